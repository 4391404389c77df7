"""Sweep milling force excitation: passes in which the cutting force itself shakes the machine -> 3x3 compliance.

Down, up and central milling push the tool in different directions; together they separate the nine compliances. All
passes and lines go into one weighted least squares a frequency (`smfe.least_squares`), with all three measured forces
as references. How records become columns is the choice of an estimator object (`smfe.sweep_estimators`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import ndimage

from process.cutting import CuttingCoefficients, force_harmonics
from process.engagement import Engagement
from process.errors import InputError
from process.labels import axis_present, make_compliance, sample_interval
from process.tool import Tool
from smfe.identification import Identification
from smfe.least_squares import Columns, Solution, condition_number, solve
from smfe.spectra import BlockSpectra, motion_axes
from smfe.sweep_estimators import (
    HANN_ERROR_LINES,
    Estimator,
    LocalPolynomial,
    Segments,
    SingleReference,
    SweepPass,
    at_rest,
    end_pieces,
)

WARN_CONDITION = 30.0
"""Above this condition number of the forces a frequency is reported as badly conditioned."""

REFUSE_CONDITION = 200.0
"""Above this condition number a frequency is not solved."""

Step = Callable[[int, int], None]
"""Called with (done, of)."""

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@dataclass(frozen=True)
class _Estimate:
    """A compliance before it is labelled; shapes (f, r, 3), (f, r, 3, 3), (f, r), (f,), (f, r) or None."""

    compliance: Complex
    covariance: Complex
    coherence: Real
    condition: Real
    error_lines: float
    half_width: Real | None = None
    warnings: tuple[str, ...] = ()


def identify_sweep(
    name: str,
    passes: Sequence[SweepPass],
    frequency_range: tuple[float, float],
    estimator: Estimator | None = None,
    progress: Step | None = None,
) -> Identification:
    """Identify the compliance from sweep passes.

    Parameters
    ----------
    name : str
        Name of the measurement.
    passes : sequence of SweepPass
        At least three that push in independent directions.
    frequency_range : (float, float)
        Band to identify [Hz].
    estimator : LocalPolynomial, Segments or SingleReference, optional
        Default: `LocalPolynomial()`.
    progress : callable, optional
        Called with (done, of).

    Returns
    -------
    Identification
        ``compliance``, ``compliance_std``, ``compliance_covariance`` (``E[d_j conj(d_k)]`` of the errors in one row,
        [m2/N2]), ``coherence`` (adjusted multiple coherence; NaN for `SingleReference`, where three columns for three
        unknowns leave nothing to judge by), ``force_condition`` and, for `LocalPolynomial`, the ``half_width`` chosen
        [Hz]. Frequencies whose condition number exceeds `REFUSE_CONDITION` are NaN.

    Raises
    ------
    InputError
        Fewer than three passes; a record without three forces or without motion; a band that the records do not
        hold; records too short for the estimator; passes that are not independent, by their arcs or by the measured
        forces in more than half of the band.
    """
    chosen = LocalPolynomial() if estimator is None else estimator
    response = _check_passes(passes)
    _check_band(passes, frequency_range)
    check_independent([(p.label, p.arc) for p in passes])
    frequency = chosen.axis(frequency_range, passes)
    if isinstance(chosen, LocalPolynomial):
        found = _local(chosen, passes, frequency, response, progress)
    elif isinstance(chosen, Segments):
        found = _segments(chosen, passes, frequency, response, progress)
    else:
        found = _single(chosen, passes, frequency, response)
    refused = ~(found.condition <= REFUSE_CONDITION)
    if refused.mean() > 0.5:
        raise InputError(
            f"sweep '{name}': the measured forces of the passes ({', '.join(p.label for p in passes)}) are not "
            f"independent: their condition number exceeds {REFUSE_CONDITION:g} at {refused.sum()} of {refused.size} "
            "frequencies, so nine compliances cannot be told apart; add a pass with another width or kind of cut"
        )
    found.compliance[refused], found.covariance[refused] = np.nan, np.nan
    three = ("frequency", "response", "excitation")
    extra = {
        "compliance_std": (three, np.sqrt(np.diagonal(found.covariance, axis1=2, axis2=3).real)),
        "compliance_covariance": ((*three, "other_excitation"), found.covariance),
        "coherence": (three[:2], found.coherence),
        "force_condition": (three[:1], found.condition),
    }
    if found.half_width is not None:
        extra["half_width"] = (three[:2], found.half_width)
    attrs = {"method": "sweep", "estimator": repr(chosen), "error_lines": found.error_lines}
    dataset = make_compliance(frequency, found.compliance, response, extra=extra, attrs=attrs)
    warnings = (*_condition_warnings(frequency, found.condition), *found.warnings)
    return Identification(name, "sweep", dataset, {"passes": _pass_table(passes)}, warnings)


# --- what is refused before anything is solved -----------------------------------------------------------------------


def _check_passes(passes: Sequence[SweepPass]) -> list[str]:
    """Return the response axes that all passes share."""
    if len(passes) < 3:
        raise InputError(
            f"a sweep measurement with {len(passes)} passes ({', '.join(p.label for p in passes)}); nine compliances "
            "need three passes that push in different directions: add a down, an up or a central pass"
        )
    shared: list[str] = ["x", "y", "z"]
    for p in passes:
        missing = [a for a in "xyz" if a not in axis_present(p.record, "force")]
        if missing:
            raise InputError(
                f"pass '{p.label}' has no force_{missing[0]}; all three forces are needed as references: "
                "declare it in [channels]"
            )
        shared = [a for a in shared if a in motion_axes(p.record)[1]]
    if not shared:
        raise InputError("the passes have no axis of motion in common; record the same accelerations in each")
    return shared


def _check_band(passes: Sequence[SweepPass], band: tuple[float, float]) -> None:
    for p in passes:
        nyquist = 0.5 / sample_interval(p.record)
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


# --- the local polynomial ---------------------------------------------------------------------------------------------


def _local(
    estimator: LocalPolynomial,
    passes: Sequence[SweepPass],
    frequency: Real,
    response: Sequence[str],
    progress: Step | None,
) -> _Estimate:
    """Solve with every half width that the records can fill and choose among them row by row."""
    restless = [not at_rest(p.record) for p in passes]
    spectra = estimator.spectra(passes, frequency, response)
    widths = _usable_widths(estimator, passes, restless)
    noise, solved = None, []
    for number, width in enumerate(widths):
        columns = [estimator.columns(spectra, restless, f, width) for f in frequency]
        if noise is None:
            noise = _noise(columns)
        solutions = []
        for i, c in enumerate(columns):
            solutions.append(solve(c, 3, noise[i]))
            if progress is not None:
                progress(number * frequency.size + i + 1, len(widths) * frequency.size)
        solved.append(_stack(solutions, estimator.error_lines(width)))
    found = _choose(estimator, widths, solved, frequency)
    return _with_force_noise(found, passes, spectra, frequency)


def _usable_widths(estimator: LocalPolynomial, passes: Sequence[SweepPass], restless: Sequence[bool]) -> list[float]:
    """Return the half widths over which the passes give at least twice as many lines as there are unknowns."""
    seconds = sum(p.record.sizes["time"] * sample_interval(p.record) for p in passes)
    needed = 2.0 * estimator.unknowns(restless)
    usable = [w for w in sorted(estimator.half_widths) if 2.0 * w * seconds >= needed]
    if not usable:
        widest = max(estimator.half_widths)
        raise InputError(
            f"the passes last {seconds:.3g} s together: {2.0 * widest * seconds:.0f} lines within {widest:g} Hz of a "
            f"frequency for {needed / 2.0:.0f} unknowns; at least {needed / (2.0 * widest):.3g} s are needed: sweep "
            "more slowly or add passes"
        )
    return usable


def _stack(solutions: Sequence[Solution], error_lines: float) -> _Estimate:
    return _Estimate(
        np.array([s.compliance for s in solutions]),
        np.array([s.covariance for s in solutions]),
        np.array([s.coherence for s in solutions]),
        np.array([s.condition for s in solutions]),
        error_lines,
    )


def _choose(
    estimator: LocalPolynomial, widths: Sequence[float], solved: Sequence[_Estimate], frequency: Real
) -> _Estimate:
    """Take, row by row, the widest band that agrees with all narrower ones; charge what even the narrowest bends."""
    rows = solved[0].compliance.shape[:2]
    index = np.zeros(rows, dtype=int)
    agrees = np.ones(rows, dtype=bool)
    for k in range(1, len(widths)):
        for narrower in solved[:k]:
            agrees &= _difference(solved[k], narrower) <= estimator.agreement
        # A mode bends the compliance over several lines; a single line that agrees by chance does not count.
        agrees = ndimage.median_filter(agrees, size=(5, 1), mode="nearest")
        index[agrees] = k
    f, r = np.ogrid[: rows[0], : rows[1]]
    compliance = np.array([s.compliance for s in solved])[index, f, r]
    covariance = np.array([s.covariance for s in solved])[index, f, r]
    coherence = np.array([s.coherence for s in solved])[index, f, r]
    condition = np.array([s.condition for s in solved])[index, f].max(axis=1)
    warnings: tuple[str, ...] = ()
    if len(widths) > 1:
        bent = (index == 0) & ~agrees
        # The bias of a polynomial of order p grows with width^(p+1), so doubling the width shows it 2^(p+1) - 1 fold.
        growth = (widths[1] / widths[0]) ** (estimator.order + 1) - 1.0
        bias = np.where(bent[..., None], (solved[1].compliance - solved[0].compliance) / growth, 0.0)
        clear = np.abs(bias) > np.sqrt(np.diagonal(covariance, axis1=2, axis2=3).real)
        covariance = covariance + bias[..., :, None] * bias[..., None, :].conj()
        if clear.any():
            where = _in_words(frequency, clear.any(axis=(1, 2)))
            warnings = (
                f"resonances are narrower than the finest band of {2 * widths[0]:g} Hz in {where}: their peaks come "
                "out too low by about what the standard deviation says; sweep more slowly so that the lines lie "
                "closer, and use smaller half_widths",
            )
    width = np.asarray(widths)[index]
    lines = float(np.mean([estimator.error_lines(w) for w in width.ravel()]))
    return _Estimate(compliance, covariance, coherence, condition, lines, width, warnings)


def _difference(a: _Estimate, b: _Estimate) -> Real:
    """Largest difference within a row, in standard deviations of b, shape (f, r)."""
    std = np.sqrt(np.diagonal(b.covariance, axis1=2, axis2=3).real)
    ratio = np.abs(a.compliance - b.compliance) / np.where(std > 0.0, std, np.inf)
    return np.asarray(np.nan_to_num(ratio).max(axis=2))


def _with_force_noise(
    found: _Estimate, passes: Sequence[SweepPass], spectra: Sequence[BlockSpectra], frequency: Real
) -> _Estimate:
    """Charge what noise on the forces takes from the compliance: ``E[Phi_hat] = Phi (1 - N (F F^H)^-1)``.

    N is the noise of the force channels in the air before and after the cut, where the record has it.
    """
    if not all(at_rest(p.record) for p in passes):
        text = "a pass begins or ends in the cut, so what noise on the forces takes from the compliance is unknown"
        return replace(found, warnings=(*found.warnings, text))
    assert found.half_width is not None
    power = []
    for p in passes:
        rms, dt = end_pieces(p.record, "force"), sample_interval(p.record)
        power.append(np.minimum(rms[:, 0], rms[:, -1]) ** 2 * dt**2 * p.record.sizes["time"])
    loss = np.empty(found.compliance.shape, dtype=complex)
    for i, f0 in enumerate(frequency):
        width = float(found.half_width[i].min())
        gram, noise = np.zeros((3, 3), dtype=complex), np.zeros(3)
        for s, n in zip(spectra, power, strict=True):
            force = s.force[slice(*np.searchsorted(s.frequency, [f0 - width, f0 + width])), :, 0].T
            gram += force @ force.conj().T
            noise += force.shape[1] * n
        loss[i] = (found.compliance[i] * noise) @ np.linalg.pinv(gram)
    share = np.linalg.norm(loss, axis=2) / np.linalg.norm(found.compliance, axis=2)
    warnings = found.warnings
    if np.nanmax(share) > 0.01:
        at = frequency[int(np.nanargmax(np.nanmax(share, axis=1)))]
        warnings += (
            f"noise on the forces lowers the compliance by up to {100 * np.nanmax(share):.2g} % (at {at:g} Hz); limits "
            "from it are too high by as much; it is in the standard deviation: use a quieter sensor or a deeper cut",
        )
    covariance = found.covariance + loss[..., :, None] * loss[..., None, :].conj()
    return replace(found, covariance=covariance, warnings=warnings)


# --- the other estimators ---------------------------------------------------------------------------------------------


def _segments(
    estimator: Segments,
    passes: Sequence[SweepPass],
    frequency: Real,
    response: Sequence[str],
    progress: Step | None,
) -> _Estimate:
    """Solve with all segments as columns, weighted with the inverse noise of their pass."""
    columns = list(estimator.columns(passes, frequency, response))
    noise = _noise(columns)
    solutions = []
    for i, c in enumerate(columns):
        solutions.append(solve(c, 3, noise[i]))
        if progress is not None:
            progress(i + 1, len(columns))
    if columns and columns[0].response.shape[1] <= columns[0].regressors.shape[0]:
        raise InputError(
            f"the passes give {columns[0].response.shape[1]} segments for {columns[0].regressors.shape[0]} unknowns; "
            f"record longer passes or choose a coarser resolution than {estimator.resolution:g} Hz"
        )
    return _stack(solutions, HANN_ERROR_LINES)


def _single(
    estimator: SingleReference, passes: Sequence[SweepPass], frequency: Real, response: Sequence[str]
) -> _Estimate:
    sxf, sff = estimator.cross_spectra(passes, (float(frequency[0]), float(frequency[-1])), response)
    gains, conditions = [], []
    for x, f in zip(sxf, sff, strict=True):
        conditions.append(condition_number(f))
        singular = not np.isfinite(conditions[-1])
        gains.append(np.full((*x.shape[:1], 3), np.nan) if singular else np.linalg.lstsq(f.T, x.T, rcond=None)[0].T)
    shape = np.array(gains).shape
    unknown = np.full((*shape, 3), np.nan, dtype=complex)
    return _Estimate(
        np.array(gains, dtype=complex), unknown, np.full(shape[:2], np.nan), np.array(conditions), HANN_ERROR_LINES
    )


def _noise(columns: Sequence[Columns], rounds: int = 4) -> Real:
    """Learn the noise power of each response in each pass, shape (f, r, tests).

    The first round weights all passes alike, so that a noisy one leaves its mark on the residual of the quiet ones;
    solving again with what was learnt takes it away.
    """
    noise: Real | None = None
    for _ in range(rounds):
        residual = [solve(c, 3, None if noise is None else noise[i]).residual for i, c in enumerate(columns)]
        noise = _smooth_noise(np.array(residual))
    assert noise is not None
    return noise


def _smooth_noise(residual: Real, reach: int = 8) -> Real:
    """Take the median residual power over neighbouring frequencies; keep weights within 1:1000."""
    filled = pd.DataFrame(residual.reshape(residual.shape[0], -1))
    smooth = filled.rolling(2 * reach + 1, center=True, min_periods=1).median().bfill().ffill().to_numpy()
    noise = smooth.reshape(residual.shape)
    largest = np.max(np.nan_to_num(noise), axis=2, keepdims=True)
    floor = np.where(largest > 0.0, 1e-6 * largest, 1.0)
    return np.where(np.isfinite(noise), np.maximum(noise, floor), 1.0)


# --- tables and words -------------------------------------------------------------------------------------------------


def _pass_table(passes: Sequence[SweepPass]) -> pd.DataFrame:
    rows = []
    for p in passes:
        force = p.record["force"].sel(axis=["x", "y", "z"]).values
        rms = np.sqrt(np.mean(force**2, axis=1))
        rows.append(
            {
                "pass": p.label,
                "duration_s": p.record.sizes["time"] * sample_interval(p.record),
                "force_x_rms_N": rms[0],
                "force_y_rms_N": rms[1],
                "force_z_rms_N": rms[2],
                "from_rest_to_rest": at_rest(p.record),
            }
        )
    return pd.DataFrame(rows)


def bands(frequency: Real, mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """Return the contiguous bands [Hz] where a mask over frequency holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [(float(frequency[a]), float(frequency[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _in_words(frequency: Real, mask: NDArray[np.bool_]) -> str:
    return ", ".join(f"{a:g}-{b:g} Hz" if b > a else f"{a:g} Hz" for a, b in bands(frequency, mask))


def _condition_warnings(frequency: Real, condition: Real) -> tuple[str, ...]:
    out = []
    refused = ~(condition <= REFUSE_CONDITION)
    for mask, text in (
        (refused, f"not solved: condition number of the forces above {REFUSE_CONDITION:g}"),
        (~refused & (condition > WARN_CONDITION), f"badly conditioned (above {WARN_CONDITION:g})"),
    ):
        if mask.any():
            out.append(f"{text} in {_in_words(frequency, mask)}")
    return tuple(out)
