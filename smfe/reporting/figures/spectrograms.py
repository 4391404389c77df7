"""Spectrograms of cutting tests: what chatters, when, beside the orders of the spindle."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from smfe.reporting.content.style import CHATTER, literal, number
from smfe.reporting.figures.figure_data import chatter_marks, common_end

RANGE_DB = 60.0
"""Range of the colours below the highest level [dB]."""

MOST_PICTURES = 24
"""The picture of all tests holds no more; the HTML file has all."""

MOST_ORDERS = 80
"""Orders that are marked at the edge; more would touch each other."""

MOST_HARMONICS = 12
"""Tooth passing harmonics that are marked by a line."""

_PAGE_DPI = 90


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


def embedded(dataset: xr.Dataset, end: float) -> str:
    """Return the spectrogram of one test as a data address of a PNG file.

    Parameters
    ----------
    dataset : xarray.Dataset
        Group of spectra.nc with a ``spectrogram``.
    end : float
        Highest frequency shown [Hz].
    """
    figure = _figure(6.4, 2.7)
    axes = figure.add_axes((0.105, 0.17, 0.87, 0.69))
    _panel(axes, dataset, end)
    axes.set_xlabel("time [s]", fontsize=9)
    axes.set_ylabel("frequency [Hz]", fontsize=9)
    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=_PAGE_DPI, pil_kwargs={"optimize": True})
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def _panel(axes: Axes, dataset: xr.Dataset, end: float) -> None:
    """Draw one spectrogram with its marks."""
    level = dataset["spectrogram"]
    time, frequency = (dataset[f"picture_{name}"].values.astype(float) for name in ("time", "frequency"))
    below = (level.values.astype(float) - 255.0) * float(level.attrs.get("step_dB", 0.5))
    # The cut sets the scale, not a knock beside it.
    top = float(np.quantile(below.max(axis=1), 0.9))
    edges = [_edges(time, float(level.attrs.get("window_s", 0.0))), _edges(frequency, 0.0)]
    axes.pcolormesh(*edges, below.T, cmap="cividis", vmin=top - RANGE_DB, vmax=top, rasterized=True)
    end = min(end, float(frequency[-1]))
    axes.set(xlim=(edges[0][0], edges[0][-1]), ylim=(0.0, end))
    axes.tick_params(labelsize=8)
    _mark_orders(axes, dataset, end)
    _mark_chatter(axes, dataset, end)
    _mark_cut(axes, dataset)


def _edges(middle: np.ndarray, width: float) -> np.ndarray:
    """Return the edges of cells around their middles; the first and last reach half a width outwards."""
    between = 0.5 * (middle[1:] + middle[:-1])
    return np.concatenate([[middle[0] - 0.5 * width], between, [middle[-1] + 0.5 * width]])


def _mark_orders(axes: Axes, dataset: xr.Dataset, end: float) -> None:
    """Mark tooth passing harmonics by dashes across, spindle orders by ticks at the right edge."""
    passing, teeth = (float(dataset.attrs.get(name, np.nan)) for name in ("tooth_passing_frequency_Hz", "teeth"))
    if not passing > 0.0:
        return
    harmonics = np.arange(passing, end, passing)
    if harmonics.size <= MOST_HARMONICS:
        for line in harmonics:
            axes.axhline(line, color="white", linewidth=0.6, dashes=(2, 6), alpha=0.8)
    orders = np.arange(passing / teeth, end, passing / teeth) if teeth > 0.0 else np.empty(0)
    for marks, length in ((harmonics, 0.03), (orders if orders.size <= MOST_ORDERS else harmonics, 0.012)):
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
        first, last = axes.get_xlim()
        names = (("entry", bounds[0], bounds[1]), ("cut", bounds[1], bounds[2]), ("exit", bounds[2], bounds[3]))
        for name, begin, end in names:
            if end - begin > 0.06 * (last - first):
                axes.text(0.5 * (begin + end), 1.04, name, fontsize=7, ha="center", va="bottom", transform=above)
    if judged.size == 2:
        axes.plot(judged, [1.015, 1.015], color="black", linewidth=2.5, transform=above, clip_on=False)


def _numbers(dataset: xr.Dataset, name: str) -> np.ndarray:
    """Return the numbers of an attribute, a JSON list."""
    return np.asarray(json.loads(str(dataset.attrs.get(name, "[]"))), dtype=float)
