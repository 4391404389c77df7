"""The cut at one spindle speed as dense matrices: all eigenvalues of a small problem in one call of the library."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from process.types import Complex, Real
from stability.methods import _semi_discretization_kernels as kernels


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

    def crossing(self, angles: Real) -> Complex:
        """Return matrices (angles, m, m) with eigenvalues 1/depth [1/m] when ``exp(j angle)`` is a multiplier."""
        multiplier = np.where(angles < math.pi, np.exp(1j * angles), -1.0 + 0.0j)[:, None, None]
        chips = self.response + (self.free / (multiplier - self.turn)) @ self.gained
        return np.asarray(chips @ (self.kept - self.wrapped / multiplier))

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
        size, half = self.response.shape[0], self.turn.imag > 0.0
        single = np.flatnonzero(self.turn.imag == 0.0)
        pairs = np.flatnonzero(half)
        states = single.size + 2 * pairs.size
        turn = np.zeros((states, states))
        turn[: single.size, : single.size] = np.diag(self.turn[single].real)
        first, second = single.size + np.arange(pairs.size), single.size + pairs.size + np.arange(pairs.size)
        turn[first, first] = turn[second, second] = self.turn[pairs].real
        turn[first, second], turn[second, first] = -self.turn[pairs].imag, self.turn[pairs].imag
        moved = self.free[:, pairs]
        free = np.hstack([self.free[:, single].real, 2.0 * moved.real, -2.0 * moved.imag])
        driven = self.gained[pairs]
        gained = np.vstack([self.gained[single].real, driven.real, driven.imag])
        depth = depths[:, None, None]
        left = np.eye(size) - depth * (self.response @ self.kept)
        none = np.zeros((depths.size, size, states))
        right = np.concatenate([none + free, -depth * (self.response @ self.wrapped)], axis=2)
        chips = np.linalg.solve(left, right)
        force = depth * (self.kept @ chips - np.hstack([np.zeros((size, states)), self.wrapped]))
        state = np.hstack([turn, np.zeros((states, size))]) + gained @ force
        return np.asarray(np.linalg.eigvals(np.concatenate([state, chips], axis=1)), dtype=complex)


def dense(system: kernels.System) -> Dense:
    """Return the dense matrices of a cut."""
    response, free, gained, left, wrapped = kernels.crossing_parts(system)
    return Dense(response.real, free, gained, system.turn, np.eye(system.source.size) - left.real, wrapped.real)
