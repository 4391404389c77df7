"""From the tables of a scenario to its measuring chains, and the machine as the accelerometer loads it."""

from __future__ import annotations

from process import units
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
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from smfe.records.formats.channels import CHANNELS, check_channel_name
from smfe.scenario import schema


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
