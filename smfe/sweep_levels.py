"""Depths of cut as the force levels of a sweep: one compliance each, and whether they differ.

The cutting force grows with the depth of cut, so passes at 1, 1.5 and 2 mm ask the machine at three levels of force. A
linear machine answers with one compliance; friction, play and micro-slip do not. Passes of one depth are a measurement
of its own, with its own errors; the estimate of all passes together is kept beside them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from process.errors import InputError
from smfe.campaign import Campaign, Measurement
from smfe.campaign.depth_levels import level_name, rounded
from smfe.conditions import stack_conditions
from smfe.explained import holm
from smfe.identification.errors.result import Identification
from smfe.level_test import difference_of
from smfe.sweep import identify_sweep
from smfe.sweep_estimators import SweepPass

BY_LEVEL = "by level"
"""Behind the name of a measurement: all its levels as one array."""

SIGNIFICANT = 0.01
"""Corrected probability below which two levels differ."""


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
        Of `smfe.sweep.identify_sweep`.

    Returns
    -------
    Identification
        As `by_level`.

    Raises
    ------
    InputError
        As `smfe.sweep.identify_sweep`, with the depth in the sentence.
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
            figures = 100.0 * apart.size, apart.chance, apart.worst
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
        f"{most.difference_percent:.2g} % beyond noise (chance {most.p_family:.1e}, most at {most.worst_Hz:.4g} Hz): "
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
