"""Methods are ranked by what they predict: counts, exact intervals, and differences that are more than chance."""

import math
from itertools import product

import numpy as np
import pytest

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from smfe.campaign import Campaign, CuttingTest, LobeRequest, Measurement
from smfe.limits.ranking import ALL, method_names, ranked, share_interval, write_ranking
from smfe.reporting.content.ranking import grid, sentences
from smfe.reporting.figures.draw_ranking import draw_ranking

REST, MOVING = dict.fromkeys("xyz", 0.0), {"x": 0.01, "y": 0.0, "z": 0.0}


def measured(name, method="hammer", feed=None, **said):
    return Measurement(name=name, method=method, records=(), channels={}, feed=feed, **said)


def campaign(tmp_path, measurements, tests):
    names = tuple(m.name for m in measurements)
    request = LobeRequest(names, "zero_order", "down", 0.05, 1e-4, np.array([600.0, 900.0]))
    cuts = tuple(
        CuttingTest(tmp_path / f"{i}.csv", {}, speed, 1e-3, "down", 0.05, 1e-4, controller=controller)
        for i, (speed, controller) in enumerate(tests)
    )
    work = CuttingCoefficients(1.9e9, 5e8, 0.0)
    return Campaign(
        tmp_path / "campaign.toml", "ranking", Tool(0.1, 4), work,
        measurements=tuple(measurements), lobes=(request,), cutting_tests=cuts,
    )  # fmt: skip


def row(happened, **predicted):
    return {"verdict": happened, "observed": "", **{f"predicted_{name}": said for name, said in predicted.items()}}


TWO = [measured("idle", feed=REST), measured("moving", feed=MOVING)]


@pytest.mark.parametrize(("right", "of"), [(0, 6), (3, 6), (6, 6), (23, 24), (1, 1)])
def test_beyond_the_ends_of_an_interval_so_few_or_many_right_ones_have_2_5_percent(right, of):
    def at_least(k, p):
        return sum(math.comb(of, i) * p**i * (1.0 - p) ** (of - i) for i in range(k, of + 1))

    low, high = share_interval(right, of)
    assert low == 0.0 if right == 0 else at_least(right, low) == pytest.approx(0.025)
    assert high == 1.0 if right == of else 1.0 - at_least(right + 1, high) == pytest.approx(0.025)


def test_the_p_value_of_a_difference_counts_every_way_in_which_chance_makes_one_as_large(tmp_path):
    # Of nine tests one method alone has seven right, the other alone one, and one both: eight decide.
    outcomes = [("stable", "chatter")] * 7 + [("chatter", "stable"), ("stable", "stable")]
    rows = [row("stable", idle=a, moving=b) for b, a in outcomes]
    found = ranked(campaign(tmp_path, TWO, [(600.0, None)] * 9), rows).differences
    coins = [sum(way) for way in product((0, 1), repeat=8)]
    expected = sum(heads <= 1 or heads >= 7 for heads in coins) / len(coins)
    assert found["p_value"].item() == pytest.approx(expected)
    assert (found["method_a"].item(), found["only_a_right"].item(), found["only_b_right"].item()) == (
        "hammer in motion", 7, 1,
    )  # fmt: skip
    assert not found["significant"].item()


def test_every_outcome_is_counted_once_by_method_controller_and_speed(tmp_path):
    machine = [measured(f"{name}_{k}", feed=feed, controller=k) for k in ("K1", "K2") for name, feed in
               (("idle", REST), ("moving", MOVING))]  # fmt: skip
    tests = [(speed, k) for k in ("K1", "K2") for speed in (600.0, 900.0)]
    rows = [
        row("chatter", idle_K1="stable", moving_K1="chatter", idle_K2="not compared", moving_K2="not compared"),
        row("stable", idle_K1="stable", moving_K1="chatter", idle_K2="not compared", moving_K2="not compared"),
        row("undecided", idle_K1="not compared", moving_K1="not compared", idle_K2="stable", moving_K2="chatter"),
        row("failed", idle_K1="not compared", moving_K1="not compared", idle_K2="stable", moving_K2="failed"),
    ]
    table = ranked(campaign(tmp_path, machine, tests), rows).table
    whole = table[table["controller"] == ALL].set_index("method")
    kinds = ["right", "falsely_stable", "falsely_unstable", "undecided"]
    assert whole.loc["hammer at rest", kinds].tolist() == [1, 1, 0, 2]
    assert whole.loc["hammer in motion", kinds].tolist() == [1, 0, 1, 1]
    assert list(whole.index) == ["hammer in motion", "hammer at rest"]  # as many right, fewer falsely stable
    single = table[table["spindle_speed_rpm"].notna()]
    assert single.groupby("method")["tests"].sum().to_dict() == {"hammer at rest": 4, "hammer in motion": 3}
    assert set(single["controller"]) == {"K1", "K2"}


