"""How the error of a compliance is distributed: over its entries, over frequency, over the parameters of a model.

A measured compliance has an error at every frequency, complex and circular. The errors of one response to the three
excitations belong together (``compliance_covariance``, else ``compliance_std`` alone); those of two responses come from
two sensors and share what ``entry_covariance`` says, else nothing. Neighbouring lines share an error: over
``attrs["error_lines"]`` lines, or in proportion to the ``half_width`` of the band from which each was estimated. The
correlation over a distance df is taken as ``exp(-pi (df/c)^2)``, whose integral c is the width that the lines share.

Row r has the error ``L_r z_r``; the z_r are one white noise of nine components, averaged over the width of each row.
Averages over the widths c and d, df apart, have the correlation ``sqrt(2 c d/q) exp(-2 pi df^2/q)``, ``q = c^2 + d^2``,
which is 1 for c = d and df = 0. With ``B_r`` the Hermitian root of the covariance of row r, the only one that changes
as slowly over frequency as the covariance does, and ``K_rs = B_r^-1 C_rs B_s^-1`` over that correlation, ``L_r = B_r
(K^1/2)_r``.

A machine given as modes has no such error; its frequencies, damping ratios and stiffnesses have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import sparse

from process.cut.force import CuttingCoefficients
from process.errors import InputError
from process.labels import AXES, at_tool, axis_index, not_measured
from process.machine.modes import HIGHEST_DAMPING, ModalModel
from process.types import Complex, Real
from stability.bands.rules import RULES


@dataclass(frozen=True)
class Spread:
    """Relative standard deviations of what the compliance does not hold; all errors are log-normal and independent.

    Parameters
    ----------
    coefficients : tuple of float, optional
        Of K_tc, K_rc, K_ac, each for itself.
    frequency, damping, stiffness : float, optional
        Of every natural frequency, damping ratio and modal stiffness of a machine given as modes.
    common : float, optional
        Of one factor on all cutting coefficients together, as a harder batch or a worn edge changes them: the limit
        depth goes exactly as one over it.

    Raises
    ------
    InputError
        When one is negative or not finite.
    """

    coefficients: tuple[float, float, float] = (0.0, 0.0, 0.0)
    frequency: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0
    common: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is no standard deviation."""
        if len(self.coefficients) != 3:
            raise InputError(f"the coefficients have {len(self.coefficients)} spreads; give one for Ktc, Krc and Kac")
        for value in (*self.coefficients, self.frequency, self.damping, self.stiffness, self.common):
            if not (math.isfinite(value) and value >= 0.0):
                raise InputError(f"a relative standard deviation of {value:g}; it must be at least 0, e.g. 0.1")

    @property
    def modal(self) -> Real:
        """Of frequency, damping and stiffness."""
        return np.array([self.frequency, self.damping, self.stiffness])


class ErrorModel(Protocol):
    """What the error of a compliance is like."""

    def draw(self, generator: np.random.Generator) -> Complex:
        """Return an error [m/N] at all frequencies, shape (n, 3, 3)."""

    def line_factors(self, frequency: Real) -> Complex:
        """Return factors L of the errors of lines, (m, 3, 3, k): row r has the error ``L[r] z_r``; k may be 0."""

    def correlation(self, frequency: Real) -> Real:
        """Return the correlation of ``z_r`` and ``z_s`` between frequencies (..., m): shape (..., m, m, 3, 3)."""

    def shared(self, frequency: Real) -> Complex:
        """Return what each shared factor of unit variance changes [m/N], shape (factors, m, 3, 3)."""


