"""``[machine]`` as scenario and campaign write it, with its axes, joints and postures, and the machine that it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, dataclass, replace
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, StrictStr, model_validator

from process import units
from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import (
    Andersson,
    Coulomb,
    CoulombViscous,
    FrictionLaw,
    GeneralisedMaxwellSlip,
    LuGre,
    MemoryLaw,
    Viscous,
)
from process.machine.joints import CubicSpring, Gap, Iwan, Jenkins, Joint
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.modes import ModalModel
from process.machine.structure import (
    Host,
    Posture,
    Structure,
    free_modes,
    hosted,
    released_modes,
    two_mass_axes,
)
from smfe.campaign import quantities as q
from smfe.campaign.tables import Delay, PositiveMass, PositiveTime, Speed, Table, Viscosity, values
from smfe.records.formats.channels import listed

MACHINE = "machine"
"""What ``measurements`` of ``[[lobes]]`` call the machine of ``[machine]``."""

LAWS: dict[str, type[FrictionLaw | MemoryLaw]] = {
    "viscous": Viscous,
    "coulomb": Coulomb,
    "coulomb_viscous": CoulombViscous,
    "andersson": Andersson,
    "lugre": LuGre,
    "gms": GeneralisedMaxwellSlip,
}
"""Friction laws by the name that a file uses."""

JOINTS: dict[str, type[Joint]] = {"jenkins": Jenkins, "iwan": Iwan, "cubic": CubicSpring, "gap": Gap}
"""Laws of joints by the name that a file uses."""


def _kilograms(value: Any) -> Any:
    """The mass of a machine without a unit: kilograms are meant, and asked for."""
    text = value.strip() if isinstance(value, str) else ""
    if text.replace(".", "", 1).isdigit():
        raise InputError(f'{value!r} has no unit; write it as text with a unit, "{text} kg"')
    if isinstance(value, int | float) and not isinstance(value, bool) and not units.numbers_count():
        raise InputError(f'{value!r} has no unit; write it as text with a unit, "{value} kg"')
    return value


@contextmanager
def placed(where: str) -> Iterator[None]:
    """Say of which table an error is."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


MachineMass = Annotated[PositiveMass, BeforeValidator(_kilograms)]


# --- What axes, joints and postures are made of.


class ModeTable(Table):
    """One entry of ``modes``."""

    frequency: q.PositiveFrequency
    damping: q.DampingRatio
    stiffness: q.Stiffness
    direction: tuple[float, float, float]


class ServoTable(Table):
    """One controller of an axis."""

    Kp: Annotated[float, q.quantity("viscosity", above=0.0)]
    Ti: PositiveTime
    Kv: q.PositiveFrequency
    delay: Delay = 0.0
    feed_forward: q.Ratio = 1.0

    def build(self) -> Servo:
        """Return the servo."""
        return Servo(**dict(self))


class FrictionParameters(Table):
    """Parameters of friction in one direction; each law has some of them."""

    coulomb: q.Force | None = None
    static: q.Force | None = None
    stribeck_speed: Speed | None = None
    sigma: Viscosity | None = None
    kt: Annotated[float, q.quantity("steepness", above=0.0)] | None = None
    delta: q.Ratio | None = None
    bristle_stiffness: q.Stiffness | None = None
    bristle_damping: Viscosity | None = None
    element_stiffness: Annotated[tuple[float, ...], values("stiffness", above=0.0)] | None = None
    share: tuple[q.Ratio, ...] | None = None
    attraction: Annotated[float, q.quantity("force_rate", above=0.0)] | None = None


class FrictionTable(FrictionParameters):
    """``friction`` of an axis: the law by name, its parameters, and those for negative velocity that differ."""

    law: Annotated[str, q.one_of(tuple(LAWS), "law")]
    negative: FrictionParameters | None = None

    def build(self) -> FrictionLaw | MemoryLaw:
        """Return the law; which of two sets of parameters counts follows from the sign of the velocity."""
        forth = self.model_dump(exclude_unset=True, exclude={"law", "negative"})
        law: FrictionLaw | MemoryLaw = made("friction law", self.law, LAWS[self.law], forth)
        if self.negative is None:
            return law
        back = {**forth, **self.negative.model_dump(exclude_unset=True)}
        with placed("friction.negative"):
            return _two_ways(law, made("friction law", self.law, LAWS[self.law], back))


