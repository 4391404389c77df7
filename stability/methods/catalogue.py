"""The stability methods that a campaign asks for by name: a new one is a file of this room and a line in `METHODS`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import xarray as xr

from stability.methods.multi_frequency import multi_frequency
from stability.methods.semi_discretization import semi_discretization
from stability.methods.zero_order import zero_order


@dataclass(frozen=True)
class StabilityMethod:
    """A method from a machine and a cut to limit depths.

    Parameters
    ----------
    limits : callable
        (compliance or modes, tool, arc, coefficients, spindle_speed [rpm], process_damping) -> a data set with
        ``limit_depth`` [mm], ``chatter_frequency`` [Hz] and ``lobe`` over ``spindle_speed``.
    takes : {"compliance", "modes", "either"}
        What it works on: a measured compliance; modes, fitted to the compliance where none are declared; modes where
        they are declared and the compliance elsewhere.
    """

    limits: Callable[..., xr.Dataset]
    takes: str

    def of(self, compliance: xr.Dataset, modes: Any | None) -> xr.Dataset | Any | None:
        """Return what the method works on; None where it needs modes and there are none."""
        if self.takes == "compliance" or (self.takes == "either" and modes is None):
            return compliance
        return modes


METHODS = {
    "zero_order": StabilityMethod(zero_order, "compliance"),
    "multi_frequency": StabilityMethod(multi_frequency, "either"),
    "semi_discretization": StabilityMethod(semi_discretization, "modes"),
}
