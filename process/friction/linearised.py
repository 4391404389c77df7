"""What a small vibration feels of a friction law at a feed: ``F/V = direct + residue/(s + rate)``."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq
from scipy.special import ive

from process import units
from process.errors import InputError
from process.friction import _kernels as kernels
from process.friction.laws import (
    Andersson,
    Coulomb,
    CoulombViscous,
    FrictionLaw,
    GeneralisedMaxwellSlip,
    LuGre,
    MemoryLaw,
    Viscous,
)
from process.types import Complex, Real


@dataclass(frozen=True)
class FrictionImpedance:
    """Force over velocity of a linearised friction law.

    Attributes
    ----------
    direct : float
        [N s/m].
    residue : float
        [N/m]; zero for a law without memory.
    rate : float
        [1/s]; zero for a contact that sticks (a spring).
    """

    direct: float
    residue: float = 0.0
    rate: float = 0.0

    def __call__(self, s: ArrayLike) -> Complex:
        """Return ``s`` times the impedance [N/m], a dynamic stiffness, at complex s [rad/s]."""
        s = np.asarray(s, dtype=np.complex128)
        if self.residue == 0.0:
            return np.asarray(self.direct * s)
        memory = self.residue * (s / (s + self.rate) if self.rate > 0.0 else np.ones_like(s))
        return np.asarray(self.direct * s + memory)


def linearised(law: FrictionLaw | MemoryLaw, feed: float) -> FrictionImpedance:
    """Return the impedance of a friction law at a feed [m/s]; zero is a relaxed contact at rest.

    Without memory it is the slope f'(v0). LuGre in motion, from ``z' = v - k |v| z/s(v)``:
    ``sigma + (k + d s) b/(s + p)``, ``b = |v0| s'/s(v0)``, ``p = k |v0|/s(v0)``; at rest ``sigma + d + k/s``.
    Generalised Maxwell slip in motion: ``sigma + (C s'/s)/(s + C/s(v0))``; at rest ``sigma + sum k/s``. At rest sigma
    and d are the mean of both directions, which is what the fundamental of a vibration feels.
    """
    if isinstance(law, FrictionLaw):
        slope = float(law.slope(feed))
        if not math.isfinite(slope):
            raise InputError(
                "the friction force jumps at rest (kt is infinite): it has no slope there; give a finite kt, e.g. "
                "15000 s/m, or a feed"
            )
        return FrictionImpedance(slope)
    if feed == 0.0:
        sides = [law.towards(v) for v in (1.0, -1.0)]
        damping = sum(v.sigma + (v.bristle_damping if isinstance(v, LuGre) else 0.0) for v in sides)
        return FrictionImpedance(0.5 * damping, law.stiffness)
    law, speed = law.towards(feed), abs(feed)
    fall = math.exp(-((speed / law.stribeck_speed) ** law.delta)) * (law.static - law.coulomb)
    curve = law.coulomb + fall
    change = -fall * law.delta / speed * (speed / law.stribeck_speed) ** law.delta
    if isinstance(law, LuGre):
        share, rate = speed * change / curve, law.bristle_stiffness * speed / curve
        direct = law.sigma + law.bristle_damping * share
        return FrictionImpedance(direct, share * (law.bristle_stiffness - law.bristle_damping * rate), rate)
    if isinstance(law, GeneralisedMaxwellSlip):
        return FrictionImpedance(law.sigma, law.attraction * change / curve, law.attraction / curve)
    raise InputError(f"{type(law).__name__} is not a friction law that can be linearised")


# --- Equivalent damping of friction: what a vibration feels of a friction law while the axis is fed.

_NEAR = np.geomspace(3e-4, 0.3, 50)

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(16)


def steepness(law: FrictionLaw) -> float:
    """Return the largest kt [s/m] of a law: zero for viscous friction, infinite where the force jumps at rest."""
    if isinstance(law, Andersson):
        return max(law.kt, law.negative.kt if law.negative is not None else 0.0)
    if isinstance(law, Coulomb | CoulombViscous):
        return law.kt
    return 0.0


def _scale(law: FrictionLaw) -> float:
    """Velocity [m/s] in which the force changes most: 1/kt, or the Stribeck speed."""
    kt = steepness(law)
    scale = 1.0 / kt if kt > 0.0 else math.inf
    if isinstance(law, Andersson):
        speeds = [part.stribeck_speed for part in (law, law.negative) if part is not None]
        scale = min([s for s in (scale, *speeds) if s > 0.0])
    return scale if 0.0 < scale < math.inf else 1.0


def equivalent_damping(law: FrictionLaw, feed: ArrayLike, amplitude: ArrayLike) -> Real:
    """Return the equivalent damping c_eq(v0, V) of a law [N s/m].

    ``c_eq = 2/(pi V) int_0^pi f(v0 + V cos t) cos t dt`` by Gauss-Legendre quadrature on panels graded towards the
    passage through rest: some hundred evaluations of f, where the midpoint (Gauss-Chebyshev) rule needs 30 kt V of
    them; it also takes a force that jumps at rest (infinite kt).

    Parameters
    ----------
    law : FrictionLaw
        Friction without memory.
    feed : array_like
        Mean velocity v0 [m/s]; signed.
    amplitude : array_like
        Amplitude V of the vibration velocity [m/s], broadcast against `feed`. Zero gives the slope f'(v0).

    Returns
    -------
    ndarray
        Equivalent damping [N s/m], of the broadcast shape.
    """
    v0, v = np.broadcast_arrays(np.asarray(feed, dtype=float), np.asarray(amplitude, dtype=float))
    if not (np.all(np.isfinite(v)) and np.all(v >= 0.0) and np.all(np.isfinite(v0))):
        raise InputError("an amplitude of vibration velocity is negative or not finite; give amplitudes >= 0 in m/s")
    if isinstance(law, Viscous):
        return np.full(v.shape, law.sigma)
    bias, size = v0.ravel(), v.ravel()
    still = size == 0.0
    moving = np.where(still, 1.0, size)
    out = np.empty(size.size)
    kernels.first_harmonics(*law.packed(), bias, moving, _scale(law), _NODES, _WEIGHTS, out)
    return np.where(still, law.slope(bias), out / moving).reshape(v.shape)


def coulomb_damping(coulomb: float, feed: ArrayLike, amplitude: ArrayLike) -> Real:
    """Return c_eq of pure Coulomb friction ``F sign(v)`` in closed form [N s/m].

    Zero for V <= v0, else ``4 F/(pi V) sqrt(1 - (v0/V)^2)``; its largest value is ``2 F/(pi v0)``, at V = sqrt(2) v0.

    Parameters
    ----------
    coulomb : float
        Sliding force F [N].
    feed, amplitude : array_like
        Mean velocity v0 and amplitude V > 0 of the vibration velocity [m/s].
    """
    v0, v = np.asarray(feed, dtype=float), np.asarray(amplitude, dtype=float)
    return np.asarray(4.0 * coulomb / (np.pi * v) * np.sqrt(np.clip(1.0 - (v0 / v) ** 2, 0.0, None)))


def stribeck_damping(law: Andersson, feed: ArrayLike, amplitude: ArrayLike) -> Real:
    """Return c_eq of a sliding contact that never reverses, in closed form [N s/m].

    ``sigma - 2 (Fs - Fc) exp(-v0/vs) I1(V/vs)/V`` for delta = 1 and V < v0, where tanh(kt v) is 1 throughout.

    Parameters
    ----------
    law : Andersson
        Law with delta = 1; its part for positive velocity is used.
    feed, amplitude : array_like
        Mean velocity v0 and amplitude 0 < V < v0 of the vibration velocity [m/s].
    """
    v0, v = np.broadcast_arrays(np.asarray(feed, dtype=float), np.asarray(amplitude, dtype=float))
    if law.delta != 1.0:
        raise InputError(f"delta is {law.delta:g}; the closed form needs delta = 1, use equivalent_damping")
    if np.any(v >= v0) or np.any(v <= 0.0):
        raise InputError("the closed form needs 0 < amplitude < feed; use equivalent_damping where the motion reverses")
    vs = law.stribeck_speed
    bessel = ive(1, v / vs) * np.exp((v - v0) / vs)
    return np.asarray(law.sigma - 2.0 * (law.static - law.coulomb) * bessel / v)


def tanh_damping(kt: float, feed: float, amplitude: float, terms: int = 20000) -> float:
    """Return c_eq of ``tanh(kt v)``, per newton, as an exact series [s/m].

    ``4/(V b) {sum_n Re[1 - A_n/sqrt(A_n^2 - b^2)] + b^2/(2 pi^2 M)}``, ``A_n = kt v0 - j (2n - 1) pi/2``, ``b = kt V``,
    with the root for which ``|A - root| < |A + root|``; from ``tanh x = sum_n 2x/(x^2 + ((2n-1) pi/2)^2)``.

    Parameters
    ----------
    kt : float
        Steepness at rest [s/m].
    feed, amplitude : float
        Mean velocity v0 and amplitude V > 0 of the vibration velocity [m/s].
    terms : int, optional
        Number M of terms; the tail is added in closed form.
    """
    b = kt * amplitude
    a = kt * feed - 0.5j * np.pi * (2.0 * np.arange(1, terms + 1) - 1.0)
    root = np.sqrt(a**2 - b**2)
    root = np.where(np.abs(a - root) < np.abs(a + root), root, -root)
    # 1 - a/root without cancellation: (root - a)/root = -b^2/(root (root + a)).
    inside = float(np.sum(-(b**2) / (root * (root + a))).real) + b**2 / (2.0 * np.pi**2 * terms)
    return 4.0 * inside / (amplitude * b)


@dataclass(frozen=True)
class DampingCurve:
    """Equivalent damping of a law at one feed over the amplitude, tabulated once and interpolated.

    Parameters
    ----------
    law : FrictionLaw
        Friction without memory.
    feed : float
        Mean velocity v0 [m/s].
    lowest, highest : float, optional
        Ends of the table: amplitudes of vibration velocity [m/s]. Beyond them the ends are held.
    per_decade : int, optional
        Points in each decade of amplitude.

    Attributes
    ----------
    amplitude : ndarray, shape (n,)
        Amplitudes of vibration velocity [m/s], in geometric steps, denser about the feed.
    damping : ndarray, shape (n,)
        Equivalent damping [N s/m].
    """

    law: FrictionLaw
    feed: float
    lowest: float = 1e-8
    highest: float = 1.0
    per_decade: int = 50
    amplitude: Real = field(init=False, repr=False, compare=False)
    damping: Real = field(init=False, repr=False, compare=False)
    _curve: PchipInterpolator = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Fill the table."""
        if not 0.0 < self.lowest < self.highest:
            raise InputError(f"amplitudes run from {self.lowest:g} to {self.highest:g} m/s; give 0 < lowest < highest")
        count = 1 + math.ceil(self.per_decade * math.log10(self.highest / self.lowest))
        even = np.geomspace(self.lowest, self.highest, count)
        # The motion begins to reverse at V = |v0|: there the damping leaps up within v0/(kt v0).
        near = abs(self.feed) * (1.0 + np.concatenate([-_NEAR, [0.0], _NEAR]))
        grid = np.union1d(even, near[(near > self.lowest) & (near < self.highest)])
        damping = equivalent_damping(self.law, self.feed, grid)
        object.__setattr__(self, "amplitude", grid)
        object.__setattr__(self, "damping", damping)
        object.__setattr__(self, "_curve", PchipInterpolator(np.log(grid), damping))

    def __call__(self, amplitude: ArrayLike) -> Real:
        """Return the equivalent damping [N s/m] at amplitudes [m/s], by monotone cubics in log V."""
        inside = np.clip(np.asarray(amplitude, dtype=float), self.lowest, self.highest)
        return np.asarray(self._curve(np.log(inside)), dtype=float)


def damping_table(law: FrictionLaw, feed: Sequence[float], amplitude: ArrayLike) -> xr.DataArray:
    """Tabulate c_eq over feed and amplitude, labelled.

    Parameters
    ----------
    law : FrictionLaw
        Friction without memory.
    feed : sequence of float
        Feeds [mm/min], as the label shows them.
    amplitude : array_like, shape (n,)
        Amplitudes of vibration velocity [m/s].

    Returns
    -------
    xarray.DataArray
        ``equivalent_damping(feed, velocity_amplitude)`` [N s/m].
    """
    shop = np.asarray(feed, dtype=float)
    v0 = shop * units.factor("mm/min", "speed")
    size = np.asarray(amplitude, dtype=float)
    table = xr.DataArray(
        equivalent_damping(law, v0[:, None], size[None, :]),
        dims=("feed", "velocity_amplitude"),
        coords={"feed": shop, "velocity_amplitude": size},
        name="equivalent_damping",
        attrs={"units": "N s/m"},
    )
    table["feed"].attrs["units"] = "mm/min"
    table["velocity_amplitude"].attrs["units"] = "m/s"
    return table


def transient_damping(
    law: FrictionLaw,
    feed: float,
    response: Callable[[float], Real],
    tolerance: float = 1e-4,
    iterations: int = 200,
) -> float:
    """Return the constant damping that stands for friction in a transient, such as a hammer hit [N s/m].

    ``c = int (f(v0 + v) - f(v0)) v dt / int v^2 dt``: the least-squares line through the force, with v the response of
    the linear machine that has this very c (fixed point; each step goes half the way, in log c where c is positive).

    Parameters
    ----------
    law : FrictionLaw
        Friction without memory.
    feed : float
        Mean velocity v0 [m/s].
    response : callable
        Damping c [N s/m] -> vibration velocity of the friction point [m/s], shape (n,), in equal time steps.
    tolerance : float, optional
        Relative change of c at which the iteration ends.
    iterations : int, optional
        Largest number of iterations.

    Raises
    ------
    InputError
        When no damping reproduces itself.

    Notes
    -----
    Right for hits that leave the friction point where it was: locked, or sliding in one direction. In the transition
    no constant damping exists (errors of 50 % of the FRF); simulate such hits in time.
    """
    steady = float(law.force(feed))
    c = float(law.slope(feed))
    for _ in range(iterations):
        v = np.asarray(response(c), dtype=float)
        power = float(v @ v)
        if not (math.isfinite(power) and power > 0.0):
            raise InputError(f"the response with damping {c:g} N s/m is zero or not finite; the axis may be unstable")
        new = float((law.force(feed + v) - steady) @ v) / power
        if abs(new - c) <= tolerance * abs(new) + 1e-6:
            return new
        c = math.sqrt(c * new) if c > 0.0 and new > 0.0 else 0.5 * (c + new)
    raise InputError("no constant damping stands for the friction in this transient; simulate it in time")


def invariant_feed(law: FrictionLaw, force: float, gain: float, share: float = 0.1) -> float:
    """Return the feed above which friction no longer changes the response [m/s].

    The larger of the feeds at which the local slope (small vibration) and ``2 F/(pi v0)`` (vibration that reverses
    the motion) have fallen to `share` of the velocity gain of the servo.

    Parameters
    ----------
    law : FrictionLaw
        Friction without memory; the viscous part, which no feed changes, does not count.
    force : float
        Amplitude of the friction force that a reversal swings through [N].
    gain : float
        Velocity gain Kp of the servo [N s/m].
    share : float, optional
        What counts as small against the gain.

    Raises
    ------
    InputError
        When the slope stays above the limit up to 10 m/s.
    """
    if not (force > 0.0 and gain > 0.0 and share > 0.0):
        raise InputError(f"force {force:g} N, gain {gain:g} N s/m and share {share:g} must be positive")
    large = 2.0 * force / (math.pi * share * gain)
    settled = float(law.slope(10.0))

    def excess(log_feed: float) -> float:
        return abs(float(law.slope(math.exp(log_feed))) - settled) - share * gain

    grid = np.log(np.geomspace(1e-6, 10.0, 400))
    above = np.flatnonzero(np.array([excess(x) for x in grid]) > 0.0)
    if above.size == 0:
        return large
    last = int(above[-1])
    if last == grid.size - 1:
        raise InputError(f"the slope of the law does not settle below {share * gain:g} N s/m; check its parameters")
    return max(large, math.exp(float(brentq(excess, grid[last], grid[last + 1]))))
