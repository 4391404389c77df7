"""`smfe plan`: what it writes, what it refuses, which limit it names, and whether its prediction comes true."""

import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from places import DATASETS

from process.errors import InputError
from smfe import cli, simulate
from smfe.commands.plan import plan
from smfe.planning.limits import KEYS
from smfe.planning.recommend import Plan, recommend
from smfe.planning.search import Search
from smfe.planning.task import load_task
from smfe.planning.verification import Verification, explain, verify
from smfe.results import read_groups
from smfe.scenario import load_scenario
from stability import semi_discretization, zero_order

EXAMPLE = DATASETS / "plans" / "milling_machine.toml"

QUICK = """
frequency_range = ["25 Hz", "65 Hz"]
inserts = [2]
feed_per_tooth = "0.1 mm"
depth_of_cut = ["0.5 mm", "2 mm"]
longest_pass = "20 s"
largest_error = "60 %"
passes = [
    { cut = "down", width_of_cut = "12 mm" },
    { cut = "up", width_of_cut = "12 mm" },
    { cut = "central", width_of_cut = "12 mm" },
]
"""


NOISY_SENSORS = f'{QUICK}\nacceleration_noise = "0.3 m/s^2"\nforce_noise = "5 N"'
ONE_RANGE = ('minimum = "150 rpm"', 'minimum = "720 rpm"')
"""Of the spindle: only one range of speeds then covers the band without a gap."""


def written(folder: Path, settings: str = QUICK, *changes: tuple[str, str]) -> Path:
    """Write a task: the machine of the example with changes of its text, and a table [plan]."""
    head = EXAMPLE.read_text(encoding="utf-8").split("[plan]")[0]
    for old, new in changes:
        assert old in head
        head = head.replace(old, new)
    path = folder / "task.toml"
    path.write_text(f"{head}\n[plan]\n{settings}", encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Plan, Path]:
    folder = tmp_path_factory.mktemp("plan")
    return plan(written(folder, QUICK, ONE_RANGE), folder / "out"), folder / "out"


# --- what is written ------------------------------------------------------------------------------------------------


def test_the_folder_holds_campaign_passes_prediction_scenario_and_page(found: tuple[Plan, Path]) -> None:
    result, out = found
    names = {str(p.relative_to(out)) for p in out.rglob("*") if p.is_file()}
    kinds = ("top_view", "band", "error", "forces", "condition", "level", "chatter")
    figures = {f"figures/plan_{n}.png" for n in kinds}
    assert names == {"plan.toml", "plan.csv", "prediction.nc", "scenario.toml", "plan.html"} | figures
    prediction = read_groups(out / "prediction.nc")["sweep"]
    assert prediction["compliance_std"].dims == ("frequency", "response", "excitation")
    assert prediction["compliance_std"].attrs["units"] == "m/N"
    assert prediction["relative_error"].max() == pytest.approx(result.worst)
    assert "data:image/png" in (out / "plan.html").read_text(encoding="utf-8")


def test_the_passes_are_in_field_units_and_agree_with_each_other(found: tuple[Plan, Path]) -> None:
    result, out = found
    table, sweep = pd.read_csv(out / "plan.csv"), result.sweep
    assert list(table["cut"]) == ["down", "up", "central"]
    rpm = table["spindle_from_rpm"] + table["spindle_acceleration_rpm_s"] * table["duration_s"]
    np.testing.assert_allclose(rpm, table["spindle_to_rpm"], rtol=1e-6)
    feed = table["feed_per_tooth_from_mm"] * table["inserts"] * table["spindle_from_rpm"]
    np.testing.assert_allclose(feed, table["feed_mm_min"], rtol=1e-6)
    np.testing.assert_allclose(table["feed_mm_min"] / 60.0 * table["duration_s"], table["length_of_cut_mm"], rtol=1e-6)
    assert (table["depth_of_cut_mm"] <= 0.5 * table["smallest_limit_depth_mm"]).all()
    arc = sweep.passes[0].engagement(sweep.tool.diameter)
    speeds = result.prediction["spindle_speed"].values
    machine, material = result.task.estimate.source, result.task.coefficients
    found = semi_discretization(machine, sweep.tool, arc, material, speeds)["limit_depth"].values
    # Not the zero-order method, which is 40 % too deep here.
    np.testing.assert_allclose(table["smallest_limit_depth_mm"][0], found.min(), rtol=0.02)
    assert zero_order(machine, sweep.tool, arc, material, speeds)["limit_depth"].values.min() > 1.1 * found.min()
    assert table["depth_of_cut_mm"][0] == pytest.approx(1e3 * sweep.depth)


