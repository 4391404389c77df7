"""Lobe tables for CAM: fixed columns, one row a spindle speed."""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from process.cut.tool import Tool
from process.errors import InputError
from process.types import Real

LOBE_COLUMNS: tuple[str, ...] = (
    "lobes",
    "source",
    "kind",
    "method",
    "cut",
    "spindle_speed_rpm",
    "limit_depth_mm",
    "limit_depth_p05_mm",
    "limit_depth_p95_mm",
    "safe_depth_mm",
    "width_of_cut_mm",
    "feed_per_tooth_mm",
    "feed_mm_min",
    "chatter_frequency_Hz",
    "lobe",
    "removal_rate_cm3_min",
    "lower_limit_depth_mm",
    "kick_Ns",
)
"""Columns of ``lobe_table.csv``, in order."""

_LATER = ("lower_limit_depth_mm", "kick_Ns")
"""Columns that a table of an earlier version does not have."""

UNLIMITED: tuple[str, ...] = ("limit_depth_mm", "removal_rate_cm3_min")
"""Columns in which an empty field of a file means "no limit as far as the data reach"."""

TEXTS: tuple[str, ...] = ("lobes", "source", "kind", "method", "cut")
"""Columns that are names."""

SAFE_QUANTILE = 0.05


@dataclass(frozen=True)
class Origin:
    """Where the rows of a lobe table come from; empty where it is not said.

    Parameters
    ----------
    source : str
        Name of the measurement or model.
    lobes : str, optional
        Request, "lobes_1".
    kind : str, optional
        How it was measured ("hammer", "sweep", ...), or "model".
    method, cut : str, optional
        Stability method, and kind of cut.
    """

    source: str
    lobes: str = ""
    kind: str = ""
    method: str = ""
    cut: str = ""


def lobe_table(
    lobes: xr.Dataset, source: str | Origin, tool: Tool, width_of_cut: float, feed_per_tooth: float
) -> pd.DataFrame:
    """Return lobes as a table with the columns `LOBE_COLUMNS`.

    ``feed = f_z N n``, or that of the lobes; ``removal rate = a_p a_e feed`` at the limit depth. The safe depth is that
    of the lobes (``safe_depth``, for the probability they name), else the 5 % quantile of the limit depth; without
    either it stays NaN, because an unmeasured margin would be invented.

    Parameters
    ----------
    lobes : xarray.Dataset
        ``limit_depth(spindle_speed)`` [mm], ``chatter_frequency`` [Hz], ``lobe``; may hold
        ``limit_depth_quantile(quantile, spindle_speed)`` [mm] and ``safe_depth(spindle_speed)`` [mm], and of an
        operating point ``feed`` [mm/min], ``lower_limit_depth`` [mm] and ``kick`` [N s].
    source : str or Origin
        Name of the measurement or model behind the lobes, or all that is said of where they come from.
    tool : Tool
        Tool of the cut.
    width_of_cut, feed_per_tooth : float
        a_e and f_z [m].

    Returns
    -------
    pandas.DataFrame
        One row a speed. Where there is no limit, depth and removal rate are inf, frequency NaN and lobe
        missing.

    Raises
    ------
    InputError
        When the lobes lack a variable, still have a condition as dimension, hold a NaN limit, or the width or
        feed is not positive.
    """
    depth = _limit_depth(lobes)
    for name, value in (("width of cut", width_of_cut), ("feed per tooth", feed_per_tooth)):
        if not (np.isfinite(value) and value > 0.0):
            raise InputError(f"the {name} is {value * 1e3:g} mm; it must be positive")
    speed = lobes["spindle_speed"].values.astype(float)
    feed = feed_per_tooth * 1e3 * tool.teeth * speed
    if "feed" in lobes and lobes["feed"].dims == ("spindle_speed",):
        feed = lobes["feed"].values.astype(float)
    low, high = _quantile(lobes, SAFE_QUANTILE), _quantile(lobes, 1.0 - SAFE_QUANTILE)
    safe = lobes["safe_depth"].values.astype(float) if "safe_depth" in lobes else low.copy()
    lobe = lobes["lobe"].values
    origin = source if isinstance(source, Origin) else Origin(source)
    columns = (
        *([getattr(origin, name)] * speed.size for name in TEXTS),
        speed,
        depth,
        low,
        high,
        safe,
        np.full(speed.size, width_of_cut * 1e3),
        np.full(speed.size, feed_per_tooth * 1e3),
        feed,
        lobes["chatter_frequency"].values.astype(float),
        pd.array([int(k) if k >= 0 else None for k in lobe], dtype="Int64"),
        depth * width_of_cut * feed,
        *(_of_speed(lobes, name) for name in ("lower_limit_depth", "kick")),
    )
    return pd.DataFrame(dict(zip(LOBE_COLUMNS, columns, strict=True)))


