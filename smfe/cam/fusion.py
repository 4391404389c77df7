"""Presets in a tool library of Autodesk Fusion: a ``.json`` file, or a ``.tools`` file, the zip of one.

There is no published schema. What is written follows libraries that Fusion exported: a library is ``{"data": [tool,
...], "version": 36}``, the presets of a tool are ``tool["start-values"]["presets"]``, lengths are in the unit of the
tool, ``v_c`` in m/min or ft/min, feeds in mm/min or in/min. Fusion takes ``n`` as given and computes ``v_c`` from it:
``v_c = pi DC n``, ``v_f = n NOF f_z``, ``f_n = v_f_plunge / n``.
"""

from __future__ import annotations

import io
import json
import math
import uuid
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from process.errors import InputError
from smfe.cam.points import OperatingPoint
from smfe.results import write_atomically

VERSION = 36
"""Of a new library, as Fusion of 2026 writes it; that of an existing library stays."""

INNER = "tools.json"
"""Name of the library inside a ``.tools`` file."""

_NAMESPACE = uuid.uuid5(uuid.NAMESPACE_DNS, "smfe.cam.fusion")

_MOST_RANKS = 50
"""Presets of one cut that are looked for in order to renew them."""

_PLUNGE, _RAMP_ANGLE, _COOLANT = 1.0 / 3.0, 2, "flood"
"""Feed of plunging over feed, ramp angle and coolant of a tool without a preset: what Fusion gives a new one. No
measurement says them."""

_DIAMETER_TOLERANCE = 0.01
"""Of a tool of the library [mm]: that of an end mill is stated to some hundredths."""


@dataclass(frozen=True)
class Units:
    """Units of a tool of the library.

    Parameters
    ----------
    length : float
        Millimetres a unit of length.
    speed : float
        Metres per minute a unit of cutting speed.
    """

    length: float
    speed: float


UNITS = {"millimeters": Units(1.0, 1.0), "inches": Units(25.4, 0.3048)}


@dataclass
class Library:
    """A library with the way it was written.

    Parameters
    ----------
    content : dict
        As in the file, in its order.
    others : dict of str to bytes
        Other members of a ``.tools`` file.
    inner : str
        Name of the library in it.
    newline, indent, ascii_only, byte_order_mark, ends_with_newline
        How the text was written.
    """

    content: dict[str, Any]
    others: dict[str, bytes]
    inner: str = INNER
    newline: str = "\n"
    indent: int | None = 4
    ascii_only: bool = False
    byte_order_mark: bool = False
    ends_with_newline: bool = True


def write_fusion(points: Sequence[OperatingPoint], path: Path, tool: str | None = None) -> list[str]:
    """Write operating points as presets into a library, new or existing.

    In an existing library nothing changes but the presets of the chosen tool: those that an earlier export of the
    same campaign wrote are replaced, all others stay as they are.

    Parameters
    ----------
    points : sequence of OperatingPoint
        Of one tool.
    path : Path
        ``.json`` or ``.tools``.
    tool : str, optional
        guid, number, product-id or description of the tool in an existing library; default: the only one with the
        diameter and the number of teeth of the points.

    Returns
    -------
    list of str
        Names of the presets that were written.

    Raises
    ------
    InputError
        When the file is no library, holds no such tool or several, or cannot be written.
    """
    library = read_library(path) if path.exists() else new_library(points[0])
    entry = library.content["data"][0] if not path.exists() else choose_tool(library.content, points[0], tool, path)
    _check_edges(entry, points, path)
    names = add_presets(entry, points)
    data = library_bytes(library, path.suffix.lower() == ".tools")
    write_atomically(path, lambda p: p.write_bytes(data))
    return names


def read_library(path: Path) -> Library:
    """Read a library and how it was written.

    Raises
    ------
    InputError
        When the file is no library of Fusion.
    """
    data, others, inner = path.read_bytes(), {}, INNER
    if zipfile.is_zipfile(io.BytesIO(data)):
        try:
            with zipfile.ZipFile(io.BytesIO(data)) as archive:
                names = [n for n in archive.namelist() if n.lower().endswith(".json")]
                inner = INNER if INNER in names else names[0] if len(names) == 1 else ""
                if not inner:
                    raise InputError(f"'{path}' is a zip that holds no {INNER}: it is no tool library of Fusion")
                if archive.getinfo(inner).file_size > 200e6:
                    raise InputError(f"'{path}': {inner} is larger than 200 MB; this is no tool library")
                others = {n: archive.read(n) for n in archive.namelist() if n != inner}
                data = archive.read(inner)
        except zipfile.BadZipFile as error:
            raise InputError(f"'{path}' is a damaged zip ({error}); export the library from Fusion again") from error
    try:
        text = data.decode("utf-8-sig")
        content = json.loads(text, object_pairs_hook=_unrepeated, parse_constant=_no_constant)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise InputError(f"'{path}' is no tool library of Fusion: it is not JSON ({error})") from error
    except ValueError as error:
        raise InputError(f"'{path}' cannot be changed without loss: {error}") from error
    if not (isinstance(content, dict) and isinstance(content.get("data"), list)):
        raise InputError(f"'{path}' is no tool library of Fusion: it has no list 'data'")
    second = next((line for line in text.splitlines()[1:] if line.strip()), "")
    return Library(
        content,
        others,
        inner,
        newline="\r\n" if "\r\n" in text else "\n",
        indent=len(second) - len(second.lstrip()) if second else None,
        ascii_only=text.isascii() and "\\u" in text,
        byte_order_mark=data.startswith(b"\xef\xbb\xbf"),
        ends_with_newline=text.endswith("\n"),
    )


