"""Limits from a compliance that was measured at several feeds and levels.

With force levels the compliance at a level is that of a sine of so much force at the tool. A vibration of constant size
has the level of the sine that moves the tool as far, in its most compliant direction; the lowest level stands for a
small disturbance. A level that follows the depth (`depth_of_cut`, or one that is given) has a limit where
``L(Phi(level(a))) = a``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from process.errors import InputError
from process.types import Complex, Real
from stability.methods.zero_order import first_limits
from stability.methods.zero_order_branches import Branches, eigenvalue_branches
from stability.operating.cycles import Cycle, Limits, kick_of
from stability.operating.guideways import CutLoop
from stability.operating.library import Conditions
from stability.operating.rules import RULES
from stability.problem import NO_LOBE

Level = Callable[[float], float]
"""Depth of cut [m] -> what the level dimension of the compliance counts [N or mm]."""


@dataclass(frozen=True)
class MeasuredMachine:
    """A measured compliance in a cut.

    Parameters
    ----------
    conditions : Conditions
        Compliance over feeds and levels.
    loop : CutLoop
        The cut.
    level : callable or None
        How the level follows the depth; None where it is the size of the vibration, or there is none.
    """

    conditions: Conditions
    loop: CutLoop
    level: Level | None
    kept: dict[tuple[float, float], Branches] = field(default_factory=dict)

    def limits(self, speed: float, feed: float) -> Limits:
        """Return the limits at a spindle speed [rpm] and a feed [mm/min]."""
        about = self.conditions
        if not about.knows_feed(feed):
            return Limits.unknown(
                f"a feed outside the measured {about.feed[0]:.6g} to {about.feed[-1]:.6g} mm/min", f"{feed:.6g} mm/min"
            )
        if self.level is not None:
            return self._by_depth(speed, feed)
        small = replace(self.cycle(speed, feed, -math.inf), amplitude=0.0, kick=0.0, swing=0.0)
        low, high = about.known(feed)
        if low > high or about.level_name is None:
            return Limits(small, None, [], [])
        nodes = about.levels_about(feed)
        levels = np.concatenate(
            [np.linspace(a, b, RULES.pieces_of_a_level, endpoint=False) for a, b in pairwise(nodes)] or [nodes[:0]]
        )
        cycles = [self.cycle(speed, feed, float(v)) for v in [*levels, nodes[-1]]]
        cycles = [small, *cycles]
        least = min(cycles, key=lambda c: c.depth)
        if not least.depth < small.depth * (1.0 - RULES.same_limit):
            least = small
        return Limits(small, least, cycles, [])

    def _branches(self, feed: float, level: float) -> Branches:
        """Return the eigenvalues at a condition; those of a measured level are kept when there is one feed only."""
        key = (float(self.conditions.feed[0]), level) if self.conditions.feed.size == 1 else (feed, level)
        if key in self.kept:
            return self.kept[key]
        branches = eigenvalue_branches(self.conditions.at(*key), self.loop.directional)
        if self.conditions.feed.size == 1 and len(self.kept) < RULES.kept_conditions:
            self.kept[key] = branches
        return branches

    def cycle(self, speed: float, feed: float, level: float) -> Cycle:
        """Return the limit with the compliance of a condition, its motion, kick and relative error."""
        branches = self._branches(feed, level)
        found = first_limits(branches, self.loop.pitch, np.array([speed]))
        depth, chatter, lobe = float(found[0][0]), float(found[1][0]), int(found[2][0])
        if not math.isfinite(depth):
            return Cycle(level, depth, chatter, lobe)
        f = chatter * (1.0 + 1e-5 * np.array([-1.0, 0.0, 1.0]))
        f = np.clip(f, branches.samples.frequency[0], branches.samples.frequency[-1])
        phi = branches.compliance_at(f)
        cut = depth * self.loop.regeneration(f, speed)[:, None, None] * self.loop.directional
        force, kick = kick_of(f, cut @ phi)
        # The sine that moves the tool as far in its most compliant direction.
        moved = phi[1] @ force
        sine = float(np.linalg.norm(moved) / np.linalg.norm(phi[1], 2))
        swing = float(np.linalg.norm(self.loop.regeneration(f, speed)[1] * moved[:2])) * level / sine / self.loop.chip
        std = self.conditions.error_at(feed, level)
        error = math.nan if std is None else _relative_error(f, cut, phi, _on_line(branches, std, chatter))
        return Cycle(
            level,
            depth,
            chatter,
            lobe,
            tool=moved * (level / sine if level > 0.0 else 1.0 / np.linalg.norm(moved)),
            kick=kick * max(level, 0.0) / sine,
            swing=swing,
            error=error,
        )

    # --- a level that follows the depth ---

    def _by_depth(self, speed: float, feed: float) -> Limits:
        depths, beyond, stable_to = self.crossings(speed, feed)
        name = "depth of cut" if self.conditions.level_name == "depth_of_cut" else "force level"
        if not depths and beyond is not None:
            unit = "mm" if self.conditions.level_name == "depth_of_cut" else "N"
            low, high = self.conditions.known(feed)
            return Limits.unknown(f"a {name} outside the measured {low:.6g} to {high:.6g} {unit}", beyond, stable_to)
        if not depths:
            return Limits(Cycle(0.0, math.inf, math.nan, NO_LOBE), None, [], [])
        assert self.level is not None
        one = self.cycle(speed, feed, self.level(depths[0]))
        # Where the limit jumps with the depth the crossing lies at the jump, else it is the limit itself.
        exact = abs(one.depth / depths[0] - 1.0) < 1e-6
        one = replace(one, depth=one.depth if exact else depths[0])
        return Limits(one, None, [], depths)

    def crossings(self, speed: float, feed: float) -> tuple[list[float], str | None, float]:
        """Return all depths [m] at which ``1 - a/L(a)`` changes its sign, where it may do so unseen, and stable_to."""
        level = self.level
        assert level is not None

        def limit(depth: float) -> float:
            branches = self._branches(feed, level(depth))
            return float(first_limits(branches, self.loop.pitch, np.array([speed]))[0][0])

        nodes = self._nodes(feed)
        limits = [limit(a) for a in nodes]
        if limits[0] < nodes[0] * (1.0 - 1e-9):
            return [], f"below {1e3 * nodes[0]:.4g} mm deep", math.nan
        out: list[float] = []
        for (a, at_a), (b, at_b) in pairwise(zip(nodes, limits, strict=True)):
            if (at_a > a) != (at_b > b):
                out.append(_root(lambda d: 1.0 - d / limit(d), (a, 1.0 - a / at_a), (b, 1.0 - b / at_b)))
        return out, (f"above {1e3 * nodes[-1]:.4g} mm deep" if limits[-1] < math.inf else None), nodes[-1]

    def _nodes(self, feed: float) -> list[float]:
        """Return the depths [m] of the measured levels and between them."""
        assert self.level is not None
        ends = [_inverse(self.level, float(v)) for v in self.conditions.levels_about(feed)]
        between = [np.linspace(a, b, RULES.pieces_of_a_level, endpoint=False) for a, b in pairwise(ends)]
        return [float(a) for a in np.concatenate([*between, ends[-1:]])]

    # --- what interpolation costs ---

    def interpolation_error(self, speeds: Real, feeds: Real) -> float | None:
        """Return the relative error of limits that straight lines between feeds make; None where it is not known.

        A feed that is left out and interpolated from its neighbours shows it; it goes with the square of the distance.
        """
        inner = range(1, self.conditions.feed.size - 1)
        worst = None
        for i in inner:
            here, rest = float(self.conditions.feed[i]), self.conditions.without(i)
            level = max(rest.known(here)[0], self.conditions.known(here)[0])
            samples = self.conditions.at(here, level), rest.at(here, level)
            one, two = (
                first_limits(eigenvalue_branches(s, self.loop.directional), self.loop.pitch, speeds)[0] for s in samples
            )
            finite = np.isfinite(one) & np.isfinite(two)
            if not finite.any():
                continue
            off = float(np.abs(two[finite] / one[finite] - 1.0).max())
            left, right = here - self.conditions.feed[i - 1], self.conditions.feed[i + 1] - here
            worst = max(worst or 0.0, off * max(left, right) ** 2 / (4.0 * left * right))
        return worst


def _on_line(branches: Branches, std: Real, chatter: float) -> Real:
    return np.asarray(std[int(np.abs(branches.samples.frequency - chatter).argmin())])


def _relative_error(frequency: Real, cut: Complex, phi: Complex, std: Real) -> float:
    """Return the standard deviation of the limit over the limit, for independent circular errors of the entries (3, 3).

    ``d(1/a)/(1/a) = Re[(1 + j Re L'/Im L') l B dPhi r/(l r)]`` with L the eigenvalue one of ``B Phi``.
    """
    u, _, v = np.linalg.svd(np.eye(3) - cut[1] @ phi[1])
    left, right = u[:, -1].conj(), v[-1].conj()
    share = left @ right
    slope = left @ (cut[2] @ phi[2] - cut[0] @ phi[0]) @ right / share
    turn = 1.0 + 1j * (slope.real / slope.imag if slope.imag != 0.0 else 0.0)
    gain = np.abs(turn * np.outer(left @ cut[1], right) / share)
    return float(np.sqrt(0.5 * np.sum(gain**2 * std**2)))


def _root(margin: Level, low: tuple[float, float], high: tuple[float, float]) -> float:
    """Return where a function of the depth changes its sign (Illinois, bisection where it jumps)."""
    (a, at_a), (b, at_b) = low, high
    ga, gb, side = at_a, at_b, 0
    for step in range(80):
        middle = (a * gb - b * ga) / (gb - ga) if step < 20 else 0.5 * (a + b)
        value = margin(middle)
        if abs(value) < 1e-13 or b - a < 1e-13 * b:
            return middle
        if (value > 0.0) == (at_b > 0.0):
            b, gb, ga, side = middle, value, ga * (0.5 if side > 0 else 1.0), 1
        else:
            a, ga, gb, side = middle, value, gb * (0.5 if side < 0 else 1.0), -1
    return 0.5 * (a + b)


def _inverse(level: Level, wanted: float) -> float:
    """Return the depth [m] of a level that rises with the depth."""
    low, high = 0.0, 1e-3
    while level(high) < wanted:
        low, high = high, 2.0 * high
        if high > 1e3:
            raise InputError(f"no depth of cut has the force level {wanted:g}; it must rise with the depth")
    for _ in range(200):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        low, high = (middle, high) if level(middle) < wanted else (low, middle)
    return high
