"""Stability lobes: a diagram for each request."""

from __future__ import annotations

from typing import Any

import numpy as np

from smfe.reporting.content.results import Lobes, bands
from smfe.reporting.content.style import band_text
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.plotly_lobes import lobes_figure
from smfe.reporting.sections.answer import cut_text
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return the diagrams."""
    results, out = draft.results, []
    for position, (request, lobes) in enumerate(results.requests.items(), 1):
        tests = figure_data.tests_of(results.chatter, request)
        name = f"plot-lobes-{position}"
        draft.plots[name] = lobes_figure(lobes, tests, draft.looks)
        out.append(
            {
                "request": request,
                "cut": cut_text(results, request),
                "plot": name,
                "tests": 0 if tests is None else len(tests),
                "band": next((b[2] for item in lobes if (b := item.band()) is not None), ""),
                "unlimited": [(item.source, _unlimited(item)) for item in lobes if _unlimited(item)],
            }
        )
    return {"requests": out, "failures": draft.failures("lobes")}


def _unlimited(item: Lobes) -> str:
    """Return the speeds without a limit, "" when there are none."""
    speed = item.data["spindle_speed"].values.astype(float)
    pairs = bands(speed, np.isinf(item.values("limit_depth")))
    return band_text(pairs).removesuffix(" Hz") + " rpm" if pairs else ""
