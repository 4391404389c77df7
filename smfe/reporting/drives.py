"""Inertia and friction of drives: a table a measurement, and force over velocity with the friction curve."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure as Picture

from smfe.reporting.draw_plotly import LEGEND, axis_look, base_layout, packed
from smfe.reporting.style import translucent
from smfe.reporting.tables import table

_RECORD, _CURVE, _RUNS = "#9A9A9A", "#0072B2", "#E69F00"
_PREFIX = "friction_"

Tables = Mapping[tuple[str, str], pd.DataFrame]


def is_friction(kind: str) -> bool:
    """Return whether a table of the results is friction over velocity."""
    return kind.startswith(_PREFIX)


def frictions(tables: Tables) -> dict[tuple[str, str], pd.DataFrame]:
    """Return (measurement, axis) -> friction over velocity, from all tables of the results."""
    return {(name, kind[len(_PREFIX) :]): frame for (name, kind), frame in tables.items() if is_friction(kind)}


def _titles(frame: pd.DataFrame) -> tuple[str, str]:
    """Return the names of velocity and force with their units."""
    velocity, force = (next(str(c) for c in frame.columns if str(c).startswith(n)) for n in ("velocity", "force"))
    return velocity, force.replace("force", "drive force without inertia")


def _parts(frame: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return motion, steady runs, and the curve of each way, with plain column names."""
    plain = frame.rename(columns={c: str(c).split(" [")[0] for c in frame.columns})
    curve = plain[plain["kind"] == "curve"].sort_values("velocity")
    return {
        "motion": plain[plain["kind"] == "motion"],
        "runs": plain[plain["kind"] == "steady run"],
        "forward": curve[curve["velocity"] > 0.0],
        "backward": curve[curve["velocity"] < 0.0],
    }


def figure(frame: pd.DataFrame) -> dict[str, Any]:
    """Return the interactive figure of one axis."""
    parts = _parts(frame)
    data: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "mode": "markers",
            "x": packed(parts["motion"]["velocity"].to_numpy()),
            "y": packed(parts["motion"]["force"].to_numpy()),
            "name": "record",
            "marker": {"size": 3, "color": _RECORD},
        }
    ]
    for way in ("forward", "backward"):
        curve = parts[way]
        if curve.empty:
            continue
        around = np.concatenate([curve["velocity"], curve["velocity"][::-1]])
        band = np.concatenate([curve["high"], curve["low"][::-1]])
        shared = {"type": "scatter", "mode": "lines", "legendgroup": "curve", "hovertemplate": "%{x:.4~g}: %{y:.4~g}"}
        data += [
            shared
            | {
                "x": packed(around),
                "y": packed(band),
                "fill": "toself",
                "line": {"width": 0},
                "fillcolor": translucent(_CURVE, 0.2),
                "showlegend": False,
                "hoverinfo": "skip",
            },
            shared
            | {
                "x": packed(curve["velocity"].to_numpy()),
                "y": packed(curve["force"].to_numpy()),
                "name": "identified, with 95 % interval",
                "line": {"width": 2, "color": _CURVE},
                "showlegend": way == "forward" or parts["forward"].empty,
            },
        ]
    runs = parts["runs"]
    if len(runs):
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": packed(runs["velocity"].to_numpy()),
                "y": packed(runs["force"].to_numpy()),
                "error_y": {"type": "data", "array": packed((runs["high"] - runs["force"]).to_numpy())},
                "name": "runs at constant velocity",
                "marker": {"size": 7, "color": _RUNS},
            }
        )
    velocity, force = _titles(frame)
    layout = base_layout(420, legend={**LEGEND, "y": 1.02, "yanchor": "bottom"})
    return {"data": data, "layout": layout | {"xaxis": axis_look(velocity), "yaxis": axis_look(force)}}


def draw(frame: pd.DataFrame) -> Picture:
    """Return the same as a picture."""
    parts = _parts(frame)
    picture = Picture(figsize=(6.0, 4.2), dpi=150, layout="constrained")
    axes = picture.subplots()
    axes.plot(parts["motion"]["velocity"], parts["motion"]["force"], ".", color=_RECORD, markersize=2, label="record")
    label = "identified, with 95 % interval"
    for way in ("forward", "backward"):
        curve = parts[way]
        if len(curve):
            axes.fill_between(curve["velocity"], curve["low"], curve["high"], color=_CURVE, alpha=0.2, linewidth=0.0)
            axes.plot(curve["velocity"], curve["force"], color=_CURVE, linewidth=1.5, label=label)
            label = "_"
    runs = parts["runs"]
    if len(runs):
        reach = (runs["high"] - runs["force"]).to_numpy()
        axes.errorbar(
            runs["velocity"],
            runs["force"],
            reach,
            fmt="o",
            color=_RUNS,
            markersize=4,
            label="runs at constant velocity",
        )
    velocity, force = _titles(frame)
    axes.set(xlabel=velocity, ylabel=force)
    axes.legend(frameon=False, fontsize=9)
    axes.grid(True, color="#dddddd", linewidth=0.5)
    return picture


def section(found: pd.DataFrame | None, tables: Tables, plots: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what the page shows, one block an axis; its figures are put into `plots`."""
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
            plots[plot] = figure(drawn[name, axis])
        out.append({"name": f"{name}, axis {axis}", "table": table(shown), "plot": plot})
    return out
