"""Claims about the process that reads files: whatever becomes of it is a sentence, and the next file is read."""

import gzip
import io
import os
import pickle
import struct
import sys
import time
import zipfile
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
from samples import hostile
from scipy import io as scipy_io

from process.errors import InputError
from smfe.records import Channel, read_blocks, read_records
from smfe.records.formats import reader
from smfe.records.formats.reader import apart

CHANNELS = {"time": Channel(sample_rate=1000.0), "force_x": Channel("Fx", "N")}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    pd.DataFrame({"Fx": np.arange(100.0)}).to_csv(tmp_path / "r.csv", index=False)
    return tmp_path / "r.csv"


def process() -> int:
    (running,) = reader._running
    return running.process.pid


class TestWhatBecomesOfIt:
    def test_numbers_come_back_as_they_are(self, path: Path) -> None:
        back, expected = apart(hostile.several)(path), hostile.several(path)
        for found, there in zip(back, expected, strict=True):
            assert type(found) is type(there)
            if isinstance(there, np.ndarray):
                assert (found.dtype, found.shape) == (there.dtype, there.shape)
                np.testing.assert_array_equal(found, there)
            else:
                assert found == there

    def test_one_process_reads_all_files(self, path: Path) -> None:
        read_records(path, CHANNELS)
        before = process()
        assert before != os.getpid()
        read_records(path, CHANNELS)
        assert process() == before

    @pytest.mark.parametrize(
        ("function", "said"),
        [
            (
                hostile.breaks_down,
                r"r\.csv: cannot be read: the library .* breaks down \(SIGABRT\); the file is damaged",
            ),
            (
                hostile.never_returns,
                r"r\.csv: cannot be read: the library .* does not come back within 0\.3 s; the file",
            ),
        ],
    )
    def test_the_next_file_is_read_by_a_new_one(
        self, path: Path, function: object, said: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        read_records(path, CHANNELS)
        before = process()
        monkeypatch.setattr(reader, "SECONDS", 0.3)
        with pytest.raises(InputError, match=said):
            apart(function)(path)
        monkeypatch.undo()
        assert read_records(path, CHANNELS)[0].sizes["time"] == 100
        assert process() != before

    def test_memory_has_a_limit(self, path: Path) -> None:
        before = read_records(path, CHANNELS), process()
        with pytest.raises(InputError, match=r"r\.csv: reading it takes more memory than a file of \S+ MB is given"):
            apart(hostile.asks_for_memory)(path)
        assert process() == before[1]

    def test_so_has_what_a_file_unpacks_to(self, path: Path) -> None:
        """64 MB and 128 times the file: 10 million numbers of a file of half a kilobyte are too many, 5 are not."""
        assert apart(hostile.unpacks)(path, 5_000_000).size == 5_000_000
        with pytest.raises(InputError, match=r"r\.csv: \S+ MB that unpack to 80 MB of numbers; .* at most 67.2 MB are"):
            apart(hostile.unpacks)(path, 10_000_000)

    def test_what_a_library_prints_is_no_answer(self, path: Path, capfd: pytest.CaptureFixture[str]) -> None:
        assert apart(hostile.writes_to_the_terminal)(path) == "read"
        assert capfd.readouterr() == ("", "")

    def test_any_exception_is_a_sentence(self, path: Path) -> None:
        with pytest.raises(InputError, match=r"^r\.csv: cannot be read \(an exception of two lines\); the file is"):
            apart(hostile.raises)(path)

    def test_several_iterators_at_a_time(self, path: Path) -> None:
        a, b = apart(hostile.counts)(path, 3), apart(hostile.counts)(path, 4)
        assert list(zip(a, b, strict=False)) == [(0, 0), (1, 1), (2, 2)]
        assert list(b) == [3]

    def test_what_was_being_read_when_it_ended_says_so(self, path: Path) -> None:
        pieces = read_blocks(path, CHANNELS, 10)
        next(pieces)
        with pytest.raises(InputError):
            apart(hostile.breaks_down)(path)
        with pytest.raises(InputError, match=r"r\.csv: the process that was reading it has been ended; read it again"):
            list(pieces)

    @pytest.mark.parametrize("how", ["no interpreter", "another program"])
    def test_where_no_process_can_be_started_files_are_read_here(
        self, path: Path, tmp_path: Path, how: str, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """A frozen program has no interpreter to start, or one that is something else."""
        silent = tmp_path / "silent.py"
        silent.write_text("")
        monkeypatch.setattr(reader, "_running", [])
        monkeypatch.setattr(reader, "_dead", [])
        if how == "no interpreter":
            monkeypatch.setattr(sys, "executable", "/nowhere/python")
        else:
            monkeypatch.setattr(reader, "_SCRIPT", silent)
        assert read_records(path, CHANNELS)[0].sizes["time"] == 100
        assert len(reader._dead) == 1


# --- files that ask for far more than they are ------------------------------------------------------------------------


def gzipped_hdf5(folder: Path) -> tuple[Path, str]:
    """1.9 GB of zeros in 1.9 MB."""
    with h5py.File(folder / "r.h5", "w") as file:
        data = file.create_dataset("Fx", (240_000_000,), "f8", chunks=(4_000_000,), compression="gzip", fillvalue=0.0)
        packed = gzip.zlib.compress(bytes(8 * 4_000_000), 9)
        for chunk in range(60):
            data.id.write_direct_chunk((4_000_000 * chunk,), packed)
    return folder / "r.h5", "Fx"


def packed_numpy(folder: Path) -> tuple[Path, str]:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (150_000_000,)})
    with zipfile.ZipFile(folder / "r.npz", "w", zipfile.ZIP_DEFLATED) as archive, archive.open("Fx.npy", "w") as member:
        member.write(head.getvalue())
        for _ in range(150):
            member.write(bytes(8_000_000))
    return folder / "r.npz", "Fx"


