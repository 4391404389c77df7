"""The campaign file as it is written, table by table; every field comes out in SI (spindle speeds in rpm)."""

from __future__ import annotations

import math
from datetime import date, datetime
from typing import Annotated

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StrictInt, StrictStr, model_validator

from process.compliance import ModalModel
from process.cutting import CuttingCoefficients
from process.tool import Tool
from smfe.campaign import quantities as q
from smfe.records.channels import check_channel_name


class Table(BaseModel):
    """A table of the file: unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


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
    channels: Channels = {}


class MeasurementTable(ConditionsTable):
    """``[[measurement]]``."""

    name: q.Name
    method: Annotated[str, q.one_of(q.METHODS, "method")]
    records: Annotated[tuple[RecordTable, ...], q.NotEmpty]
    background: q.Files | None = None
    frequency_range: q.FrequencyRange | None = None
    resolution: q.PositiveFrequency | None = None
    references: Annotated[str, q.one_of(("all", "x"), "references")] = "all"
    channels: Channels = {}


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
    channels: Channels = {}


class CampaignFile(Table):
    """The whole file."""

    campaign: CampaignTable
    tool: ToolTable | None = None
    material: MaterialTable | None = None
    channels: Channels = {}
    measurement: tuple[MeasurementTable, ...] = ()
    model: tuple[ModelTable, ...] = ()
    lobes: tuple[LobesTable, ...] = ()
    cutting_test: tuple[CuttingTestTable, ...] = ()
