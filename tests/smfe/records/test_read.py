"""Claims about readers and writers: every format gives the same record; every fault gives one clear sentence."""

import math
import tempfile
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from places import DATA
from samples.reading import fault_of_reading
from scipy import io

from process import units
from process.errors import InputError
from process.labels import make_record
from smfe.records import (
    CHANNELS,
    FORMATS,
    Channel,
    read_frf,
    read_record,
    read_records,
    record_columns,
    write_record_csv,
    write_record_mat,
    write_record_netcdf,
)
from smfe.records.align import align, shift
from smfe.records.blocks import streams
from smfe.records.formats import lvm as lvm_format

RATE = 2000.0


def a_record(n: int = 200, seed: int = 1, axes: str = "xyz") -> xr.Dataset:
    rng = np.random.default_rng(seed)
    vectors = {
        "force": {a: 100.0 * rng.standard_normal(n) for a in axes},
        "acceleration": {a: rng.standard_normal(n) for a in axes},
    }
    scalars = {"spindle_speed": np.linspace(300.0, 600.0, n), "spindle_angle": np.linspace(0.0, 40.0, n)}
    return make_record(np.arange(n) / RATE, vectors, scalars)


PLAIN = {"time": Channel("t", "s"), "force_x": Channel("Fx", "N"), "acceleration_x": Channel("ax", "m/s^2")}


def text(path: Path, content: str, encoding: str = "utf-8") -> Path:
    path.write_bytes(content.encode(encoding))
    return path


def one(path: Path, channels: dict[str, Channel] = PLAIN) -> xr.Dataset:
    return read_record(path, channels)


class TestRoundTrip:
    def test_csv(self, tmp_path: Path) -> None:
        record = a_record()
        path = write_record_csv(record, tmp_path / "r.csv", digits=17)
        back = one(path, record_columns(record))
        # pandas' fast parser may miss the last bit of a double
        xr.testing.assert_allclose(back, record, rtol=1e-15)
        assert back.attrs["source"] == "r.csv"
        assert path.read_text().splitlines()[0] == "t,Fx,Fy,Fz,ax,ay,az,n,angle"

    def test_csv_of_a_german_shop_floor(self, tmp_path: Path) -> None:
        record = a_record()
        path = write_record_csv(record, tmp_path / "r.csv", delimiter=";", decimal=",", digits=17)
        xr.testing.assert_allclose(one(path, record_columns(record)), record, rtol=1e-15)

    def test_mat_is_exact(self, tmp_path: Path) -> None:
        record = a_record()
        back = one(write_record_mat(record, tmp_path / "r.mat"), record_columns(record))
        xr.testing.assert_equal(back, record)

    def test_netcdf_is_exact_and_needs_no_channels(self, tmp_path: Path) -> None:
        record = a_record()
        back = one(write_record_netcdf(record, tmp_path / "r.nc"), {})
        xr.testing.assert_equal(back, record)
        assert back["force"].attrs["units"] == "N"

    def test_an_axis_that_none_is_called_is_said_with_the_file(self, tmp_path: Path) -> None:
        path = write_record_netcdf(a_record(), tmp_path / "r.nc")
        damaged = xr.load_dataset(path)
        axis = ["X", *damaged["axis"].values[1:]]
        damaged.assign_coords(axis=axis).to_netcdf(path)
        for read in (read_records, streams):
            with pytest.raises(InputError, match=r"^r\.nc: axis 'X' is none of x, y, z"):
                read(path, {})

    def test_a_line_break_in_the_name_of_a_column_does_not_end_the_sentence(self, tmp_path: Path) -> None:
        io.savemat(tmp_path / "r.mat", {"d": {"t": np.arange(9.0), "a\n": np.arange(9.0)}})
        with pytest.raises(InputError) as refused:
            read_record(tmp_path / "r.mat", {"time": Channel("d.t", "s"), "acceleration_x": Channel("d.ax", "m/s^2")})
        said = r"r.mat: no column 'd.ax' (did you mean 'd.a\n'?); the file has 'd.t', 'd.a\n'"
        assert str(refused.value).startswith(said)

    def test_a_partial_axis_stays_partial(self, tmp_path: Path) -> None:
        n = 50
        samples = np.sin(np.arange(n))
        record = make_record(
            np.arange(n) / RATE, {"force": {"x": samples}, "acceleration": {"x": samples, "z": samples}}
        )
        for path in (write_record_netcdf(record, tmp_path / "r.nc"), write_record_mat(record, tmp_path / "r.mat")):
            xr.testing.assert_equal(one(path, record_columns(record)), record)

    def test_nothing_half_written_is_left(self, tmp_path: Path) -> None:
        good = a_record()
        bad = good.drop_vars("time").assign_coords(time=np.zeros(good.sizes["time"]))
        for write, name in ((write_record_netcdf, "r.nc"), (write_record_csv, "r.csv"), (write_record_mat, "r.mat")):
            with pytest.raises(InputError):
                write(bad, tmp_path / name)
        assert not list(tmp_path.iterdir())


