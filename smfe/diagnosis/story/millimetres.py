"""What a set of values means in millimetres: limit depths of the cuts that a campaign asks for, whatever was tested.

An axis is linearised for small vibration about the feed of each cut, ``feed_per_tooth teeth n``, with all other
directions rigid; modes carry no sensor and turn with the spindle. Cutting forces change the coefficients, and the
machine is that of the ``[[lobes]]``; a drive record changes friction, gains and dead time of an axis of ``[machine]``.
All by the zero-order method.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from process.cut.engagement import AnyEngagement, engagement
from process.cut.force import NO_DAMPING, CuttingCoefficients, ProcessDamping
from process.cut.tool import Tool
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import Andersson
from process.labels import at_tool, make_compliance
from process.machine.machine import FeedAxis, Machine
from process.machine.modes import ModalModel
from process.types import Real
from smfe.campaign import Campaign
from smfe.diagnosis.cutting.forces import CuttingForces
from smfe.diagnosis.cutting.limits import CuttingLimits, Limit, material_of
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.frf.modes import AS_FIRST, ModalFrfs, Standing
from smfe.diagnosis.frf.noise import Excited, kept
from smfe.diagnosis.frf.workshop import SENSORS, measured
from smfe.diagnosis.inference.problem import Family, Values
from smfe.diagnosis.judgement.finding import Pocket, StableDepth
from smfe.diagnosis.machine.family import MachineOfAxes
from smfe.diagnosis.story.words import listed
from stability import zero_order

SPEEDS = 41
"""Spindle speeds of a request at which the depth is computed, at most."""

FEW_SPEEDS = 11
"""Spindle speeds of a request at which a change of the depth is looked for, at most."""

DEPTHS_KEPT = 500
"""Machines whose depths are kept."""

ENOUGH_LINES = 50
"""Lines of a compliance from which on a limit is computed from it."""

_STEP, _LOWEST, _REACH = 0.5, 2.0, 4.0  # Hz, Hz, times the locked frequency
_STEEP = 6e5
"""Steepness of the sign of a friction force [s/m]: at any feed it slides."""


@dataclass(frozen=True)
class Asked:
    """A cut that a campaign asks for, at some spindle speeds."""

    where: str  # lobes or cutting test
    cut: str  # "down", "up" or "central"
    width: float  # [m]
    feed_per_tooth: float  # [m]
    speeds: Sequence[float]  # [rpm]
    sources: tuple[str, ...] = ()  # measurements or models that the lobes are asked of
    controller: str | None = None
    standing: Standing = AS_FIRST  # where, when and how hard shaken a machine of modes cuts
    flank: ProcessDamping = NO_DAMPING  # how worn the lobes are asked for
    engaged: AnyEngagement | None = None  # where the cut is none of the three kinds

    def arc(self, tool: Tool) -> AnyEngagement:
        """Return the engagement."""
        return engagement(self.cut, self.width, tool.diameter) if self.engaged is None else self.engaged


Depths = Callable[[Values | None, Asked], Sequence[float]]
"""Limit depths [mm] of a cut at its speeds with a set of values; None: as the campaign gives them.

