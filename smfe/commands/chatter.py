"""`smfe chatter`: one record of a cut, judged by the spectral criterion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from process.units import parse
from smfe.campaign import load_channels
from smfe.records import Channel, read_records
from smfe.records.guess import default_channels
from stability import ChatterVerdict, chatter_verdict
from stability.chatter.criterion import FREQUENCY_RANGE


def chatter(
    record: Path | str,
    speed: str | None,
    teeth: int,
    campaign: Path | str | None = None,
    *,
    quantity: str | None = None,
    interval: tuple[float, float] | None = None,
    axes: Sequence[str] | None = None,
    frequency_range: tuple[float, float] | None = None,
    floor: float | None = None,
    half_order_reference: float | None = None,
) -> ChatterVerdict:
    """Judge one record of a cut by the spectral criterion.

    Parameters
    ----------
    record : path
        File of the record.
    speed : str or None
        Spindle speed with its unit, "500 rpm"; None: what the record states or its lines give away.
    teeth : int
        Number of teeth.
    campaign : path, optional
        Campaign file whose [channels] tell the columns; default: those of `DEFAULT_CHANNELS` that the file has, and the
        first channel of a WAV file as sound.
    quantity, interval, axes, frequency_range, floor, half_order_reference
        As of `stability.chatter_verdict`.

    Raises
    ------
    InputError
        For a record that cannot be read or judged; where no column is known, the columns of the file are listed.
    """
    rotation = None if speed is None else parse(speed, "rotation")
    path = Path(record)
    if campaign is not None:
        records = read_records(path, load_channels(Path(campaign)))
    elif path.suffix.lower() == ".wav":
        # Shares of full scale: how many Pa that is does not matter to a ratio.
        records = read_records(path, {"sound": Channel(1, "Pa")})
    else:
        records = read_records(path, default_channels(path))
    return chatter_verdict(
        records[0],
        rotation,
        teeth,
        quantity=quantity,
        axes=axes,
        frequency_range=frequency_range or FREQUENCY_RANGE,
        floor=floor,
        interval=interval,
        half_order_reference=half_order_reference,
    )
