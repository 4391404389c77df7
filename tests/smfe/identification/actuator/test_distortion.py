"""Random-phase multisines: levels of a polynomial in closed form, a second method, and what friction and joints show.

The physics is shown twice: by the simulation of the packages and by the independent generator.
"""

import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy import signal
from truth.axis import MM_MIN, RATE, Setting, Truth, simulate

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction.laws import Andersson, Viscous
from process.labels import make_record
from process.machine.joints import Iwan
from process.machine.machine import FeedAxis, Machine, MountedJoint
from process.machine.structure import two_mass_axes
from process.simulation.excitation import Multisine, all_harmonics, odd_random_harmonics
from process.simulation.machine import simulate_machine
from smfe.identification.actuator.distortion import Distortion, distortion

LINES = odd_random_harmonics(1, 199, 4, 3)
FS = 2048


def time(periods: float) -> np.ndarray:
    return np.arange(round(periods * FS)) / FS


def record(force: np.ndarray, response: np.ndarray, channel: str = "displacement") -> xr.Dataset:
    return make_record(np.arange(force.size) / FS, {"force": {"x": force}, channel: {"x": response}})


def wave(seed: int, periods: int, lines: tuple[int, ...] = LINES) -> np.ndarray:
    return Multisine(1.0, lines, 1.0, periods, seed, 0.0).force(time(periods))


def level(d: Distortion, kind: str) -> float:
    """Level [dB], or what hides it."""
    return max(d.level_db(kind), float(d.table.loc[kind, "floor_db"]))


# --- closed form ------------------------------------------------------------------------------------------------------


def polynomial_spectrum(seed: int, a: float, b: float) -> np.ndarray:
    """Complex amplitudes of x + a x^2 + b x^3 at lines 0 to 3 top: products are convolutions of two-sided spectra."""
    m = Multisine(1.0, LINES, 1.0, 1, seed, 0.0)
    top = LINES[-1]
    x = np.zeros(2 * top + 1, dtype=complex)
    half = 0.5 * math.sqrt(2.0 / len(LINES)) * np.exp(1j * m.phases)
    x[top + np.array(LINES)], x[top - np.array(LINES)] = half, half.conj()
    square = np.convolve(x, x)
    total = b * np.convolve(square, x)
    total[top:-top] += a * square
    total[2 * top : -2 * top] += x
    return 2.0 * total[3 * top :]


def ringing(drive: np.ndarray) -> np.ndarray:
    """A mass on a spring at 61 Hz, 3 %, from rest: its transient lives for a tenth of the period."""
    w = 2.0 * np.pi * 61.0
    b, a = signal.bilinear([w * w], [1.0, 0.06 * w, w * w], FS)
    return signal.lfilter(b, a, drive)


def filter_at(line: np.ndarray) -> np.ndarray:
    w = 2.0 * np.pi * 61.0
    b, a = signal.bilinear([w * w], [1.0, 0.06 * w, w * w], FS)
    return signal.freqz(b, a, line, fs=FS)[1]


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_levels_of_a_polynomial_before_a_resonance_are_those_of_its_convolutions(noise: float) -> None:
    # Six periods from rest: the transient is removed, not waited for.
    a, b, rng = 0.05, 0.02, np.random.default_rng(11)
    records, exact = [], []
    for seed in range(4):
        x = wave(seed, 6)
        y = ringing(x + a * x**2 + b * x**3)
        records.append(record(x, y + noise * rng.normal(size=y.size)))
        exact.append(polynomial_spectrum(seed, a, b)[1 : LINES[-1] + 1] * filter_at(np.arange(1, LINES[-1] + 1)))
    d = distortion(records, 1.0, LINES)
    power = np.mean(np.abs(exact) ** 2, axis=0)
    role = d.lines["role"].values
    for kind in ("even", "odd"):
        here = role == kind
        found = d.lines[kind].values[here]
        sd = d.lines["noise"].values[here]
        assert np.sum(found**2) == pytest.approx(np.sum(power[here]), rel=5e-3)
        assert np.all(np.abs(found**2 - power[here]) < 3e-2 * power[here] + 6.0 * sd * np.sqrt(power[here]) + 6 * sd**2)


