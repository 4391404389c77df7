"""How things look in the report, the same in every figure: colours, dashes, names and numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import find_peaks

from process.types import Complex, Real
from smfe.campaign.methods import METHODS as MEASURED
from smfe.reporting.results import Measurement, Results

# Okabe and Ito's palette for the colour-blind. Vermilion is kept for chatter, sky blue for an axis.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#4D4D4D")
_DASHES = ("solid", "dash", "dot", "dashdot")
CHATTER = "#D55E00"
AXIS_COLOURS = {"x": "#000000", "y": "#56B4E9", "z": "#8C6D1F"}
EXCITATION_DASHES = {"": "solid", "x": "solid", "y": "dash", "z": "dot"}

METHODS = {name: method.title for name, method in MEASURED.items()} | {"model": "model, not measured"}

OUTCOMES = {"stable": "●", "chatter": "✕", "undecided": "▲", "failed": "–"}
"""Outcome of a cutting test -> its mark; the shape says it, not the colour."""


@dataclass(frozen=True)
class Line:
    """How the lines of one measurement look."""

    colour: str
    dash: str


def palette(results: Results) -> dict[str, Line]:
    """Return the look of each measurement, model and lobe source."""
    names = [m.name for m in results.measurements] + [item.source for item in results.lobes]
    models = {m.name for m in results.measurements if m.is_model}
    looks = {}
    for number, name in enumerate(dict.fromkeys(names)):
        turn, colour = divmod(number, len(_COLOURS))
        # Models are broken lines from the first: they were not measured.
        looks[name] = Line(_COLOURS[colour], _DASHES[(turn + (name in models)) % len(_DASHES)])
    return looks


def translucent(colour: str, opacity: float) -> str:
    """Return "#rrggbb" as "rgba(...)"."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


def literal(text: str) -> str:
    """Return text that matplotlib shows letter by letter: a dollar sign would begin a formula."""
    return text.replace("\\", "\\\\").replace("$", r"\$") if "$" in text else text


