"""Claims: the report holds what a finding says, marks what was held out, and survives what is not there."""

import base64
import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import xarray as xr

from smfe.diagnosis.judgement.finding import BaselineParameter, Finding, GivenParameter, Remainder, StableDepth
from smfe.diagnosis.story.sentences import explain, told
from smfe.reporting import write_report
from smfe.reporting.content.results import Results
from smfe.reporting.figures.draw_diagnosis import draw_depths, draw_search
from smfe.reporting.figures.figure_data import MOST_CONDITIONS, has_diagnosis
from smfe.reporting.sections.diagnosis import section
from smfe.reporting.sections.draft import Draft


def finding(count: int = 4, **more: Any) -> dict[str, Any]:
    step: dict[str, Any] = {
        "change": "+ runout",
        "words": "with run-out",
        "ratio": 900.0,
        "threshold": 12.0,
        "gain_db": 3.0,
        "gain_sd_db": 0.2,
        "reason": "",
    }
    return {
        "verdict": "named",
        "story": ["It is the run-out."],
        "misfit_db": {"before": 12.5, "refitted": 9.5, "after": 0.5},
        "ladder": [{**step, "misfit_db": 0.5, "accepted": True}, {**step, "misfit_db": 0.4, "accepted": False}],
        "causes": [{"title": "run-out", "parameters": []}],
        "conditions": [
            {"name": f"cut {k}", "before_db": float(k), "after_db": 0.1 * k, "held_out": k == 1} for k in range(count)
        ],
        **more,
    }


