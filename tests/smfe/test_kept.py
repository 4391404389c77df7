"""What a folder of results keeps: nothing is done again where nothing has changed, and everything where it has."""

import json
import os
from pathlib import Path

import pytest

from smfe import kept
from smfe.kept import KEPT, Parts, file_hash, inputs_of, is_unchanged, key_of, read_hashes, write_record
from smfe.progress import SmfeWarning
from smfe.staged import together

CAMPAIGN = '[[measurement]]\nrecords = [ { file = "hit_*.csv" }, { file = "cut.csv" } ]\n'


@pytest.fixture
def run(tmp_path: Path) -> tuple[Path, Path]:
    """A campaign file with its records, and a folder of results as a run leaves it."""
    campaign, folder = tmp_path / "campaign.toml", tmp_path / "results"
    campaign.write_text(CAMPAIGN)
    for name in ("hit_1.csv", "hit_2.csv", "cut.csv"):
        (tmp_path / name).write_text(f"record {name}")
    with together(folder, ()) as new:
        (new / "figures").mkdir(parents=True)
        (new / "report.html").write_text("page")
        (new / "figures" / "lobes_1.png").write_text("picture")
    write_record(folder, inputs_of(campaign, [tmp_path / n for n in ("hit_1.csv", "hit_2.csv", "cut.csv")]))
    return campaign, folder


def test_results_of_a_campaign_as_it_was_are_unchanged(run: tuple[Path, Path]) -> None:
    assert is_unchanged(*run)


CHANGES = {
    "campaign file": lambda c, f: c.write_text(CAMPAIGN + "# more\n"),
    "record": lambda c, f: c.with_name("cut.csv").write_text("other record"),
    "record gone": lambda c, f: c.with_name("cut.csv").unlink(),
    "another record that the pattern finds": lambda c, f: c.with_name("hit_3.csv").write_text("new"),
    "report": lambda c, f: (f / "report.html").write_text("edited"),
    "figure gone": lambda c, f: (f / "figures" / "lobes_1.png").unlink(),
    "record of the run damaged": lambda c, f: (f / KEPT / "run.json").write_text("{"),
    "record of the run emptied": lambda c, f: (f / KEPT / "run.json").write_text(
        json.dumps({"code": kept.code(), "campaign": str(c.absolute()), "files": [1]})
    ),
}


@pytest.mark.parametrize("damage", ['{"a": 1}', '{"a": [1, 2]}', '{"a": ["x", 2, 3]}', "[]", "{"])
def test_damaged_hashes_are_as_good_as_none(damage: str, run: tuple[Path, Path]) -> None:
    campaign, folder = run
    (folder / KEPT / "hashes.json").write_text(damage)
    read_hashes(folder / KEPT)
    assert is_unchanged(campaign, folder)


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_of_anything_that_counts_is_seen(change: str, run: tuple[Path, Path]) -> None:
    CHANGES[change](*run)
    assert not is_unchanged(*run)


def test_another_version_of_the_program_counts(run: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "code", lambda: "other")
    assert not is_unchanged(*run)


@pytest.mark.parametrize(("file", "same"), [("cut.csv", True), ("dataset:emps/cut.csv", False)])
def test_where_data_sets_lie_counts_where_one_is_named(
    file: str, same: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SMFE_DATA", "here")
    campaign, folder = tmp_path / "campaign.toml", tmp_path / "results"
    campaign.write_text(f'[[measurement]]\nrecords = [ {{ file = "{file}" }} ]\n')
    write_record(folder, inputs_of(campaign, []))
    assert is_unchanged(campaign, folder)
    monkeypatch.setenv("SMFE_DATA", "there")
    assert is_unchanged(campaign, folder) == same


def test_another_campaign_file_is_another_campaign(run: tuple[Path, Path]) -> None:
    other = run[0].with_name("other.toml")
    other.write_text(CAMPAIGN)
    assert not is_unchanged(other, run[1])
    assert kept.campaign_of(run[1]) == run[0]
    assert kept.campaign_of(run[1] / "figures") is None


def test_a_file_that_was_only_touched_is_read_once_and_is_the_same(run: tuple[Path, Path]) -> None:
    os.utime(run[0].with_name("cut.csv"), ns=(1, 1))
    os.utime(run[0], ns=(2, 2))
    assert is_unchanged(*run)


def test_a_record_is_read_for_its_hash_only_where_size_or_time_differ(
    run: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    record = run[0].with_name("cut.csv")
    known = file_hash(record)
    monkeypatch.setattr(kept, "_known", {})
    read_hashes(run[1] / KEPT)
    monkeypatch.setattr(Path, "open", lambda *_: pytest.fail("read again"))
    assert file_hash(record) == known


def test_a_part_that_was_changed_behind_our_back_is_made_again(tmp_path: Path) -> None:
    """One digit of a number in a file of JSON: no reader of JSON can tell, the checksum can."""
    assert Parts(tmp_path, "check").get("hammer", "a", lambda: [12.5]) == [12.5]
    (path,) = tmp_path.glob("check-*.json")
    path.write_text(path.read_text().replace("12.5", "13.5"))
    with pytest.warns(SmfeWarning, match=r"\.json' is not as it was written \(its checksum is wrong\)"):
        assert Parts(tmp_path, "check").get("hammer", "a", lambda: [12.5]) == [12.5]


def test_a_part_is_made_again_when_its_key_is_another(tmp_path: Path) -> None:
    made: list[int] = []

    def make() -> list[int]:
        made.append(len(made))
        return list(made)

    def ask(*keys: str) -> list[object]:
        parts = Parts(tmp_path, "check")
        found = [parts.get("hammer", key, make) for key in keys]
        parts.forget_others()
        return found

    assert ask("a", "a", "b", "b") == [[0], [0], [0, 1], [0, 1]]
    assert ask("b") == [[0, 1]]
    assert ask() == []
    assert not list(tmp_path.iterdir())
    assert Parts(None, "check").get("hammer", "b", make) == [0, 1, 2]
    assert key_of(1, "a") == key_of(1, "a") != key_of(1, "b")
