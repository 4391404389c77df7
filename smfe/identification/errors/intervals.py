"""Intervals of a compliance from its standard deviation, and how few hits widen them.

``compliance_std`` is the root mean square of the complex error, ``std^2 = E |d|^2 = var Re + var Im``. How it divides
between the parts is the relation ``E d^2``: ``var Re = (std^2 + Re E d^2)/2``, ``var Im = (std^2 - Re E d^2)/2``. Noise
of a sensor is circular and has no relation; hits that differ by a factor err along the compliance itself, all in the
real part below a resonance. The variances are themselves estimated: the error of a part over its standard deviation
follows Student's t with ``degrees_of_freedom`` (M hits: M - 1).
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy import stats

from process.errors import InputError
from process.labels import check_compliance
from process.types import Real


def interval(compliance: xr.Dataset, probability: float = 0.95) -> xr.Dataset:
    """Return the interval in which each part of each entry of a compliance lies with a probability.

    ``Re Phi +- t_nu(1/2 + p/2) sqrt(var Re)``, and the same of the imaginary part, each for itself: both together hold
    less often, with ``p^2`` where they are independent.

    Parameters
    ----------
    compliance : xarray.Dataset
        With ``compliance_std`` [m/N]; where known ``compliance_relation`` [m2/N2] (else circular errors) and
        ``degrees_of_freedom`` (else many: the normal distribution). Any dimensions beside those of a compliance.
    probability : float, optional
        p, above 0 and below 1.

    Returns
    -------
    xarray.Dataset
        ``lower`` and ``upper``, complex [m/N]: their real parts bound the real part, their imaginary parts the
        imaginary part. NaN where the standard deviation is unknown.

    Raises
    ------
    InputError
        For a probability out of range, or a compliance without standard deviation.
    """
    if not 0.0 < probability < 1.0:
        raise InputError(f"a probability of {probability:g}; give one above 0 and below 1, e.g. 0.95")
    center = check_compliance(compliance)["compliance"]
    std_real, std_imaginary = component_std(compliance)
    if "degrees_of_freedom" in compliance:
        degrees_of_freedom = compliance["degrees_of_freedom"].broadcast_like(std_real).transpose(*std_real.dims).values
    else:
        degrees_of_freedom = np.full(std_real.shape, np.inf)
    quantile = student_quantile(degrees_of_freedom, probability)
    reach = (std_real * quantile + std_imaginary * (1j * quantile)).transpose(*center.dims)
    lower = center.copy(data=center.values - reach.values)
    upper = center.copy(data=center.values + reach.values)
    return xr.Dataset({"lower": lower, "upper": upper}, attrs={"probability": probability})


def component_std(compliance: xr.Dataset) -> tuple[xr.DataArray, xr.DataArray]:
    """Return the standard deviations of the real and of the imaginary part of a compliance [m/N].

    Parameters
    ----------
    compliance : xarray.Dataset
        With ``compliance_std`` and, where known, ``compliance_relation``.

    Raises
    ------
    InputError
        When it has no standard deviation.
    """
    if "compliance_std" not in compliance:
        raise InputError("the compliance has no compliance_std, so no interval can be given; identify it from repeats")
    power = compliance["compliance_std"] ** 2
    relation = np.zeros(power.shape)
    if "compliance_relation" in compliance:
        relation = compliance["compliance_relation"].transpose(*power.dims).values.real

    def part(sign: float) -> xr.DataArray:
        return power.copy(data=np.sqrt(np.maximum(0.5 * (power.values + sign * relation), 0.0)))

    return part(1.0), part(-1.0)


def student_quantile(degrees_of_freedom: Real, probability: float) -> Real:
    """Return the two-sided quantile of Student's t for degrees of freedom (infinite: normal); NaN for less than 1/2."""
    known = np.isfinite(degrees_of_freedom) & (degrees_of_freedom >= 0.5)
    upper = 0.5 + 0.5 * probability
    quantile = np.where(np.isposinf(degrees_of_freedom), stats.norm.ppf(upper), np.nan)
    # Many lines have the same number of hits; Student's quantile is slow.
    values, place = np.unique(np.round(degrees_of_freedom[known], 3), return_inverse=True)
    quantile[known] = np.asarray(stats.t.ppf(upper, values))[place]
    return np.asarray(quantile, dtype=float)
