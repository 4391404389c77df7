"""What the comparison of measurements says, in three sentences: who agrees, what differs most, and what explains it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np
import pandas as pd

from smfe.comparison.explained import JOINT, TIMES, WITH
from smfe.reporting.content.style import listed, number, spoken, with_spread
from smfe.reporting.content.tables import condition_text, true

NEEDED = ("measurement_a", "measurement_b", "response", "excitation", "match", "significant", "frequency_a_Hz")
"""Columns without which nothing is said."""

_QUANTITIES = ("frequency", "damping", "amplitude")

_FACTORS = {"level": "level", "added_mass": "added mass", "method": "method", "feed": "feed"}

_MANY = 10
"""Of more measurements the largest group that agrees is looked for among this many only."""


def sentences(frame: pd.DataFrame, explained: pd.DataFrame | None) -> list[str]:
    """Return what matters of comparison.csv and explained.csv.

    Parameters
    ----------
    frame : pandas.DataFrame
        Of `smfe.comparison.compare`.
    explained : pandas.DataFrame or None
        Of `smfe.comparison.explain`.

    Returns
    -------
    list of str
        Which measurements agree; the largest significant difference in percent and Hz; what explains it and what
        cannot be told apart. Empty where the columns of a comparison are not there.
    """
    if any(column not in frame for column in NEEDED):
        return []
    both = frame[frame["match"] == "both"]
    if both.empty:
        return []
    differs = both[_yes(both, "significant")]
    out = [_agreement(both, len(frame) - len(both))]
    if len(differs):
        largest = _largest(differs)
        out.append(largest[0])
        out.append(_cause(explained, largest[1], largest[2]))
    else:
        out.append(_smallest_seen(both))
        out.append(_design(explained))
    return [sentence for sentence in out if sentence]


def _yes(frame: pd.DataFrame, column: str) -> np.ndarray:
    if column not in frame:
        return np.zeros(len(frame), dtype=bool)
    return np.array([true(v) for v in frame[column]], dtype=bool)


def _agreement(both: pd.DataFrame, alone: int) -> str:
    """Return which measurements agree in all peaks that they share, and how many pairs were compared."""
    count = len(both)
    names = list(dict.fromkeys([*both["measurement_a"], *both["measurement_b"]]))
    apart = {frozenset(p) for p in both.loc[_yes(both, "significant"), ["measurement_a", "measurement_b"]].to_numpy()}
    compared = {frozenset(p) for p in both[["measurement_a", "measurement_b"]].to_numpy()}
    group = _largest_group(names, compared, apart)
    pairs = f"{count} pair{'s' if count > 1 else ''} of peaks"
    lonely = f" {alone} more {'was' if alone == 1 else 'were'} found in one of two measurements only." if alone else ""
    if not apart:
        which = "Both" if len(names) == 2 else "All"
        verb = f"{which} measurements agree ({listed(map(spoken, names))})"
        return f"{verb}: none of {pairs} differs significantly.{lonely}"
    significant = int(_yes(both, "significant").sum())
    tail = f"{significant} of {pairs} differ{'s' * (significant == 1)} significantly.{lonely}"
    if len(group) < 2:
        return f"No two measurements agree: {tail}"
    rest = [n for n in names if n not in group]
    return f"{listed(map(spoken, group))} agree; {listed(map(spoken, rest))} differ{'s' * (len(rest) == 1)}: {tail}"


def _largest_group(
    names: Sequence[str], compared: Iterable[frozenset[str]], apart: Iterable[frozenset[str]]
) -> list[str]:
    """Return the most measurements of which any two were compared and agree."""
    agree = set(compared) - set(apart)
    for size in range(min(len(names), _MANY), 1, -1):
        for group in combinations(names[:_MANY], size):
            if all(frozenset(pair) in agree for pair in combinations(group, 2)):
                return list(group)
    return []


def _largest(differs: pd.DataFrame) -> tuple[str, pd.Series, str]:
    """Return the sentence on the largest significant differences, the row of the first of them and its quantity."""
    parts, first = [], None
    for quantity in _QUANTITIES:
        column = f"{quantity}_difference_percent"
        if column not in differs:
            continue
        own = differs[_yes(differs, f"{quantity}_significant")]
        values = own[column].abs().to_numpy(dtype=float)
        if not np.isfinite(values).any():
            continue
        row = own.iloc[int(np.nanargmax(values))]
        first = first or (row, quantity)
        parts.append(f"{quantity} {_amount(row, quantity)} {_place(row)}")
    if first is None:
        row = differs.iloc[0]
        said = "No single quantity differs significantly; frequency, damping and amplitude together do"
        return f"{said} {_place(row)}.", row, JOINT
    return f"Largest significant differences: {'; '.join(parts)}.", *first


def _amount(row: pd.Series, quantity: str) -> str:
    """Return e.g. "−3.28 ± 0.33 % (−2.01 ± 0.20 Hz)"."""
    percent = float(row[f"{quantity}_difference_percent"])
    std = float(row.get(f"{quantity}_difference_std_percent", np.nan))
    text = f"{with_spread(percent, std)} %"
    if quantity != "frequency" or "frequency_b_Hz" not in row:
        return text
    one, other = float(row["frequency_a_Hz"]), float(row["frequency_b_Hz"])
    return f"{text} ({with_spread(other - one, std / 100.0 * one)} Hz)"


def _place(row: pd.Series) -> str:
    entry = f"{row['response']}{row['excitation']}"
    return (
        f"from {spoken(str(row['measurement_a']))} to {spoken(str(row['measurement_b']))} "
        f"(peak at {number(float(row['frequency_a_Hz']), 3)} Hz, entry {entry})"
    )


def _smallest_seen(both: pd.DataFrame) -> str:
    """Return how small a difference of frequency and amplitude would have been seen, where nothing differs."""
    parts = []
    for quantity in ("frequency", "amplitude"):
        column = f"{quantity}_difference_std_percent"
        known = both[column].to_numpy(dtype=float) if column in both else np.empty(0)
        known = known[np.isfinite(known)]
        if known.size:
            parts.append(f"{quantity} {number(1.96 * float(np.median(known)), 2)} %")
    return f"Half of the pairs would show a difference (95 %) of {listed(parts)}." if parts else ""


def _cause(explained: pd.DataFrame | None, row: pd.Series, quantity: str) -> str:
    """Return what explains a difference, or why that cannot be said."""
    rows = _rows_of(explained, row, quantity)
    if rows is None:
        return "What explains it cannot be said: no condition varies, or the peak is found in too few measurements."
    said = rows[_yes(rows, "significant")].sort_values("explained_percent", ascending=False)
    if said.empty:
        shares = rows["explained_percent"].to_numpy(dtype=float)
        most = ""
        if np.isfinite(shares).any():
            factor = str(rows["factor"].iloc[int(np.nanargmax(shares))])
            most = f" (most: {_factor(factor)}, {number(float(np.nanmax(shares)), 2)} %)"
        return f"No condition explains it significantly{most}. {_apart(rows['factor'])}".strip()
    parts = [_explains(found) for _, found in said.iterrows()]
    return f"{'; '.join(parts)}. {_apart(rows['factor'])}".strip()


def _rows_of(explained: pd.DataFrame | None, row: pd.Series, quantity: str) -> pd.DataFrame | None:
    """Return what was judged of the peak of a row, None where nothing was."""
    if explained is None or explained.empty or "factor" not in explained:
        return None
    entry = (explained["response"] == row["response"]) & (explained["excitation"] == row["excitation"])
    own = explained[entry & (explained["quantity"] == quantity)]
    if own.empty:
        return None
    apart = (own["frequency_Hz"].astype(float) / float(row["frequency_a_Hz"]) - 1.0).abs()
    nearest = own[np.isclose(apart, apart.min())]
    return nearest if float(apart.min()) < 0.2 else None


def _explains(row: pd.Series) -> str:
    """Return e.g. "Feed explains 93 % of it: −3.1 ± 0.3 % from 0 mm/min to 500 mm/min"."""
    share = number(float(row["explained_percent"]), 2)
    text = f"{_factor(row['factor']).capitalize()} explain{'' if WITH in str(row['factor']) else 's'} {share} % of it"
    effect = float(row.get("effect_percent", np.nan))
    if not np.isfinite(effect):
        return text
    ends = f"from {condition_text(str(row['lowest']))} to {condition_text(str(row['highest']))}"
    return f"{text}: {with_spread(effect, float(row.get('effect_std_percent', np.nan)))} % {ends}"


def _design(explained: pd.DataFrame | None) -> str:
    """Return which conditions vary for most peaks, and which of them nothing tells apart."""
    if explained is None or explained.empty or "factor" not in explained:
        return ""
    peak = [c for c in ("response", "excitation", "frequency_Hz") if c in explained]
    designs = [tuple(dict.fromkeys(map(str, rows["factor"]))) for _, rows in explained.groupby(peak, sort=False)]
    usual = Counter(designs).most_common(1)[0][0]
    single = [f for f in usual if TIMES not in f and WITH not in f]
    own = f"{listed(map(_factor, single)).capitalize()} can be judged alone." if single else ""
    return " ".join(part for part in (own, _apart(usual)) if part)


def _apart(factors: Iterable[object]) -> str:
    """Return which conditions always change together."""
    joined = dict.fromkeys(str(f) for f in factors if WITH in str(f) and TIMES not in str(f))
    return " ".join(
        f"{listed(map(_factor, f.split(WITH))).capitalize()} always change together: they cannot be separated."
        for f in joined
    )


def _factor(name: str) -> str:
    """Return a factor, or a product of two, in words."""
    parts = [listed(_FACTORS.get(f, f).replace("_", " ") for f in term.split(WITH)) for term in str(name).split(TIMES)]
    return " together with ".join(parts)
