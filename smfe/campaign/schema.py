"""The campaign file as it is written, table by table; every field comes out in SI (spindle speeds in rpm)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from datetime import date, datetime
from typing import Annotated, Any, Generic, TypeVar, cast

from pydantic import BeforeValidator, Field, StrictBool, StrictInt, StrictStr, model_validator

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import FrictionLaw
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from smfe.campaign import quantities as q
from smfe.campaign.machine import (
    MACHINE,
    FrictionTable,
    MachineTable,
    ModeTable,
    OpenMachineTable,
    ServoTable,
    modal_model,
)
from smfe.campaign.methods import AVERAGES, METHODS, SENSORS, SWEEP_ESTIMATORS
from smfe.campaign.tables import (
    Delay,
    Lengths,
    PositiveMass,
    PositiveTime,
    Speeds,
    Table,
    Triple,
    Viscosity,
    triple,
)
from smfe.campaign.tolerances import TolerancesTable
from smfe.campaign.tune import TuneTable
from smfe.records.dynamometer import Dynamometer
from smfe.records.formats.channels import check_channel_name
from stability import SpindleRange
from stability.chatter.criterion import QUANTITIES

# --- What was used: tool, material, spindle, channels.


class CampaignTable(Table):
    """``[campaign]``."""

    name: q.Name


class ToolTable(Table):
    """``[tool]``."""

    name: StrictStr | None = None
    diameter: q.PositiveLength
    teeth: StrictInt
    approach_angle: q.Angle = math.pi / 2
    edge_length: q.PositiveLength | None = None
    pitch_angles: tuple[q.Angle, ...] | None = None
    runout: tuple[q.Length, ...] | None = None
    helix_angle: q.Angle = 0.0

    @model_validator(mode="after")
    def _possible(self) -> ToolTable:
        self.build()
        return self

    def build(self) -> Tool:
        """Return the tool."""
        return Tool(**{f.name: getattr(self, f.name) for f in fields(Tool)})


class MaterialTable(Table):
    """``[material]``."""

    name: StrictStr | None = None
    Ktc: q.Pressure
    Krc: q.Pressure | None = None
    Kac: q.Pressure | None = None
    Kte: q.LineForce = 0.0
    Kre: q.LineForce = 0.0
    Kae: q.LineForce = 0.0
    uncertainty: q.Share | None = None

    @model_validator(mode="after")
    def _possible(self) -> MaterialTable:
        self.build()
        return self

    def build(self) -> CuttingCoefficients:
        """Return the cutting coefficients."""
        return CuttingCoefficients(self.Ktc, self.Krc or 0.0, self.Kac or 0.0, self.Kte, self.Kre, self.Kae)


class SpindleTable(Table):
    """``[spindle]``: what it can be set to, and what it can give all day."""

    minimum: q.Rotation | None = None
    maximum: q.Rotation | None = None
    step: q.Rotation | None = None
    accuracy: q.Share = 0.01
    power: Annotated[float, q.quantity("power", above=0.0)] | None = None
    torque: Annotated[float, q.quantity("torque", above=0.0)] | None = None

    @model_validator(mode="after")
    def _possible(self) -> SpindleTable:
        self.build()
        return self

    def build(self) -> SpindleRange:
        """Return the spindle."""
        low, high, step = (
            None if w is None else round(w * 30.0 / math.pi, 6) for w in (self.minimum, self.maximum, self.step)
        )
        return SpindleRange(low or 0.0, math.inf if high is None else high, step, self.accuracy)


class ChannelTable(Table):
    """One entry of ``[channels]``; what is missing is inherited."""

    column: q.Column | None = None
    unit: StrictStr | None = None
    sign: q.Sign = 1.0
    scale: q.Scale = 1.0
    delay: q.Time = 0.0
    sample_rate: q.PositiveFrequency | None = None
    pulses_per_revolution: Annotated[float, Field(gt=0.0)] | None = None
    spacing: q.PositiveFrequency | None = None
    start: q.Frequency | None = None


Channels = dict[Annotated[str, BeforeValidator(check_channel_name)], ChannelTable]


# --- What was measured, and how it was cut.


class ConditionsTable(Table):
    """What a measurement or a record was made under."""

    controller: StrictStr | None = None
    feed: q.Feed | None = None
    force_level: q.Force | None = None
    depth_of_cut: q.PositiveLength | None = None
    feed_per_tooth: q.PositiveLength | None = None
    position: StrictStr | None = None
    added_mass: q.Mass | None = None
    temperature: q.Temperature | None = None
    started: datetime | date | None = None
    repeat: StrictInt | None = None


class ProcessingTable(ConditionsTable):
    """How the records of a measurement become a compliance; each key belongs to some methods (`checks`)."""

    estimator: Annotated[str, q.one_of((*AVERAGES, *SWEEP_ESTIMATORS), "estimator")] | None = None
    force_window: StrictBool | None = None
    exponential_window: PositiveTime | None = None
    remove_background: StrictBool | None = None
    split_levels: StrictBool | None = None
    full_scale: q.PositiveForce | None = None
    accelerometer_mass: PositiveMass | None = None
    frame_mass: PositiveMass | None = None
    period: PositiveTime | None = None
    settling: q.NoTime | None = None
    hold: q.NoTime | None = None
    averages: Annotated[StrictInt, Field(ge=1)] | None = None
    conjugate: StrictBool | None = None
    moving_mass: q.Inertia | None = None
    spindle_speed: q.Rotation | None = None
    sensor: Annotated[str, q.one_of(SENSORS, "sensor")] | None = None
    free_mass: PositiveMass | None = None


class OtherRecorderTable(Table):
    """One entry of ``with``: a file that a second recorder wrote meanwhile, with channels of its own."""

    file: q.OneFile
    channels: Channels
    shared: Annotated[str, BeforeValidator(check_channel_name)] | None = None
    offset: q.Time | None = None

    @model_validator(mode="after")
    def _one_clock(self) -> OtherRecorderTable:
        if self.shared is not None and self.offset is not None:
            raise InputError("gives shared and offset; the shared channel finds the offset; take one out")
        return self


class RecordTable(ConditionsTable):
    """One entry of ``records``."""

    file: q.Files
    excitation: q.Place | None = None
    response: q.Place | None = None
    cut: q.CutName | None = None
    width_of_cut: q.PositiveLength | None = None
    spindle_speed: q.Ramp | None = None
    channels: Annotated[Channels, Field(default_factory=dict)]
    others: tuple[OtherRecorderTable, ...] = Field(default=(), alias="with")

    @model_validator(mode="after")
    def _one_file(self) -> RecordTable:
        if self.others and len(self.file) != 1:
            raise InputError(f"with adds to one file, and {len(self.file)} match; give each file an entry of its own")
        return self


class DynamometerTable(Table):
    """``dynamometer`` of a sweep."""

    mass: q.Mass = 0.0
    frequency: q.PositiveFrequency = math.inf
    damping: q.Ratio = 0.02

    def build(self) -> Dynamometer:
        """Return the force sensor."""
        return Dynamometer(self.mass, self.frequency, self.damping)


class MeasurementTable(ProcessingTable):
    """``[[measurement]]``."""

    name: q.Name
    method: Annotated[str, q.one_of(tuple(METHODS), "method")]
    records: Annotated[tuple[RecordTable, ...], q.NotEmpty]
    background: q.Files | None = None
    frequency_range: q.FrequencyRange | None = None
    resolution: q.PositiveFrequency | None = None
    references: Annotated[str, q.one_of(("all", "x", "spindle"), "references")] = "all"
    axes: Annotated[tuple[q.Axis, ...], q.NotEmpty] = ("x", "y", "z")
    reciprocal: StrictBool = False
    position_dependent: StrictBool = False
    dynamometer: DynamometerTable | None = None
    held_out: StrictBool = False
    channels: Annotated[Channels, Field(default_factory=dict)]


class CuttingTestTable(Table):
    """``[[cutting_test]]``."""

    file: q.OneFile
    spindle_speed: q.Rotation
    depth_of_cut: q.NoLength
    cut: q.CutName
    width_of_cut: q.PositiveLength
    feed_per_tooth: q.PositiveLength | None = None
    observed: Annotated[str, q.one_of(("stable", "chatter"), "verdict")] | None = None
    controller: StrictStr | None = None
    position: StrictStr | None = None
    feed: q.Feed | None = None
    quantity: Annotated[str, q.one_of(QUANTITIES, "quantity")] | None = None
    interval: q.Interval | None = None
    axes: Annotated[tuple[q.Axis, ...], q.NotEmpty] | None = None
    frequency_range: q.FrequencyRange | None = None
    floor: q.Floor | None = None
    half_order_reference: Annotated[float, q.at_least_zero] | None = None
    held_out: StrictBool = False
    channels: Annotated[Channels, Field(default_factory=dict)]


# --- What is known of the machine: models and the baseline of a diagnosis.


class UncertaintyTable(Table):
    """``uncertainty`` of a model: relative standard deviations that hold for all its modes."""

    frequency: q.Share = 0.0
    damping: q.Share = 0.0
    stiffness: q.Share = 0.0


class ModelTable(Table):
    """``[[model]]``."""

    name: q.Name
    modes: Annotated[tuple[ModeTable, ...], q.NotEmpty]
    uncertainty: UncertaintyTable | None = None

    @model_validator(mode="after")
    def _possible(self) -> ModelTable:
        self.build()
        return self

    def build(self) -> ModalModel:
        """Return the modal model."""
        return modal_model(self.modes)


EVIDENCE = ("drive", "limits")
"""What a baseline of an axis can be compared with besides compliances: drive records, limits of cutting tests."""


class AxisBaseline(Table):
    """``[baseline]`` that predicts compliances: one feed axis of two masses."""

    axis: q.Axis
    moving_mass: PositiveMass
    tip_mass: PositiveMass
    stiffness: q.Stiffness
    damping: Viscosity
    Kp: Viscosity | None = None
    Ti: PositiveTime | None = None
    Kv: q.PositiveFrequency | None = None
    delay: Delay = 0.0
    period: Delay | None = None
    controllers: dict[StrictStr, ServoTable] | None = None
    friction: FrictionTable
    evidence: tuple[Annotated[str, q.one_of(EVIDENCE, "evidence")], ...] = ()
    known: dict[StrictStr, dict[StrictStr, StrictStr]] | None = None

    @model_validator(mode="after")
    def _one_servo(self) -> AxisBaseline:
        single = [self.Kp, self.Ti, self.Kv]
        if (None in single) == (self.controllers is None):
            raise InputError(
                "needs Kp, Ti and Kv of its servo, or controllers = { K2 = { Kp = ..., Ti = ..., Kv = ... } }; give one"
            )
        for servo in self.servos().values():
            # Its samples act on the gains by T/(2 Ti) and Kv T/2 to first order.
            longest = min(servo.Ti, 1.0 / servo.Kv)
            if self.period is not None and self.period >= longest:
                raise InputError(
                    f"period of {1e3 * self.period:g} ms between samples of a control with Ti = {1e3 * servo.Ti:g} ms "
                    f"and Kv = {servo.Kv:g} 1/s; it must be shorter than {1e3 * longest:g} ms: check its unit"
                )
        self.friction.build()
        return self

    def servos(self) -> dict[str, Servo]:
        """Return the servo of each controller; a single one has no name."""
        if self.controllers is not None:
            return {name: table.build() for name, table in self.controllers.items()}
        assert self.Kp is not None
        assert self.Ti is not None
        assert self.Kv is not None
        return {"": Servo(self.Kp, self.Ti, self.Kv, self.delay)}


_SHARP = 1e6
"""Sharpness [s/m] of a friction curve about rest where none is given."""


class DriveBaseline(Table):
    """``[baseline]`` that predicts the drive force of a moving axis: rigid, with viscous friction."""

    drive: Annotated[str, q.one_of(("rigid",), "drive")]
    axis: q.Axis
    moving_mass: PositiveMass | None = None
    Kp: Annotated[float, q.quantity("viscosity", above=0.0)] | None = None
    Kv: q.PositiveFrequency | None = None
    delay: Delay = 0.0
    friction: FrictionTable | None = None
    known: dict[StrictStr, dict[StrictStr, StrictStr]] | None = None

    @model_validator(mode="after")
    def _curve(self) -> DriveBaseline:
        if self.friction is not None:
            laws = ("viscous", "coulomb", "coulomb_viscous", "andersson")
            if self.friction.law not in laws or self.friction.negative is not None:
                raise InputError(
                    f"friction of drive records is one of {', '.join(laws)}, alike in both directions; "
                    "what differs is found"
                )
            self.law()
        return self

    def law(self) -> FrictionLaw | None:
        """Return the law of the friction; over how far a guideway gives way before it slides the records tell."""
        if self.friction is None:
            return None
        sharp = {} if self.friction.law != "andersson" or self.friction.kt is not None else {"kt": _SHARP}
        return cast(FrictionLaw, self.friction.model_copy(update=sharp).build())

    @model_validator(mode="after")
    def _both_gains(self) -> DriveBaseline:
        if (self.Kp is None) != (self.Kv is None):
            raise InputError("needs Kp and Kv for the control law, or neither; give both")
        return self


class ForcesBaseline(Table):
    """``[baseline]`` that predicts the forces of the cutting tests: ``[tool]`` and ``[material]``, nothing else."""

    forces: Annotated[str, q.one_of(("mechanistic",), "forces")]
    known: dict[StrictStr, dict[StrictStr, StrictStr]] | None = None


class ModesBaseline(Table):
    """``[baseline]`` that predicts compliances from those of one measurement or model."""

    source: StrictStr = Field(alias="from")
    known: dict[StrictStr, dict[StrictStr, StrictStr]] | None = None


class LimitsBaseline(Table):
    """``[baseline]`` that predicts the limits that cutting tests found: a model, ``[tool]`` and ``[material]``."""

    limits: StrictStr
    known: dict[StrictStr, dict[StrictStr, StrictStr]] | None = None


# --- What is asked for.


class LobesTable(Table):
    """``[[lobes]]``."""

    measurements: Annotated[tuple[StrictStr, ...], q.NotEmpty]
    method: Annotated[str, q.one_of(q.LOBE_METHODS, "method")]
    cut: q.Engaged
    width_of_cut: q.Widths = ()
    offset: q.Length | None = None
    entry_angle: q.Angle | None = None
    exit_angle: q.Angle | None = None
    strips: q.Strips | None = None
    feed_per_tooth: q.PositiveLength
    spindle_speed: q.LobeSpeeds
    feed_direction: q.FeedDirection = 0.0
    feed: Annotated[float, q.quantity("speed", above=0.0)] | None = None
    controller: StrictStr | None = None
    position: StrictStr | None = None
    maximum_depth: q.PositiveLength | None = None
    process_damping: Annotated[float, q.quantity("line_force", low=0.0)] = 0.0
    flank_friction: Annotated[float, Field(ge=0.0, le=2.0)] | None = None
    bands_up_to: q.PositiveLength | None = None
    maps_up_to: q.PositiveLength | None = None
    spindle_power: Annotated[float, q.quantity("power", above=0.0)] | None = None
    spindle_torque: Annotated[float, q.quantity("torque", above=0.0)] | None = None
    deflection: q.PositiveLength | None = None
    surface_error: q.PositiveLength | None = None

    @model_validator(mode="after")
    def _vibration_of_a_sharp_edge(self) -> LobesTable:
        keys = [k for k in ("maps_up_to", "deflection", "surface_error") if getattr(self, k) is not None]
        if keys and self.process_damping > 0.0:
            raise InputError(
                f"gives {keys[0]} and a process_damping; the vibration of a stable cut is known of a sharp edge alone: "
                "leave one of both out"
            )
        if keys and self.method == "operating_point":
            raise InputError(
                f'gives {keys[0]} with method = "operating_point", whose compliance is another at each depth; ask for '
                "it with another method, of a measurement or a model"
            )
        return self

    @model_validator(mode="after")
    def _of_a_worn_flank(self) -> LobesTable:
        if self.process_damping > 0.0 and self.method == "operating_point":
            raise InputError(
                'gives a process_damping, which method = "operating_point" does not know; leave it out, or ask for '
                "another method"
            )
        if self.flank_friction is not None and self.process_damping == 0.0:
            raise InputError('gives a flank_friction and no process_damping; say it, e.g. "20 N/mm"')
        return self

    @model_validator(mode="after")
    def _bands_in_time(self) -> LobesTable:
        if self.bands_up_to is not None and self.method != "semi_discretization":
            raise InputError(
                f'gives bands_up_to with method = "{self.method}"; all bands of depth are found by method = '
                '"semi_discretization" alone: ask for it, or leave bands_up_to out'
            )
        return self

    @model_validator(mode="after")
    def _of_one_condition(self) -> LobesTable:
        for key in ("feed", "controller", "position"):
            moving = self.method == "operating_point" or MACHINE in self.measurements
            if getattr(self, key) is not None and not moving:
                raise InputError(
                    f'gives a {key}, which method = "operating_point" and the machine of [machine] ask for; another '
                    "method takes a measurement as it was made: leave it out, and name the measurement"
                )
        return self


class PassTable(Table):
    """One entry of ``passes``."""

    cut: q.CutName
    width_of_cut: q.PositiveLength


class PlanTable(Table):
    """``[plan]``; what is left out does not limit, or has the default that `docs/plan.md` lists."""

    machine: StrictStr | None = None
    scenario: StrictStr | None = None
    controller: StrictStr | None = None
    frequency_range: q.FrequencyRange = (20.0, 80.0)
    passes: tuple[PassTable, ...] = ()
    width_of_cut: Lengths | None = None
    inserts: tuple[Annotated[StrictInt, Field(ge=1)], ...] = ()
    feed_per_tooth: Lengths = (0.05e-3, 0.2e-3)
    depth_of_cut: Lengths = (0.5e-3, 4e-3)
    spindle_acceleration: Annotated[float, q.quantity("rotation_rate", above=0.0)] | None = None
    power: Annotated[float, q.quantity("power", above=0.0)] | None = None
    torque: Annotated[float, q.quantity("torque", above=0.0)] | None = None
    largest_force: Annotated[float, q.quantity("force", above=0.0)] | None = None
    feed: Speeds | None = None
    stroke: q.PositiveLength | None = None
    stock_length: q.PositiveLength | None = None
    longest_pass: PositiveTime = 90.0
    time: PositiveTime | None = None
    repeats: Annotated[StrictInt, Field(ge=1, le=100)] = 1
    largest_error: q.Share = 0.1
    chatter_margin: q.Share = 0.5
    acceleration_noise: Annotated[Triple, triple("acceleration", low=0.0)] = (0.012, 0.012, 0.012)
    force_noise: Annotated[Triple, triple("force", low=0.0)] = (1.5, 1.5, 1.5)
    sample_rate: q.PositiveFrequency = 5000.0
    lead: Delay = 0.5
    tail: Delay = 2.0

    @model_validator(mode="after")
    def _possible(self) -> PlanTable:
        if self.machine is not None and self.scenario is not None:
            raise InputError("names a machine of this file and a scenario; one estimate of the machine is needed")
        if 0 < len(self.passes) < 3:
            raise InputError(
                f"has {len(self.passes)} passes; nine compliances need three that push in different directions: add "
                "one, or leave passes out and have them found"
            )
        if min(self.largest_error, self.chatter_margin) <= 0.0:
            raise InputError("largest_error and chatter_margin must be above zero, e.g. '10 %' and '50 %'")
        if self.longest_pass < 1.0:
            raise InputError(f"longest_pass is {self.longest_pass:g} s; a sweep takes at least 1 s, better 10 s")
        if self.frequency_range[0] < 5.0:
            raise InputError(
                f"frequency_range begins at {self.frequency_range[0]:g} Hz; below 5 Hz an acceleration does not give "
                "the displacement: begin higher"
            )
        if self.frequency_range[1] > 0.2 * self.sample_rate:
            raise InputError(
                f"frequency_range ends at {self.frequency_range[1]:g} Hz, sampled at {self.sample_rate:g} Hz; sample "
                f"at {self.frequency_range[1] / 0.2:g} Hz or more"
            )
        return self


# --- The whole file.

B = TypeVar("B", bound=Table)


class CampaignFile(Table, Generic[B]):
    """The whole file, with one kind of baseline."""

    campaign: CampaignTable
    tool: ToolTable | None = None
    material: MaterialTable | None = None
    channels: Annotated[Channels, Field(default_factory=dict)]
    measurement: tuple[MeasurementTable, ...] = ()
    model: tuple[ModelTable, ...] = ()
    baseline: B | None = None
    machine: MachineTable | None = None
    spindle: SpindleTable | None = None
    lobes: tuple[LobesTable, ...] = ()
    cutting_test: tuple[CuttingTestTable, ...] = ()
    plan: PlanTable | None = None
    tune: TuneTable | None = None
    tolerances: TolerancesTable | None = None

    def machine_model(self) -> Machine | ModalModel | None:
        """Return the machine of ``[machine]``; None where nothing says what it is made of."""
        return None if self.machine is None else self.machine.build()


class ModesFile(CampaignFile[ModesBaseline]):
    """The whole file where the baseline has modes: the axes of its machine may carry them."""

    machine: OpenMachineTable | None = None

    @model_validator(mode="after")
    def _asked_machine(self) -> ModesFile:
        self.machine_model()
        return self

    def machine_model(self) -> Machine | ModalModel | None:
        """Return the machine; its axes carry the modes of the ``[[model]]`` that the baseline names."""
        own = super().machine_model()
        if own is not None or self.machine is None or self.baseline is None or not self.machine.axis:
            return own
        asked = any(MACHINE in lobes.measurements for lobes in self.lobes)
        modes = next((m for m in self.model if m.name == self.baseline.source), None)
        if modes is None and asked:
            raise InputError(
                f"lobes of the machine are asked for, and its modes are those of '{self.baseline.source}', which only "
                "a diagnosis identifies: name a [[model]] in from of [baseline], or ask for these lobes in the "
                "campaign of the extended model that `smfe diagnose` writes"
            )
        try:
            return None if modes is None else self.machine.carrying(modes.build())
        except InputError:
            if asked:
                raise
            return None


def file_table(raw: Mapping[str, Any]) -> type[CampaignFile[Any]]:
    """Return the table of a whole file: the keys of its baseline tell of which kind that is."""
    keys = raw["baseline"] if isinstance(raw.get("baseline"), dict) else {}
    if "drive" in keys:
        return CampaignFile[DriveBaseline]
    if "forces" in keys:
        return CampaignFile[ForcesBaseline]
    if "limits" in keys:
        return CampaignFile[LimitsBaseline]
    return ModesFile if "from" in keys else CampaignFile[AxisBaseline]
