"""Tables that say what a feed axis is: shared by the campaign's baseline and by scenarios."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, StrictStr

from process import units
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import (
    Andersson,
    Coulomb,
    CoulombViscous,
    FrictionLaw,
    GeneralisedMaxwellSlip,
    LuGre,
    MemoryLaw,
    Viscous,
)
from smfe.campaign import quantities as q
from smfe.campaign.tables import Table
from smfe.records.formats.channels import listed

LAWS: dict[str, type[FrictionLaw | MemoryLaw]] = {
    "viscous": Viscous,
    "coulomb": Coulomb,
    "coulomb_viscous": CoulombViscous,
    "andersson": Andersson,
    "lugre": LuGre,
    "gms": GeneralisedMaxwellSlip,
}
"""Friction laws by the name that a file uses."""


def many(value: Any) -> Any:
    """One value or a list of them -> list."""
    if value == []:
        raise InputError("is empty; at least one entry is needed")
    return value if isinstance(value, list) else [value]


def values(dimension: str, above: float = -math.inf) -> BeforeValidator:
    """One quantity or a list of them -> tuple in SI, each more than `above`."""

    def parse(value: Any) -> tuple[float, ...]:
        numbers = tuple(units.parse(item, dimension) for item in many(value))
        for number, item in zip(numbers, many(value), strict=True):
            if not number > above:
                raise InputError(f"'{item}' is not possible; it must be positive")
        return numbers

    return BeforeValidator(parse)


PositiveMass = Annotated[float, q.quantity("mass", above=0.0)]
PositiveTime = Annotated[float, q.quantity("time", above=0.0)]
Delay = Annotated[float, q.quantity("time", low=0.0)]
Viscosity = Annotated[float, q.quantity("viscosity", low=0.0)]
Speed = Annotated[float, q.quantity("speed", above=0.0)]


class ServoTable(Table):
    """One controller of an axis."""

    Kp: Annotated[float, q.quantity("viscosity", above=0.0)]
    Ti: PositiveTime
    Kv: q.PositiveFrequency
    delay: Delay = 0.0
    feed_forward: q.Ratio = 1.0

    def build(self) -> Servo:
        """Return the servo."""
        return Servo(**dict(self))


class FrictionTable(Table):
    """``friction`` of an axis: the law by name and its parameters."""

    law: Annotated[str, q.one_of(tuple(LAWS), "law")]
    coulomb: q.Force | None = None
    static: q.Force | None = None
    stribeck_speed: Speed | None = None
    sigma: Viscosity | None = None
    kt: Annotated[float, q.quantity("steepness", above=0.0)] | None = None
    delta: q.Ratio | None = None
    bristle_stiffness: q.Stiffness | None = None
    bristle_damping: Viscosity | None = None
    element_stiffness: Annotated[tuple[float, ...], values("stiffness", above=0.0)] | None = None
    share: tuple[q.Ratio, ...] | None = None
    attraction: Annotated[float, q.quantity("force_rate", above=0.0)] | None = None

    def build(self) -> FrictionLaw | MemoryLaw:
        """Return the law."""
        law: FrictionLaw | MemoryLaw = made(
            "friction law", self.law, LAWS[self.law], self.model_dump(exclude_unset=True, exclude={"law"})
        )
        return law


class AxisTable(Table):
    """``[machine.axis.x]``."""

    moving_mass: PositiveMass
    tip_mass: PositiveMass | None = None
    stiffness: q.Stiffness | None = None
    damping: Viscosity | None = None
    controllers: Annotated[dict[StrictStr, ServoTable], Field(default_factory=dict)]
    friction: FrictionTable | None = None


def made(what: str, name: str, make: Callable[..., Any], given: Mapping[str, Any]) -> Any:
    """Build a law from exactly the parameters it has."""
    fields = getattr(make, "__dataclass_fields__", {})
    wanted = {f.name for f in fields.values() if f.init}
    needed = {f.name for f in fields.values() if f.init and f.default is MISSING}
    missing, extra = sorted(needed - set(given)), sorted(set(given) - wanted)
    if missing or extra:
        told = [f"{listed(missing)} missing"] * bool(missing) + [f"{listed(extra)} not read"] * bool(extra)
        raise InputError(f"{what} '{name}': {' and '.join(told)}; it has {listed(sorted(wanted))}")
    return make(**given)
