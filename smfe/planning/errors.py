"""How wrong each compliance will be: the estimators of `sweep.sweep`, worked through on the forces of a plan.

**Bands.** Over a band of half width w the estimator fits ``Phi(f + w u) = C_0 + C_1 u + C_2 u^2`` to the lines of all
records. With the energy ``G(f) = sum over records of F F^H`` the normal matrix is ``M_ab = integral u^(a+b) G ds``:

- noise: ``Var Phi_ij = s_i^2 (M^-1)_jj`` of the block a = b = 0, with ``s_i^2 = dt (sigma_a^2/w^4 + sum_j |Phi_ij|^2
  sigma_F^2)`` for white noise of rms sigma sampled every dt; the length of the record cancels;
- bend: what a polynomial of second order misses, ``[integral u^b Phi G ds]_b M^-1 - Phi``;
- beats: harmonics that pass a frequency at different times beat over the band; as far as they do, what the polynomial
  misses of one entry is noise to the others of its row;
- forces: their noise is in the regressors, too, and is taken out of M; the residual keeps it, so that ``M^-1`` becomes
  ``M^-1 (M + N) M^-1``, N over all lines, the air included. Records in whose air N is not measured keep it in M, and
  the compliance comes out too small by ``Phi (1 - M (M + N)^-1)``; where that may be more than
  `SweepRules.most_open` of it, or where N is most of the weakest direction of the forces, the estimator
  solves nothing.

The estimator takes, row by row, the widest band that agrees with all narrower ones, in units of the standard deviation
that it states: that of its residual, where the bend counts as noise. Two bands differ by their difference in bend plus
noise of variance ``V_narrow - V_wide``, so that they agree with the probability of a non-central chi-square; the mean
square errors of the bands are added with the probabilities that they are taken.

**Model.** The default estimator takes its rational model (`expected_model`) where no entry of a row differs from
the band by more than `local_polynomial.model_agreement` standard deviations, else the band. An efficient model and
its difference d to the band are independent, so that falling back adds ``E[|d_j|^2; any |d_k|^2 > a_k]`` of
exponentially distributed squares: the band is taken exactly where it is far off.

**Scatter.** The errors of a model are those of a few poles and amplitudes, shared by all frequencies: what one sweep
will err by scatters about its root mean square as the root of a chi-square over its degrees of freedom does
(`RationalFit.entry_degrees_of_freedom`). Mean and variance of the mean square error give the degrees of freedom, twice
the mean squared over the variance (Satterthwaite 1946). With nu those of the model, to the variance contribute

- the model: ``2 n^2 (n^2 + 2 b^2)/nu`` of a noise n beside a systematic error b, which does not scatter;
- `SweepRules.model_error`, below which no estimate is stated: the square of its mean square, since it is an
  order of magnitude;
- what is not worked out: the square of the whole times `PlanRules.unknown` twice.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage, stats

from process.cut.force import CuttingCoefficients
from process.errors import InputError
from process.labels import AXES, make_compliance
from process.types import Complex, Real
from smfe.identification.sweep.least_squares import Equations
from smfe.identification.sweep.local_polynomial import (
    BANDS,
    LocalPolynomial,
    model_agreement,
)
from smfe.identification.sweep.rational import fit_rational
from smfe.identification.sweep.rules import RULES as SWEEP_RULES
from smfe.planning.forces import Forces, ForceSensor, SweepPlan, force_sensor
from smfe.planning.rules import RULES
from smfe.planning.task import Estimate


@dataclass(frozen=True)
class Instruments:
    """What is recorded with.

    Parameters
    ----------
    acceleration_noise, force_noise : (float, float, float)
        Root mean square of the white noise of x, y, z in the record [m/s2], [N].
    sample_rate : float
        [Hz].
    """

    acceleration_noise: tuple[float, float, float] = (0.012, 0.012, 0.012)
    force_noise: tuple[float, float, float] = (1.5, 1.5, 1.5)
    sample_rate: float = 5000.0

    def response_noise(self, frequency: Real, compliance: Complex) -> Real:
        """Return ``s_i^2`` [m2 s], shape (frequencies, 3): noise that each row of the fit sees, a second of record."""
        omega = 2.0 * math.pi * frequency[:, None]
        # Quieter than any converter: weights stay finite where no noise is declared.
        sensors = np.square(np.maximum(self.acceleration_noise, 1e-6)) / omega**4
        forces = np.abs(compliance) ** 2 @ np.square(self.force_noise)
        return np.asarray((sensors + forces) / self.sample_rate)


@dataclass(frozen=True)
class _Band:
    """One half width: noise, all that varies, what differences count in, systematic error, shapes (f, 3, 3).

    Condition number, and noise of the forces over the greatest that can be solved, (f,).
    """

    noise: Real
    variance: Real
    stated: Real
    bias: Complex
    condition: Real
    noise_ratio: Real


@dataclass(frozen=True)
class _Shared:
    """What all half widths share: truth (f, 3, 3), noise (f, 3) and share of beats (f,) at the frequencies (f,)."""

    forces: Forces
    estimate: Estimate
    sensor: ForceSensor
    frequency: Real
    truth: Complex
    noise: Real
    beats: Real
    order: int


def expected(
    plan: SweepPlan,
    coefficients: CuttingCoefficients,
    estimate: Estimate,
    instruments: Instruments,
    frequency: Real,
    estimator: LocalPolynomial | None = None,
) -> xr.Dataset:
    """Return the compliance that a sweep will find and how wrong each entry will be.

    Parameters
    ----------
    plan : SweepPlan
        The sweep.
    coefficients : CuttingCoefficients
        Work material.
    estimate : Estimate
        The machine.
    instruments : Instruments
        Noise and sample rate.
    frequency : ndarray, shape (f,)
        Frequencies of the evaluation [Hz].
    estimator : LocalPolynomial, optional
        Default: that of `smfe.identification.sweep.sweep.identify_sweep`, with its rational model.

    Returns
    -------
    xarray.Dataset
        ``compliance`` of the estimate, ``compliance_std`` (root mean square of the error to be expected, noise and
        systematic), ``noise_std`` (noise alone), ``force_condition``, ``half_width`` (mean of what will be taken [Hz]);
        with a rational model also ``bands_std``, what `estimators.BANDS` would err by, ``error_freedom``
        (response, excitation), by which the error of one sweep scatters, and the number of its ``poles`` as an
        attribute. ``force_condition`` is infinite where the noise of the forces leaves nothing to solve; the attribute
        ``force_noise_ratio`` is that noise over the greatest with which all frequencies are solved.

    Raises
    ------
    InputError
        When the records are too short for the estimator, or the estimate does not reach beyond the band.
    """
    chosen = LocalPolynomial() if estimator is None else estimator
    truth = estimate.matrix(frequency)
    noise = instruments.response_noise(frequency, truth)
    forces = Forces(plan, coefficients, float(frequency[-1]) + max(chosen.half_widths))
    beats = forces.beat_share(frequency)
    widths = _usable(chosen, plan)
    band = (float(frequency[0]), float(frequency[-1]))
    sensor = force_sensor(plan, coefficients, instruments.force_noise, instruments.sample_rate, band)
    shared = _Shared(forces, estimate, sensor, frequency, truth, noise, beats, chosen.order)
    bands = [_band(shared, w) for w in widths]
    taken = _taken(bands, chosen)
    alone = np.einsum("kfi,kfij->fij", taken, np.array([b.variance + np.abs(b.bias) ** 2 for b in bands]))
    noisy = np.einsum("kfi,kfij->fij", taken, np.array([b.noise for b in bands]))
    likely = taken.argmax(axis=0)
    condition, noise_ratio = (
        np.array(of_bands)[likely, np.arange(frequency.size)[:, None]].max(axis=1)
        for of_bands in ([b.condition for b in bands], [b.noise_ratio for b in bands])
    )
    three = ("frequency", "response", "excitation")
    extra = {
        "force_condition": (three[:1], condition),
        "half_width": (three[:2], np.einsum("kfi,k->fi", taken, np.asarray(widths))),
    }
    attrs: dict[str, object] = {
        "method": "plan",
        "estimator": repr(chosen),
        "force_noise_ratio": float(min(noise_ratio.max(), 1e3)),
    }
    if chosen.rational:
        extra["bands_std"] = (three, np.sqrt(_of_narrow_bands(dict(zip(widths, bands, strict=True)))))
        model = expected_model(forces, estimate, noise, sensor, frequency, chosen.order)
        noisy = model.variance
        agreement = model_agreement(chosen, widths, 3, band[1] - band[0])
        least = SWEEP_RULES.model_error**2 * np.mean(np.abs(truth) ** 2, axis=2, keepdims=True)
        alone = _with_model(noisy, model.bias, bands, taken, agreement) + least
        attrs["poles"] = model.poles
        extra["error_freedom"] = (
            three[1:],
            _degrees_of_freedom(model, alone, least, condition <= SWEEP_RULES.refuse_condition),
        )
    extra |= {"compliance_std": (three, np.sqrt(alone)), "noise_std": (three, np.sqrt(noisy))}
    found = make_compliance(frequency, truth, AXES, extra=extra, attrs=attrs)
    for name in {"noise_std", "bands_std"} & set(extra):
        found[name].attrs["units"] = "m/N"
    found["half_width"].attrs["units"] = "Hz"
    return found


def relative_error(found: xr.Dataset, scale: Real, name: str = "compliance_std") -> Real:
    """Return the rms over frequency of a standard deviation as a fraction of `scale`, shape (3, 3).

    Frequencies that the estimator will not solve do not count, where it solves any.
    """
    std = found[name].transpose("frequency", "response", "excitation").values
    solved = found["force_condition"].values <= SWEEP_RULES.refuse_condition
    std = std[solved] if solved.any() else std
    return np.asarray(np.sqrt(np.mean(std**2, axis=0)) / scale)


def error_interval(degrees_of_freedom: Real, probability: float, sweeps: int = 1) -> tuple[Real, Real]:
    """Return between which multiples of the expected error that of some sweeps lies, with a probability.

    Roots of the quantiles of a chi-square over its degrees of freedom.

    Parameters
    ----------
    degrees_of_freedom : ndarray
        ``error_freedom`` of `expected`.
    probability : float
        Within the interval; the rest is as likely below as above.
    sweeps : int, optional
        Whose mean square is taken.
    """
    n = sweeps * np.asarray(degrees_of_freedom, dtype=float)
    low, high = (np.sqrt(stats.chi2.ppf(q, n) / n) for q in (0.5 - 0.5 * probability, 0.5 + 0.5 * probability))
    return np.asarray(low), np.asarray(high)


def _degrees_of_freedom(model: ExpectedModel, total: Real, least: Real, solved: NDArray[np.bool_]) -> Real:
    """Return the degrees of freedom of what an entry will err by, shape (3, 3)."""
    at = solved if solved.any() else np.ones_like(solved)
    whole, least = np.mean(total[at], axis=0), np.mean(least[at], axis=0)
    fixed = np.minimum(np.mean(np.abs(model.bias[at]) ** 2, axis=0), 0.99 * (whole - least))
    scatters = whole - least - fixed
    variance = 2.0 * scatters * (scatters + 2.0 * fixed) / model.degrees_of_freedom + least**2
    return np.asarray(2.0 * whole**2 / (variance + (2.0 * RULES.unknown * whole) ** 2))


def _of_narrow_bands(bands: dict[float, _Band]) -> Real:
    """Return the mean square error of `BANDS` from those of its half widths that can be filled, shape (f, 3, 3)."""
    usable = [band for width, band in bands.items() if width in BANDS.half_widths]
    usable = usable or [bands[min(bands)]]
    taken = _taken(usable, BANDS)
    return np.asarray(np.einsum("kfi,kfij->fij", taken, [b.variance + np.abs(b.bias) ** 2 for b in usable]))


def _with_model(noise: Real, systematic: Complex, bands: list[_Band], taken: Real, agreement: float) -> Real:
    """Return the mean square error of the model and, where the two disagree, of the band, shape (f, 3, 3)."""
    kept = np.abs(systematic) ** 2
    total = noise.copy()
    for share, band in zip(taken, bands, strict=True):
        apart = np.maximum(band.variance - noise, 0.05 * band.variance)
        distance = np.abs(band.bias - systematic) ** 2
        allowed = np.minimum(agreement**2 * band.stated / np.maximum(apart + distance, 1e-300), 1e3)
        stays = 1.0 - np.exp(-allowed)
        row = np.prod(stays, axis=2, keepdims=True)
        others = row / np.maximum(stays, 1e-300)
        # E[x; x < a] = 1 - (1 + a) exp(-a) of an exponential x of mean 1.
        left = 1.0 - (1.0 - (1.0 + allowed) * np.exp(-allowed)) * others
        # Where the band cannot be solved, nothing is.
        solved = (band.condition <= SWEEP_RULES.refuse_condition)[:, None, None]
        fallen = np.where(solved, apart * left + np.abs(band.bias) ** 2 * (1.0 - row), 0.0)
        total += share[..., None] * (kept * row + fallen)
    return np.asarray(total)


def _usable(estimator: LocalPolynomial, plan: SweepPlan) -> list[float]:
    """Return the half widths that the records can fill: twice as many lines as unknowns (`sweep.sweep`)."""
    seconds = plan.records * plan.record
    needed = 2.0 * estimator.unknowns([False] * plan.records)
    usable = [w for w in sorted(estimator.half_widths) if 2.0 * w * seconds >= needed]
    if not usable:
        raise InputError(
            f"the records of the plan last {seconds:.3g} s together; the estimator needs "
            f"{needed / (2.0 * max(estimator.half_widths)):.3g} s: sweep more slowly or repeat the passes"
        )
    return usable


def _band(shared: _Shared, width: float) -> _Band:
    """Work through one half width [Hz]."""
    plan, frequency = shared.forces.plan, shared.frequency
    points = round(RULES.band_points * max(1.0, width))
    shift = (np.arange(points) + 0.5) * 2.0 / points - 1.0
    at = frequency[:, None] + width * shift
    energy = plan.repeats * np.sum(shared.forces.energy(at), axis=0) * (2.0 * width / points)
    compliance = shared.estimate.matrix(at, beyond=width > 1.0)
    powers = shift ** np.arange(shared.order + 1)[:, None]
    f, size = frequency.size, 3 * (shared.order + 1)
    exact = np.einsum("as,bs,fsij->faibj", powers, powers, energy, optimize=True).reshape(f, size, size)
    right = np.einsum("bs,fsik,fskj->fibj", powers, compliance, energy, optimize=True).reshape(f, 3, size)
    lines = 2.0 * width * plan.record * plan.records
    # Noise is in every line of every record; the energy of a chirp does not grow with the record.
    added = shared.sensor.density * lines / points
    noisy = np.kron(powers @ powers.T, np.diag(added)).astype(np.float64)
    normal = exact if shared.sensor.subtracted else exact + noisy
    taken_out = noisy[:3, :3] if shared.sensor.subtracted else np.zeros((3, 3))
    condition, noise_ratio = _condition(normal[:, :3, :3], taken_out, lines)
    solved = condition <= 10.0 * SWEEP_RULES.refuse_condition
    # What cannot be solved is wrong by ten times the largest compliance.
    noise = np.full((f, 3, 3), 100.0 * float(np.abs(shared.truth).max()) ** 2)
    stated, bias = noise.copy(), np.zeros((f, 3, 3), dtype=complex)
    inverse = np.linalg.inv(normal[solved])
    spread = np.diagonal(inverse @ (exact[solved] + noisy) @ inverse, axis1=1, axis2=2).real[:, None, :3]
    noise[solved] = shared.noise[solved][:, :, None] * spread
    bias[solved] = (right[solved] @ inverse)[:, :, :3] - shared.truth[solved]
    if not shared.sensor.subtracted:
        left = shared.sensor.known / SWEEP_RULES.most_open * np.linalg.norm(bias, axis=(1, 2))
        noise_ratio = left / np.maximum(np.linalg.norm(shared.truth + bias, axis=(1, 2)), 1e-300)
        condition = np.where(noise_ratio <= 1.0, condition, np.inf)
    # What the polynomial misses is in the residual, and the estimator takes that for noise.
    whole = np.einsum("fsik,fskj,fsij->fi", compliance, energy, compliance.conj(), optimize=True).real[solved]
    missed = _missed(whole, right[solved], exact[solved]) / max(lines - size, 1.0)
    stated[solved] = (shared.noise[solved] + missed)[:, :, None] * spread
    varies = noise + shared.beats[:, None, None] * (stated - noise)
    stated = stated + (SWEEP_RULES.same_entry * np.abs(shared.truth)) ** 2
    return _Band(noise, varies, stated, bias, condition, noise_ratio)


def _condition(energy: Complex, noise: Real, lines: float) -> tuple[Real, Real]:
    """Return the condition number of forces whose ``F F^H`` is given (f, 3, 3), and how far their noise drowns them.

    The estimator solves nothing where a noise n^2 that is taken out is more than a share q of the weakest direction e
    with it: from ``n = sqrt(q e/(1 - q))`` on. What it sees of e over L lines scatters by ``sqrt((n^4 + 2 e n^2)/L)``;
    two of these below e it must still be seen, or every fortieth frequency is lost.
    """
    clean, whole = np.linalg.eigvalsh(energy), np.linalg.eigvalsh(energy + noise)
    floor = 1e-30 * clean[:, -1]
    smallest, power = np.maximum(clean[:, 0], floor), whole[:, 0] - clean[:, 0]
    seen = np.maximum(smallest - 2.0 * np.sqrt(power * (power + 2.0 * smallest) / lines), np.maximum(floor, 1e-300))
    noise_ratio = np.sqrt(power / seen * (1.0 - SWEEP_RULES.largest_noise_share) / SWEEP_RULES.largest_noise_share)
    return np.where(noise_ratio <= 1.0, np.sqrt(whole[:, -1] / smallest), np.inf), noise_ratio


def _missed(whole: Real, right: Complex, normal: Complex) -> Real:
    """Return the energy of the response that the best polynomial leaves, shape (f, 3)."""
    best = right @ np.linalg.pinv(normal, hermitian=True)
    kept = np.einsum("fib,fib->fi", best, right.conj()).real
    return np.asarray(np.maximum(whole - kept, 0.0))


def _taken(bands: list[_Band], estimator: LocalPolynomial) -> Real:
    """Return the probability that each band is taken, shape (bands, f, 3)."""
    f = bands[0].variance.shape[0]
    at_least = [np.ones((f, 3))]
    for k in range(1, len(bands)):
        passes = at_least[-1]
        for j in range(k):
            probability = _agrees(bands[k], bands[j], estimator.agreement)
            # The estimator smooths its verdicts over five lines.
            passes = np.minimum(passes, ndimage.median_filter(probability, size=(5, 1), mode="nearest"))
        at_least.append(passes)
    at_least.append(np.zeros((f, 3)))
    taken = np.asarray([at_least[k] - at_least[k + 1] for k in range(len(bands))])
    if estimator.rational and len(bands) > 1:
        # Beside a model the next narrower one is taken.
        taken = np.concatenate([taken[:1] + taken[1:2], taken[2:], np.zeros((1, f, 3))])
    return taken


def _agrees(wide: _Band, narrow: _Band, agreement: float) -> Real:
    """Return the probability that two bands differ by at most `agreement` standard deviations, as the narrower states.

    Shape (f, 3): the entry of each row that agrees least decides.
    """
    scale = np.where(narrow.variance > 0.0, narrow.variance, 1e-300)
    left = np.clip(1.0 - wide.variance / scale, 0.05, 1.0)
    distance = np.minimum(np.abs(wide.bias - narrow.bias) ** 2 / scale, 1e4)
    allowed = np.minimum(agreement**2 * narrow.stated / scale, 1e6)
    probability = stats.ncx2.cdf(2.0 * allowed / left, 2, 2.0 * distance / left)
    return np.asarray(np.min(probability, axis=2))


# --- the rational model: `sweep.rational` on the equations to be expected --------------------------------------------


@dataclass(frozen=True)
class ExpectedModel:
    """What the rational model will be.

    Parameters
    ----------
    variance : ndarray, shape (f, 3, 3)
        Of the noise [m2/N2].
    bias : ndarray of complex, shape (f, 3, 3)
        Systematic error [m/N].
    degrees_of_freedom : ndarray, shape (3, 3)
        Degrees of freedom of the mean square error over the frequencies.
    poles : int
        Number of poles.
    """

    variance: Real
    bias: Complex
    degrees_of_freedom: Real
    poles: int


def expected_model(
    forces: Forces, estimate: Estimate, noise: Real, force_noise: ForceSensor, frequency: Real, order: int
) -> ExpectedModel:
    """Work the rational model out on the sums to be expected.

    Parameters
    ----------
    forces : Forces
        Of the plan.
    estimate : Estimate
        The machine.
    noise : ndarray, shape (f, 3)
        ``s_i^2`` of each row [m2 s].
    force_noise : ForceSensor
        Noise of the forces, and what the air says of it.
    frequency : ndarray, shape (f,)
        Frequencies of the evaluation [Hz].
    order : int
        Order of the polynomial in a bin.
    """
    band = (float(frequency[0]) - RULES.beyond, float(frequency[-1]) + RULES.beyond)
    centre = np.arange(band[0] + 0.5 * RULES.bin_width, band[1], RULES.bin_width)
    at, share = np.polynomial.legendre.leggauss(RULES.bin_points)
    points = centre[:, None] + 0.5 * RULES.bin_width * at
    compliance, truth = estimate.matrix(points), estimate.matrix(frequency)
    plan = forces.plan
    energy = plan.repeats * np.sum(forces.energy(points), axis=0) * (0.5 * RULES.bin_width * share)[:, None, None]
    lines = RULES.bin_width * plan.record * plan.records
    without = _sums(centre, points - centre[:, None], energy, compliance, order, lines)
    power = np.diag(force_noise.density).astype(complex)
    raw = without.without_input_noise(-np.broadcast_to(power, (centre.size, 1, 3, 3)))
    weight = np.stack([1.0 / np.interp(centre, frequency, row) for row in noise.T], axis=1)[:, None, :]
    clean = without if force_noise.subtracted else raw
    fit = fit_rational(clean, raw, weight, band, frequency, 3, known=force_noise.known)
    variance = np.diagonal(fit.covariance, axis1=2, axis2=3).real
    return ExpectedModel(
        np.asarray(variance), np.asarray(fit.value - truth), fit.entry_degrees_of_freedom, fit.poles.size
    )


def _sums(centre: Real, shift: Real, energy: Complex, compliance: Complex, order: int, lines: float) -> Equations:
    """Return the sums over bins of shape (b, points, ...) as one test; `lines` a bin."""
    powers = shift[..., None] ** np.arange(order + 1)
    # conj(F_j) F_k is the transpose of F F^H.
    gram = np.einsum("bsp,bsq,bskj->bpjqk", powers, powers, energy, optimize=True)
    cross = np.einsum("bsp,bsrk,bskj->bpjr", powers, compliance, energy, optimize=True)
    joint = np.einsum("bsik,bskj,bslj->bil", compliance, energy, compliance.conj(), optimize=True)
    moment = np.einsum("bsp,bsq->bpq", powers, powers) * lines / shift.shape[1]
    return Equations(centre, RULES.bin_width, gram[:, None], cross[:, None], joint[:, None], moment[:, None])
