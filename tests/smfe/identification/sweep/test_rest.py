"""From rest to rest or not: decided by what moves, not by how strong an axis is or how noisy its sensor."""

import numpy as np
import pytest
import xarray as xr
from scipy import signal

from process.labels import make_record
from smfe.identification.sweep.passes import at_rest

RATE = 1000.0


def sweep(
    weak: float = 1.0, lead: float = 0.5, tail: float = 2.0, ringing: float = 0.0, drift: float = 0.0, seed: int = 0
) -> xr.Dataset:
    """Twenty seconds in the cut. Force z is `weak` times that of x, noise 1 N; motion y rings on at the end."""
    rng = np.random.default_rng(seed)
    t = np.arange(round((20.0 + lead + tail) * RATE)) / RATE
    cut = (t >= lead) & (t < lead + 20.0)
    wave = np.sin(2.0 * np.pi * (20.0 * t + t**2)) * cut
    noise = rng.standard_normal((6, t.size))
    if drift:
        noise[5] = drift * signal.lfilter([1.0], [1.0, -0.995], rng.standard_normal(t.size + 5000))[5000:]
    decay = np.exp(-np.maximum(t - lead - 20.0, 0.0) / 0.15) * ~cut * (t > lead)
    force = {"x": 300.0 * wave + noise[0], "y": 100.0 * wave + noise[1], "z": 300.0 * weak * wave + noise[2]}
    end = ringing * np.sin(2.0 * np.pi * 30.0 * t) * (t > lead + 20.0)
    motion = {
        "x": 5.0 * (wave + decay * np.sin(200.0 * t)) + 0.01 * noise[3],
        "y": 2.0 * wave + end + 0.01 * noise[4],
        "z": 0.03 * wave + 0.01 * noise[5],
    }
    return make_record(t, {"force": force, "acceleration": motion})


@pytest.mark.parametrize("weak", [1.0, 0.01, 0.001, 0.0])
def test_an_axis_with_little_force_has_no_say(weak: float) -> None:
    assert at_rest(sweep(weak))


def test_slow_noise_of_a_weak_axis_is_no_motion_that_goes_on() -> None:
    """Its rms over 0.1 s varies by itself: the quietest of two hundred pieces says nothing of the last one."""
    assert np.mean([at_rest(sweep(drift=0.3, seed=seed)) for seed in range(40)]) >= 0.85


@pytest.mark.parametrize("change", [{"lead": 0.0}, {"tail": 0.0}, {"lead": 0.0, "tail": 0.0}, {"ringing": 0.4}])
def test_a_cut_that_goes_on_and_a_machine_that_rings_are_not_at_rest(change: dict[str, float]) -> None:
    assert not at_rest(sweep(**change))


def test_noise_without_a_cut_is_not_from_rest_to_rest() -> None:
    """Nothing says that there was air."""
    record = sweep()
    record["force"].values[:] = np.random.default_rng(1).standard_normal(record["force"].shape)
    assert not at_rest(record)


def test_units_and_gains_of_channels_change_nothing() -> None:
    for change in ({}, {"weak": 0.001}, {"tail": 0.0}, {"ringing": 0.4}):
        record = sweep(**change)
        scaled = record.copy(deep=True)
        scaled["force"].values *= np.array([[1e-3], [1.0], [50.0]])
        scaled["acceleration"].values *= np.array([[9.81], [1e-3], [1.0]])
        assert at_rest(scaled) == at_rest(record)


def test_a_record_without_any_force_is_no_cut_and_no_division_by_zero() -> None:
    record = sweep()
    record["force"].values[:] = 0.0
    assert not at_rest(record)
