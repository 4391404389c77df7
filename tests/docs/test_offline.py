"""The documentation is read without a network: formulas are MathML, and what a page would fetch ends its build."""

import importlib.util
from types import ModuleType

import pytest
from places import CHECKOUT


def extension(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"docs_{name}", CHECKOUT / "docs" / "_ext" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "text",
    [
        '<script defer src="https://cdn.example/mathjax.js"></script>',
        "<link href='//cdn.example/style.css' rel='stylesheet'>",
        '<img alt="badge" src="http://badge.example/passing.svg">',
        "<style>@font-face { src: url(https://fonts.example/a.woff2) }</style>",
        '<script>import("https://cdn.example/mermaid.mjs")</script>',
    ],
)
def test_what_a_browser_would_fetch_from_elsewhere_is_seen(text: str) -> None:
    assert len(extension("offline").fetched(text)) == 1


@pytest.mark.parametrize(
    "text",
    [
        '<a href="https://doi.org/10.3390/jmmp8050207">the paper</a>',
        '<script src="_static/doctools.js"></script>',
        '<link rel="stylesheet" href="_static/smfe.css"><link rel="license" href="https://license.example">',
        '<math xmlns="http://www.w3.org/1998/Math/MathML"><mi>x</mi></math>',
    ],
)
def test_a_link_that_the_reader_follows_is_none(text: str) -> None:
    assert extension("offline").fetched(text) == []


def test_a_formula_becomes_mathml_with_a_space_between_function_and_argument() -> None:
    translate = extension("mathml").translate
    assert "<msub>" in translate("A_0", False, "page")
    assert 'display="block"' in translate(r"a &= b \\ c &= d", True, "page")
    assert translate(r"\arg\sigma", False, "page") == translate(r"\arg\,\sigma", False, "page")
    assert "mspace" not in translate(r"\cos(x)", False, "page")


def test_a_formula_that_cannot_be_written_ends_the_build_with_its_page() -> None:
    with pytest.raises(Exception, match=r"hammer\.md.*nonsense"):
        extension("mathml").translate(r"\nonsense{x}", False, "hammer.md")
