"""A measured matrix prepared for a modal fit: reciprocal entries averaged, noise levels, gaps without weight.

Two entries (i, j) and (j, i) that share their residues and remainders enter a least squares through their mean alone:

    w1^2 |y1 - m|^2 + w2^2 |y2 - m|^2 = (w1^2 + w2^2) |y - m|^2 + |y1 - y2|^2 / (s1^2 + s2^2),
    y = (w1^2 y1 + w2^2 y2) / (w1^2 + w2^2),    w = 1/s.

The last term does not depend on the model: it is the test of reciprocity, and it costs nothing. Where both share an
error of covariance c, its denominator is ``s1^2 + s2^2 - 2 Re c``; the mean stays as it is, its variance grows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from process.errors import InputError
from process.labels import check_compliance
from process.types import Complex, Real
from smfe.modes.rules import RULES


@dataclass(frozen=True)
class ResponseMatrix:
    """Measured frequency responses of any size as plain arrays.

    Parameters
    ----------
    frequency : ndarray, shape (n,)
        Rising [Hz].
    values : ndarray of complex, shape (n, responses, excitations)
        Displacement over force [m/N]; NaN where it was not measured.
    response, excitation : tuple of str
        Names of the places and directions; a name in both is one and the same place, and reciprocity then holds.
    std : ndarray, shape like `values`, optional
        Root mean square of the complex error [m/N].
    covariance : ndarray of complex, shape (n, responses, excitations, excitations), optional
        ``E[d_j conj(d_k)]`` of the errors of one row [m2/N2].
    between : ndarray of complex, shape (n, responses, excitations, responses, excitations), optional
        The same of all entries, where rows share errors [m2/N2].
    error_lines : float, optional
        Number of neighbouring lines that share one error.

    Raises
    ------
    InputError
        When shapes do not fit, frequencies do not rise, or there are too few lines.
    """

    frequency: Real
    values: Complex = field(repr=False)
    response: tuple[str, ...]
    excitation: tuple[str, ...]
    std: Real | None = field(default=None, repr=False)
    covariance: Complex | None = field(default=None, repr=False)
    error_lines: float = 1.0
    between: Complex | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Refuse what is not a matrix over frequency."""
        f, shape = np.asarray(self.frequency, dtype=float), np.shape(self.values)
        if f.ndim != 1 or shape != (f.size, len(self.response), len(self.excitation)):
            raise InputError(
                f"{f.size} frequencies, {len(self.response)} responses and {len(self.excitation)} excitations, but "
                f"values of shape {shape}; give them as (frequencies, responses, excitations)"
            )
        if self.std is not None and np.shape(self.std) != shape:
            raise InputError(f"the standard deviations have the shape {np.shape(self.std)}; give one a value, {shape}")
        if not np.all(np.isfinite(f)) or np.any(np.diff(f) <= 0.0) or (f.size and f[0] < 0.0):
            raise InputError("the frequencies of a modal fit must be finite, not negative, and rise; sort them")
        known = int(np.isfinite(self.values).any(axis=(1, 2)).sum()) if f.size else 0
        if known < RULES.fewest_lines:
            raise InputError(
                f"the matrix is known at {known} frequencies; a modal fit needs at least {RULES.fewest_lines}: measure "
                "with finer resolution or over a wider band"
            )
        if not np.nan_to_num(self.values).any():
            raise InputError("the matrix is zero wherever it is known; a modal fit needs a measured response")
        for name in ("response", "excitation"):
            names = getattr(self, name)
            if len(set(names)) != len(names):
                raise InputError(f"a name occurs twice among the {name}s ({', '.join(names)}); give each its own")

    def within(self, low: float, high: float) -> ResponseMatrix:
        """Return the part between two frequencies [Hz].

        Raises
        ------
        InputError
            When there are too few lines in it.
        """
        at = (self.frequency >= low) & (self.frequency <= high)
        return ResponseMatrix(
            self.frequency[at],
            self.values[at],
            self.response,
            self.excitation,
            None if self.std is None else self.std[at],
            None if self.covariance is None else self.covariance[at],
            self.error_lines,
            None if self.between is None else self.between[at],
        )


