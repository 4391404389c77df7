"""The section of the page on a diagnosis: verdict, causes, steps of the search, detectable effects, data audit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from smfe.reporting.content.style import number
from smfe.reporting.content.tables import Row, Table
from smfe.reporting.figures.plotly_diagnosis import condition_figure, search_figure, stable_depth_figure
from smfe.reporting.sections.draft import Draft

_WORDS = {
    "consistent": "nothing is wrong",
    "named": "named",
    "ambiguous": "open between several",
    "unknown": "unknown",
    "insufficient_data": "not enough data",
}


def section(draft: Draft) -> dict[str, Any]:
    """Return what ``finding.json`` says; empty when there is none."""
    finding, plots = draft.results.finding, draft.plots
    if not finding:
        return {}
    tables = [_causes(finding), _own(finding), _search(finding), _power(finding), _audit(finding)]
    figures = {
        "plot-search": search_figure,
        "plot-conditions": condition_figure,
        "plot-stable-depth": stable_depth_figure,
    }
    partly = finding.get("verdict") == "unknown" and finding.get("causes")
    found = {name: figure for name, make in figures.items() if (figure := make(finding)) is not None}
    plots.update(found)
    verdict = "partly found" if partly else _WORDS.get(str(finding.get("verdict")), str(finding.get("verdict")))
    return {
        "plots": list(found),
        "heading": f"What the simulation gets wrong: {verdict}",
        "verdict": verdict,
        "summary": list(finding.get("story", [])),
        "tables": [t for t in tables if t is not None],
    }


def _table(headers: Sequence[str], numeric: Sequence[bool], rows: Sequence[Row], summary: str) -> Table | None:
    return Table(tuple(headers), tuple(numeric), tuple(rows), summary) if rows else None


def _n(value: Any) -> str:
    return "–" if value is None else number(float(value))


def _unit(p: Mapping[str, Any]) -> str:
    return "" if p["unit"] == "1" else str(p["unit"])


def _causes(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row(
            (
                cause["title"] if i == 0 else "",
                p["name"],
                _n(p["value"]),
                "not separable from others" if None in (p["low"], p["high"]) else f"{_n(p['low'])} to {_n(p['high'])}",
                _unit(p),
            )
        )
        for cause in finding.get("causes", [])
        for i, p in enumerate(cause["parameters"])
    ]
    heads = ("cause", "parameter", "value", "95 % interval", "unit")
    return _table(heads, (False, False, True, True, False), rows, "What the best model adds to the baseline")


def _own(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row((p["name"], _n(p["given"]), _n(p["fitted"]), _n(p["spread"]), _unit(p)))
        for p in finding.get("baseline", [])
    ]
    heads = ("parameter", "given", "fitted", "sd with which it is trusted", "unit")
    return _table(heads, (False, True, True, True, False), rows, "The baseline's own parameters")


def _search(finding: Mapping[str, Any]) -> Table | None:
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
        Row((p["title"], p["parameter"], _n(p["size"]) if p["admissible"] else "not detectable", _unit(p)))
        for p in finding.get("power", [])
    ]
    heads = ("cause", "parameter", "size", "unit")
    return _table(heads, (False, False, True, False), rows, "An effect above this size is detected with 95 %")


def _audit(finding: Mapping[str, Any]) -> Table | None:
    rows = [Row((s["level"], s["cause"], s["where"], s["evidence"])) for s in finding.get("data_audit", [])]
    return _table(("level", "cause", "where", "evidence"), (False,) * 4, rows, "Data audit")
