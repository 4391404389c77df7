"""The tool: diameter, teeth, where they sit and how far they stick out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from process.errors import InputError
from process.notebook import html_table
from process.types import Real
from process.units import check_diameter, si

MOST_TEETH = 1000
"""More teeth than any milling tool or saw has."""


@dataclass(frozen=True, init=False)
class Tool:
    """A milling tool. Numbers are SI; texts carry their unit, as in a campaign file: ``Tool("80 mm", 4)``.

    Parameters
    ----------
    diameter : float or str
        Cutting diameter [m].
    teeth : int
        Number of teeth.
    approach_angle : float or str, optional
        Angle between cutting edge and feed plane [rad]; pi/2 for a shoulder mill.
    pitch_angles : sequence of (float or str), optional
        Angles from each tooth to the next [rad]; they add up to 2 pi within their rounding. Default:
        equal.
    runout : sequence of (float or str), optional
        Radial position of each tooth relative to the mean [m]. Default: zero.
    helix_angle : float or str, optional
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

    def __init__(
        self,
        diameter: float | str,
        teeth: int,
        approach_angle: float | str = math.pi / 2,
        pitch_angles: Sequence[float | str] | None = None,
        runout: Sequence[float | str] | None = None,
        helix_angle: float | str = 0.0,
    ) -> None:
        """Turn texts into SI and refuse impossible geometry."""
        values = {
            "diameter": si(diameter, "length"),
            "teeth": teeth,
            "approach_angle": si(approach_angle, "angle"),
            "pitch_angles": None if pitch_angles is None else tuple(si(a, "angle") for a in pitch_angles),
            "runout": None if runout is None else tuple(si(r, "length") for r in runout),
            "helix_angle": si(helix_angle, "angle"),
        }
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._check()

    def _check(self) -> None:
        if not (self.diameter > 0.0 and math.isfinite(self.diameter)):
            raise InputError(f"the tool diameter is {self.diameter:g} m; it must be positive and finite")
        check_diameter(self.diameter)
        if not isinstance(self.teeth, int | float | np.number):
            raise InputError(f"the tool has {self.teeth!r} teeth; a whole number, at least one, is needed")
        if self.teeth < 1 or self.teeth != int(self.teeth):
            raise InputError(f"the tool has {self.teeth:g} teeth; a whole number, at least one, is needed")
        if self.teeth > MOST_TEETH:
            raise InputError(f"the tool has {self.teeth:g} teeth, more than any milling tool ({MOST_TEETH})")
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

    def _repr_html_(self) -> str:
        """Return a table for a notebook."""
        rows: list[tuple[object, ...]] = [
            ("diameter", 1e3 * self.diameter, "mm"),
            ("teeth", self.teeth, ""),
            ("approach angle", math.degrees(self.approach_angle), "deg"),
            ("helix angle", math.degrees(self.helix_angle), "deg"),
        ]
        if self.pitch_angles is not None:
            rows.append(("pitch angles", ", ".join(f"{math.degrees(a):.6g}" for a in self.pitch_angles), "deg"))
        if self.runout is not None:
            rows.append(("runout", ", ".join(f"{1e6 * r:.6g}" for r in self.runout), "µm"))
        return html_table("Tool", rows)

    def tooth_passing_frequency(self, rotation: float) -> float:
        """Return the tooth passing frequency [Hz] at a spindle rotation [rad/s]."""
        return self.teeth * rotation / (2.0 * math.pi)
