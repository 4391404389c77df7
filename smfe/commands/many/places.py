"""Campaigns and results that lie elsewhere: addresses that fsspec opens, and workers that do not see the results.

A campaign at an address (``s3://bucket/archive/campaign.toml``) is fetched by the process that works on it, with the
records that it names, into a temporary folder which is deleted afterwards: readers of HDF5, TDMS and MAT need files.
The names in it are relative to its folder and stay inside it. Nothing is fetched that the user has not named or that
does not lie below it.
"""

from __future__ import annotations

import io
import posixpath
import re
import shutil
import tarfile
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from typing import Any

from process.errors import InputError
from smfe.kept import KEPT, LOCK, code, read_kept, write_kept

SOURCE = "source.json"
"""File of `KEPT` that says of a campaign at an address which files there its results are of."""

_MAGIC = re.compile(r"[*?\[]")


def is_address(given: object) -> bool:
    """Return whether this is an address that fsspec opens; ``file://`` is one of this machine and is not."""
    return isinstance(given, str) and "://" in given and not given.startswith("file://")


def campaigns_at(address: str) -> list[str]:
    """Return the addresses of the campaign files that an address names: a file, a folder or a pattern."""
    system, path = _open(address)
    with _readable(address):
        if _MAGIC.search(path):
            found = [p for p in sorted(system.glob(path)) if p.endswith(".toml")]
        elif system.isdir(path):
            below = [p for p in sorted(system.find(path)) if p.endswith(".toml")]
            found = [p for p in below if re.search(rb"^\s*\[campaign\]", system.cat_file(p), re.MULTILINE)]
        else:
            found = [path] if system.exists(path) else []
    return [str(system.unstrip_protocol(p)) for p in found]


def source_of(address: str) -> dict[str, Any]:
    """Return what the results of a campaign at an address are of: each file with what its system says of its state."""
    system, path = _open(address)
    with _readable(address):
        return {"code": code(), "files": {p: system.ukey(p) for p in (path, *_records(system, path))}}


@contextmanager
def fetched(address: str) -> Iterator[tuple[Path, Mapping[str, Any]]]:
    """Give the campaign file of an address in a temporary folder with its records, and what `source_of` says of it."""
    system, path = _open(address)
    source = source_of(address)
    base = posixpath.dirname(path)
    with tempfile.TemporaryDirectory(prefix="smfe-") as place:
        for remote in source["files"]:
            target = Path(place, posixpath.relpath(remote, base))
            target.parent.mkdir(parents=True, exist_ok=True)
            with _readable(address):
                system.get_file(remote, str(target))
        yield Path(place, posixpath.basename(path)), source


def is_same(folder: Path, address: str) -> bool:
    """Return whether the results in a folder are of the files at an address as they are now, as far as can be seen."""
    try:
        return read_kept(folder / KEPT / SOURCE) == source_of(address)
    except (InputError, OSError):
        return False


def keep_source(folder: Path, source: Mapping[str, Any]) -> None:
    """Keep which files results are of."""
    write_kept(folder / KEPT / SOURCE, source)


def packed(folder: Path) -> bytes:
    """Return a folder of results as one archive; what says who writes into it is left out."""
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        for path in sorted(p for p in folder.rglob("*") if p.is_file() and p.name != LOCK):
            archive.add(path, path.relative_to(folder).as_posix(), recursive=False)
    return stream.getvalue()


def unpack_into(folder: Path, content: bytes) -> None:
    """Put results that came as an archive in their place in one step."""
    new, old = (folder.with_name(f".{folder.name}.{word}") for word in ("new", "old"))
    for left in (new, old):
        shutil.rmtree(left, ignore_errors=True)
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        archive.extractall(new, filter="data")
    if folder.exists():
        folder.rename(old)
    new.rename(folder)
    shutil.rmtree(old, ignore_errors=True)


def _open(address: str) -> tuple[Any, str]:
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise InputError(f"'{address}' needs fsspec, which is not installed: pip install 'smfe[cluster]'") from None
    try:
        system, path = url_to_fs(address)
    except (ValueError, ImportError) as error:
        raise InputError(f"'{address}' cannot be opened: {error}") from None
    return system, str(path)


def _records(system: Any, path: str) -> list[str]:
    """Return the records that a campaign file names, below its folder."""
    base = posixpath.dirname(path)
    try:
        raw = tomllib.loads(system.cat_file(path).decode("utf-8-sig"))
    except (ValueError, RecursionError):
        return []  # its error is told when it is read
    out: set[str] = set()
    for name in _names(raw):
        inside = PurePosixPath(name.replace("\\", "/"))
        if inside.is_absolute() or ".." in inside.parts or "://" in name:
            raise InputError(
                f"'{name}': records of a campaign at an address lie in its folder; name them relative to it"
            )
        whole = posixpath.join(base, str(inside))
        out.update(p for p in (system.glob(whole) if _MAGIC.search(name) else [whole]) if system.exists(p))
    return sorted(out)


def _names(value: object, key: str = "") -> Iterator[str]:
    """Yield what stands under the keys that name files; data sets lie elsewhere."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _names(inner, str(name))
    elif isinstance(value, list):
        for inner in value:
            yield from _names(inner, key)
    elif isinstance(value, str) and key in ("file", "background") and not value.startswith("dataset:"):
        yield value


@contextmanager
def _readable(address: str) -> Iterator[None]:
    """Say of an address what a system far away says with an error of its own."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except FileNotFoundError as error:
        raise InputError(f"'{address}': not there ({error})") from error
    except PermissionError as error:
        raise InputError(f"'{address}': may not be read ({error})") from error
    except OSError:
        raise
    except Exception as error:  # libraries of object stores have errors of their own
        raise ConnectionError(f"'{address}': {type(error).__name__}: {error}") from error
