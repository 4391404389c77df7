"""Claims: what is proposed next is a table that the campaign file accepts as it stands, and asks for just that."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from samples.diagnosed import (
    AXIS,
    CHANNELS,
    CUT,
    HIT,
    MODES,
    MOVED,
    TOOL,
    appended,
    axis,
    campaign,
    forces,
    limits,
    modal,
    moved,
)

from process.drive.servo import Servo
from smfe.campaign import Campaign, Measurement
from smfe.diagnosis.cases.experiments import proposed_experiments, proposed_moves
from smfe.diagnosis.consequences import with_consequences
from smfe.diagnosis.frf.axis import MachineFrfs
from smfe.diagnosis.judgement.finding import Finding, Remainder
from smfe.diagnosis.machine.axes import DeclaredAxis, Gains
from smfe.diagnosis.machine.family import MachineOfAxes
from smfe.diagnosis.story.blocks import block_of, repeated
from smfe.diagnosis.story.experiments import instruction
from smfe.diagnosis.story.millimetres import given_values


def added(whole: Campaign) -> Measurement:
    return whole.measurements[-1]


def test_each_proposal_of_an_axis_is_the_measurement_that_it_changes(tmp_path: Path) -> None:
    given, family = campaign(tmp_path, CHANNELS, AXIS, HIT), axis()
    assert len(family.proposals) > 6
    for p in family.proposals:
        made = added(appended(given, block_of(given, family, p, {})))
        assert made.name != "hammer_500"
        assert (made.method, made.accelerometer_mass, made.started) == ("hammer", 0.03, None)
        assert (made.feed or {}).get("x", 0.0) == pytest.approx(p.settings["feed"])
        assert made.controller == p.settings["controller"]
        assert made.added_mass == (p.settings.get("added_mass") or None)
        assert float(made.position.removesuffix(" mm")) == pytest.approx(1e3 * p.settings["position"])
        assert [r.excitation for r in made.records] == ["x"]


def test_spindle_sensor_and_free_mass_are_keys_of_the_campaign(tmp_path: Path) -> None:
    given, family = campaign(tmp_path, CHANNELS, MODES, HIT), modal()
    seen = set()
    for p in family.proposals:
        made = added(appended(given, block_of(given, family, p, {})))
        assert made.sensor == p.settings.get("sensor")
        assert made.free_mass == p.settings.get("free_mass")
        assert made.spindle_speed == (None if "spindle_speed" not in p.settings else pytest.approx(300.0, rel=1e-5))
        assert made.accelerometer_mass == (None if made.sensor == "laser" else 0.03)
        seen |= {k for k in ("sensor", "free_mass", "spindle_speed") if getattr(made, k) is not None}
    assert seen == {"sensor", "free_mass", "spindle_speed"}


def test_cuts_that_are_proposed_are_cutting_tests_the_spindle_in_air_too(tmp_path: Path) -> None:
    given, family = campaign(tmp_path, CHANNELS, TOOL, '[baseline]\nforces = "mechanistic"\n', CUT), forces()
    tests = [appended(given, block_of(given, family, p, {})).cutting_tests[-1] for p in family.proposals]
    assert [t.feed_per_tooth for t in tests] == pytest.approx([2e-4, 1e-4])
    assert [t.depth_of_cut for t in tests] == pytest.approx([2e-3, 0.0])
    assert [t.spindle_speed for t in tests] == pytest.approx([3000.0] * 2)
    assert {t.observed for t in tests} == {None}


def test_a_limit_is_looked_for_on_both_sides_of_what_is_expected(tmp_path: Path) -> None:
    modes = MODES.replace('from = "maker"', 'limits = "maker"')
    given, family = campaign(tmp_path, CHANNELS, TOOL, modes, CUT), limits()
    for p in family.proposals:
        pair = appended(given, block_of(given, family, p, {})).cutting_tests[-2:]
        expected = family.depth(p, {})
        assert [t.depth_of_cut / expected for t in pair] == pytest.approx([0.97, 1.03], rel=5e-3)
        assert [t.spindle_speed for t in pair] == pytest.approx([p.settings["spindle_speed"]] * 2)


@pytest.mark.slow
def test_an_axis_that_moved_has_moves_to_do_next(tmp_path: Path) -> None:
    given, family = campaign(tmp_path, CHANNELS, '[baseline]\ndrive = "rigid"\naxis = "x"\n', MOVED), moved()
    proposals = proposed_moves(family)
    assert {"at", "with", "from"} <= {p.name.split()[1] for p in proposals}
    start = {p.name: p.start for p in (*family.nuisances, *(p for c in family.causes for p in c.parameters))}
    for p in proposals:
        plain, rough = (family.predict(p, start | {"coulomb.force": f}) for f in (0.0, 40.0))
        assert np.isfinite(rough).all()
        assert np.linalg.norm(rough - plain) > 100.0  # friction of 40 N would be seen
        made = added(appended(given, block_of(given, family, p, {})))
        assert (made.method, [len(r.files) for r in made.records]) == ("drive", [1])


LIMITS = MODES.replace('from = "maker"', 'limits = "maker"')
DRIVE = '[baseline]\ndrive = "rigid"\naxis = "x"\n'
SHAKEN = HIT.replace("hammer", "actuator").replace('controller = "K2"', 'controller = "K2"\nforce_level = "50 N"')
RIDES = """[machine.axis.x]
moving_mass = "20 kg"
controllers = { K2 = { Kp = "6000 N s/m", Ti = "11 ms", Kv = "45 1/s" } }
"""


def machine_of_axes() -> MachineOfAxes:
    """Modes that ride on an axis."""
    one = modal()
    declared = {"x": DeclaredAxis(20.0, {"K2": Gains(6000.0, 11e-3, 45.0, 0.0)})}
    return MachineOfAxes(one.model, one.conditions, one.proposals, axes=declared)


def shaken() -> MachineFrfs:
    """An axis that an actuator shakes, under two controllers."""
    family = axis()
    (c,) = family.conditions
    data = replace(c.data, method="actuator", level=50.0)
    settings = {**c.settings, "method": "actuator", "level": 50.0}
    more = {**family.baseline.servos, "K4": Servo(9000.0, 10.9e-3, 45.5)}
    baseline = replace(family.baseline, servos=more)
    own = replace(c, name="actuator_500", source="actuator_500", settings=settings, data=data)
    found = MachineFrfs(baseline, (own,))
    return replace(found, proposals=proposed_experiments(found))


CATALOGUE = {
    "axis": (axis, (AXIS, HIT)),
    "shaken axis": (shaken, (AXIS, SHAKEN)),
    "modes": (modal, (MODES, HIT)),
    "modes on axes": (machine_of_axes, (MODES, RIDES, HIT)),
    "forces": (forces, (TOOL, '[baseline]\nforces = "mechanistic"\n', CUT)),
    "limits": (limits, (TOOL, LIMITS, CUT)),
}
"""Kind of baseline -> the family with its catalogue of experiments, and a campaign of it."""


@pytest.mark.parametrize("kind", CATALOGUE)
def test_every_experiment_of_the_catalogue_is_an_instruction_and_tables_that_the_campaign_accepts(
    tmp_path: Path, kind: str
) -> None:
    make, tables = CATALOGUE[kind]
    given, family = campaign(tmp_path, CHANNELS, *tables), make()
    assert family.proposals
    said = [instruction(family, p) for p in family.proposals]
    assert len(set(said)) == len(said)
    for p, do in zip(family.proposals, said, strict=True):
        assert "{" not in do
        assert "_" not in do
        block = block_of(given, family, p, {**given_values(family)})
        assert block, p.name
        longer = appended(given, block)  # as `smfe.read_campaign` reads it
        more = len(longer.measurements) - len(given.measurements), len(longer.cutting_tests) - len(given.cutting_tests)
        assert more in ((1, 0), (0, 1), (0, 2)), p.name


@pytest.mark.parametrize("kind", CATALOGUE)
def test_every_verdict_has_a_next_experiment(tmp_path: Path, kind: str) -> None:
    """Also where the search has none to propose: what it is for fits the verdict, and its tables are accepted."""
    make, tables = CATALOGUE[kind]
    given, family = campaign(tmp_path, CHANNELS, *tables), make()
    for verdict, purpose in (
        ("consistent", "one more test of it"),
        ("named", "a test of the whole"),
        ("ambiguous", "separates them best"),
        ("unknown", "what is left depends on"),
        ("insufficient_data", "adds what is missing"),
    ):
        told = with_consequences(given, family, Finding(verdict, "it is"), ())
        n = told.next_experiment
        assert n is not None
        assert (n.do, n.block) != ("", "")
        appended(given, n.block)
        (said,) = [p.text for p in told.passages if p.about == "next"]
        assert purpose in said
        assert n.do in said


def test_what_carries_an_unknown_remainder_is_made_once_more(tmp_path: Path) -> None:
    given, family = campaign(tmp_path, CHANNELS, AXIS, HIT), axis()
    left = Remainder(3.0, 1e-9, 0.2, 0.4, ("hammer_500",))
    told = with_consequences(given, family, Finding("unknown", "it is", remainder=left), ())
    assert told.next_experiment is not None
    assert added(appended(given, told.next_experiment.block)).feed == given.measurements[0].feed
    assert "hammer 500 once more" in " ".join(told.sentences)
    assert repeated(given, "nobody") == ""
