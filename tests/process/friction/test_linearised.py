"""Equivalent damping of friction: closed forms, limits, symmetry, and the table of an independent program."""

import math

import numpy as np
import pytest
from scipy.special import ive

from process.errors import InputError
from process.friction.laws import Andersson, Coulomb, CoulombViscous, Viscous
from process.friction.linearised import DampingCurve, equivalent_damping, invariant_feed, linearised

MM_MIN = 1.0 / 60e3
BENCH = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)  # Table 1 of the paper, positive direction
BACKWARDS = Andersson(38.7, 88.0, 421.0 * MM_MIN, 150.0, 15000.0)
BOTH = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0, negative=BACKWARDS)

FEEDS = [0.0, 25.0, 50.0, 100.0, 250.0, 500.0, 1000.0]
# Reference: Andersson positive direction [N s/m]: amplitude [mm/min] -> a value for each feed.
REFERENCE = {
    1: [1.24e6, -5592, -5250, -4594, -3065, -1528, -298],
    20: [3.10e5, 3795, -5252, -4595, -3066, -1528, -299],
    100: [58760, 56769, 50342, 2171, -3092, -1542, -302],
    250: [21079, 20966, 20622, 19178, -1505, -1618, -323],
    500: [9232, 9221, 9187, 9049, 7983, -1293, -403],
    1000: [4035, 4034, 4031, 4019, 3933, 3586, -594],
    3000: [1312, 1312, 1311, 1311, 1308, 1297, 1252],
}


def coulomb_damping(coulomb: float, feed: float, amplitude: np.ndarray) -> np.ndarray:
    """c_eq of pure Coulomb friction: zero for V <= v0, else ``4 F/(pi V) sqrt(1 - (v0/V)^2)``."""
    return 4.0 * coulomb / (np.pi * amplitude) * np.sqrt(np.clip(1.0 - (feed / amplitude) ** 2, 0.0, None))


def stribeck_damping(law: Andersson, feed: float, amplitude: float) -> float:
    """c_eq of a sliding contact that never reverses, delta = 1: ``sigma - 2 (Fs - Fc) exp(-v0/vs) I1(V/vs)/V``."""
    vs = law.stribeck_speed
    bessel = ive(1, amplitude / vs) * np.exp((amplitude - feed) / vs)
    return float(law.sigma - 2.0 * (law.static - law.coulomb) * bessel / amplitude)


def tanh_damping(kt: float, feed: float, amplitude: float, terms: int = 20000) -> float:
    """c_eq of ``tanh(kt v)``, per newton, from ``tanh x = sum_n 2x/(x^2 + ((2n-1) pi/2)^2)``.

    ``4/(V b) {sum_n Re[1 - A_n/sqrt(A_n^2 - b^2)] + b^2/(2 pi^2 M)}``, ``A_n = kt v0 - j (2n - 1) pi/2``, ``b = kt V``,
    with the root for which ``|A - root| < |A + root|``; the tail after M terms is in closed form.
    """
    b = kt * amplitude
    a = kt * feed - 0.5j * np.pi * (2.0 * np.arange(1, terms + 1) - 1.0)
    root = np.sqrt(a**2 - b**2)
    root = np.where(np.abs(a - root) < np.abs(a + root), root, -root)
    # 1 - a/root without cancellation: (root - a)/root = -b^2/(root (root + a)).
    inside = float(np.sum(-(b**2) / (root * (root + a))).real) + b**2 / (2.0 * np.pi**2 * terms)
    return 4.0 * inside / (amplitude * b)


@pytest.mark.parametrize("amplitude", REFERENCE)
def test_the_bench_friction_has_the_tabulated_equivalent_damping(amplitude: int) -> None:
    found = equivalent_damping(BENCH, np.array(FEEDS) * MM_MIN, amplitude * MM_MIN)
    np.testing.assert_allclose(found, REFERENCE[amplitude], rtol=5e-3)


def test_viscous_friction_is_its_own_equivalent() -> None:
    np.testing.assert_array_equal(equivalent_damping(Viscous(168.0), [0.0, 0.01], 0.02), 168.0)


