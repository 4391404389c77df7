"""Limits of milling by integration in time. Shares no code with the packages.

Teeth on a circle cut what the tooth before left; the machine is a set of modes; a worn flank resists the motion into
the work. Nothing is averaged over a turn: the delay equation is integrated as it is (velocity Verlet, dampers in the
half steps), a small push is followed, and the depth at which it neither grows nor dies is the limit. SI throughout,
angles from +y towards +x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numba import njit

STEPS = 360
"""Steps a tooth period, at least; more where a mode is fast."""

PER_PERIOD = 70
"""Steps a period of the fastest mode, at least."""


@njit(cache=True, nogil=True)
def _integrate(depth, teeth, entry, leave, kt, kr, flank, friction, period, steps, w, zeta, gain, shape, out):
    """Integrate modes (m,) from a push and write the motion in x and y, (n, 2). gain: 1/modal mass."""
    m = w.size
    dt = period / steps
    q, v, a = np.zeros(m), np.zeros(m), np.zeros(m)
    for r in range(m):
        v[r] = 1e-6 * w[r] * (1.0 + 0.3 * r)
    past = np.zeros((steps, 2))
    # Teeth that are all alike stand alike again a tooth period later: sums of ss, sc and cc over those in the cut.
    cut = np.zeros((steps, 3))
    for n in range(steps):
        for j in range(teeth):
            phi = (2.0 * math.pi * ((n / steps + j) / teeth)) % (2.0 * math.pi)
            if entry <= phi < leave:
                s, c = math.sin(phi), math.cos(phi)
                cut[n, 0] += s * s
                cut[n, 1] += s * c
                cut[n, 2] += c * c
    for n in range(out.shape[0]):
        x, y, vx, vy = 0.0, 0.0, 0.0, 0.0
        for r in range(m):
            q[r] += dt * v[r] + 0.5 * dt * dt * a[r]
            x += shape[r, 0] * q[r]
            y += shape[r, 1] * q[r]
            vx += shape[r, 0] * (v[r] + dt * a[r])
            vy += shape[r, 1] * (v[r] + dt * a[r])
        slot = n % steps
        dx, dy = x - past[slot, 0], y - past[slot, 1]
        past[slot, 0], past[slot, 1] = x, y
        ss, sc, cc = cut[slot, 0], cut[slot, 1], cut[slot, 2]
        # Along and across the teeth: chip is s dx + c dy, and what goes into the work s vx + c vy.
        ax, ay = kt * dx + friction * flank * vx, kt * dy + friction * flank * vy
        bx, by = kr * dx + flank * vx, kr * dy + flank * vy
        fx = -depth * (ax * sc + ay * cc + bx * ss + by * sc)
        fy = depth * (ax * ss + ay * sc - bx * sc - by * cc)
        for r in range(m):
            f = gain[r] * (shape[r, 0] * fx + shape[r, 1] * fy)
            half = zeta[r] * w[r] * dt
            speed = (v[r] * (1.0 - 0.5 * half) + 0.5 * dt * (a[r] + f - w[r] * w[r] * q[r])) / (1.0 + 0.5 * half)
            # The damper acts on the mean speed of each half step.
            a[r] = f - w[r] * w[r] * q[r] - 2.0 * zeta[r] * w[r] * speed
            v[r] = speed
        out[n, 0], out[n, 1] = x, y


@dataclass(frozen=True)
class Modes:
    """Frequency [Hz], damping ratio, stiffness [N/m] and direction (x, y) of each."""

    frequency: tuple[float, ...] = (62.0, 88.0)
    damping: tuple[float, ...] = (0.035, 0.03)
    stiffness: tuple[float, ...] = (1.9e7, 2.6e7)
    direction: tuple[tuple[float, float], ...] = ((1.0, 0.0), (0.0, 1.0))


@dataclass(frozen=True)
class Mill:
    """Machine, tool, material, and what is hidden in them.

    flank [N/m]: resistance of the worn flank over depth and ratio of speeds. linear, square: relative change of the
    frequencies at `fastest` [rpm], by their stiffness: masses stay. slip: share of its stiffness that the first mode
    loses at a cross-section `level` of the chip [m2]. turn [rad]: of the first mode about z (in a slot both together
    change nothing).
    extra: compliance [m/N], frequency [Hz], damping of one more mode.
    """

    modes: Modes = field(default_factory=Modes)
    diameter: float = 0.08
    teeth: int = 6
    entry: float = 0.5 * math.pi
    leave: float = math.pi
    kt: float = 1.9e9
    kr: float = 0.8e9
    flank: float = 0.0
    friction: float = 0.3
    linear: float = 0.0
    square: float = 0.0
    fastest: float = 1000.0
    slip: float = 0.0
    level: float = 2e-7
    turn: float = 0.0
    extra: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def seen(self, speed: float, section: float) -> tuple[np.ndarray, ...]:
        """Angular frequency, damping, 1/mass, direction at a speed [rpm] and a cross-section of the chip [m2]."""
        m = self.modes
        f, z, k = (np.array(v, dtype=float) for v in (m.frequency, m.damping, m.stiffness))
        u = np.array(m.direction, dtype=float)
        share = speed / self.fastest
        mass = k / (2.0 * math.pi * f) ** 2
        stiff = np.ones(f.size)
        stiff[0] = 1.0 - self.slip * section / self.level
        z[0] += 2.0 / (3.0 * math.pi) * (1.0 / stiff[0] - 1.0)
        bent = f * (1.0 + self.linear * share) * (1.0 + self.square * share**2)
        w = 2.0 * math.pi * bent * np.sqrt(stiff)
        c, s = math.cos(self.turn), math.sin(self.turn)
        u[0] = c * u[0, 0] - s * u[0, 1], s * u[0, 0] + c * u[0, 1]
        if self.extra[0] > 0.0:
            size, frequency, ratio = self.extra
            w, z = np.append(w, 2.0 * math.pi * frequency), np.append(z, ratio)
            mass, u = np.append(mass, 1.0 / size / (2.0 * math.pi * frequency) ** 2), np.vstack([u, [0.8, 0.6]])
        return w, z, 1.0 / mass, u


def growth(mill: Mill, speed: float, depth: float, section: float = 0.0, waves: float = 60.0) -> tuple[float, float]:
    """Return how a push grows [1/s] and its frequency [Hz] at a spindle speed [rpm] and depth [m]."""
    late, step, fastest = motion(mill, speed, depth, section, waves)
    rate = rate_of(late, step)
    level = late * np.exp(-rate * step * np.arange(late.shape[0]))[:, None]
    length = 8 * late.shape[0]
    power = np.sum(np.abs(np.fft.rfft(level * np.hanning(late.shape[0])[:, None], length, axis=0)) ** 2, axis=1)
    lines = np.fft.rfftfreq(length, step)
    inside = lines < 3.0 * fastest
    return rate, float(lines[inside][np.argmax(power[inside])])


def motion(mill: Mill, speed: float, depth: float, section: float, waves: float) -> tuple[np.ndarray, float, float]:
    """Return the second half of a motion, its step [s] and the frequency of the fastest mode [Hz]."""
    w, z, gain, u = mill.seen(speed, section)
    period = 60.0 / speed / mill.teeth
    steps = max(STEPS, math.ceil(PER_PERIOD * period * w.max() / (2.0 * math.pi)))
    cutting = math.pi * mill.diameter * speed / 60.0
    periods = math.ceil(max(60, waves / (w.min() / (2.0 * math.pi)) / period))
    out = np.zeros((2 * periods * steps, 2))
    _integrate(
        depth,
        mill.teeth,
        mill.entry,
        mill.leave,
        mill.kt,
        mill.kr,
        mill.flank / cutting,
        mill.friction,
        period,
        steps,
        w,
        z,
        gain,
        u,
        out,
    )
    return out[periods * steps :], period / steps, float(w.max()) / (2.0 * math.pi)


def rate_of(late: np.ndarray, step: float) -> float:
    """Size in eight pieces of a motion: its logarithm grows as a line."""
    size = np.log([math.sqrt(float(np.mean(p**2))) + 1e-300 for p in np.array_split(late, 8)])
    return float(np.polyfit(late.shape[0] * step / 8.0 * np.arange(8), size, 1)[0])


def limit(mill: Mill, speed: float, feed: float = 1e-4, deepest: float = 0.05) -> tuple[float, float]:
    """Return limit depth [m] and chatter frequency [Hz] at a spindle speed [rpm] and feed per tooth [m]."""
    depth = limit_depth(mill, speed, feed, deepest)
    return depth, growth(mill, speed, depth, depth * feed)[1] if math.isfinite(depth) else math.nan


def limit_depth(mill: Mill, speed: float, feed: float = 1e-4, deepest: float = 0.05) -> float:
    """Return the limit depth [m] alone: the frequency of a motion takes longer than the motion."""

    def rate(depth):
        late, step, _ = motion(mill, speed, depth, depth * feed, 60.0)
        return rate_of(late, step)

    low, high = 2e-4, 3.6e-4
    at = [rate(low), rate(high)]
    if at[0] > 0.0:
        raise ValueError(f"unstable at 0.2 mm and {speed:g} rpm")
    while at[1] < 0.0:
        low, high, at[0] = high, 1.4 * high, at[1]
        at[1] = rate(high)
        if high > deepest:
            return math.inf
    side = 0
    for _ in range(25):
        middle = high - at[1] * (high - low) / (at[1] - at[0])
        value = rate(middle)
        if value < 0.0:
            low, at[0] = middle, value
            at[1] *= 0.5 if side == -1 else 1.0
            side = -1
        else:
            high, at[1] = middle, value
            at[0] *= 0.5 if side == 1 else 1.0
            side = 1
        if abs(value) < 2e-3 or high - low < 3e-4 * high:
            break
    return middle


@dataclass(frozen=True)
class Found:
    """What a campaign found at one speed: deepest stable and shallowest chattering depth [m], frequency [Hz]."""

    speed: float
    feed: float
    stable: float
    chatter: float
    frequency: float | None


def search(mill: Mill, speeds, rng: np.random.Generator, ratio: float = 1.08, feeds=(1e-4,)) -> list[Found]:
    """Look for limits in steps of depth; the first depth is drawn, frequencies are read to 0.3 %."""
    found = []
    for feed in feeds:
        for speed in speeds:
            depth, frequency = limit(mill, speed, feed)
            if not math.isfinite(depth):
                continue
            below = depth * ratio ** -rng.uniform()
            measured = frequency * (1.0 + 0.003 * rng.normal())
            found.append(Found(speed, feed, below, below * ratio, measured))
    return found


def drawn(rng: np.random.Generator, mill: Mill) -> Mill:
    """Modes a little other than those that were identified: 0.4 %, 8 % and 2 %, and a weak mode beside them."""
    m = mill.modes
    n = len(m.frequency)
    modes = replace(
        m,
        frequency=tuple(np.array(m.frequency) * (1.0 + 0.004 * rng.normal(size=n))),
        damping=tuple(np.array(m.damping) * (1.0 + 0.08 * rng.normal(size=n))),
        stiffness=tuple(np.array(m.stiffness) * (1.0 + 0.02 * rng.normal(size=n))),
    )
    extra = mill.extra if mill.extra[0] > 0.0 else (0.004 / 1.9e7, 190.0, 0.04)
    return replace(mill, modes=modes, extra=extra)
