"""What a feed axis of two masses says of its drive records: the same masses, friction and gains as under a hammer.

Far below the frequency f_t at which the tip vibrates on a held carriage both masses move as one, but for the first term
of the tip's own motion: ``F = (m + m_t) x'' - (m_t^2/k) x'''' + friction + offset``, x of the carriage, of which the
next term is ``(f/f_t)^4 m_t x''``. Records are compared up to f_t/3, where that is a hundredth of m_t.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import xarray as xr
from scipy import signal

from process.drive.servo import Servo
from process.types import Real
from smfe.diagnosis.drive.control_law import Gains
from smfe.diagnosis.drive.noise import Whitener
from smfe.diagnosis.drive.record import DriveRecordFamily, ForceData
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.inference.problem import Cause, Condition, Parameter, Values

_BAND = 1.0 / 3.0
"""Where a record is compared to, over the frequency of the tip."""

_FLOOR = 0.01
"""Share of the drive force that no law of friction is expected to meet: along a stroke, from one move to the next, it
varies by some per cent."""

_OWN = ("offset", "force_gain.error")
"""Nuisances of a record that the axis does not have."""

_USUAL_SPEED = 6e-3
"""Stribeck speed of an oiled guideway where a fit begins [m/s]."""

_REMEMBERED = 500
"""Values after which the noise of a record has forgotten what it was."""

_OF_AXIS = ("guideway_friction", "low_speed_friction", "friction_asymmetry", "missing_mode")
"""Causes of a record that are those of the axis: its friction, its second mass."""

_SLOWEST = 1e-9
"""A feed that only says which way the axis slides [m/s]."""


def family_of_record(
    record: xr.Dataset, baseline: AxisBaseline, servo: Servo, name: str, like: DriveRecordFamily | None = None
) -> DriveRecordFamily:
    """Return the family of a drive record of an axis under a servo, compared below the vibration of the tip.

    The logged force is a command, or what acts, or lies between: it acts by half the dead time of the loop later,
    within that half. `like` is the family of an earlier record, whose band, noise and catalogue are taken.
    """
    drive = baseline.drive
    whole = drive.moving_mass + drive.tip_mass
    t = baseline.tolerances
    made = partial(
        DriveRecordFamily.from_record,
        record,
        baseline.axis,
        mass=(whole, t.declared_mass * whole),
        gains=Gains(servo.Kv, servo.Kp),
        delay=0.5 * servo.delay,
        tolerances=replace(t, dead_time=t.dead_time + 0.5 * servo.delay),
        like=like,
        name=name,
    )
    found = made()
    highest = _BAND * drive.locked_frequency
    if like is None and found.model.resampler.cutoff > highest:
        found = made(cutoff=highest)
    return replace(found, conditions=tuple(_roughly(c, found.model.whitener) for c in found.conditions))


def _roughly(condition: Condition, whitener: Whitener) -> Condition:
    """Return a move with an error of the colour of its noise added, a share of its force."""
    data = condition.data
    if not isinstance(data, ForceData) or condition.observed is None:
        return condition
    impulse = np.zeros(_REMEMBERED)
    impulse[0] = whitener.sigma
    usual = float(np.linalg.norm(signal.lfilter([1.0], [1.0, *whitener.coefficients], impulse)))
    noise = math.hypot(data.noise, _FLOOR * float(np.sqrt(np.mean(np.square(data.force)))) / usual)
    return replace(condition, data=replace(data, noise=noise), observed=condition.observed * (data.noise / noise))


@dataclass(frozen=True)
class Record:
    """Moves of one half of a drive record, which are compared, and left out, together."""

    moves: tuple[Condition, ...]

    def apart(self, values: Real) -> Iterator[tuple[Condition, Real]]:
        """Yield each move with its part of whitened values, shape (n,) or (n, m)."""
        sizes = [np.asarray(m.observed).size for m in self.moves]
        yield from zip(self.moves, np.split(values, np.cumsum(sizes)[:-1]), strict=True)


@dataclass(frozen=True)
class Moves:
    """Drive records of an axis as their own family predicts them, from the values of the axis."""

    family: DriveRecordFamily  # all moves of all records
    baseline: AxisBaseline  # of the axis

    def conditions(self, groups: Mapping[str, Sequence[str]]) -> Mapping[str, tuple[Condition, ...]]:
        """Return the conditions of each measurement, from the names of its moves: the halves of its records."""
        every, found = {c.name: c for c in self.family.conditions}, {}
        for name, moves in groups.items():
            halves: dict[str, list[Condition]] = {}
            for move in (every[m] for m in moves):
                halves.setdefault(move.source, []).append(move)
            found[name] = tuple(
                Condition(
                    f"{name}, {half}",
                    {"evidence": "drive"},
                    np.concatenate([np.asarray(m.observed) for m in own]),
                    half,
                    Record(tuple(own)),
                )
                for half, own in halves.items()
            )
        return found

    def sliding(self) -> dict[str, float]:
        """Return friction that the records show by themselves, by least squares, as the causes of an axis name it.

        At rest as much again is taken to be held. None where it is less than what no law is expected to meet.
        """
        zero = {
            p.name: p.start for p in (*self.family.nuisances, *(p for c in self.family.causes for p in c.parameters))
        }
        linear = ("coulomb.force", "viscous", "mass", "offset")
        zero |= dict.fromkeys(linear, 0.0)
        moves = [(c, c.data) for c in self.family.conditions if isinstance(c.data, ForceData)]
        columns = [np.concatenate([self.family.predict(c, zero | {n: 1.0}) for c, _ in moves]) for n in linear]
        observed = np.concatenate([np.asarray(c.observed) for c, _ in moves])
        force, viscous, *_ = np.linalg.lstsq(np.stack(columns, axis=1), observed, rcond=None)[0].tolist()
        if force < _FLOOR * math.sqrt(np.mean([np.mean(np.square(data.force)) for _, data in moves])):
            return {}
        same = dict.fromkeys(("stribeck_coulomb", "static_rise"), force)
        return {**same, "stribeck_speed": _USUAL_SPEED, "viscous": max(viscous, 0.0)}

    @property
    def nuisances(self) -> tuple[Parameter, ...]:
        """What belongs to the records alone: offset, gain and delay of the force."""
        own = [p for p in self.family.nuisances if p.name in _OWN]
        delay = next(p for p in self.family.nuisances if p.name == "loop_delay.delay")
        # Where in the loop a force is logged is declared by nobody.
        return (*own, replace(delay, given=""))

    @property
    def causes(self) -> tuple[Cause, ...]:
        """What a record may show besides the axis; a drift is that of its force."""
        of_record = (c for c in self.family.causes if c.id not in _OF_AXIS)
        return tuple(replace(c, variant=c.variant or "force") if c.id == "drift" else c for c in of_record)

    def values(self, values: Values) -> Mapping[str, float]:
        """Return the parameters of a drive record for values of the axis and of the record."""
        found = {p.name: p.start for c in self.family.causes for p in c.parameters}
        found |= {p.name: p.start for p in self.family.nuisances}
        found |= {name: values[name] for name in found if name in values}
        forth, back = (self.baseline.effective(values, {}, way * _SLOWEST) for way in (1.0, -1.0))
        (moving, tip), one, other = forth.masses, forth.friction[0], back.friction[1]
        return found | {
            "mass": moving + tip,
            "mode.compliance": -(tip**2) / forth.stiffness,
            "viscous": 0.5 * (one.viscous + other.viscous),
            "asymmetry.viscous": 0.5 * (one.viscous - other.viscous),
            "offset": values["offset"] + 0.5 * (one.coulomb - other.coulomb),
            "coulomb.force": 0.5 * (one.coulomb + other.coulomb),
            "stribeck.boost": 0.5 * (one.static - one.coulomb + other.static - other.coulomb),
            "stribeck.speed": 0.5 * (one.speed + other.speed) or found["stribeck.speed"],
            "servo_gains.velocity": values.get("Kp_error", 0.0),
            "servo_gains.position": values.get("Kv_error", 0.0),
        }

    def predict(self, record: Record, values: Values) -> Real:
        """Return the whitened drive force of the moves of a record."""
        own = self.values(values)
        return np.concatenate([self.family.predict(m, own) for m in record.moves])

    def squared_size(self, record: Record, misfit: Real) -> float:
        """Return the square of the relative size of a whitened misfit: of force, over that of its moves."""
        each = [self.family.squared_size(m, x) for m, x in record.apart(misfit)]
        weight = [float(np.sum(np.square(np.asarray(m.observed)))) for m in record.moves]
        return float(np.average(each, weights=weight))

    def noises(self, columns: Sequence[tuple[Condition, Real]]) -> Sequence[Real]:
        """Return products of columns for each noise that the records could have come from; all else is white."""
        apart: list[tuple[Condition, Real]] = []
        for c, x in columns:
            apart += c.data.apart(x) if isinstance(c.data, Record) else [(c, x)]
        return self.family.noises(apart)

    @property
    def degrees_of_freedom(self) -> float:
        """Of the noise of half a record: both halves have one noise in common, which is known no better than that."""
        return 0.5 * self.family.noise_degrees_of_freedom
