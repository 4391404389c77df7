"""Drives: inertia and friction with their figures."""

from __future__ import annotations

from typing import Any

from smfe.reporting.content.tables import table
from smfe.reporting.figures.figure_data import frictions, open_loop_marks, open_loops
from smfe.reporting.figures.plotly_drives import drive_figure, open_loop_figure
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return one block an axis."""
    found = draft.results.drives
    if found is None:
        return {}
    drawn, out = frictions(draft.results.tables), []
    opened = open_loops(draft.results.open_loops)
    keys = found[["measurement", "axis"]].drop_duplicates().astype(str).to_numpy().tolist()
    for position, (name, axis) in enumerate(keys, 1):
        rows = found[(found["measurement"] == name) & (found["axis"] == axis)]
        shown = rows.drop(columns=["measurement", "axis", "std"], errors="ignore")
        shown = shown.rename(columns={"low": "95 % from", "high": "to"}).fillna({"note": ""})
        plot, what = None, "drive force over velocity"
        if (name, axis) in drawn:
            plot = f"plot-drive-{position}"
            draft.plots[plot] = drive_figure(drawn[name, axis])
        if name in opened:
            plot, what = f"plot-drive-{position}", "open loop: carriage over drive force"
            draft.plots[plot] = open_loop_figure(opened[name], open_loop_marks(draft.results.open_loops, name))
        out.append({"name": f"{name}, axis {axis}", "table": table(shown), "plot": plot, "what": what})
    return {"axes": out}
