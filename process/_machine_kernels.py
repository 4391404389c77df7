"""Numba loop of a machine in time. Floats and plain arrays only; labels live in `process.machine_simulation`.

A step is the exact map of the linear part for inputs that are quadratic in time (values at start, middle and end). What
is not linear, friction and joints, is an input too: its values in the middle and at the end are solved for
(collocation, implicit), and where the quadratic does not follow it the step is halved, as often as needed. The loop
runs without reference counting: every array is made in Python.
"""

import math
from typing import Any, NamedTuple

from numba import njit

from process._cutting_kernels import cutting_force, make_pose, moved, pass_over, turn
from process._friction_kernels import COULOMB, LUGRE, MAXWELL_SLIP, VISCOUS, friction_step, lugre_part

# Kinds of elements: a force for a slide's velocity (the first two), or for a displacement.
FRICTION, MEMORY, CUBIC, FLANKS, SLIDERS = 0, 1, 2, 3, 4

# What march returns first.
DONE, RAN_AWAY, NOT_SOLVED = 0, 1, 2

FARTHEST = 1e6
"""Coordinate at which a run is given up."""

# Places in work.tally, work.mode and, after the three forces, in work.cutting.
ENERGY, WORST, LARGEST, SCALE = 0, 1, 2, 3
LEVEL, GUESSED, STALE, STILL = 0, 1, 2, 3
INSIDE, ENTRY_TIME, ENTRY_ANGLE, LOST, THICKEST = 3, 4, 5, 6, 7

_NIL = 1e-12
_LOOK = 16
_NEWTON = 12
_SOLVED = 0.01


class Linear(NamedTuple):
    """The linear part: n coordinates, N states (q, q', integrals), u inputs, e elements.

    maps (p, l, N + 3 u, 2 N + 3 e): at path point p, for a step halved l times: from the state and the three values of
    each input to the state in the middle, at the end, and to what the elements feel at a quarter, half and end of it.
    places (steps,): path point of each step, a share between two. power (n, N), mass, stiffness (n, n): energy flow
    ``q' . power z`` of the linear part. reach (u, n): participation of each input. tool (p, 3, n).
    """

    maps: Any
    places: Any
    power: Any
    mass: Any
    stiffness: Any
    reach: Any
    tool: Any


class Elements(NamedTuple):
    """Friction and joints, e of them: kind, input that they push on, law, parameters, what is taken off.

    Felt is ``rows z``, (e, N); the force is ``f(feed + felt) - steady - slope felt``, as the slope is in the linear
    part. Parameters and states of element i are those from start[i] to start[i + 1], first[i] to first[i + 1].
    """

    kind: Any
    target: Any
    law: Any
    parameters: Any
    start: Any
    feed: Any
    steady: Any
    slope: Any
    first: Any
    rows: Any


class Servos(NamedTuple):
    """Servos outside the linear part: input of each, rows (s, N) that give the force now, on a ring every half step.

    The force at the three nodes of step i is the sum of four entries from 2 i + first (s, 3), with share (s, 3, 4); the
    length of the ring is a power of two. Sampled ones (every > 0 steps a sample, lag + 1 on the ring): rows give x, v
    in turn (2 s, N); gains (s, 3): K_p, 1/T_i, K_v; resolution [m]; ramp (s, 2): speed [m/s], start [m] of the encoder.
    """

    target: Any
    rows: Any
    first: Any
    share: Any
    every: int
    gains: Any
    resolution: float
    ramp: Any


class Given(NamedTuple):
    """Forces over time: input of each, values (given, steps, 3) at the three nodes, later none; the largest [N]."""

    target: Any
    values: Any
    peak: float


class Cut(NamedTuple):
    """The cut (`process._cutting_kernels`), entry and exit [s] (equal: none), velocities from the impulse (n,)."""

    motion: Any
    teeth: Any
    surfaces: Any
    entry: float
    leave: float
    kick: Any


class Work(NamedTuple):
    """Scratch arrays; `z`, states[0], force, felt, the rings and the last three carry over from step to step.

    states (4, .): of the elements now, in the middle, at the end, and for trial. part (2 e,), slope (2 e, 2): force of
    each element in the middle, then at the end, and its slope for what that element feels in the middle and at the end.
    """

    z: Any
    base: Any
    known: Any
    piece: Any
    part: Any
    force: Any
    felt: Any
    slope: Any
    system: Any
    change: Any
    states: Any
    ring: Any
    integral: Any
    largest: Any
    blended: Any
    fresh: Any
    tally: Any
    mode: Any
    cutting: Any


