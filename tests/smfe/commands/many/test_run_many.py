"""Many campaigns: one folder each, one catalogue, the same whatever happened on the way."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet
from truth.archive import visits, write_archive

import smfe
from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.commands.many.folders import find, is_one, name_of
from smfe.commands.many.run import Batch
from smfe.commands.many.tasks import Task, keep_share, work
from smfe.fleet.rows import rows_of
from smfe.fleet.table import read_catalogue, write_catalogue
from smfe.kept import KEPT

MACHINES = 2


def small_archive(folder: Path) -> None:
    """Two machines, measured twice each, and a campaign that is wrong; run by one process."""
    write_archive(folder / "in", 4, MACHINES, tests=1)
    wrong = folder / "in" / "wrong.toml"
    wrong.write_text('[campaign]\nname = "Wrong"\nspeed = 3\n', encoding="utf-8")
    batch = smfe.run([folder / "in"], folder / "out", jobs=1)
    (folder / "batch.json").write_text(json.dumps({"states": batch.states, "wrong": batch.wrong}), encoding="utf-8")


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("archive")  # results know the place of their campaign: they cannot be moved
    small_archive(folder)
    return folder


def rows(root: Path, kind: str) -> list[dict[str, object]]:
    table = parquet.read_table(root / "catalogue.parquet", filters=[("kind", "==", kind)])
    return table.to_pylist()


def test_names_are_unique_and_depend_on_the_file_alone(tmp_path: Path) -> None:
    one, other = "/data/mill_01/2024-01-15/campaign.toml", "/data/mill_02/2024-01-15/campaign.toml"
    assert name_of(one).startswith("mill_01-2024-01-15-")
    assert name_of(one) != name_of(other)
    assert name_of("/data/a b/K$1.toml").startswith("a_b-K_1-")
    assert len(name_of(f"/data/{'x' * 500}.toml")) < 80
    write_archive(tmp_path, 1, tests=0)
    before = [f.name for f in find([tmp_path])]
    write_archive(tmp_path, 2, tests=0)
    assert before[0] in [f.name for f in find([tmp_path])]


def test_folders_patterns_and_files_name_campaigns_once_each(tmp_path: Path) -> None:
    files = write_archive(tmp_path / "in", 2, tests=0)
    (tmp_path / "in" / "note.toml").write_text('title = "no campaign"\n')
    (tmp_path / "in" / "broken.toml").write_text("[campaign]\nname = \n")  # its error is told, not passed over
    results = tmp_path / "in" / "results"
    (results / KEPT).mkdir(parents=True)
    (results / "provenance.json").write_text("{}")
    (results / "finding.toml").write_text('[campaign]\nname = "of a diagnosis"\n')
    found = find([tmp_path / "in", files[0], str(tmp_path / "in" / "**" / "campaign.toml")])
    assert sorted(f.address for f in found) == sorted([*map(str, files), str(tmp_path / "in" / "broken.toml")])
    assert {f.size for f in found} == {0, 1}
    assert is_one(files[0])
    assert not is_one(tmp_path)
    assert not is_one([files[0]])
    with pytest.raises(InputError, match="no campaign there"):
        find([tmp_path / "in" / "*.txt"])


def test_a_wrong_campaign_stops_none_of_the_others(archive: Path) -> None:
    said = json.loads((archive / "batch.json").read_text())
    assert sorted(said["states"].values()).count("refused") == 1
    assert said["wrong"]
    found = rows(archive / "out", "campaign")
    assert len(found) == 5
    (wrong,) = [row for row in found if row["verdict"] == "refused"]
    assert "speed: this key is not known" in str(wrong["text"])


def test_the_catalogue_holds_the_modes_of_every_machine(archive: Path) -> None:
    peaks = rows(archive / "out", "peak")
    for visit in visits(4, MACHINES):
        for axis, mode in visit.modes.items():
            own = [
                p
                for p in peaks
                if (p["machine"], p["date"], p["response"], p["excitation"]) == (visit.machine, visit.date, axis, axis)
            ]
            best = min(own, key=lambda p: abs(float(str(p["frequency_Hz"])) - mode.frequency))
            # A mode of 3 % seen through three hits of 1.5 s and 1e-3 m/s^2 of noise.
            assert best["frequency_Hz"] == pytest.approx(mode.frequency, rel=2e-3)
            assert best["damping"] == pytest.approx(mode.damping, rel=0.05)
            height = 1e6 / (2.0 * mode.stiffness * mode.damping * np.sqrt(1.0 - mode.damping**2))
            assert best["amplitude_um_per_N"] == pytest.approx(height, rel=0.03)


def test_limits_verdicts_and_hashes_stand_in_the_catalogue(archive: Path) -> None:
    limits, tests, inputs = (rows(archive / "out", kind) for kind in ("limit", "cutting_test", "input"))
    assert {r["at"] for r in limits} >= {"lowest", "highest"}
    lowest = {r["campaign"]: r["limit_depth_mm"] for r in limits if r["at"] == "lowest"}
    highest = {r["campaign"]: r["limit_depth_mm"] for r in limits if r["at"] == "highest"}
    assert all(lowest[c] < highest[c] for c in lowest)
    assert len(tests) == 4
    assert {r["file"] for r in inputs} == {"campaign.toml", "hammer_x.csv", "hammer_y.csv", "cut_1.csv"}
    assert {len(str(r["sha256"])) for r in inputs} == {64}


def test_a_second_run_does_nothing_and_gives_the_same_catalogue(archive: Path) -> None:
    before = (archive / "out" / "catalogue.parquet").read_bytes()
    (archive / "out" / "catalogue.parquet").unlink()
    batch = smfe.run([archive / "in"], archive / "out", jobs=1)
    assert batch.unchanged == 4
    assert (archive / "out" / "catalogue.parquet").read_bytes() == before


def test_kept_rows_that_are_damaged_are_made_again(archive: Path) -> None:
    """A bit of a number, one of the footer, and a file cut short: the catalogue is that of the results."""
    before = (archive / "out" / "catalogue.parquet").read_bytes()
    (folder, *_) = sorted(p.parent for p in (archive / "out").glob("*/provenance.json"))
    kept = folder / KEPT / "catalogue.parquet"
    good = kept.read_bytes()
    for place in (len(good) // 3, len(good) - 40, 0):
        bad = bytearray(good)
        bad[place] ^= 1
        kept.write_bytes(bytes(bad) if place else good[: len(good) // 2])
        write_catalogue(archive / "out")
        assert (archive / "out" / "catalogue.parquet").read_bytes() == before
        assert kept.read_bytes() == good


def test_results_that_are_damaged_are_doubted_and_end_no_catalogue(archive: Path, tmp_path: Path) -> None:
    shutil.copytree(archive / "out", tmp_path / "out")
    first, second, *_ = sorted(p.parent for p in (tmp_path / "out").glob("*/provenance.json"))
    said = (first / "provenance.json").read_text()
    (first / "provenance.json").write_text(said[: len(said) // 2])
    (second / KEPT / "refused.json").write_text('{"campaign": "na')
    write_catalogue(tmp_path / "out")
    rows = read_catalogue(tmp_path / "out").to_pandas().set_index("campaign")
    assert "cannot be read any more" in rows.loc[[first.name], "text"].iloc[0]
    assert "can no longer be read" in rows.loc[[second.name], "text"].iloc[0]
    assert set(rows["verdict"][rows["kind"] == "campaign"]) == {"done", "refused"}
    with pytest.raises(InputError, match=r"its results cannot be read any more \(JSONDecodeError"):
        rows_of(first)


def test_shares_keep_what_the_run_reads_back(tmp_path: Path) -> None:
    (file,) = write_archive(tmp_path / "in", 1, tests=2)
    campaign = load_campaign(file)
    for share in range(2):
        keep_share(campaign, tmp_path / "out" / KEPT, (share, 2))
    kinds = sorted(path.name.partition("-")[0] for path in (tmp_path / "out" / KEPT).iterdir())
    assert kinds == ["check"] * 3 + ["cut"] * 2 + ["hammer"]


def test_a_task_says_what_went_wrong_and_never_raises(tmp_path: Path) -> None:
    outcome = work(Task(str(tmp_path / "none.toml"), str(tmp_path / "out")))
    assert outcome.state == "refused"
    assert "cannot be read" in outcome.reasons[0]


def test_a_folder_of_one_campaign_takes_no_others(tmp_path: Path) -> None:
    files = write_archive(tmp_path / "in", 1, tests=0)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "provenance.json").write_text("{}")
    with pytest.raises(InputError, match="results of one campaign"):
        smfe.run([files[0]], tmp_path / "out")


@pytest.mark.slow
def test_killed_twice_and_resumed_the_catalogue_is_that_of_an_undisturbed_run(tmp_path: Path) -> None:
    write_archive(tmp_path / "in", 6, 2, tests=1)
    undisturbed: Batch = smfe.run([tmp_path / "in"], tmp_path / "one", jobs=1)
    command = [sys.executable, "-m", "smfe", "run", "in", "--out", "two", "--jobs", "2", "-v"]
    for enough in (1, 3):  # campaigns that are finished when it is killed
        with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL, start_new_session=True) as process:
            deadline = time.monotonic() + 300.0
            while finished(tmp_path / "two") < enough and time.monotonic() < deadline:
                time.sleep(0.02)
            os.killpg(process.pid, signal.SIGKILL)
        assert enough <= finished(tmp_path / "two") < 6
        assert not (tmp_path / "two" / "catalogue.parquet").exists()
    done = subprocess.run([*command, "--json"], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert json.loads(done.stdout)["unchanged"] >= 1  # two may have been killed before their rows were written
    assert (tmp_path / "two" / "catalogue.parquet").read_bytes() == undisturbed.catalogue.read_bytes()


def finished(root: Path) -> int:
    return len(list(root.glob(f"*/{KEPT}/run.json")))
