"""Claims about long records: read in pieces they are the record; reduced they are the record below the band's edge."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, RootObject, TdmsWriter
from scipy import io, signal
from scipy.io import wavfile

from process.errors import InputError
from process.labels import make_record, sample_interval
from smfe.records import (
    Channel,
    read_blocks,
    read_records,
    read_reduced,
    record_columns,
    uff_columns,
    write_record_csv,
    write_record_mat,
    write_record_netcdf,
    write_record_uff,
)
from smfe.records.decimate import low_pass, reduction

RATE = 4096.0


def a_record(n: int = 6000, seed: int = 1) -> xr.Dataset:
    rng = np.random.default_rng(seed)
    vectors = {
        "force": {a: 100.0 * rng.standard_normal(n) for a in "xyz"},
        "acceleration": {a: rng.standard_normal(n) for a in "xz"},
    }
    scalars = {"spindle_angle": 0.9 * np.arange(n), "spindle_speed": np.linspace(300.0, 600.0, n)}
    return make_record(np.arange(n) / RATE, vectors, scalars)


COLUMNS = {
    "force_x": Channel("Fx", "N"),
    "acceleration_z": Channel("az", "g", sign=-1.0),
    "spindle_angle": Channel("a", "deg"),
}


def samples(n: int = 6000) -> dict[str, np.ndarray]:
    """Return columns as a recorder would have them: the angle wraps at 360 degrees."""
    record = a_record(n)
    wrapped = np.degrees(np.mod(record["spindle_angle"].values, 2.0 * np.pi))
    return {
        "t": record["time"].values,
        "Fx": record["force"].values[0],
        "az": record["acceleration"].sel(axis="z").values,
        "a": wrapped,
    }


def csv_file(folder: Path, n: int) -> tuple[Path, dict[str, Channel]]:
    pd.DataFrame(samples(n)).to_csv(folder / "r.csv", index=False)
    return folder / "r.csv", COLUMNS | {"time": Channel("t", "s")}


def parquet_file(folder: Path, n: int) -> tuple[Path, dict[str, Channel]]:
    pd.DataFrame(samples(n)).to_parquet(folder / "r.parquet", row_group_size=1000)
    return folder / "r.parquet", COLUMNS | {"time": Channel("t", "s")}


def hdf5_file(folder: Path, n: int) -> tuple[Path, dict[str, Channel]]:
    with h5py.File(folder / "r.h5", "w") as file:
        for name, values in samples(n).items():
            file.create_dataset(name, data=values, chunks=(min(n, 777),), compression="gzip")
    return folder / "r.h5", COLUMNS | {"time": Channel("t", "s")}


def mat_file(folder: Path, n: int) -> tuple[Path, dict[str, Channel]]:
    io.savemat(folder / "r.mat", samples(n))
    return folder / "r.mat", COLUMNS | {"time": Channel("t", "s")}


def mat_73_file(folder: Path, n: int) -> tuple[Path, dict[str, Channel]]:
    with h5py.File(folder / "r.mat", "w", userblock_size=512) as file:
        for name, values in samples(n).items():
            file[name] = values[None, :]
    with (folder / "r.mat").open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file")
    return folder / "r.mat", COLUMNS | {"time": Channel("t", "s")}


def tdms_file(folder: Path, n: int) -> tuple[Path, dict[str, Channel]]:
    with TdmsWriter(folder / "r.tdms") as writer:
        for begin in range(0, n, 1000):
            clock = {"wf_increment": 1.0 / RATE, "wf_start_offset": 0.0}
            part = slice(begin, begin + 1000)
            channels = [ChannelObject("DAQ", name, v[part], clock) for name, v in samples(n).items() if name != "t"]
            writer.write_segment([RootObject(), *channels])
    return folder / "r.tdms", COLUMNS | {"force_x": Channel("DAQ/Fx", "N")}


def wav_file(folder: Path, n: int) -> tuple[Path, dict[str, Channel]]:
    columns = samples(n)
    wavfile.write(folder / "r.wav", int(RATE), np.column_stack([columns[c] for c in ("Fx", "az", "a")]))
    return folder / "r.wav", {name: Channel(k, c.unit, c.sign) for k, (name, c) in enumerate(COLUMNS.items(), 1)}


def own_file(folder: Path, n: int) -> tuple[Path, dict[str, Channel]]:
    return write_record_netcdf(a_record(n), folder / "r.nc"), {"force_y": Channel("any", "kN", sign=-1.0)}


def uff_file(folder: Path, n: int) -> tuple[Path, dict[str, Channel]]:
    record = a_record(n)
    return write_record_uff(record, folder / "r.uff"), uff_columns(record)


FILES = [csv_file, parquet_file, hdf5_file, mat_file, mat_73_file, tdms_file, wav_file, own_file, uff_file]
Make = Callable[[Path, int], tuple[Path, dict[str, Channel]]]


def together(path: Path, channels: dict[str, Channel], block: int) -> xr.Dataset:
    return xr.concat(list(read_blocks(path, channels, block)), "time", data_vars="minimal", coords="minimal")


def assert_delays_undone(path: Path, block: int, first: float, second: float) -> None:
    """Two channels of a record with delays [s] of their own: in pieces it is what it is as a whole."""
    if not path.exists():
        write_record_mat(a_record(700), path)
    channels = record_columns(a_record(2))
    channels["force_x"] = Channel("Fx", "N", delay=first)
    channels["acceleration_z"] = Channel("az", "m/s^2", delay=second)
    (whole,) = read_records(path, channels)
    xr.testing.assert_allclose(together(path, channels, block), whole, rtol=1e-12, atol=1e-9)


class TestBlocks:
    @pytest.mark.parametrize("make", FILES)
    @pytest.mark.parametrize("block", [2, 1000, pytest.param(5999, marks=pytest.mark.slow), 10_000])
    def test_pieces_together_are_the_record(self, tmp_path: Path, make: Make, block: int) -> None:
        path, channels = make(tmp_path, 6000 if block > 2 else 21)
        (whole,) = read_records(path, channels)
        pieces = together(path, channels, block)
        xr.testing.assert_allclose(pieces, whole, rtol=1e-14, atol=1e-10)
        assert pieces.attrs["source"] == path.name

    @given(st.integers(2, 700), st.floats(-9e-3, 9e-3), st.floats(-9e-3, 9e-3))
    @settings(max_examples=4, deadline=None)
    def test_delays_are_undone_across_the_edges_of_pieces(
        self, tmp_path_factory: pytest.TempPathFactory, block: int, first: float, second: float
    ) -> None:
        assert_delays_undone(tmp_path_factory.getbasetemp() / "delays.mat", block, first, second)

    @pytest.mark.slow
    @given(st.integers(2, 700), st.floats(-9e-3, 9e-3), st.floats(-9e-3, 9e-3))
    @settings(max_examples=40, deadline=None)
    def test_many_delays_are_undone(
        self, tmp_path_factory: pytest.TempPathFactory, block: int, first: float, second: float
    ) -> None:
        assert_delays_undone(tmp_path_factory.getbasetemp() / "delays.mat", block, first, second)

    def test_a_gap_between_two_pieces_is_found(self, tmp_path: Path) -> None:
        columns = samples(3000)
        columns["t"] = np.where(np.arange(3000) < 1000, columns["t"], columns["t"] + 5.0 / RATE)
        io.savemat(tmp_path / "r.mat", columns)
        pieces = read_blocks(tmp_path / "r.mat", COLUMNS | {"time": Channel("t", "s")}, 1000)
        with pytest.raises(InputError, match=r"r\.mat, from sample 1000: time is not uniform"):
            list(pieces)

    def test_a_missing_sample_is_counted_from_the_begin_of_the_file(self, tmp_path: Path) -> None:
        columns = samples(3000)
        columns["Fx"][2345] = np.nan
        io.savemat(tmp_path / "r.mat", columns)
        with pytest.raises(InputError, match=r"the first at sample 2345 \(counted from 0\)"):
            list(read_blocks(tmp_path / "r.mat", COLUMNS | {"time": Channel("t", "s")}, 1000))

    def test_faults(self, tmp_path: Path) -> None:
        path, channels = mat_file(tmp_path, 100)
        with pytest.raises(InputError, match="a block of 1 samples"):
            read_blocks(path, channels, 1)
        with pytest.raises(InputError, match=r"r\.mat: no column 'nothing'"):
            read_blocks(path, channels | {"force_y": Channel("nothing", "N")}, 10)


class TestReduction:
    @pytest.mark.parametrize("factor", [3, 8, 50, 128])
    def test_the_filter_is_flat_in_its_pass_band_and_closed_in_its_stop_band(self, factor: int) -> None:
        frequency, gain = signal.freqz(low_pass(factor), worN=1 << 16, fs=factor)  # in units of the new sample rate
        assert np.abs(np.abs(gain[frequency <= 0.4]) - 1.0).max() < 1e-5
        assert 20.0 * np.log10(np.abs(gain[frequency >= 0.6]).max()) < -100.0

    def test_a_reduced_record_is_the_record_below_the_highest_frequency(self, tmp_path: Path) -> None:
        n, rate, highest = 40_000, 51_200.0, 400.0
        t = np.arange(n) / rate
        inside = np.sin(2 * np.pi * 397.0 * t + 0.3) + 2.0 * np.sin(2 * np.pi * 11.0 * t)
        # 1024 +- 397 Hz folds back onto 397 Hz; the rest is anywhere above.
        outside = sum(np.sin(2 * np.pi * f * t) for f in (1024.0 - 397.0, 1024.0 + 397.0, 3000.0, 20_000.0))
        angle = 40.0 * t + 3.0 * t**2
        path = write_record_mat(
            make_record(t, {"force": {"x": inside + outside}}, {"spindle_angle": angle}), tmp_path / "r.mat"
        )
        channels = {"time": Channel("t", "s"), "force_x": Channel("Fx", "N"), "spindle_angle": Channel("angle", "rad")}
        (reduced,) = read_reduced(path, channels, highest)
        assert 1.0 / sample_interval(reduced) == pytest.approx(1024.0, rel=1e-12)
        reduced = reduced.isel(time=slice(18, -18))  # where the filter lies within the record
        at = reduced["time"].values
        expected = np.sin(2 * np.pi * 397.0 * at + 0.3) + 2.0 * np.sin(2 * np.pi * 11.0 * at)
        assert np.abs(reduced["force"].values[0] - expected).max() < 3e-5
        # A parabola is bent by the spread of the filter, 2e-4 s squared; the angle is otherwise exact.
        np.testing.assert_allclose(reduced["spindle_angle"], 40.0 * at + 3.0 * at**2, atol=1e-5)
        assert reduced.attrs["reduced_from_Hz"] == pytest.approx(rate)

    @pytest.mark.parametrize("make", FILES)
    def test_the_size_of_the_blocks_changes_nothing(self, tmp_path: Path, make: Make) -> None:
        path, channels = make(tmp_path, 6000)
        whole = read_reduced(path, channels, 100.0, block=1 << 16)[0]
        assert whole.attrs["reduced_from_Hz"] == pytest.approx(RATE)
        assert whole.sizes["time"] == 6000 // 16
        for block in (333, 1000, 4097):
            pieces = read_reduced(path, channels, 100.0, block=block)[0]
            xr.testing.assert_allclose(pieces, whole, rtol=1e-12, atol=1e-9)

    def test_each_reduced_sample_is_where_the_file_has_one(self, tmp_path: Path) -> None:
        path, channels = mat_file(tmp_path, 6000)
        (reduced,) = read_reduced(path, channels, 100.0)
        np.testing.assert_array_equal(reduced["time"], samples()["t"][::16])

    @pytest.mark.parametrize(
        ("rate", "highest", "factor"),
        [
            (51_200.0, 400.0, 50),
            (51_200.0, 409.6, 50),
            (51_200.0, 8000.0, 1),
            (25_600.0, 2048.0, 5),
            (1e4 / 3, 100.0, 13),
        ],
    )
    def test_the_reduced_rate_is_whole_where_it_can_be(self, rate: float, highest: float, factor: int) -> None:
        assert reduction(rate, highest) == factor
        assert factor == 1 or rate / factor >= 2.5 * highest

    def test_records_that_cannot_be_reduced_are_read_as_they_are(self, tmp_path: Path) -> None:
        path, channels = mat_file(tmp_path, 300)
        for highest in (1500.0, 30.0):  # rate too low; record shorter than the filter
            xr.testing.assert_identical(read_reduced(path, channels, highest)[0], read_records(path, channels)[0])

    def test_faults(self, tmp_path: Path) -> None:
        path, channels = mat_file(tmp_path, 300)
        with pytest.raises(InputError, match="it must be positive"):
            read_reduced(path, channels, 0.0)
        with pytest.raises(InputError, match="a tacho cannot be read at a lower sample rate"):
            read_reduced(path, channels | {"tacho": Channel("Fx")}, 100.0)


_PEAK = """
import sys
from smfe.records import Channel, read_reduced
def peak():  # of this process alone; ru_maxrss would begin with that of the process that started it
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
before = peak()
channels = {"time": Channel(sample_rate=51200.0)} | {f"force_{a}": Channel(f"F{a}", "N") for a in "xyz"}
record = read_reduced(sys.argv[1], channels, 400.0)[0]
print(peak() - before, record.sizes["time"])
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the peak of memory is read from /proc")
def test_ten_times_the_record_needs_no_more_memory(tmp_path: Path) -> None:
    peaks = []
    for seconds in (10, 100):
        path = tmp_path / f"{seconds}.h5"
        with h5py.File(path, "w") as file:
            rng = np.random.default_rng(0)
            for axis in "xyz":
                data = file.create_dataset(f"F{axis}", (seconds * 51200,), np.float32, chunks=(51200,))
                for second in range(seconds):
                    data[second * 51200 : (second + 1) * 51200] = rng.standard_normal(51200, np.float32)
        done = subprocess.run(
            [sys.executable, "-c", _PEAK, str(path)], capture_output=True, text=True, check=True, timeout=300
        )
        peak, size = map(int, done.stdout.split())
        assert size == pytest.approx(seconds * 1024, abs=40)
        peaks.append(peak)
    # The reduced record itself grows by 90 s of 4 channels of 8 bytes: 3 MB, and as much while it is put together.
    assert peaks[1] - peaks[0] < 20_000, f"kB more than before reading: {peaks}"
    whole = 100 * 51200 * 3 * 8 / 1024
    assert peaks[1] < 0.5 * whole


def test_csv_of_long_records_goes_piece_by_piece(tmp_path: Path) -> None:
    record = a_record(5000)
    path = write_record_csv(record, tmp_path / "r.csv", digits=17)
    channels = record_columns(record)
    (whole,) = read_records(path, channels)
    xr.testing.assert_equal(together(path, channels, 700), whole)
