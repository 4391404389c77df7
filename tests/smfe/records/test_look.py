"""Claims about `smfe look`: what a file is, from the file alone, and a campaign file that `smfe check` accepts."""

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import io
from scipy.io import wavfile
from truth.kinds import KINDS, draw
from typer.testing import CliRunner

import smfe
from process.errors import InputError
from process.labels import make_record
from smfe.cli import app
from smfe.commands.check import check
from smfe.records import write_record_netcdf
from smfe.records.kind import kind_of
from smfe.records.look import Look, examine

HEADERS = {"force": "F", "acceleration": "a", "spindle_speed": "n", "sound": "Mic"}
UNITS = {"force": "N", "acceleration": "m/s²", "spindle_speed": "U/min", "sound": "Pa"}


def table(kind: str, seed: int) -> pd.DataFrame:
    """Return a record as a table with units in its headers."""
    drawn = draw(kind, seed)
    size = next(iter(drawn.columns.values())).size
    columns = {"Zeit [s]": np.arange(size) / drawn.rate}
    for name, values in drawn.columns.items():
        vector = name if name in HEADERS else name[:-2]
        columns[f"{HEADERS[vector]}{'' if name in HEADERS else name[-1]} [{UNITS[vector]}]"] = values
    return pd.DataFrame(columns)


class TestKinds:
    @pytest.mark.parametrize("kind", KINDS)
    def test_of_six_records_of_a_kind_all_but_one_are_recognised(self, kind: str) -> None:
        found = [kind_of(d.columns, d.rate).name for d in (draw(kind, seed) for seed in range(6))]
        assert found.count(kind) >= 5, found

    def test_what_says_nothing_is_unknown(self) -> None:
        assert kind_of({"spindle_angle": np.arange(100.0)}, 100.0).name == "unknown"
        assert kind_of({"force_x": np.ones(100)}, 100.0).name == "unknown"


def start(path: Path) -> Look:
    """Write the campaign file beside the record, as `smfe.look` does, and draw nothing."""
    found = examine(path, path.parent)
    path.with_name(f"{path.name}.look.toml").write_text(found.campaign, encoding="utf-8")
    return found


