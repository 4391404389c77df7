"""Files of records to other formats: what a recorder wrote -> NetCDF, CSV, MAT or a universal file."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import xarray as xr

from process.errors import InputError
from process.labels import check_record
from smfe.campaign import Campaign, load_channels
from smfe.progress import Progress, silent, warn
from smfe.records import (
    Channel,
    column_names,
    names_itself,
    read_blocks,
    read_records,
    write_pieces_csv,
    write_pieces_netcdf,
    write_record_mat,
    write_record_uff,
)
from smfe.records.formats.channels import listed
from smfe.records.guess import default_channels

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


def _warned(text: str) -> None:
    warn([text])


def convert(
    source: str | Path | xr.Dataset | Sequence[xr.Dataset],
    target: str | Path,
    campaign: str | Path | Campaign | None = None,
    progress: Progress = silent,
    say: Callable[[str], None] = _warned,
) -> list[Path]:
    """Write the records of a file in another format, in SI units and with the corrections of its channels.

    A record of one segment goes to NetCDF and CSV piece by piece, however long it is.

    Parameters
    ----------
    source : path, xarray.Dataset or sequence of xarray.Dataset
        A file that `read_records` reads, or records in memory.
    target : path
        File to write: .nc, .csv, .mat, .uff or .unv. Of several segments each gets a file, with ``_0``, ``_1``, ...
        before the suffix.
    campaign : path or Campaign, optional
        Campaign whose [channels] say which column is which; default: `guess.DEFAULT_CHANNELS`. A NetCDF
        file in our own layout needs none.
    progress : callable, optional
        Called with (what, done, of).
    say : callable, optional
        Called with a sentence for what is left out of the target: columns of the source that are no channel. Default:
        it is warned of, as a `SmfeWarning`.

    Returns
    -------
    list of Path
        What was written.

    Raises
    ------
    InputError
        For a suffix that is not written, a target that is the source, or anything wrong with the source.
    """
    target = Path(target)
    suffix = target.suffix.lower()
    if suffix not in PIECEWISE | WHOLE:
        raise InputError(
            f"{target.name}: files with suffix '{target.suffix}' are not written; known are "
            f"{', '.join(PIECEWISE | WHOLE)}"
        )
    if not isinstance(source, str | Path):
        return _written([source] if isinstance(source, xr.Dataset) else source, target, progress, say)
    source = Path(source)
    if target.exists() and source.exists() and target.samefile(source):
        raise InputError(f"{target.name}: the source itself would be overwritten; name another file")
    channels, name = _channels(source, campaign)
    if campaign is not None and not channels and not names_itself(source):
        raise InputError(f"{name}: it declares no [channels]; say there which column is which")
    if left := _left_out(source, channels):
        say(left)
    if suffix in PIECEWISE and _one_segment(source):
        return [PIECEWISE[suffix](_counted(_noted(read_blocks(source, channels), say), source, progress), target)]
    return _written(read_records(source, channels), target, progress, say)


def _channels(source: Path, campaign: str | Path | Campaign | None) -> tuple[Mapping[str, Channel], str]:
    """Return the channels of a file, and the name of the campaign that declares them."""
    if campaign is None:
        return default_channels(source), ""
    if isinstance(campaign, Campaign):
        return campaign.channels, campaign.path.name
    return load_channels(Path(campaign)), Path(campaign).name


def _written(records: Sequence[xr.Dataset], target: Path, progress: Progress, say: Callable[[str], None]) -> list[Path]:
    """Write records in memory, each to a file."""
    for record in records:
        _note(check_record(record), say)
    written = []
    suffix = target.suffix.lower()
    for number, record in enumerate(records):
        progress(f"writing {target.name}", number, len(records))
        name = target if len(records) == 1 else target.with_stem(f"{target.stem}_{number}")
        written.append(PIECEWISE[suffix]([record], name) if suffix in PIECEWISE else WHOLE[suffix](record, name))
    return written


def _one_segment(source: Path) -> bool:
    """Whether the format holds one segment a file, and a long one need not be read at once."""
    return source.suffix.lower() not in (".lvm", ".uff", ".unv")


def _left_out(source: Path, channels: Mapping[str, Channel]) -> str:
    """Return the sentence that names the columns which no channel stands in; nothing where there is none."""
    if not channels or names_itself(source):
        return ""
    names = column_names(source)
    used = {channel.column for channel in channels.values()}
    # A TDMS channel may be called by its name without that of its group.
    left = [n for k, n in enumerate(names, 1) if not {n, k, str(n).rpartition("/")[2]} & used]
    if not left:
        return ""
    return (
        f"{source.name}: {len(left)} of {len(names)} columns are left out because they are no channel: {listed(left)}; "
        "declare those that are needed in the [channels] of a campaign file and name it with --campaign"
    )


def _note(record: xr.Dataset, say: Callable[[str], None]) -> None:
    for line in record.attrs.get("notes", "").splitlines():
        say(line)


def _noted(pieces: Iterator[xr.Dataset], say: Callable[[str], None]) -> Iterator[xr.Dataset]:
    """Pass pieces on, and say what was noticed while the first was read."""
    for number, piece in enumerate(pieces):
        if number == 0:
            _note(piece, say)
        yield piece


def _counted(pieces: Iterator[xr.Dataset], source: Path, progress: Progress) -> Iterator[xr.Dataset]:
    """Pass pieces on and say how far they are; how many will come is not known."""
    for number, piece in enumerate(pieces):
        progress(f"converting {source.name}", number, number + 1)
        yield piece
