"""A moving coil against its transfer function, and the machine that it shakes against the bare one."""

import numpy as np
import pytest

from process.drive.axis import Drive
from process.drive.servo import tune
from process.errors import InputError
from process.friction.laws import Viscous
from process.instruments.actuator import MovingCoil
from process.instruments.sensors import Sensors
from process.instruments.trials import Running, actuator_trial, shaker_trial
from process.machine.machine import FeedAxis, Machine
from process.machine.modes import ModalModel
from process.machine.structure import two_mass_axes
from process.simulation.excitation import Chirp, PseudoRandom, SteppedSine

COIL = MovingCoil(mass=8.0, frequency=4.0, damping=0.5, bandwidth=400.0, housing=3.0)
MODE = ModalModel([30.0], [0.05], [4e7], [[1.0, 0.0, 0.2]])
RATE = 2000.0


def amplitude(signal: np.ndarray, frequency: float) -> complex:
    """Complex amplitude of a sine in the last second of a record."""
    t = np.arange(signal.size) / RATE
    last = t >= t[-1] - 1.0 + 0.5 / RATE
    basis = np.stack([np.sin(2 * np.pi * frequency * t[last]), np.cos(2 * np.pi * frequency * t[last])], axis=1)
    s, c = np.linalg.lstsq(basis, signal[last], rcond=None)[0]
    return complex(s, c)


def test_the_force_is_flat_from_ten_to_eighty_hertz() -> None:
    # Franco et al. 2024, Fig. 8b: relatively constant between 10 and 80 Hz.
    f = np.linspace(10.0, 80.0, 71)
    force = np.abs(COIL.transfer(f))
    assert force.max() / force.min() < 1.1
    assert abs(COIL.transfer(2.0)) < 0.3


@pytest.mark.parametrize("frequency", [5.0, 20.0, 80.0])
def test_a_floor_feels_the_transfer_function(frequency: float) -> None:
    sine = SteppedSine((frequency,), 40.0, 4.0, start=0.0)
    t = np.arange(round(4.0 * RATE)) / RATE
    felt, asked = (amplitude(e.force(t), frequency) for e in (COIL.on_floor(sine), sine))
    # Samples of the command are joined by straight lines, 128 in a period: (w h)^2/12.
    assert felt / asked == pytest.approx(complex(COIL.transfer(frequency)), rel=1e-3)


@pytest.mark.parametrize("frequency", [12.0, 30.0, 55.0])
def test_the_recorded_force_is_what_acts_on_the_bare_machine(frequency: float) -> None:
    record = actuator_trial(
        MODE, "x", [frequency], 50.0, Sensors(), np.random.default_rng(0), dwell=5.0, sample_rate=RATE, coil=COIL
    )
    force, moved = (amplitude(record[n].sel(axis="x").values, frequency) for n in ("force", "acceleration"))
    bare = complex(MODE.compliance([frequency])["compliance"].values[0, 0, 0])
    assert moved / force == pytest.approx(-((2 * np.pi * frequency) ** 2) * bare, rel=3e-3)
    # The force itself: the machine moves with the coil on it, so that less of what was asked acts near its resonance.
    w = 2 * np.pi * frequency
    seen = -COIL.mass * w**2 * (1j * w * 2 * 0.5 * 2 * np.pi * 4.0 + (2 * np.pi * 4.0) ** 2)
    seen /= (2 * np.pi * 4.0) ** 2 - w**2 + 1j * w * 2 * 0.5 * 2 * np.pi * 4.0
    loaded = 1.0 / (1.0 + (seen - COIL.housing * w**2) * bare)
    assert force / 50.0 == pytest.approx(complex(COIL.transfer(frequency)) * loaded, rel=3e-3)


def test_the_mass_of_the_coil_moves_with_a_machine_that_feeds() -> None:
    bench = Machine(
        two_mass_axes({"x": Drive(23.1, 11.3, 1.68e6, 104.0)}), {"x": FeedAxis(tune(29.0, 34.4), Viscous(168.0))}
    )
    f, coil = 40.0, MovingCoil(2.0, 5.0, 0.5)
    sine = SteppedSine((f,), 10.0, 3.0, start=0.0)
    record = shaker_trial(bench, "x", sine, 3.0, Sensors(), np.random.default_rng(0), RATE, Running({"x": 0.02}), coil)
    force, moved = (amplitude(record[n].sel(axis="x").values, f) for n in ("force", "acceleration"))
    bare = complex(bench.at(0.02).matrix([f])[0, 0, 0])
    assert moved / force == pytest.approx(-((2 * np.pi * f) ** 2) * bare, rel=3e-3)


def test_what_is_no_coil_is_refused() -> None:
    with pytest.raises(InputError, match="a coil of 0 kg"):
        MovingCoil(0.0, 5.0, 0.5)
    with pytest.raises(InputError, match="a binary sequence jumps"):
        COIL.on_floor(PseudoRandom(1.0, 100.0))
    assert COIL.on_floor(Chirp(10.0, 60.0, 5.0, 86.0)).end > 86.0
