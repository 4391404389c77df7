"""The channels of a drive record that belong to one axis, and whether they can be those of an axis at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from process.errors import InputError
from smfe.diagnosis.drive_signals import Real

_UNITS = {"encoder_position": "m", "drive_force": "N"}

INERTIAL = 0.3
"""Least share of inertia in the drive force that says what mass is moved: the rest may be friction of any kind."""

FACTOR = 10.0
"""Mass that the force moves over the mass that is known, or the inverse, that no error of either explains."""

RECEIVED = 0.3
"""Share of its work that an axis gives back at the most: four moves that end in rest give back an eighth."""


@dataclass(frozen=True)
class Channels:
    """Channels of one axis: sample interval [s], encoder [m], drive force [N], reference position [m]."""

    step: float
    position: Real
    force: Real
    reference: Real | None

    @classmethod
    def read(cls, record: xr.Dataset, axis: str) -> Channels:
        """Read them from a record; refuse what is missing, not finite or not evenly spaced in time."""
        channels: dict[str, Real] = {}
        for channel in ("encoder_position", "drive_force", "reference_position"):
            if channel in record and axis in record[channel]["axis"].values:
                values = np.asarray(record[channel].sel(axis=axis).values, dtype=float)
                if np.all(np.isfinite(values)):
                    channels[channel] = values
        for needed in ("encoder_position", "drive_force"):
            if needed not in channels:
                raise InputError(f"the record has no {needed}_{axis}; a drive record needs it, with all its samples")
            if np.ptp(channels[needed]) == 0.0:
                raise InputError(
                    f"{needed}_{axis} is {channels[needed][0]:g} {_UNITS[needed]} in all samples; a drive record needs "
                    "an axis that moves: check the column, or take a record of moves"
                )
        time = np.asarray(record["time"].values, dtype=float)
        step = float(np.mean(np.diff(time)))
        if np.max(np.abs(np.diff(time) - step)) > 0.01 * step:
            raise InputError("the samples of the record are not evenly spaced in time; resample them first")
        return cls(step, channels["encoder_position"], channels["drive_force"], channels.get("reference_position"))


def check_balance(force: Real, acceleration: Real, velocity: Real, mass: float | None) -> None:
    """Refuse force and motion that cannot be those of an axis: a sign or a unit is wrong.

    Least squares of ``F = M x'' + sigma x' + F0`` says what mass is moved, wherever inertia is a good part of the
    force. And an axis takes up energy: over a closed path, ``int (F - F0) x' dt >= 0`` but for the kinetic energy at
    its beginning.

    Parameters
    ----------
    force, acceleration, velocity : ndarray, shape (n,)
        Drive force [N], and motion [m/s2], [m/s], in the same band.
    mass : float or None
        Moved mass [kg], if it is known.

    Raises
    ------
    InputError
        When the mass is negative, or beyond a factor of ten of the known one, or the axis gives out energy.
    """
    columns = np.stack([acceleration, velocity, np.ones_like(velocity)], axis=1)
    moved = float(np.linalg.lstsq(columns, force, rcond=None)[0][0])
    work = force * (velocity - np.mean(velocity))
    share = max(abs(moved), mass or 0.0) * float(np.std(acceleration) / np.std(force))
    if (mass is None and not moved > 0.0) or (share > INERTIAL and moved < 0.0):
        raise InputError(
            f"the force accelerates a mass of {moved:.4g} kg; check the sign of drive force and encoder, or move faster"
        )
    if float(np.sum(work)) < -RECEIVED * float(np.sum(np.abs(work))):
        raise InputError(
            "the axis gives out energy while it moves: drive force and motion point against each other; check the sign "
            "of drive force and encoder"
        )
    if mass is not None and share > INERTIAL and not mass / FACTOR < moved < mass * FACTOR:
        raise InputError(
            f"the force accelerates a mass of {moved:.4g} kg, but the moving mass is given as {mass:g} kg; check the "
            "unit and scale of drive force and encoder, or the mass"
        )
