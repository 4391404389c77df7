"""Refuse a user's own ``process.py`` that shadows the package `process`."""

from __future__ import annotations

import importlib.util
from pathlib import Path


def check_process() -> None:
    """Raise `ImportError` with a clear sentence when ``import process`` would find something else than ours.

    The finder is asked before anything is imported: a foreign ``process.py`` is often a script, and importing
    it would run it. A foreign module that is already imported is found by its own record.
    """
    try:
        spec = importlib.util.find_spec("process")
    except ValueError:  # a module without a record of its origin, put into sys.modules by hand
        raise ImportError("a foreign module named 'process' is loaded; smfe needs its own package 'process'") from None
    if spec is None:
        raise ImportError("the package 'process' is not installed; it comes with smfe: install smfe again")
    folders = spec.submodule_search_locations or []
    if not any((Path(folder) / "labels.py").is_file() for folder in folders):
        found = spec.origin or ", ".join(folders)
        raise ImportError(
            f"'import process' finds {found}, which is not the package 'process' of smfe; "
            "rename that file or folder, or start Python elsewhere"
        )
