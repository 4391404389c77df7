"""Sensors against closed forms: resonance, filter, clock, noise, converter, tones, and the mass that a sensor adds."""

import math

import numpy as np
import pytest
import xarray as xr

from process.errors import InputError
from process.instruments.sensors import (
    AntiAlias,
    Clock,
    Converter,
    Drift,
    Grid,
    HammerTip,
    Inertia,
    Noise,
    Resonance,
    Sensitivity,
    Sensors,
    Stinger,
    Tone,
    with_added_mass,
)
from process.labels import make_record
from process.machine.machine import Machine
from process.machine.modes import ModalModel
from process.machine.structure import Posture, free_modes, released_modes

RATE = 16000.0
MACHINE = ModalModel([40.0, 90.0], [0.03, 0.05], [2e7, 5e7], [(0.6, 0.8, 0.0), (-0.5, 0.3, 0.9)])


def record_of(force: np.ndarray, acceleration: np.ndarray, rate: float = RATE) -> xr.Dataset:
    t = np.arange(force.shape[1]) / rate
    named = {"force": force, "acceleration": acceleration}
    return make_record(t, {name: dict(zip("xyz", rows, strict=True)) for name, rows in named.items()})


def sine(frequency: float, seconds: float = 2.0, rate: float = RATE) -> np.ndarray:
    """The same sine on all axes, whole periods in a second."""
    return np.tile(np.sin(2 * np.pi * frequency * np.arange(int(seconds * rate)) / rate), (3, 1))


def phasor(values: np.ndarray, frequency: float, rate: float = RATE) -> complex:
    """Of the second second, relative to the sine above."""
    n = int(rate)
    t = np.arange(n, 2 * n) / rate
    return complex(2j * np.mean(values[n : 2 * n] * np.exp(-2j * np.pi * frequency * t)))


