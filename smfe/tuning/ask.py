"""From ``[tune]`` of a campaign, and machines in memory, to the task of a search for gains."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr

from process.cut.engagement import engagement
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import Viscous
from process.machine.machine import FeedAxis, Machine
from process.machine.modes import ModalModel
from smfe.campaign import Campaign
from smfe.campaign.tune import MeasuredTable, TuneTable
from smfe.identification.drive.open_loop import open_loop_response
from smfe.identification.measurement import identify_measurement, records_of
from smfe.progress import Progress, silent
from smfe.tuning.plants import MeasuredSource, ModelSource, Source
from smfe.tuning.task import Goal, Limits, Task
from smfe.tuning.tracking import Move


@dataclass(frozen=True)
class Measured:
    """Axes that are known by measurements, with the controllers that they have now.

    Parameters
    ----------
    source : MeasuredSource
        Compliance at rest, open loops, masses, dead times.
    controllers : mapping
        Axis -> controllers by name.
    """

    source: MeasuredSource
    controllers: Mapping[str, Mapping[str, Servo]] = field(default_factory=dict)


def task_of(campaign: Campaign, given: Machine | Measured | None = None, progress: Progress = silent) -> Task:
    """Return the task of a campaign.

    Parameters
    ----------
    campaign : Campaign
        With ``[tool]``, ``[material]``, ``[tune]`` and a machine.
    given : Machine or Measured, optional
        Instead of the machine of the campaign.
    progress : callable, optional
        Called with (what, done, of).

    Raises
    ------
    InputError
        When something needed is missing: a goal, speeds, a machine with axes, masses.
    """
    table, tool, material = campaign.tune, campaign.tool, campaign.coefficients
    if table is None or tool is None or material is None:
        missing = [n for n, v in (("[tune]", table), ("[tool]", tool), ("[material]", material)) if v is None]
        raise InputError(f"{campaign.path.name}: a search for gains needs {' and '.join(missing)}; add it")
    where = campaign.path.name
    if table.goal is None or table.spindle_speed is None:
        raise InputError(
            f"{where}: [tune] has no {'goal' if table.goal is None else 'spindle_speed'}; say what the gains are for, "
            'e.g. goal = "least_depth" (or "removal_rate", "depths") with spindle_speed = ["800 rpm", "2500 rpm"]'
        )
    speeds = table.spindle_speed.values
    _check_spindle(campaign, speeds)
    source, present = _source(campaign, table, given, progress)
    if table.goal != "depths":
        speeds = (speeds[0], speeds[-1])
        if speeds[0] == speeds[1]:
            raise InputError(f"{where}: {table.goal} needs a range of speeds; write spindle_speed = [lowest, highest]")
    elif not table.spindle_speed.listed:
        raise InputError(f"{where}: depths needs the speeds themselves; write spindle_speed = {{ speeds = [...] }}")
    return Task(
        source,
        tool,
        engagement(table.cut, table.width_of_cut, tool.diameter),
        material,
        Goal(table.goal, tuple(speeds), _deepest(campaign, table)),
        limits_of(table),
        Move(table.move.kind, table.move.feed, table.move.radius),
        table.feed_forward,
        table.robust,
        present,
        table.width_of_cut,
        table.feed_per_tooth,
        table.feed_direction,
        table.seed,
    )


def _deepest(campaign: Campaign, table: TuneTable) -> float:
    """Return the depth that is allowed at most [m], by the task or the length of the cutting edges."""
    known = [] if table.maximum_depth is None else [table.maximum_depth]
    edge = campaign.machine_limits.edge_length
    if edge is not None and campaign.tool is not None:
        known.append(edge * math.sin(campaign.tool.approach_angle))
    return min(known, default=math.inf)


def _check_spindle(campaign: Campaign, speeds: Sequence[float]) -> None:
    low, high = campaign.spindle.minimum, campaign.spindle.maximum
    beyond = [f"{v:g}" for v in speeds if not low <= v <= high]
    if beyond:
        most = f"to {high:g} rpm" if math.isfinite(high) else "rpm and more"
        raise InputError(
            f"{campaign.path.name}: [tune] asks for {', '.join(beyond)} rpm, which the [spindle] cannot turn: it has "
            f"{low:g} {most}; give spindle_speed within that"
        )


def limits_of(table: TuneTable) -> Limits:
    """Return the limits of ``[tune]``."""
    phase = None if table.phase_margin is None else float(np.degrees(table.phase_margin))
    return Limits(
        table.velocity_peak,
        table.position_peak,
        table.gain_margin,
        phase,
        table.velocity_bandwidth,
        table.position_bandwidth,
        table.tracking_error,
    )


def _source(
    campaign: Campaign, table: TuneTable, given: Machine | Measured | None, progress: Progress
) -> tuple[Source, dict[str, tuple[Servo, ...]]]:
    if given is None and table.measured is not None:
        given = _measured(campaign, table.measured, progress)
    if isinstance(given, Measured):
        axes = given.source.axes
        return given.source, _by_name(axes, [given.controllers.get(a, {}) for a in axes])
    machine = campaign.machine_model if given is None else given
    if not isinstance(machine, Machine) or not machine.axes:
        what = "modes alone, without axes" if isinstance(machine, ModalModel) else "no machine with axes"
        raise InputError(
            f"{campaign.path.name}: there is {what}, and nothing to tune; add [machine.axis.x] with its masses (as in "
            "a scenario), or [tune.measured] with a compliance at rest and open loops"
        )
    return _model(campaign.path.name, machine, table)


def _model(where: str, machine: Machine, table: TuneTable) -> tuple[ModelSource, dict[str, tuple[Servo, ...]]]:
    held = [a for a, axis in machine.axes.items() if axis.servo is not None]
    axes = tuple(table.axes or held or machine.axes)
    unknown = [a for a in axes if a not in machine.axes]
    if unknown:
        raise InputError(f"{where}: axis {', '.join(unknown)} is none of the machine's, {', '.join(machine.axes)}")
    if len(set(axes)) < len(axes):
        raise InputError(f"{where}: [tune] names axes {', '.join(axes)}; name each axis once")
    dry = [a for a, axis in machine.axes.items() if not isinstance(axis.friction, Viscous)]
    if dry and table.feed is None:
        raise InputError(
            f"{where}: the friction of axis {', '.join(dry)} depends on speed; say at which feed it moves in the cut, "
            'e.g. feed = { x = "500 mm/min" }'
        )
    sets = [_controllers(machine.axes[a].servo) for a in axes]
    delays = []
    for axis, one in zip(axes, sets, strict=True):
        found = {v.delay for v in one.values()}
        if table.delay is None and len(found) > 1:
            raise InputError(f"{where}: the controllers of axis {axis} have different dead times; give delay in [tune]")
        delays.append(table.delay if table.delay is not None else next(iter(found), 0.0))
    feed = {} if table.feed is None else {a: v for a, v in table.feed.items() if a in machine.axes}
    others = {a: axis for a, axis in machine.axes.items() if a not in axes}
    for name, other in others.items():
        if len(_controllers(other.servo)) > 1:
            raise InputError(f"{where}: axis {name} is not tuned and has several controllers; leave it one")
    bare = Machine(machine.structure, _bare(machine, axes), machine.joints)
    return ModelSource(bare.at(feed, None, table.position), axes, tuple(delays)), _by_name(axes, sets)


def _bare(machine: Machine, axes: Sequence[str]) -> dict[str, FeedAxis]:
    return {
        a: replace(axis, servo=None if a in axes else next(iter(_controllers(axis.servo).values()), None))
        for a, axis in machine.axes.items()
    }


def _controllers(servo: Servo | Mapping[str, Servo] | None) -> dict[str, Servo]:
    if servo is None:
        return {}
    return dict(servo) if isinstance(servo, Mapping) else {"present": servo}


def _by_name(axes: Sequence[str], sets: Sequence[Mapping[str, Servo]]) -> dict[str, tuple[Servo, ...]]:
    """Return the controllers that all axes have, by name."""
    names = [n for n in (sets[0] if sets else {}) if all(n in one for one in sets)]
    return {n: tuple(one[n] for one in sets) for n in names}


def _measured(campaign: Campaign, table: MeasuredTable, progress: Progress) -> Measured:
    where, by_name = campaign.path.name, {m.name: m for m in campaign.measurements}
    lacking = [a for a, axis in table.axis.items() if axis.moving_mass is None]
    if table.tip_mass is None or lacking:
        what = ["tip_mass"] * (table.tip_mass is None) + [f"moving_mass of axis {a}" for a in lacking]
        raise InputError(
            f"{where}: [tune.measured] lacks {' and '.join(what)}; from measured responses the masses are needed: "
            "weigh them, or take them from the fit of the open loop (fit_open_loop)"
        )
    at_rest = by_name.get(table.at_rest)
    if at_rest is None:
        raise InputError(f"{where}: '{table.at_rest}' is no measurement of a compliance at rest")
    loops = {}
    for axis, one in table.axis.items():
        record = by_name.get(one.open_loop)
        if record is None or record.method not in ("open_loop", "drive"):
            raise InputError(
                f"{where}: the open loop of axis {axis} is '{one.open_loop}', which is no measurement with method "
                '= "open_loop", or "drive" and a periodic drive force; name one'
            )
        records = [r for entry in record.records for r in records_of(entry)]
        loops[axis] = open_loop_response(records[0], axis, one.period)
    found = identify_measurement(campaign, at_rest, progress).compliance
    source = MeasuredSource(
        _plain(found),
        loops,
        {a: one.moving_mass or 0.0 for a, one in table.axis.items()},
        table.tip_mass or 0.0,
        {a: one.dead_time for a, one in table.axis.items()},
    )
    controllers = {a: {n: s.build() for n, s in one.controllers.items()} for a, one in table.axis.items()}
    return Measured(source, controllers)


def _plain(found: xr.Dataset) -> xr.Dataset:
    """Return a compliance without frequency 0."""
    return found.sel(frequency=found["frequency"] > 0.0)
