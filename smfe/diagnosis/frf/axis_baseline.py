"""The simulation that is tested, for one feed axis: two masses, servo, friction; and all that it may lack.

`AxisBaseline.machine` builds the machine that belongs to a set of values. With every cause at its null value it is the
baseline itself. A guideway that sticks gives way a little: friction is a LuGre bristle with a side for each direction.
A smooth sign instead, however steep, puts the idle compliance off by 10 % at its peak, because it has no stiffness to
stick with.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.friction.laws import FrictionLaw, GeneralisedMaxwellSlip, LuGre, MemoryLaw, Viscous
from process.machine.joints import CubicSpring, Gap, Iwan
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.structure import two_mass_axes
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.frf.causes import axis_causes
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.frf.workshop import gain_nuisance, skew_nuisance
from smfe.diagnosis.inference.problem import Cause, Parameter, Values

SPREAD: dict[str, float] = {"moving_mass": 0.1, "tip_mass": 0.1, "stiffness": 0.1, "damping": 0.4, "viscous": 0.5}
"""Prior standard deviation of what a data sheet says, relative."""

GIVEN = {"moving_mass": "declared_mass", "tip_mass": "declared_mass", "stiffness": "declared_stiffness"}
"""Cause under which a value far from the data sheet's is named."""

SAID = {"moving_mass": "moving mass", "tip_mass": "mass of the tip"}

Sides = tuple[float, float]
"""A parameter of friction: forth, back."""


class Side(NamedTuple):
    """Friction of one direction: forces [N], Stribeck speed [m/s], viscous coefficient [N s/m]."""

    coulomb: float
    static: float
    speed: float
    viscous: float

    def force(self, velocity: float) -> float:
        """Return what brakes at a steady velocity [m/s], at zero what is held at rest [N], as `LuGre` has it."""
        rise = (self.static - self.coulomb) * math.exp(-abs(velocity) / self.speed) if self.speed else 0.0
        return self.coulomb + rise + self.viscous * abs(velocity)


class Elements(NamedTuple):
    """How the elements of a guideway slip before all of it slides."""

    longest: float  # travel after which the last slips, over the geometric mean; the first as much less
    alike: str = "stiffness"  # or "force": what they have in common
    later: float = 1.0  # time in which their force follows the Stribeck curve, over that of a bristle at its speed


PRESLIDING = Elements(1.01), Elements(5.0), Elements(5.0, "force"), Elements(5.0, later=10.0)
"""Ways in which guideways give way before they slide, besides that of a bristle: all at once; one
after the other over travels of 1 to 25, as the elements of generalised Maxwell slip do (Al-Bender, Lampaert, Swevers
2005); and with a friction that lags behind its velocity. Chosen, not measured."""


class Effective(NamedTuple):
    """What a set of values comes to under the settings of a condition (SI); alike for values that change nothing.

    Without dry friction both sides of it are that of the sliding direction, or at rest their mean.
    """

    masses: tuple[float, float]
    stiffness: float
    damping: float
    friction: tuple[Side, Side]
    servos: tuple[Servo, ...]
    micro_slip: tuple[float, float]
    gap: tuple[float, float]
    cubic: float
    contact: float  # compliance of the guideway that sticks [m/N]; 0 without dry friction


def acting(servo: Servo, period: float) -> Servo:
    """Return the continuous servo that one of these gains is whose samples are a period apart [s].

    The sum over the velocity errors holds the latest in full, ``1/(Ti s) + T/(2 Ti)``, and the position is read half a
    period later than the velocity, which is a difference of two readings: ``s + Kv exp(s T/2)``. To first order in s T
    that is a larger Kp with Ti and Kv to go with it; the dead time, which is that of the velocity, stays.
    """
    whole, early = 1.0 + 0.5 * period / servo.Ti, 1.0 + 0.5 * period * servo.Kv
    return replace(servo, Kp=servo.Kp * whole * early, Ti=servo.Ti * whole, Kv=servo.Kv / early)


