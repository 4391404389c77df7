"""`smfe check`: the data audit of a campaign, and a short trial of everything that it asks for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from smfe.campaign import Campaign, load_campaign
from smfe.campaign.datasets import Show
from smfe.diagnosis.audit import audited
from smfe.diagnosis.cases.compliances import case_of
from smfe.diagnosis.cases.known import with_known
from smfe.diagnosis.checks.suspect import Suspect, fault, suspect_table, warning
from smfe.identification.compliances import labelled
from smfe.identification.errors.result import Identification
from smfe.identification.levels import condition_cubes, with_levels
from smfe.identification.measurement import split_levels
from smfe.limits.campaign_lobes import all_lobes
from smfe.limits.cutting_tests import judge_all
from smfe.limits.recommendation import pockets_of
from smfe.planning.search import Search
from smfe.planning.task import load_task
from smfe.progress import Progress, part, silent
from smfe.results import MEASUREMENT, Failures, attempt

QUICK = ("zero_order", "multi_frequency", "operating_point")
"""Methods whose prediction for a cutting test is tried as well; fitting modes for each test would take minutes."""


def check(campaign: Path | str | Campaign, progress: Progress = silent, show: Show | None = None) -> pd.DataFrame:
    """Audit the data of a campaign, and try in short everything that it asks for.

    Parameters
    ----------
    campaign : path or Campaign
        Campaign file, or what `smfe.read_campaign` read.
    progress : callable, optional
        Called with (what, done, of).
    show : callable, optional
        Called with the licence of a public data set before it is fetched.

    Returns
    -------
    pandas.DataFrame
        One row a suspicion, faults first: cause, level (fault, warning, note), where, evidence, advice. What a later
        command would refuse has the cause "unusable". No rows: nothing was found.

    Raises
    ------
    InputError
        When the campaign file is wrong.
    """
    loaded = load_campaign(campaign, show)
    found = audited(loaded, part(progress, 0.0, 0.8))
    refused = refusals(loaded, found.identified, found.excluded, part(progress, 0.8, 1.0))
    progress("checking", 1, 1)
    return suspect_table([*found.suspects, *refused])


def refusals(
    campaign: Campaign, found: Mapping[str, Identification], known: Failures, progress: Progress = silent
) -> list[Suspect]:
    """Return what `smfe run` and the other commands would refuse of identified measurements: "unusable" faults.

    Lobes are computed at three speeds. Cutting tests that no source of lobes belongs to are warnings. What needs a part
    that is `known` to be left out already is refused, and is not said once more.
    """
    whole, refused = with_levels(campaign), list(known)
    compliances = labelled(whole, found)
    with attempt(refused, "conditions"):
        condition_cubes([m for m in whole.measurements if m.name in found], compliances)
    split_levels(campaign, None, refused)
    lobes = []
    for request in whole.lobes:
        at = np.unique(np.linspace(0, request.spindle_speed.size - 1, 3).round().astype(int))
        lobes.append(replace(request, spindle_speed=request.spindle_speed[at]))
    short = replace(whole, lobes=tuple(lobes))
    results = all_lobes(short, compliances, part(progress, 0.0, 0.4), refused)
    for r in results:
        with attempt(refused, "pockets", f"{r.request}, {r.source}"):
            pockets_of(r, campaign)
    quick = replace(short, lobes=tuple(r for r in short.lobes if r.method in QUICK))
    unsure = judge_all(quick, compliances, part(progress, 0.4, 0.8), refused).warnings
    if campaign.baseline is not None:
        with attempt(refused, "diagnosis"):
            case = case_of(campaign, found, part(progress, 0.8, 1.0), as_measured=True)
            with_known(case.family, campaign)
    if campaign.plan is not None:
        with attempt(refused, "plan"):
            task = load_task(campaign.path)
            low, high = task.limits.frequency_range
            Search(task)  # refuses inserts that the tool cannot hold, and an estimate that does not move
            task.estimate.matrix([max(low - 1.0, 0.5 * low), high + 1.0])
    failed = {f.name for f in known if f.part == MEASUREMENT}
    advice = "correct what it names; the rest will run"
    return [warning("conditions", "cutting tests", text, "correct what the campaign states") for text in unsure] + [
        fault("unusable", f"{f.part} {f.name}".strip(), f.reason, advice)
        for f in refused[len(known) :]
        if not any(f"'{name}' failed" in f.reason for name in failed)
    ]
