"""A multisine shakes a joint with all its lines at once: it finds what its rms makes, not a sine of its size."""

import numpy as np
import pytest
from truth.imperfect.modal import _march

from smfe.diagnosis.frf.changed import Changed, Shaken
from smfe.diagnosis.frf.modal_dynamics import amplitude, full_compliance

FREQUENCY, DAMPING, STIFFNESS = 40.0, 0.03, 2e7
RATE, PERIOD = 1024.0, 8.0


def shaken_in_time(level: float, hard: float, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Lines [Hz] and compliance of one mode with a cubic spring [N/m3] under a multisine, integrated (Runge-Kutta)."""
    rng = np.random.default_rng(seed)
    n = round(PERIOD * RATE)
    lines = np.arange(round(5.0 * PERIOD), round(100.0 * PERIOD))
    spectrum = np.zeros(n + 1, complex)  # at twice the rate: the force between samples is known
    spectrum[lines] = np.exp(2j * np.pi * rng.random(lines.size))
    force = np.fft.irfft(spectrum, 2 * n)
    force *= level / np.sqrt(2.0) / force.std()
    mass = STIFFNESS / (2.0 * np.pi * FREQUENCY) ** 2
    loss = 2.0 * DAMPING * np.sqrt(STIFFNESS * mass)
    periods = 3
    rows = np.append(np.tile(force, periods), force[:1])[:, None]
    out = np.zeros((periods * n, 1))
    one, none = np.array([1.0]), np.zeros(0)
    _march(
        rows,
        1.0 / RATE,
        np.array([[1.0 / mass]]),
        np.array([[loss]]),
        np.array([[STIFFNESS]]),
        one,
        0.0,
        none,
        hard,
        out,
    )
    last = np.fft.rfft(out[-n:, 0])[lines] / np.fft.rfft(force[::2])[lines]
    f = lines / PERIOD
    return f, -last / (2.0 * np.pi * f) ** 2


def predicted(f: np.ndarray, level: float, hard: float, at_once: bool) -> np.ndarray:
    plain = Changed((FREQUENCY,), (DAMPING,), (STIFFNESS,), (1.0, 0.0, 0.0))
    reference = amplitude(plain, "actuator", level)
    # In coordinates of unit stiffness q = x sqrt(k); a cubic spring has 3/4 k3 a^2 at an amplitude a.
    size = 0.75 * hard / STIFFNESS * reference**2 / STIFFNESS
    power = np.gradient(f) / (f[-1] - f[0]) if at_once else None
    shaken = Shaken("actuator", level, reference, power)
    return full_compliance(plain._replace(hardening=(size, 1.0)), f, shaken)[:, 0, 0]


def test_a_joint_that_hardens_does_so_by_the_rms_of_a_multisine() -> None:
    level, hard = 2000.0, 0.0
    f, linear = shaken_in_time(level, hard, 0)
    rms = level / np.sqrt(2.0) * np.sqrt(np.mean(np.abs(linear) ** 2))
    hard = 0.04 * STIFFNESS / (3.0 * rms**2)  # 4 % stiffer by statistical linearisation, k + 3 k3 rms^2
    found = np.mean([shaken_in_time(level, hard, seed)[1] for seed in range(6)], axis=0)
    peak = f[np.argmax(np.abs(predicted(f, level, hard, True)))]
    assert peak / f[np.argmax(np.abs(linear))] == pytest.approx(1.02, abs=0.004)
    near = np.abs(f - peak) < 8.0
    size = np.linalg.norm(found[near])
    assert np.linalg.norm((predicted(f, level, hard, True) - found)[near]) / size < 0.1
    assert np.linalg.norm((predicted(f, level, hard, False) - found)[near]) / size > 0.3


def test_the_amplitude_of_a_mode_under_a_multisine_is_that_of_its_resonance_over_the_band() -> None:
    plain = Changed((FREQUENCY,), (DAMPING,), (STIFFNESS,), (1.0, 0.0, 0.0))
    f = np.linspace(0.02, 400.0, 200_000)
    phi = np.abs(full_compliance(plain, f, Shaken("actuator", 1.0, 1.0))[:, 0, 0])
    summed = np.sqrt(np.trapezoid(phi**2, f) / 100.0 * STIFFNESS)
    assert amplitude(plain, "actuator", 1.0, 100.0) == pytest.approx(float(summed), rel=1e-3)
