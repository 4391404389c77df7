"""Converged limits of a modal machine: the delay equation over one period, with the shift structure used.

A machine ``q' = A q + B F``, ``r = C q`` cuts with ``F = a_p sum_j P s_j s_j^T Q (r(t) - r(t - T_j))``, ``s_j = (sin
phi_j, cos phi_j, 1)``, over the engaged teeth j, :eq:`delay-equation`. What has to be remembered from pass to pass is
one number for each engaged tooth and node, the chip ``s^T Q r``: not the state over a whole delay.

- The period is cut at every entry and exit, so that all coefficients are smooth within an element; the force is a
  polynomial through Gauss nodes there, and its response an exact exponential: the error falls faster than any power
  of the number of steps, where the classical scheme (Insperger and Stepan 2011) is of first order at entry and exit.
- A pass costs in proportion to the number of steps (elements of few nodes, `period_mesh`); no monodromy matrix is
  built. The multipliers of largest modulus come from Arnoldi's method on the map over one period.
- With ``q(t + T) = mu q(t)`` the force is ``a_p`` times a linear operator M(mu) of the chips: for ``mu = exp(j theta)``
  the real positive eigenvalues of M are 1/depth at *all* changes of stability (`floquet_crossings`). The first one,
  islands and all, is found without a grid over depth; the map itself then confirms it.

A worn flank adds ``a_p sum_j P_d s_j s_j^T Q r'/v_c`` (Ahmadi and Altintas 2011; :eq:`process-damping`). The slope
``s^T Q dr/dphi`` at each engaged tooth and node is then one more scalar, of which nothing is remembered: its force is
proportional to the depth as well, so that 1/depth remains an eigenvalue of M, and all else stays as it is.

Along a helix the edges run behind by ``2 a_p tan(helix)/D``. The force then is that of the displacement itself, with
the directional matrix averaged over the edge in closed form (`process.cut.force.twisted_gram`), smooth between the
entries and exits of both ends; the limit is the depth at which the edges reach as deep as the cut.

Run-out and edge forces do not regenerate and have no influence. With run-out the mean chip differs from tooth to tooth,
and what a vibration adds to it does not: the linear limit is that of equal radii. Only where a tooth that stands back
misses the cut altogether does the next one cut what an earlier one has left, over a longer delay; contact is taken as
given here, and such a cut has another limit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from process.cut.engagement import AnyEngagement
from process.cut.force import NO_DAMPING, CuttingCoefficients, ProcessDamping
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import label
from process.types import Complex, Real
from stability.methods import _floquet_kernels as kernels
from stability.methods.dense_problem import Dense, dense
from stability.methods.floquet_crossings import (
    Crossing,
    Curve,
    Reaches,
    angle_grid,
    find_crossings,
    first_with_helix,
    follow,
    followed_angle,
    helix_crossings,
    relative_change,
)
from stability.methods.period_mesh import Mesh, cut_at_speed, lay_mesh
from stability.methods.rules import RULES
from stability.problem import NO_LOBE, Cut, Machine, Modes, Pattern, check_spindle_speed, modes_of, pattern_of_pitch

Krylov = Callable[[int], tuple[Complex, Complex, int]]

BAND_COLUMNS: tuple[str, ...] = ("from_mm", "to_mm", "stable", "kind", "chatter_frequency_Hz", "multiplier")
"""Columns of `stability_bands`."""


@dataclass(frozen=True)
class LimitDepth:
    """The first loss of stability with growing depth at one spindle speed.

    Parameters
    ----------
    limit_depth_mm : float
        Axial depth [mm]; inf when no multiplier reaches the unit circle at any depth searched.
    limit_depth_error_mm : float
        Change of the limit in the last refinement of the steps [mm]; the true error is far below.
    chatter_frequency_Hz : float
        The strongest line ``f_c + k f_T`` of the displacement at the limit [Hz]; NaN without limit.
    lobe : int
        Whole waves of that line between two teeth; -1 without limit.
    kind : str
        ``hopf``, ``flip`` (period doubling), ``fold``, or ``none``.
    steps : int
        Steps in the cut over one period.
    """

    limit_depth_mm: float
    limit_depth_error_mm: float
    chatter_frequency_Hz: float
    lobe: int
    kind: str
    steps: int


@dataclass(frozen=True)
class _Vibration:
    """A crossing with the chips (m,) of its vibration."""

    crossing: Crossing
    chips: Complex


@dataclass(frozen=True)
class _Discrete:
    """The cut at one spindle speed in so many steps."""

    mesh: Mesh
    system: kernels.System

    @cached_property
    def size(self) -> int:
        """Unknowns: the surface and the state."""
        return int(self.system.source.size + self.system.turn.size)

    @cached_property
    def dense(self) -> Dense:
        """The cut as dense matrices."""
        return dense(self.system)

    @property
    def small(self) -> bool:
        """Whether all eigenvalues are taken."""
        return self.size <= RULES.full_search

    def curve(self, share: float = RULES.large_eigenvalue, deepest: float = math.inf) -> Curve:
        """Return the eigenvalues 1/depth [1/m] over the angle.

        All when the problem is small; else at least those above a share of the largest and those down to 1/deepest.
        """
        if self.small:
            return self.dense.crossing_values
        return lambda angles: [_crossing_values(self.system, float(angle), share, deepest)[0] for angle in angles]

    def multipliers(self, depths: Real) -> list[Complex]:
        """Return the Floquet multipliers of large modulus at depths [m], largest first."""
        if self.small:
            values = list(self.dense.multipliers(depths))
        else:
            values = [_multipliers(self.system, float(depth)) for depth in depths]
        return [v[np.argsort(-np.abs(v))] for v in values]

    def radius(self, depth: float) -> float:
        """Return the largest modulus of a multiplier at a depth [m]."""
        return float(np.abs(self.multipliers(np.array([depth]))[0][0]))

    def stable_at(self, depth: float) -> bool:
        """Whether the map over one period is stable at a depth [m]."""
        if self.size <= RULES.dense:
            return bool(kernels.is_stable(self.dense.period, depth))
        return self.radius(depth) < 1.0

    def crossings(self, deepest: float) -> list[Crossing]:
        """Return all crossings up to a depth [m]."""
        return find_crossings(self.curve(deepest=deepest), angle_grid(self.system.turn, 80), deepest)

    def near(self, crossing: Crossing) -> Crossing | None:
        """Return the crossing near a given one."""
        if self.size <= RULES.dense:
            found = self.approach(crossing.angle, crossing.depth)
            new = None if found is None else found.crossing
        else:
            new = follow(self.curve(deepest=crossing.depth), crossing)
        return new if relative_change(crossing, new) <= RULES.largest_change else None

    def stable_below(self, depth: float) -> bool:
        """Whether the map over one period is stable at the shares `RULES.confirmed_shares` of a depth [m]."""
        return all(self.stable_at(share * depth) for share in RULES.confirmed_shares)

    def approach(self, angle: float, depth: float, chips: Complex | None = None) -> _Vibration | None:
        """Return the crossing near an angle and a depth [m], of chips like those that are given; None: none there."""
        fixed = angle in (0.0, math.pi)
        if chips is None:
            values, vectors = np.linalg.eig(self.dense.crossing(np.array([angle]))[0])
            at = int(np.argmin(np.abs(values - 1.0 / depth)))
            value, chips = complex(values[at]), vectors[:, at]
        else:
            value = 1.0 / depth + 0.0j
        found, value, chips, settled = kernels.approach_crossing(
            self.dense.period, angle, value, np.ascontiguousarray(chips, dtype=complex), fixed
        )
        inside = fixed or RULES.close_to_end < found < math.pi - RULES.close_to_end
        return _Vibration(Crossing(found, 1.0 / value.real), chips) if settled and inside else None

    def between(self, low: float, high: float) -> _Vibration | None:
        """Return a crossing between a depth [m] that is stable and one that is not, from what grows there."""
        for _ in range(RULES.halvings):
            values = np.linalg.eigvals(kernels.period_map(self.dense.period, high))
            largest = values[int(np.argmax(np.abs(values)))]
            angle = abs(float(np.angle(largest)))
            found = self.approach(angle, high)
            if found is not None and low * (1.0 - 1e-9) < found.crossing.depth < high * (1.0 + 1e-9):
                return found
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.stable_at(middle) else (low, middle)
        return None

    def lowest(self, found: _Vibration | None, deepest: float) -> _Vibration | None:
        """Return the first crossing, at a known one or below it, or below a depth [m] where none is known."""
        for _ in range(RULES.halvings):
            end, low = deepest if found is None else found.crossing.depth, 0.0
            for share in RULES.tracked_shares:
                high = share * end
                if not self.stable_at(high):
                    found = self.between(low, high)
                    break
                low = high
            else:
                return found
            if found is None:
                return None
        return None

    def chips(self, crossing: Crossing) -> Complex:
        """Return the chips of the vibration at a crossing, shape (m,)."""
        if self.small:
            return self.dense.chips(crossing.angle, crossing.depth)
        _, basis, small = _crossing_values(self.system, crossing.angle, RULES.large_eigenvalue, crossing.depth)
        values, vectors = np.linalg.eig(small)
        return np.asarray(vectors[:, int(np.argmin(np.abs(values * crossing.depth - 1.0)))] @ basis)


def _crossing_values(
    system: kernels.System, angle: float, share: float, deepest: float
) -> tuple[Complex, Complex, Complex]:
    """Return eigenvalues 1/depth [1/m] when ``exp(j angle)`` is a multiplier, as `_ritz` does."""
    multiplier = complex(math.cos(angle), math.sin(angle)) if angle < math.pi else -1.0 + 0.0j

    def wanted(modulus: Real) -> NDArray[np.bool_]:
        least = share * modulus.max()
        return np.asarray(modulus >= (least if math.isinf(deepest) else min(least, 0.5 / deepest)))

    return _ritz(lambda size: kernels.krylov_crossing(system, multiplier, size), system.source.size, wanted)


def _multipliers(system: kernels.System, depth: float) -> Complex:
    """Return the Floquet multipliers of large modulus of a large problem."""

    def wanted(modulus: Real) -> NDArray[np.bool_]:
        return np.asarray(modulus >= 0.95 * modulus.max())

    total = system.source.size + system.turn.size
    inverses = np.linalg.inv(np.eye(system.gain.shape[1]) - depth * system.gain)
    return _ritz(lambda size: kernels.krylov_period(system, inverses, depth, size), total, wanted)[0]


def _ritz(krylov: Krylov, total: int, wanted: Callable[[Real], NDArray[np.bool_]]) -> tuple[Complex, Complex, Complex]:
    """Return eigenvalues of an operator, all when small, else those wanted, converged; with Arnoldi's basis and matrix.

    A vector v of the small matrix stands for ``v @ basis``.
    """
    size = min(total, RULES.full_search)
    while True:
        basis, hessenberg, reached = krylov(size)
        small = hessenberg[:reached, :reached]
        if reached < size or size == total:
            return np.asarray(np.linalg.eigvals(small), dtype=complex), basis[:reached], small
        values, vectors = np.linalg.eig(small)
        modulus = np.abs(values)
        large = wanted(modulus)
        left = abs(hessenberg[reached, reached - 1]) * np.abs(vectors[-1])
        if np.all(left[large] <= 1e-7 * modulus.max()):
            return values[large], basis[:reached], small
        size = min(total, 2 * size)


@dataclass(frozen=True)
class _Problem:
    """A machine and a cut at one spindle speed [rpm], to be discretised; reach: depth [m] of helical edges."""

    cut: Cut
    pattern: Pattern
    modes: Modes
    spindle_speed: float
    reach: float = 0.0
    kept: dict[tuple[int, float], Mesh] = field(default_factory=dict)

    def first_steps(self) -> int:
        """Steps that resolve the fastest mode over the engaged part of a period."""
        in_cut = float(self.mesh(RULES.fewest_nodes).length.sum())
        turns = float(np.abs(self.modes.rate.imag).max()) * in_cut / (self.spindle_speed * math.pi / 30.0)
        steps = max(6, math.ceil(0.4 * turns + 3.5))
        if 2 * steps > RULES.most_steps:
            raise InputError(
                f"at {self.spindle_speed:g} rpm the fastest mode turns {turns / (2.0 * math.pi):.0f} times in a period "
                f"of the cut: {2 * steps} steps are needed, {RULES.most_steps} are the most. Ask for "
                f"{self.spindle_speed * 2 * steps / RULES.most_steps:.3g} rpm or more, or leave out the fast modes"
            )
        # Few kinds of meshes, so that neighbouring speeds have the same.
        rung = math.ceil(RULES.rungs * math.log2(steps / 6.0) - 1e-9)
        return math.ceil(6.0 * math.pow(2.0, rung / RULES.rungs) - 1e-9)

    def mesh(self, steps: int) -> Mesh:
        """Lay a mesh; it is kept for the next spindle speed."""
        key = steps, self.reach
        if key not in self.kept:
            shape = np.abs(self.modes.shape).max(axis=1)
            self.kept[key] = lay_mesh(self.cut, self.pattern, steps, self.reach, shape > 1e-12 * shape.max())
        return self.kept[key]

    def reaching(self, depth: float) -> _Problem:
        """Return the problem with edges that reach over a depth [m]."""
        return replace(self, reach=depth, kept={})

    def more_steps(self, steps: int, factor: float) -> int:
        """Return what to ask for to have so many times the steps: many short elements have more than were asked for."""
        # With a helix the elements depend on the depth; at this one no two events coincide.
        at = self.reaching(0.37 * self.cut.helix_pitch) if self.cut.twist > 0.0 else self
        wanted = factor * at.mesh(steps).steps
        steps = math.ceil(factor * steps)
        while at.mesh(steps).steps < wanted:
            steps = math.ceil(1.2 * steps)
        return steps

    def twisted(self, steps: int) -> Reaches:
        """Return the cut with so many steps, by the depth over which its edges reach."""

        @lru_cache(maxsize=4)
        def at(depth: float) -> _Discrete:
            return self.reaching(depth).discrete(steps)

        return at

    def finer(self, mesh: Mesh, factor: float = RULES.finer) -> _Discrete:
        """Return the cut in at least so many times the steps of a mesh."""
        steps = math.ceil(factor * mesh.steps)
        while self.mesh(steps).steps < factor * mesh.steps:
            steps = math.ceil(1.2 * steps)
        return self.discrete(steps)

    def discrete(self, steps: int) -> _Discrete:
        """Return the cut with so many steps."""
        mesh = self.mesh(steps)
        return _Discrete(mesh, cut_at_speed(mesh, self.modes, self.spindle_speed))


def _first_loss(discrete: _Discrete) -> Crossing | None:
    """Return the first crossing, confirmed by the map over one period: stable at shares of its depth."""
    for harder in range(3):
        found = _lowest(discrete, harder)
        if found is not None:
            deepest = found.depth
        else:
            sizes = discrete.curve()(angle_grid(discrete.system.turn, 4))
            deepest = 1.0 / (RULES.negligible_eigenvalue * max(float(np.abs(part).max()) for part in sizes))
        if discrete.stable_below(deepest):
            return found
    raise InputError(
        f"the first loss of stability is not found: the cut is unstable below {deepest * 1e3:.4g} mm already, and no "
        "multiplier was seen to cross the unit circle there. Move the spindle speed by 0.1 %"
    )


def _lowest(discrete: _Discrete, harder: int = 0) -> Crossing | None:
    """Return the first crossing that a search of some hardness finds; none only where small eigenvalues have none."""
    angles = angle_grid(discrete.system.turn, 26 * 4**harder)
    found = find_crossings(discrete.curve(RULES.large_eigenvalue / 10**harder), angles)
    if not found and not discrete.small:
        found = find_crossings(discrete.curve(RULES.negligible_eigenvalue), angles)
    return next(iter(found), None)


def _limit_with_helix(problem: _Problem, tolerance: float) -> LimitDepth:
    """Return the first loss of stability of a cut with a helix."""
    first = problem.first_steps()
    steps = [first]

    def finer(level: int) -> Reaches | None:
        if level == len(steps):
            steps.append(problem.more_steps(steps[-1], RULES.finer))
        return problem.twisted(steps[level]) if steps[level] < RULES.most_steps else None

    straight = replace(problem, kept={}).discrete(first)
    sizes = straight.curve()(angle_grid(straight.system.turn, 4))
    deepest = 1.0 / (RULES.negligible_eigenvalue * max(float(np.abs(part).max()) for part in sizes))
    near = _lowest(straight)
    limit = math.inf if near is None else near.depth
    found, change, level = first_with_helix(finer, problem.cut.helix_pitch, deepest, limit, tolerance)
    if found is None:
        error = 0.0 if change == 0.0 else math.inf
        return LimitDepth(math.inf, error, math.nan, NO_LOBE, "none", steps[level])
    here = problem.reaching(found.depth)
    discrete = here.discrete(steps[level])
    return _known(here, discrete, _Vibration(found, discrete.chips(found).astype(complex)), change, {}).limit


def _limit(problem: _Problem, tolerance: float) -> _Known:
    """Refine until the first loss moves by less than the tolerance; each result but the coarsest is confirmed."""
    discrete, change = problem.discrete(problem.first_steps()), math.inf
    old = _lowest(discrete)
    while change > tolerance and discrete.mesh.steps < RULES.most_steps:
        discrete = problem.finer(discrete.mesh)
        new = follow(discrete.curve(deepest=old.depth), old) if old is not None else None
        if new is None or not discrete.stable_below(new.depth):
            new = _first_loss(discrete)
        change = relative_change(old, new)
        old = new
    if old is None:
        error = 0.0 if change == 0.0 else math.inf
        none = LimitDepth(math.inf, error, math.nan, NO_LOBE, "none", discrete.mesh.steps)
        return _Known(none, problem.spindle_speed, math.nan, {})
    chips = discrete.chips(old).astype(complex)
    return _known(problem, discrete, _Vibration(old, chips), change, {discrete.mesh.steps: chips})


@dataclass(frozen=True)
class _Known:
    """A limit that a neighbouring spindle speed [rpm] begins with: its line, and its chips by the steps of meshes."""

    limit: LimitDepth
    spindle_speed: float
    turns: float  # of the strongest line in a period, signed: how far the multiplier has gone round
    chips: dict[int, Complex]
    steps: int = 0  # from which the next speed may begin to refine


def _tracked(problem: _Problem, before: _Known, tolerance: float) -> _Known | None:
    """Return the limit at a speed from that at a neighbouring one; None where it has to be searched for.

    The crossing is followed by Newton's method on the finest mesh, and whether anything below it is unstable is seen
    by the map over one period at the shares `RULES.tracked_shares`: what grows there leads to the crossing below.
    """
    coarse = problem.discrete(max(problem.first_steps(), before.steps))
    fine = problem.finer(coarse.mesh, RULES.finer_tracked)
    if fine.size > RULES.dense or not math.isfinite(before.limit.limit_depth_mm):
        return None
    angle, turned = followed_angle(before.limit.kind, before.turns * before.spindle_speed / problem.spindle_speed)
    depth = 1e-3 * before.limit.limit_depth_mm

    def near(discrete: _Discrete, angle: float, depth: float) -> _Vibration | None:
        chips = before.chips.get(discrete.mesh.steps)
        found = None
        if chips is not None and chips.size == discrete.system.source.size:
            found = discrete.approach(angle, depth, chips.conj() if turned else chips)
        return found or discrete.approach(angle, depth)

    at, deepest = near(fine, angle, depth), depth
    for _ in range(RULES.beyond_steps):
        deepest *= RULES.beyond_tracked
        if (at := fine.lowest(at, deepest)) is not None:
            break
    else:
        return None
    chips = {fine.mesh.steps: at.chips}
    old = near(coarse, at.crossing.angle, at.crossing.depth)
    if old is not None:
        chips[coarse.mesh.steps] = old.chips
    change = relative_change(None if old is None else old.crossing, at.crossing)
    while change > tolerance:
        finer = problem.finer(fine.mesh, RULES.finer_tracked)
        if finer.size > RULES.dense:
            return None
        new = near(finer, at.crossing.angle, at.crossing.depth)
        if new is None or not finer.stable_at(RULES.confirmed_shares[-1] * new.crossing.depth):
            new = finer.lowest(new, RULES.beyond_tracked * at.crossing.depth)
        if new is None:
            return None
        change, coarse, fine, at = relative_change(at.crossing, new.crossing), fine, finer, new
        chips[fine.mesh.steps] = at.chips
    steps = coarse.mesh.steps
    if change < RULES.needless * tolerance:
        steps = math.floor(steps / RULES.finer_tracked)
    return _known(problem, fine, at, change, chips, steps)


def _known(
    problem: _Problem, discrete: _Discrete, at: _Vibration, change: float, chips: dict[int, Complex], begin: int = 0
) -> _Known:
    turns, line, lobe = _strongest_line(problem, discrete, at.crossing, at.chips)
    steps, depth = discrete.mesh.steps, at.crossing.depth
    limit = LimitDepth(1e3 * depth, 1e3 * change * depth, line, lobe, at.crossing.kind, steps)
    return _Known(limit, problem.spindle_speed, turns, chips, begin)


def _strongest_line(
    problem: _Problem, discrete: _Discrete, crossing: Crossing, chips: Complex
) -> tuple[float, float, int]:
    """Return the turns in a period of the largest displacement among ``f_c + k/T``, its frequency [Hz], its lobe."""
    mesh, period = discrete.mesh, problem.pattern.duration(problem.spindle_speed)
    change = kernels.chip_change(discrete.system, complex(np.exp(1j * crossing.angle)), chips)
    reach = int(np.abs(problem.modes.rate.imag).max() * period / (2.0 * math.pi)) + 2
    turns = crossing.angle / (2.0 * math.pi) + np.arange(-reach, reach + 1)
    waves = np.exp(-2j * math.pi * np.outer(turns, mesh.angle / mesh.pattern.period))
    lines = waves @ (mesh.force * mesh.span * change).T
    moved = (problem.modes.matrix(turns / period) @ lines[:, :, None])[:, :, 0]
    strongest = float(turns[int(np.argmax(np.linalg.norm(moved, axis=1)))])
    return strongest, abs(strongest) / period, mesh.pattern.lobe(abs(strongest))


def _problem(machine: Machine, cut: Cut, spindle_speed: float) -> _Problem:
    """Check that the cut can move the machine, and put the two together."""
    problem = _Problem(cut, pattern_of_pitch(cut.tool), modes_of(machine), spindle_speed)
    mesh, modes = problem.mesh(RULES.fewest_nodes), problem.modes
    felt = np.abs(mesh.chip @ modes.shape).max() > 1e-12 * np.abs(modes.shape).max()
    largest = np.abs(modes.participation).max() * np.abs(mesh.force).max()
    moved = np.abs(modes.participation @ mesh.force).max() > 1e-12 * largest
    if not (felt and moved):
        raise InputError("the machine does not move where the cut acts; there is nothing that could chatter")
    jump = np.abs(modes.shape @ modes.participation).max()
    if cut.worn and jump > 1e-6 * (np.abs(modes.shape) @ np.abs(modes.participation)).max():
        raise InputError(
            "the velocity of the tool jumps with the force: the machine has no mass at the tool, and a worn flank no "
            "speed to resist. Give the tool its mass, or leave process_damping out"
        )
    return problem


def limit_depth(
    machine: Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: float,
    tolerance: float = 1e-3,
    process_damping: ProcessDamping = NO_DAMPING,
) -> LimitDepth:
    """Return the first loss of stability with growing depth at one spindle speed.

    Parameters
    ----------
    machine : Machine
        Anything with a ``state_space()``: a `process.ModalModel`, a closed loop.
    tool, arc, coefficients
        The cut; any pitch and helix.
    spindle_speed : float
        Spindle speed [rpm].
    tolerance : float, optional
        Relative change of the limit at which the refinement of the steps ends.
    process_damping : ProcessDamping, optional
        Of the worn flank; a sharp edge by default.

    Raises
    ------
    InputError
        For a machine that is itself unstable, or a speed that is not positive or too low for the most steps.
    """
    speed = float(check_spindle_speed(spindle_speed)[0])
    problem = _problem(machine, Cut(tool, arc, coefficients, process_damping), speed)
    if problem.cut.twist > 0.0:
        return _limit_with_helix(problem, _checked(tolerance))
    return _limit(problem, _checked(tolerance)).limit


def floquet_multipliers(
    machine: Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    depth: float,
    spindle_speed: float,
    steps: int | None = None,
    process_damping: ProcessDamping = NO_DAMPING,
) -> Complex:
    """Return the Floquet multipliers of largest modulus over one period of the cut, largest first.

    The period is that of the tooth passing for equal pitch, else that after which the pattern of pitches repeats. The
    cut is stable when the first has a modulus below one.

    Parameters
    ----------
    machine, tool, arc, coefficients
        As `limit_depth`.
    depth : float
        Axial depth [m].
    spindle_speed : float
        Spindle speed [rpm].
    steps : int, optional
        Least number of steps in the cut over one period; by default twice what resolves the fastest mode.
    process_damping : ProcessDamping, optional
        Of the worn flank; a sharp edge by default.

    Returns
    -------
    ndarray of complex
        All multipliers of a small problem; of a large one those within 5 % of the largest modulus.

    Raises
    ------
    InputError
        As `limit_depth`, or for a depth or a number of steps that is not positive.
    """
    speed = float(check_spindle_speed(spindle_speed)[0])
    if not (math.isfinite(depth) and depth > 0.0) or (steps is not None and steps < 1):
        raise InputError(f"depth {depth:g} m, steps {steps}; both must be positive")
    problem = _problem(machine, Cut(tool, arc, coefficients, process_damping), speed).reaching(depth)
    steps = steps or 2 * problem.mesh(problem.first_steps()).steps
    return problem.discrete(steps).multipliers(np.array([depth]))[0]


def stability_bands(
    machine: Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: float,
    maximum_depth: float,
    tolerance: float = 1e-3,
    process_damping: ProcessDamping = NO_DAMPING,
) -> pd.DataFrame:
    """Return all stable and unstable bands of depth at one spindle speed, islands included.

    Parameters
    ----------
    machine, tool, arc, coefficients, spindle_speed
        As `limit_depth`.
    maximum_depth : float
        Axial depth [m] at which the last band ends.
    tolerance : float, optional
        Relative change of every border at which the refinement of the steps ends.
    process_damping : ProcessDamping, optional
        Of the worn flank; a sharp edge by default.

    Returns
    -------
    pandas.DataFrame
        Columns `BAND_COLUMNS`, one row a band from zero up. ``kind`` and ``chatter_frequency_Hz`` belong to the lower
        border; ``multiplier`` is the largest modulus in the middle of the band.

    Raises
    ------
    InputError
        As `limit_depth`, for a maximum depth that is not positive, and when the borders do not settle.
    """
    speed = float(check_spindle_speed(spindle_speed)[0])
    if not (math.isfinite(maximum_depth) and maximum_depth > 0.0):
        raise InputError(f"the maximum depth is {maximum_depth:g} m; it must be positive and finite")
    problem = _problem(machine, Cut(tool, arc, coefficients, process_damping), speed)
    steps, tolerance = problem.first_steps(), _checked(tolerance)
    old = _all_crossings(problem, steps, maximum_depth)
    while steps < RULES.most_steps:
        steps = problem.more_steps(steps, RULES.finer)
        new = _all_crossings(problem, steps, maximum_depth)
        if len(new) == len(old) and all(relative_change(a, b) <= tolerance for a, b in zip(old, new, strict=True)):
            return _bands(problem, steps, new, maximum_depth)
        old = new
    raise InputError(
        f"the bands up to {maximum_depth * 1e3:g} mm do not settle with {RULES.most_steps} steps; ask for a "
        "smaller depth or a coarser tolerance"
    )


def _all_crossings(problem: _Problem, steps: int, deepest: float) -> list[Crossing]:
    if problem.cut.twist > 0.0:
        return list(helix_crossings(problem.twisted(steps), problem.cut.helix_pitch, deepest))
    return problem.discrete(steps).crossings(deepest)


def _bands(problem: _Problem, steps: int, crossings: list[Crossing], deepest: float) -> pd.DataFrame:
    """Classify the intervals between crossings by the map over one period; join those of one kind."""
    straight = problem.discrete(steps)

    def at_depth(depth: float) -> tuple[_Problem, _Discrete]:
        here = problem.reaching(depth)
        return (here, here.discrete(steps)) if problem.cut.twist > 0.0 else (problem, straight)

    borders = [0.0, *(c.depth for c in crossings), deepest]
    rows: list[list[Any]] = []
    for i, (low, high) in enumerate(pairwise(borders)):
        if high - low <= 1e-9 * high:
            continue
        middle = 0.5 * (low + high)
        radius = at_depth(middle)[1].radius(middle)
        if rows and rows[-1][2] == (radius < 1.0):
            rows[-1][1] = 1e3 * high
            rows[-1][5] = max(rows[-1][5], radius)
            continue
        kind, line = "none", math.nan
        if i > 0:
            at = crossings[i - 1]
            here, discrete = at_depth(at.depth)
            kind, line = at.kind, _strongest_line(here, discrete, at, discrete.chips(at).astype(complex))[1]
        rows.append([1e3 * low, 1e3 * high, radius < 1.0, kind, line, radius])
    return pd.DataFrame(rows, columns=list(BAND_COLUMNS))


def semi_discretization(
    machine: Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: ArrayLike,
    tolerance: float = 1e-3,
    process_damping: ProcessDamping = NO_DAMPING,
) -> xr.Dataset:
    """Return the converged limit depth at given spindle speeds: the first loss of stability with growing depth.

    Parameters
    ----------
    machine, tool, arc, coefficients, tolerance, process_damping
        As `limit_depth`.
    spindle_speed : array_like, shape (speeds,)
        Spindle speeds [rpm], in any order.

    Returns
    -------
    xarray.Dataset
        ``limit_depth`` [mm], ``limit_depth_error`` [mm], ``chatter_frequency`` [Hz], ``lobe``, ``kind`` and ``steps``
        over ``spindle_speed``, as the fields of `LimitDepth`. ``attrs["warnings"]`` lists what the user must know.

    Raises
    ------
    InputError
        As `limit_depth`.
    """
    speed = check_spindle_speed(spindle_speed)
    problem = _problem(machine, Cut(tool, arc, coefficients, process_damping), float(speed[0]))
    tolerance = _checked(tolerance)
    replace(problem, spindle_speed=float(speed.min())).first_steps()
    limits: list[LimitDepth] = [None] * speed.size  # type: ignore[list-item]
    known = None
    for i in np.argsort(-speed, kind="stable"):
        here = replace(problem, spindle_speed=float(speed[i]))
        if problem.cut.twist > 0.0:
            limits[i] = _limit_with_helix(here, tolerance)
            continue
        known = (_tracked(here, known, tolerance) if known else None) or _limit(here, tolerance)
        limits[i] = known.limit
    warnings = list(problem.cut.warnings)
    loose = sum(limit.limit_depth_error_mm > tolerance * limit.limit_depth_mm for limit in limits)
    if loose:
        warnings.append(
            f"{loose} of {speed.size} limits still move by more than {tolerance:g} of themselves with "
            f"{RULES.most_steps} steps: see limit_depth_error"
        )
    return labelled_limits("semi_discretization", speed, limits, "steps", warnings)


def labelled_limits(
    method: str, speed: Real, limits: Sequence[LimitDepth], effort: str, warnings: Sequence[str]
) -> xr.Dataset:
    """Put names and units on limits over speed; `effort` names what `LimitDepth.steps` counts."""

    def over(name: str) -> tuple[str, list[Any]]:
        return "spindle_speed", [getattr(limit, name) for limit in limits]

    data = {
        "limit_depth": over("limit_depth_mm"),
        "limit_depth_error": over("limit_depth_error_mm"),
        "chatter_frequency": over("chatter_frequency_Hz"),
        "lobe": over("lobe"),
        "kind": over("kind"),
        effort: over("steps"),
    }
    unlimited = sum(math.isinf(limit.limit_depth_mm) for limit in limits)
    notes = list(warnings)
    if unlimited:
        notes.append(f"{unlimited} of {speed.size} spindle speeds have no limit: stable at any depth of use")
    attrs = {"method": method, "warnings": notes}
    out = label(xr.Dataset(data, coords={"spindle_speed": speed}, attrs=attrs))
    out["lobe"].attrs["none"] = NO_LOBE
    out["limit_depth_error"].attrs["units"] = out["limit_depth"].attrs["units"]
    return out


def _checked(tolerance: float) -> float:
    if not 0.0 < tolerance < 1.0:
        raise InputError(f"the tolerance is {tolerance:g}; a share of the limit between 0 and 1 is needed, e.g. 1e-3")
    return tolerance
