"""Numba loops of the time simulation. Floats and plain arrays only; labels live in `process.simulate`."""

# Kernels take many scalars by design: numba knows no labelled arrays.
# ruff: noqa: PLR0913

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def forced_response(a, b0, b1, shape, mass, omega2, two_zeta_omega, force, displacement, acceleration):
    """March linear modes under a given force that is linear between samples (exact for such a force).

    ``s_{k+1} = a s_k + b0 f_k + b1 f_{k+1}`` per mode, s = (position, velocity), f the modal force.
    Shapes: a (m, 2, 2); b0, b1 (m, 2); shape (m, 3); force, displacement, acceleration (3, n).
    """
    modes = shape.shape[0]
    n = force.shape[1]
    q = np.zeros(modes)
    v = np.zeros(modes)
    f_old = np.zeros(modes)
    for k in range(n):
        for i in range(3):
            displacement[i, k] = 0.0
            acceleration[i, k] = 0.0
        for m in range(modes):
            f = shape[m, 0] * force[0, k] + shape[m, 1] * force[1, k] + shape[m, 2] * force[2, k]
            if k > 0:
                q_new = a[m, 0, 0] * q[m] + a[m, 0, 1] * v[m] + b0[m, 0] * f_old[m] + b1[m, 0] * f
                v[m] = a[m, 1, 0] * q[m] + a[m, 1, 1] * v[m] + b0[m, 1] * f_old[m] + b1[m, 1] * f
                q[m] = q_new
            f_old[m] = f
            modal = f / mass[m] - two_zeta_omega[m] * v[m] - omega2[m] * q[m]
            for i in range(3):
                displacement[i, k] += shape[m, i] * q[m]
                acceleration[i, k] += shape[m, i] * modal


@njit(cache=True, nogil=True)
def _engaged_share(phi, half_step, entry, leave):
    """Share of the interval phi -+ half_step that lies in the arc: moves entry and exit off the time grid."""
    low = max(phi - half_step, entry)
    high = min(phi + half_step, leave)
    return max(0.0, high - low) / (2.0 * half_step)


