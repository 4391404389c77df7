"""Limits whose compliance belongs to the feed and the force of the cut: no dependence, planted ones, islands."""

import math

import numpy as np
import pytest
import xarray as xr

from process import CuttingCoefficients, InputError, ModalModel, Tool, engagement
from process.cut.force import force_harmonics
from stability import Spread, linearised_band, zero_order
from stability.operating.operating_point import operating_point

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
    for name in ("limit_depth", "lower_limit_depth"):
        np.testing.assert_allclose(found[name], plain.limit_depth, rtol=1e-12)
    np.testing.assert_allclose(found.chatter_frequency, plain.chatter_frequency, rtol=1e-12)
    np.testing.assert_allclose(found.vibration, plain.vibration, atol=1e-4)
    np.testing.assert_array_equal(found.lobe, plain.lobe)
    np.testing.assert_array_equal(found.kick, 0.0)
    assert found.attrs["warnings"] == [
        "a small disturbance is one of 10 N, the lowest level that was measured at a feed"
    ]
    assert found.attrs["method"] == "operating_point"
    assert {n: found[n].attrs["units"] for n in ("limit_depth", "feed", "lower_limit_depth", "kick")} == {
        "limit_depth": "mm",
        "feed": "mm/min",
        "lower_limit_depth": "mm",
        "kick": "N s",
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


def test_a_vibration_that_is_softer_has_the_lower_limit_of_its_level(authors, base, plain):
    # Twice the compliance at 400 N: half the limit there, and straight lines between.
    soft = over(base, "force_level", [1, 400, 1000], [1, 2, 1.5])
    found = operating_point(soft, *authors.cut, SPEEDS, FEED)
    np.testing.assert_allclose(found.limit_depth, plain.limit_depth, rtol=1e-12)
    np.testing.assert_allclose(found.lower_limit_depth, 0.5 * plain.limit_depth, rtol=1e-9)
    half = int(np.abs(found.cycle_amplitude.values[0] - 200.5).argmin())
    assert float(found.cycle_amplitude[0, half]) == pytest.approx(200.5)
    np.testing.assert_allclose(found.cycle_depth[:, half], plain.limit_depth / 1.5, rtol=1e-9)
    assert not any("highest level" in w for w in found.attrs["warnings"])
    falling = operating_point(over(base, "force_level", [1, 400], [1, 2]), *authors.cut, SPEEDS, FEED)
    assert any("that of the highest level" in w for w in falling.attrs["warnings"])


def test_a_kick_of_one_mode_has_its_closed_form():
    # One mode along x that only the chips of its own direction turn: J = F |2 zeta ... | of the pole in the cut.
    m, f0, zeta = 10.0, 60.0, 0.02
    machine = ModalModel([f0], [zeta], [m * (2 * math.pi * f0) ** 2], [[1.0, 0.0, 0.0]])
    level = over(machine.compliance(np.arange(20.0, 200.0, 0.1)), "force_level", [1, 50], [1, 1.2])
    cut = Tool(0.05, 4), engagement("down", 0.05, 0.05), CuttingCoefficients(780e6, 351e6, 0.0)
    found = operating_point(level, *cut, [1000.0], 1e-4)
    # D = m s^2 + c s + k + K a (1 - exp(-s T)) with Phi times 1.2: all of m, c, k over 1.2.
    w, depth = 2 * math.pi * float(found.lower_chatter_frequency[0]), 1e-3 * float(found.lower_limit_depth[0])
    period, s = 60.0 / 4000.0, 1j * w
    slope = (2 * m * s + 2 * zeta * m * 2 * math.pi * f0) / 1.2 + 351e6 * depth * period * np.exp(-s * period)
    tip = 2.0 / abs(slope)  # amplitude a N s
    force = 351e6 * depth * abs(1 - np.exp(-s * period)) * tip
    assert float(found.kick[0]) == pytest.approx(50.0 / force, rel=1e-3)


def test_a_level_that_follows_the_depth_has_its_root(authors, base, plain):
    # Phi (1 + F/F_1): F = c a, so L_0/(1 + c a/F_1) = a again
    tool, arc, coefficients = authors.cut
    c = float(np.linalg.norm(force_harmonics(tool, arc, coefficients, 1e-3, FEED, [1])))
    soft = over(base, "force_level", [0, 40 * c], [1, 41])
    limit = plain.limit_depth.values
    given = operating_point(soft, *authors.cut, SPEEDS, FEED, lambda depth: 2e3 * c * depth)
    np.testing.assert_allclose(given.limit_depth, (np.sqrt(1 + 8 * limit) - 1) / 4, rtol=1e-9)
    np.testing.assert_allclose(given.force_level, 2 * c * given.limit_depth, rtol=1e-9)


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


def test_outside_the_measured_conditions_no_limit_is_given(authors, base, plain):
    moving = over(over(base, "feed", [200, 300], [1, 2]), "depth_of_cut", [0, 20], [1, 1])
    found = operating_point(moving, *authors.cut, SPEEDS, FEED)
    inside = (found.feed.values >= 200) & (found.feed.values <= 300)
    np.testing.assert_array_equal(np.isfinite(found.limit_depth), inside)
    (text,) = [w for w in found.attrs["warnings"] if "not known" in w]
    assert text.startswith("5 of 6 limits are not known, at a feed outside the measured 200 to 300 mm/min (asked: 100")
    shallow = over(base, "depth_of_cut", [0, 0.5 * float(plain.limit_depth.min())], [1, 1])
    found = operating_point(shallow, *authors.cut, SPEEDS, FEED)
    assert np.isnan(found.limit_depth).all()
    assert "at a depth of cut outside the measured 0 to" in found.attrs["warnings"][-1]
    np.testing.assert_allclose(found.stable_to, 0.5 * float(plain.limit_depth.min()))


def test_the_error_of_straight_lines_between_feeds_is_that_of_a_parabola(authors, base, plain):
    # Phi (1 + (v/1000)^2) has in the middle of two feeds h apart an error of (h/1000)^2/4 on Phi.
    feeds = np.array([0.0, 250.0, 500.0])
    moving = over(base, "feed", feeds, 1.0 + (feeds / 1000) ** 2)
    found = operating_point(moving, *authors.cut, SPEEDS, FEED)
    at = (feeds[1] / 1000) ** 2
    expected = 1.0 - (1.0 + at) / (1.0 + 2.0 * at)  # the middle left out: (1 + 1 + (2h)^2)/2 for 1 + h^2
    assert found.attrs["interpolation_error"] == pytest.approx(expected / 4.0, rel=1e-6)
    (text,) = found.attrs["warnings"]
    assert "feeds left out one by one say that limits are off by up to 1.4 %" in text
    two = operating_point(moving.isel(feed=[0, 2]), *authors.cut, SPEEDS, FEED)
    assert "cannot be told from two feeds" in two.attrs["warnings"][0]


def test_the_band_of_a_measured_compliance_is_that_of_its_errors(authors, base):
    # Against 400 draws at one feed between two.
    moving = over(base, "feed", [0, 1000], [1, 1])
    std = 0.002 * float(np.abs(base["compliance"]).max())
    moving["compliance_std"] = moving["compliance"].dims, np.full(moving["compliance"].shape, std)
    found = operating_point(moving, *authors.cut, [1500.0], FEED, uncertainty={"coefficients": 0.05})
    one = base.copy()
    share = 0.3  # 300 of 1000 mm/min: both conditions err independently
    one["compliance_std"] = (
        base["compliance"].dims,
        np.full(base["compliance"].shape, std * math.hypot(share, 1 - share)),
    )
    drawn = linearised_band(one, *authors.cut, [1500.0], Spread(common=0.05))
    own = found["limit_depth_quantile"].values[:, 0]
    width = np.log(drawn["limit_depth_quantile"].values[-1, 0] / drawn["limit_depth_quantile"].values[0, 0])
    assert math.log(own[2] / own[0]) == pytest.approx(width, rel=0.1)
    assert float(found.safe_depth[0]) == own[0] < own[1] == float(found.limit_depth[0])
    plain = operating_point(over(base, "feed", [0, 1000], [1, 1]), *authors.cut, [1500.0], FEED, uncertainty={})
    assert "limit_depth_quantile" not in plain


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
