"""How things look in the report, the same in every figure: colours, dashes, names and numbers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from smfe.campaign.methods import METHODS as MEASURED
from smfe.reporting.content.results import Results

# Okabe and Ito's palette for the colour-blind. Vermilion is kept for chatter, sky blue for an axis.
CURVE_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#4D4D4D")
DASHES = ("solid", "dash", "dot", "dashdot", "longdash")
SAFE_DASH = "longdashdot"
"""The safe curve's."""
CHATTER = "#D55E00"
RECORD = "#9A9A9A"
STABLE = "#0072B2"
ADVICE = "#F0E442"
"""The recommended cut: yellow with a black edge, as no line is."""
AXIS_COLOURS = {"x": "#000000", "y": "#56B4E9", "z": "#8C6D1F"}

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
    looks = {}
    for number, name in enumerate(dict.fromkeys(names)):
        turn, colour = divmod(number, len(CURVE_COLOURS))
        # The first five differ in colour and in dash, the next five from them in one of both.
        looks[name] = Line(CURVE_COLOURS[colour], DASHES[(number + turn) % len(DASHES)])
    return looks


def translucent(colour: str, opacity: float) -> str:
    """Return "#rrggbb" as "rgba(...)"."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgba({red},{green},{blue},{opacity:g})"


def literal(text: str) -> str:
    """Return text that matplotlib writes letter by letter: a dollar sign would begin a formula."""
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


def with_spread(value: float, std: float) -> str:
    """Return "−3.28 ± 0.33": two digits of the standard deviation, and the value as far as these reach."""
    if not math.isfinite(std) or std <= 0.0 or not math.isfinite(value):
        return number(value, 3)
    digits = 1 - math.floor(math.log10(float(f"{std:.1e}")))
    texts = [f"{round(part, digits):.{max(digits, 0)}f}" for part in (value, std)]
    return " ± ".join("0" if float(text) == 0.0 else text.replace("-", "−") for text in texts)


def listed(parts: Iterable[str]) -> str:
    """Return "a, b and c"."""
    *first, last = [*parts] or [""]
    return f"{', '.join(first)} and {last}" if first else last


def spoken(name: str) -> str:
    """Return the name of a measurement as it stands in a sentence: "hammer moving" for hammer_moving."""
    return name.replace("_", " ")


def with_range(value: float | None, low: float | None, high: float | None) -> tuple[str, str]:
    """Return ("17.50", "17.43 to 17.57"): a range about a value to two digits of its half width, the value as far."""
    if value is None or low is None or high is None or not all(map(math.isfinite, (value, low, high))) or high <= low:
        return number(value), ""
    digits = max(0, 1 - math.floor(math.log10(float(f"{0.5 * (high - low):.1e}"))))
    texts = [f"{part:.{digits}f}".replace("-", "−") for part in (value, low, high)]
    return texts[0], f"{texts[1]} to {texts[2]}"


def band_text(pairs: Iterable[tuple[float, float]], limit: int = 12) -> str:
    """Return "12–14.5 Hz, 60 Hz"."""
    parts = [number(a) if a == b else f"{number(a)}–{number(b)}" for a, b in pairs]
    more = f" and {len(parts) - limit} more" if len(parts) > limit else ""
    return ", ".join(parts[:limit]) + more + " Hz"
