"""Hammer hits: found on the force of a record, and judged one by one.

A hit is a short pulse, or several when the hammer bounces, that rises out of the noise of a force which is quiet
otherwise. It is measured, given a block of the record, and refused when it is overloaded, double or cut short.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from process.errors import InputError
from process.labels import AXES, sample_interval
from process.types import Complex, Real
from smfe.identification.hammer.rules import RULES
from smfe.identification.spectra.spectra import force_samples, motion_axes, record_source

RING = 3
"""Samples before a second pulse within which a filter that rings swings to the other side."""

FAULTS: tuple[str, ...] = ("overloaded", "double_hit", "direction")
"""What keeps a hit out of the average unless the caller says otherwise."""

WRONG_DIRECTION = "wrong direction"
"""How the reason of a hit begins that was made elsewhere than declared."""

_MAD_TO_STD = 1.4826  # of Gaussian noise
_ANTI_ALIAS = 2.56  # sampling rate over the highest frequency a usual converter passes


@dataclass(frozen=True)
class HitRules:
    """How hits are found and judged.

    Parameters
    ----------
    trigger : float, optional
        A pulse rises above this share of the largest force of the record [1]. Low, so that an overloaded hit
        ten times the others does not hide them.
    noise : float, optional
        A pulse rises above this many standard deviations of the force noise (from the median deviation) [1].
    minimum_spacing : float, optional
        Pulses closer than this belong to one hit [s]; a hand hits less than five times a second, a
        hammer bounces faster.
    pre_trigger : float, optional
        Share of the block before the pulse [1], where the record has it.
    double_share : float, optional
        A second pulse above this share of the largest makes a double hit [1].
    full_scale : float, optional
        Range of the force channel [N], where known; hits within 1 % of it are overloaded.
    peak_range : (float, float), optional
        Only hits whose peak force lies within [N] are used: one level of several.
    """

    trigger: float = 0.05
    noise: float = 8.0
    minimum_spacing: float = 0.2
    pre_trigger: float = 0.02
    double_share: float = 0.1
    full_scale: float | None = None
    peak_range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Hit:
    """One hit in a record.

    Parameters
    ----------
    excitation, source, record, number
        Axis, file, position of the record among those of the axis, number of the hit in the record (from 1).
    onset : int
        First sample of the pulse.
    capacity : float
        Longest block the hit allows: to the next hit or the end of the record [s].
    time : float
        When the force peaks [s].
    peak_force, impulse, duration : float
        [N], [N s] (all pulses of the hit), [s] (above 10 % of the peak).
    overloaded : bool
        Whether the force is cut off.
    second_delay, second_force : float
        From the first to the second pulse of a double hit [s], and the smaller of both [N]; NaN for a single
        hit.
    clipped : str
        Response axes that are cut off, e.g. "xz".
    usable_to : float
        Where the force spectrum has fallen by 20 dB [Hz]; NaN when no block fits.
    reason : str
        Why it is not used; empty for a hit that is.
    """

    excitation: str
    source: str
    record: int
    number: int
    onset: int
    capacity: float
    time: float
    peak_force: float
    impulse: float
    duration: float
    overloaded: bool
    second_delay: float
    second_force: float
    clipped: str = ""
    usable_to: float = float("nan")
    reason: str = ""

    @property
    def double(self) -> bool:
        """Whether the hammer bounced."""
        return bool(np.isfinite(self.second_delay))


# --- finding hits -------------------------------------------------------------------------------------------


def find_hits(record: xr.Dataset, excitation: str, index: int = 0, rules: HitRules | None = None) -> list[Hit]:
    """Find the hits in a record.

    Parameters
    ----------
    record : xarray.Dataset
        A record with ``force`` along `excitation`.
    excitation : str
        Axis of the hammer.
    index : int, optional
        Position of the record among those of its axis.
    rules : HitRules, optional
        How hits are found.

    Raises
    ------
    InputError
        When the force holds no pulses, or is not pulses but a vibration.
    """
    rules = rules or HitRules()
    source = record_source(record, index)
    force = force_samples(record, excitation, source)
    level, sign, noise = quiet_state(force)
    pulse = sign * (force - level)
    peak = float(pulse.max())
    threshold = max(rules.trigger * peak, rules.noise * noise)
    if np.mean(pulse > 0.5 * peak) > 0.15 or not peak > threshold:
        raise _no_hammer(source, excitation)
    dt = sample_interval(record)
    starts, stops, side = _pulses(pulse, threshold)
    gaps = (starts[1:] - stops[:-1]) * dt
    first = np.concatenate([[0], np.flatnonzero(gaps >= rules.minimum_spacing) + 1, [starts.size]])
    if np.diff(first).max() > 10:
        raise _no_hammer(source, excitation)
    time = record["time"].values
    hits = []
    for number, (a, b) in enumerate(pairwise(first), start=1):
        peak_at = int(starts[a]) + int(np.argmax(np.abs(pulse[starts[a] : stops[b - 1]])))
        way = 1.0 if pulse[peak_at] > 0.0 else -1.0
        own = np.arange(a, b)[side[a:b] == way]
        hit = _measure(way * pulse, starts[own], stops[own], dt, rules)
        following = int(starts[b]) if b < starts.size else None
        hits.append(
            replace(
                hit,
                excitation=excitation,
                source=source,
                record=index,
                number=number,
                capacity=_capacity(hit.onset, following, force.size, rules.pre_trigger) * dt,
                time=float(time[peak_at]),
                peak_force=way * sign * hit.peak_force,
                impulse=way * sign * hit.impulse,
                second_force=way * sign * hit.second_force,
            )
        )
    return _flag_outliers(hits, pulse)


def _pulses(pulse: Real, threshold: float) -> tuple[NDArray[np.intp], NDArray[np.intp], Real]:
    """Return where pulses start and stop, and their sides: what rebounds is no hit from the other side."""
    back = max(threshold, RULES.other_side * float(pulse.max()))
    (starts, stops), (other_starts, other_stops) = runs(pulse > threshold), runs(-pulse > back)
    side = np.concatenate([np.ones(starts.size), -np.ones(other_starts.size)])
    starts, stops = np.concatenate([starts, other_starts]), np.concatenate([stops, other_stops])
    order = np.argsort(starts, kind="stable")
    return starts[order], stops[order], side[order]


def _no_hammer(source: str, excitation: str) -> InputError:
    return InputError(
        f"{source}: force_{excitation} is not a series of hammer hits (no short pulses that rise out of the "
        "noise); declare method = 'actuator' for a stepped sine, or check the channel and its unit"
    )


def quiet_state(force: Real) -> tuple[float, float, float]:
    """Return offset [N], direction of the hits (+1, -1) and noise [N] of a force that is mostly quiet."""
    level = float(np.median(force))
    departure = force - level
    sign = 1.0 if departure.max() >= -departure.min() else -1.0
    return level, sign, _MAD_TO_STD * float(np.median(np.abs(departure)))


def runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where runs of True start and where they stop (exclusive)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return edges[::2], edges[1::2]


def _capacity(onset: int, following: int | None, size: int, pre_trigger: float) -> int:
    """Return how many samples a block may have that begins the pre-trigger share ahead of the onset."""
    if following is not None:
        return following - onset
    return min(size, int((size - onset) / (1.0 - pre_trigger)))


def _measure(pulse: Real, starts: NDArray[np.intp], stops: NDArray[np.intp], dt: float, rules: HitRules) -> Hit:
    """Return peak, impulse, duration, overload and second pulse of one group of pulses."""
    tops = np.array([a + np.argmax(pulse[a:b]) for a, b in zip(starts, stops, strict=True)])
    peaks = pulse[tops]
    main = int(np.argmax(peaks))
    peak = float(peaks[main])
    at = int(tops[main])
    low = pulse < 0.1 * peak
    before, after = np.flatnonzero(low[:at]), np.flatnonzero(low[at:])
    begin = int(before[-1]) + 1 if before.size else 0
    end = at + int(after[0]) if after.size else pulse.size
    margin = max(end - begin, 3)
    whole = slice(max(int(starts[0]) - margin // 2, 0), int(stops[-1]) + margin // 2)
    others = np.delete(np.arange(peaks.size), main)
    second = int(others[np.argmax(peaks[others])]) if others.size else -1
    double = second >= 0 and peaks[second] >= rules.double_share * peak and not _rings(pulse, at, int(tops[second]))
    full = rules.full_scale is not None and peak >= 0.99 * rules.full_scale
    return Hit(
        excitation="",
        source="",
        record=0,
        number=0,
        onset=int(starts[0]),
        capacity=0.0,
        time=0.0,
        peak_force=peak,
        impulse=float(pulse[whole].sum()) * dt,
        duration=(end - begin) * dt,
        overloaded=full or flat_top(pulse[max(begin - margin, 0) : end + margin]),
        second_delay=abs(int(tops[second]) - at) * dt if double else float("nan"),
        second_force=float(peaks[second]) if double else float("nan"),
    )


def _rings(pulse: Real, main: int, second: int) -> bool:
    """Whether a second pulse is a filter that rings after the first: the force swings back just before it."""
    if second < main:
        return False
    before = pulse[max(main, second - RING) : second]
    return bool(before.size) and -float(before.min()) >= 0.5 * float(pulse[second])


_BY_CHANCE = 1e-6
"""Probability with which noise may repeat the largest value as often: each channel of each hit is asked."""


def flat_top(samples: Real) -> bool:
    """Whether the largest values of a signal are cut off.

    A cut-off signal holds at least three consecutive samples at the maximum and leaves them steeply. A smooth maximum
    read by a coarse converter also repeats values, but is a parabola: if it stays within ``tol`` of the top over a
    half-width h, it is at most ``tol (1 + k/h)^2`` lower k samples beyond, plus a step of the converter. Noise may
    repeat values, too: where it could round such a top off, n of them agree by chance with a probability of
    ``(step/(2 sqrt(pi) noise))^(n-1)``.

    Parameters
    ----------
    samples : ndarray, shape (n,)
        The signal around its maximum.
    """
    top = float(samples.max())
    scale = float(np.ptp(samples))
    if scale == 0.0:
        return False
    tolerance = max(1e-5 * scale, _converter_step(samples, scale))
    starts, stops = runs(samples >= top - 1e-5 * scale)
    longest = int(np.argmax(stops - starts))
    a, b = int(starts[longest]), int(stops[longest])
    if b - a < 3:
        return False
    half = 0.5 * (b - a - 1)
    beyond = max(2, round(half))
    drop = min((top - float(samples[i]) for i in (a - beyond, b - 1 + beyond) if 0 <= i < samples.size), default=0.0)
    wide = (1.0 + beyond / half) ** 2 + 2.0
    if drop <= wide * tolerance:
        return False
    # Where the signal is quietest its second differences are those of the noise, of six times its variance. A short
    # one is quiet nowhere.
    bends = np.abs(np.diff(samples, 2))
    quietest = min((float(np.median(part)) for part in np.array_split(bends, 8) if part.size >= 8), default=0.0)
    noise = _MAD_TO_STD * quietest / math.sqrt(6.0)
    if drop > wide * 3.0 * noise:
        return True
    return (tolerance / (2.0 * math.sqrt(math.pi) * noise)) ** (b - a - 1) < _BY_CHANCE


def _converter_step(samples: Real, scale: float) -> float:
    """Return the step of the converter that all samples are multiples of, or 0 when there is none to be seen."""
    steps = np.diff(np.unique(samples))
    smallest = float(steps[steps > 1e-9 * scale].min())
    counts = (samples - samples[0]) / smallest
    return smallest if float(np.max(np.abs(counts - np.round(counts)))) < 0.1 else 0.0


def _flag_outliers(hits: list[Hit], pulse: Real) -> list[Hit]:
    """Flag hits far above the others (five medians, twice the next) whose largest value occurs twice: full scale.

    Several strong hits among weak ones are a level of their own, and none of them stands alone.
    """
    out = []
    ends = [*(h.onset for h in hits[1:]), pulse.size]
    for k, (hit, end) in enumerate(zip(hits, ends, strict=True)):
        peak = abs(hit.peak_force)
        others = [abs(h.peak_force) for i, h in enumerate(hits) if i != k]
        lone = bool(others) and peak > max(5.0 * float(np.median(others)), 2.0 * max(others))
        twice = np.count_nonzero(np.abs(pulse[hit.onset : end]) >= peak * (1.0 - 1e-9)) >= 2
        out.append(replace(hit, overloaded=hit.overloaded or (lone and bool(twice))))
    return out


# --- judging hits -------------------------------------------------------------------------------------------


def longest_block(hits: Sequence[Hit]) -> float:
    """Return the longest block [s] that nearly every hit allows; one stray hit must not shorten the rest."""
    capacity = np.array([hit.capacity for hit in hits])
    return float(capacity[capacity >= 0.5 * np.median(capacity)].min())


def common_duration(duration: float, intervals: Collection[float]) -> float:
    """Return the longest block [s] up to `duration` that is a whole number of samples at every sampling interval [s].

    Its lines are then the same at every rate. Rates whose common multiple is longer than a twentieth of the block (5000
    and 4999 Hz) have no such block, and nothing is changed: they are refused where their lines are compared.

    Parameters
    ----------
    duration : float
        Longest block allowed [s].
    intervals : collection of float
        Sampling intervals of the records [s].
    """
    first = min(intervals)
    ratios = [Fraction(dt / first).limit_denominator(1000) for dt in intervals]
    common = first * math.lcm(*(ratio.numerator for ratio in ratios))
    if all(abs(float(r) * first - dt) < 1e-7 * dt for r, dt in zip(ratios, intervals, strict=True)):
        # A sample of slack: a record of n samples lasts n, not n - 1, intervals.
        whole = int(duration / common * (1.0 + 1e-9) + 1e-6)
        return whole * common if len(set(ratios)) > 1 and whole >= 20 else duration
    return duration


def block(hit: Hit, dt: float, duration: float, rules: HitRules) -> tuple[int, int]:
    """Return first sample and number of samples of the block of a hit."""
    # A block ends before the next hit, so a duration that is not a whole number of samples is rounded down.
    # A printed time is rounded: equal rates then differ by some 1e-9, which is no sample.
    length = int(duration / dt * (1.0 + 1e-8) + 1e-3)
    return max(hit.onset - int(rules.pre_trigger * length), 0), length


def judge(hit: Hit, record: xr.Dataset, duration: float, exclude: Collection[str], rules: HitRules) -> Hit:
    """Return the hit with its usable band, its clipped response axes, and why it is not used."""
    dt = sample_interval(record)
    start, length = block(hit, dt, duration, rules)
    if duration > hit.capacity * (1.0 + 1e-9) + dt:
        short = f"{hit.capacity:.3g} s to the next hit or the end, shorter than the block of {duration:.3g} s"
        return replace(hit, reason=short)
    force = force_samples(record, hit.excitation)
    noise = quiet_state(force)[2]
    power = np.abs(fft.rfft(force[start : start + length]))[1:] ** 2
    band = usable_band(fft.rfftfreq(length, dt)[1:], power, noise**2 * length)
    channel, axes = motion_axes(record)
    motion = record[channel].isel(time=slice(start, start + length))
    rows = {axis: motion.sel(axis=axis).values for axis in axes}
    clipped = "".join(axis for axis, row in rows.items() if flat_top(row) or flat_top(-row))
    hit = replace(hit, clipped=clipped, usable_to=band[1])
    return replace(hit, reason="; ".join(_faults(hit, exclude, rules)))


def _faults(hit: Hit, exclude: Collection[str], rules: HitRules) -> Iterable[str]:
    if rules.peak_range is not None and not rules.peak_range[0] <= abs(hit.peak_force) <= rules.peak_range[1]:
        yield f"its peak of {abs(hit.peak_force):.4g} N is outside the level"
    if hit.onset == 0:
        yield "the pulse began before the record"
    if "overloaded" in exclude:
        if hit.overloaded:
            yield f"the force is overloaded at {hit.peak_force:.4g} N"
        if hit.clipped:
            yield f"the response is overloaded in {', '.join(hit.clipped)}"
    if "double_hit" in exclude and hit.double:
        yield f"double hit: {hit.second_force:.3g} N after {hit.second_delay * 1e3:.3g} ms"


def usable_band(frequency: Real, power: Real, noise: float = 0.0) -> tuple[float, float]:
    """Return the band [Hz] round the maximum of a force spectrum in which it stays above -20 dB and out of its noise.

    Parameters
    ----------
    frequency : ndarray, shape (f,)
        Frequency [Hz].
    power : ndarray, shape (f,)
        ``|F|^2``.
    noise : float, optional
        Expected ``|F|^2`` of the noise; a line less than 10 dB above it, where H1 is a tenth low, is not usable.
    """
    top = int(np.argmax(power))
    # Nine lines: signal and noise beat from line to line, and the first unlucky one must not end the band.
    smooth = ndimage.uniform_filter1d(power, 9, mode="nearest")
    weak = (power < RULES.band_drop * power[top]) | (smooth < 10.0 * noise)
    above, below = np.flatnonzero(weak[top:]), np.flatnonzero(weak[:top])
    last = max(top + int(above[0]) - 1, 0) if above.size else frequency.size - 1
    first = int(below[-1]) + 1 if below.size else 0
    return float(frequency[first]), min(float(frequency[last]), 2.0 * float(frequency[-1]) / _ANTI_ALIAS)


def accepted(name: str, axis: str, hits: Sequence[Hit]) -> list[Hit]:
    """Return the hits to average along an axis, or say why none is left."""
    along = [hit for hit in hits if hit.excitation == axis]
    used = [hit for hit in along if not hit.reason]
    if not used:
        why = "; ".join(f"{hit.source} hit {hit.number}: {hit.reason}" for hit in along)
        raise InputError(
            f"measurement '{name}', excitation {axis}: no hit is left ({why}); repeat the test, or pass "
            "exclude=() to see what the faulty hits give"
        )
    return used


def hit_table(hits: Sequence[Hit]) -> pd.DataFrame:
    """Return one row a hit."""
    return pd.DataFrame(
        {
            "excitation": [h.excitation for h in hits],
            "file": [h.source for h in hits],
            "hit": [h.number for h in hits],
            "time_s": [h.time for h in hits],
            "peak_force_N": [h.peak_force for h in hits],
            "impulse_Ns": [h.impulse for h in hits],
            "duration_ms": [h.duration * 1e3 for h in hits],
            "overloaded": [h.overloaded for h in hits],
            "response_overloaded": [h.clipped for h in hits],
            "double_hit": [h.double for h in hits],
            "second_hit_after_ms": [h.second_delay * 1e3 for h in hits],
            "second_hit_N": [h.second_force for h in hits],
            "wrong_direction": [h.reason.startswith(WRONG_DIRECTION) for h in hits],
            "usable_to_Hz": [h.usable_to for h in hits],
            "used": [not h.reason for h in hits],
            "reason": [h.reason for h in hits],
        }
    )


# --- The hits behind a compliance, one by one: the force of each as it was recorded, and what each alone finds.


def single_hits(
    records: Sequence[xr.Dataset],
    hits: Sequence[Hit],
    frequency: Real,
    motion: Complex,
    force: Complex,
    window: float,
) -> xr.Dataset:
    """Return the accepted hits of one excitation.

    Parameters
    ----------
    records : sequence of xarray.Dataset
        Of the excitation; a hit says which of them it is in.
    hits : sequence of Hit
        r hits.
    frequency : ndarray, shape (f,)
        [Hz].
    motion : ndarray, shape (f, 3, r)
        Transforms of the displacement along x, y, z [m s]; NaN where it was not recorded.
    force : ndarray, shape (f, r)
        Transforms of the force [N s].
    window : float
        Time after a hit that was transformed [s].

    Returns
    -------
    xarray.Dataset
        ``force(hit, contact_time)`` [N], its sign that of the channel, and ``compliance(hit, frequency, response)``
        [m/N]; attribute ``window_s``.
    """
    interval = min(sample_interval(records[h.record]) for h in hits)
    lasting = max(RULES.contact, 2.0 * max(h.duration for h in hits))
    time = np.linspace(0.0, 1.0, round((RULES.lead + lasting) / interval) + 1)
    time *= interval * (time.size - 1)
    recorded = np.isfinite(motion[0]).any(axis=1)
    rows = [axis for axis, there in zip(AXES, recorded, strict=True) if there]
    with np.errstate(divide="ignore", invalid="ignore"):
        compliance = (motion[:, recorded] / force[:, None]).transpose(2, 0, 1)
    return xr.Dataset(
        {
            "force": (("hit", "contact_time"), np.stack([_contact(records[h.record], h, time) for h in hits])),
            "compliance": (("hit", "frequency", "response"), compliance),
        },
        {"contact_time": time, "frequency": frequency, "response": rows},
        {"window_s": window},
    )


def _contact(record: xr.Dataset, hit: Hit, time: Real) -> Real:
    """Force of a hit [N] at times [s] from 2 ms before it was detected; zero outside the record."""
    samples, interval = force_samples(record, hit.excitation), sample_interval(record)
    level, _, _ = quiet_state(samples)
    first = hit.onset - RULES.lead / interval
    return np.interp(first + time / interval, np.arange(samples.size), samples - level, left=0.0, right=0.0)