Infinite without a limit, zero where the machine vibrates without any cut.
"""


def asked(campaign: Campaign, most: int = SPEEDS) -> Iterator[Asked]:
    """Yield the cuts that a campaign asks for: its lobes at so many speeds at most, and its cutting tests."""
    for r in campaign.lobes:
        pick = np.unique(np.linspace(0, r.spindle_speed.size - 1, most).round().astype(int))
        speeds = r.spindle_speed[pick].tolist()
        cut = (r.name, r.cut, r.width_of_cut, r.feed_per_tooth)
        yield Asked(*cut, speeds, r.measurements, r.controller, flank=r.process_damping, engaged=r.engaged)
    for t in (t for t in campaign.cutting_tests if t.feed_per_tooth is not None and t.depth_of_cut > 0.0):
        sources = campaign.lobes[0].measurements if campaign.lobes else ()
        speeds = [t.spindle_speed]
        yield Asked(t.file.name, t.cut, t.width_of_cut, t.stated_feed_per_tooth, speeds, sources, t.controller)


def depths_of(
    campaign: Campaign,
    family: Family,
    compliances: Mapping[str, xr.Dataset] | None = None,
    as_shown: bool = False,
) -> tuple[Depths | None, str]:
    """Return how depths follow from values, or None and why no depth can be given, a sentence.

    Parameters
    ----------
    campaign : Campaign
        With tool, work material, and lobes or cutting tests.
    family : Family
        What was tested.
    compliances : mapping of str to xarray.Dataset, optional
        Measurement -> compliance, for what says nothing of the machine itself.
    as_shown : bool, optional
        Of modes: depths of what sensors and hits make of the machine, which is what lobes of a measurement show.
    """
    lost = [
        name
        for name, there in (
            ("[tool]", campaign.tool is not None),
            ("[material]", campaign.coefficients is not None),
            ("[[lobes]] or cutting tests with their feed", any(True for _ in asked(campaign))),
        )
        if not there
    ]
    if isinstance(family, CuttingForces):
        return _of_forces(campaign, family, compliances or {}, lost)
    if isinstance(family, DriveRecordFamily):
        return _of_drive(campaign, family, lost)
    if lost:
        return None, f"No depth in millimetres: the campaign has no {', no '.join(lost)}."
    if isinstance(family, MachineFrfs):
        return _of_axis(campaign, family), ""
    if isinstance(family, CuttingLimits):
        return _of_limits(campaign, family), ""
    if isinstance(family, ModalFrfs):
        return _of_modes(campaign, family, as_shown), ""
    return None, ""


def given_values(family: Family) -> dict[str, float]:
    """Return all parameters of a family as the campaign gives them (SI)."""
    return {p.name: p.start for p in (*family.nuisances, *(p for c in family.causes for p in c.parameters))}


@dataclass(frozen=True)
class Stands:
    """How the machine may stand in the cut, as it was measured: at either end of the stroke, late, hardest shaken."""

    first_place: float = 0.0  # where it was measured first [m]
    every: tuple[Standing, ...] = (AS_FIRST,)  # that it was first measured in comes first

    def words(self, standing: Standing) -> str:
        """Return how the machine stands, for people; of the first all that the others change."""
        if standing != AS_FIRST:
            if standing.position is not None:
                return _at_place(standing.position)
            return "at the end of the session" if standing.order > 0.0 else "at the highest level"
        return ", ".join(
            words
            for words, changed in (
                (_at_place(self.first_place), any(s.position is not None for s in self.every)),
                ("at the beginning of the session", any(s.order > 0.0 for s in self.every)),
                ("at the lowest level", any(s.hardest for s in self.every)),
            )
            if changed
        )


def _at_place(position: float) -> str:
    return f"at {1e3 * position:.4g} mm of the stroke"


def stands_of(family: Family) -> Stands:
    """Return how the machine of a family may stand in the cut: for modes and for an axis, else as it is."""
    if not isinstance(family, MachineFrfs | ModalFrfs):
        return Stands()
    measured = [c for c in family.conditions if isinstance(c.data, Excited)]
    places = [float(c.settings["position"]) for c in measured if "position" in c.settings]
    first = places[0] if places else 0.0
    if isinstance(family, ModalFrfs):
        return Stands(first, family.standings)
    found = [Standing(position=p) for p in sorted({min(places, default=first), max(places, default=first)} - {first})]
    latest = max((float(c.settings.get("order", 0.0)) for c in measured), default=0.0)
    return Stands(first, (AS_FIRST, *found, *([Standing(order=latest)] if latest > 0.0 else [])))


def stable_depths(
    campaign: Campaign,
    depths: Depths,
    values: Values,
    before: Values | None = None,
    most: int = SPEEDS,
    stands: Stands = Stands(),
) -> tuple[StableDepth, ...]:
    """Return the limit depths that a campaign asks for, before and after, where depths follow from values.

    Those of lobes are given however the machine may stand in the cut, as far as that changes them; those of cutting
    tests, of which nobody says where they were made, as it was first measured.
    """
    assert campaign.tool is not None
    found = []
    requests = {r.name for r in campaign.lobes}
    for a in asked(campaign, most):
        feed = 1e3 * a.feed_per_tooth * campaign.tool.teeth
        kept_rows: dict[Standing, tuple[tuple[float, float], ...]] = {}
        for standing in stands.every if a.where in requests else (AS_FIRST,):
            there = replace(a, standing=standing)
            rows = tuple(zip(depths(before, there), depths(values, there), strict=True))
            if not kept_rows or not _alike(rows, kept_rows[AS_FIRST]):
                kept_rows[standing] = rows
        shown = replace(stands, every=tuple(kept_rows))
        for standing, rows in kept_rows.items():
            words = shown.words(standing)
            found += [StableDepth(a.where, n, feed * n, *both, words) for n, both in zip(a.speeds, rows, strict=True)]
    return tuple(found)


def _alike(rows: Sequence[tuple[float, float]], others: Sequence[tuple[float, float]]) -> bool:
    return bool(np.allclose(rows, others, rtol=1e-3, atol=1e-6))


def cost_of(
    campaign: Campaign,
    family: Family,
    compliances: Mapping[str, xr.Dataset] | None = None,
    as_shown: bool = False,
) -> Callable[[Values, Values], float | None]:
    """Return a function of two sets of values (SI): the change of the limit depths that were asked for [1].

    It is the larger of that of the least depth over all speeds and of the rms over the speeds of the relative changes,
    each counted as 100 % at most: a lobe that moves by a little changes single speeds a lot. It is the largest over all
    places, times and levels at which the machine was measured (`stands_of`): a stiffness that depends on the position
    changes nothing at the first of them. It returns None where no cut is given, or no depth follows. Of modes they are
    those of the machine, or `as_shown` by its sensors.
    """
    depths, _ = depths_of(campaign, family, compliances, as_shown)
    cuts = [] if depths is None else list(asked(campaign, FEW_SPEEDS))
    standings = stands_of(family).every
    every: dict[tuple[float, ...], Real] = {}

    def of(values: Values) -> Real:
        """Depths at each standing, (standings, cuts and speeds)."""
        assert depths is not None
        key = tuple(values.values())
        if key not in every:
            every[key] = np.array(
                [[d for a in cuts for d in depths(values, replace(a, standing=s))] for s in standings]
            )
        return every[key]

    def cost(before: Values, after: Values) -> float | None:
        if not cuts:
            return None
        found = [x for a, b in zip(of(before), of(after), strict=True) if (x := _size_of_change(a, b)) is not None]
        return max(found, default=None)

    return cost


def _size_of_change(before: Real, after: Real) -> float | None:
    """Return the size of a change of depths, as `cost_of` counts it; None where none is known."""
    known = np.isfinite(before) & np.isfinite(after) & (before > 0.0)
    if not known.any():
        return None
    a, b = before[known], after[known]
    least = abs(float(b.min() / a.min()) - 1.0)
    return max(least, float(np.sqrt(np.mean(np.minimum(np.abs(b / a - 1.0), 1.0) ** 2))))


def largest_change(rows: Sequence[StableDepth]) -> tuple[float, float] | None:
    """Return the largest relative change of a depth, and the same in millimetres; None where none is known."""
    known = [r for r in rows if math.isfinite(r.before_mm) and math.isfinite(r.after_mm) and r.before_mm > 0.0]
    if not known:
        return None
    worst = max(known, key=lambda r: _change(r.before_mm, r.after_mm))
    return _change(worst.before_mm, worst.after_mm), worst.after_mm - worst.before_mm


def _change(before: float, after: float) -> float:
    if before == after or (math.isinf(before) and math.isinf(after)):
        return 0.0
    if math.isinf(before) or math.isinf(after) or before == 0.0:
        return 1.0
    return abs(after / before - 1.0)


def pockets(campaign: Campaign, rows: Sequence[StableDepth]) -> tuple[Pocket, ...]:
    """Return of each request the speed at which most is removed, by the simulation and by the extended model.

    A speed counts with the smallest depth of itself and its neighbours, a step of the request to either side. A
    request at fewer than three speeds has none, and none where a depth has no limit there. Where the depth depends on
    how the machine stands, the smallest counts: a pocket has to hold over the stroke and the session.
    """
    found = []
    for request in campaign.lobes:
        own = _smallest([r for r in rows if r.where == request.name])
        if len(own) < 3 or campaign.tool is None:
            continue
        speed = np.array([r.spindle_speed_rpm for r in own])
        least = [_with_neighbours([getattr(r, name) for r in own]) for name in ("before_mm", "after_mm")]
        if request.maximum_depth is not None:
            least = [np.minimum(d, 1e3 * request.maximum_depth) for d in least]
        if not all(np.isfinite(d).all() for d in least):
            continue
        before, after = (int(np.argmax(d * speed)) for d in least)
        found.append(
            Pocket(
                request.name,
                float(speed[before]),
                float(least[0][before]),
                float(least[1][before]),
                float(speed[after]),
                float(least[1][after]),
            )
        )
    return tuple(found)


def _smallest(rows: Sequence[StableDepth]) -> list[StableDepth]:
    """Return the smallest depths at each speed, however the machine stands."""
    found: dict[float, StableDepth] = {}
    for r in rows:
        other = found.get(r.spindle_speed_rpm, r)
        least = min(r.before_mm, other.before_mm), min(r.after_mm, other.after_mm)
        found[r.spindle_speed_rpm] = replace(r, before_mm=least[0], after_mm=least[1], at="")
    return list(found.values())


def _with_neighbours(depth: Sequence[float]) -> Real:
    d = np.concatenate([[math.inf], depth, [math.inf]])
    return np.asarray(np.minimum(np.minimum(d[:-2], d[1:-1]), d[2:]))


# --- Of each family.


def _of_axis(campaign: Campaign, family: MachineFrfs) -> Depths:
    tool, given = _cut_of(campaign)
    baseline = family.baseline
    start = {p.name: p.start for p in (*baseline.nuisances(), *(p for c in baseline.causes() for p in c.parameters))}
    axis, high = baseline.axis, _REACH * baseline.drive.locked_frequency
    controller = _controller(campaign, baseline)
    first = stands_of(family).first_place
    found: dict[tuple[object, ...], float] = {}

    def depths(values: Values | None, a: Asked) -> list[float]:
        v, material = start if values is None else values, material_of(given, values or {})
        place = first if a.standing.position is None else a.standing.position
        settings = {"position": place, "order": a.standing.order}

        def at(rpm: float) -> float:
            feed = a.feed_per_tooth * tool.teeth * rpm / 60.0
            machine = baseline.effective(v, settings, feed)

            def make() -> float:
                point = baseline.machine(machine).at({axis: feed}, controller)
                if point.unstable_poles() > 0:
                    return 0.0
                phi = point.compliance(np.arange(_LOWEST, high, _STEP), [axis], [axis])
                return float(zero_order(phi, tool, a.arc(tool), material, [rpm], a.flank)["limit_depth"].values[0])

            # Most machines are the same at every place and at any time.
            return kept(found, (machine, material, a.where, rpm), make, SPEEDS * DEPTHS_KEPT)

        return [at(rpm) for rpm in a.speeds]

    return depths


def _controller(campaign: Campaign, baseline: AxisBaseline) -> str:
    """Return the controller of the first measurement that has one of the baseline's."""
    named = [m.controller for m in campaign.measurements if m.controller in baseline.servos]
    return named[0] if named and named[0] is not None else next(iter(baseline.servos))


