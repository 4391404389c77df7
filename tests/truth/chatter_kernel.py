"""Milling integrated step by step of the angle: modes, the surface that every tooth leaves, teeth that leave the cut.

A surface is kept for every angle: the radius to which the work has been cut there. A tooth that reaches beyond it cuts
what stands between; one that does not cuts nothing. So regeneration over several passes and the end of growth come out
by themselves. Steps of the angle are equal; those of time follow the speed.
"""

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def speed_at(t, span, base, drift, sag, sag_time, wave, wave_rate):
    """Speed [rad/s] at a time: a linear drift, a sag under load, a slow wave."""
    share = drift * (t / span - 0.5) - sag * (1.0 - math.exp(-t / sag_time))
    return base * (1.0 + share + wave * math.sin(2.0 * math.pi * wave_rate * t))


@njit(cache=True, nogil=True)
def integrate(spindle, arc, ramps, lags, runout, lag, law, w, zeta, mass, shape, bend, noise, hold, seed, out, clock):
    """Integrate a cut and fill out (n, m + 2) with modal accelerations and forces, clock (n,) with times [s].

    spindle: what `speed_at` takes; arc: entry, exit [rad], steps a turn; ramps: begin and end of the entry, those of
    the exit [s]; lags (Z,): steps by which a tooth is ahead; runout (Z,) [m]; lag: steps from slice to slice; law:
    depth of a slice [m], kt, kr [N/m2], ke [N/m], feed a second [m/s]; bend: drift of the modes over the span [1].
    """
    np.random.seed(seed)  # noqa: NPY002 (that numba compiles)
    m, teeth, slices = w.size, lags.size, runout.shape[1]
    steps = int(arc[2])
    dphi = 2.0 * math.pi / steps
    q, v = np.zeros(m), np.zeros(m)
    e11, e12, e21, e22, b1, b2 = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    surface = np.zeros((slices, steps))
    sines, cosines = np.empty(steps), np.empty(steps)
    for i in range(steps):
        sines[i], cosines[i] = math.sin(i * dphi), math.cos(i * dphi)
    t, dt, factor = 0.0, 0.0, 1.0
    for n in range(out.shape[0]):
        if n % 32 == 0:
            dt = dphi / speed_at(t, spindle[0], spindle[1], spindle[2], spindle[3], spindle[4], spindle[5], spindle[6])
            for r in range(m):
                wr = w[r] * (1.0 + bend[r] * (t / spindle[0] - 0.5))
                d = zeta[r] * wr
                wd = wr * math.sqrt(1.0 - zeta[r] ** 2)
                e, c, s = math.exp(-d * dt), math.cos(wd * dt), math.sin(wd * dt)
                e11[r], e12[r] = e * (c + d / wd * s), e * s / wd
                e21[r], e22[r] = -wr * wr * e12[r], e * (c - d / wd * s)
                b1[r] = (1.0 - e11[r]) / (mass[r] * wr * wr)
                b2[r] = e12[r] / mass[r]
        if n % hold == 0:
            factor = 1.0 + noise * np.random.randn()  # noqa: NPY002
        low = 1.0
        if t > ramps[1]:
            low = -1.0
        elif t > ramps[0]:
            low = 1.0 - (t - ramps[0]) / (ramps[1] - ramps[0])
        high = 2.0
        if t > ramps[3]:
            high = -1.0
        elif t > ramps[2]:
            high = 1.0 - (t - ramps[2]) / (ramps[3] - ramps[2])
        x, y = 0.0, 0.0
        for r in range(m):
            x += shape[r, 0] * q[r]
            y += shape[r, 1] * q[r]
        fx, fy = 0.0, 0.0
        for j in range(teeth):
            for k in range(slices):
                i = (n + lags[j] - k * lag) % steps
                phi = i * dphi
                if phi < arc[0] or phi >= arc[1]:
                    continue
                s, c = sines[i], cosines[i]
                travel = law[4] * t * s
                if s <= low or s >= high:
                    surface[k, i] = travel
                    continue
                reach = runout[j, k] + x * s + y * c + travel
                chip = reach - surface[k, i]
                if chip <= 0.0:
                    continue
                surface[k, i] = reach
                ft = law[0] * (law[1] * chip * factor + law[3])
                fr = law[0] * (law[2] * chip * factor + 0.5 * law[3])
                fx += -ft * c - fr * s
                fy += ft * s - fr * c
        for r in range(m):
            f = shape[r, 0] * fx + shape[r, 1] * fy
            old = v[r]
            new = e11[r] * q[r] + e12[r] * v[r] + b1[r] * f
            v[r] = e21[r] * q[r] + e22[r] * v[r] + b2[r] * f
            q[r] = new
            out[n, r] = (v[r] - old) / dt
        out[n, m], out[n, m + 1] = fx, fy
        clock[n] = t
        t += dt


@njit(cache=True, nogil=True)
def push(omega, arc, lags, slices, lag, depth, kt, kr, w, zeta, mass, shape, out):
    """Integrate the linear equation of a small push (no run-out, teeth never leave the cut); out (n, 2): tip motion."""
    m, teeth = w.size, lags.size
    steps = int(arc[2])
    dphi = 2.0 * math.pi / steps
    dt = dphi / omega
    q, v = np.zeros(m), np.zeros(m)
    e11, e12, e21, e22, b1, b2 = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    for r in range(m):
        d = zeta[r] * w[r]
        wd = w[r] * math.sqrt(1.0 - zeta[r] ** 2)
        e, c, s = math.exp(-d * dt), math.cos(wd * dt), math.sin(wd * dt)
        e11[r], e12[r] = e * (c + d / wd * s), e * s / wd
        e21[r], e22[r] = -w[r] * w[r] * e12[r], e * (c - d / wd * s)
        b1[r], b2[r] = (1.0 - e11[r]) / (mass[r] * w[r] ** 2), e12[r] / mass[r]
        v[r] = w[r] * (1.0 + 0.4 * r)
    surface = np.zeros((slices, steps))
    for n in range(out.shape[0]):
        x, y = 0.0, 0.0
        for r in range(m):
            x += shape[r, 0] * q[r]
            y += shape[r, 1] * q[r]
        fx, fy = 0.0, 0.0
        for j in range(teeth):
            for k in range(slices):
                i = (n + lags[j] - k * lag) % steps
                phi = i * dphi
                if phi < arc[0] or phi >= arc[1]:
                    continue
                s, c = math.sin(phi), math.cos(phi)
                reach = x * s + y * c
                chip = reach - surface[k, i]
                surface[k, i] = reach
                fx += -depth * (kt * chip * c + kr * chip * s)
                fy += depth * (kt * chip * s - kr * chip * c)
        for r in range(m):
            f = shape[r, 0] * fx + shape[r, 1] * fy
            new = e11[r] * q[r] + e12[r] * v[r] + b1[r] * f
            v[r] = e21[r] * q[r] + e22[r] * v[r] + b2[r] * f
            q[r] = new
        out[n, 0], out[n, 1] = x, y
