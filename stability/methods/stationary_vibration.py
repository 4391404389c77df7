"""The periodic vibration of a stable cut: what the tool does under the cutting force itself, and the wall it leaves.

The static chip ``h_j = f_j sin phi_j`` of tooth j, f_j being the feed over its pitch, and the edge force drive the tool
at the period of the cut. With equal pitch the vibration repeats from tooth to tooth, leaves no wave, and is that of the
machine alone; with unequal pitch the chips x of the vibration satisfy ``x = x_0 + a M(1) x`` with the operator M of
`methods.semi_discretization` at the multiplier one. On a mesh aligned with entries and exits both are exact to the
order of its polynomials. The wall that a peripheral cut leaves is off by the displacement at the moment a tooth
passes it: the surface location error (Insperger, Gradisek, Kalveram, Stepan, Weinert and Govekar 2006).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from process.cut.engagement import AnyEngagement
from process.cut.force import CuttingCoefficients, force_projection
from process.cut.tool import Tool
from process.errors import InputError
from process.types import Complex, Real
from stability.methods.dense_problem import Dense, dense
from stability.methods.period_mesh import Mesh, cut_at_speed, lagrange, lay_mesh, node_responses
from stability.methods.rules import RULES
from stability.problem import Cut, Machine, Modes, check_spindle_speed, modes_of, pattern_of_pitch

METHOD = "stationary vibration"


@dataclass(frozen=True)
class StationaryVibration:
    """The periodic vibration of a cut at one depth and speed.

    Parameters
    ----------
    angle : ndarray, shape (p,)
        Angle of tooth 0 [rad] at the samples, over one period of the cut while teeth are engaged.
    displacement : ndarray, shape (3, p)
        Displacement of the tool [m] there, its mean included.
    amplitude_um : dict of str to float
        Half of the peak-to-peak displacement of x, y and z [um].
    surface_location_error_um : dict of str to ndarray, shape (teeth,)
        For the walls that the cut leaves (``up``: at tooth angle 0, ``down``: at 180 deg) how far each tooth cuts
        beyond the nominal wall [um]; negative where it leaves material.
    multiplier : float
        Largest modulus of a Floquet multiplier: at one or above the cut chatters and never gets there.
    error : float
        Relative change of the displacement in the last doubling of the steps.
    steps : int
        Steps in the cut over one period.
    """

    angle: Real
    displacement: Real
    amplitude_um: dict[str, float]
    surface_location_error_um: dict[str, Real]
    multiplier: float
    error: float
    steps: int


def stationary_vibration(
    machine: Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    depth: float,
    feed_per_tooth: float,
    spindle_speed: float,
    tolerance: float = 1e-4,
) -> StationaryVibration:
    """Return the periodic vibration of a cut, teeth never leaving the work by vibration.

    Parameters
    ----------
    machine : Machine
        Anything with a ``state_space()``.
    tool, arc, coefficients
        The cut; straight edges, any pitch, no run-out.
    depth, feed_per_tooth : float
        a_p and the mean f_z [m].
    spindle_speed : float
        Spindle speed [rpm].
    tolerance : float, optional
        Relative change of the displacement at which the doubling of the steps ends.

    Raises
    ------
    InputError
        For a helix, run-out, a machine that is itself unstable, a depth, feed or speed that is not positive, and when
        the displacement does not settle.
    """
    speed = float(check_spindle_speed(spindle_speed)[0])
    _check(tool, depth, feed_per_tooth)
    change, cut, at = _settled(Cut(tool, arc, coefficients), modes_of(machine), depth, feed_per_tooth, speed, tolerance)
    return _Periodic(cut, at, depth).result(change)


@dataclass(frozen=True)
class VibrationOverDepth:
    """What the periodic vibration of a cut comes to at one spindle speed, over depths.

    Parameters
    ----------
    peak_to_peak : ndarray, shape (depths, 3)
        Of the displacement of the tool in x, y and z [m].
    deflection : ndarray, shape (depths,)
        Largest distance of the tool from where it is without a cut, the mean deflection included [m].
    wall : dict of str to ndarray, shape (depths,)
        For the walls that the cut leaves ("up", "down") how far beyond the nominal wall is cut [m]: of unequal teeth
        by that which cuts furthest; negative: material is left.
    peak_force : ndarray, shape (depths,)
        Largest force on the tool, x, y and z together [N].
    """

    peak_to_peak: Real
    deflection: Real
    wall: dict[str, Real]
    peak_force: Real


def vibration_over_depth(
    machine: Machine,
    tool: Tool,
    arc: AnyEngagement,
    coefficients: CuttingCoefficients,
    depths: Real,
    feed_per_tooth: float,
    spindle_speed: float,
    tolerance: float = 1e-3,
) -> VibrationOverDepth:
    """Return what the periodic vibration of a cut comes to over depths at one spindle speed.

    With equal pitch it leaves no wave behind, and everything goes as the depth.

    Parameters
    ----------
    machine, tool, arc, coefficients, feed_per_tooth, spindle_speed, tolerance
        As `stationary_vibration`; the steps are those that the greatest depth needs.
    depths : ndarray, shape (depths,)
        Axial depths [m].

    Raises
    ------
    InputError
        As `stationary_vibration`.
    """
    speed = float(check_spindle_speed(spindle_speed)[0])
    _check(tool, float(np.max(depths)), feed_per_tooth)
    cut = Cut(tool, arc, coefficients)
    _, cut, at = _settled(cut, modes_of(machine), float(np.max(depths)), feed_per_tooth, speed, tolerance)
    solved = [1.0] if tool.equal_pitch else [float(d) for d in depths]
    found = [_Periodic(cut, at, depth).sizes() for depth in solved]
    scale = np.asarray(depths) if tool.equal_pitch else np.ones(len(solved))
    return VibrationOverDepth(
        scale[:, None] * np.array([f[0] for f in found]),
        scale * np.array([f[1] for f in found]),
        {side: scale * np.array([f[2][side] for f in found]) for side in found[0][2]},
        scale * np.array([f[3] for f in found]),
    )


def _check(tool: Tool, depth: float, feed_per_tooth: float) -> None:
    for name, value in (("depth", depth), ("feed per tooth", feed_per_tooth)):
        if not 0.0 < value < math.inf:
            raise InputError(f"the {name} is {value * 1e3:g} mm; it must be positive and finite")
    if not tool.equal_radius:
        raise InputError(f"the tool has a run-out; the {METHOD} holds for teeth on one circle. Leave runout out")
    if tool.helix_angle > 0.0:
        raise InputError(
            f"the tool has a helix of {math.degrees(tool.helix_angle):g} deg; the {METHOD} needs straight edges. Use a "
            "time simulation, or leave helix_angle out to neglect it"
        )


def _settled(
    cut: Cut, modes: Modes, depth: float, feed_per_tooth: float, speed: float, tolerance: float
) -> tuple[float, Cut, _AtSpeed]:
    """Double the steps until the displacement at a depth stands still; return its last change, and the mesh."""
    pattern = pattern_of_pitch(cut.tool)
    turns = float(np.abs(modes.rate.imag).max()) * pattern.duration(speed)
    steps = RULES.first_steps_of_vibration + math.ceil(0.4 * turns)
    old = None
    while steps <= RULES.most_steps_of_vibration:
        at = _AtSpeed(cut, lay_mesh(cut, pattern, steps), modes, feed_per_tooth, speed)
        lines = _Periodic(cut, at, depth).lines()
        if old is not None:
            change = float(np.abs(lines - old).max() / np.abs(lines).max())
            if change <= tolerance:
                return change, cut, at
        old, steps = lines, 2 * at.mesh.steps
    raise InputError(
        f"the vibration at {speed:g} rpm does not settle with {RULES.most_steps_of_vibration} steps in a period of "
        "the cut; ask for a higher speed or a coarser tolerance"
    )


class _AtSpeed:
    """The cut on one mesh at one spindle speed, at any depth."""

    def __init__(self, cut: Cut, mesh: Mesh, modes: Modes, feed_per_tooth: float, spindle_speed: float) -> None:
        self.mesh, self.modes = mesh, modes
        self.rotation = spindle_speed * math.pi / 30.0
        self._spindle_speed = spindle_speed
        feed = feed_per_tooth * cut.tool.teeth * mesh.pattern.delay[mesh.tooth] / (2.0 * math.pi)
        phi = mesh.angle - mesh.pattern.lag[mesh.tooth]
        edge = force_projection(cut.coefficients.edge, cut.tool.approach_angle) / math.sin(cut.tool.approach_angle)
        basis = np.stack([np.sin(phi), np.cos(phi), np.ones_like(phi)])
        self.static = mesh.force * (feed * np.sin(phi)) + edge @ basis
        self.turn = np.exp(modes.rate * mesh.pattern.period / self.rotation)

    @cached_property
    def dense(self) -> Dense:
        """The dense matrices of the cut: what regenerates, and the multipliers."""
        return dense(cut_at_speed(self.mesh, self.modes, self._spindle_speed))

    @cached_property
    def repeated(self) -> Real:
        """The operator M(1), shape (m, m) [1/m]: what periodic chips make of themselves a unit of depth."""
        return np.asarray(self.dense.crossing(np.zeros(1))[0].real)

    @cached_property
    def free_chips(self) -> Real:
        """The chips of the static force a unit of depth, shape (m,)."""
        return np.asarray(np.einsum("mi,im->m", self.mesh.chip, self.response(self.static)[1]))

    def force(self, depth: float) -> Real:
        """Return the force of each contact in the periodic motion, shape (3, m)."""
        static = depth * self.static
        if self.mesh.pattern.delay.size == 1 or np.ptp(self.mesh.pattern.delay) < 1e-12:
            return np.asarray(static)  # the vibration repeats from tooth to tooth, and leaves no wave
        basis, matrix, beyond = self.chips_within
        first = np.zeros(matrix.shape[0])
        first[0] = depth * float(np.linalg.norm(self.free_chips))
        y = np.linalg.solve(np.eye(first.size) - depth * matrix, first)
        x = basis @ y
        if depth * beyond * abs(y[-1]) > RULES.residual_of_chips * float(np.linalg.norm(y)):
            x = np.linalg.solve(np.eye(x.size) - depth * self.repeated, depth * self.free_chips)
        return np.asarray(static + depth * self.mesh.force * (self.changed @ x))

    @cached_property
    def changed(self) -> Real:
        """What chips change: themselves less the surface left, shape (m, m)."""
        return np.asarray(self.dense.kept - self.dense.wrapped)

    @cached_property
    def chips_within(self) -> tuple[Real, Real, float]:
        """A basis (m, k) in which periodic chips lie at any depth, M(1) in it (k, k), and how far it leads beyond.

        The operator smooths: the space that the free chips and its powers span holds the solution after few of them
        (Arnoldi; the residual is known at each depth).
        """
        free, most = self.free_chips, min(RULES.chips_of_vibration, self.free_chips.size)
        basis, matrix = np.zeros((free.size, most + 1)), np.zeros((most + 1, most))
        basis[:, 0] = free / np.linalg.norm(free)
        for k in range(most):
            v = self.repeated @ basis[:, k]
            scale = float(np.linalg.norm(v))
            for _ in range(2):
                share = basis[:, : k + 1].T @ v
                matrix[: k + 1, k] += share
                v -= basis[:, : k + 1] @ share
            matrix[k + 1, k] = np.linalg.norm(v)
            if matrix[k + 1, k] <= 1e-13 * scale:
                return basis[:, : k + 1], matrix[: k + 1, : k + 1], 0.0
            basis[:, k + 1] = v / matrix[k + 1, k]
        return basis[:, :most], matrix[:most], float(matrix[most, most - 1])

    @cached_property
    def inside(self) -> tuple[tuple[Complex, ...], tuple[Complex, ...]]:
        """The responses at the nodes, and at the end, of each element."""
        step = (self.mesh.length / self.rotation).round(15).tolist()
        known = {key: node_responses(self.mesh, self.modes.rate, key) for key in set(step)}
        inner, last = zip(*(known[key] for key in step), strict=True)
        return inner, last

    def response(self, force: Real) -> tuple[Complex, Real]:
        """Return the modal state at the start of each element and the displacement at the contacts under a force."""
        mesh, modes = self.mesh, self.modes
        step, idle = mesh.length / self.rotation, mesh.gap / self.rotation
        drive = [modes.participation @ self.summed(force, e) for e in range(step.size)]
        inner, last = self.inside
        z = np.zeros((step.size + 1, modes.rate.size), dtype=complex)
        for _ in range(2):
            for e, h in enumerate(step):
                z[e + 1] = np.exp(modes.rate * idle[e]) * (
                    np.exp(modes.rate * h) * z[e] + (drive[e] * last[e]).sum(axis=1)
                )
            # From rest the end is H f; in the periodic motion start and end are z = H f/(1 - turn).
            if not z[0].any():
                z[0] = z[-1] / (1.0 - self.turn)
        out = np.empty((3, mesh.angle.size))
        for e, h in enumerate(step):
            state = np.exp(np.outer(modes.rate, h * mesh.node)) * z[e][:, None]
            state = state + np.einsum("mij,mj->mi", inner[e], drive[e])
            r = (modes.shape @ state).real
            for low in range(mesh.offset[e], mesh.offset[e + 1], mesh.node.size):
                out[:, low : low + mesh.node.size] = r
        return z, out

    def summed(self, force: Real, e: int) -> Real:
        """Return the force of all engaged teeth at the nodes of an element, shape (3, p)."""
        low, high = self.mesh.offset[e], self.mesh.offset[e + 1]
        return np.asarray(force[:, low:high].reshape(3, -1, self.mesh.node.size).sum(axis=1))


class _Periodic:
    """The periodic solution on one mesh at one depth."""

    def __init__(self, cut: Cut, at: _AtSpeed, depth: float) -> None:
        self.mesh, self.modes, self._cut, self._speed = at.mesh, at.modes, cut, at
        self._rotation, self._depth = at.rotation, depth
        self.force = at.force(depth)
        self._starts, self.displacement = at.response(self.force)

    def sizes(self) -> tuple[Real, float, dict[str, float], float]:
        """Return peak to peak, largest deflection, each wall by the tooth that cuts furthest, largest force; SI."""
        moved = self._over_period()
        fine = lagrange(self.mesh.node, np.linspace(0.0, 1.0, 64))
        force = np.concatenate(
            [self._speed.summed(self.force, e) @ fine.T for e in range(self.mesh.length.size)], axis=1
        )
        walls = {side: float(error.max()) for side, error in self._walls().items()}
        deflection, strongest = (float(np.linalg.norm(v, axis=0).max()) for v in (moved, force))
        return np.ptp(moved, axis=1), deflection, walls, strongest

    def lines(self) -> Complex:
        """Return the lowest harmonics of the displacement, shape (3, lines): comparable between meshes."""
        mesh = self.mesh
        period = mesh.pattern.period / self._rotation
        reach = int(np.abs(self.modes.rate.imag).max() * period / (2.0 * math.pi)) + 8
        order = np.arange(reach + 1)
        waves = np.exp(-2j * math.pi * np.outer(order, mesh.angle) / mesh.pattern.period)
        force = waves @ (self.force * mesh.span).T / mesh.pattern.period
        return np.asarray((self.modes.matrix(order / period) @ force[:, :, None])[:, :, 0].T)

    def result(self, change: float) -> StationaryVibration:
        """Return what is asked for."""
        first = np.concatenate([np.arange(self.mesh.node.size) + low for low in self.mesh.offset[:-1]])
        moved = self.displacement[:, first]
        peak = np.ptp(self._over_period(), axis=1)
        values = self._speed.dense.multipliers(np.array([self._depth]))
        return StationaryVibration(
            self.mesh.angle[first],
            moved,
            {axis: float(0.5e6 * p) for axis, p in zip("xyz", peak, strict=True)},
            {side: 1e6 * error for side, error in self._walls().items()},
            float(np.abs(values).max()),
            change,
            self.mesh.steps,
        )

    def _over_period(self) -> Real:
        """Return the displacement [m] densely over the whole period, air included, shape (3, any)."""
        mesh, out = self.mesh, []
        # In air a fast mode swings many times: a peak is found within 1 % of it by 24 points in each period.
        longest = max(float(mesh.gap.max()), float(mesh.length.max())) / self._rotation
        points = max(64, math.ceil(24.0 * float(np.abs(self.modes.rate.imag).max()) / (2.0 * math.pi) * longest))
        fine = lagrange(mesh.node, np.linspace(0.0, 1.0, points))
        for e in range(mesh.length.size):
            out.append(self.displacement[:, mesh.offset[e] : mesh.offset[e] + mesh.node.size] @ fine.T)
            # Backwards from the start of the next element: there the motion is free.
            back = mesh.gap[e] / self._rotation * np.linspace(0.0, 1.0, points)
            state = np.exp(-np.outer(self.modes.rate, back)) * self._starts[e + 1][:, None]
            out.append((self.modes.shape @ state).real)
        return np.concatenate(out, axis=1)

    def _walls(self) -> dict[str, Real]:
        """Return for each wall how far each tooth cuts beyond it [m]."""
        arcs, pattern = self._cut.arc.arcs, self.mesh.pattern
        out = {}
        if abs(arcs[0].entry) < 1e-9:
            out["up"] = np.array([self._at(lag)[1] for lag in pattern.lag])
        if abs(arcs[-1].exit - math.pi) < 1e-9:
            out["down"] = -np.array([self._at(lag + math.pi)[1] for lag in pattern.lag])
        return out

    def _at(self, angle: float) -> Real:
        """Return the displacement at an angle of the tool where an element begins or ends [m], shape (3,)."""
        mesh, period = self.mesh, self.mesh.pattern.period
        begins = mesh.angle[mesh.offset[:-1]] - mesh.node[0] * mesh.length
        for e in range(mesh.length.size):
            if abs((angle - begins[e] + 0.5 * period) % period - 0.5 * period) < 1e-6:
                return np.asarray((self.modes.shape @ self._starts[e]).real)
            if abs((angle - begins[e] - mesh.length[e] + 0.5 * period) % period - 0.5 * period) < 1e-6:
                back = np.exp(-self.modes.rate * mesh.gap[e] / self._rotation)
                return np.asarray((self.modes.shape @ (back * self._starts[e + 1])).real)
        raise AssertionError("an entry or exit lies within an element")
