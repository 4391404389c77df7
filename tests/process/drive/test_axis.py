"""One axis, linear: Eqs. (2) and (4), poles, limits and stick-slip against reference numbers and other methods.

Numbers marked as reference come from an independent program (theory.md, sections 2.5(b), 3.2 and 3.3).
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy import signal

from process.drive.axis import PARAMETERS, Drive, fit_open_loop, open_loop_response, unstable_feeds
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import Andersson
from process.labels import check_compliance, make_record

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
def test_poles_of_the_polynomial_are_eigenvalues_of_the_state_matrix(servo: str) -> None:
    drive = bench(servo, 168.0)
    a, b, c, gain = drive.state_space()
    closed = a - np.outer([0, 0, 0, 1 / drive.moving_mass, 0], gain)
    np.testing.assert_allclose(np.sort_complex(np.linalg.eigvals(closed)), np.sort_complex(drive.poles()), rtol=1e-8)
    s = 2j * np.pi * 33.0
    assert c @ np.linalg.solve(s * np.eye(5) - closed, b) == pytest.approx(drive.tip_compliance(33.0), rel=1e-9)


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
    locked = bench().locked_compliance(f)
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
        assert drive.static_compliance == pytest.approx(0.595e-6, rel=1e-3)
    assert bench(None).static_compliance == math.inf
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


@pytest.mark.parametrize(("servo", "first", "last"), [("K1", 15, 297), ("K2", 19, 56)])
def test_slow_uniform_motion_is_unstable(servo: str, first: int, last: int) -> None:
    ((low, high),) = unstable_feeds(bench(servo), FRICTION.slope, MM_MIN, 2000.0 * MM_MIN, 100)  # type: ignore[misc]
    # The reference names whole mm/min.
    assert (math.ceil(low / MM_MIN), math.floor(high / MM_MIN)) == (first, last)


@pytest.mark.parametrize("servo", ["K3", "K4"])
def test_a_stiff_servo_has_no_stick_slip(servo: str) -> None:
    assert unstable_feeds(bench(servo), FRICTION.slope, MM_MIN, 2000.0 * MM_MIN, 100) == []


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


TRUTH = dict(zip(PARAMETERS, (23.1, 11.3, 1.68e6, 104.0, 168.0, 0.75e-3), strict=True))


def measured(noise: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    f = np.arange(4.0, 200.0, 0.5)
    rng = np.random.default_rng(seed)
    h = bench(None, 168.0).open_loop(f, 0.75e-3)
    return f, h * (1 + noise * (rng.standard_normal(f.size) + 1j * rng.standard_normal(f.size)) / math.sqrt(2))


def found(fit: object) -> np.ndarray:
    drive = fit.drive  # type: ignore[attr-defined]
    values = [getattr(drive, name) for name in PARAMETERS[:5]]
    return np.array([*values, fit.delay])  # type: ignore[attr-defined]


def test_the_fit_recovers_table_1_from_a_clean_response() -> None:
    np.testing.assert_allclose(found(fit_open_loop(*measured(0.0, 1))), list(TRUTH.values()), rtol=1e-6)


def test_the_stated_uncertainty_of_the_fit_is_its_scatter() -> None:
    fits = [fit_open_loop(*measured(0.03, seed)) for seed in range(40)]
    scatter = np.std([found(fit) for fit in fits], axis=0, ddof=1)
    stated = np.mean([list(fit.std.values()) for fit in fits], axis=0)
    np.testing.assert_allclose(stated / scatter, 1.0, atol=0.35)
    bias = np.mean([found(fit) for fit in fits], axis=0) - list(TRUTH.values())
    assert np.all(np.abs(bias) < 4.0 * scatter / math.sqrt(40))
    assert fits[0].misfit == pytest.approx(0.03, rel=0.1)


def test_a_fit_needs_enough_lines() -> None:
    with pytest.raises(InputError, match="at least 4 lines"):
        fit_open_loop([1.0, 2.0], [1.0, 1.0])


TICK, LENGTH, PERIODS = 2e-3, 1023, 9
FEED = 500.0 * MM_MIN


def pseudo_random_run() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, drive force and carriage position of Table 1 in motion, sampled at 2 kHz: exact steps of 0.25 ms.

    The force is a binary sequence of +-60 N, which is held for 2 ms and acts three steps late, on top of what the
    viscous friction takes at 500 mm/min.
    """
    mt, mm, k, c, sigma = 11.3, 23.1, 1.68e6, 104.0, 168.0
    a = np.array([[0, 1, 0, 0], [-k / mt, -c / mt, k / mt, c / mt], [0, 0, 0, 1], [k / mm, c / mm, -k / mm, 0]])
    a[3, 3] = -(c + sigma) / mm
    step, per_tick = 0.25e-3, 8
    system = (a, np.array([[0.0], [0.0], [0.0], [1.0 / mm]]), np.eye(4), np.zeros((4, 1)))
    a_d, b_d, *_ = signal.cont2discrete(system, step, "zoh")
    bits = 2.0 * signal.max_len_seq(10)[0] - 1.0
    force = np.tile(np.repeat(60.0 * bits, per_tick), PERIODS) + sigma * FEED
    late = np.concatenate([np.full(3, sigma * FEED), force[:-3]])
    q, out = np.array([0.0, FEED, 0.0, FEED]), np.empty(force.size)
    for i, push in enumerate(late):
        out[i] = q[2]
        q = a_d @ q + b_d[:, 0] * push
    return np.arange(force.size // 2) * 0.5e-3, force[::2], out[::2]


@pytest.fixture(scope="module")
def clean_run() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return pseudo_random_run()


def as_read(run: tuple[np.ndarray, np.ndarray, np.ndarray], seed: int | None = None) -> xr.Dataset:
    """The record: with a seed, the encoder has steps of 0.1 um and noise of 0.2 um, the force channel noise of 1 N."""
    time, force, position = run
    if seed is not None:
        rng = np.random.default_rng(seed)
        position = 1e-7 * np.round((position + 2e-7 * rng.standard_normal(time.size)) / 1e-7)
        force = force + rng.standard_normal(time.size)
    return make_record(time, {"encoder_position": {"y": position}, "drive_force": {"y": force}})


Run = tuple[np.ndarray, np.ndarray, np.ndarray]
BAND = {"hold": 0.5e-3, "band": (3.0, 200.0), "dry_friction": False}


def test_whole_periods_give_the_open_loop_without_leakage(clean_run: Run) -> None:
    measured = open_loop_response(as_read(clean_run), "y", LENGTH * TICK, skip=3, **BAND)  # type: ignore[arg-type]
    assert measured.attrs["periods"] == PERIODS - 3
    np.testing.assert_allclose(np.diff(measured["frequency"]), 1.0 / (LENGTH * TICK), rtol=1e-9)
    exact = bench(None, 168.0).open_loop(measured["frequency"].values, 0.75e-3)
    # What is left is folded down from above half the sampling rate.
    error = np.abs(measured["response"].values / exact - 1.0)
    f = measured["frequency"].values
    assert error[(f < 50.0) | ((f > 70.0) & (f < 100.0))].max() < 1e-4
    assert error[np.abs(f - 61.4) > 2.0].max() < 1e-3
    assert measured["coherence"].values.min() > 1.0 - 1e-6
    # Without the hold it is half a sample that reads as dead time.
    other = open_loop_response(as_read(clean_run), "y", LENGTH * TICK, skip=3, band=(3.0, 50.0), dry_friction=False)
    turned = other["response"].values / exact[: other.sizes["frequency"]]
    np.testing.assert_allclose(np.angle(turned), -np.pi * other["frequency"].values * 0.5e-3, atol=1e-3)


def test_table_1_comes_back_within_its_95_percent_intervals(clean_run: Run) -> None:
    scores = []
    for seed in range(12):
        measured = open_loop_response(as_read(clean_run, seed), "y", LENGTH * TICK, **BAND)  # type: ignore[arg-type]
        fit = fit_open_loop(measured["frequency"], measured["response"], measured["std"])
        scores.append((found(fit) - list(TRUTH.values())) / list(fit.std.values()))
        np.testing.assert_allclose(found(fit)[:3], [23.1, 11.3, 1.68e6], rtol=0.02)
    inside = np.mean(np.abs(scores) < 1.96)
    # 72 parameters: 95 % and three standard deviations of that share.
    assert inside > 0.95 - 3.0 * math.sqrt(0.95 * 0.05 / 72), np.round(scores, 1)
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.3)


