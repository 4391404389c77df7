"""A machine made ready for `process._machine_kernels`, and its march through time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from process import _machine_kernels as kernels
from process import _machine_parts as machine_parts
from process.errors import InputError
from process.machine_linear import System
from process.machine_packing import (
    HALVINGS,
    Sampled,
    pack_cut,
    pack_elements,
    pack_linear,
    pack_servos,
    scratch,
)
from process.machine_problem import Problem
from process.machine_records import Run

Real = NDArray[np.float64]

AT_REST = 1e-12
"""Share of the largest states and forces below which a machine that nothing excites any more is at rest."""


class Ready(NamedTuple):
    """All of a problem that does not depend on how large its forces are, with steps of `step` [s]."""

    problem: Problem
    system: System
    elements: machine_parts.Elements
    state: Real
    servos: machine_parts.Servos
    ring: int
    linear: machine_parts.Linear
    step: float
    steps: int


def made_ready(p: Problem, system: System, step: float, steps: int) -> Ready:
    """Pack a problem for so many steps [s]."""
    elements, state = pack_elements(p, system)
    servos, ring = pack_servos(p, system, step)
    linear = pack_linear(p, system, elements, step, steps)
    return Ready(p, system, elements, state, servos, ring, linear, step, steps)


def march(
    r: Ready,
    given: machine_parts.Given,
    forces: list[Sampled],
    *,
    keep: int,
    accuracy: float,
    rest: float = AT_REST,
) -> Run:
    """March under forces over time, as packed and as sampled.

    Parameters
    ----------
    r : Ready
        The machine.
    given, forces
        From `process.machine_packing.pack_forces`.
    keep : int
        Steps a sample.
    accuracy : float
        See `process.machine_simulation.ACCURACY`.
    rest : float, optional
        See `AT_REST`.

    Raises
    ------
    InputError
        When friction and joints cannot be solved for, or the tool leaves the range of 1 m.
    """
    inputs = np.zeros((r.steps, r.linear.reach.shape[0] + r.elements.kind.size))
    states = np.zeros((r.steps, r.system.size))
    work = scratch(r.linear, r.elements, r.servos, r.ring, r.state)
    cut = pack_cut(r.problem, r.step)
    end, done = kernels.march(r.linear, r.elements, r.servos, given, work, r.step, accuracy, rest, cut, states, inputs)
    if end == machine_parts.NOT_SOLVED:
        raise InputError(
            f"friction and joints cannot be solved for at {done * r.step:.4g} s even with steps of "
            f"{r.step / 2**HALVINGS * 1e6:.3g} us; give a shorter step, or a law that is less steep"
        )
    _require_near(r.problem, states[: min(done + 1, r.steps), : r.system.n], end, done, r.step)
    worst, largest = work.tally[machine_parts.WORST], work.tally[machine_parts.LARGEST]
    share = float(worst / largest) if largest > 0.0 else 0.0
    lost, thickest = float(work.cutting[machine_parts.LOST]), float(work.cutting[machine_parts.THICKEST])
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
    if end == machine_parts.DONE and farthest < 1.0:
        return
    tip = np.abs(coordinates @ p.structures[0].tool.T)
    if end == machine_parts.RAN_AWAY or not tip.max(initial=0.0) < 1.0:
        late = np.flatnonzero(~(tip.max(axis=1) < 1.0))
        when = (late[0] if late.size else done) * step
        raise InputError(f"the tool left the range of 1 m after {when:.3g} s; it is hit too hard, or unstable")
