"""Time simulation of a whole machine: hammer hits, shakers and cuts, idle or in motion.

Deviations from the ramp of each axis are integrated: the steady friction is held by the integrator, so there is no
start-up transient and no cancellation. The linear part moves exactly (matrix exponential); friction and joints are
inputs that are solved for, quadratic in time, and the step is halved where that does not follow them. Labelled in and
out; the loop is in `process._machine_kernels`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import linalg, signal

from process import _machine_kernels as kernels
from process._friction_kernels import friction_step
from process.cutting import CuttingCoefficients
from process.engagement import Engagement
from process.errors import InputError
from process.excitation import Excitation
from process.friction import FrictionLaw, MemoryLaw
from process.friction_impedance import FrictionImpedance
from process.joints import CubicSpring, Gap, Iwan, Jenkins, Joint
from process.labels import AXES, axis_index, label
from process.machine import Machine
from process.operating_point import OperatingPoint
from process.preload import DoublePinion
from process.servo import Servo
from process.simulate import (
    STEPS_PER_PERIOD,
    STEPS_PER_TOOTH,
    MillingCut,
    Spindle,
    flat_surfaces,
    pack_motion,
    pack_teeth,
)
from process.structure import Posture, Structure
from process.tool import Tool
from process.units import from_si

Real = NDArray[np.float64]

STEPS_PER_EVENT = 8
"""Steps in the shortest event of an excitation, at least."""

STEPS_PER_POLE = 24
"""Steps in the period of the fastest linear pole, at least."""

ACCURACY = 2e-3
"""Largest error of a friction or joint force, over the largest so far, in a step that only poles and events limit.

It goes with the fourth power of the step: 1.25e-4 at half of it.
"""

_COARSEST = 20
_HALVINGS = 8
_FAST = 10.0
_WINDOW = 0.25
_STANDSTILL = 0.1
_MARGIN = 10
_SUB = 8
_PATH_POINTS = 33
_SLIDE_CHANNELS = ("encoder_position", "reference_position", "drive_force")
_LONG = 1e3
_SERIES_NORM = 0.25
_SERIES_TERMS = 12


@dataclass(frozen=True)
class SampledControl:
    """Servos that read their encoders and set their forces every period, as in `process.sampled_servo`.

    Parameters
    ----------
    period : float
        Sampling period T [s].
    lag : int, optional
        Whole periods from reading to force.
    encoder_resolution : float, optional
        Step of the encoder [m]: position is rounded to it, velocity is the difference of two readings. Zero: both are
        read exactly.
    """

    period: float
    lag: int = 1
    encoder_resolution: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what does not sample."""
        if not (0.0 < self.period < math.inf and self.lag >= 0 and 0.0 <= self.encoder_resolution < math.inf):
            raise InputError(
                f"sampling with period {self.period:g} s, lag {self.lag} and encoder steps of "
                f"{self.encoder_resolution:g} m; give a positive period and the others not negative"
            )


class _Problem(NamedTuple):
    """What is to be simulated, with all names resolved."""

    machine: Machine
    structures: tuple[Structure, ...]
    feeds: tuple[float, ...]
    servos: tuple[Servo | None, ...]
    controller: str | None
    forces: dict[str, Excitation]
    drive_forces: dict[str, Excitation]
    cut: MillingCut | None
    spindle: Spindle | None
    entry: float
    leave: float
    total: float
    impulse: tuple[float, float, float]
    control: SampledControl | None
    position: float | None

    @property
    def excitations(self) -> list[Excitation]:
        return [*self.forces.values(), *self.drive_forces.values()]

    @property
    def delays(self) -> list[float]:
        return [v.delay for v in self.servos if v is not None and v.delay > 0.0]

    @property
    def tools(self) -> list[str]:
        """Axes along which a force acts on the tool."""
        return list(AXES) if self.cut is not None else list(self.forces)

    @property
    def end(self) -> float:
        """Time [s] after which nothing excites the machine."""
        cut = self.leave if self.cut is not None else 0.0
        return max([e.end for e in self.excitations] + [cut])


def _slope(law: FrictionLaw | MemoryLaw, velocity: float) -> float:
    return float(law.slope(velocity)) if isinstance(law, FrictionLaw) else law.sigma


def _steady(law: FrictionLaw | MemoryLaw, feed: float) -> float:
    return float(law.force(feed) if isinstance(law, FrictionLaw) else law.steady_force(feed))


def _linear_slope(law: FrictionLaw | MemoryLaw, feed: float) -> float:
    """Part of the friction [N s/m] that belongs to the linear part: local slope where it slides, else far up."""
    fast = min(_slope(law, _FAST), _slope(law, -_FAST))
    local = _slope(law, feed)
    if not math.isfinite(local) or not math.isfinite(_slope(law, 0.0)):
        raise InputError(
            "the friction law jumps at rest (kt is infinite); a time simulation needs a finite kt, e.g. 15000 s/m"
        )
    return local if feed != 0.0 and local <= max(fast, 0.0) else fast


class _Layout(NamedTuple):
    """Where things are: coordinates n, states N, axis numbers of the prompt and late servos and of the elements."""

    n: int
    size: int
    prompt: list[int]
    late: list[int]
    rubbing: list[int]


def _layout(p: _Problem) -> _Layout:
    driven = [] if p.control else [i for i, v in enumerate(p.servos) if v is not None]
    late = [i for i in driven if p.servos[i].delay > 0.0]  # type: ignore[union-attr]
    prompt = [i for i in driven if i not in late]
    n = p.structures[0].size
    rubbing = [i for i, axis in enumerate(p.machine.axes.values()) if _bends(axis.friction)]
    return _Layout(n, 2 * n + len(driven), prompt, late, rubbing)


