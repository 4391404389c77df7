"""Compliances, coherence and the condition number of the forces, interactive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from smfe.reporting.content.results import BAD_CONDITION, Measurement
from smfe.reporting.content.style import CHATTER, Line, band_text, spoken, translucent
from smfe.reporting.content.tables import conditions_text
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.plotly_frame import (
    Figure,
    axis_look,
    base_layout,
    filled,
    log_axis,
    on_panel,
    packed,
    plain,
    scatter,
)
from smfe.reporting.figures.thinning import coded, thinned

CURVES = 60
"""So many curves are drawn as finely as a large figure resolves; more share the points."""

COLUMNS = (300, 1200)
"""Points over the width of the page, at least and at most."""

VIEWS = ("magnitude [µm/N]", "phase [°]", "real part [µm/N]", "imaginary part [µm/N]", "coherence [1]")
"""What the switch of the compliances offers."""


def compliance_figure(measurements: Sequence[Measurement], looks: Mapping[str, Line]) -> Figure:
    """Return the grid of compliances with a choice of magnitude, phase, real and imaginary part and coherence.

    Magnitude and phase are stored; the page makes the parts and the bands of uncertainty of them.
    """
    responses, excitations = figure_data.axes_of(measurements)
    span = figure_data.frequency_range(measurements)
    low, high = figure_data.magnitude_range(measurements, span)
    parts = figure_data.part_ranges(measurements, span)
    curves = sum(len(m.entries) for m in measurements)
    columns = int(np.clip(COLUMNS[1] * CURVES / max(curves, 1), *COLUMNS))
    ranges = (float(np.log10(high / low)), float(np.ptp(parts[0] + parts[1])), 370.0)
    panels = {(r, e): 1 + i * len(excitations) + j for i, r in enumerate(responses) for j, e in enumerate(excitations)}
    data: list[Figure] = []
    views: list[list[Any]] = []
    for m in measurements:
        for first, (r, e) in enumerate(m.entries):
            shared = {**on_panel(panels[r, e]), "legendgroup": m.name}
            entry = _entry(m, (r, e), span, ranges, columns)
            if entry.std is not None:
                data.append(_band(entry, looks[m.name], 1e-2 * low, shared))
                views.append([])
            views.append(entry.views)
            data.append(_line(m, looks[m.name], entry, figure_data.entry_name(r, e), first == 0, shared))
    layout = _grid_layout(responses, excitations, span, (low, high))
    axes = _view_axes((low, high), parts)
    known = any(m.coherences(r) for m in measurements for r in responses)
    return {
        "data": data,
        "layout": layout,
        "views": _view_switch(views, list(panels.values()), axes if known else axes[:-1]),
        "panels": [
            {"name": figure_data.entry_name(r, e), "at": at, "axes": on_panel(at)} for (r, e), at in panels.items()
        ],
    }


@dataclass(frozen=True)
class _Entry:
    """Arrays of one entry as the page reads them; ``std`` is None where nothing is known of it."""

    x: dict[str, Any]
    views: list[dict[str, Any]]
    std: dict[str, Any] | None


def _entry(
    m: Measurement, pair: tuple[str, str], span: tuple[float, float], ranges: Sequence[float], columns: int
) -> _Entry:
    """Return the points of one entry that a screen resolves [µm/N, degrees]."""
    values, std = m.entry(*pair), m.std(*pair)
    coherence = next((c for e, c in m.coherences(pair[0]) if e in ("", pair[1])), None)
    also = [] if coherence is None else [(coherence, 0.01)]
    if std is not None:
        with np.errstate(divide="ignore"):
            also.append((np.log10(std), np.log10(1.05)))
    scaled = 1e6 * values
    kept = thinned(m.frequency, scaled, span, ranges, columns, also)
    frequency = m.frequency[kept]
    # 16 bits are enough where their steps are finer than those of the data.
    fine = float(np.ptp(frequency)) < 1e4 * float(np.median(np.diff(m.frequency))) if frequency.size > 1 else False
    x = coded(frequency) if fine else packed(frequency)
    size = coded(np.abs(scaled[kept]), logarithmic=True)
    phase = coded(figure_data.lagging_phase(values[kept]))
    made = [{"derive": name, "of": [size, phase]} for name in ("real", "imaginary")]
    quality = coded(np.full(1, np.nan) if coherence is None else coherence[kept])
    return _Entry(x, [size, phase, *made, quality], None if std is None else coded(1e6 * std[kept], logarithmic=True))


def _band(entry: _Entry, look: Line, floor: float, shared: Mapping[str, Any]) -> Figure:
    """Return the magnitude ∓ two standard deviations as the page makes it."""
    size = entry.views[0]
    return {
        **filled((np.empty(0), np.empty(0)), look.colour, 0.2, shared),
        "x": {"derive": "band_x", "of": [entry.x, size, entry.std]},
        "y": {"derive": "band_y", "of": [size, entry.std, floor]},
    }


def _line(m: Measurement, look: Line, entry: _Entry, name: str, in_legend: bool, shared: Mapping[str, Any]) -> Figure:
    said = conditions_text({key: value for key, value in m.conditions.items() if key != "feed_per_tooth"})
    return {
        "type": "scatter",
        "mode": "lines",
        "x": entry.x,
        "y": entry.views[0],
        "name": plain(spoken(m.name) + (f" ({said})" if said else "")),
        "showlegend": in_legend,
        "line": {"width": 1.5, "color": look.colour, "dash": look.dash},
        "hovertemplate": f"{name}: %{{x:.5~g}} Hz, %{{y:.4~g}}",
        **shared,
    }


def _grid_layout(
    responses: Sequence[str],
    excitations: Sequence[str],
    span: tuple[float, float],
    magnitude: tuple[float, float],
) -> Figure:
    """Return panels that zoom together, tick labels only at the edges of the grid."""
    rows, columns = len(responses), len(excitations)
    layout = base_layout(
        40 + 250 * rows if rows > 1 else 420, margin={"l": 80, "r": 20, "t": 12, "b": 50}, annotations=[]
    )
    gap_x, gap_y = 0.025, 0.035
    for i, r in enumerate(responses):
        for j, e in enumerate(excitations):
            panel = 1 + i * columns + j
            tail = "" if panel == 1 else str(panel)
            wide, tall = (1 - gap_x * (columns - 1)) / columns, (1 - gap_y * (rows - 1)) / rows
            x0, y0 = j * (wide + gap_x), 1 - (i + 1) * tall - i * gap_y
            bottom, left = i == rows - 1, j == 0
            linked = {} if panel == 1 else {"matches": "x"}
            layout[f"xaxis{tail}"] = axis_look(
                "frequency [Hz]" if bottom else "",
                **{
                    "domain": [x0, x0 + wide],
                    "anchor": f"y{tail}",
                    "range": list(span),
                    "showticklabels": bottom,
                },
                **linked,
            )
            layout[f"yaxis{tail}"] = axis_look(
                "magnitude [µm/N]" if left else "",
                **{
                    "domain": [y0, y0 + tall],
                    "anchor": f"x{tail}",
                    "showticklabels": left,
                },
                **log_axis(*magnitude),
                **({} if panel == 1 else {"matches": "y"}),
            )
            note = _corner(f"Φ<sub>{plain(figure_data.entry_name(r, e))}</sub>", x0 + wide, y0 + tall)
            layout["annotations"].append({**note, "entry": figure_data.entry_name(r, e), "captureevents": True})
    return layout


def _corner(text: str, x: float, y: float) -> Figure:
    place = {
        "x": x,
        "y": y,
        "xref": "paper",
        "yref": "paper",
        "xanchor": "right",
        "yanchor": "top",
        "xshift": -4,
    }
    return {**place, "text": text, "showarrow": False, "yshift": -3, "bgcolor": "rgba(255,255,255,0.75)"}


def _view_axes(
    magnitude: tuple[float, float], parts: tuple[list[float], list[float]]
) -> list[tuple[str, dict[str, Any]]]:
    """Return title and settings of the vertical axes in each view."""
    log = {**log_axis(*magnitude), "autorange": False}
    turn = {"type": "linear", "range": [-275.0, 95.0], "dtick": 90, "autorange": False}
    free = {"type": "linear", "dtick": None, "autorange": False}
    parted = [{**free, "range": part} for part in parts]
    return list(zip(VIEWS, (log, turn, *parted, {**free, "range": [-0.02, 1.05]}), strict=True))


def _view_switch(
    views: Sequence[Sequence[Any]], panels: Sequence[int], axes: Sequence[tuple[str, Mapping[str, Any]]]
) -> list[dict[str, Any]]:
    """Return what report.js makes of a click on each view; bands belong to the magnitude and hide in the others."""
    lines = [k for k, v in enumerate(views) if v]
    fills = [k for k, v in enumerate(views) if not v]
    names = [f"yaxis{'' if p == 1 else p}" for p in panels]
    return [
        {
            "label": title.partition(" [")[0],
            "lines": lines,
            "fills": fills,
            "y": [views[k][number_] for k in lines],
            "band": number_ == 0,
            "title": title,
            "layout": {f"{name}.{key}": value for name in names for key, value in settings.items()},
        }
        for number_, (title, settings) in enumerate(axes)
    ]


def condition_figure(measurements: Sequence[Measurement], looks: Mapping[str, Line]) -> Figure | None:
    """Return the condition number of the forces of each sweep, what is badly conditioned shaded; None without one."""
    conditioned = figure_data.quality_panels(measurements)[2]
    if not conditioned:
        return None
    span = figure_data.frequency_range([m for m in measurements if not m.is_model])
    numbers = [(m, c) for m in conditioned if (c := m.condition()) is not None]
    highest = max(float(c[np.isfinite(c)].max(initial=1.0)) for _, c in numbers)
    data = [
        {
            **scatter("lines", m.frequency, values),
            "name": plain(spoken(m.name)),
            "legendgroup": m.name,
            "line": {"width": 1.5, "color": looks[m.name].colour, "dash": looks[m.name].dash},
            "hovertemplate": "%{x:.5~g} Hz: %{y:.3~g}",
        }
        for m, values in numbers
    ]
    layout = base_layout(
        280,
        xaxis=axis_look("frequency [Hz]", range=list(span)),
        yaxis=axis_look("condition number [1]", **log_axis(1.0, max(1.5 * highest, 2.0 * BAD_CONDITION))),
        shapes=[],
    )
    on = {"xref": "x", "yref": "paper", "y0": 0, "y1": 1, "layer": "below", "line": {"width": 0}}
    for m, _ in numbers:
        for low, high in figure_data.badly_conditioned(m):
            shade = {"type": "rect", "x0": low, "x1": high, "fillcolor": translucent(CHATTER, 0.18)}
            layout["shapes"].append({**shade, **on})
    limit = {"type": "line", "x0": 0, "x1": 1, "xref": "paper", "y0": BAD_CONDITION, "y1": BAD_CONDITION}
    layout["shapes"].append({**limit, "line": {"color": CHATTER, "width": 1.2, "dash": "dash"}})
    return {"data": data, "layout": layout}


def bad_bands_text(m: Measurement) -> str:
    """Return a sentence on the badly conditioned bands of a sweep."""
    found = m.bad_bands()
    if not found:
        return f"the condition number of the forces stays below {BAD_CONDITION:g} at every frequency."
    what = f"the condition number of the forces exceeds {BAD_CONDITION:g} (badly conditioned)"
    return f"{what} at {band_text(found)}."
