"""Numba loops of the zero-order solution. Plain arrays only; labels live in `stability.methods.zero_order`."""

# Kernels take many scalars by design: numba knows no labelled arrays.

from __future__ import annotations

import cmath
import math

import numpy as np
from numba import njit

SUBDIVISIONS = 4
"""Least number of pieces into which each step of the frequency grid is cut in the search for crossings."""

SMALL_TURN = 0.02
"""A step over which mu changes by less than this share of itself is not cut."""

LARGEST_TURN = 0.1
"""Largest change of arg(mu) over such a piece [rad]: a coarse grid turns far over one step of a light resonance."""

ROOT_STEPS = 60
"""Largest number of bracketing steps for one crossing; about 8 are needed."""


NEGLIGIBLE = 1e-7
"""An eigenvalue below this share of the largest at its frequency is rounding of a deficient rank, not dynamics."""


@njit(cache=True, nogil=True)
def _cubic_roots(b, c, d, roots):
    """Fill roots (3,) of ``x^3 - b x^2 + c x - d`` by Aberth's simultaneous iteration from what they hold."""
    for _ in range(60):
        largest = 0.0
        for i in range(3):
            x = roots[i]
            value = ((x - b) * x + c) * x - d
            if value == 0.0:
                continue
            slope = (3.0 * x - 2.0 * b) * x + c
            others = 0.0j
            for j in range(3):
                if j != i and x != roots[j]:
                    others += 1.0 / (x - roots[j])
            under = slope - value * others
            if under == 0.0:
                under = slope + 1e-3 * abs(x) ** 2 + 1e-300
            step = value / under
            roots[i] = x - step
            largest = max(largest, abs(step) - 4e-16 * abs(x))
        if largest <= 1e-16 * max(abs(roots[0]), abs(roots[1]), abs(roots[2])):
            return


@njit(cache=True, nogil=True)
def eigenvalues(matrices):
    """Return the eigenvalues, shape (n, m), of small matrices, shape (n, m, m), m up to 3; the negligible are zero."""
    n, m = matrices.shape[0], matrices.shape[1]
    out = np.zeros((n, m), dtype=np.complex128)
    roots = np.zeros(3, dtype=np.complex128)
    for k in range(n):
        a = matrices[k]
        if m == 1:
            out[k, 0] = a[0, 0]
        elif m == 2:
            half = 0.5 * (a[0, 0] + a[1, 1])
            turn = cmath.sqrt(0.25 * (a[0, 0] - a[1, 1]) ** 2 + a[0, 1] * a[1, 0])
            large = half + turn if abs(half + turn) >= abs(half - turn) else half - turn
            out[k, 0] = large
            out[k, 1] = (a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]) / large if large != 0.0 else 0.0
        else:
            low = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
            middle = a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]
            high = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
            determinant = (
                a[0, 0] * low
                - a[0, 1] * (a[1, 0] * a[2, 2] - a[1, 2] * a[2, 0])
                + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
            )
            size = 0.0
            for i in range(3):
                for j in range(3):
                    size = max(size, abs(a[i, j]))
            # Three points on a circle about all roots, turned off any symmetry, when the sample before tells nothing.
            for i in range(3):
                if k == 0 or roots[i] == 0.0:
                    roots[i] = size * cmath.exp(1j * (0.4 + 2.1 * i))
            _cubic_roots(a[0, 0] + a[1, 1] + a[2, 2], low + middle + high, determinant, roots)
            out[k] = roots
        largest = np.abs(out[k]).max()
        for i in range(m):
            if abs(out[k, i]) < NEGLIGIBLE * largest:
                out[k, i] = 0.0
    return out


@njit(cache=True, nogil=True)
def _mismatch(values, before, expected, permutation, penalty):
    """Squared distance of permuted values from what is expected; what rank leaves at zero is to stay zero."""
    cost = 0.0
    for j in range(permutation.size):
        value = values[permutation[j]]
        cost += abs(value - expected[j]) ** 2
        if (value == 0.0) != (before[j] == 0.0):
            cost += penalty
    return cost