@njit(cache=True, nogil=True, _nrt=False)
def _maxwell_slip(law, p, state, third, velocity, step):
    """Advance by the mean velocity, which its values at the third of the step and at its end give; the force there."""
    mean = 0.75 * third + 0.25 * velocity
    return friction_step(law, p, state, mean, step) + p[4] * (velocity - mean)


@njit(cache=True, nogil=True, _nrt=False)
def _joint(kind, p, state, x):
    """Force and stiffness of a joint at a displacement."""
    if kind == CUBIC:
        return p[0] * x + p[1] * x * x * x, p[0] + 3.0 * p[1] * x * x
    if kind == FLANKS:  # stiffness, side, threshold of each
        force, slope = 0.0, 0.0
        for k in range(0, p.size, 3):
            depth = p[k + 1] * x - p[k + 2]
            if depth > 0.0:
                force += p[k + 1] * p[k] * depth
                slope += p[k]
        return force, slope
    half, force, slope = p.size // 2, 0.0, 0.0
    for k in range(half):
        stiffness, limit = p[k], p[half + k]
        one = stiffness * (x - state[k])
        if abs(one) < limit * (1.0 - 1e-12):
            slope += stiffness
        elif abs(one) > limit:
            one = math.copysign(limit, one)
            state[k] = x - one / stiffness
        force += one
    return force, slope


@njit(cache=True, nogil=True, _nrt=False)
def _remembering(kind, law, p, feed, felt, third, step, state, beside):
    """Force and slope of an element with memory or of a joint; its state moves on, that beside it is scratch."""
    if kind != MEMORY:
        return _joint(kind, p, state, felt)
    v, inner = feed + felt, feed + third
    if law == LUGRE:
        state[0], force, _, _, _, slope, _ = lugre_part(p, state[0], inner, v, step)
        return force, slope
    nudge = 1e-6 * abs(v) + 1e-9
    for k in range(state.size):
        beside[k] = state[k]
    # A third of a change at the end of the (half) step is in its mean.
    ahead = _maxwell_slip(law, p, beside, inner + nudge / 9.0, v + nudge, step)
    force = _maxwell_slip(law, p, state, inner, v, step)
    return force, (ahead - force) / nudge


@njit(cache=True, nogil=True, inline="always")
def _bristles(el, e, work, half):
    """Fill slope and force of LuGre element e in the middle and at the end, as its force there depends on both."""
    p, first, count = el.parameters[el.start[e] : el.start[e + 1]], el.first[e], el.kind.size
    steady, linear, slope = el.steady[e], el.slope[e], work.slope
    v0, vm, v1 = el.feed[e] + work.felt[0, e], el.feed[e] + work.felt[1, e], el.feed[e] + work.felt[2, e]
    z, force, z3, z1, f3, f1, _ = lugre_part(p, work.states[0, first], (5.0 * v0 + 5.0 * vm - v1) / 9.0, vm, half)
    bend_middle, bend_end = z1 + 5.0 / 9.0 * z3, -z3 / 9.0
    slope[e, 0], slope[e, 1] = f1 + 5.0 / 9.0 * f3 - linear, -f3 / 9.0
    work.states[1, first], work.part[e] = z, force - steady - linear * work.felt[1, e]
    z, force, _, _, f3, f1, fz = lugre_part(p, z, (8.0 * vm + 2.0 * v1 - v0) / 9.0, v1, half)
    slope[count + e, 0], slope[count + e, 1] = 8.0 / 9.0 * f3 + fz * bend_middle, f1 + 2.0 / 9.0 * f3 + fz * bend_end
    slope[count + e, 1] -= linear
    work.states[2, first], work.part[count + e] = z, force - steady - linear * work.felt[2, e]


