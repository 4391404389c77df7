"""A quasi-FRF by harmonic balance against the time simulation of as many stepped-sine points, in one run."""

import time

import numpy as np
import pytest

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.friction.laws import Andersson
from process.friction.linearised import equivalent_damping
from process.harmonic_balance.many_harmonics import multi_harmonic
from process.harmonic_balance.one_harmonic import single_harmonic
from process.harmonic_balance.quasi_frf import network, quasi_compliance
from process.machine.machine import FeedAxis, Machine
from process.machine.structure import two_mass_axes
from process.simulation.excitation import SteppedSine
from process.simulation.machine import simulate_machine

MM_MIN = 1.0 / 60e3
BENCH = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)
FREQUENCY = np.linspace(20.0, 95.0, 1100)
SERVO = Servo(6268.0, 10.9e-3, 45.5)
DRIVE = Drive(23.1, 11.3, 1.68e6, 104.0, SERVO)
ONE, FEED = Machine.of_axis(DRIVE, BENCH), 500.0 * MM_MIN
AXIS = network(ONE, FEED)
FEW = np.arange(25, FREQUENCY.size, 250)


def stepped_sine(frequency: float, force: float, feed: float) -> complex:
    """One point by time simulation: phasor over the last whole periods of 4 s."""
    sine = {"x": SteppedSine((float(frequency),), force, 4.0, 0.0)}
    record = simulate_machine(ONE, duration=4.0, feed=feed, forces=sine, sample_rate=100.0 * frequency)
    shown = slice(-100 * int(frequency), None)
    wave = np.exp(-2j * np.pi * frequency * record["time"].values[shown])
    x, push = (record[name].values[0, shown] @ wave for name in ("displacement", "force"))
    return complex(x / push)


@pytest.mark.benchmark(group="harmonic balance")
def test_single_harmonic_frf_against_a_bisection_for_each_frequency(benchmark) -> None:
    found = single_harmonic(AXIS, 50.0, FREQUENCY)
    benchmark(single_harmonic, AXIS, 50.0, FREQUENCY)
    few = np.arange(0, FREQUENCY.size, 100)
    start = time.perf_counter()
    g, s = AXIS.matrix(FREQUENCY[few]), 2j * np.pi * FREQUENCY[few]
    low, high = np.full(few.size, 1e-9), np.full(few.size, 1.0)
    for _ in range(60):
        middle = np.sqrt(low * high)
        loop = np.abs(1.0 + s * g[:, 3, 3] * equivalent_damping(BENCH, FEED, middle))
        above = middle * loop > np.abs(s * g[:, 3, 0]) * 50.0
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    seconds = (time.perf_counter() - start) / few.size * FREQUENCY.size
    np.testing.assert_allclose(np.abs(found.fundamental[few, 0]), middle, rtol=2e-3)
    if benchmark.stats is not None:
        print(f"\nbisection {seconds * 1e3:.0f} ms, table {benchmark.stats.stats.median * 1e3:.1f} ms")


@pytest.mark.benchmark(group="harmonic balance")
def test_many_harmonics(benchmark) -> None:
    f = np.linspace(60.0, 75.0, 150)
    start = single_harmonic(AXIS, 50.0, f)
    balance = benchmark(multi_harmonic, AXIS, 50.0, f, 25, start)
    assert balance.converged.all()


@pytest.mark.benchmark(group="harmonic balance")
@pytest.mark.parametrize(("feed", "force"), [(500.0, 50.0), (250.0, 60.0), (0.0, 50.0)])
def test_quasi_frf_against_stepped_sines(benchmark, feed: float, force: float) -> None:
    def found_at(frequency: np.ndarray):  # type: ignore[no-untyped-def]
        return quasi_compliance(ONE, frequency, force, feed * MM_MIN, excitation=["x"], response=["x"])

    found_at(FREQUENCY[::100])
    result = benchmark.pedantic(found_at, (FREQUENCY,), rounds=2)
    found = result["compliance"].values[FEW, 0, 0]
    # A part of the points is simulated, and its time scaled to all of them.
    stepped_sine(40.0, force, feed * MM_MIN)
    start = time.perf_counter()
    simulated = np.array([stepped_sine(f, force, feed * MM_MIN) for f in FREQUENCY[FEW]])
    seconds = (time.perf_counter() - start) / FEW.size * FREQUENCY.size
    error = np.abs(found / simulated - 1.0)
    assert error.max() < 3e-3
    if benchmark.stats is not None:
        own_time = benchmark.stats.stats.min
        print(
            f"\nfeed {feed:g} mm/min, {force:g} N: {FREQUENCY.size} points in {own_time:.2f} s, time simulation "
            f"{seconds:.0f} s (from {FEW.size} points), ratio {seconds / own_time:.0f}; they differ by at most "
            f"{error.max():.1e}"
        )


@pytest.mark.benchmark(group="harmonic balance")
def test_two_axes_with_one_harmonic(benchmark) -> None:
    machine = Machine(two_mass_axes({"x": DRIVE, "y": DRIVE}), dict.fromkeys("xy", FeedAxis(SERVO, BENCH)))
    args = (machine, FREQUENCY, 50.0, 500.0 * MM_MIN)
    found = benchmark(quasi_compliance, *args, excitation=["x", "y"], tolerance=np.inf)
    assert found.attrs["status"] == "ok"
