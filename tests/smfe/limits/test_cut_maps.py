"""Maps over speed and depth by a campaign, and the pocket within power, torque, deflection and surface error."""

import json
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from typer.testing import CliRunner

import process
import smfe
import stability
from process.cut.force import mean_torque
from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.cli import app
from smfe.limits.campaign_lobes import all_lobes
from smfe.limits.recommendation import recommend
from smfe.progress import silent

CAMPAIGN = """
[campaign]
name = "maps"
[tool]
diameter = "16 mm"
teeth = 4
{tool}
[material]
Ktc = "700 N/mm^2"
Krc = "250 N/mm^2"
Kac = "100 N/mm^2"
Kte = "10 N/mm"
uncertainty = "5 %"
[spindle]
step = "50 rpm"
{spindle}
[[model]]
name = "spindle"
modes = [
    {{ frequency = "922 Hz", damping = 0.03, stiffness = "9 N/um", direction = [1, 0, 0] }},
    {{ frequency = "1010 Hz", damping = 0.03, stiffness = "8 N/um", direction = [0, 1, 0] }},
]
uncertainty = {{ stiffness = "5 %" }}
[[lobes]]
measurements = ["spindle"]
method = "{method}"
cut = "down"
width_of_cut = "4 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["10000 rpm", "14000 rpm", "100 rpm"]
maximum_depth = "6 mm"
{more}
"""
MODES = process.ModalModel([922.0, 1010.0], [0.03, 0.03], [9e6, 8e6], np.eye(2, 3))
TOOL, ARC = process.Tool(16e-3, 4), process.engagement("down", 4e-3, 16e-3)
ALUMINIUM = process.CuttingCoefficients(7e8, 2.5e8, 1e8, 1e4)


def campaign(folder: Path, more="", spindle="", method="zero_order", tool="") -> smfe.Campaign:
    path = folder / "campaign.toml"
    path.write_text(CAMPAIGN.format(more=more, spindle=spindle, method=method, tool=tool))
    return load_campaign(path)


def answer(folder: Path, *given, **more):
    loaded = campaign(folder, *given, **more)
    found = all_lobes(loaded, {"spindle": MODES.compliance(np.arange(300.0, 2500.0, 2.0))}, silent)
    return recommend(found, loaded), found


def test_by_command_there_are_arrays_a_table_and_a_picture(tmp_path):
    campaign(tmp_path, 'maps_up_to = "8 mm"', method="semi_discretization")
    files = ["-o", "l.nc", "--table", "t.csv", "--maps", "m.nc"]
    words = [w if w.startswith("-") else str(tmp_path / w) for w in files]
    done = CliRunner().invoke(app, ["lobes", str(tmp_path / "campaign.toml"), *words, "--json", "-q"])
    assert done.exit_code == 0, done.output
    names = [Path(name).name for name in json.loads(done.stdout)["written"]]
    assert names == ["l.nc", "t.csv", "m.nc", "m.csv", "m_lobes_1_spindle.png"]
    assert all((tmp_path / name).stat().st_size > 1000 for name in names)
    maps = xr.open_datatree(tmp_path / "m.nc", engine="h5netcdf")["lobes_1/spindle"].to_dataset()
    expected = stability.cut_maps(MODES, TOOL, ARC, ALUMINIUM, [1e-3, 4e-3], 1e-4, [12000.0])
    at = maps.sel(spindle_speed=12000.0, depth_of_cut=[1.0, 4.0])
    np.testing.assert_allclose(at["deflection"], expected["deflection"][0], rtol=1e-9)
    np.testing.assert_allclose(at["surface_error_down"], expected["surface_error"].sel(wall="down")[0], rtol=1e-9)
    table, limits = pd.read_csv(tmp_path / "m.csv"), pd.read_csv(tmp_path / "t.csv")
    assert len(table) == 41 * 40
    assert {"vibration_x_um", "surface_error_down_um", "peak_force_N", "spindle_power_kW"} < set(table)
    limit = table["spindle_speed_rpm"].map(limits.set_index("spindle_speed_rpm")["limit_depth_mm"])
    assert (table["stable"] == (table["depth_of_cut_mm"] < limit.fillna(math.inf))).all()
    assert table["stable"].nunique() == 2