def _two_ways(forth: FrictionLaw | MemoryLaw, back: FrictionLaw | MemoryLaw) -> FrictionLaw | MemoryLaw:
    """Return one law from those of both directions."""
    if isinstance(forth, LuGre) and isinstance(back, LuGre):
        return replace(forth, negative=back)
    if isinstance(forth, GeneralisedMaxwellSlip) and isinstance(back, GeneralisedMaxwellSlip):
        return replace(forth, negative=back)
    assert isinstance(forth, FrictionLaw)  # both have the same name
    assert isinstance(back, FrictionLaw)
    return replace(_stribeck(forth), negative=_stribeck(back))


def _stribeck(law: FrictionLaw) -> Andersson:
    """Return a law without memory as the Stribeck curve that it is, with nothing that falls."""
    if isinstance(law, Andersson):
        return law
    if isinstance(law, Coulomb | CoulombViscous):
        return Andersson(law.coulomb, law.coulomb, 1.0, law.sigma, law.kt)
    assert isinstance(law, Viscous)
    return Andersson(0.0, 0.0, 1.0, law.sigma, 1.0)


def made(what: str, name: str, make: Callable[..., Any], given: Mapping[str, Any]) -> Any:
    """Build a law from exactly the parameters it has."""
    fields = getattr(make, "__dataclass_fields__", {})
    wanted = {f.name for f in fields.values() if f.init}
    needed = {f.name for f in fields.values() if f.init and f.default is MISSING}
    missing, extra = sorted(needed - set(given)), sorted(set(given) - wanted)
    if missing or extra:
        wrong = [f"{listed(missing)} missing"] * bool(missing) + [f"{listed(extra)} not read"] * bool(extra)
        raise InputError(f"{what} '{name}': {' and '.join(wrong)}; it has {listed(sorted(wanted))}")
    return make(**given)


class HostTable(Table):
    """``host`` of an axis: the bed that it stands on, one mass on a spring."""

    mass: MachineMass
    frequency: q.PositiveFrequency
    damping: q.DampingRatio

    def build(self) -> Host:
        """Return the host."""
        return Host(self.mass, self.frequency, self.damping)


class AxisTable(Table):
    """``[machine.axis.x]``."""

    moving_mass: MachineMass
    tip_mass: MachineMass | None = None
    stiffness: q.Stiffness | None = None
    damping: Viscosity | None = None
    coupling: Annotated[tuple[float, ...], values("mass")] | None = None
    host: HostTable | None = None
    controllers: Annotated[dict[StrictStr, ServoTable], Field(default_factory=dict)]
    friction: FrictionTable | None = None


class JointTable(Table):
    """``[[machine.joint]]``."""

    law: Annotated[str, q.one_of(tuple(JOINTS), "law")]
    stiffness: q.Stiffness
    slip_force: q.PositiveForce | None = None
    cubic: Annotated[float, q.quantity("cubic_stiffness")] | None = None
    gap: q.PositiveLength | None = None
    participation: tuple[q.Ratio, ...] | None = None
    axis: q.Axis | None = None


class PostureEntry(Table):
    """One entry of ``at`` of a posture."""

    position: q.Length
    modes: Annotated[tuple[ModeTable, ...], q.NotEmpty]


class PostureTable(Table):
    """``[machine.posture]``."""

    axis: q.Axis
    at: Annotated[tuple[PostureEntry, ...], q.NotEmpty]


class SpreadTable(Table):
    """``uncertainty`` of a machine: relative standard deviations, each of one factor; friction of each parameter."""

    friction: q.Share = 0.0
    mass: q.Share = 0.0
    damping: q.Share = 0.0
    stiffness: q.Share = 0.0


class MachineTable(Table):
    """``[machine]``: what it is called, how fast it feeds, and what it is made of.

    It is complete, or gives nothing but a name and a feed.
    """

    name: q.Name | None = None
    maximum_feed: Annotated[float, q.quantity("speed", above=0.0)] | None = None
    modes: tuple[ModeTable, ...] = ()
    tip_mass: MachineMass | None = None
    axis: Annotated[dict[q.Axis, AxisTable], Field(default_factory=dict)]
    joint: tuple[JointTable, ...] = ()
    posture: PostureTable | None = None
    uncertainty: SpreadTable | None = None

    @model_validator(mode="after")
    def _possible(self) -> MachineTable:
        self.build()
        return self

    def spread(self) -> dict[str, float] | None:
        """Return the relative standard deviations that are stated; None: nothing is."""
        return None if self.uncertainty is None else dict(self.uncertainty)

    def build(self) -> Machine | ModalModel | None:
        """Return the machine, or None where nothing but its name and feed are given."""
        return build_machine(self) if is_model(self.model_fields_set) else None


