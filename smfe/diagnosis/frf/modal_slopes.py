r"""How the compliance of a modal machine changes with what it is made of, in closed form.

In the coordinates of `smfe.diagnosis.frf.modal_dynamics` it is ``Phi_e = V^T D_e^-1 V_e`` under a force along e, a
joint that is not linear being a spring in ``D_e``, at the amplitude that a hit along e gives it. With ``x = D_e^-1
V_e`` and ``y_i = D_e^-T V_i`` a change of anything changes

``d Phi_ie = dV_i^T x + y_i^T dV_e - y_i^T dD_e x``,

which is a product for each number of the machine where a difference of predictions costs two solutions. Whatever
changes with a parameter changes those numbers, most of them the same few. Several joints are taken away from the
linear machine one by one (`full_compliance`), so that their changes add up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from process.types import Complex, Real
from smfe.diagnosis.frf.modal_dynamics import Changed, Shaken, answers, in_a_hit, in_mode_space, joints, stiffness_of

Part = tuple[str, int, int]
"""A number that a machine is made of: ``frequency`` r, ``damping`` r, ``direction`` r along an axis, ``spring`` r s,
``gyroscopic`` r s, ``mass``."""

LOOSE = ("slip", "hardening", "iwan")
"""Fields of a machine with its joints that are not linear."""

STEP = 1e-5
"""Half of the step of the differences of a joint's stiffness, relative: a smooth function of a few numbers."""


class JointChange(NamedTuple):
    """A change of a joint: which, what it is below and above (empty: it is not there), and the step between."""

    joint: str
    below: tuple[float, ...]
    above: tuple[float, ...]
    step: float


def part_slopes(machine: Changed, frequency: Real, shaken: Shaken, parts: Sequence[Part]) -> Complex:
    """Return the changes of the compliance with some parts of a machine, shape (parts, f, 3, 3).

    A machine that is not linear has to be hit: then its joints have one amplitude.
    """
    there = [name for name in LOOSE if getattr(machine, name)]
    alone = machine._replace(slip=(), hardening=(), iwan=())
    out = np.zeros((len(parts), frequency.size, 3, 3), dtype=complex)
    for name in there:
        one = _with(alone, name, getattr(machine, name))
        state = _State.of(one, frequency, springs_of(one, shaken))
        out += state.slopes(parts)
        out += state.through_joint(shaken, parts)
    if len(there) != 1:
        out += (1 - len(there)) * _State.of(alone, frequency, None).slopes(parts)
    return out


def joint_slopes(machine: Changed, frequency: Real, shaken: Shaken, changes: Sequence[JointChange]) -> Complex:
    """Return the changes of the compliance with some joints, shape (changes, f, 3, 3)."""
    alone = machine._replace(slip=(), hardening=(), iwan=())
    out = np.zeros((len(changes), frequency.size, 3, 3), dtype=complex)
    for name in LOOSE:
        mine = [n for n, c in enumerate(changes) if c.joint == name]
        if mine:
            one = _with(alone, name, getattr(machine, name))
            state = _State.of(one, frequency, springs_of(one, shaken) if getattr(machine, name) else None)
            found = []
            for n in mine:
                less, more = (springs_of(_with(alone, name, x), shaken) for x in (changes[n].below, changes[n].above))
                found.append((more - less) / changes[n].step)
            out[mine] = state.through_springs(np.array(found))
    return out


def _with(machine: Changed, name: str, joint: tuple[float, ...]) -> Changed:
    return machine._replace(**{name: joint})  # type: ignore[arg-type]


def springs_of(machine: Changed, shaken: Shaken) -> Complex:
    """Return the springs that joints are under a hit along each axis, shape (3, M, M)."""
    count = len(machine.frequency)
    shape = np.array(machine.direction).reshape(count, 3) / np.sqrt(np.array(machine.stiffness))[:, None]
    out, nothing = np.zeros((3, count, count), dtype=complex), np.zeros((1, 1), dtype=complex)
    for joint in joints(machine):
        stiffness = np.broadcast_to(stiffness_of(joint, machine, shape, shaken, nothing, nothing), (1, 3))[0]
        out += stiffness[:, None, None] * np.outer(joint.vector, joint.vector)
    return out


