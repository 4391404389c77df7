"""Claims about recorders' files: what a format holds comes out as it went in, whatever its writer's habits."""

import io
import os
import struct
import warnings
import wave
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import pyuff
import xarray as xr
from nptdms import ChannelObject, RootObject, TdmsWriter
from nptdms.log import log_manager
from scipy.io import savemat, wavfile

from process.errors import InputError
from process.labels import make_record
from process.machine.modes import ModalModel
from smfe.records import (
    Channel,
    read_frf,
    read_records,
    uff_columns,
    write_compliance_uff,
    write_record_uff,
)
from smfe.records.formats.uff import read_functions

RATE = 51200.0
RNG = np.random.default_rng(7)


def one(path: Path, channels: dict[str, Channel]) -> xr.Dataset:
    (record,) = read_records(path, channels)
    return record


FORCE = {"time": Channel("t", "s"), "force_x": Channel("Fx", "N")}


class TestTextOfRecorders:
    KISTLER = (
        "DynoWare,Version 2.5.1.2\nPath:,C:\\messung\\\nSampling rate [Hz]:,10000\nCycle No:,1\n"
        "Time,Fx,Fy\ns,N,N\n0,1.5,-2\n0.0001,2.5,-3\n0.0002,3.5,-4\n"
    )
    CONTROLDESK = (
        'DCI,CSV,2.1\ndescription,"ramp, slow"\nx_axis,t\ntrace_begin,0\n'
        'path,t,"Model Root/Force, x/Out1","Model Root/Pos/Out1"\nunit,s,N,m\n'
        "trace_values,0,1.5,10\n,0.0001,2.5,11\n,0.0002,3.5,12\n,0.0003,4.5,13\n"
    )

    def test_kistler_header_and_line_of_units(self, tmp_path: Path) -> None:
        (tmp_path / "r.csv").write_text(self.KISTLER)
        record = one(tmp_path / "r.csv", {"time": Channel("Time", "s"), "force_y": Channel("Fy", "N")})
        np.testing.assert_array_equal(record["force"][0], [-2.0, -3.0, -4.0])

    def test_dspace_rows_that_begin_with_a_keyword_and_names_with_commas(self, tmp_path: Path) -> None:
        (tmp_path / "r.csv").write_text(self.CONTROLDESK)
        channels = {"time": Channel("t", "s"), "force_x": Channel("Model Root/Force, x/Out1", "N")}
        record = one(tmp_path / "r.csv", channels)
        np.testing.assert_array_equal(record["force"][0], [1.5, 2.5, 3.5, 4.5])
        np.testing.assert_array_equal(record["time"], [0.0, 1e-4, 2e-4, 3e-4])

    @pytest.mark.parametrize("encoding", ["gbk", "utf-16", "utf-16-le", "utf-16-be", "latin-1", "utf-8"])
    @pytest.mark.parametrize(("delimiter", "decimal"), [(";", ","), ("\t", ","), (",", ".")])
    def test_encodings(self, tmp_path: Path, encoding: str, delimiter: str, decimal: str) -> None:
        name = {"gbk": "切削力", "latin-1": "Kraft für x"}.get(encoding, "切削力 für x")
        lines = [f"t{delimiter}{name}", f"s{delimiter}N"]
        lines += [f"{k / 10:g}{delimiter}{k + 0.5:g}".replace(".", decimal) for k in range(20)]
        (tmp_path / "r.csv").write_bytes("\r\n".join(lines).encode(encoding))
        record = one(tmp_path / "r.csv", {"time": Channel("t", "s"), "force_x": Channel(name, "N")})
        np.testing.assert_allclose(record["force"][0], np.arange(20) + 0.5)

    def test_a_header_longer_than_what_is_looked_at_first(self, tmp_path: Path) -> None:
        header = "".join(f"setting number {k} of the amplifier is switched off\n" for k in range(4000))
        (tmp_path / "r.csv").write_text(header + "t,Fx\n" + "".join(f"{k},{k}\n" for k in range(9)))
        assert one(tmp_path / "r.csv", FORCE).sizes["time"] == 9


