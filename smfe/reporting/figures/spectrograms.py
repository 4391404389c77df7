"""Spectrograms of cutting tests: what chatters, when, beside the orders of the spindle."""

from __future__ import annotations

import base64
import json
import struct
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from process.types import Real
from smfe.reporting.content.style import CHATTER, literal, number
from smfe.reporting.figures.figure_data import chatter_marks, common_end
from smfe.reporting.figures.plotly_frame import axis_look, base_layout

RANGE_DB = 60.0
"""Range of the colours below the highest level [dB]."""

MOST_PICTURES = 24
"""The picture of all tests holds no more; the HTML file has all."""

MOST_ORDERS = 80
"""Orders that are marked at the edge; more would touch each other."""

MOST_HARMONICS = 12
"""Tooth passing harmonics that are marked by a line."""

STEP_DB = 0.5
"""Step of the colours of the page [dB]."""


def pictured(spectra: Sequence[xr.Dataset]) -> list[xr.Dataset]:
    """Return the tests of which a spectrogram has been stored."""
    return [s for s in spectra if "spectrogram" in s]


def draw(spectra: Sequence[xr.Dataset]) -> Figure:
    """Draw the spectrograms of the cutting tests as a grid.

    Parameters
    ----------
    spectra : sequence of xarray.Dataset
        Groups of spectra.nc that hold a ``spectrogram``.
    """
    shown = list(spectra[:MOST_PICTURES])
    columns = min(2, len(shown))
    rows = -(-len(shown) // columns)
    width, height = 4.6 * columns + 0.4, 2.7 * rows + 0.9
    figure = _figure(width, height)
    grid = figure.add_gridspec(
        rows,
        columns,
        left=0.65 / width,
        right=1.0 - 0.2 / width,
        bottom=0.5 / height,
        top=1.0 - 0.75 / height,
        hspace=0.45,
        wspace=0.24,
    )
    end = common_end(spectra)
    for position, dataset in enumerate(shown):
        axes = figure.add_subplot(grid[divmod(position, columns)])
        _panel(axes, dataset, end)
        cut = f"{number(dataset.attrs.get('spindle_speed_rpm'))} rpm, {number(dataset.attrs.get('depth_of_cut_mm'))} mm"
        axes.set_title(literal(f"{cut}: {dataset.attrs.get('verdict', '')}"), fontsize=8.5, pad=16.0)
    figure.supxlabel("time [s]", fontsize=10, y=0.08 / height)
    figure.supylabel("frequency [Hz]", fontsize=10, x=0.06 / width)
    text = _EXPLAINED if len(shown) == len(spectra) else f"{_EXPLAINED} The first {len(shown)} of {len(spectra)} tests."
    figure.text(0.5, 1.0 - 0.12 / height, text, ha="center", va="top", fontsize=7.5, wrap=True)
    return figure


_EXPLAINED = (
    f"Colour: level, {RANGE_DB:g} dB. White dashes: tooth passing harmonics; ticks at the right: spindle orders. "
    "Dotted red: chatter line, its family beside it.\n"
    "White upright lines: the cut is entered and left. Black bar: what was judged."
)


def spectrogram_figure(dataset: xr.Dataset, end: float) -> dict[str, Any]:
    """Return the spectrogram of one test as an interactive figure: a small image below marks that stay sharp.

    Parameters
    ----------
    dataset : xarray.Dataset
        Group of spectra.nc with a ``spectrogram``.
    end : float
        Highest frequency shown [Hz].
    """
    time, frequency, below, top = _levels(dataset)
    rows = np.clip(np.round((below - (top - RANGE_DB)) / STEP_DB), 0, RANGE_DB / STEP_DB).astype(np.uint8)
    span = [_edges(values, 0.0, uniform=True)[[0, -1]] for values in (time, frequency)]
    end = min(end, float(span[1][1]))
    image = {
        "source": "data:image/png;base64," + base64.b64encode(_png(rows.T[::-1])).decode("ascii"),
        **{"xref": "x", "yref": "y", "xanchor": "left", "yanchor": "top", "sizing": "stretch", "layer": "below"},
        **{"x": span[0][0], "y": span[1][1], "sizex": float(np.ptp(span[0])), "sizey": float(np.ptp(span[1]))},
    }
    shapes, notes = _marks(dataset, end)
    layout = base_layout(
        270,
        margin={"l": 70, "r": 15, "t": 22, "b": 46},
        xaxis=axis_look("time [s]", range=[float(v) for v in span[0]], showgrid=False),
        yaxis=axis_look("frequency [Hz]", range=[0.0, end], showgrid=False),
        images=[image],
        shapes=shapes,
        annotations=notes,
    )
    # plotly draws no axes without a trace.
    return {"data": [{"type": "scatter", "x": [None], "y": [None], "showlegend": False}], "layout": layout}


def _marks(dataset: xr.Dataset, end: float) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return lines over the image, and the names of the parts of the cut above it."""
    harmonics, orders = _orders(dataset, end)
    across = {"type": "line", "xref": "paper", "yref": "y"}
    upright = {"type": "line", "xref": "x", "yref": "paper"}
    white = {"color": "#fff", "width": 1}
    shapes: list[dict[str, Any]] = []
    if harmonics.size <= MOST_HARMONICS:
        shapes += [
            across | {"x0": 0, "x1": 1, "y0": f, "y1": f, "line": white | {"dash": "2px,7px"}} for f in harmonics
        ]
    for marks, length in ((harmonics, 0.03), (orders, 0.012)):
        shapes += [across | {"x0": 1 - length, "x1": 1, "y0": f, "y1": f, "line": white} for f in marks]
    red = {"color": CHATTER, "width": 2}
    line = chatter_marks(dataset)[1]
    if np.isfinite(line) and line < end:
        shapes.append(across | {"x0": 0, "x1": 1, "y0": line, "y1": line, "line": red | {"dash": "dot"}})
    family = _numbers(dataset, "family_Hz")
    shapes += [across | {"x0": 0, "x1": 0.035, "y0": f, "y1": f, "line": red} for f in family[family < end]]
    bounds, judged = _numbers(dataset, "cut_s"), _numbers(dataset, "interval_s")
    notes: list[dict[str, Any]] = []
    if bounds.size == 4 and np.isfinite(bounds).all():
        for at, dash in zip(bounds, ("dash", "solid", "solid", "dash"), strict=True):
            shapes.append(upright | {"x0": at, "x1": at, "y0": 0, "y1": 1, "line": white | {"dash": dash}})
        look = {"showarrow": False, "yref": "paper", "y": 1.02, "yanchor": "bottom", "font": {"size": 11}}
        notes = [{**look, "x": 0.5 * (begin + stop), "text": name} for name, begin, stop in _parts(dataset, bounds)]
    if judged.size == 2:
        ends = {"x0": judged[0], "x1": judged[1], "y0": 1.015, "y1": 1.015}
        shapes.append(upright | ends | {"line": {"color": "#000", "width": 3}})
    return shapes, notes


def _png(rows: NDArray[np.uint8]) -> bytes:
    """Return an image of levels, darkest first, as PNG with a palette: a byte a point before compression."""
    steps = int(RANGE_DB / STEP_DB) + 1
    palette = np.round(255.0 * colormaps["cividis"](np.linspace(0.0, 1.0, steps))[:, :3]).astype(np.uint8)
    lines = np.pad(rows, ((0, 0), (1, 0)))  # each line begins with its filter, which is none

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", rows.shape[1], rows.shape[0], 8, 3, 0, 0, 0)
    packed = zlib.compress(lines.tobytes(), 9)
    parts = [chunk(b"IHDR", head), chunk(b"PLTE", palette.tobytes()), chunk(b"IDAT", packed), chunk(b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def _panel(axes: Axes, dataset: xr.Dataset, end: float) -> None:
    """Draw one spectrogram with its marks."""
    time, frequency, below, top = _levels(dataset)
    window = float(dataset["spectrogram"].attrs.get("window_s", 0.0))
    edges = [_edges(time, window), _edges(frequency, 0.0)]
    axes.pcolormesh(*edges, below.T, cmap="cividis", vmin=top - RANGE_DB, vmax=top, rasterized=True)
    end = min(end, float(frequency[-1]))
    axes.set(xlim=(edges[0][0], edges[0][-1]), ylim=(0.0, end))
    axes.tick_params(labelsize=8)
    _mark_orders(axes, dataset, end)
    _mark_chatter(axes, dataset, end)
    _mark_cut(axes, dataset)


def _levels(dataset: xr.Dataset) -> tuple[Real, Real, Real, float]:
    """Return time [s], frequency [Hz], level over both [dB] and where its colours end."""
    level = dataset["spectrogram"]
    time, frequency = (dataset[f"picture_{name}"].values.astype(float) for name in ("time", "frequency"))
    below = (level.values.astype(float) - 255.0) * float(level.attrs.get("step_dB", 0.5))
    # The cut sets the scale, not a knock beside it.
    return time, frequency, below, float(np.quantile(below.max(axis=1), 0.9))


def _edges(middle: Real, width: float, *, uniform: bool = False) -> Real:
    """Return the edges of cells around their middles; the first and last reach half a width outwards."""
    if uniform:
        width = float(np.ptp(middle)) / max(middle.size - 1, 1)
    between = 0.5 * (middle[1:] + middle[:-1])
    return np.concatenate([[middle[0] - 0.5 * width], between, [middle[-1] + 0.5 * width]])


def _orders(dataset: xr.Dataset, end: float) -> tuple[Real, Real]:
    """Return the tooth passing harmonics and the spindle orders to mark [Hz]; of too many orders none."""
    passing, teeth = (float(dataset.attrs.get(name, np.nan)) for name in ("tooth_passing_frequency_Hz", "teeth"))
    if not passing > 0.0:
        return np.empty(0), np.empty(0)
    orders = np.arange(passing / teeth, end, passing / teeth) if teeth > 0.0 else np.empty(0)
    return np.arange(passing, end, passing), orders if orders.size <= MOST_ORDERS else np.empty(0)


def _parts(dataset: xr.Dataset, bounds: Real) -> list[tuple[str, float, float]]:
    """Return entry, cut and exit with their ends [s], those that are long enough to be named."""
    whole = float(np.ptp(dataset["picture_time"].values))
    return [
        (name, float(begin), float(end))
        for name, begin, end in zip(("entry", "cut", "exit"), bounds[:-1], bounds[1:], strict=True)
        if end - begin > 0.06 * whole
    ]


def _mark_orders(axes: Axes, dataset: xr.Dataset, end: float) -> None:
    """Mark tooth passing harmonics by dashes across, spindle orders by ticks at the right edge."""
    harmonics, orders = _orders(dataset, end)
    if harmonics.size <= MOST_HARMONICS:
        for line in harmonics:
            axes.axhline(line, color="white", linewidth=0.6, dashes=(2, 6), alpha=0.8)
    for marks, length in ((harmonics, 0.03), (orders, 0.012)):
        axes.hlines(marks, 1.0 - length, 1.0, color="white", linewidth=0.8, transform=axes.get_yaxis_transform())


def _mark_chatter(axes: Axes, dataset: xr.Dataset, end: float) -> None:
    """Mark the chatter line across, and the lines of its family at the left edge."""
    line = chatter_marks(dataset)[1]
    if np.isfinite(line) and line < end:
        axes.axhline(line, color=CHATTER, linestyle=":", linewidth=1.4)
    family = _numbers(dataset, "family_Hz")
    shown = family[family < end]
    axes.hlines(shown, 0.0, 0.035, color=CHATTER, linewidth=1.2, transform=axes.get_yaxis_transform())


def _mark_cut(axes: Axes, dataset: xr.Dataset) -> None:
    """Mark entry, cut and exit, and what has been judged."""
    bounds, judged = _numbers(dataset, "cut_s"), _numbers(dataset, "interval_s")
    above = axes.get_xaxis_transform()
    if bounds.size == 4 and np.isfinite(bounds).all():
        for at in (bounds[0], bounds[3]):
            axes.axvline(float(at), color="white", linewidth=0.8, linestyle="--")
        for at in bounds[1:3]:
            axes.axvline(float(at), color="white", linewidth=1.2)
        for name, begin, end in _parts(dataset, bounds):
            axes.text(0.5 * (begin + end), 1.04, name, fontsize=7, ha="center", va="bottom", transform=above)
    if judged.size == 2:
        axes.plot(judged, [1.015, 1.015], color="black", linewidth=2.5, transform=above, clip_on=False)


def _numbers(dataset: xr.Dataset, name: str) -> np.ndarray:
    """Return the numbers of an attribute, a JSON list."""
    return np.asarray(json.loads(str(dataset.attrs.get(name, "[]"))), dtype=float)