class TestCorrections:
    @settings(max_examples=30, deadline=None)
    @given(st.sampled_from(sorted(set(CHANNELS) - {"time", "frequency", "tacho"})), st.data())
    def test_a_unit_changes_the_numbers_in_the_file_and_not_the_quantity(self, name: str, data: st.DataObject) -> None:
        table = units.UNITS[CHANNELS[name]]
        first, second = (data.draw(st.sampled_from(sorted(table))) for _ in range(2))
        numbers = np.array([1.0, -2.5, 1e-3])
        a = Channel(1, first).to_si(name, numbers / table[first])
        b = Channel(1, second).to_si(name, numbers / table[second])
        np.testing.assert_allclose(a, b, rtol=1e-12)

    def test_a_spindle_speed_is_shown_in_rpm(self) -> None:
        speed = Channel(1, "rad/s").to_si("spindle_speed", np.array([2.0 * math.pi]))
        np.testing.assert_allclose(speed, [60.0], rtol=1e-14)

    def test_sign_and_scale(self, tmp_path: Path) -> None:
        record = a_record(axes="x")
        path = write_record_mat(record, tmp_path / "r.mat")
        channels = record_columns(record) | {"force_x": Channel("Fx", "kN", sign=-1.0, scale=0.5)}
        np.testing.assert_allclose(one(path, channels)["force"], -500.0 * record["force"], rtol=1e-15)

    def test_corrections_apply_to_our_own_layout_too(self, tmp_path: Path) -> None:
        record = a_record()
        path = write_record_netcdf(record, tmp_path / "r.nc")
        back = one(path, {"force_y": Channel("of another file", "kN", sign=-1.0)})
        np.testing.assert_array_equal(back["force"].sel(axis="y"), -record["force"].sel(axis="y"))
        np.testing.assert_array_equal(back["force"].sel(axis="z"), record["force"].sel(axis="z"))

    @given(st.permutations("xyz"))
    @settings(max_examples=6, deadline=None)
    def test_relabelling_axes_relabels_the_record(self, order: list[str]) -> None:
        record = a_record(n=20)
        with tempfile.TemporaryDirectory() as folder:
            path = write_record_mat(record, Path(folder) / "r.mat")
            channels = {"time": Channel("t", "s")}
            channels |= {f"force_{new}": Channel(f"F{old}", "N") for old, new in zip("xyz", order, strict=True)}
            back = one(path, channels)
        for old, new in zip("xyz", order, strict=True):
            np.testing.assert_array_equal(back["force"].sel(axis=new), record["force"].sel(axis=old))

    def test_a_wrapped_spindle_angle_is_unwrapped(self, tmp_path: Path) -> None:
        n = 400
        angle = 0.3 * np.arange(n)
        io.savemat(tmp_path / "r.mat", {"t": np.arange(n) / RATE, "a": np.degrees(np.mod(angle, 2.0 * np.pi))})
        channels = {"time": Channel("t", "s"), "spindle_angle": Channel("a", "deg")}
        np.testing.assert_allclose(one(tmp_path / "r.mat", channels)["spindle_angle"], angle, atol=1e-9)

    def test_pulses_per_revolution_stay_with_the_tacho(self, tmp_path: Path) -> None:
        io.savemat(tmp_path / "r.mat", {"t": np.arange(4) / RATE, "p": [0.0, 5.0, 0.0, 5.0]})
        channels = {"time": Channel("t", "s"), "tacho": Channel("p", pulses_per_revolution=2.0)}
        assert one(tmp_path / "r.mat", channels)["tacho"].attrs["pulses_per_revolution"] == 2.0


