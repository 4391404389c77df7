"""Several arcs of engagement: strips of work, their order, and what takes one arc only."""

import math

import numpy as np
import pytest

from process import CuttingCoefficients, InputError, MillingCut, ModalModel, Spindle, Tool, engagement, simulate_milling
from process.cut.engagement import Engagement, Engagements, engagement_of_strips
from process.cut.force import gram_matrix


def test_a_strip_at_the_edge_is_up_or_down_milling():
    for cut, strip in (("up", (20e-3, 40e-3)), ("down", (-40e-3, -20e-3)), ("central", (-10e-3, 10e-3))):
        expected, found = engagement(cut, 20e-3, 80e-3), engagement_of_strips([strip], 80e-3)
        assert (found.entry, found.exit) == pytest.approx((expected.entry, expected.exit), abs=1e-12)


def test_the_work_without_a_slot_is_the_work_on_both_sides_of_it():
    whole = engagement("central", 60e-3, 80e-3)
    sides = engagement_of_strips([(10e-3, 30e-3), (-30e-3, -10e-3)], 80e-3)
    slot = engagement("central", 20e-3, 80e-3)
    assert len(sides.arcs) == 2
    assert sides.arc == pytest.approx(whole.arc - slot.arc)
    for order in (0, 3):
        left = gram_matrix(whole, order) - gram_matrix(slot, order)
        np.testing.assert_allclose(gram_matrix(sides, order), left, atol=1e-14)


def test_stock_beside_the_tool_is_left_out():
    one = engagement_of_strips([(-100e-3, 100e-3), (200e-3, 300e-3)], 80e-3)
    assert (one.entry, one.exit) == pytest.approx((0.0, math.pi))


def test_what_is_no_engagement_is_refused():
    with pytest.raises(InputError, match="lower edge comes first"):
        engagement_of_strips([(1e-3, -1e-3)], 80e-3)
    with pytest.raises(InputError, match="no strip of work lies within"):
        engagement_of_strips([(50e-3, 60e-3)], 80e-3)
    with pytest.raises(InputError, match=r"begins at 57\.2958 deg, before the one ahead of it"):
        Engagements((Engagement(0.5, 1.5), Engagement(1.0, 2.0)))
    with pytest.raises(InputError, match="no arc of engagement"):
        Engagements(())


def test_a_simulation_takes_one_arc():
    walls = engagement_of_strips([(-40e-3, -32e-3), (32e-3, 40e-3)], 80e-3)
    cut = MillingCut(Tool(80e-3, 2), walls, CuttingCoefficients(1e9, 3e8, 0.0), 1e-3, feed_per_tooth=1e-4)  # type: ignore[arg-type]
    machine = ModalModel([50.0], [0.02], [1e7], [[1.0, 0.0, 0.0]])
    with pytest.raises(InputError, match="2 arcs of engagement; one is needed"):
        simulate_milling(machine, cut, Spindle(50.0), 0.5, 1000.0)


def test_arcs_given_as_a_list_or_as_arrays_are_those_of_plain_numbers():
    plain = Engagements((Engagement(0.1, 0.5), Engagement(1.0, 1.5)))
    other = Engagements([Engagement(np.array(0.1), np.float64(0.5)), Engagement(np.array(1.0), 1.5)])
    assert other == plain
    assert hash(other) == hash(plain)
    np.testing.assert_array_equal(gram_matrix(other, 1), gram_matrix(plain, 1))
