"""How a limit of the converged methods moves with the compliance and the work material, by its own crossing.

At a crossing ``M(w) x = x/a``, M being the loop of `stability.methods.multi_frequency` with left and right vectors v
and x, ``v x = 1``. A change of the compliance by ``dPhi(w + q w_P)`` changes the eigenvalue by ``v dM x = sum_q g_q
dPhi(w + q w_P) h_q``, with the force lines h_q of x and what a motion in line q gives to v, g_q. The eigenvalue 1/a is
real, and w moves along so that it remains so::

    d(1/a) = Re[(1 + j r) v dM x],   r = Re(v M' x) / Im(v M' x),   M' = dM/dw

A fold and a period doubling keep their w: r = 0. Lines below zero hold the conjugate of those above. Where edges are
helical, M depends on the depth over which they reach, s = a::

    d(1/a) = Re[(1 + j r) v dM x] / (1 + a^2 Re[(1 + j r) v (dM/ds) x])

Both converged methods have the same crossings, so that one derivative holds for both. Source: first-order perturbation
of eigenvalues, :eq:`eigenvalue-change`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from process.types import Complex, Real
from stability.bands.rules import RULES
from stability.methods.floquet_crossings import Crossing, followed_angle, meet
from stability.methods.multi_frequency import Loops

if TYPE_CHECKING:
    from stability.methods.multi_frequency import _Truncated


@dataclass(frozen=True)
class CriticalCrossing:
    """A depth at which a multiplier lies on the unit circle, and the derivatives of its inverse.

    Parameters
    ----------
    crossing : Crossing
        Angle of the multiplier and depth [m].
    frequency : ndarray, shape (m,)
        Frequencies [Hz], none negative, of the lines that take part.
    gradient : ndarray of complex, shape (m, 3, 3)
        ``d(1/a) = Re sum gradient dPhi`` [N/m2] over lines, responses and excitations.
    common : float
        ``- d ln a`` by the logarithm of a factor on all coefficients: one with straight edges.
    coefficients : ndarray, shape (3,) or (0,)
        ``d(1/a)`` [1/m] by the logarithms of K_tc, K_rc and K_ac, where asked for.
    """

    crossing: Crossing
    frequency: Real
    gradient: Complex
    common: float
    coefficients: Real

    @property
    def inverse(self) -> float:
        """1/a [1/m]."""
        return 1.0 / self.crossing.depth

    def change(self, compliance: Complex) -> Real:
        """Return d(1/a) [1/m] with changes of the compliance [m/N] at the lines, (..., m, 3, 3)."""
        return np.asarray(np.einsum("mrc,...mrc->...", self.gradient, compliance).real)


@dataclass(frozen=True)
class CrossingsAt:
    """The crossings of a machine and a cut at one spindle speed.

    Parameters
    ----------
    loops : Loops
        The machine and the cut.
    spindle_speed : float
        Spindle speed [rpm].
    doubled : tuple of Loops, optional
        The same with K_tc, K_rc, K_ac doubled, one each, where derivatives by them are asked for.
    """

    loops: Loops
    spindle_speed: float
    doubled: tuple[Loops, ...] = ()

    @property
    def _helical(self) -> bool:
        return self.loops.cut.twist > 0.0

    def limiting(self, depth: float, line: float, kind: str, count: int | None = None) -> CriticalCrossing | None:
        """Return the crossing of a limit that is known; None where there is none like it.

        Parameters
        ----------
        depth, line : float
            The limit [m] and a line of its vibration [Hz].
        kind : str
            ``hopf``, ``flip`` or ``fold``.
        count : int, optional
            Harmonics to begin with, those that the limit was had with; by default the fewest.
        """
        count = count or self.loops.fewest(self.spindle_speed)
        while True:
            loop = self.loops.at(self.spindle_speed, count, depth)
            found = loop.approach(followed_angle(kind, line * loop.duration)[0], depth)
            if found is not None and abs(found.crossing.depth / depth - 1.0) <= RULES.alike:
                return self._derived(loop, found.crossing, found.vector)
            if count >= self.loops.most:
                return None
            count = min(self.loops.most, math.ceil(1.5 * count) + 1)

    def competing(self, lowest: CriticalCrossing, deepest: float) -> list[CriticalCrossing]:
        """Return the limit, first, and the crossings beside it up to a depth [m], which may become the lowest.

        With the fewest harmonics and, with a helix, edges that reach as deep as the limit; each is then followed to
        where the edges reach as deep as it lies itself.
        """
        out, count = [lowest], self.loops.fewest(self.spindle_speed)
        reaching = partial(self.loops.at, self.spindle_speed, count)
        for crossing in reaching(lowest.crossing.depth).up_to(deepest):
            at = meet(reaching, crossing) if self._helical else crossing
            loop = reaching(crossing.depth if at is None else at.depth)
            found = None if at is None else loop.approach(at.angle, at.depth)
            if found is not None and not any(_same(found.crossing, c.crossing) for c in out):
                out.append(self._derived(loop, found.crossing, found.vector))
            if len(out) == RULES.crossings:
                break
        return out

    def _derived(self, loop: _Truncated, crossing: Crossing, vector: Complex) -> CriticalCrossing:
        angle, low, depth = crossing.angle, crossing.angle < 0.5 * math.pi, crossing.depth
        matrix = loop.matrices(np.array([angle]), low)[0]
        # Inverse iteration: the matrix is singular but for rounding.
        near = matrix - (1.0 + 1e-9) / depth * np.eye(vector.size)
        right: Complex = vector
        left: Complex = vector.conj()
        for _ in range(2):
            right, left = (np.asarray(np.linalg.solve(m, x)) for m, x in ((near, right), (near.T, left)))
            right, left = right / np.linalg.norm(right), left / np.linalg.norm(left)
        left = left / (left @ right)
        weight = 1.0 + 0.0j
        if crossing.kind == "hopf":
            step = RULES.angle_step * min(angle, math.pi - angle)
            below, above = loop.matrices(np.array([angle - step, angle + step]), low)
            slope = complex(left @ (above - below) @ right)
            weight += 1j * slope.real / slope.imag

        def by(other: _Truncated) -> float:
            change = other.matrices(np.array([angle]), low)[0] - matrix
            return float((weight * (left @ change @ right)).real)

        follows = 1.0
        if self._helical:
            step = RULES.reach_step * depth
            above, below = (by(self.loops.at(self.spindle_speed, loop.count, depth + s)) for s in (step, -step))
            follows += depth**2 * (above - below) / (2.0 * step)
        coefficients = [by(other.at(self.spindle_speed, loop.count, depth)) for other in self.doubled]

        turns = loop.turns(angle, low)
        motion = loop.form.motion_lines(left, loop.lines.factors(turns[None])[0])
        gradient = weight * motion[:, :, None] * loop.form.force_lines(right, turns.size)[:, None, :]
        gradient[turns < 0.0] = gradient[turns < 0.0].conj()
        frequency = np.abs(turns) / loop.duration
        return CriticalCrossing(
            crossing, frequency, gradient / follows, 1.0 / follows, np.array(coefficients) / follows
        )


def _same(one: Crossing, other: Crossing) -> bool:
    return abs(one.angle - other.angle) < RULES.apart and abs(one.depth / other.depth - 1.0) < RULES.apart
