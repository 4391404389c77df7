"""From a scenario to a folder: records, the campaign that reads them, what is true, and the scenario itself."""

from __future__ import annotations

import importlib.metadata
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
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
from process.simulation.machine import SampledControl
from process.units import show as quantity
from smfe._version import __version__
from smfe.campaign.datasets import Show
from smfe.campaign.toml import table
from smfe.identification.errors.result import Progress, silent
from smfe.records import Channel, record_columns, write_record_csv, write_record_netcdf
from smfe.records.formats.channels import listed
from smfe.results import write_groups
from smfe.scenario.jobs import Entry, Job
from smfe.scenario.scenario import Scenario, load_scenario


def to_stderr(text: str) -> None:
    """Show a notice where nothing else is given to show it."""
    print(f"notice: {text}", file=sys.stderr)


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
        rubbing = [a for a, axis in machine.axes.items() if not isinstance(axis.friction, Viscous)]
        standing = [a for a in rubbing if feeds[a] == 0.0]
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


def left_behind(folder: Path, written: Iterable[str]) -> list[str]:
    """Return a sentence about records in the folder of records that this scenario has not written."""
    new = set(written)
    old = sorted(path.name for path in folder.iterdir() if path.is_file() and path.name not in new)
    if not old:
        return []
    return [
        f"{folder} also holds {len(old)} file(s) of an earlier scenario, which the campaign does not read: "
        f"{listed(old, 8)}; delete them where nothing else does"
    ]


# --- The campaign file that reads the records: its text.

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


# --- Many independent jobs on all cores.

J = TypeVar("J")
R = TypeVar("R")


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


# --- The folder.

CSV_VALUES = 250_000
"""Numbers in a record above which it is written as NetCDF."""

_TRUE_STEP = 0.25
"""Largest step of the true compliance [Hz]."""

_LEAST_BAND = 100.0
"""Frequency to which the true compliance goes at least [Hz]."""

_LEAST_DAMPING = 1e-3
"""Damping ratio below which the true compliance is not sampled more finely."""


@dataclass(frozen=True)
class _Task:
    """One record: its job, its seed, and where it goes."""

    job: Job
    seed: np.random.SeedSequence
    folder: Path


@dataclass(frozen=True)
class Written:
    """A record on disk: its name and the channels that read it."""

    file: str
    channels: Mapping[str, Channel]


def simulate(
    scenario: Path | str,
    out: Path | str,
    workers: int | None = None,
    progress: Progress = silent,
    show: Show = to_stderr,
) -> Path:
    """Simulate the trials of a scenario and write their records with the campaign file that reads them.

    Everything is made in a temporary folder and moved to `out` when it is complete. The same scenario makes the same
    numbers, with any number of workers.

    Parameters
    ----------
    scenario : path
        Scenario file.
    out : path
        Folder for ``campaign.toml``, ``records/``, ``truth.nc`` and ``scenario.toml``; made when missing.
    workers : int, optional
        Records at a time; default: as many as there are cores.
    progress : callable, optional
        Called with (record that is finished, done, of).
    show : callable, optional
        Called with each notice: axes that stand still in a cut, records of an earlier scenario in `out`; default:
        printed to stderr.

    Returns
    -------
    Path
        The campaign file.

    Raises
    ------
    InputError
        When the scenario is wrong; nothing is then written.
    """
    loaded = load_scenario(scenario)
    true = truths(loaded)
    notices = standing_axes(loaded)
    for notice in notices:
        show(notice)
    with _made_aside(Path(out)) as folder:
        (folder / "records").mkdir()
        jobs = [job for entry in loaded.entries for job in entry.jobs]
        seeds = np.random.SeedSequence(loaded.file.scenario.seed).spawn(len(jobs))
        tasks = [_Task(job, seed, folder / "records") for job, seed in zip(jobs, seeds, strict=True)]
        written = iter(run_all(_record, tasks, workers, progress, lambda task: f"record {task.job.file}"))
        records = [[next(written) for _ in entry.jobs] for entry in loaded.entries]
        write_groups(folder / "truth.nc", true)
        (folder / "scenario.toml").write_text(_with_versions(loaded), encoding="utf-8")
        text = campaign_text(loaded, [[(w.file, w.channels) for w in one] for one in records], notices)
        (folder / "campaign.toml").write_text(text, encoding="utf-8")
    for notice in left_behind(Path(out) / "records", (Path(w.file).name for one in records for w in one)):
        show(notice)
    return Path(out) / "campaign.toml"