class TestParquet:
    def test_integers_floats_and_what_is_missing(self, tmp_path: Path) -> None:
        frame = pd.DataFrame({"t": np.arange(5) / RATE, "Fx": np.arange(5, dtype=np.int16), "text": list("abcde")})
        frame.to_parquet(tmp_path / "r.parquet")
        np.testing.assert_array_equal(one(tmp_path / "r.parquet", FORCE)["force"][0], np.arange(5))
        with pytest.raises(InputError, match=r"r\.parquet: 'text' holds no real numbers"):
            one(tmp_path / "r.parquet", FORCE | {"force_x": Channel("text", "N")})
        frame.assign(Fx=[1.0, None, 2.0, 3.0, 4.0]).to_parquet(tmp_path / "r.parquet")
        with pytest.raises(InputError, match=r"channel force_x .* is empty, NaN .* sample 1 "):
            one(tmp_path / "r.parquet", FORCE)


class TestTdms:
    def write(self, path: Path, *channels: ChannelObject) -> Path:
        with TdmsWriter(path) as writer:
            writer.write_segment([RootObject(), *channels])
        return path

    def test_the_clock_is_that_of_the_waveform(self, tmp_path: Path) -> None:
        clock = {"wf_increment": 1.0 / RATE, "wf_start_offset": 0.25}
        x = RNG.standard_normal(100)
        path = self.write(tmp_path / "r.tdms", ChannelObject("DAQ", "Fx", x, clock))
        record = one(path, {"force_x": Channel("Fx", "kN")})
        np.testing.assert_array_equal(record["force"][0], 1000.0 * x)
        np.testing.assert_allclose(record["time"], 0.25 + np.arange(100) / RATE, rtol=1e-14)

    def test_a_name_in_two_groups_needs_its_group(self, tmp_path: Path) -> None:
        a, b = RNG.standard_normal((2, 50))
        path = self.write(tmp_path / "r.tdms", ChannelObject("A", "Fx", a), ChannelObject("B", "Fx", b))
        clock = {"time": Channel(sample_rate=RATE)}
        record = one(path, clock | {"force_x": Channel("B/Fx", "N")})
        np.testing.assert_array_equal(record["force"][0], b)
        with pytest.raises(InputError, match=r"no column 'Fx' .*; the file has 'A/Fx', 'B/Fx'"):
            one(path, clock | {"force_x": Channel("Fx", "N")})

    def test_a_file_whose_recorder_broke_off(self, tmp_path: Path) -> None:
        path = self.write(
            tmp_path / "r.tdms", ChannelObject("A", "t", np.arange(9.0)), ChannelObject("A", "Fx", np.ones(9))
        )
        whole = path.read_bytes()
        for broken in (whole[:-8], whole[:12] + b"\xff" * 8 + whole[20:]):
            path.write_bytes(broken)
            with pytest.raises(
                InputError, match=r"r\.tdms: the segment that begins at byte 0 is damaged or ends after"
            ):
                one(path, FORCE)

    def test_sizes_that_do_not_fit_together(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        terminal = io.StringIO()
        monkeypatch.setattr(log_manager.console_handler, "stream", terminal)
        path = self.write(
            tmp_path / "r.tdms", ChannelObject("A", "t", np.arange(64.0)), ChannelObject("A", "Fx", np.ones(64))
        )
        whole = path.read_bytes()
        at = whole.rindex(struct.pack("<Q", 64))
        path.write_bytes(whole[:at] + struct.pack("<Q", 60) + whole[at + 8 :])
        with pytest.raises(InputError, match=r"r\.tdms: cannot be read as TDMS; .* not a multiple of the chunk size"):
            one(path, FORCE)
        assert terminal.getvalue() == ""

    def test_channels_of_different_rate(self, tmp_path: Path) -> None:
        path = self.write(
            tmp_path / "r.tdms", ChannelObject("A", "t", np.arange(9.0)), ChannelObject("A", "Fx", np.ones(4))
        )
        with pytest.raises(InputError, match=r"columns of different length \('t' 9, 'Fx' 4 samples\)"):
            one(path, FORCE)


class TestWav:
    @pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.int32, np.float32, np.float64])
    def test_sample_formats_as_scipy_writes_them(self, tmp_path: Path, dtype: type) -> None:
        full = {np.uint8: 128.0, np.int16: 2.0**15, np.int32: 2.0**31}.get(dtype, 1.0)
        offset = 128.0 if dtype is np.uint8 else 0.0
        wanted = np.round(RNG.uniform(-0.9, 0.9, (64, 2)) * full) / full
        wavfile.write(tmp_path / "r.wav", 48000, (wanted * full + offset).astype(dtype))
        record = one(tmp_path / "r.wav", {"acceleration_x": Channel(2, "m/s^2", scale=50.0)})
        np.testing.assert_allclose(
            record["acceleration"][0], 50.0 * wanted[:, 1].astype(np.float32 if full == 1 else float), rtol=1e-6
        )
        np.testing.assert_allclose(record["time"], np.arange(64) / 48000.0)

    def test_24_bits_as_the_standard_library_writes_them(self, tmp_path: Path) -> None:
        counts = np.array([0, 1, -1, 2**23 - 1, -(2**23)])
        with wave.open(str(tmp_path / "r.wav"), "wb") as file:
            file.setparams((1, 3, 44100, 0, "NONE", ""))
            file.writeframes(b"".join(int(c).to_bytes(3, "little", signed=True) for c in counts))
        np.testing.assert_array_equal(one(tmp_path / "r.wav", {"sound": Channel(1, "Pa")})["sound"], counts / 2.0**23)

    def test_faults(self, tmp_path: Path) -> None:
        path = tmp_path / "r.wav"
        wavfile.write(path, 8000, np.zeros(100, np.int16))
        whole = path.read_bytes()
        with pytest.raises(InputError, match=r"column 2 is asked for but the file has 1"):
            one(path, {"force_x": Channel(2, "N")})
        path.write_bytes(whole[:-10])
        with pytest.raises(InputError, match=r"r\.wav: the header states 244 bytes of samples and 234 bytes are there"):
            one(path, {"force_x": Channel(1, "N")})
        path.write_bytes(whole[:20] + struct.pack("<H", 2) + whole[22:])
        with pytest.raises(InputError, match=r"samples of format 2 with 16 bits are not read"):
            one(path, {"force_x": Channel(1, "N")})


