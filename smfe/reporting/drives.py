"""Sections of the page on drives: inertia and friction with their figures, and the responses of drive loops."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import pandas as pd
import xarray as xr

from smfe.reporting.draw_plotly import drive_figure, loop_figure
from smfe.reporting.figures import Tables, frictions
from smfe.reporting.tables import table


def friction_section(found: pd.DataFrame | None, tables: Tables, plots: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the section of the page, one block an axis; its figures are put into `plots`."""
    if found is None:
        return []
    drawn, out = frictions(tables), []
    keys = found[["measurement", "axis"]].drop_duplicates().astype(str).to_numpy().tolist()
    for position, (name, axis) in enumerate(keys, 1):
        rows = found[(found["measurement"] == name) & (found["axis"] == axis)]
        shown = rows.drop(columns=["measurement", "axis", "std"], errors="ignore")
        shown = shown.rename(columns={"low": "95 % from", "high": "to"}).fillna({"note": ""})
        plot = None
        if (name, axis) in drawn:
            plot = f"plot-drive-{position}"
            plots[plot] = drive_figure(drawn[name, axis])
        out.append({"name": f"{name}, axis {axis}", "table": table(shown), "plot": plot})
    return out


def loop_section(loops: Mapping[str, xr.Dataset], plots: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the section of the page, one block a measurement; its figures are put into `plots`."""
    out = []
    for position, (name, dataset) in enumerate(loops.items(), 1):
        plots[f"plot-loop-{position}"] = loop_figure(dataset)
        said = json.loads(dataset.attrs.get("summary", "[]"))
        out.append({"name": name, "plot": f"plot-loop-{position}", "said": said, "loop": dataset.attrs.get("loop", "")})
    return out
