"""The recommendation: which source, which speed, which depth, and the same in every file."""

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import smfe
from process.cut.force import mean_torque
from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.limits.campaign_lobes import all_lobes
from smfe.limits.lobe_files import write_lobes
from smfe.limits.recommendation import recommend
from smfe.progress import silent

KNOWN = "uncertainty = { frequency = 0, damping = 0, stiffness = 0 }"
"""A machine that is known exactly: what the coefficients make of the limit is had in closed form, without sampling."""

TEXT = """
[campaign]
name = "limits"
[tool]
diameter = "16 mm"
teeth = 2
{tool}
[material]
name = "aluminium"
Ktc = "600 N/mm^2"
Krc = "200 N/mm^2"
Kac = "0 N/mm^2"
{machine}
[spindle]
minimum = "4000 rpm"
step = "100 rpm"
{spindle}
[[model]]
name = "classic"
modes = [{{ frequency = "922 Hz", damping = 0.011, stiffness = "1.34e6 N/m", direction = [1, 0, 0] }}]
{model}
[[lobes]]
measurements = ["classic"]
method = "zero_order"
cut = "down"
width_of_cut = "8 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = {speed}
{lobes}
"""


def campaign(folder, **parts):
    given = {"tool": "", "machine": "", "spindle": "", "model": KNOWN, "lobes": 'maximum_depth = "20 mm"'}
    given |= {"speed": '["4000 rpm", "16000 rpm", "50 rpm"]', **parts}
    (folder / "campaign.toml").write_text(TEXT.format(**given))
    return load_campaign(folder / "campaign.toml")


def results_of(loaded):
    return all_lobes(loaded, {m.name: m.modal.compliance(np.arange(200.0, 2500.0, 1.0)) for m in loaded.models}, silent)


def answer(folder, **parts):
    loaded = campaign(folder, **parts)
    return recommend(results_of(loaded), loaded).best


def test_every_file_says_the_same(tmp_path):
    loaded = campaign(tmp_path)
    write_lobes(tmp_path, results_of(loaded), loaded)
    found = smfe.recommendation(tmp_path)
    pockets, presets = pd.read_csv(tmp_path / "pockets.csv"), json.loads((tmp_path / "presets.json").read_text())
    first = pockets.iloc[0]
    assert pockets["recommended"].tolist() == [True] + [False] * (len(pockets) - 1)
    assert presets["recommendation"] == found.as_dict() == presets["recommendations"][0]
    for name in ("spindle_speed_rpm", "depth_of_cut_mm", "width_of_cut_mm", "feed_mm_min", "lobes", "source", "cut"):
        assert presets["presets"][0][name] == first[name] == getattr(found, name)
    assert found.removal_rate_cm3_min == pytest.approx(first["removal_rate_cm3_min"], rel=1e-5)


def test_the_numbers_belong_together(tmp_path):
    found = answer(tmp_path)
    assert found.status == "recommended"
    assert found.depth_of_cut_mm == pytest.approx(round(10 * found.depth_of_cut_mm) / 10, abs=1e-12)
    assert found.depth_of_cut_mm <= found.limit_depth_p05_mm < found.limit_depth_mm < found.limit_depth_p95_mm
    assert found.feed_mm_min == pytest.approx(0.1 * 2 * found.spindle_speed_rpm)
    assert found.cutting_speed_m_min == pytest.approx(math.pi * 0.016 * found.spindle_speed_rpm, rel=1e-5)
    assert found.removal_rate_cm3_min == pytest.approx(found.depth_of_cut_mm * 8.0 * found.feed_mm_min / 1e3, rel=1e-5)
    assert found.speed_from_rpm <= found.spindle_speed_rpm <= found.speed_to_rpm
    assert found.spindle_speed_rpm % 100.0 == 0.0


def test_a_limit_of_unknown_uncertainty_is_no_depth_in_any_file(tmp_path):
    loaded = campaign(tmp_path, model="")
    write_lobes(tmp_path, results_of(loaded), loaded)
    found = smfe.recommendation(tmp_path)
    assert found.status == "limit_only"
    assert found.depth_of_cut_mm is found.removal_rate_cm3_min is found.probability is None
    assert found.limit_depth_mm > 0.0
    assert "whose uncertainty is not stated" in found.reason
    assert json.loads((tmp_path / "presets.json").read_text())["presets"] == []
    for file, names in {
        "pockets.csv": ["depth_of_cut_mm", "safe_depth_mm"],
        "lobe_table.csv": ["safe_depth_mm"],
    }.items():
        assert pd.read_csv(tmp_path / file)[names].isna().all(axis=None)


