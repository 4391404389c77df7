"""From a campaign to the diagnosis of a moving axis: records of encoder and drive force as a family."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from process.errors import InputError
from process.labels import axis_present, sample_interval
from smfe.campaign import Campaign, Measurement, RigidDrive
from smfe.diagnosis.cases.case import Case
from smfe.diagnosis.cases.experiments import proposed_moves
from smfe.diagnosis.checks.suspect import Suspect, warning
from smfe.diagnosis.drive.control_law import ControlLaw, Gains, fit_laws, unlogged_command
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.identification.measurement import records_of


@dataclass(frozen=True)
class _Read:
    """One record of a drive measurement, and what to call it."""

    name: str
    measurement: Measurement
    record: xr.Dataset


def drive_case(campaign: Campaign, baseline: RigidDrive) -> Case:
    """Return the case of the drive records of a campaign.

    The first record that is not held out gives band, noise and starts; all others are judged with these.
    """
    stated = baseline.moving_mass
    tolerances = campaign.tolerances
    mass = None if stated is None else (stated, tolerances.declared_mass * stated)
    gains = None if baseline.Kp is None or baseline.Kv is None else Gains(baseline.Kv, baseline.Kp)

    def made(m: Measurement, record: xr.Dataset, name: str, like: DriveRecordFamily | None) -> DriveRecordFamily:
        return DriveRecordFamily.from_record(
            record,
            baseline.axis,
            mass=mass,
            gains=gains,
            delay=baseline.delay,
            tolerances=tolerances,
            like=like,
            name=name,
        )

    case = records_case(campaign, made)
    assert isinstance(case.family, DriveRecordFamily)
    return replace(case, family=replace(case.family, proposals=proposed_moves(case.family)))


def records_case(
    campaign: Campaign,
    made: Callable[[Measurement, xr.Dataset, str, DriveRecordFamily | None], DriveRecordFamily],
) -> Case:
    """Return the case of all drive records of a campaign, each made by a function of what it is.

    That is its measurement, the record, what its conditions are named by, and the family of the first.
    """
    reads = _records(campaign)
    if not reads or reads[0].measurement.held_out:
        raise InputError("no measurement with method = 'drive' is left to be fitted; add one that is not held out")
    families: list[DriveRecordFamily] = []
    groups: dict[str, tuple[str, ...]] = {}
    for read in reads:
        name = read.measurement.name
        try:
            family = made(read.measurement, read.record, f"{read.name},", families[0] if families else None)
        except InputError as error:
            raise InputError(f"measurement '{read.name}': {error}") from error
        families.append(family)
        groups[name] = (*groups.get(name, ()), *(c.name for c in family.conditions))
    held_out = tuple(dict.fromkeys(r.measurement.name for r in reads if r.measurement.held_out))
    return Case(replace(families[0], conditions=tuple(c for f in families for c in f.conditions)), groups, held_out)


def _records(campaign: Campaign) -> list[_Read]:
    """Return all drive records, those that are held out last."""
    out = []
    for m in sorted(campaign.measurements, key=lambda m: m.held_out):
        if m.method == "drive":
            found = [r for entry in m.records for r in records_of(entry)]
            alone = len(found) == 1
            out += [_Read(m.name if alone else f"{m.name}, {r.attrs['source']}", m, r) for r in found]
    return out


def unlogged_suspects(campaign: Campaign, baseline: RigidDrive) -> Iterator[Suspect]:
    """Look in every drive record for commands that the control law does not give; without its gains nothing is said."""
    if baseline.Kp is None or baseline.Kv is None:
        return
    law: ControlLaw | None = None
    for read in _records(campaign):
        names, axis = ("reference_position", "encoder_position", "drive_force"), baseline.axis
        if lost := [n for n in names if n not in read.record or axis not in axis_present(read.record, n)]:
            raise InputError(
                f"measurement '{read.name}': no {lost[0]}_{axis}; the control law needs it: declare it, or take Kp and "
                "Kv out of [baseline]"
            )
        x, q, f = (np.asarray(read.record[n].sel(axis=axis).values, dtype=float) for n in names)
        step = sample_interval(read.record)
        law = law or fit_laws(x, q, f, step, Gains(baseline.Kv, baseline.Kp))[0]
        pulses = unlogged_command(law, x, q, f, step, campaign.tolerances.material)[1]
        if pulses:
            height, length = np.median([(p.height, p.end - p.begin) for p in pulses], axis=0)
            yield warning(
                "hidden_input",
                read.name,
                f"{len(pulses)} commands that the control law with its gains does not give, of {height:.4g} N over "
                f"{length:.3g} s (medians), the first from {pulses[0].begin:.4g} s on",
                "find out who adds to the command, and log it",
            )
