"""Stability boundary in a plane of two named axes: knows a scalar function and two ranges, nothing else.

A scan over few nodes finds where the function changes sign; minima of its modulus that could hide an island are looked
into. From every sign change the boundary is followed cell by cell over a fine lattice of which only the nodes beside
the boundary are evaluated, and refined on the edges it crosses to a tolerance. Corners where lobes meet need no care,
as no tangent is taken. The cost grows with the length of the boundary, not with the area.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd

from process.errors import InputError
from stability.lattice import ALONG_FIRST, ALONG_SECOND, Edges, Lattice, Nodes, Real

Surface = Callable[..., Real]
"""Called with one array an axis, by name; negative where stable, positive where unstable."""


@dataclass(frozen=True)
class Axis:
    """One axis of the plane.

    Parameters
    ----------
    name : str
        Keyword under which the function takes its values.
    low, high : float
        Range.
    cells : int, optional
        Cells of the fine lattice: the detail of the boundary.
    scan : int, optional
        Cells of the scan that finds it; `cells` must be `scan` times a whole number.

    Raises
    ------
    InputError
        For an empty range, or numbers of cells that do not fit.
    """

    name: str
    low: float
    high: float
    cells: int = 128
    scan: int = 16

    def __post_init__(self) -> None:
        """Refuse an axis on which nothing can be found."""
        if not (math.isfinite(self.low) and math.isfinite(self.high) and self.low < self.high):
            raise InputError(f"axis {self.name} goes from {self.low:g} to {self.high:g}; a rising range is needed")
        if self.scan < 2 or self.cells < self.scan or self.cells % self.scan:
            raise InputError(
                f"axis {self.name} has {self.cells} cells and a scan of {self.scan}; the scan needs at least 2, and "
                "the cells must be a multiple of it"
            )

    @property
    def nodes(self) -> Real:
        """Coordinates of the fine lattice."""
        return np.linspace(self.low, self.high, self.cells + 1)

    @property
    def stride(self) -> int:
        """Fine cells between two nodes of the scan."""
        return self.cells // self.scan


@dataclass(frozen=True)
class Boundary:
    """A stability boundary.

    Parameters
    ----------
    points : DataFrame
        ``curve`` (0, 1, ...), the two axes, ``closed``: within a curve the rows follow the boundary.
    bands : DataFrame
        The first axis, ``from``, ``to`` (on the second axis), ``stable``: every band at every value of the first axis
        of the fine lattice, in rising order.
    evaluations : int
        How often the function was evaluated.
    plain_evaluations : int
        Evaluations of a plain grid with the same cells, before any refinement.
    smallest_island : dict
        Axis -> size. An island that holds a rectangle of this size is certainly found, smaller ones where the function
        dips towards zero around them.
    """

    points: pd.DataFrame
    bands: pd.DataFrame
    evaluations: int
    plain_evaluations: int
    smallest_island: dict[str, float]


def pointwise(function: Callable[..., float]) -> Surface:
    """Return a function of arrays from one of single numbers."""

    def over_points(**axes: Real) -> Real:
        rows = zip(*axes.values(), strict=True)
        return np.array([function(**dict(zip(axes, map(float, row), strict=True))) for row in rows])

    return over_points


def find_boundary(function: Surface, first: Axis, second: Axis, tolerance: float = 1e-4) -> Boundary:
    """Find the whole stability boundary in a plane, islands and all.

    Parameters
    ----------
    function : callable
        Called as ``function(**{first.name: array, second.name: array})``, arrays of one shape (points,); returns as
        many values, negative where stable, positive where unstable, e.g. the largest modulus of a multiplier less
        one. A function of single numbers goes through `pointwise`.
    first, second : Axis
        E.g. spindle speed and depth, or spindle speed and immersion.
    tolerance : float, optional
        Largest error of a point along the edge on which it lies, as a share of the range of that axis.

    Returns
    -------
    Boundary
        Without a boundary in the plane `points` is empty, and every value of the first axis has one band.

    Raises
    ------
    InputError
        For axes of one name, a tolerance out of (0, 1), or a function that returns no number.
    """
    if first.name == second.name:
        raise InputError(f"both axes are called {first.name}; give two names")
    if not 0.0 < tolerance < 1.0:
        raise InputError(f"the tolerance is {tolerance:g}; a share of the range between 0 and 1 is needed, e.g. 1e-4")
    names = first.name, second.name
    lattice = Lattice(lambda x, y: function(**{names[0]: x, names[1]: y}), first.nodes, second.nodes)
    cells = _followed(lattice, (first.stride, second.stride))
    edges = lattice.crossed(*cells)
    x, y = lattice.roots(edges, tolerance)
    return Boundary(
        points=_points(names, _chains(lattice, cells, edges), x, y),
        bands=_bands(lattice, names[0], edges, y),
        evaluations=lattice.evaluations,
        plain_evaluations=lattice.known.size,
        smallest_island={a.name: (a.high - a.low) / a.scan for a in (first, second)},
    )


def _followed(lattice: Lattice, stride: tuple[int, int]) -> tuple[Nodes, Nodes]:
    """Evaluate scan, lower rim and surroundings of the boundary; return the cells that the boundary crosses."""
    lattice.need(*lattice.every(stride))
    lattice.seek_dips(stride)
    # The bands of a column are told apart from its lowest node up.
    rim = np.arange(lattice.first.size)
    lattice.need(rim, np.zeros_like(rim))
    visited = np.zeros((lattice.first.size - 1, lattice.second.size - 1), dtype=bool)
    while True:
        before = int(lattice.known.sum()), int(visited.sum())
        lattice.trace(lattice.seeds(), visited)
        if before == (int(lattice.known.sum()), int(visited.sum())):
            rows, columns = np.nonzero(visited)
            return rows, columns


def _bands(lattice: Lattice, name: str, edges: Edges, y: Real) -> pd.DataFrame:
    """Return the bands of every column: they change at each crossing of its edges."""
    upright = edges[:, 0] == ALONG_SECOND
    column, at = edges[upright, 1], y[upright]
    order = np.lexsort((at, column))
    column, at = column[order], at[order]
    starts = np.searchsorted(column, np.arange(lattice.first.size + 1))
    rows = []
    for i, x in enumerate(lattice.first):
        borders = [lattice.second[0], *at[starts[i] : starts[i + 1]], lattice.second[-1]]
        stable = bool(lattice.value[i, 0] < 0.0)
        for k in range(len(borders) - 1):
            rows.append((x, borders[k], borders[k + 1], stable == (k % 2 == 0)))
    return pd.DataFrame(rows, columns=[name, "from", "to", "stable"])


def _points(names: tuple[str, str], chains: list[tuple[list[int], bool]], x: Real, y: Real) -> pd.DataFrame:
    """Return the boundary as points in the order of its curves."""
    order = np.array([k for chain, _ in chains for k in chain], dtype=np.int64)
    return pd.DataFrame(
        {
            "curve": np.repeat(np.arange(len(chains)), [len(chain) for chain, _ in chains]),
            names[0]: x[order],
            names[1]: y[order],
            "closed": np.repeat([closed for _, closed in chains], [len(chain) for chain, _ in chains]).astype(bool),
        }
    )


def _chains(lattice: Lattice, cells: tuple[Nodes, Nodes], edges: Edges) -> list[tuple[list[int], bool]]:
    """Return the crossed edges in the order of the boundary, curve by curve, and whether each curve is closed."""
    number = {tuple(edge): k for k, edge in enumerate(edges.tolist())}
    links: list[list[int]] = [[] for _ in number]
    for i, j in zip(*(c.tolist() for c in cells), strict=True):
        for one, other in _pairs(lattice, i, j, number):
            links[one].append(other)
            links[other].append(one)
    chains, free = [], set(range(len(links)))
    ends = [k for k, link in enumerate(links) if len(link) < 2]
    for start in [*ends, *range(len(links))]:
        if start not in free:
            continue
        chain = [start]
        free.discard(start)
        while ahead := [k for k in links[chain[-1]] if k in free]:
            chain.append(ahead[0])
            free.discard(ahead[0])
        chains.append((chain, len(chain) > 2 and start in links[chain[-1]]))
    return chains


def _pairs(lattice: Lattice, i: int, j: int, number: dict[tuple[int, ...], int]) -> list[tuple[int, int]]:
    """Return which crossed edges of a cell the boundary joins; two curves pass a saddle on its bilinear sides."""
    sides = (
        (ALONG_FIRST, i, j),
        (ALONG_SECOND, i + 1, j),
        (ALONG_FIRST, i, j + 1),
        (ALONG_SECOND, i, j),
    )
    there = [number[side] for side in sides if side in number]
    if len(there) < 4:
        return [(there[0], there[1])] if len(there) == 2 else []
    v = lattice.value[i : i + 2, j : j + 2]
    low = v[0, 0] * v[1, 1] - v[0, 1] * v[1, 0]
    split = (low > 0.0) == (v[0, 0] + v[1, 1] - v[0, 1] - v[1, 0] > 0.0)
    joined = split == bool(v[0, 0] >= 0.0)
    bottom, right, top, left = there
    return [(bottom, right), (top, left)] if joined else [(bottom, left), (right, top)]
