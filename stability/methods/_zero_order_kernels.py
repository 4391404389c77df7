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

FINE_CHANGE = 0.1
"""A step is fine when mu changes by less than this share of itself over it and over those beside it."""

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


@njit(cache=True, nogil=True, inline="always")
def _square(z):
    """Return ``|z|^2``; the library's abs guards against overflow at ten times the price."""
    return z.real * z.real + z.imag * z.imag


@njit(cache=True, nogil=True, inline="always")
def _over(a, b):
    """Return a/b for numbers whose squares neither overflow nor vanish: one real division."""
    s = 1.0 / (b.real * b.real + b.imag * b.imag)
    return complex(
        (a.real * b.real + a.imag * b.imag) * s,
        (a.imag * b.real - a.real * b.imag) * s,
    )


@njit(cache=True, nogil=True, inline="always")
def _root(z):
    """Return the square root of z with a positive real part."""
    r = math.sqrt(z.real * z.real + z.imag * z.imag)
    if r == 0.0:
        return 0.0j
    large = math.sqrt(0.5 * (r + abs(z.real)))
    small = 0.5 * abs(z.imag) / large
    if z.real >= 0.0:
        return complex(large, math.copysign(small, z.imag))
    return complex(small, math.copysign(large, z.imag))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _isolated_root(c, d, near):
    """Return the root of ``y^3 + c y - d`` that lies farthest from the other two, by Newton's iteration from `near`.

    The slope 3 y^2 + c at a root is the product of its distances from the others, ``-3 y^2 - 4 c`` the square of the
    distance between those. Where the root reached is not isolated, the search starts anew from all three.
    """
    y = near
    for _ in range(8):
        slope = 3.0 * y * y + c
        if _square(slope) < 1e-12:
            break
        move = _over((y * y + c) * y - d, slope)
        y -= move
        if _square(move) < 1e-12 * _square(y):
            # Newton squares the error, here and once more: less than 1e-10, then rounding.
            slope = 3.0 * y * y + c
            if _square(slope) > 0.06 * _square(3.0 * y * y + 4.0 * c):
                return y - _over((y * y + c) * y - d, slope)
            break
    roots = np.empty(3, dtype=np.complex128)
    for i in range(3):
        roots[i] = 1.5 * cmath.exp(1j * (0.4 + 2.1 * i))
    _cubic_roots(0.0j, c, d, roots)
    y = roots[0]
    for i in range(1, 3):
        if _square(3.0 * roots[i] * roots[i] + c) > _square(3.0 * y * y + c):
            y = roots[i]
    slope = 3.0 * y * y + c
    return y - _over((y * y + c) * y - d, slope) if _square(slope) > 1e-24 else y


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _null_vector(s00, s01, s02, s10, s11, s12, s20, s21, s22):
    """Return the vector that a matrix of rank two sends to zero: normal to two of its rows, the longest of three."""
    x, y, z = s01 * s12 - s02 * s11, s02 * s10 - s00 * s12, s00 * s11 - s01 * s10
    size = _square(x) + _square(y) + _square(z)
    whole = _square(s00) + _square(s01) + _square(s02) + _square(s10) + _square(s11) + _square(s12)
    # A row that is nothing but rounding is at right angles to the other, too: both have to be of the matrix's size.
    if size > 0.01 * (whole + _square(s20) + _square(s21) + _square(s22)) ** 2:
        return x, y, z
    u, v, w = s11 * s22 - s12 * s21, s12 * s20 - s10 * s22, s10 * s21 - s11 * s20
    other = _square(u) + _square(v) + _square(w)
    if other > size:
        x, y, z, size = u, v, w, other
    u, v, w = s21 * s02 - s22 * s01, s22 * s00 - s20 * s02, s20 * s01 - s21 * s00
    other = _square(u) + _square(v) + _square(w)
    if other > size:
        x, y, z = u, v, w
    return x, y, z


