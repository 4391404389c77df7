"""From a compliance measured at rest to the one in motion, without a modal fit.

At rest friction holds the slides; in motion the servo does. The tool moves as ``x = E s + r``, E the directions of the
slides, r what bends. With the measured idle compliance Phi and a mass m_tip at the tool,

    r = Phi (F + w^2 m_tip E s)                                    (Phi sees the inertia of its own base motion)
    (G + j w f' - w^2 M - w^4 m_tip^2 E^T Phi E) s = E^T T F,      T = I + w^2 m_tip Phi
    x = [Phi + T E (G + j w f' - w^2 M - w^4 m_tip^2 E^T Phi E)^-1 E^T T] F

with M the mass that moves with each axis, G the servo and f' the friction slope. Exact for a tool mass on massless
springs, of any compliance; a mode with other mass between tool and slide needs `process.structure.released_modes`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from process.errors import InputError
from process.friction_impedance import linearised
from process.labels import axis_index, check_compliance, make_compliance
from process.machine import FeedAxis


def released_compliance(
    idle: xr.Dataset,
    axes: Mapping[str, FeedAxis],
    moving_mass: Mapping[str, float],
    tip_mass: float,
    feed: float | Mapping[str, float] = 0.0,
    controller: str | None = None,
) -> xr.Dataset:
    """Return the compliance in motion that belongs to a compliance measured at rest.

    Parameters
    ----------
    idle : xarray.Dataset
        Measured ``compliance(frequency, response, excitation)`` at rest, responses and excitations on the same axes,
        the driven ones among them.
    axes : mapping
        Axis name -> servo and friction.
    moving_mass : mapping
        Axis name -> all mass that moves with the axis [kg], tip included.
    tip_mass : float
        Mass at the tool [kg]; of a two-mass axis ``M (1 - (f_antiresonance/f_resonance)^2)`` of its open loop.
    feed : float or mapping, optional
        Feed of all axes, or axis name -> feed [m/s].
    controller : str, optional
        Name of the controllers.

    Returns
    -------
    xarray.Dataset
        Compliance on the same frequencies and axes; an uncertainty is not carried over.

    Raises
    ------
    InputError
        When an axis was not measured or is fed but not named, a mass is missing or not positive, or 0 Hz is among the
        frequencies.
    """
    array = check_compliance(idle)["compliance"].transpose("frequency", "response", "excitation")
    names = [str(a) for a in array["response"].values]
    if names != [str(a) for a in array["excitation"].values]:
        raise InputError(
            f"responses {', '.join(names)} and excitations differ; a full matrix on the same axes is needed"
        )
    _check_axes(names, axes, moving_mass, tip_mass)
    feeds = _feeds(axes, feed)
    f = idle["frequency"].values
    if f[0] <= 0.0:
        raise InputError("the idle compliance holds 0 Hz, where a servo's integrator has no limit; leave it out")
    w = 2.0 * np.pi * f
    phi = array.values
    columns = [names.index(a) for a in axes]
    identity = np.eye(len(names))
    t = (identity + (w**2 * tip_mass)[:, None, None] * phi)[:, :, columns]
    base = _base_stiffness(w, axes, moving_mass, feeds, controller)
    base = base - (w**4 * tip_mass**2)[:, None, None] * phi[:, columns][:, :, columns]
    # T^T with the transposed Phi: what is measured need not be reciprocal to the last digit.
    back = (identity + (w**2 * tip_mass)[:, None, None] * phi)[:, columns, :]
    moving = phi + t @ np.linalg.solve(base, back)
    return make_compliance(f, moving, names, names, attrs=dict(idle.attrs))


def _check_axes(
    names: list[str], axes: Mapping[str, FeedAxis], moving_mass: Mapping[str, float], tip_mass: float
) -> None:
    axis_index(list(axes))
    for axis in axes:
        if axis not in names:
            raise InputError(f"axis {axis} moves but was not measured; the compliance has {', '.join(names)}")
        if axis not in moving_mass or not tip_mass < moving_mass[axis] < math.inf:
            raise InputError(
                f"axis {axis} has moving mass {moving_mass.get(axis)} kg; give all that moves with it, more than the "
                f"tip mass of {tip_mass:g} kg"
            )
    if not tip_mass > 0.0:
        raise InputError(f"the tip mass is {tip_mass:g} kg; it must be positive")


def _feeds(axes: Mapping[str, FeedAxis], feed: float | Mapping[str, float]) -> dict[str, float]:
    """Return the feed of each axis [m/s]; a plain value moves all."""
    given = feed if isinstance(feed, Mapping) else dict.fromkeys(axes, feed)
    strangers = [a for a in given if a not in axes]
    if strangers or not all(math.isfinite(v) for v in given.values()):
        raise InputError(f"feed {dict(given)} m/s; finite numbers are needed, for the axes {', '.join(axes)}")
    return {a: float(given.get(a, 0.0)) for a in axes}


def _base_stiffness(
    w: NDArray[np.float64],
    axes: Mapping[str, FeedAxis],
    moving_mass: Mapping[str, float],
    feeds: Mapping[str, float],
    controller: str | None,
) -> NDArray[np.complex128]:
    """``G + j w f' - w^2 M`` of each slide, shape (f, axes, axes), diagonal."""
    out = np.zeros((w.size, len(axes), len(axes)), dtype=np.complex128)
    s = 1j * w
    for i, (name, axis) in enumerate(axes.items()):
        servo = axis.controller(controller)
        held = linearised(axis.friction, feeds[name])(s) - w**2 * moving_mass[name]
        out[:, i, i] = held if servo is None else held + servo.feedback(s)
    return out
