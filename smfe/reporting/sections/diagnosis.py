"""The section of the page on a diagnosis: verdict and gain, what both models say, depths, what to do next, details."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from smfe.diagnosis.story.sentences import ABOUT
from smfe.diagnosis.story.words import in_words, parameter_words, percent, rounded, unit_text, with_interval
from smfe.reporting.content.style import number, spoken
from smfe.reporting.content.tables import Row, Table
from smfe.reporting.figures.compared import blocks
from smfe.reporting.figures.figure_data import STARTS
from smfe.reporting.figures.plotly_diagnosis import compared_figure, condition_figure, stable_depth_figure
from smfe.reporting.sections.draft import Draft

_ERRORS = ("error_before", "error_refitted", "error_after")

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
    compared = []
    for place, block in enumerate(blocks(draft.results.curves), 1):
        name = f"plot-compared-{place}"
        plots[name] = compared_figure(block)
        compared.append({"plot": name, "title": block.title, "note": block.note})
    figures = {"plot-stable-depth": stable_depth_figure, "plot-conditions": condition_figure}
    found = {name: figure for name, make in figures.items() if (figure := make(finding)) is not None}
    plots.update(found)
    partly = finding.get("verdict") == "unknown" and finding.get("causes")
    verdict = "partly found" if partly else _WORDS.get(str(finding.get("verdict")), str(finding.get("verdict")))
    tables = [_causes(finding), _own(finding), _search(finding), _conditions(finding), _power(finding), _audit(finding)]
    return {
        "plots": list(found),
        "heading": "What the simulation gets wrong",
        "verdict": verdict,
        "summary": list(finding.get("story", [])),
        "told": _told(finding),
        "given": _given(finding),
        "block": (finding.get("next_experiment") or {}).get("block", ""),
        "extended": {"file": "", "left_out": [], **(finding.get("extended") or {})},
        "compared": compared,
        "curves": draft.results.curves is not None,
        "ladder": _ladder(finding),
        "tables": [t for t in tables if t is not None],
    }


def _told(finding: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the sentences by what they are about; of a file without that, all of them first."""
    told: dict[str, list[str]] = {about: [] for about in ABOUT}
    for passage in finding.get("passages") or [{"about": "verdict", "text": t} for t in finding.get("story", [])]:
        told.setdefault(str(passage["about"]), []).append(str(passage["text"]))
    return told


def _given(finding: Mapping[str, Any]) -> Table | None:
    """Return what was declared beside what the data say of it, what they contradict first."""
    rows = [
        Row(
            (
                g["said"] or parameter_words(g["name"]),
                rounded(g["given"]),
                _estimate({**g, "value": g["found"]}),
                "" if g["cost"] is None else percent(g["cost"]),
                "" if g["cost_mm"] is None else rounded(g["cost_mm"], 2).replace("-", "−"),
                "no" if g["beyond"] else "yes",
            ),
            "" if g["beyond"] else "quiet",
        )
        for g in sorted(finding.get("given", []), key=lambda g: not g["beyond"])
    ]
    heads = ("what", "given", "found (95 % interval)", "changes the depth by [%]", "[mm]", "right")
    return _table(heads, (False, True, False, True, True, False), rows, "")


def _ladder(finding: Mapping[str, Any]) -> Table | None:
    """Return the steps that were kept: what is left after each, over noise, and what it gains on what was left out."""
    misfit = finding.get("misfit_db") or {}
    kept = [step for step in finding.get("ladder", []) if step["accepted"]]
    if not kept:
        return None
    rows = [Row((name, _tenths(misfit[key]), "")) for name, key in STARTS if misfit.get(key) is not None]
    for step in kept:
        gain = "" if step["gain_db"] is None else _tenths(step["gain_db"])
        rows.append(Row((str(step.get("words") or step["change"]), _tenths(step["misfit_db"]), gain)))
    return _table(("step", "error over noise [dB]", "gain where it was left out [dB]"), (False, True, True), rows, "")


def _tenths(value: float) -> str:
    return f"{value:.1f}".replace("-", "−")


def _conditions(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row(
            (
                spoken(str(c["name"])),
                "set aside" if c["held_out"] else "left out" if c.get("unseen") else "fitted",
                *("–" if c.get(k) is None else percent(c[k]) for k in _ERRORS),
                *("–" if c.get(k) is None else _tenths(c[k]) for k in ("before_db", "refitted_db", "after_db")),
            )
        )
        for c in finding.get("conditions", [])
        if c.get("error_before") is not None
    ]
    heads = (
        "condition",
        "how",
        "error of the simulation as declared [%]",
        "refitted [%]",
        "of the extended model [%]",
        "simulation as declared over noise [dB]",
        "refitted [dB]",
        "extended model over noise [dB]",
    )
    return _table(heads, (False, False, *[True] * 6), rows, "Error of each condition")


def _table(headers: Sequence[str], numeric: Sequence[bool], rows: Sequence[Row], summary: str) -> Table | None:
    return Table(tuple(headers), tuple(numeric), tuple(rows), summary) if rows else None


def _n(value: Any) -> str:
    return "–" if value is None else number(float(value))


def _unit(p: Mapping[str, Any]) -> str:
    return unit_text(str(p["unit"])).strip()


def _causes(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row((cause["title"] if i == 0 else "", parameter_words(p["name"]), _estimate(p)))
        for cause in finding.get("causes", [])
        for i, p in enumerate(cause["parameters"])
    ]
    heads = ("cause", "parameter", "value (95 % interval)")
    return _table(heads, (False, False, False), rows, "What the extended model adds to the simulation")


def _estimate(p: Mapping[str, Any]) -> str:
    """Return a parameter with its interval; the file has None where that is not finite."""
    low, high = (math.inf if p[key] is None else float(p[key]) for key in ("low", "high"))
    return with_interval(float(p["value"]), low, high, str(p["unit"]))


def _own(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row((parameter_words(p["name"]), *(rounded(p[k]) for k in ("given", "fitted", "spread")), _unit(p)))
        for p in finding.get("baseline", [])
    ]
    heads = ("parameter", "given", "fitted", "sd with which it is trusted", "unit")
    return _table(heads, (False, True, True, True, False), rows, "The simulation's own parameters")


def _search(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row(
            (
                str(step.get("words") or step["change"]),
                _n(step["misfit_db"]),
                _n(step["gain_db"]),
                _n(step["gain_sd_db"]),
                _n(step["ratio"]),
                _n(step["threshold"]),
                "kept" if step["accepted"] else in_words(str(step["reason"])),
            ),
            "" if step["accepted"] else "quiet",
        )
        for step in finding.get("ladder", [])
    ]
    heads = ("step", "misfit [dB]", "held-out gain [dB]", "its sd [dB]", "likelihood ratio", "threshold", "outcome")
    return _table(heads, (False, True, True, True, True, True, False), rows, "Steps of the search")


def _power(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row(
            (
                p["title"],
                parameter_words(p["parameter"]),
                rounded(p["size"], 2) if p["admissible"] else "not detectable",
                _unit(p),
            )
        )
        for p in finding.get("power", [])
    ]
    heads = ("cause", "parameter", "size", "unit")
    return _table(heads, (False, False, True, False), rows, "An effect above this size is detected with 95 %")


def _audit(finding: Mapping[str, Any]) -> Table | None:
    rows = [
        Row((s["level"], s["cause"].replace("_", " "), s["where"], s["evidence"]))
        for s in finding.get("data_audit", [])
    ]
    return _table(("level", "cause", "where", "evidence"), (False,) * 4, rows, "Data audit")
