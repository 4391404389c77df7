"""The same figures as PNG, for papers and slides: matplotlib's object interface, no global state."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from smfe.reporting import diagnosis, drives, loops, spectrograms
from smfe.reporting.conditions import cubes
from smfe.reporting.draw_plotly import amplitude_label, common_end, harmonic_bands, predicted_lines, spectrum_span
from smfe.reporting.headline import outcomes
from smfe.reporting.results import BAD_CONDITION, Lobes, Measurement, Results
from smfe.reporting.style import (
    AXIS_COLOURS,
    CHATTER,
    EXCITATION_DASHES,
    Line,
    axes_of,
    depth_range,
    entry_name,
    frequency_range,
    literal,
    magnitude_band,
    magnitude_range,
    number,
)
from smfe.results import write_atomically

DPI = 150
MOST_SPECTRA = 24
"""The picture of the spectra holds no more; the HTML file shows all."""

NOTHING = "nothing to draw:\nzero or not known"
"""What a panel says that has no positive value for its logarithmic axis."""

_STYLES: dict[str, Any] = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-."}
_MARKERS: dict[str, dict[str, Any]] = {
    "stable": {"marker": "o", "color": "black", "markersize": 6},
    "chatter": {
        "marker": "X",
        "color": CHATTER,
        "markersize": 8,
        "markeredgecolor": "white",
        "markeredgewidth": 0.6,
    },
    "undecided": {"marker": "^", "color": "black", "markersize": 7, "fillstyle": "none"},
}

Draw = Callable[[], Figure]


def pictures(results: Results, looks: Mapping[str, Line]) -> dict[str, Draw]:
    """Return file name -> function that draws it, for everything that there is."""
    out: dict[str, Draw] = {}
    for position, (request, lobes) in enumerate(results.requests.items(), 1):
        name = re.sub(r"[^\w-]", "_", request) or f"lobes_{position}"
        out[f"{name}.png"] = partial(draw_lobes, lobes, tests_of(results.chatter, request), looks)
    shown = [m for m in results.measurements if m.entries]
    if shown:
        out["compliance.png"] = partial(draw_compliance, shown, looks)
    for position, cube in enumerate(cubes(results.conditions), 1):
        out[f"conditions_{position}.png"] = partial(draw_compliance, cube.cells, cube.looks)
    for position, dataset in enumerate(results.loops.values(), 1):
        out[f"loop_{position}.png"] = partial(loops.draw, dataset)
    for position, frame in enumerate(drives.frictions(results.tables).values(), 1):
        out[f"drive_{position}.png"] = partial(drives.draw, frame)
    if any(m.condition() is not None or any(m.coherences(r) for r in "xyz") for m in shown if not m.is_model):
        out["condition.png"] = partial(draw_quality, shown, looks)
    if results.spectra:
        out["spectra.png"] = partial(draw_spectra, list(results.spectra.values()))
    with_picture = spectrograms.pictured(list(results.spectra.values()))
    if with_picture:
        out["spectrograms.png"] = partial(spectrograms.draw, with_picture)
    if diagnosis.pictured(results.finding):
        out["diagnosis.png"] = partial(diagnosis.draw, results.finding)
    return out


def tests_of(chatter: pd.DataFrame | None, request: str) -> pd.DataFrame | None:
    """Return the cutting tests that belong on the diagram of a request, None when there are none."""
    if chatter is None:
        return None
    rows = chatter[chatter["lobes"].fillna("") == request] if "lobes" in chatter and request else chatter
    return None if rows.empty else rows


def remove_stale(folder: Path, kept: Mapping[str, Draw]) -> None:
    """Delete pictures of ours that an earlier report wrote and this one does not."""
    for pattern in (
        "lobes_*.png",
        "conditions_*.png",
        "drive_*.png",
        "loop_*.png",
        "compliance.png",
        "condition.png",
        "spectra.png",
        "spectrograms.png",
        "diagnosis.png",
    ):
        for path in folder.glob(pattern):
            if path.name not in kept:
                path.unlink()


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG."""
    FigureCanvasAgg(figure)
    with warnings.catch_warnings():
        # Names are the user's; a letter that the font lacks becomes a box and is no fault of the report.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        return write_atomically(path, lambda p: figure.savefig(p, format="png", pil_kwargs={"compress_level": 3}))