def test_one_method_under_two_controllers_is_one_and_two_feeds_at_one_cut_are_two(tmp_path):
    faster = {"x": 0.02, "y": 0.0, "z": 0.0}
    sources = [
        measured("a", feed=MOVING, controller="K1"),
        measured("b", feed=MOVING, controller="K2"),
        measured("c", method="actuator", feed=MOVING),
        measured("d", method="actuator", feed=faster),
        measured("e", method="sweep", depth_of_cut=1e-3),
        measured("f", method="sweep", depth_of_cut=2e-3),
        measured("g", method="frf"),
        measured("h", method="frf"),
    ]
    names = {label: name for label, (_, name) in method_names(campaign(tmp_path, sources, [])).items()}
    assert names == {
        "a": "hammer in motion",
        "b": "hammer in motion",
        "c": "actuator in motion at 600 mm/min",
        "d": "actuator in motion at 1200 mm/min",
        "e": "sweep at 1 mm",
        "f": "sweep at 2 mm",
        "g": "frf (g)",
        "h": "frf (h)",
    }


def test_a_test_that_states_no_controller_counts_for_no_method_that_has_two(tmp_path):
    sources = [measured("a", feed=REST, controller="K1"), measured("b", feed=REST, controller="K2")]
    rows = [row("stable", a="stable", b="chatter")]
    assert ranked(campaign(tmp_path, sources, [(600.0, None)]), rows).table.empty


def test_nothing_predicted_leaves_no_file_of_an_earlier_run(tmp_path):
    rows = [row("stable", idle="stable", moving="chatter")]
    one = campaign(tmp_path, TWO, [(600.0, None)])
    write_ranking(tmp_path, ranked(one, rows))
    assert (tmp_path / "ranking.csv").is_file()
    write_ranking(tmp_path, ranked(one, [row("stable")]))
    assert not list(tmp_path.glob("ranking*"))


def test_a_difference_that_eleven_tests_show_is_said_and_one_of_four_is_not(tmp_path):
    def said(count):
        rows = [row("stable", idle="chatter", moving="stable")] * count
        return sentences(ranked(campaign(tmp_path, TWO, [(600.0, None)] * count), rows).differences)

    assert said(11) == [
        "Hammer in motion predicts better than hammer at rest, and not by chance: of 11 tests it alone has 11 right, "
        "the other alone 0 (p below 0.001)."
    ]
    assert "No difference between the methods is more than chance" in said(4)[0]
    assert "At least 6 tests" in said(4)[0]  # 2/2^6 = 0.031 is below 0.05, 2/2^5 = 0.0625 is not


def test_the_picture_has_a_mark_for_every_test(tmp_path):
    rows = [row("stable", idle="chatter", moving="stable")] * 7 + [row("undecided", idle="chatter", moving="stable")]
    found = ranked(campaign(tmp_path, TWO, [(600.0, None)] * 5 + [(900.0, None)] * 3), rows)
    picture = draw_ranking(found.table)
    assert sum(len(line.get_xdata()) == 1 for line in picture.axes[0].lines) == 16
    assert [r.share for r in grid(found.table)] == ["7 of 7 (59 to 100 %)", "0 of 7 (0 to 41 %)"]


def test_a_controller_called_all_is_counted_like_any_other_and_names_keep_their_capitals(tmp_path):
    sources = [
        measured(f"{n}_{k}", feed=f, controller=k) for k in ("all", "K2") for n, f in (("i", REST), ("m", MOVING))
    ]
    rows = [
        row("stable", **{f"i_{k}": "chatter", f"m_{k}": "stable"}) for k in ("all", "K2") for _ in range(8)
    ]  # fmt: skip
    found = ranked(campaign(tmp_path, sources, [(600.0, k) for k in ("all", "K2") for _ in range(8)]), rows)
    whole = found.table[found.table["controller"] == ALL]
    assert whole["tests"].tolist() == [16, 16]
    assert [one.controller for one in grid(found.table)] == ["K2", "all (controller)"] * 2
    assert (found.differences["controller"] == ALL).sum() == 1
    named = found.differences.assign(method_a="FE model K2")
    assert sentences(named)[0].startswith("FE model K2 predicts better than hammer at rest")
