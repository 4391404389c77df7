"""What candidates are worth: depth, limits and tracking error, the worst over the stated change of the modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from process.types import Complex, Real
from smfe.tuning.depths import Oriented, branches, least_depth, limits
from smfe.tuning.loops import Closed, bandwidth, close, largest_feed_forward, margins, peak_dB
from smfe.tuning.plants import Plant, grid_of
from smfe.tuning.rules import RULES
from smfe.tuning.task import Task

SPEEDS = 81
"""Spindle speeds at which a removal rate is looked for."""

_SCALE = {"gain_margin": 1.0, "phase_margin": 5.0, "velocity_peak": 1.0, "position_peak": 1.0}
"""By how much a limit must be missed to count as one; others in shares of themselves."""


_AT_ONCE = 40
"""Candidates whose arrays are in memory together: more of them do not fit into the cache."""

_ROUNDING = 1e-6
"""By how much a feed-forward on the limit stays below it [dB]."""


@dataclass(frozen=True)
class Judged:
    """Candidates and what they are worth.

    Parameters
    ----------
    goal : ndarray, shape (c,)
        What is maximised, the worst over the moved modes: depth [m], or removal rate [m^3/s].
    nominal : ndarray, shape (c,)
        The same with the modes where they are.
    values : mapping of str to ndarray, shape (c,)
        Limited quantity -> its worst value over axes and moved modes.
    missed : ndarray, shape (c,)
        By how much limits are missed, 0 where all are kept; unstable candidates miss by 10 and more.
    error : ndarray, shape (c,)
        Tracking error of the move [m], modes where they are.
    feed_forward : ndarray, shape (c, a)
        [1].
    unstable : ndarray of bool, shape (c,)
        Whether a loop is unstable, in any of the moved modes.
    """

    goal: Real
    nominal: Real
    values: Mapping[str, Real]
    missed: Real
    error: Real
    feed_forward: Real
    unstable: Real

    @classmethod
    def joined(cls, parts: Sequence[Judged]) -> Judged:
        """Return candidates that were judged in parts, one after another."""
        arrays = {
            f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls) if f.name != "values"
        }
        values = {name: np.concatenate([part.values[name] for part in parts]) for name in parts[0].values}
        return cls(values=values, **arrays)

    @property
    def cost(self) -> Real:
        """What a search minimises: any candidate within the limits beats any that is not."""
        return np.where(self.missed > 0.0, 1.0 + self.missed, -self.goal)


class Judge:
    """Judges gains on one grid of frequencies."""

    def __init__(
        self,
        task: Task,
        points: int,
        spare: float = 0.0,
        tracking_error: float | None = None,
        changes: tuple[float, ...] | None = None,
    ) -> None:
        """Prepare the plants, of the task's changes of the modes by default; `spare` [dB] is kept to the peaks."""
        self.task, self.spare = task, spare
        self.tracking_error = task.limits.tracking_error if tracking_error is None else tracking_error
        grid = grid_of(task.source, fastest_of(task), points, task.move.frequency)
        self.plants: tuple[Plant, ...] = tuple(task.source.plant(grid, change) for change in changes or task.changes)
        self.oriented = Oriented.of(task.directional, self.plants[0].directions)

    def __call__(self, gains: Real, beyond: bool = False) -> Judged:
        """Return what gains, shape (c, a, 3), are worth; nothing beyond the limits, unless that is asked for."""
        parts = [self._judged(gains[i : i + _AT_ONCE], beyond) for i in range(0, len(gains), _AT_ONCE)]
        return parts[0] if len(parts) == 1 else Judged.joined(parts)

    def _judged(self, gains: Real, beyond: bool) -> Judged:
        closed = [self._spared(close(plant, self.oriented, gains), gains) for plant in self.plants]
        forward, first = self._feed_forward(closed, gains), closed[0]
        follows = first.position + forward[..., None] * first.ahead
        error = self.task.move.error(first.frequency, follows, gains[..., 2], forward)
        values = [self._values(one, forward) for one in closed]
        unstable = np.any([one.unstable > 0 for one in closed], axis=0)
        worst = {
            name: (np.max if name.endswith("peak") else np.min)([v[name] for v in values], axis=0) for name in values[0]
        }
        worst["tracking_error"] = error
        missed = self._missed(worst, unstable)
        worth = ~unstable if beyond else missed == 0.0
        goals = np.zeros((len(closed), len(gains)))
        if worth.any():
            goals[:, worth] = [self._goal(one.frequency, branches(one.cut[worth])) for one in closed]
        return Judged(goals.min(axis=0), goals[0], worst, missed, error, forward, unstable)

    def _spared(self, closed: Closed, gains: Real) -> Closed:
        """Return closed loops that are higher by what is spared."""
        if self.spare == 0.0:
            return closed
        # A closed loop begins at 0 dB: what is spared vanishes there faster than the loop can fall.
        slow = (2.0 * np.pi * closed.frequency / gains[..., 2:]) ** 2
        more = 10.0 ** (self.spare / 20.0 * slow / (1.0 + slow))
        velocity, position, ahead = closed.velocity * more, closed.position * more, closed.ahead * more
        return replace(closed, velocity=velocity, position=position, ahead=ahead)

    def _feed_forward(self, closed: Sequence[Closed], gains: Real) -> Real:
        """Return the feed-forward, shape (c, a): as asked, or the largest that all of the moved modes allow."""
        if self.task.feed_forward is not None:
            return np.full(gains.shape[:2], self.task.feed_forward)
        most = self.task.limits.position_peak
        if most is None:
            return np.ones(gains.shape[:2])
        return np.asarray(np.min([largest_feed_forward(one, most - _ROUNDING) for one in closed], axis=0))

    def _goal(self, frequency: Real, mu: Complex) -> Real:
        task = self.task
        if task.goal.kind == "least_depth":
            high, low = task.periods
            return least_depth(frequency, mu, (float(low), float(high)))
        if task.goal.kind == "depths":
            return np.asarray(limits(frequency, mu, task.periods).min(axis=1))
        speed = np.geomspace(min(task.goal.speeds), max(task.goal.speeds), SPEEDS)
        return np.asarray(task.removal_rate(speed, limits(frequency, mu, 60.0 / (task.tool.teeth * speed))).max(axis=1))

    def _values(self, closed: Closed, forward: Real) -> dict[str, Real]:
        """Return the worst value over the axes of what may be limited, shape (c,) each."""
        asked, f = self.task.limits, closed.frequency
        position = closed.position + forward[..., None] * closed.ahead
        out = {"velocity_peak": peak_dB(closed.velocity).max(axis=1), "position_peak": peak_dB(position).max(axis=1)}
        if asked.gain_margin is not None or asked.phase_margin is not None:
            both = [margins(f, loop) for loop in (closed.velocity_open, closed.position_open)]
            out["gain_margin"] = np.min([g.min(axis=1) for g, _ in both], axis=0)
            out["phase_margin"] = np.min([p.min(axis=1) for _, p in both], axis=0)
        if asked.velocity_bandwidth is not None:
            out["velocity_bandwidth"] = bandwidth(f, closed.velocity).min(axis=1)
        if asked.position_bandwidth is not None:
            out["position_bandwidth"] = bandwidth(f, position).min(axis=1)
        return out

    def _missed(self, values: Mapping[str, Real], unstable: Real) -> Real:
        asked = vars(self.task.limits) | {"tracking_error": self.tracking_error}
        out = np.where(unstable, 10.0, 0.0)
        for name, limit in asked.items():
            if limit is None or name not in values:
                continue
            by = values[name] - limit if name.endswith(("peak", "error")) else limit - values[name]
            out = out + np.maximum(by, 0.0) / _SCALE.get(name, max(abs(limit), 1e-9))
        return out


