"""Master-slave preload of a double pinion: two motors on one rack push against each other, so that no play is left.

Equations, motors held, x the displacement of the rack from rest, restoring force positive along x. Each pinion is a
spring k_i behind a backlash g (its tooth is free for g between its two flanks); the preload presses the master's tooth
onto one flank with +P, the slave's onto the other with -P::

    R_1(x) = k_1 [max(0, x - P/k_1 - g) - max(0, P/k_1 - x)]           master
    R_2(x) = k_2 [max(0, x + P/k_2) - max(0, -x - P/k_2 - g)]          slave
    R(x)   = R_1 + R_2 = (k_1 + k_2) x    while -P/k_2 <= x <= P/k_1

Beyond, one pinion has lifted off, the other works alone, until after g more the first meets its other flank.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from process.errors import InputError
from process.joints import Joint

Real = NDArray[np.float64]


@dataclass(frozen=True)
class DoublePinion(Joint):
    """Rack between two pinions that are preloaded against each other.

    Master and slave may differ in stiffness. Without preload (P = 0) the teeth still rest on opposite flanks, so that
    there is no play: one pinion and a gap in parallel. Two motors that are not set against each other are a
    ``Gap(k_1 + k_2, g/2)``.

    Parameters
    ----------
    stiffness_master, stiffness_slave : float
        Transmission of each pinion, rack to held motor, k_1 and k_2 [N/m].
    gap : float
        Backlash g of a pinion [m], flank to flank, at the rack.
    preload : float
        Force P of each pinion on the rack at rest [N], zero or positive.

    Raises
    ------
    InputError
        When a stiffness is not positive, or the gap or the preload is negative.
    """

    stiffness_master: float
    stiffness_slave: float
    gap: float
    preload: float

    def __post_init__(self) -> None:
        """Refuse what is not two pinions."""
        for name, k in (("master", self.stiffness_master), ("slave", self.stiffness_slave)):
            if not 0.0 < k < math.inf:
                raise InputError(f"the stiffness of the {name} is {k:g} N/m; it must be positive and finite")
        if not (0.0 <= self.gap < math.inf and 0.0 <= self.preload < math.inf):
            raise InputError(
                f"gap {self.gap:g} m and preload {self.preload:g} N; both must be finite and not negative (the master "
                "pushes along +x, the slave against it)"
            )

    @classmethod
    def from_torque(
        cls, stiffness_master: float, stiffness_slave: float, gap: float, torque: float, radius: float
    ) -> DoublePinion:
        """Return the joint for a preload torque of each pinion [N m] at its pitch radius [m], ``P = torque/radius``."""
        if not 0.0 < radius < math.inf:
            raise InputError(f"the pitch radius is {radius:g} m; it must be positive")
        return cls(stiffness_master, stiffness_slave, gap, torque / radius)

    @property
    def lift_off_displacements(self) -> tuple[float, float]:
        """Displacements [m] at which the slave (below zero) and the master (above) lift off."""
        return -self.preload / self.stiffness_slave, self.preload / self.stiffness_master

    @property
    def lift_off_force(self) -> float:
        """Smallest force [N] that lifts a pinion off, ``P (k_1 + k_2)/max(k_1, k_2)``; 2 P for equal pinions."""
        total = self.stiffness_master + self.stiffness_slave
        return self.preload * total / max(self.stiffness_master, self.stiffness_slave)

    @property
    def flanks(self) -> tuple[tuple[float, float, float], ...]:
        """Stiffness k [N/m], side s = +-1, threshold d [m] of each flank; its force is ``k s max(0, s x - d)``."""
        k, c, p, g = self.stiffness_master, self.stiffness_slave, self.preload, self.gap
        return (k, 1.0, p / k + g), (k, -1.0, -p / k), (c, 1.0, -p / c), (c, -1.0, p / c + g)

    def force(self, displacement: ArrayLike) -> Real:
        """Return the restoring force [N] at displacements [m] of any shape, zero at rest."""
        x = np.asarray(displacement, dtype=float)
        return np.asarray(sum(k * side * np.maximum(side * x - d, 0.0) for k, side, d in self.flanks))

    def equivalent_stiffness(self, amplitude: ArrayLike, bias: ArrayLike = 0.0) -> Real:
        """Return the stiffness K [N/m] that a vibration ``b + X cos(w t)`` feels.

        A flank with threshold d adds ``k/pi (q - c sqrt(1 - c^2))``, with ``c = (d - b)/X`` between -1 and 1 and
        ``q = arccos c``.

        Parameters
        ----------
        amplitude : array_like
            X [m].
        bias : array_like, optional
            Mean displacement b [m]; that of a mean force is `bias_of`.
        """
        total = sum(k / np.pi * (q - c * s) for k, _, c, q, s in self._angles(amplitude, bias))
        return np.asarray(total, dtype=float)

    def mean_force(self, amplitude: ArrayLike, bias: ArrayLike) -> Real:
        """Return the mean force [N] of a vibration X [m] about b [m]: ``k X/pi (sin q - q cos q)`` a flank."""
        x = np.asarray(amplitude, dtype=float)
        total = sum(k * side * x / np.pi * (s - q * c) for k, side, c, q, s in self._angles(amplitude, bias))
        # A flank in contact all the time: c was clipped, and its mean is that of its own line.
        below = sum(k * side * np.maximum(-x - d + side * np.asarray(bias), 0.0) for k, side, d in self.flanks)
        return np.asarray(total + below, dtype=float)

    def bias_of(self, force: float, amplitude: float) -> float:
        """Return the mean displacement [m] under a mean force [N], such as a cutting force, at amplitude X [m]."""
        if not math.isfinite(force):
            raise InputError(f"the mean force is {force:g} N; it must be finite")
        weaker = min(self.stiffness_master, self.stiffness_slave)
        far = (abs(force) + self.preload) / weaker + self.gap + amplitude
        return float(
            optimize.brentq(lambda b: float(self.mean_force(amplitude, b)) - force, -far, far, xtol=1e-15 * far)
        )

    def _angles(self, amplitude: ArrayLike, bias: ArrayLike) -> list[tuple[float, float, Real, Real, Real]]:
        """For each flank: stiffness, side, c, q = arccos c and sin q."""
        x = np.asarray(amplitude, dtype=float)
        if not np.all(x > 0.0):
            raise InputError("an amplitude of vibration is not positive; give amplitudes > 0 in m")
        found = []
        for k, side, d in self.flanks:
            c = np.clip((d - side * np.asarray(bias, dtype=float)) / x, -1.0, 1.0)
            found.append((k, side, c, np.arccos(c), np.sqrt(1.0 - c**2)))
        return found
