"""Claims about two recorders with clocks of their own: offset and drift are found, with an honest error, or refused."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from process.errors import InputError
from process.labels import make_record
from process.types import Real
from smfe.campaign import load_campaign
from smfe.identification.measurement import records_of
from smfe.records import put_on_clock, write_record_csv
from smfe.records.clocks import resample


def force(t: Real) -> Real:
    """Return the force of a sweep cut: harmonics of a tooth passing frequency that rises from 30 to 60 Hz."""
    turns = 30.0 * t + 0.5 * (30.0 / 30.0) * t**2
    load = np.clip((t - 2.0) / 0.2, 0.0, 1.0) * np.clip((28.0 - t) / 0.2, 0.0, 1.0)
    return load * sum(300.0 / k * np.cos(2 * np.pi * k * turns + k**2) for k in range(1, 6))


def motion(t: Real) -> Real:
    return np.sin(2 * np.pi * 87.3 * t) + 0.3 * np.cos(2 * np.pi * 211.0 * t)


def recorded(
    rates: tuple[float, float], offset: float, drift: float, noise: float, seed: int
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the records of two recorders; the second shows ``(1 + drift)(t - offset)`` at t."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(30.0 * rates[0])) / rates[0]
    u = np.arange(int(27.0 * rates[1])) / rates[1]
    true = u / (1.0 + drift) + offset
    first = force(t) + noise * 300.0 * rng.standard_normal(t.size)
    second = force(true) + noise * 300.0 * rng.standard_normal(u.size)
    a = make_record(t, {"force": {"x": first}}, attrs={"source": "one.csv"})
    vectors = {"force": {"x": second}, "acceleration": {"z": motion(true)}}
    return a, make_record(u, vectors, attrs={"source": "two.csv"})


class TestInterpolation:
    @pytest.mark.parametrize("share", [0.05, 0.5, 0.8])
    def test_any_position_below_eight_tenths_of_nyquist(self, share: float) -> None:
        at = np.random.default_rng(0).uniform(40.0, 460.0, 500)
        found = resample(np.sin(np.pi * share * np.arange(500)), at)
        assert np.abs(found - np.sin(np.pi * share * at)).max() < 1.5e-4

    def test_a_coarser_grid_takes_away_what_it_cannot_hold(self) -> None:
        n = np.arange(8000)
        low, high = np.sin(2 * np.pi * 0.02 * n), np.sin(2 * np.pi * 0.2 * n)
        at = np.arange(400.0, 7600.0, 5.0)
        assert np.abs(resample(low + high, at, 5.0) - np.sin(2 * np.pi * 0.02 * at)).max() < 2e-4


class TestTwoRecorders:
    @pytest.mark.parametrize(
        ("rates", "offset", "drift"),
        [((2000.0, 2000.0), 0.0, 0.0), ((2048.0, 5000.0), 1.2345, 8e-5), ((5000.0, 1651.3), 2.9, -1.5e-4)],
    )
    def test_offset_and_drift_are_found(self, rates: tuple[float, float], offset: float, drift: float) -> None:
        a, b = recorded(rates, offset, drift, noise=0.02, seed=3)
        both = put_on_clock(a, b, "force_x")
        assert both.attrs["clock_ratio"] - 1.0 == pytest.approx(drift, abs=2e-6)
        assert both.attrs["clock_std_s"] < 2e-5
        t = both["time"].values
        assert t[0] < offset + 0.01
        inner = slice(200, -200)
        left = both["acceleration"].sel(axis="z").values - motion(t)
        assert np.abs(left[inner]).max() < 0.03  # a lag of 20 us at 211 Hz, and 1e-4 of interpolation

    @pytest.mark.slow
    def test_the_error_of_the_lag_is_what_it_says(self) -> None:
        errors, stds = [], []
        for seed in range(4):
            a, b = recorded((2000.0, 2000.0), 0.777, 5e-5, noise=0.2, seed=seed)
            both = put_on_clock(a, b, "force_x")
            errors.append((both.attrs["clock_ratio"] - 1.00005) / both.attrs["clock_ratio_std"])
            stds.append(both.attrs["clock_std_s"])
        assert 0.3 < np.sqrt(np.mean(np.square(errors))) < 2.0
        assert 1e-7 < np.median(stds) < 5e-5

    def test_the_channels_of_the_first_recorder_stay_untouched(self) -> None:
        a, b = recorded((2000.0, 2000.0), 1.0, 0.0, noise=0.01, seed=1)
        both = put_on_clock(a, b, "force_x")
        kept = a.sel(time=both["time"])
        np.testing.assert_array_equal(both["force"].sel(axis="x"), kept["force"].sel(axis="x"))

    def test_another_event_is_refused(self) -> None:
        a, b = recorded((2000.0, 2000.0), 1.0, 0.0, noise=0.01, seed=1)
        rng = np.random.default_rng(4)
        b["force"].loc[{"axis": "x"}] = rng.standard_normal(b.sizes["time"])
        with pytest.raises(
            InputError, match=r"force_x of one\.csv and two\.csv: the shared channel correlates by 0\.\d+"
        ):
            put_on_clock(a, b, "force_x")

    def test_a_channel_that_repeats_itself_is_refused(self) -> None:
        t = np.arange(20_000) / 2000.0
        wave = {"force": {"x": np.sin(2 * np.pi * 40.0 * t)}}
        a, b = (make_record(t, wave, attrs={"source": s}) for s in ("one.csv", "two.csv"))
        with pytest.raises(InputError, match=r"repeats itself, so that several lags fit equally well"):
            put_on_clock(a, b, "force_x")

    def test_faults(self) -> None:
        a, b = recorded((2000.0, 2000.0), 1.0, 0.0, noise=0.01, seed=1)
        with pytest.raises(InputError, match=r"one\.csv: the shared channel acceleration_z is not among force_x"):
            put_on_clock(a, b, "acceleration_z")
        with pytest.raises(InputError, match=r"500 samples are too few to align clocks"):
            put_on_clock(a, b.isel(time=slice(0, 500)), "force_x")
        twice = a.assign(spindle_speed=("time", np.ones(a.sizes["time"])))
        more = b.assign(spindle_speed=("time", np.ones(b.sizes["time"])))
        with pytest.raises(InputError, match=r"spindle_speed is in both one\.csv and two\.csv"):
            put_on_clock(twice, more, "force_x")


CAMPAIGN = """
[campaign]
name = "two recorders"
[channels]
time = { column = "t", unit = "s" }
force_x = { column = "Fx", unit = "N" }
[[measurement]]
name = "moves"
method = "actuator"
[[measurement.records]]
file = "one.csv"
excitation = "x"
[[measurement.records.with]]
file = "two.csv"
shared = "force_x"
[measurement.records.with.channels]
time = { column = "t", unit = "s" }
acceleration_z = { column = "az", unit = "m/s^2" }
OTHER
"""


class TestCampaign:
    def write(self, folder: Path, shared: str = 'force_x = { column = "Fx", unit = "N" }') -> Path:
        a, b = recorded((2000.0, 1000.0), 1.0, 5e-5, noise=0.01, seed=1)
        write_record_csv(a, folder / "one.csv")
        write_record_csv(b, folder / "two.csv")
        (folder / "c.toml").write_text(CAMPAIGN.replace("OTHER", shared))
        return folder / "c.toml"

    def test_a_record_entry_names_the_file_of_the_second_recorder(self, tmp_path: Path) -> None:
        campaign = load_campaign(self.write(tmp_path))
        assert [path.name for path in campaign.files] == ["one.csv", "two.csv"]
        (record,) = records_of(campaign.measurements[0].records[0])
        assert record.attrs["clock_ratio"] == pytest.approx(1.00005, abs=2e-6)
        assert set(record.data_vars) == {"force", "acceleration"}

    def test_the_shared_channel_must_be_declared_for_both(self, tmp_path: Path) -> None:
        with pytest.raises(
            InputError, match=r"records\[0\]\.with\[0\]\.shared: 'force_x' is not declared for this file"
        ):
            load_campaign(self.write(tmp_path, ""))
