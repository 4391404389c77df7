"""The force that a dynamometer measures, and the force on its plate from it.

The plate with the work (or the tool) of mass m sits on the springs of the sensor, which measures the force in them:
``F_meas = H (F - m a)`` with ``H = 1/(1 - r^2 + 2 j zeta r)``, ``r = f/f_d`` and the acceleration a of what the sensor
stands on; so ``F = F_meas/H + m a``. Without mass the second term is none, with a high f_d the first is the force
itself: at 40 Hz a resonance of 400 Hz makes forces 1 % too large.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy import fft

from process.errors import InputError
from process.labels import AXES, axis_present, sample_interval
from process.types import Complex, Real

BAND = 0.7
"""Share of the natural frequency up to which the resonance is compensated; above it the factor stays as it is there."""


@dataclass(frozen=True)
class Dynamometer:
    """A force sensor with mass and a resonance.

    Parameters
    ----------
    mass : float, optional
        m [kg], moving with the measured acceleration.
    frequency : float or (float, float, float), optional
        f_d [Hz], of all axes or of x, y and z; default: rigid.
    damping : float, optional
        zeta [1].

    Raises
    ------
    InputError
        For a negative mass or damping, or a frequency that is not positive.
    """

    mass: float = 0.0
    frequency: float | tuple[float, float, float] = math.inf
    damping: float = 0.02

    def __post_init__(self) -> None:
        """Refuse what is no sensor."""
        each = np.broadcast_to(np.asarray(self.frequency, dtype=float), 3)
        if not (0.0 <= self.mass < math.inf and np.all(each > 0.0) and 0.0 <= self.damping < math.inf):
            raise InputError(
                f"a dynamometer of {self.mass:g} kg, {self.frequency} Hz and a damping of {self.damping:g}; mass and "
                "damping are zero or more, the natural frequency is positive"
            )

    def inverse_response(self, frequency: ArrayLike, axis: str) -> Complex:
        """Return ``1/H`` at frequencies [Hz], held above `BAND` of the natural frequency."""
        natural = float(np.broadcast_to(np.asarray(self.frequency, dtype=float), 3)[AXES.index(axis)])
        r = np.minimum(np.asarray(frequency, dtype=float) / natural, BAND)
        return np.asarray(1.0 - r**2 + 2j * self.damping * r)


def compensate(record: xr.Dataset, dynamometer: Dynamometer) -> xr.Dataset:
    """Return the record with the force that acted, from the force that was shown.

    Parameters
    ----------
    record : xarray.Dataset
        Forces, and acceleration or displacement on the same axes where the sensor has mass.
    dynamometer : Dynamometer
        The sensor.

    Raises
    ------
    InputError
        When the sensor has mass and an axis with force has no motion.
    """
    axes = axis_present(record, "force")
    dt, n = sample_interval(record), record.sizes["time"]
    length = int(fft.next_fast_len(n, real=True))
    frequency = fft.rfftfreq(length, dt)
    force = record["force"].copy(deep=True)
    for axis in axes:
        shown = force.sel(axis=axis).values
        acted = fft.irfft(fft.rfft(shown, length) * dynamometer.inverse_response(frequency, axis), length)[:n]
        if dynamometer.mass > 0.0:
            acted = acted + dynamometer.mass * _acceleration(record, axis, frequency, length)
        force.loc[{"axis": axis}] = acted
    return record.assign(force=force)


def _acceleration(record: xr.Dataset, axis: str, frequency: Real, length: int) -> Real:
    if "acceleration" in record and axis in axis_present(record, "acceleration"):
        return np.asarray(record["acceleration"].sel(axis=axis).values)
    if "displacement" in record and axis in axis_present(record, "displacement"):
        spectrum = fft.rfft(record["displacement"].sel(axis=axis).values, length)
        return np.asarray(fft.irfft(-((2.0 * np.pi * frequency) ** 2) * spectrum, length)[: record.sizes["time"]])
    raise InputError(
        f"the mass of the dynamometer needs its acceleration, and the record has no motion along {axis}; declare "
        f"acceleration_{axis} in [channels], or leave the mass out"
    )
