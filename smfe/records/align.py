"""Channels that come late: shifted back by a fraction of a sample."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr

from process.errors import InputError
from process.labels import sample_interval
from process.types import Real
from smfe.records.formats.channels import split_vector

HALF = 32
_BETA = 10.0


def align(record: xr.Dataset, delay: Mapping[str, float]) -> xr.Dataset:
    """Undo the delays of channels: ``value(t) = recorded(t + delay)``.

    Band-limited interpolation (see `shift`), not linear: linear interpolation damps by ``cos(w dt/2)`` half-way
    between two samples, 5 % at a tenth of the sample rate, and would so bias every compliance. The record loses the
    samples at its ends for which a channel has no data any more; nothing is invented.

    Parameters
    ----------
    record : xarray.Dataset
        A record.
    delay : mapping of str to float
        Channel ("force_x", "spindle_angle") -> delay [s], positive when the channel comes late.

    Raises
    ------
    InputError
        When a delay is as long as the record.
    """
    late = {name: value for name, value in delay.items() if value != 0.0}
    if not late:
        return record
    dt = sample_interval(record)
    size = record.sizes["time"]
    first = max(0, *(math.ceil(-value / dt - 1e-9) for value in late.values()))
    last = size - max(0, *(math.ceil(value / dt - 1e-9) for value in late.values()))
    if last - first < 2:
        name, value = max(late.items(), key=lambda item: abs(item[1]))
        raise InputError(
            f"the delay of {name}, {value:g} s, is as long as the record of {size * dt:g} s; check its unit"
        )
    out = record.isel(time=slice(first, last)).copy(deep=True)
    for name, value in late.items():
        vector = split_vector(name)
        where = {} if vector is None else {"axis": vector[1]}
        variable = name if vector is None else vector[0]
        samples = record[variable].sel(where).values
        out[variable].loc[where] = shift(samples, value / dt, first, last)
    return out


def shift(samples: Real, by: float, first: int, last: int) -> Real:
    """Return ``x(n + by)`` for n = first .. last - 1 from samples ``x(0), x(1), ...``.

    A Kaiser-windowed sinc over 65 samples, with its sum set to one: exact for whole samples and for a constant;
    the error is below 1e-4 up to 0.8 of the Nyquist frequency, and a ramp is off by about 1e-4 of a sample. Beyond
    both ends the samples are continued by point reflection, which touches the first and last 32 only.
    """
    whole = round(by)
    fraction = by - whole
    if abs(fraction) > 1e-9:
        half = min(HALF, samples.size - 1)
        at = fraction - np.arange(-half, half + 1)
        inside = np.clip(1.0 - (at / (half + 0.5)) ** 2, 0.0, None)
        weights = np.sinc(at) * np.i0(_BETA * np.sqrt(inside))
        padded = np.pad(samples, half, mode="reflect", reflect_type="odd")
        samples = np.correlate(padded, weights / weights.sum(), mode="valid")
    index = np.clip(np.arange(first, last) + whole, 0, samples.size - 1)
    shifted: Real = samples[index]
    return shifted