def _element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def packed_matlab(folder: Path) -> tuple[Path, str]:
    """A structure whose field is a packed matrix of zeros: read whole, or not at all."""
    size = 100_000_000
    name = _element(1, b"d")
    inner = _element(6, struct.pack("<II", 6, 0)) + _element(5, struct.pack("<ii", size, 1)) + _element(1, b"")
    packer = gzip.zlib.compressobj(9)
    field = struct.pack("<II", 14, len(inner) + 8 + 8 * size) + inner + struct.pack("<II", 9, 8 * size)
    head = _element(6, struct.pack("<II", 2, 0)) + _element(5, struct.pack("<ii", 1, 1)) + name
    head += struct.pack("<HHi", 5, 4, 8) + _element(1, b"Fx".ljust(8, b"\0"))
    out = [packer.compress(struct.pack("<II", 14, len(head) + len(field) + 8 * size) + head + field)]
    out += [packer.compress(bytes(8_000_000)) for _ in range(size // 1_000_000)]
    content = b"".join([*out, packer.flush()])
    (folder / "r.mat").write_bytes(
        b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 15, len(content)) + content
    )
    return folder / "r.mat", "d.Fx"


def constant_parquet(folder: Path) -> tuple[Path, str]:
    pd.DataFrame({"Fx": np.zeros(30_000_000)}).to_parquet(folder / "r.parquet")
    return folder / "r.parquet", "Fx"


def peak() -> Iterator[float]:
    """Yield the largest memory of the process that reads so far [GB]."""
    while True:
        lines = Path(f"/proc/{process()}/status").read_text().splitlines()
        yield next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e9


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are those of Linux")
@pytest.mark.slow
@pytest.mark.parametrize("make", [gzipped_hdf5, packed_numpy, packed_matlab, constant_parquet])
def test_a_bomb_is_a_sentence_and_costs_less_than_a_gigabyte(tmp_path: Path, make: object) -> None:
    """Less than 3 MB that unpack to 0.2 to 1.9 GB."""
    path, column = make(tmp_path)
    assert path.stat().st_size < 3e6
    for running in reader._running[:]:
        running.end()
    reader._running.clear()
    start = time.perf_counter()
    channels = {"time": Channel(sample_rate=1000.0), "force_x": Channel(column, "N")}
    with pytest.raises(InputError, match=rf"{path.name}: (reading it takes more memory|\S+ MB that unpack to)"):
        read_records(path, channels)
    assert next(peak()) < 1.0
    assert time.perf_counter() - start < 60.0


def test_a_pickle_of_a_few_bytes_gets_no_memory(tmp_path: Path) -> None:
    """Python's own unpickler makes a table of as many entries as a number in the file says: 2 GB for 138 bytes."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|O", "fortran_order": False, "shape": (2,)})
    huge = b"\x80\x02]r" + struct.pack("<I", 1 << 27) + b"."
    assert pickle.loads(b"\x80\x02]r" + struct.pack("<I", 1) + b".") == []
    (tmp_path / "r.npy").write_bytes(b"\x93NUMPY\x01\x00" + head.getvalue()[8:] + huge)
    with pytest.raises(InputError, match=r"r\.npy: "):
        read_records(tmp_path / "r.npy", {"time": Channel(sample_rate=1.0), "force_x": Channel("[0]", "N")})


# --- samples that stand in other files --------------------------------------------------------------------------------


def external_storage(file: h5py.File, secret: Path) -> None:
    file.create_dataset("Fx", (10,), "u1", external=[(str(secret), 0, 10)])


def external_link(file: h5py.File, secret: Path) -> None:
    file["Fx"] = h5py.ExternalLink(str(secret), "/Fx")


def link_in_a_group(file: h5py.File, secret: Path) -> None:
    file.create_group("a/b")["c"] = h5py.ExternalLink(str(secret), "/")


def virtual(file: h5py.File, secret: Path) -> None:
    layout = h5py.VirtualLayout((10,), "f8")
    layout[:] = h5py.VirtualSource(str(secret), "Fx", (10,))
    file.create_virtual_dataset("Fx", layout)


@pytest.mark.parametrize("suffix", [".h5", ".nc", ".mat"])
@pytest.mark.parametrize("make", [external_storage, external_link, link_in_a_group, virtual])
def test_no_file_lends_its_samples_to_another(tmp_path: Path, make: object, suffix: str) -> None:
    secret = tmp_path / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["Fx"] = np.arange(10.0)
    path = tmp_path / f"r{suffix}"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = np.arange(10.0)
        make(file, secret)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file")
    for channels in (CHANNELS, {"time": Channel("t", "s"), "force_x": Channel("t", "N")}):
        with pytest.raises(InputError, match=rf"r\{suffix}: '[^']*' stands in another file, '.*secret\.h5'; only what"):
            read_records(path, channels)


def test_a_virtual_data_set_of_the_file_itself_is_read(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "r.h5", "w") as file:
        file["raw"] = np.arange(20.0)
        layout = h5py.VirtualLayout((10,), "f8")
        layout[:] = h5py.VirtualSource(".", "raw", (20,))[::2]
        file.create_virtual_dataset("Fx", layout)
    (record,) = read_records(tmp_path / "r.h5", CHANNELS)
    np.testing.assert_array_equal(record["force"].values[0], np.arange(0.0, 20.0, 2.0))


def test_a_matlab_file_that_ends_its_reader_is_a_sentence(tmp_path: Path) -> None:
    """Every byte of a small structure changed in turn: scipy's compiled reader must not take this process with it."""
    scipy_io.savemat(tmp_path / "r.mat", {"d": {"Fx": np.arange(4.0), "c": "abc"}})
    whole = (tmp_path / "r.mat").read_bytes()
    channels = {"time": Channel(sample_rate=1000.0), "force_x": Channel("d.Fx", "N")}
    read = 0
    for at in range(128, len(whole), 4):
        broken = bytearray(whole)
        broken[at] ^= 1 << at % 7
        (tmp_path / "r.mat").write_bytes(broken)
        with suppress(InputError):
            read_records(tmp_path / "r.mat", channels)
            read += 1
    assert read > 0
