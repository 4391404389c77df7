"""The time simulation against closed forms: linear response, static forces, the lab slot, order of convergence."""

import math

import numpy as np
import pytest

from process.compliance import ModalModel
from process.cutting import CuttingCoefficients, force_harmonics
from process.engagement import Engagement, engagement
from process.errors import InputError
from process.simulate import MillingCut, Spindle, simulate_forced, simulate_milling
from process.tool import Tool

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


def test_a_swept_tooth_passing_frequency_is_where_the_angle_says() -> None:
    cut = MillingCut(FACE_MILL, engagement("down", 37.5e-3, 0.125), STEEL, 2e-3, feed_rate=2e-3)
    record = simulate_milling(RIGID, cut, Spindle(20.0, 1.5), 20.0, 1000.0)
    force, angle = record["force"].sel(axis="y").values, record["spindle_angle"].values
    tracked = np.abs(np.mean(force * np.exp(-8j * angle)))
    untracked = np.abs(np.mean(force * np.exp(-8.37j * angle)))
    assert tracked > 30 * untracked
    assert record["spindle_speed"].values[-1] == pytest.approx((20.0 + 1.5 * 20.0) * 30 / np.pi, rel=1e-3)


def test_with_unequal_pitch_every_tooth_cuts_when_and_what_its_place_says() -> None:
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


def test_a_spindle_that_stops_is_refused() -> None:
    cut = MillingCut(arc=SLOT, depth=1e-4, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="must turn forward"):
        simulate_milling(BENCH, cut, Spindle(10.0, -20.0), 1.0, 1000.0)


def test_a_cut_needs_depth_and_one_feed() -> None:
    with pytest.raises(InputError, match="depth of cut"):
        MillingCut(arc=SLOT, depth=0.0, feed_per_tooth=2e-4, **BENCH_CUT)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="either"):
        MillingCut(arc=SLOT, depth=1e-3, **BENCH_CUT)  # type: ignore[arg-type]
