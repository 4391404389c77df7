"""The answer: how deep, at which speed, how sure."""

from __future__ import annotations

from typing import Any

import numpy as np

from smfe.reporting.content.headline import KEEP, Answer, answers
from smfe.reporting.content.results import Results
from smfe.reporting.content.style import number
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return what the top of the page says, one block a request."""
    results = draft.results
    blocks: dict[str, list[Answer]] = {}
    for item in answers(results):
        blocks.setdefault(item.request, []).append(item)
    return {
        "blocks": [
            {
                "request": request,
                "cut": cut_text(results, request),
                "answers": found,
                "spread": _spread(found),
                "sure": any(np.isfinite([p.low, p.safe]).any() for a in found for p in a.pockets),
                "edge": any(p.at_edge for a in found for p in a.pockets),
            }
            for request, found in blocks.items()
        ],
        "warnings": results.warnings,
        "failed": [f"{f.part} {f.name}".strip() for f in results.failures],
        "failures": draft.failures("other"),
        "lobes_failed": bool(draft.failures("lobes")),
        "finding": results.finding,
        "keep": round(100 * KEEP),
    }


def cut_text(results: Results, request: str) -> str:
    """Return e.g. "down milling, width of cut 100 mm, feed per tooth 0.2 mm, zero order"."""
    attrs = next(item.data.attrs for item in results.lobes if item.request == request)
    parts = [f"{attrs['cut']} milling"] if attrs.get("cut") else []
    for key, what in (("width_of_cut_mm", "width of cut"), ("feed_per_tooth_mm", "feed per tooth")):
        if key in attrs:
            parts.append(f"{what} {number(float(attrs[key]))} mm")
    if attrs.get("method"):
        parts.append(f"{str(attrs['method']).replace('_', '-')} method")
    return ", ".join(parts)


def _spread(found: list[Answer]) -> float | None:
    """Return the largest over the smallest of the sources' smallest limit depths, None for one source."""
    depths = [a.smallest for a in found if np.isfinite(a.smallest)]
    return max(depths) / min(depths) if len(depths) > 1 and min(depths) > 0.0 else None
