"""Expensive results that several tests read: computed once, kept in ``.cache`` while what makes them stays."""

import fcntl
import functools
import hashlib
import importlib
import inspect
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

from places import CHECKOUT

PACKAGES = ("smfe", "stability", "process")
CACHE = CHECKOUT / ".cache" / "tests"
A_WEEK = 7 * 86400.0


@functools.cache
def sources() -> str:
    """Return the hash of all sources of the three packages: a change of any of them makes every result anew.

    The page's templates, styles and scripts are among them.
    """
    digest = hashlib.sha256()
    for package in PACKAGES:
        root = Path(importlib.import_module(package).__path__[0])
        for path in sorted(p for p in root.rglob("*") if p.suffix in (".py", ".j2", ".js", ".css")):
            digest.update(f"{path.relative_to(root)}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def kept(make: Callable[..., object], *arguments: object) -> Path:
    """Return the folder that ``make(folder, *arguments)`` has filled, in this run of the tests or an earlier one.

    Workers that ask for the same folder wait for the one that makes it. What is in it must not be changed: copy it.
    The representation of each argument must say all about it.
    """
    own = hashlib.sha256(Path(inspect.getfile(make)).read_bytes()).hexdigest()
    key = repr((make.__module__, make.__qualname__, own, arguments, sources()))
    folder = CACHE / f"{make.__name__}-{hashlib.sha256(key.encode()).hexdigest()[:16]}"
    CACHE.mkdir(parents=True, exist_ok=True)
    with (CACHE / f"{folder.name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            _forget_old(make.__name__)
            part = folder.with_suffix(".part")
            shutil.rmtree(part, ignore_errors=True)
            part.mkdir()
            make(part, *arguments)
            part.rename(folder)
        os.utime(folder)
    return folder


def _forget_old(name: str) -> None:
    for path in CACHE.glob(f"{name}-*"):
        if path.stat().st_mtime < time.time() - A_WEEK:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
