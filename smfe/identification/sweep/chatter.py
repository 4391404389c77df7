"""Passes of a sweep that chatter: noticed, said, and left out.

The chip regenerates: beyond the limit the forces grow at a frequency that is no multiple of that of the spindle. Over
the angle of the spindle all that repeats with it, run-out included, lies at whole orders, however the speed changes;
what lies between them, above the noise of the sensor, is chatter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from process.errors import InputError
from smfe.identification.spectra.spectra import hann
from smfe.identification.sweep.passes import PreparedPass, SweepPass, prepare
from smfe.identification.sweep.rules import RULES
from smfe.identification.sweep.spindle_clock import angle_in_step, force_over_angle, turns_of, windows


@dataclass(frozen=True)
class Chatter:
    """A part of a pass that chatters.

    Parameters
    ----------
    interval : (float, float)
        Of the record [s].
    speed : (float, float)
        Spindle speed at its ends [rpm].
    share : float
        Largest rms of the forces between whole orders over that at them.
    frequency : float
        Of the highest line between them, where the share is largest [Hz].
    """

    interval: tuple[float, float]
    speed: tuple[float, float]
    share: float
    frequency: float

    def in_words(self) -> str:
        """Return what was found, with its numbers."""
        return (
            f"it chatters from {self.interval[0]:.3g} to {self.interval[1]:.3g} s ({self.speed[0]:.4g} to "
            f"{self.speed[1]:.4g} rpm): forces between the orders of the spindle are {100.0 * self.share:.0f} % of "
            f"those at them, most near {self.frequency:.4g} Hz"
        )


def chatter_of(sweep: PreparedPass, teeth: int | None) -> list[Chatter]:
    """Return the parts of a pass that chatter.

    Parameters
    ----------
    sweep : PreparedPass
        With force and the angle of the spindle.
    teeth : int or None
        Of the tool.

    Returns
    -------
    list of Chatter
        Empty where the record has no angle, or is shorter than a window.
    """
    piece, angle = sweep.cut_piece, angle_in_step(sweep, teeth)
    if angle is None or piece is None:
        return []
    angle, dt = angle[piece], sweep.interval
    cells, turns = 8 * (teeth or 6), turns_of(teeth)
    force, hop = force_over_angle(sweep, piece, angle, cells), max(1, turns // 4)
    if force.shape[1] < (turns + RULES.chatter_windows * hop) * cells:
        return []
    lines = windows(force, cells, turns, hop)
    spectra = np.fft.rfft((lines - lines.mean(axis=2, keepdims=True)) * hann(turns * cells), axis=2)
    power = np.sum(np.abs(spectra) ** 2, axis=0)
    line = np.arange(power.shape[1])
    away = np.minimum(line % turns, turns - line % turns)
    begin, end = hop * np.arange(power.shape[0]), hop * np.arange(power.shape[0]) + turns
    turn = (angle - angle[0]) / (2.0 * np.pi)
    start, stop = (np.interp(at, turn, np.arange(angle.size)) for at in (begin, end))
    rate = turns / (dt * np.maximum(stop - start, 1.0))
    highest = min(3.2 * (teeth or 6), 0.4 / (dt * float(rate.max())))
    # Drift and the ends of the cut lie below.
    used = (line > 0.4 * (teeth or 2) * turns) & (line <= highest * turns)
    between, whole = power[:, used & (away > 2)], power[:, used & (away <= 2)].sum(axis=1)
    floor = np.median(between, axis=1) / np.log(2.0)
    beyond = np.maximum(between.sum(axis=1) - floor * between.shape[1], 0.0)
    share = np.sqrt(beyond / np.maximum(whole, 1e-300))
    at = line[used & (away > 2)][between.argmax(axis=1)] / turns * rate
    found = (share > RULES.chatter_share) & (between.max(axis=1) > RULES.chatter_line * np.median(between, axis=1))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], found.astype(int), [0]])))
    out = []
    time = sweep.record["time"].values[piece]
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        if b - a < RULES.chatter_windows:
            continue
        most = a + int(share[a:b].argmax())
        ends = float(time[int(start[a])]), float(time[min(int(stop[b - 1]), time.size - 1)])
        speeds = 60.0 * float(rate[a]), 60.0 * float(rate[b - 1])
        out.append(Chatter(ends, speeds, float(share[most]), float(at[most])))
    return out


def without_chatter(
    name: str, passes: Sequence[PreparedPass], teeth: int | None, needed: int
) -> tuple[list[PreparedPass], tuple[str, ...]]:
    """Return the passes, or what is left of them, without chatter, and what was left out.

    Of a pass that chatters the longest part in the cut that does not is kept, where it lasts
    `SweepRules.shortest_rest`.

    Parameters
    ----------
    name : str
        Of the measurement.
    passes : sequence of PreparedPass
        Its passes.
    teeth : int or None
        Of the tool.
    needed : int
        Passes that must be left.

    Raises
    ------
    InputError
        Where fewer are.
    """
    kept, notes = [], []
    for p in passes:
        found = chatter_of(p, teeth)
        if not found:
            kept.append(p)
            continue
        rest = _longest_rest(p, found)
        what = f"pass '{p.label}': " + "; ".join(f.in_words() for f in found)
        if rest is None:
            notes.append(f"{what}. It is left out: cut less deep, or at other speeds")
            continue
        time = p.record["time"].values
        ends = float(time[rest.start]), float(time[min(rest.stop, time.size) - 1])
        notes.append(f"{what}. Only {ends[0]:.3g} to {ends[1]:.3g} s are used: cut less deep, or at other speeds")
        kept.append(prepare(SweepPass(p.record.isel(time=rest), p.label, p.arc, p.speeds)))
    if len(kept) < needed:
        raise InputError(f"sweep '{name}': too few passes are left without chatter. " + ". ".join(notes))
    return kept, tuple(notes)


def _longest_rest(sweep: PreparedPass, chatter: Sequence[Chatter]) -> slice | None:
    """Return the samples of the longest part without chatter, with the air on its side."""
    time, cutting = sweep.record["time"].values, np.flatnonzero(sweep.cutting)
    edges = [float(time[cutting[0]])]
    for c in chatter:
        edges += list(c.interval)
    edges.append(float(time[cutting[-1]]))
    free = list(zip(edges[::2], edges[1::2], strict=True))
    longest = max(range(len(free)), key=lambda i: free[i][1] - free[i][0])
    if free[longest][1] - free[longest][0] < RULES.shortest_rest:
        return None
    first = 0 if longest == 0 else int(np.searchsorted(time, free[longest][0]))
    last = time.size if longest == len(free) - 1 else int(np.searchsorted(time, free[longest][1]))
    return slice(first, last)
