"""The sections below the first screen: cutting tests, measurements with their audit, compliances, comparison, files."""

from __future__ import annotations

import base64
import json
import re
import zlib
from pathlib import Path

import numpy as np
import pytest
from kept import kept
from samples.page import decoded, late_tables, plots, section
from samples.report import cutting_tests, spectrum, write_reported, write_single

from smfe.reporting.content.audit import audit
from smfe.reporting.content.results import Results, read_results
from smfe.reporting.figures.figure_data import common_end
from smfe.reporting.figures.plotly_spectra import BEYOND, COLUMNS, spectrum_figure
from smfe.reporting.figures.spectrograms import spectrogram_figure
from smfe.reporting.page import render
from smfe.results import write_csv, write_groups, write_json


@pytest.fixture(scope="module")
def results() -> Results:
    return read_results(kept(write_reported))


@pytest.fixture(scope="module")
def page() -> str:
    return (kept(write_reported) / "report.html").read_text(encoding="utf-8")


class TestCuttingTests:
    def test_chatter_first_with_predictions_by_word_and_mark(self, page: str) -> None:
        text = section(page, "cutting_tests")
        assert text.index("cut_380.csv") < text.index("cut_300.csv")
        assert "600 1.6 ▲ undecided ✕ chatter 63 ✗ stable limit 1.1 mm ✓ chatter limit 1.3 mm cut_600.csv" in text

    def test_disagreement_is_said_plainly(self, page: str) -> None:
        text = section(page, "cutting_tests")
        assert (
            "cut_520.csv: the criterion finds chatter, the engineer observed stable; what was observed counts" in text
        )
        assert "called stable, but chattered: 600 rpm with 1.6 mm" in text

    def test_spectra_wait_until_they_are_opened(self, page: str) -> None:
        found = re.search(r'<section id="cutting_tests".*?</section>', page, flags=re.S)
        assert found is not None
        outside = re.sub(r"<template.*?</template>", "", found[0], flags=re.S)
        assert 'class="plot"' not in outside
        assert found[0].count('id="plot-spectrum-') == found[0].count('id="plot-spectrogram-') == 6
        opened = re.findall(r'data-opens="([\w-]+)"', outside)
        assert all(found[0].count(f'<template id="{name}">') == 1 for name in opened)

    def test_a_spectrum_keeps_every_line_in_few_points(self) -> None:
        dataset = spectrum(cutting_tests().iloc[1])
        frequency = np.arange(0.1, 2000.0, 0.02)
        rng = np.random.default_rng(1)
        amplitude = rng.rayleigh(size=(3, frequency.size))
        dataset = dataset.drop_dims("frequency").assign_coords(frequency=frequency, axis=list("xyz"))
        dataset["amplitude"] = (("axis", "frequency"), amplitude)
        end = common_end([dataset])
        for trace, values in zip(spectrum_figure(dataset, end)["data"][-3:], amplitude, strict=True):
            x, y = decoded(trace["x"]), decoded(trace["y"])
            assert x.size <= COLUMNS + BEYOND
            for at in np.argsort(values)[-20:]:
                width = end / COLUMNS if frequency[at] < end else (2000.0 - end) / BEYOND
                near = np.abs(x - frequency[at]) <= 1.1 * width
                assert y[near].max() >= 0.999 * values[at]

    def test_a_spectrogram_is_a_small_image_below_sharp_marks(self) -> None:
        dataset = spectrum(cutting_tests().iloc[1])
        figure = spectrogram_figure(dataset, 180.0)
        image = figure["layout"]["images"][0]
        content = base64.b64decode(image["source"].partition(",")[2])
        assert content.startswith(b"\x89PNG")
        assert len(content) < 12_000
        # Width and height are those of the stored picture, and the brightest point is where the level is highest.
        shape = tuple(int.from_bytes(content[k : k + 4]) for k in (16, 20))
        assert shape == (dataset.sizes["picture_time"], dataset.sizes["picture_frequency"])
        at = content.index(b"IDAT")
        rows = zlib.decompress(content[at + 4 : at + 4 + int.from_bytes(content[at - 4 : at])])
        levels = np.frombuffer(rows, np.uint8).reshape(shape[1], shape[0] + 1)[::-1, 1:].T
        assert (levels == levels.max())[dataset["spectrogram"].values == 250].all()
        across = [s["y0"] for s in figure["layout"]["shapes"] if s["y0"] == s["y1"] and s["xref"] == "paper"]
        assert {66.4, 380.0 * 8 / 60.0, 130.1} <= set(across)
        assert [note["text"] for note in figure["layout"]["annotations"]] == ["cut"]

    def test_no_test_no_section(self, tmp_path: Path) -> None:
        assert section(render(read_results(write_single(tmp_path))), "cutting_tests") == ""

    def test_spectra_without_a_table(self, tmp_path: Path) -> None:
        write_groups(tmp_path / "spectra.nc", {"test_1": spectrum(cutting_tests().iloc[1])})
        assert "380 2.5 ✕ chatter" in section(render(read_results(tmp_path)), "cutting_tests")


