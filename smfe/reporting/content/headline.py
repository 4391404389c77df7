"""The headline: how deep, at which speed, and how sure; every number stands in a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.signal import find_peaks

from process.types import Real
from smfe.reporting.content.results import Lobes, Results

KEEP = 0.8
"""Share of the depth of a pocket that must hold over the window of speeds given with it."""

_SHOWN = 4


@dataclass(frozen=True)
class Pocket:
    """A local maximum of the limit depth.

    Parameters
    ----------
    speed : (float, float)
        Spindle speed [rpm]; both the same unless the maximum is a plateau.
    depth, low, high, safe : float
        Limit depth, its 5 % and 95 % quantile and the safe depth [mm]; inf: no limit found, NaN: not known.
    removal_rate : float
        At the limit depth [cm3/min].
    chatter_frequency : float
        [Hz].
    window : (float, float)
        Speeds around it [rpm] that keep the share `KEEP` of the depth.
    at_edge : bool
        Whether it lies at an end of the range of speeds, so that the true maximum may lie outside.
    """

    speed: tuple[float, float]
    depth: float
    low: float
    high: float
    safe: float
    removal_rate: float
    chatter_frequency: float
    window: tuple[float, float]
    at_edge: bool


@dataclass(frozen=True)
class Score:
    """Cutting tests against the lobes of one source.

    Parameters
    ----------
    right, of : int
        Tests predicted rightly, and tests with an outcome and a prediction.
    unsafe : int
        Predicted stable, but chattered.
    """

    right: int
    of: int
    unsafe: int


@dataclass(frozen=True)
class Answer:
    """What one source says for one request.

    Parameters
    ----------
    request, source : str
        Whose answer it is.
    speeds : (float, float)
        Lowest and highest speed [rpm].
    pockets : tuple of Pocket
        Best removal rate first.
    smallest, smallest_at : float
        Smallest limit depth [mm] and its speed [rpm]: below it every speed is stable.
    smallest_safe : float
        Smallest safe depth [mm], NaN when not known.
    score : Score or None
        None without cutting tests.
    """

    request: str
    source: str
    speeds: tuple[float, float]
    pockets: tuple[Pocket, ...]
    smallest: float
    smallest_at: float
    smallest_safe: float
    score: Score | None


def answers(results: Results) -> list[Answer]:
    """Return one answer a request and source."""
    return [answer(item, results.chatter) for item in results.lobes if not item.table.empty]


def answer(lobes: Lobes, chatter: pd.DataFrame | None) -> Answer:
    """Return what one set of lobes says."""
    table = lobes.table
    speed = table["spindle_speed_rpm"].to_numpy(dtype=float)
    depth = table["limit_depth_mm"].to_numpy(dtype=float)
    lowest = int(np.argmin(depth))
    safe = _column(table, "safe_depth_mm")
    known = safe[np.isfinite(safe)]
    return Answer(
        lobes.request,
        lobes.source,
        (float(speed[0]), float(speed[-1])),
        tuple(pockets(table)),
        float(depth[lowest]),
        float(speed[lowest]),
        # One unknown speed and "safe at every speed" could not be said.
        float(known.min()) if known.size == safe[np.isfinite(depth)].size and known.size else float("nan"),
        score(chatter, lobes.request, lobes.source),
    )


def pockets(table: pd.DataFrame) -> list[Pocket]:
    """Return the best pockets of a lobe table, highest removal rate (else depth) first."""
    speed = table["spindle_speed_rpm"].to_numpy(dtype=float)
    depth = table["limit_depth_mm"].to_numpy(dtype=float)
    finite = depth[np.isfinite(depth)]
    level = np.where(np.isfinite(depth), depth, 2.0 * finite.max(initial=1.0))
    # Padding makes peaks of maxima at the ends of the range.
    padded = np.concatenate([[-1.0], level, [-1.0]])
    at, shape = find_peaks(padded, prominence=0.0, plateau_size=0)
    first, last = shape["left_edges"] - 1, shape["right_edges"] - 1
    # A lower ripple would share its window with the pocket beside it.
    keep = np.flatnonzero(shape["prominences"] >= (1.0 - KEEP) * padded[at])
    found = [_pocket(table, speed, level, (int(first[k]), int(last[k]))) for k in keep]
    rank = [p.depth if np.isnan(p.removal_rate) else p.removal_rate for p in found]
    order = sorted(range(len(found)), key=lambda k: -rank[k])
    return [found[k] for k in order[:_SHOWN]]


def _pocket(table: pd.DataFrame, speed: Real, level: Real, plateau: tuple[int, int]) -> Pocket:
    first, last = plateau
    held = level >= KEEP * level[first]
    below = np.flatnonzero(~held)
    left = int(below[below < first].max(initial=-1)) + 1
    right = int(below[below > last].min(initial=speed.size)) - 1
    row = (first + last) // 2
    return Pocket(
        speed=(float(speed[first]), float(speed[last])),
        depth=_at(table, "limit_depth_mm", row),
        low=_at(table, "limit_depth_p05_mm", row),
        high=_at(table, "limit_depth_p95_mm", row),
        safe=_at(table, "safe_depth_mm", row),
        removal_rate=_at(table, "removal_rate_cm3_min", row),
        chatter_frequency=_at(table, "chatter_frequency_Hz", row),
        window=(float(speed[left]), float(speed[right])),
        at_edge=first == 0 or last == speed.size - 1,
    )


def _at(table: pd.DataFrame, name: str, row: int) -> float:
    return float(_column(table, name)[row])


def _column(table: pd.DataFrame, name: str) -> Real:
    if name not in table:
        return np.full(len(table), np.nan)
    return table[name].to_numpy(dtype=float)


def outcomes(chatter: pd.DataFrame) -> pd.Series[str]:
    """Return what happened in each cutting test: what the engineer observed, else the criterion's verdict."""
    verdict = chatter["verdict"].fillna("undecided").astype(str)
    if "observed" not in chatter:
        return verdict
    observed = chatter["observed"].fillna("").astype(str)
    return verdict.where(observed == "", observed)


def score(chatter: pd.DataFrame | None, request: str, source: str) -> Score | None:
    """Count the cutting tests of a request that a source predicted rightly; undecided tests do not count."""
    column = f"predicted_{source}"
    if chatter is None or column not in chatter:
        return None
    happened, predicted = outcomes(chatter), chatter[column].astype(str)
    counted = happened.isin(["stable", "chatter"]) & predicted.isin(["stable", "chatter"])
    if "lobes" in chatter and request:
        counted &= chatter["lobes"].fillna("") == request
    if not counted.any():
        return None
    right = int((counted & (happened == predicted)).sum())
    unsafe = int((counted & (happened == "chatter") & (predicted == "stable")).sum())
    return Score(right, int(counted.sum()), unsafe)
