"""`smfe report`: the report of a folder of results, written again."""

from __future__ import annotations

from pathlib import Path

from process.errors import InputError
from smfe.progress import Progress, silent
from smfe.staged import held

SHOWN = (
    *("frf.nc", "lobes.nc", "conditions.nc", "loops.nc", "spectra.nc", "chatter.csv", "drives.csv", "comparison.csv"),
    *("explained.csv", "model_error.csv", "lobe_table.csv", "pockets.csv", "presets.json", "finding.json"),
    *("open_loops.nc", "provenance.json"),
)
"""Files of results that a report shows; one of them is enough."""


def report(folder: Path | str, progress: Progress = silent) -> Path:
    """Write the report of a folder of results again.

    Raises
    ------
    InputError
        When there is no such folder, or no result in it.
    """
    path = Path(folder)
    if path.is_dir() and not any((path / name).is_file() for name in SHOWN):
        raise InputError(
            f"'{path}' holds no results; a report needs at least one of {', '.join(SHOWN[:2])}, chatter.csv or "
            f"finding.json, as `smfe run CAMPAIGN --out {path}` writes them"
        )
    if not path.is_dir():
        return report_of(path, progress)
    with held(path):
        return report_of(path, progress)


def report_of(path: Path, progress: Progress) -> Path:
    """Write the report of a folder that nobody else writes into."""
    # Drawing stays out of the numerics: only the composition imports it, and only where it is called.
    from smfe.reporting import write_report

    progress("writing the report", 0, 1)
    return write_report(path, lambda done, of: progress("writing the report", done, of))
