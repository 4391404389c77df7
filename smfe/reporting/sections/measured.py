"""What was measured, with the audit beside each measurement; every hit, step and pass for whoever looks."""

from __future__ import annotations

from typing import Any

from smfe.reporting.content import tables
from smfe.reporting.content.audit import audit
from smfe.reporting.content.style import spoken
from smfe.reporting.figures.figure_data import is_friction
from smfe.reporting.sections.draft import Draft

_KINDS = {"hit": "hits", "step": "steps", "pass": "passes"}


def section(draft: Draft) -> dict[str, Any]:
    """Return measurements and audit. Nothing where nothing was measured."""
    found = audit(draft.results)
    if not found.rows and not found.left_out:
        return {}
    kinds = {kind for _, kind in draft.results.tables}
    own = [one for one, many in _KINDS.items() if many in kinds]
    return {
        "audit": found,
        "models": [m.name for m in draft.results.measurements if m.is_model],
        "every": f"Every {', '.join(own)}" if own else "Tables",
        "tables": [
            tables.hits(frame, f"{spoken(name)}: {kind}")
            for (name, kind), frame in draft.results.tables.items()
            if not is_friction(kind) and len(frame)
        ],
    }
