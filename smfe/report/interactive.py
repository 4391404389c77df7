"""Interactive figures of lobes and spectra as plain dictionaries in plotly's JSON schema.

Arrays travel as base64 of 32-bit floats, which plotly.js reads by itself: seven digits in half the space of
five written out, and NaN for a gap.
"""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from smfe.report.answer import outcomes
from smfe.report.look import AXIS_COLOURS, CHATTER, Line, depth_range, number, translucent
from smfe.report.results import Lobes, bands

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


def plain(text: str) -> str:
    """Return text so that plotly, which knows a few HTML tags, shows it letter by letter."""
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


def polygons(
    x: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
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
        "type": "scatter",
        "mode": "lines",
        "x": packed(outline[0]),
        "y": packed(outline[1]),
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
    depths = [item.values("limit_depth") for item in lobes]
    cut = tests["depth_of_cut_mm"].to_numpy(dtype=float) if tests is not None else np.empty(0)
    top = depth_range(depths, cut)
    data: list[Figure] = []
    for item in lobes:
        data += _lobe_traces(item, looks[item.source], top)
    if tests is not None:
        data += _test_traces(tests)
    speeds = np.concatenate([item.data["spindle_speed"].values for item in lobes])
    shared = {"range": [float(speeds.min()), float(speeds.max())], "anchor": "y2", "mirror": "all"}
    layout = base_layout(
        640,
        xaxis=axis_look("spindle speed [rpm]", **shared),
        yaxis=axis_look("limit depth a<sub>p</sub> [mm]", domain=[0.36, 1.0], range=[0.0, top]),
        yaxis2=axis_look("chatter frequency [Hz]", domain=[0.0, 0.3], **_frequency_span(lobes)),
    )
    return {"data": data, "layout": layout}


def _frequency_span(lobes: Sequence[Lobes]) -> dict[str, Any]:
    values = np.concatenate([item.values("chatter_frequency") for item in lobes])
    values = values[np.isfinite(values)]
    if not values.size:
        return {}
    margin = 0.1 * float(np.ptp(values)) + 1.0
    return {"range": [max(0.0, float(values.min()) - margin), float(values.max()) + margin]}


def _lobe_traces(item: Lobes, look: Line, top: float) -> list[Figure]:
    name, group = plain(item.source), item.source
    speed, depth = item.data["spindle_speed"].values.astype(float), item.values("limit_depth")
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
    finite = np.where(np.isfinite(depth), depth, np.nan)
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


def spectrum_span(dataset: xr.Dataset) -> tuple[float, float, float]:
    """Return the highest frequency with anything to see, and the lowest and highest amplitude to show."""
    frequency = dataset["frequency"].values.astype(float)
    largest = np.nanmax(dataset["amplitude"].transpose("axis", "frequency").values, axis=0)
    top = float(np.nanmax(largest)) if np.isfinite(largest).any() else 1.0
    threshold = float(dataset.attrs.get("threshold_amplitude", np.nan))
    last = float(frequency[largest > 0.05 * top].max(initial=0.0))
    floor = max(0.5 * float(np.nanquantile(largest, 0.02)), 1e-5 * top)
    return 1.1 * last, floor, 2.0 * max(top, threshold if np.isfinite(threshold) else 0.0)


def common_end(spectra: Sequence[xr.Dataset]) -> float:
    """Return where the frequency axes of all tests end, so that they can be compared at a glance."""
    if not spectra:
        return 1.0
    lines = [float(s.attrs.get("chatter_frequency_Hz", np.nan)) for s in spectra]
    end = max(
        float(np.median([spectrum_span(s)[0] for s in spectra])),
        1.5 * max((v for v in lines if v > 0.0), default=0.0),
    )
    return min(end, max(float(s["frequency"].values[-1]) for s in spectra))


def harmonic_bands(dataset: xr.Dataset) -> list[tuple[float, float]]:
    """Return the bands [Hz] that the criterion leaves out as harmonics of the spindle."""
    if "harmonic" not in dataset:
        return []
    frequency = dataset["frequency"].values.astype(float)
    half = 0.5 * float(np.median(np.diff(frequency))) if frequency.size > 1 else 0.0
    found = bands(frequency, dataset["harmonic"].values.astype(bool))
    return [(a - half, b + half) for a, b in found]


def amplitude_label(dataset: xr.Dataset) -> str:
    """Return e.g. "acceleration [m/s²]"."""
    units = str(dataset.attrs.get("units") or dataset["amplitude"].attrs.get("units") or "")
    quantity = str(dataset.attrs.get("quantity") or "amplitude")
    return f"{quantity} [{units.replace('^2', '²')}]" if units else quantity


def spectrum_figure(dataset: xr.Dataset, end: float) -> Figure:
    """Return the amplitudes of one cutting test with removed harmonics, threshold and chatter line."""
    _, floor, top = spectrum_span(dataset)
    frequency = dataset["frequency"].values.astype(float)
    removed = [b for b in harmonic_bands(dataset) if b[0] <= frequency[-1]]
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
    predicted = predicted_lines(dataset, end)
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
        yaxis=axis_look(plain(amplitude_label(dataset)), **log_axis(floor, top)),
        shapes=_spectrum_lines(dataset),
        annotations=_spectrum_notes(dataset, end),
    )
    return {"data": data, "layout": layout}


def predicted_lines(dataset: xr.Dataset, end: float) -> dict[str, float]:
    """Return the chatter frequency that each source of lobes predicts [Hz], as far as the figure reaches."""
    found = json.loads(str(dataset.attrs.get("predicted_Hz", "{}")))
    return {str(name): float(f) for name, f in found.items() if float(f) <= end}


def _removed(pairs: Sequence[tuple[float, float]], low: float, high: float) -> Figure:
    x = np.array([v for a, b in pairs for v in (a, a, b, b, np.nan)])[:-1]
    y = np.array([v for _ in pairs for v in (low, high, high, low, np.nan)])[:-1]
    return filled((x, y), "#777777", 0.22, {"name": "removed harmonics", "showlegend": True})


def log_axis(low: float, high: float) -> dict[str, Any]:
    """Return the settings of a logarithmic axis; one of few decades shows 2 and 5 as well."""
    ends = [float(np.log10(low)), float(np.log10(high))]
    step = 1 if ends[1] - ends[0] > 2.2 else "D2"
    return {"type": "log", "range": ends, "dtick": step, "exponentformat": "power"}


def _spectrum_lines(dataset: xr.Dataset) -> list[Figure]:
    shapes = []
    threshold = float(dataset.attrs.get("threshold_amplitude", np.nan))
    line = float(dataset.attrs.get("chatter_frequency_Hz", np.nan))
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
    threshold = float(dataset.attrs.get("threshold_amplitude", np.nan))
    line = float(dataset.attrs.get("chatter_frequency_Hz", np.nan))
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
