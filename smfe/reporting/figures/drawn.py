"""Which pictures of a folder are drawn already: the same data, drawn by the same program, is not drawn again."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from smfe.kept import KEPT, Parts, key_of, state
from smfe.stored import digest


def draw_changed(folder: Path, name: str, draw: partial[Any], save: Callable[[], object]) -> None:
    """Save a picture of a folder of results, unless that is what was saved there before.

    Parameters
    ----------
    folder : Path
        Folder of results; pictures stand in its folder ``figures``.
    name : str
        Of the picture.
    draw : functools.partial
        What draws it, with its data.
    save : callable
        Draws and writes it.
    """
    path = folder / "figures" / name
    parts = Parts(folder / KEPT, "figures")
    key = key_of(name, digest([draw.func.__qualname__, draw.args, draw.keywords]))
    if (name, key) in parts and parts.get(name, key, list) == list(state(path)):
        return
    parts.forget(name)
    save()
    parts.get(name, key, lambda: list(state(path)))
