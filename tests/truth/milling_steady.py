"""The periodic vibration of a stable cut, by integration in time from rest. Shares no code with the packages.

Each mode is a spring, a damper and a mass along a direction; straight teeth at any angles behind one another, on one
circle, advance along +x. The chip of a tooth is its distance into the surface that the teeth before it have left, at
its own angle: the advance since the tooth before, and the motion since. Semi-implicit steps, a small share of the
fastest period; tooth angles from +y towards +x, SI throughout.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _run(w, zeta, stiffness, shape, lag, entry, leave, kc, ke, depth, feed, a_turn, turns, rotation):
    """Return the displacement (a_turn, 3) and the force (a_turn, 3) over the last turn."""
    modes, teeth = w.size, lag.size
    h = 2.0 * math.pi / rotation / a_turn
    q, v = np.zeros(modes), np.zeros(modes)
    past = np.zeros((a_turn, 3))
    moved, pushed = np.zeros((a_turn, 3)), np.zeros((a_turn, 3))
    r, f = np.zeros(3), np.zeros(3)
    for i in range(turns * a_turn):
        here = i % a_turn
        for a in range(3):
            r[a] = 0.0
            f[a] = 0.0
            for m in range(modes):
                r[a] += shape[m, a] * q[m]
        for j in range(teeth):
            phi = (2.0 * math.pi * here / a_turn - lag[j]) % (2.0 * math.pi)
            inside = False
            for e in range(entry.size):
                inside |= entry[e] <= phi <= leave[e]
            if not inside:
                continue
            before = lag[j] - lag[j - 1] if j > 0 else lag[0] - lag[teeth - 1] + 2.0 * math.pi
            back = before / (2.0 * math.pi) * a_turn
            steps = math.floor(back)
            part = back - steps
            s, c = math.sin(phi), math.cos(phi)
            chip = feed * back / a_turn * s
            if i >= a_turn:
                for a, n in ((0, s), (1, c)):
                    older = (1.0 - part) * past[(here - steps) % a_turn, a] + part * past[
                        (here - steps - 1) % a_turn, a
                    ]
                    if steps == 0:
                        older = r[a]
                    chip += n * (r[a] - older)
            tangential = depth * (kc[0] * chip + ke[0])
            radial = depth * (kc[1] * chip + ke[1])
            f[0] += -tangential * c - radial * s
            f[1] += tangential * s - radial * c
            f[2] -= depth * (kc[2] * chip + ke[2])
        for a in range(3):
            past[here, a] = r[a]
            moved[here, a] = r[a]
            pushed[here, a] = f[a]
        for m in range(modes):
            push = (shape[m, 0] * f[0] + shape[m, 1] * f[1] + shape[m, 2] * f[2]) * w[m] ** 2 / stiffness[m]
            # Velocity first, with the damping of the mean velocity; then the place: stable, second order in place.
            v[m] = (v[m] * (1.0 - zeta[m] * w[m] * h) + h * (push - w[m] ** 2 * q[m])) / (1.0 + zeta[m] * w[m] * h)
            q[m] += h * v[m]
    return moved, pushed


@dataclass(frozen=True)
class Steady:
    """Motion and force over one turn, by the angle of the tool [rad]: tooth j is `lag[j]` behind it."""

    angle: np.ndarray
    displacement: np.ndarray
    force: np.ndarray
    lag: np.ndarray

    def wall(self, side: str) -> float:
        """Return how far beyond the wall the tooth cuts that cuts furthest [m]."""
        at, sign = (0.0, 1.0) if side == "up" else (math.pi, -1.0)
        y = np.interp(self.lag + at, self.angle, self.displacement[:, 1], period=2.0 * math.pi)
        return float((sign * y).max())


def steady(modes, lag, arcs, kc, ke, depth, feed_per_turn, rpm, turns, a_turn) -> Steady:
    """Integrate so many turns with so many steps each, and return the last.

    `modes` holds (frequency [Hz], damping, stiffness [N/m], direction) of each, `arcs` (entry, exit) [rad], `kc` and
    `ke` the tangential, radial and axial coefficients [N/m2, N/m].
    """
    f, zeta, k, shape = (np.array(column, dtype=float) for column in zip(*modes, strict=True))
    entry, leave = np.array(arcs, dtype=float).T
    rotation = rpm * math.pi / 30.0
    moved, pushed = _run(
        2.0 * math.pi * f, zeta, k, shape, np.asarray(lag, dtype=float), entry, leave, np.asarray(kc, dtype=float),
        np.asarray(ke, dtype=float), depth, feed_per_turn, a_turn, turns, rotation,
    )  # fmt: skip
    return Steady(2.0 * math.pi * np.arange(a_turn) / a_turn, moved, pushed, np.asarray(lag, dtype=float))
