"""Steps of a stepped sine: sine fits, and the stretches of a force that are a sine of constant frequency.

Sine fits: IEEE Std 1057.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage, signal

from process.types import Complex, Real
from smfe.identification.actuator.rules import RULES


@dataclass(frozen=True)
class StepRules:
    """How steps are found and judged.

    Parameters
    ----------
    settling : float, optional
        Time dropped at the beginning of each step [s]. Default: the first half of the step, or more, up to seven
        eighths, where by `stationary` that was not enough.
    minimum_cycles : int, optional
        A step is fitted over at least this many cycles.
    force_r_squared : float, optional
        Least coefficient of determination of the force; below, it is no constant sine.
    stationary : float, optional
        A step has settled when the compliances of the two halves of its fitted part differ by less than this share
        [1], or by less than three standard deviations.
    flat : float, optional
        The force is constant when its amplitude varies by no more than this over the steps of a record, largest over
        smallest [1].
    frequency_tolerance : float, optional
        Steps whose frequencies differ by less than this share [1] are one frequency. Half a percent of the half-power
        width of a mode with 2 % damping by default; nothing is interpolated.
    """

    settling: float | None = None
    minimum_cycles: int = 4
    force_r_squared: float = 0.9
    stationary: float = 0.01
    flat: float = 1.1
    frequency_tolerance: float = 2e-4


@dataclass(frozen=True)
class SineFit:
    """A sine fitted to samples, ``Re(amplitude exp(j w t)) + offset``, t = 0 at the first sample.

    Parameters
    ----------
    frequency : float
        [Hz].
    amplitude : complex
        Peak amplitude, unit of the samples.
    offset : float
        Unit of the samples.
    r_squared : float
        Coefficient of determination [1].
    variance : float
        Of the residual, ``SS_res / (n - parameters)``.
    thd : float
        Total harmonic distortion, ``sqrt(sum_{h=2..5} |A_h|^2) / |A_1|``, of the harmonics below half the sampling
        rate.
    samples : int
        n.
    harmonics : tuple of float
        ``|A_h|/|A_1|`` for h = 2, 3, 4, 5; NaN from half the sampling rate on.
    """

    frequency: float
    amplitude: complex
    offset: float
    r_squared: float
    variance: float
    thd: float
    samples: int
    harmonics: tuple[float, ...] = ()

    def values(self, dt: float) -> Real:
        """Return the fitted sine with its offset at the n samples, shape (n,)."""
        angle = 2.0 * np.pi * self.frequency * dt * np.arange(self.samples)
        return np.asarray((self.amplitude * np.exp(1j * angle)).real + self.offset)

    @property
    def amplitude_variance(self) -> float:
        """Variance ``E |dA|^2 = 4 s^2/n`` of the complex amplitude for white noise: 2 s^2/n in each part."""
        return 4.0 * self.variance / self.samples


# --- sine fits -----------------------------------------------------------------------------------------------------


def _basis(frequency: float, count: int, dt: float, harmonics: int) -> Real:
    """Return columns cos, -sin of each harmonic and a constant, so that (a, b) is the amplitude a + j b."""
    angle = 2.0 * np.pi * frequency * dt * np.arange(count)
    columns = [part for h in range(1, harmonics + 1) for part in (np.cos(h * angle), -np.sin(h * angle))]
    return np.stack([*columns, np.ones(count)], axis=1)


def fit_sine(samples: Real, dt: float, frequency: float, fitted_frequency: bool = False) -> SineFit:
    """Fit a sine of known frequency (three parameters).

    Parameters
    ----------
    samples : ndarray, shape (n,)
        The signal.
    dt : float
        Sampling interval [s].
    frequency : float
        [Hz].
    fitted_frequency : bool, optional
        Whether the frequency comes from these samples; then a fourth degree of freedom is spent.
    """
    n = samples.size
    basis = _basis(frequency, n, dt, 1)
    a, b, offset = _least_squares(basis, samples)
    residual = samples - basis @ np.array([a, b, offset])
    rss = float(residual @ residual)
    tss = float(np.sum((samples - samples.mean()) ** 2))
    harmonics = _harmonics(samples, dt, frequency)
    return SineFit(
        frequency=frequency,
        amplitude=complex(a, b),
        offset=float(offset),
        r_squared=max(1.0 - rss / tss, 0.0) if tss > 0.0 else 0.0,
        variance=rss / max(n - (4 if fitted_frequency else 3), 1),
        thd=float("nan") if np.isnan(harmonics).all() else float(np.sqrt(np.nansum(np.square(harmonics)))),
        samples=n,
        harmonics=harmonics,
    )


def _harmonics(samples: Real, dt: float, frequency: float) -> tuple[float, ...]:
    """Return the amplitudes of the second to the fifth harmonic over that of the first."""
    highest = min(RULES.harmonics, int(0.5 / (frequency * dt) * (1.0 - 1e-6)))
    found = np.full(RULES.harmonics - 1, np.nan)
    if highest >= 2:
        parts = _least_squares(_basis(frequency, samples.size, dt, highest), samples)
        size = np.hypot(parts[0:-1:2], parts[1::2])
        if size[0] > 0.0:
            found[: highest - 1] = size[1:] / size[0]
    return tuple(found.tolist())


def neighbour_lines(residuals: Real, dt: float, frequency: float) -> Complex:
    """Return what is left of fitted sines beside their frequency, in amplitudes: the noise that also sits on the line.

    ``2/n sum_t r(t) exp(-j 2 pi (f + k/T) t)``, k = -8 .. 8 but for 0, lines at or below zero, next to a harmonic, or
    above half the sampling rate. Their mean power is ``E |dA|^2`` of a fitted amplitude, for coloured noise as well as
    white, and without what distortion adds to the residual elsewhere.

    Parameters
    ----------
    residuals : ndarray, shape (channels, n)
        Samples less the sines fitted to them, over whole cycles.
    dt : float
        Sampling interval [s].
    frequency : float
        f [Hz].

    Returns
    -------
    ndarray of complex, shape (channels, lines)
        Two degrees of freedom a line.
    """
    n = residuals.shape[1]
    cycles = frequency * n * dt
    k = np.arange(-RULES.neighbours, RULES.neighbours + 1)
    place = cycles + k
    harmonic = np.arange(2, RULES.harmonics + 5) * cycles
    clear = np.all(np.abs(place[:, None] - harmonic) > 0.9, axis=1)
    used = place[(k != 0) & clear & (place > 0.6) & (place < 0.5 * n - 0.6)]
    angle = -2j * np.pi * np.outer(np.arange(n), used) / n
    return np.asarray(2.0 / n * residuals @ np.exp(angle))


def refine_frequency(samples: Real, dt: float, frequency: float) -> float:
    """Return the frequency [Hz] of the sine that fits best (four parameters, Gauss-Newton).

    Each step solves ``A cos wt + B sin wt + C + dw t (B cos wt - A sin wt)`` for A, B, C and dw (IEEE Std 1057). Time
    is counted from the middle, which makes frequency and phase nearly independent.

    Parameters
    ----------
    samples : ndarray, shape (n,)
        The signal.
    dt : float
        Sampling interval [s].
    frequency : float
        First guess [Hz], good to a fraction of 1/(n dt).
    """
    t = np.linspace(-1.0, 1.0, samples.size)
    half = 0.5 * (samples.size - 1) * dt
    w = 2.0 * np.pi * frequency * half
    one = np.ones_like(t)
    a, b, _ = _least_squares(np.stack([np.cos(w * t), np.sin(w * t), one], axis=1), samples)
    for _ in range(20):
        cos, sin = np.cos(w * t), np.sin(w * t)
        a, b, _, change = _least_squares(np.stack([cos, sin, one, t * (b * cos - a * sin)], axis=1), samples)
        change = float(np.clip(change, -0.5 * np.pi, 0.5 * np.pi))  # half a line; further, linearity means nothing
        w = w + change
        if abs(change) < 1e-12 * w:
            break
    return float(w / (2.0 * np.pi * half))


def _least_squares(basis: Real, samples: Real) -> Real:
    """Solve by the normal equations: over some cycles the columns are nearly orthogonal, and there are thousands."""
    gram, right = basis.T @ basis, basis.T @ samples
    try:
        return np.asarray(np.linalg.solve(gram, right))
    except np.linalg.LinAlgError:  # a silent force
        return np.asarray(np.linalg.lstsq(gram, right, rcond=None)[0])


# --- finding steps -------------------------------------------------------------------------------------------------


def find_steps(force: Real, dt: float) -> list[tuple[int, int, float]]:
    """Find the stretches in which a force is a sine of constant frequency and amplitude.

    1. Frames of four cycles of the lowest frequency (below which 0.5 % of the energy lies), an eighth of a frame
       apart: the frequency of a frame is the interpolated maximum of its Hann spectrum.
    2. A run is a series of frames between which the frequency changes no more than its usual scatter (six median
       changes, at least a hundredth of a line).
    3. A sine is fitted to the middle of the run; the step reaches as far as the force, averaged over a cycle, stays
       with that sine in phase (0.05 rad, or four times its scatter) and amplitude (20 %).
    4. A step whose phase bends over its length is a stretch of a continuous sweep, or mixes two steps: dropped.
    5. What is left of a run is searched with frames twice as long, which separate closer frequencies.

    Parameters
    ----------
    force : ndarray, shape (n,)
        [N].
    dt : float
        Sampling interval [s].

    Returns
    -------
    list of (start, stop, frequency)
        Samples (stop exclusive) and frequency [Hz].
    """
    force = force - force.mean()
    if not np.any(force):
        return []
    frame = max(int(np.ceil(4.0 / (_lowest_frequency(force, dt) * dt))), 32)
    largest = float(np.abs(force).max())
    found: list[tuple[int, int, float]] = []
    pending = [(0, force.size, min(frame, force.size))]
    while pending:
        low, high, frame = pending.pop()
        for start, stop, frequency in _steady_runs(force[low:high], dt, frame, largest):
            start, stop = start + low, stop + low
            if any(a <= (start + stop) // 2 < b for a, b, _ in found):
                continue
            step = _grown(force, start, stop, frequency, dt)
            if step is not None and not any(_shared(step, other) > 0.5 for other in found):
                found.append(step)
            first, last = step[:2] if step is not None else (stop, stop)
            rest = [(start, min(first, stop)), (max(last, start), stop)]
            pending += [(a, b, 2 * frame) for a, b in rest if b - a >= 8 * frame]
    return sorted(found)


def _lowest_frequency(force: Real, dt: float) -> float:
    energy = np.cumsum(np.abs(fft.rfft(force)) ** 2)
    line = int(np.searchsorted(energy, 0.005 * energy[-1]))
    return max(line, 1) / (force.size * dt)


def _frame_frequencies(force: Real, starts: NDArray[np.intp], frame: int, dt: float) -> tuple[Real, Real]:
    """Return frequency [Hz] and amplitude of the strongest line of each frame (parabola through its logarithm)."""
    window = signal.get_window("hann", frame)
    padded = fft.next_fast_len(4 * frame, real=True)
    frequency, size = np.empty(starts.size), np.empty(starts.size)
    for k, start in enumerate(starts):
        spectrum = np.abs(fft.rfft(force[start : start + frame] * window, padded))
        top = int(np.clip(np.argmax(spectrum), 1, spectrum.size - 2))
        low, mid, high = np.log(spectrum[top - 1 : top + 2] + 1e-300)
        bend = low - 2.0 * mid + high
        shift = 0.5 * (low - high) / bend if bend < 0.0 else 0.0
        frequency[k] = (top + np.clip(shift, -1.0, 1.0)) / (padded * dt)
        size[k] = spectrum[top]
    return frequency, size


def _steady_runs(force: Real, dt: float, frame: int, largest: float) -> list[tuple[int, int, float]]:
    """Return start, stop and frequency of runs of frames whose frequency stays, the longest first."""
    starts = np.arange(0, force.size - frame + 1, max(frame // 8, 1))
    frequency, size = _frame_frequencies(force, starts, frame, dt)
    change = np.abs(np.diff(frequency))
    scatter = float(np.median(change)) if change.size else 0.0
    # A hundredth of a line is what negative frequencies do to a short frame, noise or not.
    limit = max(6.0 * scatter, 0.01 / (frame * dt))
    strong = size > 0.01 * largest * 0.5 * frame  # 0.5 frame: gain of the Hann window
    joined = (change <= limit) & strong[1:] & strong[:-1]
    edges = [0, *(np.flatnonzero(~joined) + 1).tolist(), starts.size]
    runs = [(a, b) for a, b in pairwise(edges) if strong[a] and (b - a > 2 or starts.size <= 2)]
    runs.sort(key=lambda run: run[0] - run[1])
    return [(int(starts[a]), int(starts[b - 1]) + frame, float(np.median(frequency[a:b]))) for a, b in runs]


def _shared(step: tuple[int, int, float], other: tuple[int, int, float]) -> float:
    """Return how much of the shorter step lies in the other one [1]."""
    common = min(step[1], other[1]) - max(step[0], other[0])
    return max(common, 0) / min(step[1] - step[0], other[1] - other[0])


def _grown(force: Real, start: int, stop: int, frequency: float, dt: float) -> tuple[int, int, float] | None:
    """Return the extent of a step, found again from its own middle while that makes it longer."""
    step = _extent(force, start, stop, frequency, dt)
    for _ in range(5):
        longer = _extent(force, *step, dt) if step is not None else None
        if step is None or longer is None or longer[1] - longer[0] <= 1.02 * (step[1] - step[0]):
            break
        step = longer
    return step


def _extent(force: Real, start: int, stop: int, frequency: float, dt: float) -> tuple[int, int, float] | None:
    """Return where the force stays with the sine fitted to the middle of a run, or None when it is no step."""
    quarter = (stop - start) // 4
    middle = slice(start + quarter, stop - quarter)
    frequency = refine_frequency(force[middle], dt, frequency)
    if not 0.0 < frequency * dt < 0.5:
        return None
    low, high = max(2 * start - stop, 0), min(2 * stop - start, force.size)
    relative, limit = _relative_to_sine(force, slice(low, high), middle, frequency, dt)
    if limit > 1.0:  # the middle is no sine of one frequency
        return None
    near = (np.abs(np.angle(relative)) <= limit) & (np.abs(np.abs(relative) - 1.0) <= max(0.2, limit))
    # An excursion of noise lasts a cycle, over which was averaged; the next step lasts.
    brief = np.ones(2 * max(round(0.5 / (frequency * dt)), 1) + 1, dtype=bool)
    with_it = ndimage.binary_erosion(ndimage.binary_dilation(near, brief), brief, border_value=1)
    centre = (start + stop) // 2 - low
    left, right = np.flatnonzero(~with_it[:centre]), np.flatnonzero(~with_it[centre:])
    first = int(left[-1]) + 1 if left.size else 0
    last = centre + int(right[0]) if right.size else with_it.size
    if (last - first) * dt * frequency < 4.0:
        return None
    inside = near[first:last]
    x = np.linspace(-1.0, 1.0, last - first)[inside]
    bend = np.polynomial.legendre.legfit(x, np.angle(relative[first:last][inside]), 2)[2]
    # A chirp bends by the whole limit (|c| = 2/3 of it), a step by its scatter over many cycles.
    return None if abs(bend) > 0.45 * limit else (low + first, low + last, frequency)


def _relative_to_sine(force: Real, part: slice, middle: slice, frequency: float, dt: float) -> tuple[Complex, float]:
    """Return the force as a complex multiple of the sine in the middle, and the limit of its phase [rad]."""
    mixed = force[part] * np.exp(-2j * np.pi * frequency * dt * np.arange(part.start, part.stop))
    cycle = max(round(1.0 / (frequency * dt)), 1)
    averaged = ndimage.uniform_filter1d(mixed.real, cycle) + 1j * ndimage.uniform_filter1d(mixed.imag, cycle)
    inner = averaged[middle.start - part.start : middle.stop - part.start]
    reference = complex(inner.mean())
    if reference == 0.0:
        return np.zeros_like(averaged), 0.05
    return averaged / reference, max(0.05, 4.0 * float(np.std(np.angle(inner / reference))))
