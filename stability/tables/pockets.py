"""Best pockets of a lobe table: the spindle speeds, among those that can be set, at which most is removed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.signal import find_peaks

from process.errors import InputError
from process.types import Real

POCKET_COLUMNS: tuple[str, ...] = (
    "source",
    "rank",
    "spindle_speed_rpm",
    "safe_depth_mm",
    "basis",
    "from_rpm",
    "to_rpm",
    "width_of_cut_mm",
    "feed_per_tooth_mm",
    "feed_mm_min",
    "removal_rate_cm3_min",
    "depth_gain",
    "limit_depth_mm",
    "chatter_frequency_Hz",
)
"""Columns of ``pockets.csv``, in order."""

PROMINENCE = 0.1
"""A pocket's removal rate stands out by this share of itself from the valleys about it."""


@dataclass(frozen=True)
class SpindleRange:
    """What a spindle can do.

    Parameters
    ----------
    minimum, maximum : float
        Spindle speeds [rpm].
    step : float, optional
        Speeds can be set in multiples of this [rpm]. Default: any speed of the table.
    accuracy : float, optional
        How far the speed departs from the one that is set, as a share of it.

    Raises
    ------
    InputError
        For limits without a speed between them.
    """

    minimum: float = 0.0
    maximum: float = math.inf
    step: float | None = None
    accuracy: float = 0.01

    def __post_init__(self) -> None:
        """Refuse a spindle that cannot turn."""
        if not 0.0 <= self.minimum < self.maximum:
            raise InputError(f"the spindle turns from {self.minimum:g} to {self.maximum:g} rpm; give a rising range")
        if self.step is not None and not self.step > 0.0:
            raise InputError(f"the spindle speed is set in steps of {self.step:g} rpm; the step must be positive")
        if not 0.0 <= self.accuracy < 1.0:
            raise InputError(f"a spindle accuracy of {self.accuracy:g}; give a share of the speed, e.g. 0.01")

    def speeds(self, table: Real) -> Real:
        """Return the speeds that can be set within the range of a table's rising speeds [rpm]."""
        low, high = max(self.minimum, float(table[0])), min(self.maximum, float(table[-1]))
        if self.step is None:
            return table[(table >= low) & (table <= high)]
        multiples = np.arange(math.ceil(low / self.step - 1e-9), math.floor(high / self.step + 1e-9) + 1)
        return np.asarray(multiples * self.step)


def best_pockets(
    table: pd.DataFrame, count: int = 3, spindle: SpindleRange | None = None, maximum_depth: float | None = None
) -> pd.DataFrame:
    """Return the best pockets of every source and cut in a lobe table.

    The depth of a speed is the smallest safe depth of the table within the accuracy of the spindle about it, the next
    rows on either side included; where the table knows no safe depth, its limit depth, and ``basis`` says so. A
    pocket is a local maximum of the removal rate that stands out by `PROMINENCE`.

    Parameters
    ----------
    table : pandas.DataFrame
        From `stability.lobe_table`; several may be joined.
    count : int, optional
        Most pockets a source and cut.
    spindle : SpindleRange, optional
        Limits, step and accuracy of its speed. Default: any speed of the table, held within 1 %.
    maximum_depth : float, optional
        Greatest depth that can be cut [m]: the length of the edges, the allowance. Needed where there is no limit.

    Returns
    -------
    pandas.DataFrame
        Columns `POCKET_COLUMNS`, best first within each source. ``from_rpm`` to ``to_rpm`` is the range of the table
        about the pocket in which its depth holds; ``depth_gain`` is its depth over the depth that holds at every speed.
        No row where no speed can be set.

    Raises
    ------
    InputError
        When there is no limit at a speed and no maximum depth, or `count` or the maximum depth is not positive.
    """
    if count < 1 or (maximum_depth is not None and not maximum_depth > 0.0):
        raise InputError(f"{count} pockets up to a depth of {maximum_depth} m; both must be positive")
    cuts = table.groupby(["source", "width_of_cut_mm", "feed_per_tooth_mm"], sort=False)
    frames = [_pockets(cut, count, spindle or SpindleRange(), maximum_depth) for _, cut in cuts]
    frames = [frame for frame in frames if len(frame)]
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=list(POCKET_COLUMNS))


