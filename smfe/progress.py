"""What a function says: how far a long job is, and what must be known of its result."""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Callable, Iterable, Mapping

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many steps are done, and of how many."""

STEPS = 10_000
"""Steps of a whole that has parts."""


def silent(what: str, done: int, of: int) -> None:
    """Report nothing."""


def part(progress: Progress, begin: float, end: float) -> Progress:
    """Return the progress of a part, which fills its whole from the share `begin` to the share `end`."""

    def report(what: str, done: int, of: int) -> None:
        share = min(max(done / of, 0.0), 1.0) if of > 0 else 0.0
        progress(what, round(STEPS * (begin + (end - begin) * share)), STEPS)

    return report


def step(progress: Progress, done: int, of: int) -> Progress:
    """Return the progress of one step of several: what it reports moves the whole from this step to the next."""
    return part(progress, done / of, (done + 1) / of)


def parts(progress: Progress, weights: Mapping[str, float]) -> dict[str, Progress]:
    """Return the progress of each part of a whole, in their order.

    Parameters
    ----------
    progress : callable
        Of the whole.
    weights : mapping of str to float
        Part -> how long it takes beside the others.
    """
    total, at, out = sum(weights.values()) or 1.0, 0.0, {}
    for name, weight in weights.items():
        out[name] = part(progress, at / total, (at + weight) / total)
        at += weight
    return out


def visible(text: str) -> str:
    """Return a text in which signs that a terminal obeys, and those that turn the reading round, are seen.

    Names and values come from files; an escape in them could clear the screen, or write what was never said.
    """
    return _OBEYED.sub(lambda found: f"\\x{ord(found[0]):02x}", text)


_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")

_OURS = ("smfe", "stability", "process")


class SmfeWarning(UserWarning):
    """What somebody must know who uses a result: said once a call, and kept with the result.

    Parameters
    ----------
    sentences : str
        Each thing to know, as one sentence.
    """

    def __init__(self, *sentences: str) -> None:
        super().__init__("\n".join(sentences))
        self.sentences = sentences


def warn(sentences: Iterable[str]) -> None:
    """Warn once of all sentences, each said once, at the line of the caller that is none of these packages.

    Parameters
    ----------
    sentences : iterable of str
        What must be known. Without any nothing happens.
    """
    once = tuple(dict.fromkeys(sentences))
    if not once:
        return
    frame, level = sys._getframe(), 1
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in _OURS:
        frame, level = frame.f_back, level + 1
    warnings.warn(SmfeWarning(*once), stacklevel=level)
