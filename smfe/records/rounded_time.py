"""Columns of times that were printed with too few digits: an even clock through them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from smfe.records.formats.channels import Channel
from smfe.records.formats.table import Table


def is_rounded(table: Table, channels: Mapping[str, Channel]) -> bool:
    """Whether the column of times of a table repeats its values, as times printed with too few digits do."""
    clock = channels.get("time")
    if clock is None or clock.column is None or clock.column not in table.columns:
        return False
    steps = np.diff(table.columns[clock.column])
    return bool(steps.size and np.all(steps >= 0.0) and np.any(steps == 0.0) and np.any(steps > 0.0))


def evened(source: str, table: Table, channels: Mapping[str, Channel]) -> Table:
    """Return a table whose rounded times are those of the even clock that fits them, and say so.

    A line ``a + b k`` through the times t_k of n samples that were rounded to q has a step b that is uncertain by
    ``q/n^1.5``. It takes their place only where no time departs from it by more than 0.8 q: rounding departs by
    0.5 q, and lost samples show as a jump. Other tables come back as they are.
    """
    if not is_rounded(table, channels):
        return table
    column = channels["time"].column
    assert column is not None
    times = table.columns[column]
    steps = np.diff(times)
    quantum = float(np.min(steps[steps > 0.0]))
    k = np.arange(times.size) - 0.5 * (times.size - 1)
    step = float(k @ times) / float(k @ k)
    even = times.mean() + step * k
    if step <= 0.0 or np.max(np.abs(times - even)) > 0.8 * quantum:
        return table
    note = (
        f"{source}: the times of '{column}' are printed in steps of {quantum:.3g}; an even clock with a step of "
        f"{step:.6g} fits all of them and is used. Samples lost within one printed step would not show"
    )
    return replace(table, columns={**table.columns, column: even}, notes=(*table.notes, note))
