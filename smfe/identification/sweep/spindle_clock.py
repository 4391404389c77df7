"""Whether the clock of a cut agrees with its spindle: stated speed against the tooth passing in the forces.

A record holds the speed twice: in a channel (``spindle_speed``, ``spindle_angle``, ``tacho``) or in what was stated,
and in the passing of the teeth. Over the stated angle the forces have lines at ``k r``, k the orders of the spindle and
``r = f_found/f_stated``; r is 1 unless the time base or the channel is wrong. A comb finds r, the phase of its lines
from window to window refines it. A channel that comes late by d reads ``r = 1 + d W'/W`` while the speed W changes,
which is no error of a clock; r and d are fitted together.

Speeds that are stated of a ramp are those at which the cut begins and ends (`smfe.identification.sweep.ramp`).
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import xarray as xr

from process.errors import InputError
from process.instruments.tacho import tacho_angle
from process.labels import axis_present, sample_interval
from process.types import Complex, Real
from smfe.identification.spectra.spindle_angle import spindle_angle
from smfe.identification.sweep.comb import REACH, find_comb, force_over_angle, local_ratios, piece_in_cut, turns_of
from smfe.identification.sweep.estimators import SweepPass
from smfe.identification.sweep.ramp import Bounds, angle_of_ramp, stated_bounds

FEWEST_WINDOWS = 3
"""Windows that must fit into a cut."""

HARMONICS = 3
"""Harmonics of the tooth passing up to which orders are looked at."""

PHASE = 0.5
"""What the response of the machine may turn the phase of a tooth harmonic by along a sweep [rad]."""

NOTABLE = 5e-4
"""Relative difference that is said."""

REFUSED = 0.01
"""Relative difference from which nothing is identified: at a damping of 2 % it moves a peak by half of its width."""


@dataclass(frozen=True)
class SpeedComparison:
    """Stated speed against the passing of the teeth.

    Parameters
    ----------
    source : str
        What states the speed: "spindle_speed", "spindle_angle", "tacho" or "stated".
    difference : float
        Speed found in the forces over that stated, minus 1.
    std : float
        Of it.
    late : float
        Time by which the channel comes late [s].
    tooth_passing : (float, float)
        At begin and end of the cut, as stated [Hz].
    """

    source: str
    difference: float
    std: float
    late: float
    tooth_passing: tuple[float, float]

    @property
    def real(self) -> bool:
        """Whether it is more than what the forces tell by chance."""
        return abs(self.difference) > max(NOTABLE, 4.0 * self.std)

    def in_words(self) -> str:
        """Return what was found, with its numbers."""
        names = {"stated": "the stated spindle speeds", "spindle_speed": "the recorded spindle_speed"}
        low, high = self.tooth_passing
        return (
            f"the teeth pass at a frequency {100.0 * self.difference:+.3g} +- {200.0 * self.std:.1g} % from that of "
            f"{names.get(self.source, self.source)} ({low:.4g} to {high:.4g} Hz)"
        )


ADVICE = {
    "spindle_speed": "where the speed channel is right, the time base of the record is wrong: declare the true "
    "sample_rate of the channels; where the time base is right, take the channel out of [channels] or declare its "
    "scale",
    "stated": "where the stated speeds are right, the time base of the record is wrong: declare the true sample_rate "
    "of the channels; else correct spindle_speed",
    "spindle_angle": "angle and forces are of two clocks, or the scale of spindle_angle is wrong, or the number of "
    "teeth",
    "tacho": "tacho and forces are of two clocks, or pulses_per_revolution is wrong, or the number of teeth",
}


def compare_speeds(record: xr.Dataset, teeth: int | None) -> list[SpeedComparison]:
    """Compare every channel that states the speed of a cut with the passing of the teeth in its forces.

    Parameters
    ----------
    record : xarray.Dataset
        With force, and ``spindle_speed``, ``spindle_angle`` or ``tacho``.
    teeth : int or None
        Of the tool; None: the lines of any order are compared.

    Returns
    -------
    list of SpeedComparison
        Nothing of what the forces do not tell: cuts of too few turns, or without lines that stand out.
    """
    if "force" not in record or not axis_present(record, "force"):
        return []
    piece = piece_in_cut(record)
    if piece is None:
        return []
    every = (_compared(record, piece, angle[piece], teeth, source) for source, angle in _angles(record))
    return [found for found in every if found is not None]


def angle_in_step(record: xr.Dataset, teeth: int | None) -> Real | None:
    """Return the angle of the spindle [rad] in step with the teeth, shape (n,), or None where nothing tells it.

    Parameters
    ----------
    record : xarray.Dataset
        With force and what tells the angle of the spindle.
    teeth : int or None
        Of the tool; needed where only the forces tell the angle.
    """
    piece = piece_in_cut(record)
    with suppress(InputError):
        angle, source = spindle_angle(record, teeth)
        angle = np.unwrap(angle) if source == "spindle_angle" else angle
        found = None
        if piece is not None and source != "force":
            found = _compared(record, piece, angle[piece], teeth, source)
        if found is not None:
            return _earlier(record["time"].values, angle, found.late) * (1.0 + found.difference)
        return angle
    return None


@dataclass(frozen=True)
class Clock:
    """What the comparisons of all passes say together.

    Parameters
    ----------
    difference : float
        Tooth passing found over that of the speeds, minus 1; 0 where nothing speaks against the clock.
    warnings : tuple of str
        What was found.
    """

    difference: float
    warnings: tuple[str, ...]


def _earlier(time: Real, angle: Real, late: float) -> Real:
    """Return the angle at ``time + late``, which a late channel shows at `time`; a parabola where the record ends."""
    moved = np.asarray(np.interp(time + late, time, angle))
    for outside, near in (
        (time + late > time[-1], time > time[-1] - 1.0 - abs(late)),
        (time + late < time[0], time < time[0] + 1.0 + abs(late)),
    ):
        if outside.any():
            middle = float(time[near].mean())
            parabola = np.polyfit(time[near] - middle, angle[near], 2)
            moved[outside] = np.polyval(parabola, time[outside] + late - middle)
    return moved


def judge_clock(name: str, passes: Sequence[SweepPass], teeth: int | None) -> Clock:
    """Compare the speeds of all passes with the passing of the teeth.

    Angle and tacho are read by the clock of the record: they differ from the forces where they are of another clock,
    which says nothing of the time base. Stated speeds count where all passes are off to the same side.

    Parameters
    ----------
    name : str
        Of the measurement.
    passes : sequence of SweepPass
        Its passes.
    teeth : int or None
        Of the tool.

    Raises
    ------
    InputError
        Where speed and tooth passing are more than `REFUSED` apart.
    """
    seen: dict[str, list[tuple[str, SpeedComparison]]] = {}
    for p in passes:
        for found in compare_speeds(p.record, teeth):
            seen.setdefault(found.source, []).append((p.label, found))
    stated = _stated(passes, teeth)
    if stated is not None:
        seen["stated"] = [stated]
    largest, warnings = 0.0, []
    for source, every in seen.items():
        label, worst = max(every, key=lambda pair: abs(pair[1].difference) if pair[1].real else 0.0)
        if not (worst.real or source == "stated"):
            continue
        text = f"pass '{label}': {worst.in_words()}; {ADVICE[source]}"
        if source in ("spindle_speed", "stated"):
            if abs(worst.difference) > REFUSED:
                raise InputError(
                    f"sweep '{name}', {text}. A time base that is wrong by as much moves all resonances: nothing is "
                    "identified before the two agree"
                )
            largest = max(largest, worst.difference, key=abs)
            text += ". What this would change is in the standard deviation"
        warnings.append(text)
    return Clock(largest, tuple(warnings))


def changed_by_clock(compliance: Complex, frequency: Real, difference: float, acceleration: bool) -> Complex:
    """Return by how much a compliance changes where the time base is what is wrong, same shape.

    A record whose clock runs slow by ``1 + d`` shows frequencies ``f (1 + d)``, and accelerations that were integrated
    twice at the wrong frequency: ``Phi(f) = Phi_shown(f (1 + d)) (1 + d)^2``.

    Parameters
    ----------
    compliance : ndarray of complex, shape (f, ...)
        As shown.
    frequency : ndarray, shape (f,)
        [Hz].
    difference : float
        Tooth passing found over that of the speeds, minus 1.
    acceleration : bool
        Whether the motion was recorded as acceleration.
    """
    flat = compliance.reshape(frequency.size, -1)
    known = np.isfinite(flat).all(axis=1)
    if known.sum() < 2:
        return np.zeros_like(compliance)
    at = frequency * (1.0 + difference)
    moved = np.stack([np.interp(at, frequency[known], column[known]) for column in flat.T], axis=1)
    moved *= (1.0 + difference) ** 2 if acceleration else 1.0
    return np.asarray((moved - flat).reshape(compliance.shape))


def _stated(passes: Sequence[SweepPass], teeth: int | None) -> tuple[str, SpeedComparison] | None:
    """Return the pass whose cut is nearest to its stated speeds, where all passes are off to the same side."""
    seen: list[tuple[SweepPass, Bounds]] = []
    for p in passes:
        if p.speeds is not None:
            if _angles(p.record) or teeth is None:
                angle = angle_in_step(p.record, teeth)
            else:
                angle = angle_of_ramp(p.record, teeth, p.speeds)
            found = None if angle is None else stated_bounds(p.record, angle, p.speeds)
            if found is None:
                return None
            seen.append((p, found))
    if not seen:
        return None
    p, nearest = min(seen, key=lambda pair: abs(pair[1].beyond))
    if any(found.beyond * nearest.beyond <= 0.0 for _, found in seen):
        return None
    assert p.speeds is not None
    ends = (teeth or 1) * p.speeds[0] / (2.0 * np.pi), (teeth or 1) * p.speeds[1] / (2.0 * np.pi)
    return p.label, SpeedComparison("stated", nearest.middle, nearest.std, 0.0, ends)


def _angles(record: xr.Dataset) -> list[tuple[str, Real]]:
    """Return source and angle [rad] of all channels that state the speed."""
    out: list[tuple[str, Real]] = []
    if "spindle_speed" in record:
        out.append(("spindle_speed", spindle_angle(record[["spindle_speed"]])[0]))
    if "spindle_angle" in record:
        out.append(("spindle_angle", np.unwrap(record["spindle_angle"].values)))
    if "tacho" in record:
        pulses = float(record["tacho"].attrs.get("pulses_per_revolution", 1.0))
        with suppress(InputError):  # said where the tacho is used
            out.append(("tacho", tacho_angle(record["time"].values, record["tacho"].values, pulses)))
    return out


def _compared(record: xr.Dataset, piece: slice, angle: Real, teeth: int | None, source: str) -> SpeedComparison | None:
    dt = sample_interval(record)
    turned = (angle[-1] - angle[0]) / (2.0 * np.pi)
    turns = turns_of(teeth)
    if not turned >= turns * (1.0 + 0.25 * (FEWEST_WINDOWS - 1)) or not np.isfinite(turned):
        return None
    cells = 16 * (teeth or 6)
    force = force_over_angle(record, piece, angle, cells)
    force = force - force.mean(axis=1, keepdims=True)
    # Orders that the sampling rate holds at the highest speed.
    every = max(1, angle.size // 64)
    rate = np.diff(angle[::every]) / (2.0 * np.pi * dt * every)
    highest = int(min(HARMONICS * (teeth or 6), 0.4 / (dt * max(float(rate.max()), 1e-9) * (1.0 + REACH)), 0.4 * cells))
    if highest < (teeth or 1):
        return None
    coarse = find_comb(force, cells, turns, highest)
    if coarse is None:
        return None
    ratio, orders = coarse
    middle, local, weight = local_ratios(force, cells, turns, orders, ratio)
    when = np.interp(middle, (angle - angle[0]) / (2.0 * np.pi), np.arange(angle.size) * dt)
    speed = np.gradient(np.interp(np.arange(64) / 63.0 * dt * (angle.size - 1), dt * np.arange(angle.size), angle))
    slope = np.interp(when, np.linspace(0.0, dt * (angle.size - 1), 64), np.gradient(speed) / np.maximum(speed, 1e-12))
    slope = slope / (dt * (angle.size - 1) / 63.0)
    difference, std, late = _constant_and_delay(local - 1.0, weight, slope)
    lines = float(teeth or orders.min())
    floor = PHASE / (2.0 * np.pi * lines * turned)
    number = teeth or 1
    ends = number * float(rate[0]), number * float(rate[-1])
    return SpeedComparison(source, difference, float(np.hypot(std, floor)), late, ends)


def _constant_and_delay(difference: Real, weight: Real, slope: Real | None) -> tuple[float, float, float]:
    """Fit ``difference = c + d slope``, robust against windows that say little; return c, its deviation, and d."""
    terms = [np.ones(difference.size)]
    if slope is not None and difference.size >= 6 and np.ptp(slope) > 0.3 * np.abs(slope).max():
        terms.append(slope)
    a = np.stack(terms, axis=1)
    w = np.sqrt(weight / weight.max())
    trust = np.ones(difference.size)
    for _ in range(5):
        both = (w * trust)[:, None] * a
        found = np.linalg.lstsq(both, w * trust * difference, rcond=None)[0]
        left = difference - a @ found
        size = 1.4826 * float(np.median(np.abs(left))) + 1e-12
        trust = np.sqrt(np.minimum(1.0, 2.0 * size / np.maximum(np.abs(left), 1e-300)))
    both = (w * trust)[:, None] * a
    inverse = np.linalg.pinv(both.T @ both)
    # Windows overlap: four share one.
    freedom = max(difference.size / 4.0 - a.shape[1], 1.0)
    middle = both.T @ ((w * trust * left)[:, None] ** 2 * both)
    spread = inverse @ middle @ inverse * 4.0 * (difference.size / 4.0) / freedom
    late = float(found[1]) if a.shape[1] > 1 else 0.0
    return float(found[0]), float(np.sqrt(max(spread[0, 0], 0.0))), late
