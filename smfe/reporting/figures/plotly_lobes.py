"""Lobes with their cutting tests, interactive."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from process.types import Real
from smfe.reporting.content.headline import outcomes
from smfe.reporting.content.results import Lobes
from smfe.reporting.content.style import ADVICE, CHATTER, SAFE_DASH, STABLE, Line, number, spoken, translucent
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.lobe_data import KICKED, LONGEST_NAME, SAFE, Diagram, advice_name, diagram, single_lobes
from smfe.reporting.figures.plotly_frame import Figure, axis_look, base_layout, filled, packed, plain, polygons, scatter

HEIGHT = 500
_POINTS = ("square", "diamond", "triangle-down", "triangle-up", "circle")
"""Marks of sources where they are points, not lines."""

_LABEL = 17
"""Height of a label at the end of a line [px]."""

_SYMBOLS = {
    "stable": {"symbol": "circle", "color": "#000", "size": 10},
    "chatter": {"symbol": "x", "color": CHATTER, "size": 11, "line": {"width": 1, "color": "#fff"}},
    "undecided": {"symbol": "triangle-up-open", "color": "#000", "size": 11, "line": {"width": 2}},
}


def lobes_figure(
    lobes: Sequence[Lobes],
    tests: pd.DataFrame | None,
    looks: Mapping[str, Line],
    advice: Mapping[str, Any] | None = None,
) -> Figure:
    """Return limit depth over speed: stable and chatter shaded, safe curve, cutting tests, the recommended cut."""
    shown = diagram(lobes, tests, advice)
    data = [*_regions(shown), *_main_traces(shown, looks[shown.main.source])]
    # Thinner and on top: where sources agree, the broken lines are seen on the thick one.
    data += [_limit_trace(item, looks[item.source], 1.9) for item in lobes if item is not shown.main]
    if not shown.single:
        pairs = [(item, item.lower()) for item in lobes]
        data += [_kicked_trace(item, lower, looks[item.source]) for item, lower in pairs if lower is not None]
    if shown.safe is not None:
        data.append(_safe_trace(shown.safe))
    if shown.single:
        lines = [trace for trace in data if trace["type"] == "scatter" and trace.get("name")]
        for trace, symbol in zip(lines, _POINTS * len(lines), strict=False):
            trace["mode"] = "markers"
            trace["marker"] = {"size": 10, "symbol": symbol, "color": trace.pop("line")["color"]}
    if tests is not None:
        data += _test_traces(tests)
    if shown.point is not None:
        data.append(_advice(shown.point))
    layout = base_layout(
        HEIGHT,
        margin={"l": 58, "r": 20 if shown.single else 150, "t": 10, "b": 46},
        xaxis=axis_look("spindle speed [rpm]", range=list(shown.span)),
        yaxis=axis_look("depth of cut a<sub>p</sub> [mm]", range=[0.0, shown.top]),
        barmode="overlay",
        annotations=[*_words(shown, tests), *_names(shown, looks), *_arrow(shown)],
    )
    return {"data": data, "layout": layout, "narrow": {"height": 380}, "paper": {"height": 370}}


def _regions(shown: Diagram) -> list[Figure]:
    """Return the shading: stable below the safe curve, chatter above the limit, neither between them."""
    if shown.single:
        bars = {"type": "bar", "x": packed(shown.speed), "width": shown.width, "hoverinfo": "skip"}
        stable = {"y": packed(shown.floor), "marker": {"color": translucent(STABLE, 0.22)}, "name": "stable"}
        chatter = {"y": packed(shown.top - shown.limit), "base": packed(shown.limit), "name": "chatter"}
        return [
            {**bars, **stable, "legendgroup": "below"},
            {**bars, **chatter, "legendgroup": "above", "marker": {"color": translucent(CHATTER, 0.18)}},
        ]
    speed, zero, top = shown.speed, np.zeros_like(shown.floor), np.full_like(shown.limit, shown.top)
    group = {"legendgroup": shown.main.source}
    return [
        filled(polygons(speed, zero, shown.floor), STABLE, 0.13, group),
        filled(polygons(speed, shown.limit, top), CHATTER, 0.10, group),
    ]


def _main_traces(shown: Diagram, look: Line) -> list[Figure]:
    """Return the source of the answer: band, single lobes and limit."""
    item, out = shown.main, []
    band = item.band()
    if shown.single:
        trace = _limit_trace(item, look, 3.4)
        if band is not None:
            limit = figure_data.finite_depth(item)
            trace["error_y"] = {
                **{"type": "data", "array": packed(band[1] - limit), "arrayminus": packed(limit - band[0])},
                **{"symmetric": False, "color": look.colour, "thickness": 1.5},
            }
        return [trace]
    if band is not None:
        low, high = (np.minimum(v, 1.2 * shown.top) for v in band[:2])
        out.append(filled(polygons(shown.speed, low, high), look.colour, 0.22, {"legendgroup": item.source}))
    single = single_lobes(item, shown.span, shown.top)
    if single is not None:
        thin = {"width": 0.7, "color": translucent(look.colour, 0.5)}
        hidden = {"hoverinfo": "skip", "showlegend": False, "legendgroup": item.source}
        out.append({**scatter("lines", *single), **hidden, "line": thin})
    return [*out, _limit_trace(item, look, 3.4)]


def _safe_trace(curve: tuple[Real, Real]) -> Figure:
    return {
        **scatter("lines", *curve),
        "name": SAFE,
        "legendgroup": SAFE,
        "line": {"width": 1.5, "color": "#000", "dash": SAFE_DASH},
        "hovertemplate": "%{x:.5~g} rpm<br>safe depth %{y:.4~g} mm",
    }


def _kicked_trace(item: Lobes, lower: Real, look: Line) -> Figure:
    """Return the lower limit of an operating point, with the kick that leads to it."""
    return {
        **scatter("lines+markers", item.data["spindle_speed"].values.astype(float), lower),
        "name": plain(f"{spoken(item.source)}: {KICKED}"),
        "legendgroup": f"{item.source}: {KICKED}",
        "customdata": packed(item.values("kick")),
        "hovertemplate": f"%{{x:.5~g}} rpm<br>{KICKED} %{{y:.4~g}} mm<br>kick %{{customdata:.3~g}} N s",
        # A source may be dashed itself: a few rings tell the two.
        "marker": {"symbol": "circle-open", "size": 6, "color": look.colour, "maxdisplayed": 12},
        "line": {"width": 1.5, "color": look.colour, "dash": "dash"},
    }


def _limit_trace(item: Lobes, look: Line, width: float) -> Figure:
    finite, lobe = figure_data.finite_depth(item), item.values("lobe")
    frequency = item.values("chatter_frequency")
    return {
        **scatter("lines", item.data["spindle_speed"].values.astype(float), finite),
        "name": plain(spoken(item.source)),
        "legendgroup": item.source,
        "customdata": packed(np.column_stack([frequency, np.where(lobe >= 0, lobe, np.nan)])),
        "hovertemplate": "%{x:.5~g} rpm<br>limit depth %{y:.4~g} mm<br>"
        "chatter frequency %{customdata[0]:.4~g} Hz<br>lobe %{customdata[1]:.0f}",
        "line": {"width": width, "color": look.colour, "dash": look.dash},
    }


def _advice(point: tuple[float, float, str]) -> Figure:
    speed, depth, text = point
    marker = {"symbol": "star", "size": 19, "color": ADVICE, "line": {"color": "#000", "width": 1.5}}
    return {
        **{
            "type": "scatter",
            "mode": "markers",
            "x": [speed],
            "y": [depth],
            "name": advice_name(text),
            "marker": marker,
        },
        "hovertemplate": f"{plain(text)}<extra></extra>",
    }


def _arrow(shown: Diagram) -> list[Figure]:
    """Return what is written at the recommended cut, beside it where there is more room."""
    if shown.point is None:
        return []
    speed, depth, text = shown.point
    left = speed > 0.5 * (shown.span[0] + shown.span[1])
    place = {"x": speed, "y": depth, "ax": -75 if left else 75, "ay": 34, "xanchor": "right" if left else "left"}
    look = {"bgcolor": "rgba(255,255,255,0.92)", "bordercolor": "#000", "borderpad": 3, "font": {"size": 14}}
    return [{**place, **look, "text": f"<b>{plain(text)}</b>", "showarrow": True, "arrowhead": 2, "standoff": 9}]


def _words(shown: Diagram, tests: pd.DataFrame | None) -> list[Figure]:
    look = {"showarrow": False, "font": {"size": 16, "color": "#444"}}
    return [{**look, "x": x, "y": y, "text": word} for word, (x, y) in shown.places(tests).items()]


def _names(shown: Diagram, looks: Mapping[str, Line]) -> list[Figure]:
    """Return the names at the ends of the lines, with a thin line to each end."""
    room = _LABEL / (HEIGHT - 56)
    out = []
    for source, text, end, place in shown.ends(room):
        name = text if len(text) <= LONGEST_NAME else f"{text[: LONGEST_NAME - 1]}…"
        out.append(
            {
                **{"x": 1.0, "xref": "paper", "y": end, "xanchor": "left", "align": "left", "text": plain(name)},
                **{"ax": 24, "ay": -(place - end) / shown.top * (HEIGHT - 56), "showarrow": True, "arrowhead": 0},
                **{
                    "arrowwidth": 1,
                    "arrowcolor": "#000" if text == SAFE else looks[source].colour,
                    "font": {"size": 12, "color": "#222"},
                },
                **{"wide": True, "group": text if text == SAFE else source},
            }
        )
    return out


def chatter_figure(lobes: Sequence[Lobes], tests: pd.DataFrame | None, looks: Mapping[str, Line]) -> Figure | None:
    """Return the chatter frequency over speed; None where none is known."""
    ends = figure_data.chatter_range(lobes)
    if ends is None:
        return None
    data: list[Figure] = []
    for item, symbol in zip(lobes, _POINTS * len(lobes), strict=False):
        data.append(
            {
                **scatter("markers", item.data["spindle_speed"].values.astype(float), item.values("chatter_frequency")),
                "name": plain(spoken(item.source)),
                "marker": {"size": 5, "symbol": symbol, "color": looks[item.source].colour},
                "hovertemplate": "%{x:.5~g} rpm: %{y:.4~g} Hz",
            }
        )
    if tests is not None and "chatter_frequency_Hz" in tests:
        rows = tests[(outcomes(tests) == "chatter") & np.isfinite(tests["chatter_frequency_Hz"].to_numpy(dtype=float))]
        if not rows.empty:
            data.append(
                {
                    **scatter("markers", rows["spindle_speed_rpm"], rows["chatter_frequency_Hz"]),
                    "name": "cutting test: chatter",
                    "marker": _SYMBOLS["chatter"],
                    "text": [_test_text(row) for row in rows.to_dict("records")],
                    "hovertemplate": "%{text}<extra></extra>",
                }
            )
    layout = base_layout(
        300,
        xaxis=axis_look("spindle speed [rpm]", range=list(figure_data.speed_range(lobes))),
        yaxis=axis_look("chatter frequency [Hz]", range=list(ends)),
    )
    return {"data": data, "layout": layout}


def _test_traces(tests: pd.DataFrame) -> list[Figure]:
    """Return the cutting tests by outcome."""
    happened = outcomes(tests)
    out: list[Figure] = []
    for outcome, marker in _SYMBOLS.items():
        rows = tests[happened == outcome]
        if rows.empty:
            continue
        shared = {
            "type": "scatter",
            "mode": "markers",
            "marker": marker,
            "x": packed(rows["spindle_speed_rpm"]),
            "name": f"cutting test: {outcome}",
            "legendgroup": outcome,
            "text": [_test_text(row) for row in rows.to_dict("records")],
            "hovertemplate": "%{text}<extra></extra>",
        }
        out.append({**shared, "y": packed(rows["depth_of_cut_mm"])})
    return out


def _test_text(row: Mapping[Any, Any]) -> str:
    lines = [
        plain(str(row["file"])),
        f"{number(row['spindle_speed_rpm'])} rpm, depth {number(row['depth_of_cut_mm'])} mm",
        f"verdict: {plain(str(row['verdict']))}",
    ]
    if isinstance(row.get("observed"), str) and row["observed"]:
        lines.append(f"observed: {plain(row['observed'])}")
    said = [(key, row.get(key)) for key in ("controller", "position")]
    lines += [f"{key}: {plain(value)}" for key, value in said if isinstance(value, str) and value]
    if np.isfinite(row.get("chatter_frequency_Hz", np.nan)):
        lines.append(f"line at {number(row['chatter_frequency_Hz'])} Hz")
    return "<br>".join(lines)
