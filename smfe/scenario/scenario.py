"""The scenario as the rest of the package sees it: read, checked, with the machine built."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from process.errors import InputError
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from smfe.campaign.campaign import read_toml, report
from smfe.campaign.checks import Complaint, check, complaint
from smfe.campaign.machine import MACHINE, build_machine
from smfe.campaign.methods import COMPLIANCE_METHODS
from smfe.records.formats.channels import did_you_mean, listed
from smfe.scenario import schema
from smfe.scenario.build import build_sensors, loaded_machine
from smfe.scenario.jobs import Entry, Stand, entries

T = TypeVar("T")


@dataclass(frozen=True)
class Scenario:
    """A scenario file, read and checked.

    Parameters
    ----------
    path : Path
        The file.
    raw : mapping
        Its tables as they were written.
    file : ScenarioFile
        Its tables in SI.
    machine : Machine or ModalModel
        The bare machine: what is true.
    entries : tuple of Entry
        What the campaign will hold, with the jobs that make its records.
    """

    path: Path
    raw: Mapping[str, Any]
    file: schema.ScenarioFile
    machine: Machine | ModalModel
    entries: tuple[Entry, ...]


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file, build its machine and plan its trials.

    Raises
    ------
    InputError
        With every error of the file at once, each with its place.
    """
    if not isinstance(path, Path | str):
        raise InputError(f"{type(path).__name__} is no scenario; give the path of a scenario file")
    path = Path(path).absolute()
    raw = read_toml(path, "scenario")
    if "campaign" in raw and "scenario" not in raw:
        raise InputError(f"{path.name}: this is a campaign; smfe run {path.name} evaluates it")
    found = list(_methods(raw))
    try:
        file = schema.ScenarioFile.model_validate(raw)
    except ValidationError as error:
        raise InputError(report(path, [*_complaints(error), *found])) from error
    machine = _collected(found, ("machine",), partial(build_machine, file.machine))
    if machine is None:
        raise InputError(report(path, found))
    planned: list[Entry] = []
    for i, trial in enumerate(file.trial):
        sensors = _collected(found, ("sensors",), partial(build_sensors, file.sensors, trial.method))
        if sensors is None:
            break
        stand = Stand(file, machine, loaded_machine(machine, file.sensors), sensors, i)
        planned += _collected(found, ("trial", i), partial(entries, stand)) or []
    found += _clashes(planned)
    found += [] if found else _refused(raw, planned)
    if found:
        raise InputError(report(path, found))
    return Scenario(path, raw, file, machine, tuple(planned))


def _collected(found: list[Complaint], where: tuple[str | int, ...], make: Callable[[], T]) -> T | None:
    """Call, and put what is wrong to the other complaints."""
    try:
        return make()
    except InputError as error:
        found.append((where, str(error)))
        return None


def _methods(raw: Mapping[str, Any]) -> Iterator[Complaint]:
    trials = raw.get("trial")
    for i, trial in enumerate(trials if isinstance(trials, list) else []):
        method = trial.get("method") if isinstance(trial, dict) else None
        if method is not None and not (isinstance(method, str) and method in schema.TRIALS):
            near = did_you_mean(str(method), schema.TRIALS)
            yield ("trial", i, "method"), f"method {method!r} is not known{near}; available: {', '.join(schema.TRIALS)}"


def _complaints(error: ValidationError) -> Iterator[Complaint]:
    """Return each error; those inside a trial know the keys of its method, which pydantic puts into the place."""
    for details in error.errors():
        place = details["loc"]
        if details["type"] == "union_tag_invalid":
            continue
        if details["type"] == "union_tag_not_found":
            yield (*place, "method"), f"is missing; add it: {', '.join(schema.TRIALS)}"
        elif len(place) > 2 and place[0] == "trial":
            details["loc"] = place[3:]
            where, text = complaint(details, schema.TRIALS[str(place[2])])
            yield (*place[:2], *where), text
        else:
            yield complaint(details, schema.ScenarioFile)


def _clashes(planned: list[Entry]) -> Iterator[Complaint]:
    seen: set[str] = {MACHINE}
    for entry in planned:
        if entry.name in seen:
            yield ("trial", entry.trial, "name"), f"'{entry.name}' is already taken; give each trial a name of its own"
        seen.add(entry.name)


def _refused(raw: Mapping[str, Any], planned: list[Entry]) -> Iterator[Complaint]:
    """Return why the campaign that would be written could not be run: too few passes of a sweep, lobes of nothing."""
    measured = [entry for entry in planned if entry.method != "cut"]
    draft = {key: raw[key] for key in ("machine", "tool", "material", "lobes") if key in raw}
    draft["measurement"] = [
        {"name": entry.name, "method": entry.method, "records": [dict(job.says) for job in entry.jobs]}
        for entry in measured
    ]
    seen: set[tuple[str | int, ...]] = set()
    for where, text in itertools.chain(_no_compliance(raw, measured), check(draft)):
        place = ("trial", measured[int(where[1])].trial, "passes") if where[0] == "measurement" else where
        if place not in seen:
            seen.add(place)
            yield place, text


def _no_compliance(raw: Mapping[str, Any], measured: list[Entry]) -> Iterator[Complaint]:
    """Lobes of what has none: a drive or silent trial measures no compliance."""
    methods = {entry.name: entry.method for entry in measured}
    usable = listed(name for name, method in methods.items() if method in COMPLIANCE_METHODS)
    for i, lobes in enumerate(raw.get("lobes", ())):
        for k, name in enumerate(lobes["measurements"]):
            if methods.get(name, "hammer") not in COMPLIANCE_METHODS:
                where = ("lobes", i, "measurements", k)
                yield where, f"'{name}' is a {methods[name]} trial and gives no compliance; there are {usable}"
