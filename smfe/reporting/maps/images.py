"""How the pictures of one source are called, and how a page holds them."""

from __future__ import annotations

import base64
import re
from pathlib import Path


def picture_name(kind: str, request: str, source: str) -> str:
    """Return the file name of a picture of one source: "maps_lobes_1_sweep.png"."""
    own = re.sub(r"[^\w-]", "_", f"{request}_{source}")
    return f"{kind}_{own}.png"


def embedded(folder: Path, name: str) -> str:
    """Return a picture of a folder of results as the address of an image in a page, "" where it is not there."""
    file = folder / "figures" / name
    if not file.is_file():
        return ""
    return "data:image/png;base64," + base64.b64encode(file.read_bytes()).decode("ascii")
