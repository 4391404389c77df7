"""Whether the clock of a cut agrees with its spindle: stated speed against the tooth passing in the forces.

A record holds the speed twice: in a channel (``spindle_speed``, ``spindle_angle``, ``tacho``) or in what was stated,
and in the passing of the teeth. Over the stated angle the forces have lines at ``k r``, k the orders of the spindle and
``r = f_found/f_stated``; r is 1 unless the time base or the channel is wrong. A comb finds r, the phase of its lines
from window to window refines it. A channel that comes late by d reads ``r = 1 + d W'/W`` while the speed W changes,
which is no error of a clock; r and d are fitted together.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import axis_present, sample_interval
from process.tacho import tacho_angle
from smfe.force_noise import in_cut
from smfe.spectra import hann
from smfe.spindle_angle import spindle_angle
from smfe.sweep_estimators import SweepPass

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

REACH = 0.08
"""Ratios that are looked for lie within 1 and this [1]."""

PASSAGES = 80
"""Tooth passages of a window over the angle."""

FEWEST_WINDOWS = 3
"""Windows that must fit into a cut."""

HARMONICS = 3
"""Harmonics of the tooth passing up to which orders are looked at."""

STANDS_OUT = 6.0
"""The comb stands above the median of all ratios by so many times what their lower half scatters by."""

LIFTED = 1.3
"""And it is so many times the median [1]."""

PHASE = 0.5
"""What the response of the machine may turn the phase of a tooth harmonic by along a sweep [rad]."""

STATED = 2e-3
"""How well the stated speeds of a ramp are those of the cut, as a standard deviation [1]."""

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


def compare_speeds(
    record: xr.Dataset, teeth: int | None, stated: tuple[float, float] | None = None
) -> list[SpeedComparison]:
    """Compare everything that states the speed of a cut with the passing of the teeth in its forces.

    Parameters
    ----------
    record : xarray.Dataset
        With force, and ``spindle_speed``, ``spindle_angle`` or ``tacho``.
    teeth : int or None
        Of the tool; None: the lines of any order are compared.
    stated : (float, float), optional
        Spindle rotation at begin and end of the cut [rad/s], a ramp linear in time.

    Returns
    -------
    list of SpeedComparison
        Nothing of what the forces do not tell: cuts of too few turns, or without lines that stand out.
    """
    if "force" not in record or not axis_present(record, "force"):
        return []
    cutting = np.flatnonzero(in_cut(record))
    if cutting.size < 32:
        return []
    piece = slice(int(cutting[0]), int(cutting[-1]) + 1)
    out = []
    for source, angle in _angles(record, piece, stated):
        found = _compared(record, piece, angle, teeth, source)
        if found is not None:
            out.append(found)
    return out


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


def judge_clock(name: str, passes: Sequence[SweepPass], teeth: int | None) -> Clock:
    """Compare the speeds of all passes with the passing of the teeth.

    Angle and tacho are read by the clock of the record: they differ from the forces where they are of another clock,
    which says nothing of the time base. Stated speeds count where all passes agree.

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
        for found in compare_speeds(p.record, teeth, p.speeds):
            seen.setdefault(found.source, []).append((p.label, found))
    largest, warnings = 0.0, []
    for source, every in seen.items():
        label, worst = max(every, key=lambda pair: abs(pair[1].difference) if pair[1].real else 0.0)
        if source == "stated":
            label, worst = min(every, key=lambda pair: abs(pair[1].difference))
            if any(v.difference * worst.difference <= 0.0 for _, v in every):
                continue
        if not worst.real:
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


