"""Vibrations of constant size in a cut: depth, motion, kick; and the lowest depth at which there is one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from process.types import Complex, Real
from stability.operating.rules import RULES
from stability.problem import NO_LOBE


@dataclass(frozen=True)
class Cycle:
    """A vibration that neither grows nor decays in a cut at one speed.

    Attributes
    ----------
    amplitude : float
        Of the guideway that moves most [m/s], or of the force at the tool [N] for a measured compliance; 0: small.
    depth : float
        Depth of cut [m] at which it keeps its size; inf: at none, NaN: not found.
    chatter : float
        Its frequency [Hz].
    lobe : int
        Whole waves between two teeth.
    tool : ndarray of complex, shape (3,)
        Displacement of the tool [m] in the axes of the cut; for a small vibration of length one.
    elements : ndarray of complex, shape (P,)
        Motion of guideways and joints; that of the fastest has the length one.
    kick : float
        Least impulse at the tool [N s] that leads to it, in the direction that needs least.
    swing : float
        Largest change of the chip thickness over the feed per tooth: above 1 a tooth leaves the cut.
    motion : object
        Harmonics of guideways and joints, where they were solved for.
    error : float
        Standard deviation of the depth that the measured compliance makes, over the depth.
    unsteady : bool
        The machine does not need a cut for this vibration: stick-slip.
    """

    amplitude: float
    depth: float
    chatter: float = math.nan
    lobe: int = NO_LOBE
    tool: Complex = field(default_factory=lambda: np.full(3, np.nan, dtype=complex))
    elements: Complex = field(default_factory=lambda: np.empty(0, dtype=complex))
    kick: float = math.nan
    swing: float = math.nan
    motion: object = None
    error: float = math.nan
    unsteady: bool = False


@dataclass(frozen=True)
class Limits:
    """All that is found at one speed.

    Attributes
    ----------
    small : Cycle
        Limit of a small disturbance.
    least : Cycle or None
        Vibration of the lowest depth; None where no size of vibration is known.
    cycles : list of Cycle
        All that were found, by rising amplitude.
    crossings : list of float
        Depths [m] at which a small disturbance begins to grow, or to decay again.
    why, where : str
        Why there is no limit, and what was asked; empty where there is one.
    stable_to : float
        Where there is no limit: the depth [m] to which a small disturbance is known to decay; NaN: not known either.
    lost : int
        Sizes of vibration at which none was found.
    """

    small: Cycle
    least: Cycle | None
    cycles: list[Cycle]
    crossings: list[float]
    why: str = ""
    where: str = ""
    stable_to: float = math.nan
    lost: int = 0

    @classmethod
    def unknown(cls, why: str, where: str, stable_to: float = math.nan) -> Limits:
        """Return limits that are not known."""
        return cls(Cycle(0.0, math.nan), None, [], [], why, where, stable_to)


def kick_of(frequency: Real, loop: Complex) -> tuple[Complex, float]:
    """Return the force in the mode of a loop, (3,), and the least impulse [N s] that leads to it.

    ``M = 1 - loop`` has a pole of its inverse at the middle one of three frequencies [Hz]: an impulse J along d leaves
    the vibration ``2 J r (l . d)/(l M' r)``, with the null vectors l and r of M.

    Parameters
    ----------
    frequency : ndarray, shape (3,)
        Frequencies close together [Hz].
    loop : ndarray of complex, shape (3, 3, 3)
        ``B Phi`` at each of them.
    """
    u, _, v = np.linalg.svd(np.eye(3) - loop[1])
    left, right = u[:, -1].conj(), v[-1].conj()
    change = -(loop[2] - loop[0]) / (2j * np.pi * (frequency[2] - frequency[0]))
    # The largest l . d over real unit vectors d.
    best = math.sqrt(np.linalg.eigvalsh(np.outer(left, left.conj()).real)[-1])
    share = 2.0 * best / abs(left @ change @ right)
    return right, (1.0 / share if share > 0.0 else math.inf)


def contact_gain(swing: float) -> float:
    """Return the fundamental of the chip thickness of a tooth that leaves the cut, over that of one that does not.

    ``max(0, 1 + q cos t)``: 1 up to q = 1, then ``(t_c + sin(t_c)/q)/pi`` with ``cos t_c = -1/q``.
    """
    if not swing > 1.0:
        return 1.0
    end = math.acos(-1.0 / swing)
    return (end + math.sin(end) / swing) / math.pi


def lowest(nodes: Sequence[Cycle], cycle: Callable[[float, Cycle], Cycle]) -> tuple[Cycle, list[Cycle]]:
    """Return the cycle of the least depth, and all that were found, by rising amplitude.

    Parameters
    ----------
    nodes : sequence of Cycle
        By rising amplitude, the first one of no amplitude.
    cycle : callable
        (amplitude, a cycle near by) -> the cycle of that amplitude.
    """
    found = [c for c in nodes if not math.isnan(c.depth)]
    for _ in range(RULES.refinements):
        i = int(np.argmin([c.depth for c in found]))
        if i == 0 or i == len(found) - 1 or not all(math.isfinite(found[k].depth) for k in (i - 1, i, i + 1)):
            break
        if found[i].depth == 0.0:
            break
        x = np.log([max(c.amplitude, 1e-3 * found[i].amplitude) for c in found[i - 1 : i + 2]])
        y = np.array([c.depth for c in found[i - 1 : i + 2]])
        at = _turning_point(x, y)
        if min(abs(at - x)) < 1e-3:
            break
        new = cycle(math.exp(at), found[i])
        if math.isnan(new.depth):
            break
        found = sorted([*found, new], key=lambda c: c.amplitude)
    return min(found, key=lambda c: c.depth), found


def _turning_point(x: Real, y: Real) -> float:
    """Return where a parabola through three points is lowest; the middle of the longer side where that is an end."""
    one, two = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    bend = (two - one) / (x[2] - x[0])
    at = 0.5 * (x[0] + x[1] - one / bend) if bend > 0.0 else x[1]
    near = 0.02 * (x[2] - x[0])
    if not x[0] + near < at < x[2] - near or abs(at - x[1]) < near:
        at = 0.5 * (x[0] + x[1]) if x[1] - x[0] > x[2] - x[1] else 0.5 * (x[1] + x[2])
    return float(at)
