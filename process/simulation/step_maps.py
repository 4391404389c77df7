"""The linear part of a machine in time: its matrices, and exact maps over a step for inputs that are parabolas."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from process.drive.servo import Servo
from process.labels import axis_index
from process.machine.structure import Structure
from process.simulation.problem import Problem
from process.types import Real

_SERIES_NORM = 0.25
_SERIES_TERMS = 12


class System(NamedTuple):
    """Coordinates n, states N (q, q', integrals); axis numbers of prompt and late servos and of bent friction laws.

    matrices: A (N, N) and B (N, u) of ``z' = A z + B u`` with prompt servos and linear friction, of each structure;
    inputs u are forces on the tool, on the slides, in the joints.
    """

    n: int
    size: int
    prompt: list[int]
    late: list[int]
    nonlinear: list[int]
    matrices: list[tuple[Real, Real]]

    @property
    def driven(self) -> list[int]:
        """Axes whose servo is continuous, in the order of their integrals."""
        return sorted(self.prompt + self.late)


def system_of(p: Problem) -> System:
    """Return the linear part of a problem."""
    driven = [] if p.run.control else [i for i, v in enumerate(p.servos) if v is not None]
    late = [i for i in driven if p.servos[i].delay > 0.0]  # type: ignore[union-attr]
    prompt = [i for i in driven if i not in late]
    n = p.structures[0].size
    nonlinear = [i for i, r in enumerate(p.friction) if r.nonlinear]
    system = System(n, 2 * n + len(driven), prompt, late, nonlinear, [])
    return system._replace(matrices=[_matrices(p, system, s) for s in p.structures])


def _gain(servo: Servo, row: Real, at: int, size: int) -> Real:
    """Row K of ``F_servo = -K z``; `at` is the place of the integral."""
    n, gain = row.size, np.zeros(size)
    gain[:n], gain[n : 2 * n] = servo.Kp * (servo.Kv + 1.0 / servo.Ti) * row, servo.Kp * row
    gain[at] = servo.Kp * servo.Kv / servo.Ti
    return gain


def gains(p: Problem, system: System, structure: Structure) -> dict[int, Real]:
    """Axis number -> row K of its servo; integrals stand in the order of the axes."""
    rows = structure.slide_rows()
    return {
        i: _gain(p.servos[i], rows[i], 2 * system.n + k, system.size)  # type: ignore[arg-type]
        for k, i in enumerate(system.driven)
    }


def reach(p: Problem, structure: Structure) -> Real:
    """Participation of the inputs, shape (u, n): forces on the tool, on the slides, in the joints."""
    joints = [m.participation for m in p.machine.joints]
    parts = [
        structure.tool[axis_index(p.run.tool_axes)],
        structure.slide_rows(),
        np.reshape(joints, (len(joints), structure.size)),
    ]
    return np.vstack([part for part in parts if part.size] or [np.zeros((0, structure.size))])


def _matrices(p: Problem, system: System, structure: Structure, closed: list[int] | None = None) -> tuple[Real, Real]:
    """Return A and B, with the servos of the axes in closed, by default the prompt ones."""
    n, rows = system.n, structure.slide_rows()
    damping = structure.damping + (rows.T * [r.slope for r in p.friction]) @ rows
    inputs = reach(p, structure)
    held = np.linalg.solve(structure.mass, np.hstack([structure.stiffness, damping, inputs.T, rows.T]))
    a, b = np.zeros((system.size, system.size)), np.zeros((system.size, inputs.shape[0]))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, : 2 * n], b[n : 2 * n] = -held[:, : 2 * n], held[:, 2 * n : 2 * n + b.shape[1]]
    slides = held[:, 2 * n + b.shape[1] :]
    for k, i in enumerate(system.driven):
        a[2 * n + k, :n] = rows[i]
    for i, gain in gains(p, system, structure).items():
        if i in (system.prompt if closed is None else closed):
            a[n : 2 * n] -= np.outer(slides[:, i], gain)
    return a, b


def fastest_pole(p: Problem, system: System) -> float:
    """Largest frequency [rad/s] of the linear part, without dead times."""
    if p.run.control is not None:
        system = system_of(p._replace(run=replace(p.run, control=None), structures=p.structures[:1]))
    a, _ = _matrices(p, system, p.structures[0], system.driven) if system.late else system.matrices[0]
    return float(np.abs(np.linalg.eigvals(a)).max(initial=1e-9))


def exact_maps(a: Real, b: Real, rows: Real, step: float, halvings: int) -> Real:
    """Exact maps for inputs quadratic in time, for a step halved 0, 1, ... times; `_machine_arrays.Linear`.

    The matrix exponential of state and input polynomial, for a quarter of the finest step; the others by squaring.
    """
    size, u = b.shape
    whole = np.zeros((size + 3 * u, size + 3 * u))
    whole[:size, :size], whole[:size, size : size + u] = a, b
    whole[size : size + u, size + u : size + 2 * u] = np.eye(u)
    whole[size + u : size + 2 * u, size + 2 * u :] = 2.0 * np.eye(u)
    power = np.array(_exponentials(whole * step, halvings + 2))[:, :size]
    # A quarter, half and the whole of the step of each level.
    stages = power[np.arange(halvings, -1, -1)[:, None] + np.arange(3)]
    inputs = stages[..., size:].reshape(halvings + 1, 3, size, 3, u)
    turned = np.einsum("lkd,lgsdu->lguks", _parabolas(step, halvings), inputs)
    maps = np.concatenate([stages[..., :size].swapaxes(2, 3), turned.reshape(halvings + 1, 3, 3 * u, size)], axis=2)
    motion = maps @ rows.T
    return np.concatenate([maps[:, 1], maps[:, 2], motion[:, 0], motion[:, 1], motion[:, 2]], axis=2)


def _parabolas(step: float, halvings: int) -> Real:
    """Value, slope and half the curvature of an input from its values at start, middle and end, at each level."""
    shape = np.array([[1.0, -3.0, 2.0], [0.0, 4.0, -4.0], [0.0, -1.0, 2.0]])
    return np.asarray(shape / (step / 2.0 ** np.arange(halvings + 1.0))[:, None, None] ** np.arange(3.0))


def _exponentials(matrix: Real, halvings: int) -> list[Real]:
    """Return ``exp(matrix/2^k)`` for k from `halvings` down to 0: Taylor series where the norm is small, then squares.

    A general routine costs more than all the rest of a short run.
    """
    norm = float(np.abs(matrix).sum(axis=1).max())
    more = max(halvings, math.ceil(math.log2(max(norm, 1e-300) / _SERIES_NORM)))
    small = matrix / 2.0**more
    unit = np.eye(matrix.shape[0])
    total = unit
    for k in range(_SERIES_TERMS, 0, -1):
        total = small @ total
        total /= k
        total += unit
    found = [total]
    for _ in range(more):
        found.append(found[-1] @ found[-1])
    return found[more - halvings :]
