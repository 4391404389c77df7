"""Integrate a machine of modes through a milling pass, step by step; teeth cut what all earlier teeth left.

A tooth writes into a table over its arc how far out it went; the chip of a later tooth is measured against the
outermost of what all teeth wrote last, so that a tooth that leaves the cut is nothing special. Modes are advanced
exactly for a force that is linear between steps. SI, angles from +y towards +x, forces on the tool.
"""

import math

import numpy as np
from numba import njit

BINS = 512
"""Places over the arc at which the surface is remembered."""

MARGIN = 0.06
"""The table goes so far beyond the arc [rad]."""


@njit(cache=True, nogil=True)
def _left(surface, travel, teeth, tooth, angle, local, low):
    """Return height and travel of the lowest-chip candidate of every tooth at `local`, shape (teeth, 2)."""
    out = np.empty((teeth, 2))
    at = local[0]
    b = int(at)
    share = at - b
    for i in range(teeth):
        psi = angle - 2.0 * math.pi * i / teeth - low
        turns = math.floor(psi / (2.0 * math.pi))
        ahead = i != tooth and (psi - 2.0 * math.pi * turns) > local[1]
        slot = int(turns if ahead else turns - 1) % 2
        out[i, 0] = surface[i, slot, b] + share * (surface[i, slot, b + 1] - surface[i, slot, b])
        out[i, 1] = travel[i, slot, b] + share * (travel[i, slot, b + 1] - travel[i, slot, b])
    return out


@njit(cache=True, nogil=True)
def _write(table, old_at, old, at, value):
    """Fill the places between two moments of a tooth."""
    if at <= old_at:
        return
    for b in range(math.ceil(old_at), math.floor(at) + 1):
        table[b] = old + (value - old) * (b - old_at) / (at - old_at)


@njit(cache=True, nogil=True)
def _chip(surface, travel, before, tooth, spindle, here, way, table):
    """Return the chip of one tooth along its ray [m], negative in air, and write what the tooth leaves.

    spindle: angle [rad]; here: height of the edge over a common level; table: where it begins and its places a radian.
    """
    teeth, sk = surface.shape[0], here[2]
    psi = spindle - 2.0 * math.pi * tooth / teeth - table[0]
    turns = math.floor(psi / (2.0 * math.pi))
    inside = psi - 2.0 * math.pi * turns
    at = inside * table[1]
    earlier = _left(surface, travel, teeth, tooth, spindle, (at, inside), table[0])
    chip, height, there = 1e9, here[0], way
    for i in range(teeth):
        h = here[0] - earlier[i, 0] + (way - earlier[i, 1]) * here[1] * sk
        if h < chip:
            chip = h
            if h < 0.0:
                height, there = earlier[i, 0], earlier[i, 1]
    slot = int(turns) % 2
    if before[tooth, 0] >= 0.0 and before[tooth, 3] == turns:
        _write(surface[tooth, slot], before[tooth, 0], before[tooth, 1], at, height)
        _write(travel[tooth, slot], before[tooth, 0], before[tooth, 2], at, there)
    else:
        _write(surface[tooth, slot], -0.5, height, at, height)
        _write(travel[tooth, slot], -0.5, there, at, there)
    before[tooth, 0], before[tooth, 1], before[tooth, 2], before[tooth, 3] = at, height, there, turns
    return chip


@njit(cache=True, nogil=True)
def _cut(surface, way, before, spindle, depth, travel, arc, radii, approach, cutting, edge, tool, force):
    """Add the forces of all teeth that cut [N]."""
    sk, ck = math.sin(approach), math.cos(approach)
    low = arc[0] - MARGIN
    span = arc[1] - arc[0] + 2.0 * MARGIN
    wide = depth / sk
    for j in range(radii.size):
        inside = (spindle - 2.0 * math.pi * j / radii.size - low) % (2.0 * math.pi)
        if inside >= span:
            before[j, 0] = -1.0
            continue
        phi = inside + low
        s, c = math.sin(phi), math.cos(phi)
        out = (tool[0] * s + tool[1] * c + radii[j]) * sk - tool[2] * ck
        chip = _chip(surface, way, before, j, spindle, (out, s, sk), travel, (low, BINS / span))
        if chip > 0.0 and arc[0] <= phi <= arc[1]:
            ft = wide * (cutting[0] * chip + edge[0])
            fr = wide * (cutting[1] * chip + edge[1])
            fa = wide * (cutting[2] * chip + edge[2])
            force[0] += -c * ft - sk * s * fr - ck * s * fa
            force[1] += s * ft - sk * c * fr - ck * c * fa
            force[2] += ck * fr - sk * fa


@njit(cache=True, nogil=True)
def _along(shape, r, vector):
    """Component of a vector along a mode."""
    return shape[r, 0] * vector[0] + shape[r, 1] * vector[1] + shape[r, 2] * vector[2]


@njit(cache=True, nogil=True)
def _advance(q, v, shape, steps, held, tool):
    """Advance the modes under the force as it was; what it changes by is added in `_answer`."""
    tool[:] = 0.0
    for r in range(q.size):
        s, f = steps[r], _along(shape, r, held)
        q[r], v[r] = s[0] * q[r] + s[1] * v[r] + s[4] * f, s[2] * q[r] + s[3] * v[r] + s[5] * f
        for i in range(3):
            tool[i] += shape[r, i] * q[r]


@njit(cache=True, nogil=True)
def _answer(q, v, shape, steps, change, total, acceleration):
    """Correct the modes by the change of the force, and fill the acceleration."""
    acceleration[:] = 0.0
    for r in range(q.size):
        s, df = steps[r], _along(shape, r, change)
        q[r] += s[6] * df
        v[r] += s[7] * df
        a = s[8] * _along(shape, r, total) - s[9] * v[r] - s[10] * q[r]
        for i in range(3):
            acceleration[i] += shape[r, i] * a


@njit(cache=True, nogil=True)
def integrate(angle, depth, travel, arc, radii, approach, cutting, edge, unmeasured, shape, steps, force, motion):
    """Fill force (n, 3) [N] and acceleration (n, 3) [m/s2].

    angle, depth, travel (n,): spindle [rad], depth of cut [m], way of the feed [m]. arc: entry and exit [rad].
    radii (teeth,): run-out [m]. unmeasured (n or 0, 3): force that no dynamometer sees [N]. shape (m, 3): directions.
    steps (blocks, m, 11): the exact step of each mode and what its acceleration is made of, for each of equal parts of
    the record.
    """
    m, teeth, count = shape.shape[0], radii.size, angle.size
    surface, way = np.zeros((teeth, 2, BINS + 2)), np.zeros((teeth, 2, BINS + 2))
    before = np.full((teeth, 4), -1.0)  # place in the table, height, travel, turns
    q, v, held, total, tool = np.zeros(m), np.zeros(m), np.zeros(3), np.zeros(3), np.zeros(3)
    for n in range(count):
        now = steps[min(n * steps.shape[0] // count, steps.shape[0] - 1)]
        _advance(q, v, shape, now, held, tool)
        force[n] = 0.0
        if depth[n] > 0.0:
            _cut(
                surface,
                way,
                before,
                angle[n],
                depth[n],
                travel[n],
                arc,
                radii,
                approach,
                cutting,
                edge,
                tool,
                force[n],
            )
        for i in range(3):
            total[i] = force[n, i] + (unmeasured[n, i] if unmeasured.shape[0] > 0 else 0.0)
        _answer(q, v, shape, now, total - held, total, motion[n])
        held[:] = total
