"""`smfe plan`: from a tool, an estimate of the machine and its limits to the sweep that will identify it."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from process.labels import AXES
from process.types import Complex, Real
from process.units import show
from smfe.campaign.datasets import Show
from smfe.campaign.toml import table
from smfe.commands.identify import identify
from smfe.commands.simulate import simulate
from smfe.planning.errors import error_interval
from smfe.planning.forces import Level, Pass, SweepPlan, force_level
from smfe.planning.recommend import Plan, recommend, summary
from smfe.planning.task import Task, load_task
from smfe.progress import Progress, silent
from smfe.results import pack_warnings, read_groups, write_atomically, write_csv, write_groups

__all__ = ["Plan", "plan", "recommend", "summary"]


def plan(file: Path | str, out: Path | str, progress: Progress = silent, show: Show | None = None) -> Plan:
    """Plan a sweep and write the campaign to run, the passes, the prediction and its figures.

    Parameters
    ----------
    file : path
        Campaign file with ``[tool]``, ``[material]``, an estimate of the machine and, usually, ``[plan]``.
    out : path
        Folder for ``plan.toml``, ``plan.csv``, ``prediction.nc``, ``scenario.toml``, ``plan.html`` and ``figures/``.
    progress : callable, optional
        Called with (what, done, of).
    show : callable, optional
        Called with the licence of a public data set before it is fetched.

    Returns
    -------
    Plan
        What was written.

    Raises
    ------
    InputError
        When the file is wrong, or no sweep works within the limits; nothing is then written.
    """
    check_target(Path(file), Path(out))
    found = recommend(load_task(file, progress, show), progress)
    progress("writing", 0, 1)
    write_plan(found, Path(out))
    return found


# --- What a plan leaves in its folder: the campaign to run, the passes, the prediction, the scenario, the page.

WRITTEN = ("plan.toml", "plan.csv", "prediction.nc", "scenario.toml", "plan.html")

CHANNELS: dict[str, dict[str, str]] = {
    "time": {"column": "t", "unit": "s"},
    **{f"force_{a}": {"column": f"F{a}", "unit": "N"} for a in "xyz"},
    **{f"acceleration_{a}": {"column": f"a{a}", "unit": "m/s^2"} for a in "xyz"},
    "spindle_speed": {"column": "n", "unit": "rpm"},
}


def check_target(file: Path, out: Path) -> None:
    """Refuse a folder in which the plan would overwrite its own input.

    Raises
    ------
    InputError
        With the file.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file; name a folder")
    if file.resolve() in {(out / name).resolve() for name in WRITTEN}:
        raise InputError(f"the plan would overwrite its own input {file.name}; name another folder with -o")


def write_plan(found: Plan, out: Path) -> None:
    """Write everything; each file goes to a temporary name and is moved into place.

    Parameters
    ----------
    found : Plan
        The plan.
    out : Path
        Folder; made when missing.
    """
    from smfe.reporting.planning import write_page

    passes = passes_table(found)
    texts = {"plan.toml": campaign_text(found)}
    if found.task.estimate.machine is not None:
        texts["scenario.toml"] = scenario_text(found.task, found.sweep, seed=1)
    prediction = found.prediction.assign_attrs(frequency_range=list(found.task.limits.frequency_range))
    write_groups(out / "prediction.nc", {"sweep": pack_warnings(prediction, found.warnings)})
    write_csv(out / "plan.csv", passes)
    for name, text in texts.items():
        write_atomically(out / name, lambda path, text=text: path.write_text(text, encoding="utf-8"))  # type: ignore[misc]
    write_page(found, passes, out)
    # What an earlier plan left and this one does not write would be taken for its own.
    for name in {"scenario.toml", "verification.csv"} - set(texts):
        (out / name).unlink(missing_ok=True)


# --- tables ---------------------------------------------------------------------------------------------------------


