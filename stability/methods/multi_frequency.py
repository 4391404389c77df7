"""Multi-frequency limits: the harmonics of the directional matrix kept, on a measured compliance or a modal machine.

At the limit the tool moves at all ``w + q w_P``, w_P being the frequency at which the cut repeats (that of the tooth
passing for equal pitch). With the force lines F_q and the harmonics A_r of the directional matrix of tooth j::

    F_p = a_p sum_q sum_j A_{p-q}^j (1 - exp(-j (w + q w_P) T_j)) Phi(w + q w_P) F_q

so that 1/a_p is a real eigenvalue of a block matrix. Process damping by a worn flank adds ``j (w + q w_P) sum_j
D_{p-q}^j/v_c`` to ``sum_j A_{p-q}^j (1 - exp ...)``, D being the directional matrix of the flank: it is proportional to
the depth, too, and has no delay (Ahmadi and Altintas 2011; :eq:`process-damping`).

w is scanned over [0, w_P/2]. A real motion holds with every line its conjugate: q = -R .. R below w_P/4 and q = -R .. R
- 1 above make the set of lines closed under conjugation at 0 and at w_P/2. There the matrix is similar to a real one,
and its real eigenvalues are folds (multiplier +1) and period doublings (-1) exactly. A fold needs unequal pitch: with
equal pitch a motion that repeats leaves no wave.

Along a helix the edges run behind by ``t = 2 a_p tan(helix)/D``: the harmonic k of a turn is multiplied by
``sin(k t/2)/(k t/2)``, and the depth is asked at which the edges reach as deep as the cut
(`floquet_crossings.helix_crossings`).

Harmonics are added, twice as many and more each time, until the limit stands still; a set with which it does not is
scanned over the whole range of w again. Nyquist's criterion then confirms that the cut is stable just below the limit.
Source: Budak and Altintas 1998; Merdol and Altintas 2004; :eq:`multi-frequency`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import find_peaks

from process.cut.engagement import AnyEngagement
from process.cut.force import (
    NO_DAMPING,
    CuttingCoefficients,
    ProcessDamping,
    chip_projection,
    force_projection,
    gram_matrix,
)
from process.cut.tool import Tool
from process.errors import InputError
from process.types import Complex, Real
from stability.methods import _floquet_kernels as kernels
from stability.methods.floquet_crossings import (
    Crossing,
    Reaches,
    angle_grid,
    approach,
    find_crossings,
    first_with_helix,
    follow,
    followed_angle,
    is_unstable,
    real_depths,
    relative_change,
)
from stability.methods.rules import RULES
from stability.methods.semi_discretization import LimitDepth, labelled_limits
from stability.problem import (
    NO_LOBE,
    Cut,
    Machine,
    Modes,
    Pattern,
    Samples,
    check_spindle_speed,
    complete_samples,
    edge_warnings,
    modes_of,
    pattern_of_pitch,
)


@dataclass(frozen=True)
class _Response:
    """A compliance that can be asked at any frequency.

    Parameters
    ----------
    at : callable
        Frequencies [Hz], shape (f,), of either sign -> compliance [m/N], shape (f, 3, 3).
    resonance : ndarray of complex
        Poles [1/s] about which the scan is fine.
    highest : float
        Frequency [Hz] that the harmonics should reach at least.
    warnings : tuple of str
        What the user must know about the data.
    lines : ndarray, optional
        Frequencies [Hz] of measured samples, between which the compliance bends; none of modes.
    modes : Modes, optional
        Of which the compliance is.
    """

    at: Callable[[Real], Complex]
    resonance: Complex
    highest: float
    warnings: tuple[str, ...]
    lines: Real | None = None
    modes: Modes | None = None

    def between(self, frequency: Real, felt: NDArray[np.bool_], moved: NDArray[np.bool_]) -> Complex:
        """Return the compliance of some directions of motion to some of force [m/N], (f, felt, moved)."""
        if self.modes is None:
            return np.ascontiguousarray(self.at(frequency)[:, felt][:, :, moved])
        gain = 1.0 / (2j * math.pi * frequency[:, None] - self.modes.rate)
        product = self.modes.shape[felt].T[:, :, None] * self.modes.participation[:, moved][:, None]
        return np.asarray((gain @ product.reshape(gain.shape[1], -1)).reshape(-1, *product.shape[1:]))

    def step(self, frequency: Real) -> Real:
        """Return the spacing [Hz] of the samples about frequencies [Hz] of either sign; inf where there are none."""
        if self.lines is None:
            return np.full(frequency.shape, math.inf)
        place = np.searchsorted(self.lines, np.abs(frequency))
        return np.concatenate([[math.inf], np.diff(self.lines), [math.inf]])[place]


def multi_frequency(
    compliance: xr.Dataset | Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: ArrayLike,
    tolerance: float = 2e-3,
    process_damping: ProcessDamping = NO_DAMPING,
) -> xr.Dataset:
    """Return the multi-frequency limit depth at given spindle speeds: the first loss of stability with growing depth.

    Parameters
    ----------
    compliance : xarray.Dataset or Machine
        One labelled compliance [m/N] on its own grid, or anything with a ``state_space()``. Between measured samples
        each entry is a cubic, across a gap a straight line; below the first sample it keeps the real part, above the
        last it is zero.
    tool, arc, coefficients
        The cut; any pitch and helix.
    spindle_speed : array_like, shape (speeds,)
        Spindle speeds [rpm], in any order.
    tolerance : float, optional
        Relative change of the limit at which no more harmonics are added.
    process_damping : ProcessDamping, optional
        Of the worn flank; a sharp edge by default.

    Returns
    -------
    xarray.Dataset
        ``limit_depth`` [mm], ``limit_depth_error`` [mm] (its last change), ``chatter_frequency`` [Hz] (the strongest
        line of the displacement), ``lobe`` (its whole waves between two teeth), ``kind`` (``hopf``, ``flip``, ``fold``
        or ``none``) and ``harmonics`` (R: 2 R lines) over ``spindle_speed``. ``attrs["warnings"]`` lists what the user
        must know.

    Raises
    ------
    InputError
        For an unusable compliance or machine, speeds that are not positive, or so low that the harmonics do
        not reach the modes.
    """
    speed = check_spindle_speed(spindle_speed)
    if not 0.0 < tolerance < 1.0:
        raise InputError(f"the tolerance is {tolerance:g}; a share of the limit between 0 and 1 is needed, e.g. 1e-3")
    response = _measured(compliance) if isinstance(compliance, xr.Dataset) else _modal(compliance)
    cut = Cut(tool, arc, coefficients, process_damping)
    lines = _lines_of(response, cut)
    _require_reach(response, lines, float(speed.min()))
    if cut.twist > 0.0:
        limits = [_limit_with_helix(response, lines, float(n), tolerance) for n in speed]
    elif isinstance(compliance, xr.Dataset):
        # Noise of a record makes crossings that come and go from line to line: each speed is scanned line by line.
        limits = [_limit_of_record(response, lines, float(n), tolerance) for n in speed]
    else:
        limits = _all(response, lines, speed, tolerance)
    warnings = [*cut.warnings, *response.warnings]
    loose = sum(limit.limit_depth_error_mm > tolerance * limit.limit_depth_mm for limit in limits)
    if loose:
        warnings.append(
            f"{loose} of {speed.size} limits still move by more than {tolerance:g} of themselves with {lines.most} "
            "harmonics, or are not confirmed: see limit_depth_error"
        )
    return labelled_limits("multi_frequency", speed, limits, "harmonics", warnings)


def _lines_of(response: _Response, cut: Cut) -> _Lines:
    size = np.abs(response.at(np.linspace(0.0, response.highest, 9))).max(axis=0)
    return _Lines(cut, pattern_of_pitch(cut.tool), size.max(axis=0) > 0.0, size.max(axis=1) > 0.0)


def _require_reach(response: _Response, lines: _Lines, slowest: float) -> None:
    """Raise `InputError` when the harmonics that may be taken end below the highest mode."""
    duration = lines.pattern.duration(slowest)
    needed = response.highest * duration + 1.0
    if needed > lines.most:
        possible = slowest * response.highest * duration / (lines.most - 1.0)
        raise InputError(
            f"at {slowest:g} rpm it takes {needed:.0f} harmonics of the {1.0 / duration:.4g} Hz at which the cut "
            f"repeats to reach the mode at {response.highest:.4g} Hz; {lines.most} are the most. Ask for "
            f"{possible:.3g} rpm or more, or use the semi-discretisation"
        )


def _modal(machine: Machine) -> _Response:
    modes = modes_of(machine)
    highest = float(np.abs(modes.rate.imag).max()) / (2.0 * math.pi)
    return _Response(modes.matrix, modes.rate, highest, (), modes=modes)


def _measured(compliance: xr.Dataset) -> _Response:
    """Interpolate measured samples; their peaks stand for the poles."""
    samples = complete_samples(compliance)
    f = samples.frequency
    size = np.linalg.norm(samples.matrix, axis=(1, 2))
    peaks = find_peaks(size, prominence=0.1 * size.max())[0]
    width = _half_width(f, size, peaks)
    poles = np.asarray(2.0 * math.pi * (1j * f[peaks] - width), dtype=complex)
    warnings = (
        *samples.warnings,
        *edge_warnings(samples),
        f"harmonics above {f[-1]:.6g} Hz find no compliance, those below {f[0]:.6g} Hz the real part at {f[0]:.6g} Hz",
    )
    top = float(f[peaks].max()) if peaks.size else float(f[-1])
    return _Response(_interpolant(samples), poles, top, warnings, f)


def _half_width(f: Real, size: Real, peaks: NDArray[np.int64]) -> Real:
    """Half the half-power width of peaks [Hz], at least a step of the grid."""
    out = np.empty(peaks.size)
    for i, k in enumerate(peaks):
        low = np.flatnonzero(size[:k] < size[k] / math.sqrt(2.0))
        high = np.flatnonzero(size[k:] < size[k] / math.sqrt(2.0))
        left = f[k] - f[low[-1]] if low.size else math.inf
        right = f[k + high[0]] - f[k] if high.size else math.inf
        out[i] = min(left, right, 0.1 * f[k])
    return out


def _interpolant(samples: Samples) -> Callable[[Real], Complex]:
    """Return the compliance at any frequency: a cubic within each unbroken run of samples."""
    f, matrix = samples.frequency, samples.matrix
    breaks = np.flatnonzero(~samples.bridged) + 1
    runs = [(f[part], matrix[part]) for part in np.split(np.arange(f.size), breaks)]
    splines = [CubicSpline(x, y, axis=0) if x.size > 3 else None for x, y in runs]
    flat = matrix.reshape(f.size, 9)

    def at(frequency: Real) -> Complex:
        x = np.abs(np.asarray(frequency, dtype=float))
        out = np.stack([np.interp(x, f, column) for column in flat.T], axis=-1).reshape(-1, 3, 3)
        for (run, _), spline in zip(runs, splines, strict=True):
            inside = (x >= run[0]) & (x <= run[-1])
            if spline is not None and inside.any():
                out[inside] = spline(x[inside])
        out[x < f[0]] = matrix[0].real
        out[x > f[-1]] = 0.0
        return np.where((np.asarray(frequency) < 0.0)[:, None, None], out.conj(), out)

    return at


class _Lines:
    """The harmonics of the directional matrix of a cut, computed once for all speeds.

    moved, felt: directions of a force that moves anything, and of a motion that there can be, (3,). behind: angle [rad]
    by which the upper ends of helical edges run behind their tips. Averaged over the edge each harmonic r of a turn is
    multiplied by ``sin(r behind/2)/(r behind/2)``; that all of them lag by half of it besides changes no eigenvalue.
    """

    def __init__(
        self, cut: Cut, pattern: Pattern, moved: NDArray[np.bool_], felt: NDArray[np.bool_], behind: float = 0.0
    ) -> None:
        self.pattern, self.behind = pattern, behind
        self.moved, self.felt = moved, felt
        self.teeth = pattern.lag.size // pattern.repeats
        self._cut = cut
        self._arc = cut.arc
        self._force = force_projection(cut.coefficients.cutting, cut.tool.approach_angle)
        self._flank = cut.flank_projection() if cut.worn else None
        self._chip = chip_projection(cut.tool.approach_angle)
        self._known: dict[int, _Blocks | _Contacts] = {}

    @property
    def helix_pitch(self) -> float:
        """Depth [m] over which an edge runs behind by the angle between two teeth."""
        return self._cut.helix_pitch

    def reaching(self, depth: float) -> _Lines:
        """Return the harmonics where helical edges reach over a depth [m]."""
        return _Lines(self._cut, self.pattern, self.moved, self.felt, self._cut.twist * depth)

    @property
    def _sides(self) -> int:
        return 1 if self._flank is None else 2

    def factors(self, turns: Real) -> Complex:
        """Return what the compliance is times at lines of so many turns in a period, (angles, lines).

        Shape (angles, teeth of the pattern, lines), ``1 - exp(-j w T)``; of a worn flank one row more, ``j w/Omega``.
        """
        delay = self.pattern.delay[: self.teeth] / self.pattern.period
        regenerated = 1.0 - np.exp(-2j * math.pi * delay[:, None] * turns[:, None, :])
        if self._flank is None:
            return np.asarray(regenerated)
        return np.concatenate([regenerated, 1j * self.pattern.repeats * turns[:, None, :]], axis=1)

    @property
    def pulse(self) -> float:
        """Number of harmonics up to which the shortest pulse of one tooth in the cut is about even."""
        return self.pattern.period / min(part.arc for part in self._arc.arcs)

    @cached_property
    def most(self) -> int:
        """Number of harmonics beyond which none is added: more where short arcs keep the unknowns few."""
        each = RULES.nodes_a_radian * self.pattern.repeats * sum(part.arc for part in self._arc.arcs)
        few = (RULES.most_unknowns / (self._sides * self.teeth) - len(self._arc.arcs) * RULES.spare_nodes) / each
        return max(RULES.most_harmonics, min(4 * RULES.most_harmonics, int(few)))

    def upto(self, count: int) -> _Blocks | _Contacts:
        """Return the smaller of the two forms in which the lines -R .. R of the cut can be had."""
        if count not in self._known:
            share = RULES.nodes_a_radian * self.pattern.repeats * count
            nodes = [math.ceil(share * part.arc) + RULES.spare_nodes for part in self._arc.arcs]
            slices = math.ceil(share * self.behind) + RULES.spare_nodes if self.behind > 0.0 else 1
            fewer = self._sides * self.teeth * sum(nodes) * slices < int(self.moved.sum()) * (2 * count + 1)
            self._known[count] = self._contacts(count, nodes, slices) if fewer else self._blocks(count)
        return self._known[count]

    def _blocks(self, count: int) -> _Blocks:
        orders = np.arange(2 * count + 1)[:, None] - np.arange(2 * count + 1)
        grams = [gram_matrix(self._arc, int(r) * self.pattern.repeats) for r in range(-2 * count, 2 * count + 1)]
        over_edge = np.sinc(np.arange(-2 * count, 2 * count + 1) * self.pattern.repeats * self.behind / (2.0 * math.pi))
        shapes = np.array(grams) * over_edge[:, None, None] @ self._chip / self.pattern.period
        turn = [np.exp(-1j * orders * self.pattern.repeats * lag) for lag in self.pattern.lag[: self.teeth]]
        one = (self._force @ shapes)[orders + 2 * count]
        blocks = [one * phase[:, :, None, None] for phase in turn]
        if self._flank is not None:
            blocks.append((self._flank @ shapes)[orders + 2 * count] * np.sum(turn, axis=0)[:, :, None, None])
        return _Blocks(blocks, self.moved, self.felt)

    def _contacts(self, count: int, nodes: list[int], slices: int) -> _Contacts:
        parts = [_gauss(part.entry, part.exit, n) for part, n in zip(self._arc.arcs, nodes, strict=True)]
        phi, weight = (np.concatenate(p) for p in zip(*parts, strict=True))
        after, share = _gauss(0.0, 1.0, slices)
        after = np.repeat(self.behind * after, phi.size)
        phi, weight = np.tile(phi, slices), np.outer(share, weight).ravel()
        basis = np.stack([np.sin(phi), np.cos(phi), np.ones_like(phi)], axis=1)
        tooth = np.repeat(np.arange(self.teeth), phi.size)
        angle = self.pattern.repeats * (np.tile(phi + after, self.teeth) + self.pattern.lag[tooth])
        wave = np.exp(1j * np.outer(np.arange(-count, count + 1), angle))
        chip = np.tile(basis @ self._chip, (self.teeth, 1))
        sides = [self._force]
        if self._flank is not None:
            tooth = np.append(tooth, np.full(tooth.size, self.teeth))
            wave, chip = np.tile(wave, 2), np.tile(chip, (2, 1))
            sides.append(self._flank)
        of_sides = [np.tile((basis * weight[:, None]) @ side.T, (self.teeth, 1)) for side in sides]
        force = np.concatenate(of_sides) / self.pattern.period
        return _Contacts(tooth, wave[:, :, None] * chip, wave.conj()[:, :, None] * force, self.moved, self.felt)


def _gauss(low: float, high: float, nodes: int) -> tuple[Real, Real]:
    """Return nodes and weights between two ends."""
    x, w = np.polynomial.legendre.leggauss(nodes)
    return low + 0.5 * (high - low) * (x + 1.0), 0.5 * (high - low) * w


@dataclass(frozen=True)
class _Blocks:
    """For each tooth of the pattern the harmonics p - q, shape (2R + 1, 2R + 1, 3, 3): unknowns are the force lines.

    The worn flank of all teeth stands as one more.

    Parameters
    ----------
    tooth : list of ndarray of complex
        The harmonics.
    moved, felt : ndarray of bool, shape (3,)
        Directions of a force that moves anything, and of a motion that there can be.
    """

    tooth: list[Complex]
    moved: NDArray[np.bool_]
    felt: NDArray[np.bool_]

    def size(self, lines: int) -> int:
        """Return the number of unknowns with so many lines."""
        return lines * int(self.moved.sum())

    @property
    def largest(self) -> float:
        """Size of the largest harmonic [N/m2]."""
        return max(float(np.abs(block).max()) for block in self.tooth)

    @cached_property
    def columns(self) -> Complex:
        """The columns q of the lines, (teeth, 2R + 1, lines of p and their directions, directions of motion)."""
        count = self.tooth[0].shape[0]
        kept = [block[:, :, self.moved][:, :, :, self.felt].transpose(1, 0, 2, 3) for block in self.tooth]
        return np.stack([np.ascontiguousarray(b).reshape(count, -1, int(self.felt.sum())) for b in kept])

    def loop(self, regenerated: Complex, phi: Complex) -> Complex:
        """Return square matrices [1/m] over the lines and the force directions that move anything, (angles, n, n).

        `phi` (angles, lines, felt, moved) is the compliance in the directions that count.
        """
        return kernels.block_loops(self.columns, regenerated, phi)  # type: ignore[no-any-return]

    def force_lines(self, vector: Complex, lines: int) -> Complex:
        """Return the force lines (lines, 3) that an eigenvector stands for."""
        out = np.zeros((lines, 3), dtype=complex)
        out[:, self.moved] = vector.reshape(lines, -1)
        return out

    def motion_lines(self, left: Complex, regenerated: Complex) -> Complex:
        """Return what a motion in each line gives to a left eigenvector, (lines, 3); regenerated (teeth, lines)."""
        lines = regenerated.shape[1]
        out = np.zeros((lines, 3), dtype=complex)
        shares = np.einsum("tqif,i->tqf", self.columns[:, :lines, : left.size], left)
        out[:, self.felt] = np.einsum("tq,tqf->qf", regenerated, shares)
        return out


@dataclass(frozen=True)
class _Contacts:
    """The same with Gauss nodes on the arc, for short arcs: the unknowns are the chips of each tooth at the nodes.

    With the nodes the harmonics of a tooth are a product, ``A_{p-q} = sum_g f_g e^{-j p phi_g} c_g e^{+j q phi_g}``:
    the force lines span no more than there are nodes, and ``A (1 - e) Phi`` has the eigenvalues of ``c (1 - e) Phi f``.

    Parameters
    ----------
    tooth : ndarray of int, shape (contacts,)
        Tooth of the pattern; of the worn flank one beyond the last.
    chip, force : ndarray of complex, shape (2R + 1, contacts, 3)
        ``c e^{+j q phi}`` [1] and ``f e^{-j q phi}``, its weight included [N/m2].
    moved, felt : ndarray of bool, shape (3,)
        As of `_Blocks`.
    """

    tooth: NDArray[np.int64]
    chip: Complex
    force: Complex
    moved: NDArray[np.bool_]
    felt: NDArray[np.bool_]

    def size(self, lines: int) -> int:
        """Return the number of unknowns with so many lines."""
        return self.tooth.size

    @property
    def largest(self) -> float:
        """Size of the largest harmonic [N/m2]."""
        return float(np.abs(self.force[0]).sum(axis=0).max())

    @cached_property
    def kept(self) -> tuple[Complex, Complex]:
        """Chip and force in the directions that count, (2R + 1, contacts, felt) and (2R + 1, moved, contacts)."""
        force = np.ascontiguousarray(self.force[:, :, self.moved].transpose(0, 2, 1))
        return np.ascontiguousarray(self.chip[:, :, self.felt]), force

    def loop(self, regenerated: Complex, phi: Complex) -> Complex:
        """Return square matrices [1/m] over the contacts, (angles, n, n); `phi` as of `_Blocks.loop`."""
        return kernels.contact_loops(self.tooth, *self.kept, regenerated, phi)  # type: ignore[no-any-return]

    def force_lines(self, vector: Complex, lines: int) -> Complex:
        """Return the force lines (lines, 3) that an eigenvector stands for."""
        return np.asarray(vector @ self.force[:lines])

    def motion_lines(self, left: Complex, regenerated: Complex) -> Complex:
        """Return what a motion in each line gives to a left eigenvector, (lines, 3); regenerated (teeth, lines)."""
        weight = left[:, None] * regenerated[self.tooth]
        return np.asarray(np.einsum("cq,qcf->qf", weight, self.chip[: weight.shape[1]]))


@dataclass(frozen=True)
class _Truncated:
    """The loop at one spindle speed with lines up to R."""

    response: _Response
    lines: _Lines
    duration: float
    count: int
    form: _Blocks | _Contacts

    def turns(self, angle: float, low: bool | None = None) -> Real:
        """Return the frequencies of the lines in units of the pattern's; at 0 and pi with their conjugates."""
        low = angle < 0.5 * math.pi if low is None else low
        top = self.count + 1 if low else self.count
        return np.asarray(angle / (2.0 * math.pi) + np.arange(-self.count, top))

    def matrices(self, angles: Real, low: bool | None = None) -> Complex:
        """Return matrices with eigenvalues 1/depth [1/m] at angles that have lines alike.

        `low` says of which half of the circle the lines are, where the angles may lie on its end.
        """
        low = float(angles[0]) < 0.5 * math.pi if low is None else low
        turns = angles[:, None] / (2.0 * math.pi) + np.arange(-self.count, self.count + (1 if low else 0))
        phi = self.response.between(turns.ravel() / self.duration, self.form.felt, self.form.moved)
        return self.form.loop(self.lines.factors(turns), phi.reshape(*turns.shape, *phi.shape[1:]))

    @cached_property
    def poles(self) -> Complex:
        """Multipliers of the machine alone."""
        return np.exp(self.response.resonance * self.duration)

    def scan(self, closer: float = 1.0) -> Real:
        """Return rising angles from 0 to pi: about resonances, and a few to each line of a record that they pass."""
        grid = angle_grid(self.poles, math.ceil(RULES.even_steps * max(1.0, closer)))
        if self.response.lines is None:
            return grid
        even = np.linspace(RULES.close_to_end, math.pi - RULES.close_to_end, 1 + 8 * RULES.even_steps)
        turns = even[:, None] / (2.0 * math.pi) + np.arange(-self.count, self.count + 1)
        step = self.response.step(turns / self.duration).min(axis=1) * 2.0 * math.pi * self.duration
        number = np.concatenate([[0.0], np.cumsum(np.diff(even) / np.minimum(step[1:], step[:-1]))])
        count = math.ceil(number[-1] * RULES.steps_a_line * closer)
        return np.union1d(grid, np.interp(np.linspace(0.0, number[-1], count + 1), number, even))

    def crossings(self, deepest: float) -> list[Crossing]:
        """Return all crossings up to a depth [m]."""
        return find_crossings(self.values, self.scan(), deepest)

    def near(self, crossing: Crossing) -> Crossing | None:
        """Return the crossing near a given one."""
        found = self.approach(crossing.angle, crossing.depth)
        new = None if found is None else found.crossing
        return new if relative_change(crossing, new) <= RULES.largest_change else None

    def stable_at(self, depth: float) -> bool:
        """Whether the cut is stable at a depth [m]."""
        return not self.unstable_at(self.scan(), np.array([depth]))

    def of_all(self, angles: Real, of: Callable[[Complex], Any]) -> list[Any]:
        """Return what a function makes of the matrices at rising angles, for each angle."""
        out: list[Any] = []
        for part in (angles[angles < 0.5 * math.pi], angles[angles >= 0.5 * math.pi]):
            for some in np.array_split(part, math.ceil(part.size / RULES.matrices_at_once)) if part.size else ():
                out.extend(of(self.matrices(some)))
        return out

    def values(self, angles: Real) -> list[Complex]:
        """Return the eigenvalues 1/depth [1/m] at each of rising angles."""
        return self.of_all(angles, np.linalg.eigvals)

    def lowest(self, angles: Real, above: Crossing | None = None) -> Crossing | None:
        """Return the first crossing; of those below a known one where that is given. None: there is none."""
        if above is None:
            return next(iter(find_crossings(self.values, angles)), None)
        # Eigenvalues that the search leaves out are not computed.
        least = 0.5 * RULES.share_of_bound / above.depth

        def large(matrices: Complex) -> list[Complex]:
            return [
                np.linalg.eigvals(m) if kernels.may_reach(m, least) else np.empty(0, dtype=complex) for m in matrices
            ]

        found = find_crossings(lambda at: self.of_all(at, large), angles, shallower=above.depth)
        return found[0] if found and found[0].depth < above.depth else None

    def unstable_at(self, angles: Real, depths: Real) -> bool:
        """Whether the cut is unstable at one of some depths [m]: Nyquist's criterion, from a scan over 0 to pi."""
        signs = partial(kernels.determinant_signs, depths=depths)
        return is_unstable(lambda at: np.array(self.of_all(at, signs)), angles)

    def approach(self, angle: float, depth: float, vector: Complex | None = None) -> _Vibration | None:
        """Return the crossing near an angle and a depth [m], of a vector like the one given; None: none there."""
        low = angle < 0.5 * math.pi
        if vector is None or vector.size != self.form.size(self.turns(angle).size):
            matrix = self.matrices(np.array([angle]))[0]
            values, vectors = np.linalg.eig(matrix)
            at = int(np.argmin(np.abs(values - 1.0 / depth)))
            start, vector = complex(values[at]), vectors[:, at]
        else:
            start = 1.0 / depth + 0.0j
        found = approach(lambda at: self.matrices(at, low), angle, start, vector)
        return None if found is None else _Vibration(*found)

    def up_to(self, deepest: float) -> list[Crossing]:
        """Return all crossings up to a depth [m] as `crossings`; eigenvalues that are too small are not computed."""
        least = 0.5 * RULES.share_of_bound / deepest

        def large(matrices: Complex) -> list[Complex]:
            none = np.empty(0, dtype=complex)
            return [np.linalg.eigvals(m) if kernels.may_reach(m, least) else none for m in matrices]

        return find_crossings(lambda at: self.of_all(at, large), self.scan(RULES.checked_steps), deepest)

    def vibration(self, crossing: Crossing) -> _Vibration:
        """Return a crossing with its vector."""
        values, vectors = np.linalg.eig(self.matrices(np.array([crossing.angle]))[0])
        vector = vectors[:, int(np.argmin(np.abs(values * crossing.depth - 1.0)))]
        return _Vibration(crossing, np.asarray(vector, dtype=complex))

    def strongest_line(self, at: _Vibration) -> tuple[float, float, int]:
        """Return the turns in a period of the largest displacement at a crossing, its frequency [Hz], and its lobe."""
        turns = self.turns(at.crossing.angle)
        phi = self.response.at(turns / self.duration)
        force = self.form.force_lines(at.vector, turns.size)
        moved = (phi @ force[:, :, None])[:, :, 0]
        strongest = float(turns[int(np.argmax(np.linalg.norm(moved, axis=1)))])
        return strongest, abs(strongest) / self.duration, self.lines.pattern.lobe(abs(strongest))


