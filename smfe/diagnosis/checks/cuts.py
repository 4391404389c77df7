"""Checks of records of cuts: stated speed, speed channel, tacho and clock; number of teeth; size of the force."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np
import xarray as xr

from process.cut.engagement import AnyEngagement, Engagement
from process.cut.force import CuttingCoefficients, force_harmonics
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import axis_present, sample_interval
from process.types import Real
from smfe.diagnosis.checks.rules import RULES
from smfe.diagnosis.checks.suspect import Part, Suspect, fault, warning
from smfe.identification.spectra.spectra import hann
from smfe.identification.spectra.spindle_angle import spindle_angle
from smfe.identification.sweep.passes import PreparedPass, SweepPass, in_cut, prepare
from smfe.identification.sweep.rules import RULES as SWEEP_RULES
from smfe.identification.sweep.spindle_clock import ADVICE, compare_speeds

_EQUAL_TEETH = CuttingCoefficients(1.0, 0.3, 0.0)  # the spectrum of a tooth changes little with Krc/Ktc


def clock_suspects(record: xr.Dataset, where: str, teeth: int | None) -> Iterator[Suspect]:
    """Compare the passing of the teeth with all channels of the speed, steady or not: clocks, teeth, pulses.

    A wrong clock moves all lines. Where a steady cut has a line at the stated tooth passing frequency and a larger one
    beside it, the larger one is chatter, and says nothing of the clock.
    """
    cut = prepare(SweepPass(record, where))
    for found in compare_speeds(cut, teeth):
        if found.real and not _line_at(cut, found.tooth_passing, found.difference, teeth):
            refused = found.source == "spindle_speed" and abs(found.difference) > SWEEP_RULES.refused_speed
            said = f"{where}, {found.source}", found.in_words(), ADVICE[found.source]
            yield (fault if refused else warning)("time_skew", *said)


def _line_at(cut: PreparedPass, stated: tuple[float, float], difference: float, teeth: int | None) -> bool:
    """Whether the force of a steady cut has a line at the stated frequency [Hz], apart from one moved by `difference`.

    The largest of the three bins about it (Hann, all axes) stands `CheckRules.line` times above the median of those
    around, further off than the window is wide. It must not be an order of a spindle that turns faster by `difference`,
    where run-out has a line of its own.
    """
    if cut.cut_piece is None or abs(stated[1] / stated[0] - 1.0) > RULES.steady:
        return False
    force = cut.record["force"].sel(axis=cut.force_axes).transpose("axis", "time").values[:, cut.cut_piece]
    window, step = hann(force.shape[1]), 1.0 / (force.shape[1] * sample_interval(cut.record))
    size = np.linalg.norm(np.fft.rfft((force - force.mean(axis=1, keepdims=True)) * window), axis=0)
    at = round(stated[0] / step)
    order = (teeth or 1) / (1.0 + difference)
    if abs(order - round(order)) * stated[0] * (1.0 + difference) / (teeth or 1) < RULES.apart * step:
        return False
    if abs(difference) * stated[0] < RULES.apart * step or not 4 * RULES.apart < at < size.size - 4 * RULES.apart:
        return False
    around = np.r_[size[at - 4 * RULES.apart : at - 3], size[at + 4 : at + 4 * RULES.apart + 1]]
    return float(size[at - 1 : at + 2].max()) > RULES.line * float(np.median(around))


def speed_suspects(record: xr.Dataset, where: str, stated: float | None, part: Part) -> Iterator[Suspect]:
    """Compare the stated speed [rpm] (None: none is stated), the speed channel and the tacho of one record.

    A disagreement leaves `part` out.
    """
    speeds = {} if stated is None else {"the stated speed": stated}
    if "spindle_speed" in record:
        speeds["the speed channel"] = float(np.median(record["spindle_speed"].values))
    counted = next((name for name in ("spindle_angle", "tacho") if name in record), None)
    if counted is not None:
        try:
            step = float(np.median(np.diff(np.unwrap(spindle_angle(record)[0]))))
        except InputError as error:
            yield fault("tacho", f"{where}, {counted}", str(error), "correct [channels]", part)
            return
        speeds[f"the {counted.replace('_', ' ')}"] = step * 30.0 / math.pi / sample_interval(record)
    for (one, a), (two, b) in combinations(speeds.items(), 2):
        if abs(a - b) > RULES.speeds_agree * max(abs(a), abs(b)):
            fits = ""
            if two == "the tacho" and a * b > 0.0:
                right = float(record["tacho"].attrs.get("pulses_per_revolution", 1.0)) * b / a
                if round(right) >= 1 and abs(right / round(right) - 1.0) < RULES.speeds_agree:
                    fits = f" (pulses_per_revolution = {round(right)} fits)"
            yield fault(
                "spindle_speed",
                where,
                f"{one} is {a:.5g} rpm, {two} {b:.5g} rpm{fits}",
                "correct the one that is wrong; the length of the time step scales what a tacho counts",
                part,
            )
            return


def tooth_suspects(
    record: xr.Dataset, where: str, speed: float, tool: Tool, engagement: AnyEngagement
) -> Iterator[Suspect]:
    """Look for an order with a much larger amplitude than every multiple of the number of teeth, in a steady cut.

    Force, else acceleration, of all axes together; amplitudes at the orders of the spindle (`speed` [rpm]) from 2
    (Hann, while the tool cuts). Run-out is at order 1, which is not looked at; chatter lies between the orders. With
    run-out the force at order n is ``P(n) R(n)``: the spectrum P of one tooth in its engagement, and R of the chips of
    the teeth, 1 at multiples of their number and the relative run-out elsewhere. Where P hardly has the multiples (the
    force of four teeth in a slot is constant), run-out is larger than they are; an order counts beyond
    `CheckRules.runout` times what P makes of it. An acceleration is amplified by modes, one order at a time: a further
    multiple must stand out as well.
    """
    name = "force" if "force" in record and axis_present(record, "force") else "acceleration"
    axes = axis_present(record, name) if name in record else []
    steady = "spindle_speed" not in record or np.ptp(record["spindle_speed"].values) <= RULES.steady * speed
    if not axes or not steady:
        return
    dt, turn = sample_interval(record), 60.0 / speed
    samples = record[name].sel(axis=axes).values
    if name == "force" and (inside := np.flatnonzero(in_cut(record))).size:
        # From the first tooth to the last: where teeth cut one by one there is air between them, and it takes time.
        samples = samples[:, inside[0] : inside[-1] + 1]
    every = np.arange(1, 3 * RULES.orders + 1)
    every = every[every / turn < 0.4 / dt]
    orders = every[(every > 1) & (every <= RULES.orders)]
    teeth = orders % tool.teeth == 0
    if samples.shape[1] * dt < 12.0 * turn or not teeth.any() or teeth.all():
        return
    window, t = np.hanning(samples.shape[1]), dt * np.arange(samples.shape[1])
    waves = window * np.exp(-2j * np.pi * np.outer(every / turn, t))
    size = np.linalg.norm((samples - samples.mean(axis=1, keepdims=True)) @ waves.T, axis=0)
    single = replace(tool, teeth=1, pitch_angles=None, runout=None)
    pulse = np.linalg.norm(force_harmonics(single, engagement, _EQUAL_TEETH, 1e-3, 1e-4, orders), axis=1)
    amplitude = size[orders - 1]
    own = float(amplitude[teeth].max())
    usual = np.maximum(RULES.strongest_order * own, RULES.runout * own * pulse / pulse[teeth].max())
    large = [
        int(n)
        for n in orders[~teeth & (amplitude > usual)]
        if (name == "force" or _repeats(size, int(n), tool.teeth)) and not _chatters(size, int(n), tool.teeth)
    ]
    if large:
        other = max(large, key=lambda n: float(size[n - 1]))
        yield warning(
            "tooth_number",
            where,
            f"the amplitude of order {other} of the spindle is {size[other - 1] / own:.2g} times that of any multiple "
            f"of the {tool.teeth} teeth",
            f"give the number of teeth that cut ({other} would fit), or the right spindle speed",
        )


def _repeats(size: Real, order: int, teeth: int) -> bool:
    """Whether a further multiple of an order stands above its neighbours: teeth do that, a mode or a chatter does not.

    Multiples of the declared teeth are there in any case.
    """
    further = [n for n in (2 * order, 3 * order, 4 * order) if n % teeth and n < size.size]
    return any(size[n - 1] > RULES.stands_out * max(size[n - 2], size[n]) for n in further)


def _chatters(size: Real, order: int, teeth: int) -> bool:
    """Whether side lines stand a tooth passing frequency to either side of an order, as a cut that chatters has them.

    Of fewer teeth than declared they would be multiples themselves.
    """
    if teeth % order == 0 or order + teeth >= size.size:
        return False

    def stands_out(n: int) -> bool:
        # Of two teeth both neighbours are their multiples: there side lines tell nothing.
        beside = [size[m - 1] for m in (n - 1, n + 1) if m > 0 and m % teeth]
        return bool(size[n - 1] > RULES.stands_out * max(beside, default=math.inf))

    return all(stands_out(abs(n)) for n in (order - teeth, order + teeth))


def force_suspects(
    record: xr.Dataset,
    where: str,
    cut: tuple[Tool, Engagement, CuttingCoefficients],
    depth: float,
    feed_per_tooth: float,
    *excludes: Part,
) -> Iterator[Suspect]:
    """Compare the fluctuation of a cutting force with what tool and work material make of the cut.

    The root mean square over all measured axes, measured while the tool cuts, over that of the first five harmonics of
    the tooth passing frequency. Chatter raises it; a unit changes it by much more.
    """
    axes = axis_present(record, "force") if "force" in record else []
    try:
        harmonics = force_harmonics(*cut, depth, feed_per_tooth, [1, 2, 3, 4, 5])
    except InputError:
        return
    predicted = math.sqrt(0.5 * float(np.sum(np.abs(harmonics[:, ["xyz".index(a) for a in axes]]) ** 2)))
    samples = record["force"].sel(axis=axes).values[:, in_cut(record)] if axes else np.zeros((0, 0))
    measured = math.sqrt(float(np.sum(np.var(samples, axis=1)))) if samples.shape[1] >= 16 else 0.0
    ratio = measured / predicted if predicted > 0.0 else 0.0
    if ratio > 0.0 and not 1.0 / RULES.of_force < ratio < RULES.of_force:
        yield fault(
            "unit_error",
            f"{where}, force",
            f"it fluctuates by {measured:.3g} N rms in the cut, where tool, material, depth and feed per tooth make "
            f"{predicted:.3g} N",
            "correct the unit or scale of the force in [channels], the coefficients in [material], or depth and feed",
            *excludes,
        )
