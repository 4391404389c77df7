"""The campaign file: what was measured, with what, and what is asked for."""

from smfe.campaign.campaign import (
    Baseline,
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
    "Baseline",
    "Campaign",
    "Conditions",
    "CuttingTest",
    "LobeRequest",
    "Measurement",
    "Model",
    "RecordEntry",
    "load_campaign",
]