class Loops:
    """The loops of a machine and a cut at any spindle speed, for what is asked beside the limit itself.

    Parameters
    ----------
    compliance : xarray.Dataset or Machine
        As of `multi_frequency`.
    cut : Cut
        Tool, arc, work material, flank.
    """

    def __init__(self, compliance: xr.Dataset | Machine, cut: Cut) -> None:
        self.cut = cut
        self._response = _measured(compliance) if isinstance(compliance, xr.Dataset) else _modal(compliance)
        self._lines = _lines_of(self._response, cut)

    @property
    def most(self) -> int:
        """Number of harmonics beyond which none is added."""
        return self._lines.most

    def fewest(self, spindle_speed: float) -> int:
        """Return the number of harmonics that reach the highest mode at a spindle speed [rpm]."""
        return _first_count(self._response, self._lines, self._lines.pattern.duration(spindle_speed))

    def at(self, spindle_speed: float, count: int, reach: float = 0.0) -> _Truncated:
        """Return the loop at a spindle speed [rpm] with so many harmonics, of edges that reach over a depth [m]."""
        lines = self._lines.reaching(reach) if self.cut.twist > 0.0 else self._lines
        duration = lines.pattern.duration(spindle_speed)
        return _Truncated(self._response, lines, duration, count, lines.upto(count))