def test_a_small_vibration_is_damped_by_the_local_slope() -> None:
    v0 = np.array([0.0, 2.0, 25.0, 500.0, 1396.0]) * MM_MIN
    tiny = equivalent_damping(BENCH, v0, 1e-9)
    np.testing.assert_allclose(tiny, BENCH.slope(v0), rtol=1e-4, atol=0.01)
    np.testing.assert_array_equal(equivalent_damping(BENCH, v0, 0.0), BENCH.slope(v0))
    assert float(BENCH.slope(0.0)) == pytest.approx(84.0 * 15000.0 + 168.0)


def test_coulomb_friction_damps_only_when_the_motion_reverses() -> None:
    v0, v = 500.0 * MM_MIN, np.array([100.0, 499.0, 501.0, 600.0, 707.0, 1000.0, 5000.0]) * MM_MIN
    closed = coulomb_damping(44.2, v0, v)
    np.testing.assert_allclose(equivalent_damping(Coulomb(44.2), v0, v), closed, rtol=1e-9, atol=1e-9)
    assert np.all(closed[:2] == 0.0)
    np.testing.assert_allclose(equivalent_damping(CoulombViscous(44.2, 168.0), v0, v), closed + 168.0, rtol=1e-9)


def test_coulomb_damping_peaks_at_root_two_of_the_feed() -> None:
    v0 = 500.0 * MM_MIN
    assert 2 * 44.2 / (math.pi * v0) == pytest.approx(3377, abs=1)
    v = v0 * np.linspace(1.0, 2.0, 20001)
    damping = coulomb_damping(44.2, v0, v)
    assert damping.max() == pytest.approx(2 * 44.2 / (math.pi * v0), rel=1e-7)
    assert v[damping.argmax()] == pytest.approx(math.sqrt(2) * v0, rel=1e-3)
    smooth = equivalent_damping(Coulomb(44.2, 15000.0), v0, v[::100])
    assert smooth.max() == pytest.approx(3376, abs=1)


@pytest.mark.parametrize(("amplitude", "expected"), [(50.0, -1531.2374), (300.0, -1658.0313)])
def test_a_sliding_contact_follows_the_bessel_form(amplitude: float, expected: float) -> None:
    v0, v = 500.0 * MM_MIN, amplitude * MM_MIN
    assert float(stribeck_damping(BENCH, v0, v)) == pytest.approx(expected, abs=1e-3)
    assert float(equivalent_damping(BENCH, v0, v)) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize(
    ("feed", "amplitude", "expected"), [(0.0, 10.0, 7052.17), (500.0, 600.0, None), (25.0, 30.0, None)]
)
def test_the_tanh_series_equals_the_quadrature(feed: float, amplitude: float, expected: float | None) -> None:
    v0, v = feed * MM_MIN, amplitude * MM_MIN
    series = tanh_damping(15000.0, v0, v)
    assert series == pytest.approx(float(equivalent_damping(Coulomb(1.0, 15000.0), v0, v)), rel=1e-5)
    if expected is not None:
        assert series == pytest.approx(expected, abs=0.01)


def test_the_direction_of_motion_matters_only_for_an_asymmetric_law() -> None:
    v0, v = 30.0 * MM_MIN, np.array([10.0, 100.0, 1000.0]) * MM_MIN
    np.testing.assert_allclose(equivalent_damping(BENCH, -v0, v), equivalent_damping(BENCH, v0, v), rtol=1e-9)
    forth, back = equivalent_damping(BOTH, v0, v), equivalent_damping(BOTH, -v0, v)
    assert np.all(np.abs(forth - back) > 1e-3 * np.abs(forth))
    # At idle both directions share the period.
    mean = 0.5 * (equivalent_damping(BENCH, 0.0, v) + equivalent_damping(BACKWARDS, 0.0, v))
    np.testing.assert_allclose(equivalent_damping(BOTH, 0.0, v), mean, rtol=1e-6)


