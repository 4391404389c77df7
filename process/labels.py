"""Vocabulary: dimension names, units, sign convention, and the checks for labelled arrays.

Conventions (docs/conventions.md): ``exp(+j w t)``; forces act on the tool; x is the feed direction, z the tool
axis pointing away from the workpiece; a tooth angle is measured from +y towards +x.

Shop-floor quantities carry shop units in labels (`SHOP_UNITS`); everything else is SI.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from process.errors import InputError
from process.types import Complex, Real

if TYPE_CHECKING:
    import xarray as xr

AXES: tuple[str, str, str] = ("x", "y", "z")

SHOP_UNITS: dict[str, str] = {
    "spindle_speed": "rpm",
    "feed": "mm/min",
    "depth_of_cut": "mm",
    "width_of_cut": "mm",
    "feed_per_tooth": "mm",
    "limit_depth": "mm",
    "limit_depth_quantile": "mm",
    "safe_depth": "mm",
}
"""Labels that show shop units, so that ``.sel(feed=500)`` works."""

SI_UNITS: dict[str, str] = {
    "time": "s",
    "frequency": "Hz",
    "chatter_frequency": "Hz",
    "force": "N",
    "drive_force": "N",
    "acceleration": "m/s^2",
    "displacement": "m",
    "encoder_position": "m",
    "reference_position": "m",
    "encoder_speed": "m/s",
    "reference_speed": "m/s",
    "encoder_angle": "rad",
    "encoder_rotation": "rad/s",
    "drive_torque": "N m",
    "spindle_angle": "rad",
    "tacho": "1",
    "sound": "Pa",
    "compliance": "m/N",
    "compliance_std": "m/N",
    "compliance_covariance": "m^2/N^2",
    "entry_covariance": "m^2/N^2",
    "compliance_relation": "m^2/N^2",
    "deviation": "m/N",
    "degrees_of_freedom": "1",
    "coherence": "1",
    "force_condition": "1",
    "force_spectrum": "N s",
    "force_level": "N",
    "half_width": "Hz",
    "quantile": "1",
    "lobe": "1",
    "loop_response": "1",
    "loop_response_std": "1",
}

UNITS: dict[str, str] = {**SHOP_UNITS, **SI_UNITS}
"""Name of a variable or coordinate -> the unit its values are in."""

RECORD_VECTORS: tuple[str, ...] = (
    "force",
    "acceleration",
    "displacement",
    "encoder_position",
    "drive_force",
    "reference_position",
    "encoder_speed",
    "reference_speed",
    "encoder_angle",
    "encoder_rotation",
    "drive_torque",
)
"""Channels of a record with one component an axis."""

RECORD_SCALARS: tuple[str, ...] = ("spindle_angle", "spindle_speed", "tacho", "sound")
"""Channels of a record without an axis."""


def label(dataset: xr.Dataset) -> xr.Dataset:
    """Set ``attrs["units"]`` of every variable and coordinate of the vocabulary."""
    for name in [*dataset.data_vars, *dataset.coords]:
        if str(name) in UNITS:
            dataset[name].attrs["units"] = UNITS[str(name)]
    return dataset


def axis_index(names: Sequence[str]) -> list[int]:
    """Return the position of each axis name in `AXES`."""
    unknown = [name for name in names if name not in AXES]
    if unknown:
        raise InputError(f"axis {unknown[0]!r} is none of {', '.join(AXES)}")
    return [AXES.index(name) for name in names]


def place_text(text: str) -> str:
    """Return a place and direction in its usual form: ``" 21 : +X"`` -> ``"21:x"``, ``"-X"`` -> ``"-x"``.

    Raises
    ------
    InputError
        When it is neither an axis nor ``NODE:axis``.
    """
    node, colon, direction = (part.strip() for part in text.rpartition(":"))
    axis = direction.lower().removeprefix("+")
    if axis.removeprefix("-") not in AXES or "/" in node or bool(node) != bool(colon):
        if not colon:
            raise InputError(f"axis {text!r} is not known; available: {', '.join(AXES)}, or a node and an axis, '21:x'")
        raise InputError(
            f"{text!r} is no place; write an axis at the tool tip, 'x', or a node and an axis, '21:x' or '21:-x'"
        )
    return f"{node}:{axis}" if node else axis


def at_tool(compliance: xr.Dataset) -> xr.Dataset:
    """Return the part of a compliance that is between axes at the tool tip, without places that have a node.

    Raises
    ------
    InputError
        When nothing is left.
    """
    names = {dim: [str(a) for a in compliance[dim].values] for dim in ("response", "excitation")}
    if all(name in AXES for every in names.values() for name in every):
        return compliance
    here = {dim: [name for name in every if name in AXES] for dim, every in names.items()}
    if not all(here.values()):
        raise InputError(
            f"this compliance is between {', '.join(dict.fromkeys(names['response'] + names['excitation']))}; a "
            "stability limit needs the tool tip: call its motions and forces x, y and z"
        )
    return compliance.sel(here)


def make_record(
    time: ArrayLike,
    vectors: Mapping[str, Mapping[str, ArrayLike]],
    scalars: Mapping[str, ArrayLike] | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Assemble a record.

    Parameters
    ----------
    time : array_like, shape (n,)
        Time [s].
    vectors : mapping
        Channel name (a member of `RECORD_VECTORS`) -> axis -> samples, shape (n,), SI.
        An axis that one channel has and another lacks is filled with NaN in the latter.
    scalars : mapping, optional
        Channel name (a member of `RECORD_SCALARS`) -> samples, shape (n,).
    attrs : mapping, optional
        Attributes of the record.

    Returns
    -------
    xarray.Dataset
        Variables over ``(axis, time)`` and ``(time,)`` with units.

    Raises
    ------
    InputError
        For an axis that is not known, samples of another shape than the time, or what `check_record` refuses.
    """
    t = np.asarray(time, dtype=float)
    present = [a for a in AXES if any(a in channel for channel in vectors.values())]
    data: dict[str, Any] = {}
    for name, channel in vectors.items():
        axis_index(list(channel))
        values = np.full((len(present), t.size), np.nan)
        for row, axis in enumerate(present):
            if axis in channel:
                values[row] = _as_long_as(t, channel[axis], f"{name}_{axis}")
        data[name] = (("axis", "time"), values)
    for name, samples in (scalars or {}).items():
        data[name] = (("time",), _as_long_as(t, samples, name))
    import xarray as xr  # half a second, which those who want the names alone do not need

    record = xr.Dataset(data, coords={"time": t, "axis": present}, attrs=dict(attrs or {}))
    return check_record(label(record))


