"""Checks of hammer hits: which were left out, what they would have done, whether the others agree and repeat."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from smfe.diagnosis.checks.compliances import driving_points, entry
from smfe.diagnosis.checks.rules import RULES
from smfe.diagnosis.checks.suspect import Suspect, note, warning
from smfe.identification.errors.result import Identification
from smfe.identification.hammer.direction import UNLIKE
from smfe.identification.hammer.hammer import identify_hammer
from smfe.identification.spectra.spectra import record_source


def hit_suspects(
    name: str, records: Mapping[str, Sequence[xr.Dataset]], found: Identification, **settings: object
) -> Iterator[Suspect]:
    """Yield what is suspicious in a hammer measurement.

    `records` (excitation axis -> records) were identified as `found`, with `settings` of `identify_hammer`.
    """
    hits = found.tables["hits"]
    # Read back from a file, a column without a reason holds numbers.
    refused = np.array([isinstance(reason, str) and reason != "" for reason in hits["reason"]], dtype=bool)
    for _, hit in hits[refused].iterrows():
        overloaded = bool(hit["overloaded"]) or bool(hit["response_overloaded"])
        # A hit that is like none along any axis may be one from elsewhere, or one that broke a guideway away otherwise.
        level = note if str(hit["reason"]).startswith(UNLIKE) else warning
        cause = "saturation" if overloaded else "double_hit" if bool(hit["double_hit"]) else "windowed_channel"
        yield level(
            "sensor_axis" if bool(hit["wrong_direction"]) else cause,
            f"{name}, {hit['file']}, hit {hit['hit']}",
            f"{hit['reason']}{_harm(hit, records, found.compliance, settings)}",
            "it was left out; hit again if few are left",
        )
    for axis, group in hits[~refused].groupby("excitation"):
        peaks = np.abs(group["peak_force_N"].to_numpy(dtype=float))
        if peaks.size >= 2 and peaks.max() > RULES.hit_levels * peaks.min():
            yield note(
                "joint_micro_slip",
                f"{name}, hits along {axis}",
                f"peak forces from {peaks.min():.3g} to {peaks.max():.3g} N are averaged together",
                "with friction or micro-slip the level changes the compliance: identify weak and strong hits apart "
                "(split_levels = true)",
            )
    for axis in driving_points(found.compliance) if "compliance_std" in found.compliance else ():
        phi = np.abs(entry(found.compliance, axis, axis)[0])
        std = found.compliance["compliance_std"].sel(response=axis, excitation=axis).values
        # The lowest lines of a doubly integrated acceleration are the largest compliances, and noise: peaks of the
        # accelerance are peaks of the machine.
        clear, moved = phi > RULES.clear_hits * std, phi * found.compliance["frequency"].values ** 2
        relative = (std / phi)[clear & (moved > 0.5 * np.max(moved[clear], initial=0.0))]
        spread = float(np.median(relative)) if relative.size else 0.0
        if spread > RULES.hit_scatter:
            # Hits at rest break a guideway away, each by another level: that is the machine, and the scatter counts.
            yield (warning if spread > RULES.wild_scatter else note)(
                "drift",
                f"{name}, {axis}{axis}",
                f"hits repeat only to {100.0 * spread:.0f} % at the peak (one standard deviation of the mean)",
                "more hits; if force levels differ, identify them apart; look for a loose joint",
            )


def _harm(
    hit: pd.Series, records: Mapping[str, Sequence[xr.Dataset]], good: xr.Dataset, settings: Mapping[str, object]
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
    pairs = [[np.abs(entry(c, str(r), axis)[0]) for c in (alone.compliance, good)] for r in good["response"].values]
    ratio = np.concatenate([np.interp(f[both], own, one) / mean[both] for one, mean in pairs])
    low, high = np.nanpercentile(ratio, [10.0, 90.0])
    return f"; alone it would have given {low:.2g} to {high:.2g} times the compliance of the good hits"
