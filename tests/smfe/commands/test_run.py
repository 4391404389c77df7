"""The main job, end to end: a campaign on a linear machine through the same code as anybody's own campaign."""

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from kept import kept
from nptdms import ChannelObject, RootObject, TdmsWriter
from samples.campaigns import HAMMER
from samples.linear_machine import DEMO, MACHINE, DemoSize, write_demo
from scipy.io import savemat

import smfe
from process.errors import InputError
from smfe import cli
from smfe.campaign import Measurement, load_campaign
from smfe.commands.run import Notes, _provenance, check_folder
from smfe.diagnosis import audit
from smfe.identification import measurement as measurements
from smfe.identification.errors.result import Identification
from smfe.kept import KEPT
from smfe.results import read_groups
from stability import LOBE_COLUMNS

SMALL = DemoSize(
    sweep_rate=6.0,
    sweep_duration=16.25,
    hits=3,
    actuator_step=3.0,
    cutting_tests=((700, 5.0), (950, 5.0), (950, 8.5)),
    lobe_step=25,
)
"""The same machine and methods; sweeps four times as fast, fewer hits, steps, cuts and speeds of the lobes."""

VERDICTS = {
    (700, 3.0): "stable",
    (700, 5.0): "chatter",
    (950, 5.0): "stable",
    (950, 8.5): "chatter",
    (1150, 3.0): "stable",
    (1150, 5.0): "chatter",
}
"""Spindle speed [rpm] and depth [mm] of a cutting test -> what the simulated machine does."""


def small_demo(folder: Path, size: DemoSize) -> None:
    smfe.run(write_demo(folder, size=size), folder / "results")


def full_demo(folder: Path) -> None:
    small_demo(folder, DEMO)


@pytest.fixture(scope="session", params=["small", pytest.param("full", marks=pytest.mark.slow)])
def size(request: pytest.FixtureRequest) -> DemoSize:
    return SMALL if request.param == "small" else DEMO


@pytest.fixture(scope="session")
def demo(size: DemoSize) -> Path:
    """Folder of a demonstration that has been run."""
    return kept(full_demo) if size is DEMO else kept(small_demo, size)