def test_the_stated_deviation_of_the_open_loop_is_its_scatter(clean_run: Run) -> None:
    exact = open_loop_response(as_read(clean_run), "y", LENGTH * TICK, **BAND)  # type: ignore[arg-type]
    noisy = [open_loop_response(as_read(clean_run, s), "y", LENGTH * TICK, **BAND) for s in range(12)]  # type: ignore[arg-type]
    power = np.mean([np.abs((n["response"] - exact["response"]) / n["std"]) ** 2 for n in noisy])
    assert power == pytest.approx(1.0, abs=0.1)
    # Noise that lowers the coherence by 1 - g2 has that share of the power.
    one = noisy[0]
    share = (one["std"] / np.abs(one["response"])) ** 2 * (PERIODS - 1)
    lowest = one["coherence"].values < 0.99
    assert lowest.any()
    ratio = (1.0 / one["coherence"].values - 1.0)[lowest] / share.values[lowest]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.35)


def test_noise_that_goes_around_a_closed_loop_does_not_bias_the_response() -> None:
    # x = 2 f + n and f = r - x/2, so that a cross spectrum would lie between 2 and -2.
    rng, n, count = np.random.default_rng(9), 64, 400
    # Equal lines of random phase, root mean square about 1.
    lines = np.concatenate([[0.0], np.exp(2j * np.pi * rng.random(31)), [0.0]])
    asked, noise = np.tile(np.fft.irfft(math.sqrt(n) * lines), count), rng.standard_normal(n * count)
    force, position = 0.5 * (asked - 0.5 * noise), 0.5 * (2.0 * asked + noise)
    record = make_record(
        np.arange(n * count) * 1e-3, {"encoder_position": {"x": position}, "drive_force": {"x": force}}
    )
    measured = open_loop_response(record, "x", 0.064, skip=0, dry_friction=False)
    score = (measured["response"] - 2.0) / measured["std"]
    assert float(np.mean(np.abs(score) ** 2)) == pytest.approx(1.0, abs=0.5)
    f_p, x_p = (np.fft.rfft(v.reshape(count, n), axis=1)[:, 1:32] for v in (force, position))
    biased = np.mean(x_p * np.conj(f_p), axis=0) / np.mean(np.abs(f_p) ** 2, axis=0)
    assert np.mean(biased.real) < 1.7
    mean_std = math.sqrt(float(np.mean(measured["std"] ** 2)) / 31)
    assert abs(float(np.mean(measured["response"].real)) - 2.0) < 3.0 * mean_std < 0.1


