"""Impact tests: records of hammer hits -> compliance with its uncertainty.

Hits are found and judged (`smfe.hits`) and averaged: ``H1 = S_XF / S_FF`` with ``S_XF = sum X conj(F)`` over
the accepted hits (unbiased for noise on the response, low by ``S_nn/S_FF`` for noise on the force). Blocks
are not tapered: a window would add damping, and a record that has not decayed is reported instead.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import AXES, axis_index, make_compliance, sample_interval
from smfe.hits import (
    FAULTS,
    Hit,
    HitRules,
    accepted,
    block,
    find_hits,
    hit_table,
    judge,
    longest_block,
    quiet_state,
    runs,
    usable_band,
)
from smfe.identification import Identification
from smfe.spectra import block_spectra, check_records, force_samples, hann, motion_axes


def identify_hammer(
    name: str,
    records: Mapping[str, Sequence[xr.Dataset]],
    *,
    frequency_range: tuple[float, float] | None = None,
    resolution: float | None = None,
    exclude: Collection[str] = FAULTS,
    gate_force: bool = False,
    rules: HitRules | None = None,
) -> Identification:
    """Identify compliances from hammer hits.

    Per excitation column ``H1 = S_XF/S_FF`` over the accepted hits. The standard deviation follows from what
    the hits do not have in common, ``s^2 = sum_m |X_m - H F_m|^2 / (M - 1)``, ``var H = s^2 / sum_m
    |F_m|^2``; with one hit neither it nor the coherence ``|S_XF|^2/(S_XX S_FF)`` (1 by construction) says
    anything, and both are NaN.

    Compliance is claimed only where the force carries it: up to where its spectrum has fallen by 20 dB (its
    first deep zero lies beyond) and to the sampling rate over 2.56, from 1/(block length) for a displacement
    and from 2/(block length) for an acceleration, whose noise ``-1/w^2`` raises without bound.

    Parameters
    ----------
    name : str
        Name of the measurement.
    records : mapping of str to sequence of xarray.Dataset
        Excitation axis -> records, each with one hit or several.
    frequency_range : (float, float), optional
        Frequency axis of the result [Hz], NaN where a column is not usable. Default: the band that every
        column claims, without NaN.
    resolution : float, optional
        Spacing of the frequencies [Hz], the inverse of the block length. Default: blocks as long as the hits
        allow (spans shorter than half the median do not count).
    exclude : collection of str, optional
        Faults that keep a hit out of the average, of `FAULTS`.
    gate_force : bool, optional
        Set the force to zero where the hammer is not in contact, which removes the bias that force noise
        brings.
    rules : HitRules, optional
        How hits are found.

    Returns
    -------
    Identification
        Compliance [m/N] with ``compliance_std`` and ``coherence(frequency, response, excitation)``;
        attributes ``usable_from_Hz`` and ``usable_to_Hz`` (one value an excitation) and ``block_length_s``;
        table "hits".

    Raises
    ------
    InputError
        When there are no records, force or motion is missing, a record holds no hits (a sine, noise), no hit
        is left after exclusion, or no frequency is usable.
    """
    rules = rules or HitRules()
    check_records(name, records)
    unknown = set(exclude) - set(FAULTS)
    if unknown:
        raise InputError(f"exclude names {', '.join(sorted(unknown))}; it may name {' and '.join(FAULTS)}")
    columns = {axis: list(group) for axis, group in records.items() if len(group)}
    hits = []
    for axis, group in columns.items():
        for index, record in enumerate(group):
            hits += find_hits(record, axis, index, rules)
    duration = 1.0 / resolution if resolution is not None else longest_block(hits)
    hits = [judge(hit, columns[hit.excitation][hit.record], duration, exclude, rules) for hit in hits]
    averages = [
        _average_column(columns[axis], accepted(name, axis, hits), duration, rules, gate_force, frequency_range)
        for axis in AXES
        if axis in columns
    ]
    compliance = _assemble(name, averages, frequency_range)
    notes = [note for column in averages for note in column.warnings]
    notes += _exclusion_notes(hits) + _cut_notes(averages, frequency_range)
    return Identification(name, "hammer", compliance, {"hits": hit_table(hits)}, tuple(notes))


# --- averaging ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Column:
    """Averaged result of one excitation; arrays of shape (f,) and (f, 3), NaN for a response not recorded."""

    excitation: str
    frequency: NDArray[np.float64]
    block_length: float
    compliance: NDArray[np.complex128]
    std: NDArray[np.float64]
    coherence: NDArray[np.float64]
    band: tuple[float, float]
    warnings: tuple[str, ...]


def _average_column(
    records: Sequence[xr.Dataset],
    hits: Sequence[Hit],
    duration: float,
    rules: HitRules,
    gate: bool,
    wanted: tuple[float, float] | None,
) -> _Column:
    """Average the accepted hits of one excitation axis."""
    axis = hits[0].excitation
    gathered = [
        _gather(records[i], [h for h in hits if h.record == i], duration, rules, gate)
        for i in sorted({h.record for h in hits})
    ]
    frequency = gathered[0].frequency
    for blocks in gathered[1:]:
        if blocks.frequency.size != frequency.size or not np.allclose(blocks.frequency, frequency, rtol=1e-6):
            raise InputError(
                f"the records of excitation {axis} are sampled at different rates; resample them to one rate"
            )
    motion = np.concatenate([b.motion for b in gathered], axis=2)
    force = np.concatenate([b.force for b in gathered], axis=1)
    compliance, std, coherence = average_h1(motion, force)
    power = np.mean(np.abs(force) ** 2, axis=1)
    noise = 0.0 if gate else float(np.mean([b.noise_energy for b in gathered]))
    low, high = usable_band(frequency, power, noise)
    lines = 2.0 if any(motion_axes(records[h.record])[0] == "acceleration" for h in hits) else 1.0
    band = (max(low, lines * float(frequency[0])), high)
    notes = [
        *_hit_count_note(axis, len(hits)),
        *_leakage_note(axis, gathered, band, wanted),
        *_force_noise_note(axis, gathered, frequency, power, _within(band, wanted), gate),
    ]
    length = 1.0 / float(frequency[0])
    return _Column(axis, frequency, length, compliance, std, coherence, band, tuple(notes))


def average_h1(
    motion: NDArray[np.complex128], force: NDArray[np.complex128]
) -> tuple[NDArray[np.complex128], NDArray[np.float64], NDArray[np.float64]]:
    """Return H1, its standard deviation and the coherence.

    ``H = sum X conj(F) / sum |F|^2``, ``var H = sum |X - H F|^2 / (M - 1) / sum |F|^2`` (``E |dH|^2``, both
    parts together), ``coherence = |S_XF|^2 / (S_XX S_FF)``. A response that some hits lack is averaged over
    the others.

    Parameters
    ----------
    motion : ndarray of complex, shape (f, responses, hits)
        Transforms X of the displacement [m s]; NaN where a hit lacks the response.
    force : ndarray of complex, shape (f, hits)
        Transforms F of the force [N s].

    Returns
    -------
    compliance, std, coherence : ndarray, shape (f, responses)
        [m/N], [m/N], [1]; NaN where no hit has the response, the last two also where only one has.
    """
    there = np.isfinite(motion)
    x = np.where(there, motion, 0.0)
    f = np.where(there, force[:, None, :], 0.0)
    hits = there.sum(axis=2)
    sxf = np.sum(x * f.conj(), axis=2)
    sff = np.where(hits > 0, np.sum(np.abs(f) ** 2, axis=2), np.nan)
    sxx = np.sum(np.abs(x) ** 2, axis=2)
    with np.errstate(invalid="ignore"):  # nan + nan j over nan: a response that was not recorded
        h = sxf / sff
    several = hits > 1
    residual = np.sum(np.abs(x - np.where(hits > 0, h, 0.0)[:, :, None] * f) ** 2, axis=2)
    variance = np.where(several, residual / np.maximum(hits - 1, 1), np.nan) / sff
    power = np.where(several & (sxx > 0.0), sxx * sff, np.nan)
    return h, np.sqrt(variance), np.minimum(np.abs(sxf) ** 2 / power, 1.0)


@dataclass(frozen=True)
class _Blocks:
    """Spectra of the blocks of one record, and what is needed to judge decay and force noise."""

    frequency: NDArray[np.float64]
    motion: NDArray[np.complex128]
    force: NDArray[np.complex128]
    quarter_frequency: NDArray[np.float64]
    first_quarter: NDArray[np.complex128]
    last_quarter: NDArray[np.complex128]
    noise_energy: float
    """Expected ``|F|^2`` of the force noise in one block [N^2 s^2]; zero for a force cut to exact zeros."""


def _gather(record: xr.Dataset, hits: Sequence[Hit], duration: float, rules: HitRules, gate: bool) -> _Blocks:
    axis = hits[0].excitation
    dt = sample_interval(record)
    force = force_samples(record, axis)
    level, _, noise = quiet_state(force)
    if gate:
        record = _gated(record, axis, level, rules)
    blocks = [block(hit, dt, duration, rules) for hit in hits]
    length = blocks[0][1]
    spectra = block_spectra(record, [start for start, _ in blocks], length)
    quarter = length // 4
    window = hann(quarter)
    # The first quarter begins with the pulse, so that "first" and "last" are the same stretch of every decay.
    early = block_spectra(record, [hit.onset for hit in hits], quarter, window)
    to_last = length - int(rules.pre_trigger * length) - quarter
    late = block_spectra(record, [hit.onset + to_last for hit in hits], quarter, window)
    return _Blocks(
        frequency=spectra.frequency[1:],  # an acceleration says nothing about 0 Hz, an offset says it wrongly
        motion=_all_axes(spectra.displacement, spectra.response)[1:],
        force=spectra.force[1:, spectra.excitation.index(axis)],
        quarter_frequency=early.frequency[1:],
        first_quarter=_all_axes(early.displacement, early.response)[1:],
        last_quarter=_all_axes(late.displacement, late.response)[1:],
        noise_energy=noise**2 * dt**2 * length,
    )


def _all_axes(spectrum: NDArray[np.complex128], axes: Sequence[str]) -> NDArray[np.complex128]:
    """Return the spectrum with a row for each of x, y, z; NaN where it was not recorded."""
    full = np.full((spectrum.shape[0], len(AXES), spectrum.shape[2]), np.nan, dtype=complex)
    full[:, axis_index(axes)] = spectrum
    return full


def _gated(record: xr.Dataset, axis: str, level: float, rules: HitRules) -> xr.Dataset:
    """Return the record with no force except from one pulse length before a pulse to one after it."""
    force = force_samples(record, axis)
    _, sign, noise = quiet_state(force)
    pulse = sign * (force - level)
    contact = np.zeros(force.size, dtype=bool)
    for a, b in zip(*runs(pulse > max(rules.trigger * pulse.max(), rules.noise * noise)), strict=True):
        contact[max(2 * a - b, 0) : 2 * b - a] = True
    gated = record["force"].copy(deep=True)
    gated.loc[{"axis": axis}] = np.where(contact, force - level, 0.0)
    return record.assign(force=gated)


# --- what the engineer has to know --------------------------------------------------------------------------


def _hit_count_note(axis: str, count: int) -> Iterable[str]:
    if count == 1:
        yield (
            f"excitation {axis}: one hit; its coherence is 1 by construction and its scatter unknown, so "
            "neither is given (take at least 3 to 5 hits)"
        )


def leakage(first: NDArray[np.complex128], last: NDArray[np.complex128]) -> tuple[float, int]:
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
    hits = first.shape[1]

    def mean_and_noise(quarter: NDArray[np.complex128]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        mean = quarter.mean(axis=1)
        noise = np.sum(np.abs(quarter - mean[:, None]) ** 2, axis=1) / max(hits * (hits - 1), 1)
        return np.abs(mean) ** 2, noise

    (early, early_noise), (late, late_noise) = mean_and_noise(first), mean_and_noise(last)
    # Ten and six times the noise of the mean: from few hits its estimate is itself uncertain.
    heard = early > 10.0 * early_noise
    strong = heard & (early > 0.01 * np.max(early, where=heard, initial=0.0))
    if not strong.any() or late[strong].sum() <= 6.0 * late_noise[strong].sum():
        return 0.0, 0
    ratio = float(np.sqrt(late[strong].sum() / early[strong].sum()))
    return min(ratio, 1.0) ** (4.0 / 3.0), int(np.argmax(np.where(strong, late, 0.0)))


def _leakage_note(
    axis: str, gathered: Sequence[_Blocks], band: tuple[float, float], wanted: tuple[float, float] | None
) -> Iterable[str]:
    f = gathered[0].quarter_frequency
    low, high = wanted or band
    # Below two lines of the quarter, the window mixes the line with the drift that -1/w^2 has raised.
    keep = (f >= max(band[0], low, 2.0 * f[0])) & (f <= min(band[1], high))
    if not keep.any():
        return
    # Velocity shows the resonances; displacement also shows the drift of the accelerometer.
    w = f[keep][:, None, None]
    first = w * np.concatenate([b.first_quarter for b in gathered], axis=2)[keep]
    last = w * np.concatenate([b.last_quarter for b in gathered], axis=2)[keep]
    worst, line = 0.0, 0
    for row in range(len(AXES)):
        there = np.isfinite(first[0, row])
        if there.any() and np.abs(first[:, row][:, there]).max() > 0.0:
            worst, line = max((worst, line), leakage(first[:, row][:, there], last[:, row][:, there]))
    if worst > 0.01:
        yield (
            f"excitation {axis}: at the end of the block of {1.0 / gathered[0].frequency[0]:.3g} s the response "
            f"has not decayed (or its sensor drifts), mostly at {f[keep][line]:.3g} Hz; estimated error of the "
            f"compliance there {100.0 * worst:.2g} % (leave more time between hits)"
        )


def _within(band: tuple[float, float], wanted: tuple[float, float] | None) -> tuple[float, float]:
    """Return the part of the usable band that was asked for."""
    return band if wanted is None else (max(band[0], wanted[0]), min(band[1], wanted[1]))


def _force_noise_note(
    axis: str,
    gathered: Sequence[_Blocks],
    frequency: NDArray[np.float64],
    power: NDArray[np.float64],
    band: tuple[float, float],
    gate: bool,
) -> Iterable[str]:
    noise = float(np.mean([b.noise_energy for b in gathered]))
    if any(b.noise_energy == 0.0 for b in gathered):
        yield (
            f"excitation {axis}: the force is exactly constant between hits (windowed before it was stored); "
            "its noise, and the bias that noise brings, cannot be estimated"
        )
    inside = (frequency >= band[0]) & (frequency <= band[1])
    if gate or not inside.any():
        return
    weakest = int(np.flatnonzero(inside)[np.argmin(power[inside])])
    bias = noise / float(power[weakest])
    if bias > 0.01:
        yield (
            f"excitation {axis}: force noise lowers the compliance by up to {100.0 * bias:.2g} % (at "
            f"{frequency[weakest]:.4g} Hz); hit harder, use a harder tip or a narrower frequency_range (from Python: "
            "gate_force=True removes most of it)"
        )


def _exclusion_notes(hits: Sequence[Hit]) -> list[str]:
    return [
        f"excitation {hit.excitation}: {hit.source}, hit {hit.number} is not used: {hit.reason}"
        for hit in hits
        if hit.reason
    ]


def _cut_notes(columns: Sequence[_Column], wanted: tuple[float, float] | None) -> list[str]:
    notes = []
    for c in columns:
        low, high = c.band
        if wanted is not None and (wanted[0] < low * (1.0 - 1e-9) or wanted[1] > high * (1.0 + 1e-9)):
            notes.append(
                f"excitation {c.excitation}: usable from {low:.4g} to {high:.4g} Hz; nothing is claimed "
                f"outside it, though {wanted[0]:.4g} to {wanted[1]:.4g} Hz was asked for"
            )
    return notes


def _assemble(name: str, columns: Sequence[_Column], wanted: tuple[float, float] | None) -> xr.Dataset:
    """Put the columns side by side on one frequency axis."""
    frequency = columns[0].frequency
    for column in columns[1:]:
        shared = min(frequency.size, column.frequency.size)
        if not np.allclose(column.frequency[:shared], frequency[:shared], rtol=1e-6):
            raise InputError(
                f"measurement '{name}': excitations {columns[0].excitation} and {column.excitation} have "
                "blocks of different length; resample the records to one rate or give a resolution"
            )
        frequency = frequency[:shared]
    low, high = wanted or (max(c.band[0] for c in columns), min(c.band[1] for c in columns))
    lines = np.flatnonzero((frequency >= low * (1.0 - 1e-9)) & (frequency <= high * (1.0 + 1e-9)))
    f = frequency[lines]
    claims = [(f >= c.band[0] * (1.0 - 1e-9)) & (f <= c.band[1] * (1.0 + 1e-9)) for c in columns]
    if not any(claim.any() for claim in claims):
        bands = ", ".join(f"{c.excitation} {c.band[0]:.4g} to {c.band[1]:.4g} Hz" for c in columns)
        raise InputError(
            f"measurement '{name}': nothing can be claimed between {low:.4g} and {high:.4g} Hz (usable: {bands}); ask "
            "for another frequency range, record longer blocks, use a harder hammer tip, or pass gate_force=True "
            "where force noise limits the band"
        )
    recorded = [row for row in range(len(AXES)) if any(np.isfinite(c.compliance[0, row]) for c in columns)]

    def stack(attribute: str) -> NDArray[np.complex128]:
        parts = []
        for c, claimed in zip(columns, claims, strict=True):
            parts.append(np.where(claimed[:, None], getattr(c, attribute)[lines][:, recorded], np.nan))
        return np.stack(parts, axis=2)

    dims = ("frequency", "response", "excitation")
    return make_compliance(
        f,
        stack("compliance"),
        [AXES[row] for row in recorded],
        [c.excitation for c in columns],
        {"compliance_std": (dims, stack("std")), "coherence": (dims, stack("coherence"))},
        {
            "usable_from_Hz": [c.band[0] for c in columns],
            "usable_to_Hz": [c.band[1] for c in columns],
            "block_length_s": columns[0].block_length,
        },
    )
