"""The campaign file: what was measured, with what, and what is asked for."""

from smfe.campaign.campaign import (
    AxisModel,
    Baseline,
    Campaign,
    Conditions,
    CuttingTest,
    LimitsOf,
    LobeRequest,
    Measurement,
    MechanisticForces,
    Model,
    ModesOf,
    OtherRecorder,
    RecordEntry,
    RigidDrive,
    load_campaign,
    load_channels,
)

__all__ = [
    "AxisModel",
    "Baseline",
    "Campaign",
    "Conditions",
    "CuttingTest",
    "LimitsOf",
    "LobeRequest",
    "Measurement",
    "MechanisticForces",
    "Model",
    "ModesOf",
    "OtherRecorder",
    "RecordEntry",
    "RigidDrive",
    "load_campaign",
    "load_channels",
]
