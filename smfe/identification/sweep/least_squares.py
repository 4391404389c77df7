"""Weighted least squares at a frequency: the core that every sweep estimator shares.

``X = Phi F + noise`` with one column a line, segment or harmonic of a test. Rows of Phi are solved one by one because
the noise of x, y and z differs; columns are weighted with the inverse noise level of their test: :eq:`sweep`,
:eq:`sweep-covariance`.

`solve`
    takes the columns themselves, by QR: for few of them, and where their noise is correlated (segments that overlap).
`bin_lines`, `ring`, `solve_bands`
    sum normal equations in narrow bins of frequency, from which come all bands, all weights and all models. Over a bin
    the response to every input is a polynomial in the distance to the centre of the bin,
    ``X_i = sum_j sum_p c_ijp t^p u_j + noise``, ``t = f - f_bin``. Sums over the lines of a bin of
    ``conj(u t^p) u t^q``, ``conj(u t^p) X`` and ``|X|^2`` are all that any later step needs: a polynomial about another
    frequency is one about the bin (binomial theorem), so a band is a sum of shifted bins, and a record of any length
    costs its transform and one pass over its lines. Normal equations square the condition number of the forces; it is
    refused above 200, so eleven digits are left.

Sources: theory of multiple-input least squares, ``Cov(Phi_i) = s_i^2 (F W F^H)^-1`` (Pintelon and Schoukens, System
Identification, 2012); multiple coherence adjusted for the number of columns M and unknowns p,
``1 - (1 - g2) M/(M - p)`` (:eq:`adjusted-coherence`), because M columns of pure noise have ``E[g2] = p/M``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from numpy.typing import NDArray

from process.types import Complex, Real
from smfe.identification.sweep.delay import Delay


@dataclass(frozen=True)
class Estimate:
    """A compliance before it is labelled.

    Parameters
    ----------
    compliance : ndarray of complex, shape (f, r, e)
        [m/N].
    covariance : ndarray of complex, shape (f, r, e, e)
        ``E[d_j conj(d_k)]`` within a row [m2/N2].
    coherence : ndarray, shape (f, r)
        Adjusted multiple coherence.
    condition : ndarray, shape (f,)
        Of the forces.
    error_lines : float
        Lines that share an error.
    half_width : ndarray, shape (f, r), optional
        Half of the band each row comes from [Hz].
    degrees_of_freedom : ndarray, shape (f, r), optional
        Degrees of freedom of Student's t for each part: real ones of the variance, whose errors are circular.
    warnings : tuple of str
        What the user should know.
    between : ndarray of complex, shape (f, r, e, r, e), optional
        Covariance of the errors of two rows, zero within a row [m2/N2].
    delay : Delay, optional
        Of the motion against the force, where the estimator sees it.
    """

    compliance: Complex
    covariance: Complex
    coherence: Real
    condition: Real
    error_lines: float
    half_width: Real | None = None
    degrees_of_freedom: Real | None = None
    warnings: tuple[str, ...] = ()
    between: Complex | None = None
    delay: Delay | None = None

    @property
    def std(self) -> Real:
        """Root mean square of the complex error [m/N], shape (f, r, e)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=2, axis2=3).real, 0.0))


def condition_number(force: Complex) -> float:
    """Return the ratio of largest to smallest singular value of force columns, shape (e, M)."""
    singular = np.linalg.svd(force, compute_uv=False)
    smallest = float(singular[-1]) if force.shape[1] >= force.shape[0] else 0.0
    return float("inf") if smallest == 0.0 else float(singular[0]) / smallest


# --- columns ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Columns:
    """What one frequency has to be solved from.

    Parameters
    ----------
    regressors : ndarray of complex, shape (p, M)
        The three forces first, then nuisance regressors (slopes over frequency, transients).
    response : ndarray of complex, shape (r, M)
        Displacements.
    test : ndarray of int, shape (M,)
        Which test a column belongs to.
    correlation : ndarray of complex, shape (M, M), optional
        Correlation of the noise between columns (overlapping segments). Default: none.
    """

    regressors: Complex
    response: Complex
    test: NDArray[np.int64]
    correlation: Complex | None = None


