"""Audit of single channels: cut off, frozen, coarse, offset, twice the same, with a tone; and of their clock."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import xarray as xr
from scipy import ndimage

from process.labels import axis_present, sample_interval
from process.types import Real
from smfe.campaign import Campaign, Measurement
from smfe.diagnosis.checks.suspect import Suspect
from smfe.identification.hammer.impacts import flat_top, runs
from smfe.identification.measurement import records_of
from smfe.identification.sweep.passes import SweepPass, prepare
from smfe.identification.sweep.spindle_clock import ADVICE, REFUSED, compare_speeds

VECTORS = ("force", "acceleration", "displacement", "encoder_position", "drive_force")
"""Channels with an axis."""

FROZEN_SHARE = 0.02
"""Longest run of one value, as a share of the record, above which a channel counts as frozen."""

OFTEN = 5
"""Times that a signal must stop at its largest value to count as cut off, where its tops are too quick to look flat."""

REST_SHARE = 0.6
"""Share of the record that a force may rest at exact zero at either end: the tool is in the air."""

_FEW_STEPS = 32.0  # converter steps in six standard deviations: below, quantisation is part of the noise
_GRAVITY = 9.80665
_SAME = 0.999999
_TONE = 10.0  # times the local floor in amplitude: 20 dB
_MAINS = (50.0, 60.0)


def channels_of(record: xr.Dataset) -> Iterator[tuple[str, Real]]:
    """Yield name and samples of every channel with an axis that was recorded."""
    for name in VECTORS:
        if name in record:
            for axis in axis_present(record, name):
                yield f"{name}_{axis}", record[name].sel(axis=axis).values


def channel_suspects(record: xr.Dataset, where: str, pulsed: bool = False) -> list[Suspect]:
    """Return what is suspicious in the channels of one record.

    Parameters
    ----------
    record : xarray.Dataset
        The record.
    where : str
        Measurement and file.
    pulsed : bool, optional
        The force is a series of hits: it rests most of the time, and its hits are judged one by one elsewhere.
    """
    kept = "the record is used as it is; export it again, whole, if that is not meant"
    out = [Suspect("record", "warning", where, line, kept) for line in record.attrs.get("notes", "").splitlines()]
    named = list(channels_of(record))
    for name, samples in named:
        place = f"{where}, {name}"
        hits = pulsed and name.startswith("force")
        if name.startswith(("encoder", "drive")):
            continue  # an axis at rest stands still, and counts in whole steps
        if not hits:
            out += _cut_off(samples, place)
        out += _frozen(samples, place, name.startswith("force") and not pulsed)
        out += [s for check in (_coarse, _gravity) for s in check(samples, place)]
    out += _twice(named, where)
    return out


def _cut_off(samples: Real, where: str) -> Iterator[Suspect]:
    for sign, side in ((1.0, "top"), (-1.0, "bottom")):
        values = sign * samples
        top = float(values.max())
        at_top = int(np.count_nonzero(values >= top - 1e-9 * float(np.ptp(samples) or 1.0)))
        near = max(0, int(np.argmax(values)) - 200)
        if at_top >= 3 and (flat_top(values[near : near + 400]) or _stops(values, top)):
            yield Suspect(
                "saturation",
                "fault",
                where,
                f"{at_top} samples at its {side}, {sign * top:.4g}, where the signal arrives steeply: it is cut off",
                "measure again with a larger range; leave the parts out until then",
            )


def _stops(values: Real, top: float) -> bool:
    """Whether a signal without converter steps stops at one value again and again: quick signals show no flat tops."""
    if top == 0.0 or converter_step(values) > 0.0:
        return False
    starts, stops = runs(values >= top - 1e-9 * float(np.ptp(values)))
    return starts.size >= OFTEN and int(np.sum(stops - starts)) >= 2 * OFTEN


def _frozen(samples: Real, where: str, may_rest: bool = False) -> Iterator[Suspect]:
    """A run of one value; a force may be exactly zero before the tool enters the work and after it has left it."""
    starts, stops = runs(np.concatenate([np.diff(samples) == 0.0, [False]]))
    if not starts.size or float(np.ptp(samples)) == 0.0:
        if samples.size and float(np.ptp(samples)) == 0.0:
            yield Suspect(
                "saturation", "fault", where, f"all {samples.size} samples are {samples[0]:.4g}", "check the cable"
            )
        return
    lengths = stops - starts
    if may_rest:
        ends = (starts <= 1) | (stops >= samples.size - 2)
        lengths = np.where(ends & (samples[starts] == 0.0) & (lengths < REST_SHARE * samples.size), 0, lengths)
    worst = int(np.argmax(lengths))
    share = float(lengths[worst]) / samples.size
    if share > FROZEN_SHARE:
        value = float(samples[starts[worst]])
        why = "a force window has set it to exact zeros" if value == 0.0 else "the channel stands still"
        yield Suspect(
            "windowed_channel" if value == 0.0 else "saturation",
            "note" if value == 0.0 else "warning",
            where,
            f"one value, {value:.4g}, over {min(100.0 * share, 99.9):.3g} % of the record: {why}",
            "its noise cannot be read there; noise estimates use the other channels"
            if value == 0.0
            else "check the range and the connection",
        )


def converter_step(samples: Real) -> float:
    """Return the step of the converter that all samples are multiples of; 0 when there is none to be seen."""
    scale = float(np.ptp(samples))
    steps = np.diff(np.unique(samples))
    steps = steps[steps > 1e-9 * scale] if scale > 0.0 else steps[:0]
    if not steps.size:
        return 0.0
    smallest = float(steps.min())
    counts = (samples - samples[0]) / smallest
    return smallest if float(np.max(np.abs(counts - np.round(counts)))) < 0.1 else 0.0


def _coarse(samples: Real, where: str) -> Iterator[Suspect]:
    step, spread = converter_step(samples), float(np.std(samples))
    if step > 0.0 and 6.0 * spread < _FEW_STEPS * step:
        yield Suspect(
            "quantisation",
            "warning",
            where,
            f"steps of {step:.3g} in a signal of {spread:.3g} rms: the converter adds {step / np.sqrt(12.0):.2g} rms",
            "use a smaller range; averages over few samples carry this error",
        )


def _gravity(samples: Real, where: str) -> Iterator[Suspect]:
    if ", acceleration_" not in where:
        return
    mean, spread = float(np.mean(samples)), float(np.std(samples))
    if abs(abs(mean) - 1.0) < 0.02 and spread < 0.3:
        yield Suspect(
            "unit_error",
            "warning",
            where,
            f"its mean is {mean:.4g}, as gravity is in units of g, but it was declared in m/s^2",
            'declare unit = "g", or check the offset',
        )
    elif abs(abs(mean) / _GRAVITY - 1.0) > 0.05 and abs(mean) > 5.0 and spread < abs(mean):
        yield Suspect(
            "sensor_gain",
            "note",
            where,
            f"its mean is {mean:.4g} m/s^2; a sensor that sees gravity shows 9.81, one that does not shows 0",
            "turn the sensor over once: the change must be 19.61 m/s^2",
        )


def _twice(named: list[tuple[str, Real]], where: str) -> Iterator[Suspect]:
    for i, (name, samples) in enumerate(named):
        for other, more in named[i + 1 :]:
            if name.split("_")[0] != other.split("_")[0] or not (samples.std() and more.std()):
                continue
            likeness = float(np.corrcoef(samples, more)[0, 1])
            if abs(likeness) > _SAME:
                yield Suspect(
                    "sensor_axis",
                    "fault",
                    f"{where}, {name} and {other}",
                    f"they are the same signal (correlation {likeness:.6f})",
                    "one column is declared twice, or one sensor is on two inputs; correct [channels]",
                )


def tones(samples: Real, dt: float, floor_width: int = 25) -> list[tuple[float, float, float]]:
    """Return frequency [Hz], amplitude and height above the local floor [1] of narrow lines, strongest first.

    The amplitude spectrum (Hann, whole record) against its median over `floor_width` lines to each side; a line counts
    when it stands 20 dB above it and is a local maximum.
    """
    n = samples.size
    if n < 8 * floor_width:
        return []
    window = np.hanning(n)
    spectrum = 2.0 / window.sum() * np.abs(np.fft.rfft(window * (samples - samples.mean())))
    floor = ndimage.median_filter(spectrum, 2 * floor_width + 1, mode="reflect") + 1e-300
    height = spectrum / floor
    k = np.arange(3, spectrum.size - 1)
    peak = (height[k] > _TONE) & (spectrum[k] >= spectrum[k - 1]) & (spectrum[k] > spectrum[k + 1])
    found = [(float(i / (n * dt)), float(spectrum[i]), float(height[i])) for i in k[peak]]
    return sorted(found, key=lambda t: -t[1])


def tone_suspects(record: xr.Dataset, where: str, most: int = 3) -> list[Suspect]:
    """Return the tones of a record that was made without excitation."""
    dt, out = sample_interval(record), []
    for name, samples in channels_of(record):
        for frequency, amplitude, height in tones(samples, dt)[:most]:
            mains = any(abs(frequency / m - round(frequency / m)) * m < 0.3 and frequency > 0.5 * m for m in _MAINS)
            out.append(
                Suspect(
                    "background_tone",
                    "warning",
                    f"{where}, {name}",
                    f"a line at {frequency:.5g} Hz of {amplitude:.3g}, {20.0 * np.log10(height):.0f} dB above its "
                    f"neighbours, without excitation{' (a multiple of the mains)' if mains else ''}",
                    "it is in every other record as well: leave these lines out, or find the source",
                )
            )
    return out


def clock_suspects(record: xr.Dataset, where: str, teeth: int | None) -> list[Suspect]:
    """Compare the passing of the teeth with all channels of the speed, steady or not: clocks, teeth, pulses."""
    return [
        Suspect(
            "time_skew",
            "fault" if found.source == "spindle_speed" and abs(found.difference) > REFUSED else "warning",
            f"{where}, {found.source}",
            found.in_words(),
            ADVICE[found.source],
        )
        for found in compare_speeds(prepare(SweepPass(record, where)), teeth)
        if found.real
    ]


# --- What a machine does when nothing excites it: whether it was recorded, and whether it is at rest then.

LOUDER, TONAL = 3.0, 0.5
"""Times the root mean square at rest, and share of the power in lines, above which an axis vibrates by itself."""


def silence_suspects(campaign: Campaign) -> Iterator[Suspect]:
    """Compare the records without excitation in motion with those at rest.

    An axis may vibrate by itself where friction falls with the speed, with a period and its harmonics; a compliance
    measured there means nothing. Noise of drives and guideways is no such thing.
    """
    silent = [m for m in campaign.measurements if m.method == "silent"]
    if not silent:
        if any(m.method in ("hammer", "actuator") for m in campaign.measurements) and campaign.baseline is not None:
            yield Suspect(
                "background_tone",
                "note",
                "campaign",
                "no record without excitation: tones and vibration by itself cannot be told from the response",
                "record ten seconds at rest and ten at each feed without any hit (method = 'silent'); about 2 min",
            )
        return
    rest: dict[str, float] = {}
    for m in silent:
        if not _moves(m):
            for name, (level, _) in _levels(m).items():
                rest[name] = min(level, rest.get(name, level))
    for m in silent:
        if _moves(m):
            for name, (level, tonal) in _levels(m).items():
                if level > LOUDER * rest.get(name, np.inf) and tonal > TONAL:
                    yield _loud(m, name, level, rest[name])


def _loud(measurement: Measurement, channel: str, level: float, rest: float) -> Suspect:
    return Suspect(
        "limit_cycle",
        "warning",
        f"{measurement.name}, {channel}",
        f"{level:.3g} m/s^2 rms in motion without excitation, {level / rest:.2g} times that at rest",
        "a compliance measured at this feed is none of a machine at rest: measure at another feed, or find the cause",
    )


def _moves(measurement: Measurement) -> bool:
    return any((measurement.feed or {}).values())


def _levels(measurement: Measurement) -> dict[str, tuple[float, float]]:
    """Root mean square of each accelerometer about its mean [m/s2] and share of its lines, of the loudest record."""
    found: dict[str, tuple[float, float]] = {}
    for entry in measurement.records:
        for record in records_of(entry):
            for name, samples in channels_of(record):
                level = float(np.std(samples))
                if name.startswith("acceleration") and level > found.get(name, (0.0, 0.0))[0]:
                    lines = sum(0.5 * a**2 for _, a, _ in tones(samples, sample_interval(record)))
                    found[name] = level, lines / level**2
    return found
