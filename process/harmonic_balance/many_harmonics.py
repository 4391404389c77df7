"""Harmonic balance of many harmonics: alternating frequency and time, Newton, as many harmonics as the error needs.

The linear machine does the feedback at each harmonic, the elements work in time; an unstable periodic motion is
found by Hill's determinant.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from process.errors import InputError
from process.friction.linearised import steepness
from process.harmonic_balance import _kernels as kernels
from process.harmonic_balance.network import RULES, Balance, FrictionElement, Network, checked
from process.types import Complex, Real


def multi_harmonic(
    network: Network,
    force: float,
    frequency: ArrayLike,
    harmonics: int,
    start: Balance | None = None,
    excitation: int = 0,
) -> Balance:
    """Solve the balance of harmonics up to a given one.

    Parameters
    ----------
    network : Network
        Linear machine and its nonlinear elements.
    force : float
        Amplitude of the sine force on the tool [N].
    frequency : array_like, shape (n,)
        Frequencies [Hz], in an order in which one solution starts the next.
    harmonics : int
        Highest harmonic; odd ones do where the machine and its motion are symmetric.
    start : Balance, optional
        Of the same frequencies, with fewer harmonics, to start from.
    excitation : int, optional
        Direction of the force among those of the tool.

    Returns
    -------
    Balance
        ``converged`` is False, and the values are not a number, where no periodic response was found. The error is
        estimated from the difference to `start`.
    """
    f = checked(force, frequency)
    if harmonics < 1:
        raise InputError(f"{harmonics} harmonics are given; at least 1 is needed")
    sweep = _Sweep(network, force, f, harmonics, excitation)
    motion, good = sweep.solve(start)
    return sweep.balance(motion, good, start)


class _Sweep:
    """Many-harmonic balance at frequencies (n,): admittance (n, K, P, P) in m/s/N, drive (n, P) in m/s."""

    def __init__(self, network: Network, force: float, f: Real, harmonics: int, excitation: int) -> None:
        self.network, self.force, self.f, self.excitation = network, force, f, excitation
        self.grid = network.grid(harmonics)
        self.angular = 2.0 * np.pi * f
        orders, t = self.grid.orders, network.directions
        moving = orders > 0
        self.first = int(np.argmax(orders == 1))
        at = (f[:, None] * orders[moving]).ravel()
        g = network.matrix(at)
        size = g.shape[1] - t
        # A displacement is taken times w, as a velocity.
        self.scale = np.where(network.displaced, self.angular[:, None], 1.0)
        a = network.admittance(at, g[:, t:, t:]).reshape(f.size, -1, size, size)
        self.admittance = np.zeros((f.size, orders.size, size, size), dtype=complex)
        self.admittance[:, moving] = a * self.scale[:, None, :, None]
        if not moving[0] and network.static is not None:
            self.admittance[:, 0] = self.scale[:, :, None] * network.static
        self.compliance = g.reshape(f.size, -1, *g.shape[1:])[:, 0]
        s = np.where(network.displaced, 1.0, 2j * np.pi * f[:, None])
        self.drive = s * self.scale * self.compliance[:, t:, excitation] * force

    def solve(self, start: Balance | None) -> tuple[Complex, NDArray[np.bool_]]:
        """Return the motion (n, P, K) and whether it was found."""
        shape = (self.f.size, self.drive.shape[1], self.grid.orders.size)
        first, motion, good = np.zeros(shape, dtype=complex), np.empty(shape, dtype=complex), np.empty(shape[0], bool)
        chain = True
        if start is not None:
            chain = start.orders.size == 1
            _, here, there = np.intersect1d(self.grid.orders, start.orders, return_indices=True)
            first[:, :, here] = start.motion[:, :, there] * self.scale[:, :, None]
        packed = self.network.packed()
        steps = RULES.direct_steps
        kernels.sweep(packed, self.angular, self.admittance, self.drive, self.grid, first, chain, steps, motion, good)
        for i in np.flatnonzero(~good):
            good[i] = self._continue(int(i), motion[i])
        motion[~good] = np.nan
        return motion, good

    def _continue(self, i: int, u: Complex) -> bool:
        """Solve for u (P, K) at a soft passage through rest and steepen it; a step that fails is halved."""
        elements = self.network.elements
        laws = [p.law for p in elements if isinstance(p, FrictionElement)]
        hardest = max([steepness(law) for law in laws] + [RULES.softest])
        factor, kt, done = (hardest / RULES.softest) ** (1.0 / (RULES.continuation_steps - 1)), RULES.softest, 0.0
        gain = 1.0 / self.scale[i]
        u[:] = 0.0
        u[:, self.first] = self.drive[i] / (1.0 + np.abs(np.diag(self.admittance[i, self.first])) * 1e3)
        while done < hardest:
            new, packed = u.copy(), self.network.packed(kt)
            if kernels.newton(
                packed, gain, self.admittance[i], self.drive[i], self.grid, new, RULES.continuation_newton_steps
            ):
                u[:], done = new, kt
                kt = min(kt * factor, hardest)
            elif done == 0.0 or factor < 1.02:
                return False
            else:
                factor = math.sqrt(factor)
                kt = min(done * factor, hardest)
        return True

    def balance(self, motion: Complex, good: NDArray[np.bool_], start: Balance | None) -> Balance:
        """Turn the motion of the elements into that of the tool."""
        t = self.network.directions
        force = np.empty_like(motion)
        kernels.element_forces(self.network.packed(), self.angular, np.nan_to_num(motion), self.grid, force)
        push = np.where(good[:, None], force[:, :, self.first], np.nan)
        x = self.compliance[:, :t, self.excitation] * self.force
        x = x - np.einsum("ntp,np->nt", self.compliance[:, :t, t:], push)
        u = motion / self.scale[:, :, None]
        reference = np.array([p.reference for p in self.network.elements])
        with np.errstate(divide="ignore", invalid="ignore"):
            coefficient = push / u[:, :, self.first] + reference
        out = Balance(
            self.f, x / self.force, u, self.grid.orders, coefficient, np.ones(self.f.size, dtype=np.int64), good,
            np.full(self.f.size, np.nan),
        )  # fmt: skip
        return out if start is None else replace(out, error=np.where(good, _remaining(start, out), np.inf))


def _remaining(coarse: Balance, fine: Balance) -> Real:
    """Error of the finer of two balances, from their difference.

    A reversal makes the error fall as one over the highest harmonic, from 9 on; a smooth motion makes it fall faster.
    """
    change = np.linalg.norm(fine.compliance - coarse.compliance, axis=1)
    shrink = max(coarse.orders[-1] / fine.orders[-1], 0.3)
    return np.asarray(change / np.linalg.norm(fine.compliance, axis=1) * shrink / (1.0 - shrink))


def as_many_as_needed(
    network: Network, force: float, start: Balance, tolerance: float, excitation: int = 0
) -> tuple[Balance, NDArray[np.int64], NDArray[np.int64]]:
    """Raise the number of harmonics, from a single-harmonic balance on, until the estimated error is below a tolerance.

    Parameters
    ----------
    network : Network
        Linear machine and its nonlinear elements.
    force : float
        Amplitude of the sine force on the tool [N].
    start : Balance
        From `single_harmonic`, at the frequencies (n,) that are wanted.
    tolerance : float
        Relative error of the compliance.
    excitation : int, optional
        Direction of the force among those of the tool.

    Returns
    -------
    balance : Balance
        Fundamental of the motion.
    harmonics : ndarray of int, shape (n,)
        Highest harmonic that was used.
    unstable : ndarray of int, shape (n,)
        `unstable_multipliers`; -1 where nothing converged.
    """
    n = start.frequency.size
    compliance, motion, coefficient = start.compliance.copy(), start.fundamental.copy(), start.coefficient.copy()
    harmonics, unstable, error = np.ones(n, dtype=np.int64), np.full(n, -1), start.error.copy()
    good = np.zeros(n, dtype=bool)
    left, coarse = np.arange(n), start
    for highest in RULES.harmonics:
        fine = multi_harmonic(network, force, start.frequency[left], highest, coarse, excitation)
        compliance[left], motion[left], coefficient[left] = fine.compliance, fine.fundamental, fine.coefficient
        harmonics[left], error[left], good[left] = highest, fine.error, fine.converged
        # A start that did not converge gives no error estimate.
        more = fine.converged & ~(fine.error < tolerance)
        done = fine.converged & ~more if highest != RULES.harmonics[-1] else fine.converged
        unstable[left[done]] = unstable_multipliers(network, fine.part(done))
        left, coarse = left[more], fine.part(more)
        if not left.size:
            break
    balance = Balance(
        start.frequency, compliance, motion[:, :, None], np.array([1]), coefficient, start.solutions, good, error
    )
    return balance, harmonics, unstable


def unstable_multipliers(network: Network, balance: Balance, order: int = 8) -> NDArray[np.int64]:
    """Count the ways in which a periodic response is unstable: Floquet multipliers outside the unit circle.

    A disturbance ``sum_k u_k exp(j (k w + n) t)`` lives where ``det(1 + A(k w + n) G_{k-m}) = 0``, with G the Fourier
    coefficients of the local slope of each element (Hill). The turns of the determinant about zero while n runs over
    one interval of w count the unstable multipliers, as Nyquist's curve counts poles. Such a response is a solution of
    the balance, but the machine does not stay on it.

    A guideway that sticks has a slope G_0 so large that ``A G_0`` is not small at any harmonic that is kept: the curve
    of the determinant as it stands does not close. Its mean slope is therefore made part of the linear machine,
    ``B = (1 + A G_0)^-1 A``, whose own unstable poles Nyquist's curve counts over all frequencies, and the determinant
    taken of ``1 + B(k w + n) (G_{k-m} - G_0)``, which follows it around zero.

    Parameters
    ----------
    network : Network
        Linear machine and its nonlinear elements.
    balance : Balance
        From `multi_harmonic`, shape (n,).
    order : int, optional
        Harmonics of the disturbance, -order to order.

    Returns
    -------
    ndarray of int, shape (n,)
        Zero where the response is stable; -1 where the balance did not converge.

    Notes
    -----
    A joint that slips counts with the stiffness of what sticks at each moment; its memory of the last slip, which only
    dissipates, is left out.
    """
    out = np.full(balance.frequency.size, -1, dtype=np.int64)
    good = np.flatnonzero(balance.converged)
    if not good.size:
        return out
    f = balance.frequency[good]
    grid = network.grid(max(int(balance.orders[-1]), order))
    angular = 2.0 * np.pi * f
    scale = np.where(network.displaced, angular[:, None], 1.0)
    motion = np.zeros((good.size, scale.shape[1], grid.orders.size), dtype=complex)
    _, here, there = np.intersect1d(grid.orders, balance.orders, return_indices=True)
    motion[:, :, here] = balance.motion[good][:, :, there] * scale[:, :, None]
    slope = np.empty((good.size, scale.shape[1], 2 * grid.lag_cosine.shape[1]))
    kernels.element_slopes(network.packed(), angular, motion, grid, slope)
    for i, line in enumerate(good):
        mean = slope[i, :, 0].copy()
        slope[i, :, 0] = 0.0
        at, admittance = _tabulated(network, mean, 0.9e-3 * f[i], (order + 0.5) * f[i])
        turns = kernels.hill_turns(f[i], slope[i], grid.step, order, at, admittance)
        out[line] = unstable_with(network, mean) - round(turns)
    return out


def unstable_with(network: Network, mean: Real) -> int:
    """Count the unstable poles of the linear machine whose elements have constant slopes (Nyquist).

    Parameters
    ----------
    network : Network
        Linear machine and its nonlinear elements.
    mean : ndarray, shape (P,)
        Slope of each element less its reference, [N s/m] or [N/m].
    """
    t = network.directions

    def determinant(f: Real) -> Complex:
        a = network.admittance(f, network.matrix(f)[:, t:, t:])
        return np.asarray(np.linalg.det(np.eye(mean.size) + a * mean))

    f = np.geomspace(RULES.nyquist[0], RULES.nyquist[1], 600)
    d = determinant(f)
    for _ in range(20):
        wide = np.flatnonzero(np.abs(np.angle(d[1:] / d[:-1])) > RULES.phase_step)
        if not wide.size:
            break
        middle = 0.5 * (f[wide] + f[wide + 1])
        f, d = np.insert(f, wide + 1, middle), np.insert(d, wide + 1, determinant(middle))
    # Both ends are real in the limit; what is left of their phases is not turned.
    ends = [float(np.angle(v if v.real >= 0.0 else -v)) for v in (d[0], d[-1])]
    turned = float(np.sum(np.angle(d[1:] / d[:-1]))) + ends[0] - ends[1]
    return network.unstable_poles - round(turned / np.pi)


def _tabulated(network: Network, mean: Real, lowest: float, highest: float) -> tuple[Real, Complex]:
    """Admittance (m, P, P) with the mean slopes (P,) of the elements, at frequencies (m,).

    They are so dense that straight lines between them are right to one per mille.
    """
    t = network.directions

    def at(f: Real) -> Complex:
        a = network.admittance(f, network.matrix(f)[:, t:, t:])
        return np.asarray(np.linalg.solve(np.eye(mean.size) + a * mean, a))

    f = np.geomspace(lowest, highest, 400)
    a = at(f)
    new = np.ones(f.size - 1, dtype=bool)
    for _ in range(12):
        middle = 0.5 * (f[1:] + f[:-1])[new]
        value = at(middle)
        straight = 0.5 * (a[1:] + a[:-1])[new]
        off = np.abs(value - straight).max(axis=(1, 2)) > RULES.interpolation * np.abs(value).max(axis=(1, 2))
        place = np.flatnonzero(new) + 1
        f, a = np.insert(f, place, middle), np.insert(a, place, value, axis=0)
        if not off.any():
            break
        split = place[off] + np.flatnonzero(off)  # where the middle went
        new = np.zeros(f.size - 1, dtype=bool)
        new[split - 1], new[split] = True, True
    return f, np.ascontiguousarray(a)
