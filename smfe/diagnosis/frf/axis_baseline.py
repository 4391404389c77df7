"""The simulation that is questioned, for one feed axis: two masses, servo, friction; and all that it may lack.

`AxisBaseline.machine` builds the machine that belongs to a set of values. With every cause at its null value it is the
baseline itself. A guideway that sticks gives way a little: friction is a LuGre bristle with a side for each direction.
A smooth sign instead, however steep, puts the idle compliance off by 10 % at its peak, because it has no stiffness to
stick with.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from process.drive.axis import Drive
from process.drive.sampled_servo import SampledServo
from process.drive.servo import Servo
from process.friction.laws import FrictionLaw, LuGre, Viscous
from process.machine.joints import CubicSpring, Gap, Iwan
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.structure import two_mass_axes
from smfe.diagnosis.inference.problem import Cause, Parameter, Values

BRISTLE = (5e8, 6e4)
"""Stiffness [N/m] and damping [N s/m] of a guideway that sticks, where nothing better is known."""

ELEMENTS = 20
"""Jenkins elements of a joint with micro-slip."""

SPREAD: dict[str, float] = {"moving_mass": 0.1, "tip_mass": 0.1, "stiffness": 0.1, "damping": 0.4, "viscous": 0.5}
"""Prior standard deviation of what a data sheet says, relative."""

_UNITS = {"moving_mass": "kg", "tip_mass": "kg", "stiffness": "N/m", "damping": "N s/m", "viscous": "N s/m"}


Sides = tuple[float, float]
"""A parameter of friction: forth, back."""


class Side(NamedTuple):
    """Friction of one direction: forces [N], Stribeck speed [m/s], viscous coefficient [N s/m]."""

    coulomb: float
    static: float
    speed: float
    viscous: float


class Effective(NamedTuple):
    """What a set of values comes to under the settings of a condition (SI); alike for values that change nothing.

    Without dry friction both sides of it are the one that rubs, or at rest their mean.
    """

    masses: tuple[float, float]
    stiffness: float
    damping: float
    friction: tuple[Side, Side]
    servos: tuple[tuple[float, float, float, float], ...]
    micro_slip: tuple[float, float]
    gap: tuple[float, float]
    cubic: float


@dataclass(frozen=True)
class AxisBaseline:
    """One feed axis as its maker describes it.

    Parameters
    ----------
    drive : Drive
        Masses, stiffness and damping; sigma is the viscous friction. Its servo is not used.
    servos : mapping
        Controller name -> servo.
    axis : {"x", "y", "z"}, optional
        Name of the axis.
    known : mapping, optional
        Friction that the baseline has already: ``coulomb``, ``static`` [N], ``stribeck_speed`` [m/s], ``viscous``
        [N s/m]: one value, or one forth and one back. Of ``viscous`` the ratio of the sides counts.
    spread : mapping, optional
        Prior standard deviation of each nuisance, relative; default `SPREAD`.
    bristle : (float, float), optional
        Stiffness [N/m] and damping [N s/m] of the guideway while it sticks.
    """

    drive: Drive
    servos: Mapping[str, Servo]
    axis: str = "x"
    known: Mapping[str, float | Sides] = field(default_factory=dict)
    spread: Mapping[str, float] = field(default_factory=lambda: dict(SPREAD))
    bristle: Sides = BRISTLE

    def nuisances(self) -> tuple[Parameter, ...]:
        """Return the parameters that every hypothesis fits anew."""
        d = self.drive
        starts = {
            "moving_mass": d.moving_mass,
            "tip_mass": d.tip_mass,
            "stiffness": d.stiffness,
            "damping": d.damping,
            "viscous": d.sigma,
        }
        out = []
        for name, start in starts.items():
            size = max(abs(start), 1e-3)
            spread = self.spread[name] * size
            low = 0.05 * start if name != "viscous" else 0.0
            out.append(Parameter(name, _UNITS[name], start, 0.1 * size, low, 20.0 * size, spread))
        return tuple(out)

    def causes(self) -> tuple[Cause, ...]:
        """Return what this baseline may lack."""
        return (*self._friction_causes(), *self._joint_causes(), *self._servo_causes(), *self._other_causes())

    def _friction_causes(self) -> tuple[Cause, ...]:
        coulomb = Parameter("coulomb", "N", 0.0, 10.0, 0.0, 1e4)
        under = Parameter("stribeck_coulomb", "N", 0.0, 10.0, 0.0, 1e4)
        rise = Parameter("static_rise", "N", 0.0, 10.0, 0.0, 1e4)
        speed = Parameter("stribeck_speed", "mm/min", 6e-3, 2e-3, 5e-4, 0.1, shown=6e4)
        ratio = Parameter("friction_asymmetry", "%", 0.0, 0.05, -0.9, 0.9, shown=100.0)
        level = Parameter("friction_level", "%", 0.0, 0.05, -0.9, 4.0, shown=100.0)
        out = []
        if "coulomb" not in self.known:
            title = "Coulomb friction of the guideway"
            out.append(Cause("guideway_friction", title, (coulomb,), "coulomb", starts=((40.0,),)))
        if "static" not in self.known:
            both = (rise, speed) if "coulomb" in self.known else (under, rise, speed)
            starts: tuple[tuple[float, ...], ...] = ((30.0, 6e-3), (30.0, 2e-2))
            if "coulomb" not in self.known:
                starts = ((40.0, 30.0, 6e-3), (20.0, 20.0, 2e-2))
            out.append(Cause("guideway_friction", "Stribeck friction of the guideway", both, "stribeck", starts=starts))
        if "coulomb" in self.known:
            out.append(Cause("guideway_friction", "level of the guideway's friction", (level,), "level"))
        out.append(Cause("friction_asymmetry", "friction that differs between the directions", (ratio,)))
        return tuple(out)

    def _joint_causes(self) -> tuple[Cause, ...]:
        k = self.drive.stiffness
        share = Parameter("micro_slip_share", "%", 0.0, 0.02, 0.0, 0.9, shown=100.0)
        travel = Parameter("micro_slip_travel", "um", 1e-4, 2e-5, 1e-6, 2e-3, shown=1e6)
        cubic = Parameter("cubic_stiffness", "N/um^3", 0.0, 1e7 * k, -1e11 * k, 1e11 * k, shown=1e-18)
        part = Parameter("gap_share", "%", 0.0, 0.1, 0.0, 0.95, shown=100.0)
        gap = Parameter("gap", "um", 2e-6, 1e-6, 0.0, 1e-3, shown=1e6)
        return (
            Cause("joint_micro_slip", "micro-slip in a joint", (share, travel), starts=((0.02, 1e-4), (0.02, 4e-4))),
            Cause("joint_hardening", "a joint that hardens or softens with displacement", (cubic,)),
            Cause("backlash", "play in a joint", (part, gap), starts=((0.3, 2e-6), (0.3, 2e-5))),
        )

    def _servo_causes(self) -> tuple[Cause, ...]:
        gains = tuple(
            Parameter(name, "%", 0.0, 0.05, -0.8, 4.0, shown=100.0) for name in ("Kp_error", "Ti_error", "Kv_error")
        )
        shortest = min((s.delay for s in self.servos.values()), default=0.0)
        delay = Parameter("extra_delay", "ms", 0.0, 1e-4, -shortest, 5e-3, shown=1e3)
        return (
            Cause("servo_gains", "servo gains other than recorded", gains, equivalent=self._exchanged),
            Cause("loop_delay", "a dead time in the control loop", (delay,)),
        )

    def _exchanged(self, values: Values) -> tuple[float, ...]:
        """Return the gains whose 1/Ti is the Kv and whose Kv the 1/Ti of others: P and PI in cascade know no order.

        ``Kp (s + Kv) (1 + 1/(Ti s))``; exact where all controllers have the same Kv Ti.
        """
        product = np.exp(np.mean([np.log(s.Kv * s.Ti) for s in self.servos.values() if s.Kv > 0.0] or [0.0]))
        later, faster = 1.0 + values["Ti_error"], 1.0 + values["Kv_error"]
        return values["Kp_error"], 1.0 / (product * faster) - 1.0, 1.0 / (product * later) - 1.0

    def _other_causes(self) -> tuple[Cause, ...]:
        m = self.drive.tip_mass
        posture = Parameter("stiffness_per_metre", "%/m", 0.0, 0.02, -0.9, 0.9, shown=100.0)
        drift = Parameter("stiffness_over_session", "%", 0.0, 0.01, -0.9, 0.9, shown=100.0)
        loading = Parameter("sensor_mass", "kg", 0.0, 0.01 * m, 0.0, 0.5 * m)
        return (
            Cause("posture", "stiffness that depends on the position", (posture,)),
            Cause("drift", "stiffness that drifts over the session", (drift,)),
            Cause("accelerometer_mass", "mass of the sensor", (loading,), kind="measurement"),
        )

    def effective(self, values: Values, settings: Mapping[str, float | str], feed: float) -> Effective:
        """Return what a set of values comes to under the settings of a condition.

        Parameters
        ----------
        values : mapping
            Nuisances, and of the causes those that are active; what is not there has its null value.
        settings : mapping
            ``position`` [m], ``order`` (0 first, 1 last in the session), ``added_mass`` [kg], ``sensor`` (``"laser"``
            weighs nothing), where they are known.
        feed : float
            Of the axis [m/s]; its sign tells which side of the guideway rubs.
        """
        place, order = float(settings.get("position", 0.0)), float(settings.get("order", 0.0))
        grown = 1.0 + values.get("stiffness_per_metre", 0.0) * place
        grown *= 1.0 + values.get("stiffness_over_session", 0.0) * order
        extra = float(settings.get("added_mass", 0.0))
        if settings.get("sensor") != "laser":
            extra += values.get("sensor_mass", 0.0)
        share, part = values.get("micro_slip_share", 0.0), values.get("gap_share", 0.0)
        return Effective(
            (values["moving_mass"], values["tip_mass"] + extra),
            values["stiffness"] * grown,
            values["damping"],
            self._sliding(values, feed),
            tuple(_gains(s, values) for s in self.servos.values()),
            (share, values["micro_slip_travel"] if share > 0.0 else 0.0),
            (part, values["gap"] if part > 0.0 else 0.0),
            values.get("cubic_stiffness", 0.0),
        )

    def _sliding(self, values: Values, feed: float) -> tuple[Side, Side]:
        forth, back = (self._side(values, n) for n in (0, 1))
        if forth.static > 0.0 or back.static > 0.0:
            return forth, back
        if feed != 0.0:
            return (forth, forth) if feed > 0.0 else (back, back)
        mean = forth._replace(viscous=0.5 * (forth.viscous + back.viscous))
        return mean, mean

    def _side(self, values: Values, n: int) -> Side:
        """Friction forth (0) or back (1)."""
        coulomb = _of_side(self.known.get("coulomb", 0.0), n)
        coulomb += values.get("coulomb", 0.0) + values.get("stribeck_coulomb", 0.0)
        static = _of_side(self.known["static"], n) if "static" in self.known else coulomb
        static += values.get("static_rise", 0.0)
        speed = values.get("stribeck_speed", 6e-3)
        if "stribeck_speed" in self.known:
            speed = _of_side(self.known["stribeck_speed"], n)
        ratio = self.known.get("viscous", 1.0)
        viscous = values["viscous"] * _of_side(ratio, n) / (0.5 * (_of_side(ratio, 0) + _of_side(ratio, 1)))
        factor = 1.0 + (1.0, -1.0)[n] * values.get("friction_asymmetry", 0.0)
        level = factor * (1.0 + values.get("friction_level", 0.0))
        return Side(level * coulomb, level * static, speed if static != coulomb else 0.0, factor * viscous)

    def machine(self, found: Effective) -> Machine:
        """Return the machine for what a set of values comes to."""
        joints, linear = _joints(found)
        structure = two_mass_axes({self.axis: Drive(*found.masses, linear, found.damping)})
        servos = {
            name: replace(s, Kp=kp, Ti=ti, Kv=kv, delay=delay)
            for (name, s), (kp, ti, kv, delay) in zip(self.servos.items(), found.servos, strict=True)
        }
        return Machine(structure, {self.axis: FeedAxis(servos or None, self._law(found.friction))}, joints)

    def _law(self, sides: tuple[Side, Side]) -> FrictionLaw | LuGre:
        if max(side.static for side in sides) <= 0.0:
            return Viscous(sides[0].viscous)
        forth, back = (
            LuGre(*self.bristle, max(s.coulomb, _LEAST), max(s.static, s.coulomb, _LEAST), s.speed or 1.0, s.viscous)
            for s in sides
        )
        return replace(forth, negative=back)


_LEAST = 1e-6


def _of_side(value: float | Sides, n: int) -> float:
    return value[n] if isinstance(value, tuple) else float(value)


def _gains(servo: Servo, values: Values) -> tuple[float, float, float, float]:
    return (
        servo.Kp * (1.0 + values.get("Kp_error", 0.0)),
        servo.Ti * (1.0 + values.get("Ti_error", 0.0)),
        servo.Kv * (1.0 + values.get("Kv_error", 0.0)),
        max(servo.delay + values.get("extra_delay", 0.0), 0.0),
    )


def _joints(found: Effective) -> tuple[list[MountedJoint], float]:
    """Return the joints that are not linear, and the stiffness [N/m] that is."""
    across, k = np.array([1.0, -1.0]), found.stiffness
    share, travel = found.micro_slip
    part, gap = found.gap
    joints = []
    if share > 0.0:
        joints.append(MountedJoint(Iwan(share * k, 0.5 * share * k * travel, ELEMENTS), across))
    if part > 0.0:
        joints.append(MountedJoint(Gap(part * k, gap), across))
    if found.cubic != 0.0:
        joints.append(MountedJoint(CubicSpring(0.0, found.cubic), across))
    return joints, k * max(1.0 - share - part, 1e-6)


def sampled(servo: Servo, period: float, lag: int = 1, latency: float = 0.0) -> Servo:
    """Return the continuous servo that equals a sampled one whose velocity is the difference of two readings.

    To the second order of the period T: hold, lag and latency are a dead time, the rectangular integral is worth
    ``Kp (1 + T/(2 Ti))`` and ``Ti + T/2``, and the velocity, T/2 later than the position, makes ``Kp (1 + Kv T/2)`` and
    ``Kv/(1 + Kv T/2)`` with half a period more of dead time.

    Parameters
    ----------
    servo : Servo
        Gains, without a delay.
    period : float
        Sampling period [s].
    lag : int, optional
        Whole periods from reading to force.
    latency : float, optional
        Further dead time [s].
    """
    plain, later = SampledServo(servo, period, lag).continuous(), 1.0 + 0.5 * servo.Kv * period
    return replace(plain, Kp=plain.Kp * later, Kv=plain.Kv / later, delay=plain.delay + latency + 0.5 * period)
