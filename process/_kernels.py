"""Numba loops of the time simulation. Floats and plain arrays only; labels live in `process.simulate`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

TURN = 2.0 * math.pi

# Helpers are inlined: a call with a tuple of arrays costs more in reference counts than the arithmetic in it.


class Modes(NamedTuple):
    """Linear modes and their exact step for a force that is linear over the step.

    ``s_{k+1} = a s_k + b0 f_k + b1 f_{k+1}`` with s = (position, velocity) and f the modal force.
    Shapes: a (m, 2, 2); b0, b1 (m, 2); shape (m, 3); the rest (m,).
    """

    a: Any
    b0: Any
    b1: Any
    shape: Any
    mass: Any
    omega2: Any
    two_zeta_omega: Any


class Motion(NamedTuple):
    """The spindle and the feed: ``angle0 + rotation t + rate t^2/2``; a feed per time and one per angle."""

    angle0: float
    rotation: float
    rate: float
    start: float
    stop: float
    feed_rate: float
    feed_per_angle: float


class Teeth(NamedTuple):
    """Geometry and material of the cut; lag and offset (teeth,), slice_lag (slices,), cutting and edge (3,)."""

    lag: Any
    offset: Any
    slice_lag: Any
    entry: float
    leave: float
    sin_k: float
    cos_k: float
    edge_length: float
    cutting: Any
    edge: Any


@njit(cache=True, nogil=True, inline="always")
def _modal_force(modes, x, y, z, out):
    for m in range(modes.mass.size):
        out[m] = modes.shape[m, 0] * x + modes.shape[m, 1] * y + modes.shape[m, 2] * z


@njit(cache=True, nogil=True, inline="always")
def _march(modes, state, f_old, f_new, out):
    """Advance every mode by one step; state and out (m, 2)."""
    for m in range(modes.mass.size):
        for i in range(2):
            out[m, i] = (
                modes.a[m, i, 0] * state[m, 0]
                + modes.a[m, i, 1] * state[m, 1]
                + modes.b0[m, i] * f_old[m]
                + modes.b1[m, i] * f_new[m]
            )


@njit(cache=True, nogil=True, inline="always")
def _position(modes, state, out):
    for i in range(3):
        out[i] = 0.0
        for m in range(modes.mass.size):
            out[i] += modes.shape[m, i] * state[m, 0]


@njit(cache=True, nogil=True, inline="always")
def _record(modes, state, f_modal, k, displacement, acceleration):
    """Write position and acceleration of the tool at step k."""
    for i in range(3):
        displacement[i, k] = 0.0
        acceleration[i, k] = 0.0
    for m in range(modes.mass.size):
        a = f_modal[m] / modes.mass[m] - modes.two_zeta_omega[m] * state[m, 1] - modes.omega2[m] * state[m, 0]
        for i in range(3):
            displacement[i, k] += modes.shape[m, i] * state[m, 0]
            acceleration[i, k] += modes.shape[m, i] * a


@njit(cache=True, nogil=True)
def forced_response(modes, force, displacement, acceleration):
    """March linear modes under a given force (3, n), linear between samples; fill the other two (3, n)."""
    count = modes.mass.size
    state, new = np.zeros((count, 2)), np.zeros((count, 2))
    f_old, f_new = np.zeros(count), np.zeros(count)
    for k in range(force.shape[1]):
        _modal_force(modes, force[0, k], force[1, k], force[2, k], f_new)
        if k > 0:
            _march(modes, state, f_old, f_new, new)
            state[:] = new
        f_old[:] = f_new
        _record(modes, state, f_new, k, displacement, acceleration)


@njit(cache=True, nogil=True, inline="always")
def _engaged_share(phi, half_step, entry, leave):
    """Share of the interval phi -+ half_step that lies in the arc: moves entry and exit off the time grid."""
    low = max(phi - half_step, entry)
    high = min(phi + half_step, leave)
    return max(0.0, high - low) / (2.0 * half_step)


@njit(cache=True, nogil=True, inline="always")
def _passing(surfaces, node, tooth, teeth):
    """Buffer of tooth's pass over an absolute node. A single tooth alternates between two, to read its last turn."""
    return (node // surfaces.shape[2] * teeth + tooth) % surfaces.shape[1]


@njit(cache=True, nogil=True, inline="always")
def _reach(teeth, j, phi, advance, r):
    """How far tooth j reaches along the chip normal at angle phi."""
    in_plane = (advance + r[0]) * math.sin(phi) + r[1] * math.cos(phi) + teeth.offset[j]
    return in_plane * teeth.sin_k - r[2] * teeth.cos_k


@njit(cache=True, nogil=True, inline="always")
def _cutting_force(teeth, surfaces, angle, half_step, advance, r, total):
    """Sum the force of all teeth at tool position r; return (engaged steps without contact, largest chip)."""
    lost, largest = 0, 0.0
    count, nodes = teeth.lag.size, surfaces.shape[2]
    spacing = TURN / nodes
    length = teeth.edge_length / teeth.slice_lag.size
    total[:] = 0.0
    for s in range(teeth.slice_lag.size):
        for j in range(teeth.lag.size):
            turn = angle - teeth.lag[j] - teeth.slice_lag[s]
            phi = turn - TURN * math.floor(turn / TURN)
            share = _engaged_share(phi, half_step, teeth.entry, teeth.leave)
            if share == 0.0:
                continue
            place = turn / spacing
            node = math.floor(place)
            weight = place - node
            before = surfaces[s, _passing(surfaces, node, j - 1, count), node % nodes]
            after = surfaces[s, _passing(surfaces, node + 1, j - 1, count), (node + 1) % nodes]
            left = (1.0 - weight) * before + weight * after
            h = _reach(teeth, j, phi, advance, r) - left
            if h <= 0.0:
                lost += 1
                continue
            largest = max(largest, h)
            sin_p, cos_p = math.sin(phi), math.cos(phi)
            ft = share * length * (teeth.cutting[0] * h + teeth.edge[0])
            fr = share * length * (teeth.cutting[1] * h + teeth.edge[1])
            fa = share * length * (teeth.cutting[2] * h + teeth.edge[2])
            total[0] += -cos_p * ft - teeth.sin_k * sin_p * fr - teeth.cos_k * sin_p * fa
            total[1] += sin_p * ft - teeth.sin_k * cos_p * fr - teeth.cos_k * cos_p * fa
            total[2] += teeth.cos_k * fr - teeth.sin_k * fa
    return lost, largest


@njit(cache=True, nogil=True, inline="always")
def _leave_surface(teeth, surfaces, s, j, from_angle, from_reach, to_angle, to_reach):
    """Write every node that tooth j has passed in this step: the farthest that any tooth has reached there."""
    count, nodes = teeth.lag.size, surfaces.shape[2]
    spacing = TURN / nodes
    for node in range(math.floor(from_angle / spacing) + 1, math.floor(to_angle / spacing) + 1):
        left = surfaces[s, _passing(surfaces, node, j - 1, count), node % nodes]
        phi = (node % nodes) * spacing
        if teeth.entry - 2.0 * spacing <= phi <= teeth.leave + 2.0 * spacing:
            weight = (node * spacing - from_angle) / (to_angle - from_angle)
            left = max(left, (1.0 - weight) * from_reach + weight * to_reach)
        surfaces[s, _passing(surfaces, node, j, count), node % nodes] = left


@njit(cache=True, nogil=True, inline="always")
def _pass_over(teeth, surfaces, angle, advance, r, write, old_angle, old_reach):
    """Move all teeth to where they are now; leave the surface behind where they have just cut."""
    for s in range(teeth.slice_lag.size):
        for j in range(teeth.lag.size):
            turn = angle - teeth.lag[j] - teeth.slice_lag[s]
            reach = _reach(teeth, j, turn, advance, r)
            if write:
                _leave_surface(teeth, surfaces, s, j, old_angle[s, j], old_reach[s, j], turn, reach)
            old_angle[s, j], old_reach[s, j] = turn, reach


@njit(cache=True, nogil=True)
def milling(modes, motion, teeth, step, nodes, impulse, force, displacement, acceleration):
    """March linear modes under their own cutting force, with the chip cut from the surface left behind.

    A tooth at angle phi reaches ``n = ((x_f + x) sin phi + y cos phi + rho) sin k - z cos k`` along the chip normal;
    the chip thickness is n less the farthest n that any tooth before has reached at that angle, so a tooth that leaves
    the cut leaves the older surface behind. One surface a tooth is kept on `nodes` angles a turn. The force is linear
    between steps; one prediction and one correction a step. force, displacement, acceleration (3, steps) are filled.
    Returns (engaged tooth steps without contact, largest chip thickness).
    """
    count = modes.mass.size
    state, new = np.zeros((count, 2)), np.zeros((count, 2))
    f_old, f_new = np.zeros(count), np.zeros(count)
    surfaces = np.zeros((teeth.slice_lag.size, max(teeth.lag.size, 2), nodes))
    old_angle = np.zeros((teeth.slice_lag.size, teeth.lag.size))
    old_reach = np.zeros((teeth.slice_lag.size, teeth.lag.size))
    r, total = np.zeros(3), np.zeros(3)
    lost, largest = 0, 0.0
    was_active = False
    entry_time, entry_angle = 0.0, 0.0
    for k in range(force.shape[1]):
        t = k * step
        angle = motion.angle0 + motion.rotation * t + 0.5 * motion.rate * t * t
        half_step = 0.5 * (motion.rotation + motion.rate * t) * step
        active = motion.start <= t < motion.stop
        entering = active and not was_active
        if entering:
            entry_time, entry_angle = t, angle
        advance = motion.feed_rate * (t - entry_time) + motion.feed_per_angle * (angle - entry_angle)
        # Predict the position with the force held; then find the force there.
        if k > 0:
            _march(modes, state, f_old, f_old, new)
        _position(modes, new, r)
        total[:] = 0.0
        if active:
            missed, thickness = _cutting_force(teeth, surfaces, angle, half_step, advance, r, total)
            lost += missed
            largest = max(largest, thickness)
        # Correct the state with that force.
        _modal_force(modes, total[0], total[1], total[2], f_new)
        if k > 0:
            _march(modes, state, f_old, f_new, new)
        state[:] = new
        if entering:
            _modal_force(modes, impulse[0], impulse[1], impulse[2], f_old)
            state[:, 1] += f_old / modes.mass
        f_old[:] = f_new
        _position(modes, state, r)
        _record(modes, state, f_new, k, displacement, acceleration)
        for i in range(3):
            force[i, k] = total[i]
        if active:
            _pass_over(teeth, surfaces, angle, advance, r, was_active, old_angle, old_reach)
        was_active = active
    return lost, largest
