"""The funnel: every record becomes block spectra of force and displacement here, and only here.

An acceleration becomes a displacement in this file (``X = -A/w^2``) and in no other, so that the conversion happens
once for every method, :eq:`compliance`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy import fft, signal

from process.errors import InputError
from process.labels import axis_index, axis_present, sample_interval
from process.types import Complex, Real
from process.units import displacement_over_acceleration


@dataclass(frozen=True)
class BlockSpectra:
    """Fourier transforms of blocks of a record.

    Parameters
    ----------
    frequency : ndarray, shape (f,)
        Frequency [Hz].
    displacement : ndarray of complex, shape (f, responses, blocks)
        Transform of the displacement [m s].
    force : ndarray of complex, shape (f, excitations, blocks)
        Transform of the force [N s].
    response, excitation : tuple of str
        Axis names of the rows.
    neighbour_correlation : ndarray, shape (lags,)
        Correlation of white noise between blocks 0, 1, 2, ... apart that the overlap brings; begins with 1. Between
        the transforms of blocks a and b it is multiplied by ``exp(j w hop (a - b))``.
    hop : float
        Time from one block to the next [s].
    """

    frequency: Real
    displacement: Complex
    force: Complex
    response: tuple[str, ...]
    excitation: tuple[str, ...]
    neighbour_correlation: Real
    hop: float


def motion_axes(record: xr.Dataset) -> tuple[str, list[str]]:
    """Return the motion channel with the most axes ("displacement" where both have as many), and these axes."""
    found = {channel: axis_present(record, channel) for channel in ("displacement", "acceleration")}
    channel = max(found, key=lambda name: len(found[name]))
    if found[channel]:
        return channel, found[channel]
    raise InputError("the record holds neither acceleration nor displacement; declare one in [channels]")


def as_displacement(spectrum: Complex, frequency: Real, channel: str) -> Complex:
    """Turn transforms of a motion channel into transforms of displacement.

    Parameters
    ----------
    spectrum : ndarray of complex, shape (f, ...)
        Transform of the channel.
    frequency : ndarray, shape (f,)
        Frequency [Hz]; at 0 Hz a displacement from an acceleration is NaN.
    channel : {"acceleration", "displacement"}
        What the transform is of.
    """
    if channel == "displacement":
        return spectrum
    scale = displacement_over_acceleration(frequency)
    return spectrum * scale.reshape((-1,) + (1,) * (spectrum.ndim - 1))


def block_spectra(
    record: xr.Dataset,
    starts: Sequence[int],
    length: int,
    window: Real | None = None,
    frequency_range: tuple[float, float] | None = None,
    detrend: bool = True,
    response: Sequence[str] | None = None,
    padded: int | None = None,
) -> BlockSpectra:
    """Transform blocks of a record.

    Parameters
    ----------
    record : xarray.Dataset
        A record with ``force`` and a motion channel.
    starts : sequence of int
        First sample of each block; equally spaced blocks are assumed for the overlap correlation.
    length : int
        Samples a block.
    window : ndarray, shape (length,), optional
        Default: rectangular.
    frequency_range : (float, float), optional
        Keep only these frequencies [Hz].
    detrend : bool, optional
        Remove the mean of each block first, so that an offset does not leak through the window.
    response : sequence of str, optional
        Axes of motion to transform, in this order. Default: all that were recorded.
    padded : int, optional
        Samples with rest behind each block, for a length that transforms fast; default: none.

    Raises
    ------
    InputError
        When the record holds no force or no motion, or a block does not fit.
    """
    excitation = axis_present(record, "force")
    if not excitation:
        raise InputError("the record holds no force; declare force_x, force_y or force_z in [channels]")
    channel, recorded = motion_axes(record)
    moving = recorded if response is None else list(response)
    n = record.sizes["time"]
    if not len(starts) or min(starts) < 0 or max(starts) + length > n:
        raise InputError(f"a record of {n} samples cannot hold a block of {length} samples where it is asked for")
    dt = sample_interval(record)
    total = length if padded is None else padded
    frequency = fft.rfftfreq(total, dt)
    keep = slice(None)
    if frequency_range is not None:
        low, high = np.searchsorted(frequency, [frequency_range[0] - 1e-9, frequency_range[1] + 1e-9])
        keep = slice(int(low), int(high))
    taper = np.ones(length) if window is None else window

    def transform(name: str, axes: list[str]) -> Complex:
        out = np.empty((frequency[keep].size, len(axes), len(starts)), dtype=complex)
        # One channel at a time: a long record has no room for three and their transforms.
        for row, axis in enumerate(axes):
            samples = record[name].sel(axis=axis).values
            for b, start in enumerate(starts):
                piece = samples[start : start + length]
                if detrend:
                    piece = piece - piece.mean()
                out[:, row, b] = dt * fft.rfft(piece if window is None else piece * taper, total)[keep]
        return out

    hop = int(starts[1] - starts[0]) if len(starts) > 1 else length
    return BlockSpectra(
        frequency=frequency[keep],
        displacement=as_displacement(transform(channel, moving), frequency[keep], channel),
        force=transform("force", excitation),
        response=tuple(moving),
        excitation=tuple(excitation),
        neighbour_correlation=overlap_correlation(taper, hop),
        hop=hop * dt,
    )


def overlap_correlation(window: Real, hop: int) -> Real:
    """Return the correlation of white noise between windowed blocks 0, 1, 2, ... hops apart.

    ``rho_m = sum_n w(n) w(n + m hop) / sum_n w(n)^2``; for Hann blocks that overlap by half it is (1, 1/6).
    """
    energy = float(window @ window)
    lags = range(0, window.size, max(hop, 1))
    return np.array([float(window[: window.size - lag] @ window[lag:]) / energy for lag in lags])


def hann(length: int) -> Real:
    """Return the periodic Hann window."""
    window: Real = signal.get_window("hann", length, fftbins=True)
    return window


def check_records(name: str, records: Mapping[str, Sequence[xr.Dataset]]) -> None:
    """Refuse a measurement without records, on an unknown axis, or whose records lack force or motion.

    Raises
    ------
    InputError
        With the measurement, the excitation axis and the record in the sentence.
    """
    if not any(len(group) for group in records.values()):
        raise InputError(f"measurement '{name}' has no records; give at least one for an excitation axis")
    axis_index(list(records))
    for excitation, group in records.items():
        for number, record in enumerate(group):
            force_samples(record, excitation, record_source(record, number))
            motion_axes(record)


def force_samples(record: xr.Dataset, excitation: str, source: str = "the record") -> Real:
    """Return the force [N] along `excitation`, shape (time,); `InputError` when it was not recorded."""
    present = axis_present(record, "force")
    if excitation not in present:
        found = ", ".join(f"force_{axis}" for axis in present) or "no force"
        raise InputError(
            f"{source} was excited along {excitation} but holds {found}; "
            f"declare force_{excitation} in [channels] or correct the excitation of the record"
        )
    samples: Real = record["force"].sel(axis=excitation).values
    return samples


def record_source(record: xr.Dataset, number: int) -> str:
    """Return the file of a record (``attrs["file"]`` or ``attrs["source"]``), else "record 1" and so on."""
    return str(record.attrs.get("file", record.attrs.get("source", f"record {number + 1}")))
