"""The report is made of the files of a result folder alone, needs nothing else, and says what they say."""

from __future__ import annotations

import base64
import json
import re
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from kept import kept
from places import CHECKOUT
from samples.report import (
    MACHINE,
    cutting_tests,
    hits,
    lobes_of,
    measured,
    model_error,
    spectrum,
    write_reported,
    write_sample,
    write_single,
)

from process.errors import InputError
from process.machine.modes import ModalModel
from smfe.limits.cutting_tests import with_picture
from smfe.reporting import write_report
from smfe.reporting.content.results import Results, read_results
from smfe.reporting.content.style import number, palette
from smfe.reporting.figures.draw_matplotlib import NOTHING, draw_compliance
from smfe.reporting.figures.figure_data import depth_range, frequency_range, magnitude_range
from smfe.reporting.figures.plotly_frame import packed
from smfe.reporting.figures.spectrograms import draw as draw_spectrograms
from smfe.reporting.page import render
from smfe.results import pack_warnings, write_csv, write_groups
from stability import write_table


@pytest.fixture(scope="module")
def sample() -> Path:
    return kept(write_reported)


@pytest.fixture(scope="module")
def results(sample: Path) -> Results:
    return read_results(sample)


@pytest.fixture(scope="module")
def drawn(sample: Path) -> dict:
    return plots(sample)


def page(folder: Path) -> str:
    return (folder / "report.html").read_text(encoding="utf-8")


def written(folder: Path) -> str:
    """Return the page without scripts: what a person reads."""
    text = re.sub(r"<(script|style)\b.*?</\1>", "", page(folder), flags=re.S)
    return re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", text))


def plots(folder: Path) -> dict:
    found = re.search(r'<script type="application/json" id="plots">(.*?)</script>', page(folder), flags=re.S)
    content = json.loads(found[1])

    def resolved(part: object) -> object:
        if isinstance(part, list):
            return [resolved(value) for value in part]
        if not isinstance(part, dict):
            return part
        if "array" in part:
            return content["arrays"][part["array"]]
        return {key: resolved(value) for key, value in part.items()}

    return resolved(content["plots"])


def unpacked(array: dict) -> np.ndarray:
    values = np.frombuffer(base64.b64decode(array["bdata"]), dtype="<f4")
    return values.reshape([int(n) for n in array["shape"].split(",")]) if "shape" in array else values


class TestOneFile:
    def test_nothing_is_fetched(self, sample: Path) -> None:
        text = page(sample)
        before = text.split('<script type="application/json"')[0]
        assert not re.findall(r"<(?:link|iframe|object|embed|base)\b", before)
        # Pictures stand in the page itself.
        assert all(re.search(r'\bsrc="data:image/png;base64,', tag) for tag in re.findall(r"<img\b[^>]*>", before))
        assert not re.findall(r"<script[^>]*\bsrc\b", text)
        # What is offered to download lies beside the page.
        targets = [t for t in re.findall(r'\bhref="([^"]*)"', written_html(text)) if not t.startswith("#")]
        assert targets
        assert all((sample / unquote(target)).is_file() for target in targets)
        assert "@import" not in text
        assert "url(" not in re.search("<style>(.*?)</style>", text, flags=re.S)[1]
        assert "default-src 'none'" in text

    def test_no_other_file_than_report_and_figures(self, tmp_path: Path) -> None:
        write_single(tmp_path)
        before = {p.name for p in tmp_path.iterdir()}
        assert write_report(tmp_path) == tmp_path / "report.html"
        assert {p.name for p in tmp_path.iterdir()} - before == {"report.html", "figures", ".kept"}

    def test_small_enough_to_mail(self, sample: Path) -> None:
        assert (sample / "report.html").stat().st_size < 6e6

    @pytest.mark.slow
    def test_same_folder_same_report(self, sample: Path) -> None:
        results = read_results(sample)
        assert render(results) == page(sample)

    def test_every_plot_has_a_place(self, sample: Path, drawn: dict) -> None:
        text = page(sample)
        for name in drawn:
            assert text.count(f'id="{name}"') == 1

    def test_progress_ends_complete(self, tmp_path: Path) -> None:
        calls: list[tuple[int, int]] = []
        write_report(write_single(tmp_path), lambda done, of: calls.append((done, of)))
        assert calls == [(k, len(calls)) for k in range(1, len(calls) + 1)]


def written_html(text: str) -> str:
    return re.sub(r"<script\b.*?</script>", "", text, flags=re.S)


