"""The channels of a drive record that belong to one axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from process.errors import InputError
from smfe.diagnosis.drive_signals import Real


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
        time = np.asarray(record["time"].values, dtype=float)
        step = float(np.mean(np.diff(time)))
        if np.max(np.abs(np.diff(time) - step)) > 0.01 * step:
            raise InputError("the samples of the record are not evenly spaced in time; resample them first")
        return cls(step, channels["encoder_position"], channels["drive_force"], channels.get("reference_position"))
