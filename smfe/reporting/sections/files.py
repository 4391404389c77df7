"""The files of the folder, and where the results come from: versions, input files, settings."""

from __future__ import annotations

import datetime
import json
from typing import Any

from smfe.reporting.content.folder import files, links, size_text
from smfe.reporting.figures import draw_matplotlib
from smfe.reporting.sections.draft import Draft


def section(draft: Draft) -> dict[str, Any]:
    """Return the files and the provenance with every part in the shape that the template takes."""
    results, content = draft.results, draft.results.provenance

    def pairs(name: str) -> dict[str, Any]:
        part = content.get(name, {})
        return part if isinstance(part, dict) else {"": part}

    inputs = content.get("inputs", [])
    folder = results.folder
    pictures = draw_matplotlib.pictures(results, draft.looks)
    tables = sorted(path.name for path in (folder / "tables").glob("*.csv"))
    return {
        "files": files(folder),
        "size": size_text(sum((folder / f.name).stat().st_size for f in files(folder))),
        "folders": [
            ("Figures for papers and slides", links(folder / "figures", pictures)),
            ("Every hit, step and pass", links(folder / "tables", tables)),
        ],
        "known": bool(content),
        "empty": results.diagnosis_alone or not (content or files(folder)),
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