def _pockets(cut: pd.DataFrame, count: int, spindle: SpindleRange, maximum_depth: float | None) -> pd.DataFrame:
    """Return the pockets of one source and cut."""
    cut = cut.sort_values("spindle_speed_rpm", ignore_index=True)
    speed = cut["spindle_speed_rpm"].to_numpy(float)
    depth, basis = _depth(cut, maximum_depth)
    settable = spindle.speeds(speed)
    held = np.array([_lowest(speed, depth, n, spindle.accuracy) for n in settable])
    feed = settable * float(cut["feed_mm_min"].iloc[0]) / speed[0]
    rate = held * float(cut["width_of_cut_mm"].iloc[0]) * feed / 1e3
    chosen, shape = find_peaks(np.concatenate([[0.0], rate, [0.0]]), prominence=0.0)
    chosen = chosen[shape["prominences"] >= PROMINENCE * rate[chosen - 1]] - 1
    rows = []
    for rank, k in enumerate(chosen[np.argsort(-rate[chosen], kind="stable")][:count], 1):
        low, high = _range(speed, depth, float(settable[k]), float(held[k]))
        nearest = cut.iloc[int(np.abs(speed - settable[k]).argmin())]
        rows.append(
            {
                **{name: nearest[name] for name in POCKET_COLUMNS if name in nearest},
                "rank": rank,
                "spindle_speed_rpm": settable[k],
                "safe_depth_mm": held[k],
                "basis": basis,
                "from_rpm": low,
                "to_rpm": high,
                "feed_mm_min": feed[k],
                "removal_rate_cm3_min": rate[k],
                "depth_gain": held[k] / depth.min() if depth.min() > 0.0 else math.inf,
            }
        )
    return pd.DataFrame(rows, columns=list(POCKET_COLUMNS))


def _depth(cut: pd.DataFrame, maximum_depth: float | None) -> tuple[Real, str]:
    """Return the depth that may be used at each speed [mm], and what it rests on."""
    safe = cut["safe_depth_mm"].to_numpy(float)
    basis = "limit_depth" if np.isnan(safe).all() else "safe_depth"
    # A speed at which the safe depth is not known is not used.
    depth = (
        cut["limit_depth_mm"].to_numpy(float) if basis == "limit_depth" else np.nan_to_num(safe, nan=0.0, posinf=np.inf)
    )
    if maximum_depth is not None:
        return np.minimum(depth, 1e3 * maximum_depth), basis
    if np.isinf(depth).any():
        raise InputError(
            f"the table of '{cut['source'].iloc[0]}' has {int(np.isinf(depth).sum())} speeds without a limit; give a "
            "maximum_depth: the length of the edges or the allowance"
        )
    return depth, basis


def _lowest(speed: Real, depth: Real, at: float, accuracy: float) -> float:
    """Return the smallest depth of the table from the row at or below a range of speeds to that at or above it."""
    low = max(0, int(np.searchsorted(speed, at * (1.0 - accuracy) * (1.0 + 1e-12), side="right")) - 1)
    high = int(np.searchsorted(speed, at * (1.0 + accuracy) * (1.0 - 1e-12), side="left"))
    return float(depth[low : high + 1].min())


def _range(speed: Real, depth: Real, at: float, held: float) -> tuple[float, float]:
    """Return the range of the table about a speed in which a depth holds."""
    enough = depth >= held * (1.0 - 1e-12)
    k = int(np.abs(speed - at).argmin())
    low, high = k, k
    while low > 0 and enough[low - 1]:
        low -= 1
    while high < speed.size - 1 and enough[high + 1]:
        high += 1
    return float(speed[low]), float(speed[high])
