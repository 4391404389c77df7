"""Compliance of a modal machine that has been changed: springs, gyroscopic coupling, a mass at the tool, loose joints.

In modal coordinates that are scaled to unit stiffness the machine is

``Phi = V^T D^-1 V,  D = diag(1 - (f/f_r)^2 + 2 j zeta_r f/f_r) + S + j f G - w^2 m V V^T``

with ``V_r = u_r/sqrt(k_r)``: a spring that changes adds a symmetric S, a rotor a skew G, a point mass at the tool the
last term. Modes outside the model answer to none of them. A joint that slips or hardens is a spring somewhere in the
machine, ``g(a) v v^T``, whose stiffness depends on the amplitude a of its own motion ``v^T q`` (describing function); a
slipping one follows Rayleigh's law, whose loops have the loss factor ``4/(3 pi)`` times the loss of stiffness
(Rayleigh, Phil. Mag. 23, 1887).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from process.errors import InputError
from process.machine.modes import ModalModel
from process.types import Complex, Real
from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.joint_in_hits import TIMED, force_in_hits
from smfe.diagnosis.frf.rules import RULES

RAYLEIGH_LOSS = 4.0 / (3.0 * np.pi)
"""Loss factor over loss of stiffness of a joint whose stiffness falls in proportion to the amplitude."""

DECAYING = (2.0 / 3.0, 0.5)
"""Mean amplitude and mean square amplitude of a decaying vibration over those at its start, weighted by energy."""

RANDOM = (0.75 * math.sqrt(math.pi), 2.0)
"""The same of a random vibration over the amplitude of a sine of its rms and the square of that: its amplitude has
Rayleigh's distribution (statistical linearisation: Caughey, J. Acoust. Soc. Am. 35, 1963)."""


def unchanged(model: ModalModel) -> Changed:
    """Return a modal model as it is."""
    f, damping, k, u = (
        tuple(x.ravel().tolist()) for x in (model.frequency, model.damping, model.stiffness, model.direction)
    )
    return Changed(f, damping, k, u)


def full_compliance(machine: Changed, frequency: Real, shaken: Shaken) -> Complex:
    """Return the compliance matrix of a machine at frequencies [Hz], [m/N], shape (f, 3, 3).

    How hard it is shaken counts where a joint is not linear.

    Raises InputError when a stiffness is negative, or a vibration has no single amplitude.
    """
    own, coupling, shape = with_mass(machine, frequency)
    phi = shape.T @ answers(own, coupling, shape)
    for one in timed(machine, shaken):
        joint, force = joints(one)[0], force_in_hits(one, frequency, shaken)
        into = answers(own, coupling, joint.vector[:, None])[:, :, 0]
        phi = phi - (into @ shape)[:, :, None] * force[:, None, :]
    for joint in joints(untimed(machine, shaken)):
        phi = phi - _through_joint(machine, own, coupling, shape, shaken, joint)
    return np.asarray(phi + left_out(machine, frequency))


def timed(machine: Changed, shaken: Shaken) -> list[Changed]:
    """Return the machine with each joint alone whose force is simulated in time."""
    if shaken.method != "hammer" or shaken.duration <= 0.0:
        return []
    alone = linear(machine)
    return [alone._replace(**{name: joint}) for name in TIMED if (joint := getattr(machine, name))]


def untimed(machine: Changed, shaken: Shaken) -> Changed:
    """Return the machine without the joints whose force is simulated in time."""
    if shaken.method != "hammer" or shaken.duration <= 0.0:
        return machine
    return machine._replace(hardening=(), iwan=())


def linear(machine: Changed) -> Changed:
    """Return the machine without any joint that is not linear."""
    return machine._replace(slip=(), hardening=(), iwan=())


def in_mode_space(machine: Changed, frequency: Real) -> tuple[Complex, Complex | None, Real]:
    """Return each mode's own dynamic stiffness (f, M), what couples them (f, M, M) or None, and V, (M, 3).

    Raises InputError when a stiffness is negative.
    """
    count, f = len(machine.frequency), frequency[:, None, None]
    ratio = frequency[:, None] / np.array(machine.frequency)
    own = 1.0 - ratio**2 + 2j * np.array(machine.damping) * ratio
    shape = np.array(machine.direction).reshape(count, 3) / np.sqrt(np.array(machine.stiffness))[:, None]
    coupling: Complex | None = None
    if machine.springs:
        springs = np.array(machine.springs).reshape(count, count)
        if np.linalg.eigvalsh(springs + np.eye(count))[0] <= 0.0:
            raise InputError("a machine whose stiffness is negative in some direction does not stand; change less")
        coupling = np.broadcast_to(springs[None].astype(complex), (len(frequency), count, count))
    if machine.gyroscopic:
        turning = 1j * f * np.array(machine.gyroscopic).reshape(count, count)
        coupling = turning if coupling is None else coupling + turning
    return own, coupling, shape


