"""The answer says what presets.json says, first and in the words of the shop; the diagram beside it shows the same."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from kept import kept
from samples.report import cutting_tests, write_reported

from smfe.reporting import write_report
from smfe.reporting.content import advice
from smfe.reporting.content.audit import audit
from smfe.reporting.content.headline import score
from smfe.reporting.content.results import Lobes, Results, read_results
from smfe.reporting.content.style import number, with_range
from smfe.reporting.figures.draw_matplotlib import draw_lobes
from smfe.reporting.figures.lobe_data import diagram, spread
from smfe.reporting.figures.plotly_lobes import lobes_figure
from smfe.reporting.sections.answer import section
from smfe.reporting.sections.draft import Draft
from smfe.results import write_csv


@pytest.fixture(scope="module")
def results() -> Results:
    return read_results(kept(write_reported))


@pytest.fixture(scope="module")
def page() -> str:
    return (kept(write_reported) / "report.html").read_text(encoding="utf-8")


def read(text: str) -> str:
    text = re.sub(r"<(script|style)\b.*?</\1>", "", text, flags=re.S)
    return unescape(re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text)))


def with_advice(results: Results, **changes: Any) -> dict[str, Any]:
    return {**results.best, **changes}


class TestWhatIsSaid:
    def test_the_element_carries_the_recommendation(self, page: str, results: Results) -> None:
        tag = re.search(r'<section id="answer"[^>]*>', page)
        assert tag is not None
        found = {k: unescape(v) for k, v in re.findall(r'data-([\w-]+)="([^"]*)"', tag[0])}
        for key, value in results.best.items():
            text = found[key.replace("_", "-").lower()]
            assert (text if isinstance(value, str) else json.loads(text)) == value

    def test_the_numbers_stand_first_and_as_they_are(self, page: str, results: Results) -> None:
        best, text = results.best, read(page)
        for name, key in (("Spindle speed", "spindle_speed_rpm"), ("Depth of cut", "depth_of_cut_mm")):
            assert f"{name} {number(best[key])} " in text
        assert best["reason"] in text
        assert best["assumptions"][0] in text
        assert text.index("Spindle speed") < text.index("Every source and pocket")

    def test_machine_tool_material_and_cut_are_named(self, page: str) -> None:
        head = read(page.partition("<main")[0])
        for part in ("Ram machine", "125 mm, 8 teeth, approach angle 45°", "C45"):
            assert part in head

    def test_a_limit_of_unknown_uncertainty_is_no_depth(self, results: Results) -> None:
        unknown = dict.fromkeys(["depth_of_cut_mm", "limit_depth_p05_mm", "limit_depth_p95_mm", "probability"])
        unknown["removal_rate_cm3_min"] = None
        limit = with_advice(results, status="limit_only", **unknown)
        assert advice.headline(limit) == "Limit, uncertainty unknown: no safe depth is given"
        assert [t.name for t in advice.tiles(limit)][1] == "Limit depth"
        assert "data-depth-of-cut-mm" not in advice.attributes(limit)

    def test_a_refuted_depth_is_none_though_its_uncertainty_is_known(self, results: Results) -> None:
        limit = with_advice(results, status="limit_only", depth_of_cut_mm=None)
        assert advice.headline(limit) == "Limit; no depth is called safe"

    def test_nothing_to_cut(self, results: Results) -> None:
        numbers = {k: None for k, v in results.best.items() if isinstance(v, float) and "width" not in k}
        none = with_advice(results, **{**numbers, "status": "none", "feed_per_tooth_mm": 0.2})
        assert advice.headline(none) == "No cut can be recommended"
        assert advice.tiles(none) == []
        assert [name for name, _ in advice.details(none)] == ["Source"]

    def test_warnings_stand_once_in_one_fold(self, page: str, results: Results) -> None:
        found = results.warnings
        assert len(found) == len(set(found))
        assert sum("1 of 21 hits is overloaded" in sentence for _, sentence in found) == 1
        assert len(re.findall(rf"<summary>{len(audit(results).said)} warnings", page)) == 1

    def test_a_folder_without_presets_says_what_to_do(self, tmp_path: Path) -> None:
        frame = pd.DataFrame({"source": "a", "spindle_speed_rpm": [100.0, 110.0, 120.0], "limit_depth_mm": np.nan})
        write_csv(tmp_path / "lobe_table.csv", frame)
        write_report(tmp_path)
        text = read((tmp_path / "report.html").read_text(encoding="utf-8"))
        assert "No recommendation in this folder" in text
        assert "no limit found" in text

    def test_each_request_has_a_block_and_the_recommended_one_is_shown(self, page: str) -> None:
        page = page.partition("<script")[0]
        assert re.findall(r'data-shows="(\w+)"( checked)?', page) == [("lobes_1", " checked"), ("lobes_2", "")]
        blocks = re.findall(r'class="advice" data-part="(\w+)"( hidden)?', page)
        assert blocks == [("lobes_1", ""), ("lobes_2", " hidden")]


def test_two_requests_of_one_cut_have_names_of_their_own(results: Results) -> None:
    advised = results.presets["recommendation"]
    both = [{**advised, "lobes": name} for name in ("lobes_1", "lobes_2")]
    same = replace(results, presets={"recommendation": both[0], "recommendations": both})
    names = [advice.cut_name(same, name) for name in ("lobes_1", "lobes_2")]
    assert len(set(names)) == 2
    assert all(name.startswith(advice.cut_text(advised)) for name in names)
    assert advice.cut_name(same, "lobes_3") == "lobes_3"


class TestSources:
    def test_score_counts_what_was_observed_before_the_verdict(self) -> None:
        tests = cutting_tests()
        # The sixth test belongs to no lobes; the fourth was observed stable, the fifth chattered.
        hammer, sweep = (score(tests, "lobes_1", s) for s in ("hammer_idle", "sweep"))
        assert hammer is not None
        assert sweep is not None
        assert (hammer.right, hammer.of, hammer.unsafe) == (2, 5, 1)
        assert (sweep.right, sweep.of, sweep.unsafe) == (5, 5, 0)
        assert score(tests, "lobes_2", "sweep") is None
        assert score(None, "lobes_1", "sweep") is None

    def test_the_table_holds_score_and_limits_of_each_source(self, results: Results) -> None:
        table = advice.sources(results, results.requests["lobes_1"], results.advice["lobes_1"])
        hammer, sweep = (row.cells for row in table.rows)
        assert hammer[-1] == "2 of 5; 1 chattered where it says stable"
        assert sweep[-1] == "5 of 5"
        for item, cells in zip(results.lobes, (hammer, sweep), strict=False):
            assert cells[-3] == number(item.table["limit_depth_mm"].min(), 3)
            assert cells[-2] == number(item.table["safe_depth_mm"].min(), 3)

    def test_pockets_are_those_of_the_file(self, results: Results) -> None:
        table = advice.pockets(results, "lobes_1")
        assert table is not None
        assert [row.cells[-1] for row in table.rows] == ["recommended", "end of the range"]
        assert table.rows[0].cells[2] == number(results.best["depth_of_cut_mm"])

    @pytest.mark.parametrize(
        ("value", "low", "high", "said"),
        [
            (17.2843, 17.143, 17.4391, ("17.28", "17.14 to 17.44")),
            (17.2843, 12.3, 21.9, ("17.3", "12.3 to 21.9")),
            (170.0, 120.0, 210.0, ("170", "120 to 210")),
            (2.5, float("nan"), float("nan"), ("2.5", "")),
        ],
    )
    def test_a_range_has_two_digits_of_its_half_width(
        self, value: float, low: float, high: float, said: tuple[str, str]
    ) -> None:
        assert with_range(value, low, high) == said


class TestDiagram:
    def test_page_and_picture_mark_the_same_cut(self, results: Results) -> None:
        lobes, best = results.requests["lobes_1"], results.best
        looks = Draft.of(results).looks
        place = (best["spindle_speed_rpm"], best["depth_of_cut_mm"])
        figure = lobes_figure(lobes, None, looks, best)
        star = next(t for t in figure["data"] if t.get("name") == "recommended cut")
        assert (star["x"][0], star["y"][0]) == place
        axes = draw_lobes(lobes, None, looks, best).axes[0]
        stars = [line.get_xydata()[0] for line in axes.lines if line.get_marker() == "*"]
        assert [tuple(at) for at in stars] == [place]

    def test_the_safe_curve_is_that_of_the_recommended_source(self, results: Results) -> None:
        shown = diagram(results.requests["lobes_1"], None, results.best)
        assert shown.main.source == "sweep"
        assert shown.safe is not None
        np.testing.assert_array_equal(shown.safe[1], shown.main.table["safe_depth_mm"])
        assert (shown.floor <= shown.limit).all()

    def test_lines_differ_in_dash_and_have_their_names_at_their_ends(self, results: Results) -> None:
        lobes = results.requests["lobes_1"]
        figure = lobes_figure(lobes, None, Draft.of(results).looks, results.best)
        lines = [t for t in figure["data"] if t.get("showlegend", True) and t["mode"] == "lines"]
        assert len({t["line"]["dash"] for t in lines}) == len(lines) == 3
        names = {note["text"] for note in figure["layout"]["annotations"] if note.get("wide")}
        assert names == {t["name"] for t in lines}

    def test_words_stand_in_their_regions(self, results: Results) -> None:
        shown = diagram(results.requests["lobes_1"], cutting_tests(), results.best)
        places = shown.places(cutting_tests())
        speed, depth = places["stable"]
        assert depth < np.interp(speed, shown.speed, shown.floor)
        speed, depth = places["chatter"]
        assert np.interp(speed, shown.speed, shown.limit) < depth < shown.top

    def test_labels_keep_apart_and_in_order(self) -> None:
        places = spread([0.5, 0.5, 0.51, 0.99, 1.0], 0.05)
        assert np.diff(places).min() >= 0.05 - 1e-12
        assert max(places) <= 1.0
        assert spread([0.2, 0.8], 0.05) == [0.2, 0.8]

    def test_a_limit_without_a_depth_is_marked_as_such(self, results: Results) -> None:
        limit = with_advice(results, status="limit_only", depth_of_cut_mm=None)
        point = diagram(results.requests["lobes_1"], None, limit).point
        assert point is not None
        assert point[1] == limit["limit_depth_mm"]
        assert point[2].startswith("limit: ")

    def test_without_a_limit_everything_is_stable(self) -> None:
        speed = np.array([100.0, 110.0, 120.0])
        table = pd.DataFrame({"source": "a", "spindle_speed_rpm": speed, "limit_depth_mm": np.inf})
        nothing = SimpleNamespace(values=lambda name: np.full(3, np.inf), lower=lambda: None, table=table, source="a")
        nothing.data = xr.Dataset(coords={"spindle_speed": speed})
        shown = diagram([cast(Lobes, nothing)], None, None)
        assert shown.point is None
        np.testing.assert_array_equal(shown.floor, shown.top)

    def test_single_speeds_are_bars_and_points_for_nothing_is_known_between_them(self, results: Results) -> None:
        whole = results.requests["lobes_1"]
        at = [20, 60, 110]
        lobes = [
            replace(i, data=i.data.isel(spindle_speed=at).assign_attrs(single_speeds=1), table=i.table.iloc[at])
            for i in whole
        ]
        looks = Draft.of(results).looks
        figure = lobes_figure(lobes, cutting_tests(), looks, results.best)
        assert [t["name"] for t in figure["data"] if t["type"] == "bar"] == ["stable", "chatter"]
        assert not [t for t in figure["data"] if t["type"] == "scatter" and t["mode"] == "lines"]
        symbols = [
            t["marker"]["symbol"] for t in figure["data"] if t.get("name") in ("sweep", "hammer idle", "safe depth")
        ]
        assert len(set(symbols)) == 3
        low, high = diagram(lobes, None, results.best).span
        assert low < lobes[0].table["spindle_speed_rpm"].min()
        assert high > lobes[0].table["spindle_speed_rpm"].max()
        assert len(draw_lobes(lobes, None, looks, results.best).axes[0].patches) == 6

    def test_one_speed_alone_has_a_diagram(self, results: Results) -> None:
        item = results.requests["lobes_1"][1]
        one = [replace(item, data=item.data.isel(spindle_speed=[7]), table=item.table.iloc[[7]])]
        low, high = lobes_figure(one, None, Draft.of(results).looks)["layout"]["xaxis"]["range"]
        assert low < item.table["spindle_speed_rpm"].iloc[7] < high

    def test_depth_over_speed_and_width_is_that_of_the_file(self, tmp_path: Path) -> None:
        rows = {"lobes": "lobes_1", "source": "sweep", "spindle_speed_rpm": [700, 855], "feed_mm_min": [140, 171]}
        depths = {"depth_20mm_mm": [3.9, 15.2], "depth_40mm_mm": [3.2, 13.5]}
        best = {"best_width_of_cut_mm": [40.0, 40.0], "removal_rate_cm3_min": [17.92, 92.34]}
        write_csv(tmp_path / "depth_table.csv", pd.DataFrame({**rows, **depths, **best}))
        (table,) = advice.depths(read_results(tmp_path))
        assert table.headers[2:4] == ("20 mm wide", "40 mm wide")
        assert [row.cells[2:4] for row in table.rows] == [("3.9", "3.2"), ("15.2", "13.5")]
        assert [row.css for row in table.rows] == ["", "advised"]

    def test_no_lobes_is_said_in_one_sentence(self, tmp_path: Path) -> None:
        found = section(Draft.of(read_results(tmp_path)))
        assert found["blocks"] == []
        assert found["attributes"] == {}
