"""Eq. (2) from a record: open-loop response of carriage position to drive force, and the masses and joint that fit it.

`open_loop_response` averages whole periods of a periodic excitation; `fit_open_loop` fits masses, stiffness, damping,
friction slope and dead time of `process.drive.axis.Drive` to that response.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage, optimize

from process.drive.axis import Drive
from process.errors import InputError
from process.labels import axis_present, label, sample_interval
from process.types import Complex, Real
from smfe.identification.drive.rules import RULES
from smfe.identification.spectra.periods import error, noise_power, periods_of, response

ORDERS = (2, 3, 4, 5)
"""Powers of the vibration velocity with which a friction law bends about the feed."""


def open_loop_response(
    record: xr.Dataset,
    axis: str,
    period: float,
    *,
    skip: int = 1,
    hold: float = 0.0,
    band: tuple[float, float] = (0.0, math.inf),
    dry_friction: bool = True,
) -> xr.Dataset:
    """Return the response of carriage position to drive force from a record with periodic excitation, as in Figure 12.

    The ramp of a moving axis is taken away with the slope ``(x(t + T) - x(t))/T``, averaged, which periodic motion does
    not touch. Then ``H = <X>/<F>`` with the Fourier coefficients averaged over whole periods: free of leakage, and free
    of the bias that noise in a closed loop gives to cross spectra, as that averages out before the division.

    What friction and play distort repeats with the period: the scatter of the periods does not have it. It acts like a
    force d beside the drive force, different from line to line, so that the relative error of H is ``d/|F|``. Its
    size is read off the lines: a fourth difference of ``w^2 H`` over five neighbours removes the smooth response and
    leaves ``d``, whose median over 41 lines is taken where it exceeds what the noise makes by three standard errors.

    Parameters
    ----------
    record : xarray.Dataset
        With ``encoder_position`` and ``drive_force``; the excitation (`excitation.PseudoRandom`, ``Multisine``)
        is on all the time, at constant feed and without reversals.
    axis : {"x", "y", "z"}
        Axis that moves.
    period : float
        Period T of the excitation [s], a whole number of samples.
    skip : int, optional
        Periods left out at the beginning, for the transient.
    hold : float, optional
        Time [s] for which a sample of the drive force acts unchanged: the sampling interval where the record holds the
        command of a sampled servo, which else reads as half a sample of dead time; 0 where the force is measured.
    band : tuple of float, optional
        Lowest and highest frequency [Hz].
    dry_friction : bool, optional
        Whether the guideways may stick: an axis that stops or turns round in each period is then refused, because what
        Coulomb friction does there repeats with the period on all lines alike and passes for mass and stiffness.

    Returns
    -------
    xarray.Dataset
        Over ``frequency`` [Hz], the excited lines: ``response`` [m/N]; ``std`` [m/N], the root mean square of its
        complex error, of noise and distortion; ``noise_std`` [m/N], of noise alone, from the scatter ``X_p - H F_p``
        of the P periods, its power averaged over nine lines; ``coherence`` [1] over the periods; ``bend(frequency,
        order)``: what a curved friction law adds to the drive force, over that force, ``-V_n/(n! F)`` with V_n the
        lines of the n-th power of the vibration velocity, n = 2 and 3, [(m/s)^n/N], less what acts like a slope.
        Attributes ``periods``: P; ``feed``: the mean velocity [m/s]; ``velocity``: root mean square of the vibration
        velocity in the band [m/s].

    Raises
    ------
    InputError
        When a channel is missing, the period is not a whole number of samples, fewer than 2 periods are left, no
        line is excited in the band, or the axis stops or turns round.
    """
    force, position, feed = _periods_of(record, axis, period, skip)
    if dry_friction:
        _require_sliding(position.mean(axis=0), feed, period, band[1])
    if not 0.0 <= hold <= sample_interval(record) * (1.0 + 1e-6):
        raise InputError(
            f"a hold of {hold:g} s; give 0, or the sampling interval of the record, {sample_interval(record):g} s"
        )
    count, n = force.shape
    lines = np.arange(1, (n + 1) // 2)
    frequency = lines / period
    f_p, x_p = (periods_of(samples, n)[: lines.size] for samples in (force, position))
    f_p = f_p * (np.sinc(frequency * hold) * np.exp(-1j * np.pi * frequency * hold))[:, None]
    f, x = f_p.mean(axis=1), x_p.mean(axis=1)
    excited = np.abs(f) > RULES.excited * np.abs(f).max()
    used = excited & (frequency >= band[0]) & (frequency <= band[1])
    if not used.any():
        raise InputError(
            f"no line between {band[0]:g} and {band[1]:g} Hz is excited by the drive force; widen the band, or check "
            "the period"
        )
    frequency, f_p, x_p, f, x = frequency[used], f_p[used], x_p[used], f[used], x[used]
    h = response(x[:, None], f[:, None])
    scatter = noise_power(error(x_p, f_p, h)) / count
    width = min(RULES.open_loop_neighbours, scatter.size)
    std = np.sqrt(ndimage.uniform_filter1d(scatter, width, mode="nearest")) / np.abs(f)
    distortion = _distortion(frequency, h, np.abs(f), std)
    vibration = _vibration(position, period)
    cross = np.abs(np.sum(x_p * np.conj(f_p), axis=1)) ** 2
    coherence = cross / (np.sum(np.abs(x_p) ** 2, axis=1) * np.sum(np.abs(f_p) ** 2, axis=1))
    data = {
        "response": ("frequency", h, {"units": "m/N"}),
        "std": ("frequency", np.hypot(std, distortion), {"units": "m/N"}),
        "noise_std": ("frequency", std, {"units": "m/N"}),
        "coherence": ("frequency", coherence, {"units": "1"}),
        "bend": (("frequency", "order"), _bend(vibration, lines[used]) / f[:, None], {"units": "(m/s)^order/N"}),
    }
    attrs = {"axis": axis, "periods": count, "feed": feed, "velocity": float(np.std(vibration))}
    return label(xr.Dataset(data, coords={"frequency": frequency, "order": list(ORDERS)}, attrs=attrs))


def _vibration(position: Real, period: float) -> Real:
    """Return the velocity [m/s] of a period, from positions (periods, n), of the lines that stand above noise."""
    count, n = position.shape
    frequency = np.arange(n // 2 + 1) / period
    spectra = np.fft.rfft(position, axis=1)
    mean = spectra.mean(axis=0)
    noise = np.sum(np.abs(spectra - mean) ** 2, axis=0) / (count - 1) / count
    noise = ndimage.uniform_filter1d(noise, min(RULES.open_loop_neighbours, noise.size), mode="nearest")
    clear = (np.abs(mean) ** 2 > RULES.clear_line * noise) & (frequency < RULES.unfiltered * n / period)
    return np.asarray(np.fft.irfft(np.where(clear, mean * 2j * np.pi * frequency, 0.0), n))


def _bend(velocity: Real, lines: NDArray[np.intp]) -> Complex:
    """Return ``-V_n/n!`` at the lines for a period of velocities (n,), shape (lines, orders).

    Odd powers less their part along v: what acts like a slope of the friction belongs to ``sigma``.
    """
    power = max(float(velocity @ velocity), 1e-300)
    columns = []
    for order in ORDERS:
        curved = velocity**order
        if order % 2:
            curved = curved - velocity * (float(curved @ velocity) / power)
        columns.append(-np.fft.rfft(curved)[lines] / math.factorial(order))
    return np.stack(columns, axis=1)


def _distortion(frequency: Real, response: Complex, force: Real, noise: Real) -> Real:
    """Root mean square error of a response that repeats with the period [m/N]; zero where noise explains all."""
    if frequency.size < 4 * RULES.difference:
        return np.zeros(frequency.size)
    square = (2.0 * np.pi * frequency) ** 2
    places = np.lib.stride_tricks.sliding_window_view(frequency, RULES.difference)
    apart = places[:, :, None] - places[:, None, :] + np.eye(RULES.difference)
    share = 1.0 / np.prod(apart / np.abs(apart).max(axis=(1, 2), keepdims=True), axis=2)

    def over(values: NDArray[Any]) -> NDArray[Any]:
        return np.lib.stride_tricks.sliding_window_view(values, RULES.difference)

    left = np.abs(np.sum(share * over(square * response), axis=1)) ** 2
    unit = np.sum((share * over(square * np.abs(response) / force)) ** 2, axis=1)
    of_noise = np.sum((share * over(square * noise)) ** 2, axis=1) / unit
    # The median of an exponential distribution is ln 2 of its mean.
    of_all = left / unit / math.log(2.0)
    independent = of_all.size / (0.5 * RULES.difference)
    excess = 1.0 + 3.0 / (math.log(2.0) * math.sqrt(independent))
    if not np.median(of_all / np.maximum(of_noise, 1e-300)) > excess:
        return np.zeros(frequency.size)
    size = min(RULES.distortion_lines, of_all.size)
    smooth = ndimage.median_filter(of_all, size, mode="nearest") - ndimage.median_filter(of_noise, size, mode="nearest")
    at = np.clip(np.arange(frequency.size) - RULES.difference // 2, 0, smooth.size - 1)
    return np.asarray(np.abs(response) / force * np.sqrt(np.maximum(smooth[at], 0.0)))


def _periods_of(record: xr.Dataset, axis: str, period: float, skip: int) -> tuple[Real, Real, float]:
    """Drive force and position without its ramp, each (periods, samples a period), and the slope of the ramp [m/s]."""
    for channel in ("encoder_position", "drive_force"):
        if axis not in axis_present(record, channel):
            raise InputError(f"the record has no {channel} on axis {axis!r}; the open loop is read from both channels")
    dt = sample_interval(record)
    n = round(period / dt) if 0.0 < period < math.inf else 0
    if n < 4 or abs(n * dt - period) > 1e-3 * dt:
        raise InputError(
            f"the period {period:g} s is {period / dt:.6g} samples; a response without leakage needs a whole number, 4 "
            "or more: choose the clock of the excitation as a divisor of the sampling rate"
        )
    count = record.sizes["time"] // n - skip
    if skip < 0 or count < 2:
        raise InputError(
            f"the record holds {record.sizes['time'] / n:.3g} periods and {skip} are skipped; 2 more are needed"
        )
    first = skip * n
    force, position = (
        record[name].sel(axis=axis).values[first : first + count * n] for name in ("drive_force", "encoder_position")
    )
    slope = float(np.mean(position[n:] - position[:-n])) / n
    ramp = slope * np.arange(count * n)
    return force.reshape(count, n), (position - position[0] - ramp).reshape(count, n), slope / dt


def _require_sliding(position: Real, feed: float, period: float, highest: float) -> None:
    """Refuse a period, mean position (n,) without its ramp, in which the velocity [m/s] falls to nothing."""
    n = position.size
    frequency = np.arange(n // 2 + 1) / period
    spectrum = np.fft.rfft(position) * 2j * np.pi * frequency
    spectrum[(frequency > highest) | (frequency >= 0.4 * n / period)] = 0.0
    velocity = np.sign(feed) * (feed + np.fft.irfft(spectrum, n))
    if np.quantile(velocity, RULES.stopped) <= RULES.slow * abs(feed):
        raise InputError(
            f"the axis stops or turns round within each period: at a feed of {6e4 * abs(feed):.4g} mm/min the "
            f"excitation moves it by {6e4 * float(np.std(velocity)):.4g} mm/min (root mean square). Friction that "
            "sticks then passes for mass and stiffness: move the axis faster, or excite it less. Without dry friction "
            "(air or hydrostatic bearings) give dry_friction=False"
        )


PARAMETERS: tuple[str, ...] = ("moving_mass", "tip_mass", "stiffness", "damping", "sigma", "delay")
"""What `fit_open_loop` finds, in the order of its covariance."""


@dataclass(frozen=True)
class OpenLoopFit:
    """Eq. (2) fitted to a measured open-loop response.

    Parameters
    ----------
    drive : Drive
        Masses, stiffness, damping and friction slope; no servo.
    delay : float
        Dead time [s].
    std : dict
        Name in `PARAMETERS` -> standard deviation (SI).
    covariance : ndarray, shape (6, 6)
        Of the parameters, in the order of `PARAMETERS` (SI).
    misfit : float
        Root mean square of the complex residual over its standard deviation, 1 where Eq. (2) is what was measured;
        relative to the response where no standard deviation is given.
    """

    drive: Drive
    delay: float
    std: dict[str, float]
    covariance: Real
    misfit: float


def fit_open_loop(
    frequency: ArrayLike,
    response: ArrayLike,
    std: ArrayLike | None = None,
    start: Drive | None = None,
    bend: ArrayLike | None = None,
) -> OpenLoopFit:
    """Fit Eq. (2) to a measured response of carriage position to drive force.

    Least squares of ``(model - response)/std``, or of the complex ``ln(model/response)`` where no std is given: for
    noise in proportion to the response that is unbiased, which ``model/response - 1`` is not. Masses, stiffness and
    damping are fitted as logarithms, so they stay positive. The uncertainty is ``s^2 (J^T J)^-1`` with s^2 from the
    residual, 2 n - 6 degrees of freedom. A friction law that is curved where the axis runs distorts the response; with
    `bend` its derivatives at the feed are found as well, ``H (exp(-j w tau) + sum_n f_n bend_n)``, and what they add is
    taken away. A misfit above `DriveRules.largest_misfit` is refused, and so are masses or a stiffness that the
    response does not determine.

    Parameters
    ----------
    frequency : array_like, shape (n,)
        Frequency [Hz], above zero, reaching beyond the resonance.
    response : array_like of complex, shape (n,)
        Position over force [m/N].
    std : array_like, shape (n,), optional
        Root mean square of the complex error of the response [m/N], that of `open_loop_response`; default in proportion
        to its magnitude, of unknown size.
    start : Drive, optional
        First guess; default one that is read off the response and one that is scanned, of which the better counts.
    bend : array_like of complex, shape (n, 2), optional
        That of `open_loop_response`.

    Returns
    -------
    OpenLoopFit
        Parameters with uncertainty.

    Raises
    ------
    InputError
        With fewer than 4 lines, a standard deviation that is not positive, when the least squares do not converge, when
        the misfit is large, when the anti-resonance is not in the band, or when a mass or the stiffness is uncertain by
        more than half of itself.
    """
    f, h = np.asarray(frequency, dtype=float), np.asarray(response, dtype=np.complex128)
    if f.size < 4 or f.shape != h.shape or not np.all(f > 0.0):
        raise InputError(f"{f.size} frequencies and {h.size} values; at least 4 lines above 0 Hz are needed")
    scatter = np.ones(f.size) if std is None else np.broadcast_to(np.asarray(std, dtype=float), f.shape)
    if not np.all((scatter > 0.0) & np.isfinite(scatter)):
        raise InputError("a standard deviation of the response is not a positive number; give that of each line [m/N]")
    weight = None if std is None else 1.0 / scatter
    relative = np.abs(h) if std is None else scatter
    guesses = (_by_mobility(f, h), _by_scan(f, h, relative)) if start is None else (start,)
    # Logarithms for what is positive; the other two in units that make them of order one.
    unit = np.array([1.0, 1.0, 1.0, 1.0, 2.0 * np.pi * f.min() * (guesses[0].moving_mass + guesses[0].tip_mass), 1e-3])
    bent = np.zeros((f.size, 0)) if bend is None else np.asarray(bend, dtype=np.complex128)
    if bent.shape[0] != f.size:
        raise InputError(f"{f.size} frequencies and a bend of shape {bent.shape}; give that of the response")
    bent = bent / np.maximum(np.sqrt(np.mean(np.abs(bent) ** 2, axis=0)), 1e-300)

    def model(theta: Real) -> tuple[Drive, float]:
        mm, mt, k, c = np.exp(np.clip(theta[:4], -50.0, 50.0))
        return Drive(float(mm), float(mt), float(k), float(c), None, float(theta[4] * unit[4])), float(theta[5] * 1e-3)

    def residual(theta: Real) -> Real:
        drive, delay = model(theta)
        # The bend acts at the carriage, after the dead time.
        x = drive.open_loop(f, delay) + drive.open_loop(f, 0.0) * (bent @ theta[6:])
        r = np.log(x / h) if weight is None else (x - h) * weight
        return np.concatenate([r.real, r.imag])

    def solve(first: Drive) -> optimize.OptimizeResult:
        theta0 = np.log([first.moving_mass, first.tip_mass, first.stiffness, first.damping])
        theta0 = np.concatenate([theta0, np.zeros(2 + bent.shape[1])])
        return optimize.least_squares(residual, theta0, x_scale="jac", max_nfev=500, ftol=1e-14, xtol=1e-14, gtol=1e-14)

    found = min((solve(first) for first in guesses), key=lambda one: (not one.success, one.cost))
    if not found.success:
        raise InputError("the fit of Eq. (2) did not converge; check the band, or give a start")
    drive, delay = model(found.x)
    fit = _with_uncertainty(drive, delay, np.asarray(found.jac), found.fun, unit)
    _require_sound(fit, f, weight is not None)
    return fit


def _require_sound(fit: OpenLoopFit, frequency: Real, weighted: bool) -> None:
    """Refuse a fit that is not what was measured, or does not determine what it names."""
    if weighted and not fit.misfit <= RULES.largest_misfit:
        raise InputError(
            f"Eq. (2) misses the response by {fit.misfit:.3g} times its standard deviation (root mean square), more "
            f"than {RULES.largest_misfit:g}: the parameters would be wrong by more than they state. Either the axis "
            "has more than two masses in the band (narrow it), or friction distorts the response (move the axis faster "
            "than it vibrates, or excite it less), or the standard deviation is too small"
        )
    anti_resonance = fit.drive.locked_frequency
    if not (frequency.min() <= anti_resonance <= frequency.max() and 1e-5 < fit.drive.locked_damping < 1.0):
        raise InputError(
            f"the fit of Eq. (2) has its anti-resonance at {anti_resonance:.3g} Hz with a damping ratio of "
            f"{fit.drive.locked_damping:.3g}, for lines from {frequency.min():.4g} to {frequency.max():.4g} Hz: no tip "
            "vibrates so on a carriage; give a band that holds the anti-resonance and the resonance"
        )
    for name in ("moving_mass", "tip_mass", "stiffness"):
        value, std = getattr(fit.drive, name), fit.std[name]
        if not std < 0.5 * value:
            raise InputError(
                f"the {name.replace('_', ' ')} comes out as {value:.3g} with a standard deviation of {std:.2g}: the "
                "response does not determine it; the band must hold the anti-resonance and the resonance, with lines "
                "between them that stand above noise and distortion"
            )


def _with_uncertainty(drive: Drive, delay: float, jacobian: Real, residual: Real, unit: Real) -> OpenLoopFit:
    variance = float(residual @ residual) / max(1, residual.size - jacobian.shape[1])
    # d parameter/d theta: a logarithm's is the parameter itself. A direction that changes nothing is uncertain without
    # end, which a pseudo-inverse would call certain.
    norm = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-100)
    left, values, right = np.linalg.svd(jacobian / norm, full_matrices=False)
    root = (right.T / np.maximum(values, 1e-15 * values[0]) / norm[:, None])[: len(PARAMETERS)]
    scale = np.array([drive.moving_mass, drive.tip_mass, drive.stiffness, drive.damping, *unit[4:]])
    # Weights are estimates, and wrong where noise changes within a few lines: what each line leaves counts where it is
    # more (MacKinnon and White 1985, HC3).
    score = left * (residual / np.maximum(1.0 - np.sum(left**2, axis=1), 0.1))[:, None]
    score = score.reshape(2, -1, score.shape[1]).sum(axis=0)
    with np.errstate(over="ignore", invalid="ignore"):
        alike = variance * (root @ root.T)
        robust = root @ (score.T @ score) @ root.T
        more = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(alike), 1e-300), 1.0))
        covariance = np.asarray(alike * np.outer(more * scale, more * scale), dtype=float)
    std = dict(zip(PARAMETERS, np.sqrt(np.diag(covariance)).tolist(), strict=True))
    misfit = math.sqrt(2.0 * float(residual @ residual) / residual.size)
    return OpenLoopFit(drive, delay, std, covariance, misfit)


def _by_scan(f: Real, h: Complex, std: Real) -> Drive:
    """Try anti-resonances and dead times: for each, masses and friction slope are linear in ``1/H`` (z = 2 %).

    ``exp(-s tau)/H = m_m s^2 + m_t s^2 (1 + 2 z s/w_t)/(1 + 2 z s/w_t + (s/w_t)^2) + sigma s``
    """
    s = 2j * np.pi * f
    # A line counts by its relative error, none of them for more than a twentieth would say.
    weight = np.abs(h) / np.maximum(std / np.abs(h), RULES.guess_error)
    best, least = _by_mobility(f, h), math.inf
    late = weight[:, None] * np.exp(-np.outer(s, RULES.guess_delays)) / h[:, None]
    right = np.concatenate([late.real, late.imag])
    for at in np.geomspace(f[0], f[-1], math.ceil(math.log(f[-1] / f[0]) / 0.02) + 1):
        x = s / (2.0 * np.pi * at)
        tip = s**2 * (1.0 + 0.04 * x) / (1.0 + 0.04 * x + x**2)
        columns = weight[:, None] * np.column_stack([s**2, tip, s])
        columns = np.vstack([columns.real, columns.imag])
        scale = np.linalg.norm(columns, axis=0)
        values, *_ = np.linalg.lstsq(columns / scale, right, rcond=None)
        left = np.sum((right - columns / scale @ values) ** 2, axis=0)
        masses = (values / scale[:, None])[:2]
        left[~np.all(masses > 0.0, axis=0)] = math.inf
        k = int(np.argmin(left))
        if left[k] < least:
            mm, mt = masses[:, k].tolist()
            stiffness = mt * (2.0 * np.pi * at) ** 2
            best, least = Drive(mm, mt, stiffness, 0.04 * math.sqrt(stiffness * mt)), float(left[k])
    return best


def _by_mobility(f: Real, h: Complex) -> Drive:
    """Read ``|w^2 H|``: 1/(m_m + m_t) at low frequency, its least at f_t, its greatest at f_t sqrt(1 + m_t/m_m)."""
    mobility = np.abs(h) * (2.0 * np.pi * f) ** 2
    low = int(np.argmin(mobility[: max(3, int(np.argmax(mobility)))]))
    high = low + int(np.argmax(mobility[low:]))
    ratio = max((f[high] / f[low]) ** 2 - 1.0, 0.05)
    # Between the two limits, 1/(m_m + m_t) below and 1/m_m above, the geometric mean of the quiet lines will do.
    total = 1.0 / float(np.median(mobility[: max(2, low // 2)]))
    tip = total * ratio / (1.0 + ratio)
    stiffness = tip * (2.0 * np.pi * f[low]) ** 2
    return Drive(total - tip, tip, stiffness, 0.04 * math.sqrt(stiffness * tip))
