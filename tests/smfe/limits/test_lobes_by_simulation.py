"""Methods that share nothing but the force law: lobes, and the time simulation with surface memory."""

import math

import numpy as np
import pytest
from samples.linear_machine import MACHINE, MATERIAL, TOOL

from process import MillingCut, Spindle, engagement, simulate_milling
from stability import semi_discretization, zero_order

COMPLIANCE = MACHINE.compliance(np.arange(5.0, 150.0, 0.1))


def aperiodic(
    arc_width: float, rpm: float, depth_mm: float, turns: int = 200, kind: str = "down", kick: float = 1e-3
) -> tuple[float, float]:
    """What does not repeat from turn to turn [m rms]: early after a small disturbance, and at the end."""
    arc = engagement(kind, arc_width, TOOL.diameter)
    cut = MillingCut(TOOL, arc, MATERIAL, depth_mm * 1e-3, feed_per_tooth=1e-4)
    a_turn = 200
    duration = turns * 60.0 / rpm
    record = simulate_milling(
        MACHINE, cut, Spindle(rpm * math.pi / 30), duration, a_turn * rpm / 60.0, impulse=(kick, kick, kick)
    )
    r = record["displacement"].values
    change = r[:, a_turn:] - r[:, :-a_turn]
    piece = 10 * a_turn
    first, last = change[:, piece : 2 * piece], change[:, -2 * piece : -piece]
    return float(np.sqrt(np.mean(first**2))), float(np.sqrt(np.mean(last**2)))


@pytest.mark.parametrize(
    ("rpm", "below"), [(800.0, 0.9), (1150.0, 0.9), (1300.0, 0.9), (1450.0, 0.9), (700.0, 0.8), (950.0, 0.8)]
)
def test_the_simulation_is_stable_below_and_unstable_above_the_zero_order_limit(rpm: float, below: float) -> None:
    # 72 of 80 mm width. At 700 and 950 rpm the true limit lies 10 to 20 % below zero order, which leaves out the
    # harmonics of the directional factor; at the other speeds it is within 10 %.
    arc = engagement("down", 0.072, TOOL.diameter)
    limit = float(zero_order(COMPLIANCE, TOOL, arc, MATERIAL, [rpm])["limit_depth"].values[0])
    early, late = aperiodic(0.072, rpm, below * limit)
    assert late < max(0.1 * early, 1e-9), f"{below} of {limit:.3f} mm at {rpm:g} rpm: {early:.2g} to {late:.2g} m"
    early, late = aperiodic(0.072, rpm, 1.1 * limit)
    assert late > 1e-5, f"1.1 of {limit:.3f} mm at {rpm:g} rpm: {early:.2g} to {late:.2g} m"


@pytest.mark.parametrize(
    ("width", "rpm"), [(0.040, 1150.0), (0.040, 1450.0), (0.060, 700.0), (0.060, 1150.0), (0.060, 1450.0)]
)
def test_in_three_dimensions_the_simulation_loses_stability_within_one_percent_of_the_converged_limit(
    width: float, rpm: float
) -> None:
    # Central arcs, whose chip is thick from entry to exit. In down milling it thins out to nothing, every vibration
    # loses contact there, and the limit is no longer that of the linear equation.
    arc = engagement("central", width, TOOL.diameter)
    limit = float(semi_discretization(MACHINE, TOOL, arc, MATERIAL, [rpm])["limit_depth"].values[0])
    early, late = aperiodic(width, rpm, 0.99 * limit, 150, "central", 1e-2)
    assert late < 0.8 * early, f"0.99 of {limit:.3f} mm at {rpm:g} rpm: {early:.2g} to {late:.2g} m"
    early, late = aperiodic(width, rpm, 1.01 * limit, 150, "central", 1e-2)
    assert late > 1.2 * early, f"1.01 of {limit:.3f} mm at {rpm:g} rpm: {early:.2g} to {late:.2g} m"
