"""The scan over the frequency: process damping in closed form, and the lobes without it."""

import math

import numpy as np
import pytest

from process import CuttingCoefficients, Engagement, ModalModel, ProcessDamping, Tool, engagement
from stability import zero_order
from stability.methods.zero_order_scan import loop_of, modal_crossings

SHARP = ProcessDamping(0.0)
RAM = ModalModel(
    [62.0, 85.0, 140.0], [0.03, 0.04, 0.03], [2e7, 3e7, 6e7], [[1.0, 0.2, 0.1], [-0.3, 1.0, 0.0], [0.1, 0.1, 1.0]]
)
STEEL = CuttingCoefficients(1.8e9, 0.7e9, 0.25e9)
SPEEDS = [300.0, 500.0, 700.0, 1100.0, 1700.0, 2600.0]
ONE_MODE, FOUR_TEETH, SLOT = ModalModel([60.0], [0.03], [2e7], [[1.0, 0.0, 0.0]]), Tool(0.05, 4), Engagement(0, math.pi)


@pytest.mark.parametrize("approach", [math.pi / 2.0, math.pi / 4.0])
@pytest.mark.parametrize("teeth", [2, 4, 8])
def test_without_damping_the_scan_finds_the_zero_order_limit(approach: float, teeth: int) -> None:
    # A second method: lobes explicit in the phase there, a scan of the frequency here.
    tool, down = Tool(0.05, teeth, approach_angle=approach), engagement("down", 0.025, 0.05)
    lobes = zero_order(RAM, tool, down, STEEL, SPEEDS)
    for n, depth, frequency in zip(SPEEDS, lobes["limit_depth"].values, lobes["chatter_frequency"].values, strict=True):
        found = modal_crossings(RAM, loop_of(tool, down, STEEL, n, SHARP))
        assert found[0][0] * 1e3 == pytest.approx(depth, rel=2e-6)
        assert found[1][0] == pytest.approx(frequency, rel=2e-6)
        assert np.all(np.diff(found[0]) >= 0.0)


@pytest.mark.parametrize("compliance", [RAM, RAM.compliance(np.arange(5.0, 400.0, 0.25))], ids=["modal", "measured"])
@pytest.mark.parametrize("pitch", [None, np.radians([80.0, 100.0, 80.0, 100.0])], ids=["equal", "unequal"])
def test_a_flank_hardly_worn_leaves_the_limit_of_a_sharp_edge(compliance, pitch) -> None:  # type: ignore[no-untyped-def]
    cut = Tool(0.05, 4, pitch_angles=pitch), engagement("down", 0.025, 0.05), STEEL
    sharp = zero_order(compliance, *cut, SPEEDS)
    worn = zero_order(compliance, *cut, SPEEDS, ProcessDamping(1e-3))
    for name in ("limit_depth", "chatter_frequency", "lobe"):
        np.testing.assert_allclose(worn[name], sharp[name], rtol=2e-4)
    np.testing.assert_allclose(worn["vibration"], sharp["vibration"], atol=1e-3)


def test_one_mode_with_a_flank_in_closed_form() -> None:
    # Slot of four teeth, one mode along x: 1/(a Phi) = -K_rc (1 - exp(-j w T)) - j w C/v.
    speed, flank = 400.0, ProcessDamping(4e5, 0.0)
    measured = ONE_MODE.compliance(np.arange(2.0, 300.0, 0.5))
    scanned = [v[0] for v in modal_crossings(ONE_MODE, loop_of(FOUR_TEETH, SLOT, STEEL, speed, flank))]
    limits = [zero_order(c, FOUR_TEETH, SLOT, STEEL, speed, flank) for c in (ONE_MODE, measured)]
    found = [(float(v["limit_depth"][0]) * 1e-3, float(v["chatter_frequency"][0])) for v in limits]
    for (depth, frequency), tolerance in zip([scanned, *found], [1e-6, 1e-4, 1e-4], strict=True):
        w, cutting = 2.0 * math.pi * frequency, math.pi * 0.05 * speed / 60.0
        ratio = frequency / 60.0
        dynamic = 2e7 * (1.0 - ratio**2 + 0.06j * ratio)
        force = -STEEL.Krc * (1.0 - np.exp(-1j * w * 60.0 / (4.0 * speed))) - 1j * w * flank.coefficient / cutting
        assert abs(depth * force / dynamic - 1.0) < tolerance


