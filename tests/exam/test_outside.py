"""The outside exams: where records are read from, what is said without them, how the page keeps what was sat."""

import subprocess

import pytest

from exam.outside import table
from exam.outside.places import AbsentError, Source


def test_records_are_read_from_a_folder_and_out_of_a_bare_repository(tmp_path, monkeypatch) -> None:
    source, folder, bare = Source("who/what", "SMFE_WHAT", "MIT"), tmp_path / "folder", tmp_path / "bare"
    folder.mkdir()
    (folder / "a.csv").write_bytes(b"1,2")
    git = ["git", "-C", str(folder), "-c", "user.name=a", "-c", "user.email=a@b"]
    for command in (["init", "-q"], ["add", "a.csv"], ["commit", "-qm", "a"]):
        subprocess.run([*git, *command], check=True)
    subprocess.run(["git", "clone", "-q", "--bare", str(folder), str(bare)], check=True)
    for place in (folder, bare):
        monkeypatch.setenv("SMFE_WHAT", str(place))
        assert source.read("a.csv").read() == b"1,2"
    with pytest.raises(AbsentError, match="SMFE_WHAT"):
        source.read("b.csv")


def test_an_exam_that_cannot_be_sat_keeps_what_the_page_said(monkeypatch, capsys) -> None:
    def absent():
        raise AbsentError("not here")

    monkeypatch.setattr(table, "EXAMS", {"One": absent, "Two": lambda: ([("item", "1", "2", False)], "said")})
    page = table.page("### One\n\nas before\n\n### Two\n\nold\n", ("One", "Two"))
    assert "as before" in page
    assert "| item | 1 | 2 | no |" in page
    assert "old" not in page
    assert "not sat: not here" in capsys.readouterr().out
