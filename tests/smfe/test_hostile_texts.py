"""Claims about names and values from strangers: a terminal obeys none of them, a spreadsheet computes none."""

import io
import json

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from smfe.cli import terminal
from smfe.cli.terminal import Outcome, Terminal
from smfe.progress import visible
from smfe.results import as_named, defused

ESCAPES = ["\x1b[2J", "\x1b]0;title\x07", "\x9b31m", "a\rb", "\x7f", "\u202egnp.exe", "\u2066x"]


@pytest.mark.parametrize("text", ESCAPES)
def test_an_escape_does_not_reach_the_terminal(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    said = io.StringIO()
    for stream in ("out", "errors"):
        monkeypatch.setattr(terminal, stream, Console(file=said, width=200))
    Terminal().end(Outcome([f"measurement '{text}' is identified"], {}, [f"of '{text}'"]))
    Terminal().refuse(f"'{text}': no such file")
    assert not any(sign in said.getvalue() for sign in "\x1b\x9b\x07\r\x7f\u202e\u2066")
    assert visible(text) in said.getvalue()
    assert visible("Ünïcode, 5 µm\tand\nlines") == "Ünïcode, 5 µm\tand\nlines"


@pytest.mark.parametrize("text", ESCAPES)
def test_nor_does_one_in_json_and_it_says_the_same(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    Terminal(as_json=True).end(Outcome([], {"name": text}))
    said = capsys.readouterr().out
    assert not any(sign in said for sign in "\x1b\x9b\x07\r\x7f\u202e\u2066")
    assert json.loads(said)["name"] == text


FORMULAS = ["=1+1", "@SUM(A1)", "+cmd|' /C calc'!A0", "-2+3*cmd|' /C calc'!A0", "\t=1", '=HYPERLINK("x")']
HARMLESS = ["-x", "+X", "-1.5", "+3 %", "hammer = x", "a@b", "'quoted'", "", "-1e-6"]


def test_no_cell_is_a_formula_and_all_come_back() -> None:
    texts = [*FORMULAS, *HARMLESS]
    frame = pd.DataFrame({"name": texts, "=value": -np.arange(float(len(texts))), "more": [None, *texts[1:]]})
    written = defused(frame)
    assert all(cell[0] not in "=@\t" for cell in written["name"] if cell)
    assert written["name"].tolist() == [f"'{text}" for text in FORMULAS] + HARMLESS
    assert list(written.columns) == ["name", "'=value", "more"]
    assert written["'=value"].dtype == np.float64
    pd.testing.assert_frame_equal(as_named(written), frame)
