"""Tasks on a cluster of dask.distributed: its scheduler gives them to its workers, and to others where one is gone."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Generic

from process.errors import InputError
from smfe.work.processes import alone
from smfe.work.tasks import LOST, OUTSIDE, Begun, Outcome, T

AHEAD = 2
"""Tasks that each worker is given beforehand, so that it never waits for the next one."""

CONNECT = 30.0
"""Seconds to wait for the scheduler, and for the first worker."""

_one = threading.Lock()


class Cluster(Generic[T]):
    """A cluster that carries out a function; it and its tasks can be pickled.

    The workers must have the same version of this program. A process does one task at a time, however many threads its
    worker has.
    """

    def __init__(self, function: Callable[[T], Outcome], client: Any) -> None:
        self.function, self.client = function, client
        self._flying: dict[str, tuple[Any, Begun[T]]] = {}
        self._number = 0

    @property
    def count(self) -> int:
        """How many tasks are given at a time: it follows workers that come and go."""
        return max(AHEAD * len(self.client.scheduler_info(n_workers=-1)["workers"]), 1)

    def everywhere(self, function: Callable[..., bool], *arguments: object) -> bool:
        """Return whether a function is true on every worker."""
        return all(self.client.run(function, *arguments).values())

    def begin(self, begun: Begun[T]) -> None:
        """Give a task to the scheduler."""
        self._number += 1
        key = f"smfe-{id(self)}-{self._number}"
        future = self.client.submit(_one_at_a_time, self.function, begun.task, key=key, pure=False)
        self._flying[key] = (future, begun)

    def ended(self) -> list[tuple[Begun[T], Outcome]]:
        """Wait until tasks end and return them; one whose workers were ended again and again with `LOST`."""
        import distributed

        # `distributed.wait` would ask a global client, and every dask in this process with it.
        ended: Any = distributed.as_completed
        next(ended([future for future, _ in self._flying.values()], loop=self.client.loop))
        finished = [key for key, (future, _) in self._flying.items() if future.done()]
        return [(begun, _outcome(future)) for future, begun in (self._flying.pop(key) for key in finished)]


@contextmanager
def cluster(function: Callable[[T], Outcome], address: str) -> Iterator[Cluster[T]]:
    """Carry out tasks on the cluster with a scheduler at this address ("tcp://host:8786").

    Raises
    ------
    InputError
        When dask.distributed is not installed, nothing answers at the address, or no worker is there.
    """
    try:
        import distributed
    except ImportError:
        raise InputError(
            "a cluster needs dask.distributed, which is not installed: pip install 'smfe[cluster]'"
        ) from None
    begin: Any = distributed.Client
    try:
        client = begin(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"no scheduler answers at '{address}' ({error}); start one: dask scheduler") from None
    with client:
        try:
            client.wait_for_workers(1, timeout=CONNECT)
        except TimeoutError:
            raise InputError(
                f"the scheduler at '{address}' has no workers; start some: dask worker {address}"
            ) from None
        yield Cluster(function, client)


def _one_at_a_time(function: Callable[[T], Outcome], task: T) -> Outcome:
    import dask

    # Libraries that know dask would ask the scheduler in whose task they are.
    with _one, dask.config.set(scheduler="synchronous"):
        alone()
        return function(task)


def _outcome(future: Any) -> Outcome:
    if future.status == "finished":
        found: Outcome = future.result()
        return found
    if future.status == "error":
        error = future.exception()
        if type(error).__name__ != "KilledWorker":
            return Outcome(OUTSIDE, (f"the cluster could not do it ({type(error).__name__}: {error})",))
    return LOST
