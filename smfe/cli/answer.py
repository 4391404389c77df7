"""The lines that matter of a folder of results, from its small files alone: no numerics are imported."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smfe.cli.terminal import Outcome

if TYPE_CHECKING:
    from smfe.results import Failures


def run_outcome(report_file: Path) -> Outcome:
    """Return what a run found: recommendation, cutting tests, diagnosis, warnings, where the report is.

    Parameters
    ----------
    report_file : Path
        The report, beside the other results.
    """
    folder = report_file.parent
    kept = _json(folder / "provenance.json")
    presets, finding = _json(folder / "presets.json"), _json(folder / "finding.json")
    recommendation = presets.get("recommendation")
    failures = _failures(kept)
    warnings = [str(w) for w in kept.get("warnings", [])]
    faults = [row for row in kept.get("check", []) if row.get("level") == "fault"]
    lines = [
        recommended(recommendation),
        tested(folder / "chatter.csv"),
        diagnosed(finding),
        warned(warnings, recommendation),
        f"report: {report_file}",
    ]
    content: dict[str, Any] = {"recommendation": recommendation, "report": str(report_file)}
    if "recommendations" in presets:
        content["recommendations"] = presets["recommendations"]
    if finding:
        content["finding"] = {key: finding.get(key) for key in ("verdict", "summary")}
    return Outcome([line for line in lines if line], content, warnings, failures, bool(faults), counted=True)


def recommended(found: Mapping[str, Any] | None) -> str:
    """Return the recommendation as a line."""
    if not found:
        return ""
    speed, limit = found.get("spindle_speed_rpm"), found.get("limit_depth_mm")
    why = f": {found['reason']}" if found.get("reason") else ""
    match found.get("status"):
        case "recommended":
            parts = [f"{speed:g} rpm, {found['depth_of_cut_mm']:g} mm deep", *_cut(found)]
            if (sure := found.get("probability")) is not None:
                parts.append(f"stable with {100 * sure:.0f} %")
            return f"recommended: {', '.join(parts)}{why}"
        case "limit_only" if speed is not None and limit is not None:
            kind = "limit, uncertainty unknown" if found.get("limit_depth_p05_mm") is None else "limit alone"
            parts = [f"{limit:.3g} mm at {speed:g} rpm", *_cut(found)]
            return f"{kind}: {', '.join(parts)}; no safe depth is given{why}"
    return f"no recommendation{why}"


def _cut(found: Mapping[str, Any]) -> list[str]:
    """Return width, feed and removal rate, as far as they are known."""
    units = {"width_of_cut_mm": "mm wide", "feed_mm_min": "mm/min", "removal_rate_cm3_min": "cm³/min"}
    return [f"{found[key]:.4g} {unit}" for key, unit in units.items() if found.get(key) is not None]


def tested(file: Path) -> str:
    """Return how the cutting tests agree with what was predicted, "" where there is none."""
    if not file.is_file():
        return ""
    with file.open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    known = [(r.get("observed") or r.get("verdict", ""), r) for r in rows]
    known = [(happened, r) for happened, r in known if happened in ("stable", "chatter")]
    counts = [f"{sum(h == what for h, _ in known)} {what}" for what in ("stable", "chatter")]
    if len(known) < len(rows):
        counts.append(f"{len(rows) - len(known)} undecided or failed")
    said = f"cutting tests: {', '.join(counts)}"
    sources = [c.removeprefix("predicted_") for c in (rows[0] if rows else {}) if c.startswith("predicted_")]
    shares = []
    for source in sources:
        predicted = [(h, r[f"predicted_{source}"]) for h, r in known]
        predicted = [(h, p) for h, p in predicted if p in ("stable", "chatter")]
        if predicted:
            shares.append(f"{source.replace('_', ' ')} {sum(h == p for h, p in predicted)} of {len(predicted)}")
    return said + (f"; predicted rightly: {', '.join(shares)}" if shares else "")


def diagnosed(finding: Mapping[str, Any]) -> str:
    """Return the sentence of a finding that is its verdict, "" where there is none."""
    told = [p["text"] for p in finding.get("passages") or [] if p.get("about") == "verdict"]
    summary = told or finding.get("summary") or []
    return f"diagnosis: {summary[0]}" if summary else ""


def warned(warnings: list[str], recommendation: Mapping[str, Any] | None) -> str:
    """Return how many warnings there are and the most important: one about what is recommended comes first."""
    if not warnings:
        return "no warnings"
    source = str((recommendation or {}).get("source", ""))
    about = [w for w in warnings if source and source in w.partition(": ")[0]]
    more = "" if len(warnings) == 1 else f" (all: -v, report); the first: {(about or warnings)[0]}"
    return f"1 warning: {warnings[0]}" if len(warnings) == 1 else f"{len(warnings)} warnings{more}"


def _failures(kept: Mapping[str, Any]) -> Failures:
    """Return what failed; the module of results, which imports numerics, is asked only where something did."""
    if not kept.get("failures"):
        return []
    from smfe.results import unpack

    return unpack(kept)


def _json(file: Path) -> dict[str, Any]:
    if not file.is_file():
        return {}
    found = json.loads(file.read_text(encoding="utf-8"))
    return found if isinstance(found, dict) else {}
