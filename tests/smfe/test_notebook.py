"""What a notebook shows: figures of every result, tables with units, ``.smfe`` on labelled data."""

import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from samples.report import MACHINE, STEEL, TOOL, measured

import smfe
from process._lazy import lazy
from process.errors import InputError
from smfe.diagnosis.judgement.finding import Estimate, Finding, FoundCause
from smfe.limits.cutting_tests import spectrum_of

CUT = {"cut": "down", "width_of_cut": "100 mm", "spindle_speed": (250, 750, 50)}


@pytest.fixture(scope="module")
def frf() -> xr.Dataset:
    return measured("hammer", 90.0, 2.0, 2e-9, 1).assign_attrs(name="hammer")


@pytest.fixture(scope="module")
def limits(frf: xr.Dataset) -> xr.Dataset:
    return frf.smfe.limits(TOOL, STEEL, **CUT)


@pytest.fixture(scope="module")
def cut() -> xr.Dataset:
    """A cut at 1500 rpm with four teeth and a line at 173 Hz between its harmonics."""
    time = np.arange(16000) / 4000.0
    wave = np.sin(2.0 * np.pi * 100.0 * time) + 2.0 * np.sin(2.0 * np.pi * 173.0 * time)
    return smfe.record(4000, acceleration_x=10.0 * wave, spindle_speed="1500 rpm", name="cut")


def texts(figure: Figure) -> str:
    """Return everything that is written in a figure."""
    out = [t.get_text() for axes in figure.axes for t in (axes.title, axes.xaxis.label, axes.yaxis.label)]
    legends = [axes.get_legend() for axes in figure.axes] + figure.legends
    out += [t.get_text() for legend in legends if legend is not None for t in legend.get_texts()]
    return "\n".join([*out, *(t.get_text() for t in figure.texts)])


def curve(figure: Figure, panel: int = 0) -> np.ndarray:
    """Return the longest line of a panel, shape (points, 2)."""
    return max((np.asarray(line.get_xydata(), dtype=float) for line in figure.axes[panel].lines), key=len)


def test_a_record_is_drawn_a_panel_a_channel_with_units(cut: xr.Dataset) -> None:
    figure = cut.smfe.plot()
    assert len(figure.axes) == 2
    assert "acceleration x\n[m/s²]" in texts(figure)
    assert "spindle speed\n[rpm]" in texts(figure)
    assert curve(figure)[:, 1].max() == pytest.approx(float(cut["acceleration"].max()))


def test_one_entry_shows_magnitude_phase_and_coherence_of_the_data(frf: xr.Dataset) -> None:
    other = measured("sweep", 90.0, 2.0, 1e-9, 2).assign_attrs(name="sweep")
    figure = frf.smfe.plot(other, entry="yx")
    assert len(figure.axes) == 3
    assert "compliance yx [µm/N]" in texts(figure)
    assert {"hammer", "sweep"} <= set(texts(figure).split("\n"))
    known = frf["compliance"].sel(response="y", excitation="x").values
    np.testing.assert_allclose(curve(figure)[:, 1], 1e6 * np.abs(known))
    assert len(frf.smfe.plot().axes) == 9


def test_lobes_are_drawn_with_others_tests_and_the_recommendation(limits: xr.Dataset) -> None:
    advice = smfe.recommendation(limits, TOOL, STEEL)
    figure = smfe.plot({"hammer": limits, "modes": limits}, tests=[(500, 0.2, "stable")], recommendation=advice)
    for word in ("hammer", "modes", "test: stable"):
        assert word in texts(figure)
    assert limits.smfe.plot()._repr_png_()[:4] == b"\x89PNG"  # what a notebook shows of it


def test_verdict_modes_and_look_are_drawn(frf: xr.Dataset, cut: xr.Dataset) -> None:
    verdict = cut.smfe.verdict(1500, 4)
    assert verdict.verdict == "chatter"
    assert "rpm: chatter" in texts(smfe.plot(verdict))
    assert "chatter" in texts(spectrum_of(verdict).smfe.plot())
    assert "frequency [Hz]" in texts(smfe.plot(frf.smfe.modes(), name="hammer"))
    assert "time [s]" in texts(smfe.plot(smfe.look(cut)))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (([1, 2],), "list has no figure"),
        ((xr.Dataset({"a": ("b", [1.0])}),), "Dataset has no figure"),
        ((MACHINE, xr.Dataset({"limit_depth": ("spindle_speed", [1.0])})), "do not go into one figure"),
    ],
)
def test_what_has_no_figure_is_refused(arguments: tuple[object, ...], said: str) -> None:
    with pytest.raises(InputError, match=said):
        smfe.plot(*arguments)


