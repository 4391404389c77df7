"""What the force of an actuator does: it dwells (stepped sine), repeats itself (multisine), or neither.

A force repeats itself where its correlation with itself, one period later, is nearly 1. That is looked for piece by
piece, so that a record may hold one multisine after another, each with phases of its own: each is a record of its own
then. The period is read off the phase between both, to a fraction of a sample, because the clock of a generator is not
that of a recorder; where it is no whole number of samples, the record is interpolated at times that make it one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage, signal

from process.errors import InputError
from process.labels import AXES, sample_interval
from process.types import Real
from smfe.identification.actuator.continuous_force import identify_continuous
from smfe.identification.actuator.periodic import identify_periodic
from smfe.identification.actuator.rules import RULES
from smfe.identification.actuator.sine_fit import StepRules, find_steps
from smfe.identification.actuator.stepped_sine import identify_actuator
from smfe.identification.errors.result import Identification
from smfe.identification.spectra.spectra import check_records, force_samples, record_source
from smfe.records.clocks import resample
from smfe.records.kind import kind_of


@dataclass(frozen=True)
class Repetition:
    """Stretches of a force that repeat themselves.

    Parameters
    ----------
    period : float
        In samples, with its fraction.
    stretches : tuple of (int, int)
        First sample and number of whole periods of each.
    """

    period: float
    stretches: tuple[tuple[int, int], ...]


def identify_shaken(
    name: str,
    records: Mapping[str, Sequence[xr.Dataset]],
    *,
    period: float | None = None,
    settling: float | None = None,
    frequency_range: tuple[float, float] | None = None,
    resolution: float | None = None,
    estimator: str | None = None,
) -> Identification:
    """Identify compliances from records of an actuator, by the method that its force asks for.

    Parameters
    ----------
    name : str
        Name of the measurement.
    records : mapping of str to sequence of xarray.Dataset
        Excitation axis -> records.
    period : float, optional
        Of a force that repeats itself [s]. None: found.
    settling : float, optional
        Dropped at the beginning of each step, or of a periodic record [s].
    frequency_range : (float, float), optional
        Keep only these frequencies [Hz].
    resolution : float, optional
        Step of the frequency axis of a continuous force [Hz].
    estimator : {"local_polynomial", "H1", "H2", "Hv"}, optional
        Of a continuous force, for which the records are then taken.

    Returns
    -------
    Identification
        Of `stepped_sine.identify_actuator`, `periodic.identify_periodic` or
        `continuous_force.identify_continuous`; a warning says which kind of force was found.

    Raises
    ------
    InputError
        When the kinds of force differ, or the method refuses the records.
    """
    if estimator is not None:
        found = identify_continuous(
            name, records, frequency_range=frequency_range, resolution=resolution, estimator=estimator
        )
    elif period is not None:
        found = identify_periodic(name, records, period, settling=settling, frequency_range=frequency_range)
    else:
        found = _by_kind(name, records, settling, frequency_range, resolution)
    if found.compliance.attrs.get("excitation_kind") in ("periodic", "continuous"):
        # Excited at all frequencies at once: the force has no amplitude of a sine.
        found = replace(found, compliance=found.compliance.assign_attrs(broadband="yes"))
    return replace(found, warnings=(*found.warnings, *_other_forces(records)))


def _other_forces(records: Mapping[str, Sequence[xr.Dataset]]) -> list[str]:
    """Return what is to be said of forces along other axes than that of the excitation, which are not counted."""
    said = []
    for axis, group in records.items():
        for k, record in enumerate(group):
            rms = {str(a): float(record["force"].sel(axis=a).std()) for a in record["force"]["axis"].values}
            for other in (a for a in rms if a != axis and rms[a] > RULES.sideways * rms[axis]):
                said.append(
                    f"{record_source(record, k)}: the force along {other} is {100.0 * rms[other] / rms[axis]:.3g} % of "
                    f"that along {axis}, and what it moves counts as moved by {axis}; align the exciter, or excite one "
                    "axis at a time"
                )
    return said


def _by_kind(
    name: str,
    records: Mapping[str, Sequence[xr.Dataset]],
    settling: float | None,
    frequency_range: tuple[float, float] | None,
    resolution: float | None,
) -> Identification:
    """Identify compliances by the kind of force that is found in the records."""
    check_records(name, records)
    found = {
        (axis, k): _kind(force_samples(record, axis), sample_interval(record))
        for axis in AXES
        for k, record in enumerate(records.get(axis, ()))
    }
    kinds = {(axis, k): text for (axis, k), (text, _) in found.items()}
    if len({_METHOD[kind] for kind in kinds.values()}) > 1:
        listed = ", ".join(f"{record_source(records[a][k], k)}: {kind}" for (a, k), kind in kinds.items())
        raise InputError(
            f"measurement '{name}' mixes kinds of excitation ({listed}); give each kind a measurement of its own"
        )
    kind = next(iter(kinds.values()))
    if _METHOD[kind] == "steps":
        rules = StepRules(settling=settling)
        return identify_actuator(name, records, frequency_range=frequency_range, rules=rules)
    if _METHOD[kind] == "continuous":
        out = identify_continuous(name, records, frequency_range=frequency_range, resolution=resolution)
        said = " and ".join(sorted(set(kinds.values())))
        taken = f"the force was taken for {_ARTICLE.get(said, said)}"
        return replace(out, warnings=(taken, *out.warnings))
    periods = {at: r for at, (_, r) in found.items() if r}
    return _repeated(name, records, periods, settling, frequency_range)


_METHOD = {"steps": "steps", "repeats": "repeats", "a chirp": "continuous", "random excitation": "continuous"}
_ARTICLE = {
    "a chirp": "a continuous chirp",
    "a chirp and random excitation": "chirps and random excitation",
}


def _kind(force: Real, dt: float) -> tuple[str, Repetition | None]:
    """Return "steps", "repeats", "a chirp" or "random excitation", and how it repeats itself."""
    kind = kind_of({"force_x": force}, 1.0 / dt).name
    if kind == "impact test":
        return "steps", None  # whose method says what is wrong
    if kind in ("sine", "stepped sine", "sine sweep"):
        around = force - force.mean()
        steps = find_steps(around, dt)
        inside = sum(float(np.sum(around[a:b] ** 2)) for a, b, _ in steps)
        if inside > RULES.stepped * float(np.sum(around**2)):
            return "steps", None
    repeated = repetition(force)
    if repeated is not None:
        return "repeats", repeated
    return ("a chirp" if kind in ("sine sweep", "stepped sine", "sine") else "random excitation"), None


def repetition(force: Real) -> Repetition | None:
    """Find whether a force repeats itself, in one stretch or several; None where it does not for most of its energy.

    Parameters
    ----------
    force : ndarray, shape (n,)
        [N].
    """
    around = force - np.median(force)
    if not np.any(around):
        return None
    size = fft.next_fast_len(2 * around.size, real=True)
    lines = fft.rfft(around, size)
    shared = fft.irfft(np.abs(lines) ** 2, size)[: around.size // 2 + 1]
    shared = shared / shared[0]
    negative = np.flatnonzero(shared < 0.0)
    if not negative.size or shared.size <= max(RULES.least_period, negative[0]):
        return None
    first = max(RULES.least_period, int(negative[0]))
    peaks, _ = signal.find_peaks(shared, height=0.25)
    for lag in peaks[peaks >= first][np.argsort(-shared[peaks[peaks >= first]])][:5]:
        found = _stretches(around, _smallest(around, shared, int(lag), peaks))
        if found is not None:
            return found
    return None


def _smallest(around: Real, shared: Real, lag: int, peaks: NDArray[np.intp]) -> int:
    """Return the shortest lag of which a lag is a multiple and that correlates as well."""
    for part in range(12, 1, -1):
        near = peaks[np.abs(peaks - lag / part) <= max(2.0, 1e-3 * lag / part)]
        near = near[near >= RULES.least_period]
        if near.size and _stretches(around, int(near[np.argmax(shared[near])])) is not None:
            return int(near[np.argmax(shared[near])])
    return lag


def _stretches(around: Real, lag: int) -> Repetition | None:
    """Return where a force repeats itself after a lag, with the lag to a fraction of a sample."""
    if around.size < 2 * lag:
        return None
    early, late = around[: around.size - lag], around[lag:]
    width = max(16, lag // 8)
    fraction = _fraction(early, late)
    if abs(fraction) > 1.0 + 1e-3 * lag:
        return None
    # Stretches that do not repeat themselves have no part in it.
    same = _alike(early, _moved(late, fraction), width)
    if not same.any():
        return None
    fraction = _fraction(early * same, late * same)
    period, later = lag + fraction, _moved(late, fraction)
    same, near = _alike(early, later, width), _correlation(early, later, max(8, lag // 64)) > 0.9
    label, count = ndimage.label(same)
    out, energy = [], 0.0
    for number in range(1, count + 1):
        at = np.flatnonzero(label == number)
        # The mean over a width falls before the end of a stretch; a mean over less shows where that is.
        start, stop = int(at[0]), int(at[-1]) + 1
        while start > 0 and near[start - 1] and int(at[0]) - start < width:
            start -= 1
        while stop < early.size and near[stop] and stop - int(at[-1]) < width:
            stop += 1
        stop += lag
        periods = int((stop - start) / period + 0.05)
        start = int(np.clip(start - 0.5 * max(periods * period - (stop - start), 0.0), 0, None))
        start = min(start, int(around.size - periods * period + 0.5))
        if periods >= 2 and start >= 0:
            out.append((start, periods))
            energy += float(np.sum(around[start:stop] ** 2))
    if energy < 0.6 * float(np.sum(around**2)):
        return None
    return Repetition(period, tuple(out))


def _alike(early: Real, late: Real, width: int) -> NDArray[np.bool_]:
    """Mark where two signals correlate over a width, and are not silent."""
    power = ndimage.uniform_filter1d(early**2, width)
    same = (_correlation(early, late, width) > RULES.same_force) & (power > 1e-6 * float(power.max()))
    closed = ndimage.binary_closing(np.pad(same, 2 * width, mode="edge"), iterations=width)
    return np.asarray(closed[2 * width : -2 * width])


def _correlation(early: Real, late: Real, width: int) -> Real:
    """Return the correlation of two signals over a width around each sample."""
    power = ndimage.uniform_filter1d(early**2, width) * ndimage.uniform_filter1d(late**2, width)
    shared = ndimage.uniform_filter1d(early * late, width)
    return np.asarray(shared / np.sqrt(np.maximum(power, 1e-300)))


def _fraction(early: Real, late: Real) -> float:
    """Return by how many samples more than its lag `late` comes after `early`: the slope of the phase between both."""
    size = early.size
    a, b = fft.rfft(early), fft.rfft(late)
    omega = 2.0 * np.pi * np.arange(a.size) / size
    cross = a * b.conj()
    weight = np.abs(cross)
    slope = 0.0
    # From low lines, whose phase is not ambiguous, to all.
    for share in (0.05, 0.2, 0.5, 1.0):
        inside = slice(1, max(8, int(share * a.size)))
        turned = np.angle(cross[inside] * np.exp(-1j * slope * omega[inside]))
        total = float(np.sum(weight[inside] * omega[inside] ** 2))
        if total > 0.0:
            slope += float(np.sum(weight[inside] * omega[inside] * turned)) / total
    return slope


def _moved(samples: Real, by: float) -> Real:
    """Return samples at positions moved by a fraction of a sample."""
    if abs(by) < 1e-6:
        return samples
    positions = np.clip(np.arange(samples.size) + by, 0.0, samples.size - 1.0)
    return resample(samples, positions)


def _repeated(
    name: str,
    records: Mapping[str, Sequence[xr.Dataset]],
    found: Mapping[tuple[str, int], Repetition],
    settling: float | None,
    frequency_range: tuple[float, float] | None,
) -> Identification:
    """Cut the records into their periodic stretches, with a period of a whole number of samples."""
    lengths = {round(r.period * 1.0) for r in found.values()}
    steps = {sample_interval(records[a][k]) for a, k in found}
    typical = float(np.median([r.period for r in found.values()]))
    if max(lengths) - min(lengths) > 1 + 2e-4 * typical or max(steps) - min(steps) > 1e-6 * max(steps):
        raise InputError(
            f"measurement '{name}': its records have different periods or sample rates; give each its own measurement"
        )
    whole, dt = round(typical), max(steps)
    cut: dict[str, list[xr.Dataset]] = {}
    for (axis, k), r in found.items():
        for start, periods in r.stretches:
            part = _stretch(records[axis][k], start, periods, r.period, whole)
            cut.setdefault(axis, []).append(part.assign_attrs(file=record_source(records[axis][k], k)))
    out = identify_periodic(name, cut, whole * dt, settling=settling, frequency_range=frequency_range)
    # The lines belong to the period by the clock of the recorder, which is no whole number of its samples.
    lines = out.compliance["frequency"] * (whole / typical)
    out = replace(out, compliance=out.compliance.assign_coords(frequency=lines))
    realisations = {axis: len(group) for axis, group in cut.items()}
    said = f"the force repeats itself after {typical * dt:.6g} s and was taken as periodic"
    if max(realisations.values()) > 1:
        said += f", in {', '.join(f'{n} stretches along {axis}' for axis, n in realisations.items())}"
    if min(realisations.values()) < 3:
        said += "; distortion that repeats itself, too, is not in the standard deviation: three records with other "
        said += "phases show it"
    return replace(out, warnings=(said, *out.warnings))


def _stretch(record: xr.Dataset, start: int, periods: int, period: float, whole: int) -> xr.Dataset:
    """Return a stretch of whole periods, interpolated where a period is no whole number of samples."""
    if abs(period - whole) * periods < RULES.whole_period:
        return record.isel(time=slice(start, min(start + periods * whole, record.sizes["time"])))
    count = periods * whole
    at: Real = np.asarray(start + np.arange(count) * (period / whole), dtype=np.float64)
    count = int(np.count_nonzero(at <= record.sizes["time"] - 1.0))
    part = record.isel(time=slice(start, start + count))
    for channel in [str(n) for n in part.data_vars if "time" in part[n].dims]:
        rows = record[channel].transpose(..., "time").values
        moved = np.array([resample(row, at[:count]) for row in np.atleast_2d(rows)]).reshape(*rows.shape[:-1], count)
        part[channel] = (record[channel].transpose(..., "time").dims, moved, record[channel].attrs)
    return part
