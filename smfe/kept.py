"""What a folder of results keeps for the next run: hashes of files, parts under the key of their input, a record.

Nothing here imports numerics: whether anything has changed is said before they are. A file counts as the same while its
size and time are; only where these differ is it read. Parts are kept by a key of everything that they depend on,
the program among it, so that what is read back is what would be computed again.
"""

from __future__ import annotations

import glob
import hashlib
import json
import os
import shutil
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from process.errors import InputError
from smfe._version import __version__
from smfe.patterns import matches
from smfe.progress import warn

KEPT = ".kept"
"""Folder, inside the results, of what a second run reads back."""

RECORD = "run.json"
"""File of `KEPT` that says what a run read and wrote."""

WRITTEN = "written.json"
"""File of `KEPT` that says which results the last run moved into place."""

LOCK = "lock"
"""File of `KEPT` that says who writes into the folder; locked by the system, and so free when that process ends."""

_HASHES = "hashes.json"

State = tuple[int, int]
"""Size of a file and the time of its last change [ns]."""


def state(path: Path) -> State:
    """Return size and time of a file; (-1, 0) where there is none."""
    try:
        found = path.stat()
    except OSError:
        return -1, 0
    return found.st_size, found.st_mtime_ns


@cache
def code() -> str:
    """Return what stands for the program: its version, and number, size and last change of its files."""
    count = size = newest = 0
    for package in ("smfe", "stability", "process"):
        spec = find_spec(package)
        for root in (spec.submodule_search_locations or ()) if spec is not None else ():
            for path in Path(root).rglob("*"):
                if path.suffix in (".py", ".j2", ".js", ".css"):
                    found = path.stat()
                    count, size, newest = count + 1, size + found.st_size, max(newest, found.st_mtime_ns)
    return f"{__version__} {count} {size} {newest}"


def key_of(*parts: object) -> str:
    """Return a short hash of what a part depends on; the representation of each must say all about it."""
    return hashlib.sha256("\n".join([code(), *map(repr, parts)]).encode()).hexdigest()[:32]


# --- Hashes of files ----------------------------------------------------------------------------------------------

_known: dict[tuple[str, State], str] = {}


def file_hash(path: Path) -> str:
    """Return the sha256 of a file, remembered while its size and time stay the same."""
    where = (str(path.absolute()), state(path))
    if where not in _known:
        digest = hashlib.sha256()
        with path.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
        _known[where] = digest.hexdigest()
    return _known[where]


def read_hashes(kept: Path) -> None:
    """Remember the hashes that an earlier run has kept, so that long records are not read for them again."""
    for name, row in _read(kept / _HASHES).items():
        match row:
            case [int(size), int(time), str(digest)]:
                _known.setdefault((name, (size, time)), digest)


def write_hashes(kept: Path, files: Iterable[Path]) -> None:
    """Keep the hashes of files for the next run."""
    rows = {str(p.absolute()): [*state(p), file_hash(p)] for p in files if p.is_file()}
    _write(kept / _HASHES, rows)


# --- Parts --------------------------------------------------------------------------------------------------------


class Parts:
    """Results of one kind of part, as JSON, each under its name with the key of what it came from.

    Each is a file of its own: thousands cost what one costs thousands of times, and processes that share a folder do
    not write over each other.

    Parameters
    ----------
    folder : Path or None
        `KEPT` of a folder of results. None: nothing is kept.
    kind : str
        What they are; begins the names of the files.
    """

    def __init__(self, folder: Path | None, kind: str) -> None:
        self.folder, self.kind = folder, kind
        self._used: set[str] = set()

    def __contains__(self, asked: tuple[str, str]) -> bool:
        return self._found(*asked) is not None

    def get(self, name: str, key: str, make: Callable[[], Any]) -> Any:
        """Return the part that was kept under this key, else make it and keep it; what JSON can hold."""
        if self.folder is None:
            return make()
        self._used.add(self._path(name).name)
        found = self._found(name, key)
        if found is None:
            made = {"name": name, "key": key, "value": make()}
            _write(self._path(name), made)
            found = json.loads(json.dumps(made))  # as it is read back: a tuple is a list from now on
        return found["value"]

    def forget(self, name: str) -> None:
        """Forget a part, before what it stands for is changed."""
        if self.folder is not None:
            self._path(name).unlink(missing_ok=True)

    def forget_others(self) -> None:
        """Forget what nothing has asked for: parts that the campaign has no longer."""
        for path in [] if self.folder is None else self.folder.glob(f"{self.kind}-*.json"):
            if path.name not in self._used:
                path.unlink(missing_ok=True)

    def _found(self, name: str, key: str) -> dict[str, Any] | None:
        found = {} if self.folder is None else _read(self._path(name))
        return found if (found.get("name"), found.get("key")) == (name, key) and "value" in found else None

    def _path(self, name: str) -> Path:
        assert self.folder is not None
        return self.folder / f"{self.kind}-{hashlib.sha256(name.encode()).hexdigest()[:16]}.json"


# --- A whole run --------------------------------------------------------------------------------------------------


def inputs_of(campaign: Path, files: Iterable[Path]) -> dict[str, Any]:
    """Return what a run reads as it is now: files by size and time, and what each pattern of the campaign finds."""
    text = campaign.read_text(encoding="utf-8-sig")
    texts = set(_texts(tomllib.loads(text)))
    patterns = {t for t in texts if glob.has_magic(t)}
    return {
        "campaign": str(campaign.absolute()),
        "files": {str(p.absolute()): list(state(p)) for p in (campaign, *files)},
        "patterns": {pattern: _found(campaign, pattern) for pattern in sorted(patterns)},
        # Where public data sets lie matters to a campaign that names one.
        "data": os.environ.get("SMFE_DATA", "") if any(t.startswith("dataset:") for t in texts) else None,
    }


