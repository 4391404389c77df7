"""`smfe run`: one campaign into its folder, or many of them into folders of their own and a catalogue of all."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import overload

from process.errors import InputError
from smfe.campaign import Campaign
from smfe.campaign.datasets import Show
from smfe.commands.many.folders import Found, find, is_one
from smfe.commands.many.places import is_address, is_same, unpack_into
from smfe.commands.many.tasks import Task, outcome_of, seen, work
from smfe.commands.run import run as run_one
from smfe.fleet.rows import are_written
from smfe.fleet.table import accept, refuse, write_catalogue
from smfe.kept import KEPT, RECORD, forget, forget_record, is_unchanged, read_hashes, read_kept, write_record
from smfe.progress import Progress, silent
from smfe.results import Failure, Failures, check_target
from smfe.staged import held
from smfe.work.cluster import cluster
from smfe.work.processes import cores, processes
from smfe.work.tasks import FAULT, OUTSIDE, REFUSED, Outcome, Pool, carry_out, here

Campaigns = Sequence[Path | str]

SHARE = 16
"""Measurements and cutting tests that one process takes at a time of a campaign that has more."""

CAMPAIGN = "campaign"
"""What a failure calls a campaign that was refused, or parts of one that failed."""


@dataclass(frozen=True)
class Batch:
    """What a run of many campaigns came to.

    Parameters
    ----------
    catalogue : Path
        The table of all.
    states : mapping of str to str
        Name of each campaign -> "done", "faults", "refused" or "outside".
    unchanged : int
        How many of them were as an earlier run had left them.
    failures : list of Failure
        What was refused or failed, each with its campaign.
    """

    catalogue: Path
    states: dict[str, str]
    unchanged: int
    failures: Failures

    @property
    def wrong(self) -> bool:
        """Whether a campaign has no results: its input was wrong, or it failed for a reason outside of it."""
        return any(state in (REFUSED, OUTSIDE) for state in self.states.values())


@overload
def run(  # type: ignore[overload-overlap]  # a text is a sequence of texts, and is one campaign
    campaign: Path | str | Campaign,
    out: Path | str,
    fresh: bool = False,
    progress: Progress = silent,
    licence: Show | None = None,
    draw: bool | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Path: ...


@overload
def run(
    campaign: Campaigns,
    out: Path | str,
    fresh: bool = False,
    progress: Progress = silent,
    licence: Show | None = None,
    draw: bool | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Batch: ...


def run(
    campaign: Path | str | Campaign | Campaigns,
    out: Path | str,
    fresh: bool = False,
    progress: Progress = silent,
    licence: Show | None = None,
    draw: bool | None = None,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> Path | Batch:
    """Do everything that a campaign asks for and write the results; of several, each in a folder of its own.

    It starts with the audit of `smfe check`: a measurement or cutting test with a fault is left out, and has failed.

    Of several campaigns one pool of processes does all campaigns, and of large ones all measurements and cutting tests.
    What an earlier run has finished, and of which nothing has changed, is not done again; what fails for reasons
    outside of it (memory, a disk, a network, a process that was ended) is tried three times. One that fails stops none
    of the others. In a script, call it below ``if __name__ == "__main__":``, as for every pool of processes.

    Parameters
    ----------
    campaign : path, Campaign, or sequence of paths
        Campaign file, or what `smfe.read_campaign` read. A list of files, folders and patterns is many campaigns, also
        where it finds one: of a folder all campaign files below it.
    out : path
        Folder of the results; made when missing. Of several campaigns it holds one folder each, and
        ``catalogue.parquet``, the table of all.
    fresh : bool, optional
        Compute everything again instead of reading back what an earlier run has kept. Without it, a folder that holds
        what this run would write is left as it is, and parts of which nothing has changed are read back.
    progress : callable, optional
        Called with (what, done, of).
    licence : callable, optional
        Called with the licence of a public data set before it is fetched; without it nothing is fetched. Of several
        campaigns nothing is fetched.
    draw : bool, optional
        Whether reports and pictures are written; default: of one campaign yes, of several no (`report` writes them
        later).
    jobs : int, optional
        Processes; default: of one campaign one, of several as many as there are cores.
    scheduler : str, optional
        Address of the scheduler of a cluster of dask.distributed that does the same tasks, "tcp://host:8786".

    Returns
    -------
    Path or Batch
        Of one campaign the report. What failed stands in ``provenance.json`` beside it, as a list ``failures`` of
        objects with part, name and reason, and in its place in every other file; the rest is as it would have been
        without. Of several: the catalogue, the state of each campaign and what failed.

    Raises
    ------
    InputError
        When the campaign file is wrong or the results cannot be written; no result is then written or touched. Of
        several campaigns: when none is found, or `out` cannot be written.

    Warns
    -----
    SmfeWarning
        Of one campaign what must be known of the results, and what failed; both also stand in ``provenance.json`` and
        in the report.
    """
    if jobs is not None and jobs < 1:
        raise InputError(f"{jobs} jobs; give at least 1")
    if is_one(campaign):
        assert not isinstance(campaign, Sequence) or isinstance(campaign, str)
        ahead = None
        if isinstance(campaign, Path | str) and ((jobs or 1) > 1 or scheduler is not None):
            ahead = partial(_ahead, Path(campaign).absolute(), Path(out).absolute(), jobs or 2, scheduler)
        return run_one(campaign, out, fresh, progress, licence, draw is not False, ahead)
    assert not isinstance(campaign, Campaign)
    named = [campaign] if isinstance(campaign, Path | str) else list(campaign)
    return run_many(find(named), Path(out).absolute(), fresh, bool(draw), progress, jobs, scheduler)


def run_many(
    campaigns: Sequence[Found],
    root: Path,
    fresh: bool,
    draw: bool,
    progress: Progress,
    jobs: int | None,
    scheduler: str | None = None,
) -> Batch:
    """Run campaigns that were found; see `run`."""
    check_target(root / "catalogue.parquet")
    if (root / "provenance.json").exists():
        raise InputError(f"'{root}' holds the results of one campaign; name another folder for many with --out")
    with held(root):
        return _run_held(campaigns, root, fresh, draw, progress, jobs, scheduler)


def _run_held(
    campaigns: Sequence[Found],
    root: Path,
    fresh: bool,
    draw: bool,
    progress: Progress,
    jobs: int | None,
    scheduler: str | None,
) -> Batch:
    outcomes: dict[str, Outcome] = {}
    todo = []
    for done, one in enumerate(campaigns):
        folder = root / one.name
        progress("campaigns: looking for what is done", done, 50 * len(campaigns))
        if fresh:
            forget(folder)
            forget_record(folder)
        elif _is_done(one, folder, draw):
            outcomes[one.name] = outcome_of(folder)
            continue
        todo.append(one)
    unchanged = len(outcomes)
    if todo and scheduler is not None:
        with cluster(work, scheduler) as pool, _marked(root) as mark:
            returned = not pool.everywhere(seen, mark)
            how = partial(replace, draw=draw, mark="" if returned else mark, returned=returned)
            _carry_out(todo, root, how, progress, pool, not returned, outcomes)
    elif todo:
        count = min(jobs or cores(), sum(len(_shares(one, root)) + 1 for one in todo))
        with processes(work, count) if count > 1 else here(work) as own:
            _carry_out(todo, root, partial(replace, draw=draw), progress, own, count > 1, outcomes)
    progress("campaigns: writing the catalogue", 99, 100)
    for one in campaigns:
        if _has_results(outcomes[one.name], root / one.name):
            accept(root / one.name)
        else:
            refuse(root / one.name, one.address, "\n".join(outcomes[one.name].reasons))
    failures = [Failure(CAMPAIGN, n, reason) for n, outcome in sorted(outcomes.items()) for reason in outcome.reasons]
    states = {n: outcomes[n].state for n in sorted(outcomes)}
    for one in campaigns:  # parts of it failed for reasons outside: the rest stands
        if states[one.name] == OUTSIDE and _has_results(outcomes[one.name], root / one.name):
            states[one.name] = FAULT
    return Batch(write_catalogue(root), states, unchanged, failures)


def _is_done(one: Found, folder: Path, draw: bool) -> bool:
    """Return whether a folder holds all that a run of the campaign would write, as it would be now."""
    drawn = not draw or (folder / "report.html").is_file()
    if not drawn or not are_written(folder):
        return False
    return is_same(folder, one.address) if is_address(one.address) else is_unchanged(Path(one.address), folder)


def _has_results(outcome: Outcome, folder: Path) -> bool:
    return outcome.state != REFUSED and (folder / "provenance.json").is_file() and are_written(folder)


def _carry_out(
    todo: Sequence[Found],
    root: Path,
    how: Callable[[Task], Task],
    progress: Progress,
    pool: Pool[Task],
    shared: bool,
    outcomes: dict[str, Outcome],
) -> None:
    """Carry out the tasks of campaigns: the shares of large ones first, and what is left when their shares are done."""
    by_folder = {str(root / one.name): one for one in todo}
    shares = {str(root / one.name): [how(task) for task in _shares(one, root)] if shared else [] for one in todo}
    last = {folder: how(Task(one.address, folder)) for folder, one in by_folder.items()}
    left = {folder: len(tasks) for folder, tasks in shares.items()}
    weights = {folder: 1.0 + one.measurements + 0.4 * one.tests for folder, one in by_folder.items()}
    whole, so_far, finished = sum(weights.values()), 0.0, 0
    first = [task for tasks in shares.values() for task in tasks]
    first += [last[folder] for folder, tasks in shares.items() if not tasks]

    def then(task: Task, outcome: Outcome) -> Iterable[Task]:
        nonlocal so_far, finished
        weight, number = weights[task.folder], len(shares[task.folder])
        if task.share is not None:
            left[task.folder] -= 1
            so_far += 0.8 * weight / number
        else:
            if outcome.packed:
                take(Path(task.folder), outcome.packed)
            outcomes[by_folder[task.folder].name] = replace(outcome, packed=b"")
            finished += 1
            so_far += weight * (0.2 if number else 1.0)
        what = f"campaigns: {finished} of {len(todo)} done, {by_folder[task.folder].name}"
        progress(what, 200 + round(9700 * so_far / whole), 10_000)
        return [last[task.folder]] if task.share is not None and not left[task.folder] else []

    carry_out(pool, first, then)


def take(folder: Path, content: bytes) -> None:
    """Put results that a worker returned in their place, and write down that they are as they were written."""
    unpack_into(folder, content)
    record = read_kept(folder / KEPT / RECORD)
    if record:
        read_hashes(folder / KEPT)
        write_record(folder, {name: record[name] for name in ("campaign", "files", "patterns", "data")})


@contextmanager
def _marked(root: Path) -> Iterator[str]:
    """Put a mark into the folder of the results, by which a worker knows that it sees the same folder."""
    mark = root / KEPT / f"mark-{uuid.uuid4().hex}"
    mark.touch()
    try:
        yield str(mark)
    finally:
        mark.unlink(missing_ok=True)


def _shares(one: Found, root: Path) -> list[Task]:
    """Return the shares of a campaign; none where one process does it all."""
    of = -(-one.size // SHARE)
    return [Task(one.address, str(root / one.name), (i, of)) for i in range(of)] if of > 1 else []


def _ahead(campaign: Path, folder: Path, jobs: int, scheduler: str | None, progress: Progress) -> None:
    """Keep the measurements and cutting tests of one campaign, whose run then reads them back."""
    (one,) = find([campaign])
    tasks = [replace(task, folder=str(folder)) for task in _shares(one, folder)]
    done = 0

    def then(_task: Task, _outcome: Outcome) -> Iterable[Task]:
        nonlocal done
        done += 1
        progress(f"checking share {done} of {len(tasks)}", done, len(tasks))
        return ()

    if tasks and scheduler is not None:
        with cluster(work, scheduler) as pool, _marked(folder) as mark:
            if not pool.everywhere(seen, mark):
                raise InputError(f"the workers do not see '{folder}'; name a folder with --out that all see")
            carry_out(pool, [replace(task, mark=mark) for task in tasks], then)
    elif tasks:
        with processes(work, min(jobs, len(tasks))) as own:
            carry_out(own, tasks, then)
