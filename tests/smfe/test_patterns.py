"""Claims about patterns of files: ``**`` stays where it was let in; what is written out leads where it says."""

from pathlib import Path

import pytest

from process.errors import InputError
from smfe.identification.measurement import _forget
from smfe.patterns import matches


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A campaign's folder with records, beside one of somebody else, to which links lead."""
    for name in ("campaign/a.csv", "campaign/deep/er/b.csv", "campaign/.kept/c.csv", "other/secret.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1\n")
    (tmp_path / "campaign" / "link").symlink_to(tmp_path / "other")
    (tmp_path / "campaign" / "deep" / "linked.csv").symlink_to(tmp_path / "other" / "secret.csv")
    (tmp_path / "campaign" / "deep" / "round").symlink_to(tmp_path / "campaign")
    return tmp_path / "campaign"


def names(folder: Path, pattern: str) -> list[str]:
    return [str(path.relative_to(folder)) for path in matches(folder, pattern) if path.is_file()]


@pytest.mark.parametrize("pattern", ["**/*.csv", "**", "**/**/*.csv", "./**/*.csv", "**/*/../*.csv"])
def test_two_asterisks_stay_inside_the_folder(folder: Path, pattern: str) -> None:
    if ".." in pattern:
        with pytest.raises(InputError, match=r"'\.\.' behind '\*\*' leads out of the folder"):
            matches(folder, pattern)
        return
    assert names(folder, pattern) == ["a.csv", "deep/er/b.csv"]


def test_before_them_links_and_folders_may_be_named_which_they_do_not_leave(folder: Path) -> None:
    assert names(folder, "deep/**/*.csv") == ["deep/er/b.csv"]
    assert names(folder, "d*p/**/*.csv") == ["deep/er/b.csv"]
    assert names(folder, "link/**/*.csv") == []  # the folder that it leads to is not the campaign's
    other = folder.parent / "other"
    assert matches(folder, f"{other}/**/*.csv") == [other / "secret.csv"]
    assert [path.name for path in matches(folder, "../other/**/*.csv")] == ["secret.csv"]


def test_what_is_written_out_leads_where_it_says(folder: Path) -> None:
    assert names(folder, "link/*.csv") == ["link/secret.csv"]
    assert [path.name for path in matches(folder, "../other/s*.csv")] == ["secret.csv"]
    assert names(folder, ".kept/*.csv") == [".kept/c.csv"]


def test_a_measurement_named_like_a_pattern_takes_nothing_of_the_others(tmp_path: Path) -> None:
    """What was kept of "hit" stays where that of "*" or of "h[i]t" is forgotten."""
    kept = {name: tmp_path / f"{name}-{'0123456789abcdef'}.nc" for name in ("hit", "*", "h[i]t", "???")}
    for name in ("*", "h[i]t", "???"):
        for path in kept.values():
            path.write_bytes(b"")
        _forget(tmp_path, name)
        assert sorted(tmp_path.iterdir()) == sorted(path for other, path in kept.items() if other != name)
