"""From data frames to tables that are read: units in brackets, few digits, rows that matter marked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from smfe.report.look import number

UNITS: dict[str, str] = {
    "cm3_min": "cm³/min",
    "mm_min": "mm/min",
    "um_N": "µm/N",
    "m_N": "m/N",
    "N_um": "N/µm",
    "m_s2": "m/s²",
    "percent": "%",
    "rpm": "rpm",
    "Hz": "Hz",
    "kHz": "kHz",
    "mm": "mm",
    "um": "µm",
    "ms": "ms",
    "us": "µs",
    "Ns": "N s",
    "kN": "kN",
    "dB": "dB",
    "deg": "°",
    "rad": "rad",
    "s": "s",
    "N": "N",
    "V": "V",
    "g": "g",
}
"""End of a column's name -> the unit it stands for; longer ends first."""

LONG = 30
"""A table with more rows is folded."""

Marker = Callable[[Mapping[str, Any]], str]


@dataclass(frozen=True)
class Row:
    """Cells of a row and its CSS class."""

    cells: tuple[str, ...]
    css: str = ""


@dataclass(frozen=True)
class Table:
    """A table ready to be written.

    Parameters
    ----------
    headers : tuple of str
        With units.
    numeric : tuple of bool
        Columns that are aligned to the right.
    rows : tuple of Row
        Text cells.
    summary : str
        What the fold says, or the caption.
    """

    headers: tuple[str, ...]
    numeric: tuple[bool, ...]
    rows: tuple[Row, ...]
    summary: str = ""

    @property
    def folded(self) -> bool:
        """Whether it is too long to stand open."""
        return len(self.rows) > LONG


def heading(column: str) -> str:
    """Return "frequency a [Hz]" for "frequency_a_Hz"."""
    for end, unit in UNITS.items():
        if column.endswith(f"_{end}"):
            return f"{column[: -len(end) - 1].replace('_', ' ')} [{unit}]"
    return column.replace("_", " ")


def table(frame: pd.DataFrame, summary: str = "", mark: Marker | None = None, digits: int = 4) -> Table:
    """Return a table of any data frame; `mark` names the CSS class of a row."""
    columns = [str(c) for c in frame.columns]
    numeric = tuple(_numeric(frame[c]) for c in frame.columns)
    rows = []
    for record in frame.to_dict("records"):
        cells = tuple(_cell(record[c], digits) for c in frame.columns)
        rows.append(Row(cells, mark({str(k): v for k, v in record.items()}) if mark is not None else ""))
    return Table(tuple(heading(c) for c in columns), numeric, tuple(rows), summary)


def true(value: object) -> bool:
    """Whether a cell of a table, read from a file, says yes."""
    return str(value).lower() in ("true", "yes", "1", "1.0")


def _numeric(column: pd.Series[Any]) -> bool:
    return bool(pd.api.types.is_numeric_dtype(column)) and not pd.api.types.is_bool_dtype(column)


def _cell(value: object, digits: int) -> str:
    if value in ("True", "False"):
        return "yes" if value == "True" else "no"
    return number(value, digits)


def hits(frame: pd.DataFrame, title: str) -> Table:
    """Return the table of hits, steps or passes of a measurement; what was not used is marked."""
    if "used" not in frame:
        return table(frame, f"{title}: {len(frame)} rows")
    used = int(sum(true(v) for v in frame["used"]))
    return table(
        frame, f"{title}: {used} of {len(frame)} used", lambda row: "" if true(row["used"]) else "rejected"
    )


def comparison(frame: pd.DataFrame) -> tuple[list[str], Table]:
    """Return the headline sentences and the table of differences between measurements."""
    marked = table(
        frame,
        f"{len(frame)} pairs of peaks",
        lambda row: "significant" if true(row.get("significant")) else "",
    )
    sentences = [f"{len(frame)} pairs of peaks were compared."]
    if "significant" not in frame:
        return sentences, marked
    rows = frame[[true(v) for v in frame["significant"]]]
    sentences[0] += f" {len(rows)} differ significantly (shaded rows)."
    return sentences + _largest(rows), marked


def _largest(rows: pd.DataFrame) -> list[str]:
    """Return for each kind of difference where it is largest."""
    out = []
    for column in rows.columns:
        name = str(column)
        if "difference" not in name or "std" in name or not _numeric(rows[column]):
            continue
        values = rows[column].to_numpy(dtype=float)
        values = np.where(np.isfinite(values), np.abs(values), -1.0)
        if values.size and values.max() > 0.0:
            row = rows.iloc[int(values.argmax())]
            title, _, unit = heading(name).partition(" [")
            amount = f"{number(row[column])} {unit.rstrip(']')}".strip()
            out.append(f"Largest significant {title}: {amount} ({_named(row)}).")
    return out


def _named(row: pd.Series[Any]) -> str:
    """Return what a row of the comparison is about: its text cells, the entry in one word."""
    parts = [
        str(v) for k, v in row.items() if isinstance(v, str) and v and k not in ("response", "excitation")
    ]
    entry = f"{row.get('response', '')}{row.get('excitation', '')}"
    return ", ".join([*parts, entry] if entry else parts)


def model_errors(frame: pd.DataFrame) -> list[Table]:
    """Return one table a model: measurements against entries, and their mean."""
    out = []
    for model, rows in frame.groupby("model", sort=False):
        entry = rows["response"].astype(str) + rows["excitation"].astype(str)
        wide = rows.assign(entry=entry).pivot_table(
            index="measurement", columns="entry", values="error_percent", sort=False
        )
        wide = wide[sorted(wide.columns)]
        wide["mean"] = wide.mean(axis=1)
        spans = rows.groupby("measurement", sort=False)[["from_Hz", "to_Hz"]] if "from_Hz" in rows else None
        shown = wide.reset_index()
        if spans is not None:
            low, high = spans.min()["from_Hz"], spans.max()["to_Hz"]
            band = [f"{number(low[m])}–{number(high[m])}" for m in shown["measurement"]]
            shown.insert(1, "band_Hz", band)
        shown.columns = [str(c) for c in shown.columns]
        out.append(table(shown, f"Relative error against {model} [%]", digits=3))
    return out
