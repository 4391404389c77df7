"""A rational model of all lines of a sweep at once: poles that every entry shares, and a smooth remainder.

``Theta_ij(f) = sum_m A_ijm/(f - lambda_m) + sum_q B_ijq s^q`` for row i and input j, with complex poles
``lambda_m = f_m + j zeta_m f_m`` [Hz] and s the frequency on (-1, 1). The images of the poles at negative frequencies
and modes far outside are smooth and belong to the remainder; the transient of a record has the same poles and is one
more input. Weighted least squares over all bins: for given poles the rest is linear and eliminated row by row; the
poles follow by Gauss and Newton's steps (variable projection, Golub and Pereyra 1973; common-denominator models:
Pintelon and Schoukens 2012, ch. 9). Poles are added one by one while Akaike's criterion falls.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smfe.local_equations import Equations

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

MOST_POLES = 12
"""Poles at most."""

STEPS = 12
"""Steps of the poles at most, each time one is added."""

SETTLED = 1e-3
"""Relative fall of the sum of squares, in units of one unknown, at which the poles stay."""


@dataclass(frozen=True)
class RationalFit:
    """A rational model that has been fitted.

    Parameters
    ----------
    poles : ndarray of complex, shape (m,)
        Poles [Hz], imaginary part ``zeta f``.
    misfit : float
        Weighted mean square of the residual; 1 where the weights are the inverse noise and the model is right.
    freedom : float
        Degrees of freedom of the residual, complex.
    value : ndarray of complex, shape (f, r, e)
        At the frequencies asked for [m/N].
    covariance : ndarray of complex, shape (f, r, e, e)
        For unit noise of the weighted lines.
    terms : int
        Functions of frequency an entry has.
    """

    poles: Complex
    misfit: float
    freedom: float
    value: Complex
    covariance: Complex
    terms: int


@dataclass
class _Problem:
    """Weighted bins, one gram matrix a row: shapes (r, b, p, j, p, j), (r, b, p, j), (r,)."""

    centre: Real
    gram: Complex
    cross: Complex
    power: Real
    middle: float
    half: float
    order: int
    lines: float

    @property
    def inputs(self) -> int:
        return int(self.gram.shape[3])


@dataclass
class _Linear:
    """Solution for given poles: amplitudes (r, n, j), inverse gram (r, n j, n j), and the sum of squares."""

    poles: Complex
    basis: Complex
    amplitude: Complex
    inverse: Complex
    gradient: Complex
    cost: float


def fit_rational(
    equations: Equations, weight: Real, band: tuple[float, float], frequency: Real, excitations: int, order: int = 2
) -> RationalFit:
    """Fit a rational model to the bins of a band.

    Parameters
    ----------
    equations : Equations
        All bins, without noise of the inputs.
    weight : ndarray, shape (b, tests, r)
        Inverse noise power of each bin, test and row.
    band : (float, float)
        Bins that are used [Hz].
    frequency : ndarray, shape (f,)
        Where the model is evaluated [Hz].
    excitations : int
        How many of the first inputs are forces.
    order : int, optional
        Order of the smooth remainder.

    Returns
    -------
    RationalFit
        With as many poles as Akaike's criterion asks for, none at least and `MOST_POLES` at most.
    """
    problem = _problem(equations, weight, band, order)
    best = _solve(problem, np.zeros(0, dtype=complex))
    each = problem.gram.shape[0] * problem.inputs + 1
    while best.poles.size < MOST_POLES:
        pole = _next_pole(problem, best)
        found = _polished(problem, np.append(best.poles, pole))
        # Akaike: two for each real number, and the sum of squares of complex residuals counts twice.
        if not best.cost - found.cost > 2.0 * each:
            break
        best = found
    return _result(problem, best, frequency, excitations)


def _problem(equations: Equations, weight: Real, band: tuple[float, float], order: int) -> _Problem:
    inside = (equations.centre > band[0]) & (equations.centre < band[1])
    w = weight[inside]
    return _Problem(
        equations.centre[inside],
        np.einsum("btr,btpjqk->rbpjqk", w, equations.gram[inside], optimize=True),
        np.einsum("btr,btpjr->rbpj", w, equations.cross[inside], optimize=True),
        np.einsum("btr,btr->r", w, equations.power[inside]),
        0.5 * (band[0] + band[1]),
        0.5 * (band[1] - band[0]),
        order,
        float(equations.moment[inside, :, 0, 0].sum()) * weight.shape[2],
    )


def _basis(problem: _Problem, centre: Real, poles: Complex, terms: int) -> Complex:
    """Taylor coefficients about each centre, shape (b, terms, n): poles first, then powers."""
    away = 1.0 / (centre[:, None] - poles)
    out = np.empty((centre.size, terms, poles.size + problem.order + 1), dtype=complex)
    s = (centre - problem.middle) / problem.half
    for p in range(terms):
        out[:, p, : poles.size] = (-1.0) ** p * away ** (p + 1)
        for q in range(problem.order + 1):
            # d^p/df^p of s^q over p!
            factor = float(np.prod(np.arange(q - p + 1, q + 1)) / np.prod(np.arange(1, p + 1))) if q >= p else 0.0
            out[:, p, poles.size + q] = factor * s ** max(q - p, 0) / problem.half**p
    return out


def _slopes(centre: Real, poles: Complex, terms: int) -> Complex:
    """Derivative of the Taylor coefficients of ``1/(f - lambda)`` with respect to lambda, shape (b, terms, m)."""
    away = 1.0 / (centre[:, None] - poles)
    return np.stack([(-1.0) ** p * (p + 1) * away ** (p + 2) for p in range(terms)], axis=1)


def _solve(problem: _Problem, poles: Complex) -> _Linear:
    """Eliminate the amplitudes row by row."""
    terms = problem.gram.shape[2]
    basis = _basis(problem, problem.centre, poles, terms)
    size = np.linalg.norm(basis.reshape(-1, basis.shape[2]), axis=0)
    basis = basis / size
    rows, n, j = problem.gram.shape[0], basis.shape[2], problem.inputs
    amplitude = np.empty((rows, n, j), dtype=complex)
    inverse = np.empty((rows, n * j, n * j), dtype=complex)
    gradient = np.empty(problem.cross.shape, dtype=complex)
    cost = 0.0
    for i in range(rows):
        through = np.einsum("bpjqk,bqn->bpjnk", problem.gram[i], basis, optimize=True)
        gram = np.einsum("bpm,bpjnk->mjnk", basis.conj(), through, optimize=True).reshape(n * j, n * j)
        cross = np.einsum("bpm,bpj->mj", basis.conj(), problem.cross[i]).ravel()
        scale = 1.0 / np.sqrt(np.maximum(np.diagonal(gram).real, 1e-300))
        scale[scale > 1e9 * scale.min()] = 0.0
        unit = gram * np.outer(scale, scale)
        inverse[i] = np.linalg.pinv(unit, rcond=1e-12, hermitian=True) * np.outer(scale, scale)
        amplitude[i] = (inverse[i] @ cross).reshape(n, j)
        gradient[i] = problem.cross[i] - np.einsum("bpjnk,nk->bpj", through, amplitude[i])
        cost += float(problem.power[i] - np.vdot(cross, amplitude[i].ravel()).real)
    return _Linear(poles, basis, amplitude, inverse, gradient, cost)


def _curvature(problem: _Problem, at: _Linear) -> tuple[Complex, Complex, list[Complex]]:
    """Return reduced curvature and gradient of the poles, and for each row what couples them to the amplitudes."""
    slopes = _slopes(problem.centre, at.poles, problem.gram.shape[2])
    size = np.abs(at.basis[0, 0, : at.poles.size] * (problem.centre[0] - at.poles))
    m, j = at.poles.size, problem.inputs
    curvature, pull, couplings = np.zeros((m, m), dtype=complex), np.zeros(m, dtype=complex), []
    for i in range(problem.gram.shape[0]):
        change = slopes[..., None] * (size[:, None] * at.amplitude[i, :m])
        moved = np.einsum("bpjqk,bqmk->bpjm", problem.gram[i], change, optimize=True)
        coupling = np.einsum("bpn,bpjm->njm", at.basis.conj(), moved, optimize=True).reshape(-1, m)
        curvature += np.einsum("bpmj,bpjl->ml", change.conj(), moved, optimize=True)
        curvature -= coupling.conj().T @ at.inverse[i] @ coupling
        pull += np.einsum("bpmj,bpj->m", change.conj(), at.gradient[i])
        couplings.append(coupling)
    assert couplings[0].shape[0] == at.basis.shape[2] * j
    return curvature, pull, couplings


def _polished(problem: _Problem, poles: Complex) -> _Linear:
    """Move the poles downhill; damped where a step would rise (Levenberg and Marquardt)."""
    at, damping = _solve(problem, poles), 1e-3
    for _ in range(STEPS):
        curvature, pull, _ = _curvature(problem, at)
        diagonal = np.maximum(np.diagonal(curvature).real, 1e-300)
        for _ in range(6):
            step = np.linalg.solve(curvature + np.diag(damping * diagonal), pull)
            moved = at.poles + step
            # A pole on the real axis or below would grow with time: keep it a thousandth above.
            moved = moved.real + 1j * np.maximum(moved.imag, 1e-3 * np.abs(moved.real) + 1e-3)
            new = _solve(problem, moved)
            if new.cost < at.cost:
                break
            damping *= 10.0
        else:
            return at
        fallen, at, damping = at.cost - new.cost, new, damping / 5.0
        if fallen < SETTLED * problem.gram.shape[0] * problem.inputs:
            return at
    return at


def _next_pole(problem: _Problem, at: _Linear) -> complex:
    """Return the pole on a grid that alone would lower the sum of squares most."""
    low, high = problem.middle - problem.half, problem.middle + problem.half
    centre = np.arange(max(low - 0.2 * (high - low), 0.5), high + 0.2 * (high - low), max((high - low) / 60.0, 0.25))
    grid = np.concatenate([centre * (1.0 + 1j * z) for z in (0.01, 0.03, 0.08)])
    shape = _basis(problem, problem.centre, grid, problem.gram.shape[2])[..., : grid.size]
    gain = np.zeros(grid.size)
    for i in range(problem.gram.shape[0]):
        moved = np.einsum("bpjqk,bqc->bpjck", problem.gram[i], shape, optimize=True)
        own = np.einsum("bpc,bpjck->cjk", shape.conj(), moved, optimize=True)
        coupling = np.einsum("bpn,bpjck->njck", at.basis.conj(), moved, optimize=True)
        coupling = coupling.reshape(-1, grid.size, problem.inputs).transpose(1, 0, 2)
        reduced = own - coupling.conj().transpose(0, 2, 1) @ at.inverse[i] @ coupling
        pull = np.einsum("bpc,bpj->cj", shape.conj(), at.gradient[i])
        size = np.trace(reduced, axis1=1, axis2=2).real / problem.inputs
        guarded = reduced + 1e-9 * np.maximum(size, 1e-300)[:, None, None] * np.eye(problem.inputs)
        gain += np.einsum("cj,cj->c", pull.conj(), np.linalg.solve(guarded, pull[..., None])[..., 0]).real
    return complex(grid[int(np.argmax(gain))])


def _result(problem: _Problem, at: _Linear, frequency: Real, excitations: int) -> RationalFit:
    """Evaluate the model and its covariance; poles and amplitudes share their errors."""
    rows, n, j, m = problem.gram.shape[0], at.basis.shape[2], problem.inputs, at.poles.size
    plain = _basis(problem, frequency, at.poles, 1)[:, 0]
    size = np.linalg.norm(_basis(problem, problem.centre, at.poles, problem.gram.shape[2]).reshape(-1, n), axis=0)
    shape = plain / size
    value = np.einsum("fn,rnj->frj", shape, at.amplitude)[..., :excitations]
    covariance = np.empty((frequency.size, rows, excitations, excitations), dtype=complex)
    if m:
        curvature, _, couplings = _curvature(problem, at)
        poles = np.linalg.pinv(curvature, rcond=1e-12, hermitian=True)
    slopes = _slopes(frequency, at.poles, 1)[:, 0]
    for i in range(rows):
        whole = at.inverse[i].reshape(n, j, n, j)[:, :excitations, :, :excitations]
        covariance[:, i] = np.einsum("fm,mjnk,fn->fjk", shape, whole, shape.conj(), optimize=True)
        if not m:
            continue
        follow = (at.inverse[i] @ couplings[i]).reshape(n, j, m)
        direct = slopes[:, None, :] * (at.amplitude[i, :m].T / size[:m])[None]
        moved = (direct - np.einsum("fn,njm->fjm", shape, follow))[:, :excitations]
        covariance[:, i] += np.einsum("fjm,ml,fkl->fjk", moved, poles, moved.conj(), optimize=True)
    freedom = problem.lines - rows * n * j - m
    return RationalFit(at.poles, at.cost / max(freedom, 1.0), freedom, value, covariance, n)
