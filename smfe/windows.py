"""The exponential window of a hammer test, and how it is taken off again.

A window ``exp(-t/tau)`` on force *and* response turns their transforms into Laplace transforms on the line ``s = 1/tau
+ j w``: what comes out is exactly ``H(1/tau + j w)``, the compliance of a machine whose every pole decays by 1/tau
more. The compliance wanted is the same function a little to the left, at ``s = j w``. 1/tau is about as far as the
lines are apart, and over a few lines a compliance is a rational function of low order: fitted there, it is evaluated at
j w.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from process.errors import InputError

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

REACH = 5
"""Lines to either side over which a compliance is a rational function."""

POLES = 2
"""Order of its denominator: two resonances may be near. Others bend the numerator."""

BEND = 2
"""Order of its numerator."""

_ROUNDS = 3


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

    Over ``2 REACH + 1`` lines round each line ``H(s0 + d) = (b0 + b1 d + b2 d^2)/(1 + a1 d + a2 d^2)`` is fitted
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
    lines = 2 * REACH + 1
    if frequency.size < lines:
        raise InputError(
            f"{frequency.size} lines; {lines} are needed to take the exponential window off: record longer blocks"
        )
    flat = compliance.reshape(frequency.size, -1)
    start = np.clip(np.arange(frequency.size) - REACH, 0, frequency.size - lines)
    used = start[:, None] + np.arange(lines)
    scale = 2.0 * np.pi * REACH * float(frequency[1] - frequency[0])
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
    powers = shift[..., None] ** np.arange(BEND + 1)
    below = -h[..., None] * shift[..., None] ** np.arange(1, POLES + 1)
    matrix = np.concatenate([powers, below], axis=2)
    weight = np.ones_like(size)
    for _ in range(_ROUNDS):
        a = matrix * weight[..., None]
        gram = a.conj().swapaxes(1, 2) @ a
        gram += 1e-13 * np.trace(gram, axis1=1, axis2=2).real[:, None, None] * np.eye(gram.shape[1])
        right = a.conj().swapaxes(1, 2) @ (h * weight)[..., None]
        found = np.linalg.solve(gram, right)[..., 0]
        denominator = 1.0 + np.sum(found[:, None, BEND + 1 :] * shift[..., None] ** np.arange(1, POLES + 1), axis=2)
        weight = 1.0 / np.maximum(np.abs(denominator), 1e-6)
    above = found[:, : BEND + 1] @ at ** np.arange(BEND + 1)
    under = 1.0 + found[:, BEND + 1 :] @ at ** np.arange(1, POLES + 1)
    return np.where(known, above / under * size[:, 0], np.nan)