@pytest.mark.slow
def test_a_run_shows_them_and_takes_them_away_with_the_question(tmp_path):
    campaign(tmp_path, 'maps_up_to = "4 mm"')
    smfe.run(tmp_path / "campaign.toml", tmp_path / "out")
    assert {"maps.nc", "maps.csv"} <= {p.name for p in (tmp_path / "out").iterdir()}
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "maps.csv" in page
    assert "data:image/png;base64," in page
    assert [p.name for p in (tmp_path / "out" / "figures").glob("maps*")] == ["maps_lobes_1_spindle.png"]
    campaign(tmp_path)
    smfe.run(tmp_path / "campaign.toml", tmp_path / "out")
    assert not list((tmp_path / "out").glob("maps*"))
    assert not list((tmp_path / "out" / "figures").glob("maps*"))


POWER = 'spindle_power = "0.5 kW"'
TORQUE = 'spindle_torque = "0.4 N m"'
DEFLECTION = 'deflection = "20 um"'
WALL = 'surface_error = "4 um"'


@pytest.mark.parametrize(
    ("more", "what", "unit"),
    [
        (POWER, "the power of the spindle", "0.5 kW"),
        (TORQUE, "the torque of the spindle", "0.4 N m"),
        (DEFLECTION, "the deflection of the tool", "20 um"),
        (WALL, "the error of the wall", "4 um"),
    ],
)
def test_the_pocket_keeps_within_what_is_allowed_and_says_how_much_it_takes(tmp_path, more, what, unit):
    answers, _ = answer(tmp_path, more)
    best = answers.best
    assert best.status == "recommended"
    said = re.fullmatch(rf"{what}: ([0-9.]+) of {unit}", best.limited_by)
    assert said, best.limited_by
    assert f"The depth is limited by {best.limited_by}." in best.reason
    assert answers.pockets["limited_by"][0] == best.limited_by
    # What the cut takes, found anew, at the speeds that the spindle may turn about the one that is set.
    depth, allowed = 1e-3 * best.depth_of_cut_mm, float(unit.split()[0])
    speeds = best.spindle_speed_rpm * np.array([0.99, 0.995, 1.0, 1.005, 1.01])
    torque = mean_torque(TOOL, ARC, ALUMINIUM, 1e-4)
    maps = stability.cut_maps(MODES, TOOL, ARC, ALUMINIUM, [depth, depth + 1e-4], 1e-4, speeds)
    taken = {
        POWER: lambda k: 1e-3 * torque * (depth + 1e-4 * k) * best.spindle_speed_rpm * math.pi / 30.0,
        TORQUE: lambda k: torque * (depth + 1e-4 * k),
        DEFLECTION: lambda k: float(maps["deflection"][:, k].max()),
        WALL: lambda k: float(np.abs(maps["surface_error"][:, k]).max()),
    }[more]
    assert taken(0) <= allowed * 1.001
    # A step deeper would be too much; the speeds of the request are 1 % apart, and the worst of the next two counts.
    assert taken(1) > allowed * 0.97
    assert float(said[1]) == pytest.approx(taken(0), rel=0.06)
    free = answer(tmp_path)[0].best
    assert free.depth_of_cut_mm > best.depth_of_cut_mm


