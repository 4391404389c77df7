"""From a campaign to the family of models that is diagnosed: its baseline, and its compliances as conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import xarray as xr
from scipy.ndimage import convolve1d

from process import units
from process.errors import InputError
from process.friction.laws import Andersson, Coulomb, CoulombViscous, Viscous
from process.labels import AXES
from process.machine.modes import ModalModel
from process.types import Complex
from smfe.campaign import AxisModel, Campaign, LimitsOf, Measurement, MechanisticForces, ModesOf, RigidDrive
from smfe.campaign.machine import GivenAxis
from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.cases.case import Case, NamedModes, modes_named
from smfe.diagnosis.cases.cutting import cutting_case, limit_case
from smfe.diagnosis.cases.drive import drive_case
from smfe.diagnosis.cases.evidence import evidence_case
from smfe.diagnosis.cases.experiments import proposed_experiments, proposed_modal_experiments
from smfe.diagnosis.cases.machine import band_of, machine_family
from smfe.diagnosis.checks.suspect import Suspect, note, warning
from smfe.diagnosis.frf.axis import MachineFrfs, as_hit
from smfe.diagnosis.frf.axis_baseline import SPREAD as SHEET
from smfe.diagnosis.frf.axis_baseline import AxisBaseline, Sides
from smfe.diagnosis.frf.modes import SPREAD, ModalFrfs, expected_of
from smfe.diagnosis.frf.noise import (
    Excited,
    compared,
    condition_of,
    degrees_of_freedom_of,
    excitation_of,
    near_mains,
)
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.frf.workshop import runs, with_single_hits
from smfe.diagnosis.inference.model import Model
from smfe.diagnosis.inference.problem import Condition
from smfe.diagnosis.machine.axes import is_known
from smfe.identification.errors.result import Identification
from smfe.identification.hammer.direction import UNLIKE
from smfe.progress import Progress, silent


def axis_baseline(baseline: AxisModel, tolerances: Tolerances | None = None) -> AxisBaseline:
    """Return the baseline of a campaign as one that can be tested; default tolerances: those of a workshop."""
    law, names = baseline.friction, ("coulomb", "static", "stribeck_speed")
    if not isinstance(law, Viscous | Coulomb | CoulombViscous | Andersson):
        raise InputError(
            f"baseline.friction: a {type(law).__name__} law cannot be tested; give viscous, coulomb, "
            "coulomb_viscous or andersson"
        )
    if not is_known(law):
        raise InputError("baseline.friction has a delta other than 1, which cannot be tested on an axis; leave it out")
    known: dict[str, float | Sides] = {n: float(getattr(law, n)) for n in names if hasattr(law, n)}
    drive = replace(baseline.drive, sigma=law.sigma)
    if isinstance(law, Andersson) and (back := law.negative) is not None:
        known = {n: (float(getattr(law, n)), float(getattr(back, n))) for n in names}
        known["viscous"] = (law.sigma, back.sigma) if law.sigma + back.sigma > 0.0 else 1.0
        drive = replace(baseline.drive, sigma=0.5 * (law.sigma + back.sigma))
    t = Tolerances() if tolerances is None else tolerances
    spread = SHEET | {"moving_mass": t.declared_mass, "tip_mass": t.declared_mass}
    return AxisBaseline(drive, dict(baseline.servos), baseline.axis, known, spread, t, baseline.period)


def case_of(
    campaign: Campaign, found: Mapping[str, Identification], progress: Progress = silent, *, as_measured: bool = False
) -> Case:
    """Return what is tested of a campaign, whatever its baseline predicts.

    `found` holds the identification of each measurement, by name, where the baseline predicts compliances. With
    `as_measured` hits on an axis are not put right for its friction (`as_hit`), which fits the machine, but predicted
    once: enough to know what would be refused.

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
        modes = modes_named(campaign, baseline.source, found, whole=not baseline.axes)
        family, suspects = _modal_family(campaign, modes, found, baseline.axes), modes.suspects
    else:
        tested = axis_baseline(baseline, campaign.tolerances)
        family, suspects = _axis_family(campaign, tested, found)
        if as_measured:
            model = Model(family, family.conditions)
            for c in family.conditions:
                family.predict(c, model.values(model.null()))  # an unstable servo predicts nothing
        else:
            family = as_hit(family, RULES.discrepancy)
        family = replace(family, proposals=proposed_experiments(family))
        if baseline.evidence:
            return evidence_case(campaign, family, baseline.evidence, suspects, progress)
    names = [c.name for c in family.conditions]
    held_out = tuple(m.name for m in campaign.measurements if m.held_out and m.name in names)
    return Case(family, {n: (n,) for n in names}, held_out, suspects)


