"""Line spectra of a record: amplitudes, spindle orders, and the spindle speed that the orders give away.

Amplitudes are peak amplitudes of sinusoids (Hann window, scaled by its sum). The spectrum is zero-padded four
times, so that a line between two bins is read within 1 %; the *resolution* stays ``1/T`` of the record of
length T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from process.types import Complex, Real
from stability.chatter.rules import RULES

PADDING = 4
"""Grid points a bin of 1/T."""


@dataclass(frozen=True)
class LineSpectrum:
    """Hann spectrum of a piece of record within a band.

    Parameters
    ----------
    frequency : ndarray, shape (n,)
        Frequency [Hz], in steps of a quarter of the resolution.
    phasor : ndarray of complex, shape (axes, n)
        Complex peak amplitude, in the unit of the signal.
    resolution : float
        1/T [Hz].
    """

    frequency: Real
    phasor: Complex
    resolution: float

    @cached_property
    def vector_amplitude(self) -> Real:
        """Root of the sum of squares over the axes, shape (n,); a rotated sensor reads the same."""
        total: Real = np.sqrt((np.abs(self.phasor) ** 2).sum(axis=0))
        return total

    def near(self, frequency: float, half_width: float) -> NDArray[np.bool_]:
        """Mark the grid points within `half_width` [Hz] of a frequency; at least the nearest one."""
        distance = np.abs(self.frequency - frequency)
        return np.asarray((distance <= half_width) | (distance == distance.min()), dtype=bool)


def hann_spectrum(samples: Real, dt: float, band: tuple[float, float]) -> LineSpectrum:
    """Return the spectrum of samples, shape (axes, n), at an interval dt [s], within a band [Hz]."""
    n = samples.shape[1]
    window = signal.windows.hann(n, sym=False)
    size = PADDING * n
    spectrum = fft.rfft(_centred(samples) * window, size, axis=1) * (2.0 / window.sum())
    frequency = fft.rfftfreq(size, dt)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    return LineSpectrum(frequency[inside], spectrum[:, inside], 1.0 / (n * dt))


def order_phasors(samples: Real, dt: float, base: float, count: int) -> Complex:
    """Return the peak phasors at ``base, 2 base, .. count base`` [Hz], shape (axes, count), exactly there."""
    n = samples.shape[1]
    window = signal.windows.hann(n, sym=False)
    values = _zoom(n, count, base, dt)(_centred(samples) * window, axis=1)
    return np.asarray(values * (2.0 / window.sum()), dtype=np.complex128)


@lru_cache(maxsize=64)
def _zoom(n: int, count: int, base: float, dt: float) -> signal.CZT:
    """Return the transform of n samples at 1..count times a frequency [Hz]; pieces of one length share it."""
    step = np.exp(-2j * np.pi * base * dt)
    return signal.CZT(n, m=count, w=step, a=np.conj(step))


def alternating(phasors: Complex, teeth: int) -> tuple[float, float]:
    """Return the size of order Z/2 and its odd multiples over that of all other orders that are no tooth harmonics.

    The radii of the teeth repeat with the turn, so run-out puts lines on every order m + k Z, in the shares of the
    discrete Fourier transform of the radii; an eccentric tool has m = 1 and Z - 1 alone. Teeth that alternate have
    m = Z/2 alone, on all its odd multiples: so the ratio is returned of all orders, and of those without the highest,
    which may stand on a resonance. NaN for odd numbers of teeth, and for two, that have no other order.
    """
    if teeth % 2 or teeth < 4:
        return math.nan, math.nan
    power = np.abs(phasors[0, : RULES.alternating_orders * teeth]) ** 2
    remainder = np.arange(1, power.size + 1) % teeth
    power[remainder == 0] = 0.0
    found = []
    for _ in range(2):
        half = float(power[remainder == teeth // 2].sum())
        found.append(math.sqrt(half / max(float(power.sum()) - half, 1e-300)))
        power[np.argmax(power)] = 0.0
    # With one multiple in the band nothing is left without the highest.
    return found[0], found[1] if power.size >= 1.5 * teeth else 0.1 * found[0]


def without_orders(spectrum: LineSpectrum, phasors: Complex, base: float) -> Real:
    """Return the vector amplitude left when steady lines at the orders of `base` [Hz] are subtracted.

    What is left inside a masked order is not steady and synchronous: a line beside the order, or a speed that
    varies. A line u bins away leaves ``1 - W(u)^2`` of itself, W being the Hann kernel: 0.28 at half a bin,
    0.75 at one.
    """
    left = spectrum.phasor.copy()
    for i in range(phasors.shape[1]):
        bins = (spectrum.frequency - (i + 1) * base) / spectrum.resolution
        close = np.abs(bins) < 8.0
        left[:, close] -= phasors[:, i : i + 1] * hann_kernel(bins[close])
    amplitude: Real = np.sqrt((np.abs(left) ** 2).sum(axis=0))
    return amplitude


def hann_kernel(bins: Real) -> Complex:
    """Return ``exp(-j pi u) sinc(u)/(1 - u^2)``, the Hann spectrum of a line u bins away (1/2 at u = +-1)."""
    singular = np.abs(np.abs(bins) - 1.0) < 1e-9
    u = np.where(singular, 0.0, bins)
    value = np.where(singular, 0.5, np.sinc(u) / np.where(singular, 1.0, 1.0 - u**2))
    return np.asarray(value * np.exp(-1j * np.pi * bins), dtype=complex)


def noise_rms(spectrum: LineSpectrum, amplitude: Real, free: NDArray[np.bool_], frequency: float) -> float:
    """Return the rms noise amplitude in the neighbourhood of a frequency, from the median of the free bins.

    The power of d axes of noise is Gamma(d) distributed, with median d - 0.31 of a mean d.
    """
    near = free & spectrum.near(frequency, 50.0 * spectrum.resolution)
    chosen = amplitude[near] if near.any() else amplitude
    axes = spectrum.phasor.shape[0]
    return float(np.sqrt(np.median(chosen**2) * axes / (axes - 0.31)))


def comb_speed(spectrum: LineSpectrum, base: float, teeth: int, tolerance: float) -> float:
    """Return the spindle frequency [Hz] within ``base (1 +- tolerance)`` whose orders carry most lines.

    Maximises the sum over orders of ``log(1 + power/(16 median power))``, first over all orders up to
    `RULES.comb_harmonics` tooth harmonics, then nearby over those alone that stand out. The logarithm keeps one high
    chatter line from pulling the comb to itself: it counts as one line of many. The floor keeps noise out of the sum.
    """
    power = spectrum.vector_amplitude**2
    floor = max(RULES.stands_out**2 * float(np.median(power)), float(power.max()) * 1e-12, float(np.finfo(float).tiny))
    gain = np.log1p(power / floor)
    top = min(float(spectrum.frequency[-1]) / (1.0 + tolerance), RULES.comb_harmonics * teeth * base)
    orders = np.arange(max(1, math.ceil(spectrum.frequency[0] / base)), int(top / base) + 1)
    coarse = _best_comb(spectrum, gain, base, orders, tolerance)
    lines = orders[[stands_out(spectrum, order * coarse, 2.0) for order in orders]]
    if lines.size == 0:
        return coarse
    nearby = min(tolerance, 2.0 * spectrum.resolution / (int(lines[-1]) * coarse))
    fine = _best_comb(spectrum, gain, coarse, lines, nearby)
    return min(max(fine, base * (1.0 - tolerance)), base * (1.0 + tolerance))


def _best_comb(
    spectrum: LineSpectrum,
    gain: Real,
    base: float,
    orders: NDArray[np.int64],
    tolerance: float,
) -> float:
    """Return the best of the frequencies ``base (1 +- tolerance)``, an eighth of a bin apart at the highest order."""
    if orders.size == 0:
        return base
    reach = tolerance * int(orders[-1]) * base / spectrum.resolution
    candidates = base * (1.0 + tolerance * np.linspace(-1.0, 1.0, 2 * math.ceil(8.0 * reach) + 1))
    score = np.zeros(candidates.size)
    for order in orders:
        score += np.interp(order * candidates, spectrum.frequency, gain)
    return float(candidates[np.argmax(score)])


def stands_out(spectrum: LineSpectrum, frequency: float, bins: float) -> bool:
    """Whether there is a line within some bins of a frequency [Hz]."""
    amplitude = spectrum.vector_amplitude
    everywhere = np.ones(amplitude.size, dtype=bool)
    at = float(amplitude[spectrum.near(frequency, bins * spectrum.resolution)].max())
    return at > RULES.stands_out * noise_rms(spectrum, amplitude, everywhere, frequency)


def highest_visible_order(spectrum: LineSpectrum, base: float, count: int) -> int:
    """Return the highest of `count` orders of `base` [Hz] that stands out of the noise; 0 when none does."""
    return next((order for order in range(count, 0, -1) if stands_out(spectrum, order * base, 0.5)), 0)


def _centred(samples: Real) -> Real:
    """Take out the mean, so that it does not leak into the band."""
    return np.asarray(samples - samples.mean(axis=1, keepdims=True), dtype=float)