class TestHdf5:
    def test_columns_and_rows_of_a_matrix(self, tmp_path: Path) -> None:
        data = RNG.standard_normal((40, 3))
        with h5py.File(tmp_path / "r.hdf5", "w") as file:
            file["daq/down"], file["daq/across"] = data, data.T
        clock = {"time": Channel(sample_rate=RATE)}
        for name in ("daq/down(:,2)", "daq/across(2,:)"):
            record = one(tmp_path / "r.hdf5", clock | {"force_x": Channel(name, "N")})
            np.testing.assert_array_equal(record["force"][0], data[:, 1])

    def test_a_header_that_states_more_than_is_there_allocates_nothing(self, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "r.h5", "w") as file:
            file.create_dataset("Fx", (1 << 42,), np.float64, chunks=(1024,))
        with pytest.raises(InputError, match=r"r\.h5: the header states 35184372088832 bytes of samples and 0 bytes"):
            one(tmp_path / "r.h5", {"time": Channel(sample_rate=1.0), "force_x": Channel("Fx", "N")})


def pyuff_set(**changes: object) -> dict[str, object]:
    """Return a dataset 58 as pyuff writes it."""
    n = 16
    data: dict[str, object] = {
        "type": 58, "binary": 0, "func_type": 1, "rsp_node": 1, "rsp_dir": 1, "ref_node": 0, "ref_dir": 0,
        "id1": "force", "id2": "NONE", "id3": "NONE", "id4": "NONE", "id5": "NONE", "load_case_id": 0,
        "rsp_ent_name": "NONE", "ref_ent_name": "NONE", "ver_num": 0, "func_id": 0, "ord_data_type": 4,
        "abscissa_spacing": 1, "abscissa_min": 0.0, "abscissa_inc": 1.0 / 51200.0, "z_axis_value": 0.0, "num_pts": n,
        "data": np.arange(n) - 3.5, "x": np.arange(n) / 51200.0, "abscissa_spec_data_type": 17,
        "ordinate_spec_data_type": 13, "orddenom_spec_data_type": 0, "z_axis_spec_data_type": 0,
    }  # fmt: skip
    return data | changes