def matrix_of(compliance: xr.Dataset) -> ResponseMatrix:
    """Return a labelled compliance as arrays.

    Raises
    ------
    InputError
        When it is none, has further dimensions, or has too few lines.
    """
    array = check_compliance(compliance)["compliance"]
    further = [str(d) for d in array.dims if d not in ("frequency", "response", "excitation")]
    if further:
        raise InputError(
            f"the compliance depends on {', '.join(further)} as well; select one value, e.g. .sel({further[0]}=...)"
        )
    three = ("frequency", "response", "excitation")
    std, rows, between = None, None, None
    if "compliance_std" in compliance:
        std = compliance["compliance_std"].transpose(*three).values.astype(float)
    if "compliance_covariance" in compliance:
        rows = compliance["compliance_covariance"].transpose(*three, "other_excitation").values.astype(complex)
    if "entry_covariance" in compliance:
        five = (*three, "other_response", "other_excitation")
        between = compliance["entry_covariance"].transpose(*five).values.astype(complex)
    return ResponseMatrix(
        compliance["frequency"].values.astype(float),
        array.transpose(*three).values.astype(complex),
        tuple(str(a) for a in array["response"].values),
        tuple(str(a) for a in array["excitation"].values),
        std,
        rows,
        max(1.0, float(compliance.attrs.get("error_lines", 1.0))),
        between,
    )


@dataclass(frozen=True)
class Curves:
    """One curve for each pair of places, reciprocal entries averaged.

    Parameters
    ----------
    frequency : ndarray, shape (n,)
        [Hz].
    values : ndarray of complex, shape (g, n)
        [m/N]; zero where missing.
    std : ndarray, shape (g, n)
        Root mean square of the complex error [m/N]; infinite where missing.
    pairs : tuple of (str, str)
        Response and excitation of each curve.
    covariance : ndarray of complex, shape (n, g, g) or None
        ``E[d_g conj(d_h)]`` [m2/N2]; None: the curves are independent.
    error_lines : float
        Lines that share one error.
    noise_known : bool
        Whether `std` was measured; else it is a weight only.
    reciprocity : float
        Mean of ``|y_ij - y_ji|^2`` over its variance, 1 for a reciprocal machine; NaN when no entry has a mirror, or
        was made equal to it.
    rough : ndarray, shape (g, n), optional
        Root mean square of the noise by the scatter of neighbouring lines [m/N]; None where `std` is known.
    width : ndarray, shape (n,), optional
        Width of the lines that were merged into one [Hz], of the same second moment; None: no line is merged.
    record_lines : int, optional
        Lines before merging; 0: as many as there are.
    """

    frequency: Real
    values: Complex = field(repr=False)
    std: Real = field(repr=False)
    pairs: tuple[tuple[str, str], ...]
    covariance: Complex | None = field(repr=False)
    error_lines: float
    noise_known: bool
    reciprocity: float
    rough: Real | None = field(default=None, repr=False)
    width: Real | None = field(default=None, repr=False)
    record_lines: int = 0

    @cached_property
    def weight(self) -> Real:
        """Inverse standard deviation of real and imaginary part [N/m], zero where missing, shape (g, n)."""
        return np.asarray(np.sqrt(2.0) / self.std)

    @cached_property
    def shared(self) -> bool:
        """Whether all curves have the same weights but for a factor: one decomposition then serves all."""
        relative = self.weight / np.max(self.weight, axis=1, keepdims=True)
        return bool(np.allclose(relative, relative[:1], rtol=1e-9, atol=1e-12))

    @cached_property
    def counted_lines(self) -> float:
        """Lines that count as one when the number of modes is decided.

        Those that share an error; where no noise is known, at least so many that `FitRules.unknown_lines` are left:
        what a model leaves is then taken to be smooth, no independent number on every line of a fine grid.
        """
        return (
            self.error_lines if self.noise_known else max(self.error_lines, self.frequency.size / RULES.unknown_lines)
        )

    @cached_property
    def real_data(self) -> float:
        """Independent real numbers that were measured: two a line and curve, over `counted_lines`."""
        return 2.0 * float(np.isfinite(self.std).sum()) / self.counted_lines

    def over_lines(self, function: Callable[[Real], Complex]) -> Complex:
        """Return the mean of a function of frequency [Hz] over the lines merged into each, frequency its first axis."""
        out = function(self.frequency)
        if self.width is not None:
            at = np.flatnonzero(self.width)
            middle, reach = self.frequency[at], 0.5 * np.sqrt(0.6) * self.width[at]
            out[at] = (5.0 * (function(middle - reach) + function(middle + reach)) + 8.0 * out[at]) / 18.0
        return out

    def alike(self) -> Curves:
        """Return curves whose noise levels have one course over frequency: one decomposition serves all."""
        known = np.isfinite(self.std)
        size = np.sqrt(1.0 / np.mean(1.0 / self.std**2, axis=1, keepdims=True))
        course = np.sqrt(known.sum(axis=0) / np.sum((size / self.std) ** 2, axis=0))
        return replace(self, std=np.where(known, size * course, np.inf))

    def part(
        self, lines: NDArray[np.generic], values: Complex | None = None, used: NDArray[np.bool_] | None = None
    ) -> Curves:
        """Return some lines of some curves; other values for them where these are given (all curves, all lines)."""
        pick = np.ones(len(self.values), dtype=bool) if used is None else used
        values = self.values if values is None else values
        return Curves(
            self.frequency[lines],
            values[pick][:, lines],
            self.std[pick][:, lines],
            tuple(p for p, u in zip(self.pairs, pick, strict=True) if u),
            None,
            self.error_lines,
            self.noise_known,
            self.reciprocity,
            None if self.rough is None else self.rough[pick][:, lines],
            width=None if self.width is None or not self.width[lines].any() else self.width[lines],
        )

    @property
    def places(self) -> tuple[str, ...]:
        """Names of all places, those of responses first; x, y, z in their order."""
        names = list(dict.fromkeys([r for r, _ in self.pairs] + [e for _, e in self.pairs]))
        return tuple(sorted(names)) if set(names) <= {"x", "y", "z"} else tuple(names)


