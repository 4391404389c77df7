"""Experiments that a machine could do next, from those it has done: one thing changed at a time, and its price.

Each is a condition without data, worded as a repetition: "as hammer_500, but at 100 mm/min". The engine predicts what
the open hypotheses make of it and ranks it (`smfe.diagnosis.inference.next_experiment`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.modal_causes import AXES
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.inference.problem import Condition

FEEDS = (25.0, 50.0, 100.0, 250.0, 500.0)
"""Feeds of the transition from sticking to sliding, and above [mm/min]."""

MINUTES: Mapping[str, float] = {"hammer": 5.0, "actuator": 8.0}
"""What a measurement takes."""

MORE_MINUTES: Mapping[str, float] = {"controller": 5.0, "position": 5.0, "added_mass": 10.0}
"""What a change takes on top."""

_MM_MIN = 6e4
_FURTHER = 0.3  # m
_SHARE = 0.1  # of the tip mass
_ALIKE = 0.2  # relative difference of levels that counts as the same


@dataclass(frozen=True)
class _Change:
    """What is different: in words, in settings, in feed [m/s] and level."""

    words: str
    kind: str
    settings: Mapping[str, float | str]


def menu(family: MachineFrfs) -> tuple[Condition, ...]:
    """Return the experiments that the machine of a family could do next.

    Transition feeds, the other direction, half and double the level, other controllers, another position, an added
    mass: those that were not measured already.
    """
    measured = [c for c in family.conditions if isinstance(c.data, Excited)]
    idle = [c for c in measured if not _feed(c)]
    moving = [c for c in measured if _feed(c)]
    bases = [c for c in (_typical(moving), _typical(idle)) if c is not None]
    found: list[Condition] = []
    for base in bases:
        for change in _changes(base, family):
            proposal = _proposal(base, change, family.baseline.axis)
            if not any(_same(proposal, c) for c in (*measured, *found)):
                found.append(proposal)
    return tuple(found)


def _typical(conditions: Sequence[Condition]) -> Condition | None:
    """Return the condition that shares most settings with the others; of several the fastest."""
    if not conditions:
        return None

    def shared(c: Condition) -> tuple[float, float]:
        alike = sum(c.settings.get(k) == o.settings.get(k) for o in conditions for k in ("method", "controller"))
        return alike, abs(_feed(c))

    return max(conditions, key=shared)


def _feed(condition: Condition) -> float:
    return float(condition.settings.get("feed", 0.0))


def _changes(base: Condition, family: MachineFrfs) -> Iterator[_Change]:
    feed, level = _feed(base), float(base.settings["level"])
    unit = "N s" if base.settings["method"] == "hammer" else "N"
    for speed in FEEDS:
        value = math.copysign(speed / _MM_MIN, feed)
        yield _Change(f"at {math.copysign(speed, feed):g} mm/min", "feed", {"feed": value})
    if feed:
        yield _Change(f"at {-feed * _MM_MIN:g} mm/min, the other direction", "feed", {"feed": -feed})
    for factor, word in ((0.5, "half"), (2.0, "double")):
        yield _Change(f"at {word} the level, {factor * level:.2g} {unit}", "level", {"level": factor * level})
    for name in _controllers(family):
        yield _Change(f"with controller {name}", "controller", {"controller": name})
    if "position" in base.settings or not any("position" in c.settings for c in family.conditions):
        place = float(base.settings.get("position", 0.0)) + _FURTHER
        yield _Change(f"{_FURTHER * 1e3:g} mm further along the stroke", "position", {"position": place})
    mass = float(f"{_SHARE * _tip_mass(family):.1g}")
    more = float(base.settings.get("added_mass", 0.0)) + mass
    yield _Change(f"with {mass:g} kg clamped to the tip", "added_mass", {"added_mass": more})


def _controllers(family: MachineFrfs) -> list[str]:
    return [name for name in getattr(family.baseline, "servos", {}) if name]


def _tip_mass(family: MachineFrfs) -> float:
    return next((p.start for p in family.nuisances if p.name == "tip_mass"), 10.0)


def _proposal(base: Condition, change: _Change, axis: str) -> Condition:
    excited = base.data
    assert isinstance(excited, Excited)
    settings: dict[str, float | str] = {**base.settings, **change.settings}
    method, level = str(settings["method"]), float(settings["level"])
    # The error of a line is that of the sensors mostly: a compliance is known better at a higher level.
    data = replace(
        excited,
        feed={**excited.feed, axis: float(settings["feed"])},
        level=math.copysign(level, excited.level),
        std=excited.std * (abs(excited.level) / level),
        controller=str(settings["controller"]) or excited.controller,
        hits=None,
    )
    settings["minutes"] = MINUTES.get(method, 8.0) + MORE_MINUTES.get(change.kind, 0.0)
    return Condition(f"as {base.name}, but {change.words}", settings, None, "", data)


def _same(one: Condition, other: Condition) -> bool:
    for key in ("method", "controller", "position", "added_mass"):
        if one.settings.get(key) != other.settings.get(key):
            return False
    if abs(_feed(one) - _feed(other)) > 1e-3 / _MM_MIN:
        return False
    levels = float(one.settings["level"]), float(other.settings["level"])
    return abs(math.log(levels[0] / levels[1])) < _ALIKE


# --- What could be measured next on a machine that is modelled by modes.

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