@dataclass(frozen=True)
class _Vibration:
    """A crossing with the vector of the loop that belongs to it."""

    crossing: Crossing
    vector: Complex


@dataclass(frozen=True)
class _Known:
    """A limit that a neighbouring spindle speed [rpm] begins with."""

    limit: LimitDepth
    spindle_speed: float
    turns: float  # of the strongest line in a period, signed: how far the multiplier has gone round
    vectors: dict[int, Complex]  # by the harmonics
    trend: tuple[float, float] = (0.0, 0.0)  # of the limit [m] and of turns times speed, a unit of speed

    def at(self, spindle_speed: float) -> tuple[str, float, float]:
        """Return kind, turns and depth [m] that are to be expected at another speed [rpm]."""
        apart = spindle_speed - self.spindle_speed
        turns = (self.turns * self.spindle_speed + self.trend[1] * apart) / spindle_speed
        depth = 1e-3 * self.limit.limit_depth_mm
        return self.limit.kind, turns, min(2.0 * depth, max(0.5 * depth, depth + self.trend[0] * apart))

    def after(self, before: _Known) -> _Known:
        """Return the same with the trend from a neighbouring speed that limits alike."""
        apart, lines = self.spindle_speed - before.spindle_speed, round(self.turns) - round(before.turns)
        if apart == 0.0 or lines != 0 or self.limit.kind != before.limit.kind:
            return self
        depth = 1e-3 * (self.limit.limit_depth_mm - before.limit.limit_depth_mm) / apart
        around = (self.turns * self.spindle_speed - before.turns * before.spindle_speed) / apart
        return replace(self, trend=(depth, around))


