"""Files of results: labelled arrays as groups of one NetCDF-4 file, everything moved into place when complete."""

from __future__ import annotations

import errno
import io
import json
import os
import re
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import xarray as xr
from xarray.backends import H5NetCDFStore

from process.errors import InputError
from smfe.kept import aside, say_damaged, seal, unsealed
from smfe.records.formats.hdf5 import walk
from smfe.records.formats.reader import apart
from smfe.staged import FULL

if TYPE_CHECKING:
    from _typeshed import ReadableBuffer, WriteableBuffer


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
    with aside(path) as temporary:
        write(temporary)
    return path


def write_groups(path: Path, groups: Mapping[str, xr.Dataset], attrs: Mapping[str, str] | None = None) -> Path:
    """Write datasets as the groups of one NetCDF-4 file (complex numbers natively), with attributes of the file.

    Each is asked for when it is written: groups that are read from elsewhere need not lie in memory together.
    """

    def write(temporary: Path) -> None:
        with temporary.open("w+b", buffering=0) as disk:
            file = _UnfailingFile(disk)
            store = H5NetCDFStore.open(file, mode="w")
            try:
                xr.Dataset(attrs=attrs).dump_to_store(store)
                for name, dataset in groups.items():
                    # Data before coordinates: a dataset just computed and one read back give the same bytes.
                    ordered = xr.Dataset(dataset.data_vars, dataset.coords, dataset.attrs)
                    ordered.dump_to_store(store.get_child_store(f"/{name}"))
            finally:
                store.close()
        if file.error is not None:
            raise file.error

    return write_atomically(path, write)


class _UnfailingFile(io.RawIOBase):
    """A file of which the HDF5 library never hears that the disk is full: it would end the process when it closes one.

    What the disk no longer takes goes to memory, and `error` says why.
    """

    def __init__(self, disk: io.FileIO) -> None:
        self._file: io.FileIO | io.BytesIO = disk
        self.error: OSError | None = None

    def write(self, content: ReadableBuffer) -> int:
        whole = memoryview(content).cast("B")
        place = self._file.tell()
        try:
            done = 0
            while done < len(whole):
                done += self._file.write(whole[done:])
        except OSError as error:
            self._go_on_in_memory(error)
            self._file.seek(place)
            self._file.write(whole)
        return len(whole)

    def truncate(self, size: int | None = None) -> int:
        try:
            return self._file.truncate(size)
        except OSError as error:
            self._go_on_in_memory(error)
            return self._file.truncate(size)

    def _go_on_in_memory(self, error: OSError) -> None:
        self.error = error
        place = self._file.tell()
        self._file.seek(0)
        self._file = io.BytesIO(self._file.read())
        self._file.seek(place)

    def readinto(self, buffer: WriteableBuffer) -> int:
        return self._file.readinto(buffer)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True


def read_groups(path: Path) -> dict[str, xr.Dataset]:
    """Read what `write_groups` wrote: group path -> dataset, groups without data left out.

    Raises
    ------
    InputError
        When the file is missing or is not such a file.
    """
    if not path.is_file():
        raise InputError(f"{path} does not exist; `smfe run` writes it")
    apart(walk)(path)
    try:
        with xr.open_datatree(path, engine="h5netcdf") as tree:
            loaded = tree.load()
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(f"{path} is not a readable NetCDF-4 file of results ({error}); write it again") from error
    return _groups(loaded)


def keep_groups(path: Path, groups: Mapping[str, xr.Dataset]) -> None:
    """Keep datasets for the next run, with a checksum."""
    tree = xr.DataTree.from_dict({f"/{name}": dataset for name, dataset in groups.items()})
    seal(path, bytes(tree.to_netcdf(engine="h5netcdf")))


def kept_groups(path: Path) -> dict[str, xr.Dataset]:
    """Read what `keep_groups` kept.

    Raises
    ------
    InputError
        When the file is not as it was written; that is said.
    """
    try:
        content = unsealed(path)
    except (OSError, ValueError) as error:
        say_damaged(path)
        raise InputError(f"{path}: {error}") from error
    with xr.open_datatree(io.BytesIO(content), engine="h5netcdf") as tree:
        return _groups(tree.load())


