"""From data frames to tables that are read: units in brackets, few digits, rows that matter marked."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from smfe.reporting.content.style import number, spoken, with_spread

UNITS: dict[str, str] = {
    "cm3_min": "cm³/min",
    "mm_min": "mm/min",
    "um_per_N": "µm/N",
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
    fold : bool
        Whether it is folded however short it is.
    """

    headers: tuple[str, ...]
    numeric: tuple[bool, ...]
    rows: tuple[Row, ...]
    summary: str = ""
    fold: bool = False

    @property
    def folded(self) -> bool:
        """Whether it is made when it is opened: it was asked for, or the table is too long to stand open."""
        return self.fold or len(self.rows) > LONG

    @property
    def content(self) -> dict[str, Any]:
        """What tables.js makes of it when it is opened."""
        rows = [list(row.cells) for row in self.rows]
        css = {str(at): row.css for at, row in enumerate(self.rows) if row.css}
        return {"head": list(self.headers), "numeric": [int(n) for n in self.numeric], "rows": rows, "css": css}


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
    """Return the folded table of hits, steps or passes of a measurement; what was not used is marked."""
    shown = frame.dropna(axis="columns", how="all")
    if "used" not in frame:
        return replace(table(shown, f"{title}: {len(frame)} row{'s' if len(frame) != 1 else ''}"), fold=True)
    used = int(sum(true(v) for v in frame["used"]))
    made = table(shown, f"{title}: {used} of {len(frame)} used", lambda row: "" if true(row["used"]) else "rejected")
    return replace(made, fold=True)


_DIFFERENCES = ("frequency", "damping", "amplitude")


def comparison(frame: pd.DataFrame) -> Table:
    """Return comparison.csv with what a reader needs, each difference with two digits of its uncertainty."""
    if "measurement_a" not in frame or "match" not in frame:
        return replace(table(frame.dropna(axis="columns", how="all"), f"All {len(frame)} rows"), fold=True)
    rows = []
    for row in frame.to_dict("records"):
        peaks = [with_spread(_value(row, f"frequency_{m}_Hz"), _value(row, f"frequency_std_{m}_Hz")) for m in "ab"]
        changes = [
            with_spread(_value(row, f"{q}_difference_percent"), _value(row, f"{q}_difference_std_percent"))
            for q in _DIFFERENCES
        ]
        which = [q for q in _DIFFERENCES if true(row.get(f"{q}_significant"))]
        said = ", ".join(which) or ("all three together" if true(row.get("significant")) else "–")
        head = (
            spoken(str(row["measurement_a"])),
            spoken(str(row["measurement_b"])),
            f"{row['response']}{row['excitation']}",
        )
        cells = (*map(str, head), str(row["match"]), *peaks, *changes, said)
        rows.append(Row(cells, "significant" if true(row.get("significant")) else ""))
    own = ("a", "b", "entry", "peak in", "frequency a [Hz]", "frequency b [Hz]")
    headers = (*own, *(f"{q}, b from a [%]" for q in _DIFFERENCES), "significant")
    numeric = (False,) * 4 + (True,) * 5 + (False,)
    return Table(headers, numeric, tuple(rows), f"All {len(frame)} pairs of peaks, ± one standard deviation", fold=True)


def _value(row: Mapping[Any, Any], key: str) -> float:
    value = row.get(key, np.nan)
    return float(value) if isinstance(value, int | float | np.integer | np.floating) else float("nan")


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
            band = [f"{number(low[m], 3)} to {number(high[m], 3)}" for m in shown["measurement"]]
            shown.insert(1, "band_Hz", band)
        shown.columns = [str(c) for c in shown.columns]
        shown["measurement"] = [spoken(str(name)) for name in shown["measurement"]]
        out.append(table(shown, f"Relative error against {spoken(str(model))} [%]", digits=2))
    return out


def explained(frame: pd.DataFrame | None) -> Table | None:
    """Return what conditions explain, significant rows marked; None without a row."""
    if frame is None or frame.empty:
        return None
    rows = []
    for row in frame.to_dict("records"):
        effect = _value(row, "effect_percent")
        ends = [str(row.get(key) or "") for key in ("lowest", "highest")] if np.isfinite(effect) else ["", ""]
        cells = (
            f"{row.get('response', '')}{row.get('excitation', '')}",
            number(_value(row, "frequency_Hz"), 3),
            str(row["quantity"]),
            str(row["factor"]).replace("_", " ").replace(" x ", " × "),
            with_spread(effect, _value(row, "effect_std_percent")),
            *map(condition_text, ends),
            number(_value(row, "explained_percent"), 2),
            number(_value(row, "p_family"), 2),
        )
        rows.append(Row(cells, "significant" if true(row["significant"]) else ""))
    headers = (
        "entry",
        "peak [Hz]",
        "quantity",
        "condition",
        "effect [%]",
        "from",
        "to",
        "explains [%]",
        "p corrected [1]",
    )
    numeric = (False, True, False, False, True, False, False, True, True)
    count = sum(bool(row.css) for row in rows)
    summary = f"What explains the differences: {count} of {len(frame)} rows are significant (5 % for all together)"
    return Table(headers, numeric, tuple(rows), summary, fold=True)


def condition_text(text: str) -> str:
    """Return "120 mm/min along x" for "x 120 mm/min, y 0 mm/min, z 0 mm/min": an axis at rest is not said."""
    parts = [part for part in text.split(", ") if not re.fullmatch(r"[xyz] 0 mm/min", part)]
    return re.sub(r"\b([xyz]) (-?[\d.]+ mm/min)", r"\2 along \1", ", ".join(parts)) or (text and "0 mm/min")


def conditions_text(conditions: Mapping[str, str]) -> str:
    """Return "feed 120 mm/min along x, depth of cut 2 mm"; an axis at rest is not said."""
    return ", ".join(f"{key.replace('_', ' ')} {condition_text(value)}" for key, value in conditions.items())
