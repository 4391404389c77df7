"""What the figures of the report hold, whoever draws them: panels, curves, bands, ranges, marks.

`draw_plotly` draws them for the page, `draw_matplotlib` as PNG for papers and slides.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import xarray as xr
from scipy.signal import find_peaks

from process.types import Complex, Real
from smfe.reporting.content.results import Lobes, Measurement, bands
from smfe.reporting.content.style import CHATTER, CURVE_COLOURS, number
from smfe.reporting.figures.compared import EXTENDED as EXTENDED_MODEL
from smfe.reporting.figures.compared import REFITTED, SIMULATION

# --- lobes and cutting tests -----------------------------------------------------------------------------------------


def tests_of(chatter: pd.DataFrame | None, request: str) -> pd.DataFrame | None:
    """Return the cutting tests that belong on the diagram of a request, None when there are none."""
    if chatter is None:
        return None
    rows = chatter[chatter["lobes"].fillna("") == request] if "lobes" in chatter and request else chatter
    return None if rows.empty else rows


def speed_range(lobes: Sequence[Lobes]) -> tuple[float, float]:
    """Return the ends of the axis of spindle speeds [rpm]."""
    every = np.concatenate([item.data["spindle_speed"].values for item in lobes])
    return float(every.min()), float(every.max())


def chatter_range(lobes: Sequence[Lobes]) -> tuple[float, float] | None:
    """Return the ends of the axis of chatter frequencies [Hz]; None without one."""
    every = np.concatenate([item.values("chatter_frequency") for item in lobes])
    known = every[np.isfinite(every)]
    if not known.size:
        return None
    margin = 0.1 * float(np.ptp(known)) + 1.0
    return max(0.0, float(known.min()) - margin), float(known.max()) + margin


def highest_depth(lobes: Sequence[Lobes], tests: pd.DataFrame | None) -> float:
    """Return the upper end of the axis of depths [mm]."""
    cut = tests["depth_of_cut_mm"].to_numpy(dtype=float) if tests is not None else np.empty(0)
    return depth_range([item.values("limit_depth") for item in lobes], cut)


def finite_depth(item: Lobes) -> Real:
    """Return the limit depth of lobes [mm], NaN where there is no limit."""
    depth = item.values("limit_depth")
    return np.where(np.isfinite(depth), depth, np.nan)


def depth_range(depths: Sequence[Real], tests: Real) -> float:
    """Return the upper end of the axis of depths [mm]: tests and lobes, but not a lone high peak."""
    joined = np.concatenate([d[np.isfinite(d)] for d in depths]) if depths else np.empty(0)
    highest_test = 1.3 * float(tests.max(initial=0.0))
    if not joined.size:
        return max(highest_test, 1.0)
    lobes = min(1.1 * float(np.quantile(joined, 0.98)), 8.0 * float(joined.min()))
    return max(highest_test, lobes, 1.5 * float(joined.min()))


# --- compliances -----------------------------------------------------------------------------------------------------


def axes_of(measurements: Sequence[Measurement]) -> tuple[list[str], list[str]]:
    """Return the responses and the excitations that anyone has measured: the tool tip first, then places by number."""
    entries = {pair for m in measurements for pair in m.entries}
    return sorted({r for r, _ in entries}, key=_place), sorted({e for _, e in entries}, key=_place)


def _place(name: str) -> tuple[bool, int, str]:
    """Return what sorts "x", "y", "2:z", "10:x" in this order."""
    node, apart, axis = name.rpartition(":")
    return bool(apart), int(node) if node.isdecimal() else 0, f"{node}:{axis}"


def entry_name(response: str, excitation: str) -> str:
    """Return "xy" for axes of the tool tip, "1:z, 2:z" where a place is named."""
    return f"{response}{excitation}" if len(response + excitation) == 2 else f"{response}, {excitation}"


def frequency_range(measurements: Sequence[Measurement]) -> tuple[float, float]:
    """Return the band [Hz] to show first: where the machine is flexible.

    From zero to a quarter beyond the last frequency at which any entry exceeds 5 % of the highest resonance,
    and not beyond the data. A hammer reaches far higher than what is of interest.
    """
    shown = [m for m in measurements if not m.is_model] or list(measurements)
    parts = [(m.frequency, np.abs(m.entry(*pair))) for m in shown for pair in m.entries]
    if not parts:
        return 0.0, 1.0
    level = 0.05 * max(_resonance(magnitude) for _, magnitude in parts)
    last = max(float(f[magnitude > level].max(initial=0.0)) for f, magnitude in parts)
    end = max(float(f[np.isfinite(magnitude)].max()) for f, magnitude in parts)
    return 0.0, min(end, 1.25 * last)


def _resonance(magnitude: Real) -> float:
    """Return the highest peak that stands out by 10 dB, else the highest value.

    The lowest frequencies of an integrated acceleration drift upwards without a peak.
    """
    known = magnitude[np.isfinite(magnitude) & (magnitude > 0.0)]
    peaks, _ = find_peaks(np.log10(known), prominence=0.5)
    return float(known[peaks].max() if peaks.size else known.max(initial=0.0))


def magnitude_range(measurements: Sequence[Measurement], span: tuple[float, float]) -> tuple[float, float]:
    """Return the range of magnitudes [um/N] up to the highest resonance, at most four decades."""
    joined = np.abs(_shown_values(measurements, span))
    joined = joined[joined > 0.0]
    if not joined.size:
        return 1e-3, 1.0
    top = float(joined.max())
    return max(0.8 * float(np.quantile(joined, 0.01)), 1e-4 * top), 1.5 * top


def part_ranges(measurements: Sequence[Measurement], span: tuple[float, float]) -> tuple[list[float], list[float]]:
    """Return the ranges of real and imaginary parts [um/N]."""
    joined = _shown_values(measurements, span)
    return _padded(joined.real), _padded(joined.imag)


def _shown_values(measurements: Sequence[Measurement], span: tuple[float, float]) -> Complex:
    """Return all compliances [um/N] of a band that do not exceed the highest resonance."""
    values = [np.empty(0, dtype=complex)]
    top = 0.0
    for m in measurements:
        inside = (m.frequency >= span[0]) & (m.frequency <= span[1])
        for pair in m.entries:
            entry = 1e6 * m.entry(*pair)[inside]
            values.append(entry[np.isfinite(entry)])
            top = max(top, _resonance(np.abs(entry)))
    joined = np.concatenate(values)
    return np.asarray(joined[np.abs(joined) <= top])


def _padded(values: Real) -> list[float]:
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    margin = 0.06 * (high - low) or 1.0
    return [low - margin, high + margin]


def magnitude_band(values: Complex, std: Real, floor: float) -> tuple[Real, Real]:
    """Return magnitude -+ two standard deviations [um/N], not below a floor for the logarithmic axis."""
    magnitude = 1e6 * np.abs(values)
    spread = 2e6 * std
    return np.maximum(magnitude - spread, floor), magnitude + spread


def lagging_phase(values: Complex) -> Real:
    """Return phases from -270 to 90 degrees: a displacement lags its force, and noise about -180 does not jump."""
    return (np.angle(np.where(np.isfinite(values), values, np.nan), deg=True) + 270.0) % 360.0 - 270.0


def quality_panels(
    measurements: Sequence[Measurement],
) -> tuple[list[Measurement], list[str], list[Measurement]]:
    """Return what was measured, the responses with a coherence, and the measurements with a condition number."""
    measured = [m for m in measurements if not m.is_model]
    responses = [r for r in "xyz" if any(m.coherences(r) for m in measured)]
    return measured, responses, [m for m in measured if m.condition() is not None]


def badly_conditioned(m: Measurement) -> list[tuple[float, float]]:
    """Return the bands [Hz] in which the forces are badly conditioned, half a step wider at either end."""
    half = 0.5 * float(np.median(np.diff(m.frequency))) if m.frequency.size > 1 else 0.0
    return [(a - half, b + half) for a, b in m.bad_bands()]


# --- spectra of cutting tests ----------------------------------------------------------------------------------------


def spectrum_span(dataset: xr.Dataset) -> tuple[float, float, float]:
    """Return the highest frequency with anything to see, and the lowest and highest amplitude to show."""
    frequency = dataset["frequency"].values.astype(float)
    largest = np.nanmax(dataset["amplitude"].transpose("axis", "frequency").values, axis=0)
    top = float(np.nanmax(largest)) if np.isfinite(largest).any() else 1.0
    threshold = float(dataset.attrs.get("threshold_amplitude", np.nan))
    last = float(frequency[largest > 0.05 * top].max(initial=0.0))
    floor = max(0.5 * float(np.nanquantile(largest, 0.02)), 1e-5 * top)
    return 1.1 * last, floor, 2.0 * max(top, threshold if np.isfinite(threshold) else 0.0)


def common_end(spectra: Sequence[xr.Dataset]) -> float:
    """Return where the frequency axes of all tests end, so that they can be compared at a glance."""
    if not spectra:
        return 1.0
    lines = [float(s.attrs.get("chatter_frequency_Hz", np.nan)) for s in spectra]
    end = max(
        float(np.median([spectrum_span(s)[0] for s in spectra])),
        1.5 * max((v for v in lines if v > 0.0), default=0.0),
    )
    return min(end, max(float(s["frequency"].values[-1]) for s in spectra))


def harmonic_bands(dataset: xr.Dataset) -> list[tuple[float, float]]:
    """Return the bands [Hz] that the criterion leaves out as harmonics of the spindle."""
    if "harmonic" not in dataset:
        return []
    frequency = dataset["frequency"].values.astype(float)
    half = 0.5 * float(np.median(np.diff(frequency))) if frequency.size > 1 else 0.0
    found = bands(frequency, dataset["harmonic"].values.astype(bool))
    return [(a - half, b + half) for a, b in found]


def amplitude_label(dataset: xr.Dataset) -> str:
    """Return e.g. "acceleration [m/s²]"."""
    units = str(dataset.attrs.get("units") or dataset["amplitude"].attrs.get("units") or "")
    quantity = str(dataset.attrs.get("quantity") or "amplitude")
    return f"{quantity} [{units.replace('^2', '²')}]" if units else quantity


def predicted_lines(dataset: xr.Dataset, end: float) -> dict[str, float]:
    """Return the chatter frequency that each source of lobes predicts [Hz], as far as the figure reaches."""
    found = json.loads(str(dataset.attrs.get("predicted_Hz", "{}")))
    return {str(name): float(f) for name, f in found.items() if float(f) <= end}


def chatter_marks(dataset: xr.Dataset) -> tuple[float, float]:
    """Return the amplitude of the threshold and the frequency of the chatter line [Hz]; NaN where there is none."""
    names = ("threshold_amplitude", "chatter_frequency_Hz")
    threshold, line = (float(dataset.attrs.get(name, np.nan)) for name in names)
    return threshold, line


# --- drives ----------------------------------------------------------------------------------------------------------

FRICTION = "friction_"
"""Beginning of the name of a table of friction over velocity."""

GAIN, PHASE, FREQUENCY = "gain [dB]", "phase [deg]", "frequency [Hz]"

Tables = Mapping[tuple[str, str], pd.DataFrame]


def is_friction(kind: str) -> bool:
    """Return whether a table of the results is friction over velocity."""
    return kind.startswith(FRICTION)


def frictions(tables: Tables) -> dict[tuple[str, str], pd.DataFrame]:
    """Return (measurement, axis) -> friction over velocity, from all tables of the results."""
    return {(name, kind[len(FRICTION) :]): frame for (name, kind), frame in tables.items() if is_friction(kind)}


def friction_titles(frame: pd.DataFrame) -> tuple[str, str]:
    """Return the names of velocity and force with their units."""
    velocity, force = (next(str(c) for c in frame.columns if str(c).startswith(n)) for n in ("velocity", "force"))
    return velocity, force.replace("force", "drive force without inertia")


def friction_parts(frame: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Return motion, steady runs, and the curve of each way, with plain column names."""
    plain = frame.rename(columns={c: str(c).split(" [")[0] for c in frame.columns})
    curve = plain[plain["kind"] == "curve"].sort_values("velocity")
    return {
        "motion": plain[plain["kind"] == "motion"],
        "runs": plain[plain["kind"] == "steady run"],
        "forward": curve[curve["velocity"] > 0.0],
        "backward": curve[curve["velocity"] < 0.0],
    }


