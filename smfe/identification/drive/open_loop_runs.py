"""The open loop of a drive from records with a periodic force added to it: Section 5.1 of Franco et al. 2024.

Records hold the position of the carriage and the force that the control asks for, before its dead time, while the axis
moves at a constant feed under its servo, as in Figure 12: one record a direction. The period of the added force is
found in the record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from scipy import fft

from process.errors import InputError
from process.labels import AXES, axis_present, sample_interval
from process.types import Real
from smfe.identification.drive.motion import WAYS
from smfe.identification.drive.open_loop import ORDERS, PARAMETERS, OpenLoopFit, fit_open_loop, open_loop_response
from smfe.identification.drive.results import DriveParameter, Estimate
from smfe.identification.drive.rules import RULES

UNITS = dict(zip(PARAMETERS, ("kg", "kg", "N/m", "N s/m", "N s/m", "s"), strict=True))


@dataclass(frozen=True)
class OpenLoop:
    """What the records of one measurement say of the open loop of an axis.

    Attributes
    ----------
    name, axis : str
        Measurement and axis.
    response : mapping of str to xarray.Dataset
        Direction -> over ``frequency`` [Hz]: ``open_loop`` [m/N], carriage position over drive force; its
        ``open_loop_std``, the root mean square of the complex error; ``open_loop_fitted``, Eq. (2); ``coherence``.
        Attributes: axis, feed_mm_min, period_s, periods, anti_resonance_Hz, resonance_Hz.
    parameters : tuple of DriveParameter
        Masses, stiffness, damping, friction slope, dead time, anti-resonance and resonance of each direction.
    notes : tuple of str
        What was noticed.
    """

    name: str
    axis: str
    response: Mapping[str, xr.Dataset]
    parameters: tuple[DriveParameter, ...]
    notes: tuple[str, ...] = field(default_factory=tuple)


def identify_open_loop(
    name: str,
    records: Sequence[xr.Dataset],
    *,
    period: float | None = None,
    settling: float | None = None,
    frequency_range: tuple[float, float] | None = None,
    hold: float = 0.0,
) -> OpenLoop:
    """Identify the open loop of an axis and fit Eq. (2) to it.

    Parameters
    ----------
    name : str
        Of the measurement, for messages.
    records : sequence of xarray.Dataset
        With ``encoder_position`` and ``drive_force`` of one axis, at constant feed; one, or one a direction.
    period : float, optional
        Period of the added force [s]. None: it is found.
    settling : float, optional
        Dropped at the beginning [s], rounded up to whole periods; default: one period.
    frequency_range : (float, float), optional
        Lines that are fitted [Hz]; default: all up to a tenth of the sampling rate.
    hold : float, optional
        Time for which a value of the recorded force acts unchanged [s], as in `open_loop_response`.

    Raises
    ------
    InputError
        When channels are missing, no period is found, two records have one direction, the axis stops or turns round, or
        Eq. (2) is not what was measured.
    """
    axis = _axis_of(records)
    responses: dict[str, xr.Dataset] = {}
    rows: list[DriveParameter] = []
    notes: list[str] = []
    for record in records:
        place = record["encoder_position"].sel(axis=axis).values
        way = WAYS[int(place[-1] < place[0])]
        if place[-1] == place[0]:
            raise InputError(f"axis {axis} stands still; move it at a constant feed while it is excited")
        if way in responses:
            raise InputError(f"two records move {way}; give one a direction, and each feed a measurement of its own")
        found, fit, more = _one(record, axis, period, settling, frequency_range, hold)
        responses[way] = found
        rows += _rows(fit, found, way)
        notes += [f"{way}: {note}" for note in more]
    return OpenLoop(name, axis, responses, tuple(rows), tuple(notes))


def _axis_of(records: Sequence[xr.Dataset]) -> str:
    """Return the axis that all records have both channels of, and that moves furthest."""
    if not records:
        raise InputError("no records; the open loop needs one with drive force and encoder position")
    wanted = ("encoder_position", "drive_force")
    there = [a for a in AXES if all(n in r and a in axis_present(r, n) for r in records for n in wanted)]
    if not there:
        raise InputError("an open loop needs encoder_position and drive_force of one axis in every record")
    return max(there, key=lambda a: float(np.ptp(records[0]["encoder_position"].sel(axis=a).values)))


def _one(
    record: xr.Dataset,
    axis: str,
    period: float | None,
    settling: float | None,
    frequency_range: tuple[float, float] | None,
    hold: float,
) -> tuple[xr.Dataset, OpenLoopFit, list[str]]:
    """Return response and fit of one record, and what is to be said of it."""
    dt = sample_interval(record)
    period = period_of(record["drive_force"].sel(axis=axis).values, dt) * dt if period is None else period
    skip = 1 if settling is None else math.ceil(settling / period - 1e-9)
    band = frequency_range or (0.0, RULES.band_share / dt)
    measured = open_loop_response(record, axis, period, skip=skip, hold=hold, band=band)
    f, h, bend = (measured[name].values for name in ("frequency", "response", "bend"))
    notes = []
    std, fit = measured["noise_std"].values, None
    try:
        fit = fit_open_loop(f, h, std, bend=bend)
    except InputError:
        fit = None
    if fit is None or fit.misfit > RULES.distorted:
        std = measured["std"].values
        fit = fit_open_loop(f, h, std, bend=bend)
        notes.append(
            "something distorts the response beyond its noise, and beyond what a friction curve at this feed does: the "
            "intervals contain what shows of it between neighbouring lines"
        )
    data = {
        "open_loop": ("frequency", h, {"units": "m/N"}),
        "open_loop_std": ("frequency", std, {"units": "m/N"}),
        "open_loop_fitted": ("frequency", fit.drive.open_loop(f, fit.delay), {"units": "m/N"}),
        "coherence": ("frequency", measured["coherence"].values, {"units": "1"}),
    }
    attrs = {
        "axis": axis,
        "feed_mm_min": 6e4 * float(measured.attrs["feed"]),
        "vibration_mm_min": 6e4 * float(measured.attrs["velocity"]),
        "period_s": period,
        "periods": int(measured.attrs["periods"]),
        "anti_resonance_Hz": fit.drive.locked_frequency,
        "resonance_Hz": _resonance(fit),
        "misfit": fit.misfit,
    }
    coords = {"frequency": ("frequency", f, {"units": "Hz"})}
    return xr.Dataset(data, coords=coords, attrs=attrs), fit, notes


def period_of(force: Real, dt: float) -> int:
    """Return the period, in samples, of a drive force that holds a periodic part beside that of the servo.

    The changes of the force are compared with themselves later: they correlate at all multiples of the period, and
    hardly elsewhere, because a binary sequence or a multisine of random phases is white in its band. The last multiple
    says whether the period is a whole number of samples.

    Parameters
    ----------
    force : ndarray, shape (n,)
        Drive force.
    dt : float
        Sampling interval [s].

    Raises
    ------
    InputError
        When nothing repeats itself, or not after a whole number of samples.
    """
    nothing = (
        f"the drive force does not repeat itself within the {force.size * dt:.4g} s of the record: take two periods "
        "or more of a binary sequence or a multisine, from its beginning, or give the measurement its period"
    )
    # What the servo makes of the steps of the encoder changes from sample to sample, the added force more slowly.
    for width in RULES.widths:
        smooth = np.convolve(force, np.full(width, 1.0 / width), mode="valid")
        share = _correlation(smooth[width:] - smooth[:-width])
        # A slow force resembles itself a moment later: it must have changed before it can come back.
        away = np.flatnonzero(share < RULES.changed)
        if away.size and float(share[away[0] :].max()) >= RULES.repeats:
            return _first_multiple(share, int(away[0]))
    raise InputError(nothing)


def _correlation(u: Real) -> Real:
    """Return the correlation of a signal (n,) with itself, at lags up to two thirds of it, where both overlap."""
    u = u - u.mean()
    n = u.size
    power = float(u @ u)
    if n < 32 or not power > 0.0:
        return np.zeros(2)
    size = fft.next_fast_len(2 * n, real=True)
    correlation = fft.irfft(np.abs(fft.rfft(u, size)) ** 2, size)[: 2 * n // 3 + 1]
    energy = np.concatenate([[0.0], np.cumsum(u**2)])
    lags = np.arange(2 * n // 3 + 1)
    overlap = np.sqrt(energy[n - lags] * (energy[n] - energy[lags]))
    return np.asarray(correlation / np.maximum(overlap, 1e-12 * power))


def _first_multiple(share: Real, start: int) -> int:
    """Return the period from the correlation over the lag, beyond `start`."""
    peaks = start + np.flatnonzero(share[start:] > RULES.nearly * float(share[start:].max()))
    group = peaks[peaks < peaks[0] + max(2, peaks[0] // 20)]
    first = int(group[np.argmax(share[group])])
    multiples = int(share.size - 1) // first
    near = np.arange(max(multiples * first - multiples, 1), min(multiples * first + multiples + 1, share.size))
    last = int(near[np.argmax(share[near])])
    whole = round(last / multiples)
    if last != whole * multiples:
        raise InputError(
            f"the drive force repeats itself after {last / multiples:.6g} samples; a response without leakage needs a "
            "whole number: choose the clock of the excitation as a divisor of the sampling rate"
        )
    return whole


def _resonance(fit: OpenLoopFit) -> float:
    """Return the frequency at which carriage and tip vibrate against each other [Hz]."""
    return fit.drive.locked_frequency * math.sqrt(1.0 + fit.drive.tip_mass / fit.drive.moving_mass)


def _rows(fit: OpenLoopFit, found: xr.Dataset, way: str) -> list[DriveParameter]:
    """Return the rows of one direction."""
    free = 2.0 * found.sizes["frequency"] - len(PARAMETERS) - len(ORDERS)

    def row(name: str, value: float, std: float, unit: str, note: str = "") -> DriveParameter:
        return DriveParameter.of(name, way, Estimate.single(value, std, free), unit, note)

    feed, vibration = abs(found.attrs["feed_mm_min"]), found.attrs["vibration_mm_min"]
    notes = {
        "moving_mass": f"of the carriage; Eq. (2) of Franco et al. 2024 at {feed:.4g} mm/min",
        "sigma": f"slope of the friction force at {feed:.4g} mm/min, under a vibration of {vibration:.3g} mm/min (rms)",
        "delay": "from the recorded force to the one that acts",
    }
    values = {name: getattr(fit.drive, name) for name in PARAMETERS[:5]} | {"delay": fit.delay}
    rows = [row(n, float(v), fit.std[n], UNITS[n], notes.get(n, "")) for n, v in values.items()]
    mm, mt, k = fit.drive.moving_mass, fit.drive.tip_mass, fit.drive.stiffness
    # Relative derivatives of f_t = sqrt(k/m_t)/(2 pi) and f_r = f_t sqrt(1 + m_t/m_m) to m_m, m_t, k.
    share = mt / (mm + mt)
    slopes = {
        "anti_resonance": (0.0, -0.5 / mt, 0.5 / k),
        "resonance": (-0.5 * share / mm, 0.5 * (share - 1.0) / mt, 0.5 / k),
    }
    notes = {"anti_resonance": "of the tip on the carriage held fast", "resonance": "of the tip against the carriage"}
    for name, slope in slopes.items():
        value = float(found.attrs[f"{name}_Hz"])
        std = value * math.sqrt(max(float(np.array(slope) @ fit.covariance[:3, :3] @ np.array(slope)), 0.0))
        rows.append(row(name, value, std, "Hz", notes[name]))
    return rows
