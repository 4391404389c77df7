"""What tasks come to, wherever they are carried out, and in which order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

T = TypeVar("T")

TRIES = 3
"""How often a task is begun that fails for reasons outside of it."""

DONE, FAULT, REFUSED, OUTSIDE = "done", "faults", "refused", "outside"
"""States of a task: done; done, with parts that failed; the input is wrong; failed for a reason outside of it."""


@dataclass(frozen=True)
class Outcome:
    """What a task came to.

    Parameters
    ----------
    state : str
        `DONE`, `FAULT`, `REFUSED` or `OUTSIDE`.
    reasons : tuple of str
        Why, a sentence each.
    packed : bytes
        Files that the task wrote where nobody else sees them; empty where it wrote them in their place.
    """

    state: str
    reasons: tuple[str, ...] = ()
    packed: bytes = b""


LOST = Outcome(OUTSIDE, ("the process that did it was ended from outside; out of memory, most likely",))
"""What is said of a task whose process is gone."""


@dataclass
class Begun(Generic[T]):
    """A task, and how often it was begun."""

    task: T
    tries: int = 0


class Pool(Protocol[T]):
    """Where tasks are carried out."""

    @property
    def count(self) -> int:
        """How many tasks it takes at a time."""

    def begin(self, begun: Begun[T]) -> None:
        """Begin a task."""

    def ended(self) -> list[tuple[Begun[T], Outcome]]:
        """Wait until tasks end and return them."""


def carry_out(pool: Pool[T], first: Iterable[T], then: Callable[[T, Outcome], Iterable[T]]) -> None:
    """Carry out tasks and what follows from them.

    What fails for a reason outside of it is begun anew when all else is done, `TRIES` times in all, and alone: where a
    process was ended, none is blamed for its neighbour.

    Parameters
    ----------
    pool : Pool
        Takes `pool.count` tasks at a time.
    first : iterable
        Tasks.
    then : callable
        Called with each task and its outcome, the last one of several tries; returns the tasks that can begin now.
    """
    waiting, again, flying = deque(Begun(task) for task in first), deque[Begun[T]](), 0
    while waiting or again or flying:
        while flying < pool.count and waiting:
            pool.begin(waiting.popleft())
            flying += 1
        if not flying:
            pool.begin(again.popleft())
            flying += 1
        for begun, outcome in pool.ended():
            flying -= 1
            begun.tries += 1
            if outcome.state == OUTSIDE and begun.tries < TRIES:
                again.append(begun)
            else:
                waiting.extend(Begun(task) for task in then(begun.task, outcome))


class Here(Generic[T]):
    """Tasks one after the other in this process."""

    count = 1

    def __init__(self, function: Callable[[T], Outcome]) -> None:
        self.function = function
        self._begun: Begun[T] | None = None

    def begin(self, begun: Begun[T]) -> None:
        """Remember a task."""
        self._begun = begun

    def ended(self) -> list[tuple[Begun[T], Outcome]]:
        """Carry it out."""
        assert self._begun is not None
        begun, self._begun = self._begun, None
        return [(begun, self.function(begun.task))]


@contextmanager
def here(function: Callable[[T], Outcome]) -> Iterator[Pool[T]]:
    """Carry out tasks in this process."""
    yield Here(function)
