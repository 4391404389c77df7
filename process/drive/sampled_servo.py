"""P-PI cascade that runs on samples: exact loop responses, margins, poles and tip compliance with a zero-order hold.

Encoder position and velocity are read every T; ``e = a v_ref + Kv (x_ref - x) - x'``, ``I <- I + T e``,
``F = Kp (e + I/Ti)``: Eq. (3) of Franco et al. 2024 (JMMP 8/5/207) with a rectangular integral. The force is applied
`lag` samples later and held for T, while the masses move exactly (matrix exponential). With ``z = exp(j w T)``::

    C = Kp [1 + T/Ti z/(z - 1)] z^-lag          V, X: carriage velocity and position over held force
    velocity loop L_v = C V                     both loops, cut at the force, L = C (V + Kv X)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import linalg

from process.drive.axis import Drive
from process.drive.servo import Loop, Servo
from process.errors import InputError
from process.types import Complex, Real

_MASSES = 4
_CARRIAGE, _CARRIAGE_SPEED = 2, 3


@dataclass(frozen=True)
class SampledServo:
    """A servo that reads its encoder and sets its force every T.

    The methods take the axis that it moves; the axis' own servo plays no part.

    Parameters
    ----------
    servo : Servo
        Gains, without a delay: period and lag make the dead time.
    period : float
        Sampling period T [s].
    lag : int, optional
        Whole periods from reading to force.

    Raises
    ------
    InputError
        When the servo has a delay, the period is not positive or longer than Ti, or the lag is not a whole number
        from 0 up.
    """

    servo: Servo
    period: float
    lag: int = 1

    def __post_init__(self) -> None:
        """Refuse a period, lag or servo that cannot be sampled."""
        if self.servo.delay != 0.0 or not 0.0 < self.period < math.inf or self.lag < 0 or self.lag != int(self.lag):
            raise InputError(
                f"sampling with period {self.period:g} s and lag {self.lag:g} needs a positive period, a whole lag "
                f"from 0 up, and a servo with delay 0 (it has {self.servo.delay:g} s): both make its dead time"
            )
        if self.period > self.servo.Ti:
            raise InputError(
                f"the sampling period {self.period:g} s is longer than the integral time Ti {self.servo.Ti:g} s; "
                "sample faster or raise Ti"
            )

    @property
    def nyquist(self) -> float:
        """Half the sampling rate [Hz]."""
        return 0.5 / self.period

    def continuous(self) -> Servo:
        """Return the continuous servo that this one equals up to the second order of T.

        ``z/(z - 1) = 1/(s T) + 1/2 + O(T)``: the rectangular integral equals ``Kp (1 + T/(2 Ti))`` and ``Ti + T/2``;
        hold and lag are a dead time of ``(lag + 1/2) T``. With the gains as they stand the order is one.
        """
        more = 0.5 * self.period / self.servo.Ti
        return replace(
            self.servo,
            Kp=self.servo.Kp * (1.0 + more),
            Ti=self.servo.Ti * (1.0 + more),
            delay=(self.lag + 0.5) * self.period,
        )

    def poles(self, drive: Drive) -> Complex:
        """Return the poles of the axis as ``s = ln(z)/T`` [rad/s], rightmost first. Stable: all real parts negative.

        Returns
        -------
        ndarray of complex, shape (5 + lag,)
            Imaginary part up to pi/T; a pole at z = 0 is at minus infinity and left out.
        """
        return self._logarithm(self._closed(drive, self.servo.Kv))

    def velocity_poles(self, drive: Drive) -> Complex:
        """Return the poles of the closed velocity loop (without Kv) as ``s = ln(z)/T`` [rad/s], rightmost first.

        The position of the axis integrates: its pole at s = 0 is left out.
        """
        transition = self._closed(drive, 0.0)
        # Positions relative to the carriage: x_t - x_m replaces x_t, and x_m, which nothing depends on, goes.
        shift = np.eye(len(transition))
        shift[0, _CARRIAGE] = -1.0
        relative = shift @ transition @ np.linalg.inv(shift)
        keep = [i for i in range(len(transition)) if i != _CARRIAGE]
        return self._logarithm(relative[np.ix_(keep, keep)])

    def _logarithm(self, transition: Real) -> Complex:
        found = np.linalg.eigvals(transition).astype(np.complex128)
        s = np.log(found[np.abs(found) > 1e-12]) / self.period
        return np.asarray(s[np.lexsort((s.imag, -s.real))])

    def _closed(self, drive: Drive, position_gain: float) -> Real:
        """Transition of a period. State: masses (4), the integral, and the forces that wait, newest first."""
        a = replace(drive, servo=None).state_space()[0][:_MASSES, :_MASSES]
        one = np.eye(_MASSES)
        gains = (self.servo.Kp, self.servo.Ti, position_gain)
        inlet = one[:, [_CARRIAGE_SPEED]] / drive.moving_mass
        return sampled_transition(a, inlet, one[[_CARRIAGE]], one[[_CARRIAGE_SPEED]], [gains], self.period, self.lag)

    def _controller(self, frequency: Real) -> Complex:
        """C [N s/m] at frequencies [Hz]."""
        turn = 2j * np.pi * frequency * self.period
        integral = self.period / self.servo.Ti / -np.expm1(-turn)
        return np.asarray(self.servo.Kp * (1.0 + integral) * np.exp(-self.lag * turn))

    def _plant(self, drive: Drive, frequency: Real) -> tuple[Complex, Complex]:
        """V [m/(N s)] and X [m/N] at frequencies [Hz]."""
        free, push = _held(drive, self.period)
        # (z - 1) - (exp(A T) - 1): both differences are small for a short period, and are not formed by subtraction.
        turn = np.expm1(2j * np.pi * frequency * self.period)
        states = np.linalg.solve(turn[:, None, None] * np.eye(_MASSES) - free, np.broadcast_to(push[:, None], (4, 1)))
        return states[:, _CARRIAGE_SPEED, 0], states[:, _CARRIAGE, 0]

    def _band(self, frequency: ArrayLike) -> Real:
        f = np.atleast_1d(np.asarray(frequency, dtype=float))
        if not np.all((f > 0.0) & (f <= self.nyquist)):
            raise InputError(
                f"frequencies from {f.min():g} to {f.max():g} Hz; a loop sampled every {self.period:g} s is defined "
                f"above 0 and up to {self.nyquist:g} Hz"
            )
        return f

    def velocity_loop(self, drive: Drive) -> Loop:
        """Return the velocity loop ``C V`` up to half the sampling rate."""

        def gain(frequency: Real) -> Complex:
            f = self._band(frequency)
            return np.asarray(self._controller(f) * self._plant(drive, f)[0])

        def require_stable() -> None:
            self._require_stable("the sampled velocity loop", self.velocity_poles(drive))

        return Loop(gain, self._grid(drive), require_stable, sampled=True)

    def position_loop(self, drive: Drive) -> Loop:
        """Return both loops together, cut at the drive force, ``C (V + Kv X)``, up to half the sampling rate."""
        return Loop(
            lambda f: self._both_loops(drive, f), self._grid(drive), lambda: self.require_stable(drive), sampled=True
        )

    def _both_loops(self, drive: Drive, frequency: ArrayLike) -> Complex:
        """``C (V + Kv X)`` [1] at frequencies [Hz]."""
        f = self._band(frequency)
        speed, place = self._plant(drive, f)
        return np.asarray(self._controller(f) * (speed + self.servo.Kv * place))

    def _grid(self, drive: Drive) -> Real:
        f = replace(drive, servo=self.continuous()).loop_frequencies()
        return np.append(f[f < self.nyquist], self.nyquist)

    def tip_compliance(self, drive: Drive, frequency: ArrayLike) -> Complex:
        """Return the tip's response [m/N] at the frequency [Hz] of a force on it, between samples too.

        ``Phi = G_tt - G_tm H0/T C/(1 + L) (s + Kv) G_mt`` with ``H0 = (1 - exp(-s T))/s``, G the compliances of the
        free axis. The response of the hold at ``n/T +- f`` is left out.

        Raises
        ------
        InputError
            When the loop is unstable.
        """
        self.require_stable(drive)
        f = self._band(frequency)
        s = 2j * np.pi * f
        joint = drive.damping * s + drive.stiffness
        tip = replace(drive, servo=None).tip_transfer(s)
        carriage = s**2 * drive.moving_mass + s * drive.sigma + joint
        # The force on the tip reaches the carriage through the joint, and the other way round.
        cross = tip * joint / carriage
        hold = -np.expm1(-s * self.period) / (s * self.period)
        servo = hold * self._controller(f) / (1.0 + self._both_loops(drive, f))
        return np.asarray(tip - cross**2 * servo * (s + self.servo.Kv))

    def require_stable(self, drive: Drive) -> None:
        """Raise `InputError` when a pole of the axis lies outside the unit circle."""
        self._require_stable(f"the sampled axis (friction slope {drive.sigma:g} N s/m)", self.poles(drive))

    def _require_stable(self, what: str, poles: Complex) -> None:
        count = int(np.sum(poles.real >= 0.0))
        if count:
            raise InputError(
                f"{what} is unstable with Kp {self.servo.Kp:g} N s/m, Ti {self.servo.Ti * 1e3:g} ms, Kv "
                f"{self.servo.Kv:g} 1/s, period {self.period * 1e3:g} ms, lag {self.lag}: {count} pole(s) outside the "
                "unit circle; lower Kp or Kv, raise Ti, sample faster, or look at the friction slope"
            )


def _held(drive: Drive, period: float) -> tuple[Real, Real]:
    """``exp(A T) - 1``, shape (4, 4), and the push of a unit force on the carriage held for T, shape (4,)."""
    a = replace(drive, servo=None).state_space()[0][:_MASSES, :_MASSES]
    block = np.zeros((2 * _MASSES, 2 * _MASSES))
    block[:_MASSES, :_MASSES], block[:_MASSES, _MASSES:] = a, np.eye(_MASSES)
    # Integral of exp(A t) from 0 to T.
    integral = linalg.expm(block * period)[:_MASSES, _MASSES:]
    return np.asarray(a @ integral), np.asarray(integral[:, _CARRIAGE_SPEED] / drive.moving_mass)


def sampled_transition(
    a: Real,
    inlets: Real,
    places: Real,
    speeds: Real,
    gains: Sequence[tuple[float, float, float]],
    period: float,
    lag: int,
    differenced: bool = False,
) -> Real:
    """Return the matrix that takes motion, integrals, waiting forces and last readings from one sample to the next.

    Parameters
    ----------
    a : ndarray, shape (m, m)
        Free motion ``q' = A q``.
    inlets : ndarray, shape (m, s)
        ``q'`` for a unit force [N] of each servo.
    places, speeds : ndarray, shape (s, m)
        Position and velocity that each servo reads.
    gains : sequence of (float, float, float)
        Kp [N s/m], Ti [s] and Kv [1/s] of each.
    period : float
        Sampling period [s].
    lag : int
        Whole periods from reading to force.
    differenced : bool, optional
        The velocity is the difference of two readings of the position.
    """
    m, count = inlets.shape
    block = np.zeros((m + count, m + count))
    block[:m, :m], block[:m, m:] = a, inlets
    exact = linalg.expm(block * period)[:m]
    readings = m + count * (1 + lag)
    size = readings + count * differenced
    z = np.zeros((size, size))
    z[:m, :m] = exact[:, :m]
    for k, (kp, ti, kv) in enumerate(gains):
        error, integral, queue = np.zeros(size), m + k, m + count + k * lag
        error[:m] = -kv * places[k]
        if differenced:
            error[:m] -= places[k] / period
            error[readings + k] = 1.0 / period
            z[readings + k, :m] = places[k]
        else:
            error[:m] -= speeds[k]
        z[integral] = period * error
        z[integral, integral] = 1.0
        force = kp * (error + z[integral] / ti)
        if lag == 0:
            z[:m] += np.outer(exact[:, m + k], force)
        else:
            z[:m, queue + lag - 1] += exact[:, m + k]
            z[queue] = force
            z[queue + 1 : queue + lag, queue : queue + lag - 1] = np.eye(lag - 1)
    return z