@njit(cache=True, nogil=True, inline="always")
def _two(a, b, c, d):
    """Return the eigenvalues of ``[[a, b], [c, d]]``."""
    half, apart = 0.5 * (a + d), 0.5 * (a - d)
    turn = _root(apart * apart + b * c)
    return half + turn, half - turn


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _three(a, near):
    """Return the eigenvalues of a matrix (3, 3); the first is the isolated one over the size, to start the next from.

    A third of the trace is taken off and the rest scaled: its characteristic polynomial ``y^3 + c y - d`` then loses
    nothing when all eigenvalues are close. Only the isolated root is taken from the polynomial. The others are those of
    the 2x2 block that an elimination with its eigenvector leaves: two that nearly coincide would lose half their digits
    in the polynomial, but none there. Source: Wilkinson 1965, The algebraic eigenvalue problem, ch. 9 (deflation).
    """
    mean = (a[0, 0] + a[1, 1] + a[2, 2]) / 3.0
    s00, s11, s22 = a[0, 0] - mean, a[1, 1] - mean, a[2, 2] - mean
    s01, s02, s10, s12, s20, s21 = a[0, 1], a[0, 2], a[1, 0], a[1, 2], a[2, 0], a[2, 1]
    size = math.sqrt(
        _square(s00) + _square(s11) + _square(s22) + _square(s01) + _square(s02)
        + _square(s10) + _square(s12) + _square(s20) + _square(s21)
    )  # fmt: skip
    if not size > 0.0:
        return near, mean, mean, mean
    g = 1.0 / size
    s00, s01, s02, s10, s11 = g * s00, g * s01, g * s02, g * s10, g * s11
    s12, s20, s21, s22 = g * s12, g * s20, g * s21, g * s22
    low = s11 * s22 - s12 * s21
    c = low + s00 * s22 - s02 * s20 + s00 * s11 - s01 * s10
    d = s00 * low - s01 * (s10 * s22 - s12 * s20) + s02 * (s10 * s21 - s11 * s20)
    y = _isolated_root(c, d, near)
    u, v, w = _null_vector(s00 - y, s01, s02, s10, s11 - y, s12, s20, s21, s22 - y)
    uu, vv, ww = _square(u), _square(v), _square(w)
    if uu + vv + ww == 0.0:
        first = second = -0.5 * y
    elif uu >= vv and uu >= ww:
        p, q = _over(v, u), _over(w, u)
        first, second = _two(s11 - p * s01, s12 - p * s02, s21 - q * s01, s22 - q * s02)
    elif vv >= ww:
        p, q = _over(u, v), _over(w, v)
        first, second = _two(s00 - p * s10, s02 - p * s12, s20 - q * s10, s22 - q * s12)
    else:
        p, q = _over(u, w), _over(v, w)
        first, second = _two(s00 - p * s20, s01 - p * s21, s10 - q * s20, s11 - q * s21)
    return y, mean + size * y, mean + size * first, mean + size * second


