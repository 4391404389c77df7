"""Which part of a record is judged, and how fast the spindle turns in it: the stationary part of the cut.

- Without an interval, the last half of the longest stretch that is not air is judged.
- A recorded spindle angle or speed must agree with the given one and be constant within the part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import axis_present, sample_interval

SPEED_MISMATCH = 0.01
"""Relative difference between a recorded and the given speed above which one of them must be wrong [1]."""

SPEED_PIECES = 32
"""Most pieces on whose means a recorded speed is tested for being constant."""


@dataclass(frozen=True)
class CutPart:
    """The samples that are judged, and the whole cut they are taken from; shapes (axes, n)."""

    samples: NDArray[np.float64]
    cut: NDArray[np.float64]
    dt: float
    interval: tuple[float, float]

    @property
    def duration(self) -> float:
        """Length of what is judged [s]."""
        return float(self.samples.shape[1] * self.dt)


def judged_part(
    record: xr.Dataset, channel: str, axes: list[str], turn: float, interval: tuple[float, float] | None
) -> CutPart:
    """Return the samples to judge: the given interval, or the last half of the cut."""
    dt = sample_interval(record)
    time = record["time"].values
    samples = _rows(record[channel], axes)
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
        every = _rows(record[shows], axis_present(record, shows) if "axis" in record[shows].dims else axes)
        first, last = _find_cut(every, max(2, round(turn / dt)), shows == "force")
        begin = (first + last) // 2
    bounds = float(time[begin]), float(time[last - 1])
    return CutPart(samples[:, begin:last], samples[:, first:last], dt, bounds)


def _rows(channel: xr.DataArray, axes: list[str]) -> NDArray[np.float64]:
    """Return samples, shape (axes, n); a channel without axes is one row."""
    if "axis" not in channel.dims:
        return np.asarray(channel.values, dtype=float)[None]
    return np.asarray(channel.sel(axis=axes).transpose("axis", "time").values, dtype=float)


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


def stated_frequency(record: xr.Dataset, part: CutPart) -> float | None:
    """Return the spindle frequency [Hz] that a record states by an angle or a speed; None where it states none."""
    inside = ((record["time"] >= part.interval[0]) & (record["time"] <= part.interval[1])).values
    if "spindle_angle" in record:
        angle = np.unwrap(record["spindle_angle"].values[inside])
        time = record["time"].values[inside]
        return abs(float(np.polyfit(time - time[0], angle, 1)[0])) / (2.0 * math.pi)
    if "spindle_speed" in record:
        speed = float(np.nanmedian(record["spindle_speed"].values[inside])) / 60.0
        return speed if speed > 0.0 else None
    return None


def spindle_frequency(record: xr.Dataset, part: CutPart, nominal: float, tolerance: float) -> tuple[float, bool]:
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
