"""Noise of the force channels: from the air before and after the cut, bounded by what the cut has between its lines.

Noise on the inputs makes every least squares estimate too small, ``E[Phi_hat] = Phi (1 - N (F F^H)^-1)``,
:eq:`attenuation`. With N known it is subtracted from the normal equations (bias-compensated least squares: Stoica and
Soderstrom 1982), in `least_squares.Equations.without_input_noise`; how well N is known is charged to the estimate.

What is quiet need not be air: a tool that still touches and a cut that fades have lines at the orders of the spindle,
and noise lies between them, too. So N is a median over lines, of the quietest pieces, and at most what the cut itself
has between its lines: the noise of a sensor does not fall while it cuts. Where no air was recorded that bound is all
there is, and N is anything up to it.

Noise of the motion channels weights the passes: its power in a pass is known from few lines, so the passes are pooled
(`pooled_noise`); and where the noise of two rows is not independent, their errors are not either (`shared_noise`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import fft, ndimage, special, stats

from process.types import Complex, Real
from smfe.identification.spectra.spectra import hann
from smfe.identification.sweep.passes import PreparedPass
from smfe.identification.sweep.rules import RULES

# --- of the forces ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ForceNoise:
    """Power of the noise of each force.

    Parameters
    ----------
    density : ndarray, shape (e,)
        Two-sided power spectral density [N2/Hz] over the band.
    spread : float
        Its relative standard deviation.
    air : bool
        Whether it was seen in the air; else it is the bound, and no more than that is known.
    """

    density: Real
    spread: float
    air: bool


def force_noise(passes: Sequence[PreparedPass], axes: list[str], reach: tuple[float, float]) -> ForceNoise | None:
    """Return the noise of the forces of passes with one sensor within a band [Hz]; None where they are too short.

    Parameters
    ----------
    passes : sequence of PreparedPass
        With force.
    axes : list of str
        Of the forces.
    reach : (float, float)
        Band [Hz].
    """
    pieces, floors = [], []
    for p in passes:
        force = p.record["force"].sel(axis=axes).values
        found = [density_of(force[:, piece], p.interval, reach, 0.5) for piece in p.air]
        pieces += [f for f in found if f[1] >= 1.0]
        floors += _floor_of_cut(force, np.flatnonzero(p.cutting), p.interval, reach)
    bound = np.median(floors, axis=0) if floors else np.full(len(axes), np.inf)
    if not pieces:
        return ForceNoise(bound, RULES.bounded_scatter, False) if floors else None
    together = [
        _quietest(np.array([p[0][i] for p in pieces]), np.array([p[1] for p in pieces])) for i in range(len(axes))
    ]
    density = np.minimum([value for value, _ in together], bound)
    return ForceNoise(density, float(np.hypot(max(spread for _, spread in together), RULES.noise_scatter)), True)


def _quietest(power: Real, lines: Real) -> tuple[float, float]:
    """Return the mean power of the pieces that are as quiet as the quietest, and its relative standard deviation."""
    independent = 1.0 / median_spread(lines) ** 2
    total, weight = 0.0, 0.0
    for i in np.argsort(power):
        apart = RULES.same_air * np.sqrt(1.0 / independent[i] + (1.0 / weight if weight else 0.0))
        if weight and power[i] * weight > total * np.exp(apart):
            break
        total, weight = total + independent[i] * power[i], weight + independent[i]
    return total / weight, float(1.0 / np.sqrt(max(weight, 1.0)))


def median_spread(lines: ArrayLike) -> Real:
    """Return the relative standard deviation of a noise power that is a median of lines.

    The logarithm of a median of n lines of noise scatters by ``sqrt(pi/2/n)``, and neighbouring lines of a Hann window
    share 1.5 of a line.

    Parameters
    ----------
    lines : array_like
        Lines of a Hann window.
    """
    return np.asarray(np.sqrt(1.5 * 0.5 * np.pi / np.maximum(lines, 1.0)))


def density_of(samples: Real, dt: float, reach: tuple[float, float], quantile: float) -> tuple[Real, float]:
    """Return the density of white noise [N2/Hz] whose lines have the quantile that the samples have; and the lines."""
    samples = samples - samples.mean(axis=1, keepdims=True)
    window = hann(samples.shape[1])
    frequency = fft.rfftfreq(samples.shape[1], dt)
    # The lowest lines hold the window and the drift of the charge amplifier.
    inside = (frequency >= max(reach[0], 3.0 * frequency[1])) & (frequency <= reach[1])
    if not inside.any():
        return np.zeros(samples.shape[0]), 0.0
    power = dt * np.abs(fft.rfft(samples * window, axis=1)[:, inside]) ** 2 / float(window @ window)
    return np.quantile(power, quantile, axis=1) / -np.log1p(-quantile), float(inside.sum())


def _floor_of_cut(force: Real, cutting: NDArray[np.int64], dt: float, reach: tuple[float, float]) -> list[Real]:
    """Return what each piece of the cut has between its lines [N2/Hz]: a lower quartile."""
    size = round(RULES.floor_window / dt)
    if cutting.size < 2 or cutting[-1] - cutting[0] < size:
        return []
    starts = range(int(cutting[0]), int(cutting[-1]) - size + 1, max(1, size // 2))
    return [density_of(force[:, s : s + size], dt, reach, 0.25)[0] for s in starts]


# --- of the motion: power of each pass, and what two rows share -------------------------------------------------------


def pooled_noise(power: Real, lines: Real) -> Real:
    """Return noise powers of passes, drawn together by as much as they scatter.

    Parameters
    ----------
    power : ndarray, shape (f, tests, r)
        Positive.
    lines : ndarray, shape (f, tests)
        Independent lines that each is the mean of.
    """
    tests = power.shape[1]
    if tests < 2:
        return power
    log = np.log(power)
    scatter_of_log = special.polygamma(1, np.maximum(lines, 0.5))[..., None]
    away = log - log.mean(axis=1, keepdims=True)
    scatter = np.sum(away**2, axis=1, keepdims=True) / (tests - 1)
    own = np.maximum(1.0 - scatter_of_log.mean(axis=1, keepdims=True) / np.maximum(scatter, 1e-300), 0.0)
    return np.asarray(np.exp(log.mean(axis=1, keepdims=True) + own * away))


def floored(noise: Real) -> Real:
    """Keep noise powers (f, tests, r) of the passes within 1:1e6, and unknown ones out of the way."""
    largest = np.max(np.nan_to_num(noise), axis=1, keepdims=True)
    floor = np.where(largest > 0.0, 1e-6 * largest, 1.0)
    return np.where(np.isfinite(noise), np.maximum(noise, floor), floor)


def shared_noise(products: Complex, lines: Real, reach: int) -> Complex:
    """Return the coherence of the noise of two rows, pooled over passes and neighbours, shape (f, r, r).

    Of n lines of independent noise ``2 n |rho|^2`` follows chi^2 with two degrees of freedom; a smaller coherence than
    noise reaches with the probability `SweepRules.coherent_p_value` counts as none. No sum of rows is claimed to be
    quieter than n lines can resolve: all coherences shrink until the smallest eigenvalue of their matrix is r/n.

    Parameters
    ----------
    products : ndarray of complex, shape (f, tests, r, r)
        Mean products of the residuals of two rows, NaN where a test has no lines.
    lines : ndarray, shape (f, tests)
        Independent lines within the neighbours that are pooled.
    reach : int
        Neighbours to either side that are pooled.
    """
    power = np.diagonal(products, axis1=2, axis2=3).real
    size = np.sqrt(np.maximum(power[..., :, None] * power[..., None, :], 0.0))
    known = np.isfinite(products) & (size > 0.0)
    count = np.where(known, lines[..., None, None], 0.0)
    ratio = np.where(known, products / np.where(known, size, 1.0), 0.0)
    total = np.sum(count * ratio, axis=1)
    n, real, imaginary = (
        ndimage.uniform_filter1d(part, 2 * reach + 1, axis=0, mode="nearest")
        for part in (count.sum(axis=1), total.real, total.imag)
    )
    rho = (real + 1j * imaginary) / np.maximum(n, 1.0)
    clear = 2.0 * n * np.abs(rho) ** 2 > stats.chi2.isf(RULES.coherent_p_value, 2)
    rows = rho.shape[1]
    own = np.eye(rows, dtype=bool)
    rho = np.where(clear & ~own, rho, 0.0)
    smallest = np.linalg.eigvalsh(rho)[:, 0]
    floor = np.minimum(rows / np.maximum(n[:, 0, 0], 1.0), 1.0)
    shrink = np.minimum(1.0, (1.0 - floor) / np.maximum(-smallest, 1e-12))
    return np.asarray(rho * shrink[:, None, None] + own)


def noise_between(covariance: Complex, shared: Complex, level: Real, width: Real) -> Complex:
    """Return the covariance of the errors of two rows by their noise, shape (f, r, e, r, e); zero within a row.

    Parameters
    ----------
    covariance : ndarray of complex, shape (f, r, e, e)
        Within the rows.
    shared : ndarray of complex, shape (f, r, r)
        Coherence of the noise of two rows.
    level : ndarray, shape (f, r)
        Noise of the rows, in any unit that all share.
    width : ndarray, shape (f, r)
        Of the bands that the rows come from, in any unit.
    """
    f, r, e = covariance.shape[:3]
    out = np.zeros((f, r, e, r, e), dtype=complex)
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(covariance).all(axis=(1, 2, 3)))
    known = np.where(finite.reshape(f, 1, 1, 1), covariance, 0.0)
    value, vector = np.linalg.eigh(known)
    root = (vector * np.sqrt(np.maximum(value, 0.0))[..., None, :]) @ vector.conj().swapaxes(2, 3)
    for i in range(r):
        for k in (k for k in range(r) if k != i):
            ratio = (level[:, i] / level[:, k]).reshape(f, 1, 1)
            first, second = width[:, i].reshape(f, 1, 1), width[:, k].reshape(f, 1, 1)
            same = np.where(first < second, known[:, k] * ratio, root[:, i] @ root[:, k])
            alike = np.where(first > second, known[:, i] / ratio, same)
            out[:, i, :, k] = shared[:, i, k, None, None] * alike
    return out


def possible(covariance: Complex, between: Complex, smallest: float = 1e-3) -> Complex:
    """Return covariances between rows that are possible together with those within them, shape (f, r, e, r, e).

    With ``C_i = R_i R_i^H`` and ``K_ik = R_i^-1 C_ik R_k^-H``, ``1 + K`` must have positive eigenvalues. Where
    approximations left one below `smallest`, all of K shrinks.

    Parameters
    ----------
    covariance : ndarray of complex, shape (f, r, e, e)
        Within the rows.
    between : ndarray of complex, shape (f, r, e, r, e)
        Between them.
    smallest : float, optional
        Eigenvalue of a variance that is 1 without what rows share.
    """
    f, r, e = covariance.shape[:3]
    finite = np.isfinite(covariance).all(axis=(1, 2, 3))
    value, vector = np.linalg.eigh(np.where(finite.reshape(f, 1, 1, 1), covariance, np.eye(e)))
    least = 1e-12 * value[..., -1:]
    root = (vector / np.sqrt(np.maximum(value, np.maximum(least, 1e-300)))[..., None, :]) @ vector.conj().swapaxes(2, 3)
    k = np.einsum("fiab,fibkc,fkcd->fiakd", root, between, root, optimize=True).reshape(f, r * e, r * e)
    lowest = np.linalg.eigvalsh(0.5 * (k + k.conj().swapaxes(1, 2)))[:, 0]
    shrink = np.where(lowest < 0.0, np.minimum(1.0, (1.0 - smallest) / np.maximum(-lowest, 1e-12)), 1.0)
    return np.asarray(between * shrink[:, None, None, None, None])