@njit(cache=True, nogil=True, _nrt=False)
def _sliding(law, p, v):
    """Force and slope of a law without memory, of finite steepness: `friction_force` and `friction_slope` in one.

    Exponential, power and hyperbolic tangent are most of what a step costs; here each is taken once.
    """
    if law == VISCOUS:
        return p[0] * v, p[0]
    if law == COULOMB:
        sign = math.tanh(p[2] * v)
        return p[0] * sign + p[1] * v, p[0] * p[2] * (1.0 - sign * sign) + p[1]
    i = 0 if v >= 0.0 else 6
    power = abs(v) / p[i + 2]
    if p[i + 5] != 1.0:
        power = power ** p[i + 5]
    boost, sign, kt = (p[i + 1] - p[i]) * math.exp(-power), math.tanh(p[i + 4] * v), p[i + 4]
    fall = -boost * p[i + 5] * power / v if v != 0.0 else 0.0
    force = (p[i] + boost) * sign + p[i + 3] * v
    return force, (p[i] + boost) * kt * (1.0 - sign * sign) + fall * sign + p[i + 3]


@njit(cache=True, nogil=True, inline="always")
def _element(el, e, felt, third, step, states, row):
    """Force that element e takes from its input, and its slope; its states move from a row of states to the next.

    What it feels is that at the end of the (half) step, and at the third of it.
    """
    p = el.parameters[el.start[e] : el.start[e + 1]]
    if el.kind[e] == FRICTION:
        force, slope = _sliding(el.law[e], p, el.feed[e] + felt)
    else:
        low, high = el.first[e], el.first[e + 1]
        for k in range(low, high):
            states[row + 1, k] = states[row, k]
        state, beside = states[row + 1, low:high], states[3, low:high]
        force, slope = _remembering(el.kind[e], el.law[e], p, el.feed[e], felt, third, step, state, beside)
    return force - el.steady[e] - el.slope[e] * felt, slope - el.slope[e]


@njit(cache=True, nogil=True, inline="always")
def _apply(table, z, known, base):
    """Fill base with the map of the state and of the three values of each input that is not zero."""
    size = z.size
    for r in range(base.size):
        base[r] = 0.0
    for j in range(size):
        value = z[j]
        for r in range(base.size):
            base[r] += table[j, r] * value
    for i in range(known.shape[0]):
        for k in range(3):
            _add(table, size + 3 * i + k, known[i, k], base)


@njit(cache=True, nogil=True, inline="always")
def _add(table, column, value, base):
    if value != 0.0:
        for r in range(base.size):
            base[r] += table[column, r] * value


