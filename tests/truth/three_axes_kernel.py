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
def _slopes(y, n, inverse, damping, stiffness, slides, friction, feed, steady, drive, push, joint, parts, force, out):
    a = slides.shape[0]
    for i in range(n):
        force[i] = push[i]
        for j in range(n):
            force[i] -= stiffness[i, j] * y[j] + damping[i, j] * y[n + j]
    for i in range(a):
        v = feed[i]
        for j in range(n):
            v += slides[i, j] * y[n + j]
        rate, held = _bristle(y[2 * n + i], v, friction[i])
        out[2 * n + i] = rate
        for j in range(n):
            force[j] += slides[i, j] * (drive[i] - (held - steady[i]))
    if parts.shape[0] > 0:
        speed = 0.0
        for j in range(n):
            speed += joint[j] * y[n + j]
        for i in range(parts.shape[0]):
            carried = y[2 * n + a + i]
            slips = abs(carried) >= parts[i, 1] and carried * speed > 0.0
            out[2 * n + a + i] = 0.0 if slips else parts[i, 0] * speed
            for j in range(n):
                force[j] -= joint[j] * carried
    for i in range(n):
        out[i] = y[n + i]
        rate = 0.0
        for j in range(n):
            rate += inverse[i, j] * force[j]
        out[n + i] = rate


@njit(cache=True)
def run(inverse, damping, stiffness, slides, tool, friction, feed, servo, resolution, joint, elements, pulse, way, h):
    """Return the acceleration of the tool (3, n) and the movement of the slides (a, n) under a force (n,) on it.

    way: what of the force acts along x, y, z (3,); servo: rows of Kp, Ti, Kv, readings of lag; h: step of the
    integrator [s].
    """
    n, a, m = inverse.shape[0], slides.shape[0], elements.shape[0]
    size = 2 * n + a + m
    y, at, k = np.zeros(size), np.zeros(size), np.zeros((4, size))
    force, now, middle, then = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    steady = np.zeros(a)
    for i in range(a):
        if feed[i] != 0.0:
            side = 2 if feed[i] > 0.0 else 6
            f = friction[i]
            level = f[side] + (f[side + 1] - f[side]) * math.exp(-abs(feed[i]) / f[side + 2])
            y[2 * n + i] = math.copysign(level, feed[i]) / f[0]
            steady[i] = math.copysign(level, feed[i]) + f[side + 3] * feed[i]
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
        for i in range(n):
            now[i] = pushed[i] * pulse[t]
            middle[i] = pushed[i] * 0.5 * (pulse[t] + pulse[t + 1])
            then[i] = pushed[i] * pulse[t + 1]
        for stage in range(4):
            push = now if stage == 0 else (then if stage == 3 else middle)
            part = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
            for i in range(size):
                at[i] = y[i] + part * k[stage - 1, i] if stage else y[i]
            _slopes(
                at,
                n,
                inverse,
                damping,
                stiffness,
                slides,
                friction,
                feed,
                steady,
                drive,
                push,
                joint,
                elements,
                force,
                k[stage],
            )
            if stage == 0:
                for i in range(3):
                    for j in range(n):
                        moved[i, t] += tool[i, j] * k[0, n + j]
                for i in range(a):
                    for j in range(n):
                        at_slides[i, t] += slides[i, j] * y[j]
        for i in range(size):
            y[i] += h / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])
        for i in range(m):
            y[2 * n + a + i] = min(max(y[2 * n + a + i], -elements[i, 1]), elements[i, 1])
    return moved, at_slides
