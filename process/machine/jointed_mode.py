"""One mode of a machine with a joint in it: frequency and damping over the level, forced response, free decay.

Near its resonance a jointed machine moves in one mode, ``m x'' + c x' + k x + f(x) = F``, with the joint's force f
across the modal displacement x. For a vibration of amplitude X the joint is its describing function ``K(X) + j H(X)``
(`process.machine.joints`), so that

``D(X, w) = k + K(X) - m w^2 + j (c w + H(X))``,  ``F = D X``,

the phase passes -90 degrees at ``w(X)^2 = (k + K)/m``, and the damping ratio there is ``c/(2 m w) + H/(2 m w^2)``.
Of a free decay amplitude and phase drift slowly (first order of averaging, right to 2 zeta): ``X' = -w zeta X``,
``phi' = w``.

Sources: W. D. Iwan, A distributed-element model for hysteresis and its steady-state dynamic response, J. Appl. Mech. 33
(1966) 893-900; D. J. Segalman, M. S. Allen, M. Eriten, K. Hoppman, Experimental assessment of joint-like modal models
for structures, IDETC 2015.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from process.errors import InputError
from process.machine.joints import Joint
from process.types import Complex, Real

_PER_DECADE = 200
"""Amplitudes a decade at which decays and forced responses are tabulated."""

_DOUBLINGS = 40
"""Doublings of the amplitude after which a mode without damping is no longer searched."""

_HALVINGS = 40
"""Halvings of an interval of amplitudes in which a forced response lies."""


@dataclass(frozen=True)
class JointedMode:
    """A mode with a joint across its displacement.

    Parameters
    ----------
    mass : float
        Modal mass m [kg].
    stiffness : float
        Modal stiffness k beside the joint [N/m]; may be zero.
    damping : float
        Viscous damping c beside the joint [N s/m].
    joint : Joint
        Any of `process.machine.joints` with a stiffness and a loss stiffness over the amplitude.

    Raises
    ------
    InputError
        For a mass that is not positive, or a negative stiffness or damping.
    """

    mass: float
    stiffness: float
    damping: float
    joint: Joint

    def __post_init__(self) -> None:
        """Refuse a mode that cannot vibrate."""
        if not (0.0 < self.mass < math.inf and 0.0 <= self.stiffness < math.inf and 0.0 <= self.damping < math.inf):
            raise InputError(
                f"a mode of {self.mass:g} kg, {self.stiffness:g} N/m and {self.damping:g} N s/m; the mass must be "
                "positive, stiffness and damping zero or positive"
            )

    def backbone(self, amplitude: ArrayLike) -> tuple[Real, Real]:
        """Return the frequency [Hz] and the damping ratio at amplitudes [m] of any shape."""
        w, rate = self._flow(np.asarray(amplitude, dtype=float))
        return w / (2.0 * np.pi), rate / w

    def force(self, amplitude: ArrayLike, frequency: ArrayLike) -> Complex:
        """Return the complex force [N] for the displacement ``X cos(w t)``: X [m] and Hz broadcast together."""
        x, w = np.asarray(amplitude, dtype=float), 2.0 * np.pi * np.asarray(frequency, dtype=float)
        joint = self.joint.equivalent_stiffness(x) + 1j * self.joint.loss_stiffness(x)
        return np.asarray(x * (self.stiffness + joint - self.mass * w**2 + 1j * self.damping * w))

    def response(self, force: ArrayLike, frequency: ArrayLike) -> tuple[Real, Real]:
        """Return the smallest and the largest amplitude [m] that a sine force can keep up, each shape (n,).

        They differ only where the response jumps. Force [N] and frequency [Hz] broadcast together to shape (n,).
        """
        p, f = np.broadcast_arrays(np.atleast_1d(np.asarray(force, dtype=float)), np.asarray(frequency, dtype=float))
        if not (np.all((p > 0.0) & (f > 0.0)) and np.all(np.isfinite(p)) and np.all(np.isfinite(f))):
            raise InputError(f"forces from {p.min():g} N at {f.min():g} Hz and above; both must be positive")
        low, high = self._reach(p, f)
        grid = np.geomspace(low, high, 2 + math.ceil(_PER_DECADE * math.log10(high / low)))
        excess = np.abs(self.force(grid, f[:, None])) - p[:, None]
        rises = (excess[:, :-1] < 0.0) & (excess[:, 1:] >= 0.0)
        if not rises.any(axis=1).all():
            raise InputError(f"no amplitude from {low:.3g} to {high:.3g} m balances a force of {p.max():g} N")
        first = np.argmax(rises, axis=1)
        last = rises.shape[1] - 1 - np.argmax(rises[:, ::-1], axis=1)
        return self._between(grid, first, p, f), self._between(grid, last, p, f)

    def decay(self, start: float, time: ArrayLike) -> tuple[Real, Real]:
        """Return amplitude [m] and phase [rad] of a free decay at times [s], shape (n,), from an amplitude [m] at 0."""
        t = np.asarray(time, dtype=float)
        if not (start > 0.0 and np.all(t >= 0.0)):
            raise InputError(f"a decay from {start:g} m at {t.min(initial=0.0):g} s; give an amplitude > 0, times >= 0")
        decades = 1.0
        while True:
            fall = np.linspace(0.0, decades * math.log(10.0), 1 + math.ceil(_PER_DECADE * decades))
            w, rate = self._flow(start * np.exp(-fall))
            if np.any(rate <= 0.0):
                raise InputError("the mode does not decay at some amplitude; give it damping")
            step = np.diff(fall)
            # Simpson's rule would need middles: on this grid trapezoids are right to 1e-5.
            passed, turned = (np.append(0.0, np.cumsum(0.5 * step * (y[1:] + y[:-1]))) for y in (1.0 / rate, w / rate))
            if passed[-1] >= t.max(initial=0.0):
                at = np.interp(t, passed, fall)
                return start * np.exp(-at), np.interp(at, fall, turned)
            decades *= 2.0
            if decades > 300.0:
                raise InputError(f"the decay does not last {t.max():g} s in numbers of double precision; ask for less")

    def _flow(self, amplitude: Real) -> tuple[Real, Real]:
        """Angular frequency and rate of decay [1/s] at amplitudes [m]."""
        stiffness = self.stiffness + self.joint.equivalent_stiffness(amplitude)
        if np.any(stiffness <= 0.0):
            raise InputError("the mode has no stiffness at some amplitude; give it stiffness beside the joint")
        w = np.sqrt(stiffness / self.mass)
        return w, 0.5 * (self.damping + self.joint.loss_stiffness(amplitude) / w) / self.mass

    def _reach(self, force: Real, f: Real) -> tuple[float, float]:
        """Amplitudes [m] between which the response lies."""
        low = high = float(force.min()) / self.mass / float(np.max(2.0 * np.pi * f)) ** 2
        for _ in range(400):
            if np.all(np.abs(self.force(low, f)) < force):
                break
            low /= 2.0
        # Beyond, damping alone takes more than the force: no amplitude is left there.
        for _ in range(_DOUBLINGS):
            if np.all(self.force(high, f).imag >= force):
                break
            high *= 2.0
        return low, 2.0 * high

    def _between(self, grid: Real, place: NDArray[np.int64], force: Real, f: Real) -> Real:
        """Halve intervals of the grid, one a frequency, in which the balance lies."""
        low, high = grid[place], grid[place + 1]
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            under = np.abs(self.force(middle, f)) < force
            low, high = np.where(under, middle, low), np.where(under, high, middle)
        return np.asarray(0.5 * (low + high))
