"""Whether the clock of a cut agrees with its spindle: stated speed against the tooth passing in the forces.

A record holds the speed twice: in a channel (``spindle_speed``, ``spindle_angle``, ``tacho``) or in what was stated,
and in the passing of the teeth. Over the angle of the spindle all that repeats with it lies at whole orders k, however
the speed changes; over the stated angle the forces have lines at ``k r`` with ``r = f_found/f_stated``, and r is 1
unless the time base or the channel is wrong. A comb finds r, the phase of its lines from window to window refines it. A
channel that comes late by d reads ``r = 1 + d W'/W`` while the speed W changes, which is no error of a clock; r and d
are fitted together.

Speeds that are stated of a ramp are those at which the cut begins and ends, by a control with a clock of its own. The
record shows the speed of the spindle at any time, by its own clock, and the force bounds when the cut began: not before
the force rises from its level in the air, and not after it has reached half of its level in the cut. A record without
air begins after the cut. So each end bounds r; both must hold, but where they contradict each other the statement does
not belong to the ends of the cut, and r may be anything between.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.instruments.tacho import tacho_angle
from process.types import Complex, Real
from smfe.identification.spectra.spectra import hann
from smfe.identification.spectra.spindle_angle import force_angle, spindle_angle
from smfe.identification.sweep.passes import PreparedPass, force_level
from smfe.identification.sweep.rules import RULES


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
        """Whether the difference exceeds `SweepRules.notable_speed` and four standard deviations."""
        return abs(self.difference) > max(RULES.notable_speed, 4.0 * self.std)

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


def judge_clock(name: str, passes: Sequence[PreparedPass], teeth: int | None) -> Clock:
    """Compare the speeds of all passes with the passing of the teeth.

    Angle and tacho are read by the clock of the record: they differ from the forces where they are of another clock,
    which says nothing of the time base. Stated speeds count where all passes are off to the same side.

    Parameters
    ----------
    name : str
        Of the measurement.
    passes : sequence of PreparedPass
        Its passes.
    teeth : int or None
        Of the tool.

    Raises
    ------
    InputError
        Where speed and tooth passing are more than `SweepRules.refused_speed` apart.
    """
    seen: dict[str, list[tuple[str, SpeedComparison]]] = {}
    for p in passes:
        for found in compare_speeds(p, teeth):
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
            if abs(worst.difference) > RULES.refused_speed:
                raise InputError(
                    f"sweep '{name}', {text}. A time base that is wrong by as much moves all resonances: nothing is "
                    "identified before the two agree"
                )
            largest = max(largest, worst.difference, key=abs)
            text += ". What this would change is in the standard deviation"
        warnings.append(text)
    return Clock(largest, tuple(warnings))


def compare_speeds(sweep: PreparedPass, teeth: int | None) -> list[SpeedComparison]:
    """Compare every channel that states the speed of a cut with the passing of the teeth in its forces.

    Parameters
    ----------
    sweep : PreparedPass
        With force, and ``spindle_speed``, ``spindle_angle`` or ``tacho``.
    teeth : int or None
        Of the tool; None: the lines of any order are compared.

    Returns
    -------
    list of SpeedComparison
        Empty for cuts of too few turns, or without lines that stand out.
    """
    if "force" not in sweep.record or not sweep.force_axes or sweep.cut_piece is None:
        return []
    every = (_compared(sweep, angle, teeth, source) for source, angle in _angles(sweep.record))
    return [found for found in every if found is not None]


def angle_in_step(sweep: PreparedPass, teeth: int | None) -> Real | None:
    """Return the angle of the spindle [rad] in step with the teeth, shape (n,), or None where it cannot be found.

    Parameters
    ----------
    sweep : PreparedPass
        With force and the angle of the spindle.
    teeth : int or None
        Of the tool; needed where the angle is found from the forces.
    """
    with suppress(InputError):
        angle, source = spindle_angle(sweep.record, teeth)
        angle = np.unwrap(angle) if source == "spindle_angle" else angle
        found = None if source == "force" else _compared(sweep, angle, teeth, source)
        if found is not None:
            return _earlier(sweep.record["time"].values, angle, found.late) * (1.0 + found.difference)
        return angle
    return None


def changed_by_clock(compliance: Complex, frequency: Real, difference: float, acceleration: bool) -> Complex:
    """Return by how much a compliance changes where the time base is what is wrong, same shape.

    A record whose clock runs slow by ``1 + d`` has frequencies ``f (1 + d)``, and accelerations that were integrated
    twice at the wrong frequency: ``Phi(f) = Phi_recorded(f (1 + d)) (1 + d)^2``.

    Parameters
    ----------
    compliance : ndarray of complex, shape (f, ...)
        As recorded.
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


