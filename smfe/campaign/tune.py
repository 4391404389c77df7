"""``[tune]``: which gains are to be found, for which cut, within which limits."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, StrictInt, StrictStr

from process import units
from process.errors import InputError
from smfe.campaign import quantities as q
from smfe.campaign.machine import MachineMass, ServoTable
from smfe.campaign.tables import Delay, PositiveTime, Table

GOALS = ("least_depth", "removal_rate", "depths")
"""Goals of a search for gains."""

MOVES = ("following", "circle", "corner")
"""Moves whose error is weighed against the depth."""

FREE = "none"
"""What stands for a limit that is not kept."""


def _decibels(value: Any) -> float | None:
    """A number of decibels, written "3 dB", or "none" -> dB."""
    if value == FREE or value is None:
        return None
    text = value.strip().removesuffix("dB").strip() if isinstance(value, str) else value
    try:
        if isinstance(text, bool) or (isinstance(value, str) and not value.strip().endswith("dB")):
            raise ValueError
        number = float(text)
    except (TypeError, ValueError):
        raise InputError(f'{value!r} is no level; write it in decibels, "3 dB", or "none" for no limit') from None
    if not math.isfinite(number):
        raise InputError(f'{value!r} is not finite; write "none" for no limit')
    if not isinstance(value, str) and not units.numbers_count():
        raise InputError(f'{value!r} has no unit; write it as text with a unit, "{value} dB"')
    return number


def _feed_forward(value: Any) -> float | None:
    """A number from 0 to 1, or "largest" -> number; None for the largest."""
    if value == "largest":
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
        raise InputError(f'{value!r} is no feed-forward; write a number from 0 to 1, or "largest"')
    return float(value)


Decibels = Annotated[float | None, BeforeValidator(_decibels)]


class MoveTable(Table):
    """``move``: what is followed, and how fast."""

    kind: Annotated[str, q.one_of(MOVES, "move")] = "following"
    feed: Annotated[float, q.quantity("speed", above=0.0)] = 1.0 / 60.0
    radius: q.PositiveLength | None = None


class MeasuredAxisTable(Table):
    """``measured.axis.x``: an axis that is known by its open loop."""

    open_loop: StrictStr
    period: PositiveTime
    moving_mass: MachineMass | None = None
    dead_time: Delay = 0.0
    controllers: Annotated[dict[StrictStr, ServoTable], Field(default_factory=dict)]


class MeasuredTable(Table):
    """``measured``: compliance at rest and open loops instead of a machine model."""

    at_rest: StrictStr
    tip_mass: MachineMass | None = None
    axis: Annotated[dict[q.Axis, MeasuredAxisTable], q.NotEmpty]


class TuneTable(Table):
    """``[tune]``; what is left out has the default that `docs/tune.md` lists."""

    goal: Annotated[str, q.one_of(GOALS, "goal")] | None = None
    spindle_speed: q.LobeSpeeds | None = None
    cut: q.CutName
    width_of_cut: q.PositiveLength
    feed_per_tooth: q.PositiveLength = 0.1e-3
    feed_direction: q.FeedDirection = 0.0
    maximum_depth: q.PositiveLength | None = None
    axes: Annotated[tuple[q.Axis, ...], q.NotEmpty] | None = None
    feed: q.Feed | None = None
    position: q.Length | None = None
    delay: Delay | None = None
    robust: q.Share = 0.1
    feed_forward: Annotated[float | None, BeforeValidator(_feed_forward)] = 0.0
    velocity_peak: Decibels = 3.0
    position_peak: Decibels = 0.0
    gain_margin: Decibels = None
    phase_margin: q.Angle | None = None
    velocity_bandwidth: q.PositiveFrequency | None = None
    position_bandwidth: q.PositiveFrequency | None = None
    tracking_error: q.PositiveLength | None = None
    move: MoveTable = MoveTable()
    measured: MeasuredTable | None = None
    seed: Annotated[StrictInt, Field(ge=0)] = 0
