"""The rules of the chatter criterion, asked in turn: what the evidence of one axis says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from stability.chatter.amplitudes import CERTAIN, MASK_BINS, Evidence
from stability.chatter.cut_interval import CutPart
from stability.chatter.line_spectrum import STANDS_OUT

Verdict = Literal["stable", "chatter", "undecided"]

FEWEST_TURNS = 6
"""Below this number of turns the masks of neighbouring orders meet."""

GROWTH = 3.0
"""Growth of order Z/2 against the tooth line, first to last quarter of the cut, that run-out cannot explain."""

NEARLY = 0.09
"""A steady line less than this share below the threshold is left open: a sensor may read it low [1]."""

ALTERNATING = 6.0, 0.9
"""Order Z/2 and its odd multiples over all other run-out orders, from which teeth alternate [1]: with the highest order
of all, and without it."""

ALTERNATE = 4.0
"""The same, without the highest order, from which half the threshold suffices [1]."""

ECCENTRIC = 1.5
"""The same, up to which order Z/2 is one of the lines that run-out puts on all orders [1]."""

FAMILY = 0.4
"""Share of the threshold that suffices where more than the height speaks for chatter [1]."""

FOREIGN, NEVER_RUN_OUT = 5.0, 20.0
"""A spindle order that is no tooth harmonic and this many times as high is not put down to run-out [1]: it is left open
(run-out on a resonance reaches about 15), or is chatter."""

CROWDED = 0.25
"""Share of the spectrum that may be masked where a cut is called stable [1]."""


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
    if turns >= FEWEST_TURNS:
        return None
    return Finding(
        "undecided",
        math.nan,
        math.nan,
        f"{part.duration:.3g} s of cut are {turns:.2g} turns, in which no line can be told from a spindle order; at "
        f"least {FEWEST_TURNS} turns ({FEWEST_TURNS / base:.3g} s) are needed, 12 are better",
    )


def judge(e: Evidence) -> Finding:
    """Ask the rules in turn: whether there is a signal, a clear line, period doubling, then what may be hidden."""
    for rule in (_silent, _line, _period_doubling, _hidden, _foreign_order, _crowded):
        finding = rule(e)
        if finding is not None:
            return finding
    reason = f"the largest non-harmonic peak is {e.ratio:.2g} of {_denominator(e)}, "
    if e.ratio < e.threshold:
        reason += f"below {e.threshold:g}"
    else:
        reason += (
            f"but its envelope is that of filtered noise (kurtosis {e.envelope[0]:.2g}; noise has 2, a line 1), "
            "without a family: a mode that the noise of the cut excites"
        )
    return Finding("stable", e.ratio, math.nan, reason)


def _denominator(e: Evidence) -> str:
    """Name what the ratio is taken of."""
    if e.denominator == e.tooth_amplitude:
        return f"the highest tooth harmonic at {e.tooth_frequency:.4g} Hz"
    if e.denominator == e.order_amplitude:
        return f"the highest spindle order at {e.order_frequency:.4g} Hz"
    if e.denominator == e.floor:
        return f"the floor {e.floor:g} (no tooth harmonic reaches it)"
    return f"{e.least:.3g} {e.unit}, a tenth of the highest harmonic of all axes"


def _silent(e: Evidence) -> Finding | None:
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


def _line(e: Evidence) -> Finding | None:
    """A peak that is not a harmonic, nor a mode that noise excites."""
    frequency, amplitude = e.candidate
    if math.isnan(frequency):
        return None
    family = " with its family" if e.ratio * e.denominator > 1.001 * amplitude else ""
    what = f"the non-harmonic peak at {frequency:.4g} Hz{family} is {e.ratio:.3g} of {_denominator(e)}"
    if e.coherent_family and e.ratio >= FAMILY * e.threshold:
        reason = f"{what}, above {e.threshold:g}"
        if e.ratio < e.threshold:
            reason = (
                f"{what}, below {e.threshold:g}, but steady, and {len(e.family)} lines or more lie a whole number of "
                "spindle orders beside it: what regenerates does so, and nothing in air"
            )
        return Finding("chatter", e.ratio, frequency, reason)
    if e.ratio < e.threshold - max(e.guard, NEARLY * e.threshold) or (e.ratio < e.threshold and not e.line_like):
        return None
    if e.noise_like:
        return None
    if amplitude < STANDS_OUT * e.noise and not e.line_like:
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


def _period_doubling(e: Evidence) -> Finding | None:
    """Order Z/2 of an even number of teeth: run-out or period doubling."""
    frequency, amplitude = e.half
    ratio = amplitude / e.denominator
    excess = ratio - (e.half_reference or 0.0)
    if math.isnan(frequency) or excess < 0.5 * e.threshold or amplitude < e.least:
        return None
    what = (
        f"{frequency:.4g} Hz, an odd multiple of half the tooth passing frequency, is {ratio:.3g} of {_denominator(e)}"
    )
    if e.half_growth > GROWTH:
        reason = f"{what} and has grown {e.half_growth:.3g} times along the cut: period doubling, not run-out"
        return Finding("chatter", ratio, frequency, reason)
    if e.half_reference is not None:
        if excess < e.threshold:
            return None
        reason = f"{what}; the reference cut has {e.half_reference:.3g} there: period doubling"
        return Finding("chatter", ratio, frequency, reason)
    every, others = e.alternating
    if others > ALTERNATE or (excess >= e.threshold and every > ALTERNATING[0] and others > ALTERNATING[1]):
        reason = (
            f"{what}; these orders hold {every:.2g} times what all others have that are no tooth harmonics: every "
            "other tooth cuts alike, which run-out does not do: period doubling"
        )
        return Finding("chatter", ratio, frequency, reason)
    if excess < e.threshold or every < ECCENTRIC:
        return None
    return Finding(
        "undecided",
        ratio,
        frequency,
        f"{what}: run-out or period doubling. Give the half_order_ratio of a stable cut as half_order_reference",
    )


def _hidden(e: Evidence) -> Finding | None:
    """Something that does not repeat with the spindle, inside the mask of an order."""
    frequency, amplitude = e.peak(e.masked, e.left)
    ratio = amplitude / e.denominator
    if math.isnan(frequency) or ratio < e.threshold:
        return None
    order = max(1, round(frequency / e.base))
    apart = max(abs(frequency - order * e.base), 0.25 * e.spectrum.resolution)
    # The mask is MASK_BINS/T wide on either side, and wider by the error of the speed.
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
    if clear > 0.0 and e.followed and e.coherence > CERTAIN:
        # The speed has been followed, and what lies between the orders is no order.
        reason = f"{what}; its family between the orders stands {e.coherence:.2g} times above the noise there"
        return Finding("chatter", ratio, frequency, reason)
    advice = "a record of the spindle angle or a better known speed would separate them"
    if clear > 0.0:
        judged = 1.0 / e.spectrum.resolution
        advice = f"{MASK_BINS / clear:.2g} s of steady cut would separate them, {judged:.2g} s were judged"
    reason = f"{what}: chatter close to a harmonic, or a speed that varies; {advice}"
    return Finding("undecided", ratio, frequency, reason)


def _foreign_order(e: Evidence) -> Finding | None:
    """A spindle order, not of the teeth, far above them: chatter that falls on an order looks like it."""
    if e.order_amplitude < FOREIGN * max(e.tooth_amplitude, e.floor, e.least) or e.teeth == 1:
        return None
    order = round(e.order_frequency / e.base)
    if order % e.teeth == 0 or order == 1:
        return None
    what = (
        f"spindle order {order} at {e.order_frequency:.4g} Hz is {e.order_amplitude / e.tooth_amplitude:.2g} times "
        f"as high as the harmonics of {e.teeth} teeth"
    )
    if e.coherent_family:
        frequency, lines = e.candidate[0], len(e.family)
        reason = (
            f"{what}, and a steady line at {frequency:.4g} Hz has {lines} lines or more beside it: chatter on an order"
        )
        return Finding("chatter", e.order_amplitude / e.tooth_amplitude, e.order_frequency, reason)
    if e.order_amplitude > NEVER_RUN_OUT * e.tooth_amplitude:
        reason = f"{what}, more than run-out explains: chatter on an order"
        return Finding("chatter", e.order_amplitude / e.tooth_amplitude, e.order_frequency, reason)
    reason = f"{what}: chatter on an order, or another number of teeth; change the speed by 2 %"
    return Finding("undecided", e.ratio, e.order_frequency, reason)


def _crowded(e: Evidence) -> Finding | None:
    """Masks that hide too much of the spectrum at the tooth passing frequency to call a cut stable."""
    tooth = e.teeth * e.base
    half_width = MASK_BINS * e.spectrum.resolution + e.speed_error * tooth
    if 2.0 * half_width <= CROWDED * e.base:
        return None
    needed = 2.0 * MASK_BINS / max(CROWDED * e.base - 2.0 * e.speed_error * tooth, 0.05 * e.base)
    return Finding(
        "undecided",
        e.ratio,
        e.candidate[0],
        f"no chatter line is seen, but the masks of the spindle orders ({e.base:.3g} Hz apart, "
        f"+-{half_width:.2g} Hz each) hide more than {100.0 * CROWDED:.0f} % of the spectrum; "
        f"{needed:.2g} s of cut are needed, "
        f"{1.0 / e.spectrum.resolution:.2g} s are there",
    )
