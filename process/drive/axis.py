"""One feed axis: a carriage held by a servo, and a flexible tip; its linear responses, poles and limits.

::

    m_t x_t'' = F_tip - k (x_t - x_m) - c (x_t' - x_m')
    m_m x_m'' = k (x_t - x_m) + c (x_t' - x_m') + F_servo(t - tau) - f(x_m')

Here the friction f is its slope sigma; `process.simulation.machine` takes the whole law.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from process.drive.servo import Plant, QuasiPolynomial, Servo, position_characteristic, require_stable
from process.errors import InputError
from process.labels import make_compliance
from process.types import Complex, Real


@dataclass(frozen=True)
class Drive:
    """Two masses and a servo: Figure 10 of Franco et al. 2024 (JMMP 8/5/207).

    Parameters
    ----------
    moving_mass : float
        Carriage with the motor's moving part, m_m [kg].
    tip_mass : float
        Mass that vibrates on it, m_t [kg].
    stiffness : float
        Between the two, k [N/m].
    damping : float
        Between the two, c [N s/m].
    servo : Servo, optional
        None: the carriage is free (K_p = 0).
    sigma : float, optional
        Friction slope df/dv at the operating point [N s/m]; negative on the falling part of a Stribeck curve.

    Raises
    ------
    InputError
        When a mass or the stiffness is not positive, or the damping is negative.
    """

    moving_mass: float
    tip_mass: float
    stiffness: float
    damping: float
    servo: Servo | None = None
    sigma: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what is not two masses and a spring."""
        for name, unit in (("moving_mass", "kg"), ("tip_mass", "kg"), ("stiffness", "N/m")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"the {name.replace('_', ' ')} is {value:g} {unit}; it must be positive")
        if not (math.isfinite(self.damping) and self.damping >= 0.0):
            raise InputError(f"the damping is {self.damping:g} N s/m; it must be zero or positive")
        if not math.isfinite(self.sigma):
            raise InputError(f"the friction slope is {self.sigma:g} N s/m; it must be finite")

    @property
    def locked_frequency(self) -> float:
        """Natural frequency [Hz] with the carriage held, ``sqrt(k/m_t)/2 pi``: K_p to infinity; the anti-resonance."""
        return math.sqrt(self.stiffness / self.tip_mass) / (2.0 * math.pi)

    @property
    def locked_damping(self) -> float:
        """Damping ratio [1] with the carriage held, ``c/(2 sqrt(k m_t))``."""
        return self.damping / (2.0 * math.sqrt(self.stiffness * self.tip_mass))

    @property
    def static_compliance(self) -> float:
        """``Phi(0)`` [m/N]: 1/k with any servo, whose integrator holds the carriage; infinite without."""
        return math.inf if self.servo is None else 1.0 / self.stiffness

    def plant(self) -> Plant:
        """Return Eq. (2) without its delay: carriage position over drive force, for `process.drive.servo`."""
        mm, mt, k, c, sigma = self.moving_mass, self.tip_mass, self.stiffness, self.damping, self.sigma
        # Eq. (2); its denominator is (m_m s^2 + sigma s + c s + k)(m_t s^2 + c s + k) - (c s + k)^2.
        return Plant((k, c, mt), (0.0, sigma * k, k * (mm + mt) + sigma * c, c * (mm + mt) + sigma * mt, mm * mt))

    def tip_transfer(self, s: ArrayLike) -> Complex:
        """Return the tip compliance [m/N] at complex s [rad/s], stable or not (the formula and nothing else).

        ``Phi = (m_m s^2 + (c + sigma) s + k + G)/((m_t s^2 + c s + k)(m_m s^2 + (c + sigma) s + k + G) - (c s + k)^2)``
        with ``G = (s + Kv) Kp (1 + 1/(Ti s)) e^(-s tau)``: Eq. (4) of Franco et al. 2024 with the ``sigma s`` that its
        printed numerator lacks, and with the dead time of its Eq. (2). Both are multiplied by s, so that s = 0 is good.
        """
        s = np.asarray(s, dtype=np.complex128)
        joint = self.damping * s + self.stiffness
        carriage = s * (self.moving_mass * s**2 + self.sigma * s + joint)
        if self.servo is not None:
            v = self.servo
            carriage = carriage + (s + v.Kv) * v.Kp * (s + 1.0 / v.Ti) * np.exp(-v.delay * s)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(carriage / ((self.tip_mass * s**2 + joint) * carriage - s * joint**2))

    def tip_compliance(self, frequency: ArrayLike) -> Complex:
        """Return the closed-loop compliance of the tip [m/N] at frequencies [Hz], corrected Eq. (4) (`tip_transfer`).

        Raises
        ------
        InputError
            When the loop is unstable: then no steady response exists.
        """
        self.require_stable()
        return self.tip_transfer(2j * np.pi * np.asarray(frequency, dtype=float))

    def locked_compliance(self, frequency: ArrayLike) -> Complex:
        """Return the tip compliance [m/N] with the carriage held, ``1/(m_t s^2 + c s + k)``, at frequencies [Hz]."""
        s = 2j * np.pi * np.asarray(frequency, dtype=float)
        return np.asarray(1.0 / (self.tip_mass * s**2 + self.damping * s + self.stiffness))

    def compliance(self, frequency: ArrayLike, axis: str = "x") -> xr.Dataset:
        """Return the labelled compliance of the tip along `axis` at frequencies [Hz]."""
        f = np.atleast_1d(np.asarray(frequency, dtype=float))
        return make_compliance(f, self.tip_compliance(f)[:, None, None], [axis], [axis])

    def open_loop(self, frequency: ArrayLike, delay: float | None = None) -> Complex:
        """Return carriage position over drive force [m/N] at frequencies [Hz], Eq. (2).

        Parameters
        ----------
        frequency : array_like
            Frequency [Hz], above zero.
        delay : float, optional
            Dead time [s]; default that of the servo, if there is one.
        """
        if delay is None:
            delay = 0.0 if self.servo is None else self.servo.delay
        s = 2j * np.pi * np.asarray(frequency, dtype=float)
        return np.asarray(self.plant()(s) * np.exp(-delay * s))

    def characteristic(self) -> QuasiPolynomial:
        """Return the characteristic function of the axis: with its servo, or free."""
        plant = self.plant()
        if self.servo is None:
            return QuasiPolynomial(Polynomial(plant.denominator[1:]), Polynomial([0.0]), 0.0)
        return position_characteristic(self.servo, plant)

    def poles(self) -> Complex:
        """Return the poles [rad/s], rightmost first; with a dead time those within ``|s| < pi/tau``.

        Without servo the rigid-body pole at s = 0 is left out.
        """
        return self.characteristic().roots()

    def modes(self) -> Real:
        """Return natural frequency [Hz] and damping ratio [1] of each oscillating pole, shape (modes, 2), sorted.

        ``f = |s|/2 pi``, ``zeta = -Re s/|s|``; negative damping is an unstable pole.
        """
        s = self.poles()
        s = s[s.imag > 1e-9 * np.abs(s)]
        table = np.stack([np.abs(s) / (2.0 * np.pi), -s.real / np.abs(s)], axis=1)
        return np.asarray(table[np.argsort(table[:, 0])])

    def unstable_poles(self) -> int:
        """Return the number of poles in the right half plane (argument principle, exact delay).

        Without servo the rigid body rests on the axis: it does not count.
        """
        if self.servo is None:
            s = self.poles()
            return int(np.sum(s.real > 1e-9 * np.abs(s).max()))
        return self.characteristic().unstable_count()

    def require_stable(self) -> None:
        """Raise `InputError` when there is a servo and its loop is unstable."""
        if self.servo is not None:
            require_stable(self.characteristic(), f"the axis (friction slope {self.sigma:g} N s/m)", self.servo)

    def state_space(self) -> tuple[Real, Real, Real, Real]:
        """Return A, B, C, K of ``q' = A q + B F_tip - E K q(t - tau)``, ``x_tip = C q``.

        State ``q = (x_t, x_t', x_m, x_m', int x_m)``, deviations from the ramp; ``E = (0, 0, 0, 1/m_m, 0)``. The servo
        is ``F = -K q = -Kp [x_m' + Kv x_m + (x_m + Kv int x_m)/Ti]``, which is Eq. (3) for deviations.

        Returns
        -------
        tuple of ndarray
            A (5, 5), B (5,), C (5,), K (5,).
        """
        k, c, mm, mt = self.stiffness, self.damping, self.moving_mass, self.tip_mass
        a = np.zeros((5, 5))
        a[0, 1] = a[2, 3] = a[4, 2] = 1.0
        a[1, :4] = np.array([-k, -c, k, c]) / mt
        a[3, :4] = np.array([k, c, -k, -c - self.sigma]) / mm
        b, out, gain = np.zeros(5), np.zeros(5), np.zeros(5)
        b[1], out[0] = 1.0 / mt, 1.0
        if self.servo is not None:
            v = self.servo
            gain[2:] = v.Kp * np.array([v.Kv + 1.0 / v.Ti, 1.0, v.Kv / v.Ti])
        return a, b, out, gain