class OpenServoTable(Table):
    """One controller of an axis whose gains need not all be known."""

    Kp: Annotated[float, q.quantity("viscosity", above=0.0)] | None = None
    Ti: PositiveTime | None = None
    Kv: q.PositiveFrequency | None = None
    delay: Delay | None = None
    feed_forward: q.Ratio = 1.0

    def build(self) -> Servo:
        """Return the servo, where all of it is known."""
        missing = [name for name in ("Kp", "Ti", "Kv") if getattr(self, name) is None]
        if missing:
            raise InputError(f"{listed(missing)} missing; only a diagnosis of measured modes finds a gain by itself")
        return Servo(self.Kp, self.Ti, self.Kv, self.delay or 0.0, self.feed_forward)  # type: ignore[arg-type]


class OpenAxisTable(AxisTable):
    """``[machine.axis.x]`` beside a baseline whose modes are measured."""

    controllers: Annotated[dict[StrictStr, OpenServoTable], Field(default_factory=dict)]  # type: ignore[assignment]

    def given(self) -> GivenAxis:
        """Return what the table says."""
        law = None if self.friction is None else self.friction.build()
        servos = {name: (servo.Kp, servo.Ti, servo.Kv, servo.delay) for name, servo in self.controllers.items()}
        return GivenAxis(self.moving_mass, servos, law, self.coupling)


@dataclass(frozen=True)
class GivenAxis:
    """A feed axis whose modes are measured: what the campaign says of it (SI).

    Parameters
    ----------
    moving_mass : float
        All that moves with it [kg].
    controllers : mapping
        Name -> Kp [N s/m], Ti [s], Kv [1/s], dead time [s]; None where it is not known.
    friction : FrictionLaw or MemoryLaw, optional
        Of guideway and drive.
    coupling : tuple of float, optional
        Momentum of each mode along it [kg].
    """

    moving_mass: float
    controllers: Mapping[str, tuple[float | None, float | None, float | None, float | None]]
    friction: FrictionLaw | MemoryLaw | None = None
    coupling: tuple[float, ...] | None = None


class OpenMachineTable(MachineTable):
    """``[machine]`` beside a baseline whose modes are measured: its axes may stand alone."""

    axis: Annotated[dict[q.Axis, OpenAxisTable], Field(default_factory=dict)]  # type: ignore[assignment]

    def build(self) -> Machine | ModalModel | None:
        """Return the machine, or None where its modes are those of the baseline."""
        of_two_masses = any(axis.stiffness is not None for axis in self.axis.values())
        if self.axis and not (self.modes or self.posture or self.joint or of_two_masses):
            for name, axis in self.axis.items():
                with placed(f"axis.{name}"):
                    axis.given()
            return None
        return super().build()

    def axes(self) -> dict[str, GivenAxis]:
        """Return the axes that carry the modes of the baseline; none where the machine has modes of its own."""
        return {name: axis.given() for name, axis in self.axis.items()} if self.build() is None else {}

    def carrying(self, modes: ModalModel) -> Machine:
        """Return the machine whose axes carry modes that were found with its slides held.

        Raises
        ------
        InputError
            When a gain is not known, or the momentum of a mode.
        """
        return Machine(_on_slides(self, modes), {name: _feed_axis(name, axis) for name, axis in self.axis.items()})


def is_model(keys: Iterable[str]) -> bool:
    """Return whether the keys of a ``[machine]`` say what it is made of, and not its name and feed alone."""
    return bool(set(keys) & (set(MachineTable.model_fields) - {"name", "maximum_feed", "uncertainty"}))


# --- From the tables to the machine.


def build_machine(table: MachineTable) -> Machine | ModalModel:
    """Return the machine: a modal model where there are modes alone, else a machine with axes, joints, postures.

    Raises
    ------
    InputError
        When the tables do not make one machine.
    """
    if not table.modes and not table.axis and table.posture is None:
        raise InputError("no modes and no axis; give modes, [machine.axis.x] tables, or [machine.posture]")
    if not table.axis and not table.joint and table.posture is None:
        return _modal(table.modes)
    structure: Structure | Posture
    if table.posture is None:
        structure = _structure(table, table.modes)
    else:
        if table.modes:
            raise InputError("gives modes twice: in itself and in its posture; leave one of them out")
        at = table.posture.at
        structures = tuple(_structure(table, entry.modes, f"posture.at[{k}].") for k, entry in enumerate(at))
        structure = Posture(table.posture.axis, np.array([entry.position for entry in at]), structures)
    axes = {name: _feed_axis(name, axis) for name, axis in table.axis.items()}
    return Machine(structure, axes, tuple(_joint(table, i, joint) for i, joint in enumerate(table.joint)))