def command(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run the command line in this process and return its exit code."""
    monkeypatch.setattr(sys, "argv", ["smfe", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        cli.app_entry()
    return int(stop.value.code or 0)


def test_every_promised_file_is_written(demo: Path) -> None:
    results = demo / "results"
    for name in (
        "frf.nc",
        "lobes.nc",
        "comparison.csv",
        "lobe_table.csv",
        "pockets.csv",
        "presets.json",
        "chatter.csv",
        "report.html",
        "provenance.json",
    ):
        assert (results / name).stat().st_size > 0, name
    assert list((results / "figures").glob("*.png"))
    assert not list(demo.rglob("*.part"))


def test_every_method_finds_the_machine_that_was_simulated(demo: Path) -> None:
    groups = read_groups(demo / "results" / "frf.nc")
    assert set(groups) == {"hammer", "hammer_moving", "actuator", "sweep", "sweep_force_x_only", "known_machine"}
    # The whole matrix, relative to its own size: noise levels and seeds are those of the demonstration.
    bounds = {"hammer": 0.05, "hammer_moving": 0.05, "actuator": 0.01, "sweep": 0.01, "sweep_force_x_only": 0.05}
    for name, bound in bounds.items():
        compliance = groups[name]["compliance"].sel(frequency=slice(20.0, 80.0))
        assert compliance.shape[1:] == (3, 3), name
        assert compliance.size > 0, name
        finite = np.isfinite(compliance.values).all(axis=(1, 2))
        assert finite.mean() > 0.9, name
        compliance = compliance[finite]
        truth = MACHINE.matrix(compliance["frequency"].values)
        error = np.sqrt(np.sum(np.abs(compliance.values - truth) ** 2) / np.sum(np.abs(truth) ** 2))
        assert error < bound, name


def test_lobes_of_every_source_agree_with_those_of_the_machine(demo: Path) -> None:
    lobes = read_groups(demo / "results" / "lobes.nc")
    truth = lobes["lobes_1/known_machine"]["limit_depth"]
    for source in ("hammer", "actuator", "sweep"):
        ratio = lobes[f"lobes_1/{source}"]["limit_depth"] / truth
        assert float(np.abs(ratio - 1.0).quantile(0.9)) < 0.05, source


def test_the_lobe_table_has_the_columns_that_cam_reads(demo: Path) -> None:
    table = pd.read_csv(demo / "results" / "lobe_table.csv")
    assert tuple(table.columns) == LOBE_COLUMNS
    row = table[(table["source"] == "sweep") & (table["spindle_speed_rpm"] == 950)].iloc[0]
    feed = 0.1 * 2 * 950
    assert row["feed_mm_min"] == pytest.approx(feed)
    assert row["removal_rate_cm3_min"] == pytest.approx(row["limit_depth_mm"] * 40.0 * feed / 1e3, rel=1e-6)


def test_cutting_tests_are_judged_as_the_simulation_made_them(demo: Path, size: DemoSize) -> None:
    table = pd.read_csv(demo / "results" / "chatter.csv", keep_default_na=False)
    assert len(table) == len(size.cutting_tests)
    expected = [VERDICTS[test] for test in size.cutting_tests]
    assert set(expected) == {"stable", "chatter"}
    assert list(table["verdict"]) == expected
    assert list(table["predicted_sweep"]) == expected
    assert list(table["predicted_known_machine"]) == expected


def test_the_table_of_errors_shows_all_references_ahead_of_force_x_alone(demo: Path) -> None:
    errors = pd.read_csv(demo / "results" / "model_error.csv").pivot(
        index=["response", "excitation"], columns="measurement", values="error_percent"
    )
    ours, theirs = errors["sweep"], errors["sweep_force_x_only"]
    assert len(ours) == 9
    assert ours.mean() < 0.75 * theirs.mean()
    assert (ours / theirs).max() < 1.05


def test_the_demo_separates_feed_from_method_and_names_what_it_cannot_separate(demo: Path) -> None:
    """The simulated machine does not know its feed; method and level change together, so they are judged together."""
    table = pd.read_csv(demo / "results" / "explained.csv", keep_default_na=False)
    # Where only one of the hammer tests has a peak, feed cannot be separated there either.
    assert set(table["factor"]) == {"feed", "method + level", "method + feed + level"}
    feed = table[table["factor"] == "feed"]
    assert len(feed) > 20
    assert (feed["aliased_with"] == "").all()
    # Frequency, damping and amplitude together have no size.
    assert pd.to_numeric(feed["effect_percent"]).median() < 1.0
    assert not (feed["significant"] == "True").any()


@pytest.mark.slow
def test_a_second_run_reads_back_what_every_method_has_identified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small_demo(tmp_path, SMALL)

    def identified(campaign: object, measurement: object, *_: object) -> None:
        raise AssertionError(f"identified again: {measurement}")

    monkeypatch.setattr(measurements, "identify_measurement", identified)
    results, kept = tmp_path / "results", tmp_path / "results" / KEPT
    before = {p.name: p.stat().st_mtime_ns for p in kept.glob("*.nc")}
    compliance = read_groups(results / "frf.nc")["sweep"]
    smfe.run(tmp_path / "campaign.toml", results)
    assert json.loads((results / "provenance.json").read_text())["failures"] == []
    assert {p.name: p.stat().st_mtime_ns for p in kept.glob("*.nc")} == before
    assert read_groups(results / "frf.nc")["sweep"].identical(compliance)
    with pytest.raises(AssertionError, match="identified again"):
        smfe.identify(tmp_path / "campaign.toml", tmp_path / "elsewhere" / "frf.nc")


def test_provenance_names_every_input_with_its_hash(demo: Path) -> None:
    provenance = json.loads((demo / "results" / "provenance.json").read_text())
    named = {entry["file"] for entry in provenance["inputs"]}
    assert named == {"campaign.toml", *(p.name for p in (demo / "records").iterdir())}
    assert all(len(entry["sha256"]) == 64 for entry in provenance["inputs"])


def test_provenance_names_air_cuts(tmp_path: Path, demo: Path) -> None:
    shutil.copytree(demo, tmp_path / "demo", ignore=shutil.ignore_patterns("results"))
    path = tmp_path / "demo" / "campaign.toml"
    text = path.read_text(encoding="utf-8")
    assert text.count('method = "sweep"') > 1
    shutil.copy(next((tmp_path / "demo" / "records").glob("sweep*")), tmp_path / "demo" / "air.csv")
    path.write_text(text.replace('method = "sweep"', 'method = "sweep"\nbackground = "air.csv"', 1), encoding="utf-8")
    named = {e["file"] for e in _provenance(load_campaign(path), Notes(), {})["inputs"]}
    assert "air.csv" in named


def test_the_single_verbs_do_their_part(demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign, frf = demo / "campaign.toml", demo / "results" / "frf.nc"
    assert (
        command(monkeypatch, "lobes", campaign, "--frf", frf, "-o", tmp_path / "l.nc", "--table", tmp_path / "t.csv")
        == 0
    )
    assert command(monkeypatch, "compare", frf, "-o", tmp_path / "c.csv") == 0
    record = demo / "records" / "cut_700rpm_5mm.csv"
    assert command(monkeypatch, "chatter", record, "--speed", "700 rpm", "--teeth", 2) == 0
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "t.csv"), pd.read_csv(demo / "results" / "lobe_table.csv"))
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "c.csv"), pd.read_csv(demo / "results" / "comparison.csv"))


def test_the_same_seed_makes_the_same_records(demo: Path, size: DemoSize, tmp_path: Path) -> None:
    write_demo(tmp_path, size=size)
    for name in ("hammer_z.csv", "cut_950rpm_8.5mm.csv"):
        assert (tmp_path / "records" / name).read_bytes() == (demo / "records" / name).read_bytes()


def hit_table() -> pd.DataFrame:
    """A good hammer record: three hits on a 50 Hz mode, 3 % damping, 5 N/um."""
    t = np.arange(12000) / 2000.0
    force = np.zeros(t.size)
    for start in (0.1, 2.1, 4.1):
        u = t - start
        force += np.where((u > 0) & (u < 4e-3), 1000 * np.sin(np.pi * np.clip(u, 0, 4e-3) / 4e-3), 0.0)
    r = np.fft.rfftfreq(2 * t.size, 1 / 2000.0) / 50.0
    accelerance = -((2 * np.pi * 50.0 * r) ** 2) / (5e6 * (1.0 - r**2 + 2j * 0.03 * r))
    motion = np.fft.irfft(accelerance * np.fft.rfft(force, 2 * t.size))[: t.size]
    noise = np.random.default_rng(1).standard_normal((2, t.size))
    return pd.DataFrame({"t": t, "Fx": force + 0.1 * noise[0], "ax": motion + 1e-3 * noise[1]})


def sines_table() -> pd.DataFrame:
    """A stepped sine, as an actuator makes it."""
    t = np.arange(12000) / 2000.0
    f = np.repeat([30.0, 40.0, 50.0], 4000)
    force = 100 * np.sin(2 * np.pi * np.cumsum(f) / 2000.0)
    return pd.DataFrame({"t": t, "Fx": force, "ax": 0.01 * force})


def with_nan(table: pd.DataFrame) -> pd.DataFrame:
    table.loc[77, "ax"] = np.nan
    return table


def mat_of(path: Path, cut: int | None = None, short: bool = False) -> None:
    columns = {name: hit_table()[name].to_numpy() for name in ("t", "Fx", "ax")}
    if short:
        columns["ax"] = columns["ax"][:-5]
    savemat(path, columns)
    if cut is not None:
        path.write_bytes(path.read_bytes()[:cut])


def test_what_is_identified_already_is_read_back_unless_its_record_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    campaign, results = tmp_path / "campaign.toml", tmp_path / "results"
    second = HAMMER[HAMMER.index("[[measurement]]") :].replace('"hammer"\nm', '"again"\nm').replace("hit", "again")
    campaign.write_text(HAMMER + second)
    table = hit_table()
    for name in ("hit.csv", "again.csv"):
        table.to_csv(tmp_path / name, index=False)
    smfe.identify(campaign, results / "frf.nc")
    compliance = read_groups(results / "frf.nc")
    before = {p.name: p.stat().st_mtime_ns for p in (results / KEPT).glob("*.nc")}
    identified: list[str] = []
    identify = measurements.identify_measurement

    def noted(campaign: object, measurement: Measurement, *rest: object) -> Identification:
        identified.append(measurement.name)
        return identify(campaign, measurement, *rest)

    monkeypatch.setattr(measurements, "identify_measurement", noted)
    smfe.run(campaign, results)
    assert identified == []
    assert json.loads((results / "provenance.json").read_text())["failures"] == []
    assert {p.name: p.stat().st_mtime_ns for p in (results / KEPT).glob("*.nc")} == before
    again = read_groups(results / "frf.nc")
    assert set(again) == set(compliance) == {"hammer", "again"}
    assert all(again[name].identical(compliance[name]) for name in again)
    smfe.identify(campaign, tmp_path / "elsewhere" / "frf.nc")
    assert identified == ["hammer", "again"]
    table.iloc[:-1].to_csv(tmp_path / "hit.csv", index=False)
    smfe.identify(campaign, results / "frf.nc")
    assert identified == ["hammer", "again", "hammer"]
    after = {p.name: p.stat().st_mtime_ns for p in (results / KEPT).glob("*.nc")}
    (old,) = before.keys() - after.keys()
    (new,) = after.keys() - before.keys()
    assert old.startswith("hammer-")
    assert new.startswith("hammer-")


def csv(change: object = None) -> object:
    """Return a writer of hit.csv with a change made to a good table."""

    def write(folder: Path) -> None:
        table = hit_table() if change is None else change(hit_table())  # type: ignore[operator]
        table.to_csv(folder / "hit.csv", index=False)

    return write


def cut_table() -> pd.DataFrame:
    """A stable cut with 2 teeth at 1500 rpm."""
    t = np.arange(16000) / 2000.0
    motion = 10 * np.cos(2 * np.pi * 50.0 * t) + 0.02 * np.random.default_rng(2).standard_normal(t.size)
    return pd.DataFrame({"t": t, "Fx": 10 * motion, "ax": motion})


CUTTING_TEST = """
[[cutting_test]]
file = "cut.csv"
spindle_speed = "1500 rpm"
depth_of_cut = "1 mm"
cut = "down"
width_of_cut = "40 mm"
feed_per_tooth = "0.1 mm"
"""

WRONG_COLUMN = '[cutting_test.channels]\nacceleration_x = { column = "az", unit = "m/s^2" }\n'


def with_cut(folder: Path) -> None:
    hit_table().to_csv(folder / "hit.csv", index=False)
    cut_table().to_csv(folder / "cut.csv", index=False)


def three_forces(folder: Path) -> None:
    noise = np.random.default_rng(3).standard_normal((4, 20000))
    columns = dict(zip(("Fx", "Fy", "Fz", "ax"), noise, strict=True))
    pd.DataFrame({"t": np.arange(20000) / 2000.0, **columns}).to_csv(folder / "hit.csv", index=False)


SWEEPS = """
[[measurement]]
name = "sweep"
method = "sweep"
records = [
    { file = "hit.csv", cut = "down", width_of_cut = "12 mm" },
    { file = "hit.csv", cut = "up", width_of_cut = "12 mm" },
]
"""

SWAPPED = ["hit.csv", "force_x is not a series of hammer hits", "method = 'actuator'"]

THREE_SWEEPS = """
[[measurement]]
name = "sweep"
method = "sweep"
frequency_range = ["2000 Hz", "3000 Hz"]
records = [
    { file = "hit.csv", cut = "down", width_of_cut = "24 mm" },
    { file = "hit.csv", cut = "up", width_of_cut = "40 mm" },
    { file = "hit.csv", cut = "central", width_of_cut = "68 mm" },
]
[measurement.channels]
force_y = { column = "Fy", unit = "N" }
force_z = { column = "Fz", unit = "N" }
"""

BAD_INPUT = {
    "missing file": (lambda s: s.replace("hit.csv", "hits.csv"), csv(), ["hits.csv"]),
    "missing campaign": (None, csv(), ["campaign.toml", "No such file"]),
    "wrong column": (lambda s: s.replace('"ax"', '"a_x"'), csv(), ["a_x", "ax"]),
    "wrong unit": (lambda s: s.replace('"m/s^2"', '"N/mm"'), csv(), ["channels.acceleration_x", "N/mm"]),
    "unknown key": (lambda s: s.replace("teeth = 2", "teeth = 2\ntooth = 3"), csv(), ["tool.tooth", "teeth"]),
    "NaN in a channel": (lambda s: s, csv(with_nan), ["acceleration_x", "77"]),
    "records of different length": (
        lambda s: s.replace("hit.csv", "hit.mat"),
        lambda folder: mat_of(folder / "hit.mat", short=True),
        ["hit.mat", "12000", "11995"],
    ),
    "only two sweeps": (lambda s: s + SWEEPS, csv(), ["2 passes", "three"]),
    "swapped method": (lambda s: s, lambda folder: sines_table().to_csv(folder / "hit.csv", index=False), SWAPPED),
    "hits as actuator": (lambda s: s.replace('"hammer"\nrec', '"actuator"\nrec'), csv(), ["hammer hits", "sine"]),
    "empty record": (lambda s: s, csv(lambda t: t.iloc[:0]), ["hit.csv: no rows of numbers"]),
    "empty file": (lambda s: s, lambda folder: (folder / "hit.csv").write_text(""), ["hit.csv", "empty"]),
    "truncated MAT file": (
        lambda s: s.replace("hit.csv", "hit.mat"),
        lambda folder: mat_of(folder / "hit.mat", cut=5000),
        ["hit.mat", "truncated"],
    ),
    "wrong column in a cutting test": (
        lambda s: s + CUTTING_TEST + WRONG_COLUMN,
        with_cut,
        ["cut.csv: no column 'az'", "the file has 't', 'Fx', 'ax'"],
    ),
    "a band beyond the data": (
        lambda s: s[: s.index("[[measurement]]")] + THREE_SWEEPS,
        three_forces,
        ["2000", "3000", "Nyquist"],
    ),
    "broken TOML": (lambda s: s.replace("[tool]", "[tool"), csv(), ["line"]),
}


FILE_IS_WRONG = ("missing file", "missing campaign", "wrong unit", "unknown key", "only two sweeps", "broken TOML")
"""What is wrong with the campaign file itself; everything else costs the part that needs it."""


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_is_one_clear_message_and_exit_code_1_or_3(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    change, write, words = BAD_INPUT[case]
    if change is not None:
        (tmp_path / "campaign.toml").write_text(change(HAMMER))
    write(tmp_path)  # type: ignore[operator]
    out = tmp_path / "results"
    code = 1 if case in FILE_IS_WRONG else 3
    assert command(monkeypatch, "run", tmp_path / "campaign.toml", "--out", out) == code
    said = capsys.readouterr()
    assert "Traceback" not in said.err + said.out
    for word in words:
        assert word in said.err, f"{case}: {said.err}"
    assert not list(tmp_path.rglob("*.part"))
    if code == 1:
        assert not out.exists()
    else:
        failed = json.loads((out / "provenance.json").read_text())["failures"]
        assert len(failed) == 1
        for word in words:
            assert word in failed[0]["reason"]


def test_good_input_of_the_same_kind_runs_and_its_report_can_be_written_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "campaign.toml").write_text(HAMMER)
    hit_table().to_csv(tmp_path / "hit.csv", index=False)
    assert command(monkeypatch, "run", tmp_path / "campaign.toml", "--out", tmp_path / "results") == 0
    report = tmp_path / "results" / "report.html"
    written = report.read_bytes()
    report.unlink()
    assert command(monkeypatch, "report", tmp_path / "results") == 0
    assert report.read_bytes() == written


@pytest.mark.slow
def test_only_what_has_changed_is_computed_and_drawn_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nothing is touched while nothing has changed; a word in the campaign file leaves every number as it was."""
    campaign, out = tmp_path / "campaign.toml", tmp_path / "results"
    with_cut(tmp_path)
    campaign.write_text(HAMMER + CUTTING_TEST + SWEEPS_LOBES)
    asked = ("run", campaign, "--out", out)

    def times() -> dict[str, int]:
        return {p.name: p.stat().st_mtime_ns for p in out.rglob("*") if p.is_file()}

    assert command(monkeypatch, *asked) == 0
    first, written = contents(out), times()
    monkeypatch.setattr("smfe.run", lambda *_: pytest.fail("run again"), raising=False)
    capsys.readouterr()
    assert command(monkeypatch, *asked) == 0
    assert times() == written
    said = capsys.readouterr()
    assert "nothing has changed" in said.err
    assert "report: " in said.out
    monkeypatch.undo()
    assert smfe.run(campaign, out) == out / "report.html"
    assert times() == written
    campaign.write_text(campaign.read_text() + "# a word\n")
    monkeypatch.setattr(audit, "channel_suspects", lambda *_: pytest.fail("checked again"))
    smfe.run(campaign, out)
    again, rewritten = contents(out), times()
    assert {p.name for p in again if again[p] != first[p]} <= {"provenance.json", "report.html"}
    assert rewritten["report.html"] > written["report.html"]
    monkeypatch.undo()
    smfe.run(campaign, out, fresh=True)
    assert all(times()[name] > rewritten[name] for name in rewritten if name.startswith("hammer-"))
    fresh = contents(out)
    assert {p.name for p in fresh if fresh[p] != again[p]} <= {"provenance.json", "report.html"}


def contents(folder: Path) -> dict[Path, bytes]:
    files = [p for p in folder.rglob("*") if p.is_file()]
    return {p: p.read_bytes() for p in files if KEPT not in p.relative_to(folder).parts}


def test_a_campaign_file_that_is_wrong_leaves_an_older_folder_of_results_as_it_was(tmp_path: Path) -> None:
    campaign, out = tmp_path / "campaign.toml", tmp_path / "results"
    with_cut(tmp_path)
    campaign.write_text(HAMMER + CUTTING_TEST)
    smfe.run(campaign, out)
    before = contents(out)
    assert {"frf.nc", "chatter.csv", "provenance.json"} <= {p.name for p in before}
    campaign.write_text(HAMMER.replace('name = "hammer"', 'name = "other"') + CUTTING_TEST + "teeth = 4\n")
    with pytest.raises(InputError, match="teeth"):
        smfe.run(campaign, out)
    assert contents(out) == before


def test_a_folder_of_something_else_is_refused_before_the_work_and_left_as_it_was(tmp_path: Path) -> None:
    """Results of another campaign, which --fresh replaces, and a folder of the user's that a run would clear."""
    campaign, out = tmp_path / "campaign.toml", tmp_path / "results"
    campaign.write_text(HAMMER)
    (tmp_path / "hit.csv").write_text("no record: whoever reads it fails")
    (out / "tables").mkdir(parents=True)
    (out / "tables" / "mine.csv").write_text("mine")
    with pytest.raises(InputError, match=r"holds a folder 'tables' and no results.*--out"):
        smfe.run(campaign, out)
    (out / "provenance.json").write_text('{"campaign": "Large"}')
    with pytest.raises(InputError, match=r"results of another campaign, 'Large'.*--out.*--fresh"):
        smfe.run(campaign, out)
    assert {p.name for p in out.rglob("*")} == {"tables", "mine.csv", "provenance.json"}
    loaded = load_campaign(campaign)
    check_folder(out, loaded, fresh=True)
    (out / "provenance.json").write_text('{"campaign": "Small"}')
    check_folder(out, loaded)


HEAD = HAMMER[: HAMMER.index("[[measurement]]")]
WITHOUT_MATERIAL = HEAD[: HEAD.index("[material]")] + HEAD[HEAD.index("[channels]") :]
MODEL = """
[[model]]
name = "m"
modes = [ { frequency = "50 Hz", damping = 0.03, stiffness = "20 N/um", direction = [0.6, 0.7, 0.4] } ]
[[lobes]]
measurements = ["m"]
method = "zero_order"
cut = "down"
width_of_cut = "40 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["900 rpm", "1000 rpm", "10 rpm"]
"""


LOBES = {"lobes.nc", "lobe_table.csv", "pockets.csv", "presets.json"}


@pytest.mark.parametrize(
    ("text", "written"),
    [
        pytest.param(HEAD + MODEL, LOBES, marks=pytest.mark.slow),
        (WITHOUT_MATERIAL + CUTTING_TEST, {"chatter.csv", "spectra.nc"}),
        (HEAD + MODEL + CUTTING_TEST, LOBES | {"chatter.csv", "ranking.csv", "spectra.nc"}),
    ],
    ids=["model and lobes", "cutting test without material", "model, lobes, cutting test"],
)
def test_a_campaign_without_a_measurement_runs(text: str, written: set[str], tmp_path: Path) -> None:
    (tmp_path / "campaign.toml").write_text(text)
    with_cut(tmp_path)
    results = smfe.run(tmp_path / "campaign.toml", tmp_path / "results").parent
    files = {p.name for p in results.iterdir() if p.is_file()}
    always = {"frf.nc", "comparison.csv", "explained.csv", "model_error.csv", "provenance.json", "report.html"}
    assert files == always | written
    comparison = pd.read_csv(results / "comparison.csv")
    assert comparison.empty
    assert {"measurement_a", "measurement_b", "match", "frequency_a_Hz", "frac"} <= set(comparison.columns)
    if "chatter.csv" in written:
        row = pd.read_csv(results / "chatter.csv").iloc[0]
        assert row["verdict"] == "stable"
        assert ("predicted_m" in row) == ("lobes.nc" in written)


def test_lobes_makes_the_folder_of_its_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "campaign.toml").write_text(HEAD + MODEL)
    new = tmp_path / "new"
    arguments = ("lobes", tmp_path / "campaign.toml", "-o", new / "a" / "l.nc", "--table", new / "b" / "t.csv")
    assert command(monkeypatch, *arguments) == 0
    assert (new / "a" / "l.nc").is_file()
    assert (new / "b" / "t.csv").is_file()


