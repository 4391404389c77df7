"""Joints: micro-slip, hardening and gaps, with their stiffness and damping for a vibration.

For a displacement ``X cos(w t)`` the fundamental of the force is ``X Re[(K + j H) exp(j w t)]``: K is the equivalent
stiffness, H the loss stiffness, both [N/m]; the equivalent viscous damping is ``H/w`` and the energy lost in a cycle
``pi H X^2``. None of these elements depends on the rate.

`DoublePinion` is a preloaded pair of pinions: two motors on one rack push against each other, so that no play is left.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, special

from process.errors import InputError
from process.friction import _kernels as kernels
from process.types import Real


def _amplitude(amplitude: ArrayLike) -> Real:
    x = np.asarray(amplitude, dtype=float)
    if not np.all(x > 0.0):
        raise InputError("an amplitude of vibration is not positive; give amplitudes > 0 in m")
    return x


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not 0.0 < value < np.inf:
            raise InputError(f"{name.replace('_', ' ')} is {value:g}; it must be positive and finite (SI units)")


class Joint(ABC):
    """A joint between two bodies: force against relative displacement. Subclasses are frozen dataclasses."""

    @abstractmethod
    def force(self, displacement: ArrayLike) -> Real:
        """Return the force [N] along a history of displacements [m], shape (n,), from the relaxed state."""

    @abstractmethod
    def equivalent_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the stiffness K [N/m] for a vibration of amplitude X [m]."""

    def loss_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the loss stiffness H [N/m] at amplitude X [m]; zero without hysteresis."""
        return np.zeros_like(_amplitude(amplitude))


def _slip_angle(limit: float, x: Real) -> Real:
    """Angle of the cycle from reversal to slip: ``arccos(1 - 2 limit/X)``; pi where nothing slips."""
    return np.arccos(np.clip(1.0 - 2.0 * limit / x, -1.0, 1.0))


@dataclass(frozen=True)
class Jenkins(Joint):
    """A spring in series with a Coulomb slider: sticks, then slips.

    With d = F/k and X > d: ``K = k/pi (q - sin(2 q)/2)``, ``q = arccos(1 - 2 d/X)``, ``H = 4 F (X - d)/(pi X^2)``;
    below, ``K = k``, ``H = 0``.

    Parameters
    ----------
    stiffness : float
        Stiffness k while sticking [N/m].
    slip_force : float
        Force F of the slider [N].
    """

    stiffness: float
    slip_force: float

    def __post_init__(self) -> None:
        """Refuse parameters without meaning."""
        _positive(stiffness=self.stiffness, slip_force=self.slip_force)

    def force(self, displacement: ArrayLike) -> Real:
        """Return the force [N] along a history of displacements [m], shape (n,), from the relaxed state."""
        return _history(np.array([self.stiffness]), np.array([self.slip_force]), displacement)

    def equivalent_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the stiffness K [N/m] at amplitude X [m]."""
        q = _slip_angle(self.slip_force / self.stiffness, _amplitude(amplitude))
        return np.asarray(self.stiffness / np.pi * (q - 0.5 * np.sin(2.0 * q)))

    def loss_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the loss stiffness H [N/m] at amplitude X [m]."""
        x = _amplitude(amplitude)
        slipping = np.clip(x - self.slip_force / self.stiffness, 0.0, None)
        return np.asarray(4.0 * self.slip_force * slipping / (np.pi * x**2))


@dataclass(frozen=True)
class Iwan(Joint):
    """Micro-slip: parallel Jenkins elements whose slip displacements are spread evenly from 0 to D (Iwan 1966).

    ``F(x) = k x (1 - x/(2 D))`` on first loading up to D, where all slips: ``F_max = k D/2``. For X <= D,
    ``K = k (1 - X/(2 D))`` and ``H = 2 k X/(3 pi D)``. For X > D, with ``q = arccos(1 - 2 D/X)``,
    ``K = k X/(2 pi D) (sin q - q cos q - sin(q)^3/3)`` and ``H = 4 k (X D/2 - D^2/3)/(pi X^2)``.

    Parameters
    ----------
    stiffness : float
        Stiffness k for small motion [N/m].
    slip_force : float
        Force ``F_max`` at which the whole joint slips [N].
    elements : int, optional
        Number of Jenkins elements that stand for the continuous spread in `force`.
    """

    stiffness: float
    slip_force: float
    elements: int = 100

    def __post_init__(self) -> None:
        """Refuse parameters without meaning."""
        _positive(stiffness=self.stiffness, slip_force=self.slip_force, elements=self.elements)

    @property
    def slip_displacement(self) -> float:
        """Displacement D at which the whole joint slips [m]."""
        return 2.0 * self.slip_force / self.stiffness

    def packed(self) -> tuple[Real, Real]:
        """Return stiffness [N/m] and slip force [N] of each element, as `process.friction._kernels` takes them."""
        each = np.full(self.elements, self.stiffness / self.elements)
        limit = (np.arange(self.elements) + 0.5) / self.elements * self.slip_displacement
        return each, each * limit

    def force(self, displacement: ArrayLike) -> Real:
        """Return the force [N] along a history of displacements [m], shape (n,), from the relaxed state."""
        return _history(*self.packed(), displacement)

    def equivalent_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the stiffness K [N/m] at amplitude X [m]."""
        x, d = _amplitude(amplitude), self.slip_displacement
        q = _slip_angle(d, x)
        gross = x / (2.0 * np.pi * d) * (np.sin(q) - q * np.cos(q) - np.sin(q) ** 3 / 3.0)
        return np.asarray(self.stiffness * np.where(x <= d, 1.0 - x / (2.0 * d), gross))

    def loss_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the loss stiffness H [N/m] at amplitude X [m]."""
        x, d = _amplitude(amplitude), self.slip_displacement
        gross = 4.0 * (0.5 * x * d - d**2 / 3.0) / (np.pi * x**2)
        return np.asarray(self.stiffness * np.where(x <= d, 2.0 * x / (3.0 * np.pi * d), gross))


@dataclass(frozen=True)
class PowerIwan(Joint):
    """Micro-slip whose strength follows a power law: the four-parameter Iwan joint of a bolted lap (Segalman 2005).

    Parallel Jenkins elements of density ``rho(d) = R d^chi`` over slip displacements d from 0 to D, and ``S`` at D
    itself, with ``K_T = R D^(chi + 1) (1 + beta)/(chi + 1)``, ``F_S = K_T D (beta + (chi + 1)/(chi + 2))/(1 + beta)``
    and ``beta = S (chi + 1)/(R D^(chi + 1))``. With ``r = min(1, D/X)``, ``q = arccos(1 - 2 r)`` and Euler's incomplete
    beta function B,

    ``K = K_T (q - sin(2 q)/2)/pi - 8 R X^(chi + 1) B(r; chi + 5/2, 3/2)/(pi (chi + 1))``,
    ``H = 4/(pi X^2) [R (X s^(chi + 2)/(chi + 2) - s^(chi + 3)/(chi + 3)) + S D max(0, X - D)]``, ``s = min(X, D)``.

    Below D the energy of a cycle is ``4 R X^(chi + 3)/((chi + 2)(chi + 3))``: a straight line of slope chi + 3 in
    logarithms, between 2 and 3 for bolted joints. The first loading curve is that of `force`. chi = beta = 0 is `Iwan`.
    Source: D. J. Segalman, A four-parameter Iwan model for lap-type joints, J. Appl. Mech. 72 (2005) 752-760; K follows
    from its density by the fundamental of a Jenkins element and integration by parts.

    Parameters
    ----------
    stiffness : float
        Stiffness K_T for small motion [N/m].
    slip_force : float
        Force F_S at which the whole joint slips [N].
    chi : float
        Exponent of the density, above -1; of measured joints between -1 and 0.
    beta : float
        Share of the elements that slip all at once over those that slip one after the other, 0 or more.
    elements : int, optional
        Number of Jenkins elements that stand for the continuous density in `force`.
    """

    stiffness: float
    slip_force: float
    chi: float
    beta: float = 0.0
    elements: int = 100

    def __post_init__(self) -> None:
        """Refuse parameters without meaning."""
        _positive(stiffness=self.stiffness, slip_force=self.slip_force, elements=self.elements)
        if not (-1.0 < self.chi < math.inf and 0.0 <= self.beta < math.inf):
            raise InputError(
                f"chi is {self.chi:g} and beta {self.beta:g}; give chi above -1 (bolted joints: between -1 and 0), "
                "beta zero or positive"
            )

    @property
    def slip_displacement(self) -> float:
        """Displacement D at which the whole joint slips [m]."""
        share = (self.beta + (self.chi + 1.0) / (self.chi + 2.0)) / (1.0 + self.beta)
        return self.slip_force / (self.stiffness * share)

    @property
    def density(self) -> float:
        """Density R of the elements [N/m^(chi + 2)]: alone with chi it says how the joint slips below D."""
        p = self.chi + 1.0
        return float(self.stiffness * p / ((1.0 + self.beta) * self.slip_displacement**p))

    def packed(self) -> tuple[Real, Real]:
        """Return stiffness [N/m] and slip force [N] of each element: equal parts, and that which slips all at once."""
        n, d, p = self.elements, self.slip_displacement, self.chi + 1.0
        edges = d * np.linspace(0.0, 1.0, n + 1) ** (1.0 / p)
        each = np.full(n, self.stiffness / (1.0 + self.beta) / n)
        # A part of the density slips where its mean does, so that the force of the whole joint is right.
        limit = p / (p + 1.0) * np.diff(edges ** (p + 1.0)) / np.diff(edges**p)
        last = self.stiffness * self.beta / (1.0 + self.beta)
        if last == 0.0:
            return each, each * limit
        return np.append(each, last), np.append(each * limit, last * d)

    def force(self, displacement: ArrayLike) -> Real:
        """Return the force [N] along a history of displacements [m], shape (n,), from the relaxed state."""
        return _history(*self.packed(), displacement)

    def equivalent_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the stiffness K [N/m] at amplitude X [m]."""
        x, p = _amplitude(amplitude), self.chi + 1.0
        share = np.minimum(self.slip_displacement / x, 1.0)
        q = _slip_angle(self.slip_displacement, x)
        slipped = special.betainc(p + 1.5, 1.5, share) * special.beta(p + 1.5, 1.5)
        stuck = self.stiffness * (q - 0.5 * np.sin(2.0 * q)) / np.pi
        # R X^(chi + 1)/(chi + 1), written so that it does not overflow.
        lost = self.stiffness / (1.0 + self.beta) * (x / self.slip_displacement) ** p
        return np.asarray(stuck - 8.0 / np.pi * lost * slipped)

    def loss_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the loss stiffness H [N/m] at amplitude X [m]."""
        x, d, p = _amplitude(amplitude), self.slip_displacement, self.chi + 1.0
        s = np.minimum(x, d)
        spread = self.stiffness * p / (1.0 + self.beta) * (s / d) ** p * s * (x / (p + 1.0) - s / (p + 2.0))
        at_once = self.stiffness * self.beta / (1.0 + self.beta) * d * np.clip(x - d, 0.0, None)
        return np.asarray(4.0 * (spread + at_once) / (np.pi * x**2))


@dataclass(frozen=True)
class ParallelJoints(Joint):
    """Joints across the same displacement, such as the edge and the middle of a lap: their forces add.

    Parameters
    ----------
    joints : tuple of Joint
        One or more.
    """

    joints: tuple[Joint, ...]

    def __post_init__(self) -> None:
        """Refuse no joint at all."""
        if not self.joints:
            raise InputError("no joint was given; parallel joints need one or more")

    def force(self, displacement: ArrayLike) -> Real:
        """Return the force [N] along a history of displacements [m], shape (n,), from the relaxed state."""
        return np.asarray(sum(j.force(displacement) for j in self.joints))

    def equivalent_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the stiffness K [N/m] at amplitude X [m]."""
        return np.asarray(sum(j.equivalent_stiffness(amplitude) for j in self.joints))

    def loss_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the loss stiffness H [N/m] at amplitude X [m]."""
        return np.asarray(sum(j.loss_stiffness(amplitude) for j in self.joints))


def _history(stiffness: Real, slip: Real, displacement: ArrayLike) -> Real:
    x = np.ascontiguousarray(displacement, dtype=float)
    if x.ndim != 1:
        raise InputError(f"the displacement has shape {x.shape}; a joint with memory needs one history, shape (n,)")
    out = np.empty(x.size)
    kernels.jenkins_history(stiffness, slip, np.zeros(stiffness.size), x, out)
    return out


@dataclass(frozen=True)
class CubicSpring(Joint):
    """A spring that hardens (or softens): ``k1 x + k3 x^3``; ``K = k1 + 3/4 k3 X^2``.

    Parameters
    ----------
    stiffness : float
        Linear stiffness k1 [N/m].
    cubic : float
        Cubic stiffness k3 [N/m^3]; negative softens.
    """

    stiffness: float
    cubic: float

    def force(self, displacement: ArrayLike) -> Real:
        """Return the force [N] at displacements [m] of any shape."""
        x = np.asarray(displacement, dtype=float)
        return np.asarray(self.stiffness * x + self.cubic * x**3)

    def equivalent_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the stiffness K [N/m] at amplitude X [m]."""
        return np.asarray(self.stiffness + 0.75 * self.cubic * _amplitude(amplitude) ** 2)


