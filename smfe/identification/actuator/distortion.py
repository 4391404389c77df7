"""Even and odd distortion of a machine under odd random-phase multisines, with its best linear approximation.

A linear machine answers a periodic force at its lines only. Of an odd random multisine (`process.simulation.excitation.
odd_random_harmonics`) some odd lines are left out: what the response holds there is odd distortion, at the even lines
even distortion, between the lines noise. Realisations with other phases give the scatter of the best linear
approximation itself (Pintelon and Schoukens 2012, 4.3). Over the bins between the lines the transient is a polynomial
(same, 7.3), so the periods need not have settled.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import label, sample_interval
from process.types import Complex, Real
from smfe.identification.actuator.rules import RULES
from smfe.identification.spectra.periods import periods_of
from smfe.identification.spectra.spectra import block_spectra, force_samples, motion_axes, record_source

Index = NDArray[np.int64]


@dataclass(frozen=True)
class Distortion:
    """What random-phase multisines show.

    Parameters
    ----------
    lines : xarray.Dataset
        Over ``frequency``, all harmonics up to the highest excited one. ``compliance`` (best linear approximation),
        ``compliance_std`` and ``compliance_noise_std`` of it [m/N] at the excited lines, NaN elsewhere;
        ``linear_response``, what the best linear approximation makes of the force of a line there (interpolated
        between the excited lines); ``noise`` of one realisation, ``even`` and ``odd`` distortion, NaN at the lines
        that do not show them: amplitudes [m], distortion after the power of the noise is taken off. ``role``:
        "excited", "even", "odd".
    realisations, periods : int
        How much was recorded.
    transient_db : float
        Power of the transient that was removed over that of the linear response [dB]; NaN for a single period.
    clock_ppm : float
        By how much the clock of the record is slower than that of the force [1e-6]; NaN for a single period.
    table : pandas.DataFrame
        For even, odd, noise: ``level_db``, power over that of the linear response at the same lines; ``floor_db``,
        below which noise (two standard deviations) and what the polynomial leaves of the transient hide it; ``lines``.
    warnings : tuple of str
        What makes the numbers uncertain.
    """

    lines: xr.Dataset
    realisations: int
    periods: int
    transient_db: float
    clock_ppm: float
    table: pd.DataFrame
    warnings: tuple[str, ...] = ()

    def level_db(self, kind: str) -> float:
        """Return the level of "even", "odd" or "noise" [dB] over the linear response, all lines together."""
        if kind not in self.table.index:
            raise InputError(f"no level of {kind!r}; there is {', '.join(map(str, self.table.index))}")
        return float(self.table["level_db"].to_numpy()[list(self.table.index).index(kind)])


@dataclass(frozen=True)
class _Lines:
    """Force and displacement at the harmonics without their transients; shapes (m, h), noise shared over (m, h)."""

    frequency: Real
    force: Complex
    response: Complex
    transient: Complex
    noise: Real
    noise_force: Real
    noise_cross: Complex
    leverage: Real
    left: Real
    degrees_of_freedom: int


def distortion(
    records: Sequence[xr.Dataset],
    fundamental: float,
    harmonics: Sequence[int],
    axis: str = "x",
    start: float = 0.0,
    periods: int | None = None,
) -> Distortion:
    """Return best linear approximation, noise, even and odd distortion of a response to multisines.

    Parameters
    ----------
    records : sequence of xarray.Dataset
        One a realisation (other phases, the same lines and level): ``force`` and a displacement or an acceleration
        along `axis`.
    fundamental : float
        Spacing f0 of the harmonics [Hz]; a period of 1/f0 must be a whole number of samples.
    harmonics : sequence of int
        Excited harmonics, e.g. ``Multisine.harmonics``.
    axis : {"x", "y", "z"}, optional
        Axis of force and response.
    start : float, optional
        Time in the records [s] from which the periods are taken.
    periods : int, optional
        How many of them; default all that each record holds, the same in all.

    Returns
    -------
    Distortion
        Levels line by line, and sentences on what makes them uncertain.

    Raises
    ------
    InputError
        Without a record, for a period that is not a whole number of samples or that no record holds, lines beyond the
        Nyquist frequency, or a force that is not periodic.
    """
    excited = np.asarray(harmonics)
    _check_lines(records, fundamental, excited)
    length, count = _periods(records, fundamental, start, periods)
    taken = [_cut(r, axis, start, length * count) for r in records]
    top = int(excited[-1])
    found = _stack([_lines_of(r, axis, count, top) for r in taken])
    share = _share_on_lines(taken, axis, count, excited)
    drift = _clock([force_samples(r, axis) for r in taken], length, count, excited)
    role = np.where(np.arange(1, top + 1) % 2 == 0, "even", "odd").astype(object)
    role[excited - 1] = "excited"
    powers = _powers(found, excited)
    lines = _as_dataset(found, powers, role, excited)
    table = _table(powers, role, found.force.shape[0], found.degrees_of_freedom)
    noise = float(np.sum(powers.noise) * count / np.sum(powers.linear))
    transient = _db(float(np.mean(np.abs(found.transient) ** 2)), float(np.mean(powers.linear)))
    warnings = _warnings(count, role, share, transient, drift, noise, fundamental * top)
    settled = transient if count > 1 else math.nan
    return Distortion(lines, len(taken), count, settled, 1e6 * drift[0], table, warnings)


# --- what is refused --------------------------------------------------------------------------------------------------


def _check_lines(records: Sequence[xr.Dataset], fundamental: float, excited: Index) -> None:
    if not records:
        raise InputError("no record of a multisine; give one a realisation")
    whole = excited.size and np.issubdtype(excited.dtype, np.integer)
    if not whole or excited[0] < 1 or np.any(np.diff(excited) < 1):
        raise InputError("the harmonics must be whole numbers from 1 up, rising, each once: those of the multisine")
    for number, record in enumerate(records):
        nyquist = 0.5 / sample_interval(record)
        if not 0.0 < fundamental * excited[-1] < nyquist:
            raise InputError(
                f"{record_source(record, number)}: the highest line of {fundamental * excited[-1]:g} Hz does not lie "
                f"below the Nyquist frequency of {nyquist:g} Hz; leave out the lines above it"
            )


def _periods(records: Sequence[xr.Dataset], fundamental: float, start: float, periods: int | None) -> tuple[int, int]:
    """Return samples a period and how many periods all records hold."""
    intervals = [sample_interval(r) for r in records]
    samples = 1.0 / (fundamental * intervals[0])
    if max(intervals) - min(intervals) > 1e-6 * intervals[0]:
        raise InputError("the records of the realisations are not sampled alike; resample them to one rate")
    held = [int((float(r["time"][-1]) - start) / dt + 1.5) for r, dt in zip(records, intervals, strict=True)]
    length = round(samples)
    count = max(min(held) // length, 0) if periods is None else periods
    if count < 1 or count * length > min(held) or start < max(float(r["time"][0]) for r in records) - intervals[0]:
        raise InputError(
            f"the records do not hold {max(count, 1)} periods of {1.0 / fundamental:g} s from {start:g} s on; give a "
            "start within them, fewer periods, or the right fundamental frequency"
        )
    if abs(samples - length) * count > 0.01:
        raise InputError(
            f"a period of {1.0 / fundamental:g} s is {samples:.6g} samples long; resample the records so that it is a "
            "whole number of samples, else its lines leak"
        )
    return length, count


def _cut(record: xr.Dataset, axis: str, start: float, samples: int) -> xr.Dataset:
    """Return the samples that are used, of the channels that are used."""
    force_samples(record, axis)
    channel, moving = motion_axes(record)
    if axis not in moving:
        raise InputError(f"the record moves along {', '.join(moving)} but not along {axis}; give the axis of the force")
    first = int(np.searchsorted(record["time"].values, start - 0.5 * sample_interval(record)))
    return record[["force", channel]].sel(axis=[axis]).isel(time=slice(first, first + samples))


# --- lines, noise and transients --------------------------------------------------------------------------------------


def _lines_of(record: xr.Dataset, axis: str, count: int, top: int) -> _Lines:
    n = record.sizes["time"]
    f0 = 1.0 / (n * sample_interval(record))
    spectra = block_spectra(record, [0], n, None, (f0, (top + RULES.transient_bins) * count * f0), detrend=True)
    scale = 2.0 * f0
    force, response = scale * spectra.force[:, 0, 0], scale * spectra.displacement[:, 0, 0]
    at = np.arange(1, top + 1) * count - 1
    shape = (1, top)
    if count == 1:
        nothing, unknown = np.zeros(shape, dtype=complex), np.full(shape, np.nan)
        single = (spectra.frequency[at], force[at][None], response[at][None])
        return _Lines(*single, nothing, unknown, unknown, unknown + 0.0j, np.zeros(shape), np.zeros(shape), 0)
    between = np.setdiff1d(np.arange(spectra.frequency.size), np.arange(count - 1, spectra.frequency.size, count))
    pieces = [_between(np.stack([force, response]), between, int(k)) for k in at]
    transient, scatter, leverage, left = (np.stack(part, axis=-1) for part in zip(*pieces, strict=True))
    return _Lines(
        spectra.frequency[at],
        (force[at] - transient[0])[None],
        (response[at] - transient[1])[None],
        transient[1][None],
        scatter[1, 1].real[None],
        scatter[0, 0].real[None],
        scatter[1, 0][None],
        leverage[None],
        left[None],
        RULES.transient_bins - RULES.transient_order - 1,
    )


@lru_cache(maxsize=1024)
def _polynomials(away: tuple[int, ...]) -> tuple[Real, Real, Real]:
    """Return the powers of the distances of bins, and what fits a polynomial to them and its value to two orders more.

    Nearly all lines have the same distances.
    """
    shift = np.array(away) / max(float(np.abs(away).max()), 1.0)
    terms = shift[:, None] ** np.arange(RULES.transient_order + 3)
    return (
        terms,
        np.asarray(np.linalg.pinv(terms[:, : RULES.transient_order + 1])),
        np.asarray(np.linalg.pinv(terms)[0]),
    )


def _between(values: Complex, between: Index, at: int) -> tuple[Complex, Complex, Real, Real]:
    """Return the transient of rows at a bin, the covariance of their noise, and what noise the transient brings.

    Last what the polynomial may leave of the transient of the response: squared difference to one of two orders more,
    less what noise makes of it.
    """
    middle = int(np.searchsorted(between, at))
    low = min(max(middle - RULES.transient_bins // 2, 0), between.size - RULES.transient_bins)
    used = between[low : low + RULES.transient_bins]
    terms, plain, finer = _polynomials(tuple(int(k) for k in used - at))
    fitted = values[:, used] @ plain.T
    rest = values[:, used] - fitted @ terms[:, : RULES.transient_order + 1].T
    scatter = rest @ rest.conj().T / (RULES.transient_bins - RULES.transient_order - 1)
    change = finer - plain[0]
    left = np.abs(values[1, used] @ change) ** 2 - scatter[1, 1].real * (change @ change)
    return fitted[:, 0], scatter, np.asarray(plain[0] @ plain[0]), np.asarray(left)


def _stack(found: Sequence[_Lines]) -> _Lines:
    names = ("force", "response", "transient", "noise", "noise_force", "noise_cross", "leverage", "left")
    joined = {name: np.concatenate([getattr(f, name) for f in found]) for name in names}
    return _Lines(found[0].frequency, **joined, degrees_of_freedom=found[0].degrees_of_freedom)


@dataclass(frozen=True)
class _Powers:
    """Squared amplitudes [m^2] at the harmonics, and the best linear approximation at the excited ones."""

    gain: Complex
    gain_noise: Real
    gain_total: Real
    linear: Real
    noise: Real
    spread: Real
    left: Real
    beside: Real


def _powers(found: _Lines, excited: Index) -> _Powers:
    """Return the powers; `beside`: what the response holds that the best linear approximation does not explain."""
    m, at = found.force.shape[0], excited - 1
    u, y = found.force[:, at], found.response[:, at]
    each = y / u
    gain = each.mean(axis=0)
    own = found.noise + 0.0
    seen = np.where(np.isfinite(own), own * (1.0 + found.leverage), 0.0)
    error = own[:, at] + np.abs(gain) ** 2 * found.noise_force[:, at]
    error -= 2.0 * np.real(found.noise_cross[:, at] * gain.conj())
    noise = np.mean(np.maximum(error, 0.0) * (1.0 + found.leverage[:, at]) / np.abs(u) ** 2, axis=0) / m
    harmonic = np.arange(1, found.frequency.size + 1)
    full = np.interp(harmonic, excited, gain.real) + 1j * np.interp(harmonic, excited, gain.imag)
    force = np.interp(harmonic, excited, np.mean(np.abs(u) ** 2, axis=0))
    beside = np.mean(np.abs(found.response - full * found.force) ** 2 - seen, axis=0)
    spread = np.sqrt(np.mean(seen**2, axis=0) / m)
    if m > 1:
        total = np.sum(np.abs(each - gain) ** 2, axis=0) / ((m - 1) * m)
    else:
        total = np.where(np.isfinite(noise), noise, 0.0) + _odd_at(beside, excited) / np.abs(u[0]) ** 2
    return _Powers(
        gain, noise, total, np.abs(full) ** 2 * force, np.mean(own, axis=0), spread, np.mean(found.left, axis=0), beside
    )


def _odd_at(beside: Real, excited: Index) -> Real:
    """Odd distortion of the lines left out, interpolated to the excited ones; NaN where none is left out."""
    odd = np.setdiff1d(np.arange(1, beside.size + 1, 2), excited)
    if not odd.size:
        return np.full(excited.size, np.nan)
    return np.asarray(np.interp(excited, odd, np.maximum(beside[odd - 1], 0.0)))


def _as_dataset(found: _Lines, p: _Powers, role: NDArray[np.object_], excited: Index) -> xr.Dataset:
    place = np.full(role.size, -1)
    place[excited - 1] = np.arange(excited.size)

    def at_excited(values: Real | Complex) -> Real | Complex:
        return np.where(place >= 0, values[place], np.nan)

    def amplitude(power: Real, kind: str) -> Real:
        return np.where(role == kind, np.sqrt(np.maximum(power, 0.0)), np.nan)

    over = ("frequency",)
    data = {
        "compliance": (over, at_excited(p.gain)),
        "compliance_std": (over, at_excited(np.sqrt(p.gain_total))),
        "compliance_noise_std": (over, at_excited(np.sqrt(p.gain_noise))),
        "linear_response": (over, np.sqrt(p.linear), {"units": "m"}),
        "noise": (over, np.sqrt(p.noise), {"units": "m"}),
        "even": (over, amplitude(p.beside, "even"), {"units": "m"}),
        "odd": (over, amplitude(p.beside, "odd"), {"units": "m"}),
        "role": (over, role.astype(str)),
    }
    out = label(xr.Dataset(data, coords={"frequency": found.frequency}))
    out["compliance_noise_std"].attrs["units"] = "m/N"
    return out


def _db(power: float, reference: float) -> float:
    return 10.0 * math.log10(power / reference) if power > 0.0 and reference > 0.0 else -math.inf


def _table(p: _Powers, role: NDArray[np.object_], realisations: int, degrees_of_freedom: int) -> pd.DataFrame:
    rows = {}
    for kind in ("even", "odd", "noise"):
        here = role == kind if kind != "noise" else np.ones(role.size, dtype=bool)
        linear, n = float(p.linear[here].sum()), int(here.sum())
        power = p.noise if kind == "noise" else p.beside
        level = _db(float(power[here].sum()), linear) if n and np.all(np.isfinite(power[here])) else math.nan
        # The noise itself is known from few bins: its own error counts too.
        known = 1.0 + 1.0 / degrees_of_freedom if degrees_of_freedom else math.nan
        sd = math.sqrt(float(np.sum(p.spread[here] ** 2)) * known)
        left = max(float(p.left[here].sum()), 0.0)
        floor = math.nan if kind == "noise" or not n or not degrees_of_freedom else _db(2.0 * sd + left, linear)
        rows[kind] = {"level_db": level, "floor_db": floor, "lines": n, "realisations": realisations}
    return pd.DataFrame.from_dict(rows, orient="index")


# --- what makes the numbers uncertain --------------------------------------------------------------------------------


def _share_on_lines(records: Sequence[xr.Dataset], axis: str, count: int, excited: Index) -> float:
    """Return the smallest share of the force's power up to the highest line that is at the excited lines."""
    shares = []
    for number, record in enumerate(records):
        power = np.abs(np.fft.rfft(force_samples(record, axis))[: int(excited[-1]) * count + 1]) ** 2
        whole = float(power[1:].sum())
        shares.append(float(power[excited * count].sum()) / whole if whole > 0.0 else 0.0)
        if shares[-1] < RULES.least_share:
            raise InputError(
                f"{record_source(record, number)}: only {100.0 * shares[-1]:.3g} % of the power of the force is at the "
                "lines of the multisine; check fundamental, harmonics, start, and that the force is periodic there"
            )
    return min(shares)