class TestMeasured:
    def test_how_it_was_measured_and_what_the_audit_says_stand_in_one_row(self, page: str) -> None:
        text = section(page, "measured")
        assert "hammer idle impact hammer controller K2 10 to 400 all 9" in text
        assert "18 of 21 hits 1 of 21 hits is overloaded. " in text
        assert "3 passes" in text

    def test_what_was_left_out_comes_first_and_why(self, page: str) -> None:
        text = section(page, "measured")
        assert "3 of 21 hits of hammer idle were left out: overloaded (3)." in text
        assert text.index("were left out") < text.index("impact hammer")

    def test_hits_are_made_when_they_are_opened(self, page: str) -> None:
        tables = late_tables(page)
        hits = next(t for t in tables if "peak force [N]" in t["head"] and len(t["rows"]) == 21)
        assert list(hits["css"].values()) == ["rejected"] * 3
        assert {len(row) for row in hits["rows"]} == {len(hits["head"])} == {len(hits["numeric"])}
        assert "overloaded" not in re.sub("left out: overloaded|is overloaded", "", section(page, "measured"))

    def test_a_failed_measurement_is_named_with_its_reason(self, tmp_path: Path) -> None:
        reasons = [{"part": "measurement", "name": f"tap_{k}", "reason": "all hits are overloaded"} for k in (1, 2)]
        write_json(tmp_path / "provenance.json", {"campaign": "c", "failures": reasons, "check": [], "warnings": []})
        text = section(render(read_results(tmp_path)), "measured")
        assert "tap 1 and tap 2 was left out: All hits are overloaded." in text

    def test_warnings_of_the_audit_find_their_measurement(self, tmp_path: Path) -> None:
        write_single(tmp_path)
        note = {"cause": "offset", "level": "note", "where": "tap, r.csv", "evidence": "an offset", "advice": "none"}
        warnings = [f"tap, r_{k}.csv, force_x: it is cut off; look at the range" for k in (1, 2)]
        write_json(tmp_path / "provenance.json", {"warnings": [*warnings, "lobes_1, tap: coarse"], "check": [note]})
        found = audit(read_results(tmp_path))
        assert found.rows[0].said == ("It is cut off; look at the range (force x, r_1.csv and r_2.csv).",)
        assert [s.whole for s in found.said][1:] == ["lobes_1, tap: coarse."]
        assert [s.whole for s in found.notes] == ["An offset; none (r.csv)."]


class TestCompliances:
    def test_five_views_and_a_choice_of_the_entry(self, page: str) -> None:
        figure = plots(page)["plot-compliance"]
        assert [v["label"] for v in figure["views"]] == [
            "magnitude",
            "phase",
            "real part",
            "imaginary part",
            "coherence",
        ]
        assert [p["name"] for p in figure["panels"]] == [r + e for r in "xyz" for e in "xyz"]

    def test_the_views_are_the_data(self, page: str, results: Results) -> None:
        figure = plots(page)["plot-compliance"]
        m = next(m for m in results.measurements if m.name == "actuator")
        at, line = next(
            (at, t)
            for at, t in enumerate(figure["data"])
            if t["legendgroup"] == "actuator" and t["xaxis"] == "x" and "fill" not in t
        )
        x = decoded(line["x"])
        kept_points = np.argmin(np.abs(m.frequency[:, None] - x), axis=0)
        values = 1e6 * m.entry("x", "x")[kept_points]
        views = [v["y"][v["lines"].index(at)] for v in figure["views"]]
        np.testing.assert_allclose(decoded(views[0]), np.abs(values), rtol=5e-4)
        size, phase = (decoded(part) for part in views[2]["of"])
        np.testing.assert_allclose(size * np.exp(1j * np.radians(phase)), values, atol=1e-3 * np.abs(values).max())
        assert (views[2]["derive"], views[3]["derive"]) == ("real", "imaginary")
        coherence = next(c for e, c in m.coherences("x") if e in ("", "x"))[kept_points]
        np.testing.assert_allclose(decoded(views[4]), coherence, atol=1e-4)

    def test_a_band_is_made_of_two_standard_deviations(self, tmp_path: Path) -> None:
        band, line = plots(render(read_results(write_single(tmp_path))))["plot-compliance"]["data"]
        assert (band["x"]["derive"], band["y"]["derive"]) == ("band_x", "band_y")
        size, std = (decoded(part) for part in band["y"]["of"][:2])
        np.testing.assert_array_equal(size, decoded(line["y"]))
        known = np.isfinite(std)
        np.testing.assert_allclose(std[known], 2e-3, rtol=1e-3)
        assert decoded(line["x"])[known].min() == pytest.approx(20.0, abs=0.01)

    def test_conditions_are_named(self, page: str) -> None:
        assert "sweep (controller K2)" in {t.get("name") for t in plots(page)["plot-compliance"]["data"]}

    def test_the_condition_of_the_forces_stands_beside(self, page: str) -> None:
        assert "exceeds 30 (badly conditioned) at 9" in section(page, "compliances")


