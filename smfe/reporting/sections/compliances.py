"""Compliances: who measured what, the matrix of curves, coherence, conditions."""

from __future__ import annotations

from typing import Any

import numpy as np

from smfe.reporting.content import conditions
from smfe.reporting.content.results import Measurement, Results
from smfe.reporting.content.style import METHODS, Line, number
from smfe.reporting.figures.plotly_compliances import bad_bands_text, compliance_figure, quality_figure
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return the measurements and their compliances."""
    results, looks, plots = draft.results, draft.looks, draft.plots
    shown = [m for m in results.measurements if m.entries]
    if shown:
        plots["plot-compliance"] = compliance_figure(shown, looks)
        quality = quality_figure(shown, looks)
        if quality is not None:
            plots["plot-quality"] = quality
    return {
        "rows": [_measurement_row(m, looks[m.name]) for m in results.measurements],
        "any": bool(shown),
        "quality": "plot-quality" in plots,
        "by_force": any(e for m in shown for r in "xyz" for e, _ in m.coherences(r)),
        "cubes": _cubes(results, plots),
        "uncertain": any(m.std(*pair) is not None for m in shown for pair in m.entries),
        "failures": draft.failures("compliances"),
        "conditions": [(m.name, bad_bands_text(m)) for m in shown if m.condition() is not None],
    }


def _cubes(results: Results, plots: dict[str, Any]) -> list[dict[str, Any]]:
    """Return name, figure and sentences of each set of compliances over level and feed."""
    out = []
    for position, cube in enumerate(conditions.cubes(results.conditions), 1):
        name = f"plot-cube-{position}"
        plots[name] = compliance_figure(cube.cells, cube.looks)
        out.append({"name": cube.name, "plot": name, "said": conditions.largest_changes(cube)})
    return out


def _measurement_row(m: Measurement, look: Line) -> dict[str, Any]:
    claimed = m.frequency[m.claimed()]
    coherence = [v[np.isfinite(v)] for r in "xyz" for _, v in m.coherences(r)]
    return {
        "name": m.name,
        "look": look,
        "method": METHODS.get(m.method, m.method) or "–",
        "conditions": ", ".join(f"{k.replace('_', ' ')}: {v}" for k, v in m.conditions.items()),
        "band": f"{number(claimed[0])}–{number(claimed[-1])}" if claimed.size else "–",
        "entries": " ".join(r + e for r, e in m.entries) or "none",
        "coherence": float(np.median(np.concatenate(coherence))) if coherence else float("nan"),
        "warnings": len(m.warnings),
    }
