"""Numba helpers of the cut for kernels that integrate the motion of a tool: spindle, teeth, and the surface they leave.

Every edge element (a tooth, or one slice of a helical tooth) keeps the surface that it leaves behind on a ring of
nodes, fixed angles of the tool's turn. A kernel calls, once a step::

    angle, rotation = turn(motion, t)
    pose = make_pose(teeth, angle, rotation, advance, x, y, z)            where the tool is predicted to be
    fx, fy, fz, lost, largest = cutting_force(teeth, surfaces, pose, step, vx, vy, vz)
    after = moved(pose, x, y, z)                                          once that force has corrected the position
    pass_over(teeth, surfaces, before, after)                             from the last final pose to this one

All are inlined: they are compiled as part of the kernel that calls them. Compile that kernel with ``_nrt=False`` and
allocate its arrays outside: counting references to the arrays in the tuples would take most of the time.
"""

import math
from typing import Any, NamedTuple

from numba import njit


class Motion(NamedTuple):
    """The spindle and the feed, SI; `process.simulation.milling.Spindle` states the law, feed_per_angle is in m/rad."""

    angle0: float
    rotation: float
    acceleration: float
    variation: float
    variation_omega: float
    feed_rate: float
    feed_per_angle: float


class Teeth(NamedTuple):
    """The edge elements in the order (slice, tooth) and their material; angles in nodes, `scale` of them a radian.

    lag, sin_lag, cos_lag: how far each runs behind tooth 0 (the last two of the angle). offset: run-out along the chip
    normal [m]. before: the element whose surface each one cuts, `back` nodes back on its ring (a turn for one tooth,
    which must not read what it has just written). sin_node, cos_node: of every node's angle. spacing: a node [rad].
    entry, leave: arc; low, high: where the surface is kept. chip [N/m] and edge [N]: force over chip thickness and
    force of one element, (tangential, normal in the plane, along the tool). damping [N/m] times v_n/rotation [m] is the
    radial force [N] of one element against v_n, `friction` times it the tangential one (`process.cut.force`).
    """

    lag: Any
    sin_lag: Any
    cos_lag: Any
    offset: Any
    before: Any
    sin_node: Any
    cos_node: Any
    back: int
    nodes: int
    scale: float
    spacing: float
    entry: float
    leave: float
    low: float
    high: float
    sin_k: float
    cos_k: float
    chip: Any
    edge: Any
    damping: float
    friction: float


class Pose(NamedTuple):
    """Angle of tooth 0 [rad] with its sine and cosine, rotation [rad/s], feed covered and tool position [m]."""

    angle: float
    sin: float
    cos: float
    rotation: float
    advance: float
    x: float
    y: float
    z: float


@njit(cache=True, nogil=True, inline="always")
def turn(motion, t):
    """Return angle [rad] and rotation [rad/s] of the spindle at time t [s]."""
    angle = motion.angle0 + motion.rotation * t + 0.5 * motion.acceleration * t * t
    rotation = motion.rotation + motion.acceleration * t
    if motion.variation != 0.0:
        swing = motion.variation * motion.rotation
        angle += swing / motion.variation_omega * (1.0 - math.cos(motion.variation_omega * t))
        rotation += swing * math.sin(motion.variation_omega * t)
    return angle, rotation


@njit(cache=True, nogil=True, inline="always")
def make_pose(teeth, angle, rotation, advance, x, y, z):
    """Return the pose of a tool at an angle [rad], rotation [rad/s], feed covered and position [m].

    Sine and cosine from those of the node before, and series for the rest, which is below 0.1 rad: exact to rounding,
    and three times faster than the library.
    """
    place = angle * teeth.scale
    floor = math.floor(place)
    node = floor & (teeth.nodes - 1)
    d = (place - floor) * teeth.spacing
    dd = d * d
    sine = d * (
        1.0 - dd * (1.0 / 6.0) * (1.0 - dd * (1.0 / 20.0) * (1.0 - dd * (1.0 / 42.0) * (1.0 - dd * (1.0 / 72.0))))
    )
    verse = (
        0.5
        * dd
        * (1.0 - dd * (1.0 / 12.0) * (1.0 - dd * (1.0 / 30.0) * (1.0 - dd * (1.0 / 56.0) * (1.0 - dd * (1.0 / 90.0)))))
    )
    s, c = teeth.sin_node[node], teeth.cos_node[node]
    return Pose(angle, s - s * verse + c * sine, c - c * verse - s * sine, rotation, advance, x, y, z)


