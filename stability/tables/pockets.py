"""Best pockets of a lobe table: the spindle speeds, among those that can be set, at which most is removed.

Rules, in this order. A speed counts only with the depth that holds wherever the spindle may turn about it. A depth is
given only where it is known to be safe, rounded down to `DEPTH_STEP`; the removal rate is that of the rounded depth. A
pocket is a local maximum of the removal rate that stands out by `PROMINENCE` on both sides. A flank that still rises,
or has hardly fallen, where the range of speeds ends, is an edge: beyond it nothing was computed, or can be set. It
ranks below every pocket inside.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.signal import find_peaks

from process.errors import InputError
from process.types import Real

POCKET_COLUMNS: tuple[str, ...] = (
    "source",
    "rank",
    "spindle_speed_rpm",
    "depth_of_cut_mm",
    "basis",
    "at_edge",
    "speed_from_rpm",
    "speed_to_rpm",
    "width_of_cut_mm",
    "feed_per_tooth_mm",
    "feed_mm_min",
    "removal_rate_cm3_min",
    "depth_gain",
    "safe_depth_mm",
    "limit_depth_mm",
    "limit_depth_p05_mm",
    "limit_depth_p95_mm",
    "chatter_frequency_Hz",
)
"""Columns of a table of pockets, in order."""

PROMINENCE = 0.1
"""A pocket's removal rate stands out by this share of itself from the valleys on either side of it."""

DEPTH_STEP = 0.1
"""Step to which a depth of cut is rounded down [mm]: what is typed into a machine."""

Ceiling = Callable[[Real], Real]
"""Spindle speeds [rpm] -> greatest depth that can be cut there [m]."""


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

    def among(self, speeds: Real) -> Real:
        """Return those of some speeds that can be set, rising [rpm]."""
        speeds = np.unique(speeds)
        speeds = speeds[(speeds >= self.minimum) & (speeds <= self.maximum)]
        if self.step is None:
            return speeds
        return speeds[np.abs(speeds / self.step - np.round(speeds / self.step)) <= 1e-6]


def rounded_down(depth: Real) -> Real:
    """Return depths rounded down to `DEPTH_STEP` [mm]; what lies a rounding error below a step is the step."""
    return np.asarray(np.floor(depth / DEPTH_STEP + 1e-6) * DEPTH_STEP).round(9)


def best_pockets(
    table: pd.DataFrame,
    count: int = 3,
    spindle: SpindleRange | None = None,
    maximum_depth: float | Ceiling | None = None,
    speeds: Real | None = None,
) -> pd.DataFrame:
    """Return the best pockets of every source and cut in a lobe table.

    The depth of a speed is the smallest safe depth of the table within the accuracy of the spindle about it, the next
    rows on either side included, and at most the maximum depth. Where the table knows no safe depth, ``basis`` is
    "limit_depth": the pockets are those of the limit, and no depth of cut is given.

    Parameters
    ----------
    table : pandas.DataFrame
        From `stability.lobe_table`; several may be joined.
    count : int, optional
        Most pockets a source and cut.
    spindle : SpindleRange, optional
        Limits, step and accuracy of its speed. Default: any speed of the table, held within 1 %.
    maximum_depth : float or callable, optional
        Greatest depth that can be cut [m]: the length of the edges, the allowance; or a function of the speeds [rpm],
        where power or torque limit it. Needed where there is no limit.
    speeds : ndarray, optional
        The only speeds that may be set [rpm], each a candidate: the table then holds the speeds about them as well,
        and none of them is an edge. Default: every speed within the range of the table and of the spindle.

    Returns
    -------
    pandas.DataFrame
        Columns `POCKET_COLUMNS`, best first within each source: pockets inside the range of speeds before those at
        its ends (``at_edge``). ``safe_depth_mm`` holds within the accuracy of the spindle; ``depth_of_cut_mm`` is the
        same rounded down; limit, its quantiles and the chatter frequency are those of the speed, within that accuracy,
        at which the depth is smallest. ``speed_from_rpm`` to ``speed_to_rpm`` is the range of the table about the
        pocket in which its depth holds; ``depth_gain`` is its depth over the depth that holds at every speed. No row
        where no speed can be set.

    Raises
    ------
    InputError
        When there is no limit at a speed and no maximum depth, or `count` or the maximum depth is not positive.
    """
    fixed = maximum_depth if isinstance(maximum_depth, int | float) else None
    if count < 1 or (fixed is not None and not fixed > 0.0):
        raise InputError(f"{count} pockets up to a depth of {fixed} m; both must be positive")
    ceiling = maximum_depth if callable(maximum_depth) else _constant(fixed)
    cuts = table.groupby(["source", "width_of_cut_mm", "feed_per_tooth_mm"], sort=False)
    frames = [_pockets(cut, count, spindle or SpindleRange(), ceiling, speeds) for _, cut in cuts]
    frames = [frame for frame in frames if len(frame)]
    return pd.concat(frames, ignore_index=True) if frames else pd.DataFrame(columns=list(POCKET_COLUMNS))


