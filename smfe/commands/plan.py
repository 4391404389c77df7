"""`smfe plan`: from a tool, an estimate of the machine and its limits to the sweep that will identify it."""

from __future__ import annotations

from pathlib import Path

from process.errors import InputError
from smfe.campaign.datasets import Show
from smfe.planning.recommend import Plan, recommend
from smfe.planning.sweep_files import campaign_text, passes_table, scenario_text
from smfe.planning.task import load_task
from smfe.progress import Progress, silent
from smfe.results import pack_warnings, write_atomically, write_csv, write_groups

WRITTEN = ("plan.toml", "plan.csv", "prediction.nc", "scenario.toml", "plan.html")
"""Files of a plan, beside its figures."""


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


def check_target(file: Path, out: Path) -> None:
    """Refuse a folder in which the plan would overwrite its own input.

    Raises
    ------
    InputError
        With the file.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file; name a folder")
    if file.resolve() in {(out / name).resolve() for name in WRITTEN}:
        raise InputError(f"the plan would overwrite its own input {file.name}; name another folder with -o")


def write_plan(found: Plan, out: Path) -> None:
    """Write everything; each file goes to a temporary name and is moved into place.

    Parameters
    ----------
    found : Plan
        The plan.
    out : Path
        Folder; made when missing.
    """
    from smfe.reporting.planning import write_page

    passes = passes_table(found)
    texts = {"plan.toml": campaign_text(found)}
    if found.task.estimate.machine is not None:
        texts["scenario.toml"] = scenario_text(found.task, found.sweep, seed=1)
    prediction = found.prediction.assign_attrs(frequency_range=list(found.task.limits.frequency_range))
    write_groups(out / "prediction.nc", {"sweep": pack_warnings(prediction, found.warnings)})
    write_csv(out / "plan.csv", passes)
    for name, text in texts.items():
        write_atomically(out / name, lambda path, text=text: path.write_text(text, encoding="utf-8"))  # type: ignore[misc]
    write_page(found, passes, out)
    # What an earlier plan left and this one does not write would be taken for its own.
    for name in {"scenario.toml", "verification.csv"} - set(texts):
        (out / name).unlink(missing_ok=True)
