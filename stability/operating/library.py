"""A compliance measured at several feeds and levels: linear between them, and refused outside."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from process.errors import InputError
from process.labels import at_tool, check_compliance
from process.types import Complex, Real
from stability.problem import Samples, complete_samples, partial_warning

CONDITIONS: tuple[str, ...] = ("feed", "force_level", "depth_of_cut", "level")
"""Dimensions of a compliance that a cut fixes: mm/min, N, mm; ``level`` only counts the levels of each feed."""


@dataclass(frozen=True)
class Conditions:
    """A compliance over feed and the levels of each feed, on one frequency grid.

    Parameters
    ----------
    samples : Samples
        Grid, gaps and warnings.
    matrix : ndarray of complex, shape (feeds, levels, n, 3, 3)
        Compliance [m/N].
    std : ndarray, of the same shape, or None
        Its standard deviation [m/N], where it was measured.
    feed : ndarray, shape (feeds,)
        [mm/min].
    levels : tuple of ndarray
        Of each feed, rising [N] or [mm].
    level_name : str or None
        "force_level", "depth_of_cut", or None where it has no levels.
    has_feed : bool
        Whether a feed other than rest is stated.
    """

    samples: Samples
    matrix: Complex
    std: Real | None
    feed: Real
    levels: tuple[Real, ...]
    level_name: str | None
    has_feed: bool

    def at(self, feed: float, level: float) -> Samples:
        """Return the compliance at a feed and a level: linear between conditions, the nearest outside."""
        mixed = sum(share * self.matrix[place] for place, share in self._shares(feed, level))
        return replace(self.samples, matrix=np.asarray(mixed))

    def error_at(self, feed: float, level: float) -> Real | None:
        """Return the standard deviation [m/N], shape (n, 3, 3), of what `at` returns; conditions err independently."""
        if self.std is None:
            return None
        return np.asarray(np.sqrt(sum(share**2 * self.std[place] ** 2 for place, share in self._shares(feed, level))))

    def _shares(self, feed: float, level: float) -> list[tuple[tuple[int, int], float]]:
        return [((i, j), u * v) for i, u in _between(self.feed, feed) for j, v in _between(self.levels[i], level)]

    def knows_feed(self, feed: float) -> bool:
        """Return whether a feed [mm/min] lies within the measured ones; any does where none is stated."""
        slack = 1e-9 * float(np.abs(self.feed).max())
        return not self.has_feed or bool(self.feed[0] - slack <= feed <= self.feed[-1] + slack)

    def known(self, feed: float) -> tuple[float, float]:
        """Return lowest and highest level that were measured at the feeds about this one."""
        about = [self.levels[i] for i, share in _between(self.feed, feed) if share > 0.0]
        return max(float(part[0]) for part in about), min(float(part[-1]) for part in about)

    def levels_about(self, feed: float) -> Real:
        """Return the levels that were measured at the feeds about this one, rising, within `known`."""
        low, high = self.known(feed)
        about = [self.levels[i] for i, share in _between(self.feed, feed) if share > 0.0]
        every = np.unique(np.concatenate([np.array([low, high]), *about]))
        return np.asarray(every[(every >= low) & (every <= max(low, high))])

    @property
    def every_level(self) -> Real:
        """The levels of all feeds, rising."""
        return np.unique(np.concatenate(self.levels))

    def without(self, i: int) -> Conditions:
        """Return the conditions without the feed of that number."""
        rest = np.arange(self.feed.size) != i
        levels = tuple(part for k, part in enumerate(self.levels) if k != i)
        std = None if self.std is None else self.std[rest]
        return replace(self, matrix=self.matrix[rest], std=std, feed=self.feed[rest], levels=levels)


def _between(nodes: Real, value: float) -> list[tuple[int, float]]:
    """Return the nodes about a value with their weights; the nearest one outside."""
    if nodes.size == 1 or value <= nodes[0]:
        return [(0, 1.0)]
    if value >= nodes[-1]:
        return [(nodes.size - 1, 1.0)]
    i = int(np.searchsorted(nodes, value, side="right")) - 1
    share = float((value - nodes[i]) / (nodes[i + 1] - nodes[i]))
    return [(i, 1.0 - share), (i + 1, share)]


def conditions_of(compliance: xr.Dataset) -> Conditions:
    """Check the dimensions and put all conditions on one frequency grid: where all are known."""
    array = at_tool(check_compliance(compliance))["compliance"]
    named = [name for name in CONDITIONS if name in array.dims]
    dims = [name for name in named if name != "feed"]
    names = [name for name in CONDITIONS[1:3] if name in array.coords] if dims == ["level"] else dims
    if not named or len(dims) > 1 or len(names) != len(dims):
        raise InputError(
            f"the compliance has the dimensions {', '.join(map(str, array.dims))}; feed [mm/min], and one of "
            "force_level [N] and depth_of_cut [mm], say at which operating point it holds. For a compliance at one "
            "condition ask for the zero-order limit"
        )
    if len(array.dims) > 3 + len(named):
        complete_samples(compliance.isel({name: 0 for name in named}))  # refuses what no cut fixes, with its name
    second = dims[0] if dims else "force_level"
    has_feed = "feed" in array.dims
    for name in ("feed", second):
        array = array if name in array.dims else array.expand_dims({name: [0.0]})
    along = array[names[0] if names else second]
    table = along.broadcast_like(array.isel(frequency=0, response=0, excitation=0)).transpose("feed", second)
    there = table.notnull()
    levels = tuple(row[known].astype(float) for row, known in zip(table.values, there.values, strict=True))
    feed = array["feed"].values.astype(float)
    has_feed = has_feed and not (feed.size == 1 and feed[0] == 0.0)
    for name, nodes in (("feed", feed), *((names[0] if names else second, nodes) for nodes in levels)):
        if not nodes.size or not np.isfinite(nodes).all() or np.any(np.diff(nodes) <= 0.0):
            raise InputError(f"the conditions {name} are {nodes.tolist()}; they must be finite and rise: sort them")
    behind = there.values[:, 1:] & ~there.values[:, :-1]
    if behind.any():
        raise InputError(f"the levels {names[0]} of a feed have gaps; put the NaN behind the last level of each feed")
    array = array.drop_vars([c for c in array.coords if c not in array.dims])
    there = there.drop_vars(list(there.coords))
    missing = array.isnull().all("frequency") & there
    units = array.attrs
    array = array.where(~missing, 0.0)
    known = (xr.apply_ufunc(np.isfinite, array) | ~there).all(dim=["feed", second])
    one = array.isel({"feed": 0, second: 0}, drop=True).where(known).to_dataset(name="compliance")
    one["compliance"].attrs.update(units)
    samples = complete_samples(one)
    partial = partial_warning(array["response"].values, array["excitation"].values, missing.any(dim=["feed", second]))
    samples = replace(samples, warnings=(*partial, *(w for w in samples.warnings if "partial matrix" not in w)))
    full = array.sel(frequency=samples.frequency).transpose("feed", second, "frequency", "response", "excitation")
    matrix = np.zeros((*full.shape[:3], 3, 3), dtype=complex)
    rows, columns = (["xyz".index(str(a)) for a in full[d].values] for d in ("response", "excitation"))
    matrix[np.ix_(*map(range, full.shape[:3]), rows, columns)] = full.values
    return Conditions(samples, matrix, _errors(full, compliance), feed, levels, names[0] if names else None, has_feed)


def _errors(full: xr.DataArray, compliance: xr.Dataset) -> Real | None:
    """Return the standard deviations [m/N], shape (feeds, levels, n, 3, 3); None where they are not known."""
    compliance = at_tool(compliance)
    if "compliance_std" not in compliance:
        return None
    array = compliance["compliance_std"]
    for name in full.dims:
        if name not in array.dims:
            array = array.expand_dims({name: full[name].values})
    array = array.sel(frequency=full["frequency"]).transpose(*full.dims)
    out = np.zeros((*full.shape[:3], 3, 3))
    rows, columns = (["xyz".index(str(a)) for a in full[d].values] for d in ("response", "excitation"))
    out[np.ix_(*map(range, full.shape[:3]), rows, columns)] = np.nan_to_num(array.values)
    return out if out.any() else None
