"""The demonstration tells its story: friction that holds an axis at rest, contradicted lobes, a sweep that is right."""

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from kept import kept
from places import CHECKOUT
from samples.demonstration import full_demo

import smfe
from process.cut.engagement import engagement
from smfe.commands.demo import (
    CUT_WIDTH,
    CUTTING_TESTS,
    DEMO_SEED,
    FRICTION,
    MACHINE,
    MATERIAL,
    MM_MIN,
    TOOL,
    campaign_text,
    records,
)
from smfe.diagnosis.story.words import percent
from smfe.reporting.figures.compared import blocks
from smfe.results import read_groups
from stability import zero_order

CONTRADICTED = [(900, 4.5), (950, 4.0), (1100, 5.0)]
"""Cuts that the machine at rest would make, and that chatter; at 720 rpm and 7 mm it is the other way round."""


# Another seed takes a minute and a half more: with the calibrations.
@pytest.fixture(scope="module", params=[DEMO_SEED, pytest.param(1, marks=pytest.mark.exam)])
def demo(request: pytest.FixtureRequest) -> Path:
    """Folder of a demonstration that has been run."""
    return kept(full_demo, request.param)


def limits(feed: float) -> np.ndarray:
    """Zero-order limit depths [mm] of the simulated machine for small vibration at a feed [mm/min]."""
    compliance = MACHINE.at({"x": feed * MM_MIN}).compliance(np.arange(5.0, 300.0, 0.5))
    arc = engagement("central", CUT_WIDTH, TOOL.diameter)
    speeds = [float(rpm) for rpm, _ in CONTRADICTED]
    return zero_order(compliance, TOOL, arc, MATERIAL, speeds)["limit_depth"].values


def test_the_guideway_promises_at_rest_more_than_twice_the_depth_that_it_gives_in_motion() -> None:
    assert (limits(0.0) > 2.0 * limits(450.0)).all()
    assert limits(250.0) == pytest.approx(limits(600.0), rel=0.1)


def test_the_campaign_says_nothing_of_friction_that_is_not_viscous() -> None:
    assert 'law = "viscous"' in campaign_text()
    assert "coulomb" not in campaign_text()
    for value in (FRICTION.coulomb, FRICTION.static):
        assert f'"{value:g} N"' not in campaign_text()


