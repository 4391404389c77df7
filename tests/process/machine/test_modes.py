"""A modal machine: static limit, resonance, reciprocity, passivity, state space."""

import numpy as np
import pytest

from process.errors import InputError
from process.machine.modes import ModalModel
from process.units import displacement_over_acceleration

MACHINE = ModalModel(
    [33.37, 57.44, 58.61],
    [0.061, 0.0822, 0.0287],
    [45.5e6, 32.1e6, 36.7e6],
    [(-0.055, 0.6245, 0.7724), (0.0199, 0.9968, -0.0161), (0.999, 4.0028e-4, 0.0096)],
)
FREQUENCY = np.linspace(1.0, 200.0, 400)


def test_at_zero_frequency_each_mode_is_its_spring() -> None:
    expected = np.einsum("r,ri,rj->ij", 1 / MACHINE.stiffness, MACHINE.direction, MACHINE.direction)
    np.testing.assert_allclose(MACHINE.matrix(0.0)[0], expected, rtol=1e-14)


def test_far_above_its_modes_the_machine_is_its_mass() -> None:
    f = 1e5
    expected = np.einsum("r,ri,rj->ij", 1 / MACHINE.mass, MACHINE.direction, MACHINE.direction)
    np.testing.assert_allclose(MACHINE.matrix(f)[0] / displacement_over_acceleration(f), expected, rtol=2e-4)


def test_one_mode_at_resonance_is_quarter_turn_late_and_1_over_2_zeta_k() -> None:
    one = ModalModel([61.367], [0.011935], [1.68e6], [(1.0, 0.0, 0.0)])
    assert one.matrix(61.367)[0, 0, 0] == pytest.approx(-1j / (2 * 0.011935 * 1.68e6), rel=1e-12)


def test_compliance_is_reciprocal_and_passive() -> None:
    matrix = MACHINE.matrix(FREQUENCY)
    np.testing.assert_allclose(matrix, matrix.transpose(0, 2, 1), rtol=1e-12)
    # exp(+jwt): a passive machine takes power in, so -Im(Phi) is positive semi-definite.
    assert np.linalg.eigvalsh(-matrix.imag).min() > -1e-20


def test_state_space_has_the_same_response() -> None:
    a, b, c = MACHINE.state_space()
    for f in (10.0, 33.0, 58.0, 150.0):
        direct = c @ np.linalg.solve(2j * np.pi * f * np.eye(a.shape[0]) - a, b)
        np.testing.assert_allclose(direct, MACHINE.matrix(f)[0], rtol=1e-9, atol=1e-16)


def test_a_single_axis_is_the_corner_of_the_matrix() -> None:
    part = MACHINE.compliance([50.0], ["y"], ["x", "z"])
    np.testing.assert_array_equal(part["compliance"].values[0, 0], MACHINE.matrix(50.0)[0, 1, [0, 2]])
    assert part["compliance"].attrs["units"] == "m/N"


@pytest.mark.parametrize("bad", [{"damping": [-0.01]}, {"stiffness": [0.0]}, {"frequency": [np.nan]}])
def test_a_machine_that_is_not_passive_is_refused(bad: dict[str, list[float]]) -> None:
    good = {"frequency": [50.0], "damping": [0.02], "stiffness": [1e7], "direction": [(1.0, 0.0, 0.0)]}
    with pytest.raises(InputError, match="must be positive"):
        ModalModel(**{**good, **bad})  # type: ignore[arg-type]


def test_modes_without_direction_are_refused() -> None:
    with pytest.raises(InputError, match="each mode needs"):
        ModalModel([50.0, 60.0], [0.02, 0.02], [1e7, 1e7], [(1.0, 0.0, 0.0)])