def _new(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), dpi=DPI)


def _legend(figure: Figure, entries: Sequence[tuple[Artist, str]], top: float) -> None:
    """Put the legend above the panels, where it hides nothing."""
    handles, names = [h for h, _ in entries], [literal(n) for _, n in entries]
    columns = max(1, min(len(names), int(95 / (8 + max(len(n) for n in names)))))
    figure.legend(
        handles,
        names,
        loc="lower center",
        bbox_to_anchor=(0.5, top),
        ncols=columns,
        frameon=False,
        fontsize=9,
    )


def _legend_height(entries: Sequence[tuple[Artist, str]]) -> float:
    """Return the height [inch] that `_legend` needs."""
    longest = max(len(n) for _, n in entries)
    columns = max(1, min(len(entries), int(95 / (8 + longest))))
    return 0.2 * -(-len(entries) // columns) + 0.12


def _handle(look: Line) -> Line2D:
    return Line2D([], [], color=look.colour, linestyle=_STYLES[look.dash], linewidth=1.6)


def _plain_axes(axes: Axes) -> None:
    axes.grid(True, color="#dddddd", linewidth=0.5)
    axes.tick_params(labelsize=8, direction="in", which="both")


def draw_lobes(lobes: Sequence[Lobes], tests: pd.DataFrame | None, looks: Mapping[str, Line]) -> Figure:
    """Draw limit depth and chatter frequency over spindle speed with the cutting tests."""
    entries: list[tuple[Artist, str]] = [(_handle(looks[item.source]), item.source) for item in lobes]
    banded = next((b for item in lobes if (b := item.band()) is not None), None)
    if banded is not None:
        entries.append((Patch(facecolor="#888888", alpha=0.35), banded[2]))
    happened = outcomes(tests) if tests is not None else pd.Series(dtype=str)
    for outcome, look in _MARKERS.items():
        if (happened == outcome).any():
            entries.append((Line2D([], [], linestyle="none", **look), f"test: {outcome}"))
    height = 5.4
    top = 1.0 - _legend_height(entries) / height
    figure = _new(7.5, height)
    upper = figure.add_axes((0.09, 0.40, 0.88, top - 0.40))
    lower = figure.add_axes((0.09, 0.09, 0.88, 0.27), sharex=upper)
    for item in lobes:
        _draw_lobe(upper, lower, item, looks[item.source])
    if tests is not None:
        _draw_tests(upper, lower, tests)
    depths = [item.values("limit_depth") for item in lobes]
    cut = tests["depth_of_cut_mm"].to_numpy(dtype=float) if tests is not None else np.empty(0)
    speeds = np.concatenate([item.data["spindle_speed"].values for item in lobes])
    if np.ptp(speeds) > 0.0:
        upper.set_xlim(float(speeds.min()), float(speeds.max()))
    upper.set_ylim(0.0, depth_range(depths, cut))
    upper.set_ylabel("limit depth $a_p$ [mm]")
    upper.tick_params(labelbottom=False)
    lower.set_xlabel("spindle speed [rpm]")
    lower.set_ylabel("chatter\nfrequency [Hz]")
    _legend(figure, entries, top)
    return figure


def _draw_lobe(upper: Axes, lower: Axes, item: Lobes, look: Line) -> None:
    _plain_axes(upper)
    _plain_axes(lower)
    speed = item.data["spindle_speed"].values.astype(float)
    band = item.band()
    if band is not None:
        low, high = (np.where(np.isinf(v), 1e6, v) for v in band[:2])
        upper.fill_between(speed, low, high, color=look.colour, alpha=0.2, linewidth=0)
    curves = item.curves()
    if curves is not None:
        upper.plot(curves[0], curves[1], color=look.colour, alpha=0.45, linewidth=0.5)
    depth = item.values("limit_depth")
    finite = np.where(np.isfinite(depth), depth, np.nan)
    upper.plot(speed, finite, color=look.colour, linestyle=_STYLES[look.dash], linewidth=1.6)
    lower.plot(speed, item.values("chatter_frequency"), ".", color=look.colour, markersize=2.5)


def _draw_tests(upper: Axes, lower: Axes, tests: pd.DataFrame) -> None:
    happened = outcomes(tests)
    for outcome, look in _MARKERS.items():
        rows = tests[happened == outcome]
        speed = rows["spindle_speed_rpm"].to_numpy(dtype=float)
        shared = {"linestyle": "none", "zorder": 5, "clip_on": False, **look}
        upper.plot(speed, rows["depth_of_cut_mm"].to_numpy(dtype=float), **shared)
        if outcome == "chatter" and "chatter_frequency_Hz" in rows:
            lower.plot(speed, rows["chatter_frequency_Hz"].to_numpy(dtype=float), **shared)


def draw_compliance(measurements: Sequence[Measurement], looks: Mapping[str, Line]) -> Figure:
    """Draw the magnitudes of the compliances, one panel an entry."""
    responses, excitations = axes_of(measurements)
    span = frequency_range(measurements)
    low, high = magnitude_range(measurements, span)
    entries: list[tuple[Artist, str]] = [(_handle(looks[m.name]), m.name) for m in measurements]
    width, height = (7.5, 2.0 * len(responses) + 0.9) if len(excitations) > 1 else (6.0, 4.2)
    top = 1.0 - _legend_height(entries) / height
    figure = _new(width, height)
    grid = figure.add_gridspec(
        len(responses),
        len(excitations),
        left=0.1 if len(excitations) > 1 else 0.16,
        right=0.985,
        bottom=0.5 / height,
        top=top,
        wspace=0.06,
        hspace=0.08,
    )
    for i, r in enumerate(responses):
        for j, e in enumerate(excitations):
            axes = figure.add_subplot(grid[i, j])
            _draw_entry(axes, measurements, looks, (r, e), 1e-2 * low)
            axes.set(yscale="log", xlim=span, ylim=(low, high))
            axes.tick_params(labelbottom=i == len(responses) - 1, labelleft=j == 0)
    figure.supxlabel("frequency [Hz]", fontsize=10, y=0.08 / height)
    figure.supylabel("magnitude of the compliance [µm/N]", fontsize=10, x=0.005)
    _legend(figure, entries, top)
    return figure


def _draw_entry(
    axes: Axes,
    measurements: Sequence[Measurement],
    looks: Mapping[str, Line],
    pair: tuple[str, str],
    floor: float,
) -> None:
    """Draw one entry of everyone who claims it; an axis of logarithms has no place for zero."""
    _plain_axes(axes)
    drawn = [_draw_magnitude(axes, m, looks[m.name], pair, floor) for m in measurements if pair in m.entries]
    if not any(drawn):
        _say_empty(axes)
    name = rf"$\Phi_{{{entry_name(*pair)}}}$"
    axes.text(0.97, 0.95, name, transform=axes.transAxes, ha="right", va="top", fontsize=10)


def _draw_magnitude(axes: Axes, m: Measurement, look: Line, pair: tuple[str, str], floor: float) -> bool:
    """Draw magnitude and band where they are positive, and return whether they are anywhere."""
    values, std = m.entry(*pair), m.std(*pair)
    magnitude = 1e6 * np.abs(values)
    drawn = False
    if std is not None:
        low, high = magnitude_band(values, std, floor)
        drawn = bool((high > 0.0).any())
        if drawn:
            axes.fill_between(m.frequency, low, high, where=high > 0.0, color=look.colour, alpha=0.2, linewidth=0)
    if (magnitude > 0.0).any():
        shown = np.where(magnitude > 0.0, magnitude, np.nan)
        axes.plot(m.frequency, shown, color=look.colour, linestyle=_STYLES[look.dash], linewidth=1.0)
        drawn = True
    return drawn


def _say_empty(axes: Axes) -> None:
    place = axes.transAxes
    axes.text(0.5, 0.5, NOTHING, transform=place, ha="center", va="center", fontsize=9, color="#666666")


def draw_quality(measurements: Sequence[Measurement], looks: Mapping[str, Line]) -> Figure:
    """Draw coherence by response and the condition number of the forces."""
    measured = [m for m in measurements if not m.is_model]
    responses = [r for r in "xyz" if any(m.coherences(r) for m in measured)]
    conditioned = [m for m in measured if m.condition() is not None]
    rows = bool(responses) + bool(conditioned)
    shown = [m for m in measured if m in conditioned or any(m.coherences(r) for r in responses)]
    entries: list[tuple[Artist, str]] = [(Line2D([], [], color=looks[m.name].colour), m.name) for m in shown]
    if any(e for m in shown for r in responses for e, _ in m.coherences(r)):
        styles = [(e, _STYLES[EXCITATION_DASHES[e]]) for e in "xyz"]
        entries += [(Line2D([], [], color="#666666", linestyle=s), f"force {e}") for e, s in styles]
    height = 2.3 * rows + 0.9
    top = 1.0 - _legend_height(entries) / height
    figure = _new(7.5, height)
    grid = figure.add_gridspec(
        rows,
        max(1, len(responses)),
        left=0.09,
        right=0.985,
        bottom=0.5 / height,
        top=top,
        wspace=0.06,
        hspace=0.25,
    )
    span = frequency_range(measured)
    for j, r in enumerate(responses):
        axes = figure.add_subplot(grid[0, j])
        _draw_coherence(axes, measured, looks, r)
        axes.set(xlim=span, ylim=(-0.02, 1.05), ylabel="coherence [1]" if j == 0 else "")
        axes.tick_params(labelleft=j == 0)
    if conditioned:
        _draw_condition(figure.add_subplot(grid[rows - 1, :]), conditioned, looks, span)
    figure.supxlabel("frequency [Hz]", fontsize=10, y=0.08 / height)
    _legend(figure, entries, top)
    return figure


def _draw_coherence(axes: Axes, measured: Sequence[Measurement], looks: Mapping[str, Line], response: str) -> None:
    _plain_axes(axes)
    for m in measured:
        for e, values in m.coherences(response):
            style = _STYLES[EXCITATION_DASHES[e]]
            axes.plot(m.frequency, values, color=looks[m.name].colour, linestyle=style, linewidth=0.9)
    axes.text(0.97, 0.05, f"response {response}", transform=axes.transAxes, ha="right", fontsize=9)


def _draw_condition(
    axes: Axes, conditioned: Sequence[Measurement], looks: Mapping[str, Line], span: tuple[float, float]
) -> None:
    _plain_axes(axes)
    for m in conditioned:
        axes.semilogy(m.frequency, m.condition(), color=looks[m.name].colour, linewidth=1.0)
        half = 0.5 * float(np.median(np.diff(m.frequency))) if m.frequency.size > 1 else 0.0
        for a, b in m.bad_bands():
            axes.axvspan(a - half, b + half, color=CHATTER, alpha=0.2, linewidth=0)
    axes.axhline(BAD_CONDITION, color=CHATTER, linestyle="--", linewidth=1.0)
    axes.set(xlim=span, ylabel="condition number\nof the forces [1]")
    axes.set_ylim(1.0, max(1.3 * axes.get_ylim()[1], 2.0 * BAD_CONDITION))


def draw_spectra(spectra: Sequence[xr.Dataset]) -> Figure:
    """Draw the spectra of the cutting tests as a grid."""
    shown = spectra[:MOST_SPECTRA]
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    axes_names = sorted({str(a) for s in shown for a in s["axis"].values})
    entries: list[tuple[Artist, str]] = [(Line2D([], [], color=AXIS_COLOURS.get(a, "#000000")), a) for a in axes_names]
    if any(harmonic_bands(s) for s in shown):
        entries.append((Patch(facecolor="#777777", alpha=0.3), "removed harmonics"))
    entries.append((Line2D([], [], color=CHATTER, linestyle=":"), "chatter line"))
    if any(predicted_lines(s, np.inf) for s in shown):
        entries.append((Line2D([], [], color=CHATTER, linestyle="", marker="v"), "predicted by lobes"))
    if any(np.isfinite(float(s.attrs.get("threshold_amplitude", np.nan))) for s in shown):
        entries.append((Line2D([], [], color=CHATTER, linestyle="--"), "threshold"))
    width, height = (2.6 * columns + 0.6 if columns > 1 else 5.5), 2.2 * rows + 0.9
    note = 0.22 if len(spectra) > len(shown) else 0.0
    top = 1.0 - (_legend_height(entries) + 0.25 + note) / height
    figure = _new(width, height)
    grid = figure.add_gridspec(
        rows, columns, left=0.75 / width, right=0.985, bottom=0.5 / height, top=top, wspace=0.28, hspace=0.42
    )
    end = common_end(spectra)
    for position, dataset in enumerate(shown):
        _draw_spectrum(figure.add_subplot(grid[divmod(position, columns)]), dataset, end)
    figure.supxlabel("frequency [Hz]", fontsize=10, y=0.08 / height)
    figure.supylabel(literal(amplitude_label(shown[0])), fontsize=10, x=0.08 / width)
    if note:
        text = f"the first {len(shown)} of {len(spectra)} tests"
        figure.text(0.5, 1.0 - 0.18 / height, text, ha="center", fontsize=9)
    _legend(figure, entries, top + 0.2 / height)
    return figure


def _draw_spectrum(axes: Axes, dataset: xr.Dataset, end: float) -> None:
    _plain_axes(axes)
    _, floor, top = spectrum_span(dataset)
    pairs = [(a, b) for a, b in harmonic_bands(dataset) if a < end]
    axes.broken_barh([(a, b - a) for a, b in pairs], (1e-3 * floor, 1e3 * top), facecolor="#777777", alpha=0.25)
    frequency = dataset["frequency"].values.astype(float)
    inside = frequency <= end
    for axis in dataset["axis"].values:
        values = dataset["amplitude"].sel(axis=axis).values[inside]
        axes.plot(frequency[inside], values, color=AXIS_COLOURS.get(str(axis), "#000000"), linewidth=0.7)
    line = float(dataset.attrs.get("chatter_frequency_Hz", np.nan))
    threshold = float(dataset.attrs.get("threshold_amplitude", np.nan))
    if np.isfinite(line):
        axes.axvline(line, color=CHATTER, linestyle=":", linewidth=1.2)
    if np.isfinite(threshold):
        axes.axhline(threshold, color=CHATTER, linestyle="--", linewidth=1.0)
    marks = list(predicted_lines(dataset, end).values())
    axes.plot(marks, [0.97] * len(marks), "v", color=CHATTER, markersize=4.5, transform=axes.get_xaxis_transform())
    axes.set(yscale="log", xlim=(0.0, end), ylim=(floor, top))
    attrs = dataset.attrs
    cut = f"{number(attrs.get('spindle_speed_rpm'))} rpm, {number(attrs.get('depth_of_cut_mm'))} mm"
    axes.set_title(literal(f"{cut}: {attrs.get('verdict', '')}"), fontsize=8.5)
