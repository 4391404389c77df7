"""Modes of a machine over its campaigns, and of a fleet over its machines: which peaks are the same mode.

The rule: peaks of the same entry of the compliance (xx, yy, ...) are followed from measurement to measurement, in the
order of their dates. Each measurement is matched one to one to the modes that are known so far, each at the frequency
it had last: the assignment with the least sum of relative differences, no pair further apart than 10 %
(`smfe.comparison.peaks.matched`). A peak without partner begins a mode. A mode counts where at least half of the
measurements of that entry have it. Machines of a fleet are matched in the same way, in the order of their names, by the
mean frequencies of their modes: each machine to the means over those before it, no further apart than 20 %.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import pandas as pd
from scipy import stats

from process.types import Real
from smfe.comparison.peaks import TOLERANCE, matched

SHARE = 0.5
"""Share of the measurements that have a mode."""

APART = 0.2
"""Largest relative difference of frequency at which modes of two machines can be the same."""

YEAR = 365.25
"""Days."""

QUANTITIES = ("frequency", "damping", "amplitude")
"""What is followed of a mode."""

_COLUMN = {"frequency": "frequency_Hz", "damping": "damping", "amplitude": "amplitude_um_per_N"}
_ERROR = {"frequency": "frequency_std_Hz", "damping": "damping_std", "amplitude": "amplitude_std_um_per_N"}

_CONFIDENCE = 0.95


@dataclass(frozen=True)
class Mode:
    """One mode of one machine in one entry of its compliance.

    Parameters
    ----------
    machine, entry : str
        "Mill 01", "xx".
    number : int
        From 1 at the lowest mean frequency.
    rows : pandas.DataFrame
        Its peaks, one a measurement, by date.
    """

    machine: str
    entry: str
    number: int
    rows: pd.DataFrame

    def values(self, quantity: str) -> Real:
        """Return frequency [Hz], damping or amplitude [um/N] of each measurement."""
        return self.rows[_COLUMN[quantity]].to_numpy(float)

    def errors(self, quantity: str) -> Real:
        """Return their standard deviations."""
        return self.rows[_ERROR[quantity]].to_numpy(float)

    @property
    def years(self) -> Real:
        """Years since the first dated measurement; NaN where the date is not known."""
        days = pd.to_datetime(self.rows["date"])
        return np.asarray((days - days.min()).dt.days / YEAR, float)


P = TypeVar("P")


def follow(
    steps: Sequence[Sequence[P]],
    frequency: Callable[[P], float],
    middle: Callable[[Sequence[float]], float],
    tolerance: float,
) -> list[dict[int, P]]:
    """Return modes as step -> peak, by the rule of this module, of those that at least half of the steps have.

    `middle` says where a mode is by its frequencies so far [Hz].
    """
    found: list[dict[int, P]] = []
    for number, peaks in enumerate(steps):
        at = [middle([frequency(p) for p in mode.values()]) for mode in found]
        pairs = matched(at, [frequency(p) for p in peaks], tolerance) if at and peaks else []
        for known, new in pairs:
            found[known][number] = peaks[new]
        taken = {new for _, new in pairs}
        found += [{number: peak} for i, peak in enumerate(peaks) if i not in taken]
    return [mode for mode in found if len(mode) >= SHARE * len(steps)]


def modes_of(rows: pd.DataFrame) -> list[Mode]:
    """Return the modes of every machine from rows of a catalogue; direct entries (xx, yy, zz) alone.

    Parameters
    ----------
    rows : pandas.DataFrame
        Of the kind "peak", or with others, which are passed over.
    """
    peaks = rows[(rows["kind"] == "peak") & (rows["response"] == rows["excitation"])]
    peaks = peaks.sort_values(["machine", "response", "date", "campaign", "measurement", "peak"], na_position="last")
    out = []
    for keys, own in peaks.groupby(["machine", "response"], sort=True):
        machine, axis = (str(key) for key in keys)
        steps = [list(part.index) for _, part in own.groupby(["campaign", "measurement"], sort=False)]
        frequencies: dict[Hashable, float] = own["frequency_Hz"].to_dict()
        found = [own.loc[list(mode.values())] for mode in follow(steps, frequencies.__getitem__, _last, TOLERANCE)]
        found.sort(key=lambda frame: float(frame["frequency_Hz"].mean()))
        out += [Mode(machine, 2 * axis, number, frame) for number, frame in enumerate(found, 1)]
    return out


def drift_table(modes: Sequence[Mode]) -> pd.DataFrame:
    """Return how each mode of each machine drifts: percent a year of frequency, damping and amplitude.

    A straight line is fitted to the logarithm over time (least squares, each measurement the same); the interval is
    that of its slope (95 %, Student's t, the scatter about the line for its error). Modes with fewer than three dates
    have no row.
    """
    out = []
    for mode in modes:
        years = mode.years
        known = np.isfinite(years)
        if np.unique(years[known]).size < 3:
            continue
        for quantity in QUANTITIES:
            line = stats.linregress(years[known], np.log(mode.values(quantity)[known]))
            half = float(stats.t.ppf(0.5 * (1.0 + _CONFIDENCE), known.sum() - 2)) * float(line.stderr)
            slope = float(line.slope)
            out.append(
                {
                    "machine": mode.machine,
                    "entry": mode.entry,
                    "mode": mode.number,
                    "quantity": quantity,
                    "measurements": int(known.sum()),
                    "years": float(np.nanmax(years)),
                    "percent_per_year": 100.0 * slope,
                    "low": 100.0 * (slope - half),
                    "high": 100.0 * (slope + half),
                }
            )
    columns = ["machine", "entry", "mode", "quantity", "measurements", "years", "percent_per_year", "low", "high"]
    return pd.DataFrame(out, columns=columns)


def fleet_table(modes: Sequence[Mode]) -> pd.DataFrame:
    """Return how each mode scatters over the machines: mean over machines, and standard deviation between them [%]."""
    out = []
    for entry, number, same in over_machines(modes):
        row: dict[str, object] = {"entry": entry, "mode": number, "machines": len(same)}
        for quantity in QUANTITIES:
            logs = np.array([np.mean(np.log(mode.values(quantity))) for mode in same])
            row[_COLUMN[quantity]] = float(np.exp(logs.mean()))
            row[f"{quantity}_scatter_percent"] = 100.0 * float(logs.std(ddof=1)) if logs.size > 1 else np.nan
        out.append(row)
    names = [n for q in QUANTITIES for n in (_COLUMN[q], f"{q}_scatter_percent")]
    return pd.DataFrame(out, columns=["entry", "mode", "machines", *names])


def over_machines(modes: Sequence[Mode]) -> list[tuple[str, int, list[Mode]]]:
    """Return entry, number and the same mode on every machine that has it, by the rule of this module."""
    out = []
    for entry in sorted({mode.entry for mode in modes}):
        own = [mode for mode in modes if mode.entry == entry]
        steps = [[m for m in own if m.machine == machine] for machine in sorted({m.machine for m in own})]
        same = [list(found.values()) for found in follow(steps, _frequency, _mean, APART)]
        same.sort(key=lambda group: float(np.mean([_frequency(m) for m in group])))
        out += [(entry, number, group) for number, group in enumerate(same, 1)]
    return out


def _frequency(mode: Mode) -> float:
    return _mean(mode.values("frequency").tolist())


def _mean(frequencies: Sequence[float]) -> float:
    return sum(frequencies) / len(frequencies)


def _last(frequencies: Sequence[float]) -> float:
    return frequencies[-1]
