"""A slot with four straight teeth on one feed axis, integrated from any history: two masses, P-PI servo, friction.

Two of the four teeth are always in the cut, a right angle apart: along the feed the chip force is ``Krc a`` times the
chip thickness at any angle, without harmonics, and the tangential forces cancel. A tooth that leaves the cut leaves the
surface as it was. Deviations from the ramp; Runge-Kutta of order 4. Shares no code with the packages. SI throughout.
"""

import math

import numpy as np
from numba import njit

MM_MIN = 1.0 / 6e4
GAINS = {
    "K1": (3242.0, 21.2e-3, 23.5), "K2": (6268.0, 10.9e-3, 45.5),
    "K3": (10590.0, 6.5e-3, 76.9), "K4": (18804.0, 3.6e-3, 136.6),
}  # fmt: skip
"""Kp [N s/m], Ti [s], Kv [1/s]: Table 2 of Franco et al. 2024 (JMMP 8/5/207)."""

CARRIAGE, TIP, STIFFNESS, DAMPING = 23.1, 11.3, 1.68e6, 104.0
FRICTION = (44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)
"""Coulomb and static force [N], Stribeck speed [m/s], viscous coefficient [N s/m], steepness at rest [s/m]."""

RADIAL = 351e6
"""Krc [N/m2]."""

_STEP = 2e-5


@njit(cache=True, nogil=True)
def friction_force(p, v):
    """Force of the guideway [N] at a velocity [m/s]."""
    level = p[0] + (p[1] - p[0]) * math.exp(-abs(v) / p[2])
    return level * math.tanh(p[4] * v) + p[3] * v


@njit(cache=True, nogil=True)
def _rates(y, push, gains, friction, feed, out):
    xt, vt, xm, vm, held = y
    joint = STIFFNESS * (xt - xm) + DAMPING * (vt - vm)
    error = vm + gains[2] * xm
    drive = -gains[0] * (error + held / gains[1])
    rub = friction_force(friction, feed + vm) - friction_force(friction, feed)
    out[0], out[1] = vt, (push - joint) / TIP
    out[2], out[3], out[4] = vm, (joint + drive - rub) / CARRIAGE, error


@njit(cache=True, nogil=True)
def _integrate(y, surface, chip, gain, gains, friction, feed, step, record):
    """Move on from state y (5,) with the surface (n,) of the last tooth period; record (m,) is the tip."""
    delay, k = surface.size, np.empty((4, 5))
    for i in range(record.size):
        here, then = surface[i % delay], surface[(i + 1) % delay]
        for stage in range(4):
            share = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
            at = y if stage == 0 else y + share * step * k[stage - 1]
            thickness = max(0.0, chip + at[0] - (here + share * (then - here)))
            _rates(at, -gain * (thickness - chip), gains, friction, feed, k[stage])
        surface[i % delay] = y[0] if chip + y[0] - here > 0.0 else here - chip
        y += step / 6.0 * (k[0] + 2.0 * k[1] + 2.0 * k[2] + k[3])
        record[i] = y[0]


def cut(controller, feed, speed, depth, duration, *, tip, state, feed_per_tooth=2e-4, friction=FRICTION):
    """Return the tip [m] at the steps of a cut, and the steps a tooth period.

    tip: time [s] (before 0) -> displacement in the last tooth period; state: tip, its velocity, carriage, its velocity
    and the integral of the servo at 0. feed [m/s], speed [rpm], depth [m].
    """
    period = 60.0 / (4.0 * speed)
    count = math.ceil(period / _STEP)
    step = period / count
    surface = np.array([tip((i - count) * step) for i in range(count)], dtype=float)
    record = np.empty(math.ceil(duration / step))
    y = np.array(state, dtype=float)
    gains = np.array(GAINS[controller])
    _integrate(y, surface, feed_per_tooth, RADIAL * depth, gains, np.array(friction), feed, step, record)
    return record, count


def envelope(record, count, periods=12):
    """Return half the swing of the tip in consecutive windows of some tooth periods."""
    width = count * periods
    rows = record[: record.size // width * width].reshape(-1, width)
    return 0.5 * np.ptp(rows, axis=1)
