"""Maximum-likelihood fit of common poles to all curves of a matrix, with residues and remainders solved for.

    H_g(w) = sum_p [ R_pg / (j w - s_p) + conj(R_pg) / (j w - conj(s_p)) ] + U_g u(w) + L_g l(w),
    s_p = 2 pi f_p (-zeta_p + j sqrt(1 - zeta_p^2))

with complex residues R and real remainders: U for the modes above the band, L for those below and for rigid motion.
A constant and ``-1/w^2`` are usual for the two. Here each is a mode far from the band,

    u(w) = 1/(1 - (f/f_u)^2 + 2 j zeta_u f/f_u), f_u = 4 f_last;    l(w) = the same with f_l = f_first/10000,

which differ from the usual ones by 13 % and 2e-7 of the remainder at most, and leave a model that is stable and
strictly proper. The model is linear in R, U and L, so that only f_p and zeta_p are searched: Gauss-Newton with
Marquardt's damping on the projected residual (variable projection, Golub and Pereyra 1973; Kaufman 1975). The
covariance of the poles is that of the projected problem, with the errors that entries of one row share (a sandwich);
that of the residues follows from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from process.types import Complex, Real
from smfe.modes.response_matrix import Curves

UPPER_AT, UPPER_DAMPING = 4.0, 0.2
"""Frequency over that of the last line, and damping ratio, of the mode that stands for all above the band."""

LOWER_AT, LOWER_DAMPING = 1e-4, 1e-3
"""Frequency over that of the first line, and damping ratio, of the mode that stands for all below the band."""

GAIN = 1e-7
"""A fit has converged when a step gains no more than this share of chi: far less than one standard deviation."""

LEAST_DAMPING, MOST_DAMPING = 1e-5, 0.7
REACH = 1.5
"""Poles stay between first line / REACH and last line * REACH."""


@dataclass(frozen=True)
class Remainders:
    """Which remainders a model has: for the modes below the band, and for those above."""

    lower: bool = True
    upper: bool = True

    @property
    def count(self) -> int:
        """Real unknowns of each curve."""
        return int(self.lower) + int(self.upper)


def remainder_modes(frequency: Real) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return frequency [Hz] and damping ratio of the modes that stand for all below and all above the band."""
    first = float(frequency[frequency > 0.0][0])
    return (LOWER_AT * first, LOWER_DAMPING), (UPPER_AT * float(frequency[-1]), UPPER_DAMPING)


def unit_mode(frequency: Real, natural: float, damping: float) -> Complex:
    """Return ``1/(1 - r^2 + 2 j zeta r)``, ``r = f/f_n``: a mode of unit stiffness."""
    ratio = frequency / natural
    return np.asarray(1.0 / (1.0 - ratio**2 + 2j * damping * ratio))


def pole_values(poles: Real) -> Complex:
    """Return s [1/s] of poles given as rows of frequency [Hz] and damping ratio."""
    return np.asarray(2.0 * np.pi * poles[:, 0] * (-poles[:, 1] + 1j * np.sqrt(1.0 - poles[:, 1] ** 2)))


def basis(frequency: Real, poles: Real, remainders: Remainders, grid: Real | None = None) -> Complex:
    """Return the columns of the model, two a pole and one a remainder, for real coefficients; shape (n, q).

    Columns of a pole are scaled by its half bandwidth, so that all have the size of one: the residue is
    ``2 pi f zeta (a + j b)``. Remainders belong to the band of `grid`, that of the fit; default: `frequency`.
    """
    s, scale = pole_values(poles), 2.0 * np.pi * poles[:, 0] * poles[:, 1]
    jw = 2j * np.pi * frequency[:, None]
    near, far = scale / (jw - s), scale / (jw - s.conj())
    out = np.empty((frequency.size, 2 * len(poles) + remainders.count), dtype=complex)
    out[:, 0 : 2 * len(poles) : 2], out[:, 1 : 2 * len(poles) : 2] = near + far, 1j * (near - far)
    if remainders.count:
        out[:, 2 * len(poles) :] = remainder_columns(frequency if grid is None else grid, frequency, remainders)
    return out


def basis_of(curves: Curves, poles: Real, remainders: Remainders) -> Complex:
    """Return the columns of the model at the lines of a record, those of merged lines averaged."""
    return curves.over_lines(lambda f: basis(f, poles, remainders, curves.frequency))


def squares(curves: Curves, poles: Real) -> Complex:
    """Return ``1/(j w - s)^2`` and ``1/(j w - conj(s))^2`` at the lines of a record, shape (n, 2, poles)."""
    s = pole_values(poles)
    both = np.stack([s, s.conj()])
    return curves.over_lines(lambda f: 1.0 / (2j * np.pi * f[:, None, None] - both) ** 2)