@pytest.mark.parametrize("columns", [["t", "ax"], ["t", "Fx"], ["t", "Fx", "ax"]])
@pytest.mark.parametrize("suffix", [".csv", ".mat"])
def test_chatter_takes_the_default_columns_that_a_file_has(columns: list[str], suffix: str, tmp_path: Path) -> None:
    path, table = tmp_path / f"cut{suffix}", cut_table()[columns]
    if suffix == ".csv":
        table.to_csv(path, index=False)
    else:
        savemat(path, {name: table[name].to_numpy() for name in columns})
    verdict = smfe.chatter(path, "1500 rpm", 2)
    assert verdict.verdict == "stable"
    assert verdict.axes == ("x",)
    assert verdict.quantity == ("acceleration" if "ax" in columns else "force")


def test_chatter_takes_the_channels_of_a_tdms_file_with_its_clock(tmp_path: Path) -> None:
    path, table = tmp_path / "cut.tdms", cut_table()
    step = float(table["t"][1] - table["t"][0])
    clock = {"wf_increment": step, "wf_start_offset": 0.0, "wf_samples": len(table), "unit_string": "m/s^2"}
    with TdmsWriter(path) as writer:
        writer.write_segment([RootObject(), ChannelObject("run 1", "ax", table["ax"].to_numpy(), clock)])
    verdict = smfe.chatter(path, "1500 rpm", 2)
    assert verdict.verdict == "stable"
    assert verdict.quantity == "acceleration"


