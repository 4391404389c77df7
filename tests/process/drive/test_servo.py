"""The servo: Table 2, closed loops against closed forms, and stability with exact dead time against known limits."""

import math
from dataclasses import replace

import numpy as np
import pytest

from process.drive.axis import Drive
from process.drive.delay_equation import DelayEquation
from process.drive.servo import Loop, Servo, tune
from process.errors import InputError

# Table 2 of Franco et al. 2024: f_bw [Hz], Kp [N s/m], Ti [ms], Kv [1/s]; the table cuts its last digit off.
TABLE_2 = {
    "K1": (15, 3242, 21.2, 23.5),
    "K2": (29, 6268, 10.9, 45.5),
    "K3": (49, 10590, 6.5, 76.9),
    "K4": (87, 18804, 3.6, 136.6),
}
MASS = 34.4
FREE = Drive(23.1, 11.3, 1.68e6, 104.0)


def bench(servo: Servo, sigma: float = 0.0) -> Drive:
    return replace(FREE, servo=servo, sigma=sigma)


def rigid_loop(servo: Servo) -> Loop:
    """The velocity loop of a rigid mass."""
    return Loop(
        lambda f: servo.velocity_controller(2j * np.pi * f) / (2j * np.pi * f * MASS),
        np.geomspace(1e-3, 1e4, 20000),
        lambda: None,
    )


def reference_response(drive: Drive, f: np.ndarray) -> np.ndarray:
    """Carriage over reference position: the servo takes ``a s + Kv`` of the one, ``s + Kv`` of the other."""
    s, servo = 2j * np.pi * f, drive.servo
    assert servo is not None
    return drive.position_loop().closed(f) * (servo.feed_forward * s + servo.Kv) / (s + servo.Kv)


@pytest.mark.parametrize("name", TABLE_2)
def test_the_tuning_rule_gives_table_2(name: str) -> None:
    f, kp, ti_ms, kv = TABLE_2[name]
    servo = tune(f, MASS)
    assert servo.Kp == pytest.approx(kp, abs=1.0)
    assert servo.Ti * 1e3 == pytest.approx(ti_ms, abs=0.08)
    assert servo.Kv == pytest.approx(kv, abs=0.1)
    assert servo.Kv * servo.Ti == pytest.approx(0.5)


def test_the_rule_puts_the_velocity_loop_of_a_rigid_mass_at_1_455_times_the_nominal_bandwidth() -> None:
    loop = rigid_loop(tune(29.0, MASS))
    assert loop.bandwidth() == pytest.approx(1.455 * 29.0, rel=1e-3)
    peak = np.abs(loop.closed(np.geomspace(0.1, 1000.0, 20000))).max()
    assert 20 * math.log10(peak) == pytest.approx(2.09, abs=0.01)


def test_the_force_law_is_equation_3() -> None:
    servo = Servo(6268.0, 10.9e-3, 45.5, delay=1e-3)
    s = 2j * np.pi * np.array([1.0, 10.0, 100.0])
    expected = (s + 45.5) * 6268.0 * (1 + 1 / (10.9e-3 * s)) * np.exp(-1e-3 * s)
    np.testing.assert_allclose(servo.feedback(s), expected, rtol=1e-14)


def test_with_full_feed_forward_a_ramp_is_followed_without_lag() -> None:
    servo = Servo(6268.0, 10.9e-3, 45.5)
    assert servo.following_error(0.01) == 0.0
    slow = Servo(6268.0, 10.9e-3, 45.5, feed_forward=0.0)
    assert slow.following_error(0.01) == pytest.approx(0.01 / 45.5)
    # (1 - T)/s at low frequency is the lag behind a unit ramp.
    f = np.array([1e-3])
    assert ((1 - reference_response(bench(slow), f)) / (2j * np.pi * f)).real == pytest.approx(1 / 45.5, rel=1e-4)


def test_the_two_loops_are_one_loop() -> None:
    drive = bench(Servo(6268.0, 10.9e-3, 45.5, delay=0.75e-3, feed_forward=0.0))
    f = np.geomspace(0.5, 500.0, 200)
    # The position loop around the closed velocity loop: Kv/s T_v.
    outer = 45.5 / (2j * np.pi * f) * drive.velocity_loop().closed(f)
    np.testing.assert_allclose(outer / (1 + outer), reference_response(drive, f), rtol=1e-9)


def test_the_crossover_of_a_pure_gain_loop_is_the_nominal_bandwidth() -> None:
    servo = Servo(tune(20.0, MASS).Kp, 1e6, 1e-9)
    margins = rigid_loop(servo).margins()
    assert margins.crossover == pytest.approx(20.0, rel=1e-6)
    assert math.degrees(margins.phase) == pytest.approx(90.0, abs=1e-3)
    # A quarter period of delay takes the 90 degrees away.
    assert margins.delay == pytest.approx(0.25 / 20.0, rel=1e-4)
    assert margins.gain == math.inf