def test_campaign_and_scenario_say_the_same_sweep(found: tuple[Plan, Path]) -> None:
    result, out = found
    campaign = tomllib.loads((out / "plan.toml").read_text(encoding="utf-8"))
    records = campaign["measurement"][0]["records"]
    assert [r["file"] for r in records] == list(pd.read_csv(out / "plan.csv")["file"])
    assert campaign["tool"]["teeth"] == result.sweep.tool.teeth
    scenario = load_scenario(out / "scenario.toml")
    trial = scenario.file.trial[0]
    assert trial.spindle_speed == pytest.approx([result.sweep.start, result.sweep.end])
    assert trial.feed_per_tooth == pytest.approx(result.sweep.feed_per_tooth)
    assert (trial.spindle_speed[1] - trial.spindle_speed[0]) / trial.rate == pytest.approx(result.sweep.duration)
    assert [(p.cut, p.width_of_cut) for p in trial.passes] == [(p.cut, p.width) for p in result.sweep.passes]


# --- the search -----------------------------------------------------------------------------------------------------


def test_the_recommended_sweep_keeps_every_limit_and_the_rejected_break_one(tmp_path: Path) -> None:
    limits = EXAMPLE.read_text(encoding="utf-8").split("[plan]")[1].replace('["8 mm", "76 mm"]', '["8 mm", "32 mm"]')
    table = Search(load_task(written(tmp_path, f"{limits}\ninserts = [2]"))).table()
    ratio = table[list(KEYS)].to_numpy()
    good = (ratio <= 1.0 + 1e-9).all(axis=1)
    assert 0 < good.sum() < good.size
    rows = table[good]
    assert (
        rows["feed_per_tooth"] * rows["start"] * rows["inserts"] / (2 * math.pi) * (rows["duration"] + 2.5) <= 0.4001
    ).all()
    assert ((rows["end"] - rows["start"]) / rows["duration"] <= 15.0 * math.pi / 30.0 * 1.01).all()
    assert rows["depth"].between(0.5e-3 - 1e-9, 3e-3 + 1e-9).all()