class TestDelay:
    @pytest.mark.parametrize("share", [0.05, 0.3, 0.6, 0.8])
    @pytest.mark.parametrize("by", [0.5, 2.25, -1.7])
    def test_exact_below_eight_tenths_of_nyquist(self, share: float, by: float) -> None:
        n = np.arange(400)
        w = np.pi * share
        shifted = shift(np.sin(w * n + 0.3), by, 3, 397)
        inner = slice(40, -40)
        assert np.abs(shifted - np.sin(w * (n[3:397] + by) + 0.3))[inner].max() < 1e-4

    def test_linear_interpolation_would_not_do(self) -> None:
        n = np.arange(400)
        wave = np.sin(0.2 * np.pi * n)
        linear = 0.5 * (wave[:-1] + wave[1:])
        assert np.abs(linear - np.sin(0.2 * np.pi * (n[:-1] + 0.5))).max() > 0.04

    def test_whole_samples_constants_and_ramps(self) -> None:
        x = np.random.default_rng(0).standard_normal(100)
        np.testing.assert_array_equal(shift(x, 3.0, 0, 97), x[3:])
        np.testing.assert_allclose(shift(np.full(100, 7.0), 0.4, 0, 99), 7.0, rtol=1e-14)
        np.testing.assert_allclose(shift(np.arange(100.0), 0.4, 0, 99), np.arange(99) + 0.4, atol=2e-4)

    def test_a_late_channel_is_put_back_and_nothing_is_invented(self, tmp_path: Path) -> None:
        t = np.arange(1000) / RATE
        delay = 1.3e-3  # 2.6 samples
        wave = {"t": t, "Fx": np.sin(2 * np.pi * 50.0 * t), "ax": np.sin(2 * np.pi * 50.0 * (t - delay))}
        io.savemat(tmp_path / "r.mat", wave)
        late = one(tmp_path / "r.mat", PLAIN | {"acceleration_x": Channel("ax", "m/s^2", delay=delay)})
        assert late.sizes["time"] == 997
        inner = late.isel(time=slice(40, -40), axis=0)
        np.testing.assert_allclose(inner["acceleration"], inner["force"], atol=1e-5)

    def test_early_and_late_channels_keep_what_they_share(self) -> None:
        record = a_record(n=100)
        both = align(record, {"force_x": 2.0 / RATE, "spindle_speed": -3.0 / RATE})
        np.testing.assert_array_equal(both["time"], record["time"][3:98])
        np.testing.assert_array_equal(both["force"].sel(axis="x"), record["force"].sel(axis="x")[5:100])
        np.testing.assert_array_equal(both["force"].sel(axis="y"), record["force"].sel(axis="y")[3:98])
        np.testing.assert_array_equal(both["spindle_speed"], record["spindle_speed"][0:95])

    def test_a_delay_as_long_as_the_record_is_an_error(self) -> None:
        with pytest.raises(InputError, match=r"delay of force_x, 50 s, is as long as the record"):
            align(a_record(n=100), {"force_x": 50.0})


NUMBERS = "0{d}0{s}1{d}5{s}-2e-1\n0{d}1{s}2{d}5{s}3\n0{d}2{s}3{d}5{s}4{d}25\n"


