"""Files that the lobes of a campaign make."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from smfe.campaign import Campaign
from smfe.limits.campaign_lobes import LobeResult
from smfe.limits.recommendation import PRESETS, recommend
from smfe.results import LOBES, Failures, attempt, pack, write_csv, write_groups
from stability import write_presets, write_table

POCKETS = "pockets.csv"
MADE = ("lobes.nc", "lobe_table.csv", POCKETS, PRESETS)
"""Files that lobes make."""


def joined(results: Sequence[LobeResult]) -> pd.DataFrame:
    """Return the rows of all tables."""
    return pd.concat([r.table for r in results], ignore_index=True)


def write_lobes(
    folder: Path,
    results: Sequence[LobeResult],
    campaign: Campaign,
    tests: Sequence[Mapping[str, Any]] = (),
    failures: Failures | None = None,
) -> None:
    """Write the files of `MADE`, or remove those of an earlier run when there are no lobes.

    The attribute ``failures`` of ``lobes.nc`` says which requests failed; where all did, this is all that it holds.

    Parameters
    ----------
    folder : Path
        Folder of the results.
    results : sequence of LobeResult
        From `all_lobes`.
    campaign : Campaign
        What was asked for.
    tests : sequence of mapping, optional
        Rows of chatter.csv, by which the sources are judged.
    failures : list of Failure, optional
        What failed before; a recommendation that fails is added. None: it is raised.
    """
    missing = pack(f for f in failures or () if f.part == LOBES)
    if not results:
        for name in MADE:
            (folder / name).unlink(missing_ok=True)
        if missing:
            write_groups(folder / "lobes.nc", {}, missing)
        return
    write_groups(folder / "lobes.nc", {f"{r.request}/{r.source}": r.lobes for r in results}, missing)
    write_table(joined(results), folder / "lobe_table.csv")
    for name in (POCKETS, PRESETS):
        (folder / name).unlink(missing_ok=True)
    with attempt(failures, "recommendation"):
        found = recommend(results, campaign, tests)
        document = found.document()
        write_csv(folder / POCKETS, found.pockets)
        write_presets(document, folder / PRESETS)
