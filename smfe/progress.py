"""A progress bar in the terminal for the callables that the numerics report to."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as RichProgress

from smfe.identification.errors.result import Progress


@contextmanager
def bar(console: Console) -> Iterator[Progress]:
    """Show a progress bar while the block runs; plain lines where the console is not a terminal."""
    if not console.is_terminal:
        yield _lines(console)
        return
    columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
    with RichProgress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("starting", total=1)
        yield lambda what, done, of: progress.update(task, description=what, completed=done, total=max(of, 1))


def _lines(console: Console) -> Progress:
    """Print each new job once."""
    seen: set[str] = set()

    def report(what: str, done: int, of: int) -> None:
        if what not in seen:
            seen.add(what)
            console.print(what, markup=False, highlight=False)

    return report
