"""Inertial actuator, stepped sine: records with constant-frequency steps -> compliance with its uncertainty.

The steps are found on the force itself (`sine_fit`). In each, after the response has settled, a four-parameter sine
fit of the force gives the frequency, and three-parameter fits of all responses at *that* frequency give ``Phi = X/F``.
The coefficient of determination of the fits is the coherence indicator: ``R^2 = 1 - SS_res/SS = snr/(1 + snr)``. It
also falls with distortion, which is therefore reported apart (THD, and each harmonic). Sine fits: IEEE Std 1057. A
force that repeats itself (multisine, chirp): `smfe.identification.actuator.periodic`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
import xarray as xr
from scipy import stats

from process.errors import InputError
from process.labels import AXES, make_compliance, sample_interval
from process.types import Real
from smfe.identification.actuator.sine_fit import (
    SineFit,
    StepRules,
    find_steps,
    fit_sine,
    neighbour_lines,
    refine_frequency,
)
from smfe.identification.errors.attached_mass import without_mass
from smfe.identification.errors.result import Identification
from smfe.identification.spectra.spectra import (
    as_displacement,
    check_records,
    force_samples,
    motion_axes,
    record_source,
)

SETTLING: tuple[float, ...] = (0.5, 0.75, 0.875)
"""Shares of a step that are dropped, in turn, until the two halves of the rest agree."""


@dataclass(frozen=True)
class Step:
    """One step of constant frequency.

    Parameters
    ----------
    excitation, source, number
        Axis, file, number of the step in the record (from 1).
    time, dwell, fitted : float
        Start of the step, its length, and the length of the fitted part [s].
    force : SineFit
        Fit of the force [N].
    responses : mapping of str to SineFit
        Axis -> fit of the motion channel.
    compliance, std : mapping of str to complex, float
        Axis -> compliance and root mean square of its complex error [m/N].
    degrees_of_freedom : float
        Degrees of freedom of each part of that error.
    drift : float
        Largest relative difference of the compliances of the two halves of the fitted part [1], of those responses
        where it exceeds three standard deviations.
    settled : bool
        Whether that difference is small.
    reason : str
        Why it is not used; empty when it is.
    """

    excitation: str
    source: str
    number: int
    time: float
    dwell: float
    fitted: float
    force: SineFit
    responses: Mapping[str, SineFit]
    compliance: Mapping[str, complex]
    std: Mapping[str, float]
    drift: float
    settled: bool
    reason: str = ""
    degrees_of_freedom: float = float("nan")


def identify_actuator(
    name: str,
    records: Mapping[str, Sequence[xr.Dataset]],
    *,
    frequency_range: tuple[float, float] | None = None,
    rules: StepRules | None = None,
    frame_mass: float = 0.0,
    accelerometer_mass: float = 0.0,
) -> Identification:
    """Identify compliances from stepped sines.

    Per step and response ``Phi = X/F`` with the complex amplitudes of sines of one and the same frequency, and ``var
    Phi = mean_k |dX_k - Phi dF_k|^2 / |F|^2`` over the lines k next to it (`sine_fit.neighbour_lines`), which see the
    same noise and none of the harmonics. Where the two halves of the fitted part differ by more than three standard
    deviations, their difference is added in quadrature. Repeats of a frequency are averaged; where they scatter more
    than their noise allows, their scatter is the error.

    Parameters
    ----------
    name : str
        Name of the measurement.
    records : mapping of str to sequence of xarray.Dataset
        Excitation axis -> records of stepped sines.
    frequency_range : (float, float), optional
        Keep only these frequencies [Hz].
    rules : StepRules, optional
        How steps are found and judged.
    frame_mass : float, optional
        Mass [kg] between force sensor and tool that moves with the tool: the force on the tool is ``F - m a``.
    accelerometer_mass : float, optional
        Mass [kg] at the driving point that is there only to measure; taken off the compliance.

    Returns
    -------
    Identification
        Compliance [m/N] at the frequencies of the steps, NaN where an excitation has no step at a frequency that
        another one has; ``compliance_std``, ``compliance_relation`` and ``degrees_of_freedom`` (for
        `intervals.interval`); ``coherence(frequency, response, excitation)``, the smaller R^2 of force
        and response; table "steps".

    Raises
    ------
    InputError
        When there are no records, force or motion is missing, or the force never stays at one frequency.
    """
    rules = rules or StepRules()
    check_records(name, records)
    steps: list[Step] = []
    notes: list[str] = []
    for axis in AXES:
        for index, record in enumerate(records.get(axis, ())):
            found = fit_steps(record, axis, index, rules)
            notes += _cover_note(record, axis, found)
            steps += found
    notes += [*_notes(steps), *_force_notes(steps, rules)]
    compliance, said = without_mass(_assemble(name, steps, frequency_range, rules), frame_mass + accelerometer_mass)
    return Identification(name, "actuator", compliance, {"steps": step_table(steps)}, (*notes, *said))


# --- steps -> compliance -------------------------------------------------------------------------------------------


def fit_steps(record: xr.Dataset, excitation: str, index: int = 0, rules: StepRules | None = None) -> list[Step]:
    """Find and fit the steps of a record.

    Parameters
    ----------
    record : xarray.Dataset
        A record with ``force`` along `excitation` and a motion channel.
    excitation : str
        Axis of the actuator.
    index : int, optional
        Position of the record among those of its axis.
    rules : StepRules, optional
        How steps are found and judged.

    Raises
    ------
    InputError
        When the force never stays at one frequency.
    """
    rules = rules or StepRules()
    source = record_source(record, index)
    force = force_samples(record, excitation, source)
    dt = sample_interval(record)
    time = record["time"].values
    channel, axes = motion_axes(record)
    motion = {axis: record[channel].sel(axis=axis).values for axis in axes}
    steps = []
    for number, (start, stop, frequency) in enumerate(find_steps(force, dt), start=1):
        # The ends are known to about a cycle, over which the force was averaged; the whole step gives its frequency.
        cycle = round(1.0 / (frequency * dt))
        inner = force[start + cycle : stop - cycle]
        if inner.size > 4 * cycle:
            frequency = refine_frequency(inner, dt, frequency)
        place = excitation, source, number, float(time[start]), (stop - start) * dt
        for share in SETTLING if rules.settling is None else (0.0,):
            part = _settled_part(start, stop - cycle, share, frequency, dt, rules)
            if share > SETTLING[0] and (part.stop - part.start) * dt * frequency < 2.0 * rules.minimum_cycles:
                break
            step = _step(_fit_part(force, motion, channel, part, frequency, dt), rules, *place)
            if step.settled:
                break
        steps.append(step)
    if not any(not step.reason for step in steps):
        raise _no_steps(force, source, excitation)
    return steps


def _no_steps(force: Real, source: str, excitation: str) -> InputError:
    departure = np.abs(force - np.median(force))
    if float(np.mean(departure > 0.2 * departure.max())) < 0.1:
        looks = "it looks like hammer hits: declare method = 'hammer'"
    else:
        looks = "a continuous sweep is not a stepped sine"
    return InputError(
        f"{source}: force_{excitation} never stays a sine of one frequency long enough for a fit; {looks}, or hold "
        "each frequency longer"
    )


def _settled_part(start: int, stop: int, share: float, frequency: float, dt: float, rules: StepRules) -> slice:
    """Return the whole cycles at the end of a step that are left after settling: a share of the step, or a time."""
    drop = round(share * (stop - start)) if rules.settling is None else round(rules.settling / dt)
    cycles = max(int((stop - start - drop) * frequency * dt), 0)
    return slice(stop - round(cycles / (frequency * dt)), stop)


@dataclass(frozen=True)
class _PartFits:
    """Fits of one part of a step: everything, and the compliances of both halves."""

    force: SineFit
    responses: dict[str, SineFit]
    compliance: dict[str, complex]
    std: dict[str, float]
    halves: tuple[dict[str, complex], dict[str, complex]]
    half_std: dict[str, float]
    degrees_of_freedom: float
    length: float


def _fit_part(
    force: Real,
    motion: Mapping[str, Real],
    channel: str,
    part: slice,
    frequency: float,
    dt: float,
) -> _PartFits:
    length = part.stop - part.start
    middle = part.start + length // 2
    whole, early, late = (
        _fit_channels(force, motion, channel, s, frequency, dt)
        for s in (part, slice(part.start, middle), slice(middle, part.stop))
    )
    half_std = {axis: float(np.hypot(early[3][axis], late[3][axis])) for axis in motion}
    return _PartFits(*whole[:4], (early[2], late[2]), half_std, whole[4], length * dt)


def _fit_channels(
    force: Real,
    motion: Mapping[str, Real],
    channel: str,
    part: slice,
    frequency: float,
    dt: float,
) -> tuple[SineFit, dict[str, SineFit], dict[str, complex], dict[str, float], float]:
    """Fit force and responses; return both, compliances, their standard deviations and degrees of freedom."""
    force_fit = fit_sine(force[part], dt, frequency, fitted_frequency=True)
    fits = {axis: fit_sine(samples[part], dt, frequency) for axis, samples in motion.items()}
    size = abs(force_fit.amplitude)
    channels = [(force[part], force_fit), *((motion[axis][part], fit) for axis, fit in fits.items())]
    noise = neighbour_lines(np.stack([samples - fit.values(dt) for samples, fit in channels]), dt, frequency)
    to_displacement = complex(as_displacement(np.ones((1, 1), complex), np.array([frequency]), channel)[0, 0])
    compliance, std = {}, {}
    for row, (axis, fit) in enumerate(fits.items(), start=1):
        gain = to_displacement * fit.amplitude / force_fit.amplitude if size > 0.0 else complex("nan")
        error = to_displacement * noise[row] - gain * noise[0]
        known = size > 0.0 and error.size
        compliance[axis] = gain
        std[axis] = float(np.sqrt(np.mean(np.abs(error) ** 2))) / size if known else float("nan")
    return force_fit, fits, compliance, std, 2.0 * noise.shape[1]


def _step(
    fits: _PartFits, rules: StepRules, excitation: str, source: str, number: int, time: float, dwell: float
) -> Step:
    drift, settled, std = 0.0, True, dict(fits.std)
    for axis, value in fits.compliance.items():
        difference = abs(fits.halves[1][axis] - fits.halves[0][axis])
        if difference > 3.0 * fits.half_std[axis]:
            # What has not settled is about as wrong as its halves differ, and the residual does not know it.
            std[axis] = float(np.hypot(std[axis], difference))
            drift = max(drift, difference / abs(value))
            settled = settled and difference <= rules.stationary * abs(value)
    reason = ""
    if round(fits.length * fits.force.frequency) < rules.minimum_cycles:
        reason = f"only {fits.length * fits.force.frequency:.1f} cycles are left after settling"
    elif not fits.force.r_squared >= rules.force_r_squared:
        reason = f"the force is no sine: R^2 = {fits.force.r_squared:.3f}"
    return Step(
        excitation=excitation,
        source=source,
        number=number,
        time=time,
        dwell=dwell,
        fitted=fits.length,
        force=fits.force,
        responses=fits.responses,
        compliance=fits.compliance,
        std=std,
        drift=drift,
        settled=settled,
        reason=reason,
        degrees_of_freedom=fits.degrees_of_freedom,
    )


def step_table(steps: Sequence[Step]) -> pd.DataFrame:
    """Return one row a step; R^2 and THD of an axis that was not recorded are NaN."""
    table: dict[str, list[object]] = {
        "excitation": [s.excitation for s in steps],
        "file": [s.source for s in steps],
        "step": [s.number for s in steps],
        "time_s": [s.time for s in steps],
        "dwell_s": [s.dwell for s in steps],
        "fitted_s": [s.fitted for s in steps],
        "frequency_Hz": [s.force.frequency for s in steps],
        "force_N": [abs(s.force.amplitude) for s in steps],
        "r_squared_force": [s.force.r_squared for s in steps],
        "thd_force": [s.force.thd for s in steps],
        **{f"harmonic_{h}_force": [s.force.harmonics[h - 2] for s in steps] for h in (2, 3)},
    }
    for axis in AXES:
        if any(axis in s.responses for s in steps):
            fits = [s.responses.get(axis) for s in steps]
            table[f"r_squared_{axis}"] = [fit.r_squared if fit else np.nan for fit in fits]
            table[f"thd_{axis}"] = [fit.thd if fit else np.nan for fit in fits]
            for h in (2, 3):
                table[f"harmonic_{h}_{axis}"] = [fit.harmonics[h - 2] if fit else np.nan for fit in fits]
    table["drift_percent"] = [100.0 * s.drift for s in steps]
    table["settled"] = [s.settled for s in steps]
    table["used"] = [not s.reason for s in steps]
    table["reason"] = [s.reason for s in steps]
    return pd.DataFrame(table)


def _assemble(name: str, steps: Sequence[Step], wanted: tuple[float, float] | None, rules: StepRules) -> xr.Dataset:
    """Put the steps on the union of their frequencies."""
    used = sorted((s for s in steps if not s.reason), key=lambda s: s.force.frequency)
    if wanted is not None:
        low, high = wanted[0] * (1.0 - rules.frequency_tolerance), wanted[1] * (1.0 + rules.frequency_tolerance)
        used = [s for s in used if low <= s.force.frequency <= high]
    if not used:
        where = f"none lies between {wanted[0]:.4g} and {wanted[1]:.4g} Hz" if wanted else "none can be used"
        raise InputError(f"measurement '{name}' has {len(steps)} steps, but {where}; see why in the table of steps")
    f = np.array([s.force.frequency for s in used])
    line = np.concatenate([[0], np.cumsum(np.diff(f) > rules.frequency_tolerance * f[1:])]).astype(int)
    frequency = np.bincount(line, f) / np.bincount(line)
    responses = [axis for axis in AXES if any(axis in s.responses for s in used)]
    excitations = [axis for axis in AXES if any(s.excitation == axis for s in used)]
    shape = (frequency.size, len(responses), len(excitations))
    values, relation = np.full(shape, np.nan, complex), np.full(shape, np.nan, complex)
    std, coherence, degrees_of_freedom = np.full(shape, np.nan), np.full(shape, np.nan), np.full(shape, np.nan)
    for i in range(frequency.size):
        here = [s for s, number in zip(used, line, strict=True) if number == i]
        for k, excitation in enumerate(excitations):
            for j, response in enumerate(responses):
                repeats = [s for s in here if s.excitation == excitation and response in s.responses]
                if repeats:
                    at = i, j, k
                    values[at], std[at], relation[at], degrees_of_freedom[at], coherence[at] = _merge(repeats, response)
    dims = ("frequency", "response", "excitation")
    extra = {
        "compliance_std": (dims, std),
        "compliance_relation": (dims, relation),
        "degrees_of_freedom": (dims, degrees_of_freedom),
        "coherence": (dims, coherence),
    }
    return make_compliance(frequency, values, responses, excitations, extra)


def _merge(repeats: Sequence[Step], response: str) -> tuple[complex, float, complex, float, float]:
    """Return the weighted mean of repeats; standard deviation, relation, degrees of freedom of its error; mean R^2.

    Weights are inverse variances where these differ clearly.
    The error is what the noise within the repeats makes of it, unless they scatter by more than noise allows (F test,
    5 %): then it is their scatter.
    """
    value = np.array([s.compliance[response] for s in repeats])
    std = np.array([s.std[response] for s in repeats])
    r2 = float(np.mean([min(s.force.r_squared, s.responses[response].r_squared) for s in repeats]))
    n = value.size
    # Weights that are known from few lines cost more than they gain where the repeats are about equally noisy.
    weight = 1.0 / std**2 if np.all(std > 0.0) and std.max() > 2.0 * std.min() else np.ones(n)
    weight = weight / weight.sum()
    mean, noise = complex(weight @ value), float(weight**2 @ std**2)
    degrees_of_freedom = float(np.sum([s.degrees_of_freedom for s in repeats]))
    if n > 1:
        around = np.sum(weight * np.abs(value - mean) ** 2) / (n - 1)
        if around > noise * float(stats.f.ppf(0.95, 2 * (n - 1), degrees_of_freedom)):
            # What scatters so has nothing to do with the noise within: all repeats count alike.
            mean = complex(value.mean())
            d = (value - mean) / np.sqrt(n * (n - 1.0))
            return mean, float(np.linalg.norm(d)), complex(np.sum(d**2)), n - 1.0, r2
    return mean, float(np.sqrt(noise)), 0j, degrees_of_freedom, r2


def _cover_note(record: xr.Dataset, excitation: str, steps: Sequence[Step]) -> Iterable[str]:
    """Say how much of the excitation is in no step: gaps between steps are silent, a missed step is not."""
    force = force_samples(record, excitation)
    energy = float(np.sum((force - force.mean()) ** 2)) * sample_interval(record)
    covered = sum(step.dwell * 0.5 * abs(step.force.amplitude) ** 2 / step.force.r_squared for step in steps)
    if covered < 0.9 * energy:
        yield (
            f"excitation {excitation}: {steps[0].source}: {100.0 * (1.0 - covered / energy):.2g} % of the energy of "
            "the force is in no step of constant frequency (steps too short, or swept parts)"
        )


def _notes(steps: Sequence[Step]) -> Iterable[str]:
    """Yield what the engineer has to know."""
    for step in steps:
        if step.reason:
            yield (
                f"excitation {step.excitation}: {step.source}, step {step.number} at {step.force.frequency:.4g} Hz "
                f"is not used: {step.reason}"
            )
    used = [s for s in steps if not s.reason]
    moving = [s for s in used if not s.settled]
    if moving:
        worst = max(moving, key=lambda s: s.drift)
        yield (
            f"{len(moving)} of {len(used)} steps have not settled; the worst, {worst.excitation} at "
            f"{worst.force.frequency:.4g} Hz, changes by {100.0 * worst.drift:.2g} % within the fitted part (dwell "
            "longer)"
        )
    distorted = [s for s in used if s.force.thd > 0.1]
    if distorted:
        worst = max(distorted, key=lambda s: s.force.thd)
        yield (
            f"{len(distorted)} of {len(used)} steps have a force distortion above 10 %, the worst "
            f"{100.0 * worst.force.thd:.2g} % ({worst.excitation} at {worst.force.frequency:.4g} Hz); R^2 falls "
            "without noise there"
        )


def _force_notes(steps: Sequence[Step], rules: StepRules) -> Iterable[str]:
    """Say where the force is not constant: within a record, or between the repeats of a frequency."""
    used = [s for s in steps if not s.reason]
    for excitation, source in dict.fromkeys((s.excitation, s.source) for s in used):
        here = [s for s in used if (s.excitation, s.source) == (excitation, source)]
        weak, strong = (pick(here, key=lambda s: abs(s.force.amplitude)) for pick in (min, max))
        if abs(strong.force.amplitude) > rules.flat * abs(weak.force.amplitude):
            yield (
                f"excitation {excitation}: {source}: the force is not constant: {abs(weak.force.amplitude):.3g} N at "
                f"{weak.force.frequency:.4g} Hz, {abs(strong.force.amplitude):.3g} N at {strong.force.frequency:.4g} "
                "Hz; where the level changes the compliance, one curve mixes several levels"
            )
