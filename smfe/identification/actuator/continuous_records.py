"""Records of a shaker whose force neither dwells nor repeats itself: samples, band, silence, what was cut off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from process.errors import InputError
from process.labels import axis_index, sample_interval
from process.types import Complex, Real
from smfe.identification.actuator.columns import Column
from smfe.identification.actuator.rules import RULES
from smfe.identification.errors.result import in_words
from smfe.identification.spectra.spectra import as_displacement, force_samples, motion_axes, record_source
from smfe.identification.sweep.noise import density_of
from smfe.identification.sweep.passes import air_pieces
from smfe.identification.sweep.rules import RULES as SWEEP_RULES


@dataclass(frozen=True)
class Records:
    """Samples of the records of one excitation: forces (n,), motions (responses, n) of one channel and rate."""

    axis: str
    force: list[Real]
    motion: list[Real]
    sources: list[str]
    channel: str
    response: list[str]
    dt: float
    quiet: list[float | None]
    clipped: float

    @property
    def noise_known(self) -> bool:
        """Whether every record has silence in which the noise of the force was seen."""
        return all(q is not None for q in self.quiet)

    def force_noise(self, bound: Sequence[float]) -> list[float]:
        """Return the power density of the noise of the force of each record [N2/Hz]: at most the bound."""
        return [b if q is None else min(b, q) for q, b in zip(self.quiet, bound, strict=True)]

    @property
    def seconds(self) -> list[float]:
        """Lengths [s]."""
        return [f.size * self.dt for f in self.force]


def samples_of(axis: str, records: Sequence[xr.Dataset]) -> Records:
    """Return the samples of the records of an excitation; `InputError` where they differ, or are cut off."""
    channel, response = motion_axes(records[0])
    dt = sample_interval(records[0])
    forces, motions, sources, quiet, share = [], [], [], [], 0.0
    for k, record in enumerate(records):
        source = record_source(record, k)
        here = motion_axes(record)
        if here != (channel, response) or abs(sample_interval(record) / dt - 1.0) > 1e-6:
            raise InputError(
                f"the records of excitation {axis} differ in their sample rate or in the motion they hold; give those "
                "that differ a measurement of their own"
            )
        force = force_samples(record, axis, source)
        clipped = clipped_share(force)
        if clipped > RULES.clipped:
            raise InputError(
                f"{source}: force_{axis} is at the end of its range in {100.0 * clipped:.2g} % of its samples; what "
                "was cut off is lost: widen the range, and measure again"
            )
        share = max(share, clipped)
        forces.append(force - force.mean())
        motion = np.array([record[channel].sel(axis=a).values for a in response])
        motions.append(motion - motion.mean(axis=1, keepdims=True))
        sources.append(source)
        quiet.append(_quiet(record, axis))
    return Records(axis, forces, motions, sources, channel, response, dt, quiet, share)


def clipped_share(samples: Real) -> float:
    """Return the share of samples that lie exactly at one of both ends, where more do than near it.

    The end of a range collects all that lies beyond it; of a signal that only happens to end there, few samples have
    its greatest value, and of a sine in the steps of a converter 2.4 times as many as have the next.
    """
    share = 0.0
    for turned in (samples, -samples):
        top = float(turned.max())
        at = int(np.count_nonzero(turned == top))
        below = turned[turned < top]
        if at < 6 or not below.size:
            continue
        # The width of a bin below the end: a step of the converter, or what would hold a few samples.
        step = max(top - float(below.max()), 1e-3 * float(np.std(samples)))
        near = int(np.count_nonzero(below > top - 1.5 * step))
        if at > 5 * max(near, 1):
            share += at / samples.size
    return share


def _quiet(record: xr.Dataset, axis: str) -> float | None:
    """Return the power density of the force where nothing excites [N2/Hz], two-sided; None without such a piece."""
    dt, force = sample_interval(record), record["force"].sel(axis=[axis]).values
    pieces = [p for p in air_pieces(record) if (p.stop - p.start) * dt >= SWEEP_RULES.shortest_air]
    if not pieces:
        return None
    longest = max(pieces, key=lambda p: p.stop - p.start)
    top = 1.0 / dt / RULES.anti_alias
    density, lines = density_of(force[:, longest], dt, (0.02 * top, top), 0.5)
    return float(density[0]) if lines >= 8.0 else None


def band_of(name: str, groups: Sequence[Records], wanted: tuple[float, float] | None) -> tuple[float, float]:
    """Return the band in which any force has power, within what was asked for [Hz]."""
    low, high = np.inf, 0.0
    for g in groups:
        frequency, power = smooth_power(g)
        strong = np.flatnonzero(power > 10.0 * RULES.powerless * np.quantile(power, 0.95))
        if not np.any(power > 0.0) or not strong.size:
            raise InputError(f"measurement '{name}': force_{g.axis} is constant; check its channel")
        low, high = min(low, frequency[strong[0]]), max(high, frequency[strong[-1]])
    top = 1.0 / groups[0].dt / RULES.anti_alias
    least = 4.0 / max(max(g.seconds) for g in groups)
    low, high = max(low, least), min(high, top)
    if wanted is not None:
        if wanted[1] > 0.5 / groups[0].dt or not wanted[0] < wanted[1]:
            raise InputError(
                f"measurement '{name}': the frequency range {wanted[0]:.4g} to {wanted[1]:.4g} Hz does not lie below "
                f"half the sample rate, {0.5 / groups[0].dt:.4g} Hz"
            )
        low, high = max(wanted[0], least), wanted[1]
    if not low < high:
        raise InputError(
            f"measurement '{name}': the force has no power between {low:.4g} and {high:.4g} Hz; check its channel and "
            "the frequency range"
        )
    return float(low), float(high)


def smooth_power(g: Records) -> tuple[Real, Real]:
    """Return the power of the force of all records over about a hundredth of the band (f,), [N2 s2]."""
    longest = max(g.force, key=lambda f: f.size)
    frequency = fft.rfftfreq(longest.size, g.dt)
    inside = frequency <= 1.0 / g.dt / RULES.anti_alias
    power = np.abs(fft.rfft(longest)) ** 2
    width = max(3, inside.sum() // 300)
    return frequency[inside], ndimage.uniform_filter1d(power, width)[inside]


def frequency_axis(groups: Sequence[Records], band: tuple[float, float], resolution: float | None) -> Real:
    """Return the axis of frequencies [Hz]: multiples of the resolution, else of 1, 2 or 5 times a power of ten."""
    longest = max(max(g.seconds) for g in groups)
    step = resolution
    if step is None:
        least = max((band[1] - band[0]) / RULES.most_frequencies, 0.5 / longest)
        decade = 10.0 ** np.floor(np.log10(least))
        step = float(next(m * decade for m in (1.0, 2.0, 5.0, 10.0) if m * decade >= least * (1.0 - 1e-9)))
    lines = np.arange(np.ceil(band[0] / step - 1e-9), np.floor(band[1] / step + 1e-9) + 1.0) * step
    if lines.size < 2:
        raise InputError(
            f"a resolution of {step:.4g} Hz leaves no line between {band[0]:.4g} and {band[1]:.4g} Hz; choose a finer "
            "one"
        )
    return np.asarray(lines)


def powerless_lines(g: Records, frequency: Real) -> NDArray[np.bool_]:
    """Mark the lines (f,) at which the force has no power."""
    at, power = smooth_power(g)
    return np.asarray(np.interp(frequency, at, power, right=np.inf) < RULES.powerless * np.quantile(power, 0.95))


@dataclass(frozen=True)
class Response:
    """What an estimator found at the frequencies, of the motion as it was recorded; shapes (f, responses).

    Parameters
    ----------
    value : ndarray of complex
        Motion over force.
    variance : ndarray
        Of the complex error.
    relation : ndarray of complex
        ``E[d^2]``.
    degrees_of_freedom, coherence : ndarray
        Degrees of freedom of each part; coherence.
    lost : ndarray
        Share of the value that noise of the force takes from a least squares, or may take.
    unclaimed : ndarray of bool, shape (f,)
        Lines that are not claimed for a reason that `notes` give.
    error_lines : float
        Lines that share an error.
    notes : tuple of str
        What is to be said.
    """

    value: Complex
    variance: Real
    relation: Complex
    degrees_of_freedom: Real
    coherence: Real
    lost: Real
    unclaimed: NDArray[np.bool_]
    error_lines: float
    notes: tuple[str, ...]


def column_of(g: Records, frequency: Real, found: Response) -> Column:
    """Return the compliance of an axis, NaN where nothing is claimed, and say where that is."""
    powerless = powerless_lines(g, frequency)
    with np.errstate(invalid="ignore"):
        drowned = ~(found.lost <= RULES.drowned).all(axis=1) & ~powerless
    clip = g.clipped * found.value
    cut = np.where(powerless | drowned | found.unclaimed, np.nan, 1.0)[:, None]
    scale = as_displacement(np.ones((frequency.size, 1), complex), frequency, g.channel) * cut
    rows = axis_index(g.response)

    def on_axes(part: NDArray[Any]) -> NDArray[Any]:
        whole = np.full((frequency.size, 3), np.nan, part.dtype)
        whole[:, rows] = part
        return whole

    where, notes = f"excitation {g.axis}: ", [f"excitation {g.axis}: {text}" for text in found.notes]
    if powerless.any():
        notes.append(f"{where}the force has no power in {in_words(frequency, powerless)}; nothing is claimed there")
    if drowned.any():
        notes.append(
            f"{where}in {in_words(frequency, drowned)} the force may be noise for the most part; nothing is claimed "
            "there: excite harder there, or record silence before the start so that its noise is known"
        )
    share = np.nan_to_num(found.lost * cut).max(axis=1)
    if share.max() > 0.01:
        notes.append(
            f"{where}noise of the force lowers a least squares by {'' if g.noise_known else 'at most '}"
            f"{100.0 * share.max():.2g} % (at {frequency[int(np.argmax(share))]:.4g} Hz), which is in the standard "
            "deviation as far as it is not taken out"
        )
    if g.clipped > 0.0:
        notes.append(
            f"{where}the force is at the end of its range in {100.0 * g.clipped:.2g} % of the samples, which is in the "
            "standard deviation: widen the range"
        )
    table = pd.DataFrame(
        {
            "excitation": g.axis,
            "file": g.sources,
            "duration_s": g.seconds,
            "force_N": [float(np.std(f) * np.sqrt(2.0)) for f in g.force],
            "force_peak_N": [float(np.max(np.abs(f))) for f in g.force],
        }
    )
    return Column(
        g.axis,
        on_axes(found.value * scale),
        on_axes((found.variance + np.abs(clip) ** 2) * np.abs(scale) ** 2),
        on_axes((found.relation + clip**2) * scale**2),
        on_axes(found.degrees_of_freedom * cut),
        on_axes(found.coherence * cut),
        table,
        tuple(notes),
        found.error_lines,
    )
