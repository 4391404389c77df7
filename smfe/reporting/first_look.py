"""The picture of `smfe look`: channels over time with their spectrum, or a frequency response."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from process.types import Real
from smfe.records.look import Look

_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#4D4D4D")
_MOST_PANELS = 6
_POINTS = 2000


def draw(result: Look, path: Path) -> None:
    """Write the picture as PNG."""
    figure_of(result).savefig(path, format="png", dpi=110)


def figure_of(result: Look) -> Figure:
    """Return the picture."""
    figure = Figure(layout="constrained")
    if result.kind.name == "FRF":
        _response(result, figure)
    else:
        _channels(result, figure)
    figure.suptitle(f"{result.path.name}: seems to be {result.kind.name}", fontsize=11)
    return figure


def _channels(result: Look, figure: Figure) -> None:
    """Channels over time, each in a panel of its own, and the amplitude spectra of all below."""
    found = result.found.columns
    shown = [(g.column, f"{g.channel}\n[{g.unit}]") for g in result.channels if g.channel != "time"]
    shown = (shown or [(column, str(column)) for column in found])[:_MOST_PANELS]
    figure.set_size_inches(9.0, 1.2 + 1.25 * len(shown) + 2.6)
    grid = figure.add_gridspec(len(shown) + 1, 1, height_ratios=[1.0] * len(shown) + [2.0])
    timed = math.isfinite(result.sample_rate)
    time = np.arange(result.size) / (result.sample_rate if timed else 1.0)
    spectrum = figure.add_subplot(grid[-1])
    first = None
    for k, (column, name) in enumerate(shown):
        panel = figure.add_subplot(grid[k], sharex=first)
        first = first or panel
        panel.plot(*envelope(time, found[column]), color=_COLOURS[k], linewidth=0.7)
        panel.set_ylabel(name, fontsize=8)
        panel.tick_params(labelsize=8, labelbottom=k == len(shown) - 1)
        panel.grid(alpha=0.3)
        frequency, amplitude = _spectrum(found[column], result.sample_rate if timed else 1.0)
        spectrum.plot(frequency, amplitude, color=_COLOURS[k], linewidth=0.8, label=name.replace("\n", " "))
    if first is not None:
        panel.set_xlabel("time [s]" if timed else "sample", fontsize=9)
    spectrum.set_xscale("log")
    spectrum.set_yscale("log")
    spectrum.set_xlabel("frequency [Hz]" if timed else "frequency [1/sample]", fontsize=9)
    spectrum.set_ylabel("amplitude", fontsize=9)
    spectrum.tick_params(labelsize=8)
    spectrum.grid(alpha=0.3)
    spectrum.legend(fontsize=8, loc="lower left")


def _response(result: Look, figure: Figure) -> None:
    """Magnitude and phase over frequency."""
    figure.set_size_inches(9.0, 6.0)
    columns = [guess.column for guess in result.channels]
    frequency, real, imag = (result.found.columns[c] for c in columns)
    response = (real + 1j * imag)[frequency > 0.0]
    frequency = frequency[frequency > 0.0]
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    upper.loglog(frequency, np.abs(response), color=_COLOURS[0], linewidth=0.9)
    lower.semilogx(frequency, np.degrees(np.angle(response)), color=_COLOURS[0], linewidth=0.9)
    upper.set_ylabel(f"magnitude of '{columns[1]}', '{columns[2]}'", fontsize=9)
    lower.set_ylabel("phase [deg]", fontsize=9)
    lower.set_xlabel("frequency [Hz]", fontsize=9)
    lower.set_yticks([-180, -90, 0, 90, 180])
    for panel in (upper, lower):
        panel.grid(alpha=0.3)
        panel.tick_params(labelsize=8)


def envelope(time: Real, values: Real) -> tuple[Real, Real]:
    """Return least and greatest value of each of some thousand stretches: what a thousand pixels can hold."""
    if values.size <= 2 * _POINTS:
        return time, values
    size = values.size // _POINTS
    blocks = values[: size * _POINTS].reshape(_POINTS, size)
    ends = np.column_stack([blocks.min(axis=1), blocks.max(axis=1)]).ravel()
    return np.repeat(time[: size * _POINTS : size], 2), ends


def _spectrum(values: Real, rate: float) -> tuple[Real, Real]:
    """Return amplitudes of the whole record (Hann window), of some thousand stretches the greatest in each."""
    part = values[: 1 << 20]
    part = np.where(np.isfinite(part), part, 0.0)
    window = np.hanning(part.size)
    amplitude = 2.0 * np.abs(np.fft.rfft((part - part.mean()) * window)) / window.sum()
    frequency = np.fft.rfftfreq(part.size, 1.0 / rate)
    edges = np.unique(np.round(np.geomspace(1, amplitude.size - 1, 1500)).astype(int))
    return frequency[edges[:-1]], np.maximum(np.maximum.reduceat(amplitude, edges)[:-1], 1e-300)
