"""Numba loop of a machine in time. Floats and plain arrays only; labels live in `process.simulation.machine`.

A step is the exact map of the linear part for inputs that are quadratic in time (values at start, middle and end).
Nonlinear forces (friction, joints) are inputs too: their values in the middle and at the end of the step are unknowns
of an implicit collocation; where the quadratic does not follow a force the step is halved. The loop runs without
reference counting: every array is made in Python.

Compiled at the first call and cached: `integrate`, with all that it inlines, for the tuples of `_machine_arrays` of
float64 and int64 arrays (one compilation serves every machine, with or without a cut), `low_pass` and `combine` for
float64 arrays, C-contiguous; 37 s of CPU in all. A change of this file, of `_element_kernels`, `_machine_arrays`,
`cut._kernels` or `friction._kernels` takes effect here only when this file is compiled again.
"""

import math

from numba import njit

from process.cut._kernels import cutting_force, make_pose, moved, pass_over, turn
from process.simulation._element_kernels import _add, _apply, _element, _misses, _solve
from process.simulation._machine_arrays import (
    DONE,
    ENERGY,
    ENTRY_ANGLE,
    ENTRY_TIME,
    FARTHEST,
    GUESSED,
    INSIDE,
    LARGEST,
    LEVEL,
    LOST,
    NOT_SOLVED,
    RAN_AWAY,
    SCALE,
    STALE,
    STILL,
    THICKEST,
    WORST,
)

_EVERY = 64
_SOLVED = 0.01


@njit(cache=True, nogil=True, inline="always")
def _part_of_parabola(known, piece, low, width):
    """Fill piece with the three values of each input's parabola on a part of the step."""
    for i in range(known.shape[0]):
        a, m, b = known[i, 0], known[i, 1], known[i, 2]
        for k in range(3):
            t = low + 0.5 * k * width
            piece[i, k] = a * (1.0 - t) * (1.0 - 2.0 * t) + 4.0 * m * t * (1.0 - t) + b * t * (2.0 * t - 1.0)


@njit(cache=True, nogil=True, inline="always")
def _power(lin, el, state, start, values, node, forces):
    """Power [W] that flows into masses and springs at a state; inputs at a node, and the forces of the elements."""
    n, size = lin.mass.shape[0], lin.power.shape[1]
    total = 0.0
    for r in range(n):
        velocity, flow = state[start + n + r], 0.0
        for j in range(size):
            flow += lin.power[r, j] * state[start + j]
        for i in range(values.shape[0]):
            flow += lin.reach[i, r] * values[i, node]
        for e in range(el.kind.size):
            flow += lin.reach[el.target[e], r] * forces[node, e]
        total += flow * velocity
    return total


@njit(cache=True, nogil=True, inline="always")
def _stored_energy(lin, z):
    """Energy [J] in masses and springs."""
    n = lin.mass.shape[0]
    total = 0.0
    for r in range(n):
        for k in range(n):
            total += lin.mass[r, k] * z[n + r] * z[n + k] + lin.stiffness[r, k] * z[r] * z[k]
    return 0.5 * total


@njit(cache=True, nogil=True, inline="always")
def _step_map(lin, work, step, level):
    """Return the map of a step on the path: that of its point, or the blend of two."""
    place = lin.places[step]
    point = min(int(place), lin.maps.shape[0] - 1)
    share = place - point
    if share == 0.0:
        return lin.maps[point, level]
    if work.fresh[level] != step:
        work.fresh[level] = step
        for j in range(lin.maps.shape[2]):
            for r in range(lin.maps.shape[3]):
                one, two = lin.maps[point, level, j, r], lin.maps[point + 1, level, j, r]
                work.blended[level, j, r] = one + share * (two - one)
    return work.blended[level]


@njit(cache=True, nogil=True, inline="always")
def _start_elements(el, work):
    """Set motion and force of the elements at the present state."""
    for e in range(el.kind.size):
        motion = 0.0
        for r in range(work.z.size):
            motion += el.rows[e, r] * work.z[r]
        work.motion[0, e] = motion
        force, _ = _element(el, e, motion, motion, 0.0, work.states, 0)
        work.force[0, e] = -force
    work.mode[STALE] = 0