@njit(cache=True, nogil=True)
def _surface(surfaces, slice_, node, tooth, teeth, nodes, buffers):
    """Normal position of the surface that the tooth before left at an absolute node."""
    before = (node // nodes) * teeth + tooth - 1
    return surfaces[slice_, before % buffers, node % nodes]


@njit(cache=True, nogil=True)
def milling(
    a,
    b0,
    b1,
    shape,
    mass,
    omega2,
    two_zeta_omega,
    step,
    steps,
    angle0,
    rotation,
    rotation_rate,
    start,
    stop,
    feed_rate,
    feed_per_angle,
    lag,
    offset,
    slice_lag,
    nodes,
    entry,
    leave,
    sin_k,
    cos_k,
    edge_length,
    cutting,
    edge,
    impulse,
    force,
    displacement,
    acceleration,
    thickness,
):
    """March linear modes under their own cutting force, with the chip cut from the surface left behind.

    A tooth at angle phi reaches ``n = (x_f + x + rho/s) s sin k ...`` along the chip normal, i.e.
    ``n = ((x_f + x) sin phi + y cos phi + rho) sin k - z cos k``; the chip thickness is n less the farthest n that
    any tooth before has reached at that angle (`surfaces`), so a tooth that leaves the cut leaves the older surface
    behind. One surface a tooth is kept on `nodes` angles a turn. Force linear between steps; one prediction and one
    correction a step. Returns the number of tooth-steps in which an engaged tooth was out of contact.
    """
    modes = shape.shape[0]
    teeth = lag.size
    slices = slice_lag.size
    buffers = max(teeth, 2)
    spacing = 2.0 * math.pi / nodes
    surfaces = np.zeros((slices, buffers, nodes))
    q = np.zeros(modes)
    v = np.zeros(modes)
    f_old = np.zeros(modes)
    f_now = np.zeros(modes)
    q_new = np.zeros(modes)
    old_angle = np.zeros((slices, teeth))
    old_reach = np.zeros((slices, teeth))
    r = np.zeros(3)
    total = np.zeros(3)
    lost = 0
    was_active = False
    feed_time = 0.0
    feed_angle = 0.0
    per_slice = edge_length / slices

    for k in range(steps):
        t = k * step
        angle = angle0 + rotation * t + 0.5 * rotation_rate * t * t
        half_step = max(0.5 * (rotation + rotation_rate * t) * step, 1e-12)
        active = start <= t < stop
        # Predict the position with the force held, then find the force there.
        for i in range(3):
            r[i] = 0.0
            total[i] = 0.0
        for m in range(modes):
            if k > 0:
                q_new[m] = a[m, 0, 0] * q[m] + a[m, 0, 1] * v[m] + (b0[m, 0] + b1[m, 0]) * f_old[m]
            for i in range(3):
                r[i] += shape[m, i] * q_new[m]
        if active and not was_active:
            feed_time = t
            feed_angle = angle
        advance = feed_rate * (t - feed_time) + feed_per_angle * (angle - feed_angle)
        largest = 0.0
        if active:
            for s in range(slices):
                for j in range(teeth):
                    turn = angle - lag[j] - slice_lag[s]
                    phi = turn - 2.0 * math.pi * math.floor(turn / (2.0 * math.pi))
                    share = _engaged_share(phi, half_step, entry, leave)
                    if share == 0.0:
                        continue
                    sin_p = math.sin(phi)
                    cos_p = math.cos(phi)
                    reach = ((advance + r[0]) * sin_p + r[1] * cos_p + offset[j]) * sin_k - r[2] * cos_k
                    place = turn / spacing
                    node = int(math.floor(place))
                    weight = place - node
                    left = (1.0 - weight) * _surface(surfaces, s, node, j, teeth, nodes, buffers)
                    left += weight * _surface(surfaces, s, node + 1, j, teeth, nodes, buffers)
                    h = reach - left
                    if h <= 0.0:
                        lost += 1
                        continue
                    largest = max(largest, h)
                    ft = share * per_slice * (cutting[0] * h + edge[0])
                    fr = share * per_slice * (cutting[1] * h + edge[1])
                    fa = share * per_slice * (cutting[2] * h + edge[2])
                    total[0] += -cos_p * ft - sin_k * sin_p * fr - cos_k * sin_p * fa
                    total[1] += sin_p * ft - sin_k * cos_p * fr - cos_k * cos_p * fa
                    total[2] += cos_k * fr - sin_k * fa
        # Correct the state with that force.
        for i in range(3):
            r[i] = 0.0
            force[i, k] = total[i]
            acceleration[i, k] = 0.0
        for m in range(modes):
            f_now[m] = shape[m, 0] * total[0] + shape[m, 1] * total[1] + shape[m, 2] * total[2]
            if k > 0:
                q_new[m] = a[m, 0, 0] * q[m] + a[m, 0, 1] * v[m] + b0[m, 0] * f_old[m] + b1[m, 0] * f_now[m]
                v[m] = a[m, 1, 0] * q[m] + a[m, 1, 1] * v[m] + b0[m, 1] * f_old[m] + b1[m, 1] * f_now[m]
            if active and not was_active:
                v[m] += (shape[m, 0] * impulse[0] + shape[m, 1] * impulse[1] + shape[m, 2] * impulse[2]) / mass[m]
            q[m] = q_new[m]
            f_old[m] = f_now[m]
            modal = f_now[m] / mass[m] - two_zeta_omega[m] * v[m] - omega2[m] * q[m]
            for i in range(3):
                r[i] += shape[m, i] * q[m]
                acceleration[i, k] += shape[m, i] * modal
        for i in range(3):
            displacement[i, k] = r[i]
        thickness[k] = largest
        # Leave the surface behind: every node that a tooth has just passed.
        if active:
            for s in range(slices):
                for j in range(teeth):
                    turn = angle - lag[j] - slice_lag[s]
                    sin_p = math.sin(turn)
                    cos_p = math.cos(turn)
                    reach = ((advance + r[0]) * sin_p + r[1] * cos_p + offset[j]) * sin_k - r[2] * cos_k
                    if was_active:
                        first = int(math.floor(old_angle[s, j] / spacing)) + 1
                        last = int(math.floor(turn / spacing))
                        for node in range(first, last + 1):
                            weight = (node * spacing - old_angle[s, j]) / (turn - old_angle[s, j])
                            at_node = (1.0 - weight) * old_reach[s, j] + weight * reach
                            own = (node // nodes) * teeth + j
                            left = _surface(surfaces, s, node, j, teeth, nodes, buffers)
                            phi = (node % nodes) * spacing
                            inside = entry - 2.0 * spacing <= phi <= leave + 2.0 * spacing
                            surfaces[s, own % buffers, node % nodes] = max(left, at_node) if inside else left
                    old_angle[s, j] = turn
                    old_reach[s, j] = reach
        was_active = active
    return lost