@pytest.mark.parametrize(("realisations", "within"), [(12, 1e-3), pytest.param(40, 5e-4, marks=pytest.mark.slow)])
def test_the_best_linear_approximation_of_a_cube_is_raised_by_three_times_its_power(
    realisations: int, within: float
) -> None:
    # E{x^3 at k}/X(k) = 3 s^2 (1 - 1/(2 F)) for F equal lines with random phases.
    b = 0.02
    records = [record(x, x + b * x**3) for x in (wave(seed, 2) for seed in range(realisations))]
    d = distortion(records, 1.0, LINES)
    gain = d.lines["compliance"].values[np.array(LINES) - 1]
    sd = d.lines["compliance_std"].values[np.array(LINES) - 1]
    expected = 1.0 + 3.0 * b * (1.0 - 0.5 / len(LINES))
    z = (gain.real - expected) / (sd / math.sqrt(2.0))
    assert abs(gain.mean() - expected) < within
    # Neighbouring lines share their phases: the scatter is checked, not whiteness.
    assert 0.8 < z.std() < 1.25


@pytest.mark.parametrize(("realisations", "within"), [(12, 0.2), pytest.param(40, 0.1, marks=pytest.mark.slow)])
def test_the_scatter_of_realisations_is_what_the_lines_left_out_show(realisations: int, within: float) -> None:
    # One realisation knows the odd distortion from the lines left out; many know it from their scatter.
    x = [wave(seed, 2) for seed in range(realisations)]
    many = distortion([record(v, v + 0.02 * v**3) for v in x], 1.0, LINES)
    ones = [distortion([record(v, v + 0.02 * v**3)], 1.0, LINES) for v in x]
    at = np.array(LINES)[(np.array(LINES) > 20) & (np.array(LINES) < 180)] - 1
    scatter = np.mean(many.lines["compliance_std"].values[at] ** 2) * len(x)
    single = np.mean([np.mean(d.lines["compliance_std"].values[at] ** 2) for d in ones])
    assert single == pytest.approx(scatter, rel=within)


# --- second method, noise ---------------------------------------------------------------------------------------------


def test_settled_periods_averaged_by_hand_give_the_same() -> None:
    rng = np.random.default_rng(5)
    x = wave(1, 8)
    y = ringing(x + 0.05 * x**2) + 2e-3 * rng.normal(size=x.size)
    rec = record(x, y)
    d = distortion([rec], 1.0, LINES, start=2.0)
    each = 2.0 / FS * np.fft.rfft(y[2 * FS :].reshape(6, FS), axis=1)[:, 1:200]
    mean, variance = each.mean(axis=0), each.var(axis=0, ddof=1) / 6
    even = d.lines["role"].values == "even"
    by_hand = np.sum(np.abs(mean[even]) ** 2 - variance[even])
    assert np.nansum(d.lines["even"].values ** 2) == pytest.approx(by_hand, rel=1e-2)
    assert np.mean(d.lines["noise"].values ** 2) == pytest.approx(variance.mean(), rel=0.1)


@pytest.mark.parametrize(("runs_", "within"), [(10, 2.0), pytest.param(40, 1.0, marks=pytest.mark.slow)])
def test_noise_is_taken_off_and_does_not_pass_for_distortion(runs_: int, within: float) -> None:
    rng = np.random.default_rng(7)
    x = wave(2, 4)
    runs = [distortion([record(x, x + 0.1 * rng.normal(size=x.size))], 1.0, LINES) for _ in range(runs_)]
    # White noise of deviation s at amplitude 2/n sum y exp: power 4 s^2/n.
    expected = 4.0 * 0.01 / x.size
    assert np.mean([np.mean(d.lines["noise"].values ** 2) for d in runs]) == pytest.approx(expected, rel=0.03 * within)
    above = [float(d.level_db(k)) > float(d.table.loc[k, "floor_db"]) for d in runs for k in ("even", "odd")]
    assert np.mean(above) < 0.1 * within  # two standard deviations, one side
    at = np.array(LINES) - 1
    error = np.array([d.lines["compliance"].values[at] - 1.0 for d in runs])
    claimed = np.mean([d.lines["compliance_noise_std"].values[at] ** 2 for d in runs])
    assert np.mean(np.abs(error) ** 2) == pytest.approx(claimed, rel=0.05 * within)


