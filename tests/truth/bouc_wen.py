"""The hysteretic oscillator of the nonlinear benchmarks, integrated in time.

``m y'' + c y' + k y + z = u``, ``z' = alpha y' - beta (gamma abs(y') abs(z)^(nu - 1) z + delta y' abs(z)^nu)`` with the
published parameters m = 2 kg, c = 10 N s/m, k = 5e4 N/m, alpha = 5e4 N/m, beta = 1e3 1/m, gamma = 0.8, delta = -1.1,
nu = 1: J. P. Noel, M. Schoukens, Hysteretic benchmark with a dynamic nonlinearity, Workshop on Nonlinear System
Identification Benchmarks, Brussels 2016; the benchmark integrates by Newmark at 15 kHz, this one by Runge and Kutta's
fourth order at 12 kHz. Nothing is imported from the packages.
"""

import numpy as np
from numba import njit

MASS, DAMPING, STIFFNESS = 2.0, 10.0, 5e4
ALPHA, BETA, GAMMA, DELTA = 5e4, 1e3, 0.8, -1.1
RATE, STEPS = 750.0, 16
"""Samples a second that are recorded, and steps of the integration between them."""


@njit(cache=True)
def _motion(force, steps, h):
    out = np.zeros((force.size // steps, 2))
    y = v = z = 0.0
    k = np.zeros((4, 3))
    for i in range(force.size - 1):
        if i % steps == 0:
            out[i // steps, 0] = y
            out[i // steps, 1] = (force[i] - DAMPING * v - STIFFNESS * y - z) / MASS
        for stage in range(4):
            share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            before = max(stage - 1, 0)
            a, b, s = (
                (y, v, z)
                if stage == 0
                else (
                    y + share * h * k[before, 0],
                    v + share * h * k[before, 1],
                    z + share * h * k[before, 2],
                )
            )
            u = force[i] + share * (force[i + 1] - force[i])
            hysteresis = -BETA * (GAMMA * abs(b) * s + DELTA * b * abs(s))
            k[stage, 0] = b
            k[stage, 1] = (u - DAMPING * b - STIFFNESS * a - s) / MASS
            k[stage, 2] = ALPHA * b + hysteresis
        y += h / 6.0 * (k[0, 0] + 2.0 * k[1, 0] + 2.0 * k[2, 0] + k[3, 0])
        v += h / 6.0 * (k[0, 1] + 2.0 * k[1, 1] + 2.0 * k[2, 1] + k[3, 1])
        z += h / 6.0 * (k[0, 2] + 2.0 * k[1, 2] + 2.0 * k[2, 2] + k[3, 2])
    return out


def stepped_sine(amplitude, frequencies, dwell=1.0, settle=0.5):
    """Return time [s], force [N] and acceleration [m/s^2] of sines one after the other, each from rest in phase."""
    fine = RATE * STEPS
    each = int((dwell + settle) * fine)
    t = np.arange(each) / fine
    force = np.concatenate([amplitude * np.sin(2.0 * np.pi * f * t) for f in frequencies])
    motion = _motion(force, STEPS, 1.0 / fine)
    return np.arange(len(motion)) / RATE, force[::STEPS][: len(motion)], motion[:, 1]


def multisine(rms, low, high, periods, seed, length=4096):
    """Return time [s], force [N] and acceleration [m/s^2] of a random-phase multisine that repeats itself."""
    rng, fine = np.random.default_rng(seed), RATE * STEPS
    n = length * STEPS
    spectrum = np.zeros(n // 2 + 1, dtype=complex)
    lines = np.arange(int(low * length / RATE), int(high * length / RATE))
    spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size))
    one = np.fft.irfft(spectrum, n)
    force = np.tile(rms * one / one.std(), periods)
    motion = _motion(np.append(force, force[0]), STEPS, 1.0 / fine)
    return np.arange(len(motion)) / RATE, force[::STEPS][: len(motion)], motion[:, 1]
