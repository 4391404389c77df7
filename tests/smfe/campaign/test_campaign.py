"""Claims about the campaign file: what it says arrives in SI, and all that is wrong with it is said at once."""

import contextlib
import json
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from process.errors import InputError
from process.units import UNITS, parse
from smfe.campaign import Campaign, load_campaign
from smfe.records import Channel, read_records

EXAMPLE = """
[campaign]
name = "Ram machine, K1 and K2"
[tool]
diameter = "125 mm"
teeth = 8
approach_angle = "45 deg"
[material]
name = "C45"
Ktc = "1900 N/mm^2"
Krc = "800 N/mm^2"
Kac = "300 N/mm^2"
Kte = "60 N/mm"
[channels]
time           = { column = "t", unit = "s" }
force_x        = { column = "Fx", unit = "N" }
acceleration_x = { column = "ax", unit = "g", sign = -1, delay = "50 us" }
spindle_speed  = { column = "n", unit = "rpm" }
[[measurement]]
name = "hammer_idle_K2"
method = "hammer"
controller = "K2"
feed = "0 mm/min"
records = [ { file = "hx_*.csv", excitation = "x" }, { file = "hy_*.csv", excitation = "y", controller = "K3" } ]
[[measurement]]
name = "sweep_2mm_K2"
method = "sweep"
controller = "K2"
depth_of_cut = "2 mm"
feed_per_tooth = "0.2 mm"
feed = { x = "600 mm/min", y = "-60 mm/min" }
background = "air_cut.csv"
frequency_range = ["20 Hz", "80 Hz"]
resolution = "0.25 Hz"
records = [ { file = "down.csv", cut = "down", width_of_cut = "37.5 mm" },
            { file = "up.csv", cut = "up", width_of_cut = "62.5 mm" },
            { file = "central.csv", cut = "central", width_of_cut = "106 mm" } ]
[[model]]
name = "paper_bench_idle"
modes = [ { frequency = "61.4 Hz", damping = 0.012, stiffness = "1.68 N/um", direction = [1, 0, 0] } ]
[[lobes]]
measurements = ["hammer_idle_K2", "sweep_2mm_K2", "paper_bench_idle"]
method = "zero_order"
cut = "down"
width_of_cut = "100 mm"
feed_per_tooth = "0.2 mm"
spindle_speed = ["250 rpm", "750 rpm"]
[[cutting_test]]
file = "cut_500_3.csv"
spindle_speed = "500 rpm"
depth_of_cut = "3 mm"
cut = "down"
width_of_cut = "100 mm"
feed_per_tooth = "0.2 mm"
observed = "chatter"
"""
FILES = (
    "hx_2.csv",
    "hx_1.csv",
    "hx_10.csv",
    "hy_1.csv",
    "air_cut.csv",
    "down.csv",
    "up.csv",
    "central.csv",
    "cut_500_3.csv",
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in FILES:
        (tmp_path / name).write_text("t,Fx,ax,n\n0,1,2,3\n1,2,3,4\n")
    return tmp_path


def load(folder: Path, text: str) -> Campaign:
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    return load_campaign(folder / "campaign.toml")


def errors(folder: Path, text: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        load(folder, text)
    head, *lines = str(caught.value).split("\n  ")
    return [numbered(re.sub(r"^(campaign\.toml)?(, |: )?(line \d+: )?", "", line), text) for line in lines or [head]]


def numbered(line: str, text: str) -> str:
    """Return a complaint with the number of its table instead of its name; names and lines have tests of their own."""
    tables = tomllib.loads(text)
    for key, name in (("measurement", "name"), ("model", "name"), ("cutting_test", "file")):
        entries = tables.get(key)
        for i, table in reversed(list(enumerate(entries if isinstance(entries, list) else []))):
            if not isinstance(table, dict):
                continue
            called = f"{key.replace('_', ' ')} '{table.get(name)}'"
            if line.startswith((called + ": ", called + ", ")):
                rest = line.removeprefix(called)
                return f"{key}[{i}]" + (rest if rest.startswith(": ") else "." + rest.removeprefix(", "))
    return line


def changed(old: str, new: str, text: str = EXAMPLE) -> str:
    assert text.count(old) >= 1, old
    return text.replace(old, new, 1)


class TestWhatItSays:
    def test_the_example_of_the_documentation(self, folder: Path) -> None:
        campaign = load(folder, EXAMPLE)
        assert campaign.name == "Ram machine, K1 and K2"
        assert campaign.tool is not None
        assert (campaign.tool.diameter, campaign.tool.teeth) == (0.125, 8)
        assert campaign.tool.approach_angle == pytest.approx(math.pi / 4)
        assert campaign.coefficients is not None
        np.testing.assert_allclose(campaign.coefficients.cutting, [1.9e9, 8e8, 3e8])
        np.testing.assert_allclose(campaign.coefficients.edge, [6e4, 0.0, 0.0])
        hammer, sweep = campaign.measurements
        assert (hammer.name, hammer.method, hammer.controller) == ("hammer_idle_K2", "hammer", "K2")
        assert hammer.feed == {"x": 0.0, "y": 0.0, "z": 0.0}
        assert sweep.feed == pytest.approx({"x": 0.01, "y": -0.001, "z": 0.0})
        assert (sweep.depth_of_cut, sweep.feed_per_tooth) == pytest.approx((0.002, 0.0002))
        assert (sweep.frequency_range, sweep.resolution, sweep.references) == ((20.0, 80.0), 0.25, "all")
        assert sweep.background == (folder / "air_cut.csv",)
        assert [r.cut for r in sweep.records] == ["down", "up", "central"]
        assert sweep.records[2].width_of_cut == pytest.approx(0.106)
        (model,) = campaign.models
        assert (model.name, model.modal.stiffness[0]) == ("paper_bench_idle", pytest.approx(1.68e6))
        (lobes,) = campaign.lobes
        np.testing.assert_allclose(lobes.spindle_speed, np.linspace(250.0, 750.0, 200))
        (test,) = campaign.cutting_tests
        assert (test.file, test.observed) == (folder / "cut_500_3.csv", "chatter")
        assert (test.spindle_speed, test.depth_of_cut) == pytest.approx((500.0, 0.003))

    def test_coefficients_that_are_missing_are_zero_and_named(self, folder: Path) -> None:
        assert load(folder, EXAMPLE).missing_coefficients == ()
        campaign = load(folder, EXAMPLE.replace('Krc = "800 N/mm^2"', "").replace('Kac = "300 N/mm^2"', ""))
        assert campaign.missing_coefficients == ("Krc", "Kac")
        assert campaign.coefficients is not None
        assert (campaign.coefficients.Krc, campaign.coefficients.Kac) == (0.0, 0.0)

    def test_a_verdict_alone_needs_no_feed_per_tooth(self, folder: Path) -> None:
        fed = 'width_of_cut = "100 mm"\nfeed_per_tooth = "0.2 mm"\nobserved'
        without = EXAMPLE.replace(fed, 'width_of_cut = "100 mm"\nobserved')
        assert without != EXAMPLE
        with pytest.raises(
            InputError, match=r"cutting test .cut_500_3.csv., feed_per_tooth: is missing; the predictions of \[\[lobes"
        ):
            load(folder, without)
        judged = re.sub(r"\[\[lobes\]\].*?(?=\[\[cutting_test)", "", without, flags=re.DOTALL)
        (test,) = load(folder, judged).cutting_tests
        assert test.feed_per_tooth is None
        with pytest.raises(InputError, match="has no feed_per_tooth"):
            _ = test.stated_feed_per_tooth

    def test_a_cutting_test_says_how_it_is_judged_and_under_what_it_was_cut(self, folder: Path) -> None:
        says = """observed = "chatter"
controller = "K2"
position = "left"
feed = { x = "600 mm/min" }
interval = ["500 ms", "3 s"]
axes = ["x", "z"]
frequency_range = ["20 Hz", "0.4 kHz"]
floor = "2 um"
half_order_reference = "30 %"
"""
        (test,) = load(folder, EXAMPLE.replace('observed = "chatter"\n', says)).cutting_tests
        assert (test.controller, test.position) == ("K2", "left")
        assert (test.interval, test.axes) == ((0.5, 3.0), ("x", "z"))
        assert test.feed == pytest.approx({"x": 0.01, "y": 0.0, "z": 0.0})
        assert test.floor == (pytest.approx(2e-6), "displacement")
        assert (test.frequency_range, test.half_order_reference) == ((20.0, 400.0), 0.3)

    def test_patterns_become_sorted_files(self, folder: Path) -> None:
        hammer = load(folder, EXAMPLE).measurements[0]
        assert [f.name for f in hammer.records[0].files] == ["hx_1.csv", "hx_10.csv", "hx_2.csv"]

    def test_a_folder_with_brackets_in_its_name(self, folder: Path) -> None:
        odd = folder / "trial [2]"
        odd.mkdir()
        for name in FILES:
            (folder / name).rename(odd / name)
        assert len(load(odd, EXAMPLE).measurements[0].records[0].files) == 3

    def test_every_file_once(self, folder: Path) -> None:
        assert [f.name for f in load(folder, EXAMPLE).files] == sorted(FILES)

    def test_a_record_inherits_conditions_and_may_differ(self, folder: Path) -> None:
        x, y = load(folder, EXAMPLE).measurements[0].records
        assert (x.controller, y.controller) == ("K2", "K3")
        assert x.feed == {"x": 0.0, "y": 0.0, "z": 0.0}

    @pytest.mark.parametrize(
        ("said", "degrees"),
        [("x", 0), ("y", 90), ("-x", 180), ("-y", -90), ("30 deg", 30), ("-135 deg", -135), ("270 deg", -90)],
    )
    def test_the_direction_of_a_feed_is_an_axis_or_an_angle(self, folder: Path, said: str, degrees: float) -> None:
        text = changed('method = "zero_order"', f'method = "zero_order"\nfeed_direction = "{said}"')
        assert load(folder, text).lobes[0].feed_direction == pytest.approx(np.radians(degrees))

    def test_a_speed_step(self, folder: Path) -> None:
        text = changed('["250 rpm", "750 rpm"]', '["250 rpm", "750 rpm", "0.5 rpm"]')
        speeds = load(folder, text).lobes[0].spindle_speed
        np.testing.assert_allclose(speeds, np.arange(250.0, 750.1, 0.5))

    @pytest.mark.parametrize(
        ("said", "speeds", "listed"),
        [
            ('["1500 rpm", "1800 rpm", "300 rpm"]', [1500.0, 1800.0], False),
            ('["1200 rpm", "1500 rpm", "100 rpm"]', [1200.0, 1300.0, 1400.0, 1500.0], False),
            ('"1200 rpm"', [1200.0], True),
            ('["1200 rpm"]', [1200.0], True),
            ('{ speeds = ["900 rpm", "710 rpm", "20 Hz"] }', [710.0, 900.0, 1200.0], True),
            ('["560 rpm", "710 rpm", "900 rpm", "1120 rpm"]', [560.0, 710.0, 900.0, 1120.0], True),
        ],
    )
    def test_speeds_are_a_range_or_named_one_by_one(self, folder: Path, said: str, speeds: list, listed: bool) -> None:
        request = load(folder, changed('["250 rpm", "750 rpm"]', said)).lobes[0]
        assert request.spindle_speed.tolist() == speeds
        assert request.listed is listed

    def test_each_width_is_a_request_of_its_own(self, folder: Path) -> None:
        one = load(folder, EXAMPLE).lobes
        several = load(folder, changed('width_of_cut = "100 mm"', 'width_of_cut = ["100 mm", "62.5 mm"]')).lobes
        assert [(r.name, r.table, r.width_of_cut) for r in several] == [
            ("lobes_1_62.5mm", "lobes_1", pytest.approx(0.0625)),
            ("lobes_1_100mm", "lobes_1", pytest.approx(0.1)),
        ]
        assert [(r.name, r.table) for r in one] == [("lobes_1", "lobes_1")]

    def test_a_partial_matrix_is_legitimate(self, folder: Path) -> None:
        text = """
        [campaign]
        name = "one axis"
        [channels]
        time = { sample_rate = "51.2 kHz" }
        force_x = { column = 2, unit = "N" }
        acceleration_x = { column = 3, unit = "m/s^2" }
        [[measurement]]
        name = "hammer"
        method = "hammer"
        records = [{ file = "hx_1.csv", excitation = "x" }]
        """
        campaign = load(folder, text)
        assert campaign.tool is None
        assert campaign.measurements[0].records[0].channels["time"] == Channel(sample_rate=51200.0)

    def test_a_sweep_has_three_passes_also_with_a_single_reference(self, folder: Path) -> None:
        start, end = EXAMPLE.index('            { file = "up.csv"'), EXAMPLE.index("[[model]]")
        text = EXAMPLE[:start] + "]\n" + EXAMPLE[end:]
        assert "three independent force directions" in errors(folder, text)[0]
        single = changed('resolution = "0.25 Hz"', 'references = "x"', text)
        assert "three independent force directions" in errors(folder, single)[0]
        sweep = load(folder, changed('resolution = "0.25 Hz"', 'references = "x"')).measurements[1]
        assert (sweep.references, len(sweep.records)) == ("x", 3)

    def test_settings_are_plain_values(self, folder: Path) -> None:
        text = changed('controller = "K2"', 'controller = "K2"\nstarted = 2024-05-04T10:00:00\nadded_mass = "12 g"')
        said = json.loads(json.dumps(load(folder, text).measurements[0].settings()))
        assert said["started"] == "2024-05-04T10:00:00"
        assert said["added_mass"] == pytest.approx(0.012)
        assert said["feed"] == {"x": 0.0, "y": 0.0, "z": 0.0}
        assert "temperature" not in said


class TestChannels:
    OVERRIDE = """
    [measurement.channels]
    acceleration_x = { column = "acc", sign = 1 }
    """

    def test_inherited_key_by_key(self, folder: Path) -> None:
        text = changed("[[model]]", self.OVERRIDE + "[[model]]")
        hammer, sweep = load(folder, text).measurements
        late = parse("50 us", "time")
        assert hammer.records[0].channels["acceleration_x"] == Channel("ax", "g", sign=-1.0, delay=late)
        assert sweep.records[0].channels["acceleration_x"] == Channel("acc", "g", sign=1.0, delay=late)
        assert sweep.channels == dict(sweep.records[0].channels)

    def test_a_record_has_the_last_word(self, folder: Path) -> None:
        entry = '{ file = "down.csv", channels = { force_x = { column = "F1", unit = "kN" } }, '
        sweep = load(folder, changed('{ file = "down.csv", ', entry)).measurements[1]
        assert sweep.records[0].channels["force_x"] == Channel("F1", "kN")
        assert sweep.records[1].channels["force_x"] == Channel("Fx", "N")

    def test_a_sample_rate_takes_the_place_of_a_column(self, folder: Path) -> None:
        text = changed("[[model]]", '[measurement.channels]\ntime = { sample_rate = "2 kHz" }\n[[model]]')
        hammer, sweep = load(folder, text).measurements
        assert (hammer.channels["time"].column, hammer.channels["time"].sample_rate) == ("t", None)
        assert (sweep.channels["time"].column, sweep.channels["time"].sample_rate) == (None, 2000.0)

    def test_spindle_channels_of_the_campaign_are_not_looked_for_in_hammer_records(self, folder: Path) -> None:
        hammer, sweep = load(folder, EXAMPLE).measurements
        assert "spindle_speed" not in hammer.records[0].channels
        assert "spindle_speed" in sweep.records[0].channels

    def test_they_read_the_records(self, folder: Path) -> None:
        entry = load(folder, EXAMPLE).measurements[1].records[0]
        (folder / "down.csv").write_text("t,Fx,ax,n\n" + "".join(f"{k * 1e-3},1,2,300\n" for k in range(100)))
        (record,) = read_records(entry.files[0], entry.channels)
        np.testing.assert_allclose(record["acceleration"], -2.0 * 9.80665)
        assert record.attrs["source"] == "down.csv"

    def test_an_averaged_compliance(self, folder: Path) -> None:
        text = """
        [campaign]
        name = "averaged elsewhere"
        [channels]
        force_x = { column = "F", unit = "N" }
        [[measurement]]
        name = "averaged"
        method = "frf"
        records = [{ file = "up.csv", response = "y", excitation = "x" }]
        [measurement.channels]
        frequency = { column = 1, unit = "Hz" }
        compliance_real = { column = 2, unit = "um/N" }
        compliance_imag = { column = 3, unit = "um/N" }
        """
        entry = load(folder, text).measurements[0].records[0]
        assert (entry.response, entry.excitation) == ("y", "x")
        assert sorted(entry.channels) == ["compliance_imag", "compliance_real", "frequency"]


_QUANTITIES = [
    ("length", "125 mm"),
    ("angle", "45 deg"),
    ("pressure", "1900 N/mm^2"),
    ("line_force", "60 N/mm"),
    ("speed", "600 mm/min"),
    ("length", "37.5 mm"),
    ("frequency", "61.4 Hz"),
    ("stiffness", "1.68 N/um"),
    ("rotation", "250 rpm"),
    ("rotation", "500 rpm"),
    ("time", "50 us"),
    ("frequency", "0.25 Hz"),
]


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_a_campaign_in_other_units_gives_the_same_objects(folder: Path, data: st.DataObject) -> None:
    text = EXAMPLE
    for dimension, old in _QUANTITIES:
        number, unit = old.split(" ", 1)
        other = data.draw(st.sampled_from(sorted(UNITS[dimension])), label=old)
        value = float(number) * UNITS[dimension][unit] / UNITS[dimension][other]
        text = changed(f'"{old}"', f'"{value!r} {other}"', text)
    a, b = load(folder, EXAMPLE), load(folder, text)
    assert a.tool is not None
    assert b.tool is not None
    assert b.tool.diameter == pytest.approx(a.tool.diameter, rel=1e-12)
    assert b.tool.approach_angle == pytest.approx(a.tool.approach_angle, rel=1e-12)
    assert a.coefficients is not None
    assert b.coefficients is not None
    np.testing.assert_allclose(b.coefficients.cutting, a.coefficients.cutting, rtol=1e-12)
    np.testing.assert_allclose(b.coefficients.edge, a.coefficients.edge, rtol=1e-12)
    np.testing.assert_allclose(b.lobes[0].spindle_speed, a.lobes[0].spindle_speed, rtol=1e-12)
    np.testing.assert_allclose(b.models[0].modal.stiffness, a.models[0].modal.stiffness, rtol=1e-12)
    assert b.measurements[1].feed == pytest.approx(a.measurements[1].feed, rel=1e-12)
    assert b.measurements[1].records[0].width_of_cut == pytest.approx(0.0375, rel=1e-12)
    assert b.channels["acceleration_x"].delay == pytest.approx(50e-6, rel=1e-12)


ONE_FAULT = [
    # the file as a whole
    ('name = "Ram machine, K1 and K2"', "", "campaign.name: is missing"),
    (
        "[campaign]",
        "[baseline]\nfrom = 'x'\n[campaign]",
        "baseline.from: 'x' is neither a measurement nor a model; there are 'hammer_idle_K2', 'sweep_2mm_K2'",
    ),
    (
        "[campaign]",
        "[baseline]\nfrom = 'hammer_idle_K2'\nforces = 'mechanistic'\n[campaign]",
        "baseline: gives from and forces; one simulation is tested at a time, give one of them",
    ),
    (
        "[campaign]",
        "[baseline]\ndrive = 'rigid'\naxis = 'x'\n[campaign]",
        "baseline: has nothing to be compared with; add a measurement with method = 'drive'",
    ),
    (
        'method = "hammer"',
        'method = "hammer"\nheld_out = true',
        "measurement[0].held_out: only a diagnosis reads it, and there is no [baseline]; take it out",
    ),
    ("[tool]", "[tol]", "tol: this key is not known (did you mean 'tool'?)"),
    # units
    ('"125 mm"', '"125"', "tool.diameter: '125' has no unit; write e.g. \"10 mm\""),
    ('"125 mm"', "125", "tool.diameter: 125 has no unit; write it as text with a unit"),
    ('"125 mm"', '"125 N"', "tool.diameter: unit 'N' is not a unit of length; use one of: 'm', 'mm'"),
    ('"125 mm"', '"-125 mm"', "tool.diameter: '-125 mm' is not possible; it must be positive"),
    ('"125 mm"', '"1e999 mm"', "tool.diameter: '1e999 mm' is not finite"),
    ('feed = "0 mm/min"', 'feed = "0 mm"', "measurement[0].feed: unit 'mm' is not a unit of speed"),
    ("{ x = ", "{ u = ", "measurement[1].feed: axis 'u' is none of x, y, z"),
    ('["20 Hz", "80 Hz"]', '["80 Hz", "20 Hz"]', "measurement[1].frequency_range: from 80 Hz to 20 Hz is no range"),
    ('["20 Hz", "80 Hz"]', '"20 Hz"', "measurement[1].frequency_range: '20 Hz' is not a list of 2 quantities"),
    ('["250 rpm", "750 rpm"]', "[]", "lobes[0].spindle_speed: [] names no spindle speed"),
    (
        '["250 rpm", "750 rpm"]',
        '["250 rpm", "750 rpm", "800 rpm"]',
        "lobes[0].spindle_speed: a step of 800 rpm does not divide 250 rpm to 750 rpm",
    ),
    ('["250 rpm", "750 rpm"]', '["250 rpm", "500 rpm", "750 rpm"]', "lobes[0].spindle_speed: a step of 750 rpm"),
    (
        '["250 rpm", "750 rpm"]',
        '["250 rpm", "750 rpm", "5 rpm", "1 rpm"]',
        "lobes[0].spindle_speed: ['250 rpm', '750 rpm', '5 rpm', '1 rpm'] is neither",
    ),
    (
        '["250 rpm", "750 rpm"]',
        '{ speeds = ["9 rpm", "9 rpm"] }',
        "lobes[0].spindle_speed: ['9 rpm', '9 rpm'] names a spindle speed twice",
    ),
    (
        '["250 rpm", "750 rpm"]',
        '{ from = "250 rpm" }',
        "lobes[0].spindle_speed: {'from': '250 rpm'} is no list of spindle speeds",
    ),
    (
        'width_of_cut = "100 mm"',
        'width_of_cut = ["10 mm", "10 mm"]',
        "lobes[0].width_of_cut: ['10 mm', '10 mm'] names a width twice",
    ),
    (
        'width_of_cut = "100 mm"',
        'width_of_cut = ["10 mm", "-1 mm"]',
        "lobes[0].width_of_cut: ['10 mm', '-1 mm'] is not possible; a width",
    ),
    (
        'width_of_cut = "100 mm"',
        'width_of_cut = ["10 mm", "200 mm"]',
        "lobes[0].width_of_cut[1]: '200 mm' is wider than the tool of 125 mm",
    ),
    ('["250 rpm", "750 rpm"]', '["250 rpm", "750 rpm", "0 rpm"]', "lobes[0].spindle_speed: a step of 0 rpm"),
    # tool, material, model
    ("teeth = 8", "teeth = 8.5", "tool.teeth: 8.5: must be a whole number"),
    ("teeth = 8", "teeth = 8000000", "tool: the tool has 8e+06 teeth, more than any milling tool (1000)"),
    ("force_x   ", 'force_y = "Fy"\nforce_x   ', "channels.force_y: 'Fy': must be a table, { key = ... }"),
    ("teeth = 8", 'teeth = 8\npitch_angles = ["90 deg"]', "tool: pitch_angles has 1 values for 8 teeth"),
    ('Ktc = "1900 N/mm^2"', "", "material.Ktc: is missing"),
    (
        'Ktc = "1900 N/mm^2"',
        'Ktc = "-1 Pa"',
        "material: K_tc is -1e-06 N/mm^2; the tangential coefficient must be positive",
    ),
    (
        "damping = 0.012",
        "damping = 0",
        "model[0].modes[0].damping: 0 is no damping ratio of a mode; write one above 0 and below 1",
    ),
    ("direction = [1, 0, 0]", "direction = [1, 0]", "model[0].modes[0].direction"),
    ("damping", "dampning", "model[0].modes[0].dampning: this key is not known (did you mean 'damping'?)"),
    # channels
    ("force_x   ", "forse_x   ", "channels.forse_x: channel 'forse_x' is not known (did you mean 'force_x'?)"),
    ('unit = "N"', 'unit = "mm"', "channels.force_x.unit: unit 'mm' is not a unit of force"),
    (', unit = "N"', "", 'channels.force_x.unit: force_x has no unit; add unit = "N"'),
    ('column = "Fx"', "colum = 2", "channels.force_x.colum: this key is not known (did you mean 'column'?)"),
    ('column = "Fx"', "column = 0", "channels.force_x.column: column 0 is not possible; positions count from 1"),
    ("sign = -1", "sign = -2", "channels.acceleration_x.sign: -2 is no sign; write 1 or -1, and use scale"),
    ('delay = "50 us"', 'delay = "50 mm"', "channels.acceleration_x.delay: unit 'mm' is not a unit of time"),
    ('column = "Fx"', 'sample_rate = "1 kHz"', "channels.force_x.sample_rate: belongs to the channel time only"),
    ('column = "t"', 'column = "t", sample_rate = "1 kHz"', "channels.time: gives a column and a sample_rate"),
    ('column = "t"', 'column = "t", delay = "1 ms"', "channels.time.delay: this channel has no delay"),
    # measurements
    (
        '"sweep_2mm_K2"',
        '"hammer_idle_K2"',
        "measurement[1].name: 'hammer_idle_K2' is already the name of measurement[0]",
    ),
    ('"paper_bench_idle"', '"hammer_idle_K2"', "model[0].name: 'hammer_idle_K2' is already the name of measurement[0]"),
    ('"sweep_2mm_K2"', '"a/b"', "measurement[1].name: 'a/b' is no name; one line of text without '/'"),
    ("sign = -1", "sign = -1, scale = 1e300", "channels.acceleration_x.scale: 1e+300 is the factor of no sensor; give"),
    ("sign = -1", "sign = -1, scale = 0", "channels.acceleration_x.scale: 0 is the factor of no sensor; give one"),
    *(
        ('"sweep_2mm_K2"', f'"{name}"', "measurement[1].name: ")
        for name in ("a\\\\b", ".", "..", " . ", "a\\u0000b", "a\\u001b[2Jb", "a\\u202eb", "")
    ),
    ('"sweep_2mm_K2"', f'"{200 * "a"}"', "measurement[1].name: 'aaaa"),
    ('"sweep_2mm_K2"', '"a\\tb"', "measurement[1].name: 'a\\tb' is no name; one line of text without '/'"),
    (
        '"hammer"',
        '"hamer"',
        "measurement[0].method: method 'hamer' is not known (did you mean 'hammer'?); available: hammer,",
    ),
    ('"hammer"', '"drive"', "measurement[0].records[0].excitation: method 'drive' does not read it"),
    (
        ', excitation = "x"',
        "",
        "measurement[0].records[0].excitation: is missing; a record of method 'hammer' needs the axis",
    ),
    ('excitation = "x"', 'excitation = "u"', "measurement[0].records[0].excitation: axis 'u' is not known"),
    (
        'excitation = "x"',
        'excitation = "x", cut = "up"',
        "measurement[0].records[0].cut: method 'hammer' does not read it",
    ),
    ('feed = "0 mm/min"', 'references = "x"', "measurement[0].references: method 'hammer' does not read it"),
    ('"hx_*.csv"', '"ix_*.csv"', "measurement[0].records[0].file: no file 'ix_*.csv' in "),
    ('"air_cut.csv"', '"air_cutt.csv"', "measurement[1].background: no file 'air_cutt.csv' in "),
    (
        '"down.csv"',
        '"campaign.toml"',
        "measurement[1].records[0].file: 'campaign.toml': files with suffix '.toml' are not read",
    ),
    (', cut = "down"', "", "measurement[1].records[0].cut: is missing; a record of method 'sweep' needs cut = "),
    (', width_of_cut = "37.5 mm"', "", "measurement[1].records[0].width_of_cut: is missing"),
    ('"37.5 mm"', '"137.5 mm"', "measurement[1].records[0].width_of_cut: '137.5 mm' is wider than the tool of 125 mm"),
    # lobes and cutting tests
    (
        '["hammer_idle_K2", ',
        '["hamer_idle_K2", ',
        "lobes[0].measurements[0]: 'hamer_idle_K2' is neither a measurement nor a model",
    ),
    (
        '"zero_order"',
        '"multifrequency"',
        "lobes[0].method: method 'multifrequency' is not known (did you mean 'multi_frequency'?); available: "
        "zero_order, multi_frequency, semi_discretization, operating_point",
    ),
    ('"100 mm"', '"130 mm"', "lobes[0].width_of_cut: '130 mm' is wider than the tool of 125 mm"),
    ('"cut_500_3.csv"', '"cut*_3.csv"', None),
    ('"cut_500_3.csv"', '"h*_1.csv"', "cutting_test[0].file: 'h*_1.csv' matches 2 files; name one"),
    (
        'observed = "chatter"',
        'observed = "loud"',
        "cutting_test[0].observed: verdict 'loud' is not known; available: stable",
    ),
    (
        'observed = "chatter"',
        'interval = ["3 s", "1 s"]',
        "cutting_test[0].interval: from 3 s to 1 s is no interval; the first must be before the second",
    ),
    (
        'observed = "chatter"',
        'floor = "3 mm/min"',
        "cutting_test[0].floor: '3 mm/min' is no amplitude of acceleration, displacement, force, sound; write e.g.",
    ),
    (
        'observed = "chatter"',
        "half_order_reference = -1",
        "cutting_test[0].half_order_reference: -1 is no ratio of two amplitudes",
    ),
    (
        'method = "zero_order"',
        'method = "zero_order"\nfeed_direction = "z"',
        "lobes[0].feed_direction: 'z' is no direction of a feed; write 'x', 'y', '-x', '-y', or the angle",
    ),
    ('method = "zero_order"', 'method = "zero_order"\nfeed_direction = "390 deg"', None),
]


class TestWhatIsWrong:
    @pytest.mark.parametrize(("old", "new", "message"), ONE_FAULT)
    def test_one_fault_one_sentence_with_its_place(self, folder: Path, old: str, new: str, message: str | None) -> None:
        text = changed(old, new)
        if message is None:
            load(folder, text)
            return
        found = errors(folder, text)
        assert any(line.startswith(message) for line in found), found
        assert not any("is empty" in line for line in found), found

    def test_all_faults_at_once(self, folder: Path) -> None:
        text = EXAMPLE
        faults = [
            ('"125 mm"', '"125 furlong"', "tool.diameter"),
            ("Kte", "Kt", "material.Kt"),
            ("force_x   ", "forse_x   ", "channels.forse_x"),
            ("hx_*.csv", "nowhere.csv", "measurement[0].records[0].file"),
            (', excitation = "y"', "", "measurement[0].records[1].excitation"),
            ('"2 mm"', '"2 kg"', "measurement[1].depth_of_cut"),
            ('"up.csv", cut = "up"', '"upp.csv", cut = "uper"', "measurement[1].records[1].cut"),
            ('["hammer_idle_K2", ', '["hammer", ', "lobes[0].measurements[0]"),
            ('"500 rpm"', '"500"', "cutting_test[0].spindle_speed"),
        ]
        for old, new, _ in faults:
            text = changed(old, new, text)
        found = errors(folder, text)
        for _, _, place in faults:
            assert any(line.startswith(place + ": ") for line in found), place
        assert any(line.startswith("measurement[1].records[1].file: ") for line in found)

    def test_two_passes_are_too_few_and_the_third_is_advised(self, folder: Path) -> None:
        text = re.sub(r',\n\s*{ file = "central.csv".*', " ]", EXAMPLE)
        assert errors(folder, text) == [
            "measurement[1].records: 2 passes that differ in cut or width; three independent force directions are "
            "needed to solve for nine compliances; add a pass with cut = 'central' and a width of 106.25 mm"
        ]

    def test_the_same_pass_three_times_is_one_direction(self, folder: Path) -> None:
        text = re.sub(
            r'cut = "(up|central)", width_of_cut = "[\d.]+ mm"', 'cut = "down", width_of_cut = "37.5 mm"', EXAMPLE
        )
        (line,) = errors(folder, text)
        assert line.startswith("measurement[1].records: 1 passes that differ")
        assert "cut = 'up' and a width of 62.5 mm and a pass with cut = 'central'" in line

    @pytest.mark.parametrize("table", ["tool", "material"])
    def test_missing_tables_are_missed_where_they_are_needed(self, folder: Path, table: str) -> None:
        text = re.sub(rf"\[{table}\]\n(.* = .*\n)+", "", EXAMPLE)
        found = errors(folder, text)
        assert f"lobes[0]: a stability limit needs the table [{table}]; add it" in found
        sweep_too = "measurement[1]: a sweep needs the table [tool]; add it" in found
        test_too = "cutting_test[0]: a cutting test needs the table [tool]; add it" in found
        assert (sweep_too, test_too) == (table == "tool", table == "tool")

    def test_a_missing_file_lists_what_is_there(self, folder: Path) -> None:
        (line,) = errors(folder, changed('"down.csv"', '"dwon.csv"'))
        assert "(did you mean 'down.csv'?); the records there are 'air_cut.csv', 'central.csv'" in line

    def test_syntax_errors_come_with_their_line(self, folder: Path) -> None:
        with pytest.raises(InputError, match=r"campaign.toml, line 3: not TOML: Expected '=' after a key"):
            load(folder, "[campaign]\nname = 'x'\nthis is = not = toml\n")

    def test_no_file_and_no_text(self, folder: Path) -> None:
        with pytest.raises(InputError, match=r"none\.toml: cannot be read \(No such file or directory\)"):
            load_campaign(folder / "none.toml")
        (folder / "bad.toml").write_bytes(b"\xff\xfe\x00")
        with pytest.raises(InputError, match=r"bad\.toml: not UTF-8 text"):
            load_campaign(folder / "bad.toml")

    def test_empty_lists(self, folder: Path) -> None:
        text = '[campaign]\nname = "x"\n[[measurement]]\nname = "m"\nmethod = "hammer"\nrecords = []'
        assert errors(folder, text) == ["measurement[0].records: is empty; at least one entry is needed"]

    def test_nothing_to_work_with(self, folder: Path) -> None:
        assert errors(folder, '[campaign]\nname = "empty"\n') == [
            "nothing to work with; add a [[measurement]], a [[model]] or a [[cutting_test]]"
        ]

    @pytest.mark.parametrize(
        "text",
        [
            "campaign = 3",
            "measurement = 3",
            "[[measurement]]\nrecords = 3",
            "[[measurement]]\nmethod = ['x']\nrecords = [3]\nchannels = 4",
            "[[measurement]]\nmethod = 'sweep'\nname = 5\n"
            "records = [{ file = 3, cut = [], width_of_cut = {}, channels = { time = 2 } }]",
            "tool = 3\nmaterial = []\nchannels = 'x'\nmodel = [[]]\nlobes = [{ measurements = 3 }]\ncutting_test = {}",
            "[[lobes]]\nmeasurements = [[1]]\nmethod = {}\nspindle_speed = [[], {}]",
            "[channels]\nforce_x = { column = [], unit = 3, sign = 'x', scale = [], delay = 1, sample_rate = [] }",
        ],
    )
    def test_any_shape_gives_sentences_and_no_traceback(self, folder: Path, text: str) -> None:
        assert errors(folder, text)


_VALUES = st.recursive(
    st.one_of(st.integers(-3, 3), st.booleans(), st.sampled_from(["x", "sweep", "1 mm", "down", ""])),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.sampled_from("ab"), inner, max_size=2)),
    max_leaves=4,
)


def _toml(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{k} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return f'"{value}"' if isinstance(value, str) else str(value)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.data())
def test_any_value_anywhere_is_accepted_or_explained(folder: Path, data: st.DataObject) -> None:
    lines = [line for line in EXAMPLE.splitlines() if re.match(r"\w+\s*= (?!\[ ?{)", line)]
    line = data.draw(st.sampled_from(lines))
    key = line.split("=")[0]
    with contextlib.suppress(InputError):
        load(folder, changed(line, f"{key} = {_toml(data.draw(_VALUES))}"))
