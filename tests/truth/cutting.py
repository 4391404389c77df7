"""True cutting forces: teeth on trochoids, chips cut out of what earlier teeth left, seen through a dynamometer.

The chip is the distance, along the ray from the tool's centre, between the tooth and the outermost surface that any of
the last teeth left there; its trochoids are solved for, not approximated by circles. x is the feed, angles run from +y
clockwise, forces act on the tool. Nominal: slot of Franco et al. 2024 (JMMP 8/5/207), but two inserts: the in-plane
force of four in a slot is constant, and a resonance of the dynamometer could not show. SI throughout.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy import signal

from truth import chain as instruments
from truth.blind import Answer, Sealed, seed_of

INNER_RATE = 32768.0
DIVISION = 4
RATE = INNER_RATE / DIVISION
"""Rate of the records [Hz]."""

REFERENCE_CHIP = 5e-5
"""Chip at which a size effect leaves the coefficients as they are [m]."""

_ANGLES = 7200
_SECTIONS = instruments.butterworth(6, 0.36 * RATE, INNER_RATE)


@dataclass(frozen=True)
class Mill:
    """Tool, work and dynamometer.

    cutting (t, r, a) [N/m2], edge [N/m]; runout [m] towards `runout_angle` from tooth 0; size_effect: exponent;
    dull: extra edge force of tooth 0 [N/m]; set_back: what its radius is smaller [m]. dynamometer: frequencies along x,
    y, z [Hz], infinite: rigid. exchange: x and y are swapped; gain: of all channels; unbalance: force that turns with
    the spindle [N];
    tone [N] at `mains` Hz; noise [N] rms, coloured; wander: relative slow change of the speed.
    """

    diameter: float = 50.8e-3
    teeth: int = 2
    approach: float = math.pi / 2.0
    helix: float = 0.0
    entry: float = 0.0
    exit: float = math.pi
    cutting: tuple[float, float, float] = (780e6, 351e6, 100e6)
    edge: tuple[float, float, float] = (0.0, 0.0, 0.0)
    size_effect: float = 0.0
    runout: float = 0.0
    runout_angle: float = 0.0
    dull: float = 0.0
    set_back: float = 0.0
    dynamometer: tuple[float, float, float] = (math.inf, math.inf, math.inf)
    ratio: float = 0.03
    exchange: bool = False
    gain: float = 1.0
    unbalance: float = 0.0
    tone: float = 0.0
    mains: float = 50.0
    noise: float = 2.0
    wander: float = 1e-3

    def with_nuisances(self, rng: np.random.Generator) -> Mill:
        """Coefficients within 15 %, helix 0 to 10 degrees, run-out to any side."""
        t, r, a = (float(c * k) for c, k in zip(self.cutting, 1.0 + 0.15 * rng.uniform(-1, 1, 3), strict=True))
        helix = math.radians(float(rng.uniform(0.0, 10.0)))
        return replace(self, cutting=(t, r, a), helix=helix, runout_angle=float(rng.uniform(0.0, 2.0 * math.pi)))


@dataclass(frozen=True)
class Cut:
    """One steady cut: speed [rpm], feed per tooth [m], depth [m], revolutions recorded, air: the spindle turns only."""

    speed: float = 1500.0
    feed_per_tooth: float = 0.1e-3
    depth: float = 1e-3
    revolutions: int = 60
    air: bool = False

    def settings(self) -> dict[str, float]:
        """Return what a user would write down."""
        depth = 0.0 if self.air else self.depth
        return {"spindle_rpm": self.speed, "feed_per_tooth": self.feed_per_tooth, "depth": depth}


FEEDS = tuple(Cut(feed_per_tooth=f * 1e-3) for f in (0.05, 0.1, 0.15, 0.2))
FULL = (Cut(air=True), *FEEDS, Cut(depth=0.5e-3), Cut(depth=2e-3), Cut(speed=900.0), Cut(speed=2100.0))
DESIGNS = {"feeds": FEEDS, "full": FULL}


def chip(mill: Mill, tooth: int, phi: np.ndarray, feed_per_tooth: float) -> np.ndarray:
    """Thickness along the ray [m] at angles phi [rad] of one tooth; zero where it cuts air."""
    pitch = 2.0 * math.pi / mill.teeth
    radius = 0.5 * mill.diameter + mill.runout * np.cos(pitch * np.arange(mill.teeth) + mill.runout_angle)
    radius[0] -= mill.set_back
    left = np.full(phi.shape, -np.inf)
    for m in range(1, mill.teeth + 1):
        r = radius[(tooth - m) % mill.teeth]
        lead = np.zeros(phi.shape)
        for _ in range(4):
            back = feed_per_tooth * (m - lead / pitch)
            lead = np.arcsin(back * np.cos(phi) / r)
        left = np.maximum(left, r * np.cos(lead) - back * np.sin(phi))
    return np.maximum(radius[tooth] - left, 0.0)


def forces(mill: Mill, cut: Cut, angle: np.ndarray, slices: int = 8) -> np.ndarray:
    """Force on the tool (3, n) [N] at angles of the spindle [rad]."""
    out = np.zeros((3, angle.size))
    if cut.air:
        return out
    wide = slices if mill.helix > 0.0 else 1
    edge = cut.depth / math.sin(mill.approach) / wide
    sk, ck = math.sin(mill.approach), math.cos(mill.approach)
    for tooth in range(mill.teeth):
        for z in (np.arange(wide) + 0.5) * cut.depth / wide:
            lag = 2.0 * z * math.tan(mill.helix) / mill.diameter
            phi = np.mod(angle - 2.0 * math.pi * tooth / mill.teeth - lag, 2.0 * math.pi)
            h = np.where((phi >= mill.entry) & (phi <= mill.exit), chip(mill, tooth, phi, cut.feed_per_tooth) * sk, 0.0)
            inside = h > 0.0
            grown = np.where(inside, (np.maximum(h, 1e-9) / REFERENCE_CHIP) ** -mill.size_effect, 0.0) * h
            dull = mill.dull if tooth == 0 else 0.0
            each = zip(mill.cutting, mill.edge, strict=True)
            ft, fr, fa = ((k * grown + (e + dull) * inside) * edge for k, e in each)
            s, c = np.sin(phi), np.cos(phi)
            out[0] -= c * ft + s * (sk * fr + ck * fa)
            out[1] += s * ft - c * (sk * fr + ck * fa)
            out[2] += ck * fr - sk * fa
    return out


def _table(frequency: float, ratio: float) -> np.ndarray:
    """Second-order section of a resonance with unit static gain (bilinear, true at its frequency)."""
    w = 2.0 * math.pi * frequency
    k = w / math.tan(0.5 * w / INNER_RATE)
    a0 = k * k + 2.0 * ratio * w * k + w * w
    g = w * w / a0
    return np.array([[g, 2.0 * g, g, 1.0, 2.0 * (w * w - k * k) / a0, (k * k - 2.0 * ratio * w * k + w * w) / a0]])


def record(mill: Mill, cut: Cut, seed: np.random.SeedSequence) -> dict[str, Any]:
    """Return ``condition``, ``settings``, ``time`` (n,) [s] and ``force`` (3, n) [N] of one cut."""
    rng = np.random.default_rng(seed)
    rotation = 2.0 * math.pi * cut.speed / 60.0 * (1.0 + rng.uniform(-2e-3, 2e-3))
    run_in = 0.2
    t = np.arange(round((run_in + cut.revolutions * 60.0 / cut.speed) * INNER_RATE)) / INNER_RATE
    slow = 2.0 * math.pi * rng.uniform(0.3, 0.8)
    angle = rotation * (t - mill.wander / slow * np.cos(slow * t + rng.uniform(0.0, 6.0))) + rng.uniform(0.0, 6.0)
    grid = np.arange(_ANGLES) * 2.0 * math.pi / _ANGLES
    force = np.array([np.interp(angle, grid, row, period=2.0 * math.pi) for row in forces(mill, cut, grid)])
    force[0] += mill.unbalance * np.sin(angle)
    force[1] += mill.unbalance * np.cos(angle)
    for i, frequency in enumerate(mill.dynamometer):
        if math.isfinite(frequency):
            force[i] = signal.sosfilt(_table(frequency, mill.ratio), force[i])
    seen = signal.sosfilt(_SECTIONS, force)[:, round(run_in * INNER_RATE) :: DIVISION] * mill.gain
    time = np.arange(seen.shape[1]) / RATE
    for i in range(3):
        seen[i] += mill.noise * instruments.noise(rng, time.size)
        seen[i] += mill.tone * np.sin(2.0 * math.pi * mill.mains * time + rng.uniform(0.0, 6.0))
        seen[i] = instruments.converted(seen[i], 16)
    if mill.exchange:
        seen = seen[[1, 0, 2]]
    return {"condition": cut, "settings": cut.settings(), "time": time, "force": seen}


def measure_cuts(mill: Mill, cuts: Sequence[Cut], seed: int) -> list[dict[str, Any]]:
    """Carry out the cuts, one record each."""
    seeds = np.random.SeedSequence(seed).spawn(len(cuts))
    return [record(mill, cut, s) for cut, s in zip(cuts, seeds, strict=True)]


@dataclass(frozen=True)
class CutEffect:
    """An effect on the forces: takes mill and size; with the size that must be found."""

    plant: Callable[[Mill, float], Mill]
    size: float
    unit: str


def _edges(mill: Mill, size: float) -> Mill:
    """Edge forces of `size` of the mean tangential force at 0.1 mm per tooth; radial edges as large."""
    t = size * mill.cutting[0] * 0.1e-3 * 2.0 / math.pi
    return replace(mill, edge=(t, t, 0.0))


def _resonant(mill: Mill, size: float) -> Mill:
    """Dynamometer that resonates at `size` Hz along x and y, half as high again along z."""
    return replace(mill, dynamometer=(size, size, 1.5 * size)) if size else mill


CUT_EFFECTS = {
    "runout": CutEffect(lambda mill, size: replace(mill, runout=size * 0.1e-3), 0.2, "of 0.1 mm per tooth"),
    "edge_force": CutEffect(_edges, 0.1, "of the force at 0.1 mm per tooth"),
    "size_effect": CutEffect(lambda mill, size: replace(mill, size_effect=size), 0.2, "exponent"),
    "dynamometer": CutEffect(_resonant, 250.0, "Hz"),
    "axis_swap": CutEffect(lambda mill, size: replace(mill, exchange=bool(size)), 1.0, ""),
    "sensor_gain": CutEffect(lambda mill, size: replace(mill, gain=1.0 + size), 0.05, ""),
    "unbalance": CutEffect(lambda mill, size: replace(mill, unbalance=size), 10.0, "N"),
    "tone": CutEffect(lambda mill, size: replace(mill, tone=size), 5.0, "N"),
}
"""Effects of the catalogue."""

CUT_OUTSIDE = {"dull_tooth": CutEffect(lambda mill, size: replace(mill, dull=size), 1e4, "N/m")}
"""Effects outside every catalogue: one insert is worn."""


def draw_cuts(
    seed: str | int,
    *,
    effects: Sequence[str | None] = (None, *CUT_EFFECTS),
    scale: float = 1.0,
    design: str = "full",
    mill: Mill | None = None,
) -> Sealed:
    """Hide one effect, `scale` times as large as must be found, and cut; see `truth.blind.draw`."""
    number = seed_of(seed)
    rng = np.random.default_rng([number, 2])
    name = effects[int(rng.integers(len(effects)))]
    true = (mill or Mill()).with_nuisances(rng)
    sizes: dict[str, float] = {}
    if name is not None:
        effect = (CUT_EFFECTS | CUT_OUTSIDE)[name]
        sizes = {name: effect.size * scale}
        true = effect.plant(true, sizes[name])
    records = measure_cuts(true, DESIGNS[design], int(rng.integers(2**31)))
    return Sealed(Answer(number, sizes, name in CUT_OUTSIDE, asdict(true), {}), design, records)
