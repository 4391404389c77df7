"""The figures of the page, interactive: plain dictionaries in plotly's JSON schema.

Arrays travel as base64 of 32-bit floats, which plotly.js reads by itself: seven digits in half the space of
five written out, and NaN for a gap.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike

from process.types import Complex, Real
from smfe.reporting import figures
from smfe.reporting.headline import outcomes
from smfe.reporting.results import BAD_CONDITION, Lobes, Measurement
from smfe.reporting.style import (
    AXIS_COLOURS,
    CHATTER,
    CURVE_COLOURS,
    EXCITATION_DASHES,
    RECORD,
    Line,
    band_text,
    number,
    translucent,
)

Figure = dict[str, Any]

_GRID = "#e4e4e4"
LEGEND = {"orientation": "h", "x": 0, "xanchor": "left", "bgcolor": "rgba(255,255,255,0)"}
_FONT = {"family": "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif", "size": 13, "color": "#222"}
_SYMBOLS = {
    "stable": {"symbol": "circle", "color": "#000", "size": 10},
    "chatter": {"symbol": "x", "color": CHATTER, "size": 11, "line": {"width": 1, "color": "#fff"}},
    "undecided": {"symbol": "triangle-up-open", "color": "#000", "size": 11, "line": {"width": 2}},
}


def packed(values: ArrayLike) -> dict[str, str]:
    """Return an array as plotly reads it from JSON."""
    array = np.asarray(values, dtype="<f4")
    out = {"dtype": "f4", "bdata": base64.b64encode(array.tobytes()).decode("ascii")}
    if array.ndim == 2:
        out["shape"] = f"{array.shape[0]},{array.shape[1]}"
    return out


def scatter(mode: str, x: ArrayLike, y: ArrayLike) -> Figure:
    """Return lines or markers at points."""
    return {"type": "scatter", "mode": mode, "x": packed(x), "y": packed(y)}


def plain(text: str) -> str:
    """Return text so that plotly, which knows a few HTML tags, writes it letter by letter."""
    return html.escape(text, quote=False)


def axis_look(title: str = "", **more: Any) -> dict[str, Any]:
    """Return the settings of an axis: framed, with ticks outside."""
    look = {
        "gridcolor": _GRID,
        "linecolor": "#888",
        "ticks": "outside",
        "tickcolor": "#888",
        "zeroline": False,
    }
    return {"title": {"text": title, "standoff": 6}, "showline": True, "mirror": True, **look, **more}


def base_layout(height: int, **more: Any) -> dict[str, Any]:
    """Return the layout that every figure starts from, the legend above the panels."""
    return {
        "height": height,
        "margin": {"l": 70, "r": 20, "t": 40, "b": 50},
        "paper_bgcolor": "#fff",
        "plot_bgcolor": "#fff",
        "font": _FONT,
        "hovermode": "closest",
        "hoverlabel": {"bgcolor": "#fff", "font": {"color": "#222"}, "namelength": -1},
        "legend": {**LEGEND, "y": 1.0 + 6.0 / (height - 90), "yanchor": "bottom"},
        **more,
    }


def polygons(x: Real, low: Real, high: Real) -> tuple[Real, Real]:
    """Return the outline between two curves, one polygon a run of known values."""
    xs: list[ArrayLike] = []
    ys: list[ArrayLike] = []
    edges = np.flatnonzero(np.diff(np.concatenate([[0], (np.isfinite(low) & np.isfinite(high)).astype(int), [0]])))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        xs += [x[a:b], x[a:b][::-1], [np.nan]]
        ys += [low[a:b], high[a:b][::-1], [np.nan]]
    if not xs:
        return np.empty(0), np.empty(0)
    return np.concatenate(xs)[:-1], np.concatenate(ys)[:-1]


def filled(outline: tuple[ArrayLike, ArrayLike], colour: str, opacity: float, more: Mapping[str, Any]) -> Figure:
    """Return an outline filled with a translucent colour."""
    return {
        **scatter("lines", outline[0], outline[1]),
        "fill": "toself",
        "fillcolor": translucent(colour, opacity),
        "line": {"width": 0},
        "hoverinfo": "skip",
        "showlegend": False,
        **more,
    }


# --- lobes --------------------------------------------------------------------------------------------------


def lobes_figure(lobes: Sequence[Lobes], tests: pd.DataFrame | None, looks: Mapping[str, Line]) -> Figure:
    """Return limit depth over speed with the cutting tests, and the chatter frequency below."""
    top, frequencies = figures.highest_depth(lobes, tests), figures.chatter_range(lobes)
    data: list[Figure] = []
    for item in lobes:
        data += _lobe_traces(item, looks[item.source], top)
    if tests is not None:
        data += _test_traces(tests)
    shared = {"range": list(figures.speed_range(lobes)), "anchor": "y2", "mirror": "all"}
    below = {"range": list(frequencies)} if frequencies else {}
    layout = base_layout(
        640,
        xaxis=axis_look("spindle speed [rpm]", **shared),
        yaxis=axis_look("limit depth a<sub>p</sub> [mm]", domain=[0.36, 1.0], range=[0.0, top]),
        yaxis2=axis_look("chatter frequency [Hz]", domain=[0.0, 0.3], **below),
    )
    return {"data": data, "layout": layout}


def _lobe_traces(item: Lobes, look: Line, top: float) -> list[Figure]:
    name, group = plain(item.source), item.source
    speed, finite = item.data["spindle_speed"].values.astype(float), figures.finite_depth(item)
    frequency, lobe = item.values("chatter_frequency"), item.values("lobe")
    out = []
    band = item.band()
    if band is not None:
        low, high = (np.where(np.isinf(v), 20.0 * top, v) for v in band[:2])
        out.append(filled(polygons(speed, low, high), look.colour, 0.18, {"legendgroup": group}))
    curves = item.curves()
    if curves is not None:
        thin = {
            "type": "scatter",
            "mode": "lines",
            "line": {"width": 0.7, "color": translucent(look.colour, 0.45)},
        }
        hidden = {"hoverinfo": "skip", "showlegend": False, "legendgroup": group}
        x = packed(curves[0])
        out.append({**thin, **hidden, "x": x, "y": packed(curves[1])})
        out.append({**thin, **hidden, "x": x, "y": packed(curves[2]), "yaxis": "y2"})
    shared = {
        "type": "scatter",
        "x": packed(speed),
        "name": name,
        "legendgroup": group,
        "customdata": packed(np.column_stack([finite, frequency, np.where(lobe >= 0, lobe, np.nan)])),
        "hovertemplate": "%{x:.5~g} rpm<br>limit depth %{customdata[0]:.4~g} mm<br>"
        "chatter frequency %{customdata[1]:.4~g} Hz<br>lobe %{customdata[2]:.0f}",
    }
    out.append(
        {
            **shared,
            "mode": "lines",
            "y": packed(finite),
            "line": {"width": 2.4, "color": look.colour, "dash": look.dash},
        }
    )
    points = {"mode": "markers", "marker": {"size": 3.5, "color": look.colour}, "showlegend": False}
    out.append({**shared, **points, "y": packed(frequency), "yaxis": "y2"})
    return out


def _test_traces(tests: pd.DataFrame) -> list[Figure]:
    """Return the cutting tests by outcome, and the frequencies of those that chattered."""
    happened = outcomes(tests)
    out: list[Figure] = []
    for outcome, marker in _SYMBOLS.items():
        rows = tests[happened == outcome]
        if rows.empty:
            continue
        shared = {
            "type": "scatter",
            "mode": "markers",
            "marker": marker,
            "x": packed(rows["spindle_speed_rpm"]),
            "name": f"cutting test: {outcome}",
            "legendgroup": outcome,
            "text": [_test_text(row) for row in rows.to_dict("records")],
            "hovertemplate": "%{text}<extra></extra>",
        }
        out.append({**shared, "y": packed(rows["depth_of_cut_mm"])})
        if outcome == "chatter" and "chatter_frequency_Hz" in rows:
            out.append({**shared, "y": packed(rows["chatter_frequency_Hz"]), "yaxis": "y2", "showlegend": False})
    return out


def _test_text(row: Mapping[Any, Any]) -> str:
    lines = [
        plain(str(row["file"])),
        f"{number(row['spindle_speed_rpm'])} rpm, depth {number(row['depth_of_cut_mm'])} mm",
        f"verdict: {plain(str(row['verdict']))}",
    ]
    if isinstance(row.get("observed"), str) and row["observed"]:
        lines.append(f"observed: {plain(row['observed'])}")
    said = [(key, row.get(key)) for key in ("controller", "position")]
    lines += [f"{key}: {plain(value)}" for key, value in said if isinstance(value, str) and value]
    if np.isfinite(row.get("chatter_frequency_Hz", np.nan)):
        lines.append(f"line at {number(row['chatter_frequency_Hz'])} Hz")
    return "<br>".join(lines)


# --- spectra of cutting tests -------------------------------------------------------------------------------


def spectrum_figure(dataset: xr.Dataset, end: float) -> Figure:
    """Return the amplitudes of one cutting test with removed harmonics, threshold and chatter line."""
    _, floor, top = figures.spectrum_span(dataset)
    frequency = dataset["frequency"].values.astype(float)
    removed = [b for b in figures.harmonic_bands(dataset) if b[0] <= frequency[-1]]
    data = [_removed(removed, floor * 1e-3, top * 1e3)] if removed else []
    x = packed(frequency)
    for axis in dataset["axis"].values:
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": x,
                "y": packed(dataset["amplitude"].sel(axis=axis).values),
                "name": plain(str(axis)),
                "line": {"width": 1.2, "color": AXIS_COLOURS.get(str(axis), "#000000")},
                "hovertemplate": "%{x:.5~g} Hz: %{y:.3~g}",
            }
        )
    predicted = figures.predicted_lines(dataset, end)
    if predicted:
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": list(predicted.values()),
                "y": [top / 1.1] * len(predicted),
                "text": [plain(name) for name in predicted],
                "name": "predicted",
                "marker": {"symbol": "triangle-down", "size": 10, "color": CHATTER},
                "hovertemplate": "%{text}: %{x:.5~g} Hz predicted",
            }
        )
    layout = base_layout(
        330,
        margin={"l": 70, "r": 15, "t": 34, "b": 46},
        xaxis=axis_look("frequency [Hz]", range=[0.0, end]),
        yaxis=axis_look(plain(figures.amplitude_label(dataset)), **log_axis(floor, top)),
        shapes=_spectrum_lines(dataset),
        annotations=_spectrum_notes(dataset, end),
    )
    return {"data": data, "layout": layout}


def _removed(pairs: Sequence[tuple[float, float]], low: float, high: float) -> Figure:
    x = np.array([v for a, b in pairs for v in (a, a, b, b, np.nan)])[:-1]
    y = np.array([v for _ in pairs for v in (low, high, high, low, np.nan)])[:-1]
    return filled((x, y), "#777777", 0.22, {"name": "removed harmonics", "showlegend": True})


def log_axis(low: float, high: float) -> dict[str, Any]:
    """Return the settings of a logarithmic axis; one of few decades has ticks at 2 and 5 as well."""
    ends = [float(np.log10(low)), float(np.log10(high))]
    step = 1 if ends[1] - ends[0] > 2.2 else "D2"
    return {"type": "log", "range": ends, "dtick": step, "exponentformat": "power"}


def _spectrum_lines(dataset: xr.Dataset) -> list[Figure]:
    shapes = []
    threshold, line = figures.chatter_marks(dataset)
    if np.isfinite(threshold):
        look = {"color": CHATTER, "width": 1.5, "dash": "dash"}
        ends = {"x0": 0, "x1": 1, "xref": "paper", "y0": threshold, "y1": threshold}
        shapes.append({"type": "line", **ends, "line": look})
    if np.isfinite(line):
        look = {"color": CHATTER, "width": 1.5, "dash": "dot"}
        shapes.append({"type": "line", "x0": line, "x1": line, "y0": 0, "y1": 1, "yref": "paper", "line": look})
    return shapes


def _spectrum_notes(dataset: xr.Dataset, end: float) -> list[Figure]:
    notes = []
    threshold, line = figures.chatter_marks(dataset)
    shared = {"showarrow": False, "font": {"size": 12, "color": CHATTER}, "bgcolor": "rgba(255,255,255,0.8)"}
    if np.isfinite(threshold):
        where = {
            "x": 1,
            "xref": "paper",
            "xanchor": "right",
            "y": float(np.log10(threshold)),
            "yanchor": "bottom",
        }
        notes.append({**shared, **where, "text": "threshold"})
    if np.isfinite(line):
        side = "left" if line < 0.7 * end else "right"
        where = {"x": line, "xanchor": side, "y": 0.98, "yref": "paper", "yanchor": "top"}
        notes.append({**shared, **where, "text": f"{number(line)} Hz"})
    return notes


def _on(number_: int) -> dict[str, str]:
    """Return the axes of panel 1, 2, ... as a trace names them."""
    tail = "" if number_ == 1 else str(number_)
    return {"xaxis": f"x{tail}", "yaxis": f"y{tail}"}


# --- compliances -----------------------------------------------------------------------------------------------------


def compliance_figure(measurements: Sequence[Measurement], looks: Mapping[str, Line]) -> Figure:
    """Return the grid of compliances with a choice of magnitude, phase, real and imaginary part."""
    responses, excitations = figures.axes_of(measurements)
    span = figures.frequency_range(measurements)
    low, high = figures.magnitude_range(measurements, span)
    panels = {(r, e): 1 + i * len(excitations) + j for i, r in enumerate(responses) for j, e in enumerate(excitations)}
    data: list[Figure] = []
    views: list[list[Any]] = []
    for m in measurements:
        for first, (r, e) in enumerate(m.entries):
            shared = {**_on(panels[r, e]), "legendgroup": m.name}
            std = m.std(r, e)
            if std is not None:
                edges = figures.magnitude_band(m.entry(r, e), std, 1e-2 * low)
                data.append(filled(polygons(m.frequency, *edges), looks[m.name].colour, 0.2, shared))
                views.append([])
            views.append(_views(m.entry(r, e)))
            data.append(_compliance_line(m, looks[m.name], views[-1][0], figures.entry_name(r, e), first == 0, shared))
    layout = _grid_layout(responses, excitations, span, (low, high))
    axes = _view_axes((low, high), figures.part_ranges(measurements, span))
    layout["updatemenus"] = [_view_menu(views, list(panels.values()), axes)]
    return {"data": data, "layout": layout}


def _views(values: Complex) -> list[dict[str, str]]:
    scaled = 1e6 * values
    return [packed(np.abs(scaled)), packed(figures.lagging_phase(values)), packed(scaled.real), packed(scaled.imag)]


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
        110 + 250 * rows if rows > 1 else 460, margin={"l": 80, "r": 20, "t": 60, "b": 85}, annotations=[]
    )
    # Below, where a legend of any length keeps clear of the buttons.
    layout["legend"] = {**LEGEND, "y": -55.0 / (layout["height"] - 145), "yanchor": "top"}
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


def _view_menu(
    views: Sequence[Sequence[Any]], panels: Sequence[int], axes: Sequence[tuple[str, Mapping[str, Any]]]
) -> Figure:
    """Return the buttons; bands belong to the magnitude and hide in the other views."""
    lines = [k for k, v in enumerate(views) if v]
    fills = [k for k, v in enumerate(views) if not v]
    names = [f"yaxis{'' if p == 1 else p}" for p in panels]
    buttons = []
    for number_, (title, settings) in enumerate(axes):
        relayout = {f"{name}.{key}": value for name in names for key, value in settings.items()}
        buttons.append(
            {
                "label": title.partition(" [")[0],
                "method": "skip",
                # Read by report.js: plotly's own buttons cannot change two sets of traces at once.
                "args": [
                    {
                        "lines": lines,
                        "fills": fills,
                        "y": [views[k][number_] for k in lines],
                        "band": number_ == 0,
                        "title": title,
                        "layout": relayout,
                    }
                ],
            }
        )
    place = {"x": 0, "xanchor": "left", "y": 1.0, "yanchor": "bottom", "pad": {"b": 10}}
    return {"type": "buttons", "direction": "right", "showactive": True, "buttons": buttons, **place}


# --- quality ---------------------------------------------------------------------------------------------------------


def quality_figure(measurements: Sequence[Measurement], looks: Mapping[str, Line]) -> Figure | None:
    """Return coherence by response and, for sweeps, the condition of the forces; None without either."""
    measured, responses, conditioned = figures.quality_panels(measurements)
    if not responses and not conditioned:
        return None
    span = figures.frequency_range(measured)
    data: list[Figure] = []
    named: set[str] = set()
    for panel, r in enumerate(responses, 1):
        for m in measured:
            for e, values in m.coherences(r):
                what = f"response {r}, force {e}" if e else f"response {r}"
                data.append(_quality_line(m, looks[m.name], values, what))
                data[-1].update(_on(panel), showlegend=m.name not in named)
                data[-1]["line"]["dash"] = EXCITATION_DASHES[e]
                named.add(m.name)
    for m in conditioned:
        condition = m.condition()
        assert condition is not None
        data.append(_quality_line(m, looks[m.name], condition, "condition number"))
        data[-1].update(_on(len(responses) + 1), showlegend=m.name not in named)
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
        for low, high in figures.badly_conditioned(m):
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


# --- drives ----------------------------------------------------------------------------------------------------------


def drive_figure(frame: pd.DataFrame) -> Figure:
    """Return the interactive figure of one axis."""
    parts = figures.friction_parts(frame)
    data: list[dict[str, Any]] = [
        {
            **scatter("markers", parts["motion"]["velocity"].to_numpy(), parts["motion"]["force"].to_numpy()),
            "name": "record",
            "marker": {"size": 3, "color": RECORD},
        }
    ]
    for way in ("forward", "backward"):
        curve = parts[way]
        if curve.empty:
            continue
        around = np.concatenate([curve["velocity"], curve["velocity"][::-1]])
        band = np.concatenate([curve["high"], curve["low"][::-1]])
        shared = {"type": "scatter", "mode": "lines", "legendgroup": "curve", "hovertemplate": "%{x:.4~g}: %{y:.4~g}"}
        data += [
            shared
            | {
                "x": packed(around),
                "y": packed(band),
                "fill": "toself",
                "line": {"width": 0},
                "fillcolor": translucent(CURVE_COLOURS[0], 0.2),
                "showlegend": False,
                "hoverinfo": "skip",
            },
            shared
            | {
                "x": packed(curve["velocity"].to_numpy()),
                "y": packed(curve["force"].to_numpy()),
                "name": "identified, with 95 % interval",
                "line": {"width": 2, "color": CURVE_COLOURS[0]},
                "showlegend": way == "forward" or parts["forward"].empty,
            },
        ]
    runs = parts["runs"]
    if len(runs):
        data.append(
            {
                **scatter("markers", runs["velocity"].to_numpy(), runs["force"].to_numpy()),
                "error_y": {"type": "data", "array": packed((runs["high"] - runs["force"]).to_numpy())},
                "name": "runs at constant velocity",
                "marker": {"size": 7, "color": CURVE_COLOURS[1]},
            }
        )
    velocity, force = figures.friction_titles(frame)
    layout = base_layout(420, legend={**LEGEND, "y": 1.02, "yanchor": "bottom"})
    return {"data": data, "layout": layout | {"xaxis": axis_look(velocity), "yaxis": axis_look(force)}}


def loop_figure(dataset: xr.Dataset) -> Figure:
    """Return the interactive figure of one measurement."""
    x = packed(dataset["frequency"].values)
    data = []
    for name, colour, gain, phase in figures.loop_curves(dataset):
        for y, panel, shown in ((gain, "", True), (phase, "2", False)):
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "x": x,
                    "y": packed(y),
                    "name": name,
                    "legendgroup": name,
                    "showlegend": shown,
                    "line": {"width": 1.5, "color": colour},
                    "xaxis": f"x{panel}",
                    "yaxis": f"y{panel}",
                    "hovertemplate": "%{x:.5~g} Hz, %{y:.3~g}",
                }
            )
    layout = base_layout(480, legend={**LEGEND, "y": 1.02, "yanchor": "bottom"})
    layout |= {
        "xaxis": axis_look(type="log", matches="x2", showticklabels=False, anchor="y"),
        "xaxis2": axis_look(figures.FREQUENCY, type="log", anchor="y2"),
        "yaxis": axis_look(figures.GAIN, domain=[0.45, 1.0], anchor="x"),
        "yaxis2": axis_look(figures.PHASE, domain=[0.0, 0.4], range=[-180, 180], dtick=90, anchor="x2"),
    }
    return {"data": data, "layout": layout}


# --- diagnosis -------------------------------------------------------------------------------------------------------


def search_figure(finding: Mapping[str, Any]) -> Figure | None:
    """Return the misfit of the baseline and of each step that was kept; None without a step."""
    names, heights = figures.search_steps(finding)
    if len(names) < 2:
        return None
    bars = {
        "type": "bar",
        "orientation": "h",
        "x": heights,
        "y": [plain(n) for n in names],
        "marker": {"color": [figures.BASELINE, *[figures.EXTENDED] * (len(names) - 1)]},
        "text": [f"{h:.2f} dB" for h in heights],
        "textposition": "outside",
        "cliponaxis": False,
        "hoverinfo": "skip",
        "showlegend": False,
    }
    layout = base_layout(
        110 + 34 * len(names),
        xaxis=axis_look("misfit over noise [dB]", range=[min(0.0, *heights), 1.15 * max(heights)], zeroline=True),
        yaxis=axis_look(autorange="reversed", automargin=True, type="category"),
    )
    return {"data": [bars], "layout": layout}


def condition_figure(finding: Mapping[str, Any]) -> Figure | None:
    """Return the misfit of each condition before and after; None without conditions."""
    rows, title = figures.shown_conditions(finding)
    if not rows:
        return None
    names = [plain(str(c["name"])) for c in rows]
    data = [
        {
            "type": "scatter",
            "mode": "markers",
            "name": name,
            "x": misfit,
            "y": [names[i] for i in places],
            "marker": {"color": colour, "size": 9, "symbol": "circle-open" if held_out else "circle"},
        }
        for name, colour, held_out, places, misfit in figures.condition_marks(finding)
    ]
    layout = base_layout(
        130 + 22 * len(names),
        xaxis=axis_look(title, zeroline=True, zerolinecolor="#888"),
        yaxis=axis_look(
            autorange="reversed", automargin=True, type="category", categoryorder="array", categoryarray=names
        ),
    )
    return {"data": data, "layout": layout}


def stable_depth_figure(finding: Mapping[str, Any]) -> Figure | None:
    """Return the stable depth over spindle speed before and after; None without lobes."""
    data = [
        {
            "type": "scatter",
            "mode": "lines",
            "name": f"{word}, {plain(where)}",
            "x": packed(speeds),
            "y": packed(depths),
            "line": {"color": colour, "width": 4 if word == "baseline" else 2},
        }
        for where, word, colour, speeds, depths in figures.stable_depths(finding)
    ]
    layout = base_layout(
        360,
        xaxis=axis_look("spindle speed [rpm]"),
        yaxis=axis_look("limit depth a<sub>p</sub> [mm]", rangemode="tozero"),
    )
    return {"data": data, "layout": layout} if data else None
