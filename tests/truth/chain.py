"""What instruments make of a signal: impacts of a hand, anti-alias filter, coloured noise, converter, skew, tone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import signal

from truth.axis import RATE

DIVISION = 4
SAMPLE_RATE = RATE / DIVISION
"""Rate of the records [Hz]."""

COLOUR = (1.2, -0.45)
"""Autoregression of the noise: x_n = 1.2 x_(n-1) - 0.45 x_(n-2) + white; most of it lies below 200 Hz."""


@dataclass(frozen=True)
class Chain:
    """Measuring chain. gain: sensitivity of the accelerometer over its data sheet; skew [s]: its channel comes late.

    snr [dB]: rms of the response at the middle level over the noise of the acceleration; the force has 20 dB more.
    tone: line at `mains` Hz, in dB over the noise floor of a silent record (Hann periodogram); None: no line.
    double: share of hits that bounce. bits: of the converter.
    """

    gain: float = 1.0
    skew: float = 0.0
    snr: float = 40.0
    tone: float | None = None
    mains: float = 50.0
    double: float = 0.05
    bits: int = 16


def hit(rng: np.random.Generator, level: float, double: float) -> np.ndarray:
    """Rows (start [s] after 0, peak [N], rise [s], exponent) of one impact of about `level` N: steep up, slow down."""
    rise, exponent = rng.uniform(1.5e-3, 1.9e-3), rng.uniform(2.5, 3.5)
    first = [0.0, level * rng.uniform(0.93, 1.07), rise, exponent]
    if rng.uniform() >= double:
        return np.array([first])
    again = [rng.uniform(9e-3, 16e-3), first[1] * rng.uniform(0.1, 0.3), rise * 1.1, exponent]
    return np.array([first, again])


def butterworth(order: int, cut: float, rate: float) -> np.ndarray:
    """Second-order sections of a low pass of even order, from its poles by the bilinear transform."""
    w = 2.0 * rate * math.tan(math.pi * cut / rate)
    sections = []
    for i in range(order // 2):
        q = 2.0 * math.sin(math.pi * (2 * i + 1) / (2 * order))
        k = 2.0 * rate
        a0 = k * k + q * w * k + w * w
        sections.append(
            [w * w / a0, 2 * w * w / a0, w * w / a0, 1.0, 2 * (w * w - k * k) / a0, (k * k - q * w * k + w * w) / a0]
        )
    return np.array(sections)


SECTIONS = butterworth(6, 0.36 * SAMPLE_RATE, RATE)


def slowed(raw: np.ndarray) -> np.ndarray:
    """Filter and keep every `DIVISION`-th sample."""
    return signal.sosfilt(SECTIONS, raw)[..., ::DIVISION]


def late(raw: np.ndarray, skew: float) -> np.ndarray:
    """Signal that arrives `skew` seconds late (cubic between samples)."""
    if skew == 0.0:
        return raw
    n = raw.size
    at = np.arange(n) - skew * RATE
    i = np.clip(np.floor(at).astype(int), 1, n - 3)
    u = at - i
    a, b, c, d = raw[i - 1], raw[i], raw[i + 1], raw[i + 2]
    return b + 0.5 * u * (c - a + u * (2 * a - 5 * b + 4 * c - d + u * (3 * (b - c) + d - a)))


def noise(rng: np.random.Generator, n: int) -> np.ndarray:
    """Coloured noise of unit variance."""
    white = rng.standard_normal(n + 200)
    coloured = signal.lfilter([1.0], [1.0, -COLOUR[0], -COLOUR[1]], white)[200:]
    return coloured / math.sqrt(variance())


def variance() -> float:
    """Variance of the autoregression for white noise of unit variance."""
    a, b = COLOUR
    return (1.0 - b) / ((1.0 + b) * ((1.0 - b) ** 2 - a * a))


def density(frequency: np.ndarray | float) -> np.ndarray:
    """One-sided power density [1/Hz] of `noise`."""
    z = np.exp(-2j * np.pi * np.asarray(frequency) / SAMPLE_RATE)
    return 2.0 / SAMPLE_RATE / np.abs(1.0 - COLOUR[0] * z - COLOUR[1] * z * z) ** 2 / variance()


def tone_amplitude(chain: Chain, sigma: float, duration: float) -> float:
    """Amplitude of the line whose Hann periodogram over `duration` s stands `chain.tone` dB over noise of rms sigma."""
    if chain.tone is None:
        return 0.0
    floor = sigma**2 * float(density(chain.mains)) * 1.5 / duration
    return math.sqrt(2.0 * floor * 10.0 ** (chain.tone / 10.0))


def converted(x: np.ndarray, bits: int) -> np.ndarray:
    """Round to the steps of a converter whose range is the next power of two above 1.5 times the largest value."""
    top = float(np.max(np.abs(x)))
    if top == 0.0:
        return x
    step = 2.0 ** math.ceil(math.log2(1.5 * top)) / 2 ** (bits - 1)
    return np.round(x / step) * step
