"""`smfe tune` from a campaign: a machine model, and measured responses; what is written, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from typer.testing import CliRunner, Result

import smfe
from process import Drive, Machine
from process.errors import InputError
from smfe.cli import app

HEAD = """
[campaign]
name = "Bench"
[tool]
diameter = "50.8 mm"
teeth = 4
[material]
Ktc = "780 N/mm^2"
Krc = "351 N/mm^2"
"""
MACHINE = """
[machine.axis.x]
moving_mass = "23.1 kg"
tip_mass = "11.3 kg"
stiffness = "1.68 N/um"
damping = "104 N s/m"
[machine.axis.x.controllers]
K2 = { Kp = "6268 N s/m", Ti = "10.9 ms", Kv = "45.5 1/s", delay = "0.75 ms" }
K4 = { Kp = "18804 N s/m", Ti = "3.6 ms", Kv = "136.6 1/s", delay = "0.75 ms" }
"""
TUNE = """
[tune]
goal = "least_depth"
spindle_speed = ["800 rpm", "2500 rpm"]
cut = "up"
width_of_cut = "50.8 mm"
robust = "0 %"
"""


def invoked(*words: object) -> Result:
    return CliRunner().invoke(app, [str(w) for w in words], env={"COLUMNS": "80", "TERM": "dumb"})


@pytest.mark.usefixtures("hurried")
def test_the_gains_that_are_written_are_a_controller_of_the_campaign(tmp_path: Path) -> None:
    file, out = tmp_path / "bench.toml", tmp_path / "tuned"
    file.write_text(HEAD + MACHINE + TUNE)
    done = invoked("tune", file, "-o", out, "--json", "-q")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert said["unit"] == "mm"
    assert said["worst"] > 2.4
    assert [row["gains"] for row in said["sets"]][:3] == ["tuned", "K2", "K4"]
    assert any(line.startswith("K2: 1.9") and "falls short by" in line for line in said["summary"])
    assert {p.name for p in out.iterdir()} == {"gains.toml", "tuning.csv", "tuning.nc", "figures"}
    file.write_text(HEAD + MACHINE + (out / "gains.toml").read_text() + TUNE)
    machine = smfe.read_campaign(file).machine_model
    assert isinstance(machine, Machine)
    servo = machine.axes["x"].controller("tuned")
    assert servo is not None
    for name, value in said["gains"]["x"].items():
        assert getattr(servo, name) == pytest.approx(value, rel=1e-5)
    table = pd.read_csv(out / "tuning.csv")
    assert table["worst_mm"][0] == pytest.approx(said["worst"])
    lobes = xr.open_dataset(out / "tuning.nc", group="lobes")
    assert float(lobes["limit_depth"].sel(gains="tuned").min()) == pytest.approx(said["worst"], rel=5e-3)


@pytest.mark.usefixtures("hurried")
def test_a_campaign_of_measured_responses_gives_gains_for_the_machine_that_was_measured(tmp_path: Path) -> None:
    """Compliance at rest as a file, and a record of commanded force and position: whole periods, at constant feed."""
    bench, delay, rate, period = Drive(23.1, 11.3, 1.68e6, 104.0), 0.75e-3, 2000.0, 2.0
    f = np.arange(1.0, 400.0, 0.25)
    s = 2j * np.pi * f
    phi = 1.0 / (11.3 * s**2 + 104.0 * s + 1.68e6)
    pd.DataFrame({"f": f, "re": phi.real, "im": phi.imag}).to_csv(tmp_path / "rest.csv", index=False)
    n = round(rate * period)
    lines = np.arange(1, 800)
    force, position = np.zeros(n // 2 + 1, dtype=complex), np.zeros(n // 2 + 1, dtype=complex)
    force[lines] = 20.0 * np.exp(2j * np.pi * np.random.default_rng(1).uniform(size=lines.size))
    position[lines] = force[lines] * bench.open_loop(lines / period, delay)
    t = np.arange(4 * n) / rate
    record = {
        "t": t,
        "force": np.tile(np.fft.irfft(force), 4),
        "position": np.tile(np.fft.irfft(position), 4) + 0.05 * t,
    }
    pd.DataFrame(record).to_csv(tmp_path / "prbs.csv", index=False)
    measured = """
[[measurement]]
name = "rest"
method = "frf"
records = [{ file = "rest.csv", response = "x", excitation = "x" }]
[measurement.channels]
frequency = { column = "f", unit = "Hz" }
compliance_real = { column = "re", unit = "m/N" }
compliance_imag = { column = "im", unit = "m/N" }
[[measurement]]
name = "prbs"
method = "drive"
records = [{ file = "prbs.csv" }]
[measurement.channels]
time = { column = "t", unit = "s" }
drive_force_x = { column = "force", unit = "N" }
encoder_position_x = { column = "position", unit = "m" }
"""
    sources = """
[tune.measured]
at_rest = "rest"
tip_mass = "11.3 kg"
[tune.measured.axis.x]
open_loop = "prbs"
period = "2 s"
moving_mass = "34.4 kg"
dead_time = "0.75 ms"
"""
    file = tmp_path / "measured.toml"
    file.write_text(HEAD + measured + TUNE + sources)
    found = smfe.tune(file)
    machine = Machine.of_axis(Drive(23.1, 11.3, 1.68e6, 104.0, found.servos["x"])).at()
    assert machine.unstable_poles() == 0
    exact = smfe.lobes(
        machine.compliance(np.geomspace(2.0, 400.0, 4000)),
        tool={"diameter": "50.8 mm", "teeth": 4},
        material={"Ktc": "780 N/mm^2", "Krc": "351 N/mm^2"},
        cut="up",
        width_of_cut="50.8 mm",
        spindle_speed=(800.0, 2500.0),
    )
    assert float(exact["limit_depth"].min()) == pytest.approx(1e3 * found.best.goal, rel=0.02)
    file.write_text(HEAD + measured + TUNE + sources.replace('tip_mass = "11.3 kg"', ""))
    with pytest.raises(InputError, match=r"\[tune.measured\] lacks tip_mass"):
        smfe.tune(file)
    file.write_text(HEAD + measured + TUNE + sources.replace('open_loop = "prbs"', 'open_loop = "rest"'))
    with pytest.raises(InputError, match="is no measurement with method"):
        smfe.tune(file)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (HEAD + MACHINE, "needs [tune]"),
        (HEAD + TUNE, "there is no machine with axes, and nothing to tune"),
        (MACHINE + TUNE + '[campaign]\nname = "b"\n', "needs the table [tool]; add it"),
        (HEAD + MACHINE + TUNE + 'velocity_peak = "3"\n', "is no level; write it in decibels"),
        (HEAD + MACHINE + TUNE + "gain_margin = 6\n", "has no unit"),
        (HEAD + MACHINE + TUNE.replace("50.8 mm", "60 mm"), "is wider than the tool"),
        (HEAD + MACHINE + TUNE.replace('goal = "least_depth"', ""), "has no goal; say what the gains are for"),
    ],
)
def test_a_campaign_that_says_too_little_is_refused_and_nothing_is_written(
    text: str, said: str, tmp_path: Path
) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(text)
    done = invoked("tune", file, "-o", tmp_path / "tuned", "-q")
    assert done.exit_code == 1
    assert said in " ".join(done.stderr.split())
    assert not (tmp_path / "tuned").exists()
