"""A machine packed for `simulation._machine_kernels`: friction and joints, servos, forces over time, the cut."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from process.cut.engagement import Engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.friction._kernels import friction_step
from process.friction.laws import FrictionLaw
from process.machine.joints import CubicSpring, DoublePinion, Gap, Iwan, Jenkins, Joint, PowerIwan
from process.simulation import _machine_arrays as arrays
from process.simulation.excitation import Excitation, Late
from process.simulation.milling import MillingCut, Spindle, flat_surfaces, pack_motion, pack_teeth
from process.simulation.problem import Problem, SlideFriction
from process.simulation.rules import RULES
from process.simulation.step_maps import System, exact_maps, gains, reach
from process.types import Real

# Legendre polynomials of degree 0, 1, 2 at start, middle and end of a step, over their mean squares.
_NODES = np.array([[1.0, 1.0, 1.0], [-3.0, 0.0, 3.0], [5.0, -2.5, 5.0]])


def _joint_kind(joint: Joint) -> tuple[int, Real]:
    """Kind and parameters of a joint for the kernel."""
    if isinstance(joint, CubicSpring):
        return arrays.CUBIC, np.array([joint.stiffness, joint.cubic])
    if isinstance(joint, Gap):
        k, g = joint.stiffness, joint.gap
        return arrays.FLANKS, np.array([k, 1.0, g, k, -1.0, g])
    if isinstance(joint, DoublePinion):
        return arrays.FLANKS, np.array(joint.flanks).ravel()
    if isinstance(joint, Iwan | PowerIwan):
        return arrays.SLIDERS, np.concatenate(joint.packed())
    if isinstance(joint, Jenkins):
        return arrays.SLIDERS, np.array([joint.stiffness, joint.slip_force])
    raise InputError(f"a joint of type {type(joint).__name__} cannot be simulated; use one of process.machine.joints")


class _Element(NamedTuple):
    """One row of `arrays.Elements`, and its states at the start."""

    kind: int
    target: int
    law: int
    parameters: Real
    offset: tuple[float, float, float]
    row: Real
    state: Real


def _of_slide(friction: SlideFriction, target: int, row: Real, size: int) -> _Element:
    """Friction of a slide whose row is given, in steady motion."""
    code, parameters = friction.law.packed()
    offset = (friction.feed, friction.steady, friction.slope)
    motion = np.concatenate([np.zeros(row.size), row, np.zeros(size - 2 * row.size)])
    if isinstance(friction.law, FrictionLaw):
        return _Element(arrays.FRICTION, target, code, parameters, offset, motion, np.zeros(0))
    state = np.zeros(friction.law.states)
    if friction.feed != 0.0:
        for _ in range(2):  # until it slips, then until it is steady
            friction_step(code, parameters, state, friction.feed, RULES.settling)
    return _Element(arrays.MEMORY, target, code, parameters, offset, motion, state)


def _mounted(joint: Joint, participation: Real, target: int, size: int) -> _Element:
    kind, parameters = _joint_kind(joint)
    states = parameters.size // 2 if kind == arrays.SLIDERS else 0
    motion = np.concatenate([participation, np.zeros(size - participation.size)])
    return _Element(kind, target, 0, parameters, (0.0, 0.0, 0.0), motion, np.zeros(states))


def pack_elements(p: Problem, system: System) -> tuple[arrays.Elements, Real]:
    """Pack friction and joints; also return their states at the start."""
    slides, tools = p.structures[0].slide_rows(), len(p.run.tool_axes)
    made = [_of_slide(p.friction[i], tools + i, slides[i], system.size) for i in system.nonlinear]
    for k, mounted in enumerate(p.machine.joints):
        made.append(_mounted(mounted.joint, mounted.participation, tools + len(slides) + k, system.size))

    def ends(parts: list[Real]) -> NDArray[np.int64]:
        return np.cumsum([0, *(part.size for part in parts)], dtype=np.int64)

    parameters, states = [m.parameters for m in made], [m.state for m in made]
    offsets = np.array([m.offset for m in made], dtype=float).reshape(-1, 3).T.copy()
    elements = arrays.Elements(
        kind=np.array([m.kind for m in made], dtype=np.int64),
        target=np.array([m.target for m in made], dtype=np.int64),
        law=np.array([m.law for m in made], dtype=np.int64),
        parameters=np.concatenate([np.zeros(0), *parameters]),
        start=ends(parameters),
        feed=offsets[0],
        steady=offsets[1],
        slope=offsets[2],
        first=ends(states),
        rows=np.array([m.row for m in made]).reshape(len(made), system.size),
    )
    return elements, np.concatenate([np.zeros(0), *states])


def _looking_back(lag: Real) -> tuple[NDArray[np.int64], Real]:
    """First entry (s, 3) and shares (s, 3, 4) of a cubic through half steps, a lag of so many before each node.

    The last half step that is known is the start of the step.
    """
    place = np.arange(3.0) - lag[:, None]
    first = np.minimum(np.floor(place) - 1.0, -3.0)
    t = place - first
    u, v, w = t - 1.0, t - 2.0, t - 3.0
    share = np.stack([-u * v * w / 6.0, 0.5 * t * v * w, -0.5 * t * u * w, t * u * v / 6.0], axis=2)
    return first.astype(np.int64), np.ascontiguousarray(share)


def pack_servos(p: Problem, system: System, step: float) -> tuple[arrays.Servos, int]:
    """Pack the servos outside the linear part; also return the length of their ring."""
    tools, rows = len(p.run.tool_axes), p.structures[0].slide_rows()
    blank, none = np.zeros((0, 3)), np.zeros((0, 2))
    if p.run.control is None:
        rows_of = gains(p, system, p.structures[0])
        lag = np.array([2.0 * p.servos[i].delay / step for i in system.late])  # type: ignore[union-attr]
        late = np.array([-rows_of[i] for i in system.late]).reshape(len(system.late), system.size)
        target = np.array([tools + i for i in system.late], dtype=np.int64)
        longest = int(lag.max(initial=0.0)) + 8
        return arrays.Servos(target, late, *_looking_back(lag), 0, blank, 0.0, none), 1 << longest.bit_length()
    held = [(i, v) for i, v in enumerate(p.servos) if v is not None]
    read = np.zeros((2 * len(held), system.size))
    for k, (i, _) in enumerate(held):
        read[2 * k, : system.n], read[2 * k + 1, system.n : 2 * system.n] = rows[i], rows[i]
    gains_of = np.array([(v.Kp, 1.0 / v.Ti, v.Kv) for _, v in held]).reshape(-1, 3)
    ramp = np.array([(p.feeds[i], -v.following_error(p.feeds[i])) for i, v in held]).reshape(-1, 2)
    target = np.array([tools + i for i, _ in held], dtype=np.int64)
    every, fine = max(1, round(p.run.control.period / step)), p.run.control.encoder_resolution
    return arrays.Servos(target, read, *_looking_back(np.zeros(0)), every, gains_of, fine, ramp), p.run.control.lag + 1


@lru_cache(maxsize=8)
def _projection(parts: int) -> Real:
    """Matrix (parts + 1, 3): samples within a step to the parabola with the same moments, at its three nodes."""
    t = np.linspace(0.0, 1.0, parts + 1)
    weight = np.full(t.size, 2.0)
    weight[1::2], weight[[0, -1]] = 4.0, 1.0
    weight /= 3.0 * parts
    shapes = np.array([np.ones_like(t), 2.0 * t - 1.0, 6.0 * t**2 - 6.0 * t + 1.0])
    return np.asarray((shapes * weight).T @ _NODES)


class Sampled(NamedTuple):
    """A force over time.

    smooth (parts m + 1,): its continuous part [N], at eight parts of each step until it ends; at, height: its jumps, in
    steps and [N]; those of a binary sequence fall anywhere in a step.
    """

    smooth: Real
    at: Real
    height: Real


@lru_cache(maxsize=4)
def _gregory() -> Real:
    """Polynomials (5, 4) for `stairs`: the additions to the two samples before and after a jump, over their distance.

    ``sum_(n >= 0) (n + a)^k`` exceeds the integral from 0 by ``-B_(k+1)(a)/(k + 1)``, with the Bernoulli polynomials B
    (Euler and Maclaurin); four samples correct that for k = 0 to 3.
    """
    a = np.linspace(0.0, 1.0, 5)
    excess = [a - 1 / 2, (a**2 - a + 1 / 6) / 2, (a**3 - 1.5 * a**2 + a / 2) / 3, (a**4 - 2 * a**3 + a**2 - 1 / 30) / 4]
    places = a[:, None] + np.arange(-2.0, 2.0)
    powers = places[:, None, :] ** np.arange(4.0)[:, None]
    added = np.linalg.solve(powers, np.array(excess).T[:, :, None])[:, :, 0]
    return np.asarray(np.linalg.solve(np.vander(a, increasing=True), added))


def stairs(at: Real, height: Real, count: int) -> Real:
    """Return samples (count,) of a force that is held between jumps, whose sums weigh it as integrals do.

    A plain sample would move each jump to the next sample, half an interval late on average. Here the four samples
    around a jump have values such that sums of force times any cubic are those of the force itself: the spectrum is
    right to the fourth order of the interval. So does a recorder whose filter does not ring.

    Parameters
    ----------
    at, height : ndarray
        Jumps, in samples and [N].
    count : int
        Number of samples.
    """
    first = np.ceil(at)
    added = np.vander(first - at, 5, increasing=True) @ _gregory() * height[:, None]
    where = first.astype(np.int64)
    out = np.zeros(count + 4)
    seen = where < count + 2
    np.add.at(out, where[seen] + 2, height[seen])
    out = np.cumsum(out)
    for k in range(4):
        np.add.at(out, where[seen] + k, added[seen, k])
    return out[2:-2]


def _sampled(excitation: Excitation, step: float, steps: int) -> Sampled:
    """Sample a force until it ends, for m <= steps."""
    m = int(min(steps, max(1.0, math.ceil(excitation.end / step + 1.0))))
    time = np.arange(RULES.parts * m + 1, dtype=np.float64) * (step / RULES.parts)
    smooth, (times, heights) = excitation.force(time), excitation.jumps()
    if times.size:
        # A time that is a jump but for rounding belongs to what follows, as in `force`.
        done = np.searchsorted(times, time + 1e-6 * excitation.shortest, side="right")
        smooth = smooth - np.concatenate([[0.0], np.cumsum(heights)])[done]
    inside = times < m * step
    return Sampled(smooth, times[inside] / step, heights[inside])


def pack_forces(p: Problem, step: float, steps: int) -> tuple[arrays.Given, list[Sampled]]:
    """Pack the forces over time, first those on the tool; also return them as sampled."""
    tools, axes = p.run.tool_axes, list(p.machine.axes)
    target = [tools.index(a) for a in p.run.forces] + [len(tools) + axes.index(a) for a in p.run.drive_forces]
    late = [Late(e, lag) if (lag := p.lateness(axis)) else e for axis, e in p.run.drive_forces.items()]
    sampled = [_sampled(e, step, steps) for e in (*p.run.forces.values(), *late)]
    return _given(sampled, target), sampled


def commanded_forces(p: Problem, step: float, steps: int) -> list[Sampled]:
    """Sample the drive forces as they were commanded, before the dead time."""
    return [_sampled(e, step, steps) for e in p.run.drive_forces.values()]


@lru_cache(maxsize=512)
def pack_impact(impact: Excitation, step: float, steps: int) -> arrays.Given:
    """Pack the force of one impact, the only input that is given; cached for machines that are hit alike."""
    return _given([_sampled(impact, step, steps)], [0])


def _given(forces: list[Sampled], target: list[int]) -> arrays.Given:
    """Forces as sampled, made parabolas of each step."""
    longest = max([(f.smooth.size - 1) // RULES.parts for f in forces], default=0)
    values, peak = np.zeros((len(forces), longest, 3)), 0.0
    for row, f in zip(values, forces, strict=True):
        windows = np.lib.stride_tricks.sliding_window_view(f.smooth, RULES.parts + 1)[:: RULES.parts]
        row[: windows.shape[0]] = windows @ _projection(RULES.parts)
        largest = float(np.abs(f.smooth).max())
        if f.at.size:
            row[: windows.shape[0]] += _held(f.at, f.height, windows.shape[0])
            largest += float(np.abs(np.cumsum(f.height)).max())
        peak = max(peak, largest)
    return arrays.Given(np.array(target, dtype=np.int64), values, peak)


def _held(at: Real, height: Real, steps: int) -> Real:
    """Parabola of each step, (steps, 3), with the moments of a force that is held between jumps."""
    step = np.minimum(at.astype(np.int64), steps - 1)
    t = at - step
    moments = np.array([1.0 - t, t - t**2, -2.0 * t**3 + 3.0 * t**2 - t])
    out = np.zeros((steps + 1, 3))
    np.add.at(out, step + 1, height[:, None])
    out = np.cumsum(out, axis=0)[:steps]
    np.add.at(out, step, height[:, None] * (moments.T @ _NODES))
    return np.asarray(out)


def pack_linear(p: Problem, system: System, elements: arrays.Elements, step: float, steps: int) -> arrays.Linear:
    """Discretise the linear part at every point of the path."""
    halvings = RULES.halvings if elements.kind.size else 0
    maps = np.array([exact_maps(a, b, elements.rows, step, halvings) for a, b in system.matrices])
    first, n, a = p.structures[0], system.n, system.matrices[0][0]
    power = first.mass @ a[n : 2 * n]
    power[:, :n] += first.stiffness
    places = np.minimum(np.arange(steps) * (step / p.run.total), 1.0) * (len(p.structures) - 1.0)
    tool = np.array([s.tool for s in p.structures])
    return arrays.Linear(maps, places, power, first.mass, first.stiffness, reach(p, first), tool)


def scratch(
    linear: arrays.Linear, elements: arrays.Elements, servos: arrays.Servos, ring: int, state: Real
) -> arrays.Work:
    """Make the arrays that the loop works in, with the states of the elements at the start."""
    count, size, inputs, held = elements.kind.size, linear.power.shape[1], linear.reach.shape[0], servos.target.size
    return arrays.Work(
        z=np.zeros(size),
        base=np.zeros(linear.maps.shape[3]),
        known=np.zeros((inputs, 3)),
        piece=np.zeros((inputs, 3)),
        part=np.zeros(2 * count),
        force=np.zeros((3, count)),
        motion=np.zeros((3, count)),
        slope=np.zeros((2 * count, 2)),
        system=np.zeros((2 * count, 2 * count)),
        change=np.zeros(2 * count),
        states=np.tile(state, (4, 1)),
        ring=np.zeros((held, ring)),
        integral=np.zeros((held, 2)),
        largest=np.zeros(size + count),
        recent=np.zeros(size + count),
        blended=np.zeros(linear.maps.shape[1:]),
        fresh=np.full(linear.maps.shape[1], -1, dtype=np.int64),
        tally=np.zeros(4),
        mode=np.array([0, -1, 1, 0], dtype=np.int64),
        cutting=np.zeros(8),
    )


@lru_cache(maxsize=1)
def _no_cut() -> arrays.Cut:
    """Return a cut that never begins, of the types that the kernel is compiled for."""
    cut = MillingCut(Tool(0.01, 1), Engagement(0.0, math.pi), CuttingCoefficients(1.0, 0.0, 0.0), 1.0, 1.0)
    teeth = pack_teeth(cut, 1e-3, 1.0, 1.0)
    return arrays.Cut(pack_motion(Spindle(1.0), cut), teeth, flat_surfaces(teeth), 0.0, 0.0, np.zeros(1))


def pack_cut(p: Problem, step: float) -> arrays.Cut:
    """Pack the cut; without one there are no teeth."""
    if p.run.cut is None or p.run.spindle is None:
        return _no_cut()
    slowest, fastest = p.run.spindle.extremes(0.0, p.run.total)
    teeth = pack_teeth(p.run.cut, step, slowest, fastest)
    first = p.structures[0]
    kick = np.linalg.solve(first.mass, first.tool.T @ np.asarray(p.run.impulse, dtype=float))
    return arrays.Cut(pack_motion(p.run.spindle, p.run.cut), teeth, flat_surfaces(teeth), p.run.lead, p.run.leave, kick)
