"""The pages that remake the paper say what differs, and a number in them that is not the computed one is found."""

import re
from pathlib import Path

import paper
import pytest
from places import CHECKOUT

PAGES = sorted((CHECKOUT / "docs" / "paper").glob("*.md"))


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(paper, "PAPER", tmp_path)
    text = (
        "| what | paper | ours | why different |\n|---|---|---|---|\n"
        "| resonance [Hz] | 75 | 74.97 | - |\n| peaks | 2 | −1.5, 2e-3 in `K1`, 12 | a reason |\n"
        "| shape | flat | flat | - |\n"
    )
    (tmp_path / "one.md").write_text(text, encoding="utf-8")
    return tmp_path / "one.md"


GOOD = {"resonance [Hz]": 74.9741, "peaks": (-1.52, 0.0018, 11.6), "shape": None}


def test_numbers_hold_to_half_of_their_last_digit(page: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paper.check("one", GOOD)
    assert "3 rows, 4 numbers" in capsys.readouterr().out
    for what, value in (("resonance [Hz]", 74.976), ("peaks", (-1.56, 0.0018, 11.6)), ("peaks", (-1.52, 0.0026, 12.0))):
        with pytest.raises(ValueError, match=re.escape(what)):
            paper.check("one", {**GOOD, what: value})


def test_no_row_is_left_out_and_none_invented(page: Path) -> None:
    with pytest.raises(ValueError, match="'shape' is a row of the table, but not computed"):
        paper.check("one", {k: v for k, v in GOOD.items() if k != "shape"})
    with pytest.raises(ValueError, match="'new' is computed, but no row"):
        paper.check("one", {**GOOD, "new": 1.0})
    with pytest.raises(ValueError, match="shows 3 numbers"):
        paper.check("one", {**GOOD, "peaks": (1.0, 2.0)})


@pytest.mark.parametrize("path", PAGES, ids=[p.stem for p in PAGES])
def test_every_row_says_paper_ours_and_why(path: Path) -> None:
    found = paper.rows(path.read_text(encoding="utf-8"))
    assert [what for what, cells in found.items() if not all(cells)] == []
