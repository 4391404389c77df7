"""What kind of record a file seems to be: from the channels it has and from how they behave."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import signal, stats

from process.types import Real

_WINDOWS = 150
_LEAST_WINDOW = 64
_MOST = 1 << 20
"""Samples that are looked at; of longer records the middle."""


@dataclass(frozen=True)
class Kind:
    """A kind of record and what speaks for it.

    Parameters
    ----------
    name : str
        "impact test", "stepped sine", "sine", "sine sweep", "periodic excitation", "random excitation", "cut",
        "sweep milling", "drive stroke", "loop trace", "FRF", "vibration without a force" or "unknown".
    reason : str
        What was seen, with numbers.
    fundamental : float
        Frequency whose multiples hold the power of a cut [Hz]; NaN for other kinds.
    strongest : int
        Number of the strongest of these multiples; 0 for other kinds.
    """

    name: str
    reason: str
    fundamental: float = math.nan
    strongest: int = 0


def kind_of(channels: Mapping[str, Real], rate: float) -> Kind:
    """Return the kind of a record.

    Parameters
    ----------
    channels : mapping of str to ndarray, shape (n,)
        Channel ("force_x", "sound", ...) -> samples.
    rate : float
        Sample rate [Hz].
    """
    groups = {name.rsplit("_", 1)[0] if name[-2:] in ("_x", "_y", "_z") else name for name in channels}
    if {"reference_speed", "encoder_speed"} <= groups:
        return Kind("loop trace", "it has setpoint and actual value of a speed")
    if "force" not in groups and groups & {"encoder_position", "encoder_speed"}:
        if "drive_force" in groups:
            return Kind("drive stroke", "it has the position of an axis and the force, torque or current of its drive")
        if {"reference_position", "encoder_position"} <= groups:
            return Kind("loop trace", "it has setpoint and actual value of a position")
    forces = {n: v for n, v in channels.items() if n.startswith("force_")}
    motions = {n: v for n, v in channels.items() if n.startswith(("acceleration_", "displacement_")) or n == "sound"}
    main = _strongest(forces) or _strongest(motions)
    if main is None:
        return Kind("unknown", "no column was recognised as a force, a motion or a sound")
    name, samples = main
    part = samples[max(0, (samples.size - _MOST) // 2) :][:_MOST]
    part = part - np.median(part)
    if not np.any(part):
        return Kind("unknown", f"{name} is constant")
    speed = channels.get("spindle_speed")
    if forces:
        return _hits(part, rate, name) or _excited(part, rate, name, len(forces), speed)
    comb = _cut(part, rate, name, speed)
    return comb or Kind(
        "vibration without a force", f"{name} has no comb of equally spaced lines, and no force is there"
    )


def _strongest(channels: Mapping[str, Real]) -> tuple[str, Real] | None:
    """Return the channel with the largest standard deviation in its own unit."""
    return max(channels.items(), key=lambda item: float(np.std(item[1])), default=None)


def _hits(force: Real, rate: float, name: str) -> Kind | None:
    """Impacts: the force rests nearly all the time, and what is left are short pulses of one sign."""
    peak = float(np.max(np.abs(force)))
    busy = np.abs(force) > 0.1 * peak
    share = float(np.mean(busy))
    starts, _ = signal.find_peaks(np.abs(force), height=0.2 * peak, distance=max(1, int(0.05 * rate)))
    starts = starts if starts.size else np.array([int(np.argmax(np.abs(force)))])
    seconds = share * force.size / rate / starts.size
    one_sign = float(np.sum(np.clip(np.sign(force[np.argmax(np.abs(force))]) * force[busy], 0.0, None)))
    if share > 0.08 or seconds > 0.04 or one_sign < 0.7 * float(np.sum(np.abs(force[busy]))):
        return None
    return Kind(
        "impact test",
        f"{name} is above a tenth of its peak for {100 * share:.2g} % of the time, in {starts.size} "
        f"pulse{'s' if starts.size > 1 else ''} of about {1e3 * seconds:.2g} ms",
    )


def _excited(force: Real, rate: float, name: str, count: int, speed: Real | None) -> Kind:
    frequency, purity, bin_width = _tone_track(force, rate)
    tone = frequency.size >= 8 and float(np.median(purity)) > 0.8
    if tone and count == 1:
        return _tone(frequency, bin_width, name, float(np.median(purity)))
    cut = _cut(force, rate, name, speed)
    if cut is not None:
        return cut
    period, similar = _period(force, rate)
    if count > 1 and (tone or similar > 0.9):
        # One actuator pushes along one axis; what repeats itself in several comes from teeth.
        said = f"{count} forces, of which {name} repeats itself"
        return Kind("cut", said, float(np.median(frequency)) if tone else 1.0 / period, 1)
    if similar > 0.9:
        return Kind("periodic excitation", f"{name} repeats itself after {period:.4g} s (correlation {similar:.2f})")
    kurtosis = float(stats.kurtosis(force, fisher=False))
    if 1.5 < kurtosis < 4.5:
        return Kind("random excitation", f"{name} has no lines and no period, and a kurtosis of {kurtosis:.2g}")
    return Kind("unknown", f"{name} has neither hits nor lines nor a period; its kurtosis is {kurtosis:.2g}")


def _tone_track(samples: Real, rate: float) -> tuple[Real, Real, float]:
    """Return the strongest frequency of each window [Hz], the share of power within two bins of it, and a bin [Hz]."""
    size = max(_LEAST_WINDOW, samples.size // _WINDOWS)
    count = samples.size // size
    frames = samples[: count * size].reshape(count, size)
    rms = np.sqrt(np.mean(frames**2, axis=1))
    frames = frames[rms > 0.1 * rms.max(initial=0.0)]
    power = np.abs(np.fft.rfft(frames * signal.windows.hann(size), axis=1)) ** 2
    power[:, :2] = 0.0
    at = np.argmax(power, axis=1)
    near = np.abs(np.arange(power.shape[1]) - at[:, None]) <= 2
    purity = np.sum(power * near, axis=1) / np.maximum(np.sum(power, axis=1), 1e-300)
    middle = np.sum(power * near * np.arange(power.shape[1]), axis=1) / np.maximum(np.sum(power * near, axis=1), 1e-300)
    return middle * rate / size, purity, rate / size


def _tone(frequency: Real, bin_width: float, name: str, purity: float) -> Kind:
    low, high = np.quantile(frequency, [0.02, 0.98])
    said = f"{100 * purity:.0f} % of the power of {name} is in one line, "
    if high - low < max(0.02 * high, 0.3 * bin_width):
        return Kind("sine", f"{said}which stays at {np.median(frequency):.4g} Hz")
    steps = np.abs(np.diff(frequency))
    resting = float(np.mean(steps < max(0.1 * np.mean(steps), 0.02 * bin_width)))
    said += f"which goes from {frequency[0]:.4g} to {frequency[-1]:.4g} Hz "
    if resting > 0.3 and np.median(steps) < 0.5 * np.mean(steps):
        return Kind("stepped sine", said + "in steps")
    return Kind("sine sweep", said + "without steps")


def _cut(samples: Real, rate: float, name: str, speed: Real | None) -> Kind | None:
    """A comb: most of the power is in multiples of one frequency, as teeth make it."""
    size = int(min(samples.size, max(1 << 10, samples.size // 12)))
    found = []
    for begin in np.linspace(0, samples.size - size, 7).astype(int):
        frame = samples[begin : begin + size]
        if np.std(frame) > 0.3 * np.std(samples):
            found.append(_comb(frame - frame.mean(), rate))
    # A spindle that changes its speed smears the comb of a window; its channel is then what is left to go by.
    moving = speed is not None and float(np.ptp(speed)) > 0.03 * max(float(np.median(np.abs(speed))), 1e-9)
    if speed is not None and moving and float(np.median(np.abs(speed))) > 0.0:
        ends = f"{np.min(speed):.0f} to {np.max(speed):.0f} rpm"
        return Kind("sweep milling", f"the spindle runs from {ends}", float(np.median(np.abs(speed))) / 60.0, 1)
    clear = [c for c in found if c[0] > 0.6]
    if len(clear) < 0.5 * len(found) or not found:
        if speed is not None and float(np.median(np.abs(speed))) > 0.0:
            rpm = float(np.median(np.abs(speed)))
            return Kind("cut", f"the spindle turns at {rpm:.5g} rpm", rpm / 60.0, 1)
        return None
    share, fundamental, strongest = sorted(clear)[len(clear) // 2]
    track = np.array([f for _, f, _ in clear])
    said = f"{100 * share:.0f} % of the power of {name} is in multiples of {fundamental:.4g} Hz"
    steady = float(np.ptp(track)) < 0.03 * fundamental
    rising = len(clear) >= 5 and np.ptp(track) > 0.0 and _monotonic(track)
    if not steady and rising and float(np.ptp(track)) < fundamental:
        return Kind(
            "sweep milling", f"{said}, which move from {track[0]:.4g} to {track[-1]:.4g} Hz", fundamental, strongest
        )
    return Kind("cut", said, fundamental, strongest)


def _monotonic(track: Real) -> bool:
    return abs(float(stats.spearmanr(np.arange(track.size), track).statistic)) > 0.9


def _comb(frame: Real, rate: float) -> tuple[float, float, int]:
    """Return the share of power in the lines of the best comb, beyond what its width alone catches; its frequency [Hz].

    The third is the number of the strongest line.
    """
    power = np.abs(np.fft.rfft(frame * signal.windows.hann(frame.size))) ** 2
    power[:3] = 0.0
    total, bins = float(power.sum()), power.size
    top = int(np.argmax(power))
    best = (0.0, math.nan, 0)
    for part in range(1, 13):
        start = top / part
        if start < 10.0 or total <= 0.0:
            break
        # The strongest line is known to a fraction of a bin; the highest multiples need it.
        for f0 in start + np.linspace(-0.5, 0.5, 21) / part:
            lines = f0 * np.arange(1, min(int((bins - 3) / f0), 60) + 1)
            at = np.round(lines).astype(int)
            each = power[at - 1] + power[at] + power[at + 1]
            clear = int(np.sum(each > 0.005 * total))
            share = float(each.sum()) / total - 3.0 * at.size / bins
            if clear >= 3 and share > best[0] * (1.0 if part == 1 else 1.02):
                best = (share, f0 * rate / frame.size, int(np.argmax(each)) + 1)
    return best


def _period(samples: Real, rate: float) -> tuple[float, float]:
    """Return the lag of the highest correlation after it first fell below a half [s], and the correlation."""
    size = samples.size // 2
    block = samples[:size] - samples[:size].mean()
    products = signal.fftconvolve(samples - samples.mean(), block[::-1], mode="valid")
    power = np.cumsum(np.concatenate([[0.0], (samples - samples.mean()) ** 2]))
    norm = np.sqrt(np.maximum((power[size:] - power[:-size]) * float(block @ block), 1e-300))
    rho = products / norm[: products.size]
    first = max(4, samples.size // 200)
    below = np.flatnonzero(rho[first:] < 0.5)
    if not below.size:
        return 0.0, 0.0
    at = first + int(below[0]) + int(np.argmax(rho[first + below[0] :]))
    return at / rate, float(rho[at])
