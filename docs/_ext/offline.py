"""The pages fetch nothing: a build whose HTML or style asks another host for a script, style, font or picture fails."""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import SphinxError

# What a browser fetches by itself. A link that the reader follows is none of it.
FETCHED = re.compile(
    r"""<(?:script|img|iframe|source|audio|video|embed)\b[^>]*?\bsrc\s*=\s*["'](?P<source>(?:https?:)?//[^"']+)"""
    r"""|<link\b(?=[^>]*\brel\s*=\s*["'](?:stylesheet|preload|preconnect|icon|modulepreload))[^>]*?\bhref\s*=\s*["'](?P<link>(?:https?:)?//[^"']+)"""
    r"""|url\(\s*["']?(?P<style>(?:https?:)?//[^"')]+)"""
    r"""|@import\s+["'](?P<imported>(?:https?:)?//[^"']+)"""
    r"""|\bimport\s*\(\s*["'](?P<module>(?:https?:)?//[^"']+)"""
)


def fetched(text: str) -> list[str]:
    """Return the addresses that a page or a style sheet fetches from other hosts."""
    return [next(address for address in match.groups() if address) for match in FETCHED.finditer(text)]


def refuse(app: Sphinx, error: Exception | None) -> None:
    """End the build where a page that it wrote fetches something."""
    if error is not None or app.builder.format != "html":
        return
    root = Path(app.outdir)
    found = [
        f"{path.relative_to(root)}: {address}"
        for path in sorted(root.rglob("*"))
        if path.suffix in {".html", ".css"}
        for address in fetched(path.read_text(encoding="utf-8"))
    ]
    if found:
        raise SphinxError("pages that fetch from other hosts:\n" + "\n".join(found))


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("build-finished", refuse)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