def _constant(depth: float | None) -> Ceiling:
    return lambda speed: np.full(speed.shape, math.inf if depth is None else depth)


@dataclass(frozen=True)
class _Held:
    """What holds about each speed that can be set.

    Parameters
    ----------
    speed : ndarray, shape (speeds,)
        [rpm].
    depth : ndarray, shape (speeds,)
        Smallest depth wherever the spindle may turn, and at most the ceiling [mm].
    row : ndarray of int, shape (speeds,)
        Row of the table with that depth.
    basis : str
        "safe_depth" or "limit_depth".
    """

    speed: Real
    depth: Real
    row: NDArray[np.int64]
    basis: str


def _held(cut: pd.DataFrame, spindle: SpindleRange, ceiling: Ceiling, speeds: Real | None) -> _Held:
    """Return what holds about each speed that can be set, from the rows of one cut in rising order of speed."""
    speed = cut["spindle_speed_rpm"].to_numpy(float)
    depth, basis = _depth(cut)
    settable = _covered(spindle.speeds(speed) if speeds is None else spindle.among(speeds), speed, spindle.accuracy)
    row = np.array([_lowest(speed, depth, n, spindle.accuracy) for n in settable], dtype=np.int64)
    held = np.minimum(depth[row], 1e3 * ceiling(settable))
    if np.isinf(held).any():
        raise InputError(
            f"the table of '{cut['source'].iloc[0]}' has {int(np.isinf(depth).sum())} speeds without a limit; give a "
            "maximum_depth: the length of the edges or the allowance"
        )
    return _Held(settable, held, row, basis)


def usable_depths(
    table: pd.DataFrame,
    spindle: SpindleRange | None = None,
    maximum_depth: Ceiling | None = None,
    speeds: Real | None = None,
) -> pd.DataFrame:
    """Return the depth that may be cut at each speed that can be set, by the rules of `best_pockets`.

    Parameters
    ----------
    table : pandas.DataFrame
        Rows of one source and cut.
    spindle, maximum_depth, speeds
        As of `best_pockets`.

    Returns
    -------
    pandas.DataFrame
        ``spindle_speed_rpm``, ``depth_of_cut_mm`` rounded down, ``feed_mm_min`` and ``removal_rate_cm3_min``; no row
        where no safe depth is known.

    Raises
    ------
    InputError
        When there is no limit at a speed and no maximum depth.
    """
    columns = ["spindle_speed_rpm", "depth_of_cut_mm", "feed_mm_min", "removal_rate_cm3_min"]
    cut = table.sort_values("spindle_speed_rpm", ignore_index=True)
    if cut.empty or cut["safe_depth_mm"].isna().all():
        return pd.DataFrame(columns=columns)
    found = _held(cut, spindle or SpindleRange(), maximum_depth or _constant(None), speeds)
    depth = rounded_down(found.depth)
    feed = _feed(cut, found.speed)
    rate = depth * float(cut["width_of_cut_mm"].iloc[0]) * feed / 1e3
    return pd.DataFrame(dict(zip(columns, (found.speed, depth, feed, rate), strict=True)))


def _pockets(
    cut: pd.DataFrame, count: int, spindle: SpindleRange, ceiling: Ceiling, speeds: Real | None
) -> pd.DataFrame:
    """Return the pockets of one source and cut."""
    cut = cut.sort_values("spindle_speed_rpm", ignore_index=True)
    speed, depth = cut["spindle_speed_rpm"].to_numpy(float), _depth(cut)[0]
    found = _held(cut, spindle, ceiling, speeds)
    settable, held, safe = found.speed, found.depth, found.basis == "safe_depth"
    if not settable.size:
        return pd.DataFrame(columns=list(POCKET_COLUMNS))
    feed = _feed(cut, settable)
    usable = rounded_down(held) if safe else held
    edge = np.zeros(settable.size, dtype=bool)
    if speeds is None:
        chosen = _peaks(np.concatenate([[0.0], held * feed, [0.0]])) - 1
        edge[:] = True
        edge[_peaks(held * feed)] = False
    else:
        chosen = np.flatnonzero(held > 0.0)
    rate = usable * float(cut["width_of_cut_mm"].iloc[0]) * feed / 1e3
    everywhere = min(float(depth.min()), float(held.min()))
    # Rounding may level two pockets: the deeper before rounding is then the better one.
    best = chosen[np.lexsort((-held[chosen] * feed[chosen], -rate[chosen], edge[chosen]))]
    rows = []
    for rank, k in enumerate(best[:count], 1):
        within = np.minimum(depth, 1e3 * ceiling(speed)) >= usable[k] * (1.0 - 1e-9)
        if speeds is not None:  # between two named speeds nothing is known
            within &= np.abs(speed / settable[k] - 1.0) <= spindle.accuracy * (1.0 + 1e-9)
        low, high = _range(speed, within, float(settable[k]))
        worst = cut.iloc[int(found.row[k])]
        rows.append(
            {
                **{name: worst[name] for name in POCKET_COLUMNS if name in worst},
                "rank": rank,
                "spindle_speed_rpm": settable[k],
                "depth_of_cut_mm": usable[k] if safe else math.nan,
                "basis": found.basis,
                "at_edge": bool(edge[k]),
                "speed_from_rpm": low,
                "speed_to_rpm": high,
                "feed_mm_min": feed[k],
                "removal_rate_cm3_min": rate[k] if safe else math.nan,
                "depth_gain": held[k] / everywhere if everywhere > 0.0 else math.inf,
                "safe_depth_mm": held[k] if safe else math.nan,
            }
        )
    return pd.DataFrame(rows, columns=list(POCKET_COLUMNS))


