"""The cut at one spindle speed as dense matrices: all eigenvalues of a small problem in one call of the library."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from process.types import Complex, Real
from stability.methods import _floquet_kernels as kernels


@dataclass(frozen=True)
class Dense:
    """One period: chips ``x = G f + S z``, state ``z <- turn z + H f``, ``f = depth (K x - W x_before)``.

    Parameters
    ----------
    response : ndarray, shape (m, m)
        G, what the chips of one period do within it, from rest.
    free, gained : ndarray of complex, shapes (m, N), (N, m)
        S and H in modal coordinates.
    turn : ndarray of complex, shape (N,)
        What a period makes of the modal coordinates.
    kept, wrapped : ndarray, shape (m, m)
        K, chips less the surface left in the same period; W, the surface left in the period before.
    """

    response: Real
    free: Complex
    gained: Complex
    turn: Complex
    kept: Real
    wrapped: Real

    @cached_property
    def period(self) -> kernels.Period:
        """The products of these matrices of which everything at one spindle speed is made."""
        own, lagged = self.response @ self.kept, self.response @ self.wrapped
        driven, left = self.gained @ self.kept, self.gained @ self.wrapped
        return kernels.Period(own.astype(complex), lagged.astype(complex), self.free, driven, left, self.turn)

    def crossing(self, angles: Real) -> Complex:
        """Return matrices (angles, m, m) with eigenvalues 1/depth [1/m] when ``exp(j angle)`` is a multiplier."""
        p = self.period
        multiplier = np.where(angles < math.pi, np.exp(1j * angles), -1.0 + 0.0j)[:, None, None]
        state = (p.free / (multiplier - self.turn)) @ (p.driven - p.left / multiplier)
        return np.asarray(p.own - p.lagged / multiplier + state)

    def crossing_values(self, angles: Real) -> Complex:
        """Return the eigenvalues 1/depth [1/m], shape (angles, m)."""
        return np.asarray(np.linalg.eigvals(self.crossing(angles)))

    def chips(self, angle: float, depth: float) -> Complex:
        """Return the chips of the vibration at a crossing, shape (m,), by inverse iteration."""
        matrix = self.crossing(np.array([angle]))[0] - (1.0 + 1e-10) / depth * np.eye(self.response.shape[0])
        vector = np.exp(1j * np.arange(matrix.shape[0]) ** 2)
        for _ in range(3):
            vector = np.linalg.solve(matrix, vector)
            vector /= np.linalg.norm(vector)
        return np.asarray(vector)

    def multipliers(self, depths: Real) -> Complex:
        """Return the Floquet multipliers at depths [m], shape (depths, N + m), in real arithmetic."""
        maps = np.array([kernels.period_map(self.period, float(depth)) for depth in depths])
        return np.asarray(np.linalg.eigvals(maps), dtype=complex)


def dense(system: kernels.System) -> Dense:
    """Return the dense matrices of a cut."""
    response, free, gained, left, wrapped = kernels.crossing_parts(system)
    return Dense(response.real, free, gained, system.turn, np.eye(system.source.size) - left.real, wrapped.real)
