"""Results of a run become visible together, whoever kills it and however full the disk is."""

from __future__ import annotations

import errno
import json
import os
import resource
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from process import _kernel_cache
from process.errors import InputError
from smfe import staged
from smfe.kept import KEPT, WRITTEN, aside, written
from smfe.results import attempt, read_groups, write_groups
from smfe.staged import finish, held, together


def results(folder: Path) -> dict[str, str]:
    return {
        p.relative_to(folder).as_posix(): p.read_text() for p in folder.rglob("*") if p.is_file() and KEPT not in str(p)
    }


def write(folder: Path, **texts: str) -> None:
    with held(folder), together(folder, ()) as new:
        for name, text in texts.items():
            (new / f"{name}.csv").write_text(text)
        (new / "tables").mkdir()
        (new / "tables" / f"{len(texts)}.csv").write_text("table")


OLD = {"a.csv": "old", "b.csv": "old", "tables/2.csv": "table"}
NEW = {"a.csv": "new", "c.csv": "new", "d.csv": "new", "tables/3.csv": "table"}


def test_what_is_not_written_again_goes_and_what_is_the_users_stays(tmp_path: Path) -> None:
    (tmp_path / "record.csv").write_text("mine")
    write(tmp_path, a="old", b="old")
    assert results(tmp_path) == OLD | {"record.csv": "mine"}
    write(tmp_path, a="new", c="new", d="new")
    assert results(tmp_path) == NEW | {"record.csv": "mine"}
    assert "record.csv" not in written(tmp_path)


def test_an_error_before_the_end_leaves_everything_as_it_was(tmp_path: Path) -> None:
    write(tmp_path, a="old", b="old")
    with suppress(KeyboardInterrupt), held(tmp_path), together(tmp_path, ()) as new:
        (new / "a.csv").write_text("new")
        raise KeyboardInterrupt
    assert results(tmp_path) == OLD
    assert not (tmp_path / KEPT / staged.NEW).exists()


@pytest.mark.parametrize("moves", range(6))
def test_a_run_killed_between_two_moves_is_finished_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moves: int
) -> None:
    write(tmp_path, a="old", b="old")
    left, replace = [moves], os.replace

    def killed(source: str, target: str) -> None:
        if left[0] == 0:
            raise SystemExit(9)
        left[0] -= 1
        replace(source, target)

    # What a killed process would have done after that does not happen.
    monkeypatch.setattr(os, "replace", killed)
    monkeypatch.setattr("shutil.rmtree", lambda *_, **__: None)
    with pytest.raises(SystemExit):
        write(tmp_path, a="new", c="new", d="new")
    monkeypatch.undo()
    with held(tmp_path):
        pass
    # The first move is that of the list itself: before it nothing has happened, after it everything will.
    assert results(tmp_path) == (NEW if moves else OLD)


def test_a_second_run_into_the_same_folder_is_told_who_writes_there(tmp_path: Path) -> None:
    who = rf"is being written by process {os.getpid()} on .*, since 2"
    with held(tmp_path), pytest.raises(InputError, match=who), held(tmp_path):
        pass
    with held(tmp_path):  # free again
        pass