def loop_curves(dataset: xr.Dataset) -> list[tuple[str, str, Any, Any]]:
    """Return name, colour, gain [dB] and phase [deg] of each feed."""
    out = []
    for k, feed in enumerate(dataset["feed"].values.astype(float)):
        response = dataset["loop_response"].sel(feed=feed).values
        gain = 20.0 * np.log10(np.maximum(np.abs(response), 1e-12))
        out.append((f"{number(feed)} mm/min", CURVE_COLOURS[k % 5], gain, np.degrees(np.angle(response))))
    return out


OPEN_LOOP = "carriage over drive force [µm/N]"


class OpenLoopCurve(NamedTuple):
    """One direction: name, colour, frequency [Hz], measured and fitted response [µm/N] and half its 95 % interval."""

    name: str
    colour: str
    frequency: Any
    measured: Any
    fitted: Any
    half: Any


def open_loops(groups: Mapping[str, xr.Dataset]) -> dict[str, list[OpenLoopCurve]]:
    """Return measurement -> its directions, from groups called ``measurement/direction``."""
    out: dict[str, list[OpenLoopCurve]] = {}
    for key, data in groups.items():
        name, _, way = key.rpartition("/")
        curves = out.setdefault(name, [])
        feed = number(abs(float(data.attrs["feed_mm_min"])))
        # The standard deviation is that of the complex error; along the response acts a part smaller by a root of two.
        half = 1e6 * 1.96 / math.sqrt(2.0) * data["open_loop_std"].values
        measured, fitted = (1e6 * data[n].values for n in ("open_loop", "open_loop_fitted"))
        curves.append(
            OpenLoopCurve(
                f"{way}, {feed} mm/min",
                CURVE_COLOURS[len(curves) % 5],
                data["frequency"].values,
                measured,
                fitted,
                half,
            )
        )
    return out


