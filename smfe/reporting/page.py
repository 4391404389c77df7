"""One HTML file from a folder of results."""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from smfe.reporting import conditions, diagnosis, draw_matplotlib, draw_plotly, drives, figures, spectrograms, tables
from smfe.reporting.headline import KEEP, Answer, answers, outcomes
from smfe.reporting.results import Lobes, Measurement, Results, bands, read_results
from smfe.reporting.style import METHODS, OUTCOMES, Line, band_text, number, palette
from smfe.results import FAILED, LOBES, MEASUREMENT, PREDICTION, TEST, write_atomically

Progress = Callable[[int, int], None]

_HERE = Path(__file__).parent


def write_report(folder: Path, progress: Progress | None = None) -> Path:
    """Write ``report.html`` and ``figures/*.png`` from the files of a folder of results.

    Parameters
    ----------
    folder : Path
        Folder that `smfe run` wrote. What a campaign did not ask for may be absent; the section then says so.
    progress : callable, optional
        Called with (done, of).

    Returns
    -------
    Path
        The report: one file that needs nothing else, and no network.

    Raises
    ------
    InputError
        When the folder does not exist or a file in it is corrupt.
    """
    folder = Path(folder)
    results = read_results(folder)
    looks = palette(results)
    pictures = draw_matplotlib.pictures(results, looks)
    steps = len(pictures) + 1
    draw_matplotlib.remove_stale(folder / "figures", pictures)
    for done, (name, draw) in enumerate(pictures.items(), 1):
        draw_matplotlib.save(draw(), folder / "figures" / name)
        if progress is not None:
            progress(done, steps)
    text = render(results, looks)
    path = write_atomically(folder / "report.html", lambda p: p.write_text(text, encoding="utf-8"))
    if progress is not None:
        progress(steps, steps)
    return path