@pytest.mark.parametrize(
    ("parts", "depth", "what"),
    [
        ({"lobes": 'maximum_depth = "1.55 mm"'}, 1.5, "the greatest depth that is asked for"),
        ({"tool": 'edge_length = "2 mm"\napproach_angle = "30 deg"'}, 1.0, "the length of the cutting edges"),
    ],
)
def test_what_else_limits_the_depth_is_kept_and_named(tmp_path, parts, depth, what):
    found = answer(tmp_path, **parts)
    assert found.depth_of_cut_mm == depth
    assert f"limited by {what}" in found.reason


def test_power_and_torque_at_the_recommended_cut_are_what_the_spindle_has(tmp_path):
    loaded = campaign(tmp_path)
    request = loaded.lobes[0]
    from process.cut.engagement import engagement
    from smfe.planning.forces import force_level

    arc = engagement("down", 8e-3, 16e-3)
    torque = mean_torque(loaded.tool, arc, loaded.coefficients, request.feed_per_tooth)
    # A second way: the forces of `smfe plan`, summed over the turn.
    second = force_level(loaded.tool, arc, loaded.coefficients, 1.0, request.feed_per_tooth).torque
    assert torque == pytest.approx(second, rel=5e-3)
    for spindle in ('torque = "0.1 N m"', 'power = "0.1 kW"'):
        found = answer(tmp_path, spindle=spindle)
        used = 1e-3 * found.depth_of_cut_mm * torque
        allowed = 0.1 if "torque" in spindle else 100.0 / (found.spindle_speed_rpm * math.pi / 30.0)
        assert used <= allowed < used + 1e-4 * torque
        assert f"limited by the {spindle.split()[0]} of the spindle" in found.reason


def test_a_machine_that_feeds_too_slowly_turns_slower_or_not_at_all(tmp_path):
    machine = '[machine]\nname = "ram"\nmaximum_feed = "{} mm/min"'
    found = answer(tmp_path, machine=machine.format(2000))
    assert found.feed_mm_min <= 2000.0
    assert found.machine == "ram"
    found = answer(tmp_path, machine=machine.format(500))
    assert (found.status, found.spindle_speed_rpm) == ("none", None)
    assert "slow enough for the feed of the machine" in found.reason


def test_an_end_of_the_range_is_recommended_only_where_there_is_nothing_else_and_said(tmp_path):
    flank = answer(tmp_path, speed='["11000 rpm", "13000 rpm", "50 rpm"]')
    assert "is an end of the range that can be set" in flank.reason
    whole = answer(tmp_path)
    assert "end of the range" not in whole.reason


def test_where_nothing_chatters_the_edges_decide_and_without_them_nothing_does(tmp_path):
    loaded, bounded = campaign(tmp_path, lobes=""), campaign(tmp_path, tool='edge_length = "6 mm"', lobes="")
    for given, expected in ((loaded, ("none", None)), (bounded, ("recommended", 6.0))):
        result = results_of(given)[0]
        depths = ["limit_depth_mm", "limit_depth_p05_mm", "limit_depth_p95_mm", "safe_depth_mm"]
        free = replace(result, table=result.table.assign(**dict.fromkeys(depths, math.inf)))
        found = recommend([free], given).best
        assert (found.status, found.depth_of_cut_mm) == expected
        assert found.limit_depth_mm is None
        assert ("No limit was found at any speed" in found.reason) == (given is loaded)


# --- which source ----------------------------------------------------------------------------------------------------


def stand_in(result, source, kind="hammer", in_motion=False, factor=1.0, band=True):
    """Return lobes of another source: those of the model, times a factor."""
    depths = ["limit_depth_mm", "limit_depth_p05_mm", "limit_depth_p95_mm", "safe_depth_mm"]
    table = result.table.assign(source=source, **{n: factor * result.table[n] for n in depths})
    if not band:
        table[depths[1:]] = math.nan
    return type(result)(result.request, source, result.lobes, table, result.asked, kind, in_motion)


@pytest.fixture(scope="module")
def classic(tmp_path_factory):
    loaded = campaign(tmp_path_factory.mktemp("classic"))
    return loaded, results_of(loaded)[0]


def cutting_test(result, depth, verdict, **limits):
    row = {"spindle_speed_rpm": 10000.0, "depth_of_cut_mm": depth, "verdict": verdict, "observed": ""}
    for source, limit in limits.items():
        row |= {f"limit_{source}_mm": limit, f"predicted_{source}": "chatter" if depth > limit else "stable"}
    return row


