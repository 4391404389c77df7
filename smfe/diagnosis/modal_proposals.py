"""What could be measured next on a machine that is modelled by modes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from smfe.diagnosis.frf_noise import Excited
from smfe.diagnosis.modal_causes import AXES
from smfe.diagnosis.problem import Condition

FREE_MASS = 20.0
"""Mass on soft springs that a calibration takes [kg]."""

ACCURATE = 0.005
"""Relative error of the compliance of a free mass."""

SPEED = 300.0
"""Speed of a spindle that has not been turned yet [rad/s]."""


def modal_proposals(conditions: Sequence[Condition]) -> tuple[Condition, ...]:
    """Return experiments that are not among the measured ones, each as accurate as the first of these.

    Parameters
    ----------
    conditions : sequence of Condition
        Measured compliances of the machine.

    Returns
    -------
    tuple of Condition
        The first condition once more at the end; hits in all directions; a free mass; no accelerometer, and two;
        twice and half the level; another position; a turning spindle.
    """
    used = [c for c in conditions if isinstance(c.data, Excited) and "free_mass" not in c.settings]
    if not used:
        return ()
    first, last = used[0], max(float(c.settings.get("order", 0.0)) for c in used)
    excited = first.data
    assert isinstance(excited, Excited)
    later = dict(first.settings) | {"order": last + 0.05}
    known = {key: {c.settings.get(key) for c in conditions} for key in ("sensor", "spindle_speed", "free_mass")}
    found = [("the first condition once more, at the end", later, excited)]
    everything = tuple(product(AXES, AXES))
    if set(excited.entries) != set(everything):
        found.append(("motion along x, y, z under forces along x, y, z", later, _all_entries(excited)))
    if known["free_mass"] == {None}:
        found.append(
            (f"a free mass of {FREE_MASS:g} kg in the machine's place", {"free_mass": FREE_MASS}, _free(excited))
        )
    for sensor, words in (
        ("laser", "a laser in the accelerometer's place"),
        ("two", "a second accelerometer beside it"),
    ):
        if sensor not in known["sensor"]:
            found.append((words, later | {"sensor": sensor}, excited))
    for factor in (0.5, 2.0):
        level = factor * excited.level
        found.append((f"level {level:.3g}", later | {"level": level}, replace(excited, level=level)))
    place = float(first.settings.get("position", 0.0))
    far = max((abs(float(c.settings.get("position", place)) - place) for c in used), default=0.0) or 0.5
    found.append((f"position {place + 0.5 * far:.3g} m, at the end", later | {"position": place + 0.5 * far}, excited))
    if known["spindle_speed"] <= {None, 0.0}:
        found.append(("a turning spindle", later | {"spindle_speed": SPEED}, excited))
    return tuple(Condition(name, settings, None, "", data) for name, settings, data in found)


def _all_entries(excited: Excited) -> Excited:
    """Return the same with all nine entries, the unknown ones as accurate as the known."""
    entries = tuple(product(AXES, AXES))
    std = np.repeat(excited.std.max(axis=1, keepdims=True), len(entries), axis=1)
    return replace(excited, entries=entries, std=std, shared=None)


def _free(excited: Excited) -> Excited:
    """Return the same for a free mass, which answers along the force only."""
    size = 1.0 / (FREE_MASS * (2.0 * np.pi * excited.frequency) ** 2)
    std = np.repeat(ACCURATE * size[:, None], len(excited.entries), axis=1)
    return replace(excited, std=std, shared=None)
