"""`smfe chatter`: one record of a cut, judged by the spectral criterion."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.errors import InputError
from process.units import parse
from smfe.arrays.records import record as make
from smfe.campaign import Campaign, load_channels
from smfe.progress import warn
from smfe.records import Channel, read_records
from smfe.records.guess import default_channels
from stability import ChatterVerdict, chatter_verdict
from stability.chatter.criterion import FREQUENCY_RANGE, QUANTITIES


def chatter(
    record: Path | str | xr.Dataset | ArrayLike,
    speed: float | str | None,
    teeth: int,
    campaign: Path | str | Campaign | None = None,
    *,
    sample_rate: float | str | None = None,
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
    record : path, xarray.Dataset, or array_like of shape (n,)
        File of the record; a record as of `smfe.record`; or samples of one sensor, with `sample_rate`.
    speed : float, str or None
        Spindle speed [rpm], or text with its unit, "500 rpm"; None: what the record states or its lines give away.
    teeth : int
        Number of teeth.
    campaign : path or Campaign, optional
        Campaign whose [channels] tell the columns of a file; default: those of `DEFAULT_CHANNELS` that the file has,
        and the first channel of a WAV file as sound.
    sample_rate : float or str, optional
        Of samples [Hz].
    quantity : str, optional
        As of `stability.chatter_verdict`. Samples are taken for sound, of which the unit does not matter, unless it is
        given.
    interval, axes, frequency_range, floor, half_order_reference
        As of `stability.chatter_verdict`.

    Returns
    -------
    ChatterVerdict
        Verdict with its reason, spectrum and spectrogram.

    Raises
    ------
    InputError
        For a record that cannot be read or judged; where no column is known, the columns of the file are listed.

    Warns
    -----
    SmfeWarning
        What else was noticed in the record (``ChatterVerdict.notes``).

    Examples
    --------
    >>> verdict = smfe.chatter(samples, 1200, 4, sample_rate=48000)
    """
    rotation = parse(speed, "rotation") if isinstance(speed, str) else None if speed is None else speed * math.pi / 30.0
    verdict = chatter_verdict(
        _record(record, campaign, sample_rate, quantity),
        rotation,
        teeth,
        quantity=quantity,
        axes=axes,
        frequency_range=frequency_range or FREQUENCY_RANGE,
        floor=floor,
        interval=interval,
        half_order_reference=half_order_reference,
    )
    warn(verdict.notes)
    return verdict


def _record(
    given: Path | str | xr.Dataset | ArrayLike,
    campaign: Path | str | Campaign | None,
    sample_rate: float | str | None,
    quantity: str | None,
) -> xr.Dataset:
    if isinstance(given, xr.Dataset):
        return given
    if not isinstance(given, Path | str):
        if quantity not in (None, *QUANTITIES):
            raise InputError(f"quantity '{quantity}' is not known; available: {', '.join(QUANTITIES)}")
        if sample_rate is None:
            raise InputError("samples need their sample_rate, e.g. sample_rate=48000")
        channel = "sound" if quantity in (None, "sound") else f"{quantity}_x"
        channels: dict[str, Any] = {channel: np.asarray(given)}
        return make(sample_rate, name="samples", **channels)
    path = Path(given)
    if isinstance(campaign, Campaign):
        return read_records(path, campaign.channels)[0]
    if campaign is not None:
        return read_records(path, load_channels(Path(campaign)))[0]
    if path.suffix.lower() == ".wav":
        # Shares of full scale: how many Pa that is does not matter to a ratio.
        return read_records(path, {"sound": Channel(1, "Pa")})[0]
    return read_records(path, default_channels(path))[0]
