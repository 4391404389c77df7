"""A rational model of all lines of a sweep at once: poles that every entry shares, and a smooth remainder.

``Theta_ij(f) = sum_m A_ijm/(f - lambda_m) + sum_q B_ijq s^q`` for row i and input j, with complex poles
``lambda_m = f_m + j zeta_m f_m`` [Hz] and s the frequency on (-1, 1). The images of the poles at negative frequencies
and modes far outside are smooth and belong to the remainder; the transient of a record has the same poles and is one
more input. Weighted least squares over all bins: for given poles the rest is linear and eliminated row by row; the
poles follow by Gauss and Newton's steps (variable projection, Golub and Pereyra 1973; common-denominator models:
Pintelon and Schoukens 2012, ch. 9). Poles are added one by one while each is worth its unknowns, and so are orders of
the remainder. An order that is not worth its unknowns may still be there: with a fall of W for each unknown, of which
noise makes 1, its coefficients are W - 1 of their variances from zero, and left out they bias the model by up to
``sqrt(W - 1)`` of its own standard deviation where that of the order rules, at the ends of the band. So one order more
is fitted than pays: what is then left out is smaller by what an order brings.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from process.types import Complex, Real
from smfe.identification.sweep.least_squares import Equations, ring
from smfe.modes.pole_fit import Descent, descend


@dataclass(frozen=True)
class RationalRules:
    """How poles are found, and how many."""

    coarse: float = 0.25
    """Width of the bins that are joined to find the poles [Hz]."""
    narrow: float = 8.0
    """A pole narrower than so many of them is polished with the finest bins: its third derivative counts within one."""
    most_order: int = 6
    """Order of the smooth remainder at most."""
    most_poles: int = 12
    """Poles at most."""
    worth: float = 3.0
    """Fall of the weighted sum of squares, for each unknown of a pole, from which the pole is worth adding: noise gives
    1 to a pole at a given place and nearly 2, which is Akaike's limit, to the best of all places."""


RULES = RationalRules()


def _step(curvature: Complex, pull: Complex, damping: float) -> Complex:
    diagonal = np.maximum(np.diagonal(curvature).real, 1e-300)
    return np.asarray(np.linalg.solve(curvature + np.diag(damping * diagonal), pull))


DESCENT = Descent(8, tries=6, share=0.0, fall=0.3, growth=10.0, shrink=5.0, least=0.0, step=_step)
"""Steps of the poles each time one is added: they stay when the weighted sum of squares falls by less than 0.3, since a
fall of 1 is one standard deviation of a parameter."""


@dataclass(frozen=True)
class RationalFit:
    """A rational model that has been fitted.

    Parameters
    ----------
    poles : ndarray of complex, shape (m,)
        Poles [Hz], imaginary part ``zeta f``.
    misfit : float
        Weighted mean square of the residual; 1 where the weights are the inverse noise and the model is right.
    degrees_of_freedom : float
        Degrees of freedom of the residual, complex.
    value : ndarray of complex, shape (f, r, e)
        At the frequencies asked for [m/N].
    covariance : ndarray of complex, shape (f, r, e, e)
        Within a row, for unit noise of the weighted lines.
    linear : ndarray of complex, shape (f, r, e, e)
        The same as if the poles were known.
    between : ndarray of complex, shape (f, r, e, r, e)
        Between rows whose noise is independent: their poles are the same. Zero within a row.
    terms : int
        Functions of frequency an entry has.
    entry_degrees_of_freedom : ndarray, shape (r, e)
        Degrees of freedom of the mean square error of an entry over the frequencies: how much it scatters.
    residue : ndarray of complex, shape (m, r, e)
        Amplitude of each pole [m/N Hz].
    residue_variance : ndarray, shape (m, r, e)
        Of its complex error, for unit noise of the weighted lines.
    """

    poles: Complex
    misfit: float
    degrees_of_freedom: float
    value: Complex
    covariance: Complex
    linear: Complex
    between: Complex
    terms: int
    entry_degrees_of_freedom: Real
    residue: Complex
    residue_variance: Real


