"""The next experiment as something to do: an instruction for who stands at the machine."""

from __future__ import annotations

import math
import re

from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.noise import Excited, excited_of
from smfe.diagnosis.inference.problem import Condition, Family
from smfe.diagnosis.story.words import rounded

_PHRASES = (
    (r"the first condition once more, at the end", "Repeat {first} at the end of the session"),
    (
        r"motion along x, y, z under forces along x, y, z",
        "Repeat {first} in all directions: excite and measure x, y, z",
    ),
    (r"a free mass of (\S+ kg) in the machine's place", r"Hang up a free mass of \1, and measure it as {first}"),
    (r"a laser in the accelerometer's place", "Repeat {first} with a laser in the accelerometer's place"),
    (r"a second accelerometer beside it", "Repeat {first} with a second accelerometer beside the first"),
    (r"level (\S+)", "Repeat {first} at {level}"),
    (r"position (\S+) m, at the end", "Repeat {first} at {place} of the stroke, at the end of the session"),
    (r"a turning spindle", "Repeat {first} with the spindle turning at {speed}"),
    (r"moves (.*)", r"Move the axis from rest to rest, ten times or more, \1"),
    (r"cut at (.*)", r"Make a cut at \1"),
    (r"spindle in air at (.*)", r"Record the forces with the spindle turning in air at \1"),
    (r"limit at (.*), (\S+ mm) per tooth", r"Find the limit at \1 and \2 per tooth: cut deeper by 4 to 6 % at a time"),
)
"""Name of a proposed condition -> what to do; ``{first}`` is the measurement that it repeats."""


def instruction(family: Family, condition: Condition) -> str:
    """Return what to do to measure a proposed condition, without a full stop."""
    if isinstance(family, MachineFrfs):
        return _at_an_axis(family, condition)
    settings = condition.settings
    words = {
        "first": condition.source.replace("_", " ") or "the first measurement",
        "level": _level(condition),
        "place": f"{1e3 * float(settings.get('position', 0.0)):.4g} mm",
        "speed": f"{float(settings.get('spindle_speed', 0.0)) * 30.0 / math.pi:.4g} rpm",
    }
    for pattern, said in _PHRASES:
        if found := re.fullmatch(pattern, condition.name):
            return found.expand(said).format_map(words)
    return condition.name[:1].upper() + condition.name[1:]


def _level(condition: Condition) -> str:
    """Return how hard a proposed condition hits or shakes."""
    if not isinstance(condition.data, Excited):
        return "another level"
    hammer = condition.data.method == "hammer"
    return f"{rounded(abs(condition.data.level), 2)} {'N s a hit' if hammer else 'N'}"


def _at_an_axis(family: MachineFrfs, condition: Condition) -> str:
    settings, axis = condition.settings, family.baseline.axis
    feed, level = 6e4 * float(settings.get("feed", 0.0)), abs(excited_of(condition).level)
    hammer = settings.get("method") == "hammer"
    way = "towards minus " if feed < 0.0 else ""
    parts = [
        f"{'Hit' if hammer else 'Shake'} the tool along {axis} with {rounded(level, 2)} {'N s' if hammer else 'N'}",
        f"while the {axis} axis moves {way}at {abs(feed):g} mm/min" if feed else f"while the {axis} axis stands still",
    ]
    if len(family.baseline.servos) > 1 and settings.get("controller"):
        parts.append(f"under controller {settings['controller']}")
    place = float(settings.get("position", 0.0))
    if place and not any(math.isclose(place, float(c.settings.get("position", 0.0))) for c in family.conditions):
        parts.append(f"at the position {1e3 * place:g} mm")
    mass = float(settings.get("added_mass", 0.0))
    if mass:
        parts.append(f"with {mass:g} kg clamped to the tip")
    return " ".join(parts)
