"""One axis, linear: Eqs. (2) and (4), poles, limits and stick-slip against reference numbers and other methods.

Numbers marked as reference come from an independent program (the same equations, another implementation).
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import Andersson
from process.labels import check_compliance

MM_MIN = 1.0 / 6e4
SERVOS = {
    "K1": Servo(3242.0, 21.2e-3, 23.5),
    "K2": Servo(6268.0, 10.9e-3, 45.5),
    "K3": Servo(10590.0, 6.5e-3, 76.9),
    "K4": Servo(18804.0, 3.6e-3, 136.6),
}
FRICTION = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)


def bench(servo: str | None = "K2", sigma: float = 0.0, delay: float = 0.0) -> Drive:
    chosen = None if servo is None else replace(SERVOS[servo], delay=delay)
    return Drive(23.1, 11.3, 1.68e6, 104.0, chosen, sigma)


def direct(drive: Drive, f: np.ndarray) -> np.ndarray:
    """The two equations of motion, solved as they stand."""
    out = np.empty(f.size, complex)
    for i, s in enumerate(2j * np.pi * f):
        joint = drive.damping * s + drive.stiffness
        g = 0.0 if drive.servo is None else drive.servo.feedback(s)
        matrix = [
            [drive.tip_mass * s**2 + joint, -joint],
            [-joint, drive.moving_mass * s**2 + drive.sigma * s + joint + g],
        ]
        out[i] = np.linalg.solve(matrix, [1.0, 0.0])[0]
    return out


@pytest.mark.parametrize("delay", [0.0, 0.75e-3])
@pytest.mark.parametrize("sigma", [0.0, 168.0, -1528.0, 1.26e6])
@pytest.mark.parametrize("servo", [*SERVOS, None])
def test_the_compliance_is_the_solution_of_the_equations_of_motion(servo: str, sigma: float, delay: float) -> None:
    f = np.geomspace(0.5, 500.0, 100)
    drive = bench(servo, sigma, delay)
    np.testing.assert_allclose(drive.tip_transfer(2j * np.pi * f), direct(drive, f), rtol=1e-11)


def test_the_printed_equation_4_lacks_sigma_s_in_its_numerator() -> None:
    f = np.arange(5.0, 200.0, 0.05)
    s = 2j * np.pi * f
    for sigma, low, high in ((0.0, 0.0, 1e-12), (168.0, 0.009, 0.017)):
        drive = bench("K2", sigma)
        mm, mt, k, c = 23.1, 11.3, 1.68e6, 104.0
        g = drive.servo.feedback(s)  # type: ignore[union-attr]
        printed = (g + mm * s**2 + c * s + k) / (
            (mt * s**2 + c * s + k) * g
            + mm * mt * s**4
            + (mm * c + mt * (sigma + c)) * s**3
            + ((mm + mt) * k + sigma * c) * s**2
            + sigma * k * s
        )
        right = drive.tip_compliance(f)
        error = np.abs(printed - right).max() / np.abs(right).max()
        assert low <= error <= high


# servo, sigma, delay: |Phi|max [um/N] and its frequency above 20 Hz, min Re [um/N] and its frequency: reference.
IN_MOTION = [
    ("K1", 0.0, 0.0, 2.19, 74.6, -1.321, 78.4),
    ("K2", 0.0, 0.0, 2.31, 20.0, -0.9195, 79.1),
    ("K3", 0.0, 0.0, 1.68, 35.2, -0.7925, 75.5),
    ("K4", 0.0, 0.0, 4.56, 54.9, -1.950, 60.4),
    ("K2", 168.0, 0.0, 2.25, 20.0, -0.9164, None),
    ("K2", -1528.0, 0.0, 3.03, 20.4, -0.9806, None),
    ("K2", 0.0, 0.75e-3, 2.51, 20.0, -0.7413, None),
    ("K3", 0.0, 0.75e-3, 2.13, None, -0.6191, None),
    ("K4", 0.0, 0.75e-3, 8.13, None, -3.596, None),
]


@pytest.mark.parametrize(("servo", "sigma", "delay", "peak", "at", "least", "least_at"), IN_MOTION)
def test_the_bench_in_motion_has_its_reference_compliance(
    servo: str, sigma: float, delay: float, peak: float, at: float | None, least: float, least_at: float | None
) -> None:
    f = np.arange(20.0, 200.0, 0.01)
    phi = bench(servo, sigma, delay).tip_compliance(f) * 1e6
    assert np.abs(phi).max() == pytest.approx(peak, abs=0.0051)
    assert phi.real.min() == pytest.approx(least, abs=6e-4)
    if at is not None:
        assert f[np.abs(phi).argmax()] == pytest.approx(at, abs=0.05)
    if least_at is not None:
        assert f[phi.real.argmin()] == pytest.approx(least_at, abs=0.06)


# Reference: natural frequency [Hz] and damping ratio of both pole pairs, sigma 0, no delay.
POLES = {
    "K1": ((11.5, 0.51), (74.7, 0.064)),
    "K2": ((22.4, 0.49), (74.1, 0.116)),
    "K3": ((38.9, 0.43), (71.8, 0.218)),
    "K4": ((55.3, 0.088), (90.3, 0.57)),
}


@pytest.mark.parametrize("servo", POLES)
def test_the_closed_loop_has_its_reference_poles(servo: str) -> None:
    for (f, zeta), (f_ref, zeta_ref) in zip(bench(servo).modes(), POLES[servo], strict=True):
        assert f == pytest.approx(f_ref, abs=0.05)
        assert zeta == pytest.approx(zeta_ref, abs=0.0051)


def test_k3_and_not_k2_damps_the_structure_most() -> None:
    # The paper calls K2 the maximum-damping controller; its own Eq. (4) does not.
    structural = {name: min(bench(name).modes()[:, 1]) for name in SERVOS}
    assert max(structural, key=lambda name: structural[name]) == "K3"


@pytest.mark.parametrize("servo", SERVOS)
def test_poles_are_roots_of_the_characteristic_polynomial(servo: str) -> None:
    drive, v = bench(servo, 168.0), SERVOS[servo]
    mm, mt, k, c, sigma = 23.1, 11.3, 1.68e6, 104.0, 168.0
    # Ti s D + Kp (s + Kv)(Ti s + 1) N with Eq. (2) = N/D, falling powers.
    d = [mm * mt, c * (mm + mt) + sigma * mt, k * (mm + mt) + sigma * c, sigma * k, 0.0]
    n = [mt, c, k]
    total = np.polyadd(np.polymul([v.Ti, 0.0], d), v.Kp * np.polymul(np.polymul([1.0, v.Kv], [v.Ti, 1.0]), n))
    np.testing.assert_allclose(np.sort_complex(np.roots(total)), np.sort_complex(drive.poles()), rtol=1e-8)
    a, b, out, gain = drive.state_space()
    closed = a - np.outer([0, 0, 0, 1 / drive.moving_mass, 0], gain)
    s = 2j * np.pi * 33.0
    assert out @ np.linalg.solve(s * np.eye(5) - closed, b) == pytest.approx(drive.tip_compliance(33.0), rel=1e-9)


@pytest.mark.parametrize("servo", SERVOS)
def test_poles_with_delay_are_poles_of_the_compliance(servo: str) -> None:
    drive = bench(servo, 168.0, 0.75e-3)
    for pole in drive.poles():
        # A simple pole: a hundred times nearer, a hundred times larger.
        near, nearer = (abs(drive.tip_transfer(pole * (1 + e))) for e in (1e-6, 1e-8))
        assert nearer / near == pytest.approx(1e2, rel=0.05)


def test_poles_move_continuously_from_no_delay() -> None:
    none, tiny = bench("K3").modes(), bench("K3", delay=1e-6).modes()
    np.testing.assert_allclose(tiny[:2], none, rtol=2e-3)


def test_delay_raises_the_damping_of_k1_to_k3_and_lowers_that_of_k4() -> None:
    for servo in SERVOS:
        before, after = (min(bench(servo, delay=d).modes()[:2, 1]) for d in (0.0, 0.75e-3))
        # K3: the servo pair is the less damped one with delay; its structural pair gains.
        gains = bench(servo, delay=0.75e-3).modes()[1, 1] > bench(servo).modes()[1, 1]
        assert gains if servo != "K4" else after < before


def test_the_limits_of_the_gain_are_a_free_and_a_locked_carriage() -> None:
    f = np.arange(20.0, 150.0, 0.5)
    soft = Drive(23.1, 11.3, 1.68e6, 104.0, Servo(1e-3, 1e6, 1e-3))
    np.testing.assert_allclose(soft.tip_compliance(f), bench(None).tip_compliance(f), rtol=1e-5)
    stiff = Drive(23.1, 11.3, 1.68e6, 104.0, Servo(1e9, 1e-2, 40.0))
    s = 2j * np.pi * f
    locked = 1.0 / (11.3 * s**2 + 104.0 * s + 1.68e6)
    np.testing.assert_allclose(stiff.tip_compliance(f), locked, rtol=1e-3)
    assert bench().locked_frequency == pytest.approx(61.367, abs=1e-3)
    assert bench().locked_damping == pytest.approx(0.011935, abs=1e-6)
    # Friction that sticks locks the carriage too: the sigma s in the numerator is needed for that.
    stuck = bench("K2", FRICTION.slope(0.0).item())
    assert f[np.abs(stuck.tip_compliance(f)).argmax()] == pytest.approx(61.37, abs=0.5)


def test_any_servo_with_an_integrator_leaves_the_static_compliance_of_the_flexure() -> None:
    for servo in SERVOS:
        drive = bench(servo, 168.0, 0.75e-3)
        assert drive.tip_compliance(0.0) == pytest.approx(1.0 / 1.68e6)
    assert np.abs(bench(None).tip_compliance(1e-3)) > 1e-3


def test_the_open_loop_has_its_anti_resonance_at_61_and_its_resonance_at_75_hz() -> None:
    f = np.arange(30.0, 120.0, 0.01)
    h = np.abs(bench(None).open_loop(f))
    assert f[h.argmin()] == pytest.approx(61.3, abs=0.1)
    assert f[h[3200:].argmax() + 3200] == pytest.approx(75.0, abs=0.1)
    # The delay turns the phase and leaves the magnitude.
    late = bench(None).open_loop(f, 0.75e-3)
    np.testing.assert_allclose(np.abs(late), h)
    np.testing.assert_allclose(late / bench(None).open_loop(f), np.exp(-2j * np.pi * f * 0.75e-3))


# Reference, 500 mm/min, above 8 Hz: simulated peak [um/N], and Eq. (4) with sigma 0; agreement with the local slope.
FIGURE_16 = {"K1": (12.5, 6.7, 0.06), "K2": (3.02, 2.40, 0.03), "K3": (1.96, 1.68, 0.02), "K4": (4.89, 4.56, 0.005)}


@pytest.mark.parametrize("servo", FIGURE_16)
def test_the_local_friction_slope_brings_equation_4_to_the_simulated_peak(servo: str) -> None:
    simulated, without, agreement = FIGURE_16[servo]
    f = np.arange(8.0, 100.0, 0.01)
    assert np.abs(bench(servo).tip_compliance(f)).max() * 1e6 == pytest.approx(without, rel=5e-3)
    slope = FRICTION.slope(500.0 * MM_MIN).item()
    assert slope == pytest.approx(-1528.0, abs=1.0)
    assert np.abs(bench(servo, slope).tip_compliance(f)).max() * 1e6 == pytest.approx(simulated, rel=agreement)


def is_unstable(servo: str, feed: float) -> bool:
    """Uniform motion at a feed [mm/min], with the local friction slope."""
    return bench(servo, FRICTION.slope(feed * MM_MIN).item()).unstable_poles() > 0


@pytest.mark.parametrize(("servo", "first", "last"), [("K1", 15, 297), ("K2", 19, 56)])
def test_slow_uniform_motion_is_unstable(servo: str, first: int, last: int) -> None:
    # The reference names whole mm/min.
    assert [is_unstable(servo, feed) for feed in (first - 1, first, last, last + 1)] == [False, True, True, False]
    for feed in np.geomspace(1.0, 2000.0, 40):
        assert is_unstable(servo, feed) == (first - 1 < feed < last + 1)


@pytest.mark.parametrize("servo", ["K3", "K4"])
def test_a_stiff_servo_has_no_stick_slip(servo: str) -> None:
    assert not any(is_unstable(servo, feed) for feed in np.geomspace(1.0, 2000.0, 100))


def test_an_unstable_axis_is_refused_but_its_poles_are_not() -> None:
    drive = bench("K2", FRICTION.slope(40.0 * MM_MIN).item())
    assert drive.unstable_poles() == 2
    assert drive.poles()[0].real > 0.0
    assert drive.modes()[:, 1].min() < 0.0
    with pytest.raises(InputError, match=r"friction slope -5391\.45 N s/m\) is unstable.*falling"):
        drive.tip_compliance(30.0)


def test_a_free_carriage_is_unstable_only_where_friction_falls() -> None:
    assert [bench(None, sigma).unstable_poles() for sigma in (0.0, 168.0)] == [0, 0]
    assert bench(None, -1000.0).unstable_poles() > 0
    # Its oscillation is the open-loop resonance.
    assert bench(None).modes()[0] == pytest.approx([74.88, 0.01456], rel=1e-3)


def test_the_labelled_compliance_carries_its_axis() -> None:
    data = check_compliance(bench().compliance([10.0, 20.0], "y"))
    assert data["compliance"].sel(response="y", excitation="y").shape == (2,)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"moving_mass": -23.1}, "moving mass is -23.1 kg; it must be positive"),
        ({"tip_mass": 0.0}, "tip mass is 0 kg"),
        ({"stiffness": math.inf}, "stiffness is inf"),
        ({"damping": -1.0}, "damping is -1 N s/m"),
        ({"sigma": math.nan}, "friction slope is nan"),
    ],
)
def test_an_impossible_axis_is_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        replace(bench(), **change)