def test_the_flank_raises_the_limit_by_one_over_the_speed() -> None:
    sharp, frequency = (v[0] for v in modal_crossings(ONE_MODE, loop_of(FOUR_TEETH, SLOT, STEEL, 1236.0, SHARP)))
    gains, periods = [], []
    for waves in (0, 2, 5):
        # The valley of a lobe; whole waves more between two teeth: the same limit at another cutting speed.
        period = 60.0 / (4.0 * 1236.0) + waves / frequency
        speed = 60.0 / (4.0 * period)
        undamped = modal_crossings(ONE_MODE, loop_of(FOUR_TEETH, SLOT, STEEL, speed, SHARP))
        assert undamped[0][0] == pytest.approx(sharp, rel=1e-6)
        dull = zero_order(ONE_MODE, FOUR_TEETH, SLOT, STEEL, speed, ProcessDamping(2e3))
        assert int(dull["lobe"][0]) == waves
        gains.append(float(dull["limit_depth"][0]) * 1e-3 / sharp - 1.0)
        periods.append(period)
    assert min(gains) > 0.0
    np.testing.assert_allclose(np.array(gains) / gains[0], np.array(periods) / periods[0], rtol=0.02)


def test_a_gap_of_the_data_holds_no_crossing() -> None:
    frequency = np.arange(2.0, 300.0, 0.5)
    flank = ProcessDamping(2e3)
    whole = zero_order(ONE_MODE.compliance(frequency), FOUR_TEETH, SLOT, STEEL, SPEEDS, flank)
    at = float(whole["chatter_frequency"][2])
    part = ONE_MODE.compliance(frequency[np.abs(frequency - at) > 3.0])
    found = zero_order(part, FOUR_TEETH, SLOT, STEEL, SPEEDS, flank)
    assert np.all(np.abs(found["chatter_frequency"] - at) >= 2.5)
    assert float(found["limit_depth"][2]) > float(whole["limit_depth"][2])


def test_limits_of_a_machine_that_gives_way_along_one_axis_alone_are_those_of_the_closed_form() -> None:
    """With one direction ``1/a = mu (1 - exp(-i w T))``, mu proportional to the compliance: the ratio is one number.

    The inclined edge cuts in all three directions, so that two of three eigenvalues vanish: deflated with a row of
    rounding, the third was counted twice, and limits were up to 11 % too small at four of ten speeds.
    """
    modes = ModalModel(
        np.array([38.0, 92.0]), np.array([0.08, 0.06]), np.array([1.6e7, 6e7]), np.eye(1, 3).repeat(2, 0)
    )
    tool, arc = Tool(0.08, 3, approach_angle=np.pi / 4), engagement("central", 0.07, 0.08)
    speeds = np.arange(600.0, 1500.0, 25.0)
    found = zero_order(modes, tool, arc, CuttingCoefficients(1.889e9, 8.06e8, 2.91e8), speeds)["limit_depth"].values
    f = np.arange(20.0, 130.0, 1e-3)
    phi, closed = modes.matrix(f)[:, 0, 0], []
    for period in 20.0 / speeds:
        loop = phi * (1.0 - np.exp(-2j * np.pi * f * period))
        at = np.flatnonzero((np.diff(np.sign(loop.imag)) != 0.0) & (loop.real[:-1] < 0.0))
        at = at[np.abs(np.diff(loop.imag)[at]) < np.abs(loop[at])]
        closed.append(np.min(-1.0 / loop.real[at]))
    ratio = found / np.array(closed)
    np.testing.assert_allclose(ratio, np.median(ratio), rtol=2e-3)