def write_table(frame: pd.DataFrame, path: str | Path) -> Path:
    """Write a table as CSV, whole or not at all.

    Infinite and missing values become empty fields; an empty limit depth therefore means "no limit as far as
    the data reach" (`read_table` restores it), any other empty field "not known". Numbers keep nine digits.

    Parameters
    ----------
    frame : pandas.DataFrame
        Any table.
    path : str or Path
        File to write; its folder is made when missing. A file that is there is replaced in one step.

    Returns
    -------
    Path
        The file written.
    """
    text = frame.replace([np.inf, -np.inf], np.nan).to_csv(index=False, float_format="%.9g", lineterminator="\n")
    return write_whole(text, path)


def write_whole(text: str, path: str | Path) -> Path:
    """Write a text file, whole or not at all; its folder is made when missing.

    Parameters
    ----------
    text : str
        All of it.
    path : str or Path
        File to write. A file that is there is replaced in one step.

    Returns
    -------
    Path
        The file written.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.", suffix=".tmp")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as stream:
            stream.write(text)
        # mkstemp makes files private; a result is as readable as any other file of the user.
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, target)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    return target


def read_table(path: str | Path) -> pd.DataFrame:
    """Read a lobe table that `write_table` wrote; an empty limit depth becomes inf again.

    Raises
    ------
    InputError
        When the file does not exist or its columns are not `LOBE_COLUMNS`.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(f"there is no file '{file}'")
    frame = pd.read_csv(file, dtype=dict.fromkeys(TEXTS, str), keep_default_na=False, na_values=[""])
    if tuple(frame.columns) == LOBE_COLUMNS[: -len(_LATER)]:
        frame[list(_LATER)] = np.nan
    if tuple(frame.columns) != LOBE_COLUMNS:
        missing = [c for c in LOBE_COLUMNS if c not in frame.columns]
        problem = f"no column {missing[0]}" if missing else "its columns are in another order"
        raise InputError(f"'{file}' is not a lobe table: {problem}; needed are {', '.join(LOBE_COLUMNS)}")
    for name in UNLIMITED:
        frame[name] = frame[name].astype(float).fillna(np.inf)
    frame[list(TEXTS)] = frame[list(TEXTS)].fillna("")
    numbers = [c for c in LOBE_COLUMNS if c not in (*TEXTS, "lobe")]
    frame["lobe"] = frame["lobe"].astype("Int64")
    frame[numbers] = frame[numbers].astype(float)
    return frame


def _of_speed(lobes: xr.Dataset, name: str) -> Real:
    """Return a variable of an operating point, NaN where the lobes have none."""
    return lobes[name].values.astype(float) if name in lobes else np.full(lobes.sizes["spindle_speed"], np.nan)


def _limit_depth(lobes: xr.Dataset) -> Real:
    """Return the limit depth [mm] of checked lobes."""
    for name in ("limit_depth", "chatter_frequency", "lobe"):
        if name not in lobes:
            raise InputError(f"the lobes have no variable '{name}'; they come from e.g. zero_order")
        extra = [str(d) for d in lobes[name].dims if d != "spindle_speed"]
        if extra:
            raise InputError(f"the lobes still have the dimension '{extra[0]}'; choose one: lobes.sel({extra[0]}=...)")
    depth = lobes["limit_depth"].values.astype(float)
    if np.isnan(depth).any():
        raise InputError(f"{int(np.isnan(depth).sum())} limit depths are NaN; no limit is written as inf")
    return depth


def _quantile(lobes: xr.Dataset, level: float) -> Real:
    """Return one quantile of the limit depth [mm], NaN where it has not been computed."""
    if "limit_depth_quantile" in lobes:
        levels = lobes["quantile"].values.astype(float)
        at = np.flatnonzero(np.abs(levels - level) < 1e-9)
        if at.size:
            values = lobes["limit_depth_quantile"].isel(quantile=int(at[0])).values.astype(float)
            return np.asarray(values, dtype=float)
    return np.full(lobes.sizes["spindle_speed"], np.nan)


def _umask() -> int:
    """Return the process's umask; there is no way to read it but to set it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
