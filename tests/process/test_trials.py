"""Virtual trials: what the instruments record is the machine plus the stated noise."""

import numpy as np
import pytest

from process.compliance import ModalModel
from process.errors import InputError
from process.labels import axis_present
from process.trials import Sensors, actuator_trial, half_sine, hammer_trial, stepped_sine

MACHINE = ModalModel([40.0], [0.03], [2e7], [(0.6, 0.8, 0.0)])
QUIET = Sensors()


def test_a_half_sine_pulse_has_the_impulse_it_is_asked_for() -> None:
    t = np.arange(0, 0.1, 1e-6)
    pulse = half_sine(t, 0.02, 2.5, 4e-3)
    assert np.trapezoid(pulse, t) == pytest.approx(2.5, rel=1e-6)
    assert pulse.max() == pytest.approx(np.pi / 2 * 2.5 / 4e-3, rel=1e-6)


def test_a_hammer_record_holds_its_hits_and_one_force_axis() -> None:
    record = hammer_trial(MACHINE, "y", [2.0, 3.0], QUIET, np.random.default_rng(1))
    assert axis_present(record, "force") == ["y"]
    force = record["force"].sel(axis="y").values
    halves = [force[:8000].sum() / 2000.0, force[8000:].sum() / 2000.0]
    assert halves == pytest.approx([2.0, 3.0], rel=1e-3)


def test_a_stepped_sine_keeps_its_phase_and_its_amplitude() -> None:
    sine = stepped_sine([20.0, 30.0], 100.0, 1.0, 2000.0)
    assert np.abs(sine).max() == pytest.approx(100.0, rel=1e-4)
    assert np.abs(np.diff(sine)).max() < 100 * 2 * np.pi * 30.0 / 2000.0 * 1.01


def test_actuator_motion_is_the_compliance_of_the_machine() -> None:
    record = actuator_trial(MACHINE, "x", [35.0], 100.0, QUIET, np.random.default_rng(1), dwell=4.0)
    t = record["time"].values
    last = slice(6000, 8000)
    kernel = np.exp(-2j * np.pi * 35.0 * t[last])
    force = record["force"].sel(axis="x").values[last] @ kernel
    motion = record["acceleration"].values[:, last] @ kernel / -((2 * np.pi * 35.0) ** 2)
    np.testing.assert_allclose(motion / force, MACHINE.matrix(35.0)[0, :, 0], rtol=2e-3)


def test_noise_has_the_stated_level_and_comes_from_the_seed() -> None:
    sensors = Sensors((1.0, 1.0, 1.0), (0.02, 0.03, 0.001))
    first, again, other = (
        actuator_trial(MACHINE, "z", [35.0], 1e-9, sensors, np.random.default_rng(s), dwell=10.0) for s in (5, 5, 6)
    )
    np.testing.assert_array_equal(first["acceleration"].values, again["acceleration"].values)
    assert not np.array_equal(first["acceleration"].values, other["acceleration"].values)
    np.testing.assert_allclose(first["acceleration"].std("time").values, [0.02, 0.03, 0.001], rtol=0.03)


def test_an_unknown_axis_is_refused() -> None:
    with pytest.raises(InputError, match="none of x, y, z"):
        hammer_trial(MACHINE, "w", [1.0], QUIET, np.random.default_rng(1))