class TestEscaping:
    NASTY = '</script><script>alert("1")</script><b>$x_{&</b>'

    @pytest.fixture(scope="class")
    @classmethod
    def nasty(cls, tmp_path_factory: pytest.TempPathFactory) -> Path:
        folder = write_sample(tmp_path_factory.mktemp("nasty"), cls.NASTY)
        name = "a<b>$_{\\frac$&"
        dataset = measured("hammer", 100.0, 1.0, 1e-9, 1)
        write_groups(folder / "frf.nc", {name: pack_warnings(dataset, [cls.NASTY])})
        lobes, table = lobes_of(dataset, name)
        write_groups(folder / "lobes.nc", {"lobes_1/" + name: lobes})
        write_table(table, folder / "lobe_table.csv")
        tests = cutting_tests().assign(reason=cls.NASTY, file=cls.NASTY, observed="<i>")
        write_csv(folder / "chatter.csv", tests)
        write_groups(folder / "spectra.nc", {"test_1": spectrum(tests.iloc[0], "<u>$")})
        write_csv(folder / "tables" / "a.hits.csv", hits(3).assign(reason=cls.NASTY))
        write_report(folder)
        return folder

    def test_no_tag_of_the_user_survives(self, nasty: Path) -> None:
        text = page(nasty)
        assert text.count("<script") == page_scripts(nasty)
        assert 'alert("1")' not in text
        assert not re.search(r"<(b|i|u)>", re.sub(r"<script>.*?</script>", "", text, flags=re.S))

    def test_names_are_read_letter_by_letter(self, nasty: Path) -> None:
        assert "&lt;/script&gt;&lt;script&gt;alert(&#34;1&#34;)" in page(nasty)
        names = {trace.get("name", "") for trace in plots(nasty)["plot-compliance"]["data"]}
        assert "a&lt;b&gt;$ {\\frac$&amp; (controller K2)" in names

    def test_a_formula_in_a_name_does_not_stop_the_figures(self, nasty: Path) -> None:
        assert (nasty / "figures" / "lobes_1.png").stat().st_size > 10_000


def page_scripts(folder: Path) -> int:
    """Return the number of script elements: two of data, plotly, ours, and those that plotly itself names."""
    bundle = CHECKOUT / "smfe" / "reporting" / "static" / "plotly-cartesian.min.js"
    return 4 + bundle.read_text(encoding="utf-8").count("<script")


class TestFigures:
    def test_all_there_and_not_empty(self, sample: Path) -> None:
        names = {p.name for p in (sample / "figures").iterdir()}
        tests = {"spectra.png", "spectrograms.png"}
        assert names == {"lobes_1.png", "lobes_2.png", "compliance.png", "condition.png"} | tests
        for name in names:
            content = (sample / "figures" / name).read_bytes()
            assert content.startswith(b"\x89PNG")
            assert len(content) > 20_000

    def test_a_spectrogram_marks_orders_chatter_and_the_cut(self) -> None:
        tests = cutting_tests()
        figure = draw_spectrograms([spectrum(tests.iloc[1])])
        axes = figure.axes[0]
        across = [line.get_ydata()[0] for line in axes.lines if len(set(line.get_ydata())) == 1]
        upright = [line.get_xdata()[0] for line in axes.lines if len(set(line.get_xdata())) == 1]
        assert 66.4 in across
        assert 380.0 * 8 / 60.0 in across
        assert {0.5, 0.6, 3.5, 3.6} <= set(upright)
        assert "cut" in [text.get_text() for text in axes.texts]

    def test_a_stored_spectrogram_takes_a_byte_a_point(self, tmp_path: Path) -> None:
        rng = np.random.default_rng(0)
        size = rng.rayleigh(size=(2, 160, 300)).astype(np.float32)
        coords = {"axis": ["x", "y"], "time": np.arange(160.0), "frequency": np.arange(300.0)}
        picture = xr.Dataset({"amplitude": (("axis", "time", "frequency"), size)}, coords, {"window_s": 2.0})
        whole = with_picture(
            spectrum(cutting_tests().iloc[0]).drop_dims(["picture_time", "picture_frequency"]), picture
        )
        write_groups(tmp_path / "s.nc", {"test_1": whole[["spectrogram"]]})
        assert (tmp_path / "s.nc").stat().st_size < 80_000
        level = whole["spectrogram"]
        back = level.attrs["top"] * 10.0 ** ((level.values.astype(float) - 255.0) * level.attrs["step_dB"] / 20.0)
        np.testing.assert_allclose(back, np.sqrt((size.astype(float) ** 2).sum(axis=0)), rtol=0.03)

    def test_pictures_of_an_earlier_report_go(self, tmp_path: Path) -> None:
        (tmp_path / "figures").mkdir()
        for name in ("lobes_7.png", "mine.png"):
            (tmp_path / "figures" / name).write_bytes(b"old")
        write_report(write_single(tmp_path))
        assert {p.name for p in (tmp_path / "figures").iterdir()} == {
            "compliance.png",
            "condition.png",
            "mine.png",
        }

    def test_lines_hold_the_data(self, sample: Path, drawn: dict, results: Results) -> None:
        data = drawn["plot-lobes-1"]["data"]
        limit = next(t for t in data if t.get("name") == "sweep" and t["mode"] == "lines")
        expected = results.lobes[1]
        assert expected.source == "sweep"
        np.testing.assert_allclose(unpacked(limit["y"]), expected.values("limit_depth"), rtol=1e-6)

    def test_tests_stand_on_their_diagram_only(self, drawn: dict) -> None:
        def tests_in(name: str) -> int:
            traces = drawn[name]["data"]
            return sum(
                unpacked(t["x"]).size for t in traces if "cutting test" in t.get("name", "") and "yaxis" not in t
            )

        assert tests_in("plot-lobes-1") == 5
        assert tests_in("plot-lobes-2") == 0

    def test_the_same_colour_everywhere(self, sample: Path, drawn: dict) -> None:
        colours: dict[str, set[str]] = {}
        for figure in drawn.values():
            for trace in figure["data"]:
                name = trace.get("name", "").partition(" (")[0].replace(" ", "_")
                if name in ("hammer_idle", "actuator", "sweep", "bench") and "color" in trace.get("line", {}):
                    colours.setdefault(name, set()).add(trace["line"]["color"])
        assert all(len(found) == 1 for found in colours.values())
        assert len({next(iter(found)) for found in colours.values()}) == 4

    def test_packing_keeps_seven_digits_and_gaps(self) -> None:
        values = np.array([[1.234567, np.nan], [-3e-9, 1e6]])
        np.testing.assert_allclose(unpacked(packed(values)), values, rtol=1e-6)