def falling_phase(response: Complex) -> Real:
    """Return the phase [deg] between -360 and 0: that of a mass with dead time falls below -180."""
    phase = np.degrees(np.angle(response))
    return np.asarray(np.where(phase > 90.0, phase - 360.0, phase))


def open_loop_marks(groups: Mapping[str, xr.Dataset], name: str) -> dict[str, float]:
    """Return the anti-resonance and the resonance [Hz] of the first direction of a measurement."""
    first = next(data for key, data in groups.items() if key.rpartition("/")[0] == name)
    return {word: float(first.attrs[f"{word.replace('-', '_')}_Hz"]) for word in ("anti-resonance", "resonance")}


# --- diagnosis -------------------------------------------------------------------------------------------------------

BASELINE, EXTENDED = "#B35C00", "#0072B2"
"""Colours of the two models."""

STARTS = ((SIMULATION, "before"), (REFITTED, "refitted"))
"""Where the search begins, and the key of the misfit there."""

MOST_CONDITIONS = 30
"""Conditions that are drawn, at most: those of which the extended model leaves most."""


def search_steps(finding: Mapping[str, Any]) -> tuple[list[str], list[float]]:
    """Return the simulation, as declared and refitted, and the steps that were kept, with their misfit [dB].

    Where nothing was added to it, it stands alone; where what was declared alone is wrong, no step but the end.
    """
    misfit = finding.get("misfit_db") or {}
    begun = [(name, float(misfit[key])) for name, key in STARTS if misfit.get(key) is not None]
    kept = [step for step in finding.get("ladder", []) if step["accepted"]]
    steps = [(str(step.get("words") or step["change"]), float(step["misfit_db"])) for step in kept]
    if not steps and finding.get("causes") and misfit.get("after") is not None:
        steps = [(EXTENDED_MODEL, float(misfit["after"]))]
    rows = [*begun, *steps] if steps else begun[:1]
    return [name for name, _ in rows], [x for _, x in rows]