@njit(cache=True, nogil=True)
def track(frequency, bridged, permutations, eigenvalues):
    """Reorder eigenvalues, shape (n, m), in place: each column becomes one branch, continuous over frequency.

    Each sample takes the permutation nearest (least squares) to the straight continuation of the two before:
    where two branches cross, the nearest value alone would swap them.
    """
    n, m = eigenvalues.shape
    expected = np.empty(m, dtype=np.complex128)
    taken = np.empty(m, dtype=np.complex128)
    for i in range(1, n):
        straight = i > 1 and bridged[i - 1] and bridged[i - 2]
        ratio = (frequency[i] - frequency[i - 1]) / (frequency[i - 1] - frequency[i - 2]) if straight else 0.0
        for j in range(m):
            expected[j] = eigenvalues[i - 1, j]
            if straight:
                ahead = ratio * (eigenvalues[i - 1, j] - eigenvalues[i - 2, j])
                # A grid too coarse for a resonance throws the continuation far off: then the last value is safer.
                if abs(ahead) < abs(expected[j]):
                    expected[j] += ahead
        best = math.inf
        choice = 0
        penalty = 0.0
        for j in range(m):
            penalty += 10.0 * (abs(eigenvalues[i, j]) + abs(eigenvalues[i - 1, j])) ** 2
        for p in range(permutations.shape[0]):
            cost = _mismatch(eigenvalues[i], eigenvalues[i - 1], expected, permutations[p], penalty)
            if cost < best:
                best = cost
                choice = p
        for j in range(m):
            taken[j] = eigenvalues[i, permutations[choice, j]]
        eigenvalues[i] = taken


@njit(cache=True, nogil=True)
def eigenvalue_at(x, frequency, start, newton, inverse):
    """Evaluate mu at frequency x from Newton's form of its cubic, or (`inverse`) of that of 1/mu."""
    last = frequency.size - 1
    value = newton[3] * (x - frequency[min(start + 2, last)]) + newton[2]
    value = value * (x - frequency[min(start + 1, last)]) + newton[1]
    value = value * (x - frequency[start]) + newton[0]
    return 1.0 / value if inverse else value


@njit(cache=True, nogil=True)
def _turns(mu, mu_low, angle_low):
    """theta/(2 pi) = 1/2 + arg(mu)/pi, continuous from the value at the lower end of the step."""
    return 0.5 + (angle_low + cmath.phase(mu / mu_low)) / math.pi


@njit(cache=True, nogil=True)
def _crossing(low, high, period, lobe, mu_low, frequency, start, newton, inverse):
    """Solve ``f T - theta(f)/(2 pi) = lobe`` on [low, high] by false position (Illinois); returns f [Hz]."""
    angle = cmath.phase(mu_low)
    mu_high = eigenvalue_at(high, frequency, start, newton, inverse)
    g_low = low * period - 0.5 - angle / math.pi - lobe
    g_high = high * period - _turns(mu_high, mu_low, angle) - lobe
    if g_low == 0.0 or g_low * g_high > 0.0:
        return low if abs(g_low) <= abs(g_high) else high
    side = 0
    x = high
    for _ in range(ROOT_STEPS):
        x = (low * g_high - high * g_low) / (g_high - g_low)
        mu = eigenvalue_at(x, frequency, start, newton, inverse)
        g = x * period - _turns(mu, mu_low, angle) - lobe
        if abs(g) < 1e-13 * (1.0 + abs(lobe)) or high - low < 1e-14 * x:
            break
        if g * g_high > 0.0:
            high, g_high = x, g
            if side == -1:
                g_low *= 0.5
            side = -1
        else:
            low, g_low = x, g
            if side == 1:
                g_high *= 0.5
            side = 1
    return x