@dataclass(frozen=True)
class Gap(Joint):
    """Play of +-g between two elastic stops: no force inside, ``k (|x| - g)`` outside.

    ``K = k [1 - 2/pi (arcsin(g/X) + g/X sqrt(1 - (g/X)^2))]`` for X > g, else zero.

    Parameters
    ----------
    stiffness : float
        Stiffness k of a stop [N/m].
    gap : float
        Half of the play g [m].
    """

    stiffness: float
    gap: float

    def __post_init__(self) -> None:
        """Refuse parameters without meaning."""
        _positive(stiffness=self.stiffness)
        if not 0.0 <= self.gap < np.inf:
            raise InputError(f"the gap is {self.gap:g} m; give half of the play, zero or positive")

    def force(self, displacement: ArrayLike) -> Real:
        """Return the force [N] at displacements [m] of any shape."""
        x = np.asarray(displacement, dtype=float)
        return np.asarray(self.stiffness * np.sign(x) * np.clip(np.abs(x) - self.gap, 0.0, None))

    def equivalent_stiffness(self, amplitude: ArrayLike) -> Real:
        """Return the stiffness K [N/m] at amplitude X [m]."""
        share = np.minimum(self.gap / _amplitude(amplitude), 1.0)
        return np.asarray(self.stiffness * (1.0 - 2.0 / np.pi * (np.arcsin(share) + share * np.sqrt(1.0 - share**2))))


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
        """Refuse stiffness and preload that are not possible."""
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
        """Return the stiffness K [N/m] for a vibration ``b + X cos(w t)``.

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