def test_acceleration_and_displacement_say_the_same() -> None:
    rng = np.random.default_rng(8)
    line = np.arange(1, 400)
    amplitude = 1e-6 * rng.normal(size=line.size) / line
    phase = 2.0 * np.pi * np.outer(time(2), line)
    x = wave(0, 2)
    y = np.cos(phase) @ amplitude
    acceleration = np.cos(phase) @ (-((2.0 * np.pi * line) ** 2) * amplitude)
    one, other = (
        distortion([record(x, v, c)], 1.0, LINES) for v, c in ((y, "displacement"), (acceleration, "acceleration"))
    )
    np.testing.assert_allclose(one.lines["even"].values, other.lines["even"].values, rtol=1e-9, atol=1e-18)
    assert one.lines["even"].attrs["units"] == "m"
    assert one.lines["compliance"].attrs["units"] == "m/N"


def test_distortion_of_the_force_is_no_distortion_of_the_machine() -> None:
    x = wave(3, 3)
    force = x + 0.1 * x**2
    d = distortion([record(force, 2.0 * force)], 1.0, LINES)
    assert level(d, "even") < -200.0


@pytest.mark.parametrize(("periods", "gain"), [(3, 20.0), (6, 35.0), (12, 50.0)])
def test_a_transient_is_removed_the_better_the_closer_the_bins(periods: int, gain: float) -> None:
    # It lives for a tenth of a period. A linear system has no distortion: what even lines show is the transient.
    x = wave(4, periods)
    d = distortion([record(x, ringing(x))], 1.0, LINES)
    assert any("not settled" in text for text in d.warnings)
    even = d.lines["role"].values == "even"
    plain = 2.0 / x.size * np.fft.rfft(ringing(x))[periods * np.arange(1, 200)]
    reference = np.sum(d.lines["linear_response"].values[even] ** 2)
    as_it_is = 10.0 * np.log10(np.sum(np.abs(plain[even]) ** 2) / reference)
    assert level(d, "even") < as_it_is - gain
    assert d.level_db("even") < float(d.table.loc["even", "floor_db"])


def test_a_transient_longer_than_the_record_is_not_called_distortion() -> None:
    w = 2.0 * np.pi * 10.3
    b, a = signal.bilinear([w * w], [1.0, 0.01 * w, w * w], FS)
    x = wave(4, 6)
    d = distortion([record(x, signal.lfilter(b, a, x))], 1.0, LINES)
    for kind in ("even", "odd"):
        assert d.level_db(kind) < float(d.table.loc[kind, "floor_db"])


# --- what makes it uncertain -----------------------------------------------------------------------------------------


def test_what_cannot_be_known_is_said() -> None:
    x = wave(0, 4)
    one = distortion([record(x, x)], 1.0, LINES, periods=1)
    assert "one period is too few" in one.warnings[0]
    assert math.isnan(one.level_db("noise"))
    assert math.isnan(one.table.loc["even", "floor_db"])
    assert "two periods are few" in distortion([record(x, x)], 1.0, LINES, periods=2).warnings[0]
    full = all_harmonics(1, 99)
    y = wave(0, 4, full)
    said = " ".join(distortion([record(y, y)], 1.0, full).warnings)
    assert "even distortion cannot be seen" in said
    assert "odd distortion cannot be seen" in said
    assert distortion([record(x, x)], 1.0, LINES).warnings == ()


def test_clocks_that_differ_are_measured() -> None:
    m = Multisine(1.0, LINES, 1.0, 6, 0, 0.0)
    force = m.force(time(4) * (1.0 - 30e-6) + 0.1)
    d = distortion([record(force, force)], 1.0, LINES)
    assert d.clock_ppm == pytest.approx(30.0, rel=0.01)
    assert any("30 ppm" in text for text in d.warnings)


