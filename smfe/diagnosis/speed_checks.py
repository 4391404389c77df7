"""Audit of spindle speeds: what is stated, what the speed channel says, what the tacho counts, and the teeth."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from process.errors import InputError
from process.labels import axis_present, sample_interval
from smfe.diagnosis.suspect import Suspect
from smfe.force_noise import in_cut
from smfe.spindle_angle import spindle_angle

AGREE = 0.02
"""Relative difference between two statements of one speed that slip and the load of a cut explain."""

STEADY = 0.02
"""Relative range of the speed within which the orders of a cut are lines."""

LOUDER = 5.0
"""Times the largest line at a multiple of the number of teeth from which another order is the teeth's."""

ORDERS = 12


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


def tooth_suspects(record: xr.Dataset, where: str, speed: float, teeth: int) -> list[Suspect]:
    """Look for an order that is much louder than every multiple of the number of teeth, in a steady cut.

    Force, else acceleration, of all axes together; amplitudes at the orders 1 to `ORDERS` of the spindle (Hann, while
    the tool cuts). Run-out is at order 1, which is not looked at; chatter lies between the orders.
    """
    name = "force" if "force" in record and axis_present(record, "force") else "acceleration"
    axes = axis_present(record, name) if name in record else []
    if not axes or ("spindle_speed" in record and np.ptp(record["spindle_speed"].values) > STEADY * speed):
        return []
    dt, turn = sample_interval(record), 60.0 / speed
    inside = in_cut(record) if name == "force" else np.ones(record.sizes["time"], dtype=bool)
    samples = record[name].sel(axis=axes).values[:, inside]
    if samples.shape[1] * dt < 12.0 * turn:
        return []
    orders = np.arange(2, ORDERS + 1)
    orders = orders[orders / turn < 0.4 / dt]
    if not np.any(orders % teeth == 0) or np.all(orders % teeth == 0):
        return []
    window = np.hanning(samples.shape[1])
    t = dt * np.arange(samples.shape[1])
    waves = window * np.exp(-2j * np.pi * np.outer(orders / turn, t))
    size = np.linalg.norm((samples - samples.mean(axis=1, keepdims=True)) @ waves.T, axis=0)
    own = float(size[orders % teeth == 0].max())
    other = int(np.argmax(np.where(orders % teeth == 0, 0.0, size)))
    if size[other] <= LOUDER * own:
        return []
    return [
        Suspect(
            "tooth_number",
            "warning",
            where,
            f"order {orders[other]} of the spindle is {size[other] / own:.2g} times as loud as any multiple of the "
            f"{teeth} teeth",
            f"give the number of teeth that cut ({orders[other]} would fit), or the right spindle speed",
        )
    ]