def _as_long_as(time: Real, samples: ArrayLike, name: str) -> Real:
    values = np.asarray(samples, dtype=float)
    if time.ndim != 1 or values.shape != time.shape:
        raise InputError(
            f"channel {name} has the shape {values.shape}, the time {time.shape}; give one sample for each time"
        )
    return values


def check_record(record: xr.Dataset) -> xr.Dataset:
    """Return the record when it is one, else raise.

    Raises
    ------
    InputError
        For an empty record, a time axis that is not uniform and rising, an unknown channel or axis, or NaN in an
        axis that is only partly there.
    """
    if "time" not in record.dims or record.sizes["time"] < 2:
        raise InputError(f"the record has {record.sizes.get('time', 0)} samples; at least 2 are needed")
    sample_interval(record)
    if "axis" in record.coords:
        axis_index([str(a) for a in record["axis"].values])
    for name in record.data_vars:
        if str(name) not in (*RECORD_VECTORS, *RECORD_SCALARS):
            known = ", ".join((*RECORD_VECTORS, *RECORD_SCALARS))
            raise InputError(f"channel '{name}' is not known; a record holds: {known}")
        _check_finite(record[name])
    return record


def _check_finite(channel: xr.DataArray) -> None:
    """Refuse NaN and infinity, but let an axis be absent as a whole."""
    rows = channel.transpose(..., "time").values.reshape(-1, channel.sizes["time"])
    names = channel["axis"].values if "axis" in channel.dims else [None]
    for axis, row in zip(names, rows, strict=True):
        # What is not finite shows in the extremes.
        if row.size == 0 or (np.isfinite(row.min()) and np.isfinite(row.max())):
            continue
        bad = ~np.isfinite(row)
        if not np.isnan(row).all():
            where = int(np.argmax(bad))
            what = f"{channel.name}_{axis}" if axis is not None else str(channel.name)
            raise InputError(
                f"channel {what} has {int(bad.sum())} values that are not finite, the first at sample {where} "
                f"(t = {float(channel['time'][where]):.6g} s); repair or cut the record"
            )


