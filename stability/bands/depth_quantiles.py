"""Bands on the limit depth: from the errors of compliance and coefficients to quantiles and to a depth that is safe.

Two ways. `sampled_band` draws errors with a seed and solves the zero-order limit anew for each: no linearisation, lobes
may change places. `linearised_band` takes first derivatives of the eigenvalue at every crossing that could become the
lowest::

    d mu = w^H (dA0 Phi + A0 dPhi) u / (w^H u)         A0 Phi u = mu u,  w^H A0 Phi = mu w^H
    d(1/(2 a)) = Re[(1 - j k/mu) d mu],                k = Re(mu') / (pi T - Im(mu'/mu))

(the second term is the shift of the chatter frequency along the phase condition), and takes the minimum over these
crossings, whose errors are correlated. Source: first-order perturbation of eigenvalues, :eq:`eigenvalue-change`.

A limit is the lowest of many crossings, so that noise makes it too low on the average: the estimate once, its samples
twice. Quantiles of the samples are therefore corrected for their median (Efron 1987, bias-corrected percentiles).

A factor ``exp(s z)`` on all coefficients together needs no samples: every limit is divided by it,
:eq:`coefficient-error`, so that the limit is distributed as a mixture over the samples a_i of the compliance::

    P(limit < a) = mean_i Phi(ln(a/a_i) / s)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, ndtri

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import label
from process.machine.modes import ModalModel
from process.types import Complex, Real
from stability.bands.error_model import ErrorModel, ModalError, Spread, changed_coefficients, measured_error
from stability.bands.rules import RULES
from stability.methods.vibration_mode import modal_samples
from stability.methods.zero_order_branches import Branches, eigenvalue_branches
from stability.problem import Cut, Samples, check_spindle_speed, complete_samples, modes_of, pattern_of_pitch

QUANTILES: tuple[float, ...] = (0.05, 0.5, 0.95)
"""Quantiles of a lobe table."""

SAFE_PROBABILITY = 0.95
"""Probability with which the safe depth is stable."""


@dataclass(frozen=True)
class _Problem:
    """A cut, the best compliance, and the errors of both."""

    cut: Cut
    samples: Samples
    error: ErrorModel
    spread: Spread
    speed: Real

    @property
    def moves(self) -> bool:
        """Whether anything else than the common factor of the coefficients is uncertain."""
        measured = not isinstance(self.error, ModalError)
        return measured or bool(self.spread.modal.any() or any(self.spread.coefficients))

    @property
    def delay(self) -> Real:
        """Angle of each tooth behind the one before [rad]."""
        return pattern_of_pitch(self.cut.tool).delay

    def depths(self, matrix: Complex, coefficients: CuttingCoefficients) -> Real:
        """Return the zero-order limit [m] at all speeds for one compliance and one work material."""
        directional = replace(self.cut, coefficients=coefficients).directional_matrix()
        branches = eigenvalue_branches(replace(self.samples, matrix=matrix), directional)
        turn = 60.0 / self.speed
        if not self.cut.tool.equal_pitch:
            return np.array([branches.first_crossing(self.delay / (2.0 * math.pi) * t)[0] for t in turn])
        rising = np.argsort(turn, kind="stable")
        depth = np.empty_like(turn)
        depth[rising] = branches.envelope(turn[rising] / self.cut.tool.teeth)[0]
        return depth


def sampled_band(
    compliance: xr.Dataset | ModalModel,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: ArrayLike,
    spread: Spread | None = None,
    *,
    quantiles: Sequence[float] = QUANTILES,
    safe_probability: float = SAFE_PROBABILITY,
    count: int = 200,
    seed: int = 0,
) -> xr.Dataset:
    """Return the zero-order limit with its quantiles and a safe depth, by sampling.

    Parameters
    ----------
    compliance : xarray.Dataset or ModalModel
        Measured, with ``compliance_std`` and, where known, ``compliance_covariance``, ``entry_covariance``,
        ``half_width``, ``attrs["error_lines"]``; or a machine as modes, whose errors `spread` gives.
    tool, arc, coefficients
        The cut; any pitch.
    spindle_speed : array_like, shape (speeds,)
        Spindle speeds [rpm].
    spread : Spread, optional
        Relative standard deviations of coefficients and modes. Default: none.
    quantiles : sequence of float, optional
        Quantiles of the limit depth, each between 0 and 1.
    safe_probability : float, optional
        Probability with which the true limit lies at or above ``safe_depth``.
    count : int, optional
        Samples.
    seed : int, optional
        Of the random numbers: the same seed gives the same band.

    Returns
    -------
    xarray.Dataset
        ``limit_depth`` [mm], ``limit_depth_quantile(quantile, spindle_speed)`` [mm] and ``safe_depth`` [mm] over
        ``spindle_speed``; ``attrs``: "method", "safe_probability", "samples", "seed". The safe depth is the quantile
        ``1 - safe_probability``, but never above the limit itself nor above its 5 % quantile. Quantiles are inf where
        so many samples have no limit within the data.

    Raises
    ------
    InputError
        As `stability.methods.zero_order`; when nothing is uncertain, or the compliance carries no errors.
    """
    if count < 20:
        raise InputError(f"{count} samples give no quantile; give at least 20, better 200")
    levels = checked_levels(quantiles, safe_probability)
    problem = _problem(compliance, Cut(tool, arc, coefficients), spindle_speed, spread or Spread())
    nominal = problem.depths(problem.samples.matrix, coefficients)
    generator = np.random.default_rng(seed)
    # A common factor alone moves no sample: one is as good as all.
    drawn = np.empty((count if problem.moves else 1, problem.speed.size))
    for i, steps in enumerate(_stratified(generator, drawn.shape[0])):
        work = changed_coefficients(coefficients, problem.spread, steps)
        drawn[i] = problem.depths(problem.samples.matrix + problem.error.draw(generator), work)
    found = corrected_quantiles(drawn, nominal, levels, problem.spread.common)
    out = _labelled("sampled", problem, nominal, levels, found, safe_probability, {"samples": count, "seed": seed})
    out.attrs["warnings"] += bias_warning(drawn, nominal)
    return out


def linearised_band(
    compliance: xr.Dataset | ModalModel,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: ArrayLike,
    spread: Spread | None = None,
    *,
    quantiles: Sequence[float] = QUANTILES,
    safe_probability: float = SAFE_PROBABILITY,
    seed: int = 0,
) -> xr.Dataset:
    """Return what `sampled_band` does, from first derivatives: for small errors, fast, equal pitch.

    Parameters
    ----------
    compliance, tool, arc, coefficients, spindle_speed, spread, quantiles, safe_probability, seed
        As `sampled_band`; equally spaced teeth.

    Returns
    -------
    xarray.Dataset
        As `sampled_band`.

    Raises
    ------
    InputError
        As `sampled_band`, and for unequal pitch.
    """
    levels = checked_levels(quantiles, safe_probability)
    problem = _problem(compliance, Cut(tool, arc, coefficients), spindle_speed, spread or Spread())
    problem.cut.require_equal_pitch("the linearised band")
    nominal = problem.depths(problem.samples.matrix, coefficients)
    branches = eigenvalue_branches(problem.samples, problem.cut.directional_matrix())
    crossings = _lowest_crossings(branches, 60.0 / (tool.teeth * problem.speed))
    value, shared, covariance = _linear_errors(problem, branches, crossings)
    generator = np.random.default_rng(seed)
    size, vectors = np.linalg.eigh(covariance)
    factor = vectors * np.sqrt(np.maximum(size, 0.0))[..., None, :]
    found = np.empty((len(levels), problem.speed.size))
    common = generator.standard_normal((RULES.linear_draws, shared.shape[-1]))
    for s in range(problem.speed.size):
        own = generator.standard_normal((RULES.linear_draws, value.shape[1]))
        half_inverse = (value[s] + own @ factor[s].T + common @ shared[s].T).max(axis=1)
        found[:, s] = _depth_quantiles(half_inverse, levels, problem.spread.common)
    return _labelled("linearised", problem, nominal, levels, found, safe_probability, {"seed": seed})


def exact_band(lobes: xr.Dataset) -> xr.Dataset:
    """Return the band of limits that are declared to be exact: every quantile is the limit itself.

    Parameters
    ----------
    lobes : xarray.Dataset
        ``limit_depth(spindle_speed)`` [mm] of any method.
    """
    limit = lobes["limit_depth"]
    quantiles = limit.expand_dims(quantile=list(QUANTILES))
    named = {"limit_depth": limit, "limit_depth_quantile": quantiles, "safe_depth": limit}
    return xr.Dataset(named, attrs={"safe_probability": SAFE_PROBABILITY, "warnings": []})


def with_band(lobes: xr.Dataset, band: xr.Dataset) -> xr.Dataset:
    """Return limits of any method with the quantiles and the safe depth of a zero-order band, in proportion.

    The errors move the limit of a converged method by the same share as that of the zero-order one, as far as both
    are about the same lobe: exactly for coefficients and stiffnesses that change together.

    Parameters
    ----------
    lobes : xarray.Dataset
        ``limit_depth(spindle_speed)`` [mm] of any method.
    band : xarray.Dataset
        From `sampled_band` or `linearised_band`, at the same speeds.

    Returns
    -------
    xarray.Dataset
        `lobes` with ``limit_depth_quantile`` and ``safe_depth`` [mm], NaN where one of the two has a limit and the
        other has none, and the attribute "safe_probability".

    Raises
    ------
    InputError
        When the speeds differ.
    """
    if not np.array_equal(lobes["spindle_speed"].values, band["spindle_speed"].values):
        raise InputError("the limits and their band are for other spindle speeds; ask for both at the same speeds")
    limit, zero = lobes["limit_depth"].values, band["limit_depth"].values
    finite = np.isfinite(limit) & np.isfinite(zero)
    share = np.where(np.isinf(limit) & np.isinf(zero), 1.0, np.nan)
    share[finite] = limit[finite] / zero[finite]
    names = ("limit_depth_quantile", "safe_depth")
    scaled = {name: band[name].copy(data=band[name].values * share) for name in names}
    return lobes.assign(scaled).assign_attrs(safe_probability=band.attrs["safe_probability"])


def _stratified(generator: np.random.Generator, count: int) -> Real:
    """Return normal steps of K_tc, K_rc, K_ac, one from each of so many equally likely strata; shape (count, 3)."""
    strata = np.stack([generator.permutation(count) for _ in range(3)], axis=1)
    return np.asarray(ndtri((strata + generator.random((count, 3))) / count))


def corrected_quantiles(drawn: Real, nominal: Real, levels: Sequence[float], common: float = 0.0) -> Real:
    """Return bias-corrected percentiles ``Phi(2 z0 + z)`` of samples, shape (levels, speeds).

    With a common factor they are those of the mixture over all samples (see the module).

    Parameters
    ----------
    drawn : ndarray, shape (samples, speeds)
        Samples; inf is a value like any other.
    nominal : ndarray, shape (speeds,)
        The estimate about which they were drawn. The median z0 of the samples below it is cut to `RULES.most_bias`.
    levels : sequence of float
        Levels between 0 and 1.
    common : float, optional
        Relative standard deviation of a factor by which all samples are divided.
    """
    count = drawn.shape[0]
    bias = _bias(drawn, nominal, common)
    z0 = np.where(np.isinf(nominal), 0.0, np.clip(bias, -RULES.most_bias, RULES.most_bias))
    some, places = np.unique(np.asarray(levels), return_inverse=True)
    share = ndtr(2.0 * z0 + ndtri(some)[:, None])
    if common > 0.0:
        return np.asarray(_mixture_quantiles(drawn, share, common)[places])
    rank = share * count
    ordered = np.sort(drawn, axis=0)
    index = np.clip(np.ceil(rank - 0.5).astype(np.int64), 1, count) - 1
    return np.asarray(np.take_along_axis(ordered, index, axis=0)[places])


def _steps(drawn: Real, logarithm: Real, common: float) -> Real:
    """Return ``ln(a/a_i)/s`` of depths given by their logarithm, (..., samples, speeds); -inf for samples of inf."""
    finite = np.isfinite(drawn)
    steps = (logarithm[..., None, :] - np.log(np.where(finite, drawn, 1.0))) / common
    return np.where(finite, steps, -np.inf)


def _mixture_quantiles(drawn: Real, share: Real, common: float) -> Real:
    """Return the depths below which these shares (levels, speeds) of the mixture lie; inf where it has no more."""
    finite = np.isfinite(drawn)
    level = np.log(np.where(finite, drawn, 1.0))
    low = np.where(finite, level, np.inf).min(axis=0) - RULES.reach * common
    high = np.where(finite, level, -np.inf).max(axis=0) + RULES.reach * common
    there = (share < finite.mean(axis=0)) & finite.any(axis=0)
    low, high = (np.broadcast_to(np.where(finite.any(axis=0), end, 0.0), share.shape) for end in (low, high))
    for _ in range(RULES.halvings):
        middle = 0.5 * (low + high)
        above = ndtr(_steps(drawn, middle, common)).mean(axis=-2) > share
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    at = 0.5 * (low + high)
    for _ in range(2):  # Newton's steps from there: the distribution is smooth over `common`
        steps = _steps(drawn, at, common)
        density = np.exp(-0.5 * steps**2).mean(axis=-2) / (math.sqrt(2.0 * math.pi) * common)
        off = ndtr(steps).mean(axis=-2) - share
        at = np.clip(at - off / np.where(density > 0.0, density, np.inf), low, high)
    return np.where(there, np.exp(at), np.inf)


def _bias(drawn: Real, nominal: Real, common: float = 0.0) -> Real:
    """Return how far samples, or their mixture, lie below the estimate on the average, in standard deviations."""
    if common > 0.0:
        return np.asarray(ndtri(ndtr(_steps(drawn, np.log(nominal), common)).mean(axis=0)))
    below = (drawn < nominal).sum(axis=0) + 0.5 * (drawn == nominal).sum(axis=0)
    return np.asarray(ndtri(below / drawn.shape[0]))


def bias_warning(drawn: Real, nominal: Real) -> list[str]:
    """Say where errors of the compliance make limits too low as a rule: every wrong crossing counts, none raises it."""
    low = int((_bias(drawn, nominal) > RULES.most_bias).sum())
    if low == 0:
        return []
    return [
        f"at {low} of {nominal.size} spindle speeds errors of the compliance lower the limit as a rule, so that the "
        "limit and its upper quantiles are too low there (the safe depth stays safe); average more, or measure longer"
    ]


def _depth_quantiles(half_inverse: Real, levels: Sequence[float], common: float) -> Real:
    """Return quantiles of ``1/(2 x)`` [m]; where x is not positive there is no limit."""
    if common > 0.0:
        depth = np.where(half_inverse > 0.0, 0.5 / np.where(half_inverse > 0.0, half_inverse, 1.0), np.inf)
        return _mixture_quantiles(depth[:, None], np.asarray(levels)[:, None], common)[:, 0]
    x = np.quantile(half_inverse, 1.0 - np.asarray(levels))
    return np.asarray(np.where(x > 0.0, 0.5 / np.where(x > 0.0, x, 1.0), np.inf))


def _problem(compliance: xr.Dataset | ModalModel, cut: Cut, spindle_speed: ArrayLike, spread: Spread) -> _Problem:
    """Put compliance, errors and cut together."""
    speed = check_spindle_speed(spindle_speed)
    error: ErrorModel
    if isinstance(compliance, xr.Dataset):
        if spread.modal.any():
            raise InputError(
                "a measured compliance carries the errors of its frequencies, damping and stiffness itself; give a "
                "Spread of the coefficients only, or the machine as modes"
            )
        samples = complete_samples(compliance)
        error = measured_error(compliance, samples.frequency)
    else:
        if not (spread.modal.any() or any(spread.coefficients) or spread.common):
            raise InputError(
                "neither modes nor coefficients are uncertain, so that there is no band; give a Spread, e.g. "
                "Spread(coefficients=(0.1, 0.1, 0.1), damping=0.2)"
            )
        samples = modal_samples(modes_of(compliance))
        error = ModalError(compliance, spread, samples.frequency)
    return _Problem(cut, samples, error, spread, speed)


def checked_levels(quantiles: Sequence[float], safe_probability: float) -> tuple[float, ...]:
    """Return the quantiles asked for, then that of the safe depth, then the least that the safe depth may claim."""
    for value in (*quantiles, safe_probability):
        if not 0.0 < value < 1.0:
            raise InputError(f"a quantile or probability of {value:g}; it must lie between 0 and 1")
    return (*quantiles, 1.0 - safe_probability, QUANTILES[0])


def _labelled(
    way: str,
    problem: _Problem,
    nominal: Real,
    levels: tuple[float, ...],
    found: Real,
    safe_probability: float,
    attrs: dict[str, int],
) -> xr.Dataset:
    """Put names and units on a band; depths come in metres."""
    over = ("quantile", "spindle_speed")
    out = label(
        xr.Dataset(
            {
                "limit_depth": (over[1], nominal * 1e3),
                "limit_depth_quantile": (over, found[:-2] * 1e3),
                "safe_depth": (over[1], np.minimum(nominal, found[-2:].min(axis=0)) * 1e3),
            },
            coords={"spindle_speed": problem.speed, "quantile": list(levels[:-2])},
            attrs={"method": f"zero_order, {way} errors", "safe_probability": safe_probability, **attrs},
        )
    )
    out["safe_depth"].attrs["units"] = out["limit_depth"].attrs["units"]
    out.attrs["warnings"] = list(problem.samples.warnings)
    return out


# --- the linearised way ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Crossings:
    """The crossings of each speed that limit the depth most; shapes (speeds, crossings), unused ones at mu = 0."""

    frequency: Real
    mu: Complex
    slope: Complex
    period: Real


def _lowest_crossings(branches: Branches, period: Real) -> _Crossings:
    """Return the crossings of largest Re(mu), i.e. lowest depth, at each tooth period [s]."""
    pieces = 1 + 4 * (branches.samples.frequency.size < 4000)
    f, every = branches.refined(pieces)
    shape = (period.size, RULES.crossings)
    out = np.zeros((3, *shape), dtype=complex)
    out[0] = branches.samples.frequency[0]
    found = [_crossings(f, mu, period) for mu in every]
    speed, frequency, mu, slope = (np.concatenate(columns) for columns in zip(*found, strict=True))
    order = np.lexsort((-mu.real, speed))
    rank = np.arange(order.size) - np.searchsorted(speed[order], speed[order])
    kept = order[rank < RULES.crossings]
    at = speed[kept], rank[rank < RULES.crossings]
    for field, values in zip(out, (frequency, mu, slope), strict=True):
        field[at] = values[kept]
    return _Crossings(out[0].real, out[1], out[2], np.broadcast_to(period[:, None], shape))


def _crossings(f: Real, mu: Complex, period: Real) -> tuple[NDArray[np.int64], Real, Complex, Complex]:
    """Return (number of the speed, frequency, mu, d mu/df) at all crossings of one branch with positive Re(mu)."""
    steps = np.diff(mu) / np.diff(f)
    usable = np.isfinite(steps) & (np.maximum(mu.real[1:], mu.real[:-1]) > 0.0) & (mu[1:] != 0.0) & (mu[:-1] != 0.0)
    at = np.flatnonzero(usable)
    with np.errstate(invalid="ignore", divide="ignore"):
        turned = np.angle(mu[at + 1] / mu[at])
    low = f[at] * period[:, None] - 0.5 - np.angle(mu[at]) / np.pi
    high = f[at + 1] * period[:, None] - 0.5 - (np.angle(mu[at]) + turned) / np.pi
    lobe = np.floor(np.maximum(low, high))
    speed, k = np.nonzero(lobe >= np.minimum(low, high))
    share = ((lobe - low) / np.where(high == low, 1.0, high - low))[speed, k]
    place = at[k]
    value = mu[place] + share * (mu[place + 1] - mu[place])
    positive = value.real > 0.0
    frequency = f[place] + share * (f[place + 1] - f[place])
    return speed[positive], frequency[positive], value[positive], steps[place][positive]


def _linear_errors(problem: _Problem, branches: Branches, at: _Crossings) -> tuple[Real, Real, Real]:
    """Return Re(mu) = 1/(2 a), its change with shared factors, and the covariance of the rest, for each crossing.

    Shapes (speeds, crossings), (speeds, crossings, factors), (speeds, crossings, crossings).
    """
    shape, f = at.mu.shape, at.frequency.ravel()
    used = at.mu.ravel() != 0.0
    phi = branches.compliance_at(f)
    directional = problem.cut.directional_matrix()
    left, right = _eigenvectors(directional @ phi, at.mu.ravel())
    mu = np.where(used, at.mu.ravel(), 1.0)
    slope = at.slope.ravel()
    k = slope.real / (np.pi * at.period.ravel() - (slope / mu).imag)
    weight = np.where(used, 1.0 - 1j * k / mu, 0.0)[:, None] * left
    changes = [phi_change for phi_change in problem.error.shared(f)]
    force = weight[:, None, :] @ directional
    shared = [(force @ change @ right[:, :, None])[:, 0, 0].real for change in changes]
    for axis, spread in enumerate(problem.spread.coefficients):
        step = changed_coefficients(problem.cut.coefficients, problem.spread, np.eye(3)[axis] * 1e-3)
        change = (replace(problem.cut, coefficients=step).directional_matrix() - directional) / 1e-3
        if spread > 0.0:
            shared.append((weight[:, None, :] @ change @ phi @ right[:, :, None])[:, 0, 0].real)
    # Row r of an error acts as force_r (error_r . right); circular noise: half its power is real.
    own = force[:, 0, :, None] * np.einsum("me,mrek->mrk", right, problem.error.line_factors(f))
    own = own.reshape(*shape, 3, -1)
    alike = problem.error.correlation(at.frequency)
    covariance = 0.5 * np.einsum("sark,sbtk,sabrt->sab", own, own.conj(), alike, optimize=True).real
    value = np.where(at.mu != 0.0, at.mu.real, -np.inf)
    return value, np.array(shared).reshape(len(shared), *shape).transpose(1, 2, 0), covariance


def _eigenvectors(matrix: Complex, mu: Complex) -> tuple[Complex, Complex]:
    """Return left (conjugated) and right eigenvectors of the eigenvalues nearest to mu, ``left @ right = 1``."""
    values, right = np.linalg.eig(matrix)
    nearest = np.abs(values - mu[:, None]).argmin(axis=1)
    u = np.take_along_axis(right, nearest[:, None, None], axis=2)[:, :, 0]
    values, left = np.linalg.eig(matrix.transpose(0, 2, 1))
    nearest = np.abs(values - mu[:, None]).argmin(axis=1)
    w = np.take_along_axis(left, nearest[:, None, None], axis=2)[:, :, 0]
    product = np.einsum("mi,mi->m", w, u)
    return np.asarray(w / np.where(product == 0.0, 1.0, product)[:, None]), np.asarray(u)