def _feed(cut: pd.DataFrame, speed: Real) -> Real:
    """Return the feed at spindle speeds [rpm]: in proportion, or as it was given apart from the chip."""
    own, feed = (cut[name].to_numpy(dtype=float) for name in ("spindle_speed_rpm", "feed_mm_min"))
    chip = feed / own
    return np.asarray(speed * chip[0] if np.ptp(chip) <= 1e-6 * chip.max() else np.interp(speed, own, feed))


def _peaks(rate: Real) -> NDArray[np.int64]:
    """Return where a removal rate has a maximum that stands out on both sides within the range."""
    chosen, shape = find_peaks(rate, prominence=0.0)
    return np.asarray(chosen[shape["prominences"] >= PROMINENCE * rate[chosen]])


def _covered(settable: Real, speed: Real, accuracy: float) -> Real:
    """Return the speeds about which the table reaches as far as the spindle may turn; all where there is none."""
    if not settable.size:
        return settable
    low, high = float(speed[0]) * (1.0 - 1e-9), float(speed[-1]) * (1.0 + 1e-9)
    inside = (settable * (1.0 - accuracy) >= low) & (settable * (1.0 + accuracy) <= high)
    return settable[inside] if inside.any() else settable


def _depth(cut: pd.DataFrame) -> tuple[Real, str]:
    """Return the depth that may be used at each speed [mm], and what it rests on."""
    safe = cut["safe_depth_mm"].to_numpy(float)
    if np.isnan(safe).all():
        return cut["limit_depth_mm"].to_numpy(float), "limit_depth"
    # A speed at which the safe depth is not known is not used.
    return np.nan_to_num(safe, nan=0.0, posinf=np.inf), "safe_depth"


def _lowest(speed: Real, depth: Real, at: float, accuracy: float) -> int:
    """Return the row of the smallest depth, from the row at or below a range of speeds to that at or above it."""
    low = max(0, int(np.searchsorted(speed, at * (1.0 - accuracy) * (1.0 + 1e-12), side="right")) - 1)
    high = int(np.searchsorted(speed, at * (1.0 + accuracy) * (1.0 - 1e-12), side="left"))
    return low + int(depth[low : high + 1].argmin())


def lowest_about(table: pd.DataFrame, column: str, speed: float, accuracy: float) -> pd.Series:
    """Return the row in which a depth is smallest wherever the spindle may turn about a speed.

    Parameters
    ----------
    table : pandas.DataFrame
        Rows of one source and cut.
    column : str
        The depth, e.g. "limit_depth_mm".
    speed : float
        What is set [rpm].
    accuracy : float
        How far the speed departs from it, as a share.

    Returns
    -------
    pandas.Series
        From the row of the table at or below the range of speeds to that at or above it, as in `best_pockets`.
    """
    cut = table.sort_values("spindle_speed_rpm", ignore_index=True)
    depth = np.nan_to_num(cut[column].to_numpy(float), nan=math.inf, posinf=math.inf)
    return cut.iloc[_lowest(cut["spindle_speed_rpm"].to_numpy(float), depth, speed, accuracy)]


def _range(speed: Real, enough: NDArray[np.bool_], at: float) -> tuple[float, float]:
    """Return the range of the table about a speed in which the depth is enough."""
    k = int(np.abs(speed - at).argmin())
    low, high = k, k
    while low > 0 and enough[low - 1]:
        low -= 1
    while high < speed.size - 1 and enough[high + 1]:
        high += 1
    return min(at, float(speed[low])), max(at, float(speed[high]))
