"""Which files a pattern of a campaign names."""

from __future__ import annotations

import glob
from pathlib import Path

from process.errors import InputError


def matches(folder: Path, pattern: str) -> list[Path]:
    """Return what a pattern finds from a folder, sorted.

    ``**`` stays inside the folder (or inside what stands before it, where that is absolute or begins with ``..``): it
    does not go through links to other folders, and what it finds lies there with all links followed. Names and
    patterns without it lead wherever whoever wrote them says.

    Parameters
    ----------
    folder : Path
        Folder of the campaign.
    pattern : str
        As the shell knows them, and ``**`` for any folders between.

    Raises
    ------
    InputError
        When ``..`` stands behind ``**``.
    """
    parts = Path(pattern).parts
    if "**" not in parts:
        root = "" if Path(pattern).is_absolute() else glob.escape(str(folder)) + "/"
        return sorted(map(Path, glob.glob(root + pattern)))
    at = parts.index("**")
    if ".." in parts[at:]:
        raise InputError(f"'{pattern}': '..' behind '**' leads out of the folder; name the folder before '**'")
    before, rest = Path(*parts[:at]), "/".join("**" if p == "**" else p.replace("**", "*") for p in parts[at:])
    begins = [folder / before]
    if glob.has_magic(str(before)):
        begins = matches(folder, str(before))
    home = None if before.is_absolute() or ".." in before.parts else folder.resolve()
    found = set()
    for begin in begins:
        inside = home or begin.resolve()
        # A last ** means files too.
        for path in begin.glob(f"{rest}/*" if rest.endswith("**") else rest):
            hidden = any(p.startswith(".") for p in path.relative_to(begin).parts)
            if path.resolve().is_relative_to(inside) and not (hidden and not any(p.startswith(".") for p in parts)):
                found.add(path)
    return sorted(found)
