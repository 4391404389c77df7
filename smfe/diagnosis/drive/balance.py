"""The channels of a drive record that belong to one axis, and whether they can be those of an axis at all."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.types import Real
from smfe.diagnosis.drive import noise
from smfe.diagnosis.drive.filters import Motion, Resampler, motion, moves
from smfe.diagnosis.drive.noise import Whitener
from smfe.diagnosis.drive.rules import RULES
from smfe.diagnosis.drive.terms import excess
from smfe.diagnosis.inference.rules import RULES as INFERENCE
from smfe.identification.spectra.low_pass import half_width

_UNITS = {"encoder_position": "m", "drive_force": "N"}


@dataclass(frozen=True)
class Channels:
    """Channels of one axis: sample interval [s], encoder [m], drive force [N], reference position [m]."""

    step: float
    position: Real
    force: Real
    reference: Real | None
    kept: dict[tuple[float, ...], Band] = field(default_factory=dict, repr=False, compare=False)
    """Motion and balance in the bands that were asked for before."""

    @classmethod
    def read(cls, record: xr.Dataset, axis: str) -> Channels:
        """Read them from a record; refuse what is missing, not finite or not evenly spaced in time."""
        channels: dict[str, Real] = {}
        for channel in ("encoder_position", "drive_force", "reference_position"):
            if channel in record and axis in record[channel]["axis"].values:
                values = np.asarray(record[channel].sel(axis=axis).values, dtype=float)
                if np.all(np.isfinite(values)):
                    channels[channel] = values
        for needed in ("encoder_position", "drive_force"):
            if needed not in channels:
                raise InputError(f"the record has no {needed}_{axis}; a drive record needs it, with all its samples")
            if np.ptp(channels[needed]) == 0.0:
                raise InputError(
                    f"{needed}_{axis} is {channels[needed][0]:g} {_UNITS[needed]} in all samples; a drive record needs "
                    "an axis that moves: check the column, or take a record of moves"
                )
        time = np.asarray(record["time"].values, dtype=float)
        step = float(np.mean(np.diff(time)))
        if np.max(np.abs(np.diff(time) - step)) > 0.01 * step:
            raise InputError("the samples of the record are not evenly spaced in time; resample them first")
        return cls(step, channels["encoder_position"], channels["drive_force"], channels.get("reference_position"))


def check_balance(force: Real, acceleration: Real, velocity: Real, mass: float | None) -> None:
    """Refuse force [N] and motion [m/s2, m/s] of one band that cannot be those of an axis: a sign or a unit is wrong.

    Least squares of ``F = M x'' + sigma x' + F0`` gives the mass that is moved, wherever inertia is a good part of the
    force: it must be positive, and within a factor of ten of the mass [kg] that is known. And an axis takes up energy:
    over a closed path, ``int (F - F0) x' dt >= 0`` but for the kinetic energy at its beginning.
    """
    columns = np.stack([acceleration, velocity, np.ones_like(velocity)], axis=1)
    moved = float(np.linalg.lstsq(columns, force, rcond=None)[0][0])
    work = force * (velocity - np.mean(velocity))
    share = max(abs(moved), mass or 0.0) * float(np.std(acceleration) / np.std(force))
    if (mass is None and not moved > 0.0) or (share > RULES.inertial and moved < 0.0):
        raise InputError(
            f"the force accelerates a mass of {moved:.4g} kg; check the sign of drive force and encoder, or move faster"
        )
    if float(np.sum(work)) < -RULES.received * float(np.sum(np.abs(work))):
        raise InputError(
            "the axis gives out energy while it moves: drive force and motion point against each other; check the sign "
            "of drive force and encoder"
        )
    if mass is not None and share > RULES.inertial and not mass / RULES.mass_factor < moved < mass * RULES.mass_factor:
        raise InputError(
            f"the force accelerates a mass of {moved:.4g} kg, but the moving mass is given as {mass:g} kg; check the "
            "unit and scale of drive force and encoder, or the mass"
        )


# --- The force balance of a drive record, and what is found from the record itself: moves, band, noise, waves, a limit.

Kind = tuple[float | str, float | str]
ANY: Kind = ("", "")


@dataclass(frozen=True)
class Balance:
    """Both sides of the force balance in a band, over all moves, with what the reference leaves.

    `runs` are moves that follow each other without a gap, each with the moves (first sample, end) that it has.
    """

    filter: Resampler
    motion: Motion
    acting: Real
    runs: Sequence[Sequence[tuple[int, int]]]
    force: Real
    left: Real
    regressors: Real

    @property
    def interval(self) -> float:
        """Time between two values that are kept [s]."""
        return self.filter.step * self.filter.every

    @property
    def spans(self) -> list[tuple[int, int]]:
        """First sample and end of each move."""
        return [span for run in self.runs for span in run]

    @property
    def sizes(self) -> list[int]:
        """How many values each run has."""
        return [(run[-1][1] - run[0][0] - 1) // self.filter.every + 1 for run in self.runs]

    @property
    def moves(self) -> list[Real]:
        """What the reference leaves in each move."""
        return self.each(self.left)

    def used(self, order: int) -> list[NDArray[np.bool_]]:
        """Return for each move which whitened values count: the axis moves in half of what the low-pass sees."""
        share = self.moved(np.ones(self.motion.time.size))
        return [(x >= RULES.least_moving)[order:] for x in self.each(share)]

    def each(self, values: Real) -> list[Real]:
        """Split values of all runs into those of the moves."""
        found = []
        for run, part in zip(self.runs, np.split(values, np.cumsum(self.sizes)[:-1]), strict=True):
            found += np.split(part, [(a - run[0][0]) // self.filter.every for a, _ in run[1:]])
        return found

    @property
    def kinds(self) -> list[Kind]:
        """Kind of each move."""
        return [kind_of(settings_of(self.motion, begin, end)) for begin, end in self.spans]

    def seen(self, samples: Real) -> Real:
        """Pass a signal of the motion, full rate, through the filter."""
        return _seen(self.filter, self.runs, samples)

    def moved(self, samples: Real) -> Real:
        """Pass a signal of the motion through the filter, zero where the axis stands."""
        return _seen(self.filter, self.runs, np.where(self.motion.standing, 0.0, samples))


def _seen(filter_: Resampler, runs: Sequence[Sequence[tuple[int, int]]], samples: Real, advance: float = 0.0) -> Real:
    """Return a signal behind the filter, run after run."""
    margin = filter_.margin
    return np.concatenate([filter_(samples[run[0][0] - margin : run[-1][1] + margin], advance) for run in runs])


def late(samples: Real, step: float, delay: float) -> Real:
    """Return a record as it arrives after a delay [s], between its samples linearly; before it the first value."""
    time = step * np.arange(samples.size, dtype=np.float64)
    return np.asarray(np.interp(time - delay, time, samples))


@dataclass(frozen=True)
class Band:
    """What all balances of a record in one band have in common; `columns` (n, k) are those of the reference."""

    filter: Resampler
    motion: Motion
    acting: Real
    runs: Sequence[Sequence[tuple[int, int]]]
    force: Real
    columns: Real

    def seen(self, samples: Real) -> Real:
        """Pass a signal of the motion through the filter, zero where the axis stands."""
        return _seen(self.filter, self.runs, np.where(self.motion.standing, 0.0, samples))


def _band_of(raw: Channels, cutoff: float, delay: float) -> Band:
    """Return what is common to all balances of a record in a band [Hz]; made once."""
    found = raw.kept.get((cutoff, delay))
    if found is not None:
        return found
    every = int(0.5 / (cutoff * raw.step) * (1.0 + 1e-9))
    if every < 2:
        raise InputError(
            f"a band of {cutoff:g} Hz of a record at {1.0 / raw.step:g} Hz; the encoder is differentiated up to twice "
            "the band, so that the rate must be at least four times the band: lower the cutoff"
        )
    filter_ = Resampler(raw.step, cutoff, every, math.ceil(2.0 * RULES.longest_delay / raw.step))
    moving = motion(raw.position, raw.step, cutoff)
    spans = spans_of(moving, filter_)
    runs = [list(run) for run in _without_gaps(spans)]
    first, last = spans[0][0] - filter_.margin, spans[-1][1] + filter_.margin
    acting = late(raw.force, raw.step, delay)
    force = _seen(filter_, runs, raw.force, -delay) - _seen(filter_, runs, np.where(moving.standing, acting, 0.0))
    columns = noise.reference(moving[first:last]) * ~moving.standing[first:last, None]
    before = np.zeros(first)  # the reference takes its measures from what is used of the record
    seen = np.stack([_seen(filter_, runs, np.concatenate([before, c])) for c in columns.T], axis=1)
    raw.kept[cutoff, delay] = Band(filter_, moving, acting, runs, force, seen)
    return raw.kept[cutoff, delay]


def balance_of(
    raw: Channels,
    cutoff: float,
    limit: float | None,
    lead: float | None = None,
    line: float | None = None,
    delay: float = 0.0,
) -> Balance:
    """Return the balance of a record in a band [Hz].

    `limit` is the drive force [N] beyond which the reference may lose some; `lead` [m] and `line` [Hz] are wavelength
    and frequency of waves that the reference has; `delay` [s] is that from the logged to the acting force. Where the
    axis stands both sides are zero: there the drive holds whatever friction there is.
    """
    band = _band_of(raw, cutoff, delay)
    more = [] if limit is None else [band.seen(excess(band.acting, limit))]
    for phase, period in ((band.motion.position, lead), (band.motion.time, line and 1.0 / line)):
        if period:
            more += [band.seen(wave(2.0 * math.pi * phase / period)) for wave in (np.cos, np.sin)]
    regressors = np.column_stack([band.columns, *more])
    _refuse_too_few(regressors, band.filter)
    left = noise.residual(regressors, band.force)
    return Balance(band.filter, band.motion, band.acting, band.runs, band.force, left, regressors)


def _refuse_too_few(regressors: Real, filter_: Resampler) -> None:
    """Refuse a record whose noise cannot be learned: the reference would explain a good part of it."""
    values, columns = regressors.shape
    needed = RULES.values_each * columns
    if values < needed:
        seconds = values * filter_.step * filter_.every
        raise InputError(
            f"{seconds:.3g} s of motion in a band of {filter_.cutoff:.3g} Hz are {values} values, too few to "
            f"separate noise from friction; {needed} are needed: record {needed / values:.1f} "
            "times as many moves, or moves that accelerate faster, which widens the band"
        )


def _without_gaps(spans: Sequence[tuple[int, int]]) -> Iterator[Sequence[tuple[int, int]]]:
    """Group moves of which each begins where the one before ends."""
    breaks = [k for k in range(1, len(spans)) if spans[k][0] != spans[k - 1][1]]
    for a, b in pairwise([0, *breaks, len(spans)]):
        yield spans[a:b]


def spans_of(moving: Motion, filter_: Resampler) -> list[tuple[int, int]]:
    """Return moves (first sample, end) with all their margins inside the record."""
    step = filter_.step
    lost = math.ceil(3.0 * half_width(2.0 * filter_.cutoff) / step) + filter_.margin + RULES.order * filter_.every
    last = moving.time.size - lost
    if last - lost < filter_.every:
        raise InputError(
            f"the record lasts {moving.time.size * step:g} s; the filters alone need {2.0 * lost * step:.2g} s"
        )
    found = list(moves(moving.velocity, step, lost, last))
    if len(found) < RULES.fewest_moves:
        raise InputError(
            f"{len(found)} moves of 0.2 s or longer in the record; at least {RULES.fewest_moves} are needed, so that "
            "one can be held out: record more moves, with other speeds and both directions"
        )
    return found


def settings_of(moving: Motion, begin: int, end: int) -> Mapping[str, float | str]:
    """Return direction, speed [m/s] to one digit, and quarter of the record of a move (first sample, end)."""
    velocity = moving.velocity[begin:end]
    return {
        "direction": "forward" if float(np.mean(velocity)) > 0.0 else "backward",
        "speed": float(f"{np.median(np.abs(velocity)):.1g}"),
        "quarter": float(4 * (begin + end) // (2 * moving.time.size)),
    }


def lost_beyond(raw: Channels, balance: Balance) -> float | None:
    """Return the limit beyond which drive force that is lost explains most; None where noise explains as much.

    The acceleration is what is explained, by the force up to a limit and what the reference has besides: the noise is
    in the force, and a force that is cut off lower would always leave less of it. Limits from 95 % of the largest force
    to its median while the axis moves are tried, which is paid for. Where less than half is lost nothing is cut off:
    some other force bends with the load.
    """
    acceleration, others = balance.regressors[:, 0], np.delete(balance.regressors, [0, 2], axis=1)  # without snap
    size = np.abs(balance.acting)
    limits = np.geomspace(
        0.95 * size.max(), max(float(np.median(size[~balance.motion.standing])), 0.01 * size.max()), 80
    )
    below = np.stack([balance.moved(np.clip(balance.acting, -x, x)) for x in limits], axis=1)
    force = balance.moved(balance.acting)
    columns = np.column_stack([acceleration, force, below])
    scale = np.sqrt(np.mean(np.square(others), axis=0))
    scale[scale == 0.0] = 1.0
    columns -= (others / scale) @ np.linalg.lstsq(others / scale, columns, rcond=1e-10)[0]
    a, f = columns[:, 0], columns[:, 1]
    whitener = noise.fit_whitener([a - f * float(a @ f) / max(float(f @ f), 1e-300)])
    used = noise.unbroken(balance.sizes, whitener.order)
    a, f, *each = (whitener(x) * used for x in columns.T)
    whole = float(a @ a) - float(a @ f) ** 2 / float(f @ f)
    gain = np.zeros(limits.size)
    for k, c in enumerate(each):
        both = np.stack([c, f - c], axis=1)
        (inner, outer), *_ = np.linalg.lstsq(both, a, rcond=1e-10)
        left = float(a @ a) - float(a @ c) ** 2 / max(float(c @ c), 1e-300)
        if inner > 0.0 and outer < (1.0 - RULES.cut_off) * inner and left < whole:
            gain[k] = float(np.sum(used)) * math.log(whole / max(left, 1e-300))
    best = int(np.argmax(gain))
    return float(limits[best]) if gain[best] > 2.0 * math.log(limits.size / INFERENCE.false_alarm) else None


def periodic(
    raw: Channels, plain: Balance, limit: float | None, lead: float | None, delay: float = 0.0
) -> tuple[float | None, float | None]:
    """Return the wavelength of a ripple [m] and the frequency of a tone [Hz] in what the reference leaves, if any.

    The ripple first: a screw that turns at few speeds makes lines in time as well.
    """
    cutoff = plain.filter.cutoff
    if lead is None:
        lead = wavelength(raw, plain, limit, delay)
        if lead is not None:
            plain = balance_of(raw, cutoff, limit, lead, None, delay)
    time = plain.seen(plain.motion.time)
    return lead, _wave(time, plain, RULES.lowest_tone, cutoff, lambda w: balance_of(raw, cutoff, limit, lead, w, delay))


def wavelength(raw: Channels, plain: Balance, limit: float | None, delay: float = 0.0) -> float | None:
    """Return the wavelength of a ripple [m] in what the reference leaves, if there is one."""
    cutoff, place = plain.filter.cutoff, plain.seen(plain.motion.position)
    slowest = min(float(np.median(np.abs(plain.motion.velocity[a:b]))) for a, b in plain.spans)
    lowest = 5.0 / float(np.ptp(place))
    wave = _wave(place, plain, lowest, cutoff / slowest, lambda w: balance_of(raw, cutoff, limit, 1.0 / w, None, delay))
    return None if wave is None else 1.0 / wave


def _wave(
    phase: Real, plain: Balance, lowest: float, highest: float, with_wave: Callable[[float], Balance]
) -> float | None:
    """Return the wave that stands out of what the reference leaves, if one does.

    A strong one is learned as noise by the whitener: it is looked for with one that has no memory as well, and judged
    by one that was learned with the wave in the reference.
    """

    def passed(cycles: Real) -> Real:
        return plain.filter.gain(cycles / plain.interval)

    def strongest(whitener: Whitener) -> tuple[float, float] | None:
        return noise.strongest_wave(phase, plain.left, whitener, lowest, highest, plain.sizes, passed)

    found, hidden = strongest(whitener_of(plain)), strongest(noise.without_memory(plain.moves))
    for wave in (hidden, found):
        if wave is not None:
            again = strongest(whitener_of(with_wave(wave[0])))
            if again is not None and again[1] < RULES.certain:
                return again[0]
    return None if found is None or found[1] >= INFERENCE.false_alarm else found[0]


def usable_band(balance: Balance, above: float = RULES.above_noise) -> float:
    """Return the frequency [Hz] up to which the force stands `above` what the reference leaves, in power."""
    return noise.usable_band(balance.force, balance.left, balance.interval, balance.filter.cutoff, balance.sizes, above)


def whitener_of(balance: Balance) -> Whitener:
    """Return the whitener of what the reference leaves of the moves."""
    return noise.fit_whitener(balance.moves, balance.regressors)


def noise_of(balance: Balance, whitener: Whitener) -> dict[Kind, float]:
    """Return the noise of each kind of move: a screw, a belt, a bearing has more noise one way, or fast.

    Kinds of which the reference leaves little to judge by are taken to have the noise of all.
    """
    squares, counts = dict[Kind, float](), dict[Kind, float]()
    left = noise.degrees_of_freedom_left(whitener, balance.moves, balance.regressors)
    for own, move, values, used in zip(balance.kinds, balance.moves, left, balance.used(whitener.order), strict=True):
        for kind in (own, ANY):
            squares[kind] = squares.get(kind, 0.0) + float(np.sum(np.square(whitener(move)[used])))
            counts[kind] = counts.get(kind, 0.0) + values * float(np.sum(used)) / max(used.size, 1)
    typical = squares[ANY] / counts[ANY]
    return {k: math.sqrt((squares[k] + RULES.like_all * typical) / (counts[k] + RULES.like_all)) for k in squares}


def kind_of(settings: Mapping[str, float | str]) -> Kind:
    """Return the kind of a move: direction and speed."""
    return settings["direction"], settings["speed"]