def test_an_entry_that_was_not_measured_and_a_test_without_an_outcome_are_refused(limits: xr.Dataset) -> None:
    with pytest.raises(InputError, match="no entry 'xq' was measured; there are xx, xy"):
        smfe.plot(MACHINE, entry="xq")
    with pytest.raises(InputError, match="stable, chatter or undecided, not 'bad'"):
        limits.smfe.plot(tests=[(500, 1, "bad")])
    with pytest.raises(InputError, match="entry is for compliances; this is lobes"):
        limits.smfe.plot(entry="xx")


def test_every_returned_number_has_a_unit(frf: xr.Dataset, limits: xr.Dataset, cut: xr.Dataset) -> None:
    verdict = cut.smfe.verdict(1500, 4)
    tap = smfe.compliance([10.0, 20.0], [1.0, 2.0], coherence=[0.9, 0.9], averages=5)
    for name, data in {"cut": cut, "limits": limits, "spectrum": verdict.spectrum, "tap": tap}.items():
        lacking = [v for v, a in data.variables.items() if a.dtype.kind not in "UO" and "units" not in a.attrs]
        assert not lacking, name


def test_results_show_themselves_as_tables_with_units(frf: xr.Dataset, limits: xr.Dataset, cut: xr.Dataset) -> None:
    found = smfe.Identification("hammer", "hammer", frf, warnings=("mind <this>",))
    shown = found._repr_html_()
    assert "largest [µm/N]" in shown
    assert "mind &lt;this&gt;" in shown
    assert ">173</td><td>Hz<" in cut.smfe.verdict(1500, 4)._repr_html_()
    assert "stiffness [N/µm]" in smfe.modal(found)._repr_html_()
    advice = smfe.recommendation(limits, TOOL, STEEL)
    assert f">{advice.spindle_speed_rpm:.0f}</td><td>rpm<" in advice._repr_html_()
    friction = FoundCause("f", "f", "friction", "joint", (Estimate("force", 12.0, 10.0, 14.0, "N"),), 50.0, 3.0, 0.5)
    looked = smfe.look(cut)._repr_html_()
    assert ">unit<" in looked
    assert smfe.look(cut).kind.reason in looked
    finding = Finding("named", "it rests on this", causes=(friction,))._repr_html_()
    assert ">force</td><td>12</td><td>10</td><td>14</td><td>N<" in finding


def test_lobes_recommend_what_the_compliance_they_are_of_recommends(frf: xr.Dataset, limits: xr.Dataset) -> None:
    spindle = {"maximum": "700 rpm"}
    asked = smfe.recommendation({"hammer": frf}, TOOL, STEEL, **CUT, spindle=spindle)
    assert limits.smfe.recommendation(TOOL, STEEL, spindle=spindle) == asked
    assert asked.status == "recommended"
    with pytest.raises(InputError, match="cut is not read here: the lobes have their cut"):
        smfe.recommendation(limits, TOOL, STEEL, cut="up")
    with pytest.raises(InputError, match="lobes of one cut are needed"):
        smfe.recommendation({"a": limits, "b": limits.assign_attrs(cut="up")}, TOOL, STEEL)


def test_a_campaign_shows_what_it_holds(tmp_path: Path) -> None:
    modes = 'modes = [ { frequency = "60 Hz", damping = 0.03, stiffness = "30 N/um", direction = [1, 0, 0] } ]'
    text = f'[campaign]\nname = "C <1>"\n[tool]\ndiameter = "80 mm"\nteeth = 2\n[[model]]\nname = "m"\n{modes}\n'
    (tmp_path / "c.toml").write_text(text, encoding="utf-8")
    shown = smfe.read_campaign(tmp_path / "c.toml")._repr_html_()
    for part in ("C &lt;1&gt;", "80 mm, 2 teeth", "1 modes"):
        assert part in shown


def test_what_extends_a_library_is_imported_once_a_public_name_has_imported_that_library() -> None:
    for library, expected in (("a_library_that_nothing_imports", False), ("xarray", True)):
        sys.modules.pop("smfe._version", None)
        get, _ = lazy("process", {"process.errors": "InputError"}, {library: "smfe._version"})
        assert get("InputError") is InputError
        assert ("smfe._version" in sys.modules) == expected