def modal_model(modes: Sequence[ModeTable]) -> ModalModel:
    """Return the modal model of a list of modes."""
    return ModalModel(
        frequency=np.array([mode.frequency for mode in modes]),
        damping=np.array([mode.damping for mode in modes]),
        stiffness=np.array([mode.stiffness for mode in modes]),
        direction=np.array([mode.direction for mode in modes]),
    )


def _modal(modes: Sequence[ModeTable], where: str = "") -> ModalModel:
    for i, mode in enumerate(modes):
        if not any(mode.direction):
            raise InputError(f"{where}modes[{i}].direction must not be zero; give the tool's motion in x, y and z")
    return modal_model(modes)


def _structure(table: MachineTable, modes: Sequence[ModeTable], where: str = "") -> Structure:
    if modes:
        springs = [name for name, axis in table.axis.items() if axis.stiffness is not None]
        if springs:
            raise InputError(
                f"axis {', '.join(springs)} has a stiffness and the machine has modes; give the modes alone, or axes "
                "of two masses without modes"
            )
        modal = _modal(modes, where)
        if not table.axis:
            return free_modes(modal.frequency, modal.damping, modal.mass, modal.direction, {})
        return _on_slides(table, modal)
    coupled = [name for name, axis in table.axis.items() if axis.coupling is not None]
    if coupled:
        raise InputError(
            f"axis.{coupled[0]}.coupling is the momentum of modes along the axis, and there are no modes; leave it out"
        )
    return hosted(two_mass_axes({name: _two_masses(name, axis) for name, axis in table.axis.items()}), _hosts(table))


def _on_slides(table: MachineTable, modal: ModalModel) -> Structure:
    """Return the structure whose modes, found with the slides held, ride on them."""
    masses = {name: axis.moving_mass for name, axis in table.axis.items()}
    coupling = {name: axis.coupling for name, axis in table.axis.items() if axis.coupling is not None}
    return hosted(released_modes(modal, masses, table.tip_mass, coupling), _hosts(table))


def _hosts(table: MachineTable) -> dict[str, Host]:
    return {name: axis.host.build() for name, axis in table.axis.items() if axis.host is not None}


def _two_masses(name: str, axis: AxisTable) -> Drive:
    missing = [key for key in ("tip_mass", "stiffness", "damping") if getattr(axis, key) is None]
    if missing:
        raise InputError(
            f"axis.{name}: {', '.join(missing)} missing; an axis without modes has two masses and a spring"
        )
    return Drive(axis.moving_mass, axis.tip_mass or 0.0, axis.stiffness or 0.0, axis.damping or 0.0)


def _feed_axis(name: str, axis: AxisTable) -> FeedAxis:
    with placed(f"axis.{name}"):
        servo = {called: table.build() for called, table in axis.controllers.items()} or None
        return FeedAxis(servo) if axis.friction is None else FeedAxis(servo, axis.friction.build())


def _joint(table: MachineTable, number: int, joint: JointTable) -> MountedJoint:
    given = joint.model_dump(exclude_unset=True, exclude={"law", "participation", "axis"})
    on_hosts = [0.0 for axis in table.axis.values() if axis.host is not None]
    with placed(f"joint[{number}]"):
        law: Joint = made("joint", joint.law, JOINTS[joint.law], given)
        if table.modes or table.posture is not None:
            count = len(table.modes) if table.posture is None else len(table.posture.at[0].modes)
            if joint.participation is None or len(joint.participation) != count:
                raise InputError(f"a joint needs a participation of {count} numbers, its displacement in each mode")
            return MountedJoint(law, np.array([0.0] * len(table.axis) + list(joint.participation) + on_hosts))
        if joint.axis not in table.axis:
            raise InputError('a joint of two masses needs the axis it lies in, axis = "x"')
        row = np.zeros(2 * len(table.axis) + len(on_hosts))
        at = 2 * list(table.axis).index(joint.axis)
        row[at : at + 2] = 1.0, -1.0
        return MountedJoint(law, row)
