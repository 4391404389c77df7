"""Impact tests: records of hammer hits -> compliance with its uncertainty.

Hits are found on the force, judged one by one, and averaged: ``H1 = S_XF / S_FF`` with ``S_XF = sum X
conj(F)`` over the accepted hits (unbiased for noise on the response, low by ``S_nn/S_FF`` for noise on the
force). Blocks are not tapered: a window would add damping, and a record that has not decayed is reported
instead.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from process.errors import InputError
from process.labels import AXES, axis_index, make_compliance, sample_interval
from smfe.identification import Identification
from smfe.spectra import block_spectra, check_records, force_samples, hann, motion_axes, record_source

FAULTS: tuple[str, ...] = ("overloaded", "double_hit")
"""What keeps a hit out of the average unless the caller says otherwise."""

_MAD_TO_STD = 1.4826  # of Gaussian noise
_BAND_DROP = 0.01  # -20 dB in power: where the force spectrum ends
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
        Pulses closer than this belong to one hit [s]; nobody hits five times a second, a hammer bounces
        faster.
    pre_trigger : float, optional
        Share of the block before the pulse [1], where the record has it.
    double_share : float, optional
        A second pulse above this share of the largest makes a double hit [1].
    full_scale : float, optional
        Range of the force channel [N], where known; hits within 1 % of it are overloaded.
    """

    trigger: float = 0.05
    noise: float = 8.0
    minimum_spacing: float = 0.2
    pre_trigger: float = 0.02
    double_share: float = 0.1
    full_scale: float | None = None


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


def identify_hammer(
    name: str,
    records: Mapping[str, Sequence[xr.Dataset]],
    *,
    frequency_range: tuple[float, float] | None = None,
    resolution: float | None = None,
    exclude: Collection[str] = FAULTS,
    gate_force: bool = False,
    rules: HitRules | None = None,
) -> Identification:
    """Identify compliances from hammer hits.

    Per excitation column ``H1 = S_XF/S_FF`` over the accepted hits. The standard deviation follows from what
    the hits do not have in common, ``s^2 = sum_m |X_m - H F_m|^2 / (M - 1)``, ``var H = s^2 / sum_m
    |F_m|^2``; with one hit neither it nor the coherence ``|S_XF|^2/(S_XX S_FF)`` (1 by construction) says
    anything, and both are NaN.

    Compliance is claimed only where the force carries it: up to where its spectrum has fallen by 20 dB (its
    first deep zero lies beyond) and to the sampling rate over 2.56, from 1/(block length) for a displacement
    and from 2/(block length) for an acceleration, whose noise ``-1/w^2`` raises without bound.

    Parameters
    ----------
    name : str
        Name of the measurement.
    records : mapping of str to sequence of xarray.Dataset
        Excitation axis -> records, each with one hit or several.
    frequency_range : (float, float), optional
        Frequency axis of the result [Hz], NaN where a column is not usable. Default: the band that every
        column claims, without NaN.
    resolution : float, optional
        Spacing of the frequencies [Hz], the inverse of the block length. Default: blocks as long as the hits
        allow (spans shorter than half the median do not count).
    exclude : collection of str, optional
        Faults that keep a hit out of the average, of `FAULTS`.
    gate_force : bool, optional
        Set the force to zero where the hammer is not in contact, which removes the bias that force noise
        brings.
    rules : HitRules, optional
        How hits are found.

    Returns
    -------
    Identification
        Compliance [m/N] with ``compliance_std`` and ``coherence(frequency, response, excitation)``;
        attributes ``usable_from_Hz`` and ``usable_to_Hz`` (one value an excitation) and ``block_length_s``;
        table "hits".

    Raises
    ------
    InputError
        When there are no records, force or motion is missing, a record holds no hits (a sine, noise), no hit
        is left after exclusion, or no frequency is usable.
    """
    rules = rules or HitRules()
    check_records(name, records)
    unknown = set(exclude) - set(FAULTS)
    if unknown:
        raise InputError(f"exclude names {', '.join(sorted(unknown))}; it may name {' and '.join(FAULTS)}")
    columns = {axis: list(group) for axis, group in records.items() if len(group)}
    hits = []
    for axis, group in columns.items():
        for index, record in enumerate(group):
            hits += find_hits(record, axis, index, rules)
    duration = 1.0 / resolution if resolution is not None else _longest_block(hits)
    hits = [_judge(hit, columns[hit.excitation][hit.record], duration, exclude, rules) for hit in hits]
    averages = [
        _average_column(columns[axis], _accepted(name, axis, hits), duration, rules, gate_force, frequency_range)
        for axis in AXES
        if axis in columns
    ]
    compliance = _assemble(name, averages, frequency_range)
    notes = [note for column in averages for note in column.warnings]
    notes += _exclusion_notes(hits) + _cut_notes(averages, frequency_range)
    return Identification(name, "hammer", compliance, {"hits": hit_table(hits)}, tuple(notes))


