"""P-PI cascade of a feed drive: force law, loop responses, margins, stability with exact dead time, tuning rule.

The plant that the servo holds is a rational function of s, carriage position over drive force. Its closed loop is a
quasi-polynomial ``P(s) + Q(s) exp(-s tau)``; the dead time is never replaced by a Pade fraction.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike
from scipy import optimize

from process.drive.delay_equation import chebyshev_derivative, right_half_plane_zeros
from process.errors import InputError
from process.types import Complex, Real

Response = Callable[[Real], Complex]

_COLLOCATION = 36
_HALF_POWER = math.sqrt(0.5)


@dataclass(frozen=True)
class Servo:
    """Position controller Kv around a velocity controller Kp, Ti, with velocity feed-forward and dead time.

    ``F = Kp [e_v + (1/Ti) int e_v]``, ``e_v = a v_ref + Kv (x_ref - x) - x'``, applied `delay` later: Eq. (3) of
    Franco et al. 2024 (JMMP 8/5/207), where the feed-forward a is 1 and there is no delay.

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
        """Refuse what is not a servo."""
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

    def command(self, s: ArrayLike) -> Complex:
        """Return ``(a s + Kv) Kp (1 + 1/(Ti s)) exp(-s tau)`` [N/m]: drive force over reference position."""
        return np.asarray((self.feed_forward * np.asarray(s) + self.Kv) * self.velocity_controller(s))

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
class Plant:
    """What the servo moves: ``x/F = numerator(s)/denominator(s)`` [m/N], strictly proper with a pole at s = 0.

    Parameters
    ----------
    numerator, denominator : sequence of float
        Coefficients, rising powers of s [rad/s].

    Raises
    ------
    InputError
        When the plant does not integrate (a guided carriage without servo has no static stiffness) or has less than
        two poles more than zeros.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    def __post_init__(self) -> None:
        """Refuse what a P-PI cascade is not made for."""
        if not np.all(np.isfinite([*self.numerator, *self.denominator])):
            raise InputError("a coefficient of the plant is not finite; check its masses, stiffness and damping")
        n, d = Polynomial(self.numerator).trim(), Polynomial(self.denominator).trim()
        if d.coef[0] != 0.0 or n.coef[0] == 0.0:
            raise InputError("the plant has no pole at s = 0; a P-PI cascade moves a carriage, which has one")
        if d.degree() < n.degree() + 2:
            raise InputError(
                f"the plant has {d.degree()} poles and {n.degree()} zeros; position over force of a mass has at least "
                "2 poles more"
            )

    def __call__(self, s: ArrayLike) -> Complex:
        """Return position over force [m/N] at complex frequencies s [rad/s]."""
        s = np.asarray(s, dtype=np.complex128)
        return np.asarray(Polynomial(self.numerator)(s) / Polynomial(self.denominator)(s))


def rigid_plant(mass: float, sigma: float = 0.0) -> Plant:
    """Return ``1/(m s^2 + sigma s)``: a rigid carriage of mass [kg] with friction slope sigma [N s/m]."""
    if not 0.0 < mass < math.inf:
        raise InputError(f"the mass is {mass:g} kg; it must be positive and finite")
    return Plant((1.0,), (0.0, sigma, mass))


@dataclass(frozen=True)
class QuasiPolynomial:
    """Characteristic function ``P(s) + Q(s) exp(-s tau)`` of a retarded system (degree of Q below that of P).

    Parameters
    ----------
    plain, delayed : numpy.polynomial.Polynomial
        P and Q, s in rad/s.
    delay : float
        tau [s].
    """

    plain: Polynomial
    delayed: Polynomial
    delay: float
    scale: float = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Find the frequency that makes the coefficients of order one."""
        total = (self.plain + self.delayed).trim().coef
        # The size of the product of the roots, to the power 1/n.
        object.__setattr__(self, "scale", abs(total[0] / total[-1]) ** (1.0 / (total.size - 1)))

    def __call__(self, s: ArrayLike) -> Complex:
        """Return its value at complex s [rad/s]."""
        s = np.asarray(s, dtype=np.complex128)
        return np.asarray(self.plain(s) + self.delayed(s) * np.exp(-self.delay * s))

    def unstable_count(self) -> int:
        """Return how many zeros lie in Re s > 0, by the argument principle with the exact delay.

        A zero on the axis itself counts as unstable.
        """
        roots = np.concatenate([p.roots() for p in (self.plain, self.delayed, self.plain + self.delayed)])
        sizes = np.concatenate([[self.scale], np.abs(roots), np.abs(roots.imag)])
        return right_half_plane_zeros(self._ratio, sizes[sizes > 0.0], self.delay)

    def _ratio(self, s: Complex) -> Complex:
        n = self.plain.degree()
        lead = self.plain.coef[-1] * self.scale**n
        return np.asarray(self(s) / (lead * (s / self.scale + 1.0) ** n))

    def roots(self) -> Complex:
        """Return the zeros [rad/s], rightmost first; with a delay the unstable ones and those within ``|s| < pi/tau``.

        Eigenvalues of the delay equation on 37 Chebyshev points (Breda, Maset, Vermiglio 2005), each then brought onto
        the exact characteristic function by Newton's method.
        """
        if self.delay == 0.0:
            found = (self.plain + self.delayed).roots().astype(np.complex128)
        else:
            found = self._polished(self._collocated())
        return np.asarray(found[np.lexsort((found.imag, -found.real))])

    def _collocated(self) -> Complex:
        """Eigenvalues [rad/s] of the companion system with its history on Chebyshev points, time in units 1/scale."""
        n, w, tau = self.plain.degree(), self.scale, self.delay * self.scale
        powers = w ** np.arange(n)
        lead = self.plain.coef[-1] * w**n
        now, past = np.eye(n, k=1), np.zeros((n, n))
        plain, delayed = np.asarray(self.plain.coef, dtype=float), np.asarray(self.delayed.coef, dtype=float)
        now[-1] = -plain[:n] * powers / lead
        past[-1, : delayed.size] = -delayed * powers[: delayed.size] / lead
        differences = chebyshev_derivative(_COLLOCATION) * 2.0 / tau
        matrix = np.kron(differences, np.eye(n))
        matrix[:n] = 0.0
        matrix[:n, :n], matrix[:n, -n:] = now, past
        return np.asarray(np.linalg.eigvals(matrix) * w)

    def _polished(self, start: Complex) -> Complex:
        """Newton steps to the exact zeros; keep each once, and only those near the origin or unstable."""
        near = 1.2 * math.pi / self.delay
        s = start[(np.abs(start) < near) | (start.real > -0.2 * near)].astype(np.complex128)
        slope_p, slope_q = self.plain.deriv(), self.delayed.deriv()
        change = np.zeros_like(s)
        with np.errstate(all="ignore"):  # A start that runs away is dropped below.
            for _ in range(30):
                lag = np.exp(-self.delay * s)
                change = self(s) / (slope_p(s) + (slope_q(s) - self.delay * self.delayed(s)) * lag)
                s = s - change
        wanted = (np.abs(s) < math.pi / self.delay) | (s.real > 0.0)
        good = wanted & (np.abs(change) < 1e-8 * np.abs(s))
        kept: list[complex] = []
        for value in s[good]:
            if all(abs(value - other) > 1e-6 * abs(value) for other in kept):
                kept.append(complex(value))
        return np.array(kept, dtype=np.complex128)


