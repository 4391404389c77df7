"""Claims about the zero-order solution: scan, invariances, grids, branches, gaps, labels, refusals."""

import math
from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from process.cut.force import CuttingCoefficients, directional_matrix
from process.cut.tool import Tool
from process.errors import InputError
from process.labels import make_compliance
from stability import critical_depth, lobe_curves, zero_order, zero_order_from_matrix
from stability.methods import _zero_order_kernels as _kernels
from stability.methods.zero_order_branches import eigenvalue_branches
from stability.problem import complete_samples

RAM_SPEEDS = np.linspace(200, 800, 301)


def scan_limits(case, speeds):
    """Theory 2.3, independent of the lobe construction: at each speed, zeros of Im 1/(mu (1 - e^{-jwT})) over w."""
    frequency = np.arange(2.0, 250.0, 0.01)
    mu = np.linalg.eigvals(directional_matrix(*case.cut) @ case.machine.matrix(frequency))
    for i in range(1, len(mu)):
        options = mu[i][np.array(list(permutations(range(3))))]
        mu[i] = options[np.abs(options - mu[i - 1]).sum(axis=1).argmin()]
    limits = []
    for speed in speeds:
        period = 60.0 / (case.tool.teeth * speed)
        z = 1.0 / (mu * (1.0 - np.exp(-2j * np.pi * frequency * period))[:, None])
        a, b = z[:-1], z[1:]
        weight = a.imag / (a.imag - b.imag)
        depth = a.real + weight * (b.real - a.real)
        # A pole of z also changes the sign of Im z: there z is huge on both sides.
        zero = (a.imag * b.imag < 0.0) & (depth > 0.0) & (np.abs(b - a) < 0.5 * np.abs(a))
        limits.append(depth[zero].min() * 1e3)
    return np.array(limits)


@pytest.mark.parametrize(
    ("cut", "width"),
    [
        ("down", 12e-3),
        ("up", 48e-3),
        *(pytest.param(*v, marks=pytest.mark.slow) for v in (("down", 40e-3), ("central", 72e-3))),
    ],
)
def test_lobe_construction_equals_a_scan_over_frequency(make_case, cut, width):
    case = make_case["authors"](cut, width)
    speeds = np.linspace(450, 2900, 15)
    lobes = zero_order(case.compliance(2.0, 250, 0.05), *case.cut, speeds)
    np.testing.assert_allclose(lobes.limit_depth, scan_limits(case, speeds), rtol=1e-4)


@pytest.mark.parametrize(
    ("name", "speeds", "tolerance"),
    [("authors", np.linspace(400, 3000, 301), 2e-4), ("ram", RAM_SPEEDS, 6e-4)],
)
@pytest.mark.parametrize(("cut", "share"), [("down", 0.5), ("up", 0.6), ("central", 0.9)])
def test_quarter_hertz_grid_loses_no_lobe(make_case, name, speeds, tolerance, cut, share):
    """A 0.25 Hz grid off the fine one departs by at most 0.06 %, lightly damped modes and all."""
    case = make_case[name](cut, share * make_case[name]().tool.diameter)
    fine = zero_order(case.compliance(2.0, 250, 0.01), *case.cut, speeds)
    coarse = zero_order(case.compliance(2.1, 250, 0.25), *case.cut, speeds)
    np.testing.assert_allclose(coarse.limit_depth, fine.limit_depth, rtol=tolerance)


def test_interpolation_converges_with_fourth_order(make_case):
    case = make_case["ram"]()
    exact = zero_order(case.compliance(2.0, 250, 0.01), *case.cut, RAM_SPEEDS).limit_depth.values
    errors = []
    for step in (0.4, 0.2, 0.1):
        found = zero_order(case.compliance(2.0, 250, step), *case.cut, RAM_SPEEDS).limit_depth.values
        errors.append(np.median(np.abs(found / exact - 1.0)))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (orders > 3.5).all()


def test_one_mode_is_exact_on_any_grid(lab_slot):
    # sigma of a single mode is a parabola in f, and so is its interpolant.
    speeds = np.linspace(700, 3000, 200)
    fine = zero_order(lab_slot.compliance(1, 400, 0.05), *lab_slot.cut, speeds)
    coarse = zero_order(lab_slot.compliance(1, 400, 5.0), *lab_slot.cut, speeds)
    np.testing.assert_allclose(coarse.limit_depth, fine.limit_depth, rtol=1e-9)