def test_the_graded_quadrature_equals_the_midpoint_rule() -> None:
    v0 = np.array([0.0, 1.0, 25.0, 100.0, 500.0, -40.0]) * MM_MIN
    t = (np.arange(100_000) + 0.5) * math.pi / 100_000
    for amplitude in (0.1, 20.0, 99.9, 100.1, 250.0, 3000.0):
        v = amplitude * MM_MIN
        dense = [2.0 * np.mean(BOTH.force(b + v * np.cos(t)) * np.cos(t)) / v for b in v0]
        np.testing.assert_allclose(equivalent_damping(BOTH, v0, v), dense, rtol=1e-7)


@pytest.mark.parametrize("delta", [0.5, 1.0, 2.0])
@pytest.mark.parametrize("kt", [300.0, math.inf])
def test_the_quadrature_takes_other_shapes_and_a_jump(delta: float, kt: float) -> None:
    law = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, kt, delta)
    v0, v = 100.0 * MM_MIN, 400.0 * MM_MIN
    turn = math.acos(-v0 / v)
    u = (np.arange(400_000) + 0.5) / 400_000
    total = 0.0
    for end in (0.0, math.pi):
        # t = turn + (end - turn) u^2 takes the singularity out.
        t = turn + (end - turn) * u**2
        total += abs(end - turn) * np.mean(law.force(v0 + v * np.cos(t)) * np.cos(t) * 2.0 * u)
    assert float(equivalent_damping(law, v0, v)) == pytest.approx(2.0 * total / (math.pi * v), rel=1e-6)


def test_the_curve_interpolates_the_quadrature() -> None:
    for feed in (0.0, 25.0, 100.0, 500.0, 1000.0):
        curve = DampingCurve(BENCH, feed * MM_MIN)
        between = np.sqrt(curve.amplitude[1:] * curve.amplitude[:-1])
        exact = equivalent_damping(BENCH, feed * MM_MIN, between)
        np.testing.assert_allclose(curve(between), exact, atol=2e-3 * np.abs(exact).max(), rtol=1e-3)
    np.testing.assert_array_equal(curve([0.0]), curve.damping[:1])
    np.testing.assert_array_equal(curve([7.0]), curve.damping[-1:])


def test_the_bench_is_invariant_above_the_larger_of_both_criteria() -> None:
    # 2 F/(pi Kp) = 305 mm/min for 50 N and K2.
    assert invariant_feed(Coulomb(44.2), 50.0, 6268.0, 1.0) / MM_MIN == pytest.approx(305, abs=1)
    # The slope of the Stribeck curve falls to a tenth of Kp where (Fs-Fc)/vs exp(-v/vs) = 0.1 Kp.
    vs = BENCH.stribeck_speed
    expected = vs * math.log((84.0 - 44.2) / vs / 626.8)
    assert invariant_feed(BENCH, 1.0, 6268.0) == pytest.approx(expected, rel=1e-6)


def test_what_is_not_possible_is_refused_with_what_is_needed() -> None:
    with pytest.raises(InputError, match="amplitudes >= 0"):
        equivalent_damping(BENCH, 0.0, -1.0)
    with pytest.raises(InputError, match="0 < lowest < highest"):
        DampingCurve(BENCH, 0.0, lowest=1.0, highest=0.5)
    with pytest.raises(InputError, match="must be positive"):
        invariant_feed(BENCH, 0.0, 1.0)


def test_at_rest_a_law_of_two_sides_damps_with_their_mean() -> None:
    # The limit of the describing function about rest, and the derivative from each side by differences.
    small = float(equivalent_damping(BOTH, 0.0, 1e-9))
    step = 1e-9
    sides = [float(BOTH.force(v)) / v for v in (step, -step)]
    assert float(BOTH.slope(0.0)) == pytest.approx(small, rel=1e-3)
    assert float(BOTH.slope(0.0)) == pytest.approx(np.mean(sides), rel=1e-3)
    assert float(BOTH.slope(0.0)) == linearised(BOTH, 0.0).direct
    assert float(BENCH.slope(0.0)) == pytest.approx(sides[0], rel=1e-3)
    moving = BOTH.slope(np.array([0.01, 0.0, -0.01]))
    assert np.allclose(moving[[0, 2]], [BENCH.slope(0.01), BACKWARDS.slope(0.01)], rtol=1e-12)
