"""Regeneration by surface memory: one tooth, many teeth, teeth that leave the cut."""

import math

import numpy as np
import pytest

from process.cut.engagement import Engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.machine.modes import ModalModel
from process.simulation.milling import MillingCut, Spindle, simulate_milling

PURE = CuttingCoefficients(1000e6, 300e6, 0.0)
RIGID = ModalModel([900.0], [0.5], [1e13], [(1.0, 1.0, 1.0)])


@pytest.mark.parametrize("teeth", [1, 2, 3, 5])
def test_a_rigid_tool_cuts_the_feed_per_tooth_whatever_its_number_of_teeth(teeth: int) -> None:
    cut = MillingCut(Tool(0.05, teeth), Engagement(0.3, 2.8), PURE, 1e-3, feed_per_tooth=1e-4)
    record = simulate_milling(RIGID, cut, Spindle(2 * math.pi * 10.0), 1.0, 4000.0)
    assert record.attrs["largest_chip_thickness_m"] == pytest.approx(1e-4, rel=2e-3)
    assert record.attrs["lost_contact"] < 0.01


def test_a_tooth_that_is_set_back_leaves_its_chip_to_the_next() -> None:
    # Set back by more than the feed: tooth 1 never cuts, tooth 0 cuts two feeds.
    tool = Tool(0.05, 2, runout=(0.0, -3e-4))
    cut = MillingCut(tool, Engagement(1.2, 1.9), PURE, 1e-3, feed_per_tooth=1e-4)
    record = simulate_milling(RIGID, cut, Spindle(2 * math.pi * 10.0), 2.0, 4000.0)
    assert record.attrs["largest_chip_thickness_m"] == pytest.approx(2e-4, rel=2e-3)
    assert record.attrs["lost_contact"] == pytest.approx(0.5, abs=0.03)


def test_a_wave_on_the_surface_comes_back_one_tooth_period_later() -> None:
    # A soft mode hit once: while it still rings, the chip of the next tooth carries the difference r(t) - r(t - T).
    machine = ModalModel([80.0], [0.02], [5e8], [(0.0, 1.0, 0.0)])
    cut = MillingCut(
        Tool(0.05, 4), Engagement(0.0, math.pi), CuttingCoefficients(1e6, 0.0, 0.0), 1e-3, feed_per_tooth=1e-3
    )
    spindle = Spindle(2 * math.pi * 7.0)
    record = simulate_milling(machine, cut, spindle, 1.0, 20000.0, impulse=(0.0, 100.0, 0.0))
    t, y, force = (record[n] for n in ("time", "displacement", "force"))
    y, period = y.sel(axis="y").values, 1.0 / 28.0
    late = np.interp(t.values - period, t.values, y, left=0.0)
    angle = record["spindle_angle"].values[:, None] - np.arange(4) * np.pi / 2
    s, c = np.sin(angle), np.cos(angle)
    engaged = s > 0.0
    # K_r = 0: F_y = sum K_t a_p h sin(phi) with h = f_z sin(phi) + (y - y_late) cos(phi).
    expected = (1e6 * 1e-3 * (1e-3 * s + (y - late)[:, None] * c) * s * engaged).sum(axis=1)
    # Away from entry and exit, where the chip is thin and contact is lost.
    inside = (t.values > 0.1) & (t.values < 0.9) & (np.abs(np.sin(2 * record["spindle_angle"].values)) > 0.7)
    np.testing.assert_allclose(force.sel(axis="y").values[inside], expected[inside], atol=2e-3 * np.abs(expected).max())
    assert np.abs((y - late)[inside]).max() > 2e-5
