"""Which campaigns a command names, and what the folders of their results are called."""

from __future__ import annotations

import glob
import hashlib
import re
import tomllib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from process.errors import InputError
from smfe.commands.many.places import campaigns_at, is_address
from smfe.kept import KEPT

_LONGEST = 60
"""Characters of a name before what makes it unique: some file systems take 143, and results have names, too."""


@dataclass(frozen=True)
class Found:
    """A campaign file.

    Parameters
    ----------
    address : str
        Absolute path of the file, or an address that fsspec opens.
    name : str
        Of its folder of results: the last two words of the address that say something, and eight digits of its
        SHA-256. It depends on nothing else, so that another campaign beside it changes no name.
    measurements, tests : int
        How many ``[[measurement]]`` and ``[[cutting_test]]`` it has; 0 where it cannot be read.
    """

    address: str
    name: str
    measurements: int = 0
    tests: int = 0

    @property
    def size(self) -> int:
        """Measurements and cutting tests."""
        return self.measurements + self.tests


def is_one(named: object) -> bool:
    """Return whether an argument names one campaign: a file, or a campaign in memory; no folder, pattern or list."""
    if not isinstance(named, str | Path):
        return not isinstance(named, Iterable)
    if is_address(named):
        return False
    return Path(named).is_file() or not (Path(named).is_dir() or glob.has_magic(str(named)))


def find(named: Sequence[Path | str]) -> list[Found]:
    """Return the campaigns that files, folders and patterns name, each once, sorted by name.

    Of a folder these are all TOML files below it that hold ``[campaign]``; hidden folders and folders of results are
    passed over.

    Raises
    ------
    InputError
        When a folder or a pattern holds no campaign, or nothing is named.
    """
    if not named:
        raise InputError("no campaign is named; name campaign files, folders that hold some, or patterns")
    found: dict[str, Found] = {}
    for given in named:
        if isinstance(given, str) and is_address(given):
            at = campaigns_at(given)
            if not at:
                raise InputError(f"'{given}': no campaign there; name campaign files (TOML), folders, or patterns")
            for address in at:
                found.setdefault(address, Found(address, name_of(address)))
            continue
        paths = list(_paths(str(given).removeprefix("file://")))
        if not paths:
            raise InputError(f"'{given}': no campaign there; name campaign files (TOML), folders, or patterns")
        for path in paths:
            address = str(path.absolute())
            found.setdefault(address, Found(address, name_of(address), *_size(path)))
    return sorted(found.values(), key=lambda f: f.name)


def name_of(address: str) -> str:
    """Return the name of the folder of results of a campaign, by its address alone."""
    words = [w for w in PurePosixPath(address.replace("\\", "/")).with_suffix("").parts if w.strip("/") != "campaign"]
    said = re.sub(r"[^A-Za-z0-9.-]+", "_", "-".join(words[-2:])).strip("._-")[-_LONGEST:]
    return f"{said or 'campaign'}-{hashlib.sha256(address.encode()).hexdigest()[:8]}"


def _paths(given: Path | str) -> Iterator[Path]:
    path = Path(given)
    if path.is_dir():
        yield from _below(path)
    elif path.exists() or not glob.has_magic(str(given)):
        yield path
    else:
        for match in sorted(glob.glob(str(given), recursive=True)):
            yield from _below(Path(match)) if Path(match).is_dir() else [Path(match)]


def _below(folder: Path) -> Iterator[Path]:
    """Yield the campaigns below a folder, those of results left out."""
    if (folder / KEPT).is_dir() and (folder / "provenance.json").is_file():
        return
    for path in sorted(folder.iterdir()):
        if path.is_dir() and not path.is_symlink() and not path.name.startswith("."):
            yield from _below(path)
        elif path.suffix == ".toml" and path.is_file() and _is_campaign(path):
            yield path


def _is_campaign(path: Path) -> bool:
    """Return whether a TOML file is a campaign; one that cannot be read is, where it says so: its error is told."""
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return bool(re.search(rb"^\s*\[campaign\]", path.read_bytes(), re.MULTILINE))
    return "campaign" in raw and "scenario" not in raw


def _size(path: Path) -> tuple[int, int]:
    try:
        raw = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except (OSError, ValueError, RecursionError):
        return 0, 0
    tables = (raw.get("measurement", []), raw.get("cutting_test", []))
    measurements, tests = (len(t) if isinstance(t, list) else 0 for t in tables)
    return measurements, tests
