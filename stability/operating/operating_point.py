"""Zero-order limits whose compliance belongs to the feed and the vibration at which each point is cut.

A machine with friction answers differently idle and in motion, to a small vibration and to a large one. At a spindle
speed n the feed is ``f_z N n``, or it is given. From a machine model guideways and joints have the coefficient of their
own motion (`stability.operating.guideways`), from a measured compliance it is interpolated linearly between
feeds and levels (`stability.operating.measured`), :eq:`operating-point`. Two curves come out:

- the limit of a small disturbance;
- the *lower* limit: the least depth at which a vibration of any size keeps its size. Between the two a cut stays
  quiet until it is kicked; the kick that separates them is given.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients, force_harmonics
from process.cut.tool import Tool
from process.errors import InputError
from process.harmonic_balance.network import FrictionElement
from process.labels import AXES, label
from process.machine.machine import Machine
from process.types import Real
from stability.operating.cycles import Cycle, Limits, lowest
from stability.operating.guideways import CutLoop, MovingMachine, moving_machine
from stability.operating.library import conditions_of
from stability.operating.measured import Level, MeasuredMachine
from stability.operating.rules import RULES
from stability.operating.uncertainty import SAFE, Uncertainty, quantile_factors, uncertainty_of, variants
from stability.problem import NO_LOBE, Cut, check_spindle_speed, edge_warnings, pattern_of_pitch

_MM_MIN = 1.0 / 6e4


def operating_point(
    compliance: xr.Dataset | Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: ArrayLike,
    feed_per_tooth: float,
    force_level: Level | None = None,
    *,
    feed: ArrayLike | None = None,
    feed_direction: float = 0.0,
    controller: str | None = None,
    position: float | None = None,
    uncertainty: Mapping[str, float] | None = None,
) -> xr.Dataset:
    """Return the limit depths at which the compliance is that of the cut itself.

    Parameters
    ----------
    compliance : Machine or xarray.Dataset
        A machine model, in its own axes. Or a compliance [m/N] in the axes of the cut with one or both of the
        dimensions ``feed`` [mm/min] and ``force_level`` [N] (or ``depth_of_cut`` [mm], for sweeps). Where each feed has
        levels of its own, the dimension is called ``level`` and the coordinate ``force_level(feed, level)`` (or
        ``depth_of_cut``) holds them, NaN behind the last one of a feed.
    tool, arc, coefficients
        The cut.
    spindle_speed : array_like, shape (speeds,)
        Spindle speeds [rpm], in any order.
    feed_per_tooth : float
        f_z [m]. A tooth leaves the cut where the vibration exceeds it.
    force_level : callable, optional
        Of a measured compliance: depth of cut [m] -> force level [N], rising. By default the level is the chip force of
        the vibration itself.
    feed : array_like, shape (speeds,) or one value, optional
        Feed [m/s]; default ``f_z N n``.
    feed_direction : float, optional
        Of a machine model: direction in which the cut is fed, from +x towards +y [rad]. Each axis moves with its share,
        with the friction of its direction.
    controller : str, optional
        Of a machine model: name of the controllers.
    position : float, optional
        Of a machine model: position [m] of the axis that a posture depends on.
    uncertainty : mapping of str to float, optional
        Relative standard deviations, for a band: "coefficients" (one factor on all), and of a machine model "friction"
        (each parameter of each law), "mass", "damping", "stiffness" (of the structure). That of a measured
        compliance is its ``compliance_std``.

    Returns
    -------
    xarray.Dataset
        ``limit_depth`` [mm] of a small disturbance, ``chatter_frequency`` [Hz], ``lobe``, ``vibration(spindle_speed,
        axis)`` and ``feed`` [mm/min] over ``spindle_speed``, as of `zero_order`. Where vibrations of a size are known:
        ``lower_limit_depth`` [mm], the least depth at which any vibration keeps its size, its
        ``lower_chatter_frequency`` [Hz], the ``kick`` [N s], least impulse at the tool that leads to it from rest (0
        where the two limits are one), and ``cycle_depth`` [mm], ``cycle_amplitude`` (of the fastest guideway, m/s; of
        a measured compliance the force, N), ``cycle_kick`` [N s] and ``cycle_swing`` (of the chip thickness over f_z)
        over ``(spindle_speed, cycle)``, NaN where there are fewer. For levels that follow the depth
        ``crossing_depth(spindle_speed, crossing)`` [mm]: all depths at which stability changes, lost at the first, won
        at the second and so on, the level itself, and where no limit is known ``stable_to`` [mm], the depth to which
        the cut is stable. With an uncertainty
        ``limit_depth_quantile(quantile, spindle_speed)``, ``lower_limit_depth_quantile`` and ``safe_depth`` [mm], the
        lower one of their 5 % quantiles.
        A limit that is not known is NaN: outside the feeds and levels that were measured, or where uniform motion is
        itself unstable; ``attrs["warnings"]`` says why.

    Raises
    ------
    InputError
        For a compliance without such a dimension or with others, conditions that do not rise, a force level that does
        not rise with the depth, an argument that the one or the other has no use for, friction with memory, or what
        `zero_order` refuses.
    """
    speed = check_spindle_speed(spindle_speed)
    if not 0.0 < feed_per_tooth < math.inf:
        raise InputError(f"the feed per tooth is {feed_per_tooth * 1e3:g} mm; it must be positive and finite")
    cut = Cut(tool, arc, coefficients)
    rate = _feeds(feed, speed, feed_per_tooth * tool.teeth)
    loop = CutLoop(cut.directional_matrix(), pattern_of_pitch(tool).delay, feed_per_tooth)
    known = uncertainty_of(uncertainty)
    if isinstance(compliance, Machine):
        if force_level is not None:
            raise InputError(
                "a force_level is given with a machine model, whose level is its own vibration; leave it out"
            )
        moving = moving_machine(compliance, loop, feed_direction, controller, position, rate.tolist())
        found = [_of_model(moving, float(n), float(v)) for n, v in zip(speed, rate, strict=True)]
        errors = _errors_of_model(moving, found, speed, rate, known)
        out = _labelled(found, speed, rate, moving.frequency, [*cut.mean_warnings])
        out.attrs["warnings"] += _said_of_model(moving, found)
        out.attrs["warnings"] += _shaken(moving, found, cut, speed, rate)
    else:
        if feed_direction or controller is not None or position is not None:
            raise InputError(
                "feed_direction, controller and position belong to a machine model; a measured compliance is given in "
                "the axes of the cut, under one controller and at one position"
            )
        out, found, errors = _of_compliance(compliance, cut, loop, speed, rate, feed_per_tooth, force_level, known)
    return label(_with_band(out, found, errors, known))


def _feeds(feed: ArrayLike | None, speed: Real, a_turn: float) -> Real:
    """Return the feed at each speed [m/s]."""
    if feed is None:
        return np.asarray(a_turn * speed / 60.0)
    given = np.asarray(feed, dtype=float)
    if given.ndim > 1 or given.size not in (1, speed.size) or not np.all(np.isfinite(given) & (given >= 0.0)):
        raise InputError(f"the feed is {feed} m/s; give one, or one a spindle speed, finite and not negative")
    return np.array(np.broadcast_to(given.reshape(-1) if given.ndim else given, speed.shape))


# --- from a machine model --------------------------------------------------------------------------------------------


def _of_model(moving: MovingMachine, speed: float, feed: float) -> Limits:
    """Return the limits at a speed [rpm] and feed [m/s]."""
    fed = moving.at(feed)
    small = fed.cycle(0.0, speed)
    if small.unsteady:
        return Limits.unknown(
            "uniform motion that is unstable without a cut (stick-slip)", f"{feed / _MM_MIN:.4g} mm/min"
        )
    nodes, last = [small], small
    for amplitude in fed.amplitudes():
        one = fed.cycle(float(amplitude), speed, last)
        nodes.append(one)
        if one.swing > RULES.largest_swing:
            break
        last = one if 0.0 < one.depth < math.inf else last
    # From the other side: where guideways share the motion anew, it is followed from a larger vibration.
    for i in reversed(range(1, len(nodes) - 1)):
        if math.isnan(nodes[i].depth) and 0.0 < nodes[i + 1].depth < math.inf:
            nodes[i] = fed.cycle_beside(nodes[i].amplitude, speed, nodes[i + 1])
    lost = sum(math.isnan(c.depth) for c in nodes)
    least, cycles = lowest(nodes, lambda amplitude, near: fed.cycle(amplitude, speed, near))
    if least.depth > small.depth * (1.0 - RULES.no_lower):
        least = small
    return Limits(small, least, cycles, [small.depth], lost=lost)


def _errors_of_model(
    moving: MovingMachine, found: Sequence[Limits], speed: Real, rate: Real, known: Uncertainty | None
) -> Real:
    """Return the relative errors of both limits, shape (speeds, 2), from first derivatives."""
    out = np.zeros((speed.size, 2))
    if known is None:
        return out
    others = [replace(moving, machine=machine) for machine in variants(moving.machine, known)]
    for i, (n, v) in enumerate(zip(speed, rate, strict=True)):
        one = found[i]
        if one.why or one.least is None:
            continue
        steps = np.zeros((len(others), 2))
        for k, other in enumerate(others):
            fed = other.at(float(v))
            small = fed.cycle(0.0, float(n))
            steps[k, 0] = _change(small, one.small)
            # At the lowest point a change of the amplitude does not matter.
            large = one.least is not one.small and not small.unsteady
            steps[k, 1] = (
                _change(fed.cycle(one.least.amplitude, float(n), one.least), one.least) if large else steps[k, 0]
            )
        out[i] = np.sqrt(np.sum(steps**2, axis=0))
    return out


def _change(other: Cycle, one: Cycle) -> float:
    if not (0.0 < one.depth < math.inf):
        return 0.0
    return math.log(other.depth / one.depth) if 0.0 < other.depth < math.inf else 1.0


def _said_of_model(moving: MovingMachine, found: Sequence[Limits]) -> list[str]:
    out = []
    lost = sum(one.lost for one in found)
    every = sum(len(one.cycles) for one in found) + lost
    started = sum(one.least is not None and one.least.unsteady for one in found)
    if started:
        out.append(
            f"at {started} of {len(found)} speeds a strong kick starts stick-slip without a cut: there the lower limit "
            "is zero"
        )
    if lost:
        out.append(f"{lost} of {every} vibrations of some size were not found, and the lower limit may miss them")
    idle = [
        axis
        for axis, servo in zip(moving.machine.axes, moving.machine.servos(moving.controller), strict=True)
        if servo is not None and moving.feeds(1.0).get(axis) == 0.0
    ]
    if idle and any(one.small.elements.size for one in found):
        out.append(
            f"axis {', '.join(idle)} stands still in this cut: to a small disturbance its friction holds it, and the "
            "forces of the cut itself, which may break it loose, are not counted"
        )
    return out


def _shaken(moving: MovingMachine, found: Sequence[Limits], cut: Cut, speed: Real, rate: Real) -> list[str]:
    """Say where the forces of the stable cut alone shake a guideway as fast as it is fed: then its friction differs."""
    round_tool, orders = replace(cut.tool, runout=None, pitch_angles=None), [1, 2, 3, 4]
    count = 0
    for one, n, v in zip(found, speed, rate, strict=True):
        depth = one.small.depth
        if one.why or not (0.0 < depth < math.inf):
            continue
        fed = moving.at(float(v))
        force = force_harmonics(round_tool, cut.arc, cut.coefficients, depth, moving.loop.chip, orders)
        if np.linalg.norm(force) < 1e-9 * np.linalg.norm(cut.directional_matrix()) * depth * moving.loop.chip:
            continue
        frequency = np.array(orders) * cut.tool.teeth * float(n) / 60.0
        shaken = fed.shaken(frequency, np.asarray(force).reshape(len(orders), 3))
        feeds = [abs(e.feed) if isinstance(e, FrictionElement) else math.inf for e in fed.network.elements]
        count += any(s > RULES.shaken * f > 0.0 for s, f in zip(shaken, feeds, strict=True))
    if not count:
        return []
    return [
        f"at {count} of {len(found)} speeds the tooth passing forces alone shake a guideway faster than it is fed: its "
        "friction then is that of this vibration, which these limits do not count; simulate such cuts in time"
    ]


# --- from a measured compliance --------------------------------------------------------------------------------------


def _of_compliance(
    compliance: xr.Dataset,
    cut: Cut,
    loop: CutLoop,
    speed: Real,
    rate: Real,
    feed_per_tooth: float,
    force_level: Level | None,
    known: Uncertainty | None,
) -> tuple[xr.Dataset, list[Limits], Real]:
    conditions = conditions_of(compliance)
    level = force_level
    if conditions.level_name == "depth_of_cut":
        if force_level is not None:
            raise InputError(
                "the compliance has the dimension depth_of_cut; a force_level has no use then: leave it out"
            )

        def level(depth: float) -> float:
            return 1e3 * depth

    elif conditions.level_name is None:
        level = None
    feed = rate / _MM_MIN
    machine = MeasuredMachine(conditions, loop, level)
    found = [machine.limits(float(n), float(v)) for n, v in zip(speed, feed, strict=True)]
    warnings = [*cut.mean_warnings, *conditions.samples.warnings]
    warnings += edge_warnings(conditions.at(float(np.clip(feed[0], conditions.feed[0], conditions.feed[-1])), 0.0))
    out = _labelled(found, speed, rate, conditions.samples.frequency, warnings)
    if level is not None:
        most = max([1, *(len(one.crossings) for one in found)])
        every = np.array([[1e3 * d for d in o.crossings] + [math.nan] * (most - len(o.crossings)) for o in found])
        out["stable_to"] = ("spindle_speed", np.array([1e3 * o.stable_to for o in found]), {"units": "mm"})
        out["crossing_depth"] = (("spindle_speed", "crossing"), every, {"units": "mm"})
        used = [level(o.small.depth) if math.isfinite(o.small.depth) else math.nan for o in found]
        out[str(conditions.level_name)] = ("spindle_speed", np.array(used))
    out.attrs["warnings"] += _said_of_compliance(machine, found, speed, feed)
    if conditions.has_feed and conditions.feed.size > 1:
        error = machine.interpolation_error(speed, feed)
        if error is not None:
            out.attrs["interpolation_error"] = error
    relative = np.array([[c.error if c is not None else math.nan for c in (o.small, o.least)] for o in found])
    return out, found, relative


def _said_of_compliance(machine: MeasuredMachine, found: Sequence[Limits], speed: Real, feed: Real) -> list[str]:
    """Say what straight lines between feeds cost, and what the levels do not show."""
    conditions, out = machine.conditions, []
    if conditions.has_feed and conditions.feed.size > 1:
        error = machine.interpolation_error(speed, feed)
        between = "between the measured feeds the compliance is a straight line: "
        if error is None:
            out.append(between + "what that costs cannot be told from two feeds, measure one between them")
        elif error > 1e-4:
            out.append(between + f"feeds left out one by one say that limits are off by up to {100.0 * error:.2g} %")
    if machine.level is None and conditions.level_name is not None:
        low = [part[0] for part in conditions.levels]
        if any(not one.why for one in found):
            said = f"{min(low):.4g} N" if max(low) == min(low) else f"{min(low):.4g} to {max(low):.4g} N"
            out.append(f"a small disturbance is one of {said}, the lowest level that was measured at a feed")
        apart = sum(one.least is None and not one.why for one in found)
        if apart:
            out.append(
                f"at {apart} of {len(found)} speeds the feeds about that of the cut were measured at levels that do "
                "not overlap: no lower limit is known there"
            )
        ends = sum(one.least is not None and len(one.cycles) > 1 and one.least is one.cycles[-1] for one in found)
        if ends:
            out.append(
                f"at {ends} of {len(found)} speeds the lower limit is that of the highest level: a stronger vibration "
                "was not measured and may lower it further"
            )
    return out


# --- labels ----------------------------------------------------------------------------------------------------------


def _labelled(found: Sequence[Limits], speed: Real, rate: Real, frequency: Real, warnings: list[str]) -> xr.Dataset:
    """Put names and units on limits."""
    small = [one.small for one in found]
    finite = np.array([0.0 < c.depth < math.inf for c in small])
    moved = np.array(
        [c.tool if good else np.full(3, np.nan, dtype=complex) for c, good in zip(small, finite, strict=True)]
    )
    phase = np.take_along_axis(moved, np.nan_to_num(np.abs(moved)).argmax(axis=1)[:, None], axis=1)
    size = np.linalg.norm(moved, axis=1)[:, None]
    moved = moved * np.exp(-1j * np.angle(phase)) / np.where(size > 0.0, size, 1.0)
    data: dict[str, Any] = {
        "limit_depth": ("spindle_speed", np.array([1e3 * c.depth for c in small])),
        "chatter_frequency": ("spindle_speed", np.where(finite, [c.chatter for c in small], math.nan)),
        "lobe": ("spindle_speed", np.where(finite, [c.lobe for c in small], NO_LOBE).astype(np.int64)),
        "vibration": (("spindle_speed", "axis"), moved, {"units": "1"}),
        "feed": ("spindle_speed", rate / _MM_MIN),
    }
    if any(one.least is not None for one in found):
        data.update(_lower(found))
    attrs = {
        "method": "operating_point",
        "frequency_low_Hz": float(frequency[0]),
        "frequency_high_Hz": float(frequency[-1]),
        "warnings": [*warnings, *_refusals(found)],
    }
    out = label(xr.Dataset(data, coords={"spindle_speed": speed, "axis": list(AXES)}, attrs=attrs))
    out["limit_depth"].attrs["infinity"] = "no crossing within the frequency range of the data"
    out["lobe"].attrs["none"] = NO_LOBE
    return out


def _lower(found: Sequence[Limits]) -> dict[str, Any]:
    """Return the lower limit and all cycles, as variables."""
    least = [one.least or Cycle(math.nan, math.nan) for one in found]
    kick = [
        0.0 if one.least is not None and one.least.depth >= one.small.depth else c.kick
        for one, c in zip(found, least, strict=True)
    ]
    most = max(1, *(len(one.cycles) for one in found))
    over = ("spindle_speed", "cycle")

    def table(name: str, factor: float = 1.0) -> Real:
        rows = [[factor * getattr(c, name) for c in one.cycles] for one in found]
        return np.array([row + [math.nan] * (most - len(row)) for row in rows])

    return {
        "lower_limit_depth": ("spindle_speed", np.array([1e3 * c.depth for c in least]), {"units": "mm"}),
        "lower_chatter_frequency": ("spindle_speed", np.array([c.chatter for c in least]), {"units": "Hz"}),
        "kick": ("spindle_speed", np.array(kick, dtype=float), {"units": "N s"}),
        "cycle_depth": (over, table("depth", 1e3), {"units": "mm"}),
        "cycle_amplitude": (over, table("amplitude")),
        "cycle_kick": (over, table("kick"), {"units": "N s"}),
        "cycle_swing": (over, table("swing"), {"units": "1"}),
    }


def _refusals(found: Sequence[Limits]) -> list[str]:
    """Say why limits are not known, each reason once."""
    counts = Counter(one.why for one in found if one.why)
    out = []
    for why, count in counts.items():
        asked = list(dict.fromkeys(one.where for one in found if one.why == why))
        text = asked[0] if len(asked) == 1 else f"{asked[0]} ... {asked[-1]}"
        out.append(f"{count} of {len(found)} limits are not known, at {why} (asked: {text}): they are left empty")
    return out


def _with_band(out: xr.Dataset, found: Sequence[Limits], errors: Real, known: Uncertainty | None) -> xr.Dataset:
    """Add quantiles and safe depth: log-normal, in first order."""
    if known is None or np.isnan(errors[:, 0]).all():
        return out
    whole = np.sqrt(errors**2 + known.coefficients**2)
    names, factors = quantile_factors()
    small = out["limit_depth"].values
    quantiles = small * np.exp(factors[:, None] * whole[:, 0])
    out["limit_depth_quantile"] = (("quantile", "spindle_speed"), quantiles)
    out["safe_depth"] = ("spindle_speed", quantiles[0], {"units": "mm"})
    if "lower_limit_depth" in out:
        lower = out["lower_limit_depth"].values * np.exp(factors[:, None] * whole[:, 1])
        out["lower_limit_depth_quantile"] = (("quantile", "spindle_speed"), lower, {"units": "mm"})
        # Whoever cuts at a safe depth does not want to know of kicks.
        out["safe_depth"] = ("spindle_speed", np.fmin(quantiles[0], lower[0]), {"units": "mm"})
    return out.assign_coords(quantile=names).assign_attrs(safe_probability=SAFE)