def curves_of(matrix: ResponseMatrix, accuracy: float = RULES.unknown_share) -> Curves:
    """Average reciprocal entries of a measured matrix and give each curve its noise level.

    Parameters
    ----------
    matrix : ResponseMatrix
        What was measured.
    accuracy : float, optional
        Where no noise was measured: share of the local magnitude down to which a model need not go [1].
    """
    std, roughness, known = _levels(matrix, accuracy)
    entries = [(r, e) for r in matrix.response for e in matrix.excitation]
    names = {
        (r, e): matrix.values[:, i, j] for i, r in enumerate(matrix.response) for j, e in enumerate(matrix.excitation)
    }
    rough = {(r, e): roughness[:, i, j] for i, r in enumerate(matrix.response) for j, e in enumerate(matrix.excitation)}
    levels = {(r, e): std[:, i, j] for i, r in enumerate(matrix.response) for j, e in enumerate(matrix.excitation)}
    entries = [pair for pair in entries if np.isfinite(names[pair]).any()]
    groups: dict[frozenset[str] | tuple[str, str], list[tuple[str, str]]] = {}
    for pair in entries:
        mirrored = pair[0] != pair[1] and (pair[1], pair[0]) in entries
        groups.setdefault(frozenset(pair) if mirrored else pair, []).append(pair)
    whole = _whole(matrix) if known else None
    values, spread, scatter, share = [], [], [], []
    misfit, count = 0.0, 0
    for members in groups.values():
        each = np.stack([names[pair] for pair in members])
        s = np.where(np.isfinite(each), np.stack([levels[pair] for pair in members]), np.inf)
        weight = 1.0 / s**2
        total = weight.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            part = np.where(total > 0.0, weight / total, 0.0)
            values.append(np.sum(part * np.where(np.isfinite(each), each, 0.0), axis=0))
            spread.append(np.where(total > 0.0, 1.0 / np.sqrt(total), np.inf))
        scatter.append(np.sqrt(np.sum(part**2 * np.stack([rough[pair] for pair in members]) ** 2, axis=0)))
        share.append(part)
        if len(members) == 2:
            first, second = (_place(matrix, pair) for pair in members)
            common = np.zeros(matrix.frequency.size) if whole is None else whole[:, *first, *second].real
            more = _asymmetry(each, s, common)
            misfit, count = misfit + more[0], count + more[1]
    joint = None if whole is None else _joint(matrix, whole, list(groups.values()), share)
    level = np.stack(spread)
    if matrix.between is not None and joint is not None:
        power = np.diagonal(joint, axis1=1, axis2=2).real.T
        level = np.where(
            np.isfinite(level), np.sqrt(np.maximum(power, (RULES.smallest * np.abs(values).max()) ** 2)), np.inf
        )
    # A line that no curve knows weighs nothing: it is left out.
    there = np.isfinite(level).any(axis=0)
    return Curves(
        matrix.frequency[there],
        np.stack(values)[:, there],
        level[:, there],
        tuple(members[0] for members in groups.values()),
        None if joint is None else joint[there],
        matrix.error_lines,
        known,
        misfit / count if count else float("nan"),
        None if known else np.stack(scatter)[:, there],
    )


