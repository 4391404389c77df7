"""A machine of several axes in one object: structure, a drive and a guideway an axis, joints.

`Machine.at` linearises it at a feed, a controller and a position; the operating point gives compliance, poles and state
space. `simulation.machine` moves it in time, `harmonic_balance.quasi_frf` gives its response at a force level.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import FrictionLaw, MemoryLaw, Viscous
from process.friction.linearised import linearised
from process.labels import axis_index, check_compliance, make_compliance
from process.machine.joints import Joint
from process.machine.operating_point import OperatingPoint, SlideImpedance
from process.machine.structure import Posture, Structure, two_mass_axes
from process.types import Complex, Real
from process.units import check_feed

FEW_MICROSLIP = 1e-12
"""Amplitude [m] at which a joint has its small-signal stiffness."""


@dataclass(frozen=True)
class FeedAxis:
    """Drive and friction of one slide.

    Parameters
    ----------
    servo : Servo, mapping of str to Servo, or None
        One controller, or several by name; None: the slide is free.
    friction : FrictionLaw or MemoryLaw, optional
        Of guideway and drive together.
    """

    servo: Servo | Mapping[str, Servo] | None = None
    friction: FrictionLaw | MemoryLaw = field(default_factory=lambda: Viscous(0.0))

    def __post_init__(self) -> None:
        """Refuse other types than friction laws and controllers."""
        if not isinstance(self.friction, FrictionLaw | MemoryLaw):
            raise InputError(
                f"the friction is a {type(self.friction).__name__}; give a friction law, e.g. Viscous(0.0)"
            )
        if isinstance(self.servo, Mapping) and not self.servo:
            raise InputError("no controller is given; name at least one, or give servo=None for a free slide")

    def controller(self, name: str | None) -> Servo | None:
        """Return the controller of that name; a single one needs no name."""
        if not isinstance(self.servo, Mapping):
            return self.servo
        if name is None and len(self.servo) == 1:
            return next(iter(self.servo.values()))
        if name is None or name not in self.servo:
            raise InputError(f"controller {name!r} is none of {', '.join(self.servo)}; name one of them")
        return self.servo[name]


@dataclass(frozen=True)
class MountedJoint:
    """A joint within the structure: it resists the displacement ``participation . q``.

    Parameters
    ----------
    joint : Joint
        The law; its stiffness is not part of the structure's stiffness matrix.
    participation : array_like, shape (n,)
        Relative displacement across the joint for a unit of each coordinate.
    """

    joint: Joint
    participation: Real

    def __post_init__(self) -> None:
        """Store a plain float array."""
        object.__setattr__(self, "participation", np.asarray(self.participation, dtype=float).reshape(-1))


@dataclass(frozen=True)
class Machine:
    """Structure, feed axes and joints.

    Parameters
    ----------
    structure : Structure or Posture
        What bends and moves; a posture when that depends on the position of an axis.
    axes : mapping
        Axis name -> `FeedAxis`, for the slides of the structure. A slide that is not named is free and frictionless.
    joints : sequence of MountedJoint, optional
        Non-linear joints.

    Raises
    ------
    InputError
        When an axis has no slide, or a joint's participation does not fit.
    """

    structure: Structure | Posture
    axes: Mapping[str, FeedAxis] = field(default_factory=dict)
    joints: Sequence[MountedJoint] = ()

    def __post_init__(self) -> None:
        """Refuse axes without a slide and joints that do not fit; free slides get an axis of their own."""
        one = self.structure.structures[0] if isinstance(self.structure, Posture) else self.structure
        unknown = [a for a in self.axes if a not in one.slides]
        if unknown:
            raise InputError(
                f"axis {', '.join(unknown)} has no slide in the structure, which has "
                f"{', '.join(one.slides) or 'none'}; name the axes that the structure moves along"
            )
        for mounted in self.joints:
            if mounted.participation.size != one.size:
                raise InputError(
                    f"a joint has {mounted.participation.size} participations; the structure has {one.size} coordinates"
                )
        object.__setattr__(self, "axes", {a: self.axes.get(a, FeedAxis()) for a in one.slides})
        object.__setattr__(self, "joints", tuple(self.joints))

    @classmethod
    def of_axis(cls, drive: Drive, friction: FrictionLaw | MemoryLaw | None = None, axis: str = "x") -> Machine:
        """Return the machine of one feed axis: carriage, tip and servo of a drive, and the friction of its guideway.

        Parameters
        ----------
        drive : Drive
            Masses, joint and servo.
        friction : FrictionLaw or MemoryLaw, optional
            Of the carriage; default viscous with the drive's own sigma.
        axis : {"x", "y", "z"}, optional
            Name of the axis.

        Raises
        ------
        InputError
            When the drive has a sigma and a law is given too.
        """
        if friction is None:
            friction = Viscous(drive.sigma)
        elif drive.sigma != 0.0:
            raise InputError(
                f"the drive has sigma {drive.sigma:g} N s/m and a friction law is given: friction would count twice; "
                "put the viscous part into the law and leave sigma 0"
            )
        return cls(two_mass_axes({axis: replace(drive, sigma=0.0)}), {axis: FeedAxis(drive.servo, friction)})

    def braked(self, axes: Collection[str] | None = None) -> Machine:
        """Return the machine whose brakes hold the slides of some axes, by default all: drives and friction do nothing.

        Raises
        ------
        InputError
            When it has no such axis, or nothing can move then.
        """
        held = list(self.axes) if axes is None else list(axes)
        unknown = [a for a in held if a not in self.axes]
        if unknown:
            raise InputError(
                f"brakes hold axis {', '.join(unknown)}, and this machine moves along {', '.join(self.axes) or 'none'}"
            )
        if not held:
            return self
        every = self.structure.structures if isinstance(self.structure, Posture) else (self.structure,)
        free = every[0].held_directions(held)
        structures = tuple(one.locked(held) for one in every)
        return Machine(
            replace(self.structure, structures=structures) if isinstance(self.structure, Posture) else structures[0],
            {name: axis for name, axis in self.axes.items() if name not in held},
            tuple(replace(joint, participation=joint.participation @ free) for joint in self.joints),
        )

    def structure_at(self, position: float | None = None) -> Structure:
        """Return the structure at a position [m] of the axis that the posture depends on."""
        if not isinstance(self.structure, Posture):
            return self.structure
        if position is None:
            p = self.structure.positions
            raise InputError(
                f"the structure depends on the position of axis {self.structure.axis}; give one between "
                f"{p[0] * 1e3:g} and {p[-1] * 1e3:g} mm"
            )
        return self.structure.at(position)

    def servos(self, controller: str | None = None) -> list[Servo | None]:
        """Return the servo of each axis under a controller's name."""
        return [axis.controller(controller) for axis in self.axes.values()]

    def feeds(self, feed: float | Mapping[str, float]) -> dict[str, float]:
        """Return the feed of each axis [m/s]; a plain value moves all axes, an axis not named stands still."""
        if not np.all(np.isfinite(list(feed.values()) if isinstance(feed, Mapping) else feed)):
            raise InputError(f"feed {feed} m/s; give finite ones")
        for one in feed.values() if isinstance(feed, Mapping) else (feed,):
            check_feed(one)
        if not isinstance(feed, Mapping):
            return dict.fromkeys(self.axes, float(feed))
        unknown = [a for a in feed if a not in self.axes]
        if unknown:
            raise InputError(f"feed of axis {', '.join(unknown)}; this machine moves {', '.join(self.axes) or 'none'}")
        return {a: float(feed.get(a, 0.0)) for a in self.axes}

    def at(
        self,
        feed: float | Mapping[str, float] = 0.0,
        controller: str | None = None,
        position: float | None = None,
    ) -> OperatingPoint:
        """Linearise for small vibration.

        Parameters
        ----------
        feed : float or mapping, optional
            Feed of all axes, or axis name -> feed [m/s]; zero is idle.
        controller : str, optional
            Name of the controllers; not needed where each axis has one.
        position : float, optional
            Position [m] of the axis that a posture depends on.

        Returns
        -------
        OperatingPoint
            Local friction slope, joints at small amplitude, servo.
        """
        feeds = self.feeds(feed)
        slides = [
            SlideImpedance(name, servo, linearised(axis.friction, feeds[name]))
            for (name, axis), servo in zip(self.axes.items(), self.servos(controller), strict=True)
        ]
        return OperatingPoint(self._with_joints(self.structure_at(position)), tuple(slides))

    def _with_joints(self, structure: Structure) -> Structure:
        """Return the structure with the small-signal stiffness of its joints."""
        if not self.joints:
            return structure
        added = sum(
            np.outer(m.participation, m.participation) * float(m.joint.equivalent_stiffness(FEW_MICROSLIP))
            for m in self.joints
        )
        return Structure(
            structure.mass, structure.damping, structure.stiffness + added, structure.tool, structure.slides
        )

    def idle_compliance(self, frequency: ArrayLike, position: float | None = None) -> Complex:
        """Return the tool compliance [m/N], shape (f, 3, 3), with every slide held, at frequencies [Hz]."""
        return OperatingPoint(self._with_joints(self.structure_at(position)).locked(), ()).matrix(frequency)


