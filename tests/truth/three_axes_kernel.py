"""Three feed axes and what they carry, in time: classical Runge-Kutta between the readings of sampled servos.

Coordinates are deviations from the steady ramp. Bristles (LuGre) and slipping elements are states like others.
"""

import math

import numpy as np
from numba import njit

SUBSTEPS = 4
"""Steps of the integrator between two readings of the servo."""


@njit(cache=True)
def _bristle(z, v, f):
    """Rate of bending, and force, of bristles; f: stiffness, damping, then Coulomb, static, speed, viscous, twice."""
    at = 2 if v >= 0.0 else 6
    level = f[at] + (f[at + 1] - f[at]) * math.exp(-abs(v) / f[at + 2])
    rate = v - f[0] * abs(v) / level * z
    return rate, f[0] * z + f[1] * rate + f[at + 3] * v


@njit(cache=True)
def _slopes(y, n, inverse, damping, stiffness, slides, friction, feed, steady, drive, push, joint, elements, out):
    a = slides.shape[0]
    m = elements.shape[0]
    force = push - stiffness @ y[:n] - damping @ y[n : 2 * n]
    for i in range(a):
        v = feed[i] + slides[i] @ y[n : 2 * n]
        rate, held = _bristle(y[2 * n + i], v, friction[i])
        out[2 * n + i] = rate
        force += slides[i] * (drive[i] - (held - steady[i]))
    if m > 0:
        gap = joint @ y[:n]
        speed = joint @ y[n : 2 * n]
        for i in range(m):
            at = 2 * n + a + i
            carried = y[at]
            slips = abs(carried) >= elements[i, 1] and carried * speed > 0.0
            out[at] = 0.0 if slips else elements[i, 0] * speed
            force -= joint * (carried - 0.0 * gap)
    out[:n] = y[n : 2 * n]
    out[n : 2 * n] = inverse @ force


@njit(cache=True)
def run(inverse, damping, stiffness, slides, tool, friction, feed, servo, resolution, joint, elements, pulse, way, h):
    """Return the acceleration of the tool (3, n) and the movement of the slides (a, n) under a force (n,) on it.

    way: what of the force acts along x, y, z (3,); servo: rows of Kp, Ti, Kv, readings of lag; h: step of the
    integrator [s].
    """
    n, a, m = inverse.shape[0], slides.shape[0], elements.shape[0]
    size = 2 * n + a + m
    y, k1, k2, k3, k4 = np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size), np.zeros(size)
    steady = np.zeros(a)
    for i in range(a):
        if feed[i] != 0.0:
            at = 2 if feed[i] > 0.0 else 6
            f = friction[i]
            level = f[at] + (f[at + 1] - f[at]) * math.exp(-abs(feed[i]) / f[at + 2])
            y[2 * n + i] = math.copysign(level, feed[i]) / f[0]
            steady[i] = math.copysign(level, feed[i]) + f[at + 3] * feed[i]
    drive, integral, before = np.zeros(a), np.zeros(a), np.zeros(a)
    queue = np.zeros((a, 64))
    count = pulse.size
    moved, at_slides = np.zeros((3, count)), np.zeros((a, count))
    pushed = way[0] * tool[0] + way[1] * tool[1] + way[2] * tool[2]
    for t in range(count - 1):
        if t % SUBSTEPS == 0:
            period = SUBSTEPS * h
            for i in range(a):
                absolute = feed[i] * t * h + slides[i] @ y[:n]
                read = absolute if resolution == 0.0 else round(absolute / resolution) * resolution
                read -= feed[i] * t * h
                speed = (read - before[i]) / period
                before[i] = read
                error = -servo[i, 2] * read - speed
                integral[i] += error * period / servo[i, 1]
                for j in range(63, 0, -1):
                    queue[i, j] = queue[i, j - 1]
                queue[i, 0] = servo[i, 0] * (error + integral[i])
                drive[i] = queue[i, int(servo[i, 3])]
        now = pushed * pulse[t]
        middle = pushed * (0.5 * (pulse[t] + pulse[t + 1]))
        then = pushed * pulse[t + 1]
        for i in range(3):
            moved[i, t] = 0.0
        _slopes(y, n, inverse, damping, stiffness, slides, friction, feed, steady, drive, now, joint, elements, k1)
        for i in range(3):
            moved[i, t] = tool[i] @ k1[n : 2 * n]
        for i in range(a):
            at_slides[i, t] = slides[i] @ y[:n]
        _slopes(
            y + 0.5 * h * k1,
            n,
            inverse,
            damping,
            stiffness,
            slides,
            friction,
            feed,
            steady,
            drive,
            middle,
            joint,
            elements,
            k2,
        )
        _slopes(
            y + 0.5 * h * k2,
            n,
            inverse,
            damping,
            stiffness,
            slides,
            friction,
            feed,
            steady,
            drive,
            middle,
            joint,
            elements,
            k3,
        )
        _slopes(
            y + h * k3, n, inverse, damping, stiffness, slides, friction, feed, steady, drive, then, joint, elements, k4
        )
        y = y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        for i in range(m):
            at = 2 * n + a + i
            y[at] = min(max(y[at], -elements[i, 1]), elements[i, 1])
    return moved, at_slides
