"""The stabilisation diagram of a modal fit as PNG: poles over order, and the fit beside what was measured."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smfe.modes.fit_modes import ModalFit
from smfe.reporting.content.style import literal
from smfe.reporting.figures.draw_matplotlib import DPI, save

LEVELS: tuple[tuple[int, str, dict[str, Any]], ...] = (
    (0, "pole: new", {"marker": ".", "color": "#bbbbbb", "markersize": 3}),
    (1, "as before: frequency", {"marker": "x", "color": "#999999", "markersize": 4}),
    (2, "and damping", {"marker": "o", "color": "#0072b2", "markersize": 4, "fillstyle": "none"}),
    (3, "and shape", {"marker": "o", "color": "#0072b2", "markersize": 4}),
)
"""How stable a pole is, and its mark."""

MODE = "#d55e00"

WIDE = 20.0
"""A band whose ends are further apart than this factor is drawn over the logarithm of frequency."""


def write_stabilisation(fit: ModalFit, path: Path, title: str = "") -> Path:
    """Draw the diagram of a modal fit and write it as PNG."""
    return save(draw_stabilisation(fit, title), path)


def draw_stabilisation(fit: ModalFit, title: str = "") -> Figure:
    """Return the diagram: size of the whole matrix, measured and fitted, over the poles of every order.

    The size is the root of the sum of squares of all entries, reciprocal ones counted once.
    """
    figure = Figure(figsize=(7.5, 6.0), dpi=DPI)
    upper = figure.add_axes((0.10, 0.52, 0.87, 0.36))
    lower = figure.add_axes((0.10, 0.09, 0.87, 0.40), sharex=upper)
    _draw_size(upper, fit)
    stable = fit.stable
    for level, name, look in LEVELS:
        at = stable.level == level
        if at.any():
            lower.plot(stable.frequency[at], stable.order[at], linestyle="none", label=name, **look)
    _draw_modes((upper, lower), fit)
    frequency = fit.curves.frequency
    lower.set_xlabel("frequency [Hz]")
    lower.set_ylabel("order of the polynomial [1]")
    if frequency[-1] > WIDE * max(frequency[0], 1e-9):
        lower.set_xscale("log")
    lower.set_xlim(max(float(frequency[0]), 1e-3 * float(frequency[-1])), float(frequency[-1]))
    lower.set_ylim(0.0, float(stable.order.max()) + 1.0)
    for axes in (upper, lower):
        axes.grid(True, color="#dddddd", linewidth=0.5)
        axes.tick_params(labelsize=8, direction="in", which="both")
    handles, names = upper.get_legend_handles_labels()
    more, further = lower.get_legend_handles_labels()
    figure.legend([*handles, *more], [*names, *further], loc="upper center", ncols=4, frameon=False, fontsize=8)
    figure.text(0.10, 0.895, literal(title), fontsize=10)
    return figure


def _draw_size(axes: Axes, fit: ModalFit) -> None:
    """Draw measured and fitted size of the matrix."""
    curves = fit.curves
    known = np.isfinite(curves.std)
    own, model = (
        1e6 * np.sqrt(np.sum(np.abs(np.where(known, values, 0.0)) ** 2, axis=0))
        for values in (curves.values, fit.free.curve_values(curves.frequency))
    )
    axes.plot(curves.frequency, np.where(own > 0.0, own, np.nan), color="black", linewidth=0.8, label="measured")
    axes.plot(curves.frequency, model, color=MODE, linewidth=1.2, linestyle="--", label="fitted")
    axes.set_yscale("log")
    axes.set_ylim(0.5 * float(own[own > 0.0].min()), 2.0 * float(own.max()))
    axes.set_ylabel("norm of the compliance [µm/N]")
    axes.tick_params(labelbottom=False)


def _draw_modes(panels: tuple[Axes, Axes], fit: ModalFit) -> None:
    """Mark the modes and their half-power bands in both panels."""
    for number, row in enumerate(fit.table().itertuples()):
        natural, damping = float(str(row.frequency_Hz)), float(str(row.damping))
        for axes in panels:
            named = "mode, half-power band" if number == 0 and axes is panels[0] else None
            axes.axvline(natural, color=MODE, linewidth=0.8, alpha=0.7, label=named)
            axes.axvspan(natural * (1.0 - damping), natural * (1.0 + damping), color=MODE, alpha=0.12, linewidth=0)
