"""Sweeps drawn at random: machine, tool, sensors, ends of the record, clocks and cut drawn at random.

Nothing is imported from the packages. Machine and cut are those of `truth.sweep`; drawn are 2 to 5 modes, 2 to 8 teeth,
widths, depth, run-out and edges; noise of the sensors over decades; air at none, one or both ends, teeth that touch in
it, a cut that fades, ramps of entry and exit; a time base or a speed column that is wrong; records that are resampled
and quantised, one channel late; and passes that chatter. Short passes at a moderate rate. SI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import ndimage, signal

from truth import chain as instruments
from truth.sweep import CUTS, INNER_RATE, Campaign, Modes, _steps
from truth.sweep_kernel import integrate

RATE = 1000.0
"""Rate of the records [Hz]."""

Real = np.ndarray


@dataclass(frozen=True)
class DrawnSweep:
    """One campaign of three passes.

    first, last: tooth passing [Hz] at begin and end of the cut; seconds in the cut. lead, tail: air [s]. ramps: entry
    and exit [s]. touch_share: share of the depth that still touches in the air, before and after. fade: share of the
    cut at whose end the depth has fallen to a tenth. depths: of each pass [m]. clock: relative error of the time base;
    column: of the speed column. late: of the accelerations [s]. quantised: bits, 0 for none. resampled: rate that the
    records are interpolated to [Hz], 0 for none. speed_signal: "speed", "angle", "tacho" or "nothing".
    nominal: the speed column is the commanded ramp, without the wander of the spindle.
    """

    modes: Modes
    teeth: int
    diameter: float
    widths: tuple[float, float, float]
    depths: tuple[float, float, float]
    feed: float
    first: float
    last: float
    seconds: float
    force_noise: float
    motion_noise: float
    cutting: tuple[float, float, float]
    edge: tuple[float, float, float]
    radii: tuple[float, ...]
    lead: float = 1.0
    tail: float = 2.0
    ramps: tuple[float, float] = (0.3, 0.3)
    touch_share: tuple[float, float] = (0.0, 0.0)
    fade: float = 0.0
    wander: float = 1e-3
    clock: float = 0.0
    column: float = 0.0
    column_late: float = 0.0
    late: float = 0.0
    quantised: int = 0
    resampled: float = 0.0
    speed_signal: str = "speed"
    nominal: bool = False

    def arc(self, cut: str) -> tuple[float, float]:
        """Entry and exit [rad]."""
        return Campaign(diameter=self.diameter, widths=self.widths).arc(cut)


def drawn_machine(rng: np.random.Generator) -> Modes:
    """Draw 2 to 5 modes between 25 and 75 Hz in any direction, and a stiff one beyond."""
    count = int(rng.integers(2, 6))
    f, z = rng.uniform(25.0, 75.0, count), np.exp(rng.uniform(math.log(0.015), math.log(0.08), count))
    k = np.exp(rng.uniform(math.log(15e6), math.log(100e6), count))
    f, z, k = (
        np.append(f, rng.uniform(150, 300)),
        np.append(z, rng.uniform(0.03, 0.06)),
        np.append(k, rng.uniform(1, 3) * 1e8),
    )
    u = rng.standard_normal((count + 1, 3))
    order = np.argsort(f)
    return Modes(f[order], z[order], k[order], (u / np.linalg.norm(u, axis=1)[:, None])[order])


def draw(seed: int) -> DrawnSweep:
    """Draw one campaign."""
    rng = np.random.default_rng([seed, 181])
    teeth, diameter = int(rng.integers(2, 9)), float(rng.choice([0.05, 0.063, 0.08, 0.1, 0.125]))
    deep = math.exp(rng.uniform(math.log(0.3e-3), math.log(1.2e-3))) * 2.0 / math.sqrt(teeth)
    depths = [deep] * 3
    if rng.uniform() < 0.12:  # one pass far deeper than the others, or all of them
        which = range(3) if rng.uniform() < 0.5 else [int(rng.integers(3))]
        for k in which:
            depths[k] = deep * rng.uniform(5.0, 30.0)
    ends, noise = int(rng.choice(4, p=[0.15, 0.15, 0.15, 0.55])), rng.uniform(size=2)
    lead, tail = rng.uniform(0.4, 2.0) * (ends in (1, 3)), rng.uniform(0.5, 4.0) * (ends in (2, 3))
    touch_share = rng.uniform(0.0, 0.05, 2) * (rng.uniform(size=2) < 0.35)
    wrong, sign = rng.uniform(), rng.choice([-1.0, 1.0])
    off = sign * math.exp(rng.uniform(math.log(3e-3), math.log(0.05)))
    setting = rng.uniform(0.0, 20e-6) * rng.uniform(-1.0, 1.0, teeth) * (rng.uniform() < 0.85)
    speed_signal = str(rng.choice(["speed", "angle", "tacho", "nothing"], p=[0.6, 0.2, 0.12, 0.08]))
    return DrawnSweep(
        modes=drawn_machine(rng),
        teeth=teeth,
        diameter=diameter,
        widths=tuple(float(diameter * s) for s in rng.uniform([0.1, 0.1, 0.2], [0.5, 0.5, 0.9])),
        depths=tuple(depths),
        feed=float(rng.uniform(0.04e-3, 0.2e-3)),
        first=float(rng.uniform(14.0, 24.0)),
        last=float(rng.uniform(45.0, 85.0)),
        seconds=float(rng.uniform(10.0, 20.0)),
        force_noise=float(math.exp(math.log(1e-3) + noise[0] * math.log(50.0 / 1e-3))),
        motion_noise=float(math.exp(math.log(1e-5) + noise[1] * math.log(0.5 / 1e-5))),
        cutting=tuple(
            float(v) for v in np.array([1889e6, 806e6, 291e6]) * rng.uniform(0.5, 1.5) * rng.uniform(0.8, 1.2, 3)
        ),
        edge=tuple(float(v) for v in np.array([50e3, 80e3, 5e3]) * rng.uniform(0.0, 1.5, 3)),
        radii=tuple(float(v) for v in setting),
        lead=float(lead),
        tail=float(tail),
        ramps=(float(rng.uniform(0.02, 0.8)), float(rng.uniform(0.02, 0.8))),
        touch_share=(float(touch_share[0]), float(touch_share[1])),
        fade=float(rng.uniform(0.1, 0.6)) * float(rng.uniform() < 0.2),
        wander=float(rng.uniform(0.0, 2e-3)),
        clock=off * (wrong < 0.15),
        column=off * (0.15 <= wrong < 0.3),
        column_late=float(rng.uniform(0.0, 0.2)) * float(rng.uniform() < 0.3),
        late=float(rng.uniform(-2e-4, 2e-4)) * float(rng.uniform() < 0.1),
        quantised=int(rng.choice([0, 12, 16, 24])),
        resampled=float(rng.choice([0.0, 1024.0, 800.0])) if rng.uniform() < 0.3 else 0.0,
        speed_signal=speed_signal,
        nominal=bool(rng.uniform() < 0.4),
    )  # fmt: skip


def _depth(t: Real, depth: float, this: DrawnSweep) -> Real:
    """Depth of cut at each step [m]: ramps, a fading cut, and what still touches in the air."""
    inside = t - this.lead
    up, down = inside / this.ramps[0], (this.seconds - inside) / this.ramps[1]
    if this.lead == 0.0:
        up = np.full_like(t, 1.0)
    if this.tail == 0.0:
        down = np.full_like(t, 1.0)
    cut = np.clip(np.minimum(up, down), 0.0, 1.0)
    if this.fade:
        start = (1.0 - this.fade) * this.seconds
        cut = cut * np.clip(1.0 - 0.9 * (inside - start) / (this.seconds - start), 0.1, 1.0)
    touch = np.where(inside < 0.5 * this.seconds, this.touch_share[0], this.touch_share[1])
    return depth * np.maximum(cut, touch)


def clean(
    this: DrawnSweep, cut: str, rng: np.random.Generator, kick: float = 0.0
) -> tuple[Real, Real, Real, Real, Real]:
    """Time, rate of the spindle as commanded, angle (n,), force and acceleration (3, n), before any instrument.

    kick: force [N] that pushes for 5 ms every 2 s.
    """
    t = np.arange(round((this.lead + this.seconds + this.tail) * INNER_RATE)) / INNER_RATE
    first, last = 2.0 * math.pi * np.array([this.first, this.last]) / this.teeth
    commanded = first + (last - first) * np.clip((t - this.lead) / this.seconds, -0.1, 1.1)
    slow, phase = 2.0 * math.pi * rng.uniform(0.3, 0.8), rng.uniform(0.0, 2.0 * math.pi)
    rotation = commanded * (1.0 + this.wander * np.sin(slow * t + phase))
    angle = rng.uniform(0.0, 2.0 * math.pi) + np.cumsum(rotation) / INNER_RATE
    depth = _depth(t, this.depths[CUTS.index(cut)], this)
    # The feed a tooth is the drawn one in the middle of the sweep; the feed rate is held.
    travel = this.feed * 0.5 * (this.first + this.last) * t
    force, motion = np.empty((t.size, 3)), np.empty((t.size, 3))
    steps, shape = _steps(this.modes, np.ones(1)), np.ascontiguousarray(this.modes.direction)
    cutting, edge = np.array(this.cutting), np.array(this.edge)
    none = np.zeros((0, 3))
    radii = np.array(this.radii)
    integrate(
        angle, depth, travel, this.arc(cut), radii, math.pi / 4.0, cutting, edge, none, shape, steps, force, motion
    )
    return t, commanded if this.nominal else rotation, angle, force.T, motion.T


def between_orders(angle: Real, force: Real, teeth: int) -> float:
    """Largest rms of a force that does not repeat with the spindle over that which does, within two seconds or so."""
    places, turns = 8 * teeth, max(8, round(64 / teeth))
    grid = np.arange(angle[0], angle[-1], 2.0 * math.pi / places)
    level = np.array([np.interp(grid, angle, f) for f in force])
    pieces = level[:, : level.shape[1] // (places * turns) * places * turns].reshape(3, -1, places * turns)
    shape = np.hanning(places * turns)
    power = np.sum(np.abs(np.fft.rfft((pieces - pieces.mean(axis=2, keepdims=True)) * shape, axis=2)) ** 2, axis=0)
    order = np.arange(power.shape[1]) / turns
    near = np.abs(order - np.round(order)) < 2.5 / turns
    used = (order > 0.4 * teeth) & (order < 3.2 * teeth)
    repeats, rest = power[:, used & near].sum(axis=1), power[:, used & ~near].sum(axis=1)
    strong = repeats > 0.05 * np.quantile(repeats, 0.9)
    return float(np.sqrt((rest[strong] / repeats[strong]).max()))


def chatter(this: DrawnSweep, angle: Real, force: Real) -> float:
    """Return `between_orders` of what is wholly in the cut: a tool that enters shakes the machine, too."""
    begin = this.lead + (this.ramps[0] + 0.3) * (this.lead > 0.0)
    end = this.lead + this.seconds - (this.ramps[1] + 0.1) * (this.tail > 0.0)
    inside = slice(round(begin * INNER_RATE), round(end * INNER_RATE), 4)
    return between_orders(angle[inside], force[:, inside], this.teeth)


def _shifted(x: Real, late: float) -> Real:
    """Return channels that come late [s]; a spline between the steps."""
    return ndimage.shift(x, (0.0, late * INNER_RATE), order=3, mode="nearest") if late else x


def record(this: DrawnSweep, cut: str, rng: np.random.Generator) -> dict[str, Any]:
    """Return ``cut``, ``time``, ``force``, ``acceleration`` (3, n), the signal of the speed, what was stated, and
    ``between_orders``: how much of the force without noise chatters."""
    t, rate, angle, force, motion = clean(this, cut, rng)
    division = round(INNER_RATE / RATE)
    sections = instruments.butterworth(6, 0.36 * RATE, INNER_RATE)
    out: dict[str, Any] = {"cut": cut, "between_orders": chatter(this, angle, force)}
    levels = {"force": this.force_noise, "acceleration": this.motion_noise}
    for name, x in (("force", force), ("acceleration", _shifted(motion, this.late))):
        seen = signal.sosfilt(sections, x)[:, ::division]
        seen = seen + levels[name] * rng.standard_normal(seen.shape)
        if this.quantised:
            # A converter whose range is four times the signal.
            bit = 8.0 * np.abs(seen).max() / 2.0**this.quantised
            seen = bit * np.round(seen / bit)
        out[name] = seen
    slow = (
        ndimage.shift(rate, round(this.column_late * INNER_RATE), order=0, mode="nearest") if this.column_late else rate
    )
    time, stated = t[::division], slow[::division] * 30.0 / math.pi * (1.0 + this.column)
    turned = angle[::division]
    if this.resampled:
        fresh = np.arange(math.floor(time[-1] * this.resampled)) / this.resampled
        for name in levels:
            out[name] = np.array([np.interp(fresh, time, row) for row in out[name]])
        time, stated, turned = fresh, np.interp(fresh, time, stated), np.interp(fresh, time, turned)
    out["time"] = time * (1.0 + this.clock)
    if this.speed_signal == "speed":
        out["speed"] = stated
    elif this.speed_signal == "angle":
        out["angle"] = np.floor(turned / (2.0 * math.pi / 1024)) * (2.0 * math.pi / 1024)
    elif this.speed_signal == "tacho":
        out["tacho"] = 5.0 * (np.mod(turned, 2.0 * math.pi) < 0.5 * math.pi) + 0.05 * rng.standard_normal(turned.size)
    # What a user writes into the campaign file: the speeds the ramp was set to.
    out["stated"] = tuple(float(v) * 60.0 / this.teeth for v in (this.first, this.last))
    return out


def measure(this: DrawnSweep, seed: int) -> list[dict[str, Any]]:
    """Cut the three passes, one record each."""
    streams = np.random.SeedSequence([seed, 182]).spawn(len(CUTS))
    return [record(this, cut, np.random.default_rng(s)) for cut, s in zip(CUTS, streams, strict=True)]
