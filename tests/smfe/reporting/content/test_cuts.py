"""Cutting tests in rows: chatter first, what was observed counts, predictions marked right or wrong."""

from __future__ import annotations

from samples.report import cutting_tests

from smfe.reporting.content.cuts import RIGHT, WRONG, counted, cuts, scores


def test_chatter_and_undecided_first() -> None:
    found = cuts(cutting_tests())
    assert [cut.outcome for cut in found] == ["chatter"] * 2 + ["stable"] * 4
    undecided = cuts(cutting_tests().assign(observed=""))
    assert [cut.outcome for cut in undecided] == ["chatter"] * 2 + ["undecided"] + ["stable"] * 3
    assert [cut.speed for cut in undecided][:3] == [380.0, 520.0, 600.0]


def test_what_the_engineer_observed_counts_and_is_said() -> None:
    disagree = [cut for cut in cuts(cutting_tests()) if cut.disagrees]
    assert [(cut.file, cut.verdict, cut.observed, cut.outcome) for cut in disagree] == [
        ("cut_520.csv", "chatter", "stable", "stable")
    ]


def test_predictions_are_marked_by_a_sign_and_words() -> None:
    cut = next(cut for cut in cuts(cutting_tests()) if cut.file == "cut_600.csv")
    assert [(p.source, p.mark, p.said, p.depth) for p in cut.predictions] == [
        ("hammer_idle", WRONG, "stable", "limit 1.1 mm"),
        ("sweep", RIGHT, "chatter", "limit 1.3 mm"),
    ]


def test_scores_name_the_cuts_that_were_called_stable() -> None:
    hammer, sweep = scores(cuts(cutting_tests()))
    assert hammer.startswith("hammer idle: 2 of 6 predicted rightly; called stable, but chattered: 600 rpm with 1.6 mm")
    assert "called chatter, but stable: " in hammer
    assert sweep.startswith("sweep: 5 of 6 predicted rightly; called chatter, but stable: 700 rpm with 2.2 mm")


def test_counted() -> None:
    assert counted(cuts(cutting_tests())) == "6 cutting tests: 2 chatter, 4 stable."
    assert cuts(None) == []
