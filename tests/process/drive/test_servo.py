"""The servo: Table 2, closed loops against closed forms, and stability with exact dead time against known limits."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import optimize

from process.drive.servo import (
    Plant,
    QuasiPolynomial,
    Servo,
    bandwidth,
    open_position_loop,
    open_velocity_loop,
    position_characteristic,
    position_loop,
    position_margins,
    rigid_plant,
    tune,
    velocity_bandwidth,
    velocity_characteristic,
    velocity_loop,
    velocity_margins,
)
from process.errors import InputError

# Table 2 of Franco et al. 2024: f_bw [Hz], Kp [N s/m], Ti [ms], Kv [1/s]; the table cuts its last digit off.
TABLE_2 = {
    "K1": (15, 3242, 21.2, 23.5),
    "K2": (29, 6268, 10.9, 45.5),
    "K3": (49, 10590, 6.5, 76.9),
    "K4": (87, 18804, 3.6, 136.6),
}
MASS = 34.4
# Numerator and denominator of Eq. (2) for the bench, rising powers.
BENCH = Plant((1.68e6, 104.0, 11.3), (0.0, 0.0, 1.68e6 * 34.4, 104.0 * 34.4, 23.1 * 11.3))


@pytest.mark.parametrize("name", TABLE_2)
def test_the_tuning_rule_gives_table_2(name: str) -> None:
    f, kp, ti_ms, kv = TABLE_2[name]
    servo = tune(f, MASS)
    assert servo.Kp == pytest.approx(kp, abs=1.0)
    assert servo.Ti * 1e3 == pytest.approx(ti_ms, abs=0.08)
    assert servo.Kv == pytest.approx(kv, abs=0.1)
    assert servo.Kv * servo.Ti == pytest.approx(0.5)


def test_the_rule_puts_the_velocity_loop_of_a_rigid_mass_at_1_455_times_the_nominal_bandwidth() -> None:
    servo, plant = tune(29.0, MASS), rigid_plant(MASS)
    assert velocity_bandwidth(servo, plant) == pytest.approx(1.455 * 29.0, rel=1e-3)
    peak = np.abs(velocity_loop(servo, plant, np.geomspace(0.1, 1000.0, 20000))).max()
    assert 20 * math.log10(peak) == pytest.approx(2.09, abs=0.01)


def test_the_force_law_is_equation_3() -> None:
    servo = Servo(6268.0, 10.9e-3, 45.5, delay=1e-3)
    s = 2j * np.pi * np.array([1.0, 10.0, 100.0])
    expected = (s + 45.5) * 6268.0 * (1 + 1 / (10.9e-3 * s)) * np.exp(-1e-3 * s)
    np.testing.assert_allclose(servo.feedback(s), expected, rtol=1e-14)
    # Full feed-forward: the reference acts as the position does.
    np.testing.assert_allclose(servo.command(s), servo.feedback(s), rtol=1e-14)


def test_with_full_feed_forward_a_ramp_is_followed_without_lag() -> None:
    servo = Servo(6268.0, 10.9e-3, 45.5)
    assert servo.following_error(0.01) == 0.0
    slow = Servo(6268.0, 10.9e-3, 45.5, feed_forward=0.0)
    assert slow.following_error(0.01) == pytest.approx(0.01 / 45.5)
    # (1 - T)/s at low frequency is the lag behind a unit ramp.
    f = 1e-3
    assert ((1 - position_loop(slow, BENCH, [f])[0]) / (2j * np.pi * f)).real == pytest.approx(1 / 45.5, rel=1e-4)


def test_the_two_loops_are_one_loop() -> None:
    servo = Servo(6268.0, 10.9e-3, 45.5, delay=0.75e-3, feed_forward=0.0)
    f = np.geomspace(0.5, 500.0, 200)
    outer = open_position_loop(servo, BENCH, f)
    np.testing.assert_allclose(outer / (1 + outer), position_loop(servo, BENCH, f), rtol=1e-9)


def test_the_crossover_of_a_pure_gain_loop_is_the_nominal_bandwidth() -> None:
    servo = Servo(tune(20.0, MASS).Kp, 1e6, 1e-9)
    margins = velocity_margins(servo, rigid_plant(MASS))
    assert margins.crossover == pytest.approx(20.0, rel=1e-6)
    assert math.degrees(margins.phase) == pytest.approx(90.0, abs=1e-3)
    # A quarter period of delay takes the 90 degrees away.
    assert margins.delay == pytest.approx(0.25 / 20.0, rel=1e-4)
    assert margins.gain == math.inf


@pytest.mark.parametrize("name", TABLE_2)
def test_the_delay_margin_is_where_the_argument_principle_sees_the_loop_go_unstable(name: str) -> None:
    servo = tune(TABLE_2[name][0], MASS)
    for margins, characteristic in (
        (velocity_margins(servo, BENCH), velocity_characteristic),
        (position_margins(servo, BENCH), position_characteristic),
    ):
        for factor, unstable in ((0.999, 0), (1.001, 2)):
            late = Servo(servo.Kp, servo.Ti, servo.Kv, delay=factor * margins.delay)
            assert characteristic(late, BENCH).unstable_count() == unstable


def test_the_gain_margin_is_where_the_loop_with_delay_goes_unstable() -> None:
    servo = Servo(6268.0, 10.9e-3, 45.5, delay=0.75e-3)
    gain = velocity_margins(servo, BENCH).gain
    assert gain > 1.0
    for factor, count in ((0.999, 0), (1.001, 2)):
        louder = Servo(servo.Kp * gain * factor, servo.Ti, servo.Kv, delay=servo.delay)
        assert velocity_characteristic(louder, BENCH).unstable_count() == count


def test_a_delayed_integrator_is_stable_up_to_pi_half() -> None:
    # s + a e^(-s tau): stable for a tau < pi/2, two more zeros at a tau = pi/2 + 2 pi.
    for product, count in ((1.57, 0), (1.572, 2), (7.84, 2), (7.87, 4)):
        c = QuasiPolynomial(np.polynomial.Polynomial([0.0, 1.0]), np.polynomial.Polynomial([product / 0.01]), 0.01)
        assert c.unstable_count() == count


def test_roots_with_delay_are_the_lambert_function() -> None:
    c = QuasiPolynomial(np.polynomial.Polynomial([0.0, 1.0]), np.polynomial.Polynomial([100.0]), 0.01)
    # s tau e^(s tau) = -a tau: W(-1) = -0.31813150520 +- 1.33723570143 j (Lambert W, tabulated)
    rightmost = c.roots()[:2] * 0.01
    np.testing.assert_allclose(rightmost.real, -0.31813150520476, rtol=1e-10)
    np.testing.assert_allclose(np.abs(rightmost.imag), 1.33723570143069, rtol=1e-10)


def test_the_argument_principle_counts_what_the_roots_say() -> None:
    rng = np.random.default_rng(7)
    counts = set()
    for _ in range(60):
        delay = float(rng.choice([0.0, 10 ** rng.uniform(-4, -2.3)]))
        servo = Servo(10 ** rng.uniform(3, 4.8), 10 ** rng.uniform(-3, -1.5), 10 ** rng.uniform(1, 2.7), delay)
        sigma = rng.uniform(-3000, 3000)
        plant = Plant(BENCH.numerator, (0.0, sigma * 1.68e6, 5.78e7 + sigma * 104, 3578.0 + sigma * 11.3, 261.03))
        c = position_characteristic(servo, plant)
        counts.add(c.unstable_count())
        assert c.unstable_count() == int(np.sum(c.roots().real > 0.0))
    assert counts >= {0, 2}


def test_a_pole_on_the_axis_counts_as_unstable() -> None:
    oscillator = QuasiPolynomial(np.polynomial.Polynomial([1.0e4, 0.0, 1.0]), np.polynomial.Polynomial([0.0]), 0.0)
    assert oscillator.unstable_count() > 0


def test_an_unstable_servo_is_refused_where_a_closed_loop_is_asked_for() -> None:
    late = Servo(10590.0, 6.5e-3, 76.9, delay=5e-3)
    for closed in (velocity_loop, position_loop):
        with pytest.raises(InputError, match=r"unstable with Kp 10590.* pole.*lower Kp"):
            closed(late, BENCH, [10.0])
    with pytest.raises(InputError, match="unstable"):
        position_margins(late, BENCH)
    # The open loop has a meaning all the same.
    assert np.isfinite(open_velocity_loop(late, BENCH, [10.0])).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.0, 1e-2, 40.0), "Kp is 0"),
        ((6000.0, -1e-2, 40.0), "Ti is -0.01"),
        ((6000.0, 1e-2, math.nan), "Kv is nan"),
        ((6000.0, 1e-2, 40.0, -1e-3), "delay is -0.001"),
    ],
)
def test_gains_without_meaning_are_refused(arguments: tuple[float, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Servo(*arguments)


def test_a_plant_with_static_stiffness_is_refused() -> None:
    with pytest.raises(InputError, match="no pole at s = 0"):
        Plant((1.0,), (1.0, 0.0, 1.0))
    with pytest.raises(InputError, match="f > 0"):
        open_velocity_loop(tune(29.0, MASS), BENCH, [0.0])


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (lambda: rigid_plant(0.0), "mass is 0 kg"),
        (lambda: rigid_plant(-34.4), "mass is -34.4 kg"),
        (lambda: rigid_plant(MASS, math.nan), "not finite"),
        (lambda: Plant((1.0, 0.1), (0.0, 1.0, 1.0)), "at least 2 poles more"),
        (lambda: tune(29.0, -1.0), "both must be positive"),
        (lambda: tune(math.inf, MASS), "both must be positive"),
        (lambda: bandwidth(lambda f: np.ones(f.size, complex), 1.0, 10.0), "does not fall through -3 dB"),
        (lambda: bandwidth(lambda f: np.ones(f.size, complex), 10.0, 1.0), "0 < lowest < highest"),
    ],
)
def test_what_has_no_loop_or_bandwidth_is_refused(wrong: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        wrong()


def test_the_bandwidth_is_a_half_power_point() -> None:
    servo = tune(49.0, MASS, delay=0.75e-3)
    f = velocity_bandwidth(servo, BENCH)
    assert np.abs(velocity_loop(servo, BENCH, [f]))[0] == pytest.approx(math.sqrt(0.5), rel=1e-9)
    # Nothing below it is as low.
    below = optimize.minimize_scalar(
        lambda x: np.abs(velocity_loop(servo, BENCH, [x]))[0], bounds=(1.0, 0.999 * f), method="bounded"
    )
    assert below.fun > math.sqrt(0.5)
