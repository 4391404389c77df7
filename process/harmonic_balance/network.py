"""A linear machine with nonlinear elements: guideways with friction, joints that slip, harden or have play.

Between the tool (T directions, first) and P elements the linear machine has the compliance G; element p resists with
the force f_p of its motion u_p: the velocity at a guideway, ``s_p = j w``, or the displacement at a joint, ``s_p = 1``,

    u_p(k w) = s_p(k w) (G_pe F delta_k1 - sum_q G_pq f_q(k w)),   x_t(k w) = G_te F delta_k1 - sum_q G_tq f_q(k w).

This is :eq:`harmonic-balance`. A `reference` coefficient (force for a unit of u) may belong to the linear machine; the
element resists with the rest. Convention exp(+j w t); phasors are peak values.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from process.errors import InputError
from process.friction import _kernels as friction_kernels
from process.friction.laws import Andersson, FrictionLaw
from process.friction.linearised import DampingCurve, equivalent_damping, steepness
from process.harmonic_balance import _kernels as kernels
from process.machine.joints import CubicSpring, Gap, Iwan, Jenkins, Joint, PowerIwan
from process.types import Complex, Real

Compliance = Callable[[Real], Complex]
"""Frequency [Hz], shape (n,) -> compliance [m/N], shape (n, T + P, T + P); response before excitation."""

_PARAMETERS = 12  # of a friction law in the kernels, both directions


@dataclass(frozen=True)
class BalanceRules:
    """Numbers of the harmonic balance."""

    tolerance: float = 1e-3
    """Estimated relative error of a compliance above which more harmonics are used."""

    harmonics: tuple[int, ...] = (9, 25, 70, 140)
    """Highest harmonics that are tried one after the other."""

    error_harmonics: int = 9
    """Highest harmonic of the error estimate of a single-harmonic balance."""

    nodes: int = 8
    """Gauss nodes of a panel of the period."""

    table_per_decade: float = 60.0
    """Amplitudes a decade at which the coefficient of a joint is tabulated."""

    sweeps: int = 3
    """Rounds over all elements, each solved with the others held, before Newton's method."""

    newton_steps: int = 25
    """Newton steps of a single-harmonic balance."""

    difference: float = 1e-4
    """Step of the logarithm of an amplitude for its derivative."""

    close: float = 1e-9
    """Residual, a logarithm of an amplitude, at which Newton's method ends."""

    softest: float = 300.0
    """Steepness kt [s/m] at which the continuation of many harmonics starts."""

    continuation_steps: int = 7
    """Steps from the softest passage through rest to that of the law."""

    continuation_newton_steps: int = 40
    """Newton steps at each of them."""

    direct_steps: int = 15
    """Newton steps from a guess, before the continuation is tried."""

    interpolation: float = 1e-3
    """Relative error of straight lines between tabulated admittances."""

    nyquist: tuple[float, float] = (1e-4, 1e5)
    """Frequencies [Hz] between which Nyquist's curve is followed."""

    phase_step: float = 0.5
    """Step of its phase [rad], at most."""

    free_speed: float = 0.01
    """Speed [m/s] at which the friction of a slide without servo becomes part of the linear machine."""


RULES = BalanceRules()


class NonlinearElement(ABC):
    """A nonlinear force at one place of the machine. Subclasses are frozen dataclasses."""

    reference: float

    @property
    @abstractmethod
    def uses_displacement(self) -> bool:
        """Whether u is a displacement [m]; else a velocity [m/s]."""

    @property
    @abstractmethod
    def symmetric(self) -> bool:
        """Whether a motion that repeats with the other sign after half a period gives a force that does so."""

    @abstractmethod
    def coefficient(self, amplitude: ArrayLike) -> Complex:
        """Return force over u for a sine of amplitude |u|, less the reference."""

    @abstractmethod
    def table(self, lowest: float, highest: float) -> tuple[Real, Complex]:
        """Return rising amplitudes and the coefficient there."""

    @abstractmethod
    def packed(self) -> tuple[int, Real, float, tuple[Real, Real], float]:
        """Return code, parameters, steepness, (stiffness, slip) of the elements, bias."""

    def softened(self, kt: float) -> NonlinearElement:
        """Return the element with a passage through rest no steeper than kt [s/m]."""
        return self