def test_chatter_says_what_it_looked_for_and_hides_no_other_fault(tmp_path: Path) -> None:
    path = tmp_path / "cut.csv"
    for columns in ({"ax": "acc", "Fx": "F"}, {"t": "time"}):
        cut_table().rename(columns=columns).to_csv(path, index=False)
        with pytest.raises(InputError, match=r"looked for .* t \[s\], Fx \[N\], .*az \[m/s\^2\].*needed"):
            smfe.chatter(path, "1500 rpm", 2)
    with_nan(cut_table()).to_csv(path, index=False)
    with pytest.raises(InputError, match=r"acceleration_x .* sample 77"):
        smfe.chatter(path, "1500 rpm", 2)


def test_wrong_usage_is_exit_code_2(monkeypatch: pytest.MonkeyPatch) -> None:
    assert command(monkeypatch, "run") == 2
    assert command(monkeypatch, "fly") == 2
    assert command(monkeypatch, "--version") == 0


@pytest.mark.slow
def test_warnings_are_printed_where_the_run_was_started(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "campaign.toml").write_text(HAMMER + SWEEPS_LOBES)
    hit_table().to_csv(tmp_path / "hit.csv", index=False)
    asked = ("run", tmp_path / "campaign.toml", "--out", tmp_path / "results")
    assert command(monkeypatch, *asked) == 0
    said = capsys.readouterr()
    assert "partial matrix" in next(line for line in said.out.splitlines() if " warning" in line)
    assert "warning, " not in said.err
    assert command(monkeypatch, *asked, "-v") == 0
    assert "warning, lobes_1, hammer: the compliance is a partial matrix" in capsys.readouterr().err


