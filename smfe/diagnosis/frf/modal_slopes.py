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
from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.joint_in_hits import TIMED, force_in_hits
from smfe.diagnosis.frf.modal_dynamics import answers, in_a_hit, joints, linear, stiffness_of, timed, untimed, with_mass

Part = tuple[str, int, int]
"""A number that a machine is made of: ``frequency`` r, ``damping`` r, ``direction`` r along an axis, ``spring`` r s,
``gyroscopic`` r s, ``mass``."""

LOOSE = ("slip", "hardening", "iwan")
"""Fields of a machine with its joints that are not linear."""

STEP = 1e-5
"""Step of differences of smooth functions of a few numbers, relative."""


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
    rest, alone = untimed(machine, shaken), linear(machine)
    there = [name for name in LOOSE if getattr(rest, name)]
    out = np.zeros((len(parts), frequency.size, 3, 3), dtype=complex)
    for name in there:
        one = _with(alone, name, getattr(machine, name))
        state = _State.of(one, frequency, springs_of(one, shaken))
        out += state.slopes(parts)
        out += state.through_joint(shaken, parts)
    if len(there) != 1:
        out += (1 - len(there)) * _State.of(alone, frequency, None).slopes(parts)
    for one in timed(machine, shaken):
        out -= _of_timed(one, frequency, shaken, parts)
    return out


def joint_slopes(machine: Changed, frequency: Real, shaken: Shaken, changes: Sequence[JointChange]) -> Complex:
    """Return the changes of the compliance with some joints, shape (changes, f, 3, 3)."""
    alone = linear(machine)
    out = np.zeros((len(changes), frequency.size, 3, 3), dtype=complex)
    for name in LOOSE:
        mine = [n for n, c in enumerate(changes) if c.joint == name]
        if not mine:
            continue
        if name in TIMED and shaken.duration > 0.0:
            for n in mine:
                like = _with(alone, name, getattr(machine, name) or changes[n].above)
                less, more = (
                    _taken(_with(alone, name, x), frequency, shaken, like) if x else 0.0
                    for x in (changes[n].below, changes[n].above)
                )
                out[n] -= (more - less) / changes[n].step
            continue
        one = _with(alone, name, getattr(machine, name))
        state = _State.of(one, frequency, springs_of(one, shaken) if getattr(machine, name) else None)
        found = []
        for n in mine:
            less, more = (springs_of(_with(alone, name, x), shaken) for x in (changes[n].below, changes[n].above))
            found.append((more - less) / changes[n].step)
        out[mine] = state.through_springs(np.array(found))
    return out


def _taken(machine: Changed, frequency: Real, shaken: Shaken, like: Changed) -> Complex:
    """Return what the one joint of a machine takes from its compliance in hits, shape (f, 3, 3)."""
    own, coupling, shape = with_mass(machine, frequency)
    into = answers(own, coupling, joints(machine)[0].vector[:, None])[:, :, 0] @ shape
    return np.asarray(into[:, :, None] * force_in_hits(machine, frequency, shaken, like=like)[:, None, :])


def _of_timed(machine: Changed, frequency: Real, shaken: Shaken, parts: Sequence[Part]) -> Complex:
    """Return the changes with some parts of what the one joint of a machine takes in hits, shape (parts, f, 3, 3).

    With ``z = D^-1 v`` that is ``V_i^T z S_e``; the force S over that of a hit changes by a difference of simulations.
    """
    own, coupling, shape = with_mass(machine, frequency)
    vector = joints(machine)[0].vector[:, None]
    to = (_backwards if machine.gyroscopic else answers)(own, coupling, shape)
    by = answers(own, coupling, vector)[:, :, 0]
    force, into = force_in_hits(machine, frequency, shaken), by @ shape
    natural, length = np.array(machine.frequency), np.sqrt(np.array(machine.stiffness))
    square = ((2.0 * np.pi * frequency) ** 2)[:, None]
    ratio = frequency[:, None] / natural
    by_frequency = (2.0 * ratio**2 - 2j * np.array(machine.damping) * ratio) / natural
    of_tool = np.eye(3) + machine.mass * square[..., None] * np.einsum("fri,rk->fik", to, shape)
    out = np.zeros((len(parts), frequency.size, 3, 3), dtype=complex)
    for one, (what, r, s) in zip(out, parts, strict=True):
        axes: tuple[int, ...] = (0, 1, 2)
        if what == "frequency":
            direct = -by_frequency[:, r, None] * to[:, r] * by[:, r, None]
        elif what == "damping":
            direct = -2j * ratio[:, r, None] * to[:, r] * by[:, r, None]
        elif what == "direction":
            carried = machine.mass * square * into[:, s, None]
            direct, axes = (of_tool[:, :, s] * by[:, r, None] + to[:, r] * carried) / length[r], (s,)
        elif what == "spring":
            direct = -to[:, r] * by[:, s, None] - (to[:, s] * by[:, r, None] if r != s else 0.0)
        elif what == "gyroscopic":
            direct = -1j * frequency[:, None] * (to[:, r] * by[:, s, None] - to[:, s] * by[:, r, None])
        else:
            direct = square * np.einsum("fri,rk,fk->fi", to, shape, into)
        one += direct[:, :, None] * force[:, None, :]
        moved, step = _moved(machine, (what, r, s))
        more = force_in_hits(moved, frequency, shaken, axes, like=machine)
        one[:, :, list(axes)] += into[:, :, None] * ((more - force[:, list(axes)]) / step)[:, None, :]
    return out


def _moved(machine: Changed, part: Part) -> tuple[Changed, float]:
    """Return a machine one of whose parts has been changed a little, and by how much."""
    what, r, s = part
    count = len(machine.frequency)
    if what in ("frequency", "damping"):
        values = list(getattr(machine, what))
        step = STEP * values[r]
        values[r] += step
        return machine._replace(**{what: tuple(values)}), step  # type: ignore[arg-type]
    if what == "direction":
        along = list(machine.direction)
        along[3 * r + s] += STEP
        return machine._replace(direction=tuple(along)), STEP
    if what in ("spring", "gyroscopic"):
        name = "springs" if what == "spring" else what
        matrix = np.array(getattr(machine, name) or np.zeros(count**2)).reshape(count, count)
        step = STEP if what == "spring" else STEP / math.sqrt(machine.frequency[r] * machine.frequency[s])
        matrix[r, s] += step
        if r != s:
            matrix[s, r] += step if what == "spring" else -step
        return machine._replace(**{name: tuple(matrix.ravel().tolist())}), step  # type: ignore[arg-type]
    shape = np.array(machine.direction).reshape(count, 3) / np.sqrt(np.array(machine.stiffness))[:, None]
    w = 2.0 * np.pi * np.array(machine.frequency)
    step = STEP / float(np.max(w**2 * np.sum(shape**2, axis=1)))
    return machine._replace(mass=machine.mass + step), step


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
        own, coupling, shape = with_mass(machine, frequency)
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
