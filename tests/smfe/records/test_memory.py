"""What reading a long file keeps in memory, and files that are too large for it."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import io

from process.errors import InputError
from process.labels import make_record
from smfe.records import Channel, read_blocks, read_records, uff_columns, write_record_uff
from smfe.records.blocks import streams
from smfe.records.formats import reader
from smfe.records.formats import table as memory
from smfe.records.formats.mat import plain_variables

RATE = 51200.0


def samples(size: int) -> np.ndarray:
    return np.random.default_rng(0).standard_normal((3, size)).round(6)


def lvm(folder: Path, size: int) -> tuple[Path, dict[str, Channel]]:
    """Two segments, a decimal comma, a comment at the end of some rows; the second segment is short."""
    text = "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\tNo\n***End_of_Header***\t\n"
    for count in (size, 40):
        text += (
            f"\t\nChannels\t3\nSamples\t{count}\t{count}\t{count}\nX0\t0\t0\t0\nDelta_X" + 3 * "\t1,953125E-5" + "\n"
        )
        text += "***End_of_Header***\t\nX_Value\tFx\tax\tay\tComment\n"
        for k, row in enumerate(samples(count).T):
            text += "\t" + "\t".join(f"{v:.6f}".replace(".", ",") for v in row) + ("\thit" if k % 7 == 0 else "") + "\n"
    path = folder / "r.lvm"
    path.write_text(text, encoding="utf-8")
    return path, {
        "force_x": Channel("Fx", "N"),
        "acceleration_x": Channel("ax", "m/s^2"),
        "acceleration_y": Channel("ay", "m/s^2"),
    }


def uff(folder: Path, size: int) -> tuple[Path, dict[str, Channel]]:
    force, x, y = samples(size)
    channels = {"force": {"x": force}, "acceleration": {"x": x, "y": y}}
    record = make_record(np.arange(size) / RATE, channels)
    return write_record_uff(record, folder / "r.uff"), uff_columns(record)


def mat(folder: Path, size: int, packed: bool = False) -> tuple[Path, dict[str, Channel]]:
    """A vector down, one across, and a matrix of which the second column is wanted."""
    force, x, y = samples(size)
    content = {"Fx": force[:, None], "ax": x, "both": np.column_stack([x, y])}
    io.savemat(folder / "r.mat", content, do_compression=packed)
    channels = {"force_x": Channel("Fx", "N"), "acceleration_x": Channel("ax", "m/s^2")}
    channels |= {"acceleration_y": Channel("both(:,2)", "m/s^2"), "time": Channel(sample_rate=RATE)}
    return folder / "r.mat", channels


def mat_packed(folder: Path, size: int) -> tuple[Path, dict[str, Channel]]:
    return mat(folder, size, packed=True)


@pytest.mark.parametrize("make", [mat, mat_packed])
def test_a_matlab_file_in_blocks_is_what_was_written(
    tmp_path: Path, make: Callable[[Path, int], tuple[Path, dict[str, Channel]]]
) -> None:
    path, channels = make(tmp_path, 10_000)
    assert plain_variables(path) is not None  # it is streamed
    pieces = list(read_blocks(path, channels, 999))
    force, x, y = samples(10_000)
    for parts in (pieces, read_records(path, channels)):
        np.testing.assert_array_equal(np.concatenate([p["force"].values[0] for p in parts]), force)
        np.testing.assert_array_equal(np.concatenate([p["acceleration"].values for p in parts], axis=1), [x, y])


@pytest.mark.parametrize("kind", [np.float32, np.int16, np.uint8, np.int64, bool])
def test_every_kind_of_number_is_streamed_as_scipy_reads_it(tmp_path: Path, kind: type) -> None:
    values = (50.0 * np.abs(samples(3000)[0])).astype(kind)
    io.savemat(tmp_path / "r.mat", {"F": values, "i": 1j * values}, do_compression=True)
    assert plain_variables(tmp_path / "r.mat") is None  # complex numbers are left to scipy
    io.savemat(tmp_path / "r.mat", {"F": values}, do_compression=True)
    (record,) = read_records(tmp_path / "r.mat", {"force_x": Channel("F", "N"), "time": Channel(sample_rate=RATE)})
    np.testing.assert_array_equal(record["force"].values[0], io.loadmat(tmp_path / "r.mat")["F"].ravel().astype(float))


def test_an_lvm_file_in_blocks_is_what_was_written(tmp_path: Path) -> None:
    path, channels = lvm(tmp_path, 1000)
    first, second = read_records(path, channels)
    for record, size in ((first, 1000), (second, 40)):
        force, x, y = samples(size)
        np.testing.assert_array_equal(record["force"].values[0], force)
        np.testing.assert_array_equal(record["acceleration"].values, [x, y])
        assert float(record["time"][1]) == pytest.approx(1.0 / RATE)
    with pytest.raises(InputError, match="has 2 segments"):
        read_blocks(path, channels)


@pytest.mark.parametrize("make", [pytest.param(lvm, marks=pytest.mark.slow), uff, mat, mat_packed])
def test_memory_of_blocks_does_not_grow_with_the_file(
    tmp_path: Path, make: Callable[[Path, int], tuple[Path, dict[str, Channel]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten times the samples, blocks of 2000: the peak of what is allocated grows by less than a tenth of the record.

    Read in this process, whose memory is seen here.
    """
    monkeypatch.setattr(reader, "_running", [])
    monkeypatch.setattr(reader, "_dead", ["read here"])
    peaks = {}
    for size in (6000, 60000):
        path, channels = make(tmp_path, size)
        for warm in (True, False):
            tracemalloc.start()
            count = sum(block["time"].size for block in streams(path, channels, 2000)[0].blocks)
            peaks[size] = tracemalloc.get_traced_memory()[1]
            tracemalloc.stop()
            assert count == size or warm
    assert peaks[60000] - peaks[6000] < 0.1 * 60000 * 4 * 8


def test_what_is_read_whole_is_refused_where_the_memory_does_not_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """100 000 free bytes: a file of 80 000 that is read whole needs 280 000; in pieces it needs none of that."""
    t, x = np.arange(5000) / RATE, np.ones(5000)
    io.savemat(tmp_path / "r.mat", {"t": t, "Fx": x}, format="4")
    np.save(tmp_path / "r.npy", np.column_stack([t, x]))
    columns = {"r.mat": ("t", "Fx"), "r.npy": ("[:,0]", "[:,1]")}
    monkeypatch.setattr(memory, "available", lambda: 1e5)
    for name, (time, force) in columns.items():
        with pytest.raises(
            InputError, match=rf"{name}: a file of this format is read whole; 8\S* GB need about .* free"
        ):
            read_records(tmp_path / name, {"time": Channel(time, "s"), "force_x": Channel(force, "N")})
    path, channels = uff(tmp_path, 5000)
    assert read_records(path, channels)[0].sizes["time"] == 5000
    monkeypatch.setattr(memory, "available", lambda: None)
    for name, (time, force) in columns.items():
        read_records(tmp_path / name, {"time": Channel(time, "s"), "force_x": Channel(force, "N")})


def test_the_free_memory_is_a_sensible_number() -> None:
    free = memory.available()
    assert free is None or 1e6 < free < 1e15
