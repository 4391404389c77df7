"""Drive loops: setpoint and actual value of an axis that is excited by its control -> frequency response of the loop.

    T_k = sum_p Y_pk conj(U_pk) / sum_p |U_pk|^2

over the whole periods p of a setpoint that repeats itself (`smfe.identification.spectra.periods`). U is the setpoint, Y
the actual value, both speeds or both positions, so that T is a number without unit: 1 where the axis follows. It is the
response of the *closed* loop to its setpoint. It is no compliance, and no compliance can be had from it: the force that
the loop answers is not in the record.

With several periods the standard deviation is that of what changes from period to period. From a single one (a control
averages its periods and keeps the mean) it is read from how rough T is from line to line, which takes a resonance
narrower than three lines for noise.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import ndimage

from process.errors import InputError
from process.labels import axis_present, label, sample_interval
from process.types import Complex, Real
from smfe.identification.drive.rules import RULES
from smfe.identification.spectra.periods import (
    Period,
    error,
    find_period,
    noise_power,
    periods_of,
    response,
    settled,
)

PAIRS = {"speed": ("reference_speed", "encoder_speed"), "position": ("reference_position", "encoder_position")}
"""Loop -> its setpoint and actual value. Positions are differenced, which removes the feed and cancels in T."""

_SINGLE = (
    "one period a record: the standard deviation is read from how rough the response is from line to line, and "
    "distortion that repeats with the setpoint cannot be separated from it",
)


@dataclass(frozen=True)
class LoopResponse:
    """Frequency response of a drive loop.

    Parameters
    ----------
    name : str
        Name of the measurement.
    response : xarray.Dataset
        ``loop_response(feed, frequency)`` [1], complex, with ``loop_response_std`` (root mean square of the complex
        error); ``feed`` is the mean speed of the setpoint [mm/min], its sign the direction. attrs: loop, axis.
    table : pandas.DataFrame
        One row a feed: period, lines, bandwidth, phase, peak, lag.
    notes : tuple of str
        Sentences for the report.
    """

    name: str
    response: xr.Dataset
    table: pd.DataFrame
    notes: tuple[str, ...] = field(default_factory=tuple)


def identify_loop(
    name: str,
    records: Sequence[xr.Dataset],
    *,
    period: float | None = None,
    settling: float | None = None,
    frequency_range: tuple[float, float] | None = None,
) -> LoopResponse:
    """Identify the response of a drive loop to its setpoint.

    Parameters
    ----------
    name : str
        Name of the measurement.
    records : sequence of xarray.Dataset
        Records with ``reference_speed`` and ``encoder_speed`` (or both positions) of one axis. Those of one mean speed
        are averaged, those of different ones are kept apart.
    period : float, optional
        Period of the setpoint [s]. None: it is found (`smfe.identification.spectra.periods.find_period`).
    settling : float, optional
        Dropped at the beginning of each record [s]. Default: the first period, where there are three or more.
    frequency_range : (float, float), optional
        Keep only these frequencies [Hz].

    Raises
    ------
    InputError
        Without records, setpoint or actual value, for a setpoint that does not repeat itself, and for records that have
        different lines.
    """
    if not records:
        raise InputError(f"measurement '{name}' has no records; a loop needs one with setpoint and actual value")
    loop, axis = _loop_of(records[0])
    runs = [_run(record, loop, axis, period, settling) for record in records]
    frequency = runs[0].frequency
    if any(r.frequency.size != frequency.size or not np.allclose(r.frequency, frequency) for r in runs):
        raise InputError(f"measurement '{name}': its records have different periods or sample rates; give each its own")
    groups = _by_feed(runs)
    low, high = frequency_range or (0.0, np.inf)
    lines = np.flatnonzero((frequency >= low) & (frequency <= high) & runs[0].excited())
    if lines.size < 8:
        raise InputError(f"measurement '{name}': the setpoint excites {lines.size} lines in the band; 8 are needed")
    found = {feed: _response(group, lines) for feed, group in groups.items()}
    data = {
        "loop_response": (("feed", "frequency"), np.stack([t for t, _ in found.values()])),
        "loop_response_std": (("feed", "frequency"), np.stack([s for _, s in found.values()])),
    }
    coords = {"feed": np.array(list(found)), "frequency": frequency[lines]}
    whole = label(xr.Dataset(data, coords=coords, attrs={"loop": loop, "axis": axis, "method": "loop"}))
    table = pd.DataFrame([_row(whole.sel(feed=feed), feed, group) for feed, group in groups.items()])
    single = all(sum(r.setpoint.shape[1] for r in runs) == 1 for runs in groups.values())
    whole.attrs["std_from"] = "neighbouring lines" if single else "periods"
    notes = [*(_SINGLE if single else ()), *_direction_notes(whole, table, single)]
    return LoopResponse(name, whole, table, tuple(notes))


@dataclass(frozen=True)
class _Run:
    """Spectra of the periods of a record, shapes (f,), (f, P), (f, P), without the mean."""

    frequency: Real
    setpoint: Complex
    actual: Complex
    feed: float
    period: Period
    dt: float

    def excited(self) -> NDArray[np.bool_]:
        power = np.mean(np.abs(self.setpoint) ** 2, axis=1)
        return np.asarray(power > RULES.weak_line * power.max())


def _loop_of(record: xr.Dataset) -> tuple[str, str]:
    """Return which loop a record is of, and of which axis."""
    for loop, (setpoint, actual) in PAIRS.items():
        axes = [a for a in axis_present(record, setpoint) if a in axis_present(record, actual)]
        if len(axes) > 1:
            raise InputError(
                f"setpoints of the axes {' and '.join(axes)} in one record; declare the one that is excited"
            )
        if axes:
            return loop, axes[0]
    known = " or ".join(f"{u}_x and {y}_x" for u, y in PAIRS.values())
    raise InputError(f"no setpoint with its actual value; declare the channels {known}")


def _run(record: xr.Dataset, loop: str, axis: str, period: float | None, settling: float | None) -> _Run:
    dt = sample_interval(record)
    setpoint, actual = PAIRS[loop]
    if axis not in axis_present(record, setpoint) or axis not in axis_present(record, actual):
        raise InputError(f"{record.attrs.get('source', 'a record')}: no {setpoint}_{axis} with {actual}_{axis}")
    u, y = (record[channel].sel(axis=axis).values for channel in (setpoint, actual))
    if loop == "position":
        u, y = np.diff(u) / dt, np.diff(y) / dt
    source = str(record.attrs.get("source", "the record"))
    found = find_period(u, dt, source) if period is None else Period(_whole(period, dt, u.size, source), "periodic")
    skip, count = settled(u.size, found.samples, dt, settling)
    if count < 1:
        raise InputError(f"{source}: {u.size * dt:.4g} s hold no period of {found.samples * dt:.4g} s after settling")
    part = slice(skip, skip + count * found.samples)
    setpoints, actuals = (periods_of(v[part], found.samples) for v in (u, y))
    frequency = np.arange(1, found.samples // 2 + 1) / (found.samples * dt)
    feed = float(f"{6e4 * float(np.mean(u[part])):.3g}")
    return _Run(frequency, setpoints, actuals, feed, found, dt)


def _whole(period: float, dt: float, size: int, source: str) -> int:
    samples = round(period / dt)
    if samples < 8 or samples > size or abs(period / dt - samples) * (size / samples) > 0.05:
        raise InputError(
            f"{source}: a period of {period:g} s is {period / dt:.6g} of the {size} samples; give the right period, a "
            "whole number of samples"
        )
    return samples


def _by_feed(runs: Sequence[_Run]) -> dict[float, list[_Run]]:
    """Return mean speed [mm/min] -> the runs with it, within 1 % of the fastest; rising."""
    limit = 0.01 * max(max(abs(r.feed) for r in runs), 1e-9)
    groups: dict[float, list[_Run]] = {}
    for run in sorted(runs, key=lambda r: r.feed):
        near = next((feed for feed in groups if abs(feed - run.feed) <= limit), run.feed)
        groups.setdefault(near, []).append(run)
    return groups


def _response(runs: Sequence[_Run], lines: NDArray[np.intp]) -> tuple[Complex, Real]:
    """Return T and its standard deviation at the lines."""
    u = np.concatenate([r.setpoint[lines] for r in runs], axis=1)
    y = np.concatenate([r.actual[lines] for r in runs], axis=1)
    found = response(y, u)
    if u.shape[1] > 1:
        return found, np.sqrt(noise_power(error(y, u, found)) / np.sum(np.abs(u) ** 2, axis=1))
    # Independent noise of variance s^2 has E |T_-1 - 2 T_0 + T_1|^2 = 6 s^2; the median of an exponential
    # distribution is ln 2 of its mean.
    bend = np.abs(np.diff(found, 2)) ** 2
    level = ndimage.median_filter(bend, min(RULES.loop_neighbours, bend.size), mode="nearest") / (6.0 * np.log(2.0))
    return found, np.sqrt(np.pad(level, 1, mode="edge"))


# --- what is said of it --------------------------------------------------------------------------------------------


def _row(one: xr.Dataset, feed: float, runs: Sequence[_Run]) -> dict[str, object]:
    """Return the row of one feed."""
    f, t = one["frequency"].values, one["loop_response"].values
    size, phase = np.abs(t), np.unwrap(np.angle(t))
    bandwidth = _falls_below(f, 20.0 * np.log10(size), 20.0 * np.log10(np.sqrt(0.5)))
    slow = f <= 0.25 * bandwidth if np.isfinite(bandwidth) else f <= f[min(5, f.size - 1)]
    slow[:2] = True
    shown = f <= RULES.compared_band * bandwidth if np.isfinite(bandwidth) else np.ones(f.size, bool)
    top = int(np.argmax(np.where(shown, size, 0.0)))
    first = runs[0]
    return {
        "loop": one.attrs["loop"],
        "axis": one.attrs["axis"],
        "feed_mm_min": feed,
        "setpoint": first.period.kind,
        "period_s": first.period.samples * first.dt,
        "periods": sum(r.setpoint.shape[1] for r in runs),
        "setpoint_rms_mm_min": 6e4 * _rms(first),
        "lines": f.size,
        "lowest_Hz": f[0],
        "gain_at_lowest": size[0],
        "bandwidth_Hz": bandwidth,
        "phase_minus_90_Hz": _falls_below(f, phase, -0.5 * np.pi),
        "peak_dB": 20.0 * np.log10(size[top]),
        "peak_Hz": f[top],
        **_resonance(f, size, ~shown),
        "lag_ms": -1e3 * float(np.sum(f[slow] * phase[slow]) / (2.0 * np.pi * np.sum(f[slow] ** 2))),
        "std_at_lowest": float(one["loop_response_std"].values[0]),
    }


def _resonance(f: Real, size: Real, beyond: NDArray[np.bool_]) -> dict[str, float]:
    """Return the line beyond the bandwidth that stands out most of its surroundings, where any does by 20 dB.

    Surroundings are the median of the gain over 101 lines. What a loop lets through so far up is a
    resonance, or the noise of one: its gain there says how much margin is left.
    """
    k = -1
    if beyond.sum() > RULES.surroundings:
        ratio = np.where(beyond, size / ndimage.median_filter(size, RULES.surroundings, mode="nearest"), 0.0)
        k = int(np.argmax(ratio))
        k = k if ratio[k] >= RULES.stands_out else -1
    return {
        "resonance_Hz": float(f[k]) if k >= 0 else float("nan"),
        "resonance_dB": 20.0 * float(np.log10(size[k])) if k >= 0 else float("nan"),
    }


def _rms(run: _Run) -> float:
    """Return the root mean square of the setpoint about its mean, by Parseval."""
    power = np.mean(np.abs(run.setpoint) ** 2, axis=1)
    weight = np.full(power.size, 2.0)
    if run.period.samples % 2 == 0:
        weight[-1] = 1.0
    return float(np.sqrt(np.sum(weight * power)) / run.period.samples)


def _falls_below(f: Real, values: Real, limit: float) -> float:
    """Return the first frequency [Hz] at which a curve falls below a limit, between two lines; NaN when it does not."""
    below = np.flatnonzero(values < limit)
    if not below.size or below[0] == 0:
        return float("nan")
    k = int(below[0])
    return float(np.interp(limit, values[[k, k - 1]], f[[k, k - 1]]))


def _direction_notes(whole: xr.Dataset, table: pd.DataFrame, single: bool) -> list[str]:
    """Say by how much opposite directions differ, and how much of it noise explains."""
    out = []
    for a, b in combinations([float(v) for v in whole["feed"].values], 2):
        if not a < 0.0 < b or abs(a + b) > 0.05 * b:
            continue
        end = RULES.compared_band * float(np.nanmean(table["bandwidth_Hz"]))
        band = whole.sel(frequency=whole["frequency"] <= end) if np.isfinite(end) else whole
        one, other = (band["loop_response"].sel(feed=feed).values for feed in (a, b))
        power = float(np.sum(np.abs(0.5 * (one + other)) ** 2))
        differs = float(np.sum(np.abs(one - other) ** 2)) / power
        std = float(np.sum(band["loop_response_std"].sel(feed=[a, b]).values ** 2)) / power
        out.append(
            f"{b:g} and {a:g} mm/min differ by {10.0 * np.log10(differs):.1f} dB of the response up to "
            f"{float(band['frequency'][-1]):.4g} Hz; {_judged(differs, std, single)}"
        )
    return out


def _judged(differs: float, std: float, single: bool) -> str:
    """Say what a difference of directions means; of single periods `std` is the roughness, which both may share."""
    if not single:
        verdict = "that is more: friction or play" if differs > 4.0 * std else "nothing distinguishes them"
        return f"noise alone makes {10.0 * np.log10(std):.1f} dB: {verdict}"
    text = "noise, and what friction and play do to one direction only, are at most that"
    if differs < 0.5 * std:
        text += (
            f". The roughness from line to line, {10.0 * np.log10(0.5 * std):.1f} dB, is the same in both: it is fine "
            "structure or odd distortion of this setpoint, and no noise"
        )
    return text


def _above(row: Mapping[Hashable, Any]) -> str:
    if not np.isfinite(row["resonance_Hz"]):
        return ""
    return f", and {row['resonance_dB']:.2g} dB far above it, at {row['resonance_Hz']:.4g} Hz"


def summary(found: LoopResponse) -> list[str]:
    """Return what was found as sentences."""
    out = []
    for row in found.table.to_dict("records"):
        out.append(
            f"{row['loop']} loop of {row['axis']} at {row['feed_mm_min']:g} mm/min: bandwidth "
            f"{row['bandwidth_Hz']:.4g} Hz (-3 dB), -90 deg at {row['phase_minus_90_Hz']:.4g} Hz, lag "
            f"{row['lag_ms']:.3g} ms, largest gain {row['peak_dB']:.2g} dB{_above(row)}; setpoint "
            f"{row['setpoint']}, period {row['period_s']:.6g} s"
        )
    return out
