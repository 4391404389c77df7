"""A clock or a speed column that is wrong: compared with the passing of the teeth, also while the speed sweeps."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from accuracy.strangers import stranger_passes
from truth.sweep import drawn_modes
from truth.sweep_strangers import DrawnSweep, draw, measure

from process.errors import InputError
from process.labels import make_record
from smfe import LocalPolynomial, SweepPass, identify_sweep
from smfe.campaign import load_campaign
from smfe.commands.check import check
from smfe.diagnosis.checks.cuts import clock_suspects
from smfe.identification.sweep.passes import PreparedPass, prepare
from smfe.identification.sweep.spindle_clock import changed_by_clock, compare_speeds, judge_clock, stated_bounds
from smfe.records import write_record_netcdf

COARSE = LocalPolynomial(resolution=0.5, half_widths=(0.5, 1.0), rational=False)


MACHINE = drawn_modes(3, np.random.default_rng(8))


def quiet(**changes: object) -> DrawnSweep:
    """A healthy campaign of three teeth, with what is changed."""
    base = replace(
        draw(1), modes=MACHINE, teeth=3, radii=(4e-6, -3e-6, 0.0), depths=(0.5e-3,) * 3, widths=(0.02, 0.03, 0.05)
    )
    healthy = {"clock": 0.0, "column": 0.0, "column_late": 0.0, "late": 0.0, "speed_signal": "speed", "nominal": False}
    rest = {"lead": 1.0, "tail": 1.5, "touch_share": (0.0, 0.0), "fade": 0.0, "diameter": 0.08}
    rest |= {"resampled": 0.0, "first": 16.0}
    ramp = {"last": 60.0, "seconds": 6.0, "force_noise": 0.5, "motion_noise": 0.005, "quantised": 0}
    return replace(base, **(healthy | rest | ramp | changes))


@cache
def passes(stated: bool = False, **changes: object) -> list[PreparedPass]:
    """Return the three passes of a healthy campaign with some changes."""
    this = quiet(**changes)
    return [prepare(p) for p in stranger_passes(this, measure(this, 3), stated)]


@pytest.mark.parametrize("error", [pytest.param(-0.02, marks=pytest.mark.slow), 0.003])
def test_a_time_base_or_a_speed_column_that_is_wrong_is_found_to_a_few_parts_in_ten_thousand(error: float) -> None:
    for key, expected in (("clock", 1.0 / (1.0 + error)), ("column", 1.0 / (1.0 + error))):
        (found,) = compare_speeds(passes(**{key: error})[0], 3)
        assert found.source == "spindle_speed"
        assert found.difference == pytest.approx(expected - 1.0, abs=4e-4)
        assert found.real


@pytest.mark.parametrize("source", ["speed", *(pytest.param(t, marks=pytest.mark.slow) for t in ("angle", "tacho"))])
def test_nothing_is_said_of_a_column_that_is_right_late_or_without_the_wander_of_the_spindle(source: str) -> None:
    for changes in ({}, {"column_late": 0.15}, {"nominal": True, "wander": 2e-3}):
        for p in passes(speed_signal=source, **changes):
            (found,) = compare_speeds(p, 3)
            assert not found.real
            assert abs(found.difference) < max(5e-4, 2.0 * found.std)
            assert not list(clock_suspects(p.record, "cut", 3))


def test_a_column_that_comes_late_is_no_error_of_a_clock() -> None:
    (found,) = compare_speeds(passes(column_late=0.15)[1], 3)
    assert found.late == pytest.approx(0.15, abs=0.02)


def test_without_the_number_of_teeth_the_lines_of_the_spindle_say_the_same() -> None:
    (found,) = compare_speeds(passes(column=-0.02)[0], None)
    assert found.difference == pytest.approx(1.0 / 0.98 - 1.0, abs=5e-4)


def test_two_per_cent_are_refused_with_the_figure_and_half_a_per_cent_is_in_the_interval() -> None:
    with pytest.raises(InputError, match=r"teeth pass at a frequency -1\.9\d .*time base"):
        identify_sweep("s", passes(clock=0.02), (25.0, 75.0), COARSE, teeth=3)
    this = quiet(clock=0.005)
    wrong = identify_sweep("s", passes(clock=0.005), (25.0, 75.0), COARSE, teeth=3)
    assert any("teeth pass at a frequency -0.49" in w or "teeth pass at a frequency -0.5" in w for w in wrong.warnings)
    frequency = wrong.compliance["frequency"].values
    error = np.abs(wrong.compliance["compliance"].values - this.modes.compliance(frequency))
    assert np.sqrt(np.mean((error / wrong.compliance["compliance_std"].values) ** 2)) < 1.5
    right = identify_sweep("s", passes(), (25.0, 75.0), COARSE, teeth=3)
    assert not any("teeth pass" in w for w in right.warnings)
    assert right.compliance["compliance_std"].mean() < 0.7 * wrong.compliance["compliance_std"].mean()


def test_stated_speeds_find_a_time_base_that_encoder_and_forces_share() -> None:
    for error in (0.0, 0.02):
        data = passes(stated=True, clock=error, speed_signal="angle")
        if error:
            with pytest.raises(InputError, match="the stated spindle speeds"):
                identify_sweep("s", data, (25.0, 75.0), COARSE, teeth=3)
        else:
            assert not any("stated" in w for w in identify_sweep("s", data, (25.0, 75.0), COARSE, teeth=3).warnings)


def ramp(
    clock: float, lead: float, rise: float, first: float = 10.0, last: float = 40.0
) -> tuple[xr.Dataset, np.ndarray]:
    """A force that rises within some time, over a spindle of which the angle is known [rad/s]: record and angle."""
    t = np.arange(0.0, lead + 10.0 + lead, 1e-3)
    rotation = first + (last - first) * (t - lead) / 10.0
    angle = np.cumsum(rotation) * 1e-3
    share = np.clip(np.minimum((t - lead) / rise, (lead + 10.0 - t) / rise), 0.0, 1.0)
    share = np.where((t >= lead) & (t <= lead + 10.0), share, 0.0) if lead else np.ones_like(t)
    noise = np.random.default_rng(1).standard_normal((3, t.size))
    force = 100.0 * share * (1.0 + 0.5 * np.sin(3.0 * angle)) + noise
    return make_record(t * (1.0 + clock), {"force": dict(zip("xyz", force, strict=True))}), angle


@pytest.mark.parametrize("rise", [0.05, 0.8])
@pytest.mark.parametrize("clock", [0.0, 0.006, -0.02])
def test_stated_speeds_bound_the_clock_by_when_the_cut_begins_and_ends(clock: float, rise: float) -> None:
    record, angle = ramp(clock, 2.0, rise)
    found = stated_bounds(prepare(SweepPass(record, "ramp")), angle, (10.0, 40.0))
    assert found is not None
    assert found.low <= 1.0 / (1.0 + clock) - 1.0 + 1e-3
    assert found.high >= 1.0 / (1.0 + clock) - 1.0 - 1e-3
    # A slow entry leaves open what it leaves open: 0.8 s are 0.8*3/40 of the last speed.
    assert found.high - found.low < (0.005 if rise < 0.1 else 0.08)
    assert (found.beyond != 0.0) == (abs(clock) > (0.005 if rise < 0.1 else 0.03))


def test_a_record_without_air_bounds_the_clock_by_the_speeds_that_it_misses() -> None:
    for clock in (0.02, 0.0, -0.02):
        record, angle = ramp(clock, 0.0, 0.1)
        found = stated_bounds(prepare(SweepPass(record, "ramp")), angle, (10.0, 40.0))
        assert found is not None
        assert found.low == pytest.approx(1.0 / (1.0 + clock) - 1.0, abs=1e-3)
        assert found.high == pytest.approx(found.low, abs=1e-3)
        inner = slice(1000, -500)
        short = stated_bounds(prepare(SweepPass(record.isel(time=inner), "ramp")), angle[inner], (10.0, 40.0))
        assert short is not None
        assert short.low < found.low < short.high
        assert short.beyond == 0.0


@pytest.mark.slow
def test_seven_parts_in_a_thousand_are_found_against_stated_speeds_and_not_more() -> None:
    data = passes(stated=True, clock=0.007, speed_signal="angle", ramps=(0.05, 0.05), seconds=14.0)
    clock = judge_clock("s", data, 3)
    assert any("the stated spindle speeds" in w for w in clock.warnings)
    assert clock.difference == pytest.approx(-0.007, abs=3e-3)
    for ramps in ((0.05, 0.05), (0.8, 0.8)):
        assert judge_clock("s", passes(stated=True, speed_signal="angle", ramps=ramps, wander=2e-3), 3).warnings == ()


def test_a_wrong_time_base_changes_a_compliance_by_the_scale_of_frequency_and_of_two_integrations() -> None:
    frequency = np.arange(20.0, 80.0, 0.05)

    def one_mode(f: np.ndarray) -> np.ndarray:
        return 1.0 / (1.0 - (f / 45.0) ** 2 + 0.1j * f / 45.0)

    d = 0.003
    # A record that runs slow by 1 + d shows the true line f (1 + d) at f, and divides by the wrong frequency squared.
    shown = one_mode(frequency / (1.0 + d)) / (1.0 + d) ** 2
    found = shown + changed_by_clock(shown, frequency, d, True)
    np.testing.assert_allclose(found[20:-20], one_mode(frequency[20:-20]), rtol=1e-3)


def test_a_cut_without_lines_says_nothing() -> None:
    assert compare_speeds(passes(force_noise=500.0)[0], 3) == []


def test_check_says_it_of_a_campaign_and_takes_stated_speeds(tmp_path: Path) -> None:
    this = quiet(clock=0.02, speed_signal="angle")
    rows = []
    for p in passes(clock=0.02, speed_signal="angle"):
        write_record_netcdf(p.record, tmp_path / f"{p.label}.nc")
        width = dict(zip(("down", "up", "central"), this.widths, strict=True))[p.label] * 1e3
        speeds = [f"{60.0 * f / 3.0:.4g} rpm" for f in (this.first, this.last)]
        rows.append(
            f'{{ file = "{p.label}.nc", cut = "{p.label}", width_of_cut = "{width:g} mm", spindle_speed = {speeds} }}'
        )
    file = tmp_path / "campaign.toml"
    file.write_text(
        '[campaign]\nname = "c"\n[tool]\ndiameter = "80 mm"\nteeth = 3\napproach_angle = "45 deg"\n'
        '[[measurement]]\nname = "sweep"\nmethod = "sweep"\nestimator = "bands"\nresolution = "1 Hz"\n'
        f'frequency_range = ["25 Hz", "75 Hz"]\nrecords = [{", ".join(rows)}]\n',
        encoding="utf-8",
    )
    assert load_campaign(file).measurements[0].records[0].spindle_speed == pytest.approx(
        (this.first * 2.0943951, this.last * 2.0943951), rel=1e-3
    )
    table = check(file)
    assert any("the stated spindle speeds" in text for text in table["evidence"])
