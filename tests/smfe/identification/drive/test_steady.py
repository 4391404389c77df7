"""Friction from runs at constant velocity: Table 1 by command, ripple that slow runs do not average, stick-slip."""

import csv
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

import smfe
from process.labels import make_record
from smfe.identification.drive.parameters import identify_drive
from smfe.identification.drive.results import DriveFit, DriveParameter

MM_MIN = 1.0 / 6e4
RATE = 1000.0
FEEDS = np.array([25.0, 50.0, 100.0, 150.0, 200.0, 300.0, 400.0, 600.0, 1000.0, 1500.0, 2000.0, 3000.0]) * MM_MIN

TABLE_1 = {
    "forward": {"coulomb": 44.2, "static": 84.0, "stribeck_speed": 387.4 * MM_MIN, "viscous": 168.0},
    "backward": {"coulomb": 38.7, "static": 88.0, "stribeck_speed": 421.0 * MM_MIN, "viscous": 150.0},
}
"""Franco et al. 2024: friction of both directions, SI."""


def force_of(v: np.ndarray) -> np.ndarray:
    """Table 1 in steady sliding."""
    p = TABLE_1["forward" if v[0] > 0.0 else "backward"]
    size = np.abs(v)
    curve = p["coulomb"] + (p["static"] - p["coulomb"]) * np.exp(-size / p["stribeck_speed"]) + p["viscous"] * size
    return np.asarray(np.sign(v) * curve)


def run(
    feed: float, rng: np.random.Generator, constant: float = 0.0, ripple: float = 0.0, seconds: float = 1.5
) -> xr.Dataset:
    """A run from the middle of the stroke, where the ripple (period 20 mm) is greatest; 2 N noise, steps of 0.1 um."""
    v = np.full(round(seconds * RATE), feed)
    x = feed * np.arange(v.size) / RATE
    force = force_of(v) + constant + ripple * np.cos(2.0 * np.pi * x / 20e-3) + 2.0 * rng.standard_normal(v.size)
    place = 1e-7 * np.round((x + 1e-7 * rng.random()) / 1e-7)
    channels = {"encoder_position": {"x": place}, "drive_force": {"x": force}}
    return make_record(np.arange(v.size) / RATE, channels, attrs={"source": f"{feed / MM_MIN:.0f}.csv"})


def runs(seed: int, **more: float) -> list[xr.Dataset]:
    rng = np.random.default_rng(seed)
    return [run(sign * feed, rng, **more) for sign in (1.0, -1.0) for feed in FEEDS]


def of(fit: DriveFit, name: str, way: str) -> DriveParameter:
    return next(p for p in fit.parameters if (p.name, p.direction) == (name, way))


def test_table_1_comes_back_by_command_in_both_directions(tmp_path: Path) -> None:
    """`smfe identify` of 24 records, seed 1: every value within two standard deviations, and those below 3 %."""
    files = []
    for one in runs(1):
        files.append(one.attrs["source"])
        with (tmp_path / files[-1]).open("w", newline="") as file:
            written = csv.writer(file)
            written.writerow(["t", "x", "F"])
            values = (one["encoder_position"].values[0], one["drive_force"].values[0])
            written.writerows(zip(one["time"].values, *values, strict=True))
    records = ", ".join(f'{{ file = "{name}" }}' for name in files)
    (tmp_path / "campaign.toml").write_text(
        '[campaign]\nname = "bench"\n[channels]\ntime = { column = "t", unit = "s" }\n'
        'encoder_position_x = { column = "x", unit = "m" }\ndrive_force_x = { column = "F", unit = "N" }\n'
        f'[[measurement]]\nname = "friction"\nmethod = "drive"\nrecords = [{records}]\n',
        encoding="utf-8",
    )
    smfe.identify(tmp_path / "campaign.toml", tmp_path / "frf.nc")
    rows = {(r["direction"], r["parameter"]): r for r in pd.read_csv(tmp_path / "drives.csv").to_dict("records")}
    for way, truth in TABLE_1.items():
        for name, value in truth.items():
            row = rows[way, name]
            assert abs(row["value"] - value) < 2.0 * row["std"] < 0.06 * value, (way, name)
            assert row["low"] < value < row["high"]
    assert math.isnan(rows["both", "inertia"]["value"])


