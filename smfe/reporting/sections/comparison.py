"""Comparison of the measurements with each other and with declared models."""

from __future__ import annotations

from typing import Any

from smfe.reporting.content import tables
from smfe.reporting.content.compared import sentences
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return what differs between the measurements, and why. Nothing where there is nothing to compare."""
    results = draft.results
    frame, errors, failures = results.comparison, results.model_error, draft.failures("comparison")
    compared = frame is not None and not frame.empty
    judged = errors is not None and not errors.empty
    if not compared and not judged and not failures:
        return {}
    return {
        "sentences": sentences(frame, results.explained) if frame is not None and compared else [],
        "table": tables.comparison(frame) if frame is not None and compared else None,
        "failures": failures,
        "explained": tables.explained(results.explained),
        "errors": tables.model_errors(errors) if errors is not None and judged else [],
    }