def slopes(square: Complex, poles: Real, coefficient: Real) -> Complex:
    """Return the derivative of one curve by frequency and damping of each pole, shape (n, 2 poles).

    The scale of the columns is held: its change is within what the coefficients can do.
    """
    s, scale = pole_values(poles), 2.0 * np.pi * poles[:, 0] * poles[:, 1]
    root = np.sqrt(1.0 - poles[:, 1] ** 2)
    turn = np.stack([s / poles[:, 0], 2.0 * np.pi * poles[:, 0] * (-1.0 - 1j * poles[:, 1] / root)], axis=1)
    residue = scale * (coefficient[0 : 2 * len(poles) : 2] + 1j * coefficient[1 : 2 * len(poles) : 2])
    by = residue[:, None] * turn
    out = square[:, 0, :, None] * by + square[:, 1, :, None] * by.conj()
    return np.asarray(out.reshape(len(square), -1))


def _real(values: Complex) -> Real:
    """Return real parts over imaginary parts along the first axis."""
    return np.concatenate([values.real, values.imag])


@dataclass(frozen=True)
class PoleFit:
    """Poles with everything else solved for.

    Parameters
    ----------
    curves : Curves
        What was fitted.
    poles : ndarray, shape (p, 2)
        Natural frequency [Hz] and damping ratio.
    remainders : Remainders
        Which the model has.
    coefficient : ndarray, shape (g, q)
        Of the columns of `basis`, for each curve [m/N].
    chi : float
        Weighted sum of squares of the residual, over ``curves.counted_lines``.
    bases : tuple of (ndarray, ndarray)
        Q and R of the weighted columns of each curve.
    """

    curves: Curves = field(repr=False)
    poles: Real
    remainders: Remainders
    coefficient: Real = field(repr=False)
    chi: float
    bases: tuple[tuple[Real, Real], ...] = field(repr=False, compare=False)

    @property
    def unknowns(self) -> int:
        """Real unknowns: two a pole, and the coefficients."""
        return int(self.poles.size + self.coefficient.size)

    @property
    def freedom(self) -> float:
        """Degrees of freedom of the residual."""
        return max(self.curves.real_data - self.unknowns, 1.0)

    @property
    def misfit(self) -> float:
        """Root of chi over its degrees of freedom: 1 when the model is right and the noise known."""
        return float(np.sqrt(self.chi / self.freedom))

    @property
    def inflation(self) -> float:
        """Factor on all variances: chi/dof where chance does not explain it, or where the noise is not known."""
        ratio = self.chi / self.freedom
        chance = 1.0 + 2.0 * np.sqrt(2.0 / self.freedom)
        return ratio if not self.curves.noise_known or ratio > chance else 1.0

    @property
    def information(self) -> float:
        """Bayesian information criterion; smaller is better.

        ``-2 log L + k log N`` with error levels known up to a factor on the variance that is not below one: what no
        linear model explains then counts as noise instead of calling for more poles.
        """
        n = self.curves.real_data
        factor = max(self.chi / n, 1.0)
        return float(n * np.log(factor) + self.chi / factor + self.unknowns * np.log(n))

    @cached_property
    def left(self) -> Complex:
        """What the fit leaves of every curve [m/N], shape (g, n)."""
        columns = basis_of(self.curves, self.poles, self.remainders)
        return np.asarray(self.curves.values - (columns @ self.coefficient.T).T)

    @cached_property
    def correlated_lines(self) -> float:
        """Lines over which the residual belongs together: ``1 + 2 sum rho_k^2`` over lags k (Bartlett), 1 for noise.

        What a linear model leaves of a real machine is smooth: its lines say the same thing again.
        """
        return correlated_lines(self.left * self.curves.weight)

    @property
    def shared_lines(self) -> float:
        """Lines that share an error: as stated, and as the residual shows where it is more than the noise."""
        stated = self.curves.error_lines
        return stated if self.inflation == 1.0 else max(stated, self.correlated_lines)

    def curve_values(self, frequency: Real) -> Complex:
        """Return the model of every curve [m/N], shape (g, f), at frequencies [Hz]."""
        columns = basis(frequency, self.poles, self.remainders, self.curves.frequency)
        return np.asarray((columns @ self.coefficient.T).T)

    @cached_property
    def residue(self) -> Complex:
        """Residues R [m/(N s)], shape (p, g)."""
        scale = 2.0 * np.pi * self.poles[:, 0] * self.poles[:, 1]
        count = 2 * len(self.poles)
        return np.asarray(scale[:, None] * (self.coefficient[:, 0:count:2] + 1j * self.coefficient[:, 1:count:2]).T)

    def remainder(self, name: str) -> Real:
        """Return compliance [m/N] of the mode that stands for the "lower" or "upper" remainder at 0 Hz, shape (g,)."""
        if not getattr(self.remainders, name):
            return np.zeros(len(self.coefficient))
        if name == "upper":
            return np.asarray(self.coefficient[:, -1])
        below, _ = remainder_modes(self.curves.frequency)
        largest = np.abs(unit_mode(self.curves.frequency, *below)).max()
        return np.asarray(self.coefficient[:, 2 * len(self.poles)] / largest)

    @cached_property
    def pole_covariance(self) -> Real:
        """Covariance of (f_1 [Hz], zeta_1, f_2, ...), shape (2 p, 2 p)."""
        rows = [slope for _, slope, _ in _projected(self)]
        gram = np.asarray(sum(m.T @ m for m in rows))
        inverse = scaled_inverse(gram)
        joint = self.curves.covariance
        if joint is not None:
            gram = _score_covariance(rows, joint, self.curves.weight)
            inverse = inverse @ gram @ inverse
        return np.asarray(inverse * self.shared_lines * self.inflation)

    @property
    def pole_std(self) -> Real:
        """Standard deviations of frequency [Hz] and damping ratio, shape (p, 2)."""
        return np.sqrt(np.maximum(np.diag(self.pole_covariance), 0.0)).reshape(-1, 2)

    @cached_property
    def residue_std(self) -> Real:
        """Root mean square error of the residues [m/(N s)], shape (p, g), that of the poles included."""
        scale = 2.0 * np.pi * self.poles[:, 0] * self.poles[:, 1]
        out = np.empty((len(self.poles), len(self.coefficient)))
        own = self.shared_lines * self.inflation
        for g, (inverse, _, turned) in enumerate(_projected(self)):
            spread = own * inverse @ inverse.T + turned @ self.pole_covariance @ turned.T
            variance = np.diag(spread)[: 2 * len(self.poles)].reshape(-1, 2).sum(axis=1)
            out[:, g] = scale * np.sqrt(np.maximum(variance, 0.0))
        return out


