"""The periodic vibration of a cut: against its harmonics, a long simulation, and the error of the wall."""

import math
from dataclasses import replace

import numpy as np
import pytest

from process import InputError, MillingCut, Spindle, simulate_milling
from process.cut.force import force_harmonics, force_projection, gram_matrix
from stability.methods.semi_discretization import floquet_multipliers
from stability.methods.stationary_vibration import stationary_vibration

FEED = 1e-4


def with_edges(case):
    return replace(case.coefficients, Kte=6e4, Kre=1e5, Kae=-3e3)


def harmonics(case, coefficients, depth, rpm, angle):
    """Displacement [m] at angles of tooth 0 as a sum over 400 harmonics of the static force, equal pitch."""
    tool, arc, order = case.tool, case.arc, np.arange(1, 401)
    force = force_harmonics(tool, arc, coefficients, depth, FEED, order)
    moved = np.einsum("hij,hj->hi", case.machine.matrix(order * tool.teeth * rpm / 60.0), force)
    gram, k = gram_matrix(arc), tool.approach_angle
    mean = FEED * force_projection(coefficients.cutting, k) @ gram[:, 0]
    mean = mean + force_projection(coefficients.edge, k) @ gram[:, 2] / math.sin(k)
    static = case.machine.matrix([0.0])[0] @ mean * depth * tool.teeth / (2.0 * math.pi)
    waves = np.exp(1j * np.outer(order, tool.teeth * angle))
    return static.real[:, None] + (moved.T @ waves).real


@pytest.mark.parametrize(
    ("name", "cut", "width", "rpm", "depth"),
    [
        ("authors", "down", 40e-3, 900, 1e-3),
        ("authors", "up", 60e-3, 1500, 1e-3),
        ("ram", "central", 110e-3, 500, 1e-3),
    ],
)
def test_equal_pitch_is_the_machine_under_the_harmonics_of_the_static_force(make_case, name, cut, width, rpm, depth):
    case = make_case[name](cut, width)
    edges = with_edges(case)
    found = stationary_vibration(case.machine, case.tool, case.arc, edges, depth, FEED, rpm)
    expected = harmonics(case, edges, depth, rpm, found.angle)
    np.testing.assert_allclose(found.displacement, expected, atol=1e-6 * np.abs(expected).max())
    turn = harmonics(case, edges, depth, rpm, np.linspace(0.0, 2.0 * math.pi / case.tool.teeth, 3000))
    for axis, peak in zip("xyz", np.ptp(turn, axis=1), strict=True):
        assert found.amplitude_um[axis] == pytest.approx(0.5e6 * peak, rel=5e-3)
    for side, angle, sign in (("up", 0.0, 1.0), ("down", math.pi, -1.0)):
        if side in found.surface_location_error_um:
            wall = sign * harmonics(case, edges, depth, rpm, np.array([angle]))[1, 0]
            np.testing.assert_allclose(found.surface_location_error_um[side], 1e6 * wall, rtol=1e-4)


def test_unequal_pitch_is_where_a_long_simulation_ends(make_case):
    case = make_case["authors"]("central", 50e-3)
    tool = replace(case.tool, pitch_angles=(math.radians(160), math.radians(200)))
    rpm, depth, turns, a_turn = 900.0, 2e-3, 250, 720
    found = stationary_vibration(case.machine, tool, case.arc, case.coefficients, depth, FEED, rpm)
    assert found.multiplier < 0.9
    cut = MillingCut(tool, case.arc, case.coefficients, depth, feed_per_tooth=FEED)
    record = simulate_milling(case.machine, cut, Spindle(rpm * math.pi / 30), turns * 60.0 / rpm, a_turn * rpm / 60.0)
    last = record["displacement"].values[:, -a_turn:]
    time = record["time"].values[-a_turn:]
    at = (time * rpm / 60.0 * 2.0 * math.pi) % (2.0 * math.pi)
    order = np.argsort(at)
    for axis in range(3):
        simulated = np.interp(found.angle % (2.0 * math.pi), at[order], last[axis][order], period=2.0 * math.pi)
        np.testing.assert_allclose(found.displacement[axis], simulated, atol=5e-3 * np.abs(last).max())
    alone = stationary_vibration(case.machine, tool, case.arc, case.coefficients, 1e-9, FEED, rpm)
    scaled = alone.displacement * depth / 1e-9
    assert np.abs(found.displacement[:, : scaled.shape[1]] - scaled).max() > 0.02 * np.abs(last).max()


def test_a_slow_cut_that_ends_at_the_wall_leaves_it_in_place(make_case):
    # Far below the mode the tool is a spring: the wall is off by the static deflection at the passing of the tooth.
    case = make_case["benchmark"](2, 0.2)
    cut = (case.tool, case.arc, case.coefficients, 1e-5, FEED)
    slow = stationary_vibration(case.machine, *cut, 300.0)
    # At the exit of down milling the chip has thinned to nothing, and with it the force.
    assert abs(slow.surface_location_error_um["down"][0]) < 0.05 * slow.amplitude_um["y"]


def test_the_multiplier_is_that_of_the_semi_discretisation(make_case):
    case = make_case["authors"]("up", 40e-3)
    found = stationary_vibration(case.machine, *case.cut, 3e-3, FEED, 950)
    expected = floquet_multipliers(case.machine, *case.cut, 3e-3, 950)[0]
    assert found.multiplier == pytest.approx(abs(expected), rel=1e-6)
    assert found.error <= 1e-4


def test_what_is_refused(make_case):
    case = make_case["authors"]()
    rest = (case.arc, case.coefficients)
    with pytest.raises(InputError, match="depth is 0 mm"):
        stationary_vibration(case.machine, case.tool, *rest, 0.0, FEED, 900)
    with pytest.raises(InputError, match="feed per tooth is -1 mm"):
        stationary_vibration(case.machine, case.tool, *rest, 1e-3, -1e-3, 900)
    with pytest.raises(InputError, match="run-out"):
        stationary_vibration(case.machine, replace(case.tool, runout=(1e-5, -1e-5)), *rest, 1e-3, FEED, 900)
    with pytest.raises(InputError, match="does not settle with"):
        stationary_vibration(case.machine, case.tool, *rest, 1e-3, FEED, 0.5)
