"""What an axis in motion does without a hit, learnt between the hits and taken off.

An axis that moves carries its own motion into the record: a displacement that runs away with the feed, an accelerometer
that drifts, ripple of servo, screw and rack as tones, friction as noise. The block of a hit cuts a piece out of it,
whose ends leak into all lines, the same way in every block: averaging does not help. In the quiet spans, the second
half of the time to the next hit, when the machine has rung down, nothing else moves, so there the motion is fitted
(`smfe.identification.spectra.tones`):

    x(t) = sum_k c_k t^k  (about each hit its own)  +  sum_i a_i cos w_i t + b_i sin w_i t  (one for the whole record).

Noise cannot be predicted; it stays, and is in the scatter of the hits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray
from scipy import fft, ndimage

from process.labels import AXES, axis_index, sample_interval
from process.types import Complex, Real
from smfe.identification.hammer.impacts import Hit
from smfe.identification.hammer.rules import RULES
from smfe.identification.spectra.spectra import block_spectra, motion_axes
from smfe.identification.spectra.tones import NONE, Tones, alike, fit_tones, multiples

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Background:
    """What is fitted between hits.

    Parameters
    ----------
    order : int, optional
        Of the polynomial about each hit. Default: 2 for a displacement, 1 for an acceleration.
    most_tones : int, optional
        Largest number of tones an axis.
    share : float, optional
        Share of the time to the next hit after which a span is quiet [1].
    """

    order: int | None = None
    most_tones: int = 8
    share: float = 0.5


@dataclass(frozen=True)
class Removed:
    """A record without its background, and what that was.

    Parameters
    ----------
    record : xarray.Dataset
        The motion channel without background; everything else as it was.
    tones : pandas.DataFrame
        axis, frequency_Hz, amplitude (unit of the channel).
    share : mapping of str to float
        Axis -> share of the power in the quiet spans that was explained [1], after their mean was taken off.
    quiet : float
        Length of the quiet spans together [s].
    fitted : mapping of str to Tones
        Axis -> the tones with their covariance.
    """

    record: xr.Dataset
    tones: pd.DataFrame
    share: dict[str, float]
    quiet: float
    fitted: dict[str, Tones]


def remove_background(record: xr.Dataset, hits: Sequence[Hit], rules: Background | None = None) -> Removed:
    """Return a record without the motion that goes on between its hits.

    Parameters
    ----------
    record : xarray.Dataset
        A record with hits.
    hits : sequence of Hit
        All hits in it, in order, refused ones too.
    rules : Background, optional
        What is fitted.
    """
    rules = rules or Background()
    channel, axes = motion_axes(record)
    dt, count = sample_interval(record), record.sizes["time"]
    quiet, late = quiet_spans(hits, count, dt, rules.share)
    order = rules.order if rules.order is not None else (2 if channel == "displacement" else 1)
    motion = record[channel].copy(deep=True)
    rows, share, fitted = [], {}, {}
    for axis in axes:
        samples = record[channel].sel(axis=axis).values
        tones = NONE
        trend = _trend(samples, hits, quiet, dt, order)
        if quiet.any():
            tones = _tones(samples - trend, quiet, late, dt, rules.most_tones)
        usual = quiet
        for _ in range(RULES.background_rounds):
            # The trend again, without the tones that bent it; the tones without the bend; neither where more moves.
            trend = _trend(samples - tones.wave(count, dt), hits, usual, dt, order)
            usual = alike(samples - trend - tones.wave(count, dt), quiet, dt)
            more = multiples(tones, rules.most_tones - tones.frequency.size, 0.4 / dt)
            tones = fit_tones(samples - trend, usual, dt, [*tones.frequency, *more])
            # What was seen of a transient before it was left out is not there any more.
            if not (tones.clear**2 > RULES.clear_tone).all():
                tones = fit_tones(samples - trend, usual, dt, list(tones.frequency[tones.clear**2 > RULES.clear_tone]))
        wave = tones.wave(count, dt)
        trend = _trend(samples - wave, hits, usual, dt, order)
        cleaned = samples - wave - trend
        motion.loc[{"axis": axis}] = cleaned
        size = np.hypot(tones.cosine, tones.sine)
        rows += [{"axis": axis, "frequency_Hz": f, "amplitude": a} for f, a in zip(tones.frequency, size, strict=True)]
        fitted[axis] = tones
        before = float(np.var(samples[quiet])) if quiet.any() else 0.0
        share[axis] = 1.0 - float(np.mean(cleaned[quiet] ** 2)) / before if before > 0.0 else 0.0
    table = pd.DataFrame(rows, columns=["axis", "frequency_Hz", "amplitude"])
    return Removed(record.assign({channel: motion}), table, share, float(np.count_nonzero(quiet)) * dt, fitted)


def quiet_spans(hits: Sequence[Hit], count: int, dt: float, share: float = 0.5) -> tuple[Mask, Mask]:
    """Return which samples are quiet, and which of these lie in the later half of their span.

    Before the first hit all are; after a hit those beyond `share` of the time to the next one, or of the usual such
    time after the last.

    Parameters
    ----------
    hits : sequence of Hit
        All hits of the record, in order.
    count : int
        Samples of the record.
    dt : float
        Sampling interval [s].
    share : float, optional
        [1].
    """
    quiet, late = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    onsets = [hit.onset for hit in hits]
    guard = int(RULES.guard / dt) + 1
    usual = float(np.median(np.diff(onsets))) if len(onsets) > 1 else float(count - onsets[0])
    ends = [*onsets[1:], min(count + guard, onsets[-1] + round(usual))]
    spans = [(0, onsets[0] - guard)]
    spans += [(a + int(share * (b - a)), b - guard) for a, b in zip(onsets, ends, strict=True)]
    for a, b in spans:
        if b > a:
            quiet[a:b] = True
            late[(a + b) // 2 : b] = True
    return quiet, late


def _trend(samples: Real, hits: Sequence[Hit], quiet: Mask, dt: float, order: int) -> Real:
    """Return the polynomial of each hit over its own stretch, fitted to the quiet samples on both sides of it."""
    onsets = [hit.onset for hit in hits]
    out = np.zeros(samples.size)
    guard = int(RULES.guard / dt) + 1
    borders = [0, *(max(o - guard, 0) for o in onsets[1:]), samples.size]
    for number, (a, b) in enumerate(pairwise(borders)):
        # As much time before the hit as the quiet span before it is long: the later half of the last stretch.
        begin = borders[number - 1] if number else 0
        inside = np.flatnonzero(quiet[begin:b]) + begin
        if inside.size < 4 * (order + 1):
            continue
        middle, half = 0.5 * (begin + b), max(0.5 * (b - begin), 1.0)
        fit = np.polynomial.legendre.legfit((inside - middle) / half, samples[inside], order)
        out[a:b] = np.polynomial.legendre.legval((np.arange(a, b) - middle) / half, fit)
    return out


def _tones(samples: Real, quiet: Mask, late: Mask, dt: float, most: int) -> Tones:
    """Return the tones that go on through all quiet spans, the clearest first."""
    rest = np.where(quiet, samples - float(np.mean(samples[quiet])), 0.0)
    found, refused, usual = NONE, list[float](), quiet
    length = fft.next_fast_len(2 * rest.size, real=True)
    frequency = fft.rfftfreq(length, dt)
    line = 1.0 / (rest.size * dt)
    for _ in range(2 * most):
        if found.frequency.size == most:
            break
        power = np.abs(fft.rfft(rest, length)) ** 2
        floor = ndimage.median_filter(power, 2 * RULES.tone_neighbours + 1, mode="nearest") / np.log(2.0)
        ratio = power / np.where(floor > 0.0, floor, np.inf)
        ratio[frequency < 4.0 * line] = 0.0
        for f in refused:
            ratio[np.abs(frequency - f) < max(0.01 * f, 8.0 * line)] = 0.0
        top = int(np.argmax(ratio))
        if ratio[top] < RULES.clear_tone:
            break
        # Alone first: its line may lie off by more than joint steps forgive.
        tone = _refined(np.where(quiet, rest, 0.0), usual, dt, float(frequency[top]))
        more = fit_tones(samples, usual, dt, [*found.frequency, tone])
        if _goes_on(samples, usual, late & usual, dt, list(more.frequency)):
            found = more
        else:
            refused.append(tone)
        usual = alike(samples - found.wave(samples.size, dt), quiet, dt)
        rest = np.where(usual, samples - found.wave(samples.size, dt), 0.0)
        rest = np.where(usual, rest - float(np.mean(rest[usual])), 0.0)
    return found


def _columns(frequencies: Sequence[float], index: NDArray[np.int64], dt: float) -> Real:
    angle = 2.0 * np.pi * dt * np.outer(index, frequencies)
    return np.concatenate([np.cos(angle), np.sin(angle), np.ones((index.size, 1))], axis=1)


def _solve(matrix: Real, right: Real) -> Real:
    return np.asarray(np.linalg.lstsq(matrix.T @ matrix, matrix.T @ right, rcond=None)[0])


def _amplitudes(samples: Real, mask: Mask, dt: float, frequencies: list[float]) -> list[tuple[float, float, float]]:
    if not frequencies:
        return []
    index = np.flatnonzero(mask)
    found = _solve(_columns(frequencies, index, dt), samples[index])
    n = len(frequencies)
    return [(f, float(found[i]), float(found[n + i])) for i, f in enumerate(frequencies)]


def _refined(samples: Real, mask: Mask, dt: float, frequency: float) -> float:
    """Return the frequency [Hz] that fits best over the quiet samples (Gauss-Newton, time from the middle)."""
    index = np.flatnonzero(mask)
    middle = 0.5 * (index[0] + index[-1])
    t = (index - middle) * dt
    half = max(float(t[-1]), dt)
    w = 2.0 * np.pi * frequency
    for _ in range(8):
        cos, sin = np.cos(w * t), np.sin(w * t)
        a, b, _ = _solve(np.stack([cos, sin, np.ones_like(t)], axis=1), samples[index])
        slope = t / half * (b * cos - a * sin)
        change = float(_solve(np.stack([cos, sin, np.ones_like(t), slope], axis=1), samples[index])[3]) / half
        change = float(np.clip(change, -0.5 * np.pi / half, 0.5 * np.pi / half))
        w += change
        if abs(change) * half < 1e-6:
            break
    return float(w / (2.0 * np.pi))


def _goes_on(samples: Real, quiet: Mask, late: Mask, dt: float, frequencies: list[float]) -> bool:
    """Whether the last tone is the same early and late in the quiet spans, and in every other span.

    Ringing dies away within a span and begins anew, with the phase of the hit, in the next. In a single span only its
    decay distinguishes it, so that less of it is allowed.
    """
    spans = ndimage.label(quiet)[0]
    parts = [(quiet & ~late, quiet & late)]
    if spans.max() > 1:
        parts.append((quiet & (spans % 2 == 0), quiet & (spans % 2 == 1)))
    limit = RULES.constant_tone if spans.max() > 1 else 0.3 * RULES.constant_tone
    for first, second in parts:
        tones = [_amplitudes(samples, part, dt, frequencies)[-1] for part in (first, second)]
        one, two = (complex(cosine, -sine) for _, cosine, sine in tones)
        if abs(two - one) > limit * max(abs(one), abs(two)):
            return False
    return True


# --- standard error that removing the tones adds to H1 ---------------------------------------------------------------


def tone_errors(record: xr.Dataset, starts: Sequence[int], taper: Real, tones: Mapping[str, Tones]) -> Complex:
    """Return the transforms of one standard error of each parameter of the tones that were taken off.

    Parameters
    ----------
    record : xarray.Dataset
        With the motion channel that they were taken off.
    starts : sequence of int
        First samples of the blocks.
    taper : ndarray
        Window, as long as a block.
    tones : mapping of str to Tones
        By axis.

    Returns
    -------
    ndarray of complex, shape (f, 3, blocks, p)
        Of the displacement [m s], without the line at 0 Hz; the p errors are independent of each other.
    """
    dt, count, (channel, axes) = sample_interval(record), record.sizes["time"], motion_axes(record)
    out = []
    for axis in axes:
        there = tones.get(axis, NONE)
        for number in range(there.factor.shape[1]):
            error = xr.zeros_like(record[channel])
            error.loc[{"axis": axis}] = there.standard_error(number, count, dt)
            spectra = block_spectra(record.assign({channel: error}), starts, taper.size, taper, detrend=True)
            whole = np.zeros((spectra.frequency.size - 1, len(AXES), len(starts)), dtype=complex)
            whole[:, axis_index(spectra.response)] = spectra.displacement[1:]
            out.append(whole)
    return np.stack(out, axis=3) if out else np.zeros((taper.size // 2, len(AXES), len(starts), 0), dtype=complex)


def join_records(parts: Sequence[Complex]) -> Complex:
    """Join the errors (f, 3, blocks, p) of several records, whose blocks and errors are each their own."""
    f, rows = parts[0].shape[:2]
    out = np.zeros((f, rows, sum(p.shape[2] for p in parts), sum(p.shape[3] for p in parts)), dtype=complex)
    block = number = 0
    for part in parts:
        out[:, :, block : block + part.shape[2], number : number + part.shape[3]] = part
        block, number = block + part.shape[2], number + part.shape[3]
    return out


def common_tone_error(tone_error: Complex, force: Complex, leverage: Real) -> Complex:
    """Return the standard error that removing the tones adds to H1, shape (f, responses, p) [m/N].

    It is the part that is common to all hits, which their scatter does not contain.

    An error ``dX_m`` of known shape and unit standard deviation moves H1 by ``s = sum_m h_m dX_m/F_m``. The scatter
    already shows ``v = sum_m h_m^2 |dX_m/F_m - s|^2/(1 - h_m)`` of it, on average all where its phase differs from hit
    to hit, and nothing where the hits keep step with it; ``|s|^2 - v`` is left.

    Parameters
    ----------
    tone_error : ndarray of complex, shape (f, responses, M, p)
        Errors of the transforms [m s], independent of each other.
    force : ndarray of complex, shape (f, M)
        Transforms of the force [N s].
    leverage : ndarray, shape (f, responses, M)
        Of `Average`.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        each = np.nan_to_num(tone_error / force[:, None, :, None])
    h = leverage[..., None]
    whole = np.sum(h * each, axis=2)
    left = np.minimum(h, 1.0 - 1e-12)
    shown = np.sum(h**2 * np.abs(each - whole[:, :, None]) ** 2 / (1.0 - left), axis=2)
    size = np.abs(whole) ** 2
    share = np.sqrt(np.maximum(size - shown, 0.0) / np.where(size > 0.0, size, 1.0))
    return np.asarray(whole * share)
