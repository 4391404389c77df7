"""What one process does of one campaign: a share of its measurements and cutting tests, or all that is left."""

from __future__ import annotations

import json
import tempfile
import warnings
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

from process.errors import InputError
from smfe.campaign import Campaign, load_campaign
from smfe.commands.many.places import fetched, is_address, keep_source, packed
from smfe.commands.run import run
from smfe.diagnosis.audit import Audit, audit_measurement, audit_test
from smfe.fleet.rows import write_rows
from smfe.kept import KEPT, Parts, State, read_hashes, state
from smfe.limits.cutting_tests import judged, verdict_store
from smfe.progress import SmfeWarning
from smfe.results import is_outside, reason_of, unpack
from smfe.work.tasks import DONE, FAULT, OUTSIDE, REFUSED, Outcome

Share = tuple[int, int]
"""Which of how many shares."""


@dataclass(frozen=True)
class Task:
    """One campaign, or a share of it.

    Parameters
    ----------
    campaign : str
        Its file.
    folder : str
        Of its results.
    share : (int, int), optional
        Which of how many shares of its measurements and cutting tests is done and kept; None: all the rest.
    draw : bool
        Whether the report and its pictures are written.
    mark : str
        File that `seen` must find: a process that does not see it must not write where it believes the results to be.
    returned : bool
        Whether the results are returned instead, because not every worker sees where they belong.
    """

    campaign: str
    folder: str
    share: Share | None = None
    draw: bool = field(default=False, kw_only=True)
    mark: str = field(default="", kw_only=True)
    returned: bool = field(default=False, kw_only=True)


def seen(mark: str) -> bool:
    """Return whether this process sees the folder of the results, by a mark that was put there."""
    return Path(mark).is_file()


def work(task: Task) -> Outcome:
    """Carry out a task; whatever goes wrong is its outcome."""
    folder = Path(task.folder)
    if task.mark and not seen(task.mark):
        return Outcome(OUTSIDE, (f"a worker does not see '{folder.parent}', where the results belong",))
    if not task.returned:
        return _work(task, folder)
    with tempfile.TemporaryDirectory(prefix="smfe-") as place:
        own = Path(place, folder.name)
        outcome = _work(task, own)
        written = (own / "provenance.json").is_file()
        return replace(outcome, packed=packed(own)) if written else outcome


def _work(task: Task, folder: Path) -> Outcome:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SmfeWarning)  # they stand in the results, and so in the catalogue
            if is_address(task.campaign):
                with fetched(task.campaign) as (local, source):
                    # Its place is another each time, and so are the results of another campaign to it.
                    run(local, folder, draw=task.draw, fresh=True)
                keep_source(folder, source)
            elif task.share is not None:
                campaign = Path(task.campaign)
                keep_share(_loaded(campaign, state(campaign)), folder / KEPT, task.share)
                return Outcome(DONE)
            else:
                run(Path(task.campaign), folder, draw=task.draw)
            write_rows(folder)
    except InputError as error:
        return Outcome(OUTSIDE if is_outside(error) else REFUSED, (str(error),))
    except Exception as error:
        return Outcome(OUTSIDE if is_outside(error) else REFUSED, (reason_of(error),))
    return outcome_of(folder)


def outcome_of(folder: Path) -> Outcome:
    """Return what a run came to by what it wrote."""
    said = json.loads((folder / "provenance.json").read_text(encoding="utf-8"))
    failures = unpack(said)
    reasons = [f.sentence for f in failures]
    left = [row for row in said.get("check", []) if row.get("level") == "fault"]
    reasons += [f"{row['where']}: {row['evidence']}" for row in left if not failures]
    if any(f.outside for f in failures):
        return Outcome(OUTSIDE, tuple(reasons))
    return Outcome(FAULT if reasons else DONE, tuple(reasons))


def keep_share(campaign: Campaign, kept: Path, share: Share) -> None:
    """Identify and check every n-th measurement and judge every n-th cutting test, each kept for the run that follows.

    What fails is not kept, and fails again in the run, which says so.
    """
    number, of = share
    read_hashes(kept)
    parts, verdicts, out = Parts(kept, "check"), verdict_store(kept), Audit()
    for measurement in campaign.measurements[number::of]:
        audit_measurement(campaign, measurement, out, parts)
        out.identified.clear()
    for i in range(number, len(campaign.cutting_tests), of):
        test = campaign.cutting_tests[i]
        audit_test(campaign, i, test, out, parts)
        if test.depth_of_cut > 0.0:
            try:
                judged(campaign, test, verdicts)
            except Exception as error:
                if is_outside(error):
                    raise


@lru_cache(maxsize=2)
def _loaded(path: Path, _as_it_is: State) -> Campaign:
    """Return a campaign that the shares of this process have in common."""
    return load_campaign(path)
