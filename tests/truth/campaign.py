"""What is measured: conditions, designs, `measure` to records, `reduce` to compliances with their scatter."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from truth import chain as instruments
from truth.axis import MM_MIN, Setting, Truth, response_at_rest, simulate
from truth.chain import SAMPLE_RATE, Chain

Record = dict[str, Any]

RUN_IN = 0.25
"""Steady motion before a record begins [s]."""

PRETRIGGER = 0.1
LENGTH = 2.0
"""Length of the record of one impact [s]."""

DWELL, FIT = 0.9, 0.7
"""A step of the actuator: settles, is fitted [s]."""

BAND = (8.0, 200.0)
"""Lines that `reduce` keeps [Hz]."""

STEPS = np.concatenate([np.arange(12.0, 56.0, 4.0), np.arange(56.0, 67.0, 1.0), np.arange(68.0, 93.0, 4.0)])
"""Frequencies of the actuator [Hz]."""


@dataclass(frozen=True)
class Condition:
    """One line of the plan: feed in mm/min with its sign; level in N (peak of a impact, amplitude of the actuator).

    `order` is 0 for the first and 1 for the last of the session; `added_mass` [kg] is known and sits on the tip.
    sensor "laser" puts no mass on the tip.
    """

    method: str = "hammer"
    feed: float = 0.0
    level: float = 100.0
    controller: str = "K2"
    position: float = 0.0
    added_mass: float = 0.0
    sensor: str = "accelerometer"
    repeats: int = 4
    order: float = 0.0

    @property
    def name(self) -> str:
        way = "idle" if self.feed == 0.0 else f"{self.feed:+g} mm/min"
        extra = f", +{self.added_mass:g} kg" if self.added_mass else ""
        laser = ", laser" if self.sensor == "laser" else ""
        return f"{self.method} {way}, {self.level:g} N, {self.controller}, {self.position:g} m{extra}{laser}"

    def settings(self) -> dict[str, float | str]:
        """Return what a user would write down."""
        return {
            "method": self.method,
            "feed_mm_min": self.feed,
            "direction": float(np.sign(self.feed)),
            "level": self.level,
            "controller": self.controller,
            "position": self.position,
            "added_mass": self.added_mass,
            "sensor": self.sensor,
            "order": self.order,
        }


@dataclass(frozen=True)
class Design:
    """A plan: conditions in the order in which they are measured."""

    name: str
    conditions: tuple[Condition, ...] = field(repr=False)


def ordered(name: str, conditions: Sequence[Condition], seed: int, bracket: Condition | None = None) -> Design:
    """Shuffle; measure `bracket` first, in the middle and last (ABA); write down the order."""
    rng = np.random.default_rng(seed)
    line = [conditions[i] for i in rng.permutation(len(conditions))]
    if bracket is not None:
        line = [bracket, *line[: len(line) // 2], bracket, *line[len(line) // 2 :], bracket]
    last = max(len(line) - 1, 1)
    return Design(name, tuple(replace(c, order=i / last) for i, c in enumerate(line)))


def full(seed: int = 0) -> Design:
    """Silent record; idle impacts at 3 levels; 2 feeds x 2 ways x 2 levels x 2 controllers; 3 places; one added mass.

    The idle impact of the middle level at the first place brackets the session: first, middle, last.
    """
    return ordered("full", _minimum(), seed, Condition())


def _minimum() -> list[Condition]:
    plan = [Condition("silent", level=0.0, repeats=1)]
    plan += [Condition(level=level) for level in (25.0, 400.0)]
    for feed in (500.0, -500.0, 1000.0, -1000.0):
        for level in (50.0, 200.0):
            plan += [Condition(feed=feed, level=level, controller=k) for k in ("K2", "K3")]
    plan += [Condition(position=x) for x in (0.5, 1.0)]
    return [*plan, Condition(added_mass=1.0)]


def with_laser(seed: int = 0) -> Design:
    """Full design, and idle impacts seen by a laser, which weighs nothing, without and with the added mass."""
    laser = [Condition(sensor="laser"), Condition(sensor="laser", added_mass=1.0)]
    return ordered("with laser", [*_minimum(), *laser], seed, Condition())


def hammer_only(seed: int = 0) -> Design:
    """Idle and 500 mm/min, one level, one controller."""
    return ordered("hammer only", [Condition(), Condition(feed=500.0)], seed)


def transition(seed: int = 0) -> Design:
    """Idle, the transition feeds 25 to 250 mm/min, 500 and 1000 mm/min under K3 (at rest at every feed), both ways."""
    plan = [Condition(controller="K3")]
    for feed in (25.0, 50.0, 100.0, 250.0, 500.0, 1000.0):
        plan += [Condition(feed=way * feed, controller="K3", level=50.0) for way in (1.0, -1.0)]
    return ordered("transition", plan, seed)


def actuator(
    seed: int = 0, feeds: Iterable[float] = (0.0, 500.0), levels: Iterable[float] = (20.0, 60.0, 150.0)
) -> Design:
    """Stepped sines of constant force: 3 levels, idle and in motion."""
    return ordered("actuator", [Condition("actuator", f, n, "K3", repeats=1) for f in feeds for n in levels], seed)


DESIGNS = {
    "full": full,
    "with laser": with_laser,
    "hammer only": hammer_only,
    "transition": transition,
    "actuator": actuator,
}


def measure(truth: Truth, design: Design, seed: int, chain: Chain | None = None) -> list[Record]:
    """Carry out a design and return one record per condition.

    A record holds ``condition``, ``settings``; ``time`` (n,) [s]; ``force`` [N], ``acceleration`` [m/s2], ``encoder``
    [m], ``drive_force`` [N], each (repeats, n); of an actuator ``steps`` (frequency [Hz], start, stop [s]) and one
    row; ``at_rest`` (False: the axis vibrates without any excitation) and ``vibration`` (its speed over the feed).
    """
    chain = chain or Chain()
    rng = np.random.default_rng(seed)
    walk = _walk(truth, len(design.conditions), rng)
    settings = [_setting(truth, c, w) for c, w in zip(design.conditions, walk, strict=True)]
    seeds = np.random.SeedSequence(seed).spawn(len(design.conditions))
    moving = {(s.feed, s.controller): s for s in settings if s.feed != 0.0}
    with ThreadPoolExecutor(2) as pool:
        rest = {key: pool.submit(response_at_rest, truth, s) for key, s in moving.items()}
        jobs = [
            pool.submit(_signals, truth, c, s, chain, q)
            for c, s, q in zip(design.conditions, settings, seeds, strict=True)
        ]
        clean = [job.result() for job in jobs]
    sigma = _noise_levels(design, clean, chain)
    records = []
    for c, s, signals, q in zip(design.conditions, settings, clean, seeds, strict=True):
        record = _recorded(c, signals, chain, sigma, np.random.default_rng(q.spawn(1)[0]), truth.control.resolution)
        future = rest.get((s.feed, s.controller))
        record["at_rest"], record["vibration"] = future.result() if future else (True, 0.0)
        records.append(record)
    return records


def _walk(truth: Truth, n: int, rng: np.random.Generator) -> np.ndarray:
    """Relative stiffness in every condition: drift with the order, and a random walk."""
    order = np.linspace(0.0, 1.0, n) if n > 1 else np.zeros(n)
    steps = rng.standard_normal(n) * truth.walk / math.sqrt(max(n - 1, 1))
    steps[0] = 0.0
    return (1.0 + truth.drift * order) * (1.0 + np.cumsum(steps))


def _setting(truth: Truth, c: Condition, stiffness: float) -> Setting:
    mass = c.added_mass + (truth.sensor_mass if c.sensor == "accelerometer" else 0.0)
    return Setting(c.feed * MM_MIN, c.controller, c.position, mass, float(stiffness))


def _signals(
    truth: Truth, c: Condition, s: Setting, chain: Chain, seed: np.random.SeedSequence
) -> dict[str, np.ndarray]:
    """Filtered signals without noise, each (repeats, n), and the steps of an actuator."""
    rng = np.random.default_rng(seed)
    rows, steps = [], np.zeros((0, 3))
    for _ in range(c.repeats):
        now = replace(s, arrival=float(rng.uniform(-0.3, 0.3)), phase=float(rng.uniform()))
        pulses, tones, length = np.zeros((0, 4)), np.zeros((0, 5)), LENGTH
        if c.method == "hammer":
            pulses = instruments.hit(rng, c.level, chain.double)
            pulses[:, 0] += RUN_IN + PRETRIGGER + rng.uniform(0.0, 1.0 / SAMPLE_RATE)
        elif c.method == "actuator":
            tones, steps, length = _tones(c.level)
        raw = simulate(truth, now, pulses, tones, RUN_IN + length)
        cut = round(RUN_IN * SAMPLE_RATE)
        every = raw[:, :: instruments.DIVISION]
        acceleration = instruments.slowed(instruments.late(raw[0], chain.skew))
        rows.append([instruments.slowed(raw[3])[cut:], acceleration[cut:], every[1, cut:], every[2, cut:]])
    force, acceleration, encoder, drive = np.array(rows).transpose(1, 0, 2)
    return {"force": force, "acceleration": acceleration, "encoder": encoder, "drive_force": drive, "steps": steps}


def _tones(level: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Rows of the excitation (times with the run-in); rows (frequency, start and stop of the fit); length [s]."""
    starts = np.arange(STEPS.size) * (DWELL + FIT)
    phase = np.zeros(STEPS.size)
    for i in range(1, STEPS.size):
        phase[i] = (phase[i - 1] + 2.0 * math.pi * STEPS[i - 1] * (DWELL + FIT)) % (2.0 * math.pi)
    tones = np.column_stack([starts + RUN_IN, starts + RUN_IN + DWELL + FIT, np.full(STEPS.size, level), STEPS, phase])
    steps = np.column_stack([STEPS, starts + DWELL, starts + DWELL + FIT])
    return tones, steps, float(starts[-1] + DWELL + FIT)


