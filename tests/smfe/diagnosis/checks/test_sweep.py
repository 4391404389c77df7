"""Sweeps inverted as if the loop were open and the posture constant: seen where it is wrong, and only there."""

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from samples.linear_machine import TOOL as DEMO_TOOL
from samples.linear_machine import sweep_passes
from scipy import stats

from process.cut.engagement import engagement
from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.drive.axis import Drive
from process.drive.servo import Servo
from process.friction.laws import Viscous
from process.machine.machine import FeedAxis, Machine
from process.machine.structure import Posture, two_mass_axes
from process.simulation.excitation import Multisine, all_harmonics
from process.simulation.machine import simulate_machine
from process.simulation.milling import MillingCut, Spindle
from smfe.diagnosis.checks.sweep import (
    _unweighted,
    matters,
    posture_difference,
    regeneration_difference,
    sweep_suspects,
)
from smfe.identification.sweep.passes import SweepPass

TOOL = Tool(0.08, 4, approach_angle=math.pi / 4.0)
WIDTHS = {"down": 0.024, "up": 0.04, "central": 0.068}
STEEL = CuttingCoefficients(1.8e9, 0.7e9, 0.25e9, 3e4, 4.5e4, 5e3)
AXIS = Drive(460.0, 226.0, 3.4e7, 4000.0, Servo(1.25e5, 10.9e-3, 45.5))
BAND = (22.0, 60.0)
DURATION = 24.0


def machine(*stiffness: float) -> Machine:
    parts = [two_mass_axes({"x": replace(AXIS, stiffness=AXIS.stiffness * k)}) for k in stiffness]
    structure = parts[0] if len(parts) == 1 else Posture("x", (0.0, 0.1), parts)
    return Machine(structure, {"x": FeedAxis(AXIS.servo, Viscous(3000.0))})


@functools.cache
def swept(cut: str, stiffness: tuple[float, ...] = (1.0,), shaken: float = 0.0, depth: float = 1e-3) -> xr.Dataset:
    """Tooth passing from 20 to 50 Hz in one pass of 72 mm; `shaken`: unmeasured force on the slide [N rms]."""
    mill = MillingCut(TOOL, engagement(cut, WIDTHS[cut], TOOL.diameter), STEEL, depth, feed_rate=3e-3)
    spindle = Spindle(2.0 * math.pi * 5.0, 2.0 * math.pi * 7.5 / DURATION)
    push = {"x": Multisine(0.03, all_harmonics(600, 2200), shaken, 1, list(WIDTHS).index(cut), 0.0)} if shaken else None
    where = {"feed": {"x": 3e-3}, "position": 0.01} if len(stiffness) > 1 else {}
    return simulate_machine(
        machine(*stiffness),
        duration=DURATION,
        lead=0.5,
        tail=3.0,
        cut=mill,
        spindle=spindle,
        drive_forces=push,
        sample_rate=1000.0,
        **where,
    )


def passes(records: dict[str, xr.Dataset]) -> list[SweepPass]:
    return [SweepPass(r, c, engagement(c, WIDTHS[c], TOOL.diameter)) for c, r in records.items()]


def noisy(record: xr.Dataset, seed: int, motion: float = 1e-8, force: float = 0.0) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    out = record.drop_vars("acceleration").copy(deep=True)
    out["displacement"] = out["displacement"] + motion * rng.normal(size=out["displacement"].shape)
    out["force"] = out["force"] + force * rng.normal(size=out["force"].shape)
    return out


def plain(shaken: float = 0.0, **more) -> list[SweepPass]:
    return passes({c: noisy(swept(c, shaken=shaken, **more), k) for k, c in enumerate(WIDTHS)})


def test_a_quiet_machine_gives_no_suspect() -> None:
    assert not list(sweep_suspects("sweep", plain(), TOOL.teeth, BAND))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_the_published_setup_gives_no_suspect(seed: int) -> None:
    data = [SweepPass(r, c, engagement(c, 0.012, DEMO_TOOL.diameter)) for c, r in sweep_passes(seed).items()]
    assert not list(sweep_suspects("sweep", data, DEMO_TOOL.teeth, (20.0, 80.0)))


SHAKEN = 100.0


