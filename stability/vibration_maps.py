"""What a cut does over spindle speed and depth beside being stable: vibration, wall, force, torque, power.

Below the limit the cut repeats itself with its own period (`methods.stationary_vibration`): the tool vibrates under
the cutting force, and the wall is off by where it is when a tooth passes. Torque and power are means over a turn
(`process.cut.force.mean_torque`). Above the limit the numbers are those of a motion that chatter overgrows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.cut.engagement import AnyEngagement, width_of
from process.cut.force import CuttingCoefficients, mean_torque
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import AXES
from process.types import Real
from stability.methods.stationary_vibration import VibrationOverDepth, vibration_over_depth
from stability.problem import Machine, check_spindle_speed

Progress = Callable[[str, int, int], None]

_UNITS = {
    "vibration": ("um", "peak-to-peak displacement of the tool"),
    "deflection": ("um", "largest distance of the tool from its place without a cut"),
    "surface_error": ("um", "how far beyond the nominal wall is cut; negative: material is left"),
    "peak_force": ("N", "largest force on the tool"),
    "mean_torque": ("N m", "mean torque on the spindle"),
    "spindle_power": ("kW", "mean power of the spindle"),
    "removal_rate": ("cm3/min", "removal rate"),
}
"""Variable -> unit and meaning."""

COARSEST = 1e-3
"""Relative change of the displacement at which the steps are fine enough."""


def cut_maps(
    machine: Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    depth_of_cut: ArrayLike,
    feed_per_tooth: float,
    spindle_speed: ArrayLike,
    limit_depth: ArrayLike | None = None,
    progress: Progress | None = None,
) -> xr.Dataset:
    """Return vibration, surface location error, force, torque, power and removal rate over speed and depth.

    Parameters
    ----------
    machine : Machine
        Anything with a ``state_space()``.
    tool, arc, coefficients
        The cut; straight edges, any pitch, no run-out, a sharp flank.
    depth_of_cut : array_like, shape (depths,)
        Axial depths [m], rising.
    feed_per_tooth : float
        [m].
    spindle_speed : array_like, shape (speeds,)
        Spindle speeds [rpm].
    limit_depth : array_like, shape (speeds,), optional
        Limits of the cut there [m], by any method: below them it is ``stable``. Default: nothing is said of it.
    progress : callable, optional
        Called with (what, done, of).

    Returns
    -------
    xarray.Dataset
        Over (spindle_speed [rpm], depth_of_cut [mm]): ``vibration(axis)`` and ``deflection`` [um],
        ``surface_error(wall)`` [um] of the walls that the cut leaves, "up" at tooth angle 0 and "down" at 180 degrees,
        ``peak_force`` [N], ``mean_torque`` [N m], ``spindle_power`` [kW], ``removal_rate`` [cm3/min], ``stable``.

    Raises
    ------
    InputError
        As `stationary_vibration`, and for depths that do not rise.
    """
    speed, depth = check_spindle_speed(spindle_speed), np.atleast_1d(np.asarray(depth_of_cut, dtype=float))
    if depth.ndim != 1 or not depth.size or not depth[0] > 0.0 or not (np.diff(depth) > 0.0).all():
        raise InputError("depths of cut that do not rise from above zero; give e.g. np.linspace(0.5e-3, 8e-3, 16)")
    found = list[VibrationOverDepth]()
    for done, n in enumerate(speed):
        if progress is not None:
            progress("vibration and forces", done, speed.size)
        cut = (tool, arc, coefficients, depth, feed_per_tooth, float(n), COARSEST)
        found.append(vibration_over_depth(machine, *cut))
    over = ("spindle_speed", "depth_of_cut")
    torque = np.tile(mean_torque(tool, arc, coefficients, feed_per_tooth) * depth, (speed.size, 1))
    feed = feed_per_tooth * tool.teeth * speed[:, None]  # m/min
    walls = list(found[0].wall)
    data = {
        "vibration": ((*over, "axis"), 1e6 * np.array([f.peak_to_peak for f in found])),
        "deflection": (over, 1e6 * np.array([f.deflection for f in found])),
        "surface_error": (
            (*over, "wall"),
            1e6
            * np.array([[f.wall[w] for w in walls] for f in found]).reshape(speed.size, len(walls), -1).swapaxes(1, 2)
            if walls
            else np.empty((speed.size, depth.size, 0)),
        ),
        "peak_force": (over, np.array([f.peak_force for f in found])),
        "mean_torque": (over, torque),
        "spindle_power": (over, 1e-3 * torque * speed[:, None] * math.pi / 30.0),
        "removal_rate": (over, 1e6 * depth * width_of(arc, tool.diameter) * feed),
    }
    out = xr.Dataset(data, {"spindle_speed": speed, "depth_of_cut": 1e3 * depth, "axis": list(AXES), "wall": walls})
    for name, (unit, meaning) in _UNITS.items():
        out[name].attrs.update(units=unit, long_name=meaning)
    out["spindle_speed"].attrs["units"], out["depth_of_cut"].attrs["units"] = "rpm", "mm"
    if limit_depth is not None:
        out["stable"] = (over, depth < np.asarray(limit_depth, dtype=float)[:, None])
    return out


def depths_within(
    machine: Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    feed_per_tooth: float,
    spindle_speed: ArrayLike,
    deepest: ArrayLike,
    deflection: float = math.inf,
    surface_error: float = math.inf,
    progress: Progress | None = None,
) -> tuple[Real, Real]:
    """Return the greatest depths at which the tool is deflected, and the wall is off, by no more than is allowed.

    Parameters
    ----------
    machine, tool, arc, coefficients, feed_per_tooth, spindle_speed
        As `cut_maps`.
    deepest : array_like, shape (speeds,)
        Depth beyond which nobody asks at each speed [m], the limit: with unequal pitch depths up to it are tried.
    deflection, surface_error : float
        What is allowed [m]: the largest distance of the tool from its place, and of each wall from the nominal one,
        whether too much is cut or too little.
    progress : callable, optional
        Called with (what, done, of).

    Returns
    -------
    by_deflection, by_surface : ndarray, shape (speeds,)
        Depths [m]; inf where what is allowed is not reached up to `deepest` (equal pitch: at any depth).

    Raises
    ------
    InputError
        As `cut_maps`; and where a surface error is limited and the cut leaves no wall.
    """
    speed, most = check_spindle_speed(spindle_speed), np.asarray(deepest, dtype=float)
    out = np.full((2, speed.size), math.inf)
    for k, n in enumerate(speed):
        if progress is not None:
            progress("depths within the limits", k, speed.size)
        top = float(most[k]) if math.isfinite(most[k]) and most[k] > 0.0 else 1e-3
        cut = partial(vibration_over_depth, machine, tool, arc, coefficients)
        depth = np.array([top]) if tool.equal_pitch else top * np.linspace(0.0, 1.0, 13)[1:]
        found = cut(depth, feed_per_tooth, float(n), COARSEST)
        if math.isfinite(surface_error) and not found.wall:
            raise InputError(
                "a surface_error is limited, and the cut leaves no wall: it begins above 0 and ends below 180 deg. "
                "Leave surface_error out, or ask for a down or up cut"
            )
        for row, allowed in enumerate((deflection, surface_error)):
            if not math.isfinite(allowed):
                continue
            size = _sizes(found)[row]
            if tool.equal_pitch:
                out[row, k] = top * allowed / size[0] if size[0] > 0.0 else math.inf
                continue
            at = np.flatnonzero(size >= allowed)
            if at.size:
                finer = depth[at[0]] + (depth[0] / 8.0) * np.arange(-8.0, 1.0)
                finer = finer[finer > 0.0]
                sizes = _sizes(cut(finer, feed_per_tooth, float(n), COARSEST))[row]
                over = np.concatenate([[0.0], np.maximum.accumulate(sizes)])
                out[row, k] = np.interp(allowed, over, np.concatenate([[0.0], finer]))
    return out[0], out[1]


def _sizes(found: VibrationOverDepth) -> tuple[Real, Real]:
    """Return the deflection, and the error of the wall that is furthest off."""
    walls = np.max([np.abs(v) for v in found.wall.values()], axis=0) if found.wall else np.zeros(found.deflection.size)
    return found.deflection, np.asarray(walls)
