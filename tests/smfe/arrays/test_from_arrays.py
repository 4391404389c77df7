"""From arrays to lobes: the same numbers as through a campaign file, and one sentence for what is wrong."""

import json
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from samples.report import MACHINE, STEEL, TOOL, measured
from typer.testing import CliRunner

import smfe
from process.errors import InputError
from process.machine.modes import ModalModel
from smfe.cli import app
from smfe.progress import SmfeWarning
from smfe.records import write_record_netcdf
from smfe.results import read_groups

CUT = {"cut": "down", "width_of_cut": "100 mm", "feed_per_tooth": "0.2 mm"}
HEAD = """
[campaign]
name = "own arrays"
[tool]
diameter = "125 mm"
teeth = 8
approach_angle = "45 deg"
[material]
Ktc = "1900 N/mm^2"
Krc = "800 N/mm^2"
Kac = "400 N/mm^2"
"""
LOBES = """
[[lobes]]
measurements = ["m"]
cut = "down"
method = "zero_order"
width_of_cut = "100 mm"
feed_per_tooth = "0.2 mm"
spindle_speed = ["250 rpm", "750 rpm", "50 rpm"]
"""
MILL = {"diameter": "125 mm", "teeth": 8, "approach_angle": "45 deg"}
WORK = {"Ktc": "1900 N/mm^2", "Krc": "800 N/mm^2", "Kac": "400 N/mm^2"}


def taps(axis: str, seed: int = 1) -> xr.Dataset:
    """Return three hits on a mode, sampled at 2 kHz: force and acceleration along one axis."""
    rate, hits, count = 2000.0, 3, 4096
    time = np.arange(hits * count) / rate
    force = np.zeros(time.size)
    for k in range(hits):
        force[k * count + 400 : k * count + 405] = 800.0 * np.sin(np.pi * np.arange(1, 6) / 6.0)
    f = np.fft.rfftfreq(time.size, 1.0 / rate)
    mode = ModalModel([61.4], [0.03], [4.5e7], [[1.0, 0.0, 0.0]])
    transfer = -((2.0 * np.pi * f) ** 2) * mode.matrix(f)[:, 0, 0]
    acceleration = np.fft.irfft(transfer * np.fft.rfft(force), time.size)
    noise = np.random.default_rng(seed).standard_normal((2, time.size))
    return smfe.record(
        rate,
        name=f"taps_{axis}",
        **{f"force_{axis}": force + 0.05 * noise[0], f"acceleration_{axis}": acceleration + 1e-3 * noise[1]},
    )


