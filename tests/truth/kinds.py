"""Records of every kind that a workshop brings, drawn at random, as plain columns; shares no code with the package."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import signal

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Drawn:
    """A record: its kind, sample rate [Hz] and columns, called ``force_x``, ``acceleration_x`` ..."""

    kind: str
    rate: float
    columns: dict[str, Real]


def _machine(rng: np.random.Generator, force: Real, rate: float) -> Real:
    """Acceleration of one to four modes under a force."""
    motion = np.zeros(force.size)
    for _ in range(rng.integers(1, 5)):
        f, zeta = rate * rng.uniform(0.01, 0.2), rng.uniform(0.01, 0.08)
        w = 2.0 * np.pi * f
        system = signal.cont2discrete(([1.0, 0.0, 0.0], [1.0, 2.0 * zeta * w, w**2]), 1.0 / rate, "bilinear")
        motion += signal.lfilter(system[0].ravel(), system[1], force) / rng.uniform(5.0, 500.0)
    return motion


def _noisy(rng: np.random.Generator, samples: Real) -> Real:
    """Add noise of -30 to -60 dB, an offset, and steps of a converter."""
    rms = np.sqrt(np.mean(samples**2))
    out = samples + rms * 10.0 ** rng.uniform(-3.0, -1.5) * rng.standard_normal(samples.size)
    out += rms * rng.uniform(-0.3, 0.3)
    step = np.ptp(out) / 2.0 ** rng.integers(11, 24)
    return step * np.round(out / step)


def _size(rng: np.random.Generator) -> tuple[float, int]:
    rate = float(rng.choice([2000.0, 5000.0, 10_000.0, 25_600.0, 51_200.0]))
    return rate, int(rng.integers(15_000, 60_000))


def impact(rng: np.random.Generator) -> tuple[float, dict[str, Real]]:
    """One to eight hits of a soft or hard tip."""
    rate, size = _size(rng)
    force = np.zeros(size)
    width = max(4, int(rate * 10.0 ** rng.uniform(-3.7, -2.2)))
    count = min(int(rng.integers(1, 9)), size // (40 * width))
    for place in np.linspace(0.05, 0.9, max(count, 1)) + rng.uniform(0.0, 0.03):
        at = int(place * size)
        force[at : at + width] += rng.uniform(0.5, 1.0) * 500.0 * np.sin(np.pi * np.arange(width) / width) ** 1.5
    return rate, {"force_x": force, "acceleration_x": _machine(rng, force, rate)}


def stepped_sine(rng: np.random.Generator) -> tuple[float, dict[str, Real]]:
    """10 to 40 steps of a shaker, with some second and third harmonic."""
    rate, size = _size(rng)
    steps = int(rng.integers(10, 41))
    low = rate * rng.uniform(0.004, 0.02)
    frequency = np.repeat(np.linspace(low, low * rng.uniform(2.0, 8.0), steps), size // steps)
    phase = 2.0 * np.pi * np.cumsum(frequency) / rate
    force = np.sin(phase) + rng.uniform(0.0, 0.1) * np.sin(2.0 * phase) + rng.uniform(0.0, 0.1) * np.sin(3.0 * phase)
    force *= rng.uniform(5.0, 200.0)
    return rate, {"force_x": force, "acceleration_x": _machine(rng, force, rate)}


def sine_sweep(rng: np.random.Generator) -> tuple[float, dict[str, Real]]:
    """A linear or logarithmic chirp."""
    rate, size = _size(rng)
    low, high = rate * rng.uniform(0.002, 0.01), rate * rng.uniform(0.05, 0.3)
    t = np.arange(size) / rate
    method = str(rng.choice(["linear", "logarithmic"]))
    force = rng.uniform(5.0, 200.0) * signal.chirp(t, low, t[-1], high, method)
    return rate, {"force_x": force, "acceleration_x": _machine(rng, force, rate)}


def periodic(rng: np.random.Generator) -> tuple[float, dict[str, Real]]:
    """A multisine of random phases, three to ten periods."""
    rate, size = _size(rng)
    period = size // int(rng.integers(3, 11))
    lines = np.zeros(period // 2 + 1, complex)
    band = slice(2, max(12, int(period * rng.uniform(0.05, 0.3))))
    lines[band] = np.exp(2j * np.pi * rng.random(lines[band].size))
    force = np.resize(np.fft.irfft(lines, period), size)
    force *= 100.0 / force.std()
    return rate, {"force_x": force, "acceleration_x": _machine(rng, force, rate)}


def random(rng: np.random.Generator) -> tuple[float, dict[str, Real]]:
    """Band-limited noise of a shaker."""
    rate, size = _size(rng)
    edges = [rng.uniform(0.002, 0.02), rng.uniform(0.2, 0.9)]
    force = signal.sosfilt(signal.butter(4, edges, "band", output="sos"), rng.standard_normal(size))
    force *= 50.0 / force.std()
    return rate, {"force_x": force, "acceleration_x": _machine(rng, force, rate)}


def _teeth(rng: np.random.Generator, angle: Real, count: int) -> dict[str, Real]:
    """Forces of straight teeth with run-out between two angles."""
    entry = rng.uniform(0.0, 1.2)
    leave = entry + rng.uniform(0.4, 1.8)
    chips = 1.0 + rng.uniform(0.0, 0.4) * rng.uniform(-1.0, 1.0, count)
    ratio = rng.uniform(0.2, 0.6)
    x, y, z = (np.zeros(angle.size) for _ in range(3))
    for k in range(count):
        phi = np.mod(angle + 2.0 * np.pi * k / count, 2.0 * np.pi)
        load = np.where((phi > entry) & (phi < leave), chips[k] * np.sin(phi) * 400.0, 0.0)
        x += -load * (np.cos(phi) + ratio * np.sin(phi))
        y += load * (np.sin(phi) - ratio * np.cos(phi))
        z += 0.2 * load
    return {"force_x": x, "force_y": y, "force_z": z}


def cut(rng: np.random.Generator) -> tuple[float, dict[str, Real]]:
    """A steady cut, with entry and exit in half of the draws; forces, or a microphone alone."""
    rate, size = _size(rng)
    count = int(rng.integers(1, 9))
    spindle = rate * rng.uniform(0.002, 0.02) / count
    speed = spindle * (1.0 + rng.uniform(0.0, 0.002) * np.arange(size) / size)
    forces = _teeth(rng, 2.0 * np.pi * np.cumsum(speed) / rate, count)
    if rng.random() < 0.5:
        on = (np.arange(size) > 0.15 * size) & (np.arange(size) < 0.9 * size)
        forces = {name: np.where(on, values, 0.0) for name, values in forces.items()}
    if rng.random() < 0.3:
        return rate, {"sound": 0.01 * forces["force_y"]}
    return rate, forces | {"acceleration_x": _machine(rng, forces["force_x"], rate)}


def sweep(rng: np.random.Generator) -> tuple[float, dict[str, Real]]:
    """A cut while the spindle is run up, with a column of its speed."""
    rate, size = _size(rng)
    count = int(rng.integers(1, 9))
    speed = rate * rng.uniform(0.002, 0.008) / count * np.linspace(1.0, rng.uniform(1.3, 3.0), size)
    forces = _teeth(rng, 2.0 * np.pi * np.cumsum(speed) / rate, count)
    return rate, forces | {
        "spindle_speed": 60.0 * speed,
        "acceleration_x": _machine(rng, forces["force_x"], rate),
    }


KINDS: dict[str, Callable[[np.random.Generator], tuple[float, dict[str, Real]]]] = {
    "impact test": impact,
    "stepped sine": stepped_sine,
    "sine sweep": sine_sweep,
    "periodic excitation": periodic,
    "random excitation": random,
    "cut": cut,
    "sweep milling": sweep,
}


def draw(kind: str, seed: int) -> Drawn:
    """Return a record of a kind, with noise on every channel but the speed."""
    rng = np.random.default_rng([list(KINDS).index(kind), seed])
    rate, columns = KINDS[kind](rng)
    return Drawn(kind, rate, {n: v if n == "spindle_speed" else _noisy(rng, v) for n, v in columns.items()})
