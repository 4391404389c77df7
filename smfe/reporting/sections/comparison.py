"""Comparison of the measurements with each other and with declared models."""

from __future__ import annotations

from typing import Any

from smfe.reporting.content import tables
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return what differs between the measurements, and why."""
    results = draft.results
    frame, errors = results.comparison, results.model_error
    sentences, table = ([], None) if frame is None or frame.empty else tables.comparison(frame)
    return {
        "sentences": sentences,
        "table": table,
        "compared": frame is not None,
        "failures": draft.failures("comparison"),
        "explained": tables.explained(results.explained),
        "errors": [] if errors is None or errors.empty else tables.model_errors(errors),
    }
