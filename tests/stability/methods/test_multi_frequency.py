"""The multi-frequency method against the semi-discretisation, with which it shares only the search for crossings."""

import csv
import math
from dataclasses import replace

import numpy as np
import pytest
from places import DATA

from process import InputError, ModalModel
from stability import multi_frequency, semi_discretization, zero_order

SPEEDS = [700, 950, 1150, 1450]


def checked_rows() -> list[tuple[int, float, float, str]]:
    """Rows of the classical milling benchmark: degrees of freedom, immersion, rpm, limit in mm."""
    path = DATA.parent / "reference" / "milling_limits.csv"
    if not path.is_file():
        pytest.skip("the reference table milling_limits.csv is not here (set SMFE_DATA to the data beside it)")
    with path.open() as file:
        rows = csv.reader(file)
        next(rows)
        return [(int(d), float(i), float(n), limit) for d, i, n, limit in rows]


@pytest.mark.parametrize("every", [4, pytest.param(1, marks=pytest.mark.slow)])
def test_classical_benchmark(make_case, every):
    # The last set has twice the harmonics of that from which the limit hardly moved any more.
    for directions, immersion, rpm, expected in checked_rows()[::every]:
        case = make_case["benchmark"](directions, immersion)
        found = multi_frequency(case.machine, *case.cut, rpm)
        if expected.startswith(">"):
            assert float(found.limit_depth[0]) > float(expected[1:])
            continue
        assert float(found.limit_depth[0]) == pytest.approx(float(expected), rel=2e-3)
        assert int(found.harmonics[0]) <= 80
        assert found.attrs["warnings"] == []


@pytest.mark.parametrize(
    ("directions", "immersion", "expected"),
    [  # Reference: a coarse set of harmonics misses the root at 18500 rpm and returns 25.8 mm
        (2, 1.0, {9000: 0.3462, 12000: 0.0849, 15000: 0.1144, 18500: 0.0493}),
        (2, 0.5, {9000: 0.9523, 12000: 0.2418, 15000: 0.2818, 18500: 0.1115}),
        (2, 0.05, {12000: 7.86, 15000: 1.6515}),
    ],
)
def test_two_dimensional_rows(make_case, directions, immersion, expected):
    case = make_case["benchmark"](directions, immersion)
    found = multi_frequency(case.machine, *case.cut, list(expected))
    np.testing.assert_allclose(found.limit_depth, list(expected.values()), rtol=2e-3)


@pytest.mark.parametrize(
    ("cut", "width", "zero_order_off"),
    [  # zero order against the converged limit at 700, 950, 1150, 1450 rpm, per cent, as measured
        ("down", 12e-3, [7.6, 0.7, -0.3, 31.9]),
        ("down", 72e-3, [1.9, 10.4, 1.2, -8.7]),
        ("up", 40e-3, [-16.9, 0.9, -14.1, -17.1]),
        ("central", 40e-3, [-36.8, -8.2, 3.1, 13.7]),
    ],
)
def test_three_modes_in_three_dimensions(make_case, cut, width, zero_order_off):
    case = make_case["authors"](cut, width)
    converged = semi_discretization(case.machine, *case.cut, SPEEDS)
    found = multi_frequency(case.machine, *case.cut, SPEEDS)
    np.testing.assert_allclose(found.limit_depth, converged.limit_depth, rtol=2e-3)
    np.testing.assert_allclose(found.chatter_frequency, converged.chatter_frequency, rtol=1e-3)
    assert found.kind.values.tolist() == converged.kind.values.tolist()
    zero = zero_order(case.compliance(1, 400, 0.1), *case.cut, SPEEDS)
    off = 100 * (zero.limit_depth.values / converged.limit_depth.values - 1)
    np.testing.assert_allclose(off, zero_order_off, atol=0.1)


@pytest.mark.parametrize("cut", ["down", pytest.param("up", marks=pytest.mark.slow)])
def test_five_coupled_modes_and_eight_teeth(make_case, cut):
    case = make_case["ram"](cut)
    speeds = [300, 400, 500, 600, 700]
    converged = semi_discretization(case.machine, *case.cut, speeds)
    found = multi_frequency(case.machine, *case.cut, speeds)
    np.testing.assert_allclose(found.limit_depth, converged.limit_depth, rtol=5e-4)


def test_a_constant_directional_factor_makes_zero_order_exact(lab_slot):
    speeds = [800, 1000, 1500, 3000]
    exact = zero_order(lab_slot.compliance(0.25, 400, 0.05), *lab_slot.cut, speeds)
    found = multi_frequency(lab_slot.machine, *lab_slot.cut, speeds)
    np.testing.assert_allclose(found.limit_depth, exact.limit_depth, rtol=1e-5)
    np.testing.assert_allclose(found.chatter_frequency, exact.chatter_frequency, atol=1e-3)


