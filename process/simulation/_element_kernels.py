"""Numba kernels of the nonlinear forces of a machine, friction and joints, and of the collocation that solves for them.

Their forces are inputs of the linear part, quadratic in time over a step: the values in the middle and at the end are
solved for with Newton's method; where the quadratic does not follow a force, the step has to be halved.

Most are inlined into `_machine_kernels.integrate` and compiled with it. The others, for an int64 kind, float64 scalars
and C-contiguous float64 arrays, take below 1 s of CPU each.
"""

import math

from numba import njit

from process.friction._kernels import COULOMB, LUGRE, MAXWELL_SLIP, VISCOUS, friction_step, lugre_part
from process.simulation._machine_arrays import CUBIC, FLANKS, FRICTION, MEMORY, SLIDERS

_NEWTON = 12


@njit(cache=True, nogil=True, _nrt=False)
def _maxwell_slip(law, p, state, third, velocity, step):
    """Advance by the mean velocity, which its values at the third of the step and at its end give; the force there."""
    mean = 0.75 * third + 0.25 * velocity
    viscous = (p[5] if velocity >= 0.0 else p[10]) * velocity - (p[5] if mean >= 0.0 else p[10]) * mean
    return friction_step(law, p, state, mean, step) + viscous


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
def _with_memory(kind, law, p, feed, motion, third, step, state, beside):
    """Force and slope of an element with memory or of a joint; its state moves on, that beside it is scratch."""
    if kind != MEMORY:
        return _joint(kind, p, state, motion)
    v, inner = feed + motion, feed + third
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
def _lugre_element(el, e, work, half):
    """Fill slope and force of LuGre element e in the middle and at the end, as its force there depends on both."""
    p, first, count = el.parameters[el.start[e] : el.start[e + 1]], el.first[e], el.kind.size
    steady, linear, slope = el.steady[e], el.slope[e], work.slope
    v0, vm, v1 = el.feed[e] + work.motion[0, e], el.feed[e] + work.motion[1, e], el.feed[e] + work.motion[2, e]
    z, force, z3, z1, f3, f1, _ = lugre_part(p, work.states[0, first], (5.0 * v0 + 5.0 * vm - v1) / 9.0, vm, half)
    bend_middle, bend_end = z1 + 5.0 / 9.0 * z3, -z3 / 9.0
    slope[e, 0], slope[e, 1] = f1 + 5.0 / 9.0 * f3 - linear, -f3 / 9.0
    work.states[1, first], work.part[e] = z, force - steady - linear * work.motion[1, e]
    z, force, _, _, f3, f1, fz = lugre_part(p, z, (8.0 * vm + 2.0 * v1 - v0) / 9.0, v1, half)
    slope[count + e, 0], slope[count + e, 1] = 8.0 / 9.0 * f3 + fz * bend_middle, f1 + 2.0 / 9.0 * f3 + fz * bend_end
    slope[count + e, 1] -= linear
    work.states[2, first], work.part[count + e] = z, force - steady - linear * work.motion[2, e]


@njit(cache=True, nogil=True, _nrt=False)
def _without_memory(law, p, v):
    """Force and slope of a law without memory, of finite steepness: `friction_force` and `friction_slope` in one.

    Exponential, power and hyperbolic tangent take most of the time of a step; each is evaluated once.
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
def _element(el, e, motion, third, step, states, row):
    """Force that element e takes from its input, and its slope; its states move from a row of states to the next.

    `motion` is its velocity or displacement at the end of the (half) step, `third` at the third of it.
    """
    p = el.parameters[el.start[e] : el.start[e + 1]]
    if el.kind[e] == FRICTION:
        force, slope = _without_memory(el.law[e], p, el.feed[e] + motion)
    else:
        low, high = el.first[e], el.first[e + 1]
        for k in range(low, high):
            states[row + 1, k] = states[row, k]
        state, beside = states[row + 1, low:high], states[3, low:high]
        force, slope = _with_memory(el.kind[e], el.law[e], p, el.feed[e], motion, third, step, state, beside)
    return force - el.steady[e] - el.slope[e] * motion, slope - el.slope[e]


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
            _lugre_element(el, e, work, half)
            continue
        v0, vm, v1 = work.motion[0, e], work.motion[1, e], work.motion[2, e]
        third = (5.0 * v0 + 5.0 * vm - v1) / 9.0
        work.part[e], work.slope[e, 0] = _element(el, e, vm, third, half, work.states, 0)
        third = (8.0 * vm + 2.0 * v1 - v0) / 9.0
        work.part[count + e], work.slope[count + e, 1] = _element(el, e, v1, third, half, work.states, 1)


@njit(cache=True, nogil=True, inline="always")
def _linearise(el, table, base, work):
    """Fill work.system and work.change with the equations for the change of the motion of the elements."""
    count, size = el.kind.size, work.z.size
    slope = work.slope
    for stage in range(2):
        for e in range(count):
            row = stage * count + e
            place = 2 * size + count + row
            rest = base[place] - work.motion[1 + stage, e]
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
            motion = base[tail + row]
            for d in range(count):
                column = size + 3 * el.target[d]
                motion += (
                    table[column + 1, tail + row] * work.force[1, d] + table[column + 2, tail + row] * work.force[2, d]
                )
            work.motion[1 + stage, e] = motion
    for _ in range(_NEWTON):
        _evaluate(el, work, step)
        _linearise(el, table, base, work)
        _eliminate(work.system, work.change)
        largest = 0.0
        for e in range(count):
            middle, end = work.change[e], work.change[count + e]
            work.motion[1, e] += middle
            work.motion[2, e] += end
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
def _misses(el, table, base, work, step, allowed):
    """Return whether the quadratic through the three forces misses the force at a quarter of the step."""
    count, size = el.kind.size, work.z.size
    for e in range(count):
        f0, fm, f1 = work.force[0, e], work.force[1, e], work.force[2, e]
        if abs(fm - f0) + abs(f1 - fm) <= allowed:
            continue
        if el.kind[e] == SLIDERS or el.law[e] == MAXWELL_SLIP:  # bent where one slips, wherever that is
            miss = 0.125 * (f0 - 2.0 * fm + f1)
        else:
            motion = base[2 * size + e]
            for d in range(count):
                column = size + 3 * el.target[d]
                motion += table[column + 1, 2 * size + e] * work.force[1, d]
                motion += table[column + 2, 2 * size + e] * work.force[2, d]
            third = (5.0 * work.motion[0, e] + 5.0 * motion - work.motion[1, e]) / 9.0
            force, _ = _element(el, e, motion, third, 0.25 * step, work.states, 0)
            miss = force + 0.375 * f0 + 0.75 * fm - 0.125 * f1
        if abs(miss) > allowed:
            return True
    return False
