"""Numba loops of the converged methods. Floats and plain arrays only; labels live in their modules.

Semi-discretisation: one period of the cut is a row of elements with Gauss nodes. A *contact* is one engaged tooth at
one node; its scalar is the chip ``v^T r`` that the tool's displacement r adds there. Nothing else is remembered from
pass to pass. Multi-frequency: the matrices of the loop, and their determinants.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit


class System(NamedTuple):
    """The cut at one spindle speed, in the modal coordinates z of the machine.

    Over element e with chips f a unit depth: ``x = E z + G f`` at its contacts and ``z <- gap (decay z + H^T f)``.
    Shapes, with n elements, m contacts, N states and p nodes an element: offset (n + 1,), gain (n, c, c), start (m, N),
    end (m, N), decay and gap (n, N), turn (N,), source (m,), weight (m, p), wrap (m,).
    """

    offset: Any
    gain: Any
    start: Any
    end: Any
    decay: Any
    gap: Any
    turn: Any
    source: Any
    weight: Any
    wrap: Any


@njit(cache=True, nogil=True, inline="always")
def _left_behind(system, i, x, before):
    """Surface that the tooth before has left at contact i: from `x`, or from `before` one period earlier."""
    total = 0.0j
    for k in range(system.weight.shape[1]):
        j = system.source[i] + k
        total += system.weight[i, k] * (before[j] if system.wrap[i] else x[j])
    return total


@njit(cache=True, nogil=True)
def _pass(system, f, z, x):
    """Add to x (m,) what state z (N,) and chips f (m,) do over one period; z is moved to its end."""
    for e in range(system.decay.shape[0]):
        low, high = system.offset[e], system.offset[e + 1]
        for i in range(low, high):
            total = 0.0j
            for m in range(z.size):
                total += system.start[i, m] * z[m]
            for j in range(low, high):
                total += system.gain[e, i - low, j - low] * f[j]
            x[i] += total
        _leave_element(system, e, f, z)


@njit(cache=True, nogil=True)
def chip_change(system, multiplier, x):
    """Return what the chips x (m,) are less the surface left behind, when a period multiplies all by `multiplier`."""
    f = np.empty_like(x)
    before = np.empty_like(x)
    for i in range(x.size):
        before[i] = x[i] / multiplier
    for i in range(x.size):
        f[i] = x[i] - _left_behind(system, i, x, before)
    return f


@njit(cache=True, nogil=True)
def apply_crossing(system, multiplier, x):
    """Apply the operator whose eigenvalues are 1/depth when `multiplier` is a Floquet multiplier, to x (m,)."""
    f = chip_change(system, multiplier, x)
    out = np.zeros_like(x)
    z = np.zeros(system.turn.size, dtype=np.complex128)
    _pass(system, f, z, out)
    for m in range(z.size):
        z[m] /= multiplier - system.turn[m]
    for i in range(x.size):
        f[i] = 0.0
    _pass(system, f, z, out)
    return out


@njit(cache=True, nogil=True)
def crossing_parts(system):
    """Return (G, S, H, A, B): chips ``x = G f + S z``, gain of the state ``H f`` and ``f = x - A x - B x/multiplier``.

    Shapes (m, m), (m, N), (N, m), (m, m), (m, m): f in one period from rest, z at its start.
    """
    size, states = system.source.size, system.turn.size
    response = np.zeros((size, size), dtype=np.complex128)
    free = np.zeros((size, states), dtype=np.complex128)
    gained = np.zeros((states, size), dtype=np.complex128)
    left = np.zeros((2, size, size), dtype=np.complex128)
    decayed = np.ones(states, dtype=np.complex128)
    for e in range(system.decay.shape[0]):
        low, high = system.offset[e], system.offset[e + 1]
        for i in range(low, high):
            for m in range(states):
                free[i, m] = system.start[i, m] * decayed[m]
                for j in range(low):
                    response[i, j] += system.start[i, m] * gained[m, j]
            for j in range(low, high):
                response[i, j] += system.gain[e, i - low, j - low]
            for k in range(system.weight.shape[1]):
                left[1 if system.wrap[i] else 0, i, system.source[i] + k] += system.weight[i, k]
        for m in range(states):
            turn = system.gap[e, m] * system.decay[e, m]
            decayed[m] *= turn
            for j in range(low):
                gained[m, j] *= turn
            for j in range(low, high):
                gained[m, j] = system.gap[e, m] * system.end[j, m]
    return response, free, gained, left[0], left[1]


@njit(cache=True, nogil=True)
def _cut_element(system, inverse, depth, e, z, before, x, f):
    """Cut element e from state z: fill x with its chips and f with chips less surface left behind, times depth."""
    low, high = system.offset[e], system.offset[e + 1]
    free = np.zeros(high - low, dtype=np.complex128)
    for i in range(low, high):
        f[i] = -depth * _left_behind(system, i, x, before)
    for i in range(low, high):
        for m in range(z.size):
            free[i - low] += system.start[i, m] * z[m]
        for j in range(low, high):
            free[i - low] += system.gain[e, i - low, j - low] * f[j]
    for i in range(low, high):
        for j in range(low, high):
            x[i] += inverse[i - low, j - low] * free[j - low]
        f[i] += depth * x[i]


@njit(cache=True, nogil=True)
def _leave_element(system, e, f, z):
    """Move state z to the start of the next element; f are chips less surface left behind."""
    for m in range(z.size):
        total = system.decay[e, m] * z[m]
        for i in range(system.offset[e], system.offset[e + 1]):
            total += system.end[i, m] * f[i]
        z[m] = system.gap[e, m] * total


@njit(cache=True, nogil=True)
def apply_period(system, inverses, depth, state):
    """Move (z, surface), shape (N + m,), over one period of the cut at a depth."""
    states = system.turn.size
    z, before = state[:states].copy(), state[states:]
    x, f = np.zeros_like(before), np.zeros_like(before)
    for e in range(system.decay.shape[0]):
        _cut_element(system, inverses[e], depth, e, z, before, x, f)
        _leave_element(system, e, f, z)
    return np.concatenate((z, x))


@njit(cache=True, nogil=True)
def _norm(w):
    total = 0.0
    for k in range(w.size):
        total += w[k].real ** 2 + w[k].imag ** 2
    return math.sqrt(total)


@njit(cache=True, nogil=True)
def _orthogonalise(basis, hessenberg, j, w):
    """Take out of w what basis[:j + 1] spans, twice; put the rest into basis[j + 1]. False when nothing is left."""
    size = _norm(w)
    for _ in range(2):
        for i in range(j + 1):
            h = 0.0j
            for k in range(w.size):
                h += basis[i, k].conjugate() * w[k]
            hessenberg[i, j] += h
            for k in range(w.size):
                w[k] -= h * basis[i, k]
    rest = _norm(w)
    hessenberg[j + 1, j] = rest
    if rest <= 1e-14 * size:
        return False
    for k in range(w.size):
        basis[j + 1, k] = w[k] / rest
    return True


@njit(cache=True, nogil=True)
def _start(basis):
    """Start a basis with a fixed vector that is orthogonal to nothing in particular."""
    for k in range(basis.shape[1]):
        basis[0, k] = complex(1.0 + 0.5 * math.cos(7.0 * k + 1.0), 0.3 * math.sin(3.0 * k * k))
    size = _norm(basis[0])
    for k in range(basis.shape[1]):
        basis[0, k] /= size


@njit(cache=True, nogil=True)
def krylov_crossing(system, multiplier, size):
    """Return Arnoldi's basis (size + 1, m), Hessenberg matrix (size + 1, size) and the size reached."""
    basis = np.zeros((size + 1, system.source.size), dtype=np.complex128)
    hessenberg = np.zeros((size + 1, size), dtype=np.complex128)
    _start(basis)
    for j in range(size):
        if not _orthogonalise(basis, hessenberg, j, apply_crossing(system, multiplier, basis[j])):
            return basis, hessenberg, j + 1
    return basis, hessenberg, size


