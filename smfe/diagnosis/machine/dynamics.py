r"""Compliance of a machine whose modes ride on slides: at rest the guideways hold them, in motion the drives do.

What a hammer at rest shows, and what changes in motion. With its slides held a machine has modes p, with one slide set
free it moves as a whole along that axis, by s (fixed-interface modes: Craig and Bampton, AIAA J. 6, 1968). The tool is
at ``x = E s + U^T p``, E the unit vectors of the slides; with ``V_r = u_r/sqrt(k_r)`` the modes have unit stiffness::

    D p - w^2 l^T s = V F                D_r = 1 - (f/f_r)^2 + 2 j zeta_r f/f_r
    B s - w^2 l p = E^T F                B_a = G_a(j w) + H_a(j w) - w^2 m_a

m_a is all that moves with slide a, and ``l_ar = lambda_ar sqrt(m_a)/w_r`` the momentum along a of mode r for a unit of
its velocity. G is the drive, ``Kp (1 + 1/(Ti s)) (s + Kv) exp(-s tau)``, H the guideway: a contact
that sticks at rest, ``k_c (1 + j eta)``, and the slope of its friction in motion (`process.friction.linearised`, with
the same k_c). Then ::

    Phi = V^T D^-1 V + T (B - w^4 l D^-1 l^T)^-1 T^T,    T = E + w^2 V^T D^-1 l^T

A stiff contact leaves the modes of the held slides alone in Phi: that is what is measured at rest, and it says nothing
of m, l and G. A contact of finite stiffness lowers them a little, which is why the modes of a measurement at rest are
no more than where the fit begins. In motion the slides answer, and what the lines from a few hertz on show of them is
``1/B`` (masses and gains in N/m) and, at the modes, l. A mass at the tool and a joint that gives way come on top, as
updates of ranks three and one.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from process.types import Complex, Real
from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.modal_dynamics import Joint, answers, in_mode_space, joints, left_out, stiffness_of


class Slide(NamedTuple):
    """A slide, its drive and its guideway under one condition (SI); alike for values that change nothing."""

    axis: int  # 0, 1, 2 for x, y, z
    mass: float  # all that moves with it
    momentum: tuple[float, ...]  # of each mode, any numbers: `bounded` makes lambda of those of all slides
    drive: tuple[float, float, float, float] | None  # Kp, Ti, Kv, delay; None: no servo
    viscous: float  # slope of the friction besides contact and fall
    contact: float = 0.0  # stiffness k_c of a guideway that sticks here; 0: it does not
    loss: float = 0.0  # loss factor of the contact
    fall: float = 0.0  # slope of the Stribeck curve at the feed, negative where friction falls
    rate: float = 0.0  # with which bristles follow it, k_c v/s(v) [1/s]; 0: at once

    def stiffness(self, w: Real) -> Complex:
        """Return ``B`` [N/m] at angular frequencies."""
        s = 1j * w
        out = s * self.viscous + self.contact * (1.0 + 1j * self.loss) - w**2 * self.mass
        if self.fall:
            out = out + self.fall * (s / (1.0 + s / self.rate) if self.rate else s)
        if self.drive is not None:
            kp, ti, kv, delay = self.drive
            out = out + kp * (1.0 + 1.0 / (ti * s)) * (s + kv) * np.exp(-s * delay)
        return np.asarray(out)


def moving_compliance(machine: Changed, slides: tuple[Slide, ...], frequency: Real, shaken: Shaken) -> Complex:
    """Return the compliance matrix of modes that ride on slides at frequencies [Hz], [m/N], shape (f, 3, 3).

    Raises InputError when a stiffness is negative, or a vibration has no single amplitude.
    """
    own, coupling, shape = in_mode_space(machine, frequency)
    loose = joints(machine)
    reached = np.concatenate([shape, *(j.vector[:, None] for j in loose)], axis=1)  # by the tool and the joints
    r = _receptance(own, coupling, reached, np.array(machine.frequency), slides, frequency)
    if machine.mass:
        r = _loaded(r, machine.mass * (2.0 * np.pi * frequency) ** 2)
    if loose and shaken.method == "hammer":
        return np.asarray(_hit(r, loose, machine, shape, shaken) + left_out(machine, frequency))
    for place, joint in enumerate(loose, 3):
        r = _through(r, place, joint, machine, shape, shaken)
    return np.asarray(r[:, :3, :3] + left_out(machine, frequency))


def bounded(free: Real) -> Real:
    """Return shares of momentum, (slides, modes), that no numbers can make too large: ``(1 + L L^T)^(-1/2) L``.

    Modes carry less mass than what they ride on: ``lambda lambda^T < 1``.
    """
    values, vectors = np.linalg.eigh(np.eye(len(free)) + free @ free.T)
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T @ free)


def unbounded(share: Real) -> Real:
    """Return the numbers that `bounded` makes shares of momentum of."""
    values, vectors = np.linalg.eigh(np.eye(len(share)) - share @ share.T)
    return np.asarray((vectors / np.sqrt(values)) @ vectors.T @ share)


def _receptance(
    own: Complex, coupling: Complex | None, reached: Real, natural: Real, slides: tuple[Slide, ...], frequency: Real
) -> Complex:
    """Compliance between tool x, y, z and places in mode space, reached (M, 3 + n), shape (f, 3 + n, 3 + n)."""
    w = 2.0 * np.pi * frequency
    mass = np.array([s.mass for s in slides])
    share = np.array([s.momentum for s in slides]).reshape(len(slides), natural.size)
    share = bounded(share)
    momentum = share * np.sqrt(mass)[:, None] / (2.0 * np.pi * natural)
    both = answers(own, coupling, np.concatenate([reached, momentum.T], axis=1))
    count = reached.shape[1]
    first, into = both[:, :, :count], both[:, :, count:]
    square = (w**2)[:, None, None]
    table = reached.T @ first
    if not slides:
        return table
    ends = np.zeros((count, len(slides)))
    ends[[s.axis for s in slides], range(len(slides))] = 1.0
    t = ends + square * (reached.T @ into)
    base = -(square**2) * (momentum @ into)
    at = np.arange(len(slides))
    base[:, at, at] += np.stack([s.stiffness(w) for s in slides], axis=1)
    back = ends.T + square * (momentum @ first)  # not its transpose where a rotor couples the modes
    return np.asarray(table + t @ np.linalg.solve(base, back))


def _loaded(r: Complex, force: Real) -> Complex:
    """Compliance with a mass at the tool, whose force is that much times its displacement, (f,)."""
    at_tool = r[:, :3, :3]
    left = np.linalg.solve(np.eye(3) - force[:, None, None] * at_tool, r[:, :3, :])
    return np.asarray(r + r[:, :, :3] @ (force[:, None, None] * left))


def _hit(r: Complex, loose: Sequence[Joint], machine: Changed, shape: Real, shaken: Shaken) -> Complex:
    """Compliance at the tool with joints, each with the stiffness that a hit along each axis makes it, (f, 3, 3).

    ``Phi_e = R_te - R_tj (1 + G_e R_jj)^-1 G_e R_je``, G_e the stiffnesses under a hit along e.
    """
    count, out = len(loose), r[:, :3, :3].copy()
    nothing = np.zeros((1, 1), dtype=complex)
    stiffness = [stiffness_of(joint, machine, shape, shaken, nothing, nothing)[0] for joint in loose]
    for e in range(3):
        g = np.array([k[e] for k in stiffness])[:, None]
        gives_way = np.eye(count) + g * r[:, 3:, 3:]
        out[:, :, e] -= (r[:, :3, 3:] @ np.linalg.solve(gives_way, g * r[:, 3:, e, None]))[:, :, 0]
    return out


def _through(r: Complex, at: int, joint: Joint, machine: Changed, shape: Real, shaken: Shaken) -> Complex:
    """Compliance with a spring in one place that depends on its amplitude under a force at the tool."""
    direct, moved = r[:, at, at][:, None], r[:, at, :]
    stiffness = stiffness_of(joint, machine, shape, shaken, direct, moved[:, :3])
    apart = np.zeros(moved.shape, dtype=complex)
    apart[:, :3] = stiffness * moved[:, :3] / (1.0 + stiffness * direct)
    if moved.shape[1] > 3:  # other joints are asked at the mean stiffness
        mean = stiffness.mean(axis=1, keepdims=True)
        apart[:, 3:] = mean * moved[:, 3:] / (1.0 + mean * direct)
    return np.asarray(r - r[:, :, at][:, :, None] * apart[:, None, :])
