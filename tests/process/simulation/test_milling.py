"""The time simulation against closed forms: linear response, static forces, the lab slot, order of convergence."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import root

from process.cut import _kernels as _cutting_kernels
from process.cut.engagement import Engagement, engagement
from process.cut.force import CuttingCoefficients, ProcessDamping, force_harmonics, force_projection, gram_matrix
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.modes import ModalModel
from process.simulation.machine import step_error
from process.simulation.milling import (
    MillingCut,
    Spindle,
    default_step,
    pack_motion,
    simulate_forced,
    simulate_milling,
)

BENCH = ModalModel([61.367], [0.011935], [1.68e6], [(1.0, 0.0, 0.0)])
BENCH_CUT = {"tool": Tool(0.0508, 4), "coefficients": CuttingCoefficients(780e6, 351e6, 0.0)}
SLOT = engagement("up", 0.0508, 0.0508)
RIGID = ModalModel([900.0], [0.5], [1e13], [(1.0, 1.0, 1.0)])
FACE_MILL = Tool(0.125, 8, math.radians(45.0))
STEEL = CuttingCoefficients(1800e6, 700e6, 250e6, 30e3, 45e3, 5e3)


def test_the_free_decay_after_an_impulse_is_the_closed_form() -> None:
    rate, n = 5000.0, 10000
    force = np.zeros((3, n))
    force[0, 10] = rate  # a triangle of area 1 N s
    x = simulate_forced(BENCH, force, rate)["displacement"].sel(axis="x").values
    w, z = 2 * np.pi * 61.367, 0.011935
    wd, t = w * math.sqrt(1 - z**2), (np.arange(n) - 10) / rate
    # The triangle spans two samples; its transform at the natural frequency is sinc^2.
    expected = np.exp(-z * w * t) * np.sin(wd * t) / (BENCH.mass[0] * wd) * np.sinc(w / (2 * np.pi * rate)) ** 2
    np.testing.assert_allclose(x[20:], expected[20:], atol=1e-3 * np.abs(expected).max())


def test_a_sine_settles_to_the_compliance() -> None:
    machine = ModalModel([33.0, 58.0], [0.06, 0.03], [45e6, 37e6], [(0.1, 0.6, 0.8), (1.0, 0.0, 0.1)])
    rate, f = 4000.0, 40.0
    t = np.arange(int(4 * rate)) / rate
    force = np.zeros((3, t.size))
    force[1] = 100 * np.cos(2 * np.pi * f * t)
    record = simulate_forced(machine, force, rate)
    last = slice(int(3 * rate), None)
    kernel = np.exp(-2j * np.pi * f * t[last]) * 2 / t[last].size
    phasor = record["displacement"].values[:, last] @ kernel
    np.testing.assert_allclose(phasor / 100, machine.matrix(f)[0, :, 1], rtol=2e-3)
    # Acceleration and displacement are the same motion.
    acceleration = record["acceleration"].values[:, last] @ kernel
    np.testing.assert_allclose(acceleration, -((2 * np.pi * f) ** 2) * phasor, rtol=1e-3)


@pytest.mark.parametrize(("cut", "width"), [("down", 37.5e-3), ("up", 62.5e-3), ("central", 106e-3)])
def test_on_a_rigid_machine_the_force_has_the_closed_form_harmonics(cut: str, width: float) -> None:
    arc = engagement(cut, width, 0.125)
    milling = MillingCut(FACE_MILL, arc, STEEL, 2e-3, feed_per_tooth=2e-4)
    record = simulate_milling(RIGID, milling, Spindle(2 * math.pi * 5.0), 2.0, 8000.0)
    t, force = record["time"].values, record["force"].values
    whole = (t >= 1.0 - 1e-9) & (t < 1.8 - 1e-9)
    for h in (1, 2, 3):
        # exp(-j h N theta): the angle of tooth 0 is the phase.
        kernel = np.exp(-1j * h * 8 * record["spindle_angle"].values[whole]) * 2 / whole.sum()
        expected = force_harmonics(FACE_MILL, arc, STEEL, 2e-3, 2e-4, [h])[0]
        np.testing.assert_allclose(force[:, whole] @ kernel, expected, atol=2e-3 * np.abs(expected).max())


def growth(machine: ModalModel, cut: MillingCut, rpm: float, duration: float = 8.0) -> float:
    """Log growth of what does not repeat from turn to turn, between the middle and the end of the cut."""
    record = simulate_milling(machine, cut, Spindle(rpm * math.pi / 30), duration, 2000.0, impulse=(1e-3, 0.0, 0.0))
    x = record["displacement"].sel(axis="x").values
    n = x.size
    return math.log(np.std(x[int(0.8 * n) :]) / np.std(x[int(0.4 * n) : int(0.6 * n)]))


@pytest.mark.parametrize(
    ("rpm", "limit_mm"), [(800, 1.7516), (1000, 0.2470), (1200, 0.1168), (1500, 0.1604), (1800, 0.3925), (2000, 0.7578)]
)
def test_the_lab_slot_loses_stability_at_its_known_limit(rpm: float, limit_mm: float) -> None:
    # The directional factor of this cut is constant in time, so the zero-order limit is exact (checked reference).
    for factor, sign in ((0.998, -1), (1.002, 1)):
        cut = MillingCut(arc=SLOT, depth=limit_mm * 1e-3 * factor, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
        assert sign * growth(BENCH, cut, rpm) > 0.0, f"{factor} of the limit at {rpm} rpm"


def test_the_scheme_converges_with_second_order() -> None:
    cut = MillingCut(arc=Engagement(0.5, 2.5), depth=5e-5, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]

    def final(step: float) -> np.ndarray:
        record = simulate_milling(BENCH, cut, Spindle(2 * math.pi * 20.0), 0.5, 1000.0, step=step)
        return record["displacement"].sel(axis="x").values[:-40]

    exact = final(1e-3 / 256)
    errors = [np.sqrt(np.mean((final(1e-3 / n) - exact) ** 2)) for n in (4, 8, 16)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert 1.7 < orders.min() <= orders.max() < 2.4, f"errors {errors}, orders {orders}"


def test_run_out_brings_the_spindle_line_and_loses_teeth() -> None:
    even = MillingCut(Tool(0.05, 4), SLOT, STEEL, 1e-3, feed_per_tooth=5e-5)
    offset = 40e-6 * np.cos(np.arange(4) * np.pi / 2)
    eccentric = MillingCut(Tool(0.05, 4, runout=tuple(offset)), SLOT, STEEL, 1e-3, feed_per_tooth=5e-5)
    lines, lost = [], []
    for cut in (even, eccentric):
        record = simulate_milling(RIGID, cut, Spindle(2 * math.pi * 10.0), 2.0, 4000.0)
        y = record["force"].sel(axis="y").values[4000:]
        lines.append(np.abs(np.fft.rfft(y))[10] / y.size * 2)
        lost.append(record.attrs["lost_contact"])
    assert lines[0] < 0.01
    assert lines[1] > 20.0
    assert lost[1] > 0.1 > lost[0]


def test_run_out_moves_chips_between_teeth_but_keeps_the_mean_force() -> None:
    # Small run-out: every tooth stays in contact and the sum of the chips over a turn is N f_z.
    pure = CuttingCoefficients(1800e6, 700e6, 250e6)
    means = []
    for runout in ((0.0, 0.0), (5e-6, -5e-6)):
        cut = MillingCut(Tool(0.05, 2, runout=runout), Engagement(0.6, 2.4), pure, 1e-3, feed_per_tooth=1e-4)
        record = simulate_milling(RIGID, cut, Spindle(2 * math.pi * 10.0), 2.0, 4000.0)
        means.append(record["force"].values[:, 2000:6000].mean(axis=1))
    np.testing.assert_allclose(means[1], means[0], rtol=2e-3)


def test_a_swept_tooth_passing_frequency_is_that_of_the_angle() -> None:
    cut = MillingCut(FACE_MILL, engagement("down", 37.5e-3, 0.125), STEEL, 2e-3, feed_rate=2e-3)
    record = simulate_milling(RIGID, cut, Spindle(20.0, 1.5), 20.0, 1000.0)
    force, angle = record["force"].sel(axis="y").values, record["spindle_angle"].values
    tracked = np.abs(np.mean(force * np.exp(-8j * angle)))
    untracked = np.abs(np.mean(force * np.exp(-8.37j * angle)))
    assert tracked > 30 * untracked
    assert record["spindle_speed"].values[-1] == pytest.approx((20.0 + 1.5 * 20.0) * 30 / np.pi, rel=1e-3)


def test_with_unequal_pitch_every_tooth_cuts_at_its_angle_the_chip_of_its_pitch() -> None:
    # Tooth j+1 comes pitch[j] after tooth j, and takes off what the feed has advanced in that angle.
    pitch = np.radians([100.0, 150.0, 110.0])
    tool, arc, feed = Tool(0.05, 3, pitch_angles=tuple(pitch)), Engagement(0.3, 1.1), 1e-4
    tangential = CuttingCoefficients(1800e6, 0.0, 0.0)
    cut = MillingCut(tool, arc, tangential, 1e-3, feed_per_tooth=feed)
    rate, turns = 60000.0, 10.0
    record = simulate_milling(RIGID, cut, Spindle(2 * math.pi * turns), 0.4, rate, step=1.0 / rate)
    angle = record["spindle_angle"].values - 4 * math.pi  # the third turn: all surfaces are cut ones
    force = np.linalg.norm(record["force"].values, axis=0)
    behind = {0: 0.0, 1: pitch[0], 2: pitch[0] + pitch[1]}
    starts = angle[1:][(force[1:] > 0.0) & (force[:-1] == 0.0) & (angle[1:] > 0.0) & (angle[1:] < 2 * math.pi)]
    np.testing.assert_allclose(starts, [arc.entry + behind[j] for j in range(3)], atol=2 * 2 * math.pi * turns / rate)
    for tooth, before in ((0, pitch[2]), (1, pitch[0]), (2, pitch[1])):
        phi = 0.7
        chip = feed * 3 * before / (2 * math.pi) * math.sin(phi)
        assert np.interp(phi + behind[tooth], angle, force) == pytest.approx(1800e6 * 1e-3 * chip, rel=2e-3), tooth


def test_a_helical_edge_has_the_shortened_harmonics() -> None:
    tool = Tool(0.02, 4, helix_angle=math.radians(30.0))
    arc = engagement("down", 0.01, 0.02)
    cut = MillingCut(tool, arc, STEEL, 5e-3, feed_per_tooth=1e-4)
    record = simulate_milling(RIGID, cut, Spindle(2 * math.pi * 10.0), 1.2, 20000.0)
    t = record["time"].values
    whole = (t >= 0.5 - 1e-9) & (t < 1.0 - 1e-9)
    kernel = np.exp(-4j * record["spindle_angle"].values[whole]) * 2 / whole.sum()
    expected = force_harmonics(tool, arc, STEEL, 5e-3, 1e-4, [1])[0]
    np.testing.assert_allclose(record["force"].values[:, whole] @ kernel, expected, atol=0.01 * np.abs(expected).max())


def test_in_air_there_is_no_force_and_no_motion() -> None:
    cut = MillingCut(arc=SLOT, depth=1e-4, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    record = simulate_milling(BENCH, cut, Spindle(100.0), 0.5, 2000.0, lead=0.5, tail=0.2)
    t = record["time"].values
    force = np.abs(record["force"].values).max(axis=0)
    assert force[t < 0.48].max() == 0.0
    assert force[t > 1.02].max() < 1e-9
    assert force[(t > 0.6) & (t < 0.9)].min() > 1.0


@pytest.mark.parametrize("cut", ["up", "down"])
def test_the_mean_force_has_its_closed_form(cut: str) -> None:
    # Entry at 0 and exit at pi, with edge forces that jump there: the share of a step that lies in the arc sees to it.
    tool, arc = Tool(0.0508, 2), engagement(cut, 0.02, 0.0508)
    feed, depth = 1e-4, 1e-3
    milling = MillingCut(tool, arc, STEEL, depth, feed_per_tooth=feed)
    record = simulate_milling(RIGID, milling, Spindle(2 * math.pi * 10.0), 2.0, 4800.0)
    mean = record["force"].values[:, 960:].mean(axis=1)
    chip, edge = (force_projection(k, math.pi / 2) for k in (STEEL.cutting, STEEL.edge))
    gram = gram_matrix(arc).real
    expected = 2 / (2 * math.pi) * depth * (feed * chip @ gram[:, 0] + edge @ gram[:, 2])
    np.testing.assert_allclose(mean, expected, atol=5e-3 * np.abs(expected).max())


def test_air_before_the_cut_only_shifts_the_record() -> None:
    cut = MillingCut(arc=SLOT, depth=1e-4, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    late = simulate_milling(BENCH, cut, Spindle(100.0, angle0=-50.0), 0.5, 2000.0, lead=0.5, step=1 / 2000)
    prompt = simulate_milling(BENCH, cut, Spindle(100.0), 0.5, 2000.0, step=1 / 2000)
    for name in ("force", "displacement", "acceleration"):
        expected = prompt[name].values
        np.testing.assert_allclose(late[name].values[:, 1000:], expected, atol=1e-8 * np.abs(expected).max())


def perturbation(machine: ModalModel, cut: MillingCut, spindle: Spindle, duration: float, rate: float) -> np.ndarray:
    """What a light hit at entry changes of the displacement, summed over the axes."""
    hit, calm = (
        simulate_milling(machine, cut, spindle, duration, rate, impulse=(i, i, i), step=1 / rate) for i in (1e-4, 0.0)
    )
    return np.asarray((hit["displacement"] - calm["displacement"]).sum("axis").values)


def decay_rate(x: np.ndarray, rate: float) -> float:
    """Decay rate [1/s] of one damped oscillation: x_{n+1} = 2 r cos(w h) x_n - r^2 x_{n-1}."""
    two = np.linalg.lstsq(np.column_stack([x[1:-1], x[:-2]]), x[2:], rcond=None)[0]
    return float(-0.5 * math.log(-two[1]) * rate)


# A slot with N >= 4 teeth: sum s^2 = N/4, sum s c = 0, sum 1 = N/2 over the teeth in the work, at every angle.
@pytest.mark.parametrize(
    ("direction", "factor"),
    [((1.0, 0.0, 0.0), math.sin(0.9) ** 2 * 4 / 4), ((0.0, 0.0, 1.0), math.cos(0.9) ** 2 * 4 / 2)],
)
@pytest.mark.parametrize(("diameter", "rpm", "friction"), [(0.0508, 1500, 0.3), (0.0508, 3000, 0.0), (0.1016, 1500, 2)])
def test_process_damping_of_a_slot_is_a_linear_damper(
    direction: tuple[float, float, float], factor: float, diameter: float, rpm: float, friction: float
) -> None:
    # c = C b/v_c factor, b = a_p/sin k. Without cutting force nothing regenerates; in the sum over the teeth
    # the friction has no part along x or z.
    machine = ModalModel([61.367], [0.011935], [1.68e6], [direction])
    flank, depth, rate = 4e5, 1e-3, 32000.0
    tool, soft = Tool(diameter, 4, 0.9), CuttingCoefficients(1.0, 0.0, 0.0)
    arc = engagement("up", diameter, diameter)
    rates = []
    for damping in (ProcessDamping(0.0), ProcessDamping(flank, friction)):
        cut = MillingCut(tool, arc, soft, depth, feed_per_tooth=2e-4, process_damping=damping)
        x = perturbation(machine, cut, Spindle(rpm * math.pi / 30), 0.3, rate)
        rates.append(decay_rate(x, rate))
    cutting_speed = math.pi * diameter * rpm / 60
    added = flank * depth / math.sin(0.9) / cutting_speed * factor
    assert rates[0] == pytest.approx(0.011935 * 2 * math.pi * 61.367, rel=1e-3)
    assert rates[1] - rates[0] == pytest.approx(added / (2 * machine.mass[0]), rel=5e-3)


def characteristic(s: complex, depth: float, rpm: float, flank: float) -> complex:
    """The lab slot with its tooth period and process damping: m s^2 + c s + k + K_rc a_p (1 - exp(-s T))."""
    damper = flank * depth / (math.pi * 0.0508 * rpm / 60)
    m, w = float(BENCH.mass[0]), 2 * math.pi * 61.367
    machine = m * (s**2 + 2 * 0.011935 * w * s + w**2) + damper * s
    return machine + 351e6 * depth * (1 - np.exp(-s * 15 / rpm))


def solved(equation, start: tuple[float, float]) -> np.ndarray:  # type: ignore[no-untyped-def]
    found = root(lambda p: [(e := equation(*p)).real / 1.68e6, e.imag / 1.68e6], start, tol=1e-12)
    assert found.success
    return np.asarray(found.x)


def test_regeneration_with_process_damping_decays_at_the_rate_of_the_characteristic_root() -> None:
    depth, rpm, flank, rate = 1e-4, 1500.0, 4e5, 16000.0
    sigma, _ = solved(lambda a, b: characteristic(complex(a * 100, b * 100), depth, rpm, flank), (-0.05, 3.9)) * 100
    cut = MillingCut(
        arc=SLOT,
        depth=depth,
        feed_per_tooth=2e-4,
        process_damping=ProcessDamping(flank),
        **BENCH_CUT,  # type: ignore[arg-type]
    )
    x = perturbation(BENCH, cut, Spindle(rpm * math.pi / 30), 0.8, rate)
    assert decay_rate(x[x.size // 2 :], rate) == pytest.approx(-sigma, rel=0.01)


def test_process_damping_raises_the_limit_of_the_lab_slot_to_its_closed_form() -> None:
    rpm, flank = 1500.0, 4e5
    depth, _ = solved(lambda a, w: characteristic(1j * w * 100, a * 1e-3, rpm, flank), (0.16, 3.96)) * 1e-3
    assert depth > 1.1 * 0.1604e-3
    for factor, sign in ((0.995, -1), (1.005, 1)):
        cut = MillingCut(
            arc=SLOT,
            depth=depth * factor,
            feed_per_tooth=2e-4,
            process_damping=ProcessDamping(flank),
            **BENCH_CUT,  # type: ignore[arg-type]
        )
        assert sign * growth(BENCH, cut, rpm) > 0.0, f"{factor} of {depth * 1e3:.4f} mm"


def test_a_sharp_edge_has_no_process_damping_to_the_last_bit() -> None:
    plain = MillingCut(arc=SLOT, depth=1e-4, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    sharp = replace(plain, process_damping=ProcessDamping.from_wear_land(3e13, 0.0, friction=0.5))
    a, b = (simulate_milling(BENCH, cut, Spindle(100.0), 0.5, 2000.0) for cut in (plain, sharp))
    np.testing.assert_array_equal(a["force"].values, b["force"].values)
    assert ProcessDamping.from_wear_land(4e13, 80e-6).coefficient == pytest.approx(6.4e4)


@pytest.mark.parametrize(("coefficient", "friction"), [(-1.0, 0.3), (math.nan, 0.3), (1e5, -0.1), (1e5, math.inf)])
def test_a_flank_that_drives_the_vibration_is_refused(coefficient: float, friction: float) -> None:
    with pytest.raises(InputError, match="process damping"):
        ProcessDamping(coefficient, friction)


VARYING = Spindle(80.0, -3.0, 0.4, 0.3, 1.7)


def test_the_speed_of_a_varying_spindle_is_the_rate_of_its_angle() -> None:
    t, h = np.linspace(0.0, 4.0, 1001), 1e-5
    rate = (VARYING.angle(t + h) - VARYING.angle(t - h)) / (2 * h)
    np.testing.assert_allclose(rate * 30 / np.pi, VARYING.speed(t), rtol=1e-8)
    lowest, highest = VARYING.extremes(0.0, 4.0)
    assert lowest == pytest.approx(VARYING.speed(t).min() * np.pi / 30, rel=1e-4)
    assert highest == pytest.approx(VARYING.speed(t).max() * np.pi / 30, rel=1e-4)
    cut = MillingCut(arc=SLOT, depth=1e-4, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    turned = [_cutting_kernels.turn(pack_motion(VARYING, cut), time) for time in t[::100]]
    np.testing.assert_allclose(turned, np.transpose([VARYING.angle(t[::100]), VARYING.speed(t[::100]) * np.pi / 30]))


def test_with_feed_per_tooth_a_varying_speed_changes_when_a_force_comes_but_not_the_force() -> None:
    cut = MillingCut(Tool(0.0508, 2), Engagement(0.5, 2.0), STEEL, 1e-3, feed_per_tooth=1e-4)
    steady, varying = (
        simulate_milling(RIGID, cut, s, 1.0, 20000.0, step=1 / 20000.0)
        for s in (Spindle(80.0), Spindle(80.0, variation=0.3, variation_frequency=3.0))
    )
    angle = np.linspace(10.0, 60.0, 2000)
    phi = angle % math.pi
    angle = angle[(np.abs(phi - 0.5) > 0.02) & (np.abs(phi - 2.0) > 0.02)]  # not where the force jumps
    force = [np.interp(angle, r["spindle_angle"].values, r["force"].sel(axis="y").values) for r in (steady, varying)]
    np.testing.assert_allclose(force[1], force[0], atol=2e-3 * np.abs(force[0]).max())


def test_varying_the_speed_makes_an_unstable_cut_at_a_high_lobe_stable() -> None:
    # 250 rpm: 3.7 waves a tooth period; 0.2 mm is over the limit there. Twenty per cent at 1 Hz.
    cut = MillingCut(arc=SLOT, depth=2e-4, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    change = []
    for variation in (0.0, 0.2):
        spindle = Spindle(250 * math.pi / 30, variation=variation, variation_frequency=1.0)
        x = perturbation(BENCH, cut, spindle, 6.0, 4000.0)
        change.append(float(np.std(x[-4000:]) / np.std(x[:4000])))
    assert change[0] > 10.0
    assert change[1] < 1e-4


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"rotation": math.nan}, "rotation is nan"),
        ({"rotation": 80.0, "variation": 1.0, "variation_frequency": 1.0}, "below 100 %"),
        ({"rotation": 80.0, "variation": -0.1, "variation_frequency": 1.0}, "below 100 %"),
        ({"rotation": 80.0, "variation": 0.1}, "variation_frequency must be positive"),
    ],
)
def test_a_variation_that_is_none_is_refused(given: dict[str, float], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Spindle(**given)


@pytest.mark.parametrize("spindle", [Spindle(10.0, -20.0), Spindle(10.0, -4.0, 0.0, 0.9, 2.0), Spindle(-5.0)])
def test_a_spindle_that_stops_is_refused(spindle: Spindle) -> None:
    cut = MillingCut(arc=SLOT, depth=1e-4, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="must turn forward"):
        simulate_milling(BENCH, cut, spindle, 1.0, 1000.0)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"depth": 0.0, "feed_per_tooth": 2e-4}, "the depth of cut is 0 mm"),
        ({"depth": math.inf, "feed_per_tooth": 2e-4}, "the depth of cut is inf mm"),
        ({"depth": 1e-3}, "neither of feed_rate and feed_per_tooth"),
        ({"depth": 1e-3, "feed_rate": 1e-2, "feed_per_tooth": 2e-4}, "both of feed_rate and feed_per_tooth"),
        ({"depth": 1e-3, "feed_rate": 0.0}, "the feed rate is 0 mm/min; it must be positive"),
        ({"depth": 1e-3, "feed_rate": math.nan}, "the feed rate is nan mm/min"),
        ({"depth": 1e-3, "feed_per_tooth": -1e-4}, "the feed per tooth is -0.1 mm; it must be positive"),
    ],
)
def test_a_cut_needs_depth_and_one_feed(given: dict[str, float], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        MillingCut(arc=SLOT, **given, **BENCH_CUT)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("times", "sentence"),
    [
        ((0.0, 1000.0), "0 s in the cut, 0 s in air; the cut must last"),
        ((math.nan, 1000.0), "nan s in the cut"),
        ((1.0, 1000.0, -0.1), "-0.1 s in air, 1 s in the cut"),
        ((1.0, 1000.0, 0.0, -0.1), "-0.1 s in air; the cut must last"),
        ((1.0, 0.0), "1 s at 0 Hz; at least two samples"),
        ((1.0, math.inf), "1 s at inf Hz"),
    ],
)
def test_a_cut_takes_time(times: tuple[float, ...], sentence: str) -> None:
    cut = MillingCut(arc=SLOT, depth=1e-4, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=sentence):
        simulate_milling(BENCH, cut, Spindle(100.0), *times)


@pytest.mark.parametrize(
    ("teeth", "sentence"), [(0, "the tool has 0 teeth"), (-2, "has -2 teeth"), (2.5, "has 2.5 teeth")]
)
def test_a_tool_has_a_whole_number_of_teeth(teeth: int, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Tool(0.05, teeth)


def test_a_step_that_misses_the_vibration_or_the_tooth_is_refused() -> None:
    cut = MillingCut(arc=SLOT, depth=1e-4, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="at least 4 steps in the one"):
        simulate_milling(BENCH, cut, Spindle(1.0), 1.0, 1000.0, step=5e-3)
    with pytest.raises(InputError, match="10 in the other"):
        simulate_milling(BENCH, cut, Spindle(100.0), 1.0, 1000.0, step=2e-3)
    with pytest.raises(InputError, match="the step is 0 us"):
        simulate_milling(BENCH, cut, Spindle(100.0), 1.0, 1000.0, step=0.0)


def test_the_step_error_falls_fourfold_with_the_step() -> None:
    cut = MillingCut(arc=Engagement(0.5, 2.5), depth=5e-5, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    spindle = Spindle(2 * math.pi * 20.0)
    step = default_step(BENCH, cut, spindle.rotation)
    errors = [step_error(BENCH, cut=cut, spindle=spindle, duration=0.5, step=h) for h in (step, step / 2, step / 4)]
    assert errors[0] < 5e-3
    assert 1.7 < math.log2(errors[0] / errors[2]) / 2 < 2.3, errors
