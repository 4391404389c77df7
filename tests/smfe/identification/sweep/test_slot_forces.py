"""What measured slot forces (leekunhwee, ForceCalculation) can say about the chain of a sweep.

Five feeds at a constant 6000 rpm, two teeth, 10 kHz, a second each; no motion was measured. Time is stretched tenfold,
so that the tooth passing lies at 20 Hz as at the start of a sweep: only ratios of times matter here.
"""

import math

import numpy as np
import pytest
import xarray as xr
from places import DATA
from scipy import fft

from process.errors import InputError
from process.labels import make_record
from process.machine.modes import ModalModel
from process.simulation.milling import simulate_forced
from smfe import LocalPolynomial, SweepPass, identify_sweep
from smfe.diagnosis.cutting.orders import find_rotation
from smfe.identification.spectra.spindle_angle import force_angle
from smfe.identification.sweep.passes import prepare
from smfe.identification.sweep.spindle_orders import project, spindle_waves
from smfe.records import Channel, read_records

FORCES = DATA / "milling_forces_ubc"
FEEDS = (300, 600, 900, 1200, 1500)
CHANNELS = {"time": Channel("Time", "s"), **{f"force_{a}": Channel(f"F{a}", "N") for a in "xyz"}}
NOMINAL = 6000.0 / 10.0 * math.pi / 30.0
MACHINE = ModalModel(
    [24.0, 34.0, 47.0],
    [0.03, 0.03, 0.04],
    [4e7, 3.5e7, 5e7],
    [[0.1, 0.8, 0.6], [0.9, 0.3, 0.1], [0.3, -0.5, 0.8]],
)


def slow(feed: int) -> xr.Dataset:
    """One slot, ten times as slow."""
    path = FORCES / f"6-n6000f{feed}ap3ae25.csv"
    if not path.is_file():
        pytest.skip(f"{path} is not here; set SMFE_DATA to the folder of public data")
    (record,) = read_records(path, CHANNELS)
    force = record["force"].values
    return make_record(np.arange(force.shape[1]) * 1e-3, {"force": dict(zip("xyz", force, strict=True))})


def rotation(record: xr.Dataset) -> float:
    """Speed [rad/s] from the period of the forces, near the nominal one."""
    return find_rotation(record["force"].values, 1e-3, NOMINAL, 2)


def orders(record: xr.Dataset) -> np.ndarray:
    """Amplitudes [N] of the orders 1 to 8, shape (8, 3)."""
    angle = rotation(record) * record["time"].values
    force = record["force"].values
    return 2.0 * np.abs([np.mean(force * np.exp(-1j * k * angle), axis=1) for k in range(1, 9)])


@pytest.mark.parametrize("feed", [900, 1200, 1500])
def test_the_forces_alone_give_the_angle_of_the_spindle(feed: int) -> None:
    record = slow(feed)
    inside = slice(1000, -1000)
    angle, time = force_angle(record, 2)[inside], record["time"].values[inside]
    slope, offset = np.polyfit(time, angle, 1)
    assert slope == pytest.approx(rotation(record), rel=1e-4)
    assert slope == pytest.approx(NOMINAL, rel=3e-4)
    assert np.std(angle - slope * time - offset) < 0.02


@pytest.mark.parametrize("feed", [300, 600])
def test_where_run_out_is_half_as_strong_as_the_teeth_the_forces_alone_do_not_give_the_speed(feed: int) -> None:
    # Two teeth of which one cuts little are one tooth to the force; a campaign has to give the speed then.
    record = slow(feed)
    strength = orders(record)
    assert strength[0, :2].sum() > 0.5 * strength[1, :2].sum()
    with pytest.raises(InputError, match="declare spindle_angle, tacho or spindle_speed"):
        force_angle(record, 2)


def test_run_out_does_not_grow_with_the_feed_and_the_passing_of_the_teeth_does() -> None:
    first, last = orders(slow(FEEDS[0])), orders(slow(FEEDS[-1]))
    assert last[0, :2] == pytest.approx(first[0, :2], rel=0.2)
    assert np.all(last[1, :2] > 2.0 * first[1, :2])


@pytest.mark.parametrize("feed", FEEDS)
def test_all_but_two_per_cent_of_the_power_of_the_force_goes_with_the_spindle(feed: int) -> None:
    record = slow(feed)
    record["spindle_angle"] = ("time", rotation(record) * record["time"].values)
    reach, n = (5.0, 85.0), record.sizes["time"]
    length = int(fft.next_fast_len(n, real=True))
    frequency = fft.rfftfreq(length, 1e-3)
    low, high = np.searchsorted(frequency, [reach[0] - 1e-9, reach[1] + 1e-9])
    force = record["force"].values - record["force"].values.mean(axis=1, keepdims=True)
    lines = 1e-3 * fft.rfft(force, length, axis=1)[:, low:high].T
    found = project(
        frequency[low:high], lines, spindle_waves(prepare(SweepPass(record, "slot")), list(range(1, 9)), reach)
    )
    rest = np.sum(np.abs(found.rest) ** 2) / np.sum(np.abs(lines) ** 2) / (1.0 - float(found.rank.mean()))
    assert rest < 0.02


def test_a_known_machine_under_the_measured_forces_is_found_with_the_error_that_is_stated() -> None:
    rng = np.random.default_rng(1)
    passes = []
    for feed in FEEDS:
        force = np.pad(slow(feed)["force"].values, ((0, 0), (1000, 3000)))
        record = simulate_forced(MACHINE, force, 1000.0).drop_vars("displacement")
        record["acceleration"] = record["acceleration"] + 0.01 * rng.standard_normal(force.shape)
        passes.append(SweepPass(record, f"{feed} mm/min"))
    bands = LocalPolynomial(1.0, (0.25, 0.5, 1.0), rational=False)
    found = identify_sweep("s", passes, (25.0, 65.0), bands)
    truth = MACHINE.matrix(found.compliance["frequency"].values)
    z = np.abs(found.compliance["compliance"].values - truth) / found.compliance["compliance_std"].values
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.7
    # Slots of one arc push along nearly one line at the passing of the teeth, whatever the feed.
    condition = found.compliance["force_condition"]
    assert float(condition.sel(frequency=[40.0, 60.0]).min()) > 30.0
    assert float(condition.sel(frequency=slice(45.0, 55.0)).max()) < 30.0
    assert any(w.startswith("badly conditioned (above 30) in 39-41 Hz") for w in found.warnings)
