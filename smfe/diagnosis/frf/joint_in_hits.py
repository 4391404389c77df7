"""Force of a joint that is not linear after a hit, in time: its stiffness changes as the vibration dies away.

One stiffness for a whole decay, at whatever mean amplitude, leaves a third to a half of what the joint does: at
resonance a compliance is made of the late, small vibration, beside it of the early, large one. The joint is a single
displacement ``y = v^T q`` of a machine that is otherwise linear, so that it alone is simulated: the machine's
eigenvalues bring every state exactly from one step to the next under forces that run straight between them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from process.types import Complex, Real
from smfe.diagnosis.frf._joint_kernels import march
from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.rules import RULES

TIMED = ("hardening", "iwan")
"""Fields of a machine with its joints whose force after a hit of a known duration is simulated in time."""


class _Linear(NamedTuple):
    """A machine without its joint in eigenvalue coordinates, and a grid of time for its hits."""

    eigenvalue: Complex  # (n,)
    out: Complex  # of the modes in them, whose real part counts, (M, n)
    into: Complex  # of forces on the modes, (n, M)
    shape: Real  # V, (M, 3)
    step: float  # [s]
    steps: int

    @classmethod
    def of(cls, machine: Changed, grid: tuple[float, int]) -> _Linear:
        """Return it on a grid of time: its step [s] and the count of them."""
        modes = len(machine.frequency)
        w = 2.0 * np.pi * np.array(machine.frequency)
        shape = np.array(machine.direction).reshape(modes, 3) / np.sqrt(np.array(machine.stiffness))[:, None]
        inverse = np.diag(w**2)
        if machine.mass:
            inverse = np.linalg.inv(np.diag(w**-2) + machine.mass * (shape @ shape.T))
        damping = np.diag(2.0 * np.array(machine.damping) / w)
        if machine.gyroscopic:
            damping = damping + np.array(machine.gyroscopic).reshape(modes, modes) / (2.0 * np.pi)
        stiffness = np.eye(modes)
        if machine.springs:
            stiffness = stiffness + np.array(machine.springs).reshape(modes, modes)
        rate, force = np.zeros((2 * modes, 2 * modes)), np.zeros((2 * modes, modes), dtype=complex)
        rate[:modes, modes:] = np.eye(modes)
        rate[modes:, :modes], rate[modes:, modes:] = -inverse @ stiffness, -inverse @ damping
        force[modes:] = inverse
        eigenvalue, vectors = np.linalg.eig(rate)
        into, out = np.linalg.solve(vectors, force), vectors[:modes]
        upper = eigenvalue.imag > 0.0
        if 2 * int(upper.sum()) == upper.size:
            # Each has its conjugate: one of the two, twice.
            eigenvalue, into, out = eigenvalue[upper], into[upper], 2.0 * out[:, upper]
        return cls(eigenvalue, out, into, shape, *grid)

    def held(self) -> tuple[Complex, Complex, Complex]:
        """Return what a step makes of each state, and of forces at its beginning and at its end."""
        x = self.eigenvalue * self.step
        kept = np.exp(x)
        end = (kept - 1.0 - x) / (self.eigenvalue * x)
        return kept, (kept - 1.0) / self.eigenvalue - end, end


def _grid(machine: Changed, duration: float) -> tuple[float, int]:
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


def _law(machine: Changed, reference: float) -> tuple[float, Real, Real]:
    """Return cubic stiffness, stiffnesses of elements and the force that each holds, in scaled coordinates."""
    if machine.hardening:
        # The mean stiffness of a sine of amplitude a is 3/4 of the cubic one times a^2.
        return machine.hardening[0] / 0.75 / reference**2, np.zeros(0), np.zeros(0)
    share, travel = machine.iwan[:2]
    count = RULES.hit_elements
    stiffness = np.full(count, share / count)
    return 0.0, stiffness, stiffness * travel * reference * (np.arange(count) + 0.5) / count


def force_in_hits(
    machine: Changed,
    frequency: Real,
    shaken: Shaken,
    axes: tuple[int, ...] = (0, 1, 2),
    like: Changed | None = None,
) -> Complex:
    """Return what the one joint of a machine adds to its linear force over that of a hit along some axes, (f, axes).

    Half sines of the impulse and duration of the hits; the spectrum of what is left at the end is that of a force that
    stays. The grid of time is that of a machine `like` this one, if given: differences between the two are smooth.
    """
    linear = _Linear.of(machine, _grid(machine if like is None else like, shaken.duration))
    kept, begin, end = linear.held()
    vector, pulse = _vector(machine), _pulse(linear, shaken.duration)
    impulses = [shaken.impulses[e] if shaken.impulses else shaken.level for e in axes]
    read = vector @ linear.out
    joint = linear.into @ vector
    cubic, stiffness, most = _law(machine, shaken.reference)
    rows = np.zeros((len(axes) + 1, linear.steps + 1))
    rows[-1] = pulse
    for row, e, impulse in zip(rows, axes, impulses, strict=False):
        push = impulse * (linear.into @ linear.shape[:, e])
        march(kept, begin * push, end * push, begin * joint, end * joint, read, pulse, cubic, stiffness, most, row)
    *forces, hit = _transformed(rows, frequency, linear.step)
    seen = np.abs(hit) > RULES.excited
    whole = np.where(seen, hit, 1.0)
    return np.stack([np.where(seen, f / (x * whole), 0.0) for f, x in zip(forces, impulses, strict=True)], axis=1)


def _pulse(linear: _Linear, duration: float) -> Real:
    """Return the force of a hit of 1 N s at all steps [N]: a half sine, no shorter than a few steps."""
    duration = max(duration, RULES.least_pulse * linear.step)
    time = linear.step * np.arange(linear.steps + 1)
    shape = np.where(time < duration, np.sin(np.pi * time / duration), 0.0)
    return np.asarray(shape / (shape.sum() * linear.step))


def _transformed(rows: Real, frequency: Real, step: float) -> list[Complex]:
    """Return the Fourier transforms of rows that run straight between steps, begin at zero and stay where they end.

    That of their slopes over ``j w``, in blocks: the phases of all blocks, and within one of them.
    """
    change = np.diff(rows, axis=1)
    block = max(math.isqrt(change.shape[1]), 1)
    count = -(-change.shape[1] // block)
    padded = np.zeros((len(rows), count * block))
    padded[:, : change.shape[1]] = change
    w = 2.0 * np.pi * frequency
    within = np.exp(-1j * step * np.outer(np.arange(block) + 0.5, w))
    whole = np.exp(-1j * step * np.outer(block * np.arange(count), w))
    scale = np.sinc(frequency * step) / (1j * w)
    parts = padded.reshape(-1, block) @ within
    found = np.einsum("kbf,bf->kf", parts.reshape(len(rows), count, frequency.size), whole)
    return list(found * scale)
