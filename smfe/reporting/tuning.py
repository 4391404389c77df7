"""The figure of a search for gains: loops before and after with their limits, lobes, depth against tracking error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from process.types import Complex, Real
from smfe.reporting.content.style import CHATTER, CURVE_COLOURS, literal
from smfe.reporting.figures.draw_matplotlib import DPI, save
from smfe.tuning.result import GainSet, Tuning

_DASHES = ("-", "--", ":")
_DASH_WORDS = ("solid", "dashed", "dotted")
_GREY = "#9A9A9A"


def write_figure(found: Tuning, path: Path) -> Path:
    """Write the figure as PNG and return its path."""
    return save(draw_tuning(found), path)


def draw_tuning(found: Tuning) -> Figure:
    """Return the figure: closed velocity and position loops, lobes, depth against tracking error."""
    figure = Figure(figsize=(10.0, 7.2), dpi=DPI, layout="constrained")
    axes = figure.subplots(2, 2)
    colours = _colours(found)
    limits = found.task.limits
    _loop(axes[0, 0], found, "velocity_loop", limits.velocity_peak, colours)
    _loop(axes[0, 1], found, "position_loop", limits.position_peak, colours)
    _lobes(axes[1, 0], found, colours)
    _compromise(axes[1, 1], found, colours)
    handles, labels = axes[1, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=min(len(labels), 7), frameon=False)
    return figure


def _colours(found: Tuning) -> dict[str, str]:
    """Return a colour for each set: the answer strong, the present ones in turn, the rule grey."""
    out = {found.best.name: CURVE_COLOURS[0]}
    for number, one in enumerate(found.present):
        out[one.name] = CURVE_COLOURS[1 + number % (len(CURVE_COLOURS) - 1)]
    if found.rule:
        out[found.rule.name] = _GREY
    return out


def _name(found: Tuning, one: GainSet) -> str:
    return "rule, one bandwidth" if one is found.rule else literal(one.name)


def _loop(ax: Axes, found: Tuning, which: str, limit: float | None, colours: dict[str, str]) -> None:
    loops = found.loops[which]
    f = loops["frequency"].values
    for one in reversed(found.sets):
        for number, axis in enumerate(loops["axis"].values):
            level = 20.0 * np.log10(np.abs(loops.sel(gains=one.name, axis=axis).values))
            wide = 2.2 if one is found.best else 1.2
            ax.semilogx(f, level, _DASHES[number % 3], color=colours[one.name], lw=wide)
    top = 1.0 if limit is None else limit
    shown = np.abs(loops.sel(gains=found.best.name).values).max(axis=0) > 0.05
    ax.set_xlim(_low(f, loops.values), float(f[shown].max()) * 1.3)
    ax.set_ylim(-20.0, max(top + 2.0, 4.0))
    if limit is not None:
        ax.axhline(limit, color=CHATTER, lw=1.2)
        ax.annotate(
            f"limit {limit:g} dB", (0.01, limit), xycoords=("axes fraction", "data"), color=CHATTER, va="bottom"
        )
    kind = which.removesuffix("_loop")
    many = f" ({', '.join(f'{a} {d}' for a, d in zip(loops['axis'].values, _DASH_WORDS, strict=False))})"
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel(f"closed {kind} loop [dB]" + (many if loops.sizes["axis"] > 1 else ""))
    ax.grid(visible=True, which="both", lw=0.3)


def _low(f: Real, loops: Complex) -> float:
    """Return where a loop begins to differ from 1, by half a decibel."""
    moved = np.abs(20.0 * np.log10(np.abs(loops))).reshape(-1, f.size).max(axis=0) > 0.3
    return 0.5 * float(f[np.argmax(moved)])


def _lobes(ax: Axes, found: Tuning, colours: dict[str, str]) -> None:
    lobes = found.lobes["limit_depth"]
    speed = lobes["spindle_speed"].values
    for one in found.sets:
        depth = lobes.sel(gains=one.name).values
        wide = 2.2 if one is found.best else 1.2
        known = np.where(np.isfinite(depth), depth, np.nan)
        ax.plot(speed, known, color=colours[one.name], lw=wide, label=_name(found, one))
    if found.confirmed is not None:
        ax.plot(
            found.confirmed["spindle_speed"], found.confirmed["limit_depth"], "o", color="k", ms=5, label="confirmed"
        )
    best = lobes.sel(gains=found.best.name).values
    known = best[np.isfinite(best)]
    ax.set_ylim(0.0, min(2.5 * float(np.median(known)), 1.3 * float(known.max())) if known.size else 1.0)
    ax.set_xlabel("spindle speed [rpm]")
    ax.set_ylabel("limit depth [mm]")
    ax.grid(visible=True, lw=0.3)


def _compromise(ax: Axes, found: Tuning, colours: dict[str, str]) -> None:
    rate = found.task.goal.kind == "removal_rate"
    factor = 6e7 if rate else 1e3
    line = sorted((*found.frontier, found.best), key=lambda one: one.tracking_error)
    ax.plot([1e6 * o.tracking_error for o in line], [factor * o.goal for o in line], ".-", color=CURVE_COLOURS[0])
    for one in found.sets:
        if one.goal > 0.0:
            marker = "o" if not one.misses else "x"
            ax.plot(1e6 * one.tracking_error, factor * one.goal, marker, color=colours[one.name], ms=7)
    ax.set_xscale("log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel(f"{found.task.move.words} [um]")
    worst = f", modes +-{100 * found.task.robust:g} %" if found.task.robust else ""
    what = "removal rate [cm$^3$/min]" if rate else "least depth [mm]"
    ax.set_ylabel(what + worst)
    ax.grid(visible=True, which="both", lw=0.3)
