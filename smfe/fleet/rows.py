"""Rows that one folder of results gives a catalogue: from its files alone, the same whenever they are the same.

Nothing of the run itself goes in: no time stamp, no duration, no path of the folder.
"""

from __future__ import annotations

import csv
import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from process.errors import InputError
from smfe.fleet.columns import Row, schema
from smfe.kept import KEPT
from smfe.results import read_groups, write_atomically

if TYPE_CHECKING:
    import pyarrow as pa

ROWS = "catalogue.parquet"
"""File of `KEPT` that holds the rows of one folder; and that of all, in the folder above."""

SUM = "catalogue.sha256"
"""File of `KEPT` that holds the checksum of the rows of one folder."""

_OF = b"of"
"""Key under which the rows of a folder say which results they are of."""


def rows_of(folder: Path) -> list[Row]:
    """Return the rows of a folder of results.

    Parameters
    ----------
    folder : Path
        As `smfe run` wrote it; its name is that of the campaign in the catalogue.

    Raises
    ------
    InputError
        When a file of results cannot be read.
    """
    try:
        return _rows(folder)
    except InputError:
        raise
    except (OSError, ValueError, LookupError, TypeError, AttributeError, csv.Error) as error:
        raise InputError(
            f"'{folder}': its results cannot be read any more ({type(error).__name__}: {error}); run the campaign "
            "again with --fresh"
        ) from error


def _rows(folder: Path) -> list[Row]:
    said = _provenance(folder)
    started = {name: _day(when) for name, when in said.get("started", {}).items()}
    days = sorted(day for day in started.values() if day is not None)
    head: Row = {
        "campaign": folder.name,
        "title": said.get("campaign"),
        "machine": said.get("machine") or said.get("campaign"),
        "tool": said.get("tool") or None,
        "material": said.get("material") or None,
        "date": days[0] if days else None,
    }
    faults = said.get("failures") or any(row.get("level") == "fault" for row in said.get("check", []))
    out = [{"kind": "campaign", "verdict": "faults" if faults else "done"}]
    settings = said.get("settings", {})
    for row in _peaks(folder / "frf.nc"):
        name, stated = row["measurement"], settings.get(row["measurement"], {})
        own: Row = {k: stated[k] for k in ("controller", "position") if stated.get(k)}
        if started.get(name) is not None:
            own["date"] = started[name]
        out.append({**own, **row})
    out += [
        *_limits(folder / "lobe_table.csv"),
        *_recommended(folder / "presets.json"),
        *_tests(folder / "chatter.csv"),
    ]
    out += _said(said)
    return [{**head, **row} for row in out]


def refused_rows(name: str, title: str, reason: str) -> list[Row]:
    """Return the rows of a campaign that was refused."""
    head: Row = {"campaign": name, "title": title, "machine": title}
    return [{**head, "kind": "campaign", "verdict": "refused", "text": reason}]


def write_rows(folder: Path) -> Path:
    """Write the rows of a folder of results into its `KEPT`, with their checksum and which results they are of."""
    import pyarrow as pa
    from pyarrow import parquet

    table = pa.Table.from_pylist(rows_of(folder), schema=schema())
    table = table.replace_schema_metadata({_OF: _results(folder).encode()})
    written = write_atomically(folder / KEPT / ROWS, lambda p: parquet.write_table(table, p))
    write_atomically(folder / KEPT / SUM, lambda p: p.write_text(_sum(folder), encoding="ascii"))
    return written


def are_written(folder: Path) -> bool:
    """Return whether the rows of a folder are there as they were written, and those of the results that it holds."""
    from pyarrow import parquet

    try:
        if (folder / KEPT / SUM).read_text(encoding="ascii") != _sum(folder):
            return False
        of = _results(folder)
    except (OSError, ValueError):
        return False
    said = parquet.read_schema(folder / KEPT / ROWS).metadata or {}
    return bool(said.get(_OF) == of.encode())


def read_rows(folder: Path) -> pa.Table:
    """Return the rows of a folder as they were written, without what says which results they are of."""
    from pyarrow import parquet

    return parquet.read_table(folder / KEPT / ROWS, schema=schema()).replace_schema_metadata(None)


def _sum(folder: Path) -> str:
    return hashlib.sha256((folder / KEPT / ROWS).read_bytes()).hexdigest()


def _results(folder: Path) -> str:
    """Return a hash of the protocol of a run: it holds the time of the run, and is another for each."""
    return hashlib.sha256((folder / "provenance.json").read_bytes()).hexdigest()


