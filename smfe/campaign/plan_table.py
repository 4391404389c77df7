"""``[plan]``: what a sweep may use, and what is asked of it; every field comes out in SI."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, StrictInt, StrictStr, model_validator

from process import units
from process.errors import InputError
from smfe.campaign import quantities as q
from smfe.campaign.machine_tables import Delay, PositiveTime
from smfe.campaign.tables import Table

Triple = tuple[float, float, float]


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


def _triple(dimension: str) -> BeforeValidator:
    """One quantity for all axes, or a list of three -> triple in SI, zero or more."""

    def parse(value: Any) -> Triple:
        items = value if isinstance(value, list) else [value] * 3
        if len(items) != 3:
            raise InputError(f"{value!r} has {len(items)} values; give one for all axes, or one each for x, y and z")
        x, y, z = (units.parse(item, dimension) for item in items)
        if min(x, y, z) < 0.0:
            raise InputError(f"{value!r} is not possible; noise is zero or more")
        return x, y, z

    return BeforeValidator(parse)


Lengths = Annotated[tuple[float, float], _span("length", '["0.05 mm", "0.2 mm"]')]
Speeds = Annotated[tuple[float, float], _span("speed", '["500 mm/min", "2000 mm/min"]')]


class PassTable(Table):
    """One entry of ``passes``."""

    cut: q.CutName
    width_of_cut: q.PositiveLength


class PlanTable(Table):
    """``[plan]``; what is left out does not limit, or has the default that `docs/plan.md` lists."""

    machine: StrictStr | None = None
    scenario: StrictStr | None = None
    controller: StrictStr | None = None
    frequency_range: q.FrequencyRange = (20.0, 80.0)
    passes: tuple[PassTable, ...] = ()
    width_of_cut: Lengths | None = None
    inserts: tuple[Annotated[StrictInt, Field(ge=1)], ...] = ()
    feed_per_tooth: Lengths = (0.05e-3, 0.2e-3)
    depth_of_cut: Lengths = (0.5e-3, 4e-3)
    spindle_acceleration: Annotated[float, q.quantity("rotation_rate", above=0.0)] | None = None
    power: Annotated[float, q.quantity("power", above=0.0)] | None = None
    torque: Annotated[float, q.quantity("torque", above=0.0)] | None = None
    largest_force: Annotated[float, q.quantity("force", above=0.0)] | None = None
    feed: Speeds | None = None
    stroke: q.PositiveLength | None = None
    stock_length: q.PositiveLength | None = None
    longest_pass: PositiveTime = 90.0
    time: PositiveTime | None = None
    repeats: Annotated[StrictInt, Field(ge=1, le=100)] = 1
    largest_error: q.Share = 0.1
    chatter_margin: q.Share = 0.5
    acceleration_noise: Annotated[Triple, _triple("acceleration")] = (0.012, 0.012, 0.012)
    force_noise: Annotated[Triple, _triple("force")] = (1.5, 1.5, 1.5)
    sample_rate: q.PositiveFrequency = 5000.0
    lead: Delay = 0.5
    tail: Delay = 2.0

    @model_validator(mode="after")
    def _possible(self) -> PlanTable:
        if self.machine is not None and self.scenario is not None:
            raise InputError("names a machine of this file and a scenario; one estimate of the machine is needed")
        if 0 < len(self.passes) < 3:
            raise InputError(
                f"has {len(self.passes)} passes; nine compliances need three that push in different directions: add "
                "one, or leave passes out and have them found"
            )
        if min(self.largest_error, self.chatter_margin) <= 0.0:
            raise InputError("largest_error and chatter_margin must be above zero, e.g. '10 %' and '50 %'")
        if self.longest_pass < 1.0:
            raise InputError(f"longest_pass is {self.longest_pass:g} s; a sweep takes at least 1 s, better 10 s")
        if self.frequency_range[0] < 5.0:
            raise InputError(
                f"frequency_range begins at {self.frequency_range[0]:g} Hz; below 5 Hz an acceleration tells nothing "
                "of a displacement: begin higher"
            )
        if self.frequency_range[1] > 0.2 * self.sample_rate:
            raise InputError(
                f"frequency_range ends at {self.frequency_range[1]:g} Hz, sampled at {self.sample_rate:g} Hz; sample "
                f"at {self.frequency_range[1] / 0.2:g} Hz or more"
            )
        return self
