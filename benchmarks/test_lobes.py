"""Zero-order envelope: the tracked branches against a plain NumPy scan of the phase condition, in one run."""

import math
import time
from collections.abc import Callable

import numpy as np
import pytest
from samples.linear_machine import MACHINE, MATERIAL, TOOL

from process import directional_matrix, engagement
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
    start = time.process_time()
    zero_order(compliance, TOOL, ARC, MATERIAL, SPEED)
    spent = time.process_time() - start
    print(
        f"\n{FREQUENCY.size} frequencies, {SPEED.size} speeds: {1e3 * spent:.0f} ms CPU, "
        f"{seconds / benchmark.stats.stats.min:.1f} times faster than a plain scan"
    )


def test_growth_with_frequencies_and_speeds() -> None:
    """Print the cost over the size of the problem; it grows at most in proportion to either."""
    cost = {}
    for lines, speeds in ((2500, 1000), (10_000, 1000), (40_000, 1000), (10_000, 250), (10_000, 4000)):
        compliance = MACHINE.compliance(np.linspace(5.0, 205.0, lines))
        at = np.linspace(600.0, 1500.0, speeds)
        zero_order(compliance, TOOL, ARC, MATERIAL, at)
        cost[lines, speeds] = min(
            _seconds(lambda c=compliance, n=at: zero_order(c, TOOL, ARC, MATERIAL, n)) for _ in "abc"
        )
    print("\nfrequencies  speeds  ms CPU")
    for (lines, speeds), spent in cost.items():
        print(f"{lines:11d}  {speeds:6d}  {1e3 * spent:6.1f}")
    assert cost[40_000, 1000] < 6.0 * cost[10_000, 1000]
    assert cost[10_000, 4000] < 6.0 * cost[10_000, 1000]


def _seconds(call: Callable[[], object]) -> float:
    start = time.process_time()
    call()
    return time.process_time() - start
