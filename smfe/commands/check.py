"""`smfe check`: the data audit of a campaign, and a short trial of everything that it asks for."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from smfe.campaign import load_campaign
from smfe.campaign.datasets import Show
from smfe.diagnosis.audit import audited
from smfe.diagnosis.checks.suspect import suspect_table
from smfe.diagnosis.dry_run import refusals
from smfe.progress import Progress, silent


def check(campaign: Path | str, progress: Progress = silent, show: Show | None = None) -> pd.DataFrame:
    """Audit the data of a campaign, and try in short everything that it asks for.

    Parameters
    ----------
    campaign : path
        Campaign file.
    progress : callable, optional
        Called with (what, done, of).
    show : callable, optional
        Shows the licence of a public data set before it is fetched.

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
    found = audited(loaded, progress)
    refused = refusals(loaded, found.identified, found.excluded, progress)
    progress("checking", 1, 1)
    return suspect_table([*found.suspects, *refused])
