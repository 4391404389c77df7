"""Arrays -> a labelled compliance, and whatever holds a compliance -> compliances by their names."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process import units
from process.errors import InputError
from process.labels import AXES, axis_index, check_compliance, make_compliance
from process.types import Complex, Real
from smfe.identification.errors.result import Identification
from smfe.identification.measurement import sign_warnings
from smfe.identification.responses import response_std
from smfe.progress import warn
from smfe.records.formats.channels import motion_of

Entries = ArrayLike | Mapping[str, ArrayLike]
"""One entry of a matrix, the whole matrix, or entries by name, "xy" for the response x to a force along y."""

Compliance = xr.Dataset | Identification
"""What holds a compliance."""

_UNITS = ("compliance", "mobility", "accelerance")


def compliance(
    frequency: ArrayLike,
    response: Entries,
    *,
    std: Entries | None = None,
    coherence: Entries | None = None,
    averages: int | None = None,
    unit: str = "m/N",
    axes: str = "",
    name: str = "compliance",
    conditions: Mapping[str, str] | None = None,
) -> xr.Dataset:
    """Make a labelled compliance of arrays.

    A mobility or accelerance H becomes the compliance ``H/(j w)^n`` for ``exp(+j w t)``, n = 1 or 2. A coherence g2 of
    n averages gives the root mean square of the complex error, ``|H| sqrt((1 - g2)/(g2 (n - 1)))``
    (`smfe.identification.responses`).

    Parameters
    ----------
    frequency : array_like, shape (f,)
        Frequencies [Hz], rising.
    response : array_like of complex, shape (f,) or (f, n, n), or mapping of str to array_like of shape (f,)
        Motion over force: one direct entry, the matrix (response, excitation), or entries by name, ``{"xx": ...,
        "xy": ...}`` with the response first. What is not given was not measured.
    std : as `response`, real, optional
        Root mean square of the complex error, in `unit`.
    coherence : as `response`, real, optional
        From 0 to 1.
    averages : int, optional
        Independent averages behind response and coherence; with both the error is known.
    unit : str, optional
        Of `response`: "m/N", "um/N", "m/s/N", "m/s^2/N", "g/N", ...
    axes : str, optional
        Axes of one array: "y" for a direct entry (default "x"), "xy" for a matrix of two (default "xyz" for three).
    name : str, optional
        What the compliance is called in tables and figures.
    conditions : mapping of str to str, optional
        What it was measured under, as in a campaign file: ``{"feed": "500 mm/min", "controller": "K2"}``.

    Returns
    -------
    xarray.Dataset
        ``compliance(frequency, response, excitation)`` [m/N], where known with ``compliance_std`` [m/N] and
        ``coherence``; entries that were not given are NaN.

    Raises
    ------
    InputError
        For shapes that do not fit, a unit or axis that is not known, or a coherence that is none.

    Warns
    -----
    SmfeWarning
        When a direct compliance gives out energy: force or motion have the wrong sign.

    Examples
    --------
    >>> frf = compliance([40.0, 50.0, 60.0], [2e-8, 3e-8 - 1e-8j, -4e-8j], axes="y")
    """
    order = motion_of(unit)
    factor = units.factor(unit, _UNITS[order])
    f = np.asarray(frequency, dtype=float)
    if f.ndim != 1 or not np.isfinite(f).all():
        raise InputError(f"frequencies have the shape {f.shape}; a row of finite numbers in Hz is needed")
    pairs = _pairs(response, axes, f.size, "response")
    keep = (f > 0.0) | (order == 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = (factor / (2j * np.pi * f) ** order)[keep]
    rows, columns = ([a for a in AXES if any(p[k] == a for p in pairs)] for k in (0, 1))
    shape = (int(keep.sum()), len(rows), len(columns))

    def matrix(given: Mapping[str, Complex]) -> Complex:
        out = np.full(shape, np.nan, dtype=complex)
        for pair, values in given.items():
            out[:, rows.index(pair[0]), columns.index(pair[1])] = values[keep]
        return out

    def like(given: Entries, what: str) -> Complex:
        found = _pairs(given, axes, f.size, what)
        if unknown := [p for p in found if p not in pairs]:
            raise InputError(f"{what} has the entry '{unknown[0]}', the response has {', '.join(pairs)}")
        return matrix(found)

    values = matrix(pairs) * scale[:, None, None]
    three = ("frequency", "response", "excitation")
    extra: dict[str, tuple[tuple[str, ...], Real]] = {}
    if coherence is not None:
        found = like(coherence, "coherence").real
        if np.any((found < -1e-9) | (found > 1.0 + 1e-9)):
            raise InputError("a coherence lies outside of 0 to 1; give the ordinary coherence, |S_XF|^2/(S_XX S_FF)")
        extra["coherence"] = (three, np.clip(found, 0.0, 1.0))
    if std is not None:
        extra["compliance_std"] = (three, like(std, "std").real * np.abs(scale)[:, None, None])
    elif coherence is not None and averages is not None:
        error = response_std(values, extra["coherence"][1], averages)
        if np.isfinite(error).any():
            extra["compliance_std"] = (three, error)
            known = np.where(np.isfinite(error), 2.0 * (averages - 1), np.nan)
            extra["degrees_of_freedom"] = (three, known)
    attrs: dict[str, str] = {"name": name, "method": "frf"}
    if conditions:
        attrs["conditions"] = json.dumps(dict(conditions))
    made = make_compliance(f[keep], values, rows, columns, extra, attrs)
    warn(sign_warnings(made))
    return made


def _pairs(given: Entries, axes: str, size: int, what: str) -> dict[str, Complex]:
    """Return entries by name, each of shape (frequencies,)."""
    if isinstance(given, Mapping):
        found = {str(pair): np.asarray(values) for pair, values in given.items()}
    else:
        array = np.asarray(given)
        if array.ndim == 1:
            found = {2 * (axes or "x"): array}
        elif array.ndim == 3 and array.shape[1] == array.shape[2]:
            names = axes or ("xyz" if array.shape[1] == 3 else "x" if array.shape[1] == 1 else "")
            if len(names) != array.shape[1]:
                raise InputError(
                    f'the {what} is a matrix of {array.shape[1]} axes; name them, e.g. axes="xy" (axes is {axes!r})'
                )
            found = {r + e: array[:, i, j] for i, r in enumerate(names) for j, e in enumerate(names)}
        else:
            raise InputError(
                f"the {what} has the shape {array.shape}; (frequencies,) for one entry, (frequencies, n, n) for a "
                'matrix, or a mapping {"xx": ..., "xy": ...} is needed'
            )
    for pair, values in found.items():
        if len(pair) != 2:
            raise InputError(f'entry \'{pair}\' of the {what} is none; write response and excitation, e.g. "xx", "yx"')
        axis_index(list(pair))
        if values.shape != (size,):
            raise InputError(f"entry {pair} of the {what} has the shape {values.shape}, the frequencies ({size},)")
    if not found:
        raise InputError(f"the {what} has no entry")
    return {pair: values.astype(complex) for pair, values in found.items()}


def several(source: object) -> TypeGuard[Mapping[str, Any]]:
    """Whether these are compliances by name; a dataset is a mapping, too."""
    return isinstance(source, Mapping) and not isinstance(source, xr.Dataset)


def compliances_of(source: object) -> dict[str, xr.Dataset]:
    """Return compliances by name.

    Parameters
    ----------
    source : xarray.Dataset, Identification, mapping of str to these, or sequence of Identification
        What holds them.

    Raises
    ------
    InputError
        For anything else, and a dataset that is no compliance.
    """
    if several(source):
        return {str(name): dataset_of(item) for name, item in source.items()}
    if isinstance(source, Sequence) and not isinstance(source, str):
        found = [(name_of(item), dataset_of(item)) for item in source]
        if len(dict(found)) < len(found):
            raise InputError("several of these compliances have one name; give them by name, {'hammer': ..., ...}")
        return dict(found)
    return {name_of(source): dataset_of(source)}


def dataset_of(item: object) -> xr.Dataset:
    """Return the compliance that an object holds."""
    if isinstance(item, Identification):
        return item.compliance.assign_attrs({"method": item.method, **item.compliance.attrs, "name": item.name})
    if isinstance(item, xr.Dataset):
        return check_compliance(item)
    raise InputError(
        f"{type(item).__name__} holds no compliance; give what smfe.identify or smfe.compliance returns, or a path"
    )


def name_of(item: object) -> str:
    """Return what a compliance is called."""
    if isinstance(item, Identification):
        return item.name
    return str(item.attrs.get("name", "compliance")) if isinstance(item, xr.Dataset) else "compliance"


def conditions_of(compliance: xr.Dataset) -> dict[str, str]:
    """Return what a compliance says that it was measured under."""
    found: dict[str, str] = json.loads(compliance.attrs.get("conditions", "{}"))
    return found
