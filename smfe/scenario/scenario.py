"""The scenario as the rest of the package sees it: read, checked, with the machine built."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from process.compliance import ModalModel
from process.errors import InputError
from process.machine import Machine
from smfe.campaign.campaign import read_toml, report
from smfe.campaign.checks import Complaint
from smfe.campaign.messages import complaint
from smfe.records.words import did_you_mean
from smfe.scenario import schema
from smfe.scenario.build import build_machine, build_sensors, loaded_machine
from smfe.scenario.plan import Entry, Stand, entries

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
    path = Path(path).absolute()
    raw = read_toml(path, "scenario")
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
    found += _unknown_lobes(file, planned)
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
        if method is not None and method not in schema.TRIALS:
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
    seen: set[str] = {"machine"}
    for entry in planned:
        if entry.name in seen:
            yield ("trial", entry.trial, "name"), f"'{entry.name}' is already taken; give each trial a name of its own"
        seen.add(entry.name)


def _unknown_lobes(file: schema.ScenarioFile, planned: list[Entry]) -> Iterator[Complaint]:
    known = ["machine", *(entry.name for entry in planned if entry.method != "cut")]
    for i, lobes in enumerate(file.lobes):
        for k, name in enumerate(lobes.measurements):
            if name not in known:
                near = did_you_mean(name, known)
                yield ("lobes", i, "measurements", k), f"'{name}' is no measurement{near}; there are {', '.join(known)}"
