"""Compliances: the matrix of curves with its uncertainty and coherence, and the condition of the forces of sweeps."""

from __future__ import annotations

from typing import Any

from smfe.reporting.content import conditions
from smfe.reporting.content.style import spoken
from smfe.reporting.figures.plotly_compliances import bad_bands_text, compliance_figure, condition_figure
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return the compliances. Nothing without an entry that is claimed at any frequency."""
    results, looks, plots = draft.results, draft.looks, draft.plots
    shown = [m for m in results.measurements if m.entries]
    if not shown:
        return {}
    plots["plot-compliance"] = compliance_figure(shown, looks)
    condition = condition_figure(shown, looks)
    if condition is not None:
        plots["plot-condition"] = condition
    return {
        "tip": all(len(r + e) == 2 for m in shown for r, e in m.entries),
        "entries": len({pair for m in shown for pair in m.entries}),
        "condition": condition is not None,
        "coherence": any(m.coherences(r) for m in shown for r in "xyz"),
        "uncertain": any(m.std(*pair) is not None for m in shown for pair in m.entries),
        "cubes": _cubes(draft),
        "badly": [(spoken(m.name), bad_bands_text(m)) for m in shown if m.condition() is not None],
    }


def _cubes(draft: Draft) -> list[dict[str, Any]]:
    """Return name, figure and sentences of each set of compliances over level and feed."""
    out = []
    for position, cube in enumerate(conditions.cubes(draft.results.conditions), 1):
        name = f"plot-cube-{position}"
        draft.plots[name] = compliance_figure(cube.cells, cube.looks)
        out.append({"name": spoken(cube.name), "plot": name, "said": conditions.largest_changes(cube)})
    return out
