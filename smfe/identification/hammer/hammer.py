"""Impact tests: records of hammer hits -> compliance with its uncertainty.

Hits are found and judged (`impacts`, `direction`) and averaged (`averaging`). Blocks are not tapered
unless an exponential window is asked for, whose damping is taken off again (`hammer.windows`); a record that has not
decayed is reported. What an axis in motion does between hits can be removed (`background`), and so can the mass of
the accelerometer (`smfe.identification.errors.attached_mass`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import AXES, axis_index, make_compliance, sample_interval
from process.types import Complex, Real
from smfe.identification.errors.attached_mass import without_mass
from smfe.identification.errors.averaging import ESTIMATORS, average, degrees_of_freedom, deviations, noise_ratio
from smfe.identification.errors.covariance import error_variables
from smfe.identification.errors.result import Identification
from smfe.identification.hammer.background import (
    Background,
    common_tone_error,
    join_records,
    remove_background,
    tone_errors,
)
from smfe.identification.hammer.direction import HitSpectra, wrong_directions
from smfe.identification.hammer.impacts import (
    FAULTS,
    Hit,
    HitRules,
    accepted,
    block,
    common_duration,
    find_hits,
    hit_table,
    judge,
    longest_block,
    quiet_state,
    runs,
    single_hits,
    usable_band,
)
from smfe.identification.hammer.rules import RULES
from smfe.identification.hammer.windows import (
    check_time_constant,
    exponential,
    laplace_factor,
    leakage,
    leakage_by_line,
    without_window,
)
from smfe.identification.spectra.spectra import block_spectra, check_records, force_samples, hann, motion_axes
from smfe.identification.spectra.tones import Tones


@dataclass(frozen=True)
class Averaging:
    """How hits become a compliance.

    Parameters
    ----------
    estimator : {"H1", "H2", "Hv"}, optional
        See `smfe.identification.errors.averaging.average`. H1 suits a quiet hammer, Hv one whose noise counts.
    noise_ratio : float, optional
        Of Hv: variance of the noise of a sample of the motion channel over that of the force [(m/s2)2/N2 or m2/N2].
        Default: what the hits do not have in common, over the noise of the force between hits, line by line.
    exponential_window : float, optional
        Time constant [s] of a window on force and response, taken off again. Default: none.
    """

    estimator: str = "H1"
    noise_ratio: float | None = None
    exponential_window: float | None = None

    def __post_init__(self) -> None:
        """Refuse an unknown estimator and a ratio that is none."""
        if self.estimator not in ESTIMATORS:
            raise InputError(f"estimator {self.estimator!r} is not known; available: {', '.join(ESTIMATORS)}")
        if self.noise_ratio is not None and not self.noise_ratio > 0.0:
            raise InputError(f"a noise ratio of {self.noise_ratio:g}; give a positive number, or none")


def identify_hammer(
    name: str,
    records: Mapping[str, Sequence[xr.Dataset]],
    *,
    frequency_range: tuple[float, float] | None = None,
    resolution: float | None = None,
    exclude: Collection[str] = FAULTS,
    gate_force: bool = False,
    rules: HitRules | None = None,
    averaging: Averaging | None = None,
    background: Background | None = None,
    accelerometer_mass: float = 0.0,
) -> Identification:
    """Identify compliances from hammer hits.

    Each excitation column is averaged over its accepted hits. Its error follows from leaving one hit out at a time
    (`averaging.deviations`); for hits of equal force that is ``s^2 = sum_m |X_m - H F_m|^2 / (M - 1)``, ``var H =
    s^2 / sum_m |F_m|^2``. What noise on the force takes from H1 (and noise of the response adds to H2), and what a
    response that has not decayed may be wrong by, are added in quadrature. With one hit neither the error nor the
    coherence ``|S_XF|^2/(S_XX S_FF)`` (1 by construction) says anything, and both are NaN.

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
        Force window: set the force to zero where the hammer is not in contact, which removes the bias that force
        noise brings.
    rules : HitRules, optional
        How hits are found.
    averaging : Averaging, optional
        Estimator and exponential window. Default: H1, no window.
    background : Background, optional
        What is removed of the motion between hits. Default: nothing.
    accelerometer_mass : float, optional
        Mass [kg] at the driving point that is there only to measure; taken off the compliance.

    Returns
    -------
    Identification
        Compliance [m/N] with ``compliance_std``, ``compliance_relation``, ``degrees_of_freedom`` (for
        `intervals.interval`), ``compliance_covariance``, ``deviation`` (see `errors.covariance`) and
        ``coherence(frequency, response, excitation)``, ``force_spectrum(frequency, excitation)`` [N s], the root mean
        square over the hits (for `hammer.level`); attributes ``usable_from_Hz`` and ``usable_to_Hz`` (one value
        an excitation), ``block_length_s`` and ``estimator``; tables "hits" and, where a background was removed,
        "background"; the hits one by one, unless a window was asked for.

    Raises
    ------
    InputError
        When there are no records, force or motion is missing, a record holds no hits (a sine, noise), no hit
        is left after exclusion, or no frequency is usable.
    """
    rules, averaging = rules or HitRules(), averaging or Averaging()
    check_records(name, records)
    unknown = set(exclude) - set(FAULTS)
    if unknown:
        raise InputError(f"exclude names {', '.join(sorted(unknown))}; it may name {' and '.join(FAULTS)}")
    columns = {axis: list(group) for axis, group in records.items() if len(group)}
    hits = [h for axis, group in columns.items() for i, r in enumerate(group) for h in find_hits(r, axis, i, rules)]
    duration = 1.0 / resolution if resolution is not None else longest_block(hits)
    duration = common_duration(duration, [sample_interval(r) for group in columns.values() for r in group])
    check_time_constant(averaging.exponential_window, duration)
    hits = [judge(hit, columns[hit.excitation][hit.record], duration, exclude, rules) for hit in hits]
    tables: dict[str, pd.DataFrame] = {}
    notes: list[str] = []
    tones: dict[str, list[Mapping[str, Tones]]] = {}
    if background is not None:
        columns, tones, tables["background"], notes = _without_background(columns, hits, background)
    plan = _Plan(duration, rules, gate_force, averaging, frequency_range)
    gathered = {
        a: _gather_column(columns[a], accepted(name, a, hits), plan, tones.get(a, ())) for a in AXES if a in columns
    }
    if "direction" in exclude:
        hits, gathered, undecided = _rightly_directed(hits, gathered)
        notes += undecided
    averages = [_average_column(column, plan) for column in gathered.values()]
    compliance, said = without_mass(_assemble(name, averages, plan), accelerometer_mass)
    notes += [note for column in averages for note in column.warnings]
    notes += [*_exclusion_notes(hits), *_cut_notes(averages, frequency_range), *said]
    tables = {"hits": hit_table(hits), **tables}
    single: dict[str, xr.Dataset] = {}
    if averaging.exponential_window is None:
        after = duration * (1.0 - rules.pre_trigger)
        for axis, c in gathered.items():
            single[axis] = single_hits(columns[axis], c.hits, c.frequency, c.motion, c.force, after)
    return Identification(name, "hammer", compliance, tables, tuple(notes), single)


@dataclass(frozen=True)
class _Plan:
    """What holds for all columns of a measurement."""

    duration: float
    rules: HitRules
    gate: bool
    averaging: Averaging
    wanted: tuple[float, float] | None


_NOTHING = 0.005  # share of the motion between the hits that is not worth a word


def _without_background(
    columns: Mapping[str, list[xr.Dataset]], hits: Sequence[Hit], background: Background
) -> tuple[dict[str, list[xr.Dataset]], dict[str, list[Mapping[str, Tones]]], pd.DataFrame, list[str]]:
    """Return the records without what moves between the hits, its tones, their table, and what there is to say."""
    cleaned: dict[str, list[xr.Dataset]] = {}
    tones: dict[str, list[Mapping[str, Tones]]] = {}
    tables, notes = [], []
    for axis, group in columns.items():
        cleaned[axis], tones[axis] = [], []
        for index, record in enumerate(group):
            here = [h for h in hits if h.excitation == axis and h.record == index]
            removed = remove_background(record, here, background)
            cleaned[axis].append(removed.record)
            tones[axis].append(removed.fitted)
            tables.append(removed.tones.assign(excitation=axis, file=here[0].source))
            if removed.tones.empty and max(removed.share.values()) < _NOTHING:
                continue
            shares = ", ".join(f"{100.0 * share:.0f} % in {a}" for a, share in removed.share.items())
            notes.append(
                f"excitation {axis}: {here[0].source}: motion between the hits was removed: {shares} of its power over "
                f"{removed.quiet:.3g} s, {len(removed.tones)} tones among it"
            )
    table = pd.concat(tables, ignore_index=True)
    return cleaned, tones, table[["excitation", "file", *(c for c in table if c not in ("excitation", "file"))]], notes


def _rightly_directed(
    hits: Sequence[Hit], gathered: Mapping[str, _Gathered]
) -> tuple[list[Hit], dict[str, _Gathered], list[str]]:
    """Leave out the hits that were made along another axis or from another side than the rest."""
    columns = {}
    for axis, column in gathered.items():
        inside = (column.frequency >= column.band[0]) & (column.frequency <= column.band[1])
        columns[axis] = HitSpectra(column.hits, column.frequency[inside], column.motion[inside], column.force[inside])
    faults, notes = wrong_directions(columns)
    reason = {id(gathered[axis].hits[m]): text for (axis, m), text in faults.items()}
    kept = {
        axis: column.only([m for m in range(len(column.hits)) if (axis, m) not in faults])
        for axis, column in gathered.items()
    }
    return [replace(hit, reason=reason.get(id(hit), hit.reason)) for hit in hits], kept, notes


# --- averaging ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Gathered:
    """Hits of one excitation with their spectra, shapes (f,), (f, 3, M), (f, M); NaN for a response not recorded.

    `tone_error` (f, 3, M, p) is the standard error [m s] of each parameter of the tones that were taken off.
    """

    hits: Sequence[Hit]
    records: Sequence[_Blocks]
    frequency: Real
    motion: Complex
    force: Complex
    noise: float
    band: tuple[float, float]
    channel: str
    tone_error: Complex

    def only(self, kept: Sequence[int]) -> _Gathered:
        """Return some of the hits."""
        if len(kept) == len(self.hits):
            return self
        hits = [self.hits[m] for m in kept]
        return replace(
            self,
            hits=hits,
            motion=self.motion[:, :, kept],
            force=self.force[:, kept],
            tone_error=self.tone_error[:, :, kept],
        )


def _gather_column(
    records: Sequence[xr.Dataset], hits: Sequence[Hit], plan: _Plan, tones: Sequence[Mapping[str, Tones]]
) -> _Gathered:
    """Transform the accepted hits of one excitation axis and find the band that their force carries."""
    axis = hits[0].excitation
    order = sorted({h.record for h in hits})
    gathered = [_gather(records[i], [h for h in hits if h.record == i], plan, tones[i] if tones else {}) for i in order]
    shared = min(blocks.frequency.size for blocks in gathered)
    frequency = gathered[0].frequency[:shared]
    for blocks in gathered[1:]:
        if not np.allclose(blocks.frequency[:shared], frequency, rtol=RULES.same_clock):
            raise InputError(
                f"the records of excitation {axis} are sampled at different rates, whose lines are not the same; "
                "resample them to one rate"
            )
    motion = np.concatenate([b.motion[:shared] for b in gathered], axis=2)
    force = np.concatenate([b.force[:shared] for b in gathered], axis=1)
    noise = float(np.mean([b.noise_energy for b in gathered]))
    low, high = usable_band(frequency, np.mean(np.abs(force) ** 2, axis=1), 0.0 if plan.gate else noise)
    channels = {motion_axes(records[i])[0] for i in order}
    channel = "acceleration" if "acceleration" in channels else "displacement"
    lines = 2.0 if channel == "acceleration" else 1.0
    band = (max(low, lines * float(frequency[0])), high)
    ordered = [h for i in order for h in hits if h.record == i]
    # The lines above the band, most of a record sampled fast, are not needed.
    top = max(high, plan.wanted[1] if plan.wanted else 0.0)
    kept = slice(0, int(np.searchsorted(frequency, top)) + 2 * RULES.reach + 2)
    tone_error = join_records([b.tone_error[:shared][kept] for b in gathered])
    return _Gathered(ordered, gathered, frequency[kept], motion[kept], force[kept], noise, band, channel, tone_error)


@dataclass(frozen=True)
class _Column:
    """Averaged result of one excitation; arrays of shape (f,), (f, 3) and (f, 3, M), NaN: response not recorded.

    ``force`` is the root mean square over the hits of the spectrum of their force [N s].
    """

    excitation: str
    frequency: Real
    block_length: float
    compliance: Complex
    deviation: Complex
    degrees_of_freedom: Real
    coherence: Real
    band: tuple[float, float]
    force: Real
    warnings: tuple[str, ...]


def _average_column(column: _Gathered, plan: _Plan) -> _Column:
    """Average the hits of one excitation axis."""
    axis, f, how = column.hits[0].excitation, column.frequency, plan.averaging
    ratio = _noise_ratio(column, plan) if how.estimator == "Hv" else None
    averaged = average(column.motion, column.force, how.estimator, ratio)
    compliance, left_out = averaged.compliance, averaged.left_out
    if how.exponential_window is not None:
        near = slice(0, int(np.searchsorted(f, column.band[1])) + RULES.reach + 1)
        for values in (compliance, left_out):
            values[near] = without_window(values[near], f[near], how.exponential_window)
    deviation = deviations(averaged, compliance, left_out)
    power = np.mean(np.abs(column.force) ** 2, axis=1)
    bias = np.zeros_like(averaged.coherence)
    if how.estimator == "H1" and not plan.gate:
        bias += (column.noise / power)[:, None]
    elif how.estimator == "H2":
        bias += np.nan_to_num(1.0 - averaged.coherence)  # (H2 - H1)/H2, if all that is incoherent is in the response
    common = common_tone_error(column.tone_error, column.force, averaged.leverage)
    systematic = np.concatenate([(bias * compliance)[..., None], _cut_off(column, compliance, plan), common], axis=2)
    unknown = np.isnan(deviation[..., :1])
    deviation = np.concatenate([deviation, np.where(unknown, np.nan, systematic)], axis=2)
    notes = [
        *_hit_count_note(axis, len(column.hits)),
        *_leakage_note(axis, column, plan),
        *_force_noise_note(axis, column, power, plan),
    ]
    return _Column(
        excitation=axis,
        frequency=f,
        block_length=1.0 / float(f[0]),
        compliance=compliance,
        deviation=deviation,
        degrees_of_freedom=degrees_of_freedom(averaged.leverage),
        coherence=averaged.coherence,
        band=column.band,
        force=power**0.5,
        warnings=tuple(notes),
    )


def _quarters(column: _Gathered) -> tuple[Complex, Complex]:
    """Return the velocity in the first and the last quarter of the blocks, shape (quarter lines, 3, hits).

    Velocity shows the resonances; displacement also shows the drift of the accelerometer.
    """
    f = column.records[0].quarter_frequency
    alike = [b for b in column.records if b.quarter_frequency.size == f.size]
    w = f[:, None, None]
    first, last = (
        np.concatenate([getattr(b, name) for b in alike], axis=2) for name in ("first_quarter", "last_quarter")
    )
    return w * first, w * last


def _cut_off(column: _Gathered, compliance: Complex, plan: _Plan) -> Complex:
    """Return what the end of the block may have cut off the compliance, in any phase, shape (f, 3, 2)."""
    first, last = _quarters(column)
    tau = plan.averaging.exponential_window
    share = np.zeros(compliance.shape)
    for row in range(len(AXES)):
        there = np.isfinite(first[0, row])
        if there.sum() > 1:
            left = leakage_by_line(first[:, row][:, there], last[:, row][:, there])
            share[:, row] = np.interp(column.frequency, column.records[0].quarter_frequency, left)
    share *= 1.0 if tau is None else float(np.exp(-plan.duration / tau))
    return np.asarray((share * compliance)[..., None] * np.array([1.0, 1.0j]) / np.sqrt(2.0))


def _noise_ratio(column: _Gathered, plan: _Plan) -> Real:
    """Return the ratio of the noise variances of displacement and force at each line [m2/N2], shape (f, 3)."""
    if plan.averaging.noise_ratio is None:
        return noise_ratio(column.motion, column.force, column.noise)
    w = 2.0 * np.pi * column.frequency
    own = plan.averaging.noise_ratio / (w**4 if column.channel == "acceleration" else 1.0)
    return np.broadcast_to(np.asarray(own * np.ones(w.size))[:, None], column.motion.shape[:2])


@dataclass(frozen=True)
class _Blocks:
    """Spectra of the blocks of one record, and what is needed to judge decay and force noise."""

    frequency: Real
    motion: Complex
    force: Complex
    quarter_frequency: Real
    first_quarter: Complex
    last_quarter: Complex
    noise_energy: float
    """Expected ``|F|^2`` of the force noise in one block [N^2 s^2]; zero for a force cut to exact zeros."""
    tone_error: Complex
    """Standard error of each parameter of the tones that were taken off [m s], shape (f, 3, hits, p)."""


def _gather(record: xr.Dataset, hits: Sequence[Hit], plan: _Plan, tones: Mapping[str, Tones]) -> _Blocks:
    axis, rules, tau = hits[0].excitation, plan.rules, plan.averaging.exponential_window
    dt = sample_interval(record)
    force = force_samples(record, axis)
    level, _, noise = quiet_state(force)
    if plan.gate:
        record = _gated(record, axis, level, rules)
    blocks = [block(hit, dt, plan.duration, rules) for hit in hits]
    length = blocks[0][1]
    taper = np.ones(length) if tau is None else exponential(length, int(rules.pre_trigger * length), dt, tau)
    # A window turns the mean of a block into something at every line; the usual value between hits is no mean of it.
    whole = record if tau is None else _centred(record)
    spectra = block_spectra(whole, [start for start, _ in blocks], length, taper, detrend=tau is None)
    motion = _all_axes(spectra.displacement, spectra.response)[1:]
    if tau is not None:
        motion = motion * laplace_factor(spectra.frequency[1:], tau, motion_axes(record)[0])[:, None, None]
    without = motion[..., None][..., :0]
    tone_error = tone_errors(record, [start for start, _ in blocks], taper, tones) if tau is None else without
    quarter = length // 4
    window = hann(quarter)
    # The first quarter begins with the pulse, so that "first" and "last" are the same stretch of every decay.
    early = block_spectra(record, [hit.onset for hit in hits], quarter, window)
    to_last = length - int(rules.pre_trigger * length) - quarter
    late = block_spectra(record, [hit.onset + to_last for hit in hits], quarter, window)
    return _Blocks(
        frequency=spectra.frequency[1:],  # an acceleration says nothing about 0 Hz, an offset says it wrongly
        motion=motion,
        force=spectra.force[1:, spectra.excitation.index(axis)],
        quarter_frequency=early.frequency[1:],
        first_quarter=_all_axes(early.displacement, early.response)[1:],
        last_quarter=_all_axes(late.displacement, late.response)[1:],
        noise_energy=noise**2 * dt**2 * float(taper @ taper),
        tone_error=tone_error,
    )


def _centred(record: xr.Dataset) -> xr.Dataset:
    """Return the record with the median of each channel taken off."""
    channels = [name for name in ("force", motion_axes(record)[0]) if name in record]
    return record.assign({name: record[name] - record[name].median("time") for name in channels})


def _all_axes(spectrum: Complex, axes: Sequence[str]) -> Complex:
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
    for a, b in zip(*runs(np.abs(pulse) > max(rules.trigger * pulse.max(), rules.noise * noise)), strict=True):
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


def _leakage_note(axis: str, column: _Gathered, plan: _Plan) -> Iterable[str]:
    """Say what the end of the block has cut off."""
    f, tau = column.records[0].quarter_frequency, plan.averaging.exponential_window
    low, high = plan.wanted or column.band
    # Below two lines of the quarter, the window mixes the line with the drift that -1/w^2 has raised.
    keep = (f >= max(column.band[0], low, 2.0 * f[0])) & (f <= min(column.band[1], high))
    if not keep.any():
        return
    first, last = (q[keep] for q in _quarters(column))
    worst, line = 0.0, 0
    for row in range(len(AXES)):
        there = np.isfinite(first[0, row])
        if there.any() and np.abs(first[:, row][:, there]).max() > 0.0:
            worst, line = max((worst, line), leakage(first[:, row][:, there], last[:, row][:, there]))
    # What is left at the end of the block, the window has lowered before it is cut off.
    worst *= 1.0 if tau is None else float(np.exp(-plan.duration / tau))
    if worst > 0.01:
        yield (
            f"excitation {axis}: at the end of the block of {1.0 / column.frequency[0]:.3g} s the response "
            f"has not decayed (or its sensor drifts), mostly at {f[keep][line]:.3g} Hz; estimated error of the "
            f"compliance there {100.0 * worst:.2g} % (leave more time between hits, or give an exponential_window)"
        )


def _within(band: tuple[float, float], wanted: tuple[float, float] | None) -> tuple[float, float]:
    """Return the part of the usable band that was asked for."""
    return band if wanted is None else (max(band[0], wanted[0]), min(band[1], wanted[1]))


def _force_noise_note(axis: str, column: _Gathered, power: Real, plan: _Plan) -> Iterable[str]:
    if any(b.noise_energy == 0.0 for b in column.records):
        yield (
            f"excitation {axis}: the force is exactly constant between hits (windowed before it was stored); "
            "its noise, and the bias that noise brings, cannot be estimated"
        )
    frequency, band = column.frequency, _within(column.band, plan.wanted)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    if plan.gate or plan.averaging.estimator != "H1" or not inside.any():
        return
    weakest = int(np.flatnonzero(inside)[np.argmin(power[inside])])
    bias = column.noise / float(power[weakest])
    if bias > 0.01:
        yield (
            f"excitation {axis}: force noise lowers the compliance by up to {100.0 * bias:.2g} % (at "
            f"{frequency[weakest]:.4g} Hz); hit harder, use a harder tip or a narrower frequency_range (a "
            "force_window removes most of it)"
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


def _assemble(name: str, columns: Sequence[_Column], plan: _Plan) -> xr.Dataset:
    """Put the columns side by side on one frequency axis."""
    frequency = _shared_axis(name, columns)
    low, high = plan.wanted or (max(c.band[0] for c in columns), min(c.band[1] for c in columns))
    lines = np.flatnonzero((frequency >= low * (1.0 - 1e-9)) & (frequency <= high * (1.0 + 1e-9)))
    f = frequency[lines]
    claims = [(f >= c.band[0] * (1.0 - 1e-9)) & (f <= c.band[1] * (1.0 + 1e-9)) for c in columns]
    if not any(claim.any() for claim in claims):
        bands = ", ".join(f"{c.excitation} {c.band[0]:.4g} to {c.band[1]:.4g} Hz" for c in columns)
        raise InputError(
            f"measurement '{name}': nothing can be claimed between {low:.4g} and {high:.4g} Hz (usable: {bands}); ask "
            "for another frequency range, record longer blocks, use a harder hammer tip, or set force_window = true "
            "(gate_force=True) where force noise limits the band"
        )
    recorded = [row for row in range(len(AXES)) if any(np.isfinite(c.compliance[0, row]) for c in columns)]

    def stack(attribute: str) -> Complex:
        parts = []
        for c, claimed in zip(columns, claims, strict=True):
            parts.append(np.where(claimed[:, None], getattr(c, attribute)[lines][:, recorded], np.nan))
        return np.stack(parts, axis=2)

    dims = ("frequency", "response", "excitation")
    extra = {
        **error_variables(_stacked_deviations(columns, claims, lines, recorded)),
        "degrees_of_freedom": (dims, stack("degrees_of_freedom")),
        "coherence": (dims, stack("coherence")),
        "force_spectrum": (
            ("frequency", "excitation"),
            np.stack(
                [np.where(claimed, c.force[lines], np.nan) for c, claimed in zip(columns, claims, strict=True)], 1
            ),
        ),
    }
    attrs = {
        "usable_from_Hz": [c.band[0] for c in columns],
        "usable_to_Hz": [c.band[1] for c in columns],
        "block_length_s": columns[0].block_length,
        "estimator": plan.averaging.estimator,
    }
    if plan.averaging.exponential_window is not None:
        attrs["exponential_window_s"] = plan.averaging.exponential_window
    responses, excitations = [AXES[row] for row in recorded], [c.excitation for c in columns]
    return make_compliance(f, stack("compliance"), responses, excitations, extra, attrs)


def _stacked_deviations(
    columns: Sequence[_Column], claims: Sequence[NDArray[np.bool_]], lines: NDArray[np.intp], recorded: list[int]
) -> Complex:
    """Return what each hit of each column adds to the error, shape (hits, f, responses, columns)."""
    sizes = [c.deviation.shape[2] for c in columns]
    out = np.zeros((sum(sizes), lines.size, len(recorded), len(columns)), dtype=complex)
    for j, (c, claimed) in enumerate(zip(columns, claims, strict=True)):
        own = np.moveaxis(c.deviation[lines][:, recorded], 2, 0)
        out[sum(sizes[:j]) : sum(sizes[: j + 1]), :, :, j] = own
        unknown = np.isnan(own).any(axis=0) | ~claimed[:, None]
        out[:, unknown, j] = np.nan
    return out


def _shared_axis(name: str, columns: Sequence[_Column]) -> Real:
    frequency = columns[0].frequency
    for column in columns[1:]:
        shared = min(frequency.size, column.frequency.size)
        if not np.allclose(column.frequency[:shared], frequency[:shared], rtol=RULES.same_clock):
            raise InputError(
                f"measurement '{name}': excitations {columns[0].excitation} and {column.excitation} have "
                "blocks of different length; resample the records to one rate or give a resolution"
            )
        frequency = frequency[:shared]
    return frequency
