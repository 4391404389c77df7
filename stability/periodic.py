"""What both converged methods start from: the pattern in which the teeth pass, and the machine in its modes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from process.cut.tool import Tool
from process.errors import InputError

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


NO_LOBE = -1
"""Value of ``lobe`` where there is no limit."""


class Machine(Protocol):
    """Anything linear seen from the tool: a `process.ModalModel`, a closed loop."""

    def state_space(self) -> tuple[Real, Real, Real]:
        """Return A (N, N), B (N, 3), C (3, N) of ``q' = A q + B F``, ``r = C q``."""


@dataclass(frozen=True)
class Pattern:
    """How the teeth follow each other; all angles [rad].

    Parameters
    ----------
    repeats : int
        How often the pattern repeats in a turn: the number of teeth for equal pitch.
    lag : ndarray, shape (teeth,)
        How far each tooth runs behind tooth 0.
    delay : ndarray, shape (teeth,)
        How far each tooth runs behind the tooth that has cut before it.
    """

    repeats: int
    lag: Real
    delay: Real

    @property
    def period(self) -> float:
        """Angle after which the cut repeats."""
        return 2.0 * math.pi / self.repeats

    def lobe(self, turns: float) -> int:
        """Return the whole waves between two teeth, on average, of a line with so many waves in a period."""
        return math.floor(turns * self.repeats / self.lag.size + 1e-9)

    def duration(self, spindle_speed: float) -> float:
        """Return the time after which the cut repeats [s] at a spindle speed [rpm]."""
        return 60.0 / (spindle_speed * self.repeats)


def pattern_of(tool: Tool, method: str) -> Pattern:
    """Return the pattern of a tool.

    Raises
    ------
    InputError
        For a helix: the engagement then depends on the depth that is asked for.
    """
    if tool.helix_angle > 0.0:
        raise InputError(
            f"the tool has a helix of {math.degrees(tool.helix_angle):g} deg; the {method} needs straight edges: a "
            "helix makes the engagement depend on the depth. Leave helix_angle out to neglect it"
        )
    return pattern_of_pitch(tool)


def pattern_of_pitch(tool: Tool) -> Pattern:
    """Return the pattern of the pitch angles alone."""
    lag = tool.tooth_angles()
    pitch = np.diff(np.append(lag, 2.0 * math.pi))
    shift = next(s for s in range(1, lag.size + 1) if np.allclose(pitch, np.roll(pitch, s), rtol=0.0, atol=1e-9))
    return Pattern(lag.size // shift, lag, np.roll(pitch, 1))


@dataclass(frozen=True)
class Modes:
    """A machine in its modal coordinates ``z' = rate z + participation F``, ``r = shape z``.

    Parameters
    ----------
    rate : ndarray of complex, shape (N,)
        Poles [1/s].
    shape : ndarray of complex, shape (3, N)
        Displacement of the tool a unit of each coordinate.
    participation : ndarray of complex, shape (N, 3)
        What a force at the tool does to each coordinate.
    """

    rate: Complex
    shape: Complex
    participation: Complex

    def matrix(self, frequency: ArrayLike) -> Complex:
        """Return the compliance [m/N], shape (f, 3, 3), at frequencies [Hz] of either sign."""
        gain = 1.0 / (2j * np.pi * np.asarray(frequency, dtype=float)[:, None] - self.rate)
        return np.asarray(np.einsum("im,fm,mj->fij", self.shape, gain, self.participation))


def modes_of(machine: Machine) -> Modes:
    """Return a machine in its modal coordinates; coinciding poles that share one vector are told apart by 1e-9.

    Raises
    ------
    InputError
        When the shapes do not fit, the machine is itself unstable, or its modes cannot be told apart.
    """
    if not hasattr(machine, "state_space"):
        raise InputError(
            f"a {type(machine).__name__} has no state space of its own; give a modal model, or a machine at an "
            "operating point: machine.at(feed, controller)"
        )
    a, b, c = (np.asarray(m, dtype=float) for m in machine.state_space())
    n = a.shape[0]
    if a.shape != (n, n) or b.shape != (n, 3) or c.shape != (3, n):
        raise InputError(
            f"the state space has A {a.shape}, B {b.shape}, C {c.shape}; force and displacement of the tool in x, y "
            "and z are needed: A (N, N), B (N, 3), C (3, N)"
        )
    if not all(np.isfinite(m).all() for m in (a, b, c)):
        raise InputError("the state space of the machine holds values that are not finite; give finite numbers")
    growth = float(np.linalg.eigvals(a).real.max())
    if growth >= 0.0:
        raise InputError(
            f"the machine is not stable without cutting: a pole grows with {growth:.3g} 1/s, so that no depth is "
            "stable. Check damping, gains and delay"
        )
    for nudge in (0.0, 1e-9):
        rate, vectors = np.linalg.eig(a * (1.0 + nudge * np.cos(np.arange(a.size)).reshape(a.shape)))
        inverse = np.linalg.pinv(vectors)
        if np.linalg.norm((vectors * rate) @ inverse - a) <= 1e-6 * np.linalg.norm(a):
            return Modes(rate.astype(complex), (c @ vectors).astype(complex), (inverse @ b).astype(complex))
    raise InputError("poles of the machine coincide so that its modes cannot be told apart; shift one by 0.1 %")