def with_mass(machine: Changed, frequency: Real) -> tuple[Complex, Complex | None, Real]:
    """Return the same as `in_mode_space`, with the mass that the tool carries."""
    own, coupling, shape = in_mode_space(machine, frequency)
    if machine.mass:
        square = (2.0 * np.pi * frequency[:, None, None]) ** 2 * machine.mass * (shape @ shape.T)
        coupling = -square.astype(complex) if coupling is None else coupling - square
    return own, coupling, shape


def left_out(machine: Changed, frequency: Real) -> Complex:
    """Return the compliance of what the modes leave out [m/N], shape (f or 1, 3, 3)."""
    beyond = np.zeros((1, 3, 3), dtype=complex)
    if machine.residual:
        xx, yy, zz, xy, yz, zx = machine.residual
        beyond = beyond + np.array([[xx, xy, zx], [xy, yy, yz], [zx, yz, zz]])
    if machine.mode:
        along, turns = np.array(machine.mode[:3]), frequency / machine.mode[3]
        dynamic = 1.0 - turns**2 + 2j * machine.mode[4] * turns
        beyond = beyond + np.outer(along, along) / dynamic[:, None, None]
    return beyond


def answers(own: Complex, coupling: Complex | None, force: Real) -> Complex:
    """Return the amplitudes of the modes under forces on them (M, c), shape (f, M, c)."""
    if coupling is None:
        return np.asarray(force / own[:, :, None])
    whole = coupling + own[:, :, None] * np.eye(own.shape[1])
    return np.asarray(np.linalg.solve(whole, np.broadcast_to(force.astype(complex), (len(own), *force.shape))))


def amplitude(machine: Changed, method: str, level: float, band: float = 0.0) -> float:
    """Largest amplitude of any mode in scaled coordinates under an impact or a sine along x, y or z [sqrt(J)].

    Of a multisine over a `band` [Hz] it is that of a sine of the same rms: ``int |1/(1 - r^2 + 2j zeta r)|^2 df = pi
    f_r/(4 zeta)``.
    """
    shape = np.array(machine.direction).reshape(-1, 3) / np.sqrt(np.array(machine.stiffness))[:, None]
    force = level * np.abs(shape).max(axis=1)
    if method == "hammer":
        return float(np.max(force * 2.0 * np.pi * np.array(machine.frequency)))
    if band > 0.0:
        wide = np.pi * np.array(machine.frequency) / (4.0 * np.array(machine.damping))
        return float(np.max(force * np.sqrt(wide / band)))
    return float(np.max(force / (2.0 * np.array(machine.damping))))


def _slipping(size: float, amplitude: Real, _: Real) -> Complex:
    """Stiffness lost at an amplitude relative to the reference."""
    lost = size * amplitude
    return np.asarray(-(1.0 - 1j * RAYLEIGH_LOSS) * lost / (1.0 + lost))


def _spent(travel: float, share: float, amplitude: Real, _: Real) -> Complex:
    """Stiffness lost by parallel Jenkins elements whose travels are spread evenly up to a largest one.

    Up to it a share ``X/(2 D)`` of the stiffness, by Rayleigh's law; beyond it all elements slip, and the force stays
    (closed form: `process.machine.joints.Iwan`).
    """
    x = np.maximum(amplitude / travel, 1e-300)
    q = np.arccos(np.clip(1.0 - 2.0 / np.maximum(x, 1.0), -1.0, 1.0))
    beyond = x / (2.0 * np.pi) * (np.sin(q) - q * np.cos(q) - np.sin(q) ** 3 / 3.0)
    kept = np.where(x <= 1.0, 1.0 - 0.5 * x, beyond)
    slid = 4.0 * (0.5 * x - 1.0 / 3.0) / (np.pi * np.maximum(x, 1.0) ** 2)
    loss = np.where(x <= 1.0, 2.0 * x / (3.0 * np.pi), slid)
    return np.asarray(share * (kept - 1.0 + 1j * loss))


def _hardening(size: float, _: Real, square: Real) -> Complex:
    """Stiffness gained at the square of an amplitude relative to the reference."""
    return np.asarray(size * square + 0j)