class TestText:
    @pytest.mark.parametrize(
        ("delimiter", "decimal"),
        [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), (" ", "."), ("  ", ",")],
    )
    @pytest.mark.parametrize("header", ["", "t{s}Fx{s}ax\n", "Rig 3, 4 May\n\nt{s}Fx{s}ax\ns{s}N{s}m/s2\n"])
    def test_delimiters_decimals_and_headers(self, tmp_path: Path, delimiter: str, decimal: str, header: str) -> None:
        path = text(tmp_path / "r.txt", (header + NUMBERS).format(d=decimal, s=delimiter))
        channels = PLAIN
        if not header:
            channels = {"time": Channel(1, "s"), "force_x": Channel(2, "N"), "acceleration_x": Channel(3, "m/s^2")}
        record = one(path, channels)
        np.testing.assert_allclose(record["time"], [0.0, 0.1, 0.2])
        np.testing.assert_allclose(record["force"][0], [1.5, 2.5, 3.5])
        np.testing.assert_allclose(record["acceleration"][0], [-0.2, 3.0, 4.25])

    def test_two_columns_of_whole_numbers_with_commas(self, tmp_path: Path) -> None:
        path = text(tmp_path / "r.csv", "1,2\n2,3\n3,5\n")
        np.testing.assert_array_equal(
            one(path, {"time": Channel(1, "s"), "force_z": Channel(2, "N")})["force"][0], [2, 3, 5]
        )

    @pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
    @pytest.mark.parametrize("end", ["\n", "\r\n"])
    def test_encodings_and_line_ends(self, tmp_path: Path, encoding: str, end: str) -> None:
        content = f"t;Kraft für x;ax{end}" + NUMBERS.format(d=",", s=";").replace("\n", end)
        channels = PLAIN | {"force_x": Channel("Kraft für x", "N")}
        record = one(text(tmp_path / "r.csv", content, encoding), channels)
        np.testing.assert_allclose(record["force"][0], [1.5, 2.5, 3.5])

    def test_delimiters_at_line_ends_and_text_in_other_columns(self, tmp_path: Path) -> None:
        path = text(
            tmp_path / "r.csv", "t,Fx,ax,note,\n" + "".join(f"{k},{k},{k},,\n" for k in range(9)) + "9,9,9,bang,\n"
        )
        assert one(path).sizes["time"] == 10

    def test_a_column_of_clock_times(self, tmp_path: Path) -> None:
        rows = "".join(f"10:00:0{k};{k},5;{k},25\n" for k in range(5))
        channels = {"time": Channel(sample_rate=RATE), "force_x": Channel("Fx", "N"), "acceleration_x": Channel(3, "g")}
        record = one(text(tmp_path / "r.csv", "clock;Fx;ax\n" + rows), channels)
        np.testing.assert_allclose(record["force"][0], np.arange(5) + 0.5)

    def test_column_names_that_are_numbers(self, tmp_path: Path) -> None:
        channels = {"time": Channel("t", "s"), "force_x": Channel("1", "N")}
        record = one(text(tmp_path / "r.csv", "t,1,2\n0,7,9\n1,8,9\n"), channels)
        np.testing.assert_array_equal(record["force"][0], [7.0, 8.0])

    def test_a_commented_header(self, tmp_path: Path) -> None:
        assert one(text(tmp_path / "r.dat", "# t Fx ax\n0 1 2\n1 2 3\n"))["force"][0, 1] == 2.0

    def test_one_column_and_a_sample_rate(self, tmp_path: Path) -> None:
        record = one(
            text(tmp_path / "r.csv", "Fx\n1.5\n2.5\n3.5\n"),
            {"time": Channel(sample_rate=RATE), "force_x": Channel("Fx", "N")},
        )
        np.testing.assert_allclose(record["time"], np.arange(3) / RATE)

    def test_a_long_file_is_read_fast(self, tmp_path: Path) -> None:
        rows = np.column_stack([np.arange(200_000) / RATE, np.ones((200_000, 2))])
        path = tmp_path / "r.csv"
        np.savetxt(path, rows, delimiter=",", header="t,Fx,ax", comments="", fmt="%.8g")
        start = time.perf_counter()
        one(path)
        assert time.perf_counter() - start < 2.0  # the C engine: 0.05 s; a Python loop: many seconds

    @pytest.mark.parametrize(
        ("content", "message"),
        [
            ("", "r.csv: the file is empty"),
            ("  \n\n", "r.csv: the file is empty"),
            ("hello\nworld\n", "r.csv: no rows of numbers"),
            ("t,Fx,ay\n0,1,2\n1,2,3\n", "r.csv: no column 'ax'; the file has 't', 'Fx', 'ay'"),
            ("t,FX,ax\n0,1,2\n1,2,3\n", r"r.csv: no column 'Fx' \(did you mean 'FX'\?\)"),
            ("0,1,2\n1,2,3\n", "r.csv: column 't' is asked for but no line .* names its 3 columns; give positions"),
            ("t,Fx,Fx,ax\n0,1,2,3\n1,2,3,4\n", "name 'Fx' is that of columns 2 and 3; give the position"),
            ("t,Fx,ax\n0,1,2\n1,2,3\n2,oops,4\n3,4,5\n", "column 2 holds the text 'oops' in data row 3"),
            (
                "t,Fx,ax\n0,1,2\n1,,3\n2,3,4\n",
                r"channel force_x \(column 'Fx'\) is empty, NaN .* in 1 samples, .* sample 1 ",
            ),
            (
                "t,Fx,ax\n0,1,2\n1,-1e300,3\n2,3,4\n",
                "force_x .* is -1e.300 at sample 1 .*, more than any sensor",
            ),
            ("t,Fx,ax\n0,1,2\n1,nan,3\n2,3,4\n", "channel force_x .* first at sample 1 "),
            ("t,Fx,ax\n0,1,2\n1,2,3\n2,3\n", r"the last row \(3\) is incomplete; the file is truncated"),
            ("t,Fx,ax\n0,1,2\n1,2,3,4\n2,3,4\n", "Expected 3 fields in line 3, saw 4"),
            ("t,Fx,ax\n0,1,2\n", "r.csv: the record has 1 samples; at least 2 are needed"),
            ("t,Fx,ax\n0,1,2\n1,2,3\n0,3,4\n", "r.csv: time does not rise at sample 2"),
            ("t,Fx,ax\n0,1,2\n1,2,3\n9,3,4\n", "r.csv: time is not uniform"),
        ],
    )
    def test_faults(self, tmp_path: Path, content: str, message: str) -> None:
        with pytest.raises(InputError, match=message):
            read_records(text(tmp_path / "r.csv", content), PLAIN)

    def test_a_binary_file_is_no_text(self, tmp_path: Path) -> None:
        (tmp_path / "r.csv").write_bytes(b"\x00\x01" * 100)
        with pytest.raises(InputError, match=r"r\.csv: the file holds no text"):
            read_records(tmp_path / "r.csv", PLAIN)


