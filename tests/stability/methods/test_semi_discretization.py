"""Semi-discretisation: the checked benchmark, islands, order of convergence, unequal pitch, closed loops."""

import csv
import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from places import DATA

from process import CuttingCoefficients, InputError, ModalModel, Tool, engagement
from stability import (
    floquet_multipliers,
    limit_depth,
    multi_frequency,
    semi_discretization,
    stability_bands,
    zero_order,
)


def checked_rows() -> list[tuple[int, float, float, str]]:
    """Rows of the classical milling benchmark: degrees of freedom, immersion, rpm, limit in mm."""
    path = DATA.parent / "reference" / "milling_limits.csv"
    if not path.is_file():
        pytest.skip("the reference table milling_limits.csv is not here (set SMFE_DATA to the data beside it)")
    with path.open() as file:
        rows = csv.reader(file)
        next(rows)
        return [(int(d), float(i), float(n), limit) for d, i, n, limit in rows]


def radius(case, depth_mm: float, rpm: float, steps: int | None = None) -> float:
    return float(np.abs(floquet_multipliers(case.machine, *case.cut, depth_mm * 1e-3, rpm, steps)[0]))


def test_classical_benchmark_within_a_tenth_of_a_percent(make_case):
    for directions, immersion, rpm, expected in checked_rows():
        case = make_case["benchmark"](directions, immersion)
        found = limit_depth(case.machine, *case.cut, rpm)
        if expected.startswith(">"):
            assert found.limit_depth_mm > float(expected[1:])
        else:
            assert found.limit_depth_mm == pytest.approx(float(expected), rel=1e-3)
        assert found.limit_depth_error_mm <= 1e-3 * found.limit_depth_mm


@pytest.mark.parametrize(
    ("rpm", "expected"),
    [
        (5000, {0.2: 0.81974, 0.3: 0.90737, 0.5: 1.07397, 0.7: 1.22155, 1.0: 1.40646}),
        (10000, {0.2: 0.94085, 0.3: 0.98970, 0.5: 1.07461, 0.7: 1.14579, 1.0: 1.23247}),
    ],
)
def test_largest_multiplier_in_a_slot(make_case, rpm, expected):
    # checked reference, converged to 2e-5
    case = make_case["benchmark"](1, 1.0)
    found = [radius(case, depth, rpm) for depth in expected]
    np.testing.assert_allclose(found, list(expected.values()), atol=3e-5)


def test_an_island_has_three_crossings(make_case):
    # checked reference: unstable from 2.106 (2.1047 in the table), stable again from 2.312, unstable from 2.353 mm
    case = make_case["benchmark"](1, 0.5)
    bands = stability_bands(case.machine, *case.cut, 10000, 4e-3)
    assert bands["stable"].tolist() == [True, False, True, False]
    np.testing.assert_allclose(bands["from_mm"], [0.0, 2.1047, 2.312, 2.353], rtol=5e-4)
    assert bands["kind"].tolist() == ["none", "flip", "flip", "hopf"]
    assert bands["to_mm"].iloc[-1] == 4.0
    # The map over one period, which knows nothing of crossings, sees the same bands.
    for depth in np.arange(0.05, 4.0, 0.05):
        band = bands[(bands["from_mm"] <= depth) & (depth < bands["to_mm"])].iloc[0]
        assert (radius(case, depth, 10000) < 1.0) == band["stable"]
    assert bands["from_mm"][1] == pytest.approx(limit_depth(case.machine, *case.cut, 10000).limit_depth_mm, rel=1e-6)


@pytest.mark.parametrize(
    ("directions", "immersion", "expected"),
    [  # reference values
        (2, 1.0, {9000: 0.3462, 12000: 0.0849, 15000: 0.1145, 18500: 0.0493}),
        (2, 0.5, {9000: 0.9523, 12000: 0.2418, 15000: 0.2819, 18500: 0.1115}),
        (2, 0.05, {12000: 7.86, 15000: 1.6515}),
    ],
)
def test_two_dimensional_rows(make_case, directions, immersion, expected):
    case = make_case["benchmark"](directions, immersion)
    found = semi_discretization(case.machine, *case.cut, list(expected))
    np.testing.assert_allclose(found.limit_depth, list(expected.values()), rtol=2e-3)


