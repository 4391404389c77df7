"""One answer: page, pockets.csv, presets.json, terminal, --json and Python say the same cut, on four campaigns."""

import json
import re
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from kept import kept
from samples.page import read

import smfe
from process.labels import make_compliance
from smfe.campaign import Campaign, Measurement, load_campaign
from smfe.cli.answer import run_outcome
from smfe.cli.terminal import Terminal
from smfe.limits.campaign_lobes import all_lobes
from smfe.limits.lobe_files import write_lobes
from smfe.progress import silent
from smfe.reporting.content.results import read_results
from smfe.reporting.page import render
from smfe.results import write_csv, write_groups, write_json

TEXT = """
[campaign]
name = "one answer"
[tool]
diameter = "16 mm"
teeth = 2
[material]
name = "aluminium"
Ktc = "600 N/mm^2"
Krc = "200 N/mm^2"
Kac = "100 N/mm^2"
[machine]
name = "VMC 3"
[[model]]
name = "machine"
modes = [
    {{ frequency = "922 Hz", damping = 0.011, stiffness = "1.34e6 N/m", direction = [1, 0, 0] }},
    {{ frequency = "990 Hz", damping = 0.013, stiffness = "1.5e6 N/m", direction = [0, 1, 0] }},
]
{model}
[[lobes]]
measurements = {sources}
method = "zero_order"
cut = "down"
width_of_cut = {width}
feed_per_tooth = "0.1 mm"
spindle_speed = {speed}
{more}
"""

EXACT = "uncertainty = { frequency = 0, damping = 0, stiffness = 0 }"
WHOLE, FLANK = '["8000 rpm", "16000 rpm", "100 rpm"]', '["11000 rpm", "12500 rpm", "50 rpm"]'


def measured(campaign: Campaign, **methods: str) -> Campaign:
    """Return a campaign whose model has become measurements."""
    names = tuple(methods)
    made = tuple(Measurement(name=n, method=m, records=(), channels={}) for n, m in methods.items())
    requests = tuple(replace(r, measurements=names) for r in campaign.lobes)
    return replace(campaign, models=(), measurements=made, lobes=requests)


def methods_beside_each_other(folder: Path) -> None:
    """Hammer and sweep with errors, the hammer too stiff; a cutting test that only the sweep foresees."""
    campaign = load(folder, speed='["8000 rpm", "16000 rpm", "250 rpm"]')
    modal, frequency = campaign.models[0].modal, np.arange(700.0, 1300.0, 5.0)
    values = modal.matrix(frequency)
    found = {}
    for name, stiffer in (("hammer", 1.5), ("sweep", 1.0)):
        std = np.full(values.shape, 0.01 * np.abs(values).max())
        extra = {"compliance_std": (("frequency", "response", "excitation"), std)}
        found[name] = make_compliance(frequency, values / stiffer, extra=extra, attrs={"method": name})
    row = {"file": "cut.csv", "spindle_speed_rpm": 9200.0, "depth_of_cut_mm": 3.0, "verdict": "chatter", "observed": ""}
    row |= {"limit_hammer_mm": 3.4, "predicted_hammer": "stable", "limit_sweep_mm": 2.3, "predicted_sweep": "chatter"}
    write(folder, measured(campaign, hammer="hammer", sweep="sweep"), found, [{**row, "lobes": "lobes_1"}])


def two_taps_without_coherence(folder: Path) -> None:
    campaign = load(folder)
    taps = campaign.models[0].modal.compliance(np.arange(400.0, 1800.0, 4.0), ["x", "y"], ["x", "y"])
    apart = taps["response"] != taps["excitation"]
    taps["compliance"] = taps["compliance"].where(~apart)
    taps["compliance"].attrs["units"] = "m/N"
    write(folder, measured(campaign, taps="frf"), {"taps": taps.assign_attrs(method="frf")})


def several_widths_up_to_a_greatest_depth(folder: Path) -> None:
    campaign = load(folder, model=EXACT, width='["8 mm", "2 mm", "4 mm"]', more='maximum_depth = "1.15 mm"')
    write(folder, campaign, models(campaign))


def nothing_but_an_edge(folder: Path) -> None:
    campaign = load(folder, model=EXACT, speed=FLANK)
    write(folder, campaign, models(campaign))


def load(folder: Path, **parts: str) -> Campaign:
    given = {"model": "", "sources": '["machine"]', "width": '"4 mm"', "speed": WHOLE, "more": "", **parts}
    (folder / "campaign.toml").write_text(TEXT.format(**given))
    return load_campaign(folder / "campaign.toml")


