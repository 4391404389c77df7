"""Every source and pocket of the stability lobes, and the frequencies of chatter."""

from __future__ import annotations

from typing import Any

import numpy as np

from smfe.reporting.content import advice
from smfe.reporting.content.results import Lobes, bands
from smfe.reporting.content.style import band_text, spoken
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.plotly_lobes import chatter_figure
from smfe.reporting.maps.images import embedded, picture_name
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return tables and figures, one block a request."""
    results, out = draft.results, []
    best = results.best.get("lobes", next(iter(results.requests), ""))
    for position, (request, lobes) in enumerate(results.requests.items(), 1):
        found = results.advice.get(request)
        name = f"plot-chatter-{position}"
        figure = chatter_figure(lobes, figure_data.tests_of(results.chatter, request), draft.looks)
        if figure is not None:
            draft.plots[name] = figure
        out.append(
            {
                "request": request,
                "shown": request == best,
                "cut": advice.cut_name(results, request),
                "sources": advice.sources(results, lobes, found),
                "pockets": advice.pockets(results, request),
                "plot": "" if figure is None else name,
                "pictures": _pictures(draft, request, [item.source for item in lobes]),
                "unlimited": [(item.source, _unlimited(item)) for item in lobes if _unlimited(item)],
            }
        )
    failures = draft.failures("lobes")
    content = {"requests": out, "depths": advice.depths(results), "widths": _widths(draft), "failures": failures}
    return content if out or failures else {}


_PICTURES = {
    "bands": ("All bands of depth", "Unstable bands, and where the cut is stable again above its first limit."),
    "maps": (
        "Vibration, wall, force, torque and power over spindle speed and depth",
        "Of the cut without chatter; hatched: beyond the limit, where chatter overgrows it. Errors of a wall are "
        "positive where too much is cut.",
    ),
}
"""Kind of a picture -> its heading, what it shows."""


def _pictures(draft: Draft, request: str, sources: list[str]) -> list[dict[str, str]]:
    """Return the pictures of a request that the page holds as images."""
    out = []
    for kind, (title, said) in _PICTURES.items():
        for source in sources:
            image = embedded(draft.results.folder, picture_name(kind, request, source))
            if image:
                out.append({"title": f"{title}: {spoken(source)}", "image": image, "said": said})
    return out


def _widths(draft: Draft) -> list[dict[str, str]]:
    """Return the pictures of limits over width of cut and speed."""
    out = []
    for group in draft.results.widths:
        request, _, source = group.partition("/")
        image = embedded(draft.results.folder, picture_name("widths", request, source))
        if image:
            title = f"Limit depth and removal rate over spindle speed and width of cut: {spoken(source)}"
            out.append({"title": title, "image": image, "said": "Each at the limit depth of its width."})
    return out


def _unlimited(item: Lobes) -> str:
    """Return the speeds without a limit, "" when there are none."""
    speed = item.data["spindle_speed"].values.astype(float)
    pairs = bands(speed, np.isinf(item.values("limit_depth")))
    return band_text(pairs).removesuffix(" Hz") + " rpm" if pairs else ""