def _bends(law: FrictionLaw | MemoryLaw) -> bool:
    """Say whether a law is more than viscous."""
    return isinstance(law, MemoryLaw) or law.packed()[0] != 0


def _gain(servo: Servo, row: Real, at: int, size: int) -> Real:
    """Row K of ``F_servo = -K z``; `at` is the place of the integral."""
    n, gain = row.size, np.zeros(size)
    gain[:n], gain[n : 2 * n] = servo.Kp * (servo.Kv + 1.0 / servo.Ti) * row, servo.Kp * row
    gain[at] = servo.Kp * servo.Kv / servo.Ti
    return gain


def _gains(p: _Problem, lay: _Layout, structure: Structure) -> dict[int, Real]:
    """Axis number -> row K of its servo; integrals stand in the order of the axes."""
    rows = structure.slide_rows()
    driven = sorted(lay.prompt + lay.late)
    return {i: _gain(p.servos[i], rows[i], 2 * lay.n + k, lay.size) for k, i in enumerate(driven)}  # type: ignore[arg-type]


def _reach(p: _Problem, structure: Structure) -> Real:
    """Participation of the inputs, shape (u, n): forces on the tool, on the slides, in the joints."""
    joints = [m.participation for m in p.machine.joints]
    parts = [
        structure.tool[axis_index(p.tools)],
        structure.slide_rows(),
        np.reshape(joints, (len(joints), structure.size)),
    ]
    return np.vstack([part for part in parts if part.size] or [np.zeros((0, structure.size))])


def _linear_part(p: _Problem, lay: _Layout, structure: Structure) -> tuple[Real, Real]:
    """A (N, N) and B (N, u) of ``z' = A z + B u`` with prompt servos and the linear friction."""
    n, rows = lay.n, structure.slide_rows()
    damping = structure.damping.copy()
    for row, axis, feed in zip(rows, p.machine.axes.values(), p.feeds, strict=True):
        damping += _linear_slope(axis.friction, feed) * np.outer(row, row)
    reach = _reach(p, structure)
    held = linalg.cho_solve(
        linalg.cho_factor(structure.mass), np.hstack([structure.stiffness, damping, reach.T, rows.T])
    )
    a, b = np.zeros((lay.size, lay.size)), np.zeros((lay.size, reach.shape[0]))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, : 2 * n], b[n : 2 * n] = -held[:, : 2 * n], held[:, 2 * n : 2 * n + b.shape[1]]
    slides = held[:, 2 * n + b.shape[1] :]
    for k, i in enumerate(sorted(lay.prompt + lay.late)):
        a[2 * n + k, :n] = rows[i]
    for i, gain in _gains(p, lay, structure).items():
        if i in lay.prompt:
            a[n : 2 * n] -= np.outer(slides[:, i], gain)
    return a, b


def _maps(a: Real, b: Real, rows: Real, step: float, halvings: int) -> Real:
    """Exact maps for inputs quadratic in time, for a step halved 0, 1, ... times; `process._machine_kernels.Linear`.

    The matrix exponential of state and input polynomial, for a quarter of the finest step; the others by squaring.
    """
    size, u = b.shape
    whole = np.zeros((size + 3 * u, size + 3 * u))
    whole[:size, :size], whole[:size, size : size + u] = a, b
    whole[size : size + u, size + u : size + 2 * u] = np.eye(u)
    whole[size + u : size + 2 * u, size + 2 * u :] = 2.0 * np.eye(u)
    power = _exponentials(whole * step, halvings + 2)
    out = np.empty((halvings + 1, size + 3 * u, 2 * size + 3 * rows.shape[0]))
    for level in range(halvings + 1):
        h = step / 2.0**level
        # Value, slope and half the curvature of an input from its values at start, middle and end.
        turned = np.array([[1.0, -3.0 / h, 2.0 / h**2], [0.0, 4.0 / h, -4.0 / h**2], [0.0, -1.0 / h, 2.0 / h**2]])
        parts = []
        for stage in (halvings - level, halvings - level + 1, halvings - level + 2):
            top = power[stage][:size]
            inputs = np.einsum("kd,sdi->iks", turned, top[:, size:].reshape(size, 3, u))
            parts.append(np.vstack([top[:, :size].T, inputs.reshape(3 * u, size)]))
        quarter, middle, end = parts
        out[level] = np.hstack([middle, end, *(part @ rows.T for part in (quarter, middle, end))])
    return out


def _exponentials(matrix: Real, halvings: int) -> list[Real]:
    """Return ``exp(matrix/2^k)`` for k from `halvings` down to 0: Taylor series where the norm is small, then squares.

    A general routine costs more than all the rest of a short run.
    """
    norm = float(np.abs(matrix).sum(axis=1).max())
    more = max(halvings, math.ceil(math.log2(max(norm, 1e-300) / _SERIES_NORM)))
    small = matrix / 2.0**more
    total = np.eye(matrix.shape[0])
    for k in range(_SERIES_TERMS, 0, -1):
        total = np.eye(matrix.shape[0]) + small @ total / k
    found = [total]
    for _ in range(more):
        found.append(found[-1] @ found[-1])
    return found[more - halvings :]


def _joint_kind(joint: Joint) -> tuple[int, Real]:
    """Kind and parameters of a joint for the kernel."""
    if isinstance(joint, CubicSpring):
        return kernels.CUBIC, np.array([joint.stiffness, joint.cubic])
    if isinstance(joint, Gap):
        k, g = joint.stiffness, joint.gap
        return kernels.FLANKS, np.array([k, 1.0, g, k, -1.0, g])
    if isinstance(joint, DoublePinion):
        return kernels.FLANKS, np.array(joint._flanks).ravel()
    if isinstance(joint, Iwan):
        return kernels.SLIDERS, np.concatenate(joint.packed())
    if isinstance(joint, Jenkins):
        return kernels.SLIDERS, np.array([joint.stiffness, joint.slip_force])
    raise InputError(f"a joint of type {type(joint).__name__} cannot be simulated; use one of process.joints")