@dataclass(frozen=True)
class AxisBaseline:
    """One feed axis as its maker describes it."""

    drive: Drive  # masses, stiffness and damping; sigma is the viscous friction. Its servo is not used
    servos: Mapping[str, Servo]  # controller name -> servo
    axis: str = "x"  # name of the axis: "x" or "y" or "z"
    known: Mapping[str, float | Sides] = field(default_factory=dict)
    """Friction that the baseline has already: ``coulomb``, ``static`` [N], ``stribeck_speed`` [m/s], ``viscous`` [N
    s/m]: one value, or one forth and one back. Of ``viscous`` the ratio of the sides counts."""
    spread: Mapping[str, float] = field(default_factory=lambda: dict(SPREAD))
    """Prior standard deviation of each nuisance, relative; default `SPREAD`."""
    tolerances: Tolerances = field(default_factory=Tolerances)  # of the control and of the sensors
    period: float | None = None
    """Of the samples of the control [s]; zero: the servos are what they act as; None: not known, a nuisance."""

    def nuisances(self, others: Collection[str] = ()) -> tuple[Parameter, ...]:
        """Return the parameters that every hypothesis fits anew: of the machine, of its control, of the sensors.

        What is wrong with a drive all its controls have. Besides, the gains of each are set by themselves: those of
        the `others`, beside the one that was measured most, are apart from its by as much as two are within the
        tolerance.
        """
        d, found = self.drive, []
        for name, unit, start, shown in (
            ("moving_mass", "kg", d.moving_mass, 1.0),
            ("tip_mass", "kg", d.tip_mass, 1.0),
            ("stiffness", "N/um", d.stiffness, 1e-6),
            ("damping", "N s/m", d.damping, 1.0),
            ("viscous", "N s/m", d.sigma, 1.0),
        ):
            size = max(abs(start), 1e-3)
            low, prior = 0.0 if name == "viscous" else 0.05 * start, self.spread[name] * size
            of = (GIVEN.get(name, ""), True, SAID.get(name, name))
            found.append(Parameter(name, unit, start, 0.1 * size, low, 20.0 * size, prior, shown, *of))
        # Over how far a guideway gives way before it slides nobody declares, and only an axis with friction shows.
        soft = RULES.contact * RULES.contact_axis / d.stiffness
        around = (0.1 * soft, 50.0 * soft, RULES.contact_spread * soft)
        found.append(Parameter("contact", "um/kN", soft, 0.2 * soft, *around, 1e9))
        # Sliding and static friction are declared within some per cent each, so that their difference, which damps or
        # feeds vibration in slow motion, is off by several times that.
        t = self.tolerances
        for force, said in (("coulomb", "sliding friction"), ("static", "static friction")):
            if force in self.known and t.declared_friction > 0.0:
                within = (0.0, 0.02, -0.5, 1.0, t.declared_friction)
                found.append(Parameter(f"{force}_error", "%", *within, 100.0, "guideway_friction", True, said))
        if self.servos and t.control_gain > 0.0:
            for gain, said in (("Kp", "velocity gain Kp"), ("Ti", "integral time Ti"), ("Kv", "position gain Kv")):
                known = (t.control_gain, 100.0, "servo_gains", True, said)
                found.append(Parameter(f"{gain}_error", "%", 0.0, 0.05, -0.8, 4.0, *known))
                apart = math.sqrt(2.0) * t.control_gain
                found += [Parameter(f"{gain}_of_{n}", "%", 0.0, 0.05, -0.4, 0.4, apart, 100.0) for n in others]
        shortest = min((s.delay for s in self.servos.values()), default=0.0)
        if shortest > 0.0 and t.dead_time > 0.0:
            least = 1.0 / self.rate - shortest  # no shorter dead time is simulated
            # Who counts samples is off by up to a half of one, either way, evenly.
            known = (t.dead_time / math.sqrt(3.0), 1e3, "loop_delay", True, "dead time beyond that of the control")
            found.append(Parameter("extra_delay", "ms", 0.0, 1e-4, least, 5e-3, *known))
            # Nobody declares the period of its samples: it is a part of the dead time, which holds one at least.
            if self.period is None:
                period = (0.0, 0.1 * shortest, 0.0, shortest, RULES.period * shortest)
                found.append(Parameter("period", "ms", *period, 1e3, said="period of the control's samples"))
        said = "gain of the acceleration over the force"
        # Force sensor and accelerometer are calibrated one by one.
        sensors = gain_nuisance("gain_error", said, math.sqrt(2.0) * t.sensor_gain), skew_nuisance(t.clock)
        return (*found, *(p for p in sensors if p is not None))

    @property
    def rate(self) -> float:
        """Steps and samples a second of a simulated hit [Hz]: no step is longer than the shortest dead time may be.

        The fastest pole is that of both masses on their joint. As it moves in a fit it must not need other steps: what
        they change, a fifth of the noise at rest, would be a jump that no slope knows.
        """
        shortest = min((s.delay for s in self.servos.values()), default=0.0)
        least = max(shortest - self.tolerances.dead_time, 0.5 * shortest)
        d = self.drive
        free = math.sqrt(d.stiffness * (1.0 / d.moving_mass + 1.0 / d.tip_mass)) / (2.0 * math.pi)
        return max(RULES.rate, RULES.steps_per_pole * free, 1.0 / least if least > 0.0 else 0.0)

    def causes(self) -> tuple[Cause, ...]:
        """Return what this baseline may lack."""
        timeless = bool(self.servos) and all(s.delay == 0.0 for s in self.servos.values())
        return axis_causes(self.known, self.drive, timeless)

    def effective(self, values: Values, settings: Mapping[str, float | str], feed: float) -> Effective:
        """Return what a set of values comes to under the settings of a condition.

        Settings that count: ``position`` [m], ``order`` (0 first, 1 last in the session), ``added_mass`` [kg],
        ``sensor`` (``"laser"`` weighs nothing). The sign of the feed [m/s] is the direction of sliding.
        """
        place, order = float(settings.get("position", 0.0)), float(settings.get("order", 0.0))
        grown = 1.0 + values.get("stiffness_per_metre", 0.0) * place
        grown *= 1.0 + values.get("stiffness_over_session", 0.0) * order
        extra = float(settings.get("added_mass", 0.0))
        if settings.get("sensor") != "laser":
            extra += values.get("sensor_mass", 0.0)
        forth, back = self._side(values, 0), self._side(values, 1)
        if forth.static <= 0.0 and back.static <= 0.0:
            mean = forth._replace(viscous=0.5 * (forth.viscous + back.viscous))
            forth = back = mean if feed == 0.0 else forth if feed > 0.0 else back

        def off(control: str, gain: str) -> float:
            return (1.0 + values.get(f"{gain}_error", 0.0)) * (1.0 + values.get(f"{gain}_of_{control}", 0.0))

        servos = tuple(
            acting(
                Servo(
                    s.Kp * off(name, "Kp"),
                    s.Ti * off(name, "Ti"),
                    s.Kv * off(name, "Kv"),
                    max(s.delay + values.get("extra_delay", 0.0), 0.0),
                    s.feed_forward,
                ),
                values.get("period", self.period or 0.0),
            )
            for name, s in self.servos.items()
        )
        share, part = values.get("micro_slip_share", 0.0), values.get("gap_share", 0.0)
        return Effective(
            (values["moving_mass"], values["tip_mass"] + extra),
            values["stiffness"] * grown,
            values["damping"],
            (forth, back),
            servos,
            (share, values["micro_slip_travel"] if share > 0.0 else 0.0),
            (part, values["gap"] if part > 0.0 else 0.0),
            values.get("cubic_stiffness", 0.0),
            values["contact"] if max(forth.static, back.static) > 0.0 else 0.0,
        )

    def under(self, found: Effective, controller: str | None) -> Effective:
        """Return the same with all controls but one as declared: what they are off changes nothing under this one."""
        if controller not in self.servos:
            return found
        own = zip(self.servos.items(), found.servos, strict=True)
        return found._replace(servos=tuple(off if name == controller else s for (name, s), off in own))

    def _side(self, values: Values, n: int) -> Side:
        """Friction forth (0) or back (1)."""

        def known(name: str, otherwise: float, n: int = n) -> float:
            value = self.known.get(name, otherwise)
            return value[n] if isinstance(value, tuple) else float(value)

        sliding = known("coulomb", 0.0) * (1.0 + values.get("coulomb_error", 0.0))
        coulomb = sliding + values.get("coulomb", 0.0) + values.get("stribeck_coulomb", 0.0)
        static = known("static", coulomb) + values.get("static_rise", 0.0)
        if "static" in self.known:
            static = max(static * (1.0 + values.get("static_error", 0.0)), coulomb)
        speed = known("stribeck_speed", values.get("stribeck_speed", 6e-3))
        ratio = known("viscous", 1.0) / (0.5 * (known("viscous", 1.0, 0) + known("viscous", 1.0, 1)))

        def differs(name: str) -> float:
            return 1.0 + (1.0, -1.0)[n] * (values.get("friction_asymmetry", 0.0) + values.get(name, 0.0))

        level = 1.0 + values.get("friction_level", 0.0)
        slides = level * differs("asymmetry_coulomb") * coulomb
        rise = level * differs("asymmetry_rise") * (static - coulomb)
        speed *= 1.0 + (1.0, -1.0)[n] * values.get("asymmetry_speed", 0.0)
        viscous = differs("asymmetry_viscous") * values["viscous"] * ratio
        return Side(max(slides, 0.0), max(slides + rise, 0.0), speed if rise else 0.0, max(viscous, 0.0))

    def machine(self, found: Effective, elements: Elements | None = None) -> Machine:
        """Return the machine for what a set of values comes to, with a bristle, or with elements, in its guideway."""
        across, k, (share, travel), (part, gap) = np.array([1.0, -1.0]), found.stiffness, found.micro_slip, found.gap
        joints = []
        if share > 0.0:
            joints.append(MountedJoint(Iwan(share * k, 0.5 * share * k * travel, RULES.elements), across))
        if part > 0.0:
            joints.append(MountedJoint(Gap(part * k, gap), across))
        if found.cubic != 0.0:
            joints.append(MountedJoint(CubicSpring(0.0, found.cubic), across))
        law: FrictionLaw | MemoryLaw = Viscous(found.friction[0].viscous)
        if max(side.static for side in found.friction) > 0.0:
            stiff, loss = 1.0 / found.contact, RULES.contact_loss / found.contact
            forth, back = (
                LuGre(stiff, loss, max(s.coulomb, 1e-6), max(s.static, s.coulomb, 1e-6), s.speed or 1.0, s.viscous)
                for s in found.friction
            )
            bristle = replace(forth, negative=back)
            law = bristle if elements is None else _elements(bristle, elements)
        linear = k * max(1.0 - share - part, 1e-6)
        structure = two_mass_axes({self.axis: Drive(*found.masses, linear, found.damping)})
        servos = dict(zip(self.servos, found.servos, strict=True))
        return Machine(structure, {self.axis: FeedAxis(servos or None, law)}, joints)


def _elements(law: LuGre, how: Elements) -> GeneralisedMaxwellSlip:
    """Return a guideway of elements for one with a bristle: as stiff while it sticks, and with the same forces.

    The damping of the bristle it has not.
    """
    travel = how.longest ** np.linspace(-1.0, 1.0, RULES.slipping)
    stiffness = np.ones(RULES.slipping) if how.alike == "stiffness" else 1.0 / travel
    stiffness *= law.bristle_stiffness / stiffness.sum()
    share = stiffness * travel / float(stiffness @ travel)
    drawn = law.bristle_stiffness * law.stribeck_speed / how.later

    def one_way(side: LuGre) -> GeneralisedMaxwellSlip:
        curve = side.coulomb, side.static, side.stribeck_speed, side.sigma
        return GeneralisedMaxwellSlip(tuple(stiffness.tolist()), tuple(share.tolist()), *curve, drawn)

    back = law.negative
    return one_way(law) if back is None else replace(one_way(law), negative=one_way(back))
