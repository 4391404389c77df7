"""What becomes of a scenario: the records of its trials, the campaign file that reads them, and what is true.

The folder that holds them is made by `smfe.simulate`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import xarray as xr
from scipy import linalg

from process.drive.sampled_servo import SampledServo
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import Viscous
from process.instruments.trials import Running
from process.labels import RECORD_SCALARS
from process.machine.machine import FeedAxis, Machine
from process.machine.modes import ModalModel
from process.machine.structure import Posture
from process.simulation.problem import SampledControl
from process.units import show as quantity
from smfe.campaign.machine import MACHINE
from smfe.campaign.toml import table
from smfe.progress import Progress, silent
from smfe.records import Channel, record_columns, write_record_csv, write_record_netcdf
from smfe.results import Failure, Failures
from smfe.scenario.jobs import Entry, Job
from smfe.scenario.scenario import Scenario

J = TypeVar("J")
R = TypeVar("R")

Columns = Mapping[str, Channel]

CSV_VALUES = 250_000
"""Numbers in a record above which it is written as NetCDF."""

_TRUE_STEP = 0.25
"""Largest step of the true compliance [Hz]."""

_LEAST_BAND = 100.0
"""Frequency to which the true compliance goes at least [Hz]."""

_LEAST_DAMPING = 1e-3
"""Damping ratio below which the true compliance is not sampled more finely."""


CONDITION = "condition"
"""What a failure calls a condition that cannot be simulated."""


class NothingLeft(InputError):
    """No condition of a scenario can be simulated."""


def standing_axes(scenario: Scenario) -> list[str]:
    """Return a sentence for each sweep or cut that pushes an axis which stands still on friction that is not viscous.

    Such a machine is not linear: the axis sticks or slides with the cutting force.
    """
    machine = scenario.machine
    if not isinstance(machine, Machine):
        return []
    found: dict[tuple[int, str], str] = {}
    for entry in scenario.entries:
        if entry.method not in ("sweep", "cut"):
            continue
        feeds = machine.feeds(entry.running.feed)
        free = {a: axis for a, axis in machine.axes.items() if a not in entry.held}
        sliding = [a for a, axis in free.items() if not isinstance(axis.friction, Viscous)]
        standing = [a for a in sliding if feeds[a] == 0.0]
        if standing:
            found.setdefault((entry.trial, "".join(standing)), f"trial[{entry.trial}]: {_standing(standing, feeds)}")
    return list(found.values())


def _standing(standing: list[str], feeds: dict[str, float]) -> str:
    moving = next((v for v in feeds.values() if v), 500e-3 / 60.0)
    feed = ", ".join(f'{axis} = "{quantity(v or moving, "mm/min", "speed")}"' for axis, v in feeds.items())
    return (
        f"axis {', '.join(standing)} stands still on its friction while the cut pushes it: the result depends on the "
        f"force; give feed = {{ {feed} }} to move it, or read it as such"
    )


@dataclass(frozen=True)
class Written:
    """A record on disk: its file, as the campaign names it, and the channels that read it."""

    file: str
    channels: Mapping[str, Channel]


def write_records(
    scenario: Scenario,
    folder: Path,
    workers: int | None = None,
    progress: Progress = silent,
    failures: Failures | None = None,
) -> list[list[Written]]:
    """Simulate the records of a scenario and write them to ``folder/records``; return those of each entry.

    Each record has a stream of noise of its own, from the seed of the scenario: the numbers do not depend on `workers`.

    Parameters
    ----------
    scenario : Scenario
        What is simulated.
    folder : Path
        Gets the folder ``records``.
    workers, progress
        As of `run_all`.
    failures : list of Failure, optional
        Entries that it names are left out, and those of which a record cannot be simulated are added: they have no
        records in the result. None: the first error is raised.
    """
    (folder / "records").mkdir()
    jobs = [(entry.name, job) for entry in scenario.entries for job in entry.jobs]
    seeds = np.random.SeedSequence(scenario.file.scenario.seed).spawn(len(jobs))
    out = {failure.name for failure in failures or () if failure.part == CONDITION}
    wrong: dict[str, str] = {}

    def record(task: tuple[str, Job, np.random.SeedSequence]) -> Written | None:
        name, job, seed = task
        try:
            return _write_record(job, seed, folder / "records")
        except InputError as error:
            if failures is None:
                raise
            wrong.setdefault(name, str(error))
            return None

    tasks = [(name, job, seed) for (name, job), seed in zip(jobs, seeds, strict=True) if name not in out]
    written = iter(run_all(record, tasks, workers, progress, lambda task: f"record {task[1].file}"))
    found = {e.name: [] if e.name in out else [next(written) for _ in e.jobs] for e in scenario.entries}
    for entry in scenario.entries:
        if entry.name in wrong:
            for one in found[entry.name]:
                if one is not None:
                    (folder / one.file).unlink()
            found[entry.name] = []
            assert failures is not None
            failures.append(Failure(CONDITION, entry.name, wrong[entry.name]))
    return [[one for one in found[entry.name] if one is not None] for entry in scenario.entries]


def _write_record(job: Job, seed: np.random.SeedSequence, folder: Path) -> Written:
    try:
        record = job.make(rng=np.random.default_rng(seed))
    except InputError as error:
        raise InputError(f"record '{job.file}': {error}") from error
    channels = record_columns(record)
    if record.sizes["time"] * len(channels) > CSV_VALUES:
        path = write_record_netcdf(record, folder / f"{job.file}.nc")
    else:
        path = write_record_csv(record, folder / f"{job.file}.csv")
    return Written(f"records/{path.name}", channels)


def run_all(
    work: Callable[[J], R],
    jobs: Sequence[J],
    workers: int | None = None,
    progress: Progress = silent,
    label: Callable[[J], str] = str,
) -> list[R]:
    """Return ``[work(job) for job in jobs]``, several at a time; the first error ends it.

    Parameters
    ----------
    work : callable
        Must not depend on the order of the jobs: whatever is random comes from a seed in the job.
    jobs : sequence
        What to work on.
    workers : int, optional
        Jobs at a time; default: as many as there are cores.
    progress : callable, optional
        Called with (label of the job that is finished, done, of).
    label : callable, optional
        Names a job for the progress.
    """
    if workers is not None and workers < 1:
        raise InputError(f"{workers} workers; give at least 1, or none for all cores")
    results: dict[int, R] = {}
    progress("simulating", 0, len(jobs))
    with ThreadPoolExecutor(max_workers=workers or os.cpu_count()) as pool:
        futures = {pool.submit(work, job): i for i, job in enumerate(jobs)}
        try:
            for done, future in enumerate(as_completed(futures), 1):
                results[futures[future]] = future.result()
                progress(label(jobs[futures[future]]), done, len(jobs))
        finally:
            pool.shutdown(cancel_futures=True)
    return [results[i] for i in range(len(jobs))]


def campaign_text(scenario: Scenario, records: Sequence[Sequence[Written]], notices: Sequence[str] = ()) -> str:
    """Return the campaign file: what was used, and one table for each entry with its files.

    Parameters
    ----------
    scenario : Scenario
        What was simulated.
    records : sequence
        For each entry of the scenario its records; one without any is left out, also of the lobes.
    notices : sequence of str, optional
        What its reader must know; written as comments.
    """
    left = [(entry, one) for entry, one in zip(scenario.entries, records, strict=True) if one]
    used = [_union(record.channels for record in one) for _, one in left]
    common = _common([entry for entry, _ in left], used)
    head = [f"Simulated from {scenario.path.name}, seed {scenario.file.scenario.seed}.", *notices]
    parts = ["".join("# " + " ".join(line.split()) + "\n" for line in head)]
    parts.append(table("[campaign]", {"name": scenario.file.scenario.name}))
    parts += [table(f"[{name}]", scenario.raw[name]) for name in ("tool", "material") if name in scenario.raw]
    parts.append(table("[channels]", _declared(common)))
    parts += _machine(scenario)
    runs = _runs(scenario, [entry for entry, _ in left])
    for (entry, one), columns in zip(left, used, strict=True):
        own = {name: channel for name, channel in columns.items() if name not in common}
        if entry.name in runs:
            together = [(e, files) for e, files in left if runs.get(e.name) == runs[entry.name]]
            parts += [_steady_runs(runs[entry.name], together, own)] if together[0][0] is entry else []
            continue
        parts.append(_cutting_test(entry, one[0].file, own) if entry.method == "cut" else _measurement(entry, one, own))
    gone = {entry.name for entry in scenario.entries} - {entry.name for entry, _ in left}
    for lobes in scenario.raw.get("lobes", ()):
        names = [name for name in lobes["measurements"] if name not in gone]
        parts += [table("[[lobes]]", {**lobes, "measurements": names})] if names else []
    return "\n".join(parts)


def _machine(scenario: Scenario) -> list[str]:
    """Return what the campaign says of the machine.

    Its name and feed; its modes, where it has modes alone, as a model; axes, joints and postures only where the lobes
    ask for them: a campaign that measures a machine does not know it.
    """
    raw = scenario.raw["machine"]
    asked = any(MACHINE in lobes["measurements"] for lobes in scenario.raw.get("lobes", ()))
    if isinstance(scenario.machine, ModalModel):
        known = {key: raw[key] for key in ("name", "maximum_feed") if key in raw}
        head = [table("[machine]", known)] if known else []
        return [*head, table("[[model]]", {"name": MACHINE, "modes": raw["modes"]})]
    known = {key: value for key, value in raw.items() if asked or key in ("name", "maximum_feed")}
    tables = {f"[machine.axis.{axis}]": values for axis, values in known.pop("axis", {}).items()}
    tables |= {f"[machine.{key}]": known.pop(key) for key in list(known) if isinstance(known[key], Mapping)}
    head = [table("[machine]", known)] if known or tables else []
    return head + [table(name, values) for name, values in tables.items()]


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


def _measurement(entry: Entry, records: Sequence[Written], own: Columns) -> str:
    values: dict[str, Any] = {"name": entry.name, "method": entry.method, **entry.says}
    values["records"] = [{"file": record.file, **job.says} for record, job in zip(records, entry.jobs, strict=True)]
    return table("[[measurement]]", values) + _channels("measurement", own)


def _runs(scenario: Scenario, entries: Sequence[Entry]) -> dict[str, str]:
    """Return entry -> measurement for drives without a force at several feeds: together they give a friction curve."""
    groups: dict[tuple[int, str], list[Entry]] = {}
    for entry in entries:
        if entry.method == "drive" and "force_level" not in entry.says:
            rest = {key: value for key, value in entry.says.items() if key != "feed"}
            groups.setdefault((entry.trial, repr(rest)), []).append(entry)
    out: dict[str, str] = {}
    for (trial, _), members in groups.items():
        alone = sum(key[0] == trial for key in groups) == 1
        first, base = members[0], scenario.file.trial[trial].name or members[0].method
        name = base if alone else "_".join([base, *(str(v) for k, v in first.says.items() if k != "feed")])
        if len(members) > 1:
            out |= dict.fromkeys((entry.name for entry in members), name)
    return out


def _steady_runs(name: str, runs: Sequence[tuple[Entry, Sequence[Written]]], own: Columns) -> str:
    """Return the measurement of runs at several feeds, each record with its own."""
    first = runs[0][0]
    values = {"name": name, "method": first.method, **{k: v for k, v in first.says.items() if k != "feed"}}
    values["records"] = [{"file": files[0].file, "feed": entry.says["feed"]} for entry, files in runs]
    return table("[[measurement]]", values) + _channels("measurement", own)


def _cutting_test(entry: Entry, file: str, own: Columns) -> str:
    return table("[[cutting_test]]", {"file": file, **entry.says}) + _channels("cutting_test", own)


def _channels(above: str, own: Columns) -> str:
    return table(f"[{above}.channels]", _declared(own)) if own else ""


def truths(scenario: Scenario, failures: Failures | None = None) -> dict[str, xr.Dataset]:
    """Return the true compliance of the bare machine for each entry of the campaign, for small vibration.

    Friction and joints are linearised; sampled servos act continuously, equal up to the second order of their period.
    A machine that vibrates by itself has none; a record that nothing excites shows just that, and needs none.

    Parameters
    ----------
    scenario : Scenario
        What is simulated.
    failures : list of Failure, optional
        Collects the entries in which the machine is not stable. None: they are an error.

    Raises
    ------
    InputError
        When the machine is not stable in one of them; all are named at once.
    """
    out: dict[str, xr.Dataset] = {}
    wrong: dict[str, str] = {}
    known: dict[str, xr.Dataset] = {}
    frequency = _frequencies([_braked(scenario.machine, held) for held in {(): None, **_brakes(scenario)}])
    for entry in scenario.entries:
        key = repr((entry.running, entry.held))
        try:
            if key not in known:
                known[key] = _true(_braked(scenario.machine, entry.held), entry.running, frequency)
        except InputError as error:
            if failures is not None and entry.method != "silent":
                failures.append(Failure(CONDITION, entry.name, str(error)))
            elif failures is None:
                wrong[f"trial[{entry.trial}], {entry.name}"] = str(error)
            continue
        out[entry.name] = known[key].assign_attrs(method="truth", truth=_meaning(scenario.machine), **_flat(entry))
    if wrong:
        lines = [f"{name}: {text}" for name, text in wrong.items()]
        raise InputError("\n  ".join([f"{scenario.path.name}: the machine cannot be measured", *lines]))
    return out


def _braked(machine: Machine | ModalModel, held: Sequence[str]) -> Machine | ModalModel:
    return machine.braked(held) if isinstance(machine, Machine) and held else machine


def _meaning(machine: Machine | ModalModel) -> str:
    if isinstance(machine, ModalModel):
        return "linear machine at rest: the same at every force"
    return "small vibration about uniform motion or rest: friction and joints linearised"


def _flat(entry: Entry) -> dict[str, str]:
    """Return the conditions as texts; a small vibration has no force level."""
    return {key: str(value) for key, value in entry.says.items() if key != "force_level"}


def _true(machine: Machine | ModalModel, running: Running, frequency: Sequence[float]) -> xr.Dataset:
    if isinstance(machine, ModalModel):
        return machine.compliance(frequency)
    if running.control is not None:
        machine = _continuous(machine, running.control)
    return machine.at(running.feed, running.controller, running.position).compliance(frequency)


def _continuous(machine: Machine, control: SampledControl) -> Machine:
    """Return the machine whose servos act continuously and equal sampled ones up to the second order of the period.

    An encoder with steps gives the velocity as a difference: ``Kv + s exp(-s T/2)`` is
    ``exp(-s T/2) [(1 + Kv T/2) s + Kv]`` to that order.
    """
    late = 0.5 * control.period if control.encoder_resolution > 0.0 else 0.0

    def equal(servo: Servo) -> Servo:
        found = SampledServo(servo, control.period, control.lag).continuous()
        more = 1.0 + found.Kv * late
        return replace(found, Kp=found.Kp * more, Kv=found.Kv / more, delay=found.delay + late)

    def slower(axis: FeedAxis) -> FeedAxis:
        assert isinstance(axis.servo, Mapping)
        return replace(axis, servo={name: equal(servo) for name, servo in axis.servo.items()})

    return replace(machine, axes={n: slower(a) if a.servo is not None else a for n, a in machine.axes.items()})


def _brakes(scenario: Scenario) -> dict[tuple[str, ...], None]:
    """Return which axes brakes hold in one condition or another."""
    return dict.fromkeys(entry.held for entry in scenario.entries)


def _frequencies(machines: Iterable[Machine | ModalModel]) -> Any:
    """Return 1 Hz to three times the last mode, ten lines in the narrowest half-power band of all machines."""
    modes = [(m.frequency, m.damping) if isinstance(m, ModalModel) else _elastic_modes(m) for m in machines]
    step = min(_TRUE_STEP, *(float(np.min(2.0 * zeta * f, initial=np.inf)) / 10.0 for f, zeta in modes))
    last = max(float(f.max(initial=0.0)) for f, _ in modes)
    return np.arange(1.0, max(3.0 * last, _LEAST_BAND), step)


def _elastic_modes(machine: Machine) -> tuple[Any, Any]:
    """Return frequency [Hz] and damping ratio [1] of the modes with free slides and without joints."""
    structure = machine.structure.structures[0] if isinstance(machine.structure, Posture) else machine.structure
    squares, shapes = linalg.eigh(structure.stiffness, structure.mass)
    w = np.sqrt(np.clip(squares, 0.0, None))
    damping = np.einsum("ir,ij,jr->r", shapes, structure.damping, shapes) / (2.0 * np.maximum(w, 1.0))
    elastic = w > 2.0 * np.pi
    return w[elastic] / (2.0 * np.pi), np.maximum(damping[elastic], _LEAST_DAMPING)
