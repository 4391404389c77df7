"""`smfe pitch`: the pitch that is written raises the limit that another method finds, and is a key of the campaign."""

import json
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner, Result

import process
import smfe
from process.errors import InputError
from smfe.cli import app
from stability import multi_frequency

CAMPAIGN = """
[campaign]
name = "bench"
[tool]
diameter = "16 mm"
teeth = 2{pitch}
[material]
Ktc = "600 N/mm^2"
Krc = "200 N/mm^2"
Kac = "0 N/mm^2"
[spindle]
minimum = "3000 rpm"
maximum = "14000 rpm"
[[model]]
name = "classic"
modes = [{{ frequency = "922 Hz", damping = 0.011, stiffness = "1.34 N/um", direction = [1, 0, 0] }}]
[[lobes]]
measurements = ["classic"]
method = "semi_discretization"
cut = "down"
width_of_cut = "8 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["4600 rpm", "5400 rpm", "100 rpm"]
"""


def written(folder: Path, text: str = CAMPAIGN.format(pitch="")) -> Path:
    file = folder / "bench.toml"
    file.write_text(text)
    return file


def invoked(*words: object) -> Result:
    return CliRunner().invoke(app, [str(w) for w in words], env={"COLUMNS": "80", "TERM": "dumb"})


@pytest.fixture(scope="module")
def design(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pitch")
    done = invoked("pitch", written(folder), "--speed", "5000 rpm", "-o", folder / "pitch", "--json", "-q")
    assert done.exit_code == 0, done.output
    return folder, json.loads(done.stdout)


def test_the_line_is_a_key_of_the_tool_and_the_campaign_with_it_has_the_limits_of_the_table(design):
    folder, said = design
    assert {p.name for p in (folder / "pitch").iterdir()} == {"pitch.toml", "pitch.csv", "figures"}
    text = (folder / "pitch" / "pitch.toml").read_text()
    assert said["line"] in text
    assert said["gain"] > 3.0
    table = pd.read_csv(folder / "pitch" / "pitch.csv")
    about = table[table["verified"] == 1]
    assert len(about) == 5
    assert about["limit_depth_mm"].min() == pytest.approx(said["limit_mm"], rel=2e-3)
    assert about["equal_limit_depth_mm"].min() == pytest.approx(said["equal_limit_mm"], rel=2e-3)
    other = written(folder, CAMPAIGN.format(pitch="\n" + said["line"]))
    assert np.degrees(smfe.read_campaign(other).tool.pitch_angles) == pytest.approx(said["pitch_angles_deg"])
    lobes = smfe.lobes(other)[0].lobes["limit_depth"]
    both = table.set_index("spindle_speed_rpm")["limit_depth_mm"].reindex(lobes["spindle_speed"].values)
    np.testing.assert_allclose(both, lobes, rtol=2e-3)


def test_a_method_that_shares_no_step_in_time_finds_both_limits(design):
    _, said = design
    machine = process.ModalModel([922.0], [0.011], [1.34e6], [[1.0, 0.0, 0.0]])
    rest = process.engagement("down", 8e-3, 16e-3), process.CuttingCoefficients(6e8, 2e8, 0.0)
    row = said["verified"][2]
    for pitch, key in ((said["pitch_angles_deg"], "limit_depth_mm"), (None, "equal_limit_depth_mm")):
        tool = process.Tool(16e-3, 2, pitch_angles=None if pitch is None else tuple(map(math.radians, pitch)))
        found = multi_frequency(machine, tool, *rest, [row["spindle_speed_rpm"]])
        assert float(found["limit_depth"][0]) == pytest.approx(row[key], rel=0.01)


def test_what_cannot_be_asked_is_refused_and_nothing_is_written(tmp_path):
    file, out = written(tmp_path), tmp_path / "pitch"
    for words, text in (
        (("--speed", "20000 rpm"), "not among the speeds of [spindle]"),
        (("--speed", "5000 rpm", "--lobes", "lobes_7"), "no lobes 'lobes_7'; the campaign has 'lobes_1'"),
        (("--speed", "5000 rpm", "--measurement", "taps"), "names 'taps'; the measurements there are 'classic'"),
        (("--speed", "5000 rpm", "--around", "0"), "around is 0"),
        (("--speed", "5000"), "unit"),
    ):
        done = invoked("pitch", file, *words, "-o", out)
        assert done.exit_code == 1, done.output
        assert text in " ".join(done.output.split())
    assert not out.exists()
    without = written(tmp_path, CAMPAIGN.format(pitch="").split("[[lobes]]")[0])
    with pytest.raises(InputError, match=r"add a \[\[lobes\]\] table"):
        smfe.pitch(without, "5000 rpm")
    with pytest.raises(InputError, match="overwrite their own input"):
        smfe.pitch(written(tmp_path).rename(tmp_path / "pitch.toml"), 5000, tmp_path)


def test_a_measured_compliance_is_designed_for_by_its_modes(tmp_path, design):
    """The compliance of the same mode as a file of responses: the design is that of the declared mode."""
    f = np.arange(300.0, 2000.0, 2.0)
    machine = process.ModalModel([922.0], [0.011], [1.34e6], [[1.0, 0.0, 0.0]])
    phi = machine.compliance(f)["compliance"].sel(response="x", excitation="x").values
    pd.DataFrame({"f": f, "re": phi.real, "im": phi.imag}).to_csv(tmp_path / "xx.csv", index=False)
    measured = """
[[measurement]]
name = "classic"
method = "frf"
records = [{ file = "xx.csv", response = "x", excitation = "x" }]
[measurement.channels]
frequency = { column = "f", unit = "Hz" }
compliance_real = { column = "re", unit = "m/N" }
compliance_imag = { column = "im", unit = "m/N" }
[[lobes]]"""
    head, tail = CAMPAIGN.format(pitch="").split("[[model]]")
    text = (
        head
        + measured
        + tail.split("[[lobes]]")[1].replace('"4600 rpm", "5400 rpm", "100 rpm"', '"4900 rpm", "5100 rpm"')
    )
    with pytest.warns(smfe.SmfeWarning, match="modes fitted to the measured compliance"):
        found = smfe.pitch(written(tmp_path, text), "5000 rpm")
    assert found.least_mm == pytest.approx(design[1]["limit_mm"], rel=0.02)
