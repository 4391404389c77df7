"""Tasks in processes of this machine.

The processes are forked from a server that has imported the numerics, and in which nothing else has happened (on
Windows they start from nothing): no lock of a thread is copied, and one that is gone is soon replaced.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from typing import Generic

from smfe.progress import SmfeWarning
from smfe.work.leave import leave_with_parent
from smfe.work.tasks import LOST, Begun, Outcome, Pool, T


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


class Processes(Generic[T]):
    """`count` processes that carry out a function; it and its tasks can be pickled."""

    def __init__(self, function: Callable[[T], Outcome], count: int) -> None:
        self.function, self.count = function, count
        if sys.platform == "win32":
            self._context: multiprocessing.context.BaseContext = multiprocessing.get_context("spawn")
        else:
            self._context = multiprocessing.get_context("forkserver")
            self._context.set_forkserver_preload([function.__module__])
        self._pool: ProcessPoolExecutor | None = None
        self._flying: dict[Future[Outcome], Begun[T]] = {}

    def begin(self, begun: Begun[T]) -> None:
        """Give a task to a process that has nothing to do."""
        if self._pool is None:
            if sys.platform != "win32":
                from multiprocessing import forkserver

                with _ignored_interrupt():
                    forkserver.ensure_running()
            self._pool = ProcessPoolExecutor(self.count, self._context, _begin)
        try:
            self._flying[self._pool.submit(self.function, begun.task)] = begun
        except BrokenProcessPool:  # one that had nothing to do was ended
            self.end()
            self.begin(begun)
        except KeyboardInterrupt:
            _end_server()
            raise

    def ended(self) -> list[tuple[Begun[T], Outcome]]:
        """Wait until tasks end and return them; of a process that was ended with `LOST`."""
        finished, _ = wait(self._flying, return_when=FIRST_COMPLETED)
        if not any(_broken(f) for f in finished):
            return [(self._flying.pop(f), f.result()) for f in finished]
        wait(self._flying)  # one process that is ended takes the others with it
        all_of_them = [(begun, LOST if _broken(f) else f.result()) for f, begun in self._flying.items()]
        self._flying.clear()
        self.end()
        return all_of_them

    def end(self) -> None:
        """End all processes at once; what they had written to temporary names is written again by the next."""
        if self._pool is not None:
            for process in list((getattr(self._pool, "_processes", None) or {}).values()):
                process.kill()
            self._pool.shutdown(cancel_futures=True)
        self._pool = None


@contextmanager
def _ignored_interrupt() -> Iterator[None]:
    """Start a process that ignores Ctrl-C from its first line on: it imports for seconds before it could say so."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before or signal.SIG_DFL)


def _end_server() -> None:
    """End the server of an interrupted start: it would begin processes for one that is gone, and say so at length."""
    if sys.platform != "win32":
        from multiprocessing import forkserver

        server = getattr(getattr(forkserver, "_forkserver", None), "_forkserver_pid", None)
        if server is not None:
            with suppress(ProcessLookupError):
                os.kill(server, signal.SIGKILL)


def _broken(future: Future[Outcome]) -> bool:
    return isinstance(future.exception(), BrokenProcessPool)


@contextmanager
def processes(function: Callable[[T], Outcome], count: int) -> Iterator[Pool[T]]:
    """Carry out tasks in processes, which end with the block."""
    pool: Processes[T] = Processes(function, count)
    try:
        yield pool
    finally:
        pool.end()


def _begin() -> None:
    """In a new process: leave Ctrl-C to the one that started it, end with it, use one thread, say nothing."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    leave_with_parent()
    alone()


def alone() -> None:
    """Make this process one of several: one thread of linear algebra, no warnings that nobody would read."""
    from threadpoolctl import threadpool_limits

    threadpool_limits(1, "blas")
    warnings.simplefilter("ignore", SmfeWarning)
