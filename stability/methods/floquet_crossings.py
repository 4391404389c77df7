"""Depths at which a Floquet multiplier lies on the unit circle: eigenvalue curves that cross the real axis.

Both converged methods end in a matrix M(theta) whose eigenvalues are 1/depth when ``exp(j theta)`` is a multiplier of
the period. A depth is real: the crossings of all curves with the positive real axis over 0 <= theta <= pi are *all*
depths at which stability can change, islands included, and no grid over depth is needed to find them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import linear_sum_assignment

from process.types import Complex, Real
from stability.methods.rules import RULES

Curve = Callable[[Real], Sequence[Complex] | Complex]
"""Angles, shape (n,) -> for each the eigenvalues [1/m], shape (any,), in any order."""


@dataclass(frozen=True)
class Crossing:
    """A depth at which a multiplier ``exp(j angle)`` is on the unit circle.

    Parameters
    ----------
    angle : float
        theta [rad], 0 to pi.
    depth : float
        Axial depth [m].
    """

    angle: float
    depth: float

    @property
    def kind(self) -> str:
        """Type of the loss: ``flip`` (period doubling) at pi, ``fold`` at 0, else ``hopf``."""
        if self.angle == math.pi:
            return "flip"
        return "fold" if self.angle == 0.0 else "hopf"


def angle_grid(poles: Complex, count: int) -> Real:
    """Return angles 0 to pi, evenly spaced and gathered about poles ``exp(lambda T)`` of the machine alone.

    Parameters
    ----------
    poles : ndarray of complex
        Multipliers of the machine without cutting.
    count : int
        Number of even steps.
    """
    even = np.linspace(0.0, math.pi, count + 1)
    offset = np.tan(np.pi * np.array([-7.2, -6.5, -5.0, -2.5, 0.0, 2.5, 5.0, 6.5, 7.2]) / 16.0)
    width = np.minimum(-np.log(np.maximum(np.abs(poles), 1e-300)), 1.0)
    near = (np.abs(np.angle(poles))[:, None] + width[:, None] * offset).ravel()
    # At 0 and pi every real eigenvalue lies on the axis: a curve that crosses just before is seen just before only.
    close = [RULES.close_to_end, math.pi - RULES.close_to_end]
    grid = np.unique(np.concatenate([even, close, near[(near > close[0]) & (near < close[1])]]))
    apart = np.concatenate([[True], np.diff(grid) > 1e-4])
    apart[-2:] = True
    return np.asarray(grid[apart])


def find_crossings(
    curve: Curve, angles: Real, deepest: float | None = None, shallower: float | None = None
) -> list[Crossing]:
    """Return crossings, lowest depth first.

    Parameters
    ----------
    curve : callable
        Angles -> eigenvalues.
    angles : ndarray
        Rising angles from 0 to pi; intervals are halved where a curve turns too far between them.
    deepest : float, optional
        Depth [m] up to which all crossings are wanted. Without it only the lowest one is certain to be there:
        intervals that can only hold deeper ones than those found so far are left out.
    shallower : float, optional
        Depth [m] of a crossing that is known: deeper ones are left out from the beginning, and with them eigenvalues
        below half of `RULES.share_of_bound` of 1/depth, which `curve` need not return.
    """
    values = curve(angles)
    samples = list(zip(angles.tolist(), values, strict=True))
    for _, at_end in (samples[0], samples[-1]):
        at_end.imag[np.abs(at_end.imag) <= 1e-9 * np.abs(at_end)] = 0.0
    found = [Crossing(a, depth) for a, at_end in (samples[0], samples[-1]) for depth in real_depths(at_end)]
    if isinstance(values, np.ndarray):
        size, real = np.abs(values).max(axis=1), values.real.max(axis=1)
    else:
        size, real = (np.array([part(v).max(initial=0.0) for v in values]) for part in (np.abs, np.real))
    largest = float(size.max())
    if largest == 0.0:
        return []
    beyond = deepest or shallower or 1.0 / (RULES.negligible_eigenvalue * largest)
    found = [c for c in found if c.depth <= beyond]
    reach = np.maximum(real[:-1], real[1:])
    bound = deepest or min([beyond, *(c.depth for c in found)])
    for i in np.argsort(-reach, kind="stable"):
        least = RULES.share_of_bound / bound
        if size[i] > least and size[i + 1] > 0.5 * least:
            new = list(_between(curve, samples[i], samples[i + 1], least))
            found.extend(new)
            bound = deepest or min([bound, *(c.depth for c in new)])
    return sorted((c for c in found if deepest is None or c.depth <= deepest), key=lambda c: c.depth)


def _at(curve: Curve, angle: float) -> Complex:
    return curve(np.array([angle]))[0]


def real_depths(values: Complex) -> list[float]:
    """Depths of the real positive eigenvalues of a real matrix (theta 0 or pi)."""
    size = np.abs(values)
    real = (np.abs(values.imag) <= 1e-9 * size) & (values.real > 1e-6 * size.max(initial=0.0))
    return [1.0 / float(v) for v in values.real[real]]


def _between(curve: Curve, low: tuple[float, Complex], high: tuple[float, Complex], least: float) -> Iterator[Crossing]:
    """Yield the crossings strictly between two angles, halving as needed."""
    work = [(low, high)]
    while work:
        (a, at_a), (b, at_b) = work.pop()
        steps = _matched(at_a, at_b, least)
        if b - a > RULES.smallest_interval and any(_too_far(first, last) for first, last in steps):
            middle = 0.5 * (a + b)
            at_middle = _at(curve, middle)
            work += [((a, at_a), (middle, at_middle)), ((middle, at_middle), (b, at_b))]
            continue
        for first, last in steps:
            if first.imag * last.imag < 0.0 and max(first.real, last.real) > least:
                yield from _root(curve, (a, first), (b, last))


def _too_far(first: complex, last: complex) -> bool:
    """Whether a curve may do something between two values that a straight line between them misses."""
    if max(first.real, last.real) <= 0.0:
        return False
    step, size = abs(last - first), max(abs(first), abs(last))
    if first.imag * last.imag <= 0.0:
        return step > RULES.largest_step * size
    return min(abs(first.imag), abs(last.imag)) < 0.5 * step and step > RULES.tangent_step * size


def _matched(at_a: Complex, at_b: Complex, least: float) -> list[tuple[complex, complex]]:
    """Pair the eigenvalues of two angles, nearest with nearest; those too small to matter are left out."""
    first, last = at_a[np.abs(at_a) > least], at_b[np.abs(at_b) > 0.5 * least]
    if first.size == 0 or last.size == 0:
        return []
    rows, columns = linear_sum_assignment(np.abs(first[:, None] - last[None, :]))
    return [(complex(first[i]), complex(last[j])) for i, j in zip(rows, columns, strict=True)]


def _root(curve: Curve, low: tuple[float, complex], high: tuple[float, complex]) -> Iterator[Crossing]:
    """Yield where one curve meets the real axis (Illinois); nothing when the ends belong to different curves."""
    (a, at_a), (b, at_b) = low, high
    ga, gb, side = at_a.imag, at_b.imag, 0
    for _ in range(60):
        middle = (a * gb - b * ga) / (gb - ga)
        share = (middle - a) / (b - a)
        at_middle = _nearest(_at(curve, middle), at_a + share * (at_b - at_a))
        if abs(at_middle.imag) <= 1e-7 * abs(at_middle) or b - a < 1e-13:
            if at_middle.real > 0.0 and abs(at_middle.imag) <= 1e-4 * abs(at_middle) and 0.0 < middle < math.pi:
                yield Crossing(middle, 1.0 / at_middle.real)
            return
        if (at_middle.imag > 0.0) == (at_b.imag > 0.0):
            b, at_b, gb, ga, side = middle, at_middle, at_middle.imag, ga * (0.5 if side > 0 else 1.0), 1
        else:
            a, at_a, ga, gb, side = middle, at_middle, at_middle.imag, gb * (0.5 if side < 0 else 1.0), -1


def _nearest(values: Complex, to: complex) -> complex:
    return complex(values[int(np.argmin(np.abs(values - to)))])


def follow(curve: Curve, crossing: Crossing) -> Crossing | None:
    """Return the crossing of a finer discretisation near that of a coarser one; None when it has gone elsewhere."""
    if crossing.kind != "hopf":
        depths = real_depths(_at(curve, crossing.angle))
        best = min(depths, key=lambda d: abs(1.0 / d - 1.0 / crossing.depth), default=math.inf)
        return Crossing(crossing.angle, best) if abs(best / crossing.depth - 1.0) < 0.2 else None
    old, value = crossing.angle, _nearest(_at(curve, crossing.angle), 1.0 / crossing.depth + 0.0j)
    new = old + 1e-4 if old < 0.5 * math.pi else old - 1e-4
    for _ in range(25):
        at_new = _nearest(_at(curve, new), value)
        if abs(at_new.imag) <= 1e-7 * abs(at_new):
            near = (
                abs(at_new.real * crossing.depth - 1.0) < 0.2
                and RULES.close_to_end < new < math.pi - RULES.close_to_end
            )
            return Crossing(new, 1.0 / at_new.real) if near else None
        if at_new.imag == value.imag:
            return None
        slope = (at_new.imag - value.imag) / (new - old)
        old, value = new, at_new
        new = old - max(-0.1, min(0.1, value.imag / slope))
    return None


def followed_angle(kind: str, turns: float) -> tuple[float, bool]:
    """Return the angle of a multiplier whose line turns so often in a period, and whether it is the conjugate one's."""
    if kind != "hopf":
        return (math.pi if kind == "flip" else 0.0), False
    angle = 2.0 * math.pi * (turns % 1.0)
    return (2.0 * math.pi - angle, True) if angle > math.pi else (angle, False)


