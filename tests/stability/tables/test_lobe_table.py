"""Lobe tables: columns, units, infinities, atomic writing."""

import numpy as np
import pandas as pd
import pytest

from process.cut.tool import Tool
from process.errors import InputError
from process.labels import label
from stability import LOBE_COLUMNS, lobe_table, read_table, write_table, zero_order
from stability.tables.lobe_table import Origin

COLUMNS = (  # what CAM reads, in this order
    "lobes,source,kind,method,cut,spindle_speed_rpm,limit_depth_mm,limit_depth_p05_mm,limit_depth_p95_mm,safe_depth_mm,"
    "width_of_cut_mm,feed_per_tooth_mm,feed_mm_min,chatter_frequency_Hz,lobe,removal_rate_cm3_min,"
    "lower_limit_depth_mm,kick_Ns"
)


@pytest.fixture
def lobes(lab_slot):
    # 800 rpm has a limit within these data, 1800 rpm has none
    return zero_order(lab_slot.compliance(20, 64, 0.25), *lab_slot.cut, [1000, 1200, 1800])


@pytest.fixture
def table(lobes):
    origin = Origin("hammer_idle", "lobes_1", "hammer", "zero_order", "down")
    return lobe_table(lobes, origin, Tool(50.8e-3, 4), 50.8e-3, 0.2e-3)


def test_columns_are_those_of_the_design(table):
    assert ",".join(table.columns) == COLUMNS
    assert tuple(table.columns) == LOBE_COLUMNS


def test_removal_rate_is_depth_times_width_times_feed(table):
    row = table.iloc[1]
    assert row["limit_depth_mm"] == pytest.approx(0.1168, abs=1e-4)
    assert row["feed_mm_min"] == pytest.approx(0.2 * 4 * 1200)
    assert row["removal_rate_cm3_min"] == pytest.approx(row["limit_depth_mm"] * 50.8 * 960 / 1000)


def test_quantiles_that_are_not_known_stay_empty_and_no_margin_is_invented(table):
    assert table[["limit_depth_p05_mm", "limit_depth_p95_mm", "safe_depth_mm"]].isna().all(axis=None)


def test_the_safe_depth_is_the_five_percent_quantile(lobes):
    depth = lobes["limit_depth"].values
    lobes["limit_depth_quantile"] = (("quantile", "spindle_speed"), np.stack([0.8 * depth, depth, 1.3 * depth]))
    lobes = label(lobes.assign_coords(quantile=[0.05, 0.5, 0.95]))
    table = lobe_table(lobes, "a", Tool(50.8e-3, 4), 50.8e-3, 0.2e-3)
    np.testing.assert_allclose(table["safe_depth_mm"], 0.8 * depth)
    np.testing.assert_allclose(table["limit_depth_p95_mm"], 1.3 * depth)


def test_a_safe_depth_of_another_probability_goes_into_the_table_as_it_is(lobes):
    lobes["safe_depth"] = 0.7 * lobes["limit_depth"]
    table = lobe_table(lobes, "a", Tool(50.8e-3, 4), 50.8e-3, 0.2e-3)
    np.testing.assert_allclose(table["safe_depth_mm"], 0.7 * table["limit_depth_mm"])


def test_no_limit_is_an_empty_field_and_comes_back_as_infinity(table, tmp_path):
    path = write_table(table, tmp_path / "lobe_table.csv")
    last = path.read_text().splitlines()[3]
    assert last == "lobes_1,hammer_idle,hammer,zero_order,down,1800,,,,,50.8,0.2,1440,,,,,"
    back = read_table(path)
    assert np.isinf(back["limit_depth_mm"].iloc[2])
    assert back["lobe"].isna().tolist() == [False, False, True]
    pd.testing.assert_frame_equal(back, table, check_dtype=False, rtol=1e-8)


def test_a_table_is_replaced_whole_or_not_at_all(table, tmp_path, monkeypatch):
    path = tmp_path / "lobe_table.csv"
    path.write_text("old")

    def fail(*_):
        raise OSError("disk full")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_table(table, path)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["lobe_table.csv"]


def test_the_folder_of_a_table_is_made(table, tmp_path):
    path = write_table(table, tmp_path / "new" / "folder" / "t.csv")
    assert len(read_table(path)) == len(table)


def test_what_makes_no_table_is_refused(lobes, tmp_path):
    tool = Tool(50.8e-3, 4)
    with pytest.raises(InputError, match="no variable 'lobe'"):
        lobe_table(lobes.drop_vars("lobe"), "a", tool, 0.05, 2e-4)
    with pytest.raises(InputError, match="dimension 'feed'"):
        lobe_table(lobes.expand_dims(feed=[1, 2]), "a", tool, 0.05, 2e-4)
    with pytest.raises(InputError, match="feed per tooth is 0 mm"):
        lobe_table(lobes, "a", tool, 0.05, 0.0)
    with pytest.raises(InputError, match="1 limit depths are NaN"):
        lobe_table(lobes.assign(limit_depth=lobes.limit_depth.where(lobes.spindle_speed > 1000)), "a", tool, 0.05, 2e-4)
    with pytest.raises(InputError, match="no file"):
        read_table(tmp_path / "t.csv")
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(InputError, match="not a lobe table: no column lobes"):
        read_table(tmp_path / "other.csv")
