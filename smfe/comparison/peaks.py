"""Peaks of a compliance: frequency, damping ratio and amplitude with their uncertainty, from a local modal fit.

A half-power width read off the lines is biased as soon as the resolution is not far below it (0.0163 instead of 0.0119
at 61 Hz on a 0.25 Hz grid). A fit is not: near its peaks a compliance is

    H(w) = sum_p [ r_p / (j w - s_p) + conj(r_p) / (j w - conj(s_p)) ] + c_0 + c_1 (f - f_0),
    s_p = 2 pi f_p (-zeta_p + j sqrt(1 - zeta_p^2)),

with complex residues r and complex remainders c for the modes outside the fitted band. It is linear in r and c, so
only f_p and zeta_p are searched (variable projection: Golub and Pereyra 1973).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import xarray as xr
from scipy import ndimage, optimize, signal

from process.errors import InputError
from process.labels import check_compliance
from process.types import Complex, Real

CLEAR_SIGNIFICANCE = 4.0
"""How many times more significant than another a peak must be that is low beside the highest one."""

_LARGEST_DAMPING = 0.5
_MOST_POLES = 4  # fitted together; more overlapping peaks than that are no longer peaks


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
        `CLEAR_SIGNIFICANCE` times `significance`: a mode of the same mass and damping at five times the frequency has
        1/25 of the compliance, and is a mode all the same.
    floor : float, optional
        Below this share of the highest peak nothing counts, however clear [1]: 60 dB down begins what the recording
        itself adds.
    width : float, optional
        Half-power widths fitted to each side of a peak; 3 to 6 together is the compromise between noise and the
        neighbours that the remainders can no longer describe.
    """

    significance: float = 5.0
    prominence: float = 0.1
    height: float = 0.02
    clear: float = 0.5
    floor: float = 0.001
    width: float = 2.5


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


def peak_table(dataset: xr.Dataset, rules: PeakRules | None = None) -> pd.DataFrame:
    """Return the peaks of every entry of a compliance matrix, one row a peak.

    Parameters
    ----------
    dataset : xarray.Dataset
        ``compliance(frequency, response, excitation)`` [m/N] and, where known, ``compliance_std``.
    rules : PeakRules, optional
        What counts as a peak.

    Returns
    -------
    pandas.DataFrame
        response, excitation, and the fields of `Peak`, amplitudes in um/N.

    Raises
    ------
    InputError
        When the compliance has further dimensions.
    """
    rows = []
    for response, excitation in entries(dataset):
        for peak in entry_peaks(dataset, response, excitation, rules):
            rows.append(
                {
                    "response": response,
                    "excitation": excitation,
                    "frequency_Hz": peak.frequency,
                    "frequency_std_Hz": peak.frequency_std,
                    "damping": peak.damping,
                    "damping_std": peak.damping_std,
                    "amplitude_um_per_N": 1e6 * peak.amplitude,
                    "amplitude_std_um_per_N": 1e6 * peak.amplitude_std,
                    "misfit": peak.misfit,
                }
            )
    columns = ["response", "excitation", "frequency_Hz", "frequency_std_Hz", "damping", "damping_std"]
    return pd.DataFrame(rows, columns=[*columns, "amplitude_um_per_N", "amplitude_std_um_per_N", "misfit"])


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
    clear = (rises >= rules.clear * size[tops]) & (rises >= CLEAR_SIGNIFICANCE * rules.significance * noise[tops])
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
            if guess.frequency - group[-1].frequency > reach or len(group) == _MOST_POLES:
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


def _basis(f: Real, poles: Real, centre: float) -> Real:
    """Return the model matrix for (Re r, Im r) of each pole and the remainders, real part over imaginary part.

    Parameters
    ----------
    f : ndarray, shape (n,)
        Frequency [Hz].
    poles : ndarray, shape (poles, 2)
        Frequency [Hz] and damping ratio.
    centre : float
        f_0 [Hz].

    Returns
    -------
    ndarray, shape (2 n, 2 poles + 4)
    """
    columns = []
    for frequency, damping in poles:
        s = 2.0 * np.pi * frequency * (-damping + 1j * np.sqrt(1.0 - damping**2))
        near, far = 1.0 / (2j * np.pi * f - s), 1.0 / (2j * np.pi * f - np.conj(s))
        # Residues in units of the half bandwidth, so that all columns have the size of one.
        scale = 2.0 * np.pi * frequency * damping
        columns += [scale * (near + far), scale * 1j * (near - far)]
    one, slope = np.ones_like(f), (f - centre) / (f[-1] - f[0])
    columns += [one + 0j, 1j * one, slope + 0j, 1j * slope]
    matrix = np.stack(columns, axis=1)
    return np.concatenate([matrix.real, matrix.imag])


