"""`smfe report`: the report of a folder of results, written again."""

from __future__ import annotations

from pathlib import Path

from smfe.progress import Progress, silent


def report(folder: Path | str, progress: Progress = silent) -> Path:
    """Write the report of a folder of results again."""
    # Drawing stays out of the numerics: only the composition imports it, and only where it is called.
    from smfe.reporting import write_report

    progress("writing the report", 0, 1)
    return write_report(Path(folder), lambda done, of: progress("writing the report", done, of))
