"""What the rules of the chatter criterion look at: spectrum, masks, and the amplitudes they compare."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from process.machine.modes import displacement_over_acceleration
from process.types import Complex, Real
from stability.chatter.cut_interval import CutPart
from stability.chatter.line_spectrum import (
    STANDS_OUT,
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
from stability.chatter.spindle_speed import windows

MASK_BINS = 3.0
"""Half width of the mask of an order [bins of 1/T]."""

SPEED_VARIATION = 5e-4
"""Relative variation of the speed within the record that the masks allow for [1]."""


COMES_AND_GOES = 1.4
"""Kurtosis of the envelope of a line, <|a|^4>/<|a|^2>^2, above which it may be a mode that noise excites: steady
chatter has 1, filtered noise 2."""

NOISE_LIKE = 1.75
"""Kurtosis of the envelope from which no coherence makes a line of it."""

STEADY = 1.2
"""Kurtosis of the envelope below which a line is steady whatever else there is."""

TOWERING = 8.0
"""Height in thresholds from which a steady line needs not stand out of what is around it."""

GROWS, GROWING = 5.0, 4.0
"""Growth from the first to the last quarter from which a line grows, and the kurtosis that this explains at most:
exponential growth has 2 to 4, a knock far more."""

LASTS = 0.7, 1.5
"""Growth from the first to the last quarter of a stretch in which a line is no transient that dies out, nor one that
comes up [1]."""

COHERENT = 30.0
"""Power of a family over the median power between the orders that speaks for a line."""

CERTAIN = 50.0
"""The same, from which it is a line even where its envelope varies."""

NOISE = 1.65, 3.5, 6.0
"""Least and most kurtosis of the envelope of a mode that noise excites, and most coherence."""

PLAINLY_NOISE = 1.9
"""Kurtosis from which its height does not matter; below, it reaches `EXCITED` thresholds at most."""

EXCITED = 4.0
"""Most that a mode that noise excites reaches, in thresholds [1]."""

ORDERS_SEEN = 60
"""Spindle orders of which one at least stands out of the noise where a tool cuts."""

SHORT_TURNS = (24.0, 12.0)
"""Windows in which lines that drift are looked for [turns]."""


@dataclass(frozen=True)
class Short:
    """The highest non-harmonic line of short windows: its frequency there [Hz], low and high, and amplitude."""

    frequency: float
    low: float
    high: float
    amplitude: float
    noise: float


@dataclass(frozen=True)
class Evidence:
    """Everything the rules look at, of one axis."""

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
        """Whether any of the first `ORDERS_SEEN` spindle orders stands out of the noise."""
        first, last = float(self.spectrum.frequency[0]) / self.base, float(self.spectrum.frequency[-1]) / self.base
        orders = range(max(1, math.ceil(first)), min(ORDERS_SEEN, math.floor(last)) + 1)
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
        return amplitude > STANDS_OUT * noise_rms(self.spectrum, self.amplitude, ~self.masked, frequency)

    @property
    def ratio(self) -> float:
        """Candidate, where it is a line with its family (root of the sum of squares), over harmonic."""
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
        """Amplitude of the candidate and its family together."""
        return math.sqrt(self.candidate[1] ** 2 + sum(size**2 for size, _ in self._family))

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
    def family(self) -> tuple[float, ...]:
        """The highest six lines [Hz] of the candidate's family."""
        return tuple(sorted(at for _, at in self._family[-6:]))

    @cached_property
    def _family(self) -> tuple[tuple[float, float], ...]:
        """Amplitude and frequency [Hz] of lines ``f_c + k n`` that reach a tenth of the candidate and stand out.

        Regeneration in an interrupted cut puts them there, and their mirror images ``k n - f_c``.
        """
        frequency, amplitude = self.candidate
        if math.isnan(frequency):
            return ()
        last, width = float(self.spectrum.frequency[-1]), 1.5 * self.spectrum.resolution
        width += 0.5 * (self.short.high - self.short.low) if self.drifts else 0.0
        found = set()
        for sign in (1.0, -1.0):
            begin = (sign * frequency) % self.base
            for line in np.arange(begin, last, self.base):
                near = self.peaks & (np.abs(self.spectrum.frequency - line) <= width)
                if abs(line - frequency) > 0.5 * self.base and near.any():
                    at, size = self.peak(near, self.amplitude)
                    if size > max(0.1 * amplitude, STANDS_OUT * self.noise):
                        found.add((size, at))
        return tuple(sorted(found))

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
        """Power of the candidate's family over the median of all places between the orders, in windows of turns.

        The spectrum is folded: all lines one spindle order apart, and their mirror images, are one sum.
        """
        frequency = self.candidate[0]
        turns = self.samples.size * self.dt * self.base
        if math.isnan(frequency):
            return 0.0
        best = 0.0
        for length in (*(t for t in SHORT_TURNS if 2.0 * t < turns), 0.99 * turns):
            _, orders, phasor = windows(self.samples[None], self.dt * self.base, length, 0.25 * length)
            power = np.abs(phasor[0]) ** 2
            inside = (orders >= self.spectrum.frequency[0] / self.base) & (
                orders <= self.spectrum.frequency[-1] / self.base
            )
            places = np.arange(2.25 / length, 0.5, 0.25 / length)
            folded = np.zeros((power.shape[0], places.size))
            for order in range(int(orders[inside][-1]) + 2):
                for sign in (1.0, -1.0):
                    bins = np.rint((order + sign * places) / orders[1]).astype(np.int64)
                    known = (bins > 0) & (bins < orders.size)
                    known[known] &= inside[bins[known]]
                    folded[:, known] += power[:, bins[known]]
            if places.size > 3:
                best = max(best, float(np.median(folded.max(axis=1) / np.maximum(np.median(folded, axis=1), 1e-300))))
        return best

    @property
    def line_like(self) -> bool:
        """Whether the candidate is a line, not a mode that noise excites."""
        varies, amplitude = self.envelope[0], self.candidate[1]
        if varies < NOISE_LIKE and self.coherence > CERTAIN:
            return True
        height = amplitude / (self.threshold * self.denominator) if self.denominator > 0.0 else 0.0
        if varies < STEADY and height > TOWERING:
            # A line that drifts is its own noise.
            return True
        if amplitude < STANDS_OUT * self.noise:
            return False
        if self.envelope[1] > GROWS and varies < GROWING:
            return True
        # A lightly damped mode may look steady over a short record: then something else must speak for a line.
        steady = varies < STEADY or height > 2.0 or bool(self._family) or self.coherence > COHERENT
        return varies < COMES_AND_GOES and steady

    @property
    def noise_like(self) -> bool:
        """Whether the candidate is a mode that noise excites, and nothing else."""
        varies = self.envelope[0]
        if math.isnan(self.tooth_line) and not self._stands_out(self.order_frequency, self.order_amplitude):
            return False
        if not NOISE[0] < varies < NOISE[1] or self.coherence > NOISE[2] or self._family:
            return False
        return varies > PLAINLY_NOISE or self.candidate[1] < EXCITED * self.threshold * self.denominator

    @property
    def plain(self) -> bool:
        """Whether the candidate is a steady high line, or one with a family, that neither dies out nor comes up."""
        if not LASTS[0] < self.envelope[1] < LASTS[1]:
            return False
        return self.coherent_family or (self.envelope[0] < STEADY and self.ratio > 2.0 * self.threshold)

    @property
    def coherent_family(self) -> bool:
        """Whether the candidate is a steady line with at least two others of its family."""
        return self.envelope[0] < COMES_AND_GOES and len(self._family) > 1 and self.coherence > CERTAIN


