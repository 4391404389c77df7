"""What was measured beside what the models say of it, condition by condition, and how far they are off.

One dataset for every family: ``measured``, ``baseline``, ``refitted`` and ``extended`` over (condition, point, entry),
complex where they are compliances, not a number behind the end of a shorter condition. ``baseline`` is the simulation
as the campaign declares it, nothing refitted; ``refitted`` is the best that it can do without any cause. Where a
condition could be left out of the fit, fitted models are those that have not seen it (coordinate ``unseen``);
``held_out`` are those that the campaign sets aside.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.labels import AXES
from process.types import Complex, Real
from smfe.diagnosis.cutting.forces import CuttingForces, turned
from smfe.diagnosis.cutting.limits import CuttingLimits
from smfe.diagnosis.cutting.orders import CuttingOrders
from smfe.diagnosis.drive.record import DriveRecordFamily, ForceData
from smfe.diagnosis.evidence.cuts import CutAtAxis
from smfe.diagnosis.evidence.family import AxisEvidence
from smfe.diagnosis.evidence.moves import Record
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.modes import ModalFrfs
from smfe.diagnosis.frf.noise import excited_of
from smfe.diagnosis.inference.problem import Condition, Family
from smfe.diagnosis.judgement.finding import Compared, ConditionMisfit, Finding, ModelError, Prediction

MODELS = ("baseline", "refitted", "extended")
"""Variables of the models: as declared, the best without a cause, the best."""

ANGLES = np.arange(0.0, 361.0, 2.0)
"""Spindle angles over which cutting forces are drawn [degrees]."""


WELL_KNOWN, ENOUGH = 0.2, 0.25
"""Relative standard deviation of a line that counts in the error of a compliance, and share of the lines that must be
known so well, else all count: what is mostly noise says nothing of a model."""


@dataclass(frozen=True)
class Kind:
    """How the conditions of a family are compared and drawn."""

    name: str  # what was measured: "compliance", "drive_force", "cutting_force", "limit_depth"
    unit: str  # of it
    over: str  # what it is drawn over
    over_unit: str
    of: str  # what a condition is: "measurements", "moves", "cuts", "limits"
    alike: bool = True  # whether every condition counts alike in an error; else by its size


COMPLIANCE = Kind("compliance", "m/N", "frequency", "Hz", "measurements")
DRIVE_FORCE = Kind("drive_force", "N", "time", "s", "moves", alike=False)
CUTTING_FORCE = Kind("cutting_force", "N", "angle", "deg", "cuts")
LIMIT_DEPTH = Kind("limit_depth", "mm", "spindle_speed", "rpm", "limits")
HALF_RECORD = Kind("drive_force", "N", "time", "s", "halves of drive records", alike=False)
KINDS = (COMPLIANCE, DRIVE_FORCE, HALF_RECORD, CUTTING_FORCE, LIMIT_DEPTH)


@dataclass(frozen=True)
class Curve:
    """A condition in the units of its measurement."""

    over: Real  # (n,)
    measured: Complex | Real  # (n, entries)
    entries: tuple[str, ...]
    predict: Callable[[Prediction], Complex | Real]  # from what a model predicts, (n, entries)
    velocity: Real | None = None  # of a moving axis [m/s], (n,)
    counts: NDArray[np.bool_] | None = None  # what counts in the error, (n, entries); None: all
    kind: Kind = COMPLIANCE


def with_curves(family: Family, finding: Finding) -> Finding:
    """Return a finding with its curves, the error of each condition, and that of all; as it is where none is known.

    Where an axis has more evidence than compliances the curves are those of the compliances; errors are of everything.
    """
    known = [(c, curve) for c in finding.compared if (curve := _curve(family, c.condition)) is not None]
    if not known:
        return finding
    rows = [(c, curve, _models(c)) for c, curve in known]
    rows = [row for row in rows if row[2]]
    misfits = {m.name: m for m in finding.conditions}
    sums: dict[tuple[str, str], list[tuple[float, float, float, float]]] = {
        (k.of, tested): [] for k in KINDS for tested in ("set aside", "left out in turn", "fitted")
    }
    for c, curve, models in rows:
        errors_of = _squares(curve, models)
        whole = _square(curve, curve.measured)
        size = 1.0 if curve.kind.alike else whole
        name, unseen = c.condition.name, bool(c.unseen)
        tested = "set aside" if c.held_out else "left out in turn" if unseen else "fitted"
        before, refitted, after = (square / whole for square in errors_of)
        sums[curve.kind.of, tested].append((size * before, size * after, size * refitted, size))
        misfits[name] = replace(
            misfits[name],
            error_before=before**0.5,
            error_refitted=refitted**0.5,
            error_after=after**0.5,
            unseen=unseen,
        )
    errors = tuple(
        ModelError(of, len(found), tested, *(_root_mean(found, k) for k in (0, 1, 2)))
        for (of, tested), found in sums.items()
        if found
    )
    conditions: tuple[ConditionMisfit, ...] = tuple(misfits[m.name] for m in finding.conditions)
    kind = rows[0][1].kind
    drawn = [row for row in rows if row[1].kind is kind]
    return replace(
        finding, conditions=conditions, errors=errors, curves=_dataset(kind, drawn, misfits, bool(finding.causes))
    )


def _root_mean(found: Sequence[tuple[float, float, float, float]], k: int) -> float:
    return float(np.sqrt(sum(x[k] for x in found) / max(sum(x[-1] for x in found), 1e-300)))


Models = tuple[Prediction, Prediction, Prediction]
"""What the simulation as declared, the refitted one and the extended model predict."""


def _models(c: Compared) -> tuple[Models, ...]:
    """Return what the models predict: fitted ones without having seen the condition, where that is known."""
    if c.before is None:
        return ()
    if c.unseen:
        return tuple((c.before, *both) for both in c.unseen)
    return ((c.before, c.refitted, c.after),) if c.refitted is not None and c.after is not None else ()


def _squares(curve: Curve, models: Sequence[Models]) -> list[float]:
    """Squares of each model's error, the mean over the ways in which the condition was left out."""
    each = [[_square(curve, curve.predict(p) - curve.measured) for p in own] for own in models]
    return [float(x) for x in np.mean(each, axis=0)]