@pytest.mark.parametrize("which", ["velocity", "position"])
@pytest.mark.parametrize("name", TABLE_2)
def test_the_delay_margin_is_where_the_argument_principle_finds_the_loop_unstable(name: str, which: str) -> None:
    servo = tune(TABLE_2[name][0], MASS)

    def loop(late: Servo) -> Loop:
        drive = bench(late)
        return drive.velocity_loop() if which == "velocity" else drive.position_loop()

    margin = loop(servo).margins().delay
    loop(replace(servo, delay=0.999 * margin)).require_stable()
    with pytest.raises(InputError, match=rf"the {which} loop is unstable .* 2 pole"):
        loop(replace(servo, delay=1.001 * margin)).require_stable()


def test_the_gain_margin_is_where_the_loop_with_delay_goes_unstable() -> None:
    servo = Servo(6268.0, 10.9e-3, 45.5, delay=0.75e-3)
    gain = bench(servo).velocity_loop().margins().gain
    assert gain > 1.0
    bench(replace(servo, Kp=servo.Kp * gain * 0.999)).velocity_loop().require_stable()
    with pytest.raises(InputError, match="2 pole"):
        bench(replace(servo, Kp=servo.Kp * gain * 1.001)).velocity_loop().require_stable()


def delayed_integrator(a: float, delay: float) -> DelayEquation:
    """``x' = -a x(t - tau)``."""
    one = np.ones((1, 1))
    return DelayEquation(0.0 * one, one, one, ((delay, np.ones(1), np.array([-a])),))


def test_a_delayed_integrator_is_stable_up_to_pi_half() -> None:
    # s + a e^(-s tau): stable for a tau < pi/2, two more zeros at a tau = pi/2 + 2 pi.
    for product, count in ((1.57, 0), (1.572, 2), (7.84, 2), (7.87, 4)):
        assert delayed_integrator(product / 0.01, 0.01).unstable_poles() == count


def test_poles_with_delay_are_the_lambert_function() -> None:
    # s tau e^(s tau) = -a tau: W(-1) = -0.31813150520 +- 1.33723570143 j (Lambert W, tabulated)
    rightmost = delayed_integrator(100.0, 0.01).poles()[:2] * 0.01
    np.testing.assert_allclose(rightmost.real, -0.31813150520476, rtol=1e-10)
    np.testing.assert_allclose(np.abs(rightmost.imag), 1.33723570143069, rtol=1e-10)


def test_the_argument_principle_counts_the_poles_in_the_right_half_plane() -> None:
    rng = np.random.default_rng(7)
    counts = set()
    for _ in range(60):
        delay = float(rng.choice([0.0, 10 ** rng.uniform(-4, -2.3)]))
        servo = Servo(10 ** rng.uniform(3, 4.8), 10 ** rng.uniform(-3, -1.5), 10 ** rng.uniform(1, 2.7), delay)
        drive = bench(servo, rng.uniform(-3000, 3000))
        counts.add(drive.unstable_poles())
        assert drive.unstable_poles() == int(np.sum(drive.poles().real > 0.0))
    assert counts >= {0, 2}


def test_a_pole_on_the_axis_counts_as_unstable() -> None:
    a = np.array([[0.0, 1.0], [-1.0e4, 0.0]])
    assert DelayEquation(a, np.zeros((2, 1)), np.zeros((1, 2))).unstable_poles() > 0


def test_an_unstable_servo_is_refused_where_a_closed_loop_is_needed() -> None:
    late = bench(Servo(10590.0, 6.5e-3, 76.9, delay=5e-3))
    for loop in (late.velocity_loop(), late.position_loop()):
        for closed in (lambda loop=loop: loop.closed([10.0]), loop.margins, loop.bandwidth):
            with pytest.raises(InputError, match=r"unstable with Kp 10590.* pole.*lower Kp"):
                closed()
    # The open loop has a meaning all the same.
    assert np.isfinite(late.velocity_loop()([10.0])).all()


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


def test_a_loop_needs_a_servo_and_a_frequency_above_zero() -> None:
    with pytest.raises(InputError, match="f > 0"):
        bench(tune(29.0, MASS)).velocity_loop()([0.0])
    with pytest.raises(InputError, match="no servo"):
        FREE.position_loop()


@pytest.mark.parametrize(("bandwidth", "mass"), [(29.0, -1.0), (math.inf, MASS)])
def test_a_rule_without_bandwidth_or_mass_is_refused(bandwidth: float, mass: float) -> None:
    with pytest.raises(InputError, match="both must be positive"):
        tune(bandwidth, mass)


def test_a_loop_that_does_not_fall_has_no_bandwidth() -> None:
    loop = Loop(lambda f: np.full(f.size, 1e3 + 0j), np.geomspace(1.0, 10.0, 100), lambda: None)
    with pytest.raises(InputError, match="does not fall through -3 dB"):
        loop.bandwidth()


def test_the_bandwidth_is_a_half_power_point() -> None:
    loop = bench(tune(49.0, MASS, delay=0.75e-3)).velocity_loop()
    f = loop.bandwidth()
    assert np.abs(loop.closed([f]))[0] == pytest.approx(math.sqrt(0.5), rel=1e-9)
    # Nothing below it is as low.
    assert np.abs(loop.closed(np.linspace(1.0, 0.999 * f, 2000))).min() > math.sqrt(0.5)