@dataclass(frozen=True)
class Solution:
    """Estimate at one frequency.

    Parameters
    ----------
    compliance : ndarray of complex, shape (r, e)
        Compliance [m/N].
    covariance : ndarray of complex, shape (r, e, e)
        Covariance of the complex errors of each row, ``E[d_j conj(d_k)]`` [m2/N2].
    coherence : ndarray, shape (r,)
        Adjusted multiple coherence.
    condition : float
        Largest over smallest singular value of the force columns.
    residual : ndarray, shape (r, tests)
        Mean square residual of each response in each test.
    degrees_of_freedom : ndarray, shape (r,)
        Degrees of freedom of Student's t that the error of each part (real, imaginary) over its standard deviation
        follows: ``2 (M - p)`` for uncorrelated columns, fewer where they share noise.
    """

    compliance: Complex
    covariance: Complex
    coherence: Real
    condition: float
    residual: Real
    degrees_of_freedom: Real

    @property
    def std(self) -> Real:
        """Root mean square of the complex error of each entry [m/N], shape (r, e)."""
        variance: Real = np.diagonal(self.covariance, axis1=1, axis2=2).real
        return np.sqrt(variance)


def solve(columns: Columns, excitations: int, noise: Real | None = None) -> Solution:
    """Solve one frequency.

    Parameters
    ----------
    columns : Columns
        Regressors and responses, M columns.
    excitations : int
        How many of the first regressors are forces.
    noise : ndarray, shape (r, tests), optional
        Mean square noise of each response in each test; columns are weighted with its inverse. Default: equal.

    Returns
    -------
    Solution
        NaN throughout when there are not more columns than unknowns.
    """
    p, m = columns.regressors.shape
    rows, tests = columns.response.shape[0], int(columns.test.max()) + 1
    scale = np.sqrt(np.mean(np.abs(columns.regressors) ** 2, axis=1))
    scale[scale == 0.0] = 1.0
    unit = columns.regressors / scale[:, None]
    shape = (rows, excitations)
    estimate = np.full(shape, np.nan, dtype=complex)
    covariance = np.full((*shape, excitations), np.nan, dtype=complex)
    coherence = np.full(rows, np.nan)
    residual, degrees_of_freedom = np.full((rows, tests), np.nan), np.zeros(rows)
    condition = condition_number(columns.regressors[:excitations])
    if m <= p or not np.isfinite(condition):
        return Solution(estimate, covariance, coherence, condition, residual, degrees_of_freedom)
    for i in range(rows):
        weight = np.ones(m) if noise is None else 1.0 / np.sqrt(noise[i, columns.test])
        x = columns.response[i]
        gain, spread = _row(unit, x, weight, columns.correlation)
        left = x - gain @ unit
        expected, degrees_of_freedom[i] = _degrees_of_freedom(unit, weight, columns.correlation)
        power = float(np.sum(np.abs(weight * left) ** 2)) / expected
        estimate[i] = gain[:excitations] / scale[:excitations]
        forces = scale[:excitations]
        covariance[i] = power * spread[:excitations, :excitations] / np.outer(forces, forces)
        total = float(np.sum(np.abs(weight * x) ** 2))
        coherence[i] = 1.0 - power * m / total if total > 0.0 else np.nan
        for test in range(tests):
            mine = columns.test == test
            residual[i, test] = np.mean(np.abs(left[mine]) ** 2) * m / (m - p) if mine.any() else np.nan
    return Solution(estimate, covariance, np.clip(coherence, 0.0, 1.0), condition, residual, degrees_of_freedom)


