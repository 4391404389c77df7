"""The numbered equations of the theory page are those that docstrings cite, each of them."""

import ast
import re
from pathlib import Path

import pytest
from places import CHECKOUT

THEORY = CHECKOUT / "docs" / "theory.md"
CITED = re.compile(r":eq:`([a-z-]+)`")


def docstrings(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    if ":eq:" not in text:  # most files: parsing all of them takes seconds
        return ""
    tree = ast.parse(text)
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef)
    return "\n".join(ast.get_docstring(node) or "" for node in ast.walk(tree) if isinstance(node, kinds))


@pytest.mark.skipif(not THEORY.is_file(), reason="the documentation is not part of an installed wheel")
def test_every_equation_is_cited_and_every_citation_is_an_equation() -> None:
    labels = re.findall(r"\$\$ \(([a-z-]+)\)$", THEORY.read_text(encoding="utf-8"), re.MULTILINE)
    files = [path for package in ("process", "stability", "smfe") for path in (CHECKOUT / package).rglob("*.py")]
    cited = {label for path in files for label in CITED.findall(docstrings(path))}
    assert len(labels) == len(set(labels))
    assert cited == set(labels)
