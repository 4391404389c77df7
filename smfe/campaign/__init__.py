"""The campaign file: what was measured, with what, and what is asked for."""

from smfe.campaign.campaign import (
    Campaign,
    Conditions,
    CuttingTest,
    LobeRequest,
    Measurement,
    Model,
    RecordEntry,
    load_campaign,
)

__all__ = [
    "Campaign",
    "Conditions",
    "CuttingTest",
    "LobeRequest",
    "Measurement",
    "Model",
    "RecordEntry",
    "load_campaign",
]
