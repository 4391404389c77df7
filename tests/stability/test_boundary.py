"""Boundary finder: closed-form boundaries, islands, every band, cost against a plain grid, and a reference island."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from process.errors import InputError
from stability import floquet_multipliers, stability_bands
from stability.boundary import Axis, find_boundary, pointwise


def circle(x, y):
    """Unstable inside a circle of radius 1/2."""
    return 0.25 - x**2 - y**2


def sinusoids(speed, depth):
    """Lobes with cusps: the lower envelope of sinusoids of unlike period."""
    return depth - envelope(speed)


def envelope(speed):
    return np.minimum(0.45 + 0.3 * np.sin(7.0 * speed), 0.5 + 0.25 * np.cos(11.0 * speed))


PLANE = Axis("x", -1.0, 1.0), Axis("y", -1.0, 1.0)
LOBES = Axis("speed", 0.0, 3.0), Axis("depth", 0.0, 1.0)


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-7])
def test_a_circle_is_one_closed_curve_within_the_tolerance(tolerance):
    points = find_boundary(circle, *PLANE, tolerance=tolerance).points
    assert points["curve"].nunique() == 1
    assert points["closed"].all()
    # Along an edge that meets the circle at a slant the radius errs by less.
    assert np.abs(np.hypot(points["x"], points["y"]) - 0.5).max() <= 2.0 * tolerance
    # The points follow the boundary: a neighbour is never further than across a cell.
    step = np.hypot(np.diff(points["x"]), np.diff(points["y"]))
    assert step.max() <= math.hypot(2.0, 2.0) / 128
    area = 0.5 * abs(np.sum(points["x"] * np.roll(points["y"], -1) - points["y"] * np.roll(points["x"], -1)))
    assert area == pytest.approx(math.pi / 4, rel=2e-3 + 10 * tolerance)


def test_lobes_with_cusps_are_followed_through_every_corner():
    found = find_boundary(sinusoids, *LOBES, tolerance=1e-6)
    assert found.points["curve"].nunique() == 1
    assert not found.points["closed"].any()
    bands = found.bands[found.bands["stable"]].groupby("speed")["to"].first()
    np.testing.assert_allclose(bands, envelope(bands.index.to_numpy()), atol=1e-6)
    np.testing.assert_array_equal(found.bands.groupby("speed").size(), 2)


def test_every_band_of_nested_rings_is_reported_not_only_the_first_crossing():
    def rings(x, y):
        return np.cos(3.0 * math.pi * np.hypot(x, y) + 0.3)

    found = find_boundary(rings, Axis("x", 0.01, 1.0), Axis("y", -1.0, 1.0), tolerance=1e-6)
    column = found.bands[np.isclose(found.bands["x"], found.bands["x"].unique()[64])]
    x = column["x"].iloc[0]
    radii = (math.pi * (np.arange(4) + 0.5) - 0.3) / (3.0 * math.pi)
    half = np.sqrt(radii[radii > x] ** 2 - x**2)
    half = half[half < 1.0]
    expected = np.sort(np.concatenate([[-1.0, 1.0], half, -half]))
    np.testing.assert_allclose(column["from"], expected[:-1], atol=2e-6)
    np.testing.assert_allclose(column["to"], expected[1:], atol=2e-6)
    middle = rings(x, 0.5 * (column["from"] + column["to"]))
    np.testing.assert_array_equal(column["stable"], middle < 0.0)


def test_a_plane_without_boundary_is_one_band_everywhere():
    found = find_boundary(lambda x, y: -1.0 + 0.0 * x, *PLANE)
    assert found.points.empty
    assert found.bands["stable"].all()
    assert len(found.bands) == 129


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0), st.floats(1.0, 3.0), st.floats(1.0, 3.0))
def test_an_island_that_holds_the_stated_rectangle_is_never_missed(left, below, wide, high):
    """A box whose outside is flat gives no hint: only the guarantee can find it."""
    small = find_boundary(lambda x, y: -np.ones_like(x), *PLANE).smallest_island
    width, height = 1.0001 * wide * small["x"], 1.0001 * high * small["y"]
    x0, y0 = -1.0 + left * (2.0 - width), -1.0 + below * (2.0 - height)

    def box(x, y):
        return np.where((x >= x0) & (x <= x0 + width) & (y >= y0) & (y <= y0 + height), 1.0, -1.0)

    points = find_boundary(box, *PLANE, tolerance=1e-3).points
    assert np.ptp(points["x"]) == pytest.approx(width, abs=0.02)
    assert np.ptp(points["y"]) == pytest.approx(height, abs=0.02)


@pytest.mark.parametrize("centre", [(0.31, -0.22), (-0.71, 0.43), (0.05, 0.06)])
def test_smooth_islands_a_quarter_of_the_guarantee_are_found_by_their_dip(centre):
    def island(x, y):
        return 0.015**2 - (x - centre[0]) ** 2 - (y - centre[1]) ** 2

    found = find_boundary(island, *PLANE)
    assert found.smallest_island == {"x": 0.125, "y": 0.125}
    assert len(found.points) > 4
    assert np.abs(np.hypot(found.points["x"] - centre[0], found.points["y"] - centre[1]) - 0.015).max() < 4e-4


def test_the_boundary_is_the_same_whichever_axis_comes_first():
    one = find_boundary(sinusoids, *LOBES, tolerance=1e-7).points[["speed", "depth"]]
    other = find_boundary(sinusoids, *LOBES[::-1], tolerance=1e-7).points[["speed", "depth"]]
    assert len(one) == len(other)
    assert cKDTree(one).query(other)[0].max() < 3e-7


def test_the_cost_grows_with_the_length_of_the_boundary_not_with_the_area():
    cells = (64, 128, 256, 512)
    cost = [find_boundary(circle, *(Axis(n, -1.0, 1.0, c) for n in "xy")).evaluations for c in cells]
    order = np.polyfit(np.log(cells[1:]), np.log(np.array(cost[1:]) - 17**2), 1)[0]
    assert order < 1.1
    assert cost[2] < 0.05 * 257**2


def test_a_function_of_single_numbers_counts_as_its_array_form():
    calls = []

    def single(x, y):
        calls.append((x, y))
        return float(circle(x, y))

    found = find_boundary(pointwise(single), *PLANE)
    assert len(calls) == len(set(calls)) == found.evaluations
    assert found.points.equals(find_boundary(circle, *PLANE).points)


def test_what_is_no_plane_or_no_function_is_refused():
    with pytest.raises(InputError, match="both axes are called x"):
        find_boundary(circle, PLANE[0], PLANE[0])
    with pytest.raises(InputError, match="tolerance is 0"):
        find_boundary(circle, *PLANE, tolerance=0.0)
    with pytest.raises(InputError, match="a rising range is needed"):
        Axis("x", 1.0, 1.0)
    with pytest.raises(InputError, match="the cells must be a multiple"):
        Axis("x", 0.0, 1.0, 100, 16)
    with pytest.raises(InputError, match=r"not a number at \(-1, -1\)"):
        find_boundary(lambda x, y: x * np.nan, *PLANE)
    with pytest.raises(InputError, match="wrap a function of single numbers"):
        find_boundary(lambda x, y: 1.0, *PLANE)


@pytest.mark.slow
def test_the_reference_island_of_milling_is_found_in_the_plane_and_its_bands_agree(make_case):
    """Immersion 0.5: an unstable band 2.1 to 2.3 mm at 10000 rpm, stable again, unstable from 2.35 mm."""
    case = make_case["benchmark"](1, 0.5)

    def growth(speed, depth):
        return abs(floquet_multipliers(case.machine, *case.cut, 1e-3 * depth, speed)[0]) - 1.0

    speed, depth = Axis("speed", 9600.0, 10400.0, 32, 8), Axis("depth", 1.6, 2.6, 64, 16)
    found = find_boundary(pointwise(growth), speed, depth, tolerance=1e-4)
    at = found.bands[np.isclose(found.bands["speed"], 10000.0)]
    assert at["stable"].tolist() == [True, False, True, False]
    np.testing.assert_allclose(at["to"].iloc[:3], [2.106, 2.312, 2.353], atol=3e-3)
    direct = stability_bands(case.machine, *case.cut, 10000.0, 2.6e-3)
    np.testing.assert_allclose(at["to"].iloc[:3], direct["to_mm"].iloc[:3], atol=2e-4)
    print(f"\n{found.evaluations} evaluations, a plain grid {found.plain_evaluations}")
    assert found.evaluations < 0.4 * found.plain_evaluations


@pytest.mark.slow
def test_a_boundary_over_speed_and_immersion_lies_where_the_limit_depth_says(make_case):
    """At a point of the boundary the limit depth of that immersion and speed is the depth of the cut."""
    cases = make_case["benchmark"]

    def growth(speed, immersion):
        case = cases(1, immersion)
        return abs(floquet_multipliers(case.machine, *case.cut, 1.5e-3, speed)[0]) - 1.0

    axes = Axis("speed", 12000.0, 20000.0, 16, 8), Axis("immersion", 0.1, 0.9, 16, 8)
    points = find_boundary(pointwise(growth), *axes).points
    assert len(points) > 20
    for row in points.iloc[::6].itertuples():
        case = cases(1, row.immersion)
        bands = stability_bands(case.machine, *case.cut, row.speed, 2e-3)
        assert np.abs(bands["to_mm"] - 1.5).min() < 0.01
