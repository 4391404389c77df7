"""Depths on the grid of a search against `stability.zero_order`, and tracking errors against closed forms."""

import numpy as np
import pytest

from process import CuttingCoefficients, Drive, Machine, Tool, engagement, tune
from process.errors import InputError
from process.labels import AXES, make_compliance
from process.machine.modes import ModalModel
from process.types import Complex, Real
from smfe.tuning.depths import Oriented, branches, least_depth, limits
from smfe.tuning.loops import close, gains_of
from smfe.tuning.plants import ModelSource, grid_of
from smfe.tuning.tracking import Move
from stability import zero_order
from stability.problem import Cut

ALUMINIUM = CuttingCoefficients(780e6, 351e6, 0.0)
SLOT = Tool(0.0508, 4), engagement("up", 0.0508, 0.0508)
SPEEDS = np.array([800.0, 920.0, 1000.0, 1200.0, 1500.0, 1800.0, 2000.0, 2250.0, 2500.0])


def test_the_bench_has_the_limits_of_its_controllers() -> None:
    """Reference values of the closed loop of five states, by semi-discretisation."""
    source = ModelSource(Machine.of_axis(Drive(23.1, 11.3, 1.68e6, 104.0)).at(), ("x",), (0.0,))
    plant = source.plant(grid_of(source, 500.0, 3000))
    oriented = Oriented.of(Cut(*SLOT, ALUMINIUM).directional_matrix(), plant.directions)
    mu = close(plant, oriented, np.array([gains_of([tune(f, 34.4)]) for f in (15.0, 29.0, 49.0)])).eigenvalue
    expected = [
        [1.561, 2.722, 3.700, 3.034, 1.129, 1.137, 1.328, 1.734, 2.332],
        [1.922, 2.948, 3.858, 3.483, 1.646, 1.586, 1.760, 2.141, 2.693],
        [2.267, 3.227, 4.078, 2.427, 1.816, 1.885, 2.092, 2.490, 3.035],
    ]
    np.testing.assert_allclose(1e3 * limits(plant.frequency, mu, 60.0 / (4 * SPEEDS)), expected, rtol=2e-3)
    least = 1e3 * least_depth(plant.frequency, mu, (60.0 / (4 * 2500.0), 60.0 / (4 * 800.0)))
    np.testing.assert_allclose(least, [1.078, 1.549, 1.798], rtol=1e-3)


@pytest.mark.parametrize("angle", [90.0, 45.0])
def test_three_directions_have_the_limits_of_the_zero_order_method(angle: float) -> None:
    """Two eigenvalues with a straight edge, three with an inclined one; single speeds, and the least over a range."""
    modes = ModalModel(
        [24.0, 29.0, 33.0], [0.04, 0.05, 0.03], [3e7, 4e7, 3.5e7], [(0.1, 1.0, 0.2), (0.7, 0.6, 0.3), (1.0, -0.2, 0.1)]
    )
    tool, arc = Tool(0.125, 8, np.radians(angle)), engagement("down", 0.06, 0.125)
    steel = CuttingCoefficients(1900e6, 700e6, 300e6)
    f = np.arange(2.0, 150.0, 0.02)
    phi = modes.matrix(f)
    oriented = Oriented.of(Cut(tool, arc, steel).directional_matrix(), (0, 1, 2))
    mu = branches(oriented.both(phi)[None])
    assert mu.shape[1] == (2 if angle == 90.0 else 3)
    speed = np.linspace(300.0, 700.0, 101)
    expected = zero_order(make_compliance(f, phi, AXES, AXES), tool, arc, steel, speed)["limit_depth"].values
    np.testing.assert_allclose(1e3 * limits(f, mu, 60.0 / (8 * speed))[0], expected, rtol=1e-4)
    least = 1e3 * least_depth(f, mu, (60.0 / (8 * 700.0), 60.0 / (8 * 300.0)))[0]
    assert expected.min() * 0.995 < least <= expected.min() * 1.0001


def first_order(kv: float) -> tuple[Real, Complex]:
    """Frequencies and an axis that follows as ``Kv/(s + Kv)``."""
    f = np.geomspace(1e-3, 1e4, 4000)
    return f, (kv / (2j * np.pi * f + kv))[None, None]


def test_a_circle_comes_out_too_small_by_what_a_lag_of_first_order_takes() -> None:
    move = Move("circle", 0.1, 0.01)
    f = np.array(move.frequency)
    follows = (50.0 / (2j * np.pi * f + 50.0))[None, None]
    expected = 0.01 * (1.0 - 1.0 / np.hypot(1.0, 10.0 / 50.0))
    np.testing.assert_allclose(move.error(f, follows, np.array([[50.0]]), np.zeros((1, 1))), expected, rtol=1e-9)


def test_axes_that_differ_make_an_ellipse_of_a_circle() -> None:
    """Equal amplitudes with a phase p between them: the half axes are ``sqrt(1 +- sin p)``."""
    move = Move("circle", 0.1, 0.01)
    follows = np.exp(-1j * np.array([0.0, 0.2]))[None, :, None]
    found = move.error(np.array(move.frequency), follows, np.ones((1, 2)), np.zeros((1, 2)))
    np.testing.assert_allclose(found, 0.01 * (1.0 - np.sqrt(1.0 - np.sin(0.2))), rtol=1e-3)


@pytest.mark.parametrize("kv", [20.0, 80.0])
def test_a_corner_is_rounded_as_two_lags_of_first_order_round_it(kv: float) -> None:
    v = 0.05
    f, follows = first_order(kv)
    t = np.linspace(0.0, 5.0 / kv, 100000)
    starts, stops = v * (t - (1.0 - np.exp(-kv * t)) / kv), -v / kv * np.exp(-kv * t)
    found = Move("corner", v).error(f, follows, np.array([[kv]]), np.zeros((1, 1)))
    np.testing.assert_allclose(found, np.hypot(starts, stops).min(), rtol=0.01)


def test_following_is_the_lag_of_the_slowest_axis_less_the_share_of_the_feed_forward() -> None:
    lag = Move("following", 0.1).error(np.ones(1), np.ones((1, 2, 1)), np.array([[50.0, 20.0]]), np.array([[0.0, 0.5]]))
    np.testing.assert_allclose(lag, 0.1 * 0.5 / 20.0)


def test_moves_that_say_too_little_are_refused() -> None:
    with pytest.raises(InputError, match="a circle needs its radius"):
        Move("circle", 0.1)
    with pytest.raises(InputError, match="name one of following, circle, corner"):
        Move("spiral")