def pyuff_file(path: Path, *sets: dict[str, object]) -> Path:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # pyuff leaves a file open
        pyuff.UFF(str(path)).write_sets(list(sets), "add")
    return path


CLOCKED = {"force_x": Channel("1:+X", "N"), "acceleration_z": Channel("12:-Z", "g")}


class TestUff:
    @pytest.mark.parametrize("binary", [0, 1])
    def test_time_data_of_another_writer(self, tmp_path: Path, binary: int) -> None:
        y = RNG.standard_normal(16)
        path = pyuff_file(
            tmp_path / "r.uff", pyuff_set(binary=binary), pyuff_set(binary=binary, rsp_node=12, rsp_dir=-3, data=y)
        )
        record = one(path, CLOCKED)
        np.testing.assert_array_equal(record["force"].sel(axis="x"), np.arange(16) - 3.5)
        np.testing.assert_allclose(record["acceleration"].sel(axis="z"), 9.80665 * y, rtol=1e-12 if binary else 1e-11)

    def test_a_step_of_six_digits_is_not_taken_for_the_clock(self, tmp_path: Path) -> None:
        path = pyuff_file(tmp_path / "r.uff", pyuff_set())
        assert "1.95313e-05" in path.read_text().lower()  # off by 2.6e-6: 1.5 ms after ten minutes
        np.testing.assert_allclose(
            one(path, {"force_x": CLOCKED["force_x"]})["time"], np.arange(16) / 51200.0, rtol=1e-15
        )

    def test_an_frf_of_another_writer(self, tmp_path: Path) -> None:
        h = RNG.standard_normal(16) + 1j * RNG.standard_normal(16)
        frf = pyuff_set(
            func_type=4, ref_node=2, ref_dir=2, data=h, ord_data_type=6, abscissa_spec_data_type=18, abscissa_inc=0.5,
            x=0.5 * np.arange(16), abscissa_min=0.0, binary=1,
        )  # fmt: skip
        path = pyuff_file(tmp_path / "h.unv", pyuff_set(), frf)
        channels = {
            "frequency": Channel("frequency", "Hz"),
            "compliance_real": Channel("1:+X/2:+Y real", "um/N"),
            "compliance_imag": Channel("1:+X/2:+Y imag", "um/N"),
        }
        found = read_frf(path, channels, "x", "y")
        np.testing.assert_allclose(found["compliance"][:, 0, 0], 1e-6 * h, rtol=1e-12)
        np.testing.assert_array_equal(found["frequency"], 0.5 * np.arange(16))

    def test_uneven_single_precision_and_numbers_that_touch(self, tmp_path: Path) -> None:
        head = pyuff_file(tmp_path / "a.uff", pyuff_set(ord_data_type=2)).read_text().splitlines()
        record_7 = f"{5:10d}{3:10d}{0:10d}{0.0:13.5e}{0.0:13.5e}{0.0:13.5e}"
        body = "  5.00000e+00 9.930030e-01-1.084200e-19  5.03501e+00  1.00135e+00  0.00000e+00"
        last = "  1.00000e+02  8.03837e-01  0.00000e+00  0.00000e+00  0.00000e+00  0.00000e+00"
        path = tmp_path / "r.uff"
        path.write_text("\n".join([*head[:8], record_7, *head[9:13], body, last, "    -1", ""]))
        (function,) = read_functions(path)
        np.testing.assert_allclose(function.axis(), [5.0, 5.03501, 100.0])
        np.testing.assert_allclose(function.y, [0.993003 - 1.0842e-19j, 1.00135, 0.803837])

    @pytest.mark.parametrize("binary", [0, 1])
    @pytest.mark.parametrize("even", [0, 1])
    @pytest.mark.parametrize("kind", [2, 4, 5, 6])
    def test_every_kind_of_ordinate(self, tmp_path: Path, kind: int, even: int, binary: int) -> None:
        n = 17  # odd, so that the last line of text is not full
        x = 0.5 * np.arange(n) if even else np.sort(RNG.uniform(0.0, 9.0, n))
        y = np.arange(n) + 0.25 + (1j * np.arange(n) if kind > 4 else 0.0)
        written = pyuff_set(binary=binary, ord_data_type=kind, abscissa_spacing=even, x=x, data=y, num_pts=n)
        (function,) = read_functions(pyuff_file(tmp_path / "r.uff", written))
        np.testing.assert_array_equal(function.y, y)
        np.testing.assert_allclose(function.axis(), x, atol=0.0 if binary else 1e-5)

    def test_abscissae_in_single_precision_after_the_standard(self, tmp_path: Path) -> None:
        x, y = np.array([0.0, 0.5, 4.0], np.float32), np.array([1.0, -2.0, 3.5])
        written = pyuff_set(binary=1, abscissa_spacing=0, x=x.astype(float), data=y, num_pts=3)
        path = pyuff_file(tmp_path / "r.uff", written)
        head = b"\n".join(path.read_bytes().split(b"\n")[:13]) + b"\n"
        body = b"".join(struct.pack("<fd", *row) for row in zip(x, y, strict=True))
        path.write_bytes(head + body + b"\n    -1\n")
        (function,) = read_functions(path)
        np.testing.assert_array_equal(function.axis(), x)
        np.testing.assert_array_equal(function.y, y)

    def test_a_file_whose_header_its_writer_has_overwritten_is_refused(self, tmp_path: Path) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ResourceWarning)
            pyuff.UFF(str(tmp_path / "r.uff")).write_sets([pyuff_set(binary=1)], "overwrite")
        with pytest.raises(InputError, match=r"r\.uff: the last dataset is not closed"):
            one(tmp_path / "r.uff", {"force_x": CLOCKED["force_x"]})

    def test_other_datasets_are_passed_over_and_repeated_names_are_segments(self, tmp_path: Path) -> None:
        node = {
            "type": 15,
            "node_nums": [1],
            "def_cs": [0],
            "disp_cs": [0],
            "color": [0],
            "x": [0.0],
            "y": [1.0],
            "z": [2.0],
        }
        path = pyuff_file(tmp_path / "r.uff", node, pyuff_set(), pyuff_set(data=np.ones(16)))
        records = read_records(path, {"force_x": CLOCKED["force_x"]})
        assert [float(r["force"][0, 0]) for r in records] == [-3.5, 1.0]
        assert [r.attrs["source"] for r in records] == ["r.uff, segment 0", "r.uff, segment 1"]

    def test_round_trip_is_exact(self, tmp_path: Path) -> None:
        n = 333
        vectors = {"force": {a: RNG.standard_normal(n) for a in "xyz"}, "acceleration": {"z": RNG.standard_normal(n)}}
        record = make_record(0.1 + np.arange(n) / 44100.0, vectors, {"spindle_speed": np.linspace(1, 2, n)})
        back = one(write_record_uff(record, tmp_path / "r.uff"), uff_columns(record))
        xr.testing.assert_equal(back.drop_vars("time"), record.drop_vars("time"))
        np.testing.assert_allclose(back["time"], record["time"], rtol=1e-13)

    def test_what_we_write_another_reader_reads(self, tmp_path: Path) -> None:
        n = 50
        record = make_record(np.arange(n) / 44100.0, {"force": {"y": RNG.standard_normal(n)}})
        found = pyuff.UFF(str(write_record_uff(record, tmp_path / "r.uff"))).read_sets(0)
        np.testing.assert_array_equal(found["data"], record["force"][0])
        assert (found["rsp_node"], found["rsp_dir"], found["func_type"]) == (1, 2, 1)
        assert found["abscissa_inc"] == pytest.approx(1.0 / 44100.0, rel=2e-7)

    def test_a_compliance_goes_and_comes_back_exactly(self, tmp_path: Path) -> None:
        model = ModalModel([61.4, 90.0], [0.02, 0.03], [1e7, 2e7], [(1.0, 0.2, 0.0), (0.0, 1.0, 0.3)])
        compliance = model.compliance(np.arange(400) * 0.25)
        path = write_compliance_uff(compliance, tmp_path / "h.uff")
        for response in "xyz":
            for excitation in "xyz":
                name = f"1:+{response.upper()}/1:+{excitation.upper()}"
                channels = {
                    "frequency": Channel("frequency", "Hz"),
                    "compliance_real": Channel(f"{name} real", "m/N"),
                    "compliance_imag": Channel(f"{name} imag", "m/N"),
                }
                back = read_frf(path, channels, response, excitation)
                expected = compliance["compliance"].sel(response=response, excitation=excitation)
                np.testing.assert_array_equal(back["compliance"][:, 0, 0], expected)
        with pytest.raises(InputError, match="not evenly spaced"):
            write_compliance_uff(compliance.isel(frequency=[1, 2, 5]), path)

    @pytest.mark.parametrize("binary", [0, 1])
    def test_truncated(self, tmp_path: Path, binary: int) -> None:
        path = pyuff_file(tmp_path / "r.uff", pyuff_set(binary=binary))
        whole = path.read_bytes()
        for size in range(1, len(whole.rstrip()) - 1, 23):
            path.write_bytes(whole[:size])
            with pytest.raises(InputError, match=r"r\.uff"):
                one(path, {"force_x": CLOCKED["force_x"]})

    @pytest.mark.parametrize("binary", [0, 1])
    def test_a_header_that_states_fewer_values_than_there_are(self, tmp_path: Path, binary: int) -> None:
        path = pyuff_file(tmp_path / "r.uff", pyuff_set(binary=binary))
        path.write_bytes(path.read_bytes().replace(b"         4        16", b"         4         6"))
        with pytest.raises(InputError, match=r"r\.uff: a dataset 58 holds"):
            one(path, {"force_x": CLOCKED["force_x"]})

    def test_names_that_are_not_there(self, tmp_path: Path) -> None:
        path = pyuff_file(tmp_path / "r.uff", pyuff_set())
        with pytest.raises(InputError, match=r"no column '1:\+Y' .*the file has 'time', '1:\+X'"):
            one(path, {"force_x": Channel("1:+Y", "N")})


