"""What conditions explain, as a table that is read."""

from __future__ import annotations

import pandas as pd

from smfe.reporting.tables import Table, table, true

SHOWN = (
    *("response", "excitation", "frequency_Hz", "quantity", "factor", "lowest", "highest", "effect_percent"),
    *("effect_low_percent", "effect_high_percent", "explained_percent", "p", "p_family", "significant"),
)
"""Columns that the report shows; the file holds all."""


def explained(frame: pd.DataFrame | None) -> Table | None:
    """Return the table, rows that are significant marked; None when there is nothing to show."""
    if frame is None or frame.empty:
        return None
    count = int(sum(true(v) for v in frame["significant"]))
    shown = frame[[c for c in SHOWN if c in frame]]
    return table(
        shown,
        f"{count} of {len(frame)} rows are significant (5 % for all together)",
        lambda row: "significant" if true(row["significant"]) else "",
        digits=3,
    )