@njit(cache=True, nogil=True, inline="always")
def _clear(out, k):
    """Set to zero what is negligible among the eigenvalues out[:, k]."""
    largest = 0.0
    for i in range(out.shape[0]):
        largest = max(largest, _square(out[i, k]))
    for i in range(out.shape[0]):
        if _square(out[i, k]) < NEGLIGIBLE**2 * largest:
            out[i, k] = 0.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def eigenvalues(matrices):
    """Return the eigenvalues, shape (n, m), of small matrices, shape (n, m, m), m up to 3; the negligible are zero."""
    n, m = matrices.shape[0], matrices.shape[1]
    out = np.empty((n, m), dtype=np.complex128)
    flipped = out.T
    near = 0.0j
    for k in range(n):
        a = matrices[k]
        if m == 1:
            out[k, 0] = a[0, 0]
        elif m == 2:
            out[k, 0], out[k, 1] = _two(a[0, 0], a[0, 1], a[1, 0], a[1, 1])
        else:
            near, out[k, 0], out[k, 1], out[k, 2] = _three(a, near)
        _clear(flipped, k)
    return out


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def oriented_eigenvalues(compliance, left, right):
    """Return the eigenvalues, shape (r, n), of ``left Phi right``: Phi (n, 3, 3), left (r, 3), right (3, r), r up to 3.

    With r = 3 those of ``right left Phi``, which are the same at half the products. Nothing but the result is stored:
    fresh memory would cost more than the sums.
    """
    n, r = compliance.shape[0], left.shape[0]
    out = np.empty((r, n), dtype=np.complex128)
    a = np.zeros((3, 3), dtype=np.complex128)
    near, last = 0.0j, 0.0j
    if r == 3:
        left = right @ left
    for k in range(n):
        for i in range(r):
            x = left[i, 0] * compliance[k, 0, 0] + left[i, 1] * compliance[k, 1, 0] + left[i, 2] * compliance[k, 2, 0]
            y = left[i, 0] * compliance[k, 0, 1] + left[i, 1] * compliance[k, 1, 1] + left[i, 2] * compliance[k, 2, 1]
            z = left[i, 0] * compliance[k, 0, 2] + left[i, 1] * compliance[k, 1, 2] + left[i, 2] * compliance[k, 2, 2]
            if r == 3:
                a[i, 0], a[i, 1], a[i, 2] = x, y, z
                continue
            for j in range(r):
                a[i, j] = x * right[0, j] + y * right[1, j] + z * right[2, j]
        if r == 1:
            out[0, k] = a[0, 0]
        elif r == 2:
            out[0, k], out[1, k] = _two(a[0, 0], a[0, 1], a[1, 0], a[1, 1])
        else:
            root, out[0, k], out[1, k], out[2, k] = _three(a, near)
            # Samples follow each other closely: start the next from the straight continuation.
            near, last = 2.0 * root - last if k > 0 else root, root
        _clear(out, k)
    return out


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def track(frequency, bridged, permutations, eigenvalues):
    """Reorder eigenvalues, shape (m, n), in place: each row becomes one branch, continuous over frequency.

    Each sample takes the permutation nearest (least squares) to the straight continuation of the two before:
    where two branches cross, the nearest value alone would swap them. What rank leaves at zero is to stay zero.
    """
    m, n = eigenvalues.shape
    expected = np.empty(m, dtype=np.complex128)
    taken = np.empty(m, dtype=np.complex128)
    apart = np.empty((m, m))
    for i in range(1, n):
        straight = i > 1 and bridged[i - 1] and bridged[i - 2]
        ratio = (frequency[i] - frequency[i - 1]) / (frequency[i - 1] - frequency[i - 2]) if straight else 0.0
        penalty = 0.0
        for j in range(m):
            before = eigenvalues[j, i - 1]
            expected[j] = before
            if straight:
                ahead = ratio * (before - eigenvalues[j, i - 2])
                # A grid too coarse for a resonance throws the continuation far off: then the last value is safer.
                if _square(ahead) < _square(before):
                    expected[j] += ahead
            # More than any of the distances: twice the squares bound the square of a sum.
            penalty += 20.0 * (_square(eigenvalues[j, i]) + _square(before))
        for j in range(m):
            zero = eigenvalues[j, i - 1] == 0.0
            for k in range(m):
                value = eigenvalues[k, i]
                apart[j, k] = _square(value - expected[j])
                if (value == 0.0) != zero:
                    apart[j, k] += penalty
        best = math.inf
        choice = 0
        for p in range(permutations.shape[0]):
            cost = 0.0
            for j in range(m):
                cost += apart[j, permutations[p, j]]
            if cost < best:
                best = cost
                choice = p
        for j in range(m):
            taken[j] = eigenvalues[permutations[choice, j], i]
        for j in range(m):
            eigenvalues[j, i] = taken[j]


@njit(cache=True, nogil=True, inline="always")
def _divided_differences(v0, v1, v2, v3, r01, r12, r23, r02, r13, r03, order):
    """Return Newton's coefficients of four values for the reciprocals of the spans; those beyond `order` are zero."""
    d01, d12, d23 = (v1 - v0) * r01, (v2 - v1) * r12, (v3 - v2) * r23
    d012, d123 = (d12 - d01) * r02, (d23 - d12) * r13
    third = (d123 - d012) * r03
    return d01, d012 if order >= 2 else 0.0j, third if order >= 3 else 0.0j


