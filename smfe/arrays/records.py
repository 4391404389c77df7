"""Arrays -> a labelled record, and records in memory -> the measurement that a campaign file would declare of them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process import units
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import AXES, axis_present, check_record, make_record
from process.types import Real
from smfe.arrays.tables import tool_table
from smfe.campaign import Campaign, Measurement, campaign_of_tables
from smfe.campaign.methods import COMPLIANCE_METHODS, METHODS
from smfe.records.formats.channels import RECORD_CHANNELS, Channel, check_channel_name, listed, split_vector

Signal = ArrayLike | tuple[ArrayLike, str] | str
"""Samples in SI (a spindle speed in rpm), samples with their unit, or one quantity that holds all along."""

_LENGTHS = ("width_of_cut", "depth_of_cut", "feed_per_tooth")
_OF_RECORDS = ("excitation", "cut", *_LENGTHS)
"""What a record may say of itself; the rest is said of a measurement."""


def record(
    sample_rate: float | str | None = None,
    *,
    time: ArrayLike | None = None,
    name: str = "record",
    excitation: str | None = None,
    cut: str | None = None,
    width_of_cut: float | str | None = None,
    depth_of_cut: float | str | None = None,
    feed_per_tooth: float | str | None = None,
    pulses_per_revolution: float | None = None,
    **channels: Signal,
) -> xr.Dataset:
    """Make a labelled record of arrays.

    Parameters
    ----------
    sample_rate : float or str, optional
        [Hz], or text with a unit, "51.2 kHz".
    time : array_like, shape (n,), optional
        Times of the samples [s], evenly spaced; instead of a sample rate.
    name : str, optional
        What the record is called in tables and messages.
    excitation : str, optional
        Axis of the hammer or actuator. Default: the axis of the only force.
    cut : {"down", "up", "central"}, optional
        Kind of cut.
    width_of_cut, depth_of_cut, feed_per_tooth : float or str, optional
        [m], or text with a unit, "40 mm".
    pulses_per_revolution : float, optional
        Of the channel ``tacho``.
    **channels : array_like of shape (n,), (array_like, str), str or float
        Channels by the names that a campaign file has for them: ``force_x``, ``acceleration_y``, ``sound``,
        ``spindle_speed``, ... Arrays are SI (a spindle speed rpm); with a unit, ``(a, "g")``, they are converted. One
        number or text, ``spindle_speed="950 rpm"``, holds all along.

    Returns
    -------
    xarray.Dataset
        Record over ``time`` [s] with e.g. ``force(axis, time)`` [N]; what was said of the cut stands in its
        attributes.

    Raises
    ------
    InputError
        For a channel or unit that is not known, arrays of different length, or samples that are not finite.

    Examples
    --------
    >>> tap = record(51200, force_x=[0.0, 1.0, 0.0], acceleration_x=([0.0, 0.1, 0.0], "g"))
    """
    for channel in channels:
        if check_channel_name(channel) not in RECORD_CHANNELS or channel == "time":
            raise InputError(f"'{channel}' is no channel of a record; a compliance is made by smfe.compliance")
    values = {n: _numbers(n, signal) for n, signal in channels.items()}
    sizes = {n: v.size for n, v in values.items() if v.ndim}
    if not sizes:
        raise InputError("a record needs one channel at least that is an array, e.g. force_x=..., acceleration_x=...")
    size = next(iter(sizes.values()))
    if set(sizes.values()) != {size}:
        raise InputError(f"channels of one record have one length: {', '.join(f'{n} {s}' for n, s in sizes.items())}")
    clock = _clock(sample_rate, time, size)
    vectors: dict[str, dict[str, Real]] = {}
    scalars: dict[str, Real] = {}
    for channel, numbers in values.items():
        vector = split_vector(channel)
        if vector is None:
            scalars[channel] = np.broadcast_to(numbers, size).copy()
        else:
            vectors.setdefault(vector[0], {})[vector[1]] = np.broadcast_to(numbers, size).copy()
    attrs: dict[str, Any] = {"source": name}
    attrs |= {k: v for k, v in (("excitation", excitation), ("cut", cut)) if v is not None}
    for key, value in zip(_LENGTHS, (width_of_cut, depth_of_cut, feed_per_tooth), strict=True):
        if value is not None:
            attrs[f"{key}_mm"] = units.from_si(units.si(value, "length"), "mm", "length")
    found = make_record(clock, vectors, scalars, attrs)
    if pulses_per_revolution is not None and "tacho" in found:
        found["tacho"].attrs["pulses_per_revolution"] = pulses_per_revolution
    return found


def _clock(sample_rate: float | str | None, time: ArrayLike | None, size: int) -> Real:
    if (sample_rate is None) == (time is None):
        raise InputError("a record needs a sample_rate in Hz, or the time of each sample in s; give one of both")
    if time is not None:
        return np.asarray(time, dtype=float)
    assert sample_rate is not None
    rate = units.si(sample_rate, "frequency")
    if not 0.0 < rate < math.inf:
        raise InputError(f"a sample rate of {rate:g} Hz; it must be positive and finite")
    return np.arange(size) / rate


def _numbers(name: str, signal: Signal) -> Real:
    """Return a channel in the unit of its label; one number is an array without dimension."""
    if isinstance(signal, str):
        value = units.parse(signal, RECORD_CHANNELS[name])
        return np.asarray(units.from_si(value, "rpm", "rotation") if name == "spindle_speed" else value)
    unit = None
    if isinstance(signal, tuple) and len(signal) == 2 and isinstance(signal[1], str):
        signal, unit = signal
    try:
        numbers = np.asarray(signal, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"channel {name} is no array of numbers ({error})") from error
    if numbers.ndim > 1:
        raise InputError(f"channel {name} has the shape {numbers.shape}; give each axis a channel of its own")
    return numbers if unit is None else Channel(unit=unit).to_si(name, numbers)


Records = xr.Dataset | Sequence[xr.Dataset] | Mapping[str, xr.Dataset | Sequence[xr.Dataset]]
"""One record, several, or records by the axis that was excited."""


def measured(
    records: Records, method: str, tool: Tool | Mapping[str, Any] | None, name: str, settings: Mapping[str, Any]
) -> tuple[Campaign, Measurement]:
    """Return records in memory as the one measurement of a campaign.

    Parameters
    ----------
    records : Records
        What was recorded.
    method : str
        "hammer", "actuator" or "sweep".
    tool : Tool or mapping, optional
        For a sweep.
    name : str
        Of the measurement.
    settings : mapping
        Further keys of a ``[[measurement]]``, e.g. ``frequency_range``; numbers are SI.

    Raises
    ------
    InputError
        Where a campaign file would be refused.
    """
    possible = [m for m in COMPLIANCE_METHODS if m != "frf"]
    if method not in possible:
        other = "averaged responses are made a compliance by smfe.compliance" if method == "frf" else ""
        other = other or "drives: smfe.fit_friction_record, smfe.fit_open_loop, smfe.open_loop_response"
        why = "gives no compliance" if method in METHODS else "is not known"
        raise InputError(f"method '{method}' {why} of records in memory; available: {', '.join(possible)}; {other}")
    held: dict[str, list[xr.Dataset]] = {}
    entries: list[dict[str, str]] = []
    for axis, found in _by_axis(records):
        for one in found:
            key = f"record {len(entries) + 1}"
            held[key] = [check_record(one)]
            said = {k: one.attrs[k] for k in ("excitation", "cut") if k in one.attrs}
            said |= {k: f"{one.attrs[f'{k}_mm']!r} mm" for k in _LENGTHS if f"{k}_mm" in one.attrs}
            if method == "sweep":
                said.pop("excitation", None)
            else:
                said = {"excitation": axis or said.get("excitation") or _only_force(one)}
            entries.append({"file": key, **said})
    table = {"name": name, "method": method, "records": entries, **settings}
    tables: dict[str, Any] = {"measurement": [table]}
    if tool is not None:
        tables["tool"] = tool_table(tool)
    campaign = campaign_of_tables(tables, held, name)
    return campaign, campaign.measurements[0]


def _by_axis(records: Records) -> list[tuple[str, list[xr.Dataset]]]:
    if isinstance(records, xr.Dataset):
        return [("", [records])]
    if not isinstance(records, Mapping):
        return [("", _datasets(list(records)))]
    unknown = [str(axis) for axis in records if axis not in AXES]
    if unknown:
        raise InputError(f"records are given by the axis excited, x, y or z, not {listed(unknown)}")
    return [(str(a), _datasets([r] if isinstance(r, xr.Dataset) else list(r))) for a, r in records.items()]


def _datasets(found: list[xr.Dataset]) -> list[xr.Dataset]:
    for one in found:
        if not isinstance(one, xr.Dataset):
            raise InputError(f"{type(one).__name__} is no record; make one of arrays with smfe.record")
    return found


def _only_force(one: xr.Dataset) -> str:
    forces = axis_present(one, "force")
    if len(forces) != 1:
        raise InputError(
            f"{one.attrs.get('source', 'the record')} holds {len(forces)} forces ({', '.join(forces) or 'none'}); say "
            'which axis was excited: smfe.record(..., excitation="x") or smfe.identify({"x": record})'
        )
    return forces[0]