class _Element(NamedTuple):
    """One row of `kernels.Elements`, and its states at the start."""

    kind: int
    target: int
    law: int
    parameters: Real
    offset: tuple[float, float, float]
    row: Real
    state: Real


def _rubbing(law: FrictionLaw | MemoryLaw, feed: float, target: int, row: Real, size: int) -> _Element:
    """Friction of a slide whose row is given, in steady motion."""
    code, parameters = law.packed()
    offset = (feed, _steady(law, feed), _linear_slope(law, feed))
    felt = np.concatenate([np.zeros(row.size), row, np.zeros(size - 2 * row.size)])
    if isinstance(law, FrictionLaw):
        return _Element(kernels.FRICTION, target, code, parameters, offset, felt, np.zeros(0))
    state = np.zeros(law.states)
    if feed != 0.0:
        for _ in range(2):  # until it slips, then until it is steady
            friction_step(code, parameters, state, feed, _LONG)
    return _Element(kernels.MEMORY, target, code, parameters, offset, felt, state)


def _mounted(joint: Joint, participation: Real, target: int, size: int) -> _Element:
    kind, parameters = _joint_kind(joint)
    states = parameters.size // 2 if kind == kernels.SLIDERS else 0
    felt = np.concatenate([participation, np.zeros(size - participation.size)])
    return _Element(kind, target, 0, parameters, (0.0, 0.0, 0.0), felt, np.zeros(states))


def _elements(p: _Problem, lay: _Layout) -> tuple[kernels.Elements, Real]:
    """Pack friction and joints; also return their states at the start."""
    slides, axes, tools = p.structures[0].slide_rows(), list(p.machine.axes.values()), len(p.tools)
    made = [_rubbing(axes[i].friction, p.feeds[i], tools + i, slides[i], lay.size) for i in lay.rubbing]
    for k, mounted in enumerate(p.machine.joints):
        made.append(_mounted(mounted.joint, mounted.participation, tools + len(axes) + k, lay.size))

    def ends(parts: list[Real]) -> NDArray[np.int64]:
        return np.cumsum([0, *(part.size for part in parts)], dtype=np.int64)

    parameters, states = [m.parameters for m in made], [m.state for m in made]
    offsets = np.array([m.offset for m in made], dtype=float).reshape(-1, 3).T.copy()
    elements = kernels.Elements(
        kind=np.array([m.kind for m in made], dtype=np.int64),
        target=np.array([m.target for m in made], dtype=np.int64),
        law=np.array([m.law for m in made], dtype=np.int64),
        parameters=np.concatenate([np.zeros(0), *parameters]),
        start=ends(parameters),
        feed=offsets[0],
        steady=offsets[1],
        slope=offsets[2],
        first=ends(states),
        rows=np.array([m.row for m in made]).reshape(len(made), lay.size),
    )
    return elements, np.concatenate([np.zeros(0), *states])


def _servos(p: _Problem, lay: _Layout, step: float) -> tuple[kernels.Servos, int]:
    """Pack the servos outside the linear part; also return the length of their ring."""
    tools, rows = len(p.tools), p.structures[0].slide_rows()
    blank, none = np.zeros((0, 3)), np.zeros((0, 2))
    if p.control is None:
        gains = _gains(p, lay, p.structures[0])
        lag = np.array([2.0 * p.servos[i].delay / step for i in lay.late])  # type: ignore[union-attr]
        late = np.array([-gains[i] for i in lay.late]).reshape(len(lay.late), lay.size)
        target = np.array([tools + i for i in lay.late], dtype=np.int64)
        return kernels.Servos(target, late, lag, 0, blank, 0.0, none), int(lag.max(initial=0.0)) + 8
    held = [(i, v) for i, v in enumerate(p.servos) if v is not None]
    read = np.zeros((2 * len(held), lay.size))
    for k, (i, _) in enumerate(held):
        read[2 * k, : lay.n], read[2 * k + 1, lay.n : 2 * lay.n] = rows[i], rows[i]
    gains_of = np.array([(v.Kp, 1.0 / v.Ti, v.Kv) for _, v in held]).reshape(-1, 3)
    ramp = np.array([(p.feeds[i], -v.following_error(p.feeds[i])) for i, v in held]).reshape(-1, 2)
    target = np.array([tools + i for i, _ in held], dtype=np.int64)
    every, fine = max(1, round(p.control.period / step)), p.control.encoder_resolution
    return kernels.Servos(target, read, np.zeros(0), every, gains_of, fine, ramp), p.control.lag + 1


@lru_cache(maxsize=8)
def _projection(parts: int) -> Real:
    """Matrix (parts + 1, 3): samples within a step to the parabola with the same moments, at its three nodes."""
    t = np.linspace(0.0, 1.0, parts + 1)
    weight = np.full(t.size, 2.0)
    weight[1::2], weight[[0, -1]] = 4.0, 1.0
    weight /= 3.0 * parts
    shapes = np.array([np.ones_like(t), 2.0 * t - 1.0, 6.0 * t**2 - 6.0 * t + 1.0])
    nodes = np.array([[1.0, 1.0, 1.0], [-1.0, 0.0, 1.0], [1.0, -0.5, 1.0]])
    return np.asarray((shapes * weight).T @ (np.array([1.0, 3.0, 5.0])[:, None] * nodes))