class TestComparison:
    def test_three_sentences_then_the_folded_table(self, page: str) -> None:
        text = section(page, "comparison")
        assert "hammer idle and actuator agree; sweep differs" in text
        assert "−3.26 ± 0.21 % (−2.00 ± 0.13 Hz)" in text
        assert "Feed explains 93 % of it" in text
        assert "All 10 pairs of peaks" in text

    def test_errors_against_a_model_are_a_matrix(self, page: str) -> None:
        assert "sweep 10 to 200 7.2 7.2" in section(page, "comparison")


class TestFiles:
    def test_each_file_is_linked_and_said(self, page: str) -> None:
        folder = kept(write_reported)
        found = re.search(r'<section id="files".*?</section>', page, flags=re.S)
        assert found is not None
        links = re.findall(r'href="([^"#]+)"', found[0])
        every = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file()}
        # What the next run goes on from is nobody's download.
        expected = {name for name in every if not name.startswith(".kept/")} - {"report.html"}
        assert set(links) == expected
        assert "Compliances with uncertainty and coherence" in section(page, "files")

    def test_inputs_stand_folded_with_their_sums(self, page: str) -> None:
        assert "1 input files with their SHA-256" in section(page, "files")
        assert "hx_1.csv " + "0" * 64 in section(page, "files")

    def test_the_address_of_an_odd_name_is_escaped(self, tmp_path: Path) -> None:
        write_single(tmp_path)
        write_csv(tmp_path / "tables" / "a b#1.hits.csv", cutting_tests())
        page = render(read_results(tmp_path))
        assert 'href="tables/a%20b%231.hits.csv"' in page


class TestMany:
    def test_fifty_cuts_stay_below_six_megabytes(self, tmp_path: Path) -> None:
        tests = cutting_tests()
        many = tests.loc[np.arange(50) % len(tests)].reset_index(drop=True)
        many["depth_of_cut_mm"] = 1.0 + 0.01 * np.arange(50)
        write_csv(tmp_path / "chatter.csv", many)
        wide = spectrum(tests.iloc[1])
        frequency = np.linspace(0.1, 3000.0, 16_000)
        size = np.random.default_rng(3).rayleigh(size=(3, frequency.size))
        fine = wide.drop_dims("frequency").assign_coords(frequency=frequency, axis=list("xyz"))
        fine["amplitude"] = (("axis", "frequency"), size)
        picture = np.random.default_rng(4).integers(100, 200, (160, 300)).astype(np.uint8)
        fine = fine.drop_dims(["picture_time", "picture_frequency"]).assign_coords(
            picture_time=np.linspace(0.1, 9.0, 160), picture_frequency=np.linspace(1.0, 400.0, 300)
        )
        fine["spectrogram"] = (("picture_time", "picture_frequency"), picture, wide["spectrogram"].attrs)
        # No two spectra are the same, else the page would hold their numbers once.
        spectra = {f"test_{k + 1}": fine.assign(amplitude=(1.0 + 1e-3 * k) * fine["amplitude"]) for k in range(50)}
        read = read_results(tmp_path)
        read = type(read)(**{**vars(read), "spectra": spectra})
        page = render(read)
        found = json.loads(re.search(r'id="plots">(.*?)</script>', page, flags=re.S)[1])  # type: ignore[index]
        assert sum(name.startswith("plot-spectrum-") for name in found["plots"]) == 50
        assert len(page.encode()) < 6e6
