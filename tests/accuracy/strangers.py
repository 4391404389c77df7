"""From the records of `truth.sweep_strangers` to passes of a sweep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import xarray as xr
from truth.sweep_strangers import CUTS, DrawnSweep

from process import engagement
from process.labels import make_record
from smfe import SweepPass


def labelled(raw: dict[str, Any]) -> xr.Dataset:
    """Label one record."""
    channels = {name: dict(zip("xyz", raw[name], strict=True)) for name in ("force", "acceleration")}
    record = make_record(raw["time"], channels)
    if "speed" in raw:
        record["spindle_speed"] = ("time", raw["speed"], {"units": "rpm"})
    if "angle" in raw:
        record["spindle_angle"] = ("time", raw["angle"], {"units": "rad"})
    if "tacho" in raw:
        record["tacho"] = ("time", raw["tacho"], {"pulses_per_revolution": 1.0})
    return record


def stranger_passes(this: DrawnSweep, records: Sequence[dict[str, Any]], stated: bool = False) -> list[SweepPass]:
    """Return the passes, with the speeds that a user would state where asked for."""
    width = dict(zip(CUTS, this.widths, strict=True))
    return [
        SweepPass(
            labelled(r),
            r["cut"],
            engagement(r["cut"], width[r["cut"]], this.diameter),
            tuple(v * math.pi / 30.0 for v in r["stated"]) if stated else None,
        )
        for r in records
    ]
