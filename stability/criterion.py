"""Spectral chatter criterion: a peak that is no harmonic and exceeds half of the highest tooth harmonic.

The paper says no more than that. What is added here, and why (theory 5):

- *Harmonic* means every spindle order: run-out alone puts lines of 0.3 of the tooth line on orders 1, 2, ...
- Order Z/2 of an even number of teeth Z (and its odd multiples) is where period doubling shows, and also an
  order. It is judged separately: against a reference cut, or by its growth along the cut; else it is
  *undecided*.
- An order is masked by +-3 bins (the Hann main lobe is +-2) plus what the speed may be wrong, growing with
  the order.
- The speed is refined from the record, because 0.3 % of speed error over 4 s makes a stable cut look like
  chatter.
- The last part of the cut is used: transients of the entry trigger the criterion 3 to 10 % below the limit.
- The highest tooth harmonic is not let below an absolute floor: a slot with 4 equal teeth has no tooth line
  in x at all.
- A record in which nothing reaches that floor says nothing about the cut: a dead sensor, a wrong unit or air look
  the same. It is *undecided*.
- What stands inside a mask is not declared stable: it is *undecided*, and the record length that would
  separate it is said.
- The quantity is not stated in the paper and matters, because the ratio changes by ``(f_c/f_T)^2`` between
  displacement and acceleration. The default is the acceleration as recorded; the result says which.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.compliance import displacement_over_acceleration
from process.errors import InputError
from process.labels import UNITS, axis_present, check_record, sample_interval
from stability.line_spectrum import (
    STANDS_OUT,
    LineSpectrum,
    comb_speed,
    hann_spectrum,
    highest_visible_order,
    noise_rms,
    order_phasors,
    without_orders,
)

Verdict = Literal["stable", "chatter", "undecided"]

QUANTITIES: tuple[str, ...] = ("acceleration", "displacement", "force")

DEFAULT_FLOOR: dict[str, float] = {"acceleration": 0.1, "displacement": 1e-6, "force": 5.0}
"""Least amplitude that counts as the highest tooth harmonic [m/s2, m, N]."""

MASK_BINS = 3.0
"""Half width of the mask of an order [bins of 1/T]."""

SPEED_VARIATION = 5e-4
"""Relative variation of the speed within the record that the masks allow for [1]."""

FEWEST_TURNS = 6
"""Below this number of turns the masks of neighbouring orders meet."""

HIGHEST_SHARE_OF_SAMPLE_RATE = 0.4
"""Default upper end of the band, in sample rates: above it anti-alias filters act."""

SPEED_MISMATCH = 0.01
"""Relative difference between a recorded and the given speed above which one of them must be wrong [1]."""

SPEED_PIECES = 32
"""Most pieces on whose means a recorded speed is tested for being constant."""

GROWTH = 3.0
"""Growth of order Z/2 from the first to the last quarter of the cut that run-out cannot explain."""


@dataclass(frozen=True)
class ChatterVerdict:
    """What the criterion says of one record.

    Parameters
    ----------
    verdict : {"stable", "chatter", "undecided"}
        The verdict.
    ratio : float
        Amplitude of the largest non-harmonic peak over that of the highest tooth harmonic (or of the floor)
        [1]; for period doubling, of order Z/2.
    chatter_frequency_Hz : float
        Frequency of that peak; NaN when the cut is stable.
    tooth_passing_harmonic_Hz : float
        Frequency of the highest tooth passing harmonic; NaN when none could be read.
    spindle_speed_rpm : float
        Spindle speed as refined from the record.
    reason : str
        The verdict in one sentence, with its numbers.
    spectrum : xarray.Dataset
        ``amplitude(axis, frequency)``, ``vector_amplitude(frequency)``, ``harmonic(frequency)`` (true where
        masked).
    quantity : str
        What has been judged, e.g. "acceleration" or "displacement from acceleration".
    axes : tuple of str
        Axes whose amplitudes are combined (root of the sum of squares).
    threshold, guard_band : float
        The threshold, and the distance from it within which noise leaves the verdict open [1].
    resolution_Hz : float
        One over the length of the part that has been judged.
    interval_s : (float, float)
        That part of the record.
    half_order_ratio : float
        Highest odd multiple of order Z/2 over the highest tooth harmonic; NaN for an odd number of teeth.
    """

    verdict: Verdict
    ratio: float
    chatter_frequency_Hz: float
    tooth_passing_harmonic_Hz: float
    spindle_speed_rpm: float
    reason: str
    spectrum: xr.Dataset = field(repr=False)
    quantity: str
    axes: tuple[str, ...]
    threshold: float
    guard_band: float
    resolution_Hz: float
    interval_s: tuple[float, float]
    half_order_ratio: float


@dataclass(frozen=True)
class _Part:
    """The samples that are judged, and the whole cut they are taken from; shapes (axes, n)."""

    samples: NDArray[np.float64]
    cut: NDArray[np.float64]
    dt: float
    interval: tuple[float, float]

    @property
    def duration(self) -> float:
        return float(self.samples.shape[1] * self.dt)


@dataclass(frozen=True)
class _Evidence:
    """Everything the rules look at."""

    spectrum: LineSpectrum
    amplitude: NDArray[np.float64]
    left: NDArray[np.float64]
    masked: NDArray[np.bool_]
    base: float
    speed_error: float
    tooth_frequency: float
    tooth_amplitude: float
    denominator: float
    floor: float
    unit: str
    threshold: float
    teeth: int
    half: tuple[float, float]
    half_growth: float
    half_reference: float | None

    def peak(self, where: NDArray[np.bool_], amplitude: NDArray[np.float64]) -> tuple[float, float]:
        """Return frequency and amplitude of the highest of the points marked; NaN, 0 for none."""
        if not where.any():
            return math.nan, 0.0
        top = int(np.argmax(np.where(where, amplitude, -1.0)))
        return float(self.spectrum.frequency[top]), float(amplitude[top])

    @property
    def candidate(self) -> tuple[float, float]:
        """Frequency and amplitude of the largest peak that is not a harmonic.

        A shoulder of a masked order is no peak: the point must be a local maximum.
        """
        inner = self.amplitude[1:-1]
        local = np.zeros(self.amplitude.size, dtype=bool)
        local[1:-1] = (inner >= self.amplitude[:-2]) & (inner >= self.amplitude[2:])
        return self.peak(local & ~self.masked, self.amplitude)

    @property
    def highest(self) -> float:
        """Highest amplitude in the band, spindle orders included."""
        return float(self.amplitude.max(initial=0.0))

    @property
    def tooth_line(self) -> float:
        """Frequency of the highest tooth harmonic [Hz]; NaN when it does not stand out of the noise."""
        if math.isnan(self.tooth_frequency):
            return math.nan
        noise = noise_rms(self.spectrum, self.amplitude, ~self.masked, self.tooth_frequency)
        return self.tooth_frequency if self.tooth_amplitude > STANDS_OUT * noise else math.nan

    @property
    def ratio(self) -> float:
        """Candidate over tooth harmonic."""
        return self.candidate[1] / self.denominator

    @property
    def noise(self) -> float:
        """Rms noise amplitude around the candidate."""
        frequency = self.candidate[0]
        where = self.teeth * self.base if math.isnan(frequency) else frequency
        return noise_rms(self.spectrum, self.amplitude, ~self.masked, where)

    @property
    def guard(self) -> float:
        """Two standard deviations of the ratio, from the noise on both amplitudes."""
        return self.noise / self.denominator * math.sqrt(2.0 * (1.0 + self.threshold**2))


@dataclass(frozen=True)
class _Finding:
    """What one rule concludes."""

    verdict: Verdict
    ratio: float
    frequency: float
    reason: str


def chatter_verdict(
    record: xr.Dataset,
    rotation: float,
    teeth: int,
    *,
    quantity: str | None = None,
    axes: Sequence[str] | None = None,
    threshold: float = 0.5,
    frequency_range: tuple[float, float | None] = (5.0, None),
    speed_tolerance: float = 0.005,
    floor: float | None = None,
    interval: tuple[float, float] | None = None,
    half_order_reference: float | None = None,
) -> ChatterVerdict:
    """Return whether a record shows chatter: a non-harmonic peak above half of the highest tooth harmonic.

    Parameters
    ----------
    record : xarray.Dataset
        Record of one cut at constant speed, air before and after it allowed.
    rotation : float
        Nominal spindle rotation [rad/s]; a record with a ``spindle_angle`` or a ``spindle_speed`` must agree.
    teeth : int
        Number of teeth.
    quantity : {"acceleration", "displacement", "force"}, optional
        What is judged; default the first of these that has been recorded. A displacement that has not been
        recorded is had from the acceleration, ``-a/w^2``.
    axes : sequence of str, optional
        Axes to combine; default all that have been recorded.
    threshold : float, optional
        Limit of the ratio [1].
    frequency_range : (float, float or None), optional
        Band [Hz]; the lower end keeps servo and table motion out, the upper end defaults to 0.4 sample rates.
    speed_tolerance : float, optional
        Relative error of the speed, given or recorded, to search [1]; 0 takes the speed as exact. Not used where the
        record has a ``spindle_angle``.
    floor : float, optional
        Least amplitude that counts as tooth harmonic, in the unit of the quantity; default `DEFAULT_FLOOR`.
    interval : (float, float), optional
        Part of the record to judge [s]; default the last half of the cut that is found in it.
    half_order_reference : float, optional
        ``half_order_ratio`` of a stable reference cut with the same tool: what run-out puts there.

    Returns
    -------
    ChatterVerdict
        The verdict with its reason.

    Raises
    ------
    InputError
        For an unusable record or a speed, tooth count or band that makes no sense.
    """
    _check_numbers(rotation, teeth, threshold, speed_tolerance)
    check_record(record)
    chosen, recorded = _choose_quantity(record, quantity)
    names = _choose_axes(record, recorded, axes)
    part = _judged_part(record, recorded, names, 2.0 * math.pi / rotation, interval)
    base, exact = _spindle_frequency(record, part, rotation / (2.0 * math.pi), speed_tolerance)
    band = _band(frequency_range, part, teeth * base)
    least = DEFAULT_FLOOR[chosen] if floor is None else floor
    integrate = chosen != recorded
    evidence = _gather(
        part,
        base,
        teeth,
        band,
        exact,
        speed_tolerance,
        integrate,
        least,
        UNITS[chosen],
        threshold,
        half_order_reference,
    )
    finding = _too_few_turns(part, base) or _judge(evidence)
    return ChatterVerdict(
        verdict=finding.verdict,
        ratio=finding.ratio,
        chatter_frequency_Hz=finding.frequency,
        tooth_passing_harmonic_Hz=evidence.tooth_line,
        spindle_speed_rpm=60.0 * evidence.base,
        reason=finding.reason,
        spectrum=_labelled(evidence, names, UNITS[chosen]),
        quantity="displacement from acceleration" if integrate else chosen,
        axes=tuple(names),
        threshold=threshold,
        guard_band=evidence.guard,
        resolution_Hz=evidence.spectrum.resolution,
        interval_s=part.interval,
        half_order_ratio=evidence.half[1] / evidence.denominator,
    )


# --- what is asked ---------------------------------------------------------------------------------------------------


def _check_numbers(rotation: float, teeth: int, threshold: float, speed_tolerance: float) -> None:
    if not (math.isfinite(rotation) and rotation > 0.0):
        raise InputError(f"the spindle turns at {rotation:g} rad/s; a positive speed is needed")
    if teeth < 1:
        raise InputError(f"the tool has {teeth} teeth; at least one is needed")
    if not threshold > 0.0:
        raise InputError(f"the threshold is {threshold:g}; it must be positive (the paper's is 0.5)")
    if not 0.0 <= speed_tolerance < 0.1:
        raise InputError(f"the speed tolerance is {speed_tolerance:g}; a share between 0 and 0.1 is needed")


def _choose_quantity(record: xr.Dataset, quantity: str | None) -> tuple[str, str]:
    """Return the quantity that is judged and the channel it is had from."""
    recorded = [name for name in QUANTITIES if axis_present(record, name)]
    if quantity is None:
        if not recorded:
            raise InputError(f"the record holds none of {', '.join(QUANTITIES)}; there is nothing to judge")
        return recorded[0], recorded[0]
    if quantity not in QUANTITIES:
        raise InputError(f"quantity '{quantity}' is none of {', '.join(QUANTITIES)}")
    if quantity == "displacement" and quantity not in recorded and "acceleration" in recorded:
        return "displacement", "acceleration"
    if quantity not in recorded:
        raise InputError(f"the record has no {quantity}; it has {', '.join(recorded) or 'nothing to judge'}")
    return quantity, quantity


def _choose_axes(record: xr.Dataset, channel: str, axes: Sequence[str] | None) -> list[str]:
    present = axis_present(record, channel)
    chosen = present if axes is None else list(axes)
    missing = [a for a in chosen if a not in present]
    if missing or not chosen:
        raise InputError(f"{channel} has been recorded on {', '.join(present)}; axis {missing or 'none'} was asked for")
    return chosen


def _band(frequency_range: tuple[float, float | None], part: _Part, tooth: float) -> tuple[float, float]:
    """Return the band [Hz]; below `MASK_BINS` bins the mean leaks."""
    low, high = frequency_range
    sample_rate = 1.0 / part.dt
    top = HIGHEST_SHARE_OF_SAMPLE_RATE * sample_rate if high is None else high
    if not 0.0 <= low < top <= 0.5 * sample_rate:
        raise InputError(
            f"a frequency range of {low:g} to {top:g} Hz at {sample_rate:g} samples a second; "
            "it must rise and end at most at half the sample rate"
        )
    if tooth * 1.01 > top:
        raise InputError(
            f"the tooth passing frequency of {tooth:g} Hz lies above the frequency range, which ends at {top:g} Hz: "
            "sample faster or raise the upper end"
        )
    return max(low, MASK_BINS / part.duration), top


# --- the part of the record ------------------------------------------------------------------------------------------


def _judged_part(
    record: xr.Dataset, channel: str, axes: list[str], turn: float, interval: tuple[float, float] | None
) -> _Part:
    """Return the samples to judge: the given interval, or the last half of the cut."""
    dt = sample_interval(record)
    time = record["time"].values
    samples = record[channel].sel(axis=axes).transpose("axis", "time").values.astype(float)
    if interval is not None:
        first, last = np.searchsorted(time, interval)
        if last - first < 16:
            raise InputError(
                f"the interval {interval[0]:g} to {interval[1]:g} s holds {max(last - first, 0)} samples of a record "
                f"from {time[0]:g} to {time[-1]:g} s; give one with more"
            )
        begin = first
    else:
        # The force is nearly zero in air: it shows the cut best where it has been recorded.
        shows = "force" if axis_present(record, "force") else channel
        every = record[shows].sel(axis=axis_present(record, shows)).transpose("axis", "time").values.astype(float)
        first, last = _find_cut(every, max(2, round(turn / dt)), shows == "force")
        begin = (first + last) // 2
    bounds = float(time[begin]), float(time[last - 1])
    return _Part(samples[:, begin:last], samples[:, first:last], dt, bounds)


def _find_cut(samples: NDArray[np.float64], turn: int, static: bool) -> tuple[int, int]:
    """Return first and last sample of the longest stretch of turns that is not air, less its last turn (the exit).

    A turn counts as cut when its level exceeds a fifth of the 95 % quantile. The level is the standard deviation
    within the turn; with `static` (forces) the departure of its mean from the record's quieter end counts too, because
    a slot with many teeth cuts with a constant force.
    """
    n = samples.shape[1]
    blocks = n // turn
    if blocks < 4:
        return 0, n
    turns = samples[:, : blocks * turn].reshape(samples.shape[0], blocks, turn)
    power = turns.var(axis=2).sum(axis=0)
    if static:
        means = turns.mean(axis=2)
        air = means[:, :1] if power[0] <= power[-1] else means[:, -1:]
        power = power + ((means - air) ** 2).sum(axis=0)
    level = np.sqrt(power)
    loud = np.concatenate([[False], level > 0.2 * np.quantile(level, 0.95), [False]])
    edges = np.flatnonzero(np.diff(loud.astype(int)))
    starts, stops = edges[::2], edges[1::2]
    if starts.size == 0:
        return 0, n
    longest = int(np.argmax(stops - starts))
    start, stop = int(starts[longest]), int(stops[longest])
    if stop == blocks:
        return start * turn, n
    return start * turn, max(stop - 1, start + 1) * turn


def _spindle_frequency(record: xr.Dataset, part: _Part, nominal: float, tolerance: float) -> tuple[float, bool]:
    """Return the spindle frequency [Hz] to start from, and whether the record states it exactly."""
    inside = (record["time"] >= part.interval[0]) & (record["time"] <= part.interval[1])
    time = record["time"].values[inside.values]
    if "spindle_angle" not in record:
        return _recorded_speed(record, inside.values, nominal, tolerance), tolerance == 0.0
    angle = np.unwrap(record["spindle_angle"].values[inside.values])
    half = angle.size // 2
    slopes = [np.polyfit(t - t[0], a, 1)[0] for t, a in ((time[:half], angle[:half]), (time[half:], angle[half:]))]
    _check_constant(np.array(slopes) * 30.0 / np.pi)
    measured = float(np.polyfit(time - time[0], angle, 1)[0]) / (2.0 * math.pi)
    _check_same(measured, nominal, tolerance, "the spindle angle of the record turns at")
    return measured, True


def _recorded_speed(record: xr.Dataset, inside: NDArray[np.bool_], nominal: float, tolerance: float) -> float:
    """Return the median of the recorded spindle speed [Hz], `nominal` where none has been recorded."""
    if "spindle_speed" not in record:
        return nominal
    speed = record["spindle_speed"].values[inside].astype(float)
    if np.isnan(speed).all():
        return nominal
    # Means, because every sample of a measured speed carries noise; a piece is a turn at least.
    turn = sample_interval(record) * nominal
    pieces = int(np.clip(speed.size * turn, 2, SPEED_PIECES))
    _check_constant(np.array([piece.mean() for piece in np.array_split(speed, pieces)]))
    measured = float(np.median(speed)) / 60.0
    _check_same(measured, nominal, tolerance, "the recorded spindle speed is")
    return measured


def _check_same(measured: float, nominal: float, tolerance: float, what: str) -> None:
    """Refuse a record whose speed [Hz] is not the one given."""
    if abs(measured / nominal - 1.0) > max(tolerance, SPEED_MISMATCH):
        raise InputError(f"{what} {60.0 * measured:g} rpm, {60.0 * nominal:g} rpm were given: correct one of them")


def _check_constant(speed: NDArray[np.float64]) -> None:
    """Refuse a sweep."""
    low, high = float(speed.min()), float(speed.max())
    if high - low > 0.01 * abs(high):
        raise InputError(
            f"the spindle speed varies from {low:g} to {high:g} rpm within the part that is judged; the "
            "criterion needs a constant speed: give an interval in which it is constant"
        )


# --- evidence --------------------------------------------------------------------------------------------------------


def _gather(
    part: _Part,
    base: float,
    teeth: int,
    band: tuple[float, float],
    exact: bool,
    tolerance: float,
    integrate: bool,
    floor: float,
    unit: str,
    threshold: float,
    reference: float | None,
) -> _Evidence:
    """Turn samples into spectra, masks and the amplitudes that the rules compare."""
    raw = hann_spectrum(part.samples, part.dt, band)
    if not exact:
        base = comb_speed(raw, base, teeth, tolerance)
    count = max(teeth, int(band[1] / base))
    error = SPEED_VARIATION + (0.0 if exact else _remaining_error(raw, base, count, tolerance))
    phasors = order_phasors(part.samples, part.dt, base, count)
    scale = np.abs(displacement_over_acceleration(raw.frequency)) if integrate else np.ones(raw.frequency.size)
    spectrum = LineSpectrum(raw.frequency, raw.phasor * scale, raw.resolution)
    amplitude = spectrum.vector_amplitude
    tooth_frequency, tooth_amplitude = _highest_line(spectrum, amplitude, teeth * base, 1, error)
    half = (math.nan, math.nan)
    if teeth % 2 == 0:
        half = _highest_line(spectrum, amplitude, 0.5 * teeth * base, 2, error)
    return _Evidence(
        spectrum=spectrum,
        amplitude=amplitude,
        left=without_orders(raw, phasors, base) * scale,
        masked=_order_mask(spectrum, base, error),
        base=base,
        speed_error=error,
        tooth_frequency=tooth_frequency,
        tooth_amplitude=tooth_amplitude,
        denominator=max(tooth_amplitude, floor),
        floor=floor,
        unit=unit,
        threshold=threshold,
        teeth=teeth,
        half=half,
        half_growth=_growth(part, half[0]),
        half_reference=reference,
    )


def _remaining_error(spectrum: LineSpectrum, base: float, count: int, tolerance: float) -> float:
    """Return the relative error left after the comb: half a bin at the highest order that can be seen."""
    visible = highest_visible_order(spectrum, base, count)
    if visible == 0:
        return tolerance
    return min(tolerance, 0.5 * spectrum.resolution / (visible * base))


def _highest_line(
    spectrum: LineSpectrum, amplitude: NDArray[np.float64], base: float, stride: int, error: float
) -> tuple[float, float]:
    """Return frequency [Hz] and amplitude of the highest of the multiples 1, 1 + stride, ... of `base` in the band."""
    multiples = base * np.arange(1, int(spectrum.frequency[-1] / base) + 1, stride)
    best = (math.nan, 0.0)
    for frequency in multiples[multiples >= spectrum.frequency[0]]:
        near = spectrum.near(float(frequency), spectrum.resolution + error * float(frequency))
        top = float(amplitude[near].max())
        if top > best[1]:
            best = (float(frequency), top)
    return best


def _order_mask(spectrum: LineSpectrum, base: float, error: float) -> NDArray[np.bool_]:
    """Mark ``|f - h base| <= 3/T + error h base`` for every order h >= 1."""
    order = np.maximum(1.0, np.round(spectrum.frequency / base))
    nearest = order * base
    return np.abs(spectrum.frequency - nearest) <= MASK_BINS * spectrum.resolution + error * nearest


def _growth(part: _Part, frequency: float) -> float:
    """Return how much a line has grown from the first to the last quarter of the cut; NaN when there is no line."""
    quarter = part.cut.shape[1] // 4
    if math.isnan(frequency) or quarter * part.dt * frequency < 4.0:
        return math.nan
    pieces = (part.cut[:, :quarter], part.cut[:, -quarter:])
    first, last = (float(np.linalg.norm(order_phasors(p, part.dt, frequency, 1))) for p in pieces)
    return last / first if first > 0.0 else math.inf


# --- rules -----------------------------------------------------------------------------------------------------------


def _too_few_turns(part: _Part, base: float) -> _Finding | None:
    turns = part.duration * base
    if turns >= FEWEST_TURNS:
        return None
    return _Finding(
        "undecided",
        math.nan,
        math.nan,
        f"{part.duration:.3g} s of cut are {turns:.2g} turns, in which no line can be told from a spindle order; at "
        f"least {FEWEST_TURNS} turns ({FEWEST_TURNS / base:.3g} s) are needed, 12 are better",
    )


def _judge(e: _Evidence) -> _Finding:
    """Ask the rules in turn: whether there is a signal, a clear line, period doubling, then what may be hidden."""
    for rule in (_silent, _line, _period_doubling, _hidden, _crowded):
        finding = rule(e)
        if finding is not None:
            return finding
    return _Finding(
        "stable",
        e.ratio,
        math.nan,
        f"the largest non-harmonic peak is {e.ratio:.2g} of {_denominator(e)}, below {e.threshold:g}",
    )


def _denominator(e: _Evidence) -> str:
    """Name what the ratio is taken of."""
    if e.tooth_amplitude < e.denominator:
        return f"the floor {e.denominator:g} (no tooth harmonic reaches it)"
    return f"the highest tooth harmonic at {e.tooth_frequency:.4g} Hz"


def _silent(e: _Evidence) -> _Finding | None:
    """A spectrum of which nothing, not even a spindle order, reaches the floor."""
    if e.highest >= e.floor:
        return None
    return _Finding(
        "undecided",
        e.ratio,
        math.nan,
        f"nothing reaches the floor of {e.floor:g} {e.unit} (the highest line has {e.highest:.2g} {e.unit}), so no cut "
        "is seen: check sensor, unit and interval, or give a lower floor",
    )


def _line(e: _Evidence) -> _Finding | None:
    """A peak that is not a harmonic."""
    frequency, amplitude = e.candidate
    if math.isnan(frequency) or e.ratio < e.threshold - e.guard:
        return None
    what = f"the non-harmonic peak at {frequency:.4g} Hz is {e.ratio:.3g} of {_denominator(e)}"
    if amplitude < STANDS_OUT * e.noise:
        return _Finding("undecided", e.ratio, frequency, f"{what}, but does not stand out of the noise: cut longer")
    if abs(e.ratio - e.threshold) <= e.guard:
        reason = f"{what}: within {e.guard:.2g} of {e.threshold:g}, which the noise leaves open; record longer"
        return _Finding("undecided", e.ratio, frequency, reason)
    return _Finding("chatter", e.ratio, frequency, f"{what}, above {e.threshold:g}")


def _period_doubling(e: _Evidence) -> _Finding | None:
    """Order Z/2 of an even number of teeth: run-out or period doubling."""
    frequency, amplitude = e.half
    ratio = amplitude / e.denominator
    if math.isnan(frequency) or ratio - (e.half_reference or 0.0) < e.threshold:
        return None
    what = (
        f"{frequency:.4g} Hz, an odd multiple of half the tooth passing frequency, is {ratio:.3g} of {_denominator(e)}"
    )
    if e.half_reference is not None:
        reason = f"{what}; the reference cut has {e.half_reference:.3g} there: period doubling"
        return _Finding("chatter", ratio, frequency, reason)
    if e.half_growth > GROWTH:
        reason = f"{what} and has grown {e.half_growth:.3g} times along the cut: period doubling, not run-out"
        return _Finding("chatter", ratio, frequency, reason)
    return _Finding(
        "undecided",
        ratio,
        frequency,
        f"{what}: run-out or period doubling. Give the half_order_ratio of a stable cut as half_order_reference",
    )


def _hidden(e: _Evidence) -> _Finding | None:
    """Something that does not repeat with the spindle, inside the mask of an order."""
    frequency, amplitude = e.peak(e.masked, e.left)
    ratio = amplitude / e.denominator
    if math.isnan(frequency) or ratio < e.threshold:
        return None
    order = max(1, round(frequency / e.base))
    apart = max(abs(frequency - order * e.base), 0.25 * e.spectrum.resolution)
    return _Finding(
        "undecided",
        ratio,
        frequency,
        f"{ratio:.3g} of {_denominator(e)} does not repeat with the spindle, but lies at {frequency:.5g} Hz, "
        f"within the mask of spindle order {order}: chatter close to a harmonic, or a speed that varies. "
        f"About {MASK_BINS / apart:.2g} s of cut would separate them",
    )


def _crowded(e: _Evidence) -> _Finding | None:
    """Masks that hide more than half of the spectrum at the tooth passing frequency."""
    tooth = e.teeth * e.base
    half_width = MASK_BINS * e.spectrum.resolution + e.speed_error * tooth
    if 4.0 * half_width <= e.base:
        return None
    needed = 4.0 * MASK_BINS / max(e.base - 4.0 * e.speed_error * tooth, 0.1 * e.base)
    return _Finding(
        "undecided",
        e.ratio,
        e.candidate[0],
        f"no chatter line is seen, but the masks of the spindle orders ({e.base:.3g} Hz apart, "
        f"+-{half_width:.2g} Hz each) hide more than half of the spectrum; {needed:.2g} s of cut are needed, "
        f"{1.0 / e.spectrum.resolution:.2g} s are there",
    )


def _labelled(e: _Evidence, axes: list[str], unit: str) -> xr.Dataset:
    """Return the spectrum for plotting."""
    data = {
        "amplitude": (("axis", "frequency"), np.abs(e.spectrum.phasor), {"units": unit}),
        "vector_amplitude": ("frequency", e.amplitude, {"units": unit}),
        "harmonic": ("frequency", e.masked, {"units": "1"}),
    }
    coords = {"axis": axes, "frequency": ("frequency", e.spectrum.frequency, {"units": "Hz"})}
    return xr.Dataset(data, coords=coords, attrs={"resolution_Hz": e.spectrum.resolution, "window": "hann"})
