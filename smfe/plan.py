"""`smfe plan`: from a tool, an estimate of the machine and its limits to the sweep that will identify it."""

from __future__ import annotations

from pathlib import Path

from smfe.campaign.datasets import Show
from smfe.identification.errors.result import Progress, silent
from smfe.plan_files import check_target, write_plan
from smfe.planning.recommend import Plan, recommend, summary
from smfe.planning.task import load_task

__all__ = ["Plan", "plan", "recommend", "summary"]


def plan(file: Path | str, out: Path | str, progress: Progress = silent, show: Show | None = None) -> Plan:
    """Plan a sweep and write the campaign to run, the passes, the prediction and its figures.

    Parameters
    ----------
    file : path
        Campaign file with ``[tool]``, ``[material]``, an estimate of the machine and, usually, ``[plan]``.
    out : path
        Folder for ``plan.toml``, ``plan.csv``, ``prediction.nc``, ``scenario.toml``, ``plan.html`` and ``figures/``.
    progress : callable, optional
        Called with (what, done, of).
    show : callable, optional
        Called with the licence of a public data set before it is fetched.

    Returns
    -------
    Plan
        What was written.

    Raises
    ------
    InputError
        When the file is wrong, or no sweep works within the limits; nothing is then written.
    """
    check_target(Path(file), Path(out))
    found = recommend(load_task(file, progress, show), progress)
    progress("writing", 0, 1)
    write_plan(found, Path(out))
    return found