@njit(cache=True, nogil=True)
def _take_crossings(low, high, mu_low, mu_high, period, step, depth, chatter, lobe):
    """Lower the envelope by every lobe that crosses one piece [low, high] of a branch.

    `period` rises; `step` holds (frequency, start, newton, inverse) of the piece's interpolant.
    """
    frequency, start, newton, inverse = step
    angle = cmath.phase(mu_low)
    turns_low = 0.5 + angle / math.pi
    turns_high = _turns(mu_high, mu_low, angle)
    first = math.ceil(min(low * period[0] - turns_low, high * period[0] - turns_high) - 1e-9)
    last = math.floor(max(low * period[-1] - turns_low, high * period[-1] - turns_high) + 1e-9)
    for k in range(first, last + 1):
        at_low = (turns_low + k) / low
        at_high = (turns_high + k) / high
        i = np.searchsorted(period, min(at_low, at_high) * (1.0 - 1e-13))
        end = np.searchsorted(period, max(at_low, at_high) * (1.0 + 1e-13))
        while i < end:
            x = _crossing(low, high, period[i], k, mu_low, frequency, start, newton, inverse)
            mu = eigenvalue_at(x, frequency, start, newton, inverse)
            if mu.real > 0.0 and 0.5 / mu.real < depth[i]:
                depth[i] = 0.5 / mu.real
                chatter[i] = x
                # theta is taken in (0, 2 pi) for the number of the lobe, whatever turn the tracking is in.
                lobe[i] = round(x * period[i] - 0.5 - cmath.phase(mu) / math.pi)
            i += 1


@njit(cache=True, nogil=True)
def _pieces(low, high, step):
    """Return into how many pieces to cut a step so that the eigenvalue turns little over each."""
    turned = 0.0
    before = eigenvalue_at(low, *step)
    middle, after = eigenvalue_at(0.5 * (low + high), *step), eigenvalue_at(high, *step)
    if abs(middle - before) + abs(after - middle) < SMALL_TURN * abs(middle):
        return 1
    for s in range(1, SUBDIVISIONS + 1):
        after = eigenvalue_at(low + (high - low) * s / SUBDIVISIONS, *step)
        if before != 0.0 and after != 0.0:
            turned = max(turned, abs(cmath.phase(after / before)))
        before = after
    return SUBDIVISIONS * min(64, 1 + int(turned / LARGEST_TURN))


@njit(cache=True, nogil=True)
def envelope(frequency, bridged, start, newton, inverse, period):
    """Return (depth, chatter frequency, lobe) of the lowest crossing at each tooth period.

    Shapes: frequency (n,), bridged and start (n-1,), newton (branches, n-1, 4), inverse (branches, n-1),
    period (speeds,) rising. SI; depth is inf and lobe -1 where nothing crosses.
    """
    depth = np.full(period.size, np.inf)
    chatter = np.full(period.size, np.nan)
    lobe = np.full(period.size, -1)
    for b in range(newton.shape[0]):
        for i in range(frequency.size - 1):
            if not bridged[i]:
                continue
            step = (frequency, start[i], newton[b, i], inverse[b, i])
            low = frequency[i]
            mu_low = eigenvalue_at(low, *step)
            pieces = _pieces(low, frequency[i + 1], step)
            for s in range(1, pieces + 1):
                high = frequency[i] + (frequency[i + 1] - frequency[i]) * s / pieces
                mu_high = eigenvalue_at(high, *step)
                if mu_low != 0.0 and mu_high != 0.0 and (mu_low.real > 0.0 or mu_high.real > 0.0):
                    _take_crossings(low, high, mu_low, mu_high, period, step, depth, chatter, lobe)
                low, mu_low = high, mu_high
    return depth, chatter, lobe