class TestStart:
    @pytest.mark.parametrize(
        "kind", [k if k == "impact test" else pytest.param(k, marks=pytest.mark.slow) for k in KINDS]
    )
    def test_check_accepts_the_campaign_file(self, tmp_path: Path, kind: str) -> None:
        table(kind, 3).round(9).to_csv(tmp_path / "a record.csv", sep=";", decimal=",", index=False)
        found = smfe.look(tmp_path / "a record.csv", tmp_path / "out")
        assert found.kind.name == kind
        campaign = tmp_path / "out" / "a record.csv.look.toml"
        assert found.campaign == campaign.read_text(encoding="utf-8")
        refused = [row for row in check(campaign).itertuples() if row.cause == "unusable"]
        assert not refused, refused
        assert (tmp_path / "out" / "a record.csv.look.png").read_bytes().startswith(b"\x89PNG")

    def test_a_frequency_response_is_one_and_its_motion_is_read_off_its_phase(self, tmp_path: Path) -> None:
        f = np.arange(0.0, 800.0, 0.5)
        w = 2.0 * np.pi * f
        for motion, unit in ((0, "m/N"), (1, "m/s/N"), (2, "m/s^2/N")):
            h = (1j * w) ** motion * sum(1e-6 / (1 - (f / c) ** 2 + 0.04j * f / c) for c in (120.0, 310.0))
            path = tmp_path / f"frf{motion}.txt"
            np.savetxt(path, np.column_stack([f, h.real, h.imag]))
            found = start(path)
            assert found.kind.name == "FRF"
            assert found.channels[1].unit == unit
            assert not (check(tmp_path / f"{path.name}.look.toml")["level"] == "fault").any()

    def test_a_drive_stroke_a_loop_a_sound_and_our_own_layout(self, tmp_path: Path) -> None:
        t = np.arange(0.0, 4.0, 1e-3)
        x = 0.1 * np.sin(t)
        io.savemat(tmp_path / "axis.mat", {"t": t, "ENC_POS": x, "Torque": np.cos(t), "Kp": 3.0})
        pd.DataFrame({"time": t, "vel_cmd": 0.0 * t, "CMD_SPEED|1": np.sign(np.sin(50 * t)), "ENC_SPEED|1": x}).to_csv(
            tmp_path / "loop.csv", index=False
        )
        wavfile.write(tmp_path / "phone.wav", 8000, np.sin(np.arange(16000.0)).astype(np.float32))
        rng = np.random.default_rng(1)
        record = make_record(t, {"acceleration": {"x": rng.standard_normal(t.size)}})
        write_record_netcdf(record, tmp_path / "own.nc")
        kinds = {}
        for name in ("axis.mat", "loop.csv", "phone.wav", "own.nc"):
            kinds[name] = start(tmp_path / name).kind.name
            smfe.load_campaign(tmp_path / f"{name}.look.toml")
        assert kinds == {
            "axis.mat": "drive stroke",
            "loop.csv": "loop trace",
            "phone.wav": "vibration without a force",
            "own.nc": "vibration without a force",
        }

    def test_a_file_of_which_nothing_is_known_still_gives_a_start(self, tmp_path: Path) -> None:
        rng = np.random.default_rng(2)
        path = tmp_path / "x.csv"
        pd.DataFrame({"Kanal 7": rng.standard_normal(4000), "Kanal 9": rng.random(4000)}).to_csv(path, index=False)
        found = start(path)
        assert found.kind.name == "unknown"
        assert any("no clock" in note for note in found.notes)
        assert "CHANGE" in found.campaign
        channels = tomllib.loads(found.campaign)["channels"]
        assert channels["acceleration_x"]["column"] == "Kanal 7"
        assert channels["time"] == {"sample_rate": "1000 Hz"}
        check(tmp_path / "x.csv.look.toml")

    def test_blocks_of_a_trigger_one_after_another_are_hits(self, tmp_path: Path) -> None:
        block = np.round((np.arange(2000) - 100) / 25600, 6)
        pulse = 300 * np.exp(-0.5 * ((block - 2e-4) / 6e-5) ** 2)
        ringing = np.where(block > 0, np.exp(-90 * block) * np.sin(4500 * block), 0)
        columns = {"Time [s]": block, "Force [N]": pulse, "Acc [m/s^2]": 40 * ringing}
        path = tmp_path / "blocks.csv"
        pd.DataFrame({name: np.tile(values, 3) for name, values in columns.items()}).to_csv(path, index=False)
        found = start(path)
        assert found.kind.name == "impact test"
        assert found.sample_rate == 25600
        assert any("begins anew with each block" in note for note in found.notes)
        (only,) = smfe.load_campaign(tmp_path / "blocks.csv.look.toml").measurements[0].records
        record = smfe.read_record(path, only.channels)
        np.testing.assert_allclose(np.diff(record["time"]), 1 / 25600)
        np.testing.assert_allclose(record["force"].sel(axis="x"), np.tile(pulse, 3), atol=1e-9)

    def test_two_channels_of_a_wav_file_of_which_one_is_hits_are_a_hammer(self, tmp_path: Path) -> None:
        t = np.arange(16000) / 8000
        hit = np.where((t > 0.2) & (t < 0.2005), 0.5, 0.0)
        ringing = np.where(t > 0.2, 0.3 * np.exp(-30 * (t - 0.2)) * np.sin(3000 * (t - 0.2)), 0.0)
        wavfile.write(tmp_path / "tap.wav", 8000, np.column_stack([ringing, hit]).astype(np.float32))
        found = start(tmp_path / "tap.wav")
        assert found.kind.name == "impact test"
        assert {g.channel: g.column for g in found.channels} == {"force_x": 2, "acceleration_x": 1}
        assert "scale = N at full scale" in found.campaign
        smfe.load_campaign(tmp_path / "tap.wav.look.toml")

    def test_a_file_without_a_clock_keeps_the_channels_that_it_names(self, tmp_path: Path) -> None:
        path = tmp_path / "x.csv"
        rng = np.random.default_rng(2)
        pd.DataFrame({"Force [N]": rng.random(4000), "Acc [g]": rng.random(4000)}).to_csv(path, index=False)
        channels = tomllib.loads(start(path).campaign)["channels"]
        assert channels["force_x"] == {"column": "Force [N]", "unit": "N"}
        assert channels["acceleration_x"] == {"column": "Acc [g]", "unit": "g"}

    def test_the_command_keeps_a_campaign_file_that_is_there(self, tmp_path: Path) -> None:
        table("impact test", 1).to_csv(tmp_path / "r.csv", index=False)
        arguments = ["look", str(tmp_path / "r.csv"), "-o", str(tmp_path)]
        done = CliRunner().invoke(app, arguments)
        assert done.exit_code == 0
        assert "seems to be: impact test" in done.output
        (tmp_path / "r.csv.look.toml").write_text("mine")
        assert "kept as it was" in " ".join(CliRunner().invoke(app, arguments).output.split())
        assert (tmp_path / "r.csv.look.toml").read_text() == "mine"

    def test_what_cannot_be_read_is_said(self, tmp_path: Path) -> None:
        (tmp_path / "r.csv").write_text("no numbers here\nat all\n")
        with pytest.raises(InputError, match=r"r\.csv: no rows of numbers"):
            smfe.look(tmp_path / "r.csv")


def test_a_record_of_three_samples_divides_by_nothing(tmp_path: Path) -> None:
    (tmp_path / "short.csv").write_text("t [s],Fx [N]\n0,1\n0.001,2\n0.002,4\n")
    assert examine(tmp_path / "short.csv").size == 3