def test_a_response_that_does_not_repeat_is_warned_of() -> None:
    x = wave(0, 4)
    d = distortion([record(x, x + 0.3 * np.sin(2 * np.pi * 33.37 * time(4)))], 1.0, LINES)
    assert any("does not repeat" in text for text in d.warnings)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"fundamental": 1.1}, "whole number of samples"),
        ({"fundamental": 2.0}, "only .* of the power of the force"),
        ({"harmonics": (3, 1)}, "rising"),
        ({"harmonics": (1, 2001)}, "Nyquist"),
        ({"periods": 9}, "do not hold 9 periods"),
        ({"start": 3.5}, "do not hold"),
        ({"axis": "y"}, "force_x"),
    ],
)
def test_bad_input_is_one_sentence(change: dict, match: str) -> None:
    x = wave(0, 4)
    arguments = {"fundamental": 1.0, "harmonics": LINES, **change}
    with pytest.raises(InputError, match=match):
        distortion([record(x, x)], **arguments)


def test_no_record_and_unlike_records_are_refused() -> None:
    with pytest.raises(InputError, match="no record"):
        distortion([], 1.0, LINES)
    x = wave(0, 4)
    with pytest.raises(InputError, match="not sampled alike"):
        distortion([record(x, x), record(x, x).assign_coords(time=2.0 * time(4))], 1.0, LINES)
    with pytest.raises(InputError, match="no level of 'third'"):
        distortion([record(x, x)], 1.0, LINES).level_db("third")


# --- physics: a guideway is even in motion only, a joint never --------------------------------------------------------

BENCH = Drive(23.1, 11.3, 1.68e6, 104.0, Servo(6268.0, 10.9e-3, 45.5))
TABLE_1 = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, 15000.0)
BAND = odd_random_harmonics(11, 241, 4, 3)


def shaken(machine: Machine, feed: float, rms: float) -> Distortion:
    records = [
        simulate_machine(
            machine,
            duration=8.02,
            feed={"x": feed * MM_MIN},
            forces={"x": Multisine(0.5, BAND, rms, 4, seed, 0.02)},
            sample_rate=1000.0,
        )
        for seed in range(2)
    ]
    return distortion(records, 0.5, BAND, start=2.02, periods=3)


def slipping(share: float = 0.2) -> Machine:
    rest = two_mass_axes({"x": replace(BENCH, stiffness=(1.0 - share) * BENCH.stiffness)})
    joint = Iwan(share * BENCH.stiffness, 0.5 * share * BENCH.stiffness * 100e-6, 20)
    return Machine(rest, {"x": FeedAxis(BENCH.servo, Viscous(168.0))}, [MountedJoint(joint, [1.0, -1.0])])


@pytest.mark.parametrize("rms", [pytest.param(20.0, marks=pytest.mark.slow), 60.0])
def test_guideway_friction_is_even_in_motion_and_odd_at_rest(rms: float) -> None:
    guideway = Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(BENCH.servo, TABLE_1)})
    idle = shaken(guideway, 0.0, rms)
    assert level(idle, "even") < -120.0
    assert level(idle, "odd") > -15.0
    for feed in (250.0, 500.0, 1500.0):
        assert -47.0 < level(shaken(guideway, feed, rms), "even") < -9.0


def test_even_distortion_dies_out_when_the_feed_leaves_the_vibration_behind() -> None:
    guideway = Machine(two_mass_axes({"x": BENCH}), {"x": FeedAxis(BENCH.servo, TABLE_1)})
    found = [level(shaken(guideway, feed, 20.0), "even") for feed in (250.0, 500.0, 1500.0, 5000.0)]
    assert np.all(np.diff(found) < -10.0)
    assert found[-1] < -110.0


SLOW = pytest.mark.slow


@pytest.mark.parametrize("feed", [pytest.param(0.0, marks=SLOW), 500.0, pytest.param(1500.0, marks=SLOW)])
def test_a_joint_that_slips_stays_odd(feed: float) -> None:
    weak, strong = shaken(slipping(), feed, 20.0), shaken(slipping(), feed, 60.0)
    for d in (weak, strong):
        assert level(d, "even") < -120.0
    assert -40.0 < level(weak, "odd") < level(strong, "odd") - 5.0 < -25.0


# --- the same by the independent generator ----------------------------------------------------------------------------

ALIKE = {"coulomb": (44.2, 44.2), "static": (84.0, 84.0), "stribeck": (387.4 * MM_MIN,) * 2, "viscous": (168.0, 168.0)}
COARSE = odd_random_harmonics(6, 121, 4, 3)
FEEDS = (250.0, 500.0, 1500.0)


