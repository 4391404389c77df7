"""Which pictures of a folder are drawn already: the same data, drawn by the same program, is not drawn again."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from smfe.kept import KEPT, Parts, key_of, state


def draw_changed(folder: Path, name: str, draw: partial[Any], save: Callable[[], object]) -> None:
    """Save a picture of a folder of results, unless that is what was saved there before.

    Parameters
    ----------
    folder : Path
        Folder of results; pictures stand in its folder ``figures``.
    name : str
        Of the picture.
    draw : functools.partial
        What draws it, with its data.
    save : callable
        Draws and writes it.
    """
    path = folder / "figures" / name
    parts = Parts(folder / KEPT, "figures")
    key = key_of(name, digest([draw.func.__qualname__, draw.args, draw.keywords]))
    if (name, key) in parts and parts.get(name, key, list) == list(state(path)):
        return
    parts.forget(name)
    save()
    parts.get(name, key, lambda: list(state(path)))


def digest(value: object) -> str:
    """Return a hash of all that data hold: arrays, labelled arrays, tables, and what is made of them."""
    whole = hashlib.sha256()
    _add(whole, value)
    return whole.hexdigest()


def _add(whole: hashlib._Hash, value: object) -> None:
    whole.update(type(value).__name__.encode())
    if isinstance(value, xr.Dataset | xr.DataArray):
        variables = value.variables if isinstance(value, xr.Dataset) else {"": value.variable, **value.coords.variables}
        _add(whole, {str(n): [v.dims, v.attrs, v.values] for n, v in variables.items()})
        _add(whole, value.attrs)
    elif isinstance(value, pd.DataFrame):
        _add(whole, {str(c): value[c].to_numpy() for c in value.columns})
    elif isinstance(value, np.ndarray):
        whole.update(repr((value.dtype, value.shape)).encode())
        whole.update(repr(value.tolist()).encode() if value.dtype == object else np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value) and not isinstance(value, type):
        _add(whole, {f.name: getattr(value, f.name) for f in fields(value)})
    elif isinstance(value, Mapping):
        for key, entry in value.items():
            whole.update(repr(key).encode())
            _add(whole, entry)
    elif isinstance(value, list | tuple):
        for entry in value:
            _add(whole, entry)
    else:
        whole.update(repr(value).encode())