def test_period_doubling_is_told_apart(make_case):
    # Half the tooth passing frequency and its odd multiples; the neighbouring speed loses stability by a Hopf.
    case = make_case["benchmark"](1, 0.05)
    found = multi_frequency(case.machine, *case.cut, [10000, 15000, 20000])
    assert found.kind.values.tolist() == ["flip", "flip", "hopf"]
    order = found.chatter_frequency.values[:2] / (np.array([10000, 15000]) * 2 / 60)
    np.testing.assert_allclose(order, [2.5, 1.5], rtol=1e-12)


def test_unequal_pitch(make_case):
    case = make_case["authors"]()
    tool = replace(case.tool, pitch_angles=(math.radians(160), math.radians(200)))
    cut = (tool, case.arc, case.coefficients)
    converged = semi_discretization(case.machine, *cut, SPEEDS[2:])
    found = multi_frequency(case.machine, *cut, SPEEDS[2:])
    np.testing.assert_allclose(found.limit_depth, converged.limit_depth, rtol=2e-3)
    np.testing.assert_allclose(found.chatter_frequency, converged.chatter_frequency, rtol=1e-3)


def test_measured_samples_need_no_modal_fit(make_case):
    # 0.25 Hz steps from 2 to 400 Hz: what lies beyond and between costs less than the tolerance.
    case = make_case["authors"]("down", 72e-3)
    modal = multi_frequency(case.machine, *case.cut, SPEEDS)
    sampled = multi_frequency(case.compliance(2, 400, 0.25), *case.cut, SPEEDS)
    np.testing.assert_allclose(sampled.limit_depth, modal.limit_depth, rtol=5e-4)
    assert "harmonics above 399.75 Hz find no compliance" in sampled.attrs["warnings"][-1]


def test_a_gap_and_a_missing_axis_are_named(make_case):
    case = make_case["authors"]("down", 72e-3)
    whole = case.compliance(2, 400, 0.25)
    gap = whole.where((whole.frequency < 150) | (whole.frequency > 160))
    found = multi_frequency(gap, *case.cut, [950])
    assert any("missing between its samples in 1 band" in w for w in found.attrs["warnings"])
    exact = multi_frequency(whole, *case.cut, [950])
    assert float(found.limit_depth[0]) == pytest.approx(float(exact.limit_depth[0]), rel=1e-3)
    flat = whole.sel(response=["x", "y"], excitation=["x", "y"])
    assert any("partial matrix" in w for w in multi_frequency(flat, *case.cut, [950]).attrs["warnings"])


def test_a_compliance_that_ends_among_its_modes_is_named(make_case):
    case = make_case["authors"]("down", 72e-3)
    top = float(case.machine.frequency.max())
    bottom = float(case.machine.frequency.min())
    cut_off = case.compliance(2, top, 0.25), case.compliance(bottom, 400, 0.25)
    for samples, expected in zip(cut_off, ("measure further up", "measure further down"), strict=True):
        assert any(expected in w for w in multi_frequency(samples, *case.cut, [950]).attrs["warnings"])
    whole = multi_frequency(case.compliance(2, 400, 0.25), *case.cut, [950])
    assert not any("measure further" in w for w in whole.attrs["warnings"])


def test_more_harmonics_change_less(make_case):
    case = make_case["benchmark"](1, 0.1)
    exact = semi_discretization(case.machine, *case.cut, [10000], 1e-6).limit_depth.values
    loose, tight = (multi_frequency(case.machine, *case.cut, [10000], t) for t in (1e-2, 1e-5))
    assert int(tight.harmonics[0]) > int(loose.harmonics[0])
    off = [abs(float(found.limit_depth[0]) / float(exact[0]) - 1.0) for found in (tight, loose)]
    assert off[0] < off[1] < 1e-2
    assert off[0] < 1e-5


def test_labels_and_what_is_refused(lab_slot):
    found = multi_frequency(lab_slot.machine, *lab_slot.cut, [1500, 1000])
    assert found.spindle_speed.values.tolist() == [1500, 1000]
    assert found.limit_depth.attrs["units"] == found.limit_depth_error.attrs["units"] == "mm"
    assert set(found.data_vars) == {
        "limit_depth",
        "limit_depth_error",
        "chatter_frequency",
        "lobe",
        "kind",
        "harmonics",
    }
    with pytest.raises(InputError, match="nothing that could chatter"):
        multi_frequency(ModalModel([50.0], [0.02], [1e7], [[0, 0, 1]]), *lab_slot.cut, 1000)
    with pytest.raises(InputError, match="tolerance is 0"):
        multi_frequency(lab_slot.machine, *lab_slot.cut, 1000, 0.0)
