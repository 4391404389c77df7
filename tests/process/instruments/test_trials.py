"""Virtual trials: what the instruments record is the machine plus the stated noise."""

from dataclasses import replace

import numpy as np
import pytest

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.servo import Servo, tune
from process.errors import InputError
from process.friction.laws import Viscous
from process.instruments.sensors import AntiAlias, Resonance, Sensors, with_added_mass
from process.instruments.trials import Running, actuator_trial, hammer_trial, milling_trial, moving_trial, silent_trial
from process.labels import axis_present
from process.machine.machine import FeedAxis, Machine
from process.machine.modes import ModalModel
from process.machine.structure import two_mass_axes
from process.simulation.excitation import Chirp, HalfSine, Multisine, PseudoRandom, SteppedSine, all_harmonics
from process.simulation.milling import MillingCut, Spindle
from process.simulation.problem import SampledControl

MACHINE = ModalModel([40.0], [0.03], [2e7], [(0.6, 0.8, 0.0)])
QUIET = Sensors()
SERVO = Servo(4e5, 0.03, 25.0)
AXIS = Machine(two_mass_axes({"x": Drive(4000.0, 300.0, 4e7, 5e3)}), {"x": FeedAxis(SERVO, Viscous(4000.0))})


def test_a_half_sine_pulse_has_the_given_impulse() -> None:
    t = np.arange(0, 0.1, 1e-6)
    pulse = HalfSine(2.5, 4e-3, 0.02).force(t)
    assert np.trapezoid(pulse, t) == pytest.approx(2.5, rel=1e-6)
    assert pulse.max() == pytest.approx(np.pi / 2 * 2.5 / 4e-3, rel=1e-6)


def test_a_hammer_record_holds_its_hits_and_one_force_axis() -> None:
    record = hammer_trial(MACHINE, "y", [2.0, 3.0], QUIET, np.random.default_rng(1))
    assert axis_present(record, "force") == ["y"]
    force = record["force"].sel(axis="y").values
    halves = [force[:8000].sum() / 2000.0, force[8000:].sum() / 2000.0]
    assert halves == pytest.approx([2.0, 3.0], rel=1e-3)


def test_a_stepped_sine_keeps_its_phase_and_its_amplitude() -> None:
    sine = SteppedSine((20.0, 30.0), 100.0, 1.0).force(np.arange(4000) / 2000.0)
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


def test_one_filter_on_all_channels_leaves_the_compliance_as_it_is() -> None:
    """The delay of the anti-alias filter is in force and motion alike."""
    sensors = Sensors(anti_alias=AntiAlias(8, 400.0))
    record = actuator_trial(MACHINE, "x", [35.0], 100.0, sensors, np.random.default_rng(1), dwell=4.0)
    t = record["time"].values
    last = slice(6000, 8000)
    kernel = np.exp(-2j * np.pi * 35.0 * t[last])
    force = record["force"].sel(axis="x").values[last] @ kernel
    motion = record["acceleration"].values[:, last] @ kernel / -((2 * np.pi * 35.0) ** 2)
    np.testing.assert_allclose(motion / force, MACHINE.matrix(35.0)[0, :, 0], rtol=2e-3)
    assert abs(np.angle(force * 1j)) > 0.1


def test_a_silent_record_of_a_machine_without_drives_is_its_noise() -> None:
    record = silent_trial(MACHINE, 20.0, Sensors((1.0,) * 3, (0.02, 0.03, 0.001)), np.random.default_rng(1))
    np.testing.assert_allclose(record["acceleration"].std("time").values, [0.02, 0.03, 0.001], rtol=0.03)


def test_a_machine_without_drives_takes_no_feed() -> None:
    with pytest.raises(InputError, match="has no drives"):
        hammer_trial(MACHINE, "x", [1.0], Sensors(), np.random.default_rng(1), running=Running(feed=0.01))