class _State(NamedTuple):
    """A machine under a force along each axis."""

    machine: Changed
    frequency: Real
    shape: Real  # V, (M, 3)
    to: Complex  # y of each response under a force along each axis, (f, M, 3, 3)
    by: Complex  # x under a force along each axis, (f, M, 3)

    @classmethod
    def of(cls, machine: Changed, frequency: Real, springs: Complex | None) -> _State:
        """Return it for a machine with more springs, (3, M, M), or none."""
        own, coupling, shape = in_mode_space(machine, frequency)
        if machine.mass:
            square = (2.0 * np.pi * frequency[:, None, None]) ** 2 * machine.mass * (shape @ shape.T)
            coupling = -square.astype(complex) if coupling is None else coupling - square
        if springs is None:
            by = answers(own, coupling, shape)
            back = by if not machine.gyroscopic else _backwards(own, coupling, shape)
            return cls(machine, frequency, shape, np.repeat(back[..., None], 3, axis=3), by)
        to, by = np.zeros((2, frequency.size, len(shape), 3, 3), dtype=complex)
        for e in range(3):
            whole = springs[e] if coupling is None else coupling + springs[e]
            whole = np.broadcast_to(whole, (frequency.size, *whole.shape[-2:]))
            by[..., e] = answers(own, whole, shape)
            to[..., e] = _backwards(own, whole, shape) if machine.gyroscopic else by[..., e]
        return cls(machine, frequency, shape, to, np.stack([by[:, :, e, e] for e in range(3)], axis=2))

    def slopes(self, parts: Sequence[Part]) -> Complex:
        """Return the changes of the compliance with some parts, all else as it is, shape (parts, f, 3, 3)."""
        machine, f, to, by = self.machine, self.frequency[:, None], self.to, self.by
        w, natural = 2.0 * np.pi * f, np.array(machine.frequency)
        ratio, out = f / natural, np.zeros((len(parts), f.size, 3, 3), dtype=complex)
        by_frequency = (2.0 * ratio**2 - 2j * np.array(machine.damping) * ratio) / natural
        response = np.einsum("frie,rk->fike", to, self.shape)
        force = np.einsum("fre,rk->fke", by, self.shape)
        carried = (w**2 * machine.mass)[:, :, None]
        of_tool, of_force = np.eye(3)[:, :, None] + carried[..., None] * response, np.eye(3) + carried * force
        length = np.sqrt(np.array(machine.stiffness))

        def both(r: int, s: int) -> Complex:
            return np.asarray(to[:, r] * by[:, s, None, :])

        for one, (what, r, s) in zip(out, parts, strict=True):
            if what == "frequency":
                one -= by_frequency[:, r, None, None] * both(r, r)
            elif what == "damping":
                one -= 2j * ratio[:, r, None, None] * both(r, r)
            elif what == "direction":
                one += (of_tool[:, :, s] * by[:, r, None, :] + to[:, r] * of_force[:, s, None, :]) / length[r]
            elif what == "spring":
                one -= both(r, r) if r == s else both(r, s) + both(s, r)
            elif what == "gyroscopic":
                one -= 1j * f[..., None] * (both(r, s) - both(s, r))
            else:
                one += (w**2)[..., None] * np.einsum("fike,fke->fie", response, force)
        return out

    def through_joint(self, shaken: Shaken, parts: Sequence[Part]) -> Complex:
        """Return the changes of the compliance with some parts through the amplitude of its one joint in a hit.

        The square of the amplitude is the sum of ``(level/reference v_r V_re 2 pi f_r)^2`` over the modes.
        """
        machine, (joint,) = self.machine, joints(self.machine)
        each = shaken.level / shaken.reference * joint.vector[:, None] * self.shape
        each = each * (2.0 * np.pi * np.array(machine.frequency))[:, None]
        start = np.sqrt(np.sum(each**2, axis=0))
        less, more = (in_a_hit(joint, start * (1.0 + side * STEP)) for side in (-1.0, 1.0))
        rate = (more - less) / (2.0 * STEP) / np.maximum(start**2, 1e-300)
        changes = np.zeros((len(parts), 3), dtype=complex)
        for change, (what, r, a) in zip(changes, parts, strict=True):
            if what == "frequency":
                change[:] = rate * each[r] ** 2 / machine.frequency[r]
            elif what == "direction":
                by_shape = shaken.level / shaken.reference * joint.vector[r] * 2.0 * np.pi * machine.frequency[r]
                change[a] = rate[a] * each[r, a] * by_shape / math.sqrt(machine.stiffness[r])
        through = (
            np.einsum("frie,r->fie", self.to, joint.vector) * np.einsum("fre,r->fe", self.by, joint.vector)[:, None]
        )
        return np.asarray(-changes[:, None, None, :] * through)

    def through_springs(self, springs: Complex) -> Complex:
        """Return the changes of the compliance with springs that differ between the forces, (p, 3, M, M)."""
        moved = np.einsum("pers,fse->pfre", springs, self.by, optimize=True)
        return np.asarray(-np.einsum("frie,pfre->pfie", self.to, moved, optimize=True))


def _backwards(own: Complex, coupling: Complex | None, force: Real) -> Complex:
    """Return ``D^-T`` times forces on the modes (M, c), shape (f, M, c)."""
    return answers(own, None if coupling is None else coupling.transpose(0, 2, 1), force)