def _angles(record: xr.Dataset, piece: slice, stated: tuple[float, float] | None) -> list[tuple[str, Real]]:
    """Return source and angle [rad] within the cut of all that states the speed."""
    out: list[tuple[str, Real]] = []
    if "spindle_speed" in record:
        out.append(("spindle_speed", spindle_angle(record[["spindle_speed"]])[0][piece]))
    if "spindle_angle" in record:
        out.append(("spindle_angle", np.unwrap(record["spindle_angle"].values)[piece]))
    if "tacho" in record:
        pulses = float(record["tacho"].attrs.get("pulses_per_revolution", 1.0))
        with suppress(InputError):  # said where the tacho is used
            out.append(("tacho", tacho_angle(record["time"].values, record["tacho"].values, pulses)[piece]))
    if stated is not None:
        rate = np.linspace(stated[0], stated[1], piece.stop - piece.start)
        out.append(("stated", np.cumsum(rate) * sample_interval(record)))
    return out


def turns_of(teeth: int | None) -> int:
    """Return the turns of a window: some `PASSAGES` of teeth, a multiple of four."""
    return 4 * max(2, round(0.25 * PASSAGES / (teeth or 6)))


def over_angle(force: Real, angle: Real, cells: int) -> Real:
    """Return the mean force in each of `cells` equal parts of every turn, shape (axes, cells of all turns).

    Parameters
    ----------
    force : ndarray, shape (axes, n)
        At equal times.
    angle : ndarray, shape (n,)
        Rising [rad].
    cells : int
        Of a turn.
    """
    rising = np.maximum.accumulate(angle + 1e-9 * np.arange(angle.size))
    turns = int((rising[-1] - rising[0]) / (2.0 * np.pi))
    edges = rising[0] + 2.0 * np.pi / cells * np.arange(turns * cells + 1)
    at = np.interp(edges, rising, np.arange(angle.size))
    total = np.concatenate([np.zeros((force.shape[0], 1)), np.cumsum(force, axis=1)], axis=1)
    sums = np.array([np.interp(at + 0.5, np.arange(angle.size + 1), row) for row in total])
    return np.asarray(np.diff(sums, axis=1) / np.maximum(np.diff(at), 1e-9))