@njit(cache=True, nogil=True, inline="always")
def _inverse_span(x):
    """Return 1/x, or 1 beyond the last sample of a run: there is nothing to difference."""
    return 1.0 / x if x > 0.0 else 1.0


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def _interpolant(frequency, s, o, mu, b, i):
    """Return Newton's form (x0, x1, x2, c0, c1, c2, c3, inverse) of the cubic over step i of branch b.

    Of mu or of 1/mu, whichever has the smaller last term; across a zero of mu, of mu itself. s and o are first sample
    and order.
    """
    end = frequency.size - 1
    i1, i2, i3 = min(s + 1, end), min(s + 2, end), min(s + 3, end)
    x0, x1, x2, x3 = frequency[s], frequency[i1], frequency[i2], frequency[i3]
    r01, r12, r23 = _inverse_span(x1 - x0), _inverse_span(x2 - x1), _inverse_span(x3 - x2)
    r02, r13, r03 = _inverse_span(x2 - x0), _inverse_span(x3 - x1), _inverse_span(x3 - x0)
    v0, v1, v2, v3 = mu[b, s], mu[b, i1], mu[b, i2], mu[b, i3]
    c1, c2, c3 = _divided_differences(v0, v1, v2, v3, r01, r12, r23, r02, r13, r03, o)
    if v0 == 0.0 or v1 == 0.0 or v2 == 0.0 or v3 == 0.0:
        return x0, x1, x2, v0, c1, c2, c3, False
    w0, w1, w2, w3 = _over(1.0 + 0.0j, v0), _over(1.0 + 0.0j, v1), _over(1.0 + 0.0j, v2), _over(1.0 + 0.0j, v3)
    e1, e2, e3 = _divided_differences(w0, w1, w2, w3, r01, r12, r23, r02, r13, r03, o)
    last = c3 if o == 3 else (c2 if o == 2 else c1)
    reciprocal = e3 if o == 3 else (e2 if o == 2 else e1)
    # Both last terms are times the same distances; each is over the mean size of its values at the ends.
    low, high = math.sqrt(_square(mu[b, i])), math.sqrt(_square(mu[b, i + 1]))
    if math.sqrt(_square(reciprocal)) * low * high < math.sqrt(_square(last)):
        return x0, x1, x2, w0, e1, e2, e3, True
    return x0, x1, x2, v0, c1, c2, c3, False


@njit(cache=True, nogil=True)
def interpolants(frequency, start, order, mu, newton, inverse):
    """Fill the cubic of each step; newton (branches, n-1, 4) and inverse (branches, n-1) of mu (branches, n)."""
    for b in range(mu.shape[0]):
        for i in range(start.size):
            _, _, _, c0, c1, c2, c3, other = _interpolant(frequency, start[i], order[i], mu, b, i)
            newton[b, i, 0], newton[b, i, 1], newton[b, i, 2], newton[b, i, 3] = c0, c1, c2, c3
            inverse[b, i] = other


@njit(cache=True, nogil=True)
def eigenvalue_at(x, frequency, start, newton, inverse):
    """Evaluate mu at frequency x from Newton's form of its cubic, or (`inverse`) of that of 1/mu."""
    last = frequency.size - 1
    value = newton[3] * (x - frequency[min(start + 2, last)]) + newton[2]
    value = value * (x - frequency[min(start + 1, last)]) + newton[1]
    value = value * (x - frequency[start]) + newton[0]
    return 1.0 / value if inverse else value


@njit(cache=True, nogil=True, inline="always")
def _cubic(x, x0, x1, x2, c0, c1, c2, c3, inverse):
    """Evaluate as `eigenvalue_at`, from scalars: arrays in arguments cost more than the sum."""
    value = ((c3 * (x - x2) + c2) * (x - x1) + c1) * (x - x0) + c0
    return _over(1.0 + 0.0j, value) if inverse else value


@njit(cache=True, nogil=True, inline="always")
def _turns(mu, mu_low, turns_low):
    """theta/(2 pi) = 1/2 + arg(mu)/pi, continuous from the value at the lower end of the piece."""
    along = mu.real * mu_low.real + mu.imag * mu_low.imag
    across = mu.imag * mu_low.real - mu.real * mu_low.imag
    if abs(across) > 0.05 * along:
        return turns_low + math.atan2(across, along) / math.pi
    # The series of the arc tangent to rounding: most turns are small.
    u = across / along
    q = u * u
    series = 1.0 - q * (1.0 / 3.0 - q * (1.0 / 5.0 - q * (1.0 / 7.0 - q * (1.0 / 9.0 - q * (1.0 / 11.0)))))
    return turns_low + u * series / math.pi


