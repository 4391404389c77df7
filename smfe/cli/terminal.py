"""What a verb says: one bar while it works, then what it found, on the terminal or as one JSON object."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Console

from smfe.cli.bar import bar, lines
from smfe.cli.interrupt import answer
from smfe.progress import Progress, silent, visible

if TYPE_CHECKING:
    from smfe.results import Failures

out = Console()
errors = Console(stderr=True)

DONE, WRONG, USAGE, FAULT, INTERRUPTED = 0, 1, 2, 3, 130
"""Exit statuses: done; the input was wrong; wrong usage; done, but a fault in the data remains; Ctrl-C."""


@dataclass
class Outcome:
    """What a verb found.

    Parameters
    ----------
    lines : sequence of str
        What it found and what to do next, a line each.
    content : mapping
        The same for ``--json``.
    warnings : sequence of str
        What speaks against it.
    failures : list of Failure
        Parts that failed or were left out; with any the exit status is 3.
    fault : bool
        Whether a fault in the data remains that is no failure of a part.
    wrong : bool
        Whether some of what was asked for was not done at all: the exit status is 1.
    counted : bool
        Whether the lines say how many warnings there are: they are then said in full with ``-v`` only.
    """

    lines: Sequence[str]
    content: Mapping[str, Any]
    warnings: Sequence[str] = ()
    failures: Failures = field(default_factory=list)
    fault: bool = False
    wrong: bool = False
    counted: bool = False


@dataclass(frozen=True)
class Terminal:
    """How a verb talks to its user.

    Parameters
    ----------
    as_json : bool
        Print one JSON object on stdout, and nothing else there.
    verbose : bool
        Say every step and every warning.
    quiet : bool
        Say nothing on the way; the result alone.
    """

    as_json: bool = False
    verbose: bool = False
    quiet: bool = False

    @contextmanager
    def bar(self) -> Iterator[Progress]:
        """Show how far the work is while the block runs: a bar on a terminal, else a line now and then."""
        if self.quiet:
            yield _answering(silent)
        elif errors.is_terminal:
            with bar(errors, self.verbose) as progress:
                yield _answering(progress)
        else:
            with lines(errors, self.verbose) as progress:
                yield _answering(progress)

    def show(self, text: str) -> None:
        """Show the licence of a public data set that is about to be fetched, also where all else is silent."""
        _say(errors, text)

    def note(self, text: str) -> None:
        """Say something by the way."""
        if not self.quiet:
            _say(errors, text)

    def end(self, outcome: Outcome) -> None:
        """Print what was found and leave with exit status 3 where a fault remains."""
        if self.as_json:
            rows = [{"part": f.part, "name": f.name, "reason": f.reason} for f in outcome.failures]
            self.print_json({**outcome.content, "warnings": list(outcome.warnings), "failures": rows})
        else:
            if self.verbose or not (self.quiet or outcome.counted):
                for warning in outcome.warnings:
                    _say(errors, f"warning, {warning}")
            for line in outcome.lines:
                _say(out, line)
        for failure in outcome.failures:
            _say(errors, f"failed, {failure.sentence}")
        if outcome.wrong:
            raise typer.Exit(WRONG)
        if outcome.failures or outcome.fault:
            raise typer.Exit(FAULT)

    def refuse(self, text: str) -> None:
        """Say why nothing was done."""
        _say(errors, f"smfe: {text}")
        if self.as_json:
            self.print_json({"error": text})

    def print_json(self, content: Mapping[str, Any]) -> None:
        """Print one JSON object; numbers that JSON does not have become null."""
        text = json.dumps(plain(content), indent=2, ensure_ascii=False)
        # JSON escapes the first 32 signs itself.
        typer.echo(_LEFT.sub(lambda found: f"\\u{ord(found[0]):04x}", text))


_LEFT = re.compile("[\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def _answering(progress: Progress) -> Progress:
    """Return the same progress, at each step of which a Ctrl-C that was dropped on the way ends the work."""

    def report(step: str, done: int, of: int) -> None:
        answer()
        progress(step, done, of)

    return report


def plain(value: Any) -> Any:
    """Return a value as JSON has it: infinite and missing numbers as null, arrays as lists, paths as text."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, bool | str | int) or value is None:
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, list | tuple | set):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return str(value)


def _say(console: Console, text: str) -> None:
    # A terminal breaks between words; what is piped on stays one line.
    console.print(visible(text), markup=False, highlight=False, soft_wrap=not console.is_terminal)
