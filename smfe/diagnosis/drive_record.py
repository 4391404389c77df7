"""Diagnosis of a drive record: encoder position and drive force of one moving axis.

The baseline is rigid and viscous, in the force domain: ``F = M x'' + sigma x' + offset``; with a loop delay tau the
force commanded at t acts at ``t + tau``. Both sides pass the same zero-phase low-pass and are kept at twice its cutoff;
the encoder is differentiated with a filter of twice that cutoff (`drive_signals`). The likelihood is that of residuals
whitened with an autoregression (`drive_noise`), so that neighbouring values do not count twice.

A condition is a move from rest to rest. Where the reference and the gains are known, the control law is a second,
independent balance for each move (`drive_control_law`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr

from process.errors import InputError
from smfe.diagnosis import drive_noise as noise
from smfe.diagnosis import drive_terms as terms
from smfe.diagnosis.drive_control_law import ControlLaw, Gains, Pulse, fit_control_law, unlogged_command
from smfe.diagnosis.drive_noise import Whitener
from smfe.diagnosis.drive_signals import Motion, Real, Resampler, half_width, motion, moves
from smfe.diagnosis.drive_terms import Term
from smfe.diagnosis.problem import Cause, Condition, Parameter, Values

_Kind = tuple[float | str, float | str]
_ANY: _Kind = ("", "")

LONGEST_DELAY = 5e-3
"""Largest loop delay that is looked for [s]."""

_FEWEST_MOVES = 4
_WIDEST = 0.1
"""Widest band, in units of the sample rate."""


@dataclass(frozen=True)
class _ForceData:
    """A move: the motion with all margins, the low-passed drive force with the values before it, and its noise."""

    motion: Motion = field(repr=False)
    force: Real = field(repr=False)
    noise: float


@dataclass(frozen=True)
class _LawData:
    """A move of the control law: position and velocity part of the command and the unlogged pulses of height one."""

    position: Real = field(repr=False)
    velocity: Real = field(repr=False)
    pulses: Real = field(repr=False)


@dataclass(frozen=True)
class DriveModel:
    """What two records of one axis share, so that one can judge what the other has found.

    Parameters
    ----------
    resampler : Resampler
        Low-pass of both sides.
    whitener : Whitener
        Of the residual force.
    noise : mapping
        Kind of move (direction, speed) -> its noise in units of the whitener's; `_ANY`: of all moves together.
    nuisances : tuple of Parameter
        Of the baseline.
    terms : tuple of Term
        Forces that may be missing.
    delay : float
        Known delay from the logged to the acting force [s].
    mass_known : bool
        Whether the mass has a prior, without which a gain of the force channel cannot be told from the mass.
    law : ControlLaw, optional
        Control law with its velocity filter.
    """

    resampler: Resampler
    whitener: Whitener
    noise: Mapping[_Kind, float]
    nuisances: tuple[Parameter, ...]
    terms: tuple[Term, ...]
    delay: float
    mass_known: bool
    law: ControlLaw | None = None


@dataclass(frozen=True)
class DriveRecordFamily:
    """Baseline, causes and conditions of one drive record; made by `from_record`.

    Parameters
    ----------
    model : DriveModel
        What the record is judged with.
    conditions : tuple of Condition
        Moves.
    pulses : tuple of Pulse
        Commands that the control law does not know, from the first sample of the record.
    proposals : tuple of Condition, optional
        Experiments that could be done.
    known : frozenset of str, optional
        Keys of causes that the baseline has (`settled`).
    """

    model: DriveModel
    conditions: tuple[Condition, ...]
    pulses: tuple[Pulse, ...] = ()
    proposals: tuple[Condition, ...] = ()
    known: frozenset[str] = frozenset()

    @classmethod
    def from_record(
        cls,
        record: xr.Dataset,
        axis: str = "x",
        *,
        mass: tuple[float, float] | None = None,
        gains: Gains | None = None,
        delay: float = 0.0,
        cutoff: float | None = None,
        like: DriveRecordFamily | None = None,
        name: str = "",
    ) -> DriveRecordFamily:
        """Make the family of a record.

        Parameters
        ----------
        record : xarray.Dataset
            With ``encoder_position`` and ``drive_force``; with `gains` also ``reference_position``.
        axis : str, optional
            Axis of the record.
        mass : tuple of float, optional
            Moved mass and its standard deviation [kg], if it is known apart from this record.
        gains : Gains, optional
            Gains of the controller.
        delay : float, optional
            Known delay from the logged to the acting force [s], such as the half sample for which a command is held.
        cutoff : float, optional
            Band of the comparison [Hz]. Default: as far as the force stands 13 dB above what no model explains, at
            most a tenth of the sample rate.
        like : DriveRecordFamily, optional
            Take filter, noise, starts and catalogue from another record of the same axis (a held-out record).
        name : str, optional
            Put before the names of the conditions.
        """
        if not 0.0 <= delay <= LONGEST_DELAY:
            raise InputError(f"known delay {delay:g} s; give one from 0 to {LONGEST_DELAY:g} s")
        raw = _Raw.read(record, axis)
        if like is None:
            shared = _learn(raw, mass, gains, delay, cutoff)
        elif like.model.resampler.step != raw.step:
            raise InputError(f"sample interval {raw.step:g} s, {like.model.resampler.step:g} s of the other record")
        else:
            shared = like.model
        moving = motion(raw.position, raw.step, 2.0 * shared.resampler.cutoff)
        conditions = list(_force_conditions(raw, moving, shared, name))
        pulses: tuple[Pulse, ...] = ()
        if shared.law is not None and raw.reference is not None:
            more, pulses = _law_conditions(raw, moving, shared, shared.law, name)
            conditions += more
        return cls(shared, tuple(conditions), pulses)

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Mass, viscous friction and offset."""
        return self.model.nuisances

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Everything that a rigid, viscous axis with a perfect loop leaves out."""
        found = [t.cause for t in self.model.terms] + [_DELAY]
        if self.model.mass_known:
            found.append(_SENSOR_GAIN)
        if self.model.law is not None:
            found.append(_SERVO_GAINS)
            if self.pulses:
                found.append(_HIDDEN_COMMAND)
        return tuple(c for c in found if c.key not in self.known)

    def with_terms(self, more: Sequence[Term]) -> DriveRecordFamily:
        """Return the family with more forces in its catalogue."""
        return replace(self, model=replace(self.model, terms=(*self.model.terms, *more)))

    def settled(self, causes: Sequence[str], values: Values, source: str = "") -> DriveRecordFamily:
        """Return the family with some causes in its baseline, started at `values`, and the moves of one source."""
        known = {p.name for c in self.causes if c.key in causes for p in c.parameters}
        missing = sorted(set(causes) - {c.key for c in self.causes})
        if missing:
            raise InputError(f"no cause {missing[0]!r}; this record has {', '.join(c.key for c in self.causes)}")
        more = [p for c in self.causes for p in c.parameters if p.name in known]
        nuisances = tuple(replace(p, start=values[p.name]) for p in (*self.nuisances, *more))
        kept = tuple(c for c in self.conditions if source in ("", c.source))
        return replace(self, model=replace(self.model, nuisances=nuisances), conditions=kept, known=frozenset(causes))

    def predict(self, condition: Condition, values: Values) -> Real:
        """Return the whitened drive force of a move, or its whitened command after the control law."""
        if isinstance(condition.data, _ForceData):
            return self.model.whitener(self._force(condition.data.motion, values)) / condition.data.noise
        if isinstance(condition.data, _LawData) and self.model.law is not None:
            return _law_force(condition.data, values) / self.model.law.noise
        raise InputError(f"condition {condition.name} is not one of this family")

    def force_error(self, values: Values, conditions: Sequence[Condition] | None = None) -> float:
        """Return rms(measured - predicted force)/rms(measured force) [1], in the band, over moves (default: all)."""
        wrong, whole = 0.0, 0.0
        for c in self.conditions if conditions is None else conditions:
            if isinstance(c.data, _ForceData):
                order = self.model.whitener.order
                measured = c.data.force[order:]
                wrong += float(np.sum(np.square(measured - self._force(c.data.motion, values)[order:])))
                whole += float(np.sum(np.square(measured)))
        return math.sqrt(wrong / whole)

    def _force(self, m: Motion, values: Values) -> Real:
        total = values["mass"] * m.acceleration + values["viscous"] * m.velocity + values["offset"]
        for term in self.model.terms:
            if any(values[p.name] != p.start for p in term.cause.parameters):
                total = total + term.force(m, values)
        if self.model.mass_known:
            total = total * (1.0 + values["force_gain.error"])
        return self.model.resampler(total, self.model.delay + values["loop_delay.delay"])


_DELAY = Cause(
    "loop_delay",
    "delay between command and force",
    (Parameter("loop_delay.delay", "ms", 0.0, 1e-4, 0.0, LONGEST_DELAY, shown=1e3),),
)
_SENSOR_GAIN = Cause(
    "sensor_gain",
    "gain of the force channel",
    (Parameter("force_gain.error", "%", 0.0, 0.01, -0.5, 1.0, shown=100.0),),
    kind="measurement",
)
_SERVO_GAINS = Cause(
    "servo_gains",
    "gains of the controller",
    (
        Parameter("servo_gains.position", "%", 0.0, 0.01, -0.9, 9.0, shown=100.0),
        Parameter("servo_gains.velocity", "%", 0.0, 0.01, -0.9, 9.0, shown=100.0),
    ),
)
_HIDDEN_COMMAND = Cause(
    "hidden_input", "command that was not logged", (Parameter("hidden.command", "N", 0.0, 1.0),), "command"
)


@dataclass(frozen=True)
class _Raw:
    """Channels of one axis."""

    step: float
    position: Real
    force: Real
    reference: Real | None

    @classmethod
    def read(cls, record: xr.Dataset, axis: str) -> _Raw:
        channels: dict[str, Real] = {}
        for channel in ("encoder_position", "drive_force", "reference_position"):
            if channel in record and axis in record[channel]["axis"].values:
                values = np.asarray(record[channel].sel(axis=axis).values, dtype=float)
                if np.all(np.isfinite(values)):
                    channels[channel] = values
        for needed in ("encoder_position", "drive_force"):
            if needed not in channels:
                raise InputError(f"the record has no {needed}_{axis}; a drive record needs it, with all its samples")
        time = np.asarray(record["time"].values, dtype=float)
        step = float(np.mean(np.diff(time)))
        if np.max(np.abs(np.diff(time) - step)) > 0.01 * step:
            raise InputError("the samples of the record are not evenly spaced in time; resample them first")
        return cls(step, channels["encoder_position"], channels["drive_force"], channels.get("reference_position"))


@dataclass(frozen=True)
class _Balance:
    """Both sides of the force balance in a band, over all moves, with what the reference leaves."""

    filter: Resampler
    motion: Motion
    spans: Sequence[tuple[int, int]]
    part: slice
    force: Real
    left: Real
    columns: int

    def seen(self, samples: Real) -> Real:
        """Pass a signal of the motion, full rate, through the filter."""
        return self.filter(samples[self.part])


def _balance(raw: _Raw, cutoff: float, lead: float | None) -> _Balance:
    every = int(0.5 / (cutoff * raw.step) * (1.0 + 1e-9))
    if every < 2:
        raise InputError(
            f"a band of {cutoff:g} Hz of a record at {1.0 / raw.step:g} Hz; the encoder is differentiated up to twice "
            "the band, so that the rate must be at least four times the band: lower the cutoff"
        )
    filter_ = Resampler(raw.step, cutoff, every, math.ceil(2.0 * LONGEST_DELAY / raw.step))
    moving = motion(raw.position, raw.step, 2.0 * cutoff)
    spans = _spans(moving, filter_)
    part = slice(spans[0][0] - filter_.margin, spans[-1][1] + filter_.margin)
    columns = list(noise.reference(moving[part]).T)
    if lead is not None:
        angle = 2.0 * math.pi * moving.position[part] / lead
        columns += [np.cos(angle), np.sin(angle)]
    force = filter_(raw.force[part])
    left = noise.residual(np.stack([filter_(c) for c in columns], axis=1), force)
    return _Balance(filter_, moving, spans, part, force, left, len(columns))


def _learn(
    raw: _Raw, mass: tuple[float, float] | None, gains: Gains | None, delay: float, cutoff: float | None
) -> DriveModel:
    """Find what the record itself has to say: band, noise, starts of the nuisances, wavelength of a ripple."""
    if cutoff is None:
        wide = _balance(raw, _WIDEST / raw.step, None)
        step = raw.step * wide.filter.every
        cutoff = noise.usable_band(wide.force, wide.left, step, wide.filter.cutoff)
    plain = _balance(raw, cutoff, None)
    place, velocity = plain.seen(plain.motion.position), plain.seen(plain.motion.velocity)
    slowest = min(float(np.median(np.abs(plain.motion.velocity[a:b]))) for a, b in plain.spans)
    quick = np.abs(velocity) > 0.5 * slowest
    lead = noise.wavelength(place[quick], plain.left[quick], slowest / cutoff)
    full = _balance(raw, cutoff, lead)
    first, every = full.spans[0][0], full.filter.every
    whitener = noise.fit_whitener(np.split(full.left, [(a - first) // every for a, _ in full.spans[1:]]))
    each = _noise(full, whitener)
    pulse = noise.strongest_pulse(whitener(full.left), every * raw.step)
    origin = float(full.motion.time[first]) + whitener.order * every * raw.step
    law = None
    if gains is not None and raw.reference is not None:
        law = fit_control_law(raw.reference, raw.position, raw.force, raw.step, gains)
    nuisances = _nuisances(full, mass)
    centre = float(np.mean(place))
    catalogue = [
        terms.coulomb(),
        terms.stribeck(),
        terms.shear(),
        terms.asymmetry(),
        terms.position_slope(centre),
        terms.ripple(lead, centre),
        terms.drift(),
        terms.missing_mode(nuisances[0].start),
    ]
    if pulse is not None:
        catalogue.append(terms.hidden_force(origin + pulse[0], origin + pulse[1]))
    return DriveModel(full.filter, whitener, each, nuisances, tuple(catalogue), delay, mass is not None, law)


def _noise(balance: _Balance, whitener: Whitener) -> dict[_Kind, float]:
    """Return the noise of each kind of move: a screw, a belt, a bearing is louder one way, or fast."""
    first, every = balance.spans[0][0], balance.filter.every
    squares: dict[_Kind, list[float]] = {}
    for (begin, end), left in zip(
        balance.spans, np.split(balance.left, [(a - first) // every for a, _ in balance.spans[1:]]), strict=True
    ):
        for kind in (_kind(_settings(balance.motion, begin, end)), _ANY):
            squares.setdefault(kind, []).extend(np.square(whitener(left)))
    fitted = balance.columns / balance.left.size
    return {kind: math.sqrt(float(np.mean(values)) / (1.0 - fitted)) for kind, values in squares.items()}


def _kind(settings: Mapping[str, float | str]) -> _Kind:
    return settings["direction"], settings["speed"]


def _nuisances(balance: _Balance, mass: tuple[float, float] | None) -> tuple[Parameter, ...]:
    """Start the baseline at its least squares."""
    m, force = balance.motion, balance.force
    columns = [balance.seen(x) for x in (m.acceleration, m.velocity, np.ones_like(m.velocity))]
    found = np.linalg.lstsq(np.stack(columns, axis=1), force, rcond=None)[0]
    heavy, prior = (float(found[0]), math.inf) if mass is None else mass
    if not heavy > 0.0:
        raise InputError(
            f"the force accelerates a mass of {heavy:g} kg; check the sign of drive force and encoder, or move faster"
        )
    viscous = max(float(found[1]), 0.0)
    return (
        Parameter("mass", "kg", heavy, 0.01 * heavy, low=0.0, prior=prior),
        Parameter("viscous", "N s/m", viscous, max(0.01 * viscous, 1e-3 * heavy), low=0.0),
        Parameter("offset", "N", float(found[2]), 0.01 * float(np.sqrt(np.mean(np.square(force))))),
    )


def _spans(moving: Motion, filter_: Resampler) -> list[tuple[int, int]]:
    """Return moves (first sample, end) with all their margins inside the record."""
    step = filter_.step
    lost = math.ceil(3.0 * half_width(2.0 * filter_.cutoff) / step) + filter_.margin + noise.ORDER * filter_.every
    last = moving.time.size - lost
    if last - lost < filter_.every:
        raise InputError(
            f"the record lasts {moving.time.size * step:g} s; the filters alone need {2.0 * lost * step:.2g} s"
        )
    found = list(moves(moving.velocity, step, lost, last))
    if len(found) < _FEWEST_MOVES:
        raise InputError(
            f"{len(found)} moves of 0.2 s or longer in the record; at least {_FEWEST_MOVES} are needed, so that one "
            "can be held out: record more moves, with other speeds and both directions"
        )
    return found


def _settings(moving: Motion, begin: int, end: int) -> Mapping[str, float | str]:
    velocity = moving.velocity[begin:end]
    return {
        "direction": "forward" if float(np.mean(velocity)) > 0.0 else "backward",
        "speed": float(f"{np.median(np.abs(velocity)):.1g}"),
        "quarter": float(4 * (begin + end) // (2 * moving.time.size)),
    }


def _named(moving: Motion, shared: DriveModel, name: str) -> list[tuple[str, Mapping[str, float | str], str, int, int]]:
    """Return name, settings, source, first sample and end of each move."""
    found = []
    spans = _spans(moving, shared.resampler)
    for k, (begin, end) in enumerate(spans):
        settings = _settings(moving, begin, end)
        way, speed = settings["direction"], 1e3 * float(np.median(np.abs(moving.velocity[begin:end])))
        half = "first half" if moving.time[(begin + end) // 2] < 0.0 else "second half"
        text = f"{name + ' ' if name else ''}move {k + 1}, {way}, {speed:.0f} mm/s"
        found.append((text, settings, half, begin, end))
    return found


def _force_conditions(raw: _Raw, moving: Motion, shared: DriveModel, name: str) -> Sequence[Condition]:
    filter_ = shared.resampler
    before = filter_.margin + shared.whitener.order * filter_.every
    found = []
    for text, settings, half, begin, end in _named(moving, shared, name):
        part = slice(begin - before, end + filter_.margin)
        force = filter_(raw.force[part])
        data = _ForceData(moving[part], force, shared.noise.get(_kind(settings), shared.noise[_ANY]))
        found.append(Condition(text, settings, shared.whitener(force) / data.noise, half, data))
    return found


def _law_conditions(
    raw: _Raw, moving: Motion, shared: DriveModel, law: ControlLaw, name: str
) -> tuple[list[Condition], tuple[Pulse, ...]]:
    assert raw.reference is not None
    position, velocity = law.force(raw.reference, raw.position, raw.step)
    pulses = unlogged_command(law, raw.reference, raw.position, raw.force, raw.step)[1]
    pattern = np.zeros_like(position)
    for p in pulses:
        pattern[round(p.begin / raw.step) : round(p.end / raw.step)] = math.copysign(1.0, p.height)
    found = []
    for text, settings, half, begin, end in _named(moving, shared, name):
        part = slice(begin, end, shared.resampler.every)
        data = _LawData(position[part], velocity[part], pattern[part])
        found.append(Condition(f"control law, {text}", settings, raw.force[part] / law.noise, half, data))
    return found, pulses


def _law_force(data: _LawData, values: Values) -> Real:
    velocity_gain = 1.0 + values["servo_gains.velocity"]
    position_gain = 1.0 + values["servo_gains.position"]
    command = velocity_gain * (position_gain * data.position + data.velocity)
    return np.asarray(command + values.get("hidden.command", 0.0) * data.pulses)