@njit(cache=True, nogil=True, error_model="numpy")
def _crossing(low, high, period, lobe, mu_low, turns_low, turns_high, x0, x1, x2, c0, c1, c2, c3, inverse):
    """Solve ``f T - theta(f)/(2 pi) = lobe`` on [low, high] by false position (Illinois); returns f [Hz] and mu."""
    g_low = low * period - turns_low - lobe
    g_high = high * period - turns_high - lobe
    if g_low == 0.0 or g_low * g_high > 0.0:
        x = low if abs(g_low) <= abs(g_high) else high
        return x, _cubic(x, x0, x1, x2, c0, c1, c2, c3, inverse)
    side = 0
    x, mu = high, mu_low
    for _ in range(ROOT_STEPS):
        x = (low * g_high - high * g_low) / (g_high - g_low)
        mu = _cubic(x, x0, x1, x2, c0, c1, c2, c3, inverse)
        g = x * period - _turns(mu, mu_low, turns_low) - lobe
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
    return x, mu


@njit(cache=True, nogil=True, inline="always")
def _first_at_least(period, cells, rate0, scale, value):
    """Return the first index of rising periods that is not below a value, found from the cell of its rate."""
    cell = min(max((1.0 / value - rate0) * scale, 0.0), cells.size - 2.0)
    at, end = cells[int(cell) + 1], cells[int(cell)]
    while at < end:
        middle = (at + end) >> 1
        if period[middle] < value:
            at = middle + 1
        else:
            end = middle
    return at