def _of_modes(campaign: Campaign, family: ModalFrfs, as_shown: bool) -> Depths:
    tool, material = _cut_of(campaign)
    start, f = given_values(family), family.fine_frequency()
    found: dict[tuple[object, ...], list[float]] = {}

    def depths(values: Values | None, a: Asked) -> list[float]:
        v = start if values is None else values

        def at(rpm: float, speeds: Sequence[float]) -> list[float]:
            feed = a.feed_per_tooth * tool.teeth * rpm / 60.0
            how = (rpm, feed, a.controller or "", a.standing)
            machine, slides = family.as_it_cuts(v, *how)
            # Most machines are the same wherever, whenever and however hard shaken they cut.
            level = a.standing.hardest and bool(machine.slip or machine.hardening or machine.iwan)

            def make() -> list[float]:
                there = family.in_the_cut(v, rpm, f, *how[1:])
                phi = make_compliance(f, measured(there, f, v) if as_shown else there)
                limits = zero_order(phi, tool, a.arc(tool), material, list(speeds), a.flank)["limit_depth"]
                return [float(d) for d in limits.values]

            sensors = tuple(v.get(name, 0.0) for name in SENSORS) if as_shown else ()
            return kept(found, (machine, slides, level, a.where, sensors, *speeds), make, DEPTHS_KEPT)

        turning = any(v.get(name) for name in v if "bearings" in name or "gyroscopic" in name)
        each = turning or isinstance(family, MachineOfAxes)
        return [d for rpm in a.speeds for d in at(rpm, [rpm])] if each else at(a.speeds[0], a.speeds)

    return depths