def sample_interval(record: xr.Dataset) -> float:
    """Return the sampling interval [s] of a record with a uniform, rising time axis."""
    t = record["time"].values
    steps = np.diff(t)
    # Times that rise are finite where the first and the last are.
    if not (steps.min(initial=np.inf) > 0.0 and np.isfinite(t[0]) and np.isfinite(t[-1])):
        where = int(np.argmax(~(steps > 0.0)))
        said = f"time does not rise at sample {where + 1}: {t[where]:.9g} s, then {t[where + 1]:.9g} s"
        if (rate := restarting_rate(t)) is not None:
            said += (
                "; it begins anew there, as in blocks of a triggered recorder one after another: save each block as a "
                f'file, or, where each has come to rest, declare time = {{ sample_rate = "{rate:.10g} Hz" }}'
            )
        raise InputError(said)
    mean = float((t[-1] - t[0]) / (t.size - 1))
    # Text files carry few digits: the *accumulated* departure from a uniform clock is what matters.
    departure = np.arange(t.size, dtype=np.float64)
    departure *= -mean
    departure += t
    departure -= t[0]
    drift = float(max(departure.max(), -departure.min()))
    if drift > 0.6 * mean:
        raise InputError(
            f"time is not uniform: samples depart by up to {drift:.3g} s from a clock of {mean:.6g} s; "
            "resample the record or repair its time column"
        )
    return mean


def restarting_rate(time: Real) -> float | None:
    """Return the sample rate of blocks that stand one after another.

    Parameters
    ----------
    time : ndarray, shape (n,)
        Times [s].

    Returns
    -------
    float or None
        Samples a second, where the time falls and each time to where it began, and rises in even steps between: so
        does the time since the trigger. None for every other time.
    """
    steps = np.diff(time)
    falls = np.flatnonzero(steps <= 0.0)
    if falls.size == 0 or falls[0] < 7 or not np.all(np.isfinite(time)):
        return None
    rising = steps[steps > 0.0]
    mean = float(np.mean(rising))
    begins = np.abs(time[falls + 1] - time[0])
    # Few digits of a text make single steps uneven by as much as the last digit.
    even = np.max(np.abs(rising - mean)) < 0.5 * mean and np.max(begins) < 0.5 * mean
    if not even:
        return None
    # The roundest rate that departs by less than a fiftieth of a step in a block: times are written with few digits.
    rates = (float(f"{1.0 / mean:.{digits}g}") for digits in range(2, 17))
    return next((rate for rate in rates if abs(rate * mean - 1.0) * falls[0] < 0.02), 1.0 / mean)


def axis_present(record: xr.Dataset, channel: str) -> list[str]:
    """Return the axes on which `channel` has been recorded, in the order x, y, z."""
    if channel not in record:
        return []
    values = record[channel]
    names = [str(a) for a in values["axis"].values]
    there = [
        i for name, i in zip(names, axis_index(names), strict=True) if not np.isnan(values.sel(axis=name).values[0])
    ]
    return [AXES[i] for i in sorted(there)]


