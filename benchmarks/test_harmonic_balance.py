"""A quasi-FRF by harmonic balance against the time simulation of as many stepped-sine points, in one run."""

import time

import numpy as np
import pytest

from process.equivalent_friction import equivalent_damping
from process.friction import Andersson
from process.harmonic_balance import SlidingAxis, multi_harmonic, quasi_frf, single_harmonic

MM_MIN = 1.0 / 60e3
BENCH = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)
FREQUENCY = np.linspace(20.0, 95.0, 1100)


def compliance(frequency: np.ndarray) -> np.ndarray:
    """The bench of the paper under K2, without friction: (tool, carriage)."""
    s = 2j * np.pi * frequency
    q = 104.0 * s + 1.68e6
    tip, carriage = 11.3 * s**2 + q, 23.1 * s**2 + q + 6268.0 * (s + 1.0 / 10.9e-3) * (s + 45.5) / s
    out = np.empty((s.size, 2, 2), dtype=complex)
    out[:, 0, 0], out[:, 1, 1], out[:, 0, 1], out[:, 1, 0] = carriage, tip, q, q
    return out / (tip * carriage - q**2)[:, None, None]


AXIS = SlidingAxis(compliance, BENCH, 500.0 * MM_MIN)


@pytest.mark.benchmark(group="harmonic balance")
def test_single_harmonic_frf_against_a_bisection_for_each_frequency(benchmark) -> None:
    found = single_harmonic(AXIS, 50.0, FREQUENCY)
    benchmark(single_harmonic, AXIS, 50.0, FREQUENCY)
    few = np.arange(0, FREQUENCY.size, 100)
    start = time.perf_counter()
    g, s = compliance(FREQUENCY[few]), 2j * np.pi * FREQUENCY[few]
    low, high = np.full(few.size, 1e-9), np.full(few.size, 1.0)
    for _ in range(60):
        middle = np.sqrt(low * high)
        loop = np.abs(1.0 + s * g[:, 1, 1] * equivalent_damping(BENCH, AXIS.feed, middle))
        above = middle * loop > np.abs(s * g[:, 1, 0]) * 50.0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    seconds = (time.perf_counter() - start) / few.size * FREQUENCY.size
    np.testing.assert_allclose(np.abs(found.velocity[few, 0]), middle, rtol=2e-3)
    if benchmark.stats is not None:
        assert seconds > 5.0 * benchmark.stats.stats.median


@pytest.mark.benchmark(group="harmonic balance")
def test_many_harmonics(benchmark) -> None:
    f = np.linspace(60.0, 75.0, 150)
    start = single_harmonic(AXIS, 50.0, f).velocity[:, 0]
    balance = benchmark(multi_harmonic, AXIS, 50.0, f, 25, start)
    assert balance.converged.all()


@pytest.mark.benchmark(group="harmonic balance")
def test_quasi_frf_with_automatic_choice(benchmark) -> None:
    result = benchmark(quasi_frf, AXIS, 50.0, FREQUENCY[::10])
    assert result.attrs["status"] == "ok"
