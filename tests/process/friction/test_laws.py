"""Friction laws: numbers of the paper's bench, slopes, energy, memory."""

import math
from dataclasses import replace

import numpy as np
import pytest

from process.errors import InputError
from process.friction._kernels import friction_step
from process.friction.laws import (
    Andersson,
    Coulomb,
    CoulombViscous,
    FrictionLaw,
    GeneralisedMaxwellSlip,
    LuGre,
    MemoryLaw,
    Viscous,
)

MM_MIN = 1.0 / 60e3
# Table 1 of the paper; 0.0028 N min/mm = 168 N s/m, 0.25 min/mm = 15000 s/m.
BACKWARDS = Andersson(38.7, 88.0, 421.0 * MM_MIN, 0.0025 * 60e3, 0.25 * 60e3)
BENCH = Andersson(44.2, 84.0, 387.4 * MM_MIN, 0.0028 * 60e3, 0.25 * 60e3, negative=BACKWARDS)
LAWS = [Viscous(168.0), Coulomb(44.2, 15000.0), CoulombViscous(44.2, 168.0, 15000.0), BENCH]

LUGRE = LuGre(2e7, 1e3, 44.2, 84.0, 387.4 * MM_MIN, 168.0)
SLIP = GeneralisedMaxwellSlip((1e7, 6e6, 4e6), (0.2, 0.3, 0.5), 44.2, 84.0, 387.4 * MM_MIN, 168.0, 2e4)


@pytest.mark.parametrize(("feed", "expected"), [(13.5, 82.5), (25.0, 81.6), (1396.0, 49.2), (1500.0, 49.2)])
def test_the_bench_curve_has_the_reference_forces(feed: float, expected: float) -> None:
    assert float(BENCH.force(feed * MM_MIN)) == pytest.approx(expected, abs=0.05)


def test_the_bench_curve_has_its_extremes_at_those_of_the_reference() -> None:
    feed = np.linspace(0.0, 3000.0, 300001)
    force = BENCH.force(feed * MM_MIN)
    assert feed[force.argmax()] == pytest.approx(13.5, abs=0.1)
    sliding = feed > 100.0
    assert feed[sliding][force[sliding].argmin()] == pytest.approx(1396, abs=0.5)


def test_the_slope_at_rest_is_static_force_times_steepness() -> None:
    assert float(replace(BENCH, negative=None).slope(0.0)) == pytest.approx(84.0 * 15000.0 + 168.0, rel=1e-6)
    assert float(BENCH.slope(0.0)) == pytest.approx(86.0 * 15000.0 + 159.0, rel=1e-6)  # the mean of both sides
    assert float(BENCH.slope(500.0 * MM_MIN)) == pytest.approx(-1528, abs=1)
    assert float(Coulomb(44.2).slope(0.0)) == math.inf
    assert float(CoulombViscous(44.2, 168.0).slope(0.01)) == 168.0


