"""What the tables of campaign and scenario are made of: unknown keys are errors, several kinds of values."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict

from process import units
from process.errors import InputError
from smfe.campaign import quantities as q


class Table(BaseModel):
    """A table of the file: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


# --- Kinds of values that several tables hold.

Triple = tuple[float, float, float]


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


def number(value: Any) -> float:
    """A number without unit, written as such or as a text with "%" -> float."""
    if isinstance(value, str):
        return units.parse(value, "dimensionless")
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"{value!r} is not a number; write 0.02 or '2 %'")
    return float(value)


def triple(dimension: str, low: float = -math.inf) -> BeforeValidator:
    """One quantity for all axes, or a list of three -> triple in SI, each at least `low`."""

    def parse(value: Any) -> Triple:
        items = value if isinstance(value, list) else [value] * 3
        if len(items) != 3:
            raise InputError(f"{value!r} has {len(items)} values; give one for all axes, or one each for x, y and z")
        x, y, z = (number(item) if dimension == "dimensionless" else units.parse(item, dimension) for item in items)
        if min(x, y, z) < low:
            raise InputError(f"{value!r} is not possible; noise is zero or more")
        return x, y, z

    return BeforeValidator(parse)


def _span(dimension: str, example: str) -> BeforeValidator:
    """[from, to], or one quantity for both -> (low, high) in SI, positive."""

    def parse(value: Any) -> tuple[float, float]:
        items = value if isinstance(value, list) else [value, value]
        if len(items) != 2:
            raise InputError(f"{value!r} is no range; write [from, to] or one value, e.g. {example}")
        low, high = (units.parse(item, dimension) for item in items)
        if not 0.0 < low <= high < math.inf:
            raise InputError(f"{value!r} is no range; both must be positive, the first not above the second")
        return low, high

    return BeforeValidator(parse)


PositiveMass = Annotated[float, q.quantity("mass", above=0.0)]
PositiveTime = Annotated[float, q.quantity("time", above=0.0)]
Delay = Annotated[float, q.quantity("time", low=0.0)]
Viscosity = Annotated[float, q.quantity("viscosity", low=0.0)]
Speed = Annotated[float, q.quantity("speed", above=0.0)]


Lengths = Annotated[tuple[float, float], _span("length", '["0.05 mm", "0.2 mm"]')]
Speeds = Annotated[tuple[float, float], _span("speed", '["500 mm/min", "2000 mm/min"]')]
