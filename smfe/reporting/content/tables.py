"""From data frames to tables that are read: units in brackets, few digits, rows that matter marked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from smfe.reporting.content.headline import outcomes
from smfe.reporting.content.style import number

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
    """

    headers: tuple[str, ...]
    numeric: tuple[bool, ...]
    rows: tuple[Row, ...]
    summary: str = ""

    @property
    def folded(self) -> bool:
        """Whether it is too long to stand open."""
        return len(self.rows) > LONG

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
    """Return the table of hits, steps or passes of a measurement; what was not used is marked."""
    shown = frame.dropna(axis="columns", how="all")
    if "used" not in frame:
        return table(shown, f"{title}: {len(frame)} rows")
    used = int(sum(true(v) for v in frame["used"]))
    return table(shown, f"{title}: {used} of {len(frame)} used", lambda row: "" if true(row["used"]) else "rejected")


def cutting_tests(frame: pd.DataFrame) -> list[Table]:
    """Return what the criterion found in the cutting tests, and what each source of lobes had predicted."""
    happened = outcomes(frame)
    sources = [str(c).removeprefix("predicted_") for c in frame.columns if str(c).startswith("predicted_")]
    columns = [
        f"{kind}_{s}{end}" for s in sources for kind, end in (("predicted", ""), ("limit", "_mm"), ("frequency", "_Hz"))
    ]
    found = frame.drop(columns=columns, errors="ignore").dropna(axis="columns", how="all")
    out = [table(found, f"{len(frame)} cutting tests", lambda row: str(row["verdict"]))]
    if sources:
        test = ["file", "spindle_speed_rpm", "depth_of_cut_mm"]
        shown = frame[test].assign(outcome=happened, **{s: _predictions(frame, s, happened) for s in sources})
        plain = table(shown, "Limit depth [mm] and prediction of each source")
        # The name of a source stands as it is.
        headers = (*plain.headers[: len(test) + 1], *sources)
        out.append(Table(headers, plain.numeric, plain.rows, plain.summary))
    return out


def _predictions(frame: pd.DataFrame, source: str, happened: pd.Series[str]) -> list[str]:
    """Return e.g. "3.927, stable" a test."""
    limits = frame.get(f"limit_{source}_mm", pd.Series(np.nan, index=frame.index))
    out = []
    for limit, predicted, outcome in zip(limits, frame[f"predicted_{source}"], happened, strict=True):
        wrong = " (wrong)" if {outcome, predicted} == {"stable", "chatter"} else ""
        out.append(f"{number(limit)}, {predicted}{wrong}")
    return out


def comparison(frame: pd.DataFrame) -> tuple[list[str], Table]:
    """Return the headline sentences and the table of differences between measurements."""
    marked = table(
        frame.dropna(axis="columns", how="all"),
        f"All {len(frame)} rows",
        lambda row: "significant" if true(row.get("significant")) else "",
    )
    alone = int((frame["match"] != "both").sum()) if "match" in frame else 0
    sentences = [f"{len(frame) - alone} pairs of peaks were compared."]
    if "significant" in frame:
        rows = _where(frame, "significant")
        sentences[0] += f" {len(rows)} differ significantly (shaded rows)."
        sentences += _largest(rows)
    if alone:
        sentences.append(f"{alone} peaks were found in one of two measurements only.")
    return sentences, marked


def _where(frame: pd.DataFrame, column: str) -> pd.DataFrame:
    """Return the rows in which a column is true; an empty list would select columns, so the mask is an array."""
    return frame[np.array([true(v) for v in frame[column]], dtype=bool)]


def _largest(rows: pd.DataFrame) -> list[str]:
    """Return for each kind of difference where it is largest, among those that are significant."""
    own = [str(c).removesuffix("_significant") for c in rows.columns if str(c).endswith("_significant")]
    out = []
    for column in map(str, rows.columns):
        quantity, found, _ = column.partition("_difference")
        if not found or "_std" in column or not _numeric(rows[column]) or (own and quantity not in own):
            continue
        counted = _where(rows, f"{quantity}_significant") if own else rows
        values = counted[column].abs().fillna(0.0).to_numpy(dtype=float)
        if values.max(initial=0.0) > 0.0:
            out.append(_difference_text(counted.iloc[int(values.argmax())], column))
    return out


def _difference_text(row: pd.Series[Any], column: str) -> str:
    title, _, unit = heading(column).partition(" [")
    std = row.get(column.replace("_difference", "_difference_std"))
    spread = f" ± {number(std, 2)}" if std is not None else ""
    amount = f"{number(row[column], 3)}{spread} {unit.rstrip(']')}".strip()
    return f"Largest significant {title}: {amount} ({_named(row)})."


def _named(row: pd.Series[Any]) -> str:
    """Return what a row of the comparison is about: its text cells, the entry in one word."""
    other = ("response", "excitation", "match")
    parts = [str(v) for k, v in row.items() if isinstance(v, str) and v and k not in other]
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


EXPLAINED = (
    *("response", "excitation", "frequency_Hz", "quantity", "factor", "lowest", "highest", "effect_percent"),
    *("effect_low_percent", "effect_high_percent", "explained_percent", "p", "p_family", "significant"),
)
"""Columns of what conditions explain that the report holds; the file has all."""


def explained(frame: pd.DataFrame | None) -> Table | None:
    """Return what conditions explain, significant rows marked; None without a row."""
    if frame is None or frame.empty:
        return None
    count = int(sum(true(v) for v in frame["significant"]))
    shown = frame[[c for c in EXPLAINED if c in frame]]
    return table(
        shown,
        f"{count} of {len(frame)} rows are significant (5 % for all together)",
        lambda row: "significant" if true(row["significant"]) else "",
        digits=3,
    )
