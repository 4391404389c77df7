"""Compiled friction: scalars in, scalars out, SI. Friction force opposes motion: ``m x'' = F - friction_force(x')``.

Compiled at the first call and cached: every function below for an int64 code of the law, float64 scalars, and float64
arrays, C-contiguous, of parameters, states, velocities and results. Each takes 0.3 to 0.9 s of CPU.
"""

import math

from numba import njit

# Codes and the layout of the packed parameters. Friction laws without memory:
VISCOUS = 0  # sigma
COULOMB = 1  # force, sigma, kt (may be infinite)
ANDERSSON = 2  # coulomb, static, stribeck_speed, sigma, kt, delta; the same six for negative velocity


@njit(cache=True, nogil=True, inline="always")
def _smooth_sign(kt, velocity):
    if math.isinf(kt):
        return math.copysign(1.0, velocity) if velocity != 0.0 else 0.0
    return math.tanh(kt * velocity)


@njit(cache=True, nogil=True)
def friction_force(law, parameters, velocity):
    """Force [N] of a law without memory at a velocity [m/s]."""
    p = parameters
    if law == VISCOUS:
        return p[0] * velocity
    if law == COULOMB:
        return p[0] * _smooth_sign(p[2], velocity) + p[1] * velocity
    i = 0 if velocity >= 0.0 else 6
    boost = (p[i + 1] - p[i]) * math.exp(-((abs(velocity) / p[i + 2]) ** p[i + 5]))
    return (p[i] + boost) * _smooth_sign(p[i + 4], velocity) + p[i + 3] * velocity


@njit(cache=True, nogil=True)
def friction_slope(law, parameters, velocity):
    """Derivative [N s/m] of `friction_force` with respect to velocity."""
    p = parameters
    if law == VISCOUS:
        return p[0]
    i = 0
    if law == COULOMB:
        force, boost, fall, sigma, kt = p[0], 0.0, 0.0, p[1], p[2]
    else:
        i = 0 if velocity >= 0.0 else 6
        ratio = abs(velocity) / p[i + 2]
        boost = (p[i + 1] - p[i]) * math.exp(-(ratio ** p[i + 5]))
        force, sigma, kt = p[i], p[i + 3], p[i + 4]
        # d/dv of -(|v|/vs)^delta; its product with the smooth sign vanishes at rest.
        fall = 0.0 if ratio == 0.0 else -p[i + 5] * ratio ** p[i + 5] / velocity
    if math.isinf(kt):
        return math.inf if velocity == 0.0 else boost * fall * math.copysign(1.0, velocity) + sigma
    t = math.tanh(kt * velocity)
    return (force + boost) * kt * (1.0 - t * t) + boost * fall * t + sigma


@njit(cache=True, nogil=True)
def friction_forces(law, parameters, velocity, out):
    """Fill out (n,) with `friction_force` at velocity (n,)."""
    for i in range(velocity.size):
        out[i] = friction_force(law, parameters, velocity[i])


@njit(cache=True, nogil=True)
def friction_slopes(law, parameters, velocity, out):
    """Fill out (n,) with `friction_slope` at velocity (n,)."""
    for i in range(velocity.size):
        out[i] = friction_slope(law, parameters, velocity[i])


@njit(cache=True, nogil=True)
def _panel(law, parameters, bias, amplitude, low, high, nodes, weights):
    half, total = 0.5 * (high - low), 0.0
    for i in range(nodes.size):
        c = math.cos(low + half * (1.0 + nodes[i]))
        total += weights[i] * friction_force(law, parameters, bias + amplitude * c) * c
    return half * total


@njit(cache=True, nogil=True)
def first_harmonic(law, parameters, bias, amplitude, scale, nodes, weights):
    """First Fourier cosine coefficient [N] of f(bias + amplitude cos t).

    Gauss-Legendre (nodes, weights on -1..1) on panels that double in length away from the passage through rest, or
    from the slowest moment; the first spans about `scale` [m/s], in which f changes most.
    """
    turn = math.acos(min(1.0, max(-1.0, -bias / amplitude)))
    ratio, sine = scale / amplitude, math.sin(turn)
    first = max(2.0 * ratio / (sine + math.sqrt(sine * sine + 2.0 * ratio)), 1e-6)
    total = 0.0
    for side in range(2):
        length = math.pi - turn if side == 0 else turn
        sign = 1.0 if side == 0 else -1.0
        low, width = 0.0, first
        while low < length:
            high = low + width
            if length - high < 0.5 * width:
                high = length
            if sign > 0.0:
                total += _panel(law, parameters, bias, amplitude, turn + low, turn + high, nodes, weights)
            else:
                total += _panel(law, parameters, bias, amplitude, turn - high, turn - low, nodes, weights)
            low, width = high, 2.0 * width
    return 2.0 * total / math.pi


@njit(cache=True, nogil=True)
def first_harmonics(law, parameters, bias, amplitude, scale, nodes, weights, out):
    """Fill out (n,) with `first_harmonic` at bias (n,) and amplitude (n,)."""
    for i in range(out.size):
        out[i] = first_harmonic(law, parameters, bias[i], amplitude[i], scale, nodes, weights)


# Friction with memory: `state` holds the deflection or the force of the elements.
LUGRE = (
    10  # stiffness; micro damping, sigma, coulomb, static, stribeck_speed, delta; the same six for negative velocity
)
# Attraction; coulomb, static, stribeck_speed, delta, sigma; the same five for negative velocity; then stiffness and
# share of each element.
MAXWELL_SLIP = 11


