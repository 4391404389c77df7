"""Milling with any pitch as a linear map over one turn, by integration in time. Shares no code with the packages.

The teeth of a tool, one turn behind the other by any angles, cut what the tooth before left; the machine is a set of
modes that move the tool in x, y and z. The delay equation is integrated over one turn: between two instants each mode
moves exactly as it does without a force, at each instant it takes the impulse of the cutting force over one step
(second order in the step; teeth that enter or leave within a step count in part). A worn flank resists the speed into
the work, half way through that impulse. The multipliers of that map are those
of the cut. SI throughout, tooth angles from +y towards +x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.sparse.linalg import LinearOperator, eigs

PER_PERIOD = 100
"""Steps a period of the fastest mode, at least."""

IN_CUT = 40
"""Steps while a tooth is in its shortest arc, at least."""


@njit(cache=True, nogil=True)
def _turn(factor, first, weight, step_back, flank, gain, shape, advance, depth, state, past):
    """Move state (m, 2) and the motion of the modes over the turn before, (n, m), over one turn."""
    n, m = past.shape
    teeth = first.size
    now = np.zeros((n, m))
    moved, speed, force = np.zeros(3), np.zeros(3), np.zeros(3)
    for i in range(n):
        for r in range(m):
            now[i, r] = state[r, 0]
        force[:] = 0.0
        for j in range(teeth):
            if step_back[j, i] == 0:
                continue
            moved[:] = 0.0
            for r in range(m):
                before = 0.0
                for k in range(4):
                    at = i - first[j] + k
                    before += weight[j, k] * (now[at, r] if at >= 0 else past[at + n, r])
                apart = state[r, 0] - before
                for a in range(3):
                    moved[a] += shape[r, a] * apart
            f = factor[j, i]
            for a in range(3):
                force[a] += f[a, 0] * moved[0] + f[a, 1] * moved[1] + f[a, 2] * moved[2]
        cut = force.copy()
        for share in (0.0, 0.5):
            speed[:] = 0.0
            for r in range(m):
                push = shape[r, 0] * force[0] + shape[r, 1] * force[1] + shape[r, 2] * force[2]
                for a in range(3):
                    speed[a] += shape[r, a] * (state[r, 1] + share * depth * gain[r] * push)
            for a in range(3):
                force[a] = cut[a] + flank[i, a, 0] * speed[0] + flank[i, a, 1] * speed[1] + flank[i, a, 2] * speed[2]
        for r in range(m):
            q = state[r, 0]
            push = shape[r, 0] * force[0] + shape[r, 1] * force[1] + shape[r, 2] * force[2]
            v = state[r, 1] + depth * gain[r] * push
            state[r, 0] = advance[r, 0, 0] * q + advance[r, 0, 1] * v
            state[r, 1] = advance[r, 1, 0] * q + advance[r, 1, 1] * v
    past[:] = now


@dataclass(frozen=True)
class MillingCut:
    """Machine, tool, arcs and material.

    frequency [Hz], damping, stiffness [N/m], direction (modes, 3); pitch [rad] (teeth,): from tooth j to the next that
    follows it; arcs: (entry, exit) [rad]; approach [rad]; k: tangential, radial, axial coefficient [N/m2]; flank: force
    of the worn flank over length of the edge and ratio of speeds [N/m], its friction, and the diameter [m] of the tool;
    twist [rad/m]: how far the edges run behind their tips, a unit of depth.
    """

    frequency: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    direction: np.ndarray
    pitch: np.ndarray
    arcs: tuple[tuple[float, float], ...]
    k: tuple[float, float, float]
    approach: float = 0.5 * math.pi
    flank: tuple[float, float, float] = (0.0, 0.0, 1.0)
    twist: float = 0.0


def _mean_factors(
    cut: MillingCut, k: tuple[float, float, float], lag: np.ndarray, n: int, depth: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Force over displacement and depth of each tooth, averaged over each step, (teeth, n, 3, 3), and where it cuts.

    A helix cuts with slices of the depth, one for every four steps that they run behind, 16 at least.
    """
    behind = cut.twist * depth
    if behind > 0.0:
        slices = max(16, math.ceil(behind * n / (8.0 * math.pi)))
        parts = [_mean_factors(cut, k, lag + behind * (i + 0.5) / slices, n) for i in range(slices)]
        active = np.any([part[1] for part in parts], axis=0).astype(np.int8)
        return sum(part[0] for part in parts) / slices, active
    kt, kr, ka = k
    sin, cos = math.sin(cut.approach), math.cos(cut.approach)
    normal, axial = kr * sin + ka * cos, kr * cos - ka * sin
    force = np.array([[-normal, -kt, 0.0], [kt, -normal, 0.0], [0.0, 0.0, axial]])
    chip = np.diag([1.0, 1.0, -cos / sin])

    def integral(phi):
        s, c, one = np.sin(phi), np.cos(phi), phi
        ss, cc, sc = 0.5 * phi - 0.25 * np.sin(2 * phi), 0.5 * phi + 0.25 * np.sin(2 * phi), 0.5 * s * s
        rows = [[ss, sc, -c], [sc, cc, s], [-c, s, one]]
        return np.moveaxis(np.array(rows), (0, 1), (-2, -1))

    width = 2.0 * math.pi / n
    middle = width * np.arange(n)[None, :] - lag[:, None]
    total = np.zeros((lag.size, n, 3, 3))
    for entry, leave in cut.arcs:
        for whole in range(-2 - math.ceil(float(lag.max()) / (2.0 * math.pi)), 2):
            low = np.clip(middle - 0.5 * width, entry + 2 * math.pi * whole, leave + 2 * math.pi * whole)
            high = np.clip(middle + 0.5 * width, entry + 2 * math.pi * whole, leave + 2 * math.pi * whole)
            total += integral(high) - integral(low)
    active = np.abs(total).max(axis=(2, 3)) > 0.0
    return force @ (total / width) @ chip, active.astype(np.int8)


