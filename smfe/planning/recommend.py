"""The sweep that keeps all limits and errs least, and what its prediction holds."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from process.machine.modes import ModalModel
from process.notebook import html_table
from process.types import Real
from smfe.identification.sweep.rules import RULES as SWEEP_RULES
from smfe.identification.sweep.sweep import check_independent
from smfe.planning.errors import error_interval, expected, relative_error
from smfe.planning.forces import Forces, Pass, SweepPlan, force_level
from smfe.planning.limits import KEYS, no_plan, rejections
from smfe.planning.rules import RULES
from smfe.planning.search import Search
from smfe.planning.task import Task
from smfe.progress import Progress, part, silent
from stability import multi_frequency, semi_discretization, zero_order


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
        `smfe.planning.errors.expected`, with ``relative_error(response, excitation)`` of the default estimator, between
        ``relative_error_low`` and ``relative_error_high`` with a probability of 95 %,
        ``bands_relative_error`` of ``estimator = "bands"``, ``force_spectrum(pass, axis, frequency)`` [N s],
        ``limit_depth(pass, spindle_speed)`` [mm], and ``peak_force`` and ``mean_force`` [N] over
        the depth of cut.
    alternatives : pandas.DataFrame
        The best of each kind, ranked, the recommended one first; ``note`` says why one that ranked better failed.
    rejected : pandas.DataFrame
        What each limit rejected (`smfe.planning.limits.rejections`).
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

    def _repr_html_(self) -> str:
        """Return a table for a notebook: what to cut, how well it will do, and what else `summary` says."""
        cut = self.sweep
        slow, fast = (w * 30.0 / math.pi for w in (cut.start, cut.end))
        rows = [
            ("passes", ", ".join(f"{p.cut} {1e3 * p.width:g}" for p in cut.passes), "mm wide"),
            ("each pass", str(cut.repeats), "times"),
            ("spindle speed", f"{slow:.5g} to {fast:.5g}", "rpm"),
            ("depth of cut", f"{1e3 * cut.depth:.3g}", "mm"),
            ("feed", f"{6e4 * cut.feed_rate:.4g}", "mm/min"),
            ("largest expected error", f"{100.0 * self.worst:.2g}", "% of the rms compliance"),
        ]
        return html_table("Planned sweep", rows, ("", "value", "unit"), [summary(self), *self.warnings])

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
    at = int(found.prediction["relative_error"].values.argmax())
    low, high = (found.prediction[f"relative_error_{end}"].values.ravel()[at] for end in ("low", "high"))
    lines = [
        f"cut {passes}, {times}: {sweep.tool.teeth} inserts, {1e3 * sweep.depth:.3g} mm deep, spindle {slow:.5g} to "
        f"{fast:.5g} rpm in {sweep.duration:g} s, feed {6e4 * sweep.feed_rate:.4g} mm/min "
        f"({1e3 * sweep.feed_per_tooth:.3g} mm per tooth at the start), {1e3 * sweep.length_of_cut:.4g} mm long at "
        f"full width, and {1e3 * sweep.entry:.3g} mm to enter",
        f"expected error of the rms compliance: at most {100.0 * found.worst:.2g} %, "
        f"median {100.0 * found.median:.2g} % (95 % of sweeps: worst entry {100.0 * low:.2g} to {100.0 * high:.2g} %; "
        "narrow bands alone: at most "
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
        arcs = [(p.cut, Pass(p.cut, p.width_of_cut).engagement(diameter)) for p in task.limits.passes]
        try:
            check_independent(arcs)
        except InputError as error:
            raise InputError(f"{task.path.name}: plan.passes: {error}") from error
    search = Search(task)
    table = search.table(part(progress, 0.0, 0.3))
    choices = search.choices()
    possible = table[(table[list(KEYS)] <= 1.0 + 1e-9).all(axis=1)]
    if possible.empty:
        raise InputError(no_plan(task, table))
    refined: list[_Refined] = []
    steps = part(progress, 0.3, 0.9)
    kinds = _kinds(possible)
    for done, row in enumerate(kinds.index):
        if done >= RULES.refined and any(one.good for one in refined):
            break
        steps("working through the best alternatives", min(done, RULES.refined - 1), RULES.refined)
        one = _refined(search, table, choices, row)
        refined.append(one)
        table.loc[row, list(one.needs)] = list(one.needs.values())
    progress("confirming the limit depths", 9, 10)
    ranked = sorted(refined, key=_rank)
    while ranked[0].good and not ranked[0].converged:
        # Of a measured compliance only for what is to be recommended: a converged limit takes seconds.
        ranked[0] = _confirmed(search, ranked[0])
        table.loc[ranked[0].row, list(ranked[0].needs)] = list(ranked[0].needs.values())
        ranked.sort(key=_rank)
    if not ranked[0].good:
        raise InputError(no_plan(task, table.loc[[r.row for r in ranked]]))
    return _plan(task, table, ranked)


@dataclass(frozen=True)
class _Limits:
    """Limit depths [m] over spindle speeds [rpm], shape (passes, speeds), and whether they are converged."""

    speed: Real
    depth: Real
    converged: bool
    note: str = ""


@dataclass(frozen=True)
class _Refined:
    """An alternative worked through: its row in the table, the sweep, the prediction, limit depths, and its needs."""

    row: int
    sweep: SweepPlan
    prediction: xr.Dataset
    limits: _Limits
    needs: dict[str, float]
    deepest: float

    @property
    def worst(self) -> float:
        """Largest expected error."""
        return float(self.prediction["relative_error"].max())

    @property
    def median(self) -> float:
        """Median expected error."""
        return float(self.prediction["relative_error"].median())

    @property
    def good(self) -> bool:
        """Whether it keeps what is asked."""
        return max(self.needs.values()) <= 1.0 + 1e-9

    @property
    def converged(self) -> bool:
        """Whether its limit depths are those of a converged method, or that was tried."""
        return self.limits.converged or bool(self.limits.note)

    @property
    def note(self) -> str:
        """What is wrong with it."""
        said = {
            "chatter": f"only {1e3 * float(self.limits.depth.min()):.3g} mm are stable",
            "noise": "the noise of the forces leaves frequencies unsolved",
            "error": "expected error too large",
        }
        return "; ".join(said[key] for key, ratio in self.needs.items() if ratio > 1.0 + 1e-9)


def _rank(one: _Refined) -> tuple[bool, int, float]:
    """Of those that are good enough come first the ones that are cut least often; of these, the best."""
    return not one.good, one.sweep.repeats, one.worst


def _kinds(possible: pd.DataFrame) -> pd.DataFrame:
    """Return the best of each kind, the best first: kinds differ in inserts, speeds or feed per tooth.

    What the zero-order method finds unstable comes last.
    """
    kinds = possible.sort_values(["unstable", "worst", "median"], kind="stable")
    return kinds.drop_duplicates(["inserts", "start", "end", "feed_per_tooth"]).head(RULES.most_refined)


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
    modal = isinstance(task.estimate.source, ModalModel)
    return _at_depth(search, row, sweep, _converged(task, sweep) if modal else _zero_order(task, sweep), one["deepest"])


def _at_depth(search: Search, row: int, sweep: SweepPlan, limits: _Limits, deepest: float) -> _Refined:
    """Work a sweep through at the greatest depth that is safe, with as many repeats as its error needs."""
    asked = search.task.limits
    least = asked.depth_of_cut[0]
    safe = asked.chatter_margin * float(limits.depth.min())
    depth = math.floor(min(deepest, safe) / RULES.depth_step * (1.0 + 1e-9)) * RULES.depth_step
    sweep = replace(sweep, depth=min(max(depth, least), asked.depth_of_cut[1]), repeats=1)
    most = search.most_repeats(sweep, len(sweep.passes))
    prediction = _worked(search, sweep)
    error = float(prediction["relative_error"].max()) / asked.largest_error
    while error > 1.0 and sweep.repeats < most:
        # Noise falls with the root of the repeats, bend does not.
        wanted = math.ceil(sweep.repeats * min(4.0, error**2))
        sweep = replace(sweep, repeats=min(most, max(sweep.repeats + 1, wanted)))
        prediction = _worked(search, sweep)
        error = float(prediction["relative_error"].max()) / asked.largest_error
    noise = float(prediction.attrs["force_noise_ratio"])
    needs = {"chatter": least / max(safe, 1e-12), "noise": noise if noise > 1.0 else 0.0, "error": error}
    return _Refined(row, sweep, prediction, limits, needs, deepest)


def _worked(search: Search, sweep: SweepPlan) -> xr.Dataset:
    task = search.task
    prediction = expected(sweep, task.coefficients, task.estimate, search.instruments, task.frequency)
    error = relative_error(prediction, search.scale)
    prediction["relative_error"] = (("response", "excitation"), error, {"units": "1"})
    of_bands = relative_error(prediction, search.scale, "bands_std")
    prediction["bands_relative_error"] = (("response", "excitation"), of_bands, {"units": "1"})
    low, high = error_interval(prediction["error_freedom"].values, RULES.confidence)
    for name, factor in (("relative_error_low", low), ("relative_error_high", high)):
        prediction[name] = (("response", "excitation"), factor * error, {"units": "1"})
    return prediction


# --- chatter --------------------------------------------------------------------------------------------------------


def _limits(task: Task, sweep: SweepPlan, method: Callable[..., xr.Dataset], count: int, **settings: float) -> _Limits:
    """Return the limit depths of all passes over the speeds of a sweep; passes that are alike are asked once."""
    speeds = np.linspace(sweep.start, sweep.end, count) * 30.0 / math.pi
    known = {}
    for one in dict.fromkeys(sweep.passes):
        cut = one.engagement(sweep.tool.diameter)
        found = method(task.estimate.source, sweep.tool, cut, task.coefficients, speeds, **settings)
        known[one] = 1e-3 * found["limit_depth"].values
    return _Limits(speeds, np.array([known[one] for one in sweep.passes]), method is not zero_order)


def _zero_order(task: Task, sweep: SweepPlan, note: str = "") -> _Limits:
    return replace(_limits(task, sweep, zero_order, RULES.modal_limit_speeds), note=note)


def _converged(task: Task, sweep: SweepPlan) -> _Limits:
    """Return the limit depths by semi-discretisation of modes, by multi-frequency of a compliance that was measured.

    Where neither can be had, those of the zero-order method, and why.
    """
    modal = isinstance(task.estimate.source, ModalModel)
    try:
        if modal:
            return _limits(task, sweep, semi_discretization, RULES.modal_limit_speeds, tolerance=1e-2)
        return _limits(task, sweep, multi_frequency, RULES.measured_limit_speeds, tolerance=1e-2)
    except InputError as error:
        reason = str(error).split(";")[0].split(". ")[0]
        return _zero_order(task, sweep, f"the limit depths are those of the zero-order method: {reason}")


def _confirmed(search: Search, one: _Refined) -> _Refined:
    """Return the alternative at the depth that a converged method finds safe."""
    return _at_depth(search, one.row, one.sweep, _converged(search.task, one.sweep), one.deepest)


# --- the result -----------------------------------------------------------------------------------------------------


def _plan(task: Task, table: pd.DataFrame, ranked: list[_Refined]) -> Plan:
    chosen = ranked[0]
    frame = pd.DataFrame([_row(r) for r in ranked])
    warnings = [
        *task.estimate.warnings,
        *([chosen.limits.note] if chosen.limits.note else []),
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


def _row(one: _Refined) -> dict[str, object]:
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
        "note": one.note,
    }


def thin_chips(sweep: SweepPlan) -> list[str]:
    """Say where the thickest chip at the end of the sweep, ``f_z sin(phi) sin(kappa)``, is thinner than 10 um."""
    feed = sweep.feed_rate / sweep.tooth_passing[1]
    thin = []
    for cut in dict.fromkeys(sweep.passes):
        arc = cut.engagement(sweep.tool.diameter)
        phi = min(max(0.5 * math.pi, arc.entry), arc.exit)
        chip = feed * math.sin(phi) * math.sin(sweep.tool.approach_angle)
        if chip < RULES.thin_chip:
            thin.append(f"{cut.cut} {1e3 * cut.width:g} mm ({1e6 * chip:.2g} um)")
    if not thin:
        return []
    return [
        f"chips are thinner than {1e6 * RULES.thin_chip:g} um in {', '.join(thin)}: an edge ploughs there, and "
        "coefficients of thicker chips do not give its force; cut wider or with more feed, or measure the force of one "
        "such pass first"
    ]


def _condition_warning(one: _Refined) -> list[str]:
    condition = one.prediction["force_condition"].values
    if condition.max() <= SWEEP_RULES.warn_condition:
        return []
    share = f"{100.0 * float(np.mean(condition > SWEEP_RULES.warn_condition)):.0f}"
    lost = int(np.sum(condition > SWEEP_RULES.refuse_condition))
    more = (
        f", and exceeds {SWEEP_RULES.refuse_condition:g} at {lost} frequencies, which will stay empty" if lost else ""
    )
    return [f"the condition number of the forces exceeds {SWEEP_RULES.warn_condition:g} in {share} % of the band{more}"]


def _completed(task: Task, one: _Refined) -> xr.Dataset:
    """Add force spectra and limit depths to the prediction."""
    sweep, out = one.sweep, one.prediction.copy()
    labels = [f"{p.cut} {1e3 * p.width:g} mm" for p in sweep.passes]
    energy = np.array(Forces(sweep, task.coefficients, task.frequency[-1] + 1.0).energy(task.frequency))
    spectrum = np.sqrt(np.diagonal(energy, axis1=2, axis2=3).real).transpose(0, 2, 1)
    out = out.assign_coords({"pass": labels, "axis": list("xyz"), "spindle_speed": ("spindle_speed", one.limits.speed)})
    out["force_spectrum"] = (("pass", "axis", "frequency"), spectrum, {"units": "N s"})
    method = "zero order" if not one.limits.converged else "semi-discretisation"
    if one.limits.converged and not isinstance(task.estimate.source, ModalModel):
        method = "multi-frequency"
    out["limit_depth"] = (("pass", "spindle_speed"), 1e3 * one.limits.depth, {"units": "mm", "method": method})
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
    depths = np.unique([*np.linspace(*task.limits.depth_of_cut, RULES.drawn_depths), sweep.depth])
    rows = []
    for p in sweep.passes:
        cut = p.engagement(sweep.tool.diameter)
        rows.append([force_level(sweep.tool, cut, task.coefficients, float(a), sweep.feed_per_tooth) for a in depths])
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
