"""Claims: faults of single channels are named with their place, clean channels give nothing, tones are found."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from process.labels import make_record
from smfe.campaign import Campaign, Measurement, RecordEntry
from smfe.diagnosis.checks.channels import (
    channel_suspects,
    converter_step,
    gravity_suspects,
    silence_suspects,
    tone_suspects,
    tones,
)
from smfe.diagnosis.checks.suspect import suspect_table
from smfe.records import Channel, write_record_netcdf

RATE = 2000.0


def noisy_record(seed: int = 0, seconds: float = 8.0, **spoil: np.ndarray) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    n = round(seconds * RATE)
    channels = {name: {axis: rng.standard_normal(n) for axis in "xyz"} for name in ("force", "acceleration")}
    for key, samples in spoil.items():
        name, axis = key.split("_")
        channels[name][axis] = samples
    return make_record(np.arange(n) / RATE, channels)


class TestChannels:
    def test_clean_noise_is_not_suspicious(self) -> None:
        for seed in range(20):
            assert not list(channel_suspects(noisy_record(seed), "here"))

    def test_an_axis_at_rest_is_not_a_dead_channel(self) -> None:
        record = noisy_record()
        still = {axis: np.zeros(record.sizes["time"]) for axis in "xyz"}
        moved = make_record(
            record["time"].values,
            {"acceleration": {a: record["acceleration"].sel(axis=a).values for a in "xyz"}, "encoder_position": still},
        )
        assert not list(channel_suspects(moved, "here"))

    def test_axes_fed_together_share_their_ramp_and_are_not_one_channel(self) -> None:
        record, rng = noisy_record(), np.random.default_rng(3)
        t = record["time"].values
        ramp = 560.0 / 60e3 * t
        shaken = {axis: ramp + 1e-7 * rng.standard_normal(t.size) for axis in "xy"}
        acceleration = {a: record["acceleration"].sel(axis=a).values for a in "xyz"}
        # z moves without any vibration: its ramp is no signal of its own.
        fed = make_record(t, {"acceleration": acceleration, "encoder_position": {**shaken, "z": ramp}})
        assert np.corrcoef(shaken["x"], shaken["y"])[0, 1] > 0.999999
        assert not list(channel_suspects(fed, "here"))
        same = make_record(t, {"acceleration": acceleration, "encoder_position": {**shaken, "z": shaken["x"]}})
        (found,) = channel_suspects(same, "here")
        assert found.where == "here, encoder_position_x and encoder_position_z"

    def test_a_cut_off_channel_is_named_with_its_side(self) -> None:
        t = np.arange(16000) / RATE
        clipped = np.clip(3.0 * np.sin(2 * np.pi * 7.3 * t), -10.0, 2.0)
        (found,) = channel_suspects(noisy_record(acceleration_y=clipped), "here")
        assert (found.cause, found.level) == ("saturation", "fault")
        assert found.where == "here, acceleration_y"
        assert "at its top, 2" in found.evidence

    def test_a_sine_that_only_reaches_its_top_smoothly_is_not_cut_off(self) -> None:
        t = np.arange(16000) / RATE
        assert not list(channel_suspects(noisy_record(acceleration_y=np.sin(2 * np.pi * 0.5 * t)), "here"))

    def test_zeros_of_a_force_window_are_no_dead_channel(self) -> None:
        rng = np.random.default_rng(1)
        windowed = np.where(np.arange(16000) < 200, rng.standard_normal(16000), 0.0)
        (found,) = channel_suspects(noisy_record(force_x=windowed), "here")
        assert (found.cause, found.level) == ("windowed_channel", "note")
        dead = list(channel_suspects(noisy_record(force_x=np.full(16000, 3.0)), "here"))
        assert dead[0].level == "fault"

    def test_the_converter_step_is_found_and_its_noise_is_stated(self) -> None:
        rng = np.random.default_rng(2)
        coarse = np.round(rng.standard_normal(16000) / 0.5) * 0.5
        assert converter_step(coarse) == pytest.approx(0.5)
        (found,) = channel_suspects(noisy_record(acceleration_x=coarse), "here")
        assert found.cause == "quantisation"
        assert "adds 0.14 rms" in found.evidence  # q/sqrt(12)

    def test_gravity_in_units_of_g_is_a_unit_error(self) -> None:
        rng = np.random.default_rng(3)
        in_g = noisy_record(acceleration_z=1.0 + 0.01 * rng.standard_normal(16000))
        (found,) = gravity_suspects([("here", in_g)])
        assert (found.cause, found.where) == ("unit_error", "here, acceleration_z")
        assert [s.where for s in gravity_suspects([("a", in_g), ("b", in_g)])] == [
            "a, acceleration_z",
            "b, acceleration_z",
        ]
        # A record that vibrates has no say.
        loud = noisy_record(acceleration_z=0.7 + rng.standard_normal(16000))
        both = gravity_suspects([("here", in_g), ("too", in_g), ("there", loud)])
        assert [s.where for s in both] == ["here, acceleration_z", "too, acceleration_z"]
        # One quiet record among others tells gravity from no offset; nor do two that differ by 3 %.
        assert not list(gravity_suspects([("here", in_g), ("there", loud)]))
        more = noisy_record(acceleration_z=0.985 + 0.01 * rng.standard_normal(16000))
        above = noisy_record(acceleration_z=1.013 + 0.01 * rng.standard_normal(16000))
        assert not list(gravity_suspects([("here", more), ("there", above)]))
        # An offset of one record is no unit.
        other = noisy_record(acceleration_z=0.2 + 0.01 * rng.standard_normal(16000))
        assert not list(gravity_suspects([("here", in_g), ("there", other)]))

    def test_one_signal_on_two_axes(self) -> None:
        samples = np.random.default_rng(4).standard_normal(16000)
        (found,) = channel_suspects(noisy_record(acceleration_x=samples, acceleration_y=-2.0 * samples), "here")
        assert (found.cause, found.where) == ("sensor_axis", "here, acceleration_x and acceleration_y")


class TestTones:
    @pytest.mark.parametrize("seed", range(5))
    def test_noise_has_no_tones_and_a_planted_one_has_its_amplitude(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        t = np.arange(16000) / RATE
        noise = rng.standard_normal(16000)
        assert tones(noise, 1.0 / RATE) == []
        (found, *_) = tones(noise + 0.5 * np.sin(2 * np.pi * 50.0 * t), 1.0 / RATE)
        assert found[0] == pytest.approx(50.0, abs=0.13)
        assert found[1] == pytest.approx(0.5, rel=0.15)
        record = noisy_record(seed, acceleration_x=noise + 0.5 * np.sin(2 * np.pi * 50.0 * t))
        (suspect,) = tone_suspects(record, "silent")
        assert "multiple of the mains" in suspect.evidence


def test_what_is_said_of_several_channels_takes_one_row():
    held = np.random.default_rng(1).standard_normal((3, 16000))
    held[:2, 4000:8000], held[2, 4000:8000] = 0.0, 3.0
    found = list(channel_suspects(noisy_record(force_x=held[0], force_y=held[1], acceleration_z=held[2]), "a, b.csv"))
    assert len(found) == 3
    table = suspect_table(found)
    assert table["level"].tolist() == ["warning", "note"]
    assert table["where"].tolist() == ["a, b.csv, acceleration_z", "a, b.csv, force_x, force_y"]


def silent_campaign(folder: Path, moving: np.ndarray) -> Campaign:
    time = np.arange(moving.size) * 1e-3
    rest = 0.01 * np.random.default_rng(1).standard_normal(moving.size)
    out = []
    for name, samples, feed in (("rest", rest, 0.0), ("moving", moving, 0.01)):
        write_record_netcdf(make_record(time, {"acceleration": {"x": samples}}), folder / f"{name}.nc")
        entry = RecordEntry(files=(folder / f"{name}.nc",), channels={"time": Channel()}, feed={"x": feed})
        out.append(Measurement(name=name, method="silent", records=(entry,), channels={}, feed={"x": feed}))
    return Campaign(folder / "campaign.toml", "silence", measurements=tuple(out))


def test_an_axis_that_vibrates_by_itself_is_named_and_a_noisy_one_is_not(tmp_path: Path) -> None:
    time, rng = np.arange(8000) * 1e-3, np.random.default_rng(2)
    noise = 0.5 * rng.standard_normal(time.size)
    assert list(silence_suspects(silent_campaign(tmp_path, noise))) == []
    sine = np.sin(2.0 * np.pi * 61.3 * time) + 0.05 * rng.standard_normal(time.size)
    (found,) = silence_suspects(silent_campaign(tmp_path, sine))
    assert found.cause == "limit_cycle"
    assert found.where == "moving, acceleration_x"
