"""The search: every sweep of a grid under the limits of the machine, ranked by its largest expected error.

The grid runs over inserts, speed ranges, feed per tooth and the widths of the three passes. Two quantities need no
grid, because the error falls with both: the sweep lasts as long as stroke, stock and time allow, and the depth is the
greatest that chatter margin, force, torque and power allow (all are proportional to it). Alternatives are ranked by the
noise alone, in one band, at the depth that the zero-order method allows; neither refuses anything. The best of each
group are then worked through as the estimator will (`planning.errors`), at the depth that a converged method allows.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from process.cut.engagement import CUTS
from process.cut.tool import Tool
from process.errors import InputError
from process.types import Complex, Real
from smfe.identification.sweep.rules import RULES as SWEEP_RULES
from smfe.planning.errors import Instruments
from smfe.planning.forces import (
    Pass,
    SweepPlan,
    energy,
    force_level,
    orders_within,
    possible_inserts,
    unit_harmonics,
    with_inserts,
)
from smfe.planning.limits import KEYS, allowed
from smfe.planning.rules import RULES
from smfe.planning.task import Task
from smfe.progress import Progress, silent
from stability import zero_order


@dataclass(frozen=True)
class Ramp:
    """One choice of inserts, speeds and feed per tooth."""

    tool: Tool
    start: float
    end: float
    feed_per_tooth: float


@dataclass(frozen=True)
class Cuts:
    """What each choice of one pass gives with one tool, for unit depth of 1 m where a force is meant.

    Parameters
    ----------
    choices : tuple of Pass
        Kinds and widths.
    limit : ndarray, shape (choices, speeds)
        Limit depth [m].
    speed : ndarray
        Spindle speeds of the limits [rpm].
    """

    choices: tuple[Pass, ...]
    limit: Real
    speed: Real


class Search:
    """All alternatives for a task.

    Parameters
    ----------
    task : Task
        The task.
    """

    def __init__(self, task: Task) -> None:
        self.task = task
        limits = task.limits
        fitting = possible_inserts(task.tool, limits.inserts)
        lost = sorted(set(limits.inserts) - set(fitting))
        if lost or not fitting:
            raise InputError(
                f"{task.path.name}: plan.inserts: {lost[0] if lost else 0} inserts cannot be spaced equally on a tool "
                f"of {task.tool.teeth} teeth; possible are {', '.join(map(str, possible_inserts(task.tool)))}"
            )
        self.tools = [with_inserts(task.tool, n) for n in fitting]
        self.instruments = Instruments(limits.acceleration_noise, limits.force_noise, limits.sample_rate)
        low, high = limits.frequency_range
        self.frequency = np.linspace(low, high, RULES.ranking_lines)
        self.scale = task.estimate.scale(task.frequency)
        self._deep = 0.5 * sum(limits.depth_of_cut)
        self._known: dict[tuple[int, Pass], tuple[Complex, Complex]] = {}

    @cached_property
    def _noise(self) -> Real:
        return self.instruments.response_noise(self.frequency, self.task.estimate.matrix(self.frequency))

    def choices(self) -> list[tuple[Pass, ...]]:
        """Return the sets of passes that are tried: those of the plan, else all widths of down, up and central."""
        given = self.task.limits.passes
        if given:
            return [tuple(Pass(p.cut, p.width_of_cut) for p in given)]
        diameter = self.task.tool.diameter
        low, high = self.task.limits.width_of_cut or (RULES.widths[0] * diameter, RULES.widths[-1] * diameter)
        every = {round(min(max(share * diameter, low), high, diameter), 4) for share in RULES.widths}
        widths = sorted(w for w in every if w > 0.0)
        return [
            tuple(Pass(cut, w) for cut, w in zip(CUTS, chosen, strict=True))
            for chosen in itertools.product(widths, repeat=3)
        ]

    def ramps(self, tool: Tool) -> Iterator[Ramp]:
        """Yield the speed ranges whose first harmonics cover the band without a gap, with each feed per tooth."""
        low, high = self.task.limits.feed_per_tooth
        # Two digits are what an operator sets.
        every = {min(max(float(f"{f:.2g}"), low), high) for f in np.geomspace(low, high, RULES.feeds)}
        feeds = [low] if math.isclose(low, high) else sorted(every)
        for start, end in self._speed_ranges(tool):
            for feed in feeds:
                yield Ramp(tool, start, end, float(feed))

    def _speed_ranges(self, tool: Tool) -> list[tuple[float, float]]:
        first, last = self.task.limits.frequency_range
        first, last = first - RULES.beyond, last + RULES.beyond
        turn = 2.0 * math.pi / tool.teeth
        spindle = self.task.spindle
        slow, fast = (n * tool.teeth / 60.0 for n in (spindle.minimum, spindle.maximum))
        starts = {first / m for m in (1, 2, 3)}
        ends = {last / m for m in (1, 2, 3)}
        # A spindle that is too slow for one choice may do with its own limits.
        starts |= {slow} if first / 3.0 < slow <= first else set()
        ends |= {fast} if last / 3.0 < fast <= last else set()
        out = []
        for a, b in itertools.product(sorted(starts), sorted(ends)):
            if covers((a, b), (first, last)):
                out.append((self._set(a * turn, down=True), self._set(b * turn, down=False)))
        # A spindle that cannot be set finely enough may not sweep at all.
        return sorted({(slowest, fastest) for slowest, fastest in out if slowest < fastest})

    def _set(self, rotation: float, down: bool) -> float:
        """Return the next speed that can be set, as rotation [rad/s]."""
        step = self.task.spindle.step or 1.0
        rpm = rotation * 30.0 / math.pi
        whole = (math.floor if down else math.ceil)(round(rpm / step, 6)) * step
        # Rounding does not lead out of the spindle's range.
        if down and rpm >= self.task.spindle.minimum > whole:
            whole += step
        if not down and rpm <= self.task.spindle.maximum < whole:
            whole -= step
        return float(max(whole, step) * math.pi / 30.0)

    def table(self, progress: Progress = silent) -> pd.DataFrame:
        """Return all alternatives: what they are, their expected error by noise alone, and what they need.

        Columns: inserts, start, end [rad/s], feed_per_tooth [m], duration [s], depth [m], deepest (that force, torque
        and power allow [m]), unstable (too deep by the zero-order method), passes (number in `choices`), worst, median
        (expected error), condition, and needed over available for each of `KEYS`; chatter, noise and error are 0:
        they are known of an alternative that is worked through.
        """
        choices = self.choices()
        frames = []
        for k, tool in enumerate(self.tools):
            progress("looking at alternatives", k, len(self.tools))
            ramps = list(self.ramps(tool))
            if not ramps:
                continue
            cuts = self._cuts(tool, choices, ramps)
            frames += [self._alternatives(ramp, choices, cuts) for ramp in ramps]
        if not frames:
            low, high = self.task.limits.frequency_range
            raise InputError(
                f"{self.task.path.name}: no spindle speed brings the first three harmonics of the tooth passing "
                f"frequency over {low:g} to {high:g} Hz without a gap; ask for another frequency_range"
            )
        progress("looking at alternatives", len(self.tools), len(self.tools))
        return pd.concat(frames, ignore_index=True)

    def _cuts(self, tool: Tool, choices: Sequence[tuple[Pass, ...]], ramps: Sequence[Ramp]) -> Cuts:
        """Return the limit depths of every pass that occurs, over all speeds of all ramps."""
        used = tuple(dict.fromkeys(p for chosen in choices for p in chosen))
        speed = np.unique(np.concatenate([_speeds(r.start, r.end) for r in ramps]))
        limits = []
        for one in used:
            arc = one.engagement(tool.diameter)
            found = zero_order(self.task.estimate.source, tool, arc, self.task.coefficients, speed)
            limits.append(1e-3 * found["limit_depth"].values)
        return Cuts(used, np.array(limits), speed)

    def _alternatives(self, ramp: Ramp, choices: Sequence[tuple[Pass, ...]], cuts: Cuts) -> pd.DataFrame:
        index = {p: i for i, p in enumerate(cuts.choices)}
        rows = np.array([[index[p] for p in chosen] for chosen in choices])
        limits = self.task.limits
        base = SweepPlan(
            ramp.tool, (), 1.0, ramp.feed_per_tooth, ramp.start, ramp.end, 1.0, 1, limits.lead, limits.tail
        )
        entry = max(p.entry_length(ramp.tool.diameter) for p in cuts.choices)
        duration, needs = self._duration(base, len(choices[0]), entry)
        plan = replace(base, duration=duration)
        loads = self._loads(plan, cuts)
        peaks = {k: v[rows].max(axis=1) for k, v in loads.items()}
        slow, fast = (w * 30.0 / math.pi for w in (ramp.start, ramp.end))
        inside = (cuts.speed >= slow * (1 - 1e-9)) & (cuts.speed <= fast * (1 + 1e-9))
        safe = limits.chatter_margin * cuts.limit[:, inside].min(axis=1)[rows].min(axis=1)
        least, greatest = limits.depth_of_cut
        # Loads are proportional to the depth, for straight edges exactly.
        bounds = [np.full(rows.shape[0], greatest)]
        bounds += [allowed(self.task, k) / v for k, v in peaks.items() if allowed(self.task, k) is not None]
        deepest = np.min(bounds, axis=0)
        depth = np.floor(np.minimum(deepest, safe) / RULES.depth_step * (1.0 + 1e-9)) * RULES.depth_step
        depth = np.clip(np.where(depth < least, least, depth), least, greatest)
        worst, median, condition = self._errors(plan, cuts, rows, depth)
        columns: dict[str, Any] = {
            "inserts": ramp.tool.teeth,
            "start": ramp.start,
            "end": ramp.end,
            "feed_per_tooth": ramp.feed_per_tooth,
            "duration": duration,
            "depth": depth,
            "deepest": deepest,
            "unstable": safe < least * (1.0 - 1e-9),
            "passes": np.arange(rows.shape[0]),
            "worst": worst,
            "median": median,
            "force_condition": condition,
        }
        needed = dict.fromkeys(KEYS, 0.0) | needs
        columns |= {key: np.full(rows.shape[0], needed[key]) for key in KEYS}
        columns["condition"] = condition / SWEEP_RULES.refuse_condition
        for k, v in peaks.items():
            given = allowed(self.task, k)
            columns[k] = np.zeros(rows.shape[0]) if given is None else least * v / given
        return pd.DataFrame(columns)

    def _duration(self, plan: SweepPlan, passes: int, entry: float) -> tuple[float, dict[str, float]]:
        """Return the longest time at full width [s], and needed over available of what limits it.

        The tool enters and leaves on the way `entry` [m] each.
        """
        limits = self.task.limits
        feed, air = plan.feed_rate, plan.lead + plan.tail
        rise = plan.end - plan.start
        shortest = RULES.shortest_pass
        longest = limits.longest_pass
        needs: dict[str, float] = {}
        if limits.spindle_acceleration is not None:
            needs["acceleration"] = rise / longest / limits.spindle_acceleration
            shortest = max(shortest, rise / limits.spindle_acceleration)
        ends = [longest]
        for key, given, used, extra in (
            ("stroke", limits.stroke, feed, feed * air + 2.0 * entry),
            ("stock", limits.stock_length, feed, entry),
            ("time", limits.time, float(passes), passes * (air + 2.0 * entry / feed)),
        ):
            if given is not None:
                needs[key] = (used * shortest + extra) / given
                ends.append((given - extra) / used)
        slow, fast = (w * 30.0 / math.pi for w in (plan.start, plan.end))
        needs["speed_high"] = fast / self.task.spindle.maximum
        needs["speed_low"] = self.task.spindle.minimum / slow
        if limits.feed is not None:
            needs["feed_low"], needs["feed_high"] = limits.feed[0] / feed, feed / limits.feed[1]
        duration = max(min(ends), min(shortest, longest), 1.0)
        return math.floor(duration * 10.0 + 1e-9) / 10.0, needs

    def most_repeats(self, plan: SweepPlan, passes: int) -> int:
        """Return how often the passes can be cut in the time that there is, at most as often as the plan allows."""
        limits = self.task.limits
        if limits.time is None:
            return limits.repeats
        return min(limits.repeats, max(1, math.floor(limits.time / (passes * plan.pass_time) + 1e-9)))

    def _loads(self, plan: SweepPlan, cuts: Cuts) -> dict[str, Real]:
        """Return the largest force [N/m], torque [N] and power [W/m] of each pass of unit depth over the sweep."""
        last = plan.feed_rate / plan.tooth_passing[1]
        loads: dict[str, list[float]] = {"force": [], "torque": [], "power": []}
        for one in cuts.choices:
            arc = one.engagement(plan.tool.diameter)
            begin, end = (
                force_level(plan.tool, arc, self.task.coefficients, 1.0, f) for f in (plan.feed_per_tooth, last)
            )
            loads["force"].append(max(begin.peak, end.peak))
            loads["torque"].append(max(begin.peak_torque, end.peak_torque))
            loads["power"].append(max(begin.torque * plan.start, end.torque * plan.end))
        return {key: np.array(values) for key, values in loads.items()}

    def _harmonics(self, tool: Tool, one: Pass, count: int) -> tuple[Complex, Complex]:
        """Return `unit_harmonics` at the depth in the middle of what is asked; a helix makes others not quite alike."""
        nothing: Complex = np.empty((0, 3), dtype=complex)
        chip, edge = self._known.get((tool.teeth, one), (nothing, nothing))
        if chip.shape[0] < count:
            arc, orders = one.engagement(tool.diameter), np.arange(1, count + 1)
            chip, edge = unit_harmonics(tool, arc, self.task.coefficients, self._deep, orders)
            self._known[tool.teeth, one] = chip, edge
        return chip[:count], edge[:count]

    def _errors(self, plan: SweepPlan, cuts: Cuts, rows: NDArray[np.int64], depth: Real) -> tuple[Real, Real, Real]:
        """Return worst and median expected error, and the largest condition number, of each set of passes."""
        orders = orders_within(plan.tooth_passing, self.frequency[-1] + 2.0)
        grams = []
        for one in cuts.choices:
            parts = self._harmonics(plan.tool, one, orders.size)
            grams.append(energy(self.frequency, parts, orders, plan.tooth_passing, plan.duration, plan.feed_rate))
        gram = np.array(grams)[rows].sum(axis=1)
        spread, condition = inverse_diagonal(gram)
        density = 9.0 / 4.0 / (2.0 * RULES.ranking_band)
        square = density * np.einsum("fi,pfj->pij", self._noise, spread) / self.frequency.size
        error = np.sqrt(square) / self.scale * (self._deep / depth)[:, None, None]
        flat = error.reshape(rows.shape[0], 9)
        return flat.max(axis=1), np.median(flat, axis=1), condition


def covers(tooth_passing: tuple[float, float], band: tuple[float, float]) -> bool:
    """Whether the harmonics of a sweep cover a band without a gap."""
    first, last = tooth_passing
    if not 0.0 < first < last:
        return False
    reached = band[0]
    for h in range(1, math.ceil(band[1] / first) + 1):
        if h * first > reached * (1.0 + 1e-9):
            return False
        reached = max(reached, h * last)
        if reached >= band[1] * (1.0 - 1e-9):
            return True
    return False


def inverse_diagonal(gram: Complex) -> tuple[Real, Real]:
    """Return the diagonal of the inverse of Hermitian 3x3 matrices, and the largest root of their condition over lines.

    Parameters
    ----------
    gram : ndarray of complex, shape (p, f, 3, 3)
        ``F F^H``.

    Returns
    -------
    tuple of ndarray
        Shapes (p, f, 3) and (p,): by cofactors; the condition number of F from every third line.
    """
    values = np.linalg.eigvalsh(gram[:, ::3])
    condition = np.sqrt(values[..., 2] / np.maximum(values[..., 0], 1e-14 * values[..., 2])).max(axis=1)
    cofactors = []
    for j in range(3):
        k, m = (j + 1) % 3, (j + 2) % 3
        cofactors.append(gram[..., k, k].real * gram[..., m, m].real - np.abs(gram[..., k, m]) ** 2)
    trace = np.trace(gram, axis1=2, axis2=3).real
    determinant = np.linalg.det(gram).real
    floor = 1e-14 * trace**3
    return np.maximum(np.stack(cofactors, axis=-1), 0.0) / np.maximum(determinant, floor)[..., None], condition


def _speeds(start: float, end: float) -> Real:
    return np.linspace(start, end, RULES.ranking_speeds) * 30.0 / math.pi
