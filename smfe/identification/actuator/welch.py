"""H1, H2 and Hv of a shaker by Welch's method: Hann blocks that overlap by two thirds, and what their window leaks.

Blocks that overlap share noise: of M blocks there are

    n = M/(1 + 2 sum_m (1 - m/M) rho_m^2)

independent ones, with the correlation rho_m of white noise in blocks m apart (Welch 1967), and fewer where few of them
hold the power of the force, as of a chirp. With the coherence g2 the complex error of H1 is ``E|d|^2 = |H|^2 (1 - g2)/
(g2 (n - 1))`` (Bendat and Piersol, Random Data, 9.2).

A block of length L does not resolve a resonance narrower than a few 1/L: its peak comes out low by an error that falls
with ``1/L^2`` (Bendat and Piersol, 8.5). Blocks of half the length show three times that error; it is charged, and
where it is more than a share of the response, nothing is claimed. Without a resolution the length is chosen that errs
least by both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from process.errors import InputError
from process.types import Complex, Real
from smfe.identification.actuator.columns import Column
from smfe.identification.actuator.continuous_records import Records, Response, column_of
from smfe.identification.actuator.rules import RULES
from smfe.identification.errors.averaging import average, noise_ratio
from smfe.identification.errors.result import in_words
from smfe.identification.spectra.spectra import hann, overlap_correlation

HANN_ERROR_LINES = 1.5
"""How many lines of a Hann window share an error: its noise bandwidth."""


@dataclass(frozen=True)
class _Averaged:
    """Averages over blocks of one length, shapes (f, r); frequencies (f,)."""

    frequency: Real
    value: Complex
    variance: Real
    charged: Complex
    blocks: Real
    coherence: Real
    lost: Real


def averaged_blocks(
    groups: Sequence[Records], band: tuple[float, float], resolution: float | None, estimator: str
) -> tuple[Real, list[Column]]:
    """Return the lines of a block within a band [Hz], and what each excitation gave there.

    Parameters
    ----------
    groups : sequence of Records
        One for each excitation, of one sample rate.
    band : (float, float)
        [Hz].
    resolution : float or None
        One over the length of a block [Hz]; None: chosen.
    estimator : {"H1", "H2", "Hv"}
        Which.

    Raises
    ------
    InputError
        For records that are too short for enough blocks.
    """
    if any(abs(g.dt / groups[0].dt - 1.0) > 1e-6 for g in groups):
        raise InputError("the records are sampled at different rates, so blocks have other lines; resample them")
    dt = groups[0].dt
    length = _length(groups, band, estimator) if resolution is None else 2 * round(0.5 / (resolution * dt))
    found = [_with_leakage(g, length, band, estimator) for g in groups]
    frequency = found[0][0].frequency
    return frequency, [_column(g, a, leaked, length) for g, (a, leaked) in zip(groups, found, strict=True)]


def _length(groups: Sequence[Records], band: tuple[float, float], estimator: str) -> int:
    """Return the length of a block that errs least by noise and leakage together [samples]."""
    shortest = min(max(g.seconds) for g in groups) / groups[0].dt
    tried, least, best = int(shortest / (1.0 + RULES.least_blocks * 0.6)) // 2 * 2, np.inf, 0
    while tried >= 64 and tried * groups[0].dt * (band[1] - band[0]) > 16.0:
        total = 0.0
        for g in groups:
            a, leaked = _with_leakage(g, tried, band, estimator)
            with np.errstate(invalid="ignore", divide="ignore"):
                wrong = np.nansum(a.variance + np.abs(leaked) ** 2, axis=0) / np.nansum(np.abs(a.value) ** 2, axis=0)
            total += float(np.nanmedian(wrong))
        if total < least:
            least, best = total, tried
        tried = tried // 4 * 2
    if not best:
        raise InputError(
            f"the records last {shortest * groups[0].dt:.3g} s at most: too short for {RULES.least_blocks} blocks that "
            "resolve the band; record longer, or take estimator out"
        )
    return best


def _with_leakage(g: Records, length: int, band: tuple[float, float], estimator: str) -> tuple[_Averaged, Complex]:
    """Return averages, and what half the length of a block makes different from them beyond noise."""
    whole = _averaged(g, length, band, estimator)
    half = _averaged(g, length // 2, (band[0] - 4.0 / (length * g.dt), band[1] + 4.0 / (length * g.dt)), estimator)
    step = np.empty_like(whole.value)
    for r in range(step.shape[1]):
        parts = (
            np.interp(whole.frequency, half.frequency, part) for part in (half.value[:, r].real, half.value[:, r].imag)
        )
        step[:, r] = whole.value[:, r] - np.sum(np.array(list(parts)) * np.array([[1.0], [1j]]), axis=0)
    noise = ndimage.uniform_filter1d(whole.variance, 9, axis=0, mode="nearest")
    clear = np.sqrt(np.maximum(1.0 - noise / np.maximum(np.abs(step) ** 2, 1e-300), 0.0))
    return whole, step * clear


def _averaged(g: Records, length: int, band: tuple[float, float], estimator: str) -> _Averaged:
    window = hann(length)
    hop = max(1, round(RULES.hop * length))
    frequency = fft.rfftfreq(length, g.dt)
    inside = (frequency >= band[0] - 1e-9) & (frequency <= band[1] + 1e-9)
    starts = [range(0, f.size - length + 1, hop) for f in g.force]
    count = sum(len(s) for s in starts)
    if count < 2:
        raise InputError(
            f"the records of excitation {g.axis} hold {count} blocks of {length * g.dt:.3g} s; choose a coarser "
            "resolution, or record longer"
        )
    force = np.concatenate(
        [_transforms(f, s, window, inside, g.dt) for f, s in zip(g.force, starts, strict=True)], axis=1
    )
    motion = np.stack(
        [
            np.concatenate(
                [_transforms(x[r], s, window, inside, g.dt) for x, s in zip(g.motion, starts, strict=True)], axis=1
            )
            for r in range(len(g.response))
        ],
        axis=1,
    )
    sff = np.mean(np.abs(force) ** 2, axis=1)
    plain = average(motion, force, "H1")
    rho = overlap_correlation(window, hop)
    m = np.arange(1, rho.size)
    shared = 1.0 + 2.0 * float(np.sum(np.maximum(1.0 - m / count, 0.0) * rho[1:] ** 2))
    # Exponential powers, as those of noise, count for half of the blocks that they are in.
    power = np.abs(force) ** 2
    holding = 2.0 * power.sum(axis=1) ** 2 / np.maximum((power**2).sum(axis=1), 1e-300)
    holding = ndimage.uniform_filter1d(holding, min(9, holding.size), mode="nearest")
    n = np.maximum(np.minimum(count, holding) / shared, 1.05)[:, None]
    g2 = np.clip(plain.coherence, 1e-12, 1.0)
    # The noise of the force in one block, at most what the response leaves unexplained anywhere.
    energy = float(window @ window) * g.dt
    bound = float(np.min(ndimage.median_filter(sff[:, None] * (1.0 - g2), size=(9, 1)))) / energy
    noise = float(np.mean(g.force_noise([2.0 * bound] * len(g.force)))) * energy
    lost = np.broadcast_to((noise / sff)[:, None], g2.shape)
    if estimator == "Hv":
        ratio = noise_ratio(motion, force, noise if g.noise_known else 0.5 * noise)
        value = average(motion, force, "Hv", ratio).compliance
        away = value - plain.compliance
        lost = np.maximum(lost, np.abs(away) / np.abs(value))
        charged = value * (0.2 if g.noise_known else 0.3) * lost / np.maximum(1.0 - lost, 0.1)
    elif estimator == "H2":
        # High by the noise of the response, of which no more is known than the coherence.
        value = average(motion, force, "H2").compliance
        charged = 0.6 * (1.0 - g2) * value
    else:
        value = plain.compliance
        charged = 0.6 * lost / np.maximum(1.0 - lost, 0.1) * value
    variance = np.abs(value) ** 2 * (1.0 - g2) / (g2 * (n - 1.0))
    return _Averaged(frequency[inside], value, variance, charged, np.broadcast_to(n, g2.shape), plain.coherence, lost)


def _transforms(samples: Real, starts: Sequence[int], window: Real, inside: NDArray[np.bool_], dt: float) -> Complex:
    out = [dt * fft.rfft((p - p.mean()) * window)[inside] for p in (samples[s : s + window.size] for s in starts)]
    return np.array(out, dtype=np.complex128).T if out else np.empty((int(inside.sum()), 0), np.complex128)


def _column(g: Records, a: _Averaged, leaked: Complex, length: int) -> Column:
    bias = 0.5 * leaked
    with np.errstate(invalid="ignore", divide="ignore"):
        unclaimed = np.asarray((np.abs(leaked) > RULES.leaked * np.abs(a.value)).any(axis=1))
    notes = [
        f"{np.median(a.blocks):.3g} independent averages of Hann blocks of {length * g.dt:.4g} s that overlap by two "
        "thirds"
    ]
    if unclaimed.any():
        notes.append(
            f"the blocks are too short for the damping in {in_words(a.frequency, unclaimed)}: half their length "
            f"changes the response by more than {100.0 * RULES.leaked:.0f} %; nothing is claimed there: choose a finer "
            "resolution and record longer, or take estimator out"
        )
    response = Response(
        a.value,
        a.variance + np.abs(a.charged) ** 2 + np.abs(bias) ** 2,
        a.charged**2 + bias**2,
        2.0 * (a.blocks - 1.0),
        a.coherence,
        a.lost,
        unclaimed,
        HANN_ERROR_LINES,
        tuple(notes),
    )
    return column_of(g, a.frequency, response)