@dataclass
class _Problem:
    """Weighted bins, one gram matrix a row: shapes (r, b, p j, p j), (r, b, p j), (r,)."""

    centre: Real
    gram: Complex
    cross: Complex
    power: Real
    middle: float
    half: float
    order: int
    lines: float
    inputs: int
    narrowest: float

    @property
    def terms(self) -> int:
        return int(self.gram.shape[2]) // self.inputs


@dataclass
class _Linear:
    """Solution for given poles: amplitudes (r, n, j), inverse gram (r, n j, n j), and the sum of squares."""

    poles: Complex
    basis: Complex
    amplitude: Complex
    inverse: Complex
    gradient: Complex
    chi: float


def fit_rational(
    equations: Equations,
    raw: Equations,
    weight: Real,
    band: tuple[float, float],
    frequency: Real,
    excitations: int,
    order: int = 2,
    known: float = 0.0,
) -> RationalFit:
    """Fit a rational model to the bins of a band.

    Parameters
    ----------
    equations : Equations
        All bins, without noise of the inputs.
    raw : Equations
        All bins, with it: for the residual.
    weight : ndarray, shape (b, tests, r)
        Inverse noise power of each bin, test and row.
    band : (float, float)
        Bins that are used [Hz].
    frequency : ndarray, shape (f,)
        Where the model is evaluated [Hz].
    excitations : int
        How many of the first inputs are forces.
    order : int, optional
        Order of the smooth remainder, raised where that is worth it.
    known : float, optional
        Relative standard deviation of the noise power that was taken out of the inputs.

    Returns
    -------
    RationalFit
        With as many poles as are worth their unknowns, `RationalRules.most_poles` at most, and one order more than is.
    """
    together = max(1, round(RULES.coarse / equations.step))
    problem = _problem(equations, weight, band, order, together)
    best = _solve(problem, np.zeros(0, dtype=complex))
    each = problem.gram.shape[0] * problem.inputs
    while True:
        if best.poles.size < RULES.most_poles:
            found = _polished(problem, np.append(best.poles, _next_pole(problem, best)))
            if best.chi - found.chi > RULES.worth * (each + 1):
                best = found
                continue
        worth, (problem, best) = best.chi, _one_order_more(problem, best)
        if problem.order > RULES.most_order or not worth - best.chi > RULES.worth * each:
            break
    if together > 1 and best.poles.size and float(best.poles.imag.min()) < RULES.narrow * RULES.coarse:
        together = 1
        problem = _problem(equations, weight, band, problem.order, 1)
        best = _polished(problem, best.poles)
    return _result(problem, _problem(raw, weight, band, problem.order, together), best, known, frequency, excitations)


def _one_order_more(problem: _Problem, at: _Linear) -> tuple[_Problem, _Linear]:
    smoother = replace(problem, order=problem.order + 1)
    return smoother, _polished(smoother, at.poles)


