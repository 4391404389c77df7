"""The simulation that is tested, for one feed axis: two masses, servo, friction; and all that it may lack.

`AxisBaseline.machine` builds the machine that belongs to a set of values. With every cause at its null value it is the
baseline itself. A guideway that sticks gives way a little: friction is a LuGre bristle with a side for each direction.
A smooth sign instead, however steep, puts the idle compliance off by 10 % at its peak, because it has no stiffness to
stick with.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.friction.laws import FrictionLaw, LuGre, Viscous
from process.machine.joints import CubicSpring, Gap, Iwan
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.structure import two_mass_axes
from smfe.diagnosis.frf.causes import axis_causes
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.inference.problem import Cause, Parameter, Values

SPREAD: dict[str, float] = {"moving_mass": 0.1, "tip_mass": 0.1, "stiffness": 0.1, "damping": 0.4, "viscous": 0.5}
"""Prior standard deviation of what a data sheet says, relative."""

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

    def nuisances(self) -> tuple[Parameter, ...]:
        """Return the parameters that every hypothesis fits anew."""
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
            found.append(Parameter(name, unit, start, 0.1 * size, low, 20.0 * size, prior, shown))
        return tuple(found)

    def causes(self) -> tuple[Cause, ...]:
        """Return what this baseline may lack."""
        return axis_causes(self.known, self.drive.stiffness, self.drive.tip_mass, list(self.servos.values()))

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
        servos = tuple(
            replace(
                s,
                Kp=s.Kp * (1.0 + values.get("Kp_error", 0.0)),
                Ti=s.Ti * (1.0 + values.get("Ti_error", 0.0)),
                Kv=s.Kv * (1.0 + values.get("Kv_error", 0.0)),
                delay=max(s.delay + values.get("extra_delay", 0.0), 0.0),
            )
            for s in self.servos.values()
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
        )

    def _side(self, values: Values, n: int) -> Side:
        """Friction forth (0) or back (1)."""

        def known(name: str, otherwise: float, n: int = n) -> float:
            value = self.known.get(name, otherwise)
            return value[n] if isinstance(value, tuple) else float(value)

        coulomb = known("coulomb", 0.0) + values.get("coulomb", 0.0) + values.get("stribeck_coulomb", 0.0)
        static = known("static", coulomb) + values.get("static_rise", 0.0)
        speed = known("stribeck_speed", values.get("stribeck_speed", 6e-3))
        ratio = known("viscous", 1.0) / (0.5 * (known("viscous", 1.0, 0) + known("viscous", 1.0, 1)))
        factor = 1.0 + (1.0, -1.0)[n] * values.get("friction_asymmetry", 0.0)
        level = factor * (1.0 + values.get("friction_level", 0.0))
        return Side(
            level * coulomb, level * static, speed if static != coulomb else 0.0, factor * values["viscous"] * ratio
        )

    def machine(self, found: Effective) -> Machine:
        """Return the machine for what a set of values comes to."""
        across, k, (share, travel), (part, gap) = np.array([1.0, -1.0]), found.stiffness, found.micro_slip, found.gap
        joints = []
        if share > 0.0:
            joints.append(MountedJoint(Iwan(share * k, 0.5 * share * k * travel, RULES.elements), across))
        if part > 0.0:
            joints.append(MountedJoint(Gap(part * k, gap), across))
        if found.cubic != 0.0:
            joints.append(MountedJoint(CubicSpring(0.0, found.cubic), across))
        law: FrictionLaw | LuGre = Viscous(found.friction[0].viscous)
        if max(side.static for side in found.friction) > 0.0:
            forth, back = (
                LuGre(*RULES.bristle, max(s.coulomb, 1e-6), max(s.static, s.coulomb, 1e-6), s.speed or 1.0, s.viscous)
                for s in found.friction
            )
            law = replace(forth, negative=back)
        linear = k * max(1.0 - share - part, 1e-6)
        structure = two_mass_axes({self.axis: Drive(*found.masses, linear, found.damping)})
        servos = dict(zip(self.servos, found.servos, strict=True))
        return Machine(structure, {self.axis: FeedAxis(servos or None, law)}, joints)
