"""From the tables of a scenario to the machine and its sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from process import units
from process.drive.axis import Drive
from process.errors import InputError
from process.instruments.sensors import (
    AntiAlias,
    Clock,
    Converter,
    Drift,
    Grid,
    HammerTip,
    Inertia,
    Noise,
    Resonance,
    Sensitivity,
    Sensors,
    Stage,
    Stinger,
    Tone,
    with_added_mass,
)
from process.machine.joints import CubicSpring, Gap, Iwan, Jenkins, Joint
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.modes import ModalModel
from process.machine.structure import Posture, Structure, free_modes, released_modes, two_mass_axes
from smfe.campaign.schema import ModeTable, made
from smfe.records.formats.channels import CHANNELS, check_channel_name
from smfe.scenario import schema

_JOINTS: dict[str, type[Joint]] = {"jenkins": Jenkins, "iwan": Iwan, "cubic": CubicSpring, "gap": Gap}


def build_machine(table: schema.MachineTable) -> Machine | ModalModel:
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
    axes = {name: FeedAxis(**_feed_axis(axis)) for name, axis in table.axis.items()}
    return Machine(structure, axes, tuple(_joint(table, joint) for joint in table.joint))


def _modal(modes: Sequence[ModeTable], where: str = "") -> ModalModel:
    for i, mode in enumerate(modes):
        if not any(mode.direction):
            raise InputError(f"{where}modes[{i}].direction must not be zero; give the tool's motion in x, y and z")
    return ModalModel(
        frequency=np.array([mode.frequency for mode in modes]),
        damping=np.array([mode.damping for mode in modes]),
        stiffness=np.array([mode.stiffness for mode in modes]),
        direction=np.array([mode.direction for mode in modes]),
    )


def _structure(table: schema.MachineTable, modes: Sequence[ModeTable], where: str = "") -> Structure:
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
        return released_modes(modal, {name: axis.moving_mass for name, axis in table.axis.items()}, table.tip_mass)
    return two_mass_axes({name: _two_masses(name, axis) for name, axis in table.axis.items()})


def _two_masses(name: str, axis: schema.AxisTable) -> Drive:
    missing = [key for key in ("tip_mass", "stiffness", "damping") if getattr(axis, key) is None]
    if missing:
        raise InputError(
            f"axis.{name}: {', '.join(missing)} missing; an axis without modes has two masses and a spring"
        )
    return Drive(axis.moving_mass, axis.tip_mass or 0.0, axis.stiffness or 0.0, axis.damping or 0.0)


def _feed_axis(axis: schema.AxisTable) -> dict[str, Any]:
    out: dict[str, Any] = {"servo": {name: servo.build() for name, servo in axis.controllers.items()} or None}
    if axis.friction is not None:
        out["friction"] = axis.friction.build()
    return out


def _joint(table: schema.MachineTable, joint: schema.JointTable) -> MountedJoint:
    given = joint.model_dump(exclude_unset=True, exclude={"law", "participation", "axis"})
    law: Joint = made("joint", joint.law, _JOINTS[joint.law], given)
    if table.modes or table.posture is not None:
        count = len(table.modes) if table.posture is None else len(table.posture.at[0].modes)
        if joint.participation is None or len(joint.participation) != count:
            raise InputError(f"a joint needs a participation of {count} numbers, its displacement in each mode")
        return MountedJoint(law, np.array([0.0] * len(table.axis) + list(joint.participation)))
    if joint.axis not in table.axis:
        raise InputError('a joint of two masses needs the axis it lies in, axis = "x"')
    row = np.zeros(2 * len(table.axis))
    at = 2 * list(table.axis).index(joint.axis)
    row[at : at + 2] = 1.0, -1.0
    return MountedJoint(law, row)


def loaded_machine(machine: Machine | ModalModel, sensors: schema.SensorsTable) -> Machine | ModalModel:
    """Return the machine with the mass of the accelerometer on it."""
    mounted = sensors.accelerometer
    return with_added_mass(machine, mounted.mass, mounted.moves) if mounted.mass > 0.0 else machine


def build_sensors(table: schema.SensorsTable, method: str) -> Sensors:
    """Return the measuring chain of a method: hammer, actuator, or the dynamometer of a cut; none measures no force."""
    force = {"hammer": table.hammer, "actuator": table.actuator}.get(method, table.dynamometer)
    stages: list[Stage] = []
    if force.mass > 0.0:
        stages.append({"hammer": HammerTip, "actuator": Stinger}.get(method, Inertia)(force.mass))
    stages += [*_sensor("force", force), *_sensor("acceleration", table.accelerometer)]
    stages += [Drift(f"force_{a}", rate) for a, rate in zip("xyz", force.drift, strict=True) if rate]
    stages += [_tone(tone) for tone in table.tone]
    digital: list[Stage] = []
    for channel, sensor in (("force", force), ("acceleration", table.accelerometer)):
        if sensor.noise_corner > 0.0:
            digital.append(Noise(channel, sensor.noise, sensor.noise_corner))
        if sensor.range is not None:
            digital.append(Converter(channel, sensor.range, sensor.bits))
    if table.encoder is not None:
        digital.append(Grid(table.encoder.resolution))
    white = [s.noise if s.noise_corner == 0.0 else (0.0, 0.0, 0.0) for s in (force, table.accelerometer)]
    return Sensors(
        force_noise=white[0],
        acceleration_noise=white[1],
        stages=tuple(stages),
        anti_alias=None if table.anti_alias is None else AntiAlias(table.anti_alias.order, table.anti_alias.corner),
        clocks=tuple(Clock(clock.channel, clock.skew, clock.rate_error) for clock in table.clock),
        digital=tuple(digital),
    )


def _sensor(channel: str, table: schema.SensorTable) -> list[Stage]:
    out: list[Stage] = []
    if table.misalignment is not None:
        out.append(Sensitivity.rotated(channel, table.misalignment.axis, table.misalignment.angle))
    if table.cross_axis is not None:
        out.append(Sensitivity(channel, table.cross_axis))
    if table.resonance is not None:
        out.append(Resonance(channel, table.resonance, table.damping))
    if table.gain != (1.0, 1.0, 1.0):
        out.append(Sensitivity.gains(channel, table.gain))
    return out


def _tone(table: schema.ToneTable) -> Tone:
    dimension = CHANNELS[check_channel_name(table.channel)]
    amplitude = units.parse(table.amplitude, dimension)
    return Tone(table.channel, amplitude, table.frequency, table.order, table.phase)
