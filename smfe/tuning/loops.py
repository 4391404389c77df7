"""Loops, tool compliance and stability of many sets of gains at once, with exact dead times.

With ``V = Kp (1 + 1/(Ti s)) s e^(-s tau)`` and ``G = V (s + Kv)/s`` for an axis, the other axes closed by their own
candidate servos, and B_a the dynamic stiffness that the slide then shows::

    velocity loop closed    V/(B_a + V)
    position loop closed    (a s + Kv)/s V/(B_a + G)      a: velocity feed-forward
    cut at the force        V/B_a, G/B_a

Right-half-plane poles are counted by the phase of ``s^a det(B + G)``, which tends to ``3 a pi/2`` for a axes when
there are none (`process.drive.delay_equation` does it on a grid of its own; here the plant's grid serves all).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from process.drive.servo import Servo
from process.types import Complex, Real
from smfe.tuning import _loop_kernels as kernels
from smfe.tuning.depths import Oriented, branches
from smfe.tuning.plants import Plant


def gains_of(servos: list[Servo]) -> Real:
    """Return Kp, Ti, Kv of one candidate, shape (a, 3)."""
    return np.array([[v.Kp, v.Ti, v.Kv] for v in servos])


@dataclass(frozen=True)
class Closed:
    """Candidates in the loop.

    Parameters
    ----------
    frequency : ndarray, shape (f,)
        [Hz].
    cut : ndarray of complex, shape (c, f, r, r)
        Compliance of the tool as the cut sees it: its eigenvalues are those of ``A0 Phi`` [1/m].
    velocity, position, ahead : ndarray of complex, shape (c, a, f)
        Closed velocity loop; closed position loop without feed-forward, and what a feed-forward of 1 adds to it [1].
    velocity_open, position_open : ndarray of complex, shape (c, a, f)
        The loops cut at the drive force [1].
    unstable : ndarray of int, shape (c,)
        Poles in the right half plane, of the machine and of its velocity loops.
    """

    frequency: Real
    cut: Complex
    velocity: Complex
    position: Complex
    ahead: Complex
    velocity_open: Complex
    position_open: Complex
    unstable: Real

    @property
    def eigenvalue(self) -> Complex:
        """Branches of ``A0 Phi`` [1/m], shape (c, r, f)."""
        return branches(self.cut)


def close(plant: Plant, oriented: Oriented, gains: Real) -> Closed:
    """Close the loops of a plant.

    Parameters
    ----------
    plant : Plant
        Of a axes.
    oriented : Oriented
        How the cut sees the tool.
    gains : ndarray, shape (c, a, 3)
        Kp [N s/m], Ti [s], Kv [1/s] of c candidates.
    """
    s, axes = plant.laplace, len(plant.axes)
    tool, loops, turned = kernels.close(
        s,
        np.exp(-s[:, None] * plant.delay),
        oriented.both(plant.held),
        oriented.rows(plant.reach),
        oriented.columns(plant.back),
        np.ascontiguousarray(plant.base),
        np.ascontiguousarray(gains, dtype=float),
    )
    # Without a pole to the right the whole turns by 3 pi/2 an axis; a velocity loop alone lacks one integrator.
    target = np.full(1 + axes, 1.5 * axes - 0.5)
    target[0] = 1.5 * axes
    unstable = np.maximum(np.round(target - turned / np.pi), 0.0).sum(axis=1)
    velocity, position, ahead, velocity_open, position_open = loops
    return Closed(
        plant.frequency,
        tool,
        velocity,
        position,
        ahead,
        velocity_open,
        position_open,
        unstable,
    )


def peak_dB(closed: Complex) -> Real:
    """Return the highest amplitude over frequency [dB] of loops, shape (..., f)."""
    return np.asarray(20.0 * np.log10(np.abs(closed).max(axis=-1)))


def margins(frequency: Real, loop: Complex) -> tuple[Real, Real]:
    """Return gain margin [dB] and phase margin [deg] of open loops, shape (..., f); inf where there is none.

    As `process.drive.servo.Margins`: the smallest factor above 1 by which the gain may rise, and the smallest lag that
    may be added where ``|L| = 1``. Linear between the points.
    """
    size = np.abs(loop)
    low, high = loop[..., :-1], loop[..., 1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = low.imag / (low.imag - high.imag)
        real = low.real + share * (high.real - low.real)
        crosses = (low.imag * high.imag < 0.0) & (real < 0.0) & (real > -1.0)
        gain = np.where(crosses, -20.0 * np.log10(np.where(crosses, -real, 1.0)), np.inf).min(axis=-1)
        share = (1.0 - size[..., :-1]) / (size[..., 1:] - size[..., :-1])
        lag = np.degrees(np.angle(low + share * (high - low)) + np.pi) % 360.0
        unity = (size[..., :-1] - 1.0) * (size[..., 1:] - 1.0) < 0.0
        phase = np.where(unity, lag, np.inf).min(axis=-1)
    return np.asarray(gain), np.asarray(phase)


def bandwidth(frequency: Real, closed: Complex) -> Real:
    """Return the lowest frequency [Hz] at which closed loops, shape (..., f), fall below -3 dB, or the last one."""
    size = np.abs(closed) - np.sqrt(0.5)
    falls = (size[..., :-1] >= 0.0) & (size[..., 1:] < 0.0)
    first = falls.argmax(axis=-1)[..., None]
    a, b = (np.take_along_axis(size, first + i, axis=-1)[..., 0] for i in range(2))
    at = first[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        found = frequency[at] + (frequency[at + 1] - frequency[at]) * a / (a - b)
    return np.asarray(np.where(falls.any(axis=-1), found, np.where(size[..., 0] < 0.0, frequency[0], frequency[-1])))


def largest_feed_forward(closed: Closed, limit_dB: float) -> Real:
    """Return the largest feed-forward from 0 to 1 with which the position loops stay within a limit, shape (c, a).

    ``|T + a D|^2 <= 10^(limit/10)`` is a quadratic in a at each frequency; 0 where already T exceeds it.
    """
    most = 10.0 ** (limit_dB / 10.0)
    square, mixed = np.abs(closed.ahead) ** 2, (closed.position * closed.ahead.conj()).real
    rest = np.abs(closed.position) ** 2 - most
    root = (-mixed + np.sqrt(np.maximum(mixed**2 - square * rest, 0.0))) / square
    return np.asarray(np.clip(np.where(rest < 0.0, root, 0.0).min(axis=-1), 0.0, 1.0))