def _groups(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    nodes = {node.path.lstrip("/"): node.to_dataset() for node in tree.subtree}
    return {name: dataset for name, dataset in nodes.items() if dataset.data_vars}


def write_csv(path: Path, frame: pd.DataFrame) -> Path:
    """Write a table as CSV; empty where there is no number, and no cell a formula (`defused`)."""
    return write_atomically(path, lambda p: defused(frame).to_csv(p, index=False, lineterminator="\n"))


_FORMULA = re.compile(r"[=@\t\r]|[-+](?!(?:[\w.:% ]|(?<=[eE])[-+])*$)")
"""Begin of a text that a spreadsheet takes for a formula; signs before numbers and words are none."""


def defused(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table whose texts no spreadsheet takes for formulas: those that begin like one get an apostrophe.

    Names come from campaigns and files of others; a formula may start a program of whoever opens the table.
    """

    def of(cell: object) -> object:
        return f"'{cell}" if isinstance(cell, str) and _FORMULA.match(cell) else cell

    texts = [k for k, kind in enumerate(frame.dtypes) if kind.kind not in "biufcM"]
    out = frame.copy(deep=False)
    for k in texts:
        if any(isinstance(cell, str) and _FORMULA.match(cell) for cell in frame.iloc[:, k]):
            out.isetitem(k, [of(cell) for cell in frame.iloc[:, k]])
    return out.rename(columns=of)


def as_named(frame: pd.DataFrame) -> pd.DataFrame:
    """Return a table as it was before `defused`."""

    def of(cell: object) -> object:
        return cell[1:] if isinstance(cell, str) and cell[:1] == "'" and _FORMULA.match(cell[1:]) else cell

    texts = [k for k, kind in enumerate(frame.dtypes) if kind.kind not in "biufcM"]
    out = frame.copy(deep=False)
    for k in texts:
        if any(isinstance(cell, str) and cell[:1] == "'" for cell in frame.iloc[:, k]):
            out.isetitem(k, [of(cell) for cell in frame.iloc[:, k]])
    return out.rename(columns=of)


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


# --- Parts of a campaign that fail: each alone, with its reason kept for every output.

FAILED = "failed"
"""What stands in a table where a verdict or a prediction would have stood."""

MEASUREMENT, LOBES, TEST, PREDICTION = "measurement", "lobes", "cutting test", "prediction"
"""Kinds of parts that have a place of their own in the report."""


@dataclass(frozen=True)
class Failure:
    """One part that failed.

    Parameters
    ----------
    part : str
        What it is: "measurement", "lobes", "cutting test", "prediction", "comparison", "diagnosis", ...
    name : str
        Which one: a measurement, "lobes_1, SOURCE", the file of a cutting test; empty where there is one only.
    reason : str
        Why, with what to do.
    outside : bool
        Whether it lies outside of input and program: memory, a disk, a network. The same may go well another time.
    """

    part: str
    name: str
    reason: str
    outside: bool = False

    @property
    def sentence(self) -> str:
        """Part, name and reason as one line."""
        return f"{self.part}{f' {self.name}' if self.name else ''}: {self.reason}"


Failures = list[Failure]
"""Collects what failed."""


@contextmanager
def attempt(failures: Failures | None, part: str, name: str = "") -> Iterator[None]:
    """Carry out a part; what goes wrong in it is added to `failures`, and the rest goes on.

    Input that cannot be used is the usual reason. Any other error is a mistake of this package: it costs the part, not
    the results of the others, and is said with the place where it happened. An interruption ends everything, and so
    does a disk that takes nothing more.

    Parameters
    ----------
    failures : list of Failure or None
        Where to add it. None: nothing is caught.
    part, name : str
        As in `Failure`.
    """
    try:
        yield
    except Exception as error:
        if failures is None or (isinstance(error, OSError) and error.errno in FULL):
            raise
        failures.append(failure_of(part, name, error))


def failure_of(part: str, name: str, error: Exception) -> Failure:
    """Return what an error makes of a part; its reason does not say once more which part it was."""
    return Failure(part, name, reason_of(error).removeprefix(f"{part} '{name}': "), is_outside(error))


_OUTSIDE = frozenset(
    getattr(errno, name)
    for name in (
        *("EAGAIN", "EBUSY", "EDQUOT", "EINTR", "EIO", "EMFILE", "ENFILE", "ENOBUFS", "ENOLCK", "ENOMEM", "ENOSPC"),
        *("EHOSTDOWN", "EHOSTUNREACH", "ENETDOWN", "ENETRESET", "ENETUNREACH", "ENOTCONN", "ESTALE", "ETIMEDOUT"),
        *("ECONNABORTED", "ECONNREFUSED", "ECONNRESET", "EREMOTEIO"),
    )
    if hasattr(errno, name)
)
"""Numbers of errors of the system that say nothing of the file itself: disk, memory, handles, network."""


def is_outside(error: BaseException | None) -> bool:
    """Return whether what went wrong, or what it came from, lies outside of input and program."""
    while error is not None:
        if isinstance(error, MemoryError | ConnectionError | TimeoutError) or getattr(error, "errno", None) in _OUTSIDE:
            return True
        error = error.__cause__
    return False


def reason_of(error: Exception) -> str:
    """Return what went wrong as a sentence; what is neither wrong input nor the system is said to be our mistake."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.strerror or error}: {error.filename or ''}"
    if isinstance(error, MemoryError):
        return "the memory of this computer does not hold it; give shorter records or fewer at a time"
    at = traceback.extract_tb(error.__traceback__)[-1]
    place = f"{Path(at.filename).name}, line {at.lineno}"
    return f"a mistake in smfe ({type(error).__name__} in {place}: {error}); please report it with the records"


def pack(failures: Iterable[Failure]) -> dict[str, str]:
    """Return attributes for a file of results that say what is missing in it."""
    rows = as_rows(failures)
    return {"failures": json.dumps(rows)} if rows else {}


def unpack(content: Mapping[str, object]) -> Failures:
    """Return the failures in the attributes of a file, or in what provenance.json holds."""
    found = content.get("failures", [])
    rows = json.loads(found) if isinstance(found, str) else found
    if not isinstance(rows, list):
        return []
    return [
        Failure(str(r.get("part", "")), str(r.get("name", "")), str(r.get("reason", "")), bool(r.get("outside")))
        for r in rows
        if isinstance(r, dict)
    ]


def of_file(path: Path) -> Failures:
    """Return what a NetCDF-4 file of results says is missing in it."""
    if not path.is_file():
        return []
    with xr.open_dataset(path, engine="h5netcdf") as root:
        return unpack(dict(root.attrs))


def as_rows(failures: Iterable[Failure]) -> list[dict[str, Any]]:
    """Return one row a failure, for JSON; that it came from outside is said where it did."""
    return [{k: v for k, v in asdict(f).items() if k != "outside" or v} for f in failures]


def require_something(found: Sequence[object], failures: Failures | None) -> None:
    """Refuse to write a file in which everything failed: an older one says more."""
    if failures and not found:
        raise InputError("\n  ".join(["nothing could be computed", *(f.sentence for f in failures)]))
