"""One feed axis: a carriage held by a servo, and a flexible tip; its linear responses, poles and limits.

::

    m_t x_t'' = F_tip - k (x_t - x_m) - c (x_t' - x_m')
    m_m x_m'' = k (x_t - x_m) + c (x_t' - x_m') + F_servo(t - tau) - f(x_m')

This is :eq:`axis`. Here the friction f is its slope sigma; `process.simulation.machine` takes the whole law.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.drive.delay_equation import DelayEquation, oscillations
from process.drive.servo import Loop, Servo
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
        """Refuse masses, stiffness and damping that are not possible."""
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

    def tip_transfer(self, s: ArrayLike) -> Complex:
        """Return the tip compliance [m/N] at complex s [rad/s], stable or not (no check).

        ``Phi = (m_m s^2 + (c + sigma) s + k + G)/((m_t s^2 + c s + k)(m_m s^2 + (c + sigma) s + k + G) - (c s + k)^2)``
        with ``G = (s + Kv) Kp (1 + 1/(Ti s)) e^(-s tau)``: Eq. (4) of Franco et al. 2024 with the ``sigma s`` that its
        printed numerator lacks, and with the dead time of its Eq. (2), :eq:`tip-compliance`. Both are multiplied by s,
        so that s = 0 is good.
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

    def compliance(self, frequency: ArrayLike, axis: str = "x") -> xr.Dataset:
        """Return the labelled compliance of the tip along `axis` at frequencies [Hz]."""
        f = np.atleast_1d(np.asarray(frequency, dtype=float))
        return make_compliance(f, self.tip_compliance(f)[:, None, None], [axis], [axis])

    def open_loop(self, frequency: ArrayLike, delay: float | None = None) -> Complex:
        """Return carriage position over drive force [m/N] at frequencies [Hz], Eq. (2) of the paper, :eq:`open-loop`.

        Parameters
        ----------
        frequency : array_like
            Frequency [Hz], above zero.
        delay : float, optional
            Dead time [s]; default that of the servo, if there is one.
        """
        if delay is None:
            delay = 0.0 if self.servo is None else self.servo.delay
        s = _laplace(frequency)
        return np.asarray(self._free_carriage(s) * np.exp(-delay * s))

    def _free_carriage(self, s: Complex) -> Complex:
        """Return carriage position over drive force [m/N] without dead time at complex s [rad/s]."""
        mm, mt, k, c, sigma = self.moving_mass, self.tip_mass, self.stiffness, self.damping, self.sigma
        # The denominator is (m_m s^2 + sigma s + c s + k)(m_t s^2 + c s + k) - (c s + k)^2.
        total = mm + mt
        below = s * (sigma * k + s * (k * total + sigma * c + s * (c * total + sigma * mt + s * mm * mt)))
        return np.asarray((k + s * (c + s * mt)) / below)

    def delay_equation(self) -> DelayEquation:
        """Return the axis as ``q' = A q + B F_tip + sum E K q(t - tau)``, ``x_tip = C q``, in relative coordinates.

        State ``(x_t - x_m, x_t', x_m')``, with a servo also ``x_m`` and its integral: the rigid-body position of a free
        axis is left out.
        """
        a, b, out, gain = self.state_space()
        if self.servo is None:
            return DelayEquation(*_relative(a[:4, :4], b[:4], out[:4]))
        inlet = np.array([0.0, 0.0, 0.0, 1.0 / self.moving_mass, 0.0])
        return _with_dead_time(a, b, out, inlet, -gain, self.servo.delay)

    def poles(self) -> Complex:
        """Return the poles [rad/s], rightmost first; with a dead time those within ``|s| < pi/tau``.

        Without servo the rigid-body pole at s = 0 is left out.
        """
        return self.delay_equation().poles()

    def modes(self) -> Real:
        """Return natural frequency [Hz] and damping ratio [1] of each oscillating pole, shape (modes, 2), sorted.

        ``f = |s|/2 pi``, ``zeta = -Re s/|s|``; negative damping is an unstable pole.
        """
        return oscillations(self.poles())

    def unstable_poles(self) -> int:
        """Return the number of poles in the right half plane (argument principle, exact delay).

        Without servo the rigid body rests on the axis: it does not count.
        """
        if self.servo is None:
            s = self.poles()
            return int(np.sum(s.real > 1e-9 * np.abs(s).max()))
        return self.delay_equation().unstable_poles()

    def require_stable(self) -> None:
        """Raise `InputError` when there is a servo and its loop is unstable."""
        if self.servo is not None:
            self._refuse(self.unstable_poles(), f"the axis (friction slope {self.sigma:g} N s/m)")

    def velocity_loop(self) -> Loop:
        """Return the velocity loop ``Kp (1 + 1/(Ti s)) e^(-s tau) s H``, H the plant of Eq. (2)."""
        servo = self._held()

        def gain(f: Real) -> Complex:
            s = _laplace(f)
            return np.asarray(servo.velocity_controller(s) * s * self._free_carriage(s))

        def require_stable() -> None:
            self._refuse(self._velocity_equation(servo).unstable_poles(), "the velocity loop")

        return Loop(gain, self.loop_frequencies(), require_stable)

    def position_loop(self) -> Loop:
        """Return both loops together, cut at the drive force: ``G H``, G the feedback of the servo, H Eq. (2)."""
        servo = self._held()

        def gain(f: Real) -> Complex:
            s = _laplace(f)
            return np.asarray(servo.feedback(s) * self._free_carriage(s))

        def require_stable() -> None:
            self._refuse(self.unstable_poles(), "the position loop")

        return Loop(gain, self.loop_frequencies(), require_stable)

    def loop_frequencies(self) -> Real:
        """Return frequencies [Hz] over the band of the loops, dense at poles and zeros of plant and closed loop."""
        servo = self._held()
        free = np.linalg.eigvals(replace(self, servo=None).delay_equation().a)
        closed = np.linalg.eigvals(self.delay_equation().prompt())
        size = np.abs(np.concatenate([free, closed, [servo.Kv, 1.0 / servo.Ti, 2.0 * np.pi * self.locked_frequency]]))
        size = size[size > 1e-9 * size.max()] / (2.0 * np.pi)
        coarse = np.geomspace(1e-2 * size.min(), 50.0 * size.max(), 6000)
        return np.unique(np.concatenate([coarse, np.outer(size, np.linspace(0.9, 1.1, 401)).ravel()]))

    def _velocity_equation(self, servo: Servo) -> DelayEquation:
        """Return the axis under the velocity controller alone, whose integral is the carriage position."""
        a, b, out, _ = replace(self, servo=None).state_space()
        gain, inlet = np.array([0.0, 0.0, servo.Kp / servo.Ti, servo.Kp]), np.array([0.0, 0.0, 0.0, 1.0])
        return _with_dead_time(a[:4, :4], b[:4], out[:4], inlet / self.moving_mass, -gain, servo.delay)

    def _held(self) -> Servo:
        if self.servo is None:
            raise InputError("the axis has no servo and therefore no loop; give it one")
        return self.servo

    def _refuse(self, unstable: int, what: str) -> None:
        if unstable:
            servo = self._held()
            raise InputError(
                f"{what} is unstable with Kp {servo.Kp:g} N s/m, Ti {servo.Ti * 1e3:g} ms, Kv {servo.Kv:g} 1/s, "
                f"delay {servo.delay * 1e3:g} ms: {unstable} pole(s) in the right half plane; a closed-loop quantity "
                "needs a stable loop: lower Kp or Kv, raise Ti, shorten the delay, or look at the friction slope (a "
                "falling friction force drives the carriage)"
            )

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


def _laplace(frequency: ArrayLike) -> Complex:
    """``j w`` [rad/s] at frequencies [Hz]."""
    return np.asarray(2j * np.pi * np.asarray(frequency, dtype=float), dtype=np.complex128)


def _relative(a: Real, b: Real, out: Real) -> tuple[Real, Real, Real]:
    """Return A, B, C of the free axis for the states (x_t - x_m, x_t', x_m'), without the rigid-body position.

    The output is the tip relative to the carriage.
    """
    # x_t = (x_t - x_m) + x_m; nothing depends on x_m alone.
    keep = [0, 1, 3]
    part = a[np.ix_(keep, keep)].copy()
    part[0, 2] -= 1.0
    return part, b[keep, None], out[None, keep]


def _with_dead_time(a: Real, b: Real, out: Real, inlet: Real, row: Real, delay: float) -> DelayEquation:
    if delay == 0.0:
        return DelayEquation(a + np.outer(inlet, row), b[:, None], out[None])
    return DelayEquation(a, b[:, None], out[None], ((delay, inlet, row),))