# --- From a compliance measured at rest to the one in motion, without a modal fit.


def released_compliance(
    idle: xr.Dataset,
    axes: Mapping[str, FeedAxis],
    moving_mass: Mapping[str, float],
    tip_mass: float,
    feed: float | Mapping[str, float] = 0.0,
    controller: str | None = None,
) -> xr.Dataset:
    """Return the compliance in motion that belongs to a compliance measured at rest.

    Parameters
    ----------
    idle : xarray.Dataset
        Measured ``compliance(frequency, response, excitation)`` at rest, responses and excitations on the same axes,
        the driven ones among them.
    axes : mapping
        Axis name -> servo and friction.
    moving_mass : mapping
        Axis name -> all mass that moves with the axis [kg], tip included.
    tip_mass : float
        Mass at the tool [kg]; of a two-mass axis ``M (1 - (f_antiresonance/f_resonance)^2)`` of its open loop.
    feed : float or mapping, optional
        Feed of all axes, or axis name -> feed [m/s].
    controller : str, optional
        Name of the controllers.

    Returns
    -------
    xarray.Dataset
        Compliance on the same frequencies and axes; an uncertainty is not carried over.

    Raises
    ------
    InputError
        When an axis was not measured or is fed but not named, a mass is missing or not positive, or 0 Hz is among the
        frequencies.
    """
    array = check_compliance(idle)["compliance"].transpose("frequency", "response", "excitation")
    names = [str(a) for a in array["response"].values]
    if names != [str(a) for a in array["excitation"].values]:
        raise InputError(
            f"responses {', '.join(names)} and excitations differ; a full matrix on the same axes is needed"
        )
    _check_axes(names, axes, moving_mass, tip_mass)
    feeds = _feeds(axes, feed)
    f = idle["frequency"].values
    if f[0] <= 0.0:
        raise InputError("the idle compliance holds 0 Hz, where a servo's integrator has no limit; leave it out")
    w = 2.0 * np.pi * f
    phi = array.values
    columns = [names.index(a) for a in axes]
    identity = np.eye(len(names))
    t = (identity + (w**2 * tip_mass)[:, None, None] * phi)[:, :, columns]
    base = _base_stiffness(w, axes, moving_mass, feeds, controller)
    base = base - (w**4 * tip_mass**2)[:, None, None] * phi[:, columns][:, :, columns]
    # T^T with the transposed Phi: what is measured need not be reciprocal to the last digit.
    back = (identity + (w**2 * tip_mass)[:, None, None] * phi)[:, columns, :]
    moving = phi + t @ np.linalg.solve(base, back)
    return make_compliance(f, moving, names, names, attrs=dict(idle.attrs))


