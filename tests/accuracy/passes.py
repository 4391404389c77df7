"""From the records of the independent generator to passes of a sweep, and how far an estimate is from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from truth.sweep import Campaign

from process import engagement
from process.labels import make_record
from smfe import SweepPass

BAND = (20.0, 80.0)


def labelled(raw: dict[str, Any]) -> xr.Dataset:
    """Label one record."""
    channels = {name: dict(zip("xyz", raw[name], strict=True)) for name in ("force", "acceleration")}
    record = make_record(raw["time"], channels)
    if "angle" in raw:
        record["spindle_angle"] = ("time", raw["angle"])
    else:
        record["tacho"] = ("time", raw["tacho"], {"pulses_per_revolution": 1.0})
    return record


def sweep_passes(records: Sequence[dict[str, Any]], campaign: Campaign) -> list[SweepPass]:
    """Return the passes; the arcs are those that a user would write down."""
    widths = dict(zip(("down", "up", "central"), campaign.widths, strict=True))
    return [
        SweepPass(labelled(r), r["cut"], engagement(r["cut"], widths[r["cut"]], campaign.diameter))
        if r["cut"] in widths
        else SweepPass(labelled(r), r["cut"])
        for r in records
    ]


def entry_errors(compliance: xr.Dataset, campaign: Campaign, own: bool = True) -> np.ndarray:
    """Rms error of the nine entries over the rms of the entry itself (`own`), or of the whole compliance."""
    truth = campaign.modes.compliance(compliance["frequency"].values)
    error = np.abs(compliance["compliance"].values - truth) ** 2
    size = np.mean(np.abs(truth) ** 2, axis=0 if own else None)
    return np.sqrt(np.nanmean(error, axis=0) / size).ravel()