def _unrepeated(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) != len(pairs):
        names = [name for name, _ in pairs]
        raise ValueError(f"a key is there twice: {next(n for n in names if names.count(n) > 1)}")
    return out


def _no_constant(text: str) -> float:
    raise ValueError(f"{text} is no number of JSON")


def library_bytes(library: Library, zipped: bool) -> bytes:
    """Return the file of a library, written as it was."""
    text = json.dumps(library.content, indent=library.indent, ensure_ascii=library.ascii_only, allow_nan=False)
    text = text.replace("\n", library.newline) + (library.newline if library.ends_with_newline else "")
    data = text.encode("utf-8-sig" if library.byte_order_mark else "utf-8")
    if not zipped:
        return data
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in {library.inner: data, **library.others}.items():
            # A fixed date: the same presets make the same file.
            archive.writestr(zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0)), content, zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def new_library(point: OperatingPoint) -> Library:
    """Return a library of one tool, that of the operating points, without presets.

    The geometry is what the campaign knows, diameter, number of teeth, approach angle, length of the edges, and for
    the rest, which no stability depends on, lengths in proportion: OAL > LB >= shoulder >= LCF, as Fusion asks for.
    """
    diameter = point.diameter_mm
    edges = point.axial_edges_mm or 0.5 * diameter
    square = abs(point.approach_angle_deg - 90.0) < 0.5
    geometry: dict[str, Any] = {
        "CSP": False,
        "DC": diameter,
        "HAND": True,
        "LB": 1.5 * edges + diameter,
        "LCF": edges,
        "NOF": point.teeth,
        "OAL": 1.5 * edges + 2.0 * diameter,
        "RE": 0,
        "SFDM": diameter,
        "assemblyGaugeLength": 1.5 * edges + diameter,
        "shoulder-diameter": diameter,
        "shoulder-length": edges,
    }
    if not square:
        geometry["TA"] = 90.0 - point.approach_angle_deg
    entry = {
        "BMC": "carbide",
        "description": point.tool,
        "geometry": geometry,
        "guid": str(uuid.uuid5(_NAMESPACE, f"tool\x1f{point.tool}\x1f{diameter}\x1f{point.teeth}")),
        "post-process": {
            "break-control": False,
            "comment": "",
            "diameter-offset": 0,
            "length-offset": 0,
            "live": True,
            "manual-tool-change": False,
            "number": 0,
            "turret": 0,
        },
        "product-id": "",
        "product-link": "",
        "start-values": {"presets": []},
        "type": "flat end mill" if square else "face mill",
        "unit": "millimeters",
        "vendor": "",
    }
    return Library({"data": [entry], "version": VERSION}, {})


def choose_tool(content: Mapping[str, Any], point: OperatingPoint, wanted: str | None, path: Path) -> dict[str, Any]:
    """Return the tool of a library that the points belong to.

    Raises
    ------
    InputError
        When none or several fit; the tools that there are stand in the message.
    """
    mills = [t for t in content["data"] if isinstance(t, dict) and _diameter(t) is not None]
    if wanted is not None:
        found = [t for t in mills if wanted.strip().casefold() in _names(t)]
        what = f"the tool '{wanted}'"
        wrong = [t for t in found if not _fits(t, point)]
        if found and wrong == found:
            raise InputError(
                f"'{path}': {_title(found[0])} is not the tool of the campaign, {point.diameter_mm:g} mm with "
                f"{point.teeth} teeth; its presets would be wrong for it"
            )
    else:
        found = [t for t in mills if _fits(t, point)]
        what = f"a mill of {point.diameter_mm:g} mm with {point.teeth} teeth"
    if len(found) == 1:
        return found[0]
    listed = "; ".join(_title(t) for t in (found or mills)[:12]) or "no mill at all"
    if found:
        raise InputError(f"'{path}' holds {what} {len(found)} times: {listed}. Choose one by its guid with --tool")
    raise InputError(
        f"'{path}' does not hold {what}; it holds {listed}. Choose with --tool, add the tool in Fusion, or write a new "
        "library and import it"
    )


def _check_edges(tool: Mapping[str, Any], points: Sequence[OperatingPoint], path: Path) -> None:
    """Refuse a depth beyond the edges of the tool of the library."""
    edges = tool["geometry"].get("LCF")
    if not isinstance(edges, int | float) or edges <= 0:
        return
    longest, deepest = edges * UNITS[str(tool["unit"])].length, max(p.depth_of_cut_mm for p in points)
    if deepest > longest + 1e-9:
        along = longest / math.sin(math.radians(points[0].approach_angle_deg))
        raise InputError(
            f"'{path}': the edges of {_title(tool)} reach {longest:g} mm, and {deepest:g} mm are recommended; give "
            f'[tool] edge_length = "{math.floor(10.0 * along) / 10.0:g} mm", along the edge, in the campaign and run '
            "it again"
        )