@dataclass(frozen=True)
class _Fit:
    """A converged fit: poles, linear coefficients, covariance of both together (poles first)."""

    poles: Real
    linear: Real
    covariance: Real
    centre: float
    band: Real
    misfit: float

    def model(self, f: Real, parameters: Real | None = None) -> Complex:
        """Return H [m/N] at frequencies inside the band."""
        count = self.poles.size
        poles = self.poles if parameters is None else parameters[:count].reshape(-1, 2)
        linear = self.linear if parameters is None else parameters[count:]
        # The slope is scaled by the band of the fit, not by that of the frequencies asked for.
        padded = np.concatenate([[self.band[0]], f, [self.band[-1]]])
        value = _basis(padded, poles, self.centre) @ linear
        half = padded.size
        return np.asarray(value[:half] + 1j * value[half:])[1:-1]


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
    fit = None
    for _ in range(2):
        band = _band(f, group, rules)
        if 2 * (band.stop - band.start) <= 4 * len(group) + 4:
            return []
        fit = _fit(f[band], h[band], noise.level[band], noise.given, group, error_lines)
        if fit is None:
            return []
        group = [
            replace(g, frequency=p, width=2.0 * z * p) for g, (p, z) in zip(group, fit.poles.tolist(), strict=True)
        ]
    assert fit is not None
    peaks = [_peak(fit, k, noise.given) for k in range(len(group))]
    return [p for p in peaks if p is not None and p.amplitude >= rules.significance * p.amplitude_std]


def _fit(
    f: Real,
    h: Complex,
    noise: Real,
    given: bool,
    group: Sequence[_Guess],
    error_lines: float,
) -> _Fit | None:
    """Weighted least squares over poles (searched) and residues (solved)."""
    size = float(np.abs(h).max())
    # Each of real and imaginary part has half of the variance. Without a given noise every line counts the same.
    sigma = np.maximum(noise, 1e-9 * size) / np.sqrt(2.0) if given else np.full(f.size, size)
    weight = np.concatenate([1.0 / sigma, 1.0 / sigma])
    data = np.concatenate([h.real, h.imag]) * weight
    centre = 0.5 * (f[0] + f[-1])
    widths = np.array([g.width for g in group])
    first = np.array([g.frequency for g in group])
    start = np.stack([first / widths, np.log(np.clip(widths / (2.0 * first), 1e-4, 0.4))], axis=1)

    def poles(p: Real) -> Real:
        # Frequencies in half-power widths and logarithms of damping: steps of one mean something everywhere.
        pairs = p.reshape(-1, 2)
        return np.stack([pairs[:, 0] * widths, np.exp(pairs[:, 1])], axis=1)

    def residual(p: Real) -> Real:
        matrix = _basis(f, poles(p), centre) * weight[:, None]
        return np.asarray(data - matrix @ np.linalg.lstsq(matrix, data, rcond=None)[0])

    one = np.ones(first.size)
    lower = np.stack([[g.low for g in group] / widths, np.log(1e-5) * one], axis=1).ravel()
    upper = np.stack([[g.high for g in group] / widths, np.log(_LARGEST_DAMPING) * one], axis=1).ravel()
    inside = np.clip(start.ravel(), lower + 1e-9, upper - 1e-9)
    found = optimize.least_squares(residual, inside, bounds=(lower, upper), x_scale=0.3)
    solution = poles(found.x)
    matrix = _basis(f, solution, centre) * weight[:, None]
    linear = np.linalg.lstsq(matrix, data, rcond=None)[0]
    dof = max(2 * f.size - matrix.shape[1] - found.x.size, 1)
    chi = float(np.sum((data - matrix @ linear) ** 2)) / dof
    jacobian = np.concatenate([_pole_columns(f, solution, linear, centre) * weight[:, None], matrix], axis=1)
    covariance = _inverse_gram(jacobian) * error_lines
    if not given or chi > 1.0 + 2.0 * np.sqrt(2.0 / dof):  # a misfit that chance does not explain
        covariance = covariance * chi
    return _Fit(solution, linear, covariance, centre, f, float(np.sqrt(chi)))