@dataclass(frozen=True)
class MeasuredError:
    """Error of a measured compliance.

    Parameters
    ----------
    frequency : ndarray, shape (n,)
        Frequencies [Hz].
    factor : ndarray of complex, shape (n, 3, 3, 9)
        ``factor[:, r]`` times its adjoint is the covariance of row r [m2/N2]; times that of another row it is what the
        two share, but for the correlation of their averages.
    width : ndarray, shape (n, 3)
        Width over which the lines of a response share an error [Hz].
    """

    frequency: Real
    factor: Complex
    width: Real

    @cached_property
    def _average(self) -> list[sparse.csr_array]:
        """Moving averages that turn white noise into noise of this width, one a response."""
        return [_moving_average(self.frequency, w) for w in self.width.T]

    def draw(self, generator: np.random.Generator) -> Complex:
        """Return an error [m/N] at all frequencies, shape (n, 3, 3)."""
        n = self.frequency.size
        white = generator.standard_normal((n, 18)).view(complex) * math.sqrt(0.5)
        smooth = np.stack([average @ white for average in self._average], axis=1)
        return np.asarray((self.factor @ smooth[..., None])[..., 0])

    def line_factors(self, frequency: Real) -> Complex:
        """Return the factor at the nearest line, shape (m, 3, 3, 9)."""
        return np.asarray(self.factor[_nearest(self.frequency, frequency)])

    def correlation(self, frequency: Real) -> Real:
        """Return the correlation of ``z_r`` and ``z_s`` between frequencies (..., m): shape (..., m, m, 3, 3)."""
        width = self.width[_nearest(self.frequency, frequency)]
        apart = frequency[..., :, None] - frequency[..., None, :]
        return _alike(width[..., :, None, :, None], width[..., None, :, None, :], apart[..., None, None])

    def shared(self, frequency: Real) -> Complex:
        """Return nothing: the errors of lines far apart are independent."""
        return np.zeros((0, frequency.size, 3, 3), dtype=complex)


@dataclass(frozen=True)
class ModalError:
    """Error of a machine given as modes.

    Parameters
    ----------
    machine : ModalModel
        The machine.
    spread : Spread
        Of its parameters.
    frequency : ndarray, shape (n,)
        Frequencies at which errors are drawn [Hz].
    """

    machine: ModalModel
    spread: Spread
    frequency: Real

    def changed(self, steps: Real) -> ModalModel:
        """Return the machine with ``exp(spread x step)`` on frequency, damping and stiffness; steps (3, modes)."""
        factor = np.exp(self.spread.modal[:, None] * steps)
        machine = self.machine
        # A mode that would not vibrate any more is no draw of an uncertain damping.
        damping = np.minimum(machine.damping * factor[1], HIGHEST_DAMPING)
        return ModalModel(machine.frequency * factor[0], damping, machine.stiffness * factor[2], machine.direction)

    def draw(self, generator: np.random.Generator) -> Complex:
        """Return an error [m/N] at all frequencies, shape (n, 3, 3)."""
        steps = generator.standard_normal((3, self.machine.frequency.size))
        return self.changed(steps).matrix(self.frequency) - self.machine.matrix(self.frequency)

    def line_factors(self, frequency: Real) -> Complex:
        """Return nothing: no error belongs to one line alone."""
        return np.zeros((frequency.size, 3, 3, 0), dtype=complex)

    def correlation(self, frequency: Real) -> Real:
        """Return ones, which nothing depends on."""
        return np.ones((*frequency.shape, frequency.shape[-1], 3, 3))

    def shared(self, frequency: Real) -> Complex:
        """Return the change with one parameter of one mode, shape (factors, m, 3, 3), by central differences."""
        modes, step = self.machine.frequency.size, 1e-3
        out = []
        for parameter in np.flatnonzero(self.spread.modal):
            for mode in range(modes):
                steps = np.zeros((3, modes))
                steps[parameter, mode] = step
                up, down = self.changed(steps), self.changed(-steps)
                out.append((up.matrix(frequency) - down.matrix(frequency)) / (2.0 * step))
        return np.array(out, dtype=complex).reshape(-1, frequency.size, 3, 3)


def carries_errors(compliance: xr.Dataset) -> bool:
    """Whether a compliance says how far it can be trusted: a standard deviation at nearly all of its frequencies."""
    return "compliance_std" in compliance and _missing(compliance) <= RULES.most_missing