def test_lines_that_the_force_does_not_excite_are_left_out() -> None:
    t = np.arange(4000) * 1e-3
    force = sum(np.cos(2.0 * np.pi * k * t + k**2) for k in (3, 5, 9, 11))
    position = sum(0.1 * np.cos(2.0 * np.pi * k * t + k**2 - 1.0) for k in (3, 5, 9, 11)) + 0.02 * t
    record = make_record(t, {"encoder_position": {"x": position}, "drive_force": {"x": force}})
    measured = open_loop_response(record, "x", 1.0, dry_friction=False)
    np.testing.assert_allclose(measured["frequency"], [3.0, 5.0, 9.0, 11.0])
    np.testing.assert_allclose(measured["response"], 0.1 * np.exp(-1j), rtol=1e-9)


def test_a_record_without_whole_periods_is_refused(clean_run: Run) -> None:
    record = as_read(clean_run)
    for arguments, options, message in (
        (("y", 1.00025), {}, "a whole number, 4 or more"),
        (("y", 0.0), {}, "a whole number, 4 or more"),
        (("y", LENGTH * TICK), {"skip": 8}, "9 periods and 8 are skipped; 2 more"),
        (("x", LENGTH * TICK), {}, "no encoder_position on axis 'x'"),
        (("y", LENGTH * TICK), {"hold": 1e-3}, "the sampling interval"),
        (("y", LENGTH * TICK), {"band": (300.1, 300.2)}, "widen the band"),
    ):
        with pytest.raises(InputError, match=message):
            open_loop_response(record, *arguments, dry_friction=False, **options)  # type: ignore[arg-type]
