"""Numba loop of one feed axis in time. Floats and plain arrays only; labels live in `process.axis_simulation`."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from process._friction_kernels import friction_force

CHANNELS = 6
"""Rows that `march` fills: x_t, x_t', x_m, x_m', x_t'', drive force; deviations from the ramp."""


class Axis(NamedTuple):
    """Masses [kg], joint, servo gains (K_p 0: none) and the steady feed [m/s]."""

    tip_mass: float
    moving_mass: float
    stiffness: float
    damping: float
    kp: float
    inverse_ti: float
    kv: float
    feed: float


class Friction(NamedTuple):
    """Law, its parameters, and the force at the steady feed [N], which the integrator holds."""

    law: int
    parameters: Any
    steady: float


@njit(cache=True, nogil=True, inline="always")
def _servo(axis, xm, vm, j):
    """Drive force [N] that the servo asks for now: Eq. (3) for deviations from the ramp."""
    return -axis.kp * (vm + axis.kv * xm + (xm + axis.kv * j) * axis.inverse_ti)


@njit(cache=True, nogil=True, inline="always")
def _motion(axis, friction, xt, vt, xm, vm, drive, force):
    """Return accelerations of tip and carriage, and the power that flows into masses and spring."""
    speed = vt - vm
    joint = axis.stiffness * (xt - xm) + axis.damping * speed
    rub = friction_force(friction.law, friction.parameters, axis.feed + vm) - friction.steady
    power = force * vt + (drive - rub) * vm - axis.damping * speed * speed
    return (force - joint) / axis.tip_mass, (joint + drive - rub) / axis.moving_mass, power


@njit(cache=True, nogil=True, inline="always")
def _past(values, rates, node, weight, step):
    """Cubic Hermite interpolation between ring nodes `node` and `node + 1`; the future of the newest is never asked."""
    size = values.size
    a = node % size
    if weight == 0.0:
        return values[a]
    b = (node + 1) % size
    w, v = weight, 1.0 - weight
    return (
        v * v * (1.0 + 2.0 * w) * values[a]
        + w * w * (1.0 + 2.0 * v) * values[b]
        + step * w * v * (v * rates[a] - w * rates[b])
    )


@njit(cache=True, nogil=True)
def march(axis, friction, delay, step, slowest, force, out):
    """March the axis by classical Runge-Kutta steps; return (steps done, energy error, largest energy).

    force (2 n - 1,) [N] at every half step, out (CHANNELS, n). The delayed drive force comes from a ring of past values
    and rates, cubic between them, so the order stays four; it needs delay >= step, or none. The energy error [J] is the
    largest difference between masses and spring, and the integral of the power (a sixth state). Stops at a metre, and
    where the carriage is slower than `slowest` [m/s] or turns back: there the friction is too steep for this step
    (0: for no speed).
    """
    n = out.shape[1]
    forward = math.copysign(1.0, axis.feed)
    late = delay > 0.0
    lag = delay / step
    ring, rates = np.zeros(math.ceil(lag) + 3), np.zeros(math.ceil(lag) + 3)
    node1, node2, node4 = math.floor(-lag), math.floor(0.5 - lag), math.floor(1.0 - lag)
    weight1, weight2, weight4 = -lag - node1, 0.5 - lag - node2, 1.0 - lag - node4
    xt, vt, xm, vm, j, energy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    worst, largest = 0.0, 0.0
    h, half = step, 0.5 * step
    for i in range(n):
        now = _servo(axis, xm, vm, j)
        drive = _past(ring, rates, i + node1, weight1, step) if late else now
        at1, am1, p1 = _motion(axis, friction, xt, vt, xm, vm, drive, force[2 * i])
        out[0, i], out[1, i], out[2, i], out[3, i], out[4, i], out[5, i] = xt, vt, xm, vm, at1, drive
        held = 0.5 * (axis.tip_mass * vt * vt + axis.moving_mass * vm * vm + axis.stiffness * (xt - xm) * (xt - xm))
        worst, largest = max(worst, abs(held - energy)), max(largest, held)
        if i == n - 1 or not abs(xt) < 1.0 or (slowest > 0.0 and forward * (axis.feed + vm) < slowest):
            return i + 1, worst, largest
        if late:
            ring[i % ring.size] = now
            rates[i % ring.size] = -axis.kp * (am1 + axis.kv * vm + (vm + axis.kv * xm) * axis.inverse_ti)
            drive = _past(ring, rates, i + node2, weight2, step)
        # Stage 2
        xt2, vt2, xm2, vm2, j2 = xt + half * vt, vt + half * at1, xm + half * vm, vm + half * am1, j + half * xm
        if not late:
            drive = _servo(axis, xm2, vm2, j2)
        at2, am2, p2 = _motion(axis, friction, xt2, vt2, xm2, vm2, drive, force[2 * i + 1])
        # Stage 3
        xt3, vt3, xm3, vm3, j3 = xt + half * vt2, vt + half * at2, xm + half * vm2, vm + half * am2, j + half * xm2
        if not late:
            drive = _servo(axis, xm3, vm3, j3)
        at3, am3, p3 = _motion(axis, friction, xt3, vt3, xm3, vm3, drive, force[2 * i + 1])
        # Stage 4
        xt4, vt4, xm4, vm4, j4 = xt + h * vt3, vt + h * at3, xm + h * vm3, vm + h * am3, j + h * xm3
        drive = _past(ring, rates, i + node4, weight4, step) if late else _servo(axis, xm4, vm4, j4)
        at4, am4, p4 = _motion(axis, friction, xt4, vt4, xm4, vm4, drive, force[2 * i + 2])
        sixth = h / 6.0
        j += sixth * (xm + 2.0 * (xm2 + xm3) + xm4)
        xt += sixth * (vt + 2.0 * (vt2 + vt3) + vt4)
        xm += sixth * (vm + 2.0 * (vm2 + vm3) + vm4)
        vt += sixth * (at1 + 2.0 * (at2 + at3) + at4)
        vm += sixth * (am1 + 2.0 * (am2 + am3) + am4)
        energy += sixth * (p1 + 2.0 * (p2 + p3) + p4)
    return n, worst, largest