class Joint(NamedTuple):
    """A spring somewhere in the machine whose stiffness depends on its amplitude."""

    size: float  # what it loses or gains at the amplitude of reference
    vector: Real  # of its displacement, in mode space
    law: Callable[[float, Real, Real], Complex]  # size, amplitude, mean square -> stiffness


def joints(machine: Changed) -> list[Joint]:
    """Return the joints of a machine that are not linear."""
    both = ((machine.slip, _slipping), (machine.hardening, _hardening))
    found = [Joint(joint[0], np.array(joint[1:]), law) for joint, law in both if joint]
    if machine.iwan:
        share, travel, *vector = machine.iwan
        there = min(1.0, RULES.largest_share / share)
        found.append(Joint(there * share, np.array(vector), partial(_spent, there * travel)))
    return found


def stiffness_of(
    joint: Joint, machine: Changed, shape: Real, shaken: Shaken, direct: Complex, moved: Complex
) -> Complex:
    """Return the stiffness of a joint under forces at the tool, shape (f or 1, 3).

    `direct` is its own compliance without it (f, 1), `moved` its displacement over each force (f, 3).
    """
    if shaken.method == "hammer":
        start = shaken.level / shaken.reference * np.abs(joint.vector[:, None] * shape)
        start = np.sqrt(np.sum((start * 2.0 * np.pi * np.array(machine.frequency)[:, None]) ** 2, axis=0))
        return in_a_hit(joint, start)[None]
    free = np.abs(moved) * shaken.level / shaken.reference
    if shaken.power is not None:
        return _at_once(partial(_of_random, joint), direct, free * np.sqrt(shaken.power)[:, None])
    return _steady(lambda a: joint.law(joint.size, a, a**2), direct, free)


def in_a_hit(joint: Joint, start: Real) -> Complex:
    """Return the stiffness of a joint after a hit that starts it with an amplitude."""
    return joint.law(joint.size, DECAYING[0] * start, DECAYING[1] * start**2)


def _of_random(joint: Joint, amplitude: Real) -> Complex:
    return joint.law(joint.size, RANDOM[0] * amplitude, RANDOM[1] * amplitude**2)


def _at_once(law: Callable[[Real], Complex], direct: Complex, free: Real) -> Complex:
    """Solve ``a^2 = sum_f |free/(1 + g(a) direct)|^2`` for the one amplitude of each force; return g, (1, 3).

    By bisection of the logarithm of the amplitude: what moves less than it must move at a smaller one.
    """
    low, high = np.full(free.shape[1], 1e-6), np.full(free.shape[1], 1e3)
    size = np.sqrt(np.sum(free**2, axis=0)) + 1e-300
    for _ in range(40):
        middle = np.sqrt(low * high)
        moved = np.sqrt(np.sum(np.abs(free / (1.0 + law(middle * size) * direct)) ** 2, axis=0))
        more = moved > middle * size
        low, high = np.where(more, middle, low), np.where(more, high, middle)
    return law(np.sqrt(low * high) * size)[None]


def _through_joint(
    machine: Changed, own: Complex, coupling: Complex | None, shape: Real, shaken: Shaken, joint: Joint
) -> Complex:
    """Compliance that a joint takes away (Sherman and Morrison), shape (f, 3, 3)."""
    both = answers(own, coupling, np.concatenate([shape, joint.vector[:, None]], axis=1))
    moved, into = joint.vector @ both[:, :, :3], both[:, :, 3]
    direct = (into @ joint.vector)[:, None]
    stiffness = stiffness_of(joint, machine, shape, shaken, direct, moved)
    return np.asarray((into @ shape)[:, :, None] * (stiffness * moved / (1.0 + stiffness * direct))[:, None, :])


def _steady(law: Callable[[Real], Complex], direct: Complex, free: Real) -> Complex:
    """Solve ``a |1 + g(a) direct| = free`` for the amplitude a by secant steps; return the stiffness g, (f, 3)."""
    before = free
    error = before * np.abs(1.0 + law(before) * direct) - free
    now = free / np.abs(1.0 + law(free) * direct)
    for _ in range(40):
        stiffness = law(now)
        factor = np.abs(1.0 + stiffness * direct)
        fresh = now * factor - free
        if np.all(np.abs(fresh) <= 1e-9 * free + 1e-300):
            return stiffness
        apart = now - before
        slope = (fresh - error) / np.where(apart == 0.0, 1.0, apart)
        safe = (slope > 0.05) & (apart != 0.0)
        step = np.where(safe, now - fresh / np.where(safe, slope, 1.0), free / factor)
        before, error, now = now, fresh, np.maximum(step, 0.0)
    raise InputError("a joint that is not linear jumps between two amplitudes there; take a lower level")
