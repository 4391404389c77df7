"""The sweep that keeps all limits and errs least, and what its prediction holds."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.compliance import ModalModel
from process.errors import InputError
from smfe.identification import Progress, silent
from smfe.plan_errors import expected, relative_error
from smfe.plan_forces import Forces, Pass, SweepPlan, force_level
from smfe.plan_limits import KEYS, no_plan, rejections
from smfe.plan_search import DEPTH_STEP, Search
from smfe.plan_task import Task
from smfe.sweep import REFUSE_CONDITION, WARN_CONDITION, check_independent
from stability import semi_discretization, zero_order

REFINED = 10
"""Alternatives that are worked through as the estimator will."""

CONFIRMED_SPEEDS = 5
"""Spindle speeds at which the limit depth of the recommended sweep is confirmed by semi-discretisation."""

DRAWN_DEPTHS = 9
"""Depths of cut at which the prediction holds the force level."""

THIN_CHIP = 10e-6
"""Chips thinner than this [m], about the radius of a sharp edge, are not cut as the coefficients say."""

DRAWN_SPEEDS = 101
"""Spindle speeds of the limit depths in the prediction."""


@dataclass(frozen=True)
class Plan:
    """A recommended sweep and why it is recommended.

    Parameters
    ----------
    task : Task
        What it was planned for.
    sweep : SweepPlan
        What to cut.
    prediction : xarray.Dataset
        `smfe.plan_errors.expected`, with ``relative_error(response, excitation)`` of the default estimator,
        ``bands_relative_error`` of ``estimator = "bands"``, ``force_spectrum(pass, axis, frequency)`` [N s],
        ``limit_depth(pass, spindle_speed)`` [mm], and ``peak_force`` and ``mean_force`` [N] over
        the depth of cut.
    alternatives : pandas.DataFrame
        The best of each kind, ranked, the recommended one first; ``note`` says why one that ranked better failed.
    rejected : pandas.DataFrame
        What each limit rejected (`smfe.plan_limits.rejections`).
    examined : int
        Number of alternatives looked at.
    warnings : tuple of str
        What the user must know.
    """

    task: Task
    sweep: SweepPlan
    prediction: xr.Dataset
    alternatives: pd.DataFrame
    rejected: pd.DataFrame
    examined: int
    warnings: tuple[str, ...] = ()

    @property
    def worst(self) -> float:
        """Largest expected error of the nine entries, as a fraction of the rms compliance."""
        return float(self.prediction["relative_error"].max())

    @property
    def median(self) -> float:
        """Median expected error of the nine entries."""
        return float(self.prediction["relative_error"].median())


def summary(found: Plan) -> str:
    """Return the plan in words, a line each."""
    sweep = found.sweep
    slow, fast = (w * 30.0 / math.pi for w in (sweep.start, sweep.end))
    passes = ", ".join(f"{p.cut} {1e3 * p.width:g} mm" for p in sweep.passes)
    times = "once each" if sweep.repeats == 1 else f"{sweep.repeats} times each"
    lines = [
        f"cut {passes}, {times}: {sweep.tool.teeth} inserts, {1e3 * sweep.depth:.3g} mm deep, spindle {slow:.5g} to "
        f"{fast:.5g} rpm in {sweep.duration:g} s, feed {6e4 * sweep.feed_rate:.4g} mm/min "
        f"({1e3 * sweep.feed_per_tooth:.3g} mm per tooth at the start), {1e3 * sweep.length_of_cut:.4g} mm long",
        f"expected error of the rms compliance: at most {100.0 * found.worst:.2g} %, "
        f"median {100.0 * found.median:.2g} % (narrow bands alone: at most "
        f"{100.0 * float(found.prediction['bands_relative_error'].max()):.2g} %)",
        f"{found.examined} alternatives looked at",
    ]
    for row in found.rejected.itertuples():
        lines.append(f"{row.limit} rejects {row.rejected} of them ({row.alone} alone); nearest: {row.needs}")
    return "\n".join(lines)


def recommend(task: Task, progress: Progress = silent) -> Plan:
    """Return the sweep that keeps all limits with the fewest repeats, and of these the one that errs least.

    What counts is the largest expected error of the nine entries.

    Parameters
    ----------
    task : Task
        The task.
    progress : callable, optional
        Called with (what, done, of).

    Raises
    ------
    InputError
        When no sweep works; the sentence says which limit would have to be lifted.
    """
    if task.limits.passes:
        diameter = task.tool.diameter
        arcs = [(p.cut, Pass(p.cut, p.width_of_cut).arc(diameter)) for p in task.limits.passes]
        try:
            check_independent(arcs)
        except InputError as error:
            raise InputError(f"{task.path.name}: plan.passes: {error}") from error
    search = Search(task)
    table = search.table(progress)
    choices = search.choices()
    fails = (table[list(KEYS)].to_numpy() > 1.0 + 1e-9).any(axis=1)
    if fails.all():
        raise InputError(no_plan(task, table))
    rows = _shortlist(table.iloc[np.flatnonzero(~fails)])
    refined = []
    for done, row in enumerate(rows.index):
        progress("working through the best alternatives", done, len(rows))
        refined.append(_refined(search, table, choices, row))
    # Of those that are good enough, the ones that are cut least often; of these, the best.
    ranked = sorted(refined, key=lambda r: (r.worst > task.limits.largest_error, r.sweep.repeats, r.worst))
    notes: dict[int, str] = {}
    for one in ranked:
        progress("confirming the chatter margin", 0, 1)
        if one.worst > task.limits.largest_error:
            notes[one.row] = "expected error too large once the bend of the resonances is in it"
            table.loc[one.row, "error"] = one.worst / task.limits.largest_error
            continue
        confirmed, note = _confirmed(search, one)
        if confirmed is not None:
            return _plan(task, table, ranked, notes, confirmed, note)
        notes[one.row] = note
        table.loc[one.row, "chatter"] = 2.0
    raise InputError(no_plan(task, table.loc[[r.row for r in ranked]]))


@dataclass(frozen=True)
class _Refined:
    """An alternative worked through: its row in the table, the sweep, the prediction and its errors."""

    row: int
    sweep: SweepPlan
    prediction: xr.Dataset
    worst: float
    median: float


def _shortlist(possible: pd.DataFrame) -> pd.DataFrame:
    """Return the best of each kind, the best first: kinds differ in inserts, speeds or feed per tooth."""
    kinds = possible.sort_values(["worst", "median"], kind="stable")
    best = kinds.drop_duplicates(["inserts", "start", "end", "feed_per_tooth"])
    return best.head(REFINED)


def _refined(search: Search, table: pd.DataFrame, choices: list[tuple[Pass, ...]], row: int) -> _Refined:
    task = search.task
    one: dict[str, Any] = {str(k): v for k, v in table.loc[[row]].to_dict("records")[0].items()}
    tool = next(t for t in search.tools if t.teeth == int(one["inserts"]))
    sweep = SweepPlan(
        tool,
        choices[int(one["passes"])],
        float(one["depth"]),
        float(one["feed_per_tooth"]),
        float(one["start"]),
        float(one["end"]),
        float(one["duration"]),
        1,
        task.limits.lead,
        task.limits.tail,
    )
    most = search.most_repeats(sweep, len(sweep.passes))
    found = _worked(search, row, sweep)
    while found.worst > task.limits.largest_error and found.sweep.repeats < most:
        # Noise falls with the root of the repeats, bend does not.
        wanted = math.ceil(found.sweep.repeats * min(4.0, (found.worst / task.limits.largest_error) ** 2))
        repeats = min(most, max(found.sweep.repeats + 1, wanted))
        found = _worked(search, row, replace(sweep, repeats=repeats))
    return found


def _worked(search: Search, row: int, sweep: SweepPlan) -> _Refined:
    task = search.task
    prediction = expected(sweep, task.coefficients, task.estimate, search.instruments, task.frequency)
    error = relative_error(prediction, search.scale)
    prediction["relative_error"] = (("response", "excitation"), error, {"units": "1"})
    of_bands = relative_error(prediction, search.scale, "bands_std")
    prediction["bands_relative_error"] = (("response", "excitation"), of_bands, {"units": "1"})
    return _Refined(row, sweep, prediction, float(error.max()), float(np.median(error)))


# --- chatter --------------------------------------------------------------------------------------------------------


def _confirmed(search: Search, one: _Refined) -> tuple[_Refined | None, str]:
    """Return the alternative at a depth that a converged method also finds safe, or the reason why there is none."""
    task = search.task
    if not isinstance(task.estimate.source, ModalModel):
        return one, "the limit depths are those of the zero-order method, which a measured compliance allows"
    try:
        smallest = min(_converged(task, one.sweep))
    except InputError as error:
        reason = str(error).split(";")[0].split(". ")[0]
        return one, f"the limit depths are those of the zero-order method; semi-discretisation cannot be had: {reason}"
    safe = task.limits.chatter_margin * smallest
    if one.sweep.depth <= safe * (1.0 + 1e-9):
        return one, ""
    depth = math.floor(safe / DEPTH_STEP) * DEPTH_STEP
    if depth < task.limits.depth_of_cut[0]:
        return None, f"semi-discretisation finds only {1e3 * smallest:.3g} mm stable, {1e3 * safe:.3g} mm with margin"
    shallow = _worked(search, one.row, replace(one.sweep, depth=depth))
    if shallow.worst > task.limits.largest_error:
        return None, f"at the {1e3 * depth:.3g} mm that semi-discretisation finds safe its error is too large"
    return shallow, ""


def _converged(task: Task, sweep: SweepPlan) -> Iterator[float]:
    """Yield the smallest converged limit [m] of each kind of pass over a few speeds of the sweep."""
    speeds = np.linspace(sweep.start, sweep.end, CONFIRMED_SPEEDS) * 30.0 / math.pi
    assert isinstance(task.estimate.source, ModalModel)
    for one in dict.fromkeys(sweep.passes):
        arc = one.arc(sweep.tool.diameter)
        found = semi_discretization(task.estimate.source, sweep.tool, arc, task.coefficients, speeds, tolerance=1e-2)
        yield 1e-3 * float(found["limit_depth"].min())


# --- the result -----------------------------------------------------------------------------------------------------


def _plan(
    task: Task, table: pd.DataFrame, ranked: list[_Refined], notes: dict[int, str], chosen: _Refined, note: str
) -> Plan:
    others = [r for r in ranked if r.row != chosen.row]
    frame = pd.DataFrame([_row(task, r, notes.get(r.row, "")) for r in [chosen, *others]])
    warnings = [
        *task.estimate.warnings,
        *([note] if note else []),
        *_condition_warning(chosen),
        *thin_chips(chosen.sweep),
    ]
    return Plan(
        task,
        chosen.sweep,
        _completed(task, chosen),
        frame,
        rejections(task, table),
        len(table),
        tuple(warnings),
    )


def _row(task: Task, one: _Refined, note: str) -> dict[str, object]:
    s = one.sweep
    return {
        "inserts": s.tool.teeth,
        "from_rpm": s.start * 30.0 / math.pi,
        "to_rpm": s.end * 30.0 / math.pi,
        "feed_per_tooth_mm": 1e3 * s.feed_per_tooth,
        "depth_of_cut_mm": 1e3 * s.depth,
        "passes": ", ".join(f"{p.cut} {1e3 * p.width:g}" for p in s.passes),
        "duration_s": s.duration,
        "repeats": s.repeats,
        "worst_error_percent": 100.0 * one.worst,
        "median_error_percent": 100.0 * one.median,
        "largest_condition": float(one.prediction["force_condition"].max()),
        "note": note,
    }


def thin_chips(sweep: SweepPlan) -> list[str]:
    """Say where the thickest chip at the end of the sweep, ``f_z sin(phi) sin(kappa)``, is thinner than `THIN_CHIP`."""
    feed = sweep.feed_rate / sweep.tooth_passing[1]
    thin = []
    for cut in dict.fromkeys(sweep.passes):
        arc = cut.arc(sweep.tool.diameter)
        phi = min(max(0.5 * math.pi, arc.entry), arc.exit)
        chip = feed * math.sin(phi) * math.sin(sweep.tool.approach_angle)
        if chip < THIN_CHIP:
            thin.append(f"{cut.cut} {1e3 * cut.width:g} mm ({1e6 * chip:.2g} um)")
    if not thin:
        return []
    return [
        f"chips are thinner than {1e6 * THIN_CHIP:g} um in {', '.join(thin)}: an edge rubs there, and coefficients of "
        "thicker chips do not give its force; cut wider or with more feed, or measure the force of one such pass first"
    ]


def _condition_warning(one: _Refined) -> list[str]:
    condition = one.prediction["force_condition"].values
    if condition.max() <= WARN_CONDITION:
        return []
    share = f"{100.0 * float(np.mean(condition > WARN_CONDITION)):.0f}"
    lost = int(np.sum(condition > REFUSE_CONDITION))
    more = f", and exceeds {REFUSE_CONDITION:g} at {lost} frequencies, which will stay empty" if lost else ""
    return [f"the condition number of the forces exceeds {WARN_CONDITION:g} in {share} % of the band{more}"]


def _completed(task: Task, one: _Refined) -> xr.Dataset:
    """Add force spectra and limit depths to the prediction."""
    sweep, out = one.sweep, one.prediction.copy()
    labels = [f"{p.cut} {1e3 * p.width:g} mm" for p in sweep.passes]
    energy = np.array(Forces(sweep, task.coefficients, task.frequency[-1] + 1.0).energy(task.frequency))
    spectrum = np.sqrt(np.diagonal(energy, axis1=2, axis2=3).real).transpose(0, 2, 1)
    speeds = np.linspace(sweep.start, sweep.end, DRAWN_SPEEDS) * 30.0 / math.pi
    limits = [
        zero_order(task.estimate.source, sweep.tool, p.arc(sweep.tool.diameter), task.coefficients, speeds)
        for p in sweep.passes
    ]
    out = out.assign_coords({"pass": labels, "axis": list("xyz"), "spindle_speed": ("spindle_speed", speeds)})
    out["force_spectrum"] = (("pass", "axis", "frequency"), spectrum, {"units": "N s"})
    out["limit_depth"] = (
        ("pass", "spindle_speed"),
        np.array([found["limit_depth"].values for found in limits]),
        {"units": "mm"},
    )
    out["spindle_speed"].attrs["units"] = "rpm"
    out = xr.merge([out, _levels(task, sweep, labels)], combine_attrs="override")
    return out.assign_attrs(
        estimate=task.estimate.name,
        depth_of_cut_mm=1e3 * sweep.depth,
        duration_s=sweep.duration,
        repeats=sweep.repeats,
        inserts=sweep.tool.teeth,
    )


def _levels(task: Task, sweep: SweepPlan, labels: list[str]) -> xr.Dataset:
    """Return the force level of each pass over the depths that are asked for, at the start of the sweep."""
    depths = np.unique([*np.linspace(*task.limits.depth_of_cut, DRAWN_DEPTHS), sweep.depth])
    rows = [
        [
            force_level(sweep.tool, p.arc(sweep.tool.diameter), task.coefficients, float(a), sweep.feed_per_tooth)
            for a in depths
        ]
        for p in sweep.passes
    ]
    peak = np.array([[level.peak for level in row] for row in rows])
    mean = np.array([[level.mean for level in row] for row in rows]).transpose(0, 2, 1)
    return xr.Dataset(
        {
            "peak_force": (("pass", "depth_of_cut"), peak, {"units": "N"}),
            "mean_force": (("pass", "axis", "depth_of_cut"), mean, {"units": "N"}),
        },
        coords={
            "pass": labels,
            "axis": list("xyz"),
            "depth_of_cut": ("depth_of_cut", 1e3 * depths, {"units": "mm"}),
        },
    )