def _square(curve: Curve, values: Complex | Real) -> float:
    return float(np.sum(np.abs(values if curve.counts is None else values[curve.counts]) ** 2))


def _dataset(
    kind: Kind,
    rows: Sequence[tuple[Compared, Curve, Sequence[Models]]],
    misfits: Mapping[str, ConditionMisfit],
    repaired: bool,
) -> xr.Dataset:
    entries = tuple(dict.fromkeys(e for _, curve, _ in rows for e in curve.entries))
    shape = (len(rows), max(curve.over.size for _, curve, _ in rows), len(entries))
    number = np.complex64 if kind is COMPLIANCE else np.float32
    found = {name: np.full(shape, np.nan, dtype=number) for name in ("measured", *MODELS)}
    over, velocity = (np.full(shape[:2], np.nan, dtype=np.float32) for _ in range(2))
    for i, (_, curve, models) in enumerate(rows):
        n, places = curve.over.size, [entries.index(e) for e in curve.entries]
        over[i, :n] = curve.over
        if curve.velocity is not None:
            velocity[i, :n] = curve.velocity
        shown = (curve.measured, *(curve.predict(p) for p in models[0]))
        for values, y in zip(found.values(), shown, strict=True):
            values[i, :n, places] = y.T
    errors = {
        "error_baseline": [misfits[c.condition.name].error_before for c, _, _ in rows],
        "error_refitted": [misfits[c.condition.name].error_refitted for c, _, _ in rows],
        "error_extended": [misfits[c.condition.name].error_after for c, _, _ in rows],
    }
    if not repaired:
        del found["extended"], errors["error_extended"]
    every = ("condition", "point", "entry")
    data = {name: (every, values, {"units": kind.unit}) for name, values in found.items()}
    out = xr.Dataset(
        {
            **data,
            **{name: ("condition", values, {"units": "1"}) for name, values in errors.items()},
            kind.over: (every[:2], over, {"units": kind.over_unit}),
        },
        coords={
            "condition": [c.condition.name for c, _, _ in rows],
            "entry": list(entries),
            "held_out": ("condition", [c.held_out for c, _, _ in rows]),
            "unseen": ("condition", [bool(c.unseen) for c, _, _ in rows]),
        },
        attrs={"kind": kind.name, "over": kind.over},
    )
    return out.assign(velocity=(every[:2], velocity, {"units": "m/s"})) if np.isfinite(velocity).any() else out


