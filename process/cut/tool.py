"""The tool: diameter, teeth, where they sit and how far they stick out."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from process.errors import InputError
from process.types import Real
from process.units import check_diameter


@dataclass(frozen=True)
class Tool:
    """A milling tool, SI.

    Parameters
    ----------
    diameter : float
        Cutting diameter [m].
    teeth : int
        Number of teeth.
    approach_angle : float, optional
        Angle between cutting edge and feed plane [rad]; pi/2 for a shoulder mill.
    pitch_angles : tuple of float, optional
        Angles from each tooth to the next [rad]; they add up to 2 pi within their rounding. Default:
        equal.
    runout : tuple of float, optional
        Radial position of each tooth relative to the mean [m]. Default: zero.
    helix_angle : float, optional
        Helix angle of the edges [rad]. Default: straight edges.

    Raises
    ------
    InputError
        For impossible geometry.
    """

    diameter: float
    teeth: int
    approach_angle: float = math.pi / 2
    pitch_angles: tuple[float, ...] | None = None
    runout: tuple[float, ...] | None = None
    helix_angle: float = 0.0

    def __post_init__(self) -> None:
        """Refuse impossible geometry."""
        if not (self.diameter > 0.0 and math.isfinite(self.diameter)):
            raise InputError(f"the tool diameter is {self.diameter:g} m; it must be positive and finite")
        check_diameter(self.diameter)
        if self.teeth < 1 or self.teeth != int(self.teeth):
            raise InputError(f"the tool has {self.teeth:g} teeth; a whole number, at least one, is needed")
        if not 0.0 < self.approach_angle <= math.pi / 2 + 1e-12:
            raise InputError(
                f"the approach angle is {math.degrees(self.approach_angle):g} deg; it must be above 0 and at most 90"
            )
        if not 0.0 <= self.helix_angle < math.pi / 2:
            raise InputError(f"the helix angle is {math.degrees(self.helix_angle):g} deg; it must be in [0, 90)")
        self._check_per_tooth()

    def _check_per_tooth(self) -> None:
        for name, values in (("pitch_angles", self.pitch_angles), ("runout", self.runout)):
            if values is not None and len(values) != self.teeth:
                raise InputError(f"{name} has {len(values)} values for {self.teeth} teeth; give one a tooth")
            if values is not None and not all(map(math.isfinite, values)):
                raise InputError(f"{name} is {values}; give a finite number for each tooth")
        if self.pitch_angles is not None:
            total = math.degrees(sum(self.pitch_angles))
            allowed = self.teeth * (0.05 if float(np.ptp(self.pitch_angles)) < 1e-9 else 0.005)
            if abs(total - 360.0) > max(allowed, 0.01) + 1e-9 or min(self.pitch_angles) <= 0.0:
                raise InputError(f"the pitch angles add up to {total:g} deg; they must be positive and add up to 360")

    @property
    def equal_pitch(self) -> bool:
        """Whether all teeth are equally spaced: the same angle for each, or angles rounded to 0.01 deg around 360/Z."""
        if self.pitch_angles is None or float(np.ptp(self.pitch_angles)) < 1e-9:
            return True
        hundredths = 100.0 * np.degrees(self.pitch_angles)
        rounded = np.abs(hundredths - np.round(hundredths)).max() < 1e-6
        return bool(rounded and np.abs(hundredths - 36000.0 / self.teeth).max() < 1.01)

    @property
    def equal_radius(self) -> bool:
        """Whether no tooth stands out: the tool has no run-out."""
        return self.runout is None or float(np.ptp(self.runout)) == 0.0

    def tooth_angles(self) -> Real:
        """Return how far each tooth runs behind tooth 0 [rad], shape (teeth,)."""
        if self.pitch_angles is None or self.equal_pitch:
            return np.linspace(0.0, 2.0 * math.pi, self.teeth, endpoint=False)
        return np.concatenate([[0.0], np.cumsum(self.pitch_angles)[:-1]])

    def tooth_offsets(self) -> Real:
        """Return the radial position of each tooth relative to the mean [m], shape (teeth,)."""
        return np.zeros(self.teeth) if self.runout is None else np.asarray(self.runout, dtype=float)

    def tooth_passing_frequency(self, rotation: float) -> float:
        """Return the tooth passing frequency [Hz] at a spindle rotation [rad/s]."""
        return self.teeth * rotation / (2.0 * math.pi)
