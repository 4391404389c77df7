"""A folder of results that no run has made: what every part of the report can be shown."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.machine.modes import ModalModel
from smfe.reporting import write_report
from smfe.results import pack_warnings, write_csv, write_groups, write_json
from stability import lobe_curves, lobe_table, write_table, zero_order

MACHINE = ModalModel(
    frequency=[27.0, 61.4, 74.0, 118.0],
    damping=[0.05, 0.03, 0.025, 0.04],
    stiffness=[9e7, 4.5e7, 6e7, 2e8],
    direction=[[0.4, 1.0, 0.1], [1.0, 0.15, 0.1], [0.2, 1.0, 0.3], [0.3, 0.3, 1.0]],
)
TOOL = Tool(0.125, 8, np.pi / 4)
STEEL = CuttingCoefficients(1.9e9, 0.8e9, 0.4e9, 0.0, 0.0, 0.0)
WIDTH, FEED = 0.1, 0.2e-3
SPEEDS = np.arange(250.0, 751.0, 2.0)


def measured(method: str, top: float, step: float, error: float, seed: int, softer: float = 1.0) -> xr.Dataset:
    """Return a compliance with noise of a known standard deviation, as `method` leaves it."""
    rng = np.random.default_rng(seed)
    frequency = np.arange(10.0, top, step)
    machine = ModalModel(MACHINE.frequency * softer, MACHINE.damping, MACHINE.stiffness, MACHINE.direction)
    dataset = machine.compliance(frequency)
    shape = dataset["compliance"].shape
    std = np.broadcast_to(error * (60.0 / frequency)[:, None, None] ** 0.5, shape)
    noise = std / np.sqrt(2.0) * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    dims = ("frequency", "response", "excitation")
    dataset["compliance"] = (dims, dataset["compliance"].values + noise, {"units": "m/N"})
    dataset["compliance_std"] = (dims, std, {"units": "m/N"})
    if method == "sweep":
        condition = 4.0 + 60.0 * np.exp(-(((frequency - 93.0) / 3.0) ** 2)) + rng.uniform(0, 2, frequency.size)
        dataset["force_condition"] = ("frequency", condition, {"units": "1"})
        dataset["coherence"] = (dims[:2], 1.0 - 0.1 * rng.uniform(size=shape[:2]) ** 3, {"units": "1"})
        dataset["compliance"] = dataset["compliance"].where(condition_ok(dataset, 55.0))
        dataset["compliance"].attrs["units"] = "m/N"
    else:
        dataset["coherence"] = (dims, 1.0 - 0.2 * rng.uniform(size=shape) ** 4, {"units": "1"})
    return dataset.assign_attrs(method=method, conditions=json.dumps({"controller": "K2"}))


def condition_ok(dataset: xr.Dataset, limit: float) -> xr.DataArray:
    return dataset["force_condition"] < limit


def lobes_of(compliance: xr.Dataset, source: str, cut: str = "down") -> tuple[xr.Dataset, pd.DataFrame]:
    """Return lobes and their table as the pipeline writes them, with a quantile band of 15 %."""
    arc = engagement(cut, WIDTH, TOOL.diameter)
    clean = compliance[["compliance"]].interpolate_na("frequency")
    clean["compliance"].attrs["units"] = "m/N"
    dataset = zero_order(clean, TOOL, arc, STEEL, SPEEDS)
    spread = np.array([0.85, 1.0, 1.15])[:, None] * dataset["limit_depth"].values
    dataset = dataset.assign_coords(quantile=[0.05, 0.5, 0.95])
    dataset["limit_depth_quantile"] = (("quantile", "spindle_speed"), spread, {"units": "mm"})
    table = lobe_table(dataset, source, TOOL, WIDTH, FEED)
    curves = lobe_curves(clean, TOOL, arc, STEEL, (SPEEDS[0], SPEEDS[-1]))
    for column in ("spindle_speed_rpm", "limit_depth_mm", "chatter_frequency_Hz", "lobe", "branch"):
        short = re.sub("_(rpm|mm|Hz)$", "", column)
        dataset[f"curve_{short}"] = ("point", curves[column].to_numpy())
    dataset = pack_warnings(dataset, dataset.attrs.pop("warnings", ()))
    attrs = {"source": source, "cut": cut, "method": "zero_order"}
    return dataset.assign_attrs(**attrs, width_of_cut_mm=100.0, feed_per_tooth_mm=0.2), table


def spectrum(row: pd.Series, units: str = "m/s^2") -> xr.Dataset:
    rng = np.random.default_rng(int(row["spindle_speed_rpm"]))
    frequency = np.arange(1.0, 2000.0, 0.5)
    tooth = 8 * row["spindle_speed_rpm"] / 60.0
    amplitude = 0.01 * rng.rayleigh(size=(3, frequency.size)) * np.array([[1.0], [0.7], [0.3]])
    harmonic = np.abs((frequency + tooth / 2) % tooth - tooth / 2) < 1.5
    amplitude += np.array([[2.0], [1.2], [0.6]]) * np.where(harmonic, np.exp(-frequency / 400.0), 0.0)
    if row["verdict"] == "chatter":
        amplitude[:2] += 3.0 * np.exp(-(((frequency - row["chatter_frequency_Hz"]) / 0.8) ** 2))
    data = {"amplitude": (("axis", "frequency"), amplitude), "harmonic": ("frequency", harmonic)}
    attrs = row[["file", "spindle_speed_rpm", "depth_of_cut_mm", "verdict", "ratio", "chatter_frequency_Hz", "reason"]]
    more = {
        "quantity": "acceleration",
        "units": units,
        "tooth_passing_frequency_Hz": tooth,
        "threshold_amplitude": 0.5,
    }
    time, coarse = np.linspace(0.1, 3.9, 60), np.arange(2.0, 400.0, 2.0)
    turned = (time[:, None] > 0.6) & (np.abs((coarse + tooth / 2) % tooth - tooth / 2) < 2.0)
    grown = (time[:, None] > 1.5) & (np.abs(coarse - row["chatter_frequency_Hz"]) < 1.5)
    level = np.where(grown, 250, np.where(turned, 230, 90)).astype(np.uint8)
    data["spectrogram"] = (("picture_time", "picture_frequency"), level, {"step_dB": 0.5, "window_s": 0.2})
    more |= {"teeth": 8, "cut_s": "[0.5, 0.6, 3.5, 3.6]", "interval_s": "[2.0, 3.5]", "family_Hz": "[130.1]"}
    coords = {"axis": list("xyz"), "frequency": frequency, "picture_time": time, "picture_frequency": coarse}
    return xr.Dataset(data, coords, {**attrs.to_dict(), **more})


def cutting_tests() -> pd.DataFrame:
    speed = [300.0, 380.0, 450.0, 520.0, 600.0, 700.0]
    depth = [0.8, 2.5, 1.2, 3.0, 1.6, 2.2]
    verdict = ["stable", "chatter", "stable", "chatter", "undecided", "stable"]
    line = [np.nan, 66.4, np.nan, 64.8, 63.0, np.nan]
    return pd.DataFrame(
        {
            "file": [f"cut_{n:g}.csv" for n in speed],
            "spindle_speed_rpm": speed,
            "depth_of_cut_mm": depth,
            "verdict": verdict,
            "ratio": [0.01, 1.52, 0.02, 0.8, 0.3, 0.03],
            "chatter_frequency_Hz": line,
            "tooth_passing_harmonic_Hz": [40.0, 50.7, 60.0, 69.3, 80.0, 93.3],
            "observed": ["stable", "chatter", "", "stable", "chatter", ""],
            "lobes": ["lobes_1"] * 5 + [""],
            "reason": [
                f"the largest line reaches {r} of the tooth passing line" for r in (0.01, 1.5, 0.02, 0.8, 0.3, 0.03)
            ],
            "limit_hammer_idle_mm": [1.1] * 6,
            "predicted_hammer_idle": ["stable", "chatter", "chatter", "chatter", "stable", "chatter"],
            "limit_sweep_mm": [1.3] * 6,
            "predicted_sweep": ["stable", "chatter", "stable", "stable", "chatter", "chatter"],
        }
    )


def hits(count: int) -> pd.DataFrame:
    used = np.arange(count) % 7 != 3
    return pd.DataFrame(
        {
            "excitation": "x",
            "file": [f"hx_{i}.csv" for i in range(count)],
            "hit": 1,
            "peak_force_N": 1400.0 + 13.7 * np.arange(count),
            "overloaded": ~used,
            "double_hit": False,
            "used": used,
            "reason": np.where(used, "", "overloaded"),
        }
    )


def recommendation(request: str, cut: str, source: str, table: pd.DataFrame) -> dict[str, object]:
    """Return a recommendation at the highest limit of a table, with the keys that the pipeline writes."""
    row = table.loc[table["limit_depth_mm"].idxmax()]
    speed, depth = float(row["spindle_speed_rpm"]), np.floor(10.0 * row["safe_depth_mm"]) / 10.0
    return {
        "status": "recommended",
        "spindle_speed_rpm": speed,
        "speed_from_rpm": speed - 4.0,
        "speed_to_rpm": speed + 4.0,
        "depth_of_cut_mm": float(depth),
        "limit_depth_mm": float(row["limit_depth_mm"]),
        "limit_depth_p05_mm": float(row["limit_depth_p05_mm"]),
        "limit_depth_p95_mm": float(row["limit_depth_p95_mm"]),
        "width_of_cut_mm": 100.0,
        "feed_per_tooth_mm": 0.2,
        "feed_mm_min": float(row["feed_mm_min"]),
        "cutting_speed_m_min": float(np.pi * TOOL.diameter * speed),
        "removal_rate_cm3_min": float(depth * 100.0 * row["feed_mm_min"] / 1e3),
        "probability": 0.95,
        "chatter_frequency_Hz": float(row["chatter_frequency_Hz"]),
        "lobes": request,
        "method": "zero_order",
        "cut": cut,
        "source": source,
        "reason": f"From {source}, measured in motion. The depth is stable with a probability of 95 %.",
        "assumptions": ["cutting coefficients of C45 are taken as known within 10 %"],
        "tool": {"name": "125 mm, 8 teeth", "diameter_mm": 125.0, "teeth": 8, "approach_angle_deg": 45.0},
        "material": "C45",
        "machine": "Ram machine",
    }


def pockets(answers: list[dict[str, object]]) -> pd.DataFrame:
    """Return rows of pockets.csv: each recommendation, and half of each at the end of the speeds."""
    names = ["lobes", "source", "spindle_speed_rpm", "speed_from_rpm", "speed_to_rpm", "depth_of_cut_mm"]
    names += ["limit_depth_mm", "limit_depth_p05_mm", "limit_depth_p95_mm", "removal_rate_cm3_min"]
    best = pd.DataFrame(answers)[[*names, "chatter_frequency_Hz"]].assign(recommended=[True, False], at_edge=False)
    edge = best.assign(recommended=False, at_edge=True, spindle_speed_rpm=SPEEDS[-1])
    return pd.concat([best, edge], ignore_index=True)


def comparison() -> pd.DataFrame:
    """Return a comparison in which the sweep alone differs: its peak at 61.4 Hz is 2 Hz lower and 40 % higher."""
    pairs = [("hammer_idle", "actuator"), ("hammer_idle", "sweep"), ("actuator", "sweep")]
    rows = []
    for k, (a, b) in enumerate(pairs):
        for r in "xyz":
            apart = b == "sweep" and r == "x"
            row: dict[str, object] = {"measurement_a": a, "measurement_b": b, "response": r, "excitation": r}
            row |= {"match": "both", "frequency_a_Hz": 61.4, "frequency_std_a_Hz": 0.08}
            row |= {"frequency_b_Hz": 59.4 if apart else 61.4, "frequency_std_b_Hz": 0.1}
            for quantity, percent, std in (
                ("frequency", -3.257, 0.21),
                ("damping", 1.0, 5.2),
                ("amplitude", 40.0 + k, 5.4),
            ):
                row[f"{quantity}_difference_percent"] = percent if apart else 0.1
                row[f"{quantity}_difference_std_percent"] = std
                row[f"{quantity}_significant"] = apart and quantity != "damping"
            rows.append({**row, "significant": apart})
    alone = {"measurement_a": "hammer_idle", "measurement_b": "sweep", "response": "x", "excitation": "y"}
    rows.append({**alone, "match": "b only", "frequency_b_Hz": 33.2, "significant": False})
    return pd.DataFrame(rows)


def explained() -> pd.DataFrame:
    """Return what explains it: the feed; method and level change together."""
    rows = []
    for quantity, effect in (("frequency", -3.1), ("amplitude", 38.0)):
        head = {"response": "x", "excitation": "x", "frequency_Hz": 60.7, "quantity": quantity}
        feed = {"lowest": "0 mm/min", "highest": "x 120 mm/min, y 0 mm/min, z 0 mm/min", "effect_percent": effect}
        feed |= {"effect_std_percent": 0.3, "explained_percent": 93.4, "p_family": 1e-4, "significant": True}
        rows.append({**head, "factor": "feed", **feed})
        rows.append(
            {**head, "factor": "method + level", "explained_percent": 4.0, "p_family": 1.0, "significant": False}
        )
    return pd.DataFrame(rows)


def model_error() -> pd.DataFrame:
    rows = [
        {
            "measurement": m,
            "model": "bench",
            "response": r,
            "excitation": e,
            "from_Hz": 10.0,
            "to_Hz": 200.0,
            "error_percent": p,
        }
        for m, p in (("hammer_idle", 3.4), ("sweep", 7.25))
        for r in "xyz"
        for e in "xyz"
    ]
    return pd.DataFrame(rows)


def write_sample(folder: Path, name: str = "Ram machine, K1 and K2") -> Path:
    """Write what three methods, a model, six cutting tests and two lobe requests leave behind."""
    frf = {
        "hammer_idle": pack_warnings(measured("hammer", 400.0, 0.5, 4e-10, 1), ["1 of 21 hits is overloaded"]),
        "actuator": measured("actuator", 200.0, 0.5, 2e-10, 2),
        "sweep": pack_warnings(measured("sweep", 200.0, 0.25, 8e-10, 3, 0.97), ["badly conditioned in 90-96 Hz"]),
        "bench": MACHINE.compliance(np.arange(1.0, 360.0, 0.25)).assign_attrs(method="model"),
    }
    write_groups(folder / "frf.nc", frf)
    jobs = [("lobes_1", "down", s) for s in ("hammer_idle", "sweep")] + [("lobes_2", "up", "sweep")]
    results = {f"{request}/{source}": lobes_of(frf[source], source, cut) for request, cut, source in jobs}
    write_groups(folder / "lobes.nc", {name: item[0] for name, item in results.items()})
    write_table(pd.concat([item[1] for item in results.values()], ignore_index=True), folder / "lobe_table.csv")
    answers = [recommendation(request, cut, s, results[f"{request}/{s}"][1]) for request, cut, s in jobs[1:]]
    write_json(folder / "presets.json", {"recommendation": answers[0], "recommendations": answers, "presets": answers})
    write_csv(folder / "pockets.csv", pockets(answers))
    tests = cutting_tests()
    write_csv(folder / "chatter.csv", tests)
    write_groups(folder / "spectra.nc", {f"test_{i + 1}": spectrum(row) for i, row in tests.iterrows()})
    write_csv(folder / "comparison.csv", comparison())
    write_csv(folder / "explained.csv", explained())
    write_csv(folder / "model_error.csv", model_error())
    write_csv(folder / "tables" / "hammer_idle.hits.csv", hits(21))
    write_csv(folder / "tables" / "other.v2.hits.csv", hits(40))
    passes = pd.DataFrame(
        {"pass": ["down", "up", "central"], "duration_s": [41.0, 40.2, 39.9], "from_rest_to_rest": True}
    )
    write_csv(folder / "tables" / "sweep.passes.csv", passes)
    provenance = {
        "campaign": name,
        "created": "2026-11-21T06:00:00+00:00",
        "versions": {"smfe": "0.1.0", "numpy": "2.4"},
        "inputs": [{"file": "hx_1.csv", "sha256": "0" * 64}],
        "seconds": {"identify": 12.3, "lobes": 0.8},
        "warnings": ["hammer_idle: 1 of 21 hits is overloaded", "cut_600.csv: undecided"],
    }
    write_json(folder / "provenance.json", provenance)
    return folder


def write_reported(folder: Path) -> Path:
    """Write the sample and its page and figures, for `kept`."""
    write_sample(folder)
    write_report(folder)
    return folder


def write_single(folder: Path) -> Path:
    """Write what one hammer on one axis leaves behind."""
    frequency = np.arange(5.0, 300.0, 0.5)
    dataset = MACHINE.compliance(frequency, ["x"], ["x"]).assign_attrs(method="hammer")
    std = np.where(frequency[:, None, None] < 20.0, np.nan, 2e-9)
    dataset["compliance_std"] = (("frequency", "response", "excitation"), std)
    dataset["coherence"] = (("frequency", "response", "excitation"), np.full(std.shape, 0.98))
    write_groups(folder / "frf.nc", {"tap": dataset})
    return folder
