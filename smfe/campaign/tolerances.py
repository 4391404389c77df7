"""``[tolerances]``: how well a workshop measures and knows what it declares, and what is too small to matter."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from smfe.campaign import quantities as q
from smfe.campaign.tables import Table

_DEGREE = math.pi / 180.0

Lean = Annotated[float, q.quantity("angle", low=0.0)]
Reach = Annotated[float, q.quantity("length", low=0.0)]


@dataclass(frozen=True)
class Tolerances:
    """Standard deviations (one sigma, SI) of ordinary imperfections; defaults are those of a workshop.

    Parameters
    ----------
    hit_direction, setup_direction : float
        By which a single hit, and all hits of one set-up together, lean from their axis [rad].
    hit_position : float
        By which a hit misses its point [m].
    sensor_position : float
        By which the accelerometer is beside the point that is hit [m].
    cross_talk : float
        What a sensor shows of the other directions [1].
    sensor_gain : float
        Calibration of force sensors and accelerometers [1].
    mounting_angle : float
        By which a sensor is turned [rad].
    clock : float
        Time between the recorders of force and motion [s].
    hum : float
        Mains hum and its harmonics over the rms of a channel [1].
    mode_direction : float
        By which the direction of a mode that is declared is off [rad].
    declared_mass : float
        Masses that are declared [1].
    declared_friction : float
        Sliding and static friction that are declared of an axis that is hit [1].
    control_gain : float
        Gains of a control [1].
    dead_time : float
        Dead time of a control loop, from the logged to the acting force [s]; of an axis that is hit the most that it is
        off by, as half a sample of the control is, evenly.
    coefficients : float
        Cutting coefficients, as ``[material] uncertainty`` states it [1].
    material : float
        Change of a limit depth, or of a force over its rms, from which on a misfit matters [1].
    """

    hit_direction: float = _DEGREE
    setup_direction: float = 1.5 * _DEGREE
    hit_position: float = 3e-3
    sensor_position: float = 3e-3
    cross_talk: float = 0.01
    sensor_gain: float = 0.01
    mounting_angle: float = _DEGREE
    clock: float = 20e-6
    hum: float = 0.01
    mode_direction: float = 2.0 * _DEGREE
    declared_mass: float = 0.1
    declared_friction: float = 0.02
    control_gain: float = 0.02
    dead_time: float = 1e-4
    coefficients: float = 0.1
    material: float = 0.05


class TolerancesTable(Table):
    """``[tolerances]``; what is left out has the default of `Tolerances`."""

    hit_direction: Lean | None = None
    setup_direction: Lean | None = None
    hit_position: Reach | None = None
    sensor_position: Reach | None = None
    cross_talk: q.Share | None = None
    sensor_gain: q.Share | None = None
    mounting_angle: Lean | None = None
    clock: q.NoTime | None = None
    hum: q.Share | None = None
    mode_direction: Lean | None = None
    declared_mass: q.Share | None = None
    declared_friction: q.Share | None = None
    control_gain: q.Share | None = None
    dead_time: q.NoTime | None = None
    material: q.Share | None = None

    def build(self, coefficients: float) -> Tolerances:
        """Return the tolerances; those of the cutting coefficients are stated with the material [1]."""
        stated = {name: value for name, value in self.model_dump().items() if value is not None}
        return Tolerances(**stated, coefficients=coefficients)
