"""Compliances under several conditions as one array: force level, depth of cut and feed become dimensions.

A machine with friction, play or micro-slip has no compliance but one for each force level, and a moving axis one for
each feed; the depths of cut of a sweep are its force levels. Hits of several levels in the same records are separated
by their peaks, whole measurements by what the campaign says of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.labels import UNITS
from process.types import Real
from smfe.campaign import Campaign, Measurement
from smfe.campaign.checks import level_name, rounded
from smfe.comparison.explained import holm
from smfe.identification.errors.covariance import ENTRY
from smfe.identification.errors.difference import difference_of
from smfe.identification.errors.result import Identification
from smfe.identification.hammer.hammer import identify_hammer
from smfe.identification.hammer.impacts import HitRules, find_hits, longest_block
from smfe.identification.sweep.passes import SweepPass
from smfe.identification.sweep.sweep import identify_sweep

LEVEL_GAP = 1.6
"""Ratio of neighbouring peak forces from which they are two levels: a hand repeats a hit to a third or so."""

STACKED = (
    "compliance",
    "compliance_std",
    "compliance_relation",
    "degrees_of_freedom",
    "coherence",
    "force_condition",
)
"""Variables that are stacked; covariances stay with the single measurements."""

BY_LEVEL = "by level"
"""Behind the name of a measurement: all its levels as one array."""

SIGNIFICANT = 0.01
"""Corrected p-value below which two levels differ."""

_SAME_FREQUENCY = 2e-4
"""Relative difference of two frequencies up to which they are one."""


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


def force_levels(peaks: Iterable[float]) -> list[tuple[float, float]]:
    """Return the levels among peak forces: lowest and highest peak of each, rising [N].

    Parameters
    ----------
    peaks : iterable of float
        Peak forces [N]; their sign does not count. Neighbours with a ratio above `LEVEL_GAP` are two levels.
    """
    size = np.sort(np.abs(np.fromiter(peaks, dtype=float)))
    cuts = np.flatnonzero(size[1:] > LEVEL_GAP * size[:-1]) + 1
    return [(float(part[0]), float(part[-1])) for part in np.split(size, cuts) if part.size]


def hammer_levels(name: str, records: Mapping[str, Sequence[xr.Dataset]], **settings: Any) -> Identification:
    """Identify the compliance at each force level of hammer hits.

    Parameters
    ----------
    name : str
        Name of the measurement.
    records : mapping of str to sequence of xarray.Dataset
        Excitation axis -> records with hits of several levels, in any order.
    **settings
        Of `smfe.identification.hammer.hammer.identify_hammer`.

    Returns
    -------
    Identification
        ``compliance(force_level, frequency, response, excitation)``, the level being the median peak of its hits [N];
        table "hits" with a column level_N, table "levels".

    Raises
    ------
    InputError
        As `smfe.identification.hammer.hammer.identify_hammer`; with the level in the sentence.
    """
    rules: HitRules = settings.pop("rules", None) or HitRules()
    hits = [h for axis, group in records.items() for i, r in enumerate(group) for h in find_hits(r, axis, i, rules)]
    levels = force_levels(h.peak_force for h in hits)
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


# --- depths of cut as the force levels of a sweep: one compliance each, and whether they differ --------------------


def sweep_levels(
    name: str,
    passes: Mapping[float, Sequence[SweepPass]],
    frequency_range: tuple[float, float],
    estimator: Any = None,
    **settings: Any,
) -> Identification:
    """Identify the compliance at each depth of cut, and test whether the depths differ.

    Parameters
    ----------
    name : str
        Name of the measurement.
    passes : mapping of float to sequence of SweepPass
        Depth of cut [m] -> its passes, as many as there are axes at each depth.
    frequency_range : (float, float)
        Band to identify [Hz].
    estimator, **settings
        Of `smfe.identification.sweep.sweep.identify_sweep`.

    Returns
    -------
    Identification
        As `by_level`.

    Raises
    ------
    InputError
        As `smfe.identification.sweep.sweep.identify_sweep`, with the depth in the sentence.
    """
    found = {
        depth: identify_sweep(level_name(name, depth), own, frequency_range, estimator, **settings)
        for depth, own in sorted(passes.items())
    }
    return by_level(name, found)


def by_level(name: str, found: Mapping[float, Identification]) -> Identification:
    """Stack the levels of a sweep.

    Parameters
    ----------
    name : str
        Name of the measurement.
    found : mapping of float to Identification
        Depth of cut [m] -> what was identified from its passes.

    Returns
    -------
    Identification
        ``compliance(depth_of_cut, frequency, response, excitation)``, depth in mm, with the coordinates ``force_rms``
        and ``force_peak`` [N] of each depth: magnitude of the force in the cut, rms over all passes and largest. Table
        "levels": the same; table "level_test": each pair of levels, see `compared`. A warning where levels differ.
    """
    depths = sorted(found)
    forces = [_force(found[d]) for d in depths]
    stacked = stack_conditions([({"depth_of_cut": round(1e3 * d, 6)}, found[d].compliance) for d in depths])
    for k, key in enumerate(("force_rms", "force_peak")):
        stacked = stacked.assign_coords({key: ("depth_of_cut", [f[k] for f in forces], {"units": "N"})})
    rows = [
        {"level": level_name(name, d), "depth_of_cut_mm": round(1e3 * d, 6), "force_rms_N": rms, "force_peak_N": peak,
         "passes": len(found[d].tables["passes"])}
        for d, (rms, peak) in zip(depths, forces, strict=True)
    ]  # fmt: skip
    test = compared({d: found[d].compliance for d in depths})
    notes = [f"{round(1e3 * d, 6):g} mm: {note}" for d in depths for note in found[d].warnings]
    tables = {"levels": pd.DataFrame(rows), "level_test": test}
    return Identification(name, "sweep", stacked, tables, (*notes, *_differ(test)))


def _force(found: Identification) -> tuple[float, float]:
    """Return rms and peak of the force of a level [N]; passes count alike."""
    table = found.tables["passes"]
    return math.sqrt(float(np.mean(table["force_rms_N"] ** 2))), float(table["force_peak_N"].max())


def compared(compliances: Mapping[float, xr.Dataset]) -> pd.DataFrame:
    """Test each pair of levels for a difference beyond their noise.

    Parameters
    ----------
    compliances : mapping of float to xarray.Dataset
        Depth of cut [m] -> compliance.

    Returns
    -------
    pandas.DataFrame
        depth_a_mm, depth_b_mm, difference_percent (rms beyond noise, of the rms compliance), p, p_family (corrected
        for the number of pairs, Holm), worst_Hz, differs (p_family below `SIGNIFICANT`). A pair without a common
        frequency has no figures.
    """
    rows = []
    for a, b in combinations(sorted(compliances), 2):
        row = {"depth_a_mm": round(1e3 * a, 6), "depth_b_mm": round(1e3 * b, 6)}
        try:
            apart = difference_of(compliances[a], compliances[b])
            figures = 100.0 * apart.size, apart.p_value, apart.worst
        except InputError:
            figures = math.nan, math.nan, math.nan
        rows.append(row | dict(zip(("difference_percent", "p", "worst_Hz"), figures, strict=True)))
    table = pd.DataFrame(rows, columns=["depth_a_mm", "depth_b_mm", "difference_percent", "p", "worst_Hz"])
    table.insert(4, "p_family", holm(table["p"].to_numpy(dtype=float)))
    return table.assign(differs=table["p_family"] < SIGNIFICANT)


def _differ(test: pd.DataFrame) -> tuple[str, ...]:
    if not test["differs"].any():
        return ()
    most = test[test["differs"]].sort_values("difference_percent").iloc[-1]
    return (
        f"the compliance depends on the depth of cut: {most.depth_b_mm:g} mm and {most.depth_a_mm:g} mm differ by "
        f"{most.difference_percent:.2g} % beyond noise (p = {most.p_family:.1e}, most at {most.worst_Hz:.4g} Hz): "
        "the estimate of all passes together belongs to no level, use those of the single depths",
    )


# --- levels of a campaign --------------------------------------------------------------------------------------------


def levels_of(measurement: Measurement) -> dict[float, Measurement]:
    """Return depth of cut [m] -> the passes of this depth as a measurement; empty where there is one depth or none.

    So it is where ``split_levels = false`` asks for one estimate of all passes.
    """
    depths = {rounded(entry.depth_of_cut) for entry in measurement.records}
    known = sorted(d for d in depths if d is not None)
    if measurement.method != "sweep" or measurement.split_levels is False or len(known) < 2:
        return {}
    return {
        depth: replace(
            measurement,
            name=level_name(measurement.name, depth),
            depth_of_cut=depth,
            records=tuple(e for e in measurement.records if rounded(e.depth_of_cut) == depth),
        )
        for depth in known
    }


def belongs(campaign: Campaign, name: str, measurement: str) -> bool:
    """Whether a name is that of a measurement, or of a level of it."""
    if name == measurement:
        return True
    levels = (levels_of(m) for m in campaign.measurements if m.name == measurement)
    return any(m.name == name for level in levels for m in level.values())


def with_levels(campaign: Campaign) -> Campaign:
    """Return the campaign with the levels of its sweeps as measurements, each behind the one it belongs to.

    A sweep whose records all state the same depth of cut is one at this depth.
    """
    out: list[Measurement] = []
    for measurement in campaign.measurements:
        levels, depths = levels_of(measurement), {rounded(e.depth_of_cut) for e in measurement.records}
        if measurement.method == "sweep":
            measurement = replace(measurement, depth_of_cut=depths.pop() if len(depths) == 1 else None)
        out += [measurement, *levels.values()]
    return replace(campaign, measurements=tuple(out))


def level_cubes(
    campaign: Campaign, found: Mapping[str, Identification]
) -> tuple[dict[str, Identification], dict[str, xr.Dataset]]:
    """Return what the sweeps with several depths of cut are once their levels are known.

    Parameters
    ----------
    campaign : Campaign
        As its file says, without `with_levels`.
    found : mapping of str to Identification
        Measurements and levels; those that could not be identified are not among them.

    Returns
    -------
    found : dict
        The estimates of all passes together, with the tables "levels" and "level_test", their warnings and the
        attribute ``levels``: names of what was identified from the same passes.
    cubes : dict
        "NAME, by level" -> compliance with the dimension ``depth_of_cut`` [mm].
    """
    pooled, cubes = {}, {}
    for measurement in campaign.measurements:
        levels = {d: m.name for d, m in levels_of(measurement).items() if m.name in found}
        if not levels:
            continue
        whole = by_level(measurement.name, {d: found[n] for d, n in levels.items()})
        cubes[f"{measurement.name}, {BY_LEVEL}"] = whole.compliance
        if measurement.name not in found:
            continue
        one = found[measurement.name]
        pooled[measurement.name] = replace(
            one,
            compliance=one.compliance.assign_attrs(levels=", ".join(levels.values())),
            tables={**one.tables, **whole.tables},
            warnings=(*one.warnings, *_differ(whole.tables["level_test"])),
        )
    return pooled, cubes
