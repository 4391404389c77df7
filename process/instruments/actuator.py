"""A moving coil that excites a machine: what of a command arrives at the tool, and what the coil does to the machine.

The magnet is fixed to the tool, the coil hangs in it on a spring and a damper, and the force between both is commanded.
The coil is linear: what acts on the tool is the force that a rigid floor would feel, and that of a passive mass on
the same spring which the tool shakes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal
from scipy.interpolate import CubicSpline

from process.errors import InputError
from process.labels import axis_index
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from process.machine.structure import Posture, Structure, free_modes
from process.simulation.excitation import Excitation
from process.types import Complex, Real

_POINTS = 64
"""Points of the force in the shortest event of what is commanded."""

_DECAY = 12.0
"""Time constants of the coil after which it rests."""


@dataclass(frozen=True)
class MovingCoil:
    """A moving coil on a spring, driven by a current.

    On a rigid floor the force over the commanded one is ``s^2/(s^2 + 2 zeta w_0 s + w_0^2) w_b/(s + w_b)``: flat
    between the resonance of the coil and the bandwidth of its current.

    Parameters
    ----------
    mass : float
        Of the coil [kg].
    frequency : float
        Natural frequency of the coil on its spring [Hz], ``w_0/(2 pi)``.
    damping : float
        Damping ratio of the coil [1].
    bandwidth : float, optional
        Of the current loop [Hz], a lag of first order.
    housing : float, optional
        Mass that is fixed to the tool between the force sensor and the spring [kg].
    """

    mass: float
    frequency: float
    damping: float
    bandwidth: float = math.inf
    housing: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what does not swing."""
        positive = (self.mass, self.frequency, self.damping)
        if not (all(0.0 < v < math.inf for v in positive) and self.bandwidth > 0.0 and 0.0 <= self.housing < math.inf):
            raise InputError(
                f"a coil of {self.mass:g} kg at {self.frequency:g} Hz with a damping ratio of {self.damping:g}, a "
                f"bandwidth of {self.bandwidth:g} Hz and a housing of {self.housing:g} kg; all must be positive, the "
                "housing may be zero"
            )

    @property
    def _coil(self) -> tuple[float, float, float]:
        """Mass, damping and stiffness of the coil."""
        w = 2.0 * math.pi * self.frequency
        return self.mass, 2.0 * self.damping * w * self.mass, self.mass * w**2

    def transfer(self, frequency: ArrayLike) -> Complex:
        """Return the force on a rigid floor over the commanded force [1] at frequencies [Hz]."""
        s = 2j * np.pi * np.asarray(frequency, dtype=float)
        m, c, k = self._coil
        lag = 1.0 if math.isinf(self.bandwidth) else 1.0 + s / (2.0 * np.pi * self.bandwidth)
        return np.asarray(m * s**2 / (m * s**2 + c * s + k) / lag)

    def on_floor(self, commanded: Excitation) -> OnFloor:
        """Return the force that a rigid floor feels under a commanded force."""
        return OnFloor(self, commanded)

    def mounted(self, machine: Machine | ModalModel, axis: str) -> Machine:
        """Return the machine that carries the coil along an axis, and its housing; no current flows."""
        row = axis_index([axis])[0]
        m, c, k = self._coil

        def carrying(structure: Structure) -> Structure:
            pull = np.append(-structure.tool[row], 1.0)
            on_tool = structure.tool.T @ structure.tool * self.housing

            def more(matrix: Real, added: float) -> Real:
                return np.pad(matrix, (0, 1)) + added * np.outer(pull, pull)

            mass = np.pad(structure.mass + on_tool, (0, 1))
            mass[-1, -1] = m
            return Structure(
                mass,
                more(structure.damping, c),
                more(structure.stiffness, k),
                np.pad(structure.tool, ((0, 0), (0, 1))),
                {name: np.append(slide, 0.0) for name, slide in structure.slides.items()},
            )

        if isinstance(machine, ModalModel):
            modes = free_modes(machine.frequency, machine.damping, machine.mass, machine.direction, {})
            return Machine(carrying(modes))
        joints = tuple(replace(j, participation=np.append(j.participation, 0.0)) for j in machine.joints)
        whole = machine.structure
        if isinstance(whole, Posture):
            whole = replace(whole, structures=tuple(map(carrying, whole.structures)))
        else:
            whole = carrying(whole)
        return Machine(whole, machine.axes, joints)

    def reaction(self, acceleration: Real, rate: float) -> Real:
        """Return the force of the passive coil and of the housing on the tool [N].

        Parameters
        ----------
        acceleration : ndarray, shape (n,)
            Of the tool along the axis of the coil [m/s2], from rest.
        rate : float
            Samples a second [Hz].
        """
        m, c, k = self._coil
        shaken = _filtered(np.array([-m * c, -m * k]), np.array([m, c, k]), 1.0 / rate, acceleration)
        return shaken - self.housing * acceleration


def _filtered(above: Real, below: Real, step: float, signal_in: Real) -> Real:
    """Return a signal, straight between its samples a step [s] apart, behind a transfer function of s."""
    upper, lower, _ = signal.cont2discrete((above, below), step, method="foh")
    return np.asarray(signal.lfilter(np.ravel(upper), lower, signal_in))


@dataclass(frozen=True)
class OnFloor(Excitation):
    """The force of a moving coil on a rigid floor.

    Parameters
    ----------
    coil : MovingCoil
        The actuator.
    commanded : Excitation
        Force that is commanded, without jumps.
    """

    coil: MovingCoil
    commanded: Excitation

    def __post_init__(self) -> None:
        """Refuse a command that jumps."""
        if self.commanded.jumps()[0].size:
            raise InputError("a binary sequence jumps, which no coil follows; give it a sine, a sweep or a multisine")

    @cached_property
    def _force(self) -> CubicSpline:
        step = self.shortest / _POINTS
        time: Real = step * np.arange(math.ceil(self.end / step) + 2.0)
        m, c, k = self.coil._coil
        above, below = np.array([m, 0.0, 0.0]), np.array([m, c, k])
        if not math.isinf(self.coil.bandwidth):
            below = np.polymul(below, [1.0 / (2.0 * math.pi * self.coil.bandwidth), 1.0])
        return CubicSpline(time, _filtered(above, below, step, self.commanded.force(time)))

    def force(self, time: Real) -> Real:
        """Return the force [N] at times [s]."""
        t = np.asarray(time, dtype=float)
        return np.where((t >= 0.0) & (t <= self.end), self._force(np.clip(t, 0.0, self.end)), 0.0)

    @property
    def shortest(self) -> float:
        """Shortest event of the command [s]."""
        return self.commanded.shortest

    @property
    def end(self) -> float:
        """When the coil rests again [s]."""
        return self.commanded.end + _DECAY / (self.coil.damping * 2.0 * math.pi * self.coil.frequency)
