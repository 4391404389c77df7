"""`smfe tune`: the gains of the feed drives with which the cut is most stable, within the limits of commissioning."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.machine.machine import Machine
from smfe.arrays.tables import material_table, tool_table
from smfe.campaign import Campaign, campaign_of_tables, load_campaign
from smfe.campaign.datasets import Show
from smfe.progress import Progress, part, silent, warn
from smfe.results import pack_warnings, write_atomically, write_csv, write_groups
from smfe.tuning.ask import Measured, task_of
from smfe.tuning.plants import MeasuredSource
from smfe.tuning.result import Tuning, tuned
from smfe.tuning.words import gains_text

WRITTEN = ("gains.toml", "tuning.csv", "tuning.nc")
"""Files of a search, beside its figure."""


def tune(
    source: Path | str | Campaign | Machine | Drive | Mapping[str, xr.Dataset],
    out: Path | str | None = None,
    progress: Progress = silent,
    show: Show | None = None,
    *,
    tool: Tool | Mapping[str, Any] | None = None,
    material: CuttingCoefficients | Mapping[str, Any] | None = None,
    at_rest: xr.Dataset | None = None,
    moving_mass: Mapping[str, float] | None = None,
    tip_mass: float | None = None,
    dead_time: Mapping[str, float] | float = 0.0,
    controllers: Mapping[str, Mapping[str, Servo]] | None = None,
    **asked: Any,
) -> Tuning:
    """Find gains ``Kp, Ti, Kv`` for each axis that make a cut most stable within limits; see docs/tune.md.

    Parameters
    ----------
    source : path, Campaign, Machine, Drive, or mapping of str to xarray.Dataset
        Campaign with ``[tool]``, ``[material]``, ``[tune]`` and a machine; or the machine itself; or the measured open
        loop of each axis, as `smfe.open_loop_response` returns it (commanded force to carriage position).
    out : path, optional
        Folder for ``gains.toml``, ``tuning.csv``, ``tuning.nc`` and ``figures/tuning.png``. None: nothing is written.
    progress : callable, optional
        Called with (what, done, of).
    show : callable, optional
        Called with the licence of a public data set before it is fetched.
    tool, material : Tool or mapping, CuttingCoefficients or mapping
        With a machine or open loops: the tool, or the keys of ``[tool]``; cutting coefficients, or the keys of
        ``[material]``.
    at_rest : xarray.Dataset, optional
        With open loops: the compliance of the tool at rest.
    moving_mass : mapping, optional
        With open loops: axis -> all mass that moves with it [kg].
    tip_mass : float, optional
        With open loops: mass at the tool [kg].
    dead_time : mapping or float, optional
        With open loops: dead time that they hold [s], of each axis or of all.
    controllers : mapping, optional
        With open loops: axis -> present controllers by name.
    **asked
        With a machine or open loops: keys of ``[tune]``, e.g. ``goal="least_depth"``, ``spindle_speed=(800, 2500)``,
        ``cut="up"``, ``width_of_cut=0.0508``; numbers are SI, spindle speeds rpm, levels dB.

    Returns
    -------
    Tuning
        The best gains, the present ones beside them, the compromise of depth and tracking, lobes and loops.

    Raises
    ------
    InputError
        When something given is wrong or missing (goal, masses), or no gains keep all limits; nothing is then written.

    Warns
    -----
    SmfeWarning
        What must be known of the answer (``Tuning.warnings``).
    """
    given: Machine | Measured | None = None
    if isinstance(source, Path | str | Campaign):
        if tool is not None or material is not None or asked:
            raise InputError("a campaign says its tool, material and limits itself; they are for a machine in memory")
        campaign = load_campaign(source, show)
    else:
        if tool is None or material is None:
            raise InputError("gains need tool and material; give both, e.g. tool=smfe.Tool(...), material=...")
        given = _given(source, at_rest, moving_mass, tip_mass, dead_time, controllers)
        campaign = _campaign(tool, material, asked)
    if out is not None:
        _check_target(campaign.path, Path(out))
    found = tuned(task_of(campaign, given, part(progress, 0.0, 0.1)), part(progress, 0.1, 1.0))
    if out is not None:
        progress("writing", 1, 1)
        write_tuning(found, Path(out))
    warn(found.warnings)
    return found


def _given(
    source: object,
    at_rest: xr.Dataset | None,
    moving_mass: Mapping[str, float] | None,
    tip_mass: float | None,
    dead_time: Mapping[str, float] | float,
    controllers: Mapping[str, Mapping[str, Servo]] | None,
) -> Machine | Measured:
    if isinstance(source, Drive):
        return Machine.of_axis(source)
    if isinstance(source, Machine):
        return source
    if not isinstance(source, Mapping):
        raise InputError(
            f"a {type(source).__name__} is neither a campaign nor a machine; give a path, a process.Machine or Drive, "
            "or the open loop of each axis"
        )
    needed = {"at_rest": at_rest, "moving_mass": moving_mass, "tip_mass": tip_mass}
    lacking = [name for name, value in needed.items() if value is None]
    if at_rest is None or moving_mass is None or tip_mass is None:
        raise InputError(
            f"open loops alone do not say how the tool moves: {', '.join(lacking)} missing; give the compliance at "
            "rest and both masses (fit_open_loop finds them)"
        )
    delays = dead_time if isinstance(dead_time, Mapping) else dict.fromkeys(source, float(dead_time))
    return Measured(MeasuredSource(at_rest, dict(source), moving_mass, tip_mass, delays), controllers or {})


def _campaign(
    tool: Tool | Mapping[str, Any], material: CuttingCoefficients | Mapping[str, Any], asked: Mapping[str, Any]
) -> Campaign:
    table = {**asked}
    if "spindle_speed" in table:
        table["spindle_speed"] = _speeds(table["spindle_speed"])
    tables = {"tool": tool_table(tool), "material": material_table(material), "tune": table}
    return campaign_of_tables(tables, name="tune")


def _speeds(given: Any) -> Any:
    """Return spindle speeds with their unit; numbers are rpm."""
    if isinstance(given, Mapping):
        return {key: _speeds(value) for key, value in given.items()}
    if isinstance(given, str):
        return given
    if np.ndim(given) == 0:
        return f"{float(given)!r} rpm"
    return [one if isinstance(one, str) else f"{float(one)!r} rpm" for one in given]


def _check_target(file: Path, out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file; name a folder")
    if file.resolve() in {(out / name).resolve() for name in WRITTEN}:
        raise InputError(f"the gains would overwrite their own input {file.name}; name another folder with -o")


def write_tuning(found: Tuning, out: Path) -> None:
    """Write gains, table, lobes and loops, and the figure; each file is moved into place when it is whole.

    Parameters
    ----------
    found : Tuning
        The answer.
    out : Path
        Folder; made when missing.
    """
    from smfe.reporting.tuning import write_figure

    loops = found.loops
    parts = {f"{name}_{p}": getattr(loops[name], p) for name in loops.data_vars for p in ("real", "imag")}
    groups = {
        "lobes": pack_warnings(found.lobes, [*found.notes, *found.warnings]),
        "loops": xr.Dataset(parts, loops.coords),
    }
    if found.confirmed is not None:
        groups["confirmed"] = pack_warnings(found.confirmed, list(found.confirmed.attrs["warnings"]))
    out.mkdir(parents=True, exist_ok=True)
    write_groups(out / "tuning.nc", groups)
    write_csv(out / "tuning.csv", found.table())
    text = gains_text(found)
    write_atomically(out / "gains.toml", lambda path: path.write_text(text, encoding="utf-8"))
    write_figure(found, out / "figures" / "tuning.png")
