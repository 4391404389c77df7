"""Multi-frequency limits: the harmonics of the directional matrix kept, on a measured compliance or a modal machine.

At the limit the tool moves at all ``w + q w_P``, w_P being the frequency at which the cut repeats (that of the tooth
passing for equal pitch). With the force lines F_q and the harmonics A_r of the directional matrix of tooth j::

    F_p = a_p sum_q sum_j A_{p-q}^j (1 - exp(-j (w + q w_P) T_j)) Phi(w + q w_P) F_q,     q = -R .. R - 1

so that 1/a_p is a real eigenvalue of a block matrix. w is scanned over (0, w_P/2]; at w_P/2 the set of lines is closed
under conjugation, the matrix is similar to a real one, and its real eigenvalues are period doubling exactly. Harmonics
are added until the limit stands still, and the whole range of w is scanned again with the last set: a root that a
coarser set has missed is found there. Source: Budak and Altintas 1998; Merdol and Altintas 2004; theory 2.4.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import find_peaks

from process.cutting import CuttingCoefficients, chip_projection, force_projection, gram_matrix
from process.engagement import AnyEngagement
from process.errors import InputError
from process.tool import Tool
from stability.crossings import Crossing, angle_grid, find_crossings, follow, relative_change
from stability.periodic import NO_LOBE, Complex, Machine, Pattern, Real, modes_of, pattern_of
from stability.problem import Cut, Samples, check_spindle_speed, complete_samples, edge_warnings
from stability.semi_discretization import LimitDepth, labelled_limits

METHOD = "multi-frequency method"

MOST_HARMONICS = 64
"""Harmonics are not added beyond this."""


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
    """

    at: Callable[[Real], Complex]
    resonance: Complex
    highest: float
    warnings: tuple[str, ...]


def multi_frequency(
    compliance: xr.Dataset | Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: ArrayLike,
    tolerance: float = 2e-3,
) -> xr.Dataset:
    """Return the multi-frequency limit depth at given spindle speeds: the first loss of stability with growing depth.

    Parameters
    ----------
    compliance : xarray.Dataset or Machine
        One labelled compliance [m/N] on its own grid, or anything with a ``state_space()``. Between measured samples
        each entry is a cubic, across a gap a straight line; below the first sample it keeps the real part, above the
        last it is zero.
    tool, arc, coefficients
        The cut; straight edges, any pitch.
    spindle_speed : array_like, shape (speeds,)
        Spindle speeds [rpm], in any order.
    tolerance : float, optional
        Relative change of the limit at which no more harmonics are added.

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
        For a helix, an unusable compliance or machine, speeds that are not positive, or so low that the harmonics do
        not reach the modes.
    """
    speed = check_spindle_speed(spindle_speed)
    if not 0.0 < tolerance < 1.0:
        raise InputError(f"the tolerance is {tolerance:g}; a share of the limit between 0 and 1 is needed, e.g. 1e-3")
    response = _measured(compliance) if isinstance(compliance, xr.Dataset) else _modal(compliance)
    cut = Cut(tool, arc, coefficients)
    lines = _Lines(cut, pattern_of(tool, METHOD))
    _require_reach(response, lines.pattern, float(speed.min()))
    limits = [_limit(response, lines, float(n), tolerance) for n in speed]
    warnings = [*cut.warnings, *response.warnings]
    loose = sum(limit.limit_depth_error_mm > tolerance * limit.limit_depth_mm for limit in limits)
    if loose:
        warnings.append(
            f"{loose} of {speed.size} limits still move by more than {tolerance:g} of themselves with "
            f"{MOST_HARMONICS} harmonics: see limit_depth_error"
        )
    return labelled_limits("multi_frequency", speed, limits, "harmonics", warnings)


def _require_reach(response: _Response, pattern: Pattern, slowest: float) -> None:
    """Raise `InputError` when the harmonics that may be taken end below the highest mode."""
    needed = response.highest * pattern.duration(slowest) + 1.0
    if needed > MOST_HARMONICS:
        possible = slowest * response.highest * pattern.duration(slowest) / (MOST_HARMONICS - 1.0)
        raise InputError(
            f"at {slowest:g} rpm it takes {needed:.0f} harmonics of the {1.0 / pattern.duration(slowest):.4g} Hz at "
            f"which the cut repeats to reach the mode at {response.highest:.4g} Hz; {MOST_HARMONICS} are the most. Ask "
            f"for {possible:.3g} rpm or more, or use the semi-discretisation"
        )


