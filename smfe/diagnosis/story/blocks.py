"""The next experiment as tables of a campaign file: what to append to it once it is measured.

A table is that of the measurement which the experiment repeats, with what is changed: channels, band and processing
stay as they are. In place of its records stands `RECORD`, the file that is still to be made.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from smfe.campaign import Campaign, Measurement
from smfe.campaign.toml import table
from smfe.diagnosis.cutting.forces import CuttingForces
from smfe.diagnosis.cutting.limits import CuttingLimits
from smfe.diagnosis.frf.noise import Excited
from smfe.diagnosis.inference.problem import Condition, Family, Values

RECORD = "record_{}.csv"
"""What the file of an experiment is called until it is made."""

_OF_ITS_OWN = ("started", "held_out", "repeat", "temperature", "force_level", "observed", "file", "interval")
"""Keys that a repetition does not share with what it repeats."""

_NEAR = 0.97, 1.03
"""Depths of a stable and a chattering cut over the limit that is expected."""

Raw = Mapping[str, Any]


def block_of(campaign: Campaign, family: Family, condition: Condition, values: Values) -> str:
    """Return a condition that is still to be measured as text to append to a campaign file.

    Parameters
    ----------
    campaign : Campaign
        That it is appended to.
    family : Family
        What is tested.
    condition : Condition
        One of its proposals, or one that was measured and is to be repeated.
    values : mapping of str to float
        Of the best model (SI): where a limit is to be looked for.

    Returns
    -------
    str
        One ``[[measurement]]``, or ``[[cutting_test]]``, or two of these; empty where the campaign has nothing like it.
    """
    if isinstance(family, CuttingForces):
        return _cut(campaign, family, condition)
    if isinstance(family, CuttingLimits):
        return _limit(campaign, family, condition, values)
    return _measurement(campaign, condition)


def repeated(campaign: Campaign, name: str) -> str:
    """Return a measurement, or a cutting test by the name of its file, that is made once more, as such text."""
    for m in campaign.measurements:
        if m.name == name:
            return table("[[measurement]]", _like(campaign, m, "again", {}))
    for number, t in enumerate(campaign.cutting_tests):
        if t.file.name == name:
            return table("[[cutting_test]]", {"file": RECORD.format("again"), **_test_like(campaign, number)})
    return ""


# --- Measurements.


def _measurement(campaign: Campaign, condition: Condition) -> str:
    settings, base = condition.settings, _base(campaign, condition)
    if base is None:
        return ""
    changed: dict[str, Any] = {}
    before = base.feed or {}
    axis = _axis(campaign, base, condition)
    feed = float(settings.get("feed", 0.0))
    if feed or before:
        kept = {a: v for a, v in before.items() if a != axis}
        moving = {a: _text(6e4 * v, "mm/min") for a, v in {**kept, axis: feed}.items() if v}
        changed["feed"] = moving or None
    for key, unit, factor in (("added_mass", "kg", 1.0), ("spindle_speed", "rpm", 30.0 / np.pi)):
        if value := float(settings.get(key, 0.0)):
            changed[key] = _text(factor * value, unit)
    if "free_mass" in settings:
        changed = {"free_mass": _text(float(settings["free_mass"]), "kg"), "controller": None, "feed": None}
    if (sensor := settings.get("sensor")) in ("laser", "two"):
        changed["sensor"] = sensor
        if sensor == "laser":
            changed["accelerometer_mass"] = None
    if settings.get("controller"):
        changed["controller"] = settings["controller"]
    if "position" in settings:
        changed["position"] = _text(1e3 * float(settings["position"]), "mm")
    level = abs(float(settings.get("level", 0.0)))
    if base.method == "actuator" and level:
        changed["force_level"] = _text(level, "N")
    return table("[[measurement]]", _like(campaign, base, _slug(condition.name, base.name), changed))


def _base(campaign: Campaign, condition: Condition) -> Measurement | None:
    """Return the measurement that a condition repeats with something changed."""
    named = {m.name: m for m in campaign.measurements}
    if condition.source in named:
        return named[condition.source]
    near = [m for name, m in named.items() if name in condition.name]
    methods = ("hammer", "actuator", "drive")
    return next(iter((*near, *(m for m in campaign.measurements if m.method in methods))), None)


def _axis(campaign: Campaign, base: Measurement, condition: Condition) -> str:
    """Return the axis that moves, or is excited."""
    data = condition.data
    if isinstance(data, Excited) and (moving := [a for a, v in data.feed.items() if v]):
        return moving[0]
    own = getattr(campaign.baseline, "axis", None)
    return own or next((r.excitation for r in base.records if r.excitation), "x")


def _like(campaign: Campaign, base: Measurement, what: str, changed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a measurement with some keys changed (None: left out), under a name of its own."""
    old = next((m for m in _raw(campaign).get("measurement", []) if m.get("name") == base.name), None)
    if old is None:  # made in memory
        old = {"method": base.method, "records": [{"excitation": r.excitation} for r in base.records if r.excitation]}
    plain = {key: value for key, value in old.items() if key not in (*_OF_ITS_OWN, "name", "method", "records")}
    taken = {m.name for m in campaign.measurements} | {m.name for m in campaign.models}
    name = f"{base.name}_{what}"
    while name in taken:
        name += "_again"
    records: list[dict[str, Any]] = []
    seen: set[str] = set()
    for record in old.get("records", []) or [{}]:
        kept = {k: v for k, v in record.items() if k not in (*_OF_ITS_OWN, *changed, "with")}
        along = str(kept.get("excitation", ""))
        if base.method == "sweep" or along not in seen:
            number = f"{name}{f'_{along}' if along else ''}{f'_{len(records) + 1}' if along in seen else ''}"
            records.append({"file": RECORD.format(number), **kept})
            seen.add(along)
    made = {key: value for key, value in {**plain, **changed}.items() if value is not None}
    return {"name": name, "method": old.get("method", base.method), **made, "records": records}


