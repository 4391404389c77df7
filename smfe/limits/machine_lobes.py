"""Lobes of the machine of ``[machine]`` by methods for linear machines: linearised at the feed of each cut.

At a feed each guideway moves with the slope of its friction there, servos with their dead time hold the axes, joints
have their small stiffness (`process.Machine.at`). To small vibration that is a linear machine. Where the feed follows
the spindle speed it is another at each speed. What friction does to large vibration `stability.operating_point` knows.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from process import units
from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.machine import Machine
from process.machine.operating_point import OperatingPoint
from process.types import Real
from smfe.campaign import LobeRequest
from smfe.limits.cut_conditions import rotation
from smfe.progress import Progress, silent
from stability.methods.catalogue import METHODS
from stability.problem import NO_LOBE

SMALL = (
    "these limits are those of a small disturbance, friction and joints linearised at the feed of each cut; "
    'method = "operating_point" tells what a kick does'
)
"""Said of the limits of a machine in motion by methods for linear machines."""

PADE_REACH = 4.0
"""Phase of a dead time [rad] up to which its Pade fraction of order 6 is right to 1 % of a radian."""

_MM_MIN = 6e4


@dataclass(frozen=True)
class FedMachine:
    """A machine at one operating point, seen in the axes of a cut.

    Parameters
    ----------
    point : OperatingPoint
        The machine, linearised.
    direction : float
        Direction in which the cut is fed, from +x towards +y [rad].
    """

    point: OperatingPoint
    direction: float = 0.0

    def state_space(self) -> tuple[Real, Real, Real]:
        """Return A, B, C of ``x' = A x + B F``, tool ``C x``, in the axes of the cut."""
        a, b, c = self.point.state_space()
        r = rotation(self.direction)
        return a, b @ r.T, r @ c


def place_of(text: str | None) -> float | None:
    """Return the position [m] of an axis; None where none is named.

    Raises
    ------
    InputError
        When it is no length.
    """
    if text is None:
        return None
    try:
        return units.parse(text, "length")
    except InputError as error:
        raise InputError(
            f'position {text!r} of [[lobes]]: the machine takes a length, e.g. "300 mm" ({error})'
        ) from error


def fed(machine: Machine, request: LobeRequest, feed: float) -> FedMachine:
    """Return a machine fed at a rate [m/s] along the direction of a request.

    Raises
    ------
    InputError
        When uniform motion at that feed is unstable, or it has no controller or position of that name.
    """
    along = {"x": math.cos(request.feed_direction), "y": math.sin(request.feed_direction)}
    feeds = {axis: feed * round(along.get(axis, 0.0), 12) for axis in machine.axes}
    point = machine.at(feeds, request.controller, place_of(request.position))
    point.require_stable()
    return FedMachine(point, request.feed_direction)


def machine_limits(
    machine: Machine,
    request: LobeRequest,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    progress: Progress = silent,
) -> xr.Dataset:
    """Return the limits of a machine in motion by a method for linear machines.

    Parameters
    ----------
    machine : Machine
        The machine of ``[machine]``.
    request : LobeRequest
        Method, speeds, feed, direction, controller, position.
    tool, arc, coefficients
        The cut.
    progress : callable, optional
        Called with (what, done, of).

    Returns
    -------
    xarray.Dataset
        As of the method, with ``feed(spindle_speed)`` [mm/min]; NaN where uniform motion is unstable.

    Raises
    ------
    InputError
        As the method.
    """
    speeds = request.spindle_speed
    feeds = np.full(speeds.size, request.feed or 0.0)
    if request.feed is None:
        feeds = request.feed_per_tooth * tool.teeth * speeds / 60.0
    limits = METHODS[request.method].limits
    cut = {"tool": tool, "arc": arc, "coefficients": coefficients, "process_damping": request.process_damping}
    parts, unknown, notes = list[xr.Dataset](), list[tuple[float, str]](), [SMALL]
    every = np.unique(feeds)
    for done, feed in enumerate(every):
        progress("limits at each feed", done, every.size)
        at = speeds[feeds == feed]
        try:
            here = fed(machine, request, float(feed))
        except InputError as error:
            if "uniform motion is unstable" not in str(error):
                raise
            unknown += [(float(n), str(error)) for n in at]
            continue
        notes += _late(here)
        parts.append(limits(here, spindle_speed=at, **cut))
    if unknown:
        notes.append(f"{len(unknown)} of {speeds.size} limits are not known, {unknown[0][0]:g} rpm: "
                     f"{unknown[0][1]}")  # fmt: skip
    notes += [w for part in parts for w in part.attrs["warnings"]]
    out = _joined(parts, speeds)
    out["feed"] = ("spindle_speed", _MM_MIN * feeds, {"units": "mm/min"})
    return out.assign_attrs(warnings=list(dict.fromkeys(notes)))


def _joined(parts: Sequence[xr.Dataset], speeds: Real) -> xr.Dataset:
    """Return the limits of several machines over all speeds, NaN at those that none has."""
    if not parts:
        none = ("spindle_speed", np.full(speeds.size, np.nan))
        data = {
            "limit_depth": none,
            "chatter_frequency": none,
            "lobe": ("spindle_speed", np.full(speeds.size, NO_LOBE)),
        }
        return xr.Dataset(data, {"spindle_speed": speeds})
    names = [name for name in parts[0] if "spindle_speed" in parts[0][name].dims]
    whole = xr.concat([part[names] for part in parts], "spindle_speed").sortby("spindle_speed")
    out = whole.reindex(spindle_speed=speeds, fill_value={"lobe": NO_LOBE, "kind": "none", "mode": 0, "steps": 0})
    return out.assign_attrs(parts[0].attrs)


def _late(here: FedMachine) -> list[str]:
    """Say where a dead time is too long for the fastest mode of the machine."""
    delays = [slide.servo.delay for slide in here.point.slides if slide.servo is not None]
    structure = here.point.structure  # with a dead time not all poles are known
    stiff = np.linalg.eigvals(np.linalg.solve(structure.mass, here.point.stuck_stiffness())).real
    fastest = math.sqrt(max(float(stiff.max(initial=0.0)), 0.0)) / (2.0 * math.pi)
    if 2.0 * math.pi * fastest * max(delays, default=0.0) <= PADE_REACH:
        return []
    return [
        f"the dead time of {1e3 * max(delays):g} ms is long for the mode at {fastest:.4g} Hz: it is a Pade fraction in "
        'these limits, and its phase there is not right; compare with method = "operating_point", which has it exactly'
    ]