def _accepted(name: str, axis: str, hits: Sequence[Hit]) -> list[Hit]:
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
    level, sign, noise = _quiet_state(force)
    pulse = sign * (force - level)
    peak = float(pulse.max())
    threshold = max(rules.trigger * peak, rules.noise * noise)
    if np.mean(pulse > 0.5 * peak) > 0.15 or not peak > threshold:
        raise _no_hammer(source, excitation)
    dt = sample_interval(record)
    starts, stops = _runs(pulse > threshold)
    gaps = (starts[1:] - stops[:-1]) * dt
    first = np.concatenate([[0], np.flatnonzero(gaps >= rules.minimum_spacing) + 1, [starts.size]])
    if np.diff(first).max() > 10:
        raise _no_hammer(source, excitation)
    time = record["time"].values
    hits = []
    for number, (a, b) in enumerate(pairwise(first), start=1):
        hit = _measure(pulse, starts[a:b], stops[a:b], dt, rules)
        peak_at = int(starts[a]) + int(np.argmax(pulse[starts[a] : stops[b - 1]]))
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
                peak_force=sign * hit.peak_force,
                impulse=sign * hit.impulse,
                second_force=sign * hit.second_force,
            )
        )
    return _flag_outliers(hits, pulse)


def _no_hammer(source: str, excitation: str) -> InputError:
    return InputError(
        f"{source}: force_{excitation} is not a series of hammer hits (no short pulses that rise out of the "
        "noise); declare method = 'actuator' for a stepped sine, or check the channel and its unit"
    )


