"""What turns with the spindle: taken out with an air cut, or used as the instrument that the passing of the teeth is.

What repeats with the spindle (an unbalance, a gear) is one more input: the transform of ``exp(j k angle)`` for each
order k of the spindle, the same in the cut and in the air, with a response that is smooth in frequency. An air cut
separates it from the response to the teeth; its uncertainty is then part of the least squares. The passing of the
teeth is also an instrument: forces replaced by their projection on its harmonics hold neither noise of their sensor nor
the answer of the cut to what else shakes the machine (two-stage least squares; joint input-output identification, Van
den Hof and Schrama 1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from process.errors import InputError
from process.types import Complex, Real
from smfe.identification.sweep.least_squares import Lines
from smfe.identification.sweep.passes import PreparedPass
from smfe.identification.sweep.rules import RULES


def spindle_waves(
    sweep: PreparedPass,
    orders: Sequence[float],
    reach: tuple[float, float],
    teeth: int | None = None,
    cut_only: bool = False,
) -> Complex:
    """Return transforms of ``exp(j k angle)`` at the lines of `whole_record`, shape (lines, orders).

    Parameters
    ----------
    sweep : PreparedPass
        With a record that holds the angle of the spindle.
    orders : sequence of float
        Orders k of the spindle.
    reach : (float, float)
        Band [Hz].
    teeth : int, optional
        Of the tool, where the angle is found from the force.
    cut_only : bool, optional
        Silent in the air.
    """
    dt, n = sweep.interval, sweep.record.sizes["time"]
    length = int(fft.next_fast_len(n, real=True))
    frequency = fft.rfftfreq(length, dt)
    low, high = np.searchsorted(frequency, [reach[0] - 1e-9, reach[1] + 1e-9])
    angle = sweep.angle(teeth)
    mask = sweep.cutting if cut_only else np.ones(n)
    return np.stack([dt * fft.fft(np.exp(1j * k * angle) * mask, length)[low:high] for k in orders], axis=1)


def orders_in_band(passes: Sequence[PreparedPass], frequency_range: tuple[float, float]) -> list[int]:
    """Return the orders of the spindle that pass through a band [Hz] in any of the records."""
    slowest, fastest = np.inf, 0.0
    for p in passes:
        angle = p.angle()
        rate = np.diff(angle[:: max(1, angle.size // 200)]) / (2.0 * np.pi)
        rate = rate / (p.interval * max(1, angle.size // 200))
        slowest, fastest = min(slowest, float(np.quantile(rate, 0.02))), max(fastest, float(np.quantile(rate, 0.98)))
    if not fastest > 0.0:
        raise InputError("the spindle does not turn in these records; check spindle_angle or spindle_speed")
    first = max(1, int(np.ceil(frequency_range[0] / fastest)))
    return list(range(first, int(frequency_range[1] / max(slowest, 1e-3 * fastest)) + 1))


# --- instruments ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Projection:
    """Which share of each block of lines a set of waves explains.

    Parameters
    ----------
    explained, rest : ndarray of complex, shape (lines, k)
        What the waves make of the signals, and what is left.
    rank : ndarray, shape (lines,)
        Number of waves times powers in the block of each line, over its number of lines.
    """

    explained: Complex
    rest: Complex
    rank: Real


def project(frequency: Real, signals: Complex, waves: Complex, block: float = RULES.instrument_block) -> Projection:
    """Project signals, block by block, on waves whose amplitude is a polynomial in frequency.

    Parameters
    ----------
    frequency : ndarray, shape (lines,)
        [Hz].
    signals : ndarray of complex, shape (lines, k)
        What is projected.
    waves : ndarray of complex, shape (lines, w)
        Silent ones are left out.
    block : float, optional
        Width of a block [Hz].
    """
    explained, rank = np.zeros_like(signals), np.zeros(frequency.size)
    largest = float(np.abs(waves).max(initial=1e-300))
    number = np.floor((frequency - frequency[0]) / block).astype(int)
    number = np.minimum(number, max(0, round((frequency[-1] - frequency[0]) / block) - 1))
    for i in range(int(number[-1]) + 1):
        at = np.flatnonzero(number == i)
        above_noise = np.abs(waves[at]).max(axis=0) > RULES.absent_order * largest
        if at.size == 0 or not above_noise.any():
            continue
        shift = 2.0 * (frequency[at] - frequency[at].mean()) / block
        terms = shift[:, None] ** np.arange(RULES.instrument_order + 1)
        z = (terms[:, :, None] * waves[at][:, None, above_noise]).reshape(at.size, -1)
        size = np.linalg.norm(z, axis=0)
        left, strength, _ = np.linalg.svd(z / np.where(size > 0.0, size, 1.0), full_matrices=False)
        basis = left[:, strength > 1e-6 * strength[0]]
        explained[at] = basis @ (basis.conj().T @ signals[at])
        rank[at] = basis.shape[1] / at.size
    return Projection(explained, signals - explained, rank)


def instrumented(lines: Lines, waves: Complex, forces: int, label: str) -> tuple[Lines, float]:
    """Return the lines with their forces projected on the waves, and which share of noise comes through.

    Raises
    ------
    InputError
        For a record with too few lines to separate waves from noise.
    """
    found = project(lines.frequency, lines.inputs[:, :forces], waves)
    share = float(found.rank.mean())
    if not share < 0.5:
        raise InputError(
            f"pass '{label}' is too short for the spindle as instrument: its harmonics have {100 * share:.0f} % of the "
            "unknowns of a block; sweep more slowly, or use all references without the instrument"
        )
    inputs = np.concatenate([found.explained, lines.inputs[:, forces:]], axis=1)
    return Lines(lines.frequency, inputs, lines.response), share


# --- noise from an air cut --------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Background:
    """Noise of an air cut, without what turns with the spindle, at some frequencies.

    Parameters
    ----------
    force : ndarray of complex, shape (f, e, e)
        ``E[conj(n_j) n_k]`` a second of record [N2 s2/s].
    shared : ndarray of complex, shape (f, e, r)
        ``E[conj(n_j) n_X]`` a second of record [N m s2/s].
    degrees_of_freedom : float
        Complex lines each is the mean of.
    """

    force: Complex
    shared: Complex
    degrees_of_freedom: float


def background_noise(records: Sequence[tuple[Lines, float]], forces: int, at: Real, reach: float = 4.0) -> Background:
    """Return the noise of air cuts.

    Parameters
    ----------
    records : sequence of (Lines, float)
        Lines with the forces first and the spindle waves behind them, and the length of the record [s].
    forces : int
        How many inputs are forces.
    at : ndarray, shape (f,)
        Frequencies [Hz].
    reach : float, optional
        Half of the band of the mean [Hz].
    """
    rest, where, scale = [], [], []
    for lines, length in records:
        signals = np.concatenate([lines.inputs[:, :forces], lines.response], axis=1)
        waves = lines.inputs[:, forces:]
        found = project(lines.frequency, signals, waves)
        rest.append(found.rest / np.sqrt(np.maximum(1.0 - found.rank, 0.1) * length)[:, None])
        where.append(lines.frequency)
        scale.append(lines.frequency.size)
    noise, frequency = np.concatenate(rest), np.concatenate(where)
    product = noise[:, :forces, None].conj() * noise[:, None, :]
    mean = np.empty((at.size, forces, noise.shape[1]), dtype=complex)
    count = np.empty(at.size)
    for i, f in enumerate(at):
        near = np.abs(frequency - f) <= reach
        if not near.any():
            near = np.abs(frequency - f) <= np.abs(frequency - f).min()
        mean[i], count[i] = product[near].mean(axis=0), near.sum()
    return Background(mean[..., :forces], mean[..., forces:], float(count.min()))
