"""Zero order for any cut: several arcs, unequal pitch, a machine given as modes, the mode of vibration, bad data."""

import math
from dataclasses import replace

import numpy as np
import pytest

from process import CuttingCoefficients, InputError, ModalModel, Tool, engagement
from process.cut.engagement import Engagement, Engagements, engagement_of_strips
from process.labels import make_compliance
from stability import critical_depth, multi_frequency, semi_discretization, zero_order
from stability.problem import Cut

SPEEDS = np.linspace(400.0, 2500.0, 60)


def degrees(*values):
    return tuple(math.radians(v) for v in values)


# --- several arcs ----------------------------------------------------------------------------------------------------


def test_an_arc_in_two_parts_is_one_arc(make_case):
    case = make_case["authors"]("down", 72e-3)
    middle = 0.5 * (case.arc.entry + case.arc.exit)
    parts = Engagements((Engagement(case.arc.entry, middle), Engagement(middle, case.arc.exit)))
    for method in (zero_order, semi_discretization, multi_frequency):
        whole = method(case.machine, *case.cut, [700.0, 1150.0])
        split = method(case.machine, case.tool, parts, case.coefficients, [700.0, 1150.0])
        np.testing.assert_allclose(
            split.limit_depth, whole.limit_depth, rtol=2e-3 if method is multi_frequency else 1e-5
        )


def test_two_walls_by_two_methods(make_case):
    # A slot between two walls of 8 mm each: the tool cuts at both edges of its path and not between.
    case = make_case["authors"]()
    walls = engagement_of_strips([(-40e-3, -32e-3), (32e-3, 40e-3)], 80e-3)
    cut = (case.tool, walls, case.coefficients)
    converged = semi_discretization(case.machine, *cut, [700.0, 950.0, 1450.0])
    lines = multi_frequency(case.machine, *cut, [700.0, 950.0, 1450.0])
    np.testing.assert_allclose(lines.limit_depth, converged.limit_depth, rtol=3e-3)
    both = Cut(*cut).directional_matrix()
    one, other = (Cut(case.tool, part, case.coefficients).directional_matrix() for part in walls.arcs)
    np.testing.assert_allclose(both, one + other, rtol=1e-12)


def test_many_teeth_in_two_arcs_make_zero_order_exact():
    # With many teeth the directional factor hardly varies, whatever the arcs.
    machine = ModalModel([50.0], [0.03], [2e7], [[0.8, 0.6, 0.0]])
    walls = engagement_of_strips([(-30e-3, -5e-3), (10e-3, 28e-3)], 60e-3)
    cut = (Tool(60e-3, 12), walls, CuttingCoefficients(8e8, 3e8, 0.0))
    mean = zero_order(machine, *cut, [200.0, 250.0])
    converged = semi_discretization(machine, *cut, [200.0, 250.0])
    np.testing.assert_allclose(mean.limit_depth, converged.limit_depth, rtol=0.05)


# --- unequal pitch ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pitch", "expected"),
    [  # Reference: averaged equation
        ((90, 90, 90, 90), {1000: 0.247, 1200: 0.117, 1500: 0.160, 2000: 0.758}),
        ((80, 100, 80, 100), {1000: 0.338, 1200: 0.137, 1500: 0.177, 2000: 0.793}),
        ((70, 85, 95, 110), {1000: 0.57, 1200: 0.165, 1500: 0.198, 2000: 0.835}),
    ],
)
def test_unequal_pitch_of_the_averaged_equation(lab_slot, pitch, expected):
    tool = replace(lab_slot.tool, pitch_angles=degrees(*pitch))
    found = zero_order(lab_slot.machine, tool, lab_slot.arc, lab_slot.coefficients, list(expected))
    np.testing.assert_allclose(found.limit_depth, list(expected.values()), atol=2e-3)
    assert any("losses of stability that are none" in w for w in found.attrs["warnings"]) == (len(set(pitch)) > 1)


def test_the_scan_over_frequency_meets_the_explicit_lobes(make_case):
    for case in (make_case["authors"](), make_case["ram"]("central", 110e-3)):
        n = case.tool.teeth
        nearly = np.full(n, 2.0 * math.pi / n) + 1e-8 * np.where(np.arange(n) % 2, 1.0, -1.0)
        tool = replace(case.tool, pitch_angles=tuple(nearly))
        scanned = zero_order(case.machine, tool, case.arc, case.coefficients, SPEEDS)
        explicit = zero_order(case.machine, *case.cut, SPEEDS)
        np.testing.assert_allclose(scanned.limit_depth, explicit.limit_depth, rtol=1e-9)
        np.testing.assert_allclose(scanned.chatter_frequency, explicit.chatter_frequency, rtol=1e-7)
        np.testing.assert_array_equal(scanned.lobe, explicit.lobe)
        np.testing.assert_allclose(np.abs(scanned.vibration), np.abs(explicit.vibration), atol=1e-5)


