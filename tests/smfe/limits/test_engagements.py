"""Other engagements than down, up and central by a campaign: the same limits where the arcs are the same."""

from pathlib import Path

import numpy as np
import pytest

import process
import smfe
import stability
from process.cut.engagement import engagement, engagement_of_offset, engagement_of_strips, width_of
from process.errors import InputError
from smfe.campaign import load_campaign
from smfe.limits.campaign_lobes import all_lobes
from smfe.limits.recommendation import recommend
from smfe.progress import silent

CAMPAIGN = """
[campaign]
name = "engagements"
[tool]
diameter = "80 mm"
teeth = 5
[material]
Ktc = "1900 N/mm^2"
Krc = "800 N/mm^2"
Kac = "300 N/mm^2"
[[model]]
name = "spindle"
modes = [
    {{ frequency = "180 Hz", damping = 0.03, stiffness = "20 N/um", direction = [1, 0, 0] }},
    {{ frequency = "210 Hz", damping = 0.04, stiffness = "25 N/um", direction = [0, 1, 0] }},
]
uncertainty = {{ stiffness = "5 %" }}
[[lobes]]
measurements = ["spindle"]
method = "{method}"
{cut}
feed_per_tooth = "0.1 mm"
spindle_speed = ["900 rpm", "1800 rpm", "300 rpm"]
maximum_depth = "20 mm"
"""
MODES = process.ModalModel([180.0, 210.0], [0.03, 0.04], [20e6, 25e6], np.eye(2, 3))
TOOL, STEEL = process.Tool(80e-3, 5), process.CuttingCoefficients(1.9e9, 8e8, 3e8)
METHODS = ["zero_order", "multi_frequency", "semi_discretization"]
STRIPS = 'cut = "strips"\nstrips = [["-35 mm", "-15 mm"], ["10 mm", "30 mm"]]'


def campaign(folder: Path, cut: str, method: str = "zero_order") -> smfe.Campaign:
    path = folder / "campaign.toml"
    path.write_text(CAMPAIGN.format(cut=cut, method=method))
    return load_campaign(path)


def lobes_of(loaded: smfe.Campaign) -> list:
    return all_lobes(loaded, {"spindle": MODES.compliance(np.arange(60.0, 700.0, 0.5))}, silent)


def limits(folder: Path, cut: str, method: str = "zero_order") -> np.ndarray:
    return lobes_of(campaign(folder, cut, method))[0].lobes["limit_depth"].values


@pytest.mark.parametrize("cut", ["down", "up"])
@pytest.mark.parametrize("method", METHODS)
def test_an_offset_to_the_edge_of_the_tool_and_free_angles_are_the_down_and_up_cut(tmp_path, cut, method):
    expected = limits(tmp_path, f'cut = "{cut}"\nwidth_of_cut = "30 mm"', method)
    sign = "" if cut == "down" else "-"
    offset = limits(tmp_path, f'cut = "offset"\nwidth_of_cut = "30 mm"\noffset = "{sign}25 mm"', method)
    np.testing.assert_allclose(offset, expected, rtol=2e-3)
    arc = engagement(cut, 30e-3, 80e-3)
    entry, leave = np.degrees([arc.entry, arc.exit])
    angles = f'cut = "angles"\nentry_angle = "{entry!r} deg"\nexit_angle = "{leave!r} deg"'.replace("np.float64", "")
    angles = angles.replace("(", "").replace(")", "")
    np.testing.assert_allclose(limits(tmp_path, angles, method), expected, rtol=2e-3)


@pytest.mark.parametrize("method", METHODS)
def test_strips_are_a_tooth_that_leaves_the_work_and_comes_back(tmp_path, method):
    arcs = engagement_of_strips([(-35e-3, -15e-3), (10e-3, 30e-3)], 80e-3)
    machine = MODES.compliance(np.arange(60.0, 700.0, 0.5)) if method == "zero_order" else MODES
    speeds = [900.0, 1200.0, 1500.0, 1800.0]
    expected = getattr(stability, method)(machine, TOOL, arcs, STEEL, speeds)["limit_depth"].values
    result = lobes_of(campaign(tmp_path, STRIPS, method))[0]
    np.testing.assert_allclose(result.lobes["limit_depth"], expected, rtol=1e-6)
    assert result.asked.width_of_cut == pytest.approx(40e-3)
    # One strip of the same width in the middle is another cut.
    middle = limits(tmp_path, 'cut = "central"\nwidth_of_cut = "40 mm"', method)
    assert np.abs(middle / expected - 1.0).max() > 0.02


def test_the_converged_limits_of_strips_are_where_the_map_over_one_period_grows():
    arcs = engagement_of_strips([(-35e-3, -15e-3), (10e-3, 30e-3)], 80e-3)
    for method in ("multi_frequency", "semi_discretization"):
        depth = 1e-3 * float(getattr(stability, method)(MODES, TOOL, arcs, STEEL, [1350.0])["limit_depth"][0])
        for share, stable in ((0.995, True), (1.005, False)):
            largest = abs(stability.floquet_multipliers(MODES, TOOL, arcs, STEEL, share * depth, 1350.0)[0])
            assert (largest < 1.0) == stable, (method, share, largest)