@njit(cache=True, nogil=True)
def refine(frequency, bridged, start, newton, inverse, pieces):
    """Return (frequency, eigenvalue) with each step cut into `pieces`; the eigenvalue is NaN in gaps.

    Shapes of the result: ((n-1) pieces + 1,), (branches, (n-1) pieces + 1).
    """
    n = frequency.size
    x = np.empty((n - 1) * pieces + 1)
    mu = np.empty((newton.shape[0], x.size), dtype=np.complex128)
    x[-1] = frequency[-1]
    for i in range(n - 1):
        for s in range(pieces):
            x[i * pieces + s] = frequency[i] + (frequency[i + 1] - frequency[i]) * s / pieces
    for b in range(newton.shape[0]):
        for j in range(x.size):
            i = min(j // pieces, n - 2)
            on_sample = j % pieces == 0
            if bridged[i]:
                mu[b, j] = eigenvalue_at(x[j], frequency, start[i], newton[b, i], inverse[b, i])
            elif on_sample and i > 0 and bridged[i - 1]:
                mu[b, j] = eigenvalue_at(x[j], frequency, start[i - 1], newton[b, i - 1], inverse[b, i - 1])
            else:
                mu[b, j] = np.nan
    return x, mu


@njit(cache=True, nogil=True)
def regeneration(turns):
    """Return the mean of ``1 - exp(-2 pi j turns)`` over the teeth, for the waves between each and the one before."""
    total = 0.0j
    for t in turns:
        total += 1.0 - cmath.exp(-2j * math.pi * t)
    return total / turns.size


@njit(cache=True, nogil=True)
def _regenerated_root(low, high, g_low, g_high, delay, step):
    """Return (f, value) where the imaginary part of ``S(f) mu(f)`` vanishes on [low, high] (Illinois)."""
    side = 0
    x, value = low, 0.0j
    for _ in range(ROOT_STEPS):
        x = (low * g_high - high * g_low) / (g_high - g_low)
        value = regeneration(x * delay) * eigenvalue_at(x, *step)
        g = value.imag
        if abs(g) < 1e-12 * abs(value) or high - low < 1e-14 * x:
            break
        if g * g_high > 0.0:
            high, g_high = x, g
            if side == -1:
                g_low *= 0.5
            side = -1
        else:
            low, g_low = x, g
            if side == 1:
                g_high *= 0.5
            side = 1
    return x, value


@njit(cache=True, nogil=True)
def first_crossing(frequency, bridged, start, newton, inverse, eigenvalue, delay):
    """Return (depth, frequency) of the lowest crossing ``a S(f) mu(f) = 1`` for delays of the teeth [s], (teeth,)."""
    depth, chatter = math.inf, math.nan
    longest = delay.max()
    for b in range(newton.shape[0]):
        for i in range(frequency.size - 1):
            # |S| is at most 2: where mu is small nothing can lie below what is found.
            bound = 2.0 * max(abs(eigenvalue[b, i]), abs(eigenvalue[b, i + 1]))
            if not bridged[i] or bound * depth < 0.5:
                continue
            step = (frequency, start[i], newton[b, i], inverse[b, i])
            width = frequency[i + 1] - frequency[i]
            waves = 2.0 * math.pi * width * longest
            pieces = max(_pieces(frequency[i], frequency[i + 1], step), int(waves / LARGEST_TURN) + 1)
            low = frequency[i]
            at_low = regeneration(low * delay) * eigenvalue_at(low, *step)
            for s in range(1, pieces + 1):
                high = frequency[i] + width * s / pieces
                at_high = regeneration(high * delay) * eigenvalue_at(high, *step)
                if at_low.imag * at_high.imag <= 0.0 and max(at_low.real, at_high.real) > 0.0 and at_low != at_high:
                    x, value = _regenerated_root(low, high, at_low.imag, at_high.imag, delay, step)
                    if value.real > 0.0 and 1.0 / value.real < depth:
                        depth, chatter = 1.0 / value.real, x
                low, at_low = high, at_high
    return depth, chatter
