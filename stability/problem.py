"""What is asked of a stability method: the cut, the speeds, and the compliance made ready for it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from process.cutting import CuttingCoefficients, directional_matrix
from process.engagement import Engagement
from process.errors import InputError
from process.labels import AXES, check_compliance, full_matrix
from process.tool import Tool

GAP_FACTOR = 1.5
"""A step longer than this many neighbouring steps is a gap: a logarithmic grid is not, a dropped row is."""


@dataclass(frozen=True)
class Cut:
    """The cut whose limit depth is asked: everything but depth and spindle speed.

    Parameters
    ----------
    tool : Tool
        Geometry of the tool.
    arc : Engagement
        Arc of engagement.
    coefficients : CuttingCoefficients
        Work material [N/m2]; edge coefficients do not regenerate and have no influence.
    """

    tool: Tool
    arc: Engagement
    coefficients: CuttingCoefficients

    def directional_matrix(self, order: int = 0) -> NDArray[np.complex128]:
        """Return harmonic `order` of the directional matrix [N/m2], shape (3, 3), per axial depth a_p."""
        return directional_matrix(self.tool, self.arc, self.coefficients, order)

    def require_equal_pitch(self, method: str) -> None:
        """Raise `InputError` when the teeth are not equally spaced.

        With unequal pitch the speed is no longer explicit in the averaged equation, and the averaged equation
        itself is unreliable on islands (theory 2.4): refusing is better than a wrong lobe.
        """
        if not self.tool.equal_pitch:
            degrees = ", ".join(f"{math.degrees(p):g}" for p in self.tool.pitch_angles or ())
            raise InputError(
                f"the tool has unequal pitch ({degrees} deg); the {method} method supports equally "
                "spaced teeth only. Use a time simulation, or leave "
                "pitch_angles out to treat the teeth as equally spaced"
            )


def check_spindle_speed(spindle_speed: ArrayLike) -> NDArray[np.float64]:
    """Return spindle speeds [rpm] as an array of shape (speeds,).

    Raises
    ------
    InputError
        When there is none, or one is not a positive finite number.
    """
    speed = np.atleast_1d(np.asarray(spindle_speed, dtype=float))
    if speed.ndim != 1 or speed.size == 0:
        raise InputError(f"spindle speeds of shape {speed.shape}; a list of at least one speed in rpm is needed")
    bad = ~(np.isfinite(speed) & (speed > 0.0))
    if bad.any():
        raise InputError(f"a spindle speed of {speed[bad][0]:g} rpm; speeds must be positive and finite")
    return speed


@dataclass(frozen=True)
class Samples:
    """A measured compliance on its own frequency grid, complete frequencies only.

    Parameters
    ----------
    frequency : ndarray, shape (n,)
        Frequencies above zero at which every entry is known [Hz].
    matrix : ndarray of complex, shape (n, 3, 3)
        Compliance [m/N]; entries that were not measured are zero.
    bridged : ndarray of bool, shape (n - 1,)
        Whether a method may interpolate between a sample and the next.
    warnings : tuple of str
        What the user must know about the data.
    """

    frequency: NDArray[np.float64]
    matrix: NDArray[np.complex128]
    bridged: NDArray[np.bool_]
    warnings: tuple[str, ...]


def complete_samples(compliance: xr.Dataset) -> Samples:
    """Return the samples of a compliance at which all measured entries are finite.

    Raises
    ------
    InputError
        When the dataset holds no compliance, holds more than one (a condition such as ``feed`` is still a
        dimension), or has fewer than two complete frequencies.
    """
    array = check_compliance(compliance)["compliance"]
    extra = [str(d) for d in array.dims if d not in ("frequency", "response", "excitation")]
    if extra:
        values = ", ".join(f"{v}" for v in array[extra[0]].values)
        raise InputError(
            f"the compliance still has the dimension '{extra[0]}' ({values}); choose one, "
            f"e.g. compliance.sel({extra[0]}=...)"
        )
    every = compliance["frequency"].values.astype(float)
    full = full_matrix(compliance)
    complete = np.isfinite(full).all(axis=(1, 2)) & (every > 0.0)
    if complete.sum() < 2:
        raise InputError(
            f"the compliance is complete at {int(complete.sum())} of {every.size} frequencies above 0 Hz; "
            "at least 2 are needed. Drop the response or excitation that is NaN, or measure it"
        )
    frequency = every[complete]
    masked_between = np.diff(np.flatnonzero(complete)) > 1
    bridged = ~(masked_between | _long_steps(frequency))
    warnings = [*_partial_warning(compliance), *_gap_warnings(frequency, bridged)]
    return Samples(frequency, full[complete], bridged, tuple(warnings))


def _long_steps(frequency: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Mark the steps that are longer than `GAP_FACTOR` times the longer of their neighbours."""
    step = np.diff(frequency)
    if step.size < 2:
        return np.zeros(step.size, dtype=bool)
    before = np.concatenate([[0.0], step[:-1]])
    after = np.concatenate([step[1:], [0.0]])
    return np.asarray(step > GAP_FACTOR * np.maximum(before, after), dtype=bool)


def _partial_warning(compliance: xr.Dataset) -> list[str]:
    """Name what is taken as rigid."""
    missing = [
        f"{dim} {', '.join(a for a in AXES if a not in compliance[dim].values)}"
        for dim in ("response", "excitation")
        if len(set(compliance[dim].values)) < len(AXES)
    ]
    if not missing:
        return []
    return [
        f"the compliance is a partial matrix (no {'; no '.join(missing)}): cross terms and directions that "
        "were not measured are taken as rigid, which can change the limit by 30 to 60 %"
    ]


def _gap_warnings(frequency: NDArray[np.float64], bridged: NDArray[np.bool_]) -> list[str]:
    """Say which bands are missing, in one sentence."""
    gaps = np.flatnonzero(~bridged)
    if gaps.size == 0:
        return []
    bands = [f"{frequency[i]:.6g} to {frequency[i + 1]:.6g} Hz" for i in gaps[:5]]
    more = f" and {gaps.size - 5} more" if gaps.size > 5 else ""
    return [
        f"the compliance is missing between its samples in {gaps.size} band(s): {', '.join(bands)}{more}; "
        "no limit with a chatter frequency there is found"
    ]