@njit(cache=True, nogil=True, inline="always")
def _map_known(el, work, table, values):
    """Map state, known inputs and present forces of the elements over the step into work.base."""
    _apply(table, work.z, values, work.base)
    for d in range(el.kind.size):
        _add(table, work.z.size + 3 * el.target[d], work.force[0, d], work.base)


@njit(cache=True, nogil=True, inline="always")
def _write_servo_forces(servos, work, node, state, start):
    """Write the force commands of the servos at a half step on the ring."""
    for s in range(servos.target.size if servos.every == 0 else 0):
        force = 0.0
        for r in range(work.z.size):
            force += servos.rows[s, r] * state[start + r]
        work.ring[s, node & (work.ring.shape[1] - 1)] = force


@njit(cache=True, nogil=True, inline="always")
def _add_delayed_forces(servos, work, i):
    """Add the force commands of a dead time ago, interpolated by a cubic through four half steps on the ring."""
    mask = work.ring.shape[1] - 1
    for s in range(servos.target.size):
        for k in range(3):
            first, force = 2 * i + servos.first[s, k], 0.0
            for m in range(4):
                force += servos.share[s, k, m] * work.ring[s, (first + m) & mask]
            work.known[servos.target[s], k] += force


@njit(cache=True, nogil=True, inline="always")
def _add_sampled_forces(servos, work, i, step):
    """Add the held forces of sampled servos; at a sample read the encoder first. integral (s, 2): I, reading."""
    lag = work.ring.shape[1]
    for s in range(servos.target.size):
        if i % servos.every == 0:
            period, place, speed = servos.every * step, 0.0, 0.0
            for r in range(work.z.size):
                place += servos.rows[2 * s, r] * work.z[r]
                speed += servos.rows[2 * s + 1, r] * work.z[r]
            if servos.resolution > 0.0:
                ramp = servos.ramp[s, 1] + servos.ramp[s, 0] * i * step
                place = servos.resolution * math.floor((ramp + place) / servos.resolution + 0.5) - ramp
                speed = (place - work.integral[s, 1]) / period if i > 0 else 0.0
                work.integral[s, 1] = place
            error = -(servos.gains[s, 2] * place + speed)
            work.integral[s, 0] += period * error
            force = servos.gains[s, 0] * (error + work.integral[s, 0] * servos.gains[s, 1])
            work.ring[s, (i // servos.every) % lag] = force
        held = work.ring[s, (i // servos.every + 1) % lag]
        for k in range(3):
            work.known[servos.target[s], k] += held


@njit(cache=True, nogil=True, inline="always")
def _fill_known_inputs(given, servos, work, i, step):
    """Fill work.known with the inputs of a step that do not depend on its motion."""
    for a in range(work.known.shape[0]):
        for k in range(3):
            work.known[a, k] = 0.0
    if i < given.values.shape[1]:
        for g in range(given.target.size):
            for k in range(3):
                work.known[given.target[g], k] += given.values[g, i, k]
    if servos.every > 0:
        _add_sampled_forces(servos, work, i, step)
    elif servos.target.size:
        _write_servo_forces(servos, work, 2 * i, work.z, 0)
        _add_delayed_forces(servos, work, i)


@njit(cache=True, nogil=True, inline="always")
def _tool_motion(tool, state, start):
    """Return the three sums of a tool row times a part of a state."""
    x, y, z = 0.0, 0.0, 0.0
    for r in range(tool.shape[1]):
        value = state[start + r]
        x += tool[0, r] * value
        y += tool[1, r] * value
        z += tool[2, r] * value
    return x, y, z


@njit(cache=True, nogil=True, inline="always")
def _solve_part(el, work, table, piece, level, here, allowed, last):
    """Apply the map of a part of the step and solve for the elements; return whether the error is allowed."""
    _map_known(el, work, table, piece)
    if not el.kind.size:
        return True
    if work.mode[GUESSED] != level:
        for e in range(el.kind.size):
            work.force[1, e], work.force[2, e] = work.force[0, e], work.force[0, e]
    work.mode[GUESSED] = -1
    if not _solve(el, table, work.base, work, here, _SOLVED * allowed):
        return False
    return last or not _misses(el, table, work.base, work, here, allowed)


@njit(cache=True, nogil=True, inline="always")
def _finish_part(lin, el, work, table, piece, level, here):
    """Take the end of a part of the step as the state, add its energy, extrapolate the parabolas as the next guess."""
    size, tally = work.z.size, work.tally
    flow = _power(lin, el, work.z, 0, piece, 0, work.force)
    for d in range(el.kind.size):
        column = size + 3 * el.target[d]
        _add(table, column + 1, work.force[1, d], work.base)
        _add(table, column + 2, work.force[2, d], work.base)
    for r in range(size):
        work.z[r] = work.base[size + r]
    for k in range(work.states.shape[1]):
        work.states[0, k] = work.states[2, k]
    flow += 4.0 * _power(lin, el, work.base, 0, piece, 1, work.force)
    flow += _power(lin, el, work.base, size, piece, 2, work.force)
    held = _stored_energy(lin, work.z)
    tally[ENERGY] += here * flow / 6.0
    tally[WORST] = max(tally[WORST], abs(held - tally[ENERGY]))
    tally[LARGEST] = max(tally[LARGEST], held)
    for e in range(el.kind.size):
        f0, fm, f1 = work.force[0, e], work.force[1, e], work.force[2, e]
        work.motion[0, e], work.force[0, e] = work.motion[2, e], f1
        work.force[1, e], work.force[2, e] = f0 - 3.0 * fm + 3.0 * f1, 3.0 * f0 - 8.0 * fm + 6.0 * f1
        tally[SCALE] = max(tally[SCALE], abs(f1))
    work.mode[GUESSED] = level


@njit(cache=True, nogil=True, inline="always")
def _integrate_step(lin, el, servos, work, i, step, accuracy):
    """Integrate step i in one part or in several; return DONE, RAN_AWAY or NOT_SOLVED."""
    finest, done = lin.maps.shape[1] - 1, 0
    while done < 1 << finest:
        level = work.mode[LEVEL]
        width = 1 << (finest - level)
        if done & (width - 1):
            work.mode[LEVEL] = level + 1
            continue
        table, piece, share = _step_map(lin, work, i, level), work.known, width / (1 << finest)
        if level > 0:
            _part_of_parabola(work.known, work.piece, done / (1 << finest), share)
            piece = work.piece
        if not _solve_part(el, work, table, piece, level, step * share, accuracy * work.tally[SCALE], level == finest):
            if level == finest:
                return NOT_SOLVED
            work.mode[LEVEL] = level + 1
            continue
        _finish_part(lin, el, work, table, piece, level, step * share)
        done += width
        if level == 0 or 2 * done == 1 << finest:
            # The state in the middle of this part, or at its end.
            _write_servo_forces(servos, work, 2 * i + 1, work.base, 0 if level == 0 else work.z.size)
        if level > 0 and done & (2 * width - 1) == 0:
            work.mode[LEVEL] = level - 1
    for r in range(lin.mass.shape[0]):
        if not abs(work.z[r]) < FARTHEST:
            return RAN_AWAY
    return DONE


@njit(cache=True, nogil=True, inline="always")
def _predict_tool(lin, el, work, i):
    """Position and velocity of the tool at the end of step i, with the cutting force held and the elements guessed."""
    for axis in range(3):
        for k in range(3):
            work.known[axis, k] += work.cutting[axis]
    table, size = _step_map(lin, work, i, 0), work.z.size
    tool = lin.tool[int(lin.places[i] + 0.5)]
    _map_known(el, work, table, work.known)
    held = 0 if work.mode[GUESSED] != 0 else 1
    for d in range(el.kind.size):
        column = size + 3 * el.target[d]
        _add(table, column + 1, work.force[held, d], work.base)
        _add(table, column + 2, work.force[2 * held, d], work.base)
    x, y, z = _tool_motion(tool, work.base, size)
    vx, vy, vz = _tool_motion(tool, work.base, size + tool.shape[1])
    return x, y, z, vx, vy, vz


@njit(cache=True, nogil=True, inline="always")
def _apply_cutting_force(cut, work, t, step, moving, old):
    """Return the pose at time t, and write the cutting force there; linear over the step."""
    x, y, z, vx, vy, vz = moving
    motion, memory = cut.motion, work.cutting
    fx, fy, fz = 0.0, 0.0, 0.0
    pose = old
    if cut.entry <= t < cut.leave:
        angle, rotation = turn(motion, t)
        if memory[INSIDE] == 0.0:
            memory[ENTRY_TIME], memory[ENTRY_ANGLE] = t, angle
        advance = motion.feed_rate * (t - memory[ENTRY_TIME]) + motion.feed_per_angle * (angle - memory[ENTRY_ANGLE])
        pose = make_pose(cut.teeth, angle, rotation, advance, x, y, z)
        fx, fy, fz, missed, chip = cutting_force(cut.teeth, cut.surfaces, pose, step, vx, vy, vz)
        memory[LOST] += missed
        memory[THICKEST] = max(memory[THICKEST], chip)
        work.tally[SCALE] = max(work.tally[SCALE], abs(fx), abs(fy), abs(fz))
    for k in range(1, 3):
        work.known[0, k] += 0.5 * k * (fx - memory[0])
        work.known[1, k] += 0.5 * k * (fy - memory[1])
        work.known[2, k] += 0.5 * k * (fz - memory[2])
    memory[0], memory[1], memory[2] = fx, fy, fz
    return pose


@njit(cache=True, nogil=True, inline="always")
def _leave_surface(lin, cut, work, place, t, before, pose):
    """Let the teeth pass over the surface, or the impulse act at entry; return the final pose."""
    now = cut.entry <= t < cut.leave
    if now:
        x, y, z = _tool_motion(lin.tool[place], work.z, 0)
        pose = moved(pose, x, y, z)
        if work.cutting[INSIDE] == 1.0:
            pass_over(cut.teeth, cut.surfaces, before, pose)
        else:
            work.tally[ENERGY] -= _stored_energy(lin, work.z)
            for r in range(cut.kick.size):
                work.z[cut.kick.size + r] += cut.kick[r]
            work.tally[ENERGY] += _stored_energy(lin, work.z)
            work.mode[GUESSED], work.mode[STALE] = -1, 1
    work.cutting[INSIDE] = 1.0 if now else 0.0
    return pose


@njit(cache=True, nogil=True, inline="always")
def _store(el, work, i, states, inputs):
    """Write state, inputs and forces of the elements at the start of step i."""
    for r in range(work.z.size):
        states[i, r] = work.z[r]
    for a in range(work.known.shape[0]):
        inputs[i, a] = work.known[a, 0]
    for e in range(el.kind.size):
        inputs[i, work.known.shape[0] + e] = work.force[0, e]


@njit(cache=True, nogil=True, inline="always")
def _note_motion(work):
    """Note how large states and forces have been since the last look at them."""
    recent, size = work.recent, work.z.size
    for k in range(recent.size):
        recent[k] = max(recent[k], abs(work.z[k]) if k < size else abs(work.force[0, k - size]))


@njit(cache=True, nogil=True, _nrt=False)
def _at_rest(servos, work, i, n, left, rest):
    """Return whether nothing moves any more that would with `left` steps to come, of a machine of n coordinates.

    States and forces have stayed below the share rest[0] of their largest for longer than the dead times. Or a slide
    that its guideway holds stays where it is: velocities are below the share rest[1] of the largest, and what the
    servos wind up by until the end, as they do now, is below the share rest[2] of the largest force.
    """
    if i % _EVERY:
        return False
    largest, recent, moving, now, fastest = work.largest, work.recent, False, 0.0, 0.0
    for k in range(largest.size):
        largest[k] = max(largest[k], recent[k])
        moving = moving or recent[k] > rest[0] * largest[k]
        if n <= k < 2 * n:
            now, fastest = max(now, recent[k]), max(fastest, largest[k])
        recent[k] = 0.0
    creeping = rest[1] > 0.0 and now <= rest[1] * fastest
    mask = work.ring.shape[1] - 1
    for s in range(servos.target.size):
        # The ring has a force every half step.
        winds = abs(work.ring[s, (2 * i) & mask] - work.ring[s, (2 * i - 4) & mask]) / 2.0
        creeping = creeping and winds * left <= rest[2] * work.tally[SCALE]
    work.mode[STILL] = 0 if moving else work.mode[STILL] + _EVERY
    return creeping or work.mode[STILL] > work.ring.shape[1]


@njit(cache=True, nogil=True, _nrt=False)
def integrate(lin, el, servos, given, work, step, accuracy, rest, cut, states, inputs):
    """Integrate the machine; return DONE, RAN_AWAY or NOT_SOLVED, and the number of steps done.

    states (steps, N) and inputs (steps, u + e) receive the state, the inputs and the forces of the elements at the
    start of each step. `accuracy` is the largest error of an element's force, over the largest force so far. work.tally
    receives the largest difference between the energy in masses and springs and the integral of the power (Simpson).
    With a cut the first three inputs are the forces on the tool. Once nothing moves any more by the shares `rest` (3,)
    and no excitation follows, the run ends: states and inputs must be zero before and stay so.
    """
    steps, milling = states.shape[0], cut.leave > cut.entry
    work.tally[SCALE] = given.peak
    pose = make_pose(cut.teeth, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    # The first pass is no step: it computes the cutting force at t = 0.
    for i in range(-1 if milling else 0, steps):
        before, t = pose, (i + 1) * step
        if work.mode[STALE] == 1:
            _start_elements(el, work)
        if i >= 0:
            _fill_known_inputs(given, servos, work, i, step)
        if milling:
            moving = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            if i >= 0:
                moving = _predict_tool(lin, el, work, i)
            pose = _apply_cutting_force(cut, work, t, step, moving, before)
        if i >= 0:
            _store(el, work, i, states, inputs)
            result = _integrate_step(lin, el, servos, work, i, step, accuracy)
            if result != DONE:
                return result, i
            if servos.every == 0 and not milling:
                _note_motion(work)
                left = steps - i
                if i >= given.values.shape[1] and _at_rest(servos, work, i, lin.mass.shape[0], left, rest):
                    return DONE, i + 1
        if milling:
            pose = _leave_surface(lin, cut, work, int(lin.places[max(i, 0)] + 0.5), t, before, pose)
    return DONE, steps


@njit(cache=True, nogil=True, fastmath=True)
def low_pass(channels, at, taps, factor, out):
    """Fill out (c, m) with every `factor`-th sample of channels (c, n) through a symmetric filter; zero outside.

    taps (t,) at distances at (t,) from the middle, to both sides; the first in the middle itself.
    """
    n, half = channels.shape[1], at[-1]
    for c in range(channels.shape[0]):
        for k in range(min(out.shape[1], (n + half - 1) // factor + 1)):
            middle, total = k * factor, 0.0
            if half <= middle < n - half:
                total = taps[0] * channels[c, middle]
                for j in range(1, at.size):
                    total += taps[j] * (channels[c, middle - at[j]] + channels[c, middle + at[j]])
            else:
                for j in range(at.size):
                    low, high = middle - at[j], middle + at[j]
                    if 0 <= low < n:
                        total += taps[j] * channels[c, low]
                    if high < n and high > low:
                        total += taps[j] * channels[c, high]
            out[c, k] = total


@njit(cache=True, nogil=True, fastmath=True)
def combine(rows, states, inputs, share, out):
    """Add ``share (rows . (states, inputs))`` to out (c, n): rows (c, N + u), states (n, N), inputs (n, u), share (n,).

    A library's product starts threads for so long a matrix, which costs more than it gains. Most of a row is zero.
    """
    size = states.shape[1]
    for c in range(rows.shape[0]):
        for j in range(rows.shape[1]):
            weight = rows[c, j]
            if weight == 0.0:
                continue
            if j < size:
                for k in range(share.size):
                    out[c, k] += share[k] * weight * states[k, j]
            else:
                for k in range(share.size):
                    out[c, k] += share[k] * weight * inputs[k, j - size]
