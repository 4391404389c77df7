"""The data audit: measurement faults are looked for, and excluded, before physics is blamed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import xarray as xr

from process.errors import InputError
from smfe.campaign import Campaign, Measurement, RigidDrive, load_campaign
from smfe.datasets import Show
from smfe.diagnosis.campaign_drive import unlogged_suspects
from smfe.diagnosis.channel_checks import channel_suspects, clock_suspects, tone_suspects
from smfe.diagnosis.compliance_checks import factor_suspects, reciprocity_suspects, skew_suspects
from smfe.diagnosis.hammer_checks import hit_suspects
from smfe.diagnosis.silence import silence_suspects
from smfe.diagnosis.suspect import Suspect, suspect_table
from smfe.diagnosis.sweep_checks import sweep_suspects
from smfe.identification import Progress, silent
from smfe.loop import summary
from smfe.loops import loop_of
from smfe.measurements import hammer_settings, identify_measurement, passes_and_band, records_of, sign_warnings
from smfe.records import read_records
from smfe.sweep_clock import ADVICE, judge_clock
from smfe.sweep_estimators import SweepPass


def check(campaign: Path | str, progress: Progress = silent, show: Show | None = None) -> pd.DataFrame:
    """Audit the data of a campaign.

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
        One row a suspicion, faults first: cause, level (fault, warning, note), where, evidence, advice. No rows:
        nothing was found.

    Raises
    ------
    InputError
        When the campaign file is wrong or a record cannot be read.
    """
    return suspect_table(audit(load_campaign(campaign, show), progress))


def audit(campaign: Campaign, progress: Progress = silent) -> list[Suspect]:
    """Return every suspicion about the data of a campaign."""
    out: list[Suspect] = []
    compliances: dict[str, xr.Dataset] = {}
    total = len(campaign.measurements) + len(campaign.cutting_tests)
    for done, measurement in enumerate(campaign.measurements):
        progress(f"checking {measurement.name}", done, total)
        out += _records_suspects(campaign, measurement)
        out += _compliance_suspects(campaign, measurement, compliances)
        out += _loop_suspects(measurement)
    for done, test in enumerate(campaign.cutting_tests, start=len(campaign.measurements)):
        progress(f"checking {test.file.name}", done, total)
        for record in read_records(test.file, test.channels):
            where = f"cutting test, {test.file.name}"
            out += channel_suspects(record, where)
            out += clock_suspects(record, where, campaign.tool.teeth if campaign.tool else None)
    progress("checking", total, total)
    out += silence_suspects(campaign)
    if isinstance(campaign.baseline, RigidDrive):
        out += unlogged_suspects(campaign, campaign.baseline)
    return out + factor_suspects(compliances)


def _records_suspects(campaign: Campaign, measurement: Measurement) -> list[Suspect]:
    if measurement.method == "frf":
        return []
    out: list[Suspect] = []
    by_axis: dict[str, list[xr.Dataset]] = {}
    for entry in measurement.records:
        for record in records_of(entry, entry.excitation):
            where = f"{measurement.name}, {record.attrs['source']}"
            out += channel_suspects(record, where, pulsed=measurement.method == "hammer")
            if measurement.method == "silent":
                out += tone_suspects(record, where)
            if entry.cut is not None:
                out += clock_suspects(record, where, campaign.tool.teeth if campaign.tool else None)
            by_axis.setdefault(entry.excitation or "", []).append(record)
    if measurement.method == "hammer":
        out += _hammer(measurement, by_axis)
    return out


def _hammer(measurement: Measurement, records: dict[str, list[xr.Dataset]]) -> list[Suspect]:
    try:
        return hit_suspects(measurement.name, records, **hammer_settings(measurement))
    except InputError:
        return []  # said once, by the identification


def _compliance_suspects(
    campaign: Campaign, measurement: Measurement, compliances: dict[str, xr.Dataset]
) -> Sequence[Suspect]:
    if measurement.method not in ("hammer", "actuator", "sweep", "frf"):
        return []
    try:
        found = identify_measurement(campaign, measurement)
    except InputError as error:
        advice = "correct the campaign file or the record; nothing can be computed from it"
        return [Suspect("unusable", "fault", measurement.name, str(error), advice)]
    compliances[measurement.name] = found.compliance
    signs = [
        Suspect("sensor_gain", "fault", measurement.name, text, "declare sign = -1 on the channel that is turned round")
        for text in sign_warnings(found.compliance)
    ]
    skew = [] if signs else skew_suspects(measurement.name, found.compliance)
    return [*signs, *skew, *reciprocity_suspects(measurement.name, found.compliance), *_sweep(campaign, measurement)]


def _loop_suspects(measurement: Measurement) -> list[Suspect]:
    """Say what the setpoint of a loop is, what the loop does, and what spoils it."""
    if measurement.method != "loop":
        return []
    try:
        found = loop_of(measurement)
    except InputError as error:
        advice = "correct the campaign file or the record; nothing can be computed from it"
        return [Suspect("unusable", "fault", measurement.name, str(error), advice)]
    advice = "the response of a loop to its setpoint, without unit; it is no compliance"
    told = [Suspect("loop_response", "note", measurement.name, text, advice) for text in summary(found)]
    return told + [
        Suspect("loop_response", "note", measurement.name, text, "record several periods, not their average")
        for text in found.notes
    ]


def _sweep(campaign: Campaign, measurement: Measurement) -> list[Suspect]:
    if measurement.method != "sweep" or campaign.tool is None:
        return []
    passes, band = passes_and_band(campaign, measurement)
    out = _stated_speeds(measurement.name, passes, campaign.tool.teeth)
    if measurement.references == "all":
        out += sweep_suspects(measurement.name, passes, campaign.tool.teeth, band)
    return out


def _stated_speeds(name: str, passes: Sequence[SweepPass], teeth: int) -> list[Suspect]:
    """Compare the stated speeds alone: those of channels are said with their record."""
    bare = [replace(p, record=p.record[["force"]]) for p in passes]
    clock = judge_clock(name, bare, teeth)
    return [Suspect("time_skew", "warning", name, text, ADVICE["stated"]) for text in clock.warnings]
