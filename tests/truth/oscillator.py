"""One mass with cubic damping, cubic stiffness and dry friction, hit or driven by a sine; no code of the package."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True)
def motion(force, dt, mass, stiffness, damping, cubic_damping, cubic_stiffness, friction):
    """Return the displacement under a force [N] sampled at half steps, by Runge and Kutta's fourth order."""
    n = (force.size - 1) // 2
    out = np.zeros(n + 1)
    x = v = 0.0

    def acceleration(f, x, v):
        dry = friction * math.tanh(2000.0 * v)
        return (f - damping * v - cubic_damping * v**3 - stiffness * x - cubic_stiffness * x**3 - dry) / mass

    for i in range(n):
        f0, f1, f2 = force[2 * i], force[2 * i + 1], force[2 * i + 2]
        a0 = acceleration(f0, x, v)
        v1 = v + 0.5 * dt * a0
        a1 = acceleration(f1, x + 0.5 * dt * v, v1)
        v2 = v + 0.5 * dt * a1
        a2 = acceleration(f1, x + 0.5 * dt * v1, v2)
        v3 = v + dt * a2
        a3 = acceleration(f2, x + dt * v2, v3)
        x += dt / 6.0 * (v + 2.0 * v1 + 2.0 * v2 + v3)
        v += dt / 6.0 * (a0 + 2.0 * a1 + 2.0 * a2 + a3)
        out[i + 1] = x
    return out


def half_sine(peak, duration, time):
    """Return the force of a hit that begins at time 0 [N]."""
    return np.where((time >= 0.0) & (time < duration), peak * np.sin(np.pi * time / duration), 0.0)


def hit(peak, duration, seconds, dt, **machine):
    """Return frequency [Hz], displacement over force of one hit, and the spectrum of its force [N s]."""
    half = np.arange(2 * round(seconds / dt) + 1) * 0.5 * dt
    force = half_sine(peak, duration, half)
    moved = np.fft.rfft(motion(force, dt, **machine)[:-1]) * dt
    pulse = np.fft.rfft(force[:-1:2]) * dt
    return np.fft.rfftfreq(round(seconds / dt), dt), moved / pulse, np.abs(pulse)


def driven(amplitude, frequency, dt, periods, **machine):
    """Return the largest compliance over frequencies driven by a sine of an amplitude [N], periodic parts fitted."""
    best = 0.0
    for f in frequency:
        half = np.arange(2 * round(periods / f / dt) + 1) * 0.5 * dt
        x = motion(amplitude * np.sin(2 * np.pi * f * half), dt, **machine)
        last = round(10.0 / f / dt)
        t = half[::2][-last:]
        wave = np.exp(-2j * np.pi * f * t)
        best = max(best, 2.0 * abs(np.mean(x[-last:] * wave)) / amplitude)
    return best
