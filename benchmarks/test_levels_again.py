"""Levels of hammer hits: a run that reads back what an earlier one has identified against one that identifies."""

import time
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from process.labels import make_record
from smfe.campaign import load_campaign
from smfe.identification.measurement import split_levels
from smfe.records.write import write_record_netcdf

RATE = 5000.0


def write(folder: Path) -> Path:
    """Forty hits at two levels on one mass on a spring, x only."""
    rng = np.random.default_rng(1)
    t = np.arange(round(80.0 * RATE)) / RATE
    force = np.zeros(t.size)
    for k in range(40):
        u = (t - 0.2 - 2.0 * k) / 5e-3
        force += np.where((u > 0.0) & (u < 1.0), (100.0, 400.0)[k % 2] * np.sin(np.pi * np.clip(u, 0.0, 1.0)), 0.0)
    short = t[: round(1.8 * RATE)]
    kernel = np.exp(-7.5 * short) * np.sin(387.0 * short) / (20.0 * 387.0) / RATE
    moved = np.convolve(force, kernel)[: t.size] + 1e-9 * rng.standard_normal(t.size)
    channels = {"force": {"x": force + 0.01 * rng.standard_normal(t.size)}, "displacement": {"x": moved}}
    write_record_netcdf(make_record(t, channels), folder / "hits.nc")
    text = '[campaign]\nname = "levels"\n[[measurement]]\nname = "hammer"\nmethod = "hammer"\nsplit_levels = true\n'
    text += 'frequency_range = ["20 Hz", "120 Hz"]\nrecords = [ { file = "hits.nc", excitation = "x" } ]\n'
    (folder / "campaign.toml").write_text(text)
    return folder / "campaign.toml"


@pytest.mark.benchmark(group="kept levels")
def test_levels_are_read_back(benchmark, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    loaded, kept = load_campaign(write(tmp_path)), tmp_path / "kept"
    start = time.perf_counter()
    first = split_levels(loaded, kept)
    seconds = time.perf_counter() - start
    again = benchmark(split_levels, loaded, kept)
    xr.testing.assert_identical(first["hammer, by level"], again["hammer, by level"])
    back = benchmark.stats.stats.min
    benchmark.extra_info.update(times_faster_than_identified=round(seconds / back))
    print(f"\nidentified in {seconds:.2f} s, read back in {back:.3f} s: {seconds / back:.0f} times")
    assert back < 0.5 * seconds
