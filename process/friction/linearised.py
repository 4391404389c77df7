"""Linearised friction at a feed: impedance of a small vibration, equivalent damping of one with an amplitude.

`linearised` returns ``F/V = direct + residue/(s + rate)``; `equivalent_damping` the describing function of a law
without memory, tabulated by `DampingCurve`; `invariant_feed` the feed above which friction no longer changes a
response.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator
from scipy.optimize import brentq

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
    and d are the mean of both directions, which acts on the fundamental of a vibration.
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


# --- Equivalent damping

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
    """Return the equivalent damping c_eq(v0, V) of a law [N s/m], :eq:`equivalent-damping`, :eq:`coulomb-damping`.

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

    Returns
    -------
    float
        Feed [m/s]. Faster than this the frequency response depends on servo and structure alone (invariant FRF, Franco
        et al. 2024).

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
