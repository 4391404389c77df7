"""Long records at a lower sample rate: low-pass filtered and decimated while they are read.

Filter: a Kaiser-windowed sinc of ``36 factor + 1`` coefficients, symmetric, so that its delay is a whole number of
samples and is removed. With beta = 11.3 ripple and stop band are at 111 dB (Oppenheim and Schafer, Discrete-Time Signal
Processing, 3rd ed., 7.5.3): flat within 3e-6 up to 0.4 of the new sample rate, below -110 dB from 0.6 of it, so that
what folds back meets nothing below 0.4.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import xarray as xr
from scipy import signal

from process.errors import InputError
from process.types import Real
from smfe.records.blocks import BLOCK, Samples, Stream, streams
from smfe.records.formats.channels import Channel, split_vector
from smfe.records.read import own_table, read_records

PASS_BAND = 0.4
"""Share of the reduced sample rate up to which a reduced record is that of the file."""

_SPANS = 36
_BETA = 11.3
_WORTH_IT = 2.5


def read_reduced(
    path: str | Path, channels: Mapping[str, Channel], highest_frequency: float, block: int = BLOCK
) -> list[xr.Dataset]:
    """Read the records of a file at the lowest sample rate that holds a band.

    Parameters
    ----------
    path : str or Path
        A file that `read_records` reads.
    channels : mapping of str to Channel
        As for `read_records`.
    highest_frequency : float
        Up to here [Hz] every channel is what the file holds, within 3e-6.
    block : int, optional
        Samples that are read at a time; without influence on the result.

    Returns
    -------
    list of xarray.Dataset
        As of `read_records`, one a segment. The sample rate is the file's divided by a whole number, and at least 2.5
        times `highest_frequency`; a file whose rate is less than 2.5 times that is read as it is. A reduced record
        begins with the first sample of the file and states the rate it was reduced from in
        ``attrs["reduced_from_Hz"]``. Beyond both ends forces and vibrations are taken for zero, as a Fourier transform
        of the record takes them, and other channels are continued by point reflection; that touches the first and last
        18 samples, and of a record that begins and ends at rest none.

    Raises
    ------
    InputError
        As `read_records`; for a frequency that is not positive, and for a tacho, whose pulses a filter would smear.
    """
    if not highest_frequency > 0.0:
        raise InputError(f"a highest frequency of {highest_frequency:g} Hz; it must be positive")
    found = []
    for stream in streams(path, channels, block):
        if "tacho" in stream.channels:
            raise InputError(
                f"{stream.source}: a tacho cannot be read at a lower sample rate, its pulses would be smeared; leave "
                "the channel out"
            )
        reduced = _reduced(stream, highest_frequency)
        if reduced is None:
            return read_records(path, channels)
        found.append(reduced)
    return found


def reduced(record: xr.Dataset, highest_frequency: float) -> xr.Dataset:
    """Return a record in memory at the lowest sample rate that holds a band, as `read_reduced` does a file.

    Parameters
    ----------
    record : xarray.Dataset
        A record; a tacho in it is left out.
    highest_frequency : float
        Up to here [Hz] every channel is what the record holds, within 3e-6.
    """
    whole = record.drop_vars("tacho", errors="ignore")
    table, channels = own_table(whole, {})
    samples = {str(name): values for name, values in table.columns.items()}
    found = _reduced(
        Stream(str(record.attrs.get("source", "record")), channels, iter([samples]), record.attrs), highest_frequency
    )
    return whole if found is None else found


def reduction(rate: float, highest_frequency: float) -> int:
    """Return by which whole number a sample rate may be divided for a band; 1 where it is not worth it.

    A divisor of a rate in whole hertz is preferred, so that the reduced rate is in whole hertz too.
    """
    rate = float(f"{rate:.6g}")  # a clock written with few digits must not decide
    most = int(rate * PASS_BAND / highest_frequency * (1.0 + 1e-9))
    if most < _WORTH_IT:
        return 1
    if rate == round(rate):
        whole = [factor for factor in range(most, most // 2, -1) if round(rate) % factor == 0]
        most = next(iter(whole), most)
    return most


def low_pass(factor: int) -> Real:
    """Return the coefficients of the filter before a decimation by `factor`; their sum is 1."""
    half = _SPANS * factor // 2
    taps = np.sinc(np.arange(-half, half + 1) / factor) * signal.windows.kaiser(2 * half + 1, _BETA)
    return np.asarray(taps / taps.sum())


def _reduced(stream: Stream, highest_frequency: float) -> xr.Dataset | None:
    """Return the reduced record of a segment; None where it is too short or its rate too low."""
    first = next(stream.blocks)
    time = first["time"]
    if time.size < 2:
        return None
    rate = (time.size - 1) / float(time[-1] - time[0])
    factor = reduction(rate, highest_frequency)
    if factor == 1:
        return None
    parts = list(_decimated(first, stream.blocks, factor))
    if sum(part["time"].size for part in parts) < 2:
        return None
    # Channel by channel, so that what is returned is never there twice.
    samples = {name: np.concatenate([part.pop(name) for part in parts]) for name in list(parts[0])}
    return stream.record(samples).assign_attrs(reduced_from_Hz=rate)


def _decimated(first: Samples, blocks: Iterator[Samples], factor: int) -> Iterator[Samples]:
    """Yield every `factor`-th sample of the filtered channels; nothing for a record shorter than half the filter."""
    taps = low_pass(factor)
    half = taps.size // 2
    held = first
    while held["time"].size <= half:
        if (more := next(blocks, None)) is None:
            return
        held = _joined(held, more)
    held = {name: np.concatenate([_beyond(name, v, half)[::-1], v]) for name, v in held.items()}
    while True:
        count = (held["time"].size - taps.size) // factor + 1
        if count > 0:
            yield {name: _filtered(name, values, taps, factor, count) for name, values in held.items()}
            held = {name: values[count * factor :] for name, values in held.items()}
        if (more := next(blocks, None)) is None:
            break
        held = _joined(held, more)
    held = {name: np.concatenate([v, _beyond(name, v[::-1], half)]) for name, v in held.items()}
    count = (held["time"].size - taps.size) // factor + 1
    if count > 0:
        yield {name: _filtered(name, values, taps, factor, count) for name, values in held.items()}


def _beyond(name: str, values: Real, count: int) -> Real:
    """Return what lies before the first sample, the nearest first."""
    vector = split_vector(name)
    if vector is not None and vector[0] in ("force", "acceleration", "displacement"):
        return np.zeros(count)
    return np.asarray(2.0 * values[0] - values[1 : count + 1])


def _joined(held: Samples, more: Samples) -> Samples:
    return {name: np.concatenate([values, more[name]]) for name, values in held.items()}


def _filtered(name: str, values: Real, taps: Real, factor: int, count: int) -> Real:
    if name == "time":
        return values[taps.size // 2 :: factor][:count].copy()
    # The first coefficient of the convolution that lies within the record is number taps.size - 1 = _SPANS factor.
    return np.asarray(signal.upfirdn(taps, values, 1, factor)[_SPANS : _SPANS + count])
