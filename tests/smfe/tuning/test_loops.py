"""Loops of many gains at once against one axis worked out alone, and against the machine of several axes."""

from collections.abc import Callable

import numpy as np
import pytest

from process import (
    Andersson,
    Drive,
    FeedAxis,
    Machine,
    ModalModel,
    Servo,
    Viscous,
    released_compliance,
    released_modes,
    tune,
)
from process.errors import InputError
from process.labels import label, make_compliance
from smfe.tuning.depths import Oriented
from smfe.tuning.loops import bandwidth, close, gains_of, largest_feed_forward, margins, peak_dB
from smfe.tuning.plants import MeasuredSource, ModelSource, grid_of

BENCH = Drive(23.1, 11.3, 1.68e6, 104.0)
ISOTROPIC = Oriented.of(np.eye(3), (0,))
RAM = ModalModel(
    [24.0, 29.0, 33.5], [0.022, 0.026, 0.03], [3e7, 4e7, 3.5e7], [(0.1, 1.0, 0.2), (0.7, 0.6, 0.1), (1.0, -0.2, 0.1)]
)
MASS = {"x": 9000.0, "y": 6000.0}


def bench(delay: float = 0.0, sigma: float = 0.0) -> ModelSource:
    return ModelSource(Machine.of_axis(Drive(23.1, 11.3, 1.68e6, 104.0, None, sigma)).at(), ("x",), (delay,))


def ram(servos: dict[str, Servo]) -> Machine:
    return Machine(released_modes(RAM, MASS), {a: FeedAxis(v, Viscous(2e4)) for a, v in servos.items()})


@pytest.mark.parametrize(("f", "delay"), [(15.0, 0.0), (49.0, 0.75e-3), (87.0, 0.0)])
def test_one_axis_has_the_loops_and_margins_of_its_drive(f: float, delay: float) -> None:
    servo = tune(f, 34.4, delay)
    drive = Drive(23.1, 11.3, 1.68e6, 104.0, servo)
    plant = bench(delay).plant(grid_of(bench(), 500.0, 6000))
    closed = close(plant, ISOTROPIC, np.array([gains_of([servo])]))
    np.testing.assert_allclose(closed.eigenvalue[0, 0], drive.tip_compliance(plant.frequency), rtol=1e-6)
    np.testing.assert_allclose(closed.velocity[0, 0], drive.velocity_loop().closed(plant.frequency), rtol=1e-6)
    both = drive.position_loop()(plant.frequency)
    share = servo.Kv / (2j * np.pi * plant.frequency + servo.Kv)
    np.testing.assert_allclose(closed.position[0, 0], share * both / (1.0 + both), rtol=1e-6)
    for loop, ours in ((drive.velocity_loop(), closed.velocity_open), (drive.position_loop(), closed.position_open)):
        gain, phase = margins(plant.frequency, ours)
        expected = loop.margins()
        np.testing.assert_allclose(gain[0, 0], 20.0 * np.log10(expected.gain), rtol=1e-3)
        np.testing.assert_allclose(phase[0, 0], np.degrees(expected.phase), rtol=1e-3)
    width = bandwidth(plant.frequency, closed.velocity)[0, 0]
    np.testing.assert_allclose(width, drive.velocity_loop().bandwidth(), rtol=1e-3)
    assert closed.unstable[0] == 0


def test_peaks_of_the_loops_are_those_of_the_paper_s_four_controllers() -> None:
    plant = bench().plant(grid_of(bench(), 500.0, 3000))
    closed = close(plant, ISOTROPIC, np.array([gains_of([tune(f, 34.4)]) for f in (15.0, 29.0, 49.0, 87.0)]))
    np.testing.assert_allclose(peak_dB(closed.velocity)[:, 0], [2.10, 2.12, 2.20, 2.54], atol=0.01)
    assert np.all(peak_dB(closed.position) < 0.0)
    assert np.all(peak_dB(closed.position + closed.ahead) > 3.9)


def test_the_largest_feed_forward_puts_the_position_loop_on_its_limit() -> None:
    plant = bench().plant(grid_of(bench(), 500.0, 3000))
    closed = close(plant, ISOTROPIC, np.array([gains_of([tune(f, 34.4)]) for f in (15.0, 49.0)]))
    found = largest_feed_forward(closed, 0.0)
    assert np.all((found > 0.1) & (found < 0.9))
    np.testing.assert_allclose(peak_dB(closed.position + found[..., None] * closed.ahead), 0.0, atol=1e-9)


@pytest.mark.parametrize("feed", [0.1, 500.0 / 6e4])
def test_the_phase_counts_unstable_poles_as_the_exact_delay_equation_does(feed: float) -> None:
    """Random gains, dead time, and friction that falls with speed: an open loop that is itself unstable."""
    gains = 10.0 ** np.random.default_rng(3).uniform([3.0, -3.0, 1.0], [5.0, -1.0, 3.0], (25, 3))
    law = Andersson(44.2, 84.0, 6.457e-3, 168.0, 15000.0)
    source = ModelSource(Machine.of_axis(BENCH, law).at(feed), ("x",), (1e-3,))
    sigma = float(law.slope(np.array([feed]))[0])
    assert sigma == pytest.approx(168.0 if feed == 0.1 else -1528.0, rel=1e-2)
    closed = close(source.plant(grid_of(source, 2000.0, 3000)), ISOTROPIC, gains[:, None])
    drives = [Drive(23.1, 11.3, 1.68e6, 104.0, Servo(*g, 1e-3), sigma) for g in gains.tolist()]
    unstable = np.array([d.unstable_poles() > 0 or refused(d.velocity_loop().require_stable) for d in drives])
    assert 4 < unstable.sum() < 22
    np.testing.assert_array_equal(closed.unstable > 0, unstable)