def _provenance(folder: Path) -> dict[str, Any]:
    found = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    return found if isinstance(found, dict) else {}


def _day(text: str) -> date | None:
    try:
        return date.fromisoformat(text[:10])
    except ValueError:
        return None


def _peaks(path: Path) -> Iterator[Row]:
    from smfe.comparison.peaks import entries, entry_peaks

    if not path.is_file():
        return
    for name, dataset in read_groups(path).items():
        method = str(dataset.attrs.get("method", ""))
        if method == "model":
            continue
        for response, excitation in entries(dataset):
            for number, peak in enumerate(entry_peaks(dataset, response, excitation), 1):
                yield {
                    "kind": "peak",
                    "measurement": name,
                    "method": method,
                    "response": response,
                    "excitation": excitation,
                    "peak": float(number),
                    "frequency_Hz": peak.frequency,
                    "frequency_std_Hz": peak.frequency_std,
                    "damping": peak.damping,
                    "damping_std": peak.damping_std,
                    "amplitude_um_per_N": 1e6 * peak.amplitude,
                    "amplitude_std_um_per_N": 1e6 * peak.amplitude_std,
                }


_LIMIT = (
    *("spindle_speed_rpm", "limit_depth_mm", "limit_depth_p05_mm", "limit_depth_p95_mm", "safe_depth_mm"),
    "chatter_frequency_Hz",
)


def _limits(path: Path) -> Iterator[Row]:
    """Yield the lowest and the highest limit of each source of each request; of equal ones that of the lowest speed."""
    found: dict[tuple[str, str], list[dict[str, str]]] = {}
    for row in _csv(path):
        found.setdefault((row["lobes"], row["source"]), []).append(row)
    for (lobes, source), rows in found.items():
        known = [(depth, row) for row in rows if (depth := _number(row["limit_depth_mm"])) is not None]
        for at, choose in (("lowest", min), ("highest", max)):
            if known:
                _, row = choose(known, key=_depth)
                numbers = {name: _number(row.get(name, "")) for name in _LIMIT}
                said = {"measurement": source, "method": row.get("method"), "lobes": lobes, "at": at}
                yield {"kind": "limit", **said, **numbers}


def _depth(of: tuple[float, dict[str, str]]) -> float:
    return of[0]


def _recommended(path: Path) -> Iterator[Row]:
    found = json.loads(path.read_text(encoding="utf-8")).get("recommendation") if path.is_file() else None
    if found and found.get("spindle_speed_rpm") is not None:
        said = {"measurement": found.get("source") or None, "lobes": found.get("lobes") or None, "at": "recommended"}
        numbers = {name: found.get(name) for name in (*_LIMIT, "depth_of_cut_mm") if name in found}
        yield {"kind": "limit", **said, **numbers, "verdict": found.get("status")}


def _tests(path: Path) -> Iterator[Row]:
    numbers = ("spindle_speed_rpm", "depth_of_cut_mm", "ratio", "chatter_frequency_Hz")
    texts = ("file", "verdict", "observed", "controller", "position")
    for row in _csv(path):
        said = {name: row.get(name) or None for name in texts}
        known = {name: _number(row.get(name, "")) for name in numbers}
        yield {"kind": "cutting_test", **said, **known, "text": row.get("reason") or None}


def _said(said: Mapping[str, Any]) -> Iterator[Row]:
    """Yield what the protocol of the run says: diagnosis, suspicions, warnings, failures, inputs."""
    if finding := said.get("finding"):
        summary = finding.get("summary") or [None]
        yield {"kind": "finding", "verdict": finding.get("verdict"), "text": summary[0]}
    for row in said.get("check", []):
        if row.get("level") in ("fault", "warning"):
            about = {"cause": row.get("cause"), "level": row["level"], "measurement": row.get("where")}
            yield {"kind": "suspicion", **about, "text": row.get("evidence")}
    for text in said.get("warnings", []):
        yield {"kind": "warning", "text": text}
    for row in said.get("failures", []):
        yield {"kind": "failure", "cause": row["part"], "measurement": row["name"] or None, "text": row["reason"]}
    for row in said.get("inputs", []):
        yield {"kind": "input", "file": row["file"], "sha256": row["sha256"]}


def _csv(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        return []
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


def _number(text: str | None) -> float | None:
    """Return a number of a CSV file; None where there is none, or nothing that a table could rank."""
    try:
        found = float(text or "nan")
    except ValueError:
        return None
    return None if math.isnan(found) else found