def test_the_folder_of_a_killed_run_is_free_and_its_unfinished_files_go(tmp_path: Path) -> None:
    code = f"""if True:
        import os, signal, pathlib
        from smfe.staged import held
        with held(pathlib.Path({str(tmp_path)!r})):
            pathlib.Path({str(tmp_path / ".frf.nc.1.part")!r}).write_text("half")
            os.kill(os.getpid(), signal.SIGKILL)"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    os.utime(tmp_path / ".frf.nc.1.part", (0, time.time() - 2 * staged.STALE))
    with held(tmp_path):
        assert [p.name for p in tmp_path.iterdir()] == [KEPT]


def test_a_list_of_moves_that_was_never_complete_moves_nothing(tmp_path: Path) -> None:
    write(tmp_path, a="old", b="old")
    (tmp_path / KEPT / staged.MOVES).write_text('{"move": ["a.csv", ')
    finish(tmp_path)
    assert results(tmp_path) == OLD


@pytest.mark.parametrize("name", ["../mine.csv", "ABSOLUTE", "link/mine.csv", ""])
def test_a_folder_from_somebody_else_moves_and_deletes_nothing_outside_of_it(tmp_path: Path, name: str) -> None:
    folder, mine = tmp_path / "results", tmp_path / "mine.csv"
    write(folder, a="old", b="old")
    mine.write_text("mine")
    (folder / "link").symlink_to(tmp_path)
    named = str(mine) if name == "ABSOLUTE" else name
    for moves in ({"move": [], "remove": [named]}, {"move": [named], "remove": []}):
        (folder / KEPT / staged.NEW).mkdir(exist_ok=True)
        (folder / KEPT / staged.NEW / "mine.csv").write_text("theirs")
        (folder / KEPT / staged.MOVES).write_text(json.dumps(moves))
        finish(folder)
        (folder / KEPT / WRITTEN).write_text(json.dumps(moves))
        write(folder, a="new")
        assert mine.read_text() == "mine"


def write_too_much(folder: Path) -> None:
    with held(folder), together(folder, ()) as new, attempt([], "lobes"), aside(new / "big.csv") as path:
        path.write_bytes(bytes(20_000))


def test_a_full_disk_ends_the_run_with_the_file_that_did_not_fit(tmp_path: Path) -> None:
    write(tmp_path, a="old", b="old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(OSError, match=r"File too large.*big\.csv"):
            write_too_much(tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert results(tmp_path) == OLD
    assert errno.ENOSPC in staged.FULL


def test_a_full_disk_ends_a_file_of_arrays_with_an_error_and_not_the_process(tmp_path: Path) -> None:
    """The HDF5 library crashes where it cannot close a file: it must not hear of the disk."""
    groups = {f"g{i}": xr.Dataset({"a": ("n", np.arange(1000.0) + i)}) for i in range(5)}
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, limits[1]))
    try:
        with pytest.raises(OSError, match="File too large"):
            write_groups(tmp_path / "a.nc", groups)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []
    again = read_groups(write_groups(tmp_path / "a.nc", groups))
    assert list(again) == list(groups)
    for name, dataset in groups.items():
        xr.testing.assert_identical(again[name], dataset)


def test_a_dataset_read_back_is_written_as_the_same_bytes(tmp_path: Path) -> None:
    """Coordinates come last of a dataset that was computed, first of one that was read: an order says nothing."""
    computed = xr.Dataset({"depth": ("speed", np.arange(3.0))}, {"speed": [1.0, 2.0, 3.0]}, {"unit": "m"})
    computed = computed.assign_coords(quantile=0.05).assign(lobe=("speed", [1, 1, 2]))
    first = write_groups(tmp_path / "a.nc", {"lobes": computed})
    again = write_groups(tmp_path / "b.nc", read_groups(first))
    assert again.read_bytes() == first.read_bytes()
    assert read_groups(again)["lobes"].identical(computed)


def test_kernels_are_kept_in_a_folder_of_the_users_own_where_nothing_else_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(_kernel_cache, "__file__", "/proc/none/process/_kernel_cache.py")
    monkeypatch.setattr(_kernel_cache, "_user_cache", lambda: Path("/proc/none"))
    monkeypatch.delitem(sys.modules, "numba", raising=False)
    _kernel_cache.provide()
    own = Path(os.environ.pop("NUMBA_CACHE_DIR"))
    assert own.parent == tmp_path
    assert own.stat().st_mode & 0o777 == 0o700
    own.chmod(0o777)  # anybody may have put code there
    _kernel_cache.provide()
    assert Path(os.environ["NUMBA_CACHE_DIR"]) != own
