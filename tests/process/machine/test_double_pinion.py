"""Double pinion: its force by hand, its describing function by quadrature, and the limits of the preload."""

import math

import numpy as np
import pytest

from process.errors import InputError
from process.machine.joints import DoublePinion, Gap, Joint

K1, K2, PLAY, PRELOAD = 8e7, 5e7, 30e-6, 2000.0
PINIONS = DoublePinion(K1, K2, PLAY, PRELOAD)


def by_hand(x: float, k: float, flank: float, side: float) -> float:
    """One tooth: its flank towards `side` touches until the rack has moved by `flank`, the other one a play later."""
    moved = side * x
    if moved < flank:
        return side * k * (moved - flank)
    return side * k * max(0.0, moved - flank - PLAY)


def test_the_force_is_that_of_two_teeth_one_after_the_other() -> None:
    x = np.linspace(-150e-6, 150e-6, 1001)
    expected = [by_hand(v, K1, PRELOAD / K1, 1.0) + by_hand(v, K2, PRELOAD / K2, -1.0) for v in x]
    np.testing.assert_allclose(PINIONS.force(x), expected, atol=1e-9)
    assert isinstance(PINIONS, Joint)


def test_both_pinions_work_up_to_the_lift_off_force_then_one_then_both_again() -> None:
    low, high = PINIONS.lift_off_displacements
    assert float(PINIONS.force(high)) == pytest.approx((K1 + K2) * PRELOAD / K1)
    assert -float(PINIONS.force(low)) == pytest.approx((K1 + K2) * PRELOAD / K2)
    assert PINIONS.lift_off_force == pytest.approx(min(float(PINIONS.force(high)), -float(PINIONS.force(low))))

    def slope(x: float) -> float:
        return float(PINIONS.force(x + 1e-8) - PINIONS.force(x - 1e-8)) / 2e-8

    slopes = [slope(x) for x in (low - 1.1 * PLAY, low - 0.5 * PLAY, 0.0, high + 0.5 * PLAY, high + 1.1 * PLAY)]
    np.testing.assert_allclose(slopes, [K1 + K2, K1, K1 + K2, K2, K1 + K2], rtol=1e-6)
    assert DoublePinion(K1, K1, PLAY, PRELOAD).lift_off_force == pytest.approx(2.0 * PRELOAD)


def quadrature(joint: DoublePinion, x: float, bias: float) -> tuple[float, float]:
    w = (np.arange(200000) + 0.5) * 2.0 * np.pi / 200000
    force = joint.force(bias + x * np.cos(w))
    return 2.0 * float(np.mean(force * np.cos(w))) / x, float(np.mean(force))


@pytest.mark.parametrize("bias", [0.0, 12e-6, -60e-6, 300e-6])
@pytest.mark.parametrize("amplitude", [1e-6, 30e-6, 70e-6, 500e-6])
def test_stiffness_and_mean_force_are_the_fourier_coefficients(amplitude: float, bias: float) -> None:
    stiffness, mean = quadrature(PINIONS, amplitude, bias)
    assert float(PINIONS.equivalent_stiffness(amplitude, bias)) == pytest.approx(stiffness, rel=1e-7)
    assert float(PINIONS.mean_force(amplitude, bias)) == pytest.approx(mean, rel=1e-7, abs=1e-5)


def test_a_large_preload_makes_the_joint_linear() -> None:
    x = np.geomspace(1e-6, 1e-3, 30)
    tight = DoublePinion(K1, K2, PLAY, 1e9)
    np.testing.assert_allclose(tight.equivalent_stiffness(x), K1 + K2, rtol=1e-12)
    np.testing.assert_allclose(tight.force(x), (K1 + K2) * x, rtol=1e-6)
    # And with any preload the joint is linear below the lift-off.
    below = 0.999 * PRELOAD / K1
    assert float(PINIONS.equivalent_stiffness(below)) == pytest.approx(K1 + K2, rel=1e-12)
    assert float(PINIONS.equivalent_stiffness(1.2 * PRELOAD / K1)) < K1 + K2