def test_unequal_pitch_against_the_characteristic_equation(make_case):
    # det(1 - a S(w) A0 Phi) = 0 with an eigenvalue on a fine grid, without branches or interpolation.
    case = make_case["authors"]("down", 72e-3)
    tool = replace(case.tool, pitch_angles=degrees(160, 200))
    frequency = np.arange(2.0, 300.0, 0.005)
    mu = np.linalg.eigvals(Cut(*case.cut).directional_matrix() @ case.machine.matrix(frequency))
    for rpm in (500.0, 900.0, 1700.0):
        delay = np.array([160.0, 200.0]) / 360.0 * 60.0 / rpm
        value = (1.0 - np.exp(-2j * np.pi * frequency[:, None] * delay)).mean(axis=1)[:, None] * mu
        near = (value.real > 0.0) & (np.abs(value.imag) < 2e-3 * np.abs(value))
        found = zero_order(case.machine, tool, case.arc, case.coefficients, [rpm])
        assert float(found.limit_depth[0]) == pytest.approx(1e3 / value.real[near].max(), rel=5e-3)


# --- a machine instead of samples, and how it vibrates ---------------------------------------------------------------


@pytest.mark.parametrize(("name", "speeds"), [("authors", SPEEDS), ("ram", np.linspace(250.0, 900.0, 60))])
def test_a_machine_gives_the_limits_of_its_compliance(make_case, name, speeds):
    case = make_case[name]()
    exact = zero_order(case.machine, *case.cut, speeds)
    sampled = zero_order(case.compliance(1, 400, 0.02), *case.cut, speeds)
    np.testing.assert_allclose(exact.limit_depth, sampled.limit_depth, rtol=1e-5)
    np.testing.assert_allclose(exact.vibration, sampled.vibration, atol=1e-4)
    assert exact.attrs["warnings"] == []


def test_a_limit_at_a_fortieth_of_the_mode(lab_slot):
    # 61 Hz at 24 rpm of four teeth: lobes 36 to 40 touch the smallest limit of all speeds, and it does not fall below.
    found = zero_order(lab_slot.machine, *lab_slot.cut, np.linspace(23.0, 25.0, 2001))
    lowest = {int(k): float(found.limit_depth[found.lobe == k].min()) for k in set(found.lobe.values)}
    assert set(lowest) <= set(range(35, 42))
    assert min(lowest.values()) == pytest.approx(0.11561, rel=1e-4)
    assert sum(depth < 0.1157 for depth in lowest.values()) >= 2


def test_the_vibration_solves_the_equation_at_the_limit(make_case):
    case = make_case["ram"]("central", 110e-3)
    found = zero_order(case.machine, *case.cut, np.linspace(250.0, 900.0, 40))
    a0, teeth = Cut(*case.cut).directional_matrix(), case.tool.teeth
    for i, rpm in enumerate(found.spindle_speed.values):
        f, depth = float(found.chatter_frequency[i]), 1e-3 * float(found.limit_depth[i])
        wave = 1.0 - np.exp(-2j * np.pi * f * 60.0 / (teeth * rpm))
        r = found.vibration.values[i]
        loop = depth * wave * case.machine.matrix([f])[0] @ a0
        assert np.linalg.norm(loop @ r - r) < 1e-5
        assert np.linalg.norm(r) == pytest.approx(1.0)
        assert r[np.abs(r).argmax()].imag == pytest.approx(0.0, abs=1e-12)


def test_the_mode_is_named_and_moves_along_its_vector():
    direction = [[0.8, 0.6, 0.0], [0.0, 0.6, 0.8]]
    machine = ModalModel([300.0, 40.0], [0.02, 0.02], [2e7, 2e7], direction)
    tool, coefficients = Tool(60e-3, 3, math.radians(45)), CuttingCoefficients(1e9, 4e8, 2e8)
    found = zero_order(machine, tool, engagement("up", 40e-3, 60e-3), coefficients, np.linspace(200.0, 6000.0, 200))
    modes = found["mode"].values
    assert set(modes) == {1, 2}
    close = np.where(
        modes == 1, np.abs(found.chatter_frequency - 40.0) < 1.5, np.abs(found.chatter_frequency - 300.0) < 8
    )
    for number, vector in ((1, direction[1]), (2, direction[0])):
        rows = found.vibration.values[close & (modes == number)]
        assert len(rows) > 5
        along = np.abs(rows @ np.array(vector)) / np.linalg.norm(vector)
        assert np.median(along) > 0.99