def true_axis(kind: str, share: float, feed: float, rms: float) -> Distortion:
    plain = Truth()
    friction = replace(plain.friction, kind=kind, **ALIKE)
    truth = replace(plain, friction=friction, joint=replace(plain.joint, slip_share=share))
    records = []
    for seed in range(2):
        each = rms * math.sqrt(2.0 / len(COARSE))
        phases = Multisine(1.0, COARSE, rms, 1, seed).phases
        waves = np.array([[each, k, p] for k, p in zip(COARSE, phases, strict=True)])
        none = np.zeros((0, 5))
        raw = simulate(truth, Setting(feed=feed * MM_MIN), none[:, :4], none, 4.0, waves)
        t = np.arange(raw.shape[1]) / RATE
        records.append(make_record(t, {"force": {"x": raw[3]}, "displacement": {"x": raw[4] - feed * MM_MIN * t}}))
    return distortion(records, 1.0, COARSE, start=1.0, periods=3)


@pytest.mark.parametrize(
    ("kind", "feeds"),
    [("stick", (500.0,)), *(pytest.param(k, FEEDS, marks=pytest.mark.slow) for k in ("lugre", "stick", "gms"))],
)
def test_truth_guideway_friction_is_even_in_motion_only(kind: str, feeds: tuple[float, ...]) -> None:
    # At 20 N not all elements of Maxwell slip slide: what the start left in them is even (-56 dB) and goes slowly.
    assert level(true_axis(kind, 0.0, 0.0, 60.0), "even") < -85.0
    for feed in feeds:
        assert -47.0 < level(true_axis(kind, 0.0, feed, 20.0), "even") < -8.0


@pytest.mark.parametrize("feed", [pytest.param(0.0, marks=SLOW), 500.0, pytest.param(1500.0, marks=SLOW)])
def test_truth_a_joint_that_slips_stays_odd(feed: float) -> None:
    d = true_axis("none", 0.2, feed, 60.0)
    assert level(d, "even") < -90.0
    assert level(d, "odd") == pytest.approx(-27.4, abs=0.5)


def test_a_prbs_of_one_period_gives_the_linear_response_and_says_that_it_gives_no_more() -> None:
    # Speed loop of a real axis, both directions: setpoint stands for the force, speed for the displacement.
    folder = os.environ.get("SMFE_DATA")
    if not folder or not (Path(folder) / "sinumerik_speedloop").is_dir():
        pytest.skip("SMFE_DATA does not name a folder with sinumerik_speedloop")
    data = np.load(Path(folder) / "sinumerik_speedloop" / "decoded_u_setpoint_y_actual.npz")
    found = []
    for u, y in zip(data["u"], data["y"], strict=True):
        rec = make_record(np.arange(u.size) * 0.125e-3, {"force": {"x": u}, "displacement": {"x": y}})
        found.append(distortion([rec], 8000.0 / 2047.0, all_harmonics(1, 25)))
    said = " ".join(found[0].warnings)
    assert "one period" in said
    assert "even distortion cannot be seen" in said
    forth, back = (d.lines["compliance"].values for d in found)
    assert np.abs(forth[:5]) == pytest.approx(1.0, abs=0.05)  # the loop follows slow setpoints
    difference = 10.0 * np.log10(np.sum(np.abs(forth - back) ** 2) / np.sum(np.abs(forth) ** 2))
    # Setpoints of opposite sign: half of the difference is what is even, to 100 Hz.
    assert difference == pytest.approx(-30.7, abs=0.5)


def test_one_axis_record_is_enough() -> None:
    forces = {"x": Multisine(0.5, BAND, 20.0, 4, 0, 0.02)}
    machine = Machine.of_axis(BENCH, Viscous(168.0))
    rec = simulate_machine(machine, duration=8.02, forces=forces, sample_rate=1000.0, step=1e-4)
    d = distortion([rec], 0.5, BAND, start=2.02, periods=3)
    at = np.array(BAND) - 1
    exact = replace(BENCH, sigma=168.0).tip_compliance(0.5 * np.array(BAND))
    np.testing.assert_allclose(d.lines["compliance"].values[at], exact, rtol=1e-4)
