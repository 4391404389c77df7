"""Motion that is recorded late or early: seen in the residues of the modes, said, and in the interval."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from accuracy.strangers import stranger_passes
from scipy import linalg
from truth.sweep import drawn_modes
from truth.sweep_strangers import draw, measure

from smfe import LocalPolynomial, identify_sweep
from smfe.identification.sweep.delay import changed_by_delay, delay_of

BAND = (25.0, 75.0)
COARSE = LocalPolynomial(resolution=1.0, half_widths=(0.5, 1.0, 2.0))
POLES = np.array([31.0, 44.0, 62.0]) * (1.0 + 1j * np.array([0.02, 0.04, 0.03]))


def residues(turned: np.ndarray) -> np.ndarray:
    """Residues of real modes in any direction, each mode turned by an angle [rad], shape (3, 3, 3)."""
    u = np.random.default_rng(5).standard_normal((3, 3))
    return -1e-6 * np.einsum("mi,mj->mij", u, u) * np.exp(1j * turned)[:, None, None]


@pytest.mark.parametrize("late", [-2e-4, -3e-5, 5e-5])
def test_a_delay_turns_all_modes_in_proportion_to_their_frequency(late: float) -> None:
    residue = residues(-2.0 * np.pi * POLES.real * late)
    found = delay_of(POLES, residue, np.full(residue.shape, 1e-18), BAND)
    assert found is not None
    assert found.real
    assert found.modes == 3
    assert found.late == pytest.approx(late, rel=1e-9)


def test_damping_that_turns_modes_both_ways_and_poles_of_the_noise_are_no_delay() -> None:
    both = residues(np.array([0.05, -0.05, 0.04]))
    found = delay_of(POLES, both, np.full(both.shape, 1e-18), BAND)
    assert found is not None
    assert not found.real
    noisy = delay_of(POLES, both, np.full(both.shape, 1e-12), BAND)
    assert noisy is None


def damped_in_joints(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Poles [Hz] and residues at three directions of a machine whose damping sits in one or two joints."""
    n = int(rng.integers(4, 8))
    f = np.append(rng.uniform(25.0, 75.0, n - 1), rng.uniform(120.0, 300.0))
    shapes = linalg.qr(rng.standard_normal((n, n)))[0]
    stiffness = shapes @ np.diag((2.0 * np.pi * f) ** 2) @ shapes.T
    damping = shapes @ np.diag(0.04 * np.pi * f) @ shapes.T
    for _ in range(int(rng.integers(1, 3))):
        joint = rng.standard_normal(n)
        damping += 400.0 * np.pi * rng.uniform(0.02, 0.08) * np.outer(joint, joint) / (joint @ joint)
    state = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness, -damping]])
    s, left, right = linalg.eig(state, left=True, right=True)
    tip = rng.standard_normal((n, 3))
    residue = [
        np.outer(tip.T @ right[:n, m], left[n:, m].conj() @ tip) / (left[:, m].conj() @ right[:, m]) / (2j * np.pi)
        for m in np.flatnonzero(s.imag > 0.0)
    ]
    return s[s.imag > 0.0] / (2j * np.pi), np.array(residue)


def test_damping_in_the_joints_is_seldom_taken_for_a_delay() -> None:
    # 19 of 1000 (seed 3); their modes are turned by 0.2 rad. A delay of 0.2 ms turns them by 0.06.
    rng = np.random.default_rng(30)
    every = [damped_in_joints(rng) for _ in range(200)]
    found = [delay_of(p, a, np.full(a.shape, 1e-8 * np.abs(a).max() ** 2), BAND) for p, a in every]
    assert sum(d is not None and d.real for d in found) <= 10


def test_what_a_delay_changes_is_undone_by_it() -> None:
    frequency = np.linspace(25.0, 75.0, 11)
    true = np.ones((11, 1, 1)) * (1.0 - 0.3j)
    shown = true * np.exp(-2j * np.pi * frequency * 1e-4)[:, None, None]
    np.testing.assert_allclose(shown + changed_by_delay(shown, frequency, 1e-4), true, rtol=1e-12)


@pytest.mark.parametrize("late", [pytest.param(0.0, marks=pytest.mark.slow), -8e-5])
def test_a_late_channel_is_said_with_its_delay_and_the_interval_holds_the_truth(late: float) -> None:
    healthy = {"clock": 0.0, "column": 0.0, "touch_share": (0.0, 0.0), "fade": 0.0, "quantised": 0, "resampled": 0.0}
    cut = {"teeth": 3, "widths": (0.02, 0.03, 0.05), "depths": (0.6e-3,) * 3, "first": 16.0, "last": 60.0}
    rest = {"diameter": 0.08, "radii": (3e-6, -2e-6, 0.0), "seconds": 10.0, "lead": 1.0, "tail": 3.0}
    sensors = {"force_noise": 0.1, "motion_noise": 1e-3, "speed_signal": "speed", "late": late}
    machine = {"modes": drawn_modes(3, np.random.default_rng(24))}
    this = replace(draw(24), **(healthy | cut | rest | sensors | machine))
    found = identify_sweep("s", stranger_passes(this, measure(this, 24)), BAND, COARSE)
    said = [w for w in found.warnings if "against the force" in w]
    assert bool(said) == (late != 0.0)
    if late:
        assert "us too early" in said[0]
        assert float(said[0].split("reads ")[1].split(" ")[0]) == pytest.approx(-1e6 * late, abs=15.0)
    error = np.abs(found.compliance["compliance"].values - this.modes.compliance(found.compliance["frequency"].values))
    # Without it the error is eight times what is stated.
    assert np.sqrt(np.nanmean((error / found.compliance["compliance_std"].values) ** 2)) < 1.5
