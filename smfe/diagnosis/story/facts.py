"""What a campaign says of a cause beside what was found, in words: gains, delay, coefficients, edge forces."""

from __future__ import annotations

from collections.abc import Iterator

from smfe.diagnosis.cutting.forces import CuttingForces
from smfe.diagnosis.cutting.limits import CuttingLimits
from smfe.diagnosis.drive.record import DriveRecordFamily
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.inference.problem import Family, Values
from smfe.diagnosis.story.words import listed, rounded, unit_text

_ALIKE = 0.005
"""Relative difference below which two values are not told apart."""


def facts_of(family: Family, values: Values) -> dict[str, str]:
    """Return what the sentences of `smfe.diagnosis.story.to_do` may say beside the parameters of a cause.

    Parameters
    ----------
    family : Family
        What was tested.
    values : mapping of str to float
        Parameters of the extended model (SI).

    Returns
    -------
    dict of str to str
        ``gains``, ``dead_time``, ``coefficients_found``, ``edge_found``: those that differ from what was given.
    """
    if not values:
        return {}
    if isinstance(family, MachineFrfs):
        return dict(_of_servos(family, values))
    if isinstance(family, CuttingForces):
        return dict(_of_forces(family, values))
    if isinstance(family, CuttingLimits):
        return dict(_of_limits(family, values))
    if isinstance(family, DriveRecordFamily):
        return dict(_of_drive(family, values))
    return {}


def in_place_of(name: str, found: float, given: float, unit: str) -> str:
    """Return "Ktc 2700 N/mm² in place of 2000"; "" where both are alike."""
    if abs(found - given) <= _ALIKE * max(abs(found), abs(given)):
        return ""
    return f"{name} {rounded(found)}{unit_text(unit)} in place of {rounded(given)}"


def _of_servos(family: MachineFrfs, values: Values) -> Iterator[tuple[str, str]]:
    baseline = family.baseline
    if not baseline.servos:
        return
    # As they are set, not as the samples of the control make them act.
    found = baseline.effective({**values, "period": 0.0}, {}, 0.0).servos
    gains, delays = [], []
    for (name, given), servo in zip(baseline.servos.items(), found, strict=True):
        of = f" of {name}" if len(found) > 1 else ""
        told = (
            in_place_of(f"Kp{of}", servo.Kp, given.Kp, "N s/m"),
            in_place_of(f"Ti{of}", 1e3 * servo.Ti, 1e3 * given.Ti, "ms"),
            in_place_of(f"Kv{of}", servo.Kv, given.Kv, "1/s"),
        )
        gains += [t for t in told if t]
        if servo.delay != given.delay:
            delays.append(f'"{1e3 * servo.delay:.3g} ms"{of}')
    if gains:
        yield "gains", listed(gains)
    if delays:
        yield "dead_time", listed(delays)


def _of_drive(family: DriveRecordFamily, values: Values) -> Iterator[tuple[str, str]]:
    known = next(p for p in family.nuisances if p.name == "loop_delay.delay")
    delay = values.get(known.name, known.start)
    if abs(delay - known.start) > known.prior:
        yield "dead_time", f'"{1e3 * delay:.3g} ms"'
    told = [
        f"{name} {100.0 * abs(change):.2g} % {'higher' if change > 0.0 else 'lower'} than given"
        for name, key in (("Kv", "servo_gains.position"), ("Kp", "servo_gains.velocity"))
        if (change := values.get(key, 0.0))
    ]
    if told:
        yield "gains", listed(told)


def _of_forces(family: CuttingForces, values: Values) -> Iterator[tuple[str, str]]:
    given = dict(zip(("Ktc", "Krc", "Kac"), family.coefficients, strict=True))
    told = [
        in_place_of(name, 1e-6 * (values.get(name, k) + values.get(f"other_{name}", 0.0)), 1e-6 * k, "N/mm^2")
        for name, k in given.items()
    ]
    if any(told):
        yield "coefficients_found", listed([t for t in told if t])
    edge = [
        in_place_of(name, 1e-3 * values.get(name, k), 1e-3 * k, "N/mm")
        for name, k in zip(("Kte", "Kre", "Kae"), family.edge, strict=True)
    ]
    if any(edge):
        yield "edge_found", listed([t for t in edge if t])


def _of_limits(family: CuttingLimits, values: Values) -> Iterator[tuple[str, str]]:
    k, found = family.coefficients, family.material(values)
    told = [
        in_place_of(name, 1e-6 * getattr(found, name), 1e-6 * getattr(k, name), "N/mm^2")
        for name in ("Ktc", "Krc", "Kac")
    ]
    if any(told):
        yield "coefficients_found", listed([t for t in told if t])