def _compared(record: xr.Dataset, piece: slice, angle: Real, teeth: int | None, source: str) -> SpeedComparison | None:
    dt = sample_interval(record)
    turned = (angle[-1] - angle[0]) / (2.0 * np.pi)
    turns = turns_of(teeth)
    if not turned >= turns * (1.0 + 0.25 * (FEWEST_WINDOWS - 1)) or not np.isfinite(turned):
        return None
    cells = 16 * (teeth or 6)
    axes = axis_present(record, "force")
    force = over_angle(record["force"].sel(axis=axes).values[:, piece], angle, cells)
    force = force - force.mean(axis=1, keepdims=True)
    # Orders that the sampling rate holds at the highest speed.
    every = max(1, angle.size // 64)
    rate = np.diff(angle[::every]) / (2.0 * np.pi * dt * every)
    highest = int(min(HARMONICS * (teeth or 6), 0.4 / (dt * max(float(rate.max()), 1e-9) * (1.0 + REACH)), 0.4 * cells))
    if highest < (teeth or 1):
        return None
    coarse = _comb(force, cells, turns, highest)
    if coarse is None:
        return None
    ratio, orders = coarse
    middle, local, weight = _local_ratios(force, cells, turns, orders, ratio)
    when = np.interp(middle, (angle - angle[0]) / (2.0 * np.pi), np.arange(angle.size) * dt)
    speed = np.gradient(np.interp(np.arange(64) / 63.0 * dt * (angle.size - 1), dt * np.arange(angle.size), angle))
    slope = np.interp(when, np.linspace(0.0, dt * (angle.size - 1), 64), np.gradient(speed) / np.maximum(speed, 1e-12))
    slope = slope / (dt * (angle.size - 1) / 63.0)
    difference, std, late = _constant_and_delay(local - 1.0, weight, slope)
    if source == "stated":
        difference, late = _at_both_ends(when, local, weight, angle, dt), 0.0
        std = float(np.hypot(std, STATED))
    lines = float(teeth or orders.min())
    floor = PHASE / (2.0 * np.pi * lines * turned)
    number = teeth or 1
    ends = number * float(rate[0]), number * float(rate[-1])
    return SpeedComparison(source, difference, float(np.hypot(std, floor)), late, ends)


def _windows(force: Real, cells: int, turns: int, hop: int) -> Real:
    """Return windows of some turns, shape (axes, windows, cells of all turns)."""
    return np.lib.stride_tricks.sliding_window_view(force, turns * cells, axis=1)[:, :: hop * cells]


def _comb(force: Real, cells: int, turns: int, highest: int) -> tuple[float, NDArray[np.int64]] | None:
    """Return the ratio whose comb stands out, and the orders that have lines; None where none does."""
    size, pad = turns * cells, 8
    windows = _windows(force, cells, turns, turns // 2)
    power = np.zeros(pad * size // 2 + 1)
    for row in windows:
        power += np.sum(np.abs(np.fft.rfft(row * hann(size), pad * size, axis=1)) ** 2, axis=0)
    amplitude = np.sqrt(power)
    step = cells / (pad * size)
    reach = REACH
    ratios = 1.0 + np.arange(-reach, reach, 0.5 * step / highest)
    each = [np.interp(k * ratios, step * np.arange(amplitude.size), amplitude) for k in range(1, highest + 1)]
    score = np.sum(each, axis=0)
    best = int(score.argmax())
    typical = float(np.median(score))
    # Beside strong lines the upper half holds their leakage.
    scatter = (typical - float(np.quantile(score, 0.1))) / 1.28
    clear = score[best] > LIFTED * typical and score[best] - typical > STANDS_OUT * min(scatter, 0.2 * typical)
    if not clear or best in (0, ratios.size - 1):
        return None
    heights = np.array([e[best] for e in each])
    floor = np.array([np.median(e) for e in each])
    loud = (heights > 2.0 * floor) & (heights > 0.1 * heights.max())
    if not loud.any():
        return None
    return float(ratios[best]), np.flatnonzero(loud) + 1


def _local_ratios(
    force: Real, cells: int, turns: int, orders: NDArray[np.int64], ratio: float
) -> tuple[Real, Real, Real]:
    """Return middle [turns], ratio and weight between successive windows, from the phases of the orders."""
    hop = turns // 4
    windows = _windows(force, cells, turns, hop)
    shape, place = hann(turns * cells), np.arange(turns * cells) / cells
    starts = hop * np.arange(windows.shape[1])
    for limit in (float(orders.min()), float(orders.max())):
        # The lowest order first: its phase does not come round.
        used = orders[orders <= max(limit, float(orders.min()))]
        drift, weight = np.zeros(starts.size - 1), np.full(starts.size - 1, 1e-300)
        for k in used:
            line = (windows * shape) @ np.exp(-2j * np.pi * k * ratio * place)
            line = line * np.exp(-2j * np.pi * k * ratio * starts)
            between = np.sum(line[:, 1:] * line[:, :-1].conj(), axis=0)
            drift += k * np.abs(between) * np.angle(between)
            weight += k**2 * np.abs(between)
        local = ratio + drift / weight / (2.0 * np.pi * hop)
        ratio = float(np.sum(weight * local) / np.sum(weight))
    return np.asarray(starts[:-1] + 0.5 * (turns + hop), dtype=float), np.asarray(local), np.asarray(weight)


def _at_both_ends(when: Real, local: Real, weight: Real, angle: Real, dt: float) -> float:
    """Return the smaller of the differences at begin and end of a cut; 0 where their signs differ.

    When the stated speeds were passed is not known: a ramp that begins before the cut, or ends behind it, is above the
    stated speed at one end and below at the other. A wrong time base is wrong alike.
    """
    whole = dt * (angle.size - 1)
    stated = (angle[1] - angle[0]) / dt, (angle[-1] - angle[-2]) / dt
    speed = local * (stated[0] + (stated[1] - stated[0]) * when / whole)
    slope, first = np.polyfit(when, speed, 1, w=np.sqrt(weight / weight.max()))
    ends = first / stated[0] - 1.0, (first + slope * whole) / stated[1] - 1.0
    return float(np.sign(ends[0]) * min(abs(e) for e in ends)) if ends[0] * ends[1] > 0.0 else 0.0


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