@njit(cache=True, nogil=True)
def krylov_period(system, inverses, depth, size):
    """Return what `krylov_crossing` does, for the map over one period; inverses of ``1 - depth G``, shape of gain."""
    basis = np.zeros((size + 1, system.turn.size + system.source.size), dtype=np.complex128)
    hessenberg = np.zeros((size + 1, size), dtype=np.complex128)
    _start(basis)
    for j in range(size):
        if not _orthogonalise(basis, hessenberg, j, apply_period(system, inverses, depth, basis[j])):
            return basis, hessenberg, j + 1
    return basis, hessenberg, size


@njit(cache=True, nogil=True)
def element_responses(rate, step, node, x, w, inside, whole):
    """Integrate ``exp(rate (t - s))`` times Lagrange polynomials from 0 to each node, and to the end of an element.

    Shapes (N, p, p) and (N, p) [s], by a rule x, w (q,) with the polynomials `inside` (p, q, p) and `whole` (q, p).
    """
    states, nodes, points = rate.size, node.size, x.size
    inner = np.zeros((states, nodes, nodes), dtype=np.complex128)
    last = np.zeros((states, nodes), dtype=np.complex128)
    for m in range(states):
        for q in range(points):
            for i in range(nodes):
                reach = step * node[i]
                growth = np.exp(rate[m] * reach * (1.0 - x[q])) * w[q] * reach
                for j in range(nodes):
                    inner[m, i, j] += growth * inside[i, q, j]
            growth = np.exp(rate[m] * step * (1.0 - x[q])) * w[q] * step
            for j in range(nodes):
                last[m, j] += growth * whole[q, j]
    return inner, last


