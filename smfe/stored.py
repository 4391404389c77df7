"""Results with arrays that a second run reads back: exactly what was stored, under the key of what it came from.

A part is one file: its structure as JSON and its arrays beside it. Nothing is ever executed when it is read.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd
import xarray as xr

from smfe.kept import say_damaged, seal, unsealed

T = TypeVar("T")


class Store:
    """Parts of one kind in a folder.

    Parameters
    ----------
    folder : Path or None
        `smfe.kept.KEPT` of a folder of results. None: nothing is stored.
    kind : str
        Begins the names of the files.
    *classes : type
        Dataclasses that may be in a part.
    """

    def __init__(self, folder: Path | None, kind: str, *classes: type) -> None:
        self.folder, self.kind = folder, kind
        self.classes = {c.__name__: c for c in classes}
        self._used: set[str] = set()

    def get(self, key: str, make: Callable[[], T]) -> T:
        """Return the part that was stored under a key, else make it and store it."""
        if self.folder is None:
            return make()
        path = self.folder / f"{self.kind}-{key}.npz"
        self._used.add(path.name)
        if path.is_file():
            try:
                found: T = _read(path, self.classes)
                return found
            except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile):
                say_damaged(path)
                path.unlink()
        made = make()
        _write(path, made)
        return made

    def forget_others(self) -> None:
        """Delete what nothing has asked for."""
        for path in [] if self.folder is None else self.folder.glob(f"{self.kind}-*.npz"):
            if path.name not in self._used:
                path.unlink()


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


# --- to a file and back: each value as [kind, content] ------------------------------------------------------------


def _write(path: Path, value: object) -> None:
    arrays: dict[str, np.ndarray[Any, Any]] = {}
    text = json.dumps(_coded(value, arrays))
    stream = io.BytesIO()
    np.savez(stream, structure=np.array(text), **arrays)  # type: ignore[arg-type]
    seal(path, stream.getvalue())


def _read(path: Path, classes: Mapping[str, type]) -> Any:
    with np.load(io.BytesIO(unsealed(path)), allow_pickle=False) as file:
        return _value(json.loads(str(file["structure"])), file, classes)


def _coded(value: Any, arrays: dict[str, np.ndarray[Any, Any]]) -> Any:
    def of(entry: Any) -> Any:
        return _coded(entry, arrays)

    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, np.ndarray | np.generic):
        scalar = isinstance(value, np.generic)
        array = np.asarray(value)
        if array.dtype == object:
            return ["texts", [list(array.shape), [of(entry) for entry in array.ravel().tolist()]]]
        name = f"a{len(arrays)}"
        arrays[name] = array
        return ["scalar" if scalar else "array", name]
    if isinstance(value, xr.Dataset):
        variables = [[n, list(v.dims), of(dict(v.attrs)), of(v.values)] for n, v in value.variables.items()]
        return ["dataset", [variables, list(value.coords), of(dict(value.attrs))]]
    if isinstance(value, list):
        return ["list", [of(entry) for entry in value]]
    if isinstance(value, tuple):
        return ["tuple", [of(entry) for entry in value]]
    if isinstance(value, Mapping):
        return ["dict", [[of(key), of(entry)] for key, entry in value.items()]]
    if is_dataclass(value) and not isinstance(value, type):
        return ["object", [type(value).__name__, {f.name: of(getattr(value, f.name)) for f in fields(value)}]]
    raise TypeError(f"{type(value).__name__} cannot be stored")


def _value(coded: Any, arrays: Mapping[str, np.ndarray[Any, Any]], classes: Mapping[str, type]) -> Any:
    def of(entry: Any) -> Any:
        return _value(entry, arrays, classes)

    if not isinstance(coded, list):
        return coded
    kind, content = coded
    match kind:
        case "array":
            return arrays[content]
        case "scalar":
            return arrays[content][()]
        case "texts":
            array = np.empty(len(content[1]), object)
            array[:] = [of(entry) for entry in content[1]]
            return array.reshape(content[0])
        case "dataset":
            variables = {n: (tuple(dims), of(values), of(attrs)) for n, dims, attrs, values in content[0]}
            coords = {n: variables[n] for n in content[1]}
            return xr.Dataset({n: v for n, v in variables.items() if n not in coords}, coords, of(content[2]))
        case "list":
            return [of(entry) for entry in content]
        case "tuple":
            return tuple(of(entry) for entry in content)
        case "dict":
            return {of(key): of(entry) for key, entry in content}
        case "object":
            return classes[content[0]](**{name: of(entry) for name, entry in content[1].items()})
    raise ValueError(f"a part of unknown kind '{kind}'")
