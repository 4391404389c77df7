"""What a difference costs in depth: looked for wherever, whenever and however hard shaken the machine was measured."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from exam.modal import PASS, draw
from samples import diagnosed as samples
from truth.modal_machine import Setting

from process.cut.force import NO_DAMPING, CuttingCoefficients, ProcessDamping
from process.cut.tool import Tool
from smfe.diagnosis.frf.modes import ModalFrfs, Standing
from smfe.diagnosis.story.millimetres import cost_of, depths_of, given_values, pockets, stable_depths, stands_of


@pytest.fixture(scope="module")
def machine() -> ModalFrfs:
    """Five places, the last at the end of the session, and one hard shake."""
    found, _ = draw(None, 1, lambda rng: (*PASS, Setting(level=200.0)))
    return found


@pytest.fixture(scope="module")
def campaign() -> Any:
    speeds = np.linspace(300.0, 900.0, 5)
    lobes = dict(name="lobes", cut="down", width_of_cut=0.04, feed_per_tooth=1e-4, spindle_speed=speeds)
    cut = SimpleNamespace(
        **lobes, measurements=(), controller=None, process_damping=NO_DAMPING, maximum_depth=None, engaged=None
    )
    steel = CuttingCoefficients(2e9, 8e8, 3e8)
    return SimpleNamespace(lobes=[cut], cutting_tests=[], tool=Tool(0.08, 4), coefficients=steel)


def test_a_machine_may_cut_as_it_was_measured(machine: ModalFrfs) -> None:
    assert machine.standings == (Standing(), Standing(position=1.0), Standing(order=1.0), Standing(hardest=True))


def test_a_stiffness_that_is_the_first_at_the_first_place_costs_what_it_costs_at_the_last(
    machine: ModalFrfs, campaign: Any
) -> None:
    cost, given = cost_of(campaign, machine), given_values(machine)
    along, late = (cost(given, {**given, name: -0.3}) for name in ("posture_11", "drift_11"))
    assert along is not None
    assert along > 0.005
    assert along == pytest.approx(late, rel=1e-9)  # the same springs, at the end of the stroke or of the session
    assert cost(given, given) == 0.0


def test_a_joint_that_slips_costs_more_the_harder_it_is_shaken(machine: ModalFrfs, campaign: Any) -> None:
    cost, given = cost_of(campaign, machine), given_values(machine)
    slips = {**given, "joint_micro_slip": 0.1}
    f = machine.fine_frequency()
    soft, hard = (machine.in_the_cut(slips, 600.0, f, standing=Standing(hardest=h)) for h in (False, True))
    assert np.abs(hard).max() < np.abs(soft).max()  # what slips loses energy
    assert (cost(given, slips) or 0.0) > 0.0


def test_what_sensors_show_wrongly_costs_the_depth_of_the_lobes_that_it_gives(
    machine: ModalFrfs, campaign: Any
) -> None:
    """Of the machine itself it costs nothing.

    A tenth less force makes every depth a tenth less; a sensor turned by six degrees mixes x and y.
    """
    given = given_values(machine)
    itself, shown = (cost_of(campaign, machine, as_shown=s) for s in (False, True))
    for fault in ({"gain_force": -0.1}, {"turned_z": 0.1}):
        assert itself(given, {**given, **fault}) == 0.0
    assert shown(given, {**given, "gain_force": -0.1}) == pytest.approx(0.1, rel=1e-6)
    turned = shown(given, {**given, "turned_z": 0.1})
    assert turned is not None
    assert turned > 0.02


def test_the_flank_that_lobes_are_asked_with_counts(machine: ModalFrfs, campaign: Any) -> None:
    given = given_values(machine)
    found = {**given, "posture_11": -0.3}
    worn = SimpleNamespace(**vars(campaign.lobes[0]) | {"process_damping": ProcessDamping(1e6)})
    sharp, dull = (
        cost_of(SimpleNamespace(**vars(campaign) | {"lobes": [cut]}), machine)(given, found)
        for cut in (campaign.lobes[0], worn)
    )
    assert sharp is not None
    assert dull is not None
    assert abs(dull / sharp - 1.0) > 0.02


@pytest.mark.parametrize(
    ("name", "where"), [("posture_11", "at 1000 mm of the stroke"), ("drift_11", "at the end of the session")]
)
def test_a_depth_is_given_wherever_and_whenever_it_is_another(
    machine: ModalFrfs, campaign: Any, name: str, where: str
) -> None:
    """Where nothing depends on it one row a speed is enough; a pocket is the one that holds everywhere."""
    depths, _ = depths_of(campaign, machine)
    assert depths is not None
    given = given_values(machine)
    rows = stable_depths(campaign, depths, {**given, name: -0.3}, given, stands=stands_of(machine))
    own = {at: [r for r in rows if r.at == at] for at in dict.fromkeys(r.at for r in rows)}
    first = "at 0 mm of the stroke" if name.startswith("posture") else "at the beginning of the session"
    assert set(own) == {first, where}
    assert [r.before_mm for r in own[first]] == pytest.approx([r.after_mm for r in own[first]], rel=1e-9)
    change = [r.after_mm / r.before_mm - 1.0 for r in own[where]]
    assert max(map(abs, change)) > 0.005
    assert len({r.at for r in stable_depths(campaign, depths, given, given, stands=stands_of(machine))}) == 1
    (pocket,) = pockets(campaign, rows)
    everywhere = {
        n: min(r.after_mm for r in rows if r.spindle_speed_rpm == n) for n in (300.0, 450.0, 600.0, 750.0, 900.0)
    }
    beside = [d for n, d in everywhere.items() if abs(n - pocket.after_rpm) <= 150.0]
    assert pocket.after_mm == pytest.approx(min(beside), rel=1e-12)


def test_an_axis_that_is_softer_further_along_cuts_less_there_and_it_costs(tmp_path: Path) -> None:
    lobes = """[[lobes]]
measurements = ["hammer_500"]
method = "zero_order"
cut = "down"
width_of_cut = "12.5 mm"
feed_per_tooth = "0.1 mm"
spindle_speed = ["600 rpm", "1400 rpm", "400 rpm"]
"""
    given, family = (
        samples.campaign(tmp_path, samples.CHANNELS, samples.TOOL, samples.AXIS, samples.HIT, lobes),
        samples.axis(),
    )
    far = replace(family.conditions[0], name="far", settings={**family.conditions[0].settings, "position": 0.5})
    family = replace(family, conditions=(*family.conditions, far))
    start = given_values(family)
    depths, why = depths_of(given, family)
    assert (depths is not None, why) == (True, "")
    assert depths is not None
    # Half as stiff at 500 mm; at 100 mm, where it was first measured, nine tenths.
    softer = {**start, "stiffness_per_metre": -1.0}
    rows = stable_depths(given, depths, softer, start, stands=stands_of(family))
    near, away = ([r for r in rows if r.at == f"at {mm} mm of the stroke"] for mm in (100, 500))
    assert len(near) == len(away) == 3
    assert min(r.after_mm for r in away) < 0.8 * min(r.after_mm for r in near)
    assert {r.before_mm for r in away} == {r.before_mm for r in near}
    cost = cost_of(given, family)
    assert (cost(start, softer) or 0.0) > 0.2
