"""Operating points as presets of a tool library, in an open form: JSON with one unit in the name of every number.

The form is `PRESET_SCHEMA` (JSON Schema 2020-12). A CAM system's own library takes the numbers over: spindle speed,
feed, feed per tooth, stepdown (``depth_of_cut_mm``) and stepover (``width_of_cut_mm``).
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from process.errors import InputError
from stability.tables.lobe_table import write_whole

FORMAT = "smfe-presets"
VERSION = 2

_POSITIVE = {"type": "number", "exclusiveMinimum": 0}
_UNKNOWN = {"type": ["number", "null"], "exclusiveMinimum": 0}
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
    {
        "pitch_angles_deg": {"type": "array", "items": _POSITIVE},
        "helix_angle_deg": _POSITIVE,
        "edge_length_mm": _POSITIVE,
    },
)


def _operating_point(status: list[str], number: dict[str, Any]) -> dict[str, Any]:
    return _object(
        {
            "status": {"enum": status},
            "spindle_speed_rpm": number,
            "speed_from_rpm": number,
            "speed_to_rpm": number,
            "depth_of_cut_mm": number,
            "limit_depth_mm": _UNKNOWN,
            "limit_depth_p05_mm": _UNKNOWN,
            "limit_depth_p95_mm": _UNKNOWN,
            "width_of_cut_mm": _POSITIVE,
            "feed_per_tooth_mm": _POSITIVE,
            "feed_mm_min": number,
            "cutting_speed_m_min": number,
            "removal_rate_cm3_min": number,
            "probability": _SHARE,
            "chatter_frequency_Hz": _UNKNOWN,
            "lobes": _TEXT,
            "method": _TEXT,
            "cut": {"enum": ["down", "up", "central", "offset", "angles", "strips"]},
            "source": _TEXT,
            "reason": _TEXT,
            "assumptions": {"type": "array", "items": _TEXT},
            "tool": _TOOL,
            "material": _TEXT,
            "machine": _TEXT,
        },
        {"limited_by": {"type": "string"}},
    )


def milling(cut: str) -> str:
    """Return a kind of cut in words: "down milling"."""
    words = {"offset": "offset milling", "angles": "milling between given angles", "strips": "milling of strips"}
    return words.get(cut, f"{cut} milling")


RECOMMENDED, LIMIT_ONLY, NONE = "recommended", "limit_only", "none"
"""A depth to cut with; a limit whose uncertainty is not known, and therefore no depth; nothing that can be cut."""

_ANSWER = _operating_point([RECOMMENDED, LIMIT_ONLY, NONE], _UNKNOWN)

PRESET_SCHEMA: dict[str, Any] = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "title": "Operating points of a milling tool",
    **_object(
        {
            "format": {"const": FORMAT},
            "version": {"const": VERSION},
            "recommendation": _ANSWER,
            "recommendations": {"type": "array", "items": _ANSWER},
            "presets": {"type": "array", "items": _operating_point([RECOMMENDED], _POSITIVE)},
        }
    ),
}
"""The form of a file of presets.

``recommendation`` is the one answer, ``recommendations`` holds one for each request of the campaign, and ``presets``
every pocket that can be cut, best first within each request and source. The numbers of a limit are null where there is
no limit, or where it is not known how sure it is; ``probability`` is null where no depth is given.
"""


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
        found = json.loads(file.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"'{file}' is not JSON: {error}") from error
    version = found.get("version") if isinstance(found, dict) else VERSION
    if version != VERSION:
        raise InputError(
            f"'{file}' has the form of version {version}, and {VERSION} is read; `smfe run` writes it again"
        )
    try:
        return check_presets(found)
    except InputError as error:
        raise InputError(f"'{file}': {error}") from error


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