def test_a_constant_directional_factor_makes_zero_order_exact(lab_slot):
    # Reference: four straight teeth in a slot
    speeds = [800, 920, 1000, 1200, 1500, 1800, 2000, 2250, 2500, 3000]
    expected = [1.7516, 3.053, 0.2470, 0.1168, 0.1604, 0.3925, 0.7578, 1.4202, 2.2255, 4.1493]
    found = semi_discretization(lab_slot.machine, *lab_slot.cut, speeds)
    np.testing.assert_allclose(found.limit_depth, expected, rtol=5e-4)
    exact = zero_order(lab_slot.compliance(0.25, 400, 0.05), *lab_slot.cut, speeds)
    np.testing.assert_allclose(found.limit_depth, exact.limit_depth, rtol=1e-5)
    np.testing.assert_allclose(found.chatter_frequency, exact.chatter_frequency, atol=1e-3)
    assert set(found.kind.values) == {"hopf"}


def test_up_and_down_milling_are_equal_for_an_isotropic_machine(make_case):
    case = make_case["benchmark"](2, 0.5)
    speeds = [9000, 12000, 18500]
    down = semi_discretization(case.machine, *case.cut, speeds, 1e-6)
    up = semi_discretization(case.machine, case.tool, engagement("up", 5e-3, 10e-3), case.coefficients, speeds, 1e-6)
    np.testing.assert_allclose(up.limit_depth, down.limit_depth, rtol=1e-5)


@pytest.mark.parametrize(("immersion", "steps"), [(1.0, 8), (0.5, 4), (0.1, 3)])
def test_order_of_convergence(make_case, immersion, steps):
    # Measured from 8 to 16 steps in a slot 6.1e-3 to 5.9e-8, from 4 to 8 at immersion 0.5 4.5e-5 to 8e-10: order 16.
    # No power law caps it, in an interrupted cut as little as in a slot.
    case = make_case["benchmark"](1, immersion)
    exact = radius(case, 1.0, 20000, 60)
    coarse, fine = (abs(radius(case, 1.0, 20000, n) - exact) for n in (steps, 2 * steps))
    assert math.log2(coarse / fine) > 8.0, (coarse, fine)
    assert abs(radius(case, 1.0, 20000, 24) - exact) < 1e-11


def test_explicit_equal_pitch_is_no_pitch_at_all(make_case):
    case = make_case["authors"]("down", 72e-3)
    tool = replace(case.tool, pitch_angles=(math.pi, math.pi))
    one = semi_discretization(case.machine, *case.cut, [700, 950, 1450])
    same = semi_discretization(case.machine, tool, case.arc, case.coefficients, [700, 950, 1450])
    np.testing.assert_array_equal(one.limit_depth, same.limit_depth)


def test_nearly_equal_pitch_is_nearly_the_same(make_case):
    # Period one turn with two delays against period one tooth passing with one: different meshes, one answer.
    case = make_case["authors"]("down", 72e-3)
    tool = replace(case.tool, pitch_angles=(math.pi + 1e-5, math.pi - 1e-5))
    one = semi_discretization(case.machine, *case.cut, [700, 950, 1450], 1e-5)
    near = semi_discretization(case.machine, tool, case.arc, case.coefficients, [700, 950, 1450], 1e-5)
    np.testing.assert_allclose(near.limit_depth, one.limit_depth, rtol=2e-5)
    np.testing.assert_allclose(near.chatter_frequency, one.chatter_frequency, rtol=1e-5)
    turn = floquet_multipliers(case.machine, tool, case.arc, case.coefficients, 2e-3, 950)
    passing = floquet_multipliers(case.machine, *case.cut, 2e-3, 950)
    assert abs(turn[0]) == pytest.approx(abs(passing[0]) ** 2, rel=1e-4)