def test_an_actuator_on_a_moving_axis_measures_its_linear_compliance() -> None:
    running = Running(feed=0.01)
    record = actuator_trial(AXIS, "x", [50.0], 100.0, QUIET, np.random.default_rng(1), dwell=4.0, running=running)
    t = record["time"].values
    last = slice(6000, 8000)
    kernel = np.exp(-2j * np.pi * 50.0 * t[last])
    force = record["force"].sel(axis="x").values[last] @ kernel
    motion = record["acceleration"].sel(axis="x").values[last] @ kernel / -((2 * np.pi * 50.0) ** 2)
    assert motion / force == pytest.approx(AXIS.at(0.01).matrix(50.0)[0, 0, 0], rel=5e-3)


def test_a_moving_axis_travels_with_its_feed_and_shakes_with_its_drive() -> None:
    shaken = {"x": Chirp(20.0, 60.0, 1000.0, 1.5, 0.2)}
    records = [
        moving_trial(AXIS, 2.0, QUIET, np.random.default_rng(1), forces, running=Running(feed=0.02))
        for forces in (None, shaken)
    ]
    for record in records:
        assert np.ptp(record["encoder_position"].sel(axis="x").values) == pytest.approx(0.04, rel=0.01)
    still, moved = (float(np.std(record["acceleration"].sel(axis="x").values)) for record in records)
    assert moved > 100 * still
    assert list(records[0]["axis"].values) == ["x", "y", "z"]


def test_a_machine_of_modes_and_one_of_matrices_make_the_same_cut() -> None:
    """Two simulations, one by modes and one by matrices, and a sensor that both go through."""
    tool = Tool(0.08, 2)
    cut = MillingCut(
        tool, engagement("down", 0.02, 0.08), CuttingCoefficients(1.9e9, 8e8, 3e8), 1e-3, feed_per_tooth=1e-4
    )
    sensors = Sensors(stages=(Resonance("force", 2000.0),))
    one, two = (
        milling_trial(machine, cut, Spindle(70.0), 0.6, sensors, np.random.default_rng(1), 0.1, 0.3)
        for machine in (MACHINE, with_added_mass(MACHINE, 0.0))
    )
    for name in ("force", "acceleration"):
        size = np.abs(one[name].values).max()
        np.testing.assert_allclose(two[name].values, one[name].values, atol=0.02 * size)


@pytest.mark.parametrize(
    ("delay", "control", "dead"),
    [(0.75e-3, None, 0.75e-3), (0.0, SampledControl(0.5e-3, 2), 1e-3), (0.0, None, 0.0)],
    ids=["dead time", "sampled", "prompt"],
)
@pytest.mark.parametrize("binary", [True, False], ids=["prbs", "multisine"])
def test_the_commanded_force_shows_the_open_loop_with_its_dead_time(
    delay: float, control: SampledControl | None, dead: float, binary: bool
) -> None:
    plain = Drive(23.1, 11.3, 1.68e6, 104.0)
    axis = FeedAxis(tune(29.0, 34.4, delay=delay), Viscous(168.0))
    machine, rate, skip = Machine(two_mass_axes({"x": plain}), {"x": axis}), 4000.0, 6
    sequence = PseudoRandom(5.0, 1000.0, 9, periods=8, start=0.0)
    tones = Multisine(1.0 / sequence.period, all_harmonics(4, 150), 3.0, periods=8, start=0.0)
    record = moving_trial(
        machine,
        8 * sequence.period,
        Sensors(),
        np.random.default_rng(0),
        {"x": sequence if binary else tones},
        rate,
        Running({"x": 500.0 / 6e4}, control=control),
        commanded=True,
    )
    count = round(sequence.period * rate)
    moved = record["encoder_position"] - record["reference_position"]
    lines = [np.fft.rfft(v.sel(axis="x").values[skip * count :])[::2] for v in (moved, record["drive_force"])]
    f = np.arange(lines[0].size) / sequence.period
    band = (f > 10.0) & (f < 250.0)
    found = lines[0][band] / lines[1][band]
    true = replace(plain, sigma=168.0).open_loop(f[band], dead)
    assert np.abs(found / true - 1.0).max() < 0.01
    # The phase at 200 Hz knows the dead time to microseconds.
    late = np.angle(found / replace(plain, sigma=168.0).open_loop(f[band], 0.0)) / (-2.0 * np.pi * f[band])
    assert np.median(late[f[band] > 100.0]) == pytest.approx(dead, abs=5e-6)