# --- Cutting tests.


def _cut(campaign: Campaign, family: CuttingForces, condition: Condition) -> str:
    settings = condition.settings
    if "spindle_rpm" not in settings or not campaign.cutting_tests:
        return ""
    cut = getattr(condition.data, "cut", None)
    speed = float(settings["spindle_rpm"]) if cut is None else cut.rotation * 30.0 / np.pi
    number = _nearest(campaign, float(settings["depth"]), float(settings["feed_per_tooth"]))
    new = {
        "spindle_speed": _text(speed, "rpm"),
        "depth_of_cut": _text(1e3 * float(settings["depth"]), "mm"),
        "feed_per_tooth": _text(1e3 * float(settings["feed_per_tooth"]), "mm"),
    }
    made = {**_test_like(campaign, number), **new}
    return table("[[cutting_test]]", {"file": RECORD.format(_slug(condition.name, "")), **made})


def _limit(campaign: Campaign, family: CuttingLimits, condition: Condition, values: Values) -> str:
    """Return two cuts about the limit that is expected: one should be stable, the other chatter."""
    speed = float(condition.settings["spindle_speed"])
    feed = float(condition.settings["feed_per_tooth"])
    if not campaign.cutting_tests:
        return ""
    expected = family.depth(condition, values)
    if not np.isfinite(expected):
        expected = max(t.depth_of_cut for t in campaign.cutting_tests)
    new = {"spindle_speed": _text(speed, "rpm"), "feed_per_tooth": _text(1e3 * feed, "mm")}
    made = {**_test_like(campaign, _nearest(campaign, expected, feed)), **new}
    return "\n".join(
        table(
            "[[cutting_test]]",
            {
                "file": RECORD.format(f"{speed:.0f}_rpm_{k}"),
                **made,
                "depth_of_cut": f"{1e3 * share * expected:.3g} mm",  # as a machine is set
            },
        )
        for k, share in enumerate(_NEAR, 1)
    )


def _nearest(campaign: Campaign, depth: float, feed: float) -> int:
    """Return the cutting test whose depth and feed per tooth are nearest."""
    away = [abs(t.depth_of_cut - depth) + 10.0 * abs((t.feed_per_tooth or feed) - feed) for t in campaign.cutting_tests]
    return int(np.argmin(away))


def _test_like(campaign: Campaign, number: int) -> dict[str, Any]:
    """Return the table of a cutting test without what belongs to it alone."""
    tests = _raw(campaign).get("cutting_test", [])
    t = campaign.cutting_tests[number]
    old = tests[number] if number < len(tests) else _stated(t)
    return {key: value for key, value in old.items() if key not in _OF_ITS_OWN}


def _stated(t: Any) -> dict[str, Any]:
    return {
        "spindle_speed": _text(t.spindle_speed, "rpm"),
        "depth_of_cut": _text(1e3 * t.depth_of_cut, "mm"),
        "cut": t.cut,
        "width_of_cut": _text(1e3 * t.width_of_cut, "mm"),
        **({} if t.feed_per_tooth is None else {"feed_per_tooth": _text(1e3 * t.feed_per_tooth, "mm")}),
    }


# --- Text.


def _raw(campaign: Campaign) -> Raw:
    """Return the tables of a campaign as its file has them; none where it was made in memory."""
    with suppress(OSError, ValueError):
        return tomllib.loads(campaign.path.read_text(encoding="utf-8-sig"))
    return {}


def _text(value: float, unit: str) -> str:
    return f"{value:.6g} {unit}"


def _slug(name: str, base: str) -> str:
    """Return what is changed as part of a name: "as hammer_500, but at 100 mm/min" -> "100_mm_min"."""
    text = name.removeprefix(f"as {base}, but ").removeprefix("at ").removeprefix("with ")
    words: Sequence[str] = re.findall(r"-?[0-9]+(?:\.[0-9]+)?|[A-Za-z]+", text)
    return "_".join(words[:6]).lower() or "next"