def test_the_one_that_binds_is_named(tmp_path):
    assert answer(tmp_path)[0].best.limited_by == "the greatest depth that is asked for"
    assert "power" in answer(tmp_path, f'spindle_power = "0.1 kW"\n{DEFLECTION}')[0].best.limited_by
    tight = 'deflection = "5 um"'
    assert "deflection" in answer(tmp_path, f"{POWER}\n{tight}")[0].best.limited_by
    # The spindle and the request: the smaller of both.
    loose = answer(tmp_path, 'spindle_power = "9 kW"', 'power = "0.5 kW"')[0].best
    assert loose.limited_by.endswith("of 0.5 kW")


def test_chatter_is_named_where_it_binds(tmp_path):
    loaded = campaign(tmp_path, 'deflection = "1 mm"')
    text = loaded.path.read_text().replace('"10000 rpm", "14000 rpm", "100 rpm"', '"8300 rpm", "9000 rpm", "50 rpm"')
    loaded.path.write_text(text)
    loaded = load_campaign(loaded.path)
    found = all_lobes(loaded, {"spindle": MODES.compliance(np.arange(300.0, 2500.0, 2.0))}, silent)
    assert recommend(found, loaded).best.limited_by == "chatter"


@pytest.mark.parametrize(
    ("more", "tool", "said"),
    [
        ('maps_up_to = "4 mm"', 'helix_angle = "30 deg"', "needs straight teeth on one circle"),
        (WALL, 'runout = ["10 um", "0 um", "0 um", "0 um"]', "needs straight teeth on one circle"),
        ('maps_up_to = "4 mm"\nprocess_damping = "20 N/mm"', "", "known of a sharp edge alone"),
        ('maps_up_to = "0 mm"', "", "must be positive"),
    ],
)
def test_what_cannot_be_mapped_is_refused(tmp_path, more, tool, said):
    with pytest.raises(InputError, match=said):
        campaign(tmp_path, more, tool=tool)


def test_a_surface_error_of_a_cut_without_a_wall_is_refused(tmp_path):
    loaded = campaign(tmp_path, WALL)
    loaded.path.write_text(loaded.path.read_text().replace('cut = "down"', 'cut = "central"'))
    with pytest.raises(InputError, match="leaves no wall"):
        all_lobes(load_campaign(loaded.path), {"spindle": MODES.compliance(np.arange(300.0, 2500.0, 2.0))}, silent)


def test_lobes_in_memory_keep_what_is_allowed():
    tables = {"Ktc": 7e8, "Krc": 2.5e8, "Kac": 1e8, "Kte": 1e4, "uncertainty": 0.05}
    given = {"cut": "down", "width_of_cut": "4 mm", "feed_per_tooth": "0.1 mm", "maximum_depth": "6 mm"}
    measured = {"spindle": MODES.compliance(np.arange(300.0, 2500.0, 2.0))}
    found = smfe.lobes(measured, TOOL, tables, **given, spindle_speed=(10000, 14000, 100), spindle_power="0.5 kW")
    best = smfe.recommendation(found, TOOL, tables)
    assert best.status == "limit_only"  # no error of the compliance is known
    row_power = smfe.lobes(measured, TOOL, tables, **given, spindle_speed=(10000, 14000, 100), deflection="20 um")
    assert "deflection_depth" in row_power["spindle"]
    assert row_power["spindle"].attrs["deflection_um"] == pytest.approx(20.0)
    smfe.recommendation(row_power, TOOL, tables)


