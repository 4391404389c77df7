"""Compiled harmonic balance of several nonlinear elements: alternating time and frequency, Newton, Hill's determinant.

The motion of element p is ``bias + gain u(t)``, ``u(t) = Re sum_k u_k exp(j k w t)``, in m/s (friction) or m (joints,
gain 1/w). Its force less ``reference`` times its motion enters ``u_pk + sum_q A_pqk f_qk = d_p delta_k1``.
Real layout of K complex coefficients: K real parts, then K imaginary parts.

Compiled at the first call and cached, for the tuples `Elements` and `Grid` of float64 and int64 arrays and for
complex128 arrays, C-contiguous: `sweep`, `newton`, `element_forces`, `element_slopes`, `hill_turns` and `crossings`,
with what they call, in 36 s of CPU.
"""

import math
from collections import namedtuple

import numpy as np
from numba import njit

from process.friction._kernels import ANDERSSON, friction_force, friction_slope, jenkins_force

# Codes beside those of the friction laws without memory.
CUBIC = 20  # stiffness, cubic
GAP = 21  # stiffness, gap
SLIDERS = 22  # parallel spring-slider elements

# Per element (P, ...): code; parameters (12); steepness; stiffness and slip (E) of its sliders, unused ones zero; bias;
# whether its motion is a displacement; reference.
Elements = namedtuple(
    "Elements", ["code", "parameters", "steepness", "stiffness", "slip", "bias", "displacement", "reference"]
)
# Harmonics (K,), a multiple of `step` apart; panels of `nodes` over `span` of a period, the sum of weights is 1; cosine
# and sine of the harmonics (N, K) and of the lags 0, step, 2 step ... (N, L) at the nodes.
Grid = namedtuple(
    "Grid",
    ["orders", "step", "span", "nodes", "share", "panels", "cosine", "sine", "lag_cosine", "lag_sine"],
)

_RISE = 4.0  # of the argument of tanh in a panel
_SATURATED = 8.0
_DEEPEST = 14
_TOLERANCE = 3e-6


@njit(cache=True, nogil=True)
def _force(code, p, x):
    if code == CUBIC:
        return p[0] * x + p[1] * x * x * x
    if code == GAP:
        return p[0] * math.copysign(max(abs(x) - p[1], 0.0), x)
    return friction_force(code, p, x)


@njit(cache=True, nogil=True)
def _force_and_slope(code, p, x):
    if code == CUBIC:
        return _force(code, p, x), p[0] + 3.0 * p[1] * x * x
    if code == GAP:
        return _force(code, p, x), p[0] if abs(x) > p[1] else 0.0
    if code != ANDERSSON:
        return friction_force(code, p, x), friction_slope(code, p, x)
    # The same exponentials serve both; x is rarely where the smooth sign is not one.
    i = 0 if x >= 0.0 else 6
    ratio = abs(x) / p[i + 2]
    power = ratio if p[i + 5] == 1.0 else ratio ** p[i + 5]
    boost = (p[i + 1] - p[i]) * math.exp(-power)
    fall = 0.0 if ratio == 0.0 else -p[i + 5] * power / x
    turn = p[i + 4] * x
    sign = math.tanh(turn) if abs(turn) < 20.0 else math.copysign(1.0, x)
    force = (p[i] + boost) * sign + p[i + 3] * x
    return force, (p[i] + boost) * p[i + 4] * (1.0 - sign * sign) + boost * fall * sign + p[i + 3]


@njit(cache=True, nogil=True)
def _rough(steepness, low, high):
    """Return whether the passage through rest falls into a panel in which x runs from low to high."""
    near = 0.0 if low < 0.0 < high else min(abs(low), abs(high))
    return steepness * (high - low) > _RISE and steepness * near < _SATURATED


@njit(cache=True, nogil=True, fastmath={"reassoc", "contract"})
def _sum(real, imaginary, cosine, sine):
    total = 0.0
    for k in range(real.size):
        total += real[k] * cosine[k] - imaginary[k] * sine[k]
    return total


