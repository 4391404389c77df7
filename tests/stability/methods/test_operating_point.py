"""Limits whose compliance belongs to the feed and the force of the cut: no dependence, planted ones, islands."""

import math

import numpy as np
import pytest
import xarray as xr

from process import InputError
from process.cut.force import force_harmonics
from stability import zero_order
from stability.methods.operating_point import operating_point

SPEEDS = np.linspace(500.0, 2500.0, 6)
FEED = 1e-4


def over(base: xr.Dataset, name: str, nodes, factor) -> xr.Dataset:
    """Repeat a compliance over a condition, times a factor at each node."""
    nodes = np.asarray(nodes, dtype=float)
    out = base.expand_dims({name: nodes}).copy()
    out["compliance"] = out["compliance"] * xr.DataArray(np.asarray(factor, dtype=float), dims=name)
    out["compliance"].attrs["units"] = "m/N"
    return out


@pytest.fixture(scope="module")
def base(authors):
    return authors.compliance(2, 250, 0.25)


@pytest.fixture(scope="module")
def plain(authors, base):
    return zero_order(base, *authors.cut, SPEEDS)


def test_conditions_without_influence_give_the_zero_order_limit(authors, base, plain):
    same = over(over(base, "force_level", [10, 1e3, 1e4], [1, 1, 1]), "feed", [0, 300, 1000], [1, 1, 1])
    found = operating_point(same, *authors.cut, SPEEDS, FEED)
    np.testing.assert_allclose(found.limit_depth, plain.limit_depth, rtol=1e-12)
    np.testing.assert_allclose(found.chatter_frequency, plain.chatter_frequency, rtol=1e-12)
    np.testing.assert_allclose(found.vibration, plain.vibration, atol=1e-10)
    np.testing.assert_array_equal(found.lobe, plain.lobe)
    assert found.sizes["crossing"] == 1
    assert found.attrs["warnings"] == []
    assert found.attrs["method"] == "operating_point"
    assert {n: found[n].attrs["units"] for n in ("limit_depth", "feed", "force_level", "crossing_depth")} == {
        "limit_depth": "mm",
        "feed": "mm/min",
        "force_level": "N",
        "crossing_depth": "mm",
    }


def test_a_machine_that_softens_with_the_depth(authors, base, plain):
    # Phi (1 + b a): L_0/(1 + b a) = a, so a = (sqrt(1 + 4 b L_0) - 1)/(2 b)
    b = 0.2
    soft = over(base, "depth_of_cut", [0, 20], [1, 1 + 20 * b])
    found = operating_point(soft, *authors.cut, SPEEDS, FEED)
    limit = plain.limit_depth.values
    np.testing.assert_allclose(found.limit_depth, (np.sqrt(1 + 4 * b * limit) - 1) / (2 * b), rtol=1e-10)
    np.testing.assert_allclose(found.depth_of_cut, found.limit_depth, rtol=1e-10)
    np.testing.assert_allclose(found.chatter_frequency, plain.chatter_frequency, rtol=1e-9)


def test_the_feed_of_each_speed_is_that_of_the_teeth(authors, base, plain):
    # Phi (1 + v/1000) with v = f_z N n
    moving = over(base, "feed", [0, 1000], [1, 2])
    found = operating_point(moving, *authors.cut, SPEEDS, FEED)
    feed = 0.1 * 2 * SPEEDS
    np.testing.assert_allclose(found.feed, feed)
    np.testing.assert_allclose(found.limit_depth, plain.limit_depth / (1 + feed / 1000), rtol=1e-10)