def _sampled(excitation: Excitation, step: float, steps: int) -> Real:
    """Force [N] at eight parts of each step until it ends, shape (8 m + 1,), m <= steps."""
    m = int(min(steps, max(1.0, math.ceil(excitation.end / step + 1.0))))
    return excitation.force(np.arange(_SUB * m + 1, dtype=np.float64) * (step / _SUB))


def _given(p: _Problem, step: float, steps: int) -> tuple[kernels.Given, dict[str, Real]]:
    """Pack the forces over time; also return those on the tool as sampled."""
    tools, axes = p.tools, list(p.machine.axes)
    fine = {a: _sampled(e, step, steps) for a, e in p.forces.items()}
    pushes = [_sampled(e, step, steps) for e in p.drive_forces.values()]
    target = [tools.index(a) for a in fine] + [len(tools) + axes.index(a) for a in p.drive_forces]
    both = [*fine.values(), *pushes]
    longest = max([(f.size - 1) // _SUB for f in both], default=0)
    values = np.zeros((len(both), longest, 3))
    for row, f in zip(values, both, strict=True):
        windows = np.lib.stride_tricks.sliding_window_view(f, _SUB + 1)[::_SUB]
        row[: windows.shape[0]] = windows @ _projection(_SUB)
    peak = max([float(np.abs(f).max()) for f in both], default=0.0)
    return kernels.Given(np.array(target, dtype=np.int64), values, peak), fine


def _linear(p: _Problem, elements: kernels.Elements, lay: _Layout, step: float, steps: int) -> kernels.Linear:
    """Discretise the linear part at every point of the path."""
    halvings = _HALVINGS if elements.kind.size else 0
    parts = [_linear_part(p, lay, s) for s in p.structures]
    maps = np.array([_maps(a, b, elements.rows, step, halvings) for a, b in parts])
    first, n, a = p.structures[0], lay.n, parts[0][0]
    power = first.mass @ a[n : 2 * n]
    power[:, :n] += first.stiffness
    places = np.linspace(0.0, len(p.structures) - 1.0, steps)
    tool = np.array([s.tool for s in p.structures])
    return kernels.Linear(maps, places, power, first.mass, first.stiffness, _reach(p, first), tool)


def _work(
    linear: kernels.Linear, elements: kernels.Elements, servos: kernels.Servos, ring: int, state: Real
) -> kernels.Work:
    count, size, inputs, held = elements.kind.size, linear.power.shape[1], linear.reach.shape[0], servos.target.size
    return kernels.Work(
        z=np.zeros(size),
        base=np.zeros(linear.maps.shape[3]),
        known=np.zeros((inputs, 3)),
        piece=np.zeros((inputs, 3)),
        part=np.zeros(2 * count),
        force=np.zeros((3, count)),
        felt=np.zeros((3, count)),
        slope=np.zeros(2 * count),
        system=np.zeros((2 * count, 2 * count)),
        change=np.zeros(2 * count),
        states=np.tile(state, (4, 1)),
        ring=np.zeros((held, ring)),
        integral=np.zeros((held, 2)),
        blended=np.zeros(linear.maps.shape[1:]),
        fresh=np.full(linear.maps.shape[1], -1, dtype=np.int64),
        tally=np.zeros(4),
        mode=np.array([0, -1, 1], dtype=np.int64),
        cutting=np.zeros(8),
    )


@lru_cache(maxsize=1)
def _no_cut() -> kernels.Cut:
    """Return a cut that never begins, of the types that the kernel is compiled for."""
    cut = MillingCut(Tool(0.01, 1), Engagement(0.0, math.pi), CuttingCoefficients(1.0, 0.0, 0.0), 1.0, 1.0)
    teeth = pack_teeth(cut, 1e-3, 1.0, 1.0)
    return kernels.Cut(pack_motion(Spindle(1.0), cut), teeth, flat_surfaces(teeth), 0.0, 0.0, np.zeros(1))


def _cut(p: _Problem, step: float) -> kernels.Cut:
    """Pack the cut; without one there are no teeth."""
    if p.cut is None or p.spindle is None:
        return _no_cut()
    slowest, fastest = p.spindle.extremes(0.0, p.total)
    teeth = pack_teeth(p.cut, step, slowest, fastest)
    first = p.structures[0]
    kick = np.linalg.solve(first.mass, first.tool.T @ np.asarray(p.impulse, dtype=float))
    return kernels.Cut(pack_motion(p.spindle, p.cut), teeth, flat_surfaces(teeth), p.entry, p.leave, kick)


class _Run(NamedTuple):
    """Inputs and states at the start of each step, what there is of forces on the tool, and how it went."""

    states: Real
    inputs: Real
    force: dict[str, Real]
    step: float
    keep: int
    linear: kernels.Linear
    energy_error: float
    lost: float
    thickest: float


def _march(p: _Problem, lay: _Layout, sample_rate: float, keep: int, ratio: float) -> _Run:
    """March with `keep` steps a sample; ratio: this step over the default one."""
    step = 1.0 / (sample_rate * keep)
    # The low-pass looks ahead: march beyond the end of the record.
    steps = (round(p.total * sample_rate) + (2 * _MARGIN if keep > 1 else 0)) * keep
    elements, state = _elements(p, lay)
    servos, ring = _servos(p, lay, step)
    given, force = _given(p, step, steps)
    linear = _linear(p, elements, lay, step, steps)
    inputs = np.empty((steps, linear.reach.shape[0] + elements.kind.size))
    states = np.empty((steps, lay.size))
    work = _work(linear, elements, servos, ring, state)
    accuracy = min(1e-2, ACCURACY * ratio**4)
    end, done = kernels.march(linear, elements, servos, given, work, step, accuracy, _cut(p, step), states, inputs)
    if end == kernels.NOT_SOLVED:
        raise InputError(
            f"friction and joints cannot be solved for at {done * step:.4g} s even with steps of "
            f"{step / 2**_HALVINGS * 1e6:.3g} us; give a shorter step, or a law that is less steep"
        )
    tip = np.abs(states[: min(done + 1, steps), : lay.n] @ p.structures[0].tool.T)
    if end == kernels.RAN_AWAY or not tip.max(initial=0.0) < 1.0:
        late = np.flatnonzero(~(tip.max(axis=1) < 1.0))
        when = (late[0] if late.size else done) * step
        raise InputError(f"the tool left the range of 1 m after {when:.3g} s; it is hit too hard, or unstable")
    worst, largest = work.tally[kernels.WORST], work.tally[kernels.LARGEST]
    share = float(worst / largest) if largest > 0.0 else 0.0
    lost, thickest = float(work.cutting[kernels.LOST]), float(work.cutting[kernels.THICKEST])
    return _Run(states, inputs, force, step, keep, linear, share, lost, thickest)


@lru_cache(maxsize=32)
def _taps(factor: int) -> Real:
    """Low-pass for every `factor`-th sample: windowed sinc of 20 samples of the slow rate, of gain 1 at 0 Hz."""
    return np.asarray(signal.firwin(2 * _MARGIN * factor + 1, 1.0 / factor, window="hamming"))


def _slow(channels: Real, factor: int, samples: int) -> Real:
    """Low-pass channels (c, n) without phase and keep every `factor`-th sample, (c, samples); zero before and after."""
    if factor == 1:
        out = np.zeros((channels.shape[0], samples))
        m = min(samples, channels.shape[1])
        out[:, :m] = channels[:, :m]
        return out
    out = np.zeros((channels.shape[0], samples))
    kernels.low_pass(np.ascontiguousarray(channels), _taps(factor), factor, out)
    return out


def _rows(p: _Problem, lay: _Layout, structure: Structure, prompt_force: bool) -> Real:
    """Rows of all channels for (states, inputs, elements): displacement, acceleration, velocity of the tool (3 each).

    Then velocity, position and drive force of each axis. With `prompt_force` the tool forces act on the acceleration.
    """
    n, tools, axes = lay.n, len(p.tools), len(p.servos)
    a, b = _linear_part(p, lay, structure)
    targets = [tools + i for i in lay.rubbing] + [tools + axes + k for k in range(len(p.machine.joints))]
    width = lay.size + b.shape[1] + len(targets)
    rows, slides = np.zeros((9 + 3 * axes, width)), structure.slide_rows()
    tool = structure.tool
    rows[:3, :n], rows[6:9, n : 2 * n] = tool, tool
    direct = tool @ b[n : 2 * n]
    rows[3:6] = np.hstack([tool @ a[n : 2 * n], direct, direct[:, targets]])
    if not prompt_force:
        rows[3:6, lay.size : lay.size + tools] = 0.0
    gains = _gains(p, lay, structure)
    for i in range(axes):
        speed, place, push = 9 + i, 9 + axes + i, 9 + 2 * axes + i
        rows[speed, n : 2 * n], rows[place, :n] = slides[i], slides[i]
        rows[push, lay.size + tools + i] = 1.0
        if i in lay.prompt:
            rows[push, : lay.size] = -gains[i]
    return rows


def _channels(p: _Problem, lay: _Layout, run: _Run) -> Real:
    """All channels at each step, (c, steps), blended along the path."""
    values = np.hstack([run.states, run.inputs])
    rows = [_rows(p, lay, s, p.cut is not None) for s in p.structures]
    out = np.zeros((rows[0].shape[0], values.shape[0]))
    for k, row in enumerate(rows):
        kernels.combine(row, values, np.clip(1.0 - np.abs(run.linear.places - k), 0.0, 1.0), out)
    return out


def _as_record(p: _Problem, lay: _Layout, run: _Run, sample_rate: float) -> xr.Dataset:
    """Low-pass and label the channels; put the ramps and the steady friction back; add the verdict."""
    samples, count = round(p.total * sample_rate), len(p.servos)
    every = _channels(p, lay, run)
    wanted = [0, 1, 2, 3, 4, 5, *range(9 + count, 9 + 3 * count)]
    slow = _slow(every[wanted], run.keep, samples)
    force = np.zeros((3, samples))
    first = p.structures[0]
    if p.cut is not None:
        force = _slow(run.inputs[:, :3].T, run.keep, samples)
    elif run.force:
        rows = axis_index(list(run.force))
        for row, fine in zip(rows, run.force.values(), strict=True):
            plain = fine[None, ::_SUB] if run.keep == 1 else fine[None]
            force[row] = _slow(plain, 1 if run.keep == 1 else run.keep * _SUB, samples)[0]
        slow[3:6] += first.tool @ np.linalg.solve(first.mass, first.tool[rows].T) @ force[rows]
    record = _labelled(p, np.arange(samples) / sample_rate, force, slow)
    record.attrs.update(_attributes(p, run))
    record.attrs.update(_verdict(p, every[:, : samples * run.keep], run.step, _unstable_poles(p)))
    return record


def _labelled(p: _Problem, time: Real, force: Real, slow: Real) -> xr.Dataset:
    """Label force (3, n) and channels: displacement (3), acceleration (3), positions and drive forces of the slides.

    Not by `process.labels.make_record`, whose checks of what comes from outside cost as much as a short run.
    """
    axes, count = _moving_axes(p), len(p.servos)
    numbers = axis_index(axes)
    values = {"force": force[numbers], "displacement": slow[numbers], "acceleration": slow[3:6][numbers]}
    slides = {name: np.full((len(axes), time.size), np.nan) for name in _SLIDE_CHANNELS if count}
    for i, (name, axis) in enumerate(p.machine.axes.items()):
        feed, servo, at = p.feeds[i], p.servos[i], axes.index(name)
        lag = 0.0 if servo is None else servo.following_error(feed)
        slides["encoder_position"][at] = feed * time - lag + slow[6 + i]
        slides["reference_position"][at] = feed * time
        slides["drive_force"][at] = _steady(axis.friction, feed) + slow[6 + count + i]
    data: dict[str, Any] = {name: (("axis", "time"), rows) for name, rows in {**values, **slides}.items()}
    if p.spindle is not None:
        data.update(spindle_angle=("time", p.spindle.angle(time)), spindle_speed=("time", p.spindle.speed(time)))
    return label(xr.Dataset(data, coords={"time": time, "axis": axes}))


def _moving_axes(p: _Problem) -> list[str]:
    """Axes along which the tool can move or is pushed, or that have a slide; all in a cut."""
    moves = np.any([np.any(s.tool != 0.0, axis=1) for s in p.structures], axis=0)
    return [a for a, moving in zip(AXES, moves, strict=True) if moving or a in p.tools or a in p.machine.axes]


def _attributes(p: _Problem, run: _Run) -> dict[str, float | list[float]]:
    feeds = [from_si(feed, "mm/min", "speed") for feed in p.feeds]
    out: dict[str, float | list[float]] = {
        "feed_mm_min": feeds[0] if len(feeds) == 1 else feeds,
        "step_s": run.step,
        "energy_error": run.energy_error if len(p.structures) == 1 else math.nan,
    }
    if p.cut is not None:
        engaged = (p.leave - p.entry) / run.step * p.cut.tool.teeth * p.cut.arc.arc / (2.0 * math.pi)
        out.update(lost_contact=run.lost / engaged, largest_chip_thickness_m=run.thickest)
    return out


def _verdict(p: _Problem, every: Real, dt: float, poles: int) -> dict[str, float | int | str]:
    """Say how the record ends: settled, decaying, or in a motion that nobody excites.

    The third and the last quarter of the time after the excitation are compared; they should hold several periods.
    """
    quarter = max(2, (every.shape[1] - round(p.end / dt)) // 4)
    speed = every[6:9]
    last, before = (float(np.std(speed[:, part])) for part in (slice(-quarter, None), slice(-2 * quarter, -quarter)))
    quiet = last <= 1e-3 * float(np.abs(speed).max())
    motion = "settled"
    if poles:
        motion = (
            f"self-excited: uniform motion is unstable at this feed (stick-slip, {poles} poles in the right half plane)"
        )
    elif (every.shape[1] - 2 * quarter) * dt < p.end:
        motion = "excited to the end"
    elif not quiet and last > 0.97 * before:
        motion = "self-excited: the motion is not at rest without excitation and does not decay"
    elif not quiet:
        motion = "still decaying"
    if motion.startswith("self-excited"):
        motion += "; a frequency response from this record is not a property of the axis alone"
    window = every[:, -min(round(_WINDOW / dt), every.shape[1]) :]
    slow = [
        float(np.mean((feed + window[9 + i]) * np.sign(feed) < _STANDSTILL * abs(feed)))
        for i, feed in enumerate(p.feeds)
    ]
    residual = 0.5 * float(np.ptp(window[:3], axis=1).max())
    return {
        "unstable_poles": poles,
        "residual_m": residual,
        "standstill_share": max(slow, default=0.0),
        "motion": motion,
    }


def _count_unstable(point: OperatingPoint, control: SampledControl | None) -> int:
    """Count poles in the right half plane, or outside the unit circle; without dead time from the eigenvalues."""
    if control is not None:
        return int(np.sum(np.abs(np.linalg.eigvals(_sampled_transition(point, control))) > 1.0 + 1e-9))
    if any(s.servo is not None and s.servo.delay > 0.0 for s in point.slides):
        return point.unstable_poles()
    s = np.linalg.eigvals(point.delay_equation.a)
    return int(np.sum(s.real > 1e-9 * np.abs(s).max(initial=0.0)))


def _sampled_transition(point: OperatingPoint, control: SampledControl) -> Real:
    """Return the matrix that takes motion, integrals and waiting forces from one sample to the next."""
    free = replace(point, slides=tuple(replace(s, servo=None) for s in point.slides))
    a, n, period, lag = free.delay_equation.a, point.structure.size, control.period, control.lag
    rows, held = point.structure.slide_rows(), [(i, s.servo) for i, s in enumerate(point.slides) if s.servo is not None]
    m, count = a.shape[0], len(held)
    block = np.zeros((m + count, m + count))
    block[:m, :m] = a
    block[n : 2 * n, m:] = np.linalg.solve(point.structure.mass, rows[[i for i, _ in held]].T)
    exact = linalg.expm(block * period)[:m]
    size = m + count * (1 + lag)
    z = np.zeros((size, size))
    z[:m, :m] = exact[:, :m]
    for k, (i, servo) in enumerate(held):
        error, integral = np.zeros(size), m + k
        error[:n], error[n : 2 * n] = -servo.Kv * rows[i], -rows[i]
        z[integral] = period * error
        z[integral, integral] = 1.0
        force = servo.Kp * (error + z[integral] / servo.Ti)
        queue = m + count + k * lag
        if lag == 0:
            z[:m] += np.outer(exact[:, m + k], force)
        else:
            z[:m, queue + lag - 1] += exact[:, m + k]
            z[queue] = force
            z[queue + 1 : queue + lag, queue : queue + lag - 1] = np.eye(lag - 1)
    return z


def _unstable_poles(p: _Problem) -> int:
    """Unstable poles of uniform motion, with the local friction."""
    feeds = dict(zip(p.machine.axes, p.feeds, strict=True))
    return _count_unstable(p.machine.at(feeds, p.controller, p.position), p.control)


def _require_bounded(p: _Problem) -> None:
    """Friction limits a motion only where its force rises with speed: the servo must be stable when sliding fast."""
    if not any(v is not None for v in p.servos):
        return
    point, laws = p.machine.at(0.0, p.controller, p.position), [axis.friction for axis in p.machine.axes.values()]
    for slopes in {tuple(_slope(law, sign * _FAST) for law in laws) for sign in (1.0, -1.0)}:
        fast = replace(
            point,
            slides=tuple(
                replace(slide, friction=FrictionImpedance(slope))
                for slide, slope in zip(point.slides, slopes, strict=True)
            ),
        )
        count = _count_unstable(fast, p.control)
        if count:
            gains = "; ".join(
                f"axis {s.name} has Kp {s.servo.Kp:g} N s/m, Ti {s.servo.Ti * 1e3:g} ms, Kv {s.servo.Kv:g} 1/s, delay "
                f"{s.servo.delay * 1e3:g} ms"
                for s in point.slides
                if s.servo is not None
            )
            raise InputError(
                f"the machine is unstable with its servos even when it slides fast: {count} pole(s); {gains}. Lower Kp "
                "or Kv, raise Ti, or shorten the dead time or the sampling period"
            )


def _default_step(p: _Problem) -> float:
    """Return the default step [s], which `simulate_machine` states."""
    bounds = [*(e.shortest / STEPS_PER_EVENT for e in p.excitations), *p.delays]
    period = 2.0 * math.pi / _fastest(p)
    bounds.append(period / STEPS_PER_POLE)
    if p.cut is not None and p.spindle is not None:
        _, fastest = p.spindle.extremes(0.0, p.total)
        bounds.append(1.0 / (STEPS_PER_TOOTH * p.cut.tool.tooth_passing_frequency(fastest)))
        bounds.append(period / STEPS_PER_PERIOD)
    return min(bounds)


def _fastest(p: _Problem) -> float:
    """Largest frequency [rad/s] of the linear part, without dead times."""
    prompt = p._replace(control=None, servos=tuple(None if v is None else replace(v, delay=0.0) for v in p.servos))
    a, _ = _linear_part(prompt, _layout(prompt), p.structures[0])
    return float(np.abs(np.linalg.eigvals(a)).max(initial=1e-9))


def _keep(p: _Problem, sample_rate: float, largest: float) -> int:
    """Steps a sample: the step divides the sampling intervals of record and controller."""
    keep = max(1, math.ceil(1.0 / (sample_rate * largest) - 1e-9))
    if p.control is None:
        return keep
    for more in range(keep, 64 * keep + 64):
        ratio = p.control.period * sample_rate * more
        if abs(ratio - round(ratio)) < 1e-9 * ratio and round(ratio) >= 1:
            return more
    raise InputError(
        f"no step divides both the servo's period {p.control.period:g} s and the interval of {sample_rate:g} samples a "
        "second; give a sample rate that is a simple fraction of the servo's"
    )


def _problem(
    machine: Machine,
    duration: float,
    feed: float | Mapping[str, float],
    controller: str | None,
    position: float | None,
    forces: Mapping[str, Excitation] | None,
    drive_forces: Mapping[str, Excitation] | None,
    cut: MillingCut | None,
    spindle: Spindle | None,
    lead: float,
    tail: float,
    impulse: tuple[float, float, float],
    control: SampledControl | None,
) -> _Problem:
    feeds = machine.feeds(feed)
    if (cut is None) != (spindle is None):
        raise InputError("a cut needs a spindle and a spindle a cut; give both or neither")
    total = lead + duration + tail
    if not all(math.isfinite(v) for v in [total, *feeds.values()]):
        raise InputError(f"{total:g} s at a feed {', '.join(f'{v:g}' for v in feeds.values())} m/s; give finite ones")
    servos = tuple(machine.servos(controller))
    if control is not None and any(v is not None and v.delay > 0.0 for v in servos):
        raise InputError("a sampled servo has a delay of its own; its period and lag make the dead time: set delay 0")
    if cut is None and any(impulse):
        raise InputError("an impulse at entry is given, but no cut; use forces, e.g. a HalfSine")
    strangers = [a for a in drive_forces or {} if a not in machine.axes]
    if strangers:
        raise InputError(f"a drive force on axis {', '.join(strangers)}; this machine drives {', '.join(machine.axes)}")
    axis_index(list(forces or {}))
    return _Problem(
        machine,
        _along_path(machine, feeds, position, total),
        tuple(feeds.values()),
        servos,
        controller,
        dict(forces or {}),
        dict(drive_forces or {}),
        cut,
        spindle,
        lead,
        lead + duration,
        total,
        impulse,
        control,
        position,
    )


def _along_path(
    machine: Machine, feeds: Mapping[str, float], position: float | None, total: float
) -> tuple[Structure, ...]:
    """Return the structure, or those along the path of an axis that a posture depends on."""
    start = machine.structure_at(position)
    if not isinstance(machine.structure, Posture) or feeds.get(machine.structure.axis, 0.0) == 0.0:
        return (start,)
    assert position is not None
    stop = position + feeds[machine.structure.axis] * total
    return tuple(machine.structure_at(float(at)) for at in np.linspace(position, stop, _PATH_POINTS))


def simulate_machine(
    machine: Machine,
    *,
    duration: float,
    feed: float | Mapping[str, float] = 0.0,
    controller: str | None = None,
    position: float | None = None,
    forces: Mapping[str, Excitation] | None = None,
    drive_forces: Mapping[str, Excitation] | None = None,
    cut: MillingCut | None = None,
    spindle: Spindle | None = None,
    lead: float = 0.0,
    tail: float = 0.0,
    impulse: tuple[float, float, float] = (0.0, 0.0, 0.0),
    control: SampledControl | None = None,
    sample_rate: float = 2000.0,
    step: float | None = None,
) -> xr.Dataset:
    """Return the record of a machine at rest or in motion that is hit, shaken, or mills.

    Everything linear moves exactly. The default step is the smallest of 1/8 of the shortest event of the excitations,
    1/24 of the period of the fastest pole, the shortest dead time and, below 4 samples in such a step, half a sample;
    with a cut also of 1/60 of that period and 1/120 of the shortest tooth period, as in `process.simulate`. Where
    friction or a joint does not follow a parabola to `ACCURACY`, a step is halved, up to 8 times. The step is of order
    4, with a cut 2; with LuGre 3 to 4, with Maxwell slip 1 to 4. `step_error` measures what it costs: below 2e-6 for
    a hit of 25 N, 4 ms on the bench of Franco et al. 2024 at 2 kHz, below 1e-4 where up to 1000 N break it away.

    Parameters
    ----------
    machine : Machine
        Structure, servos, friction, joints; it follows its ramps steadily before t = 0.
    duration : float
        Length of the record, with a cut the time in the cut [s].
    feed : float or mapping, optional
        Feed of all axes, or axis name -> feed [m/s], of either sign; zero is idle.
    controller : str, optional
        Name of the controllers, where axes have several.
    position : float, optional
        Position [m], at t = 0, of the axis that a posture depends on; the structure follows its feed.
    forces : mapping, optional
        Axis name -> force on the tool.
    drive_forces : mapping, optional
        Axis name -> force added to that of the drive.
    cut : MillingCut, optional
        The cut; its feed is its own.
    spindle : Spindle, optional
        Speed of the spindle, needed with a cut.
    lead, tail : float, optional
        Time before and after the cut [s]; without one they add to the duration.
    impulse : (float, float, float), optional
        Impulse on the tool at entry [N s], to disturb a cut on purpose.
    control : SampledControl, optional
        The servos work on samples; they must have no delay of their own.
    sample_rate : float, optional
        Samples a second [Hz]; above it every channel is low-passed alike.
    step : float, optional
        Largest integration step [s]. The step used divides the sampling interval; with one step a sample nothing is
        low-passed. The tolerance of friction and joints goes with its fourth power.

    Returns
    -------
    xarray.Dataset
        ``force``, ``displacement`` and ``acceleration`` of the tool (deviations from the ramp) along the axes in which
        it can move; ``encoder_position`` and ``reference_position`` (with the ramp) and ``drive_force`` (with the
        steady friction) of each slide; with a cut ``spindle_angle`` and ``spindle_speed``. Attributes: ``feed_mm_min``
        (one value, or one a slide); ``step_s``; ``energy_error`` (largest error of the energy balance over the largest
        energy; NaN where the structure changes on the way); ``unstable_poles`` of uniform motion with the local
        friction; of the last quarter second, ``residual_m`` (half the swing of the tool) and ``standstill_share``
        (slide slower than a tenth of its feed, or going back; the largest); ``motion``: "settled", "excited to the
        end", "still decaying", or a sentence that begins with "self-excited": not at rest without excitation; with a
        cut ``lost_contact`` and ``largest_chip_thickness_m`` as in `process.simulate.simulate_milling`.

    Raises
    ------
    InputError
        When the servos are unstable when sliding fast, the step is too large, a law jumps at rest, the spindle does
        not turn forward, or the tool leaves the range of 1 m.
    """
    p = _problem(
        machine, duration, feed, controller, position, forces, drive_forces, cut, spindle, lead, tail, impulse, control
    )
    if not p.total * sample_rate >= 2.0:
        raise InputError(f"{p.total:g} s at {sample_rate:g} Hz; at least two samples are needed")
    lay = _layout(p)
    for axis in machine.axes.values():
        _linear_slope(axis.friction, 0.0)
    _require_bounded(p)
    usual = _default_step(p)
    if step is not None:
        _require_fine(p, step)
    half = usual if usual * sample_rate >= 4.0 else 0.5 / sample_rate
    keep = _keep(p, sample_rate, min(usual, half) if step is None else step)
    run = _march(p, lay, sample_rate, keep, 1.0 / (sample_rate * keep * usual))
    return _as_record(p, lay, run, sample_rate)


def step_error(machine: Machine, *, step: float | None = None, **arguments: Any) -> float:
    """Return what the step costs: largest change of the tool's displacement when it is halved, over the largest [1].

    Parameters
    ----------
    machine : Machine
        The machine.
    step : float, optional
        Step to judge [s]; default that of `simulate_machine`.
    **arguments
        As of `simulate_machine`; a sample is a step here.
    """
    arguments.pop("sample_rate", None)
    if step is None:
        step = simulate_machine(machine, **arguments).attrs["step_s"]
    coarse, fine = (
        simulate_machine(machine, sample_rate=1.0 / h, step=h, **arguments)["displacement"].values
        for h in (step, 0.5 * step)
    )
    n = min(coarse.shape[1], (fine.shape[1] + 1) // 2)
    return float(np.abs(coarse[:, :n] - fine[:, ::2][:, :n]).max() / np.abs(fine).max())


def _require_fine(p: _Problem, step: float) -> None:
    largest = min([2.0 * math.pi / _fastest(p) / _COARSEST, *p.delays])
    if not 0.0 < step <= largest * (1.0 + 1e-12):
        raise InputError(
            f"the step is {step * 1e6:g} us; at most {largest * 1e6:.4g} us follow the fastest pole and the dead time "
            "of this machine; leave the step out to have it chosen"
        )
