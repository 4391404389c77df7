"""Sweep milling as a laboratory records it: down, up and central passes, the spindle ramped, on a machine of modes.

Nothing is imported from the packages. The machine is 3-D, the chip regenerates from what all earlier teeth left, with
run-out; forces and accelerations go through one anti-alias filter, sensor noise and a converter; the angle comes from
an encoder or a tacho. What no campaign file can know exactly (coefficients, run-out, ramp, wander of the speed,
offsets, drift, a stiff mode beyond the band) is drawn for every campaign. SI, angles from +y towards +x.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import linalg, signal

from truth import chain as instruments
from truth.sweep_kernel import integrate

INNER_RATE = 20000.0
"""Steps a second."""

BLOCKS = 200
"""Parts of a pass in which the machine is taken to be the same, where its stiffness changes on the way."""

RUN_IN = 0.3
"""Time in which the depth of cut grows from nothing to its value, and vanishes again [s]."""

CUTS = ("down", "up", "central")

Real = np.ndarray


@dataclass(frozen=True)
class Modes:
    """frequency [Hz], damping ratio, stiffness [N/m], unit direction (m, 3)."""

    frequency: Real
    damping: Real
    stiffness: Real
    direction: Real

    def compliance(self, frequency: Real) -> Real:
        """Compliance [m/N] at frequencies [Hz], shape (f, 3, 3)."""
        r = np.asarray(frequency)[:, None] / self.frequency
        share = 1.0 / (self.stiffness * (1.0 - r**2 + 2j * self.damping * r))
        return np.einsum("fm,mi,mj->fij", share, self.direction, self.direction)


def drawn_modes(count: int, rng: np.random.Generator, beyond: bool = True) -> Modes:
    """Draw modes between 25 and 75 Hz in any direction, and a stiff one beyond the band."""
    f, z, k = rng.uniform(25.0, 75.0, count), rng.uniform(0.02, 0.06, count), rng.uniform(25e6, 60e6, count)
    u = rng.standard_normal((count + beyond, 3))
    if beyond:
        f, z = np.append(f, rng.uniform(150.0, 250.0)), np.append(z, rng.uniform(0.03, 0.06))
        k = np.append(k, rng.uniform(150e6, 300e6))
    order = np.argsort(f)
    return Modes(f[order], z[order], k[order], (u / np.linalg.norm(u, axis=1)[:, None])[order])


@dataclass(frozen=True)
class Campaign:
    """How the passes are cut and recorded.

    widths: of the three cuts [m]; rotation [rad/s], acceleration [rad/s2], seconds in the cut. feed_rate is held [m/s].
    runout: eccentricity [m]. cutting (t, r, a) [N/m2], edge [N/m]. rate: of the records [Hz]. force_noise [N] and
    motion_noise [m/s2]: rms at `noise_rate`, white, the same density at any rate; coloured: as in `truth.chain`.
    encoder: lines of the encoder, mounted at an angle; 0: a tacho of one pulse a turn. bits: of the converter.
    dynamometer: natural frequency [Hz]. plate: mass of the plate [kg] times its share of the tool's acceleration.
    posture: relative change of all stiffnesses from the middle to the end of a pass. turning: order of the spindle, and
    the size of the force that turns with it [N], which no dynamometer sees.
    """

    diameter: float = 0.08
    teeth: int = 2
    approach: float = math.pi / 4.0
    widths: tuple[float, float, float] = (0.012, 0.012, 0.012)
    depth: float = 0.8e-3
    feed_rate: float = 2e-3
    rotation: float = 20.0 * math.pi
    acceleration: float = 1.5
    seconds: float = 60.0
    lead: float = 0.7
    tail: float = 2.3
    cutting: tuple[float, float, float] = (1889.2e6, 806.1e6, 291.0e6)
    edge: tuple[float, float, float] = (63.12e3, 113.7e3, -3.1e3)
    runout: float = 8e-6
    runout_angle: float = 0.0
    setting: tuple[float, ...] = ()
    wander: float = 1e-3
    rate: float = 5000.0
    noise_rate: float = 5000.0
    force_noise: float = 1.5
    motion_noise: float = 0.012
    coloured: bool = False
    bits: int = 16
    encoder: int = 1024
    mounted: float = 0.0
    dynamometer: float = math.inf
    dynamometer_damping: float = 0.03
    plate: float = 0.0
    posture: float = 0.0
    turning: tuple[int, float] = (0, 0.0)
    offsets: tuple[float, float] = (0.0, 0.0)
    drift: float = 0.0
    modes: Modes = field(default_factory=lambda: drawn_modes(4, np.random.default_rng(0)))

    def arc(self, cut: str) -> tuple[float, float]:
        """Entry and exit [rad]."""
        width = self.widths[CUTS.index(cut)]
        if cut == "central":
            half = math.asin(width / self.diameter)
            return 0.5 * math.pi - half, 0.5 * math.pi + half
        reach = math.acos(1.0 - 2.0 * width / self.diameter)
        return (math.pi - reach, math.pi) if cut == "down" else (0.0, reach)


def with_nuisances(campaign: Campaign, rng: np.random.Generator) -> Campaign:
    """Coefficients within 15 %, run-out of 5-12 um, seat of the inserts, ramp within 3 %, offsets and drift."""
    cutting, edge = (
        tuple(float(v) for v in np.array(c) * (1.0 + 0.15 * rng.uniform(-1, 1, 3)))
        for c in (campaign.cutting, campaign.edge)
    )
    return replace(
        campaign,
        cutting=cutting,
        edge=edge,
        runout=float(rng.uniform(5e-6, 12e-6)),
        runout_angle=float(rng.uniform(0.0, 2.0 * math.pi)),
        setting=tuple(float(v) for v in rng.uniform(-1.5e-6, 1.5e-6, campaign.teeth)),
        acceleration=campaign.acceleration * float(rng.uniform(0.97, 1.03)),
        wander=float(rng.uniform(0.5e-3, 2e-3)),
        encoder=int(rng.choice([256, 1024, 2500])),
        mounted=float(rng.uniform(0.0, 2.0 * math.pi)),
        offsets=(float(rng.uniform(-1.0, 1.0)), float(rng.uniform(-0.02, 0.02))),
        drift=float(rng.uniform(-1.0, 1.0)),
    )


def _steps(modes: Modes, stretch: Real) -> Real:
    """Exact step of each mode for a force linear in time, for each factor of all stiffnesses, (blocks, m, 11)."""
    dt = 1.0 / INNER_RATE
    out = np.empty((stretch.size, modes.frequency.size, 11))
    for r, (f, z, k) in enumerate(zip(modes.frequency, modes.damping, modes.stiffness, strict=True)):
        w = 2.0 * math.pi * f
        gain, drag = w * w / k, 2.0 * z * w
        for b, factor in enumerate(stretch):
            spring = w * w * factor
            system = np.array([[0, 1, 0, 0], [-spring, -drag, gain, 0], [0, 0, 0, 1], [0, 0, 0, 0]], dtype=float)
            e = linalg.expm(system * dt)
            # x1 = A x0 + (whole) f0 + (slope/dt)(f1 - f0)
            out[b, r] = [*e[0, :2], *e[1, :2], e[0, 2], e[1, 2], e[0, 3] / dt, e[1, 3] / dt, gain, drag, spring]
    return out


def _times(campaign: Campaign) -> tuple[Real, Real, Real]:
    """Time, depth and travel of every inner step."""
    t = np.arange(round((campaign.lead + campaign.seconds + campaign.tail) * INNER_RATE)) / INNER_RATE
    inside = t - campaign.lead
    ramp = np.clip(np.minimum(inside, campaign.seconds - inside) / RUN_IN, 0.0, 1.0)
    return t, campaign.depth * ramp, campaign.feed_rate * np.clip(inside, 0.0, campaign.seconds)


def _angle(campaign: Campaign, t: Real, rng: np.random.Generator) -> Real:
    """Angle of the spindle [rad]: ramp, and a slow wander of the speed."""
    slow = 2.0 * math.pi * rng.uniform(0.3, 0.8)
    begin, phase = rng.uniform(0.0, 2.0 * math.pi, 2)
    wander = campaign.wander * campaign.rotation / slow * (np.cos(phase) - np.cos(slow * t + phase))
    return begin + campaign.rotation * t + 0.5 * campaign.acceleration * t**2 + wander


def _turning(campaign: Campaign, angle: Real) -> Real:
    """Force that turns with an order of the spindle and is not in the forces."""
    order, size = campaign.turning
    if size == 0.0:
        return np.zeros((0, 3))
    return size * np.stack([np.cos(order * angle), np.sin(order * angle), 0.5 * np.cos(order * angle + 1.0)], axis=1)


def resonance(frequency: float, ratio: float) -> Real:
    """Second-order section of a resonance with unit static gain (bilinear, true at its frequency)."""
    w = 2.0 * math.pi * frequency
    k = w / math.tan(0.5 * w / INNER_RATE)
    a0 = k * k + 2.0 * ratio * w * k + w * w
    g = w * w / a0
    return np.array([[g, 2.0 * g, g, 1.0, 2.0 * (w * w - k * k) / a0, (k * k - 2.0 * ratio * w * k + w * w) / a0]])


def _noise(campaign: Campaign, n: int, rng: np.random.Generator) -> Real:
    """Noise (3, n) of unit rms at the rate of the noise."""
    if campaign.coloured:
        return np.array([instruments.noise(rng, n) for _ in range(3)])
    return math.sqrt(campaign.rate / campaign.noise_rate) * rng.standard_normal((3, n))


def clean(campaign: Campaign, cut: str, rng: np.random.Generator) -> tuple[Real, Real, Real]:
    """Angle (n,), force and acceleration (3, n) at the inner rate, before any instrument; "air": the spindle turns."""
    t, depth, travel = _times(campaign)
    angle = _angle(campaign, t, rng)
    pitch = 2.0 * math.pi * np.arange(campaign.teeth) / campaign.teeth
    radii = campaign.runout * np.cos(pitch + campaign.runout_angle) + np.array(campaign.setting or [0.0])
    arc = campaign.arc("down" if cut == "air" else cut)
    if cut == "air":
        depth = np.zeros_like(depth)
    stretch = np.ones(1)
    if campaign.posture:
        middle = (np.arange(BLOCKS) + 0.5) / BLOCKS * t[-1] - campaign.lead - 0.5 * campaign.seconds
        stretch = 1.0 + campaign.posture * np.clip(middle / (0.5 * campaign.seconds), -1.0, 1.0)
    force, motion = np.empty((t.size, 3)), np.empty((t.size, 3))
    steps = _steps(campaign.modes, stretch)
    impact = _turning(campaign, angle)
    cutting, edge = np.array(campaign.cutting), np.array(campaign.edge)
    shape = np.ascontiguousarray(campaign.modes.direction)
    integrate(angle, depth, travel, arc, radii, campaign.approach, cutting, edge, impact, shape, steps, force, motion)
    return angle, force.T, motion.T


def record(campaign: Campaign, cut: str, rng: np.random.Generator) -> dict[str, Any]:
    """Return ``cut``, ``time`` (n,) [s], ``force`` (3, n) [N], ``acceleration`` (3, n), and ``angle`` or ``tacho``."""
    angle, force, motion = clean(campaign, cut, rng)
    division = round(INNER_RATE / campaign.rate)
    sections = instruments.butterworth(6, 0.36 * campaign.rate, INNER_RATE)
    shown = force - campaign.plate * motion
    if math.isfinite(campaign.dynamometer):
        shown = signal.sosfilt(resonance(campaign.dynamometer, campaign.dynamometer_damping), shown)
    seen = {"force": shown, "acceleration": motion}
    levels = {"force": campaign.force_noise, "acceleration": campaign.motion_noise}
    out: dict[str, Any] = {"cut": cut}
    for (name, x), offset in zip(seen.items(), campaign.offsets, strict=True):
        x = signal.sosfilt(sections, x)[:, ::division]
        out["time"] = np.arange(x.shape[1]) / campaign.rate
        slope = campaign.drift / 60.0 * out["time"] if name == "force" else 0.0
        x = x + offset + slope + levels[name] * _noise(campaign, x.shape[1], rng)
        out[name] = np.array([instruments.converted(row, campaign.bits) for row in x])
    return out | _clock(campaign, angle[::division], rng)


def _clock(campaign: Campaign, angle: Real, rng: np.random.Generator) -> dict[str, Real]:
    """Angle signal: counts of an encoder, or one pulse a turn with some noise."""
    mounted = angle + campaign.mounted
    if campaign.encoder:
        count = 2.0 * math.pi / campaign.encoder
        return {"angle": np.floor(mounted / count) * count}
    high = np.mod(mounted, 2.0 * math.pi) < 0.5 * math.pi
    return {"tacho": 5.0 * high + 0.05 * rng.standard_normal(angle.size)}


def measure(campaign: Campaign, seed: int, cuts: Sequence[str] = CUTS) -> list[dict[str, Any]]:
    """Cut the passes, one record each."""
    seeds = np.random.SeedSequence([seed, 7]).spawn(len(cuts))
    return [record(campaign, cut, np.random.default_rng(s)) for cut, s in zip(cuts, seeds, strict=True)]


def required(modes: int, seed: int, **changes: Any) -> Campaign:
    """Draw a machine of some modes and the nuisances of one campaign."""
    rng = np.random.default_rng([seed, modes])
    machine = drawn_modes(modes, rng)
    return replace(with_nuisances(Campaign(modes=machine), rng), **changes)
