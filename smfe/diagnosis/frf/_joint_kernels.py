"""A joint that is not linear, step by step through a hit."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from process.types import Real


@njit(cache=True, nogil=True)
def _spent(y: float, count: int, stiffness: float, travel: float) -> float:
    """Force of elements at rest, of one stiffness each, that slip one after another at travels evenly apart."""
    slips = min(max(math.ceil(abs(y) / travel - 0.5), 0.0), float(count))
    force = stiffness * (0.5 * travel * slips * slips + (count - slips) * abs(y))
    return force if y >= 0.0 else -force


@njit(cache=True, nogil=True)
def _held(
    now: float,
    before: float,
    force: float,
    depth: int,
    turned: Real,
    there: Real,
    count: int,
    stiffness: float,
    travel: float,
) -> tuple[float, int]:
    """Force of the elements at a displacement, and how many reversals they remember then (Masing 1926).

    From each reversal on, `turned`, where the force was `there`, it runs as from rest at twice the scale, until a loop
    closes: what was within it is forgotten. Nothing above `depth` counts, so that a trial leaves no trace.
    """
    last = before - turned[depth - 1] if depth > 0 else before
    if (now - before) * last < 0.0:
        turned[depth], there[depth] = before, force
        depth += 1
    while depth > 0:
        if depth == 1:
            if abs(now) <= abs(turned[0]) or now * turned[0] > 0.0:
                break
            depth = 0
        elif (now - turned[depth - 2]) * (turned[depth - 2] - turned[depth - 1]) > 0.0:
            depth -= 2
        else:
            break
    if depth == 0:
        return _spent(now, count, stiffness, travel), 0
    return there[depth - 1] + 2.0 * _spent(0.5 * (now - turned[depth - 1]), count, stiffness, travel), depth


@njit(cache=True, nogil=True)
def march(
    kept: NDArray[np.complex128],
    push_begin: NDArray[np.complex128],
    push_end: NDArray[np.complex128],
    pull_begin: NDArray[np.complex128],
    pull_end: NDArray[np.complex128],
    read: NDArray[np.complex128],
    pulse: Real,
    cubic: float,
    count: int,
    stiffness: float,
    travel: float,
    out: Real,
) -> None:
    """Fill the force of the joint that is not that of its stiffness at rest, from one step to the next.

    It has a cubic spring and a count of elements, each of a stiffness, the travels at which they slip so far apart.
    """
    state = np.zeros(kept.size, dtype=np.complex128)
    turned, there = np.zeros(pulse.size + 1), np.zeros(pulse.size + 1)
    whole, y, force, back, held, depth = count * stiffness, 0.0, 0.0, 0.0, 0.0, 0
    for i in range(kept.size):
        back += (read[i] * pull_end[i]).real
    out[0] = 0.0
    for k in range(pulse.size - 1):
        free = 0.0
        for i in range(kept.size):
            state[i] = (
                kept[i] * state[i] + push_begin[i] * pulse[k] + push_end[i] * pulse[k + 1] - pull_begin[i] * force
            )
            free += (read[i] * state[i]).real
        now = free - back * force
        # What the force at the end of a step does within it is a few per cent of what it does to the next.
        for _ in range(2):
            force = cubic * now * now * now - whole * now
            if count > 0:
                force += _held(now, y, held, depth, turned, there, count, stiffness, travel)[0]
            now = free - back * force
        if count > 0:
            held, depth = _held(now, y, held, depth, turned, there, count, stiffness, travel)
        for i in range(kept.size):
            state[i] -= pull_end[i] * force
        y = now
        out[k + 1] = force
