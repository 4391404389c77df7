"""The run of a machine in a time simulation: its arguments, resolved and checked against the machine."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import FrictionLaw, MemoryLaw
from process.labels import AXES, axis_index
from process.machine.machine import Machine
from process.machine.structure import Posture, Structure
from process.simulation.excitation import Excitation
from process.simulation.milling import MillingCut, Spindle
from process.simulation.rules import RULES


@dataclass(frozen=True)
class SampledControl:
    """Servos that read their encoders and set their forces every period, as in `process.drive.sampled_servo`.

    Parameters
    ----------
    period : float
        Sampling period T [s].
    lag : int, optional
        Whole periods from reading to force.
    encoder_resolution : float, optional
        Step of the encoder [m]: position is rounded to it, velocity is the difference of two readings. Zero: both are
        read exactly.
    """

    period: float
    lag: int = 1
    encoder_resolution: float = 0.0

    def __post_init__(self) -> None:
        """Refuse a period, lag or resolution that is not possible."""
        if not (0.0 < self.period < math.inf and self.lag >= 0 and 0.0 <= self.encoder_resolution < math.inf):
            raise InputError(
                f"sampling with period {self.period:g} s, lag {self.lag} and encoder steps of "
                f"{self.encoder_resolution:g} m; give a positive period and the others not negative"
            )


class SlideFriction(NamedTuple):
    """Friction of one slide in steady motion: law, feed [m/s], force [N], and slopes [N s/m].

    `slope` belongs to the linear part: the local one where it slides, else that far up; `fast`: far up, both ways.
    """

    law: FrictionLaw | MemoryLaw
    feed: float
    steady: float
    slope: float
    fast: tuple[float, float]

    @property
    def nonlinear(self) -> bool:
        """Whether the law is more than viscous."""
        return isinstance(self.law, MemoryLaw) or self.law.packed()[0] != 0


def _slide_friction(law: FrictionLaw | MemoryLaw, feed: float) -> SlideFriction:
    if isinstance(law, MemoryLaw):
        sides = law.towards(RULES.fast).sigma, law.towards(-RULES.fast).sigma
        return SlideFriction(law, feed, float(law.steady_force(feed)), min(sides), sides)
    local, rest, up, down = (float(v) for v in law.slope(np.array([feed, 0.0, RULES.fast, -RULES.fast])))
    if not (math.isfinite(local) and math.isfinite(rest)):
        raise InputError(
            "the friction law jumps at rest (kt is infinite); a time simulation needs a finite kt, e.g. 15000 s/m"
        )
    fast = min(up, down)
    slope = local if feed != 0.0 and local <= max(fast, 0.0) else fast
    return SlideFriction(law, feed, float(law.force(feed)), slope, (up, down))


@dataclass(frozen=True)
class MachineRun:
    """Motion of a machine and forces on it in a simulation; `process.simulation.machine.simulate_machine`.

    Parameters
    ----------
    duration : float
        Length of the record, with a cut the time in the cut [s].
    feed : float or mapping, optional
        Feed of all axes, or axis name -> feed [m/s], of either sign.
    controller : str, optional
        Name of the controllers.
    position : float, optional
        Position [m], at t = 0, of the axis that a posture depends on.
    forces, drive_forces : mapping, optional
        Axis name -> force on the tool, or added to that of the drive.
    cut, spindle : optional
        The cut and the speed of the spindle: both or neither.
    lead, tail : float, optional
        Time before and after the cut [s].
    impulse : (float, float, float), optional
        Impulse on the tool at entry [N s].
    control : SampledControl, optional
        The servos work on samples.
    commanded : bool, optional
        Drive forces are added to what the controllers command, before the dead time, and the record holds the command.
        Else they act at once, and the record holds what acts.

    Raises
    ------
    InputError
        When a cut has no spindle or a spindle no cut, a time is not possible, or an impulse has no cut.
    """

    duration: float
    feed: float | Mapping[str, float] = 0.0
    controller: str | None = None
    position: float | None = None
    forces: Mapping[str, Excitation] = field(default_factory=dict)
    drive_forces: Mapping[str, Excitation] = field(default_factory=dict)
    cut: MillingCut | None = None
    spindle: Spindle | None = None
    lead: float = 0.0
    tail: float = 0.0
    impulse: tuple[float, float, float] = (0.0, 0.0, 0.0)
    control: SampledControl | None = None
    commanded: bool = False

    def __post_init__(self) -> None:
        """Refuse what does not fit together."""
        if (self.cut is None) != (self.spindle is None):
            raise InputError("a cut needs a spindle and a spindle a cut; give both or neither")
        if self.cut is not None and not (self.duration > 0.0 and self.lead >= 0.0 and self.tail >= 0.0):
            raise InputError(
                f"{self.lead:g} s in air, {self.duration:g} s in the cut, {self.tail:g} s in air; the cut must last, "
                "and the others must be zero or positive"
            )
        if not math.isfinite(self.total):
            raise InputError(f"a simulation of {self.total:g} s; give a finite time")
        if self.cut is None and any(self.impulse):
            raise InputError("an impulse at entry is given, but no cut; use forces, e.g. a HalfSine")
        axis_index(list(self.forces))

    @property
    def total(self) -> float:
        """Length of the record [s]."""
        return self.lead + self.duration + self.tail

    @property
    def leave(self) -> float:
        """Time [s] at which the tool leaves the cut; it enters at `lead`."""
        return self.lead + self.duration

    @property
    def excitations(self) -> list[Excitation]:
        """Every force over time, those on the tool first."""
        return [*self.forces.values(), *self.drive_forces.values()]

    @property
    def tool_axes(self) -> list[str]:
        """Axes along which a force acts on the tool."""
        return list(AXES) if self.cut is not None else list(self.forces)

    @property
    def end(self) -> float:
        """Time [s] after which nothing excites the machine."""
        return max([e.end for e in self.excitations] + [self.leave if self.cut is not None else 0.0])


class Problem(NamedTuple):
    """A machine and its run, with all names resolved."""

    machine: Machine
    run: MachineRun
    structures: tuple[Structure, ...]
    friction: tuple[SlideFriction, ...]
    servos: tuple[Servo | None, ...]

    @property
    def feeds(self) -> list[float]:
        """Feed of each axis [m/s]."""
        return [r.feed for r in self.friction]

    def lateness(self, axis: str) -> float:
        """Return the time [s] from what the controller of an axis commands to the force that acts."""
        servo = self.servos[list(self.machine.axes).index(axis)]
        if servo is None or not self.run.commanded:
            return 0.0
        control = self.run.control
        return servo.delay if control is None else control.lag * control.period

    @property
    def delays(self) -> list[float]:
        """Dead times [s] of the servos."""
        return [v.delay for v in self.servos if v is not None and v.delay > 0.0]


def resolve(machine: Machine, run: MachineRun) -> Problem:
    """Resolve the names of a run.

    Raises
    ------
    InputError
        When the run does not fit the machine.
    """
    feeds = machine.feeds(run.feed)
    servos = tuple(machine.servos(run.controller))
    if run.control is not None and any(v is not None and v.delay > 0.0 for v in servos):
        raise InputError("a sampled servo has a delay of its own; its period and lag make the dead time: set delay 0")
    unknown = [a for a in run.drive_forces if a not in machine.axes]
    if unknown:
        raise InputError(f"a drive force on axis {', '.join(unknown)}; this machine drives {', '.join(machine.axes)}")
    friction = tuple(_slide_friction(axis.friction, feeds[name]) for name, axis in machine.axes.items())
    return Problem(machine, run, _along_path(machine, feeds, run.position, run.total), friction, servos)


def _along_path(
    machine: Machine, feeds: Mapping[str, float], position: float | None, total: float
) -> tuple[Structure, ...]:
    """Return the structure, or those along the path of an axis that a posture depends on."""
    start = machine.structure_at(position)
    if not isinstance(machine.structure, Posture) or feeds.get(machine.structure.axis, 0.0) == 0.0:
        return (start,)
    assert position is not None
    stop = position + feeds[machine.structure.axis] * total
    return tuple(machine.structure_at(float(at)) for at in np.linspace(position, stop, RULES.path_points))
