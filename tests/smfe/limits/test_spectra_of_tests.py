"""What is stored beside the spectrum of a cutting test: predictions of the sources alone, and the threshold."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from smfe.limits.cutting_tests import _spectrum_of
from stability import chatter_verdict


def record(chatter: float) -> xr.Dataset:
    time = np.arange(0.0, 6.0, 1e-3)
    motion = 2.0 * np.sin(2 * np.pi * 40.0 * time) + chatter * np.sin(2 * np.pi * 57.3 * time)
    noise = 1e-3 * np.random.default_rng(1).standard_normal((1, time.size))
    data = {"acceleration": (("axis", "time"), motion + noise, {"units": "m/s^2"})}
    return xr.Dataset(data, {"axis": ["x"], "time": ("time", time, {"units": "s"})})


@pytest.mark.parametrize(("chatter", "verdict"), [(3.0, "chatter"), (0.05, "stable")])
def test_the_threshold_parts_the_lines_of_the_spectrum(chatter: float, verdict: str) -> None:
    found = chatter_verdict(record(chatter), 2 * np.pi * 20.0, 2)
    assert found.verdict == verdict
    row = {
        "predicted_sweep": "chatter",
        "frequency_sweep_Hz": 57.0,
        "frequency_low_Hz": 5.0,
        "frequency_high_Hz": 400.0,
    }
    test = SimpleNamespace(file=SimpleNamespace(name="cut.csv"), spindle_speed=1200.0, depth_of_cut=3e-3)
    stored = _spectrum_of(test, found, 2, row)  # type: ignore[arg-type]
    # The ends of the band are no prediction.
    assert json.loads(stored.attrs["predicted_Hz"]) == {"sweep": 57.0}
    assert stored.attrs["threshold_axis"] == "x"
    # Half of the tooth passing line, an amplitude of 2 m/s^2.
    assert stored.attrs["threshold_amplitude"] == pytest.approx(1.0, rel=0.02)
    line = stored["amplitude"].sel(axis="x", frequency=slice(55.0, 60.0)).max().item()
    assert (line > stored.attrs["threshold_amplitude"]) == (verdict == "chatter")
