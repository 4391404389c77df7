"""Operating points as presets of a tool library, in an open form: JSON with one unit in the name of every number.

The form is `PRESET_SCHEMA` (JSON Schema 2020-12). A CAM system's own library takes the numbers over: spindle speed,
feed, feed per tooth, stepdown (``depth_of_cut_mm``) and stepover (``width_of_cut_mm``).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from process.cut.tool import Tool
from process.errors import InputError
from stability.tables.lobe_table import write_whole

FORMAT = "smfe-presets"
VERSION = 1

_POSITIVE = {"type": "number", "exclusiveMinimum": 0}
_TEXT = {"type": "string", "minLength": 1}
_SHARE = {"type": ["number", "null"], "exclusiveMinimum": 0, "exclusiveMaximum": 1}


def _object(required: dict[str, Any], optional: dict[str, Any] | None = None) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {**required, **(optional or {})},
        "required": list(required),
        "additionalProperties": False,
    }


_TOOL = _object(
    {
        "name": _TEXT,
        "diameter_mm": _POSITIVE,
        "teeth": {"type": "integer", "minimum": 1},
        "approach_angle_deg": _POSITIVE,
    },
    {"pitch_angles_deg": {"type": "array", "items": _POSITIVE}, "helix_angle_deg": _POSITIVE},
)

_PRESET = _object(
    {
        "name": _TEXT,
        "tool": _TOOL,
        "material": _TEXT,
        "cut": {"enum": ["down", "up", "central"]},
        "spindle_speed_rpm": _POSITIVE,
        "depth_of_cut_mm": _POSITIVE,
        "width_of_cut_mm": _POSITIVE,
        "feed_per_tooth_mm": _POSITIVE,
        "feed_mm_min": _POSITIVE,
        "removal_rate_cm3_min": _POSITIVE,
        "safe_probability": _SHARE,
        "source": _TEXT,
    },
    {"stable_from_rpm": _POSITIVE, "stable_to_rpm": _POSITIVE},
)

PRESET_SCHEMA: dict[str, Any] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "Operating points of milling tools",
    **_object(
        {"format": {"const": FORMAT}, "version": {"const": VERSION}, "presets": {"type": "array", "items": _PRESET}}
    ),
}
"""The form of a file of presets. ``safe_probability`` is null where the depth is a limit without margin."""


@dataclass(frozen=True)
class PresetContext:
    """What pockets do not know about themselves.

    Parameters
    ----------
    tool : Tool
        Tool of the cut.
    tool_name, material : str
        As the shop calls them.
    cut : {"down", "up", "central"}
        Kind of cut.
    safe_probability : float or None
        With which the safe depths of the table are stable; None when it has none.
    """

    tool: Tool
    tool_name: str
    material: str
    cut: str
    safe_probability: float | None = None


def presets(pockets: pd.DataFrame, context: PresetContext) -> dict[str, Any]:
    """Return pockets as presets, in the form of `PRESET_SCHEMA`.

    Parameters
    ----------
    pockets : pandas.DataFrame
        From `stability.best_pockets`.
    context : PresetContext
        Tool, material and cut.

    Raises
    ------
    InputError
        When a name is empty, the cut is unknown, or a depth is called safe without a probability.
    """
    for what, text in (("tool", context.tool_name), ("material", context.material)):
        if not text.strip():
            raise InputError(f"the {what} has no name; a preset needs one")
    found = [_preset(row, context) for row in pockets.to_dict("records") if row["safe_depth_mm"] > 0.0]
    return check_presets({"format": FORMAT, "version": VERSION, "presets": found})


def _preset(row: dict[Any, Any], context: PresetContext) -> dict[str, Any]:
    safe = row["basis"] == "safe_depth"
    if safe and context.safe_probability is None:
        raise InputError(
            f"the depths of '{row['source']}' are safe depths, but with which probability is not said; give "
            "safe_probability"
        )
    numbers = {name: _short(row[name]) for name in ("width_of_cut_mm", "feed_per_tooth_mm", "feed_mm_min")}
    return {
        "name": f"{context.tool_name}, {context.material}, {row['spindle_speed_rpm']:.6g} rpm, {context.cut}",
        "tool": _tool(context),
        "material": context.material,
        "cut": context.cut,
        "spindle_speed_rpm": _short(row["spindle_speed_rpm"]),
        # Never rounded up: the depth is a limit.
        "depth_of_cut_mm": math.floor(1e3 * row["safe_depth_mm"]) / 1e3 or _short(row["safe_depth_mm"]),
        **numbers,
        "removal_rate_cm3_min": _short(row["removal_rate_cm3_min"]),
        "safe_probability": context.safe_probability if safe else None,
        "source": row["source"],
        "stable_from_rpm": _short(row["from_rpm"]),
        "stable_to_rpm": _short(row["to_rpm"]),
    }


def _tool(context: PresetContext) -> dict[str, Any]:
    tool = context.tool
    out: dict[str, Any] = {
        "name": context.tool_name,
        "diameter_mm": _short(1e3 * tool.diameter),
        "teeth": tool.teeth,
        "approach_angle_deg": _short(math.degrees(tool.approach_angle)),
    }
    if not tool.equal_pitch:
        out["pitch_angles_deg"] = [_short(math.degrees(p)) for p in tool.pitch_angles or ()]
    if tool.helix_angle > 0.0:
        out["helix_angle_deg"] = _short(math.degrees(tool.helix_angle))
    return out


def _short(value: float) -> float:
    """Return a number with six digits: more is not known."""
    return float(f"{value:.6g}")


def write_presets(document: dict[str, Any], path: str | Path) -> Path:
    """Write presets as JSON, whole or not at all.

    Raises
    ------
    InputError
        As `check_presets`.
    """
    return write_whole(json.dumps(check_presets(document), indent=2, ensure_ascii=False) + "\n", path)


def read_presets(path: str | Path) -> dict[str, Any]:
    """Read presets.

    Raises
    ------
    InputError
        When the file does not exist, is no JSON, or as `check_presets`.
    """
    file = Path(path)
    if not file.is_file():
        raise InputError(f"there is no file '{file}'")
    try:
        return check_presets(json.loads(file.read_text(encoding="utf-8")))
    except json.JSONDecodeError as error:
        raise InputError(f"'{file}' is not JSON: {error}") from error


def check_presets(document: Any) -> dict[str, Any]:
    """Return presets when they have the form of `PRESET_SCHEMA`.

    Raises
    ------
    InputError
        With the place in the document, what is there and what is needed.
    """
    _check(document, PRESET_SCHEMA, "the file")
    return dict(document)


def _check(value: Any, form: dict[str, Any], where: str) -> None:
    """Check the part of JSON Schema that `PRESET_SCHEMA` uses."""
    if "const" in form and value != form["const"]:
        raise InputError(f"{where} is {value!r}; {form['const']!r} is needed")
    if "enum" in form and value not in form["enum"]:
        raise InputError(f"{where} is {value!r}; it must be one of {', '.join(form['enum'])}")
    kinds = [form["type"]] if isinstance(form.get("type"), str) else form.get("type", [])
    if kinds and not any(_is(value, kind) for kind in kinds):
        raise InputError(f"{where} is {value!r}; {' or '.join(kinds)} is needed")
    if isinstance(value, str) and len(value) < form.get("minLength", 0):
        raise InputError(f"{where} is empty; a text is needed")
    if isinstance(value, int | float):
        _check_number(value, form, where)
    if isinstance(value, list):
        for k, item in enumerate(value):
            _check(item, form["items"], f"{where}[{k}]")
    if isinstance(value, dict):
        _check_members(value, form, where)


def _is(value: Any, kind: str) -> bool:
    if isinstance(value, bool):
        return False
    types: dict[str, Any] = {
        "string": str,
        "integer": int,
        "number": (int, float),
        "null": type(None),
        "array": list,
        "object": dict,
    }
    return isinstance(value, types[kind])


def _check_number(value: float, form: dict[str, Any], where: str) -> None:
    low, high = form.get("exclusiveMinimum", -math.inf), form.get("exclusiveMaximum", math.inf)
    if not (low < value < high and value >= form.get("minimum", -math.inf)):
        raise InputError(f"{where} is {value:g}; it must be above {low:g} and below {high:g}")


def _check_members(value: dict[str, Any], form: dict[str, Any], where: str) -> None:
    missing = [name for name in form["required"] if name not in value]
    if missing:
        raise InputError(f"{where} has no '{missing[0]}'; needed are {', '.join(form['required'])}")
    for name, member in value.items():
        if name not in form["properties"]:
            raise InputError(f"{where} has '{name}', which is not known; known are {', '.join(form['properties'])}")
        _check(member, form["properties"][name], f"{where}.{name}")
