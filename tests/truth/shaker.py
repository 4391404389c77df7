"""Records of a shaker at a machine, drawn at random; shares no code with the packages.

Force and motion are band-limited and solved line by line over a circle that is longer than the record (before it the
machine has been shaken already, or was at rest), so that samples are exact. A source drives the exciter, whose moving
mass, suspension and back-EMF work against the machine: the force drops where the machine is soft. Then the sensors: an
accelerometer or a displacement, white noise and noise that falls with frequency, offsets, steps of a converter, silence
before the start, a generator whose clock is not that of the recorder, clipped forces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

KINDS = ("random", "burst", "linear chirp", "logarithmic chirp", "repeated chirp", "multisine", "multisines")


@dataclass(frozen=True)
class Machine:
    """Modes: frequency [Hz], damping ratio, shape over the mass of each, and a residual [m/N]."""

    frequency: Real
    damping: Real
    shape: Real
    residual: Real

    def compliance(self, f: Real, response: int, excitation: int) -> Complex:
        """Displacement over force [m/N]."""
        w, wn = 2.0 * np.pi * f[:, None], 2.0 * np.pi * self.frequency
        gain = self.shape[:, response] * self.shape[:, excitation]
        modes = np.sum(gain / (wn**2 - w**2 + 2j * self.damping * wn * w), axis=1)
        return np.asarray(modes + self.residual[response, excitation])


@dataclass(frozen=True)
class Shaken:
    """Records along one axis: ``force`` (n,), ``motion`` (3, n) each; `truth` is what a linear estimate should find."""

    kind: str
    rate: float
    force: list[Real]
    motion: list[Real]
    channel: str
    machine: Machine
    axis: int
    gain: float
    drawn: dict[str, Any] = field(default_factory=dict)

    def truth(self, f: Real, response: int) -> Complex:
        """Best linear approximation of displacement over force [m/N]."""
        return self.gain * self.machine.compliance(f, response, self.axis)


def machine(rng: np.random.Generator, rate: float, lightest: float = 0.003) -> Machine:
    """Two to five modes between 1 and 30 % of the sample rate, 0.3 to 6 % of damping."""
    count = int(rng.integers(2, 6))
    frequency = np.sort(rate * np.exp(rng.uniform(np.log(0.012), np.log(0.3), count)))
    shape = rng.standard_normal((count, 3)) / np.sqrt(rng.uniform(3.0, 60.0, (count, 1)))
    shape += 0.3 * np.sign(shape) / np.sqrt(20.0)
    damping = np.exp(rng.uniform(np.log(lightest), np.log(0.06), count))
    stiff = np.diag(rng.uniform(0.0, 1.0, 3)) * 0.05 / (20.0 * (2.0 * np.pi * frequency[-1]) ** 2)
    return Machine(frequency, damping, shape, stiff)


def _band(rng: np.random.Generator, rate: float) -> tuple[float, float]:
    return rate * rng.uniform(0.003, 0.01), rate * rng.uniform(0.33, 0.42)


def _shaped(rng: np.random.Generator, size: int, rate: float, band: tuple[float, float]) -> Real:
    """Gaussian noise in a band with soft edges."""
    f = fft.rfftfreq(size, 1.0 / rate)
    with np.errstate(divide="ignore"):
        edge = 1.0 / (1.0 + (band[0] / f) ** 8) / (1.0 + (f / band[1]) ** 24)
    return np.asarray(fft.irfft(fft.rfft(rng.standard_normal(size)) * edge, size))


def _chirp(rng: np.random.Generator, size: int, rate: float, band: tuple[float, float], method: str) -> Real:
    t = np.arange(size) / rate
    out = signal.chirp(t, band[0], t[-1], band[1], method, phi=360.0 * rng.random())
    ramp = max(4, int(0.01 * size))
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(ramp) / ramp)
    out[:ramp] *= rise
    out[-ramp:] *= rise[::-1]
    return np.asarray(out)


def _multisine(rng: np.random.Generator, period: int, rate: float, band: tuple[float, float]) -> Complex:
    """Amplitudes of the lines of a period, random phases, some lines left out."""
    f = fft.rfftfreq(period, 1.0 / rate)
    lines = np.where((f > band[0]) & (f < band[1]), np.exp(2j * np.pi * rng.random(f.size)), 0.0)
    return np.asarray(lines * (rng.random(f.size) > rng.choice([0.0, 0.2])))


def draw(seed: int, kind: str | None = None) -> Shaken:
    """Draw machine, exciter, signal, sensors and recorder."""
    rng = np.random.default_rng(seed)
    kind = str(rng.choice(KINDS)) if kind is None else kind
    rate = float(rng.choice([512.0, 1024.0, 2000.0, 4096.0]))
    seconds = float(np.exp(rng.uniform(np.log(8.0), np.log(40.0)))) * min(1.0, 2048.0 / rate)
    size = int(seconds * rate)
    m, axis, band = machine(rng, rate), int(rng.integers(3)), _band(rng, rate)
    # The generator's clock: its period is no whole number of samples.
    clock = 1.0 + (rng.uniform(-1e-4, 1e-4) if rng.random() < 0.4 else 0.0)
    quiet = int(rate * rng.uniform(0.3, 1.0)) if rng.random() < 0.5 else 0
    cubic = float(rng.uniform(0.0, 0.08)) if kind == "multisines" and rng.random() < 0.6 else 0.0
    sources = []
    if kind == "multisines":
        realisations, periods = int(rng.integers(3, 7)), int(rng.integers(2, 5))
        period = max(int(size / periods / 2), int(1.0 * rate))
        for _ in range(realisations):
            one = fft.irfft(_multisine(rng, period, rate, band), period)
            sources.append(np.tile(one, periods + 1))
        one_record = bool(rng.random() < 0.3)
        sources = [np.concatenate(sources)] if one_record else sources
    elif kind in ("multisine", "repeated chirp"):
        periods = int(rng.integers(3, 9))
        period = size // periods
        one = (
            fft.irfft(_multisine(rng, period, rate, band), period)
            if kind == "multisine"
            else _chirp(rng, period, rate, band, "linear")
        )
        sources.append(np.tile(one, periods))
    elif kind == "burst":
        bursts = int(rng.integers(3, 9))
        on = np.zeros(size)
        for part in np.array_split(np.arange(size), bursts):
            on[part[: int(part.size * rng.uniform(0.4, 0.8))]] = 1.0
        sources.append(_shaped(rng, size, rate, band) * on)
    elif kind == "random":
        sources.append(_shaped(rng, size, rate, band))
        quiet = quiet if rng.random() < 0.5 else -1  # -1: has run long before
    else:
        sources.append(_chirp(rng, int(size * rng.uniform(0.8, 1.0)), rate, band, kind.split()[0]))
    force_noise, motion_noise = 10.0 ** rng.uniform(-4.0, -1.7), 10.0 ** rng.uniform(-3.5, -1.0)
    channel = str(rng.choice(["acceleration", "acceleration", "displacement"]))
    exciter = rng.uniform(0.05, 3.0), rng.uniform(5.0, 60.0), float(10.0 ** rng.uniform(1.0, 2.5))
    clipped = float(rng.uniform(2.0, 3.2)) if kind == "random" and rng.random() < 0.06 else 0.0
    bits, level = int(rng.integers(14, 25)), float(10.0 ** rng.uniform(0.5, 2.5))
    forces, motions = [], []
    for source in sources:
        tail = int(rng.uniform(0.0, 0.3) * rate)
        steady = quiet < 0
        padded = source if steady else np.concatenate([np.zeros(quiet), source, np.zeros(tail)])
        circle = padded.size if steady else padded.size + int(12.0 * rate / (m.damping * m.frequency).min() / 6.0)
        circle = int(fft.next_fast_len(circle, real=True))
        if steady:
            padded = _shaped(rng, circle, rate, band)
        if clock != 1.0 and not steady:
            # The same signal, sampled by a recorder whose clock differs: the phase of its lines is stretched.
            padded = _stretched(np.concatenate([padded, np.zeros(int(0.02 * padded.size) + 64)]), clock)[: padded.size]
        force, motion = _shaken(rng, padded, circle, rate, m, axis, exciter, channel, cubic, level)
        count = size if steady else padded.size
        start = int(rng.integers(0, circle - count + 1)) if steady else 0
        f, x = force[start : start + count], motion[:, start : start + count]
        f = f + force_noise * np.std(f) * rng.standard_normal(count)
        x = x + _sensor_noise(rng, x, motion_noise, rate)
        f, x = f + rng.uniform(-0.2, 0.2) * np.std(f), x + rng.uniform(-0.2, 0.2, (3, 1)) * np.std(x, axis=1)[:, None]
        if clipped:
            f = np.clip(f, -clipped * np.std(f), clipped * np.std(f))
        forces.append(_converted(f, bits))
        motions.append(np.array([_converted(row, bits) for row in x]))
    gain = 1.0 + 3.0 * cubic
    drawn = {
        "seconds": size / rate, "noise": motion_noise, "force noise": force_noise, "damping": m.damping.min(),
        "bits": bits, "clock": clock, "cubic": cubic, "clipped": clipped, "quiet": quiet / rate,
        "modes": m.frequency, "zeta": m.damping, "records": len(forces), "samples": forces[0].size,
    }  # fmt: skip
    return Shaken(kind, rate, forces, motions, channel, m, axis, gain, drawn)


def _stretched(samples: Real, clock: float) -> Real:
    """Return a band-limited signal at times ``clock`` samples apart (chirp z-transform of its lines)."""
    n = samples.size
    lines = fft.fft(samples)
    order = np.fft.fftfreq(n, 1.0 / n)
    first = order.min()
    return np.asarray(
        (
            np.exp(2j * np.pi * first * clock * np.arange(n) / n)
            * signal.czt(fft.fftshift(lines), n, np.exp(2j * np.pi * clock / n))
            / n
        ).real
    )


def _shaken(
    rng: np.random.Generator, source: Real, circle: int, rate: float, m: Machine, axis: int,
    exciter: tuple[float, float, float], channel: str, cubic: float, level: float,
) -> tuple[Real, Real]:  # fmt: skip
    """Solve exciter and machine line by line over a circle of samples."""
    f = fft.rfftfreq(circle, 1.0 / rate)
    w = 2.0 * np.pi * f
    mass, own, damping = exciter
    k = mass * (2.0 * np.pi * own) ** 2
    against = k - mass * w**2 + 1j * w * (damping + 0.1 * mass * 2.0 * np.pi * own)
    phi = m.compliance(f, axis, axis)
    force = fft.rfft(source, circle) / (1.0 + against * phi)
    force[0] = 0.0
    samples = fft.irfft(force, circle)
    active = np.mean(samples**2) * circle / max(np.count_nonzero(source), 1)
    samples *= level / np.sqrt(active)
    acting = samples if not cubic else samples + cubic * samples**3 / level**2
    acting_lines = fft.rfft(acting)
    scale = -(w**2) if channel == "acceleration" else np.ones(f.size)
    motion = np.array([fft.irfft(acting_lines * m.compliance(f, r, axis) * scale, circle) for r in range(3)])
    return samples, motion


def _sensor_noise(rng: np.random.Generator, motion: Real, share: float, rate: float) -> Real:
    """White noise and noise that falls with frequency, of a share of the rms of the strongest axis."""
    n = motion.shape[1]
    f = np.maximum(fft.rfftfreq(n, 1.0 / rate), rate / n)
    colour = np.sqrt(1.0 + rng.uniform(0.0, 0.02) * rate / f)
    out = np.array([fft.irfft(fft.rfft(rng.standard_normal(n)) * colour, n) for _ in range(3)])
    return np.asarray(out * share * np.std(motion, axis=1).max())


def _converted(samples: Real, bits: int) -> Real:
    step = 2.5 * np.max(np.abs(samples)) / 2.0**bits
    return np.asarray(step * np.round(samples / step))
