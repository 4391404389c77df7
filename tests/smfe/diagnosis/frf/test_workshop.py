"""What hits and sensors do to a compliance, against a machine that is hit so, and healthy machines in a workshop."""

import math
from dataclasses import replace

import numpy as np
import pytest
from exam.modal import ALL, draw, machine
from truth.modal_machine import LINES, Hidden, Setting, compliance
from truth.modal_workshop import turn

from smfe.campaign.tolerances import Tolerances
from smfe.diagnosis.frf.noise import Excited, near_mains
from smfe.diagnosis.frf.workshop import (
    apart,
    errors_of_condition,
    force,
    measured,
    mounting,
    runs,
    sensor_nuisances,
    without_own_noise,
)
from smfe.diagnosis.judgement.diagnose import diagnose

PHI = compliance(machine(1)[1], Hidden(), Setting(), LINES)
HITS = ("hit_direction", "setup_direction", "hit_position", "clock")
EXACT = Tolerances(**dict.fromkeys((*HITS, "sensor_position"), 0.0))


def excited(repeats: int = 4) -> Excited:
    return Excited(LINES, ALL, np.full((LINES.size, 9), 1e-9), "hammer", 0.3, repeats=repeats)


def flat(phi: np.ndarray) -> np.ndarray:
    return phi.reshape(LINES.size, 9)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_hit_that_leans_is_among_the_errors_and_nothing_else_is(axis: int) -> None:
    """The machine is turned under the hammer by a rotation, which moves the force of one column to first order."""
    lean = 1e-5 * np.eye(3)[(axis + 1) % 3]
    moved = PHI.copy()
    moved[:, :, axis] = PHI @ turn(np.cross(np.eye(3)[axis], lean)) @ np.eye(3)[axis]
    errors = errors_of_condition(excited(), PHI, replace(EXACT, setup_direction=1e-5))
    assert errors.shape == (6, LINES.size, 9)
    away = flat(moved - PHI)
    assert min(np.abs(e - away).max() for e in errors) < 1e-4 * np.abs(away).max()


def test_the_mean_of_many_hits_leans_as_the_set_up_does() -> None:
    both = replace(EXACT, setup_direction=0.03, hit_direction=0.02)
    few, many, only = (
        np.sqrt(np.sum(np.abs(errors_of_condition(excited(n), PHI, t)) ** 2))
        for n, t in ((1, both), (10**8, both), (1, replace(both, hit_direction=0.0)))
    )
    assert few / many == pytest.approx(math.hypot(0.03, 0.02) / 0.03)
    assert many == pytest.approx(only)


def test_a_late_clock_turns_the_phase_of_one_recording() -> None:
    """Hits along x, y and z are recorded one after the other: each column has a clock of its own."""
    late = errors_of_condition(excited(), PHI, replace(EXACT, clock=1e-7))
    assert len(late) == 3
    for axis, found in enumerate(late):
        turned = np.where(np.arange(3) == axis, np.exp(-2j * np.pi * LINES[:, None, None] * 1e-7), 1.0) * PHI
        np.testing.assert_allclose(found, flat(turned - PHI), rtol=1e-4, atol=0.0)


def test_exact_hits_have_no_errors_and_exact_sensors_no_parameters() -> None:
    assert errors_of_condition(excited(), PHI, EXACT).shape == (0, LINES.size, 9)
    exact = replace(EXACT, sensor_gain=0.0, mounting_angle=0.0, cross_talk=0.0)
    assert sensor_nuisances(exact) == ()


def test_sensors_and_hits_act_on_either_side_of_the_machine() -> None:
    values = {"turned_z": 0.02, "talk_xy": 0.01, "gain_z": 0.1, "lean_xy": 0.03, "reach_y": -0.02, "gain_force": 0.2}
    found = measured(PHI, LINES, values)
    np.testing.assert_allclose(found, mounting(values) @ PHI @ force(values), rtol=1e-12)
    # A hit along x that leans towards y has a force along both.
    np.testing.assert_allclose(force({"lean_xy": 0.03}) @ [1.0, 0.0, 0.0], [1.0, 0.03, 0.0])
    np.testing.assert_allclose(mounting({"turned_z": 0.02}), turn(np.array([0.0, 0.0, 0.02])), atol=1e-15)
    np.testing.assert_allclose(measured(PHI, LINES, {"reversed_force": 1.0}), -PHI)
    np.testing.assert_allclose(measured(PHI, LINES, {"reversed_x": 1.0})[:, 0], -PHI[:, 0])


def test_an_accelerometer_beside_its_place_is_no_wrong_gain() -> None:
    """It moves as the point does and by what the machine turns: over the distance, about as much over 0.3 m."""
    rng, known = np.random.default_rng(4), sensor_nuisances(Tolerances(sensor_gain=0.0, cross_talk=0.0))
    beside, turns = 3e-3 * rng.standard_normal((4000, 3)), rng.standard_normal((4000, 3, 3)) / 0.3
    shown = np.std([turn(r) @ t - t for r, t in zip(beside, turns, strict=True)], axis=0)
    step = 1e-4
    away = [(mounting({p.name: step}) - np.eye(3)) / step * p.prior for p in known]
    trusted = np.sqrt(np.sum(np.square(away), axis=0))
    np.testing.assert_allclose(np.diag(trusted), np.diag(shown), rtol=0.1)
    assert np.all(trusted > 0.95 * shown)


