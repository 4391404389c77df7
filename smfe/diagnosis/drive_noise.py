"""What no smooth model of an axis explains in a drive record: the noise that a diagnosis whitens with.

A reference with far more freedom than any cause of the catalogue (piecewise-linear friction over speed and over
position for each direction, pre-sliding, jerk, snap, a periodic force) is fitted to the force. Its residual is held to
be noise, and an autoregression of it (Yule-Walker over whole moves, those with a residual above twice the median left
out) whitens:

``e_n = (y_n + a_1 y_(n-1) + ... + a_p y_(n-p))/sigma``.

What a position-periodic force has for a wavelength is looked for in the residual of the reference without it.

The reference also says how far up in frequency a record can be used. The axis moves in closed loop: where its motion
comes from disturbances and not from the reference position, drive force over motion is minus the controller and no
property of the axis (Forssell and Ljung, Automatica 35, 1999); it looks like a flexibility and a longer delay. On rigid
axes that were simulated 10 dB was seen to let a flexibility through.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, signal

from smfe.diagnosis.drive_signals import Motion, Real
from smfe.diagnosis.drive_terms import presliding

ORDER = 10
_SPEEDS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.65, 1.0)
_POSITIONS = 8
_SLIDES = (1e-6, 5e-6, 2.5e-5)
_ABOVE = 20.0
_RESOLUTION = 5.0
_STANDS_OUT = 5.5


@dataclass(frozen=True)
class Whitener:
    """An autoregression: ``e = (y + a y_before)/sigma``.

    Parameters
    ----------
    coefficients : ndarray, shape (p,)
        a_1 ... a_p.
    sigma : float
        Standard deviation of the innovations, in the unit of the signal.
    """

    coefficients: Real
    sigma: float

    @property
    def order(self) -> int:
        """Values needed before the first."""
        return self.coefficients.size

    def __call__(self, values: Real) -> Real:
        """Return the whitened values, `order` fewer than were given."""
        taps = np.concatenate(([1.0], self.coefficients)) / self.sigma
        return np.convolve(values, taps, mode="valid")


def fit_whitener(residuals: Sequence[Real]) -> Whitener:
    """Return the whitener of residuals, one array a move."""
    size = np.array([math.sqrt(float(np.mean(np.square(r)))) for r in residuals])
    kept = [r for r, rms in zip(residuals, size, strict=True) if rms <= 2.0 * np.median(size)]
    total = sum(r.size for r in kept)
    lags = np.array([sum(float(r[k:] @ r[: r.size - k]) for r in kept) / total for k in range(ORDER + 1)])
    # A ridge of 1e-6 keeps what the low-pass has taken away from being blown up.
    lags[0] *= 1.0 + 1e-6
    coefficients = np.asarray(linalg.solve_toeplitz(lags[:-1], -lags[1:]))
    return Whitener(coefficients, math.sqrt(float(lags[0] + coefficients @ lags[1:])))


def reference(m: Motion) -> Real:
    """Return the regressors of the reference, shape (n, k): N for unit coefficients."""
    speed = np.abs(m.velocity) / np.abs(m.velocity).max()
    place = (m.position - m.position.min()) / max(float(np.ptp(m.position)), 1e-300)
    columns = [m.acceleration, m.jerk, m.snap, *(presliding(m.position, m.velocity, d) for d in _SLIDES)]
    for way in (m.velocity > 0.0, m.velocity <= 0.0):
        columns += [way * hat for hat in _hats(speed, _SPEEDS)]
        columns += [way * hat for hat in _hats(place, np.linspace(0.0, 1.0, _POSITIONS))]
    return np.stack(columns, axis=1)


def _hats(x: Real, nodes: Sequence[float] | NDArray[np.float64]) -> list[Real]:
    unit = np.eye(len(nodes))
    return [np.interp(x, nodes, row) for row in unit]


def residual(regressors: Real, response: Real) -> Real:
    """Return what least squares leaves of the response; columns may depend on each other."""
    scale = np.sqrt(np.mean(np.square(regressors), axis=0))
    scale[scale == 0.0] = 1.0
    solution = np.linalg.lstsq(regressors / scale, response, rcond=1e-10)[0]
    return np.asarray(response - (regressors / scale) @ solution)


def usable_band(force: Real, left: Real, step: float, highest: float) -> float:
    """Return the frequency [Hz] up to which the force stands 13 dB above what the reference leaves, at most `highest`.

    Power densities with a resolution of 5 Hz, each the median of three neighbours.
    """
    size = min(round(1.0 / (_RESOLUTION * step)), force.size)
    f, (whole, rest) = signal.welch(np.stack([force, left]), 1.0 / step, nperseg=size)
    ratio = signal.medfilt(whole / np.maximum(rest, 1e-300), 3)[1:-1]
    low = np.flatnonzero(ratio < _ABOVE)
    return float(min(f[1:-1][low[0]] if low.size else highest, highest))


def wavelength(position: Real, left: Real, shortest: float) -> float:
    """Return the period over position [m] that explains most of a residual, from `shortest` to a fifth of the stroke.

    Parameters
    ----------
    position : ndarray, shape (n,)
        Where the residual was measured [m].
    left : ndarray, shape (n,)
        Residual [N].
    shortest : float
        Shortest wavelength that the band can show at the speeds of the record [m].
    """
    stroke = float(np.ptp(position))
    wavenumbers = np.arange(5.0 / stroke, max(1.0 / shortest, 6.0 / stroke), 0.1 / stroke)
    power = np.array([abs(np.exp(-2j * math.pi * k * position) @ left) for k in wavenumbers])
    return float(1.0 / wavenumbers[int(np.argmax(power))])


def strongest_pulse(left: Real, step: float) -> tuple[float, float] | None:
    """Return begin and end [s from the first sample] of the box that white noise explains worst.

    Boxes of 50, 100, 200 and 400 ms are moved over the residual; None where the worst is below 5.5 standard deviations,
    as it is in noise of a hundred thousand places but once in a hundred times.
    """
    best, found = _STANDS_OUT, None
    for width in (0.05, 0.1, 0.2, 0.4):
        n = max(round(width / step), 1)
        if n < left.size:
            sums = np.abs(np.convolve(left, np.ones(n), mode="valid")) / math.sqrt(n)
            k = int(np.argmax(sums))
            if sums[k] > best:
                best, found = float(sums[k]), (k * step, (k + n) * step)
    return found
