"""Rows of a catalogue that somebody asks for: by machine, date, kind, or what a column holds."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Sequence
from datetime import date
from typing import Any

import pandas as pd

from process.errors import InputError
from smfe.fleet.columns import COLUMNS, KINDS
from smfe.records.formats.channels import did_you_mean

_COMPARE: dict[str, Callable[[Any, Any], Any]] = {
    "<=": operator.le,
    ">=": operator.ge,
    "!=": operator.ne,
    "==": operator.eq,
    "=": operator.eq,
    "<": operator.lt,
    ">": operator.gt,
}
_CONDITION = re.compile(r"\s*(\w+)\s*(<=|>=|!=|==|=|<|>)\s*(.+?)\s*")


def selected(
    rows: pd.DataFrame,
    machines: Sequence[str] = (),
    where: Sequence[str] = (),
    since: str | None = None,
    until: str | None = None,
    kind: str | None = None,
) -> pd.DataFrame:
    """Return the rows for which every condition holds; what is not known meets no condition.

    Parameters
    ----------
    rows : pandas.DataFrame
        A catalogue.
    machines : sequence of str
        Names; any of them.
    where : sequence of str
        "COLUMN OPERATOR VALUE": "frequency_Hz > 30", "verdict = chatter", "date >= 2025-01-01"; all of them.
    since, until : str, optional
        Dates, both included.
    kind : str, optional
        One of `KINDS`.

    Raises
    ------
    InputError
        When a machine, a column or a kind does not exist, or a value is none of its column.
    """
    keep = pd.Series(True, rows.index)
    if machines:
        known = set(rows["machine"].dropna())
        for name in machines:
            if name not in known:
                raise InputError(f"the catalogue has no machine '{name}'{_meant(name, sorted(known))}")
        keep &= rows["machine"].isin(machines)
    if kind is not None:
        if kind not in KINDS:
            raise InputError(f"there is no kind of rows '{kind}'; there are {', '.join(KINDS)}")
        keep &= rows["kind"] == kind
    conditions = [*where, *([f"date >= {since}"] if since else []), *([f"date <= {until}"] if until else [])]
    for text in conditions:
        keep &= _holds(rows, text)
    return rows[keep]


def _holds(rows: pd.DataFrame, text: str) -> pd.Series[bool]:
    found = _CONDITION.fullmatch(text)
    if found is None:
        raise InputError(
            f"'{text}' is no condition; write a column, one of < <= = != >= > and a value: frequency_Hz > 30"
        )
    name, sign, value = found.groups()
    if name not in COLUMNS:
        raise InputError(f"the catalogue has no column '{name}'{_meant(name, list(COLUMNS))}")
    column, compare = rows[name], _COMPARE[sign]
    given: Any = value.strip("\"'")
    match COLUMNS[name][0]:
        case "number":
            try:
                given = float(given)
            except ValueError:
                raise InputError(f"'{text}': {name} holds numbers, and '{given}' is none") from None
        case "date":
            try:
                given = date.fromisoformat(given)
            except ValueError:
                raise InputError(f"'{text}': write a date as 2025-01-31") from None
    holds = [bool(known and compare(entry, given)) for known, entry in zip(column.notna(), column, strict=True)]
    return pd.Series(holds, rows.index, dtype=bool)


def _meant(name: str, known: Sequence[str]) -> str:
    return did_you_mean(name, known) or f"; there are {', '.join(known[:12])}{', ...' if len(known) > 12 else ''}"
