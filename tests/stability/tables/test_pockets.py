"""Best pockets of a table."""

import math

import numpy as np
import pytest

from process.cut.tool import Tool
from process.errors import InputError
from stability import lobe_table, zero_order
from stability.tables.pockets import POCKET_COLUMNS, SpindleRange, best_pockets, rounded_down

TOOL = Tool(80e-3, 2, math.pi / 4)


@pytest.fixture
def table(authors):
    lobes = zero_order(authors.machine, *authors.cut, np.arange(400.0, 1600.0, 5.0))
    lobes["safe_depth"] = 0.8 * lobes["limit_depth"]
    return lobe_table(lobes, "model", TOOL, 40e-3, 0.2e-3)


def test_the_best_pocket_is_where_the_most_is_removed(table):
    found = best_pockets(table, spindle=SpindleRange(accuracy=0.0))
    assert tuple(found.columns) == POCKET_COLUMNS
    rate = table["safe_depth_mm"] * table["width_of_cut_mm"] * table["feed_mm_min"] / 1e3
    inside = found[~found["at_edge"]]
    best, flank = found.iloc[0], table["spindle_speed_rpm"] > 1200.0
    # The largest removal rate of all lies on a flank that ends with the range.
    assert rate.argmax() == len(table) - 1
    assert best["spindle_speed_rpm"] == table["spindle_speed_rpm"][rate[~flank].idxmax()]
    assert best["removal_rate_cm3_min"] == pytest.approx(
        best["depth_of_cut_mm"] * best["width_of_cut_mm"] * best["feed_mm_min"] / 1e3
    )
    assert best["depth_gain"] == pytest.approx(best["safe_depth_mm"] / table["safe_depth_mm"].min())
    assert inside["removal_rate_cm3_min"].is_monotonic_decreasing
    assert found["rank"].tolist() == list(range(1, len(found) + 1))


def test_a_pocket_is_safe_at_every_speed_that_the_spindle_may_turn(table):
    for accuracy in (0.0, 0.01, 0.05):
        for row in best_pockets(table, spindle=SpindleRange(accuracy=accuracy)).itertuples():
            near = (table["spindle_speed_rpm"] / row.spindle_speed_rpm - 1.0).abs() <= accuracy
            assert row.safe_depth_mm <= table["safe_depth_mm"][near].min()
            held = table["spindle_speed_rpm"].between(row.speed_from_rpm, row.speed_to_rpm)
            assert (table["safe_depth_mm"][held] >= row.depth_of_cut_mm * (1 - 1e-9)).all()
            assert row.speed_from_rpm <= row.spindle_speed_rpm <= row.speed_to_rpm


def test_limits_and_steps_of_the_spindle_are_honoured(table):
    found = best_pockets(table, 5, SpindleRange(500.0, 1100.0, 30.0))
    assert found["spindle_speed_rpm"].between(500.0, 1100.0).all()
    np.testing.assert_allclose(found["spindle_speed_rpm"] % 30.0, 0.0, atol=1e-9)
    # Between two rows of the table the lower depth counts.
    odd = best_pockets(table, 5, SpindleRange(step=7.0, accuracy=0.0))
    for row in odd.itertuples():
        beside = (table["spindle_speed_rpm"] - row.spindle_speed_rpm).abs() < 5.0
        assert row.safe_depth_mm == table["safe_depth_mm"][beside].min()
    assert best_pockets(table, 5, SpindleRange(5000.0, 6000.0)).empty


def test_ripple_makes_no_pocket(table):
    """A ripple of 2 % on the depth leaves the pockets what they are."""
    rough = table.copy()
    rough["safe_depth_mm"] *= 1.0 + 0.02 * (-1.0) ** np.arange(len(table))
    one, other = (best_pockets(t, 9, SpindleRange(accuracy=0.0)) for t in (table, rough))
    assert len(one) == len(other)
    np.testing.assert_allclose(one["spindle_speed_rpm"], other["spindle_speed_rpm"], atol=10.0)


def test_without_a_safe_depth_the_pocket_is_that_of_the_limit_and_no_depth_is_given(table):
    found = best_pockets(table.assign(safe_depth_mm=np.nan), 1, SpindleRange(accuracy=0.0))
    assert found["basis"].tolist() == ["limit_depth"]
    assert found["limit_depth_mm"][0] > 0.0
    assert found[["depth_of_cut_mm", "safe_depth_mm", "removal_rate_cm3_min"]].isna().all(axis=None)


def test_an_end_of_the_range_never_ranks_above_a_pocket_inside(table):
    for top in (1000.0, 1200.0, 1400.0, 1595.0):
        found = best_pockets(table[table["spindle_speed_rpm"] <= top], 9)
        assert found["at_edge"].is_monotonic_increasing
        assert not found["at_edge"][0]
    # Rising to the end, with no pocket inside: then the end is all there is, and named.
    flank = table[table["spindle_speed_rpm"].between(1300.0, 1595.0)]
    assert best_pockets(flank)["at_edge"].tolist() == [True]


def test_depths_are_rounded_down_and_whole_tenths_stay(table):
    np.testing.assert_array_equal(
        rounded_down(np.array([15.751, 0.09, 0.3, 20.0, 1.2 - 1e-12])), [15.7, 0, 0.3, 20, 1.2]
    )
    for row in best_pockets(table).itertuples():
        assert 0.0 <= row.safe_depth_mm - row.depth_of_cut_mm < 0.1
        assert row.removal_rate_cm3_min == pytest.approx(
            row.depth_of_cut_mm * row.width_of_cut_mm * row.feed_mm_min / 1e3
        )


def test_each_of_the_speeds_of_a_shop_is_a_candidate_and_none_an_edge(table):
    shop = np.array([500.0, 700.0, 850.0, 1500.0])
    found = best_pockets(table, 9, SpindleRange(accuracy=0.0, maximum=1450.0), speeds=shop)
    assert set(found["spindle_speed_rpm"]) == {500.0, 700.0, 850.0}
    assert not found["at_edge"].any()
    assert found["removal_rate_cm3_min"].is_monotonic_decreasing


def test_a_ceiling_that_falls_with_the_speed_is_kept_everywhere(table):
    power = 3.0  # [m rpm]
    for row in best_pockets(table, 5, maximum_depth=lambda n: power / n).itertuples():
        assert row.depth_of_cut_mm <= 1e3 * power / row.spindle_speed_rpm


def test_a_speed_without_limit_needs_a_greatest_depth(table):
    table.loc[210:220, ["limit_depth_mm", "safe_depth_mm"]] = np.inf
    with pytest.raises(InputError, match="11 speeds without a limit; give a maximum_depth"):
        best_pockets(table)
    found = best_pockets(table, 1, maximum_depth=20e-3)
    assert found["safe_depth_mm"][0] == pytest.approx(20.0)


def test_each_source_has_its_own_pockets(table):
    from pandas import concat

    both = concat([table, table.assign(source="other", safe_depth_mm=2 * table["safe_depth_mm"])])
    found = best_pockets(both, 2)
    assert found["source"].tolist() == ["model", "model", "other", "other"]
    np.testing.assert_allclose(found["safe_depth_mm"][2:].to_numpy(), 2 * found["safe_depth_mm"][:2].to_numpy())


def test_what_makes_no_pocket_is_refused(table):
    with pytest.raises(InputError, match="0 pockets"):
        best_pockets(table, 0)
    for bad in ({"minimum": 5.0, "maximum": 4.0}, {"step": 0.0}, {"accuracy": 1.0}):
        with pytest.raises(InputError, match="spindle"):
            SpindleRange(**bad)
