"""Where the results come from: versions, input files, settings."""

from __future__ import annotations

import datetime
import json
from typing import Any

from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return provenance with every part in the shape that the template takes."""
    content = draft.results.provenance

    def pairs(name: str) -> dict[str, Any]:
        part = content.get(name, {})
        return part if isinstance(part, dict) else {"": part}

    inputs = content.get("inputs", [])
    return {
        "known": bool(content),
        "created": _moment(str(content.get("created", ""))),
        "versions": pairs("versions"),
        "seconds": pairs("seconds"),
        "settings": json.dumps(content["settings"], indent=2, ensure_ascii=False) if content.get("settings") else "",
        "inputs": [i for i in inputs if isinstance(i, dict)] if isinstance(inputs, list) else [],
    }


def _moment(text: str) -> str:
    """Return "2026-11-21 06:00 UTC" for a date and time in ISO 8601, any other text as it is."""
    try:
        moment = datetime.datetime.fromisoformat(text)
    except ValueError:
        return text
    return moment.strftime("%Y-%m-%d %H:%M %Z").strip()
