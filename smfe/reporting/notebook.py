"""Figures of one result at a time, for a notebook: the same drawings as those of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from process.errors import InputError
from process.labels import RECORD_SCALARS, RECORD_VECTORS, axis_present
from process.machine.modes import ModalModel
from smfe.diagnosis.judgement.finding import Finding
from smfe.identification.compliances import of_model
from smfe.identification.errors.result import Identification
from smfe.limits.campaign_lobes import LobeResult
from smfe.limits.cutting_tests import spectrum_of
from smfe.limits.recommendation import Recommendation
from smfe.modes.fit_modes import ModalFit
from smfe.records.look import Look
from smfe.reporting import first_look
from smfe.reporting.content.results import Lobes, Measurement, Results
from smfe.reporting.content.style import AXIS_COLOURS, CURVE_COLOURS, Line, literal, number, palette
from smfe.reporting.figures import figure_data
from smfe.reporting.figures.draw_diagnosis import draw_compared, draw_search
from smfe.reporting.figures.draw_matplotlib import (
    DPI,
    draw_compliance,
    draw_lobes,
    draw_loop,
    draw_spectra,
)
from smfe.reporting.modal import draw_stabilisation
from stability import ChatterVerdict

_DASHES: dict[str, Any] = {"solid": "-", "dash": "--", "dot": ":", "dashdot": "-.", "longdash": (0, (9, 3))}


def figure_of(
    thing: object,
    others: Sequence[object] = (),
    entry: str | None = None,
    tests: object = None,
    recommendation: Recommendation | None = None,
    name: str | None = None,
) -> Figure:
    """Draw a result.

    Parameters
    ----------
    thing : object
        A record, compliance, lobes or spectrum as a dataset, `Identification`, `ModalModel`, `LobeResult`,
        `ChatterVerdict`, `ModalFit`, `Finding` or `Look`; a mapping of str to compliances or lobes.
    others : sequence of object, optional
        Further compliances, or lobes, to compare with.
    entry : str, optional
        Of compliances, one entry with its phase, error and coherence: "xy" is the response x to a force along y.
    tests : DataFrame, or sequence of (float, float, str or ChatterVerdict), optional
        On lobes, cutting tests: rows of chatter.csv, or spindle speed [rpm], depth of cut [mm] and outcome.
    recommendation : Recommendation, optional
        On lobes, the cut that is recommended.
    name : str, optional
        What the first of several is called.

    Raises
    ------
    InputError
        For what has no figure.
    """
    named = _named(thing, others, name)
    first = next(iter(named.values()), None)
    kinds = {_kind(one) for one in named.values()}
    if len(kinds) > 1:
        raise InputError(f"{' and '.join(sorted(kinds))} do not go into one figure; draw them one by one")
    kind = kinds.pop() if kinds else "nothing"
    if entry is not None and kind != "compliance":
        raise InputError(f"entry is for compliances; this is {kind}")
    if (tests is not None or recommendation is not None) and kind != "lobes":
        raise InputError(f"tests and a recommendation are for lobes; this is {kind}")
    if kind == "compliance":
        return _compliances({n: _dataset(one) for n, one in named.items()}, entry)
    if kind == "lobes":
        return _lobes({n: _dataset(one) for n, one in named.items()}, tests, recommendation)
    if len(named) > 1:
        raise InputError(f"figures of {kind} show one at a time; give one")
    single: Mapping[str, Any] = {
        "record": draw_record,
        "spectrum": lambda one: draw_spectra([one]),
        "verdict": draw_verdict,
        "loop": draw_loop,
        "modes": lambda one: draw_stabilisation(one, name or ""),
        "finding": _finding,
        "look": first_look.figure_of,
    }
    if kind not in single:
        raise InputError(f"{type(first).__name__} has no figure; there are those of records, compliances, lobes, modes")
    figure: Figure = single[kind](first)
    return figure


def shown(figure: Figure) -> Figure:
    """Let a notebook show the figure as its last line does, without `pyplot`."""
    figure._repr_png_ = partial(_png, figure)  # type: ignore[attr-defined]
    return figure


def _png(figure: Figure) -> bytes:
    import io

    file = io.BytesIO()
    figure.savefig(file, format="png", dpi=110)
    return file.getvalue()


def _named(thing: object, others: Sequence[object], name: str | None) -> dict[str, object]:
    """Return what is drawn by its name, each once."""
    if isinstance(thing, Mapping) and not isinstance(thing, xr.Dataset):
        out = {str(n): one for n, one in thing.items()}
    else:
        out = {name or _name(thing): thing}
    for other in others:
        base = key = _name(other)
        count = 2
        while key in out:
            key, count = f"{base} ({count})", count + 1
        out[key] = other
    return out


def _name(thing: object) -> str:
    if isinstance(thing, Identification):
        return thing.name
    if isinstance(thing, LobeResult):
        return thing.source
    if isinstance(thing, xr.Dataset):
        return str(thing.attrs.get("name") or thing.attrs.get("source") or thing.attrs.get("method") or "compliance")
    return "modes" if isinstance(thing, ModalModel) else ""


def _dataset(thing: object) -> xr.Dataset:
    if isinstance(thing, Identification):
        return thing.compliance.assign_attrs(method=thing.method)
    if isinstance(thing, LobeResult):
        return thing.lobes
    if isinstance(thing, ModalModel):
        return of_model(thing)
    assert isinstance(thing, xr.Dataset)
    return thing


def _kind(thing: object) -> str:
    if isinstance(thing, xr.Dataset):
        channels = {str(n) for n in thing.data_vars} & {*RECORD_VECTORS, *RECORD_SCALARS}
        tells = {"compliance": "compliance", "limit_depth": "lobes", "loop_response": "loop", "amplitude": "spectrum"}
        found = next((kind for variable, kind in tells.items() if variable in thing), None)
        return found or ("record" if channels and "time" in thing.dims else "Dataset")
    classes: dict[type, str] = {
        Identification: "compliance",
        ModalModel: "compliance",
        LobeResult: "lobes",
        ChatterVerdict: "verdict",
        ModalFit: "modes",
        Finding: "finding",
        Look: "look",
    }
    return next((kind for one, kind in classes.items() if isinstance(thing, one)), type(thing).__name__)


def _finding(finding: Finding) -> Figure:
    """Return measured and modelled curves side by side, or where there are none the steps of the search."""
    if finding.curves is not None:
        return draw_compared(finding.curves)
    if not figure_data.has_diagnosis(finding.as_dict()):
        raise InputError(f"this finding has no search to draw: {finding.reason}")
    return draw_search(finding.as_dict())


# --- compliances -----------------------------------------------------------------------------------------------------


def _compliances(named: Mapping[str, xr.Dataset], entry: str | None) -> Figure:
    further = [str(d) for one in named.values() for d in one["compliance"].dims if str(d) not in _MATRIX]
    if further:
        raise InputError(f"these compliances are over {further[0]}, too; select one, e.g. .sel({further[0]}=...)")
    every = [Measurement(n, str(one.attrs.get("method", "")), one) for n, one in named.items()]
    measurements = [m for m in every if m.entries]
    if not measurements:
        raise InputError("no entry of these compliances holds a number; there is nothing to draw")
    looks = palette(_results(measurements, ()))
    pairs = [pair for m in measurements for pair in m.entries]
    if entry is None and len(set(pairs)) > 1:
        return draw_compliance(measurements, looks)
    pair = pairs[0] if entry is None else next((p for p in pairs if figure_data.entry_name(*p) == entry), None)
    if pair is None:
        there = ", ".join(dict.fromkeys(figure_data.entry_name(*p) for p in pairs))
        raise InputError(f"no entry '{entry}' was measured; there are {there}")
    return draw_entry([m for m in measurements if pair in m.entries], pair, looks)


_MATRIX = ("frequency", "response", "excitation")


def draw_entry(measurements: Sequence[Measurement], pair: tuple[str, str], looks: Mapping[str, Line]) -> Figure:
    """Draw one entry: magnitude with two standard deviations, phase, and the coherence where it is known.

    Parameters
    ----------
    measurements : sequence of Measurement
        Those that claim the entry.
    pair : (str, str)
        Response and excitation.
    looks : mapping of str to Line
        Colour and dash of each.
    """
    span = figure_data.frequency_range(measurements)
    low, high = figure_data.magnitude_range(measurements, span)
    coherences = {m.name: c for m in measurements if (c := _coherence(m, pair)) is not None}
    rows = 3 if coherences else 2
    figure = Figure(figsize=(7.0, 1.8 + 1.5 * rows), dpi=DPI, layout="constrained")
    panels = figure.subplots(rows, 1, sharex=True, height_ratios=[2.2, 1.2, 1.0][:rows])
    for m in measurements:
        values, std, line = m.entry(*pair), m.std(*pair), _line(looks[m.name])
        if std is not None:
            below, above = figure_data.magnitude_band(values, std, 1e-2 * low)
            panels[0].fill_between(m.frequency, below, above, color=line["color"], alpha=0.2, linewidth=0)
        panels[0].semilogy(m.frequency, np.where(values != 0.0, 1e6 * np.abs(values), np.nan), label=m.name, **line)
        panels[1].plot(m.frequency, figure_data.lagging_phase(values), **line)
        if m.name in coherences:
            panels[2].plot(m.frequency, coherences[m.name], **line)
    name = figure_data.entry_name(*pair)
    panels[0].set(ylabel=f"compliance {name} [µm/N]", ylim=(low, high), xlim=span)
    panels[1].set(ylabel="phase [deg]", ylim=(-280.0, 100.0), yticks=(-270, -180, -90, 0, 90))
    if coherences:
        panels[2].set(ylabel="coherence [1]", ylim=(-0.02, 1.05))
    panels[-1].set_xlabel("frequency [Hz]")
    for panel in panels:
        _plain_axes(panel)
    known = any(m.std(*pair) is not None for m in measurements)
    title = "shaded: two standard deviations" if known else "the error is not known"
    panels[0].legend(frameon=False, fontsize=9, title=title, title_fontsize=8)
    return figure


def _line(look: Line) -> dict[str, Any]:
    return {"color": look.colour, "linestyle": _DASHES.get(look.dash, "-"), "linewidth": 1.2}


def _coherence(m: Measurement, pair: tuple[str, str]) -> Any:
    """Return the coherence behind an entry, or that of its response to all forces together."""
    found = dict(m.coherences(pair[0]))
    return found.get(pair[1], found.get(""))


def _plain_axes(axes: Axes) -> None:
    axes.grid(True, color="#dddddd", linewidth=0.5)
    axes.tick_params(labelsize=8, direction="in", which="both")


def _results(measurements: Sequence[Measurement], lobes: Sequence[Lobes]) -> Results:
    nothing = (None,) * 4
    return Results(Path(), tuple(measurements), tuple(lobes), {}, {}, *nothing, {}, {})


# --- lobes -----------------------------------------------------------------------------------------------------------


def _lobes(named: Mapping[str, xr.Dataset], tests: object, recommendation: Recommendation | None) -> Figure:
    items = []
    for name, data in named.items():
        columns = {"spindle_speed_rpm": data["spindle_speed"].values, "limit_depth_mm": data["limit_depth"].values}
        if "safe_depth" in data:
            columns["safe_depth_mm"] = data["safe_depth"].values
        items.append(Lobes("", name, data.sortby("spindle_speed"), pd.DataFrame(columns)))
    advice = None if recommendation is None else recommendation.as_dict()
    return draw_lobes(items, None if tests is None else _tests(tests), palette(_results((), items)), advice)


def _tests(given: Any) -> pd.DataFrame:
    """Return cutting tests as rows of chatter.csv."""
    if isinstance(given, pd.DataFrame):
        missing = [c for c in ("spindle_speed_rpm", "depth_of_cut_mm", "verdict") if c not in given]
        if missing:
            raise InputError(f"the table of cutting tests has no column {', '.join(missing)}")
        return given
    rows = []
    for test in given:
        speed, depth, outcome = test
        line = np.nan
        if isinstance(outcome, ChatterVerdict):
            line, outcome = outcome.chatter_frequency_Hz, outcome.verdict
        if outcome not in ("stable", "chatter", "undecided"):
            raise InputError(f"the outcome of a cutting test is stable, chatter or undecided, not {outcome!r}")
        rows.append((float(speed), float(depth), outcome, line))
    return pd.DataFrame(rows, columns=["spindle_speed_rpm", "depth_of_cut_mm", "verdict", "chatter_frequency_Hz"])


# --- records ---------------------------------------------------------------------------------------------------------


def draw_record(record: xr.Dataset) -> Figure:
    """Draw the channels of a record over time, each in a panel of its own."""
    channels = []
    for name in (str(n) for n in record.data_vars if "time" in record[n].dims):
        array = record[name]
        unit = str(array.attrs.get("units", "1")).replace("^2", "²")
        for axis in axis_present(record, name) if "axis" in array.dims else [""]:
            values = (array.sel(axis=axis) if axis else array).values.astype(float)
            title = f"{name.replace('_', ' ')} {axis}".strip()
            channels.append((f"{title}\n[{unit}]", AXIS_COLOURS.get(axis, CURVE_COLOURS[0]), values))
    if not channels:
        raise InputError("no channel of this record holds a number; there is nothing to draw")
    figure = Figure(figsize=(7.5, 0.9 + 0.95 * len(channels)), dpi=DPI, layout="constrained")
    panels = figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
    time = record["time"].values.astype(float)
    for axes, (title, colour, values) in zip(panels, channels, strict=True):
        axes.plot(*first_look.envelope(time, values), linewidth=0.7, color=colour)
        axes.set_ylabel(title, fontsize=8)
        _plain_axes(axes)
    panels[-1].set_xlabel("time [s]")
    figure.align_ylabels()
    source = record.attrs.get("source")
    if source:
        figure.suptitle(literal(str(source)), fontsize=10)
    return figure


def draw_verdict(verdict: ChatterVerdict) -> Figure:
    """Draw the spectrum that was judged, with the harmonics that were left out and the chatter line."""
    figure = draw_spectra([spectrum_of(verdict)])
    figure.axes[0].set_title(f"{number(verdict.spindle_speed_rpm)} rpm: {verdict.verdict}", fontsize=9)
    return figure