class TestWhatIsMissing:
    def test_empty_folder(self, tmp_path: Path) -> None:
        write_report(tmp_path)
        text = written(tmp_path)
        assert "No lobes were computed" in text
        assert re.findall(r'<section id="(\w+)"', page(tmp_path)) == ["answer"]
        assert plots(tmp_path) == {}

    def test_one_axis(self, tmp_path: Path) -> None:
        write_report(write_single(tmp_path))
        figure = plots(tmp_path)["plot-compliance"]
        assert [t for t in figure["layout"] if t.startswith("xaxis")] == ["xaxis"]
        assert "No lobes were computed" in written(tmp_path)

    @pytest.mark.parametrize(
        "name",
        [
            "spectra.nc",
            *(
                pytest.param(name, marks=pytest.mark.slow)
                for name in (
                    "lobes.nc",
                    "lobe_table.csv",
                    "chatter.csv",
                    "frf.nc",
                    "comparison.csv",
                    "model_error.csv",
                    "provenance.json",
                )
            ),
        ],
    )
    def test_each_file_may_be_absent(self, sample: Path, tmp_path: Path, name: str) -> None:
        for path in sample.iterdir():
            if path.is_file() and path.name not in (name, "report.html"):
                (tmp_path / path.name).write_bytes(path.read_bytes())
        assert write_report(tmp_path).is_file()

    def test_no_standard_deviation_and_no_coherence(self, tmp_path: Path) -> None:
        write_groups(tmp_path / "frf.nc", {"m": MACHINE.compliance(np.arange(1.0, 90.0)).assign_attrs(method="model")})
        write_report(tmp_path)
        assert set(plots(tmp_path)) == {"plot-compliance"}
        assert "Band:" not in written(tmp_path)

    def test_entry_without_values_is_left_out(self, tmp_path: Path) -> None:
        dataset = MACHINE.compliance(np.arange(1.0, 90.0), ["x", "y"], ["x"])
        dataset["compliance"].loc[{"response": "y"}] = np.nan
        write_groups(tmp_path / "frf.nc", {"m": dataset})
        assert read_results(tmp_path).measurements[0].entries == [("x", "x")]
        write_report(tmp_path)

    @pytest.mark.parametrize("unknown", [pytest.param(False, marks=pytest.mark.slow), True])
    def test_panel_without_a_positive_value_says_so(self, tmp_path: Path, unknown: bool) -> None:
        # Flexible in x alone: eight of nine entries are zero, which have no place on a logarithmic axis.
        model = ModalModel([60.0], [0.03], [5e7], [[1.0, 0.0, 0.0]]).compliance(np.arange(1.0, 90.0))
        if unknown:
            model["compliance"].loc[{"response": "y", "excitation": "y"}] = np.nan
        write_groups(tmp_path / "frf.nc", {"m": model.assign_attrs(method="model")})
        assert write_report(tmp_path).is_file()
        results = read_results(tmp_path)
        panels = draw_compliance(results.measurements, palette(results)).axes
        assert [len(axes.lines) for axes in panels] == [1] + [0] * 8
        assert [NOTHING in [text.get_text() for text in axes.texts] for axes in panels] == [False] + [True] * 8

    def test_zero_with_a_known_deviation_keeps_its_band(self, tmp_path: Path) -> None:
        model = ModalModel([60.0], [0.03], [5e7], [[1.0, 0.0, 0.0]]).compliance(np.arange(1.0, 90.0))
        model["compliance_std"] = (model["compliance"].dims, np.full(model["compliance"].shape, 1e-9))
        write_groups(tmp_path / "frf.nc", {"m": model})
        results = read_results(tmp_path)
        panels = draw_compliance(results.measurements, palette(results)).axes
        assert [len(axes.collections) for axes in panels] == [1] * 9
        assert not any(NOTHING in [text.get_text() for text in axes.texts] for axes in panels)

    def test_empty_tables(self, tmp_path: Path) -> None:
        write_csv(tmp_path / "comparison.csv", pd.DataFrame())
        write_csv(tmp_path / "model_error.csv", model_error().iloc[:0])
        write_report(tmp_path)
        assert 'id="comparison"' not in page(tmp_path)


