"""Peaks of a compliance: frequency, damping ratio and amplitude with their uncertainty, from a local modal fit.

A half-power width read off the lines is biased as soon as the resolution is not far below it (0.0163 instead of 0.0119
at 61 Hz on a 0.25 Hz grid). A fit is not: near its peaks a compliance is

    H(w) = sum_p [ r_p / (j w - s_p) + conj(r_p) / (j w - conj(s_p)) ] + c_0 + c_1 (f - f_0),
    s_p = 2 pi f_p (-zeta_p + j sqrt(1 - zeta_p^2)),

with complex residues r and a complex straight line c for the modes outside the fitted band: the fit of
`smfe.modes.pole_fit` to one curve, over a window that follows the damping found.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from scipy import ndimage, optimize, signal

from process.errors import InputError
from process.labels import check_compliance
from process.types import Complex, Real
from smfe.modes.pole_fit import (
    Bounds,
    Descent,
    PoleFit,
    Remainders,
    basis,
    inflation,
    refine,
    slopes,
    solve,
    squares,
)
from smfe.modes.response_matrix import Curves

TOLERANCE = 0.1
"""Largest relative difference of frequency at which two peaks can be the same mode."""


@dataclass(frozen=True)
class PeakRules:
    """What counts as a peak and how it is fitted.

    Parameters
    ----------
    significance : float, optional
        A peak rises above its surroundings by this many standard deviations of the compliance.
    prominence : float, optional
        And by this share of its own height [1].
    height : float, optional
        Peaks below this share of the highest one are ignored [1], unless they are clear.
    clear : float, optional
        A peak is clear when it rises above its surroundings by this share of its own height [1] and by
        `clear_significance` times `significance`: a mode of the same mass and damping at five times the frequency has
        1/25 of the compliance, and is a mode all the same.
    floor : float, optional
        Below this share of the highest peak nothing counts, however clear [1]: 60 dB down begins what the recording
        itself adds.
    clear_significance : float, optional
        How many times more significant than another a peak must be that is low beside the highest one.
    width : float, optional
        Half-power widths fitted to each side of a peak; 3 to 6 together is the compromise between noise and the
        neighbours that the remainders can no longer describe.
    most_poles : int, optional
        Overlapping peaks that are fitted together; more are no longer peaks.
    largest_damping : float, optional
        Damping ratio beyond which a maximum is no peak.
    """

    significance: float = 5.0
    prominence: float = 0.1
    height: float = 0.02
    clear: float = 0.5
    floor: float = 0.001
    clear_significance: float = 4.0
    width: float = 2.5
    most_poles: int = 4
    largest_damping: float = 0.5


@dataclass(frozen=True)
class Peak:
    """One peak of one entry of a compliance matrix.

    Parameters
    ----------
    frequency, frequency_std : float
        Natural frequency f_p of the pole and its standard deviation [Hz].
    damping, damping_std : float
        Damping ratio [1].
    amplitude, amplitude_std : float
        Largest ``|H|`` of the fitted curve near the pole [m/N].
    misfit : float
        Root mean square residual over standard deviation of the data, 1 for a perfect model; NaN when the compliance
        came without standard deviations.
    correlation : (float, float, float), optional
        Of the errors of frequency and damping, frequency and amplitude, damping and amplitude [1].
    """

    frequency: float
    frequency_std: float
    damping: float
    damping_std: float
    amplitude: float
    amplitude_std: float
    misfit: float
    correlation: tuple[float, float, float] = (0.0, 0.0, 0.0)


def find_peaks(
    frequency: Real,
    compliance: Complex,
    std: Real | None = None,
    rules: PeakRules | None = None,
    error_lines: float = 1.0,
) -> list[Peak]:
    """Find and fit the peaks of one entry of a compliance matrix.

    Standard deviations come from linear propagation of those of the data through the fit, raised where the residual is
    larger than they say (by ``chi^2/dof`` where that is above one by more than two of its standard deviations);
    without them, from the residual alone.

    Parameters
    ----------
    frequency : ndarray, shape (n,)
        Rising [Hz].
    compliance : ndarray of complex, shape (n,)
        [m/N]; lines with NaN are left out.
    std : ndarray, shape (n,), optional
        Root mean square of its complex error [m/N].
    rules : PeakRules, optional
        What counts as a peak.
    error_lines : float, optional
        Number of neighbouring lines that share one error (1: independent lines).

    Returns
    -------
    list of Peak
        With rising frequency.
    """
    rules = rules or PeakRules()
    there = np.isfinite(compliance)
    f, h = frequency[there], compliance[there]
    if f.size < 8:
        return []
    noise = _noise_level(h, None if std is None else std[there])
    tops = _tops(h, noise.level, rules)
    out: list[Peak] = []
    for group in _groups(f, h, tops, rules):
        out += _fit_group(f, h, noise, group, rules, error_lines)
    return _distinct(sorted(out, key=lambda peak: peak.frequency))


def entries(dataset: xr.Dataset) -> list[tuple[str, str]]:
    """Return (response, excitation) of every entry that was measured.

    Raises
    ------
    InputError
        When there is no compliance or it has more dimensions than frequency, response, excitation.
    """
    array = check_compliance(dataset)["compliance"]
    further = [str(d) for d in array.dims if d not in ("frequency", "response", "excitation")]
    if further:
        raise InputError(
            f"the compliance depends on {', '.join(further)} as well; select one value, e.g. .sel({further[0]}=...)"
        )
    return [
        (str(r), str(e))
        for r in array["response"].values
        for e in array["excitation"].values
        if np.isfinite(array.sel(response=r, excitation=e).values).any()
    ]


def entry_peaks(dataset: xr.Dataset, response: str, excitation: str, rules: PeakRules | None = None) -> list[Peak]:
    """Return the peaks of one entry; ``attrs["error_lines"]`` says how many lines share an error (default 1)."""
    where = {"response": response, "excitation": excitation}
    std = dataset["compliance_std"].sel(where).values if "compliance_std" in dataset else None
    return find_peaks(
        dataset["frequency"].values,
        dataset["compliance"].sel(where).values,
        std,
        rules,
        float(dataset.attrs.get("error_lines", 1.0)),
    )


Peaks = Mapping[str, Mapping[tuple[str, str], list[Peak]]]
"""Measurement -> entry of its matrix (response, excitation) -> peaks."""


def all_peaks(identifications: Mapping[str, xr.Dataset], rules: PeakRules | None = None) -> Peaks:
    """Return the peaks of every entry of every measurement: a fit each, which whoever compares them shares."""
    return {
        name: {entry: entry_peaks(dataset, *entry, rules) for entry in entries(dataset)}
        for name, dataset in identifications.items()
    }


def matched(one: Sequence[float], other: Sequence[float], tolerance: float) -> list[tuple[int, int]]:
    """Return the numbers of frequencies that are the same mode, one to one.

    The assignment has the least sum of relative differences; a pair beyond the tolerance costs more than any number of
    good ones and is dissolved afterwards.

    Parameters
    ----------
    one, other : sequence of float
        Frequencies [Hz].
    tolerance : float
        Largest relative difference [1].
    """
    distance = np.abs(np.log(one)[:, None] - np.log(other)[None, :])
    limit = np.log1p(tolerance)
    cost = np.where(distance <= limit, distance, 10.0 * limit * (len(one) + len(other)))
    return [
        (int(i), int(j)) for i, j in zip(*optimize.linear_sum_assignment(cost), strict=True) if distance[i, j] <= limit
    ]


# --- which maxima are peaks ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Noise:
    """Smoothed noise level, shape (n,), and whether it was given or guessed from the roughness of the curve."""

    level: Real
    given: bool


def _noise_level(h: Complex, std: Real | None) -> _Noise:
    """Return the local root mean square error [m/N].

    A standard deviation from few repeats scatters itself: its mean square over nine lines is used. Without one, the
    noise is read from second differences, ``E |h_-1 - 2 h_0 + h_1|^2 = 6 s^2``, whose median over 41 lines passes by
    the peaks.
    """
    if std is not None and np.isfinite(std).sum() > 0.5 * std.size:
        filled = np.where(np.isfinite(std), std, np.nanmedian(std))
        return _Noise(np.sqrt(ndimage.uniform_filter1d(filled**2, min(9, std.size), mode="nearest")), True)
    bend = np.abs(np.diff(h, 2)) ** 2
    # The median of an exponential distribution is ln 2 of its mean.
    level = ndimage.median_filter(bend, min(41, bend.size), mode="nearest") / (6.0 * np.log(2.0))
    return _Noise(np.sqrt(np.pad(level, 1, mode="edge")), False)


def _tops(h: Complex, noise: Real, rules: PeakRules) -> list[int]:
    """Return the lines of the maxima that stand out."""
    size = np.abs(h)
    tops, found = signal.find_peaks(size, prominence=0.0)
    needed = np.maximum(rules.prominence * size[tops], rules.significance * noise[tops])
    rises = found["prominences"]
    clear = (rises >= rules.clear * size[tops]) & (rises >= rules.clear_significance * rules.significance * noise[tops])
    share = size[tops] / size.max()
    keep = (rises >= needed) & ((clear & (share >= rules.floor)) | (share >= rules.height))
    return [int(top) for top in tops[keep]]


def _half_width(f: Real, h: Complex, top: int) -> float:
    """Return half the width [Hz] over which ``|H|`` stays above 1/sqrt(2) of its maximum: a first guess only."""
    low = np.abs(h) < np.abs(h[top]) / np.sqrt(2.0)
    left, right = np.flatnonzero(low[:top]), np.flatnonzero(low[top:])
    sides = []
    if left.size:
        sides.append(f[top] - f[left[-1]])
    if right.size:
        sides.append(f[top + right[0]] - f[top])
    return float(min(sides)) if sides else float(f[-1] - f[0]) / 4.0


@dataclass(frozen=True)
class _Guess:
    """Frequency, half-power width, and the middles to the next maxima [Hz].

    Each pole keeps to its side of the middles, or two would fit the stronger of two maxima.
    """

    frequency: float
    width: float
    low: float
    high: float


def _groups(f: Real, h: Complex, tops: Sequence[int], rules: PeakRules) -> Iterable[list[_Guess]]:
    """Yield peaks whose bands of fit touch: they are fitted together."""
    group: list[_Guess] = []
    fences = np.concatenate([[f[0]], 0.5 * (f[tops[1:]] + f[tops[:-1]]), [f[-1]]])
    for k, top in enumerate(tops):
        guess = _Guess(float(f[top]), 2.0 * _half_width(f, h, top), float(fences[k]), float(fences[k + 1]))
        if group:
            reach = rules.width * (group[-1].width + guess.width)
            if guess.frequency - group[-1].frequency > reach or len(group) == rules.most_poles:
                yield group
                group = []
        group.append(guess)
    if group:
        yield group


def _distinct(peaks: list[Peak]) -> list[Peak]:
    """Drop a second fit of the same pole."""
    out: list[Peak] = []
    for peak in peaks:
        if out and peak.frequency - out[-1].frequency < 0.5 * peak.damping * peak.frequency:
            if peak.misfit < out[-1].misfit:
                out[-1] = peak
        else:
            out.append(peak)
    return out


# --- the fit -------------------------------------------------------------------------------------------------------

_DESCENT = Descent(40, share=1e-10)
"""Peaks are compared with each other: converged far below their standard deviations."""


def _band(f: Real, group: Sequence[_Guess], rules: PeakRules) -> slice:
    """Return the lines round a group, at least so many that the fit has as many left over as it uses."""
    low = max(min(g.frequency - rules.width * g.width for g in group), group[0].low)
    high = min(max(g.frequency + rules.width * g.width for g in group), group[-1].high)
    a, b = int(np.searchsorted(f, low)), int(np.searchsorted(f, high, side="right"))
    least = min(4 * len(group) + 5, f.size)
    while b - a < least:
        a, b = max(a - 1, 0), min(b + 1, f.size)
    return slice(a, b)


def _fit_group(
    f: Real,
    h: Complex,
    noise: _Noise,
    group: list[_Guess],
    rules: PeakRules,
    error_lines: float,
) -> list[Peak]:
    """Fit the poles of a group; the band follows the damping found, once."""
    for _ in range(2):
        band = _band(f, group, rules)
        if 2 * (band.stop - band.start) <= 4 * len(group) + 4:
            return []
        fit = _fit(f[band], h[band], noise.level[band], noise.given, group, rules)
        group = [
            replace(g, frequency=p, width=2.0 * z * p) for g, (p, z) in zip(group, fit.poles.tolist(), strict=True)
        ]
    covariance = fit.unit_covariance() * error_lines * inflation(fit.chi, fit.degrees_of_freedom, noise.given)
    peaks = [_peak(fit, k, covariance, noise.given, rules) for k in range(len(group))]
    return [p for p in peaks if p is not None and p.amplitude >= rules.significance * p.amplitude_std]


def _fit(
    f: Real,
    h: Complex,
    noise: Real,
    given: bool,
    group: Sequence[_Guess],
    rules: PeakRules,
) -> PoleFit:
    """Fit poles and a complex straight line to a band; without a given noise every line counts the same."""
    size = float(np.abs(h).max())
    level = np.maximum(noise, 1e-9 * size) if given else np.full(f.size, size)
    curves = Curves(f, h[None], level[None], (("", ""),), None, 1.0, True, float("nan"))
    line = 0.5 * float(f[0] + f[-1]), 0.5 * float(f[-1] - f[0])
    low, high = (np.array([getattr(g, end) for g in group]) for end in ("low", "high"))
    natural, width = (np.array([getattr(g, of) for g in group]) for of in ("frequency", "width"))
    poles = np.stack([np.clip(natural, low, high), np.clip(width / (2.0 * natural), 1e-4, 0.4)], axis=1)
    fit = solve(curves, poles, Remainders(False, False, line))
    return refine(fit, _DESCENT, Bounds(low, high, most_damping=rules.largest_damping))


def _peak(fit: PoleFit, k: int, covariance: Real, given: bool, rules: PeakRules) -> Peak | None:
    """Return peak number k of a fit, or None when it ran away."""
    frequency, damping = (float(v) for v in fit.poles[k])
    width, f = 2.0 * damping * frequency, fit.curves.frequency
    std = np.sqrt(np.diag(covariance)[2 * k : 2 * k + 2])
    outside = not f[0] < frequency < f[-1]
    if outside or damping > 0.99 * rules.largest_damping or not std[0] < width or not std[1] < damping:
        return None
    fine = np.linspace(max(f[0], frequency - width), min(f[-1], frequency + width), 801)
    size = np.abs(fit.curve_values(fine)[0])
    top = fine[[int(np.argmax(size))]]
    # |H| at its maximum does not change to first order with the frequency of the maximum, which is held.
    value = fit.curve_values(top)[0]
    slope = np.concatenate(
        [slopes(squares(top, fit.poles), fit.poles, fit.coefficient)[0, :, 0], basis(top, fit.poles, fit.remainders)[0]]
    )
    gradient = (value.conj() / np.abs(value) * slope).real
    amplitude_std = float(np.sqrt(np.maximum(gradient @ covariance @ gradient, 0.0)))
    own = covariance[2 * k : 2 * k + 2]
    with np.errstate(divide="ignore", invalid="ignore"):  # a peak of an exact curve claims no error
        related = np.nan_to_num(np.array([own[0, 2 * k + 1] / std[1], *(own @ gradient / amplitude_std)]))
        related = np.nan_to_num(related / std[[0, 0, 1]])
    return Peak(
        frequency=frequency,
        frequency_std=float(std[0]),
        damping=damping,
        damping_std=float(std[1]),
        amplitude=float(size.max()),
        amplitude_std=amplitude_std,
        misfit=fit.misfit if given else float("nan"),
        correlation=(float(related[0]), float(related[1]), float(related[2])),
    )