def measured_error(compliance: xr.Dataset, frequency: Real) -> MeasuredError:
    """Return the error of a measured compliance at those of its frequencies that are used [Hz].

    Raises
    ------
    InputError
        When it has no standard deviation, or at too few frequencies (one hit, or no repeat, has none).
    """
    if "compliance_std" not in compliance:
        raise InputError(
            "the compliance has no compliance_std: how far it can be trusted is not known; identify it from repeats, "
            "or give a machine as modes with a Spread"
        )
    if not carries_errors(compliance):
        raise InputError(
            f"the standard deviation of the compliance is missing at {100.0 * _missing(compliance):.0f} % of its "
            "frequencies; repeats (three hits or more, a longer record) are needed for a band"
        )
    compliance = at_tool(compliance)
    at = np.searchsorted(compliance["frequency"].values, frequency - 1e-9)
    rows = axis_index([str(a) for a in compliance["response"].values])
    columns = axis_index([str(a) for a in compliance["excitation"].values])
    covariance = np.zeros((frequency.size, 3, 3, 3, 3), dtype=complex)
    covariance[np.ix_(range(frequency.size), rows, columns, rows, columns)] = _smoothed_covariance(compliance)[at]
    width = _width(compliance, frequency, at, rows)
    return MeasuredError(frequency, _factors(covariance, width), width)


def _missing(compliance: xr.Dataset) -> float:
    """Return the share of the frequencies with a compliance that have no standard deviation."""
    three, compliance = ("frequency", "response", "excitation"), at_tool(compliance)
    rigid = not_measured(compliance).transpose(*three[1:]).values
    there, known = (
        (np.isfinite(compliance[name].transpose(*three).values) | rigid).all(axis=(1, 2))
        for name in ("compliance", "compliance_std")
    )
    return float((there & ~known).sum()) / max(1, int(there.sum()))


def entry_covariance(compliance: xr.Dataset) -> Complex:
    """Return the covariance of all entries at every frequency [m2/N2], shape (n, r, e, r, e); NaN where not known.

    Parameters
    ----------
    compliance : xarray.Dataset
        With ``compliance_std`` and, where known, ``compliance_covariance`` or ``entry_covariance``. What was not
        measured is taken as rigid, without an error.
    """
    three = ("frequency", "response", "excitation")
    rigid = not_measured(compliance).transpose(*three[1:]).values
    if "entry_covariance" in compliance:
        five = (*three, "other_response", "other_excitation")
        values = compliance["entry_covariance"].transpose(*five).values.astype(complex)
    else:
        variance = compliance["compliance_std"].transpose(*three).values ** 2
        rows = variance[..., None] * np.eye(variance.shape[-1]) + 0.0j
        if "compliance_covariance" in compliance:
            rows = compliance["compliance_covariance"].transpose(*three, "other_excitation").values.astype(complex)
        rows = np.where(rigid[:, :, None] | rigid[:, None, :], 0.0, rows)
        values = np.einsum("frij,rs->frisj", rows, np.eye(rows.shape[1]))
    return np.asarray(np.where(rigid[:, :, None, None] | rigid, 0.0, values))


def _smoothed_covariance(compliance: xr.Dataset) -> Complex:
    """Return the covariance of all entries, interpolated where it is not known, and smoothed over frequency."""
    f, values = compliance["frequency"].values, entry_covariance(compliance)
    known = np.isfinite(values).reshape(f.size, -1).all(axis=1)
    flat = values.reshape(f.size, -1)
    for column in flat.T:
        column.real[~known] = np.interp(f[~known], f[known], column.real[known])
        column.imag[~known] = np.interp(f[~known], f[known], column.imag[known])
    lines = max(1.0, float(compliance.attrs.get("error_lines", 1.0)))
    return _level(flat, round(0.5 * RULES.level_width * lines)).reshape(values.shape)