class TestMatlabStructures:
    def test_fields_and_arrays_of_structures(self, tmp_path: Path) -> None:
        x, y = RNG.standard_normal((2, 30))
        traces = np.zeros((1, 2), dtype=[("Name", object), ("Data", object)])
        traces[0, 0], traces[0, 1] = ("a", x), ("b", y)
        savemat(tmp_path / "r.mat", {"rec": {"X": {"Data": np.arange(30) / RATE}, "Y": traces}, "other": 1.0})
        channels = {"time": Channel("rec.X.Data", "s"), "force_x": Channel("rec.Y(2).Data", "N")}
        np.testing.assert_array_equal(one(tmp_path / "r.mat", channels)["force"][0], y)
        with pytest.raises(InputError, match=r"did you mean 'rec\.Y\(2\)\.Data'"):
            one(tmp_path / "r.mat", channels | {"force_x": Channel("rec.Y(3).Data", "N")})

    def test_version_7_3_calls_them_the_same(self, tmp_path: Path) -> None:
        with h5py.File(tmp_path / "r.mat", "w", userblock_size=512) as file:
            file["data/Fx"], file["data/t"] = np.arange(9.0)[None, :], np.arange(9.0)[None, :] / RATE
            file["#refs#/a"] = np.ones((1, 9))
        with (tmp_path / "r.mat").open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file")
        channels = {"time": Channel("data.t", "s"), "force_x": Channel("data.Fx", "N")}
        np.testing.assert_array_equal(one(tmp_path / "r.mat", channels)["force"][0], np.arange(9))