@pytest.fixture(scope="module")
def tapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Campaign of two taps in files."""
    folder = tmp_path_factory.mktemp("taps")
    for k, axis in enumerate("xy"):
        write_record_netcdf(taps(axis, k), folder / f"{axis}.nc")
    records = ", ".join(f'{{ file = "{a}.nc", excitation = "{a}" }}' for a in "xy")
    measurement = '[[measurement]]\nname = "m"\nmethod = "hammer"\nfrequency_range = ["40 Hz", "90 Hz"]\n'
    (folder / "c.toml").write_text(f"{HEAD}{measurement}records = [{records}]\n{LOBES}", encoding="utf-8")
    return folder


def same(a: xr.Dataset, b: xr.Dataset) -> None:
    """Assert that all variables agree to 1e-12 of their size."""
    assert set(a.variables) == set(b.variables)
    for name in a.data_vars:
        if np.issubdtype(a[name].dtype, np.number):
            np.testing.assert_allclose(a[name].values, b[name].values, rtol=1e-12, atol=0.0, err_msg=str(name))


def test_two_taps_in_memory_give_the_compliance_and_lobes_of_the_campaign(tapped: Path) -> None:
    by_path = smfe.lobes(tapped / "c.toml")[0].lobes
    frf = smfe.identify({"x": taps("x", 0), "y": taps("y", 1)}, method="hammer", frequency_range=(40, "90 Hz"))
    same(frf.compliance, smfe.identify(tapped / "c.toml")["m"].compliance)
    limits = smfe.lobes(frf, MILL, WORK, **CUT, spindle_speed=(250, 750, 50))
    same(limits, by_path)
    assert limits.attrs["source"] == "hammer"


def test_an_array_of_responses_gives_the_lobes_of_the_campaign(tmp_path: Path) -> None:
    f = np.arange(20.0, 100.0, 1.0)
    accelerance = -((2.0 * np.pi * f) ** 2) * MACHINE.matrix(f)[:, 0, 0]
    table = {"f": f, "re": accelerance.real, "im": accelerance.imag, "g2": np.full(f.size, 0.99)}
    pd.DataFrame(table).to_csv(tmp_path / "h.csv", index=False)
    channels = 'frequency = { column = "f", unit = "Hz" }\naccelerance_real = { column = "re", unit = "m/s^2/N" }\n'
    channels += 'accelerance_imag = { column = "im", unit = "m/s^2/N" }\ncoherence = { column = "g2", unit = "1" }\n'
    records = 'averages = 10\nrecords = [ { file = "h.csv", response = "x", excitation = "x" } ]\n'
    text = f'{HEAD}[[measurement]]\nname = "m"\nmethod = "frf"\n{records}[measurement.channels]\n{channels}{LOBES}'
    (tmp_path / "c.toml").write_text(text, encoding="utf-8")
    frf = smfe.compliance(f, accelerance, unit="m/s^2/N", coherence=table["g2"], averages=10)
    limits = smfe.lobes(frf, TOOL, STEEL, cut="down", width_of_cut=0.1, spindle_speed=np.arange(250.0, 751.0, 50.0))
    same(limits, smfe.lobes(tmp_path / "c.toml")[0].lobes)


def test_tool_material_and_numbers_may_be_given_in_every_form() -> None:
    frf = measured("hammer", 90.0, 2.0, 2e-9, 1)
    first = smfe.lobes(
        frf, TOOL, STEEL, cut="down", width_of_cut=0.1, feed_per_tooth=2e-4, spindle_speed=(250, 750, 50)
    )
    again = smfe.lobes(frf, MILL, WORK, **CUT, spindle_speed=("250 rpm", "750 rpm", "50 rpm"))
    same(first, again)


def test_compliances_and_modes_by_name_give_lobes_by_name_and_files_only_where_asked(tmp_path: Path) -> None:
    frf = measured("hammer", 90.0, 2.0, 2e-9, 1)
    asked = {**CUT, "spindle_speed": (250, 750, 50)}
    found = smfe.lobes({"hammer": frf, "modes": MACHINE}, TOOL, STEEL, **asked, output=tmp_path / "l.nc")
    assert list(found) == ["hammer", "modes"]
    same(found["hammer"], smfe.lobes(frf, TOOL, STEEL, **asked))
    same(found["modes"], read_groups(tmp_path / "l.nc")["lobes_1/modes"])
    assert [p.name for p in tmp_path.iterdir()] == ["l.nc"]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"width_of_cut": "130 mm"}, "width_of_cut: '130 mm' is wider than the tool of 125 mm"),
        ({"width_of_cut": ["20 mm", "40 mm"]}, "width_of_cut: one width at a time"),
        ({"width_of_cut": 100}, "width_of_cut: '100' is wider than the tool"),
        ({"cut": "climb"}, "climb milling is down milling: write 'down'"),
        ({"spindle_speed": (750, 250)}, "the first must be positive and below the second"),
        ({"spindle_speed": np.array([0.0, 500.0])}, "positive numbers in rpm"),
        ({"method": "zeroth"}, "method .zeroth. is not known; available: zero_order"),
        ({"depth": 1.0}, "depth: "),
        ({"tool": 0.125}, "no tool; give smfe.Tool"),
        ({"material": {"Ktc": "1900 N"}}, "Ktc: unit 'N' is not a unit of pressure"),
        ({"source": {"hammer": 1.0}}, "float holds no compliance"),
    ],
)
def test_what_a_file_would_be_refused_for_is_refused_by_its_name(wrong: dict[str, object], said: str) -> None:
    given = {"source": MACHINE, "tool": TOOL, "material": STEEL, **CUT, "spindle_speed": (250, 750), **wrong}
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        smfe.lobes(given.pop("source"), given.pop("tool"), given.pop("material"), **given)


def test_one_speed_and_a_list_of_speeds_are_those_speeds() -> None:
    for given, expected in ((500, [500.0]), ("500 rpm", [500.0]), ([250, 400, 500, 750], [250.0, 400.0, 500.0, 750.0])):
        limits = smfe.lobes(MACHINE, TOOL, STEEL, **CUT, spindle_speed=given)
        assert limits["spindle_speed"].values == pytest.approx(expected)


def test_what_is_left_out_is_named() -> None:
    with pytest.raises(InputError, match="material, cut, width_of_cut, spindle_speed are missing; give tool, material"):
        smfe.lobes(MACHINE, TOOL)
    with pytest.raises(InputError, match="spindle_speed is missing"):
        smfe.recommendation(MACHINE, TOOL, STEEL, **CUT)


def test_the_command_line_says_a_warning_once(tmp_path: Path) -> None:
    modes = 'modes = [ { frequency = "61 Hz", damping = 0.03, stiffness = "45 N/um", direction = [1, 0, 0] } ]'
    text = HEAD.replace('Krc = "800 N/mm^2"\n', "") + f'[[model]]\nname = "m"\n{modes}\n{LOBES}'
    (tmp_path / "c.toml").write_text(text, encoding="utf-8")
    files = ["-o", str(tmp_path / "l.nc"), "--table", str(tmp_path / "t.csv")]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        done = CliRunner().invoke(app, ["lobes", str(tmp_path / "c.toml"), *files, "--json"])
    assert done.exit_code == 0
    said = json.loads(done.stdout)["warnings"]
    assert sum("[material] gives no Krc" in sentence for sentence in said) == 1
    assert not [w for w in caught if w.category is SmfeWarning]
    with pytest.warns(SmfeWarning, match="gives no Krc"):
        smfe.lobes(tmp_path / "c.toml")


def test_a_mobility_and_an_accelerance_are_the_compliance_of_the_same_machine() -> None:
    f = np.arange(0.0, 100.0, 0.5)
    matrix, s = MACHINE.matrix(f), 2j * np.pi * f[:, None, None]
    plain = smfe.compliance(f, 1e6 * matrix, unit="um/N", std=np.full(matrix.shape, 0.01))
    assert plain["compliance_std"].values == pytest.approx(1e-8)
    for n, unit in ((1, "mm/s/N"), (2, "g/N")):
        scale = {1: 1e3, 2: 1.0 / 9.80665}[n]
        other = smfe.compliance(f, scale * s**n * matrix, unit=unit)
        assert float(other["frequency"][0]) == 0.5  # a motion says nothing of the displacement at 0 Hz
        np.testing.assert_allclose(other["compliance"].values, plain["compliance"].values[1:], rtol=1e-12)


def test_entries_by_name_stand_where_they_belong() -> None:
    f = np.array([10.0, 20.0])
    frf = smfe.compliance(f, {"xx": [1.0, 2.0], "zx": [3j, 4j]}, conditions={"feed": "500 mm/min"})
    at = frf["compliance"].sel(excitation="x")
    assert at.sel(response="z").values.tolist() == [3j, 4j]
    assert json.loads(frf.attrs["conditions"]) == {"feed": "500 mm/min"}
    assert frf["compliance"].attrs["units"] == "m/N"
    assert smfe.compliance(f, [1.0, 2.0], axes="y")["response"].values.tolist() == ["y"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([1.0, 2.0], [1.0]), r"entry xx of the response has the shape \(1,\)"),
        (([1.0, 2.0], np.ones((2, 2, 2))), "matrix of 2 axes; name them"),
        (([1.0, 2.0], {"xw": [1.0, 1.0]}), "axis 'w' is none of x, y, z"),
        (([1.0, 2.0], {"x": [1.0, 1.0]}), "write response and excitation"),
        (([2.0, 1.0], [1.0, 1.0]), "must be non-negative and rise"),
        (([1.0, 2.0], [[1.0, 1.0]]), r"the response has the shape \(1, 2\)"),
    ],
)
def test_arrays_that_make_no_compliance_are_refused(arguments: tuple[object, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        smfe.compliance(*arguments)


def test_a_record_of_arrays_is_in_si_with_its_units() -> None:
    tap = smfe.record("2 kHz", force_x=[0, 1, 0], acceleration_x=([0.0, 1.0, 0.0], "g"), spindle_speed="950 rpm")
    assert tap["acceleration"].sel(axis="x").values[1] == pytest.approx(9.80665)
    assert tap["spindle_speed"].values == pytest.approx([950.0] * 3)
    assert tap["time"].values[1] == 5e-4
    assert all("units" in tap[name].attrs for name in [*tap.data_vars, "time"])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"sample_rate": 1e3, "force_w": [1, 2]}, "channel 'force_w' is not known"),
        ({"sample_rate": 1e3, "force_x": [1, 2], "sound": [1, 2, 3]}, "force_x 2, sound 3"),
        ({"force_x": [1, 2]}, "give one of both"),
        ({"sample_rate": 1e3, "force_x": ([1, 2], "mm")}, "unit 'mm' is not a unit of force"),
        ({"sample_rate": 1e3, "force_x": np.ones((3, 2))}, "give each axis a channel of its own"),
        ({"sample_rate": 1e3, "spindle_speed": "950 rpm"}, "one channel at least that is an array"),
        ({"sample_rate": 1e3, "force_x": [1, np.nan]}, "not finite"),
    ],
)
def test_arrays_that_make_no_record_are_refused(arguments: dict[str, object], said: str) -> None:
    with pytest.raises(InputError, match=said):
        smfe.record(**arguments)


def test_records_without_a_method_or_of_another_one_are_refused() -> None:
    tap = taps("x")
    with pytest.raises(InputError, match='method="hammer", "actuator" or "sweep"'):
        smfe.identify(tap)
    with pytest.raises(InputError, match=r"smfe\.compliance"):
        smfe.identify(tap, method="frf")
    with pytest.raises(InputError, match="by the axis excited, x, y or z, not 'X'"):
        smfe.identify({"X": tap}, method="hammer")
    with pytest.raises(InputError, match="estimator: "):
        smfe.identify(tap, method="hammer", estimator="H3")


def test_what_must_be_known_is_warned_of_once_at_the_line_of_the_caller_and_kept() -> None:
    frf = smfe.compliance(np.arange(20.0, 90.0, 0.25), {"xx": MACHINE.matrix(np.arange(20.0, 90.0, 0.25))[:, 0, 0]})
    with pytest.warns(SmfeWarning) as caught:
        limits = smfe.lobes(frf, TOOL, STEEL, **CUT, spindle_speed=(250, 750, 50))
    (said,) = [w for w in caught if w.category is SmfeWarning]
    assert Path(said.filename) == Path(__file__)
    assert list(said.message.sentences) == list(dict.fromkeys(json.loads(limits.attrs["warnings"])))


def test_sound_data_warn_of_nothing() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", SmfeWarning)
        smfe.compliance(np.arange(20.0, 90.0, 0.25), MACHINE.matrix(np.arange(20.0, 90.0, 0.25)))


def test_a_force_of_the_wrong_sign_is_warned_of() -> None:
    f = np.arange(20.0, 90.0, 0.25)
    with pytest.warns(SmfeWarning, match="the direct compliance xx gives out energy"):
        smfe.compliance(f, -MACHINE.matrix(f)[:, 0, 0])
