"""Converged crossings of one cut, fast enough to be fitted: one mesh for all, and slopes by its eigenvectors.

With few teeth in the cut the mean forces over a turn do not describe it: the limit lies elsewhere, and it may double
the period. Here the limit is that of the delay equation over one period (`stability.methods.semi_discretization`), on
a mesh whose error is far below what a bracket says. At a crossing the operator M of the cut has the eigenvalue 1/depth,
``M x = x/depth`` with the left vector ``y``: to first order a parameter p changes it by ``y^H dM x / y^H x``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy import linalg

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients, ProcessDamping, force_projection
from process.cut.tool import Tool
from process.machine.modes import ModalModel
from process.types import Complex, Real
from smfe.diagnosis.cutting.rules import RULES
from stability.methods import _floquet_kernels as kernels
from stability.methods.dense_problem import Dense, dense
from stability.methods.floquet_crossings import Crossing, angle_grid, find_crossings, real_depths
from stability.methods.period_mesh import Mesh, cut_at_speed, lay_mesh
from stability.problem import Cut, Modes, modes_of, pattern_of_pitch


@dataclass(frozen=True)
class PeriodicCut:
    """One cut of one machine at a spindle speed [rpm], over one period."""

    cut: Cut  # straight edges
    spindle_speed: float
    modes: Modes
    mesh: Mesh
    steps: int  # that were asked of the mesh

    @staticmethod
    def of(machine: ModalModel, cut: Cut, spindle_speed: float) -> PeriodicCut:
        """Lay the mesh of a cut, of as many steps as its fastest mode needs."""
        modes, pattern = modes_of(machine), pattern_of_pitch(cut.tool)
        engaged = sum(arc.arc for arc in cut.arc.arcs)
        turns = float(np.abs(modes.rate.imag).max()) * min(engaged, pattern.period) / (spindle_speed * math.pi / 30.0)
        wanted = RULES.steps_a_radian * turns + RULES.spare_steps
        steps = RULES.even_steps * math.ceil(wanted / RULES.even_steps)
        return PeriodicCut(cut, spindle_speed, modes, _laid(cut, steps), steps)

    def with_machine(self, machine: ModalModel) -> PeriodicCut:
        """Return the same cut of another machine, on the same mesh."""
        return PeriodicCut(self.cut, self.spindle_speed, modes_of(machine), self.mesh, self.steps)

    def with_cut(self, cut: Cut) -> PeriodicCut:
        """Return another cut of the same machine, in as many steps."""
        return PeriodicCut(cut, self.spindle_speed, self.modes, _laid(cut, self.steps), self.steps)

    @cached_property
    def system(self) -> kernels.System:
        """What the kernels know of it."""
        return cut_at_speed(self.mesh, self.modes, self.spindle_speed)

    @cached_property
    def dense(self) -> Dense:
        """The cut as dense matrices."""
        return dense(self.system)

    @cached_property
    def vibrations(self) -> dict[Crossing, Complex]:
        """Chips x of the crossings that Newton's method came to."""
        return {}

    @cached_property
    def period(self) -> float:
        """Time after which the cut repeats [s]."""
        return self.mesh.pattern.duration(self.spindle_speed)

    def crossings(
        self, deepest: float, near: Sequence[Crossing] = (), mean: Callable[[], tuple[Real, Real]] | None = None
    ) -> list[Crossing]:
        """Return the crossings down to a depth [m], the shallowest first; where there is none, the shallowest.

        Those of a cut that is nearly this one are followed by Newton's method, but for the much deeper ones. Where the
        map over one period is unstable below the first, those of the mean forces are, depths [m] and frequencies [Hz];
        then each change of sign over a coarse grid of angles is closed in on likewise, and where that finds no first
        one either the grid is refined until it is safe.
        """
        shallow = [c for c in near if c.depth <= RULES.deepest_followed * near[0].depth]
        followed = [at for c in shallow if (at := self._settled(c.angle, 1.0 / c.depth)) is not None]
        if self._first(found := _apart(followed, math.inf)):
            return found
        if mean is not None:
            followed += self._beside(*mean())
            if self._first(found := _apart(followed, math.inf)):
                return found
        curve = self.dense.crossing_values
        # Of a cut far stiffer than the one that was measured the first is deeper than any that is looked for.
        for count, depths in ((1, (deepest, RULES.far_deeper * deepest)), (RULES.finer, (RULES.far_deeper * deepest,))):
            angles = angle_grid(self.system.turn, count * RULES.angles_of_circle)
            values = curve(angles)
            for depth in depths:
                if self._first(found := self._newton(angles, values, depth)):
                    return found
        return find_crossings(curve, angles)

    def _beside(self, depth: Real, frequency: Real) -> list[Crossing]:
        """Return the crossings that Newton's method comes to from those of the mean forces, the first of them only."""
        near = depth <= RULES.deepest_followed * depth.min(initial=math.inf)
        turned = np.mod(2.0 * math.pi * self.period * frequency[near], 2.0 * math.pi)
        angles = np.minimum(turned, 2.0 * math.pi - turned)
        found = [self._settled(float(angle), 1.0 / float(b)) for angle, b in zip(angles, depth[near], strict=True)]
        return [at for at in found if at is not None]

    def _first(self, found: Sequence[Crossing]) -> bool:
        """Whether the cut is stable below the first of some crossings."""
        return bool(found) and bool(kernels.is_stable(self.dense.period, RULES.surely_below * found[0].depth))

    def _newton(self, angles: Real, values: Complex, deepest: float) -> list[Crossing]:
        found = []
        for angle, at_end in ((0.0, values[0]), (math.pi, values[-1])):
            real = np.where(np.abs(at_end.imag) <= 1e-9 * np.abs(at_end), at_end.real, at_end)
            found += [Crossing(angle, depth) for depth in real_depths(real.astype(complex))]
        least = 0.7 / deepest
        for i in range(angles.size - 1):
            first, last = values[i], values[i + 1]
            first = first[np.abs(first) > least]
            if not first.size or not np.any(np.abs(last) > 0.5 * least):
                continue
            last = last[np.argmin(np.abs(first[:, None] - last), axis=1)]
            for one, other in zip(first, last, strict=True):
                if one.imag * other.imag < 0.0 and max(one.real, other.real) > least:
                    share = one.imag / (one.imag - other.imag)
                    angle, value = angles[i] + share * (angles[i + 1] - angles[i]), one + share * (other - one)
                    if (at := self._settled(float(angle), complex(value))) is not None:
                        found.append(at)
        return _apart(found, deepest)

    def _settled(self, angle: float, value: complex) -> Crossing | None:
        """Return the crossing that Newton's method comes to from an angle and an eigenvalue [1/m]."""
        fixed = angle in (0.0, math.pi)
        vector = self._inverse_iteration(self.dense.crossing(np.array([angle]))[0], value)
        end, value, chips, settled = kernels.approach_crossing(self.dense.period, angle, complex(value), vector, fixed)
        if not settled or not (fixed or 0.0 < end < math.pi):
            return None
        at = Crossing(float(end), 1.0 / value.real)
        self.vibrations[at] = chips
        return at

    @staticmethod
    def _inverse_iteration(matrix: Complex, value: complex, times: int = 2) -> Complex:
        """Return the vector of the eigenvalue of a matrix that is nearest to a value."""
        shifted = matrix.copy()
        shifted[range(matrix.shape[0]), range(matrix.shape[0])] -= value * (1.0 + 1e-10)
        factors, vector = linalg.lu_factor(shifted, check_finite=False), np.exp(1j * np.arange(matrix.shape[0]) ** 2)
        for _ in range(times):
            vector = linalg.lu_solve(factors, vector, check_finite=False)
            vector /= np.linalg.norm(vector)
        return np.ascontiguousarray(vector)

    def chips(self, at: Crossing) -> Complex:
        """Return x at a crossing, shape (m,)."""
        known = self.vibrations.get(at)
        return self.dense.chips(at.angle, at.depth) if known is None else known

    def left(self, at: Crossing) -> Complex:
        """Return y at a crossing, shape (m,)."""
        return self._inverse_iteration(self.dense.crossing(np.array([at.angle]))[0].conj().T, 1.0 / at.depth, 3)

    def applied(self, angle: float, chips: Complex) -> Complex:
        """Return M x."""
        return np.asarray(kernels.apply_crossing(self.system, complex(np.exp(1j * angle)), chips.astype(complex)))

    def observed(self, crossings: Sequence[Crossing], frequency: float) -> tuple[Crossing, float]:
        """Return the crossing that was observed at a frequency [Hz], and its line: signed turns in a period.

        It is near the first in depth, and has a line near the one observed that is among its largest.
        """
        best, least = (crossings[0], 0.0), math.inf
        for at in crossings:
            turns, size = self.lines(at, self.chips(at))
            excess = math.log(at.depth / crossings[0].depth) / RULES.near
            away = (np.abs(turns) / self.period / frequency - 1.0) / RULES.near_observed
            quiet = np.log(size / size.max()) / RULES.loudest
            cost = excess**2 + away**2 + quiet**2
            n = int(np.argmin(cost))
            if cost[n] < least:
                best, least = (at, float(turns[n])), float(cost[n])
        return best

    def slopes(self, at: Crossing, moved: Sequence[PeriodicCut]) -> tuple[Real, Real]:
        """Return changes of 1/depth [1/m] and of the angle [rad] of a crossing in cuts that are a little other ones."""
        x, y = self.chips(at), self.left(at)
        scale = np.vdot(y, x)
        here = self.applied(at.angle, x)
        change = np.array([np.vdot(y, m.applied(at.angle, x) - here) / scale for m in moved])
        if at.kind != "hopf":  # the period stays doubled
            return change.real, np.zeros(change.size)
        step = 1e-6 if at.angle < 0.5 * math.pi else -1e-6
        over = np.vdot(y, self.applied(at.angle + step, x) - here) / scale / step
        angle: Real = np.asarray(-change.imag / over.imag)
        return np.asarray(change.real + over.real * angle), np.asarray(angle)

    def lines(self, at: Crossing, chips: Complex) -> tuple[Real, Real]:
        """Return the signed turns in a period of the lines of a vibration at a crossing, and how far each moves it."""
        change = kernels.chip_change(self.system, complex(np.exp(1j * at.angle)), chips.astype(complex))
        reach = int(np.abs(self.modes.rate.imag).max() * self.period / (2.0 * math.pi)) + 2
        turns = at.angle / (2.0 * math.pi) + np.arange(-reach, reach + 1)
        waves = np.exp(-2j * math.pi * np.outer(turns, self.mesh.angle / self.mesh.pattern.period))
        force = waves @ (self.mesh.force * self.mesh.span * change).T
        moved = (self.modes.matrix(turns / self.period) @ force[:, :, None])[:, :, 0]
        return np.asarray(turns, dtype=float), np.asarray(np.linalg.norm(moved, axis=1), dtype=float)


