r"""How the compliance of a machine on slides changes with its parameters, in closed form.

Modes and slides together are ``A q = P F``, ``Phi_e = P^T A_e^-1 P_e`` under a force along e, with

``A_e = [[D + S_e + j f G, -w^2 l^T], [-w^2 l, B]] - w^2 m P P^T``,  ``P = [V; E^T]``

(`smfe.diagnosis.machine.dynamics`); a joint that is not linear is a spring in S_e, at the amplitude that a hit along e
gives it. With ``x = A_e^-1 P_e`` and ``y_i = A_e^-T P_i`` a change of anything changes

``d Phi_ie = dP_i^T x + y_i^T dP_e - y_i^T dA_e x``,

which is a few products for all parameters together where differences of predictions cost a solution each. How A and P
change with a parameter is found by differences of those: they are smooth, and small. Joints that are simulated in time
act as forces: they come to P_e in x alone, and change with what they are simulated with besides (`family.Beside`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from process.types import Complex, Real
from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.modal_dynamics import left_out, untimed
from smfe.diagnosis.frf.modal_slopes import springs_of as joint_springs
from smfe.diagnosis.machine.dynamics import Slide

STEP = 1e-3
"""Half of the step of the differences, in scales: of functions in closed form, so that rounding does not count."""

MOST = 100_000  # parts that are kept for one set of values


class Machine(NamedTuple):
    """A machine under one condition, as parameters make it."""

    modes: Changed
    slides: tuple[Slide, ...]


class Parts(NamedTuple):
    """What A and P are made of; real numbers but for springs, base, pull and what is beyond."""

    springs: Complex  # S_e, (3, M, M)
    frequency: Real  # of the modes [Hz], (M,)
    damping: Real  # (M,)
    turning: Real  # G, (M, M)
    shape: Real  # P, (M + a, 3)
    mass: Real  # m, (1,)
    beyond: Complex  # compliance that does not answer to any of it, (f or 1, 3, 3)
    momentum: Real  # l, (a, M)
    base: Complex  # B, (a, f)
    joints: Real  # displacements of joints that are simulated in time, (M + a, j)
    pull: Complex  # force of each of them over that of a hit along e, (3, f, j)


def springs_of(modes: Changed, shaken: Shaken) -> Complex:
    """Return the springs of a machine that is hit, or whose joints are linear, under a force along each axis, S_e.

    Without those of joints that are simulated in time.
    """
    own = joint_springs(untimed(modes, shaken), shaken)
    return own + np.array(modes.springs).reshape(own.shape[1:]) if modes.springs else own


def parts_of_modes(modes: Changed, slides: Sequence[Slide], frequency: Real) -> tuple[Any, ...]:
    """Return the parts of a machine that do not depend on how it is shaken or moves: frequency to beyond."""
    natural, count = np.array(modes.frequency), len(modes.frequency)
    v = np.array(modes.direction).reshape(count, 3) / np.sqrt(np.array(modes.stiffness))[:, None]
    turning = np.array(modes.gyroscopic).reshape(count, count) if modes.gyroscopic else np.zeros((count, count))
    ends = np.zeros((len(slides), 3))
    ends[range(len(slides)), [s.axis for s in slides]] = 1.0
    mass, shape = np.array([modes.mass]), np.concatenate([v, ends])
    return natural, np.array(modes.damping), turning, shape, mass, left_out(modes, frequency)


Change = list[Any]
"""How each of the parts changes; None: not at all."""


def slopes(parts: Parts, changes: Sequence[Change], frequency: Real) -> Complex:
    """Return the changes of the compliance, and of what joints move by, shape (p, f, 3 + j, 3), for p changes of parts.

    Their forces stay what they are.
    """
    p, size = len(changes), frequency.size
    w, f = 2.0 * np.pi * frequency, frequency[:, None]
    carried, ratio, count = w**2 * parts.mass, f / parts.frequency, parts.frequency.size
    by_frequency = (2.0 * ratio**2 - 2j * parts.damping * ratio) / parts.frequency
    rows = 3 + parts.joints.shape[1]
    out = np.zeros((p, size, rows, 3), dtype=complex)
    for one, change in zip(out, changes, strict=True):
        if change[6] is not None:
            one[:, :3] += change[6]
    real = np.concatenate([_stacked(changes, k, parts[k].size) for k in (1, 2, 3, 7, 4, 5)], axis=1)
    springs = _stacked(changes, 0, 3 * count**2, complex).reshape(p, 3, count**2)
    used, moved = np.any(real != 0.0, axis=0), [j for j, c in enumerate(changes) if c[8] is not None]
    base = np.array([changes[j][8] for j in moved])
    for e in range(3):
        x, y = _answers(parts, frequency, e)  # (f, n), (f, n, 3 + j)
        response, own = y.transpose(0, 2, 1) @ parts.shape, x @ parts.shape  # of the tool, (f, 3 + j, 3) and (f, 3)
        to, by = (a[:, :count] for a in (y, x))
        on, under = (a[:, count:] for a in (y, x))
        of_tool = np.eye(rows, 3) + carried[:, None, None] * response  # (f, i, k)
        of_force = np.eye(3)[e] + carried[:, None] * own  # (f, k)
        both = to[:, :, None, :] * by[:, None, :, None]  # (f, r, s, i)
        along = on[:, :, None, :] * by[:, None, :, None] + to[:, None, :, :] * under[:, :, None, None]
        ends = x[:, :, None, None] * of_tool.transpose(0, 2, 1)[:, None] + y[:, :, None, :] * of_force[:, None, :, None]
        single = to * by[:, :, None]
        terms = [
            -by_frequency[:, :, None] * single,
            -2j * ratio[:, :, None] * single,
            -1j * frequency[:, None, None] * both.reshape(size, -1, rows),
            (w**2)[:, None, None] * along.reshape(size, -1, rows),
            ends.reshape(size, -1, rows),
            ((w**2)[:, None] * np.einsum("fik,fk->fi", response, own))[:, None],
        ]
        basis = np.ascontiguousarray(np.concatenate(terms, axis=1)[:, used].transpose(1, 0, 2))
        basis = basis.reshape(int(used.sum()), rows * size)
        out[..., e] += _product(real[:, used], basis).reshape(p, size, rows)
        spring = springs[:, e]
        if np.any(spring):
            basis = both.reshape(size, -1, rows).transpose(1, 0, 2).reshape(spring.shape[1], rows * size)
            out[..., e] -= (spring @ basis).reshape(p, size, rows)
        if moved:
            out[moved, :, :, e] -= np.einsum("paf,fai->pfi", base, on * under[:, :, None])
    return out


def _stacked(changes: Sequence[Change], k: int, size: int, kind: type = float) -> Any:
    """Return how one of the parts changes, flat, (p, n)."""
    out: Any = np.zeros((len(changes), size), dtype=kind)
    for row, change in zip(out, changes, strict=True):
        if change[k] is not None:
            row[:] = change[k].ravel()
    return out


def _product(real: Real, basis: Complex) -> Complex:
    """Return a real matrix times a complex one."""
    return (real @ basis.view(np.float64)).view(np.complex128)


def _answers(parts: Parts, frequency: Real, e: int) -> tuple[Complex, Complex]:
    """Return ``A_e^-1 P_e`` with the pull of joints, (f, n), and ``A_e^-T`` of P and joints, (f, n, 3 + j)."""
    count, w = parts.frequency.size, 2.0 * np.pi * frequency
    ratio, n = frequency[:, None] / parts.frequency, parts.shape.shape[0]
    a = np.zeros((frequency.size, n, n), dtype=complex)
    a[:, :count, :count] = parts.springs[e] + 1j * frequency[:, None, None] * parts.turning
    at = np.arange(count)
    a[:, at, at] += 1.0 - ratio**2 + 2j * parts.damping * ratio
    a[:, count:, :count] = -(w**2)[:, None, None] * parts.momentum
    a[:, :count, count:] = -(w**2)[:, None, None] * parts.momentum.T
    slides = np.arange(count, n)
    a[:, slides, slides] = parts.base.T
    if parts.mass[0]:
        a -= (w**2)[:, None, None] * parts.mass * (parts.shape @ parts.shape.T)
    force = np.tile(parts.shape[:, e].astype(complex), (len(a), 1))
    force -= parts.pull[e] @ parts.joints.T
    x = np.linalg.solve(a, force[:, :, None])[:, :, 0]
    seen = np.concatenate([parts.shape, parts.joints], axis=1).astype(complex)
    y = np.linalg.solve(a.transpose(0, 2, 1), np.broadcast_to(seen, (len(a), *seen.shape)))
    return x, y