def _quiet_state(force: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return offset [N], direction of the hits (+1, -1) and noise [N] of a force that is mostly quiet."""
    level = float(np.median(force))
    departure = force - level
    sign = 1.0 if departure.max() >= -departure.min() else -1.0
    return level, sign, _MAD_TO_STD * float(np.median(np.abs(departure)))


def _runs(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where runs of True start and where they stop (exclusive)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return edges[::2], edges[1::2]


def _capacity(onset: int, following: int | None, size: int, pre_trigger: float) -> int:
    """Return how many samples a block may have that begins the pre-trigger share ahead of the onset."""
    if following is not None:
        return following - onset
    return min(size, int((size - onset) / (1.0 - pre_trigger)))


def _measure(
    pulse: NDArray[np.float64], starts: NDArray[np.intp], stops: NDArray[np.intp], dt: float, rules: HitRules
) -> Hit:
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
    double = second >= 0 and peaks[second] >= rules.double_share * peak
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


def flat_top(samples: NDArray[np.float64]) -> bool:
    """Tell whether the largest values of a signal are cut off.

    A cut-off signal holds at least three consecutive samples at the maximum and leaves them steeply. A smooth maximum
    read by a coarse converter also repeats values, but is a parabola: if it stays within ``tol`` of the top over a
    half-width h, it is at most ``tol (1 + k/h)^2`` lower k samples beyond, plus a step of the converter.

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
    starts, stops = _runs(samples >= top - 1e-5 * scale)
    longest = int(np.argmax(stops - starts))
    a, b = int(starts[longest]), int(stops[longest])
    if b - a < 3:
        return False
    half = 0.5 * (b - a - 1)
    beyond = max(2, round(half))
    drop = [top - float(samples[i]) for i in (a - beyond, b - 1 + beyond) if 0 <= i < samples.size]
    return bool(drop) and min(drop) > ((1.0 + beyond / half) ** 2 + 2.0) * tolerance


def _converter_step(samples: NDArray[np.float64], scale: float) -> float:
    """Return the step of the converter that all samples are multiples of, or 0 when there is none to be seen."""
    steps = np.diff(np.unique(samples))
    smallest = float(steps[steps > 1e-9 * scale].min())
    counts = (samples - samples[0]) / smallest
    return smallest if float(np.max(np.abs(counts - np.round(counts)))) < 0.1 else 0.0


def _flag_outliers(hits: list[Hit], pulse: NDArray[np.float64]) -> list[Hit]:
    """Flag hits far above the others (five medians) whose largest value occurs twice: full scale."""
    out = []
    for k, hit in enumerate(hits):
        others = [abs(h.peak_force) for i, h in enumerate(hits) if i != k]
        lone = bool(others) and abs(hit.peak_force) > 5.0 * float(np.median(others))
        twice = np.count_nonzero(pulse >= abs(hit.peak_force) * (1.0 - 1e-9)) >= 2
        out.append(replace(hit, overloaded=hit.overloaded or (lone and bool(twice))))
    return out


# --- judging hits -------------------------------------------------------------------------------------------


def _longest_block(hits: Sequence[Hit]) -> float:
    """Return the longest block [s] that nearly every hit allows; one stray hit must not shorten the rest."""
    capacity = np.array([hit.capacity for hit in hits])
    return float(capacity[capacity >= 0.5 * np.median(capacity)].min())


def _block(hit: Hit, dt: float, duration: float, rules: HitRules) -> tuple[int, int]:
    """Return first sample and number of samples of the block of a hit."""
    # A block ends before the next hit, so a duration that is not a whole number of samples is rounded down.
    length = int(duration / dt * (1.0 + 1e-9) + 1e-6)
    return max(hit.onset - int(rules.pre_trigger * length), 0), length


def _judge(hit: Hit, record: xr.Dataset, duration: float, exclude: Collection[str], rules: HitRules) -> Hit:
    """Return the hit with its usable band, its clipped response axes, and why it is not used."""
    dt = sample_interval(record)
    start, length = _block(hit, dt, duration, rules)
    if duration > hit.capacity * (1.0 + 1e-9) + dt:
        short = f"{hit.capacity:.3g} s to the next hit or the end, shorter than the block of {duration:.3g} s"
        return replace(hit, reason=short)
    force = force_samples(record, hit.excitation)
    noise = _quiet_state(force)[2]
    power = np.abs(fft.rfft(force[start : start + length]))[1:] ** 2
    band = usable_band(fft.rfftfreq(length, dt)[1:], power, noise**2 * length)
    channel, axes = motion_axes(record)
    motion = record[channel].isel(time=slice(start, start + length))
    rows = {axis: motion.sel(axis=axis).values for axis in axes}
    clipped = "".join(axis for axis, row in rows.items() if flat_top(row) or flat_top(-row))
    hit = replace(hit, clipped=clipped, usable_to=band[1])
    return replace(hit, reason="; ".join(_faults(hit, exclude)))


def _faults(hit: Hit, exclude: Collection[str]) -> Iterable[str]:
    if hit.onset == 0:
        yield "the pulse began before the record"
    if "overloaded" in exclude:
        if hit.overloaded:
            yield f"the force is overloaded at {hit.peak_force:.4g} N"
        if hit.clipped:
            yield f"the response is overloaded in {', '.join(hit.clipped)}"
    if "double_hit" in exclude and hit.double:
        yield f"double hit: {hit.second_force:.3g} N after {hit.second_delay * 1e3:.3g} ms"


def usable_band(frequency: NDArray[np.float64], power: NDArray[np.float64], noise: float = 0.0) -> tuple[float, float]:
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
    weak = (power < _BAND_DROP * power[top]) | (smooth < 10.0 * noise)
    above, below = np.flatnonzero(weak[top:]), np.flatnonzero(weak[:top])
    last = max(top + int(above[0]) - 1, 0) if above.size else frequency.size - 1
    first = int(below[-1]) + 1 if below.size else 0
    return float(frequency[first]), min(float(frequency[last]), 2.0 * float(frequency[-1]) / _ANTI_ALIAS)


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
            "usable_to_Hz": [h.usable_to for h in hits],
            "used": [not h.reason for h in hits],
            "reason": [h.reason for h in hits],
        }
    )


