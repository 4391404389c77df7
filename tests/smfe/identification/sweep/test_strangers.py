"""Intervals of sweeps on records as strangers bring them: noise of forces, contact in the air, quiet sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from accuracy.strangers import stranger_passes
from truth.sweep import Modes, drawn_modes
from truth.sweep_strangers import DrawnSweep, draw, measure

from process.errors import InputError
from smfe import LocalPolynomial, SingleReference, identify_sweep
from smfe.identification.sweep.chatter import chatter_of
from smfe.identification.sweep.noise import force_noise
from smfe.identification.sweep.passes import prepare

BAND = (25.0, 75.0)


def stranger(seed: int, **changes: object) -> DrawnSweep:
    """A sweep of 10 s with three teeth on a machine of three modes, with what is changed."""
    machine = {"modes": drawn_modes(3, np.random.default_rng(seed))}
    cut = {"teeth": 3, "diameter": 0.08, "widths": (0.02, 0.03, 0.05), "depths": (0.6e-3,) * 3, "feed": 1e-4}
    cut |= {"radii": (3e-6, -2e-6, 0.0), "first": 16.0, "last": 60.0, "seconds": 10.0, "ramps": (0.3, 0.3)}
    healthy = {"clock": 0.0, "column": 0.0, "late": 0.0, "touch_share": (0.0, 0.0), "fade": 0.0, "quantised": 0}
    sensors = {"resampled": 0.0, "force_noise": 0.01, "motion_noise": 1e-4, "lead": 1.0, "tail": 3.0}
    return replace(draw(seed), **(machine | cut | healthy | sensors | changes))


def over_stated(this: DrawnSweep, seed: int, estimator: object = None) -> float:
    """Rms error over the stated standard deviation."""
    data = stranger_passes(this, measure(this, seed))
    found = identify_sweep("s", data, BAND, estimator or LocalPolynomial(resolution=0.5)).compliance
    error = np.abs(found["compliance"].values - this.modes.compliance(found["frequency"].values))
    return float(np.sqrt(np.nanmean((error / found["compliance_std"].values) ** 2)))


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [{"touch_share": (0.03, 0.03)}, {"touch_share": (0.0, 0.05)}, {"fade": 0.5, "ramps": (0.3, 0.8)}],
    ids=["touch", "end", "fade"],
)
def test_contact_in_the_air_and_a_cut_that_fades_are_no_noise_of_the_force_sensor(
    changes: dict[str, object],
) -> None:
    assert over_stated(stranger(21, **changes), 21) < 1.5


@pytest.mark.parametrize(
    "touch", [(0.0, 0.04), *(pytest.param(r, marks=pytest.mark.slow) for r in ((0, 0), (0.04, 0)))]
)
def test_the_noise_of_the_forces_is_that_of_the_sensor_whatever_touches_at_the_ends(touch: tuple[float, float]) -> None:
    this = stranger(22, force_noise=5.0, touch_share=touch)
    found = force_noise([prepare(p) for p in stranger_passes(this, measure(this, 22))], ["x", "y", "z"], BAND)
    assert found is not None
    assert found.air
    np.testing.assert_allclose(found.density, this.force_noise**2 / 1000.0, rtol=3.0 * found.spread)


@pytest.mark.slow
def test_without_air_the_noise_of_the_forces_is_bounded_by_the_cut_and_charged() -> None:
    this = stranger(23, force_noise=2.0, lead=0.0, tail=0.0)
    found = force_noise([prepare(p) for p in stranger_passes(this, measure(this, 23))], ["x", "y", "z"], BAND)
    assert found is not None
    assert not found.air
    assert np.all(this.force_noise**2 / 1000.0 < 1.4 * found.density)
    assert over_stated(this, 23) < 2.0


@pytest.mark.slow
def test_sensors_without_noise_leave_the_error_of_the_model() -> None:
    # 3.8 with what the noise alone explains.
    this = stranger(25, force_noise=1e-3, motion_noise=1e-5, seconds=20.0, first=14.0, last=85.0)
    assert over_stated(this, 25) < 1.5


# --- chatter ----------------------------------------------------------------------------------------------------------


def chattering(depths: tuple[float, float, float], **changes: object) -> DrawnSweep:
    """Return a soft machine of one bad mode, cut with six teeth."""
    mode = Modes(np.array([45.0]), np.array([0.02]), np.array([20e6]), np.array([[0.6, 0.8, 0.0]]))
    changes = {
        "modes": mode,
        "teeth": 6,
        "radii": (2e-6, -2e-6, 0.0, 1e-6, 0.0, -1e-6),
        "speed_signal": "angle",
    } | changes
    return stranger(31, depths=depths, seconds=12.0, **changes)


def test_a_pass_that_chatters_is_noticed_and_a_stable_one_is_not() -> None:
    this = chattering((0.2e-3, 4e-3, 0.2e-3))
    records = measure(this, 31)
    for raw, data in zip(records, stranger_passes(this, records), strict=True):
        found = chatter_of(prepare(data), 6)
        assert bool(found) == (raw["between_orders"] > 0.35)
        assert (raw["between_orders"] > 0.35) == (data.label == "up")
        for part in found:
            assert 30.0 < part.frequency < 250.0
            assert part.share > 0.25


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes", [{"column_late": 0.2}, {"column": 0.02}, {"force_noise": 40.0}, {"speed_signal": "tacho"}]
)
def test_a_late_or_wrong_speed_column_and_a_noisy_sensor_are_no_chatter(changes: dict[str, object]) -> None:
    this = chattering((0.2e-3,) * 3, **({"speed_signal": "speed"} | changes))
    for data in stranger_passes(this, measure(this, 31)):
        assert chatter_of(prepare(data), 6) == []


def test_a_pass_that_chatters_is_left_out_with_the_reason_and_too_few_are_refused() -> None:
    this = chattering((0.2e-3, 4e-3, 0.2e-3))
    down, up, central = stranger_passes(this, measure(this, 31))
    estimator = LocalPolynomial(resolution=1.0, half_widths=(0.5, 1.0), rational=False)
    # What is left of it is shorter than a use is worth, or said.
    if all(c.interval[0] < 4.0 for c in chatter_of(prepare(up), 6)):
        with pytest.raises(InputError, match=r"pass 'up': it chatters from .* rpm"):
            identify_sweep("s", [down, up, central], BAND, estimator, teeth=6)
    again = replace(down, label="down again")
    found = identify_sweep("s", [down, up, central, again], BAND, estimator, axes=["x", "y"], teeth=6)
    assert any("pass 'up': it chatters" in w and "cut less deep" in w for w in found.warnings)
    alone = identify_sweep("s", [down, central, again], BAND, estimator, axes=["x", "y"], teeth=6)
    assert not any("chatters" in w for w in alone.warnings)


# --- a single reference -----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_single_reference_states_an_error_that_holds_the_truth() -> None:
    this = stranger(41, motion_noise=0.05, force_noise=1.0, seconds=20.0)
    found = identify_sweep("s", stranger_passes(this, measure(this, 41)), BAND, SingleReference(overlap=0.8)).compliance
    std = found["compliance_std"].values
    solved = np.isfinite(found["compliance"].values)
    assert solved.mean() > 0.9
    assert np.isfinite(std[solved]).all()
    error = np.abs(found["compliance"].values - this.modes.compliance(found["frequency"].values))
    assert 0.2 < np.sqrt(np.mean((error / std)[solved] ** 2)) < 2.0