def correlated_lines(left: Complex) -> float:
    """Return ``1 + 2 sum rho_k^2`` of weighted residuals, shape (g, n), over lags k up to where rho is 0.1."""
    power, n = float(np.sum(np.abs(left) ** 2)), left.shape[1]
    spectrum = np.sum(np.abs(np.fft.fft(left, 2 * n, axis=1)) ** 2, axis=0)
    rho = np.abs(np.fft.ifft(spectrum))[: n // 4] / max(power, 1e-300)
    end = int(np.argmax(rho < 0.1)) if (rho < 0.1).any() else rho.size
    return float(1.0 + 2.0 * np.sum(rho[1:end] ** 2))


def remainder_columns(grid: Real, frequency: Real, remainders: Remainders) -> Complex:
    """Return the columns of the remainders of a fit on `grid` at other frequencies [Hz]."""
    below, above = remainder_modes(grid)
    out = []
    if remainders.lower:
        out.append(unit_mode(frequency, *below) / np.abs(unit_mode(grid, *below)).max())
    if remainders.upper:
        out.append(unit_mode(frequency, *above))
    return np.stack(out, axis=1)


def scaled_inverse(gram: Real) -> Real:
    """Return the inverse of a positive matrix, scaled to a unit diagonal first so that Hz and m/N do not meet."""
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale = np.where(scale > 0.0, scale, 1.0)
    size, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    inverse = (vectors / np.maximum(size, 1e-14 * size[-1])) @ vectors.T
    return np.asarray(inverse / np.outer(scale, scale))


def _bases(curves: Curves, columns: Complex) -> Iterator[tuple[Real, Real]]:
    """Yield Q and R of the weighted columns of each curve; one decomposition where the weights are shared."""
    if curves.shared:
        relative = curves.weight[0] / curves.weight[0].max()
        q, r = np.linalg.qr(_real(columns * relative[:, None]))
        for weight in curves.weight:
            yield q, r * weight.max()
    else:
        for weight in curves.weight:
            yield np.linalg.qr(_real(columns * weight[:, None]))


def triangular(r: Real, right: Real) -> Real:
    """Solve a triangular system; the least squares of smallest norm where two columns coincide."""
    size = np.abs(np.diag(r))
    if size.min() > 1e-11 * size.max():
        return np.asarray(np.linalg.solve(r, right))
    return np.asarray(np.linalg.lstsq(r, right, rcond=1e-11)[0])


def solve(curves: Curves, poles: Real, remainders: Remainders) -> PoleFit:
    """Return the best residues and remainders for given poles."""
    columns = basis_of(curves, poles, remainders)
    coefficient = np.empty((len(curves.values), columns.shape[1]))
    chi = 0.0
    bases = tuple(_bases(curves, columns))
    for g, (q, r) in enumerate(bases):
        data = _real(curves.values[g] * curves.weight[g])
        inside = q.T @ data
        coefficient[g] = triangular(r, inside)
        chi += float(np.sum((data - q @ inside) ** 2))
    return PoleFit(curves, poles, remainders, coefficient, chi / curves.counted_lines, bases)


def _projected(fit: PoleFit) -> Iterator[tuple[Real, Real, Real]]:
    """Yield for each curve: the inverse of R, the slopes by the poles outside the span of the columns, and inside it.

    The last, negative and in units of the coefficients, says how they follow the poles.
    """
    curves = fit.curves
    square = squares(curves, fit.poles)
    for g, (q, r) in enumerate(fit.bases):
        slope = _real(slopes(square, fit.poles, fit.coefficient[g]) * curves.weight[g][:, None])
        inside = q.T @ slope
        inverse = triangular(r, np.eye(len(r)))
        yield inverse, slope - q @ inside, -inverse @ inside


def _score_covariance(rows: list[Real], joint: Complex, weight: Real) -> Real:
    """Return the covariance of the score for errors that curves share.

    With weighted slopes a, b and circular errors, ``cov(Re a^H d, Re b^H d) = Re(a^H S b)/2``.
    """
    n = joint.shape[0]
    turned = np.stack([(m[:n] + 1j * m[n:]) * w[:, None] for m, w in zip(rows, weight, strict=True)], axis=1)
    seen = np.einsum("ngh,nhk->ngk", joint, turned)
    return np.asarray(0.5 * np.einsum("ngj,ngk->jk", turned.conj(), seen).real)


def refine(fit: PoleFit, iterations: int = 40) -> PoleFit:
    """Return the fit at the nearest least of chi over frequencies and damping ratios.

    Steps are in half-power widths and logarithms of damping: one means something everywhere.
    """
    if not len(fit.poles):
        return fit
    low, high = fit.curves.frequency[0] / REACH, fit.curves.frequency[-1] * REACH
    damping = 1e-3
    for _ in range(iterations):
        width = 2.0 * fit.poles[:, 0] * fit.poles[:, 1]
        unit = np.stack([width, fit.poles[:, 1]], axis=1).ravel()
        gram, gradient = _normal(fit, unit)
        for _ in range(8):
            diagonal = np.diag(gram) + 1e-12 * np.trace(gram)
            step = np.linalg.lstsq(gram + damping * np.diag(diagonal), gradient, rcond=None)[0].reshape(-1, 2)
            step = np.clip(step, [-1.0, -1.0], [1.0, 1.0])
            poles = np.stack([fit.poles[:, 0] + step[:, 0] * width, fit.poles[:, 1] * np.exp(step[:, 1])], axis=1)
            poles[:, 0] = np.clip(poles[:, 0], max(low, 1e-6 * high), high)
            poles[:, 1] = np.clip(poles[:, 1], LEAST_DAMPING, MOST_DAMPING)
            tried = solve(fit.curves, poles, fit.remainders)
            if tried.chi <= fit.chi:
                break
            damping = max(damping, 1e-6) * 6.0
        else:
            return fit
        gain, fit, damping = fit.chi - tried.chi, tried, damping / 10.0
        if gain <= GAIN * fit.chi:
            break
    return fit


def _normal(fit: PoleFit, unit: Real) -> tuple[Real, Real]:
    """Return Gram matrix and gradient of the projected problem in the units of the steps."""
    curves = fit.curves
    gram, gradient = np.zeros((unit.size, unit.size)), np.zeros(unit.size)
    square = squares(curves, fit.poles)
    for g, (q, _) in enumerate(fit.bases):
        slope = _real(slopes(square, fit.poles, fit.coefficient[g]) * curves.weight[g][:, None]) * unit
        outside = slope - q @ (q.T @ slope)
        left = _real(fit.left[g] * curves.weight[g])
        gram += outside.T @ outside
        gradient += outside.T @ left
    return gram, gradient


def without(fit: PoleFit, number: int) -> PoleFit:
    """Return the fit without one of its poles."""
    return solve(fit.curves, np.delete(fit.poles, number, axis=0), fit.remainders)


def sorted_fit(fit: PoleFit) -> PoleFit:
    """Return the fit with rising frequencies."""
    return solve(fit.curves, fit.poles[np.argsort(fit.poles[:, 0])], fit.remainders)
