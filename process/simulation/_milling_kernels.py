"""Numba loops of the time simulation. Floats and plain arrays only; labels live in `process.simulation.milling`.

Compiled at the first call and cached, for the tuples `Modes`, `Motion` and `Teeth` of float64 arrays and scalars:
`forced_response` in 0.5 s of CPU, `milling` in 2 s.
"""

from typing import Any, NamedTuple

from numba import njit

from process.cut._kernels import cutting_force, make_pose, moved, pass_over, turn


class Modes(NamedTuple):
    """Linear modes and their exact step for a force that is linear over the step.

    With s = (position, velocity) and f the modal force, ``s_{k+1} = p + d (f_{k+1} - f_k)`` and ``p = a s_k + b f_k``,
    the prediction with the force held. So ``p_{k+1} = a p_k + b f_k + e (f_{k+1} - f_k)`` with ``e = a d + b``: most of
    the next prediction can be computed before the force is known.
    step (m, 10): a by rows, b, d, e. shape (m, 3). law (m, 3): 1/mass, 2 zeta omega, omega^2.
    """

    step: Any
    shape: Any
    law: Any


@njit(cache=True, nogil=True, inline="always")
def _advance(modes, state, fx, fy, fz):
    """Correct the predicted state (m, 3: position, velocity, old force) for a force now, and predict the next.

    Return position and acceleration of the tool now, and its predicted position after the next step.
    """
    x, y, z, ax, ay, az, px, py, pz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for m in range(state.shape[0]):
        p, w, old = state[m, 0], state[m, 1], state[m, 2]
        held_p = modes.step[m, 0] * p + modes.step[m, 1] * w + modes.step[m, 4] * old
        held_w = modes.step[m, 2] * p + modes.step[m, 3] * w + modes.step[m, 5] * old
        sx, sy, sz = modes.shape[m, 0], modes.shape[m, 1], modes.shape[m, 2]
        f = sx * fx + sy * fy + sz * fz
        rise = f - old
        q = p + modes.step[m, 6] * rise
        v = w + modes.step[m, 7] * rise
        a = modes.law[m, 0] * f - modes.law[m, 1] * v - modes.law[m, 2] * q
        next_p = held_p + modes.step[m, 8] * rise
        state[m, 0], state[m, 1], state[m, 2] = next_p, held_w + modes.step[m, 9] * rise, f
        x, y, z = x + sx * q, y + sy * q, z + sz * q
        ax, ay, az = ax + sx * a, ay + sy * a, az + sz * a
        px, py, pz = px + sx * next_p, py + sy * next_p, pz + sz * next_p
    return x, y, z, ax, ay, az, px, py, pz


@njit(cache=True, nogil=True, inline="always")
def _at_tool(modes, state, column):
    """Return the predicted position (column 0) or velocity (column 1) of the tool."""
    x, y, z = 0.0, 0.0, 0.0
    for m in range(state.shape[0]):
        x += modes.shape[m, 0] * state[m, column]
        y += modes.shape[m, 1] * state[m, column]
        z += modes.shape[m, 2] * state[m, column]
    return x, y, z


@njit(cache=True, nogil=True, inline="always")
def _add_impulse(modes, state, impulse):
    """Add to the prediction the velocity that an impulse (3,) gives every mode now."""
    for m in range(state.shape[0]):
        modal = modes.shape[m, 0] * impulse[0] + modes.shape[m, 1] * impulse[1] + modes.shape[m, 2] * impulse[2]
        state[m, 0] += modes.step[m, 1] * modes.law[m, 0] * modal
        state[m, 1] += modes.step[m, 3] * modes.law[m, 0] * modal


@njit(cache=True, nogil=True, _nrt=False)
def forced_response(modes, state, force, displacement, acceleration):
    """Integrate linear modes under a given force (3, n), linear between samples; fill the other two (3, n).

    state (m, 3): position, velocity and force of each mode at the first sample.
    """
    for k in range(force.shape[1]):
        x, y, z, ax, ay, az, _, _, _ = _advance(modes, state, force[0, k], force[1, k], force[2, k])
        displacement[0, k], displacement[1, k], displacement[2, k] = x, y, z
        acceleration[0, k], acceleration[1, k], acceleration[2, k] = ax, ay, az


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"}, _nrt=False)
def milling(modes, state, motion, teeth, surfaces, step, start, stop, impulse, force, displacement, acceleration):
    """Integrate linear modes under their own cutting force, with the chip cut from the surface left behind.

    state (m, 3) is zero: at rest before the first sample. The tool is in the work while start <= t < stop; the impulse
    [N s] acts at entry. The force is linear between steps; one prediction and one correction a step. force,
    displacement, acceleration (3, steps) are filled. Arrays are not counted (_nrt): that took most of the time.
    Returns (engaged tooth steps without contact, largest chip thickness).
    """
    lost, largest = 0, 0.0
    cutting = False
    entry_time, entry_angle = 0.0, 0.0
    before = make_pose(teeth, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    px, py, pz = 0.0, 0.0, 0.0
    for k in range(force.shape[1]):
        t = k * step
        fx, fy, fz = 0.0, 0.0, 0.0
        inside = start <= t < stop
        if inside:
            angle, rotation = turn(motion, t)
            if not cutting:
                entry_time, entry_angle = t, angle
            advance = motion.feed_rate * (t - entry_time) + motion.feed_per_angle * (angle - entry_angle)
            pose = make_pose(teeth, angle, rotation, advance, px, py, pz)
            vx, vy, vz = 0.0, 0.0, 0.0
            if teeth.damping != 0.0:
                vx, vy, vz = _at_tool(modes, state, 1)
            fx, fy, fz, missed, thickest = cutting_force(teeth, surfaces, pose, step, vx, vy, vz)
            lost += missed
            largest = max(largest, thickest)
        x, y, z, ax, ay, az, px, py, pz = _advance(modes, state, fx, fy, fz)
        force[0, k], force[1, k], force[2, k] = fx, fy, fz
        displacement[0, k], displacement[1, k], displacement[2, k] = x, y, z
        acceleration[0, k], acceleration[1, k], acceleration[2, k] = ax, ay, az
        if inside:
            after = moved(pose, x, y, z)
            if cutting:
                pass_over(teeth, surfaces, before, after)
            else:
                _add_impulse(modes, state, impulse)
                px, py, pz = _at_tool(modes, state, 0)
            before = after
        cutting = inside
    return lost, largest
