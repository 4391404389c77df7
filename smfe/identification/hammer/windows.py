"""The exponential window of a hammer test, and how it is taken off again.

A window ``exp(-t/tau)`` on force *and* response turns their transforms into Laplace transforms on the line ``s = 1/tau
+ j w``: what comes out is exactly ``H(1/tau + j w)``, the compliance of a machine whose every pole decays by 1/tau
more. The compliance wanted is the same function a little to the left, at ``s = j w``. 1/tau is about as far as the
lines are apart, and over a few lines a compliance is a rational function of low order: fitted there, it is evaluated at
j w.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from process.errors import InputError
from process.types import Complex, Real
from smfe.identification.hammer.rules import RULES


def exponential(length: int, onset: int, dt: float, tau: float) -> Real:
    """Return the window ``exp(-(t - t_onset)/tau)``, shape (length,); 1 at the onset of the pulse.

    Parameters
    ----------
    length : int
        Samples of the block.
    onset : int
        Sample of the block at which the pulse begins.
    dt : float
        Sampling interval [s].
    tau : float
        Time constant [s].
    """
    return np.asarray(np.exp(-(np.arange(length) - onset) * dt / tau))


def check_time_constant(tau: float | None, duration: float) -> None:
    """Refuse a window that has not fallen at the end of the block, or that leaves no lines.

    Raises
    ------
    InputError
        For a time constant that is not positive, above half of the block, or below a fiftieth of it.
    """
    if tau is None:
        return
    if not 0.0 < tau <= 0.5 * duration:
        raise InputError(
            f"an exponential window of {tau:g} s on blocks of {duration:.3g} s; give a positive time constant of at "
            f"most half the block, e.g. {0.2 * duration:.2g} s, or none"
        )
    if tau < duration / 50.0:
        raise InputError(
            f"an exponential window of {tau:g} s widens every resonance by {0.5 / np.pi / tau:.3g} Hz, many lines of a "
            f"block of {duration:.3g} s, and cannot be taken off; give at least {duration / 50.0:.2g} s"
        )


def laplace_factor(frequency: Real, tau: float, channel: str) -> Complex:
    """Return what turns ``A(s)/(j w)^2`` into ``A(s)/s^2`` at ``s = 1/tau + j w``, shape (f,); 1 for a displacement."""
    if channel == "displacement":
        return np.ones(frequency.size, dtype=complex)
    jw = 2j * np.pi * frequency
    return np.asarray((jw / (jw + 1.0 / tau)) ** 2)


def without_window(compliance: Complex, frequency: Real, tau: float) -> Complex:
    """Return compliances at ``j w`` from their values at ``1/tau + j w``.

    Over ``2 reach + 1`` lines round each line ``H(s0 + d) = (b0 + b1 d + b2 d^2)/(1 + a1 d + a2 d^2)`` is fitted
    (linearised, then weighted with the denominator found: Sanathanan and Koerner 1963; local rational models: McKelvey
    and Guerin 2012) and read at ``d = -1/tau``. One or two modes are exact, of more the rest bends little over 11
    lines. The damping removed is ``1/tau`` of every decay rate: ``zeta w_n`` falls by it.

    Parameters
    ----------
    compliance : ndarray of complex, shape (f, ...)
        [m/N], at equally spaced frequencies.
    frequency : ndarray, shape (f,)
        [Hz].
    tau : float
        Time constant of the window [s].

    Raises
    ------
    InputError
        When there are fewer lines than the fit needs.
    """
    lines = 2 * RULES.reach + 1
    if frequency.size < lines:
        raise InputError(
            f"{frequency.size} lines; {lines} are needed to take the exponential window off: record longer blocks"
        )
    flat = compliance.reshape(frequency.size, -1)
    start = np.clip(np.arange(frequency.size) - RULES.reach, 0, frequency.size - lines)
    used = start[:, None] + np.arange(lines)
    scale = 2.0 * np.pi * RULES.reach * float(frequency[1] - frequency[0])
    shift = 2j * np.pi * (frequency[used] - frequency[:, None]) / scale
    at = -1.0 / (tau * scale)
    out = np.empty_like(flat)
    for column in range(flat.shape[1]):
        out[:, column] = _continued(flat[used, column], shift, at)
    return np.asarray(out.reshape(compliance.shape))


def _continued(values: Complex, shift: Complex, at: float) -> Complex:
    """Fit the rational function of each window, shapes (f, lines), and evaluate it; NaN where a value is unknown."""
    known = np.asarray(np.isfinite(values).all(axis=1))
    h = np.where(known[:, None], values, 1.0)
    size = np.abs(h).max(axis=1, keepdims=True)
    size = np.where(size > 0.0, size, 1.0)
    h = h / size
    powers = shift[..., None] ** np.arange(RULES.bend + 1)
    below = -h[..., None] * shift[..., None] ** np.arange(1, RULES.poles + 1)
    matrix = np.concatenate([powers, below], axis=2)
    weight = np.ones_like(size)
    for _ in range(RULES.window_rounds):
        a = matrix * weight[..., None]
        gram = a.conj().swapaxes(1, 2) @ a
        gram += 1e-13 * np.trace(gram, axis1=1, axis2=2).real[:, None, None] * np.eye(gram.shape[1])
        right = a.conj().swapaxes(1, 2) @ (h * weight)[..., None]
        found = np.linalg.solve(gram, right)[..., 0]
        denominator = 1.0 + np.sum(
            found[:, None, RULES.bend + 1 :] * shift[..., None] ** np.arange(1, RULES.poles + 1), axis=2
        )
        weight = 1.0 / np.maximum(np.abs(denominator), 1e-6)
    above = found[:, : RULES.bend + 1] @ at ** np.arange(RULES.bend + 1)
    under = 1.0 + found[:, RULES.bend + 1 :] @ at ** np.arange(1, RULES.poles + 1)
    return np.where(known, above / under * size[:, 0], np.nan)


# --- A response that has not decayed when its block ends: how wrong the compliance is for it.


def leakage(first: Complex, last: Complex) -> tuple[float, int]:
    """Estimate the error of a block that ends before the response has decayed.

    A decay ``exp(-t/tau)`` cut at T leaves an error of ``exp(-T/tau)``. The decay from the first to the last
    quarter of the block, whose centres are 3/4 T apart, is read where the first quarter is above a tenth of
    its maximum, on the mean over hits, where that is above what the scatter of the hits leaves of the noise,
    and raised to 4/3.

    Parameters
    ----------
    first, last : ndarray of complex, shape (f, hits)
        Hann-windowed transforms of the velocity in the first and the last quarter, in any unit.

    Returns
    -------
    error : float
        Relative error of the compliance near the peaks of the response [1].
    line : int
        Index of the frequency that contributes most.
    """
    (early, early_noise), (late, late_noise) = _mean_and_noise(first), _mean_and_noise(last)
    # Ten and six times the noise of the mean: from few hits its estimate is itself uncertain.
    clear = early > 10.0 * early_noise
    strong = clear & (early > 0.01 * np.max(early, where=clear, initial=0.0))
    if not strong.any() or late[strong].sum() <= 6.0 * late_noise[strong].sum():
        return 0.0, 0
    ratio = float(np.sqrt(late[strong].sum() / early[strong].sum()))
    return min(ratio, 1.0) ** (4.0 / 3.0), int(np.argmax(np.where(strong, late, 0.0)))


def leakage_by_line(first: Complex, last: Complex) -> Real:
    """Estimate the error of `leakage` line by line: relative to the compliance at the line, at most 1.

    ``(late/early)^(2/3)`` of the powers over five lines, where the late one is above ten times the noise that the
    scatter of the hits shows; zero elsewhere.

    Parameters
    ----------
    first, last : ndarray of complex, shape (f, hits)
        Hann-windowed transforms of the velocity in the first and the last quarter, in any unit; two hits or more.
    """
    (early, _), (late, noise) = _mean_and_noise(first), _mean_and_noise(last)
    # The running sum of the filter leaves a rounding error that may be negative.
    early, late, noise = (np.maximum(ndimage.uniform_filter1d(p, 5, mode="nearest"), 0.0) for p in (early, late, noise))
    ratio = np.divide(late, early, out=np.zeros_like(late), where=(late > 10.0 * noise) & (early > 0.0))
    return np.asarray(np.minimum(ratio, 1.0) ** (2.0 / 3.0))


def _mean_and_noise(quarter: Complex) -> tuple[Real, Real]:
    """Return the power of the mean over hits, and of the noise in that mean, shape (f,)."""
    hits = quarter.shape[1]
    mean = quarter.mean(axis=1)
    noise = np.sum(np.abs(quarter - mean[:, None]) ** 2, axis=1) / max(hits * (hits - 1), 1)
    return np.abs(mean) ** 2, noise
