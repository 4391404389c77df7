"""Results of a run that become visible together: written aside, synchronised, then moved into place.

Moving several files is not one step of a file system. What is to be moved is therefore written down first: a run that
is killed between two moves leaves a list, and whoever opens the folder next carries it out. Until the list is complete
nothing in the folder has changed, so that a full disk costs the new results and not the old ones.
"""

from __future__ import annotations

import datetime
import errno
import json
import os
import shutil
import socket
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from process.errors import InputError
from smfe.kept import KEPT, LOCK, WRITTEN, forget_record, inside, written

NEW = "new"
"""Folder, inside `KEPT`, of results that are not visible yet."""

MOVES = "moves.json"
"""File of `KEPT` that says what is moved into place, and what is taken away."""

STALE = 3600.0
"""Age [s] of a file that somebody began to write and left behind when the process was killed."""

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EFBIG)
"""Errors of a disk that takes nothing more: what could be computed cannot be kept, and no part is to blame."""


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold a folder of results against every other run while the block runs, and finish what a killed one left.

    Raises
    ------
    InputError
        When another process holds it.
    """
    kept = folder / KEPT
    kept.mkdir(parents=True, exist_ok=True)
    with (kept / LOCK).open("a+", encoding="utf-8") as stream:
        try:
            _lock(stream)
        except OSError:
            stream.seek(0)
            who = stream.read().strip() or "another process"
            raise InputError(
                f"'{folder}' is being written by {who}; wait until that has ended, or name another folder with --out"
            ) from None
        stream.truncate(0)
        now = datetime.datetime.now().astimezone().strftime("%Y-%m-%d %H:%M:%S")
        stream.write(f"process {os.getpid()} on {socket.gethostname()}, since {now}\n")
        stream.flush()
        finish(folder)
        for left in (*folder.glob(".*.part"), *kept.glob(".*.part")):
            with suppress(OSError):
                if left.stat().st_mtime < time.time() - STALE:
                    left.unlink()
        yield


def _lock(stream: IO[str]) -> None:
    try:
        import fcntl
    except ImportError:  # Windows locks bytes, here one beyond the text that others read
        import msvcrt

        stream.seek(1 << 20)
        msvcrt.locking(stream.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        return
    fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def together(folder: Path, earlier: Iterable[str]) -> Iterator[Path]:
    """Give a folder to write results into; at the end they all become visible in `folder`, after an error none.

    Pictures of an earlier run stand there already, so that what has not changed is not drawn again.

    Parameters
    ----------
    folder : Path
        Folder of the results, `held`.
    earlier : iterable of str
        Files below `folder` that are taken away where they are not written anew, beside what the last run wrote.

    Raises
    ------
    InputError
        When a link in the folder leads a result out of it; nothing is moved then.
    """
    stage = folder / KEPT / NEW
    shutil.rmtree(stage, ignore_errors=True)
    stage.mkdir(parents=True)
    try:
        drawn = [p for p in (folder / "figures").glob("*.png") if p.is_file()]
        for path in (*drawn, *(folder / KEPT).glob("figures-*.json")):
            _link(path, stage / path.relative_to(folder))
        yield stage
        made = sorted(p.relative_to(stage).as_posix() for p in stage.rglob("*") if p.is_file())
        for name in made:
            if not inside(folder, name):
                raise InputError(
                    f"'{folder / name}' leads out of the folder of results through a link; put a folder in its place"
                )
            _synchronise(stage / name)
        before = {*earlier, *written(folder), *(p.relative_to(folder).as_posix() for p in drawn)}
        _write_moves(folder, {"move": made, "remove": sorted(n for n in before - set(made) if inside(folder, n))})
    except BaseException:
        shutil.rmtree(stage, ignore_errors=True)
        raise
    finish(folder)


def finish(folder: Path) -> None:
    """Carry out what `MOVES` says, if anything; what has been moved before the process was killed stays moved."""
    journal = folder / KEPT / MOVES
    try:
        moves = json.loads(journal.read_text(encoding="utf-8"))
        made, gone = list(map(str, moves["move"])), list(map(str, moves["remove"]))
    except FileNotFoundError:
        return
    except (ValueError, KeyError, TypeError):  # never complete: nothing was moved
        journal.unlink()
        return
    stage = folder / KEPT / NEW
    # A folder may come from somebody else: what it asks to move or to delete stays inside it, or nothing is done.
    if stage.is_symlink() or not all(inside(folder, name) and inside(stage, name) for name in (*made, *gone)):
        journal.unlink()
        return
    forget_record(folder)
    for name in made:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileNotFoundError):
            os.replace(stage / name, folder / name)
    for name in gone:
        (folder / name).unlink(missing_ok=True)
    for place in {folder, *((folder / name).parent for name in made)}:
        _synchronise(place)
    os.replace(journal, folder / KEPT / WRITTEN)
    shutil.rmtree(stage, ignore_errors=True)


def _write_moves(folder: Path, moves: dict[str, list[str]]) -> None:
    journal = folder / KEPT / MOVES
    aside = journal.with_name(f".{journal.name}.part")
    aside.write_text(json.dumps(moves), encoding="utf-8")
    _synchronise(aside)
    os.replace(aside, journal)
    _synchronise(journal.parent)


def _link(source: Path, target: Path) -> None:
    """Give a file a second name, or copy it where the file system has no such thing; nothing where there is none."""
    if not source.is_file():
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def _synchronise(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk; not every system knows it for folders."""
    try:
        number = os.open(path, os.O_RDONLY)
    except OSError:
        if path.is_dir():
            return
        raise
    try:
        os.fsync(number)
    except OSError as error:
        if error.errno in FULL:
            raise
    finally:
        os.close(number)