def approach(
    matrix: Callable[[Real], Complex], angle: float, value: complex, vector: Complex
) -> tuple[Crossing, Complex] | None:
    """Return the crossing near an angle and an eigenvalue 1/depth [1/m] with its vector; None where there is none.

    Newton's method on ``M(angle) x = value x``, ``x_0^H x = 1`` with a real value: the angle moves the imaginary part
    of the value to zero. At 0 and pi the angle stays. `matrix` takes angles (n,) to matrices (n, m, m).
    """
    fixed = angle in (0.0, math.pi)
    size, step = vector.size, 0.0
    border = np.append(vector.conj() / np.vdot(vector, vector), 0.0)
    x, whole = vector.astype(complex), np.zeros((size + 1, size + 1), dtype=complex)
    shift = 1e-6 if angle < 0.5 * math.pi else -1e-6
    for _ in range(12):
        at, *beside = matrix(np.array([angle] if fixed else [angle, angle + shift]))
        right = np.zeros((size + 1, 2), dtype=complex)
        right[:size, 0] = value * x - at @ x
        if not fixed:
            right[:size, 1] = (at @ x - beside[0] @ x) / shift
        whole[:size, :size] = at
        whole[range(size), range(size)] -= value
        whole[:size, size], whole[size] = -x, border
        try:
            found = np.linalg.solve(whole, right)
        except np.linalg.LinAlgError:
            return None
        if not fixed:
            slope = found[size, 1].imag
            step = max(-0.1, min(0.1, -(value + found[size, 0]).imag / slope)) if slope else math.inf
        moved = found[:, 0] + step * found[:, 1]
        x, value, angle = x + moved[:size], value + complex(moved[size]), angle + step
        if not (fixed or 0.0 < angle < math.pi) or not 0.0 < abs(value) < math.inf:
            return None
        # The error left is about the square of the last step, and 1e-4 of it: the slope is a difference.
        if abs(moved[size]) <= 1e-4 * abs(value) and abs(step) <= 1e-4 and abs(value.imag) <= 1e-7 * abs(value):
            inside = fixed or RULES.close_to_end < angle < math.pi - RULES.close_to_end
            return (Crossing(angle, 1.0 / value.real), x) if inside and value.real > 0.0 else None
    return None


