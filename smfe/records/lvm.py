"""LabVIEW measurement files (.lvm), read with lvm_read; each segment is a record."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import lvm_read
import numpy as np
from numpy.typing import NDArray

from process.errors import InputError
from smfe.records.table import Column, Table, damaged, find_columns


def read_tables(path: Path, wanted: Sequence[Column]) -> list[Table]:
    """Read the wanted columns of every segment of an LVM file; see `smfe.records.read_records`."""
    with damaged(path, "a LabVIEW measurement file"):
        text = path.read_text(encoding="utf-8", errors="ignore")
        if not text.strip():
            raise InputError(f"{path.name}: the file is empty")
        if not text.startswith("LabVIEW Measurement"):
            raise InputError(f"{path.name}: not a LabVIEW measurement file; its first line must say so")
        # read_str and not read: that would load (and leave) a pickle beside the file.
        content = lvm_read.read_str(text)
        return [_segment(path, content[number], number, wanted) for number in range(content["Segments"])]


def _segment(path: Path, segment: dict[str, Any], number: int, wanted: Sequence[Column]) -> Table:
    data: NDArray[np.float64] = np.atleast_2d(segment["data"])
    source = f"{path.name}, segment {number}"
    stated = [int(samples) for samples in segment.get("Samples", []) if samples == samples]
    rows, stated_rows = data.shape[0] if data.size else 0, max(stated, default=1)
    if rows < stated_rows:
        raise InputError(f"{source}: {rows} of the {stated_rows} samples that its header states; the file is truncated")
    names = [name for name in segment["Channel names"] if name != "Comment"]
    at = find_columns(source, names, wanted, min(len(names), data.shape[1]))
    rate, start = _clock(segment)
    columns = {column: np.ascontiguousarray(data[:, index]) for column, index in at.items()}
    return Table(columns, rate, start)


def _clock(segment: dict[str, Any]) -> tuple[float | None, float]:
    """Return the sample rate [Hz] and the first time [s] where all channels share them."""
    step = {float(value) for value in segment.get("Delta_X", []) if value == value}
    start = {float(value) for value in segment.get("X0", []) if value == value}
    if len(step) != 1 or len(start) > 1 or not min(step) > 0.0:
        return None, 0.0
    return 1.0 / step.pop(), start.pop() if start else 0.0
