"""The figures as PNG, for papers and slides: matplotlib's object interface, no global state."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
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
from matplotlib.patches import Patch, Rectangle

from process.types import Real
from smfe.limits.depth_bands import AGAIN, FIRST, LOST, unpacked
from smfe.reporting.content.conditions import cubes
from smfe.reporting.content.headline import outcomes
from smfe.reporting.content.ranking import grid
from smfe.reporting.content.results import BAD_CONDITION, Lobes, Measurement, Results
from smfe.reporting.content.style import (
    ADVICE,
    AXIS_COLOURS,
    CHATTER,
    CURVE_COLOURS,
    RECORD,
    SAFE_DASH,
    STABLE,
    Line,
    literal,
    number,
    spoken,
)
from smfe.reporting.figures import figure_data, spectrograms
from smfe.reporting.figures.draw_diagnosis import draw_compared, draw_depths, draw_search
from smfe.reporting.figures.draw_ranking import draw_ranking
from smfe.reporting.figures.lobe_data import KICKED, LONGEST_NAME, SAFE, Diagram, advice_name, diagram, single_lobes
from smfe.reporting.figures.thinning import columns_of, largest
from smfe.reporting.maps.contours import draw_maps, draw_widths
from smfe.reporting.maps.images import picture_name
from smfe.results import write_atomically

DPI = 150
MOST_SPECTRA = 24
"""The picture of the spectra holds no more; the HTML file has all."""

MOST_NAMES = 21
"""Entries of a legend; of more the first and the last are named."""

SPECTRUM_COLUMNS = 250
"""Points over the width of a small spectrum, each the largest amplitude of its column."""

NOTHING = "nothing to draw:\nzero or not known"
"""What a panel says that has no positive value for its logarithmic axis."""

_STYLES: dict[str, Any] = {
    "solid": "-",
    "dash": "--",
    "dot": ":",
    "dashdot": "-.",
    "longdash": (0, (9, 3)),
    "longdashdot": (0, (9, 3, 2, 3)),
}
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

_STAR: dict[str, Any] = {"marker": "*", "color": ADVICE, "markersize": 15, "markeredgecolor": "black"}

Draw = partial[Figure]


def pictures(results: Results, looks: Mapping[str, Line]) -> dict[str, Draw]:
    """Return file name -> function that draws it, for everything that there is."""
    out: dict[str, Draw] = {}
    for position, (request, lobes) in enumerate(results.requests.items(), 1):
        name = re.sub(r"[^\w-]", "_", request) or f"lobes_{position}"
        out[f"{name}.png"] = partial(
            draw_lobes, lobes, figure_data.tests_of(results.chatter, request), looks, results.advice.get(request)
        )
        for item in lobes:
            bands = unpacked(item.data)
            if bands is not None:
                name = picture_name("bands", request, item.source)
                out[name] = partial(draw_bands, bands, f"{request}, {item.source}")
            maps = results.maps.get(f"{request}/{item.source}")
            if maps is not None:
                name = picture_name("maps", request, item.source)
                out[name] = partial(draw_maps, maps, f"{request}, {item.source}")
    for group, limits in results.widths.items():
        request, _, source = group.partition("/")
        out[picture_name("widths", request, source)] = partial(draw_widths, limits, f"{request}, {source}")
    shown = [m for m in results.measurements if m.entries]
    if shown:
        out["compliance.png"] = partial(draw_compliance, shown, looks)
    for position, cube in enumerate(cubes(results.conditions), 1):
        out[f"conditions_{position}.png"] = partial(draw_compliance, cube.cells, cube.looks)
    for position, dataset in enumerate(results.loops.values(), 1):
        out[f"loop_{position}.png"] = partial(draw_loop, dataset)
    for position, frame in enumerate(figure_data.frictions(results.tables).values(), 1):
        out[f"drive_{position}.png"] = partial(draw_drive, frame)
    for position, (name, curves) in enumerate(figure_data.open_loops(results.open_loops).items(), 1):
        marks = figure_data.open_loop_marks(results.open_loops, name)
        out[f"open_loop_{position}.png"] = partial(draw_open_loop, curves, marks)
    if any(figure_data.quality_panels(shown)[1:]):
        out["condition.png"] = partial(draw_quality, shown, looks)
    if results.spectra:
        out["spectra.png"] = partial(draw_spectra, list(results.spectra.values()))
    with_picture = spectrograms.pictured(list(results.spectra.values()))
    if with_picture:
        out["spectrograms.png"] = partial(spectrograms.draw, with_picture)
    if results.ranking is not None and grid(results.ranking):
        out["ranking.png"] = partial(draw_ranking, results.ranking)
    if results.curves is not None:
        out["diagnosis.png"] = partial(draw_compared, results.curves)
    if figure_data.stable_depths(results.finding):
        out["diagnosis_depth.png"] = partial(draw_depths, results.finding)
    if figure_data.has_diagnosis(results.finding):
        out["diagnosis_search.png"] = partial(draw_search, results.finding)
    return out


def remove_stale(folder: Path, kept: Mapping[str, Draw]) -> None:
    """Delete pictures of ours that an earlier report wrote and this one does not."""
    for pattern in (
        "lobes_*.png",
        "bands_*.png",
        "maps_*.png",
        "widths_*.png",
        "conditions_*.png",
        "drive_*.png",
        "loop_*.png",
        "open_loop_*.png",
        "compliance.png",
        "condition.png",
        "spectra.png",
        "spectrograms.png",
        "ranking.png",
        "diagnosis*.png",
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
    entries = _named(entries)
    handles, names = [h for h, _ in entries], [literal(spoken(n)) for _, n in entries]
    columns = _columns(entries, figure.get_figwidth())
    figure.legend(
        handles,
        names,
        loc="lower center",
        bbox_to_anchor=(0.5, top),
        ncols=columns,
        frameon=False,
        fontsize=9,
        handlelength=3.2,
    )


def _legend_height(entries: Sequence[tuple[Artist, str]], width: float = 7.5) -> float:
    """Return the height [inch] that `_legend` needs in a figure of a width [inch]."""
    named = _named(entries)
    return 0.2 * -(-len(named) // _columns(named, width)) + 0.12


def _named(entries: Sequence[tuple[Artist, str]]) -> list[tuple[Artist, str]]:
    """Return what the legend names: all, or of many the first and the last, which say what the marks are."""
    more = len(entries) - MOST_NAMES
    if more <= 0:
        return list(entries)
    return [*entries[: MOST_NAMES - 7], (Line2D([], [], linestyle="none"), f"and {more + 1} more"), *entries[-6:]]


def _columns(entries: Sequence[tuple[Artist, str]], width: float) -> int:
    """Return how many names stand beside each other: some 13 letters an inch, and a line of 8 letters before each."""
    longest = max(len(n) for _, n in entries)
    return max(1, min(len(entries), int(95 / 7.5 * width / (8 + longest))))


def _handle(look: Line) -> Line2D:
    return Line2D([], [], color=look.colour, linestyle=_STYLES[look.dash], linewidth=1.6)


def _plain_axes(axes: Axes) -> None:
    axes.grid(True, color="#dddddd", linewidth=0.5)
    axes.tick_params(labelsize=8, direction="in", which="both")


def draw_lobes(
    lobes: Sequence[Lobes],
    tests: pd.DataFrame | None,
    looks: Mapping[str, Line],
    advice: Mapping[str, Any] | None = None,
) -> Figure:
    """Draw limit depth and chatter frequency over spindle speed, as the page does; the recommended cut is marked."""
    shown = diagram(lobes, tests, advice)
    entries: list[tuple[Artist, str]] = [(_handle(looks[item.source]), spoken(item.source)) for item in lobes]
    kicked = [] if shown.single else [(i, kick) for i in lobes if (kick := i.lower()) is not None]
    entries += [(Line2D([], [], **_kicked(looks[i.source])), f"{spoken(i.source)}: {KICKED}") for i, _ in kicked]
    if shown.safe is not None:
        entries.append((_handle(Line("#000000", SAFE_DASH)), f"{SAFE} of {spoken(shown.main.source)}"))
    happened = outcomes(tests) if tests is not None else pd.Series(dtype=str)
    for outcome, look in _MARKERS.items():
        if (happened == outcome).any():
            entries.append((Line2D([], [], linestyle="none", **look), f"test: {outcome}"))
    if shown.point is not None:
        entries.append((Line2D([], [], linestyle="none", **_STAR), advice_name(shown.point[2])))
    height = 5.4
    top = 1.0 - _legend_height(entries) / height
    figure = _new(7.5, height)
    longest = max((min(len(text), LONGEST_NAME) for _, text, *_ in shown.ends(0.05)), default=0)
    width = 0.76 - 0.009 * max(longest - 10, 0)  # room for the names at the ends of the lines
    upper = figure.add_axes((0.09, 0.36, width, top - 0.36))
    lower = figure.add_axes((0.09, 0.09, width, 0.22), sharex=upper)
    _draw_regions(upper, shown, looks[shown.main.source])
    for item in lobes:
        main, line = item is shown.main, looks[item.source]
        style = {"color": line.colour, "linestyle": _STYLES[line.dash], "linewidth": 2.6 if main else 1.3}
        if shown.single:
            style = {"color": line.colour, "linestyle": "none", "marker": "D" if main else "s", "markersize": 5}
        upper.plot(_speeds(item), figure_data.finite_depth(item), zorder=2 if main else 3, **style)
        lower.plot(_speeds(item), item.values("chatter_frequency"), ".", color=line.colour, markersize=2.5)
    for item, kick in kicked:
        upper.plot(_speeds(item), kick, markevery=max(1, kick.size // 12), **_kicked(looks[item.source]))
    if shown.safe is not None:
        safe = {"marker": "_", "linestyle": "none"} if shown.single else {"linestyle": _STYLES[SAFE_DASH]}
        upper.plot(*shown.safe, color="black", linewidth=1.1, zorder=4, **safe)
    if tests is not None:
        _draw_tests(upper, lower, tests)
    for axes in (upper, lower):
        _plain_axes(axes)
    if shown.span[0] < shown.span[1]:
        upper.set_xlim(*shown.span)
    upper.set_ylim(0.0, shown.top)
    _draw_words(upper, shown, tests)
    upper.set_ylabel("depth of cut $a_p$ [mm]")
    upper.tick_params(labelbottom=False)
    lower.set_xlabel("spindle speed [rpm]")
    lower.set_ylabel("chatter\nfrequency [Hz]")
    _legend(figure, entries, top)
    return figure


def _kicked(look: Line) -> dict[str, Any]:
    """Return how a limit after a kick is drawn: a source may be dashed itself, and a few rings tell the two."""
    ring = {"marker": "o", "markersize": 3.5, "markerfacecolor": "none", "markeredgewidth": 0.8}
    return {"color": look.colour, "linestyle": _STYLES["dash"], "linewidth": 1.0, **ring}


def _speeds(item: Lobes) -> Real:
    return np.asarray(item.data["spindle_speed"].values, dtype=float)


def _draw_regions(axes: Axes, shown: Diagram, look: Line) -> None:
    """Shade where the source of the answer calls the cut stable, and where it says chatter; draw its single lobes."""
    if shown.single:
        axes.bar(shown.speed, shown.floor, shown.width, color=STABLE, alpha=0.22)
        axes.bar(shown.speed, shown.top - shown.limit, shown.width, shown.limit, color=CHATTER, alpha=0.18)
        return
    axes.fill_between(shown.speed, 0.0, shown.floor, color=STABLE, alpha=0.13, linewidth=0)
    axes.fill_between(shown.speed, shown.limit, shown.top, color=CHATTER, alpha=0.10, linewidth=0)
    band = shown.main.band()
    if band is not None:
        low, high = (np.minimum(v, 2.0 * shown.top) for v in band[:2])
        axes.fill_between(shown.speed, low, high, color=look.colour, alpha=0.22, linewidth=0)
    single = single_lobes(shown.main, shown.span, shown.top)
    if single is not None:
        axes.plot(*single, color=look.colour, alpha=0.5, linewidth=0.5)


def _draw_words(axes: Axes, shown: Diagram, tests: pd.DataFrame | None) -> None:
    """Write what the regions are, the names at the ends of the lines, and the recommended cut."""
    for word, (speed, depth) in shown.places(tests).items():
        axes.text(speed, depth, word, ha="center", va="center", fontsize=11, color="#444444")
    for _, text, end, place in shown.ends(0.05):
        name = literal(text if len(text) <= LONGEST_NAME else f"{text[: LONGEST_NAME - 1]}…")
        axes.annotate(
            name,
            (1.0, end),
            (1.04, place),
            xycoords=axes.get_yaxis_transform(),
            fontsize=8,
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": "#555555", "linewidth": 0.6, "shrinkA": 1, "shrinkB": 0},
        )
    if shown.point is not None:
        speed, depth, text = shown.point
        axes.plot([speed], [depth], linestyle="none", zorder=7, **_STAR)
        left = speed > 0.5 * sum(shown.span)
        axes.annotate(
            text,
            (speed, depth),
            (-45 if left else 45, -26),
            textcoords="offset points",
            ha="right" if left else "left",
            va="center",
            fontsize=9,
            fontweight="bold",
            zorder=8,
            bbox={"facecolor": "white", "edgecolor": "black", "linewidth": 0.7, "pad": 2.5},
            arrowprops={"arrowstyle": "->", "linewidth": 0.8, "shrinkB": 6},
        )


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
    responses, excitations = figure_data.axes_of(measurements)
    span = figure_data.frequency_range(measurements)
    low, high = figure_data.magnitude_range(measurements, span)
    entries: list[tuple[Artist, str]] = [(_handle(looks[m.name]), m.name) for m in measurements]
    width, height = (7.5, 2.0 * len(responses) + 0.9) if len(excitations) > 1 else (6.0, 4.2)
    top = 1.0 - _legend_height(entries, width) / height
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
    name = rf"$\Phi_{{{figure_data.entry_name(*pair)}}}$"
    axes.text(0.97, 0.95, name, transform=axes.transAxes, ha="right", va="top", fontsize=10)


def _draw_magnitude(axes: Axes, m: Measurement, look: Line, pair: tuple[str, str], floor: float) -> bool:
    """Draw magnitude and band where they are positive, and return whether they are anywhere."""
    values, std = m.entry(*pair), m.std(*pair)
    magnitude = 1e6 * np.abs(values)
    drawn = False
    if std is not None:
        low, high = figure_data.magnitude_band(values, std, floor)
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
    """Draw coherence, a panel an entry where it is known for each force, and the condition number of the forces."""
    measured, responses, conditioned = figure_data.quality_panels(measurements)
    forces = [e for e in "xyz" if any(e == own for m in measured for r in responses for own, _ in m.coherences(r))]
    shown = [m for m in measured if m in conditioned or any(m.coherences(r) for r in responses)]
    entries: list[tuple[Artist, str]] = [(_handle(looks[m.name]), m.name) for m in shown]
    # Without a force a response has one coherence; three of them stand side by side.
    cells = (
        [[(r, e) for e in forces] for r in responses] if forces else [[(r, "") for r in responses]] * bool(responses)
    )
    heights = [1.7 if forces else 2.3] * len(cells) + [2.3] * bool(conditioned)
    height = sum(heights) + 0.9
    top = 1.0 - _legend_height(entries) / height
    figure = _new(7.5, height)
    room = {"left": 0.09, "right": 0.985, "bottom": 0.5 / height, "top": top}
    grid = figure.add_gridspec(len(heights), 1, **room, height_ratios=heights, hspace=0.22)
    span = figure_data.frequency_range(measured)
    for i, row in enumerate(cells):
        panels = grid[i, 0].subgridspec(1, len(row), wspace=0.06)
        for j, (r, e) in enumerate(row):
            axes = figure.add_subplot(panels[0, j])
            _draw_coherence(axes, measured, looks, r, e)
            axes.set(xlim=span, ylim=(-0.02, 1.05), ylabel="coherence [1]" if j == 0 else "")
            axes.tick_params(labelleft=j == 0)
    if conditioned:
        _draw_condition(figure.add_subplot(grid[len(cells), 0]), conditioned, looks, span)
    figure.supxlabel("frequency [Hz]", fontsize=10, y=0.08 / height)
    _legend(figure, entries, top)
    return figure


def _draw_coherence(
    axes: Axes, measured: Sequence[Measurement], looks: Mapping[str, Line], response: str, force: str
) -> None:
    """Draw the coherence of an entry; one of a response alone stands with each of its forces."""
    _plain_axes(axes)
    for m in measured:
        for e, values in m.coherences(response):
            if e in ("", force):
                look = looks[m.name]
                axes.plot(m.frequency, values, color=look.colour, linestyle=_STYLES[look.dash], linewidth=0.9)
    said = f"{response}{force}" if force else f"response {response}"
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    axes.text(0.97, 0.06, said, transform=axes.transAxes, ha="right", fontsize=9, bbox=box)


def _draw_condition(
    axes: Axes, conditioned: Sequence[Measurement], looks: Mapping[str, Line], span: tuple[float, float]
) -> None:
    _plain_axes(axes)
    for m in conditioned:
        look = looks[m.name]
        axes.semilogy(m.frequency, m.condition(), color=look.colour, linestyle=_STYLES[look.dash], linewidth=1.0)
        for low, high in figure_data.badly_conditioned(m):
            axes.axvspan(low, high, color=CHATTER, alpha=0.2, linewidth=0)
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
    if any(figure_data.harmonic_bands(s) for s in shown):
        entries.append((Patch(facecolor="#777777", alpha=0.3), "removed harmonics"))
    entries.append((Line2D([], [], color=CHATTER, linestyle=":"), "chatter line"))
    if any(figure_data.predicted_lines(s, np.inf) for s in shown):
        entries.append((Line2D([], [], color=CHATTER, linestyle="", marker="v"), "predicted by lobes"))
    if any(np.isfinite(figure_data.chatter_marks(s)[0]) for s in shown):
        entries.append((Line2D([], [], color=CHATTER, linestyle="--"), "threshold"))
    width, height = (2.6 * columns + 0.6 if columns > 1 else 5.5), 2.2 * rows + 0.9
    note = 0.22 if len(spectra) > len(shown) else 0.0
    top = 1.0 - (_legend_height(entries, width) + 0.25 + note) / height
    figure = _new(width, height)
    grid = figure.add_gridspec(
        rows, columns, left=0.75 / width, right=0.985, bottom=0.5 / height, top=top, wspace=0.28, hspace=0.42
    )
    end = figure_data.common_end(spectra)
    for position, dataset in enumerate(shown):
        _draw_spectrum(figure.add_subplot(grid[divmod(position, columns)]), dataset, end)
    figure.supxlabel("frequency [Hz]", fontsize=10, y=0.08 / height)
    figure.supylabel(literal(figure_data.amplitude_label(shown[0])), fontsize=10, x=0.08 / width)
    if note:
        text = f"the first {len(shown)} of {len(spectra)} tests"
        figure.text(0.5, 1.0 - 0.18 / height, text, ha="center", fontsize=9)
    _legend(figure, entries, top + 0.2 / height)
    return figure


def _draw_spectrum(axes: Axes, dataset: xr.Dataset, end: float) -> None:
    _plain_axes(axes)
    _, floor, top = figure_data.spectrum_span(dataset)
    pairs = [(a, b) for a, b in figure_data.harmonic_bands(dataset) if a < end]
    axes.broken_barh([(a, b - a) for a, b in pairs], (1e-3 * floor, 1e3 * top), facecolor="#777777", alpha=0.25)
    frequency = dataset["frequency"].values.astype(float)
    # The top of each column: what is drawn up and down would hide the axes behind it.
    columns = columns_of(frequency, (0.0, end), SPECTRUM_COLUMNS, 1)
    for axis in dataset["axis"].values:
        values = dataset["amplitude"].sel(axis=axis).values.astype(float)
        kept = largest(columns, values)
        axes.plot(frequency[kept], values[kept], color=AXIS_COLOURS.get(str(axis), "#000000"), linewidth=0.7)
    threshold, line = figure_data.chatter_marks(dataset)
    if np.isfinite(line):
        axes.axvline(line, color=CHATTER, linestyle=":", linewidth=1.2)
    if np.isfinite(threshold):
        axes.axhline(threshold, color=CHATTER, linestyle="--", linewidth=1.0)
    marks = list(figure_data.predicted_lines(dataset, end).values())
    axes.plot(marks, [0.97] * len(marks), "v", color=CHATTER, markersize=4.5, transform=axes.get_xaxis_transform())
    axes.set(yscale="log", xlim=(0.0, end), ylim=(floor, top))
    attrs = dataset.attrs
    cut = f"{number(attrs.get('spindle_speed_rpm'))} rpm, {number(attrs.get('depth_of_cut_mm'))} mm"
    axes.set_title(literal(f"{cut}: {attrs.get('verdict', '')}"), fontsize=8.5)


# --- drives ----------------------------------------------------------------------------------------------------------


def draw_drive(frame: pd.DataFrame) -> Figure:
    """Draw drive force over velocity: the record, the friction curve, runs at constant velocity."""
    parts = figure_data.friction_parts(frame)
    picture = Figure(figsize=(6.0, 4.2), dpi=150, layout="constrained")
    axes = picture.subplots()
    axes.plot(parts["motion"]["velocity"], parts["motion"]["force"], ".", color=RECORD, markersize=2, label="record")
    label = "identified, with 95 % interval"
    for way in ("forward", "backward"):
        curve = parts[way]
        if len(curve):
            axes.fill_between(
                curve["velocity"], curve["low"], curve["high"], color=CURVE_COLOURS[0], alpha=0.2, linewidth=0.0
            )
            axes.plot(curve["velocity"], curve["force"], color=CURVE_COLOURS[0], linewidth=1.5, label=label)
            label = "_"
    runs = parts["runs"]
    if len(runs):
        reach = (runs["high"] - runs["force"]).to_numpy()
        axes.errorbar(
            runs["velocity"],
            runs["force"],
            reach,
            fmt="o",
            color=CURVE_COLOURS[1],
            markersize=4,
            label="runs at constant velocity",
        )
    velocity, force = figure_data.friction_titles(frame)
    axes.set(xlabel=velocity, ylabel=force)
    axes.legend(frameon=False, fontsize=9)
    axes.grid(True, color="#dddddd", linewidth=0.5)
    return picture


def draw_open_loop(curves: Sequence[figure_data.OpenLoopCurve], marks: Mapping[str, float]) -> Figure:
    """Draw an open loop: magnitude and phase, measured with its 95 % band, and Eq. (2)."""
    picture = Figure(figsize=(6.0, 4.8), dpi=150, layout="constrained")
    upper, lower = picture.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for c in curves:
        size = np.abs(c.measured)
        low = np.maximum(size - c.half, 1e-3 * size)
        upper.fill_between(c.frequency, low, size + c.half, color=c.colour, alpha=0.25, linewidth=0.0)
        upper.loglog(c.frequency, size, ".", color=c.colour, markersize=2.5, label=f"{c.name}, measured")
        upper.loglog(c.frequency, np.abs(c.fitted), color="#222222", linewidth=1.0, label=f"{c.name}, Eq. (2)")
        lower.semilogx(c.frequency, figure_data.falling_phase(c.measured), ".", color=c.colour, markersize=2.5)
        lower.semilogx(c.frequency, figure_data.falling_phase(c.fitted), color="#222222", linewidth=1.0)
    for (name, frequency), side in zip(marks.items(), ("right", "left"), strict=True):
        for axes in (upper, lower):
            axes.axvline(frequency, color="#888888", linewidth=0.7, linestyle=":")
        end = 0.99 if side == "right" else 1.01
        upper.annotate(
            f"{name} {frequency:.4g} Hz",
            (frequency * end, 1.0),
            xycoords=("data", "axes fraction"),
            ha=side,
            va="bottom",
            fontsize=8,
        )
    upper.set_ylabel(figure_data.OPEN_LOOP)
    upper.legend(frameon=False, fontsize=8)
    lower.set(ylabel=figure_data.PHASE, xlabel=figure_data.FREQUENCY)
    for axes in (upper, lower):
        axes.grid(True, color="#dddddd", linewidth=0.5)
    return picture


def draw_loop(dataset: xr.Dataset) -> Figure:
    """Draw gain and phase of a drive loop, a line a feed."""
    picture = Figure(figsize=(6.0, 4.6), dpi=150, layout="constrained")
    upper, lower = picture.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    for name, colour, gain, phase in figure_data.loop_curves(dataset):
        upper.semilogx(dataset["frequency"].values, gain, color=colour, linewidth=1.0, label=name)
        lower.semilogx(dataset["frequency"].values, phase, color=colour, linewidth=1.0)
    upper.axhline(-3.01, color="#888888", linewidth=0.7, linestyle="--")
    upper.set_ylabel(figure_data.GAIN)
    upper.legend(frameon=False, fontsize=9)
    lower.set(ylabel=figure_data.PHASE, xlabel=figure_data.FREQUENCY, ylim=(-180, 180), yticks=(-180, -90, 0, 90, 180))
    for axes in (upper, lower):
        axes.grid(True, color="#dddddd", linewidth=0.5)
    return picture


_SHADES = {LOST: (CHATTER, 0.30, "chatter"), AGAIN: (STABLE, 0.35, "stable again: islands and tongues")}
"""Kind of a band of depth -> its colour, opacity and name."""


def draw_bands(bands: pd.DataFrame, title: str = "") -> Figure:
    """Return the picture of the bands of one source over the spindle speed.

    Parameters
    ----------
    bands : DataFrame
        As `smfe.limits.depth_bands.bands_over` returns them.
    title : str, optional
        Which request and source.
    """
    figure = Figure(figsize=(9.0, 5.0), dpi=DPI, layout="constrained")
    ax = figure.subplots()
    speeds = np.unique(bands["spindle_speed_rpm"].to_numpy())
    edges = _strips(speeds)
    place = dict(zip(speeds.tolist(), range(speeds.size), strict=True))
    for band, group in bands.groupby("band"):
        if band == FIRST:
            continue
        colour, opacity, _ = _SHADES[str(band)]
        for speed, low, high in zip(group["spindle_speed_rpm"], group["from_mm"], group["to_mm"], strict=True):
            left, right = edges[place[speed]].item(), edges[place[speed] + 1].item()
            ax.add_patch(Rectangle((left, low), right - left, high - low, color=colour, alpha=opacity, lw=0))
    first = bands[bands["band"] == FIRST]
    deepest = float(bands["to_mm"].max())
    limit = np.where(first["to_mm"] < deepest, first["to_mm"], np.nan)
    (line,) = ax.plot(first["spindle_speed_rpm"], limit, color="k", lw=1.6)
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylim(0.0, deepest)
    ax.set_xlabel("spindle speed [rpm]")
    ax.set_ylabel("depth of cut [mm]")
    ax.set_title(literal(title), fontsize="medium")
    shown = [(Patch(color=c, alpha=o), word) for b, (c, o, word) in _SHADES.items() if b in set(bands["band"])]
    handles, labels = zip((line, "first loss of stability"), *shown, strict=True)
    figure.legend(handles, labels, loc="outside lower center", ncols=3, frameon=False)
    return figure


def _strips(speeds: Real) -> Real:
    """Return the borders between the strips of neighbouring speeds [rpm]."""
    if speeds.size == 1:
        return np.array([0.99, 1.01]) * float(speeds[0])
    middle = 0.5 * (speeds[1:] + speeds[:-1])
    return np.asarray(np.concatenate([[2.0 * speeds[0] - middle[0]], middle, [2.0 * speeds[-1] - middle[-1]]]))