def _record(task: _Task) -> Written:
    """Simulate and write one record."""
    try:
        record = task.job.make(rng=np.random.default_rng(task.seed))
    except InputError as error:
        raise InputError(f"record '{task.job.file}': {error}") from error
    channels = record_columns(record)
    if record.sizes["time"] * len(channels) > CSV_VALUES:
        path = write_record_netcdf(record, task.folder / f"{task.job.file}.nc")
    else:
        path = write_record_csv(record, task.folder / f"{task.job.file}.csv")
    return Written(f"records/{path.name}", channels)


def _with_versions(scenario: Scenario) -> str:
    packages = ("numpy", "scipy", "numba", "xarray")
    versions = ", ".join([f"smfe {__version__}", *(f"{p} {importlib.metadata.version(p)}" for p in packages)])
    text = scenario.path.read_text(encoding="utf-8")
    return f"# simulated with seed {scenario.file.scenario.seed} by {versions}\n{text}"


@contextmanager
def _made_aside(out: Path) -> Iterator[Path]:
    """Yield an empty folder beside `out`; what is in it in the end goes to `out`, the campaign file last."""
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file; name a folder")
    out.parent.mkdir(parents=True, exist_ok=True)
    aside = Path(tempfile.mkdtemp(prefix=f".{out.name}.", suffix=".part", dir=out.parent))
    try:
        yield aside
        for path in sorted(p for p in aside.rglob("*") if p.is_file() and p.name != "campaign.toml"):
            target = out / path.relative_to(aside)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.replace(path, target)
        os.replace(aside / "campaign.toml", out / "campaign.toml")
    finally:
        shutil.rmtree(aside, ignore_errors=True)


# --- what is true -------------------------------------------------------------------------------------------


def truths(scenario: Scenario) -> dict[str, xr.Dataset]:
    """Return the true compliance of the bare machine for each entry of the campaign, for small vibration.

    Friction and joints are linearised; sampled servos act continuously, equal up to the second order of their period.

    Raises
    ------
    InputError
        When the machine is not stable in one of them; all are named at once.
    """
    out: dict[str, xr.Dataset] = {}
    wrong: dict[str, str] = {}
    known: dict[str, xr.Dataset] = {}
    frequency = _frequencies(scenario.machine)
    for entry in scenario.entries:
        key = repr(entry.running)
        try:
            if key not in known:
                known[key] = _true(scenario.machine, entry.running, frequency)
        except InputError as error:
            wrong[f"trial[{entry.trial}], {entry.name}"] = str(error)
            continue
        out[entry.name] = known[key].assign_attrs(method="truth", truth=_meaning(scenario.machine), **_flat(entry))
    if wrong:
        lines = [f"{name}: {text}" for name, text in wrong.items()]
        raise InputError("\n  ".join([f"{scenario.path.name}: the machine cannot be measured", *lines]))
    return out


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


def _frequencies(machine: Machine | ModalModel) -> Any:
    """Return 1 Hz to three times the last mode, ten lines in the narrowest half-power band."""
    if isinstance(machine, ModalModel):
        frequency, damping = machine.frequency, machine.damping
    else:
        frequency, damping = _elastic_modes(machine)
    step = min(_TRUE_STEP, float(np.min(2.0 * damping * frequency)) / 10.0)
    return np.arange(1.0, max(3.0 * float(frequency.max()), _LEAST_BAND), step)


def _elastic_modes(machine: Machine) -> tuple[Any, Any]:
    """Return frequency [Hz] and damping ratio [1] of the modes with free slides and without joints."""
    structure = machine.structure.structures[0] if isinstance(machine.structure, Posture) else machine.structure
    squares, shapes = linalg.eigh(structure.stiffness, structure.mass)
    w = np.sqrt(np.clip(squares, 0.0, None))
    damping = np.einsum("ir,ij,jr->r", shapes, structure.damping, shapes) / (2.0 * np.maximum(w, 1.0))
    elastic = w > 2.0 * np.pi
    return w[elastic] / (2.0 * np.pi), np.maximum(damping[elastic], _LEAST_DAMPING)
