"""`smfe plan`: from a tool, an estimate of the machine and its limits to the sweep that will identify it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, overload

import xarray as xr

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.modes import ModalModel
from smfe.arrays.requests import planned
from smfe.campaign import Campaign
from smfe.campaign.datasets import Show
from smfe.campaign.schema import PlanTable
from smfe.identification.errors.result import Identification
from smfe.modes.fit_modes import ModalFit
from smfe.planning.recommend import Plan, recommend
from smfe.planning.sweep_files import campaign_text, passes_table, scenario_text
from smfe.planning.task import Estimate, estimate_of, load_task, task_of
from smfe.progress import Progress, part, silent, warn
from smfe.results import pack_warnings, write_atomically, write_csv, write_groups

WRITTEN = ("plan.toml", "plan.csv", "prediction.nc", "scenario.toml", "plan.html")
"""Files of a plan, beside its figures."""


@overload
def plan(
    file: Path | str | Campaign, out: Path | str | None = None, progress: Progress = silent, show: Show | None = None
) -> Plan: ...


@overload
def plan(
    file: xr.Dataset | Identification | ModalModel | ModalFit,
    out: Path | str | None = None,
    progress: Progress = silent,
    *,
    tool: Tool | Mapping[str, Any],
    material: CuttingCoefficients | Mapping[str, Any],
    **limits: Any,
) -> Plan: ...


def plan(
    file: Path | str | Campaign | xr.Dataset | Identification | ModalModel | ModalFit,
    out: Path | str | None = None,
    progress: Progress = silent,
    show: Show | None = None,
    *,
    tool: Tool | Mapping[str, Any] | None = None,
    material: CuttingCoefficients | Mapping[str, Any] | None = None,
    **limits: Any,
) -> Plan:
    """Plan a sweep; write the campaign to run, the passes, the prediction and its figures.

    Parameters
    ----------
    file : path, Campaign, xarray.Dataset, Identification, ModalModel or ModalFit
        Campaign with ``[tool]``, ``[material]``, an estimate of the machine and, usually, ``[plan]``; or the estimate
        itself: a compliance or modes.
    out : path, optional
        Folder for ``plan.toml``, ``plan.csv``, ``prediction.nc``, ``scenario.toml``, ``plan.html`` and ``figures/``.
        None: nothing is written.
    progress : callable, optional
        Called with (what, done, of).
    show : callable, optional
        Called with the licence of a public data set before it is fetched.
    tool, material : Tool or mapping, CuttingCoefficients or mapping
        With an estimate: the tool, or the keys of ``[tool]``; cutting coefficients, or the keys of ``[material]``.
    **limits
        With an estimate: keys of ``[plan]``, e.g. ``frequency_range=(20, 80)``, ``depth_of_cut=("0.5 mm", "3 mm")``,
        and ``spindle``, a mapping with the keys of that table; numbers are SI.

    Returns
    -------
    Plan
        What is recommended.

    Raises
    ------
    InputError
        When something given is wrong, or no sweep works within the limits; nothing is then written.

    Warns
    -----
    SmfeWarning
        What must be known of the plan (``Plan.warnings``).
    """
    if isinstance(file, Path | str | Campaign):
        if tool is not None or material is not None or limits:
            raise InputError("a campaign says its tool, material and limits itself; they are for an estimate in memory")
        path = file.path if isinstance(file, Campaign) else Path(file)
        if out is not None:
            check_target(path, Path(out))
        task = load_task(file, part(progress, 0.0, 0.2), show)
    else:
        if tool is None or material is None:
            raise InputError("a plan needs tool and material; give both, e.g. tool=smfe.Tool(...), material=...")
        campaign, compliances, written = planned(file, tool, material, limits)

        def estimate(table: PlanTable) -> Estimate:
            if compliances:
                ((name, dataset),) = compliances.items()
                return estimate_of(name, dataset, table)
            (model,) = campaign.models
            return Estimate(model.name, model.modal, {"modes": written["model"][0]["modes"]})

        task = task_of(campaign, written, estimate)
    found = recommend(task, part(progress, 0.2, 1.0))
    if out is not None:
        progress("writing", 1, 1)
        write_plan(found, Path(out))
    warn(found.warnings)
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