def velocity_characteristic(servo: Servo, plant: Plant) -> QuasiPolynomial:
    """Return ``Ti D + Kp (Ti s + 1) N exp(-s tau)`` of the closed velocity loop, plant N/D."""
    n, d = Polynomial(plant.numerator), Polynomial(plant.denominator)
    return QuasiPolynomial((servo.Ti * d).trim(), (servo.Kp * Polynomial([1.0, servo.Ti]) * n).trim(), servo.delay)


def position_characteristic(servo: Servo, plant: Plant) -> QuasiPolynomial:
    """Return ``Ti s D + Kp (s + Kv) (Ti s + 1) N exp(-s tau)`` of the closed position loop, plant N/D."""
    n, d = Polynomial(plant.numerator), Polynomial(plant.denominator)
    controller = servo.Kp * Polynomial([servo.Kv, 1.0]) * Polynomial([1.0, servo.Ti])
    return QuasiPolynomial((servo.Ti * Polynomial([0.0, 1.0]) * d).trim(), (controller * n).trim(), servo.delay)


def require_stable(characteristic: QuasiPolynomial, what: str, servo: Servo) -> None:
    """Raise `InputError` when the loop has poles in the right half plane.

    Parameters
    ----------
    characteristic : QuasiPolynomial
        Of the loop.
    what : str
        The loop, as the message names it.
    servo : Servo
        For the message.
    """
    count = characteristic.unstable_count()
    if count:
        raise InputError(
            f"{what} is unstable with Kp {servo.Kp:g} N s/m, Ti {servo.Ti * 1e3:g} ms, Kv {servo.Kv:g} 1/s, "
            f"delay {servo.delay * 1e3:g} ms: {count} pole(s) in the right half plane; a closed-loop quantity needs a "
            "stable loop: lower Kp or Kv, raise Ti, shorten the delay, or look at the friction slope (a falling "
            "friction force drives the carriage)"
        )