def _limit(response: _Response, lines: _Lines, spindle_speed: float, tolerance: float) -> _Known:
    """Add harmonics until the first loss stands still; where it does not, the next set is scanned as a whole."""
    duration = lines.pattern.duration(spindle_speed)
    poles = np.exp(response.resonance * duration)
    angles = angle_grid(poles, RULES.even_steps)

    def truncated(count: int) -> _Truncated:
        return _Truncated(response, lines, duration, count, lines.upto(count))

    def first(loop: _Truncated) -> Crossing | None:
        return next(iter(find_crossings(loop.values, angles)), None)

    loop = truncated(_first_count(response, lines, duration))
    _require_motion(loop)
    old, change = first(loop), math.inf
    if 1.25 * loop.count > lines.most:
        # Nothing worth while is left to be added: what the last quarter has changed is known instead.
        coarser = truncated(math.ceil(0.75 * loop.count))
        change = relative_change(old, follow(coarser.values, old) if old is not None else first(coarser))
    while change > tolerance and loop.count < lines.most:
        # Harmonics of a pulse vanish here and there: the next set reaches beyond a whole one of their waves.
        loop = truncated(min(lines.most, 2 * loop.count + math.ceil(lines.pulse)))
        new = follow(loop.values, old) if old is not None else None
        change = relative_change(old, new)
        if new is None or change > tolerance:
            new = first(loop)
            change = relative_change(old, new)
        old = new
    if not _confirmed(loop, angle_grid(poles, RULES.even_steps // 4), old):
        # A coarser set has missed a root, or the angles have.
        closer = angle_grid(poles, 4 * RULES.even_steps)
        new = next(iter(find_crossings(loop.values, closer)), None)
        change = relative_change(old, new) if _confirmed(loop, closer, new) and change <= tolerance else math.inf
        old = new
    if old is None:
        error = 0.0 if change == 0.0 else math.inf
        none = LimitDepth(math.inf, error, math.nan, NO_LOBE, "none", loop.count)
        return _Known(none, spindle_speed, math.nan, {})
    at = loop.vibration(old)
    return _known(loop, spindle_speed, at, change, {loop.count: at.vector})


def _first_count(response: _Response, lines: _Lines, duration: float) -> int:
    """Number of harmonics that reach the highest mode and beyond the pulse of a tooth."""
    return min(lines.most, math.ceil(response.highest * duration + 1.0 + lines.pulse))


def _known(
    loop: _Truncated, spindle_speed: float, at: _Vibration, change: float, vectors: dict[int, Complex]
) -> _Known:
    turns, line, lobe = loop.strongest_line(at)
    depth, kind = 1e3 * at.crossing.depth, at.crossing.kind
    return _Known(LimitDepth(depth, change * depth, line, lobe, kind, loop.count), spindle_speed, turns, vectors)


def _limit_with_helix(response: _Response, lines: _Lines, spindle_speed: float, tolerance: float) -> LimitDepth:
    """Return the first loss of stability of a cut with a helix, harmonics added until it stands still."""
    duration = lines.pattern.duration(spindle_speed)
    counts = [_first_count(response, lines, duration)]
    while counts[-1] < lines.most:
        counts.append(min(lines.most, math.ceil(1.5 * counts[-1] + lines.pulse)))

    def looped(count: int, depth: float) -> _Truncated:
        there = lines.reaching(depth)
        return _Truncated(response, there, duration, count, there.upto(count))

    def finer(level: int) -> Reaches | None:
        return lru_cache(maxsize=4)(partial(looped, counts[level])) if level < len(counts) else None

    straight = looped(counts[0], 0.0)
    _require_motion(straight)
    largest = max(float(np.abs(part).max()) for part in straight.values(angle_grid(straight.poles, RULES.even_steps)))
    deepest = 1.0 / (RULES.negligible_eigenvalue * largest)
    near = next(iter(find_crossings(straight.values, angle_grid(straight.poles, RULES.even_steps))), None)
    limit = math.inf if near is None else near.depth
    found, change, level = first_with_helix(finer, lines.helix_pitch, deepest, limit, tolerance)
    if found is None:
        error = 0.0 if change == 0.0 else math.inf
        return LimitDepth(math.inf, error, math.nan, NO_LOBE, "none", counts[level])
    loop = looped(counts[level], found.depth)
    return _known(loop, spindle_speed, loop.vibration(found), change, {}).limit


def _limit_of_record(response: _Response, lines: _Lines, spindle_speed: float, tolerance: float) -> LimitDepth:
    """Return the limit with a measured compliance: a crossing with settled harmonics below which there is no other.

    A crossing that a wide scan has found is followed to more harmonics until it stands still. With these the whole
    circle is then scanned line by line for a crossing below it, which takes its place.
    """
    duration = lines.pattern.duration(spindle_speed)

    def truncated(count: int) -> _Truncated:
        count = min(lines.most, count)
        return _Truncated(response, lines, duration, count, lines.upto(count))

    def near(loop: _Truncated, at: _Vibration) -> _Vibration | None:
        found = loop.approach(at.crossing.angle, at.crossing.depth)
        return found if _changed(at, found) <= RULES.largest_change else None

    def lowest(loop: _Truncated, angles: Real, above: Crossing | None = None) -> _Vibration | None:
        found = loop.lowest(angles, above)
        if found is None:
            return None
        return loop.approach(found.angle, found.depth) or loop.vibration(found)

    loop = truncated(_first_count(response, lines, duration))
    _require_motion(loop)
    found = lowest(loop, angle_grid(loop.poles, RULES.even_steps))
    for _ in range(RULES.scans_of_a_record):
        change = math.inf
        while change > tolerance:
            if loop.count == lines.most:
                coarser, old = truncated(math.ceil(0.75 * loop.count)), found
                new = None if found is None else near(coarser, found)
                change = _changed(old, new)
                break
            coarser, loop, old = loop, truncated(math.ceil(1.5 * loop.count + lines.pulse)), found
            found = None if old is None else near(loop, old)
            change = _changed(old, found)
            if old is not None and found is None:
                found = lowest(loop, angle_grid(loop.poles, RULES.even_steps))
        below = lowest(loop, loop.scan(), found.crossing if found else None)
        if below is None:
            break
        found = below
        change = _changed(near(coarser, found), found)
        if change <= tolerance:
            break
    at = found.crossing if found else None
    if not (_confirmed(loop, loop.scan(RULES.checked_steps), at) or _confirmed(loop, loop.scan(), at)):
        change = math.inf
    if found is None:
        error = 0.0 if change == 0.0 else math.inf
        return LimitDepth(math.inf, error, math.nan, NO_LOBE, "none", loop.count)
    return _known(loop, spindle_speed, found, change, {}).limit


def _changed(old: _Vibration | None, new: _Vibration | None) -> float:
    return relative_change(old.crossing if old else None, new.crossing if new else None)


@dataclass(frozen=True)
class _AtSpeed:
    """The loops at one spindle speed [rpm], and what is known at a neighbouring one."""

    response: _Response
    lines: _Lines
    spindle_speed: float
    before: _Known
    tolerance: float
    vectors: dict[int, Complex] = field(default_factory=dict)

    @cached_property
    def duration(self) -> float:
        """Time after which the cut repeats [s]."""
        return self.lines.pattern.duration(self.spindle_speed)

    @cached_property
    def angles(self) -> Real:
        """Angles of a scan."""
        return angle_grid(np.exp(self.response.resonance * self.duration), RULES.even_steps // 4)

    def loop(self, count: int) -> _Truncated:
        """Return the loop with so many harmonics, or the most there are."""
        count = min(self.lines.most, count)
        return _Truncated(self.response, self.lines, self.duration, count, self.lines.upto(count))

    @cached_property
    def first(self) -> _Truncated:
        """The loop with the fewest harmonics."""
        return self.loop(_first_count(self.response, self.lines, self.duration))

    def near(self, loop: _Truncated, angle: float, depth: float, turned: bool = False) -> _Vibration | None:
        """Return the crossing near an angle and a depth [m] by Newton's method, from the vector known before."""
        found = None
        if (vector := self.before.vectors.get(loop.count)) is not None and not turned:
            found = loop.approach(angle, depth, vector)
        found = found or loop.approach(angle, depth)
        if found is not None:
            self.vectors[loop.count] = found.vector
        return found

    def followed(self) -> _Vibration | None:
        """Return the crossing of the neighbouring speed at this one, with the fewest harmonics."""
        return self.near(self.first, *_predicted(*self.before.at(self.spindle_speed)))

    def settled(self, loop: _Truncated, at: _Vibration | None) -> tuple[_Truncated, _Known] | None:
        """Return a limit with harmonics added until it stands still, and the loop before the last; None: it does not.

        `at` is its crossing with the harmonics of `loop`.
        """
        coarser, change = loop, math.inf
        while change > self.tolerance:
            if at is None or loop.count == self.lines.most:
                return None
            coarser, loop = loop, self.loop(math.ceil(1.5 * loop.count + self.lines.pulse))
            new = self.near(loop, at.crossing.angle, at.crossing.depth)
            change = relative_change(at.crossing, None if new is None else new.crossing)
            if change > RULES.largest_change:
                return None
            at = new
        assert at is not None
        return coarser, _known(loop, self.spindle_speed, at, change, self.vectors)

    def below(self, loop: _Truncated, depth: float) -> Crossing | None:
        """Return a crossing below a limit [m], or the limit itself; None where one is not found that must be there."""
        # An island of period doubling may be narrower than what lies between the shares; its ends are real eigenvalues.
        flip = min(real_depths(loop.values(np.array([math.pi]))[0]), default=math.inf)
        least = min(flip, depth)
        if not loop.unstable_at(self.angles, least * np.array(RULES.tracked_shares_of_harmonics)):
            return Crossing(math.pi, flip) if flip < depth else Crossing(math.nan, depth)
        found = next(iter(find_crossings(loop.values, self.angles)), None)
        return found if found is not None and found.depth < least else None


def _predicted(kind: str, turns: float, depth: float) -> tuple[float, float, bool]:
    angle, turned = followed_angle(kind, turns)
    return angle, depth, turned


def _tracked(here: _AtSpeed) -> tuple[_Known | None, bool]:
    """Return the limit at a speed from that at a neighbouring one, and whether it is of another crossing.

    None where it has to be searched for. With the harmonics with which it stands still, Nyquist's criterion says
    whether the cut is stable below.
    """
    if not math.isfinite(here.before.limit.limit_depth_mm):
        return None, True
    other, found = False, here.settled(here.first, here.followed())
    for _ in range(RULES.crossings_below):
        loop, depth = (here.first, math.inf) if found is None else (found[0], 1e-3 * found[1].limit.limit_depth_mm)
        if math.isinf(depth):
            below = next(iter(find_crossings(loop.values, here.angles)), None)
        else:
            below = here.below(loop, (1.0 - here.tolerance) * depth)
            if below is not None and math.isnan(below.angle):
                return found[1] if found else None, other
        if below is None:
            break
        other, found = True, here.settled(loop, here.near(loop, below.angle, below.depth))
        if found is None:
            break
    return None, True


def _all(response: _Response, lines: _Lines, speed: Real, tolerance: float) -> list[LimitDepth]:
    """Return the limits at all speeds, from the highest down.

    Where another crossing becomes the first, it is followed back to the speeds before as well: near its tip a lobe is
    narrower than what the criterion sees.
    """
    limits: list[LimitDepth] = [None] * speed.size  # type: ignore[list-item]
    order: list[int] = np.argsort(-speed, kind="stable").tolist()
    known: _Known | None = None
    for place, i in enumerate(order):
        n, found, other = float(speed[i]), None, True
        if known is not None:
            found, other = _tracked(_AtSpeed(response, lines, n, known, tolerance))
        if found is not None and known is not None and not other:
            found = found.after(known)
        known = _limit(response, lines, n, tolerance) if found is None else found
        limits[i], back = known.limit, known
        for j in reversed(order[:place] if other and math.isfinite(known.limit.limit_depth_mm) else []):
            there = _AtSpeed(response, lines, float(speed[j]), back, tolerance)
            settled = there.settled(there.first, there.followed())
            if settled is None or settled[1].limit.limit_depth_mm > (1.0 - tolerance) * limits[j].limit_depth_mm:
                break
            limits[j], back = settled[1].limit, settled[1]
    return limits


def _confirmed(loop: _Truncated, angles: Real, found: Crossing | None) -> bool:
    """Whether the cut is stable below a limit, or deep down where there is none."""
    if found is None:
        depth = 1.0 / (RULES.negligible_eigenvalue * max(float(np.abs(part).max()) for part in loop.values(angles)))
        return not loop.unstable_at(angles, np.array([depth]))
    return not loop.unstable_at(angles, found.depth * np.array(RULES.confirmed_shares_of_harmonics))


def _require_motion(loop: _Truncated) -> None:
    middle = np.array([0.5 * math.pi])
    matrix, phi = loop.matrices(middle), loop.response.at(loop.turns(middle[0]) / loop.duration)
    if np.abs(matrix).max(initial=0.0) <= 1e-12 * loop.form.largest * float(np.abs(phi).max()):
        raise InputError("the compliance is zero wherever the cut acts; there is nothing that could chatter")
