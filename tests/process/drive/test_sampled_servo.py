"""Sampled servo: against a second discretisation and plain recursions, and its order towards the continuous loop."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from process.drive.axis import Drive
from process.drive.sampled_servo import SampledServo
from process.drive.servo import Servo
from process.errors import InputError

SERVOS = {
    "K1": Servo(3242.0, 21.2e-3, 23.5),
    "K2": Servo(6268.0, 10.9e-3, 45.5),
    "K3": Servo(10590.0, 6.5e-3, 76.9),
    "K4": Servo(18804.0, 3.6e-3, 136.6),
}
FREE = Drive(23.1, 11.3, 1.68e6, 104.0, None, 168.0)
F = np.geomspace(1.0, 240.0, 60)


def sampled_poles(drive: Drive, period: float, lag: int = 1) -> np.ndarray:
    assert drive.servo is not None
    return SampledServo(drive.servo, period, lag).poles(drive)


def bench(servo: str = "K2", delay: float = 0.0) -> Drive:
    return Drive(23.1, 11.3, 1.68e6, 104.0, replace(SERVOS[servo], delay=delay))


@pytest.mark.parametrize("lag", [0, 1, 3])
def test_fast_sampling_is_a_dead_time_of_lag_and_a_half_periods(lag: int) -> None:
    errors = []
    for period in (40e-6, 20e-6, 10e-6):
        sampled = sampled_poles(bench("K3"), period, lag)
        exact = bench("K3", delay=(lag + 0.5) * period).poles()[:5]
        errors.append(max(np.abs(sampled - pole).min() / abs(pole) for pole in exact))
    # The rectangular integral is of first order.
    assert errors[-1] < 2e-3
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.2)


def test_the_dead_time_of_the_bench_is_that_of_two_kilohertz_with_one_sample_of_lag() -> None:
    sampled = sampled_poles(bench("K3"), 0.5e-3, 1)
    for pole in bench("K3", delay=0.75e-3).poles()[:4]:
        assert np.abs(sampled - pole).min() < 0.1 * abs(pole)


def test_the_sampled_servo_is_stable_exactly_where_its_recursion_decays() -> None:
    # A plain recursion: exact free motion of the masses between samples by many small steps.
    for period, lag in ((1e-3, 1), (2e-3, 1), (4e-3, 1), (3e-3, 0)):
        drive = bench("K3")
        a, _, _, _ = drive.state_space()
        fine = np.eye(4) + sum(np.linalg.matrix_power(a[:4, :4] * 1e-5, k) / math.factorial(k) for k in range(1, 6))
        whole, push = np.eye(4), np.zeros(4)
        for _ in range(round(period / 1e-5)):
            push = fine @ push + np.array([0.0, 0.0, 0.0, 1e-5 / 23.1])
            whole = fine @ whole
        q, integral, waiting = np.array([1e-5, 0.0, 0.0, 0.0]), 0.0, [0.0] * lag
        sizes = []
        for _ in range(round(3.0 / period)):
            e = -(76.9 * q[2] + q[3])
            integral += period * e
            waiting.append(10590.0 * (e + integral / 6.5e-3))
            q = whole @ q + push * waiting.pop(0)
            sizes.append(np.abs(q).max())
            if sizes[-1] > 1e6:
                break
        assert (sizes[-1] > sizes[0]) == (sampled_poles(drive, period, lag)[0].real > 0.0)
    assert sampled_poles(bench("K3"), 1e-3)[0].real < 0.0 < sampled_poles(bench("K3"), 4e-3)[0].real


def test_a_sampled_servo_brings_its_own_dead_time() -> None:
    with pytest.raises(InputError, match="delay 0"):
        sampled_poles(bench(delay=1e-3), 1e-3)


def by_cont2discrete(frequency: np.ndarray, period: float, output: list[float]) -> np.ndarray:
    """Carriage over held force, by another program: masses from their equations, output a row of the four states."""
    mt, mm, k, c, sigma = 11.3, 23.1, 1.68e6, 104.0, 168.0
    a = [
        [0.0, 1.0, 0.0, 0.0],
        [-k / mt, -c / mt, k / mt, c / mt],
        [0.0, 0.0, 0.0, 1.0],
        [k / mm, c / mm, -k / mm, -(c + sigma) / mm],
    ]
    system = (np.array(a), np.array([[0.0], [0.0], [0.0], [1.0 / mm]]), np.array([output]), np.zeros((1, 1)))
    a_d, b_d, c_d, _, _ = signal.cont2discrete(system, period, "zoh")
    z = np.exp(2j * np.pi * frequency * period)
    return np.array([(c_d @ np.linalg.solve(x * np.eye(4) - a_d, b_d))[0, 0] for x in z])


@pytest.mark.parametrize("lag", [0, 1, 2])
@pytest.mark.parametrize("period", [0.25e-3, 1e-3])
def test_loops_are_those_of_another_discretisation(period: float, lag: int) -> None:
    sampled = SampledServo(SERVOS["K2"], period, lag)
    z = np.exp(2j * np.pi * F * period)
    controller = 6268.0 * (1 + period / 10.9e-3 * z / (z - 1)) / z**lag
    speed, place = (by_cont2discrete(F, period, row) for row in ([0, 0, 0, 1.0], [0, 0, 1.0, 0]))
    for loop, gain in (
        (sampled.velocity_loop(FREE), controller * speed),
        (sampled.position_loop(FREE), controller * (speed + 45.5 * place)),
    ):
        np.testing.assert_allclose(loop(F), gain, rtol=1e-8)
        np.testing.assert_allclose(loop.closed(F), gain / (1.0 + gain), rtol=1e-8)


def order(errors: list[float]) -> float:
    return math.log2(errors[-2] / errors[-1])


@pytest.mark.parametrize("lag", [0, 1, 3])
def test_a_short_period_is_a_dead_time_of_lag_and_a_half_periods(lag: int) -> None:
    plain, corrected = [], []
    for period in (20e-6, 10e-6, 5e-6):
        sampled = SampledServo(SERVOS["K3"], period, lag)
        late = replace(SERVOS["K3"], delay=(lag + 0.5) * period)
        own = np.concatenate([loop.closed(F) for loop in (sampled.velocity_loop(FREE), sampled.position_loop(FREE))])
        for servo, errors in ((late, plain), (sampled.continuous(), corrected)):
            drive = replace(FREE, servo=servo)
            other = np.concatenate([loop.closed(F) for loop in (drive.velocity_loop(), drive.position_loop())])
            errors.append(float(np.abs(own - other).max()))
    # Gains as they stand: the rectangular integral is of first order. With its half step in the gains: second.
    assert order(plain) == pytest.approx(1.0, abs=0.1)
    assert order(corrected) == pytest.approx(2.0, abs=0.05)
    assert corrected[-1] < 1e-3


def test_margins_and_bandwidth_tend_to_the_continuous_ones_with_second_order() -> None:
    errors: dict[str, list[float]] = {}
    for period in (200e-6, 100e-6, 50e-6):
        sampled = SampledServo(SERVOS["K2"], period)
        drive = replace(FREE, servo=sampled.continuous())
        velocity, continuous = sampled.velocity_loop(FREE), drive.velocity_loop()
        pairs = {"bandwidth": (velocity.bandwidth(), continuous.bandwidth())}
        for which, own, other in (
            ("velocity", velocity.margins(), continuous.margins()),
            ("position", sampled.position_loop(FREE).margins(), drive.position_loop().margins()),
        ):
            pairs[f"{which} phase"] = own.phase, other.phase
            pairs[f"{which} crossover"] = own.crossover, other.crossover
        for name, (a, b) in pairs.items():
            errors.setdefault(name, []).append(abs(a / b - 1.0))
    for name, values in errors.items():
        assert order(values) == pytest.approx(2.0, abs=0.15), name
        assert values[-1] < 1e-3, name


@pytest.mark.parametrize(("period", "lag"), [(0.5e-3, 1), (1e-3, 0), (1e-3, 2)])
def test_the_gain_margin_is_where_the_poles_leave_the_unit_circle(period: float, lag: int) -> None:
    servo = SERVOS["K2"]
    for margins, poles in (
        (SampledServo(servo, period, lag).position_loop(FREE).margins(), SampledServo.poles),
        (SampledServo(servo, period, lag).velocity_loop(FREE).margins(), SampledServo.velocity_poles),
    ):
        assert 1.0 < margins.gain < math.inf
        for factor, unstable in ((0.999, False), (1.001, True)):
            changed = SampledServo(replace(servo, Kp=servo.Kp * margins.gain * factor), period, lag)
            assert bool(poles(changed, FREE)[0].real > 0.0) is unstable


def test_the_poles_are_zeros_of_one_plus_the_loop_gain() -> None:
    sampled = SampledServo(SERVOS["K3"], 1e-3, 1)
    for poles, loop in ((sampled.poles, sampled.position_loop), (sampled.velocity_poles, sampled.velocity_loop)):
        kept = poles(FREE)
        gain = loop(FREE)(F)
        z, roots = np.exp(2j * np.pi * F * 1e-3), np.exp(kept * 1e-3)
        # 1 + L is the product of (z - closed poles) over that of (z - open poles).
        ratio = (1.0 + gain) / np.prod(z[:, None] - roots, axis=1)
        # Integrator of the servo, then the axis: with its rigid-body pole where the position is fed back.
        own = [0.0] if loop == sampled.velocity_loop else [0.0, 0.0]
        before = np.exp(1e-3 * np.array([*own, *FREE.poles()]))
        spread = ratio * np.prod(z[:, None] - before, axis=1) * z ** (kept.size - before.size)
        np.testing.assert_allclose(spread, spread[0], rtol=1e-6)


def integrate(sampled: SampledServo, force: np.ndarray, fine: int) -> np.ndarray:
    """Tip, carriage and drive force of a plain recursion, `fine` steps a period, force on the tip held for a step."""
    period, servo = sampled.period, sampled.servo
    h = period / fine
    mt, mm, k, c, sigma = 11.3, 23.1, 1.68e6, 104.0, 168.0
    a = np.array([[0, 1, 0, 0], [-k / mt, -c / mt, k / mt, c / mt], [0, 0, 0, 1], [k / mm, c / mm, -k / mm, 0]])
    a[3, 3] = -(c + sigma) / mm
    inputs = np.array([[0, 0], [1 / mt, 0], [0, 0], [0, 1 / mm]])
    a_d, b_d, *_ = signal.cont2discrete((a, inputs, np.eye(4), np.zeros((4, 2))), h, "zoh")
    q, integral = np.zeros(4), 0.0
    waiting, push, out = [0.0] * sampled.lag, 0.0, np.empty((3, force.size))
    for i in range(force.size):
        if i % fine == 0:
            place, speed = q[2], q[3]
            e = -servo.Kv * place - speed
            integral += period * e
            waiting.append(servo.Kp * (e + integral / servo.Ti))
            push = waiting.pop(0)
        out[:, i] = q[0], q[2], push
        q = a_d @ q + b_d @ [force[i], push]
    return out


@pytest.mark.parametrize(("period", "lag"), [(0.5e-3, 1), (2e-3, 0)])
def test_the_tip_compliance_is_the_response_of_a_plain_recursion(period: float, lag: int) -> None:
    sampled, fine = SampledServo(SERVOS["K2"], period, lag), 8
    frequency = 60.0
    h = period / fine
    n = round(1.0 / h)
    t = np.arange(3 * n) * h
    tip = integrate(sampled, np.sin(2.0 * np.pi * frequency * t), fine)[0]
    # Whole periods of 60 Hz and of the sampling, after the transient; the force was held for h, half of it late.
    wave = np.exp(-2j * np.pi * frequency * t[2 * n :])
    response = 2.0 * np.mean(tip[2 * n :] * wave) * 1j
    expected = sampled.tip_compliance(FREE, [frequency])[0]
    held = np.exp(-1j * np.pi * frequency * h) * np.sinc(frequency * h)
    assert abs(response / (expected * held) - 1.0) < 2e-3


def test_the_tip_compliance_tends_to_that_of_the_continuous_servo_with_second_order() -> None:
    errors = []
    for period in (200e-6, 100e-6, 50e-6):
        sampled = SampledServo(SERVOS["K3"], period)
        exact = replace(FREE, servo=sampled.continuous()).tip_compliance(F)
        errors.append(float(np.abs(sampled.tip_compliance(FREE, F) / exact - 1.0).max()))
    assert order(errors) == pytest.approx(2.0, abs=0.1)


def test_an_unstable_sampled_servo_is_refused_where_a_closed_loop_is_needed() -> None:
    slow = SampledServo(SERVOS["K3"], 4e-3)
    for closed in (lambda drive, f: slow.position_loop(drive).closed(f), slow.tip_compliance):
        with pytest.raises(InputError, match=r"Kp 10590.*period 4 ms, lag 1: .*outside the unit circle.*sample faster"):
            closed(FREE, [10.0])
    with pytest.raises(InputError, match="velocity loop is unstable"):
        SampledServo(SERVOS["K4"], 3.5e-3, 2).velocity_loop(FREE).margins()
    assert np.isfinite(slow.position_loop(FREE)([10.0])).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"period": 0.0}, "needs a positive period"),
        ({"period": math.nan}, "needs a positive period"),
        ({"lag": -1}, "whole lag from 0 up"),
        ({"servo": replace(SERVOS["K2"], delay=1e-3)}, "delay 0"),
        ({"period": 12e-3}, "longer than the integral time"),
    ],
)
def test_what_is_no_sampled_servo_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(SampledServo(SERVOS["K2"], 1e-3), **change)  # type: ignore[arg-type]


def test_a_sampled_loop_answers_up_to_half_the_sampling_rate() -> None:
    sampled = SampledServo(SERVOS["K2"], 1e-3)
    for f, message in ((0.0, "f > 0"), (500.1, "up to 500 Hz")):
        with pytest.raises(InputError, match=message):
            sampled.position_loop(FREE)([f])
