"""What is kept between tests is made once, and anew when an argument changes."""

from pathlib import Path

import kept
import pytest


def test_a_result_is_made_once_for_the_same_arguments_and_a_failed_one_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(kept, "CACHE", tmp_path / "cache")
    calls: list[int] = []

    def make(folder: Path, number: int) -> None:
        calls.append(number)
        (folder / "one").write_text("half")
        if number == 0:
            raise ValueError("failed")
        (folder / "number").write_text(str(number))

    assert (kept.kept(make, 1) / "number").read_text() == "1"
    assert (kept.kept(make, 1) / "number").read_text() == "1"
    assert (kept.kept(make, 2) / "number").read_text() == "2"
    for _ in range(2):
        with pytest.raises(ValueError, match="failed"):
            kept.kept(make, 0)
    assert calls == [1, 2, 0, 0]


def test_a_change_of_the_sources_makes_it_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kept, "CACHE", tmp_path / "cache")

    def make(folder: Path) -> None:
        (folder / "sources").write_text(kept.sources())

    first = kept.kept(make)
    monkeypatch.setattr(kept, "sources", lambda: "others")
    second = kept.kept(make)
    assert first != second
    assert (second / "sources").read_text() == "others"
