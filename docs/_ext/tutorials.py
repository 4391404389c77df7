"""Tutorials are walked when the documentation is built: each page shows what its own blocks print and draw.

Below a block stands what it printed. A picture or a page that the blocks have made is named as the reader finds it,
relative to the folder: ``![Lobes](results/figures/lobes_1.png)``. The walk is kept while page and packages stay the
same, and shared with the tests. ``{gallery}`` collects the pictures of all pages.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx
from sphinx.errors import SphinxError

sys.path.append(str(Path(__file__).resolve().parents[2] / "tests"))

from kept import kept
from walk import FENCE, Stopped, walked

PARTS = ("start/", "tutorials/")
MADE = "_made"
MOST_LINES = 40
LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]\n]*)\]\((?P<path>[\w./-]+)\)")


def show(app: Sphinx, page: str, source: list[str]) -> None:
    """Walk a tutorial, and put into its text what the blocks print and where its pictures lie."""
    if not page.startswith(PARTS):
        return
    try:
        found = kept(walked, source[0])
    except Stopped as error:
        raise SphinxError(f"{page}: {error}") from error
    printed = {line: text for line, text in json.loads((found / "printed.json").read_text(encoding="utf-8")) if text}
    text = FENCE.sub(lambda match: _with_output(match, source[0], printed), source[0])
    source[0] = LINK.sub(lambda match: _made(app, page, found / "walk", match), text)


def _with_output(block: re.Match[str], page: str, printed: dict[int, str]) -> str:
    said = printed.get(page.count("\n", 0, block.start()) + 1)
    if not said:
        return block[0]
    lines = said.splitlines()
    if len(lines) > MOST_LINES:
        lines = [*lines[: MOST_LINES - 1], "..."]
    # More backticks than any line of what was printed could hold.
    return block[0] + "\n\n``````{code-block} text\n:class: printed\n\n" + "\n".join(lines) + "\n``````\n"


def _made(app: Sphinx, page: str, folder: Path, link: re.Match[str]) -> str:
    path = folder / link["path"]
    if not path.is_file():
        return link[0]
    target = f"{MADE}/{page}/{link['path']}"
    if link["picture"]:
        copy = Path(app.srcdir) / target
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)
        return f"![{link['text']}](/{target})"
    copy = Path(app.outdir) / target
    copy.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(path, copy)
    up = "../" * page.count("/")
    return f'<a class="reference external" href="{up}{target}">{link["text"]}</a>'


class gallery(nodes.General, nodes.Element):
    """Place of the pictures of all pages."""


class Gallery(Directive):
    """``{gallery}``: the pictures of all pages, each a link to the page that makes it."""

    def run(self) -> list[nodes.Node]:
        return [gallery()]


def collect(app: Sphinx, doctree: nodes.document, page: str) -> None:
    """Put the pictures of all pages where the directive stands."""
    for place in list(doctree.findall(gallery)):
        box = nodes.container(classes=["gallery"])
        for other in _in_order(app):
            seen: set[str] = set()
            for image in app.env.get_doctree(other).findall(nodes.image):
                if image["uri"] in seen or image["uri"].endswith(".svg"):
                    continue
                seen.add(image["uri"])
                box += _picture(app, page, other, image)
        place.replace_self(box)


def _in_order(app: Sphinx) -> list[str]:
    """Return the pages as the table of contents lists them."""
    out: list[str] = []
    for children in (app.env.toctree_includes.get(app.config.root_doc, []),):
        out += [page for page in children if page in app.env.found_docs]
    return out


def _picture(app: Sphinx, page: str, other: str, image: nodes.image) -> nodes.container:
    title = app.env.titles[other].astext()
    section = image.parent
    while section is not None and not isinstance(section, nodes.section):
        section = section.parent
    heading = section.next_node(nodes.title).astext() if section is not None else title
    alt = image.get("alt", "")
    said = alt if " " in alt else heading
    shown = nodes.image(uri=image["uri"], candidates=image["candidates"], alt=said)
    address = app.builder.get_relative_uri(page, other)
    caption = nodes.paragraph("", f"{said}: " if said != title else "")
    caption += nodes.reference("", title, refuri=address, internal=True)
    return nodes.container("", nodes.reference("", "", shown, refuri=address, internal=True), caption)


def setup(app: Sphinx) -> dict[str, bool]:
    app.add_node(gallery)
    app.add_directive("gallery", Gallery)
    app.connect("source-read", show)
    app.connect("doctree-resolved", collect)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
