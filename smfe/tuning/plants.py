"""What a servo finds: the machine as one sees it from its drives, on a grid of frequencies, and with moved modes.

The tool compliance and the slides of the axes that are tuned obey::

    Phi = Phi_h + T (B + G)^-1 T'        G = diag(G_a),  G_a = Kp (1 + 1/(Ti s)) (s + Kv) e^(-s tau)

Phi_h is the compliance with the slides held, B the dynamic stiffness of the slides with their drives off, T how the
tool moves with a slide, T' what a held slide feels of a force on the tool. None of them knows a gain: gains by the
thousand cost a division each. A machine model gives them (`ModelSource`), and so do a compliance measured at rest and
the open loops of the axes (`MeasuredSource`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline

from process.errors import InputError
from process.labels import AXES
from process.machine.operating_point import OperatingPoint, SlideImpedance
from process.machine.structure import Structure
from process.types import Complex, Real
from smfe.tuning.rules import RULES
from stability.problem import complete_samples


@dataclass(frozen=True)
class Plant:
    """The machine between its drives and its tool, without the servos of the axes that are tuned.

    Parameters
    ----------
    axes : tuple of str
        The a axes that are tuned, in the order of all that follows.
    frequency : ndarray, shape (f,)
        [Hz], rising, above 0.
    held : ndarray of complex, shape (f, 3, 3)
        Tool compliance with these slides held [m/N].
    reach : ndarray of complex, shape (f, 3, a)
        Displacement of the tool a displacement of the slide [1].
    back : ndarray of complex, shape (f, a, 3)
        Force on a held slide a force on the tool [1].
    base : ndarray of complex, shape (f, a, a)
        Dynamic stiffness of the slides, drives off [N/m].
    delay : ndarray, shape (a,)
        Dead time from encoder to force [s].
    """

    axes: tuple[str, ...]
    frequency: Real
    held: Complex
    reach: Complex
    back: Complex
    base: Complex
    delay: Real

    @property
    def laplace(self) -> Complex:
        """``j w`` [rad/s], shape (f,)."""
        return np.asarray(2j * np.pi * self.frequency)

    @property
    def directions(self) -> tuple[int, ...]:
        """Directions (0 x, 1 y, 2 z) in which the tool gives way."""
        rows = (np.abs(self.held).max(axis=(0, 2)) > 0.0) | (np.abs(self.reach).max(axis=(0, 2)) > 0.0)
        return tuple(int(i) for i in np.flatnonzero(rows))


class Source(Protocol):
    """What gives plants: a machine model, or measurements."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes that are tuned."""

    @property
    def mass(self) -> Real:
        """All that moves with each axis [kg], shape (a,)."""

    @property
    def delay(self) -> tuple[float, ...]:
        """Dead time of each axis [s]."""

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies [Hz] within which the plant is known."""

    def modes(self) -> Real:
        """Return frequency [Hz] and damping ratio [1] of the modes, shape (m, 2)."""

    def plant(self, frequency: Real, change: float = 0.0) -> Plant:
        """Return the plant at frequencies [Hz] with all modes moved by a share, e.g. 0.1 or -0.1."""


@dataclass(frozen=True)
class ModelSource:
    """A machine model at the operating point of the cut.

    Parameters
    ----------
    point : OperatingPoint
        The linear machine; servos of the axes that are tuned do not count, those of other axes do.
    axes : tuple of str
        Axes that are tuned.
    delay : tuple of float
        Their dead times [s].
    """

    point: OperatingPoint
    axes: tuple[str, ...]
    delay: tuple[float, ...]

    @property
    def mass(self) -> Real:
        """All that moves with each axis [kg], shape (a,): what the drive has to push far below all modes."""
        low = 1e-2 * float(self.modes()[:, 0].min())
        free = tuple(replace(s, servo=None, friction=replace(s.friction, direct=0.0, residue=0.0)) for s in self._free)
        point = replace(self.point, slides=free)
        rows = np.array([point.structure.slides[a] for a in self.axes])
        pushed = 1.0 / np.einsum("fii->i", point.receptance(np.array([low]), rows)).real
        return np.asarray(-pushed / (2.0 * np.pi * low) ** 2)

    @property
    def band(self) -> tuple[float, float]:
        """A model is known everywhere."""
        return 0.0, math.inf

    @property
    def _free(self) -> tuple[SlideImpedance, ...]:
        return tuple(replace(s, servo=None) if s.name in self.axes else s for s in self.point.slides)

    def modes(self) -> Real:
        """Return frequency [Hz] and damping ratio [1] with the slides held, and with them free, shape (m, 2)."""
        return np.concatenate([_modes(self.point.structure.locked()), _modes(self.point.structure)])

    def plant(self, frequency: Real, change: float = 0.0) -> Plant:
        """Return the plant at frequencies [Hz]; masses and damping ratios stay where modes move.

        ``K -> (1 + change)^2 K``, ``C -> (1 + change) C`` of the structure.
        """
        bare = replace(self.point, structure=_scaled(self.point.structure, change), slides=self._free)
        rows = np.array([bare.structure.slides[a] for a in self.axes])
        both = bare.receptance(frequency, np.vstack([bare.structure.tool, rows]))
        base = np.linalg.inv(both[:, 3:, 3:])
        reach, back = both[:, :3, 3:] @ base, base @ both[:, 3:, :3]
        held = both[:, :3, :3] - reach @ both[:, 3:, :3]
        return Plant(self.axes, frequency, held, reach, np.asarray(back), np.asarray(base), np.array(self.delay))


@dataclass(frozen=True)
class MeasuredSource:
    """A compliance measured at rest and the measured open loops of the axes; no model is fitted.

    A tip of mass m_t on the held slide, all of mass M with it, gives (`process.machine.machine.released_compliance`)
    ``T = 1 + w^2 m_t Phi_h`` and ``B = -w^2 M - w^4 m_t^2 Phi_h``. The open loop of an axis replaces its B:
    ``B = e^(-s tau)/H``, with friction, gear and all else that the drive feels.

    Parameters
    ----------
    at_rest : xarray.Dataset
        Compliance of the tool at rest, responses and excitations on the same axes.
    open_loop : mapping
        Axis -> ``response`` [m/N] over ``frequency``, carriage position over *commanded* drive force, as
        `smfe.open_loop_response` returns it.
    moving_mass : mapping
        Axis -> all mass that moves with it [kg], tip included.
    tip_mass : float
        Mass at the tool [kg].
    dead_time : mapping
        Axis -> dead time within the open loop [s].

    Raises
    ------
    InputError
        When an axis lacks mass, open loop or direct compliance, or the bands do not overlap.
    """

    at_rest: xr.Dataset
    open_loop: Mapping[str, xr.Dataset]
    moving_mass: Mapping[str, float]
    tip_mass: float
    dead_time: Mapping[str, float]

    def __post_init__(self) -> None:
        """Refuse what does not make a plant."""
        if not self.open_loop:
            raise InputError("no open loop is given; give one for each axis that is tuned, open_loop={'x': ...}")
        samples = complete_samples(self.at_rest)
        for axis, one in self.open_loop.items():
            if axis not in AXES or not samples.matrix[:, AXES.index(axis), AXES.index(axis)].any():
                raise InputError(f"axis {axis} has an open loop, but its compliance at rest was not measured")
            if "response" not in one or "frequency" not in one.coords:
                raise InputError(
                    f"the open loop of axis {axis} has no 'response' over 'frequency'; give what open_loop_response "
                    "returns"
                )
            mass = self.moving_mass.get(axis)
            if mass is None or not self.tip_mass > 0.0 or not self.tip_mass < mass < math.inf:
                raise InputError(
                    f"axis {axis} has moving mass {mass} kg and tip mass {self.tip_mass:g} kg; from measured responses "
                    "both masses are needed, the moving mass above the tip mass (fit_open_loop finds them)"
                )
        low, high = self.band
        if not low < 0.5 * high:
            raise InputError(
                f"compliance at rest and open loops have {low:g} to {high:g} Hz in common; at least an octave is needed"
            )

    @property
    def axes(self) -> tuple[str, ...]:
        """Axes that are tuned."""
        return tuple(self.open_loop)

    @property
    def mass(self) -> Real:
        """All that moves with each axis [kg], shape (a,)."""
        return np.array([self.moving_mass[a] for a in self.axes])

    @property
    def delay(self) -> tuple[float, ...]:
        """Dead time of each axis [s]."""
        return tuple(self.dead_time.get(a, 0.0) for a in self.axes)

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies [Hz] that compliance and open loops have in common."""
        grids = [complete_samples(self.at_rest).frequency]
        grids += [one["frequency"].values for one in self.open_loop.values()]
        return max(float(g.min()) for g in grids), min(float(g.max()) for g in grids)

    def modes(self) -> Real:
        """Return the highest peaks of the compliance at rest and of the open loops, with a damping of 1 %, (m, 2)."""
        samples = complete_samples(self.at_rest)
        peaks = [float(samples.frequency[np.argmax(np.linalg.norm(samples.matrix, axis=(1, 2)))])]
        for one in self.open_loop.values():
            f = one["frequency"].values
            peaks.append(float(f[np.argmax(f**2 * np.abs(one["response"].values))]))
        return np.array([[f, 0.01] for f in peaks])

    def plant(self, frequency: Real, change: float = 0.0) -> Plant:
        """Return the plant at frequencies [Hz] within the band; modes are moved with masses and damping ratios kept.

        ``Phi_h(w) -> Phi_h(w/(1 + change))/(1 + change)^2``; B follows by ``w^4 m_t^2`` times the difference.
        """
        samples, w = complete_samples(self.at_rest), 2.0 * np.pi * frequency
        rows = [AXES.index(a) for a in self.axes]
        before = _interpolated(samples.frequency, samples.matrix, frequency)
        held = before
        if change != 0.0:
            held = _interpolated(samples.frequency, samples.matrix, frequency / (1.0 + change)) / (1.0 + change) ** 2
        tip = (w**2 * self.tip_mass)[:, None, None]
        whole = np.eye(3) + tip * held
        base = -(tip**2) * held[:, rows][:, :, rows]
        for i, axis in enumerate(self.axes):
            one = self.open_loop[axis]
            found = one["response"].values * np.exp(2j * np.pi * one["frequency"].values * self.delay[i])
            # w^2 H is flat where H is not.
            flat = _interpolated(one["frequency"].values, found * one["frequency"].values ** 2, frequency)
            moved = (w**4 * self.tip_mass**2) * (before - held)[:, rows[i], rows[i]]
            base[:, i, i] = frequency**2 / flat + moved
        return Plant(self.axes, frequency, held, whole[:, :, rows], whole[:, rows, :], base, np.array(self.delay))


