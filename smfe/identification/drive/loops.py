"""The drive loops of a campaign: identified, written beside the compliances, and audited."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from process.errors import InputError
from smfe.campaign import Campaign, Measurement
from smfe.identification.drive.loop import LoopResponse, identify_loop, summary
from smfe.identification.measurement import records_of
from smfe.results import MEASUREMENT, Failures, attempt, pack_warnings, read_groups, write_csv, write_groups

FILE = "loops.nc"


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
    out = {}
    gone = {f.name for f in failures or () if f.part == MEASUREMENT}
    for m in campaign.measurements:
        if m.method == "loop" and m.name not in gone:
            with attempt(failures, MEASUREMENT, m.name):
                out[m.name] = loop_of(m)
    return out


def loop_of(m: Measurement) -> LoopResponse:
    """Identify one measurement of method "loop"; see `loops_of`."""
    try:
        records = [record for entry in m.records for record in records_of(entry)]
        return identify_loop(m.name, records, period=m.period, settling=m.settling, frequency_range=m.frequency_range)
    except InputError as error:
        text = str(error)
        raise InputError(text if m.name in text else f"measurement '{m.name}': {text}") from error


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