def test_a_more_compliant_machine_has_proportionally_smaller_limits(authors):
    compliance = authors.compliance(2, 250, 0.25)
    softer = make_compliance(compliance.frequency, 3.0 * compliance.compliance.values)
    speeds = np.linspace(400, 3000, 50)
    one, other = (zero_order(c, *authors.cut, speeds) for c in (compliance, softer))
    np.testing.assert_allclose(other.limit_depth, one.limit_depth / 3.0, rtol=1e-9)
    np.testing.assert_allclose(other.chatter_frequency, one.chatter_frequency, rtol=1e-9)


def test_harder_work_has_proportionally_smaller_limits_and_edges_do_not_matter(authors):
    k = authors.coefficients
    harder = CuttingCoefficients(2 * k.Ktc, 2 * k.Krc, 2 * k.Kac, Kte=6e4, Kre=1e5, Kae=-3e3)
    speeds = np.linspace(400, 3000, 50)
    compliance = authors.compliance(2, 250, 0.25)
    one = zero_order(compliance, *authors.cut, speeds)
    other = zero_order(compliance, authors.tool, authors.arc, harder, speeds)
    np.testing.assert_allclose(other.limit_depth, one.limit_depth / 2.0, rtol=1e-9)


def test_limits_do_not_depend_on_the_frame(authors):
    turn = np.linalg.qr(np.random.default_rng(3).standard_normal((3, 3)))[0]
    compliance = authors.compliance(2, 250, 0.25)
    turned = make_compliance(compliance.frequency, turn @ compliance.compliance.values @ turn.T)
    a0 = directional_matrix(*authors.cut)
    speeds = np.linspace(400, 3000, 50)
    one = zero_order_from_matrix(compliance, a0, 2, speeds)
    other = zero_order_from_matrix(turned, turn @ a0 @ turn.T, 2, speeds)
    np.testing.assert_allclose(other.limit_depth, one.limit_depth, rtol=1e-8)


def test_teeth_and_speed_act_through_the_tooth_period(authors):
    compliance = authors.compliance(2, 250, 0.25)
    a0 = directional_matrix(*authors.cut)
    speeds = np.linspace(400, 3000, 50)
    two = zero_order_from_matrix(compliance, a0, 2, speeds)
    six = zero_order_from_matrix(compliance, a0, 6, speeds / 3.0)
    np.testing.assert_allclose(six.limit_depth, two.limit_depth, rtol=1e-9)


def test_eigenvalues_are_those_of_the_library(authors, make_case):
    rng = np.random.default_rng(5)
    for size in (1, 2, 3):
        matrices = rng.standard_normal((200, size, size)) + 1j * rng.standard_normal((200, size, size))
        matrices[100:] *= 1e-9
        found = np.sort_complex(_kernels.eigenvalues(matrices))
        np.testing.assert_allclose(found, np.sort_complex(np.linalg.eigvals(matrices)), rtol=1e-9)
    for case in (authors, make_case["ram"]()):
        oriented = directional_matrix(*case.cut) @ case.machine.matrix(np.arange(2.0, 250.0, 0.25))
        found = np.sort(np.abs(_kernels.eigenvalues(np.ascontiguousarray(oriented))), axis=1)
        expected = np.sort(np.abs(np.linalg.eigvals(oriented)), axis=1)
        # Those below 1e-7 of the largest count as none.
        np.testing.assert_allclose(found, expected, atol=1e-7 * expected.max(), rtol=1e-7)


@pytest.mark.parametrize("gap", [1.0, 1e-2, 1e-5, 1e-8, 0.0])
@pytest.mark.parametrize("all_three", [False, True])
def test_eigenvalues_that_nearly_coincide(gap, all_three):
    """Of normal matrices, whose eigenvalues are known as well as their entries: a polynomial would lose half."""
    rng = np.random.default_rng(11)
    unitary = np.linalg.qr(rng.standard_normal((500, 3, 3)) + 1j * rng.standard_normal((500, 3, 3)))[0]
    known = rng.standard_normal((500, 3)) + 1j * rng.standard_normal((500, 3))
    for i in (1, 2) if all_three else (1,):
        known[:, i] = known[:, 0] * (1.0 + gap * np.exp(2j * np.pi * rng.random(500)))
    matrices = (unitary * known[:, None, :]) @ unitary.conj().transpose(0, 2, 1)
    found = _kernels.eigenvalues(matrices)
    for reference in (known, np.linalg.eigvals(matrices)):
        off = [np.abs(found - reference[:, order]).max(axis=1) for order in permutations(range(3))]
        assert np.max(np.min(off, axis=0) / np.abs(known).max(axis=1)) < 1e-13