def rng(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


def apply(stage, record: xr.Dataset, seed: int = 1) -> xr.Dataset:
    return stage.apply(record, rng(seed))


@pytest.mark.parametrize("frequency", [100.0, 800.0, 1500.0, 2200.0])
def test_a_dynamometer_amplifies_as_a_mass_on_a_spring(frequency: float) -> None:
    record = record_of(sine(frequency), sine(frequency))
    out = apply(Resonance("force", 2000.0, damping=0.03), record)
    r = frequency / 2000.0
    assert phasor(out["force"].values[1], frequency) == pytest.approx(1 / (1 - r**2 + 0.06j * r), rel=1e-4)
    np.testing.assert_array_equal(out["acceleration"].values, record["acceleration"].values)
    assert out["force"].attrs["units"] == "N"


def test_well_below_its_resonance_an_accelerometer_reads_too_much_by_the_square_of_the_frequency() -> None:
    out = apply(Resonance("acceleration_y", 5000.0, damping=1e-3), record_of(sine(500.0), sine(500.0)))
    gain = [abs(phasor(row, 500.0)) for row in out["acceleration"].values]
    assert gain == pytest.approx([1.0, 1 / (1 - 0.01), 1.0], rel=2e-4)


def test_a_resonance_conserves_the_impulse_of_a_hit() -> None:
    pulse = np.zeros((3, int(RATE)))
    pulse[:, 4000:4064] = np.sin(np.pi * np.arange(64) / 64)
    out = apply(Resonance("force", 1500.0, damping=0.05), record_of(pulse, pulse))["force"].values
    assert out.sum() == pytest.approx(pulse.sum(), rel=1e-6)
    assert np.abs(out[:, :3990]).max() < 1e-3, "nothing comes before its cause"


def test_gain_cross_axis_and_sign_are_one_matrix() -> None:
    true = np.array([sine(20.0)[0], 2 * sine(30.0)[0], 3 * sine(50.0)[0]])
    record = record_of(true, true)
    out = apply(Sensitivity("acceleration", ((1.02, 0.03, 0.0), (0.0, 0.97, 0.0), (0.0, 0.0, -1.0))), record)
    np.testing.assert_allclose(out["acceleration"].values[0], 1.02 * true[0] + 0.03 * true[1])
    np.testing.assert_allclose(out["acceleration"].values[1], 0.97 * true[1])
    np.testing.assert_allclose(out["acceleration"].values[2], -true[2])
    flipped = apply(Sensitivity.gains("force", (1.0, -1.0, 1.0)), record)["force"].values
    np.testing.assert_allclose(flipped, np.array([[1], [-1], [1]]) * true)


def test_a_turned_sensor_reads_a_vector_turned_back_of_the_same_length() -> None:
    angle = math.radians(3.0)
    true = np.zeros((3, 100))
    true[0] = 1.0
    out = apply(Sensitivity.rotated("force", "z", angle), record_of(true, true))["force"].values
    np.testing.assert_allclose(out[:, 0], [math.cos(angle), -math.sin(angle), 0.0], atol=1e-15)
    back = apply(Sensitivity.rotated("force", "z", -angle), record_of(out, out))["force"].values
    np.testing.assert_allclose(back, true, atol=1e-15)


def test_a_plate_takes_its_inertia_off_the_force_and_a_stinger_adds_its_own() -> None:
    """Newton for the mass between: a plate behind the cut passes on F - m a, a stinger needs F + m a for F."""
    force = np.zeros((3, 100))
    force[0, 40:50] = 5.0
    motion = np.full((3, 100), 2.0)
    record = record_of(force, motion)
    np.testing.assert_allclose(apply(Inertia(0.5), record)["force"].values, force - 1.0)
    tip = apply(HammerTip(0.5), record)["force"].values
    np.testing.assert_allclose(tip, np.where(force != 0, 6.0, 0.0))
    np.testing.assert_allclose(apply(Stinger(0.5), record)["force"].values, force + 1.0)


def test_the_error_of_a_plate_is_its_mass_times_the_accelerance() -> None:
    f, mass = 35.0, 3.0
    accelerance = -((2 * np.pi * f) ** 2) * MACHINE.matrix(f)[0, 0, 0]
    t = np.arange(2 * int(RATE)) / RATE
    motion = np.tile((accelerance * np.exp(2j * np.pi * f * t)).imag, (3, 1))
    out = apply(Inertia(mass), record_of(sine(f), motion))["force"].values[0]
    assert phasor(out, f) == pytest.approx(1 - mass * accelerance, rel=1e-9)


def test_a_charge_amplifier_drifts_in_a_straight_line() -> None:
    out = apply(Drift("force_y", 0.4), record_of(sine(10.0), sine(10.0)))["force"].values - sine(10.0)
    np.testing.assert_allclose(out[1], 0.4 * np.arange(out.shape[1]) / RATE, atol=1e-12)
    assert not out[[0, 2]].any()


def test_a_tone_has_its_amplitude_and_a_random_phase_from_the_seed() -> None:
    quiet = record_of(np.zeros((3, 32000)), np.zeros((3, 32000)))
    tone = Tone("acceleration_z", 0.05, frequency=49.0)
    one, again, other = (apply(tone, quiet, s)["acceleration"].values for s in (1, 1, 2))
    assert abs(phasor(one[2], 49.0)) == pytest.approx(0.05, rel=1e-6)
    np.testing.assert_array_equal(one, again)
    assert abs(phasor(one[2], 49.0) - phasor(other[2], 49.0)) > 1e-3
    assert not one[:2].any()


def test_a_tone_of_the_spindle_follows_its_angle_and_is_silent_without_one() -> None:
    record = record_of(np.zeros((3, 32000)), np.zeros((3, 32000)))
    tone = Tone("acceleration_x", 0.1, order=3.0, phase=0.2)
    assert not apply(tone, record)["acceleration"].values.any()
    angle = 10.0 * record["time"].values + 4.0 * record["time"].values ** 2
    turned = apply(tone, record.assign(spindle_angle=("time", angle)))["acceleration"].values[0]
    np.testing.assert_allclose(turned, 0.1 * np.cos(3 * angle + 0.2), atol=1e-15)


@pytest.mark.parametrize(("order", "frequency"), [(1, 100.0), (4, 200.0), (8, 300.0), (8, 800.0)])
def test_the_anti_alias_filter_is_a_butterworth_filter(order: int, frequency: float) -> None:
    out = apply(AntiAlias(order, 400.0), record_of(sine(frequency), sine(frequency)))
    force, motion = (phasor(out[name].values[0], frequency) for name in ("force", "acceleration"))
    assert abs(force) == pytest.approx(1 / math.sqrt(1 + (frequency / 400.0) ** (2 * order)), rel=2e-3)
    assert force == pytest.approx(motion, rel=1e-12), "one filter for all channels: no phase between them"


def test_the_slope_of_the_phase_at_0_hz_is_that_of_the_poles() -> None:
    filter_, f = AntiAlias(6, 400.0), np.linspace(0.0, 1.0, 11)
    slope = -np.gradient(np.angle(filter_.response(f)), 2 * np.pi * f)[0]
    # The sum of 1/sin of the pole angles over w_c.
    poles = np.pi * (2 * np.arange(1, 7) - 1) / 12
    assert slope == pytest.approx(np.sin(poles).sum() / (2 * np.pi * 400.0), rel=1e-4)


def test_a_skew_is_a_phase_that_grows_with_the_frequency() -> None:
    tau = 130e-6
    for frequency in (20.0, 100.0, 500.0):
        out = apply(Clock("acceleration", skew=tau), record_of(sine(frequency), sine(frequency)))
        assert phasor(out["acceleration"].values[0], frequency) == pytest.approx(
            np.exp(-2j * np.pi * frequency * tau), rel=1e-6
        )
        assert phasor(out["force"].values[0], frequency) == pytest.approx(1.0, rel=1e-9)


def test_a_slow_second_recorder_shifts_every_frequency_by_its_rate_error() -> None:
    out = apply(Clock("acceleration", rate_error=1e-3), record_of(sine(100.0, 4.0), sine(100.0, 4.0)))
    t = np.arange(int(3.9 * RATE)) / RATE
    np.testing.assert_allclose(out["acceleration"].values[0, : t.size], np.sin(2 * np.pi * 100.1 * t), atol=1e-6)


def test_noise_has_its_level_and_its_corner() -> None:
    quiet = record_of(np.zeros((3, 400_000)), np.zeros((3, 400_000)), 1000.0)
    white = apply(Noise("force", (1.0, 2.0, 0.0)), quiet)["force"].values
    np.testing.assert_allclose(white.std(axis=1), [1.0, 2.0, 0.0], rtol=0.01)
    pink = apply(Noise("acceleration", (1.0, 1.0, 1.0), corner=50.0), quiet)["acceleration"].values
    f = np.fft.rfftfreq(400_000, 1e-3)
    density = (np.abs(np.fft.rfft(pink)) ** 2).mean(axis=0) * 2 / (400_000 * 1000.0)
    for low, high in ((2.0, 3.0), (20.0, 30.0), (200.0, 300.0)):
        band = (f > low) & (f < high)
        expected = np.mean(1.0 / 500.0 * (1 + 50.0 / f[band]))
        assert density[band].mean() == pytest.approx(expected, rel=0.1)


def test_the_error_of_a_converter_has_the_variance_of_its_step_over_twelve() -> None:
    true = 8.0 * rng().uniform(-1, 1, (3, 100_000))
    converter = Converter("acceleration", 10.0, bits=8)
    error = apply(converter, record_of(true, true))["acceleration"].values - true
    assert converter.step == pytest.approx(20.0 / 256)
    assert error.var() == pytest.approx(converter.step**2 / 12, rel=0.01)
    assert np.abs(error).max() <= converter.step / 2 * (1 + 1e-9)


def test_a_converter_clips_at_its_range() -> None:
    out = apply(Converter("force_x", 0.5, bits=16), record_of(sine(10.0), sine(10.0)))["force"].values
    assert out[0].max() == pytest.approx(0.5, abs=2e-5)
    assert out[0].min() == -0.5
    np.testing.assert_array_equal(out[1], sine(10.0)[1])


def test_an_encoder_reads_whole_steps() -> None:
    t = np.arange(1000) / 1000.0
    record = make_record(t, {"force": {"x": 0 * t}, "encoder_position": {"x": 0.01 * t}})
    out = apply(Grid(1e-6), record)["encoder_position"].values[0]
    np.testing.assert_allclose(out / 1e-6, np.round(out / 1e-6), atol=1e-6)
    assert np.abs(out - 0.01 * t).max() <= 0.5e-6 * (1 + 1e-9)


def test_the_chain_delays_by_the_group_delay_and_then_takes_every_eighth_sample() -> None:
    filter_ = AntiAlias(4, 300.0)
    sensors = Sensors(anti_alias=filter_)
    out = sensors.measure(record_of(sine(10.0), sine(10.0)), rng(), keep=sensors.oversampling)
    assert out["time"].values[1] == pytest.approx(8 / RATE)
    measured = phasor(out["force"].values[0], 10.0, RATE / 8)
    delay = np.sin(np.pi * (2 * np.arange(1, 5) - 1) / 8).sum() / (2 * np.pi * 300.0)
    assert -np.angle(measured) / (2 * np.pi * 10.0) == pytest.approx(delay, rel=1e-2)


def test_a_perfect_chain_changes_nothing_but_the_rate() -> None:
    record = record_of(sine(50.0), sine(50.0))
    np.testing.assert_array_equal(Sensors().measure(record, rng())["force"].values, record["force"].values)
    sampled = Sensors().measure(record, rng(), keep=8)["force"].values
    # The sharp low-pass has a ripple of 0.15 %, the same on every channel.
    np.testing.assert_allclose(sampled[:, 50:-50], sine(50.0)[:, ::8][:, 50:-50], atol=2e-3)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_an_added_mass_is_the_formula_of_sherman_and_morrison(axis: str) -> None:
    f, mass, e = np.linspace(5.0, 150.0, 200), 12.0, np.eye(3)["xyz".index(axis)]
    phi = MACHINE.matrix(f)
    w2 = mass * (2 * np.pi * f) ** 2
    at = phi @ e
    expected = phi + w2[:, None, None] * at[:, :, None] * (e @ phi)[:, None, :] / (1 - w2 * (at @ e))[:, None, None]
    heavier = with_added_mass(MACHINE, mass, [axis])
    np.testing.assert_allclose(heavier.at().matrix(f), expected, rtol=1e-9, atol=1e-20)


def test_a_mass_on_one_mode_lowers_its_frequency_by_the_root_of_the_masses() -> None:
    single = ModalModel([50.0], [1e-3], [1e7], [(1.0, 0.0, 0.0)])
    loaded = with_added_mass(single, 10.0).at()
    assert loaded.modes()[0, 0] == pytest.approx(50.0 * math.sqrt(single.mass[0] / (single.mass[0] + 10.0)), rel=1e-9)


def test_a_mass_on_a_machine_with_slides_and_postures_is_on_every_structure() -> None:
    one = released_modes(MACHINE, {"x": 4000.0})
    f = np.linspace(5.0, 150.0, 50)
    held = with_added_mass(Machine(one), 12.0).idle_compliance(f)
    np.testing.assert_allclose(held, with_added_mass(MACHINE, 12.0).at().matrix(f), rtol=1e-9)
    moved = with_added_mass(Machine(Posture("y", [0.0, 1.0], (one, one))), 12.0)
    np.testing.assert_allclose(moved.idle_compliance(f, 0.4), held, rtol=1e-9)


def test_no_mass_changes_nothing() -> None:
    f = np.linspace(5.0, 150.0, 50)
    bare = Machine(free_modes(MACHINE.frequency, MACHINE.damping, MACHINE.mass, MACHINE.direction, {}))
    np.testing.assert_array_equal(with_added_mass(bare, 0.0).at().matrix(f), bare.at().matrix(f))


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: Resonance("force", 0.0), "must be positive"),
        (lambda: Resonance("velocity", 10.0), "channel 'velocity' is not known"),
        (lambda: Inertia(-1.0), "zero or positive"),
        (lambda: AntiAlias(0, 100.0), "give 1 to 20"),
        (lambda: Converter("force", 10.0, 1), "give 2 to 48"),
        (lambda: Tone("force_x", 1.0), "a frequency"),
        (lambda: Tone("force_x", 1.0, frequency=5.0, order=1.0), "one of them"),
        (lambda: Noise("force", (1.0, -1.0, 0.0)), "noise of force"),
        (lambda: Clock("force", rate_error=2.0), "below 0.5"),
        (lambda: Sensitivity("force", ((1.0, 0.0, 0.0),)), "3 x 3"),  # type: ignore[arg-type]
        (lambda: with_added_mass(MACHINE, -1.0), "added mass"),
        (lambda: with_added_mass(MACHINE, 1.0, ["u"]), "none of x, y, z"),
    ],
)
def test_impossible_instruments_are_refused(make, match: str) -> None:
    with pytest.raises(InputError, match=match):
        make()