@pytest.mark.slow
def test_what_shakes_the_machine_comes_back_through_the_cut() -> None:
    # The same vibration twice: felt by the cut, and added to the record of a cut that does not feel it.
    closed = plain(SHAKEN)
    found = regeneration_difference(closed, TOOL.teeth, BAND)
    assert found is not None
    assert matters(found)
    said = list(sweep_suspects("sweep", closed, TOOL.teeth, BAND))
    assert "regeneration_bias" in [s.cause for s in said]
    assert "instrument" in next(s.evidence for s in said if s.cause == "regeneration_bias")

    open_loop = {}
    for k, c in enumerate(WIDTHS):
        alone = simulate_machine(
            machine(1.0),
            duration=DURATION + 3.5,
            drive_forces={"x": Multisine(0.03, all_harmonics(600, 2200), SHAKEN, 1, k, 0.0)},
            sample_rate=1000.0,
        )
        record = noisy(swept(c), k)
        n = min(record.sizes["time"], alone.sizes["time"])
        record = record.isel(time=slice(0, n)).copy(deep=True)
        record["displacement"] = record["displacement"] + alone["displacement"].values[:, :n]
        open_loop[c] = record
    quiet = regeneration_difference(passes(open_loop), TOOL.teeth, BAND)
    assert quiet is None or not matters(quiet)


def test_the_p_value_of_noise_is_uniform_whatever_rows_and_columns_share() -> None:
    """Circular noise of a covariance that is nearly singular: the sum of squares needs no inverse of it."""
    rng, lines, p = np.random.default_rng(3), 40, []
    left, right = (rng.standard_normal((lines, 3, 3)) + 1j * rng.standard_normal((lines, 3, 3)) for _ in range(2))
    right[:, 2] = right[:, 0] + 1e-9 * right[:, 2]
    noise, spread = left @ left.conj().swapaxes(1, 2), right.conj().swapaxes(1, 2) @ right
    for _ in range(400):
        white = (rng.standard_normal((lines, 3, 3)) + 1j * rng.standard_normal((lines, 3, 3))) / math.sqrt(2.0)
        p.append(_unweighted(np.arange(40.0), left @ white @ right, noise, spread, np.ones((lines, 3, 3))).p_value)
    assert stats.kstest(p, "uniform").pvalue > 0.01
    louder = _unweighted(np.arange(40.0), 3.0 * left @ white @ right, noise, spread, np.ones((lines, 3, 3)))
    assert louder.p_value < 1e-20


@pytest.mark.slow
def test_noise_of_the_vibration_alone_has_the_p_values_of_noise() -> None:
    p = []
    for seed in range(24):
        data = passes({c: noisy(swept(c), 100 * seed + k, motion=1e-6) for k, c in enumerate(WIDTHS)})
        found = regeneration_difference(data, TOOL.teeth, BAND)
        assert found is not None
        p.append(found.p_value)
    assert min(p) > 0.005
    assert 0.3 < float(np.median(p)) < 0.8


def test_noise_of_the_force_sensor_is_not_taken_for_regeneration() -> None:
    data = passes({c: noisy(swept(c), k, force=20.0) for k, c in enumerate(WIDTHS)})
    found = regeneration_difference(data, TOOL.teeth, BAND)
    assert found is not None
    assert not matters(found)


@pytest.mark.parametrize("change", [0.9, pytest.param(1.1, marks=pytest.mark.slow)])
def test_a_machine_that_changes_along_the_pass_is_seen(change: float) -> None:
    data = passes({c: noisy(swept(c, (1.0, change)), k) for k, c in enumerate(WIDTHS)})
    assert "posture" in [s.cause for s in sweep_suspects("sweep", data, TOOL.teeth, BAND)]


def test_without_a_spindle_angle_or_a_common_band_nothing_is_claimed() -> None:
    bare = [SweepPass(p.record.drop_vars("spindle_angle"), p.label, p.arc) for p in plain()]
    assert regeneration_difference(bare, TOOL.teeth, BAND) is None
    short = [SweepPass(p.record.isel(time=slice(0, 3000)), p.label, p.arc) for p in plain()]
    assert posture_difference(short, (22.0, 30.0)) is None
