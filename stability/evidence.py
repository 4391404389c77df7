"""What the rules of the chatter criterion look at: spectrum, masks, and the amplitudes they compare."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.compliance import displacement_over_acceleration
from stability.cut_interval import CutPart
from stability.line_spectrum import (
    STANDS_OUT,
    LineSpectrum,
    comb_speed,
    hann_spectrum,
    highest_visible_order,
    noise_rms,
    order_phasors,
    without_orders,
)

MASK_BINS = 3.0
"""Half width of the mask of an order [bins of 1/T]."""

SPEED_VARIATION = 5e-4
"""Relative variation of the speed within the record that the masks allow for [1]."""


@dataclass(frozen=True)
class Evidence:
    """Everything the rules look at."""

    spectrum: LineSpectrum
    amplitude: NDArray[np.float64]
    left: NDArray[np.float64]
    masked: NDArray[np.bool_]
    base: float
    speed_error: float
    tooth_frequency: float
    tooth_amplitude: float
    denominator: float
    floor: float
    unit: str
    threshold: float
    teeth: int
    half: tuple[float, float]
    half_growth: float
    half_reference: float | None

    def peak(self, where: NDArray[np.bool_], amplitude: NDArray[np.float64]) -> tuple[float, float]:
        """Return frequency and amplitude of the highest of the points marked; NaN, 0 for none."""
        if not where.any():
            return math.nan, 0.0
        top = int(np.argmax(np.where(where, amplitude, -1.0)))
        return float(self.spectrum.frequency[top]), float(amplitude[top])

    @property
    def candidate(self) -> tuple[float, float]:
        """Frequency and amplitude of the largest peak that is not a harmonic.

        A shoulder of a masked order is no peak: the point must be a local maximum.
        """
        inner = self.amplitude[1:-1]
        local = np.zeros(self.amplitude.size, dtype=bool)
        local[1:-1] = (inner >= self.amplitude[:-2]) & (inner >= self.amplitude[2:])
        return self.peak(local & ~self.masked, self.amplitude)

    @property
    def highest(self) -> float:
        """Highest amplitude in the band, spindle orders included."""
        return float(self.amplitude.max(initial=0.0))

    @property
    def tooth_line(self) -> float:
        """Frequency of the highest tooth harmonic [Hz]; NaN when it does not stand out of the noise."""
        if math.isnan(self.tooth_frequency):
            return math.nan
        noise = noise_rms(self.spectrum, self.amplitude, ~self.masked, self.tooth_frequency)
        return self.tooth_frequency if self.tooth_amplitude > STANDS_OUT * noise else math.nan

    @property
    def ratio(self) -> float:
        """Candidate over tooth harmonic."""
        return self.candidate[1] / self.denominator

    @property
    def noise(self) -> float:
        """Rms noise amplitude around the candidate."""
        frequency = self.candidate[0]
        where = self.teeth * self.base if math.isnan(frequency) else frequency
        return noise_rms(self.spectrum, self.amplitude, ~self.masked, where)

    @property
    def guard(self) -> float:
        """Two standard deviations of the ratio, from the noise on both amplitudes."""
        return self.noise / self.denominator * math.sqrt(2.0 * (1.0 + self.threshold**2))


def gather(
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
    """Turn samples into spectra, masks and the amplitudes that the rules compare."""
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
    return Evidence(
        spectrum=spectrum,
        amplitude=amplitude,
        left=without_orders(raw, phasors, base) * scale,
        masked=_order_mask(spectrum, base, error),
        base=base,
        speed_error=error,
        tooth_frequency=tooth_frequency,
        tooth_amplitude=tooth_amplitude,
        denominator=max(tooth_amplitude, floor),
        floor=floor,
        unit=unit,
        threshold=threshold,
        teeth=teeth,
        half=half,
        half_growth=_growth(part, half[0]),
        half_reference=reference,
    )


def _remaining_error(spectrum: LineSpectrum, base: float, count: int, tolerance: float) -> float:
    """Return the relative error left after the comb: half a bin at the highest order that can be seen."""
    visible = highest_visible_order(spectrum, base, count)
    if visible == 0:
        return tolerance
    return min(tolerance, 0.5 * spectrum.resolution / (visible * base))


def _highest_line(
    spectrum: LineSpectrum, amplitude: NDArray[np.float64], base: float, stride: int, error: float
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


def _growth(part: CutPart, frequency: float) -> float:
    """Return how much a line has grown from the first to the last quarter of the cut; NaN when there is no line."""
    quarter = part.cut.shape[1] // 4
    if math.isnan(frequency) or quarter * part.dt * frequency < 4.0:
        return math.nan
    pieces = (part.cut[:, :quarter], part.cut[:, -quarter:])
    first, last = (float(np.linalg.norm(order_phasors(p, part.dt, frequency, 1))) for p in pieces)
    return last / first if first > 0.0 else math.inf


def labelled_spectrum(e: Evidence, axes: list[str], unit: str) -> xr.Dataset:
    """Return the spectrum for plotting."""
    data = {
        "amplitude": (("axis", "frequency"), np.abs(e.spectrum.phasor), {"units": unit}),
        "vector_amplitude": ("frequency", e.amplitude, {"units": unit}),
        "harmonic": ("frequency", e.masked, {"units": "1"}),
    }
    coords = {"axis": axes, "frequency": ("frequency", e.spectrum.frequency, {"units": "Hz"})}
    return xr.Dataset(data, coords=coords, attrs={"resolution_Hz": e.spectrum.resolution, "window": "hann"})