def _axis_family(
    campaign: Campaign, baseline: AxisBaseline, found: Mapping[str, Identification]
) -> tuple[MachineFrfs, tuple[Suspect, ...]]:
    """Every hammer and actuator measurement along an axis; suspicions of those that are left out."""
    axis, band = baseline.axis, (RULES.lowest, RULES.reach * baseline.drive.locked_frequency)
    conditions, few = [], []
    for m, order in _ordered(campaign):
        if m.free_mass is not None or not _known(found.get(m.name), axis):
            continue
        hits = _fewest_hits(m, found[m.name], (axis,))
        if m.method == "hammer" and hits < RULES.fewest_hits:
            evidence = (
                f"{_hits_used(found[m.name], axis)}: their scatter does not separate a level or a state at rest that "
                "they share"
            )
            advice = f"left out of the comparison; hit {RULES.fewest_hits} times or more"
            # What was hit as it should be, but found a guideway otherwise, is no fault of who hit.
            struck = hits + sum(str(reason).startswith(UNLIKE) for reason in _unused(found[m.name], axis)["reason"])
            level = note if struck >= RULES.fewest_hits else warning
            few.append(level("few_hits", m.name, f"{evidence} from the machine", advice))
            continue
        controller = next(iter(baseline.servos)) if len(baseline.servos) == 1 else m.controller
        if controller not in baseline.servos:
            raise InputError(
                f"measurement '{m.name}': controller {controller!r} is none of the baseline's "
                f"{', '.join(baseline.servos)}; name one of them"
            )
        conditions.append(_condition(m, found[m.name], (axis,), band, order, controller, hum=campaign.tolerances.hum))
    if not conditions:
        raise InputError(
            f"no hammer or actuator measurement has {axis} under a force along {axis} with its "
            f"uncertainty (three hits or more{_too_few(found, (axis,))}); the baseline has nothing to be compared with"
        )
    family = MachineFrfs(baseline, tuple(_in_session(campaign, conditions)))
    unsteady = [c.name for c in family.conditions if family.sticks_and_slips(c)]
    if 0 < len(unsteady) < len(conditions):
        said = "as declared, its friction falls so fast with speed at this feed that the axis sticks and slips"
        told = "left out of the comparison, for no hit finds it as another did; measure faster, or declare what it has"
        few += [note("low_speed_friction", name, said, told) for name in unsteady]
        family = replace(family, conditions=tuple(c for c in family.conditions if c.name not in unsteady))
    return family, tuple(few)


def _modal_family(
    campaign: Campaign, modes: NamedModes, found: Mapping[str, Identification], driven: Mapping[str, GivenAxis]
) -> ModalFrfs:
    """Every hammer and actuator measurement, for a baseline that is a modal model, alone or on its feed axes."""
    band, conditions = band_of(modes) if driven else (0.5 * modes.band[0], 2.0 * modes.band[1]), []
    source = found.get(campaign.baseline.source) if isinstance(campaign.baseline, ModesOf) else None
    left = None if source is None or driven else partial(left_by_fit, modes.modal, source.compliance)
    for m, order in _ordered(campaign):
        axes = tuple(a for a in AXES if _known(found.get(m.name), a))
        if axes:
            more = (modes.modal, campaign.tolerances.hum, left)
            conditions.append(_condition(m, found[m.name], axes, band, order, m.controller, *more))
    if not conditions:
        raise InputError(
            f"no hammer or actuator measurement has an uncertainty (three hits or more{_too_few(found, AXES)}); the "
            "baseline has nothing to be compared with"
        )
    conditions = _in_session(campaign, conditions)
    if driven:
        return machine_family(campaign, driven, modes, tuple(conditions))
    spread = {**SPREAD, **modes.spread}
    family = ModalFrfs(
        modes.modal,
        tuple(conditions),
        proposed_modal_experiments(conditions),
        spread=spread,
        stated=tuple(modes.spread),
        tolerances=campaign.tolerances,
        fitted=modes.fitted,
    )
    return family.with_errors()


def left_by_fit(modal: ModalModel, source: xr.Dataset, excited: Excited) -> Complex:
    """Return what a modal model leaves of the compliance that it was fitted to [m/N], shape (1, f, entries).

    Damping that is not in proportion, or a mode in the noise, is in every measurement alike: an error of the form of
    the model, which all lines share (`Excited.shared`), and no evidence of a cause. Zero where the source has no lines.
    """
    f = source["frequency"].values
    out = np.zeros((1, excited.frequency.size, len(excited.entries)), dtype=complex)
    for k, (response, excitation) in enumerate(excited.entries):
        if response in source["response"] and excitation in source["excitation"]:
            measured = source["compliance"].sel(response=response, excitation=excitation).values
            known = np.isfinite(measured)
            if known.any():
                away = measured[known] - modal.matrix(f[known])[:, AXES.index(response), AXES.index(excitation)]
                real, imaginary = (
                    np.interp(excited.frequency, f[known], part, left=0.0, right=0.0) for part in (away.real, away.imag)
                )
                out[0, :, k] = real + 1j * imaginary
    return out


