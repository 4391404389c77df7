"""Compliances over force level and feed: each combination as a line of the figures that measurements have.

Colour stands for the first condition, from dark to light as it grows, dashes for the second.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
import xarray as xr
from matplotlib import colormaps
from matplotlib.colors import to_hex

from process.labels import UNITS
from smfe.reporting.content.results import Measurement
from smfe.reporting.content.style import Line, number

_DASHES = ("solid", "dash", "dot", "dashdot")
_LIGHTEST = 0.85
"""Where the scale of colours ends: what is beyond cannot be seen on white."""

_ENTRY = ("frequency", "response", "excitation")


@dataclass(frozen=True)
class Cube:
    """One group of conditions.nc.

    Parameters
    ----------
    name : str
        "hammer, controller K2".
    cells : tuple of Measurement
        One a combination of conditions that was measured, "100 N, 500 mm/min".
    looks : mapping of str to Line
        How each looks.
    """

    name: str
    cells: tuple[Measurement, ...]
    looks: Mapping[str, Line]


def cubes(groups: Mapping[str, xr.Dataset]) -> list[Cube]:
    """Return the groups that hold anything."""
    found = [_cube(name, dataset) for name, dataset in groups.items()]
    return [cube for cube in found if cube.cells]


def _cube(name: str, dataset: xr.Dataset) -> Cube:
    dims = [str(d) for d in dataset["compliance"].dims if d not in _ENTRY]
    values = [dataset[d].values.astype(float) for d in dims]
    cells, looks = [], {}
    for at in product(*(range(v.size) for v in values)):
        said = ", ".join(f"{number(v[k])} {UNITS[d]}" for d, v, k in zip(dims, values, at, strict=True))
        cell = Measurement(said, "", dataset.isel(dict(zip(dims, at, strict=True))))
        if cell.entries:
            cells.append(cell)
            looks[said] = Line(_colour(at[0], values[0].size), _DASHES[at[1] % 4 if len(at) > 1 else 0])
    return Cube(name, tuple(cells), looks)


def _colour(place: int, count: int) -> str:
    return to_hex(colormaps["viridis"](_LIGHTEST * place / max(count - 1, 1)))


def largest_changes(cube: Cube) -> list[str]:
    """Say for each entry between which compliances its magnitude peaks, and at which conditions."""
    out = []
    for pair in dict.fromkeys(p for cell in cube.cells for p in cell.entries):
        tops = {c.name: _top(c, pair) for c in cube.cells if pair in c.entries}
        low, high = min(tops, key=lambda n: tops[n][0]), max(tops, key=lambda n: tops[n][0])
        if len(tops) > 1:
            ends = [f"{number(1e6 * tops[n][0], 3)} µm/N at {number(tops[n][1])} Hz ({n})" for n in (low, high)]
            out.append(f"Largest magnitude of {pair[0]}{pair[1]}: from {ends[0]} to {ends[1]}.")
    return out


def _top(cell: Measurement, pair: tuple[str, str]) -> tuple[float, float]:
    size = np.nan_to_num(np.abs(cell.entry(*pair)))
    at = int(np.argmax(size))
    return float(size[at]), float(cell.frequency[at])
