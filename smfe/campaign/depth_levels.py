"""Depths of cut as the force levels of a sweep: how they are called, and what each of them needs.

Works on the raw file, so that a level without its passes is found before any record is read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from process import units
from process.errors import InputError

Raw = Mapping[str, Any]
TooFew = Callable[[set[tuple[str, float | None]]], str]

SAME_DEPTH = 1e-7
"""Depths of cut that differ by less are one [m]."""


def level_name(name: str, depth: float) -> str:
    """Return what the passes of one depth of cut [m] of a measurement are called."""
    return f"{name}, {units.show(depth, 'mm', 'length')}"


def rounded(depth: float | None) -> float | None:
    """Return a depth of cut [m] as it counts as a level."""
    return None if depth is None else round(depth / SAME_DEPTH) * SAME_DEPTH


def depths_of(table: Raw, records: Sequence[Raw]) -> list[float | None]:
    """Return the depth of cut of each record of a measurement [m]; None where neither of them states one."""
    return [rounded(_length(record, "depth_of_cut") or _length(table, "depth_of_cut")) for record in records]


def depth_complaints(table: Raw, records: Sequence[Raw], needed: int, too_few: TooFew) -> Iterator[str]:
    """Yield what keeps the depths of cut of a sweep from being force levels.

    Parameters
    ----------
    table : mapping
        The measurement.
    records : sequence of mapping
        Its records.
    needed : int
        Passes that differ in cut or width which an estimate needs.
    too_few : callable
        Says of (cut, width) pairs what is missing.
    """
    wish, depths = table.get("split_levels"), depths_of(table, records)
    known = sorted({d for d in depths if d is not None})
    if wish is False:
        return
    if len(known) < 2:
        if wish is True:
            yield "split_levels = true tells depths of cut apart, and its records do not state several; take it out"
        return
    said = ", ".join(units.show(d, "mm", "length") for d in known)
    if None in depths:
        yield (
            f"some passes state a depth of cut ({said}) and others none, so their force level is not known; give each "
            "its depth_of_cut, or split_levels = false for one estimate of all"
        )
        return
    for depth in known:
        here = [r for r, d in zip(records, depths, strict=True) if d == depth]
        passes = {(str(r.get("cut")), _length(r, "width_of_cut")) for r in here}
        if len(passes) < needed:
            cuts = " and ".join(_pass(cut, width) for cut, width in sorted(passes, key=str))
            yield (
                f"at a depth of cut of {units.show(depth, 'mm', 'length')} there is only {cuts}: {too_few(passes)} at "
                f"this depth, or give split_levels = false for one estimate of all depths ({said})"
            )


def _pass(cut: str, width: float | None) -> str:
    return cut if width is None else f"{cut} {units.show(width, 'mm', 'length')}"


def _length(table: Raw, key: str) -> float | None:
    """Return a length where it is one; what is wrong with it the field says itself."""
    try:
        return units.parse(table[key], "length")
    except (InputError, KeyError, TypeError):
        return None
