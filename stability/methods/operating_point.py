"""Zero-order limits whose compliance belongs to the feed and the force at which each point is cut.

A machine with friction answers differently idle and in motion, to a small force and to a large one. At a spindle speed
n the feed is ``f_z N n``, and at a depth a the force level is that of the cut. With L the zero-order limit::

    L(Phi(feed(n), level(a))) = a

(:eq:`operating-point`) has as roots all depths at which stability changes: a cut at depth a is stable where ``a < L``.
Between the measured conditions the complex compliance is interpolated linearly; outside them the nearest one is taken,
and that is said. Each feed may have been measured at levels of its own: along the level it is interpolated first, then
along the feed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients, force_harmonics
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import at_tool, check_compliance, label
from process.types import Complex, Real
from stability.methods.rules import RULES
from stability.methods.vibration_mode import vibration
from stability.methods.zero_order import first_limits, labelled
from stability.methods.zero_order_branches import Branches, eigenvalue_branches
from stability.problem import (
    NO_LOBE,
    Cut,
    Samples,
    check_spindle_speed,
    complete_samples,
    edge_warnings,
    partial_warning,
    pattern_of_pitch,
)

CONDITIONS: tuple[str, ...] = ("feed", "force_level", "depth_of_cut", "level")
"""Dimensions of a compliance that a cut fixes: mm/min, N, mm; ``level`` only counts the levels of each feed."""


Level = Callable[[float], float]
"""Depth of cut [m] -> what the level dimension of the compliance counts [N or mm]."""


@dataclass(frozen=True)
class _Conditions:
    """A compliance over feed and the levels of each feed, shape (feeds, levels, n, 3, 3), on one frequency grid."""

    samples: Samples
    matrix: Complex
    feed: Real
    levels: tuple[Real, ...]
    level_name: str | None

    def at(self, feed: float, level: float) -> Samples:
        """Return the compliance at a feed [mm/min] and a level, linear between conditions, the nearest outside."""
        mixed = sum(
            u * v * self.matrix[i, j] for i, u in _between(self.feed, feed) for j, v in _between(self.levels[i], level)
        )
        return replace(self.samples, matrix=np.asarray(mixed))

    def known(self, feed: float) -> tuple[float, float]:
        """Return lowest and highest level that were measured at the feeds about this one."""
        about = [self.levels[i] for i, share in _between(self.feed, feed) if share > 0.0]
        return max(float(part[0]) for part in about), min(float(part[-1]) for part in about)

    @property
    def every_level(self) -> Real:
        """The levels of all feeds, rising."""
        return np.unique(np.concatenate(self.levels))


@dataclass(frozen=True)
class _Point:
    """Zero-order at one speed with the compliance of one condition."""

    depth: float
    chatter: float
    lobe: int
    branches: Branches


def operating_point(
    compliance: xr.Dataset,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    spindle_speed: ArrayLike,
    feed_per_tooth: float,
    force_level: Level | None = None,
) -> xr.Dataset:
    """Return the limit depths at which the compliance is that of the cut itself.

    Parameters
    ----------
    compliance : xarray.Dataset
        Compliance [m/N] with one or both of the dimensions ``feed`` [mm/min] and ``force_level`` [N] (or
        ``depth_of_cut`` [mm], for sweeps): measured, or of a machine model by `process.compliance_map`. Where each feed
        has levels of its own, the dimension is called ``level`` and the coordinate ``force_level(feed, level)`` (or
        ``depth_of_cut``) holds them, NaN behind the last one of a feed.
    tool, arc, coefficients
        The cut.
    spindle_speed : array_like, shape (speeds,)
        Spindle speeds [rpm], in any order.
    feed_per_tooth : float
        f_z [m]: the feed at each speed is ``f_z N n``.
    force_level : callable, optional
        Depth of cut [m] -> force level [N], rising. Default: the amplitude of the first tooth passing harmonic of the
        static cutting force, all directions together (`process.force_harmonics`).

    Returns
    -------
    xarray.Dataset
        What `zero_order` returns for a measured compliance, with ``feed`` [mm/min] and ``force_level`` [N] (or
        ``depth_of_cut`` [mm]) of each limit, and ``crossing_depth(spindle_speed, crossing)`` [mm]: all depths at which
        stability changes, lost at the first, won at the second and so on, NaN where there are fewer.

    Raises
    ------
    InputError
        For a compliance without such a dimension or with others, conditions that do not rise, a force level that does
        not rise with the depth, or what `zero_order` refuses.
    """
    speed = check_spindle_speed(spindle_speed)
    if not 0.0 < feed_per_tooth < math.inf:
        raise InputError(f"the feed per tooth is {feed_per_tooth * 1e3:g} mm; it must be positive and finite")
    cut = Cut(tool, arc, coefficients)
    conditions = _conditions(compliance)
    level = _level(conditions, cut, feed_per_tooth, force_level)
    feed = feed_per_tooth * 1e3 * tool.teeth * speed
    search = _Search(conditions, cut.directional_matrix(), pattern_of_pitch(tool).delay, level)
    found = [search.crossings(float(n), float(v)) for n, v in zip(speed, feed, strict=True)]
    depth = np.array([d[0] if d else math.inf for d in found])
    points = [search.point(float(n), float(v), float(a)) for n, v, a in zip(speed, feed, depth, strict=True)]
    out = _labelled_points(search, speed, depth, points, [*cut.warnings, *conditions.samples.warnings])
    most = max([1, *(len(d) for d in found)])
    every = np.array([[1e3 * d for d in row] + [math.nan] * (most - len(row)) for row in found])
    out["crossing_depth"] = (("spindle_speed", "crossing"), every, {"units": "mm"})
    out["feed"] = ("spindle_speed", feed)
    used = np.array([level(d) if math.isfinite(d) else math.nan for d in depth])
    if conditions.level_name is not None:
        out[conditions.level_name] = ("spindle_speed", used)
    out.attrs["warnings"] += [*_outside(conditions, feed, used), *edge_warnings(conditions.at(float(feed[0]), 0.0))]
    return label(out)


@dataclass(frozen=True)
class _Search:
    """What is the same at all speeds."""

    conditions: _Conditions
    directional: Complex
    pitch: Real
    level: Level
    kept: dict[tuple[float, float], Branches] = field(default_factory=dict)

    def _branches(self, feed: float, level: float) -> Branches:
        """Return the eigenvalues at a condition; those of a measured level are kept when there is one feed only."""
        key = (float(self.conditions.feed[0]), level) if self.conditions.feed.size == 1 else (feed, level)
        if key in self.kept:
            return self.kept[key]
        branches = eigenvalue_branches(self.conditions.at(*key), self.directional)
        if self.conditions.feed.size == 1 and len(self.kept) < RULES.kept_conditions:
            self.kept[key] = branches
        return branches

    def point(self, speed: float, feed: float, depth: float) -> _Point:
        """Return the zero-order limit at a speed with the compliance that belongs to a depth [m]."""
        branches = self._branches(
            feed, float(self.conditions.every_level[-1]) if math.isinf(depth) else self.level(depth)
        )
        limit, chatter, lobe = first_limits(branches, self.pitch, np.array([speed]))
        return _Point(float(limit[0]), float(chatter[0]), int(lobe[0]), branches)

    def crossings(self, speed: float, feed: float) -> list[float]:
        """Return all depths [m] at which ``1 - a/L(a)`` changes its sign, rising."""

        def margin(depth: float) -> float:
            return 1.0 - depth / self.point(speed, feed, depth).depth

        nodes = self._nodes()
        limits = [self.point(speed, feed, a).depth for a in nodes]
        # Below the first level and above the last the compliance is constant, and so is the limit.
        out = [limits[0]] if limits[0] <= nodes[0] else []
        for (a, at_a), (b, at_b) in pairwise(zip(nodes, limits, strict=True)):
            if (at_a > a) != (at_b > b):
                out.append(_root(margin, (a, 1.0 - a / at_a), (b, 1.0 - b / at_b)))
        return [*out, limits[-1]] if nodes[-1] < limits[-1] < math.inf else out

    def _nodes(self) -> list[float]:
        """Return the depths [m] of the measured levels and between them; below and above the compliance is constant."""
        ends = [_inverse(self.level, float(level)) for level in self.conditions.every_level]
        between = [np.linspace(a, b, RULES.pieces_of_a_level, endpoint=False) for a, b in pairwise(ends)]
        return [float(a) for a in np.concatenate([*between, ends[-1:]])]


def _root(margin: Level, low: tuple[float, float], high: tuple[float, float]) -> float:
    """Return where a function of the depth changes its sign (Illinois, bisection where it jumps)."""
    (a, at_a), (b, at_b) = low, high
    ga, gb, side = at_a, at_b, 0
    for step in range(80):
        middle = (a * gb - b * ga) / (gb - ga) if step < 20 else 0.5 * (a + b)
        value = margin(middle)
        if abs(value) < 1e-13 or b - a < 1e-13 * b:
            return middle
        if (value > 0.0) == (at_b > 0.0):
            b, gb, ga, side = middle, value, ga * (0.5 if side > 0 else 1.0), 1
        else:
            a, ga, gb, side = middle, value, gb * (0.5 if side < 0 else 1.0), -1
    return 0.5 * (a + b)


def _between(nodes: Real, value: float) -> list[tuple[int, float]]:
    """Return the nodes about a value with their weights; the nearest one outside."""
    if nodes.size == 1 or value <= nodes[0]:
        return [(0, 1.0)]
    if value >= nodes[-1]:
        return [(nodes.size - 1, 1.0)]
    i = int(np.searchsorted(nodes, value, side="right")) - 1
    share = float((value - nodes[i]) / (nodes[i + 1] - nodes[i]))
    return [(i, 1.0 - share), (i + 1, share)]


def _inverse(level: Level, wanted: float) -> float:
    """Return the depth [m] of a level that rises with the depth."""
    low, high = 0.0, 1e-3
    while level(high) < wanted:
        low, high = high, 2.0 * high
        if high > 1e3:
            raise InputError(f"no depth of cut has the force level {wanted:g}; it must rise with the depth")
    for _ in range(200):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (middle, high) if level(middle) < wanted else (low, middle)
    return high


def _conditions(compliance: xr.Dataset) -> _Conditions:
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
    for name in ("feed", second):
        array = array if name in array.dims else array.expand_dims({name: [0.0]})
    along = array[names[0] if names else second]
    table = along.broadcast_like(array.isel(frequency=0, response=0, excitation=0)).transpose("feed", second)
    there = table.notnull()
    levels = tuple(row[known].astype(float) for row, known in zip(table.values, there.values, strict=True))
    feed = array["feed"].values.astype(float)
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
    return _Conditions(samples, matrix, feed, levels, names[0] if names else None)


def _level(conditions: _Conditions, cut: Cut, feed_per_tooth: float, given: Level | None) -> Level:
    """Return how the level dimension follows the depth: given, the depth itself in mm, or the first force harmonic."""
    if conditions.level_name is None:
        return lambda depth: 1e3 * depth
    if conditions.level_name == "depth_of_cut":
        if given is not None:
            raise InputError(
                "the compliance has the dimension depth_of_cut; a force_level has no use then: leave it out"
            )
        return lambda depth: 1e3 * depth
    if given is not None:
        return given
    # Run-out moves force between the teeth; their passing harmonic stays that of the mean chip.
    round_tool = replace(cut.tool, runout=None)
    return lambda depth: float(
        np.linalg.norm(force_harmonics(round_tool, cut.arc, cut.coefficients, depth, feed_per_tooth, [1]))
    )


def _outside(conditions: _Conditions, feed: Real, level: Real) -> list[str]:
    """Say how many limits take the nearest condition because theirs lies outside the measured ones."""
    out = []
    nodes = conditions.feed
    ranges = [("feed", "mm/min", feed, np.broadcast_to([nodes[0], nodes[-1]], (feed.size, 2)))]
    if nodes.size == 1 and nodes[0] == 0.0:
        ranges = []
    if conditions.level_name is not None:
        unit = "mm" if conditions.level_name == "depth_of_cut" else "N"
        finite = np.isfinite(level)
        known = np.array([conditions.known(float(v)) for v in feed[finite]]).reshape(-1, 2)
        ranges.append((conditions.level_name, unit, level[finite], known))
    for name, unit, values, known in ranges:
        outside = (values < known[:, 0] * (1 - 1e-12)) | (values > known[:, 1] * (1 + 1e-12))
        if outside.any():
            out.append(
                f"{outside.sum()} of {feed.size} limits lie at a {name} outside the measured {known[:, 0].min():.6g} "
                f"to {known[:, 1].max():.6g} {unit} (asked: {values.min():.6g} to {values.max():.6g} {unit}); the "
                "nearest compliance is taken there"
            )
    return out


def _labelled_points(
    search: _Search, speed: Real, depth: Real, points: Sequence[_Point], warnings: list[str]
) -> xr.Dataset:
    """Put names and units on the limits; each with the vibration of its own compliance."""
    limited = np.isfinite(depth)
    # Where the limit jumps with the depth the crossing lies at the jump, else it is the limit itself.
    limit = np.where(limited, [p.depth for p in points], math.inf)
    exact = limited & np.isfinite(limit)
    exact[exact] = np.abs(limit[exact] / depth[exact] - 1.0) < 1e-6
    chatter = np.where(limited, [p.chatter for p in points], math.nan)
    lobe = np.where(limited, [p.lobe for p in points], NO_LOBE).astype(np.int64)
    moved = np.concatenate(
        [
            vibration(p.branches, search.directional, chatter[[i]], limit[[i]], search.pitch, speed[[i]])[1]
            for i, p in enumerate(points)
        ]
    )
    branches = points[0].branches
    out = labelled(speed, (np.where(exact, limit, depth), chatter, lobe, moved, None), branches, warnings)
    return out.assign_attrs(method="operating_point")
