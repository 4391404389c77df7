"""Spectra of cutting tests, interactive."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr

from smfe.reporting.content.style import AXIS_COLOURS, CHATTER, number, spoken
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.plotly_frame import Figure, axis_look, base_layout, filled, log_axis, plain
from smfe.reporting.figures.thinning import coded, columns_of, largest

COLUMNS = 800
"""Columns of a spectrum up to where it is shown first; a figure is half as wide as the page."""

BEYOND = 400
"""Columns of what lies beyond and is seen by whoever asks for the whole range."""


def spectrum_figure(dataset: xr.Dataset, end: float) -> Figure:
    """Return the amplitudes of one cutting test with removed harmonics, threshold and chatter line.

    Of each column of the picture the largest amplitude stays, so that no line is lost.
    """
    _, floor, top = figure_data.spectrum_span(dataset)
    frequency = dataset["frequency"].values.astype(float)
    removed = [b for b in figure_data.harmonic_bands(dataset) if b[0] <= frequency[-1]]
    data = [_removed(removed, floor * 1e-3, top * 1e3)] if removed else []
    columns = columns_of(frequency, (0.0, end), COLUMNS, BEYOND)
    for axis in dataset["axis"].values:
        values = dataset["amplitude"].sel(axis=axis).values.astype(float)
        kept = largest(columns, values)
        data.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": coded(frequency[kept]),
                "y": coded(values[kept], logarithmic=True),
                "name": plain(str(axis)),
                "line": {"width": 1.2, "color": AXIS_COLOURS.get(str(axis), "#000000")},
                "hovertemplate": "%{x:.5~g} Hz: %{y:.3~g}",
            }
        )
    predicted = figure_data.predicted_lines(dataset, end)
    if predicted:
        data.append(
            {
                "type": "scatter",
                "mode": "markers",
                "x": list(predicted.values()),
                "y": [top / 1.1] * len(predicted),
                "text": [plain(spoken(name)) for name in predicted],
                "name": "predicted",
                "marker": {"symbol": "triangle-down", "size": 10, "color": CHATTER},
                "hovertemplate": "%{text}: %{x:.5~g} Hz predicted",
            }
        )
    layout = base_layout(
        310,
        margin={"l": 70, "r": 15, "t": 12, "b": 46},
        xaxis=axis_look("frequency [Hz]", range=[0.0, end]),
        yaxis=axis_look(plain(figure_data.amplitude_label(dataset)), **log_axis(floor, top)),
        shapes=_spectrum_lines(dataset),
        annotations=_spectrum_notes(dataset, end),
    )
    return {"data": data, "layout": layout}


def _removed(pairs: Sequence[tuple[float, float]], low: float, high: float) -> Figure:
    begins, ends = (coded(values) for values in np.asarray(pairs, dtype=float).T)
    return {
        **filled((np.empty(0), np.empty(0)), "#777777", 0.22, {"name": "removed harmonics", "showlegend": True}),
        "x": {"derive": "bars_x", "of": [begins, ends]},
        "y": {"derive": "bars_y", "of": [begins, low, high]},
    }


def _spectrum_lines(dataset: xr.Dataset) -> list[Figure]:
    shapes = []
    threshold, line = figure_data.chatter_marks(dataset)
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
    threshold, line = figure_data.chatter_marks(dataset)
    shared = {"showarrow": False, "font": {"size": 12, "color": CHATTER}, "bgcolor": "rgba(255,255,255,0.8)"}
    if np.isfinite(threshold):
        where = {
            "x": 1,
            "xref": "paper",
            "xanchor": "right",
            "y": float(np.log10(threshold)),
            "yanchor": "bottom",
        }
        notes.append({**shared, **where, "text": f"threshold {dataset.attrs.get('threshold_axis', '')}".strip()})
    if np.isfinite(line):
        side = "left" if line < 0.7 * end else "right"
        where = {"x": line, "xanchor": side, "y": 0.98, "yref": "paper", "yanchor": "top"}
        notes.append({**shared, **where, "text": f"{number(line)} Hz"})
    return notes
