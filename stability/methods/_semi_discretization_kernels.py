"""Numba loops of the semi-discretisation. Floats and plain arrays only; labels live in `semi_discretization`.

One period of the cut is a row of elements with Gauss nodes. A *contact* is one engaged tooth at one node; its scalar is
the chip ``v^T r`` that the tool's displacement r adds there. Nothing else is remembered from pass to pass.
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
