"""Spectral amplitudes that the rules of the chatter criterion compare: harmonics, other lines, noise, air."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from process.types import Complex, Real
from process.units import displacement_over_acceleration
from stability.chatter.cut_interval import CutPart
from stability.chatter.line_spectrum import (
    LineSpectrum,
    alternating,
    comb_speed,
    hann_spectrum,
    highest_visible_order,
    noise_rms,
    order_phasors,
    stands_out,
    without_orders,
)
from stability.chatter.rules import RULES
from stability.chatter.sidebands import sideband_coherence, sideband_lines
from stability.chatter.spindle_speed import windows


@dataclass(frozen=True)
class Short:
    """The highest non-harmonic line of short windows: its frequency there [Hz], low and high, and amplitude."""

    frequency: float
    low: float
    high: float
    amplitude: float
    noise: float


@dataclass(frozen=True)
class SpectralAmplitudes:
    """Amplitudes of one axis that the rules compare: harmonics, orders, the highest other line, its sidebands."""

    axis: str
    spectrum: LineSpectrum
    amplitude: Real
    left: Real
    masked: NDArray[np.bool_]
    in_air: NDArray[np.bool_]
    base: float
    speed_error: float
    followed: bool
    tooth_frequency: float
    tooth_amplitude: float
    order_frequency: float
    order_amplitude: float
    least: float
    floor: float
    unit: str
    threshold: float
    teeth: int
    half: tuple[float, float]
    half_growth: float
    half_reference: float | None
    alternating: tuple[float, float]
    short: Short
    samples: Real
    dt: float

    @property
    def denominator(self) -> float:
        """The highest harmonic, or what counts at least."""
        return max(self.tooth_amplitude, self.order_amplitude, self.least, self.floor)

    def peak(self, where: NDArray[np.bool_], amplitude: Real) -> tuple[float, float]:
        """Return frequency and amplitude of the highest of the points marked; NaN, 0 for none."""
        if not where.any():
            return math.nan, 0.0
        top = int(np.argmax(np.where(where, amplitude, -1.0)))
        return float(self.spectrum.frequency[top]), float(amplitude[top])

    @cached_property
    def peaks(self) -> NDArray[np.bool_]:
        """Local maxima of the spectrum that are neither harmonics nor there in air."""
        inner = self.amplitude[1:-1]
        local = np.zeros(self.amplitude.size, dtype=bool)
        local[1:-1] = (inner >= self.amplitude[:-2]) & (inner >= self.amplitude[2:])
        return local & ~self.masked & ~self.in_air

    @cached_property
    def candidate(self) -> tuple[float, float]:
        """Frequency and amplitude of the largest peak that is not a harmonic, nor there in air.

        A shoulder of a masked order is no peak: the point must be a local maximum.
        """
        whole = self.peak(self.peaks, self.amplitude)
        # A line that drifts is lower and broader the longer the window: a short one reads it higher.
        return (self.short.frequency, self.short.amplitude) if self.short.amplitude > 1.3 * whole[1] else whole

    @property
    def drifts(self) -> bool:
        """Whether the candidate has been read in short windows."""
        return self.candidate[0] == self.short.frequency and self.candidate[1] == self.short.amplitude

    @property
    def spindle_seen(self) -> bool:
        """Whether any of the first `RULES.orders_seen` spindle orders stands out of the noise."""
        first, last = float(self.spectrum.frequency[0]) / self.base, float(self.spectrum.frequency[-1]) / self.base
        orders = range(max(1, math.ceil(first)), min(RULES.orders_seen, math.floor(last)) + 1)
        return any(stands_out(self.spectrum, order * self.base, 0.5) for order in orders)

    @property
    def highest(self) -> float:
        """Highest amplitude in the band, spindle orders included."""
        return float(self.amplitude.max(initial=0.0))

    @property
    def tooth_line(self) -> float:
        """Frequency of the highest tooth harmonic [Hz]; NaN when it does not stand out of the noise."""
        if math.isnan(self.tooth_frequency):
            return math.nan
        return self.tooth_frequency if self._stands_out(self.tooth_frequency, self.tooth_amplitude) else math.nan

    def _stands_out(self, frequency: float, amplitude: float) -> bool:
        """Whether a harmonic stands out of the noise around it."""
        return amplitude > RULES.stands_out * noise_rms(self.spectrum, self.amplitude, ~self.masked, frequency)

    @property
    def ratio(self) -> float:
        """Amplitude of the candidate over that of the highest harmonic; of a line, together with its sidebands."""
        size = self.candidate[1]
        if (
            self.denominator > 0.0
            and 0.2 * self.threshold < size / self.denominator < self.threshold
            and self.line_like
        ):
            size = self.pooled
        return size / self.denominator if self.denominator > 0.0 else 0.0

    @cached_property
    def pooled(self) -> float:
        """Root of the sum of squares of the candidate and its sidebands."""
        return math.sqrt(self.candidate[1] ** 2 + sum(size**2 for size, _ in self.sidebands))

    @cached_property
    def noise(self) -> float:
        """Rms noise amplitude around the candidate, in the windows it was read in."""
        if self.drifts:
            return self.short.noise
        frequency = self.candidate[0]
        where = self.teeth * self.base if math.isnan(frequency) else frequency
        return noise_rms(self.spectrum, self.amplitude, ~self.masked, where)

    @property
    def guard(self) -> float:
        """Two standard deviations of the ratio, from the noise on both amplitudes."""
        if self.denominator == 0.0:
            return 0.0
        return self.noise / self.denominator * math.sqrt(2.0 * (1.0 + self.threshold**2))

    @property
    def highest_sidebands(self) -> tuple[float, ...]:
        """Frequencies of the six highest sidebands of the candidate [Hz]."""
        return tuple(sorted(at for _, at in self.sidebands[-6:]))

    @cached_property
    def sidebands(self) -> tuple[tuple[float, float], ...]:
        """Amplitude and frequency [Hz] of the sidebands of the candidate, rising (`chatter.sidebands`)."""
        frequency, amplitude = self.candidate
        if math.isnan(frequency):
            return ()
        reach = 1.5 * self.spectrum.resolution
        reach += 0.5 * (self.short.high - self.short.low) if self.drifts else 0.0
        least = max(0.1 * amplitude, RULES.stands_out * self.noise)
        return sideband_lines(
            self.spectrum.frequency, np.where(self.peaks, self.amplitude, 0.0), frequency, self.base, reach, least
        )

    @cached_property
    def envelope(self) -> tuple[float, float]:
        """Kurtosis of the envelope of the candidate, and its growth from the first to the last quarter."""
        frequency = self.candidate[0]
        if math.isnan(frequency):
            return math.nan, math.nan
        n = self.samples.size
        lines, grid = fft.fft(self.samples - self.samples.mean()), fft.fftfreq(n, self.dt)
        beside = np.abs(grid / self.base - np.round(grid / self.base)) * self.base
        apart = (beside > 1.5 / (n * self.dt)) & (grid > 0.0)
        found = []
        for width in (0.5 * self.base, 0.08 * frequency):
            near = apart & (np.abs(grid - frequency) <= max(width, 3.0 / (n * self.dt)))
            envelope = np.abs(fft.ifft(np.where(near, lines, 0.0)))[n // 8 : -(n // 8)]
            square = envelope**2
            quarter = max(1, square.size // 4)
            growth = math.sqrt(float(square[-quarter:].mean() / max(square[:quarter].mean(), 1e-300)))
            found.append((float((square**2).mean() / max(square.mean() ** 2, 1e-300)), growth))
        return min(found)

    @cached_property
    def coherence(self) -> float:
        """Power of all lines one spindle order apart over the median of all places between the orders."""
        if math.isnan(self.candidate[0]):
            return 0.0
        band = float(self.spectrum.frequency[0]), float(self.spectrum.frequency[-1])
        return sideband_coherence(self.samples, self.dt, self.base, band)

    @property
    def line_like(self) -> bool:
        """Whether the candidate is a line, not a mode that noise excites."""
        varies, amplitude = self.envelope[0], self.candidate[1]
        if varies < RULES.noise_like and self.coherence > RULES.certain:
            return True
        height = amplitude / (self.threshold * self.denominator) if self.denominator > 0.0 else 0.0
        if varies < RULES.steady and height > RULES.towering:
            # A line that drifts is its own noise.
            return True
        if amplitude < RULES.stands_out * self.noise:
            return False
        if self.envelope[1] > RULES.grows and varies < RULES.growing:
            return True
        # A lightly damped mode may look steady over a short record: then something else must speak for a line.
        steady = varies < RULES.steady or height > 2.0 or bool(self.sidebands) or self.coherence > RULES.coherent
        return varies < RULES.comes_and_goes and steady

    @property
    def noise_like(self) -> bool:
        """Whether the candidate is a mode that noise excites, and nothing else."""
        varies = self.envelope[0]
        if math.isnan(self.tooth_line) and not self._stands_out(self.order_frequency, self.order_amplitude):
            return False
        if (
            not RULES.noise_kurtosis[0] < varies < RULES.noise_kurtosis[1]
            or self.coherence > RULES.noise_coherence
            or self.sidebands
        ):
            return False
        return varies > RULES.plainly_noise or self.candidate[1] < RULES.excited * self.threshold * self.denominator

    @property
    def plain(self) -> bool:
        """Whether the candidate is a steady high line, or one with sidebands, that neither dies out nor comes up."""
        if not RULES.lasts[0] < self.envelope[1] < RULES.lasts[1]:
            return False
        return self.coherent_sidebands or (self.envelope[0] < RULES.steady and self.ratio > 2.0 * self.threshold)

    @property
    def coherent_sidebands(self) -> bool:
        """Whether the candidate is a steady line with at least two sidebands."""
        return self.envelope[0] < RULES.comes_and_goes and len(self.sidebands) > 1 and self.coherence > RULES.certain


def spectral_amplitudes(
    axis: str,
    part: CutPart,
    base: float,
    teeth: int,
    band: tuple[float, float],
    exact: bool,
    tolerance: float,
    integrate: bool,
    floor: float,
    unit: str,
    threshold: float,
    reference: float | None,
) -> SpectralAmplitudes:
    """Return the spectral amplitudes of one axis of a part."""
    raw = hann_spectrum(part.samples, part.dt, band)
    if not exact:
        base = comb_speed(raw, base, teeth, tolerance)
    count = max(teeth, int(band[1] / base))
    error = RULES.speed_variation + (0.0 if exact else _remaining_error(raw, base, count, tolerance))
    phasors = order_phasors(part.samples, part.dt, base, count)
    scale = np.abs(displacement_over_acceleration(raw.frequency)) if integrate else np.ones(raw.frequency.size)
    spectrum = LineSpectrum(raw.frequency, raw.phasor * scale, raw.resolution)
    amplitude = spectrum.vector_amplitude
    tooth_frequency, tooth_amplitude = _highest_line(spectrum, amplitude, teeth * base, 1, error)
    half = (math.nan, math.nan)
    if teeth % 2 == 0:
        half = _highest_line(spectrum, amplitude, 0.5 * teeth * base, 2, error)
    orders = _order_amplitudes(phasors, base, band, integrate)
    if teeth % 2 == 0:
        orders[teeth // 2 - 1 :: teeth] = 0.0
    top = int(np.argmax(orders))
    in_air = _in_air(part, spectrum, amplitude, band, scale)
    return SpectralAmplitudes(
        axis=axis,
        spectrum=spectrum,
        amplitude=amplitude,
        left=without_orders(raw, phasors, base) * scale,
        masked=_order_mask(spectrum, base, error),
        in_air=in_air,
        base=base,
        speed_error=error,
        followed=exact and tolerance > 0.0,
        tooth_frequency=tooth_frequency,
        tooth_amplitude=tooth_amplitude,
        order_frequency=(top + 1) * base,
        order_amplitude=float(orders[top]),
        least=0.0,
        floor=floor,
        unit=unit,
        threshold=threshold,
        teeth=teeth,
        half=half,
        half_growth=_growth(part, half[0], teeth),
        half_reference=reference,
        alternating=alternating(phasors, teeth),
        short=_short(part, base, band, error, in_air, spectrum, integrate),
        samples=part.samples[0],
        dt=part.dt,
    )


def _order_amplitudes(phasors: Complex, base: float, band: tuple[float, float], integrate: bool) -> Real:
    """Return the amplitudes of orders 1, 2, ...; zero outside of the band."""
    frequency = base * np.arange(1, phasors.shape[1] + 1)
    size = np.abs(phasors[0]) * (np.abs(displacement_over_acceleration(frequency)) if integrate else 1.0)
    return np.asarray(np.where((frequency >= band[0]) & (frequency <= band[1]), size, 0.0))


def _in_air(
    part: CutPart,
    spectrum: LineSpectrum,
    amplitude: Real,
    band: tuple[float, float],
    scale: Real,
) -> NDArray[np.bool_]:
    """Mark lines that are there in air with half of their amplitude or more: hum, pumps, fans."""
    nothing = np.zeros(amplitude.size, dtype=bool)
    duration = part.air.shape[1] * part.raw_dt
    if duration < 0.1 or duration * band[0] < 0.5:
        return nothing
    air = hann_spectrum(part.air, part.raw_dt, band)
    if air.frequency.size < 3:
        return nothing
    if _still_cuts(part, spectrum, air):
        return nothing
    reach = 2.0 * air.resolution / (air.frequency[1] - air.frequency[0])
    highest = ndimage.maximum_filter1d(air.vector_amplitude, 2 * math.ceil(reach) + 1)
    return np.asarray(np.interp(spectrum.frequency, air.frequency, highest) * scale > 0.5 * amplitude)


def _still_cuts(part: CutPart, spectrum: LineSpectrum, air: LineSpectrum) -> bool:
    """Whether the teeth cut in what was taken for air: chatter that comes up leaves the cut before it far below.

    The highest orders of the cut then are there in the same size. The first is left out: an unbalance turns in air too.
    """
    last = int((spectrum.frequency[-1] - spectrum.resolution) / part.base)
    orders = part.base * np.arange(2, last + 1)
    orders = orders[orders > spectrum.frequency[0] + air.resolution]
    if orders.size < RULES.orders_compared:
        return False

    def at(lines: LineSpectrum) -> Real:
        reach = math.ceil(RULES.mask_bins / 3.0 * lines.resolution / (lines.frequency[1] - lines.frequency[0]))
        highest = ndimage.maximum_filter1d(lines.vector_amplitude, 2 * reach + 1)
        return np.asarray(np.interp(orders, lines.frequency, highest))

    cut, before = at(spectrum), at(air)
    top = np.argsort(-cut)[: RULES.orders_compared]
    return float(np.median(before[top] / cut[top])) > 0.5


def _short(
    part: CutPart,
    base: float,
    band: tuple[float, float],
    error: float,
    in_air: NDArray[np.bool_],
    spectrum: LineSpectrum,
    integrate: bool,
) -> Short:
    """Return the highest line between the orders that short windows have, the median over the windows."""
    best = Short(math.nan, math.nan, math.nan, 0.0, 0.0)
    turns = part.duration * base
    for length in (t for t in RULES.short_turns if 2.0 * t <= turns):
        _, frequency, phasor = windows(part.samples, part.dt, length / base, 0.25 * length / base)
        size = np.abs(phasor[0])
        if integrate:
            size = size * np.abs(displacement_over_acceleration(np.maximum(frequency, band[0])))
        order = np.maximum(1.0, np.round(frequency / base))
        free = np.abs(frequency - order * base) > RULES.mask_bins * base / length + error * order * base
        free &= (frequency >= band[0]) & (frequency <= band[1])
        free &= np.interp(frequency, spectrum.frequency, in_air.astype(float)) < 0.5
        if not free.any():
            continue
        size = np.where(free, size, 0.0)
        tops = size.argmax(axis=1)
        heights = size.max(axis=1)
        found = float(np.median(heights))
        if found > best.amplitude:
            middle = float(np.median(frequency[tops]))
            at = float(frequency[tops][int(np.argmin(np.abs(frequency[tops] - middle)))])
            # Another sideband may be the highest from window to window: what counts is the place between the orders.
            moved = (frequency[tops] - at + 0.5 * base) % base - 0.5 * base
            low, high = at + np.quantile(moved, [0.1, 0.9])
            near = free & (np.abs(frequency - at) < 2.0 * base)
            best = Short(at, float(low), float(high), found, float(np.sqrt(np.median(size[:, near] ** 2) / 0.69)))
    return best


def _remaining_error(spectrum: LineSpectrum, base: float, count: int, tolerance: float) -> float:
    """Return the relative error left after the comb: half a bin at the highest order that can be seen."""
    visible = highest_visible_order(spectrum, base, count)
    if visible == 0:
        return tolerance
    return min(tolerance, 0.5 * spectrum.resolution / (visible * base))


def _highest_line(
    spectrum: LineSpectrum, amplitude: Real, base: float, stride: int, error: float
) -> tuple[float, float]:
    """Return frequency [Hz] and amplitude of the highest of the multiples 1, 1 + stride, ... of `base` in the band."""
    multiples = base * np.arange(1, int(spectrum.frequency[-1] / base) + 1, stride)
    best = (math.nan, 0.0)
    for frequency in multiples[multiples >= spectrum.frequency[0]]:
        near = spectrum.near(float(frequency), spectrum.resolution + error * float(frequency))
        top = float(amplitude[near].max())
        if top > best[1]:
            best = (float(frequency), top)
    return best


def _order_mask(spectrum: LineSpectrum, base: float, error: float) -> NDArray[np.bool_]:
    """Mark ``|f - h base| <= 3/T + error h base`` for every order h >= 1."""
    order = np.maximum(1.0, np.round(spectrum.frequency / base))
    nearest = order * base
    return np.abs(spectrum.frequency - nearest) <= RULES.mask_bins * spectrum.resolution + error * nearest


def _growth(part: CutPart, frequency: float, teeth: int) -> float:
    """Return how much a line has grown against the tooth passing line from the first to the last quarter of the cut.

    NaN when there is no line. What run-out puts there enters together with the teeth, so that the ratio stays.
    """
    turn = 1.0 / part.base if part.base > 0.0 else math.inf
    quarter = part.cut.shape[1] // 4
    if math.isnan(frequency) or quarter * part.raw_dt < 4.0 * turn:
        return math.nan
    length = max(1, round(4.0 * turn / part.raw_dt))

    def mean_size(piece: Real, line: float) -> float:
        parts = [piece[:, i : i + length] for i in range(0, piece.shape[1] - length + 1, length)]
        return math.sqrt(
            sum(float(np.abs(order_phasors(p, part.raw_dt, line, 1)).max()) ** 2 for p in parts) / len(parts)
        )

    first, last = (mean_size(p, frequency) for p in (part.cut[:, :quarter], part.cut[:, -quarter:]))
    passing = teeth * part.base
    teeth_first, teeth_last = (mean_size(p, passing) for p in (part.cut[:, :quarter], part.cut[:, -quarter:]))
    steady = max(1.0, teeth_last / teeth_first) if teeth_first > 0.0 else 1.0
    return last / first / steady if first > 0.0 else math.inf
