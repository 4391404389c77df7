"""Responses of drive loops."""

from __future__ import annotations

import json
from typing import Any

from smfe.reporting.figures.plotly_drives import loop_figure
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return one block a measurement."""
    out = []
    for position, (name, dataset) in enumerate(draft.results.loops.items(), 1):
        draft.plots[f"plot-loop-{position}"] = loop_figure(dataset)
        said = json.loads(dataset.attrs.get("summary", "[]"))
        out.append({"name": name, "plot": f"plot-loop-{position}", "said": said, "loop": dataset.attrs.get("loop", "")})
    return {"loops": out} if out else {}
