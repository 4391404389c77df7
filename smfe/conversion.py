"""Files of records to other formats: what a recorder wrote -> NetCDF, CSV, MAT or a universal file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import xarray as xr

from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.identification import Progress, silent
from smfe.pipeline import read_default_channels
from smfe.records import (
    own_layout,
    read_blocks,
    read_records,
    write_pieces_csv,
    write_pieces_netcdf,
    write_record_mat,
    write_record_uff,
)

PIECEWISE: dict[str, Callable[[Iterable[xr.Dataset], Path], Path]] = {
    ".nc": write_pieces_netcdf,
    ".csv": lambda pieces, path: write_pieces_csv(pieces, path, digits=17),
}
"""Suffix -> what writes a record piece by piece."""

WHOLE: dict[str, Callable[[xr.Dataset, Path], Path]] = {
    ".mat": write_record_mat,
    ".uff": write_record_uff,
    ".unv": write_record_uff,
}
"""Suffix -> what writes a record that is in memory."""


def convert(
    source: str | Path, target: str | Path, campaign: str | Path | None = None, progress: Progress = silent
) -> list[Path]:
    """Write the records of a file in another format, in SI units and with the corrections of its channels.

    A record of one segment goes to NetCDF and CSV piece by piece, however long it is.

    Parameters
    ----------
    source : path
        A file that `read_records` reads.
    target : path
        File to write: .nc, .csv, .mat, .uff or .unv. Of several segments each gets a file, with ``_0``, ``_1``, ...
        before the suffix.
    campaign : path, optional
        Campaign file whose [channels] tell the columns; default: `smfe.pipeline.DEFAULT_CHANNELS`. A NetCDF file in our
        own layout needs none.
    progress : callable, optional
        Called with (what, done, of).

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        For a suffix that is not written, a target that is the source, or anything wrong with the source.
    """
    source, target = Path(source), Path(target)
    suffix = target.suffix.lower()
    if suffix not in PIECEWISE | WHOLE:
        raise InputError(
            f"{target.name}: files with suffix '{target.suffix}' are not written; known are "
            f"{', '.join(PIECEWISE | WHOLE)}"
        )
    if target.exists() and source.exists() and target.samefile(source):
        raise InputError(f"{target.name}: the source itself would be overwritten; name another file")
    channels = {} if campaign is None else load_campaign(Path(campaign)).channels
    if suffix in PIECEWISE and (_one_segment(source) if channels else _own_layout(source)):
        return [PIECEWISE[suffix](_told(read_blocks(source, channels), source, progress), target)]
    records = read_records(source, channels) if channels else read_default_channels(source)
    written = []
    for number, record in enumerate(records):
        progress(f"writing {target.name}", number, len(records))
        name = target if len(records) == 1 else target.with_stem(f"{target.stem}_{number}")
        written.append(PIECEWISE[suffix]([record], name) if suffix in PIECEWISE else WHOLE[suffix](record, name))
    return written


def _one_segment(source: Path) -> bool:
    """Whether the format holds one segment a file, and a long one need not be read at once."""
    return source.suffix.lower() not in (".lvm", ".uff", ".unv")


def _own_layout(source: Path) -> bool:
    """Whether a file says itself which channels it holds."""
    return source.suffix.lower() in (".nc", ".h5", ".hdf5") and source.is_file() and own_layout(source)


def _told(pieces: Iterator[xr.Dataset], source: Path, progress: Progress) -> Iterator[xr.Dataset]:
    """Pass pieces on and tell how far they are; how many will come is not known."""
    for number, piece in enumerate(pieces):
        progress(f"converting {source.name}", number, number + 1)
        yield piece
