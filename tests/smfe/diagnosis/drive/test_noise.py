"""How well a whitener is known: draws scatter about it as an estimate from so few values must."""

from math import sqrt

import numpy as np
import pytest
from scipy import signal

from smfe.diagnosis.drive.noise import NoiseDraw, fit_whitener, noise_draws


def moves_of(count, length, seed=0):
    """Noise with a pole, the reference of a few hats over each move, and what it leaves."""
    rng = np.random.default_rng(seed)
    noise = signal.lfilter([1.0], [1.0, -0.6], rng.standard_normal(count * length + 300))[300:]
    place = np.tile(np.linspace(0.0, 1.0, length), count)
    hats = np.stack([np.interp(place, np.linspace(0.0, 1.0, 8), row) for row in np.eye(8)], axis=1)
    left = noise - hats @ np.linalg.lstsq(hats, noise)[0]
    return np.split(left, count), hats


@pytest.mark.parametrize(("count", "length"), [(12, 40), (48, 40)])
def test_the_size_of_the_noise_is_known_by_the_root_of_twice_the_values(count, length):
    """sd(log sigma) = 1/sqrt(2 (N - p)), of a kind with a quarter of the moves twice that."""
    moves, hats = moves_of(count, length)
    kinds = ["slow" if k % 4 == 0 else "fast" for k in range(count)]
    draws = noise_draws(fit_whitener(moves, hats), moves, hats, kinds)
    values = count * length - hats.shape[1]
    assert len(draws) >= 30
    whole = np.std([np.log(d.above[0]) for d in draws])
    assert whole == pytest.approx(1.0 / sqrt(2.0 * values), rel=0.5)
    # The whitener of a draw makes the draw as a whole white: a quarter differs from it by sqrt(4 - 1).
    slow = np.std([np.log(d.size["slow"]) for d in draws])
    assert slow == pytest.approx(sqrt(3.0) / sqrt(2.0 * values), rel=0.5)


def test_draws_scatter_about_what_was_learned():
    """The power of a slow pattern: no bias beyond its own error, and a spread that falls with the number of moves."""
    spread = {}
    for count in (12, 108):
        moves, hats = moves_of(count, 40)
        draws = noise_draws(fit_whitener(moves, hats), moves, hats, ["any"] * count)
        pattern = np.repeat(np.where(np.arange(count) % 4 < 2, 1.0, -1.0), 40)[:, None]
        power = [np.sum(d.coloured_products(pattern) ** 2) / pattern.size for d in draws]
        spread[count] = np.std(np.log(power))
        assert abs(np.mean(np.log(power))) < 4.0 * spread[count] / sqrt(len(draws))
    assert 1.3 < spread[12] / spread[108] < 6.0


def test_the_noise_of_the_whitener_itself_changes_nothing():
    taps = np.array([1.0, -0.5, 0.1])
    columns = np.random.default_rng(0).standard_normal((60, 2))
    same = NoiseDraw(taps, taps, {}).coloured_products(columns)
    assert same[:60] == pytest.approx(columns[::-1], abs=1e-12)


def test_products_have_the_covariance_of_the_noise_that_is_drawn():
    """X^T e with e = H white, by simulation."""
    draw = NoiseDraw(np.array([1.2, 0.3]), np.array([1.0, -0.8]), {})
    columns = np.random.default_rng(1).standard_normal((50, 2))
    white = np.random.default_rng(2).standard_normal((20_000, 250))
    noise = signal.lfilter(draw.above, draw.below, white, axis=1)[:, 200:]
    through = draw.coloured_products(columns)
    assert through.T @ through == pytest.approx(np.cov((noise @ columns).T), rel=0.05, abs=3.0)