def chosen(classic, *stand_ins, tests=()):
    loaded, model = classic
    results = [model, *(stand_in(model, *s) if isinstance(s, tuple) else stand_in(model, **s) for s in stand_ins)]
    return recommend(results, loaded, tests).best


def test_a_measurement_comes_before_a_model_and_motion_before_rest(classic):
    assert chosen(classic).source == "classic"
    assert "a model: no measurement" in chosen(classic).reason
    assert chosen(classic, ("idle",)).source == "idle"
    assert chosen(classic, ("idle",), ("moving", "sweep", True)).source == "moving"
    # While cutting is nearer to the cut than a moved axis that is hit.
    for order in ([("hit", "hammer", True), ("cut", "sweep", True)], [("cut", "sweep", True), ("hit", "hammer", True)]):
        assert chosen(classic, *order).source == "cut"
    assert "From cut, measured while cutting" in chosen(classic, ("cut", "sweep", True)).reason
    assert "From hit, measured in motion" in chosen(classic, ("hit", "hammer", True)).reason
    known, unknown = {"source": "known"}, {"source": "unknown", "band": False}
    assert chosen(classic, unknown, known).source == "known"


def test_the_cutting_tests_decide_before_motion_does(classic):
    tests = [cutting_test(classic[1], 2.0, "chatter", idle=1.5, moving=2.5)]
    found = chosen(classic, ("idle",), ("moving", "sweep", True), tests=tests)
    assert found.source == "idle"
    assert "it predicts 1 of 1 cutting test rightly" in found.reason
    assert "moving is set aside: 1 cut that it calls stable chattered" in found.reason


def test_what_chattered_at_a_safe_depth_is_no_longer_called_safe(classic):
    tests = [cutting_test(classic[1], 1.0, "chatter", idle=2.5)]
    found = chosen(classic, ("idle",), tests=tests)
    assert (found.source, found.status, found.depth_of_cut_mm) == ("idle", "limit_only", None)
    assert "chattered at a depth that it calls safe" in found.reason
    # Within the band, chatter below the limit refutes nothing.
    near = [cutting_test(classic[1], 2.49, "chatter", idle=2.5)]
    assert chosen(classic, ("idle",), tests=near).status == "recommended"


def test_sources_that_disagree_beyond_their_uncertainty_are_named(classic):
    found = chosen(classic, ("idle", "hammer", False, 2.0), ("moving", "sweep", True))
    assert "differ at this speed by more than the uncertainties explain: idle 100 % higher." in found.reason
    assert "idle" not in chosen(classic, ("idle", "hammer", False, 1.03), ("moving", "sweep", True)).reason


def test_limits_are_compared_where_the_recommended_one_is_read(classic):
    """Within the accuracy of the spindle: what differs at one speed in the middle of it changes no lowest limit."""
    loaded, model = classic
    best = chosen(classic, ("idle",)).spindle_speed_rpm
    moved = stand_in(model, "moving", "sweep", True)
    at = int(np.abs(moved.table["spindle_speed_rpm"].to_numpy(float) - best).argmin())
    columns = ["limit_depth_mm", "limit_depth_p05_mm", "limit_depth_p95_mm", "safe_depth_mm"]
    table = moved.table.copy()
    table.loc[table.index[at], columns] *= 3.0
    found = recommend([stand_in(model, "idle"), replace(moved, table=table)], loaded).best
    assert "differ at this speed" not in found.reason


def test_what_the_tests_set_aside_is_named_once(classic):
    tests = [cutting_test(classic[1], 2.0, "chatter", idle_x=2.5, hit=2.6, moving=1.5)]
    found = chosen(classic, ("idle_x",), ("hit",), ("moving", "sweep", True, 0.5), tests=tests)
    assert found.source == "moving"
    assert "idle x and hit are set aside: 1 and 1 cuts that they call stable chattered" in found.reason
    assert found.reason.count("idle") == found.reason.count("hit") == 1


def test_the_best_of_all_requests_removes_most(classic):
    loaded, model = classic
    other = stand_in(model, "classic", "model", factor=0.5)
    other = type(other)("lobes_2", *(getattr(other, n) for n in ("source", "lobes", "table", "asked", "kind")))
    for order in ([other, model], [model, other]):
        found = recommend(order, loaded)
        assert found.best.lobes == "lobes_1"
        assert [r.lobes for r in found.each] == [r.request for r in order]
        assert found.pockets["lobes"][0] == "lobes_1"