@pytest.mark.parametrize(
    ("pitch", "simulated"),
    [  # Reference: time simulation of low order, 1 to 5 % low
        ((90, 90, 90, 90), {1000: 0.247, 1200: 0.117, 1500: 0.159, 2000: 0.751}),
        ((80, 100, 80, 100), {1000: 0.333, 1200: 0.135, 1500: 0.173, 2000: 0.768}),
        ((70, 85, 95, 110), {1200: 0.157, 1500: 0.189, 2000: 0.826}),
    ],
)
def test_unequal_pitch_against_time_simulation(lab_slot, pitch, simulated):
    tool = replace(lab_slot.tool, pitch_angles=tuple(math.radians(p) for p in pitch))
    found = semi_discretization(lab_slot.machine, tool, lab_slot.arc, lab_slot.coefficients, list(simulated))
    ratio = found.limit_depth.values / np.array(list(simulated.values()))
    assert np.all((ratio > 0.998) & (ratio < 1.05)), ratio


@pytest.mark.parametrize("rpm", [320.1, 321.0])
def test_the_limit_of_unequal_pitch_lies_where_a_multiplier_leaves_the_unit_circle(lab_slot, rpm):
    tool = replace(lab_slot.tool, pitch_angles=tuple(math.radians(p) for p in (98, 82, 98, 82)))
    cut = lab_slot.machine, tool, lab_slot.arc, lab_slot.coefficients
    limit = limit_depth(*cut, rpm).limit_depth_mm * 1e-3
    below, above = (float(np.abs(floquet_multipliers(*cut, f * limit, rpm)[0])) for f in (0.99, 1.01))
    assert below < 1.0 < above


def test_the_averaged_island_of_unequal_pitch_is_not_there(lab_slot):
    # Reference: averaged, unstable from 0.57 to 1.36 mm; in time simulation lost between 2.5 and 4 mm
    tool = replace(lab_slot.tool, pitch_angles=tuple(math.radians(p) for p in (70, 85, 95, 110)))
    bands = stability_bands(lab_slot.machine, tool, lab_slot.arc, lab_slot.coefficients, 1000, 4e-3)
    assert bands["stable"].tolist()[:2] == [True, False]
    assert 2.5 < bands["to_mm"][0] < 4.0


@pytest.mark.parametrize(
    ("rpm", "kind"),
    [(2400, "fold"), *(pytest.param(*v, marks=pytest.mark.slow) for v in ((1800, "flip"), (2000, "hopf")))],
)
def test_a_fold_of_unequal_pitch_is_found(rpm, kind):
    # A multiplier leaves through +1, which equal pitch does not know: then a wave that repeats leaves no wave.
    degrees = (46.25, 41.82, 55.42, 35.74, 42.46, 43.45, 39.31, 55.55)
    machine = ModalModel([197.8, 64.2], [0.0099, 0.0177], [2.8e7, 1.32e8], [[0.9, 0.5, -0.8], [-1.0, 0.4, 0.9]])
    tool = Tool(0.08, 8, math.radians(60), pitch_angles=tuple(math.radians(d) for d in degrees))
    cut = (tool, engagement("down", 0.072, 0.08), CuttingCoefficients(1.8e9, 0.8e9, 0.3e9))
    found = limit_depth(machine, *cut, rpm)
    assert found.kind == kind
    mu = floquet_multipliers(machine, *cut, 1e-3 * found.limit_depth_mm, rpm, found.steps)[0]
    assert abs(mu) == pytest.approx(1.0, abs=5e-5)
    turns = found.chatter_frequency_Hz * 60 / rpm
    assert turns % 1 == pytest.approx({"flip": 0.5, "fold": 0.0}.get(kind, turns % 1), abs=1e-9)
    assert mu.real == pytest.approx(math.cos(2 * math.pi * turns), abs=1e-4)


