"""The search: globally by differential evolution, then a cloud that shrinks about the best, on a finer grid.

Limits are kept by order (Deb 2000): of two candidates within the limits the better one wins, one within beats one
without, and of two without the one that misses less wins. The depth is the least of several lobes and has kinks where
two of them are equal, and the best gains usually lie there and on a limit: nothing here takes a derivative.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize

from process.types import Real
from smfe.progress import Progress, silent
from smfe.tuning.judge import Judge, Judged, gains_at, shares_of
from smfe.tuning.rules import RULES
from smfe.tuning.task import Task


@dataclass
class Archive:
    """All candidates of a search that kept the limits.

    Parameters
    ----------
    share : ndarray, shape (n, 3 a)
        Places in the unit cube.
    goal, error : ndarray, shape (n,)
        What they are worth, and their tracking error [m].
    tried : int
        How many were judged, these included.
    """

    share: Real
    goal: Real
    error: Real
    tried: int = 0

    @classmethod
    def empty(cls, size: int) -> Archive:
        """Return an archive without candidates, of `size` coordinates."""
        return cls(np.zeros((0, size)), np.zeros(0), np.zeros(0))

    def add(self, share: Real, judged: Judged) -> None:
        """Keep those candidates, shape (c, 3 a), that keep the limits."""
        good = judged.missed == 0.0
        self.share = np.concatenate([self.share, share[good]])
        self.goal = np.concatenate([self.goal, judged.goal[good]])
        self.error = np.concatenate([self.error, judged.error[good]])
        self.tried += len(share)


def search_globally(task: Task, progress: Progress = silent) -> tuple[Real, float, Archive]:
    """Return the best place in the unit cube, by how much its limits are missed, and what was found on the way.

    Differential evolution (Storn and Price 1997) on the coarse grid, a generation at a time. Candidates miss the limits
    everywhere: the least miss comes back, and above zero.
    """
    judge, size = Judge(task, RULES.coarse), 3 * len(task.source.axes)
    archive = Archive.empty(size)
    generations = RULES.generations

    def told(generation: int) -> None:
        progress("searching gains", min(generation, generations), generations)

    best, cost = _evolved(judge, _starts(task, size), generations, archive, told)
    return best, max(cost - 1.0, 0.0) if cost > 0.0 else 0.0, archive


def _evolved(
    judge: Judge, start: Real, generations: int, archive: Archive, told: Callable[[int], None] = lambda _: None
) -> tuple[Real, float]:
    """Return the best place and its cost after some generations from a first one, shape (n, 3 a)."""
    task, generation = judge.task, [0]

    def cost(places: Any, /) -> Any:
        share = np.atleast_2d(places.T)
        judged = judge(gains_at(task, share))
        archive.add(share, judged)
        return judged.cost

    def after(intermediate_result: Any) -> Any:
        generation[0] += 1
        told(generation[0])
        return _settled(intermediate_result)

    found = optimize.differential_evolution(
        cost,
        optimize.Bounds(np.zeros(start.shape[1]), np.ones(start.shape[1])),
        init=start,
        maxiter=generations,
        tol=0.0,
        mutation=(0.4, 0.9),
        recombination=0.8,
        seed=task.seed,
        polish=False,
        vectorized=True,
        updating="deferred",
        callback=after,
    )
    return np.asarray(found.x), float(found.fun)


def _settled(state: object) -> bool:
    """Whether the whole population lies within the limits and within a thousandth of each other."""
    energies = np.asarray(getattr(state, "population_energies", np.array([1.0])))
    return bool(energies.max() < 0.0 and np.ptp(energies) < 2e-3 * abs(energies.min()))


def _starts(task: Task, size: int) -> Real:
    """A first generation: an even spread, the rule of Table 2 at several bandwidths, and the present gains."""
    number = RULES.population * (size // 3)
    generator = np.random.default_rng(task.seed)
    spread = (generator.permuted(np.tile(np.arange(number), (size, 1)), axis=1).T + 0.5) / number
    rule = shares_of(task, rule_gains(task, np.geomspace(0.2, 0.9, 6)))
    known = [np.array([[v.Kp, v.Ti, v.Kv] for v in servos]) for servos in task.present.values()]
    given = shares_of(task, np.array(known)) if known else np.zeros((0, size))
    return np.asarray(np.clip(np.concatenate([rule, given, spread]), 0.0, 1.0))


def rule_gains(task: Task, share: Real) -> Real:
    """Return gains of `process.drive.servo.tune` for all axes, ``Ti Kp/M = 2``, ``Kv M/Kp = 1/4``, shape (c, a, 3).

    `share` runs from the slowest crossover (0) to the fastest (1) of each axis.
    """
    places = np.repeat(np.asarray(share, dtype=float)[:, None], 3 * len(task.source.axes), axis=1)
    speed = gains_at(task, places)[..., 0] / task.source.mass
    return np.asarray(np.stack([speed * task.source.mass, 2.0 / speed, 0.25 * speed], axis=-1))


def refine(
    judge: Judge, start: Real, width: float, archive: Archive | None = None, rounds: int | None = None, seed: int = 0
) -> tuple[Real, float]:
    """Return a better place than `start` in the unit cube, and its cost: a cloud that shrinks about the best.

    Parameters
    ----------
    judge : Judge
        What counts.
    start : ndarray, shape (n, 3 a)
        Places to begin at; the best of them is the first centre.
    width : float
        Half width of the first cloud [1], of the cube.
    archive : Archive, optional
        Is told of each candidate.
    rounds : int, optional
        How many clouds.
    seed : int, optional
        Of the draws.
    """
    task, generator = judge.task, np.random.default_rng(seed)
    size = start.shape[1]
    number = RULES.cloud * (size // 3)
    judged = judge(gains_at(task, start))
    cost = judged.cost
    best, least = start[int(cost.argmin())], float(cost.min())
    step = np.zeros(size)
    for _ in range(RULES.clouds if rounds is None else rounds):
        drawn = best + width * generator.normal(size=(number, size)) * generator.uniform(0.05, 1.0, (number, 1))
        # Along the last steps too: the best gains lie on a limit, and a limit is followed fastest that way.
        drawn[: number // 4] = (
            best + step * generator.uniform(0.2, 2.0, (number // 4, 1)) + 0.3 * (drawn[: number // 4] - best)
        )
        drawn = np.clip(drawn, 0.0, 1.0)
        judged = judge(gains_at(task, drawn))
        if archive is not None:
            archive.add(drawn, judged)
        i = int(judged.cost.argmin())
        if judged.cost[i] < least:
            step = 0.5 * step + (drawn[i] - best)
            best, least = drawn[i], float(judged.cost[i])
        else:
            width *= RULES.shrink
    return best, least


def polished(task: Task, start: Real, archive: Archive, progress: Progress = silent) -> tuple[Real, float]:
    """Return the best place and its cost: refined on the coarse grid, then on the fine one with the limits kept.

    The search begins at `start`, shape (n, 3 a), and at the best of the archive.
    """
    coarse = Judge(task, RULES.coarse)
    good = archive.share[np.argsort(-archive.goal)[:8]] if archive.goal.size else start
    best, _ = refine(coarse, np.concatenate([start, good]), 0.05, archive, RULES.clouds, task.seed)
    fine = Judge(task, RULES.fine, RULES.spare)
    near = [best]
    for number in range(RULES.fine_parts):
        progress("refining", number, RULES.fine_parts)
        rounds = RULES.clouds // (2 * RULES.fine_parts)
        width = 4e-3 * RULES.shrink ** (number * rounds / 2)
        best, cost = refine(fine, np.array(near), width, None, rounds, task.seed + number)
        near = [best]
    return best, cost


def frontier(
    task: Task, best: Real, archive: Archive, points: int, progress: Progress = silent
) -> list[tuple[Real, float]]:
    """Return places and goals with the best depth at a given tracking error, from the least error to that of `best`.

    Each is a search of its own, with the error as one limit more: the gains change their kind along the curve. It
    begins at the best that the archive has about its error, and at random.
    """
    judge = Judge(task, RULES.coarse)
    top = float(judge(gains_at(task, best[None])).error[0])
    within = archive.error[archive.goal > RULES.worth * archive.goal.max()]
    low, high = float(within.min()), max(top, float(within.min()) * 1.0001)
    levels = np.geomspace(low, high, points) if low > 0.0 else np.linspace(low, high, points)
    half, generator = RULES.population * (best.size // 3) // 2, np.random.default_rng(task.seed)
    out: list[tuple[Real, float]] = []
    for number, level in enumerate(levels[::-1]):
        progress("weighing depth against tracking", number, points)
        asked = Judge(task, RULES.coarse, RULES.spare, float(level))
        near = np.flatnonzero(archive.error <= 1.2 * level)
        near = near[np.argsort(-archive.goal[near])][: 10 * half : 10]
        known = np.concatenate([archive.share[near], best[None], *([out[-1][0][None]] if out else [])])
        start = np.concatenate([known, generator.uniform(size=(half, best.size))])
        found, _ = _evolved(asked, start, RULES.generations // 3, archive)
        found, cost = refine(asked, np.concatenate([found[None], known]), 0.03, archive, RULES.clouds // 2, number)
        if cost < 0.0:
            out.append((found, -cost))
    # What is shallower at a larger error is no compromise.
    out = out[::-1]
    return [one for i, one in enumerate(out) if all(one[1] > before[1] for before in out[:i])]
