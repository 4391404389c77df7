"""The harmonics of guideways and joints whose fundamental motion is given, and the force that they make.

Near stick-slip the motion of a guideway is far from a sine even where the tool moves as one. With the fundamental u_1
given, the others follow from ``u_k + A(k w) f_k(u) = 0``, and the force of the fundamental over u_1 is a complex
coefficient: equivalent damping, and a share in phase with the displacement that one harmonic alone does not have.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from process.friction.linearised import steepness
from process.harmonic_balance import _kernels as kernels
from process.harmonic_balance.network import RULES, FrictionElement, Network
from process.types import Complex, Real


@dataclass(frozen=True)
class ImposedMotion:
    """Motion and forces of the elements of a network.

    Attributes
    ----------
    coefficient : ndarray of complex, shape (P,)
        Fundamental of the force less the reference, over that of the motion: [N s/m], or [N/m] of a joint.
    motion : ndarray of complex, shape (P, K)
        Phasors of the motion, [m/s] or [m], at the harmonics `orders`.
    force : ndarray of complex, shape (P, K)
        Phasors of the force less the reference [N].
    orders : ndarray of int, shape (K,)
        Harmonics.
    converged : bool
        Whether the harmonics were found.
    """

    coefficient: Complex
    motion: Complex
    force: Complex
    orders: NDArray[np.int64]
    converged: bool


def imposed_motion(
    network: Network,
    fundamental: Complex,
    frequency: float,
    compliance: Callable[[Real], Complex],
    highest: int,
    start: ImposedMotion | None = None,
) -> ImposedMotion:
    """Return the harmonics that belong to a given fundamental motion of the elements.

    Parameters
    ----------
    network : Network
        Linear machine and its nonlinear elements.
    fundamental : ndarray of complex, shape (P,)
        Fundamental of their motion, [m/s] or [m].
    frequency : float
        Its frequency [Hz].
    compliance : callable
        Frequency [Hz], shape (n,) -> compliance between the elements [m/N], shape (n, P, P): that of the network, or
        with whatever else closes a loop about it, e.g. a cut.
    highest : int
        Highest harmonic.
    start : ImposedMotion, optional
        A solution near by.
    """
    grid, displaced = network.grid(highest), network.displaced
    w, orders = 2.0 * np.pi * frequency, grid.orders
    scale = np.where(displaced, w, 1.0)
    above = orders > 1
    admittance = np.zeros((orders.size, displaced.size, displaced.size), dtype=complex)
    s = np.where(displaced, 1.0, 1j * w * orders[above, None])
    admittance[above] = (s * scale)[:, :, None] * compliance(orders[above] * frequency)
    if orders[0] == 0 and network.static is not None:
        admittance[0] = scale[:, None] * network.static
    drive = np.ascontiguousarray(fundamental * scale, dtype=np.complex128)
    u = np.zeros((displaced.size, orders.size), dtype=complex)
    if start is not None and start.motion.shape == u.shape:
        old = start.motion[:, orders == 1][:, 0]
        turn = np.where(old != 0.0, fundamental / np.where(old != 0.0, old, 1.0), 0.0)
        # A shift of time turns each harmonic by its own multiple of the angle.
        u[:] = start.motion * np.abs(turn)[:, None] * np.exp(1j * np.angle(turn)[:, None] * orders) * scale[:, None]
    u[:, orders == 1] = drive[:, None]
    good = _solved(network, 1.0 / scale, admittance, drive, grid, u)
    force = np.empty((1, *u.shape), dtype=complex)
    kernels.element_forces(network.packed(), np.array([w]), u[None], grid, force)
    first = force[0][:, orders == 1][:, 0]
    still = drive == 0.0
    coefficient: Complex = np.array([complex(p.coefficient(0.0)) for p in network.elements], dtype=np.complex128)
    coefficient[~still] = (first * scale)[~still] / drive[~still]
    return ImposedMotion(coefficient, np.asarray(u / scale[:, None]), force[0], orders, good)


def _solved(network: Network, gain: Real, admittance: Complex, drive: Complex, grid: kernels.Grid, u: Complex) -> bool:
    """Solve for u (P, K), from where it is; if that fails from a soft passage through rest that is steepened."""
    new = u.copy()
    if kernels.newton(network.packed(), gain, admittance, drive, grid, new, RULES.direct_steps):
        u[:] = new
        return True
    u[:, grid.orders != 1] = 0.0
    laws = [p.law for p in network.elements if isinstance(p, FrictionElement)]
    hardest = max([steepness(law) for law in laws] + [RULES.softest])
    good = False
    for kt in np.geomspace(RULES.softest, hardest, 2 * RULES.continuation_steps):
        packed = network.packed(float(kt)) if kt < hardest * (1.0 - 1e-9) else network.packed()
        good = bool(kernels.newton(packed, gain, admittance, drive, grid, u, RULES.continuation_newton_steps))
    return good
