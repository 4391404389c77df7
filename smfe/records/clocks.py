"""Two recorders with a clock of their own each: brought together by a channel that both have recorded.

The clocks are taken to run evenly: ``u = p + q (t - t_c)``, with t the time of the first recorder and u that of the
second. A block of the shared channel is looked for in the whole second record; from there on blocks ever further away
are correlated with what the line found so far predicts, their lags are read off with a parabola through the peak, and
the line is fitted again, until it reaches over both records. The second record is interpolated at the predicted times
before each correlation, so that the parabola is only asked for what is left, near zero, where it is not biased.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import signal

from process.errors import InputError
from process.labels import axis_present, make_record, sample_interval
from process.types import Real
from smfe.records.decimate import low_pass
from smfe.records.formats.channels import split_vector

_LEAST_CORRELATION = 0.7
_LEAST_MARGIN = 0.03
_WORST_CLOCK = 3e-4
"""Largest difference of two clocks that is looked for; quartz oscillators are within 1e-4 of each other."""

_LEAST_BLOCK, _MOST_BLOCK = 256, 1 << 16
_SMALLEST = 4 * _LEAST_BLOCK
_MOST_BLOCKS = 64
_MOST_COARSE = 1 << 20
"""Samples among which the first block is looked for; longer records are thinned for that."""


@dataclass(frozen=True)
class ClockFit:
    """How the clock of a second recorder runs: ``u = p + q (t - centre)``.

    Parameters
    ----------
    centre : float
        Time of the first recorder around which the line is given [s].
    p : float
        Time of the second recorder then [s].
    q : float
        Its rate against the first, 1 for equal clocks.
    p_std, q_std : float
        Standard deviations [s], [1].
    std : float
        Standard deviation of the time of the second record within what both share, at its worst [s].
    correlation : float
        Median correlation coefficient of the blocks.
    blocks : int
        Blocks that the line was fitted to.
    """

    centre: float
    p: float
    q: float
    p_std: float
    q_std: float
    std: float
    correlation: float
    blocks: int

    def other_time(self, time: Real) -> Real:
        """Return the times of the second recorder at times of the first."""
        return self.p + self.q * (time - self.centre)


@dataclass(frozen=True)
class _Signal:
    """A channel on the clock of its recorder."""

    first: float
    step: float
    samples: Real

    @property
    def last(self) -> float:
        return self.first + self.step * (self.samples.size - 1)

    def at(self, time: Real, step: float) -> Real:
        """Return the channel at times `step` apart, of which all lie within the record."""
        return resample(self.samples, (time - self.first) / self.step, step / self.step)

    def every(self, step: float) -> _Signal:
        """Return the channel at a wider step."""
        if step <= self.step * (1.0 + 1e-9):
            return self
        count = int((self.last - self.first) / step * (1.0 + 1e-12)) + 1
        return _Signal(self.first, step, self.at(np.asarray(self.first + step * np.arange(count)), step))

    def thinned(self, factor: int) -> _Signal:
        """Return every `factor`-th sample of what the lower rate can hold."""
        if factor == 1:
            return self
        taps = low_pass(factor)
        delay = taps.size // 2 // factor
        count = (self.samples.size - 1) // factor + 1
        samples = signal.upfirdn(taps, self.samples, 1, factor)[delay : delay + count]
        return _Signal(self.first, self.step * factor, np.asarray(samples))


def put_on_clock(record: xr.Dataset, other: xr.Dataset, shared: str) -> xr.Dataset:
    """Add the channels of a second recorder to a record, on the clock of the record.

    Parameters
    ----------
    record, other : xarray.Dataset
        Records of one event with clocks of their own.
    shared : str
        Channel that both have, "force_x" or "spindle_speed"; that of `record` is kept.

    Returns
    -------
    xarray.Dataset
        The samples of `record` for which `other` has samples too, with the channels of both. ``attrs`` hold
        ``clock_ratio`` with ``clock_ratio_std`` and ``clock_std_s``, the standard deviation of the alignment at its
        worst; where a third recorder is added, those of the last one.

    Raises
    ------
    InputError
        When a record lacks the shared channel, another channel is in both, or `fit_clock` refuses.
    """
    a, b = (_signal(r, shared) for r in (record, other))
    fit = fit_clock(a, b, f"{shared} of {record.attrs.get('source', 'the record')}", str(other.attrs.get("source", "")))
    clock = {"clock_ratio": fit.q, "clock_ratio_std": fit.q_std, "clock_std_s": fit.std}
    return _merged(record, other, fit.other_time(record["time"].values), shared).assign_attrs(clock)


def put_on_time(record: xr.Dataset, other: xr.Dataset, offset: float = 0.0) -> xr.Dataset:
    """Add the channels of a file that shares its clock with a record but no channel.

    Parameters
    ----------
    record, other : xarray.Dataset
        Records of one event, whose times are those of one clock, or of two that differ by a fixed offset.
    offset : float, optional
        Time of the clock of `other` less that of `record` [s].

    Returns
    -------
    xarray.Dataset
        The samples of `record` for which `other` has samples too, with the channels of both.

    Raises
    ------
    InputError
        When the two share less than two samples of time, or a channel is in both.
    """
    return _merged(record, other, record["time"].values + offset, None)


def _merged(record: xr.Dataset, other: xr.Dataset, u: Real, shared: str | None) -> xr.Dataset:
    """Return a record with the channels of another, at the times u of the other for each sample of the record."""
    time = record["time"].values
    first, step = float(other["time"].values[0]), sample_interval(other)
    last = float(other["time"].values[-1])
    inside = (u >= first - 1e-6 * step) & (u <= last + 1e-6 * step)
    if int(inside.sum()) < 2:
        raise InputError(
            f"{record.attrs.get('source', 'the record')} runs from {time[0]:.6g} to {time[-1]:.6g} s, "
            f"{other.attrs.get('source', 'the other file')} from {first:.6g} to {last:.6g} s of its clock: they share "
            'no time; give the offset of its clock, offset = "2.5 s", or a channel that both have, shared = "force_x"'
        )
    positions = np.clip((u[inside] - first) / step, 0.0, other.sizes["time"] - 1.0)
    stretch = float(u[-1] - u[0]) / (u.size - 1) / step
    vectors = {str(v): _rows(record, str(v), inside) for v in record.data_vars if "axis" in record[v].dims}
    scalars = {str(v): record[v].values[inside] for v in record.data_vars if "axis" not in record[v].dims}
    for name, samples in _channels(other).items():
        if name == shared:
            continue
        vector = split_vector(name)
        there = name in scalars if vector is None else vector[1] in vectors.get(vector[0], {})
        if there:
            raise InputError(
                f"{name} is in both {record.attrs.get('source')} and {other.attrs.get('source')}; declare it for one "
                f"of them, or make it the shared channel{f' instead of {shared}' if shared else ''}"
            )
        values = resample(samples, positions, stretch)
        if vector is None:
            scalars[name] = values
        else:
            vectors.setdefault(vector[0], {})[vector[1]] = values
    merged = make_record(time[inside], vectors, scalars, record.attrs)
    for name in scalars:
        merged[name].attrs.update((record if name in record else other)[name].attrs)
    return merged


def _rows(record: xr.Dataset, vector: str, inside: NDArray[np.bool_]) -> dict[str, Real]:
    return {axis: record[vector].sel(axis=axis).values[inside] for axis in axis_present(record, vector)}


def _channels(record: xr.Dataset) -> dict[str, Real]:
    found = {}
    for variable in map(str, record.data_vars):
        if "axis" not in record[variable].dims:
            found[variable] = record[variable].values
            continue
        for axis in axis_present(record, variable):
            found[f"{variable}_{axis}"] = record[variable].sel(axis=axis).values
    return found


def _signal(record: xr.Dataset, shared: str) -> _Signal:
    channels = _channels(record)
    if shared not in channels:
        raise InputError(
            f"{record.attrs.get('source', 'a record')}: the shared channel {shared} is not among "
            f"{', '.join(channels)}; declare it for both files"
        )
    return _Signal(float(record["time"].values[0]), sample_interval(record), channels[shared])


# --- the line --------------------------------------------------------------------------------------------------------


def fit_clock(a: _Signal, b: _Signal, name: str = "the shared channel", source: str = "") -> ClockFit:
    """Find how the clock of `b` runs against that of `a`.

    Parameters
    ----------
    a, b : signals
        The shared channel of both recorders.
    name, source : str, optional
        What it is called, and the second file, for messages.

    Raises
    ------
    InputError
        When the records are too short, the channel does not correlate or repeats itself, or the clocks differ by more
        than 3e-4.
    """
    step = max(a.step, b.step)
    a, b = a.every(step), b.every(step)
    if min(a.samples.size, b.samples.size) < _SMALLEST:
        raise InputError(
            f"{name} and {source}: {min(a.samples.size, b.samples.size)} samples are too few to align clocks by; at "
            f"least {_SMALLEST} are needed"
        )
    thin = max(1, math.ceil(max(a.samples.size, b.samples.size) / _MOST_COARSE))
    centre, p = _coarse(a.thinned(thin), b.thinned(thin), name, source)
    size = int(np.clip(a.samples.size // 32, _LEAST_BLOCK, _MOST_BLOCK))
    whole = max(a.last - centre, centre - a.first)
    reaches = [4.0 * size * step]
    while reaches[-1] < whole:
        reaches.append(2.0 * reaches[-1])
    found, q, q_std = None, 1.0, _WORST_CLOCK
    for reach in (*reaches, reaches[-1]):
        search = int(np.ceil(3.0 + q_std * min(reach, whole) / step)) + (thin if found is None else 0)
        found = _line(_lags(a, b, (centre, p, q), size, reach, search), centre, a, f"{name} and {source}")
        p, q, q_std = found.p, found.q, min(3.0 * found.q_std, _WORST_CLOCK)
    assert found is not None
    if abs(found.q - 1.0) > _WORST_CLOCK:
        raise InputError(
            f"{name} and {source}: their clocks differ by {abs(found.q - 1.0):.2g}; check their sample rates"
        )
    return found


def _coarse(a: _Signal, b: _Signal, name: str, source: str) -> tuple[float, float]:
    """Return a time of a and the time of b that belongs to it, from the clearest of several blocks."""
    best = (False, -1.0, -1.0, 0.0, 0.0)
    for size in sorted({max(_LEAST_BLOCK, a.samples.size // part) for part in (2, 4, 16)}):
        size = min(size, b.samples.size)
        for start in _busy(a.samples, size):
            rho = _correlation(a.samples[start : start + size], b.samples)
            at = int(np.argmax(rho))
            away = np.abs(np.arange(rho.size) - at) > _lobe(rho, at)
            margin = float(rho[at]) - (float(rho[away].max()) if away.any() else 0.0)
            middle = 0.5 * (size - 1)
            times = a.first + a.step * (start + middle), b.first + b.step * (at + middle)
            best = max(best, (float(rho[at]) >= _LEAST_CORRELATION, margin, float(rho[at]), *times))
    _, margin, highest, centre, p = best
    if highest < _LEAST_CORRELATION:
        raise InputError(
            f"{name} and {source}: the shared channel correlates by {highest:.2f} at best, {_LEAST_CORRELATION} is "
            "needed; check that both files record the same event and channel"
        )
    if margin < _LEAST_MARGIN:
        raise InputError(
            f"{name} and {source}: the shared channel repeats itself, so that several lags fit "
            f"equally well (correlation {highest:.3f}, next {highest - margin:.3f}); share a channel that begins, ends "
            "or changes speed"
        )
    return centre, p


def _busy(samples: Real, size: int) -> list[int]:
    """Return where blocks begin that have at least half the power of the most powerful; up to five, far apart."""
    starts = np.linspace(0, samples.size - size, 17).astype(np.int64)
    power = np.array([np.var(samples[start : start + size]) for start in starts])
    busy = starts[power >= 0.5 * power.max()]
    return [int(start) for start in busy[np.unique(np.linspace(0, busy.size - 1, 5).astype(np.int64))]]


def _correlation(block: Real, other: Real) -> Real:
    """Return the correlation coefficient of a block with every stretch of the other signal that is as long."""
    ones = np.ones(block.size)
    centred = block - block.mean()
    products = signal.oaconvolve(other, centred[::-1], mode="valid")
    mean = signal.oaconvolve(other, ones, mode="valid") / block.size
    power = signal.oaconvolve((other - other.mean()) ** 2, ones, mode="valid") - block.size * (mean - other.mean()) ** 2
    floor = 1e-9 * block.size * float(np.var(other)) + 1e-300
    return np.asarray(products / np.sqrt(np.maximum(power, floor) * (centred @ centred + 1e-300)))


def _lobe(rho: Real, at: int) -> int:
    """Return the half width of a peak: where the correlation rises again on both sides."""
    width = 1
    for side in (rho[at::-1], rho[at:]):
        rising = np.flatnonzero(np.diff(side) > 0.0)
        width = max(width, int(rising[0]) if rising.size else side.size)
    return width


@dataclass(frozen=True)
class _Point:
    """A block: time of a, time of b, standard deviation that its correlation promises [s], correlation."""

    t: float
    u: float
    std: float
    rho: float


def _lags(
    a: _Signal, b: _Signal, line: tuple[float, float, float], size: int, reach: float, search: int
) -> list[_Point]:
    """Return the lag of every block of a within `reach` of the centre that b covers and in which something happens."""
    centre, p, q = line
    points = []
    power = float(np.var(a.samples))
    starts = np.arange(0, a.samples.size - size + 1, size)
    for start in starts[:: math.ceil(starts.size / _MOST_BLOCKS)]:
        middle = a.first + a.step * (start + 0.5 * (size - 1))
        block = a.samples[start : start + size]
        if abs(middle - centre) > reach or np.var(block) < 0.01 * power:
            continue
        time = a.first + a.step * np.arange(start - search, start + size + search)
        u = p + q * (time - centre)
        if u[0] < b.first or u[-1] > b.last:
            continue
        rho = _correlation(block, b.at(np.asarray(u), a.step * q))
        at = int(np.argmax(rho))
        lag = float(at - search)
        if 0 < at < rho.size - 1:
            left, top, right = rho[at - 1 : at + 2]
            lag += 0.5 * (left - right) / (left - 2.0 * top + right)
        points.append(
            _Point(middle, p + q * (middle - centre + lag * a.step), _promised(block, rho[at], a.step), rho[at])
        )
    return points


def _promised(block: Real, rho: float, step: float) -> float:
    """Return the Cramer-Rao bound of a lag [s]: ``sqrt((1 - rho^2)/(rho^2 N)) / w_rms`` (Carter 1987)."""
    centred = block - block.mean()
    speed = np.sqrt(np.mean(np.gradient(centred, step) ** 2) / max(float(np.mean(centred**2)), 1e-300))
    share = max(1.0 - float(rho) ** 2, 1e-12) / max(float(rho) ** 2, 1e-6)
    return float(np.sqrt(share / block.size) / max(float(speed), 1e-300))


def _line(points: Sequence[_Point], centre: float, a: _Signal, what: str) -> ClockFit:
    """Fit the line to the blocks that correlate; with fewer than four the clocks are taken to run alike."""
    good = [point for point in points if point.rho >= _LEAST_CORRELATION]
    if not good or len(good) < 0.5 * len(points):
        median = float(np.median([point.rho for point in points])) if points else 0.0
        raise InputError(
            f"{what}: the shared channel correlates by {median:.2f} in the median of {len(points)} blocks, "
            f"{_LEAST_CORRELATION} is needed; check that both files record the same event and channel"
        )
    t = np.array([point.t for point in good]) - centre
    u = np.array([point.u for point in good])
    weight = 1.0 / np.array([point.std for point in good]) ** 2
    design = np.column_stack([np.ones_like(t), t]) if len(good) >= 4 else np.ones((t.size, 1))
    target = u - t if len(good) < 4 else u
    normal = np.linalg.inv(design.T @ (weight[:, None] * design))
    solution = normal @ (design.T @ (weight * target))
    left = target - design @ solution
    spread = float(np.sum(weight * left**2)) / max(t.size - solution.size, 1)
    covariance = normal * max(spread, 1.0)
    p_std = float(np.sqrt(covariance[0, 0]))
    q, q_std = (float(solution[1]), float(np.sqrt(covariance[1, 1]))) if len(good) >= 4 else (1.0, _WORST_CLOCK / 3.0)
    ends = np.array([a.first, a.last]) - centre
    worst = p_std**2 + (q_std * ends) ** 2
    if len(good) >= 4:
        worst = worst + 2.0 * covariance[0, 1] * ends
    rho = float(np.median([point.rho for point in good]))
    return ClockFit(centre, float(solution[0]), q, p_std, q_std, float(np.sqrt(worst.max())), rho, len(good))


# --- Band-limited interpolation: a signal at any times between its samples.


_HALF = 32
_BETA = 10.0
_PHASES = 1024
_AT_ONCE = 1 << 19
"""Neighbours that are gathered at a time."""


def resample(samples: Real, positions: Real, stretch: float = 1.0) -> Real:
    """Return a signal at positions between its samples.

    The kernel is the Kaiser-windowed sinc of `smfe.records.align.shift` over 65 samples, from a table of 1024 phases
    with linear interpolation between them: the error is below 1e-4 up to 0.8 of the Nyquist frequency. Beyond both
    ends the samples are continued by point reflection.

    Parameters
    ----------
    samples : ndarray
        ``x(0), x(1), ...``
    positions : ndarray
        Where to evaluate, in samples, from 0 to ``samples.size - 1``.
    stretch : float, optional
        Distance of the positions in samples where it is more than one: the kernel is as much wider, and what the new
        sample rate cannot hold is removed.
    """
    stretch = stretch if stretch > 1.01 else 1.0  # two clocks of one rate differ by far less
    half = min(math.ceil(_HALF * stretch), samples.size - 1)
    table = _table(half, stretch)
    padded = np.pad(samples, half, mode="reflect", reflect_type="odd")
    out = np.empty(positions.size)
    near = np.arange(2 * half + 1)
    rows = max(64, _AT_ONCE // near.size)
    for begin in range(0, positions.size, rows):
        at = positions[begin : begin + rows]
        whole = np.clip(np.round(at).astype(np.int64), 0, samples.size - 1)
        phase = (at - whole + 0.5) * _PHASES
        cell = np.clip(phase.astype(np.int64), 0, _PHASES - 1)
        share = (phase - cell)[:, None]
        weights = table[cell] * (1.0 - share) + table[cell + 1] * share
        out[begin : begin + at.size] = np.einsum("ij,ij->i", weights, padded[whole[:, None] + near])
    return out


@lru_cache(maxsize=8)
def _table(half: int, stretch: float) -> Real:
    """Return the weights of the neighbours ``-half .. half`` for fractions -0.5 to 0.5, each row with the sum one."""
    fraction = np.linspace(-0.5, 0.5, _PHASES + 1)[:, None]
    at = fraction - np.arange(-half, half + 1)
    inside = np.clip(1.0 - (at / (half + 0.5)) ** 2, 0.0, None)
    weights = np.sinc(at / stretch) * np.i0(_BETA * np.sqrt(inside))
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
