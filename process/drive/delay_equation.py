"""Linear equations with dead times: poles, number of unstable poles, characteristic function, Pade state space.

Poles are found by Chebyshev collocation of the history and Newton's method on the exact equation; unstable poles are
counted by the argument principle on an adaptively refined imaginary axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import linalg

from process.errors import InputError
from process.types import Complex, Real

_PHASE_STEP = 0.3  # [rad] of the characteristic function between two frequencies, at most
_ROUNDS = 60  # of halving the frequency grid
_COLLOCATION = 24  # Chebyshev intervals over the longest dead time
_NEWTON = 30  # steps to an exact pole
_INDEPENDENT = 1e8  # condition number of the mode vectors up to which they are taken as a basis


def right_half_plane_zeros(
    characteristic: Callable[[Complex], Complex],
    scales: Real,
    longest_delay: float = 0.0,
) -> int:
    """Return how many zeros of a monic retarded quasi-polynomial lie in Re s > 0.

    ``r(w) = D(jw)/(jw + w0)^n`` tends to 1 for w to infinity, and its phase changes by ``-pi Z`` from 0 to there. The
    grid is refined until no step of phase exceeds 0.3 rad. A zero on the axis itself counts as unstable.

    Parameters
    ----------
    characteristic : callable
        Complex s [rad/s], shape (n,), to ``D(s)/(s + w0)^n``, n the degree of D and w0 a typical frequency.
    scales : ndarray, shape (m,)
        Frequencies [rad/s] where D changes quickly (poles without dead time).
    longest_delay : float, optional
        Longest dead time [s].
    """
    w = _contour(characteristic, scales, longest_delay)
    for _ in range(_ROUNDS):
        r = characteristic(np.asarray(1j * w, dtype=np.complex128))
        if np.any(r == 0.0):
            return max(1, _count(r[r != 0.0]))
        wide = np.abs(np.angle(r[1:] / r[:-1])) > _PHASE_STEP
        if not wide.any():
            return _count(r)
        w = np.sort(np.concatenate([w, 0.5 * (w[1:] + w[:-1])[wide]]))
    return max(1, _count(characteristic(np.asarray(1j * w, dtype=np.complex128))))


def _count(r: Complex) -> int:
    turn = float(np.sum(np.angle(r[1:] / r[:-1]))) - float(np.angle(r[-1]))
    return round(-turn / math.pi)


def _contour(
    characteristic: Callable[[Complex], Complex],
    scales: Real,
    longest_delay: float,
) -> Real:
    """First grid [rad/s]: dense around every scale, fine against the delay, far enough for r to be 1."""
    far = 20.0 * float(scales.max())
    for _ in range(60):
        if np.abs(characteristic(1j * np.array([far, 3.0 * far])) - 1.0).max() <= 0.3:
            break
        far *= 2.0
    else:
        raise InputError("the poles cannot be counted: the characteristic function does not settle at high frequency")
    near = np.outer(scales, 1.0 + np.array([-0.1, -0.03, -0.01, -0.003, 0.0, 0.003, 0.01, 0.03, 0.1])).ravel()
    even = np.arange(0.0, far, 0.25 / longest_delay)[:20000] if longest_delay > 0.0 else np.zeros(1)
    w = np.concatenate([[0.0], np.geomspace(1e-6 * float(scales.max()), far, 1500), near, even])
    return np.unique(np.clip(w, 0.0, far))


@dataclass(frozen=True)
class DelayEquation:
    """``x' = A x + B u + sum_d E_d (K_d . x(t - tau_d))``, output ``C x``.

    Parameters
    ----------
    a, b, c : ndarray
        Shapes (n, n), (n, inputs), (outputs, n).
    delayed : tuple of (float, ndarray, ndarray)
        Dead time [s], inlet E_d (n,), row K_d (n,).
    """

    a: Real
    b: Real
    c: Real
    delayed: tuple[tuple[float, Real, Real], ...] = ()

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.a.shape[0])

    @property
    def longest(self) -> float:
        """Longest dead time [s]; zero without."""
        return max((tau for tau, _, _ in self.delayed), default=0.0)

    def prompt(self) -> Real:
        """Return A as it is without its dead times."""
        return np.asarray(sum((np.outer(e, k) for _, e, k in self.delayed), self.a))

    @cached_property
    def scales(self) -> Real:
        """Frequencies [rad/s] at which the characteristic function changes quickly."""
        roots = np.concatenate([np.linalg.eigvals(self.a), np.linalg.eigvals(self.prompt())])
        sizes = np.abs(np.concatenate([roots, roots.imag]))
        return np.unique(sizes[sizes > 1e-9 * sizes.max()])

    def delta(self, s: Complex) -> Complex:
        """Return ``s I - A - sum E K exp(-s tau)``, shape (m, n, n), at complex s (m,)."""
        out = s[:, None, None] * np.eye(self.order) - self.a
        for tau, e, k in self.delayed:
            out = out - np.outer(e, k) * np.exp(-tau * s)[:, None, None]
        return np.asarray(out)

    @cached_property
    def _prompt_modes(self) -> tuple[Complex, Complex] | None:
        """Poles without dead time and residues of the delayed paths there, (n, d, d); None where they are not apart."""
        poles, vectors = np.linalg.eig(self.prompt())
        size = np.abs(poles).max(initial=0.0)
        if np.linalg.cond(vectors) > _INDEPENDENT or np.abs(poles.real).min(initial=np.inf) < 1e-9 * size:
            return None
        inlets, rows = (np.array(part) for part in list(zip(*self.delayed, strict=True))[1:])
        residues = (rows @ vectors).T[:, :, None] * np.linalg.solve(vectors, inlets.T)[:, None, :]
        return poles.astype(np.complex128), residues.astype(np.complex128)

    def characteristic(self, s: Complex) -> Complex:
        """Return ``det(delta)/(s + w0)^n`` [1] with w0 the largest of `scales`.

        With ``A_0 = A + sum E K`` it is ``det(s I - A_0) det(I + (1 - exp(-s tau)) K (s I - A_0)^-1 E)``: as large a
        determinant as there are dead times, where the poles of A_0 are apart.
        """
        w0 = float(self.scales.max())
        if self.delayed and self._prompt_modes is not None:
            poles, residues = self._prompt_modes
            away, count = s[:, None] - poles, len(self.delayed)
            taus = np.array([tau for tau, _, _ in self.delayed])
            loop = ((1.0 / away) @ residues.reshape(poles.size, -1)).reshape(s.size, count, count)
            loop = loop * -np.expm1(-s[:, None] * taus)[:, :, None]
            whole = 1.0 + loop[:, 0, 0] if count == 1 else np.linalg.det(np.eye(count) + loop)
            return np.asarray(np.prod(away / (s + w0)[:, None], axis=1) * whole)
        sign, size = np.linalg.slogdet(self.delta(s))
        with np.errstate(divide="ignore"):
            lead = np.log(s + w0) * self.order
        return np.asarray(sign * np.exp(size - lead))

    def poles(self) -> Complex:
        """Return the poles [rad/s], rightmost first.

        With dead times: eigenvalues of the equation with its history on Chebyshev points (Breda, Maset, Vermiglio
        2005), each brought onto the exact equation by Newton's method; kept are those within ``|s| < pi/tau`` of the
        longest dead time and the unstable ones.
        """
        if not self.delayed:
            found = np.linalg.eigvals(self.a).astype(np.complex128)
        else:
            found = self._polished(self._collocated())
        return np.asarray(found[np.lexsort((found.imag, -found.real))])

    def unstable_poles(self) -> int:
        """Return the number of poles in the right half plane, those on the axis too (`right_half_plane_zeros`)."""
        return right_half_plane_zeros(self.characteristic, self.scales, self.longest)

    def _collocated(self) -> Complex:
        n, m = self.order, _COLLOCATION
        points = 0.5 * self.longest * (np.cos(np.pi * np.arange(m + 1) / m) - 1.0)
        matrix = np.kron(_chebyshev_derivative(m) * 2.0 / self.longest, np.eye(n))
        matrix[:n] = 0.0
        matrix[:n, :n] = self.a
        for tau, e, k in self.delayed:
            for j, weight in enumerate(_lagrange(points, -tau)):
                matrix[:n, j * n : (j + 1) * n] += weight * np.outer(e, k)
        return np.asarray(np.linalg.eigvals(matrix))

    def _polished(self, start: Complex) -> Complex:
        near = math.pi / self.longest
        s = start[(np.abs(start) < 1.2 * near) | (start.real > -0.05 * near)]
        s = s[s.imag > -1e-9 * near].astype(np.complex128)
        change = np.full(s.shape, np.inf, dtype=np.complex128)
        for _ in range(_NEWTON):
            # Newton on det: d log det = trace(delta^-1 d delta), from a point beside s: at a pole delta is singular.
            s = s + 1e-8 * (np.abs(s) + 1e-3 * near) * (1.0 + 1.0j)
            slope = np.broadcast_to(np.eye(self.order), (s.size, self.order, self.order)).astype(np.complex128)
            for tau, e, k in self.delayed:
                slope = slope + np.outer(e, k) * (tau * np.exp(-tau * s))[:, None, None]
            change = 1.0 / np.trace(np.linalg.solve(self.delta(s), slope), axis1=1, axis2=2)
            s = s - np.where(np.isfinite(change), change, 0.0)
            inside = np.abs(s) < 4.0 * near
            s, change = s[inside], change[inside]
        good = (np.abs(change) < 1e-7 * np.abs(s) + 1e-9 * near) & ((np.abs(s) < near) | (s.real > 0.0))
        kept: list[complex] = []
        for value in s[good]:
            value = complex(value.real, 0.0) if abs(value.imag) < 1e-7 * abs(value) else complex(value)
            if all(abs(value - other) > 1e-6 * max(abs(value), 1e-9 * near) for other in kept):
                kept.append(value)
        pairs = [v for value in kept for v in ((value, value.conjugate()) if value.imag > 0.0 else (value,))]
        return np.array(pairs, dtype=np.complex128)

    def state_space(self, pade_order: int) -> tuple[Real, Real, Real]:
        """Return A, B, C with every dead time replaced by a Pade fraction of `pade_order`."""
        a, b, c = self.a, self.b, self.c
        for tau, e, k in self.delayed:
            lag, inlet, outlet, through = _pade(tau, pade_order)
            n, p = a.shape[0], lag.shape[0]
            wide_e, wide_k = np.zeros(n), np.zeros(n)
            wide_e[: e.size], wide_k[: k.size] = e, k
            a = np.block(
                [[a + through * np.outer(wide_e, wide_k), np.outer(wide_e, outlet)], [np.outer(inlet, wide_k), lag]]
            )
            b, c = np.vstack([b, np.zeros((p, b.shape[1]))]), np.hstack([c, np.zeros((c.shape[0], p))])
        return a, b, c


def oscillations(poles: Complex) -> Real:
    """Return natural frequency ``|s|/2 pi`` [Hz] and damping ratio ``-Re s/|s|`` of each oscillating pole [rad/s].

    Shape (modes, 2), sorted by frequency; negative damping is an unstable pole.
    """
    s = poles[poles.imag > 1e-9 * np.abs(poles)]
    table = np.stack([np.abs(s) / (2.0 * np.pi), -s.real / np.abs(s)], axis=1)
    return np.asarray(table[np.argsort(table[:, 0])])


def _chebyshev_derivative(order: int) -> Real:
    """Return the differentiation matrix on the points cos(pi i/order), i = 0..order (Trefethen 2000, p. 54)."""
    x = np.cos(np.pi * np.arange(order + 1) / order)
    c = np.ones(order + 1)
    c[0] = c[-1] = 2.0
    c *= (-1.0) ** np.arange(order + 1)
    d = np.outer(c, 1.0 / c) / (x[:, None] - x[None, :] + np.eye(order + 1))
    return np.asarray(d - np.diag(d.sum(axis=1)))


def _lagrange(points: Real, at: float) -> Real:
    """Weights of the interpolation from Chebyshev points to one place (barycentric)."""
    distance = at - points
    if np.any(distance == 0.0):
        return np.asarray(distance == 0.0, dtype=float)
    weights = (-1.0) ** np.arange(points.size)
    weights[0] *= 0.5
    weights[-1] *= 0.5
    terms = weights / distance
    return np.asarray(terms / terms.sum())


def _pade(tau: float, order: int) -> tuple[Real, Real, Real, float]:
    """State space (A, b, c, d) of the diagonal Pade fraction of ``exp(-s tau)``, balanced in time units of tau."""
    i = np.arange(order + 1)
    total = [math.comb(order, int(k)) * math.factorial(2 * order - int(k)) / math.factorial(2 * order) for k in i]
    denominator = np.array(total)
    numerator = denominator * (-1.0) ** i
    # Monic in s tau, descending powers for the companion form.
    den, num = denominator[::-1] / denominator[-1], numerator[::-1] / denominator[-1]
    through = float(num[0])
    rest = num[1:] - through * den[1:]
    a = np.zeros((order, order))
    a[0] = -den[1:]
    a[1:, :-1] = np.eye(order - 1)
    balanced, (scale, _) = linalg.matrix_balance(a, permute=False, separate=True)
    first = np.zeros(order)
    first[0] = 1.0
    return np.asarray(balanced / tau), np.asarray(first / scale / tau), np.asarray(rest * scale), through
