"""`smfe export`: what a run recommends, for a CAM program or for the wall."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from process.errors import InputError
from smfe.cam.freecad import write_freecad
from smfe.cam.fusion import write_fusion
from smfe.cam.points import operating_points
from smfe.cam.table import write_table
from smfe.results import check_target
from stability import read_presets

Target = Literal["fusion", "freecad", "csv", "sheet"]

SUFFIXES: dict[str, tuple[str, ...]] = {
    "fusion": (".json", ".tools"),
    "freecad": (".fctb",),
    "csv": (".csv",),
    "sheet": (".pdf", ".png", ".svg"),
}
"""What the file of each target may be called."""


def export(results: Path | str, output: Path | str, to: Target, tool: str | None = None) -> list[str]:
    """Write the operating points that a run recommends for a CAM program.

    Parameters
    ----------
    results : path
        Folder of results of `smfe run`.
    output : path
        File to write. A tool library of Fusion and a tool bit of FreeCAD that are there already keep all that they
        hold; the presets of an earlier export are replaced.
    to : {"fusion", "freecad", "csv", "sheet"}
        Tool library of Autodesk Fusion (``.json``, ``.tools``), tool bit of FreeCAD (``.fctb``), table, or a page for
        the wall (``.pdf``, ``.png``, ``.svg``).
    tool : str, optional
        The tool in an existing library of Fusion, by guid, number, product-id or description.

    Returns
    -------
    list of str
        Names of the presets; of a sheet the heading.

    Raises
    ------
    InputError
        When nothing is recommended (a sheet says so itself), or the file is none that the target could read.
    """
    folder, path = Path(results), Path(output)
    if to not in get_args(Target):
        raise InputError(f"'{to}' is no target; choose {', '.join(get_args(Target))}")
    if path.suffix.lower() not in SUFFIXES[to]:
        raise InputError(f"'{path}' is no file for {to}; name it {' or '.join(f'NAME{s}' for s in SUFFIXES[to])}")
    if tool is not None and to != "fusion":
        raise InputError(f"a tool is chosen in libraries of Fusion alone; {to} has one tool a file")
    if not folder.is_dir():
        raise InputError(f"there is no folder '{folder}'; give the folder of results of `smfe run`")
    check_target(path)
    if to == "sheet":
        # Drawing stays out of the numerics: imported where it is called.
        from smfe.reporting.setup_sheet import write_sheet

        document = read_presets(folder / "presets.json")
        write_sheet(folder, path, document)
        return [f"setup sheet, {document['recommendation']['status'].replace('_', ' ')}"]
    points = operating_points(folder)
    if to == "fusion":
        return write_fusion(points, path, tool)
    return write_freecad(points, path) if to == "freecad" else write_table(points, path)
