"""Hammer: how often the 95 % interval of a compliance holds the truth, part by part, for few hits and many."""

import numpy as np
import pytest
import xarray as xr
from scipy import signal, stats

from process.errors import InputError
from process.labels import make_compliance, make_record
from smfe.error_factors import covariance_between
from smfe.hammer import Averaging, identify_hammer
from smfe.intervals import component_std, interval, student_quantile

# Two coupled modes seen in x and y: closed form, and exact motion under a force that is linear between samples.
FREQUENCY, DAMPING, STIFFNESS = np.array([45.0, 80.0]), np.array([0.03, 0.04]), np.array([2e6, 5e6])
SHAPE = np.array([[1.0, 0.5], [-0.4, 1.0]])  # mode, axis
RATE, SPACING, PULSE = 2000.0, 1.2, 5e-3
BAND = (30.0, 110.0)


def exact(frequency: np.ndarray, excitation: int = 0) -> np.ndarray:
    """Compliance (f, 2); a force that is linear between samples has sinc^2 of the transform of its samples."""
    r = frequency[:, None] / FREQUENCY
    modes = 1.0 / (STIFFNESS * (1.0 - r**2 + 2j * DAMPING * r))
    return (modes * SHAPE[:, excitation]) @ SHAPE * np.sinc(frequency / RATE)[:, None] ** 2


def response(force: np.ndarray, excitation: int = 0) -> np.ndarray:
    out = np.zeros((2, force.size))
    for f, zeta, k, shape in zip(FREQUENCY, DAMPING, STIFFNESS, SHAPE, strict=True):
        w = 2.0 * np.pi * f
        system = [[0.0, 1.0], [-(w**2), -2.0 * zeta * w]], [[0.0], [w**2 / k]], [[1.0, 0.0]], [[0.0]]
        q = signal.lsim(system, shape[excitation] * force, np.arange(force.size) / RATE)[1]
        out += np.outer(shape, q)
    return out


def clean_hits(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Force and displacement of each hit alone, shapes (count, n) and (count, 2, n); levels differ by a third."""
    n = round(SPACING * RATE)
    t = np.arange(n) / RATE - 0.03
    pulse = np.where((t >= 0.0) & (t <= PULSE), np.sin(np.pi * t / PULSE), 0.0)
    levels = 100.0 * (1.0 + 0.3 * np.linspace(-1.0, 1.0, count))
    moved = response(pulse)
    return levels[:, None] * pulse, levels[:, None, None] * moved


def noisy(
    clean: tuple[np.ndarray, np.ndarray], seed: int, force: float = 0.0, motion: float = 0.0, scatter: float = 0.0
) -> xr.Dataset:
    """One record; noise as share of the peak force and of the rms motion, hits that differ by a gain each."""
    rng = np.random.default_rng(seed)
    f, x = clean
    gain = 1.0 + scatter * rng.standard_normal(f.shape[0])
    displacement = np.concatenate(list(x * gain[:, None, None]), axis=1)
    displacement = displacement + motion * x.std() * rng.standard_normal(displacement.shape)
    total = f.ravel() + force * f.max() * rng.standard_normal(f.size)
    channels = {"force": {"x": total}, "displacement": {"x": displacement[0], "y": displacement[1]}}
    return make_record(np.arange(total.size) / RATE, channels)


def coverage(
    count: int, seeds: int, averaging: Averaging | None = None, gate: bool = False, **noise: float
) -> np.ndarray:
    """Share of seeds and lines in which the real and the imaginary part are inside their interval, (response, part)."""
    clean = clean_hits(count)
    inside = []
    for seed in range(seeds):
        record = noisy(clean, seed, **noise)
        found = identify_hammer(
            "hits", {"x": [record]}, frequency_range=BAND, averaging=averaging, gate_force=gate, exclude=()
        ).compliance
        bounds = interval(found)
        truth = exact(found["frequency"].values)
        low, high = bounds["lower"].values[:, :, 0], bounds["upper"].values[:, :, 0]
        real = (low.real <= truth.real) & (truth.real <= high.real)
        imaginary = (low.imag <= truth.imag) & (truth.imag <= high.imag)
        inside.append(np.stack([real.mean(axis=0), imaginary.mean(axis=0)], axis=1))
    return 100.0 * np.mean(inside, axis=0)


CASES = {
    "response noise, 3 hits": (3, {"motion": 0.3}, None, False),
    "response noise, 10 hits": (10, {"motion": 0.3}, None, False),
    "hits that differ by 3 %, 3 hits": (3, {"motion": 0.02, "scatter": 0.03}, None, False),
    "hits that differ by 3 %, 5 hits": (5, {"motion": 0.02, "scatter": 0.03}, None, False),
    "force noise and all, H1": (5, {"force": 0.001, "motion": 0.2, "scatter": 0.01}, None, False),
    "force noise and all, force window": (5, {"force": 0.02, "motion": 0.2, "scatter": 0.01}, None, True),
    "force noise and all, Hv": (5, {"force": 0.01, "motion": 0.2, "scatter": 0.01}, Averaging("Hv"), False),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=list(CASES))
def test_intervals_hold_the_truth_as_often_as_they_say(case: str) -> None:
    """95 % intervals over 200 seeds: 92 to 98 % for each response and part."""
    count, noise, averaging, gate = CASES[case]
    found = coverage(count, 200, averaging, gate, **noise)
    assert found.min() > 92.0
    assert found.max() < 98.0