def _laid(cut: Cut, steps: int) -> Mesh:
    """Return the mesh of a cut with straight edges: of all coefficients the same, but for the forces."""
    mesh = _contacts(cut.tool, cut.arc, cut.worn, steps)
    phi = mesh.angle - mesh.pattern.lag[mesh.tooth]
    basis = np.stack([np.sin(phi), np.cos(phi), np.ones_like(phi)])
    force = force_projection(cut.coefficients.cutting, cut.tool.approach_angle) @ basis
    if cut.worn:
        force[:, mesh.flank] = cut.flank_projection() @ basis[:, mesh.flank]
    return replace(mesh, force=force)


@lru_cache(maxsize=128)
def _contacts(tool: Tool, arc: AnyEngagement, worn: bool, steps: int) -> Mesh:
    """Return a mesh of any forces."""
    cut = Cut(tool, arc, CuttingCoefficients(1.0, 0.0, 0.0), ProcessDamping(1.0 if worn else 0.0))
    return lay_mesh(cut, pattern_of_pitch(tool), steps)


def _apart(found: Sequence[Crossing], deepest: float) -> list[Crossing]:
    """Return crossings down to a depth [m], the shallowest first, each once."""
    kept: list[Crossing] = []
    for at in sorted((c for c in found if c.depth <= deepest), key=lambda c: c.depth):
        if not any(abs(at.angle - c.angle) < 1e-5 and abs(at.depth / c.depth - 1.0) < 1e-5 for c in kept):
            kept.append(at)
    return kept
