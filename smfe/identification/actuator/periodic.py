"""Inertial actuator, periodic force: multisines and repeated chirps -> compliance with its uncertainty.

``Phi = sum_r Y_r conj(U_r) / sum_r |U_r|^2`` with the mean spectra U, Y of the periods of each record r (for one record
``Y/U``; see `smfe.identification.spectra.periods`). What changes from period to period is noise. Distortion repeats
with the force and is not in it; three records with other phases have it in their scatter as well
(`smfe.identification.actuator.distortion` distinguishes even from odd).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import AXES, axis_index, sample_interval
from process.types import Complex, Real
from smfe.identification.actuator.columns import Column, joined
from smfe.identification.actuator.rules import RULES
from smfe.identification.errors.averaging import degrees_of_freedom
from smfe.identification.errors.result import Identification
from smfe.identification.spectra.periods import error, noise_power, response, settled
from smfe.identification.spectra.spectra import block_spectra, check_records, force_samples, record_source


def identify_periodic(
    name: str,
    records: Mapping[str, Sequence[xr.Dataset]],
    period: float,
    *,
    settling: float | None = None,
    frequency_range: tuple[float, float] | None = None,
) -> Identification:
    """Identify compliances from a force that repeats itself.

    Parameters
    ----------
    name : str
        Name of the measurement.
    records : mapping of str to sequence of xarray.Dataset
        Excitation axis -> records; several records of an axis may have other phases.
    period : float
        [s]; a whole number of samples.
    settling : float, optional
        Dropped at the beginning of each record [s]. Default: the first period, where there are three or more.
    frequency_range : (float, float), optional
        Keep only these frequencies [Hz].

    Returns
    -------
    Identification
        Compliance [m/N] at the lines that the force excites in each column, NaN elsewhere, with ``compliance_std``,
        ``compliance_relation``, ``degrees_of_freedom`` (P periods, R records: 2 R (P - 1); from three records R - 1)
        and ``coherence``, the share of the response that repeats; table "steps", one row a record.

    Raises
    ------
    InputError
        When there are no records, force or motion is missing, a period is no whole number of samples, a record holds
        less than two, or no line is excited.
    """
    check_records(name, records)
    if not 0.0 < period < np.inf:
        raise InputError(f"a period of {period:g} s; it must be positive")
    found = [_column(axis, records[axis], period, settling) for axis in AXES if len(records.get(axis, ()))]
    columns = [c for _, c in found]
    size = min(f.size for f, _ in found)
    frequency = found[0][0][:size]
    if any(not np.allclose(f[:size], frequency, rtol=1e-6) for f, _ in found):
        raise InputError(f"measurement '{name}': its records have different lines; resample them to one rate")
    low, high = frequency_range or (0.0, np.inf)
    known = np.any([np.isfinite(c.compliance[:size]).any(axis=1) for c in columns], axis=0)
    lines = np.flatnonzero(known & (frequency >= low * (1.0 - 1e-9)) & (frequency <= high * (1.0 + 1e-9)))
    if not lines.size:
        where = f" between {low:.4g} and {high:.4g} Hz" if frequency_range else ""
        raise InputError(
            f"measurement '{name}': the force excites no line of the period{where}; check the period, the frequency "
            "range and that the force repeats itself"
        )
    compliance = joined(frequency, columns, lines, {"excitation_kind": "periodic"})
    notes = tuple(note for c in columns for note in c.notes)
    return Identification(name, "actuator", compliance, {"steps": pd.concat([c.table for c in columns])}, notes)


# --- one excitation ------------------------------------------------------------------------------------------------


def _column(axis: str, records: Sequence[xr.Dataset], period: float, settling: float | None) -> tuple[Real, Column]:
    """Return the lines of a period [Hz], and what one excitation gives there."""
    spectra = [_periods(record, axis, record_source(record, i), period, settling) for i, record in enumerate(records)]
    frequency = spectra[0].frequency
    for other in spectra[1:]:
        if other.frequency.size != frequency.size:
            raise InputError(
                f"the records of excitation {axis} are sampled at different rates; resample them to one rate"
            )
    mean_u = np.stack([s.force.mean(axis=1) for s in spectra], axis=1)
    mean_y = np.stack([s.motion.mean(axis=2) for s in spectra], axis=2)
    power = np.sum(np.abs(mean_u) ** 2, axis=1)
    phi = response(mean_y, mean_u)
    if len(records) >= 3:
        variance, relation, each = _between_records(phi, mean_y, mean_u)
    else:
        variance, each = _within_records(phi, spectra, mean_u)
        relation = np.zeros_like(phi)
    total = np.sum(np.abs(mean_y) ** 2, axis=2)
    coherence = np.clip(
        1.0 - np.sum([s.scatter(phi) for s in spectra], axis=0) / np.where(total > 0, total, np.nan), 0, 1
    )
    excited = _excited(spectra, power, frequency)
    cut = np.where(excited[:, None], 1.0, np.nan)
    relation = np.where(excited[:, None], relation, np.nan)
    notes = [note for s in spectra for note in s.notes(axis, phi, excited)]
    found = Column(
        axis,
        phi * cut,
        variance * cut,
        relation,
        each * cut,
        coherence * cut,
        pd.DataFrame([s.row(axis) for s in spectra]),
        tuple(notes),
    )
    return frequency, found


@dataclass(frozen=True)
class _Periods:
    """Spectra of the periods of a record: shapes (f,), (f, P), (f, 3, P); NaN for a response not recorded."""

    frequency: Real
    force: Complex
    motion: Complex
    source: str
    settling: float
    length: int
    rms: float

    @property
    def count(self) -> int:
        """Number of periods."""
        return int(self.force.shape[1])

    def error(self, phi: Complex) -> Complex:
        """Return what each period has beside the mean of its record, ``Y - Phi U``, shape (f, 3, P)."""
        e = error(self.motion, self.force, phi)
        return np.asarray(e - e.mean(axis=2, keepdims=True))

    def scatter(self, phi: Complex) -> Real:
        """Return the mean power of that, unbiased, shape (f, 3)."""
        return noise_power(self.error(phi))

    def row(self, axis: str) -> dict[str, object]:
        """Return the row of the table."""
        return {
            "excitation": axis,
            "file": self.source,
            "periods": self.count,
            "settling_s": self.settling,
            "force_N": self.rms * np.sqrt(2.0),
        }

    def notes(self, axis: str, phi: Complex, excited: NDArray[np.bool_]) -> list[str]:
        """Say whether the first period differs from the others by more than these from each other."""
        if self.count < 3:
            return []
        power = np.nansum(np.abs(self.error(phi)[excited]) ** 2, axis=(0, 1))
        ratio = float(power[0] / np.mean(power[1:])) if power[1:].any() else 1.0
        if ratio <= RULES.unsettled:
            return []
        return [
            f"excitation {axis}: {self.source}: the first period used differs from the others by {ratio:.2g} times the "
            "power that these differ by: it has not settled (give settling, or leave the actuator on for longer)"
        ]


def _periods(record: xr.Dataset, axis: str, source: str, period: float, settling: float | None) -> _Periods:
    dt = sample_interval(record)
    samples = period / dt
    length = round(samples)
    available = record.sizes["time"]
    if length < 4 or abs(samples - length) * (available / max(length, 1)) > 0.05:
        raise InputError(
            f"{source}: a period of {period:g} s is {samples:.6g} samples long; lines would leak: give the right "
            "period, or resample the record so that it is a whole number of samples"
        )
    skip, count = settled(available, length, dt, settling)
    if count < 2:
        raise InputError(
            f"{source}: {available * dt:.4g} s hold {max(count, 0)} periods of {period:g} s after {skip * dt:.3g} s of "
            "settling; two are needed for the noise, better five: record longer"
        )
    spectra = block_spectra(record, [skip + k * length for k in range(count)], length)
    motion = np.full((spectra.frequency.size, len(AXES), count), np.nan, dtype=complex)
    motion[:, axis_index(spectra.response)] = spectra.displacement
    force = force_samples(record, axis, source)
    used = force[skip : skip + count * length]
    return _Periods(
        spectra.frequency[1:],
        spectra.force[1:, spectra.excitation.index(axis)],
        motion[1:],
        source,
        skip * dt,
        length,
        float(np.std(used)),
    )


def _within_records(phi: Complex, spectra: Sequence[_Periods], mean_u: Complex) -> tuple[Real, Real]:
    """Return variance and degrees of freedom from what changes from period to period: stationary noise, circular."""
    power = np.sum(np.abs(mean_u) ** 2, axis=1)
    variance = np.zeros(phi.shape)
    for r, s in enumerate(spectra):
        variance += (np.abs(mean_u[:, r]) ** 2)[:, None] * s.scatter(phi) / s.count
    with np.errstate(divide="ignore", invalid="ignore"):
        return variance / power[:, None] ** 2, np.full(phi.shape, 2.0 * sum(s.count - 1 for s in spectra))


def _between_records(phi: Complex, mean_y: Complex, mean_u: Complex) -> tuple[Real, Complex, Real]:
    """Return variance, relation and degrees of freedom from what records differ by: distortion and noise."""
    power = np.sum(np.abs(mean_u) ** 2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        leverage = np.abs(mean_u) ** 2 / power[:, None]
        e = error(mean_y, mean_u, phi)
        d = mean_u.conj()[:, None, :] * e / power[:, None, None] / np.sqrt(1.0 - leverage)[:, None, :]
    each = degrees_of_freedom(np.nan_to_num(np.broadcast_to(leverage[:, None, :], d.shape)))
    with np.errstate(invalid="ignore"):
        return np.sum(np.abs(d) ** 2, axis=2), np.sum(d**2, axis=2), each


def _excited(spectra: Sequence[_Periods], power: Real, frequency: Real) -> NDArray[np.bool_]:
    """Return which lines the force excites: within 40 dB of the strongest, 20 dB out of its own noise."""
    noise = np.zeros(power.size)
    for s in spectra:
        noise += noise_power(s.force - s.force.mean(axis=1, keepdims=True)) / s.count
    highest = frequency[-1] * 2.0 / RULES.anti_alias
    return np.asarray(
        (power > RULES.weak_line * power.max()) & (power > RULES.noisy_line * noise) & (frequency <= highest)
    )