def write_record(folder: Path, inputs: Mapping[str, Any]) -> None:
    """Write down what a run read, before it began, and what it wrote; the last thing that a run does."""
    kept = folder / KEPT
    write_hashes(kept, map(Path, inputs["files"]))
    outputs = {name: list(state(folder / name)) for name in written(folder)}
    _write(kept / RECORD, {**inputs, "code": code(), "outputs": outputs})


def forget(folder: Path) -> None:
    """Forget all that earlier runs have kept, but not which results they wrote, nor who holds the folder."""
    for path in (folder / KEPT).glob("*"):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        elif path.name not in (RECORD, WRITTEN, LOCK):
            path.unlink(missing_ok=True)


def written(folder: Path) -> list[str]:
    """Return the results that the last run wrote, by their names below the folder; other files there are the user's."""
    names = _read(folder / KEPT / WRITTEN).get("move")
    found = map(str, names) if isinstance(names, list) else ()
    return [name for name in found if not name.startswith(KEPT) and inside(folder, name)]


def inside(folder: Path, name: str) -> bool:
    """Return whether a name leads to a place below a folder, links followed: a list of names may be another's."""
    path = Path(name)
    if not name or path.is_absolute() or path.drive or ".." in path.parts or "\0" in name:
        return False
    return (folder / path).parent.resolve().is_relative_to(folder.resolve())


def forget_record(folder: Path) -> None:
    """Forget that the results are complete, before they are changed."""
    (folder / KEPT / RECORD).unlink(missing_ok=True)


def is_unchanged(campaign: Path, folder: Path) -> bool:
    """Return whether a folder holds what a run of this campaign would write, all of it as it was written.

    Parameters
    ----------
    campaign : Path
        Campaign file.
    folder : Path
        Folder of results.
    """
    record = _read(folder / KEPT / RECORD)
    if record.get("code") != code() or record.get("campaign") != str(campaign.absolute()):
        return False
    if not all(isinstance(record.get(part), dict) for part in ("files", "outputs", "patterns")):
        return False
    if record.get("data") not in (None, os.environ.get("SMFE_DATA", "")):
        return False
    if any(list(state(folder / name)) != known for name, known in record["outputs"].items()):
        return False
    hashes = _read(folder / KEPT / _HASHES)
    for name, known in record["files"].items():
        path = Path(name)
        if list(state(path)) != known and not (path.is_file() and file_hash(path) == hashes.get(name, [0, 0, ""])[2]):
            return False
    return all(_found(campaign, pattern) == known for pattern, known in record["patterns"].items())


def campaign_of(folder: Path) -> Path | None:
    """Return the campaign file whose results a folder holds, as far as that is written down."""
    name = _read(folder / KEPT / RECORD).get("campaign")
    return Path(name) if isinstance(name, str) else None


def _found(campaign: Path, pattern: str) -> list[str]:
    try:
        return list(map(str, matches(campaign.absolute().parent, pattern)))
    except (InputError, ValueError):  # a text that is no pattern of files
        return []


def _texts(value: object) -> Iterator[str]:
    """Yield every text in the tables of a file."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for inner in value.values():
            yield from _texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _texts(inner)


def _read(path: Path) -> dict[str, Any]:
    """Return what a file of ours holds; one that is damaged is as good as none, and that is said."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(found, dict) or found.pop(_CHECKSUM, _sum(found)) != _sum(found):
            raise ValueError("it is not as it was written")
    except FileNotFoundError:
        return {}
    except (OSError, ValueError):
        say_damaged(path)
        return {}
    return found


def read_kept(path: Path) -> dict[str, Any]:
    """Return what `write_kept` wrote; nothing where there is none, or it is not as it was written."""
    return {name: value for name, value in _read(path).items() if name != _CHECKSUM}


def write_kept(path: Path, content: Mapping[str, Any]) -> None:
    """Write a file of JSON with its checksum."""
    _write(path, content)


def _write(path: Path, content: Mapping[str, Any]) -> None:
    with aside(path) as temporary:
        temporary.write_text(json.dumps({**content, _CHECKSUM: _sum(content)}), encoding="utf-8")


# --- Checksums: what was kept is as it was kept, or is computed again ----------------------------------------------

_CHECKSUM = "checksum"
_SUM = b"\nsha256 "


def _sum(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def seal(path: Path, content: bytes) -> None:
    """Write a file with its checksum behind it."""
    with aside(path) as temporary:
        temporary.write_bytes(content + _SUM + hashlib.sha256(content).hexdigest().encode() + b"\n")


def unsealed(path: Path) -> bytes:
    """Return what `seal` wrote.

    Raises
    ------
    ValueError
        When the file is not as it was written.
    """
    content, _, known = path.read_bytes().rpartition(_SUM)
    if hashlib.sha256(content).hexdigest().encode() + b"\n" != known:
        raise ValueError("it is not as it was written")
    return content


def say_damaged(path: Path) -> None:
    """Say that what was kept is computed again."""
    warn([f"'{path}' is not as it was written (its checksum is wrong); what was kept in it is computed again"])


@contextmanager
def aside(path: Path) -> Iterator[Path]:
    """Give a temporary file to write, which becomes `path` when the block ends; after an error nothing is left."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        if error.filename is None and error.errno is not None:  # a full disk does not say whose it was
            raise OSError(error.errno, error.strerror, str(path)) from None
        raise
    finally:
        temporary.unlink(missing_ok=True)
