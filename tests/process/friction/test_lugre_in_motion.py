"""Stiff bristles within a step of a time simulation, and bristles that differ between the directions."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from process.drive.axis import Drive
from process.drive.servo import Servo
from process.errors import InputError
from process.friction._kernels import lugre_part
from process.friction.laws import LuGre
from process.friction.linearised import linearised
from process.machine.machine import FeedAxis, Machine
from process.machine.structure import two_mass_axes
from process.simulation.excitation import HalfSine
from process.simulation.machine import simulate_machine

MM_MIN = 1.0 / 6e4
FORTH = LuGre(5e8, 6e4, 44.2, 84.0, 387.4 * MM_MIN, 168.0)
BACK = LuGre(5e8, 2e4, 60.0, 95.0, 300.0 * MM_MIN, 300.0, 1.5)
BOTH = replace(FORTH, negative=BACK)
STRUCTURE = two_mass_axes({"x": Drive(23.1, 11.3, 1.68e6, 104.0)})


def axis(law: LuGre) -> Machine:
    return Machine(STRUCTURE, {"x": FeedAxis(Servo(6268.0, 10.9e-3, 45.5), law)})


def swing(law: LuGre, feed: float, step: float, peak: float = 50.0) -> np.ndarray:
    hit = {"x": HalfSine.from_peak(peak)}
    rate = 1.0 / step
    run = simulate_machine(axis(law), duration=0.3, feed=feed * MM_MIN, forces=hit, sample_rate=rate, step=step)
    return np.asarray(run["displacement"].values[0])


@pytest.mark.parametrize(("feed", "peak"), [(500.0, 50.0), (500.0, 300.0), (50.0, 50.0), (0.0, 50.0), (0.0, 300.0)])
@pytest.mark.parametrize("law", [FORTH, replace(FORTH, bristle_damping=200.0)], ids=["damped", "bare"])
def test_stiff_bristles_are_right_at_half_a_millisecond_and_of_order_two(law: LuGre, feed: float, peak: float) -> None:
    # Bristles settle in 15 us at 500 mm/min: a step of 500 us does not resolve them.
    truth = swing(law, feed, 1.0 / 64e3, peak)
    coarse, middle, fine = (swing(law, feed, 1.0 / (n * 1e3), peak) for n in (2, 4, 8))
    errors = [np.abs(x - truth[:: 64 // n][: x.size]).max() for x, n in ((coarse, 2), (middle, 4), (fine, 8))]
    assert errors[0] < 1e-3 * np.abs(truth).max()
    assert math.log2(errors[0] / errors[2]) / 2.0 > 2.0


def test_a_part_of_a_step_is_of_order_three_and_settles_at_once_where_bristles_are_fast() -> None:
    _, p = FORTH.packed()

    def speed(t: float) -> float:
        return 8e-3 + 3.0 * t - 500.0 * t**2

    def bend_after(step: float) -> tuple[float, float]:
        def rate(t: float, z: np.ndarray) -> np.ndarray:
            v = speed(t)
            return np.asarray(v - 5e8 * abs(v) * z / float(FORTH.steady_force(v) - FORTH.sigma * v))

        start = [0.5 * float(FORTH.steady_force(8e-3)) / 5e8]
        truth = solve_ivp(rate, (0.0, step), start, "Radau", rtol=1e-10, atol=1e-20).y[0, -1]
        return lugre_part(p, start[0], speed(step / 3.0), speed(step), step)[0], truth

    errors = [abs(ours - truth) for ours, truth in map(bend_after, (4e-6, 2e-6, 1e-6))]
    # The error of one step is one order above that of the method.
    assert all(math.log2(a / b) > 3.5 for a, b in itertools.pairwise(errors))
    ours, truth = bend_after(1e-3)
    assert ours == pytest.approx(truth, rel=1e-2)
    end, force = lugre_part(p, 0.0, 8e-3, 8e-3, 1e6)[:2]
    assert end == pytest.approx(float(FORTH.steady_force(8e-3) - FORTH.sigma * 8e-3) / 5e8, rel=1e-9)
    assert force == pytest.approx(float(FORTH.steady_force(8e-3)), rel=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_slopes_of_a_part_of_a_step_are_those_of_its_values(sign: float) -> None:
    _, p = BOTH.packed()
    at, size = np.array([sign * 4e-8, sign * 6e-3, sign * 9e-3]), np.array([1e-12, 1e-7, 1e-7])
    _, _, z_third, z_end, f_third, f_end, f_bend = lugre_part(p, *at, 2.5e-4)

    def slopes(which: int) -> np.ndarray:
        change = np.where(np.arange(3) == which, size, 0.0)
        up, down = (lugre_part(p, *(at + s * change), 2.5e-4)[:2] for s in (1.0, -1.0))
        return np.asarray((np.array(up) - np.array(down)) / (2.0 * size[which]))

    np.testing.assert_allclose([z_third, f_third], slopes(1), rtol=1e-5)
    np.testing.assert_allclose([z_end, f_end], slopes(2), rtol=1e-5)
    assert f_bend == pytest.approx(slopes(0)[1], rel=1e-5)


@pytest.mark.parametrize("feed", [500.0, -500.0, 3000.0])
def test_a_light_hit_in_motion_gives_the_linearised_compliance_of_its_direction(feed: float) -> None:
    machine, rate, f = axis(BOTH), 4000.0, np.array([10.0, 25.0, 40.0, 60.0, 90.0])
    hit = {"x": HalfSine.from_peak(0.05, start=0.0)}
    run = simulate_machine(
        machine, duration=2.0, feed=feed * MM_MIN, forces=hit, sample_rate=8 * rate, step=1.0 / (8 * rate)
    )
    turn = np.exp(-2j * np.pi * np.outer(f, run["time"].values))
    found = (turn @ run["displacement"].values[0]) / (turn @ run["force"].values[0])
    exact = machine.at(feed * MM_MIN).matrix(f)[:, 0, 0]
    np.testing.assert_allclose(found, exact, rtol=1e-3)


def test_equal_sides_are_one_law() -> None:
    twice = replace(FORTH, negative=replace(FORTH))
    for feed in (500.0, 0.0, -500.0):
        x = swing(FORTH, feed, 5e-4, 300.0)
        np.testing.assert_allclose(swing(twice, feed, 5e-4, 300.0), x, rtol=0.0, atol=1e-12 * np.abs(x).max())


@pytest.mark.parametrize("feed", [500.0, 30.0, 0.0])
def test_going_back_is_the_mirror_image_of_the_law_that_is_turned_round(feed: float) -> None:
    turned = replace(BACK, negative=FORTH)
    x = swing(turned, feed, 2.5e-4, 300.0)
    np.testing.assert_allclose(swing(BOTH, -feed, 2.5e-4, -300.0), -x, rtol=0.0, atol=1e-12 * np.abs(x).max())


def test_each_direction_has_the_steady_force_of_its_side() -> None:
    v = np.array([1e-3, 8e-3, 0.1])
    np.testing.assert_allclose(BOTH.steady_force(v), FORTH.steady_force(v), rtol=1e-12)
    np.testing.assert_allclose(BOTH.steady_force(-v), -BACK.steady_force(v), rtol=1e-12)
    for speed in v:
        assert BOTH.history(np.full(50, -speed), 1e-3)[-1] == pytest.approx(float(BOTH.steady_force(-speed)), rel=1e-9)


def test_the_force_does_not_jump_where_the_direction_turns() -> None:
    for bend in (0.0, 1e-7, -1e-7):
        _, p = BOTH.packed()
        forth, back = (lugre_part(p, bend, v, v, 0.0)[1] for v in (1e-12, -1e-12))
        assert forth == pytest.approx(back, abs=1e-6)
        assert forth == pytest.approx(5e8 * bend, abs=1e-6)


def test_a_full_cycle_of_sliding_costs_the_force_of_both_sides() -> None:
    step, w, size = 1e-5, 2.0 * math.pi * 5.0, 5e-3
    velocity = size * w * np.cos(w * np.arange(40000) * step)
    force = BOTH.history(velocity, step)
    cost = float(force[20000:] @ velocity[20000:]) * step
    assert cost == pytest.approx(float(BOTH.steady_force(velocity[20000:]) @ velocity[20000:]) * step, rel=0.01)


def test_at_rest_a_small_vibration_has_the_mean_of_both_sides() -> None:
    step, w, size = 1e-6, 2.0 * math.pi * 500.0, 1e-10
    velocity = size * w * np.cos(w * (np.arange(4000) + 0.5) * step)
    force = BOTH.history(velocity, step)[2000:]
    # Within a step held at its middle the velocity is that of half a step before the force.
    wave = np.exp(-1j * w * (np.arange(2000, 4000) + 1.0) * step)
    found = np.mean(force * wave) / np.mean(size * np.sin(w * (np.arange(2000, 4000) + 1.0) * step) * wave)
    assert linearised(BOTH, 0.0).direct == pytest.approx(0.5 * (6e4 + 168.0 + 2e4 + 300.0))
    exact = complex(linearised(BOTH, 0.0)(np.array(1j * w)))
    assert found.real == pytest.approx(exact.real, rel=0.02)
    assert found.imag == pytest.approx(exact.imag, rel=0.02)


@pytest.mark.parametrize("feed", [500.0, 0.0])
def test_the_energy_balance_holds(feed: float) -> None:
    hit = {"x": HalfSine.from_peak(-300.0)}
    record = simulate_machine(axis(BOTH), duration=0.3, feed=feed * MM_MIN, forces=hit, sample_rate=2000.0, step=5e-4)
    assert record.attrs["energy_error"] < 2e-3


def test_sides_that_cannot_be_one_guideway_are_refused() -> None:
    with pytest.raises(InputError, match="give both the same"):
        replace(FORTH, negative=replace(BACK, bristle_stiffness=1e8))
    with pytest.raises(InputError, match="give it without"):
        replace(FORTH, negative=BOTH)
