"""Claims about what a file says of itself: its columns, their units, and what `smfe convert` leaves out."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from nptdms import ChannelObject, RootObject, TdmsWriter
from scipy import io
from scipy.io import wavfile
from typer.testing import CliRunner

from process.errors import InputError
from process.labels import make_record
from smfe import convert
from smfe.cli import app
from smfe.records import (
    Channel,
    column_names,
    read_blocks,
    read_records,
    record_columns,
    write_record_csv,
    write_record_netcdf,
    write_record_uff,
)
from smfe.records.contents import contents, plain_unit, without_unit

N = 200
T = np.arange(N) / 1000.0
FX, AX = np.sin(40.0 * T), np.cos(50.0 * T)


def _csv(path: Path) -> list[str]:
    rows = "".join(f"{t};{a};{b}\n".replace(".", ",") for t, a, b in zip(T, FX, AX, strict=True))
    path.write_text("Prüfstand 3;Halle B\nZeit;Fx;ax\ns;kN;g\n" + rows, encoding="latin-1")
    return ["Zeit", "Fx", "ax"]


def _tdms(path: Path) -> list[str]:
    with TdmsWriter(path) as writer:
        fx, ax = (ChannelObject("DAQ", n, v, {"unit_string": u}) for n, v, u in (("Fx", FX, "N"), ("ax", AX, "m/s^2")))
        writer.write_segment([RootObject(), fx, ax])
    return ["DAQ/Fx", "DAQ/ax"]


def _h5(path: Path) -> list[str]:
    with h5py.File(path, "w") as file:
        for name, values, unit in (("a/t", T, "s"), ("a/Fx", FX, "N")):
            file[name] = values
            file[name].attrs["units"] = unit
    return ["a/Fx", "a/t"]


def _mat(path: Path) -> list[str]:
    io.savemat(path, {"t": T, "F": np.column_stack([FX, AX]), "teeth": 4.0})
    return ["t", "F(:,1)", "F(:,2)", "teeth"]


def _wav(path: Path) -> list[int]:
    wavfile.write(path, 1000, np.column_stack([FX, AX]).astype(np.float32))
    return [1, 2]


def _uff(path: Path) -> list[str]:
    write_record_uff(make_record(T, {"force": {"x": FX}, "acceleration": {"x": AX}}), path)
    return ["time", "1:+X", "2:+X"]


class TestWhatAFileHolds:
    @pytest.mark.parametrize(
        ("suffix", "write"),
        [(".csv", _csv), (".tdms", _tdms), (".h5", _h5), (".mat", _mat), (".wav", _wav), (".uff", _uff)],
    )
    def test_columns_are_called_as_read_records_wants_them(
        self, tmp_path: Path, suffix: str, write: Callable[[Path], list[str | int]]
    ) -> None:
        path = tmp_path / f"r{suffix}"
        names = write(path)
        assert column_names(path) == names
        (found,) = contents(path)
        assert found.size == N
        assert set(found.columns) | set(found.unread) == set(names)
        for values in found.columns.values():
            assert np.all(np.isfinite(values))

    def test_units_come_from_wherever_the_format_has_them(self, tmp_path: Path) -> None:
        for suffix, write in ((".csv", _csv), (".tdms", _tdms), (".h5", _h5)):
            write(tmp_path / f"r{suffix}")
        assert contents(tmp_path / "r.csv")[0].units == {"Zeit": "s", "Fx": "kN", "ax": "g"}
        assert contents(tmp_path / "r.tdms")[0].units == {"DAQ/Fx": "N", "DAQ/ax": "m/s^2"}
        assert contents(tmp_path / "r.h5")[0].units == {"a/t": "s", "a/Fx": "N"}
        for header, unit in (("Fx [kN]", "kN"), ("t (s)", "s"), ("ax_[m/s²]", "m/s²"), ("n/rpm", "rpm")):
            assert without_unit(header)[1] == unit
        assert without_unit("a/Fx") == ("a/Fx", None), "a group of HDF5 is no unit"
        assert plain_unit("Newtons") == "N"
        assert plain_unit("furlong") is None

    def test_settings_beside_a_record_are_named_and_not_read(self, tmp_path: Path) -> None:
        _mat(tmp_path / "r.mat")
        (found,) = contents(tmp_path / "r.mat")
        assert found.unread == {"teeth": "it has 1 values where others have 200"}


class TestConversionLeavesNothingOutInSilence:
    def test_a_tacho_stays(self, tmp_path: Path) -> None:
        """Every channel of a record has a column in our files, and each is looked for."""
        tacho = np.arange(N) % 50 < 3
        record = make_record(
            T, {"force": {"x": FX}, "displacement": {"y": AX}}, {"tacho": tacho.astype(float), "spindle_angle": T}
        )
        write_record_csv(record, tmp_path / "r.csv", digits=17)
        (back,) = read_records(convert(tmp_path / "r.csv", tmp_path / "r.nc")[0], {})
        for name in record.data_vars:
            np.testing.assert_array_equal(back[name], record[name])

    def test_what_is_no_channel_is_named(self, tmp_path: Path) -> None:
        path = tmp_path / "r.csv"
        path.write_text("t,Fx,Ki,trigger\n" + "".join(f"{t},{t},5,0\n" for t in T))
        with pytest.warns(UserWarning, match=r"2 of 4 columns are left out .* 'Ki', 'trigger'; declare"):
            convert(path, tmp_path / "r.nc")
        done = CliRunner().invoke(app, ["convert", str(path), str(tmp_path / "s.csv")])
        assert done.exit_code == 0
        assert "'Ki', 'trigger'" in " ".join(done.output.split())

    def test_the_unit_that_a_file_states_counts(self, tmp_path: Path) -> None:
        path = tmp_path / "r.csv"
        path.write_text("t,Fx\nms,kN\n" + "".join(f"{1e3 * t},{t}\n" for t in T))
        (back,) = read_records(convert(path, tmp_path / "r.nc")[0], {})
        np.testing.assert_allclose(back["force"].sel(axis="x"), 1000.0 * T)
        np.testing.assert_allclose(back["time"], T)

    def test_channels_alone_are_a_campaign_for_it(self, tmp_path: Path) -> None:
        _csv(tmp_path / "r.csv")
        channels = '[channels]\ntime = { column = "Zeit", unit = "s" }\n'
        (tmp_path / "c.toml").write_text(channels + 'force_x = { column = "Fx", unit = "kN" }\n')
        with pytest.warns(UserWarning, match="1 of 3 columns"):
            (written,) = convert(tmp_path / "r.csv", tmp_path / "r.nc", tmp_path / "c.toml")
        (back,) = read_records(written, {})
        np.testing.assert_allclose(back["force"].sel(axis="x"), 1000.0 * FX, atol=1e-12)
        (tmp_path / "d.toml").write_text(channels + 'force_q = { column = "Fx", unit = "kN" }\n')
        with pytest.raises(InputError, match=r"d\.toml, line 3: channels.* 'force_q' is not known"):
            convert(tmp_path / "r.csv", tmp_path / "r.nc", tmp_path / "d.toml")
        (tmp_path / "e.toml").write_text('[campaign]\nname = "empty"\n')
        with pytest.raises(InputError, match=r"e\.toml: it declares no \[channels\]"):
            convert(tmp_path / "r.csv", tmp_path / "r.nc", tmp_path / "e.toml")

    def test_our_own_layout_needs_no_word(self, tmp_path: Path) -> None:
        record = make_record(T, {"force": {"x": FX}}, {"tacho": AX})
        write_record_netcdf(record, tmp_path / "r.nc")
        (back,) = read_records(convert(tmp_path / "r.nc", tmp_path / "r.csv")[0], record_columns(record))
        np.testing.assert_allclose(back["tacho"], AX)


def _labview(path: Path, every: int, timed: bool, stated: int = 2000) -> None:
    rate = 1000.0
    head = f"LabVIEW Measurement\t\nSeparator\tTab\nX_Columns\t{'One' if timed else 'No'}\n***End_of_Header***\t\n\t\n"
    head += f"Channels\t1\nSamples\t{stated}\nX0\t0\nDelta_X\t{1.0 / rate}\n***End_of_Header***\t\nX_Value\tFx\n"
    rows = [f"{k / rate if timed else ''}\t{k}.5\n" for k in range(0, 2000, every)]
    path.write_text(head + "".join(rows))


class TestThinnedLabviewExports:
    FORCE = {"force_x": Channel("Fx", "N")}  # noqa: RUF012

    def test_the_x_column_is_the_clock(self, tmp_path: Path) -> None:
        path = tmp_path / "r.lvm"
        _labview(path, every=10, timed=True)
        (record,) = read_records(path, self.FORCE)
        np.testing.assert_allclose(record["time"], np.arange(200) / 100.0)
        assert "200 of the 2000 samples that its header states" in record.attrs["notes"]
        assert next(read_blocks(path, self.FORCE, 50)).attrs["notes"] == record.attrs["notes"]

    def test_without_one_the_campaign_declares_it(self, tmp_path: Path) -> None:
        path = tmp_path / "r.lvm"
        _labview(path, every=10, timed=False)
        with pytest.raises(
            InputError, match=r'clock is then to be declared \(sample_rate = "100 Hz" if Delta_X is the recorder'
        ):
            read_records(path, self.FORCE)
        (record,) = read_records(path, self.FORCE | {"time": Channel(sample_rate=100.0)})
        assert record.sizes["time"] == 200
        assert "every 10. sample" in record.attrs["notes"]

    @pytest.mark.parametrize("timed", [True, False])
    def test_a_truncated_file_stays_refused(self, tmp_path: Path, timed: bool) -> None:
        path = tmp_path / "r.lvm"
        _labview(path, every=1, timed=timed, stated=2000)
        lines = path.read_text().splitlines(keepends=True)
        path.write_text("".join(lines[:-700]))
        with pytest.raises(InputError, match="1300 of the 2000 samples that its header states; the file is truncated"):
            read_records(path, self.FORCE | {"time": Channel(sample_rate=100.0)})