class TestMatlab:
    def test_columns_of_a_matrix(self, tmp_path: Path) -> None:
        data = np.column_stack([np.arange(5) / RATE, np.ones(5), np.arange(5)])
        io.savemat(tmp_path / "r.mat", {"data": data, "comment": "text"})
        channels = {"time": Channel("data(:,1)", "s"), "force_x": Channel("data(:,3)", "N")}
        np.testing.assert_array_equal(one(tmp_path / "r.mat", channels)["force"][0], np.arange(5))

    def test_version_7_3_is_read_the_same(self, tmp_path: Path) -> None:
        path = tmp_path / "r.mat"
        record = a_record(n=30, axes="x")
        values = {"t": record["time"].values, "Fx": record["force"].values[0], "ax": record["acceleration"].values[0]}
        with h5py.File(path, "w", userblock_size=512) as file:
            for name, samples in values.items():
                file[name] = samples[None, :]  # MATLAB's column vector, as HDF5 sees it
            file["label"] = "text"
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file")
        xr.testing.assert_equal(one(path), record[["force", "acceleration"]])

    def test_columns_of_different_length(self, tmp_path: Path) -> None:
        io.savemat(tmp_path / "r.mat", {"t": np.arange(5.0), "Fx": np.ones(4), "ax": np.ones(5)})
        with pytest.raises(InputError, match=r"r.mat: columns of different length \('t' 5, 'Fx' 4, 'ax' 5 samples\)"):
            read_records(tmp_path / "r.mat", PLAIN)

    def test_a_missing_variable_lists_those_there_are(self, tmp_path: Path) -> None:
        io.savemat(tmp_path / "r.mat", {"t": np.arange(5.0), "FX": np.ones(5), "ax": np.ones(5), "s": {"f": 1.0}})
        with pytest.raises(
            InputError, match=r"no column 'Fx' \(did you mean 'FX'\?\); the file has 't', 'FX', 'ax', 's\.f'$"
        ):
            read_records(tmp_path / "r.mat", PLAIN)


class TestHdf5:
    def test_data_sets_in_groups(self, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "r.h5", "w") as file:
            file["daq/t"] = np.arange(6) / RATE
            file["daq/Fx"] = np.arange(6.0)
        channels = {"time": Channel("daq/t", "s"), "force_x": Channel("daq/Fx", "N")}
        np.testing.assert_array_equal(one(tmp_path / "r.h5", channels)["force"][0], np.arange(6))

    def test_our_layout_in_other_units_is_refused(self, tmp_path: Path) -> None:
        record = a_record()
        record["force"].attrs["units"] = "kN"
        record.to_netcdf(tmp_path / "r.nc", engine="h5netcdf")
        with pytest.raises(InputError, match=r"r\.nc: force has units 'kN'; a record in our own layout has 'N'"):
            read_records(tmp_path / "r.nc", {})

    def test_netcdf_3_says_how_to_convert(self, tmp_path: Path) -> None:
        (tmp_path / "r.nc").write_bytes(b"CDF\x01" + bytes(100))
        with pytest.raises(InputError, match=r"r\.nc: a NetCDF-3 file; convert it with: nccopy -k nc4"):
            read_records(tmp_path / "r.nc", PLAIN)

    def test_text_in_a_data_set(self, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "r.h5", "w") as file:
            file["t"], file["Fx"] = np.arange(2.0), [b"a", b"b"]
        with pytest.raises(InputError, match=r"r\.h5: 'Fx' holds no real numbers"):
            read_records(tmp_path / "r.h5", {"time": Channel("t", "s"), "force_x": Channel("Fx", "N")})