def _of_limits(campaign: Campaign, family: CuttingLimits) -> Depths:
    """Depths of limits: where one was found, what the family compares with it; elsewhere that of zero order."""
    tool, _ = _cut_of(campaign)
    found = {(k.spindle_speed, k.feed_per_tooth, k.arc or family.arc): c for c, k in family.measured}

    def depth(values: Values, limit: Limit) -> float:
        measured = found.get((limit.spindle_speed, limit.feed_per_tooth, limit.arc or family.arc))
        if measured is None:
            crossings = family.limits_at(limit, values)[0]
            return float(crossings[0]) if crossings.size else math.inf
        try:
            return family.depth(measured, values)
        except InputError:  # it does not chatter at any depth
            return math.inf

    def depths(values: Values | None, a: Asked) -> list[float]:
        limits = [Limit(rpm, feed_per_tooth=a.feed_per_tooth, arc=a.arc(tool)) for rpm in a.speeds]
        return [1e3 * depth(values or {}, limit) for limit in limits]

    return depths


def _of_forces(
    campaign: Campaign, family: CuttingForces, compliances: Mapping[str, xr.Dataset], lost: Sequence[str]
) -> tuple[Depths | None, str]:
    """Depths of cutting forces: the coefficients as found, and the machine of the lobes."""
    machines: dict[str, xr.Dataset | ModalModel] = {m.name: m.modal for m in campaign.models}
    machines |= {n: at_tool(c) for n, c in compliances.items() if c.sizes["frequency"] >= ENOUGH_LINES}
    machine = next((machines[n] for a in asked(campaign) for n in a.sources if n in machines), None)
    if lost or machine is None:
        missing = [*lost, *(["[[model]] or measured compliance that [[lobes]] name"] if machine is None else [])]
        return None, (
            f"No depth in millimetres: cutting forces alone say nothing of how far the tool gives way, and the "
            f"campaign has no {', no '.join(missing)}."
        )
    tool, material = _cut_of(campaign)

    def depths(values: Values | None, a: Asked) -> list[float]:
        one = next((machines[n] for n in a.sources if n in machines), machine)
        found = material if values is None else coefficients_found(family, material, values)
        limits = zero_order(one, tool, a.arc(tool), found, list(a.speeds), a.flank)["limit_depth"]
        return [float(d) for d in limits.values]

    return depths, ""