@njit(cache=True, nogil=True)
def element_gains(output, force, rate, offset, node, step, x, w, inside, whole):
    """Return gain, start and end of a `System` whose elements last `step` (n,) [s]; output (m, N), force (N, m)."""
    width = 0
    for e in range(step.size):
        width = max(width, offset[e + 1] - offset[e])
    gain = np.zeros((step.size, width, width))
    start, end = np.empty_like(output), np.empty_like(output)
    inner, last = element_responses(rate, step[0], node, x, w, inside, whole)
    known = step[0]
    for e in range(step.size):
        if abs(step[e] / known - 1.0) > 1e-9:
            inner, last = element_responses(rate, step[e], node, x, w, inside, whole)
            known = step[e]
        for i in range(offset[e], offset[e + 1]):
            at = (i - offset[e]) % node.size
            for m in range(rate.size):
                start[i, m] = output[i, m] * np.exp(step[e] * node[at] * rate[m])
                end[i, m] = force[m, i] * last[m, at]
            for j in range(offset[e], offset[e + 1]):
                of = (j - offset[e]) % node.size
                total = 0.0
                for m in range(rate.size):
                    total += (output[i, m] * inner[m, at, of] * force[m, j]).real
                gain[e, i - offset[e], j - offset[e]] = total
    return gain, start, end


class Period(NamedTuple):
    """One period as dense products: ``x = depth (own - lagged/mu) x + free (mu - turn)^-1 depth (driven - left/mu) x``.

    Chips x (m,), multiplier mu. Shapes own and lagged (m, m), free (m, N), driven and left (N, m), turn (N,).
    """

    own: Any
    lagged: Any
    free: Any
    driven: Any
    left: Any
    turn: Any


@njit(cache=True, nogil=True)
def approach_crossing(period, angle, value, x, fixed):
    """Return angle, eigenvalue 1/depth, chips x and whether they settled at a crossing near those that are given.

    Newton's method on ``M(angle) x = value x``, ``x_0^H x = 1`` with a real value: the angle moves the imaginary part
    of the value to zero. With `fixed` the angle stays: a fold or a flip. A step of the angle is 0.1 at the most.
    """
    size = x.size
    matrix = np.empty((size + 1, size + 1), dtype=np.complex128)
    right = np.zeros((size + 1, 2), dtype=np.complex128)
    norm = 0.0
    for i in range(size):
        norm += x[i].real ** 2 + x[i].imag ** 2
    border = np.conj(x) / norm
    x = x.copy()
    value = complex(value)
    for _ in range(20):
        mu = np.exp(1j * angle)
        gain = 1.0 / (mu - period.turn)
        lag = 1.0 / mu
        # How the operator changes with the angle: only its product with x is needed.
        moved, later = period.lagged @ x, period.left @ x
        driven = period.driven @ x - lag * later
        change = 1j * (lag * moved + period.free @ (gain * (lag * later - mu * gain * driven)))
        matrix[:size, :size] = (
            period.own - lag * period.lagged + period.free @ (gain.reshape(-1, 1) * (period.driven - lag * period.left))
        )
        rest = np.ascontiguousarray(matrix[:size, :size]) @ x - value * x
        for i in range(size):
            matrix[i, i] -= value
            matrix[i, size] = -x[i]
            matrix[size, i] = border[i]
            right[i, 0] = -rest[i]
            right[i, 1] = -change[i]
        matrix[size, size] = 0.0
        found = np.linalg.solve(matrix, right)
        step = 0.0
        if not fixed:
            slope = found[size, 1].imag
            if slope == 0.0:
                return angle, value, x, False
            step = -(value + found[size, 0]).imag / slope
            step = min(0.1, max(-0.1, step))
        for i in range(size):
            x[i] += found[i, 0] + step * found[i, 1]
        moved_by = found[size, 0] + step * found[size, 1]
        value += moved_by
        angle += step
        if not (abs(value) < 1e300 and abs(value) > 0.0):
            return angle, value, x, False
        # The error left is about the square of the last step.
        if abs(moved_by) <= 1e-6 * abs(value) and abs(step) <= 1e-6 and abs(value.imag) <= 1e-7 * abs(value):
            return angle, value, x, value.real > 0.0
    return angle, value, x, False


