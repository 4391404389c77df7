"""Pictures of a catalogue: how machines drift, how a fleet scatters, which campaigns to doubt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.ticker import Locator

from smfe.fleet.doubts import FAR, scores
from smfe.fleet.tracks import QUANTITIES, Mode, drift_table, over_machines
from smfe.reporting.content.style import CHATTER, CURVE_COLOURS, RECORD, literal
from smfe.reporting.figures.draw_matplotlib import DPI, save

MOST_MACHINES = 5
"""Machines that are drawn in colour: those whose frequencies drift most; the others are grey."""

MOST_MODES = 4
"""Modes that are drawn, those that most machines have."""

_LABELS = {"frequency": "natural frequency [Hz]", "damping": "damping ratio [%]", "amplitude": "amplitude [µm/N]"}
_FACTORS = {"frequency": 1.0, "damping": 100.0, "amplitude": 1.0}


def write_pictures(modes: Sequence[Mode], doubts: pd.DataFrame, folder: Path) -> list[Path]:
    """Write what there is to draw and return the files."""
    out = []
    if any(np.isfinite(mode.years).sum() > 1 for mode in modes):
        out.append(save(draw_drift(modes), folder / "drift.png"))
    if modes:
        out.append(save(draw_fleet(modes), folder / "fleet.png"))
    if modes and any(np.isfinite(scores(mode, "frequency")).any() for mode in modes):
        out.append(save(draw_doubts(modes, doubts), folder / "doubts.png"))
    return out


def draw_drift(modes: Sequence[Mode]) -> Figure:
    """Return natural frequency over date, a panel a mode: the machines that drift most in colour, errors as bars."""
    drift = drift_table(modes)
    drift = drift[drift["quantity"] == "frequency"].assign(size=lambda d: d["percent_per_year"].abs())
    worst = list(dict.fromkeys(drift.sort_values("size", ascending=False)["machine"]))[:MOST_MACHINES]
    worst = worst or sorted({m.machine for m in modes})[:MOST_MACHINES]
    of = (drift[name].to_list() for name in ("machine", "entry", "mode"))
    slopes = dict(zip(zip(*of, strict=True), map(float, drift["percent_per_year"]), strict=True))
    shown = sorted(over_machines(modes), key=lambda group: -len(group[2]))[:MOST_MODES]
    figure = Figure(figsize=(7.5, 0.9 + 2.6 * len(shown)), dpi=DPI, layout="constrained")
    panels = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (entry, number, same) in zip(panels, shown, strict=True):
        for mode in sorted(same, key=lambda m: m.machine in worst):
            known = np.isfinite(mode.years)
            dates, f, s = pd.to_datetime(mode.rows["date"])[known], mode.values("frequency"), mode.errors("frequency")
            if mode.machine not in worst:
                axes.plot(dates, f[known], color=RECORD, linewidth=0.6, alpha=0.6)
                continue
            slope = slopes.get((mode.machine, mode.entry, mode.number))
            said = "" if slope is None else f", {slope:+.2g} %/year".replace("-", "\u2212")
            axes.errorbar(
                dates,
                f[known],
                2.0 * s[known],
                color=CURVE_COLOURS[worst.index(mode.machine)],
                marker="o",
                markersize=3,
                linewidth=1.0,
                label=literal(f"{mode.machine}{said}"),
            )
        axes.set_ylabel("frequency [Hz]")
        axes.set_title(f"{entry}, mode {number}", fontsize=9, loc="left")
        axes.grid(True, color="#dddddd", linewidth=0.5)
        axes.legend(frameon=False, fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5))
    locator: Locator = AutoDateLocator()  # type: ignore[no-untyped-call]
    panels[-1].xaxis.set_major_locator(locator)
    panels[-1].xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]
    panels[-1].set_xlabel("date of the measurement (bars: two standard deviations)")
    return figure


def draw_fleet(modes: Sequence[Mode]) -> Figure:
    """Return frequency, damping and amplitude of each mode over the machines: every measurement, and the mean."""
    shown = sorted(over_machines(modes), key=lambda group: -len(group[2]))[:MOST_MODES]
    names = sorted({mode.machine for mode in modes})
    wide = max(3.0, min(0.28 * len(names), 6.0))
    figure = Figure(figsize=(1.2 + wide * len(shown), 6.5), dpi=DPI, layout="constrained")
    grid = figure.subplots(len(QUANTITIES), len(shown), sharex=True, squeeze=False)
    for column, (entry, number, same) in zip(grid.T, shown, strict=True):
        column[0].set_title(f"{entry}, mode {number}: {len(same)} of {len(names)} machines", fontsize=9)
        for axes, quantity in zip(column, QUANTITIES, strict=True):
            _strip(axes, same, names, quantity)
        column[-1].set_xticks(range(len(names)), [literal(n) for n in names], rotation=90, fontsize=7)
    for axes, quantity in zip(grid[:, 0], QUANTITIES, strict=True):
        axes.set_ylabel(_LABELS[quantity])
    return figure


def _strip(axes: Axes, same: Sequence[Mode], names: Sequence[str], quantity: str) -> None:
    means = []
    for mode in same:
        at, values = names.index(mode.machine), _FACTORS[quantity] * mode.values(quantity)
        axes.plot(np.full(values.size, at), values, ".", color=RECORD, markersize=3)
        means.append(float(np.exp(np.mean(np.log(values)))))
        axes.plot(at, means[-1], "_", color=CURVE_COLOURS[0], markersize=9, markeredgewidth=2)
    logs = np.log(means)
    if logs.size > 1:
        middle, spread = float(logs.mean()), float(logs.std(ddof=1))
        axes.axhspan(
            np.exp(middle - spread), np.exp(middle + spread), color=CURVE_COLOURS[0], alpha=0.10, linewidth=0.0
        )
        axes.axhline(np.exp(middle), color=CURVE_COLOURS[0], linewidth=0.6)
        axes.text(
            0.99, 0.97, f"scatter {100.0 * spread:.2g} %", transform=axes.transAxes, ha="right", va="top", fontsize=7
        )
    axes.grid(True, axis="y", color="#dddddd", linewidth=0.5)
    axes.set_xlim(-0.6, len(names) - 0.4)
    axes.margins(y=0.15)
    axes.tick_params(labelsize=8)


def draw_doubts(modes: Sequence[Mode], doubts: pd.DataFrame) -> Figure:
    """Return how far each measurement lies from the others of its machine, in robust standard deviations."""
    figure = Figure(figsize=(7.5, 4.0), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    names = sorted({mode.machine for mode in modes})
    least, told = 2.0 * FAR, {str(c) for c in doubts["campaign"]}
    marked = 0
    for number, quantity in enumerate(QUANTITIES):
        at, score, where = [], [], []
        for mode in modes:
            at += [names.index(mode.machine)] * len(mode.rows)
            score += scores(mode, quantity).tolist()
            where += [str(c) for c in mode.rows["campaign"]]
        size = np.array(score)
        axes.plot(
            np.array(at) + 0.2 * (number - 1), size, ".", color=CURVE_COLOURS[number], markersize=4, label=quantity
        )
        for i in np.argsort(-np.nan_to_num(np.abs(size))):
            if not abs(size[i]) > FAR or where[i] not in told or marked >= 8:
                break
            marked += 1
            axes.annotate(literal(where[i]), (at[i], size[i]), fontsize=6, xytext=(4, 2), textcoords="offset points")
        least = max(least, 1.15 * float(np.nanmax(np.abs(size), initial=0.0)))
    for side in (-FAR, FAR):
        axes.axhline(side, color=CHATTER, linewidth=0.8, linestyle="--")
    axes.set_yscale("symlog", linthresh=2.0 * FAR)
    axes.set_ylim(-least, least)
    axes.set_xticks(range(len(names)), [literal(n) for n in names], rotation=90, fontsize=7)
    axes.set_ylabel("robust standard deviations\nfrom the others of the machine")
    axes.grid(True, axis="y", color="#dddddd", linewidth=0.5)
    axes.legend(frameon=False, fontsize=8, ncols=3, loc="lower left")
    return figure
