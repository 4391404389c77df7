"""From a campaign to the family of models that is diagnosed: its baseline, and its compliances as conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
import xarray as xr
from scipy.ndimage import convolve1d

from process import units
from process.errors import InputError
from process.friction.laws import Andersson, Coulomb, CoulombViscous, Viscous
from process.labels import AXES
from smfe.campaign import AxisModel, Campaign, LimitsOf, Measurement, MechanisticForces, ModesOf, RigidDrive
from smfe.diagnosis.cases.case import Case, NamedModes, modes_named
from smfe.diagnosis.cases.cutting import cutting_case, limit_case
from smfe.diagnosis.cases.drive import drive_case
from smfe.diagnosis.cases.experiments import proposed_experiments, proposed_modal_experiments
from smfe.diagnosis.checks.suspect import Suspect, warning
from smfe.diagnosis.frf.axis import MachineFrfs, as_hit
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.frf.modes import SPREAD, ModalFrfs
from smfe.diagnosis.frf.noise import compared, condition_of, degrees_of_freedom_of, excitation_of
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.inference.problem import Condition
from smfe.identification.errors.result import Identification
from smfe.progress import Progress, silent


def axis_baseline(baseline: AxisModel) -> AxisBaseline:
    """Return the baseline of a campaign as one that can be tested."""
    law, names = baseline.friction, ("coulomb", "static", "stribeck_speed")
    one_sided = not isinstance(law, Andersson) or law.negative is None
    if not (isinstance(law, Viscous | Coulomb | CoulombViscous | Andersson) and one_sided):
        raise InputError(
            f"baseline.friction: a {type(law).__name__} law cannot be tested; give viscous, coulomb, "
            "coulomb_viscous or andersson"
        )
    known = {name: float(getattr(law, name)) for name in names if hasattr(law, name)}
    drive = replace(baseline.drive, sigma=law.sigma)
    return AxisBaseline(drive, dict(baseline.servos), baseline.axis, known)


def case_of(campaign: Campaign, found: Mapping[str, Identification], progress: Progress = silent) -> Case:
    """Return what is tested of a campaign, whatever its baseline predicts.

    `found` holds the identification of each measurement, by name, where the baseline predicts compliances.

    Raises InputError without a baseline, or when nothing can be compared with it.
    """
    baseline = campaign.baseline
    if baseline is None:
        raise InputError(
            'the campaign gives no [baseline]: say which simulation is to be tested: axis = "x", moving_mass, '
            'tip_mass, stiffness, damping, Kp, Ti, Kv, friction; or drive = "rigid"; or forces = "mechanistic"; '
            'or from = "NAME"; or limits = "NAME"'
        )
    if isinstance(baseline, RigidDrive):
        return drive_case(campaign, baseline)
    if isinstance(baseline, MechanisticForces):
        return cutting_case(campaign)
    if isinstance(baseline, LimitsOf):
        return limit_case(campaign, baseline, found, progress)
    family: MachineFrfs | ModalFrfs
    if isinstance(baseline, ModesOf):
        modes = modes_named(campaign, baseline.source, found)
        family, suspects = _modal_family(campaign, modes, found), modes.suspects
    else:
        family, suspects = _axis_family(campaign, axis_baseline(baseline), found)
    names = [c.name for c in family.conditions]
    held_out = tuple(m.name for m in campaign.measurements if m.held_out and m.name in names)
    return Case(family, {n: (n,) for n in names}, held_out, suspects)


def _axis_family(
    campaign: Campaign, baseline: AxisBaseline, found: Mapping[str, Identification]
) -> tuple[MachineFrfs, tuple[Suspect, ...]]:
    """Every hammer and actuator measurement along an axis; warnings of those with too few hits."""
    axis, band = baseline.axis, (RULES.lowest, RULES.reach * baseline.drive.locked_frequency)
    conditions, few = [], []
    for m, order in _ordered(campaign):
        if not _known(found.get(m.name), axis):
            continue
        hits = _fewest_hits(m, found[m.name], (axis,))
        if m.method == "hammer" and hits < RULES.fewest_hits:
            evidence = (
                f"{hits} hits are used: their scatter does not separate a level or a state at rest that they share"
            )
            advice = f"left out of the comparison; hit {RULES.fewest_hits} times or more"
            few.append(warning("few_hits", m.name, f"{evidence} from the machine", advice))
            continue
        controller = next(iter(baseline.servos)) if len(baseline.servos) == 1 else m.controller
        if controller not in baseline.servos:
            raise InputError(
                f"measurement '{m.name}': controller {controller!r} is none of the baseline's "
                f"{', '.join(baseline.servos)}; name one of them"
            )
        conditions.append(_condition(m, found[m.name], (axis,), band, order, controller, single_hits=True))
    if not conditions:
        raise InputError(
            f"no hammer or actuator measurement has {axis} under a force along {axis} with its "
            "uncertainty (three hits or more); the baseline has nothing to be compared with"
        )
    family = as_hit(MachineFrfs(baseline, tuple(conditions)), RULES.discrepancy)
    return replace(family, proposals=proposed_experiments(family)), tuple(few)


def _modal_family(campaign: Campaign, modes: NamedModes, found: Mapping[str, Identification]) -> ModalFrfs:
    """Every hammer and actuator measurement, for a baseline that is a modal model."""
    band, conditions = (0.5 * modes.band[0], 2.0 * modes.band[1]), []
    for m, order in _ordered(campaign):
        axes = tuple(a for a in AXES if _known(found.get(m.name), a))
        if axes:
            conditions.append(_condition(m, found[m.name], axes, band, order, m.controller))
    if not conditions:
        raise InputError(
            "no hammer or actuator measurement has an uncertainty (three hits or more); the baseline has nothing to be "
            "compared with"
        )
    spread = {**SPREAD, **modes.spread}
    return ModalFrfs(modes.modal, tuple(conditions), proposed_modal_experiments(conditions), spread=spread)


def _ordered(campaign: Campaign) -> list[tuple[Measurement, float]]:
    """Return the hammer and actuator measurements with their places in the session.

    From 0 to 1 where the campaign says when each measurement was made; else all are alike.
    """
    measurements = campaign.measurements
    place = dict.fromkeys(range(len(measurements)), 0.0)
    if len(measurements) > 1 and all(m.started is not None for m in measurements):
        ranked = sorted(place, key=lambda i: str(measurements[i].started))
        place |= {i: rank / (len(ranked) - 1) for rank, i in enumerate(ranked)}
    return [(m, place[i]) for i, m in enumerate(measurements) if m.method in ("hammer", "actuator")]


def _known(found: Identification | None, axis: str) -> bool:
    """Whether the direct compliance of an axis was measured with its standard deviation."""
    if found is None or "compliance_std" not in found.compliance:
        return False
    std = found.compliance["compliance_std"]
    there = all(axis in std[d].values for d in ("response", "excitation"))
    return there and bool(np.isfinite(std.sel(response=axis, excitation=axis).values).any())


def _fewest_hits(measurement: Measurement, found: Identification, axes: Sequence[str]) -> int:
    """Hits that the scatter of the worst column comes from; 0 where it does not come from hits."""
    if measurement.method != "hammer":
        return 0
    return min(len(_used(found, a)) for a in axes)


def _used(found: Identification, axis: str) -> pd.DataFrame:
    hits = found.tables["hits"]
    return hits[(hits["excitation"] == axis) & hits["used"].astype(bool)]


def _condition(
    measurement: Measurement,
    found: Identification,
    axes: Sequence[str],
    band: tuple[float, float],
    order: float,
    controller: str | None,
    single_hits: bool = False,
) -> Condition:
    compliance = found.compliance.sel(response=list(axes), excitation=list(axes))
    if measurement.method == "hammer":
        compliance = steadied(compliance)
    level, duration = np.mean([_level(measurement, found, a) for a in axes], axis=0).tolist()
    feed = {a: float(v) for a, v in (measurement.feed or {}).items() if a in axes}
    settings: dict[str, float | str] = {
        "method": measurement.method,
        "feed": feed.get(axes[0], 0.0),
        "level": level,
        "order": order,
        "controller": controller or "",
        "added_mass": measurement.added_mass or 0.0,
    }
    if measurement.position is not None:  # a length counts; the name of a place only says which are the same
        try:
            settings["position"] = units.parse(measurement.position, "length")
        except InputError:
            settings["place"] = measurement.position
    how = {"duration": duration, "feed": feed, "controller": controller}
    excited = excitation_of(compliance, measurement.method, level, band, **how)
    hits = _fewest_hits(measurement, found, axes)
    if hits > 1:
        excited = replace(excited, degrees_of_freedom=degrees_of_freedom_of(hits, excited.std.size))
    if single_hits:
        excited = compared(excited, found.compliance, found.hits.get(axes[0]))
    return condition_of(measurement.name, compliance, excited, settings, measurement.name)


def steadied(compliance: xr.Dataset) -> xr.Dataset:
    """Return a compliance whose standard deviation is the root mean square over neighbouring lines.

    That of a line by itself comes from a few hits: over it, residuals of noise alone have a mean square of
    (n - 1)/(n - 2) for n hits, 1.5 for four, and tails that no threshold allows for. Noise is smooth over frequency.
    """
    std = compliance["compliance_std"].transpose("frequency", ...)
    known = np.isfinite(std.values)
    squares = np.where(known, std.values**2, 0.0)
    square, count = (
        convolve1d(x, np.ones(RULES.smooth_lines), axis=0, mode="constant") for x in (squares, 1.0 * known)
    )
    smooth = np.where(known, np.sqrt(square / np.maximum(count, 1.0)), np.nan)
    return compliance.assign(compliance_std=(std.dims, smooth, std.attrs))


def _level(measurement: Measurement, found: Identification, axis: str) -> tuple[float, float]:
    """Impulse [N s] and duration [s] of the hits used, or amplitude [N] of the actuator."""
    if measurement.method == "actuator":
        steps = found.tables["steps"]
        applied = steps[steps["excitation"] == axis]["force_N"].abs().median()
        return float(measurement.force_level or applied), 0.0
    used = _used(found, axis)
    # A half sine stays above a tenth of its peak for 93.6 % of its duration.
    return float(used["impulse_Ns"].abs().mean()), float(used["duration_ms"].mean()) * 1e-3 / 0.936
