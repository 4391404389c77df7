"""What the operator is told is the geometry that the plan computes with."""

import math

import numpy as np
import pytest

from process.cut.tool import Tool
from smfe.planning.forces import Pass, SweepPlan
from smfe.planning.operator import centre_offset, steps, strip

DIAMETER = 0.08
PASSES = [Pass(cut, width) for cut in ("down", "up", "central") for width in (0.012, 0.03, 0.04, 0.055, 0.079)]


def touched(one: Pass, face: float) -> np.ndarray:
    """Return the angles at which an edge is in the work whose face lies at x = face before the centre, brute force."""
    phi = np.linspace(0.0, math.pi, 20001)  # the front half of the tool: what is behind is cut
    x, y = 0.5 * DIAMETER * np.sin(phi), 0.5 * DIAMETER * np.cos(phi)
    low, high = strip(one, DIAMETER)
    return phi[(y > low) & (y < high) & (x > face)]


@pytest.mark.parametrize("one", PASSES, ids=lambda p: f"{p.cut} {1e3 * p.width:g}")
class TestGeometry:
    def test_the_work_is_where_the_engagement_is(self, one: Pass) -> None:
        (arc,) = one.engagement(DIAMETER).arcs
        angles = touched(one, -DIAMETER)
        assert angles.min() == pytest.approx(arc.entry, abs=1e-3)
        assert angles.max() == pytest.approx(arc.exit, abs=1e-3)

    def test_the_arc_is_full_after_the_entry_and_not_before(self, one: Pass) -> None:
        whole, entry = touched(one, -DIAMETER), one.entry_length(DIAMETER)
        # At the first touch the foremost point of the arc lies at the face.
        first = 0.5 * DIAMETER * np.sin(whole).max()
        assert touched(one, first - 1e-9).size <= 5
        assert touched(one, first - 1.001 * entry - 1e-6).size == whole.size
        if entry > 1e-4:
            assert touched(one, first - 0.97 * entry).size < whole.size


def test_the_centre_runs_outside_the_wall_by_what_is_not_cut() -> None:
    assert centre_offset(Pass("down", 0.012), DIAMETER) == pytest.approx(0.028)
    assert centre_offset(Pass("up", 0.055), DIAMETER) == pytest.approx(-0.015)
    assert centre_offset(Pass("central", 0.055), DIAMETER) == 0.0


def test_the_ramp_is_cut_at_full_width_alone() -> None:
    sweep = SweepPlan(Tool(DIAMETER, 2, math.pi / 4), (Pass("down", 0.012),), 1e-3, 1e-4, 60.0, 120.0, 30.0)
    entry = sweep.passes[0].entry_length(DIAMETER)
    begin, touch, full, ramped, leaving, left, end = steps(sweep, sweep.passes[0])
    assert (touch.position, full.position) == pytest.approx((0.0, entry))
    assert ramped.time - full.time == pytest.approx(sweep.duration)
    assert leaving.time == pytest.approx(ramped.time)
    # The foremost point of the arc, `entry` ahead of the centre, is then at the far face of the work.
    assert leaving.position == pytest.approx(sweep.stock)
    assert left.position - leaving.position == pytest.approx(entry)
    assert (begin.speed, full.speed, ramped.speed, end.speed) == (60.0, 60.0, 120.0, 120.0)
    assert end.position - begin.position == pytest.approx(sweep.travel)
    assert end.time == pytest.approx(sweep.pass_time)


def test_a_narrow_ridge_on_the_same_work_is_left_later_than_its_ramp_ends() -> None:
    passes = (Pass("down", 0.012), Pass("central", 0.03))
    sweep = SweepPlan(Tool(DIAMETER, 2, math.pi / 4), passes, 1e-3, 1e-4, 60.0, 120.0, 30.0)
    _, _, full, ramped, leaving, _, end = steps(sweep, passes[1])
    assert ramped.time - full.time == pytest.approx(sweep.duration)
    assert leaving.position == pytest.approx(sweep.stock)
    assert leaving.time > ramped.time
    assert end.time < sweep.pass_time
