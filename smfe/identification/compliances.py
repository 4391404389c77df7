"""The compliances of a campaign, labelled with what they were measured under."""

from __future__ import annotations

import json
from collections.abc import Mapping

import numpy as np
import xarray as xr

from process.machine.modes import ModalModel
from process.units import show
from smfe.campaign import Campaign, Measurement
from smfe.identification.errors.result import Identification


def labelled(campaign: Campaign, found: Mapping[str, Identification]) -> dict[str, xr.Dataset]:
    """Return measurement or model -> compliance, of the measurements that were identified and of all models."""
    out = {}
    for measurement in (m for m in campaign.measurements if m.name in found):
        item = found[measurement.name]
        labels = {"method": item.method, "conditions": json.dumps(conditions(measurement))}
        out[measurement.name] = item.compliance.assign_attrs(labels)
    out.update({m.name: of_model(m.modal) for m in campaign.models})
    return out


def conditions(measurement: Measurement) -> dict[str, str]:
    """Return what a measurement was made under, as a reader of the report would write it."""
    out = {"controller": measurement.controller, "position": measurement.position}
    if measurement.feed is not None:
        feeds = {a: show(v, "mm/min", "speed") for a, v in measurement.feed.items()}
        same = len(set(feeds.values())) == 1
        out["feed"] = next(iter(feeds.values())) if same else ", ".join(f"{a} {v}" for a, v in feeds.items())
    for name, unit, dimension in (
        ("force_level", "N", "force"),
        ("depth_of_cut", "mm", "length"),
        ("feed_per_tooth", "mm", "length"),
        ("added_mass", "kg", "mass"),
        ("temperature", "degC", "temperature"),
    ):
        value = getattr(measurement, name)
        if value is not None:
            out[name] = show(value, unit, dimension)
    return {name: text for name, text in out.items() if text is not None}


def of_model(modal: ModalModel) -> xr.Dataset:
    """Sample a modal model: at least ten points in the narrowest half-power band, up to three times the last mode."""
    band = float(np.min(2.0 * modal.damping * modal.frequency))
    step = min(0.25, band / 10.0)
    frequency = np.arange(1.0, 3.0 * float(modal.frequency.max()), step)
    return modal.compliance(frequency).assign_attrs(method="model")
