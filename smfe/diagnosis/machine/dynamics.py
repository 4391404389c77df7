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
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from process.types import Complex, Real
from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.joint_in_hits import TIMED, Stepped, force_in_hits, grid_of, springs_and_losses
from smfe.diagnosis.frf.modal_dynamics import (
    Joint,
    answers,
    in_mode_space,
    joints,
    left_out,
    linear,
    stiffness_of,
    timed,
    untimed,
)

LEAST_DELAY = 1e-6
"""Dead time below which there is none to a hit [s]."""

LOST_AT = 60.0
"""Frequency at which a contact loses in time what its loss factor says [Hz]: of the first modes of machines."""


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


def moving_compliance(
    machine: Changed, slides: tuple[Slide, ...], frequency: Real, shaken: Shaken, like: Changed | None = None
) -> Complex:
    """Return the compliance matrix of modes that ride on slides at frequencies [Hz], [m/N], shape (f, 3, 3).

    A joint whose force after a hit is simulated in time is, on a grid of time for a machine `like` this one.

    Raises InputError when a stiffness is negative, or a vibration has no single amplitude.
    """
    in_time, at_once = timed(machine, shaken), joints(untimed(machine, shaken))
    vectors = [j.vector[:, None] for j in (*at_once, *(joints(one)[0] for one in in_time))]
    r = _reached(machine, slides, frequency, vectors)
    count, shape = 3 + len(at_once), in_mode_space(machine, frequency[:1])[2]
    out = r[:, :count, :count]
    if at_once and shaken.method == "hammer":
        out = _hit(out, at_once, machine, shape, shaken)
    else:
        for place, joint in enumerate(at_once, 3):
            out = _through(out, place, joint, machine, shape, shaken)
    out = out[:, :3, :3] + left_out(machine, frequency)
    for place, one in enumerate(in_time, count):
        force = force_in_time(one, slides, frequency, shaken, like)
        out = out - r[:, :3, place, None] * force[:, None, :]
    return np.asarray(out)


class Pulled(NamedTuple):
    """A machine with one joint that is simulated in time."""

    machine: Changed
    vector: Real  # of its displacement, (M,)
    reached: Complex  # motion of the tool over its force, (f, 3)
    force: Complex  # what it adds to its linear force over that of a hit along each axis, (f, 3)

    def follows(self) -> Complex:
        """Return how its force changes with its displacement, all amplitudes as they are, (f, 3).

        As that of a spring line by line, ``g/(1 + g r_jj)``, of a machine without rotors, where it moves under a force
        at the tool as the tool does under its own. No more than twice what most lines have: where it is hardly moved
        its force is that of other frequencies.
        """
        ratio = self.force / np.where(self.reached == 0.0, 1.0, self.reached)
        size = np.abs(ratio)
        most = 2.0 * np.quantile(size, 0.9, axis=0)
        return np.asarray(ratio * np.minimum(1.0, most / np.maximum(size, 1e-300)))


def pulled_by_joints(machine: Changed, slides: tuple[Slide, ...], frequency: Real, shaken: Shaken) -> list[Pulled]:
    """Return the joints of a machine that are simulated in time, as they pull at it after a hit."""
    found = timed(machine, shaken)
    if not found:
        return []
    vectors = [joints(one)[0].vector for one in found]
    r = _reached(machine, slides, frequency, [v[:, None] for v in vectors])
    each = zip(found, vectors, strict=True)
    return [
        Pulled(one, v, r[:, :3, place], force_in_time(one, slides, frequency, shaken))
        for place, (one, v) in enumerate(each, 3)
    ]


def force_in_time(
    one: Changed,
    slides: tuple[Slide, ...],
    frequency: Real,
    shaken: Shaken,
    like: Changed | None = None,
    axes: tuple[int, ...] = (0, 1, 2),
) -> Complex:
    """Return what the one joint of a machine adds to its linear force over that of a hit along some axes, (f, axes)."""
    alone, name = linear(one), next(n for n in TIMED if getattr(one, n))
    alike = one if like is None or not getattr(like, name) else linear(like)._replace(**{name: getattr(like, name)})
    stepped = riding(alone._replace(mode=(), residual=()), slides, grid_of(alike, shaken.duration))
    return force_in_hits(one, frequency, shaken, axes, stepped=stepped)