@dataclass(frozen=True)
class ClosedLoop:
    """The moving one-axis bench: tip on a flexure on a carriage that a P-PI cascade holds (five states)."""

    gain: float
    integral: float
    position: float

    def state_space(self):
        m, carriage, k, c = 11.3, 23.1, 1.68e6, 104.0
        p, i = self.gain, 1.0 / self.integral
        a = np.zeros((5, 5))  # tip x, v; carriage x, v; integral of carriage x
        a[0, 1] = a[2, 3] = a[4, 2] = 1.0
        a[1, :4] = np.array([-k, -c, k, c]) / m
        a[3, :4] = np.array([k, c, -k, -c]) / carriage
        a[3, 2:] -= p * np.array([self.position + i, 1.0, i * self.position]) / carriage
        b, out = np.zeros((5, 3)), np.zeros((3, 5))
        b[1, 0], out[0, 0] = 1.0 / m, 1.0
        return a, b, out


@pytest.mark.parametrize(
    ("loop", "expected"),
    [  # Reference: the table of gains is rounded, which moves a limit by up to 0.4 %
        (ClosedLoop(3242, 21.2e-3, 23.5), [1.561, 2.722, 3.700, 3.034, 1.129, 1.137, 1.328, 1.734, 2.332]),
        (ClosedLoop(6268, 10.9e-3, 45.5), [1.922, 2.948, 3.858, 3.483, 1.646, 1.586, 1.760, 2.141, 2.693]),
        (ClosedLoop(18804, 3.6e-3, 136.6), [2.331, 1.485, 0.925, 0.732, 0.962, 1.433, 1.840, 2.436, 3.125]),
    ],
)
def test_a_closed_loop_in_motion(lab_slot, loop, expected):
    speeds = [800, 920, 1000, 1200, 1500, 1800, 2000, 2250, 2500]
    found = semi_discretization(loop, *lab_slot.cut, speeds)
    np.testing.assert_allclose(found.limit_depth, expected, rtol=5e-3)


@pytest.mark.parametrize(
    ("name", "cut"),
    [
        ("authors", "down"),
        ("ram", "up"),
        *(
            pytest.param(name, cut, marks=pytest.mark.slow)
            for name, cut in (("authors", "up"), ("authors", "central"), ("ram", "down"), ("ram", "central"))
        ),
    ],
)
def test_stable_everywhere_below_and_unstable_above(make_case, name, cut):
    case = make_case[name](cut, 50e-3)
    for rpm in (400, 700):
        limit = limit_depth(case.machine, *case.cut, rpm).limit_depth_mm
        assert max(radius(case, share * limit, rpm) for share in np.arange(0.02, 0.999, 0.04)) < 1.0
        assert radius(case, 0.999 * limit, rpm) < 1.0 < radius(case, 1.001 * limit, rpm)


def test_period_doubling_vibrates_at_odd_multiples_of_half_the_tooth_passing(make_case):
    case = make_case["benchmark"](1, 0.05)
    found = semi_discretization(case.machine, *case.cut, [10000, 15000])
    assert found.kind.values.tolist() == ["flip", "flip"]
    order = found.chatter_frequency.values / (np.array([10000, 15000]) * 2 / 60)
    np.testing.assert_allclose(order, [2.5, 1.5], rtol=1e-12)


def test_coinciding_poles_are_no_obstacle():
    # A critically damped mode has one vector for two poles.
    def limit(damping: float) -> float:
        a, b, c = ModalModel([50.0, 80.0], [0.5, 0.02], [2e7, 3e7], [[1, 0, 0], [0, 1, 0]]).state_space()
        a = a.copy()
        a[2, 2] *= damping / 0.5
        cut = (Tool(0.05, 3), engagement("down", 0.02, 0.05), CuttingCoefficients(1e9, 4e8, 1e8))
        return limit_depth(Shapes(a, b, c), *cut, 900).limit_depth_mm

    assert limit(1.0) == pytest.approx(0.5 * (limit(0.999) + limit(1.001)), rel=1e-4)


