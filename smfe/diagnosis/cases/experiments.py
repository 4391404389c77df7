"""Experiments that a machine could do next, from those it has done: one thing changed at a time, and its price.

Each is a condition without data, worded as a repetition: "as hammer_500, but at 100 mm/min". The inference predicts it
with the hypotheses that are left and ranks it (`smfe.diagnosis.judgement.next_experiment`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from smfe.diagnosis.drive.balance import ANY
from smfe.diagnosis.drive.filters import motion
from smfe.diagnosis.drive.record import DriveRecordFamily, ForceData
from smfe.diagnosis.drive.rules import RULES as DRIVE_RULES
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.frf.causes import AXES
from smfe.diagnosis.frf.noise import Excited, excited_of
from smfe.diagnosis.frf.rules import RULES
from smfe.diagnosis.inference.problem import Condition


@dataclass(frozen=True)
class ProposalRules:
    """What is proposed, and its price."""

    feeds: tuple[float, ...] = (25.0, 50.0, 100.0, 250.0, 500.0)
    """Feeds of the transition from sticking to sliding, and above [mm/min]."""
    minutes: Mapping[str, float] = field(
        default_factory=lambda: {"hammer": 5.0, "actuator": 8.0, "controller": 5.0, "position": 5.0, "added_mass": 10.0}
    )
    """Time of a measurement, by its method, and further time of a change [min]."""
    cut: float = 3.0  # time of a further cut [min]
    further: float = 0.3  # distance to another position [m]
    mass_share: float = 0.1  # mass that is clamped to the tip, over the mass of the tip
    free_mass: float = 20.0  # mass on soft springs that a calibration takes [kg]
    accurate: float = 0.005  # relative error of the compliance of a free mass
    moves: float = 2.0  # time of further moves of an axis [min]
    slow: float = 0.2  # their speed, over the slowest that was measured
    fast: float = 2.0  # ... and over the fastest
    gentle: float = 0.25  # their acceleration, over the largest that was measured
    longest: float = 20.0  # what they take of a record [s]
    speed: float = 300.0  # speed of a spindle that has not been turned yet [rad/s]


PROPOSALS = ProposalRules()
_MM_MIN = 6e4


def proposed_experiments(family: MachineFrfs) -> tuple[Condition, ...]:
    """Return the experiments that the machine of a family could do next.

    Transition feeds, the other direction, half and double the level, other controllers, another position, an added
    mass: those that were not measured already.
    """
    measured = [c for c in family.conditions if isinstance(c.data, Excited)]

    found: list[Condition] = []
    for moves in (True, False):
        kind = [c for c in measured if bool(_feed(c)) == moves]
        if not kind:
            continue
        # The one that shares most settings with the others of its kind; of several the fastest.
        shared = [
            sum(c.settings.get(k) == o.settings.get(k) for o in kind for k in ("method", "controller")) for c in kind
        ]
        base = max(zip(shared, kind, strict=True), key=lambda pair: (pair[0], abs(_feed(pair[1]))))[1]
        for words, key, value in _changes(base, family):
            proposal = _proposal(base, words, key, value, family.baseline.axis)
            if not any(_same(proposal, c) for c in (*measured, *found)):
                found.append(proposal)
    return tuple(found)


def _feed(condition: Condition) -> float:
    return float(condition.settings.get("feed", 0.0))


def _changes(base: Condition, family: MachineFrfs) -> Iterator[tuple[str, str, float | str]]:
    """Yield what is changed: in words, the setting, its value."""
    feed, level = _feed(base), float(base.settings["level"])
    unit = "N s" if base.settings["method"] == "hammer" else "N"
    for speed in PROPOSALS.feeds:
        yield f"at {math.copysign(speed, feed):g} mm/min", "feed", math.copysign(speed / _MM_MIN, feed)
    if feed:
        yield f"at {-feed * _MM_MIN:g} mm/min, the other direction", "feed", -feed
    for factor, word in ((0.5, "half"), (2.0, "double")):
        yield f"at {word} the level, {factor * level:.2g} {unit}", "level", factor * level
    for name in filter(None, family.baseline.servos):
        yield f"with controller {name}", "controller", name
    if "position" in base.settings or not any("position" in c.settings for c in family.conditions):
        place = float(base.settings.get("position", 0.0)) + PROPOSALS.further
        yield f"{PROPOSALS.further * 1e3:g} mm further along the stroke", "position", place
    mass = float(f"{PROPOSALS.mass_share * family.baseline.drive.tip_mass:.1g}")
    yield f"with {mass:g} kg clamped to the tip", "added_mass", float(base.settings.get("added_mass", 0.0)) + mass


def _proposal(base: Condition, words: str, key: str, value: float | str, axis: str) -> Condition:
    excited = excited_of(base)
    settings: dict[str, float | str] = {**base.settings, key: value}
    level = float(settings["level"])
    # The error of a line is that of the sensors mostly: a compliance is known better at a higher level.
    data = replace(
        excited,
        feed={**excited.feed, axis: float(settings["feed"])},
        level=math.copysign(level, excited.level),
        std=excited.std * (abs(excited.level) / level),
        controller=str(settings["controller"]) or excited.controller,
        hits=None,
    )
    settings["minutes"] = PROPOSALS.minutes.get(str(settings["method"]), 8.0) + PROPOSALS.minutes.get(key, 0.0)
    return Condition(f"as {base.name}, but {words}", settings, None, base.name, data)


def _same(one: Condition, other: Condition) -> bool:
    alike = all(
        one.settings.get(key) == other.settings.get(key) for key in ("method", "controller", "position", "added_mass")
    )
    ratio = float(one.settings["level"]) / float(other.settings["level"])
    return alike and abs(_feed(one) - _feed(other)) <= 1e-3 / _MM_MIN and abs(math.log(ratio)) < RULES.same_level


# --- A machine that is modelled by modes.


def proposed_modal_experiments(conditions: Sequence[Condition]) -> tuple[Condition, ...]:
    """Return experiments that are not among the measured ones, each as accurate as the first of these.

    The first condition once more at the end; hits in all directions; a free mass; no accelerometer, and two; twice and
    half the level; another position; a turning spindle.
    """
    used = [c for c in conditions if isinstance(c.data, Excited) and "free_mass" not in c.settings]
    if not used:
        return ()
    first, last = used[0], max(float(c.settings.get("order", 0.0)) for c in used)
    excited = excited_of(first)
    later = dict(first.settings) | {"order": last + 0.05}
    known = {key: {c.settings.get(key) for c in conditions} for key in ("sensor", "spindle_speed", "free_mass")}
    found = [("the first condition once more, at the end", later, excited)]
    everything = tuple(product(AXES, AXES))
    if set(excited.entries) != set(everything):  # the unknown ones as accurate as the known
        std = np.repeat(excited.std.max(axis=1, keepdims=True), len(everything), axis=1)
        whole = replace(excited, entries=everything, std=std, shared=None)
        found.append(("motion along x, y, z under forces along x, y, z", later, whole))
    if known["free_mass"] == {None}:
        size = 1.0 / (PROPOSALS.free_mass * (2.0 * np.pi * excited.frequency) ** 2)
        std = np.repeat(PROPOSALS.accurate * size[:, None], len(excited.entries), axis=1)
        free = replace(excited, std=std, shared=None)
        found.append(
            (
                f"a free mass of {PROPOSALS.free_mass:g} kg in the machine's place",
                {"free_mass": PROPOSALS.free_mass},
                free,
            )
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
        found.append(("a turning spindle", later | {"spindle_speed": PROPOSALS.speed}, excited))
    return tuple(Condition(name, settings, None, first.name, data) for name, settings, data in found)


# --- An axis that moves.


def proposed_moves(family: DriveRecordFamily) -> tuple[Condition, ...]:
    """Return moves that a record of an axis has not, as a family compares them, without data.

    Slower and faster, the other direction where one is all there is, on another part of the stroke, with gentle ramps.
    Each goes to and fro, or over and over in the direction that is missing.
    """
    measured = [(c, c.data) for c in family.conditions if isinstance(c.data, ForceData)]
    if not measured:
        return ()
    place = [(float(d.motion.position.min()), float(d.motion.position.max())) for _, d in measured]
    low, high = min(p[0] for p in place), max(p[1] for p in place)
    speeds = [float(np.percentile(np.abs(d.motion.velocity), 90.0)) for _, d in measured]
    steep = max(float(np.abs(d.motion.acceleration).max()) for _, d in measured)
    ways = {str(c.settings.get("direction", "")) for c, _ in measured}
    end = max(float(d.motion.time[-1]) for _, d in measured)
    slow, fast, usual = PROPOSALS.slow * min(speeds), PROPOSALS.fast * max(speeds), max(speeds)
    softly = PROPOSALS.gentle * steep
    soft = min(usual, 0.9 * math.sqrt(softly * (high - low)))  # what it reaches within the stroke
    half = 0.5 * (high - low)
    begin, far = round(1e3 * (low + half)), round(1e3 * (high + half))
    # No record says how fast and how far the machine can go.
    asked = [
        (f"at {_two(1e3 * slow)} mm/s", "speed", slow, steep, low),
        (f"at {_two(1e3 * fast)} mm/s, if it may move so fast", "speed", fast, steep, low),
        (f"with ramps of {_two(softly)} m/s2", "ramp", soft, softly, low),
        (f"from {begin} to {far} mm, if its stroke goes so far", "position", usual, steep, low + half),
    ]
    found = []
    for words, what, speed, ramp, start in asked:
        if speed**2 / ramp <= high - low:  # else the stroke is too short to reach the speed
            found.append(_moves(family, f"moves {words}", what, speed, ramp, start, high - low, end))
    if len(ways) == 1:
        words = "moves in the other direction" + (", backward" if ways == {"forward"} else ", forward")
        found.append(_moves(family, words, "direction", usual, steep, low, high - low, end))
    return tuple(found)


def _two(value: float) -> str:
    """Return a number with two digits, never as a power of ten."""
    return f"{float(f'{value:.2g}'):g}"


def _moves(
    family: DriveRecordFamily,
    name: str,
    what: str,
    speed: float,
    ramp: float,
    begin: float,
    stroke: float,
    end: float,
) -> Condition:
    """Return moves from rest to rest over a stroke [m] from a place on [m], later than the record [s]."""
    model = family.model
    step, order = model.resampler.step, model.whitener.order
    there = min(stroke / speed + speed / ramp, 0.5 * PROPOSALS.longest)
    rest = max(0.3, (model.resampler.margin + order * model.resampler.every) * step)
    t = np.arange(0.0, 2.0 * (there + rest) + rest, step)
    pace = np.zeros_like(t)
    for k, sign in enumerate((1.0, -1.0)):
        own = t - rest - k * (there + rest)
        pace += sign * np.clip(np.minimum(ramp * own, ramp * (there - own)), 0.0, speed)
    moving = motion(begin + step * np.cumsum(pace), step, model.resampler.cutoff)
    moving = replace(moving, time=moving.time - moving.time[0] + end)
    silent = np.zeros_like(t)
    turning = model.resampler(np.where(moving.standing, 0.0, 1.0))[order:] >= DRIVE_RULES.least_moving
    data = ForceData(moving, model.resampler(silent), model.noise[ANY], silent, turning)
    settings: dict[str, float | str] = {"direction": "forward", "speed": float(f"{speed:.1g}"), "quarter": 3.0}
    if what == "direction":
        settings["direction"] = "backward" if "backward" in name else "forward"
    settings |= {"minutes": PROPOSALS.moves, "stroke_from": begin, "stroke_to": begin + stroke}
    return Condition(name, settings, None, "", data)
