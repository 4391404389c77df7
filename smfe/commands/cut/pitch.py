"""`smfe pitch`: the unequal pitch that suits the cut of a campaign at one spindle speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

from process.errors import InputError
from process.units import si
from smfe.campaign import Campaign, load_campaign
from smfe.campaign.machine import MACHINE
from smfe.commands.identify import identify_all
from smfe.identification.compliances import labelled
from smfe.identification.levels import with_levels
from smfe.kept import KEPT
from smfe.limits.pitch import Pitch, pitch_of, settable
from smfe.limits.source_modes import AskedCut, asked_cut, request_of
from smfe.progress import Progress, part, silent, warn
from smfe.results import read_groups, write_atomically, write_csv

WRITTEN = ("pitch.toml", "pitch.csv")
"""Files of a pitch, beside its figure."""


def pitch(
    source: Path | str | Campaign,
    spindle_speed: float | str,
    out: Path | str | None = None,
    progress: Progress = silent,
    *,
    lobes: str | None = None,
    measurement: str | None = None,
    frf: Path | str | None = None,
    frequency: float | str | None = None,
    around: float = 0.03,
    largest_deviation: float = 0.2,
) -> Pitch:
    """Find the pitch angles with the largest limit depth for the cut of a campaign at a spindle speed and around it.

    Parameters
    ----------
    source : path or Campaign
        Campaign with ``[tool]``, ``[material]`` and ``[[lobes]]``, which say the cut.
    spindle_speed : float or str
        The speed of interest; a number is rpm.
    out : path, optional
        Folder for ``pitch.toml``, ``pitch.csv`` and ``figures/pitch.png``. None: nothing is written.
    progress : callable, optional
        Called with (what, done, of).
    lobes : str, optional
        Which ``[[lobes]]``: "lobes_2". Default: the first.
    measurement : str, optional
        Which of its measurements or models. Default: the first.
    frf : path, optional
        Compliances of an earlier run.
    frequency : float or str, optional
        Frequency of the mode that is to be silenced; a number is Hz. Default: the chatter frequency with equal pitch.
    around : float, optional
        The limit counts at speeds up to this share beside the speed.
    largest_deviation : float, optional
        How far a pitch may depart from the mean, as a share of it.

    Returns
    -------
    Pitch
        The design, and both limits over the speeds of the request.

    Raises
    ------
    InputError
        When something given is wrong, no modes are known of the source, or the spindle does not turn at the speed;
        nothing is then written.

    Warns
    -----
    SmfeWarning
        What must be known of the limits (``Pitch.notes``).
    """
    campaign = load_campaign(source)
    speed = spindle_speed if isinstance(spindle_speed, int | float) else si(spindle_speed, "rotation") * 30.0 / math.pi
    speed = round(float(speed), 6)
    settable(speed, campaign.spindle.minimum, campaign.spindle.maximum)
    target = None if out is None else Path(out)
    if target is not None:
        check_folder(campaign.path, target, WRITTEN)
    kept = None if target is None else target.parent / KEPT
    asked = cut_of(campaign, lobes, measurement, frf, kept, part(progress, 0.0, 0.2))
    hertz = None if frequency is None else float(si(frequency, "frequency"))
    found = pitch_of(asked, speed, around, largest_deviation, hertz, part(progress, 0.2, 1.0))
    if target is not None:
        progress("writing", 1, 1)
        write_pitch(found, target)
    warn(found.notes)
    return found


def cut_of(
    campaign: Campaign,
    lobes: str | None,
    measurement: str | None,
    frf: Path | str | None,
    kept: Path | None,
    progress: Progress,
) -> AskedCut:
    """Return the cut that is asked about with the modes of its source, which is identified where it was measured."""
    request, name = request_of(campaign, lobes, measurement)
    if name == MACHINE or any(m.name == name for m in campaign.models):
        return asked_cut(campaign, request, name, None)
    return asked_cut(campaign, request, name, _compliance(campaign, name, frf, kept, progress))


def _compliance(
    campaign: Campaign, name: str, frf: Path | str | None, kept: Path | None, progress: Progress
) -> xr.Dataset:
    if frf is not None:
        found = read_groups(Path(frf))
    else:
        # A level of a sweep is identified with the sweep that it belongs to.
        own = tuple(m for m in campaign.measurements if m.name == name) or campaign.measurements
        identified, _ = identify_all(replace(campaign, measurements=own), kept, progress)
        found = labelled(with_levels(campaign), identified)
    if name not in found:
        raise InputError(f"'{name}' is asked for, and the compliances do not hold it: {', '.join(found)}")
    return found[name]


def check_folder(file: Path, out: Path, written: Sequence[str]) -> None:
    """Refuse a folder of results that is a file, or in which a result would overwrite the campaign."""
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} is a file; name a folder")
    if file.resolve() in {(out / name).resolve() for name in written}:
        raise InputError(f"the results would overwrite their own input {file.name}; name another folder with -o")


def write_pitch(found: Pitch, out: Path) -> None:
    """Write the line to paste, both limits over the speeds, and the figure; each file is moved into place when whole.

    Parameters
    ----------
    found : Pitch
        The design.
    out : Path
        Folder; made when missing.
    """
    from smfe.reporting.pitch import write_figure

    out.mkdir(parents=True, exist_ok=True)
    text = found.toml()
    write_atomically(out / "pitch.toml", lambda path: path.write_text(text, encoding="utf-8"))
    # No limit is an empty place, as in lobe_table.csv.
    write_csv(out / "pitch.csv", found.table.replace([np.inf, -np.inf], np.nan))
    write_figure(found, out / "figures" / "pitch.png")