# --- speeds and widths -----------------------------------------------------------------------------------------------


def test_single_speeds_are_candidates_with_the_depth_about_them(tmp_path):
    speeds = [7000.0, 9300.0, 13900.0]
    shop = campaign(tmp_path, speed='{ speeds = ["13900 rpm", "7000 rpm", "9300 rpm"] }')
    (result,) = results_of(shop)
    assert result.table["spindle_speed_rpm"].tolist() == speeds == result.lobes["spindle_speed"].values.tolist()
    found = recommend([result], shop)
    assert set(found.pockets["spindle_speed_rpm"]) == set(speeds)
    assert not found.pockets["at_edge"].any()
    # As a fine table has it: the smallest depth within 1 % of the speed.
    fine = campaign(tmp_path, speed='["6500 rpm", "14500 rpm", "10 rpm"]')
    table = results_of(fine)[0].table.set_index("spindle_speed_rpm")["limit_depth_mm"]
    for row in found.pockets.itertuples():
        near = table[np.abs(table.index / row.spindle_speed_rpm - 1.0) <= 0.01]
        assert row.limit_depth_mm == pytest.approx(near.min(), rel=0.01)
        assert row.spindle_speed_rpm * 0.98 < row.speed_from_rpm <= row.speed_to_rpm < row.spindle_speed_rpm * 1.02
    one = answer(tmp_path, speed='"13900 rpm"')
    assert one.spindle_speed_rpm == 13900.0
    assert one.depth_of_cut_mm == found.best.depth_of_cut_mm


def test_several_widths_are_requests_of_their_own_with_a_table_over_both(tmp_path):
    loaded = campaign(tmp_path, lobes='maximum_depth = "6 mm"')
    text = (tmp_path / "campaign.toml").read_text().replace('"8 mm"', '["8 mm", "4 mm", "1.6 mm"]')
    (tmp_path / "campaign.toml").write_text(text)
    single, loaded = loaded, load_campaign(tmp_path / "campaign.toml")
    results = results_of(loaded)
    write_lobes(tmp_path, results, loaded)
    names = ["lobes_1_1.6mm", "lobes_1_4mm", "lobes_1_8mm"]
    assert [r.request for r in results] == names
    presets = json.loads((tmp_path / "presets.json").read_text())
    assert [r["lobes"] for r in presets["recommendations"]] == names
    best = presets["recommendation"]
    assert best["removal_rate_cm3_min"] == max(r["removal_rate_cm3_min"] for r in presets["recommendations"])
    # The same as that width alone.
    alone = recommend(results_of(single), single).best.as_dict()
    eight = presets["recommendations"][2]
    assert {k: v for k, v in eight.items() if k != "lobes"} == {k: v for k, v in alone.items() if k != "lobes"}
    depths = pd.read_csv(tmp_path / "depth_table.csv")
    assert list(depths)[4:] == [
        *(f"depth_{w}mm_mm" for w in ("1.6", "4", "8")),
        "best_width_of_cut_mm",
        "removal_rate_cm3_min",
    ]
    for answer_of_width, column in zip(presets["recommendations"], list(depths)[4:7], strict=True):
        row = depths[depths["spindle_speed_rpm"] == answer_of_width["spindle_speed_rpm"]].iloc[0]
        assert row[column] == answer_of_width["depth_of_cut_mm"]
    row = depths.iloc[len(depths) // 2]
    rates = {w: w * row[f"depth_{w:g}mm_mm"] * row["feed_mm_min"] / 1e3 for w in (1.6, 4.0, 8.0)}
    assert row["removal_rate_cm3_min"] == pytest.approx(max(rates.values()))
    assert rates[row["best_width_of_cut_mm"]] == pytest.approx(max(rates.values()))
    table = pd.read_csv(tmp_path / "lobe_table.csv")
    assert set(table["lobes"]) == set(names)
    assert (table[["kind", "method", "cut"]].drop_duplicates().to_numpy() == [["model", "zero_order", "down"]]).all()
    # A second run for one width leaves no table of another.
    write_lobes(tmp_path, results_of(single), single)
    assert not (tmp_path / "depth_table.csv").exists()


def test_folders_without_a_recommendation(tmp_path):
    assert smfe.recommendation(tmp_path) is None
    with pytest.raises(InputError, match="there is no folder"):
        smfe.recommendation(tmp_path / "none")
