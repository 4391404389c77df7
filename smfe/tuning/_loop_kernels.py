"""The loop over candidates and frequencies, compiled; `smfe.tuning.loops` says what is computed."""

from __future__ import annotations

import cmath

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def _inverse(m, out):
    """Fill `out` with the inverse of a matrix of one to three rows; return its determinant."""
    n = m.shape[0]
    if n == 1:
        out[0, 0] = 1.0 / m[0, 0]
        return m[0, 0]
    if n == 2:
        whole = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0]
        out[0, 0], out[1, 1] = m[1, 1] / whole, m[0, 0] / whole
        out[0, 1], out[1, 0] = -m[0, 1] / whole, -m[1, 0] / whole
        return whole
    for i in range(3):
        for j in range(3):
            a, b, c, d = (j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3
            out[i, j] = m[a, c] * m[b, d] - m[a, d] * m[b, c]
    whole = m[0, 0] * out[0, 0] + m[0, 1] * out[1, 0] + m[0, 2] * out[2, 0]
    for i in range(3):
        for j in range(3):
            out[i, j] /= whole
    return whole


@njit(cache=True, nogil=True)
def close(s, lag, held, reach, back, base, gains):
    """Close the loops of c candidates at f frequencies for a axes and a tool matrix of r rows.

    Shapes: s (f,), lag (f, a), held (f, r, r), reach (f, r, a), back (f, a, r), base (f, a, a), gains (c, a, 3).
    Returns the tool matrix (c, f, r, r), five loops (5, c, a, f), turns of phase (c, 1 + a) [rad].
    """
    c, f, a, r = gains.shape[0], s.size, lag.shape[1], held.shape[1]
    tool = np.empty((c, f, r, r), dtype=np.complex128)
    loops = np.empty((5, c, a, f), dtype=np.complex128)
    turned = np.zeros((c, 1 + a))
    matrix, inverse = np.empty((a, a), dtype=np.complex128), np.empty((a, a), dtype=np.complex128)
    v, g = np.empty(a, dtype=np.complex128), np.empty(a, dtype=np.complex128)
    before, now = np.ones(1 + a, dtype=np.complex128), np.ones(1 + a, dtype=np.complex128)
    for i in range(c):
        before[:] = 1.0
        for k in range(f):
            for x in range(a):
                v[x] = gains[i, x, 0] * (s[k] + 1.0 / gains[i, x, 1]) * lag[k, x]
                g[x] = v[x] * (s[k] + gains[i, x, 2]) / s[k]
                for y in range(a):
                    matrix[x, y] = base[k, x, y]
                matrix[x, x] += g[x]
            whole = _inverse(matrix, inverse)
            for p in range(r):
                for q in range(r):
                    total = held[k, p, q]
                    for x in range(a):
                        for y in range(a):
                            total += reach[k, p, x] * inverse[x, y] * back[k, y, q]
                    tool[i, k, p, q] = total
            # An integrator an axis: multiplied away, so that the phase begins at zero. The size does not count.
            now[0] = whole / abs(whole) * 1j**a
            for x in range(a):
                own = inverse[x, x]
                alone = 1.0 / own - g[x]
                velocity = alone + v[x]
                loops[0, i, x, k] = v[x] / velocity
                loops[1, i, x, k] = v[x] * gains[i, x, 2] / s[k] * own
                loops[2, i, x, k] = v[x] * own
                loops[3, i, x, k] = v[x] / alone
                loops[4, i, x, k] = g[x] / alone
                one = whole * own * velocity
                now[1 + x] = one / abs(one) * 1j ** (a - 1)
            for x in range(1 + a):
                turned[i, x] += cmath.phase(now[x] / before[x])
                before[x] = now[x]
    return tool, loops, turned