def coefficients_found(family: CuttingForces, material: CuttingCoefficients, values: Values) -> CuttingCoefficients:
    """Return the cutting coefficients, and edge forces, of a set of values of cutting forces."""
    cutting = {name: values.get(name, getattr(material, name)) for name in ("Ktc", "Krc", "Kac")}
    edge = dict(zip(("Kte", "Kre", "Kae"), family.edge, strict=True))
    return replace(material, **cutting, **{name: values.get(name, k) for name, k in edge.items()})


def _of_drive(campaign: Campaign, family: DriveRecordFamily, lost: Sequence[str]) -> tuple[Depths | None, str]:
    """Depths of a drive record: friction, gains and dead time as found, in an axis of ``[machine]``."""
    axis = getattr(campaign.baseline, "axis", "x")
    machine = campaign.machine_model if isinstance(campaign.machine_model, Machine) else None
    there = machine is not None and axis in machine.axes
    if lost or machine is None or not there:
        missing = [*lost, *([] if there else [f"[machine.axis.{axis}] (masses, servo, modes)"])]
        return None, (
            f"No depth in millimetres: the drive force alone says nothing of how far the tool gives way, and the "
            f"campaign has no {', no '.join(missing)}."
        )
    tool, material = _cut_of(campaign)
    given = given_values(family)

    def depths(values: Values | None, a: Asked) -> list[float]:
        one = machine if values is None else _with_axis(machine, axis, values, given["loop_delay.delay"])
        controllers = one.axes[axis].servo
        controller = a.controller or (next(iter(controllers)) if isinstance(controllers, Mapping) else None)
        found = []
        for rpm in a.speeds:
            point = one.at({axis: a.feed_per_tooth * tool.teeth * rpm / 60.0}, controller)
            silent = point.unstable_poles() > 0
            limit = None if silent else zero_order(point, tool, a.arc(tool), material, [rpm], a.flank)["limit_depth"]
            found.append(0.0 if limit is None else float(limit.values[0]))
        return found

    return depths, ""