class TestCorruptFiles:
    @pytest.mark.parametrize("name", ["frf.nc", "lobes.nc", "spectra.nc", "provenance.json"])
    def test_not_the_format(self, tmp_path: Path, name: str) -> None:
        (tmp_path / name).write_bytes(b"\x89not a file of results {")
        with pytest.raises(InputError, match=re.escape(name)):
            write_report(tmp_path)
        assert not (tmp_path / "report.html").exists()

    @pytest.mark.parametrize("name", ["lobe_table.csv", "chatter.csv", "model_error.csv"])
    def test_columns_are_missing(self, tmp_path: Path, name: str) -> None:
        (tmp_path / name).write_text("a,b\n1,2\n")
        with pytest.raises(InputError, match="has no column"):
            write_report(tmp_path)

    def test_binary_table(self, tmp_path: Path) -> None:
        (tmp_path / "comparison.csv").write_bytes(b"\xff\xfe\x00\x81,\n")
        with pytest.raises(InputError, match="not a readable CSV"):
            write_report(tmp_path)

    def test_text_for_numbers(self, tmp_path: Path) -> None:
        (tmp_path / "lobe_table.csv").write_text("source,spindle_speed_rpm,limit_depth_mm\na,fast,deep\n")
        with pytest.raises(InputError, match="text instead of numbers"):
            write_report(tmp_path)

    def test_group_without_compliance(self, tmp_path: Path) -> None:
        write_groups(tmp_path / "frf.nc", {"m": xr.Dataset({"a": ("frequency", [1.0])})})
        with pytest.raises(InputError, match="no variable 'compliance'"):
            write_report(tmp_path)

    def test_conditions_that_are_no_json(self, tmp_path: Path) -> None:
        dataset = MACHINE.compliance(np.arange(1.0, 9.0)).assign_attrs(conditions="{K2")
        write_groups(tmp_path / "frf.nc", {"m": dataset})
        with pytest.raises(InputError, match="conditions"):
            write_report(tmp_path)

    def test_no_folder(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match="not a folder"):
            write_report(tmp_path / "nowhere")


class TestAxes:
    def test_drift_of_an_integrated_acceleration_is_not_what_is_shown(self, tmp_path: Path) -> None:
        frequency = np.arange(2.0, 1000.0)
        dataset = MACHINE.compliance(frequency, ["x"], ["x"])
        drift = 1e-3 / frequency[:, None, None] ** 4
        dataset["compliance"] = dataset["compliance"] + drift
        dataset["compliance"].attrs["units"] = "m/N"
        write_groups(tmp_path / "frf.nc", {"tap": dataset})
        measurements = read_results(tmp_path).measurements
        low, high = frequency_range(measurements)
        assert low == 0.0
        assert 61.4 < high < 500.0
        assert magnitude_range(measurements, (low, high))[1] < 1.0

    def test_depth_axis_holds_the_tests(self) -> None:
        assert depth_range([np.array([1.0, 2.0, np.inf])], np.array([3.0])) > 3.0
        assert depth_range([np.array([1.0, 1.0, 100.0])], np.empty(0)) <= 8.0
        assert depth_range([np.array([np.inf])], np.empty(0)) == 1.0


class TestNumbers:
    @pytest.mark.parametrize(
        ("value", "text"),
        [
            (1234.56, "1235"),
            (0.000123456, "0.0001235"),
            (np.nan, "–"),
            (True, "yes"),
            (-2.5, "−2.5"),
            (-0.0, "0"),
            (1.5e-9, "1.5·10^−9"),
        ],
    )
    def test_numbers(self, value: float, text: str) -> None:
        assert number(value) == text
