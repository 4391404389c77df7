"""Compliances under several conditions as one array: force level, depth of cut and feed become dimensions.

A machine with friction, play or micro-slip has no compliance but one for each force level, and a moving axis one for
each feed. Hits of several levels in the same records are told apart by their peaks; whole measurements by what the
campaign says of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import UNITS
from smfe.campaign import Measurement
from smfe.error_factors import ENTRY
from smfe.hammer import identify_hammer
from smfe.hits import HitRules, find_hits, longest_block
from smfe.identification.errors.result import Identification

Real = NDArray[np.float64]

LEVEL_GAP = 1.6
"""Ratio of neighbouring peak forces from which they are two levels: a hand repeats a blow to a third or so."""

STACKED = (
    "compliance",
    "compliance_std",
    "compliance_relation",
    "degrees_of_freedom",
    "coherence",
    "force_condition",
)
"""Variables that are stacked; covariances stay with the single measurements."""

_SAME_FREQUENCY = 2e-4


def stack_conditions(compliances: Sequence[tuple[Mapping[str, float], xr.Dataset]]) -> xr.Dataset:
    """Stack compliances under several conditions.

    Parameters
    ----------
    compliances : sequence of (mapping, xarray.Dataset)
        Condition name (``force_level`` [N], ``feed`` [mm/min], ``depth_of_cut`` [mm]) -> value, the same names in all;
        and what was measured under it. Frequencies that differ by less than 0.02 % (or a quarter of the spacing) are
        one.

    Returns
    -------
    xarray.Dataset
        ``compliance`` and what else of `STACKED` all have, with a dimension a condition, its values rising; NaN for
        combinations that were not measured, and where one was measured at frequencies that another was not.

    Raises
    ------
    InputError
        Without compliances, with different condition names, or with the same conditions twice.
    """
    if not compliances:
        raise InputError("no compliances to stack; give at least one with its conditions")
    names = list(compliances[0][0])
    if not names or any(set(given) != set(names) for given, _ in compliances):
        raise InputError(
            "the compliances to stack have different conditions; give each the same ones, e.g. force_level"
        )
    axes = [sorted({float(given[name]) for given, _ in compliances}) for name in names]
    places = [
        tuple(axis.index(float(given[n])) for n, axis in zip(names, axes, strict=True)) for given, _ in compliances
    ]
    if len(set(places)) < len(places):
        twice = next(given for (given, _), at in zip(compliances, places, strict=True) if places.count(at) > 1)
        said = ", ".join(f"{name} {value:g}" for name, value in twice.items())
        raise InputError(f"two of the compliances to stack have the same conditions ({said}); average or leave out one")
    datasets = [dataset for _, dataset in compliances]
    frequency, lines = _shared_frequencies([d["frequency"].values for d in datasets])
    labels = {
        name: [a for a in "xyz" if any(a in d[name].values for d in datasets)] for name in ("response", "excitation")
    }
    coords: dict[str, Any] = dict(zip(names, axes, strict=True))
    coords |= {"frequency": frequency, **labels}
    data = {}
    for variable in (v for v in STACKED if all(v in d for d in datasets)):
        # A multiple coherence belongs to a response, the condition of the forces to neither.
        own = tuple(dim for dim in ENTRY if dim in datasets[0][variable].dims)
        values = np.full([len(coords[name]) for name in (*names, *own)], np.nan, dtype=datasets[0][variable].dtype)
        for at, line, dataset in zip(places, lines, datasets, strict=True):
            part = dataset[variable].transpose(*own)
            values[at][line] = part.reindex({dim: labels[dim] for dim in own[1:]}).values
        data[variable] = ((*names, *own), values, {"units": UNITS[variable]})
    out = xr.Dataset(data, coords=coords)
    for name in (*names, "frequency"):
        out[name].attrs["units"] = UNITS.get(name, "1")
    return out


def _shared_frequencies(axes: Sequence[Real]) -> tuple[Real, list[NDArray[np.intp]]]:
    """Return the union of frequency axes, and where the lines of each are in it."""
    together = np.sort(np.concatenate(axes))
    spacing = min((float(np.diff(a).min()) for a in axes if a.size > 1), default=np.inf)
    limit = np.minimum(_SAME_FREQUENCY * together[1:], 0.25 * spacing)
    group = np.concatenate([[0], np.cumsum(np.diff(together) > limit)]).astype(int)
    frequency = np.bincount(group, together) / np.bincount(group)
    return frequency, [np.abs(a[:, None] - frequency[None, :]).argmin(axis=1) for a in axes]


# --- levels in the records of one measurement ----------------------------------------------------------------------


def force_levels(peaks: Iterable[float], gap: float = LEVEL_GAP) -> list[tuple[float, float]]:
    """Return the levels among peak forces: lowest and highest peak of each, rising [N].

    Parameters
    ----------
    peaks : iterable of float
        Peak forces [N]; their sign does not count.
    gap : float, optional
        Ratio of two neighbours from which they belong to different levels.
    """
    size = np.sort(np.abs(np.fromiter(peaks, dtype=float)))
    cuts = np.flatnonzero(size[1:] > gap * size[:-1]) + 1
    return [(float(part[0]), float(part[-1])) for part in np.split(size, cuts) if part.size]


def hammer_levels(
    name: str, records: Mapping[str, Sequence[xr.Dataset]], *, gap: float = LEVEL_GAP, **settings: Any
) -> Identification:
    """Identify the compliance at each force level of hammer hits.

    Parameters
    ----------
    name : str
        Name of the measurement.
    records : mapping of str to sequence of xarray.Dataset
        Excitation axis -> records with hits of several levels, in any order.
    gap : float, optional
        Ratio of two neighbouring peaks from which they belong to different levels.
    **settings
        Of `smfe.hammer.identify_hammer`.

    Returns
    -------
    Identification
        ``compliance(force_level, frequency, response, excitation)``, the level being the median peak of its hits [N];
        table "hits" with a column level_N, table "levels".

    Raises
    ------
    InputError
        As `smfe.hammer.identify_hammer`; with the level in the sentence.
    """
    rules: HitRules = settings.pop("rules", None) or HitRules()
    hits = [h for axis, group in records.items() for i, r in enumerate(group) for h in find_hits(r, axis, i, rules)]
    levels = force_levels((h.peak_force for h in hits), gap)
    settings.setdefault("resolution", 1.0 / longest_block(hits))
    parts, tables, notes, rows = [], [], [], []
    for low, high in levels:
        only = replace(rules, peak_range=(low * (1.0 - 1e-9), high * (1.0 + 1e-9)))
        found = identify_hammer(f"{name}, {low:.4g} to {high:.4g} N", records, rules=only, **settings)
        table = found.tables["hits"]
        peaks = table["peak_force_N"].abs()
        table = table[peaks.between(low, high)]
        level = float(f"{table.loc[table['used'], 'peak_force_N'].abs().median():.3g}")
        parts.append(({"force_level": level}, found.compliance))
        tables.append(table.assign(level_N=level))
        rows.append({"force_level_N": level, "from_N": low, "to_N": high, "hits": int(table["used"].sum())})
        notes += [f"{level:g} N: {note}" for note in found.warnings if "outside the level" not in note]
    hit_table = pd.concat(tables).sort_values(["excitation", "file", "hit"], ignore_index=True)
    return Identification(
        name, "hammer", stack_conditions(parts), {"hits": hit_table, "levels": pd.DataFrame(rows)}, tuple(notes)
    )


def by_level(
    found: Mapping[float, Identification] | Mapping[float, Callable[[], Identification]],
) -> xr.Dataset:
    """Stack identifications by their force level [N]."""
    whole = {level: item() if callable(item) else item for level, item in found.items()}
    return stack_conditions([({"force_level": level}, item.compliance) for level, item in whole.items()])


# --- levels and feeds of a campaign --------------------------------------------------------------------------------


def condition_cubes(
    measurements: Sequence[Measurement], compliances: Mapping[str, xr.Dataset]
) -> tuple[dict[str, xr.Dataset], list[str]]:
    """Stack the measurements of a campaign that differ in level or feed and in nothing else.

    Parameters
    ----------
    measurements : sequence of Measurement
        As the campaign declares them.
    compliances : mapping of str to xarray.Dataset
        Name of a measurement -> what was identified.

    Returns
    -------
    cubes : dict
        "hammer, controller K2" and so on -> compliance with the dimensions ``force_level`` [N], ``depth_of_cut`` [mm]
        (sweep) and ``feed`` [mm/min], of those that its measurements declare and that differ. Measurements that declare
        different ones are not mixed.
    notes : list of str
        Groups that cannot be stacked, and why.
    """
    groups: dict[tuple[str, tuple[str, ...]], list[Measurement]] = {}
    for m in measurements:
        if m.name in compliances and m.method in ("hammer", "actuator", "sweep"):
            groups.setdefault((_group(m), tuple(_numbers(m))), []).append(m)
    cubes, notes = {}, []
    for (name, declared), members in groups.items():
        given = [_numbers(m) for m in members]
        varied = [key for key in declared if len({g[key] for g in given}) > 1]
        if not varied:
            continue
        name = f"{name}, over {' and '.join(varied)}" if name in cubes else name
        try:
            parts = [
                ({key: g[key] for key in varied}, compliances[m.name]) for g, m in zip(given, members, strict=True)
            ]
            cubes[name] = stack_conditions(parts)
        except InputError as error:
            notes.append(f"{name}: not stacked over {' and '.join(varied)}: {error}")
    return cubes, notes


def _group(m: Measurement) -> str:
    """Return what must be the same: everything but level and feed."""
    parts = {
        "controller": m.controller,
        "position": m.position,
        "added mass": m.added_mass or None,
        "repeat": m.repeat,
    }
    if m.method == "sweep":
        parts |= {"estimator": m.estimator, "references": None if m.references == "all" else m.references}
    said = [m.method, *(f"{name} {value}" for name, value in parts.items() if value is not None)]
    return ", ".join(said).replace("/", " per ")


def _numbers(m: Measurement) -> dict[str, float]:
    """Return level [N or mm] and feed [mm/min] where they are one number; several axes must agree."""
    out = {} if m.force_level is None else {"force_level": float(m.force_level)}
    if m.method == "sweep" and m.depth_of_cut is not None:
        out["depth_of_cut"] = round(1e3 * m.depth_of_cut, 6)
    if m.feed is not None:
        moving = {round(v * 6e4, 6) for v in m.feed.values() if v != 0.0}
        if len(moving) <= 1:
            out["feed"] = next(iter(moving), 0.0)
    return out
