"""What a run recommends, for CAM programs and for the wall: the same numbers, and none where none is safe."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from typer.testing import CliRunner

import smfe
from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.cli import app
from smfe.limits.campaign_lobes import all_lobes
from smfe.limits.lobe_files import write_lobes
from smfe.progress import silent
from smfe.reporting.content.results import read_results
from smfe.reporting.setup_sheet import draw_sheet

CAMPAIGN = """
[campaign]
name = "Bench & mill <1>"
[tool]
diameter = "16 mm"
teeth = 2
edge_length = "30 mm"
[material]
name = "aluminium"
Ktc = "600 N/mm^2"
Krc = "200 N/mm^2"
Kac = "0 N/mm^2"
uncertainty = "5 %"
[spindle]
step = "50 rpm"
[[model]]
name = "first_mode"
modes = [{{ frequency = "922 Hz", damping = 0.011, stiffness = "1.34e6 N/m", direction = [1, 0, 0] }}]
{uncertainty}
[[lobes]]
measurements = ["first_mode"]
method = "zero_order"
cut = "down"
width_of_cut = "4 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["6000 rpm", "16000 rpm", "50 rpm"]
maximum_depth = "10 mm"
[[lobes]]
measurements = ["first_mode"]
method = "zero_order"
cut = "down"
width_of_cut = "8 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["6000 rpm", "16000 rpm", "50 rpm"]
maximum_depth = "10 mm"
"""


def results(folder: Path, uncertainty: str) -> Path:
    (folder / "campaign.toml").write_text(CAMPAIGN.format(uncertainty=uncertainty))
    loaded = load_campaign(folder / "campaign.toml")
    machine = {m.name: m.modal.compliance(np.arange(300.0, 2500.0, 2.0)) for m in loaded.models}
    write_lobes(folder, all_lobes(loaded, machine, silent), loaded)
    return folder


@pytest.fixture(scope="module")
def sure(tmp_path_factory: pytest.TempPathFactory) -> Path:
    known = 'uncertainty = { frequency = "0.5 %", damping = "20 %", stiffness = "5 %" }'
    return results(tmp_path_factory.mktemp("sure"), known)


@pytest.fixture(scope="module")
def unsure(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return results(tmp_path_factory.mktemp("unsure"), "")


def test_every_target_holds_the_recommendation_of_each_width(sure: Path, tmp_path: Path) -> None:
    answers = json.loads((sure / "presets.json").read_text())["recommendations"]
    assert len(answers) == 2
    wanted = {(a["spindle_speed_rpm"], a["depth_of_cut_mm"], a["width_of_cut_mm"]) for a in answers}
    smfe.export(sure, tmp_path / "a.json", "fusion")
    presets = json.loads((tmp_path / "a.json").read_text())["data"][0]["start-values"]["presets"]
    assert wanted <= {(p["n"], p["stepdown"], p["stepover"]) for p in presets}
    smfe.export(sure, tmp_path / "a.csv", "csv")
    rows = list(csv.DictReader((tmp_path / "a.csv").read_text().splitlines()))
    columns = ("spindle_speed_rpm", "depth_of_cut_mm", "width_of_cut_mm")
    assert wanted <= {tuple(float(row[c]) for c in columns) for row in rows}
    smfe.export(sure, tmp_path / "a.fctb", "freecad")
    notes = " ".join(p["notes"] for p in json.loads((tmp_path / "a.fctb").read_text())["presets"])
    for speed, depth, width in wanted:
        assert f"width of cut {width:g} mm; depth of cut {depth:g} mm, {speed:g} rpm" in notes


def test_the_setup_sheet_is_one_page_with_the_answer(sure: Path, tmp_path: Path) -> None:
    pypdf = pytest.importorskip("pypdf")
    smfe.export(sure, tmp_path / "a.pdf", "sheet")
    found = smfe.recommendation(sure)
    (page,) = pypdf.PdfReader(tmp_path / "a.pdf").pages
    text = page.extract_text()
    for value in (f"{found.spindle_speed_rpm:.0f}", f"{found.depth_of_cut_mm:.1f}", "Bench & mill <1>", "aluminium"):
        assert value in text
    assert (float(page.mediabox.width), float(page.mediabox.height)) == pytest.approx((595.4, 841.7), abs=0.5)


def test_all_of_the_setup_sheet_lies_within_its_margins_and_the_cut_within_the_diagram(sure: Path) -> None:
    document = json.loads((sure / "presets.json").read_text())
    figure = draw_sheet(read_results(sure), document)
    drawn = FigureCanvasAgg(figure).get_renderer()
    width = figure.bbox.width
    for text in figure.texts:
        box = text.get_window_extent(drawn)
        assert 0.05 * width < box.x0 < box.x1 < 0.95 * width, text.get_text()
    lobes = next(axes for axes in figure.axes if axes.get_ylabel())
    (depth,) = next(line for line in lobes.lines if line.get_label() == "cut here").get_ydata()
    assert 0.0 < depth < 0.95 * lobes.get_ylim()[1]


def test_a_limit_without_uncertainty_goes_to_no_program(unsure: Path, tmp_path: Path) -> None:
    for name, target in (("a.json", "fusion"), ("a.fctb", "freecad"), ("a.csv", "csv")):
        with pytest.raises(InputError, match=r"recommends no depth: .*A limit without a margin is not exported"):
            smfe.export(unsure, tmp_path / name, target)
        assert not (tmp_path / name).exists()
    pypdf = pytest.importorskip("pypdf")
    smfe.export(unsure, tmp_path / "a.pdf", "sheet")
    text = pypdf.PdfReader(tmp_path / "a.pdf").pages[0].extract_text()
    assert "LIMIT, UNCERTAINTY UNKNOWN" in text
    assert "No safe depth is given" in text
    assert "cut here" not in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere", "-o", "a.json", "--to", "fusion"], "there is no folder 'nowhere'"),
        ([".", "-o", "a.json", "--to", "fusion"], "holds no presets.json"),
        ([".", "-o", "a.pdf", "--to", "sheet"], "presets.json"),
        (["SURE", "-o", "a.txt", "--to", "fusion"], "name it NAME.json or NAME.tools"),
        (["SURE", "-o", "a.csv", "--to", "csv", "--tool", "x"], "a tool is chosen in libraries of Fusion alone"),
    ],
)
def test_what_cannot_be_exported_is_said_in_one_line(
    sure: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["export", *(str(sure) if a == "SURE" else a for a in arguments)])
    assert done.exit_code == 1
    assert said in done.output.replace("\n", " ")
    assert list(tmp_path.iterdir()) == []
