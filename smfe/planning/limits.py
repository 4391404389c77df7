"""What a plan needs of the machine against what the machine has, and how that is said."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from process.units import show
from smfe.campaign.schema import PlanTable
from smfe.identification.sweep.rules import RULES as SWEEP_RULES
from smfe.planning.task import Task


@dataclass(frozen=True)
class Limit:
    """One limit of the machine or of the task.

    Parameters
    ----------
    key : str
        Column of the table of alternatives that holds what is needed, as a multiple of what there is.
    what : str
        Its name in a sentence.
    setting : str
        Where it is set in the file.
    """

    key: str
    what: str
    setting: str


LIMITS: tuple[Limit, ...] = (
    Limit("speed_high", "a higher spindle speed", "spindle.maximum"),
    Limit("speed_low", "a lower spindle speed", "spindle.minimum"),
    Limit("acceleration", "a faster spindle acceleration", "plan.spindle_acceleration"),
    Limit("feed_high", "a higher feed", "plan.feed"),
    Limit("feed_low", "a lower feed", "plan.feed"),
    Limit("stroke", "a longer stroke", "plan.stroke"),
    Limit("stock", "a longer stock", "plan.stock_length"),
    Limit("time", "more time", "plan.time"),
    Limit("condition", "forces that are less alike", "plan.passes or tool.approach_angle"),
    Limit("noise", "a quieter force sensor or a deeper cut", "plan.force_noise"),
    Limit("chatter", "a more stable cut", "plan.chatter_margin or plan.depth_of_cut"),
    Limit("force", "a larger force", "plan.largest_force"),
    Limit("torque", "more torque", "plan.torque"),
    Limit("power", "more power", "plan.power"),
    Limit("error", "a larger error", "plan.largest_error"),
)
"""In the order in which they are asked."""

KEYS = tuple(limit.key for limit in LIMITS)


def allowed(task: Task, key: str) -> float | None:
    """Return the value of a limit in SI (speeds in rpm); None where there is none."""
    limits: PlanTable = task.limits
    feed = limits.feed or (None, None)
    values: dict[str, float | None] = {
        "speed_high": task.spindle.maximum if np.isfinite(task.spindle.maximum) else None,
        "speed_low": task.spindle.minimum or None,
        "acceleration": limits.spindle_acceleration,
        "feed_low": feed[0],
        "feed_high": feed[1],
        "stroke": limits.stroke,
        "stock": limits.stock_length,
        "time": limits.time,
        "condition": SWEEP_RULES.refuse_condition,
        "noise": max(limits.force_noise),
        "chatter": limits.depth_of_cut[0],
        "force": limits.largest_force,
        "torque": limits.torque,
        "power": limits.power,
        "error": limits.largest_error,
    }
    return values[key]


_UNITS: dict[str, tuple[str, str]] = {
    "acceleration": ("rpm/s", "rotation_rate"),
    "feed_low": ("mm/min", "speed"),
    "feed_high": ("mm/min", "speed"),
    "stroke": ("mm", "length"),
    "stock": ("mm", "length"),
    "time": ("s", "time"),
    "chatter": ("mm", "length"),
    "noise": ("N", "force"),
    "force": ("N", "force"),
    "torque": ("N m", "torque"),
    "power": ("kW", "power"),
}


def quantity(key: str, value: float, digits: int = 3) -> str:
    """Return a value of a limit as text."""
    if key in ("speed_high", "speed_low"):
        return f"{value:.{digits + 1}g} rpm"
    if key == "condition":
        return f"{value:.{digits}g}"
    if key == "error":
        return f"{100.0 * value:.{digits}g} %"
    unit, dimension = _UNITS[key]
    return show(value, unit, dimension, digits=digits)


def need(task: Task, key: str, ratio: float) -> str:
    """Return what is needed against what there is: ``"a longer stroke: 420 mm instead of 300 mm (plan.stroke)"``."""
    limit = LIMITS[KEYS.index(key)]
    given = allowed(task, key)
    if given is None:
        return f"{limit.what} ({limit.setting})"
    if key == "chatter":
        depth = quantity(key, given / ratio)
        return f"{limit.what}: at most {depth} are safe, {quantity(key, given)} are asked ({limit.setting})"
    # Lower limits must come down, all others go up.
    wanted = given / ratio if key in ("speed_low", "feed_low", "noise") else given * ratio
    # As many digits as make the two differ.
    digits = next((d for d in range(3, 9) if quantity(key, wanted, d) != quantity(key, given, d)), 9)
    return f"{limit.what}: {quantity(key, wanted, digits)} instead of {quantity(key, given, digits)} ({limit.setting})"


def rejections(task: Task, table: pd.DataFrame) -> pd.DataFrame:
    """Return, for each limit that rejects something, how much it rejects and what lifting it alone would bring.

    Parameters
    ----------
    task : Task
        The task.
    table : pandas.DataFrame
        All alternatives; columns `KEYS` hold needed over available, above one where the limit fails.

    Returns
    -------
    pandas.DataFrame
        limit, rejected (number of alternatives), alone (of these, by this limit alone), best_error_percent (the best
        expected error among the latter), needs (text).
    """
    ratio = table[list(KEYS)].to_numpy()
    fails = ratio > 1.0 + 1e-9
    rows = []
    for k, limit in enumerate(LIMITS):
        mine = fails[:, k]
        if not mine.any():
            continue
        alone = mine & (fails.sum(axis=1) == 1)
        among = np.flatnonzero(alone if alone.any() else mine)
        nearest = among[np.argmin(ratio[among, k])]
        best = float(table["worst"].to_numpy()[np.flatnonzero(alone)].min()) if alone.any() else np.nan
        rows.append(
            {
                "limit": limit.setting,
                "rejected": int(mine.sum()),
                "alone": int(alone.sum()),
                "best_error_percent": 100.0 * best,
                "needs": need(task, limit.key, float(ratio[nearest, k])),
            }
        )
    columns = ["limit", "rejected", "alone", "best_error_percent", "needs"]
    return pd.DataFrame(rows, columns=columns)


def no_plan(task: Task, table: pd.DataFrame) -> str:
    """Return the sentence that says that no plan works, and which limit would have to be lifted."""
    ratio = table[list(KEYS)].to_numpy()
    fails = ratio > 1.0 + 1e-9
    fewest = fails.sum(axis=1).min()
    candidates = np.flatnonzero(fails.sum(axis=1) == fewest)
    if fewest == 1:
        options: dict[int, float] = {}
        for row in candidates:
            k = int(np.flatnonzero(fails[row])[0])
            if k not in options or ratio[row, k] < options[k]:
                options[k] = float(ratio[row, k])
        nearest = sorted(options, key=lambda k: options[k])[:3]
        lifted = "; or ".join(need(task, KEYS[k], options[k]) for k in nearest)
    else:
        row = candidates[np.argmin(np.where(fails[candidates], ratio[candidates], 1.0).max(axis=1))]
        lifted = ", and ".join(need(task, KEYS[k], float(ratio[row, k])) for k in np.flatnonzero(fails[row]))
    low, high = task.limits.frequency_range
    return (
        f"{task.path.name}: none of {len(table)} sweeps looked at identifies {low:g} to {high:g} Hz within the limits; "
        f"nearest would be one with {lifted}"
    )
