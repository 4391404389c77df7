"""From the hits, drive records and cutting tests of one campaign to the axis that must explain them all."""

from __future__ import annotations

from collections.abc import Sequence

import xarray as xr

from process.errors import InputError
from smfe.campaign import Campaign, CuttingTest, Measurement
from smfe.diagnosis.cases.case import Case
from smfe.diagnosis.cases.cutting import bracketed_limits
from smfe.diagnosis.cases.drive import records_case
from smfe.diagnosis.checks.suspect import Suspect
from smfe.diagnosis.cutting.limits import Limit
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.evidence.cuts import Cuts
from smfe.diagnosis.evidence.family import with_evidence
from smfe.diagnosis.evidence.moves import Moves, family_of_record
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.inference.problem import Condition
from smfe.progress import Progress
from smfe.records.formats.channels import listed


def evidence_case(
    campaign: Campaign,
    family: MachineFrfs,
    evidence: Sequence[str],
    suspects: Sequence[Suspect],
    progress: Progress,
) -> Case:
    """Return the case of an axis whose compliances are a family already, with its drive records and cutting tests.

    Raises
    ------
    InputError
        When a record cannot be read, a test names no controller of the axis, or no limit is bracketed.
    """
    baseline, compliances = family.baseline, [c.name for c in family.conditions]
    groups: dict[str, tuple[str, ...]] = {name: (name,) for name in compliances}
    held_out = [m.name for m in campaign.measurements if m.held_out and m.name in groups]
    notes = list(suspects)
    moves, cuts = None, None
    further: list[Condition] = []
    if "drive" in evidence:

        def made(m: Measurement, record: xr.Dataset, name: str, like: DriveRecordFamily | None) -> DriveRecordFamily:
            servo = baseline.servos[_controller(baseline, m.controller, "the measurement")]
            return family_of_record(record, baseline, servo, name, like)

        records = records_case(campaign, made)
        assert isinstance(records.family, DriveRecordFamily)
        moves = Moves(records.family, baseline)
        for name, halves in moves.conditions(records.groups).items():
            groups[name] = tuple(c.name for c in halves)
            further += halves
        held_out += records.held_out
    if "limits" in evidence:
        if campaign.tool is None or campaign.coefficients is None:
            raise InputError("a limit depth needs the tables [tool] and [material]; add them")
        cuts = Cuts(baseline, campaign.tool, campaign.coefficients, campaign.coefficient_spread is not None)
        tests: dict[str, list[CuttingTest]] = {}
        for test in campaign.cutting_tests:
            tests.setdefault(_controller(baseline, test.controller, test.file.name), []).append(test)
        found: list[tuple[Limit, str]] = []
        for controller, own in tests.items():
            bracketed, of_files, said = bracketed_limits(campaign, own, campaign.tool, progress)
            found += [(limit, controller) for limit in bracketed]
            groups |= of_files
            notes += said
        start = {
            p.name: p.start for p in (*baseline.nuisances(), *(p for c in baseline.causes() for p in c.parameters))
        }
        further += cuts.conditions(found, start)
        held_out += [t.file.name for t in campaign.cutting_tests if t.held_out and t.file.name in groups]
    return Case(with_evidence(family, moves, cuts, further), groups, tuple(dict.fromkeys(held_out)), tuple(notes))


def _controller(baseline: AxisBaseline, named: str | None, where: str) -> str:
    """Return the controller that a record was made under: the only one, or the one that it names."""
    controller = next(iter(baseline.servos)) if len(baseline.servos) == 1 else named
    if controller is None or controller not in baseline.servos:
        raise InputError(
            f"{where}: controller {controller!r} is none of the baseline's {listed(list(baseline.servos))}; name one"
        )
    return controller
