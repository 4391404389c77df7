"""A page for the wall beside the machine: which cut, how sure, and the lobes around it."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from process.errors import InputError
from smfe.reporting.content.results import Lobes, Results, read_results
from smfe.reporting.content.style import CHATTER, literal, number
from smfe.reporting.figures import figure_data
from smfe.results import write_atomically
from stability.tables.presets import milling

FORMATS = (".pdf", ".png", ".svg")
"""Kinds of files that the sheet is written as."""

_A4 = (8.27, 11.69)
_INK, _QUIET, _SAFE = "#111111", "#555555", "#0072B2"
_MOST_ROWS = 6

_COLUMNS = (
    ("cut", "cut", ""),
    ("width\n[mm]", "width_of_cut_mm", "g"),
    ("speed\n[rpm]", "spindle_speed_rpm", ".0f"),
    ("depth\n[mm]", "depth_of_cut_mm", ".1f"),
    ("feed a tooth\n[mm]", "feed_per_tooth_mm", "g"),
    ("feed\n[mm/min]", "feed_mm_min", ".0f"),
    ("cutting speed\n[m/min]", "cutting_speed_m_min", ".0f"),
    ("removal\n[cm³/min]", "removal_rate_cm3_min", ".1f"),
)


def write_sheet(folder: Path, path: Path, document: Mapping[str, Any]) -> Path:
    """Write the setup sheet of a folder of results.

    Parameters
    ----------
    folder : Path
        Results of a run.
    path : Path
        ``.pdf``, ``.png`` or ``.svg``; A4, upright.
    document : mapping
        Content of its ``presets.json``.

    Raises
    ------
    InputError
        When the suffix is another, or the folder holds no lobes.
    """
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"'{path}': a setup sheet is a {', '.join(FORMATS[:-1])} or {FORMATS[-1]} file")
    results = read_results(folder)
    figure = draw_sheet(results, document)
    kind = path.suffix.lower().lstrip(".")
    # Without a date the same results make the same file.
    metadata = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(kind, {})
    return write_atomically(path, lambda p: figure.savefig(p, format=kind, metadata=metadata, dpi=150))


def draw_sheet(results: Results, document: Mapping[str, Any]) -> Figure:
    """Draw the sheet."""
    answer = document["recommendation"]
    figure = Figure(figsize=_A4)
    tool = answer["tool"]
    figure.text(0.07, 0.955, literal(answer["machine"]), fontsize=20, weight="bold", color=_INK, va="top")
    figure.text(
        0.07,
        0.922,
        literal(f"{tool['name']}  ·  {answer['material']}  ·  {milling(answer['cut'])}"),
        fontsize=12.5,
        color=_INK,
        va="top",
    )
    _say_answer(figure, answer)
    rows = [a for a in document["recommendations"] if a["status"] == "recommended"]
    if len(rows) > 1:
        _table(figure, rows[:_MOST_ROWS])
    lobes = next(
        (
            item
            for item in results.lobes
            if item.source == answer["source"] and item.request.split("/")[0] == answer["lobes"]
        ),
        None,
    )
    if lobes is not None:
        height = 0.27 if len(rows) > 1 else 0.37
        _draw_lobes(figure.add_axes((0.11, 0.315, 0.82, height)), lobes, answer)
    _say_conditions(figure, answer, results)
    return figure


def _say_answer(figure: Figure, answer: Mapping[str, Any]) -> None:
    """Write the numbers large, or in as large letters that there is none."""
    if answer["status"] != "recommended":
        known = answer["status"] == "limit_only"
        title = "LIMIT, UNCERTAINTY UNKNOWN" if known else "NO RECOMMENDATION"
        figure.text(0.07, 0.855, title, fontsize=22, weight="bold", color=CHATTER, va="top")
        text = answer["reason"]
        if known and answer["limit_depth_mm"] is not None:
            at = f"limit {number(answer['limit_depth_mm'], 3)} mm at {number(answer['spindle_speed_rpm'])} rpm. "
            text = at + "No safe depth is given: cut less, and test. " + text
        figure.text(0.07, 0.815, literal(textwrap.fill(text, 88)), fontsize=11, color=_INK, va="top", linespacing=1.4)
        return
    shown = (
        ("spindle speed", f"{answer['spindle_speed_rpm']:.0f}", "rpm"),
        ("depth of cut", f"{answer['depth_of_cut_mm']:.1f}", "mm"),
        ("width of cut", f"{answer['width_of_cut_mm']:g}", "mm"),
        ("feed", f"{answer['feed_mm_min']:.0f}", "mm/min"),
    )
    for at, (what, value, unit) in zip(np.linspace(0.07, 0.75, len(shown)), shown, strict=True):
        figure.text(at, 0.868, what, fontsize=10.5, color=_QUIET, va="top")
        figure.text(at, 0.848, value, fontsize=32, weight="bold", color=_INK, va="top")
        figure.text(at, 0.797, unit, fontsize=11, color=_QUIET, va="top")
    line = (
        f"feed a tooth {answer['feed_per_tooth_mm']:g} mm  ·  cutting speed {answer['cutting_speed_m_min']:.0f} m/min"
        f"  ·  removal {answer['removal_rate_cm3_min']:.1f} cm³/min"
    )
    figure.text(0.07, 0.765, line, fontsize=11, color=_INK, va="top")
    sure = (
        f"Stable with {100.0 * answer['probability']:g} % from {answer['speed_from_rpm']:.0f} to "
        f"{answer['speed_to_rpm']:.0f} rpm. Outside, and deeper, it may chatter."
    )
    figure.text(0.07, 0.740, sure, fontsize=11, weight="bold", color=_SAFE, va="top")


def _table(figure: Figure, rows: Sequence[Mapping[str, Any]]) -> None:
    axes = figure.add_axes((0.07, 0.605, 0.86, 0.115))
    axes.set_axis_off()
    cells = [[format(row[key], form) if form else str(row[key]) for _, key, form in _COLUMNS] for row in rows]
    table = axes.table(cells, colLabels=[title for title, _, _ in _COLUMNS], loc="upper center", cellLoc="right")
    table.auto_set_font_size(False)
    table.set_fontsize(8)
    for (row, _), cell in table.get_celld().items():
        cell.set_linewidth(0.4)
        cell.set_height(0.30 if row == 0 else 0.16)


def _draw_lobes(axes: Axes, lobes: Lobes, answer: Mapping[str, Any]) -> None:
    speed = lobes.data["spindle_speed"].values.astype(float)
    limit = figure_data.finite_depth(lobes)
    safe = lobes.values("safe_depth") if "safe_depth" in lobes.data else None
    top = figure_data.highest_depth([lobes], None)
    if answer["status"] == "recommended":
        top = max(top, 1.15 * answer["depth_of_cut_mm"])
    lower = limit if safe is None else np.where(np.isfinite(safe), safe, 0.0)
    axes.fill_between(speed, np.minimum(limit, top), top, color=CHATTER, alpha=0.16, linewidth=0)
    axes.fill_between(speed, 0.0, np.minimum(lower, top), color=_SAFE, alpha=0.14, linewidth=0)
    axes.plot(speed, limit, color=CHATTER, linewidth=1.6, label="limit")
    if safe is not None:
        axes.plot(speed, safe, color=_SAFE, linewidth=1.6, linestyle="--", label="safe")
    if answer["status"] == "recommended":
        axes.plot(
            answer["spindle_speed_rpm"], answer["depth_of_cut_mm"], "o", color=_INK, markersize=9, label="cut here"
        )
    axes.set_xlim(speed[0], speed[-1])
    axes.set_ylim(0.0, top)
    axes.set_xlabel("spindle speed [rpm]")
    axes.set_ylabel("depth of cut [mm]")
    axes.grid(True, color="#dddddd", linewidth=0.5)
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False, fontsize=9)


def _say_conditions(figure: Figure, answer: Mapping[str, Any], results: Results) -> None:
    lines = [answer["reason"], *(f"{text[:1].upper()}{text[1:].rstrip('.')}." for text in answer["assumptions"])]
    lines.append("Holds for this machine, tool, material and feed, with a sharp tool, and for stability alone.")
    text = "\n".join(textwrap.fill(line, 108) for line in lines)
    figure.text(0.07, 0.255, literal(text), fontsize=9, color=_INK, va="top", linespacing=1.45)
    made = str(results.provenance.get("created", ""))[:10]
    versions = results.provenance.get("versions", {})
    version = versions.get("smfe", "") if isinstance(versions, dict) else ""
    figure.text(0.07, 0.045, f"smfe {version}  ·  computed {made}".strip(), fontsize=8, color=_QUIET)
    figure.text(0.62, 0.045, "checked: ______________________", fontsize=8, color=_QUIET)
