"""The recommendation in words: what `smfe.limits.recommendation` found, neither computed nor chosen again."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from smfe.reporting.content.headline import score
from smfe.reporting.content.results import Lobes, Results
from smfe.reporting.content.style import METHODS, number, spoken, with_range
from smfe.reporting.content.tables import Row, Table, true
from stability.tables.pockets import lowest_about
from stability.tables.presets import milling

Advice = Mapping[str, Any]

RECOMMENDED, LIMIT_ONLY = "recommended", "limit_only"


@dataclass(frozen=True)
class Tile:
    """A number in large type: what it is, the number, its unit."""

    name: str
    value: str
    unit: str


def attributes(advice: Advice) -> dict[str, str]:
    """Return the recommendation as data attributes of an element: the keys with hyphens, what is null left out."""
    found = {k: v for k, v in advice.items() if v is not None}
    return {
        f"data-{key.replace('_', '-').lower()}": value if isinstance(value, str) else json.dumps(value)
        for key, value in found.items()
    }


def subject(results: Results) -> list[tuple[str, str]]:
    """Return what the page is about: ("Machine", name), ("Tool", ...), ("Material", ...), ("Cut", ...)."""
    best = results.best
    if not best:
        return []
    cuts = dict.fromkeys(cut_text(a) for a in results.advice.values())
    parts = [
        ("Machine", "" if best["machine"] == results.title else best["machine"]),
        ("Tool", tool_text(best["tool"])),
        ("Material", best["material"]),
        ("Cut", next(iter(cuts)) if len(cuts) == 1 else f"{len(cuts)} kinds, below"),
    ]
    return [(name, str(text)) for name, text in parts if text]


def tool_text(tool: Mapping[str, Any]) -> str:
    """Return "80 mm, 2 teeth, approach angle 45°"."""
    angle = tool.get("approach_angle_deg")
    return str(tool["name"]) + (f", approach angle {number(angle)}°" if angle and angle != 90.0 else "")


def cut_text(advice: Advice) -> str:
    """Return "down milling, 40 mm wide, 0.1 mm per tooth"."""
    width, feed = number(advice["width_of_cut_mm"]), number(advice["feed_per_tooth_mm"])
    return f"{milling(advice['cut'])}, {width} mm wide, {feed} mm per tooth"


def cut_name(results: Results, request: str) -> str:
    """Return the cut of a request in words; where another request has the same (its feed is another), its name too."""
    found = results.advice.get(request)
    if not found:
        return request
    text = cut_text(found)
    alike = [name for name, other in results.advice.items() if cut_text(other) == text]
    return text if len(alike) == 1 else f"{text} ({spoken(request)})"


def tiles(advice: Advice) -> list[Tile]:
    """Return the numbers that are typed into the machine."""
    if advice["spindle_speed_rpm"] is None:
        return []
    sure = advice["status"] == RECOMMENDED
    depth = number(advice["depth_of_cut_mm"]) if sure else number(advice["limit_depth_mm"], 3)
    return [
        Tile("Spindle speed", number(advice["spindle_speed_rpm"]), "rpm"),
        Tile("Depth of cut" if sure else "Limit depth", depth, "mm"),
        Tile("Feed", number(advice["feed_mm_min"]), "mm/min"),
        Tile("Width of cut", number(advice["width_of_cut_mm"]), "mm"),
    ]


def headline(advice: Advice) -> str:
    """Return how sure it is, in few words."""
    if advice["status"] == RECOMMENDED:
        return f"At least {100.0 * advice['probability']:.3g} % sure to be stable"
    if advice["status"] == LIMIT_ONLY:
        known = advice["limit_depth_p05_mm"] is not None
        return "Limit; no depth is called safe" if known else "Limit, uncertainty unknown: no safe depth is given"
    return "No cut can be recommended"


def details(advice: Advice) -> list[tuple[str, str]]:
    """Return what stands in smaller type: name and text."""
    out = []
    if advice["removal_rate_cm3_min"] is not None:
        out.append(("Removal rate", f"{number(advice['removal_rate_cm3_min'])} cm³/min"))
    if advice["cutting_speed_m_min"] is not None:
        out.append(("Cutting speed", f"{number(advice['cutting_speed_m_min'])} m/min"))
    if advice["speed_from_rpm"] is not None:
        out.append(("Holds from", f"{number(advice['speed_from_rpm'])} to {number(advice['speed_to_rpm'])} rpm"))
    if advice.get("limited_by"):
        out.append(("Limited by", str(advice["limited_by"])))
    if advice["limit_depth_mm"] is not None:
        value, between = with_range(*(advice[f"limit_depth{end}_mm"] for end in ("", "_p05", "_p95")))
        # A limit without a depth stands above in large type.
        said = [f"{value} mm"] if advice["status"] == RECOMMENDED else []
        said += [f"5 % to 95 %: {between} mm"] if between else []
        out += [("Limit depth", ", ".join(said))] if said else []
    if advice["chatter_frequency_Hz"] is not None:
        out.append(("Chatter beyond it", f"at {number(advice['chatter_frequency_Hz'], 3)} Hz"))
    out.append(("Source", f"{spoken(advice['source'])}, {str(advice['method']).replace('_', ' ')} lobes"))
    return out


def sources(results: Results, lobes: Sequence[Lobes], advice: Advice | None) -> Table:
    """Return the table of the sources of a request: the limit at the recommended speed and at any, tests foretold."""
    speed = advice.get("spindle_speed_rpm") if advice else None
    kinds = {m.name: METHODS.get(m.method, m.method) for m in results.measurements}
    accuracy = max((float(item.data.attrs.get("spindle_accuracy", 0.0)) for item in lobes), default=0.0)
    about = f"within {100.0 * accuracy:g} % of" if accuracy else "at"
    heads = ["source", "how", *([f"limit {about} {number(speed)} rpm [mm]", "5 % to 95 % [mm]"] if speed else [])]
    heads += ["smallest limit [mm]", "smallest safe depth [mm]", "cutting tests foretold"]
    rows = []
    for item in lobes:
        table = item.table
        cells = [spoken(item.source), kinds.get(item.source) or "–"]
        if speed:
            cells += _limit(lowest_about(table, "limit_depth_mm", speed, accuracy))
        cells += [_smallest(table, "limit_depth_mm"), _smallest(table, "safe_depth_mm")]
        found = score(results.chatter, item.request, item.source)
        cells.append("–" if found is None else f"{found.right} of {found.of}")
        if found is not None and found.unsafe:
            cells[-1] += f"; {found.unsafe} chattered where it says stable"
        rows.append(Row(tuple(cells), "advised" if advice and item.source == advice["source"] else ""))
    numeric = (False, False, *((True, True) if speed else ()), True, True, False)
    return Table(tuple(heads), numeric, tuple(rows), "Sources")


def _limit(row: pd.Series) -> tuple[str, str]:
    value, low, high = (
        float(row[n]) if n in row else float("nan")
        for n in ("limit_depth_mm", "limit_depth_p05_mm", "limit_depth_p95_mm")
    )
    text, between = with_range(value, low, high)
    return "no limit found" if np.isinf(value) else text if between else number(value, 3), between or "not known"


def _smallest(table: pd.DataFrame, column: str) -> str:
    """Return the smallest value; "not known" where it is unknown at any speed with a limit."""
    if column not in table:
        return "not known"
    values = table[column].to_numpy(dtype=float)
    limited = np.isfinite(table["limit_depth_mm"].to_numpy(dtype=float))
    if not limited.any():
        return "no limit found"
    return number(float(values[limited].min()), 3) if np.isfinite(values[limited]).all() else "not known"


_WIDTH = re.compile(r"depth_(.+)mm_mm")


def depths(results: Results) -> list[Table]:
    """Return depth over speed and width of cut, one table a request with several widths, as depth_table.csv has it."""
    found = results.depths
    if found is None:
        return []
    out = []
    for _, rows in found.groupby("lobes", sort=False):
        widths = {c: m[1] for c in map(str, rows) if (m := _WIDTH.fullmatch(c)) and rows[c].notna().any()}
        columns = {"spindle_speed_rpm": "spindle speed [rpm]", "feed_mm_min": "feed [mm/min]"}
        columns |= {c: f"{w} mm wide" for c, w in widths.items()}
        columns |= {"best_width_of_cut_mm": "best width [mm]", "removal_rate_cm3_min": "removal rate [cm³/min]"}
        cells = [tuple(number(v) for v in row) for row in rows[list(columns)].itertuples(index=False)]
        best = rows["removal_rate_cm3_min"].to_numpy(dtype=float).argmax()
        lines = tuple(Row(row, "advised" if k == best else "") for k, row in enumerate(cells))
        title = f"Depth of cut [mm] over spindle speed and width of cut, from {rows['source'].iloc[0]}"
        out.append(Table(tuple(columns.values()), (True,) * len(columns), lines, title))
    return out


_POCKETS = {
    "source": "source",
    "spindle_speed_rpm": "spindle speed [rpm]",
    "depth_of_cut_mm": "depth of cut [mm]",
    "limit_depth_mm": "limit depth [mm]",
    "between": "5 % to 95 % [mm]",
    "removal_rate_cm3_min": "removal rate [cm³/min]",
    "range": "holds from–to [rpm]",
    "chatter_frequency_Hz": "chatter frequency [Hz]",
    "limited_by": "limited by",
    "note": "note",
}


def pockets(results: Results, request: str) -> Table | None:
    """Return the table of the pockets of a request, as pockets.csv has them; None without any."""
    found = results.pockets
    if found is None or not {"lobes", "depth_of_cut_mm", "at_edge", "recommended"} <= set(found):
        return None
    rows = found[found["lobes"] == request]
    columns = {name: title for name, title in _POCKETS.items() if name != "limited_by" or name in found}
    out = []
    for row in rows.to_dict("records"):
        text, between = with_range(*(row.get(f"limit_depth{end}_mm") for end in ("", "_p05", "_p95")))
        advised, edge = true(row["recommended"]), true(row["at_edge"])
        note = "recommended" if advised else "end of the range" if edge else ""
        text = text if between else number(row.get("limit_depth_mm"), 3)
        cells = {**row, "limit_depth_mm": text, "between": between or "not known", "note": note}
        cells["source"] = spoken(str(row["source"]))
        cells["range"] = f"{number(row['speed_from_rpm'])}–{number(row['speed_to_rpm'])}"
        cells["chatter_frequency_Hz"] = number(row["chatter_frequency_Hz"], 3)
        out.append(Row(tuple(number(cells[name]) for name in columns), "advised" if advised else ""))
    numeric = tuple(name not in ("source", "limited_by", "note") for name in columns)
    return Table(tuple(columns.values()), numeric, tuple(out), "Pockets") if out else None
