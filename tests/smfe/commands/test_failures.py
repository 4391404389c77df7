"""Nothing is lost because one thing fails: every part alone, and every output says what is missing in it."""

import io
import json
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from kept import kept
from samples.campaigns import HAMMER

import smfe
from process.errors import InputError
from smfe import cli
from smfe import results as failures
from smfe.commands.check import check
from smfe.results import Failure, attempt, of_file, read_groups, unpack

MODEL = """
[[model]]
name = "m"
modes = [ { frequency = "50 Hz", damping = 0.03, stiffness = "20 N/um", direction = [0.6, 0.7, 0.4] } ]
"""

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


def hits() -> pd.DataFrame:
    """Three hits on a mode of 50 Hz, 3 % damping, 50 N/um."""
    t = np.arange(12000) / 2000.0
    force = np.zeros(t.size)
    for start in (0.1, 2.1, 4.1):
        u = t - start
        force += np.where((u > 0) & (u < 4e-3), 1000 * np.sin(np.pi * np.clip(u, 0, 4e-3) / 4e-3), 0.0)
    r = np.fft.rfftfreq(2 * t.size, 1 / 2000.0) / 50.0
    accelerance = -((2 * np.pi * 50.0 * r) ** 2) / (5e7 * (1.0 - r**2 + 2j * 0.03 * r))
    motion = np.fft.irfft(accelerance * np.fft.rfft(force, 2 * t.size))[: t.size]
    noise = np.random.default_rng(1).standard_normal((2, t.size))
    return pd.DataFrame({"t": t, "Fx": force + 0.1 * noise[0], "ax": motion + 1e-3 * noise[1]})


def cut() -> pd.DataFrame:
    """A stable cut with 2 teeth at 1500 rpm."""
    t = np.arange(16000) / 2000.0
    motion = 10 * np.cos(2 * np.pi * 50.0 * t) + 0.02 * np.random.default_rng(2).standard_normal(t.size)
    return pd.DataFrame({"t": t, "Fx": 10 * motion, "ax": motion})