@njit(cache=True, nogil=True)
def _stribeck(coulomb, static, speed, delta, velocity):
    return coulomb + (static - coulomb) * math.exp(-((abs(velocity) / speed) ** delta))


@njit(cache=True, nogil=True, inline="always")
def _lugre_rate(p, velocity):
    """Rate ``k |v| / g(v)`` [1/s] at which bristles settle, and its slope [1/m]; where the side's parameters begin."""
    i = 1 if velocity >= 0.0 else 7
    power = abs(velocity) / p[i + 4]
    if p[i + 5] != 1.0:
        power = power ** p[i + 5]
    boost = (p[i + 3] - p[i + 2]) * math.exp(-power)
    weak = 1.0 / (p[i + 2] + boost)
    steep = p[0] * weak
    return steep * abs(velocity), math.copysign(steep * (1.0 + boost * p[i + 5] * power * weak), velocity), i


@njit(cache=True, nogil=True)
def _lugre_step(p, state, velocity, step):
    """``z' = v - k |v| z / g(v)``, exact for a velocity held over the step; the force at its end."""
    rate, _, i = _lugre_rate(p, velocity)
    if rate * step < 1e-12:
        state[0] += velocity * step
    else:
        settled = velocity / rate
        state[0] = settled + (state[0] - settled) * math.exp(-rate * step)
    return p[0] * state[0] + p[i] * (velocity - rate * state[0]) + p[i + 1] * velocity


@njit(cache=True, nogil=True, inline="always")
def lugre_part(p, z, third, velocity, step):
    """Bend and force of LuGre after a step under a velocity that changes: its values at a third and at the end.

    Radau IIA of two stages: order 3, and exact where bristles are so fast that they are settled (L-stable); both stages
    are linear in the bend. Also returns the slopes of the bend for the two velocities, and of the force for the two and
    for the bend at the start.
    """
    one, change_one, _ = _lugre_rate(p, third)
    two, change_two, i = _lugre_rate(p, velocity)
    h = step / 12.0
    a, b = h * one, h * two
    scale = 1.0 / (1.0 + 5.0 * a + 3.0 * b + 24.0 * a * b)
    early = (z * (1.0 + 4.0 * b) + h * (5.0 * third - velocity + 24.0 * b * third)) * scale
    late = (z * (1.0 - 4.0 * a) + 3.0 * h * (3.0 * third + velocity * (1.0 + 8.0 * a))) * scale
    end = 1.0 - change_two * late
    late_third, late_end = 9.0 * h * (1.0 - change_one * early) * scale, 3.0 * h * (1.0 + 8.0 * a) * end * scale
    bend, direct = p[0] - p[i] * two, p[i] * end + p[i + 1]
    force = bend * late + (p[i] + p[i + 1]) * velocity
    return (
        late,
        force,
        late_third,
        late_end,
        bend * late_third,
        bend * late_end + direct,
        bend * (1.0 - 4.0 * a) * scale,
    )


@njit(cache=True, nogil=True)
def _maxwell_slip_step(p, state, velocity, step):
    """Each element sticks (F' = k v) until it reaches its share of s(v), then is drawn to it; sticks on reversal.

    state: force and direction of slip (0: it sticks) of each element.
    """
    side = 1 if velocity >= 0.0 else 6
    total = p[side + 4] * velocity
    s = _stribeck(p[side], p[side + 1], p[side + 2], p[side + 3], velocity)
    sign = math.copysign(1.0, velocity)
    for i in range(state.size // 2):
        stiffness, limit = p[11 + 2 * i], p[12 + 2 * i] * s
        force, slips = state[2 * i], state[2 * i + 1]
        if velocity != 0.0 and slips == sign:
            force = sign * (limit + (sign * force - limit) * math.exp(-p[0] / s * step))
        elif velocity != 0.0:
            slips = 0.0
            force += stiffness * velocity * step
            if sign * force >= limit:
                force, slips = sign * limit, sign
        state[2 * i], state[2 * i + 1] = force, slips
        total += force
    return total


@njit(cache=True, nogil=True)
def friction_step(law, parameters, state, velocity, step):
    """Advance a law with memory by `step` [s] at a velocity [m/s] held over it; return the force [N] at its end.

    `state` is changed: in a method of several stages, give each stage a copy and keep that of the full step.
    """
    if law == LUGRE:
        return _lugre_step(parameters, state, velocity, step)
    return _maxwell_slip_step(parameters, state, velocity, step)


@njit(cache=True, nogil=True)
def friction_history(law, parameters, state, velocity, step, out):
    """Fill out (n,) with the force under a velocity (n,) held over each step."""
    for i in range(velocity.size):
        out[i] = friction_step(law, parameters, state, velocity[i], step)


@njit(cache=True, nogil=True)
def jenkins_force(stiffness, slip, state, displacement):
    """Force [N] of parallel spring-slider elements (stiffness, slip (n,)); state (n,) holds the slider positions."""
    total = 0.0
    for i in range(state.size):
        force = stiffness[i] * (displacement - state[i])
        if abs(force) > slip[i]:
            force = math.copysign(slip[i], force)
            state[i] = displacement - force / stiffness[i]
        total += force
    return total


@njit(cache=True, nogil=True)
def jenkins_history(stiffness, slip, state, displacement, out):
    """Fill out (n,) with the force under a displacement (n,)."""
    for i in range(displacement.size):
        out[i] = jenkins_force(stiffness, slip, state, displacement[i])
