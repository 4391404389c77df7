"""Zero-order crossings at one spindle speed, by a scan of the frequency: for cuts whose lobes are no explicit curve.

``F = a_p [A0 S(w) + j w A_d / v_c] Phi(w) F``: S is the mean of ``1 - exp(-j w T_j)`` over the delays T_j of the teeth,
A_d the mean directional matrix of the worn flank (`process.ProcessDamping`: its friction along the cut, one across it),
v_c the cutting speed. With ``A_d = 0`` and equal pitch the crossings are those of the explicit lobes of `zero_order`.
The damping force grows with the depth and with ``1/v_c``, so each speed has eigenvalues of its own: they are followed
over the frequency, and each change of sign of an imaginary part is closed in on. Source: Ahmadi and Altintas 2011.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
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
from stability.methods.rules import RULES
from stability.methods.zero_order_branches import Branches
from stability.problem import pattern_of_pitch


@dataclass(frozen=True)
class Loop:
    """What a cut adds to the machine at one spindle speed.

    Parameters
    ----------
    regenerative : ndarray, shape (3, 3)
        A0 [N/m2].
    flank : ndarray, shape (3, 3)
        A_d over the cutting speed [N s/m2 a metre depth].
    delay : ndarray, shape (teeth,)
        Time from each tooth to the one before it [s]; one value stands for equal pitch.
    """

    regenerative: Real
    flank: Real
    delay: Real

    def factors(self, frequency: Real) -> tuple[Complex, Complex]:
        """Return ``S`` and ``j w`` at frequencies [Hz], shape (f, 1, 1) each: what A0 and the flank are times."""
        w = 2.0 * np.pi * frequency
        wave = 1.0 - np.exp(-1j * w[:, None] * self.delay).mean(axis=1)
        return np.asarray(wave[:, None, None]), np.asarray(1j * w[:, None, None])


def loop_of(
    tool: Tool, arc: AnyEngagement, coefficients: CuttingCoefficients, spindle_speed: float, damping: ProcessDamping
) -> Loop:
    """Return the loop of a cut at a spindle speed [rpm], any pitch."""
    turn = 60.0 / spindle_speed
    flank = force_projection(np.array([damping.friction, 1.0, 0.0]), tool.approach_angle)
    mean = flank @ gram_matrix(arc).real @ chip_projection(tool.approach_angle) * tool.teeth / (2.0 * math.pi)
    speed = math.pi * tool.diameter / turn
    delay = np.array([1.0 / tool.teeth]) if tool.equal_pitch else pattern_of_pitch(tool).delay / (2.0 * math.pi)
    return Loop(
        directional_matrix(replace(tool, pitch_angles=None), arc, coefficients).real,
        mean * (damping.coefficient / speed),
        turn * delay,
    )


def modal_crossings(machine: ModalModel, loop: Loop) -> tuple[Real, Real]:
    """Return `crossings` of a modal model, scanned evenly from below its lowest to beyond its highest mode."""
    low, high = 0.3 * float(machine.frequency.min()), 1.6 * float(machine.frequency.max()) + 0.5 / loop.delay.max()
    half_width = float((machine.frequency * machine.damping).min())
    step = min(1.0 / (RULES.samples_per_period * loop.delay.max()), half_width)
    shapes = (machine.direction[:, :, None] * machine.direction[:, None, :]).reshape(-1, 9)
    return crossings(
        lambda f: _compliance(machine, shapes, f),
        np.linspace(low, high, min(RULES.most_samples, math.ceil((high - low) / step) + 1)),
        loop,
    )


def modal_eigenvalues(machine: ModalModel, loop: Loop, frequency: Real) -> Complex:
    """Return the eigenvalues 1/depth [1/m] of a modal model at frequencies [Hz], shape (f, 3); real at a crossing."""
    shapes = (machine.direction[:, :, None] * machine.direction[:, None, :]).reshape(-1, 9)
    return _eigenvalues(_compliance(machine, shapes, frequency), loop, np.arange(3), frequency)


def _compliance(machine: ModalModel, shapes: Real, frequency: Real) -> Complex:
    ratio = frequency[:, None] / machine.frequency
    gain = 1.0 / (machine.stiffness * (1.0 - ratio**2 + 2j * machine.damping * ratio))
    return np.asarray((gain @ shapes).reshape(-1, 3, 3))


def sampled_crossings(branches: Branches, loop: Loop) -> tuple[Real, Real]:
    """Return `crossings` of a compliance on its own grid, each step cut where the wave turns far over it."""
    f, bridged = branches.samples.frequency, branches.samples.bridged
    pieces = np.ceil(np.diff(f) * RULES.samples_per_period * loop.delay.max()).astype(np.int64)
    pieces[~bridged] = 1
    step = np.repeat(np.diff(f) / pieces, pieces)
    number = np.arange(step.size) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    frequency = np.append(np.repeat(f[:-1], pieces) + step * number, f[-1])
    return crossings(branches.compliance_at, frequency, loop, np.repeat(bridged, pieces))


def crossings(
    compliance: Callable[[Real], Complex], frequency: Real, loop: Loop, bridged: NDArray[np.bool_] | None = None
) -> tuple[Real, Real]:
    """Return depths [m] and frequencies [Hz] at which a root crosses the imaginary axis, the shallowest first.

    Those deeper than about `deepest` times the first are left out; both arrays are empty where there is none.

    Parameters
    ----------
    compliance : callable
        Frequencies [Hz], shape (f,) -> compliance [m/N], shape (f, 3, 3).
    frequency : ndarray, shape (n,)
        The scan [Hz], rising, fine enough for the resonances and for the wave between two teeth.
    loop : Loop
        The cut.
    bridged : ndarray of bool, shape (n - 1,), optional
        Whether a crossing may lie between a sample and the next; default everywhere.
    """
    phi = compliance(frequency)
    weight = np.abs(loop.regenerative).max(axis=0)
    # The axes whose motion changes the force: the others only add eigenvalues of zero.
    axes = np.flatnonzero((weight > 1e-12 * weight.max()) & (np.abs(phi).max(axis=(0, 2)) > 0.0))
    if not axes.size:
        return np.zeros(0), np.zeros(0)
    values = _eigenvalues(phi, loop, axes, frequency)
    following = _matched(values[:-1], values[1:])
    cells, branch = _shallow(values[:-1], following, bridged)
    low, high = frequency[cells], frequency[cells + 1]
    left, right = values[cells, branch], following[cells, branch]
    kept = np.ones_like(low)
    for _ in range(12):
        # False position, the end that stays counted half (Illinois); the branch goes on near the chord.
        share = kept * left.imag / (kept * left.imag - right.imag)
        middle = low + share * (high - low)
        value = _nearest(_eigenvalues(compliance(middle), loop, axes, middle), left + share * (right - left))
        crossed = value.imag * right.imag < 0.0
        low, left = np.where(crossed, high, low), np.where(crossed, right, left)
        kept = np.where(crossed, 1.0, 0.5 * kept)
        high, right = middle, value
        if not np.any(right.imag) or np.all(np.abs(right.imag) < 1e-10 * np.abs(right)):
            break
    real = (right.real > 0.0) & (np.abs(right.imag) < 1e-3 * np.abs(right))
    depth, at = 1.0 / right.real[real], high[real]
    order = np.argsort(depth, kind="stable")
    return depth[order], at[order]


def _eigenvalues(phi: Complex, loop: Loop, axes: NDArray[np.int64], frequency: Real) -> Complex:
    """Return the eigenvalues 1/depth [1/m] of ``Phi (A0 S + j w A_d/v_c)``, shape (f, axes)."""
    wave, rate = loop.factors(frequency)
    rows = phi[:, axes].reshape(-1, 3)
    total = wave * (rows @ loop.regenerative[:, axes]).reshape(-1, axes.size, axes.size)
    if np.any(loop.flank):
        total = total + rate * (rows @ loop.flank[:, axes]).reshape(-1, axes.size, axes.size)
    if axes.size == 1:
        return np.asarray(total[:, 0])
    if axes.size == 2:
        half = 0.5 * (total[:, 0, 0] + total[:, 1, 1])
        root = np.sqrt(half**2 - total[:, 0, 0] * total[:, 1, 1] + total[:, 0, 1] * total[:, 1, 0])
        return np.stack([half + root, half - root], axis=1)
    return np.asarray(np.linalg.eigvals(total))


def _shallow(
    before: Complex, after: Complex, bridged: NDArray[np.bool_] | None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return samples and branches after which an eigenvalue turns real, positive, and not small.

    Eigenvalues that are zero by rank are left out.
    """
    size = np.abs(before)
    turns = (before.imag * after.imag < 0.0) & (size > 1e-9 * size.max(axis=1, keepdims=True))
    if bridged is not None:
        turns &= bridged[:, None]
    cells, branch = np.nonzero(turns)
    left, right = before[cells, branch], after[cells, branch]
    inverse = (left.imag * right.real - right.imag * left.real) / (left.imag - right.imag)
    kept = (inverse > 0.0) & (inverse > inverse.max(initial=0.0) / RULES.deepest)
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
