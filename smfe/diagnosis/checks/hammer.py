"""Audit of hammer hits: what was left out, what it would have done, whether the hits agree, whether they drift."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from smfe.diagnosis.checks.suspect import Suspect
from smfe.identification.errors.result import Identification
from smfe.identification.hammer.hammer import identify_hammer
from smfe.identification.spectra.spectra import record_source

_SPREAD = 0.1
_CLEAR = 3.0


def hit_suspects(
    name: str,
    records: Mapping[str, Sequence[xr.Dataset]],
    found: Identification | None = None,
    **settings: object,
) -> list[Suspect]:
    """Return what is suspicious in a hammer measurement.

    Parameters
    ----------
    name : str
        Measurement.
    records : mapping of str to sequence of xarray.Dataset
        Excitation axis -> records.
    found : Identification, optional
        What was identified from these records with these settings.
    **settings : object
        Of `smfe.identification.hammer.hammer.identify_hammer`, but for ``exclude``.
    """
    if found is None:
        found = identify_hammer(name, records, **settings)  # type: ignore[arg-type]
    hits = found.tables["hits"]
    out = []
    # Read back from a file, a column without a reason holds numbers.
    given = np.array([isinstance(reason, str) and reason != "" for reason in hits["reason"]], dtype=bool)
    for _, hit in hits[given].iterrows():
        out.append(_left_out(name, hit, records, found.compliance, settings))
    out += _levels(name, hits[~given])
    out += _scatter(name, found.compliance)
    return out


def _left_out(
    name: str,
    hit: pd.Series,
    records: Mapping[str, Sequence[xr.Dataset]],
    good: xr.Dataset,
    settings: Mapping[str, object],
) -> Suspect:
    """A hit that was refused, with what it alone would have made of the compliance."""
    double, overloaded = bool(hit["double_hit"]), bool(hit["overloaded"]) or bool(hit["response_overloaded"])
    cause = "saturation" if overloaded else "double_hit" if double else "windowed_channel"
    if bool(hit["wrong_direction"]):
        cause = "sensor_axis"
    harm = _harm(hit, records, good, settings)
    return Suspect(
        cause,
        "warning",
        f"{name}, {hit['file']}, hit {hit['hit']}",
        f"{hit['reason']}{harm}",
        "it was left out; hit again if few are left",
    )


def _harm(
    hit: pd.Series,
    records: Mapping[str, Sequence[xr.Dataset]],
    good: xr.Dataset,
    settings: Mapping[str, object],
) -> str:
    """Say how the compliance of this hit alone compares with that of the good ones."""
    axis = str(hit["excitation"])
    group = [r for i, r in enumerate(records[axis]) if record_source(r, i) == hit["file"]]
    if len(group) != 1:
        return ""
    try:
        alone = identify_hammer("hit", {axis: group}, exclude=(), **settings)  # type: ignore[arg-type]
    except InputError:
        return ""
    f, own = good["frequency"].values, alone.compliance["frequency"].values
    both = (f >= own[0]) & (f <= own[-1])
    if np.count_nonzero(both) < 5 or len(alone.tables["hits"]) != 1:
        return ""
    ratios = []
    for response in good["response"].values:
        pick = {"response": response, "excitation": axis}
        one = np.interp(f[both], own, np.abs(alone.compliance["compliance"].sel(pick).values))
        ratios.append(one / np.abs(good["compliance"].sel(pick).values[both]))
    ratio = np.concatenate(ratios)
    low, high = np.nanpercentile(ratio, [10.0, 90.0])
    return f"; alone it would have given {low:.2g} to {high:.2g} times the compliance of the good hits"


def _levels(name: str, hits: pd.DataFrame) -> list[Suspect]:
    out = []
    for axis, group in hits.groupby("excitation"):
        peaks = np.abs(group["peak_force_N"].to_numpy(dtype=float))
        if peaks.size >= 2 and peaks.max() > 3.0 * peaks.min():
            out.append(
                Suspect(
                    "joint_micro_slip",
                    "note",
                    f"{name}, hits along {axis}",
                    f"peak forces from {peaks.min():.3g} to {peaks.max():.3g} N are averaged together",
                    "with friction or micro-slip the level changes the compliance: identify weak and strong hits "
                    "apart (split_levels = true)",
                )
            )
    return out


def _scatter(name: str, compliance: xr.Dataset) -> list[Suspect]:
    if "compliance_std" not in compliance:
        return []
    out = []
    for axis in compliance["excitation"].values:
        if axis not in compliance["response"].values:
            continue
        phi = np.abs(compliance["compliance"].sel(response=axis, excitation=axis).values)
        std = compliance["compliance_std"].sel(response=axis, excitation=axis).values
        # The lowest lines of a doubly integrated acceleration are the largest compliances, and noise: peaks of the
        # accelerance are peaks of the machine.
        clear, moved = phi > _CLEAR * std, phi * compliance["frequency"].values ** 2
        relative = (std / phi)[clear & (moved > 0.5 * np.max(moved[clear], initial=0.0))]
        spread = float(np.median(relative)) if relative.size else float("nan")
        if spread > _SPREAD:
            out.append(
                Suspect(
                    "drift",
                    "warning",
                    f"{name}, {axis}{axis}",
                    f"hits repeat only to {100.0 * spread:.0f} % at the peak (one standard deviation of the mean)",
                    "more hits; if force levels differ, identify them apart; look for a loose joint",
                )
            )
    return out