def step_colours(names: Sequence[str]) -> list[str]:
    """Return the colour of each step: that of the simulation, or of the extended model."""
    simulations = [name for name, _ in STARTS]
    return [BASELINE if name in simulations else EXTENDED for name in names]


def shown_conditions(finding: Mapping[str, Any]) -> tuple[list[Mapping[str, Any]], str]:
    """Return the conditions that are shown, in the order of the campaign, and what to call them."""
    every = [c for c in finding.get("conditions", []) if c["before_db"] is not None and c["after_db"] is not None]
    if finding.get("verdict") in ("consistent", None):
        return [], ""
    worst = sorted(every, key=lambda c: (-c["after_db"], -c["before_db"]))[:MOST_CONDITIONS]
    few = f" (the {len(worst)} of {len(every)} with most left)" if len(every) > len(worst) else ""
    return [c for c in every if c in worst], f"misfit of each condition over noise [dB]{few}"


def condition_marks(finding: Mapping[str, Any]) -> list[tuple[str, str, bool, list[int], list[float]]]:
    """Return name, colour, whether held out, place and misfit [dB] of the marks of the conditions drawn."""
    rows, _ = shown_conditions(finding)
    models = [("before_db", BASELINE, SIMULATION)]
    if finding.get("causes"):
        models.append(("after_db", EXTENDED, EXTENDED_MODEL))
    out = []
    for key, colour, word in models:
        for held_out in sorted({bool(c["held_out"]) for c in rows}):
            places = [i for i, c in enumerate(rows) if bool(c["held_out"]) == held_out]
            name = f"{word}, set aside" if held_out else word
            out.append((name, colour, held_out, places, [float(rows[i][key]) for i in places]))
    return out