def test_a_mirrored_offset_is_the_mirrored_machine(tmp_path):
    """Mirrored about the feed, entry and exit change places: not the same limit, because the tool turns one way."""
    one = engagement_of_offset(30e-3, 10e-3, 80e-3)
    other = engagement_of_offset(30e-3, -10e-3, 80e-3)
    assert (one.entry, one.exit) == pytest.approx((np.pi - other.exit, np.pi - other.entry))
    assert width_of(one, 80e-3) == pytest.approx(30e-3)
    assert one.entry > np.pi / 4  # an axis on the +y side of the work cuts mostly down


def test_widths_of_an_offset_cut_are_requests_of_their_own(tmp_path):
    cut = 'cut = "offset"\nwidth_of_cut = ["20 mm", "40 mm"]\noffset = "10 mm"'
    found = lobes_of(campaign(tmp_path, cut))
    assert [r.request for r in found] == ["lobes_1_20mm", "lobes_1_40mm"]
    for r in found:
        arc = engagement_of_offset(r.asked.width_of_cut, 10e-3, 80e-3)
        assert np.radians(r.lobes.attrs["arcs_deg"]) == pytest.approx([arc.entry, arc.exit])
        expected = stability.zero_order(MODES.compliance(np.arange(60.0, 700.0, 0.5)), TOOL, arc, STEEL, [900.0])
        assert r.lobes["limit_depth"].values[0] == pytest.approx(float(expected["limit_depth"][0]), rel=1e-6)


@pytest.mark.parametrize("cut", [STRIPS, 'cut = "offset"\nwidth_of_cut = "40 mm"\noffset = "10 mm"'])
def test_band_recommendation_and_presets_know_them(tmp_path, cut):
    loaded = campaign(tmp_path, cut)
    answers = recommend(lobes_of(loaded), loaded)
    assert answers.best.status == "recommended"
    assert answers.best.width_of_cut_mm == pytest.approx(40.0)
    rate = answers.best.depth_of_cut_mm * 40.0 * answers.best.feed_mm_min / 1e3
    assert answers.best.removal_rate_cm3_min == pytest.approx(rate, rel=1e-5)
    assert answers.document()["recommendation"]["cut"] == loaded.lobes[0].cut


def test_lobes_in_memory_keep_their_engagement():
    more = {"spindle_speed": (900, 1800, 300), "maximum_depth": "20 mm"}
    found = smfe.lobes(MODES, TOOL, {"Ktc": 1.9e9, "Krc": 8e8, "Kac": 3e8}, cut="angles", entry_angle="30 deg",
                       exit_angle="100 deg", **more)  # fmt: skip
    arc = process.Engagement(np.radians(30.0), np.radians(100.0))
    expected = stability.semi_discretization(MODES, TOOL, arc, STEEL, [900.0])["limit_depth"].values
    assert found["limit_depth"].values[0] == pytest.approx(expected[0], rel=0.05)
    answer = smfe.recommendation(found, TOOL, {"Ktc": 1.9e9, "Krc": 8e8, "Kac": 3e8})
    assert answer.cut == "angles"
    assert answer.width_of_cut_mm == pytest.approx(1e3 * width_of(arc, 80e-3), rel=1e-5)


@pytest.mark.parametrize(
    ("cut", "said"),
    [
        ('cut = "offset"\nwidth_of_cut = "40 mm"', "offset: is missing"),
        ('cut = "offset"\nwidth_of_cut = "40 mm"\noffset = "30 mm"', "reaches 10 mm beyond the tool of 80 mm"),
        (
            'cut = "down"\nwidth_of_cut = "40 mm"\noffset = "5 mm"',
            'cut = "down" is said by .*width_of_cut.*; take it out',
        ),
        ('cut = "angles"\nentry_angle = "30 deg"', "exit_angle: is missing"),
        ('cut = "angles"\nentry_angle = "90 deg"\nexit_angle = "30 deg"', "0 <= entry < exit <= 180 deg is needed"),
        ('cut = "strips"\nstrips = [["50 mm", "60 mm"]]', "no strip of work lies within the path of the tool"),
        ('cut = "strips"\nstrips = [["10 mm", "5 mm"]]', "is no strip of work; the lower edge comes first"),
        ('cut = "strips"\nstrips = [["-10 mm", "5 mm"], ["0 mm", "8 mm"]]', "do not overlap"),
        ('cut = "offset"\nwidth_of_cut = "90 mm"\noffset = "0 mm"', "is wider than the tool"),
        ('cut = "down"', "width_of_cut: is missing"),
        ('cut = "face"\nwidth_of_cut = "90 mm"', "'face'"),
    ],
)
def test_what_does_not_say_an_engagement_is_refused(tmp_path, cut, said):
    with pytest.raises(InputError, match=said):
        campaign(tmp_path, cut)
