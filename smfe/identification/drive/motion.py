"""Motion of a drive and the force that it asks for, in one band: the two sides of its inverse dynamics.

Linear drives are recorded as positions or velocities and forces, rotary ones as angles or rates of turning and torques.
One zero-phase low-pass differentiates the encoder analytically and smooths the force alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import signal
from scipy.interpolate import CubicSpline

from process.errors import InputError
from process.labels import AXES, axis_present, sample_interval
from process.types import Real
from smfe.identification.drive.rules import RULES
from smfe.identification.spectra.low_pass import filtered, half_width, kernel


class Trace(NamedTuple):
    """One record of one axis: sample interval [s], position [m or rad] or velocity, and force [N or N m]."""

    step: float
    motion: Real
    is_velocity: bool
    force: Real


class Balance(NamedTuple):
    """Low-passed and thinned: acceleration and its slope, place, share and velocity of each way, number of the record.

    Shapes (n,), of `share` and `velocity` (2, n): forward and backward.
    """

    acceleration: Real
    jerk: Real
    place: Real
    share: Real
    velocity: Real
    run: NDArray[np.int64]

    def thinned(self, stride: int) -> Balance:
        """Return every so many-th value."""
        return Balance(
            self.acceleration[::stride],
            self.jerk[::stride],
            self.place[::stride],
            self.share[:, ::stride],
            self.velocity[:, ::stride],
            self.run[::stride],
        )


class Kept(NamedTuple):
    """One record of a balance: velocity in a wide band, share of each way (2, samples), and samples that are kept."""

    trace: Trace
    rough: Real
    ways: Real
    at: NDArray[np.int64]


WAYS = ("forward", "backward")

KINDS = {
    False: ("encoder_position", "encoder_speed", "drive_force", {"force": "N", "motion": "m", "inertia": "kg"}),
    True: ("encoder_angle", "encoder_rotation", "drive_torque", {"force": "N m", "motion": "rad", "inertia": "kg m^2"}),
}


def drives_in(records: Sequence[xr.Dataset]) -> list[tuple[bool, str]]:
    """Return whether it is rotary, and its axis, of every drive whose channels all records have."""
    pairs = []
    for rotary, (place, speed, load, _) in KINDS.items():
        for a in AXES:
            if all(_has(r, load, a) and (_has(r, place, a) or _has(r, speed, a)) for r in records):
                pairs.append((rotary, a))
    if pairs:
        return pairs
    there = {f"{n}_{a}" for r in records for n in r.data_vars if "axis" in r[n].dims for a in axis_present(r, str(n))}
    raise InputError(
        "a drive needs its motion and its force in every record: encoder_position or encoder_speed with drive_force, "
        "or encoder_angle or encoder_rotation with drive_torque, of one axis; the records have "
        f"{', '.join(sorted(there)) or 'none of them'}"
    )


def which_drive(records: Sequence[xr.Dataset], axis: str | None) -> tuple[bool, str]:
    """Return whether the drive is rotary, and its axis; without an axis, records of several drives are refused."""
    pairs = [pair for pair in drives_in(records) if axis in (None, pair[1])]
    if len(pairs) == 1:
        return pairs[0]
    names = ", ".join(f"{'angle' if rotary else 'position'} {a}" for rotary, a in drives_in(records))
    raise InputError(f"{len(pairs)} drives of axis {axis or 'x, y or z'} in the records, which have {names}; name one")


def _has(record: xr.Dataset, channel: str, axis: str) -> bool:
    return channel in record and axis in axis_present(record, channel)


def moves(record: xr.Dataset, rotary: bool, axis: str) -> bool:
    """Return whether an axis moves: its channels go further than noise that returns from sample to sample."""
    place, speed, load, _ = KINDS[rotary]
    motion, force = (record[n].sel(axis=axis).values for n in (place if _has(record, place, axis) else speed, load))
    return bool(np.ptp(motion) > 20.0 * np.mean(np.abs(np.diff(motion))) and np.ptp(force) > 0.0)


def trace_of(record: xr.Dataset, rotary: bool, axis: str, steady: bool = False) -> Trace:
    """Take the channels of one axis from a record; refuse gaps, and an axis that does not move.

    A force that never changes is refused, too, unless the record may be a `steady` run, free of noise.
    """
    place, speed, load, units = KINDS[rotary]
    is_velocity = not _has(record, place, axis)
    motion, force = (record[n].sel(axis=axis).values.astype(float) for n in (speed if is_velocity else place, load))
    for values, what, unit in (
        (motion, speed if is_velocity else place, units["motion"]),
        (force, load, units["force"]),
    ):
        if not np.all(np.isfinite(values)):
            raise InputError(f"{what}_{axis} has gaps; a drive is identified from records without")
        alike = np.ptp(values) == 0.0
        if alike and not (values[0] != 0.0 and ((is_velocity and what == speed) or (steady and what == load))):
            raise InputError(
                f"{what}_{axis} is {values[0]:g} {unit} in all samples; take a record of an axis that moves"
            )
    return Trace(sample_interval(record), motion, is_velocity, force)


def _derivative(t: Trace, band: float, order: int) -> Real:
    """Velocity (order 1) or acceleration (2) in the band."""
    samples = t.motion - t.motion[0] if not t.is_velocity else t.motion
    return filtered(samples, t.step, band, order - 1 if t.is_velocity else order)


def encoder_noise(t: Trace, band: float, order: int) -> float:
    """Standard deviation that the noise of the encoder, white, gives velocity or acceleration in the band."""
    wide = 0.2 / t.step
    rough = t.motion - t.motion[0]
    rough = rough - filtered(rough, t.step, wide)
    edge = min(math.ceil(half_width(wide) / t.step), rough.size // 3)
    inner = rough[edge : rough.size - edge]
    level = float(np.median(np.abs(inner))) / 0.6745 / math.sqrt(0.6)
    level = max(level, float(np.std(inner)) * 1e-3, RULES.finest * float(np.ptp(t.motion)))
    reach = math.ceil(half_width(band) / t.step)
    times = t.step * np.arange(-reach, reach + 1.0)
    return level * float(np.linalg.norm(t.step * kernel(times, band, order - 1 if t.is_velocity else order)))


def band_of(traces: Sequence[Trace], highest: float | None) -> float:
    """Choose the highest frequency [Hz]: what the sampling allows, less where the encoder is too coarse."""
    top = min(RULES.band_share / t.step for t in traces)
    if highest is not None:
        if not 0.0 < highest <= 2.0 * top:
            raise InputError(f"a band up to {highest:g} Hz; records at this rate allow up to {2.0 * top:.4g} Hz")
        return highest
    band = min(RULES.widest_band, top)
    shortest = min(t.motion.size * t.step for t in traces)
    lowest = 4.0 * half_width(1.0) / shortest
    while band > 1.2 * lowest:
        signal = math.hypot(*(float(np.std(_derivative(t, band, 2))) for t in traces))
        if math.hypot(*(encoder_noise(t, band, 2) for t in traces)) <= RULES.acceleration_noise * signal:
            break
        band /= 1.25
    if 2.2 * half_width(band) > shortest:
        raise InputError(
            f"a record lasts {shortest:.3g} s and its low-pass at {band:.3g} Hz takes {2.0 * half_width(band):.3g} s: "
            "record a longer motion, at a higher rate"
        )
    return band


def balance_of(traces: Sequence[Trace], band: float) -> tuple[Balance, list[Kept]]:
    """Filter the motion of all records; also return which samples of each are used."""
    parts, kept = [], []
    fastest = max(float(np.abs(_derivative(t, band, 1)).max()) for t in traces)
    for k, t in enumerate(traces):
        wide = max(band, min(RULES.wider * band, 0.2 / t.step))
        rough = _derivative(t, wide, 1)
        least = max(RULES.standstill * fastest, RULES.speed_sigmas * encoder_noise(t, wide, 1))
        ways = np.array([rough > least, rough < -least], dtype=float)
        resting = _within_reach(1.0 - ways[0] - ways[1], t.step, band)
        margin = math.ceil(half_width(band) / t.step)
        at = np.arange(margin, t.motion.size - margin, max(1, int(RULES.every / (band * t.step))))
        at = at[resting[at] < RULES.standstill_weight]
        place = np.cumsum(t.motion) * t.step if t.is_velocity else t.motion - t.motion[0]
        acceleration = _derivative(t, band, 2)
        parts.append(
            Balance(
                acceleration[at],
                np.gradient(acceleration, t.step)[at],
                filtered(place, t.step, band)[at],
                np.array([filtered(w, t.step, band)[at] for w in ways]),
                np.array([filtered(w * rough, t.step, band)[at] for w in ways]),
                np.full(at.size, k),
            )
        )
        kept.append(Kept(t, rough, ways, at))
    joined = Balance(*(np.concatenate(column, axis=-1) for column in zip(*parts, strict=True)))
    if joined.run.size < RULES.least_values:
        raise InputError(
            f"the axis moves for {joined.run.size} values in a band of {band:.3g} Hz; at least {RULES.least_values} "
            "are needed: record a longer stroke, or raise the band with frequency_range"
        )
    return joined, kept


def _within_reach(there: Real, step: float, band: float) -> Real:
    """Return the largest weight that the low-pass gives to samples that are `there` (1, else 0)."""
    reach = math.ceil(half_width(band) / step)
    weights = step * np.abs(kernel(step * np.arange(-reach, reach + 1.0), band))
    return np.asarray(signal.oaconvolve(np.pad(there, reach, mode="edge"), weights, mode="valid"))


def fading(kept: Sequence[Kept], band: float, way: int, speed: float, shape: float) -> Real:
    """Low-pass ``exp(-(|v|/speed)^shape)`` of one way of motion, for friction that fades with the velocity."""
    columns = []
    for part in kept:
        fast = np.minimum(np.abs(part.rough) / speed, 50.0)
        columns.append(smooth(part.ways[way] * np.exp(-(fast**shape)), part.trace.step, band)[part.at])
    return np.concatenate(columns)


def smooth(samples: Real, step: float, band: float) -> Real:
    """Low-pass a record, by blocks in the frequency domain: many columns of a long one are needed."""
    reach = math.ceil(half_width(band) / step)
    weights = step * kernel(step * np.arange(-reach, reach + 1.0), band)
    return np.asarray(signal.oaconvolve(np.pad(samples, reach, mode="edge"), weights, mode="valid"))


class Forces:
    """Low-passed drive force of all records at the kept samples, as a function of a delay [s]."""

    def __init__(self, kept: Sequence[Kept], band: float) -> None:
        self._curves = [
            (CubicSpline(np.arange(k.trace.force.size), smooth(k.trace.force, k.trace.step, band)), k) for k in kept
        ]

    def __call__(self, delay: float) -> Real:
        """Return the forces that were logged a delay [s] earlier."""
        return np.concatenate([curve(k.at - delay / k.trace.step) for curve, k in self._curves])
