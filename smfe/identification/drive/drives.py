"""The drives and the drive loops of a campaign: identified, written beside the compliances, and put into sentences.

Drives give inertia and friction (``drives.csv``), open loops masses and stiffness beside a response of the carriage
(``open_loops.nc``), loops a frequency response (``loops.nc``); none is a compliance of the tool.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TypeVar

import pandas as pd
import xarray as xr

from process.errors import InputError
from smfe.campaign import Campaign, Measurement
from smfe.identification.drive.loop import LoopResponse, identify_loop, summary
from smfe.identification.drive.motion import KINDS, drives_in, moves
from smfe.identification.drive.open_loop_runs import OpenLoop, identify_open_loop
from smfe.identification.drive.parameters import identify_drive
from smfe.identification.drive.results import DriveFit
from smfe.identification.measurement import records_of
from smfe.progress import Progress, silent
from smfe.results import MEASUREMENT, Failures, as_named, attempt, pack_warnings, read_groups, write_csv, write_groups

T = TypeVar("T")

DRIVE_FILE = "drives.csv"

LOOP_FILE = "loops.nc"

OPEN_LOOP_FILE = "open_loops.nc"

COLUMNS = ("measurement", "axis", "parameter", "direction", "value", "std", "low", "high", "unit", "note")
"""Columns of the table; low and high are the 95 % interval, and a value that was not determined is empty."""


Drives = Mapping[str, Sequence[DriveFit]]
"""Measurement -> its drives, one an axis."""


def drives_of(
    campaign: Campaign, failures: Failures | None = None, progress: Progress = silent
) -> dict[str, list[DriveFit]]:
    """Identify every measurement of method "drive".

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    failures : list of Failure, optional
        Collects measurements whose records do not allow it; those that it holds already are left out. None: the first
        one is raised.
    progress : callable, optional
        Called with (what, done, of).

    Raises
    ------
    InputError
        With the measurement's name, when its records do not allow it.
    """
    return _each(campaign, "drive", drive_of, failures, progress)


def drive_of(m: Measurement) -> list[DriveFit]:
    """Identify the axes of one measurement of method "drive"; see `drives_of`. Axes that stand still are left out."""
    with _records(m) as records:
        highest = None if m.frequency_range is None else m.frequency_range[1]
        pairs = drives_in(records)
        moving = [pair for pair in pairs if all(moves(r, *pair) for r in records)] or pairs
        return [identify_drive(m.name, records, a, known=m.moving_mass, highest=highest) for _, a in moving]


def _each(
    campaign: Campaign,
    method: str,
    identify: Callable[[Measurement], T],
    failures: Failures | None,
    progress: Progress = silent,
) -> dict[str, T]:
    """Identify every measurement of a method that has not failed before."""
    out = {}
    gone = {f.name for f in failures or () if f.part == MEASUREMENT}
    wanted = [m for m in campaign.measurements if m.method == method and m.name not in gone]
    for done, m in enumerate(wanted):
        progress(f"identifying {m.name}", done, len(wanted))
        with attempt(failures, MEASUREMENT, m.name):
            out[m.name] = identify(m)
    return out


@contextmanager
def _records(m: Measurement) -> Iterator[list[xr.Dataset]]:
    """Read the records of a measurement; what is wrong with them is said with its name."""
    try:
        yield [record for entry in m.records for record in records_of(entry)]
    except InputError as error:
        text = str(error)
        raise InputError(text if m.name in text else f"measurement '{m.name}': {text}") from error


def as_table(drives: Drives, open_loops: Mapping[str, OpenLoop] | None = None) -> pd.DataFrame:
    """Return a row a parameter, with the columns `COLUMNS`."""
    rows = []
    everything: list[tuple[str, DriveFit | OpenLoop]] = [(name, fit) for name, fits in drives.items() for fit in fits]
    for name, fit in everything + list((open_loops or {}).items()):
        for p in fit.parameters:
            row = asdict(p) | {"measurement": name, "axis": fit.axis, "parameter": p.name}
            rows.append({column: row[column] for column in COLUMNS})
    return pd.DataFrame(rows, columns=list(COLUMNS))


def write_drives(
    path: Path, drives: Drives, tables: Path | None = None, open_loops: Mapping[str, OpenLoop] | None = None
) -> None:
    """Write the table, and beside it friction over velocity of each axis; without any drive, take an old file away."""
    if not drives and not open_loops:
        path.unlink(missing_ok=True)
        return
    write_csv(path, as_table(drives, open_loops))
    for name, fits in drives.items() if tables is not None else ():
        for fit in fits:
            units = KINDS[fit.rotary][3]
            named = {"velocity": f"velocity [{units['motion']}/s]"} | {
                column: f"{column} [{units['force']}]" for column in ("force", "low", "high")
            }
            assert tables is not None
            write_csv(tables / f"{name}.friction_{fit.axis}.csv", fit.friction.rename(columns=named))


def drive_lines(path: Path) -> list[str]:
    """Return what a table says in sentences; nothing where there is no file."""
    if not path.is_file():
        return []
    rows = as_named(pd.read_csv(path, keep_default_na=False, na_values=[""])).to_dict("records")
    return [sentence({str(key): value for key, value in row.items()}) for row in rows]


def sentence(row: Mapping[str, object]) -> str:
    """Return one row of the table as a sentence."""
    value, low, high = (float(str(row[name])) for name in ("value", "low", "high"))
    way = "" if row["direction"] == "both" else f" {row['direction']}"
    what = f"{row['measurement']}, axis {row['axis']}: {str(row['parameter']).replace('_', ' ')}{way}"
    note = str(row["note"]) if isinstance(row["note"], str) else ""
    if math.isfinite(value):
        return f"{what} {value:.4g} {row['unit']}, 95 % interval {low:.4g} to {high:.4g}" + (f"; {note}" * bool(note))
    bound = f", at most {high:.4g} {row['unit']}" if math.isfinite(high) and high > 0.0 else ""
    return f"{what}: {note}{bound}"


def notes_of(drives: Drives) -> list[str]:
    """Return what was noticed, by measurement, and whether the inertia was not determined."""
    out = []
    for name, fits in drives.items():
        for fit in fits:
            where = f"{name}, axis {fit.axis}"
            out += [f"{where}: {note}" for note in fit.notes]
            out += [f"{where}: {p.name} {p.note}" for p in fit.parameters if p.name == "inertia" and p.note]
    return out


# --- open loops -------------------------------------------------------------------------------------------------------


def open_loops_of(campaign: Campaign, failures: Failures | None = None) -> dict[str, OpenLoop]:
    """Identify every measurement of method "open_loop".

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    failures : list of Failure, optional
        Collects measurements whose records do not allow it. None: the first one is raised.

    Raises
    ------
    InputError
        With the measurement's name, when its records do not allow it.
    """
    return _each(campaign, "open_loop", open_loop_of, failures)


def open_loop_of(m: Measurement) -> OpenLoop:
    """Identify one measurement of method "open_loop"; see `open_loops_of`."""
    with _records(m) as records:
        return identify_open_loop(
            m.name,
            records,
            period=m.period,
            settling=m.settling,
            frequency_range=m.frequency_range,
            hold=m.hold or 0.0,
        )


def write_open_loops(path: Path, open_loops: Mapping[str, OpenLoop]) -> None:
    """Write the responses as groups ``measurement/direction`` of one file; without any, take an old file away."""
    if not open_loops:
        path.unlink(missing_ok=True)
        return
    groups = {
        f"{name}/{way}": pack_warnings(data, found.notes)
        for name, found in open_loops.items()
        for way, data in found.response.items()
    }
    write_groups(path, groups)


# --- drive loops ------------------------------------------------------------------------------------------------------


def loops_of(campaign: Campaign, failures: Failures | None = None) -> dict[str, LoopResponse]:
    """Identify every measurement of method "loop".

    Parameters
    ----------
    campaign : Campaign
        The campaign.
    failures : list of Failure, optional
        Collects measurements whose records do not allow it. None: the first one is raised.

    Raises
    ------
    InputError
        With the measurement's name, when its records do not allow it.
    """
    return _each(campaign, "loop", loop_of, failures)


def loop_of(m: Measurement) -> LoopResponse:
    """Identify one measurement of method "loop"; see `loops_of`."""
    with _records(m) as records:
        return identify_loop(m.name, records, period=m.period, settling=m.settling, frequency_range=m.frequency_range)


def write_loops(path: Path, loops: Mapping[str, LoopResponse], tables: Path | None = None) -> None:
    """Write the responses as groups of one file, and a table a measurement; without any, take an old file away."""
    if not loops:
        path.unlink(missing_ok=True)
        return
    groups = {}
    for name, found in loops.items():
        groups[name] = pack_warnings(found.response, found.notes).assign_attrs(summary=json.dumps(summary(found)))
        if tables is not None:
            write_csv(tables / f"{name}.loop.csv", found.table)
    write_groups(path, groups)


def loop_lines(path: Path) -> list[str]:
    """Return what a file of responses says in sentences; nothing where there is no file."""
    if not path.is_file():
        return []
    return [f"{n}: {text}" for n, data in read_groups(path).items() for text in json.loads(data.attrs["summary"])]