def _check_axes(
    names: list[str], axes: Mapping[str, FeedAxis], moving_mass: Mapping[str, float], tip_mass: float
) -> None:
    axis_index(list(axes))
    for axis in axes:
        if axis not in names:
            raise InputError(f"axis {axis} moves but was not measured; the compliance has {', '.join(names)}")
        if axis not in moving_mass or not tip_mass < moving_mass[axis] < math.inf:
            raise InputError(
                f"axis {axis} has moving mass {moving_mass.get(axis)} kg; give all that moves with it, more than the "
                f"tip mass of {tip_mass:g} kg"
            )
    if not tip_mass > 0.0:
        raise InputError(f"the tip mass is {tip_mass:g} kg; it must be positive")


def _feeds(axes: Mapping[str, FeedAxis], feed: float | Mapping[str, float]) -> dict[str, float]:
    """Return the feed of each axis [m/s]; a plain value moves all."""
    given = feed if isinstance(feed, Mapping) else dict.fromkeys(axes, feed)
    unknown = [a for a in given if a not in axes]
    if unknown or not all(math.isfinite(v) for v in given.values()):
        raise InputError(f"feed {dict(given)} m/s; finite numbers are needed, for the axes {', '.join(axes)}")
    return {a: float(given.get(a, 0.0)) for a in axes}


def _base_stiffness(
    w: Real,
    axes: Mapping[str, FeedAxis],
    moving_mass: Mapping[str, float],
    feeds: Mapping[str, float],
    controller: str | None,
) -> Complex:
    """``G + j w f' - w^2 M`` of each slide, shape (f, axes, axes), diagonal."""
    out = np.zeros((w.size, len(axes), len(axes)), dtype=np.complex128)
    for i, (name, axis) in enumerate(axes.items()):
        slide = SlideImpedance(name, axis.controller(controller), linearised(axis.friction, feeds[name]))
        out[:, i, i] = slide.stiffness(np.asarray(1j * w)) - w**2 * moving_mass[name]
    return out
