"""Section 5.1 of Franco et al. 2024 from a scenario: friction of both directions and the open loop, by two commands."""

from pathlib import Path

import pandas as pd
import pytest

import smfe
from smfe.campaign import load_campaign
from smfe.results import read_groups

FEEDS = (25, 50, 100, 150, 200, 300, 400, 600, 1000, 1500, 2000, 3000)

SCENARIO = f"""
[scenario]
name = "bench, Section 5.1"
seed = 1
sample_rate = "4000 Hz"
[machine.axis.x]
moving_mass = "23.1 kg"
tip_mass = "11.3 kg"
stiffness = "1.68 N/um"
damping = "104 N s/m"
controllers.K2 = {{ Kp = "6268 N s/m", Ti = "10.9 ms", Kv = "45.5 1/s", delay = "0.75 ms" }}
controllers.K3 = {{ Kp = "10590 N s/m", Ti = "6.5 ms", Kv = "76.9 1/s" }}
[machine.axis.x.friction]
law = "andersson"
coulomb = "44.2 N"
static = "84 N"
stribeck_speed = "387.4 mm/min"
sigma = "0.0028 N min/mm"
kt = "0.25 min/mm"
negative = {{ coulomb = "38.7 N", static = "88 N", stribeck_speed = "421 mm/min", sigma = "0.0025 N min/mm" }}
[sensors]
encoder = {{ resolution = "0.1 um" }}
[[trial]]
name = "friction"
method = "drive"
axis = "x"
duration = "1 s"
controller = "K3"
feed = {[f"{sign * feed} mm/min" for sign in (1, -1) for feed in FEEDS]}
[[trial]]
name = "open loop"
method = "drive"
axis = "x"
signal = "prbs"
force = "5 N"
clock = "500 Hz"
bits = 9
periods = 4
controller = "K2"
feed = "500 mm/min"
""".replace("'", '"')

TABLE_1 = {
    ("friction", "coulomb", "forward"): 44.2,
    ("friction", "coulomb", "backward"): 38.7,
    ("friction", "static", "forward"): 84.0,
    ("friction", "static", "backward"): 88.0,
    ("friction", "stribeck_speed", "forward"): 387.4 / 6e4,
    ("friction", "stribeck_speed", "backward"): 421.0 / 6e4,
    ("friction", "viscous", "forward"): 168.0,
    ("friction", "viscous", "backward"): 150.0,
    ("open loop", "moving_mass", "forward"): 23.1,
    ("open loop", "tip_mass", "forward"): 11.3,
    ("open loop", "stiffness", "forward"): 1.68e6,
    ("open loop", "damping", "forward"): 104.0,
    ("open loop", "delay", "forward"): 0.75e-3,
    ("open loop", "anti_resonance", "forward"): 61.37,
    ("open loop", "resonance", "forward"): 74.89,
}


@pytest.mark.slow
def test_table_1_of_the_bench_comes_back_by_two_commands(tmp_path: Path) -> None:
    (tmp_path / "bench.toml").write_text(SCENARIO, encoding="utf-8")
    campaign = smfe.simulate(tmp_path / "bench.toml", tmp_path / "campaign")
    friction, loop = load_campaign(campaign).measurements
    assert (friction.method, len(friction.records), loop.method) == ("drive", 2 * len(FEEDS), "open_loop")
    page = smfe.run(campaign, tmp_path / "results")
    table = pd.read_csv(tmp_path / "results" / "drives.csv").to_dict("records")
    rows = {(r["measurement"], r["parameter"], r["direction"]): r for r in table}
    for key, value in TABLE_1.items():
        row = rows[key]
        assert abs(row["value"] - value) < max(2.0 * row["std"], 0.005 * value), key
    assert set(read_groups(tmp_path / "results" / "open_loops.nc")) == {"open loop/forward"}
    assert {"drive_1.png", "open_loop_1.png"} <= {p.name for p in (tmp_path / "results" / "figures").iterdir()}
    assert "open loop: carriage over drive force" in page.read_text(encoding="utf-8")