@njit(cache=True, nogil=True, inline="always")
def _eliminate(a, x):
    """Solve a x = x in place, without exchange of rows."""
    n = x.size
    for k in range(n):
        for i in range(k + 1, n):
            f = a[i, k] / a[k, k]
            if f != 0.0:
                for j in range(k + 1, n):
                    a[i, j] -= f * a[k, j]
                x[i] -= f * x[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            x[k] -= a[k, j] * x[j]
        x[k] /= a[k, k]


@njit(cache=True, nogil=True, inline="always")
def _evaluate(el, work, step):
    """Fill work.slope and work.part with slope and force of all elements in the middle and at the end."""
    count, half = el.kind.size, 0.5 * step
    for e in range(count):
        if el.law[e] == LUGRE:
            _bristles(el, e, work, half)
            continue
        v0, vm, v1 = work.felt[0, e], work.felt[1, e], work.felt[2, e]
        third = (5.0 * v0 + 5.0 * vm - v1) / 9.0
        work.part[e], work.slope[e, 0] = _element(el, e, vm, third, half, work.states, 0)
        third = (8.0 * vm + 2.0 * v1 - v0) / 9.0
        work.part[count + e], work.slope[count + e, 1] = _element(el, e, v1, third, half, work.states, 1)


@njit(cache=True, nogil=True, inline="always")
def _linearise(el, table, base, work):
    """Fill work.system and work.change with the equations for the change of what the elements feel."""
    count, size = el.kind.size, work.z.size
    slope = work.slope
    for stage in range(2):
        for e in range(count):
            row = stage * count + e
            place = 2 * size + count + row
            rest = base[place] - work.felt[1 + stage, e]
            for d in range(count):
                column = size + 3 * el.target[d]
                one, two = table[column + 1, place], table[column + 2, place]
                rest -= one * work.part[d] + two * work.part[count + d]
                work.system[row, d] = one * slope[d, 0] + two * slope[count + d, 0]
                work.system[row, count + d] = one * slope[d, 1] + two * slope[count + d, 1]
            work.system[row, row] += 1.0
            work.change[row] = rest


@njit(cache=True, nogil=True, inline="always")
def _solve(el, table, base, work, step, allowed):
    """Newton for the forces of the elements in the middle and at the end; base holds their map without them.

    work.force (3, e): at the start given; in the middle and at the end guessed and found. False: not solved.
    """
    count, size = el.kind.size, work.z.size
    tail = 2 * size + count
    for stage in range(2):
        for e in range(count):
            row = stage * count + e
            felt = base[tail + row]
            for d in range(count):
                column = size + 3 * el.target[d]
                felt += (
                    table[column + 1, tail + row] * work.force[1, d] + table[column + 2, tail + row] * work.force[2, d]
                )
            work.felt[1 + stage, e] = felt
    for _ in range(_NEWTON):
        _evaluate(el, work, step)
        _linearise(el, table, base, work)
        _eliminate(work.system, work.change)
        largest = 0.0
        for e in range(count):
            middle, end = work.change[e], work.change[count + e]
            work.felt[1, e] += middle
            work.felt[2, e] += end
            for stage in range(2):
                row = stage * count + e
                moves = work.slope[row, 0] * middle + work.slope[row, 1] * end
                largest = max(largest, abs(moves))
                work.force[1 + stage, e] = -(work.part[row] + moves)
        if largest <= allowed:
            return True
        if not largest < 1e30:
            return False
    return False


@njit(cache=True, nogil=True, inline="always")
def _strays(el, table, base, work, step, allowed):
    """Say whether the quadratic through the three forces misses the force at a quarter of the step."""
    count, size = el.kind.size, work.z.size
    for e in range(count):
        f0, fm, f1 = work.force[0, e], work.force[1, e], work.force[2, e]
        if abs(fm - f0) + abs(f1 - fm) <= allowed:
            continue
        if el.kind[e] == SLIDERS or el.law[e] == MAXWELL_SLIP:  # bent where one slips, wherever that is
            miss = 0.125 * (f0 - 2.0 * fm + f1)
        else:
            felt = base[2 * size + e]
            for d in range(count):
                column = size + 3 * el.target[d]
                felt += table[column + 1, 2 * size + e] * work.force[1, d]
                felt += table[column + 2, 2 * size + e] * work.force[2, d]
            third = (5.0 * work.felt[0, e] + 5.0 * felt - work.felt[1, e]) / 9.0
            force, _ = _element(el, e, felt, third, 0.25 * step, work.states, 0)
            miss = force + 0.375 * f0 + 0.75 * fm - 0.125 * f1
        if abs(miss) > allowed:
            return True
    return False


@njit(cache=True, nogil=True, inline="always")
def _cut_out(known, piece, low, width):
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
def _stored(lin, z):
    """Energy [J] in masses and springs."""
    n = lin.mass.shape[0]
    total = 0.0
    for r in range(n):
        for k in range(n):
            total += lin.mass[r, k] * z[n + r] * z[n + k] + lin.stiffness[r, k] * z[r] * z[k]
    return 0.5 * total


@njit(cache=True, nogil=True, inline="always")
def _table(lin, work, step, level):
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
def _start(el, work):
    """Set what the elements feel and do at the state as it is."""
    for e in range(el.kind.size):
        felt = 0.0
        for r in range(work.z.size):
            felt += el.rows[e, r] * work.z[r]
        work.felt[0, e] = felt
        force, _ = _element(el, e, felt, felt, 0.0, work.states, 0)
        work.force[0, e] = -force
    work.mode[STALE] = 0


@njit(cache=True, nogil=True, inline="always")
def _begin(el, work, table, values):
    """Apply the map to what is known at the start of a step; the force of the elements there too."""
    _apply(table, work.z, values, work.base)
    for d in range(el.kind.size):
        _add(table, work.z.size + 3 * el.target[d], work.force[0, d], work.base)


@njit(cache=True, nogil=True, inline="always")
def _serve(servos, work, node, state, start):
    """Write what the servos ask for at a half step on the ring."""
    for s in range(servos.target.size if servos.every == 0 else 0):
        force = 0.0
        for r in range(work.z.size):
            force += servos.rows[s, r] * state[start + r]
        work.ring[s, node & (work.ring.shape[1] - 1)] = force


@njit(cache=True, nogil=True, inline="always")
def _late(servos, work, i):
    """Add the forces that the servos asked for a dead time ago: four half steps, from a ring, share in each."""
    mask = work.ring.shape[1] - 1
    for s in range(servos.target.size):
        for k in range(3):
            first, force = 2 * i + servos.first[s, k], 0.0
            for m in range(4):
                force += servos.share[s, k, m] * work.ring[s, (first + m) & mask]
            work.known[servos.target[s], k] += force


@njit(cache=True, nogil=True, inline="always")
def _sample(servos, work, i, step):
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
def _gather(given, servos, work, i, step):
    """Fill work.known with the inputs of a step that do not depend on what happens in it."""
    for a in range(work.known.shape[0]):
        for k in range(3):
            work.known[a, k] = 0.0
    if i < given.values.shape[1]:
        for g in range(given.target.size):
            for k in range(3):
                work.known[given.target[g], k] += given.values[g, i, k]
    if servos.every > 0:
        _sample(servos, work, i, step)
    elif servos.target.size:
        _serve(servos, work, 2 * i, work.z, 0)
        _late(servos, work, i)


@njit(cache=True, nogil=True, inline="always")
def _swing(tool, state, start):
    """Return the three sums of a tool row times a part of a state."""
    x, y, z = 0.0, 0.0, 0.0
    for r in range(tool.shape[1]):
        value = state[start + r]
        x += tool[0, r] * value
        y += tool[1, r] * value
        z += tool[2, r] * value
    return x, y, z


@njit(cache=True, nogil=True, inline="always")
def _attempt(el, work, table, piece, level, here, allowed, last):
    """Apply the map of a part of the step and solve for the elements; say whether it is good enough."""
    _begin(el, work, table, piece)
    if not el.kind.size:
        return True
    if work.mode[GUESSED] != level:
        for e in range(el.kind.size):
            work.force[1, e], work.force[2, e] = work.force[0, e], work.force[0, e]
    work.mode[GUESSED] = -1
    if not _solve(el, table, work.base, work, here, _SOLVED * allowed):
        return False
    return last or not _strays(el, table, work.base, work, here, allowed)


@njit(cache=True, nogil=True, inline="always")
def _accept(lin, el, work, table, piece, level, here):
    """Take the end of a part of the step as the state; book its energy; the parabolas go on as a guess."""
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
    held = _stored(lin, work.z)
    tally[ENERGY] += here * flow / 6.0
    tally[WORST] = max(tally[WORST], abs(held - tally[ENERGY]))
    tally[LARGEST] = max(tally[LARGEST], held)
    for e in range(el.kind.size):
        f0, fm, f1 = work.force[0, e], work.force[1, e], work.force[2, e]
        work.felt[0, e], work.force[0, e] = work.felt[2, e], f1
        work.force[1, e], work.force[2, e] = f0 - 3.0 * fm + 3.0 * f1, 3.0 * f0 - 8.0 * fm + 6.0 * f1
        tally[SCALE] = max(tally[SCALE], abs(f1))
    work.mode[GUESSED] = level


@njit(cache=True, nogil=True, inline="always")
def _advance(lin, el, servos, work, i, step, accuracy):
    """Move the machine by step i, in one part or in several; return what happened."""
    finest, done = lin.maps.shape[1] - 1, 0
    while done < 1 << finest:
        level = work.mode[LEVEL]
        width = 1 << (finest - level)
        if done & (width - 1):
            work.mode[LEVEL] = level + 1
            continue
        table, piece, share = _table(lin, work, i, level), work.known, width / (1 << finest)
        if level > 0:
            _cut_out(work.known, work.piece, done / (1 << finest), share)
            piece = work.piece
        if not _attempt(el, work, table, piece, level, step * share, accuracy * work.tally[SCALE], level == finest):
            if level == finest:
                return NOT_SOLVED
            work.mode[LEVEL] = level + 1
            continue
        _accept(lin, el, work, table, piece, level, step * share)
        done += width
        if level == 0 or 2 * done == 1 << finest:
            # The state in the middle of this part, or at its end.
            _serve(servos, work, 2 * i + 1, work.base, 0 if level == 0 else work.z.size)
        if level > 0 and done & (2 * width - 1) == 0:
            work.mode[LEVEL] = level - 1
    for r in range(lin.mass.shape[0]):
        if not abs(work.z[r]) < FARTHEST:
            return RAN_AWAY
    return DONE


@njit(cache=True, nogil=True, inline="always")
def _predict(lin, el, work, i):
    """Position and velocity of the tool at the end of step i, with the cutting force held and the elements guessed."""
    for axis in range(3):
        for k in range(3):
            work.known[axis, k] += work.cutting[axis]
    table, size = _table(lin, work, i, 0), work.z.size
    tool = lin.tool[int(lin.places[i] + 0.5)]
    _begin(el, work, table, work.known)
    held = 0 if work.mode[GUESSED] != 0 else 1
    for d in range(el.kind.size):
        column = size + 3 * el.target[d]
        _add(table, column + 1, work.force[held, d], work.base)
        _add(table, column + 2, work.force[2 * held, d], work.base)
    x, y, z = _swing(tool, work.base, size)
    vx, vy, vz = _swing(tool, work.base, size + tool.shape[1])
    return x, y, z, vx, vy, vz


@njit(cache=True, nogil=True, inline="always")
def _bite(cut, work, t, step, moving, old):
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
        x, y, z = _swing(lin.tool[place], work.z, 0)
        pose = moved(pose, x, y, z)
        if work.cutting[INSIDE] == 1.0:
            pass_over(cut.teeth, cut.surfaces, before, pose)
        else:
            work.tally[ENERGY] -= _stored(lin, work.z)
            for r in range(cut.kick.size):
                work.z[cut.kick.size + r] += cut.kick[r]
            work.tally[ENERGY] += _stored(lin, work.z)
            work.mode[GUESSED], work.mode[STALE] = -1, 1
    work.cutting[INSIDE] = 1.0 if now else 0.0
    return pose


@njit(cache=True, nogil=True, inline="always")
def _keep(el, work, i, states, inputs):
    """Write state, inputs and forces of the elements at the start of step i."""
    for r in range(work.z.size):
        states[i, r] = work.z[r]
    for a in range(work.known.shape[0]):
        inputs[i, a] = work.known[a, 0]
    for e in range(el.kind.size):
        inputs[i, work.known.shape[0] + e] = work.force[0, e]


@njit(cache=True, nogil=True, _nrt=False)
def _settled(work, i):
    """Say whether all has been at rest for longer than servos look back: states and forces, next to their largest."""
    if i % _LOOK:
        return False
    largest, size, moving = work.largest, work.z.size, False
    for k in range(largest.size):
        now = abs(work.z[k]) if k < size else abs(work.force[0, k - size])
        largest[k] = max(largest[k], now)
        moving = moving or now > _NIL * largest[k]
    work.mode[STILL] = 0 if moving else work.mode[STILL] + _LOOK
    return work.mode[STILL] > work.ring.shape[1]


@njit(cache=True, nogil=True, _nrt=False)
def march(lin, el, servos, given, work, step, accuracy, cut, states, inputs):
    """March the machine; return what happened and the steps done.

    states (steps, N) and inputs (steps, u + e) receive the state, the inputs and the forces of the elements at the
    start of each step. `accuracy` is the largest error of an element's force, over the largest force so far. work.tally
    tells the largest difference between the energy in masses and springs and the integral of the power (Simpson). With
    a cut the first three inputs are the forces on the tool. Once all is at rest and nothing will excite it, it stays
    so: the rest of states and inputs, which must be zero before, is left as it is.
    """
    steps, milling = states.shape[0], cut.leave > cut.entry
    work.tally[SCALE] = given.peak
    pose = make_pose(cut.teeth, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0)
    # The first turn is no step: it brings the cutting force at t = 0.
    for i in range(-1 if milling else 0, steps):
        before, t = pose, (i + 1) * step
        if work.mode[STALE] == 1:
            _start(el, work)
        if i >= 0:
            _gather(given, servos, work, i, step)
        if milling:
            moving = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            if i >= 0:
                moving = _predict(lin, el, work, i)
            pose = _bite(cut, work, t, step, moving, before)
        if i >= 0:
            _keep(el, work, i, states, inputs)
            result = _advance(lin, el, servos, work, i, step, accuracy)
            if result != DONE:
                return result, i
            if i >= given.values.shape[1] and servos.every == 0 and not milling and _settled(work, i):
                break
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
