"""The answer: how deep, at which speed, how sure; and the lobe diagram that it is read from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from smfe.reporting.content import advice
from smfe.reporting.content.audit import audit
from smfe.reporting.content.merging import sentence
from smfe.reporting.content.results import Lobes
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.lobe_data import SAFE
from smfe.reporting.figures.plotly_lobes import lobes_figure
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return what the first screen says, one block a request, the recommended one first."""
    results = draft.results
    best = str(results.best.get("lobes", next(iter(results.requests), "")))
    # What is taken for granted stands with the recommendation.
    assumed = {sentence(str(a)) for found in results.advice.values() for a in found["assumptions"]}
    warnings = [said for said in audit(results).said if said.whole not in assumed]
    # As in the terminal, what is said of the recommended source comes first.
    source = str(results.best.get("source", ""))
    warnings.sort(key=lambda said: not any(where.split()[-1] == source for where in said.where if where))
    order = sorted(results.requests.items(), key=lambda item: item[0] != best)
    return {
        "attributes": advice.attributes(results.best),
        "blocks": [_block(draft, request, lobes) for request, lobes in order],
        "warnings": warnings,
        "failed": [f"{f.part} {f.name}".strip() for f in results.failures],
        "failures": draft.failures("other"),
        "lobes_failed": bool(draft.failures("lobes")),
    }


def _block(draft: Draft, request: str, lobes: Sequence[Lobes]) -> dict[str, Any]:
    results = draft.results
    tests = figure_data.tests_of(results.chatter, request)
    found = results.advice.get(request)
    name = f"plot-lobes-{list(results.requests).index(request) + 1}"
    draft.plots[name] = lobes_figure(lobes, tests, draft.looks, found)
    return {
        "request": request,
        "cut": advice.cut_name(results, request),
        "advice": found,
        "headline": advice.headline(found) if found else "",
        "tiles": advice.tiles(found) if found else [],
        "details": advice.details(found) if found else [],
        "plot": name,
        "tests": tests is not None,
        "safe": any(t.get("name") == SAFE for t in draft.plots[name]["data"]),
    }
