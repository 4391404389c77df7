"""Presets in a tool bit of FreeCAD (``.fctb``): a JSON file a tool, its presets a list under the key ``presets``.

FreeCAD keeps cutting speed [m/min] and feed per tooth [mm] and computes spindle speed and feed from them and the tool:
``n = 1000 v_c / (pi D)``. A preset of FreeCAD has no depth and no width of cut; they stand in its notes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from process.errors import InputError
from smfe.cam.fusion import unique_name
from smfe.cam.points import OperatingPoint
from smfe.results import write_atomically
from stability.tables.presets import milling

_MARK = "smfe: "
"""Begin of the notes of a preset that an export wrote, by which the next one finds it."""

_VERTICAL = 0.33
"""Vertical feed over feed, FreeCAD's own default."""


def write_freecad(points: Sequence[OperatingPoint], path: Path) -> list[str]:
    """Write operating points as presets into a tool bit, new or existing.

    In an existing tool bit nothing changes but the presets that an earlier export wrote.

    Returns
    -------
    list of str
        Names of the presets.

    Raises
    ------
    InputError
        When the file is no tool bit, or its diameter or number of teeth is not that of the campaign.
    """
    point = points[0]
    content = _read(path) if path.exists() else _new(point)
    _check_tool(content, point, path)
    before = content.get("presets", [])
    cuts = {_cut(p) for p in points}
    kept = [p for p in before if not (isinstance(p, dict) and str(p.get("notes") or "").startswith(tuple(cuts)))]
    taken = {str(p.get("name")) for p in kept if isinstance(p, dict)}
    names = []
    for item in points:
        names.append(unique_name(item.name, taken))
        taken.add(names[-1])
        kept.append(_preset(item, names[-1]))
    content["presets"] = kept
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(path, lambda p: p.write_text(text, encoding="utf-8"))
    return names


def _cut(point: OperatingPoint) -> str:
    return (
        f"{_MARK}{point.machine}, {point.material}, {milling(point.cut)}, width of cut {point.width_of_cut_mm:g} mm; "
    )


def _preset(point: OperatingPoint, name: str) -> dict[str, Any]:
    return {
        "chipload": point.feed_per_tooth_mm,
        "material_hint": {"name": point.material, "uuid": None},
        "name": name,
        "notes": (
            f"{_cut(point)}depth of cut {point.depth_of_cut_mm:g} mm, {point.spindle_speed_rpm:g} rpm, feed "
            f"{point.feed_mm_min:g} mm/min; {point.description}"
        ),
        "op_type_hint": None,
        "surface_speed": math.pi * point.diameter_mm * point.spindle_speed_rpm / 1e3,
        "vert_feed_ratio": _VERTICAL,
    }


def _new(point: OperatingPoint) -> dict[str, Any]:
    """Return an end mill of the tool's diameter and teeth; lengths that no campaign knows are in proportion."""
    edges = point.axial_edges_mm or 0.5 * point.diameter_mm
    return {
        "version": 2,
        "name": point.tool,
        "shape": "endmill.fcstd",
        "shape-type": "Endmill",
        "parameter": {
            "CuttingEdgeHeight": f"{edges:g} mm",
            "Diameter": f"{point.diameter_mm:g} mm",
            "Flutes": point.teeth,
            "Length": f"{1.5 * edges + 2.0 * point.diameter_mm:g} mm",
            "ShankDiameter": f"{point.diameter_mm:g} mm",
        },
        "attribute": {},
    }


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"'{path}' is no tool bit of FreeCAD: it is not JSON ({error})") from error
    form = isinstance(content, dict) and isinstance(content.get("parameter"), dict) and "shape" in content
    if not form or not isinstance(content.get("presets", []), list):
        raise InputError(f"'{path}' is no tool bit of FreeCAD: it has no 'shape' and 'parameter'")
    return dict(content)


def _check_tool(content: dict[str, Any], point: OperatingPoint, path: Path) -> None:
    """Refuse another tool; the diameter of a tool bit is a text with its unit, "5.0000 mm" or "0.5 in"."""
    parameter = content["parameter"]
    flutes = parameter.get("Flutes", content.get("attribute", {}).get("Flutes"))
    if flutes is not None and str(flutes).strip() != str(point.teeth):
        raise InputError(f"'{path}' is a tool of {flutes} teeth; the campaign's has {point.teeth}")
    number, _, unit = str(parameter.get("Diameter", "")).strip().replace('"', " in").partition(" ")
    factor = {"mm": 1.0, "in": 25.4, "inch": 25.4, "": 1.0}.get(unit.strip())
    try:
        diameter = float(number) * (factor or math.nan)
    except ValueError:
        diameter = math.nan
    if not abs(diameter - point.diameter_mm) <= 0.01:
        said = parameter.get("Diameter", "no diameter")
        raise InputError(f"'{path}' is a tool of {said}; the campaign's has {point.diameter_mm:g} mm")