def _pole_columns(f: Real, poles: Real, linear: Real, centre: float) -> Real:
    """Return the derivative of the model with respect to the poles, shape (2 n, 2 poles), by central differences."""
    columns = []
    for k in range(poles.size):
        step = 1e-4 * poles[k // 2, 1] * (poles[k // 2, 0] if k % 2 == 0 else 1.0)
        up, down = poles.copy().ravel(), poles.copy().ravel()
        up[k], down[k] = up[k] + step, down[k] - step
        change = _basis(f, up.reshape(-1, 2), centre) - _basis(f, down.reshape(-1, 2), centre)
        columns.append(change @ linear / (2.0 * step))
    return np.stack(columns, axis=1)


def _inverse_gram(jacobian: Real) -> Real:
    """Return ``(J^T J)^-1``, scaled column by column first so that Hz and m/N do not meet."""
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    _, singular, right = np.linalg.svd(jacobian / scale, full_matrices=False)
    inverse = (right.T / np.maximum(singular, 1e-12 * singular[0]) ** 2) @ right
    return np.asarray(inverse / np.outer(scale, scale))


def _peak(fit: _Fit, k: int, given: bool) -> Peak | None:
    """Return peak number k of a fit, or None when it ran away."""
    frequency, damping = (float(v) for v in fit.poles[k])
    width = 2.0 * damping * frequency
    std = np.sqrt(np.diag(fit.covariance)[2 * k : 2 * k + 2])
    outside = not fit.band[0] < frequency < fit.band[-1]
    if outside or damping > 0.99 * _LARGEST_DAMPING or not std[0] < width or not std[1] < damping:
        return None
    low, high = max(fit.band[0], frequency - width), min(fit.band[-1], frequency + width)
    fine = np.linspace(low, high, 801)
    top = fine[[int(np.argmax(np.abs(fit.model(fine))))]]
    amplitude = float(np.abs(fit.model(top))[0])
    gradient = _amplitude_gradient(fit, top)
    amplitude_std = float(np.sqrt(np.maximum(gradient @ fit.covariance @ gradient, 0.0)))
    own = fit.covariance[2 * k : 2 * k + 2]
    with np.errstate(divide="ignore", invalid="ignore"):  # a peak of an exact curve claims no error
        related = np.nan_to_num(np.array([own[0, 2 * k + 1] / std[1], *(own @ gradient / amplitude_std)]))
        related = np.nan_to_num(related / std[[0, 0, 1]])
    return Peak(
        frequency=frequency,
        frequency_std=float(std[0]),
        damping=damping,
        damping_std=float(std[1]),
        amplitude=amplitude,
        amplitude_std=amplitude_std,
        misfit=fit.misfit if given else float("nan"),
        correlation=(float(related[0]), float(related[1]), float(related[2])),
    )


def _amplitude_gradient(fit: _Fit, top: Real) -> Real:
    """Return the derivative of ``|H|`` at its maximum with respect to all parameters.

    The maximum does not move to first order when the parameters do, so the gradient is taken at a fixed frequency.
    """
    parameters = np.concatenate([fit.poles.ravel(), fit.linear])
    spread = np.sqrt(np.diag(fit.covariance))
    gradient = np.zeros(parameters.size)
    for i, step in enumerate(1e-3 * spread):
        if step > 0.0:
            up, down = parameters.copy(), parameters.copy()
            up[i], down[i] = up[i] + step, down[i] - step
            difference = np.abs(fit.model(top, up)) - np.abs(fit.model(top, down))
            gradient[i] = float(difference[0]) / (2.0 * step)
    return gradient
