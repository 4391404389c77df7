"""Which campaigns to doubt: those that were refused or had faults, those that warn, and those that lie far off.

A value lies far off when it differs from the other measurements of the same mode of the same machine by more than 5
robust standard deviations (the modified z score of Iglewicz and Hoaglin, How to Detect and Handle Outliers, 1993; they
take 3.5 for a single sample, and here thousands of values are asked at once):
``|x - line| / max(1.4826 MAD, s)`` with x the logarithm of frequency, damping or amplitude, the line of Theil and Sen
over time where dates are known (a drift is no outlier), else the median, and s the value's own standard deviation.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd
from scipy import stats

from process.types import Real
from smfe.fleet.tracks import QUANTITIES, Mode

FAR = 5.0
"""Modified z score beyond which a value lies far off."""

FEWEST = 5
"""Measurements of a mode below which none can be said to lie far off."""


_UNITS = {"frequency": "Hz", "damping": "", "amplitude": "um/N"}


def scores(mode: Mode, quantity: str) -> Real:
    """Return the modified z score of each measurement of a mode, signed; NaN of fewer than `FEWEST`."""
    x, years = np.log(mode.values(quantity)), mode.years
    if x.size < FEWEST:
        return np.full(x.size, np.nan)
    if np.isfinite(years).all() and np.unique(years).size >= FEWEST:
        slope, cut, *_ = stats.theilslopes(x, years)
        rest = x - (cut + slope * years)
        rest -= np.median(rest)
    else:
        rest = x - np.median(x)
    own = np.nan_to_num(mode.errors(quantity) / mode.values(quantity))
    scale = np.maximum(1.4826 * float(np.median(np.abs(rest))), own)
    return np.asarray(rest / np.where(scale > 0.0, scale, np.inf))


def doubt_table(rows: pd.DataFrame, modes: Sequence[Mode]) -> pd.DataFrame:
    """Return the campaigns to doubt, the most doubtful first: campaign, machine, date, reasons, how many of each.

    Refused ones come first, then by how far off their worst value lies, by faults and failures, and by warnings;
    campaigns without any are left out.
    """
    campaigns = rows[rows["kind"] == "campaign"].set_index("campaign")
    far: dict[str, list[str]] = {}
    worst: dict[str, float] = {}
    for name, score, text in _far_off(modes):
        far.setdefault(name, []).append(text)
        worst[name] = max(worst.get(name, 0.0), score)
    table = campaigns.reset_index()[["campaign", "machine", "date", "verdict"]].copy()
    of_kind = rows.groupby(["campaign", "kind"]).size().unstack(fill_value=0)
    faults = rows[(rows["kind"] == "suspicion") & (rows["level"] == "fault")].groupby("campaign").size()

    def count(kind: str) -> pd.Series[int]:
        found = of_kind[kind] if kind in of_kind.columns else pd.Series(dtype=int)
        return table["campaign"].map(found).fillna(0).astype(int)

    table["far_off"] = table["campaign"].map({n: len(t) for n, t in far.items()}).fillna(0).astype(int)
    table["worst_score"] = table["campaign"].map(worst).fillna(0.0)
    table["faults"] = table["campaign"].map(faults).fillna(0).astype(int) + count("failure")
    table["warnings"] = count("warning")
    table["why"] = ["; ".join(far.get(name, ())) for name in table["campaign"]]
    refused = table["verdict"] == "refused"
    table.loc[refused, "why"] = [str(text or "") for text in campaigns.loc[refused.to_numpy(), "text"]]
    kept = table[refused | (table[["far_off", "faults", "warnings"]].sum(axis=1) > 0)]
    order = kept.assign(_refused=refused).sort_values(
        ["_refused", "worst_score", "faults", "warnings", "campaign"], ascending=[False, False, False, False, True]
    )
    return order.drop(columns="_refused").reset_index(drop=True)


def _far_off(modes: Sequence[Mode]) -> Iterator[tuple[str, float, str]]:
    for mode in modes:
        for quantity in QUANTITIES:
            z = scores(mode, quantity)
            for i in np.flatnonzero(np.abs(z) > FAR):
                side = "above" if z[i] > 0.0 else "below"
                value = f"{quantity} {mode.values(quantity)[i]:.4g} {_UNITS[quantity]}".strip()
                text = f"{mode.entry}, mode {mode.number}: {value}, {abs(z[i]):.1f} deviations {side} the others"
                yield str(mode.rows["campaign"].iloc[i]), float(abs(z[i])), text
