"""Maximum-likelihood fit of common poles to all curves of a matrix, with residues and remainders solved for.

    H_g(w) = sum_p [ R_pg / (j w - s_p) + conj(R_pg) / (j w - conj(s_p)) ] + remainders,
    s_p = 2 pi f_p (-zeta_p + j sqrt(1 - zeta_p^2))

with complex residues R. **Remainders** stand for the modes outside the band. Over a whole record they are
``U_g u(w) + L_g l(w)`` with real U for the modes above, L for those below and for rigid motion. A constant and
``-1/w^2`` are usual for the two. Here each is a mode far from the band,

    u(w) = 1/(1 - (f/f_u)^2 + 2 j zeta_u f/f_u), f_u = 4 f_last;    l(w) = the same with f_l = f_first/10000,

which differ from the usual ones by 13 % and 2e-7 of the remainder at most, and leave a model that is stable and
strictly proper. Over a window of lines a complex straight line ``c_g + d_g (f - f_c)`` stands for all other modes.

The model is linear in residues and remainders, so that only f_p and zeta_p are searched: Gauss-Newton with Marquardt's
damping on the projected residual (variable projection, Golub and Pereyra 1973; Kaufman 1975). The covariance of the
poles is that of the projected problem, with the errors that entries of one row share (a sandwich); that of the residues
follows from it.

Whole matrices (`smfe.modes.fit_modes`), windows around one mode (`smfe.modes.likelihood_ratio`) and single peaks
(`smfe.comparison.peaks`) are fitted by this module; `descend` serves mode shapes and the rational model of a sweep too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from process.types import Complex, Real
from smfe.modes.response_matrix import Curves
from smfe.modes.rules import RULES

# --- the step --------------------------------------------------------------------------------------------------------


class _WithChi(Protocol):
    @property
    def chi(self) -> float: ...


Fit = TypeVar("Fit", bound=_WithChi)


def damped_step(gram: Any, gradient: Any, damping: float) -> Any:
    """Return the step of unknowns that are in units of one size; none along what does not change the model."""
    diagonal = np.diag(np.diag(gram) + 1e-12 * np.trace(gram))
    return np.linalg.lstsq(gram + damping * diagonal, gradient, rcond=None)[0]


def scaled_step(gram: Any, gradient: Any, damping: float) -> Any:
    """Return the step of unknowns of any units: the curvature is scaled to a unit diagonal first."""
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-30 * np.trace(gram)))
    damped = gram / np.outer(scale, scale) + damping * np.eye(scale.size)
    return np.linalg.lstsq(damped, gradient / scale, rcond=None)[0] / scale


@dataclass(frozen=True)
class Descent:
    """When Gauss-Newton steps are damped, and when they end.

    Parameters
    ----------
    iterations, tries : int, optional
        Steps at most, and dampings that are tried for each.
    share, fall : float, optional
        Converged when a step gains no more than this share of chi, or no more than this.
    damping, growth, shrink, least : float, optional
        Marquardt's damping of the first step as a share of the curvature; factor on it when chi would rise, divisor
        when chi falls; least damping that grows.
    step : callable, optional
        Curvature (k, k), descent direction (k,) and damping -> step (k,).
    """

    iterations: int = 40
    tries: int = 8
    share: float = 1e-7
    fall: float = 0.0
    damping: float = 1e-3
    growth: float = 6.0
    shrink: float = 10.0
    least: float = 1e-6
    step: Callable[[Any, Any, float], Any] = damped_step


def descend(
    fit: Fit, normal: Callable[[Fit], tuple[Any, Any]], moved: Callable[[Fit, Any], Fit], rules: Descent
) -> Fit:
    """Return the nearest least of chi (Gauss-Newton with Marquardt's damping).

    Parameters
    ----------
    fit : object with ``chi``
        Start.
    normal : callable
        Fit -> curvature (k, k) and descent direction (k,): ``J^H J`` and ``J^H r`` of the residual r.
    moved : callable
        Fit and step (k,) -> fit there.
    rules : Descent
        Damping and convergence.
    """
    damping = rules.damping
    for _ in range(rules.iterations):
        gram, gradient = normal(fit)
        for _ in range(rules.tries):
            tried = moved(fit, rules.step(gram, gradient, damping))
            if tried.chi <= fit.chi:
                break
            damping = max(damping, rules.least) * rules.growth
        else:
            return fit
        gain, fit, damping = fit.chi - tried.chi, tried, damping / rules.shrink
        if gain <= max(rules.share * fit.chi, rules.fall):
            break
    return fit


# --- the model -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Remainders:
    """What stands in a model for the modes outside its band.

    Parameters
    ----------
    lower, upper : bool, optional
        A mode far below the band; one far above.
    line : (float, float), optional
        A complex straight line over a window: its middle and half width [Hz].
    """

    lower: bool = True
    upper: bool = True
    line: tuple[float, float] | None = None

    @property
    def count(self) -> int:
        """Real unknowns of each curve."""
        return int(self.lower) + int(self.upper) + (0 if self.line is None else 4)

    def columns(self, grid: Real, frequency: Real) -> Complex:
        """Return the columns of a fit on `grid` at other frequencies [Hz], shape (n, count)."""
        out = []
        if self.lower or self.upper:
            below, above = remainder_modes(grid)
            if self.lower:
                out.append(unit_mode(frequency, *below) / np.abs(unit_mode(grid, *below)).max())
            if self.upper:
                out.append(unit_mode(frequency, *above))
        if self.line is not None:
            x = (frequency - self.line[0]) / self.line[1] + 0.0j
            out += [np.ones_like(x), np.full_like(x, 1j), x, 1j * x]
        return np.stack(out, axis=1) if out else np.empty((frequency.size, 0), dtype=complex)


NO_REMAINDERS = Remainders(False, False)


def remainder_modes(frequency: Real) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return frequency [Hz] and damping ratio of the modes that stand for all below and all above the band."""
    first = float(frequency[frequency > 0.0][0])
    below = (RULES.lower_at * first, RULES.lower_damping)
    return below, (RULES.upper_at * float(frequency[-1]), RULES.upper_damping)


def unit_mode(frequency: Real, natural: float, damping: float) -> Complex:
    """Return ``1/(1 - r^2 + 2 j zeta r)``, ``r = f/f_n``: a mode of unit stiffness."""
    ratio = frequency / natural
    return np.asarray(1.0 / (1.0 - ratio**2 + 2j * damping * ratio))


def pole_values(poles: Real) -> Complex:
    """Return s [1/s] of poles given as rows of frequency [Hz] and damping ratio."""
    return np.asarray(2.0 * np.pi * poles[:, 0] * (-poles[:, 1] + 1j * np.sqrt(1.0 - poles[:, 1] ** 2)))


def basis(frequency: Real, poles: Real, remainders: Remainders, grid: Real | None = None) -> Complex:
    """Return the columns of the model, two a pole, then the remainders, for real coefficients; shape (n, q).

    Columns of a pole are scaled by its half bandwidth, so that all have the size of one: the residue is
    ``2 pi f zeta (a + j b)``. Remainders belong to the band of `grid`, that of the fit; default: `frequency`.
    """
    s, scale = pole_values(poles), 2.0 * np.pi * poles[:, 0] * poles[:, 1]
    jw = 2j * np.pi * frequency[:, None]
    near, far = scale / (jw - s), scale / (jw - s.conj())
    out = np.empty((frequency.size, 2 * len(poles) + remainders.count), dtype=complex)
    out[:, 0 : 2 * len(poles) : 2], out[:, 1 : 2 * len(poles) : 2] = near + far, 1j * (near - far)
    out[:, 2 * len(poles) :] = remainders.columns(frequency if grid is None else grid, frequency)
    return out


def basis_of(curves: Curves, poles: Real, remainders: Remainders) -> Complex:
    """Return the columns of the model at the lines of a record, those of merged lines averaged."""
    return curves.over_lines(lambda f: basis(f, poles, remainders, curves.frequency))


def squares(frequency: Real, poles: Real) -> Complex:
    """Return ``1/(j w - s)^2`` and ``1/(j w - conj(s))^2`` at frequencies [Hz], shape (n, 2, poles)."""
    s = pole_values(poles)
    return np.asarray(1.0 / (2j * np.pi * frequency[:, None, None] - np.stack([s, s.conj()])) ** 2)


def slopes(square: Complex, poles: Real, coefficient: Real) -> Complex:
    """Return the derivatives of some curves by frequency and damping of each pole, shape (n, 2 poles, g).

    The residues are held, and with them the scale of the columns: its change is within what the coefficients can do.

    Parameters
    ----------
    square : ndarray of complex, shape (n, 2, p)
        From `squares`.
    poles : ndarray, shape (p, 2)
        Frequency [Hz] and damping ratio.
    coefficient : ndarray, shape (g, q)
        Of the columns of `basis`.
    """
    s, scale = pole_values(poles), 2.0 * np.pi * poles[:, 0] * poles[:, 1]
    root = np.sqrt(1.0 - poles[:, 1] ** 2)
    turn = np.stack([s / poles[:, 0], 2.0 * np.pi * poles[:, 0] * (-1.0 - 1j * poles[:, 1] / root)], axis=1)
    pairs = coefficient[:, : 2 * len(poles)].reshape(len(coefficient), -1, 2)
    by = (scale[:, None] * (pairs[..., 0] + 1j * pairs[..., 1]).T)[:, None, :] * turn[:, :, None]
    out = square[:, 0, :, None, None] * by + square[:, 1, :, None, None] * by.conj()
    return np.asarray(out.reshape(len(square), 2 * len(poles), -1))


def _real(values: Complex) -> Real:
    """Return real parts over imaginary parts along the first axis."""
    return np.concatenate([values.real, values.imag])


# --- the fit ---------------------------------------------------------------------------------------------------------


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
    residual : ndarray of complex, shape (g, n)
        What the fit leaves of every curve, times its weight.
    bases : tuple of (ndarray of int, ndarray, ndarray)
        Numbers of the curves that share a decomposition, and Q and R of their columns, weighted relative to the largest
        weight of each curve.
    """

    curves: Curves = field(repr=False)
    poles: Real
    remainders: Remainders
    coefficient: Real = field(repr=False)
    chi: float
    residual: Complex = field(repr=False, compare=False)
    bases: tuple[tuple[NDArray[np.int64], Real, Real], ...] = field(repr=False, compare=False)

    @property
    def unknowns(self) -> int:
        """Real unknowns: two a pole, and the coefficients."""
        return int(self.poles.size + self.coefficient.size)

    @property
    def degrees_of_freedom(self) -> float:
        """Degrees of freedom of the residual."""
        return max(self.curves.real_data - self.unknowns, 1.0)

    @property
    def misfit(self) -> float:
        """Root of chi over its degrees of freedom: 1 when the model is right and the noise known."""
        return float(np.sqrt(self.chi / self.degrees_of_freedom))

    @property
    def inflation(self) -> float:
        """Factor on all variances: chi/dof where noise does not explain it, or where the noise is not known."""
        return inflation(self.chi, self.degrees_of_freedom, self.curves.noise_known)

    @property
    def information(self) -> float:
        """Bayesian information criterion; smaller is better (`information`)."""
        return information(self.chi, self.curves.real_data, self.unknowns)

    @cached_property
    def left(self) -> Complex:
        """What the fit leaves of every curve [m/N], shape (g, n)."""
        columns = basis_of(self.curves, self.poles, self.remainders)
        return np.asarray(self.curves.values - (columns @ self.coefficient.T).T)

    @cached_property
    def correlated_lines(self) -> float:
        """Lines over which the residual belongs together: ``1 + 2 sum rho_k^2`` over lags k (Bartlett), 1 for noise.

        What a linear model leaves of a real machine is smooth: neighbouring lines are no independent data.
        """
        return correlated_lines(self.residual)

    @property
    def shared_lines(self) -> float:
        """Lines that share an error: as stated, or as the residual has them where it is more than the noise."""
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

    def unit_covariance(self) -> Real:
        """Return the covariance of poles and coefficients of a single curve for errors as its weights say.

        Shape (2 p + q, 2 p + q); neither lines that share errors nor a misfit are in it.
        """
        ((inverse, slope, turned),) = _projected(self)
        poles = scaled_inverse(slope.T @ slope)
        follows = turned @ poles
        return np.block([[poles, follows.T], [follows, inverse @ inverse.T + follows @ turned.T]])


def inflation(chi: float, degrees_of_freedom: float, noise_known: bool) -> float:
    """Return the factor on all variances of a fit: chi/dof where it is above what noise explains, or noise not known.

    Noise explains one and two standard deviations more, ``1 + 2 sqrt(2/dof)``.
    """
    ratio = chi / degrees_of_freedom
    return ratio if not noise_known or ratio > 1.0 + 2.0 * np.sqrt(2.0 / degrees_of_freedom) else 1.0


def information(chi: float, data: float, unknowns: int) -> float:
    """Return the Bayesian information criterion; smaller is better.

    ``-2 log L + k log N`` with error levels known up to a factor on the variance that is not below one: what no linear
    model explains then counts as noise instead of calling for more poles.
    """
    factor = max(chi / data, 1.0)
    return float(data * np.log(factor) + chi / factor + unknowns * np.log(data))


def correlated_lines(left: Complex) -> float:
    """Return ``1 + 2 sum rho_k^2`` of weighted residuals, shape (g, n), over lags k up to where rho is 0.1."""
    power, n = float(np.sum(np.abs(left) ** 2)), left.shape[1]
    spectrum = np.sum(np.abs(np.fft.fft(left, 2 * n, axis=1)) ** 2, axis=0)
    rho = np.abs(np.fft.ifft(spectrum))[: n // 4] / max(power, 1e-300)
    end = int(np.argmax(rho < 0.1)) if (rho < 0.1).any() else rho.size
    return float(1.0 + 2.0 * np.sum(rho[1:end] ** 2))


def scaled_inverse(gram: Real) -> Real:
    """Return the inverse of a positive matrix, scaled to a unit diagonal first so that Hz and m/N do not meet."""
    scale = np.sqrt(np.maximum(np.diag(gram), 0.0))
    scale = np.where(scale > 0.0, scale, 1.0)
    size, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
    inverse = (vectors / np.maximum(size, 1e-14 * size[-1])) @ vectors.T
    return np.asarray(inverse / np.outer(scale, scale))


def _triangular(r: Real, right: Real) -> Real:
    """Solve a triangular system; the least squares of smallest norm where two columns coincide."""
    size = np.abs(np.diag(r))
    if size.min() > 1e-11 * size.max():
        return np.asarray(np.linalg.solve(r, right))
    return np.asarray(np.linalg.lstsq(r, right, rcond=1e-11)[0])


def solve(curves: Curves, poles: Real, remainders: Remainders) -> PoleFit:
    """Return the best residues and remainders for given poles."""
    columns, n = basis_of(curves, poles, remainders), curves.frequency.size
    coefficient = np.empty((len(curves.values), columns.shape[1]))
    residual = np.empty(curves.values.shape, dtype=complex)
    chi, bases = 0.0, []
    every = np.arange(len(curves.values))
    for which in [every] if curves.shared else np.split(every, every.size):
        size = curves.weight[which].max(axis=1)
        q, r = np.linalg.qr(_real(columns * (curves.weight[which[0]] / size[0])[:, None]))
        data = _real((curves.values[which] * curves.weight[which]).T)
        inside = q.T @ data
        left = data - q @ inside
        coefficient[which] = (_triangular(r, inside) / size).T
        residual[which] = (left[:n] + 1j * left[n:]).T
        chi += float(np.sum(left**2))
        bases.append((which, q, r))
    return PoleFit(curves, poles, remainders, coefficient, chi / curves.counted_lines, residual, tuple(bases))


def _projected(fit: PoleFit) -> Iterator[tuple[Real, Real, Real]]:
    """Yield for each curve: the inverse of R, the slopes by the poles outside the span of the columns, and inside it.

    The last, negative and in units of the coefficients, says how they follow the poles.
    """
    curves = fit.curves
    square = curves.over_lines(lambda f: squares(f, fit.poles))
    for which, q, r in fit.bases:
        unit = _triangular(r, np.eye(len(r)))
        for g in which:
            slope = slopes(square, fit.poles, fit.coefficient[[g]])[..., 0]
            weighted = _real(slope * curves.weight[g][:, None])
            inside = q.T @ weighted
            inverse = unit / curves.weight[g].max()
            yield inverse, weighted - q @ inside, -inverse @ inside


def _score_covariance(rows: list[Real], joint: Complex, weight: Real) -> Real:
    """Return the covariance of the score for errors that curves share.

    With weighted slopes a, b and circular errors, ``cov(Re a^H d, Re b^H d) = Re(a^H S b)/2``.
    """
    n = joint.shape[0]
    turned = np.stack([(m[:n] + 1j * m[n:]) * w[:, None] for m, w in zip(rows, weight, strict=True)], axis=1)
    seen = np.einsum("ngh,nhk->ngk", joint, turned)
    return np.asarray(0.5 * np.einsum("ngj,ngk->jk", turned.conj(), seen).real)


@dataclass(frozen=True)
class Bounds:
    """Between which poles are moved: frequencies [Hz], for all poles or for each, and damping ratios."""

    low: float | Real
    high: float | Real
    least_damping: float = RULES.least_damping
    most_damping: float = RULES.most_damping


def refine(fit: PoleFit, rules: Descent | int = 40, bounds: Bounds | None = None) -> PoleFit:
    """Return the fit at the nearest least of chi over frequencies and damping ratios.

    Steps are in half-power widths and logarithms of damping: one means something everywhere, and no step is longer.

    Parameters
    ----------
    fit : PoleFit
        Start.
    rules : Descent or int, optional
        Damping and convergence, or only how many steps at most.
    bounds : Bounds, optional
        Default: the band and half of it beyond.
    """
    if not len(fit.poles):
        return fit
    f = fit.curves.frequency
    high = float(f[-1]) * RULES.beyond
    within = bounds or Bounds(max(float(f[0]) / RULES.beyond, 1e-6 * high), high)

    def moved(at: PoleFit, step: Real) -> PoleFit:
        change = np.clip(step.reshape(-1, 2), -1.0, 1.0)
        natural, damping = at.poles.T
        poles = np.stack([natural * (1.0 + 2.0 * damping * change[:, 0]), damping * np.exp(change[:, 1])], axis=1)
        poles[:, 0] = np.clip(poles[:, 0], within.low, within.high)
        poles[:, 1] = np.clip(poles[:, 1], within.least_damping, within.most_damping)
        return solve(at.curves, poles, at.remainders)

    return descend(fit, _normal, moved, rules if isinstance(rules, Descent) else Descent(rules))


def _normal(fit: PoleFit) -> tuple[Real, Real]:
    """Return Gram matrix and gradient of the projected problem in half-power widths and logarithms of damping."""
    curves, size = fit.curves, fit.poles.size
    unit = np.stack([2.0 * fit.poles[:, 0] * fit.poles[:, 1], fit.poles[:, 1]], axis=1).ravel()
    gram, gradient = np.zeros((size, size)), np.zeros(size)
    square = curves.over_lines(lambda f: squares(f, fit.poles))
    for which, q, _ in fit.bases:
        # Some curves at a time: the slopes of a large matrix would not fit into memory.
        for part in np.array_split(which, -(-which.size * size * curves.frequency.size // 1_000_000)):
            slope = slopes(square, fit.poles, fit.coefficient[part]) * curves.weight[part].T[:, None]
            weighted = (_real(slope) * unit[:, None]).reshape(len(q), -1)
            outside = (weighted - q @ (q.T @ weighted)).reshape(len(q), size, -1)
            flat = outside.transpose(1, 2, 0).reshape(size, -1)
            gram += flat @ flat.T
            gradient += flat @ _real(fit.residual[part].T).T.ravel()
    return gram, gradient


def without(fit: PoleFit, number: int) -> PoleFit:
    """Return the fit without one of its poles."""
    return solve(fit.curves, np.delete(fit.poles, number, axis=0), fit.remainders)


def sorted_fit(fit: PoleFit) -> PoleFit:
    """Return the fit with rising frequencies."""
    return solve(fit.curves, fit.poles[np.argsort(fit.poles[:, 0])], fit.remainders)
