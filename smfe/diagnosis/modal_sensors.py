"""What the sensors make of a compliance: gains and signs, exchanged and turned axes, a time skew."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from smfe.diagnosis.modal_causes import AXES, PLANES
from smfe.diagnosis.problem import Values

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

_NAMES = (
    *(f"{what}_{a}" for what in ("gain", "turned") for a in AXES),
    *(f"exchanged_{a}{b}" for a, b in PLANES),
)
SEEN = (*_NAMES, "gain_force", "skew")
"""Parameters of the sensors."""


def seen(phi: Complex, frequency: Real, values: Values, accelerometer: bool = True) -> Complex:
    """Return a compliance (f, 3, 3) as the sensors show it.

    Parameters
    ----------
    phi : ndarray, shape (f, 3, 3)
        At the tool [m/N].
    frequency : ndarray, shape (f,)
        [Hz].
    values : mapping
        ``gain_force``, ``gain_x`` ..., ``exchanged_xy`` ..., ``turned_x`` ... [rad], ``skew`` [s].
    accelerometer : bool, optional
        Whether the motion is seen by the accelerometer, or by a laser that shares none of its faults.
    """
    factor = 1.0 + values.get("gain_force", 0.0)
    out = phi * factor if factor != 1.0 else phi
    if accelerometer and any(values.get(n, 0.0) for n in _NAMES):
        out = mounting(values) @ out
    skew = values.get("skew", 0.0)
    return out * np.exp(-2j * np.pi * frequency * skew)[:, None, None] if skew else out


def mounting(values: Values) -> Real:
    """Matrix from the motion to what the channels x, y, z of the accelerometer show: turned, exchanged, scaled."""
    x, y, z = (values.get(f"turned_{a}", 0.0) for a in AXES)
    out = _about(0, x) @ _about(1, y) @ _about(2, z) if x or y or z else np.eye(3)
    for a, b in PLANES:
        if values.get(f"exchanged_{a}{b}", 0.0) > 0.5:
            rows = [AXES.index(a), AXES.index(b)]
            out[rows] = out[rows[::-1]]
    for i, a in enumerate(AXES):
        out[i] *= 1.0 + values.get(f"gain_{a}", 0.0)
    return out


def _about(axis: int, angle: float) -> Real:
    """Rotation about an axis [rad]."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    out = np.eye(3)
    out[i, i] = out[j, j] = math.cos(angle)
    out[i, j], out[j, i] = -math.sin(angle), math.sin(angle)
    return out