def _noise_levels(design: Design, clean: Sequence[dict[str, np.ndarray]], chain: Chain) -> tuple[float, float]:
    """rms of the noise of force [N] and acceleration [m/s2], from the records at the middle level."""
    excited = [(c.level, d) for c, d in zip(design.conditions, clean, strict=True) if c.method != "silent"]
    middle = sorted(level for level, _ in excited)[len(excited) // 2]
    there = [d for level, d in excited if level == middle]
    response, force = (float(np.median([d[name].std() for d in there])) for name in ("acceleration", "force"))
    return force * 10.0 ** (-(chain.snr + 20.0) / 20.0), response * 10.0 ** (-chain.snr / 20.0)


def _recorded(
    c: Condition,
    clean: dict[str, np.ndarray],
    chain: Chain,
    sigma: tuple[float, float],
    rng: np.random.Generator,
    resolution: float,
) -> Record:
    count, n = clean["force"].shape
    time = np.arange(n) / SAMPLE_RATE
    line = instruments.tone_amplitude(chain, sigma[1], LENGTH)
    force, acceleration = np.empty((count, n)), np.empty((count, n))
    for i in range(count):
        tone = line * np.sin(2.0 * math.pi * chain.mains * time + rng.uniform(0.0, 2.0 * math.pi))
        noisy = chain.gain * clean["acceleration"][i] + sigma[1] * instruments.noise(rng, n) + tone
        acceleration[i] = instruments.converted(noisy, chain.bits)
        force[i] = instruments.converted(clean["force"][i] + sigma[0] * instruments.noise(rng, n), chain.bits)
    encoder = np.round(clean["encoder"] / resolution) * resolution if resolution > 0.0 else clean["encoder"]
    return {
        "condition": c,
        "settings": c.settings(),
        "time": time,
        "force": force,
        "acceleration": acceleration,
        "encoder": encoder,
        "drive_force": clean["drive_force"],
        "steps": clean["steps"],
    }


def reduce(record: Record) -> Record:
    """Estimate the tip compliance from a record: H1 over the impacts, or a sine fit per step.

    Returns ``condition``, ``settings``, ``at_rest``; ``frequency`` (f,) [Hz]; ``compliance`` (f,) [m/N];
    ``std`` (f,) [m/N]: standard deviation of the estimate, ``sqrt(E|error|^2)``, from the scatter; ``dof``.
    """
    method = record["condition"].method
    if method == "silent":
        raise ValueError("a silent record has no excitation to refer to")
    f, h, std, dof = _h1(record) if method == "hammer" else _sines(record)
    kept = {name: record[name] for name in ("condition", "settings", "at_rest", "vibration")}
    return {**kept, "frequency": f, "compliance": h, "std": std, "dof": dof}


def _h1(record: Record) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """``H = sum X F* / sum |F|^2``; its variance is that of the residuals ``X - H F`` over ``sum |F|^2``."""
    n = record["time"].size
    f = np.fft.rfftfreq(n, 1.0 / SAMPLE_RATE)
    band = (f >= BAND[0]) & (f <= BAND[1])
    quiet = round(0.9 * PRETRIGGER * SAMPLE_RATE)
    parts = []
    for name in ("force", "acceleration"):
        x = record[name] - record[name][:, :quiet].mean(axis=1, keepdims=True)
        parts.append(np.fft.rfft(x)[:, band])
    force, response = parts[0], parts[1] / -((2.0 * math.pi * f[band]) ** 2)
    power = (np.abs(force) ** 2).sum(axis=0)
    h = (response * force.conj()).sum(axis=0) / power
    dof = force.shape[0] - 1
    scatter = (np.abs(response - h * force) ** 2).sum(axis=0) / dof
    return f[band], h, np.sqrt(scatter / power), dof


def _sines(record: Record, parts: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Ratio of fitted sines, mean over `parts` pieces of each step; the variance is that of the mean."""
    mean, std = [], []
    for frequency, start, stop in record["steps"]:
        edges = np.round(np.linspace(start, stop, parts + 1) * SAMPLE_RATE).astype(int)
        pieces = []
        for a, b in pairwise(edges):
            angle = 2.0 * math.pi * frequency * record["time"][a:b]
            base = np.column_stack([np.cos(angle), np.sin(angle), np.ones(b - a)])
            two = np.column_stack([record["force"][0, a:b], record["acceleration"][0, a:b]])
            fit = np.linalg.lstsq(base, two, rcond=None)[0]
            phasor = fit[0] - 1j * fit[1]
            pieces.append(phasor[1] / phasor[0] / -((2.0 * math.pi * frequency) ** 2))
        values = np.array(pieces)
        mean.append(values.mean())
        std.append(math.sqrt((np.abs(values - values.mean()) ** 2).sum() / (parts - 1) / parts))
    return record["steps"][:, 0], np.array(mean), np.array(std), parts - 1