def _earlier(time: Real, angle: Real, late: float) -> Real:
    """Return the angle at ``time + late``, which a late channel states at `time`; a parabola where the record ends."""
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


def _compared(sweep: PreparedPass, angle: Real, teeth: int | None, source: str) -> SpeedComparison | None:
    """Return the comparison of one source, kept with the pass; None where the cut is too short or has no lines."""
    if sweep.cut_piece is None:
        return None
    if (source, teeth) not in sweep.compared:
        sweep.compared[source, teeth] = _compare(sweep, sweep.cut_piece, angle[sweep.cut_piece], teeth, source)
    found: SpeedComparison | None = sweep.compared[source, teeth]
    return found


def _compare(sweep: PreparedPass, piece: slice, angle: Real, teeth: int | None, source: str) -> SpeedComparison | None:
    dt = sweep.interval
    turned = (angle[-1] - angle[0]) / (2.0 * np.pi)
    turns = turns_of(teeth)
    if not turned >= turns * (1.0 + 0.25 * (RULES.fewest_windows - 1)) or not np.isfinite(turned):
        return None
    cells = 16 * (teeth or 6)
    force = force_over_angle(sweep, piece, angle, cells)
    force = force - force.mean(axis=1, keepdims=True)
    # Orders that the sampling rate holds at the highest speed.
    every = max(1, angle.size // 64)
    rate = np.diff(angle[::every]) / (2.0 * np.pi * dt * every)
    highest = int(
        min(
            RULES.clock_harmonics * (teeth or 6),
            0.4 / (dt * max(float(rate.max()), 1e-9) * (1.0 + RULES.ratio_reach)),
            0.4 * cells,
        )
    )
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
    floor = RULES.response_phase / (2.0 * np.pi * lines * turned)
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
    degrees_of_freedom = max(difference.size / 4.0 - a.shape[1], 1.0)
    middle = both.T @ ((w * trust * left)[:, None] ** 2 * both)
    spread = inverse @ middle @ inverse * 4.0 * (difference.size / 4.0) / degrees_of_freedom
    late = float(found[1]) if a.shape[1] > 1 else 0.0
    return float(found[0]), float(np.sqrt(max(spread[0, 0], 0.0))), late


# --- forces over the angle of the spindle, and the comb of lines at its orders ----------------------------------------


def turns_of(teeth: int | None) -> int:
    """Return the turns of a window: some `SweepRules.window_passages` of teeth, a multiple of four."""
    return 4 * max(2, round(0.25 * RULES.window_passages / (teeth or 6)))


def force_over_angle(sweep: PreparedPass, piece: slice, angle: Real, cells: int) -> Real:
    """Return the mean force in each of `cells` equal parts of every turn, shape (axes, cells of all turns).

    Parameters
    ----------
    sweep : PreparedPass
        With force.
    piece : slice
        Samples that are used.
    angle : ndarray, shape (n,)
        At these samples, rising [rad].
    cells : int
        Of a turn.
    """
    force = sweep.record["force"].sel(axis=sweep.force_axes).values[:, piece]
    rising = np.maximum.accumulate(angle + 1e-9 * np.arange(angle.size))
    turns = int((rising[-1] - rising[0]) / (2.0 * np.pi))
    edges = rising[0] + 2.0 * np.pi / cells * np.arange(turns * cells + 1)
    at = np.interp(edges, rising, np.arange(angle.size))
    total = np.concatenate([np.zeros((force.shape[0], 1)), np.cumsum(force, axis=1)], axis=1)
    sums = np.array([np.interp(at + 0.5, np.arange(angle.size + 1), row) for row in total])
    return np.asarray(np.diff(sums, axis=1) / np.maximum(np.diff(at), 1e-9))


def windows(force: Real, cells: int, turns: int, hop: int) -> Real:
    """Return windows of some turns, every so many turns, shape (axes, windows, cells of all turns)."""
    return np.lib.stride_tricks.sliding_window_view(force, turns * cells, axis=1)[:, :: hop * cells]


def find_comb(force: Real, cells: int, turns: int, highest: int) -> tuple[float, NDArray[np.int64]] | None:
    """Return the ratio whose comb stands out, and the orders that have lines; None where none does."""
    size, pad = turns * cells, 8
    pieces = windows(force, cells, turns, turns // 2)
    power = np.zeros(pad * size // 2 + 1)
    for row in pieces:
        power += np.sum(np.abs(np.fft.rfft(row * hann(size), pad * size, axis=1)) ** 2, axis=0)
    amplitude = np.sqrt(power)
    step = cells / (pad * size)
    reach = RULES.ratio_reach
    ratios = 1.0 + np.arange(-reach, reach, 0.5 * step / highest)
    each = [np.interp(k * ratios, step * np.arange(amplitude.size), amplitude) for k in range(1, highest + 1)]
    score = np.sum(each, axis=0)
    best = int(score.argmax())
    typical = float(np.median(score))
    # Beside strong lines the upper half holds their leakage.
    scatter = (typical - float(np.quantile(score, 0.1))) / 1.28
    clear = score[best] > RULES.comb_lifted * typical and score[best] - typical > RULES.comb_stands_out * min(
        scatter, 0.2 * typical
    )
    if not clear or best in (0, ratios.size - 1):
        return None
    heights = np.array([e[best] for e in each])
    floor = np.array([np.median(e) for e in each])
    above_noise = (heights > 2.0 * floor) & (heights > 0.1 * heights.max())
    if not above_noise.any():
        return None
    return float(ratios[best]), np.flatnonzero(above_noise) + 1


def local_ratios(
    force: Real, cells: int, turns: int, orders: NDArray[np.int64], ratio: float
) -> tuple[Real, Real, Real]:
    """Return middle [turns], ratio and weight between successive windows, from the phases of the orders."""
    hop = turns // 4
    pieces = windows(force, cells, turns, hop)
    shaped, place = pieces * hann(turns * cells), np.arange(turns * cells) / cells
    starts = hop * np.arange(pieces.shape[1])
    for limit in (float(orders.min()), float(orders.max())):
        # The lowest order first: its phase does not come round.
        used = orders[orders <= max(limit, float(orders.min()))]
        wave = np.exp(-2j * np.pi * ratio * np.outer(place, used))
        lines = shaped @ wave.real + 1j * (shaped @ wave.imag)  # real products: half the time of complex ones
        lines *= np.exp(-2j * np.pi * ratio * np.outer(starts, used))
        between = np.sum(lines[:, 1:] * lines[:, :-1].conj(), axis=0)
        drift = np.abs(between) * np.angle(between) @ used
        weight = np.maximum(np.abs(between) @ used**2, 1e-300)
        local = ratio + drift / weight / (2.0 * np.pi * hop)
        ratio = float(np.sum(weight * local) / np.sum(weight))
    return np.asarray(starts[:-1] + 0.5 * (turns + hop), dtype=float), np.asarray(local), np.asarray(weight)


# --- speeds stated of a ramp ------------------------------------------------------------------------------------------


def _stated(passes: Sequence[PreparedPass], teeth: int | None) -> tuple[str, SpeedComparison] | None:
    """Return the pass whose cut is nearest to its stated speeds, where all passes are off to the same side."""
    seen: list[tuple[PreparedPass, Bounds]] = []
    for p in passes:
        if p.speeds is not None:
            angle = angle_in_step(p, teeth) if teeth is None or _angles(p.record) else angle_of_ramp(p, teeth, p.speeds)
            found = None if angle is None else stated_bounds(p, angle, p.speeds)
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


@dataclass(frozen=True)
class Bounds:
    """Bounds of the speed found over that stated, minus 1; infinite where the record leaves a side open."""

    low: float
    high: float

    @property
    def beyond(self) -> float:
        """What no spindle that holds its speed explains; 0 where nothing is beyond."""
        return max(self.low - RULES.spindle_holds, 0.0) + min(self.high + RULES.spindle_holds, 0.0)

    @property
    def middle(self) -> float:
        """Middle of the bounds; the bound where one side is open."""
        finite = [v for v in (self.low, self.high) if math.isfinite(v)]
        return float(np.mean(finite)) if finite else 0.0

    @property
    def std(self) -> float:
        """Standard deviation of anything between the bounds."""
        wide = self.high - self.low
        return float(np.hypot(wide / math.sqrt(12.0) if math.isfinite(wide) else 0.0, 0.25 * RULES.spindle_holds))


def stated_bounds(sweep: PreparedPass, angle: Real, stated: tuple[float, float]) -> Bounds | None:
    """Return the bounds that the ends of the cut set, or None where the forces have no cut.

    Parameters
    ----------
    sweep : PreparedPass
        With force.
    angle : ndarray, shape (n,)
        Of the spindle, in step with the teeth [rad].
    stated : (float, float)
        Spindle rotation where the cut begins and ends [rad/s].
    """
    level, dt = force_level(sweep.record), sweep.interval
    in_work, quiet = float(np.median(level[sweep.cutting])), float(level.min())
    if not in_work > 0.0 or not np.isfinite(angle).all():
        return None
    begin = _rise(level, quiet, in_work)
    back = _rise(level[::-1], quiet, in_work)
    last = level.size - 1
    ends = []
    for (earliest, latest), speed, sign in ((begin, stated[0], 1), (back, stated[1], -1)):
        at = np.linspace(latest if earliest is None else earliest, latest, 7)
        seen = [_speed(angle, round(v) if sign > 0 else last - round(v), dt) / speed - 1.0 for v in at]
        low, high = min(seen), max(seen)
        # What lies outside the record is on the far side of what it holds of the ramp.
        if earliest is None and sign * (stated[1] - stated[0]) > 0.0:
            low = -math.inf
        elif earliest is None:
            high = math.inf
        ends.append((low, high))
    (a, b), (c, d) = ends
    if max(a, c) <= min(b, d):
        return Bounds(max(a, c), min(b, d))
    return Bounds(min(a, c), max(b, d))


def angle_of_ramp(sweep: PreparedPass, teeth: int, stated: tuple[float, float]) -> Real | None:
    """Return the angle of the spindle [rad] of a ramp from the forces alone, or None where they do not allow it.

    Which harmonic the path through the forces follows is taken from the stated speeds.

    Parameters
    ----------
    sweep : PreparedPass
        With force.
    teeth : int
        Of the tool.
    stated : (float, float)
        Spindle rotation where the cut begins and ends [rad/s].
    """
    piece, dt = sweep.cut_piece, sweep.interval
    with suppress(InputError):
        path = force_angle(sweep.record, teeth)
        margin = round(1.0 / dt)
        if piece is None or piece.stop - piece.start < 4 * margin:
            return None
        inner = slice(piece.start + margin, piece.stop - margin)
        middle = 0.5 * (inner.start + inner.stop)
        reach = 0.5 * (inner.stop - inner.start)
        place = (np.arange(path.size) - middle) / reach
        smooth = np.polyfit(place[inner], path[inner], 3)
        if teeth * np.std(path[inner] - np.polyval(smooth, place[inner])) > RULES.path_scatter:
            return None
        ratio = float(smooth[2]) / (reach * dt) / (0.5 * (stated[0] + stated[1]))
        factor = min(RULES.other_harmonics, key=lambda q: abs(math.log(max(q * ratio, 1e-9))))
        return (
            np.asarray(factor * np.polyval(smooth, place)) if abs(factor * ratio - 1.0) < RULES.speed_by_force else None
        )
    return None


def _rise(level: Real, quiet: float, in_work: float) -> tuple[int | None, int]:
    """Return the earliest and the latest sample at which the cut may begin; no earliest where the record has no air."""
    latest = int(np.argmax(level > RULES.surely_in_cut * in_work))
    below = np.flatnonzero(level[:latest] <= max(1.3 * quiet, quiet + RULES.above_air * (in_work - quiet)))
    if not below.size or not quiet < RULES.surely_in_cut * in_work:
        return None, latest
    # A rise begins in the noise: as long again before it is seen.
    first = int(below[-1]) + 1
    return max(2 * first - latest, 0), latest


def _speed(angle: Real, at: int, dt: float) -> float:
    """Return the rotation [rad/s] at a sample."""
    mean = (angle[-1] - angle[0]) / (dt * (angle.size - 1))
    half = round(0.5 * max(RULES.slope_seconds, 2.0 * math.pi * RULES.slope_turns / max(mean, 1e-9)) / dt)
    piece = slice(max(at - half, 0), min(at + half + 1, angle.size))
    time = dt * (np.arange(piece.start, piece.stop) - at)
    return float(np.polyfit(time, angle[piece], 2)[1])
