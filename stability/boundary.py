"""The boundary of any scalar function over two named axes, with islands and every band: `find_boundary`.

The function is evaluated on a coarse scan of a fine lattice; dips towards zero are sought out, and the boundary is
followed from there through the cells that it crosses, whose nodes alone are evaluated. Crossings of edges are then
closed in on, and joined to curves. Nothing here knows of stability but the sign of the function.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from process.errors import InputError
from process.types import Real

Surface = Callable[..., Real]
"""Called with one array an axis, by name; negative where stable, positive where unstable."""

Nodes = NDArray[np.int64]
Edges = NDArray[np.int64]

ALONG_FIRST, ALONG_SECOND = 0, 1
"""Direction of an edge."""

Plane = Callable[[Real, Real], Real]
"""Values of the function at points (first, second), arrays of one shape."""

NEIGHBOURS = np.array([(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)])


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
    # The bands of a column alternate from its lowest node up.
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


# --- the lattice: nodes are evaluated only when they are needed -----------------------------------------------------


@dataclass
class Lattice:
    """Nodes (i, j) over two ranges, and what is known of the function there.

    Parameters
    ----------
    function : callable
        Negative where stable.
    first, second : ndarray
        Coordinates of the nodes.
    """

    function: Plane
    first: Real
    second: Real
    evaluations: int = 0
    value: Real = field(init=False)
    known: NDArray[np.bool_] = field(init=False)

    def __post_init__(self) -> None:
        """Begin with nothing known."""
        self.value = np.full((self.first.size, self.second.size), np.nan)
        self.known = np.zeros(self.value.shape, dtype=bool)

    def at(self, x: Real, y: Real) -> Real:
        """Evaluate the function, and count.

        Raises
        ------
        InputError
            When it returns another shape or a value that is no number.
        """
        self.evaluations += x.size
        out = np.asarray(self.function(x, y), dtype=float)
        if out.shape != x.shape:
            raise InputError(
                f"the function returned the shape {out.shape} for {x.size} points; one number a point is needed: wrap "
                "a function of single numbers in pointwise()"
            )
        bad = np.flatnonzero(np.isnan(out))
        if bad.size:
            raise InputError(
                f"the function is not a number at ({x[bad[0]]:g}, {y[bad[0]]:g}); it must be negative where stable and "
                "positive where unstable everywhere in the ranges"
            )
        return out

    def need(self, i: Nodes, j: Nodes) -> None:
        """Evaluate those of the nodes that are not known."""
        unknown = np.unique(np.ravel_multi_index((i, j), self.known.shape)[~self.known[i, j]])
        if unknown.size:
            i, j = np.unravel_index(unknown, self.known.shape)
            self.value[i, j] = self.at(self.first[i], self.second[j])
            self.known[i, j] = True

    def unstable(self, i: Nodes, j: Nodes) -> NDArray[np.bool_]:
        """Return which of some known nodes are not stable."""
        return np.asarray(self.value[i, j] >= 0.0)

    def seek_dips(self, stride: tuple[int, int]) -> None:
        """Go down from the local minima of ``|f|`` of a scan, while f could change sign within a stride.

        Around a minimum the stride is halved again and again until it is one or a sign change is found, which the
        next `seeds` sees.
        """
        i, j = (
            g.ravel()
            for g in np.meshgrid(
                *(np.arange(0, n, s) for n, s in zip(self.known.shape, stride, strict=True)), indexing="ij"
            )
        )
        chosen = self._dips(i, j, stride)
        i, j = i[chosen], j[chosen]
        while i.size and max(stride) > 1:
            stride = (max(1, stride[0] // 2), max(1, stride[1] // 2))
            near_i, near_j = self._stencil(i, j, stride)
            self.need(near_i.ravel(), near_j.ravel())
            lowest = np.abs(self.value[near_i, near_j]).argmin(axis=1)
            row = np.arange(i.size)
            i, j = near_i[row, lowest], near_j[row, lowest]
            self.need(*(n.ravel() for n in self._stencil(i, j, stride)))
            chosen = self._dips(i, j, stride)
            i, j = i[chosen], j[chosen]

    def every(self, stride: tuple[int, int]) -> tuple[Nodes, Nodes]:
        """Return the nodes of a scan."""
        rows, columns = (np.arange(0, n, s) for n, s in zip(self.known.shape, stride, strict=True))
        i, j = np.meshgrid(rows, columns, indexing="ij")
        return i.ravel(), j.ravel()

    def _stencil(self, i: Nodes, j: Nodes, stride: tuple[int, int]) -> tuple[Nodes, Nodes]:
        """Return each node with its eight neighbours; those beyond an edge are moved onto it."""
        around = NEIGHBOURS * np.array(stride)
        return (
            np.clip(i[:, None] + around[:, 0], 0, self.first.size - 1),
            np.clip(j[:, None] + around[:, 1], 0, self.second.size - 1),
        )

    def _dips(self, i: Nodes, j: Nodes, stride: tuple[int, int]) -> NDArray[np.bool_]:
        """Mark minima of ``|f|`` without a sign change that are no further from zero than their neighbours differ."""
        near_i, near_j = self._stencil(i, j, stride)
        value, around = self.value[i, j], self.value[near_i, near_j]
        same = ((around >= 0.0) == (value >= 0.0)[:, None]).all(axis=1)
        size = np.abs(value)
        lowest = (np.abs(around) >= size[:, None]).all(axis=1)
        return np.asarray(same & lowest & (size <= np.abs(around - value[:, None]).max(axis=1)))

    def seeds(self) -> Edges:
        """Return an edge (direction, i, j) with a sign change for every two known neighbours in a line that differ."""
        found = []
        for direction in (ALONG_FIRST, ALONG_SECOND):
            known = self.known.T if direction == ALONG_FIRST else self.known
            line, place = np.nonzero(known)
            side = (self.value.T if direction == ALONG_FIRST else self.value)[line, place] >= 0.0
            differ = np.flatnonzero((line[1:] == line[:-1]) & (side[1:] != side[:-1]))
            low = self._bisect(direction, line[differ], place[differ], place[differ + 1])
            i, j = (low, line[differ]) if direction == ALONG_FIRST else (line[differ], low)
            found.append(np.stack([np.full(low.size, direction), i, j], axis=1))
        return np.concatenate(found)

    def _bisect(self, direction: int, line: Nodes, low: Nodes, high: Nodes) -> Nodes:
        """Return the lower node of an edge with a sign change between two nodes that differ."""
        low, high = low.copy(), high.copy()
        while low.size and (high - low).max() > 1:
            middle = (low + high) // 2
            if direction == ALONG_FIRST:
                self.need(middle, line)
                same = self.unstable(middle, line) == self.unstable(low, line)
            else:
                self.need(line, middle)
                same = self.unstable(line, middle) == self.unstable(line, low)
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        return low

    def trace(self, edges: Edges, visited: NDArray[np.bool_]) -> None:
        """Follow the boundary from some edges through all cells that it crosses; marks these as visited."""
        cells = self._cells_beside(edges)
        while True:
            cells = np.unique(cells[~visited[cells[:, 0], cells[:, 1]]], axis=0)
            if not cells.size:
                return
            i, j = cells.T
            visited[i, j] = True
            for a, b in ((0, 0), (1, 0), (0, 1), (1, 1)):
                self.need(i + a, j + b)
            cells = self._cells_beside(self.crossed(i, j))

    def crossed(self, i: Nodes, j: Nodes) -> Edges:
        """Return the edges of cells that have a sign change."""
        sides = {(a, b): self.unstable(i + a, j + b) for a in (0, 1) for b in (0, 1)}
        found = []
        for direction, a, b in ((ALONG_FIRST, 0, 0), (ALONG_FIRST, 0, 1), (ALONG_SECOND, 0, 0), (ALONG_SECOND, 1, 0)):
            far = sides[1, b] if direction == ALONG_FIRST else sides[a, 1]
            at = np.flatnonzero(sides[a, b] != far)
            found.append(np.stack([np.full(at.size, direction), i[at] + a, j[at] + b], axis=1))
        return np.unique(np.concatenate(found), axis=0)

    def _cells_beside(self, edges: Edges) -> Nodes:
        """Return the one or two cells on either side of each edge."""
        direction, i, j = edges.T
        back = np.stack([i - (direction == ALONG_SECOND), j - (direction == ALONG_FIRST)], axis=1)
        cells = np.concatenate([edges[:, 1:], back])
        inside = (cells >= 0).all(axis=1) & (cells < np.array(self.known.shape) - 1).all(axis=1)
        return np.asarray(cells[inside])

    def roots(self, edges: Edges, tolerance: float) -> tuple[Real, Real]:
        """Return where the boundary crosses edges, to a share of the range of each axis."""
        direction, i, j = edges.T
        along = direction == ALONG_FIRST
        x, y = self.first[i], self.second[j]
        dx = np.where(along, self.first[np.minimum(i + 1, self.first.size - 1)] - x, 0.0)
        dy = np.where(along, 0.0, self.second[np.minimum(j + 1, self.second.size - 1)] - y)
        ends = self.value[i, j], self.value[i + along, j + ~along]
        cells = np.where(along, self.first.size - 1, self.second.size - 1)
        share = shares(lambda t, k: self.at(x[k] + t * dx[k], y[k] + t * dy[k]), *ends, tolerance * cells)
        return x + share * dx, y + share * dy


def shares(function: Callable[[Real, Nodes], Real], at_low: Real, at_high: Real, tolerance: Real) -> Real:
    """Return the root of many functions in 0..1 at once, each between ends of unlike sign.

    Chandrupatla's bracketing: inverse quadratic interpolation where it is safe, else bisection; the bracket itself
    shrinks below the tolerance. Source: Chandrupatla 1997.

    Parameters
    ----------
    function : callable
        (positions, numbers of the functions) -> values.
    at_low, at_high : ndarray
        Values at 0 and at 1.
    tolerance : ndarray
        Largest error of each root.
    """
    a, b, c = np.ones_like(at_low), np.zeros_like(at_low), np.ones_like(at_low)
    fa, fb, fc = at_high.copy(), at_low.copy(), at_high.copy()
    with np.errstate(divide="ignore", invalid="ignore"):
        t = np.clip(fa / (fa - fb), 0.0, 1.0)
    t = np.where(np.isfinite(t), t, 0.5)
    open_ = np.flatnonzero(np.abs(a - b) > tolerance)
    while open_.size:
        k = open_
        least = np.minimum(0.5, 0.5 * tolerance[k] / np.abs(b[k] - a[k]))
        x = a[k] + np.clip(t[k], least, 1.0 - least) * (b[k] - a[k])
        fx = function(x, k)
        same = (fx >= 0.0) == (fa[k] >= 0.0)
        c[k], fc[k] = np.where(same, a[k], b[k]), np.where(same, fa[k], fb[k])
        b[k], fb[k] = np.where(same, b[k], a[k]), np.where(same, fb[k], fa[k])
        a[k], fa[k] = x, fx
        t[k] = _next_share(a[k], b[k], c[k], fa[k], fb[k], fc[k])
        open_ = k[(np.abs(a[k] - b[k]) > tolerance[k]) & (fa[k] != 0.0)]
    with np.errstate(divide="ignore", invalid="ignore"):
        last = a + np.clip(fa / (fa - fb), 0.0, 1.0) * (b - a)
    return np.asarray(np.where(np.isfinite(last), last, a))


def _next_share(a: Real, b: Real, c: Real, fa: Real, fb: Real, fc: Real) -> Real:
    """Return where between a and b to look next: inverse quadratic interpolation where it is safe."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        xi, phi = (a - b) / (c - b), (fa - fb) / (fc - fb)
        safe = (phi**2 < xi) & ((1.0 - phi) ** 2 < 1.0 - xi)
        t = fa / (fb - fa) * fc / (fb - fc) + (c - a) / (b - a) * fa / (fc - fa) * fb / (fc - fb)
    return np.asarray(np.where(safe & np.isfinite(t), t, 0.5))
