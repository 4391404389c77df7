"""Friction laws of guideways and drives; `smfe.identification.drive.friction` identifies them from steady runs.

A law gives the force that opposes the motion: ``m x'' = F - law.force(x')``. All quantities are SI; `process.units`
turns ``mm/min`` into m/s (N min/mm into N s/m and min/mm into s/m both have the factor 6e4).
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from process.errors import InputError
from process.friction import _kernels as kernels
from process.types import Real


def _positive(**values: float) -> None:
    for name, value in values.items():
        if not value > 0.0:
            raise InputError(f"{name.replace('_', ' ')} is {value:g}; it must be positive (SI units)")


def _not_negative(**values: float) -> None:
    for name, value in values.items():
        if not 0.0 <= value < math.inf:
            raise InputError(f"{name.replace('_', ' ')} is {value:g}; give a finite value >= 0 (SI units)")


def _static_at_least(coulomb: float, static: float) -> None:
    if static < coulomb * (1.0 - 1e-9):
        raise InputError(
            f"the static force of {static:g} N is below the sliding force (coulomb) of {coulomb:g} N; the Stribeck "
            "curve falls from static to coulomb: give a static force at least as large"
        )


class FrictionLaw(ABC):
    """Friction without memory: a force for each velocity. Subclasses are frozen dataclasses."""

    @abstractmethod
    def packed(self) -> tuple[int, Real]:
        """Return the code of the law and its parameters, as `process.friction._kernels` takes them."""

    def force(self, velocity: ArrayLike) -> Real:
        """Return the force [N] that opposes the motion at velocities [m/s] of any shape."""
        return self._filled(kernels.friction_forces, velocity)

    def slope(self, velocity: ArrayLike) -> Real:
        """Return the local damping ``d force / d velocity`` [N s/m] at velocities [m/s] of any shape."""
        return self._filled(kernels.friction_slopes, velocity)

    def _filled(self, kernel: Callable[..., Any], velocity: ArrayLike) -> Real:
        v = np.asarray(velocity, dtype=float)
        out = np.empty(v.size)
        kernel(*self.packed(), np.ascontiguousarray(v).reshape(-1), out)
        return out.reshape(v.shape)


@dataclass(frozen=True)
class Viscous(FrictionLaw):
    """Force in proportion to velocity: ``sigma v``.

    Parameters
    ----------
    sigma : float
        Viscous coefficient [N s/m].
    """

    sigma: float

    def __post_init__(self) -> None:
        """Refuse a negative coefficient."""
        _not_negative(sigma=self.sigma)

    def packed(self) -> tuple[int, Real]:
        """Return the code of the law and its parameters."""
        return kernels.VISCOUS, np.array([self.sigma])


class _Step(FrictionLaw):
    """A step at rest and a slope: ``F tanh(kt v) + sigma v``."""

    coulomb: float
    sigma: float
    kt: float

    def __post_init__(self) -> None:
        """Refuse negative parameters."""
        _not_negative(coulomb_force=self.coulomb, sigma=self.sigma)
        _positive(kt=self.kt)

    def packed(self) -> tuple[int, Real]:
        """Return the code of the law and its parameters."""
        return kernels.COULOMB, np.array([self.coulomb, self.sigma, self.kt])


@dataclass(frozen=True)
class Coulomb(_Step):
    """Constant force against the motion: ``F tanh(kt v)``, which is ``F sign(v)`` for an infinite kt.

    Parameters
    ----------
    coulomb : float
        Sliding force F [N].
    kt : float, optional
        Steepness at rest [s/m]. A time simulation needs a finite one.
    """

    coulomb: float
    kt: float = math.inf
    sigma: float = field(default=0.0, init=False, repr=False)


@dataclass(frozen=True)
class CoulombViscous(_Step):
    """Coulomb and viscous friction: ``F tanh(kt v) + sigma v``.

    Parameters
    ----------
    coulomb : float
        Sliding force F [N].
    sigma : float
        Viscous coefficient [N s/m].
    kt : float, optional
        Steepness at rest [s/m]; infinite means sign(v).
    """

    coulomb: float
    sigma: float
    kt: float = math.inf


@dataclass(frozen=True)
class Andersson(FrictionLaw):
    """Stribeck curve through a smooth sign (Andersson et al. 2007; Eq. 5 of Franco et al. 2024), :eq:`friction`.

    ``f(v) = [Fc + (Fs - Fc) exp(-(|v|/vs)^delta)] tanh(kt v) + sigma v``

    Parameters
    ----------
    coulomb : float
        Sliding force Fc [N].
    static : float
        Largest static force Fs [N].
    stribeck_speed : float
        Velocity vs at which the Stribeck boost has fallen to 1/e [m/s].
    sigma : float
        Viscous coefficient [N s/m].
    kt : float
        Steepness at rest [s/m]; infinite means sign(v).
    delta : float, optional
        Shape of the Stribeck curve.
    negative : Andersson, optional
        The law for negative velocity, with its own positive parameters; by default the same.
    """

    coulomb: float
    static: float
    stribeck_speed: float
    sigma: float
    kt: float
    delta: float = 1.0
    negative: Andersson | None = None

    def __post_init__(self) -> None:
        """Refuse parameters without meaning."""
        _not_negative(coulomb_force=self.coulomb, static_force=self.static, sigma=self.sigma)
        _positive(stribeck_speed=self.stribeck_speed, kt=self.kt, delta=self.delta)
        _static_at_least(self.coulomb, self.static)
        if self.negative is not None and self.negative.negative is not None:
            raise InputError("the law for negative velocity has itself one for negative velocity; give it without")

    def slope(self, velocity: ArrayLike) -> Real:
        """Return the local damping ``d force / d velocity`` [N s/m] at velocities [m/s] of any shape.

        At rest, where the sides differ, it is their mean: that acts on the fundamental of a small vibration.
        """
        v = np.asarray(velocity, dtype=float)
        forth = super().slope(v)
        if self.negative is None or not np.any(v == 0.0):
            return forth
        back = float(self.negative.slope(0.0))
        return np.where(v == 0.0, 0.5 * (forth + back), forth)

    def _one_way(self) -> list[float]:
        return [self.coulomb, self.static, self.stribeck_speed, self.sigma, self.kt, self.delta]

    def packed(self) -> tuple[int, Real]:
        """Return the code of the law and its parameters."""
        backwards = self if self.negative is None else self.negative
        return kernels.ANDERSSON, np.array(self._one_way() + backwards._one_way())


class MemoryLaw(ABC):
    """Friction with memory: internal states that a velocity history drives. Subclasses are frozen dataclasses."""

    coulomb: float
    static: float
    stribeck_speed: float
    sigma: float
    delta: float
    negative: Self | None

    @abstractmethod
    def packed(self) -> tuple[int, Real]:
        """Return the code of the law and its parameters, as `process.friction._kernels.friction_step` takes them."""

    @property
    @abstractmethod
    def states(self) -> int:
        """Number of internal states; all zero is the relaxed law."""

    @property
    @abstractmethod
    def stiffness(self) -> float:
        """Stiffness of the contact while it sticks [N/m]."""

    @abstractmethod
    def holding(self, force: float) -> Real:
        """Return the internal states, shape (states,), in which a relaxed law has come to hold a force [N] at rest.

        Raises InputError for more than the static force.
        """

    def _holds(self, force: float) -> None:
        static = self.towards(force).static
        if not abs(force) <= static:
            raise InputError(f"friction of {static:g} N at rest does not hold {force:g} N; give less")

    def towards(self, velocity: float) -> Self:
        """Return the law for the direction of a velocity [m/s], with the same parameters both ways."""
        if velocity < 0.0 and self.negative is not None:
            return self.negative
        return replace(self, negative=None)  # type: ignore[type-var]  # subclasses are dataclasses

    def steady_force(self, velocity: ArrayLike) -> Real:
        """Return the force [N] under constant velocity: ``s(v) sign(v) + sigma v`` with the Stribeck curve s."""
        return self._steady().force(velocity)

    def _steady(self) -> Andersson:
        forth = Andersson(self.coulomb, self.static, self.stribeck_speed, self.sigma, math.inf, self.delta)
        return forth if self.negative is None else replace(forth, negative=self.negative._steady())

    def history(self, velocity: ArrayLike, step: float) -> Real:
        """Return the force [N] at the end of each step [s] of a velocity history [m/s], shape (n,), from rest."""
        v = np.ascontiguousarray(velocity, dtype=float)
        if v.ndim != 1 or not step > 0.0:
            raise InputError(f"velocity of shape {v.shape} and step {step:g} s: give shape (n,) and a positive step")
        out = np.empty(v.size)
        kernels.friction_history(*self.packed(), np.zeros(self.states), v, step, out)
        return out

    def _check(self) -> None:
        _not_negative(sigma=self.sigma)
        _positive(
            coulomb_force=self.coulomb, static_force=self.static, stribeck_speed=self.stribeck_speed, delta=self.delta
        )
        _static_at_least(self.coulomb, self.static)
        if self.negative is not None and type(self.negative) is not type(self):
            raise InputError(f"the law for negative velocity is no {type(self).__name__}; give one of the same kind")
        if self.negative is not None and self.negative.negative is not None:
            raise InputError("the law for negative velocity has itself one for negative velocity; give it without")


@dataclass(frozen=True)
class LuGre(MemoryLaw):
    """Bristles that bend and slip (Canudas de Wit et al. 1995).

    ``z' = v - k |v| z / s(v)``, ``f = k z + d z' + sigma v``, ``s(v) = Fc + (Fs - Fc) exp(-(|v|/vs)^delta)``

    Where the directions differ v decides whose parameters count; at v = 0, where ``z' = v``, the force does not jump.

    Parameters
    ----------
    bristle_stiffness : float
        Stiffness k of the contact [N/m].
    bristle_damping : float
        Damping d of the bristles [N s/m].
    coulomb, static : float
        Sliding and largest static force [N].
    stribeck_speed : float
        Velocity vs [m/s].
    sigma : float
        Viscous coefficient [N s/m].
    delta : float, optional
        Shape of the Stribeck curve.
    negative : LuGre, optional
        The law for negative velocity, with its own positive parameters but the same bristle stiffness, as the bristles
        stay bent on reversal; by default the same.
    """

    bristle_stiffness: float
    bristle_damping: float
    coulomb: float
    static: float
    stribeck_speed: float
    sigma: float
    delta: float = 1.0
    negative: LuGre | None = None

    def __post_init__(self) -> None:
        """Refuse parameters without meaning."""
        self._check()
        _positive(bristle_stiffness=self.bristle_stiffness)
        _not_negative(bristle_damping=self.bristle_damping)
        if self.negative is not None and self.negative.bristle_stiffness != self.bristle_stiffness:
            raise InputError(
                f"bristle stiffness is {self.bristle_stiffness:g} N/m and for negative velocity "
                f"{self.negative.bristle_stiffness:g} N/m; the bristles are the same: give both the same"
            )

    def _one_way(self) -> list[float]:
        curve = [self.coulomb, self.static, self.stribeck_speed, self.delta]
        return [self.bristle_damping, self.sigma, *curve]

    def packed(self) -> tuple[int, Real]:
        """Return the code of the law and its parameters."""
        backwards = self if self.negative is None else self.negative
        return kernels.LUGRE, np.array([self.bristle_stiffness, *self._one_way(), *backwards._one_way()])

    def holding(self, force: float) -> Real:
        """Return the bend of the bristles [m] that holds a force [N] at rest."""
        self._holds(force)
        return np.array([force / self.bristle_stiffness])

    @property
    def states(self) -> int:
        """One: the bend of the bristles [m]."""
        return 1

    @property
    def stiffness(self) -> float:
        """Stiffness of the contact while it sticks [N/m]."""
        return self.bristle_stiffness


@dataclass(frozen=True)
class GeneralisedMaxwellSlip(MemoryLaw):
    """Parallel elements that stick and slip (Al-Bender, Lampaert, Swevers 2005).

    An element that sticks follows ``F' = k v`` until it carries its share a of the Stribeck curve s(v); then
    ``F' = C (a - F/s(v))`` (signs for v > 0) until the velocity reverses. The force is their sum and ``sigma v``.

    Parameters
    ----------
    element_stiffness : tuple of float
        Stiffness k of each element [N/m].
    share : tuple of float
        Share a of each element; the sum is 1.
    coulomb, static : float
        Sliding and largest static force [N].
    stribeck_speed : float
        Velocity vs [m/s].
    sigma : float
        Viscous coefficient [N s/m].
    attraction : float
        Rate C at which a slipping element is drawn to the Stribeck curve [N/s].
    delta : float, optional
        Shape of the Stribeck curve.
    negative : GeneralisedMaxwellSlip, optional
        The law for negative velocity, with its own Stribeck curve and `sigma` but the same elements and attraction; by
        default the same.
    """

    element_stiffness: tuple[float, ...]
    share: tuple[float, ...]
    coulomb: float
    static: float
    stribeck_speed: float
    sigma: float
    attraction: float
    delta: float = 1.0
    negative: GeneralisedMaxwellSlip | None = None

    def __post_init__(self) -> None:
        """Refuse parameters without meaning."""
        self._check()
        _positive(attraction=self.attraction)
        if len(self.element_stiffness) != len(self.share) or not self.share:
            given = f"{len(self.element_stiffness)} stiffnesses and {len(self.share)} shares"
            raise InputError(f"{given} were given; give as many of both")
        for k, a in zip(self.element_stiffness, self.share, strict=True):
            _positive(element_stiffness=k, share=a)
        if not math.isclose(sum(self.share), 1.0, rel_tol=1e-6):
            raise InputError(f"the shares sum to {sum(self.share):g}; they must sum to 1")
        if self.negative is not None and self.negative._elements() != self._elements():
            raise InputError(
                f"elements {self._elements()} and for negative velocity {self.negative._elements()} (stiffness, share, "
                "attraction); they are the same: give both the same"
            )

    def _elements(self) -> tuple[object, ...]:
        return tuple(self.element_stiffness), tuple(self.share), self.attraction

    def _one_way(self) -> list[float]:
        return [self.coulomb, self.static, self.stribeck_speed, self.delta, self.sigma]

    def packed(self) -> tuple[int, Real]:
        """Return the code of the law and its parameters."""
        backwards = self if self.negative is None else self.negative
        elements = [x for pair in zip(self.element_stiffness, self.share, strict=True) for x in pair]
        return kernels.MAXWELL_SLIP, np.array([self.attraction, *self._one_way(), *backwards._one_way(), *elements])

    def holding(self, force: float) -> Real:
        """Return force [N] and direction of slip of each element, pulled from rest up to a force [N].

        One that carries all that it can does not slip yet: at rest nothing moves.
        """
        self._holds(force)
        stiffness = np.array(self.element_stiffness)
        most = np.array(self.share) * self.towards(force).static
        order = np.argsort(most / stiffness)
        # Up to the travel at which an element slips, those before it slip and those from it on follow.
        travel = (most / stiffness)[order]
        slipped = np.concatenate([[0.0], np.cumsum(most[order])[:-1]])
        following = np.cumsum(stiffness[order][::-1])[::-1]
        at = float(np.interp(abs(force), slipped + following * travel, travel, left=abs(force) / stiffness.sum()))
        out = np.zeros(self.states)
        out[::2] = math.copysign(1.0, force) * np.minimum(stiffness * at, most)
        return out

    @property
    def states(self) -> int:
        """Two an element: its force [N] and its direction of slip (0: it sticks)."""
        return 2 * len(self.share)

    @property
    def stiffness(self) -> float:
        """Stiffness of the contact while it sticks [N/m]."""
        return sum(self.element_stiffness)
