"""The campaign file as it is written, table by table; every field comes out in SI (spindle speeds in rpm)."""

from __future__ import annotations

import math
from datetime import date, datetime
from typing import Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, StrictInt, StrictStr, model_validator

from process.compliance import ModalModel
from process.cutting import CuttingCoefficients
from process.errors import InputError
from process.servo import Servo
from process.tool import Tool
from smfe.campaign import quantities as q
from smfe.campaign.machine_tables import Delay, FrictionTable, PositiveMass, PositiveTime, ServoTable, Viscosity
from smfe.campaign.tables import Table
from smfe.records.channels import check_channel_name


class CampaignTable(Table):
    """``[campaign]``."""

    name: q.Name


class ToolTable(Table):
    """``[tool]``."""

    diameter: q.PositiveLength
    teeth: StrictInt
    approach_angle: q.Angle = math.pi / 2
    pitch_angles: tuple[q.Angle, ...] | None = None
    runout: tuple[q.Length, ...] | None = None
    helix_angle: q.Angle = 0.0

    @model_validator(mode="after")
    def _possible(self) -> ToolTable:
        self.build()
        return self

    def build(self) -> Tool:
        """Return the tool."""
        return Tool(**dict(self))


class MaterialTable(Table):
    """``[material]``."""

    name: StrictStr | None = None
    Ktc: q.Pressure
    Krc: q.Pressure
    Kac: q.Pressure
    Kte: q.LineForce = 0.0
    Kre: q.LineForce = 0.0
    Kae: q.LineForce = 0.0

    @model_validator(mode="after")
    def _possible(self) -> MaterialTable:
        self.build()
        return self

    def build(self) -> CuttingCoefficients:
        """Return the cutting coefficients."""
        return CuttingCoefficients(self.Ktc, self.Krc, self.Kac, self.Kte, self.Kre, self.Kae)


class ChannelTable(Table):
    """One entry of ``[channels]``; what is missing is inherited."""

    column: q.Column | None = None
    unit: StrictStr | None = None
    sign: q.Sign = 1.0
    scale: q.Ratio = 1.0
    delay: q.Time = 0.0
    sample_rate: q.PositiveFrequency | None = None
    pulses_per_revolution: Annotated[float, Field(gt=0.0)] | None = None


Channels = dict[Annotated[str, BeforeValidator(check_channel_name)], ChannelTable]


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


class RecordTable(ConditionsTable):
    """One entry of ``records``."""

    file: q.Files
    excitation: q.Axis | None = None
    response: q.Axis | None = None
    cut: q.CutName | None = None
    width_of_cut: q.PositiveLength | None = None
    channels: Annotated[Channels, Field(default_factory=dict)]


class MeasurementTable(ConditionsTable):
    """``[[measurement]]``."""

    name: q.Name
    method: Annotated[str, q.one_of(q.METHODS, "method")]
    records: Annotated[tuple[RecordTable, ...], q.NotEmpty]
    background: q.Files | None = None
    frequency_range: q.FrequencyRange | None = None
    resolution: q.PositiveFrequency | None = None
    references: Annotated[str, q.one_of(("all", "x"), "references")] = "all"
    channels: Annotated[Channels, Field(default_factory=dict)]


class ModeTable(Table):
    """One entry of ``modes``."""

    frequency: q.PositiveFrequency
    damping: q.Ratio
    stiffness: q.Stiffness
    direction: tuple[float, float, float]


class ModelTable(Table):
    """``[[model]]``."""

    name: q.Name
    modes: Annotated[tuple[ModeTable, ...], q.NotEmpty]

    @model_validator(mode="after")
    def _possible(self) -> ModelTable:
        self.build()
        return self

    def build(self) -> ModalModel:
        """Return the modal model."""
        return ModalModel(
            frequency=np.array([mode.frequency for mode in self.modes]),
            damping=np.array([mode.damping for mode in self.modes]),
            stiffness=np.array([mode.stiffness for mode in self.modes]),
            direction=np.array([mode.direction for mode in self.modes]),
        )


class BaselineTable(Table):
    """``[baseline]``: the simulation that a diagnosis questions, one feed axis of two masses."""

    axis: q.Axis
    moving_mass: PositiveMass
    tip_mass: PositiveMass
    stiffness: q.Stiffness
    damping: Viscosity
    Kp: Viscosity | None = None
    Ti: PositiveTime | None = None
    Kv: q.PositiveFrequency | None = None
    delay: Delay = 0.0
    controllers: dict[StrictStr, ServoTable] | None = None
    friction: FrictionTable

    @model_validator(mode="before")
    @classmethod
    def _an_axis(cls, table: Any) -> Any:
        if isinstance(table, dict) and "from" in table:
            raise InputError(
                "a baseline from a measurement is not available; give the axis: axis, moving_mass, tip_mass, "
                "stiffness, damping, Kp, Ti, Kv, friction"
            )
        return table

    @model_validator(mode="after")
    def _one_servo(self) -> BaselineTable:
        single = [self.Kp, self.Ti, self.Kv]
        if (None in single) == (self.controllers is None):
            raise InputError(
                "needs Kp, Ti and Kv of its servo, or controllers = { K2 = { Kp = ..., Ti = ..., Kv = ... } }; give one"
            )
        self.servos()
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


class LobesTable(Table):
    """``[[lobes]]``."""

    measurements: Annotated[tuple[StrictStr, ...], q.NotEmpty]
    method: Annotated[str, q.one_of(q.LOBE_METHODS, "method")]
    cut: q.CutName
    width_of_cut: q.PositiveLength
    feed_per_tooth: q.PositiveLength
    spindle_speed: q.SpeedRange


class CuttingTestTable(Table):
    """``[[cutting_test]]``."""

    file: q.OneFile
    spindle_speed: q.Rotation
    depth_of_cut: q.PositiveLength
    cut: q.CutName
    width_of_cut: q.PositiveLength
    feed_per_tooth: q.PositiveLength
    observed: Annotated[str, q.one_of(("stable", "chatter"), "verdict")] | None = None
    channels: Annotated[Channels, Field(default_factory=dict)]


class CampaignFile(Table):
    """The whole file."""

    campaign: CampaignTable
    tool: ToolTable | None = None
    material: MaterialTable | None = None
    channels: Annotated[Channels, Field(default_factory=dict)]
    measurement: tuple[MeasurementTable, ...] = ()
    model: tuple[ModelTable, ...] = ()
    baseline: BaselineTable | None = None
    lobes: tuple[LobesTable, ...] = ()
    cutting_test: tuple[CuttingTestTable, ...] = ()