def test_without_preload_equal_pinions_are_one_pinion_and_a_gap() -> None:
    loose = DoublePinion(K1, K1, PLAY, 0.0)
    x = np.array([5e-6, 29e-6, 31e-6, 60e-6, 1e-3])
    gap = Gap(K1, PLAY)
    np.testing.assert_allclose(loose.equivalent_stiffness(x), K1 + gap.equivalent_stiffness(x), rtol=1e-12)
    np.testing.assert_allclose(loose.force(x), K1 * x + gap.force(x), rtol=1e-12)
    # Teeth without backlash cannot lift off.
    np.testing.assert_allclose(DoublePinion(K1, K2, 0.0, 0.0).equivalent_stiffness(x), K1 + K2, rtol=1e-12)


def test_one_pinion_that_vanishes_leaves_the_other_with_its_play() -> None:
    # The slave carries nothing: the master's gap, seen from its middle.
    single = DoublePinion(K1, 1e-6, PLAY, 0.0)
    x = np.geomspace(16e-6, 1e-3, 20)
    middle = single.equivalent_stiffness(x, 0.5 * PLAY)
    np.testing.assert_allclose(middle, Gap(K1, 0.5 * PLAY).equivalent_stiffness(x), rtol=1e-6)


def test_master_and_slave_are_mirror_images() -> None:
    x, mirrored = np.linspace(-2e-4, 2e-4, 101), DoublePinion(K2, K1, PLAY, PRELOAD)
    np.testing.assert_allclose(PINIONS.force(-x), -mirrored.force(x), atol=1e-9)
    amplitude = np.array([2e-5, 5e-5, 2e-4])
    np.testing.assert_allclose(
        PINIONS.equivalent_stiffness(amplitude, 1e-5), mirrored.equivalent_stiffness(amplitude, -1e-5), rtol=1e-12
    )


@pytest.mark.parametrize("force", [0.0, 1500.0, -6000.0, 30000.0])
def test_the_bias_of_a_mean_force_carries_that_force(force: float) -> None:
    bias = PINIONS.bias_of(force, 60e-6)
    assert float(PINIONS.mean_force(60e-6, bias)) == pytest.approx(force, rel=1e-9, abs=1e-6)


def test_a_cutting_force_beyond_the_lift_off_halves_the_stiffness_of_a_small_vibration() -> None:
    equal = DoublePinion(K1, K1, PLAY, PRELOAD)
    for force, pinions in ((0.9 * 2 * PRELOAD, 2), (1.1 * 2 * PRELOAD, 1)):
        bias = equal.bias_of(force, 1e-7)
        assert float(equal.equivalent_stiffness(1e-7, bias)) == pytest.approx(pinions * K1, rel=1e-6)


def test_the_energy_of_a_cycle_is_zero() -> None:
    w = np.linspace(0.0, 2.0 * np.pi, 20001)
    x = 1e-5 + 8e-5 * np.cos(w)
    work = np.trapezoid(PINIONS.force(x), x)
    assert abs(work) < 1e-9 * np.abs(PINIONS.force(x)).max() * 8e-5
    assert float(PINIONS.loss_stiffness(8e-5)) == 0.0


def test_a_torque_acts_at_the_pitch_radius() -> None:
    assert DoublePinion.from_torque(K1, K2, PLAY, 100.0, 0.05) == DoublePinion(K1, K2, PLAY, 2000.0)


def test_what_is_no_double_pinion_is_refused() -> None:
    with pytest.raises(InputError, match="stiffness of the slave is 0"):
        DoublePinion(K1, 0.0, PLAY, PRELOAD)
    with pytest.raises(InputError, match="gap -1e-06 m"):
        DoublePinion(K1, K2, -1e-6, PRELOAD)
    with pytest.raises(InputError, match="not negative"):
        DoublePinion(K1, K2, PLAY, -1.0)
    with pytest.raises(InputError, match="pitch radius"):
        DoublePinion.from_torque(K1, K2, PLAY, 1.0, 0.0)
    with pytest.raises(InputError, match="amplitudes > 0"):
        PINIONS.equivalent_stiffness([1e-6, 0.0])
    with pytest.raises(InputError, match="must be finite"):
        PINIONS.bias_of(math.inf, 1e-6)
