"""Claims: what is proposed next is a table that the campaign file accepts as it stands, and asks for just that."""

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

from smfe.campaign import Campaign, Measurement
from smfe.diagnosis.cases.experiments import proposed_moves
from smfe.diagnosis.consequences import with_consequences
from smfe.diagnosis.judgement.finding import Finding, Remainder
from smfe.diagnosis.story.blocks import block_of, repeated


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
        assert [t.depth_of_cut / expected for t in pair] == pytest.approx([0.97, 1.03], rel=1e-4)
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


def test_every_verdict_has_a_next_experiment(tmp_path: Path) -> None:
    """Where nothing of the catalogue explains the data, what carries the remainder is made once more."""
    given, family = campaign(tmp_path, CHANNELS, AXIS, HIT), axis()
    left = Remainder(3.0, 1e-9, 0.2, 0.4, ("hammer_500",))
    for verdict in ("consistent", "named", "ambiguous", "insufficient_data"):
        told = with_consequences(given, family, Finding(verdict, "it is"), ()).next_experiment
        assert told is not None
        assert added(appended(given, told.block)).method == "hammer"
    told = with_consequences(given, family, Finding("unknown", "it is", remainder=left), ())
    assert told.next_experiment is not None
    assert added(appended(given, told.next_experiment.block)).feed == given.measurements[0].feed
    assert "hammer 500 once more" in " ".join(told.sentences)
    assert repeated(given, "nobody") == ""
