"""Force of a joint that is not linear after a hit, in time: its stiffness changes as the vibration dies away.

One stiffness for a whole decay, at whatever mean amplitude, leaves a third to a half of what the joint does: at
resonance a compliance is made of the late, small vibration, beside it of the early, large one. The joint is a single
displacement ``y = v^T q`` of a machine that is otherwise linear, so that it alone is simulated: the machine's
eigenvalues bring every state exactly from one step to the next under forces that run straight between them.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from process.types import Complex, Real
from smfe.diagnosis.frf._joint_kernels import march
from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.rules import RULES

TIMED = ("hardening", "iwan")
"""Fields of a machine with its joints whose force after a hit of a known duration is simulated in time."""

_BLOCK = 128  # steps that are transformed at once


class Stepped(NamedTuple):
    """A machine without its joint in eigenvalue coordinates, from step to step of a grid of time."""

    eigenvalue: Complex  # (n,)
    out: Complex  # of the modes in them, whose real part counts, (M, n)
    into: Complex  # of forces on the modes, (n, M)
    push: Complex  # of forces at the tool along x, y, z, (n, 3)
    step: float  # [s]
    steps: int

    @classmethod
    def of_states(cls, rate: Real, force: Real, modes: int, grid: tuple[float, int]) -> Stepped:
        """Return that of states whose rate is that matrix (n, n), the modes first, and forces on them (n, M + 3).

        A force acts on each of the modes, then at the tool along each axis.
        """
        eigenvalue, vectors = np.linalg.eig(rate)
        into, out = np.linalg.solve(vectors, force.astype(complex)), vectors[:modes]
        # What a fit passes on its way may be unstable: no measured machine is.
        eigenvalue = np.minimum(eigenvalue.real, 0.0) + 1j * eigenvalue.imag
        # Each has its conjugate, or is real: one of the two, twice.
        upper = eigenvalue.imag >= 0.0
        out = out * np.where(eigenvalue.imag > 0.0, 2.0, 1.0)
        return cls(
            np.asarray(eigenvalue[upper], dtype=complex),
            np.asarray(out[:, upper], dtype=complex),
            into[upper, :modes],
            into[upper, modes:],
            *grid,
        )

    @classmethod
    def of(cls, machine: Changed, grid: tuple[float, int]) -> Stepped:
        """Return that of a machine on a grid of time: its step [s] and the count of them."""
        modes = len(machine.frequency)
        w, loss = 2.0 * np.pi * np.array(machine.frequency), np.array(machine.damping)
        shape = np.array(machine.direction).reshape(modes, 3) / np.sqrt(np.array(machine.stiffness))[:, None]
        if not (machine.mass or machine.gyroscopic or machine.springs) and np.all(loss < 1.0):
            # Modes that nothing couples are each an oscillator of its own.
            turning = 1j * w * np.sqrt(1.0 - loss**2)
            real, alone = np.diag(np.full(modes, 2.0 + 0.0j)), np.diag(0.5 * w**2 / turning)
            return cls(np.asarray(turning - loss * w), real, alone, alone @ shape, *grid)
        inverse = np.diag(w**2)
        if machine.mass:
            inverse = np.linalg.inv(np.diag(w**-2) + machine.mass * (shape @ shape.T))
        stiffness, damping = springs_and_losses(machine)
        rate, force = np.zeros((2 * modes, 2 * modes)), np.zeros((2 * modes, modes + 3))
        rate[:modes, modes:] = np.eye(modes)
        rate[modes:, :modes], rate[modes:, modes:] = -inverse @ stiffness, -inverse @ damping
        force[modes:] = inverse @ np.concatenate([np.eye(modes), shape], axis=1)
        return cls.of_states(rate, force, modes, grid)

    def held(self) -> tuple[Complex, Complex, Complex]:
        """Return what a step makes of each state, and of forces at its beginning and at its end."""
        x = self.eigenvalue * self.step
        kept, slow = np.exp(x), np.abs(x) < 1e-3
        safe = np.where(slow, 1.0, x)
        end = self.step * np.where(slow, 0.5 + x / 6.0 + x**2 / 24.0, (np.exp(safe) - 1.0 - safe) / safe**2)
        whole = self.step * np.where(slow, 1.0 + 0.5 * x + x**2 / 6.0, (np.exp(safe) - 1.0) / safe)
        return np.asarray(kept), np.asarray(whole - end), np.asarray(end)


def springs_and_losses(machine: Changed) -> tuple[Real, Real]:
    """Return stiffness and damping matrix of a machine's modes, of unit stiffness each, (M, M)."""
    modes = len(machine.frequency)
    damping = np.diag(np.array(machine.damping) / (np.pi * np.array(machine.frequency)))
    if machine.gyroscopic:
        damping = damping + np.array(machine.gyroscopic).reshape(modes, modes) / (2.0 * np.pi)
    stiffness = np.eye(modes)
    if machine.springs:
        stiffness = stiffness + np.array(machine.springs).reshape(modes, modes)
    return stiffness, damping


@lru_cache(maxsize=16)
def _linear(machine: Changed, grid: tuple[float, int]) -> Stepped:
    """Return the same of a machine without joints: whatever changes with these alone asks for it once."""
    return Stepped.of(machine, grid)