def passes_table(found: Plan) -> pd.DataFrame:
    """Return the passes as the operator sets them, in field units, with the loads to be expected."""
    sweep, coefficients = found.sweep, found.task.coefficients
    slow, fast = (w * 30.0 / math.pi for w in (sweep.start, sweep.end))
    last = sweep.feed_rate / sweep.tooth_passing[1]
    limits = found.prediction["limit_depth"].values.min(axis=1)
    rows = []
    for number, (repeat, k, one) in enumerate(_records(sweep), 1):
        arc = one.arc(sweep.tool.diameter)
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


# --- the campaign to run --------------------------------------------------------------------------------------------


def campaign_text(found: Plan) -> str:
    """Return the campaign file that evaluates the records of the sweep."""
    task, sweep = found.task, found.sweep
    slow, fast = (w * 30.0 / math.pi for w in (sweep.start, sweep.end))
    head = (
        "# Planned sweep. Cut the passes of plan.csv, put their records where [[measurement]] names them, correct\n"
        "# [channels] to your recorder, then: smfe run plan.toml\n"
        f"# Each pass: spindle from {slow:.5g} to {fast:.5g} rpm in {sweep.duration:g} s, feed held at "
        f"{6e4 * sweep.feed_rate:.4g} mm/min.\n"
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


# --- the scenario that verifies it ----------------------------------------------------------------------------------


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


# --- Is the prediction right? Simulate the planned sweep, identify it, compare the errors entry by entry.


CONFIDENCE = 0.95
"""Probability with which all entries of a right prediction lie in their intervals."""

ESTIMATORS = {"local_polynomial": ("relative_error", ""), "bands": ("bands_relative_error", "bands_")}
"""Estimators that are compared: variable of the prediction, and what their columns begin with."""


@dataclass(frozen=True)
class Verification:
    """Measured errors beside predicted ones.

    Parameters
    ----------
    table : pandas.DataFrame
        entry, predicted_percent, measured_percent (root mean square over seeds) and ratio of the default estimator, the
        interval of the ratio (ratio_low, ratio_high), the same with ``bands_`` before it of narrow bands alone, and one
        column a seed of the default.
    condition_ratio : float
        Median over frequency of the condition number found over the one predicted, first seed.
    seeds : tuple of int
        Seeds of the sensor noise.
    """

    table: pd.DataFrame
    condition_ratio: float
    seeds: tuple[int, ...]

    @property
    def median_ratio(self) -> float:
        """Median over the entries of measured over predicted error."""
        return float(self.table["ratio"].median())

    @property
    def off(self) -> pd.DataFrame:
        """The entries whose ratio lies outside its interval, or is none, the farthest first."""
        ratio = self.table["ratio"].to_numpy()
        low, high = (self.table[f"ratio_{end}"].to_numpy() for end in ("low", "high"))
        far = np.maximum(ratio / high, low / ratio)
        far[~np.isfinite(far)] = np.inf
        order = np.argsort(-far, kind="stable")
        missed: pd.DataFrame = self.table.iloc[order[far[order] > 1.0]]
        return missed

    @property
    def confirmed(self) -> bool:
        """Whether each entry lies in its interval."""
        return self.off.empty


def verify(
    found: Plan, out: Path | str | None = None, seeds: tuple[int, ...] = (1, 2, 3), progress: Progress = silent
) -> Verification:
    """Simulate and identify the recommended sweep; compare the errors with those predicted.

    Parameters
    ----------
    found : Plan
        The plan.
    out : path, optional
        Folder for ``verification.csv``. The records are not kept: ``scenario.toml`` makes them again.
    seeds : tuple of int, optional
        Seeds of the sensor noise.
    progress : callable, optional
        Called with (what, done, of).

    Raises
    ------
    InputError
        When the machine cannot be simulated, or there is no seed.
    """
    if not seeds:
        raise InputError("no seed to verify with; give at least one")
    scale = _scale(found)
    errors: dict[str, list[Real]] = {name: [] for name in ESTIMATORS}
    condition = np.nan
    for done, seed in enumerate(seeds):
        progress("simulating and identifying the plan", done, len(seeds))
        compliances, truth = _identified(found, seed)
        if done == 0:
            seen = compliances["local_polynomial"]["force_condition"] / found.prediction["force_condition"]
            condition = float(np.median(seen))
        for name, compliance in compliances.items():
            difference = compliance["compliance"].transpose("frequency", "response", "excitation").values - truth
            errors[name].append(np.sqrt(np.nanmean(np.abs(difference) ** 2, axis=0)) / scale)
    table = pd.DataFrame({"entry": [r + e for r in AXES for e in AXES]})
    # Each of the nine at such a level that all hold together (Bonferroni).
    each = 1.0 - (1.0 - CONFIDENCE) / len(table)
    interval = error_interval(found.prediction["error_freedom"].values.ravel(), each, len(seeds))
    table["ratio_low"], table["ratio_high"] = interval
    for name, (variable, prefix) in ESTIMATORS.items():
        predicted = found.prediction[variable].values.ravel()
        measured = np.sqrt(np.mean(np.square(errors[name]), axis=0)).ravel()
        table[f"{prefix}predicted_percent"] = 100.0 * predicted
        table[f"{prefix}measured_percent"] = 100.0 * measured
        table[f"{prefix}ratio"] = measured / predicted
    for seed, error in zip(seeds, errors["local_polynomial"], strict=True):
        table[f"seed_{seed}_percent"] = 100.0 * error.ravel()
    if out is not None:
        write_csv(Path(out) / "verification.csv", table)
    return Verification(table, condition, tuple(seeds))


def explain(result: Verification) -> str:
    """Return the verification in words, a line each."""
    lines = [
        f"{row.entry}: expected {row.predicted_percent:.2g} %, found {row.measured_percent:.2g} % ({row.ratio:.2f}, "
        f"{row.ratio_low:.2f} to {row.ratio_high:.2f} is in the stated interval); "
        f"bands alone {row.bands_predicted_percent:.2g} %, {row.bands_measured_percent:.2g} % ({row.bands_ratio:.2f})"
        for row in result.table.itertuples()
    ]
    if result.confirmed:
        verdict = f"the prediction is confirmed: all {len(result.table)} entries lie in their intervals"
    else:
        missed = [
            f"{row.entry} {row.ratio:.2f} times the expected ({row.ratio_low:.2f} to {row.ratio_high:.2f})"
            for row in result.off.itertuples()
        ]
        verdict = f"the prediction is NOT confirmed: found was {', '.join(missed)}"
    seeds = ", ".join(map(str, result.seeds))
    tail = (
        f"{verdict}; median ratio {result.median_ratio:.2f}, condition number found over expected "
        f"{result.condition_ratio:.2f}, seeds {seeds}"
    )
    return "\n".join([*lines, tail])


def _scale(found: Plan) -> Real:
    return found.task.estimate.scale(found.task.frequency)


def _identified(found: Plan, seed: int) -> tuple[dict[str, xr.Dataset], Complex]:
    """Return what each estimator finds from simulated records, and the truth on its frequencies."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "scenario.toml").write_text(scenario_text(found.task, found.sweep, seed), encoding="utf-8")
        campaign = simulate(folder / "scenario.toml", folder / "out", workers=1, show=lambda text: None)
        text = campaign.read_text(encoding="utf-8")
        compliances = {}
        for estimator in ESTIMATORS:
            wanted = text.replace('method = "sweep"', f'method = "sweep"\nestimator = "{estimator}"')
            campaign.write_text(wanted, encoding="utf-8")
            compliances[estimator] = identify(campaign, folder / f"{estimator}.nc")["sweep"].compliance
        truth = read_groups(folder / "out" / "truth.nc")["sweep"]["compliance"]
        at = compliances["bands"]["frequency"].values
        exact = found.task.estimate.matrix(at)
        if found.task.estimate.machine is not None and "axis" in found.task.estimate.machine:
            exact = truth.interp(frequency=at).transpose("frequency", "response", "excitation").values
        # The force that acted, over its samples.
        return compliances, exact * np.sinc(at / found.task.limits.sample_rate)[:, None, None] ** 2
