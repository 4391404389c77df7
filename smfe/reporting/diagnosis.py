"""The story of a diagnosis: verdict, ladder, what is left of each condition, stable depth, detection power."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from smfe.reporting.draw_plotly import axis_look, base_layout, packed, plain
from smfe.reporting.style import literal, number
from smfe.reporting.tables import Row, Table

_WORDS = {
    "consistent": "nothing is wrong",
    "named": "named",
    "ambiguous": "open between several",
    "unknown": "unknown",
    "insufficient_data": "not enough data",
}


MOST = 30
"""Conditions that are shown, at most: those of which the extended model leaves most."""

_GREY, _BLUE = "#999999", "#0072B2"


def section(finding: Mapping[str, Any], plots: dict[str, Any]) -> dict[str, Any]:
    """Return what the page shows of ``finding.json``, its figures added to `plots`; empty when there is none."""
    if not finding:
        return {}
    tables = [_causes(finding), _own(finding), _ladder(finding), _power(finding), _audit(finding)]
    figures = {"plot-ladder": _ladder_plot, "plot-conditions": _condition_plot, "plot-stable-depth": _depth_plot}
    partly = finding.get("verdict") == "unknown" and finding.get("causes")
    found = {name: figure for name, make in figures.items() if (figure := make(finding)) is not None}
    plots.update(found)
    return {
        "plots": list(found),
        "verdict": "partly found" if partly else _WORDS.get(str(finding.get("verdict")), str(finding.get("verdict"))),
        "story": list(finding.get("story", [])),
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
                "not told from others" if None in (p["low"], p["high"]) else f"{_n(p['low'])} to {_n(p['high'])}",
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
        Row((p["title"], p["parameter"], _n(p["size"]) if p["admissible"] else "not seen", _unit(p)))
        for p in finding.get("power", [])
    ]
    heads = ("cause", "parameter", "size", "unit")
    return _table(heads, (False, False, True, False), rows, "An effect above this size would have been seen with 95 %")


def _audit(finding: Mapping[str, Any]) -> Table | None:
    rows = [Row((s["level"], s["cause"], s["where"], s["evidence"])) for s in finding.get("data_audit", [])]
    return _table(("level", "cause", "where", "evidence"), (False,) * 4, rows, "Data audit")


# --- figures: the same three, interactive and as a picture ---------------------------------------------------


def _steps(finding: Mapping[str, Any]) -> tuple[list[str], list[float]]:
    """Return the baseline and the steps that were kept, with their misfit over noise [dB]."""
    before = (finding.get("misfit_db") or {}).get("before")
    kept = [step for step in finding.get("ladder", []) if step["accepted"]]
    if before is None:
        return [], []
    names = ["baseline", *(str(step["change"]).replace("_", " ") for step in kept)]
    return names, [float(before), *(float(step["misfit_db"]) for step in kept)]


def _shown(finding: Mapping[str, Any]) -> tuple[list[Mapping[str, Any]], str]:
    """Return the conditions that are shown, in the order of the campaign, and what to call them."""
    every = [c for c in finding.get("conditions", []) if c["before_db"] is not None and c["after_db"] is not None]
    if finding.get("verdict") in ("consistent", None):
        return [], ""
    worst = sorted(every, key=lambda c: (-c["after_db"], -c["before_db"]))[:MOST]
    few = f" (the {len(worst)} of {len(every)} with most left)" if len(every) > len(worst) else ""
    return [c for c in every if c in worst], f"misfit of each condition over noise [dB]{few}"


def _models(finding: Mapping[str, Any]) -> list[tuple[str, str, str]]:
    """Return key, colour and name of the models whose misfit is shown: where nothing was found there is but one."""
    extended = [("after_db", _BLUE, "extended model")] if finding.get("causes") else []
    return [("before_db", _GREY, "baseline"), *extended]


def _depths(finding: Mapping[str, Any]) -> dict[str, list[Mapping[str, Any]]]:
    """Return the rows of stable depth by what asks for them, lobes only, at rising speed."""
    out: dict[str, list[Mapping[str, Any]]] = {}
    for row in finding.get("stable_depth", []):
        out.setdefault(str(row["where"]), []).append(row)
    return {where: rows for where, rows in out.items() if len(rows) > 1}


def _ladder_plot(finding: Mapping[str, Any]) -> dict[str, Any] | None:
    names, heights = _steps(finding)
    if len(names) < 2:
        return None
    bars = {
        "type": "bar",
        "orientation": "h",
        "x": heights,
        "y": [plain(n) for n in names],
        "marker": {"color": [_GREY, *[_BLUE] * (len(names) - 1)]},
        "text": [f"{h:.2f} dB" for h in heights],
        "textposition": "outside",
        "cliponaxis": False,
        "hoverinfo": "skip",
        "showlegend": False,
    }
    layout = base_layout(
        110 + 34 * len(names),
        xaxis=axis_look("misfit over noise [dB]", range=[min(0.0, *heights), 1.15 * max(heights)], zeroline=True),
        yaxis=axis_look(autorange="reversed", automargin=True, type="category"),
    )
    return {"data": [bars], "layout": layout}


def _condition_plot(finding: Mapping[str, Any]) -> dict[str, Any] | None:
    rows, title = _shown(finding)
    if not rows:
        return None
    names = [plain(str(c["name"])) for c in rows]
    data: list[dict[str, Any]] = []
    for key, colour, word in _models(finding):
        for held_out in sorted({bool(c["held_out"]) for c in rows}):
            pick = [i for i, c in enumerate(rows) if bool(c["held_out"]) == held_out]
            data.append(
                {
                    "type": "scatter",
                    "mode": "markers",
                    "name": f"{word}, set aside" if held_out else word,
                    "x": [float(rows[i][key]) for i in pick],
                    "y": [names[i] for i in pick],
                    "marker": {"color": colour, "size": 9, "symbol": "circle-open" if held_out else "circle"},
                }
            )
    layout = base_layout(
        130 + 22 * len(names),
        xaxis=axis_look(title, zeroline=True, zerolinecolor="#888"),
        yaxis=axis_look(
            autorange="reversed", automargin=True, type="category", categoryorder="array", categoryarray=names
        ),
    )
    return {"data": data, "layout": layout}


def _depth_plot(finding: Mapping[str, Any]) -> dict[str, Any] | None:
    data: list[dict[str, Any]] = []
    for where, rows in _depths(finding).items():
        speeds = [float(r["spindle_speed_rpm"]) for r in rows]
        for key, colour, word in (("before_mm", _GREY, "baseline"), ("after_mm", _BLUE, "extended model")):
            depths = [float("nan") if r[key] is None else float(r[key]) for r in rows]
            line = {"color": colour, "width": 4 if key == "before_mm" else 2}
            data.append(
                {
                    "type": "scatter",
                    "mode": "lines",
                    "name": f"{word}, {plain(where)}",
                    "x": packed(speeds),
                    "y": packed(depths),
                    "line": line,
                }
            )
    layout = base_layout(
        360,
        xaxis=axis_look("spindle speed [rpm]"),
        yaxis=axis_look("limit depth a<sub>p</sub> [mm]", rangemode="tozero"),
    )
    return {"data": data, "layout": layout} if data else None


def pictured(finding: Mapping[str, Any]) -> bool:
    """Return whether there is anything to draw."""
    return len(_steps(finding)[0]) > 1 or bool(_shown(finding)[0])


def draw(finding: Mapping[str, Any]) -> Figure:
    """Draw the ladder, what is left of each condition and the stable depth, one above the other."""
    names, _ = _steps(finding)
    rows, _ = _shown(finding)
    climbed = len(names) > 1
    heights = [0.9 + 0.32 * len(names)] * climbed
    heights += [1.1 + 0.22 * len(rows)] * bool(rows) + [3.0] * bool(_depths(finding))
    figure = Figure(figsize=(8.0, sum(heights)), layout="constrained")
    panels = figure.subplots(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    painters = [_draw_ladder] * climbed + [_draw_conditions] * bool(rows) + [_draw_depths] * bool(_depths(finding))
    for axes, paint in zip(panels, painters, strict=True):
        paint(axes, finding)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _draw_ladder(axes: Axes, finding: Mapping[str, Any]) -> None:
    names, heights = _steps(finding)
    places = range(len(names))
    axes.barh(places, heights, color=[_GREY, *[_BLUE] * (len(names) - 1)], height=0.6)
    for place, height in zip(places, heights, strict=True):
        axes.text(max(height, 0.0), place, f" {height:.2f} dB", va="center")
    axes.set_yticks(list(places), names)
    axes.invert_yaxis()
    axes.set_xlim(min(0.0, *heights), 1.15 * max(*heights, 0.1))
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.set_xlabel("misfit over noise [dB], step by step")


def _draw_conditions(axes: Axes, finding: Mapping[str, Any]) -> None:
    rows, title = _shown(finding)
    for key, colour, word in _models(finding):
        for held_out in sorted({bool(c["held_out"]) for c in rows}):
            pick = [i for i, c in enumerate(rows) if bool(c["held_out"]) == held_out]
            axes.plot(
                [rows[i][key] for i in pick],
                pick,
                "o",
                color=colour,
                fillstyle="none" if held_out else "full",
                label=f"{word}, set aside" if held_out else word,
            )
    axes.set_yticks(range(len(rows)), [literal(str(c["name"])) for c in rows], fontsize="small")
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.axvline(0.0, color="black", linewidth=0.8)
    axes.grid(axis="y", color="0.93")
    axes.set_axisbelow(True)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize="small", frameon=False)
    axes.set_xlabel(title)


def _draw_depths(axes: Axes, finding: Mapping[str, Any]) -> None:
    for (where, rows), style in zip(_depths(finding).items(), ("-", "--", ":", "-.") * 8, strict=False):
        speeds = [r["spindle_speed_rpm"] for r in rows]
        for key, colour, word in (("before_mm", _GREY, "baseline"), ("after_mm", _BLUE, "extended model")):
            depths = [float("nan") if r[key] is None else r[key] for r in rows]
            wide = 3.5 if key == "before_mm" else 1.5  # where nothing changes both are seen
            axes.plot(speeds, depths, style, color=colour, linewidth=wide, label=f"{word}, {literal(where)}")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("spindle speed [rpm]")
    axes.set_ylabel("limit depth [mm]")
    axes.legend(fontsize="small", frameon=False)