class TurnMap:
    """The map over one turn at one spindle speed [rpm]; of a helix with edges that reach over a depth [m]."""

    def __init__(self, cut: MillingCut, spindle_speed: float, finer: float = 1.0, reach: float = 0.0) -> None:
        lag = np.concatenate([[0.0], np.cumsum(cut.pitch)[:-1]])
        turn = 60.0 / spindle_speed
        shortest = min(leave - entry for entry, leave in cut.arcs)
        n = math.ceil(
            finer * max(PER_PERIOD * turn * np.max(cut.frequency), IN_CUT * 2.0 * math.pi / shortest, 60 * lag.size)
        )
        h = turn / n
        self.factor, self.active = _mean_factors(cut, cut.k, lag, n, reach)
        resistance, friction, diameter = cut.flank
        against = resistance / (math.pi * diameter / turn)
        self.flank = _mean_factors(cut, (friction * against, against, 0.0), lag, n, reach)[0].sum(axis=0)
        # Tooth j cuts what the tooth ahead of it, j - 1, has left.
        back = np.roll(cut.pitch, 1) / (2.0 * math.pi) * n
        whole = np.floor(back).astype(np.int64)
        self.first = whole + 2
        # Cubic through the instants whole + 2, + 1, 0, - 1 steps ago.
        x = 2.0 - (back - whole)
        at = np.arange(4.0)
        self.weight = np.ones((lag.size, 4))
        for k in range(4):
            for other in range(4):
                if other != k:
                    self.weight[:, k] *= (x - at[other]) / (at[k] - at[other])
        if cut.pitch.size == 1:
            self.first, self.weight = np.array([n]), np.array([[1.0, 0.0, 0.0, 0.0]])
        w, zeta = 2.0 * math.pi * np.asarray(cut.frequency), np.asarray(cut.damping)
        self.gain = h * w**2 / np.asarray(cut.stiffness)
        self.shape = np.asarray(cut.direction, dtype=float)
        wd, e = w * np.sqrt(1.0 - zeta**2), np.exp(-zeta * w * h)
        c, s = np.cos(wd * h), np.sin(wd * h)
        rows = [[c + zeta * w / wd * s, s / wd], [-(w**2) / wd * s, c - zeta * w / wd * s]]
        self.advance = np.ascontiguousarray(np.moveaxis(e * np.array(rows), -1, 0))
        self.n, self.modes, self.scale = n, w.size, w

    def after(self, depth: float, vector: np.ndarray) -> np.ndarray:
        """Return (position and speed of the modes, motion over the last turn) one turn later."""
        m = self.modes
        state = vector[: 2 * m].reshape(m, 2).copy()
        state[:, 1] *= self.scale
        past = vector[2 * m :].reshape(self.n, m).copy()
        cut = self.factor, self.first, self.weight, self.active, self.flank
        _turn(*cut, self.gain, self.shape, self.advance, depth, state, past)
        state[:, 1] /= self.scale
        return np.concatenate([state.ravel(), past.ravel()])

    def multipliers(self, depth: float, count: int = 4) -> np.ndarray:
        """Return the largest multipliers of one turn at an axial depth [m], largest first."""
        size = 2 * self.modes + self.n * self.modes
        start = np.random.default_rng(1).normal(size=size)
        operator = LinearOperator((size, size), matvec=lambda v: self.after(depth, np.asarray(v).ravel()), dtype=float)
        values = eigs(operator, k=count, v0=start, ncv=max(24, 4 * count), tol=1e-7, return_eigenvectors=False)
        return values[np.argsort(-np.abs(values))]

    def radius(self, depth: float) -> float:
        """Return the largest modulus of a multiplier of one turn."""
        return float(np.abs(self.multipliers(depth)[0]))

    def limit(self, low: float, high: float, share: float = 2e-4) -> float:
        """Return a depth [m] between a stable and an unstable one at which the map changes between the two."""
        while high / low > 1.0 + share:
            middle = math.sqrt(low * high)
            low, high = (low, middle) if self.radius(middle) > 1.0 else (middle, high)
        return math.sqrt(low * high)
