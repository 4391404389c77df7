"""Cuts drawn over what a workshop does: teeth, pitch, immersion, machine and speed, without regard to any method."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from truth.milling_map import MillingCut

PITCHES = ("equal", "alternating", "linear", "any", "repeated")


@dataclass(frozen=True)
class Drawn:
    """A cut at a spindle speed [rpm]; kinds of its pitch and arc in words."""

    cut: MillingCut
    speed: float
    pitch: str
    arc: str


def _pitch(rng: np.random.Generator, teeth: int) -> tuple[str, np.ndarray]:
    """Angles [rad] from tooth to tooth: equal in two of five, else by up to a third of the mean apart."""
    kind = str(rng.choice(PITCHES, p=[0.4, 0.2, 0.15, 0.15, 0.1]))
    mean = 2.0 * math.pi / teeth
    spread = mean * rng.uniform(0.01, 0.33)
    steps = np.zeros(teeth)
    if kind == "alternating" and teeth % 2 == 0 and teeth > 1:
        steps = spread * np.where(np.arange(teeth) % 2, 1.0, -1.0)
    elif kind == "linear" and teeth > 1:
        steps = spread * np.linspace(-1.0, 1.0, teeth)
    elif kind == "any" and teeth > 1:
        steps = spread * rng.uniform(-1.0, 1.0, teeth)
    elif kind == "repeated" and teeth in (6, 8):
        steps = np.tile(spread * rng.uniform(-1.0, 1.0, teeth // 2), 2)
    else:
        kind = "equal"
    steps = steps - steps.mean()
    # Whole tenths of a degree, as a tool maker states them; the last takes the rest.
    degrees = np.round(np.degrees(mean + steps), 1)
    if kind == "equal":
        return kind, np.full(teeth, mean)
    if kind == "linear" or kind == "any":
        degrees[-1] = 360.0 - degrees[:-1].sum()
    else:
        half = 2 if kind == "alternating" else teeth // 2
        degrees = np.tile(degrees[:half], teeth // half)
        degrees *= 360.0 / degrees.sum()
    return kind, np.radians(degrees)


def _arc(rng: np.random.Generator) -> tuple[str, tuple[float, float]]:
    kind = str(rng.choice(("up", "down", "slot", "offset"), p=[0.3, 0.3, 0.1, 0.3]))
    immersion = math.exp(rng.uniform(math.log(0.02), 0.0))
    reach = math.acos(1.0 - 2.0 * immersion)
    if kind == "up":
        return kind, (0.0, reach)
    if kind == "down":
        return kind, (math.pi - reach, math.pi)
    if kind == "slot":
        return kind, (0.0, math.pi)
    # Between two heights of the tool: a wall on either side.
    low = rng.uniform(0.0, 1.0 - 0.5 * immersion)
    high = min(1.0, low + immersion)
    return kind, (math.acos(1.0 - 2.0 * low), math.acos(1.0 - 2.0 * high))


def draw(seed: int) -> Drawn:
    """Return cut number `seed`."""
    rng = np.random.default_rng(seed)
    teeth = int(rng.integers(1, 9))
    modes = int(rng.integers(1, 4))
    fastest = math.exp(rng.uniform(math.log(60.0), math.log(4000.0)))
    frequency = fastest * np.exp(-rng.uniform(0.0, math.log(6.0), modes) * (np.arange(modes) > 0))
    damping = np.exp(rng.uniform(math.log(0.006), math.log(0.08), modes))
    stiffness = 2e7 * np.exp(rng.uniform(-1.5, 1.5, modes))
    direction = np.zeros((modes, 3))
    for r in range(modes):
        along = rng.choice(("x", "y", "plane", "space"))
        if along in ("x", "y"):
            direction[r, "xy".index(along)] = 1.0
        else:
            vector = rng.normal(size=3) * (1.0, 1.0, 1.0 if along == "space" else 0.0)
            direction[r] = vector / np.linalg.norm(vector)
    kind, pitch = _pitch(rng, teeth)
    arc, where = _arc(rng)
    approach = 0.5 * math.pi if rng.uniform() < 0.6 else math.radians(rng.uniform(15.0, 89.0))
    kt = math.exp(rng.uniform(math.log(5e8), math.log(3e9)))
    k = (kt, kt * rng.uniform(0.1, 0.6), kt * rng.uniform(0.0, 0.3))
    cut = MillingCut(frequency, damping, stiffness, direction, pitch, (where,), k, approach)
    if kind == "equal":
        waves = math.exp(rng.uniform(math.log(0.2), math.log(20.0)))
        speed = 60.0 * fastest / (waves * teeth)
    else:
        waves = math.exp(rng.uniform(math.log(0.4), math.log(50.0)))
        speed = 60.0 * fastest / waves
    return Drawn(cut, speed, kind, arc)