def models(campaign: Campaign) -> dict:
    frequency = np.arange(400.0, 1800.0, 4.0)
    return {m.name: m.modal.compliance(frequency).assign_attrs(method="model") for m in campaign.models}


def write(folder: Path, campaign: Campaign, compliances: dict, tests: list = ()) -> None:
    """Write what a run writes of lobes and cutting tests, and the page without its pictures."""
    write_lobes(folder, all_lobes(campaign, compliances, silent), campaign, tests)
    write_groups(folder / "frf.nc", compliances)
    if tests:
        write_csv(folder / "chatter.csv", pd.DataFrame(tests))
    write_json(folder / "provenance.json", {"campaign": campaign.name, "warnings": [], "failures": [], "check": []})
    (folder / "report.html").write_text(render(read_results(folder)), encoding="utf-8")


@pytest.mark.parametrize(
    ("make", "status", "said"),
    [
        (methods_beside_each_other, "recommended", "hammer is set aside: 1 cut that it calls stable chattered"),
        (two_taps_without_coherence, "limit_only", "whose uncertainty is not known"),
        (several_widths_up_to_a_greatest_depth, "recommended", "limited by the greatest depth"),
        (nothing_but_an_edge, "recommended", "is an end of the range that can be set, and no pocket lies inside"),
    ],
)
def test_all_six_places_say_the_same(make, status: str, said: str, capsys: pytest.CaptureFixture[str]) -> None:
    folder = kept(make)
    found = smfe.recommendation(folder)
    assert found is not None
    assert (found.status, said in found.reason) == (status, True), found.reason
    best = found.as_dict()
    presets = json.loads((folder / "presets.json").read_text())
    assert presets["recommendation"] == best
    assert best in presets["recommendations"]
    # --json and the terminal, as they are printed.
    Terminal(as_json=True).end(run_outcome(folder / "report.html"))
    assert json.loads(capsys.readouterr().out)["recommendation"] == best
    Terminal().end(run_outcome(folder / "report.html"))
    line = next(line for line in capsys.readouterr().out.splitlines() if "rpm" in line)
    # The page: what programs read, and what people do.
    page = (folder / "report.html").read_text(encoding="utf-8")
    tag = re.search(r'<section id="answer"[^>]*>', page)
    assert tag is not None
    attributes = {k: unescape(v) for k, v in re.findall(r'data-([\w-]+)="([^"]*)"', tag[0])}
    numbers = {k: v for k, v in best.items() if isinstance(v, float)}
    assert {k: float(attributes[k.replace("_", "-").lower()]) for k in numbers} == numbers
    text = read(page)
    assert found.reason in text
    assert found.reason in line
    # pockets.csv.
    pockets = pd.read_csv(folder / "pockets.csv")
    for key in ("spindle_speed_rpm", "width_of_cut_mm", "feed_per_tooth_mm", "limit_depth_mm", "lobes", "source"):
        value = pockets[key][0]
        assert value == best[key] if isinstance(value, str) else value == pytest.approx(best[key], rel=1e-5)
    assert f"{found.spindle_speed_rpm:g} rpm" in line
    assert f" {found.width_of_cut_mm:g} mm wide, {found.feed_mm_min:.4g} mm/min" in line
    assert f"Spindle speed {found.spindle_speed_rpm:g} rpm" in text
    if status == "recommended":
        assert pockets["recommended"].tolist() == [True] + [False] * (len(pockets) - 1)
        assert pockets["depth_of_cut_mm"][0] == found.depth_of_cut_mm
        assert f"{found.depth_of_cut_mm:g} mm deep" in line
        assert f" {found.removal_rate_cm3_min:.4g} cm³/min" in line
        assert f"Removal rate {found.removal_rate_cm3_min:.4g} cm³/min" in text
        assert f"Depth of cut {found.depth_of_cut_mm:g} mm" in text
    else:
        assert not pockets["recommended"].any()
        assert pockets[["depth_of_cut_mm", "safe_depth_mm"]].isna().all(axis=None)
        assert "data-depth-of-cut-mm" not in tag[0]
        assert "no safe depth is given" in line
        # The same digits everywhere: more than three are not known of a limit without an uncertainty.
        assert f" {found.limit_depth_mm:.3g} mm at" in line
        assert f"Limit depth {found.limit_depth_mm:.3g} mm" in text
        assert "Depth of cut" not in text.partition("Every source and pocket")[0]