def _modal(machine: Machine) -> _Response:
    modes = modes_of(machine)
    return _Response(modes.matrix, modes.rate, float(np.abs(modes.rate.imag).max()) / (2.0 * math.pi), ())


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
    return _Response(_interpolant(samples), poles, top, warnings)


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
    """The harmonics of the directional matrix of a cut, computed once for all speeds."""

    def __init__(self, cut: Cut, pattern: Pattern) -> None:
        self.pattern = pattern
        self._arc = cut.arc
        self._force = force_projection(cut.coefficients.cutting, cut.tool.approach_angle)
        self._chip = chip_projection(cut.tool.approach_angle)
        self._harmonics: dict[int, Complex] = {}

    @property
    def pulse(self) -> float:
        """Number of harmonics up to which the shortest pulse of one tooth in the cut is about even."""
        return self.pattern.period / min(part.arc for part in self._arc.arcs)

    def matrix(self, order: int) -> Complex:
        """Return harmonic `order` of one tooth at lag zero [N/m2], shape (3, 3)."""
        if order not in self._harmonics:
            gram = gram_matrix(self._arc, order * self.pattern.repeats)
            self._harmonics[order] = self._force @ gram @ self._chip / self.pattern.period
        return self._harmonics[order]

    def blocks(self, count: int) -> list[Complex]:
        """Return for each tooth of the pattern the harmonics p - q of 2R lines, shape (2R, 2R, 3, 3)."""
        orders = np.arange(2 * count)[:, None] - np.arange(2 * count)
        one = np.array([[self.matrix(int(r)) for r in row] for row in orders])
        teeth = range(self.pattern.lag.size // self.pattern.repeats)
        turn = [np.exp(-1j * orders * self.pattern.repeats * self.pattern.lag[j]) for j in teeth]
        return [one * phase[:, :, None, None] for phase in turn]


@dataclass(frozen=True)
class _Truncated:
    """The loop at one spindle speed with 2 R lines."""

    response: _Response
    pattern: Pattern
    duration: float
    blocks: list[Complex]

    def turns(self, angle: float) -> Real:
        """Return the frequencies of the lines in units of the pattern's."""
        count = self.blocks[0].shape[0] // 2
        return np.asarray(angle / (2.0 * math.pi) + np.arange(-count, count))

    def loop(self, angle: float) -> tuple[Complex, Complex]:
        """Return the block matrix [1/m] over the force lines, and the compliance at the lines."""
        turns = self.turns(angle)
        phi = self.response.at(turns / self.duration)
        regenerated = np.zeros_like(self.blocks[0])
        for j, block in enumerate(self.blocks):
            share = self.pattern.delay[j] / self.pattern.period
            regenerated += block * (1.0 - np.exp(-2j * math.pi * turns * share))[None, :, None, None]
        return (regenerated @ phi[None]).transpose(0, 2, 1, 3), phi

    def moving(self, angle: float) -> tuple[Complex, NDArray[np.bool_], Complex]:
        """Return the square matrix over the force directions that move anything, those directions, the compliance."""
        loop, phi = self.loop(angle)
        kept = np.abs(phi).max(axis=(0, 1)) > 0.0
        size = int(kept.sum()) * phi.shape[0]
        return loop[:, kept][:, :, :, kept].reshape(size, size), kept, phi

    def values(self, angles: Real) -> list[Complex]:
        """Return the eigenvalues 1/depth [1/m] at each angle."""
        return [np.asarray(np.linalg.eigvals(self.moving(float(angle))[0])) for angle in angles]

    def strongest_line(self, crossing: Crossing) -> tuple[float, int]:
        """Return the frequency [Hz] of the largest displacement at a crossing, and its lobe."""
        matrix, kept, phi = self.moving(crossing.angle)
        values, vectors = np.linalg.eig(matrix)
        force = vectors[:, int(np.argmin(np.abs(values * crossing.depth - 1.0)))].reshape(phi.shape[0], -1)
        moved = (phi[:, :, kept] @ force[:, :, None])[:, :, 0]
        strongest = float(abs(self.turns(crossing.angle)[int(np.argmax(np.linalg.norm(moved, axis=1)))]))
        return strongest / self.duration, self.pattern.lobe(strongest)


def _limit(response: _Response, lines: _Lines, spindle_speed: float, tolerance: float) -> LimitDepth:
    """Add harmonics until the first loss stands still, and scan once more with the last set."""
    duration = lines.pattern.duration(spindle_speed)
    angles = angle_grid(np.exp(response.resonance * duration), 48)

    def truncated(count: int) -> _Truncated:
        return _Truncated(response, lines.pattern, duration, lines.blocks(count))

    def first(loop: _Truncated) -> Crossing | None:
        return next(iter(find_crossings(loop.values, angles)), None)

    count = min(MOST_HARMONICS // 2, math.ceil(max(response.highest * duration + 1.0, lines.pulse)))
    loop = truncated(count)
    _require_motion(loop)
    old, change, settled = first(loop), math.inf, False
    while count < MOST_HARMONICS and not settled:
        count = min(MOST_HARMONICS, count + max(1, count // 2))
        loop = truncated(count)
        new = follow(loop.values, old) if old is not None else None
        change = relative_change(old, new)
        if change <= tolerance or new is None or count == MOST_HARMONICS:
            new = first(loop)
            change = relative_change(old, new)
            settled = change <= tolerance
        old = new
    if old is None:
        return LimitDepth(math.inf, 0.0 if settled else math.inf, math.nan, NO_LOBE, "none", count)
    return LimitDepth(1e3 * old.depth, 1e3 * change * old.depth, *loop.strongest_line(old), old.kind, count)


def _require_motion(loop: _Truncated) -> None:
    matrix, _, phi = loop.moving(0.5 * math.pi)
    largest = max(float(np.abs(block).max()) for block in loop.blocks) * float(np.abs(phi).max())
    if np.abs(matrix).max(initial=0.0) <= 1e-12 * largest:
        raise InputError("the compliance is zero wherever the cut acts; there is nothing that could chatter")
