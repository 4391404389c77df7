"""The bar: one for the whole, an estimate of the time that is left, few lines where there is no terminal."""

import io

import pytest
from rich.console import Console

from smfe.cli.bar import HEARTBEAT, Estimate, bar, duration, lines


class Clock:
    """A clock that stands until it is told to go."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


def test_the_time_left_follows_from_the_work_done_and_runs_down() -> None:
    clock = Clock()
    estimate = Estimate(clock)
    assert estimate.left is None
    clock.now += 5.0  # what is imported first
    estimate.report(0, 4)
    clock.now += 10.0
    estimate.report(1, 4)
    assert estimate.left == pytest.approx(30.0)
    clock.now += 12.0
    assert estimate.left == pytest.approx(18.0)
    clock.now += 20.0
    assert estimate.left is None  # it takes longer than expected; nothing is claimed
    assert estimate.elapsed == pytest.approx(47.0)


def test_the_share_never_falls() -> None:
    estimate = Estimate(Clock())
    assert [estimate.report(d, o) for d, o in ((1, 2), (0, 5), (9, 0), (3, 4), (7, 4))] == [0.5, 0.5, 0.5, 0.75, 1.0]


def test_durations_are_said_in_the_unit_that_fits() -> None:
    assert [duration(s) for s in (0.4, 59.4, 125.0, 4800.0)] == ["0 s", "59 s", "2 min 05 s", "1 h 20 min"]


@pytest.mark.parametrize("verbose", [False, True])
def test_without_a_terminal_a_hundred_steps_are_a_line_unless_all_are_asked_for(
    verbose: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, out = Clock(), io.StringIO()
    monkeypatch.setattr("smfe.cli.bar.Estimate", lambda: Estimate(clock))
    with lines(Console(file=out, width=80), verbose) as progress:
        for i in range(100):
            progress(f"judging cut_{i}.csv", i, 101)
        clock.now += 2.0 * HEARTBEAT
        progress("judging cut_99.csv", 100, 101)
        progress("writing the report", 100, 101)
    said = out.getvalue().splitlines()
    assert len(said) == (102 if verbose else 3)
    assert said[0] == "judging cut_0.csv (0 %, 0 s)"
    assert said[-1].startswith("writing the report (99 %, 40 s")


def test_a_bar_on_a_terminal_says_what_how_far_and_how_long_in_a_line_of_80_columns() -> None:
    out = io.StringIO()
    console = Console(file=out, width=80, force_terminal=True, color_system=None)
    with bar(console) as progress:
        progress("identifying " + "a very long name of a measurement " * 3, 1, 4)
        progress("judging cut.csv", 1, 2)
    shown = out.getvalue()
    assert "judging cut.csv" in shown
    assert " 50 % 0 s" in shown
    assert max(len(line) for line in shown.replace("\r", "\n").splitlines()) < 100  # with the codes of the terminal
