"""Zero-order limits of a modal machine with the damping of the cut itself, one spindle speed at a time.

``F = a_p [A0 (1 - exp(-j w T)) + j w A_d / v_c] Phi(w) F``: A_d is the mean directional matrix of the flank
(`process.ProcessDamping`; its friction along the cut, one across it), v_c the cutting speed. With ``A_d = 0`` this is
`methods.zero_order`. The damping belongs to the depth, so the lobes are no explicit curve: the frequency is scanned
for real positive eigenvalues of the loop, and each change of sign is closed in on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import NDArray

from process.cut.engagement import AnyEngagement
from process.cut.force import (
    CuttingCoefficients,
    ProcessDamping,
    chip_projection,
    directional_matrix,
    force_projection,
    gram_matrix,
)
from process.cut.tool import Tool
from process.machine.modes import ModalModel
from process.types import Complex, Real

PER_TOOTH_PERIOD = 14
"""Samples in which the phase of a wave turns once."""

PER_WIDTH = 1.0
"""Samples in half the width of a resonance."""

MOST_SAMPLES = 6000
"""Of a scan."""

DEEPER = 3.0
"""How much deeper than the first a crossing may be to be closed in on."""

_ROUNDS = 12


@dataclass(frozen=True)
class Loop:
    """A cut at one spindle speed, for a machine whose directions may change.

    Parameters
    ----------
    regenerative : ndarray, shape (3, 3)
        A0 [N/m2].
    flank : ndarray, shape (3, 3)
        A_d over the cutting speed [N s/m2 a metre depth].
    period : float
        Tooth period T [s].
    """

    regenerative: Real
    flank: Real
    period: float


def loop_of(
    tool: Tool, arc: AnyEngagement, coefficients: CuttingCoefficients, spindle_speed: float, flank: ProcessDamping
) -> Loop:
    """Return the loop of a cut at a spindle speed [rpm]."""
    turn = 60.0 / spindle_speed
    rubbing = force_projection(np.array([flank.friction, 1.0, 0.0]), tool.approach_angle)
    mean = rubbing @ gram_matrix(arc).real @ chip_projection(tool.approach_angle) * tool.teeth / (2.0 * math.pi)
    speed = math.pi * tool.diameter / turn
    return Loop(
        directional_matrix(tool, arc, coefficients).real,
        mean * (flank.coefficient / speed),
        turn / tool.teeth,
    )


def crossings(machine: ModalModel, loop: Loop) -> tuple[Real, Real]:
    """Return depth [m] and frequency [Hz] of losses of stability, deepest last; empty arrays where there is none.

    Those deeper than about `DEEPER` times the first are left out.

    Parameters
    ----------
    machine : ModalModel
        The machine at the tool.
    loop : Loop
        The cut.
    """
    weight = np.abs(loop.regenerative).max(axis=0)
    felt = np.flatnonzero((weight > 1e-12 * weight.max()) & np.any(machine.direction != 0.0, axis=0))
    if not felt.size:
        return np.zeros(0), np.zeros(0)
    frequency = _grid(machine, loop.period)
    values = _eigenvalues(machine, loop, felt, frequency)
    following = _matched(values[:-1], values[1:])
    cells, branch = _shallow(values[:-1], following)
    low, high = frequency[cells], frequency[cells + 1]
    left, right = values[cells, branch], following[cells, branch]
    kept = np.ones_like(low)
    for _ in range(_ROUNDS):
        # Regula falsi, the end that stays counted half (Illinois); the branch goes on near the chord.
        share = kept * left.imag / (kept * left.imag - right.imag)
        middle = low + share * (high - low)
        value = _nearest(_eigenvalues(machine, loop, felt, middle), left + share * (right - left))
        crossed = value.imag * right.imag < 0.0
        low, left = np.where(crossed, high, low), np.where(crossed, right, left)
        kept = np.where(crossed, 1.0, 0.5 * kept)
        high, right = middle, value
        if not np.any(right.imag) or np.all(np.abs(right.imag) < 1e-10 * np.abs(right)):
            break
    inverse = right
    real = (inverse.real > 0.0) & (np.abs(inverse.imag) < 1e-3 * np.abs(inverse))
    depth, at = 1.0 / inverse.real[real], high[real]
    order = np.argsort(depth, kind="stable")
    return depth[order], at[order]


def _grid(machine: ModalModel, period: float) -> Real:
    """Frequencies that resolve the turns of the wave and the resonances."""
    low, high = 0.3 * float(machine.frequency.min()), 1.6 * float(machine.frequency.max()) + 0.5 / period
    narrow = float((machine.frequency * machine.damping).min()) / PER_WIDTH
    step = min(1.0 / (PER_TOOTH_PERIOD * period), narrow)
    return np.linspace(low, high, min(MOST_SAMPLES, math.ceil((high - low) / step) + 1))


def _eigenvalues(machine: ModalModel, loop: Loop, felt: NDArray[np.int64], frequency: Real) -> Complex:
    """Return eigenvalues 1/depth [1/m] of the loop at frequencies, shape (f, axes felt)."""
    w = 2.0 * np.pi * frequency
    ratio = frequency[:, None] / machine.frequency
    gain = np.asarray(1.0 / (machine.stiffness * (1.0 - ratio**2 + 2j * machine.damping * ratio)), dtype=np.complex128)
    moved, pushed = machine.direction[:, felt], machine.direction
    # Phi A, for the axes whose motion changes the force.
    cut, rub = pushed @ loop.regenerative[:, felt], pushed @ loop.flank[:, felt]
    wave = 1.0 - np.exp(-1j * w * loop.period)
    total = wave[:, None, None] * _through(gain, moved, cut)
    if np.any(rub):
        total = total + 1j * w[:, None, None] * _through(gain, moved, rub)
    if felt.size == 1:
        return np.asarray(total[:, 0])
    if felt.size == 2:
        half = 0.5 * (total[:, 0, 0] + total[:, 1, 1])
        root = np.sqrt(half**2 - total[:, 0, 0] * total[:, 1, 1] + total[:, 0, 1] * total[:, 1, 0])
        return np.stack([half + root, half - root], axis=1)
    return np.asarray(np.linalg.eigvals(total))


def _through(gain: Complex, moved: Real, force: Real) -> Complex:
    """Sum over modes of gain, motion and force, shape (f, axes, axes)."""
    each = moved[:, :, None] * force[:, None, :]
    return np.asarray(gain @ each.reshape(each.shape[0], -1)).reshape(-1, *each.shape[1:])


def _shallow(before: Complex, after: Complex) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return samples and branches after which an eigenvalue turns real, positive, and not small.

    Eigenvalues that are zero by rank are left out.
    """
    size = np.abs(before)
    turns = (before.imag * after.imag < 0.0) & (size > 1e-9 * size.max(axis=1, keepdims=True))
    cells, branch = np.nonzero(turns)
    left, right = before[cells, branch], after[cells, branch]
    inverse = (left.imag * right.real - right.imag * left.real) / (left.imag - right.imag)
    kept = (inverse > 0.0) & (inverse > inverse.max(initial=0.0) / DEEPER)
    return cells[kept], branch[kept]


def _matched(before: Complex, after: Complex) -> Complex:
    """Return the eigenvalues after, in the order of those before that they belong to, shape (f, n)."""
    orders = [list(p) for p in permutations(range(before.shape[1]))]
    distance = np.stack([np.sum(np.abs(after[:, p] - before) ** 2, axis=1) for p in orders])
    best = np.array(orders)[np.argmin(distance, axis=0)]
    return np.asarray(np.take_along_axis(after, best, axis=1))


def _nearest(values: Complex, expected: Complex) -> Complex:
    """Return of each row the eigenvalue nearest to the one expected."""
    best = np.argmin(np.abs(values - expected[:, None]), axis=1)
    return np.asarray(values[np.arange(best.size), best])
