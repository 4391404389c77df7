"""The story of a diagnosis: verdict, ladder of steps, causes with intervals, what would have been seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from smfe.report.look import number
from smfe.report.tables import Row, Table

_WORDS = {
    "consistent": "nothing is wrong",
    "named": "named",
    "ambiguous": "open between several",
    "unknown": "unknown",
    "insufficient_data": "not enough data",
}


def section(finding: Mapping[str, Any]) -> dict[str, Any]:
    """Return what the page shows of ``finding.json``; empty when there is none."""
    if not finding:
        return {}
    tables = [_causes(finding), _ladder(finding), _power(finding), _audit(finding)]
    return {
        "verdict": _WORDS.get(str(finding.get("verdict")), str(finding.get("verdict"))),
        "story": list(finding.get("story", [])),
        "tables": [t for t in tables if t is not None],
    }


def _table(headers: Sequence[str], numeric: Sequence[bool], rows: Sequence[Row], summary: str) -> Table | None:
    return Table(tuple(headers), tuple(numeric), tuple(rows), summary) if rows else None


def _n(value: Any) -> str:
    return "–" if value is None else number(float(value))


def _causes(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row(
            (
                cause["title"] if i == 0 else "",
                p["name"],
                _n(p["value"]),
                f"{_n(p['low'])} to {_n(p['high'])}",
                p["unit"],
            )
        )
        for cause in finding.get("causes", [])
        for i, p in enumerate(cause["parameters"])
    ]
    heads = ("cause", "parameter", "value", "95 % interval", "unit")
    return _table(heads, (False, False, True, True, False), rows, "What the best model adds to the baseline")


def _ladder(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row(
            (
                str(step["change"]),
                _n(step["misfit_db"]),
                _n(step["gain_db"]),
                _n(step["gain_sd_db"]),
                _n(step["ratio"]),
                _n(step["threshold"]),
                "kept" if step["accepted"] else str(step["reason"]),
            ),
            "" if step["accepted"] else "quiet",
        )
        for step in finding.get("ladder", [])
    ]
    heads = ("step", "misfit [dB]", "held-out gain [dB]", "its sd [dB]", "likelihood ratio", "threshold", "outcome")
    return _table(heads, (False, True, True, True, True, True, False), rows, "Steps of the search")


def _power(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row((p["title"], p["parameter"], _n(p["size"]) if p["admissible"] else "not seen", p["unit"]))
        for p in finding.get("power", [])
    ]
    heads = ("cause", "parameter", "size", "unit")
    return _table(heads, (False, False, True, False), rows, "What would have been seen with 95 %")


def _audit(finding: Mapping[str, Any]) -> Table | None:
    rows = [Row((s["level"], s["cause"], s["where"], s["evidence"])) for s in finding.get("data_audit", [])]
    return _table(("level", "cause", "where", "evidence"), (False,) * 4, rows, "Data audit")


def draw_ladder(finding: Mapping[str, Any]) -> Figure:
    """Draw the misfit over noise after every step that was kept."""
    before = float((finding.get("misfit_db") or {}).get("before") or 0.0)
    kept = [step for step in finding.get("ladder", []) if step["accepted"]]
    names = ["baseline", *(str(step["change"]) for step in kept)]
    heights = [before, *(float(step["misfit_db"]) for step in kept)]
    figure = Figure(figsize=(7.0, 0.9 + 0.45 * len(names)), layout="constrained")
    axes = figure.add_subplot()
    places = range(len(names))
    axes.barh(places, heights, color=["0.6", *["#3b6ea5"] * len(kept)], height=0.6)
    for place, height in zip(places, heights, strict=True):
        axes.text(height, place, f" {height:.2f} dB", va="center")
    axes.set_yticks(list(places), names)
    axes.invert_yaxis()
    axes.set_xlim(min(0.0, *heights), 1.15 * max(*heights, 0.1))
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("misfit over noise [dB]")
    axes.spines[["top", "right"]].set_visible(False)
    return figure