def test_the_pass_over_the_steps_leaves_no_crossing_out(authors, make_case):
    """Against a scan of each speed by itself, which shares neither the order of the search nor its bounds."""
    rng = np.random.default_rng(5)
    for case in (authors, make_case["ram"]()):
        # Even, uneven and wide lists of speeds; a grid that is fine, and one of a few samples a resonance.
        for step in (0.1, 1.5):
            samples = complete_samples(case.compliance(2, 250, step))
            branches = eigenvalue_branches(samples, directional_matrix(*case.cut))
            for speed in (np.linspace(200, 3000, 40), 10.0 ** rng.uniform(1.5, 4.5, 40), np.array([812.0])):
                period = np.sort(60.0 / (case.cut[0].teeth * speed))
                depth, chatter, _ = branches.envelope(period)
                alone = np.array([branches.first_crossing(np.full(1, t)) for t in period])
                np.testing.assert_allclose(depth, alone[:, 0], rtol=1e-8)
                np.testing.assert_allclose(chatter, alone[:, 1], rtol=1e-7)


def test_speeds_may_come_in_any_order(authors):
    compliance = authors.compliance(2, 250, 0.25)
    speeds = np.linspace(400, 3000, 50)
    rising = zero_order(compliance, *authors.cut, speeds)
    mixed = np.random.default_rng(1).permutation(speeds)
    found = zero_order(compliance, *authors.cut, mixed)
    np.testing.assert_array_equal(found.limit_depth, rising.limit_depth.sel(spindle_speed=mixed))


def test_ninety_degree_tool_drops_the_eigenvalue_that_rank_leaves_at_zero(authors):
    # At 90 degrees z motion does not change the chip (forces in z still move x and y): rank two.
    tool = replace(authors.tool, approach_angle=math.pi / 2)
    compliance = authors.compliance(2, 250, 0.25)
    speeds = np.linspace(400, 3000, 100)
    full = zero_order(compliance, tool, authors.arc, authors.coefficients, speeds)
    plane = compliance.sel(response=["x", "y"])
    flat = zero_order(plane, tool, authors.arc, authors.coefficients, speeds)
    np.testing.assert_allclose(full.limit_depth, flat.limit_depth, rtol=1e-9)


def test_the_lobe_counts_whole_waves_between_teeth(authors):
    speeds = np.linspace(200, 3000, 200)
    lobes = zero_order(authors.compliance(1, 250, 0.25), *authors.cut, speeds)
    waves = np.floor(lobes.chatter_frequency / (authors.tool.teeth * speeds / 60.0))
    np.testing.assert_array_equal(lobes.lobe, waves)


def test_the_envelope_is_the_lowest_of_the_single_lobes(make_case):
    case = make_case["ram"]()
    compliance = case.compliance(2, 250, 0.1)
    curves = lobe_curves(compliance, *case.cut, (RAM_SPEEDS[0], RAM_SPEEDS[-1]))
    inner = RAM_SPEEDS[1:-1]
    lowest = np.full(inner.size, np.inf)
    for _, curve in curves.groupby(["branch", "lobe", "piece"]):
        n, a = curve["spindle_speed_rpm"].to_numpy(), curve["limit_depth_mm"].to_numpy()
        for i in range(len(n) - 1):
            hit = (inner - n[i]) * (inner - n[i + 1]) <= 0.0
            if hit.any() and n[i] != n[i + 1]:
                at = a[i] + (inner[hit] - n[i]) / (n[i + 1] - n[i]) * (a[i + 1] - a[i])
                lowest[hit] = np.minimum(lowest[hit], at)
    envelope = zero_order(compliance, *case.cut, inner).limit_depth.values
    np.testing.assert_allclose(lowest, envelope, rtol=5e-3)