def test_what_hits_share_is_parted_from_their_noise() -> None:
    rng = np.random.default_rng(1)
    noise = 1e-11 * (rng.standard_normal((5, LINES.size, 3)) + 1j * rng.standard_normal((5, LINES.size, 3)))
    each = np.array([PHI[:, :, 0] + 0.02 * rng.standard_normal() * PHI[:, :, 1] for _ in range(5)]) + noise
    shared, left = apart(each, LINES, PHI, 0)
    rms = np.sqrt(np.mean(np.abs(left) ** 2) * 5.0 / 4.0)
    assert rms == pytest.approx(1e-11 * math.sqrt(2.0), rel=0.1)
    assert np.sqrt(np.mean(np.abs(shared) ** 2)) > 10.0 * rms
    assert np.sqrt(np.mean(np.abs(each - each.mean(axis=0)) ** 2)) > 20.0 * rms


def test_lines_near_the_mains_are_known() -> None:
    f = np.arange(10.0, 198.0, 0.5)
    near = near_mains(f)
    assert [float(f[s].mean()) for s in runs(near)] == [50.0, 60.0, 100.0, 120.0, 150.0, 180.0]
    assert f[near].size == 6 * 7


class TestSize:
    """A misfit counts by the real part where it is most negative."""

    def test_another_gain_has_its_own_size(self) -> None:
        x = Excited(LINES, (("x", "x"),), np.full((LINES.size, 1), 1e-9), "hammer", 0.3)
        phi = PHI[:, :1, 0]
        size = x.squared_size(x.whitened(phi), x.whitened(0.05 * phi))
        assert math.sqrt(size) == pytest.approx(0.05, rel=0.15)  # the real part is near its deepest there
        assert x.squared_size(x.whitened(phi), x.whitened(0.1 * phi)) == pytest.approx(4.0 * size)

    def test_cross_terms_and_other_frequencies_do_not_count(self) -> None:
        x = excited()
        seen = x.whitened(flat(PHI))
        wrong = PHI.copy()
        wrong[:, [0, 1, 2], [0, 1, 2]] = 0.0
        assert x.squared_size(seen, x.whitened(flat(wrong))) == 0.0
        low = np.where(LINES < 20.0, 1.0, 0.0)[:, None, None] * PHI
        assert x.squared_size(seen, x.whitened(flat(low))) == 0.0
        assert x.squared_size(seen, x.whitened(1j * np.abs(flat(PHI)))) == 0.0

    def test_what_all_lines_share_is_undone_first(self) -> None:
        x = excited()
        wide = replace(x, shared=errors_of_condition(x, PHI, Tolerances()))
        sizes = [e.squared_size(e.whitened(flat(PHI)), e.whitened(0.1 * flat(PHI))) for e in (x, wide)]
        assert sizes[1] == pytest.approx(sizes[0], rel=1e-9)


@pytest.mark.slow
def test_a_healthy_machine_in_a_workshop_is_consistent() -> None:
    """Hits lean and miss, sensors are calibrated to a per cent, clocks differ, damping changes along the stroke."""
    assert diagnose(draw(None, 3, ordinary=True)[0], 3).verdict == "consistent"


def test_an_error_in_proportion_to_noise_pulls_no_model_down() -> None:
    """Three errors of 1 % over 800 lines, the scale fitted: a tenth too low where they go with what was seen."""
    frequency, found = np.linspace(20.0, 120.0, 800), {"as seen": [], "without own noise": []}
    truth = 1e-6 / (1.0 - (frequency / 60.0) ** 2 + 0.1j * frequency / 60.0)[:, None]
    std = np.full((frequency.size, 1), 0.3 * np.abs(truth).max())
    rng, ones = np.random.default_rng(3), np.ones(3)[:, None, None]
    for _ in range(40):
        noise = (rng.standard_normal(truth.shape) + 1j * rng.standard_normal(truth.shape)) * std / np.sqrt(2.0)
        seen = truth + noise
        shapes = {"as seen": seen, "without own noise": without_own_noise(seen, std, 1.1 * truth)}
        for name, shape in shapes.items():
            x = Excited(frequency, (("x", "x"),), std, "hammer", 1.0, shared=0.01 * ones * shape)
            data, model = x.whitened(seen), x.whitened(truth)
            found[name].append(model @ data / (model @ model))
    pulled, kept = (np.mean(x) for x in found.values())
    unsure = np.std(found["without own noise"]) / np.sqrt(40)
    assert pulled < 0.9
    assert abs(kept - 1.0) < 3.0 * unsure


def test_lines_further_apart_than_a_resonance_is_wide_are_taken_as_they_were_measured() -> None:
    """42 lines from 14 to 150 Hz, a mode 1 % beside the expected one: the mean of two neighbours errs by far more."""
    std = np.full(LINES.size, 1e-3 * np.abs(PHI[:, 0, 0]).max())
    beside = np.interp(LINES, 1.01 * LINES, PHI[:, 0, 0])
    rng = np.random.default_rng(5)
    seen = PHI[:, 0, 0] + std * (rng.standard_normal(LINES.size) + 1j * rng.standard_normal(LINES.size)) / np.sqrt(2.0)
    off = np.abs(without_own_noise(seen, std, beside) - PHI[:, 0, 0]).max()
    assert off < 4.0 * std[0]
    assert np.abs(without_own_noise(seen, np.full(LINES.size, np.inf), beside) - PHI[:, 0, 0]).max() > 4.0 * off
