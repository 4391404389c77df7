"""The answer of a search for gains: the best set, the present ones beside it, the compromise with tracking, lobes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr

from process.drive.servo import Servo
from process.errors import InputError
from process.labels import AXES, make_compliance
from process.types import Complex, Real
from smfe.limits.cut_conditions import rotation
from smfe.progress import Progress, part, silent
from smfe.tuning.confirm import confirmed, constant_factor, with_servos
from smfe.tuning.judge import Judge, Judged, gains_at, shares_of
from smfe.tuning.loops import close, gains_of
from smfe.tuning.plants import ModelSource, Plant
from smfe.tuning.rules import RULES
from smfe.tuning.search import frontier, polished, rule_gains, search_globally
from smfe.tuning.task import LIMIT_WORDS, Task
from stability import zero_order

FRONTIER = 7
"""Compromises between depth and tracking that are worked out."""

_KEPT = 5e-3
"""A limit in dB (deg, share) counts as kept when it is missed by no more."""


@dataclass(frozen=True)
class GainSet:
    """Gains of all axes and what they are worth.

    Parameters
    ----------
    name : str
        "tuned", the name of a controller, "rule", or "compromise 1".
    servos : mapping of str to Servo
        Axis -> gains.
    goal, nominal : float
        What is maximised, in SI (depth [m] or removal rate [m^3/s]): the worst over the moved modes, and with the modes
        where they are. Zero where a loop is unstable.
    values : mapping of str to float
        What may be limited, by its name in `smfe.tuning.task.Limits`; the worst of axes and moved modes.
    tracking_error : float
        Of the move [m].
    misses : tuple of str
        Limits that these gains do not keep, in words.
    """

    name: str
    servos: Mapping[str, Servo]
    goal: float
    nominal: float
    values: Mapping[str, float]
    tracking_error: float
    misses: tuple[str, ...] = ()

    def row(self, kind: str) -> dict[str, object]:
        """Return the set as a row of a table, in field units."""
        unit, factor = ("cm3_min", 6e7) if kind == "removal_rate" else ("mm", 1e3)
        out: dict[str, object] = {
            "gains": self.name,
            f"worst_{unit}": factor * _unlimited(kind, self.goal),
            f"nominal_{unit}": factor * _unlimited(kind, self.nominal),
            "tracking_error_um": 1e6 * self.tracking_error,
        }
        for axis, v in self.servos.items():
            out |= {f"Kp_{axis}_N_s_m": v.Kp, f"Ti_{axis}_ms": 1e3 * v.Ti, f"Kv_{axis}_1_s": v.Kv}
            out[f"feed_forward_{axis}"] = v.feed_forward
        out |= {
            f"{name}_{LIMIT_WORDS[name][2]}": value for name, value in self.values.items() if name != "tracking_error"
        }
        return out | {"misses": "; ".join(self.misses)}


@dataclass(frozen=True)
class Tuning:
    """What a search for gains found.

    Parameters
    ----------
    task : Task
        What was asked.
    best : GainSet
        The answer.
    present : tuple of GainSet
        The controllers that are there now.
    rule : GainSet or None
        The best that the rule of `process.tune`, one bandwidth for all axes, reaches within the limits.
    frontier : tuple of GainSet
        The deepest cut at growing tracking error; the last is about the answer.
    lobes : xarray.Dataset
        Zero-order ``limit_depth(gains, spindle_speed)`` [mm], modes where they are.
    loops : xarray.Dataset
        ``velocity_loop`` and ``position_loop`` (gains, axis, frequency), closed, complex [1].
    confirmed : xarray.Dataset or None
        Limits of the answer by a method without the zero order's approximation; None where that is exact, or none takes
        the tool.
    tried : int
        Sets of gains that were judged in the global search.
    notes : tuple of str
        What holds of the answer.
    warnings : tuple of str
        What speaks against it.
    """

    task: Task
    best: GainSet
    present: tuple[GainSet, ...]
    rule: GainSet | None
    frontier: tuple[GainSet, ...]
    lobes: xr.Dataset
    loops: xr.Dataset
    confirmed: xr.Dataset | None
    tried: int
    notes: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def servos(self) -> Mapping[str, Servo]:
        """Axis -> the gains that were found."""
        return self.best.servos

    @property
    def sets(self) -> tuple[GainSet, ...]:
        """The answer, the present sets and the rule."""
        return (self.best, *self.present, *((self.rule,) if self.rule else ()))

    def shortfall(self, one: GainSet) -> float:
        """Return by which share a set stays behind the answer, 0 to 1."""
        return 1.0 - one.goal / self.best.goal

    def table(self) -> pd.DataFrame:
        """Return one row a set of gains: the answer, the present ones, the rule, the compromises."""
        rows = [one.row(self.task.goal.kind) for one in (*self.sets, *self.frontier)]
        return pd.DataFrame(rows)


def _unlimited(kind: str, goal: float) -> float:
    """Return infinity for a depth that counts as without limit."""
    return math.inf if kind != "removal_rate" and goal >= RULES.deepest else goal


def tuned(task: Task, progress: Progress = silent) -> Tuning:
    """Search the gains of a task.

    Raises
    ------
    InputError
        When no gains within the search keep all limits, with those that come nearest.
    """
    start, missed, archive = search_globally(task, part(progress, 0.0, 0.4))
    final = Judge(task, 2 * RULES.fine, changes=task.changes_between)
    if missed > 0.0:
        raise InputError(_impossible(task, final, start))
    rule = _rule(task, final)
    known = [rule] if rule else []
    starts = np.concatenate([start[None], *(shares_of(task, _gains(one)[None]) for one in known)])
    best, _ = polished(task, np.clip(starts, 0.0, 1.0), archive, part(progress, 0.4, 0.7))
    fronts = frontier(task, best, archive, FRONTIER, part(progress, 0.7, 0.95))
    progress("lobes and loops", 19, 20)
    answer = _sets(task, final, ["tuned"], gains_at(task, best[None]))[0]
    present = _given(task, final, list(task.present))
    compromises = _sets(
        task,
        final,
        [f"compromise {i}" for i in range(1, len(fronts) + 1)],
        np.concatenate([gains_at(task, share[None]) for share, _ in fronts]) if fronts else np.zeros((0, 1, 3)),
    )
    shown = [answer, *present, *([rule] if rule else [])]
    even = _even_plant(task)
    lobes, warnings = _lobes(task, even, shown)
    notes, limits = [], None
    if constant_factor(task, final.plants[0].directions):
        notes.append("the directional factor of this cut is constant: the zero order is exact")
    else:
        progress("confirming", 19, 20)
        servos = tuple(answer.servos.values())
        phi = _in_cut(task, _tool(even, servos), even.frequency)
        limits, said = confirmed(task, servos, phi, lobes.sel(gains="tuned"))
        (warnings if limits is None else notes).append(said)
    warnings += _doubts(task, answer, best)
    return Tuning(
        task,
        answer,
        tuple(present),
        rule,
        tuple(compromises),
        lobes,
        _loops(final, shown),
        limits,
        archive.tried,
        tuple(notes),
        tuple(warnings),
    )


def _sets(task: Task, judge: Judge, names: Sequence[str], gains: Real) -> list[GainSet]:
    if not len(gains):
        return []
    judged, own = judge(gains, beyond=True), task.source
    out = []
    for i, name in enumerate(names):
        servos = {
            axis: Servo(kp, ti, kv, own.delay[a], float(judged.feed_forward[i, a]))
            for a, (axis, (kp, ti, kv)) in enumerate(zip(own.axes, gains[i].tolist(), strict=True))
        }
        out.append(_set(task, name, servos, judged, i))
    return out


def _set(task: Task, name: str, servos: Mapping[str, Servo], judged: Judged, i: int) -> GainSet:
    values = {key: float(one[i]) for key, one in judged.values.items()}
    unstable = ("a loop is unstable",) if judged.unstable[i] else ()
    return GainSet(
        name,
        servos,
        float(judged.goal[i]),
        float(judged.nominal[i]),
        values,
        float(judged.error[i]),
        (*unstable, *_misses(task, values)),
    )


def _misses(task: Task, values: Mapping[str, float]) -> tuple[str, ...]:
    """Return the limits that are not kept, in words."""
    out = []
    for name, limit in vars(task.limits).items():
        if limit is None or name not in values:
            continue
        what, side, unit, factor = LIMIT_WORDS[name]
        allowed = _KEPT if unit in ("dB", "deg") else _KEPT * abs(limit)
        by = values[name] - limit if side == "at most" else limit - values[name]
        if by > allowed:
            out.append(f"{what} {factor * values[name]:.3g} {unit} ({side} {factor * limit:.3g} {unit})")
    return tuple(out)


def _given(task: Task, judge: Judge, names: Sequence[str]) -> list[GainSet]:
    """Judge the present controllers, each with its own feed-forward where the task leaves that open."""
    gains = [gains_of(list(task.present[name])) for name in names]
    return _sets(task, judge, names, np.array(gains)) if names else []


def _rule(task: Task, judge: Judge) -> GainSet | None:
    """Return the best set of the bandwidth rule within the limits."""
    gains = rule_gains(task, np.linspace(0.1, 0.95, 60))
    coarse = Judge(task, RULES.coarse)
    judged = coarse(gains)
    if not (judged.missed == 0.0).any():
        return None
    # The rule has one bandwidth: the best of a scan, scanned once more between its neighbours.
    share = np.linspace(0.1, 0.95, 60)
    at = int(judged.cost.argmin())
    near = rule_gains(task, np.linspace(share[max(at - 1, 0)], share[min(at + 1, 59)], 60))
    return _sets(task, judge, ["rule"], near[[int(coarse(near).cost.argmin())]])[0]


def _even_plant(task: Task) -> Plant:
    """Return the plant on the even grid that the methods of `stability` take a measured compliance on."""
    modes, (low, high) = task.source.modes()[:, 0], task.source.band
    first, last = max(RULES.even[0] * modes.min(), low), min(RULES.even[1] * modes.max(), high)
    return task.source.plant(np.geomspace(first, last, RULES.even_points))


def _tool(plant: Plant, servos: Sequence[Servo]) -> Complex:
    """Return the compliance of the tool [m/N], shape (f, 3, 3), with servos closed."""
    s = plant.laplace
    feedback = np.stack([v.feedback(s) for v in servos], axis=1)
    matrix = plant.base + feedback[:, :, None] * np.eye(len(servos))
    return np.asarray(plant.held + plant.reach @ np.linalg.solve(matrix, plant.back))


def _in_cut(task: Task, phi: Complex, frequency: Real) -> xr.Dataset:
    turn = rotation(task.feed_direction)
    return make_compliance(frequency, turn @ phi @ turn.T, list(AXES), list(AXES))


def _lobes(task: Task, plant: Plant, shown: Sequence[GainSet]) -> tuple[xr.Dataset, list[str]]:
    """Return zero-order limits of the sets by `stability.zero_order`, and its warnings about the answer."""
    low, high = min(task.goal.speeds), max(task.goal.speeds)
    if low == high:
        low, high = 0.7 * low, 1.3 * high
    speed = np.union1d(np.linspace(low, high, 201), task.goal.speeds)
    depths, chatter, warnings = [], [], []
    for one in shown:
        if any(m.startswith("a loop") for m in one.misses):
            depths.append(np.zeros(speed.size))
            chatter.append(np.full(speed.size, np.nan))
            continue
        phi = _in_cut(task, _tool(plant, tuple(one.servos.values())), plant.frequency)
        found = zero_order(phi, task.tool, task.arc, task.coefficients, speed)
        depths.append(found["limit_depth"].values)
        chatter.append(found["chatter_frequency"].values)
        if one is shown[0]:
            # A servo may give energy, and the grid of a model ends where masses alone count. What else a helix does is
            # said by `confirm`.
            skip = (
                "the compliance is not that",
                "at ",
                "the frequency range",
                "the compliance is missing",
                "the mean directional matrix",
            )
            warnings = [w for w in found.attrs["warnings"] if not w.startswith(skip)]
    data = {
        "limit_depth": (("gains", "spindle_speed"), np.array(depths), {"units": "mm"}),
        "chatter_frequency": (("gains", "spindle_speed"), np.array(chatter), {"units": "Hz"}),
    }
    coords = {"gains": [one.name for one in shown], "spindle_speed": ("spindle_speed", speed, {"units": "rpm"})}
    return xr.Dataset(data, coords), warnings


def _gains(one: GainSet) -> Real:
    """Return Kp, Ti, Kv, shape (a, 3)."""
    return gains_of(list(one.servos.values()))


def _loops(judge: Judge, shown: Sequence[GainSet]) -> xr.Dataset:
    gains = np.array([_gains(one) for one in shown])
    forward = np.array([[v.feed_forward for v in one.servos.values()] for one in shown])
    plant = judge.plants[0]
    closed = close(plant, judge.oriented, gains)
    data = {
        "velocity_loop": (("gains", "axis", "frequency"), closed.velocity),
        "position_loop": (("gains", "axis", "frequency"), closed.position + forward[..., None] * closed.ahead),
    }
    coords = {
        "gains": [one.name for one in shown],
        "axis": list(plant.axes),
        "frequency": ("frequency", plant.frequency, {"units": "Hz"}),
    }
    return xr.Dataset(data, coords)


def _impossible(task: Task, judge: Judge, share: Real) -> str:
    nearest = _sets(task, judge, ["nearest"], gains_at(task, share[None]))[0]
    gains = "; ".join(
        f"{axis}: Kp {v.Kp:.4g} N s/m, Ti {1e3 * v.Ti:.3g} ms, Kv {v.Kv:.3g} 1/s" for axis, v in nearest.servos.items()
    )
    missed = ", ".join(nearest.misses) or "all by a hair"
    moved = f" with the modes moved by up to {100 * task.robust:.3g} %" if task.robust else ""
    return (
        f"no gains keep all limits together{moved}; the nearest ({gains}) miss: {missed}. Relax one of them, or "
        "shorten the dead time"
    )


def _doubts(task: Task, answer: GainSet, share: Real) -> list[str]:
    """Say what speaks against an answer: an edge of what is tried, an exact count of poles, no limit at all."""
    out = [f"the answer misses a limit on the finest grid: {missed}" for missed in answer.misses]
    at_edge = (share < 1e-3) | (share > 1.0 - 1e-3)
    if at_edge.any():
        names = [f"{g} of {axis}" for axis in task.source.axes for g in ("Kp", "Ti", "Kv")]
        listed = ", ".join(n for n, edge in zip(names, at_edge, strict=True) if edge)
        verb = "lie" if at_edge.sum() > 1 else "lies"
        out.append(
            f"{listed} {verb} at an edge of what is tried: no limit holds it back; state one (bandwidth, margins)"
        )
    if isinstance(task.source, ModelSource):
        count = with_servos(task.source, tuple(answer.servos.values())).unstable_poles()
        if count:
            out.append(f"the exact count finds {count} pole(s) in the right half plane; do not use these gains")
    if task.goal.kind == "removal_rate" and math.isinf(task.goal.deepest):
        out.append(
            "no largest depth is stated: a removal rate then counts the deepest pocket as deep as it is stable; give "
            "maximum_depth, or edge_length of the tool"
        )
    elif answer.goal >= RULES.deepest:
        out.append("no depth is unstable with these gains as far as the machine is known; the goal does not decide")
    return out
