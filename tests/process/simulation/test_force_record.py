"""The recorded force is the one that acted: against closed forms of held forces."""

import math

import numpy as np
import pytest

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.friction.laws import Andersson, Viscous
from process.machine.machine import FeedAxis, Machine
from process.machine.structure import free_modes
from process.simulation.excitation import HalfSine, PseudoRandom, Sum
from process.simulation.machine import simulate_machine
from process.simulation.packing import stairs
from process.simulation.problem import SampledControl

MM_MIN = 1.0 / 6e4
K2 = Servo(6268.0, 10.9e-3, 45.5)
BENCH = Drive(23.1, 11.3, 1.68e6, 104.0)
ANDERSSON = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)


def lines_of(values: np.ndarray, dt: float, e: PseudoRandom, f: np.ndarray) -> np.ndarray:
    """Fourier coefficients of the last but one period of samples that begin at 0 s."""
    first, count = math.ceil((e.start + (e.periods - 2) * e.period) / dt), round(e.period / dt)
    t, part = dt * np.arange(first, first + count), values[first : first + count]
    return np.array([np.mean(part * np.exp(-2j * np.pi * g * (t - e.start))) for g in f])


def held_lines(e: PseudoRandom, f: np.ndarray) -> np.ndarray:
    """Fourier coefficients of a held sequence, in closed form: ``sinc(f T) exp(-j pi f T)`` of those of its values."""
    ticks = np.arange(e.length) / e.clock
    values = np.array([np.mean(e.sequence() * np.exp(-2j * np.pi * g * ticks)) for g in f])
    return values * np.sinc(f / e.clock) * np.exp(-1j * np.pi * f / e.clock)


@pytest.mark.parametrize("where", ["drive_force", "force"])
@pytest.mark.parametrize("offset", [0.0, 0.37])
def test_a_held_force_is_recorded_without_a_dead_time_at_the_default_step(where: str, offset: float) -> None:
    clock = 500.0
    e = PseudoRandom(20.0, clock, 7, 3, (20 + offset) / clock)
    name = "drive_forces" if where == "drive_force" else "forces"
    record = simulate_machine(
        Machine.of_axis(BENCH, Viscous(168.0)), duration=e.start + 3 * e.period, sample_rate=2000.0, **{name: {"x": e}}
    )
    f = np.arange(1, 51) / e.period
    found = lines_of(record[where].values[0], 5e-4, e, f)
    error = found / held_lines(e, f) - 1.0
    # What the low-pass of the record folds down is left.
    assert math.sqrt(np.mean(np.abs(error) ** 2)) < 5e-3
    assert abs(np.median(np.angle(found / held_lines(e, f)) / (2.0 * np.pi * f))) < 3e-6


def test_samples_between_jumps_weigh_cubics_as_integrals_do() -> None:
    rng = np.random.default_rng(3)
    at = np.concatenate([np.sort(rng.uniform(5.0, 30.0, 12)), [31.0, 32.0]])
    height = rng.standard_normal(14)
    height[-1] -= height.sum()
    samples, t = stairs(at, height, 40), np.arange(40.0)
    for k in range(4):
        integral = -np.sum(height * at ** (k + 1)) / (k + 1)
        assert np.sum(samples * t**k) == pytest.approx(integral, rel=1e-11)


def test_the_recorded_lines_of_a_held_force_converge_with_the_fourth_order() -> None:
    e = PseudoRandom(20.0, 470.0, 5, 3, 0.1 / 470.0)
    f = np.arange(1, 9) / e.period
    errors = []
    for per_tick in (4, 8, 16):
        rate = per_tick * e.clock
        record = simulate_machine(
            Machine.of_axis(BENCH, Viscous(168.0)),
            duration=e.end,
            drive_forces={"x": Sum((e, HalfSine(0.1, 0.02, 0.001)))},
            sample_rate=rate,
            step=1.0 / rate,
        )
        found = lines_of(record["drive_force"].values[0], 1.0 / rate, e, f)
        errors.append(np.abs(found - held_lines(e, f)).max())
    assert errors[0] / errors[2] > 0.9 * 4.0**4


def test_the_acceleration_of_the_tool_is_that_of_its_displacement_under_a_held_drive_force() -> None:
    shapes = [[1.0, 0.0, 0.0], [-0.06, 0.02, 0.0], [-0.03, -0.05, 0.0]]
    modes = free_modes([0.0, 45.0, 80.0], [0.0, 0.03, 0.02], [300.0, 1.0, 1.0], shapes, {"x": [1.0, 0.06, 0.03]})
    e = PseudoRandom(20.0, 400.0, 6, 8, 0.01)
    record = simulate_machine(
        Machine(modes, {"x": FeedAxis(Servo(3e5, 0.02, 20.0), Viscous(100.0))}),
        duration=e.start + 8 * e.period,
        drive_forces={"x": e},
        sample_rate=2000.0,
    )
    f = np.arange(3, 26) / e.period
    x, a = (lines_of(record[v].sel(axis="x").values, 5e-4, e, f) for v in ("displacement", "acceleration"))
    assert np.abs(a / (-((2.0 * np.pi * f) ** 2) * x) - 1.0).max() < 0.01


def test_the_force_of_a_sampled_servo_has_no_dead_time_where_the_record_is_low_passed() -> None:
    # The servo holds its command for 2 ms; eight samples a millisecond see the staircase as it is.
    control = SampledControl(2e-3)
    e = PseudoRandom(20.0, 500.0, 7, 8, 0.02)
    axis = Machine.of_axis(Drive(23.1, 11.3, 1.68e6, 104.0, Servo(2000.0, 30e-3, 15.0)), Viscous(168.0))
    record = simulate_machine(
        axis, duration=e.end, drive_forces={"x": e}, control=control, sample_rate=1000.0, step=2.5e-4
    )
    f = np.arange(1, 13) / e.period
    position, force = (lines_of(record[name].values[0], 1e-3, e, f) for name in ("encoder_position", "drive_force"))
    exact = Drive(23.1, 11.3, 1.68e6, 104.0, None, 168.0).open_loop(f)
    late = np.angle(position / force / exact) / (2.0 * np.pi * f)
    assert abs(np.median(late)) < 1e-5