def fastest_of(task: Task) -> float:
    """Return the highest crossover that is tried [Hz]."""
    return float(bounds(task)[:, 0, 1].max() / (2.0 * np.pi))


def bounds(task: Task) -> Real:
    """Return least and largest value of Kp/M [rad/s], Ti Kp/M and Kv M/Kp, shape (a, 3, 2)."""
    first = 2.0 * np.pi * float(task.source.modes()[:, 0].min())
    out = []
    for delay in task.source.delay:
        most = RULES.fastest_crossover * first
        if delay > 0.0:
            most = min(most, RULES.delayed_crossover / delay)
        # A dead time that is long beside the modes leaves slow loops only.
        least = min(RULES.slowest_crossover * first, 0.05 * most)
        out.append([(least, most), RULES.integral, RULES.position])
    return np.array(out)


def gains_at(task: Task, share: Real) -> Real:
    """Return Kp, Ti, Kv, shape (c, a, 3), of places in the unit cube, shape (c, 3 a), logarithmic in each."""
    box = np.log(bounds(task))
    at = np.exp(box[..., 0] + share.reshape(-1, *box.shape[:2]) * (box[..., 1] - box[..., 0]))
    speed = at[..., 0]
    return np.stack([speed * task.source.mass, at[..., 1] / speed, at[..., 2] * speed], axis=-1)


def shares_of(task: Task, gains: Real) -> Real:
    """Return the places in the unit cube of gains; the inverse of `gains_at`."""
    speed = gains[..., 0] / task.source.mass
    at = np.log(np.stack([speed, gains[..., 1] * speed, gains[..., 2] / speed], axis=-1))
    box = np.log(bounds(task))
    return np.asarray(((at - box[..., 0]) / (box[..., 1] - box[..., 0])).reshape(len(gains), -1))
