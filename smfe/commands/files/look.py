"""`smfe look`: what a file holds, what kind of record it seems to be, and a campaign file to start from."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import xarray as xr

from smfe.records.look import Look, examine
from smfe.results import write_atomically


def look(path: str | Path | xr.Dataset | pd.DataFrame, output: str | Path | None = None) -> Look:
    """Say what a file holds and what kind of record it seems to be.

    Parameters
    ----------
    path : path, xarray.Dataset or pandas.DataFrame
        Any file that `read_records` reads; a record; or a table with a column a channel.
    output : path, optional
        Folder for a picture, ``NAME.look.png``, and a campaign file to start from, ``NAME.look.toml``. A campaign file
        that is there already is left as it is. None: nothing is written.

    Returns
    -------
    Look

    Raises
    ------
    InputError
        When the file cannot be read or holds no column of numbers.
    """
    if output is None:
        return examine(path)
    # Drawing stays out of the numerics: imported where it is called.
    from smfe.reporting.first_look import draw

    folder = Path(output)
    result = examine(path, folder)
    name = result.path.name
    write_atomically(folder / f"{name}.look.png", lambda p: draw(result, p))
    target = folder / f"{name}.look.toml"
    if not target.exists():
        write_atomically(target, lambda p: p.write_text(result.campaign, encoding="utf-8"))
    return result