def test_no_speed_lies_below_the_critical_depth_and_some_speed_reaches_it(authors):
    compliance = authors.compliance(2, 250, 0.25)
    critical = critical_depth(compliance, *authors.cut)
    envelope = zero_order(compliance, *authors.cut, np.linspace(150, 6000, 3000)).limit_depth.values
    assert envelope.min() >= critical.limit_depth_mm * (1 - 1e-6)
    assert envelope.min() == pytest.approx(critical.limit_depth_mm, rel=1e-3)


def test_labels_carry_units(authors):
    lobes = zero_order(authors.compliance(2, 250, 0.25), *authors.cut, [500, 600])
    units = {str(n): lobes[n].attrs["units"] for n in [*lobes.data_vars, "spindle_speed"]}
    assert units == {
        "limit_depth": "mm",
        "chatter_frequency": "Hz",
        "lobe": "1",
        "vibration": "1",
        "spindle_speed": "rpm",
    }
    assert lobes.lobe.dtype == np.int64


# --- what the data do not hold ---------------------------------------------------------------------------------------


def masked(compliance, low, high):
    keep = (compliance.frequency < low) | (compliance.frequency > high)
    return compliance.where(keep).assign_coords(compliance.coords)


def with_units(dataset):
    dataset["compliance"].attrs["units"] = "m/N"
    return dataset


def test_a_masked_band_is_skipped_named_and_not_bridged(authors):
    speeds = np.linspace(400, 3000, 200)
    whole = authors.compliance(2, 250, 0.25)
    holed = with_units(masked(whole, 58.0, 63.0))
    expected, found = (zero_order(c, *authors.cut, speeds) for c in (whole, holed))
    frequency = found.chatter_frequency.values
    assert not ((frequency > 57.75) & (frequency < 63.25)).any()
    outside = ((expected.chatter_frequency < 57.0) | (expected.chatter_frequency > 64.0)).values
    assert outside.sum() > 20
    np.testing.assert_allclose(found.limit_depth[outside], expected.limit_depth[outside], rtol=1e-3)
    assert any("57.75 to 63.25 Hz" in w for w in found.attrs["warnings"])
    assert any("cuts off lobes" in w for w in found.attrs["warnings"])


def test_rows_that_were_dropped_are_a_gap_as_well(authors):
    whole = authors.compliance(2, 250, 0.25)
    dropped = whole.isel(frequency=(whole.frequency < 58.0) | (whole.frequency > 63.0))
    warnings = zero_order(dropped, *authors.cut, [800, 900]).attrs["warnings"]
    assert any("57.75 to 63.25 Hz" in w for w in warnings)


def test_a_single_masked_sample_is_a_gap(authors):
    holed = with_units(masked(authors.compliance(2, 250, 0.25), 60.0, 60.0))
    lobes = zero_order(holed, *authors.cut, np.linspace(400, 3000, 400))
    frequency = lobes.chatter_frequency.values
    assert not ((frequency > 59.75) & (frequency < 60.25)).any()


def test_a_logarithmic_grid_has_no_gap(authors):
    frequency = np.geomspace(5, 250, 800)
    lobes = zero_order(authors.machine.compliance(frequency), *authors.cut, np.linspace(1000, 3000, 20))
    fine = zero_order(authors.compliance(5, 250, 0.02), *authors.cut, np.linspace(1000, 3000, 20))
    assert lobes.attrs["warnings"] == []
    np.testing.assert_allclose(lobes.limit_depth, fine.limit_depth, rtol=2e-3)


def test_a_partial_matrix_is_said_to_be_rigid_elsewhere(authors):
    partial = authors.machine.compliance(np.arange(2, 250, 0.25), ["x", "y"], ["x", "y"])
    warnings = zero_order(partial, *authors.cut, [800]).attrs["warnings"]
    assert any("partial matrix" in w and "rigid" in w and "response z" in w for w in warnings)


def test_no_share_bounds_what_an_unmeasured_direction_does_to_the_limit(authors):
    """With a softer and softer y the limit falls without end while xx stays as it is: the warning states no figure."""
    full = authors.machine.compliance(np.arange(2, 250, 0.25))
    alone = full.sel(response=["x"], excitation=["x"])
    speeds = np.linspace(500.0, 1500.0, 21)
    measured = zero_order(alone, *authors.cut, speeds)
    ratios = []
    for softer in (1.0, 10.0, 100.0):
        matrix = full["compliance"].values.copy()
        matrix[:, 1, 1] *= softer
        true = zero_order(make_compliance(full["frequency"], matrix), *authors.cut, speeds)
        ratios.append(float(np.max(measured.limit_depth / true.limit_depth)))
    # Past 1.6 times, which "30 to 60 %" would have been, from the start; soon past any figure.
    assert ratios[0] > 1.6
    assert ratios[1] > 2.0 * ratios[0]
    assert ratios[2] > 2.0 * ratios[1]
    (warning,) = (w for w in measured.attrs["warnings"] if "partial matrix" in w)
    assert "no measured entry bounds by how much" in warning
    assert "%" not in warning


