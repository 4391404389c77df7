"""Parts of a campaign that fail: each alone, with its reason kept for every output."""

from __future__ import annotations

import json
import traceback
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import xarray as xr

from process.errors import InputError

FAILED = "failed"
"""What stands in a table where a verdict or a prediction would have stood."""

MEASUREMENT, LOBES, TEST, PREDICTION = "measurement", "lobes", "cutting test", "prediction"
"""Kinds of parts that the report shows in a place of their own."""


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
    """

    part: str
    name: str
    reason: str

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
    the results of the others, and is said with the place where it happened. An interruption ends everything.

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
        if failures is None:
            raise
        failures.append(failure_of(part, name, error))


def failure_of(part: str, name: str, error: Exception) -> Failure:
    """Return what an error makes of a part; its reason does not say once more which part it was."""
    return Failure(part, name, _reason(error).removeprefix(f"{part} '{name}': "))


def _reason(error: Exception) -> str:
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
    rows = [asdict(f) for f in failures]
    return {"failures": json.dumps(rows)} if rows else {}


def unpack(content: Mapping[str, object]) -> Failures:
    """Return the failures in the attributes of a file, or in what provenance.json holds."""
    found = content.get("failures", [])
    rows = json.loads(found) if isinstance(found, str) else found
    if not isinstance(rows, list):
        return []
    return [Failure(*(str(r.get(k, "")) for k in ("part", "name", "reason"))) for r in rows if isinstance(r, dict)]


def of_file(path: Path) -> Failures:
    """Return what a NetCDF-4 file of results says is missing in it."""
    if not path.is_file():
        return []
    with xr.open_dataset(path, engine="h5netcdf") as root:
        return unpack(dict(root.attrs))


def as_rows(failures: Iterable[Failure]) -> list[dict[str, str]]:
    """Return one row a failure, for JSON."""
    return [asdict(f) for f in failures]