# --- averaging ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Column:
    """Averaged result of one excitation; arrays of shape (f,) and (f, 3), NaN for a response not recorded."""

    excitation: str
    frequency: NDArray[np.float64]
    block_length: float
    compliance: NDArray[np.complex128]
    std: NDArray[np.float64]
    coherence: NDArray[np.float64]
    band: tuple[float, float]
    warnings: tuple[str, ...]


def _average_column(
    records: Sequence[xr.Dataset],
    hits: Sequence[Hit],
    duration: float,
    rules: HitRules,
    gate: bool,
    wanted: tuple[float, float] | None,
) -> _Column:
    """Average the accepted hits of one excitation axis."""
    axis = hits[0].excitation
    gathered = [
        _gather(records[i], [h for h in hits if h.record == i], duration, rules, gate)
        for i in sorted({h.record for h in hits})
    ]
    frequency = gathered[0].frequency
    for blocks in gathered[1:]:
        if blocks.frequency.size != frequency.size or not np.allclose(blocks.frequency, frequency, rtol=1e-6):
            raise InputError(
                f"the records of excitation {axis} are sampled at different rates; resample them to one rate"
            )
    motion = np.concatenate([b.motion for b in gathered], axis=2)
    force = np.concatenate([b.force for b in gathered], axis=1)
    compliance, std, coherence = average_h1(motion, force)
    power = np.mean(np.abs(force) ** 2, axis=1)
    noise = 0.0 if gate else float(np.mean([b.noise_energy for b in gathered]))
    low, high = usable_band(frequency, power, noise)
    lines = 2.0 if any(motion_axes(records[h.record])[0] == "acceleration" for h in hits) else 1.0
    band = (max(low, lines * float(frequency[0])), high)
    notes = [
        *_hit_count_note(axis, len(hits)),
        *_leakage_note(axis, gathered, band, wanted),
        *_force_noise_note(axis, gathered, frequency, power, band, gate),
    ]
    length = 1.0 / float(frequency[0])
    return _Column(axis, frequency, length, compliance, std, coherence, band, tuple(notes))


