"""The scenario file as it is written, table by table; every field comes out in SI."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, StrictInt, StrictStr, model_validator

from process import units
from process.errors import InputError
from process.instruments.actuator import MovingCoil
from process.instruments.trials import DEFAULT_SAMPLE_RATE
from process.labels import AXES
from smfe.campaign import quantities as q
from smfe.campaign.machine import MachineMass, MachineTable
from smfe.campaign.schema import LobesTable, MaterialTable, PassTable, ToolTable
from smfe.campaign.tables import Delay, PositiveTime, Table, Triple, many, number, triple, values
from smfe.records.formats.channels import listed


def _range(dimension: str, steps: bool) -> BeforeValidator:
    """[from, to] or [from, to, step] -> tuple in SI, rising."""
    return BeforeValidator(lambda value: _rising(value, dimension, steps))


def _rising(value: Any, dimension: str, steps: bool) -> tuple[float, ...]:
    wanted = "[from, to, step]" if steps else "[from, to]"
    if not isinstance(value, list) or len(value) != (3 if steps else 2):
        raise InputError(f"{value!r} is no range; write {wanted}, each with its unit")
    numbers = tuple(units.parse(item, dimension) for item in value)
    if not 0.0 < numbers[0] < numbers[1] or (steps and not 0.0 < numbers[2] <= numbers[1] - numbers[0]):
        raise InputError(f"{value!r} is no range; write {wanted} with positive, rising values")
    return numbers


def _frequencies(value: Any) -> tuple[float, ...]:
    """[from, to], or [from, to, step] -> tuple in SI, rising."""
    return _rising(value, "frequency", steps=isinstance(value, list) and len(value) == 3)


Axis = q.Axis
Directions = Annotated[tuple[Axis, ...], q.NotEmpty]
Ratios = Annotated[Triple, triple("dimensionless")]
Matrix = Annotated[tuple[Ratios, Ratios, Ratios], q.NotEmpty]


class ScenarioTable(Table):
    """``[scenario]``."""

    name: q.Name
    seed: Annotated[StrictInt, Field(ge=0)] = 0
    sample_rate: q.PositiveFrequency = DEFAULT_SAMPLE_RATE


# --- sensors ------------------------------------------------------------------------------------------------


class RotationTable(Table):
    """``misalignment`` of a sensor."""

    axis: Axis
    angle: q.Angle


class SensorTable(Table):
    """What accelerometers and force sensors have in common."""

    resonance: q.PositiveFrequency | None = None
    damping: q.Ratio = 0.02
    gain: Ratios = (1.0, 1.0, 1.0)
    cross_axis: Matrix | None = None
    misalignment: RotationTable | None = None
    noise_corner: Annotated[float, q.quantity("frequency", low=0.0)] = 0.0
    bits: StrictInt = 24


class AccelerometerTable(SensorTable):
    """``[sensors.accelerometer]``."""

    mass: q.Mass = 0.0
    moves: Directions = AXES
    noise: Annotated[Triple, triple("acceleration")] = (0.0, 0.0, 0.0)
    range: Annotated[float, q.quantity("acceleration", above=0.0)] | None = None


class ForceSensorTable(SensorTable):
    """``[sensors.hammer]``, ``[sensors.actuator]``, ``[sensors.dynamometer]``."""

    mass: q.Mass = 0.0
    drift: Annotated[Triple, triple("force_rate")] = (0.0, 0.0, 0.0)
    noise: Annotated[Triple, triple("force")] = (0.0, 0.0, 0.0)
    range: q.PositiveForce | None = None


class EncoderTable(Table):
    """``[sensors.encoder]``."""

    resolution: q.PositiveLength


class ToneTable(Table):
    """``[[sensors.tone]]``."""

    channel: StrictStr
    amplitude: StrictStr
    frequency: q.PositiveFrequency | None = None
    order: q.Ratio | None = None
    phase: q.Angle | None = None


class AntiAliasTable(Table):
    """``[sensors.anti_alias]``."""

    order: StrictInt = 8
    corner: q.PositiveFrequency


class ClockTable(Table):
    """``[[sensors.clock]]``."""

    channel: StrictStr
    skew: q.Time = 0.0
    rate_error: q.Ratio = 0.0


class SensorsTable(Table):
    """``[sensors]``."""

    accelerometer: AccelerometerTable = AccelerometerTable()
    hammer: ForceSensorTable = ForceSensorTable()
    actuator: ForceSensorTable = ForceSensorTable()
    dynamometer: ForceSensorTable = ForceSensorTable()
    encoder: EncoderTable | None = None
    tone: tuple[ToneTable, ...] = ()
    anti_alias: AntiAliasTable | None = None
    clock: tuple[ClockTable, ...] = ()


class CoilTable(Table):
    """``[actuator]``: a moving coil on the tool, with dynamics of its own."""

    mass: MachineMass
    frequency: q.PositiveFrequency
    damping: q.DampingRatio
    force_constant: Annotated[float, q.quantity("force_constant", above=0.0)] | None = None
    bandwidth: q.PositiveFrequency = math.inf
    housing: q.Mass = 0.0

    def build(self) -> MovingCoil:
        """Return the actuator."""
        return MovingCoil(self.mass, self.frequency, self.damping, self.bandwidth, self.housing)


# --- trials -------------------------------------------------------------------------------------------------


class ControlTable(Table):
    """``control`` of a trial: a sampled servo."""

    period: PositiveTime
    lag: Annotated[StrictInt, Field(ge=0)] = 1
    encoder_resolution: Annotated[float, q.quantity("length", low=0.0)] = 0.0


def _braked(value: Any) -> Any:
    """`true` for all axes, or a list of some."""
    if isinstance(value, bool):
        return list(AXES) if value else []
    return many(value)


class TrialBase(Table):
    """What all trials have in common; a list makes one record of each combination."""

    name: q.Name | None = None
    feed: Annotated[tuple[q.Feed, ...], BeforeValidator(many)] | None = None
    controller: Annotated[tuple[StrictStr, ...], BeforeValidator(many)] | None = None
    position: Annotated[tuple[float, ...], values("length")] | None = None
    repeats: Annotated[StrictInt, Field(ge=1, le=1000)] = 1
    control: ControlTable | None = None
    brakes: Annotated[tuple[Axis, ...], BeforeValidator(_braked)] | None = None


class HammerTrial(TrialBase):
    """``method = "hammer"``: `scatter` is the largest departure of a hit from the level."""

    method: Literal["hammer"]
    directions: Directions = AXES
    hits: Annotated[StrictInt, Field(ge=1, le=1000)] = 5
    impulse: Annotated[tuple[float, ...], values("impulse", above=0.0)] | None = None
    peak_force: Annotated[tuple[float, ...], values("force", above=0.0)] | None = None
    scatter: Annotated[float, BeforeValidator(number), Field(ge=0.0, lt=1.0)] = 0.0
    duration: PositiveTime = 4e-3
    interval: PositiveTime = 4.0
    frequency_range: q.FrequencyRange | None = None

    @model_validator(mode="after")
    def _one_level(self) -> HammerTrial:
        if (self.impulse is None) == (self.peak_force is None):
            raise InputError("a hammer trial needs an impulse or a peak_force, one of them")
        if self.duration >= 0.5 * self.interval:
            raise InputError("the interval must be more than twice the duration of a hit")
        return self


class ActuatorTrial(TrialBase):
    """``method = "actuator"``: a sine in steps, or one that sweeps."""

    method: Literal["actuator"]
    directions: Directions = AXES
    force: Annotated[tuple[float, ...], values("force", above=0.0)] | None = None
    current: Annotated[tuple[float, ...], values("current", above=0.0)] | None = None
    frequencies: Annotated[tuple[float, ...], BeforeValidator(_frequencies)]
    dwell: PositiveTime | None = None
    sweep_time: PositiveTime | None = None

    @model_validator(mode="after")
    def _one_sine(self) -> ActuatorTrial:
        if (self.force is None) == (self.current is None):
            raise InputError("an actuator trial needs a force, or the current of an [actuator], one of them")
        if self.sweep_time is None and len(self.frequencies) != 3:
            raise InputError("a sine in steps needs frequencies = [from, to, step]; one that sweeps, a sweep_time")
        if self.sweep_time is not None and (len(self.frequencies) != 2 or self.dwell is not None):
            raise InputError("a sine that sweeps needs frequencies = [from, to], and no dwell")
        if self.sweep_time is not None and self.sweep_time * self.frequencies[0] < 1.0:
            raise InputError(
                f"a sine that sweeps in {self.sweep_time:g} s has no period of {self.frequencies[0]:g} Hz; give a "
                "longer sweep_time"
            )
        return self


class CuttingTrial(TrialBase):
    """What sweeps and cutting tests have in common."""

    depth_of_cut: Annotated[tuple[float, ...], values("length", above=0.0)]
    feed_per_tooth: q.PositiveLength
    lead: Delay = 0.5
    tail: Delay = 2.0


class SweepTrial(CuttingTrial):
    """``method = "sweep"``: the feed rate is held while the speed rises.

    `spindle_speed` and `feed_per_tooth` are those in the cut, the latter at its start.
    """

    method: Literal["sweep"]
    spindle_speed: Annotated[tuple[float, float], _range("rotation", steps=False)]
    rate: Annotated[float, q.quantity("rotation_rate", above=0.0)]
    passes: Annotated[tuple[PassTable, ...], q.NotEmpty]
    frequency_range: q.FrequencyRange | None = None


class CutTrial(CuttingTrial):
    """``method = "cut"``: cutting tests at constant speed."""

    method: Literal["cut"]
    spindle_speed: Annotated[tuple[float, ...], values("rotation", above=0.0)]
    cut: q.CutName
    width_of_cut: q.PositiveLength
    duration: PositiveTime
    lead: Delay = 0.25
    tail: Delay = 0.25


class DriveTrial(TrialBase):
    """``method = "drive"``: a force added to what the controller of one axis commands, or nothing."""

    method: Literal["drive"]
    axis: Axis
    signal: Annotated[str, q.one_of(("chirp", "prbs", "multisine"), "signal")] = "chirp"
    force: Annotated[tuple[float, ...], values("force", above=0.0)] | None = None
    duration: PositiveTime | None = None
    frequency_range: q.FrequencyRange | None = None
    resolution: q.PositiveFrequency | None = None
    clock: q.PositiveFrequency | None = None
    bits: Annotated[StrictInt, Field(ge=2, le=20)] | None = None
    periods: Annotated[StrictInt, Field(ge=1, le=1000)] | None = None

    @model_validator(mode="after")
    def _complete(self) -> DriveTrial:
        """Each signal has keys of its own."""
        if self.force is None:
            needed: tuple[str, ...] = ("duration",)
        else:
            needed = {
                "chirp": ("duration", "frequency_range"),
                "prbs": ("clock", "bits", "periods"),
                "multisine": ("frequency_range", "resolution", "periods"),
            }[self.signal]
        keys = ("duration", "frequency_range", "resolution", "clock", "bits", "periods")
        missing = [key for key in needed if getattr(self, key) is None]
        extra = [key for key in keys if key not in needed and getattr(self, key) is not None]
        if missing or extra:
            what = f"signal '{self.signal}'" if self.force is not None else "a drive trial without force"
            wrong = [f"{listed(missing)} missing"] * bool(missing) + [f"{listed(extra)} not read"] * bool(extra)
            raise InputError(f"{what}: {' and '.join(wrong)}; it has {listed(needed)}")
        return self

    @property
    def period(self) -> float | None:
        """Period of the force [s]; None where it has none."""
        if self.clock is not None and self.bits is not None:
            return (2.0**self.bits - 1.0) / self.clock
        return None if self.resolution is None else 1.0 / self.resolution


class SilentTrial(TrialBase):
    """``method = "silent"``."""

    method: Literal["silent"]
    duration: PositiveTime


TRIALS: dict[str, type[TrialBase]] = {
    "hammer": HammerTrial,
    "actuator": ActuatorTrial,
    "sweep": SweepTrial,
    "cut": CutTrial,
    "drive": DriveTrial,
    "silent": SilentTrial,
}
"""Method -> its table."""

Trial = HammerTrial | ActuatorTrial | SweepTrial | CutTrial | DriveTrial | SilentTrial


class ScenarioFile(Table):
    """The whole file."""

    scenario: ScenarioTable
    machine: MachineTable
    tool: ToolTable | None = None
    material: MaterialTable | None = None
    sensors: SensorsTable = SensorsTable()
    actuator: CoilTable | None = None
    trial: Annotated[tuple[Annotated[Trial, Field(discriminator="method")], ...], q.NotEmpty]
    lobes: tuple[LobesTable, ...] = ()
