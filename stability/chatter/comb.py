"""Number of teeth and spindle speed that the orders of a cut support, and the spectrogram of the whole record.

Both judge by energy: which share of the power in the band stands at the orders that a number of teeth, or a speed,
explains.
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from scipy import fft, signal

from process.labels import UNITS, sample_interval
from stability.chatter.cut_interval import CutPart
from stability.chatter.line_spectrum import LineSpectrum, hann_spectrum, order_phasors, stands_out
from stability.chatter.rules import RULES
from stability.chatter.spindle_speed import spindle_from_lines


def other_teeth(part: CutPart, teeth: int) -> tuple[int, str]:
    """Return the number of teeth to judge with, and a sentence where it is not the declared one.

    Another number is taken only where the declared orders have less than a tenth of the power and those of the other
    more than four fifths; a divisor of the declared number is left to run-out and period doubling.
    """
    top = min(int(0.4 / (part.dt * part.base)), 6 * max(teeth, 8))
    if top < 2 * teeth:
        return teeth, ""
    power = (np.abs(order_phasors(part.samples, part.dt, part.base, top)) ** 2).sum(axis=0)
    # Lines beside the orders, where there is nothing but noise and chatter: an order must stand out of them.
    beside = order_phasors(part.samples, part.dt, part.base * (1.0 + 0.37 / top), top)
    if power.max() <= RULES.stands_out**2 * float(np.median((np.abs(beside) ** 2).sum(axis=0))):
        return teeth, ""
    order = np.arange(1, top + 1)
    share = {z: float(power[order % z == 0].sum() / power.sum()) for z in range(2, RULES.most_teeth + 1)}
    if teeth == 1 or share.get(teeth, 0.0) > RULES.not_explained:
        return teeth, ""
    # One line that stands alone is chatter on an order, not a tool: what is left without it must say the same.
    rest = np.where(order == order[np.argmax(power)], 0.0, power)
    left = {z: float(rest[order % z == 0].sum() / max(rest.sum(), 1e-300)) for z in share}
    share = {z: min(share[z], left[z]) for z in share}
    fits = [z for z in share if share[z] > RULES.explained and teeth % z != 0 and z % teeth != 0 and z <= 2 * teeth]
    if not fits:
        return teeth, ""
    best = max(fits, key=lambda z: (round(share[z], 2), z))
    high = power[order % best == 0]
    if np.count_nonzero(high > 1e-4 * high.max()) < 3:
        return teeth, ""
    heights = (float(np.sqrt(power[order % z == 0].max())) for z in (best, teeth))
    better = next(heights) / max(next(heights), 1e-300)
    return best, (
        f"{teeth} teeth are declared, but {best} fit: order {best} and its multiples are {better:.2g} times as high as "
        f"those of {teeth}; judged with {best} teeth, check the tool"
    )


def other_speed(part: CutPart, base: float, teeth: int, band: tuple[float, float], line: float) -> str:
    """Return a sentence where the lines fit another speed far better than the one they are judged at.

    Parameters
    ----------
    part : CutPart
        What is judged, at constant speed.
    base : float
        Spindle frequency it is judged at [Hz].
    teeth : int
        Number of teeth.
    band : (float, float)
        Frequencies [Hz].
    line : float
        The line that was found [Hz].
    """
    spectrum = hann_spectrum(part.samples, part.dt, band)
    end = spectrum.frequency[-1]

    def seen_of(spacing: float) -> int:
        return sum(stands_out(spectrum, k * spacing, 0.5 * k) for k in range(1, 6) if k * spacing < end)

    if seen_of(teeth * base) == 0 and seen_of(line) >= 4:
        return (
            f"no harmonic of {teeth} teeth at {60.0 * base:.4g} rpm stands out, but {seen_of(line)} of the first five "
            f"multiples of {line:.4g} Hz do, which is the tooth passing frequency at {60.0 * line / teeth:.4g} rpm: "
            "check the speed"
        )
    found = spindle_from_lines(spectrum, teeth, (0.4 * base, 2.5 * base))
    if found is None or abs(found / base - 1.0) < 0.02:
        return ""
    # Chatter has a comb of its own, which may hold nearly all power; the orders of the right speed stand out still.
    harmonics = [k * teeth * base for k in range(1, 6) if k * teeth * base < spectrum.frequency[-1]]
    if sum(stands_out(spectrum, line, 0.5) for line in harmonics) >= 2:
        return ""
    here, there = (_share_at(spectrum, speed) for speed in (base, found))
    ends = (k * teeth * found for k in range(1, 9))
    seen = sum(stands_out(spectrum, line, 0.5) for line in ends if line < spectrum.frequency[-1])
    if there < RULES.explained or here > 0.5 * there or seen < 5:
        return ""
    return (
        f"the lines of the record fit {60.0 * found:.4g} rpm far better than {60.0 * base:.4g} rpm (the orders of the "
        f"one hold {100.0 * there:.0f} % of the power, those of the other {100.0 * here:.0f} %): check the speed"
    )


def _share_at(spectrum: LineSpectrum, base: float) -> float:
    """Share of the power within two bins of the orders of a speed [Hz], less what they would hold of noise."""
    power = spectrum.vector_amplitude**2
    distance = np.abs(spectrum.frequency - np.maximum(1.0, np.round(spectrum.frequency / base)) * base)
    at = distance <= 2.0 * spectrum.resolution
    width = float(at.mean())
    return max(0.0, (float(power[at].sum() / power.sum()) - width) / max(1.0 - width, 1e-9))


def spectrogram(
    record: xr.Dataset, channel: str, axes: list[str], band: tuple[float, float], base: float
) -> xr.Dataset:
    """Return the amplitudes of a whole record over time and frequency, the highest of what falls into one point.

    Parameters
    ----------
    record : xarray.Dataset
        The record.
    channel : str
        What is shown, as recorded.
    axes : list of str
        Its axes.
    band : (float, float)
        Frequencies [Hz].
    base : float
        Spindle frequency [Hz].
    """
    dt = sample_interval(record)
    rows = record[channel].values[None] if "axis" not in record[channel].dims else None
    values = record[channel].sel(axis=axes).transpose("axis", "time").values if rows is None else rows
    duration = values.shape[1] * dt
    window = min(max(duration / 100.0, RULES.picture_turns / base, 64 * dt), duration)
    n = max(8, min(values.shape[1], round(window / dt)))
    step = max(1, round(max(window / 8.0, (duration - window) / RULES.picture[0]) / dt))
    starts = np.arange(0, values.shape[1] - n + 1, step)
    shape = signal.windows.hann(n, sym=False)
    frequency = fft.rfftfreq(n, dt)
    inside = (frequency >= band[0]) & (frequency <= band[1])
    # Each point of the picture holds the highest of so many neighbouring lines.
    each = math.ceil(np.count_nonzero(inside) / RULES.picture[1])
    first = np.arange(0, np.count_nonzero(inside), each)
    grid = np.array([part.mean() for part in np.split(frequency[inside], first[1:])])
    size = np.zeros((values.shape[0], starts.size, grid.size), dtype=np.float32)
    # One window after the other: all at once would take gigabytes for a minute at 50 kHz.
    for row, samples in enumerate(values):
        for column, start in enumerate(starts):
            piece = samples[start : start + n]
            lines = np.abs(fft.rfft((piece - piece.mean()) * shape)) * (2.0 / shape.sum())
            size[row, column] = np.maximum.reduceat(lines[inside], first)
    data = {"amplitude": (("axis", "time", "frequency"), size, {"units": UNITS[channel]})}
    coords = {
        "axis": axes,
        "time": ("time", float(record["time"].values[0]) + (starts + 0.5 * n) * dt, {"units": "s"}),
        "frequency": ("frequency", grid, {"units": "Hz"}),
    }
    return xr.Dataset(data, coords=coords, attrs={"window_s": n * dt})