def test_a_constant_force_raises_one_way_and_lowers_the_other() -> None:
    plain, loaded = identify_drive("m", runs(2)), identify_drive("m", runs(2, constant=12.0))
    for way, sign in (("forward", 1.0), ("backward", -1.0)):
        for name in ("coulomb", "static"):
            assert of(loaded, name, way).value - of(plain, name, way).value == pytest.approx(12.0 * sign, abs=0.05)
        assert of(loaded, "viscous", way).value == pytest.approx(of(plain, "viscous", way).value, abs=1.0)
    assert of(loaded, "coulomb", "both").value == pytest.approx(of(plain, "coulomb", "both").value, abs=0.05)


def test_a_ripple_that_slow_runs_do_not_average_is_taken_off() -> None:
    """Below 400 mm/min no run crosses half a period: their means are wrong by up to the 6 N, in both directions."""
    fit = identify_drive("m", runs(3, ripple=6.0))
    assert any("period 0.02 m" in note for note in fit.notes)
    for way, truth in TABLE_1.items():
        for name, value in truth.items():
            row = of(fit, name, way)
            assert row.low < value < row.high, (way, name)
        assert of(fit, "static", way).value == pytest.approx(truth["static"], abs=1.0)
    points = fit.friction[fit.friction["kind"] == "steady run"]
    exact = np.array([force_of(np.array([v]))[0] for v in points["velocity"]])
    assert np.mean((points["low"] < exact) & (exact < points["high"])) > 0.8
    assert np.abs(points["force"] - exact).max() < 1.0


def test_a_record_that_sticks_and_slips_is_left_out_and_said() -> None:
    rng = np.random.default_rng(4)
    t = np.arange(1500) / RATE
    jerky = 50.0 * MM_MIN * (t + 0.9 * np.sin(2.0 * np.pi * 3.0 * t) / (2.0 * np.pi * 3.0))
    slip = {"encoder_position": {"x": jerky}, "drive_force": {"x": 60.0 + 2.0 * rng.standard_normal(t.size)}}
    fit = identify_drive("m", [*runs(4), make_record(t, slip)])
    assert any("1 record without a run at constant velocity" in note for note in fit.notes)
    for name, value in TABLE_1["forward"].items():
        assert of(fit, name, "forward").low < value < of(fit, name, "forward").high


def test_runs_without_a_rise_towards_rest_state_none() -> None:
    """Coulomb and viscous friction alone, and the four slowest feeds left out: no Stribeck curve to be seen."""
    rng = np.random.default_rng(5)
    records = []
    for sign in (1.0, -1.0):
        for feed in FEEDS[4:]:
            one = run(sign * feed, rng)
            force = sign * (40.0 + 160.0 * feed) + 2.0 * rng.standard_normal(one.sizes["time"])
            records.append(one.assign(drive_force=(one["drive_force"].dims, force[None, :])))
    fit = identify_drive("m", records)
    for way in ("forward", "backward"):
        assert of(fit, "coulomb", way).low < 40.0 < of(fit, "coulomb", way).high
        assert of(fit, "viscous", way).low < 160.0 < of(fit, "viscous", way).high
        for name in ("static", "stribeck_speed"):
            assert math.isnan(of(fit, name, way).value)
            assert "no rise of friction towards rest" in of(fit, name, way).note


@pytest.mark.slow
def test_a_known_mass_takes_what_is_left_of_the_acceleration() -> None:
    """Each run slows down by 1 % of its speed: 20 t then take 133 N s/m off the viscous friction."""
    rng = np.random.default_rng(6)
    records = []
    for sign in (1.0, -1.0):
        for feed in FEEDS:
            t = np.arange(1500) / RATE
            v = sign * feed * (1.005 - 0.01 * t / t[-1])
            a = -sign * feed * 0.01 / t[-1]
            force = force_of(v) + 2e4 * a + 0.01 * rng.standard_normal(t.size)
            channels = {"encoder_position": {"x": np.cumsum(v) / RATE}, "drive_force": {"x": force}}
            records.append(make_record(t, channels))
    fit = identify_drive("m", records, known=(2e4, "mass"))
    assert not any(p.name == "inertia" for p in fit.parameters)
    for way, truth in TABLE_1.items():
        assert of(fit, "viscous", way).value == pytest.approx(truth["viscous"], rel=0.01)
    without = identify_drive("m", records)
    assert of(without, "viscous", "forward").value == pytest.approx(168.0 - 2e4 * 0.01 / 1.5, abs=4.0)