def average_h1(
    motion: NDArray[np.complex128], force: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.float64], NDArray[np.float64]]:
    """Return H1, its standard deviation and the coherence.

    ``H = sum X conj(F) / sum |F|^2``, ``var H = sum |X - H F|^2 / (M - 1) / sum |F|^2`` (``E |dH|^2``, both
    parts together), ``coherence = |S_XF|^2 / (S_XX S_FF)``. A response that some hits lack is averaged over
    the others.

    Parameters
    ----------
    motion : ndarray of complex, shape (f, responses, hits)
        Transforms X of the displacement [m s]; NaN where a hit lacks the response.
    force : ndarray of complex, shape (f, hits)
        Transforms F of the force [N s].

    Returns
    -------
    compliance, std, coherence : ndarray, shape (f, responses)
        [m/N], [m/N], [1]; NaN where no hit has the response, the last two also where only one has.
    """
    there = np.isfinite(motion)
    x = np.where(there, motion, 0.0)
    f = np.where(there, force[:, None, :], 0.0)
    hits = there.sum(axis=2)
    sxf = np.sum(x * f.conj(), axis=2)
    sff = np.where(hits > 0, np.sum(np.abs(f) ** 2, axis=2), np.nan)
    sxx = np.sum(np.abs(x) ** 2, axis=2)
    with np.errstate(invalid="ignore"):  # nan + nan j over nan: a response that was not recorded
        h = sxf / sff
    several = hits > 1
    residual = np.sum(np.abs(x - np.where(hits > 0, h, 0.0)[:, :, None] * f) ** 2, axis=2)
    variance = np.where(several, residual / np.maximum(hits - 1, 1), np.nan) / sff
    power = np.where(several & (sxx > 0.0), sxx * sff, np.nan)
    return h, np.sqrt(variance), np.minimum(np.abs(sxf) ** 2 / power, 1.0)


@dataclass(frozen=True)
class _Blocks:
    """Spectra of the blocks of one record, and what is needed to judge decay and force noise."""

    frequency: NDArray[np.float64]
    motion: NDArray[np.complex128]
    force: NDArray[np.complex128]
    quarter_frequency: NDArray[np.float64]
    first_quarter: NDArray[np.complex128]
    last_quarter: NDArray[np.complex128]
    noise_energy: float
    """Expected ``|F|^2`` of the force noise in one block [N^2 s^2]; zero for a force cut to exact zeros."""


def _gather(record: xr.Dataset, hits: Sequence[Hit], duration: float, rules: HitRules, gate: bool) -> _Blocks:
    axis = hits[0].excitation
    dt = sample_interval(record)
    force = force_samples(record, axis)
    level, _, noise = _quiet_state(force)
    if gate:
        record = _gated(record, axis, level, rules)
    blocks = [_block(hit, dt, duration, rules) for hit in hits]
    length = blocks[0][1]
    spectra = block_spectra(record, [start for start, _ in blocks], length)
    quarter = length // 4
    window = hann(quarter)
    # The first quarter begins with the pulse, so that "first" and "last" are the same stretch of every decay.
    early = block_spectra(record, [hit.onset for hit in hits], quarter, window)
    to_last = length - int(rules.pre_trigger * length) - quarter
    late = block_spectra(record, [hit.onset + to_last for hit in hits], quarter, window)
    return _Blocks(
        frequency=spectra.frequency[1:],  # an acceleration says nothing about 0 Hz, an offset says it wrongly
        motion=_all_axes(spectra.displacement, spectra.response)[1:],
        force=spectra.force[1:, spectra.excitation.index(axis)],
        quarter_frequency=early.frequency[1:],
        first_quarter=_all_axes(early.displacement, early.response)[1:],
        last_quarter=_all_axes(late.displacement, late.response)[1:],
        noise_energy=noise**2 * dt**2 * length,
    )


def _all_axes(spectrum: NDArray[np.complex128], axes: Sequence[str]) -> NDArray[np.complex128]:
    """Return the spectrum with a row for each of x, y, z; NaN where it was not recorded."""
    full = np.full((spectrum.shape[0], len(AXES), spectrum.shape[2]), np.nan, dtype=complex)
    full[:, axis_index(axes)] = spectrum
    return full


def _gated(record: xr.Dataset, axis: str, level: float, rules: HitRules) -> xr.Dataset:
    """Return the record with no force except from one pulse length before a pulse to one after it."""
    force = force_samples(record, axis)
    _, sign, noise = _quiet_state(force)
    pulse = sign * (force - level)
    contact = np.zeros(force.size, dtype=bool)
    for a, b in zip(*_runs(pulse > max(rules.trigger * pulse.max(), rules.noise * noise)), strict=True):
        contact[max(2 * a - b, 0) : 2 * b - a] = True
    gated = record["force"].copy(deep=True)
    gated.loc[{"axis": axis}] = np.where(contact, force - level, 0.0)
    return record.assign(force=gated)