def _interpolated(at: Real, values: Complex, frequency: Real) -> Complex:
    """Return complex samples at other frequencies [Hz]: a cubic; beyond either end the last value."""
    inside = np.clip(frequency, at[0], at[-1])
    return np.asarray(CubicSpline(at, values, axis=0)(inside))


def _scaled(structure: Structure, change: float) -> Structure:
    if change == 0.0:
        return structure
    share = 1.0 + change
    return Structure(
        structure.mass, share * structure.damping, share**2 * structure.stiffness, structure.tool, structure.slides
    )


def _modes(structure: Structure) -> Real:
    """Return frequency [Hz] and damping ratio [1] of the oscillating poles, shape (m, 2)."""
    n, inverse = structure.size, np.linalg.inv(structure.mass)
    a = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ structure.stiffness, -inverse @ structure.damping]])
    s = np.linalg.eigvals(a)
    s = s[(s.imag > 0.0) & (np.abs(s) > 1e-6 * np.abs(s).max(initial=0.0))]
    return np.stack([np.abs(s) / (2.0 * np.pi), -s.real / np.abs(s)], axis=1)


def grid_of(source: Source, fastest: float, points: int, extra: tuple[float, ...] = ()) -> Real:
    """Return frequencies [Hz] on which a plant shows its loops and lobes, dense about its modes.

    Parameters
    ----------
    source : Source
        Where the plant comes from.
    fastest : float
        Highest crossover of the gains that are tried [Hz].
    points : int
        About as many.
    extra : tuple of float
        Frequencies that must be among them [Hz].
    """
    modes, (low, high) = source.modes(), source.band
    first, last = RULES.lowest * modes[:, 0].min(), RULES.highest * max(modes[:, 0].max(), fastest)
    even = np.geomspace(max(first, low), min(last, high), points // 2)
    middle = np.geomspace(max(0.25 * modes[:, 0].min(), low), min(3.0 * modes[:, 0].max(), high), points // 4)
    near = max(4, points // (4 * len(modes)))
    offset = np.sinh(np.linspace(-4.0, 4.0, near)) / math.sinh(4.0)
    # At a mode without damping the compliance has no value: the points about it lie a little beside it.
    modes = np.column_stack([modes[:, 0] * np.where(np.abs(modes[:, 1]) < 1e-6, 1.0 + 1e-5, 1.0), modes[:, 1]])
    close = [f + max(0.15 * f, 20.0 * zeta * f) * offset for f, zeta in modes]
    close += [f * (1.0 + 0.1 * np.linspace(-1.0, 1.0, near)) for f, _ in modes]
    inside = np.concatenate([even, middle, *close])
    return np.unique(np.concatenate([inside[(inside >= low) & (inside <= high) & (inside > 0.0)], extra]))
