"""Campaigns over controllers, positions, feeds and levels, with the limit of each group by brute force.

No code of the package: two modes in the plane whose frequency, damping and stiffness change with controller, position,
feed and force; forces of straight teeth integrated over the turn; the limits by trying levels one after the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Tap:
    """One measurement: its conditions and compliance (frequencies, 2, 2) in the axes of the machine."""

    name: str
    controller: str
    position: str
    feed: float
    level: float
    compliance: np.ndarray


@dataclass(frozen=True)
class Draw:
    """A campaign: its measurements, the (down milling) cut, and the direction in which everything moves [rad]."""

    taps: tuple[Tap, ...]
    frequency: np.ndarray
    direction: float
    teeth: int
    diameter: float
    width: float
    tangential: float
    radial: float
    feed_per_tooth: float


def compliance(frequency, modes):
    """Return the compliance (n, 2, 2) of modes (f, zeta, k, angle of the mode in the plane)."""
    out = np.zeros((frequency.size, 2, 2), dtype=complex)
    for f, zeta, k, angle in modes:
        u = np.array([math.cos(angle), math.sin(angle)])
        r = frequency / f
        out += (1.0 / (k * (1.0 - r**2 + 2j * zeta * r)))[:, None, None] * np.outer(u, u)
    return out


def draw(seed):
    """Return a campaign drawn at random."""
    rng = np.random.default_rng(seed)
    frequency = np.arange(30.0, 160.0, 0.2)
    direction = float(rng.choice([0.0, 0.5 * math.pi, math.pi, rng.uniform(-math.pi, math.pi)]))
    base = [
        (rng.uniform(50, 70), rng.uniform(0.02, 0.06), rng.uniform(5e6, 2e7), rng.uniform(0, math.pi)),
        (rng.uniform(80, 110), rng.uniform(0.02, 0.06), rng.uniform(5e6, 2e7), rng.uniform(0, math.pi)),
    ]
    taps = []
    for controller in ["K1", "K2", "K3"][: rng.integers(1, 4)]:
        for position in ["left", "right"][: rng.integers(1, 3)]:
            scale = rng.uniform(0.6, 1.7, (2, 3))
            for feed in [0.0, *np.sort(rng.uniform(100.0, 1500.0, rng.integers(0, 3)))]:
                slope = rng.uniform(0.3, 2.0, 2)
                for level in np.sort(rng.uniform(20.0, 2000.0, rng.integers(1, 4))):
                    modes = [
                        (f * (1 + 0.03 * (s[0] - 1)), zeta * s[1] * (1 + e * level / 1e3), k * s[2], angle)
                        for (f, zeta, k, angle), s, e in zip(base, scale, slope, strict=True)
                    ]
                    name = f"tap {len(taps)}"
                    at = (round(float(feed), 3), round(float(level), 3))
                    taps.append(Tap(name, controller, position, *at, compliance(frequency, modes)))
    order = rng.permutation(len(taps))
    return Draw(
        tuple(taps[i] for i in order), frequency, direction, int(rng.integers(2, 7)), 0.1,
        0.1 * rng.uniform(0.1, 1.0), rng.uniform(600e6, 2000e6), rng.uniform(100e6, 800e6), rng.uniform(5e-5, 3e-4),
    )  # fmt: skip


def cut_forces(d):
    """Return the mean regeneration matrix (2, 2) [N/m^2] and the first harmonic a depth [N/m], axes of the cut."""
    phi = np.linspace(math.pi - math.acos(1.0 - 2.0 * d.width / d.diameter), math.pi, 4001)
    s, c = np.sin(phi), np.cos(phi)
    force = np.array([-c * d.tangential - s * d.radial, s * d.tangential - c * d.radial])
    chip = np.array([s, c])
    matrix = d.teeth / (2 * math.pi) * np.trapezoid(force[:, None] * chip[None], phi)
    first = d.teeth / math.pi * np.trapezoid(force * s * d.feed_per_tooth * np.exp(-1j * d.teeth * phi), phi)
    return matrix, float(np.linalg.norm(first))


def limit(d, taps, speed):
    """Return the limits [m] at a speed [rpm]: of the weakest vibration that was measured, and the least of all.

    NaN where the feed lies outside the measured ones.
    """
    matrix, _ = cut_forces(d)
    turn = np.array([[math.cos(d.direction), math.sin(d.direction)], [-math.sin(d.direction), math.cos(d.direction)]])
    matrix = turn.T @ matrix @ turn  # in the axes of the machine
    delay = 1.0 - np.exp(-2j * math.pi * d.frequency * 60.0 / (d.teeth * speed))
    feed = 1e3 * d.feed_per_tooth * d.teeth * speed
    feeds = sorted({t.feed for t in taps})
    if feeds != [0.0] and not feeds[0] <= feed <= feeds[-1]:
        return math.nan, math.nan
    weights = [np.interp(feed, feeds, np.eye(len(feeds))[j]) for j in range(len(feeds))]
    about = [v for w, v in zip(weights, feeds, strict=True) if w > 0.0]

    def at_level(v, level):
        own = sorted((t.level, i) for i, t in enumerate(taps) if t.feed == v)
        weights = [np.interp(level, [x for x, _ in own], np.eye(len(own))[j]) for j in range(len(own))]
        return sum(w * taps[i].compliance for w, (_, i) in zip(weights, own, strict=True))

    def smallest(level):
        """Return the limit of the machine as it is at a level."""
        phi = sum(w * at_level(v, level) for w, v in zip(weights, feeds, strict=True) if w > 0.0)
        loop = matrix @ phi
        half, product = 0.5 * np.trace(loop, axis1=1, axis2=2), np.linalg.det(loop)
        root = np.sqrt(half**2 - product)
        # Continuous branches: the root must not change its sign between neighbours.
        root *= np.cumprod(np.where(np.abs(np.diff(root, prepend=root[:1])) > np.abs(root + np.roll(root, 1)), -1, 1))
        best = math.inf
        for value in ((half + root) * delay, (half - root) * delay):
            cross = np.flatnonzero(np.sign(value.imag[1:]) != np.sign(value.imag[:-1]))
            share = value.imag[cross] / (value.imag[cross] - value.imag[cross + 1])
            real = value.real[cross] + share * (value.real[cross + 1] - value.real[cross])
            best = min([best, *(1.0 / real[real > 0.0])])
        return best

    ends = [sorted(t.level for t in taps if t.feed == v) for v in about]
    low, high = max(own[0] for own in ends), min(own[-1] for own in ends)
    small = smallest(0.0)  # each feed at its own lowest level
    if low > high:
        return small, math.nan
    return small, min(small, *(smallest(level) for level in np.linspace(low, high, 60)))