def test_a_fast_pole_costs_nothing(lab_slot):
    # A force filter of 10 us beside a period of 15 ms: the response is integrated exactly, its pole is not resolved.
    a, b, c = lab_slot.machine.state_space()
    lag = 1e-5
    filtered = np.block([[a, b], [np.zeros((3, 2)), -np.eye(3) / lag]])
    machine = Shapes(filtered, np.vstack([np.zeros((2, 3)), np.eye(3) / lag]), np.hstack([c, np.zeros((3, 3))]))
    found = semi_discretization(machine, *lab_slot.cut, [1000, 1500])
    exact = multi_frequency(machine, *lab_slot.cut, [1000, 1500], 1e-6)
    np.testing.assert_allclose(found.limit_depth, exact.limit_depth, rtol=1e-6)
    plain = semi_discretization(lab_slot.machine, *lab_slot.cut, [1000, 1500])
    assert np.all(np.abs(found.limit_depth / plain.limit_depth - 1) < 0.02)
    assert found.steps.values.tolist() == plain.steps.values.tolist()


def test_many_oscillations_a_period(lab_slot):
    # 61 Hz at 40 rpm: 23 waves between two teeth. The mean factor is exact here, so zero order is the reference.
    exact = zero_order(lab_slot.compliance(0.25, 400, 0.02), *lab_slot.cut, [40])
    found = semi_discretization(lab_slot.machine, *lab_slot.cut, [40])
    assert float(found.limit_depth[0]) == pytest.approx(float(exact.limit_depth[0]), rel=1e-4)


def test_labels(lab_slot):
    found = semi_discretization(lab_slot.machine, *lab_slot.cut, [1500, 1000])
    assert found.spindle_speed.values.tolist() == [1500, 1000]
    assert found.sel(spindle_speed=1000).limit_depth == pytest.approx(0.2470, rel=1e-3)
    assert {n: found[n].attrs.get("units") for n in ("limit_depth", "limit_depth_error", "chatter_frequency")} == {
        "limit_depth": "mm",
        "limit_depth_error": "mm",
        "chatter_frequency": "Hz",
    }
    assert found.attrs == {"method": "semi_discretization", "warnings": []}


class Shapes:
    def __init__(self, a, b, c):
        self.matrices = a, b, c

    def state_space(self):
        return self.matrices


def test_what_is_refused(lab_slot):
    machine = lab_slot.machine
    with pytest.raises(InputError, match="not stable without cutting"):
        limit_depth(Shapes(np.eye(2), np.ones((2, 3)), np.ones((3, 2))), *lab_slot.cut, 1000)
    with pytest.raises(InputError, match="A \\(N, N\\)"):
        limit_depth(Shapes(-np.eye(2), np.ones((2, 1)), np.ones((1, 2))), *lab_slot.cut, 1000)
    with pytest.raises(InputError, match="not finite"):
        limit_depth(Shapes(-np.eye(2), np.full((2, 3), np.nan), np.ones((3, 2))), *lab_slot.cut, 1000)
    with pytest.raises(InputError, match="nothing that could chatter"):
        limit_depth(ModalModel([50.0], [0.02], [1e7], [[0, 0, 1]]), *lab_slot.cut, 1000)
    with pytest.raises(InputError, match="depth 0 m"):
        floquet_multipliers(machine, *lab_slot.cut, 0.0, 1000)
    with pytest.raises(InputError, match="maximum depth"):
        stability_bands(machine, *lab_slot.cut, 1000, -1.0)
    with pytest.raises(InputError, match="tolerance is 2"):
        semi_discretization(machine, *lab_slot.cut, [1000], 2.0)
