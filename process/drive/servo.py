"""P-PI cascade of a feed drive: force law, tuning rule, and the loops of a servo with their margins.

`process.drive.axis.Drive` and `process.drive.sampled_servo.SampledServo` return their loops as `Loop`; the dead time is
never replaced by a Pade fraction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from process.errors import InputError
from process.types import Complex, Real

_HALF_POWER = math.sqrt(0.5)  # -3 dB
_BANDWIDTH_GRID = 4000  # frequencies among which the first one below -3 dB is looked for


@dataclass(frozen=True)
class Servo:
    """Position controller Kv around a velocity controller Kp, Ti, with velocity feed-forward and dead time.

    ``F = Kp [e_v + (1/Ti) int e_v]``, ``e_v = a v_ref + Kv (x_ref - x) - x'``, applied `delay` later: Eq. (3) of
    Franco et al. 2024 (JMMP 8/5/207), where the feed-forward a is 1 and there is no delay, :eq:`servo`.

    Parameters
    ----------
    Kp : float
        Velocity gain [N s/m].
    Ti : float
        Integral time of the velocity controller [s].
    Kv : float
        Position gain [1/s].
    delay : float, optional
        Dead time from the encoder to the force [s].
    feed_forward : float, optional
        Velocity feed-forward a [1]; it moves the reference response only.

    Raises
    ------
    InputError
        When a gain or the integral time is not positive, or the delay is negative.
    """

    Kp: float
    Ti: float
    Kv: float
    delay: float = 0.0
    feed_forward: float = 1.0

    def __post_init__(self) -> None:
        """Refuse gains and delays that are not possible."""
        for name, unit in (("Kp", "N s/m"), ("Ti", "s"), ("Kv", "1/s")):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} is {value:g} {unit}; it must be positive (no servo at all: servo=None)")
        if not (math.isfinite(self.delay) and self.delay >= 0.0):
            raise InputError(f"the delay is {self.delay:g} s; it must be zero or positive")
        if not math.isfinite(self.feed_forward):
            raise InputError(f"the feed-forward is {self.feed_forward:g}; it must be a number, usually 0 or 1")

    def velocity_controller(self, s: ArrayLike) -> Complex:
        """Return ``Kp (1 + 1/(Ti s)) exp(-s tau)`` [N s/m] at complex frequencies s [rad/s]."""
        s = np.asarray(s, dtype=np.complex128)
        return np.asarray(self.Kp * (1.0 + 1.0 / (self.Ti * s)) * np.exp(-self.delay * s))

    def feedback(self, s: ArrayLike) -> Complex:
        """Return ``G(s) = (s + Kv) Kp (1 + 1/(Ti s)) exp(-s tau)`` [N/m]: drive force over minus carriage position."""
        return np.asarray((np.asarray(s) + self.Kv) * self.velocity_controller(s))

    def following_error(self, feed: float) -> float:
        """Return the steady lag behind a ramp [m] at a feed [m/s], ``(1 - a) v/Kv``."""
        return (1.0 - self.feed_forward) * feed / self.Kv


def tune(bandwidth: float, mass: float, delay: float = 0.0) -> Servo:
    """Return the servo of the rule behind Table 2 of Franco et al. 2024.

    ``Kp = 2 pi f m``, ``Ti = 2/(2 pi f)``, ``Kv = 2 pi f/4``: f is where a P controller alone on the rigid mass has
    gain 1; with this Ti the closed velocity loop of the rigid mass is 3 dB down at 1.455 f.

    Parameters
    ----------
    bandwidth : float
        f [Hz].
    mass : float
        All that the drive moves [kg], carriage and tip.
    delay : float, optional
        Dead time [s]; the rule ignores it.

    Returns
    -------
    Servo
        The gains.
    """
    if not (0.0 < bandwidth < math.inf and 0.0 < mass < math.inf):
        raise InputError(f"bandwidth {bandwidth:g} Hz and mass {mass:g} kg; both must be positive")
    w = 2.0 * math.pi * bandwidth
    return Servo(w * mass, 2.0 / w, w / 4.0, delay)


@dataclass(frozen=True)
class Margins:
    """Distance of a stable loop L from instability.

    Parameters
    ----------
    gain : float
        Smallest factor above 1 by which the loop gain may rise [1]; inf when none.
    phase : float
        Smallest phase lag that may be added at a gain crossover [rad]; inf when none.
    delay : float
        Smallest dead time that may be added [s]; inf when none.
    modulus : float
        Smallest ``|1 + L|`` [1].
    crossover : float
        Highest frequency with ``|L| = 1`` [Hz]; nan when none.
    """

    gain: float
    phase: float
    delay: float
    modulus: float
    crossover: float


@dataclass(frozen=True)
class Loop:
    """Frequency response L of an open loop, of which the closed loop is ``L/(1 + L)``.

    Parameters
    ----------
    gain : callable
        Frequency [Hz], shape (n,), above 0 -> L [1].
    grid : ndarray, shape (m,)
        Frequencies [Hz], rising, dense enough that each crossing lies between two of them.
    require_stable : callable
        Raises `InputError` when the closed loop is unstable.
    sampled : bool, optional
        Whether the grid ends at half a sampling rate, where L is real and a pole may leave the unit circle at z = -1.
    """

    gain: Callable[[Real], Complex]
    grid: Real
    require_stable: Callable[[], None]
    sampled: bool = False

    def __call__(self, frequency: ArrayLike) -> Complex:
        """Return L [1] at frequencies [Hz] above 0, stable or not."""
        f = np.atleast_1d(np.asarray(frequency, dtype=float))
        if not np.all(f > 0.0):
            raise InputError(f"the lowest frequency is {f.min():g} Hz; a loop with an integrator needs f > 0")
        return self.gain(f)

    def closed(self, frequency: ArrayLike) -> Complex:
        """Return ``L/(1 + L)`` [1] at frequencies [Hz]; raises `InputError` when the closed loop is unstable."""
        self.require_stable()
        gain = self(frequency)
        return np.asarray(gain / (1.0 + gain))

    def bandwidth(self) -> float:
        """Return the lowest frequency [Hz] at which the closed loop falls 3 dB below 1.

        Raises
        ------
        InputError
            When the loop is unstable, or does not fall below -3 dB within its grid.
        """
        self.require_stable()

        def level(f: Real) -> Real:
            gain = self.gain(f)
            return np.asarray(np.abs(gain / (1.0 + gain)) - _HALF_POWER)

        f = np.geomspace(self.grid[0], self.grid[-1], _BANDWIDTH_GRID)
        values = level(f)
        falls = np.flatnonzero((values[:-1] >= 0.0) & (values[1:] < 0.0))
        if not falls.size:
            raise InputError(f"the loop does not fall through -3 dB between {f[0]:g} and {f[-1]:g} Hz")
        i = int(falls[0])
        return _crossing(lambda x: float(level(np.array([x]))[0]), f[i], f[i + 1])

    def margins(self) -> Margins:
        """Return the margins; raises `InputError` when the closed loop is unstable."""
        self.require_stable()
        f, gain = self.grid, self.gain(self.grid)

        def value(x: float) -> complex:
            return complex(self.gain(np.array([x]))[0])

        def crossings(level: Real, of: Callable[[float], float]) -> list[float]:
            return [_crossing(of, f[i], f[i + 1]) for i in np.flatnonzero(level[:-1] * level[1:] < 0.0)]

        unity = crossings(np.abs(gain) - 1.0, lambda x: abs(value(x)) - 1.0)
        real = [value(x).real for x in crossings(gain.imag, lambda x: value(x).imag)]
        if self.sampled:
            real.append(float(gain[-1].real))
        # Lag that turns L(f) onto -1, in (0, 2 pi).
        lags = [float((np.angle(value(x)) + np.pi) % (2.0 * np.pi)) for x in unity]
        return Margins(
            min((-1.0 / r for r in real if -1.0 < r < 0.0), default=math.inf),
            min(lags, default=math.inf),
            min((lag / (2.0 * np.pi * x) for lag, x in zip(lags, unity, strict=True)), default=math.inf),
            float(np.abs(1.0 + gain).min()),
            max(unity, default=math.nan),
        )


def _crossing(function: Callable[[float], float], low: float, high: float) -> float:
    return float(optimize.brentq(function, low, high, xtol=1e-12 * high, rtol=1e-13))