def test_limits_over_width_and_speed_are_those_of_each_width(tmp_path):
    loaded = campaign(tmp_path)
    ranged = loaded.path.read_text().replace('width_of_cut = "4 mm"', 'width_of_cut = ["2 mm", "16 mm", "7 mm"]')
    loaded.path.write_text(ranged.replace('"100 rpm"', '"500 rpm"'))
    words = ["lobes", "campaign.toml", "-o", "l.nc", "--table", "t.csv", "--widths", "w.nc"]
    words = [str(tmp_path / w) if "." in w else w for w in words]
    done = CliRunner().invoke(app, [*words, "--json", "-q"])
    assert done.exit_code == 0, done.output
    names = [Path(name).name for name in json.loads(done.stdout)["written"]]
    assert names == ["l.nc", "t.csv", "w.nc", "w.csv", "w_lobes_1_spindle.png"]
    found = xr.open_datatree(tmp_path / "w.nc", engine="h5netcdf")["lobes_1/spindle"].to_dataset()
    assert found["limit_depth"].dims == ("width_of_cut", "spindle_speed")
    assert found["width_of_cut"].values.tolist() == [2.0, 9.0, 16.0]
    table, rows = pd.read_csv(tmp_path / "t.csv"), pd.read_csv(tmp_path / "w.csv")
    for width in (2.0, 9.0, 16.0):
        own = table[table["width_of_cut_mm"] == width]
        at = found.sel(width_of_cut=width)
        np.testing.assert_allclose(at["limit_depth"], own["limit_depth_mm"].fillna(np.inf), rtol=1e-8)
        rate = width * at["limit_depth"] * at["feed"] / 1e3
        np.testing.assert_allclose(at["removal_rate"], rate, rtol=1e-9)
        assert len(rows[rows["width_of_cut_mm"] == width]) == 9
    assert found["limit_depth"].sel(width_of_cut=16.0).max() < found["limit_depth"].sel(width_of_cut=2.0).max()


@pytest.mark.parametrize(
    ("given", "widths"),
    [
        ('["2 mm", "8 mm"]', [2.0, 8.0]),
        ('["2 mm", "4 mm", "8 mm"]', [2.0, 4.0, 8.0]),
        ('["2 mm", "8 mm", "3 mm"]', [2.0, 5.0, 8.0]),
        ('["2 mm", "8 mm", "2 mm"]', [2.0, 4.0, 6.0, 8.0]),
        ('["8 mm", "2 mm", "4 mm"]', [2.0, 4.0, 8.0]),
    ],
)
def test_widths_are_named_or_a_range(tmp_path, given, widths):
    loaded = campaign(tmp_path)
    loaded.path.write_text(loaded.path.read_text().replace('width_of_cut = "4 mm"', f"width_of_cut = {given}"))
    asked = [round(1e3 * r.width_of_cut, 9) for r in load_campaign(loaded.path).lobes]
    assert asked == widths


def test_a_step_that_divides_nothing_is_refused(tmp_path):
    loaded = campaign(tmp_path)
    for given in ('["2 mm", "8 mm", "7 mm"]', '["2 mm", "8 mm", "0.01 mm"]'):
        loaded.path.write_text(loaded.path.read_text().replace('width_of_cut = "4 mm"', f"width_of_cut = {given}"))
        with pytest.raises(InputError, match="does not divide 2 mm to 8 mm"):
            load_campaign(loaded.path)
        loaded = campaign(tmp_path)


def test_named_speeds_keep_within_what_is_allowed_wherever_the_spindle_may_turn(tmp_path):
    loaded = campaign(tmp_path, DEFLECTION)
    named = loaded.path.read_text().replace(
        '["10000 rpm", "14000 rpm", "100 rpm"]', '{ speeds = ["11000 rpm", "12500 rpm"] }'
    )
    loaded.path.write_text(named)
    loaded = load_campaign(loaded.path)
    found = all_lobes(loaded, {"spindle": MODES.compliance(np.arange(300.0, 2500.0, 2.0))}, silent)
    best = recommend(found, loaded).best
    assert best.spindle_speed_rpm in (11000.0, 12500.0)
    assert "the deflection of the tool" in best.limited_by
    speeds = best.spindle_speed_rpm * np.array([0.99, 0.995, 1.0, 1.005, 1.01])
    depth = 1e-3 * best.depth_of_cut_mm
    at = stability.cut_maps(MODES, TOOL, ARC, ALUMINIUM, [depth, depth + 1e-4], 1e-4, speeds)["deflection"]
    assert float(at[:, 0].max()) <= 20.0 * 1.001 < float(at[:, 1].max())
