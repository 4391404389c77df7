"""The rules of the chatter criterion, applied in turn to the spectral amplitudes of one axis.

1. `_silence_rule`: nothing reaches the floor: undecided.
2. `_sideband_rule`: a steady line with two sidebands or more, from 0.4 of the threshold on: chatter.
3. `_half_rule`: a line above the threshold of one half of the highest harmonic: chatter (the rule of the paper).
4. `_period_doubling_rule`: order Z/2 that run-out does not explain: chatter, or undecided.
5. `_mask_rule`: what does not repeat with the spindle inside the mask of an order: chatter, or undecided.
6. `_foreign_order_rule`: a spindle order far above the teeth that is not one of theirs.
7. `_crowded_rule`: masks that hide too much of the spectrum: undecided.

Where none applies the cut is stable.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from stability.chatter.amplitudes import SpectralAmplitudes
from stability.chatter.cut_interval import CutPart
from stability.chatter.rules import RULES

Verdict = Literal["stable", "chatter", "undecided"]


@dataclass(frozen=True)
class Finding:
    """What one rule concludes."""

    verdict: Verdict
    ratio: float
    frequency: float
    reason: str


def too_few_turns(part: CutPart, base: float) -> Finding | None:
    """Return what to say of a part too short for any line; None where it is long enough."""
    turns = part.duration * base
    if turns >= RULES.fewest_turns:
        return None
    return Finding(
        "undecided",
        math.nan,
        math.nan,
        f"{part.duration:.3g} s of cut are {turns:.2g} turns, in which no line is apart from a spindle order; at "
        f"least {RULES.fewest_turns} turns ({RULES.fewest_turns / base:.3g} s) are needed, 12 are better",
    )


def judge(e: SpectralAmplitudes) -> Finding:
    """Return the finding of the first rule that applies; stable where none does."""
    for rule in (
        _silence_rule,
        _sideband_rule,
        _half_rule,
        _period_doubling_rule,
        _mask_rule,
        _foreign_order_rule,
        _crowded_rule,
    ):
        finding = rule(e)
        if finding is not None:
            return finding
    reason = f"the largest non-harmonic peak is {e.ratio:.2g} of {_denominator(e)}, "
    if e.ratio < e.threshold:
        reason += f"below {e.threshold:g}"
    else:
        reason += (
            f"but its envelope is that of filtered noise (kurtosis {e.envelope[0]:.2g}; noise has 2, a line 1), "
            "without sidebands: a mode that the noise of the cut excites"
        )
    return Finding("stable", e.ratio, math.nan, reason)


def _denominator(e: SpectralAmplitudes) -> str:
    """Name what the ratio is taken of."""
    if e.denominator == e.tooth_amplitude:
        return f"the highest tooth harmonic at {e.tooth_frequency:.4g} Hz"
    if e.denominator == e.order_amplitude:
        return f"the highest spindle order at {e.order_frequency:.4g} Hz"
    if e.denominator == e.floor:
        return f"the floor {e.floor:g} (no tooth harmonic reaches it)"
    return f"{e.least:.3g} {e.unit}, a tenth of the highest harmonic of all axes"


def _silence_rule(e: SpectralAmplitudes) -> Finding | None:
    """A spectrum of which nothing, not even a spindle order, reaches the floor."""
    if e.highest >= e.floor:
        return None
    return Finding(
        "undecided",
        e.ratio,
        math.nan,
        f"nothing reaches the floor of {e.floor:g} {e.unit} (the highest line has {e.highest:.2g} {e.unit}), so no cut "
        "is seen: check sensor, unit and interval, or give a lower floor",
    )


def _what(e: SpectralAmplitudes) -> str:
    """Name the candidate and its ratio."""
    frequency, amplitude = e.candidate
    group = " with its sidebands" if e.ratio * e.denominator > 1.001 * amplitude else ""
    return f"the non-harmonic peak at {frequency:.4g} Hz{group} is {e.ratio:.3g} of {_denominator(e)}"


def _sideband_rule(e: SpectralAmplitudes) -> Finding | None:
    """A steady line with two sidebands or more: chatter from `ChatterRules.sideband_share` of the threshold on."""
    if math.isnan(e.candidate[0]) or not e.coherent_sidebands or e.ratio < RULES.sideband_share * e.threshold:
        return None
    reason = f"{_what(e)}, above {e.threshold:g}"
    if e.ratio < e.threshold:
        reason = (
            f"{_what(e)}, below {e.threshold:g}, but steady, and {len(e.highest_sidebands)} lines or more lie a whole "
            "number of spindle orders beside it: what regenerates does so, and nothing in air"
        )
    return Finding("chatter", e.ratio, e.candidate[0], reason)


def _half_rule(e: SpectralAmplitudes) -> Finding | None:
    """A peak above the threshold that is not a harmonic, nor a mode that noise excites."""
    frequency, amplitude = e.candidate
    if math.isnan(frequency):
        return None
    what = _what(e)
    if e.ratio < e.threshold - max(e.guard, RULES.nearly * e.threshold) or (e.ratio < e.threshold and not e.line_like):
        return None
    if e.noise_like:
        return None
    if amplitude < RULES.stands_out * e.noise and not e.line_like:
        return Finding("undecided", e.ratio, frequency, f"{what}, but does not stand out of the noise: cut longer")
    # What a drifting line spreads around itself is no noise.
    if abs(e.ratio - e.threshold) <= min(e.guard, (0.1 if e.line_like else 0.5) * e.threshold):
        reason = f"{what}: within {e.guard:.2g} of {e.threshold:g}, which the noise leaves open; record longer"
        return Finding("undecided", e.ratio, frequency, reason)
    if e.ratio < e.threshold:
        reason = f"{what}, little below {e.threshold:g}, and it is a steady line: judge another axis or sensor as well"
        return Finding("undecided", e.ratio, frequency, reason)
    if not (e.line_like and e.spindle_seen):
        but = (
            f"no order of a spindle at {60.0 * e.base:.4g} rpm stands out of the noise: the tool does not cut, or "
            "turns at another speed; check both"
            if e.line_like
            else "comes and goes like a mode that noise excites: cut longer, or compare with a lower depth"
        )
        return Finding("undecided", e.ratio, frequency, f"{what}, but {but}")
    return Finding("chatter", e.ratio, frequency, f"{what}, above {e.threshold:g}")


def _period_doubling_rule(e: SpectralAmplitudes) -> Finding | None:
    """Order Z/2 of an even number of teeth: run-out or period doubling."""
    frequency, amplitude = e.half
    ratio = amplitude / e.denominator
    excess = ratio - (e.half_reference or 0.0)
    if math.isnan(frequency) or excess < 0.5 * e.threshold or amplitude < e.least:
        return None
    what = (
        f"{frequency:.4g} Hz, an odd multiple of half the tooth passing frequency, is {ratio:.3g} of {_denominator(e)}"
    )
    if e.half_growth > RULES.growth:
        reason = f"{what} and has grown {e.half_growth:.3g} times along the cut: period doubling, not run-out"
        return Finding("chatter", ratio, frequency, reason)
    if e.half_reference is not None:
        if excess < e.threshold:
            return None
        reason = f"{what}; the reference cut has {e.half_reference:.3g} there: period doubling"
        return Finding("chatter", ratio, frequency, reason)
    every, others = e.alternating
    if others > RULES.alternate or (
        excess >= e.threshold and every > RULES.alternating and others > RULES.alternating_rest
    ):
        reason = (
            f"{what}; these orders hold {every:.2g} times what all others have that are no tooth harmonics: every "
            "other tooth cuts alike, which run-out does not do: period doubling"
        )
        return Finding("chatter", ratio, frequency, reason)
    if excess < e.threshold or every < RULES.eccentric:
        return None
    return Finding(
        "undecided",
        ratio,
        frequency,
        f"{what}: run-out or period doubling. Give the half_order_ratio of a stable cut as half_order_reference",
    )


def _mask_rule(e: SpectralAmplitudes) -> Finding | None:
    """Something that does not repeat with the spindle, inside the mask of an order."""
    frequency, amplitude = e.peak(e.masked, e.left)
    ratio = amplitude / e.denominator
    if math.isnan(frequency) or ratio < e.threshold:
        return None
    order = max(1, round(frequency / e.base))
    apart = max(abs(frequency - order * e.base), 0.25 * e.spectrum.resolution)
    # The mask is RULES.mask_bins/T wide on either side, and wider by the error of the speed.
    clear = apart - e.speed_error * order * e.base
    near = e.spectrum.near(order * e.base, e.spectrum.resolution)
    if clear <= 0.25 * e.spectrum.resolution and 0.6 * float(e.amplitude[near].max()) > amplitude:
        # Much less than the order itself, no farther from it than the speed may wander: a harmonic not quite steady.
        return None
    if e.noise_like and abs(frequency - e.candidate[0]) < e.base and ratio < 2.0 * e.threshold:
        # The mode that noise excites beside the mask reaches into it.
        return None
    what = (
        f"{ratio:.3g} of {_denominator(e)} does not repeat with the spindle, but lies at {frequency:.5g} Hz, "
        f"within the mask of spindle order {order}"
    )
    if clear > 0.0 and e.followed and e.coherence > RULES.certain:
        # The speed has been followed, and what lies between the orders is no order.
        reason = f"{what}; its sidebands between the orders stand {e.coherence:.2g} times above the noise there"
        return Finding("chatter", ratio, frequency, reason)
    advice = "a record of the spindle angle or a better known speed would separate them"
    if clear > 0.0:
        judged = 1.0 / e.spectrum.resolution
        advice = f"{RULES.mask_bins / clear:.2g} s of steady cut would separate them, {judged:.2g} s were judged"
    reason = f"{what}: chatter close to a harmonic, or a speed that varies; {advice}"
    return Finding("undecided", ratio, frequency, reason)


def _foreign_order_rule(e: SpectralAmplitudes) -> Finding | None:
    """A spindle order, not of the teeth, far above them: chatter that falls on an order looks like it."""
    if e.order_amplitude < RULES.foreign * max(e.tooth_amplitude, e.floor, e.least) or e.teeth == 1:
        return None
    order = round(e.order_frequency / e.base)
    if order % e.teeth == 0 or order == 1:
        return None
    what = (
        f"spindle order {order} at {e.order_frequency:.4g} Hz is {e.order_amplitude / e.tooth_amplitude:.2g} times "
        f"as high as the harmonics of {e.teeth} teeth"
    )
    if e.coherent_sidebands:
        frequency, lines = e.candidate[0], len(e.highest_sidebands)
        reason = (
            f"{what}, and a steady line at {frequency:.4g} Hz has {lines} lines or more beside it: chatter on an order"
        )
        return Finding("chatter", e.order_amplitude / e.tooth_amplitude, e.order_frequency, reason)
    if e.order_amplitude > RULES.never_run_out * e.tooth_amplitude:
        reason = f"{what}, more than run-out explains: chatter on an order"
        return Finding("chatter", e.order_amplitude / e.tooth_amplitude, e.order_frequency, reason)
    reason = f"{what}: chatter on an order, or another number of teeth; change the speed by 2 %"
    return Finding("undecided", e.ratio, e.order_frequency, reason)


def _crowded_rule(e: SpectralAmplitudes) -> Finding | None:
    """Masks that hide too much of the spectrum at the tooth passing frequency to call a cut stable."""
    tooth = e.teeth * e.base
    half_width = RULES.mask_bins * e.spectrum.resolution + e.speed_error * tooth
    if 2.0 * half_width <= RULES.crowded * e.base:
        return None
    needed = 2.0 * RULES.mask_bins / max(RULES.crowded * e.base - 2.0 * e.speed_error * tooth, 0.05 * e.base)
    return Finding(
        "undecided",
        e.ratio,
        e.candidate[0],
        f"no chatter line is seen, but the masks of the spindle orders ({e.base:.3g} Hz apart, "
        f"+-{half_width:.2g} Hz each) hide more than {100.0 * RULES.crowded:.0f} % of the spectrum; "
        f"{needed:.2g} s of cut are needed, "
        f"{1.0 / e.spectrum.resolution:.2g} s are there",
    )