@njit(cache=True, nogil=True, inline="always")
def moved(pose, x, y, z):
    """Return the same pose at another position [m]."""
    return Pose(pose.angle, pose.sin, pose.cos, pose.rotation, pose.advance, x, y, z)


@njit(cache=True, nogil=True, inline="always")
def _wrap(teeth, node):
    """Angle of a node within a turn, in nodes; from a quarter turn before phi = 0, so that entry at 0 is inside."""
    quarter = teeth.nodes >> 2
    return ((node + quarter) & (teeth.nodes - 1)) - quarter


@njit(cache=True, nogil=True, inline="always")
def _reach(teeth, e, pose):
    """How far [m] element e reaches along the chip normal, ``((x_f + x) s + y c) sin k - z cos k + rho sin k``."""
    s = pose.sin * teeth.cos_lag[e] - pose.cos * teeth.sin_lag[e]
    c = pose.cos * teeth.cos_lag[e] + pose.sin * teeth.sin_lag[e]
    return ((pose.advance + pose.x) * s + pose.y * c) * teeth.sin_k - pose.z * teeth.cos_k + teeth.offset[e]


@njit(cache=True, nogil=True, inline="always")
def cutting_force(teeth, surfaces, pose, step, vx, vy, vz):
    """Return (F_x, F_y, F_z, engaged elements without contact, largest chip): the force [N] of all teeth on the tool.

    An element counts with the share of this step, half before and half after, that it spends in the arc: entry and
    exit come off the time grid. The chip is what it reaches beyond the surface that earlier teeth have left. v [m/s] is
    the velocity of the tool's vibration, for process damping.
    """
    fx, fy, fz, lost, largest = 0.0, 0.0, 0.0, 0, 0.0
    half = 0.5 * step * pose.rotation * teeth.scale
    ring = surfaces.shape[1] - 1
    for e in range(teeth.lag.size):
        place = pose.angle * teeth.scale - teeth.lag[e]
        node = math.floor(place)
        weight = place - node
        phi = _wrap(teeth, node) + weight
        inside = min(phi + half, teeth.leave) - max(phi - half, teeth.entry)
        if inside <= 0.0:
            continue
        first = surfaces[teeth.before[e], (node - teeth.back) & ring]
        second = surfaces[teeth.before[e], (node + 1 - teeth.back) & ring]
        h = _reach(teeth, e, pose) - (first + weight * (second - first))
        if h <= 0.0:
            lost += 1
            continue
        largest = max(largest, h)
        share = inside / (2.0 * half)
        s = pose.sin * teeth.cos_lag[e] - pose.cos * teeth.sin_lag[e]
        c = pose.cos * teeth.cos_lag[e] + pose.sin * teeth.sin_lag[e]
        ft = teeth.chip[0] * h + teeth.edge[0]
        fn = teeth.chip[1] * h + teeth.edge[1]
        fa = teeth.chip[2] * h + teeth.edge[2]
        if teeth.damping != 0.0:
            into = (vx * s + vy * c) * teeth.sin_k - vz * teeth.cos_k
            fr = teeth.damping / pose.rotation * into
            ft += teeth.friction * fr
            fn += teeth.sin_k * fr
            fa += teeth.cos_k * fr
        ft, fn, fa = share * ft, share * fn, share * fa
        fz += fa
        fx -= c * ft + s * fn
        fy += s * ft - c * fn
    return fx, fy, fz, lost, largest


@njit(cache=True, nogil=True, inline="always")
def pass_over(teeth, surfaces, before, after):
    """Move all teeth from one pose to the next: at each node passed stays the farthest that any tooth has reached."""
    ring = surfaces.shape[1] - 1
    for e in range(teeth.lag.size):
        start = before.angle * teeth.scale - teeth.lag[e]
        first = math.floor(start) + 1
        last = math.floor(after.angle * teeth.scale - teeth.lag[e])
        phi = _wrap(teeth, last)
        if last < first or phi < teeth.low or phi - (last - first) > teeth.high:
            continue
        reach = _reach(teeth, e, before)
        slope = (_reach(teeth, e, after) - reach) / ((after.angle - before.angle) * teeth.scale)
        for node in range(first, last + 1):
            if teeth.low <= phi - (last - node) <= teeth.high:
                left = surfaces[teeth.before[e], (node - teeth.back) & ring]
                surfaces[e, node & ring] = max(left, reach + slope * (node - start))