def command(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    """Run the command line in this process and return its exit code."""
    monkeypatch.setattr(sys, "argv", ["smfe", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        cli.app_entry()
    return int(stop.value.code or 0)


SECOND = """
[[measurement]]
name = "broken"
method = "hammer"
records = [ { file = "broken.csv", excitation = "x" } ]
"""

LOBES = """
[[lobes]]
measurements = ["hammer", "broken", "m"]
method = "{method}"
cut = "down"
width_of_cut = "40 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["900 rpm", "1000 rpm", "10 rpm"]
"""


def parts(folder: Path) -> None:
    """Run a campaign of which a measurement, a request, a prediction and a cutting test fail, and one without them.

    The first is run from the command line, into ``results`` with what was printed; the other into ``alone``.
    """
    broken = hits()
    broken.loc[77, "ax"] = np.nan
    for name, table in {"hit": hits(), "broken": broken, "cut": cut(), "other": cut()}.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    # The hammer gives 1 x 1 of the compliance from 0 to 1000 Hz: enough for zero order, not for an operating point.
    requests = LOBES.format(method="zero_order") + LOBES.format(method="operating_point").replace(', "broken"', "")
    tests = CUTTING_TEST.replace("cut.csv", "other.csv") + WRONG_COLUMN + CUTTING_TEST
    text = HAMMER + SECOND + MODEL + requests + tests
    (folder / "campaign.toml").write_text(text)
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as monkeypatch, redirect_stdout(out), redirect_stderr(err):
        code = command(monkeypatch, "run", folder / "campaign.toml", "--out", folder / "results", "--json")
    (folder / "printed.json").write_text(json.dumps([code, out.getvalue(), err.getvalue()]))
    healthy = text.replace(SECOND, "").replace(', "broken"', "")
    (folder / "healthy.toml").write_text(healthy[: healthy.rindex("[[lobes]]")] + CUTTING_TEST)
    smfe.run(folder / "healthy.toml", folder / "alone")


@pytest.fixture(scope="session")
def folder() -> Path:
    return kept(parts)


@pytest.fixture(scope="session")
def results(folder: Path) -> Path:
    return folder / "results"


def test_what_does_not_fail_is_as_it_would_have_been(folder: Path, results: Path) -> None:
    alone = folder / "alone"
    assert set(read_groups(results / "frf.nc")) == {"hammer", "m"}
    assert read_groups(results / "frf.nc")["hammer"].identical(read_groups(alone / "frf.nc")["hammer"])
    for source in ("hammer", "m"):
        one, two = (read_groups(f / "lobes.nc")[f"lobes_1/{source}"]["limit_depth"] for f in (results, alone))
        np.testing.assert_array_equal(one, two)
    rows = [pd.read_csv(f / "chatter.csv").iloc[-1] for f in (results, alone)]
    for column in ("file", "verdict", "ratio", "predicted_hammer", "limit_m_mm"):
        assert rows[0][column] == rows[1][column]


def test_every_output_says_in_its_place_what_failed(results: Path) -> None:
    held = json.loads((results / "provenance.json").read_text())["failures"]
    parts = {(f["part"], f["name"]) for f in held}
    assert parts == {
        ("measurement", "broken"),
        ("lobes", "lobes_1, broken"),
        ("lobes", "lobes_2, hammer + m"),
        ("prediction", "hammer + m for 2 cutting tests"),
        ("cutting test", "other.csv"),
    }
    assert of_file(results / "frf.nc") == [f for f in unpack({"failures": held}) if f.part == "measurement"]
    assert {f.name for f in of_file(results / "lobes.nc")} == {"lobes_1, broken", "lobes_2, hammer + m"}
    chatter = pd.read_csv(results / "chatter.csv", keep_default_na=False).set_index("file")
    assert chatter.loc["other.csv", "verdict"] == "failed"
    assert "no column 'az'" in chatter.loc["other.csv", "reason"]
    assert chatter.loc["cut.csv", "verdict"] == "stable"
    assert set(chatter["predicted_broken"]) == set(chatter["predicted_hammer + m"]) == {"failed"}
    assert set(chatter["predicted_m"]) <= {"stable", "chatter"}
    page = (results / "report.html").read_text()
    assert "5 parts of what was asked for failed" in page
    for name in ("lobes lobes_1, broken", "cutting test other.csv"):
        assert f"<strong>{name} failed</strong>" in page
    assert "broken was left out: broken.csv: channel acceleration_x" in page


def test_exit_code_3_and_what_failed_in_the_terminal(folder: Path) -> None:
    code, out, err = json.loads((folder / "printed.json").read_text())
    assert code == 3, err
    assert {f["name"] for f in json.loads(out)["failures"]} >= {"broken", "other.csv"}
    assert "failed, cutting test other.csv: " in err


def test_exit_code_3_of_the_single_commands(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    frf, lobes = tmp_path / "single.nc", tmp_path / "lobes.nc"
    assert command(monkeypatch, "identify", folder / "campaign.toml", "-o", frf) == 3
    assert [f.name for f in of_file(frf)] == ["broken"]
    assert command(monkeypatch, "lobes", folder / "campaign.toml", "-o", lobes, "--table", tmp_path / "t.csv") == 3
    assert set(read_groups(lobes)) == {"lobes_1/hammer", "lobes_1/m"}
    assert "failed, lobes lobes_2, hammer + m: " in capsys.readouterr().err


def test_a_command_of_which_nothing_is_left_writes_nothing(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken.csv").write_bytes((folder / "broken.csv").read_bytes())
    (tmp_path / "nothing.toml").write_text(HAMMER.replace("hit.csv", "broken.csv"))
    assert command(monkeypatch, "identify", tmp_path / "nothing.toml", "-o", tmp_path / "nothing.nc") == 1
    assert not (tmp_path / "nothing.nc").exists()
    assert command(monkeypatch, "run", tmp_path / "nothing.toml", "--out", tmp_path / "nothing") == 3
    assert "hammer was left out" in (tmp_path / "nothing" / "report.html").read_text()


def test_a_mistake_of_ours_costs_its_part_and_an_interruption_everything() -> None:
    caught: list[Failure] = []
    with attempt(caught, "lobes", "a"):
        raise InputError("give more")
    with attempt(caught, "lobes", "b"):
        np.zeros(2)[5]
    assert [f.name for f in caught] == ["a", "b"]
    assert caught[0].reason == "give more"
    assert "a mistake in smfe (IndexError in test_failures.py, line" in caught[1].reason
    with pytest.raises(KeyboardInterrupt), attempt(caught, "lobes", "c"):
        raise KeyboardInterrupt
    with pytest.raises(InputError), attempt(None, "lobes", "c"):
        raise InputError("no collector")
    assert failures.unpack({}) == []


@pytest.mark.slow
def test_a_cut_under_another_controller_is_not_compared_and_every_output_says_so(folder: Path, tmp_path: Path) -> None:
    for name in ("hit.csv", "cut.csv"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    text = HAMMER + 'controller = "K1"\n' + LOBES.format(method="zero_order").replace(', "broken", "m"', "")
    (tmp_path / "campaign.toml").write_text(text + CUTTING_TEST + 'controller = "K2"\n')
    out = smfe.run(tmp_path / "campaign.toml", tmp_path / "results").parent
    (row,) = pd.read_csv(out / "chatter.csv", keep_default_na=False).to_dict("records")
    assert (row["verdict"], row["predicted_hammer"], row["limit_hammer_mm"]) == ("stable", "not compared", "")
    assert row["not_compared"] == "hammer: controller K1, the cut K2"
    assert (row["controller"], row["lobes"]) == ("K2", "")
    provenance = json.loads((out / "provenance.json").read_text())
    assert provenance["failures"] == []
    said = "cut.csv: no source of lobes belongs to it, so nothing is predicted (hammer: controller K1, the cut K2)"
    assert said in provenance["warnings"]
    assert "not compared" in (out / "report.html").read_text()
    table = check(tmp_path / "campaign.toml")
    assert table.loc[table["cause"] == "conditions", "evidence"].tolist() == [said]
    assert read_groups(out / "lobes.nc")["lobes_1/hammer"].attrs["controller"] == "K1"
