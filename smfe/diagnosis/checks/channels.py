"""Checks of single channels of a record: clipped, frozen, coarse, offset, duplicated, with a tone, self-excited."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import xarray as xr
from scipy import ndimage

from process.labels import axis_present, sample_interval
from process.types import Real
from smfe.campaign import Campaign, Measurement
from smfe.diagnosis.checks.rules import RULES
from smfe.diagnosis.checks.suspect import Suspect, fault, note, warning
from smfe.identification.hammer.impacts import flat_top, runs
from smfe.identification.measurement import records_of

VECTORS = ("force", "acceleration", "displacement", "encoder_position", "drive_force")
"""Channels with an axis."""


def channels_of(record: xr.Dataset) -> Iterator[tuple[str, Real]]:
    """Yield name and samples of every channel with an axis that was recorded."""
    for name in VECTORS:
        for axis in axis_present(record, name) if name in record else ():
            yield f"{name}_{axis}", record[name].sel(axis=axis).values


def channel_suspects(record: xr.Dataset, where: str, pulsed: bool = False) -> Iterator[Suspect]:
    """Yield what is suspicious in the channels of one record; `where` names measurement and file.

    A `pulsed` force is a series of hits: it rests most of the time, and its hits are judged one by one elsewhere.
    """
    for line in record.attrs.get("notes", "").splitlines():
        advice = "the record is used as it is; export it again, whole, if that is not meant"
        yield warning("record", where, line, advice)
    named = list(channels_of(record))
    for name, samples in named:
        if name.startswith(("encoder", "drive")):
            continue  # an axis at rest stands still, and counts in whole steps
        place, force = f"{where}, {name}", name.startswith("force")
        if not (pulsed and force):
            yield from _clipped(samples, place)
        yield from _frozen(samples, place, force and not pulsed)
        yield from _coarse(samples, place)
    yield from _duplicated(named, where)


def _clipped(samples: Real, where: str) -> Iterator[Suspect]:
    near_top = 1e-9 * float(np.ptp(samples) or 1.0)
    for sign, side in ((1.0, "top"), (-1.0, "bottom")):
        values = sign * samples
        top = float(values.max())
        starts, stops = runs(values >= top - near_top)
        count = int(np.sum(stops - starts))
        # Quick signals have no flat tops: without converter steps they stop at one value again and again.
        stops_often = starts.size >= RULES.often and count >= 2 * RULES.often and top != 0.0
        near = max(0, int(np.argmax(values)) - 200)
        if count >= 3 and (flat_top(values[near : near + 400]) or (stops_often and converter_step(values) == 0.0)):
            yield fault(
                "saturation",
                where,
                f"{count} samples at its {side}, {sign * top:.4g}, where the signal arrives steeply: it is cut off",
                "measure again with a larger range; leave the parts out until then",
            )


def _frozen(samples: Real, where: str, may_rest: bool) -> Iterator[Suspect]:
    """A run of one value; a force may be exactly zero before the tool enters the work and after it has left it."""
    starts, stops = runs(np.concatenate([np.diff(samples) == 0.0, [False]]))
    if samples.size and float(np.ptp(samples)) == 0.0:
        yield fault("saturation", where, f"all {samples.size} samples are {samples[0]:.4g}", "check the cable")
        return
    if not starts.size:
        return
    lengths = stops - starts
    if may_rest:
        ends = (starts <= 1) | (stops >= samples.size - 2)
        rests = ends & (samples[starts] == 0.0) & (lengths < RULES.rest_share * samples.size)
        lengths = np.where(rests, 0, lengths)
    worst = int(np.argmax(lengths))
    share, value = float(lengths[worst]) / samples.size, float(samples[starts[worst]])
    said = f"one value, {value:.4g}, over {min(100.0 * share, 99.9):.3g} % of the record: "
    if share > RULES.frozen_share and value == 0.0:
        advice = "its noise cannot be read there; noise estimates use the other channels"
        yield note("windowed_channel", where, f"{said}a force window has set it to exact zeros", advice)
    elif share > RULES.frozen_share:
        yield warning("saturation", where, f"{said}the channel stands still", "check the range and the connection")


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
    if step > 0.0 and 6.0 * spread < RULES.few_steps * step:
        yield warning(
            "quantisation",
            where,
            f"steps of {step:.3g} in a signal of {spread:.3g} rms: the converter adds {step / np.sqrt(12.0):.2g} rms",
            "use a smaller range; averages over few samples carry this error",
        )


def gravity_suspects(records: Iterable[tuple[str, xr.Dataset]]) -> Iterator[Suspect]:
    """Yield the accelerations [m/s2] whose mean is that of gravity in units of g, or no gravity that there is.

    `records`: where each is, and it, all with channels that were declared alike. A unit is that of a channel in all of
    them: an offset of one record that happens to be 1 m/s2 is none.
    """
    every: dict[str, list[tuple[str, float, float]]] = {}
    for where, record in records:
        for name, samples in channels_of(record):
            if name.startswith("acceleration"):
                every.setdefault(name, []).append((where, float(np.mean(samples)), float(np.std(samples))))
    for name, each in every.items():
        # Where the channel vibrates much its mean says nothing.
        quiet = [mean for _, mean, spread in each if spread < 0.3]
        in_g = bool(quiet) and all(abs(abs(mean) - 1.0) < 0.02 for mean in quiet)
        # A sensor sees the same gravity in every record, and one that is quiet among others tells no offset from it.
        in_g = in_g and np.ptp(quiet) < 0.01 and (len(quiet) > 1 or len(each) == 1)
        for where, mean, spread in each:
            if in_g and spread < 0.3:
                evidence = f"its mean is {mean:.4g}, as gravity is in units of g, but it was declared in m/s^2"
                yield warning("unit_error", f"{where}, {name}", evidence, 'declare unit = "g", or check the offset')
            elif abs(abs(mean) / 9.80665 - 1.0) > 0.05 and abs(mean) > 5.0 and spread < abs(mean):
                evidence = f"its mean is {mean:.4g} m/s^2; a sensor that sees gravity has 9.81, one that does not has 0"
                advice = "turn the sensor over once: the change must be 19.61 m/s^2"
                yield note("sensor_gain", f"{where}, {name}", evidence, advice)


def _less_feed(name: str, samples: Real) -> Real:
    """Return a position without its uniform motion, which axes share that are fed together; others as they are."""
    if not name.startswith("encoder_position"):
        return samples
    time = np.linspace(-1.0, 1.0, samples.size)
    left = samples - samples.mean() - time * float(samples @ time) / float(time @ time)
    # What rounding leaves of a ramp is no signal.
    return np.asarray(left if left.std() > 1e-9 * np.abs(samples).max() else np.zeros_like(left))


def _duplicated(named: Sequence[tuple[str, Real]], where: str) -> Iterator[Suspect]:
    for i, (name, samples) in enumerate(named):
        for other, more in named[i + 1 :]:
            if name.split("_")[0] != other.split("_")[0]:
                continue
            one, two = _less_feed(name, samples), _less_feed(other, more)
            if not (one.std() and two.std()):
                continue
            correlation = float(np.corrcoef(one, two)[0, 1])
            if abs(correlation) > RULES.same_signal:
                yield fault(
                    "sensor_axis",
                    f"{where}, {name} and {other}",
                    f"they are the same signal (correlation {correlation:.6f})",
                    "one column is declared twice, or one sensor is on two inputs; correct [channels], and declare a "
                    "sensor that was moved between the records with each record ([measurement.records.channels])",
                )


# --- Records without excitation: tones, and an axis that vibrates by itself.


def tones(samples: Real, dt: float) -> list[tuple[float, float, float]]:
    """Return frequency [Hz], amplitude and height above the local floor [1] of narrow lines, largest first.

    The amplitude spectrum (Hann, whole record) is compared with its median over neighbouring lines; a line counts
    when it stands 20 dB above it and is a local maximum.
    """
    n, width = samples.size, RULES.floor_width
    if n < 8 * width:
        return []
    window = np.hanning(n)
    spectrum = 2.0 / window.sum() * np.abs(np.fft.rfft(window * (samples - samples.mean())))
    height = spectrum / (ndimage.median_filter(spectrum, 2 * width + 1, mode="reflect") + 1e-300)
    k = np.arange(3, spectrum.size - 1)
    peak = (height[k] > RULES.tone) & (spectrum[k] >= spectrum[k - 1]) & (spectrum[k] > spectrum[k + 1])
    found = [(float(i / (n * dt)), float(spectrum[i]), float(height[i])) for i in k[peak]]
    return sorted(found, key=lambda t: -t[1])


def tone_suspects(record: xr.Dataset, where: str) -> Iterator[Suspect]:
    """Yield the three largest tones of each channel of a record that was made without excitation."""
    for name, samples in channels_of(record):
        for frequency, amplitude, height in tones(samples, sample_interval(record))[:3]:
            near = [(m, round(frequency / m)) for m in (50.0, 60.0)]
            mains = any(abs(frequency - n * m) < 0.3 and frequency > 0.5 * m for m, n in near)
            yield warning(
                "background_tone",
                f"{where}, {name}",
                f"a line at {frequency:.5g} Hz of {amplitude:.3g}, {20.0 * np.log10(height):.0f} dB above its "
                f"neighbours, without excitation{' (a multiple of the mains)' if mains else ''}",
                "it is in every other record as well: leave these lines out, or find the source",
            )


def silence_suspects(campaign: Campaign) -> Iterator[Suspect]:
    """Compare the records without excitation in motion with those at rest.

    An axis may vibrate by itself where friction falls with the speed, with a period and its harmonics; a compliance
    measured there means nothing. Noise of drives and guideways is no such thing.
    """
    silent = [m for m in campaign.measurements if m.method == "silent"]
    excited = any(m.method in ("hammer", "actuator") for m in campaign.measurements)
    if not silent and excited and campaign.baseline is not None:
        yield note(
            "background_tone",
            "campaign",
            "no record without excitation: a tone or a self-excited vibration looks like part of the response",
            "record ten seconds at rest and ten at each feed without any hit (method = 'silent'); about 2 min",
        )
    rest: dict[str, float] = {}
    for m in (m for m in silent if not any((m.feed or {}).values())):
        for name, (level, _) in _levels(m).items():
            rest[name] = min(level, rest.get(name, level))
    for m in (m for m in silent if any((m.feed or {}).values())):
        for name, (level, tonal) in _levels(m).items():
            if level > RULES.self_excited * rest.get(name, np.inf) and tonal > RULES.tonal:
                yield warning(
                    "limit_cycle",
                    f"{m.name}, {name}",
                    f"{level:.3g} m/s^2 rms in motion without excitation, {level / rest[name]:.2g} times that at rest",
                    "a compliance measured at this feed is none of a machine at rest: measure at another feed, or find "
                    "the cause",
                )


def _levels(measurement: Measurement) -> dict[str, tuple[float, float]]:
    """Rms of each accelerometer about its mean [m/s2] and share of its lines, of the record with the largest rms."""
    found: dict[str, tuple[float, float]] = {}
    for entry in measurement.records:
        for record in records_of(entry):
            for name, samples in channels_of(record):
                level = float(np.std(samples))
                if name.startswith("acceleration") and level > found.get(name, (0.0, 0.0))[0]:
                    lines = sum(0.5 * a**2 for _, a, _ in tones(samples, sample_interval(record)))
                    found[name] = level, lines / level**2
    return found
