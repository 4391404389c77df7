"""Spectral chatter criterion: a peak that is no harmonic and exceeds half of the highest tooth harmonic.

This is the rule of the paper, :eq:`chatter`. Added here, with the reason:

- *Harmonic* means every spindle order: run-out alone puts lines of 0.3 of the tooth line on orders 1, 2, ... An order
  that is higher than the tooth harmonics takes their place in the ratio.
- The record is judged over turns of the spindle, not over time (`spindle_speed`): 0.3 % of speed error over 4 s, or a
  spindle that slows by it, makes a stable cut look like chatter.
- Each axis is judged by itself: a small axis that chatters does not drown in a larger one. An axis counts as silent
  below a tenth of the highest harmonic of all.
- Order Z/2 of an even number of teeth Z (and its odd multiples) is where period doubling
  appears, and also an order. It is judged separately: against a reference cut, or by its growth against the tooth
  line; else it is *undecided*.
- An order is masked by +-3 bins (the Hann main lobe is +-2) plus what the speed may be wrong, growing with
  the order.
- A line that drifts within the record is read in windows of 12 and 24 turns, in which it does not.
- A steady line with sidebands one spindle order apart is chatter below the threshold too (`chatter.sidebands`).
- A line that comes and goes like filtered noise, without such sidebands, may be a mode that noise
  excites: *undecided*.
- What is there in air with half of its height is no chatter: hum, pumps, fans.
- The last part of the cut is used, without entry and exit: transients of the entry trigger the criterion 3 to 10 %
  below the limit.
- The highest tooth harmonic is not let below an absolute floor: a slot with 4 equal teeth has no tooth line
  in x at all.
- A record in which nothing reaches that floor says nothing about the cut: a dead sensor, a wrong unit or air look
  the same. It is *undecided*.
- What stands inside a mask is not declared stable: it is *undecided*, and the record length that would
  separate it is said.
- The quantity is not stated in the paper and matters, because the ratio changes by ``(f_c/f_T)^2`` between
  displacement and acceleration. The default is the acceleration as recorded; the result says which.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr

from process.errors import InputError
from process.labels import UNITS, axis_present, check_record
from process.notebook import html_table
from stability.chatter.amplitudes import SpectralAmplitudes, spectral_amplitudes
from stability.chatter.comb import other_speed, other_teeth, spectrogram
from stability.chatter.cut_interval import (
    CutPart,
    axis_part,
    judged_part,
    measured_turns,
    over_turns,
    spindle_frequency,
    stated_frequency,
    stretches,
    with_angle,
)
from stability.chatter.line_spectrum import LineSpectrum, comb_speed, hann_spectrum
from stability.chatter.rules import RULES
from stability.chatter.spindle_speed import followed_turns, spindle_from_lines
from stability.chatter.verdict_rules import Finding, Verdict, judge, too_few_turns

QUANTITIES: tuple[str, ...] = ("acceleration", "displacement", "force", "sound")

DEFAULT_FLOOR: dict[str, float] = {"acceleration": 0.1, "displacement": 1e-6, "force": 5.0, "sound": 1e-6}
"""Least amplitude that counts as the highest tooth harmonic [m/s2, m, N, Pa]."""

FREQUENCY_RANGE: tuple[float, float | None] = (5.0, None)
"""Default band [Hz]; the lower end keeps servo and table motion out."""

HIGHEST_SHARE_OF_SAMPLE_RATE = 0.4
"""Default upper end of the band, in sample rates: above it anti-alias filters act."""


@dataclass(frozen=True)
class AxisVerdict:
    """Result of the criterion for one axis: verdict, ratio [1], frequency of the line [Hz] and the reason."""

    axis: str
    verdict: Verdict
    ratio: float
    frequency_Hz: float
    reason: str


@dataclass(frozen=True)
class ChatterVerdict:
    """Result of the criterion for one record.

    Parameters
    ----------
    verdict : {"stable", "chatter", "undecided"}
        The verdict.
    ratio : float
        Amplitude of the largest non-harmonic peak over that of the highest tooth harmonic (or of the floor)
        [1]; for period doubling, of order Z/2.
    chatter_frequency_Hz : float
        Frequency of that peak; NaN when the cut is stable.
    tooth_passing_harmonic_Hz : float
        Frequency of the highest tooth passing harmonic; NaN when none could be read.
    spindle_speed_rpm : float
        Spindle speed as refined from the record.
    reason : str
        The verdict in one sentence, with its numbers.
    spectrum : xarray.Dataset
        ``amplitude(axis, frequency)``, ``vector_amplitude(frequency)``, ``harmonic(frequency)`` (true where
        masked).
    quantity : str
        What has been judged, e.g. "acceleration" or "displacement from acceleration".
    axes : tuple of str
        Axes that were judged; ("sound",) for a microphone.
    threshold, guard_band : float
        The threshold, and the distance from it within which noise leaves the verdict open [1].
    resolution_Hz : float
        One over the length of the part that has been judged.
    interval_s : (float, float)
        That part of the record.
    half_order_ratio : float
        Highest odd multiple of order Z/2 over the highest tooth harmonic; NaN for an odd number of teeth.
    frequency_range_Hz : (float, float)
        Band that has been judged.
    floor, unit : float, str
        Least amplitude that counts as tooth harmonic, and the unit of the amplitudes.
    by_axis : tuple of AxisVerdict
        Result of each axis; the verdict is that of the axis with chatter, else the one that is undecided.
    family_Hz : tuple of float
        Lines a whole number of spindle orders beside the chatter line or its mirror image.
    drift_Hz : (float, float) or None
        From where to where the chatter line moves, where it does.
    growth : float
        How much the line has grown from the first to the last quarter of what was judged; NaN without one.
    cut_s : (float, float, float, float)
        When the cut begins, is entered, is left and ends.
    try_rpm : tuple of float
        Speeds ``60 f_c/(k Z)`` from half to twice the present one, at which the tooth passing meets the chatter line;
        none where the cut does not chatter.
    notes : tuple of str
        What else was noticed: another number of teeth that fits better, another speed, silent axes.
    spectrogram : xarray.Dataset
        ``amplitude(axis, time, frequency)`` of the whole record, in at most 160 by 300 points.
    """

    verdict: Verdict
    ratio: float
    chatter_frequency_Hz: float
    tooth_passing_harmonic_Hz: float
    spindle_speed_rpm: float
    reason: str
    spectrum: xr.Dataset = field(repr=False)
    quantity: str
    axes: tuple[str, ...]
    threshold: float
    guard_band: float
    resolution_Hz: float
    interval_s: tuple[float, float]
    half_order_ratio: float
    frequency_range_Hz: tuple[float, float]
    floor: float
    unit: str
    by_axis: tuple[AxisVerdict, ...] = ()
    family_Hz: tuple[float, ...] = ()
    drift_Hz: tuple[float, float] | None = None
    growth: float = math.nan
    cut_s: tuple[float, float, float, float] = (math.nan, math.nan, math.nan, math.nan)
    try_rpm: tuple[float, ...] = ()
    notes: tuple[str, ...] = ()
    spectrogram: xr.Dataset | None = field(default=None, repr=False)

    def _repr_html_(self) -> str:
        """Return a table for a notebook."""
        rows: list[tuple[object, ...]] = [
            ("spindle speed", f"{self.spindle_speed_rpm:.5g}", "rpm"),
            ("ratio of the largest line to the tooth passing line", f"{self.ratio:.3g}", "1"),
            ("judged on", ", ".join(dict.fromkeys([self.quantity, *self.axes])), ""),
            ("judged from", f"{self.interval_s[0]:.3g} to {self.interval_s[1]:.3g}", "s"),
        ]
        if math.isfinite(self.chatter_frequency_Hz):
            rows.insert(0, ("chatter frequency", f"{self.chatter_frequency_Hz:.4g}", "Hz"))
        if self.try_rpm:
            rows.append(("speeds to try", ", ".join(f"{s:.0f}" for s in self.try_rpm), "rpm"))
        return html_table(f"Verdict: {self.verdict}", rows, notes=(self.reason, *self.notes))


def chatter_verdict(
    record: xr.Dataset,
    rotation: float | None,
    teeth: int,
    *,
    quantity: str | None = None,
    axes: Sequence[str] | None = None,
    threshold: float = 0.5,
    frequency_range: tuple[float, float | None] = FREQUENCY_RANGE,
    speed_tolerance: float = 0.005,
    floor: float | None = None,
    interval: tuple[float, float] | None = None,
    half_order_reference: float | None = None,
) -> ChatterVerdict:
    """Return whether a record holds chatter: a non-harmonic peak above half of the highest tooth harmonic.

    Parameters
    ----------
    record : xarray.Dataset
        Record of one cut at constant speed, air before and after it allowed.
    rotation : float or None
        Nominal spindle rotation [rad/s]; a record with a ``spindle_angle`` or a ``spindle_speed`` must agree. None:
        what the record states, else what the spacing of its lines gives away.
    teeth : int
        Number of teeth.
    quantity : {"acceleration", "displacement", "force", "sound"}, optional
        What is judged; default the first of these that has been recorded. A displacement that has not been
        recorded is had from the acceleration, ``-a/w^2``.
    axes : sequence of str, optional
        Axes to combine; default all that have been recorded.
    threshold : float, optional
        Limit of the ratio [1].
    frequency_range : (float, float or None), optional
        Band [Hz]; the lower end keeps servo and table motion out, the upper end defaults to 0.4 sample rates.
    speed_tolerance : float, optional
        Relative error of the speed, given or recorded, to search [1]; 0 takes the speed as exact. Not used where the
        record has a ``spindle_angle``.
    floor : float, optional
        Least amplitude that counts as tooth harmonic, in the unit of the quantity; default `DEFAULT_FLOOR`.
    interval : (float, float), optional
        Part of the record to judge [s]; default the last half of the cut that is found in it.
    half_order_reference : float, optional
        ``half_order_ratio`` of a stable reference cut with the same tool: what run-out puts there.

    Returns
    -------
    ChatterVerdict
        The verdict with its reason.

    Raises
    ------
    InputError
        For an unusable record, a speed, tooth count or band that makes no sense, or a speed that is neither given
        nor to be read off the record.
    """
    _check_numbers(rotation, teeth, threshold, speed_tolerance)
    check_record(record)
    chosen, recorded = _choose_quantity(record, quantity)
    names = _choose_axes(record, recorded, axes)
    record, notes = with_angle(record)
    if rotation is None:
        rotation = _rotation(record, recorded, names, teeth, interval, frequency_range)
    least = DEFAULT_FLOOR[chosen] if floor is None else floor

    def judged(stretch: tuple[float, float] | None) -> tuple[ChatterVerdict, SpectralAmplitudes]:
        return _judged(
            record,
            rotation,
            teeth,
            chosen,
            recorded,
            names,
            threshold,
            frequency_range,
            speed_tolerance,
            least,
            stretch,
            half_order_reference,
        )

    found, whole = judged(interval)
    # What has no spindle order as a whole has none in its parts.
    if interval is None and (found.verdict == "stable" or (found.verdict == "undecided" and whole.spindle_seen)):
        for stretch in stretches(found.cut_s, found.interval_s, 2.0 * math.pi / rotation):
            try:
                here, there = judged(stretch)
            except InputError:
                continue  # the speed changes there, or the stretch is too short for the band
            if here.verdict == "chatter" and there.plain and here.chatter_frequency_Hz == there.candidate[0]:
                said = f"from {here.interval_s[0]:.3g} to {here.interval_s[1]:.3g} s alone: {here.reason}"
                found = replace(here, reason=said, cut_s=found.cut_s)
                break
    # What there is to see: some tooth passing harmonics, and the lines that decided, with room above.
    low, high = found.frequency_range_Hz
    base = found.spindle_speed_rpm / 60.0
    lines = [f for f in (found.chatter_frequency_Hz, found.tooth_passing_harmonic_Hz) if math.isfinite(f)]
    top = min(high, max(8.0 * teeth * base, 2.0 * max(lines, default=0.0)))
    picture = spectrogram(record, recorded, names, (low, top), base)
    return replace(found, notes=(*notes, *found.notes), spectrogram=picture)


def _judged(
    record: xr.Dataset,
    rotation: float,
    teeth: int,
    chosen: str,
    recorded: str,
    names: list[str],
    threshold: float,
    frequency_range: tuple[float, float | None],
    speed_tolerance: float,
    least: float,
    interval: tuple[float, float] | None,
    half_order_reference: float | None,
) -> tuple[ChatterVerdict, SpectralAmplitudes]:
    """Judge one interval of a record, or the last half of its cut, and return the amplitudes of the deciding axis."""
    part = judged_part(record, recorded, names, 2.0 * math.pi / rotation, interval)
    base, exact = spindle_frequency(record, part, rotation / (2.0 * math.pi), speed_tolerance)
    band = _band(frequency_range, part, teeth * base)
    integrate = chosen != recorded
    enough = part.duration * base >= RULES.fewest_turns
    if enough and speed_tolerance > 0.0:
        angle = measured_turns(record, part) if exact else None
        if angle is None:
            angle = followed_turns(part.samples, part.raw_dt, base, teeth, speed_tolerance, band)
        even = over_turns(part, angle, band[1])
        if exact:
            base = even.base
        else:
            # Less than a bin at the tooth harmonics is left: the comb of the whole record says where.
            left = 0.5 / (even.duration * teeth * even.base)
            base = comb_speed(hann_spectrum(even.samples, even.dt, band), even.base, teeth, left)
        part, exact = even, True
    part = replace(part, base=base)
    fitting, said = other_teeth(part, teeth) if enough else (teeth, "")
    settings = (base, fitting, band, exact, speed_tolerance, integrate, least, UNITS[chosen], threshold)
    found = [
        spectral_amplitudes(name, axis_part(part, i), *settings, half_order_reference) for i, name in enumerate(names)
    ]
    highest = max(max(e.tooth_amplitude, e.order_amplitude) for e in found)
    found = [replace(e, least=RULES.silent * highest) for e in found]
    findings = [too_few_turns(part, base) or judge(e) for e in found]
    worst = _deciding(found, findings)
    decisive, finding = found[worst], findings[worst]
    said_speed = other_speed(part, base, fitting, band, finding.frequency) if finding.verdict == "chatter" else ""
    chatters = finding.verdict == "chatter"
    verdict = ChatterVerdict(
        verdict=finding.verdict,
        ratio=finding.ratio,
        chatter_frequency_Hz=finding.frequency,
        tooth_passing_harmonic_Hz=decisive.tooth_line,
        spindle_speed_rpm=60.0 * decisive.base,
        reason=_in_words(finding, findings, decisive, names, "; ".join(filter(None, (said, said_speed)))),
        spectrum=_labelled_spectrum(found, UNITS[chosen]),
        quantity="displacement from acceleration" if integrate else chosen,
        axes=tuple(names),
        threshold=threshold,
        guard_band=decisive.guard,
        resolution_Hz=decisive.spectrum.resolution,
        interval_s=part.interval,
        half_order_ratio=decisive.half[1] / decisive.denominator if decisive.denominator > 0.0 else math.nan,
        frequency_range_Hz=band,
        floor=least,
        unit=UNITS[chosen],
        by_axis=tuple(
            AxisVerdict(e.axis, f.verdict, f.ratio, f.frequency, f.reason) for e, f in zip(found, findings, strict=True)
        ),
        family_Hz=decisive.highest_sidebands if chatters else (),
        drift_Hz=(decisive.short.low, decisive.short.high) if chatters and decisive.drifts else None,
        growth=decisive.envelope[1] if chatters else math.nan,
        cut_s=part.bounds,
        try_rpm=_speeds_to_try(finding, decisive, teeth) if chatters else (),
        notes=tuple(note for note in (said, said_speed) if note),
    )
    return verdict, decisive


def _deciding(found: Sequence[SpectralAmplitudes], findings: Sequence[Finding]) -> int:
    """Return the axis that decides: the worst chatter, else what is undecided on an axis that is not silent."""

    def rank(i: int) -> tuple[int, float]:
        e, f = found[i], findings[i]
        quiet = max(e.tooth_amplitude, e.order_amplitude, e.candidate[1]) < max(e.least, e.floor)
        order = {"chatter": 3, "undecided": 0 if quiet else 2, "stable": 1}[f.verdict]
        return order, 0.0 if math.isnan(f.ratio) else f.ratio

    return max(range(len(found)), key=rank)


def _in_words(
    finding: Finding, findings: Sequence[Finding], e: SpectralAmplitudes, names: Sequence[str], said: str
) -> str:
    """Return the reason with the axis, the drift, the sidebands and the growth of the line."""
    text = finding.reason
    if len(names) > 1:
        others = [f"{n} {f.verdict}" for n, f in zip(names, findings, strict=True) if n != e.axis]
        text = f"{e.axis}: {text} ({', '.join(others)})"
    if finding.verdict == "chatter":
        if e.drifts and e.short.high - e.short.low > 2.0 * e.spectrum.resolution:
            text += f"; it moves from {e.short.low:.4g} to {e.short.high:.4g} Hz"
        if e.highest_sidebands:
            lines = ", ".join(f"{line:.4g}" for line in e.highest_sidebands)
            text += f"; a whole number of spindle orders away lie {lines} Hz"
        if e.envelope[1] > RULES.growth:
            text += f"; it grows {e.envelope[1]:.2g} times within what is judged"
    return f"{said}; {text}" if said else text


def _speeds_to_try(finding: Finding, e: SpectralAmplitudes, teeth: int) -> tuple[float, ...]:
    """Return ``60 f_c/(k Z)`` from half to twice the present speed [rpm], fastest first."""
    present = 60.0 * e.base
    speeds = (60.0 * finding.frequency / (k * teeth) for k in range(1, 200))
    return tuple(s for s in speeds if 0.5 * present <= s <= 2.0 * present)


def _labelled_spectrum(found: Sequence[SpectralAmplitudes], unit: str) -> xr.Dataset:
    """Return the spectra of all axes for plotting."""
    first = found[0]
    phasor = np.concatenate([e.spectrum.phasor for e in found])
    whole = LineSpectrum(first.spectrum.frequency, phasor, first.spectrum.resolution)
    data = {
        "amplitude": (("axis", "frequency"), np.abs(phasor), {"units": unit}),
        "vector_amplitude": ("frequency", whole.vector_amplitude, {"units": unit}),
        "harmonic": ("frequency", first.masked, {"units": "1"}),
    }
    coords = {"axis": [e.axis for e in found], "frequency": ("frequency", whole.frequency, {"units": "Hz"})}
    return xr.Dataset(data, coords=coords, attrs={"resolution_Hz": whole.resolution, "window": "hann"})


# --- what is asked ---------------------------------------------------------------------------------------------------


def _check_numbers(rotation: float | None, teeth: int, threshold: float, speed_tolerance: float) -> None:
    if rotation is not None and not (math.isfinite(rotation) and rotation > 0.0):
        raise InputError(f"the spindle turns at {rotation:g} rad/s; a positive speed is needed")
    if teeth < 1:
        raise InputError(f"the tool has {teeth} teeth; at least one is needed")
    if not threshold > 0.0:
        raise InputError(f"the threshold is {threshold:g}; it must be positive (the paper's is 0.5)")
    if not 0.0 <= speed_tolerance < 0.1:
        raise InputError(f"the speed tolerance is {speed_tolerance:g}; a share between 0 and 0.1 is needed")


def _rotation(
    record: xr.Dataset,
    channel: str,
    axes: list[str],
    teeth: int,
    interval: tuple[float, float] | None,
    frequency_range: tuple[float, float | None],
) -> float:
    """Return the spindle rotation [rad/s] that a record states or that its lines give away."""
    part = judged_part(record, channel, axes, RULES.turn_unknown, interval)
    stated = stated_frequency(record, part)
    if stated is None:
        low, high = (s / 60.0 for s in RULES.speeds_searched)
        top = HIGHEST_SHARE_OF_SAMPLE_RATE / part.dt if frequency_range[1] is None else frequency_range[1]
        band = max(frequency_range[0], RULES.mask_bins / part.duration), min(top, 0.5 / part.dt)
        if band[0] < band[1]:
            stated = spindle_from_lines(hann_spectrum(part.samples, part.dt, band), teeth, (low, high))
    if stated is None:
        raise InputError(
            "no spindle speed is given, none is recorded, and the lines of the record do not give it away: "
            "give the speed"
        )
    return 2.0 * math.pi * stated


def _choose_quantity(record: xr.Dataset, quantity: str | None) -> tuple[str, str]:
    """Return the quantity that is judged and the channel it is had from."""
    recorded = [name for name in QUANTITIES if name in record and (name == "sound" or axis_present(record, name))]
    if quantity is None:
        if not recorded:
            raise InputError(f"the record holds none of {', '.join(QUANTITIES)}; there is nothing to judge")
        return recorded[0], recorded[0]
    if quantity not in QUANTITIES:
        raise InputError(f"quantity '{quantity}' is none of {', '.join(QUANTITIES)}")
    if quantity == "displacement" and quantity not in recorded and "acceleration" in recorded:
        return "displacement", "acceleration"
    if quantity not in recorded:
        raise InputError(f"the record has no {quantity}; it has {', '.join(recorded) or 'nothing to judge'}")
    return quantity, quantity


def _choose_axes(record: xr.Dataset, channel: str, axes: Sequence[str] | None) -> list[str]:
    if "axis" not in record[channel].dims:
        return [channel]
    present = axis_present(record, channel)
    chosen = present if axes is None else list(axes)
    missing = [a for a in chosen if a not in present]
    if missing or not chosen:
        raise InputError(f"{channel} has been recorded on {', '.join(present)}; axis {missing or 'none'} was asked for")
    return chosen


def _band(frequency_range: tuple[float, float | None], part: CutPart, tooth: float) -> tuple[float, float]:
    """Return the band [Hz]; below `RULES.mask_bins` bins the mean leaks."""
    low, high = frequency_range
    sample_rate = 1.0 / part.dt
    top = HIGHEST_SHARE_OF_SAMPLE_RATE * sample_rate if high is None else high
    if not 0.0 <= low < top <= 0.5 * sample_rate:
        raise InputError(
            f"a frequency range of {low:g} to {top:g} Hz at {sample_rate:g} samples a second; "
            "it must rise and end at most at half the sample rate"
        )
    if tooth * 1.01 > top:
        raise InputError(
            f"the tooth passing frequency of {tooth:g} Hz lies above the frequency range, which ends at {top:g} Hz: "
            "sample faster or raise the upper end"
        )
    return max(low, RULES.mask_bins / part.duration), top
