"""Harmonic balance of the fundamental alone: ``u = (1 + A c(|u|))^-1 d`` at each frequency, for all at once.

A is the admittance between the nonlinear elements, d what the force excites without them, c their describing functions.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from process.harmonic_balance import _kernels as kernels
from process.harmonic_balance.network import RULES, Balance, Network, checked
from process.types import Complex, Real


def single_harmonic(network: Network, force: float, frequency: ArrayLike, excitation: int = 0) -> Balance:
    """Solve the balance of the fundamental alone: a whole FRF in milliseconds.

    From the lowest solution of each element with the others held, Newton on the logarithms of all amplitudes.

    Parameters
    ----------
    network : Network
        Linear machine and its nonlinear elements.
    force : float
        Amplitude of the sine force on the tool [N].
    frequency : array_like, shape (n,)
        Frequencies [Hz].
    excitation : int, optional
        Direction of the force among those of the tool.

    Returns
    -------
    Balance
        With one harmonic and the error that the others make.

    Notes
    -----
    Right to a few per mille where a guideway slides or is locked, but wrong by 50 % and more where it is near
    stick-slip: `Balance.error` states where; `multi_harmonic` is right there.
    """
    f = checked(force, frequency)
    g, t = network.matrix(f), network.directions
    a = network.admittance(f, g[:, t:, t:])
    s = np.where(network.displaced, 1.0, 2j * np.pi * f[:, None])
    problem = _Problem(network, a, s * g[:, t:, excitation] * force)
    log_u, count, found = problem.solve()
    c = problem.coefficients(log_u)
    u = np.where(found[:, None], problem.response(c), np.nan)
    x = g[:, :t, excitation] * force - np.einsum("ntp,np->nt", g[:, :t, t:], c * u)
    error = np.where(found, _error(problem, f, g, u, c, x), np.inf)
    whole = c + np.array([p.reference for p in network.elements])
    return Balance(
        f, x / force, u[:, :, None], np.array([1]), np.where(found[:, None], whole, np.nan), count, found, error
    )


class _Problem:
    """Admittance (n, P, P), drive (n, P) and a table of the coefficient of each element."""

    def __init__(self, network: Network, admittance: Complex, drive: Complex) -> None:
        self.network, self.admittance, self.drive = network, admittance, drive
        size = np.abs(drive)
        # An anti-resonance excites nothing.
        self.least = np.maximum(1e-9 * size.max(axis=0, initial=0.0), 1e-9 * size.max(initial=0.0) + 1e-30)
        self.tables = [self._table(i) for i in range(drive.shape[1])]

    def _table(self, i: int) -> tuple[Real, Complex]:
        element = self.network.elements[i]
        stiffest = float(np.abs(element.coefficient([1e-12, 1e-6, 1e-3, 1.0])).max())
        drive = np.maximum(np.abs(self.drive[:, i]), self.least[i])
        low = float(np.min(drive / (1.0 + np.abs(self.admittance[:, i, i]) * stiffest)))
        high = max(float(drive.max()), float(self.least.max() * 1e9))
        return element.table(max(0.1 * low, 1e-13 * high), 100.0 * high)

    def coefficients(self, log_u: Real) -> Complex:
        """Return c (n, P) at the logarithms of the amplitudes (n, P): closed forms of joints, tables of friction."""
        out = np.empty(log_u.shape, dtype=complex)
        for i, (element, (grid, value)) in enumerate(zip(self.network.elements, self.tables, strict=True)):
            if element.uses_displacement:
                out[:, i] = element.coefficient(np.exp(log_u[:, i]))
            else:
                out[:, i] = _interpolated(np.log(grid), value, log_u[:, i])
        return out

    def response(self, c: Complex) -> Complex:
        """Return u (n, P) for coefficients c (n, P)."""
        return _solved(self.admittance, c, self.drive)

    def solve(self) -> tuple[Real, NDArray[np.int64], NDArray[np.bool_]]:
        """Return the logarithms of the amplitudes (n, P), the number of solutions (n,) and whether one was found."""
        n, elements = self.drive.shape
        count, found = np.ones(n, dtype=np.int64), np.ones(n, dtype=bool)
        log_u = np.log(np.maximum(np.abs(self.drive), self.least))
        for i in range(elements):
            log_u[:, i] = np.log(self.tables[i][0][-1])
        for _ in range(RULES.sweeps if elements > 1 else 1):
            count[:], found[:] = 1, True
            for i in range(elements):
                place, number = self._alone(i, log_u)
                grid = np.log(self.tables[i][0])
                log_u[:, i] = np.interp(place, np.arange(grid.size), grid)
                count, found = np.maximum(count, number), found & (place >= 0.0)
        return self._newton(log_u, count, found)

    def _alone(self, i: int, log_u: Real) -> tuple[Real, NDArray[np.int64]]:
        """Lowest solution for element i, the others held: its place in the table (n,), and the number of solutions."""
        c = self.coefficients(log_u)
        c[:, i] = 0.0
        both = np.stack([self.drive, self.admittance[:, :, i]], axis=-1)
        loop = np.eye(c.shape[1]) + self.admittance * c[:, None, :]
        free = np.linalg.solve(loop, both)[:, i]
        place, count = np.empty(c.shape[0]), np.empty(c.shape[0], dtype=np.int64)
        drive = np.maximum(np.abs(free[:, 0]), self.least[i])
        kernels.crossings(np.ascontiguousarray(free[:, 1]), drive, *self.tables[i], place, count)
        return place, count

    def _excess(self, log_u: Real) -> Real:
        u = np.abs(self.response(self.coefficients(log_u)))
        return np.asarray(log_u - np.log(np.maximum(u, self.least)))

    def jacobian(self, log_u: Real, excess: Real) -> Real:
        """Return d excess / d log|u|, shape (n, P, P)."""
        columns = [
            (self._excess(log_u + RULES.difference * e) - excess) / RULES.difference for e in np.eye(log_u.shape[1])
        ]
        return np.stack(columns, axis=-1)

    def _newton(
        self, log_u: Real, count: NDArray[np.int64], found: NDArray[np.bool_]
    ) -> tuple[Real, NDArray[np.int64], NDArray[np.bool_]]:
        excess = self._excess(log_u)
        for _ in range(RULES.newton_steps if log_u.shape[1] else 0):
            if np.abs(excess[found]).max(initial=0.0) < RULES.close:
                break
            slope = self.jacobian(log_u, excess)
            slope += 1e-12 * np.eye(slope.shape[1])
            step = np.clip(-np.linalg.solve(slope, excess[..., None])[..., 0], -0.5, 0.5)
            log_u, excess = self._halved(log_u, excess, step)
        return log_u, count, found & (np.abs(excess).max(axis=1, initial=0.0) < 1e-3)

    def _halved(self, log_u: Real, excess: Real, step: Real) -> tuple[Real, Real]:
        """Take of each step the largest half, quarter ... that brings the solution nearer."""
        best, size = log_u.copy(), np.abs(excess).max(axis=1)
        out, share = excess.copy(), np.ones(size.size)
        open_ = np.ones(size.size, dtype=bool)
        for _ in range(4):
            new = log_u + share[:, None] * step
            there = self._excess(new)
            better = open_ & (np.abs(there).max(axis=1) < size)
            best[better], out[better] = new[better], there[better]
            open_ &= ~better
            if not open_.any():
                break
            share = np.where(open_, 0.5 * share, share)
        return best, out


def _interpolated(x: Real, y: Complex, at: Real) -> Complex:
    """Monotone cubics; beyond the ends the ends are held."""
    inside = np.clip(at, x[0], x[-1])
    return np.asarray(PchipInterpolator(x, y.real)(inside) + 1j * PchipInterpolator(x, y.imag)(inside))


def _solved(admittance: Complex, c: Complex, right: Complex) -> Complex:
    """``(1 + A c)^-1 d`` for A (..., P, P), c and d (..., P)."""
    loop = np.eye(c.shape[-1]) + admittance * c[..., None, :]
    return np.asarray(np.linalg.solve(loop, right[..., None])[..., 0])


def _error(problem: _Problem, f: Real, g: Complex, u: Complex, c: Complex, x: Complex) -> Real:
    """Estimate the relative error that the neglected harmonics make.

    The harmonics 2..9 of the forces are let through the machine once, ``u_k = -(1 + A_k c)^-1 A_k f_k``; the change of
    the fundamental of the forces that they cause, seen at the tool, is the estimate; it is enlarged by the sensitivity
    of the amplitudes. At least it is the product of the distortion of the motion and the share of the distorting force
    in the response, which leads near rest.
    """
    network, t = problem.network, problem.network.directions
    if not network.elements:
        return np.zeros(f.size)
    u, x = np.nan_to_num(u), np.nan_to_num(x)
    grid, packed = network.grid(RULES.error_harmonics), network.packed()
    order = grid.orders
    first = int(np.argmax(order == 1))
    high = order > 1
    scale = np.where(network.displaced, 2.0 * np.pi * f[:, None], 1.0)
    motion = np.zeros((*u.shape, order.size), dtype=complex)
    motion[:, :, first] = u * scale
    before, after = np.empty_like(motion), np.empty_like(motion)
    kernels.element_forces(packed, 2.0 * np.pi * f, motion, grid, before)
    at = (f[:, None] * order[high]).ravel()
    a = network.admittance(at, network.matrix(at)[:, t:, t:]).reshape(f.size, int(high.sum()), *g[0, t:, t:].shape)
    push = np.einsum("nkpq,nqk->nkp", a, before[:, :, high])
    reply = -_solved(a, np.broadcast_to(c[:, None], push.shape), push)
    motion[:, :, high] = np.moveaxis(reply, 1, 2) * scale[:, :, None]
    kernels.element_forces(packed, 2.0 * np.pi * f, motion, grid, after)
    change = after[:, :, first] - before[:, :, first]
    shown = _at_tool(problem, g[:, :t, t:], c)
    size = np.maximum(np.linalg.norm(x, axis=1), 1e-300)
    once = np.linalg.norm(np.einsum("ntp,np->nt", shown, change), axis=1) * _sensitivity(problem, u) / size
    # Near rest the reply above is damped away by c; what the harmonics would do unhindered bounds the error there.
    free = np.linalg.norm(push, axis=1) / np.maximum(np.abs(u), problem.least)
    weight = np.linalg.norm(shown, axis=1) / size[:, None]
    bound = np.sum(free * weight * np.linalg.norm(before[:, :, high], axis=2), axis=1)
    return np.asarray(np.maximum(once, bound))


def _at_tool(problem: _Problem, tool: Complex, c: Complex) -> Complex:
    """Displacement of the tool for a unit of additional force at each element, the others answering: (n, T, P)."""
    elements = c.shape[1]
    loop = np.eye(elements) + problem.admittance * c[:, None, :]
    answer = np.eye(elements) - c[:, :, None] * np.linalg.solve(loop, problem.admittance)
    return np.asarray(tool @ answer)


def _sensitivity(problem: _Problem, u: Complex) -> Real:
    """Largest relative change of an amplitude for a relative change of a drive, at least 1."""
    log_u = np.log(np.maximum(np.abs(u), problem.least))
    slope = problem.jacobian(log_u, problem._excess(log_u))
    least = np.linalg.svd(slope, compute_uv=False)[:, -1]
    return np.asarray(1.0 / np.clip(least, 1e-6, 1.0))
