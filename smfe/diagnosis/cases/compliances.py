"""From a campaign to the family of models that is diagnosed: its baseline, and its compliances as conditions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.ndimage import convolve1d

from process import units
from process.errors import InputError
from process.friction.laws import Andersson, Coulomb, CoulombViscous, FrictionLaw, MemoryLaw, Viscous
from process.labels import AXES
from smfe.campaign import AxisModel, Campaign, LimitsOf, Measurement, MechanisticForces, ModesOf, RigidDrive
from smfe.diagnosis.cases.case import Case, NamedModes, modes_named
from smfe.diagnosis.cases.cutting import cutting_case, limit_case
from smfe.diagnosis.cases.drive import drive_case
from smfe.diagnosis.cases.experiments import menu, modal_proposals
from smfe.diagnosis.checks.suspect import Suspect
from smfe.diagnosis.frf.axis import MachineFrfs, as_hit, condition_of, excitation_of
from smfe.diagnosis.frf.axis_baseline import AxisBaseline
from smfe.diagnosis.frf.modes import SPREAD, ModalFrfs
from smfe.diagnosis.frf.noise import DISCREPANCY, FEWEST, compared, freedom_of
from smfe.diagnosis.inference.problem import Condition
from smfe.identification.errors.result import Identification
from smfe.progress import Progress, silent

_LOWEST = 5.0
_LINES = 15  # over which the error of hits is averaged
_REACH = 3.0  # times the locked frequency: beyond, two masses say nothing


def axis_baseline(baseline: AxisModel) -> AxisBaseline:
    """Return the baseline of a campaign as one that can be questioned.

    Raises
    ------
    InputError
        When its friction is a law that cannot be questioned (LuGre, Maxwell slip, or one that differs by direction).
    """
    sigma, known = _friction(baseline.friction)
    return AxisBaseline(replace(baseline.drive, sigma=sigma), dict(baseline.servos), baseline.axis, known)


def _friction(law: FrictionLaw | MemoryLaw) -> tuple[float, dict[str, float]]:
    if isinstance(law, Viscous):
        return law.sigma, {}
    if isinstance(law, CoulombViscous):
        return law.sigma, {"coulomb": law.coulomb}
    if isinstance(law, Coulomb):
        return 0.0, {"coulomb": law.coulomb}
    if isinstance(law, Andersson) and law.negative is None:
        return law.sigma, {"coulomb": law.coulomb, "static": law.static, "stribeck_speed": law.stribeck_speed}
    raise InputError(
        f"baseline.friction: a {type(law).__name__} law cannot be questioned; give viscous, coulomb, "
        "coulomb_viscous or andersson"
    )


def case_of(campaign: Campaign, found: Mapping[str, Identification], progress: Progress = silent) -> Case:
    """Return what a campaign puts to the question, whatever its baseline predicts.

    Parameters
    ----------
    campaign : Campaign
        With ``[baseline]``.
    found : mapping
        Measurement name -> identification, where the baseline predicts compliances.
    progress : callable, optional
        Called with (what, done, of).

    Raises
    ------
    InputError
        Without a baseline, or when nothing can be compared with it.
    """
    baseline = campaign.baseline
    if baseline is None:
        raise InputError(
            'the campaign gives no [baseline]: say which simulation is to be questioned: axis = "x", moving_mass, '
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
        family, suspects = modal_family(campaign, modes, found), modes.suspects
    else:
        family = machine_family(campaign, found)
        family, suspects = replace(family, proposals=menu(family)), tuple(_too_few(campaign, found, baseline.axis))
    names = [c.name for c in family.conditions]
    held_out = tuple(m.name for m in campaign.measurements if m.held_out and m.name in names)
    return Case(family, {n: (n,) for n in names}, held_out, suspects)


def _too_few(campaign: Campaign, found: Mapping[str, Identification], axis: str) -> Iterator[Suspect]:
    """Name the hammer measurements that are not compared because few hits are left of them."""
    for m in campaign.measurements:
        if m.method == "hammer" and _shows(found.get(m.name), axis) and not _tells(m, found[m.name], axis):
            yield Suspect(
                "few_hits",
                "warning",
                m.name,
                f"{_fewest_hits(m, found[m.name], (axis,))} hits are used: what they have in common, a level or a "
                "state at rest, cannot be told from the machine",
                f"left out of the comparison; hit {FEWEST} times or more",
            )


def _tells(measurement: Measurement, found: Identification, axis: str) -> bool:
    """Whether there are enough hits for their scatter."""
    return measurement.method != "hammer" or _fewest_hits(measurement, found, (axis,)) >= FEWEST


def machine_family(campaign: Campaign, found: Mapping[str, Identification]) -> MachineFrfs:
    """Return the family of a campaign with the model of an axis: every hammer and actuator measurement along it.

    Parameters
    ----------
    campaign : Campaign
        With ``[baseline]``.
    found : mapping
        Measurement name -> identification.

    Raises
    ------
    InputError
        When no measurement shows its axis with an uncertainty.
    """
    if not isinstance(campaign.baseline, AxisModel):
        raise InputError("the baseline is not the model of an axis; give axis, moving_mass, tip_mass, stiffness ...")
    baseline = axis_baseline(campaign.baseline)
    axis, band = baseline.axis, (_LOWEST, _REACH * baseline.drive.locked_frequency)
    conditions = [
        _condition(m, found[m.name], (axis,), band, order, _controller(m, baseline), DISCREPANCY)
        for m, order in _ordered(campaign)
        if _shows(found.get(m.name), axis) and _tells(m, found[m.name], axis)
    ]
    if not conditions:
        raise InputError(
            f"no hammer or actuator measurement shows {axis} under a force along {axis} with its "
            "uncertainty (three hits or more); the baseline has nothing to be compared with"
        )
    return as_hit(MachineFrfs(baseline, tuple(conditions)), DISCREPANCY)


def modal_family(campaign: Campaign, modes: NamedModes, found: Mapping[str, Identification]) -> ModalFrfs:
    """Return the family of a campaign whose baseline is a modal model: every hammer and actuator measurement.

    Raises
    ------
    InputError
        When no measurement has an uncertainty.
    """
    band = (0.5 * modes.band[0], 2.0 * modes.band[1])
    conditions = []
    for m, order in _ordered(campaign):
        axes = tuple(a for a in AXES if _shows(found.get(m.name), a))
        if axes:
            conditions.append(_condition(m, found[m.name], axes, band, order, m.controller))
    if not conditions:
        raise InputError(
            "no hammer or actuator measurement has an uncertainty (three hits or more); the baseline has nothing to be "
            "compared with"
        )
    spread = {**SPREAD, **modes.spread}
    return ModalFrfs(modes.modal, tuple(conditions), modal_proposals(conditions), spread=spread)


def _ordered(campaign: Campaign) -> list[tuple[Measurement, float]]:
    """Return the hammer and actuator measurements with their places in the session."""
    pairs = zip(campaign.measurements, _orders(campaign.measurements), strict=True)
    return [(m, order) for m, order in pairs if m.method in ("hammer", "actuator")]


def _shows(found: Identification | None, axis: str) -> bool:
    if found is None or "compliance_std" not in found.compliance:
        return False
    there = all(axis in found.compliance[d].values for d in ("response", "excitation"))
    if not there:
        return False
    std = found.compliance["compliance_std"].sel(response=axis, excitation=axis).values
    return bool(np.isfinite(std).any())


def _condition(
    measurement: Measurement,
    found: Identification,
    axes: Sequence[str],
    band: tuple[float, float],
    order: float,
    controller: str | None,
    discrepancy: float = 0.0,
) -> Condition:
    compliance = found.compliance.sel(response=list(axes), excitation=list(axes))
    if measurement.method == "hammer":
        compliance = steadied(compliance)
    levels, durations = zip(*(_level(measurement, found, a) for a in axes), strict=True)
    feed = {a: float(v) for a, v in (measurement.feed or {}).items() if a in axes}
    settings: dict[str, float | str] = {
        "method": measurement.method,
        "feed": feed.get(axes[0], 0.0),
        "level": float(np.mean(levels)),
        "order": order,
        "controller": controller or "",
        "added_mass": measurement.added_mass or 0.0,
        **_position(measurement.position),
    }
    excited = excitation_of(
        compliance,
        measurement.method,
        float(np.mean(levels)),
        band,
        duration=float(np.mean(durations)),
        feed=feed,
        controller=controller,
    )
    hits = _fewest_hits(measurement, found, axes)
    if hits > 1:
        excited = replace(excited, noise_freedom=freedom_of(hits, excited.std.size))
    if discrepancy > 0.0:
        excited = compared(excited, found.compliance, found.hits.get(axes[0]), discrepancy)
    return condition_of(measurement.name, compliance, excited, settings, measurement.name)


def steadied(compliance: xr.Dataset) -> xr.Dataset:
    """Return a compliance whose standard deviation is the root mean square over neighbouring lines.

    That of a line by itself comes from a few hits: over it, residuals of noise alone have a mean square of
    (n - 1)/(n - 2) for n hits, 1.5 for four, and tails that no threshold allows for. Noise is smooth over frequency.
    """
    std = compliance["compliance_std"].transpose("frequency", ...)
    known = np.isfinite(std.values)
    squares = np.where(known, std.values**2, 0.0)
    square, count = (convolve1d(x, np.ones(_LINES), axis=0, mode="constant") for x in (squares, 1.0 * known))
    smooth = np.where(known, np.sqrt(square / np.maximum(count, 1.0)), np.nan)
    return compliance.assign(compliance_std=(std.dims, smooth, std.attrs))


def _controller(measurement: Measurement, baseline: AxisBaseline) -> str | None:
    name = measurement.controller
    if len(baseline.servos) == 1:
        return next(iter(baseline.servos))
    if name not in baseline.servos:
        raise InputError(
            f"measurement '{measurement.name}': controller {name!r} is none of the baseline's "
            f"{', '.join(baseline.servos)}; name one of them"
        )
    return name


def _position(text: str | None) -> dict[str, float | str]:
    """A position that is a length counts; a name of a place says only which are the same."""
    if text is None:
        return {}
    try:
        return {"position": units.parse(text, "length")}
    except InputError:
        return {"place": text}


def _level(measurement: Measurement, found: Identification, axis: str) -> tuple[float, float]:
    """Impulse [N s] and duration [s] of the hits used, or amplitude [N] of the actuator."""
    if measurement.method == "actuator":
        steps = found.tables["steps"]
        measured = steps[steps["excitation"] == axis]["force_N"].abs().median()
        return float(measurement.force_level or measured), 0.0
    hits = found.tables["hits"]
    used = hits[(hits["excitation"] == axis) & hits["used"].astype(bool)]
    # A half sine stays above a tenth of its peak for 93.6 % of its duration.
    return float(used["impulse_Ns"].abs().mean()), float(used["duration_ms"].mean()) * 1e-3 / 0.936


def _fewest_hits(measurement: Measurement, found: Identification, axes: Sequence[str]) -> int:
    """Hits that the scatter of the worst column comes from; 0 where it does not come from hits."""
    if measurement.method != "hammer":
        return 0
    hits = found.tables["hits"]
    return min(int(hits["used"][hits["excitation"] == a].sum()) for a in axes)


def _orders(measurements: Sequence[Measurement]) -> list[float]:
    """Place in the session, 0 to 1, where the campaign says when each was made; else all alike."""
    times = [m.started for m in measurements]
    if any(t is None for t in times) or len(times) < 2:
        return [0.0] * len(times)
    ranked = sorted(range(len(times)), key=lambda i: str(times[i]))
    out = [0.0] * len(times)
    for place, i in enumerate(ranked):
        out[i] = place / (len(times) - 1)
    return out
