"""Stretches of constant velocity in the records of a drive (`smfe.identification.drive.friction.friction_runs`)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import pandas as pd
from scipy import stats

from process.errors import InputError
from process.labels import make_record
from smfe.identification.drive.friction import friction_runs
from smfe.identification.drive.motion import Trace
from smfe.identification.drive.results import LEVEL


def steady_points(traces: Sequence[Trace], inertia: float) -> pd.DataFrame:
    """Return a row a stretch of constant velocity: velocity, mean force without inertia, 95 % interval of it."""
    reach = float(stats.norm.ppf(0.5 + 0.5 * LEVEL))
    rows = []
    for t in traces:
        place = t.motion
        if t.is_velocity:
            place = np.concatenate([[0.0], np.cumsum(0.5 * (t.motion[1:] + t.motion[:-1])) * t.step])
        record = make_record(
            t.step * np.arange(t.force.size), {"encoder_position": {"x": place}, "drive_force": {"x": t.force}}
        )
        with suppress(InputError):
            for _, run in friction_runs(record, "x").to_dataframe().iterrows():
                force = run["force"] - inertia * run["acceleration"]
                rows.append(
                    (run["velocity"], force, force - reach * run["force_std"], force + reach * run["force_std"])
                )
    return pd.DataFrame(rows, columns=["velocity", "force", "low", "high"])