class TestNumpy:
    def test_arrays_are_called_as_python_indexes_them(self, tmp_path: Path) -> None:
        data = RNG.standard_normal((40, 3))
        np.save(tmp_path / "r.npy", np.asfortranarray(data))
        np.savez_compressed(tmp_path / "r.npz", t=np.arange(40) / RATE, u=data.T)
        clock = {"time": Channel(sample_rate=RATE)}
        record = one(tmp_path / "r.npy", clock | {"force_x": Channel("[:,1]", "N"), "force_y": Channel(3, "N")})
        np.testing.assert_array_equal(record["force"], data[:, 1:].T)
        record = one(tmp_path / "r.npz", {"time": Channel("t", "s"), "force_x": Channel("u[2,:]", "N")})
        np.testing.assert_array_equal(record["force"][0], data[:, 2])

    def test_a_list_of_arrays_is_read_without_running_anything(self, tmp_path: Path) -> None:
        h = RNG.standard_normal((2, 30)) + 1j * RNG.standard_normal((2, 30))
        both = np.empty(2, dtype=object)
        both[0], both[1] = np.arange(30.0), h
        np.save(tmp_path / "h.npy", both)
        channels = {
            "frequency": Channel("[0]", "Hz"),
            "compliance_real": Channel("[1][1,:] real", "m/N"),
            "compliance_imag": Channel("[1][1,:] imag", "m/N"),
        }
        found = read_frf(tmp_path / "h.npy", channels, "x", "x")
        np.testing.assert_array_equal(found["compliance"][:, 0, 0], h[1])

    def test_a_pickle_that_would_run_code_is_refused(self, tmp_path: Path) -> None:
        class Evil:
            def __reduce__(self) -> tuple[object, ...]:
                return os.mkdir, (str(tmp_path / "owned"),)

        np.save(tmp_path / "r.npy", np.array([Evil(), Evil()], dtype=object), allow_pickle=True)
        with pytest.raises(InputError, match=r"r\.npy: cannot be read as a NumPy file; .*it would call posix\.mkdir"):
            one(tmp_path / "r.npy", FORCE)
        assert not (tmp_path / "owned").exists()

    def test_a_header_that_states_more_than_is_there(self, tmp_path: Path) -> None:
        np.save(tmp_path / "r.npy", np.arange(64.0))
        whole = (tmp_path / "r.npy").read_bytes()
        (tmp_path / "r.npy").write_bytes(whole.replace(b"(64,), }        ", b"(64000000000,), }"))
        with pytest.raises(InputError, match=r"r\.npy: "):
            one(tmp_path / "r.npy", {"time": Channel(sample_rate=1.0), "force_x": Channel(1, "N")})


