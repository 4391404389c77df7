"""A machine model in a cut that is fed: vibrations of constant size, and the depth at which each keeps its size.

Guideways and joints answer a vibration by the coefficient c of its amplitude (:eq:`equivalent-damping`). A cut at the
mean directional matrix closes the loop, ``F = B Phi(c) F`` with ``B = a (1 - exp(-j w T)) A0``; for a given amplitude V
of the guideways the zero-order limit with ``Phi(c(V))`` is the depth at which a vibration of that amplitude neither
grows nor decays. V -> 0 is the limit of a small disturbance.

Where a guideway comes to rest within a cycle its motion is no sine: the harmonics of that motion are solved for
(`process.harmonic_balance.imposed_motion`), with the cut closed at each of them, and c becomes complex. One harmonic
alone puts the cycles of the bench of Franco et al. 2024 at amplitudes that are up to 60 % too small.

The *kick* is the impulse at the tool that leads onto the cycle, :eq:`kick`: with c held, the critical pair of poles
takes the share ``l . d/(l M'(s) r)`` of a unit impulse along d, ``M = 1 - B Phi``, l and r its null vectors.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from process.friction.linearised import steepness
from process.harmonic_balance.imposed_motion import ImposedMotion, imposed_motion
from process.harmonic_balance.many_harmonics import unstable_with
from process.harmonic_balance.network import FrictionElement, Network
from process.harmonic_balance.quasi_frf import network
from process.machine.machine import Machine
from process.types import Complex, Real
from stability.methods.vibration_mode import frequencies_about
from stability.methods.zero_order import first_limits
from stability.methods.zero_order_branches import eigenvalue_branches
from stability.operating.cycles import Cycle, contact_gain, kick_of
from stability.operating.rules import RULES
from stability.problem import NO_LOBE, Samples


@dataclass(frozen=True)
class CutLoop:
    """What a cut does at any depth: mean directional matrix A0 [N/m2], pitch angles [rad], feed per tooth [m]."""

    directional: Complex
    pitch: Real
    chip: float

    def regeneration(self, frequency: Real, speed: float) -> Complex:
        """Return the mean of ``1 - exp(-j w T)`` over the teeth, at frequencies [Hz]; speed [rpm]."""
        waves = np.asarray(frequency, dtype=float)[..., None] * (30.0 / np.pi / speed * self.pitch)
        return np.asarray((1.0 - np.exp(-2j * np.pi * waves)).mean(axis=-1))


@dataclass(frozen=True)
class MovingMachine:
    """A machine under one controller and at one position, seen in the axes of a cut.

    Parameters
    ----------
    machine : Machine
        Structure, servos, friction, joints.
    loop : CutLoop
        The cut.
    direction : float
        Direction in which the cut is fed, from +x towards +y [rad].
    controller : str, optional
        Name of the controllers.
    position : float, optional
        Position [m] of the axis that a posture depends on.
    frequency : ndarray, shape (n,)
        Frequencies [Hz] at which limits are looked for.
    """

    machine: Machine
    loop: CutLoop
    direction: float
    controller: str | None
    position: float | None
    frequency: Real

    def feeds(self, feed: float) -> dict[str, float]:
        """Return the feed of each axis [m/s] for the feed of a cut."""
        along = {"x": math.cos(self.direction), "y": math.sin(self.direction)}
        shares = {axis: round(along.get(axis, 0.0), 12) for axis in self.machine.axes}
        return {axis: feed * share for axis, share in shares.items()}

    def at(self, feed: float) -> FedMachine:
        """Return the machine fed at a rate [m/s]."""
        linear = network(self.machine, self.feeds(feed), self.controller, self.position)
        return FedMachine(self, linear)


def moving_machine(
    machine: Machine,
    loop: CutLoop,
    direction: float,
    controller: str | None,
    position: float | None,
    feeds: Sequence[float],
) -> MovingMachine:
    """Return a machine with the frequencies at which its limits are looked for, fed at rates [m/s] in a direction."""
    moving = MovingMachine(machine, loop, direction, controller, position, np.empty(0))
    rates: list[float | Mapping[str, float]] = [0.0, moving.feeds(min(feeds)), moving.feeds(max(feeds))]
    if all(servo is not None for servo in machine.servos(controller)):
        rates.append(RULES.free_of_friction)
    poles = np.concatenate([machine.at(v, controller, position).poles() for v in rates])
    ringing = poles[(poles.imag > 2.0 * np.pi * RULES.lowest_frequency) & (-poles.real < 0.9 * np.abs(poles))]
    return replace(moving, frequency=frequencies_about(ringing if ringing.size else poles, RULES.reach, RULES.density))


@dataclass
class FedMachine:
    """A machine that is fed at one rate.

    Parameters
    ----------
    moving : MovingMachine
        The machine.
    network : Network
        Its linear part and its guideways and joints at this feed.
    """

    moving: MovingMachine
    network: Network
    _grid: dict[str, Complex] = field(default_factory=dict)
    _steady: dict[tuple[float, ...], bool] = field(default_factory=dict)

    def compliance(self, frequency: Real) -> Complex:
        """Return the compliance [m/N] of tool and elements, shape (n, 3 + P, 3 + P), in the axes of the cut."""
        g = self.network.matrix(frequency)
        if self.moving.direction == 0.0:
            return g
        c, s = math.cos(self.moving.direction), math.sin(self.moving.direction)
        turn = np.eye(g.shape[1])
        turn[:2, :2] = [[c, s], [-s, c]]
        return np.asarray(turn @ g @ turn.T)

    def with_elements(self, g: Complex, frequency: Real, c: Complex) -> tuple[Complex, Complex]:
        """Return the compliance at the tool [m/N], (n, 3, 3), and the motion of the elements a unit force, (n, P, 3).

        g : compliance without the elements, c : coefficient of each, shape (P,).
        """
        s = np.where(self.network.displaced, 1.0, 2j * np.pi * frequency[:, None])[:, :, None]
        to, between = s * g[:, 3:, :3], s * g[:, 3:, 3:]
        moved = to / (1.0 + between * c[0]) if c.size == 1 else np.linalg.solve(np.eye(c.size) + between * c, to)
        return g[:, :3, :3] - g[:, :3, 3:] @ (c[:, None] * moved), np.asarray(moved)

    def coefficients(self, amplitude: Real) -> Complex:
        """Return the coefficient of each element, shape (P,), for sines of amplitudes (P,) [m/s] or [m]."""
        parts = zip(self.network.elements, amplitude, strict=True)
        return np.array([complex(p.coefficient(float(v))) for p, v in parts], dtype=complex)

    def steady(self, c: Complex) -> bool:
        """Return whether the machine without a cut is stable with coefficients c (P,)."""
        key = tuple(float(f"{v:.3g}") for v in c.real)
        if key not in self._steady:
            self._steady[key] = (unstable_with(self.network, c.real) if c.size else self.network.unstable_poles) == 0
        return self._steady[key]

    def limit(self, c: Complex, speed: float) -> tuple[float, float, int]:
        """Return depth [m], frequency [Hz] and lobe of the zero-order limit with coefficients c (P,)."""
        f = self.moving.frequency
        if "g" not in self._grid:
            self._grid["g"] = self.compliance(f)
        samples = Samples(f, self.with_elements(self._grid["g"], f, c)[0], np.ones(f.size - 1, dtype=bool), ())
        loop = self.moving.loop
        depth, chatter, lobe = first_limits(
            eigenvalue_branches(samples, loop.directional), loop.pitch, np.array([speed])
        )
        return float(depth[0]), float(chatter[0]), int(lobe[0])

    def cycle(self, amplitude: float, speed: float, before: Cycle | None = None) -> Cycle:
        """Return the vibration in which the guideway that moves most does so by an amplitude [m/s] (0: small).

        A cycle near by, `before`, says how the guideways share the motion.
        """
        c = self.coefficients(np.zeros(len(self.network.elements)))
        if amplitude == 0.0 or before is None:
            if not self.steady(c):
                return Cycle(0.0, 0.0, math.nan, NO_LOBE, unsteady=True)
            small = self._finished(c, *self.limit(c, speed), speed, 0.0)
            if amplitude == 0.0 or not c.size:
                return small
            before = small
        shape = before.elements
        alone = c.size == 1 and not self.network.displaced.any()
        for _ in range(1 if alone else RULES.shares):
            old, c = c, self.coefficients(amplitude * np.abs(shape))
            depth, chatter, lobe = self.limit(c, speed)
            if alone or not math.isfinite(depth):
                break
            shape = self._shape(c, depth, chatter, speed)
            if np.all(np.abs(c - old) <= RULES.same_coefficient * np.abs(c)):
                break
        if not self.steady(c):
            return Cycle(amplitude, 0.0, math.nan, NO_LOBE, elements=shape, unsteady=True)
        if not math.isfinite(depth) or not self._reverses(amplitude * np.abs(shape)):
            return self._finished(c, depth, chatter, lobe, speed, amplitude)
        return self._with_harmonics(amplitude, shape, (depth, chatter, lobe), speed, before.motion)

    def cycle_beside(self, amplitude: float, speed: float, before: Cycle) -> Cycle:
        """Return the vibration of an amplitude [m/s] whose guideways share the motion nearly as in another one."""
        if not isinstance(before.motion, ImposedMotion):
            return self.cycle(amplitude, speed, before)
        near = (before.depth, before.chatter, before.lobe)
        return self._with_harmonics(amplitude, before.elements, near, speed, before.motion)

    def _reverses(self, amplitude: Real) -> bool:
        """Return whether a guideway comes near to rest within a cycle, or a joint moves: then harmonics matter."""
        for element, v in zip(self.network.elements, amplitude, strict=True):
            if isinstance(element, FrictionElement):
                rest = 1.0 / steepness(element.law) if steepness(element.law) > 0.0 else 0.0
                if v > RULES.near_rest * abs(element.feed) - 2.0 * rest and v > 0.1 * rest:
                    return True
            elif v > 0.0:
                return True
        return False

    def _with_harmonics(
        self, amplitude: float, shape: Complex, first: tuple[float, float, int], speed: float, start: object
    ) -> Cycle:
        depth, chatter, lobe = first
        motion = start if isinstance(start, ImposedMotion) else None
        c, near, settled = np.zeros(shape.size, dtype=complex), False, False
        for round_ in range(RULES.rounds if shape.size == 1 else RULES.shares):
            motion = self.imposed(amplitude * shape, depth, chatter, speed, motion)
            old, c = c, motion.coefficient
            if not motion.converged or not np.isfinite(c).all():
                return Cycle(amplitude, math.nan, elements=shape)
            settled = bool(np.all(np.abs(c - old) <= RULES.nearly_same * np.abs(c)))
            if near and np.all(np.abs(c - old) <= RULES.same_coefficient * np.abs(c)):
                break
            near = round_ > 0
            if near:
                depth, chatter = self._followed(c, depth, chatter, speed)
            else:
                depth, chatter, lobe = self.limit(c, speed)
            if not (0.0 < depth < math.inf):
                break
            if shape.size > 1:
                new = self._shape(c, depth, chatter, speed)
                new = new * np.exp(-1j * np.angle(np.vdot(shape, new)))
                shape = 0.5 * (shape + new)
            shape = self._scaled(shape, chatter)
        if not settled and math.isfinite(depth):
            return Cycle(amplitude, math.nan, elements=shape)
        cycle = self._finished(c, depth, chatter, lobe, speed, amplitude)
        return replace(cycle, motion=motion)

    def imposed(
        self, fundamental: Complex, depth: float, chatter: float, speed: float, start: ImposedMotion | None = None
    ) -> ImposedMotion:
        """Return the harmonics of guideways and joints in a cut, for their fundamental motion (P,) [m/s] or [m]."""

        def closed(frequency: Real) -> Complex:
            g = self.compliance(frequency)
            regeneration = self.moving.loop.regeneration(frequency, speed)[:, None, None]
            cut = depth * regeneration * self.moving.loop.directional
            to = np.linalg.solve(np.eye(3) - g[:, :3, :3] @ cut, g[:, :3, 3:])
            return np.asarray(g[:, 3:, 3:] + g[:, 3:, :3] @ cut @ to)

        return imposed_motion(self.network, fundamental, chatter, closed, RULES.harmonics, start)

    def _followed(self, c: Complex, depth: float, chatter: float, speed: float) -> tuple[float, float]:
        """Return depth and frequency of the limit next to the given one, when c has changed a little (Newton)."""
        step = 1e-6
        for _ in range(RULES.newton_steps):
            f = chatter * np.array([1.0, 1.0 + step])
            phi = self.with_elements(self.compliance(f), f, c)[0]
            loop = self.moving.loop.regeneration(f, speed)[:, None, None] * (self.moving.loop.directional @ phi)
            values = np.linalg.eigvals(loop)
            one = values[0, np.abs(values[0] * depth - 1.0).argmin()]
            pair = np.array([one, values[1, np.abs(values[1] - one).argmin()]])
            slope = (1.0 / pair[1] - 1.0 / pair[0]) / (step * chatter) if pair.all() else 0.0
            if slope.imag == 0.0 or not math.isfinite(abs(slope)):
                return math.nan, math.nan
            inverse = 1.0 / pair
            change = float(np.clip(-inverse[0].imag / slope.imag, -0.02 * chatter, 0.02 * chatter))
            depth, chatter = float((inverse[0] + slope * change).real), chatter + change
            if abs(change) < 1e-8 * chatter:
                break
        return depth, chatter

    def _shape(self, c: Complex, depth: float, chatter: float, speed: float) -> Complex:
        """Return the motion of the elements in the mode at a limit, (P,); the fastest guideway has the length one."""
        f = np.array([chatter])
        phi, moved = self.with_elements(self.compliance(f), f, c)
        loop = depth * self.moving.loop.regeneration(f, speed)[:, None, None] * (self.moving.loop.directional @ phi)
        force = np.linalg.svd(np.eye(3) - loop[0])[2][-1].conj()
        return self._scaled(moved[0] @ force, chatter)

    def _scaled(self, u: Complex, chatter: float) -> Complex:
        speed = np.abs(u) * np.where(self.network.displaced, 2.0 * np.pi * chatter, 1.0)
        fastest = int(speed.argmax()) if speed.size else 0
        if not speed.size or speed[fastest] == 0.0:
            return u
        return np.asarray(u / (u[fastest] / abs(u[fastest])) / speed[fastest])

    def _finished(self, c: Complex, depth: float, chatter: float, lobe: int, speed: float, amplitude: float) -> Cycle:
        """Return a cycle with the motion of the tool, of the guideways, and the kick that leads to it."""
        if not (0.0 < depth < math.inf):
            return Cycle(amplitude, depth, chatter, lobe, elements=np.ones(c.size, dtype=complex))
        f = chatter * (1.0 + 1e-5 * np.array([-1.0, 0.0, 1.0]))
        phi, moved = self.with_elements(self.compliance(f), f, c)
        cut = depth * self.moving.loop.regeneration(f, speed)[:, None, None] * self.moving.loop.directional
        found, kick = kick_of(f, cut @ phi)
        tool, u = phi[1] @ found, moved[1] @ found
        speeds = np.abs(u) * np.where(self.network.displaced, 2.0 * np.pi * chatter, 1.0)
        largest = float(speeds.max(initial=0.0))
        scale = amplitude / largest if largest > 0.0 else 0.0
        swing = (
            float(np.linalg.norm(self.moving.loop.regeneration(f, speed)[1] * tool[:2])) * scale / self.moving.loop.chip
        )
        return Cycle(
            amplitude,
            depth / contact_gain(swing),
            chatter,
            lobe,
            tool=tool * scale if scale > 0.0 else tool / np.linalg.norm(tool),
            elements=self._scaled(u, chatter),
            kick=kick * scale,
            swing=swing,
        )

    def shaken(self, frequency: Real, force: Complex) -> Real:
        """Return the largest speed [m/s] at which forces at the tool shake each guideway and joint, (P,).

        frequency : of the forces [Hz], (n,); force : their amplitudes [N], (n, 3). To a small vibration.
        """
        c = self.coefficients(np.zeros(len(self.network.elements)))
        moved = self.with_elements(self.compliance(frequency), frequency, c)[1]
        speed = np.abs(np.einsum("npi,ni->np", moved, force))
        scale = np.where(self.network.displaced, 2.0 * np.pi * frequency[:, None], 1.0)
        return np.asarray((speed * scale).sum(axis=0))

    def amplitudes(self) -> Real:
        """Return amplitudes [m/s] at which the coefficients of the elements change, rising."""
        out = []
        for element in self.network.elements:
            if isinstance(element, FrictionElement):
                feed, kt = abs(element.feed), steepness(element.law)
                if feed > 0.0:
                    out.append(feed * np.array(RULES.amplitudes_of_a_feed))
                if kt > 0.0 and feed < RULES.slow * 1.0 / kt:
                    out.append(np.geomspace(0.3, 3e3, RULES.amplitudes_at_rest) / kt)
            else:
                out.append(np.geomspace(*RULES.joint_amplitudes, RULES.amplitudes_at_rest))
        return np.unique(np.concatenate(out)) if out else np.empty(0)