def gather(
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
) -> Evidence:
    """Turn the samples of one axis into spectra, masks and the amplitudes that the rules compare."""
    raw = hann_spectrum(part.samples, part.dt, band)
    if not exact:
        base = comb_speed(raw, base, teeth, tolerance)
    count = max(teeth, int(band[1] / base))
    error = SPEED_VARIATION + (0.0 if exact else _remaining_error(raw, base, count, tolerance))
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
    return Evidence(
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
    reach = 2.0 * air.resolution / (air.frequency[1] - air.frequency[0])
    highest = ndimage.maximum_filter1d(air.vector_amplitude, 2 * math.ceil(reach) + 1)
    return np.asarray(np.interp(spectrum.frequency, air.frequency, highest) * scale > 0.5 * amplitude)


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
    for length in (t for t in SHORT_TURNS if 2.0 * t <= turns):
        _, frequency, phasor = windows(part.samples, part.dt, length / base, 0.25 * length / base)
        size = np.abs(phasor[0])
        if integrate:
            size = size * np.abs(displacement_over_acceleration(np.maximum(frequency, band[0])))
        order = np.maximum(1.0, np.round(frequency / base))
        free = np.abs(frequency - order * base) > MASK_BINS * base / length + error * order * base
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
            # The highest line may be another of the family from window to window: what counts is where it is between.
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
    return np.abs(spectrum.frequency - nearest) <= MASK_BINS * spectrum.resolution + error * nearest


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
