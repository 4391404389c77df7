"""One HTML file from a folder of results."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from smfe.reporting.content.advice import subject
from smfe.reporting.content.merging import sentence
from smfe.reporting.content.results import Results, read_results
from smfe.reporting.content.style import OUTCOMES, band_text, number, palette, spoken
from smfe.reporting.figures import draw_matplotlib
from smfe.reporting.figures.drawn import draw_changed
from smfe.reporting.sections import (
    answer,
    comparison,
    compliances,
    cutting_tests,
    diagnosis,
    drives,
    files,
    lobes,
    loops,
    measured,
)
from smfe.reporting.sections.draft import Draft
from smfe.results import write_atomically

Progress = Callable[[int, int], None]
Section = Callable[[Draft], dict[str, Any]]

SECTIONS: dict[str, tuple[str, str, Section]] = {
    "answer": ("Answer", "How deep, at which speed, how sure", answer.section),
    "lobes": ("Lobes", "Every source and pocket", lobes.section),
    "cutting_tests": ("Cutting tests", "Cutting tests", cutting_tests.section),
    "measured": ("Measured", "What was measured, and what the audit says", measured.section),
    "compliances": ("Compliances", "Compliances", compliances.section),
    "loops": ("Drive loops", "Drive loops", loops.section),
    "drives": ("Drives", "Drives: inertia, friction, open loop", drives.section),
    "comparison": ("Comparison", "Comparison of the measurements", comparison.section),
    "diagnosis": ("Diagnosis", "What the simulation gets wrong", diagnosis.section),
    "files": ("Files", "Files to download, and where they come from", files.section),
}
"""Name of a section, its module and its template -> its link, its heading (unless it says another), its maker."""

_HERE = Path(__file__).parent

_SCRIPTS = ("arrays.js", "tables.js", "cuts.js", "panels.js", "report.js")

_ARRAY = {"bdata", "codes", "derive"}
"""A part of a figure with one of these keys is an array: of 32-bit floats, of 16 bits, or made of others."""


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
        draw_changed(folder, name, draw, partial(_save, draw, folder / "figures" / name))
        if progress is not None:
            progress(done, steps)
    text = render(results)
    path = write_atomically(folder / "report.html", lambda p: p.write_text(text, encoding="utf-8"))
    if progress is not None:
        progress(steps, steps)
    return path


def _save(draw: draw_matplotlib.Draw, path: Path) -> None:
    draw_matplotlib.save(draw(), path)


def render(results: Results) -> str:
    """Return the page."""
    draft = Draft.of(results)
    environment = Environment(
        loader=FileSystemLoader(_HERE / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(n=number, bands=band_text, spoken=spoken, sentence=sentence)
    environment.globals["marks"] = OUTCOMES
    environment.globals["late"] = draft.late
    wanted = ("diagnosis", "files") if results.diagnosis_alone else tuple(SECTIONS)
    made = {name: content for name in wanted if (content := SECTIONS[name][2](draft))}
    environment.globals["heights"] = {name: plot["layout"]["height"] for name, plot in draft.plots.items()}
    return environment.get_template("report.html.j2").render(
        title=results.title,
        subject=subject(results),
        alone=results.diagnosis_alone,
        made=made,
        headings={name: SECTIONS[name][1] for name in made},
        links={name: SECTIONS[name][0] for name, content in made.items() if not content.get("empty")},
        css=Markup((_HERE / "static" / "report.css").read_text(encoding="utf-8")),
        tables=lambda: Markup(_json([table.content for table in draft.tables])),
        script=Markup("\n".join((_HERE / "static" / name).read_text(encoding="utf-8") for name in _SCRIPTS)),
        plotly=Markup((_HERE / "static" / "plotly-cartesian.min.js").read_text(encoding="utf-8")),
        plots=Markup(_embedded(draft.plots)),
    )


def _embedded(plots: dict[str, Any]) -> str:
    """Return figures and their arrays as JSON; the same array is written once."""
    arrays: dict[str, int] = {}

    def shared(part: Any) -> Any:
        if isinstance(part, dict):
            found = {key: shared(value) for key, value in part.items()}
            if _ARRAY & part.keys():
                return {"array": arrays.setdefault(json.dumps(found), len(arrays))}
            return found
        return [shared(value) for value in part] if isinstance(part, list | tuple) else part

    content = {"plots": shared(plots), "arrays": []}
    content["arrays"] = [json.loads(text) for text in arrays]
    return _json(content)


def _json(content: Any) -> str:
    """Return JSON that cannot end the script element it stands in."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False, ensure_ascii=False)
    return text.replace("<", "\\u003c").replace("\u2028", "\\u2028").replace("\u2029", "\\u2029")
