"""What the sections of a page are made of, and what they leave behind: plots and long tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from smfe.reporting.content.results import Results
from smfe.reporting.content.style import Line, palette
from smfe.reporting.content.tables import Table
from smfe.results import LOBES, MEASUREMENT, PREDICTION, TEST

_SECTION = {
    MEASUREMENT: "measured",
    LOBES: "lobes",
    TEST: "cutting_tests",
    PREDICTION: "cutting_tests",
    "comparison": "comparison",
}
"""What failed -> the section in which it would have stood."""


@dataclass(frozen=True)
class Draft:
    """A page in the making.

    Parameters
    ----------
    results : Results
        What the folder holds.
    looks : mapping of str to Line
        The look of each measurement, model and source of lobes.
    plots : dict
        Figure of each element of the page with this id; the sections fill it.
    tables : list of Table
        Long tables, which the page makes when they are opened; the templates fill it.
    """

    results: Results
    looks: Mapping[str, Line]
    plots: dict[str, Any] = field(default_factory=dict)
    tables: list[Table] = field(default_factory=list)

    @classmethod
    def of(cls, results: Results) -> Draft:
        """Return an empty page."""
        return cls(results, palette(results))

    def late(self, table: Table) -> int:
        """Keep a table for the page to make when it is opened, and return its place."""
        self.tables.append(table)
        return len(self.tables) - 1

    def failures(self, section: str) -> list[dict[str, str]]:
        """Return what failed and would have stood in a section; "other" holds what would have stood in none."""
        found = [f for f in self.results.failures if _SECTION.get(f.part, "other") == section]
        return [{"what": f"{f.part} {f.name}".strip(), "reason": f.reason} for f in found]
