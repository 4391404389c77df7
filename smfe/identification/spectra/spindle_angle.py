"""The angle of the spindle: measured, from tacho pulses, from its speed, or from the cutting force itself.

Only differences of the angle matter to what is built on it: a constant offset turns force and motion alike.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy import interpolate, ndimage, signal

from process.errors import InputError
from process.instruments.tacho import tacho_angle
from process.labels import axis_present, sample_interval
from process.types import Real
from smfe.identification.spectra.rules import RULES

SOURCES = ("spindle_angle", "tacho", "spindle_speed", "force")
"""Where an angle comes from, best first."""


def spindle_angle(record: xr.Dataset, teeth: int | None = None) -> tuple[Real, str]:
    """Return the angle [rad] of the spindle at each sample, and which of `SOURCES` it comes from.

    Parameters
    ----------
    record : xarray.Dataset
        With ``spindle_angle``, ``tacho``, ``spindle_speed``, or the forces of a cut.
    teeth : int, optional
        Needed where the angle is taken from the force.

    Raises
    ------
    InputError
        When no channel gives the angle, or the tacho has too few pulses.
    """
    if "spindle_angle" in record:
        return np.asarray(record["spindle_angle"].values, dtype=float), "spindle_angle"
    if "tacho" in record:
        pulses = float(record["tacho"].attrs.get("pulses_per_revolution", 1.0))
        return tacho_angle(record["time"].values, record["tacho"].values, pulses), "tacho"
    if "spindle_speed" in record:
        turns = record["spindle_speed"].values / 60.0 * sample_interval(record)
        return np.asarray(2.0 * np.pi * np.cumsum(turns)), "spindle_speed"
    if teeth is None or not axis_present(record, "force"):
        raise InputError(
            "the record holds no spindle angle; declare spindle_angle, tacho (with pulses_per_revolution) or "
            "spindle_speed in [channels]"
        )
    return force_angle(record, teeth), "force"


# --- from the force ---------------------------------------------------------------------------------------------------


def force_angle(record: xr.Dataset, teeth: int) -> Real:
    """Return the angle [rad] from the tooth passing that the forces show.

    A path of the tooth passing frequency through a spectrogram (the comb with most amplitude, dynamic programming)
    gives a first angle; the phase of the harmonics against it corrects it. The offset is arbitrary. Teeth of which one
    cuts most are one tooth to the force: where nothing is seen at the orders between those of the teeth, the period may
    be that of the whole tool, and the record is refused.

    Parameters
    ----------
    record : xarray.Dataset
        With force.
    teeth : int
        Of the tool.

    Raises
    ------
    InputError
        For forces that are too short, or that may repeat once a tooth or once a turn.
    """
    dt = sample_interval(record)
    keep = max(1, int(1.0 / (dt * 5.0 * RULES.tooth_harmonics * RULES.highest_tooth_passing)))
    force = record["force"].sel(axis=axis_present(record, "force")).values
    force = force - force.mean(axis=1, keepdims=True)
    if keep > 1:
        force = signal.decimate(force, keep, ftype="fir", axis=1, zero_phase=True)
    step = dt * keep
    if force.shape[1] * step < 3.0 * RULES.angle_window:
        raise InputError(f"{force.shape[1] * step:.3g} s of force are too short to find the tooth passing in; 3 s are")
    times, path = _comb_path(
        force, step, RULES.lowest_tooth_passing, min(RULES.highest_tooth_passing, 0.49 / (RULES.tooth_harmonics * step))
    )
    clock = np.arange(force.shape[1]) * step
    angle = _integral(np.interp(clock, times, path), step)
    for length in (0.5 * RULES.angle_window, RULES.angle_window):
        angle = _corrected(force, angle, step, length)
    if teeth > 1:
        _refuse_ambiguous(force, angle, step, teeth)
    fine = np.arange(record.sizes["time"]) * dt
    return np.asarray(interpolate.make_interp_spline(clock, angle, k=3)(np.minimum(fine, clock[-1])) / teeth)


def _refuse_ambiguous(force: Real, angle: Real, step: float, teeth: int) -> None:
    """Refuse forces whose period may be that of the tool: no run-out between strong harmonics of the found period."""
    rate = float(np.median(np.diff(angle))) / (2.0 * np.pi * step)
    size = min(round(RULES.turns * teeth / (rate * step)), force.shape[1] // 2) | 1
    window = signal.windows.hann(size) / (0.5 * size)

    def strength(order: float) -> float:
        turned = force * np.exp(-1j * order * angle)
        slow = signal.oaconvolve(turned, window[None, :], mode="valid", axes=1)[:, :: max(1, size // 4)]
        return float(np.sqrt(np.median(np.sum(np.abs(slow) ** 2, axis=0))))

    between = [k for k in range(1, 2 * teeth) if k % teeth]
    found = max(strength(k / teeth) for k in between)
    floor = float(np.median([strength((k + 0.5) / teeth) for k in between]))
    first, of_turn = strength(1.0), strength(float(teeth))
    if found < max(RULES.run_out_over_noise * floor, RULES.run_out * first) and of_turn > RULES.like_teeth * first:
        raise InputError(
            f"the forces repeat at about {rate:.3g} Hz and show no run-out: they do not decide whether one of {teeth} "
            "teeth passes then or the whole tool turns; declare spindle_angle, tacho or spindle_speed in [channels]"
        )


def _integral(frequency: Real, step: float) -> Real:
    return np.asarray(2.0 * np.pi * step * (np.cumsum(frequency) - 0.5 * (frequency + frequency[0])))


def _comb_path(force: Real, step: float, lowest: float, highest: float) -> tuple[Real, Real]:
    """Return times [s] and the tooth passing frequency [Hz] there; in the air it goes on straight."""
    length, hop = round(RULES.angle_window / step), round(0.25 * RULES.angle_window / step)
    padded = 4 * length
    frequency, times, spectrum = signal.spectrogram(
        force, 1.0 / step, "hann", length, length - hop, padded, detrend="constant", mode="magnitude"
    )
    level = np.sqrt(np.sum(spectrum**2, axis=0))
    grid = np.arange(lowest, highest, 0.5 * frequency[1])
    comb = sum(level[np.round(h * grid / frequency[1]).astype(int)] for h in range(1, RULES.tooth_harmonics + 1))
    score = np.asarray(comb)
    cells = round(2.0 * hop * step / (grid[1] - grid[0])) + 1
    path = grid[_best_path(score / score.max(), cells)]
    strength = score.max(axis=0)
    cutting = strength > 0.3 * np.quantile(strength, 0.75)
    straight = np.polyval(np.polyfit(times[cutting], path[cutting], 1), times)
    return times, np.where(cutting, path, straight)


def _best_path(score: Real, reach: int) -> NDArray[np.int64]:
    """Return the row of each column on the path of most score that moves at most `reach` rows a column."""
    total, back = score[:, 0].copy(), np.zeros(score.shape, dtype=np.int64)
    rows = np.arange(score.shape[0])
    for k in range(1, score.shape[1]):
        best = ndimage.maximum_filter1d(total, 2 * reach + 1, mode="constant", cval=-np.inf)
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(total, reach, constant_values=-np.inf), 2 * reach + 1)
        back[:, k] = np.clip(rows + windows.argmax(axis=1) - reach, 0, rows[-1])
        total = best + score[:, k]
    path = np.empty(score.shape[1], dtype=np.int64)
    path[-1] = int(total.argmax())
    for k in range(score.shape[1] - 1, 0, -1):
        path[k - 1] = back[path[k], k]
    return path


def _corrected(force: Real, angle: Real, step: float, length: float) -> Real:
    """Return the tooth angle corrected by the phase that the harmonics show against it."""
    size = round(length / step) | 1
    hop = max(1, size // 8)
    window = signal.windows.hann(size)
    drift, weight = 0.0, 1e-300
    for h in range(1, RULES.tooth_harmonics):
        turned = force * np.exp(-1j * h * angle)
        slow = signal.oaconvolve(turned, window[None, :], mode="same", axes=1)[:, ::hop]
        between = np.sum(slow[:, 1:] * slow[:, :-1].conj(), axis=0)
        # The error of a phase goes with the inverse amplitude, that of the angle with a further 1/h.
        drift = drift + h * np.abs(between) * np.angle(between)
        weight = weight + h**2 * np.abs(between)
    rate = np.asarray(drift / np.maximum(weight, 1e-3 * np.max(weight)))
    at = (np.arange(rate.size) + 1) * hop
    total = np.concatenate([[0.0], np.cumsum(rate)])
    return np.asarray(angle + np.interp(np.arange(angle.size), np.concatenate([[0], at]), total))