def test_the_force_level_is_the_first_tooth_passing_harmonic(authors, base, plain):
    # Phi (1 + F/F_1): F = c a, so L_0/(1 + c a/F_1) = a again
    tool, arc, coefficients = authors.cut
    c = float(np.linalg.norm(force_harmonics(tool, arc, coefficients, 1e-3, FEED, [1])))
    soft = over(base, "force_level", [0, 40 * c], [1, 41])
    found = operating_point(soft, *authors.cut, SPEEDS, FEED)
    limit = plain.limit_depth.values
    expected = (np.sqrt(1 + 4 * limit) - 1) / 2
    np.testing.assert_allclose(found.limit_depth, expected, rtol=1e-9)
    np.testing.assert_allclose(found.force_level, c * expected, rtol=1e-9)
    given = operating_point(soft, *authors.cut, SPEEDS, FEED, lambda depth: 2e3 * c * depth)
    np.testing.assert_allclose(given.limit_depth, (np.sqrt(1 + 8 * limit) - 1) / 4, rtol=1e-9)


def test_a_machine_that_stiffens_is_stable_again_deeper(authors, base, plain):
    # Stiff from 1.2 L to 3 L: lost at L, won within the rise, lost again at the limit of the stiff machine.
    limit = float(plain.limit_depth[1])
    nodes = np.array([0.5, 1.1, 1.3, 6.0]) * limit
    stiffer = over(base, "depth_of_cut", nodes, [1, 1, 0.5, 0.5])
    found = operating_point(stiffer, *authors.cut, SPEEDS[1:2], FEED)
    lost, won, again = found.crossing_depth.values[0]
    assert lost == pytest.approx(limit, rel=1e-10)
    # Between 1.1 and 1.3 L the factor falls linearly, k = 1 - 2.5 (a/L - 1.1), and 1/k = a/L.
    x = (3.75 - math.sqrt(3.75**2 - 10.0)) / 5.0
    assert won == pytest.approx(limit * (x if 1.1 < x < 1.3 else (3.75 + math.sqrt(3.75**2 - 10.0)) / 5.0), rel=1e-9)
    assert again == pytest.approx(2 * limit, rel=1e-10)
    assert float(found.limit_depth[0]) == pytest.approx(limit, rel=1e-10)


def test_a_condition_outside_the_measured_ones_is_said(authors, base):
    moving = over(over(base, "feed", [200, 300], [1, 2]), "depth_of_cut", [10, 20], [1, 1])
    warnings = operating_point(moving, *authors.cut, SPEEDS, FEED).attrs["warnings"]
    assert any("lie at a feed outside the measured 200 to 300 mm/min (asked: 100 to 500 mm/min)" in w for w in warnings)
    assert any("depth_of_cut outside the measured 10 to 20 mm" in w for w in warnings)


def test_a_frequency_that_one_condition_lacks_is_a_gap(authors, base):
    moving = over(base, "feed", [0, 1000], [1, 2])
    values = moving["compliance"].values
    values[1, (base.frequency.values > 100) & (base.frequency.values < 110)] = np.nan
    warnings = operating_point(moving, *authors.cut, SPEEDS, FEED).attrs["warnings"]
    assert any("missing between its samples in 1 band(s): 100 to 110 Hz" in w for w in warnings)


def test_what_is_refused(authors, base):
    moving = over(base, "feed", [0, 1000], [1, 2])
    with pytest.raises(InputError, match=r"say at which operating point it holds.*zero-order"):
        operating_point(base, *authors.cut, SPEEDS, FEED)
    with pytest.raises(InputError, match="feed per tooth is 0 mm"):
        operating_point(moving, *authors.cut, SPEEDS, 0.0)
    with pytest.raises(InputError, match="must be finite and rise"):
        operating_point(moving.isel(feed=[1, 0]), *authors.cut, SPEEDS, FEED)
    with pytest.raises(InputError, match="dimension 'controller'"):
        operating_point(over(moving, "controller", [1, 2], [1, 1]), *authors.cut, SPEEDS, FEED)
    deep = over(base, "depth_of_cut", [1, 2], [1, 1])
    with pytest.raises(InputError, match="force_level has no use"):
        operating_point(deep, *authors.cut, SPEEDS, FEED, lambda depth: depth)
    level = over(base, "force_level", [1, 2], [1, 1])
    with pytest.raises(InputError, match="it must rise with the depth"):
        operating_point(level, *authors.cut, SPEEDS, FEED, lambda depth: 0.5)
