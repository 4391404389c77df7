"""Formulas as MathML: browsers draw them by themselves, so that a page needs no script and no network.

Docutils translates LaTeX to MathML; Sphinx asks for somebody who writes the nodes. What docutils does not know is an
error of the build, with the formula.
"""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.errors import SphinxError
from sphinx.locale import _
from sphinx.util.math import get_node_equation_number

# A space between a function and its argument, as TeX sets it: docutils writes none.
FUNCTION = re.compile(
    r"(\\(?:operatorname\{\w+\}|arg|arccos|arcsin|arctan|cos|det|exp|ln|log|max|min|sin|tan)(?![a-z]))\s*"
    r"(?=\\(?!left|big|Big|,|;|!|quad|right)[a-zA-Z]|[A-Za-z])"
)


def translate(tex: str, block: bool, place: object) -> str:
    """MathML of one formula; lines that end in two backslashes are aligned at ``&``."""
    if block and r"\\" in tex and r"\begin" not in tex:
        tex = rf"\begin{{aligned}}{tex}\end{{aligned}}"
    tex = FUNCTION.sub(r"\1\\,", tex)
    try:
        found: str = tex2mathml(tex, as_block=block)
    except MathError as error:
        raise SphinxError(f"{place}: docutils cannot write {tex!r} as MathML: {error}") from error
    return found


def visit_inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(translate(node.astext(), False, writer.document.get("source")))
    raise nodes.SkipNode


def visit_block(writer: Any, node: nodes.math_block) -> None:
    writer.body.append(writer.starttag(node, "div", CLASS="math notranslate nohighlight"))
    if node["number"]:
        writer.body.append(f'<span class="eqno">({get_node_equation_number(writer, node)})')
        writer.add_permalink_ref(node, _("Link to this equation"))
        writer.body.append("</span>")
    writer.body.append(translate(node.astext(), True, writer.document.get("source")))
    writer.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_html_math_renderer("mathml", (visit_inline, None), (visit_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
