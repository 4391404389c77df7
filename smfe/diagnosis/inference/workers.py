"""Predictions made by several processes, where they take long.

A third of a time simulation is a kernel that runs beside others; what is around it is Python, which threads do one
after the other: two cores with threads took as long as one. A process that is forked has the family as it is, closures
and all, and starts in a few hundredths of a second. Where processes cannot be forked safely (macOS, Windows, a thread
beside the main one) or not at all (a daemonic process, a limit of the system), all is done by one.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from itertools import groupby
from types import TracebackType

from process.errors import InputError
from process.types import Real
from smfe.diagnosis.inference.rules import RULES
from smfe.work.leave import leave_with_parent

Wanted = tuple[int, Real]
"""Number of a condition and all scaled values."""
Answer = tuple[Real | None, str]
"""A prediction, or None and why there is none."""
Ask = Callable[[int, Real], Answer]


def cores() -> int:
    """Return how many cores this process may use; 1 where processes cannot be forked safely."""
    # A fork copies the locks that other threads hold. Beside the main thread there are those that draw a bar or wait.
    main = threading.current_thread() is threading.main_thread()
    # A process that was started by another has others beside it, which use the cores.
    if sys.platform != "linux" or not main or multiprocessing.parent_process() is not None:
        return 1
    return len(os.sched_getaffinity(0))


class Helpers:
    """Processes that predict for one model at a time: by default one a core, `RULES.most_workers` at most."""

    def __init__(self, count: int | None = None) -> None:
        if count is not None and count < 1:
            raise InputError(f"{count} workers; give at least 1, or none for all cores")
        self.count = min(RULES.most_workers if count is None else count, cores())
        self._ask: Ask | None = None
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Helpers:
        """Return itself; processes start when they are first asked."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Send the processes home."""
        self._dismiss()

    def answers(self, ask: Ask, wanted: Sequence[Wanted]) -> list[Answer]:
        """Return what `ask` says to each, in their order; asked here where no process can help."""
        if self.count > 1 and self._ask != ask:
            self._employ(ask)
        if self._pool is None:
            return [ask(*w) for w in wanted]
        try:
            return [a for part in self._pool.map(_answered, _parts(wanted, self.count)) for a in part]
        except BrokenProcessPool:
            # Killed from outside, short of memory most likely: go on alone.
            self._dismiss()
            self.count = 1
            return [ask(*w) for w in wanted]

    def _employ(self, ask: Ask) -> None:
        self._dismiss()
        try:
            with warnings.catch_warnings():
                # Later Pythons warn of forks beside threads.
                warnings.simplefilter("ignore", DeprecationWarning)
                self._pool = ProcessPoolExecutor(self.count, multiprocessing.get_context("fork"), _begin, (ask,))
                self._pool.submit(int).result()
            self._ask = ask
        except (OSError, ImportError, NotImplementedError, BrokenProcessPool):
            # No more processes, no semaphores, no memory: go on alone.
            self._abandon()
            self.count = 1
        except BaseException:
            self._abandon()
            raise

    def _abandon(self) -> None:
        """End what has started of processes that did not all start."""
        for process in list((getattr(self._pool, "_processes", None) or {}).values()):
            process.terminate()
            process.join()
        self._dismiss()

    def _dismiss(self) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        self._pool, self._ask = None, None


def _parts(wanted: Sequence[Wanted], count: int) -> list[list[Wanted]]:
    """Keep the same values together, for which a machine is prepared once; share them out where they are few."""
    alike = [list(group) for _, group in groupby(wanted, key=lambda w: w[1].tobytes())]
    shares = -(-count // len(alike))
    sizes = [-(-len(part) // shares) for part in alike]
    return [part[k : k + n] for part, n in zip(alike, sizes, strict=True) for k in range(0, len(part), n)]


_asked: Ask


def _begin(ask: Ask) -> None:
    """In a new process: know what to ask; end without a word with an interruption, or with who started it."""
    global _asked
    _asked = ask
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    leave_with_parent()


def _answered(part: Sequence[Wanted]) -> list[Answer]:
    return [_asked(*w) for w in part]