SWEEPS_LOBES = """
[[lobes]]
measurements = ["hammer"]
method = "zero_order"
cut = "down"
width_of_cut = "20 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["600 rpm", "1500 rpm", "10 rpm"]
"""


def test_a_wrong_speed_is_found_by_the_speed_in_the_record(
    demo: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    record = demo / "records" / "cut_950rpm_5mm.csv"
    assert command(monkeypatch, "chatter", record, "--speed", "900 rpm", "--teeth", 2) == 1
    assert "950" in capsys.readouterr().err


def test_dependent_sweeps_are_refused_before_any_record_is_read(
    demo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (demo / "campaign.toml").read_text().replace('"records/', f'"{demo}/records/')
    first, start = text.index("[[measurement]]"), text.index('[[measurement]]\nname = "sweep"')
    text = text[:first] + text[start : text.index("[[measurement]]", start + 1)]
    for cut, width in (("down", 40), ("up", 40), ("central", 80)):
        text = text.replace(f'cut = "{cut}", width_of_cut = "12 mm"', f'cut = "{cut}", width_of_cut = "{width} mm"')
    (tmp_path / "campaign.toml").write_text(text)
    assert command(monkeypatch, "run", tmp_path / "campaign.toml", "--out", tmp_path / "results") == 3
    said = capsys.readouterr().err
    assert "add up to the slot" in said
    assert "identifying" not in said


@pytest.mark.parametrize("asked", [("run", "--out"), ("diagnose", "-o")])
def test_a_target_that_cannot_be_written_is_refused_before_the_work(
    asked: tuple[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file where a folder is needed, a folder where a file is: said at once, with what to do, and left as it was."""
    records = "records = [{ file = 'moved.csv' }]\n"
    (tmp_path / "moved.csv").write_text("t,x,f\n" + "".join(f"{0.001 * k},0,0\n" for k in range(50)))
    (tmp_path / "campaign.toml").write_text(
        "[campaign]\nname = 'axis'\n[channels]\ntime = { column = 't', unit = 's' }\n"
        "encoder_position_x = { column = 'x', unit = 'mm' }\ndrive_force_x = { column = 'f', unit = 'N' }\n"
        f"[[measurement]]\nname = 'moved'\nmethod = 'drive'\n{records}[baseline]\ndrive = 'rigid'\naxis = 'x'\n",
        encoding="utf-8",
    )
    (tmp_path / "taken").write_text("mine")
    verb, option = asked
    target = tmp_path / "taken" if verb == "run" else tmp_path / "taken" / "finding.json"
    assert command(monkeypatch, verb, tmp_path / "campaign.toml", option, target) == 1
    assert "is a file, so that" in capsys.readouterr().err
    assert (tmp_path / "taken").read_text() == "mine"
    if verb == "diagnose":
        assert command(monkeypatch, verb, tmp_path / "campaign.toml", option, tmp_path) == 1
        assert "is a folder; name the file to write" in capsys.readouterr().err
