"""Causes that a drive record can name besides friction: delay, cut-off force, gains, a command nobody logged."""

from __future__ import annotations

import numpy as np

from smfe.diagnosis.drive_signals import Real
from smfe.diagnosis.problem import Cause, Parameter

LONGEST_DELAY = 5e-3
"""Largest loop delay that is looked for [s]."""

DELAY = Cause(
    "loop_delay",
    "delay between command and force",
    (Parameter("loop_delay.delay", "ms", 0.0, 1e-4, 0.0, LONGEST_DELAY, shown=1e3),),
)


def excess(drive: Real, limit: float) -> Real:
    """Return what a drive force [N] has beyond a limit."""
    return drive - np.clip(drive, -limit, limit)


def saturation(peak: float, limit: float) -> Cause:
    """Return the cause that drive force beyond a limit never acts: what the limit is below the largest force [N]."""
    cut = Parameter("saturation.cut", "N", 0.0, peak - limit, low=0.0, high=0.95 * peak)
    return Cause("drive_saturation", "drive force that is cut off", (cut,), starts=((peak - limit,),))


SENSOR_GAIN = Cause(
    "sensor_gain",
    "gain of the force channel",
    (Parameter("force_gain.error", "%", 0.0, 0.01, -0.5, 1.0, shown=100.0),),
    kind="measurement",
)
SERVO_GAINS = Cause(
    "servo_gains",
    "gains of the controller",
    (
        Parameter("servo_gains.position", "%", 0.0, 0.01, -0.9, 9.0, shown=100.0),
        Parameter("servo_gains.velocity", "%", 0.0, 0.01, -0.9, 9.0, shown=100.0),
    ),
)
HIDDEN_COMMAND = Cause(
    "hidden_input", "command that was not logged", (Parameter("hidden.command", "N", 0.0, 1.0),), "command"
)