def _level(values: Complex, reach: int) -> Complex:
    """Return the mean over `reach` lines to either side, fewer at the ends; shape (n, any)."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    line = np.arange(values.shape[0])
    low, high = np.maximum(line - reach, 0), np.minimum(line + reach + 1, line.size)
    return np.asarray((total[high] - total[low]) / (high - low)[:, None])


def _alike(one: Real, other: Real, apart: Real | float = 0.0) -> Real:
    """Return the correlation of averages of one noise over two widths, `apart` from each other."""
    square = one**2 + other**2
    return np.asarray(np.sqrt(2.0 * one * other / square) * np.exp(-2.0 * math.pi * apart**2 / square))


def _factors(covariance: Complex, width: Real) -> Complex:
    """Return the factors L of covariances (n, 3, 3, 3, 3) of rows of these widths (n, 3), shape (n, 3, 3, 9)."""
    n = width.shape[0]
    value, vectors = np.linalg.eigh(np.stack([covariance[:, r, :, r] for r in range(3)], axis=1))
    size = np.sqrt(np.maximum(value, 0.0))
    root = (vectors * size[..., None, :]) @ vectors.conj().swapaxes(2, 3)
    seen = size > 1e-6 * size[..., -1:]
    turned = vectors * np.where(seen, 1.0 / np.where(seen, size, 1.0), 0.0)[..., None, :]
    inverse = turned @ vectors.conj().swapaxes(2, 3)
    k = np.einsum("nrab,nrbsc,nscd->nrasd", inverse, covariance, inverse, optimize=True)
    k /= _alike(width[:, :, None], width[:, None, :])[:, :, None, :, None]
    for r in range(3):
        k[:, r, :, r] = 0.0
    between = k.reshape(n, 9, 9)
    lowest = np.linalg.eigvalsh(between)[:, 0]
    # Averages over unlike widths cannot share more than all.
    possible = np.eye(9) + between * np.minimum(1.0, -1.0 / np.minimum(lowest, -1e-12))[:, None, None]
    value, vectors = np.linalg.eigh(possible)
    mixed = (vectors * np.sqrt(np.maximum(value, 0.0))[..., None, :]) @ vectors.conj().swapaxes(1, 2)
    return np.asarray(root @ mixed.reshape(n, 3, 3, 9))


def _width(compliance: xr.Dataset, frequency: Real, at: NDArray[np.int64], rows: list[int]) -> Real:
    """Return the width over which lines share an error [Hz], shape (n, 3)."""
    lines = max(1.0, float(compliance.attrs.get("error_lines", 1.0)))
    step = np.gradient(frequency) if frequency.size > 1 else np.ones(1)
    width = np.repeat((lines * step)[:, None], len(AXES), axis=1)
    if "half_width" in compliance:
        half = compliance["half_width"].transpose("frequency", "response").values[at]
        width[:, rows] = np.maximum(width[:, rows] * half / np.nanmean(half), step[:, None])
        width[~np.isfinite(width)] = float(lines * step.mean())
    return width


def _moving_average(frequency: Real, width: Real) -> sparse.csr_array:
    """Return the matrix that averages white noise so that its correlation has the width; rows of length one."""
    columns, weights, ends = [], [], [0]
    reach = 0.8 * width
    low, high = np.searchsorted(frequency, frequency - reach), np.searchsorted(frequency, frequency + reach, "right")
    for i in range(frequency.size):
        apart = frequency[low[i] : high[i]] - frequency[i]
        weight = np.exp(-2.0 * math.pi * (apart / width[i]) ** 2)
        columns.append(np.arange(low[i], high[i]))
        weights.append(weight / np.linalg.norm(weight))
        ends.append(ends[-1] + weight.size)
    shape = (frequency.size, frequency.size)
    return sparse.csr_array((np.concatenate(weights), np.concatenate(columns), np.array(ends)), shape=shape)


def _nearest(grid: Real, value: Real) -> NDArray[np.int64]:
    """Return the number of the nearest line."""
    above = np.clip(np.searchsorted(grid, value), 1, grid.size - 1)
    return np.asarray(np.where(value - grid[above - 1] < grid[above] - value, above - 1, above))


def changed_coefficients(coefficients: CuttingCoefficients, spread: Spread, steps: Real) -> CuttingCoefficients:
    """Return coefficients with ``exp(spread x step)`` on K_tc, K_rc, K_ac; steps (3,)."""
    ktc, krc, kac = coefficients.cutting * np.exp(np.array(spread.coefficients) * steps)
    return replace(coefficients, Ktc=float(ktc), Krc=float(krc), Kac=float(kac))
