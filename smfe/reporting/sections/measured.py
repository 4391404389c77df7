"""What was measured: hits, steps and passes."""

from __future__ import annotations

from typing import Any

from smfe.reporting.content import tables
from smfe.reporting.figures.figure_data import is_friction
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return the tables of the measurements."""
    found = draft.results.tables
    return {"tables": [tables.hits(f, f"{m}: {t}") for (m, t), f in found.items() if not is_friction(t)]}