def render(results: Results, looks: dict[str, Line]) -> str:
    """Return the page."""
    plots: dict[str, Any] = {}
    environment = Environment(
        loader=FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(n=number, bands=band_text)
    environment.globals["marks"] = OUTCOMES
    sections = {
        "headline": _headline(results),
        "lobes": _lobes(results, looks, plots),
        "spectra": _spectra(results, plots),
        "compliance": _compliance(results, looks, plots),
        "loops": drives.loop_section(results.loops, plots),
        "drives": drives.friction_section(results.drives, results.tables, plots),
        "comparison": _comparison(results),
        "diagnosis": diagnosis.section(results.finding, plots),
        "details": [tables.hits(f, f"{m}: {t}") for (m, t), f in results.tables.items() if not figures.is_friction(t)],
        "provenance": _provenance(results),
    }
    return environment.get_template("report.html.j2").render(
        title=results.title,
        alone=results.diagnosis_alone,
        warnings=results.warnings,
        failures=_failures(results),
        keep=round(100 * KEEP),
        **sections,
        css=Markup((_HERE / "static" / "report.css").read_text(encoding="utf-8")),
        script=Markup((_HERE / "static" / "report.js").read_text(encoding="utf-8")),
        plotly=Markup((_HERE / "static" / "plotly-cartesian.min.js").read_text(encoding="utf-8")),
        plots=Markup(_embedded(plots)),
        heights={name: plot["layout"]["height"] for name, plot in plots.items()},
    )


def _embedded(plots: dict[str, Any]) -> str:
    """Return JSON that cannot end the script element it stands in; the same array is written once."""
    arrays: dict[str, int] = {}

    def shared(part: Any) -> Any:
        if isinstance(part, dict):
            if "bdata" in part:
                return {"array": arrays.setdefault(json.dumps(part), len(arrays))}
            return {key: shared(value) for key, value in part.items()}
        return [shared(value) for value in part] if isinstance(part, list) else part

    content = {"plots": shared(plots), "arrays": []}
    content["arrays"] = [json.loads(text) for text in arrays]
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")


def _failures(results: Results) -> dict[str, list[dict[str, str]]]:
    """Return what failed by the section in which it would have stood."""
    section = {
        MEASUREMENT: "compliance",
        LOBES: "lobes",
        TEST: "tests",
        PREDICTION: "tests",
        "comparison": "comparison",
    }
    out: dict[str, list[dict[str, str]]] = {name: [] for name in ("all", *section.values(), "other")}
    for f in results.failures:
        row = {"what": f"{f.part} {f.name}".strip(), "reason": f.reason}
        out["all"].append(row)
        out[section.get(f.part, "other")].append(row)
    return out


def _headline(results: Results) -> list[dict[str, Any]]:
    """Return what the top of the page says, one block a request."""
    blocks: dict[str, list[Answer]] = {}
    for item in answers(results):
        blocks.setdefault(item.request, []).append(item)
    return [
        {
            "request": request,
            "cut": _cut_text(results, request),
            "answers": found,
            "spread": _spread(found),
            "sure": any(np.isfinite([p.low, p.safe]).any() for a in found for p in a.pockets),
            "edge": any(p.at_edge for a in found for p in a.pockets),
        }
        for request, found in blocks.items()
    ]


def _cut_text(results: Results, request: str) -> str:
    """Return e.g. "down milling, width of cut 100 mm, feed per tooth 0.2 mm, zero order"."""
    attrs = next(item.data.attrs for item in results.lobes if item.request == request)
    parts = [f"{attrs['cut']} milling"] if attrs.get("cut") else []
    for key, what in (("width_of_cut_mm", "width of cut"), ("feed_per_tooth_mm", "feed per tooth")):
        if key in attrs:
            parts.append(f"{what} {number(float(attrs[key]))} mm")
    if attrs.get("method"):
        parts.append(f"{str(attrs['method']).replace('_', '-')} method")
    return ", ".join(parts)


def _spread(found: list[Answer]) -> float | None:
    """Return the largest over the smallest of the sources' smallest limit depths, None for one source."""
    depths = [a.smallest for a in found if np.isfinite(a.smallest)]
    return max(depths) / min(depths) if len(depths) > 1 and min(depths) > 0.0 else None


def _lobes(results: Results, looks: dict[str, Line], plots: dict[str, Any]) -> list[dict[str, Any]]:
    out = []
    for position, (request, lobes) in enumerate(results.requests.items(), 1):
        tests = figures.tests_of(results.chatter, request)
        name = f"plot-lobes-{position}"
        plots[name] = draw_plotly.lobes_figure(lobes, tests, looks)
        out.append(
            {
                "request": request,
                "cut": _cut_text(results, request),
                "plot": name,
                "tests": 0 if tests is None else len(tests),
                "band": next((b[2] for item in lobes if (b := item.band()) is not None), ""),
                "unlimited": [(item.source, _unlimited(item)) for item in lobes if _unlimited(item)],
            }
        )
    return out


def _unlimited(item: Lobes) -> str:
    """Return the speeds without a limit, "" when there are none."""
    speed = item.data["spindle_speed"].values.astype(float)
    pairs = bands(speed, np.isinf(item.values("limit_depth")))
    return band_text(pairs).removesuffix(" Hz") + " rpm" if pairs else ""


def _spectra(results: Results, plots: dict[str, Any]) -> dict[str, Any]:
    tests = []
    end = figures.common_end(list(results.spectra.values()))
    for position, (key, dataset) in enumerate(results.spectra.items(), 1):
        name = f"plot-spectrum-{position}"
        plots[name] = draw_plotly.spectrum_figure(dataset, end)
        # A test that failed has a row in chatter.csv and no spectrum; the number says which row is meant.
        number_of = key.rpartition("_")[2]
        observed = _observed(results.chatter, int(number_of) - 1 if number_of.isdigit() else position - 1)
        picture = spectrograms.embedded(dataset, end) if spectrograms.pictured([dataset]) else ""
        tests.append({"plot": name, "picture": picture, "attrs": {**_NO_TEST, **dataset.attrs}, "observed": observed})
    found = []
    if results.chatter is not None:
        # Each reason stands below its spectrum.
        found = tables.cutting_tests(results.chatter.drop(columns="reason" if results.spectra else [], errors="ignore"))
    return {
        "tests": tests,
        "tables": found,
        "outside": _outside(results),
        "disagree": _disagreeing(results.chatter),
    }


_NO_TEST: dict[str, Any] = {
    "file": "cutting test",
    "spindle_speed_rpm": float("nan"),
    "depth_of_cut_mm": float("nan"),
    "verdict": "undecided",
    "ratio": float("nan"),
    "chatter_frequency_Hz": float("nan"),
    "reason": "",
}


def _observed(chatter: pd.DataFrame | None, row: int) -> str:
    """Return what the engineer observed in the test of a row of chatter.csv."""
    if chatter is None or "observed" not in chatter or row >= len(chatter):
        return ""
    value = chatter["observed"].iloc[row]
    return value if isinstance(value, str) else ""


def _outside(results: Results) -> int:
    """Return the number of cutting tests that stand on no diagram."""
    if results.chatter is None or not results.requests:
        return 0
    shown = [figures.tests_of(results.chatter, request) for request in results.requests]
    return len(results.chatter) - sum(len(t) for t in shown if t is not None)


def _disagreeing(chatter: pd.DataFrame | None) -> list[str]:
    """Return the files of tests in which the engineer observed something else than the criterion says."""
    if chatter is None:
        return []
    happened = outcomes(chatter)
    other = (happened != chatter["verdict"]) & ~chatter["verdict"].isin(["undecided", FAILED])
    return [str(f) for f in chatter["file"][other]]


def _compliance(results: Results, looks: dict[str, Line], plots: dict[str, Any]) -> dict[str, Any]:
    shown = [m for m in results.measurements if m.entries]
    if shown:
        plots["plot-compliance"] = draw_plotly.compliance_figure(shown, looks)
        quality = draw_plotly.quality_figure(shown, looks)
        if quality is not None:
            plots["plot-quality"] = quality
    return {
        "rows": [_measurement_row(m, looks[m.name]) for m in results.measurements],
        "any": bool(shown),
        "quality": "plot-quality" in plots,
        "by_force": any(e for m in shown for r in "xyz" for e, _ in m.coherences(r)),
        "cubes": _cubes(results, plots),
        "uncertain": any(m.std(*pair) is not None for m in shown for pair in m.entries),
        "conditions": [(m.name, draw_plotly.bad_bands_text(m)) for m in shown if m.condition() is not None],
    }


def _cubes(results: Results, plots: dict[str, Any]) -> list[dict[str, Any]]:
    """Return name, figure and sentences of each set of compliances over level and feed."""
    out = []
    for position, cube in enumerate(conditions.cubes(results.conditions), 1):
        name = f"plot-cube-{position}"
        plots[name] = draw_plotly.compliance_figure(cube.cells, cube.looks)
        out.append({"name": cube.name, "plot": name, "said": conditions.largest_changes(cube)})
    return out


def _measurement_row(m: Measurement, look: Line) -> dict[str, Any]:
    claimed = m.frequency[m.claimed()]
    coherence = [v[np.isfinite(v)] for r in "xyz" for _, v in m.coherences(r)]
    return {
        "name": m.name,
        "look": look,
        "method": METHODS.get(m.method, m.method) or "–",
        "conditions": ", ".join(f"{k.replace('_', ' ')}: {v}" for k, v in m.conditions.items()),
        "band": f"{number(claimed[0])}–{number(claimed[-1])}" if claimed.size else "–",
        "entries": " ".join(r + e for r, e in m.entries) or "none",
        "coherence": float(np.median(np.concatenate(coherence))) if coherence else float("nan"),
        "warnings": len(m.warnings),
    }


def _comparison(results: Results) -> dict[str, Any]:
    frame, errors = results.comparison, results.model_error
    sentences, table = ([], None) if frame is None or frame.empty else tables.comparison(frame)
    return {
        "sentences": sentences,
        "table": table,
        "compared": frame is not None,
        "explained": tables.explained(results.explained),
        "errors": [] if errors is None or errors.empty else tables.model_errors(errors),
    }


def _moment(text: str) -> str:
    """Return "2026-11-21 06:00 UTC" for a date and time in ISO 8601, any other text as it is."""
    try:
        moment = datetime.datetime.fromisoformat(text)
    except ValueError:
        return text
    return moment.strftime("%Y-%m-%d %H:%M %Z").strip()


def _provenance(results: Results) -> dict[str, Any]:
    """Return provenance with every part in the shape that the template takes."""
    content = results.provenance

    def pairs(name: str) -> dict[str, Any]:
        part = content.get(name, {})
        return part if isinstance(part, dict) else {"": part}

    inputs = content.get("inputs", [])
    return {
        "known": bool(content),
        "created": _moment(str(content.get("created", ""))),
        "versions": pairs("versions"),
        "seconds": pairs("seconds"),
        "settings": json.dumps(content["settings"], indent=2, ensure_ascii=False) if content.get("settings") else "",
        "inputs": [i for i in inputs if isinstance(i, dict)] if isinstance(inputs, list) else [],
    }
