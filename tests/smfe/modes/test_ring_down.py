"""Frequency and damping over a free decay: closed forms, a neighbour, noise, an integration in time."""

import numpy as np
import pytest
from truth.decay import Oscillator, free_decay

from process.errors import InputError
from smfe.modes.ring_down import ring_down

RATE = 4000.0
T = np.arange(int(4.0 * RATE)) / RATE


def mode(frequency: float, damping: float, amplitude: float = 1.0) -> np.ndarray:
    w = 2.0 * np.pi * frequency
    return amplitude * np.exp(-damping * w * T) * np.cos(w * np.sqrt(1.0 - damping**2) * T)


def test_a_linear_mode_beside_another_has_its_frequency_and_damping_at_every_level() -> None:
    found = ring_down(mode(80.0, 2e-3) + mode(300.0, 1e-3, 3.0), RATE, (30.0, 130.0), hit=0.0)
    np.testing.assert_allclose(found["frequency"], 80.0 * np.sqrt(1.0 - 4e-6), rtol=1e-5)
    np.testing.assert_allclose(found["damping"], 2e-3, rtol=2e-3)
    expected = np.exp(-2e-3 * 2 * np.pi * 80.0 * found["time"].values)
    np.testing.assert_allclose(found["amplitude"], expected, rtol=2e-3)


def test_the_standard_deviations_are_those_of_the_noise() -> None:
    pulls = []
    for seed in range(12):
        x = mode(80.0, 2e-3) + 3e-3 * np.random.default_rng(seed).standard_normal(T.size)
        found = ring_down(x, RATE, (30.0, 130.0), hit=0.0)
        pulls += list((found["frequency"].values - 80.0) / found["frequency_std"].values)
        pulls += list((found["damping"].values - 2e-3) / found["damping_std"].values)
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.6


def test_a_decay_is_read_until_it_meets_the_noise() -> None:
    x = mode(80.0, 2e-3) + 0.1 * np.random.default_rng(1).standard_normal(T.size)
    found = ring_down(x, RATE, (30.0, 130.0), hit=0.0)
    assert found["amplitude"].values[-1] > 5.0 * found.attrs["noise"]
    assert found["time"].values[-1] < 3.5


def test_a_spring_that_hardens_has_the_frequency_of_its_level() -> None:
    rate, x = free_decay(Oscillator(cubic=0.05))
    found = ring_down(x, rate, (40.0, 120.0), hit=0.0)
    # The acceleration is that of the fundamental over 1 + 3/4 of the cubic share, near enough.
    expected = 80.0 * np.sqrt(1.0 + 0.75 * 0.05 * found["amplitude"].values ** 2)
    np.testing.assert_allclose(found["frequency"], expected, atol=0.1)
    assert found["frequency"].values[0] - found["frequency"].values[-1] > 0.3


@pytest.mark.parametrize(
    ("signal", "band", "says"),
    [
        (np.ones((2, 2)), (30.0, 130.0), "one row"),
        (mode(80.0, 2e-3), (130.0, 30.0), "below half"),
        (mode(80.0, 2e-3), (100.0, 130.0), "at the edge"),
        (mode(80.0, 2e-3)[:2500], (30.0, 130.0), "windows"),
        (mode(80.0, 2e-3)[:500], (30.0, 130.0), "ends with the hit"),
        (mode(80.0, 2e-3)[:20], (30.0, 130.0), "fewer than three lines"),
    ],
)
def test_what_cannot_be_read_is_refused_with_what_is_needed(signal, band, says) -> None:
    with pytest.raises(InputError, match=says):
        ring_down(signal, RATE, band, hit=0.0)
