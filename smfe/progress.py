"""What a function says: how far a long job is, and what must be known of its result."""

import sys
import warnings
from collections.abc import Callable, Iterable

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how many steps are done, and of how many."""


def silent(what: str, done: int, of: int) -> None:
    """Report nothing."""


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
