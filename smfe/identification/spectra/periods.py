"""Whole periods of a record: the response between two signals, its noise, and the period of a setpoint.

Over whole periods a periodic input and its settled output have lines and nothing between them: no window, no leakage.

    T = sum_p Y_p conj(U_p) / sum_p |U_p|^2

with the transforms U, Y of the periods p averages noise out before it divides, where U is the same in all of them or a
mean over them (Pintelon and Schoukens 2012, 2.4). ``E_p = Y_p - T U_p`` changes from period to period: that is noise.
Distortion repeats with the period and is not in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft

from process.errors import InputError
from process.types import Complex, Real
from smfe.identification.spectra.rules import RULES


def settled(available: int, length: int, dt: float, settling: float | None) -> tuple[int, int]:
    """Return the first sample that is used, and how many whole periods follow.

    Parameters
    ----------
    available, length : int
        Samples of the record, and of a period.
    dt : float
        Sampling interval [s].
    settling : float or None
        Time that is dropped at the beginning [s]. None: the first period, where there are three or more.
    """
    default = length if available >= 3 * length else 0
    first = default if settling is None else round(settling / dt)
    return first, (available - first) // length


def periods_of(samples: Real, length: int) -> Complex:
    """Return the transforms of the periods of a signal, without their means, shape (f, P).

    Parameters
    ----------
    samples : ndarray, shape (P * length,)
        Whole periods.
    length : int
        Samples of a period.
    """
    return np.asarray(np.fft.rfft(samples.reshape(-1, length), axis=1).T[1:])


def response(output: Complex, source: Complex) -> Complex:
    """Return T, shape (f, ...), from the transforms of output and input; NaN or infinite where nothing is put in.

    Parameters
    ----------
    output : ndarray of complex, shape (f, ..., P)
        Y of each period, or their means in each record.
    source : ndarray of complex, shape (f, P)
        U of the same.
    """
    u = source.reshape(source.shape[0], *(1,) * (output.ndim - 2), -1)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.sum(output * u.conj(), axis=-1) / np.sum(np.abs(u) ** 2, axis=-1))


def error(output: Complex, source: Complex, found: Complex) -> Complex:
    """Return ``E_p = Y_p - T U_p``, shape (f, ..., P); arguments as of `response`, and T."""
    u = source.reshape(source.shape[0], *(1,) * (output.ndim - 2), -1)
    return np.asarray(output - found[..., None] * u)


def noise_power(errors: Complex) -> Real:
    """Return the mean power of the noise of a period, ``sum_p |E_p|^2/(P - 1)``, shape (f, ...)."""
    return np.asarray(np.sum(np.abs(errors) ** 2, axis=-1) / (errors.shape[-1] - 1))


# --- the period of a setpoint that a control has made ----------------------------------------------------------------


@dataclass(frozen=True)
class Period:
    """How a setpoint repeats itself.

    Parameters
    ----------
    samples : int
        Its period.
    kind : str
        "PRBS of order 11", "periodic".
    """

    samples: int
    kind: str


def find_period(setpoint: Real, dt: float, source: str = "the record") -> Period:
    """Return the period of a setpoint.

    A record of several periods equals itself one period later: the smallest lag of at most half the record at which the
    mean square change is nothing but rounding. A record of one period gives it away only where the setpoint is a binary
    sequence of maximum length (PRBS): two levels, ``2^n - 1`` samples and, as nothing shorter or longer has, equal
    power at all lines but that of the mean (Golomb 1967).

    Parameters
    ----------
    setpoint : ndarray, shape (n,)
        Samples of one setpoint; free of noise, as a control computes it.
    dt : float
        Sampling interval [s].
    source : str, optional
        File, for messages.

    Raises
    ------
    InputError
        When it does not repeat itself and is no such sequence.
    """
    u = setpoint - setpoint.mean()
    power = float(np.mean(u**2))
    if u.size < 16 or power <= 0.0:
        raise InputError(f"{source}: the setpoint does not change; record it while the loop is excited")
    lag = _repeats(u, power)
    if lag is not None:
        order = _prbs_order(setpoint[:lag])
        return Period(lag, f"PRBS of order {order}" if order else "periodic")
    order = _prbs_order(setpoint)
    if order:
        return Period(u.size, f"PRBS of order {order}")
    raise InputError(
        f"{source}: the setpoint does not repeat itself within {u.size * dt:.4g} s; record two periods or more, or "
        "give the measurement its period"
    )


def _repeats(u: Real, power: float) -> int | None:
    """Return the smallest lag at which a signal is what it was.

    ``sum (u_t - u_t+l)^2`` over all t of a lag l is the energy of both parts less twice their correlation, which a
    transform gives for all lags together.
    """
    n = u.size
    size = fft.next_fast_len(2 * n, real=True)
    spectrum = fft.rfft(u, size)
    correlation = fft.irfft(np.abs(spectrum) ** 2, size)[: n // 2 + 1]
    energy = np.concatenate([[0.0], np.cumsum(u**2)])
    lags = np.arange(n // 2 + 1)
    change = (energy[n - lags] + energy[n] - energy[lags] - 2.0 * correlation) / (n - lags) / power
    # A slow setpoint has hardly changed a sample later: it must have changed before it can come back.
    away = np.flatnonzero(change > 0.5)
    back = np.flatnonzero(change[away[0] :] < RULES.same) if away.size else away
    return int(away[0] + back[0]) if back.size else None


def _prbs_order(u: Real) -> int:
    """Return n for one period of a binary sequence of maximum length 2^n - 1, else 0."""
    order = int(np.log2(u.size + 1))
    low, high = float(u.min()), float(u.max())
    two_levels = np.all(np.minimum(u - low, high - u) < RULES.flat * (high - low))
    if order < 3 or u.size != 2**order - 1 or not two_levels:
        return 0
    lines = np.abs(fft.rfft(u - u.mean()))[1:]
    return order if float(np.ptp(lines)) < RULES.flat * float(lines.max()) else 0