def _levels(matrix: ResponseMatrix, accuracy: float) -> tuple[Real, Real, bool]:
    """Return the smooth noise level of each entry, its part by the scatter of lines [m/N], whether it was measured."""
    there = np.isfinite(matrix.values)
    largest = float(np.abs(matrix.values[there]).max())
    if matrix.std is not None and np.isfinite(matrix.std[there]).mean() > 0.5:
        square = np.where(there & np.isfinite(matrix.std), matrix.std, np.nan) ** 2
        level = np.apply_along_axis(_mean_over_lines, 0, square, RULES.smoothing)
        level = np.maximum(np.sqrt(level), RULES.smallest * largest)
        return level, level, True
    out, rough = np.full(matrix.values.shape, largest), np.full(matrix.values.shape, largest)
    for i, j in np.ndindex(matrix.values.shape[1:]):
        known = there[:, i, j]
        if known.sum() > 2:
            rough[known, i, j], share = _rough_level(matrix.values[known, i, j])
            out[known, i, j] = np.hypot(rough[known, i, j], accuracy * share)
    return np.maximum(out, RULES.smallest * largest), np.maximum(rough, RULES.smallest * largest), False


def running_mean(values: Real, width: int) -> Real:
    """Return the mean of each value and its neighbours, `width` in all, each sum by itself.

    A sum carried along (`scipy.ndimage.uniform_filter1d`) loses what is small behind what is large: the compliance of a
    free part at its first line is 1e8 times that at its last.
    """
    return np.asarray(ndimage.convolve1d(values, np.full(width, 1.0 / width), mode="nearest"))


def _mean_over_lines(square: Real, width: int) -> Real:
    """Return the mean of the known values among neighbouring lines."""
    known = np.isfinite(square)
    if not known.any():
        return np.full(square.size, np.inf)
    mean = running_mean(np.where(known, square, 0.0), width)
    count = running_mean(known.astype(float), width)
    near = np.where(count > 0.5 / width, mean / np.maximum(count, 1e-12), np.nan)
    return np.asarray(np.where(np.isfinite(near), near, np.nanmedian(square)))


def _rough_level(h: Complex) -> tuple[Real, Real]:
    """Return roughness of a curve and its local size; a share of it in quadrature: modes of any size count alike."""
    bend = np.abs(np.diff(h, 2)) ** 2
    # The median of an exponential distribution is ln 2 of its mean; E |second difference|^2 = 6 s^2.
    rough = ndimage.median_filter(bend, min(41, bend.size), mode="nearest") / (6.0 * np.log(2.0))
    size = running_mean(np.abs(h) ** 2, min(41, h.size))
    return np.sqrt(np.pad(rough, 1, mode="edge")), np.sqrt(size)


def _whole(matrix: ResponseMatrix) -> Complex | None:
    """Return the smooth covariance of all entries, shape (n, r, e, r, e), or None where only their sizes are known."""
    # An entry that was not measured is in no curve; its unknown covariance must not reach those of other rows.
    missing = np.asarray(~np.isfinite(matrix.values).any(axis=0))
    if matrix.between is not None:
        whole = np.where(missing[:, :, None, None] | missing, 0.0, matrix.between)
    elif matrix.covariance is not None:
        rows = np.where(missing[:, :, None] | missing[:, None, :], 0.0, matrix.covariance)
        whole = np.asarray(np.einsum("nrij,rs->nrisj", rows, np.eye(len(matrix.response)) + 0.0j))
    else:
        return None
    flat = whole.reshape(matrix.frequency.size, -1)
    real = np.apply_along_axis(_mean_over_lines, 0, flat.real, RULES.smoothing)
    imag = np.apply_along_axis(_mean_over_lines, 0, flat.imag, RULES.smoothing)
    return np.asarray((real + 1j * imag).reshape(whole.shape))


def _joint(matrix: ResponseMatrix, whole: Complex, groups: list[list[tuple[str, str]]], share: list[Real]) -> Complex:
    """Return the covariance between curves, shape (n, g, g), from that of all entries."""
    n, g = matrix.frequency.size, len(groups)
    out = np.zeros((n, g, g), dtype=complex)
    for a, members in enumerate(groups):
        for b, others in enumerate(groups):
            for p, pair in enumerate(members):
                for q, other in enumerate(others):
                    out[:, a, b] += share[a][p] * share[b][q] * whole[:, *_place(matrix, pair), *_place(matrix, other)]
    return out


def _place(matrix: ResponseMatrix, pair: tuple[str, str]) -> tuple[int, int]:
    return matrix.response.index(pair[0]), matrix.excitation.index(pair[1])


def _asymmetry(each: Complex, s: Real, common: Real) -> tuple[float, int]:
    """Return the sum of ``|y1 - y2|^2`` over its variance, and its lines; without those that were made equal."""
    both = np.isfinite(s).all(axis=0)
    power = (s[:, both] ** 2).sum(axis=0)
    apart = power - 2.0 * common[both]
    independent = apart > RULES.mirrored * power
    square = np.abs(each[0] - each[1])[both] ** 2
    return float(np.sum(square[independent] / apart[independent])), int(independent.sum())
