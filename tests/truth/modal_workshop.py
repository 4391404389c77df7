"""The ram of `modal_machine` as a workshop measures it: hits that lean and miss, sensors that are turned and not exact.

Everything is drawn; sizes are standard deviations. Shares no code with the packages.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from truth.modal_machine import (
    LINES,
    NOMINAL_LEVEL,
    REPEATS,
    Hidden,
    Ram,
    Record,
    Setting,
    compliance,
    modes,
)

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class Imperfections:
    """What is ordinary in a workshop (SI)."""

    hit_direction: float = math.radians(0.7)
    setup_direction: float = math.radians(1.0)
    miss: float = 0.007
    gain: float = 0.007
    mounting: float = math.radians(0.7)
    cross_talk: float = 0.007
    skew: float = 15e-6
    clock: float = 10e-6
    hum: float = 0.01
    damping_over_place: float = 0.12


def turn(angles: Real) -> Real:
    """Rotation by small angles about x, y, z, exact."""
    length = float(np.linalg.norm(angles))
    k = np.cross(np.eye(3), angles / max(length, 1e-300))
    return np.eye(3) + math.sin(length) * k + (1.0 - math.cos(length)) * k @ k


def damped(ram: Ram, factors: Real) -> Ram:
    """Return a ram whose modes are damped otherwise."""
    root = np.sqrt(np.diag(ram.mass))
    _, turned = np.linalg.eigh(ram.stiffness / np.outer(root, root))
    shapes = turned / root[:, None]
    back, own = np.linalg.inv(shapes), shapes.T @ ram.damping @ shapes
    scale = np.sqrt(np.outer(factors, factors))
    return replace(ram, damping=back.T @ (own * scale) @ back)


def off_the_point(ram: Ram, missed: Real, frequency: Real) -> Complex:
    """What a column of the compliance changes by where each mode is hit a little more or less, (f, 3, 3)."""
    f, zeta, k, u = modes(ram)
    ratio = frequency[:, None] / f
    each = 1.0 / (k * (1.0 - ratio**2 + 2j * zeta * ratio))
    return np.einsum("fm,mr,mc,mc->frc", each, u, u, missed)


def measure_ordinarily(
    ram: Ram,
    hidden: Hidden,
    settings: Sequence[Setting],
    snr: float,
    rng: np.random.Generator,
    imperfect: Imperfections | None = None,
) -> list[Record]:
    """Measure every setting as a workshop does, with noise `snr` [dB] below the response at 100 N."""
    i = Imperfections() if imperfect is None else imperfect
    count = ram.mass.shape[0]
    plain = compliance(ram, Hidden(), Setting(), LINES)
    rms = float(np.sqrt(np.mean(np.abs(plain) ** 2)))
    color = LINES[0] / LINES
    size = np.sqrt(REPEATS) * rms / np.sqrt(np.mean(color**2)) * 10.0 ** (-snr / 20.0)
    gains = np.diag(1.0 + i.gain * rng.standard_normal(3))
    force_gain = 1.0 + i.gain * float(rng.standard_normal())
    talk = np.eye(3) + i.cross_talk * rng.standard_normal((3, 3)) * (1.0 - np.eye(3))
    shown = gains @ talk @ turn(i.mounting * rng.standard_normal(3))
    late = i.skew * float(rng.standard_normal())
    drifts = i.damping_over_place * rng.uniform(-1.7, 1.7, count)
    near = np.exp(-(((LINES[:, None] - np.array([50.0, 100.0, 150.0])) / 1.0) ** 2)) @ np.array([1.0, 0.5, 0.3])
    found = []
    for setting in settings:
        here = damped(ram, 1.0 + drifts * setting.position)
        phi = compliance(here, hidden, setting, LINES)
        if not setting.free_mass:
            phi = phi + off_the_point(here, i.miss * rng.standard_normal((count, 3)), LINES)
        phi = force_gain * (phi if setting.sensor == "laser" else shown @ phi)
        clock = late + i.clock * float(rng.standard_normal())
        phi = phi * np.exp(-2j * np.pi * LINES * clock)[:, None, None]
        set_up = i.setup_direction * rng.standard_normal((3, 3))
        each = []
        for _ in range(REPEATS):
            force = np.eye(3) + (set_up + i.hit_direction * rng.standard_normal((3, 3))) * (1.0 - np.eye(3))
            hum = i.hum * rms * near[:, None, None] * np.exp(2j * np.pi * rng.random((1, 3, 3)))
            each.append(phi @ force + hum)
        shape = (REPEATS, *phi.shape)
        noise = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
        noise *= (size * color / math.sqrt(2.0) * NOMINAL_LEVEL / setting.level)[None, :, None, None]
        found.append(Record(setting, LINES, np.array(each) + noise))
    return found
