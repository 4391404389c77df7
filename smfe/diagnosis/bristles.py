"""The direction of sliding along a record: bristles that follow a reversal over micrometres.

``dz/dx = (1 - z sign v)/slide`` (Dahl 1968), in closed form between reversals. Friction that changes with speed,
g(|v|), goes through the same bristles (LuGre; Canudas de Wit et al., IEEE Transactions on Automatic Control 40, 1995):
it follows ``g sign v`` over the same distance, in place of at once. A reversal is where the axis comes back
by more than the encoder trembles: at rest bristles keep what they hold until the axis moves on. What they hold at the
beginning of a move comes from the move before, so that a record is followed as a whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

Real = NDArray[np.float64]

_KEPT = 8


def reversals(position: Real, velocity: Real, least: float = 0.0) -> tuple[float, tuple[int, ...]]:
    """Return the direction at first, and the first sample of each way back that is longer than `least` [m]."""
    forward = velocity >= 0.0
    turning = np.flatnonzero(forward[1:] != forward[:-1]) + 1
    first = way = 1.0 if forward[0] else -1.0
    found: list[int] = []
    farthest, at = float(position[0]), 0
    for k in [*turning.tolist(), velocity.size - 1]:
        ahead = way * (float(position[k]) - farthest)
        if ahead < -least:
            if at:
                found.append(at)
            else:
                first = -first
            way, farthest, at = -way, float(position[k]), k
        elif ahead > 0.0:
            farthest, at = float(position[k]), k
    return first, tuple(found)


def presliding(
    position: Real, velocity: Real, slide: float, step: float = 0.0, turns: tuple[float, Sequence[int]] | None = None
) -> Real:
    """Return the direction of sliding [1], which follows a reversal over a distance `slide` [m] (Dahl 1968).

    At the first sample it slides. With the sample interval `step` [s] a reversal is where the velocity passes zero
    between two samples: within a millisecond an axis goes back by a good part of the distance over which its friction
    gives way.

    Parameters
    ----------
    position, velocity : ndarray, shape (n,)
        Of the axis [m], [m/s].
    slide : float
        Distance [m].
    step : float, optional
        Sample interval [s]; zero: reversals are at samples.
    turns : tuple, optional
        What `reversals` found.
    """
    way, found = reversals(position, velocity) if turns is None else turns
    out = np.full(velocity.size, way)
    before, since = way, position[0]
    for a, b in pairwise([*found, velocity.size]):
        speed = velocity[a]
        # Half of the speed times the share of the step that is left after the velocity was zero.
        turn = position[a] - 0.5 * speed * step * speed / (speed - velocity[a - 1])
        before = way - (way - before) * np.exp(-abs(turn - since) / slide)
        way, since = -way, turn
        out[a:b] = way - (way - before) * np.exp(-np.abs(position[a:b] - turn) / slide)
    return out


class Path:
    """Position and velocity of a whole record in the widest band that its encoder allows.

    Parameters
    ----------
    position, velocity : ndarray, shape (n,)
        Of the axis [m], [m/s].
    step : float
        Sample interval [s].
    least : float, optional
        Way back [m] from which a reversal counts.
    """

    def __init__(self, position: Real, velocity: Real, step: float, least: float = 0.0) -> None:
        self.position, self.velocity, self.step = position, velocity, step
        self._turns = reversals(position, velocity, least)
        self._kept: dict[tuple[float, ...], Real] = {}

    def built(self, speed: float, slide: float, damping: float = 0.0) -> Real:
        """Return what bristles make of ``[1 - exp(-|v|/speed)] sign v`` [1], shape (n,); parameters as `direction`."""
        key = (slide, damping, speed)
        found = self._kept.get(key)
        if found is None:
            ahead, way = self._ahead
            middle = 0.5 * (np.abs(self.velocity[1:]) + np.abs(self.velocity[:-1]))
            kept = np.exp(-ahead / slide)
            # z[k+1] = kept[k] z[k] + (1 - kept[k]) target[k], a bidiagonal system.
            bands = np.stack([np.ones(way.size), np.append(-kept, 0.0)])
            begin = -way[0] * np.expm1(-abs(self.velocity[0]) / speed)
            z = solve_banded((1, 0), bands, np.append(begin, (1.0 - kept) * -np.expm1(-middle / speed) * way[1:]))
            found = self._keep(key, z + damping * np.gradient(z, self.step) if damping else z)
        return found

    @cached_property
    def _ahead(self) -> tuple[Real, Real]:
        """Way made good in each step [m], not counting what the encoder trembles, (n - 1,), and its direction, (n,)."""
        way, found = self._turns
        direction, made = np.full(self.position.size, way), np.zeros(self.position.size)
        for a, b in pairwise([0, *found, self.position.size]):
            direction[a:b] = way
            reached = np.maximum.accumulate(way * (self.position[a:b] - self.position[max(a - 1, 0)]))
            made[a:b] = np.maximum(np.diff(reached, prepend=0.0), 0.0)
            way = -way
        return made[1:], direction

    def _keep(self, key: tuple[float, ...], found: Real) -> Real:
        if len(self._kept) >= _KEPT:
            self._kept.clear()
        self._kept[key] = found
        return found

    def direction(self, slide: float, damping: float = 0.0) -> Real:
        """Return the direction of sliding ``z + damping dz/dt`` [1], shape (n,), of bristles of a length [m], [s]."""
        key = (slide, damping)
        found = self._kept.get(key)
        if found is None:
            z = presliding(self.position, self.velocity, slide, self.step, self._turns)
            found = self._keep(key, z + damping * np.gradient(z, self.step) if damping else z)
        return found
