"""The picture of the ranking: method and controller over spindle speed, a mark a cutting test."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from smfe.reporting.content.ranking import WORDS, grid, speeds
from smfe.reporting.content.style import CHATTER, STABLE, literal, number

_LOOKS: dict[str, dict[str, Any]] = {
    "right": {"marker": "o", "color": STABLE},
    "falsely_stable": {"marker": "v", "color": CHATTER},
    "falsely_unstable": {"marker": "^", "markeredgecolor": CHATTER, "markerfacecolor": "white", "markeredgewidth": 1.6},
    "undecided": {"marker": "s", "markeredgecolor": "#666666", "markerfacecolor": "white"},
}
"""Told apart by their form: colour alone would not do."""

_ROW = 5
"""Marks beside each other in a cell."""


def draw_ranking(ranking: pd.DataFrame) -> Figure:
    """Draw a cell a method, controller and speed, with a mark a cutting test."""
    rows, across = grid(ranking), speeds(ranking)
    lines = [max(1, *(-(-sum(cell.values()) // _ROW) for cell in row.cells)) for row in rows]
    height = 1.5 + 0.24 * sum(line + 1 for line in lines)
    figure = Figure(figsize=(max(7.0, 2.9 + 0.75 * len(across)), height), dpi=150, layout="constrained")
    axes = figure.subplots()
    tops = np.cumsum([0.0, *[line + 1.0 for line in lines]])
    for top, row in zip(tops, rows, strict=False):
        for column, cell in enumerate(row.cells):
            marks = [kind for kind in _LOOKS for _ in range(cell.get(kind, 0))]
            for i, kind in enumerate(marks):
                in_line = min(_ROW, len(marks) - _ROW * (i // _ROW))
                x = column + 0.15 * (i % _ROW - 0.5 * (in_line - 1))
                axes.plot(x, top + i // _ROW + 0.5, markersize=6, linestyle="", **_LOOKS[kind])
    names = [literal(", ".join(filter(None, [row.method, row.controller]))) for row in rows]
    axes.set_yticks([top + 0.5 * line for top, line in zip(tops, lines, strict=False)], names)
    axes.set_xticks(range(len(across)), [number(v) for v in across])
    axes.set(xlabel="spindle speed [rpm]", xlim=(-0.6, len(across) - 0.4), ylim=(tops[-1] - 0.5, -0.5))
    shares = axes.secondary_yaxis("right")
    shares.set_yticks(
        [top + 0.5 * line for top, line in zip(tops, lines, strict=False)], [row.share for row in rows], fontsize=8
    )
    shares.tick_params(length=0)
    for line in tops[1:-1]:
        axes.axhline(line - 0.5, color="#dddddd", linewidth=0.7)
    used = {kind for row in rows for cell in row.cells for kind in cell}
    handles = [Line2D([], [], linestyle="", label=WORDS[k], **look) for k, look in _LOOKS.items() if k in used]
    figure.legend(handles=handles, loc="outside upper left", ncols=2, frameon=False, fontsize=9)
    axes.tick_params(length=0)
    for side in (*axes.spines.values(), *shares.spines.values()):
        side.set_visible(False)
    return figure