class TestAveragedResponses:
    def test_accelerance_and_mobility_become_the_compliance_by_their_unit(self, tmp_path: Path) -> None:
        model = ModalModel([61.4], [0.02], [1e7], [(1.0, 0.0, 0.0)])
        f = np.arange(5, 100) * 1.0
        expected = model.compliance(f, "x", "x")["compliance"].values[:, 0, 0]
        w = 2.0 * np.pi * f
        for unit, values in (("m/N", expected), ("mm/s/N", 1e3j * w * expected), ("g/N", -(w**2) * expected / 9.80665)):
            frame = pd.DataFrame({"f": np.r_[0.0, f], "re": np.r_[1.0, values.real], "im": np.r_[0.0, values.imag]})
            frame.to_csv(tmp_path / "h.csv", index=False)
            channels = {
                "frequency": Channel("f", "Hz"),
                "compliance_real": Channel("re", unit),
                "compliance_imag": Channel("im", unit),
            }
            found = read_frf(tmp_path / "h.csv", channels, "x", "x").sel(frequency=f)
            np.testing.assert_allclose(found["compliance"][:, 0, 0], expected, rtol=1e-12)
        with pytest.raises(InputError, match="real and imaginary part are of different motions"):
            read_frf(tmp_path / "h.csv", channels | {"compliance_real": Channel("re", "m/N")}, "x", "x")


class TestCutPro:
    def test_frequency_real_and_imaginary_part_below_a_header(self, tmp_path: Path) -> None:
        # No description of the .frf layout is published: this is the generic form, three columns below any header.
        path = tmp_path / "tool.frf"
        path.write_text("Transfer function\nHz  m/N  m/N\n 0.0 1e-7 0.0\n 1.0 2e-7 -1e-8\n 2.0 3e-7 -2e-8\n")
        channels = {
            "frequency": Channel(1, "Hz"),
            "compliance_real": Channel(2, "m/N"),
            "compliance_imag": Channel(3, "m/N"),
        }
        found = read_frf(path, channels, "x", "x")
        np.testing.assert_allclose(found["compliance"][:, 0, 0], [1e-7, 2e-7 - 1e-8j, 3e-7 - 2e-8j])
