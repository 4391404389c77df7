"""What a diagnosis compared, as panels that either renderer draws: measured, simulation, extended model, what is left.

The simulation is drawn as the campaign declares it; beside it, where no cause extends it, the best that it can do. The
curves are those of ``finding.nc`` (`smfe.diagnosis.story.curves`); nothing is computed anew.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import xarray as xr

from process.types import Complex, Real
from smfe.diagnosis.story.words import percent

MEASURED, SIMULATION, REFITTED, EXTENDED = (
    "measured",
    "simulation as declared",
    "simulation, refitted",
    "extended model",
)
WORDS = {"measured": MEASURED, "baseline": SIMULATION, "refitted": REFITTED, "extended": EXTENDED}
"""Variable of the curves -> what it is called."""

LOOKS = {
    MEASURED: ("#000000", "solid", 2.4),
    SIMULATION: ("#B35C00", "dash", 1.8),
    REFITTED: ("#009E73", "dot", 2.2),
    EXTENDED: ("#0072B2", "dot", 2.2),
}
"""Colour, dash and width of each line."""

MOST = 6
"""Conditions that are drawn, at most: those that were set aside, then those of which the simulation misses most."""

MOST_MARKS = 250
"""Marks of a line, at most: each is an element of the page."""


@dataclass(frozen=True)
class Line:
    """A line of a panel."""

    word: str  # one of `LOOKS`
    x: Real
    y: Real
    marks: bool = False  # points in place of a line


@dataclass(frozen=True)
class Panel:
    """Lines over one axis."""

    label: str
    lines: tuple[Line, ...]
    log: bool = False


@dataclass(frozen=True)
class Block:
    """Panels one above the other over a common axis."""

    title: str
    note: str  # what no fit has seen, and how far both models are off
    x_label: str
    panels: tuple[Panel, ...]
    log_x: bool = False


def blocks(curves: xr.Dataset | None) -> tuple[Block, ...]:
    """Return what is drawn of the curves of a finding; nothing without them."""
    if curves is None:
        return ()
    makers = {
        "compliance": _compliances,
        "drive_force": _drive_forces,
        "cutting_force": _cutting_forces,
        "limit_depth": _limits,
    }
    return makers[str(curves.attrs["kind"])](curves)


def _models(curves: xr.Dataset) -> list[str]:
    """Return the models that are drawn: as declared, and the best of the others."""
    best = "extended" if "extended" in curves else "refitted"
    return [name for name in ("baseline", best) if name in curves]


def _shown(curves: xr.Dataset) -> list[xr.Dataset]:
    """Return the conditions that are drawn, in the order of the campaign."""
    error = curves["error_baseline"].values
    order = sorted(range(error.size), key=lambda i: (not curves["held_out"].values[i], -error[i]))
    chosen = sorted(order[:MOST])
    return [curves.isel(condition=i) for i in chosen]


def _note(one: xr.Dataset) -> str:
    errors = [f"{percent(float(one[f'error_{name}']))} %" for name in _models(one)]
    seen = "set aside, " if bool(one["held_out"]) else "left out of the fit, " if bool(one["unseen"]) else ""
    return f"{seen}error {' → '.join(errors)}"


def _known(one: xr.Dataset, over: str) -> xr.Dataset:
    return one.isel(point=np.flatnonzero(np.isfinite(one[over].values)))


def _compliances(curves: xr.Dataset) -> tuple[Block, ...]:
    found = []
    for one in _shown(curves):
        part = _known(one, "frequency")
        f, entries = part["frequency"].values, [str(e) for e in part["entry"].values]
        there = [e for e in entries if np.isfinite(part["measured"].sel(entry=e).values).any()]
        direct = [e for e in there if e[0] == e[-1]] or there[:1]
        panels = [
            Panel(
                f"|Φ {e}| [µm/N]",
                tuple(
                    Line(WORDS[name], f, 1e6 * np.abs(part[name].sel(entry=e).values))
                    for name in ("measured", *_models(curves))
                ),
                log=True,
            )
            for e in direct
        ]
        left = [Line(WORDS[name], f, 1e6 * _length(_left(part, name))) for name in _models(curves)]
        panels.append(Panel("what is left [µm/N]", tuple(left), log=True))
        found.append(Block(str(one["condition"].values), _note(one), "frequency [Hz]", tuple(panels)))
    return tuple(found)


def _left(part: xr.Dataset, name: str) -> Complex | Real:
    return np.asarray(part["measured"].values - part[name].values)


def _length(left: Complex | Real) -> Real:
    return np.asarray(np.sqrt(np.nansum(np.abs(left) ** 2, axis=-1)))


def _cutting_forces(curves: xr.Dataset) -> tuple[Block, ...]:
    found = []
    for one in _shown(curves):
        angle = one["angle"].values
        panels = [
            Panel(
                f"F {axis} [N]",
                tuple(Line(WORDS[n], angle, one[n].sel(entry=axis).values) for n in ("measured", *_models(curves))),
            )
            for axis in map(str, one["entry"].values)
        ]
        left = tuple(Line(WORDS[name], angle, _length(_left(one, name))) for name in _models(curves))
        panels.append(Panel("what is left [N]", left))
        found.append(Block(str(one["condition"].values), _note(one), "angle of the spindle [°]", tuple(panels)))
    return tuple(found)


def _drive_forces(curves: xr.Dataset) -> tuple[Block, ...]:
    """Return force over time of what was fitted and of what was set aside, and what is left over velocity."""
    found, held_out = [], curves["held_out"].values.astype(bool)
    for apart in sorted(set(held_out.tolist()), reverse=True):
        part = curves.isel(condition=np.flatnonzero(held_out == apart))
        part = part.isel(condition=np.argsort(part["time"].values[:, 0]))
        time, names = _joined(part["time"].values), ("measured", *_models(curves))
        time = time - np.nanmin(time)
        force = {name: _joined(part[name].values[:, :, 0]) for name in names}
        # Of each move the error is the mean over the ways in which it was left out; one of them is drawn.
        weight = np.nansum(part["measured"].values[:, :, 0] ** 2, axis=1)
        left = {name: force["measured"] - force[name] for name in names[1:]}
        squares = [np.average(part[f"error_{name}"].values ** 2, weights=weight) for name in left]
        errors = [f"{percent(float(np.sqrt(square)))} %" for square in squares]
        unseen = bool(part["unseen"].all())
        title = "moves set aside" if apart else "moves left out of the fit" if unseen else "moves that were fitted"
        over_time = (
            Panel("drive force [N]", tuple(Line(WORDS[n], time, y) for n, y in force.items())),
            Panel("what is left [N]", tuple(Line(WORDS[n], time, y) for n, y in left.items())),
        )
        found.append(Block(title, f"error {' → '.join(errors)}", "time [s]", over_time))
        if "velocity" in part:
            velocity = 6e4 * _joined(part["velocity"].values)
            some = slice(None, None, max(1, velocity.size // MOST_MARKS))
            marks = tuple(Line(WORDS[n], velocity[some], y[some], marks=True) for n, y in left.items())
            panel = Panel("what is left [N]", marks)
            found.append(Block(f"{title}: over the velocity", "", "velocity [mm/min]", (panel,)))
    return tuple(found)


def _joined(values: Real) -> Real:
    """Rows one after the other with a gap between them, without what lies behind their ends."""
    parts: list[Real] = []
    for row in values:
        parts += [row[np.isfinite(row)], np.array([np.nan])]
    return np.concatenate(parts)


def _limits(curves: xr.Dataset) -> tuple[Block, ...]:
    order = np.argsort(curves["spindle_speed"].values[:, 0])
    part = curves.isel(condition=order)
    speed = part["spindle_speed"].values[:, 0]
    depth = {name: part[name].values[:, 0, 0] for name in ("measured", *_models(curves))}
    left = {name: 100.0 * (depth[name] / depth["measured"] - 1.0) for name in _models(curves)}
    panels = (
        Panel("limit depth [mm]", tuple(Line(WORDS[n], speed, y, marks=n == "measured") for n, y in depth.items())),
        Panel("error [%]", tuple(Line(WORDS[n], speed, y) for n, y in left.items())),
    )
    apart = [f"{s:g} rpm" for s, held in zip(speed, part["held_out"].values, strict=True) if held]
    note = f"set aside: {', '.join(apart)}" if apart else ""
    return (Block("limit depths", note, "spindle speed [rpm]", panels),)
