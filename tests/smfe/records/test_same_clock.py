"""Claims about files of one measurement that share a clock but no channel, and about times that are printed rounded."""

from pathlib import Path

import numpy as np
import pytest

from process.errors import InputError
from process.labels import make_record
from smfe.campaign import load_campaign
from smfe.identification.measurement import records_of
from smfe.records import Channel, put_on_time, read_blocks, read_records

CHANNELS = {"time": Channel("t", "s"), "force_x": Channel("Fx", "N")}


def signal(t: np.ndarray) -> np.ndarray:
    return np.sin(90.0 * t) + 0.3 * np.cos(211.0 * t)


class TestSharedClock:
    def test_channels_come_together_at_their_times(self) -> None:
        """Other rate, later begin: what is there at t is what the other file shows at t + offset."""
        t, u = np.arange(0.0, 2.0, 1e-3), 0.3 + np.arange(0.0, 3.0, 0.4e-3)
        a = make_record(t, {"force": {"x": signal(t)}})
        for offset in (0.0, 0.25, -0.1):
            b = make_record(u, {"acceleration": {"x": signal(u - offset)}}, {"tacho": np.ones(u.size)})
            both = put_on_time(a, b, offset)
            assert float(both["time"][0]) == pytest.approx(max(0.0, 0.3 - offset), abs=1e-3)
            inner = slice(100, -100)
            np.testing.assert_allclose(both["acceleration"][0][inner], both["force"][0][inner], atol=1e-3)

    def test_equal_clocks_change_no_sample(self) -> None:
        t = np.arange(500) * 1e-3
        a, b = make_record(t, {"force": {"x": signal(t)}}), make_record(t, {"acceleration": {"y": signal(t)}})
        np.testing.assert_allclose(put_on_time(a, b)["acceleration"].sel(axis="y"), signal(t), atol=1e-12)

    def test_no_common_time_is_said(self) -> None:
        t = np.arange(100) * 1e-3
        a, b = make_record(t, {"force": {"x": t}}), make_record(t + 50.0, {"acceleration": {"x": t}})
        with pytest.raises(InputError, match=r"they share no time; give the offset of its clock, offset = "):
            put_on_time(a, b)
        with pytest.raises(InputError, match="force_x is in both"):
            put_on_time(a, make_record(t, {"force": {"x": t}}))

    def test_a_campaign_says_it_with_or_without_an_offset(self, tmp_path: Path) -> None:
        t = np.arange(400) * 1e-3
        np.savetxt(tmp_path / "f.csv", np.column_stack([t, signal(t)]), "%.9g", ",", header="t,Fx", comments="")
        for name, late in (("a", 0.0), ("b", 1.5)):
            np.savetxt(tmp_path / f"{name}.csv", np.column_stack([t + late, signal(t)]), "%.9g", ",")
        withs = ""
        for file, offset, channel in (("a", "", "acceleration_x"), ("b", 'offset = "1.5 s"', "acceleration_y")):
            withs += (
                f'[[measurement.records.with]]\nfile = "{file}.csv"\n{offset}\n[measurement.records.with.channels]\n'
            )
            withs += f'time = {{ column = 1, unit = "s" }}\n{channel} = {{ column = 2, unit = "g" }}\n'
        head = '[campaign]\nname = "two files"\n[channels]\ntime = { column = "t", unit = "s" }\n'
        head += 'force_x = { column = "Fx", unit = "N" }\n[[measurement]]\nname = "m"\nmethod = "hammer"\n'
        head += '[[measurement.records]]\nfile = "f.csv"\nexcitation = "x"\n'
        (tmp_path / "c.toml").write_text(head + withs)
        (record,) = records_of(load_campaign(tmp_path / "c.toml").measurements[0].records[0])
        for axis in "xy":
            np.testing.assert_allclose(record["acceleration"].sel(axis=axis), 9.80665 * signal(t), atol=1e-6)


class TestRoundedTimes:
    @pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.slow) for k in range(2, 8))])
    def test_an_even_clock_takes_their_place(self, tmp_path: Path, seed: int) -> None:
        """Rates of 2 to 51 kHz with times of three or four decimals, rounded or cut off, read whole and in blocks."""
        rng = np.random.default_rng(seed)
        rate, digits = float(rng.choice([2048.0, 10_000.0, 25_600.0, 51_200.0])), int(rng.choice([3, 4]))
        digits = 3 if rate < 20_000.0 else digits
        size = int(rng.integers(3000, 9000))
        t = rng.uniform(0.0, 100.0) + np.arange(size) / rate
        printed = np.round(t, digits) if rng.random() < 0.5 else np.floor(t * 10**digits) / 10**digits
        rows = "".join(f"{a:.{digits}f},{b}\n" for a, b in zip(printed, range(size), strict=True))
        (tmp_path / "r.csv").write_text("t,Fx\n" + rows)
        (record,) = read_records(tmp_path / "r.csv", CHANNELS)
        np.testing.assert_allclose(np.diff(record["time"]), 1.0 / rate, rtol=2e-3)
        assert np.max(np.abs(record["time"].values - t)) < 1.01 * 10.0**-digits
        assert "are printed in steps of" in record.attrs["notes"]
        pieces = list(read_blocks(tmp_path / "r.csv", CHANNELS, 1000))
        np.testing.assert_array_equal(np.concatenate([p["time"] for p in pieces]), record["time"])

    def test_lost_samples_are_not_smoothed_over(self, tmp_path: Path) -> None:
        t = np.delete(np.arange(5000) / 10_000.0, slice(2000, 2200))
        (tmp_path / "r.csv").write_text("t,Fx\n" + "".join(f"{a:.3f},1\n" for a in t))
        with pytest.raises(InputError, match="time does not rise"):
            read_records(tmp_path / "r.csv", CHANNELS)