def test_without_a_limit_there_is_no_vibration(lab_slot):
    short = lab_slot.compliance(5, 50, 0.25)
    found = zero_order(short, *lab_slot.cut, [1000.0])
    assert np.isinf(found.limit_depth[0])
    assert np.isnan(found.vibration).all()


# --- bad data --------------------------------------------------------------------------------------------------------


def test_a_range_that_ends_below_the_mode_is_said(lab_slot):
    warnings = zero_order(lab_slot.compliance(5, 50, 0.25), *lab_slot.cut, [1000.0]).attrs["warnings"]
    assert any("at 49.75 Hz, its last sample" in w and "measure further up" in w for w in warnings)


def test_lobes_that_need_data_below_and_above_are_told_with_their_speeds(lab_slot):
    speeds = np.linspace(700.0, 2500.0, 200)
    for low, high, expected in ((5.0, 66.0, "above"), (62.5, 400.0, "below")):
        found = zero_order(lab_slot.compliance(low, high, 0.25), *lab_slot.cut, speeds)
        (sentence,) = (w for w in found.attrs["warnings"] if "cuts off lobes" in w)
        assert f"need data {expected}" in sentence
        whole = zero_order(lab_slot.machine, *lab_slot.cut, speeds)
        edge = 65.75 if expected == "above" else 62.5
        outside = whole.chatter_frequency > edge if expected == "above" else whole.chatter_frequency < edge
        assert np.all(found.limit_depth[outside & (found.lobe == whole.lobe)] >= whole.limit_depth[outside] * 0.999)


def test_a_machine_that_gives_energy_is_told(authors):
    compliance = authors.compliance(2, 250, 0.25)
    turned = make_compliance(compliance.frequency, compliance.compliance.values.conj())
    late = np.exp(2j * np.pi * compliance.frequency.values * 3e-3)[:, None, None]
    delayed = make_compliance(compliance.frequency, compliance.compliance.values * late)
    for bad in (turned, delayed):
        expected = zero_order(bad, *authors.cut, [800.0]).attrs["warnings"]
        assert any("not that of a passive machine" in w for w in expected)
    assert zero_order(compliance, *authors.cut, [800.0]).attrs["warnings"] == []
    noise = np.random.default_rng(1).standard_normal(compliance.compliance.shape) * 0.02
    noisy = make_compliance(compliance.frequency, compliance.compliance.values * (1.0 + noise))
    assert not any("passive" in w for w in zero_order(noisy, *authors.cut, [800.0]).attrs["warnings"])


def test_a_radial_force_of_the_wrong_sign_is_told_by_all_methods(authors):
    pulling = CuttingCoefficients(1889e6, -806e6, 291e6)
    for method in (zero_order, semi_discretization, multi_frequency):
        expected = method(authors.machine, authors.tool, authors.arc, pulling, [900.0]).attrs["warnings"]
        assert any("K_rc is -806 N/mm^2" in w for w in expected)
    with pytest.raises(InputError, match="tangential coefficient must be positive"):
        CuttingCoefficients(-1e9, 1e8, 0.0)
    with pytest.raises(InputError, match="above zero and at most the diameter"):
        engagement("down", 0.0, 0.08)


def test_speeds_too_low_for_a_method_are_refused_with_the_lowest_possible(lab_slot):
    with pytest.raises(InputError, match=r"64 are the most. Ask for 14.* rpm or more"):
        multi_frequency(lab_slot.machine, *lab_slot.cut, [1000.0, 5.0])
    with pytest.raises(InputError, match=r"4096 are the most. Ask for"):
        semi_discretization(lab_slot.machine, *lab_slot.cut, [1000.0, 0.05])


def test_a_helix_leaves_the_mean_matrix_as_it_is_and_that_is_said(make_case):
    """Each part of the edge passes the same arc in a turn, only later."""
    case = make_case["authors"]("down", 40e-3)
    tool = replace(case.tool, helix_angle=math.radians(30.0))
    straight, twisted = (zero_order(case.machine, t, *case.cut[1:], [700.0, 950.0]) for t in (case.tool, tool))
    np.testing.assert_array_equal(twisted.limit_depth, straight.limit_depth)
    assert not any("helix" in w for w in straight.attrs["warnings"])
    assert sum("does not know the helix of 30 deg" in w for w in twisted.attrs["warnings"]) == 1
    sampled = case.compliance(2, 400, 0.5)
    assert any("helix of 30 deg" in w for w in critical_depth(sampled, tool, *case.cut[1:]).warnings)