def _with_axis(machine: Machine, axis: str, values: Values, delay: float) -> Machine:
    """Return a machine whose axis has friction, gains and dead time of a drive record that was given a delay [s]."""
    old, later = machine.axes[axis], values["loop_delay.delay"] - delay
    servo: Servo | dict[str, Servo] | None = (
        {name: servo_found(s, values, later) for name, s in old.servo.items()}
        if isinstance(old.servo, Mapping)
        else None
        if old.servo is None
        else servo_found(old.servo, values, later)
    )
    return replace(machine, axes={**machine.axes, axis: FeedAxis(servo, friction_found(values))})


def servo_found(servo: Servo, values: Values, later: float) -> Servo:
    """Return a servo with the gains of a drive record, and with more dead time [s]."""
    return replace(
        servo,
        Kp=servo.Kp * (1.0 + values.get("servo_gains.velocity", 0.0)),
        Kv=servo.Kv * (1.0 + values.get("servo_gains.position", 0.0)),
        delay=max(servo.delay + later, 0.0),
    )


def friction_found(values: Values) -> Andersson:
    """Return the friction that a drive record found, as a Stribeck curve of each direction."""
    force, boost = values.get("coulomb.force", 0.0), values.get("stribeck.boost", 0.0)
    speed = values.get("stribeck.speed", 0.02)
    apart, exponent = values.get("asymmetry.viscous", 0.0), values.get("stribeck.exponent", 1.0)
    forth, back = (
        Andersson(force, force + boost, speed, max(values["viscous"] + side * apart, 0.0), _STEEP, exponent)
        for side in (1, -1)
    )
    return forth if apart == 0.0 else replace(forth, negative=back)


def _cut_of(campaign: Campaign) -> tuple[Tool, CuttingCoefficients]:
    if campaign.tool is None or campaign.coefficients is None:
        missing = [n for n, x in (("[tool]", campaign.tool), ("[material]", campaign.coefficients)) if x is None]
        raise InputError(f"a depth needs {listed(missing)}; add them")
    return campaign.tool, campaign.coefficients