def _s(frequency: ArrayLike) -> Complex:
    f = np.asarray(frequency, dtype=float)
    if not np.all(f > 0.0):
        raise InputError(f"the lowest frequency is {f.min():g} Hz; a loop with an integrator needs f > 0")
    return np.asarray(2j * np.pi * f)


def open_velocity_loop(servo: Servo, plant: Plant, frequency: ArrayLike) -> Complex:
    """Return the velocity loop gain ``Kp (1 + 1/(Ti s)) e^(-s tau) s N/D`` [1] at frequencies [Hz]."""
    s = _s(frequency)
    return np.asarray(servo.velocity_controller(s) * s * plant(s))


def velocity_loop(servo: Servo, plant: Plant, frequency: ArrayLike) -> Complex:
    """Return the closed velocity loop [1], carriage velocity over commanded velocity, at frequencies [Hz].

    Raises
    ------
    InputError
        When the loop is unstable.
    """
    require_stable(velocity_characteristic(servo, plant), "the velocity loop", servo)
    gain = open_velocity_loop(servo, plant, frequency)
    return np.asarray(gain / (1.0 + gain))


def open_position_loop(servo: Servo, plant: Plant, frequency: ArrayLike) -> Complex:
    """Return the position loop gain ``Kv/s T_v`` [1] around the closed velocity loop ``T_v``, at frequencies [Hz]."""
    gain = open_velocity_loop(servo, plant, frequency)
    return np.asarray(servo.Kv / _s(frequency) * gain / (1.0 + gain))


def position_loop(servo: Servo, plant: Plant, frequency: ArrayLike) -> Complex:
    """Return the closed position loop [1], carriage position over reference position, at frequencies [Hz].

    ``(a s + Kv) K e^(-s tau) H/(1 + G H)`` with ``K = Kp (1 + 1/(Ti s))``, H the plant, a the feed-forward.

    Raises
    ------
    InputError
        When the loop is unstable.
    """
    require_stable(position_characteristic(servo, plant), "the position loop", servo)
    s = _s(frequency)
    h = plant(s)
    return np.asarray(servo.command(s) * h / (1.0 + servo.feedback(s) * h))