def grid_of(machine: Changed, duration: float) -> tuple[float, int]:
    """Return step [s] and count of steps of a hit, alike for machines that differ a little: predictions are smooth."""
    mine = np.flatnonzero(np.abs(_vector(machine)) > 0.0)
    longest = 1.0 / (RULES.steps_a_period * max(machine.frequency[r] for r in mine))
    step = math.exp(0.1 * math.floor(10.0 * math.log(longest)))
    if duration >= RULES.least_pulse * longest:
        step = duration / math.ceil(duration / longest)
    slowest = min(2.0 * math.pi * machine.damping[r] * machine.frequency[r] for r in mine)
    count = math.ceil(math.log(1.0 / RULES.died_away) / slowest / step)
    return step, min(max(count, RULES.least_steps), RULES.most_steps)


def _vector(machine: Changed) -> Real:
    """Unit vector of the displacement of the one joint that is simulated."""
    name = next(n for n in TIMED if getattr(machine, n))
    return np.array(getattr(machine, name)[2 if name == "iwan" else 1 :])


def _law(machine: Changed, reference: float) -> tuple[float, int, float, float]:
    """Return cubic stiffness, count and stiffness of elements and by how much their travels differ, scaled."""
    if machine.hardening:
        # The mean stiffness of a sine of amplitude a is 3/4 of the cubic one times a^2.
        return machine.hardening[0] / 0.75 / reference**2, 0, 0.0, 1.0
    share, travel = machine.iwan[:2]
    each = min(share / RULES.hit_elements, RULES.largest_share)
    # How far apart they slip is what small vibration sees, and does not depend on how many slip beyond it.
    count = min(RULES.hit_elements, int(RULES.largest_share / each))
    return 0.0, count, each, travel * reference / RULES.hit_elements


def force_in_hits(
    machine: Changed,
    frequency: Real,
    shaken: Shaken,
    axes: tuple[int, ...] = (0, 1, 2),
    like: Changed | None = None,
    stepped: Stepped | None = None,
) -> Complex:
    """Return what the one joint of a machine adds to its linear force over that of a hit along some axes, (f, axes).

    Half sines of the impulse and duration of the hits; the spectrum of what is left at the end is that of a force that
    stays. The grid of time is that of a machine `like` this one, if given: differences between the two are smooth.
    A machine whose modes ride on something is given `stepped`.
    """
    if stepped is None:
        alone = machine._replace(slip=(), hardening=(), iwan=(), mode=(), residual=())
        stepped = _linear(alone, grid_of(machine if like is None else like, shaken.duration))
    kept, begin, end = stepped.held()
    vector, pulse = _vector(machine), _pulse(stepped.step, stepped.steps, shaken.duration)
    impulses = [shaken.impulses[e] if shaken.impulses else shaken.level for e in axes]
    read = vector @ stepped.out
    joint = stepped.into @ vector
    law = _law(machine, shaken.reference)
    rows = np.zeros((len(axes), stepped.steps + 1))
    for row, e, impulse in zip(rows, axes, impulses, strict=True):
        push = impulse * stepped.push[:, e]
        march(kept, begin * push, end * push, begin * joint, end * joint, read, pulse, *law, row)
    lines = tuple(frequency.tolist())
    hit = _hit(lines, stepped.step, stepped.steps, shaken.duration)
    seen = np.abs(hit) > RULES.excited
    whole = np.where(seen, hit, 1.0)
    forces = _transformed(rows, lines, stepped.step)
    return np.stack([np.where(seen, f / (x * whole), 0.0) for f, x in zip(forces, impulses, strict=True)], axis=1)


@lru_cache(maxsize=64)
def _pulse(step: float, steps: int, duration: float) -> Real:
    """Return the force of a hit of 1 N s at all steps [N]: a half sine, no shorter than a few steps."""
    duration = max(duration, RULES.least_pulse * step)
    time = step * np.arange(steps + 1)
    shape = np.where(time < duration, np.sin(np.pi * time / duration), 0.0)
    return np.asarray(shape / (shape.sum() * step))


@lru_cache(maxsize=64)
def _hit(frequency: tuple[float, ...], step: float, steps: int, duration: float) -> Complex:
    """Return the Fourier transform of the force of a hit of 1 N s."""
    steps = min(math.ceil(max(duration / step, RULES.least_pulse)) + 1, steps)
    return np.asarray(_transformed(_pulse(step, steps, duration)[None], frequency, step)[0])


def _transformed(rows: Real, frequency: tuple[float, ...], step: float) -> Complex:
    """Return the Fourier transforms of rows that run straight between steps, begin at zero and stay where they end.

    That of their slopes over ``j w``, in blocks: the phases of all blocks, and within one of them.
    """
    change = np.diff(rows, axis=1)
    count = -(-change.shape[1] // _BLOCK)
    padded = np.zeros((len(rows), count * _BLOCK))
    padded[:, : change.shape[1]] = change
    within = _phases(frequency, step, _BLOCK, 0.5).view(np.float64)
    # Grids differ in length from machine to machine: what is kept are the phases of the next power of two.
    whole = _phases(frequency, _BLOCK * step, 2 ** math.ceil(math.log2(count)), 0.0)[:count]
    parts = (padded.reshape(-1, _BLOCK) @ within).view(complex)
    found = np.einsum("kbf,bf->kf", parts.reshape(len(rows), count, -1), whole)
    f = np.array(frequency)
    return np.asarray(found * np.sinc(f * step) / (2j * np.pi * f))


@lru_cache(maxsize=32)
def _phases(frequency: tuple[float, ...], step: float, count: int, first: float) -> Complex:
    """Return ``exp(-j w t)`` at so many steps from a first on, (count, f)."""
    return np.asarray(np.exp(-2j * np.pi * step * np.outer(np.arange(count) + first, np.array(frequency))))