def _clock(forces: Sequence[Real], length: int, count: int, excited: Index) -> tuple[float, float]:
    """Return by how much of a period each period of the force comes late, and the standard deviation of that [1]."""
    if count == 1:
        return math.nan, math.nan
    turns, weights = [], []
    for force in forces:
        each = periods_of(force[: length * count], length)[excited - 1]
        step = np.sum(each[:, 1:] * each[:, :-1].conj(), axis=1)
        turns.append(-np.angle(step) / (2.0 * np.pi * excited))
        weights.append(np.abs(step) * excited.astype(float) ** 2)
    turn, weight = np.concatenate(turns), np.concatenate(weights)
    late = float(np.sum(weight * turn) / np.sum(weight))
    spread = float(np.sum(weight**2 * (turn - late) ** 2)) / float(np.sum(weight)) ** 2
    return late, math.sqrt(spread)


def _warnings(
    count: int,
    role: NDArray[np.object_],
    share: float,
    transient: float,
    drift: tuple[float, float],
    noise: float,
    highest: float,
) -> tuple[str, ...]:
    late, sd = drift
    phase = 2.0 * math.pi * late * int(role.size) * (count - 1)
    said = (
        (
            count == 1,
            "one period is too few: noise is not known, it counts as distortion, and transients stay in; record three "
            "or more",
        ),
        (
            count == 2,
            "two periods are few: one bin between two lines separates transient from noise; record three or more",
        ),
        (not np.any(role == "even"), "every even line is excited: even distortion cannot be seen; excite odd lines"),
        (not np.any(role == "odd"), "no odd line is left out: odd distortion cannot be seen; leave some out at random"),
        (
            share < RULES.clean_share,
            f"the force is not quite the multisine: {100.0 * (1.0 - share):.2g} % of its power up to {highest:g} Hz is "
            "beside its lines",
        ),
        (
            count > 1 and transient > 10.0 * math.log10(RULES.settled),
            f"the periods have not settled: a transient of {transient:.0f} dB of the response was removed; leave out "
            "the first periods if there are enough",
        ),
        (
            count > 1 and abs(late) > 5.0 * sd and abs(phase) > RULES.sharp,
            f"the clocks of force and record differ by {late * 1e6:.3g} ppm: the lines smear by {abs(phase):.2g} rad "
            f"at {highest:g} Hz over the record; lock the clocks or resample",
        ),
        (
            noise > RULES.repeats,
            f"the response does not repeat: {100.0 * noise:.2g} % of its power changes from period to period; it may "
            "not be at rest without the force (stick-slip, chatter), and then these numbers mean little",
        ),
    )
    return tuple(text for holds, text in said if holds)