def refused(call: Callable[[], None]) -> bool:
    try:
        call()
    except InputError:
        return True
    return False


def test_two_coupled_axes_have_the_compliance_and_stability_of_the_machine() -> None:
    servos = {"x": tune(12.0, 9000.0, 2e-3), "y": tune(10.0, 6000.0, 1e-3)}
    point = ram(servos).at(0.01)
    source = ModelSource(point, ("x", "y"), (2e-3, 1e-3))
    np.testing.assert_allclose(source.mass, [9000.0, 6000.0], rtol=1e-4)
    plant = source.plant(grid_of(source, 100.0, 800))
    whole = Oriented.of(np.eye(3), (0, 1, 2))
    strong = {"x": tune(120.0, 9000.0, 2e-3), "y": servos["y"]}
    gains = np.array([gains_of(list(servos.values())), gains_of(list(strong.values()))])
    closed = close(plant, whole, gains)
    phi = point.matrix(plant.frequency)
    np.testing.assert_allclose(closed.eigenvalue[0].sum(axis=0), np.trace(phi, axis1=1, axis2=2), rtol=1e-6)
    np.testing.assert_allclose(closed.eigenvalue[0].prod(axis=0), np.linalg.det(phi), rtol=1e-4)
    assert closed.unstable[0] == point.unstable_poles() == 0
    assert ram(strong).at(0.01).unstable_poles() > 0 < closed.unstable[1]


def measured(delay: float, sigma: float = 0.0) -> MeasuredSource:
    """The bench from what instruments give: compliance at rest, commanded force to position, both masses."""
    f = np.linspace(1.0, 400.0, 8000)
    s = 2j * np.pi * f
    at_rest = make_compliance(f, (1.0 / (11.3 * s**2 + 104.0 * s + 1.68e6))[:, None, None], ["x"], ["x"])
    free = Drive(23.1, 11.3, 1.68e6, 104.0, None, sigma)
    loop = label(at_rest.drop_vars("compliance").assign(response=("frequency", free.open_loop(f, delay))))
    return MeasuredSource(at_rest, {"x": loop}, {"x": 34.4}, 11.3, {"x": delay})


@pytest.mark.parametrize("change", [-0.1, 0.1])
def test_moved_modes_are_those_of_a_drive_with_another_spring(change: float) -> None:
    """Frequencies by the share, masses and damping ratio as they are; from a model and from measurements."""
    servo = tune(30.0, 34.4, 0.75e-3)
    other = Drive(23.1, 11.3, 1.68e6 * (1.0 + change) ** 2, 104.0 * (1.0 + change), servo)
    assert np.isclose(other.locked_frequency, (1.0 + change) * BENCH.locked_frequency)
    f = np.linspace(5.0, 150.0, 600)
    for source, tolerance in ((bench(0.75e-3), 1e-7), (measured(0.75e-3), 5e-4)):
        closed = close(source.plant(f, change), ISOTROPIC, np.array([gains_of([servo])]))
        np.testing.assert_allclose(closed.eigenvalue[0, 0], other.tip_compliance(f), rtol=tolerance)


def test_measured_responses_give_the_closed_loop_of_the_machine_that_they_come_from() -> None:
    """The open loop holds the friction; without any, `released_compliance` is the second method."""
    f, servo = np.linspace(5.0, 300.0, 500), tune(40.0, 34.4, 0.75e-3)
    gains = np.array([gains_of([servo])])
    closed = close(measured(0.75e-3, -500.0).plant(f), ISOTROPIC, gains)
    drive = Drive(23.1, 11.3, 1.68e6, 104.0, servo, -500.0)
    np.testing.assert_allclose(closed.eigenvalue[0, 0], drive.tip_compliance(f), rtol=5e-4)
    source = measured(0.75e-3)
    at = source.at_rest.isel(frequency=slice(100, 6000, 7))
    expected = released_compliance(at, {"x": FeedAxis(servo, Viscous(0.0))}, {"x": 34.4}, 11.3)
    found = close(source.plant(at["frequency"].values), ISOTROPIC, gains).eigenvalue[0, 0]
    np.testing.assert_allclose(found, expected["compliance"].values[:, 0, 0], rtol=1e-6)


def test_measurements_without_masses_or_band_are_refused() -> None:
    source = measured(0.0)
    with pytest.raises(InputError, match=r"axis x has moving mass None kg and tip mass 11.3 kg"):
        MeasuredSource(source.at_rest, source.open_loop, {}, 11.3, {})
    with pytest.raises(InputError, match="axis y has an open loop, but its compliance at rest was not measured"):
        MeasuredSource(source.at_rest, {"y": source.open_loop["x"]}, {"y": 34.4}, 11.3, {})
    late = source.open_loop["x"].sel(frequency=slice(300.0, None))
    with pytest.raises(InputError, match=r"300.* to 400 Hz in common"):
        MeasuredSource(source.at_rest, {"x": late}, {"x": 34.4}, 11.3, {})
