"""Sweep milling force excitation: passes in which the cutting force itself shakes the machine -> 3x3 compliance.

Down, up and central milling push the tool in different directions; together they separate the nine compliances. All
passes and lines go into one weighted least squares a frequency (`sweep.least_squares`), with all three measured forces
as references. How records become columns is the choice of an estimator object: `LocalPolynomial`, `Segments`,
`SingleReference` or `Orders`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.cut.engagement import Engagement
from process.cut.force import CuttingCoefficients, force_harmonics
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import make_compliance
from process.types import Real
from smfe.identification.errors.difference import reciprocity, symmetric
from smfe.identification.errors.result import Identification, in_words
from smfe.identification.sweep.chatter import without_chatter
from smfe.identification.sweep.delay import changed_by_delay
from smfe.identification.sweep.least_squares import Estimate, condition_number
from smfe.identification.sweep.local_polynomial import LocalPolynomial, solve_local
from smfe.identification.sweep.order_tracking import Orders
from smfe.identification.sweep.passes import PreparedPass, SweepPass, prepare
from smfe.identification.sweep.rules import RULES
from smfe.identification.sweep.segments import Segments, SingleReference
from smfe.identification.sweep.spindle_clock import changed_by_clock, judge_clock

Estimator = LocalPolynomial | Segments | SingleReference | Orders

Step = Callable[[int, int], None]
"""Called with (done, of)."""


def identify_sweep(
    name: str,
    passes: Sequence[SweepPass],
    frequency_range: tuple[float, float],
    estimator: Estimator | None = None,
    progress: Step | None = None,
    *,
    axes: Sequence[str] = ("x", "y", "z"),
    background: Sequence[SweepPass] = (),
    reciprocal: bool = False,
    teeth: int | None = None,
) -> Identification:
    """Identify the compliance from sweep passes.

    Parameters
    ----------
    name : str
        Name of the measurement.
    passes : sequence of SweepPass
        At least as many as there are axes, in independent directions.
    frequency_range : (float, float)
        Band to identify [Hz].
    estimator : LocalPolynomial, Segments, Orders or SingleReference, optional
        Default: `LocalPolynomial()`.
    progress : callable, optional
        Called with (done, of).
    axes : sequence of str, optional
        Axes of the forces that are references, for rigs with fewer sensors; one pass is enough for one.
    background : sequence of SweepPass, optional
        Air cuts over the same speeds (`LocalPolynomial`): what turns with the spindle becomes an input of its own, and
        the noise of the forces is taken from them.
    reciprocal : bool, optional
        Constrain the compliance to be symmetric.
    teeth : int, optional
        Of the tool. The speeds that records and passes state are compared with the passing of the teeth; without it,
        with all lines that repeat with the spindle.

    Returns
    -------
    Identification
        ``compliance``, ``compliance_std``, ``compliance_covariance`` (``E[d_j conj(d_k)]`` of the errors in one row,
        [m2/N2]), for `LocalPolynomial` ``entry_covariance`` (the same of all entries); ``coherence`` (adjusted multiple
        coherence; NaN for `SingleReference`, where three columns for three unknowns leave nothing to judge by),
        ``force_condition`` and, for `LocalPolynomial`, the ``half_width`` chosen [Hz]; ``degrees_of_freedom`` of
        Student's t for each part; ``compliance_gradient`` and its standard deviation where the fit depends on position:
        change from the middle to the end of a pass. Frequencies whose condition number exceeds
        `SweepRules.refuse_condition` are NaN.

    Raises
    ------
    InputError
        Too few passes; a record without the forces or without motion; a band that the records do not hold; records too
        short for the estimator; a speed that the passing of the teeth contradicts (`spindle_clock`); too few passes
        without chatter (`smfe.identification.sweep.chatter`); passes that are
        not independent, by their arcs or by the measured forces in more than
        half of the band.
    """
    chosen = LocalPolynomial() if estimator is None else estimator
    axes = [a for a in "xyz" if a in axes]
    prepared, air = [prepare(p) for p in passes], [prepare(p) for p in background]
    response = _check_passes([*prepared, *air], len(passes), axes)
    _check_band(prepared, frequency_range)
    if len(axes) == 3:
        check_independent([(p.label, p.arc) for p in prepared])
    clock = judge_clock(name, prepared, teeth)
    prepared, chatter = without_chatter(name, prepared, teeth, len(axes))
    frequency = chosen.axis(frequency_range, prepared)
    if isinstance(chosen, LocalPolynomial):
        found = solve_local(chosen, prepared, frequency, axes, response, air, progress)
    elif background:
        raise InputError(
            f"an air cut is subtracted by the local polynomial only, and the estimator is {type(chosen).__name__}; "
            "take background or estimator out"
        )
    else:
        found = chosen.solve(prepared, frequency, axes, response, progress)
    refused = ~(found.condition <= RULES.refuse_condition)
    if refused.mean() > 0.5:
        raise InputError(
            f"sweep '{name}': the measured forces of the passes ({', '.join(p.label for p in prepared)}) are not "
            f"independent: their condition number exceeds {RULES.refuse_condition:g} at {refused.sum()} of "
            f"{refused.size} frequencies, so nine compliances cannot be separated; add a pass with another width or "
            "kind of cut"
            + (
                ", or cut deeper and record from air to air: noise of the force sensor leaves the compliance open"
                if np.isinf(found.condition).mean() > 0.25
                else ""
            )
        )
    found.compliance[refused], found.covariance[refused] = np.nan, np.nan
    if found.between is not None:
        found.between[refused] = np.nan
    delay = found.delay if found.delay is not None and found.delay.real else None
    moved = []
    if clock.difference:
        acceleration = prepared[0].motion[0] == "acceleration"
        moved.append(changed_by_clock(found.compliance, frequency, clock.difference, acceleration))
    if delay is not None:
        moved.append(changed_by_delay(found.compliance, frequency, delay.late))
    for change in moved:
        found = replace(found, covariance=found.covariance + change[..., :, None] * change[..., None, :].conj())
    attrs = {"method": "sweep", "estimator": repr(chosen), "error_lines": found.error_lines}
    dataset = _labelled(frequency, found, response, axes, attrs)
    warnings = (
        *clock.warnings,
        *chatter,
        *([delay.in_words()] if delay is not None else []),
        *_condition_warnings(frequency, found.condition),
        *found.warnings,
        *_fewer_axes(axes),
    )
    if reciprocal:
        test = reciprocity(dataset)
        dataset = symmetric(dataset)
        if test.p_value < 1e-4:
            warnings += (
                f"the compliance is not reciprocal: Phi_ij and Phi_ji differ by {100.0 * test.size:.2g} % beyond noise "
                f"(p = {test.p_value:.1e}, most at {test.worst:.4g} Hz), and were forced to be equal; leave "
                "reciprocal out, or look for a sensor that is turned or away from the tool",
            )
    return Identification(name, "sweep", dataset, {"passes": _pass_table(prepared, axes)}, warnings)


def _labelled(
    frequency: Real, found: Estimate, response: Sequence[str], axes: Sequence[str], attrs: dict[str, Any]
) -> xr.Dataset:
    """Return the compliance with its labels; a second set of excitations is the change along the pass."""
    three, e = ("frequency", "response", "excitation"), len(axes)
    covariance, std = found.covariance[..., :e, :e], found.std
    extra: dict[str, Any] = {
        "compliance_std": (three, std[..., :e]),
        "compliance_covariance": ((*three, "other_excitation"), covariance),
        "coherence": (three[:2], found.coherence),
        "force_condition": (three[:1], found.condition),
    }
    if found.between is not None:
        whole = found.between[:, :, :e, :, :e].copy()
        for r in range(len(response)):
            whole[:, r, :, r] = covariance[:, r]
        extra["entry_covariance"] = ((*three, "other_response", "other_excitation"), whole)
    if found.compliance.shape[2] > e:
        extra["compliance_gradient"] = (three, found.compliance[..., e:])
        extra["compliance_gradient_std"] = (three, std[..., e:])
    if found.half_width is not None:
        extra["half_width"] = (three[:2], found.half_width)
    if found.degrees_of_freedom is not None:
        # All entries of a row have the same residual; the label is that of every method.
        extra["degrees_of_freedom"] = (three, np.repeat(found.degrees_of_freedom[..., None], e, axis=2))
    return make_compliance(frequency, found.compliance[..., :e], response, list(axes), extra=extra, attrs=attrs)


def _fewer_axes(axes: Sequence[str]) -> tuple[str, ...]:
    missing = [a for a in "xyz" if a not in axes]
    if not missing:
        return ()
    return (
        f"forces along {' and '.join(missing)} are no references: what they cause is noise where it is unlike the "
        f"others, and counted to {' and '.join(axes)} where it is alike, which is in no standard deviation",
    )


# --- what is refused before anything is solved -----------------------------------------------------------------------


def _check_passes(passes: Sequence[PreparedPass], cutting: int, axes: Sequence[str]) -> list[str]:
    """Return the response axes that all passes share."""
    if not axes:
        raise InputError('no axis is a reference; give axes = ["x", "y", "z"] or those whose forces are recorded')
    if cutting < len(axes):
        number = {3: "nine", 2: "four", 1: "one"}[len(axes)]
        raise InputError(
            f"a sweep measurement with {cutting} passes ({', '.join(p.label for p in passes)}); {number} compliances "
            f"need {('one pass', 'two passes', 'three passes')[len(axes) - 1]} that push in different directions: add "
            "a down, an up or a central pass"
        )
    shared: list[str] = ["x", "y", "z"]
    for p in passes:
        missing = [a for a in axes if a not in p.force_axes]
        if missing:
            raise InputError(
                f"pass '{p.label}' has no force_{missing[0]}; all three forces are needed as references: "
                "declare it in [channels], or name those there are in axes"
            )
        shared = [a for a in shared if a in p.motion[1]]
    if not shared:
        raise InputError("the passes have no axis of motion in common; record the same accelerations in each")
    return shared


def _check_band(passes: Sequence[PreparedPass], band: tuple[float, float]) -> None:
    for p in passes:
        nyquist = 0.5 / p.interval
        if not 0.0 < band[0] < band[1] < nyquist:
            raise InputError(
                f"the frequency range {band[0]:g} to {band[1]:g} Hz does not lie between 0 and the Nyquist frequency "
                f"of {nyquist:g} Hz of pass '{p.label}'; give a frequency_range that rises within it"
            )


def check_independent(arcs: Sequence[tuple[str, Engagement | None]]) -> None:
    """Refuse passes whose forces are dependent by geometry.

    Forces add up over the arc: a pass whose arc is the sum of others brings nothing new at any harmonic, for any tool
    and material. All distinct arcs together must span three directions in at least one of the first harmonics of a
    probe with unlike coefficients. Passes of unknown arc are left to the measured forces.

    Parameters
    ----------
    arcs : sequence of (str, Engagement or None)
        What each pass is called, and its arc.

    Raises
    ------
    InputError
        When they do not.
    """
    distinct = {arc: label for label, arc in arcs if arc is not None}
    if any(arc is None for _, arc in arcs) or _best_condition(list(distinct)) <= 1e6:
        return
    raise InputError(
        f"the passes {', '.join(distinct.values())} are not independent: cutting forces add up over the arc of "
        "engagement, so a pass whose arc is the sum of the others repeats them (half-immersion down and up milling "
        "add up to the slot) and the nine compliances cannot be separated; change one width, e.g. widths of 30, 50 "
        "and 85 % of the diameter for down, up and central milling"
    )


def _best_condition(arcs: Sequence[Engagement]) -> float:
    """Smallest condition number of the force directions over the first harmonics, equal teeth."""
    if len(arcs) < 3:
        return float("inf")
    coefficients = CuttingCoefficients(1.0, 0.4, 0.15, 1e-4, 1.5e-4, 1e-5)
    probe = Tool(1.0, 2, np.pi / 4)
    conditions = []
    for harmonic in (1, 2, 3):
        force = [force_harmonics(probe, arc, coefficients, 1.0, 1e-4, [harmonic])[0] for arc in arcs]
        unit = [f / max(float(np.linalg.norm(f)), 1e-300) for f in force]
        conditions.append(condition_number(np.array(unit, dtype=np.complex128).T))
    return min(conditions)


# --- tables and words -------------------------------------------------------------------------------------------------


def _pass_table(passes: Sequence[PreparedPass], axes: Sequence[str]) -> pd.DataFrame:
    """Return a row a pass: rms of each force over the record, and of their magnitude, with its peak, in the cut."""
    rows = []
    for p in passes:
        force = p.record["force"].sel(axis=list(axes)).values
        rms = np.sqrt(np.mean(force**2, axis=1))
        whole = np.sum(force[:, p.cutting] ** 2, axis=0)
        rows.append(
            {
                "pass": p.label,
                "duration_s": p.seconds,
                **{f"force_{a}_rms_N": value for a, value in zip(axes, rms, strict=True)},
                "force_rms_N": np.sqrt(np.mean(whole)),
                "force_peak_N": np.sqrt(np.max(whole)),
                "from_rest_to_rest": p.at_rest,
            }
        )
    return pd.DataFrame(rows)


def _condition_warnings(frequency: Real, condition: Real) -> tuple[str, ...]:
    out = []
    refused = ~(condition <= RULES.refuse_condition)
    for mask, text in (
        (refused, f"not solved: condition number of the forces above {RULES.refuse_condition:g}"),
        (~refused & (condition > RULES.warn_condition), f"badly conditioned (above {RULES.warn_condition:g})"),
    ):
        if mask.any():
            out.append(f"{text} in {in_words(frequency, mask)}")
    return tuple(out)
