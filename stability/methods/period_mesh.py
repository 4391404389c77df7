"""One period of a cut laid out in elements between the entries and exits of the teeth, with Gauss nodes in each."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from process.cut.force import chip_projection, force_projection, twisted_gram
from process.types import Complex, Real
from stability.methods import _floquet_kernels as kernels
from stability.methods.rules import RULES
from stability.problem import Cut, Modes, Pattern

Element = tuple[float, float, list[int]]
"""From which angle [rad], how far, and with which teeth engaged."""


@dataclass(frozen=True)
class Mesh:
    """One period of a cut in n elements with p nodes each: m contacts, one for each engaged tooth at each node.

    With a worn flank there are two, of the edge and of the flank. With a helix there is one for each direction of
    motion: what counts is the displacement, and the force a unit of it is the mean over the edge, which reaches from
    angle to angle. Equally spaced teeth then are one.

    Parameters
    ----------
    pattern : Pattern
        How the teeth follow each other.
    length, gap : ndarray, shape (n,)
        Angle over an element, and through air after it [rad].
    node : ndarray, shape (p,)
        Gauss nodes on 0..1.
    offset : ndarray of int, shape (n + 1,)
        First contact of each element.
    tooth : ndarray of int, shape (m,)
        Tooth of a contact.
    flank : ndarray of bool, shape (m,)
        Contacts of the worn flank. They follow the edges' of the same element, tooth by tooth; what counts there is
        the slope of the chip over the angle [m/rad], no surface is left, and the force is one a unit of that slope.
    angle, span : ndarray, shape (m,)
        Angle of the tool at a contact, and the angle it stands for [rad].
    chip : ndarray, shape (m, 3)
        ``(s, c, 1) Q``: chip a unit of displacement [1]; with a helix the displacement itself.
    force : ndarray, shape (3, m)
        ``P (s, c, 1)``: force a unit of chip and of depth [N/m2]; with a helix of the displacement.
    source, weight, wrap : ndarray, shapes (m,), (m, p), (m,)
        First contact of those that hold the surface left by the tooth before, their weights, and whether they are
        those of the period before.
    """

    pattern: Pattern
    length: Real
    gap: Real
    node: Real
    offset: NDArray[np.int64]
    tooth: NDArray[np.int64]
    flank: NDArray[np.bool_]
    angle: Real
    span: Real
    chip: Real
    force: Real
    source: NDArray[np.int64]
    weight: Real
    wrap: NDArray[np.bool_]

    @property
    def steps(self) -> int:
        """Nodes over one period."""
        return int(self.length.size * self.node.size)


def _pieces(cut: Cut, pattern: Pattern, twist: float, lead: Real) -> list[Element]:
    """Return the elements between the events of one period, air left out.

    The upper ends of edges run `twist` [rad] behind; `lead`: teeth that are one, how far each runs behind the first.
    """
    arcs, lag, period = cut.arc.arcs, pattern.lag, pattern.period
    ends = [angle + end for arc in arcs for angle in (arc.entry, arc.exit) for end in {0.0, twist}]
    events = np.sort(np.concatenate([end + lag for end in ends]) % period)
    events = events[np.diff(events, prepend=-1.0) > 1e-9]
    if events[-1] - events[0] > period - 1e-9:
        events = events[:-1]
    out = []
    for low, high in zip(events, np.append(events[1:], events[0] + period), strict=True):
        phi = 0.5 * (low + high) - lag[:, None] - lead
        inside = [np.any((phi - arc.entry) % (2.0 * math.pi) < arc.arc + twist, axis=1) for arc in arcs]
        teeth = np.flatnonzero(np.any(inside, axis=0)).tolist()
        if teeth:
            out.append((float(low), float(high - low), teeth))
    return out


def _elements(cut: Cut, pattern: Pattern, steps: int, twist: float, lead: Real) -> tuple[list[Element], int]:
    """Return the elements and the number of nodes in each: at least `steps` in all."""
    pieces = _pieces(cut, pattern, twist, lead)
    in_cut = sum(length for _, length, _ in pieces)
    share = [steps * length / in_cut for _, length, _ in pieces]
    # An element must not hold the surface that it cuts itself: none is longer than the shortest delay.
    fewest = [math.ceil(length / pattern.delay.min() - 1e-9) for _, length, _ in pieces]
    choices = []
    for order in range(RULES.fewest_nodes, RULES.highest_order + 1):
        counts = [max(n, math.ceil(s / order - 1e-9)) for s, n in zip(share, fewest, strict=True)]
        nodes = max(RULES.fewest_nodes, *(math.ceil(s / n - 1e-9) for s, n in zip(share, counts, strict=True)))
        choices.append((nodes * sum(counts), nodes, counts))
    # Many nodes in few elements are the most accurate; but all elements have as many, and short ones need few.
    least = min(total for total, _, _ in choices)
    _, nodes, counts = max((c for c in choices if c[0] <= RULES.wasted_nodes * least), key=lambda c: c[1])
    elements = [
        (low + length * i / n, length / n, teeth)
        for (low, length, teeth), n in zip(pieces, counts, strict=True)
        for i in range(n)
    ]
    return elements, nodes


def lay_mesh(
    cut: Cut, pattern: Pattern, steps: int, depth: float = 0.0, moving: NDArray[np.bool_] | None = None
) -> Mesh:
    """Lay at least `steps` nodes over the engaged part of one period.

    Parameters
    ----------
    cut, pattern : Cut, Pattern
        What cuts.
    steps : int
        Number of nodes.
    depth : float, optional
        Depth [m] over which a helix reaches; straight edges by default.
    moving : ndarray of bool, shape (3,), optional
        Directions in which the tool moves at all; all by default. Only a helix asks for them.
    """
    twist = cut.twist * depth
    teeth, lead = pattern, np.zeros(1)
    directions: list[int] = [-1]
    if twist > 0.0:
        felt = np.abs(np.diag(chip_projection(cut.tool.approach_angle))) > 1e-12
        directions = np.flatnonzero(felt if moving is None else felt & moving).tolist()
        if pattern.repeats == pattern.lag.size:
            # All teeth leave the same wave behind: together they are one.
            teeth, lead = Pattern(pattern.repeats, np.zeros(1), pattern.delay[:1]), pattern.lag
    elements, p = _elements(cut, teeth, steps, twist, lead)
    start = np.array([e[0] for e in elements])
    length = np.array([e[1] for e in elements])
    gap = np.append(start[1:], start[0] + pattern.period) - start - length
    node, w = _gauss(p)
    sides = 2 if cut.worn else 1
    groups = [[(j, d) for _ in range(sides) for j in e[2] for d in directions] for e in elements]
    offset = np.concatenate([[0], np.cumsum([p * len(g) for g in groups])]).astype(np.int64)
    angle = np.concatenate([np.tile(s + h * node, len(g)) for s, h, g in zip(start, length, groups, strict=True)])
    span = np.concatenate([np.tile(h * w, len(g)) for h, g in zip(length, groups, strict=True)])
    tooth, way = np.concatenate([np.repeat(g, p, axis=0) for g in groups]).T
    flank = np.concatenate([np.arange(p * len(g)) >= p * len(g) // sides for g in groups])
    chip, force = _of_contacts(cut, angle - teeth.lag[tooth], flank, (way, lead, twist))
    source, weight, wrap = _surface_left(elements, offset, node, teeth, angle, tooth, way, directions)
    weight[flank] = 0.0
    gap = np.where(gap > 1e-9, gap, 0.0)
    return Mesh(pattern, length, gap, node, offset, tooth, flank, angle, span, chip, force, source, weight, wrap)


def _of_contacts(
    cut: Cut, phi: Real, flank: NDArray[np.bool_], edge: tuple[NDArray[np.int64], Real, float]
) -> tuple[Real, Real]:
    """Return chip and force of contacts of teeth at angles phi [rad]; edge: directions, teeth in one, and twist."""
    way, lead, twist = edge
    projection = chip_projection(cut.tool.approach_angle)
    straight = force_projection(cut.coefficients.cutting, cut.tool.approach_angle)
    if twist > 0.0:
        one = sum((twisted_gram(cut.arc, phi - lag, twist) for lag in lead), np.zeros((phi.size, 3, 3)))
        basis = (one @ projection)[np.arange(phi.size), :, way]
        chip = np.eye(3)[way]
    else:
        basis = np.stack([np.sin(phi), np.cos(phi), np.ones_like(phi)], axis=1)
        chip = basis @ projection
    force = straight @ basis.T
    if cut.worn:
        force[:, flank] = cut.flank_projection() @ basis[flank].T
    return chip, force


def _surface_left(
    elements: list[Element],
    offset: NDArray[np.int64],
    node: Real,
    pattern: Pattern,
    angle: Real,
    tooth: NDArray[np.int64],
    way: NDArray[np.int64],
    directions: list[int],
) -> tuple[NDArray[np.int64], Real, NDArray[np.bool_]]:
    """Find for each contact those that hold the surface which the tooth before has left there, and their weights."""
    turn = 2.0 * math.pi
    source = np.empty(angle.size, dtype=np.int64)
    place = np.empty(angle.size)
    before = angle - pattern.delay[tooth]
    wrap = before < elements[0][0] - 1e-9
    before = np.where(wrap, before + pattern.period, before)
    for i in range(angle.size):
        # At that time the tooth before was at the same angle; in a repeating pattern another tooth stands for it.
        apart = (before[i] - pattern.lag - angle[i] + pattern.lag[tooth[i]]) % turn
        same = int(np.argmin(np.minimum(apart, turn - apart)))
        holding = ((e, *element) for e, element in enumerate(elements) if same in element[2])
        e, low, length, teeth = next(h for h in holding if h[1] - 1e-9 <= before[i] <= h[1] + h[2] + 1e-9)
        source[i] = offset[e] + node.size * (teeth.index(same) * len(directions) + directions.index(int(way[i])))
        place[i] = (before[i] - low) / length
    return source, lagrange(node, place), wrap


def lagrange(node: Real, x: Real) -> Real:
    """Return the Lagrange polynomials of nodes (p,) at x, shape (..., p)."""
    apart = node[:, None] - node + np.eye(node.size)
    factor = np.where(np.eye(node.size, dtype=bool), 1.0, (x[..., None, None] - node) / apart)
    return np.asarray(factor.prod(axis=-1))


@lru_cache(maxsize=256)
def _rule(nodes: int, points: int) -> tuple[Real, Real, Real, Real]:
    """Return a Gauss rule on 0..1 and the Lagrange polynomials of the nodes, at node times rule and at the rule."""
    node = _gauss(nodes)[0]
    x, w = _gauss(points)
    return x, w, lagrange(node, node[:, None] * x), lagrange(node, x)


def _gauss(points: int) -> tuple[Real, Real]:
    x, w = np.polynomial.legendre.leggauss(points)
    return 0.5 * (x + 1.0), 0.5 * w


def node_responses(mesh: Mesh, rate: Complex, step: float) -> tuple[Complex, Complex]:
    """Integrate ``exp(rate (t - s))`` times Lagrange polynomials from 0 to each node, and to the end of an element.

    Shapes (N, p, p) and (N, p) [s].
    """
    return kernels.element_responses(rate, step, mesh.node, *_rule_of(mesh, rate, step))  # type: ignore[no-any-return]


def _rule_of(mesh: Mesh, rate: Complex, step: float) -> tuple[Real, Real, Real, Real]:
    """Return the rule of an element that lasts so long [s]."""
    # A fast decay is a layer at the end of the interval, where a Gauss rule is dense with the square of its points.
    decay = math.ceil(3.0 * math.sqrt(step * np.abs(rate.real).max()) / 8.0)
    return _rule(mesh.node.size, mesh.node.size + 8 + 8 * decay)


def cut_at_speed(mesh: Mesh, modes: Modes, spindle_speed: float) -> kernels.System:
    """Return the cut at one spindle speed [rpm]."""
    rotation = spindle_speed * math.pi / 30.0
    # A displacement does not jump with the force: its rate is that of the modes alone.
    slope = modes.rate / rotation
    output = np.where(mesh.flank[:, None], slope, 1.0) * (mesh.chip @ modes.shape)
    force = modes.participation @ mesh.force
    step, idle = mesh.length / rotation, mesh.gap / rotation
    rule = _rule_of(mesh, modes.rate, float(step.max()))
    gain, start, end = kernels.element_gains(output, force, modes.rate, mesh.offset, mesh.node, step, *rule)
    turn = np.exp(modes.rate * mesh.pattern.period / rotation)
    decay, gap = np.exp(np.outer(step, modes.rate)), np.exp(np.outer(idle, modes.rate))
    return kernels.System(
        mesh.offset, gain, start, end, decay, gap, turn, mesh.source, mesh.weight.astype(complex), mesh.wrap
    )
