"""Best pockets of a table, and presets for a tool library."""

import json
import math

import numpy as np
import pytest

from process.cut.tool import Tool
from process.errors import InputError
from stability import lobe_table, zero_order
from stability.tables.pockets import POCKET_COLUMNS, SpindleRange, best_pockets
from stability.tables.presets import PRESET_SCHEMA, PresetContext, check_presets, presets, read_presets, write_presets

TOOL = Tool(80e-3, 2, math.pi / 4)
CONTEXT = PresetContext(TOOL, "face mill 80", "C45", "down", 0.95)


@pytest.fixture
def table(authors):
    lobes = zero_order(authors.machine, *authors.cut, np.arange(400.0, 1600.0, 5.0))
    lobes["safe_depth"] = 0.8 * lobes["limit_depth"]
    return lobe_table(lobes, "model", TOOL, 40e-3, 0.2e-3)


def test_the_best_pocket_is_where_the_most_is_removed(table):
    found = best_pockets(table, spindle=SpindleRange(accuracy=0.0))
    assert tuple(found.columns) == POCKET_COLUMNS
    rate = table["safe_depth_mm"] * table["width_of_cut_mm"] * table["feed_mm_min"] / 1e3
    best = found.iloc[0]
    assert best["spindle_speed_rpm"] == table["spindle_speed_rpm"][rate.argmax()]
    assert best["removal_rate_cm3_min"] == pytest.approx(rate.max())
    assert best["depth_gain"] == pytest.approx(best["safe_depth_mm"] / table["safe_depth_mm"].min())
    assert found["removal_rate_cm3_min"].is_monotonic_decreasing
    assert found["rank"].tolist() == list(range(1, len(found) + 1))


def test_a_pocket_is_safe_at_every_speed_that_the_spindle_may_turn(table):
    for accuracy in (0.0, 0.01, 0.05):
        for row in best_pockets(table, spindle=SpindleRange(accuracy=accuracy)).itertuples():
            near = (table["spindle_speed_rpm"] / row.spindle_speed_rpm - 1.0).abs() <= accuracy
            assert row.safe_depth_mm <= table["safe_depth_mm"][near].min()
            held = table["spindle_speed_rpm"].between(row.from_rpm, row.to_rpm)
            assert (table["safe_depth_mm"][held] >= row.safe_depth_mm * (1 - 1e-9)).all()
            assert row.from_rpm <= row.spindle_speed_rpm <= row.to_rpm


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


def test_without_a_safe_depth_the_limit_is_used_and_named(table):
    found = best_pockets(table.assign(safe_depth_mm=np.nan), 1, SpindleRange(accuracy=0.0))
    assert found["basis"].tolist() == ["limit_depth"]
    assert found["safe_depth_mm"][0] == found["limit_depth_mm"][0]


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


def test_presets_hold_what_the_pockets_say_and_come_back(table, tmp_path):
    pockets = best_pockets(table, 2)
    document = presets(pockets, CONTEXT)
    assert read_presets(write_presets(document, tmp_path / "presets.json")) == document
    for preset, row in zip(document["presets"], pockets.itertuples(), strict=True):
        assert preset["spindle_speed_rpm"] == row.spindle_speed_rpm
        assert row.safe_depth_mm - 1e-3 <= preset["depth_of_cut_mm"] <= row.safe_depth_mm
        feed = preset["feed_per_tooth_mm"] * preset["tool"]["teeth"] * preset["spindle_speed_rpm"]
        assert preset["feed_mm_min"] == pytest.approx(feed)
        assert preset["safe_probability"] == 0.95
        assert preset["source"] == "model"


def test_presets_have_the_published_form(table):
    jsonschema = pytest.importorskip("jsonschema")
    tool = Tool(80e-3, 2, math.pi / 4, pitch_angles=(math.radians(170.0), math.radians(190.0)))
    document = presets(best_pockets(table), PresetContext(tool, "mill", "C45", "up", 0.9))
    jsonschema.Draft202012Validator.check_schema(PRESET_SCHEMA)
    jsonschema.validate(json.loads(json.dumps(document)), PRESET_SCHEMA)
    assert document["presets"][0]["tool"]["pitch_angles_deg"] == [170.0, 190.0]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda p: p.pop("material"), "the file.presets.0. has no 'material'"),
        (lambda p: p.update(colour="red"), "has 'colour', which is not known"),
        (lambda p: p.update(spindle_speed_rpm="1000"), "spindle_speed_rpm is '1000'; number is needed"),
        (lambda p: p.update(depth_of_cut_mm=0), "depth_of_cut_mm is 0; it must be above 0"),
        (lambda p: p.update(cut="side"), "cut is 'side'; it must be one of down, up, central"),
        (lambda p: p.update(safe_probability=1.0), "safe_probability is 1; it must be above 0 and below 1"),
        (lambda p: p["tool"].update(teeth=0), "tool.teeth is 0"),
        (lambda p: p.update(source=""), "source is empty"),
    ],
)
def test_presets_of_another_form_are_refused_as_the_schema_does(table, change, sentence):
    document = presets(best_pockets(table), CONTEXT)
    change(document["presets"][0])
    with pytest.raises(InputError, match=sentence):
        check_presets(document)
    jsonschema = pytest.importorskip("jsonschema")
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(document, PRESET_SCHEMA)


def test_what_makes_no_pocket_or_preset_is_refused(table, tmp_path):
    with pytest.raises(InputError, match="0 pockets"):
        best_pockets(table, 0)
    for bad in ({"minimum": 5.0, "maximum": 4.0}, {"step": 0.0}, {"accuracy": 1.0}):
        with pytest.raises(InputError, match="spindle"):
            SpindleRange(**bad)
    with pytest.raises(InputError, match="with which probability is not said"):
        presets(best_pockets(table), PresetContext(TOOL, "mill", "C45", "down"))
    with pytest.raises(InputError, match="the material has no name"):
        presets(best_pockets(table), PresetContext(TOOL, "mill", " ", "down"))
    with pytest.raises(InputError, match="there is no file"):
        read_presets(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(InputError, match="is not JSON"):
        read_presets(tmp_path / "bad.json")
