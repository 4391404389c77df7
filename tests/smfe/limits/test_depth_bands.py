"""All bands of depth of a campaign: those of the published benchmark, confirmed by the map over one period."""

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
from smfe.limits.depth_bands import AGAIN, FIRST, LOST
from stability import floquet_multipliers

STIFFNESS = 0.03993 * (2.0 * math.pi * 922.0) ** 2
CAMPAIGN = f"""
[campaign]
name = "benchmark"
[tool]
diameter = "10 mm"
teeth = 2
[material]
Ktc = "600 N/mm^2"
Krc = "200 N/mm^2"
Kac = "0 N/mm^2"
[[model]]
name = "one mode"
modes = [{{ frequency = "922 Hz", damping = 0.011, stiffness = "{STIFFNESS:.9g} N/m", direction = [1, 0, 0] }}]
[[lobes]]
measurements = ["one mode"]
method = "semi_discretization"
cut = "down"
width_of_cut = "5 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["9600 rpm", "10400 rpm", "100 rpm"]
bands_up_to = "4 mm"
"""


def invoked(*words: object) -> Result:
    return CliRunner().invoke(app, [str(w) for w in words], env={"COLUMNS": "80", "TERM": "dumb"})


@pytest.fixture(scope="module")
def computed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict, pd.DataFrame]:
    folder = tmp_path_factory.mktemp("bands")
    (folder / "campaign.toml").write_text(CAMPAIGN)
    files = ("-o", folder / "lobes.nc", "--table", folder / "table.csv", "--bands", folder / "bands.csv")
    done = invoked("lobes", folder / "campaign.toml", *files, "--json", "-q")
    assert done.exit_code == 0, done.output
    return folder, json.loads(done.stdout), pd.read_csv(folder / "bands.csv")


def test_the_island_of_the_published_benchmark_is_in_the_table_and_in_a_picture(computed):
    """Unstable from 2.1047 mm, stable again from 2.312, unstable from 2.353 mm (checked reference, 10000 rpm)."""
    folder, said, bands = computed
    at = bands[bands["spindle_speed_rpm"] == 10000.0]
    np.testing.assert_allclose(at["from_mm"], [0.0, 2.1047, 2.312, 2.353], rtol=5e-4)
    assert at["band"].tolist() == [FIRST, LOST, AGAIN, LOST]
    assert at["kind"].tolist() == ["none", "flip", "flip", "hopf"]
    assert said["bands"] == str(folder / "bands.csv")
    assert (folder / "bands_lobes_1_one_mode.png").stat().st_size > 10_000
    limit = pd.read_csv(folder / "table.csv").set_index("spindle_speed_rpm")["limit_depth_mm"]
    first = bands[bands["band"] == FIRST].set_index("spindle_speed_rpm")["to_mm"]
    np.testing.assert_allclose(first, limit, rtol=2e-3)


def test_the_map_over_one_period_sees_the_same_bands(computed):
    machine = process.ModalModel([922.0], [0.011], [STIFFNESS], [[1.0, 0.0, 0.0]])
    cut = process.Tool(10e-3, 2), process.engagement("down", 5e-3, 10e-3), process.CuttingCoefficients(6e8, 2e8, 0.0)
    rng, seen = np.random.default_rng(5), set()
    for _, row in computed[2].iterrows():
        depth = row["from_mm"] + rng.uniform(0.1, 0.9) * (row["to_mm"] - row["from_mm"])
        largest = abs(floquet_multipliers(machine, *cut, 1e-3 * depth, row["spindle_speed_rpm"])[0])
        assert (largest < 1.0) == (row["band"] != LOST), (row, depth, largest)
        seen.add(row["band"])
    assert seen == {FIRST, LOST, AGAIN}


@pytest.mark.slow
def test_a_run_has_them_beside_its_lobes_and_takes_them_away_with_the_question(tmp_path):
    file, out = tmp_path / "campaign.toml", tmp_path / "results"
    short = CAMPAIGN.replace('["9600 rpm", "10400 rpm", "100 rpm"]', '["9900 rpm", "10100 rpm", "100 rpm"]')
    file.write_text(short)
    smfe.run(file, out)
    assert len(pd.read_csv(out / "bands.csv")) > 3
    assert [p.name for p in (out / "figures").glob("bands_*.png")] == ["bands_lobes_1_one_mode.png"]
    assert "bands.csv" in (out / "report.html").read_text(encoding="utf-8")
    file.write_text(short.replace('bands_up_to = "4 mm"\n', ""))
    smfe.run(file, out)
    assert not (out / "bands.csv").exists()
    assert not list((out / "figures").glob("bands_*.png"))


def test_bands_are_asked_of_the_method_that_finds_them_all(tmp_path):
    file = tmp_path / "campaign.toml"
    file.write_text(CAMPAIGN.replace("semi_discretization", "zero_order"))
    with pytest.raises(InputError, match='found by method = "semi_discretization" alone'):
        smfe.read_campaign(file)


def test_a_helix_makes_an_island_of_period_doubling(tmp_path):
    """Unstable from 1.1605 to 1.6107 mm, below the helix pitch of 3.14 mm; straight edges from 0.96 mm."""
    text = CAMPAIGN.replace('diameter = "10 mm"', 'diameter = "2 mm"\nhelix_angle = "45 deg"')
    text = text.replace('["9600 rpm", "10400 rpm", "100 rpm"]', '["54000 rpm", "54500 rpm", "500 rpm"]')
    (tmp_path / "campaign.toml").write_text(text.replace('"5 mm"', '"0.1 mm"').replace('"4 mm"', '"3 mm"'))
    files = ("-o", tmp_path / "lobes.nc", "--table", tmp_path / "table.csv", "--bands", tmp_path / "bands.csv")
    done = invoked("lobes", tmp_path / "campaign.toml", *files, "-q")
    assert done.exit_code == 0, done.output
    bands = pd.read_csv(tmp_path / "bands.csv").set_index("spindle_speed_rpm").loc[54500.0]
    np.testing.assert_allclose(bands["from_mm"], [0.0, 1.1605, 1.6107], rtol=1e-3)
    assert bands["band"].tolist() == [FIRST, LOST, AGAIN]
    limit = pd.read_csv(tmp_path / "table.csv").set_index("spindle_speed_rpm")["limit_depth_mm"]
    assert limit[54500.0] == pytest.approx(1.1605, rel=1e-3)
