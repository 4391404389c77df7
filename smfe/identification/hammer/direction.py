"""Hits along the wrong axis or from the wrong side, found by the response: hits of an axis look like each other.

The compliance of each hit alone, times w (a mobility, which shows the resonances), is one long vector over frequency
and responses. Two hits of the same axis agree when these vectors have the same shape (modal assurance criterion), the
same size within a factor of two, and the same sign. A hit that disagrees with most of the hits of its axis, while these
agree with each other, was not made where the campaign says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from process.types import Complex, Real
from smfe.identification.hammer.impacts import WRONG_DIRECTION, Hit
from smfe.identification.hammer.rules import RULES


@dataclass(frozen=True)
class HitSpectra:
    """Hits of one axis: shapes (f,), (f, 3, M), (f, M)."""

    hits: Sequence[Hit]
    frequency: Real
    motion: Complex
    force: Complex


UNLIKE = f"{WRONG_DIRECTION}: its response is not that of the other hits along"
"""Beginning of the reason of a hit whose direction nothing tells."""


def wrong_directions(columns: Mapping[str, HitSpectra]) -> tuple[dict[tuple[str, int], str], list[str]]:
    """Return the hits that were made elsewhere than declared.

    Parameters
    ----------
    columns : mapping of str to HitSpectra
        Excitation axis -> hits with their spectra, inside the band that their force carries.

    Returns
    -------
    faults : dict
        (axis, place among its hits) -> reason.
    notes : list of str
        What cannot be decided.
    """
    shapes = {axis: _shapes(column) for axis, column in columns.items()}
    faults: dict[tuple[str, int], str] = {}
    notes = []
    for axis, column in columns.items():
        wrong, undecided = _outvoted(shapes[axis], column.hits)
        notes += [f"excitation {axis}: {undecided}"] if undecided else []
        for m in wrong:
            faults[axis, m] = ""
    accused = dict(faults)
    for axis, m in accused:
        reason = _reason(axis, m, shapes, accused)
        if _belongs(axis, m, shapes, accused) or (reason.startswith(UNLIKE) and _scattered(axis, m, shapes, accused)):
            del faults[axis, m]
        else:
            faults[axis, m] = reason
    return faults, notes


def _scattered(axis: str, m: int, shapes: Mapping[str, Complex], faults: Mapping[tuple[str, int], str]) -> bool:
    """Whether the others of its axis are hardly more like each other than a hit that is like none is like them.

    Each hit that breaks a guideway away finds another state of it.
    """
    good = [k for k in range(len(shapes[axis])) if (axis, k) not in faults]

    def unlike(k: int) -> float:
        return 1.0 - compared(shapes[axis][k], np.mean([shapes[axis][j] for j in good if j != k], axis=0))[0]

    return len(good) > 1 and unlike(m) < RULES.apart * max(unlike(k) for k in good)


def _belongs(axis: str, m: int, shapes: Mapping[str, Complex], faults: Mapping[tuple[str, int], str]) -> bool:
    """Whether a hit that was outvoted is only noisier than the others: the mean of those is like it, and no other axis.

    Noise takes from the shape of two single hits what it takes from none and their mean.
    """
    own, found = shapes[axis][m], {}
    for other, each in shapes.items():
        good = [k for k in range(len(each)) if (other, k) not in faults]
        if good and each.shape[1] == own.size:
            found[other] = compared(own, np.mean(each[good], axis=0))
    if axis not in found:
        return False
    shape, gain = found[axis]
    alike = gain.real > 0.5 * abs(gain) and 1.0 / RULES.same_size <= abs(gain) <= RULES.same_size
    return alike and shape >= max(RULES.noisy_shape, *(2.0 * f[0] for a, f in found.items() if a != axis), 0.0)


def _shapes(column: HitSpectra) -> Complex:
    """Return the mobility of each hit as a vector, shape (M, lines x responses); NaN: no response."""
    with np.errstate(invalid="ignore", divide="ignore"):
        h = column.motion / column.force[:, None, :] * (2.0 * np.pi * column.frequency)[:, None, None]
    return np.asarray(np.moveaxis(h, 2, 0).reshape(h.shape[2], -1))


def compared(one: Complex, other: Complex) -> tuple[float, complex]:
    """Return the modal assurance criterion of two vectors and the gain of the first over the second.

    ``|<b, a>|^2/(|a|^2 |b|^2)`` and ``<b, a>/|b|^2``, over the lines where either is above a tenth of its maximum and
    both are known; (0, NaN) when none is.

    Parameters
    ----------
    one, other : ndarray of complex, shape (n,)
        The vectors a and b, in any unit.
    """
    both = np.isfinite(one) & np.isfinite(other)
    if not both.any():
        return 0.0, complex("nan")
    a, b = one[both], other[both]
    power_a, power_b = np.abs(a) ** 2, np.abs(b) ** 2
    strong = (power_a > RULES.strong_line * power_a.max()) | (power_b > RULES.strong_line * power_b.max())
    product = complex(np.vdot(b[strong], a[strong]))
    aa, bb = float(power_a[strong].sum()), float(power_b[strong].sum())
    if aa == 0.0 or bb == 0.0:
        return 0.0, complex("nan")
    return abs(product) ** 2 / (aa * bb), product / bb


def _agree(one: Complex, other: Complex) -> bool:
    shape, gain = compared(one, other)
    return shape >= RULES.same_shape and gain.real > 0.0 and 1.0 / RULES.same_size <= abs(gain) <= RULES.same_size


def _outvoted(shapes: Complex, hits: Sequence[Hit]) -> tuple[list[int], str]:
    """Return the hits that disagree with most of those of their level, and what two hits leave open."""
    count = len(hits)
    level = np.abs([hit.peak_force for hit in hits])
    near = np.maximum(level[:, None], level) <= RULES.same_level * np.minimum(level[:, None], level)
    near &= np.array([[bool(np.any(np.isfinite(a) & np.isfinite(b))) for b in shapes] for a in shapes])
    np.fill_diagonal(near, False)
    agree = np.array([[bool(near[i, j]) and _agree(shapes[i], shapes[j]) for j in range(count)] for i in range(count)])
    agree = agree | agree.T
    peers, friends = near.sum(axis=1), agree.sum(axis=1)
    wrong = [
        m
        for m in range(count)
        # Those it disagrees with must agree with each other: noise makes all hits disagree with all others.
        if peers[m] >= 2 and friends[m] < 0.5 * peers[m] and _united(agree, np.flatnonzero(near[m] & ~agree[m]))
    ]
    if count == 2 and near[0, 1] and not agree[0, 1] and compared(shapes[0], shapes[1])[0] >= RULES.same_shape:
        gain = compared(shapes[0], shapes[1])[1]
        return [], (
            f"its two hits have the same shape but a ratio of {gain.real:.2g}: one was made elsewhere or from the "
            "other side than its sensor says, and two do not decide which; add a third"
        )
    return (wrong if 2 * len(wrong) < count else []), ""


def _united(agree: NDArray[np.bool_], others: NDArray[np.int64]) -> bool:
    """Whether more than half of the pairs agree."""
    if others.size < 2:
        return False
    block = agree[np.ix_(others, others)]
    return bool(block.sum() > 0.5 * others.size * (others.size - 1))


def _reason(axis: str, m: int, shapes: Mapping[str, Complex], faults: Mapping[tuple[str, int], str]) -> str:
    own = shapes[axis][m]
    for other in (axis, *(a for a in shapes if a != axis)):
        good = [k for k in range(len(shapes[other])) if (other, k) not in faults]
        if not good or shapes[other].shape[1] != own.size:
            continue
        shape, gain = compared(own, np.mean(shapes[other][good], axis=0))
        if shape < RULES.same_shape:
            continue
        if gain.real < 0.0:
            return (
                f"{WRONG_DIRECTION}: its response is that of the hits along {other} turned round (gain "
                f"{gain.real:.2g}); hit from the other side, or a sensor has the wrong sign"
            )
        if other == axis:
            return f"{WRONG_DIRECTION}: it gives {abs(gain):.2g} times the compliance of the other hits along {axis}"
        if 1.0 / RULES.same_size <= abs(gain) <= RULES.same_size:
            return f"{WRONG_DIRECTION}: its response is that of a hit along {other} (gain {abs(gain):.2g})"
    return f"{UNLIKE} {axis}"