def _diameter(tool: Mapping[str, Any]) -> float | None:
    """Return the diameter of a mill [mm], None for what has no teeth, or no presets of the form of a mill."""
    geometry = tool.get("geometry")
    units = UNITS.get(str(tool.get("unit")))
    if not isinstance(geometry, dict) or units is None or "probe" in str(tool.get("type")):
        return None
    diameter, teeth = geometry.get("DC"), geometry.get("NOF")
    known = all(isinstance(v, int | float) and not isinstance(v, bool) and v > 0 for v in (diameter, teeth))
    return float(diameter) * units.length if known and diameter is not None else None


def _fits(tool: Mapping[str, Any], point: OperatingPoint) -> bool:
    diameter = _diameter(tool)
    assert diameter is not None
    return abs(diameter - point.diameter_mm) <= _DIAMETER_TOLERANCE and tool["geometry"]["NOF"] == point.teeth


def _names(tool: Mapping[str, Any]) -> list[str]:
    number = (tool.get("post-process") or {}).get("number")
    texts = [tool.get("guid"), tool.get("product-id"), tool.get("description"), number if number else None]
    return [str(t).strip().casefold() for t in texts if t not in (None, "")]


def _title(tool: Mapping[str, Any]) -> str:
    text = str(tool.get("description") or tool.get("product-id") or tool.get("type")).strip()
    return f"{text} ({_diameter(tool):g} mm, {tool['geometry']['NOF']} teeth, guid {tool.get('guid')})"


def add_presets(tool: dict[str, Any], points: Sequence[OperatingPoint]) -> list[str]:
    """Put the points in place of those of an earlier export of the same cuts; return their names."""
    values = tool.setdefault("start-values", {})
    before: list[Any] = values.setdefault("presets", [])
    cuts = {point.cut_key for point in points}
    ours = {_guid(tool, cut, rank) for cut in cuts for rank in range(_MOST_RANKS)}
    kept = [p for p in before if not (isinstance(p, dict) and str(p.get("guid")).strip("{}").lower() in ours)]
    taken = {str(p.get("name")) for p in kept if isinstance(p, dict)}
    names = []
    ranks: dict[str, int] = {}
    for point in points:
        rank = ranks.get(point.cut_key, 0)
        ranks[point.cut_key] = rank + 1
        name = unique_name(point.name, taken)
        taken.add(name)
        names.append(name)
        kept.append(preset(tool, point, name, _guid(tool, point.cut_key, rank)))
    values["presets"] = kept
    return names


def _guid(tool: Mapping[str, Any], cut: str, rank: int) -> str:
    return str(uuid.uuid5(_NAMESPACE, f"{tool.get('guid')}\x1f{cut}\x1f{rank}"))


def unique_name(name: str, taken: set[str]) -> str:
    """Return a name that no other preset of the tool has."""
    return next(n for k in range(1, len(taken) + 2) if (n := name if k == 1 else f"{name} ({k})") not in taken)


def _has_feeds(entry: object) -> bool:
    keys = ("v_f", "v_f_plunge")
    return isinstance(entry, dict) and all(isinstance(entry.get(k), int | float) and entry[k] > 0 for k in keys)


def preset(tool: Mapping[str, Any], point: OperatingPoint, name: str, guid: str) -> dict[str, Any]:
    """Return a preset in the units of the tool."""
    units = UNITS[str(tool.get("unit"))]
    geometry = tool["geometry"]
    like = next((p for p in tool["start-values"]["presets"] if _has_feeds(p)), None)
    speed, feed_per_tooth = point.spindle_speed_rpm, point.feed_per_tooth_mm / units.length
    feed = speed * geometry["NOF"] * feed_per_tooth
    plunge = feed * (like["v_f_plunge"] / like["v_f"] if like else _PLUNGE)
    return {
        "description": point.description,
        "f_n": plunge / speed,
        "f_z": feed_per_tooth,
        "guid": guid,
        "material": {"category": "all", "query": point.material, "use-hardness": False},
        "n": speed,
        "n_ramp": speed,
        "name": name,
        "ramp-angle": (like or {}).get("ramp-angle", _RAMP_ANGLE),
        "stepdown": point.depth_of_cut_mm / units.length,
        "stepover": point.width_of_cut_mm / units.length,
        "tool-coolant": (like or {}).get("tool-coolant", _COOLANT),
        "use-stepdown": True,
        "use-stepover": True,
        "v_c": math.pi * geometry["DC"] * units.length * speed / 1e3 / units.speed,
        "v_f": feed,
        "v_f_leadIn": feed,
        "v_f_leadOut": feed,
        "v_f_plunge": plunge,
        "v_f_ramp": plunge,
        "v_f_transition": feed,
    }
