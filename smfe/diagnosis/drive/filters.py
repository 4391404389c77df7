"""Filters and segments of a drive record: derivatives of an encoder, a low-pass that can shift in time, moves.

The low-pass is that of `smfe.identification.spectra.low_pass`; evaluated at ``t + tau`` its kernel advances a record by
any fraction of a sample.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy.linalg import solve_banded
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from process.types import Real
from smfe.diagnosis.drive.rules import RULES
from smfe.identification.spectra.low_pass import filtered, half_width, kernel


@dataclass(frozen=True)
class Resampler:
    """The low-pass of both sides of a force balance, read at every `every`-th sample."""

    step: float  # sample interval [s]
    cutoff: float  # cutoff [Hz]
    every: int  # samples between two values that are kept
    slack: int  # largest shift [samples]

    @property
    def margin(self) -> int:
        """Samples needed before the first and after the last value."""
        return math.ceil(half_width(self.cutoff) / self.step) + self.slack

    def __call__(self, samples: Real, advance: float = 0.0) -> Real:
        """Return ``(g * samples)(t + advance)`` [s] at every kept sample that has its margin."""
        every, reach = self.every, self.margin
        weights = _weights(self.cutoff, self.step, every, reach, advance)
        count = (samples.size - 2 * reach - 1) // every + 1
        # Products of whole rows of `every` samples, then their sums along the diagonals: each sample is read once.
        rows = np.zeros((count + weights.shape[0]) * every)
        used = min(samples.size, rows.size)
        rows[:used] = samples[:used]
        products = rows.reshape(-1, every) @ weights.T
        down, across = products.strides
        diagonals = as_strided(products, (count, weights.shape[0]), (down, down + across), writeable=False)
        return np.asarray(diagonals.sum(axis=1))

    def gain(self, frequency: Real) -> Real:
        """Return what it passes of sines of some frequencies [Hz]; between a thousand of them linearly."""
        return np.asarray(np.interp(frequency, *_gains(self)))


@lru_cache(maxsize=16)
def _gains(filter_: Resampler) -> tuple[Real, Real]:
    known = np.linspace(0.0, 2.0 * filter_.cutoff, 1001)
    times = filter_.step * np.arange(-filter_.margin, filter_.margin + 1, dtype=np.float64)
    weights = filter_.step * kernel(times, filter_.cutoff)
    return known, np.asarray(np.cos(2.0 * math.pi * np.outer(known, times)) @ weights)


@lru_cache(maxsize=256)
def _weights(cutoff: float, step: float, every: int, reach: int, advance: float) -> Real:
    """Weights of the samples around a kept one, in rows of `every`; a fit asks for each delay many times."""
    times = step * np.arange(-reach, reach + 1, dtype=np.float64)
    found = np.zeros(math.ceil(times.size / every) * every)
    found[: times.size] = step * kernel(advance - times, cutoff)
    return found.reshape(-1, every)


@dataclass(frozen=True)
class Motion:
    """What the encoder says, sample by sample (SI), and the time; every array has shape (n,).

    `path` is the whole record, of which `first` is the first sample here, in the widest band that the encoder allows:
    friction gives way within micrometres after a reversal, which the band of the force balance would smear.
    """

    time: Real
    position: Real
    velocity: Real
    acceleration: Real
    jerk: Real
    snap: Real
    path: Path = field(repr=False)
    first: int = 0

    @property
    def rate(self) -> Real:
        """Velocity in the wide band [m/s]."""
        return self.path.velocity[self.first : self.first + self.time.size]

    @property
    def standing(self) -> NDArray[np.bool_]:
        """Where the axis stands (`standing`)."""
        return self.path.standing[self.first : self.first + self.time.size]

    def sliding(self, slide: float, damping: float = 0.0) -> Real:
        """Return the direction of sliding of bristles of a length [m] and a damping [s] (`bristles.Path`)."""
        return self.path.direction(slide, damping)[self.first : self.first + self.time.size]

    def built(self, speed: float, slide: float, damping: float = 0.0, exponent: float = 1.0) -> Real:
        """Return what bristles make of a direction that builds up over a speed [m/s] (`bristles.Path`)."""
        return self.path.built(speed, slide, damping, exponent)[self.first : self.first + self.time.size]

    @property
    def step(self) -> float:
        """Sample interval [s]."""
        return float(self.time[1] - self.time[0])

    def __getitem__(self, part: slice) -> Motion:
        """Return a part of the motion."""
        first = self.first + range(self.time.size)[part].start
        own = (self.time, self.position, self.velocity, self.acceleration, self.jerk, self.snap)
        time, position, velocity, acceleration, jerk, snap = (x[part] for x in own)
        return Motion(time, position, velocity, acceleration, jerk, snap, self.path, first)


def motion(position: Real, step: float, cutoff: float) -> Motion:
    """Differentiate an encoder record [m] for a balance in a band [Hz]; time counts from the middle of the record.

    The band of the motion is twice that, and wide enough for the shortest rest: what a narrower one smears into it from
    the ramps beside it would be lost where the axis stands.
    """
    narrow = 2.0 * cutoff
    band = max(narrow, min(1.0 / RULES.standing_time, RULES.wide / step))
    acceleration = filtered(position, step, band, 2)
    return Motion(
        step * (np.arange(position.size, dtype=np.float64) - 0.5 * (position.size - 1)),
        filtered(position, step, band),
        filtered(position, step, band, 1),
        acceleration,
        filtered(acceleration, step, band, 1),
        filtered(acceleration, step, band, 2),
        _path(position, step, narrow),
    )


def _path(position: Real, step: float, cutoff: float) -> Path:
    """Follow a record up to a fifth of the sample rate, where the encoder is finer than friction gives way.

    Above that rate the encoder has its noise within the band too, which must not pass for reversals.
    """
    for wide in (max(RULES.wide / step, cutoff), cutoff):
        rough = position - filtered(position, step, wide)
        edge = math.ceil(half_width(wide) / step)
        inner = rough[edge : rough.size - edge]
        noise = float(np.std(inner)) if inner.size else math.inf
        if 6.0 * noise <= RULES.finest_slide:
            break
    least = RULES.trembles * noise * math.sqrt(wide / max(0.5 / step - wide, wide)) if inner.size else 0.0
    rests = standing(position, step)
    return Path(filtered(position, step, wide), filtered(position, step, wide, 1), step, least, rests)


def standing(position: Real, step: float) -> NDArray[np.bool_]:
    """Return where an axis stands: the encoder stays within a micrometre, or two of its steps, for 10 ms.

    There friction is whatever balances the drive, up to its limit: the motion says nothing of it. Very slow axes may
    make good 0.5 % of what they do at their greatest speed.
    """
    width = 2 * max(math.ceil(0.5 * RULES.standing_time / step), 2) + 1
    if position.size <= width:
        return np.zeros(position.size, dtype=bool)
    steps = np.abs(np.diff(position))
    moving = steps[steps > 1e-9 * max(float(np.ptp(position)), 1e-300)]
    count = float(moving.min()) if moving.size else 0.0
    fastest = float(np.quantile(steps, 0.99)) * width
    most = max(min(RULES.finest_slide, RULES.standing_share * fastest), 2.0 * count)
    within = maximum_filter1d(position, width) - minimum_filter1d(position, width) <= most
    return np.asarray(maximum_filter1d(within.astype(np.uint8), width) > 0)


def moves(velocity: Real, step: float, first: int, last: int) -> Iterator[tuple[int, int]]:
    """Yield the moves of a record as (first sample, end): from rest to rest, cut where they last over 2 s.

    Rest is a speed below 2 % of the greatest; what lasts less than 0.2 s is left out. Of a rest of 0.2 s or longer only
    50 ms at either end belong to the moves: the force of an axis at rest is that of its controller.
    """
    speed = np.abs(velocity[first:last])
    resting = speed < RULES.rest * speed.max()
    edges = np.flatnonzero(np.diff(np.concatenate(([0], resting.astype(np.int8), [0])))).reshape(-1, 2)
    pad, begin = round(RULES.settling / step), first
    for a, b in [*(edges + first).tolist(), [last, last]]:
        standing = b - a >= RULES.shortest_move / step
        end = min(a + pad, b) if standing else a + int(np.argmin(speed[a - first : b - first])) if b > a else last
        pieces = max(math.ceil((end - begin) * step / RULES.longest_move), 1)
        if (end - begin) * step >= RULES.shortest_move:
            ends = np.linspace(begin, end, pieces + 1).astype(int)
            yield from zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True)
        begin = max(b - pad, a) if standing else end


# --- The direction of sliding along a record: bristles that follow a reversal over micrometres.


def reversals(position: Real, velocity: Real, least: float = 0.0) -> tuple[float, tuple[int, ...]]:
    """Return the direction at first, and the first sample of each way back that is longer than `least` [m]."""
    forward = velocity >= 0.0
    turning = np.flatnonzero(forward[1:] != forward[:-1]) + 1
    first = way = 1.0 if forward[0] else -1.0
    found: list[int] = []
    farthest, at = float(position[0]), 0
    for k in [*turning.tolist(), velocity.size - 1]:
        ahead = way * (float(position[k]) - farthest)
        if ahead < -least:
            if at:
                found.append(at)
            else:
                first = -first
            way, farthest, at = -way, float(position[k]), k
        elif ahead > 0.0:
            farthest, at = float(position[k]), k
    return first, tuple(found)


def presliding(
    position: Real, velocity: Real, slide: float, step: float = 0.0, turns: tuple[float, Sequence[int]] | None = None
) -> Real:
    """Return the direction of sliding [1], which follows a reversal over a distance `slide` [m] (Dahl 1968).

    At the first sample it slides. With the sample interval `step` [s] a reversal is where the velocity passes zero
    between two samples: within a millisecond an axis goes back by a good part of the distance over which its friction
    gives way. `turns` are the `reversals`.
    """
    way, found = reversals(position, velocity) if turns is None else turns
    out = np.full(velocity.size, way)
    before, since = way, position[0]
    for a, b in pairwise([*found, velocity.size]):
        speed = velocity[a]
        # Half of the speed times the share of the step that is left after the velocity was zero.
        turn = position[a] - 0.5 * speed * step * speed / (speed - velocity[a - 1])
        before = way - (way - before) * np.exp(-abs(turn - since) / slide)
        way, since = -way, turn
        out[a:b] = way - (way - before) * np.exp(-np.abs(position[a:b] - turn) / slide)
    return out


class Path:
    """Position [m] and velocity [m/s] of a whole record in the widest band that its encoder allows.

    A reversal counts from a way back of `least` [m]; `rests` is where the axis stands, by default nowhere.
    """

    def __init__(
        self,
        position: Real,
        velocity: Real,
        step: float,
        least: float = 0.0,
        rests: NDArray[np.bool_] | None = None,
    ) -> None:
        self.position, self.velocity, self.step = position, velocity, step
        self.standing = np.zeros(position.size, dtype=bool) if rests is None else rests
        self._turns = reversals(position, velocity, least)
        self._kept: dict[tuple[float, ...], Real] = {}

    def built(self, speed: float, slide: float, damping: float = 0.0, exponent: float = 1.0) -> Real:
        """Return what bristles make of ``[1 - exp(-(|v|/speed)^exponent)] sign v`` [1], (n,); as `direction`."""
        key = (slide, damping, speed, exponent)
        found = self._kept.get(key)
        if found is None:
            ahead, way = self._ahead
            middle = 0.5 * (np.abs(self.velocity[1:]) + np.abs(self.velocity[:-1]))
            kept = np.exp(-ahead / slide)
            # z[k+1] = kept[k] z[k] + (1 - kept[k]) target[k], a bidiagonal system.
            bands = np.stack([np.ones(way.size), np.append(-kept, 0.0)])
            begin = -way[0] * np.expm1(-((abs(self.velocity[0]) / speed) ** exponent))
            target = -np.expm1(-((middle / speed) ** exponent)) * way[1:]
            z = solve_banded((1, 0), bands, np.append(begin, (1.0 - kept) * target))
            found = self._keep(key, z + damping * np.gradient(z, self.step) if damping else z)
        return found

    @cached_property
    def _ahead(self) -> tuple[Real, Real]:
        """Way made good in each step [m], not counting what the encoder trembles, (n - 1,), and its direction, (n,)."""
        way, found = self._turns
        direction, made = np.full(self.position.size, way), np.zeros(self.position.size)
        for a, b in pairwise([0, *found, self.position.size]):
            direction[a:b] = way
            reached = np.maximum.accumulate(way * (self.position[a:b] - self.position[max(a - 1, 0)]))
            made[a:b] = np.maximum(np.diff(reached, prepend=0.0), 0.0)
            way = -way
        return made[1:], direction

    def _keep(self, key: tuple[float, ...], found: Real) -> Real:
        if len(self._kept) >= RULES.kept_directions:
            self._kept.clear()
        self._kept[key] = found
        return found

    def direction(self, slide: float, damping: float = 0.0) -> Real:
        """Return the direction of sliding ``z + damping dz/dt`` [1], shape (n,), of bristles of a length [m], [s]."""
        key = (slide, damping)
        found = self._kept.get(key)
        if found is None:
            z = presliding(self.position, self.velocity, slide, self.step, self._turns)
            found = self._keep(key, z + damping * np.gradient(z, self.step) if damping else z)
        return found