@pytest.mark.parametrize("law", LAWS)
def test_the_slope_is_the_derivative_of_the_force(law: FrictionLaw) -> None:
    v = np.array([-0.05, -3e-3, -1e-4, -1e-6, 1e-6, 2e-4, 7e-3, 0.1])
    h = 1e-7 * np.abs(v)
    numeric = (law.force(v + h) - law.force(v - h)) / (2.0 * h)
    np.testing.assert_allclose(law.slope(v), numeric, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("law", [*LAWS, Coulomb(44.2)])
def test_friction_takes_energy_and_vanishes_at_rest(law: FrictionLaw) -> None:
    v = np.concatenate([-np.geomspace(1e-8, 1.0, 50), np.geomspace(1e-8, 1.0, 50)])
    assert np.all(law.force(v) * v >= 0.0)
    assert float(law.force(0.0)) == 0.0


def test_each_direction_has_its_own_curve() -> None:
    v = np.array([1e-3, 1e-2, 0.1])
    np.testing.assert_array_equal(BENCH.force(-v), -BACKWARDS.force(v))
    np.testing.assert_array_equal(BENCH.slope(-v), BACKWARDS.slope(v))


def test_equal_static_and_sliding_force_is_coulomb_and_viscous() -> None:
    v = np.linspace(-0.02, 0.02, 41)
    plain = Andersson(44.2, 44.2, 1.0, 168.0, 15000.0)
    np.testing.assert_allclose(plain.force(v), CoulombViscous(44.2, 168.0, 15000.0).force(v), atol=1e-12)


def test_an_infinite_steepness_is_the_sign_of_the_velocity() -> None:
    v = np.array([-0.01, -1e-3, 1e-3, 0.01])
    np.testing.assert_array_equal(Coulomb(44.2).force(v), 44.2 * np.sign(v))


def test_any_shape_goes_in_and_comes_out() -> None:
    assert BENCH.force(np.zeros((2, 3))).shape == (2, 3)
    assert BENCH.slope(0.1).shape == ()


@pytest.mark.parametrize("law", [LUGRE, SLIP])
def test_a_law_with_memory_settles_on_the_stribeck_curve(law: MemoryLaw) -> None:
    for velocity in (-0.02, 1e-3, 5e-3):
        force = law.history(np.full(40000, velocity), 1e-5)[-1]
        assert force == pytest.approx(float(law.steady_force(velocity)), rel=1e-3)
    one_way = Andersson(44.2, 84.0, 387.4 * MM_MIN, 168.0, math.inf)
    np.testing.assert_allclose(law.steady_force([1e-3, 0.01]), one_way.force([1e-3, 0.01]))


@pytest.mark.parametrize("law", [LUGRE, SLIP])
def test_a_law_with_memory_has_a_curve_for_each_direction(law: MemoryLaw) -> None:
    back = replace(law, coulomb=20.0, static=60.0, stribeck_speed=3e-3, sigma=300.0)  # type: ignore[type-var]
    both = replace(law, negative=back)  # type: ignore[type-var]
    for velocity, own in ((2e-3, law), (-2e-3, back)):
        force = both.history(np.full(40000, velocity), 1e-5)
        np.testing.assert_array_equal(force, own.history(np.full(40000, velocity), 1e-5))
        assert force[-1] == pytest.approx(float(both.steady_force(velocity)), rel=1e-3)
    assert both.towards(-1.0) == back
    assert both.towards(1.0) == law


@pytest.mark.parametrize("law", [LUGRE, SLIP])
@pytest.mark.parametrize("force", [0.0, 7.0, -50.0, pytest.param(83.0, marks=pytest.mark.slow)])
@pytest.mark.parametrize("back", [84.0, 57.0])
def test_what_a_law_with_memory_holds_at_rest_is_where_it_was_pulled_to(
    law: MemoryLaw, force: float, back: float
) -> None:
    """The slower it is pulled, the nearer is the state to that of rest; its force is at once what is held."""
    law = replace(law, negative=replace(law, static=back))  # type: ignore[type-var]
    state, step = law.holding(force), 1e-5
    carried = state[0] * law.stiffness if state.size == 1 else state[::2].sum()
    assert carried == pytest.approx(force, abs=1e-9)
    velocity = math.copysign(1e-6, force)
    pulled, total = np.zeros(law.states), 0.0
    while abs(total) < abs(force) * (1.0 - 1e-9):
        total = friction_step(*law.packed(), pulled, velocity, step)
    bent = slice(0, None, 2) if law.states > 1 else slice(None)
    np.testing.assert_allclose(state[bent], pulled[bent], rtol=5e-3, atol=1e-3 * np.abs(state[bent]).max() + 1e-12)


@pytest.mark.parametrize("law", [LUGRE, SLIP])
def test_a_law_with_memory_is_a_spring_before_it_slips(law: MemoryLaw) -> None:
    n, step, amplitude = 4000, 1e-5, 2e-8
    t = (np.arange(n) + 0.5) * step
    w = 2.0 * math.pi * 50.0
    displacement = amplitude * np.sin(w * (t + 0.5 * step))
    force = law.history(amplitude * w * np.cos(w * t), step)
    stiffness = float(force @ displacement / (displacement @ displacement))
    assert stiffness == pytest.approx(law.stiffness, rel=0.02)


@pytest.mark.parametrize("law", [LUGRE, SLIP])
def test_the_loop_of_a_law_with_memory_takes_energy(law: MemoryLaw) -> None:
    step, w = 1e-5, 2.0 * math.pi * 20.0
    t = np.arange(10000) * step
    velocity = 50e-6 * w * np.cos(w * t)
    work = np.cumsum(law.history(velocity, step) * velocity) * step
    # A whole cycle of sliding costs about 4 X times the static to the sliding force.
    cycle = work[9999] - work[4999]
    assert 4 * 50e-6 * 44.2 * 0.9 < cycle < 4 * 50e-6 * 90.0


@pytest.mark.parametrize("law", [LUGRE, SLIP])
def test_to_and_fro_each_direction_brakes_with_its_own_forces(law: MemoryLaw) -> None:
    """Over 20 mm, far beyond what sticks: a stroke costs its own sliding force times the way, less where it turns."""
    forth = replace(law, sigma=0.0)  # type: ignore[type-var]
    back = replace(forth, coulomb=20.0, static=30.0)  # type: ignore[type-var]
    step, w, reach = 1e-5, 2.0 * math.pi * 5.0, 10e-3
    t = (np.arange(40000) + 0.5) * step
    velocity = reach * w * np.cos(w * t)
    force = replace(forth, negative=back).history(velocity, step)  # type: ignore[type-var]
    later = slice(20000, None)
    for away, own in ((velocity[later] > 0.0, 44.2), (velocity[later] < 0.0, 20.0)):
        work = float(np.sum(force[later][away] * velocity[later][away])) * step
        assert work == pytest.approx(own * 2.0 * reach, rel=0.02)
    # It lets go with the static force of the way that it goes, give or take what slips early.
    assert 0.9 * 84.0 > force[later].max() > 44.2
    assert -0.9 * 30.0 < force[later].min() < -20.0


def test_half_the_step_changes_the_memory_laws_little() -> None:
    w = 2.0 * math.pi * 20.0
    for law in (LUGRE, SLIP):
        ends = []
        for step in (2e-5, 1e-5, 5e-6):
            t = (np.arange(round(0.11 / step)) + 0.5) * step
            ends.append(law.history(1e-3 * np.cos(w * t), step)[-1])
        assert abs(ends[2] - ends[1]) < 0.7 * abs(ends[1] - ends[0]) + 1e-9
        assert abs(ends[2] - ends[1]) < 0.5


def test_what_is_not_possible_is_refused_with_what_is_needed() -> None:
    with pytest.raises(InputError, match="sigma is -1"):
        Viscous(-1.0)
    with pytest.raises(InputError, match="stribeck speed is 0"):
        Andersson(1.0, 2.0, 0.0, 0.0, 1e4)
    with pytest.raises(InputError, match="give it without"):
        Andersson(1.0, 2.0, 1.0, 0.0, 1e4, negative=BENCH)
    with pytest.raises(InputError, match="sum to 1"):
        GeneralisedMaxwellSlip((1e6,), (0.5,), 1.0, 2.0, 1.0, 0.0, 1.0)
    with pytest.raises(InputError, match="they are the same: give both the same"):
        replace(SLIP, negative=replace(SLIP, attraction=1e4))
    with pytest.raises(InputError, match="friction of 84 N at rest does not hold -85 N"):
        SLIP.holding(-85.0)
    with pytest.raises(InputError, match="does not hold nan N"):
        LUGRE.holding(math.nan)
    with pytest.raises(InputError, match="is no GeneralisedMaxwellSlip; give one of the same kind"):
        replace(SLIP, negative=LUGRE)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="as many of both"):
        GeneralisedMaxwellSlip((1e6, 1e6), (1.0,), 1.0, 2.0, 1.0, 0.0, 1.0)
    with pytest.raises(InputError, match="positive step"):
        LUGRE.history([0.0], 0.0)
