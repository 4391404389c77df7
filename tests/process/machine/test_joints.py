"""Joints: describing functions against quadrature of the force law, energy of a cycle, limits."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from process.errors import InputError
from process.machine.joints import CubicSpring, Gap, Iwan, Jenkins, Joint, PowerIwan

JENKINS = Jenkins(2e7, 100.0)  # slips at 5 um
IWAN = Iwan(2e7, 100.0, 2000)  # slips as a whole at 10 um
BOLTED = PowerIwan(2e7, 100.0, -0.4, 0.3, 2000)  # the elements at once slip at 7.5 um
POINTS = 4000


def cycle(joint: Joint, amplitude: float) -> tuple[NDArray, NDArray]:
    """Displacement and force over one steady cycle, by integrating two."""
    t = 2.0 * math.pi * np.arange(2 * POINTS) / POINTS
    x = amplitude * np.cos(t)
    return x[POINTS:], joint.force(x)[POINTS:]


def quadrature(joint: Joint, amplitude: float) -> complex:
    _, force = cycle(joint, amplitude)
    t = 2.0 * math.pi * np.arange(POINTS) / POINTS
    return complex(2.0 * np.mean(force * np.exp(-1j * t)) / amplitude)


SPRINGS = (CubicSpring(2e7, 1e17), CubicSpring(2e7, -1e16), Gap(2e7, 4e-6))


@pytest.mark.parametrize("joint", [JENKINS, IWAN, BOLTED, *SPRINGS])
@pytest.mark.parametrize("amplitude", [1e-6, 4.5e-6, 5.5e-6, 9e-6, 11e-6, 50e-6])
def test_the_describing_function_is_the_first_harmonic_of_the_force(joint: Joint, amplitude: float) -> None:
    numeric = quadrature(joint, amplitude)
    scale = 2e-3 * abs(numeric) + 1.0
    assert float(joint.equivalent_stiffness(amplitude)) == pytest.approx(numeric.real, abs=scale)
    assert float(joint.loss_stiffness(amplitude)) == pytest.approx(numeric.imag, abs=scale)


@pytest.mark.parametrize("joint", [JENKINS, IWAN, BOLTED])
@pytest.mark.parametrize("amplitude", [4e-6, 8e-6, 30e-6])
def test_the_energy_of_a_cycle_is_the_area_of_the_loop(joint: Joint, amplitude: float) -> None:
    x, force = cycle(joint, amplitude)
    area = float(np.sum(0.5 * (force + np.roll(force, -1)) * (np.roll(x, -1) - x)))
    lost = math.pi * float(joint.loss_stiffness(amplitude)) * amplitude**2
    assert lost == pytest.approx(area, rel=2e-3, abs=1e-9)


def test_an_iwan_joint_loads_along_a_parabola_and_then_slips() -> None:
    x = np.linspace(0.0, 20e-6, 400)
    expected = np.where(x < 10e-6, 2e7 * x * (1.0 - x / 20e-6), 100.0)
    np.testing.assert_allclose(IWAN.force(x), expected, atol=0.01)
    assert IWAN.slip_displacement == pytest.approx(10e-6)


def test_unloading_follows_masing() -> None:
    # The unloading branch is the first loading curve magnified by two.
    down = np.linspace(8e-6, -8e-6, 300)
    start = np.linspace(0.0, 8e-6, 300)
    force = IWAN.force(np.concatenate([start, down]))[300:]
    travel = 0.5 * (8e-6 - down)
    loading = 2e7 * travel * (1.0 - travel / 20e-6)
    np.testing.assert_allclose(force, force[0] - 2.0 * loading, atol=0.02)


def test_micro_slip_softens_and_damps_while_a_gap_stiffens_with_amplitude() -> None:
    x = np.geomspace(1e-7, 1e-3, 200)
    for joint in (JENKINS, IWAN, BOLTED):
        assert np.all(np.diff(joint.equivalent_stiffness(x)) <= 1e-6)
        tiny = 1e-9 if joint is not BOLTED else 1e-12
        assert float(joint.equivalent_stiffness(tiny)) == pytest.approx(2e7, rel=1e-3)
        # Far beyond slip only the Coulomb force is left: H = 4 F/(pi X).
        assert float(joint.loss_stiffness(1e-2)) == pytest.approx(4 * 100.0 / (math.pi * 1e-2), rel=2e-3)
    gap = Gap(2e7, 4e-6).equivalent_stiffness(x)
    assert np.all(np.diff(gap) >= 0.0)
    assert np.all(gap[x <= 4e-6] == 0.0)
    assert gap[-1] == pytest.approx(2e7, rel=0.01)


def test_jenkins_damps_most_at_twice_its_slip_displacement() -> None:
    x = np.linspace(5e-6, 30e-6, 25001)
    assert x[JENKINS.loss_stiffness(x).argmax()] == pytest.approx(10e-6, rel=1e-3)
    assert float(JENKINS.loss_stiffness(x).max()) == pytest.approx(2e7 / math.pi, rel=1e-6)


def test_the_branches_of_iwan_meet_where_the_whole_joint_slips() -> None:
    for joint in (IWAN, BOLTED):
        at = joint.slip_displacement
        for verb in (joint.equivalent_stiffness, joint.loss_stiffness):
            assert float(verb(at)) == pytest.approx(float(verb(at * (1 + 1e-9))), rel=1e-6)


def test_a_bolted_joint_without_a_power_or_a_jump_is_the_even_iwan() -> None:
    even, x = PowerIwan(2e7, 100.0, 0.0), np.geomspace(1e-7, 1e-4, 60)
    assert even.slip_displacement == pytest.approx(10e-6)
    np.testing.assert_allclose(even.equivalent_stiffness(x), IWAN.equivalent_stiffness(x), rtol=1e-9)
    np.testing.assert_allclose(even.loss_stiffness(x), IWAN.loss_stiffness(x), rtol=1e-9)


def test_a_bolted_joint_loads_and_slips_as_segalman_says() -> None:
    # F = K_T x - R x^(chi + 2)/((chi + 1)(chi + 2)) up to D, F_S beyond; energy of a cycle 4 R X^(chi + 3)/...
    d, r, chi = BOLTED.slip_displacement, BOLTED.density, BOLTED.chi
    x = np.linspace(0.0, 2.0 * d, 300)
    loading = BOLTED.stiffness * x - r * x ** (chi + 2) / ((chi + 1) * (chi + 2))
    np.testing.assert_allclose(BOLTED.force(x), np.where(x < d, loading, 100.0), atol=0.02)
    small = np.geomspace(0.01, 1.0, 20) * d
    energy = 4.0 * r * small ** (chi + 3) / ((chi + 2) * (chi + 3))
    np.testing.assert_allclose(math.pi * BOLTED.loss_stiffness(small) * small**2, energy, rtol=1e-12)


def test_what_is_not_possible_is_refused_with_what_is_needed() -> None:
    with pytest.raises(InputError, match="slip force is -1"):
        Jenkins(1.0, -1.0)
    with pytest.raises(InputError, match="amplitudes > 0"):
        JENKINS.equivalent_stiffness(0.0)
    with pytest.raises(InputError, match="half of the play"):
        Gap(1.0, -1e-6)
    with pytest.raises(InputError, match="chi above -1"):
        PowerIwan(1.0, 1.0, -1.0)
    with pytest.raises(InputError, match="one history"):
        IWAN.force(np.zeros((2, 2)))