def _ordered(campaign: Campaign) -> list[tuple[Measurement, float]]:
    """Return the hammer and actuator measurements with their places in the session.

    From 0 to 1 where the campaign says when each measurement was made; else all are alike, until `as_listed`.
    """
    measurements = campaign.measurements
    place = dict.fromkeys(range(len(measurements)), 0.0)
    if len(measurements) > 1 and all(m.started is not None for m in measurements):
        ranked = sorted(place, key=lambda i: str(measurements[i].started))
        place |= {i: rank / (len(ranked) - 1) for rank, i in enumerate(ranked)}
    return [(m, place[i]) for i, m in enumerate(measurements) if m.method in ("hammer", "actuator")]


def _in_session(campaign: Campaign, conditions: Sequence[Condition]) -> list[Condition]:
    """Return measurements as listed where no `started` says more: a few of these may contradict the list."""
    said = any(m.started is not None for m in campaign.measurements)
    return list(conditions) if said else as_listed(conditions)


def as_listed(conditions: Sequence[Condition]) -> list[Condition]:
    """Return measurements of which nobody says when they were made in the order in which they are listed.

    Not where that goes along with anything that they differ in (a list by level, place, feed or controller): whatever
    that does would pass for a drift, and a drift for it. All stay alike then.
    """
    if len(conditions) < 2 or any(c.settings["order"] for c in conditions):
        return list(conditions)
    place = np.linspace(0.0, 1.0, len(conditions))
    for key in {k for c in conditions for k in c.settings} - {"order"}:
        each = [c.settings.get(key, 0.0) for c in conditions]
        words = list(dict.fromkeys(map(str, each)))
        numbers = all(isinstance(x, int | float) for x in each)
        # Which of two names comes first says nothing: they are counted as they come.
        values = np.array(each, dtype=float) if numbers else np.array([words.index(str(x)) for x in each], dtype=float)
        for x in (values, np.abs(values)):
            # Hits are never quite as hard as the last ones.
            alike = np.ptp(x) <= (RULES.same_level * np.max(np.abs(x)) if key == "level" else 0.0)
            if not alike and abs(np.corrcoef(place, x)[0, 1]) > RULES.along_list:
                return list(conditions)
    return [replace(c, settings={**c.settings, "order": float(t)}) for c, t in zip(conditions, place, strict=True)]


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


def _hits_used(found: Identification, axis: str) -> str:
    """Say how many hits along an axis are used, and why the others are not."""
    hits = found.tables["hits"]
    along = hits[hits["excitation"] == axis]
    out = _unused(found, axis)
    why = "; ".join(f"hit {n} of {file}: {reason}" for n, file, reason in out[["hit", "file", "reason"]].values)
    return f"{len(along) - len(out)} of {len(along)} hits are used" + (f" ({why})" if why else "")


def _too_few(found: Mapping[str, Identification], axes: Sequence[str]) -> str:
    """Say of which measurements hits are left out or too few, and why."""
    every = [
        f"{name}, {axis}: {_hits_used(one, axis)}"
        for name, one in found.items()
        for axis in axes
        if "hits" in one.tables and len(one.tables["hits"].query("excitation == @axis")) > 0
        if len(_used(one, axis)) < RULES.fewest_hits
    ]
    return "; " + "; ".join(every) if every else ""


