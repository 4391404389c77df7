"""`smfe lobes`: the lobes that a campaign asks for."""

from __future__ import annotations

from pathlib import Path

from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.commands.identify import identify_all
from smfe.identification.compliances import labelled
from smfe.identification.levels import with_levels
from smfe.limits.campaign_lobes import LobeResult, all_lobes
from smfe.limits.lobe_files import joined
from smfe.progress import Progress, silent
from smfe.results import (
    KEPT,
    Failures,
    check_target,
    pack,
    read_groups,
    require_something,
    write_groups,
)
from stability import write_table


def lobes(
    campaign: Path | str,
    output: Path | str,
    table: Path | str | None = None,
    frf: Path | str | None = None,
    progress: Progress = silent,
    failures: Failures | None = None,
) -> list[LobeResult]:
    """Compute the lobes that a campaign asks for, from its records or from a compliance file.

    Parameters
    ----------
    campaign, output : path
        Campaign file; file of the lobes.
    table : path, optional
        CSV lobe table.
    frf : path, optional
        Compliances of an earlier run.
    progress : callable, optional
        Called with (what, done, of).
    failures : list of Failure, optional
        Collects measurements and requests that fail, which the file names in its attribute ``failures``; the rest is
        written. None: the first one is raised, and nothing is written.

    Raises
    ------
    InputError
        When the campaign file is wrong, or no lobes at all can be computed.
    """
    loaded, path = load_campaign(Path(campaign)), Path(output)
    if not loaded.lobes:
        raise InputError(f"{campaign}: it asks for no lobes; add a [[lobes]] table")
    check_target(path)
    if frf is not None:
        compliances = read_groups(Path(frf))
    else:
        found, _ = identify_all(loaded, path.parent / KEPT, progress, failures)
        compliances = labelled(with_levels(loaded), found)
    results = all_lobes(with_levels(loaded), compliances, progress, failures)
    require_something(results, failures)
    write_groups(path, {f"{r.request}/{r.source}": r.lobes for r in results}, pack(failures or ()))
    if table is not None:
        write_table(joined(results), Path(table))
    return results
