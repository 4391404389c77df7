"""Unequal pitch: the formulas cancel the waves, the search does no worse, the map over one turn confirms the result."""

import math
from dataclasses import replace

import numpy as np
import pytest

from process.cut.tool import Tool
from process.errors import InputError
from stability import floquet_multipliers, limit_depth
from stability.pitch_design import alternating, cancelling_difference, design_pitch, linear

SPEED = 5000.0


@pytest.fixture(scope="module")
def bench(make_case):
    """The classical benchmark at a speed of many waves between two teeth, where lobes are narrow."""
    return make_case["benchmark"](1, 0.5)


@pytest.fixture(scope="module")
def design(bench):
    return design_pitch(bench.machine, *bench.cut, SPEED)


@pytest.mark.parametrize(
    ("pattern", "name", "teeth"), [(alternating, "alternating", 4), (linear, "linear", 3), (linear, "linear", 7)]
)
def test_the_formulas_cancel_the_waves_of_all_teeth(pattern, name, teeth):
    frequency, speed = 437.0, 1700.0
    pitch = pattern(teeth, cancelling_difference(name, teeth, frequency, speed))
    assert pitch.sum() == pytest.approx(2.0 * math.pi)
    delay = pitch / (2.0 * math.pi) * 60.0 / speed
    assert abs(np.exp(-2j * math.pi * frequency * delay).sum()) < 1e-9


def test_the_design_multiplies_the_limit_and_is_no_worse_than_the_formula(bench, design):
    assert design.pattern == "alternating"
    assert design.gain > 3.0
    assert design.gain == pytest.approx(
        design.check["limit_depth_mm"].min() / design.check["equal_limit_depth_mm"].min()
    )
    chatter = limit_depth(bench.machine, *bench.cut, SPEED).chatter_frequency_Hz
    formula = replace(
        bench.tool,
        pitch_angles=tuple(alternating(2, cancelling_difference("alternating", 2, chatter, SPEED))),
    )
    limits = [
        limit_depth(bench.machine, formula, bench.arc, bench.coefficients, float(n)).limit_depth_mm
        for n in design.check["spindle_speed_rpm"].iloc[[0, 2, 4]]
    ]
    assert design.check["limit_depth_mm"].iloc[[0, 2, 4]].min() >= 0.98 * min(limits)


def test_the_map_over_one_turn_confirms_the_limit_at_every_speed_checked(bench, design):
    cut = (design.tool, bench.arc, bench.coefficients)
    for row in design.check.itertuples():
        below, above = (
            abs(floquet_multipliers(bench.machine, *cut, share * 1e-3 * row.limit_depth_mm, row.spindle_speed_rpm)[0])
            for share in (0.99, 1.01)
        )
        assert below < 1.0 < above


def test_the_pitch_can_be_ground_and_stays_within_the_deviation(lab_slot):
    tool = Tool(50.8e-3, 3)
    found = design_pitch(
        lab_slot.machine, tool, lab_slot.arc, lab_slot.coefficients, 1500.0, largest_deviation=0.15, frequency=61.4
    )
    degrees = np.array(found.pitch_angles_deg)
    assert degrees.sum() == pytest.approx(360.0)
    np.testing.assert_allclose(degrees * 10.0, np.round(degrees * 10.0), atol=1e-6)
    assert np.abs(degrees / 120.0 - 1.0).max() <= 0.15 + 1e-3
    assert found.pattern in ("linear", "equal")
    assert found.gain >= 1.0


def test_without_room_the_teeth_stay_equally_spaced(lab_slot):
    found = design_pitch(lab_slot.machine, *lab_slot.cut, 1200.0, largest_deviation=1e-4)
    assert (found.pattern, found.gain) == ("equal", 1.0)
    assert found.tool == lab_slot.tool
    assert found.pitch_angles_deg == (90.0, 90.0, 90.0, 90.0)


def test_what_cannot_be_designed_is_refused(lab_slot):
    machine, (_, arc, coefficients) = lab_slot.machine, lab_slot.cut
    with pytest.raises(InputError, match="one tooth"):
        design_pitch(machine, Tool(0.05, 1), arc, coefficients, 1000.0)
    with pytest.raises(InputError, match="around is 0"):
        design_pitch(machine, *lab_slot.cut, 1000.0, around=0.0)
    with pytest.raises(InputError, match="speeds must be positive"):
        design_pitch(machine, *lab_slot.cut, -1.0)
