"""Zero-order envelope: the tracked branches against a plain NumPy scan of the phase condition, in one run."""

import math
import time

import numpy as np
import pytest

from process import directional_matrix, engagement
from smfe.demo_campaign import MACHINE, MATERIAL, TOOL
from stability import zero_order

ARC = engagement("down", 0.04, 0.08)
FREQUENCY = np.linspace(5.0, 205.0, 10_000)
SPEED = np.linspace(600.0, 1500.0, 1000)


def scan(matrix: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """Smallest limit [mm] at each speed by sign changes of Im(1/(mu (1 - exp(-j w T)))) between samples."""
    mu = np.linalg.eigvals(directional_matrix(TOOL, ARC, MATERIAL) @ matrix)
    w = 2 * math.pi * FREQUENCY
    out = np.full(speeds.size, np.inf)
    for i, n in enumerate(speeds):
        inverse = 1.0 / (mu * (1.0 - np.exp(-1j * w * 60.0 / (TOOL.teeth * n)))[:, None])
        change = np.sign(inverse.imag[1:]) != np.sign(inverse.imag[:-1])
        depth = np.where(change & (inverse.real[1:] > 0), inverse.real[1:], np.inf)
        out[i] = 1e3 * depth.min()
    return out


@pytest.mark.benchmark(group="lobes")
def test_envelope_against_a_plain_scan(benchmark) -> None:
    compliance = MACHINE.compliance(FREQUENCY)
    matrix = MACHINE.matrix(FREQUENCY)
    found = zero_order(compliance, TOOL, ARC, MATERIAL, SPEED)["limit_depth"].values
    benchmark(zero_order, compliance, TOOL, ARC, MATERIAL, SPEED)
    start = time.perf_counter()
    plain = scan(matrix, SPEED)
    seconds = time.perf_counter() - start
    # The plain scan takes eigenvalues as they come; where their order changes it sees crossings that are none.
    assert np.median(np.abs(plain / found - 1.0)) < 0.01
    benchmark.extra_info["times_faster_than_a_scan"] = round(seconds / benchmark.stats.stats.min, 1)
    print(f"\n{seconds / benchmark.stats.stats.min:.1f} times faster than a plain scan")