# --- Of each family.


def _curve(family: Family, condition: Condition) -> Curve | None:
    if condition.observed is None:
        return None
    if isinstance(family, AxisEvidence) and isinstance(condition.data, Record):
        return _half_record(family, condition.data)
    if isinstance(family, AxisEvidence) and isinstance(condition.data, CutAtAxis):
        return _limit_at_axis(family, condition.data)
    if isinstance(family, MachineFrfs | ModalFrfs):
        return _compliance(condition, condition.observed)
    if isinstance(family, DriveRecordFamily) and isinstance(condition.data, ForceData):
        return _drive_force(family, condition.data)
    if isinstance(family, CuttingForces) and isinstance(condition.data, CuttingOrders):
        return _cutting_force(family, condition.data)
    if isinstance(family, CuttingLimits):
        return _limit_depth(family, condition)
    return None


def _half_record(family: AxisEvidence, record: Record) -> Curve | None:
    moves = [m.data for m in record.moves if isinstance(m.data, ForceData)]
    if family.moves is None or not moves:
        return None
    axis, own = family.moves, family.moves.family
    each = [_drive_force(own, data) for data in moves]

    def predicted(p: Prediction) -> Real:
        values = axis.values(p.values)
        return np.concatenate([own.force(data, values)[own.model.whitener.order :, None] for data in moves])

    over, measured = (np.concatenate(x) for x in zip(*((c.over, c.measured) for c in each), strict=True))
    return Curve(over, measured, ("force",), predicted, kind=HALF_RECORD)


def _limit_at_axis(family: AxisEvidence, cut: CutAtAxis) -> Curve | None:
    cuts, depth = family.cuts, cut.limit.depth
    if cuts is None or depth is None:
        return None

    def predicted(p: Prediction) -> Real:
        found = cuts.depth(cut, p.values)
        return np.array([[1e3 * found if np.isfinite(found) else 0.0]])

    speed = np.array([cut.limit.spindle_speed])
    return Curve(speed, np.array([[1e3 * depth]]), ("depth",), predicted, kind=LIMIT_DEPTH)


def _compliance(condition: Condition, observed: Real) -> Curve:
    excited = excited_of(condition)

    def physical(whitened: Real) -> Complex:
        return excited.unwhitened(whitened[:, None])[:, 0].reshape(len(excited.entries), -1).T

    entries = tuple(r + e for r, e in excited.entries)
    found = physical(observed)
    known = excited.std < WELL_KNOWN * np.abs(found)
    counts = known if known.mean() > ENOUGH else None
    return Curve(excited.frequency, found, entries, lambda p: physical(p.whitened), counts=counts)


def _drive_force(family: DriveRecordFamily, data: ForceData) -> Curve:
    begin, kept = family.model.whitener.order, family.model.resampler
    seen = slice(kept.margin, kept.margin + kept.every * data.force.size, kept.every)
    velocity = data.motion.velocity[seen][begin:]
    return Curve(
        data.motion.time[seen][begin:],
        data.force[begin:, None],
        ("force",),
        lambda p: family.force(data, p.values)[begin:, None],
        velocity,
        kind=DRIVE_FORCE,
    )


def _cutting_force(family: CuttingForces, found: CuttingOrders) -> Curve:
    wave = np.exp(1j * np.radians(ANGLES)[:, None] * np.arange(found.value.shape[0]))

    def force(orders: Complex) -> Real:
        return np.asarray((wave @ np.where(found.used, orders, 0.0)).real)

    def predicted(p: Prediction) -> Real:
        return force(turned(family.orders(found, p.values), found))

    return Curve(ANGLES, force(found.value), AXES, predicted, kind=CUTTING_FORCE)


def _limit_depth(family: CuttingLimits, condition: Condition) -> Curve | None:
    speed, depth = family.found(condition)
    if depth is None:
        return None

    def predicted(p: Prediction) -> Real:
        return np.array([[1e3 * family.depth(condition, p.values)]])

    return Curve(np.array([speed]), np.array([[1e3 * depth]]), ("depth",), predicted, kind=LIMIT_DEPTH)
