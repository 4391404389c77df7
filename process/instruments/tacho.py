"""The angle of the spindle from the pulses of a tacho."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import interpolate

from process.errors import InputError
from process.types import Real


def tacho_angle(time: Real, level: Real, pulses_per_revolution: float = 1.0) -> Real:
    """Return the angle [rad] from the rising edges of a tacho, zero at the first.

    An edge is where the level passes its middle after it was below a quarter; its time is interpolated between
    samples. Between edges the angle is a cubic spline, outside them it goes on at the last speed.

    Parameters
    ----------
    time, level : ndarray, shape (n,)
        Time [s] and signal in any unit.
    pulses_per_revolution : float, optional
        Edges a turn.

    Raises
    ------
    InputError
        For fewer than four edges, or a gap as of a lost pulse.
    """
    low, high = np.quantile(level, [0.02, 0.98])
    if not high > low:
        low, high = float(level.min()), float(level.max())
    middle, quarter = 0.5 * (low + high), low + 0.25 * (high - low)
    edges = _edges(level, middle, quarter)
    if edges.size < 4:
        raise InputError(f"the tacho has {edges.size} rising edges; at least 4 are needed: check the channel")
    share = (middle - level[edges]) / (level[edges + 1] - level[edges])
    at = time[edges] + share * (time[edges + 1] - time[edges])
    gaps = np.diff(at)
    jump = gaps[1:] / gaps[:-1]
    if np.any(jump > 1.6) or np.any(jump < 1.0 / 1.6):
        where = float(at[1 + int(np.argmax(np.abs(np.log(jump))))])
        raise InputError(
            f"the time between tacho pulses changes by more than 60 % at {where:.4g} s: a pulse is lost or false, or "
            "the spindle starts or stops; cut the record to the sweep"
        )
    angle = 2.0 * np.pi / pulses_per_revolution * np.arange(at.size)
    spline = interpolate.CubicSpline(at, angle)
    slope = spline(at[[0, -1]], 1)
    inside = spline(np.clip(time, at[0], at[-1]))
    return np.asarray(inside + slope[0] * np.minimum(time - at[0], 0.0) + slope[1] * np.maximum(time - at[-1], 0.0))


def _edges(level: Real, middle: float, quarter: float) -> NDArray[np.int64]:
    """Return the last sample before each passage of the middle that follows one below the quarter."""
    state = np.where(level >= middle, 1, np.where(level <= quarter, -1, 0))
    known = np.flatnonzero(state)
    rising = known[1:][(state[known[1:]] == 1) & (state[known[:-1]] == -1)]
    return np.asarray(rising - 1, dtype=np.int64)
