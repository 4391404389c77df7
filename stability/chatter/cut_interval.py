"""Which part of a record is judged, and how fast the spindle turns in it: entry, cut and exit.

- Air, entry, steady cut and exit are separated by the level of each turn. Without an interval, the second half of the
  cut is judged, more of it where that is short, and neither entry nor exit.
- Forces are taken from the whole steady cut, or the interval, less what a dynamometer shows in the air.
- A recorded spindle angle, tacho or speed must agree with the given speed and be constant within the part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from process.errors import InputError
from process.instruments.tacho import tacho_angle
from process.labels import axis_present, sample_interval
from process.types import Real
from stability.chatter.rules import RULES
from stability.chatter.spindle_speed import resampled


@dataclass(frozen=True)
class CutPart:
    """The samples that are judged, the whole cut they are taken from, and the air; shapes (axes, n).

    ``bounds`` are the times [s] at which the cut begins, is entered, is left and ends; ``base`` is the spindle
    frequency [Hz] once it is known. Over turns (`stability.chatter.spindle_speed`), `dt` is that of the mean speed.
    """

    samples: Real
    cut: Real
    dt: float
    interval: tuple[float, float]
    bounds: tuple[float, float, float, float]
    air: Real
    raw_dt: float
    base: float = 0.0

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
    # The force is nearly zero in air: it separates cut and air best where it has been recorded.
    measure = "force" if axis_present(record, "force") else channel
    every = _rows(
        record[measure],
        axis_present(record, measure) if "axis" in record[measure].dims else axes,
    )
    first, last, *steady = _find_cut(every, max(2, round(turn / dt)), measure == "force")
    if interval is not None:
        begin, end = np.searchsorted(time, interval)
        if end - begin < 16:
            raise InputError(
                f"the interval {interval[0]:g} to {interval[1]:g} s holds {max(end - begin, 0)} samples of a record "
                f"from {time[0]:g} to {time[-1]:g} s; give one with more"
            )
        cut = samples[:, begin:end]
    else:
        fewest, most = (round(count * turn / dt) for count in RULES.judged_turns)
        half = (first + last) // 2
        begin = max(steady[0], min(half, max(steady[1] - fewest, first + (last - first) // 4)), steady[1] - most)
        begin, end = min(begin, steady[1] - 2), steady[1]
        cut = samples[:, first:last]
    at = [float(time[min(i, time.size - 1)]) for i in (first, steady[0], steady[1], last)]
    return CutPart(
        samples=samples[:, begin:end],
        cut=cut,
        dt=dt,
        interval=(float(time[begin]), float(time[end - 1])),
        bounds=(at[0], at[1], at[2], at[3]),
        air=_air(samples, min(first, begin), max(last, end), max(2, round(turn / dt))),
        raw_dt=dt,
    )


def in_the_cut(record: xr.Dataset, rotation: float, interval: tuple[float, float] | None = None) -> xr.Dataset:
    """Return the steady part of a cut, without the air before and after it, entry and exit; less the forces in the air.

    A mean over air as well is too small by its share of the record. What a dynamometer shows in the air is its zero. An
    entry counts as over when it has taken twice the turns in which 70 % of the force is reached: one that rises evenly
    has all of it after 1.4 times as many.

    Parameters
    ----------
    record : xarray.Dataset
        With ``force``.
    rotation : float
        Spindle speed [rad/s].
    interval : (float, float), optional
        Part of the record to take instead [s].

    Raises
    ------
    InputError
        When the interval holds next to nothing of the record.
    """
    axes = axis_present(record, "force")
    turn = 2.0 * math.pi / rotation
    part = judged_part(record, "force", axes, turn, interval)
    begin, entered, left, end = part.bounds
    # A cut that begins or ends with the record has no entry or exit.
    first, last = interval or (min(2.0 * entered - begin, left), max(2.0 * left - end, entered))
    if first >= last:
        first, last = entered, left
    time = record["time"].values
    inside = record.isel(time=np.flatnonzero((time >= first) & (time <= last)))
    if part.air.shape[1] * part.raw_dt < RULES.turns_of_air * turn:
        return inside
    zero = xr.DataArray(part.air.mean(axis=1), {"axis": axes})
    return inside.assign(
        force=(inside["force"] - zero).transpose(*inside["force"].dims).assign_attrs(inside["force"].attrs)
    )


def stretches(
    cut: tuple[float, float, float, float], judged: tuple[float, float], turn: float
) -> list[tuple[float, float]]:
    """Return the stretches [s] of a steady cut in which chatter may come and go: what was not judged, and pieces.

    Parameters
    ----------
    cut : (float, float, float, float)
        Begin, entered, left, end [s].
    judged : (float, float)
        What has been judged as a whole [s].
    turn : float
        Duration of a turn [s].
    """
    first, last = cut[1], cut[2]
    found = [(first, judged[0])] if judged[0] - first >= RULES.turns_of_a_stretch * turn else []
    pieces = min(RULES.most_stretches, int((last - first) / (RULES.turns_of_a_stretch * turn)))
    if pieces > 1:
        edges = np.linspace(first, last, pieces + 1)
        found += list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    return found


def _air(samples: Real, first: int, last: int, turn: int) -> Real:
    """Return the longer of the pieces before and after the cut, less two turns beside it."""
    before, after = samples[:, : max(0, first - 2 * turn)], samples[:, last + 2 * turn :]
    return before if before.shape[1] >= after.shape[1] else after


def _rows(channel: xr.DataArray, axes: list[str]) -> Real:
    """Return samples, shape (axes, n); a channel without axes is one row."""
    if "axis" not in channel.dims:
        return np.asarray(channel.values, dtype=float)[None]
    return np.asarray(channel.sel(axis=axes).transpose("axis", "time").values, dtype=float)


def _find_cut(samples: Real, turn: int, static: bool) -> tuple[int, int, int, int]:
    """Return first and last sample of the cut (the longest stretch of turns that is not air), and of its steady part.

    A turn counts as cut when its level is nearer to that of the highest turns than to that of the lowest
    (`_air_below`). The level is the standard deviation within the turn; with `static` (forces) the departure of its
    mean from the record's quieter end counts too, because a slot with many teeth cuts with a constant force. Entry and
    exit end where the level, a median over three turns,
    has reached 70 % of that of the middle; the exit takes a turn at least.
    """
    n = samples.shape[1]
    blocks = n // turn
    if blocks < 4:
        return 0, n, 0, n
    turns = samples[:, : blocks * turn].reshape(samples.shape[0], blocks, turn)
    power = turns.var(axis=2).sum(axis=0)
    if static:
        means = turns.mean(axis=2)
        air = means[:, :1] if power[0] <= power[-1] else means[:, -1:]
        power = power + ((means - air) ** 2).sum(axis=0)
    level = ndimage.median_filter(np.sqrt(power), size=3, mode="nearest")
    if not level.any():
        return 0, n, 0, n
    start, stop = _longest_cut(level)
    # A few turns far above all others are an entry, an exit or a knock, and hide the cut beside them.
    while stop - start < min(RULES.fewest_turns_of_cut, blocks // 4):
        quieter = np.delete(level, np.arange(start, stop))
        level = np.minimum(level, np.quantile(quieter, 0.95))
        again = _longest_cut(level)
        if again == (start, stop):
            break
        start, stop = again
    inside = level[start:stop]
    third = max(1, inside.size // 3)
    full = np.flatnonzero(inside > 0.7 * np.median(inside[third : 2 * third + 1]))
    begin = start + int(full[0])
    full = np.flatnonzero(inside > 0.7 * np.median(inside[-2 * third : -(third // 3) or None]))
    end = start + int(full[-1]) + 1
    if stop == blocks and end >= stop - 1:
        return start * turn, n, begin * turn, n
    return start * turn, min(stop * turn, n), begin * turn, max(end - 1, begin + 1) * turn


def _longest_cut(level: Real) -> tuple[int, int]:
    """Return first and last turn, exclusive, of the longest stretch whose level is that of a cut."""
    # A cut may swell and fade: a gap of a tenth of the record is none.
    gap = max(1, level.size // 10)
    above = np.pad(level > _air_below(level), gap)
    above_air = np.concatenate(
        [[False], ndimage.binary_closing(above, np.ones(gap + 1, dtype=bool))[gap:-gap], [False]]
    )
    edges = np.flatnonzero(np.diff(above_air.astype(int)))
    if edges.size == 0:
        return 0, level.size
    starts, stops = edges[::2], edges[1::2]
    longest = int(np.argmax(stops - starts))
    return int(starts[longest]), int(stops[longest])


def _air_below(level: Real) -> float:
    """Return the level between air and cut."""
    high, low = float(np.quantile(level, 0.95)), float(np.quantile(level, 0.05))
    # A record without air has nothing much lower; an entry may be higher than all that follows.
    if high < 2.0 * low:
        return 0.2 * high
    return max(3.0 * low, 0.05 * high) if 3.0 * low < 0.35 * high else math.sqrt(low * high)


def axis_part(part: CutPart, row: int) -> CutPart:
    """Return a part with one of its axes."""
    rows = slice(row, row + 1)
    return replace(part, samples=part.samples[rows], cut=part.cut[rows], air=part.air[rows])


def over_turns(part: CutPart, turns: Real, highest: float) -> CutPart:
    """Return a part at equal steps of the angle, at the interval of the mean speed; `highest`: frequency [Hz]."""
    base = float(turns[-1] - turns[0]) / ((turns.size - 1) * part.raw_dt)
    steps = math.ceil(2.5 * highest / base)
    return replace(part, samples=resampled(part.samples, turns, steps), dt=1.0 / (steps * base), base=base)


def with_angle(record: xr.Dataset) -> tuple[xr.Dataset, tuple[str, ...]]:
    """Return a record with the spindle angle that its tacho gives, and what there is to say about it."""
    if "spindle_angle" in record or "tacho" not in record:
        return record, ()
    pulses = float(record["tacho"].attrs.get("pulses_per_revolution", 1.0))
    try:
        angle = tacho_angle(record["time"].values, record["tacho"].values, pulses)
    except InputError as error:
        return record, (f"the tacho is not used: {error}",)
    return record.assign(spindle_angle=("time", angle, {"units": "rad"})), ()


def measured_turns(record: xr.Dataset, part: CutPart) -> Real | None:
    """Return the turns at each judged sample from the spindle angle of a record; None where it has none."""
    if "spindle_angle" not in record:
        return None
    inside = (record["time"] >= part.interval[0]) & (record["time"] <= part.interval[1])
    angle = np.unwrap(record["spindle_angle"].values[inside.values]) / (2.0 * math.pi)
    turns = np.abs(angle - angle[0])
    return turns if bool(np.all(np.diff(turns) >= 0.0)) else None


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
    pieces = int(np.clip(speed.size * turn, 2, RULES.speed_pieces))
    _check_constant(np.array([piece.mean() for piece in np.array_split(speed, pieces)]))
    measured = float(np.median(speed)) / 60.0
    _check_same(measured, nominal, tolerance, "the recorded spindle speed is")
    return measured


def _check_same(measured: float, nominal: float, tolerance: float, what: str) -> None:
    """Refuse a record whose speed [Hz] is not the one given."""
    if abs(measured / nominal - 1.0) > max(tolerance, RULES.speed_mismatch):
        raise InputError(f"{what} {60.0 * measured:g} rpm, {60.0 * nominal:g} rpm were given: correct one of them")


def _check_constant(speed: Real) -> None:
    """Refuse a sweep."""
    low, high = float(speed.min()), float(speed.max())
    if high - low > RULES.most_change * abs(high):
        raise InputError(
            f"the spindle speed varies from {low:g} to {high:g} rpm within the part that is judged; the "
            "criterion needs a constant speed: give an interval in which it is constant"
        )