def make_compliance(
    frequency: ArrayLike,
    compliance: Complex,
    response: Sequence[str] = AXES,
    excitation: Sequence[str] = AXES,
    extra: Mapping[str, tuple[tuple[str, ...], ArrayLike]] | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Assemble a labelled compliance.

    Parameters
    ----------
    frequency : array_like, shape (n,)
        Frequency [Hz], rising.
    compliance : ndarray of complex, shape (n, responses, excitations)
        Displacement over force [m/N].
    response, excitation : sequence of str
        Names of the last two dimensions: axes at the tool tip (a part of `AXES` is a legitimate measurement), or
        places ``NODE:axis``.
    extra : mapping, optional
        More variables, name -> (dimensions, values).
    attrs : mapping, optional
        Attributes of the dataset.

    Returns
    -------
    xarray.Dataset
        ``compliance(frequency, response, excitation)`` and what `extra` holds, with units.
    """
    data: dict[str, Any] = {"compliance": (("frequency", "response", "excitation"), np.asarray(compliance))}
    data.update(extra or {})
    coords = {
        "frequency": np.asarray(frequency, dtype=float),
        "response": list(response),
        "excitation": list(excitation),
    }
    import xarray as xr

    return check_compliance(label(xr.Dataset(data, coords=coords, attrs=dict(attrs or {}))))


def check_compliance(dataset: xr.Dataset) -> xr.Dataset:
    """Return the dataset when it holds a compliance, else raise `InputError`."""
    if "compliance" not in dataset:
        raise InputError(f"no variable 'compliance' among {', '.join(map(str, dataset.data_vars)) or 'none'}")
    array = dataset["compliance"]
    for dim in ("frequency", "response", "excitation"):
        if dim not in array.dims:
            raise InputError(f"the compliance has dimensions {array.dims}; '{dim}' is missing")
    f = dataset["frequency"].values
    if f.size < 1 or np.any(np.diff(f) <= 0.0) or f[0] < 0.0:
        raise InputError("the frequencies of a compliance must be non-negative and rise")
    for dim in ("response", "excitation"):
        for name in map(str, dataset[dim].values):
            place_text(name)
    if array.attrs.get("units") != UNITS["compliance"]:
        raise InputError(f"the compliance has units {array.attrs.get('units')!r}; 'm/N' is needed")
    return dataset


def not_measured(dataset: xr.Dataset) -> xr.DataArray:
    """Return which entries hold a number at no frequency, ``(response, excitation)``: two taps know no cross term.

    Conditions such as ``feed`` stay dimensions.
    """
    return never_known(check_compliance(dataset)["compliance"])


def never_known(array: xr.DataArray) -> xr.DataArray:
    """Return `not_measured` of a compliance that has been checked."""
    # Most often the first frequency knows every entry: then the others need not be looked through.
    first = array.isel(frequency=0, drop=True).isnull()
    return array.isnull().all("frequency") if first.values.any() else first


def full_matrix(dataset: xr.Dataset) -> Complex:
    """Return the compliance as an array of shape (frequencies, 3, 3) with zeros where it was not measured.

    Notes
    -----
    Zero means rigid. A caller that computes a limit from a partial matrix must state it. An entry that is known at some
    frequencies only is NaN at the others.
    """
    array = at_tool(check_compliance(dataset))["compliance"].transpose("frequency", "response", "excitation")
    values = np.asarray(array.values, dtype=np.complex128)
    missing = np.asarray(np.isnan(values).all(axis=0))
    full = np.zeros((values.shape[0], 3, 3), dtype=np.complex128)
    columns = axis_index([str(a) for a in array["excitation"].values])
    for i, row in enumerate(axis_index([str(a) for a in array["response"].values])):
        for j, column in enumerate(columns):
            if not missing[i, j]:
                full[:, row, column] = values[:, i, j]
    return full
