"""The campaign file of simulated records."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from process.labels import RECORD_SCALARS
from process.machine.modes import ModalModel
from smfe.records import Channel
from smfe.scenario.plan import Entry
from smfe.scenario.scenario import Scenario
from smfe.scenario.toml import table

Columns = Mapping[str, Channel]
File = tuple[str, Columns]


def campaign_text(scenario: Scenario, files: Sequence[Sequence[File]], notices: Sequence[str] = ()) -> str:
    """Return the campaign file: what was used, and one table for each entry with its files.

    Parameters
    ----------
    scenario : Scenario
        What was simulated.
    files : sequence
        For each entry of the scenario its records: file and the channels in it.
    notices : sequence of str, optional
        What its reader must know; written as comments.
    """
    used = [_union(columns for _, columns in one) for one in files]
    common = _common(scenario.entries, used)
    head = [f"Simulated from {scenario.path.name}, seed {scenario.file.scenario.seed}.", *notices]
    parts = ["".join(f"# {line}\n" for line in head)]
    parts.append(table("[campaign]", {"name": scenario.file.scenario.name}))
    parts += [table(f"[{name}]", scenario.raw[name]) for name in ("tool", "material") if name in scenario.raw]
    parts.append(table("[channels]", _declared(common)))
    if isinstance(scenario.machine, ModalModel):
        parts.append(table("[[model]]", {"name": "machine", "modes": scenario.raw["machine"]["modes"]}))
    for entry, one, columns in zip(scenario.entries, files, used, strict=True):
        own = {name: channel for name, channel in columns.items() if name not in common}
        parts.append(_cutting_test(entry, one[0][0], own) if entry.method == "cut" else _measurement(entry, one, own))
    parts += [table("[[lobes]]", lobes) for lobes in scenario.raw.get("lobes", ())]
    return "\n".join(parts)


def _common(entries: Sequence[Entry], used: Sequence[Columns]) -> Columns:
    """Return the channels that every entry reads: those of the spindle only cuts do."""
    cuts = [entry.method in ("sweep", "cut") for entry in entries]

    def everywhere(name: str) -> bool:
        wanted = [columns for columns, cut in zip(used, cuts, strict=True) if cut or name not in RECORD_SCALARS]
        return all(name in columns for columns in wanted)

    return {name: channel for name, channel in _union(used).items() if everywhere(name)}


def _union(all_columns: Iterable[Columns]) -> Columns:
    return {name: channel for columns in all_columns for name, channel in columns.items()}


def _declared(columns: Columns) -> dict[str, Any]:
    return {name: {"column": channel.column, "unit": channel.unit} for name, channel in columns.items()}


def _measurement(entry: Entry, files: Sequence[File], own: Columns) -> str:
    values: dict[str, Any] = {"name": entry.name, "method": entry.method, **entry.says}
    values["records"] = [{"file": file, **job.says} for (file, _), job in zip(files, entry.jobs, strict=True)]
    return table("[[measurement]]", values) + _channels("measurement", own)


def _cutting_test(entry: Entry, file: str, own: Columns) -> str:
    return table("[[cutting_test]]", {"file": file, **entry.says}) + _channels("cutting_test", own)


def _channels(above: str, own: Columns) -> str:
    return table(f"[{above}.channels]", _declared(own)) if own else ""
