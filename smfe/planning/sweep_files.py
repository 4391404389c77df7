"""A planned sweep as files: table of passes, campaign that evaluates their records, scenario that simulates them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from process.errors import InputError
from process.units import show
from smfe.campaign.toml import table
from smfe.planning.forces import Level, Pass, SweepPlan, force_level
from smfe.planning.recommend import Plan
from smfe.planning.task import Task

CHANNELS: dict[str, dict[str, str]] = {
    "time": {"column": "t", "unit": "s"},
    **{f"force_{a}": {"column": f"F{a}", "unit": "N"} for a in "xyz"},
    **{f"acceleration_{a}": {"column": f"a{a}", "unit": "m/s^2"} for a in "xyz"},
    "spindle_speed": {"column": "n", "unit": "rpm"},
}
"""Columns of a record, to be corrected to the recorder."""


def passes_table(found: Plan) -> pd.DataFrame:
    """Return the passes as the operator sets them, in field units, with the loads to be expected."""
    sweep, coefficients = found.sweep, found.task.coefficients
    slow, fast = (w * 30.0 / math.pi for w in (sweep.start, sweep.end))
    last = sweep.feed_rate / sweep.tooth_passing[1]
    limits = found.prediction["limit_depth"].values.min(axis=1)
    rows = []
    for number, (repeat, k, one) in enumerate(_records(sweep), 1):
        arc = one.engagement(sweep.tool.diameter)
        levels = [force_level(sweep.tool, arc, coefficients, sweep.depth, f) for f in (sweep.feed_per_tooth, last)]
        rows.append(
            {
                "pass": number,
                "repeat": repeat,
                "cut": one.cut,
                "width_of_cut_mm": 1e3 * one.width,
                "depth_of_cut_mm": 1e3 * sweep.depth,
                "inserts": sweep.tool.teeth,
                "spindle_from_rpm": slow,
                "spindle_to_rpm": fast,
                "spindle_acceleration_rpm_s": (fast - slow) / sweep.duration,
                "duration_s": sweep.duration,
                "feed_mm_min": 6e4 * sweep.feed_rate,
                "feed_per_tooth_from_mm": 1e3 * sweep.feed_per_tooth,
                "feed_per_tooth_to_mm": 1e3 * last,
                "length_of_cut_mm": 1e3 * sweep.length_of_cut,
                "entry_mm": 1e3 * one.entry_length(sweep.tool.diameter),
                "stock_mm": 1e3 * sweep.stock,
                "travel_mm": 1e3 * sweep.travel,
                **_loads(levels, sweep),
                "smallest_limit_depth_mm": limits[k],
                "file": file_name(one, number),
            }
        )
    return pd.DataFrame(rows).round(6)


def _records(sweep: SweepPlan) -> list[tuple[int, int, Pass]]:
    """Return repeat, number among the passes, and pass of every record, in the order of cutting."""
    return [(r, k, one) for r in range(1, sweep.repeats + 1) for k, one in enumerate(sweep.passes)]


def _loads(levels: list[Level], sweep: SweepPlan) -> dict[str, float]:
    mean = np.array([level.mean for level in levels])
    largest = mean[np.abs(mean).argmax(axis=0), range(3)]
    return {
        **{f"mean_force_{a}_N": float(v) for a, v in zip("xyz", largest, strict=True)},
        "peak_force_N": max(level.peak for level in levels),
        "peak_torque_Nm": max(level.peak_torque for level in levels),
        "power_kW": 1e-3 * max(levels[0].torque * sweep.start, levels[1].torque * sweep.end),
    }


def file_name(one: Pass, number: int) -> str:
    """Return the record of a pass, relative to the campaign file."""
    return f"records/sweep_{one.cut}_{number}.csv"


def campaign_text(found: Plan) -> str:
    """Return the campaign file that evaluates the records of the sweep."""
    task, sweep = found.task, found.sweep
    slow, fast = (w * 30.0 / math.pi for w in (sweep.start, sweep.end))
    head = (
        "# Planned sweep. Cut the passes of plan.csv, put their records where [[measurement]] names them, correct\n"
        "# [channels] to your recorder, then: smfe run plan.toml\n"
        f"# Each pass: enter at {slow:.5g} rpm; at full width spindle from {slow:.5g} to {fast:.5g} rpm in "
        f"{sweep.duration:g} s; leave. Feed held at {6e4 * sweep.feed_rate:.4g} mm/min. plan.html has the steps.\n"
        "# Record from air to air, with the free decay after the cut. Forces act on the tool: a dynamometer under the\n"
        "# work needs sign = -1 in its channels.\n"
    )
    low, high = task.limits.frequency_range
    measurement: dict[str, Any] = {
        "name": "sweep",
        "method": "sweep",
        "depth_of_cut": show(sweep.depth, "mm", "length"),
        "feed_per_tooth": show(sweep.feed_per_tooth, "mm", "length"),
        "frequency_range": [show(low, "Hz", "frequency"), show(high, "Hz", "frequency")],
        "records": [
            {"file": file_name(one, number), "cut": one.cut, "width_of_cut": show(one.width, "mm", "length")}
            for number, (_, _, one) in enumerate(_records(sweep), 1)
        ],
    }
    parts = [
        head,
        table("[campaign]", {"name": f"{task.name}: sweep"}),
        table("[tool]", _tool(task, sweep)),
        table("[material]", task.raw["material"]),
        table("[channels]", CHANNELS),
        *(table("[[model]]", model) for model in task.raw.get("model", ())),
        table("[[measurement]]", measurement),
    ]
    return "\n".join(parts)


def _tool(task: Task, sweep: SweepPlan) -> Mapping[str, Any]:
    kept = {key: value for key, value in task.raw["tool"].items() if key not in ("pitch_angles", "runout")}
    return {**kept, "teeth": sweep.tool.teeth}


def scenario_text(task: Task, sweep: SweepPlan, seed: int) -> str:
    """Return the scenario file that simulates the sweep on the estimate of the machine.

    Raises
    ------
    InputError
        When the estimate is a measured compliance, which cannot be simulated.
    """
    machine = task.estimate.machine
    if machine is None:
        raise InputError(
            f"the estimate '{task.estimate.name}' is a measured compliance, which cannot be simulated; describe the "
            "machine by a [[model]] or a scenario to verify the plan"
        )
    limits = task.limits
    low, high = limits.frequency_range
    trial: dict[str, Any] = {
        "method": "sweep",
        **({"controller": limits.controller} if limits.controller else {}),
        "depth_of_cut": show(sweep.depth, "mm", "length"),
        "feed_per_tooth": show(sweep.feed_per_tooth, "mm", "length", digits=9),
        "spindle_speed": [show(w, "rpm", "rotation", digits=9) for w in (sweep.start, sweep.end)],
        "rate": show(sweep.acceleration, "rad/s^2", "rotation_rate", digits=9),
        "lead": show(sweep.lead, "s", "time"),
        "tail": show(sweep.tail, "s", "time"),
        "frequency_range": [show(low, "Hz", "frequency"), show(high, "Hz", "frequency")],
        "passes": [{"cut": one.cut, "width_of_cut": show(one.width, "mm", "length")} for _, _, one in _records(sweep)],
    }
    accelerometer = {"noise": [show(n, "m/s^2", "acceleration") for n in limits.acceleration_noise]}
    dynamometer = {"noise": [show(n, "N", "force") for n in limits.force_noise]}
    rate = show(limits.sample_rate, "Hz", "frequency")
    parts = [
        "# The planned sweep on the machine that it was planned for: smfe simulate scenario.toml\n",
        table("[scenario]", {"name": f"{task.name}: sweep", "seed": seed, "sample_rate": rate}),
        table("[machine]", machine),
        table("[tool]", _tool(task, sweep)),
        table("[material]", task.raw["material"]),
        table("[sensors]", {"accelerometer": accelerometer, "dynamometer": dynamometer}),
        table("[[trial]]", trial),
    ]
    return "\n".join(parts)