@lru_cache(maxsize=64)
def riding(machine: Changed, slides: tuple[Slide, ...], grid: tuple[float, int]) -> Stepped:
    """Return a machine without joints whose modes ride on slides, from step to step of a grid of time.

    In time a contact's loss is viscous, that of its loss factor at `LOST_AT`, and a dead time an all-pass of second
    order (Pade), whose phase ``w tau`` is ``(w tau)^5/720`` off: 1 degree at 1.7 radian.
    """
    count, a = len(machine.frequency), len(slides)
    n = count + a
    natural = np.array(machine.frequency)
    v = np.array(machine.direction).reshape(count, 3) / np.sqrt(np.array(machine.stiffness))[:, None]
    ends = np.zeros((a, 3))
    ends[range(a), [s.axis for s in slides]] = 1.0
    tool = np.concatenate([v, ends])
    stiffness, damping, mass = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    stiffness[:count, :count], damping[:count, :count] = springs_and_losses(machine)
    mass[:count, :count] = np.diag(1.0 / (2.0 * np.pi * natural) ** 2)
    mass[count:, :count] = momentum_of(machine.frequency, slides)
    mass[:count, count:] = mass[count:, :count].T
    further: list[tuple[dict[int, float], int, float]] = []  # rate by all states, slide, force on it

    def add(rate: dict[int, float], at: int, force: float) -> int:
        """Add a state; return its number."""
        further.append((rate, at, force))
        return 2 * n + len(further) - 1

    for at, s in enumerate(slides, count):
        mass[at, at] = s.mass
        damping[at, at] += s.viscous + (0.0 if s.rate else s.fall)
        stiffness[at, at] += s.contact
        damping[at, at] += s.loss * s.contact / (2.0 * np.pi * LOST_AT)
        if s.fall and s.rate:  # bristles that follow the slide: fall rate (s - b), b' = rate (s - b)
            stiffness[at, at] += s.fall * s.rate
            own = 2 * n + len(further)
            add({at: s.rate, own: -s.rate}, at, s.fall * s.rate)
        if s.drive is not None:
            kp, ti, kv, delay = s.drive
            stiffness[at, at] += kp * (kv + 1.0 / ti)
            damping[at, at] += kp
            wound = add({at: kp * kv / ti}, at, -1.0)
            if delay > LEAST_DELAY:  # what is asked for less 12 x/(x^2 + 6 x + 12) of it, x the delay times s
                first, then, by = wound + 1, wound + 2, 12.0 / delay**2
                add({then: 1.0}, at, 0.0)
                asked = {at: by * kp * (kv + 1.0 / ti), n + at: by * kp, wound: by}
                add({**asked, first: -by, then: -6.0 / delay}, at, delay)
    mass += machine.mass * (tool @ tool.T)
    inverse, size = np.linalg.inv(mass), 2 * n + len(further)
    rate, force = np.zeros((size, size)), np.zeros((size, count + 3))
    rate[:n, n : 2 * n] = np.eye(n)
    rate[n : 2 * n, :n], rate[n : 2 * n, n : 2 * n] = -inverse @ stiffness, -inverse @ damping
    for own, (rates, at, pull) in enumerate(further, 2 * n):
        rate[own, list(rates)] = list(rates.values())
        rate[n : 2 * n, own] = inverse[:, at] * pull
    force[n : 2 * n] = inverse @ np.concatenate([np.eye(n)[:, :count], tool], axis=1)
    return Stepped.of_states(rate, force, count, grid)


def momentum_of(natural: tuple[float, ...], slides: Sequence[Slide]) -> Real:
    """Return the momentum of modes of these frequencies [Hz] along the slides, l, (a, M)."""
    share = bounded(np.array([s.momentum for s in slides]).reshape(len(slides), len(natural)))
    mass = np.array([s.mass for s in slides])
    return np.asarray(share * np.sqrt(mass)[:, None] / (2.0 * np.pi * np.array(natural)))


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


def _reached(machine: Changed, slides: tuple[Slide, ...], frequency: Real, vectors: Sequence[Real]) -> Complex:
    """Compliance between tool x, y, z and places in mode space without joints, (f, 3 + n, 3 + n)."""
    own, coupling, shape = in_mode_space(machine, frequency)
    reached = np.concatenate([shape, *vectors], axis=1)
    r = _receptance(own, coupling, reached, machine.frequency, slides, frequency)
    return _loaded(r, machine.mass * (2.0 * np.pi * frequency) ** 2) if machine.mass else r


def _receptance(
    own: Complex,
    coupling: Complex | None,
    reached: Real,
    natural: tuple[float, ...],
    slides: tuple[Slide, ...],
    frequency: Real,
) -> Complex:
    """Compliance between tool x, y, z and places in mode space, reached (M, 3 + n), shape (f, 3 + n, 3 + n)."""
    w, momentum = 2.0 * np.pi * frequency, momentum_of(natural, slides)
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