def _row(unit: Complex, x: Complex, weight: Real, correlation: Complex | None) -> tuple[Complex, Complex]:
    """Solve one response by QR, never by normal equations; return gains and ``E[d_j conj(d_k)]`` for unit noise."""
    q, r = np.linalg.qr((unit * weight).conj().T)
    turned = np.linalg.lstsq(r, q.conj().T @ (x * weight).conj(), rcond=None)[0]
    gain = np.asarray(turned.conj(), dtype=np.complex128)
    inverse: Complex = np.linalg.pinv(r)
    if correlation is None:
        return gain, (inverse @ inverse.conj().T).conj()
    # gain = x q r^-H =: x M, so E[d_j conj(d_k)] = (M^T R conj(M))_jk for R = E[n_a conj(n_b)].
    middle = q.conj().T @ correlation.conj() @ q
    return gain, (inverse @ middle @ inverse.conj().T).conj()


def _degrees_of_freedom(unit: Complex, weight: Real, correlation: Complex | None) -> tuple[float, float]:
    """Return the expected sum of squares of the residual for unit noise, and its real degrees of freedom.

    With ``P = I - Q Q^H`` and noise of correlation R the sum has the mean ``tr(P R)`` and the variance ``tr(P R P R)``
    of circular noise; a scaled chi^2 of the same mean and variance has ``2 tr(P R)^2/tr(P R P R)`` degrees of freedom
    (Satterthwaite 1946): 2 (M - p) for uncorrelated columns.
    """
    p, m = unit.shape
    if correlation is None:
        return float(m - p), 2.0 * (m - p)
    q = np.linalg.qr((unit * weight).conj().T)[0]
    # R belongs to the noise, P to its conjugate.
    through = correlation.conj() @ q
    inner = q.conj().T @ through
    mean = max(float(m - np.trace(inner).real), 1.0)
    square = np.sum(np.abs(correlation) ** 2) - 2.0 * np.sum(np.abs(through) ** 2) + np.sum(np.abs(inner) ** 2)
    return mean, 2.0 * mean**2 / max(float(square), 1e-300)


# --- normal equations in bins of frequency ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Lines:
    """Spectra of one test at its lines.

    Parameters
    ----------
    frequency : ndarray, shape (lines,)
        [Hz], rising.
    inputs : ndarray of complex, shape (lines, j)
        Forces first, then nuisance inputs; zero where a test does not have one.
    response : ndarray of complex, shape (lines, r)
        Displacements.
    """

    frequency: Real
    inputs: Complex
    response: Complex


@dataclass(frozen=True)
class Equations:
    """Sums over the lines of each bin and test.

    Parameters
    ----------
    centre : ndarray, shape (b,)
        Centre of each bin [Hz].
    step : float
        Width of a bin [Hz].
    gram : ndarray of complex, shape (b, tests, p, j, p, j)
        ``sum conj(u_j t^p) u_k t^q``.
    cross : ndarray of complex, shape (b, tests, p, j, r)
        ``sum conj(u_j t^p) X``.
    joint : ndarray of complex, shape (b, tests, r, r)
        ``sum X_i conj(X_k)``.
    moment : ndarray, shape (b, tests, p, p)
        ``sum t^(p + q)``; the first is the number of lines.
    """

    centre: Real
    step: float
    gram: Complex
    cross: Complex
    joint: Complex
    moment: Real

    @property
    def power(self) -> Real:
        """``sum |X|^2``, shape (b, tests, r)."""
        return np.asarray(np.diagonal(self.joint, axis1=2, axis2=3).real)

    @property
    def unknowns(self) -> int:
        """Number of polynomial coefficients a row."""
        return int(self.gram.shape[2] * self.gram.shape[3])

    def without_input_noise(self, noise: Complex, with_response: Complex | None = None) -> Equations:
        """Return the equations without what noise of the inputs adds on average.

        Parameters
        ----------
        noise : ndarray of complex, shape (b, tests, j, j)
            ``E[conj(n_j) n_k]`` a line.
        with_response : ndarray of complex, shape (b, tests, j, r), optional
            ``E[conj(n_j) n_X]`` a line.
        """
        gram = self.gram - np.einsum("btpq,btjk->btpjqk", self.moment, noise)
        cross = self.cross
        if with_response is not None:
            cross = cross - np.einsum("btp,btjr->btpjr", self.moment[..., 0], with_response)
        return replace(self, gram=gram, cross=cross)