def _unused(found: Identification, axis: str) -> pd.DataFrame:
    hits = found.tables["hits"]
    return hits[(hits["excitation"] == axis) & ~hits["used"].astype(bool)]


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
    modal: ModalModel | None = None,
    hum: float = 0.0,
    left: Callable[[Excited], Complex] | None = None,
) -> Condition:
    compliance = found.compliance.sel(response=list(axes), excitation=list(axes))
    if measurement.method == "hammer":
        compliance = steadied(compliance)
    compliance = hummed(compliance, hum)
    each = {a: _level(measurement, found, a) for a in axes}
    level, duration = np.mean(list(each.values()), axis=0).tolist()
    feed = {a: float(v) for a, v in (measurement.feed or {}).items()}
    settings: dict[str, float | str] = {
        "method": measurement.method,
        "feed": feed.get(axes[0], 0.0),
        "level": level,
        "order": order,
        "controller": controller or "",
        "added_mass": measurement.added_mass or 0.0,
    }
    for key in ("spindle_speed", "sensor", "free_mass"):
        if (value := getattr(measurement, key)) is not None:
            settings[key] = value
    if measurement.position is not None:  # a length counts; the name of a place only says which are the same
        try:
            settings["position"] = units.parse(measurement.position, "length")
        except InputError:
            settings["place"] = measurement.position
    how = {"duration": duration, "feed": feed, "controller": controller}
    if measurement.method == "hammer":
        how["impulses"] = {a: x for a, (x, _) in each.items()}
    excited = excitation_of(compliance, measurement.method, level, band, **how)
    excited = replace(excited, band=_band_at_once(measurement, found))
    hits = _fewest_hits(measurement, found, axes)
    if hits > 1:
        known = degrees_of_freedom_of(hits, excited.std.size)
        excited = replace(excited, degrees_of_freedom=known, repeats=hits)
    if modal is not None:
        excited = with_single_hits(excited, found.compliance, found.hits, expected_of(modal, excited, settings))
    else:
        excited = compared(excited, found.compliance, found.hits.get(axes[0]), hum)
    if left is not None:
        shared = left(excited)
        excited = replace(
            excited, shared=shared if excited.shared is None else np.concatenate([excited.shared, shared])
        )
    return condition_of(measurement.name, compliance, excited, settings, measurement.name)


def steadied(compliance: xr.Dataset) -> xr.Dataset:
    """Return a compliance whose standard deviation is the root mean square over neighbouring lines.

    That of a line by itself comes from a few hits: over it, residuals of noise alone have a mean square of
    (n - 1)/(n - 2) for n hits, 1.5 for four, and tails that no threshold allows for. Noise is smooth over frequency but
    for hum: lines near the mains' harmonics do not count for their neighbours, and have the largest scatter among them.
    """
    std = compliance["compliance_std"].transpose("frequency", ...)
    hum = near_mains(compliance["frequency"].values).reshape(-1, *(1,) * (std.ndim - 1))
    known = np.isfinite(std.values)
    squares = np.where(known, std.values**2, 0.0)
    own, all_ = (
        [convolve1d(x, np.ones(RULES.smooth_lines), axis=0, mode="constant") for x in (squares * counts, counts)]
        for counts in (1.0 * (known & ~hum), 1.0 * known)
    )
    square, count = (np.where(own[1] > 0.5, a, b) for a, b in zip(own, all_, strict=True))
    smooth = np.sqrt(square / np.maximum(count, 1.0))
    for lines in runs(hum.ravel()):
        smooth[lines] = np.maximum(smooth[lines], np.sqrt(squares[lines].max(axis=0)))
    return compliance.assign(compliance_std=(std.dims, np.where(known, smooth, np.nan), std.attrs))


def hummed(compliance: xr.Dataset, hum: float) -> xr.Dataset:
    """Return a compliance whose standard deviation allows for hum: a share of the rms of its lines, near the mains'."""
    std = compliance["compliance_std"].transpose("frequency", ...)
    phi = compliance["compliance"].transpose(*std.dims).values
    count = np.maximum(np.isfinite(phi).sum(axis=0), 1)
    rms = np.sqrt(np.where(np.isfinite(phi), np.abs(phi) ** 2, 0.0).sum(axis=0) / count)
    near = near_mains(compliance["frequency"].values).reshape(-1, *(1,) * (std.ndim - 1))
    return compliance.assign(compliance_std=(std.dims, np.hypot(std.values, hum * rms * near), std.attrs))


def _band_at_once(measurement: Measurement, found: Identification) -> float:
    """Return the band over which an actuator shakes at all frequencies at once [Hz]; 0 for a sine after another."""
    compliance = found.compliance
    if measurement.method != "actuator" or compliance.attrs.get("excitation_kind") not in ("periodic", "continuous"):
        return 0.0
    f = compliance["frequency"].values
    return float(np.sum(np.gradient(f))) if f.size > 1 else 0.0


def _level(measurement: Measurement, found: Identification, axis: str) -> tuple[float, float]:
    """Impulse [N s] and duration [s] of the hits used, or amplitude [N] of the actuator."""
    if measurement.method == "actuator":
        steps = found.tables["steps"]
        applied = float(steps[steps["excitation"] == axis]["force_N"].abs().median())
        # What is stated of a multisine may be its peak: how hard it shakes is what was recorded.
        return (applied if _band_at_once(measurement, found) else measurement.force_level or applied), 0.0
    used = _used(found, axis)
    # A half sine stays above a tenth of its peak for 93.6 % of its duration.
    return float(used["impulse_Ns"].abs().mean()), float(used["duration_ms"].mean()) * 1e-3 / 0.936