@njit(cache=True, nogil=True)
def _cells_of_rates(period, cells):
    """Fill cells (m + 1,): the first index whose rate 1/T is below each of m + 1 even marks; return it and 1/width.

    Speeds mostly lie evenly: then a cell holds about one, and finding a period takes no search. The first and the last
    cell hold what lies beyond.
    """
    low, high = 1.0 / period[-1], 1.0 / period[0]
    m = cells.size - 1
    scale = m / (high - low) if high > low else 1.0
    i = period.size
    for j in range(1, m):
        # One mark lower by rounding: the search in a cell must not miss what lies on its edge.
        while i > 0 and (1.0 / period[i - 1] - low) * scale < j - 1e-6:
            i -= 1
        cells[j] = i
    cells[0], cells[m] = period.size, 0
    return low, scale


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


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def envelope(frequency, bridged, start, order, mu, period, depth, chatter, lobe):
    """Lower (depth, chatter frequency, lobe) at each tooth period to the lowest crossing, in one pass over the steps.

    Shapes: frequency (n,), bridged, start and order (n-1,), mu (branches, n), period and what is filled (speeds,),
    period rising. SI; give depth inf, frequency NaN, lobe -1. A step whose largest real part cannot lie below what has
    been found is passed by, a fine one before its cubic is made; so are crossings.
    """
    cells = np.empty(2 * period.size + 2, dtype=np.int64)
    rate0, scale = _cells_of_rates(period, cells)
    newton = np.empty(4, dtype=np.complex128)
    shortest, longest = period[0], period[-1]
    end = frequency.size - 1
    # The turns at the upper end of the last piece, where the next one begins, and the deepest limit so far.
    turns_high, reached, deepest = 0.0, -1.0, math.inf
    for b in range(mu.shape[0]):
        reached = -1.0
        for i in range(end):
            if i % 128 == 0:
                deepest = depth.max()
            if not bridged[i]:
                continue
            mu_low, mu_high = mu[b, i], mu[b, i + 1]
            change = _square(mu_high - mu_low)
            if i > 0:
                change = max(change, _square(mu_low - mu[b, i - 1]))
            if i + 2 <= end:
                change = max(change, _square(mu[b, i + 2] - mu_high))
            if change < FINE_CHANGE**2 * min(_square(mu_low), _square(mu_high)):
                # A cubic through values so close stays within one change of them.
                most = max(mu_low.real, mu_high.real) + math.sqrt(change)
                if most <= 0.0 or most * deepest <= 0.5:
                    continue
            f_low, f_high = frequency[i], frequency[i + 1]
            x0, x1, x2, c0, c1, c2, c3, other = _interpolant(frequency, start[i], order[i], mu, b, i)
            middle = _cubic(0.5 * (f_low + f_high), x0, x1, x2, c0, c1, c2, c3, other)
            # At least the square of the way from end to end.
            varied = 2.0 * (_square(middle - mu_low) + _square(mu_high - middle))
            pieces = 1
            if varied >= SMALL_TURN**2 * _square(middle):
                newton[0], newton[1], newton[2], newton[3] = c0, c1, c2, c3
                pieces = _pieces(f_low, f_high, (frequency, start[i], newton, other))
            elif max(mu_low.real, mu_high.real) <= 0.0:
                continue
            low = f_low
            for part in range(1, pieces + 1):
                high, mu_high = f_high, mu[b, i + 1]
                if part < pieces:
                    high = f_low + (f_high - f_low) * part / pieces
                    mu_high = _cubic(high, x0, x1, x2, c0, c1, c2, c3, other)
                if mu_low == 0.0 or mu_high == 0.0 or max(mu_low.real, mu_high.real) <= 0.0:
                    low, mu_low = high, mu_high
                    continue
                # The arc between the ends bulges by less than this.
                if pieces == 1:
                    bulge = 0.1 * math.sqrt(varied) + 2.0 * abs(middle.real - 0.5 * (mu_low.real + mu_high.real))
                else:
                    bulge = 0.5 * math.sqrt(_square(mu_high - mu_low))
                largest = max(mu_low.real, mu_high.real) + bulge
                if largest * deepest <= 0.5:
                    low, mu_low = high, mu_high
                    continue
                turns_low = turns_high
                if low != reached:
                    turns_low = 0.5 + math.atan2(mu_low.imag, mu_low.real) / math.pi
                turns_high = _turns(mu_high, mu_low, turns_low)
                reached = high
                first = math.ceil(min(low * shortest - turns_low, high * shortest - turns_high) - 1e-9)
                last = math.floor(max(low * longest - turns_low, high * longest - turns_high) + 1e-9)
                for k in range(first, last + 1):
                    at_low, at_high = (turns_low + k) / low, (turns_high + k) / high
                    least, most = min(at_low, at_high) * (1.0 - 1e-13), max(at_low, at_high) * (1.0 + 1e-13)
                    j = _first_at_least(period, cells, rate0, scale, least)
                    while j < period.size and period[j] < most:
                        if largest * depth[j] > 0.5:
                            x, value = _crossing(
                                low, high, period[j], k, mu_low, turns_low, turns_high,
                                x0, x1, x2, c0, c1, c2, c3, other,
                            )  # fmt: skip
                            if value.real > 0.0 and 0.5 / value.real < depth[j]:
                                depth[j] = 0.5 / value.real
                                chatter[j] = x
                                # theta is in (0, 2 pi) for the number of the lobe, whatever turn the tracking is in.
                                lobe[j] = round(x * period[j] - 0.5 - cmath.phase(value) / math.pi)
                        j += 1
                low, mu_low = high, mu_high


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


@njit(cache=True, nogil=True)
def compliance_between(frequency, matrix, start, order, at, step, out):
    """Fill out (m, 3, 3) with a matrix (n, 3, 3) at frequencies `at` (m,) on steps (m,): Lagrange's polynomial."""
    for k in range(at.size):
        first, count = start[step[k]], order[step[k]] + 1
        out[k] = 0.0
        for a in range(first, first + count):
            weight = 1.0
            for b in range(first, first + count):
                if b != a:
                    weight *= (at[k] - frequency[b]) / (frequency[a] - frequency[b])
            for i in range(3):
                for j in range(3):
                    out[k, i, j] += weight * matrix[a, i, j]


@njit(cache=True, nogil=True)
def null_vectors(m):
    """Return the vectors (n, 3) that singular matrices (n, 3, 3) send to zero."""
    out = np.empty((m.shape[0], 3), dtype=np.complex128)
    for k in range(m.shape[0]):
        a = m[k]
        out[k, 0], out[k, 1], out[k, 2] = _null_vector(
            a[0, 0], a[0, 1], a[0, 2], a[1, 0], a[1, 1], a[1, 2], a[2, 0], a[2, 1], a[2, 2]
        )
    return out
