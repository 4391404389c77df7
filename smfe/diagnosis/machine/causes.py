"""What the baseline of a machine with feed axes may lack: of its guideways and drives, and of modes and sensors.

Gains, dead times and masses that somebody declared are no causes of their own: they are nuisances that the inference
releases and names where they are wrong. Here stand those that nobody declared, and what nests the baseline.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from smfe.diagnosis.inference.problem import Cause, Parameter
from smfe.diagnosis.machine.axes import DeclaredAxis
from smfe.diagnosis.machine.rules import RULES


def axis_causes(axes: Mapping[str, DeclaredAxis], slowest: float = 0.0) -> tuple[Cause, ...]:
    """Return what guideways may do that the baseline does not say, seen at feeds from the slowest on [m/s]."""
    smooth = [a for a, axis in axes.items() if not axis.sticks]
    found = []
    if smooth:
        starts = tuple(tuple(np.repeat((0.7, 100.0, v), len(smooth)).tolist()) for v in (4e-3, 1e-2))
        title = "guideways that hold the slides at rest, and friction that falls with speed"
        parameters = (*(_hold(a) for a in smooth), *(_fall(a) for a in smooth), *(_speed(a, slowest) for a in smooth))
        found.append(Cause("guideway_friction", title, parameters, "stribeck", starts=starts))
    if axes:
        apart = tuple(
            Parameter(f"friction_asymmetry_{a}", "%", 0.0, 0.05, -0.9, 0.9, shown=100.0)
            for a, axis in axes.items()
            if axis.sticks or axis.friction is not None
        )
        if apart:
            found.append(Cause("friction_asymmetry", "friction that differs between the directions", apart))
    return tuple(found)


def _hold(axis: str) -> Parameter:
    return Parameter(f"hold_{axis}", "%", 0.0, 0.05, 0.0, 0.9999, shown=100.0, secondary=True)


def _fall(axis: str) -> Parameter:
    return Parameter(f"fall_{axis}", "N", 0.0, 20.0, 0.0, 1e5)


def _speed(axis: str, slowest: float) -> Parameter:
    # Friction that has fallen long before the slowest feed is not seen: any force would do, and no fit of it ends.
    low = min(max(slowest / 3.0, 5e-4), 4e-3)
    known = (RULES.stribeck[1], 6e4)
    return Parameter(f"stribeck_speed_{axis}", "mm/min", RULES.stribeck[0], 2e-3, low, 0.1, *known, secondary=True)