def number(value: object, digits: int = 4) -> str:
    """Return a number with so many significant digits and without an exponent where that reads better."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if not isinstance(value, int | float | np.integer | np.floating):
        return "–" if value is None else str(value)
    x = float(value)
    if math.isnan(x):
        return "–"
    if math.isinf(x):
        return "∞" if x > 0 else "−∞"
    if x == round(x) and abs(x) < 1e7:
        return f"{int(x)}".replace("-", "−")
    text = f"{x:.{digits}g}"
    if "e" in text and 1e-4 <= abs(x) < 1e7:
        text = f"{float(text):.0f}"
    return re.sub(r"e([+-])0*(\d+)", lambda m: f"·10^{'-' if m[1] == '-' else ''}{m[2]}", text).replace("-", "−")


def band_text(pairs: Iterable[tuple[float, float]], limit: int = 12) -> str:
    """Return "12–14.5 Hz, 60 Hz"."""
    parts = [number(a) if a == b else f"{number(a)}–{number(b)}" for a, b in pairs]
    more = f" and {len(parts) - limit} more" if len(parts) > limit else ""
    return ", ".join(parts[:limit]) + more + " Hz"


def axes_of(measurements: Sequence[Measurement]) -> tuple[list[str], list[str]]:
    """Return the responses and the excitations that anyone has measured: the tool tip first, then places by number."""
    entries = {pair for m in measurements for pair in m.entries}
    return sorted({r for r, _ in entries}, key=_place), sorted({e for _, e in entries}, key=_place)


def _place(name: str) -> tuple[bool, int, str]:
    """Return what sorts "x", "y", "2:z", "10:x" in this order."""
    node, apart, axis = name.rpartition(":")
    return bool(apart), int(node) if node.isdecimal() else 0, f"{node}:{axis}"


def entry_name(response: str, excitation: str) -> str:
    """Return "xy" for axes of the tool tip, "1:z, 2:z" where a place is named."""
    return f"{response}{excitation}" if len(response + excitation) == 2 else f"{response}, {excitation}"


def frequency_range(measurements: Sequence[Measurement]) -> tuple[float, float]:
    """Return the band [Hz] to show first: where the machine is flexible.

    From zero to a quarter beyond the last frequency at which any entry exceeds 5 % of the highest resonance,
    and not beyond the data. A hammer reaches far higher than what is of interest.
    """
    shown = [m for m in measurements if not m.is_model] or list(measurements)
    parts = [(m.frequency, np.abs(m.entry(*pair))) for m in shown for pair in m.entries]
    if not parts:
        return 0.0, 1.0
    level = 0.05 * max(_resonance(magnitude) for _, magnitude in parts)
    last = max(float(f[magnitude > level].max(initial=0.0)) for f, magnitude in parts)
    end = max(float(f[np.isfinite(magnitude)].max()) for f, magnitude in parts)
    return 0.0, min(end, 1.25 * last)


def _resonance(magnitude: Real) -> float:
    """Return the highest peak that stands out by 10 dB, else the highest value.

    The lowest frequencies of an integrated acceleration drift upwards without a peak.
    """
    known = magnitude[np.isfinite(magnitude) & (magnitude > 0.0)]
    peaks, _ = find_peaks(np.log10(known), prominence=0.5)
    return float(known[peaks].max() if peaks.size else known.max(initial=0.0))


def magnitude_range(measurements: Sequence[Measurement], span: tuple[float, float]) -> tuple[float, float]:
    """Return the range of magnitudes [um/N] up to the highest resonance, at most four decades."""
    joined = np.abs(_shown_values(measurements, span))
    joined = joined[joined > 0.0]
    if not joined.size:
        return 1e-3, 1.0
    top = float(joined.max())
    return max(0.8 * float(np.quantile(joined, 0.01)), 1e-4 * top), 1.5 * top


def part_ranges(measurements: Sequence[Measurement], span: tuple[float, float]) -> tuple[list[float], list[float]]:
    """Return the ranges of real and imaginary parts [um/N]."""
    joined = _shown_values(measurements, span)
    return _padded(joined.real), _padded(joined.imag)


def _shown_values(measurements: Sequence[Measurement], span: tuple[float, float]) -> Complex:
    """Return all compliances [um/N] of a band that do not exceed the highest resonance."""
    values = [np.empty(0, dtype=complex)]
    top = 0.0
    for m in measurements:
        inside = (m.frequency >= span[0]) & (m.frequency <= span[1])
        for pair in m.entries:
            entry = 1e6 * m.entry(*pair)[inside]
            values.append(entry[np.isfinite(entry)])
            top = max(top, _resonance(np.abs(entry)))
    joined = np.concatenate(values)
    return np.asarray(joined[np.abs(joined) <= top])


def _padded(values: Real) -> list[float]:
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    margin = 0.06 * (high - low) or 1.0
    return [low - margin, high + margin]


def magnitude_band(values: Complex, std: Real, floor: float) -> tuple[Real, Real]:
    """Return magnitude -+ two standard deviations [um/N], not below a floor for the logarithmic axis."""
    magnitude = 1e6 * np.abs(values)
    spread = 2e6 * std
    return np.maximum(magnitude - spread, floor), magnitude + spread


def depth_range(depths: Sequence[Real], tests: Real) -> float:
    """Return the upper end of the axis of depths [mm]: tests and lobes, but not a lone high peak."""
    joined = np.concatenate([d[np.isfinite(d)] for d in depths]) if depths else np.empty(0)
    highest_test = 1.3 * float(tests.max(initial=0.0))
    if not joined.size:
        return max(highest_test, 1.0)
    lobes = min(1.1 * float(np.quantile(joined, 0.98)), 8.0 * float(joined.min()))
    return max(highest_test, lobes, 1.5 * float(joined.min()))