def stable_depths(finding: Mapping[str, Any]) -> list[tuple[str, str, str, Real, Real]]:
    """Return lobes, model, colour, spindle speeds [rpm] and stable depths [mm], baseline before extended model.

    Where the depth depends on how the machine stands, those at which it is smallest.
    """
    found: dict[str, dict[str, list[Mapping[str, Any]]]] = {}
    for row in finding.get("stable_depth", []):
        found.setdefault(str(row["where"]), {}).setdefault(str(row.get("at", "")), []).append(row)
    out = []
    for where, by_standing in found.items():
        at, rows = min(by_standing.items(), key=lambda item: min(_limit(r["after_mm"]) for r in item[1]))
        where = f"{where}, {at}" if at else where
        speeds = np.array([float(r["spindle_speed_rpm"]) for r in rows])
        for key, colour, word in (("before_mm", BASELINE, SIMULATION), ("after_mm", EXTENDED, EXTENDED_MODEL)):
            depths = np.array([np.nan if r[key] is None else float(r[key]) for r in rows])
            out += [(where, word, colour, speeds, depths)] * (len(rows) > 1)
    return out


def _limit(depth: float | None) -> float:
    return math.inf if depth is None else float(depth)


def condition_symbol(name: str) -> str:
    """Return the symbol of the marks of a model: its shape tells the models apart, its filling what was set aside."""
    shape = "diamond" if name.startswith("simulation") else "circle"
    return f"{shape}-open" if name.endswith("set aside") else shape


def tested_depths(finding: Mapping[str, Any]) -> list[tuple[str, str, str, Real, Real]]:
    """Return what happened, mark, colour, spindle speeds [rpm] and depths [mm] of the decided cutting tests."""
    out = []
    for happened, mark, colour in (("stable", "o", "#000000"), ("chatter", "x", CHATTER)):
        rows = [t for t in finding.get("tested_depth", []) if t["happened"] == happened]
        if rows:
            speeds, depths = (np.array([float(t[k]) for t in rows]) for k in ("spindle_speed_rpm", "depth_of_cut_mm"))
            out.append((happened, mark, colour, speeds, depths))
    return out


def has_diagnosis(finding: Mapping[str, Any]) -> bool:
    """Return whether there is anything to draw."""
    return len(search_steps(finding)[0]) > 1 or bool(shown_conditions(finding)[0])