def shown(content: dict[str, Any], curves: xr.Dataset | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
    plots: dict[str, Any] = {}
    results = cast(Results, SimpleNamespace(finding=content, curves=curves))
    return section(Draft(results, {}, plots)), plots


def test_the_ladder_goes_from_the_simulation_to_the_extended_model() -> None:
    ladder = shown(finding())[0]["ladder"]
    assert [row.cells for row in ladder.rows] == [
        ("simulation as declared", "12.5", ""),
        ("simulation, refitted", "9.5", ""),
        ("with run-out", "0.5", "3.0"),
    ]


def test_what_no_fit_has_seen_is_marked_and_every_condition_is_there_twice() -> None:
    traces = shown(finding())[1]["plot-conditions"]["data"]
    assert sum(len(t["x"]) for t in traces) == 8
    for trace in traces:
        assert ("cut 1" in trace["y"]) == ("set aside" in trace["name"]) == trace["marker"]["symbol"].endswith("-open")


def test_of_many_conditions_those_with_most_left_are_shown_in_their_order() -> None:
    """What carries the remainder is in the picture, however well the baseline did there."""
    content = finding(MOST_CONDITIONS + 10)
    for k, condition in enumerate(content["conditions"]):
        condition["before_db"] = float(-k)
    layout = shown(content)[1]["plot-conditions"]["layout"]
    assert layout["yaxis"]["categoryarray"] == [f"cut {k}" for k in range(10, MOST_CONDITIONS + 10)]
    assert f"the {MOST_CONDITIONS} of {MOST_CONDITIONS + 10} with most left" in layout["xaxis"]["title"]["text"]


def test_where_something_is_wrong_but_has_no_name_the_conditions_are_shown_with_the_baseline_alone() -> None:
    content = finding(verdict="unknown", causes=[], ladder=[])
    plots = shown(content)[1]
    assert set(plots) == {"plot-conditions"}
    assert {t["name"] for t in plots["plot-conditions"]["data"]} == {
        "simulation as declared",
        "simulation as declared, set aside",
    }
    assert has_diagnosis(content)
    assert len(draw_search(content).axes) == 1


def test_a_baseline_that_the_data_move_beyond_what_is_trusted_is_said_to_be_moved() -> None:
    """Fitted along it hides in every verdict, "consistent" included."""
    own = (BaselineParameter("damping_1", 3.0, 4.99, 0.9, "%"), BaselineParameter("frequency_1", 62.0, 62.1, 1.2, "Hz"))
    found = Finding("consistent", "it is", baseline=own)
    text = explain(found)
    assert "damping of mode 1 4.99 % in place of 3.00." in text
    assert "frequency of mode 1" not in text
    (table,) = shown(found.as_dict())[0]["tables"]
    assert [row.cells[:3] for row in table.rows] == [
        ("damping of mode 1", "3.00", "4.99"),
        ("frequency of mode 1", "62.0", "62.1"),
    ]


def test_a_finding_alone_says_nothing_of_what_the_campaign_may_hold_besides(tmp_path: Path) -> None:
    """Without `smfe run` lobes and cutting tests are not known; with it the verdict stands at the top too."""
    (tmp_path / "finding.json").write_text(json.dumps(finding(campaign="Slots & feeds")), encoding="utf-8")
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert "<h1>Slots &amp; feeds</h1>" in page
    assert "What the simulation gets wrong</h2>" in page
    assert not re.search("No lobes|No cutting tests|No compliances|No tables|provenance.json is absent", page)
    (tmp_path / "provenance.json").write_text(json.dumps({"campaign": "Slots"}), encoding="utf-8")
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert "No lobes were computed for this campaign" in page
    assert page.index("It is the run-out.") < page.index('<section id="diagnosis"')


def test_what_carries_the_remainder_is_told_apart() -> None:
    """Names of conditions hold commas themselves."""
    left = Remainder(3.5, 1e-9, 0.3, 0.1, ("moves, move 8, forward", "moves, move 24, forward"))
    text = explain(Finding("unknown", "it is", remainder=left))
    assert "is largest in moves, move 8, forward; moves, move 24, forward." in text


def test_no_limit_is_a_gap_in_the_stable_depth() -> None:
    rows = [
        {"where": "lobes_1", "spindle_speed_rpm": n, "feed_mm_min": n, "before_mm": 3.0, "after_mm": d}
        for n, d in ((300.0, 2.0), (400.0, None), (500.0, 0.0))
    ]
    before, after = shown(finding(stable_depth=rows))[1]["plot-stable-depth"]["data"]
    depths = np.frombuffer(base64.b64decode(after["y"]["bdata"]), dtype="<f4")
    np.testing.assert_array_equal(depths, np.array([2.0, np.nan, 0.0], dtype="f4"))
    assert (before["name"], before["line"]["dash"]) == ("simulation as declared", "dash")
    assert (after["name"], after["line"]["dash"]) == ("extended model", "dot")


def test_part_of_the_truth_is_not_called_unknown() -> None:
    assert shown(finding(verdict="unknown"))[0]["verdict"] == "partly found"
    assert shown(finding(verdict="unknown", causes=[]))[0]["verdict"] == "unknown"


@pytest.mark.parametrize("content", [{}, {"verdict": "consistent", "misfit_db": {"before": 0.1, "after": 0.1}}])
def test_where_nothing_was_found_nothing_is_drawn(content: dict[str, Any]) -> None:
    assert not has_diagnosis(content)
    assert shown(content)[1] == {}


def test_a_folder_with_a_finding_alone_has_a_report_and_its_picture(tmp_path: Path) -> None:
    rows = [
        {"where": "lobes_1", "spindle_speed_rpm": n, "feed_mm_min": n, "before_mm": 3.0, "after_mm": None}
        for n in (300.0, 400.0)
    ]
    content = finding(stable_depth=rows)
    content["conditions"][0]["name"] = "<script>alert(1)</script> $x_$"
    (tmp_path / "finding.json").write_text(json.dumps(content), encoding="utf-8")
    page = write_report(tmp_path).read_text(encoding="utf-8")
    assert "<script>alert(1)" not in page
    for name in ("plot-conditions", "plot-stable-depth"):
        assert f'id="{name}"' in page
    for picture in ("diagnosis_search.png", "diagnosis_depth.png"):
        assert (tmp_path / "figures" / picture).stat().st_size > 10_000
    assert len(draw_search(content).axes) == 2
    assert len(draw_depths(content).axes) == 1


def test_the_words_say_what_it_means_in_the_workshop() -> None:
    depths = (StableDepth("lobes_1", 300.0, 480.0, 3.0, 2.9), StableDepth("lobes_1", 400.0, 640.0, 3.0, 1.5))
    resting = (StableDepth("a.csv", 500.0, 800.0, 3.0, 0.0),)
    text = explain(Finding("named", "it is", stable_depth=(*depths, *resting)))
    assert "The largest change is at 400 rpm: 1.50 mm where the simulation gives 3.00 mm." in text
    assert "At 500 rpm the axis vibrates without any cut by the extended model; the simulation gives 3.00 mm." in text


def test_a_depth_without_limit_is_none_in_the_file() -> None:
    found = Finding("named", "it is", stable_depth=(StableDepth("a", 300.0, 480.0, 3.0, np.inf),)).as_dict()
    assert found["stable_depth"][0]["after_mm"] is None


def test_whether_what_was_given_is_right_stands_before_the_verdict(tmp_path: Path) -> None:
    """Coefficients 35 % off are the first line of the page, with their millimetres; what is right is folded below."""
    wrong = GivenParameter(
        "Ktc", "", "force_coefficients", 2e3, 200.0, 2.7e3, 2650.0, 2750.0, "N/mm^2", True, 0.26, -1.2
    )
    right = replace(wrong, name="Krc", given=600.0, found=612.0, low=580.0, high=644.0, beyond=False, cost=0.01)
    found = Finding("named", "it is", given=(right, wrong), to_do=("Measure the coefficients again",))
    content = {**found.as_dict(), "campaign": "cuts"}
    content["passages"] = [{"about": p.about, "text": p.text} for p in told(found)]
    rows = shown(content)[0]["given"].rows
    assert rows[0].cells == ("cutting coefficient Ktc", "2000", "2700 N/mm² (2650 to 2750)", "26", "−1.2", "no")
    assert rows[1].cells[-1] == "yes"
    (tmp_path / "finding.json").write_text(json.dumps(content), encoding="utf-8")
    page = write_report(tmp_path).read_text(encoding="utf-8")
    first = page.index("Cutting coefficient Ktc: given 2000")
    assert first < page.index("The simulation is wrong") < page.index("Measure the coefficients again.")
