"""The comparison in three sentences: who agrees, what differs most, what explains it or cannot be told apart."""

from __future__ import annotations

import pandas as pd
from samples.report import comparison, explained

from smfe.reporting.content.compared import sentences
from smfe.reporting.content.style import with_spread
from smfe.reporting.content.tables import comparison as table


def test_who_agrees_what_differs_and_why() -> None:
    agree, differ, why = sentences(comparison(), explained())
    assert agree.startswith(
        "hammer idle and actuator agree; sweep differs: 2 of 9 pairs of peaks differ significantly."
    )
    assert "1 more was found in one of two measurements only." in agree
    assert "frequency −3.26 ± 0.21 % (−2.00 ± 0.13 Hz) from hammer idle to sweep (peak at 61.4 Hz, entry xx)" in differ
    assert "amplitude 42.0 ± 5.4 % from actuator to sweep" in differ
    assert "damping" not in differ
    assert why.startswith("Feed explains 93 % of it: −3.10 ± 0.30 % from 0 mm/min to 120 mm/min along x.")
    assert "Method and level always change together: they cannot be separated." in why


def test_nothing_differs() -> None:
    frame = comparison().assign(significant=False)
    agree, seen, design = sentences(frame, explained().assign(significant=False))
    assert agree.startswith("All measurements agree (hammer idle, actuator and sweep): none of 9 pairs")
    assert "frequency 0.41 %" in seen
    assert design.startswith("Feed can be judged alone. Method and level always change together")


def test_no_condition_explains_it() -> None:
    rows = explained().assign(significant=False)
    assert "No condition explains it significantly (most: feed, 93 %)." in sentences(comparison(), rows)[2]
    assert "cannot be said" in sentences(comparison(), None)[2]


def test_everyone_differs() -> None:
    frame = comparison().assign(significant=True)
    assert sentences(frame, None)[0].startswith("No two measurements agree: 9 of 9 pairs")


def test_only_all_three_together_differ() -> None:
    frame = comparison()
    frame = frame.assign(**{f"{q}_significant": False for q in ("frequency", "damping", "amplitude")})
    assert "No single quantity differs significantly" in sentences(frame, explained())[1]


def test_a_table_of_another_program_says_nothing() -> None:
    assert sentences(pd.DataFrame({"a": [1]}), None) == []


def test_two_digits_of_an_uncertainty() -> None:
    assert with_spread(58.60915, 0.0028) == "58.6091 ± 0.0028"
    assert with_spread(-0.2874, 0.2333) == "−0.29 ± 0.23"
    assert with_spread(0.5, 0.0996) == "0.50 ± 0.10"
    assert with_spread(1234.5, 321.0) == "1230 ± 320"
    assert with_spread(5.0, float("nan")) == "5"


def test_the_table_is_folded_and_marks_what_differs() -> None:
    found = table(comparison())
    assert found.folded
    assert [bool(row.css) for row in found.rows].count(True) == 2
    assert found.rows[3].cells[:4] == ("hammer idle", "sweep", "xx", "both")
    assert found.rows[3].cells[6:] == ("−3.26 ± 0.21", "1.0 ± 5.2", "41.0 ± 5.4", "frequency, amplitude")