@njit(cache=True, nogil=True)
def _powers(c, s, first, step, cosine, sine):
    """Fill with cosine and sine of (first + i step) t for c = cos t, s = sin t; first 0 or 1, step 1 or 2."""
    dc, ds = (c, s) if step == 1 else (c * c - s * s, 2.0 * c * s)
    if first == 0:
        c, s = 1.0, 0.0
    for i in range(cosine.size):
        cosine[i], sine[i] = c, s
        c, s = c * dc - s * ds, c * ds + s * dc


@njit(cache=True, nogil=True)
def _add(code, p, x, weight, cosine, sine, lag_cosine, lag_sine, force, slope):
    f, g = _force_and_slope(code, p, x)
    f, g = weight * f, weight * g
    n, m = cosine.size, slope.size // 2
    for k in range(n):
        force[k] += f * cosine[k]
        force[n + k] -= f * sine[k]
    for k in range(m):
        slope[k] += g * lag_cosine[k]
        slope[m + k] -= g * lag_sine[k]


@njit(cache=True, nogil=True)
def _refined(code, p, bias, gain, steepness, u, v, grid, first, last, force, slope):
    """Integrate from `first` to `last` [rad] on panels halved until they resolve the passage through rest."""
    q, total = grid.nodes.size, 2.0 * math.pi * grid.span
    begin, end = np.empty(2 * _DEEPEST), np.empty(2 * _DEEPEST)
    x, cosine, sine = np.empty(q), np.empty((q, u.size)), np.empty((q, u.size))
    c, s = np.empty(q), np.empty(q)
    lag_cosine, lag_sine = np.empty(slope.size // 2), np.empty(slope.size // 2)
    begin[0], end[0], open_ = first, last, 1
    shortest = (last - first) * 0.5**_DEEPEST
    while open_:
        open_ -= 1
        a, b = begin[open_], end[open_]
        low, high = math.inf, -math.inf
        for j in range(q):
            t = a + (b - a) * grid.nodes[j]
            c[j], s[j] = math.cos(t), math.sin(t)
            _powers(c[j], s[j], grid.orders[0], grid.step, cosine[j], sine[j])
            x[j] = bias + gain * _sum(u, v, cosine[j], sine[j])
            low, high = min(low, x[j]), max(high, x[j])
        if _rough(steepness, low, high) and b - a > shortest:
            middle = 0.5 * (a + b)
            begin[open_], end[open_], begin[open_ + 1], end[open_ + 1] = middle, b, a, middle
            open_ += 2
            continue
        for j in range(q):
            _powers(c[j], s[j], 0, grid.step, lag_cosine, lag_sine)
            weight = grid.share[j] * (b - a) / total
            _add(code, p, x[j], weight, cosine[j], sine[j], lag_cosine, lag_sine, force, slope)


@njit(cache=True, nogil=True)
def memoryless(code, p, bias, gain, steepness, u, v, grid, force, slope):
    """Mean of force and slope times ``exp(-j k t)``: force (2 K,) at the harmonics, slope (2 L,) at the lags.

    A slope of no length is not computed.
    """
    force[:], slope[:] = 0.0, 0.0
    q = grid.nodes.size
    width = 2.0 * math.pi * grid.span / grid.panels
    x = np.empty(q)
    for panel in range(grid.panels):
        low, high = math.inf, -math.inf
        for j in range(q):
            i = panel * q + j
            x[j] = bias + gain * _sum(u, v, grid.cosine[i], grid.sine[i])
            low, high = min(low, x[j]), max(high, x[j])
        if _rough(steepness, low, high):
            first = panel * width
            _refined(code, p, bias, gain, steepness, u, v, grid, first, first + 0.5 * width, force, slope)
            _refined(code, p, bias, gain, steepness, u, v, grid, first + 0.5 * width, first + width, force, slope)
            continue
        for j in range(q):
            i = panel * q + j
            weight = grid.share[j] / grid.panels
            _add(
                code, p, x[j], weight, grid.cosine[i], grid.sine[i], grid.lag_cosine[i], grid.lag_sine[i], force, slope
            )


@njit(cache=True, nogil=True)
def _toeplitz_and_hankel(slope, grid, gain, out):
    """``df_k = c_k/2 sum_m g_{k-m} du_m + g_{k+m} conj(du_m)``; c is 2, for the mean 1."""
    n, lags = grid.orders.size, slope.size // 2
    for k in range(n):
        c = 0.5 * gain if grid.orders[k] == 0 else gain
        for m in range(n):
            lag = (grid.orders[k] - grid.orders[m]) // grid.step
            ar, ai = slope[abs(lag)], slope[lags + abs(lag)]
            if lag < 0:
                ai = -ai
            both = (grid.orders[k] + grid.orders[m]) // grid.step
            br, bi = slope[both], slope[lags + both]
            out[k, m], out[k, n + m] = c * (ar + br), c * (bi - ai)
            out[n + k, m], out[n + k, n + m] = c * (ai + bi), c * (ar - br)


@njit(cache=True, nogil=True)
def _slide(stiffness, slip, state, x, i, way, where, sign, last):
    """Move the sliders to x at node i; return the force and the stiffness of what sticks.

    last (N,) receives, for each node, the stiffness of what has stuck since then.
    """
    before = state.copy()
    total = jenkins_force(stiffness, slip, state, x)
    sticking = 0.0
    last[:] = 0.0
    for e in range(stiffness.size):
        if state[e] != before[e]:
            where[e], sign[e] = i, way
            continue
        sticking += stiffness[e]
        if where[e] >= 0:
            last[where[e]] += sign[e] * stiffness[e]
    return total, sticking


@njit(cache=True, nogil=True)
def _sliders(stiffness, slip, bias, gain, u, v, grid, force, tangent, slope):
    """Mean force (2 K,), its derivative (2 K, 2 K) and the stiffness of what sticks at the lags (2 L,), settled.

    An element that sticks remembers where it slipped last: ``df = k (dx(t) - dx(t_last))``. Over half a period the
    motion comes back with the opposite sign.
    """
    n, nodes, lags = u.size, grid.cosine.shape[0], slope.size // 2
    state, sign = np.zeros(stiffness.size), np.ones(stiffness.size)
    where = np.full(stiffness.size, -1)
    basis, row, last = np.empty((nodes, 2 * n)), np.empty(2 * n), np.zeros(nodes)
    basis[:, :n], basis[:, n:] = grid.cosine, -grid.sine
    weight_of = np.full(2 * n, 2.0)
    if grid.orders[0] == 0:
        weight_of[0], weight_of[n] = 1.0, 1.0
    force[:], tangent[:, :], slope[:] = 0.0, 0.0, 0.0
    turns = 2 if grid.span == 1.0 else 4
    for turn in range(turns):
        way = 1.0 if grid.span == 1.0 or (turns - 1 - turn) % 2 == 0 else -1.0
        for i in range(nodes):
            x = way * (bias + gain * _sum(u, v, grid.cosine[i], grid.sine[i]))
            total, sticking = _slide(stiffness, slip, state, x, i, way, where, sign, last)
            if turn < turns - 1:
                continue
            weight = grid.share[i % grid.nodes.size] / grid.panels
            row[:] = sticking * basis[i]
            for m in np.flatnonzero(last):
                row -= last[m] * basis[m]
            force += weight * total * basis[i]
            tangent += np.outer(gain * weight * weight_of * basis[i], row)
            slope[:lags] += weight * sticking * grid.lag_cosine[i]
            slope[lags:] -= weight * sticking * grid.lag_sine[i]


@njit(cache=True, nogil=True)
def forces(elements, gain, u, grid, force, tangent, slope):
    """Fill force (P, K) complex, tangent (P, 2 K, 2 K) and slope (P, 2 L) under u (P, K)."""
    n = grid.orders.size
    mean = np.empty(2 * n)
    for p in range(u.shape[0]):
        real, imaginary = u[p].real.copy(), u[p].imag.copy()
        if elements.code[p] == SLIDERS:
            _sliders(
                elements.stiffness[p],
                elements.slip[p],
                elements.bias[p],
                gain[p],
                real,
                imaginary,
                grid,
                mean,
                tangent[p],
                slope[p],
            )
        else:
            memoryless(
                elements.code[p],
                elements.parameters[p],
                elements.bias[p],
                gain[p],
                elements.steepness[p],
                real,
                imaginary,
                grid,
                mean,
                slope[p],
            )
            _toeplitz_and_hankel(slope[p], grid, gain[p], tangent[p])
        slope[p, 0] -= elements.reference[p]
        for k in range(n):
            c = 1.0 if grid.orders[k] == 0 else 2.0
            force[p, k] = c * complex(mean[k], mean[n + k]) - elements.reference[p] * gain[p] * u[p, k]
            tangent[p, k, k] -= elements.reference[p] * gain[p]
            tangent[p, n + k, n + k] -= elements.reference[p] * gain[p]


@njit(cache=True, nogil=True)
def _residual(u, force, admittance, drive, first, out):
    size = 0.0
    for p in range(u.shape[0]):
        for k in range(u.shape[1]):
            r = u[p, k]
            for q in range(u.shape[0]):
                r += admittance[k, p, q] * force[q, k]
            if k == first:
                r -= drive[p]
            out[p, k] = r
            size += r.real * r.real + r.imag * r.imag
    return math.sqrt(size)


@njit(cache=True, nogil=True)
def _step(residual, tangent, admittance):
    """Newton step (P, K) complex."""
    elements, n = residual.shape
    jacobian = np.zeros((2 * n * elements, 2 * n * elements))
    right = np.empty(2 * n * elements)
    for p in range(elements):
        for k in range(n):
            i = 2 * n * p + k
            jacobian[i, i], jacobian[i + n, i + n] = 1.0, 1.0
            right[i], right[i + n] = -residual[p, k].real, -residual[p, k].imag
            for q in range(elements):
                a = admittance[k, p, q]
                for m in range(2 * n):
                    re, im = tangent[q, k, m], tangent[q, n + k, m]
                    jacobian[i, 2 * n * q + m] += a.real * re - a.imag * im
                    jacobian[i + n, 2 * n * q + m] += a.real * im + a.imag * re
    d = np.linalg.solve(jacobian, right)
    out = np.empty((elements, n), dtype=np.complex128)
    for p in range(elements):
        for k in range(n):
            out[p, k] = complex(d[2 * n * p + k], d[2 * n * p + n + k])
    return out


@njit(cache=True, nogil=True)
def newton(elements, gain, admittance, drive, grid, u, steps):
    """Solve from u (P, K) by Newton with halving of the step; u is changed; return whether it converged."""
    n = grid.orders.size
    first = 1 if grid.orders[0] == 0 else 0
    lags = grid.lag_cosine.shape[1]
    force, r = np.empty_like(u), np.empty_like(u)
    tangent, slope = np.empty((u.shape[0], 2 * n, 2 * n)), np.empty((u.shape[0], 2 * lags))
    forces(elements, gain, u, grid, force, tangent, slope)
    size = _residual(u, force, admittance, drive, first, r)
    limit = _TOLERANCE * np.abs(drive).max()
    for _ in range(steps):
        if size <= limit:
            return True
        if not math.isfinite(size):
            return False
        d = _step(r, tangent, admittance)
        share = 1.0
        while share > 1e-3:
            new = u + share * d
            forces(elements, gain, new, grid, force, tangent, slope)
            now = _residual(new, force, admittance, drive, first, r)
            if now < (1.0 - 0.1 * share) * size or now <= limit:
                break
            share *= 0.5
        else:
            return size <= 30.0 * limit
        u[:] = new
        size = now
    return size <= limit


@njit(cache=True, nogil=True)
def gains(elements, angular):
    """Return the factors from u [m/s] to the motion of the elements: 1, or 1/w for a displacement."""
    out = np.ones(elements.code.size)
    for p in range(out.size):
        if elements.displacement[p]:
            out[p] = 1.0 / angular
    return out


@njit(cache=True, nogil=True)
def sweep(elements, angular, admittance, drive, grid, start, chain, steps, out, good):
    """Solve at each frequency (n,) from the last solution (if `chain`), else from start (n, P, K)."""
    for i in range(angular.size):
        gain = gains(elements, angular[i])
        good[i] = False
        if chain and i > 0 and good[i - 1]:
            u = out[i - 1].copy()
            good[i] = newton(elements, gain, admittance[i], drive[i], grid, u, steps)
            out[i] = u
        if not good[i]:
            u = start[i].copy()
            good[i] = newton(elements, gain, admittance[i], drive[i], grid, u, steps)
            out[i] = u


@njit(cache=True, nogil=True)
def element_forces(elements, angular, u, grid, out):
    """Fill out (n, P, K) with the harmonics of the forces under u (n, P, K)."""
    n, lags = grid.orders.size, grid.lag_cosine.shape[1]
    mean, none, slope = np.empty(2 * n), np.empty(0), np.empty(2 * lags)
    tangent = np.empty((2 * n, 2 * n))
    for i in range(angular.size):
        gain = gains(elements, angular[i])
        for p in range(u.shape[1]):
            real, imaginary = u[i, p].real.copy(), u[i, p].imag.copy()
            if elements.code[p] == SLIDERS:
                _sliders(
                    elements.stiffness[p],
                    elements.slip[p],
                    elements.bias[p],
                    gain[p],
                    real,
                    imaginary,
                    grid,
                    mean,
                    tangent,
                    slope,
                )
            else:
                memoryless(
                    elements.code[p],
                    elements.parameters[p],
                    elements.bias[p],
                    gain[p],
                    elements.steepness[p],
                    real,
                    imaginary,
                    grid,
                    mean,
                    none,
                )
            for k in range(n):
                c = 1.0 if grid.orders[k] == 0 else 2.0
                out[i, p, k] = c * complex(mean[k], mean[n + k]) - elements.reference[p] * gain[p] * u[i, p, k]


@njit(cache=True, nogil=True)
def crossings(mobility, drive, amplitude, coefficient, position, count):
    """Solve ``V |1 + Y c(V)| = drive`` on a rising grid of V (m,) for each Y (n,); c (m,) is complex.

    position (n,) receives the place of the first solution in grid steps, linear in log V (-1: none);
    count (n,) the number of solutions.
    """
    for i in range(mobility.size):
        position[i], count[i] = -1.0, 0
        yr, yi, target = mobility[i].real, mobility[i].imag, drive[i] * drive[i]
        last = -1.0
        for k in range(amplitude.size):
            cr, ci = coefficient[k].real, coefficient[k].imag
            a, b = 1.0 + yr * cr - yi * ci, yr * ci + yi * cr
            now = amplitude[k] * amplitude[k] * (a * a + b * b) / target - 1.0
            if k == 0 and now > 0.0:  # below the table, where c is that of its first point
                position[i], count[i] = 0.0, 1
            elif k > 0 and (now > 0.0) != (last > 0.0):
                if count[i] == 0:
                    low, high = math.log1p(max(last, -1.0 + 1e-15)), math.log1p(max(now, -1.0 + 1e-15))
                    position[i] = k - 1 + low / (low - high)
                count[i] += 1
            last = now


@njit(cache=True, nogil=True)
def _direction(matrix):
    """Determinant over its magnitude, by elimination with pivots; the matrix is changed."""
    n, out = matrix.shape[0], 1.0 + 0.0j
    for c in range(n):
        pivot, best = c, -1.0
        for r in range(c, n):
            size = abs(matrix[r, c].real) + abs(matrix[r, c].imag)
            if size > best:
                pivot, best = r, size
        if best == 0.0:
            return 0.0j
        if pivot != c:
            out = -out
            for k in range(c, n):
                matrix[c, k], matrix[pivot, k] = matrix[pivot, k], matrix[c, k]
        out *= matrix[c, c] / abs(matrix[c, c])
        inverse = 1.0 / matrix[c, c]
        for r in range(c + 1, n):
            factor = matrix[r, c] * inverse
            if factor != 0.0:
                for k in range(c + 1, n):
                    matrix[r, k] -= factor * matrix[c, k]
    return out


@njit(cache=True, nogil=True)
def _hill(share, f, slope, step, order, frequency, admittance):
    """Direction of det D at the disturbance ``share f``; admittance (m, P, P) tabulated over frequency (m,)."""
    elements, lags, n = slope.shape[0], slope.shape[1] // 2, 2 * order + 1
    matrix = np.zeros((elements * n, elements * n), dtype=np.complex128)
    for k in range(n):
        at = (share + k - order) * f
        size = abs(at)
        i = min(max(np.searchsorted(frequency, size) - 1, 0), frequency.size - 2)
        part = (size - frequency[i]) / (frequency[i + 1] - frequency[i])
        for p in range(elements):
            for q in range(elements):
                a = admittance[i, p, q] + part * (admittance[i + 1, p, q] - admittance[i, p, q])
                if at < 0.0:
                    a = a.conjugate()
                for m in range(n):
                    lag = k - m
                    if lag % step == 0 and abs(lag) // step < lags:
                        g = complex(slope[q, abs(lag) // step], slope[q, lags + abs(lag) // step])
                        matrix[p * n + k, q * n + m] += a * (g if lag >= 0 else g.conjugate())
            matrix[p * n + k, p * n + k] += 1.0
    return _direction(matrix)


@njit(cache=True, nogil=True)
def element_slopes(elements, angular, u, grid, slope):
    """Fill slope (n, P, 2 lags) with the Fourier coefficients of the local slope of each element: real, imaginary."""
    n = grid.orders.size
    force = np.empty(u.shape[1:], dtype=np.complex128)
    tangent = np.empty((u.shape[1], 2 * n, 2 * n))
    for i in range(angular.size):
        forces(elements, gains(elements, angular[i]), u[i], grid, force, tangent, slope[i])


@njit(cache=True, nogil=True)
def hill_turns(f, slope, step, order, frequency, admittance):
    """Return the turns of det D about zero while the disturbance runs over one interval of f.

    Real signals: half the interval does; its ends, where det D is real, are approached. Steps of phase are halved until
    they are below 0.6 rad.
    """
    begin, end = np.empty(64), np.empty(64)
    first, last = np.empty(64, dtype=np.complex128), np.empty(64, dtype=np.complex128)
    edge = np.linspace(1e-3, 0.5, 9)
    turn, left = 0.0, 0.0j
    for e in range(edge.size):
        here = _hill(edge[e], f, slope, step, order, frequency, admittance)
        if e == 0 or e == edge.size - 1:
            real = here if here.real >= 0.0 else -here
            turn += math.atan2(real.imag, real.real) * (1.0 if e == 0 else -1.0)
        if e > 0:
            begin[0], end[0], first[0], last[0], open_ = edge[e - 1], edge[e], left, here, 1
            while open_:
                open_ -= 1
                a, b, fa, fb = begin[open_], end[open_], first[open_], last[open_]
                ratio = fb * fa.conjugate()
                phase = math.atan2(ratio.imag, ratio.real)
                if abs(phase) < 0.6 or b - a < 1e-5 or open_ > 60:
                    turn += phase
                    continue
                middle = 0.5 * (a + b)
                fm = _hill(middle, f, slope, step, order, frequency, admittance)
                begin[open_], end[open_], first[open_], last[open_] = a, middle, fa, fm
                begin[open_ + 1], end[open_ + 1], first[open_ + 1], last[open_ + 1] = middle, b, fm, fb
                open_ += 2
        left = here
    return turn / math.pi
