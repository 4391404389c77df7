"""Measurements side by side: the peaks of every entry of the compliance matrix, matched, with what differs for certain.

Peaks are compared through the local modal fits of `peaks`, each on the grid of its own measurement: nothing is
resampled. Only the response assurance figures need common lines; for them the finer compliance is interpolated
linearly onto the lines of the coarser within the common band. Which conditions the differences belong to is the
question of `smfe.comparison.explained`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import stats

from process.errors import InputError
from process.types import Complex, Real
from smfe.comparison.explained import LEVEL, error_covariance, holm
from smfe.comparison.peaks import TOLERANCE, Peak, Peaks, all_peaks, matched

_QUANTITIES: tuple[tuple[str, str, float], ...] = (
    ("frequency", "_Hz", 1.0),
    ("damping", "", 1.0),
    ("amplitude", "_um_per_N", 1e6),
)
"""Field of `Peak`, end of its column, factor."""

MOST_PAIRED = 20
"""Measurements of which every pair is compared; of more each is compared with the first alone."""

_INTERVAL = 1.96
"""Standard deviations to either side of a 95 % interval."""


@dataclass(frozen=True)
class CompareRules:
    """When peaks are the same and when they differ.

    Parameters
    ----------
    tolerance : float, optional
        Largest relative difference of frequency at which two peaks can be the same mode [1].
    level : float, optional
        A difference is significant when its p value, corrected for the number of differences in the table, is below
        this: the probability that anything is called significant in a table of equal machines.
    """

    tolerance: float = TOLERANCE
    level: float = LEVEL


def compare(
    identifications: Mapping[str, xr.Dataset],
    *,
    peaks: Peaks | None = None,
    rules: CompareRules | None = None,
) -> pd.DataFrame:
    """Compare measurements pair by pair, entry by entry, peak by peak; of more than 20 each with the first.

    The difference of a quantity q is ``100 (q_b/q_a - 1)`` percent with the standard deviation ``100 (q_b/q_a)
    sqrt((s_a/q_a)^2 + (s_b/q_b)^2)`` (independent measurements). Peaks are matched by nearest frequency, one to one.
    Unmatched peaks are listed with the reason in ``match``. One measurement alone, or measurements that share no
    entry, give a table without rows.

    Parameters
    ----------
    identifications : mapping of str to xarray.Dataset
        Name -> compliance; in every pair the earlier one is a, the reference.
    peaks : mapping, optional
        Their peaks, from `all_peaks`; without them they are fitted.
    rules : CompareRules, optional
        When peaks are the same and when they differ.

    Returns
    -------
    pandas.DataFrame
        measurement_a, measurement_b, response, excitation; match ("both", "a only", "b only", "a only, outside the
        band of b", "b only, outside the band of a", "no peak"); frequency [Hz], damping [1] and amplitude [um/N] of
        each with standard deviation, their differences in percent with standard deviation, 95 % interval, two-sided p
        value, p value corrected for the number of differences in the table (``_p_family``, Holm) and whether that is
        below the level; ``joint_p`` of all three differences together with the covariance of their errors, and
        ``significant``, whether that is below the level when corrected for the number of pairs of peaks; per entry,
        repeated on its rows: common band [Hz], ``frac``, ``csf`` and ``relative_difference_percent`` over it, see
        `response_assurance` and `scale_factor`.

    Raises
    ------
    InputError
        When there is no measurement, or a compliance has further dimensions.
    """
    rules = rules or CompareRules()
    if not identifications:
        raise InputError("there is no measurement to compare; give two or more compliances")
    peaks = all_peaks(identifications) if peaks is None else peaks
    rows: list[dict[str, object]] = []
    first = next(iter(identifications))
    few = len(identifications) <= MOST_PAIRED
    pairs = combinations(identifications, 2) if few else ((first, b) for b in list(identifications)[1:])
    for a, b in pairs:
        for entry in peaks[a]:
            if entry in peaks[b]:
                curves = _curve(identifications[a], entry), _curve(identifications[b], entry)
                head = {"measurement_a": a, "measurement_b": b, "response": entry[0], "excitation": entry[1]}
                shared = _entry_figures(*curves)
                found = _label(_match(peaks[a][entry], peaks[b][entry], rules.tolerance), *curves)
                rows += [head | _row(one, other, match) | shared for one, other, match in found]
    return _family(pd.DataFrame(rows, columns=_columns()), rules.level)


def _family(table: pd.DataFrame, level: float) -> pd.DataFrame:
    """Fill in the p values that are corrected for all differences of the table together, and what they say."""
    if table.empty:
        return table
    names = [name for name, _, _ in _QUANTITIES]
    single = table[[f"{name}_p" for name in names]].to_numpy(dtype=float)
    corrected = holm(single.ravel()).reshape(single.shape)
    joint = holm(table["joint_p"].to_numpy(dtype=float))
    filled: dict[str, NDArray[Any]] = {f"{name}_p_family": corrected[:, k] for k, name in enumerate(names)}
    filled |= {f"{name}_significant": corrected[:, k] < level for k, name in enumerate(names)}
    return table.assign(**filled, joint_p_family=joint, significant=joint < level)


def _columns() -> list[str]:
    """Return the columns of comparison.csv in their order."""
    nothing = _Curve(np.array([1.0, 2.0]), np.ones(2, dtype=np.complex128))
    figures = _entry_figures(nothing, nothing)
    row = _row(None, None, "")
    return ["measurement_a", "measurement_b", "response", "excitation", *row, *figures]


def response_assurance(
    frequency_a: Real,
    compliance_a: Complex,
    frequency_b: Real,
    compliance_b: Complex,
) -> tuple[float, float]:
    """Return FRAC and relative difference of two compliances over their common band.

    ``FRAC = |sum H_a conj(H_b)|^2 / (sum |H_a|^2 sum |H_b|^2)`` (frequency response assurance criterion, Heylen and
    Lammens 1996): 1 for curves of one shape, blind to a factor between them. Therefore also
    ``sqrt(sum |H_b - H_a|^2 / sum |H_a|^2)``, which is not. The curve with more lines in the common band is
    interpolated linearly onto the lines of the other.

    Parameters
    ----------
    frequency_a, frequency_b : ndarray, shape (n,), (m,)
        Rising [Hz].
    compliance_a, compliance_b : ndarray of complex, shape (n,), (m,)
        [m/N], finite.

    Returns
    -------
    frac, relative_difference : float
        NaN when fewer than two lines are common.
    """
    h_a, h_b = _on_common_lines(frequency_a, compliance_a, frequency_b, compliance_b)
    if not h_a.size:
        return float("nan"), float("nan")
    energy_a, energy_b = float(np.sum(np.abs(h_a) ** 2)), float(np.sum(np.abs(h_b) ** 2))
    frac = float(np.abs(np.vdot(h_b, h_a)) ** 2 / (energy_a * energy_b))
    return frac, float(np.sqrt(np.sum(np.abs(h_b - h_a) ** 2) / energy_a))


def scale_factor(
    frequency_a: Real,
    compliance_a: Complex,
    frequency_b: Real,
    compliance_b: Complex,
) -> float:
    """Return the cross signature scale factor of two compliances over their common band: amplitude and shape.

    ``CSF = 2 |sum H_a conj(H_b)| / (sum |H_a|^2 + sum |H_b|^2)`` (Heylen and Avitabile 1998): 1 for equal curves, and
    below for a factor between them, to which FRAC is blind: ``2 c/(1 + c^2)`` for curves of one shape and a factor c.

    Parameters
    ----------
    frequency_a, frequency_b, compliance_a, compliance_b
        As in `response_assurance`.
    """
    h_a, h_b = _on_common_lines(frequency_a, compliance_a, frequency_b, compliance_b)
    if not h_a.size:
        return float("nan")
    return float(2.0 * np.abs(np.vdot(h_b, h_a)) / (np.sum(np.abs(h_a) ** 2) + np.sum(np.abs(h_b) ** 2)))


def _on_common_lines(
    frequency_a: Real,
    compliance_a: Complex,
    frequency_b: Real,
    compliance_b: Complex,
) -> tuple[Complex, Complex]:
    """Return both compliances on the lines of the coarser in the common band; empty for fewer than two lines."""
    low, high = max(frequency_a[0], frequency_b[0]), min(frequency_a[-1], frequency_b[-1])
    in_a = (frequency_a >= low) & (frequency_a <= high)
    in_b = (frequency_b >= low) & (frequency_b <= high)
    if min(in_a.sum(), in_b.sum()) < 2:
        return np.empty(0, dtype=complex), np.empty(0, dtype=complex)
    if in_a.sum() <= in_b.sum():
        return compliance_a[in_a], np.interp(frequency_a[in_a], frequency_b, compliance_b)
    return np.interp(frequency_b[in_b], frequency_a, compliance_a), compliance_b[in_b]


@dataclass(frozen=True)
class _Curve:
    """One entry without its gaps: frequency [Hz] and compliance [m/N]."""

    frequency: Real
    compliance: Complex

    def holds(self, frequency: float) -> bool:
        """Whether a frequency lies in the band."""
        return bool(self.frequency[0] <= frequency <= self.frequency[-1])


def _curve(dataset: xr.Dataset, entry: tuple[str, str]) -> _Curve:
    values = dataset["compliance"].sel(response=entry[0], excitation=entry[1]).values
    there = np.isfinite(values)
    return _Curve(dataset["frequency"].values[there], values[there])


def _entry_figures(a: _Curve, b: _Curve) -> dict[str, object]:
    low, high = max(a.frequency[0], b.frequency[0]), min(a.frequency[-1], b.frequency[-1])
    frac, difference = response_assurance(a.frequency, a.compliance, b.frequency, b.compliance)
    return {
        "band_from_Hz": float(low) if low < high else float("nan"),
        "band_to_Hz": float(high) if low < high else float("nan"),
        "frac": frac,
        "csf": scale_factor(a.frequency, a.compliance, b.frequency, b.compliance),
        "relative_difference_percent": 100.0 * difference,
    }


def _match(a: list[Peak], b: list[Peak], tolerance: float) -> list[tuple[Peak | None, Peak | None]]:
    """Return pairs of peaks with rising frequency; an unmatched peak is paired with None."""
    pairs: list[tuple[Peak | None, Peak | None]] = []
    free_a, free_b = set(range(len(a))), set(range(len(b)))
    for i, j in matched([p.frequency for p in a], [p.frequency for p in b], tolerance):
        pairs.append((a[i], b[j]))
        free_a.discard(i)
        free_b.discard(j)
    pairs += [(a[i], None) for i in free_a] + [(None, b[j]) for j in free_b]
    return sorted(pairs, key=lambda pair: min(p.frequency for p in pair if p is not None))


def _label(
    pairs: list[tuple[Peak | None, Peak | None]], a: _Curve, b: _Curve
) -> Iterable[tuple[Peak | None, Peak | None, str]]:
    """Add to each pair what became of it."""
    if not pairs:
        yield None, None, "no peak"
    for one, other in pairs:
        if one is not None and other is not None:
            yield one, other, "both"
        elif one is not None:
            yield one, None, "a only" if b.holds(one.frequency) else "a only, outside the band of b"
        elif other is not None:
            yield None, other, "b only" if a.holds(other.frequency) else "b only, outside the band of a"


def _row(a: Peak | None, b: Peak | None, match: str) -> dict[str, object]:
    """Return the columns of one pair of peaks."""
    row: dict[str, object] = {"match": match}
    for name, unit, factor in _QUANTITIES:
        for side, peak in (("a", a), ("b", b)):
            value, std = _value(peak, name)
            row[f"{name}_{side}{unit}"] = factor * value
            row[f"{name}_std_{side}{unit}"] = factor * std
    for name, _, _ in _QUANTITIES:
        difference, std = _difference(_value(a, name), _value(b, name))
        row[f"{name}_difference_percent"] = difference
        row[f"{name}_difference_std_percent"] = std
        row[f"{name}_interval_low_percent"] = difference - _INTERVAL * std
        row[f"{name}_interval_high_percent"] = difference + _INTERVAL * std
        row[f"{name}_p"] = _p_value(difference, std)
        row[f"{name}_p_family"] = float("nan")
        row[f"{name}_significant"] = False
    return row | {"joint_p": _joint_p(a, b), "joint_p_family": float("nan"), "significant": False}


def _joint_p(a: Peak | None, b: Peak | None) -> float:
    """Return the p value of no difference in frequency, damping and amplitude together: d' (S_a + S_b)^-1 d."""
    if a is None or b is None:
        return float("nan")
    d = np.array([np.log(getattr(b, name) / getattr(a, name)) for name, _, _ in _QUANTITIES])
    return float(stats.chi2.sf(d @ np.linalg.solve(error_covariance(a) + error_covariance(b), d), d.size))


def _p_value(difference: float, std: float) -> float:
    """Return the two-sided p value of a difference of normal error; NaN where there is none."""
    if not np.isfinite(difference):
        return float("nan")
    if std == 0.0:
        return float(difference == 0.0)
    return float(2.0 * stats.norm.sf(abs(difference) / std))


def _value(peak: Peak | None, name: str) -> tuple[float, float]:
    if peak is None:
        return float("nan"), float("nan")
    return float(getattr(peak, name)), float(getattr(peak, f"{name}_std"))


def _difference(a: tuple[float, float], b: tuple[float, float]) -> tuple[float, float]:
    """Return the difference of b from a and its standard deviation, both in percent of a."""
    ratio = b[0] / a[0]
    return 100.0 * (ratio - 1.0), 100.0 * ratio * float(np.hypot(a[1] / a[0], b[1] / b[0]))