def lvm_text(segments: int = 2, rows: int = 4, x_columns: str = "No", start: str = "0", comment: bool = True) -> str:
    head = "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\nMulti_Headings\tYes\n"
    out = head + f"X_Columns\t{x_columns}\n***End_of_Header***\t\n"
    for k in range(segments):
        out += f"\t\nChannels\t2\t\t\nSamples\t{rows}\t{rows}\t\nX0\t0\t{start}\t\nDelta_X\t0.0005\t0.0005\t\n"
        out += "***End_of_Header***\t\t\t\nX_Value\tForce\tAcc" + ("\tComment" if comment else "") + "\n"
        for i in range(rows):
            out += f"{i * 0.0005 if x_columns == 'One' else ''}\t{k + i}\t{-i}\n"
    return out


LVM = {"force_x": Channel("Force", "N"), "acceleration_x": Channel(2, "m/s^2")}


class TestLabview:
    def test_each_segment_is_a_record_with_the_clock_of_the_file(self, tmp_path: Path) -> None:
        records = read_records(text(tmp_path / "r.lvm", lvm_text()), LVM)
        assert [r.attrs["source"] for r in records] == ["r.lvm, segment 0", "r.lvm, segment 1"]
        with pytest.raises(InputError, match=r"r\.lvm: it holds 2 segments; read them with read_records"):
            read_record(tmp_path / "r.lvm", LVM)
        np.testing.assert_allclose(records[1]["force"][0], [1, 2, 3, 4])
        np.testing.assert_allclose(records[1]["time"], np.arange(4) / RATE)

    @pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
    def test_segments_are_gone_to_whatever_ends_their_lines(self, tmp_path: Path, end: str) -> None:
        (tmp_path / "r.lvm").write_bytes(lvm_text(segments=5).replace("\n", end).encode())
        records = read_records(tmp_path / "r.lvm", LVM)
        assert [r["force"].values[0].tolist() for r in records] == [[k, k + 1, k + 2, k + 3] for k in range(5)]

    def test_of_many_segments_no_line_is_read_once_for_each(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """400 segments of 4 rows: where each was read up to from the start of the file, 880,000 lines were."""
        read = 0

        class Counted(lvm_format.TextIOWrapper):
            def __next__(self) -> str:
                nonlocal read
                read += 1
                return super().__next__()

        monkeypatch.setattr(lvm_format, "TextIOWrapper", Counted)
        path = text(tmp_path / "r.lvm", lvm_text(segments=400))
        assert len(lvm_format.read_tables(path, ["Force"])) == 400
        assert 0 < read < 400 * 20

    def test_a_time_column(self, tmp_path: Path) -> None:
        path = text(tmp_path / "r.lvm", lvm_text(segments=1, x_columns="One"))
        channels = LVM | {"time": Channel("X_Value", "s"), "acceleration_x": Channel("Acc", "m/s^2")}
        np.testing.assert_allclose(one(path, channels)["acceleration"][0], [0, -1, -2, -3])

    def test_no_pickle_is_read_or_left(self, tmp_path: Path) -> None:
        path = text(tmp_path / "r.lvm", lvm_text())
        (tmp_path / "r.lvm.pkl").write_bytes(b"not a pickle")
        read_records(path, LVM)
        assert sorted(p.name for p in tmp_path.iterdir()) == ["r.lvm", "r.lvm.pkl"]

    def test_channels_that_start_at_different_times_have_no_common_clock(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"r\.lvm, segment 0: no time; declare time = .* sample_rate"):
            read_records(text(tmp_path / "r.lvm", lvm_text(start="0.1")), LVM)

    def test_a_truncated_segment(self, tmp_path: Path) -> None:
        path = text(tmp_path / "r.lvm", "\n".join(lvm_text().splitlines()[:-2]) + "\n")
        with pytest.raises(InputError, match=r"r\.lvm, segment 1: 2 of the 4 samples .* the file is truncated"):
            read_records(path, LVM)

    def test_another_kind_of_file(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"r\.lvm: not a LabVIEW measurement file"):
            read_records(text(tmp_path / "r.lvm", "t,Fx\n1,2\n"), LVM)


class TestRequests:
    def test_a_missing_file(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"none\.csv: no such file"):
            read_records(tmp_path / "none.csv", PLAIN)

    def test_a_suffix_that_is_not_read(self, tmp_path: Path) -> None:
        with pytest.raises(
            InputError, match=r"r\.xlsx: files with suffix '\.xlsx' are not read; known are \.csv, \.txt"
        ):
            read_records(text(tmp_path / "r.xlsx", "x"), PLAIN)

    @pytest.mark.parametrize(
        ("channels", "message"),
        [
            ({}, "no channels are declared"),
            ({"force_x": Channel("Fx", "N")}, "r.csv: no time; declare time"),
            (PLAIN | {"force_x": Channel("Fx", "mm")}, "r.csv: unit 'mm' is not a unit of force; use one of: 'N'"),
            (PLAIN | {"force_x": Channel("Fx")}, 'r.csv: force_x has no unit; add unit = "N"'),
            (PLAIN | {"force_x": Channel(unit="N")}, "r.csv: channel force_x has no column"),
            (PLAIN | {"force_x": Channel(4, "N")}, "r.csv: column 4 is asked for but the file has 3"),
            (PLAIN | {"forse_x": Channel("Fx", "N")}, r"channel 'forse_x' is not known \(did you mean 'force_x'\?\)"),
        ],
    )
    def test_channels_that_do_not_fit(self, tmp_path: Path, channels: dict[str, Channel], message: str) -> None:
        with pytest.raises(InputError, match=message):
            read_records(text(tmp_path / "r.csv", "t,Fx,ax\n0,1,2\n1,2,3\n"), channels)


class TestDamage:
    """A damaged file gives a record or one clear sentence; never an exception of a library."""

    @pytest.fixture
    def files(self, tmp_path: Path) -> list[Path]:
        record = a_record(n=64, axes="x")
        hdf5 = tmp_path / "r.h5"
        with h5py.File(hdf5, "w") as file:
            file["t"], file["Fx"], file["ax"] = record["time"], record["force"][0], record["acceleration"][0]
        return [
            write_record_csv(record, tmp_path / "r.csv"),
            write_record_netcdf(record, tmp_path / "r.nc"),
            write_record_mat(record, tmp_path / "r.mat"),
            text(tmp_path / "r.lvm", lvm_text(rows=20)),
            hdf5,
        ]

    @staticmethod
    def channels_of(path: Path) -> dict[str, Channel]:
        return LVM if path.suffix == ".lvm" else PLAIN

    def test_empty(self, files: list[Path]) -> None:
        for path in files:
            path.write_bytes(b"")
            with pytest.raises(InputError, match=f"{path.name}: the file is empty"):
                read_records(path, PLAIN)

    def test_truncated(self, files: list[Path]) -> None:
        for path in files:
            whole = path.read_bytes()
            for size in np.linspace(1, len(whole) - 1, 40, dtype=int):
                path.write_bytes(whole[:size])
                # Text that ends with a whole row is a shorter record; a binary file states its size.
                if path.suffix in (".csv", ".lvm"):
                    assert fault_of_reading(path, self.channels_of(path)) == ""
                else:
                    with pytest.raises(InputError, match=path.name):
                        read_records(path, self.channels_of(path))

    @pytest.mark.parametrize("times", [12, pytest.param(60, marks=pytest.mark.slow)])
    def test_flipped_bits(self, files: list[Path], times: int) -> None:
        rng = np.random.default_rng(20)
        for path in files:
            whole = np.frombuffer(path.read_bytes(), dtype=np.uint8)
            for _ in range(times):
                broken = whole.copy()
                at = rng.integers(0, whole.size, rng.integers(1, 6))
                broken[at] ^= (1 << rng.integers(0, 8, at.size)).astype(np.uint8)
                path.write_bytes(broken.tobytes())
                assert fault_of_reading(path, self.channels_of(path)) == ""

    def test_another_format_under_the_suffix(self, files: list[Path], tmp_path: Path) -> None:
        for source in files:
            for suffix in FORMATS:
                path = tmp_path / f"other{suffix}"
                path.write_bytes(source.read_bytes())
                assert fault_of_reading(path, self.channels_of(path)) == ""

    @settings(max_examples=100, deadline=None)
    @given(st.binary(max_size=300), st.sampled_from(sorted(FORMATS)))
    def test_any_bytes(self, tmp_path_factory: pytest.TempPathFactory, content: bytes, suffix: str) -> None:
        path = tmp_path_factory.getbasetemp() / f"any{suffix}"
        path.write_bytes(content)
        assert fault_of_reading(path, self.channels_of(path)) == ""

    @settings(max_examples=100, deadline=None)
    @given(st.text(alphabet='0123456789.,;-+eE\t \n\r"#tFx', max_size=120))
    def test_any_text_of_numbers(self, tmp_path_factory: pytest.TempPathFactory, content: str) -> None:
        path = tmp_path_factory.getbasetemp() / "any.csv"
        path.write_text(content)
        assert fault_of_reading(path, self.channels_of(path)) == ""


FRF = {
    "frequency": Channel("f", "kHz"),
    "compliance_real": Channel("re", "um/N"),
    "compliance_imag": Channel("im", "um/N", sign=-1.0),
}


class TestFrf:
    def test_units_and_signs(self, tmp_path: Path) -> None:
        path = text(tmp_path / "h.csv", "f,re,im\n0.1,1,2\n0.2,3,4\n")
        frf = read_frf(path, FRF | PLAIN, "x", "y")
        np.testing.assert_allclose(frf["compliance"].sel(response="x", excitation="y"), [1e-6 - 2e-6j, 3e-6 - 4e-6j])
        np.testing.assert_allclose(frf["frequency"], [100.0, 200.0])

    def test_faults(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"h\.csv: channel frequency is not declared; a compliance needs"):
            read_frf(text(tmp_path / "h.csv", "f,re,im\n0.1,1,2\n0.2,3,4\n"), PLAIN, "x", "y")
        with pytest.raises(InputError, match=r"h\.csv: the frequencies of a compliance must be non-negative and rise"):
            read_frf(text(tmp_path / "h.csv", "f,re,im\n0.1,1,2\n0.1,3,4\n"), FRF, "x", "y")


def public(name: str) -> Path:
    root = DATA
    if not (root / name).is_file():
        pytest.skip(f"public data not here: {name} (set SMFE_DATA)")
    return root / name


class TestPublicData:
    @pytest.mark.slow
    def test_hammer_hits_in_labview_segments(self) -> None:
        channels = {"force_x": Channel(1, "N"), "acceleration_x": Channel(2, "m/s^2")}
        records = read_records(public("pyfrf_hammer/impact2_response0.lvm"), channels)
        assert [r.sizes["time"] for r in records] == [51200] * 5
        peaks = [int(abs(r["force"]).max() >= 1999.0) for r in records]
        assert peaks == [1, 0, 0, 0, 0], "segment 0 is overloaded"
        for record in records:
            np.testing.assert_allclose(np.diff(record["time"]), 1.0 / 51200.0, rtol=1e-6)

    def test_tool_point_hit_and_averaged_frf_agree(self) -> None:
        channels = {"time": Channel(1, "s"), "force_x": Channel(2, "N"), "acceleration_x": Channel(3, "m/s^2")}
        record = one(public("toolpoint_hammer_ubc/Point1_hammer_time.txt"), channels)
        columns = {
            "frequency": Channel(1, "Hz"),
            "compliance_real": Channel(2, "m/N"),
            "compliance_imag": Channel(3, "m/N"),
        }
        frf = read_frf(public("toolpoint_hammer_ubc/FRF_H11.txt"), columns, "x", "x")
        averaged = frf["compliance"].sel(frequency=1074.0).item()
        # the author's peak of the imaginary part, in the data set's README
        assert averaged.imag == pytest.approx(-0.6433e-6, rel=1e-3)
        accelerance = np.fft.rfft(record["acceleration"][0]) / np.fft.rfft(record["force"][0])
        single = accelerance[1074] / -((2.0 * np.pi * 1074.0) ** 2)
        assert abs(single - averaged) < 0.05 * abs(averaged)

    def test_dynoware_header(self) -> None:
        path = public("milling_forces_ubc/6-n6000f300ap3ae25.csv")
        record = one(path, {"time": Channel("Time", "s"), "force_y": Channel("Fy", "N")})
        assert record.sizes["time"] == 10001
        assert float(record["force"][0, 0]) == -209.473

    def test_emps_variables(self) -> None:
        channels = {"time": Channel("t", "s"), "encoder_position_x": Channel("qm", "m")}
        assert one(public("emps/DATA_EMPS.mat"), channels).sizes["time"] == 24841