def _problem(equations: Equations, weight: Real, band: tuple[float, float], order: int, together: int) -> _Problem:
    inside = np.flatnonzero((equations.centre > band[0]) & (equations.centre < band[1]))
    first = inside[: inside.size // together * together : together]
    # About the lower edge of a bin in the middle.
    joined = ring(equations, first + together // 2, weight, range(-(together // 2), together - together // 2))
    centre = equations.centre[first + together // 2] - 0.5 * equations.step
    return _Problem(
        centre,
        np.ascontiguousarray(joined.gram.swapaxes(0, 1)),
        np.ascontiguousarray(joined.cross.swapaxes(0, 1)),
        joined.power.sum(axis=0),
        0.5 * (band[0] + band[1]),
        0.5 * (band[1] - band[0]),
        order,
        float(joined.lines.sum()) * weight.shape[2],
        equations.gram.shape[3],
        0.5 * RULES.coarse,
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


def _spread(basis: Complex, inputs: int) -> Complex:
    """Return a basis (b, p, n) for each of the inputs, shape (b, p j, n j)."""
    b, p, n = basis.shape
    return np.asarray(np.einsum("bpn,jk->bpjnk", basis, np.eye(inputs)).reshape(b, p * inputs, n * inputs))


def _slopes(centre: Real, poles: Complex, terms: int) -> Complex:
    """Derivative of the Taylor coefficients of ``1/(f - lambda)`` with respect to lambda, shape (b, terms, m)."""
    away = 1.0 / (centre[:, None] - poles)
    return np.stack([(-1.0) ** p * (p + 1) * away ** (p + 2) for p in range(terms)], axis=1)


def _solve(problem: _Problem, poles: Complex) -> _Linear:
    """Eliminate the amplitudes row by row."""
    terms = problem.terms
    basis = _basis(problem, problem.centre, poles, terms)
    size = np.linalg.norm(basis.reshape(-1, basis.shape[2]), axis=0)
    basis = basis / size
    rows, n, j = problem.gram.shape[0], basis.shape[2], problem.inputs
    amplitude = np.empty((rows, n, j), dtype=complex)
    inverse = np.empty((rows, n * j, n * j), dtype=complex)
    gradient = np.empty(problem.cross.shape, dtype=complex)
    chi = 0.0
    wide = _spread(basis, j)
    flat = wide.reshape(-1, n * j).conj().T
    for i in range(rows):
        through = problem.gram[i] @ wide
        gram = flat @ through.reshape(-1, n * j)
        cross = flat @ problem.cross[i].ravel()
        scale = 1.0 / np.sqrt(np.maximum(np.diagonal(gram).real, 1e-300))
        scale[scale > 1e9 * scale.min()] = 0.0
        unit = gram * np.outer(scale, scale)
        inverse[i] = np.linalg.pinv(unit, rcond=1e-12, hermitian=True) * np.outer(scale, scale)
        amplitude[i] = (inverse[i] @ cross).reshape(n, j)
        gradient[i] = problem.cross[i] - through @ amplitude[i].ravel()
        chi += float(problem.power[i] - np.vdot(cross, amplitude[i].ravel()).real)
    return _Linear(poles, basis, amplitude, inverse, gradient, chi)


def _curvature(problem: _Problem, at: _Linear) -> tuple[Complex, Complex, list[Complex]]:
    """Return reduced curvature and gradient of the poles, and for each row what couples them to the amplitudes."""
    slopes = _slopes(problem.centre, at.poles, problem.terms)
    size = np.abs(at.basis[0, 0, : at.poles.size] * (problem.centre[0] - at.poles))
    m, j = at.poles.size, problem.inputs
    curvature, pull, couplings = np.zeros((m, m), dtype=complex), np.zeros(m, dtype=complex), []
    flat = _spread(at.basis, j).reshape(-1, at.basis.shape[2] * j).conj().T
    for i in range(problem.gram.shape[0]):
        change = slopes[:, :, None, :] * (size[:, None] * at.amplitude[i, :m]).T
        change = change.reshape(slopes.shape[0], -1, m)
        moved = (problem.gram[i] @ change).reshape(-1, m)
        coupling = flat @ moved
        curvature += change.reshape(-1, m).conj().T @ moved
        curvature -= coupling.conj().T @ at.inverse[i] @ coupling
        pull += change.reshape(-1, m).conj().T @ at.gradient[i].ravel()
        couplings.append(coupling)
    return curvature, pull, couplings


def _polished(problem: _Problem, poles: Complex) -> _Linear:
    """Move the poles to the nearest least of the sum of squares."""
    if not poles.size:
        return _solve(problem, poles)

    def moved(at: _Linear, step: Complex) -> _Linear:
        there = at.poles + step
        # A pole narrower than a bin is a resonance of the noise.
        return _solve(problem, there.real + 1j * np.maximum(there.imag, problem.narrowest))

    return descend(_solve(problem, poles), lambda at: _curvature(problem, at)[:2], moved, DESCENT)


def _next_pole(problem: _Problem, at: _Linear) -> complex:
    """Return the pole on a grid that alone would lower the sum of squares most."""
    low, high = problem.middle - problem.half, problem.middle + problem.half
    centre = np.arange(max(low - 0.2 * (high - low), 0.5), high + 0.2 * (high - low), max((high - low) / 60.0, 0.25))
    grid = np.concatenate([centre * (1.0 + 1j * z) for z in (0.015, 0.05)])
    shape = _basis(problem, problem.centre, grid, problem.terms)[..., : grid.size]
    gain = np.zeros(grid.size)
    j, n = problem.inputs, at.basis.shape[2]
    for i in range(problem.gram.shape[0]):
        own = _products(problem, i, shape, shape)
        coupling = _products(problem, i, at.basis[..., None], shape[:, :, None, :]).reshape(n, grid.size, j, j)
        tied = coupling.transpose(1, 0, 2, 3).reshape(grid.size, n * j, j)
        reduced = own.reshape(-1, j, j) - tied.conj().transpose(0, 2, 1) @ at.inverse[i] @ tied
        pull = np.einsum("bpc,bpj->cj", shape.conj(), at.gradient[i].reshape(*shape.shape[:2], j))
        size = np.trace(reduced, axis1=1, axis2=2).real / problem.inputs
        guarded = reduced + 1e-9 * np.maximum(size, 1e-300)[:, None, None] * np.eye(problem.inputs)
        gain += np.einsum("cj,cj->c", pull.conj(), np.linalg.solve(guarded, pull[..., None])[..., 0]).real
    return complex(grid[int(np.argmax(gain))])


def _products(problem: _Problem, row: int, left: Complex, right: Complex) -> Complex:
    """Return ``sum conj(left) G right`` over the bins, shape (functions, j, j); left and right (b, p, ...)."""
    b, p = left.shape[:2]
    j = problem.inputs
    gram = problem.gram[row].reshape(b, p, j, p, j)
    blocks: list[Complex] = []
    for one in range(p):
        for other in range(p):
            pairs = left[:, one].conj() * right[:, other]
            block = gram[:, one, :, other, :].reshape(b, j * j)
            blocks.append(pairs.reshape(b, -1).T @ block)
    return np.asarray(np.sum(blocks, axis=0)).reshape(-1, j, j)


def _residual(raw: _Problem, at: _Linear) -> float:
    """Return the weighted sum of squares of what the model leaves, noise of the inputs included."""
    wide, total = _spread(at.basis, raw.inputs), 0.0
    for i in range(raw.gram.shape[0]):
        fitted = wide @ at.amplitude[i].ravel()
        curved = np.einsum("bx,bxy,by->", fitted.conj(), raw.gram[i], fitted, optimize=True).real
        total += float(raw.power[i] - 2.0 * np.vdot(fitted, raw.cross[i]).real + curved)
    return total


def _result(
    problem: _Problem, raw: _Problem, at: _Linear, known: float, frequency: Real, excitations: int
) -> RationalFit:
    """Evaluate the model and its covariance; poles and amplitudes share their errors.

    With C the clean sums, R the raw ones and J what the poles (shared) and amplitudes (of a row) change, an error is
    ``(J^H C J)^-1 J^H e``. The lines hold the noise of the inputs, ``E[J^H e e^H J] = J^H R J``; a noise power that is
    wrong by a share of itself adds ``J^H (R - C) Theta`` of each input.
    """
    rows, n, j, m = problem.gram.shape[0], at.basis.shape[2], problem.inputs, at.poles.size
    plain = _basis(problem, frequency, at.poles, 1)[:, 0]
    size = np.linalg.norm(_basis(problem, problem.centre, at.poles, problem.terms).reshape(-1, n), axis=0)
    shape = plain / size
    value = np.einsum("fn,rnj->frj", shape, at.amplitude)[..., :excitations]
    slopes = _slopes(frequency, at.poles, 1)[:, 0]
    steep = _slopes(problem.centre, at.poles, problem.terms)
    wide = _spread(at.basis, j)
    own = n * j
    poles, couplings = np.zeros((m, m), dtype=complex), [np.zeros((own, m), dtype=complex)] * rows
    if m:
        curvature, _, couplings = _curvature(problem, at)
        poles = np.linalg.pinv(curvature, rcond=1e-12, hermitian=True)
    # What lines do to amplitudes and poles (reach), and how these scores vary, alone and together.
    reach = np.zeros((rows, frequency.size, excitations, own + m), dtype=complex)
    spread = np.zeros((rows, own + m, own + m), dtype=complex)
    wrong = np.zeros((rows, own + m, j), dtype=complex)
    residues = np.zeros((rows, m, excitations, own + m), dtype=complex)
    for i in range(rows):
        by_poles = at.inverse[i] @ couplings[i]
        change = (steep[:, :, None, :] * (at.amplitude[i, :m].T / size[:m])).reshape(*wide.shape[:2], m)
        change = change - wide @ by_poles
        both = np.concatenate([wide, change], axis=2)
        turned = both.reshape(-1, own + m).conj().T
        spread[i] = turned @ (raw.gram[i] @ both).reshape(-1, own + m)
        extra = (raw.gram[i] - problem.gram[i]) @ (wide @ at.amplitude[i].ravel())[..., None]
        wrong[i] = turned @ (extra * np.tile(np.eye(j), (problem.terms, 1))).reshape(-1, j)
        amplitudes = at.inverse[i].reshape(n, j, own)[:, :excitations]
        residues[i, ..., :own] = amplitudes[:m]
        residues[i, ..., own:] = -(by_poles @ poles).reshape(n, j, m)[:m, :excitations]
        reach[i, :, :, :own] = np.einsum("fn,njx->fjx", shape, amplitudes)
        direct = slopes[:, None, :] * (at.amplitude[i, :m].T / size[:m])
        moved = direct - np.einsum("fn,njm->fjm", shape, by_poles.reshape(n, j, m))
        reach[i, :, :, own:] = moved[:, :excitations] @ poles
    spread[:, own:, own:] = spread[:, own:, own:].sum(axis=0)
    wrong[:, own:] = wrong[:, own:].sum(axis=0)
    within = spread + known**2 * wrong @ wrong.conj().swapaxes(1, 2)
    covariance = np.einsum("rfex,rxy,rfgy->freg", reach, within, reach.conj(), optimize=True)
    scatter = np.einsum("rmex,rxy,rmey->mre", residues, within, residues.conj(), optimize=True).real
    alone = reach[..., :own]
    linear = np.einsum("rfex,rxy,rfgy->freg", alone, within[:, :own, :own], alone.conj(), optimize=True)
    between = np.zeros((frequency.size, rows, excitations, rows, excitations), dtype=complex)
    for i in range(rows):
        for k in range(rows):
            if i == k:
                continue
            shared = known**2 * wrong[i] @ wrong[k].conj().T
            shared[:own, own:] += spread[i][:own, own:]
            shared[own:, :own] += spread[k][own:, :own]
            shared[own:, own:] += spread[i][own:, own:]
            between[:, i, :, k] = np.einsum("fex,xy,fgy->feg", reach[i], shared, reach[k].conj(), optimize=True)
    left = problem.lines - rows * own - m
    misfit = _residual(raw, at) / max(left, 1.0)
    return RationalFit(
        at.poles,
        misfit,
        left,
        value,
        covariance,
        linear,
        between,
        n,
        _entry_degrees_of_freedom(reach, within),
        np.asarray(at.amplitude[:, :m, :excitations].swapaxes(0, 1) / size[:m, None, None]),
        np.asarray(scatter / size[:m, None, None] ** 2),
    )


def _entry_degrees_of_freedom(reach: Complex, spread: Complex | Real) -> Real:
    """Return the degrees of freedom of the mean square error of each entry over all frequencies, shape (r, e).

    An error of covariance C has a mean square of mean ``tr C`` and variance ``tr C^2`` (circular): that of a chi-square
    with ``2 (tr C)^2/tr C^2`` degrees of freedom (Satterthwaite 1946).
    """
    products = np.einsum("rfex,rfey->rexy", reach.conj(), reach)
    turned = spread[:, None] @ products
    mean = np.trace(turned, axis1=2, axis2=3).real
    square = np.einsum("rexy,reyx->re", turned, turned).real
    return np.asarray(2.0 * mean**2 / np.maximum(square, 1e-300))
