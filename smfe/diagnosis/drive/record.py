"""Diagnosis of a drive record: encoder position and drive force of one moving axis.

The baseline is rigid and viscous, in the force domain: ``F = M x'' + sigma x' + offset``; with a loop delay tau the
force commanded at t acts at ``t + tau``. Mass, gain of the force channel and delay are known as well as a workshop
knows them, and are fitted with that as prior. Both sides pass the same zero-phase low-pass and are kept at twice its
cutoff; the encoder is differentiated with a filter of twice that cutoff (`filters`). The likelihood is that of
residuals whitened with an autoregression (`noise`), so that neighbouring values do not count twice.

A condition is a move from rest to rest. Where the reference and the gains are known, the control law is a second,
independent balance for each move (`drive_control_law`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import signal

from process.errors import InputError
from process.types import Real
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.drive import noise, terms
from smfe.diagnosis.drive.balance import (
    ANY,
    Balance,
    Channels,
    Kind,
    balance_of,
    check_balance,
    kind_of,
    late,
    lost_beyond,
    noise_of,
    periodic,
    settings_of,
    spans_of,
    usable_band,
    wavelength,
    whitener_of,
)
from smfe.diagnosis.drive.control_law import (
    ControlLaw,
    Gains,
    Pulse,
    fit_gains,
    fit_laws,
    unlogged_command,
    without_line,
)
from smfe.diagnosis.drive.filters import Motion, Resampler, motion
from smfe.diagnosis.drive.noise import NoiseDraw, Whitener, noise_draws
from smfe.diagnosis.drive.rules import RULES
from smfe.diagnosis.drive.terms import HIDDEN_COMMAND, Term, excess, saturation
from smfe.diagnosis.inference.problem import Abilities, Cause, Condition, Parameter, Values


@dataclass(frozen=True)
class ForceData:
    """A move: motion and drive force with all margins, the force low-passed with the values before it, its noise."""

    motion: Motion = field(repr=False)
    force: Real = field(repr=False)
    noise: float
    drive: Real = field(repr=False)
    used: NDArray[np.bool_] = field(repr=False)
    """Whitened values that count: the axis moves in at least half of what the low-pass sees."""
    track: Track | None = field(default=None, repr=False)
    """What the move is part of, from its value number `first` on; None: it stands alone."""
    first: int = 0
    acting: Real | None = field(default=None, repr=False)
    """The force up to the limit of the drive, low-passed like it, where there seems to be one: what is beyond counts
    for nothing."""


@dataclass(frozen=True)
class Track:
    """All that is used of a record, with all margins: one prediction serves all of its moves."""

    motion: Motion = field(repr=False)
    drive: Real = field(repr=False)
    kept: dict[tuple[object, ...], Real] = field(default_factory=dict, repr=False, compare=False)


@dataclass(frozen=True)
class _LawData:
    """What the control law leaves over some windows: sign of the pulse in each, or zero, and its noise [N].

    `whole` is the rms of the drive force [N].
    """

    signs: Real = field(repr=False)
    noise: float
    whole: float


@dataclass(frozen=True)
class _GainData:
    """Gains that a control law shows over the documented ones, less one, velocity and position, each over its `sd`."""

    sd: Real = field(repr=False)


@dataclass(frozen=True)
class _LineData:
    """Cosine and sine of a tone beyond the band in what the reference leaves of a move about a time [s]: noise [N].

    `whole` is the rms of the drive force [N].
    """

    time: float
    noise: float
    whole: float


@dataclass(frozen=True)
class DriveModel:
    """What two records of one axis share, so that one can judge what the other has found."""

    resampler: Resampler  # low-pass of both sides
    whitener: Whitener  # of the residual force
    noise: Mapping[Kind, float]
    """Kind of move (direction, speed) -> its noise in units of the whitener's; `ANY`: of all moves together."""
    nuisances: tuple[Parameter, ...]  # of the baseline
    terms: tuple[Term, ...]  # forces that may be missing
    peak: float  # largest drive force [N]
    limit: float | None = None  # drive force beyond which the axis seems to get less than was asked for [N]
    law: ControlLaw | None = None  # control law with its velocity filter
    shown: ControlLaw | None = None  # the same behind a band-pass, which shows its gains
    line: float | None = None  # frequency of a tone in the drive force [Hz]
    beyond: float | None = None  # band in which that is seen where the comparison does not reach it [Hz]
    draws: tuple[NoiseDraw, ...] = ()  # noises that the record could as well have come from

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters that a force depends on."""
        more = [saturation(self.peak, self.limit)] if self.limit is not None else []
        causes = [*(t.cause for t in self.terms), *more]
        return tuple(p.name for p in (*self.nuisances, *(p for c in causes for p in c.parameters)))


@dataclass(frozen=True)
class DriveRecordFamily(Abilities):
    """Baseline, causes and conditions of one drive record; made by `from_record`."""

    model: DriveModel  # what the record is judged with
    conditions: tuple[Condition, ...]  # moves
    pulses: tuple[Pulse, ...] = ()  # commands that the control law does not know, from the first sample of the record
    proposals: tuple[Condition, ...] = ()  # experiments that could be done
    known: frozenset[str] = frozenset()  # keys of causes that the baseline has (`settled`)

    @classmethod
    def from_record(
        cls,
        record: xr.Dataset,
        axis: str = "x",
        *,
        mass: tuple[float, float] | None = None,
        gains: Gains | None = None,
        delay: float = 0.0,
        lead: float | None = None,
        cutoff: float | None = None,
        tolerances: Tolerances | None = None,
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
        lead : float, optional
            Known wavelength of the ripple of screw, rack or magnets [m]. Default: the one that stands out, if one does
            beyond what noise alone has at some wavelength; a ripple is in the catalogue in these cases only.
        cutoff : float, optional
            Band of the comparison [Hz]. Default: as far as the force stands 23 dB above what no model explains, at
            most a tenth of the sample rate.
        tolerances : Tolerances, optional
            How well gain of the force channel and delay are known; default: as in a workshop.
        like : DriveRecordFamily, optional
            Take filter, noise, starts and catalogue from another record of the same axis (a held-out record).
        name : str, optional
            Put before the names of the conditions.
        """
        if not 0.0 <= delay <= RULES.longest_delay:
            raise InputError(f"known delay {delay:g} s; give one from 0 to {RULES.longest_delay:g} s")
        if lead is not None and not 0.0 < lead < math.inf:
            raise InputError(f"lead {lead:g} m; give a positive one, or none")
        raw = Channels.read(record, axis)
        if like is None:
            shared = _learn(raw, mass, gains, delay, lead, cutoff, tolerances or Tolerances())
        elif abs(raw.step / like.model.resampler.step - 1.0) > RULES.same_step:
            raise InputError(
                f"sample interval {raw.step:.9g} s, {like.model.resampler.step:.9g} s of the other record; "
                "records of one axis are compared at one sample interval"
            )
        else:
            shared = like.model
        known = (b.motion for (f, _), b in raw.kept.items() if f == shared.resampler.cutoff)
        moving = next(known, None) or motion(raw.position, raw.step, shared.resampler.cutoff)
        conditions = list(_force_conditions(raw, moving, shared, name))
        conditions += _line_conditions(raw, shared, name)
        pulses: tuple[Pulse, ...] = ()
        if shared.law is not None and raw.reference is not None:
            more, pulses = _law_conditions(raw, moving, shared, shared.law, name)
            conditions += more
        return cls(shared, tuple(conditions), pulses)

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """Mass, viscous friction, offset, gain of the force channel, delay and gains of the control."""
        return self.model.nuisances

    @property
    def common(self) -> tuple[str, ...]:
        """Every axis slides."""
        return ("guideway_friction",)

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Everything that a rigid, viscous axis with a perfect loop leaves out."""
        found = [t.cause for t in self.model.terms]
        if self.model.limit is not None:
            found.append(saturation(self.model.peak, self.model.limit))
        if any(np.any(c.data.signs) for c in self.conditions if isinstance(c.data, _LawData)):
            found.append(HIDDEN_COMMAND)
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
        if isinstance(condition.data, ForceData):
            white = self.model.whitener(self._low_passed(condition.data, values)) / condition.data.noise
            return np.asarray(white[condition.data.used])
        if isinstance(condition.data, _LawData):
            return values.get("hidden.command", 0.0) * condition.data.signs / condition.data.noise
        if isinstance(condition.data, _LineData):
            return self._tone(condition.data, values)
        if isinstance(condition.data, _GainData):
            # The command is known no better than the channel that shows it: its gain is that of the velocity, too.
            velocity = (1.0 + values["servo_gains.velocity"]) * (1.0 + values.get("force_gain.error", 0.0)) - 1.0
            return np.array([velocity, values["servo_gains.position"]]) / condition.data.sd
        raise InputError(f"condition {condition.name} is not one of this family")

    def _tone(self, data: _LineData, values: Values) -> Real:
        """Return cosine and sine of the tone beyond the band, over their noise; at another frequency they turn."""
        assert self.model.line is not None
        a, b = (values.get(f"tone.{n}", 0.0) / data.noise for n in ("cosine", "sine"))
        turn = 2.0 * math.pi * (values.get("tone.frequency", self.model.line) - self.model.line) * data.time
        c, s = math.cos(turn), math.sin(turn)
        return np.array([a * c + b * s, b * c - a * s]) * (1.0 + values.get("force_gain.error", 0.0))

    def noises(self, columns: Sequence[tuple[Condition, Real]]) -> list[Real]:
        """Return products of the columns of all conditions, (m, m): one covariance for each noise that may be true."""
        moving = [(c, x) for c, x in columns if isinstance(c.data, ForceData)]
        others = [x for c, x in columns if not isinstance(c.data, ForceData)]
        rest = sum((x.T @ x for x in others), np.zeros((columns[0][1].shape[1],) * 2))
        found: list[Real] = []
        for draw in self.model.draws if moving else ():
            joined = np.concatenate([_spread(c, x) * draw.size.get(kind_of(c.settings), 1.0) for c, x in moving])
            through = draw.coloured_products(joined)
            found.append(rest + through.T @ through)
        return found

    @property
    def noise_degrees_of_freedom(self) -> float:
        """Degrees of freedom with which the slowest noise is known: 2 over the variance of the log of its power."""
        powers = [math.log(abs(float(np.sum(d.above) / np.sum(d.below)))) * 2.0 for d in self.model.draws]
        return 2.0 / float(np.var(powers)) if len(powers) > 1 else math.inf

    def squared_size(self, condition: Condition, misfit: Real) -> float:
        """Return the squares of the force that a whitened misfit is, over those of the drive force of its move [1]."""
        if isinstance(condition.data, _GainData):
            return float(np.mean(np.square(misfit * condition.data.sd)))
        if isinstance(condition.data, _LawData):
            # A command that comes and goes counts by its height, in however few moves it does.
            height = float(np.sqrt(np.mean(np.square(misfit)))) * condition.data.noise
            return (height / condition.data.whole) ** 2 / self._share(condition)
        if isinstance(condition.data, _LineData):
            square = 0.5 * float(np.sum(np.square(misfit))) * condition.data.noise**2
            return square / condition.data.whole**2 / self._share(condition)
        if not isinstance(condition.data, ForceData):
            return super().squared_size(condition, misfit)
        force, whole = self._squares(condition.data, misfit)
        return force / whole if whole > 0.0 else math.inf

    def squared_change(self, condition: Condition, before: Values, after: Values, misfit: Real) -> float:
        """Return the same of what lies between two forces, with what the low-pass takes away of it.

        A ripple at full speed, friction that changes within a reversal, or a delay while the axis gathers speed acts
        though it is beyond the band.
        """
        data = condition.data
        if not isinstance(data, ForceData):
            return self.squared_size(condition, misfit)
        m = data.motion
        change = np.where(
            m.standing, 0.0, self._missing(m, after) - self._missing(m, before) + self._early(m, before, after)
        )
        margin = self.model.resampler.margin
        inner = slice(margin, m.time.size - margin)
        # What the low-pass passes and what it takes away are orthogonal; where the axis stands neither is anything.
        passed = self.model.resampler(change)
        beyond = passed.size * float(np.mean(np.square(change[inner])) - np.mean(np.square(passed)))
        inside, whole = self._squares(data, misfit)
        return (inside + max(beyond, 0.0)) / whole if whole > 0.0 else math.inf

    def _squares(self, data: ForceData, misfit: Real) -> tuple[float, float]:
        """Return the squares of the force that a whitened misfit is [N2], and those of the drive force of its move."""
        whitener = self.model.whitener
        white = np.zeros(data.used.size)
        white[data.used] = misfit * data.noise
        force = signal.lfilter([whitener.sigma], [1.0, *whitener.coefficients], white)
        acting = data.force if data.acting is None else data.acting
        whole = float(np.sum(np.square(acting[whitener.order :][data.used])))
        return float(np.sum(np.square(force[data.used]))), whole

    def _missing(self, m: Motion, values: Values) -> Real:
        """Return the forces of the causes [N], but for that of a mode: beyond the band it is noise of the encoder."""
        total = np.zeros_like(m.time)
        for term in self.model.terms:
            acts = any(values.get(p.name, p.start) != p.start for p in term.cause.parameters)
            if acts and term.cause.id != "missing_mode":
                total = total + term.force(m, values)
        return total

    def _early(self, m: Motion, before: Values, after: Values) -> Real:
        """Return what a change of the delay alone makes of the force that acts [N], where the axis moves then, too."""
        early = before["loop_delay.delay"] - after["loop_delay.delay"]
        if early == 0.0:
            return np.zeros_like(m.time)
        force = after["mass"] * m.acceleration + after["viscous"] * m.velocity + self._missing(m, after)
        moving = late((~m.standing).astype(float), m.step, early) == 1.0
        return np.where(moving, late(force, m.step, early) - force, 0.0)

    def _share(self, condition: Condition) -> float:
        """Return the share that the data of a condition and of all like it have in the squares of all data [1]."""
        squares = {c.name: float(c.observed @ c.observed) for c in self.conditions if c.observed is not None}
        like = [c.name for c in self.conditions if type(c.data) is type(condition.data)]
        return sum(squares.get(n, 0.0) for n in like) / max(sum(squares.values()), 1e-300)

    def force_error(self, values: Values, conditions: Sequence[Condition] | None = None) -> float:
        """Return rms(measured - predicted force)/rms(measured force) [1], in the band, over moves (default: all)."""
        wrong, whole = 0.0, 0.0
        for c in self.conditions if conditions is None else conditions:
            if isinstance(c.data, ForceData):
                order = self.model.whitener.order
                measured = c.data.force[order:]
                wrong += float(np.sum(np.square(measured - self.force(c.data, values)[order:])))
                whole += float(np.sum(np.square(measured)))
        return math.sqrt(wrong / whole)

    def _low_passed(self, data: ForceData, values: Values) -> Real:
        """Return the low-passed drive force of a move [N] as part of its record, of which the last few are kept."""
        if data.track is None:
            return self.force(data, values)
        kept, key = data.track.kept, (id(self.model), *values.items())
        if key not in kept:
            if len(kept) >= RULES.kept_forces:
                kept.clear()
            kept[key] = self.force(data.track, values)
        return kept[key][data.first : data.first + data.force.size]

    def force(self, data: ForceData | Track, values: Values) -> Real:
        """Return the low-passed drive force of a move, or of all that is used of a record [N]."""
        m = data.motion
        total = values["mass"] * m.acceleration + values["viscous"] * m.velocity + values["offset"]
        for term in self.model.terms:
            if any(values[p.name] != p.start for p in term.cause.parameters):
                total = total + term.force(m, values)
        total = total * (1.0 + values.get("force_gain.error", 0.0))
        delay = values["loop_delay.delay"]
        needed = self.model.resampler(np.where(m.standing, 0.0, total), delay)
        if m.standing.any():
            needed = needed + self.model.resampler(np.where(m.standing, late(data.drive, m.step, delay), 0.0), delay)
        cut = values.get("saturation.cut", 0.0)
        if self.model.limit is None or cut == 0.0:
            return needed
        lost = late(excess(data.drive, self.model.peak - cut), m.step, delay)
        return needed + self.model.resampler(np.where(m.standing, 0.0, lost), delay)


def _learn(
    raw: Channels,
    mass: tuple[float, float] | None,
    gains: Gains | None,
    delay: float,
    lead: float | None,
    cutoff: float | None,
    tolerances: Tolerances,
) -> DriveModel:
    """Find what the record itself has to say: band, noise, starts of the nuisances, wavelength of a ripple."""
    known, above = lead is not None, RULES.above_noise
    far: tuple[float, float] | None = None
    if cutoff is None:
        cutoff, above, lead, far = _usable_band(raw, lead, delay, tolerances.material)
    limit = lost_beyond(raw, balance_of(raw, cutoff, None, delay=delay))
    lead, line = periodic(raw, balance_of(raw, cutoff, limit, lead, delay=delay), limit, lead, delay)
    full = balance_of(raw, cutoff, limit, lead, line, delay)
    whitener = whitener_of(full)
    beyond = None
    if line is None and far is not None:
        line, beyond = far
    law = shown = None
    if gains is not None and raw.reference is not None:
        given = without_line(raw.reference, raw.position, raw.force, raw.step, line)
        law, shown = fit_laws(raw.reference, raw.position, given, raw.step, gains)
    nuisances = (*_nuisances(full, mass, tolerances, limit), _timing(cutoff, above, delay, tolerances))
    if shown is not None and shown.tells(float(np.std(raw.force))):
        within, said = tolerances.control_gain, "gain of the control over the one that was given"
        nuisances += tuple(
            Parameter(f"servo_gains.{n}", "%", 0.0, 0.01, -0.9, 9.0, within, 100.0, "servo_gains", said=f"{n} {said}")
            for n in ("position", "velocity")
        )
    place = full.seen(full.motion.position)
    centre, stroke = float(np.mean(place)), float(np.ptp(place))
    fastest = float(np.max(np.abs(full.seen(full.motion.velocity))))
    catalogue = [*terms.always(centre, stroke, nuisances[0].start, fastest)]
    if above < RULES.above_noise:  # the noise would pass for flexibility
        catalogue = [t for t in catalogue if t.cause.id != "missing_mode"]
    if lead is not None:
        catalogue.append(terms.ripple(lead, centre, known))
    if line is not None:
        catalogue.append(terms.tone(line, raw.step * raw.force.size))
    boxes = noise.boxes(full.left, whitener, full.seen(full.motion.time), full.sizes)
    if boxes:
        catalogue.append(terms.hidden_force(boxes))
    return DriveModel(
        resampler=full.filter,
        whitener=whitener,
        noise=noise_of(full, whitener),
        nuisances=nuisances,
        terms=tuple(catalogue),
        peak=float(np.max(np.abs(raw.force))),
        limit=limit,
        law=law,
        shown=shown,
        line=line,
        beyond=beyond,
        draws=noise_draws(whitener, full.moves, full.regressors, full.kinds),
    )


def _usable_band(
    raw: Channels, lead: float | None, delay: float, material: float
) -> tuple[float, float, float | None, tuple[float, float] | None]:
    """Return the band of the comparison [Hz], how far the force stands above the noise at its end, and a lead [m].

    A ripple and a tone that matter end the band no more than anything else that is explained. To reach a tone it may
    end where the force stands 13 dB above the noise. The lead is looked for in the widest band: a screw that turns fast
    makes a ripple of which that of the comparison has nothing but while the axis gathers speed.
    """
    widest = RULES.widest / raw.step
    limit = lost_beyond(raw, balance_of(raw, widest, None, delay=delay))
    plain = balance_of(raw, widest, limit, delay=delay)
    cutoff = usable_band(plain)
    middle = min(max(RULES.beyond * cutoff, RULES.below_mains), widest)
    lead = lead or wavelength(raw, plain, limit, delay)
    waves = periodic(raw, balance_of(raw, middle, limit, lead, delay=delay), limit, lead, delay)
    full = balance_of(raw, widest, limit, *waves, delay)
    explained = float(np.mean(np.square(plain.left)) - np.mean(np.square(full.left)))
    if explained < (RULES.worth_a_band * material) ** 2 * float(np.mean(np.square(plain.force))):
        return cutoff, RULES.above_noise, waves[0], None
    cutoff = max(cutoff, usable_band(full))
    reach = RULES.above_line * (waves[1] or 0.0)
    if cutoff < reach <= usable_band(balance_of(raw, middle, limit, *waves, delay), RULES.above_line_noise):
        return reach, RULES.above_line_noise, waves[0], None
    far = None if waves[1] is None or reach <= cutoff else (waves[1], middle)
    return cutoff, RULES.above_noise, waves[0], far


def _nuisances(
    balance: Balance, mass: tuple[float, float] | None, tolerances: Tolerances, limit: float | None
) -> tuple[Parameter, ...]:
    """Start the baseline at its least squares, of the force up to the limit of the drive: what is beyond never acts."""
    m, force = balance.motion, balance.force
    if limit is not None:
        force = force - balance.moved(excess(balance.acting, limit))
    columns = [balance.moved(x) for x in (m.acceleration, m.velocity, np.ones_like(m.velocity))]
    check_balance(force, columns[0], columns[1], None if mass is None else mass[0])
    found = np.linalg.lstsq(np.stack(columns, axis=1), force, rcond=None)[0]
    heavy, prior = (float(found[0]), math.inf) if mass is None else mass
    viscous = max(float(found[1]), 0.0)
    free = (
        Parameter("viscous", "N s/m", viscous, max(0.01 * viscous, 1e-3 * heavy), low=0.0),
        Parameter("offset", "N", float(found[2]), 0.01 * float(np.sqrt(np.mean(np.square(force))))),
    )
    known = Parameter("mass", "kg", heavy, 0.01 * heavy, low=0.0, prior=prior)
    if mass is not None:
        known = replace(known, given="declared_mass", said="moving mass", stated=False)
    # Without a mass the record says nothing of the gain: all forces and the mass are known no better than it is.
    gain = Parameter("force_gain.error", "%", 0.0, 0.01, -0.5, 1.0, prior=tolerances.sensor_gain, shown=100.0)
    return known, *free, replace(gain, given="sensor_gain", said="gain of the force channel", stated=False)


def _timing(cutoff: float, above: float, delay: float, tolerances: Tolerances) -> Parameter:
    """Return the delay from the logged to the acting force, known as a workshop knows it, and 4 us in a band of 33 Hz.

    The latter no record contains: the controller answers the disturbances that the balance takes for noise (bias of
    the direct method in closed loop, a share of the power of noise over that of the force; Forssell and Ljung,
    Automatica 35, 1999). At the end of the band that share is one in `above`, by which angle noise may turn
    the force. A sixth of it, one sigma, is taken for the loop, as linearisation at the truth showed for Coulomb
    friction at 1 kHz; at other rates and bands it is an extrapolation.
    """
    off = math.hypot(RULES.closed_loop / (above * 2.0 * math.pi * cutoff), tolerances.dead_time)
    said = "delay from the logged to the acting force"
    name, most = "loop_delay.delay", RULES.longest_delay
    return Parameter(name, "ms", delay, 1e-4, 0.0, most, prior=off, shown=1e3, given="loop_delay", said=said)


def _named(moving: Motion, shared: DriveModel, name: str) -> list[tuple[str, Mapping[str, float | str], str, int, int]]:
    """Return name, settings, source, first sample and end of each move."""
    found = []
    spans = spans_of(moving, shared.resampler)
    for k, (begin, end) in enumerate(spans):
        settings = settings_of(moving, begin, end)
        way, speed = settings["direction"], 1e3 * float(np.median(np.abs(moving.velocity[begin:end])))
        half = "first half" if moving.time[(begin + end) // 2] < 0.0 else "second half"
        text = f"{name + ' ' if name else ''}move {k + 1}, {way}, {speed:.0f} mm/s"
        found.append((text, settings, half, begin, end))
    return found


def _force_conditions(raw: Channels, moving: Motion, shared: DriveModel, name: str) -> Sequence[Condition]:
    filter_, order = shared.resampler, shared.whitener.order
    before, every = filter_.margin + order * filter_.every, filter_.every
    named = _named(moving, shared, name)
    origin = named[0][3] - before
    whole = slice(origin, named[-1][4] + filter_.margin)
    track = Track(moving[whole], raw.force[whole])
    force, moves = filter_(track.drive), filter_(np.where(track.motion.standing, 0.0, 1.0))
    limit = math.inf if shared.limit is None else shared.limit
    acting = filter_(np.clip(track.drive, -limit, limit))
    found = []
    for text, settings, half, begin, end in named:
        first = -(-(begin - before - origin) // every)
        start = origin + first * every
        part = slice(start, end + filter_.margin)
        count = (end - start - filter_.margin - 1) // every + 1
        own = force[first : first + count]
        used = moves[first + order : first + count] >= RULES.least_moving
        if np.count_nonzero(used) > order:
            noise_ = shared.noise.get(kind_of(settings), shared.noise[ANY])
            acts = acting[first : first + count]
            data = ForceData(moving[part], own, noise_, raw.force[part], used, track, first, acts)
            found.append(Condition(text, settings, (shared.whitener(own) / noise_)[used], half, data))
    return found


def _line_conditions(raw: Channels, shared: DriveModel, name: str) -> list[Condition]:
    """Return the amplitudes of a tone that the force does not reach out of the noise, in each move by itself.

    The motion says nothing there, and of a tone in the log alone it need not. The noise is that of the amplitudes at
    frequencies beside it.
    """
    if shared.beyond is None or shared.line is None:
        return []
    delay = next(p.start for p in shared.nuisances if p.name == "loop_delay.delay")
    try:
        band = balance_of(raw, shared.beyond, shared.limit, None, None, delay)
    except InputError:
        return []
    times = band.each(band.seen(band.motion.time))
    duration = float(np.median([t[-1] - t[0] for t in times]))
    beside = [f for k in RULES.beside_line for f in (shared.line - k / duration, shared.line + k / duration)]
    beside = [f for f in beside if RULES.lowest_tone < f < shared.beyond]
    passed = float(band.filter.gain(np.array([shared.line]))[0])
    own = [_amplitude(x, t, shared.line) for x, t in zip(band.moves, times, strict=True)]
    spread = [[_amplitude(x, t, f) * math.sqrt(x.size) for f in beside] for x, t in zip(band.moves, times, strict=True)]
    noise_ = math.sqrt(float(np.mean(np.square(spread))))
    whole, found = float(np.std(raw.force)), list[Condition]()
    for k, ((begin, end), a, t) in enumerate(zip(band.spans, own, times, strict=True)):
        middle, sd = float(np.mean(t)), noise_ / math.sqrt(t.size) / passed
        text = f"{name + ' ' if name else ''}tone of {shared.line:.3g} Hz, move {k + 1}"
        half = "first half" if middle < 0.0 else "second half"
        data = _LineData(middle, sd, whole)
        found.append(Condition(text, settings_of(band.motion, begin, end), a / passed / sd, half, data))
    return found


def _amplitude(values: Real, time: Real, frequency: float) -> Real:
    """Return cosine and sine of a frequency [Hz] in values, by least squares."""
    angle = 2.0 * math.pi * frequency * time
    return np.asarray(np.linalg.lstsq(np.stack([np.cos(angle), np.sin(angle)], axis=1), values, rcond=None)[0])


def _spread(condition: Condition, columns: Real) -> Real:
    """Return columns of a move with zeros where its values do not count, so that neighbours are neighbours in time."""
    assert isinstance(condition.data, ForceData)
    whole = np.zeros((condition.data.used.size, columns.shape[1]))
    whole[condition.data.used] = columns
    return whole


def _law_conditions(
    raw: Channels, moving: Motion, shared: DriveModel, law: ControlLaw, name: str
) -> tuple[list[Condition], tuple[Pulse, ...]]:
    """Hold the record against the control law: its gains where it is exact, and pulses beside as much without any."""
    assert raw.reference is not None
    given = without_line(raw.reference, raw.position, raw.force, raw.step, shared.line)
    left, pulses = unlogged_command(law, raw.reference, raw.position, given, raw.step)
    whole, found = float(np.std(raw.force)), list[Condition]()
    tells = any(p.given == "servo_gains" for p in shared.nuisances)
    own = fit_gains(raw.reference, raw.position, given, raw.step, law.gains, pulses) if tells else None
    if own is not None and own.plausible:
        gains = np.array([own.found.velocity / law.gains.velocity, own.found.position / law.gains.position])
        told = own.uncertainty(whole)
        text, sd_ = f"{name + ' ' if name else ''}control law", np.array([told.velocity, told.position])
        found.append(Condition(text, {}, (gains - 1.0) / sd_, "control law", _GainData(sd_)))
    if not pulses:
        return found, pulses
    length = max(round(float(np.median([p.end - p.begin for p in pulses])) / raw.step), 1)
    taken = np.zeros(left.size, dtype=bool)
    for p in pulses:
        taken[round(p.begin / raw.step) : round(p.end / raw.step)] = True
    count = left.size // length
    blocks, free = (x[: count * length].reshape(count, length) for x in (left, ~taken))
    means = blocks[free.all(axis=1)].mean(axis=1)
    height = float(np.median([abs(p.height) for p in pulses]))
    sd = math.hypot(1.4826 * float(np.median(np.abs(means))) if means.size else law.noise, RULES.even * height)
    for text, settings, half, begin, end in _named(moving, shared, name):
        values, signs = list[float](), list[float]()
        for p in pulses:
            first = round(p.begin / raw.step)
            before = slice(max(first - length, 0), first)
            if begin <= first < end and first > length and not taken[before].any():
                values += [float(np.mean(left[before])), p.height]
                signs += [0.0, math.copysign(1.0, p.height)]
        if values:
            data = _LawData(np.array(signs), sd, whole)
            found.append(Condition(f"control law, {text}", settings, np.array(values) / sd, half, data))
    return found, pulses
