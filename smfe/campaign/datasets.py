"""Public data sets by name: ``dataset:NAME/FILE`` -> a file on this machine.

The registry that is installed with the package (``registry.toml`` beside this module) says where a file is published,
under which licence and with which hash; ``$SMFE_REGISTRY`` may name one more, whose data sets come before it. No other
is looked for: a folder from a stranger says nothing about what is fetched. A file is downloaded, its hash is checked,
and it is kept; nothing of it is run or unpacked.
"""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections.abc import Callable
from pathlib import Path

import pooch
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from process.errors import InputError
from smfe.records.formats.channels import did_you_mean, listed

PREFIX = "dataset:"

INSTALLED = Path(__file__).with_name("registry.toml")
"""The registry that belongs to the package."""

Show = Callable[[str], None]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class DataFile(_Model):
    """One file of a data set: where it is published, and its hash."""

    sha256: str = Field(pattern="^[0-9a-f]{64}$")
    address: str = Field(pattern="^https?://")


class DataSet(_Model):
    """What the registry says about a data set."""

    title: str
    licence: str
    citation: str
    units: str
    facts: tuple[str, ...] = ()
    files: dict[str, DataFile]


def resolve(name: str, show: Show | None = None) -> Path:
    """Return the file that ``dataset:NAME/FILE`` stands for.

    Looked for in ``$SMFE_DATA/NAME/FILE``, then in the user's cache, where it must have the hash of the registry. Where
    it is in neither and `show` is given, it is fetched into the cache: the licence is shown, then the file is loaded
    and its hash checked.

    Parameters
    ----------
    name : str
        ``dataset:NAME/FILE``.
    show : callable, optional
        Called with the text to show before anything is fetched. None: never fetch.

    Raises
    ------
    InputError
        When the file is nowhere, or what was fetched is not the file that the registry describes.
    """
    dataset, _, file = name.removeprefix(PREFIX).partition("/")
    if not dataset or not file or ".." in Path(file).parts or ".." in Path(dataset).parts or Path(file).is_absolute():
        raise InputError(f"'{name}' does not name a file of a data set; write dataset:NAME/FILE")
    root = os.environ.get("SMFE_DATA")
    if root and (Path(root) / dataset / file).is_file():
        return Path(root) / dataset / file
    described, place = _described(name, dataset, file)
    target = cache() / dataset / file
    if target.is_file():
        with target.open("rb") as stream:
            if hashlib.file_digest(stream, "sha256").hexdigest() == place.sha256:
                return target
    if show is None:
        raise InputError(
            f"'{name}' is not on this machine: {_places(dataset, file)}; it is published as {place.address} "
            f"(licence: {described.licence}); allow it to be fetched, or put it into one of these places"
        )
    show(
        f"{name}\n{described.title}\nfrom {place.address}\nlicence: {described.licence}\ncitation: {described.citation}"
    )
    return fetch(place, target)


def cache() -> Path:
    """Return the user's cache folder for data sets."""
    return Path(pooch.os_cache("smfe"))


def read_registry(path: Path) -> dict[str, DataSet]:
    """Read a registry of data sets.

    Raises
    ------
    InputError
        When it is not there, no TOML, or an entry is not complete.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8-sig"))
        return {name: DataSet.model_validate(table) for name, table in tables.items()}
    except OSError as error:
        raise InputError(f"{path}: no registry of data sets: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"{path}: not a TOML file: {error}") from error
    except ValidationError as error:
        lines = [f"{'.'.join(map(str, e['loc']))}: {e['msg']}" for e in error.errors()]
        raise InputError(f"{path}: " + "; ".join(lines)) from error


def fetch(file: DataFile, target: Path) -> Path:
    """Fetch a file, check its hash and put it at `target`.

    Raises
    ------
    InputError
        When it cannot be had, or has another hash.
    """
    try:
        pooch.retrieve(file.address, known_hash=f"sha256:{file.sha256}", path=target.parent, fname=target.name)
    except Exception as error:  # whatever requests, urllib3 and pooch raise: no network, 404, another hash
        reason = " ".join(str(error).split())[:300]
        raise InputError(
            f"could not fetch {file.address}: {reason}; fetch it by hand to {target} (sha256 {file.sha256})"
        ) from error
    return target


def _described(name: str, dataset: str, file: str) -> tuple[DataSet, DataFile]:
    own = os.environ.get("SMFE_REGISTRY")
    registry = {**read_registry(INSTALLED), **(read_registry(Path(own)) if own else {})}
    if dataset not in registry:
        whose = f"nor in $SMFE_REGISTRY = {own}" if own else "and $SMFE_REGISTRY names no other"
        raise InputError(
            f"'{name}': no data set '{dataset}' in the registry of smfe{did_you_mean(dataset, registry)}, {whose}; "
            f"there are {listed(registry)}; a file of your own goes to $SMFE_DATA/{dataset}/{file}"
        )
    files = registry[dataset].files
    if file not in files:
        raise InputError(
            f"'{name}': no file '{file}' in data set '{dataset}'{did_you_mean(file, files)}; it has {listed(files)}"
        )
    return registry[dataset], files[file]


def _places(dataset: str, file: str) -> str:
    root = os.environ.get("SMFE_DATA")
    first = f"not at $SMFE_DATA = {Path(root) / dataset / file}" if root else "$SMFE_DATA is not set"
    return f"{first}, not at {cache() / dataset / file} (cache)"
