"""One bar for the whole of a job: what is done, how far it is, how long still; alive while a single step takes long."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, Task, TextColumn
from rich.progress import Progress as RichProgress
from rich.table import Column
from rich.text import Text

from smfe.progress import Progress, visible

HEARTBEAT = 20.0
"""Seconds between lines where the output is no terminal and the work is the same."""

Clock = Callable[[], float]


class Estimate:
    """Share of the work that is done, and the time that is left by it.

    The share never falls, whatever a nested step reports: one job is one bar. What is left is what the work so far
    leads to expect, and runs down between two reports.
    """

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self.clock = clock
        self.begun = self.reported = clock()
        self.first: float | None = None  # when the work began: what is imported before is no work
        self.share = 0.0

    def report(self, done: int, of: int) -> float:
        """Take a report and return the share."""
        share = min(done / of, 1.0) if of > 0 else 0.0
        if self.first is None:
            self.first = self.clock()
        if share > self.share:
            self.share, self.reported = share, self.clock()
        return self.share

    @property
    def elapsed(self) -> float:
        """Seconds since the beginning."""
        return self.clock() - self.begun

    @property
    def left(self) -> float | None:
        """Seconds still; None where nothing can be said yet, or the estimate has run out."""
        worked = self.reported - (self.begun if self.first is None else self.first)
        if self.share < 0.03 or worked < 1.0:
            return None
        left = worked * (1.0 - self.share) / self.share - (self.clock() - self.reported)
        return left if left >= 0.5 else None


def duration(seconds: float) -> str:
    """Return "8 s", "2 min 05 s", "1 h 20 min"."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole % 3600 // 60:02d} min"


class _Times(TextColumn):
    """Elapsed time and time left; drawn anew by the refresh thread of the bar."""

    def __init__(self, estimate: Estimate) -> None:
        super().__init__("", table_column=Column(no_wrap=True))
        self.estimate = estimate

    def render(self, task: Task) -> Text:
        left = self.estimate.left
        still = "" if left is None else f", about {duration(left)} left"
        return Text(f"{100 * self.estimate.share:3.0f} % {duration(self.estimate.elapsed)}{still}")


@contextmanager
def bar(console: Console, verbose: bool = False) -> Iterator[Progress]:
    """Show a bar; with `verbose`, each step also as a line above it."""
    estimate, seen = Estimate(), _Seen()
    what = TextColumn(
        "{task.description}", markup=False, table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis")
    )
    columns = (SpinnerColumn(), what, BarColumn(bar_width=18), _Times(estimate))
    with RichProgress(*columns, console=console, transient=True, expand=True) as progress:
        task = progress.add_task("starting", total=1.0)

        def report(step: str, done: int, of: int) -> None:
            progress.update(task, description=visible(step), completed=estimate.report(done, of))
            if verbose and seen.new(step):
                console.print(_line(step, estimate), markup=False, highlight=False)

        yield report


@contextmanager
def lines(console: Console, verbose: bool = False) -> Iterator[Progress]:
    """Print a line where the kind of work changes and now and then in between; with `verbose`, one a step."""
    estimate, seen = Estimate(), _Seen()
    last = [-HEARTBEAT]

    def report(step: str, done: int, of: int) -> None:
        estimate.report(done, of)
        kind = step if verbose else step.partition(" ")[0]
        if seen.new(kind) or estimate.elapsed - last[0] > HEARTBEAT:
            last[0] = estimate.elapsed
            console.print(_line(step, estimate), markup=False, highlight=False, soft_wrap=True)

    yield report


def _line(step: str, estimate: Estimate) -> str:
    left = estimate.left
    still = "" if left is None else f", about {duration(left)} left"
    return f"{visible(step)} ({100 * estimate.share:.0f} %, {duration(estimate.elapsed)}{still})"


class _Seen:
    """What was said already."""

    def __init__(self) -> None:
        self.names: set[str] = set()

    def new(self, name: str) -> bool:
        known = name in self.names
        self.names.add(name)
        return not known
