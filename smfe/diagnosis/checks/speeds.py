"""Audit of spindle speeds: what is stated, what the speed channel says, what the tacho counts, and the teeth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import xarray as xr

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients, force_harmonics
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import axis_present, sample_interval
from process.types import Real
from smfe.diagnosis.checks.suspect import Suspect
from smfe.identification.spectra.spindle_angle import spindle_angle
from smfe.identification.sweep.passes import in_cut

AGREE = 0.02
"""Relative difference between two statements of one speed that slip and the load of a cut explain."""

STEADY = 0.02
"""Relative range of the speed within which the orders of a cut are lines."""

LOUDER = 5.0
"""Times the largest line at a multiple of the number of teeth from which another order is the teeth's."""

RUNOUT = 3.0
"""Largest run-out that is taken for one: of the chips of single teeth, over their mean."""

STANDS_OUT = 2.0
"""Times its neighbours from which an order stands above them."""

KR = 0.3
"""Radial over tangential cutting coefficient that the spectrum of a tooth is had with; it changes little."""

ORDERS = 12
"""Highest number of teeth that is looked for."""


def speed_suspects(
    record: xr.Dataset, where: str, stated: float | None, excludes: tuple[tuple[str, str], ...] = ()
) -> list[Suspect]:
    """Compare the stated speed [rpm], the speed channel and the tacho of one record.

    Parameters
    ----------
    record : xarray.Dataset
        The record.
    where : str
        Measurement or test, and file.
    stated : float or None
        Spindle speed that the campaign states [rpm].
    excludes : tuple, optional
        What a disagreement leaves out.
    """
    speeds = {} if stated is None else {"the stated speed": stated}
    if "spindle_speed" in record:
        speeds["the speed channel"] = float(np.median(record["spindle_speed"].values))
    counted = "spindle_angle" if "spindle_angle" in record else "tacho" if "tacho" in record else None
    if counted is not None:
        try:
            angle = spindle_angle(record)[0]
        except InputError as error:
            return [Suspect("tacho", "fault", f"{where}, {counted}", str(error), "correct [channels]", excludes)]
        speeds[f"the {counted.replace('_', ' ')}"] = float(
            np.median(np.diff(np.unwrap(angle)))
        ) * 30.0 / math.pi / sample_interval(record)  # fmt: skip
    names = list(speeds)
    for i, one in enumerate(names):
        for two in names[i + 1 :]:
            a, b = speeds[one], speeds[two]
            if abs(a - b) > AGREE * max(abs(a), abs(b)):
                return [
                    Suspect(
                        "spindle_speed",
                        "fault",
                        where,
                        f"{one} is {a:.5g} rpm, {two} {b:.5g} rpm{_pulses(record, a / b if b else math.inf, two)}",
                        "correct the one that is wrong; the length of the time step scales what a tacho counts",
                        excludes,
                    )
                ]
    return []


def _pulses(record: xr.Dataset, ratio: float, counted: str) -> str:
    """Say which number of pulses a revolution would make a tacho agree."""
    if counted != "the tacho" or not math.isfinite(ratio) or ratio <= 0.0:
        return ""
    right = float(record["tacho"].attrs.get("pulses_per_revolution", 1.0)) / ratio
    near = round(right)
    return f" (pulses_per_revolution = {near} fits)" if near >= 1 and abs(right / near - 1.0) < AGREE else ""


def tooth_suspects(record: xr.Dataset, where: str, speed: float, tool: Tool, arc: AnyEngagement) -> list[Suspect]:
    """Look for an order that is much louder than every multiple of the number of teeth, in a steady cut.

    Force, else acceleration, of all axes together; amplitudes at the orders of the spindle from 2 (Hann, while the tool
    cuts). Run-out is at order 1, which is not looked at; chatter lies between the orders. With run-out the force at
    order n is ``P(n) R(n)``: the spectrum P of one tooth in its arc, and R of the chips of the teeth, 1 at multiples of
    their number and the relative run-out elsewhere. Where P hardly has the multiples (the force of four teeth in
    a slot is constant), run-out is louder than the teeth; an order counts beyond `RUNOUT` times what P makes of it. An
    acceleration is amplified by modes, one order at a time: a further multiple must stand out as well.

    Parameters
    ----------
    record : xarray.Dataset
        The record.
    where : str
        Test and file.
    speed : float
        Spindle speed [rpm].
    tool : Tool
        With the declared number of teeth.
    arc : Engagement or Engagements
        Where a tooth cuts.
    """
    name = "force" if "force" in record and axis_present(record, "force") else "acceleration"
    axes = axis_present(record, name) if name in record else []
    if not axes or ("spindle_speed" in record and np.ptp(record["spindle_speed"].values) > STEADY * speed):
        return []
    dt, turn = sample_interval(record), 60.0 / speed
    samples = record[name].sel(axis=axes).values
    if name == "force" and (inside := np.flatnonzero(in_cut(record))).size:
        # From the first tooth to the last: where teeth cut one by one there is air between them, and it takes time.
        samples = samples[:, inside[0] : inside[-1] + 1]
    if samples.shape[1] * dt < 12.0 * turn:
        return []
    every = np.arange(1, 3 * ORDERS + 1)
    every = every[every / turn < 0.4 / dt]
    orders = every[(every > 1) & (every <= ORDERS)]
    teeth = orders % tool.teeth == 0
    if not teeth.any() or teeth.all():
        return []
    window = np.hanning(samples.shape[1])
    t = dt * np.arange(samples.shape[1])
    waves = window * np.exp(-2j * np.pi * np.outer(every / turn, t))
    size = np.linalg.norm((samples - samples.mean(axis=1, keepdims=True)) @ waves.T, axis=0)
    single = replace(tool, teeth=1, pitch_angles=None, runout=None)
    pulse = np.linalg.norm(force_harmonics(single, arc, CuttingCoefficients(1.0, KR, 0.0), 1e-3, 1e-4, orders), axis=1)
    loudness = size[orders - 1]
    own = float(loudness[teeth].max())
    usual = np.maximum(LOUDER * own, RUNOUT * own * pulse / pulse[teeth].max())
    loud = [int(n) for n in orders[~teeth & (loudness > usual)] if name == "force" or _again(size, int(n))]
    if not loud:
        return []
    other = max(loud, key=lambda n: float(size[n - 1]))
    return [
        Suspect(
            "tooth_number",
            "warning",
            where,
            f"order {other} of the spindle is {size[other - 1] / own:.2g} times as loud as any multiple of the "
            f"{tool.teeth} teeth",
            f"give the number of teeth that cut ({other} would fit), or the right spindle speed",
        )
    ]


def _again(size: Real, order: int) -> bool:
    """Whether the second or third multiple of an order stands above its neighbours: teeth do that, a mode does not."""
    near = [size[n - 1] / max(size[n - 2], size[n]) for n in (2 * order, 3 * order) if n < size.size]
    return max(near, default=0.0) > STANDS_OUT
