"""What force a sweep puts where: spectra, means, peaks, torque and power, before anything is cut.

Harmonic h of the tooth passing frequency is a linear chirp of rate ``h g`` and slowly varying amplitude ``F_h``
(`process.cut.force.force_harmonics`). By stationary phase its transform at the frequencies that it passes is
``|F(f)| = |F_h|/(2 sqrt(h g))``; at both ends of the sweep the factor ``(Z(u_1) - Z(u_0))/(1 + j)`` with the Fresnel
integral Z is exact for a constant amplitude (Klauder et al., Bell Syst. Tech. J. 1960). Harmonics that pass the same
frequency do so at different times: over the band of an estimate their products average out, their energies add up.

The static force is enough: at the harmonics of the tooth passing frequency a stable cut does not regenerate, because
``1 - exp(-j w T) = 0``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import special

from process.cut.engagement import Engagement, engagement
from process.cut.force import CuttingCoefficients, force_harmonics, force_projection
from process.cut.tool import Tool
from process.types import Complex, Real
from smfe.identification.sweep.noise import median_spread
from smfe.identification.sweep.rules import RULES as SWEEP_RULES
from smfe.planning.rules import RULES


@dataclass(frozen=True)
class Pass:
    """Kind and radial width of one pass [m]."""

    cut: str
    width: float

    def engagement(self, diameter: float) -> Engagement:
        """Return the engagement of a tool of this diameter [m]."""
        return engagement(self.cut, self.width, diameter)

    def entry_length(self, diameter: float) -> float:
        """Return the way [m] from the first touch to the full arc of engagement, and the same again at the exit.

        Within a strip of the width ``a_e`` at the edge of a tool of radius R the tool reaches ``sqrt(R^2 - (R -
        a_e)^2)`` ahead of its centre, R where the strip passes the centre, and the arc is full when the centre is at
        the face. A central strip is met at R ahead and full at ``sqrt(R^2 - (a_e/2)^2)``.
        """
        radius = 0.5 * diameter
        if self.cut == "central":
            return radius - math.sqrt(max(radius**2 - (0.5 * self.width) ** 2, 0.0))
        return radius if self.width >= radius else math.sqrt(radius**2 - (radius - self.width) ** 2)


@dataclass(frozen=True)
class SweepPlan:
    """One set of passes, each a sweep of the spindle at constant feed rate.

    Parameters
    ----------
    tool : Tool
        With the inserts that are mounted.
    passes : tuple of Pass
        Each is cut `repeats` times.
    depth : float
        Axial depth of cut [m].
    feed_per_tooth : float
        At the start of the sweep [m].
    start, end : float
        Spindle rotation [rad/s].
    duration : float
        Time at full width [s], in which the spindle goes from `start` to `end`.
    repeats : int
        How often all passes are cut.
    lead, tail : float
        Time in air before and after [s].
    """

    tool: Tool
    passes: tuple[Pass, ...]
    depth: float
    feed_per_tooth: float
    start: float
    end: float
    duration: float
    repeats: int = 1
    lead: float = 0.5
    tail: float = 2.0

    @property
    def acceleration(self) -> float:
        """Spindle acceleration [rad/s2]."""
        return (self.end - self.start) / self.duration

    @property
    def tooth_passing(self) -> tuple[float, float]:
        """First and last tooth passing frequency [Hz]."""
        return self.tool.tooth_passing_frequency(self.start), self.tool.tooth_passing_frequency(self.end)

    @property
    def feed_rate(self) -> float:
        """Feed [m/s], held while the speed rises."""
        return self.feed_per_tooth * self.tooth_passing[0]

    @property
    def record(self) -> float:
        """Length of a record [s]: air, full width, air; entry and exit add to it."""
        return self.lead + self.duration + self.tail

    @property
    def length_of_cut(self) -> float:
        """Way of the tool at full width [m], on which the spindle accelerates."""
        return self.feed_rate * self.duration

    @property
    def entry(self) -> float:
        """Way on which the tool enters the work, and again on which it leaves it [m]; the longest of the passes."""
        return max((p.entry_length(self.tool.diameter) for p in self.passes), default=0.0)

    @property
    def stock(self) -> float:
        """Length of the work [m]: the tool enters it and cuts at full width."""
        return self.length_of_cut + self.entry

    @property
    def travel(self) -> float:
        """Travel of the axis in one pass [m]: air, entry, full width, exit, air."""
        return self.feed_rate * self.record + 2.0 * self.entry

    @property
    def pass_time(self) -> float:
        """Duration of one pass [s], entry and exit included."""
        return self.travel / self.feed_rate

    @property
    def records(self) -> int:
        """Number of records."""
        return self.repeats * len(self.passes)


def orders_within(tooth_passing: tuple[float, float], highest: float) -> NDArray[np.int64]:
    """Return the harmonics of a sweep that reach no higher than `highest` [Hz] where they begin."""
    return np.arange(1, max(1, math.floor(highest / tooth_passing[0])) + 1)


def edge_factor(frequency: ArrayLike, first: float, last: float, duration: float) -> Real:
    """Return the energy of a finite linear chirp at frequencies [Hz] over that of one without ends.

    ``|Z(u_1) - Z(u_0)|^2/2`` with ``u = sqrt(2 T/(f_2 - f_1)) (f_1 or f_2 - f)``.

    Parameters
    ----------
    frequency : array_like
        Where it is asked [Hz].
    first, last : float
        Frequencies that the chirp runs between [Hz].
    duration : float
        How long it lasts [s].
    """
    f = np.asarray(frequency, dtype=float)
    stretch = math.sqrt(2.0 * duration / (last - first))
    (s0, c0), (s1, c1) = (special.fresnel(stretch * (end - f)) for end in (first, last))
    return np.asarray(((s1 - s0) ** 2 + (c1 - c0) ** 2) / 2.0)


def unit_harmonics(
    tool: Tool, arc: Engagement, coefficients: CuttingCoefficients, depth: float, orders: ArrayLike
) -> tuple[Complex, Complex]:
    """Return the force harmonics per feed per tooth [N/m] and those of the edges [N], each of shape (orders, 3)."""
    edge = force_harmonics(tool, arc, coefficients, depth, 0.0, orders)
    return force_harmonics(tool, arc, coefficients, depth, 1.0, orders) - edge, edge


def energy(
    frequency: ArrayLike,
    harmonics: tuple[Complex, Complex],
    orders: NDArray[np.int64],
    tooth_passing: tuple[float, float],
    duration: float,
    feed_rate: float,
) -> Complex:
    """Return ``F F^H`` of the transform of one pass [N2 s2], shape (..., 3, 3), harmonics added as energies.

    ``sum_h F_h F_h^H/(4 h g)`` times the edge factor of each, with the feed per tooth ``v/f_t`` at the moment when
    harmonic h passes the frequency.

    Parameters
    ----------
    frequency : array_like
        Where it is asked [Hz].
    harmonics : pair of ndarray
        From `unit_harmonics`.
    orders : ndarray of int
        Which harmonics they are.
    tooth_passing : (float, float)
        Range of the tooth passing frequency [Hz].
    duration : float
        Time at full width [s], in which the spindle goes from `start` to `end`.
    feed_rate : float
        [m/s].
    """
    f = np.asarray(frequency, dtype=float)
    first, last = tooth_passing
    rate = (last - first) / duration
    total = np.zeros((*f.shape, 3, 3), dtype=complex)
    for h, chip, edge in zip(orders, *harmonics, strict=True):
        feed_per_tooth = feed_rate / np.clip(f / h, first, last)
        force = feed_per_tooth[..., None] * chip + edge
        share = edge_factor(f, h * first, h * last, duration) / (4.0 * h * rate)
        total += share[..., None, None] * force[..., :, None] * force[..., None, :].conj()
    return total


@dataclass(frozen=True)
class Forces:
    """The force harmonics of all passes of a plan, up to a frequency.

    Parameters
    ----------
    plan : SweepPlan
        The plan.
    coefficients : CuttingCoefficients
        Work material.
    highest : float
        Frequency up to which harmonics count [Hz].
    """

    plan: SweepPlan
    coefficients: CuttingCoefficients
    highest: float

    @cached_property
    def _orders(self) -> NDArray[np.int64]:
        return orders_within(self.plan.tooth_passing, self.highest)

    @cached_property
    def _harmonics(self) -> list[tuple[Complex, Complex]]:
        tool, depth = self.plan.tool, self.plan.depth
        return [
            unit_harmonics(tool, one.engagement(tool.diameter), self.coefficients, depth, self._orders)
            for one in self.plan.passes
        ]

    def energy(self, frequency: ArrayLike) -> list[Complex]:
        """Return `energy` of each pass, one record each."""
        return [self._of(frequency, slice(None), parts) for parts in self._harmonics]

    def beat_share(self, frequency: Real) -> Real:
        """Return the share of the energy that beats, shape (frequencies,): 0 for one harmonic, 1/2 for two alike.

        Products of harmonics that pass a frequency at times Delta t apart rotate with 1/(Delta t) over the frequency.
        ``1 - sum_h g_h^2/(sum_h g_h)^2`` of their energies g_h, mean over the passes.
        """
        shares = []
        for parts in self._harmonics:
            single = [self._of(frequency, slice(k, k + 1), parts) for k in range(self._orders.size)]
            each = np.trace(np.array(single), axis1=-2, axis2=-1).real
            shares.append(1.0 - np.sum(each**2, axis=0) / np.maximum(np.sum(each, axis=0) ** 2, 1e-300))
        return np.asarray(np.mean(shares, axis=0))

    def _of(self, frequency: ArrayLike, which: slice, parts: tuple[Complex, Complex]) -> Complex:
        plan, (chip, edge) = self.plan, parts
        return energy(
            frequency,
            (chip[which], edge[which]),
            self._orders[which],
            plan.tooth_passing,
            plan.duration,
            plan.feed_rate,
        )


@dataclass(frozen=True)
class Level:
    """Forces of one pass at one spindle speed, all teeth together.

    Parameters
    ----------
    mean : ndarray, shape (3,)
        Mean force on the tool [N].
    rms : ndarray, shape (3,)
        Root mean square of the force [N].
    peak : float
        Largest resultant [N].
    torque, peak_torque : float
        On the spindle, mean and largest [N m].
    """

    mean: Real
    rms: Real
    peak: float
    torque: float
    peak_torque: float


def force_level(
    tool: Tool, arc: Engagement, coefficients: CuttingCoefficients, depth: float, feed_per_tooth: float
) -> Level:
    """Return the level of the static cutting force over one tooth period; straight edges are taken.

    ``f(phi) = a_p (f_z P (s^2, s c, s) + P_e (s, c, 1)/sin k)`` for each engaged tooth; the torque is D/2 times the
    sum of ``F_t = a_p (K_tc f_z s + K_te/sin k)``. All are proportional to the depth.

    Parameters
    ----------
    tool, arc, coefficients
        The cut.
    depth, feed_per_tooth : float
        [m].
    """
    first = np.arange(RULES.angles) * (2.0 * math.pi / tool.teeth / RULES.angles)
    phi = (first[:, None] + 2.0 * math.pi / tool.teeth * np.arange(tool.teeth)) % (2.0 * math.pi)
    inside = (phi >= arc.entry) & (phi <= arc.exit)
    s, c, one = np.sin(phi) * inside, np.cos(phi) * inside, inside.astype(float)
    sine = math.sin(tool.approach_angle)
    chip = force_projection(coefficients.cutting, tool.approach_angle)
    edge = force_projection(coefficients.edge, tool.approach_angle) / sine
    both = (
        np.stack([np.sin(phi) * s, np.sin(phi) * c, s], axis=-1).sum(axis=1),
        np.stack([s, c, one], axis=-1).sum(axis=1),
    )
    force = depth * (feed_per_tooth * both[0] @ chip.T + both[1] @ edge.T)
    tangential = depth * (coefficients.Ktc * feed_per_tooth * s + coefficients.Kte / sine * one).sum(axis=1)
    torque = 0.5 * tool.diameter * tangential
    return Level(
        force.mean(axis=0),
        np.sqrt(np.mean(force**2, axis=0)),
        float(np.linalg.norm(force, axis=1).max()),
        float(torque.mean()),
        float(torque.max()),
    )


@dataclass(frozen=True)
class ForceSensor:
    """Noise of the forces, and what the estimator will know of it.

    Parameters
    ----------
    density : ndarray, shape (3,)
        ``sigma_F^2 dt``, two-sided [N2 s].
    subtracted : bool
        Whether it is measured in the air, so that it is taken out of the normal equations.
    known : float
        Relative standard deviation of that measurement, or of the bound.
    """

    density: Real
    subtracted: bool
    known: float


def force_sensor(
    plan: SweepPlan,
    coefficients: CuttingCoefficients,
    noise: Sequence[float],
    sample_rate: float,
    band: tuple[float, float],
) -> ForceSensor:
    """Return what the records of a plan will hold of the noise of their forces (`smfe.identification.sweep.noise`).

    The air is seen where the force is less than half of that in the cut; the median of its lines within the band is
    known to `smfe.identification.sweep.noise.median_spread` and no better than `SweepRules.noise_scatter`.

    Parameters
    ----------
    plan : SweepPlan
        The sweep.
    coefficients : CuttingCoefficients
        Work material.
    noise : sequence of float
        Root mean square of x, y, z in the record [N].
    sample_rate : float
        [Hz].
    band : (float, float)
        Of the identification [Hz].
    """
    square = np.square(noise)
    levels = [
        force_level(plan.tool, one.engagement(plan.tool.diameter), coefficients, plan.depth, plan.feed_per_tooth)
        for one in plan.passes
    ]
    # A noise n is in the cut too: n < sqrt(F^2 + n^2)/2.
    above_noise = [float(level.rms @ level.rms) > 3.0 * float(square.sum()) for level in levels]
    pieces = [
        t - SWEEP_RULES.air_margin
        for t in (plan.lead, plan.tail)
        if t - SWEEP_RULES.air_margin >= SWEEP_RULES.shortest_air
    ]
    lines = plan.repeats * sum(above_noise) * sum(pieces) * (band[1] - band[0])
    known = float(np.hypot(median_spread(lines), SWEEP_RULES.noise_scatter)) if lines else SWEEP_RULES.bounded_scatter
    return ForceSensor(square / sample_rate, bool(lines), known)


def with_inserts(tool: Tool, count: int) -> Tool:
    """Return the tool with only `count` of its pockets filled, equally spaced."""
    return replace(tool, teeth=count, pitch_angles=None, runout=None)


def possible_inserts(tool: Tool, asked: Sequence[int] = ()) -> list[int]:
    """Return the numbers of inserts that can be mounted equally spaced, most first."""
    fitting = [n for n in range(tool.teeth, 0, -1) if tool.teeth % n == 0]
    return [n for n in fitting if not asked or n in asked]