def is_unstable(signs: Callable[[Real], Complex], angles: Real) -> bool:
    """Whether a cut is unstable at one of some depths, without a search for crossings: Nyquist's criterion.

    The machine alone is stable, so that ``det(1 - depth M(theta))`` turns about zero as often as multipliers lie
    outside the unit circle. Over half the circle it turns by half of that, from one real value to another; steps of
    more than `RULES.largest_turn` are cut in four.

    Parameters
    ----------
    signs : callable
        Rising angles [rad], shape (n,) -> the determinants there, of modulus 1 or 0, shape (n, depths).
    angles : ndarray
        Rising angles from 0 to pi.
    """
    at = signs(angles)
    while True:
        ratio = at[1:] * at[:-1].conj()
        turned = np.angle(np.where(ratio == 0.0, 1.0, ratio))
        wide = np.any(np.abs(turned) > RULES.largest_turn, axis=1) & (np.diff(angles) > RULES.smallest_interval)
        if not wide.any():
            return bool(np.any(np.round(turned.sum(axis=0) / math.pi) != 0.0))
        place = np.repeat(np.flatnonzero(wide) + 1, 3)
        share = np.tile([0.25, 0.5, 0.75], place.size // 3)
        between = (1.0 - share) * angles[place - 1] + share * angles[place]
        angles, at = np.insert(angles, place, between), np.insert(at, place, signs(between), axis=0)


def relative_change(old: Crossing | None, new: Crossing | None) -> float:
    """Return the relative change of a limit; a limit that appears or vanishes changes without bound."""
    if old is None or new is None:
        return 0.0 if old is new else math.inf
    return abs(new.depth / old.depth - 1.0)


# --- a helix: the matrix depends on the depth, over which the edges lie ----------------------------------------------


class Twisted(Protocol):
    """The cut with edges that reach over one depth: a problem with eigenvalues 1/depth like that of straight edges."""

    def crossings(self, deepest: float) -> list[Crossing]:
        """Return all crossings up to a depth [m], lowest first."""

    def near(self, crossing: Crossing) -> Crossing | None:
        """Return the crossing near one of another reach; None where there is none."""

    def stable_at(self, depth: float) -> bool:
        """Whether the cut is stable at a depth [m]."""


Reaches = Callable[[float], Twisted]
"""Depth [m] over which the edges reach -> the cut with these edges."""


def meet(reaches: Reaches, crossing: Crossing) -> Crossing | None:
    """Return the crossing near another at which the edges reach as deep as the cut (secant method); None: it is lost.

    With edges that reach over s the crossing lies at the depth a(s); asked is ``a(s) = s``.
    """
    reach, at, before = crossing.depth, crossing, None
    for _ in range(20):
        new = reaches(reach).near(at)
        if new is None:
            return None
        apart = new.depth - reach
        if abs(apart) <= 1e-7 * reach:
            return new
        step = apart
        if before is not None and before[1] != apart:
            step = -apart * (reach - before[0]) / (apart - before[1])
        before, at = (reach, apart), new
        reach += max(-0.2 * reach, min(0.2 * reach, step))
    return None


def helix_crossings(reaches: Reaches, pitch: float, deepest: float, straight: float = math.inf) -> Iterator[Crossing]:
    """Yield the crossings of a cut with a helix, lowest first.

    `straight`: limit depth [m] of straight edges, if known. A little beyond it the first piece ends: in slow cuts a
    piece holds dozens of crossings, of which the first is asked for.

    The depth is cut in pieces of a small part of the helix pitch. In each the matrix hardly changes: the crossings of
    edges that reach to its middle are all there can be, and each is followed to where the edges reach as deep as the
    cut. Where stability changes over a piece and no crossing was found, that place is closed in on.
    """
    low, stable, end = 0.0, True, RULES.beyond_straight * straight
    while low < deepest:
        high = min(deepest, end, low + max(1.0 / RULES.pieces_a_pitch, low / (pitch * RULES.pieces_of_depth)) * pitch)
        end = math.inf
        margin = 0.5 * (high - low)
        candidates = reaches(0.5 * (low + high)).crossings(high + margin)
        followed = [meet(reaches, c) for c in candidates if c.depth > low - margin]
        found: list[Crossing] = []
        for new in sorted((c for c in followed if c is not None), key=lambda c: c.depth):
            same = found and abs(new.depth / found[-1].depth - 1.0) < 1e-5 and abs(new.angle - found[-1].angle) < 1e-4
            if low < new.depth <= high and not same:
                found.append(new)
        after = reaches(high).stable_at(high)
        if not found and after != stable:
            found = [_closed_in(reaches, low, high, stable)]
        yield from found
        low, stable = high, after


def _closed_in(reaches: Reaches, low: float, high: float, stable: bool) -> Crossing:
    """Return the crossing between a depth [m] and another at which the cut is stable, or not, other than there."""
    while high - low > 1e-5 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if reaches(middle).stable_at(middle) == stable else (low, middle)
    near = reaches(high).crossings(1.1 * high)
    angle = min(near, key=lambda c: abs(c.depth - high)).angle if near else math.pi
    return Crossing(angle, high)


def first_with_helix(
    finer: Callable[[int], Reaches | None], pitch: float, deepest: float, straight: float, tolerance: float
) -> tuple[Crossing | None, float, int]:
    """Return the first crossing of a cut with a helix, its last relative change, and how often it was refined.

    Parameters
    ----------
    finer : callable
        Times refined -> the cut; None where it is not refined so far.
    pitch : float
        Helix pitch [m].
    deepest : float
        Depth [m] beyond which no limit is of use.
    straight : float
        Limit depth [m] of straight edges; infinite where they have none.
    tolerance : float
        Relative change at which the refinement ends.
    """

    def first(at: Reaches) -> Crossing | None:
        return next(helix_crossings(at, pitch, deepest, straight), None)

    at, level, change = finer(0), 0, math.inf
    assert at is not None
    old = first(at)
    while (better := finer(level + 1)) is not None:
        new = meet(better, old) if old is not None else None
        change = relative_change(old, new)
        # What moves much may have hidden an island below, narrower than the shares at which it is confirmed.
        if new is None or change > tolerance or not _stable_below(better, new.depth):
            new = first(better)
            change = relative_change(old, new)
        old, level = new, level + 1
        if change <= tolerance:
            break
    return old, change, level


def _stable_below(at: Reaches, depth: float) -> bool:
    return all(at(share * depth).stable_at(share * depth) for share in RULES.confirmed_shares)
