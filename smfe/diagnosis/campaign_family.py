"""From a campaign to the family of models that is diagnosed: its baseline, and its compliances as conditions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from process import units
from process.errors import InputError
from process.friction import Andersson, Coulomb, CoulombViscous, FrictionLaw, MemoryLaw, Viscous
from smfe.campaign import Baseline, Campaign, Measurement
from smfe.diagnosis.axis_baseline import AxisBaseline
from smfe.diagnosis.machine_frf import MachineFrfs, condition_of, excitation_of
from smfe.diagnosis.problem import Condition
from smfe.identification import Identification

_LOWEST = 5.0
_REACH = 3.0  # times the locked frequency: beyond, two masses say nothing


def axis_baseline(baseline: Baseline) -> AxisBaseline:
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


def machine_family(campaign: Campaign, found: Mapping[str, Identification]) -> MachineFrfs:
    """Return the family of a campaign with a baseline: every hammer and actuator measurement along its axis.

    Parameters
    ----------
    campaign : Campaign
        With ``[baseline]``.
    found : mapping
        Measurement name -> identification.

    Raises
    ------
    InputError
        Without a baseline, or when no measurement shows its axis with an uncertainty.
    """
    if campaign.baseline is None:
        raise InputError(
            'the campaign gives no [baseline]: say which simulation is to be questioned, e.g. axis = "x", moving_mass, '
            "tip_mass, stiffness, damping, Kp, Ti, Kv, friction"
        )
    baseline = axis_baseline(campaign.baseline)
    conditions = [
        _condition(m, found[m.name], baseline, order)
        for m, order in zip(campaign.measurements, _orders(campaign.measurements), strict=True)
        if m.method in ("hammer", "actuator") and _shows(found.get(m.name), baseline.axis)
    ]
    if not conditions:
        raise InputError(
            f"no hammer or actuator measurement shows {baseline.axis} under a force along {baseline.axis} with its "
            "uncertainty (three hits or more); the baseline has nothing to be compared with"
        )
    return MachineFrfs(baseline, tuple(conditions))


def _shows(found: Identification | None, axis: str) -> bool:
    if found is None or "compliance_std" not in found.compliance:
        return False
    there = all(axis in found.compliance[d].values for d in ("response", "excitation"))
    if not there:
        return False
    std = found.compliance["compliance_std"].sel(response=axis, excitation=axis).values
    return bool(np.isfinite(std).any())


def _condition(measurement: Measurement, found: Identification, baseline: AxisBaseline, order: float) -> Condition:
    axis = baseline.axis
    compliance = found.compliance.sel(response=[axis], excitation=[axis])
    level, duration = _level(measurement, found, axis)
    feed = {a: float(v) for a, v in (measurement.feed or {}).items() if a == axis}
    controller = _controller(measurement, baseline)
    settings: dict[str, float | str] = {
        "method": measurement.method,
        "feed": feed.get(axis, 0.0),
        "level": level,
        "order": order,
        "controller": controller or "",
        "added_mass": measurement.added_mass or 0.0,
    }
    if measurement.position is not None:
        settings["position"] = _position(measurement.position)
    band = (_LOWEST, _REACH * baseline.drive.locked_frequency)
    excited = excitation_of(
        compliance, measurement.method, level, band, duration=duration, feed=feed, controller=controller
    )
    return condition_of(measurement.name, compliance, excited, settings, measurement.name)


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


def _position(text: str) -> float:
    """A position that is a length counts; a name of a place says only which are the same."""
    try:
        return units.parse(text, "length")
    except InputError:
        return 0.0


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