@dataclass(frozen=True)
class FrictionElement(NonlinearElement):
    """A guideway that is fed at a constant rate; the drive holds its mean velocity.

    Parameters
    ----------
    law : FrictionLaw
        Friction without memory, with finite steepness at rest.
    feed : float
        Feed v0 [m/s]; zero is idle, negative the other direction.
    reference : float, optional
        Damping that belongs to the linear machine [N s/m].
    """

    law: FrictionLaw
    feed: float
    reference: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a force that jumps at rest."""
        if math.isinf(steepness(self.law)):
            raise InputError("the friction force jumps at rest (kt is infinite); give a finite kt, e.g. 15000 s/m")

    @property
    def uses_displacement(self) -> bool:
        """A velocity."""
        return False

    @property
    def symmetric(self) -> bool:
        """Idle, with the same law both ways."""
        one_way = isinstance(self.law, Andersson) and self.law.negative not in (None, self.law)
        return self.feed == 0.0 and not one_way

    def coefficient(self, amplitude: ArrayLike) -> Complex:
        """Return the equivalent damping [N s/m] at amplitudes [m/s]."""
        return (equivalent_damping(self.law, self.feed, amplitude) - self.reference).astype(np.complex128)

    def table(self, lowest: float, highest: float) -> tuple[Real, Complex]:
        """Return the amplitudes [m/s] and values of a `DampingCurve`."""
        curve = DampingCurve(self.law, self.feed, lowest, highest)
        return curve.amplitude, (curve.damping - self.reference).astype(np.complex128)

    def packed(self) -> tuple[int, Real, float, tuple[Real, Real], float]:
        """Return code, parameters, steepness, no elements, feed."""
        kt = self.law.kt if isinstance(self.law, _SoftenedLaw) else steepness(self.law)
        return *self.law.packed(), kt, (np.empty(0), np.empty(0)), self.feed

    def softened(self, kt: float) -> FrictionElement:
        """Return the element with a law no steeper than kt [s/m]."""
        return (
            self
            if steepness(self.law) <= kt
            else FrictionElement(_SoftenedLaw(self.law, kt), self.feed, self.reference)
        )


@dataclass(frozen=True)
class _SoftenedLaw(FrictionLaw):
    law: FrictionLaw
    kt: float

    def packed(self) -> tuple[int, Real]:
        code, parameters = self.law.packed()
        for i in {friction_kernels.COULOMB: [2], friction_kernels.ANDERSSON: [4, 10]}.get(code, []):
            parameters[i] = min(parameters[i], self.kt)
        return code, parameters


@dataclass(frozen=True)
class JointElement(NonlinearElement):
    """A joint across which the machine moves.

    Parameters
    ----------
    joint : Joint
        Jenkins, Iwan, PowerIwan, CubicSpring or Gap.
    reference : float, optional
        Stiffness that belongs to the linear machine [N/m].
    """

    joint: Joint
    reference: float = 0.0

    @property
    def uses_displacement(self) -> bool:
        """A displacement."""
        return True

    @property
    def symmetric(self) -> bool:
        """Every joint is."""
        return True

    def coefficient(self, amplitude: ArrayLike) -> Complex:
        """Return ``K + j H`` [N/m] at amplitudes [m]."""
        x = np.maximum(np.asarray(amplitude, dtype=float), 1e-30)
        k, h = self.joint.equivalent_stiffness(x), self.joint.loss_stiffness(x)
        return np.asarray(k - self.reference + 1j * h)

    def table(self, lowest: float, highest: float) -> tuple[Real, Complex]:
        """Return 60 amplitudes [m] a decade and the coefficient there."""
        x = np.geomspace(lowest, highest, 1 + math.ceil(RULES.table_per_decade * math.log10(highest / lowest)))
        return x, self.coefficient(x)

    def packed(self) -> tuple[int, Real, float, tuple[Real, Real], float]:
        """Return code, parameters, no steepness, elements, no bias."""
        none, j = (np.empty(0), np.empty(0)), self.joint
        if isinstance(j, CubicSpring):
            return kernels.CUBIC, np.array([j.stiffness, j.cubic]), 0.0, none, 0.0
        if isinstance(j, Gap):
            return kernels.GAP, np.array([j.stiffness, j.gap]), 0.0, none, 0.0
        if isinstance(j, Jenkins):
            elements = np.array([j.stiffness]), np.array([j.slip_force])
            return kernels.SLIDERS, np.empty(0), 0.0, elements, 0.0
        if isinstance(j, Iwan | PowerIwan):
            return kernels.SLIDERS, np.empty(0), 0.0, j.packed(), 0.0
        raise InputError(
            f"the joint is a {type(j).__name__}; harmonic balance takes Jenkins, Iwan, PowerIwan, CubicSpring and Gap"
        )


@dataclass(frozen=True)
class Network:
    """A linear machine and its nonlinear elements.

    Parameters
    ----------
    compliance : callable
        Frequency [Hz], shape (n,) -> compliance of the linear machine [m/N], shape (n, T + P, T + P): first the
        directions of the tool, then the elements; response before excitation.
    elements : sequence of NonlinearElement
        Friction and joints.
    directions : int, optional
        Number T.
    static : ndarray, shape (P, P), optional
        Compliance between the elements at 0 Hz with the slides held [m/N], for the mean of a motion; default: the
        mean of every element stays.
    unstable_poles : int, optional
        Of the linear machine without its elements.
    """

    compliance: Compliance
    elements: Sequence[NonlinearElement]
    directions: int = 1
    static: Real | None = None
    unstable_poles: int = 0

    @property
    def symmetric(self) -> bool:
        """Whether odd harmonics are enough."""
        return all(p.symmetric for p in self.elements)

    @property
    def displaced(self) -> NDArray[np.bool_]:
        """Which elements take a displacement, shape (P,)."""
        return np.array([p.uses_displacement for p in self.elements], dtype=bool)

    def matrix(self, frequency: Real) -> Complex:
        """Return the compliance [m/N], shape (n, T + P, T + P), checked."""
        g = np.asarray(self.compliance(frequency), dtype=complex)
        size = self.directions + len(self.elements)
        if g.shape != (frequency.size, size, size):
            needed = (frequency.size, size, size)
            raise InputError(f"the compliance has shape {g.shape}; {needed} is needed: tool, elements")
        if not np.all(np.isfinite(g)):
            raise InputError("the compliance is not finite at some frequency; check the machine model there")
        return g

    def admittance(self, frequency: Real, compliance: Complex) -> Complex:
        """Return u over force between the elements, shape (n, P, P), of their compliance."""
        s = np.where(self.displaced, 1.0, 2j * np.pi * frequency[:, None])
        return np.asarray(s[:, :, None] * compliance)

    def reached(self, frequency: Real, excitation: int) -> NDArray[np.int64]:
        """Return which elements a force on the tool can move at these frequencies, through others or not: indices."""
        t = self.directions
        g = self.matrix(frequency)
        size = np.abs(g).max(axis=0)
        scale = np.sqrt(np.diag(size))
        linked = size > 1e-10 * np.outer(scale, scale)
        reach = linked[t:, excitation]
        for _ in self.elements:
            reach = reach | (linked[t:, t:] & reach).any(axis=1)
        return np.flatnonzero(reach)

    def part(self, which: NDArray[np.int64]) -> Network:
        """Return the network with some of the elements; the others do not matter."""
        rows = np.concatenate([np.arange(self.directions), self.directions + which])
        static = None if self.static is None else self.static[np.ix_(which, which)]
        elements = tuple(self.elements[i] for i in which)

        def compliance(frequency: Real) -> Complex:
            return np.asarray(self.compliance(frequency))[:, rows][:, :, rows]

        return Network(compliance, elements, self.directions, static, self.unstable_poles)

    def packed(self, steepest: float = math.inf) -> kernels.Elements:
        """Return the elements as the kernels take them, with a passage through rest no steeper than given [s/m]."""
        parts = [p.softened(steepest).packed() for p in self.elements]
        most = max([e[0].size for _, _, _, e, _ in parts], default=0)
        parameters, stiffness, slip = np.zeros((len(parts), _PARAMETERS)), *np.zeros((2, len(parts), max(most, 1)))
        for i, (_, p, _, (k, f), _) in enumerate(parts):
            parameters[i, : p.size], stiffness[i, : k.size], slip[i, : f.size] = p, k, f
        return kernels.Elements(
            np.array([code for code, *_ in parts], dtype=np.int64),
            parameters,
            np.array([kt for _, _, kt, _, _ in parts], dtype=float),
            np.where(stiffness > 0.0, stiffness, 1e-300),
            np.where(stiffness > 0.0, slip, 1e300),
            np.array([bias for *_, bias in parts], dtype=float),
            self.displaced,
            np.array([p.reference for p in self.elements], dtype=float),
        )

    def grid(self, highest: int) -> kernels.Grid:
        """Return harmonics up to `highest` and the nodes to integrate over; odd ones and half a period if symmetric."""
        return _grid(highest, self.symmetric, bool(self.displaced.any()))


@lru_cache(maxsize=32)
def _grid(highest: int, odd: bool, mean: bool) -> kernels.Grid:
    """Return the grid of a network that is symmetric (odd) or not, whose mean may move or not."""
    orders = np.arange(1, highest + 1, 2) if odd else np.arange(0 if mean else 1, highest + 1)
    step, span = (2, 0.5) if odd else (1, 1.0)
    panels = math.ceil(span * (6.0 * highest + 48.0) / RULES.nodes)
    nodes, share = np.polynomial.legendre.leggauss(RULES.nodes)
    nodes, share = 0.5 * (1.0 + nodes), 0.5 * share
    t = 2.0 * np.pi * span / panels * (np.arange(panels)[:, None] + nodes).reshape(-1, 1)
    lags = np.arange(0, 2 * highest + 1, step)
    waves = [np.ascontiguousarray(w) for w in (np.cos(t * orders), np.sin(t * orders))]
    return kernels.Grid(
        orders.astype(np.int64),
        step,
        span,
        nodes,
        share,
        panels,
        waves[0],
        waves[1],
        np.cos(t * lags),
        np.sin(t * lags),
    )


def checked(force: float, frequency: ArrayLike) -> Real:
    """Return the frequencies [Hz], shape (n,), when they and the amplitude [N] fit harmonic balance."""
    f = np.atleast_1d(np.asarray(frequency, dtype=float))
    if not (force > 0.0 and math.isfinite(force)):
        raise InputError(f"the force amplitude is {force:g} N; harmonic balance needs a positive one")
    if f.ndim != 1 or f.size == 0 or np.any(f <= 0.0) or not np.all(np.isfinite(f)):
        raise InputError("frequencies must be a list of positive numbers [Hz]; leave 0 Hz out")
    return f


@dataclass(frozen=True)
class Balance:
    """Response to a sine force on the tool.

    Attributes
    ----------
    frequency : ndarray, shape (n,)
        Frequency [Hz].
    compliance : ndarray of complex, shape (n, T)
        Fundamental of the displacement of the tool over the force [m/N].
    motion : ndarray of complex, shape (n, P, K)
        Phasors of the motion of the elements, [m/s] or [m], at the harmonics `orders`.
    orders : ndarray of int, shape (K,)
        Harmonics.
    coefficient : ndarray of complex, shape (n, P)
        Fundamental of the force over that of the motion: damping [N s/m], or ``K + j H`` [N/m].
    solutions : ndarray of int, shape (n,)
        Number of single-harmonic solutions; 1 where the method does not look for more.
    converged : ndarray of bool, shape (n,)
        False where no solution was found (the values are then not a number).
    error : ndarray, shape (n,)
        Estimated relative error of the compliance that the neglected harmonics make.
    """

    frequency: Real
    compliance: Complex
    motion: Complex
    orders: NDArray[np.int64]
    coefficient: Complex
    solutions: NDArray[np.int64]
    converged: NDArray[np.bool_]
    error: Real

    @property
    def fundamental(self) -> Complex:
        """Fundamental of the motion of the elements, shape (n, P)."""
        return np.asarray(self.motion[:, :, int(np.argmax(self.orders == 1))])

    def part(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Balance:
        """Return the balance at some of the frequencies."""
        return Balance(
            self.frequency[which], self.compliance[which], self.motion[which], self.orders,
            self.coefficient[which], self.solutions[which], self.converged[which], self.error[which],
        )  # fmt: skip

    def spread(self, network: Network, which: NDArray[np.int64]) -> Balance:
        """Return the balance with all elements of a network, where `which` have been moved and the others rest."""
        n, p = self.frequency.size, len(network.elements)
        motion = np.zeros((n, p, self.orders.size), dtype=complex)
        rest = [complex(q.coefficient(0.0)) + q.reference for q in network.elements]
        coefficient = np.tile(np.array(rest, dtype=complex), (n, 1))
        motion[:, which], coefficient[:, which] = self.motion, self.coefficient
        return replace(self, motion=motion, coefficient=coefficient)

    def replaced(self, where: NDArray[np.int64], other: Balance) -> Balance:
        """Return the balance with another, of the same harmonics, in some places."""
        names = ("compliance", "motion", "coefficient", "converged", "error")
        new = {name: getattr(self, name).copy() for name in names}
        for name in names:
            new[name][where] = getattr(other, name)
        return replace(self, **new)
