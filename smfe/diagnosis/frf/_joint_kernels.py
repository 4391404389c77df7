"""A joint that is not linear, step by step through a hit."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from process.types import Real


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
    stiffness: Real,
    most: Real,
    out: Real,
) -> None:
    """Fill the force of the joint that is not that of its stiffness at rest, from one step to the next."""
    state = np.zeros(kept.size, dtype=np.complex128)
    held = np.zeros(stiffness.size)
    whole, y, force, back = stiffness.sum(), 0.0, 0.0, 0.0
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
            for i in range(held.size):
                force += min(max(held[i] + stiffness[i] * (now - y), -most[i]), most[i])
            now = free - back * force
        for i in range(held.size):
            held[i] = min(max(held[i] + stiffness[i] * (now - y), -most[i]), most[i])
        for i in range(kept.size):
            state[i] -= pull_end[i] * force
        y = now
        out[k + 1] = force