# --- what the engineer has to know --------------------------------------------------------------------------


def _hit_count_note(axis: str, count: int) -> Iterable[str]:
    if count == 1:
        yield (
            f"excitation {axis}: one hit; its coherence is 1 by construction and its scatter unknown, so "
            "neither is given (take at least 3 to 5 hits)"
        )


def leakage(first: NDArray[np.complex128], last: NDArray[np.complex128]) -> tuple[float, int]:
    """Estimate the error of a block that ends before the response has decayed.

    A decay ``exp(-t/tau)`` cut at T leaves an error of ``exp(-T/tau)``. The decay from the first to the last
    quarter of the block, whose centres are 3/4 T apart, is read where the first quarter is above a tenth of
    its maximum, on the mean over hits, where that is above what the scatter of the hits leaves of the noise,
    and raised to 4/3.

    Parameters
    ----------
    first, last : ndarray of complex, shape (f, hits)
        Hann-windowed transforms of the velocity in the first and the last quarter, in any unit.

    Returns
    -------
    error : float
        Relative error of the compliance near the peaks of the response [1].
    line : int
        Index of the frequency that contributes most.
    """
    hits = first.shape[1]

    def mean_and_noise(quarter: NDArray[np.complex128]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        mean = quarter.mean(axis=1)
        noise = np.sum(np.abs(quarter - mean[:, None]) ** 2, axis=1) / max(hits * (hits - 1), 1)
        return np.abs(mean) ** 2, noise

    (early, early_noise), (late, late_noise) = mean_and_noise(first), mean_and_noise(last)
    # Ten and six times the noise of the mean: from few hits its estimate is itself uncertain.
    heard = early > 10.0 * early_noise
    strong = heard & (early > 0.01 * np.max(early, where=heard, initial=0.0))
    if not strong.any() or late[strong].sum() <= 6.0 * late_noise[strong].sum():
        return 0.0, 0
    ratio = float(np.sqrt(late[strong].sum() / early[strong].sum()))
    return min(ratio, 1.0) ** (4.0 / 3.0), int(np.argmax(np.where(strong, late, 0.0)))


def _leakage_note(
    axis: str, gathered: Sequence[_Blocks], band: tuple[float, float], wanted: tuple[float, float] | None
) -> Iterable[str]:
    f = gathered[0].quarter_frequency
    low, high = wanted or band
    # Below two lines of the quarter, the window mixes the line with the drift that -1/w^2 has raised.
    keep = (f >= max(band[0], low, 2.0 * f[0])) & (f <= min(band[1], high))
    if not keep.any():
        return
    # Velocity shows the resonances; displacement also shows the drift of the accelerometer.
    w = f[keep][:, None, None]
    first = w * np.concatenate([b.first_quarter for b in gathered], axis=2)[keep]
    last = w * np.concatenate([b.last_quarter for b in gathered], axis=2)[keep]
    worst, line = 0.0, 0
    for row in range(len(AXES)):
        there = np.isfinite(first[0, row])
        if there.any() and np.abs(first[:, row][:, there]).max() > 0.0:
            worst, line = max((worst, line), leakage(first[:, row][:, there], last[:, row][:, there]))
    if worst > 0.01:
        yield (
            f"excitation {axis}: at the end of the block of {1.0 / gathered[0].frequency[0]:.3g} s the response "
            f"has not decayed (or its sensor drifts), mostly at {f[keep][line]:.3g} Hz; estimated error of the "
            f"compliance there {100.0 * worst:.2g} % (leave more time between hits)"
        )


def _force_noise_note(
    axis: str,
    gathered: Sequence[_Blocks],
    frequency: NDArray[np.float64],
    power: NDArray[np.float64],
    band: tuple[float, float],
    gate: bool,
) -> Iterable[str]:
    noise = float(np.mean([b.noise_energy for b in gathered]))
    if any(b.noise_energy == 0.0 for b in gathered):
        yield (
            f"excitation {axis}: the force is exactly constant between hits (windowed before it was stored); "
            "its noise, and the bias that noise brings, cannot be estimated"
        )
    inside = (frequency >= band[0]) & (frequency <= band[1])
    if gate or not inside.any():
        return
    weakest = int(np.flatnonzero(inside)[np.argmin(power[inside])])
    bias = noise / float(power[weakest])
    if bias > 0.01:
        yield (
            f"excitation {axis}: force noise lowers the compliance by up to {100.0 * bias:.2g} % (at "
            f"{frequency[weakest]:.4g} Hz); gate_force=True removes most of it"
        )


def _exclusion_notes(hits: Sequence[Hit]) -> list[str]:
    return [
        f"excitation {hit.excitation}: {hit.source}, hit {hit.number} is not used: {hit.reason}"
        for hit in hits
        if hit.reason
    ]


def _cut_notes(columns: Sequence[_Column], wanted: tuple[float, float] | None) -> list[str]:
    notes = []
    for c in columns:
        low, high = c.band
        if wanted is not None and (wanted[0] < low * (1.0 - 1e-9) or wanted[1] > high * (1.0 + 1e-9)):
            notes.append(
                f"excitation {c.excitation}: usable from {low:.4g} to {high:.4g} Hz; nothing is claimed "
                f"outside it, though {wanted[0]:.4g} to {wanted[1]:.4g} Hz was asked for"
            )
    return notes


def _assemble(name: str, columns: Sequence[_Column], wanted: tuple[float, float] | None) -> xr.Dataset:
    """Put the columns side by side on one frequency axis."""
    frequency = columns[0].frequency
    for column in columns[1:]:
        shared = min(frequency.size, column.frequency.size)
        if not np.allclose(column.frequency[:shared], frequency[:shared], rtol=1e-6):
            raise InputError(
                f"measurement '{name}': excitations {columns[0].excitation} and {column.excitation} have "
                "blocks of different length; resample the records to one rate or give a resolution"
            )
        frequency = frequency[:shared]
    low, high = wanted or (max(c.band[0] for c in columns), min(c.band[1] for c in columns))
    lines = np.flatnonzero((frequency >= low * (1.0 - 1e-9)) & (frequency <= high * (1.0 + 1e-9)))
    f = frequency[lines]
    claims = [(f >= c.band[0] * (1.0 - 1e-9)) & (f <= c.band[1] * (1.0 + 1e-9)) for c in columns]
    if not any(claim.any() for claim in claims):
        bands = ", ".join(f"{c.excitation} {c.band[0]:.4g} to {c.band[1]:.4g} Hz" for c in columns)
        raise InputError(
            f"measurement '{name}': nothing can be claimed between {low:.4g} and {high:.4g} Hz (usable: {bands}); ask "
            "for another frequency range, record longer blocks, use a harder hammer tip, or pass gate_force=True "
            "where force noise limits the band"
        )
    recorded = [row for row in range(len(AXES)) if any(np.isfinite(c.compliance[0, row]) for c in columns)]

    def stack(attribute: str) -> NDArray[np.complex128]:
        parts = []
        for c, claimed in zip(columns, claims, strict=True):
            parts.append(np.where(claimed[:, None], getattr(c, attribute)[lines][:, recorded], np.nan))
        return np.stack(parts, axis=2)

    dims = ("frequency", "response", "excitation")
    return make_compliance(
        f,
        stack("compliance"),
        [AXES[row] for row in recorded],
        [c.excitation for c in columns],
        {"compliance_std": (dims, stack("std")), "coherence": (dims, stack("coherence"))},
        {
            "usable_from_Hz": [c.band[0] for c in columns],
            "usable_to_Hz": [c.band[1] for c in columns],
            "block_length_s": columns[0].block_length,
        },
    )