def test_data_that_end_on_a_lobe_are_said_to_cut_it_off(lab_slot):
    short = lab_slot.compliance(20, 64.0, 0.25)
    lobes = zero_order(short, *lab_slot.cut, np.linspace(1100, 2000, 91))
    assert np.isinf(lobes.limit_depth.values[-1])
    assert np.isnan(lobes.chatter_frequency.values[-1])
    assert lobes.lobe.values[-1] == -1
    assert any("cuts off lobes" in w and "rpm need data above 63.75 Hz" in w for w in lobes.attrs["warnings"])
    assert any("measure further up" in w for w in lobes.attrs["warnings"])
    assert any("as far as the data reach (20 to 63.75 Hz)" in w for w in lobes.attrs["warnings"])


def test_a_cut_that_nothing_can_make_unstable_has_no_limit(lab_slot):
    # Below the resonance Re Phi > 0, and this slot acts through -K_rc Phi_xx alone.
    below = lab_slot.compliance(5, 60, 0.25)
    critical = critical_depth(below, *lab_slot.cut)
    assert critical.limit_depth_mm == math.inf
    assert math.isnan(critical.chatter_frequency_Hz)
    assert np.isinf(zero_order(below, *lab_slot.cut, [800, 1200]).limit_depth).all()


# --- refusals --------------------------------------------------------------------------------------------------------


def test_unequal_pitch_has_no_explicit_lobes(authors):
    tool = Tool(80e-3, 2, math.pi / 4, pitch_angles=(math.radians(170), math.radians(190)))
    compliance = authors.compliance(2, 250, 0.25)
    for call in (
        lambda: lobe_curves(compliance, tool, authors.arc, authors.coefficients, (800, 900)),
        lambda: critical_depth(compliance, tool, authors.arc, authors.coefficients),
    ):
        with pytest.raises(InputError, match=r"unequal pitch \(170, 190 deg\).*equally spaced teeth only"):
            call()


@pytest.mark.parametrize("speeds", [[0.0], [800, -1], [math.nan], [math.inf]])
def test_impossible_speeds_are_refused(authors, speeds):
    with pytest.raises(InputError, match="must be positive and finite"):
        zero_order(authors.compliance(2, 250, 1), *authors.cut, speeds)


def test_no_speeds_are_refused(authors):
    with pytest.raises(InputError, match="at least one speed"):
        zero_order(authors.compliance(2, 250, 1), *authors.cut, [])
    with pytest.raises(InputError, match="is empty"):
        lobe_curves(authors.compliance(2, 250, 1), *authors.cut, (500, 500))


def test_a_condition_left_over_is_refused_by_name(authors):
    compliance = authors.compliance(2, 250, 1).expand_dims(feed=[0, 500])
    compliance["compliance"].attrs["units"] = "m/N"
    with pytest.raises(InputError, match=r"dimension 'feed' \(0, 500\).*sel\(feed"):
        zero_order(compliance, *authors.cut, [800])


def test_a_matrix_that_is_nan_throughout_is_refused(authors):
    compliance = authors.compliance(2, 250, 1)
    compliance["compliance"][:] = np.nan
    with pytest.raises(InputError, match="holds no number at any frequency"):
        zero_order(compliance, *authors.cut, [800])


def test_no_teeth_and_no_matrix_are_refused(authors):
    compliance = authors.compliance(2, 250, 1)
    with pytest.raises(InputError, match="0 teeth"):
        zero_order_from_matrix(compliance, np.eye(3), 0, [800])
    with pytest.raises(InputError, match="finite 3x3 matrix"):
        zero_order_from_matrix(compliance, np.eye(2), 1, [800])
    with pytest.raises(InputError, match="nothing that could chatter"):
        zero_order_from_matrix(compliance, np.zeros((3, 3)), 1, [800])
