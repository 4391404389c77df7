"""The files of a folder of results, with what each is and what opens it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

_SHEET, _ARRAYS = "spreadsheet", "Python (xarray), MATLAB (ncread), Panoply"

KNOWN: dict[str, tuple[str, str]] = {
    "presets.json": (
        "The recommendation, and the best speeds and depths of each source as cutting data",
        "CAM, text editor",
    ),
    "pockets.csv": ("The recommendation first, then the pockets between the lobes", _SHEET),
    "lobe_table.csv": ("Limit depth, its interval and safe depth over spindle speed", _SHEET),
    "bands.csv": ("All bands of depth, stable and unstable, over spindle speed", _SHEET),
    "maps.csv": ("Vibration, wall, force, torque and power over spindle speed and depth", _SHEET),
    "maps.nc": ("The same as arrays over spindle speed and depth", _ARRAYS),
    "widths.csv": ("Limit depth and removal rate over width of cut and spindle speed", _SHEET),
    "widths.nc": ("The same as arrays over width of cut and spindle speed", _ARRAYS),
    "lobes.nc": ("Stability lobes with quantiles and single lobes", _ARRAYS),
    "chatter.csv": ("Cutting tests: verdict, chatter frequency, what was predicted", _SHEET),
    "ranking.csv": ("Methods by the share of cutting tests that they predict rightly", _SHEET),
    "ranking_differences.csv": ("Which of their differences are more than chance", _SHEET),
    "spectra.nc": ("Spectra and spectrograms of the cutting tests", _ARRAYS),
    "frf.nc": ("Compliances with uncertainty and coherence, one group a measurement", _ARRAYS),
    "conditions.nc": ("Compliances over force level and feed", _ARRAYS),
    "comparison.csv": ("Peaks of the measurements beside each other", _SHEET),
    "explained.csv": ("What feed, level, controller and method explain of the differences", _SHEET),
    "model_error.csv": ("Error of each measurement against the declared models", _SHEET),
    "drives.csv": ("Inertia, friction and open loop of the drives", _SHEET),
    "open_loops.nc": ("Open-loop responses of the drives, carriage over drive force", _ARRAYS),
    "loops.nc": ("Responses of the drive loops", _ARRAYS),
    "finding.json": ("The diagnosis: what the simulation gets wrong", "text editor"),
    "finding.toml": ("The extended model of the diagnosis, as a campaign", "text editor"),
    "provenance.json": ("Versions, settings, inputs with SHA-256, warnings", "text editor"),
}
"""Files that a run may leave, the ones most asked for first -> what they are and what opens them."""


@dataclass(frozen=True)
class File:
    """Address relative to the page, name, size in words, what it is, what opens it."""

    link: str
    name: str
    size: str
    what: str
    opens: str


def files(folder: Path) -> list[File]:
    """Return the known files of a folder that are there."""
    return [
        File(quote(name), name, size_text((folder / name).stat().st_size), what, opens)
        for name, (what, opens) in KNOWN.items()
        if (folder / name).is_file()
    ]


def links(folder: Path, names: Iterable[str]) -> list[tuple[str, str]]:
    """Return address and name of files of a folder below the results, those that are there."""
    found = [name for name in names if (folder / name).is_file()]
    return [(quote(f"{folder.name}/{name}"), name) for name in found]


def size_text(size: int) -> str:
    """Return "4.1 MB", "84 kB"."""
    return f"{size / 1e6:.1f} MB" if size >= 995_000 else f"{max(1, round(size / 1e3))} kB"