def bin_lines(tests: Sequence[Lines], edges: Real, order: int, instruments: Sequence[Lines] | None = None) -> Equations:
    """Sum the lines of all tests in bins.

    Parameters
    ----------
    tests : sequence of Lines
        With the same inputs and responses.
    edges : ndarray, shape (b + 1,)
        Equally spaced edges of the bins [Hz].
    order : int
        Order of the polynomial.
    instruments : sequence of Lines, optional
        Take the place of the conjugated inputs: what they do not hold has no part in the sums.
    """
    left = tests if instruments is None else instruments
    b, j, r, n = edges.size - 1, tests[0].inputs.shape[1], tests[0].response.shape[1], order + 1
    centre = 0.5 * (edges[1:] + edges[:-1])
    gram = np.zeros((b, len(tests), n * j, n * j), dtype=complex)
    cross = np.zeros((b, len(tests), n * j, r), dtype=complex)
    joint, moment = np.zeros((b, len(tests), r, r), dtype=complex), np.zeros((b, len(tests), n, n))
    for k, test in enumerate(tests):
        border = np.searchsorted(test.frequency, edges - 1e-9)
        for i in range(b):
            lines = slice(border[i], border[i + 1])
            terms = (test.frequency[lines] - centre[i])[:, None] ** np.arange(n)
            u = (terms[:, :, None] * test.inputs[lines, None, :]).reshape(terms.shape[0], n * j)
            x = test.response[lines]
            z = (terms[:, :, None] * left[k].inputs[lines, None, :]).reshape(u.shape)
            gram[i, k], cross[i, k] = z.conj().T @ u, z.conj().T @ x
            joint[i, k], moment[i, k] = x.T @ x.conj(), terms.T @ terms
    shape = (b, len(tests), n, j)
    return Equations(
        centre, float(edges[1] - edges[0]), gram.reshape(*shape, n, j), cross.reshape(*shape, r), joint, moment
    )


def shift_matrix(distance: float, order: int) -> Real:
    """Return S with ``c_bin = S c_centre`` for polynomials about points `distance` apart (bin minus centre)."""
    n = order + 1
    return np.array([[comb(p, q) * distance ** (p - q) if p >= q else 0.0 for p in range(n)] for q in range(n)])


@dataclass(frozen=True)
class Bands:
    """Normal equations of the bands around some frequencies.

    Parameters
    ----------
    gram : ndarray of complex, shape (f, r, k, k)
        Weighted, one a row of the compliance.
    cross : ndarray of complex, shape (f, r, k)
        Weighted.
    power : ndarray, shape (f, r)
        Weighted sum of squares of the response.
    lines : ndarray, shape (f,)
        Lines in the band.
    """

    gram: Complex
    cross: Complex
    power: Real
    lines: Real

    def __add__(self, other: Bands) -> Bands:
        """Return the sum."""
        return Bands(
            self.gram + other.gram, self.cross + other.cross, self.power + other.power, self.lines + other.lines
        )


