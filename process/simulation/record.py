"""A machine prepared for `process.simulation._machine_kernels`, its integration in time, and the record of it."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import signal

from process.errors import InputError
from process.labels import AXES, UNITS, axis_index
from process.machine.structure import Structure
from process.simulation import _machine_arrays as arrays
from process.simulation import _machine_kernels as kernels
from process.simulation.packing import (
    Sampled,
    commanded_forces,
    pack_cut,
    pack_elements,
    pack_linear,
    pack_servos,
    scratch,
    stairs,
)
from process.simulation.problem import Problem
from process.simulation.rules import RULES
from process.simulation.step_maps import System, gains, reach
from process.types import Real
from process.units import from_si


class PreparedMachine(NamedTuple):
    """All of a problem that does not depend on how large its forces are, with steps of `step` [s]."""

    problem: Problem
    system: System
    elements: arrays.Elements
    state: Real
    servos: arrays.Servos
    ring: int
    linear: arrays.Linear
    step: float
    steps: int


def prepare(p: Problem, system: System, step: float, steps: int) -> PreparedMachine:
    """Pack a problem for so many steps [s]."""
    elements, state = pack_elements(p, system)
    servos, ring = pack_servos(p, system, step)
    linear = pack_linear(p, system, elements, step, steps)
    return PreparedMachine(p, system, elements, state, servos, ring, linear, step, steps)


def prepare_again(known: PreparedMachine, p: Problem, steps: int) -> PreparedMachine:
    """Pack a problem that has the linear part of one that is prepared, and one structure, for so many steps."""
    elements, state = pack_elements(p, known.system)
    linear = known.linear._replace(places=np.zeros(steps))
    return known._replace(problem=p, elements=elements, state=state, linear=linear, steps=steps)


def integrate(
    r: PreparedMachine,
    given: arrays.Given,
    forces: list[Sampled],
    *,
    keep: int,
    accuracy: float,
    rest: float = RULES.at_rest,
    held: tuple[float, float] = (0.0, 0.0),
) -> Run:
    """Integrate under forces over time, as packed and as sampled.

    Parameters
    ----------
    r : PreparedMachine
        The machine.
    given, forces
        From `process.simulation.packing.pack_forces`.
    keep : int
        Steps a sample.
    accuracy : float
        See `process.simulation.machine.ACCURACY`.
    rest : float, optional
        See `SimulationRules.at_rest`.
    held : (float, float), optional
        See `process.simulation.machine.RepeatedImpact.displacement`.

    Raises
    ------
    InputError
        When friction and joints cannot be solved for, or the tool leaves the range of 1 m.
    """
    inputs = np.zeros((r.steps, r.linear.reach.shape[0] + r.elements.kind.size))
    states = np.zeros((r.steps, r.system.size))
    work = scratch(r.linear, r.elements, r.servos, r.ring, r.state)
    cut = pack_cut(r.problem, r.step)
    end, done = kernels.integrate(
        r.linear, r.elements, r.servos, given, work, r.step, accuracy, np.array([rest, *held]), cut, states, inputs
    )
    if end == arrays.NOT_SOLVED:
        raise InputError(
            f"friction and joints cannot be solved for at {done * r.step:.4g} s even with steps of "
            f"{r.step / 2**RULES.halvings * 1e6:.3g} us; give a shorter step, or a law that is less steep"
        )
    _require_near(r.problem, states[: min(done + 1, r.steps), : r.system.n], end, done, r.step)
    worst, largest = work.tally[arrays.WORST], work.tally[arrays.LARGEST]
    share = float(worst / largest) if largest > 0.0 else 0.0
    lost, thickest = float(work.cutting[arrays.LOST]), float(work.cutting[arrays.THICKEST])
    # Within a step forces over time are not what their parabolas are at its start: `as_record` adds them as sampled.
    pushes = list(zip(given.target.tolist(), forces, strict=False))
    for (target, _), values in zip(pushes, given.values, strict=False):
        n = min(values.shape[0], done)
        inputs[:n, target] -= values[:n, 0]
    return Run(states, inputs, pushes, r.step, keep, r.linear.places, share, lost, thickest, done)


def _require_near(p: Problem, coordinates: Real, end: int, done: int, step: float) -> None:
    """Refuse a tool that left the range of 1 m."""
    # Coordinates that are small enough bound the tool without its path.
    farthest = np.abs(p.structures[0].tool).sum(axis=1).max() * np.abs(coordinates).max(initial=0.0)
    if end == arrays.DONE and farthest < 1.0:
        return
    tip = np.abs(coordinates @ p.structures[0].tool.T)
    if end == arrays.RAN_AWAY or not tip.max(initial=0.0) < 1.0:
        late = np.flatnonzero(~(tip.max(axis=1) < 1.0))
        when = (late[0] if late.size else done) * step
        raise InputError(f"the tool left the range of 1 m after {when:.3g} s; it is hit too hard, or unstable")


# --- From states and inputs to a record: channels, low-pass, labels, and a verdict on how it ends.


_DIRECTIONS = 3
_NIL = 1e-12


class Run(NamedTuple):
    """Inputs and states at the start of each step, forces over time (input, as sampled) apart, and how it went.

    After `done` steps all was at rest, and is.
    """

    states: Real
    inputs: Real
    forces: list[tuple[int, Sampled]]
    step: float
    keep: int
    places: Real
    energy_error: float
    lost: float
    thickest: float
    done: int


@lru_cache(maxsize=32)
def _taps(factor: int) -> tuple[NDArray[np.int64], Real]:
    """Low-pass for every `factor`-th sample: windowed sinc of 20 samples of the slow rate, of gain 1 at 0 Hz.

    Where and how much, from the middle to one side; a sinc is zero at every `factor`-th.
    """
    half = RULES.margin * factor
    taps = signal.firwin(2 * half + 1, 1.0 / factor, window="hamming")[half:]
    at = np.flatnonzero(np.abs(taps) > _NIL)
    return at, np.ascontiguousarray(taps[at])


def _slow(channels: Real, factor: int, samples: int) -> Real:
    """Low-pass channels (c, n) without phase and keep every `factor`-th sample, (c, samples); zero before and after."""
    out = np.zeros((channels.shape[0], samples))
    if factor == 1:
        m = min(samples, channels.shape[1])
        out[:, :m] = channels[:, :m]
    else:
        kernels.low_pass(np.ascontiguousarray(channels), *_taps(factor), factor, out)
    return out


def moving_axes(p: Problem) -> list[int]:
    """Numbers of the axes along which the tool can move or is pushed, or that have a slide; all in a cut."""
    moves = [any(s.tool[i].any() for s in p.structures) for i in range(len(AXES))]
    return [i for i, moving in enumerate(moves) if moving or AXES[i] in p.run.tool_axes or AXES[i] in p.machine.axes]


def _tool_rows(p: Problem, system: System, at: int, axes: list[int]) -> Real:
    """Rows of displacement and acceleration of the tool along axes, for (state, inputs, elements) of a structure."""
    n, tools, (a, b) = system.n, len(p.run.tool_axes), system.matrices[at]
    tool = p.structures[at].tool[axes]
    targets = [tools + i for i in system.nonlinear] + [tools + len(p.servos) + k for k in range(len(p.machine.joints))]
    direct = tool @ b[n : 2 * n]
    place = np.zeros((len(axes), system.size + direct.shape[1] + len(targets)))
    place[:, :n] = tool
    push = np.hstack([tool @ a[n : 2 * n], direct, direct[:, targets]])
    return np.vstack([place, push])


def _slide_rows(p: Problem, system: System, structure: Structure, axes: list[int], width: int) -> Real:
    """Rows of position and drive force of each slide, of the velocities of the tool along axes and of each slide."""
    n, count, slides = system.n, len(p.servos), structure.slide_rows()
    rows = np.zeros((3 * count + len(axes), width))
    rows[:count, :n], rows[2 * count : 3 * count, n : 2 * n] = slides, slides
    rows[3 * count :, n : 2 * n] = structure.tool[axes]
    held = gains(p, system, structure)
    for i in range(count):
        commanded = p.run.commanded and p.run.control is None and i in held
        if not commanded:
            rows[count + i, system.size + len(p.run.tool_axes) + i] = 1.0
        if commanded or i in system.prompt:
            rows[count + i, : system.size] = -held[i]
    return rows


def _channels(run: Run, rows: list[Real]) -> Real:
    """Rows of each structure times states and inputs at each step, (c, steps), blended along the path."""
    out = np.zeros((rows[0].shape[0], run.states.shape[0]))
    for row, share in zip(rows, _shares(run.places, len(rows)), strict=True):
        kernels.combine(row, run.states, run.inputs, share, out)
    return out


def _shares(places: Real, points: int) -> list[Real]:
    """Share of each point of the path in the structure at some places."""
    if points == 1:
        return [np.ones(places.size)]
    return [np.clip(1.0 - np.abs(places - k), 0.0, 1.0) for k in range(points)]


def _pushes(run: Run, forces: list[Sampled], samples: int) -> Real:
    """Forces over time as the record has them, (forces, samples)."""
    parts = 1 if run.keep == 1 else RULES.parts
    out = np.zeros((len(forces), samples))
    for row, force in zip(out, forces, strict=True):
        plain = force.smooth[:: RULES.parts // parts]
        if force.at.size:
            plain = plain + stairs(force.at * parts, force.height, plain.size)
        row[:] = _slow(plain[None], run.keep * parts if parts > 1 else 1, samples)[0]
    return out


def _add_pushes(p: Problem, run: Run, axes: list[int], slow: Real, force: Real) -> None:
    """Add forces over time to the force on the tool (3, samples), the drive forces, and the acceleration of the tool.

    slow: displacement and acceleration of the tool along axes, positions and drive forces of the slides.
    """
    m, tools, samples = len(axes), len(p.run.tool_axes), force.shape[1]
    targets = [target for target, _ in run.forces]
    if not targets:
        return
    pushes = shown = _pushes(run, [one for _, one in run.forces], samples)
    if p.run.commanded:
        drives = _pushes(run, commanded_forces(p, run.step, run.states.shape[0]), samples)
        shown = np.vstack([pushes[: len(p.run.forces)], drives])
    rows = axis_index(p.run.tool_axes)
    for target, push in zip(targets, shown, strict=True):
        if target < tools:
            force[rows[target]] += push
        elif slow.shape[0] > 2 * m:
            slow[2 * m + len(p.servos) + target - tools] += push
    place = np.arange(samples) / samples * (len(p.structures) - 1.0)
    for share, structure in zip(_shares(place, len(p.structures)), p.structures, strict=True):
        if share.any():
            prompt = structure.tool[axes] @ np.linalg.solve(structure.mass, reach(p, structure)[targets].T)
            slow[m : 2 * m] += prompt @ (share * pushes)


def _hold(drive_forces: Real, every: int) -> None:
    """Weigh drive forces (slides, steps) that sampled servos hold for so many steps as integrals do."""
    ticks = np.arange(0, drive_forces.shape[1], every)
    for row in drive_forces:
        row[:] = stairs(ticks.astype(float), np.diff(row[ticks], prepend=0.0), row.size)


def _cutting_force(p: Problem, run: Run, samples: int) -> Real:
    """Force of the cut on the tool, (3, samples)."""
    if p.run.cut is None:
        return np.zeros((3, samples))
    return _slow(run.inputs[:, :3].T, run.keep, samples)


def displacement_of(p: Problem, run: Run) -> Real:
    """Displacement of the tool (3, done) at the start of each step until nothing moves any more."""
    n = p.structures[0].size
    seen = run._replace(states=run.states[: run.done], inputs=run.inputs[: run.done], places=run.places[: run.done])
    rows = [np.hstack([s.tool, np.zeros((3, run.states.shape[1] + run.inputs.shape[1] - n))]) for s in p.structures]
    return _channels(seen, rows)


def as_record(p: Problem, system: System, run: Run, sample_rate: float, poles: int) -> xr.Dataset:
    """Low-pass and label the channels; put the ramps and the steady friction back; add the verdict."""
    samples, axes = round(p.run.total * sample_rate), moving_axes(p)
    rows = []
    for k, structure in enumerate(p.structures):
        tool = _tool_rows(p, system, k, axes)
        rows.append(np.vstack([tool, _slide_rows(p, system, structure, axes, tool.shape[1])]))
    every, m, count = _channels(run, rows), len(axes), len(p.servos)
    if p.run.control is not None and run.keep > 1:
        _hold(every[2 * m + count : 2 * (m + count)], max(1, round(p.run.control.period / run.step)))
    if p.run.control is not None and p.run.commanded:
        # What is held now was commanded some periods ago.
        for k, axis in enumerate(p.machine.axes):
            row, ahead = every[2 * m + count + k], round(p.lateness(axis) / run.step)
            row[: row.size - ahead] = row[ahead:]
    slow, force = _slow(every[: 2 * (m + count)], run.keep, samples), _cutting_force(p, run, samples)
    _add_pushes(p, run, axes, slow, force)
    record = _labelled(p, sample_rate, axes, force[axes], slow)
    record.attrs.update(_attributes(p, run))
    at_steps = every[:, : samples * run.keep]
    swings, speeds = at_steps[:m], at_steps[2 * (m + count) :]
    record.attrs.update(_verdict(p, swings, speeds[count:], speeds[:count], run.step, poles))
    return record


@lru_cache(maxsize=16)
def _coordinates(samples: int, sample_rate: float, axes: tuple[int, ...]) -> xr.Coordinates:
    """Return time and axes of a record. To index them costs as much as to label all channels."""
    time = xr.Variable("time", np.arange(samples) / sample_rate, {"units": UNITS["time"]})
    return xr.Coordinates({"time": time, "axis": [AXES[i] for i in axes]})


def _labelled(p: Problem, sample_rate: float, axes: list[int], force: Real, slow: Real) -> xr.Dataset:
    """Label force (m, n) and channels: displacement (m), acceleration (m), positions and drive forces of the slides.

    Not by `process.labels.make_record`, whose checks of what comes from outside cost as much as a short run.
    """
    m, count = len(axes), len(p.servos)
    coordinates = _coordinates(slow.shape[1], sample_rate, tuple(axes))
    time = coordinates["time"].values
    values = {"force": force, "displacement": slow[:m], "acceleration": slow[m : 2 * m]}
    if count:
        slides = np.full((3, m, time.size), np.nan)
        for i, (name, friction, servo) in enumerate(zip(p.machine.axes, p.friction, p.servos, strict=True)):
            lag, ramp = 0.0 if servo is None else servo.following_error(friction.feed), friction.feed * time
            at = axes.index(AXES.index(name))
            slides[0, at], slides[1, at] = ramp - lag + slow[2 * m + i], ramp
            slides[2, at] = friction.steady + slow[2 * m + count + i]
        values.update(zip(("encoder_position", "reference_position", "drive_force"), slides, strict=True))
    data = {name: xr.Variable(("axis", "time"), rows, {"units": UNITS[name]}) for name, rows in values.items()}
    if p.run.spindle is not None:
        for name, turning in (("spindle_angle", p.run.spindle.angle), ("spindle_speed", p.run.spindle.speed)):
            data[name] = xr.Variable("time", turning(time), {"units": UNITS[name]})
    return xr.Dataset(data, coords=coordinates)


def _attributes(p: Problem, run: Run) -> dict[str, float | list[float]]:
    # In the order of the record's axes, whatever that of the slides.
    order = np.argsort(axis_index(list(p.machine.axes)))
    feeds = [from_si(p.feeds[i], "mm/min", "speed") for i in order]
    out: dict[str, float | list[float]] = {
        "feed_mm_min": feeds[0] if len(feeds) == 1 else feeds,
        "step_s": run.step,
        "energy_error": run.energy_error if len(p.structures) == 1 else math.nan,
    }
    if p.run.cut is not None:
        engaged = (p.run.leave - p.run.lead) / run.step * p.run.cut.tool.teeth * p.run.cut.arc.arc / (2.0 * math.pi)
        out.update(lost_contact=run.lost / engaged, largest_chip_thickness_m=run.thickest)
    return out


def _verdict(
    p: Problem, swings: Real, speeds: Real, slides: Real, dt: float, poles: int
) -> dict[str, float | int | str]:
    """Return how the record ends: settled, decaying, excited or self-excited.

    The third and the last quarter of the time after the excitation are compared; they should hold several periods.
    """
    steps = speeds.shape[1]
    quarter = max(2, (steps - round(p.run.end / dt)) // 4)
    last, before = (_scatter(speeds[:, part]) for part in (slice(-quarter, None), slice(-2 * quarter, -quarter)))
    quiet = last <= RULES.quiet * float(np.abs(speeds).max(initial=0.0))
    motion = "settled"
    if poles:
        motion = (
            f"self-excited: uniform motion is unstable at this feed (stick-slip, {poles} poles in the right half plane)"
        )
    elif (steps - 2 * quarter) * dt < p.run.end:
        motion = "excited to the end"
    elif not quiet and last > RULES.decaying * before:
        motion = "self-excited: the motion is not at rest without excitation and does not decay"
    elif not quiet:
        motion = "still decaying"
    if motion.startswith("self-excited"):
        motion += "; a frequency response from this record is not a property of the axis alone"
    window = slice(-min(round(RULES.window / dt), steps), None)
    slow = [
        float(np.mean((feed + row[window]) * np.sign(feed) < RULES.standstill * abs(feed)))
        for feed, row in zip(p.feeds, slides, strict=True)
    ]
    return {
        "unstable_poles": poles,
        "residual_m": 0.5 * float(np.ptp(swings[:, window], axis=1).max(initial=0.0)),
        "standstill_share": max(slow, default=0.0),
        "motion": motion,
    }


def _scatter(speeds: Real) -> float:
    """Standard deviation over time and three directions, of which some may be missing: they do not move."""
    still = (_DIRECTIONS - speeds.shape[0]) * speeds.shape[1]
    count = speeds.size + still
    mean = float(speeds.sum()) / count
    return math.sqrt((float(((speeds - mean) ** 2).sum()) + still * mean**2) / count)
