"""The five families of campaigns, and how one of them is drawn."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import numpy as np

from truth.imperfect import axis, cutting, drive, limits, modal
from truth.imperfect.bench import Answer

FAMILIES: dict[str, ModuleType] = {"modal": modal, "drive": drive, "cutting": cutting, "limits": limits, "axis": axis}


def hidden_of(family: str, seed: int, what: str) -> tuple[str, ...]:
    """Return the names of the effects that a word stands for."""
    module, rng = FAMILIES[family], np.random.default_rng([seed, 77])
    known = {**module.EFFECTS, **module.OUTSIDE}
    if what == "healthy":
        return ()
    if what in ("effect", "outside"):
        names = list(module.EFFECTS if what == "effect" else module.OUTSIDE)
        return (names[int(rng.integers(len(names)))],)
    if what == "pair":
        return tuple(module.PAIRS[int(rng.integers(len(module.PAIRS)))])
    names = what.split("+")
    for name in names:
        if name not in known:
            raise ValueError(f"{family} has no effect '{name}'; it has {', '.join(known)}")
    return tuple(names)


def draw(family: str, seed: int, what: str, folder: Path, scale: float = 1.0) -> Answer:
    """Write the campaign of a seed and return what is hidden in it."""
    return FAMILIES[family].campaign(folder, seed, hidden_of(family, seed, what), scale)