def ring(equations: Equations, first: NDArray[np.int64], weight: Real, offsets: Sequence[int]) -> Bands:
    """Sum the bins at some offsets from each frequency.

    Parameters
    ----------
    equations : Equations
        All bins.
    first : ndarray of int, shape (f,)
        Bin whose lower edge is the frequency.
    weight : ndarray, shape (b, tests, r)
        Weight of each bin, test and row.
    offsets : sequence of int
        Bins relative to `first`.
    """
    order, r = equations.moment.shape[2] - 1, weight.shape[2]
    k = equations.unknowns
    gram = np.zeros((first.size, r, k, k), dtype=complex)
    cross = np.zeros((first.size, r, k), dtype=complex)
    power, lines = np.zeros((first.size, r)), np.zeros(first.size)
    squares = equations.power
    for offset in offsets:
        at = first + offset
        # About the frequency, whose distance to the centre of the bin is half a bin more than the offset.
        s = np.kron(shift_matrix((offset + 0.5) * equations.step, order), np.eye(k // (order + 1)))
        w = weight[at]
        tests = w.shape[1]
        # (f, r, tests) times (f, tests, k k): matrix products are several times faster than einsum here.
        weighted = w.swapaxes(1, 2) @ equations.gram[at].reshape(first.size, tests, k * k)
        gram += s.T @ weighted.reshape(gram.shape) @ s
        moved = np.sum(w[:, :, None] * equations.cross[at].reshape(first.size, tests, k, r), axis=1)
        cross += moved.swapaxes(1, 2) @ s
        power += np.sum(w * squares[at], axis=1)
        lines += equations.moment[at, :, 0, 0].sum(axis=1)
    return Bands(gram, cross, power, lines)


def solve_bands(bands: Bands) -> tuple[Complex, Complex]:
    """Return the coefficients, shape (f, r, k), and the inverse of the gram matrices, (f, r, k, k).

    Unknowns that nothing excites come out as zero; rows and columns are scaled to a unit diagonal first.
    """
    size = np.sqrt(np.maximum(np.diagonal(bands.gram, axis1=2, axis2=3).real, 0.0))
    scale = np.where(size > 1e-9 * size.max(axis=-1, keepdims=True), 1.0 / np.where(size > 0.0, size, 1.0), 0.0)
    unit = bands.gram * scale[..., :, None] * scale[..., None, :]
    silent = scale == 0.0
    unit[..., np.arange(silent.shape[-1]), np.arange(silent.shape[-1])] += silent
    finite = np.isfinite(unit).all(axis=(-1, -2))
    unit[~finite] = np.eye(unit.shape[-1])
    inverse = _inverse(unit)
    inverse = inverse * scale[..., :, None] * scale[..., None, :]
    inverse[~finite] = np.nan
    return np.einsum("frkl,frl->frk", inverse, bands.cross), inverse


def _inverse(unit: Complex) -> Complex:
    """Return inverses of matrices with a unit diagonal; of those that are singular the pseudo-inverse."""
    try:
        inverse = np.asarray(np.linalg.inv(unit), dtype=np.complex128)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(unit, rcond=1e-13, hermitian=True))
    bad = ~(np.abs(inverse).max(axis=(-1, -2)) < 1e12)
    if bad.any():
        inverse[bad] = np.linalg.pinv(unit[bad], rcond=1e-13, hermitian=True)
    return inverse


def residual_power(bands: Bands, coefficients: Complex) -> Real:
    """Return the weighted ``sum |X - c u|^2``, shape (f, r)."""
    fitted = np.einsum("frk,frkl,frl->fr", coefficients.conj(), bands.gram, coefficients, optimize=True).real
    shared = np.einsum("frk,frk->fr", coefficients.conj(), bands.cross).real
    return np.asarray(np.maximum(bands.power - 2.0 * shared + fitted, 0.0))


def residual_products(equations: Equations, coefficients: Complex) -> Complex:
    """Return ``sum (X - c u)_i conj((X - c u)_k)`` of coefficients (b, r, k) in all tests, shape (b, tests, r, r)."""
    b, t = equations.joint.shape[:2]
    k = equations.unknowns
    gram, cross = equations.gram.reshape(b, t, k, k), equations.cross.reshape(b, t, k, -1)
    shared = np.einsum("btli,bkl->btik", cross, coefficients.conj(), optimize=True)
    fitted = np.einsum("bil,btml,bkm->btik", coefficients, gram, coefficients.conj(), optimize=True)
    return np.asarray(equations.joint - shared - shared.conj().swapaxes(2, 3) + fitted)
