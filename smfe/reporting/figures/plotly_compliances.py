"""Compliances, coherence and the condition number of the forces, interactive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from process.types import Complex, Real
from smfe.reporting.content.results import BAD_CONDITION, Measurement
from smfe.reporting.content.style import CHATTER, EXCITATION_DASHES, Line, band_text, translucent
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
    polygons,
    scatter,
)


def compliance_figure(measurements: Sequence[Measurement], looks: Mapping[str, Line]) -> Figure:
    """Return the grid of compliances with a choice of magnitude, phase, real and imaginary part."""
    responses, excitations = figure_data.axes_of(measurements)
    span = figure_data.frequency_range(measurements)
    low, high = figure_data.magnitude_range(measurements, span)
    panels = {(r, e): 1 + i * len(excitations) + j for i, r in enumerate(responses) for j, e in enumerate(excitations)}
    data: list[Figure] = []
    views: list[list[Any]] = []
    for m in measurements:
        for first, (r, e) in enumerate(m.entries):
            shared = {**on_panel(panels[r, e]), "legendgroup": m.name}
            std = m.std(r, e)
            if std is not None:
                edges = figure_data.magnitude_band(m.entry(r, e), std, 1e-2 * low)
                data.append(filled(polygons(m.frequency, *edges), looks[m.name].colour, 0.2, shared))
                views.append([])
            views.append(_views(m.entry(r, e)))
            data.append(
                _compliance_line(m, looks[m.name], views[-1][0], figure_data.entry_name(r, e), first == 0, shared)
            )
    layout = _grid_layout(responses, excitations, span, (low, high))
    axes = _view_axes((low, high), figure_data.part_ranges(measurements, span))
    return {"data": data, "layout": layout, "views": _view_switch(views, list(panels.values()), axes)}


def _views(values: Complex) -> list[dict[str, str]]:
    scaled = 1e6 * values
    return [packed(np.abs(scaled)), packed(figure_data.lagging_phase(values)), packed(scaled.real), packed(scaled.imag)]


def _compliance_line(
    m: Measurement, look: Line, y: dict[str, str], entry: str, in_legend: bool, shared: Mapping[str, Any]
) -> Figure:
    return {
        "type": "scatter",
        "mode": "lines",
        "x": packed(m.frequency),
        "y": y,
        "name": plain(m.name),
        "showlegend": in_legend,
        "line": {"width": 1.5, "color": look.colour, "dash": look.dash},
        "hovertemplate": f"{entry}: %{{x:.5~g}} Hz, %{{y:.4~g}}",
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
            layout["annotations"].append(_corner(f"Φ<sub>{r}{e}</sub>", x0 + wide, y0 + tall))
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
    return [
        ("magnitude [µm/N]", log),
        ("phase [°]", turn),
        ("real part [µm/N]", {**free, "range": parts[0]}),
        ("imaginary part [µm/N]", {**free, "range": parts[1]}),
    ]


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


def quality_figure(measurements: Sequence[Measurement], looks: Mapping[str, Line]) -> Figure | None:
    """Return coherence by response and, for sweeps, the condition of the forces; None without either."""
    measured, responses, conditioned = figure_data.quality_panels(measurements)
    if not responses and not conditioned:
        return None
    span = figure_data.frequency_range(measured)
    data: list[Figure] = []
    named: set[str] = set()
    for panel, r in enumerate(responses, 1):
        for m in measured:
            for e, values in m.coherences(r):
                what = f"response {r}, force {e}" if e else f"response {r}"
                data.append(_quality_line(m, looks[m.name], values, what))
                data[-1].update(on_panel(panel), showlegend=m.name not in named)
                data[-1]["line"]["dash"] = EXCITATION_DASHES[e]
                named.add(m.name)
    for m in conditioned:
        condition = m.condition()
        assert condition is not None
        data.append(_quality_line(m, looks[m.name], condition, "condition number"))
        data[-1].update(on_panel(len(responses) + 1), showlegend=m.name not in named)
        named.add(m.name)
    return {"data": data, "layout": _quality_layout(responses, conditioned, span)}


def _quality_line(m: Measurement, look: Line, values: Real, what: str) -> Figure:
    return {
        **scatter("lines", m.frequency, values),
        "name": plain(m.name),
        "legendgroup": m.name,
        "line": {"width": 1.3, "color": look.colour},
        "hovertemplate": f"{what}: %{{x:.5~g}} Hz, %{{y:.4~g}}",
    }


def _quality_layout(responses: Sequence[str], conditioned: Sequence[Measurement], span: tuple[float, float]) -> Figure:
    rows = bool(responses) + bool(conditioned)
    layout = base_layout(140 + 210 * rows, annotations=[], shapes=[])
    count = len(responses)
    floor = 0.0 if rows == 1 else 0.58
    gap = 0.025
    for panel, r in enumerate(responses, 1):
        tail = "" if panel == 1 else str(panel)
        wide = (1 - gap * (count - 1)) / count
        x0 = (panel - 1) * (wide + gap)
        linked = {} if panel == 1 else {"matches": "x"}
        layout[f"xaxis{tail}"] = axis_look(
            "" if conditioned else "frequency [Hz]",
            domain=[x0, x0 + wide],
            anchor=f"y{tail}",
            range=list(span),
            **linked,
        )
        layout[f"yaxis{tail}"] = axis_look(
            "coherence [1]" if panel == 1 else "", domain=[floor, 1.0], anchor=f"x{tail}", range=[-0.02, 1.05]
        )
        layout[f"yaxis{tail}"]["showticklabels"] = panel == 1
        note = _corner(f"response {r}", x0 + wide, floor)
        layout["annotations"].append({**note, "yanchor": "bottom", "yshift": 4})
    if conditioned:
        _add_condition(layout, count + 1, conditioned, span, 0.42 if responses else 1.0)
    return layout


def _add_condition(
    layout: Figure, panel: int, conditioned: Sequence[Measurement], span: tuple[float, float], top: float
) -> None:
    """Add the panel of condition numbers; what is badly conditioned is shaded."""
    tail = "" if panel == 1 else str(panel)
    linked = {} if panel == 1 else {"matches": "x"}
    layout[f"xaxis{tail}"] = axis_look("frequency [Hz]", anchor=f"y{tail}", range=list(span), **linked)
    numbers = [c for m in conditioned if (c := m.condition()) is not None]
    highest = max(float(c[np.isfinite(c)].max(initial=1.0)) for c in numbers)
    layout[f"yaxis{tail}"] = axis_look(
        "condition number of the forces [1]" if panel == 1 else "condition number [1]",
        **{"domain": [0.0, top], "anchor": f"x{tail}"},
        **log_axis(1.0, max(1.5 * highest, 2.0 * BAD_CONDITION)),
    )
    on = {
        "xref": f"x{tail}",
        "yref": f"y{tail} domain",
        "y0": 0,
        "y1": 1,
        "layer": "below",
        "line": {"width": 0},
    }
    for m in conditioned:
        for low, high in figure_data.badly_conditioned(m):
            shade = {"type": "rect", "x0": low, "x1": high, "fillcolor": translucent(CHATTER, 0.18)}
            layout["shapes"].append({**shade, **on})
    limit = {"type": "line", "x0": 0, "x1": 1, "xref": f"x{tail} domain", "yref": f"y{tail}"}
    look = {"line": {"color": CHATTER, "width": 1.2, "dash": "dash"}}
    layout["shapes"].append({**limit, "y0": BAD_CONDITION, "y1": BAD_CONDITION, **look})


def bad_bands_text(m: Measurement) -> str:
    """Return a sentence on the badly conditioned bands of a sweep."""
    found = m.bad_bands()
    if not found:
        return f"the condition number of the forces stays below {BAD_CONDITION:g} at every frequency."
    what = f"the condition number of the forces exceeds {BAD_CONDITION:g} (badly conditioned)"
    return f"{what} at {band_text(found)}."
