"""Files of results: labelled arrays as groups of one NetCDF-4 file, everything moved into place when complete."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from process.errors import InputError
from smfe.records.formats import hdf5_guard


def check_target(path: Path) -> None:
    """Refuse a file of results that cannot be written where it is asked for; long work asks before it begins.

    Raises
    ------
    InputError
        When a folder has its name, or a file the name of one of its folders.
    """
    if path.is_dir():
        raise InputError(f"'{path}' is a folder; name the file to write, '{path}/NAME'")
    for folder in path.parents:
        if folder.exists() and not folder.is_dir():
            raise InputError(f"'{folder}' is a file, so that '{path}' cannot be written; name another folder")


def write_atomically(path: Path, write: Callable[[Path], object]) -> Path:
    """Call ``write(temporary path)`` and move the result to `path`; leave nothing behind when it fails."""
    check_target(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.part")
    try:
        write(temporary)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def write_groups(path: Path, groups: Mapping[str, xr.Dataset], attrs: Mapping[str, str] | None = None) -> Path:
    """Write datasets as the groups of one NetCDF-4 file (complex numbers natively), with attributes of the file."""
    root = {"/": xr.Dataset(attrs=attrs)} if attrs else {}
    tree = xr.DataTree.from_dict({**root, **{f"/{name}": dataset for name, dataset in groups.items()}})
    return write_atomically(path, lambda p: tree.to_netcdf(p, engine="h5netcdf"))


def read_groups(path: Path) -> dict[str, xr.Dataset]:
    """Read what `write_groups` wrote: group path -> dataset, groups without data left out.

    Raises
    ------
    InputError
        When the file is missing or is not such a file.
    """
    if not path.is_file():
        raise InputError(f"{path} does not exist; `smfe run` writes it")
    hdf5_guard.check(path, "a NetCDF-4 file of results")
    try:
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            loaded = tree.load()
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(f"{path} is not a readable NetCDF-4 file of results ({error}); write it again") from error
    nodes = {node.path.lstrip("/"): node.to_dataset() for node in loaded.subtree}
    return {name: dataset for name, dataset in nodes.items() if dataset.data_vars}


def write_csv(path: Path, frame: pd.DataFrame) -> Path:
    """Write a table as CSV; empty where there is no number."""
    return write_atomically(path, lambda p: frame.to_csv(p, index=False, lineterminator="\n"))


def write_json(path: Path, content: Mapping[str, Any]) -> Path:
    """Write JSON, indented."""
    text = json.dumps(content, indent=2, sort_keys=True) + "\n"
    return write_atomically(path, lambda p: p.write_text(text, encoding="utf-8"))


def pack_warnings(dataset: xr.Dataset, warnings: Sequence[str]) -> xr.Dataset:
    """Return the dataset with its warnings as a JSON list in ``attrs["warnings"]``."""
    return dataset.assign_attrs(warnings=json.dumps(list(warnings)))


def unpack_warnings(dataset: xr.Dataset) -> list[str]:
    """Return the warnings that `pack_warnings` put into a dataset."""
    found: list[str] = json.loads(dataset.attrs.get("warnings", "[]"))
    return found