@pytest.mark.parametrize(
    ("limit", "needs"),
    [
        ('stroke = "5 mm"', r"a longer stroke: \d+(\.\d+)? mm instead of 5 mm \(plan.stroke\)"),
        ('power = "10 W"', r"more power: .* kW instead of 0.01 kW"),
        ('largest_force = "20 N"', r"a larger force: .* N instead of 20 N"),
        ('spindle_acceleration = "1 rpm/s"', r"a faster spindle acceleration: .* instead of 1 rpm/s"),
        ('time = "20 s"', r"more time: .* s instead of 20 s"),
        ('feed = ["10 mm/min", "20 mm/min"]', r"a higher feed: .* mm/min instead of 20 mm/min"),
        ('force_noise = "1 kN"', r"a larger error: .* % instead of 60 % \(plan.largest_error\)"),
        ('chatter_margin = "1 %"', r"a more stable cut: at most .* mm are safe, 0.5 mm are asked"),
    ],
)
def test_where_no_sweep_works_the_limit_to_lift_is_named(limit: str, needs: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none of \d+ sweeps looked at identifies 25 to 65 Hz") as refused:
        recommend(load_task(written(tmp_path, f"{QUICK}\n{limit}", ONE_RANGE)))
    assert re.search(needs, str(refused.value))


def test_lifting_the_named_limit_as_far_as_it_says_makes_a_plan(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        recommend(load_task(written(tmp_path, f'{QUICK}\nstroke = "5 mm"', ONE_RANGE)))
    wanted = float(re.search(r"stroke: ([\d.]+) mm", str(refused.value))[1])  # type: ignore[index]
    found = recommend(load_task(written(tmp_path, f'{QUICK}\nstroke = "{1.01 * wanted:.4g} mm"', ONE_RANGE)))
    assert found.sweep.travel <= 1.01e-3 * wanted


def test_a_slow_spindle_is_named(tmp_path: Path) -> None:
    path = written(tmp_path, QUICK, ('maximum = "3000 rpm"', 'maximum = "300 rpm"'))
    with pytest.raises(InputError, match=r"a higher spindle speed: .* rpm instead of 300 rpm \(spindle.maximum\)"):
        recommend(load_task(path))


def test_half_immersion_up_and_down_with_a_slot_is_refused(tmp_path: Path) -> None:
    dependent = QUICK.replace('"down", width_of_cut = "12 mm"', '"down", width_of_cut = "40 mm"')
    dependent = dependent.replace('"up", width_of_cut = "12 mm"', '"up", width_of_cut = "40 mm"')
    dependent = dependent.replace('"central", width_of_cut = "12 mm"', '"central", width_of_cut = "80 mm"')
    with pytest.raises(InputError, match=r"plan.passes: .*add up to the slot"):
        recommend(load_task(written(tmp_path, dependent)))


def test_a_force_sensor_is_only_refused_where_the_estimator_would_solve_nothing(tmp_path: Path) -> None:
    """Noise above a third of the force was refused, though what it costs is known and may well be affordable."""
    noisy = QUICK.replace('["0.5 mm", "2 mm"]', '"0.5 mm"')
    found = recommend(load_task(written(tmp_path, f'{noisy}\nforce_noise = "35 N"', ONE_RANGE)))
    assert found.prediction.attrs["force_noise_ratio"] < 1.0
    assert 0.1 < found.worst < 0.6


def test_the_largest_error_is_that_of_the_estimator_and_not_of_the_ranking(tmp_path: Path) -> None:
    """The noise in one band, by which alternatives are ranked, is up to twice what the model errs by."""
    task = load_task(written(tmp_path, NOISY_SENSORS.replace('"60 %"', '"2.7 %"'), ONE_RANGE))
    assert Search(task).table()["worst"].min() > 0.03
    assert recommend(task).worst < 0.027


def test_sensors_without_noise_are_planned_for(tmp_path: Path) -> None:
    noiseless = f'{QUICK}\nacceleration_noise = "0 m/s^2"\nforce_noise = "0 N"'
    row = Search(load_task(written(tmp_path, noiseless))).table()["worst"]
    assert np.isfinite(row).all()


@pytest.mark.slow
def test_without_noise_the_expected_error_is_below_a_thousandth(tmp_path: Path) -> None:
    noiseless = f'{QUICK}\nacceleration_noise = "0 m/s^2"\nforce_noise = "0 N"'
    assert recommend(load_task(written(tmp_path, noiseless))).worst < 1e-3


@pytest.mark.slow
def test_repeats_are_cut_where_one_is_not_enough(tmp_path: Path) -> None:
    once = recommend(load_task(written(tmp_path)))
    strict = QUICK.replace('"60 %"', f'"{70.0 * once.worst:.3g} %"')
    with pytest.raises(InputError, match="a larger error"):
        recommend(load_task(written(tmp_path, strict)))
    again = recommend(load_task(written(tmp_path, f"{strict}\nrepeats = 4")))
    assert again.sweep.repeats > 1
    assert again.worst <= 0.7 * once.worst


# --- what is refused ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ("strok = '1 m'", r"plan.strok: this key is not known \(did you mean 'stroke'\?\)"),
        ("stroke = 400", "plan.stroke: 400 has no unit"),
        ("stroke = '400 N'", "plan.stroke: unit 'N' is not a unit of length"),
        ("feed_per_tooth = ['0.2 mm', '0.1 mm']", "plan.feed_per_tooth: .* is no range"),
        ("inserts = [3]", "plan.inserts: 3 inserts cannot be spaced equally .* possible are 4, 2, 1"),
        ("passes = [{ cut = 'down', width_of_cut = '12 mm' }]", "1 passes; nine compliances need three"),
        ("passes = [{ cut = 'down', width_of_cut = '120 mm' }]", "wider than the tool"),
        ("machine = 'unknown'", "plan.machine: 'unknown' is neither a measurement nor a model"),
        ("machine = 'earlier_test'\nscenario = 'a.toml'", "one estimate of the machine is needed"),
        ("acceleration_noise = '-1 m/s^2'", "noise is zero or more"),
        ("sample_rate = '100 Hz'", "sample at 400 Hz or more"),
        ("frequency_range = ['2 Hz', '80 Hz']", "begin higher"),
        ("chatter_margin = 0.0", "must be above zero"),
        ("longest_pass = '1 ms'", "a sweep takes at least 1 s"),
        ("scenario = 'none.toml'", "cannot be read"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(settings: str, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        recommend(load_task(written(tmp_path, settings)))


def test_a_wrong_plan_writes_nothing_and_a_right_one_does_not_overwrite_its_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path, f'{QUICK}\npower = "1 W"')
    monkeypatch.setattr("sys.argv", ["smfe", "plan", str(path), "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        cli.app_entry()
    assert ended.value.code == 1
    assert "more power" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    mine = tmp_path / "plan.toml"
    mine.write_bytes(path.read_bytes())
    with pytest.raises(InputError, match="overwrite its own input"):
        plan(mine, tmp_path)


def test_run_out_is_not_planned_for(tmp_path: Path) -> None:
    path = written(tmp_path, QUICK, ("teeth = 4", 'teeth = 2\nrunout = ["10 um", "-10 um"]'))
    with pytest.raises(InputError, match=r"the tool has run-out; .* leave pitch_angles and runout out"):
        load_task(path)


def test_a_measured_estimate_cannot_be_verified_and_says_so(found: tuple[Plan, Path]) -> None:
    from dataclasses import replace

    result, _ = found
    measured = replace(result.task.estimate, machine=None)
    with pytest.raises(InputError, match="cannot be simulated"):
        verify(replace(result, task=replace(result.task, estimate=measured)))


def test_found_twice_what_was_expected_is_not_confirmed_and_said() -> None:
    ratio = np.array([2.31] * 5 + [1.0] * 4)
    columns = {"predicted_percent": 0.05, "measured_percent": 0.05 * ratio, "ratio": ratio}
    columns |= {f"bands_{name}": value for name, value in columns.items()} | {"ratio_low": 0.5, "ratio_high": 1.7}
    table = pd.DataFrame({"entry": [r + e for r in "xyz" for e in "xyz"], **columns})
    text = explain(Verification(table, 1.0, (1,)))
    assert "NOT confirmed: found was xx 2.31 times the expected (0.50 to 1.70)" in text
    assert "median ratio 2.31" in text
    right = Verification(table.assign(ratio=1.2), 1.0, (1,))
    assert right.confirmed
    assert not Verification(table.assign(ratio=np.nan), 1.0, (1,)).confirmed


# --- what it starts from --------------------------------------------------------------------------------------------

HAMMER = """
[[trial]]
method = "hammer"
hits = 2
impulse = "5 N s"
interval = "3 s"
frequency_range = ["15 Hz", "90 Hz"]
"""


@pytest.fixture
def machine(tmp_path: Path) -> str:
    """Write the machine of the example as a scenario without trials; return its text."""
    whole = (EXAMPLE.parents[1] / "scenarios" / "milling_machine.toml").read_text(encoding="utf-8")
    text = whole.split("[sensors]")[0]
    (tmp_path / "machine.toml").write_text(text + HAMMER, encoding="utf-8")
    return text


def test_modes_and_a_scenario_of_them_lead_to_the_same_sweep(
    found: tuple[Plan, Path], machine: str, tmp_path: Path
) -> None:
    by_modes, _ = found
    by_scenario = recommend(load_task(written(tmp_path, f'scenario = "machine.toml"\n{QUICK}', ONE_RANGE)))
    assert by_scenario.sweep == by_modes.sweep
    assert by_scenario.worst == pytest.approx(by_modes.worst, rel=1e-6)


@pytest.mark.slow
def test_a_hammer_test_leads_to_the_sweep_of_the_modes(machine: str, tmp_path: Path) -> None:
    campaign = simulate(tmp_path / "machine.toml", tmp_path / "hammered", show=lambda text: None)
    measured = campaign.read_text(encoding="utf-8").split("[[model]]")
    hammer = measured[0] + "[[measurement]]" + measured[1].split("[[measurement]]")[1]
    text = f"{hammer}\n[plan]\n{QUICK}"
    (campaign.parent / "hammer.toml").write_text(text, encoding="utf-8")
    by_hammer = recommend(load_task(campaign.parent / "hammer.toml"))
    by_modes = recommend(load_task(written(tmp_path)))
    assert by_hammer.sweep.depth == pytest.approx(by_modes.sweep.depth, abs=0.11e-3)
    # A hammer test of two hits is enough to predict the error of the sweep.
    assert by_hammer.worst == pytest.approx(by_modes.worst, rel=0.25)


# --- does it come true ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_plans_and_verifies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "out"
    monkeypatch.setattr(
        "sys.argv", ["smfe", "plan", str(written(tmp_path)), "-o", str(out), "--verify", "--seeds", "1"]
    )
    with pytest.raises(SystemExit) as ended:
        cli.app_entry()
    assert ended.value.code == 0
    printed = capsys.readouterr().out
    assert "cut down 12 mm, up 12 mm, central 12 mm, once each: 2 inserts" in printed
    assert "the prediction is confirmed" in printed
    assert (out / "verification.csv").is_file()
    # A new plan is not verified by an old verification.
    plan(tmp_path / "task.toml", out)
    assert not (out / "verification.csv").exists()


FIXED = """
frequency_range = ["20 Hz", "80 Hz"]
inserts = [2]
feed_per_tooth = "0.1 mm"
largest_error = "60 %"
passes = [
    { cut = "down", width_of_cut = "12 mm" },
    { cut = "up", width_of_cut = "12 mm" },
    { cut = "central", width_of_cut = "12 mm" },
]
"""
NOISY = 'longest_pass = "30 s"\ndepth_of_cut = "2 mm"\nacceleration_noise = "0.3 m/s^2"\nforce_noise = "20 N"'
SHORT = 'longest_pass = "12 s"\ndepth_of_cut = "1 mm"'
CASES = {
    "much noise": (NOISY, ("", "")),
    "noise of the forces alone": (NOISY.replace("0.3 m/s^2", "0.001 m/s^2"), ("", "")),
    "a short sweep": (SHORT, ("", "")),
    "a helix and hardly any axial force": (SHORT, ('"45 deg"', '"90 deg"\nhelix_angle = "30 deg"')),
    "one part in two hundred of the diameter": (f"{SHORT}\nforce_noise = '0.5 N'", ("", "")),
    "little damping": (f'{SHORT}\nchatter_margin = "90 %"', ("damping = 0.0287", "damping = 0.01")),
}


LONGER = ("a helix and hardly any axial force", "one part in two hundred of the diameter")


@pytest.mark.parametrize(
    "case", [pytest.param(c, marks=getattr(pytest.mark, "exam" if c in LONGER else "slow")) for c in CASES]
)
def test_the_prediction_comes_true_for_other_sweeps(case: str, tmp_path: Path) -> None:
    settings, change = CASES[case]
    fixed = FIXED.replace('width_of_cut = "12 mm"', 'width_of_cut = "0.4 mm"') if "part" in case else FIXED
    # The error of a model is that of a few poles: one draw says less of it than of many bands.
    checked = verify(recommend(load_task(written(tmp_path, f"{fixed}\n{settings}", change))), None, (1, 2, 3))
    # Four of six are confirmed; a short sweep and little damping leave their intervals, which is not yet understood.
    assert checked.table["ratio"].between(0.35, 2.5).all(), explain(checked)
    assert 0.6 < checked.median_ratio < 1.6
    assert checked.condition_ratio == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_the_prediction_comes_true(tmp_path: Path) -> None:
    result = recommend(load_task(EXAMPLE))
    checked = verify(result, tmp_path, (1, 2))
    assert checked.table["bands_ratio"].between(0.45, 2.0).all()
    assert checked.table["bands_ratio"].median() == pytest.approx(1.0, abs=0.2)
    assert checked.condition_ratio == pytest.approx(1.0, abs=0.1)
    assert 0.6 < checked.median_ratio < 1.6
    assert (tmp_path / "verification.csv").is_file()


def test_an_estimate_in_memory_gives_the_plan_of_the_campaign(found: tuple[Plan, Path]) -> None:
    by_path, _ = found
    tables = tomllib.loads(by_path.task.path.read_text(encoding="utf-8"))
    limits = {key: value for key, value in tables["plan"].items() if key != "machine"}
    of = by_path.task
    given = plan(of.estimate.source, tool=of.tool, material=tables["material"], spindle=tables["spindle"], **limits)
    assert given.sweep == by_path.sweep
    assert given.worst == pytest.approx(by_path.worst, rel=1e-12)
