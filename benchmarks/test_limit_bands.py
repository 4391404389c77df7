"""Bands on the limit and the boundary finder, each against the plain way, in one run."""

import time

import numpy as np
import pytest
from samples.linear_machine import MACHINE, MATERIAL, TOOL

from process import engagement
from process.labels import make_compliance
from stability import floquet_multipliers, zero_order
from stability.bands.depth_quantiles import linearised_band, sampled_band
from stability.bands.error_model import Spread
from stability.boundary import Axis, find_boundary, pointwise

ARC = engagement("down", 0.04, 0.08)
SPEED = np.linspace(300.0, 1500.0, 200)
SPREAD = Spread(coefficients=(0.05, 0.05, 0.05))


def measured():
    """A compliance of 560 lines whose errors are half a percent of its peak and shared by four lines."""
    frequency = np.arange(10.0, 150.0, 0.25)
    phi = MACHINE.matrix(frequency)
    std = np.full(phi.shape, 0.005 * np.abs(phi).max())
    extra = {"compliance_std": (("frequency", "response", "excitation"), std)}
    return make_compliance(frequency, phi, extra=extra, attrs={"error_lines": 4.0})


@pytest.mark.benchmark(group="bands")
@pytest.mark.parametrize("band", [sampled_band, linearised_band])
def test_a_band_over_two_hundred_speeds_against_its_limits_one_by_one(benchmark, band):
    compliance = measured()
    benchmark.pedantic(band, (compliance, TOOL, ARC, MATERIAL, SPEED, SPREAD), rounds=2, warmup_rounds=1)
    start = time.perf_counter()
    for _ in range(20):
        zero_order(compliance, TOOL, ARC, MATERIAL, SPEED)
    ratio = 10.0 * (time.perf_counter() - start) / benchmark.stats.stats.min
    benchmark.extra_info["two_hundred_zero_order_limits_over_this"] = round(ratio, 2)
    print(f"\n200 calls of zero_order take {ratio:.2f} times as long as {band.__name__}")


@pytest.mark.benchmark(group="boundary")
def test_the_boundary_against_a_plain_grid_of_the_same_cells(benchmark):
    def growth(speed, depth):
        return abs(floquet_multipliers(MACHINE, TOOL, ARC, MATERIAL, 1e-3 * depth, speed)[0]) - 1.0

    axes = Axis("speed", 600.0, 1500.0, 128, 16), Axis("depth", 0.5, 20.0, 128, 16)
    found = benchmark.pedantic(find_boundary, (pointwise(growth), *axes), rounds=1)
    ratio = found.plain_evaluations / found.evaluations
    benchmark.extra_info["fewer_evaluations_than_a_plain_grid"] = round(ratio, 1)
    print(f"\n{found.evaluations} evaluations, {ratio:.1f} times fewer than a plain grid of {found.plain_evaluations}")
    assert ratio > 3.0
