"""What a difference costs in depth: looked for wherever, whenever and however hard shaken the machine was measured."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from exam.modal import PASS, draw
from truth.modal_machine import Setting

from process.cut.force import NO_DAMPING, CuttingCoefficients, ProcessDamping
from process.cut.tool import Tool
from smfe.diagnosis.frf.modes import ModalFrfs, Standing
from smfe.diagnosis.story.millimetres import cost_of, given_values


@pytest.fixture(scope="module")
def machine() -> ModalFrfs:
    """Five places, the last at the end of the session, and one hard shake."""
    found, _ = draw(None, 1, lambda rng: (*PASS, Setting(level=200.0)))
    return found


@pytest.fixture(scope="module")
def campaign() -> Any:
    speeds = np.linspace(300.0, 900.0, 5)
    lobes = dict(name="lobes", cut="down", width_of_cut=0.04, feed_per_tooth=1e-4, spindle_speed=speeds)
    cut = SimpleNamespace(**lobes, measurements=(), controller=None, process_damping=NO_DAMPING)
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