def test_the_same_seed_makes_the_same_record() -> None:
    hit = {file: make for file, make in records()}["records/hammer_x.csv"]
    one, same, other = (hit(np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert one.identical(same)
    assert not np.array_equal(one["acceleration"].values, other["acceleration"].values)


@pytest.mark.slow
def test_friction_is_named_with_its_gain_on_the_measurement_set_aside(demo: Path) -> None:
    finding = json.loads((demo / "results" / "finding.json").read_text())
    assert finding["verdict"] == "named"
    (cause,) = finding["causes"]
    assert cause["id"] == "guideway_friction"
    # What is asked of any cause: of blocks of values, the hits at rest being the only ones that show it.
    assert cause["gain_db"] > 6.0
    (apart,) = [e for e in finding["errors"] if e["tested"] == "set aside"]
    assert apart["count"] == 1
    assert 20.0 * np.log10(apart["before"] / apart["after"]) > 20.0
    assert finding["next_experiment"]["minutes"] > 0.0
    # What the data hardly know is known as well as it was declared, no worse.
    for given in finding["given"]:
        assert given["high"] - given["low"] < 4.0 * given["spread"], given["name"]


def declared(frequency: np.ndarray) -> np.ndarray:
    """Return the compliance of the tip as the campaign declares it, from the equations of its two masses [m/N]."""
    given = tomllib.loads(campaign_text())["baseline"]
    names = ("moving_mass", "tip_mass", "stiffness", "damping", "Kp", "Ti", "Kv", "delay")
    big, tip, k, d, kp, ti, kv, late = (float(given[name].split()[0]) for name in names)
    k, ti, late, sigma = 1e6 * k, 1e-3 * ti, 1e-3 * late, float(given["friction"]["sigma"].split()[0])
    s = 2j * np.pi * frequency
    servo = kp * (kv + s) * (1.0 + 1.0 / (ti * s)) * np.exp(-s * late)
    slide, between, head = big * s**2 + sigma * s + k + d * s + servo, k + d * s, tip * s**2 + k + d * s
    return slide / (slide * head - between**2)


@pytest.mark.slow
def test_the_simulation_that_is_told_of_is_the_one_that_was_declared(demo: Path) -> None:
    """Sentence, error, curve and note of the figure are of one simulation: that of the campaign, nothing refitted."""
    finding = json.loads((demo / "results" / "finding.json").read_text())
    curves = read_groups(demo / "results" / "finding.nc")["curves"]
    one = curves.sel(condition="hammer_300", entry="xx").dropna("point")
    phi = declared(one["frequency"].values)
    np.testing.assert_allclose(one["baseline"].values, phi, atol=2e-3 * np.abs(phi).max())
    by_hand = float(np.linalg.norm(phi - one["measured"].values) / np.linalg.norm(one["measured"].values))
    (apart,) = [e for e in finding["errors"] if e["tested"] == "set aside"]
    (condition,) = [c for c in finding["conditions"] if c["name"] == "hammer_300"]
    for told in (
        apart["before"],
        condition["error_before"],
        float(curves["error_baseline"].sel(condition="hammer_300")),
    ):
        assert told == pytest.approx(by_hand, rel=0.02)
    assert apart["refitted"] == pytest.approx(condition["error_refitted"])
    verdict = next(p["text"] for p in finding["passages"] if p["about"] == "verdict")
    assert f"falls from {percent(apart['before'])} % as declared to {percent(apart['after'])} %" in verdict
    assert f"the simulation is {percent(apart['refitted'])} % wrong there" in verdict
    assert any(f"error {percent(apart['before'])} % → {percent(apart['after'])} %" in b.note for b in blocks(curves))
    for name, value in finding["values_before"].items():
        near = {g["name"]: g["given"] for g in finding["given"] if g["name"] in ("moving_mass", "tip_mass")}
        assert value == near.get(name, value)


NUMBER = re.compile(r"\d+(?:\.\d+)?")


@pytest.mark.slow
@pytest.mark.parametrize("demo", [DEMO_SEED], indirect=True)
def test_the_documentation_quotes_what_the_demonstration_says(demo: Path) -> None:
    """The words of docs/diagnosis.md are those of the finding; another machine's rounding may move a number by 5 %."""
    finding = json.loads((demo / "results" / "finding.json").read_text())
    said = " ".join(p["text"] for p in finding["passages"])
    page = (CHECKOUT / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    quoted = next(b for b in page.split("\n\n") if b.startswith("> The simulation leaves out"))
    for paragraph in quoted.removeprefix("> ").split("\n>\n> "):
        words = NUMBER.sub("#", paragraph.replace("\n> ", " ")).removesuffix(" ...")
        at = NUMBER.sub("#", said).find(words)
        assert at >= 0, words
        begin = NUMBER.sub("#", said)[:at].count("#")
        numbers = [float(n) for n in NUMBER.findall(paragraph)]
        assert [float(n) for n in NUMBER.findall(said)][begin:][: len(numbers)] == pytest.approx(numbers, rel=0.05)


@pytest.mark.slow
def test_depths_before_and_after_are_given_at_the_speeds_of_the_shop(demo: Path) -> None:
    depths = json.loads((demo / "results" / "finding.json").read_text())["stable_depth"]
    given = {d["where"]: d for d in depths if d["where"].endswith(".csv")}
    for (rpm, depth), true in zip(CONTRADICTED, limits(450.0), strict=True):
        row = given[f"cut_{rpm}rpm_{depth:g}mm.csv"]
        assert row["before_mm"] > 2.0 * row["after_mm"]
        assert row["after_mm"] == pytest.approx(true, rel=0.25)  # y and z are rigid there


@pytest.mark.slow
def test_the_cutting_tests_contradict_the_machine_at_rest_and_confirm_the_sweep(demo: Path) -> None:
    table = pd.read_csv(demo / "results" / "chatter.csv", keep_default_na=False)
    assert len(table) == len(CUTTING_TESTS)
    verdict = {(int(r["spindle_speed_rpm"]), r["depth_of_cut_mm"]): r for _, r in table.iterrows()}
    for test in CONTRADICTED:
        assert verdict[test]["verdict"] == "chatter"
        assert verdict[test]["predicted_hammer"] == "stable"
    assert verdict[720, 7.0]["verdict"] == "stable"
    assert verdict[720, 7.0]["predicted_hammer"] == "chatter"
    assert list(table["predicted_sweep"]) == list(table["verdict"])
    assert list(table["predicted_hammer_moving"]) == list(table["verdict"])
    ranking = pd.read_csv(demo / "results" / "ranking.csv").query("controller == 'all'")
    assert list(ranking["method"]) == ["hammer in motion", "sweep", "hammer at rest"]
    assert list(ranking["right"]) == [6, 6, 2]
    page = (demo / "results" / "report.html").read_text(encoding="utf-8")
    assert "No difference between the methods is more than chance" in page


@pytest.mark.slow
def test_the_recommended_cut_lies_in_the_pocket_of_the_machine_in_motion(demo: Path) -> None:
    found = smfe.recommendation(demo / "results")
    assert found is not None
    assert found.status == "recommended"
    assert found.source in {"hammer_moving", "sweep"}
    assert found.spindle_speed_rpm is not None
    assert 700.0 <= found.spindle_speed_rpm <= 800.0


@pytest.mark.slow
def test_nothing_is_said_of_a_background_that_is_not_there(demo: Path) -> None:
    said = json.loads((demo / "results" / "provenance.json").read_text())["warnings"]
    assert not [w for w in said if "motion between the hits" in w]