@njit(cache=True, nogil=True)
def period_map(period, depth):
    """Return the map of state and surface over one period at a depth, real, shape (N + m, N + m).

    The state of a conjugate pair stands as real and imaginary part.
    """
    size, states = period.own.shape[0], period.turn.size
    right = np.zeros((size, states + size))
    turn, driven, left = np.zeros((states, states)), np.zeros((states, size)), np.zeros((states, size))
    row = 0
    for m in range(states):
        t = period.turn[m]
        if t.imag < 0.0:
            continue
        driven[row], left[row] = period.driven[m].real, period.left[m].real
        if t.imag == 0.0:
            turn[row, row] = t.real
            right[:, row] = period.free[:, m].real
            row += 1
            continue
        driven[row + 1], left[row + 1] = period.driven[m].imag, period.left[m].imag
        turn[row, row] = turn[row + 1, row + 1] = t.real
        turn[row, row + 1], turn[row + 1, row] = -t.imag, t.imag
        right[:, row], right[:, row + 1] = 2.0 * period.free[:, m].real, -2.0 * period.free[:, m].imag
        row += 2
    right[:, states:] = -depth * period.lagged.real
    chips = np.linalg.solve(np.eye(size) - depth * period.own.real, right)
    out = np.empty((states + size, states + size))
    out[:states] = depth * (driven @ chips)
    out[:states, :states] += turn
    out[:states, states:] -= depth * left
    out[states:] = chips
    return out


@njit(cache=True, nogil=True)
def is_stable(period, depth):
    """Whether the map over one period is stable at a depth: its powers of two, squared again and again, decay."""
    power = period_map(period, depth)
    for _ in range(40):
        size = math.sqrt(np.sum(power * power))
        if size < 1.0:
            return True
        if not size < 1e100:
            return False
        power = power @ power
    return False


@njit(cache=True, nogil=True)
def block_loops(columns, regenerated, phi):
    """Return the matrices of the multi-frequency loop over force lines, (a, M L, M L).

    Shapes, with t teeth of the pattern, L lines, F directions of motion and M of force: columns (t, L, rows, F), of
    which the first M L rows count, regenerated (a, t, L), phi (a, L, F, M).
    """
    count, lines, felt, moved = phi.shape
    size = lines * moved
    out = np.zeros((count, size, size), dtype=np.complex128)
    for a in range(count):
        for q in range(lines):
            for t in range(columns.shape[0]):
                for f in range(felt):
                    for k in range(moved):
                        factor = regenerated[a, t, q] * phi[a, q, f, k]
                        if factor != 0.0:
                            for row in range(size):
                                out[a, row, q * moved + k] += columns[t, q, row, f] * factor
    return out


@njit(cache=True, nogil=True)
def contact_loops(tooth, chip, force, regenerated, phi):
    """Return the same over the chips of contacts, (a, c, c); tooth (c,), chip (L, c, F), force (L, M, c)."""
    count, lines, felt, moved = phi.shape
    size = tooth.size
    right = np.ascontiguousarray(force[:lines]).reshape(lines * moved, size)
    out = np.empty((count, size, size), dtype=np.complex128)
    left = np.empty((lines * moved, size), dtype=np.complex128)
    for a in range(count):
        for q in range(lines):
            for k in range(moved):
                row = left[q * moved + k]
                first = phi[a, q, 0, k]
                for i in range(size):
                    row[i] = chip[q, i, 0] * first
                for f in range(1, felt):
                    other = phi[a, q, f, k]
                    if other != 0.0:
                        for i in range(size):
                            row[i] += chip[q, i, f] * other
                for i in range(size):
                    row[i] *= regenerated[a, tooth[i], q]
        out[a] = left.T @ right
    return out


@njit(cache=True, nogil=True)
def determinant_signs(matrices, depths):
    """Return ``det(1 - depth M)`` over its modulus for matrices (a, n, n) and depths (d,), shape (a, d)."""
    count, size, _ = matrices.shape
    out = np.empty((count, depths.size), dtype=np.complex128)
    for a in range(count):
        for d in range(depths.size):
            work = -depths[d] * matrices[a]
            for i in range(size):
                work[i, i] += 1.0
            out[a, d] = np.linalg.slogdet(work)[0]
    return out


@njit(cache=True, nogil=True)
def may_reach(matrix, least):
    """Whether an eigenvalue of a matrix may be as large as `least`: no power is larger than its norm says."""
    power = matrix / least
    for _ in range(4):
        size = 0.0
        for value in power.ravel():
            size += value.real**2 + value.imag**2
        if size < 1.0:
            return False
        if not size < 1e100:
            return True
        power = power @ power
    return True