@dataclass(frozen=True)
class Margins:
    """How far a stable loop L is from instability.

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


def velocity_margins(servo: Servo, plant: Plant) -> Margins:
    """Return the margins of the velocity loop."""
    require_stable(velocity_characteristic(servo, plant), "the velocity loop", servo)
    return margins(lambda f: open_velocity_loop(servo, plant, f), frequency_grid(servo, plant))


def position_margins(servo: Servo, plant: Plant) -> Margins:
    """Return the margins of both loops together, cut at the drive force: ``L = G H``."""
    require_stable(position_characteristic(servo, plant), "the position loop", servo)
    return margins(lambda f: np.asarray(servo.feedback(_s(f)) * plant(_s(f))), frequency_grid(servo, plant))


def bandwidth(response: Response, lowest: float, highest: float) -> float:
    """Return the lowest frequency [Hz] at which a closed loop falls 3 dB below 1.

    Parameters
    ----------
    response : callable
        Frequencies [Hz], shape (n,), to the closed loop [1].
    lowest, highest : float
        Band that is searched [Hz].

    Raises
    ------
    InputError
        When the response does not fall below -3 dB in the band.
    """
    if not 0.0 < lowest < highest < math.inf:
        raise InputError(f"a band from {lowest:g} to {highest:g} Hz; give 0 < lowest < highest")
    f = np.geomspace(lowest, highest, 4000)
    level = np.abs(response(f)) - _HALF_POWER
    falls = np.flatnonzero((level[:-1] >= 0.0) & (level[1:] < 0.0))
    if not falls.size:
        raise InputError(f"the loop does not fall through -3 dB between {lowest:g} and {highest:g} Hz; widen the band")
    i = int(falls[0])
    return _crossing(lambda x: float(np.abs(response(np.array([x])))[0]) - _HALF_POWER, f[i], f[i + 1])


def velocity_bandwidth(servo: Servo, plant: Plant) -> float:
    """Return the -3 dB frequency [Hz] of the closed velocity loop (the lowest one)."""
    require_stable(velocity_characteristic(servo, plant), "the velocity loop", servo)

    def closed(f: Real) -> Complex:
        gain = open_velocity_loop(servo, plant, f)
        return np.asarray(gain / (1.0 + gain))

    grid = frequency_grid(servo, plant)
    return bandwidth(closed, grid[0], grid[-1])


def frequency_grid(servo: Servo, plant: Plant) -> Real:
    """Return frequencies [Hz] over all that the position loop does, dense at its lightly damped roots."""
    characteristic = position_characteristic(servo, plant)
    plain, delayed = characteristic.plain, characteristic.delayed
    roots = np.concatenate([p.roots() for p in (plain, delayed, plain + delayed)])
    size = np.abs(roots[np.abs(roots) > 0.0]) / (2.0 * np.pi)
    coarse = np.geomspace(1e-2 * size.min(), 50.0 * size.max(), 6000)
    fine = np.outer(size, np.linspace(0.9, 1.1, 401)).ravel()
    return np.unique(np.concatenate([coarse, fine]))


def _crossing(function: Callable[[float], float], low: float, high: float) -> float:
    return float(optimize.brentq(function, low, high, xtol=1e-12 * high, rtol=1e-13))


def margins(loop: Response, f: Real) -> Margins:
    """Return the margins of a stable loop.

    Parameters
    ----------
    loop : callable
        Frequencies [Hz], shape (n,), to the loop gain L [1].
    f : ndarray, shape (n,)
        Frequencies [Hz], rising, dense enough that each crossing lies between two of them.
    """
    gain = loop(f)

    def value(x: float) -> complex:
        return complex(loop(np.array([x]))[0])

    def crossings(level: Real, of: Callable[[float], float]) -> list[float]:
        return [_crossing(of, f[i], f[i + 1]) for i in np.flatnonzero(level[:-1] * level[1:] < 0.0)]

    unity = crossings(np.abs(gain) - 1.0, lambda x: abs(value(x)) - 1.0)
    real = [value(x).real for x in crossings(gain.imag, lambda x: value(x).imag)]
    # Lag that turns L(f) onto -1, in (0, 2 pi).
    lags = [float((np.angle(value(x)) + np.pi) % (2.0 * np.pi)) for x in unity]
    return Margins(
        min((-1.0 / r for r in real if -1.0 < r < 0.0), default=math.inf),
        min(lags, default=math.inf),
        min((lag / (2.0 * np.pi * x) for lag, x in zip(lags, unity, strict=True)), default=math.inf),
        float(np.abs(1.0 + gain).min()),
        max(unity, default=math.nan),
    )
