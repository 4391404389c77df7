"""Whether the zero order, with which gains are searched, holds for the cut; where it need not, a method that does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from process.cut.force import directional_matrix
from process.drive.servo import Servo
from process.errors import InputError
from process.machine.operating_point import OperatingPoint
from process.types import Complex, Real
from smfe.limits.cut_conditions import rotation
from smfe.tuning.plants import ModelSource
from smfe.tuning.task import Task
from stability import multi_frequency, semi_discretization

SPEEDS = 5
"""Spindle speeds at which the answer is confirmed, beside that of the least depth."""

_HARMONICS = 8
_ZERO = 1e-9


def constant_factor(task: Task, directions: tuple[int, ...]) -> bool:
    """Return whether the directional factor of the cut does not change while the teeth pass: zero order is then exact.

    It does where all its harmonics vanish in the directions in which the tool gives way, as in a slot with four
    straight teeth: ``cos`` and ``sin`` of twice the angle cancel.
    """
    if task.tool.helix_angle > 0.0 or not task.tool.equal_pitch:
        return False
    at = np.ix_(directions, directions)
    mean = np.abs(task.directional[at]).max()
    turned = [
        np.abs(_turned(task, directional_matrix(task.tool, task.arc, task.coefficients, r))[at]).max()
        for r in range(1, _HARMONICS + 1)
    ]
    return bool(max(turned) <= _ZERO * mean)


def _turned(task: Task, matrix: Complex) -> Complex:
    turn = rotation(task.feed_direction)
    return np.asarray(turn.T @ matrix @ turn)


def with_servos(source: ModelSource, servos: tuple[Servo, ...]) -> OperatingPoint:
    """Return the machine of a source with servos for the axes that are tuned."""
    own = dict(zip(source.axes, servos, strict=True))
    slides = tuple(replace(s, servo=own.get(s.name, s.servo)) for s in source.point.slides)
    return replace(source.point, slides=slides)


class _Turned:
    """A machine seen in the axes of the cut."""

    def __init__(self, point: OperatingPoint, task: Task) -> None:
        self.point, self.turn = point, rotation(task.feed_direction)

    def state_space(self) -> tuple[Real, Real, Real]:
        """Return A, B, C with force and displacement in the axes of the cut."""
        a, b, c = self.point.state_space()
        return a, b @ self.turn.T, self.turn @ c


def confirmed(
    task: Task, servos: tuple[Servo, ...], compliance: xr.Dataset, zero: xr.Dataset
) -> tuple[xr.Dataset | None, str]:
    """Return limits of an answer by a method that takes the changing factor in, and a sentence about them.

    Semi-discretisation for a model (a dead time as a Pade fraction of order 6), the multi-frequency solution for a
    measured compliance; at the speed of the least depth and some others. None where no method takes the tool.

    Parameters
    ----------
    task : Task
        With the cut.
    servos : tuple of Servo
        The answer, a servo for each axis.
    compliance : xarray.Dataset
        Of the tool with these servos, in the axes of the cut.
    zero : xarray.Dataset
        Zero-order limits, over the speeds of the goal.
    """
    speed, depth = zero["spindle_speed"].values, zero["limit_depth"].values
    low, high = min(task.goal.speeds), max(task.goal.speeds)
    inside = (speed >= low) & (speed <= high)
    worst = float(speed[inside][np.argmin(depth[inside])])
    asked = np.unique(np.append(np.linspace(low, high, SPEEDS), worst))
    if task.goal.kind == "depths":
        asked = np.array(sorted(task.goal.speeds))
    try:
        if isinstance(task.source, ModelSource):
            method, machine = "semi-discretisation", _Turned(with_servos(task.source, servos), task)
            limits = semi_discretization(machine, task.tool, task.arc, task.coefficients, asked)
        else:
            method = "multi-frequency solution"
            limits = multi_frequency(compliance, task.tool, task.arc, task.coefficients, asked)
    except InputError as error:
        return None, f"the answer rests on the zero order alone, which is not exact for this cut: {error}"
    found = limits["limit_depth"].values
    expected = np.interp(asked, speed, np.minimum(depth, 1e6))
    at = int(found.argmin())
    return limits, (
        f"the directional factor of this cut changes while teeth pass; {method} gives a least depth of "
        f"{found[at]:.4g} mm at {asked[at]:.0f} rpm among {asked.size} speeds, where the zero order gives "
        f"{expected[at]:.4g} mm"
    )
