"""Free decays of one oscillator, integrated in time with its sliders one by one: no describing function, no average.

``x'' + 2 zeta w x' + w^2 (x + f(x, x')) = 0`` by Stormer's method, 100 steps a period, from a displacement at rest in
every slider. Nothing is imported from the packages.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

STEPS = 100  # a period


@dataclass(frozen=True)
class Oscillator:
    """Of unit mass, and what hides in it: shares of the stiffness, displacements over that at the start."""

    frequency: float = 80.0
    damping: float = 1.5e-3
    sliders: tuple = ()  # (share of the stiffness, displacement at which it slips) each
    cubic: float = 0.0  # share of the stiffness gained at the displacement 1
    gap: tuple = ()  # share of the stiffness, half of the play
    dry: float = 0.0  # friction over stiffness
    drag: float = 0.0  # damping ratio that comes with the velocity w


def bolted(share, exponent, number=80, reach=3.0):
    """Sliders of a power law: the density of slip displacements goes with ``d^exponent`` up to `reach`."""
    edges = reach * np.linspace(0.0, 1.0, number + 1) ** (1.0 / (exponent + 1.0))
    return tuple((share / number, 0.5 * (a + b)) for a, b in pairwise(edges))


def free_decay(oscillator, seconds=4.0, start=1.0):
    """Return samples a second, and the acceleration over that of the start, shape (n,)."""
    o, w = oscillator, 2.0 * np.pi * oscillator.frequency
    rate = o.frequency * STEPS
    h, n = 1.0 / rate, int(seconds * rate)
    share, limit = (np.array(c, dtype=float) for c in zip(*o.sliders, strict=True)) if o.sliders else np.zeros((2, 0))
    beside = 1.0 - share.sum() - (o.gap[0] if o.gap else 0.0)
    slid, x, v = np.zeros(share.size), start, 0.0
    out = np.empty(n)
    for i in range(n):
        stretched = np.clip(x - slid, -limit, limit)
        slid = x - stretched
        force = beside * x + share @ stretched + o.cubic * x**3 + 2.0 * (o.damping + o.drag * abs(v) / w) * v / w
        if o.gap:
            force += o.gap[0] * np.sign(x) * max(abs(x) - o.gap[1], 0.0)
        out[i] = force + o.dry * np.tanh(50.0 * v / (w * 0.05))
        v -= h * w**2 * out[i]
        x += h * v
    return rate, -out
