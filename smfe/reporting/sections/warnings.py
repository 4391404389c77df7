"""Warnings, once each."""

from __future__ import annotations

from typing import Any

from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return the warnings."""
    return {"warnings": draft.results.warnings}
