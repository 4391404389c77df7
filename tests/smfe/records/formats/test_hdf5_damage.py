"""Damaged HDF5 files on which the library itself does not come back, or dies: a sentence, in time.

Everything that may hang is read in a process of its own, which is ended when it does.
"""

import json
import os
import queue
import subprocess
import sys
import threading
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from process.errors import InputError
from process.labels import make_record
from smfe.records import Channel, write_record_netcdf
from smfe.records.formats import reader as guard
from smfe.records.formats.hdf5 import walk
from smfe.records.formats.reader import apart
from smfe.results import read_groups

KINDS = ["nc", "h5", "mat73"]
LIMIT = 60.0  # seconds a file may take, the limit of the watch and the start of its process included

READER = """
import json, sys, warnings
from pathlib import Path
from process.errors import InputError
from smfe.records import Channel, read_blocks, read_records
from smfe.records.formats import reader as guard

guard.SECONDS = 2.0
clock = {"time": Channel("t", "s"), "force_x": Channel("Fx", "N"), "acceleration_x": Channel("ax", "m/s^2")}
print("ready", flush=True)
for line in sys.stdin:
    path = Path(json.loads(line))
    try:
        (record,) = read_records(path, clock)
        sizes = sum(piece.sizes["time"] for piece in read_blocks(path, clock, 100))
        answer = "read" if sizes == record.sizes["time"] else f"{sizes} samples in blocks, not {record.sizes['time']}"
    except InputError as error:
        answer = f"said {error}"
    except BaseException as error:
        answer = f"{type(error).__name__}: {error}"
    print(json.dumps(answer), flush=True)
"""


CHANNELS = {"time": Channel("t", "s"), "force_x": Channel("Fx", "N"), "acceleration_x": Channel("ax", "m/s^2")}


def make(kind: str, folder: Path) -> Path:
    """Write a short record."""
    rng = np.random.default_rng(5)
    t, force, acceleration = np.arange(256) / 2000.0, rng.standard_normal(256), rng.standard_normal(256)
    path = folder / f"r.{kind.removesuffix('73')}"
    if kind == "nc":
        return write_record_netcdf(make_record(t, {"force": {"x": force}, "acceleration": {"x": acceleration}}), path)
    with h5py.File(path, "w", userblock_size=512 if kind == "mat73" else 0) as file:
        for name, values in (("t", t), ("Fx", force), ("ax", acceleration)):
            file[name] = values[None, :] if kind == "mat73" else values
    if kind == "mat73":
        with path.open("r+b") as stream:
            stream.write(b"MATLAB 7.3 MAT-file")
    return path


class Reader:
    """A process that reads files, and is ended when it takes too long."""

    def __init__(self) -> None:
        path = os.pathsep.join([*(p for p in sys.path if p)])
        self.process = subprocess.Popen(
            [sys.executable, "-c", READER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env={**os.environ, "PYTHONPATH": path},
        )
        self.answers: queue.SimpleQueue[str] = queue.SimpleQueue()
        threading.Thread(target=self.listen, daemon=True).start()
        assert self.answers.get(timeout=60.0) == "ready\n"

    def listen(self) -> None:
        for line in self.process.stdout:
            self.answers.put(line)
        self.answers.put("")

    def read(self, path: Path) -> str:
        self.process.stdin.write(json.dumps(str(path)) + "\n")
        self.process.stdin.flush()
        answer = self.answers.get(timeout=LIMIT)
        return json.loads(answer) if answer else "died"

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self.process.stdin.close()
        self.process.stdout.close()


@pytest.fixture(scope="module")
def reader():
    found = Reader()
    yield found
    found.end()


def damaged(whole: bytes, seed: int) -> bytes:
    """Some bytes near one of the ends changed, a bit each or altogether; now and then the end cut off."""
    rng = np.random.default_rng(seed)
    out = np.frombuffer(whole, np.uint8).copy()
    count = rng.integers(1, 6)
    at = np.minimum(rng.exponential(len(whole) / 6, count).astype(int), len(whole) - 1)
    if rng.random() < 0.3:
        at = len(whole) - 1 - at
    if rng.random() < 0.5:
        out[at] ^= (1 << rng.integers(0, 8, count)).astype(np.uint8)
    else:
        out[at] = rng.integers(0, 256, count)
    return out.tobytes()[: len(whole) if rng.random() < 0.9 else rng.integers(0, len(whole))]


def judge(answer: str, path: Path) -> str:
    """Return what is wrong with an answer, nothing when it is a record or a sentence with the file's name."""
    if answer == "read" or (answer.startswith("said ") and path.name in answer and "\n" not in answer):
        return ""
    return answer


def hanging(path: Path) -> Path:
    """Damage a NetCDF file so that the library loops: a text in its heap that is longer than the heap.

    After "GCOL", a version and a size, 16 bytes in all, come the texts, each with 16 bytes of its own in front; the
    last 8 of these are its length.
    """
    content = bytearray(path.read_bytes())
    heap = content.index(b"GCOL")
    content[heap + 16 + 8 + 1] = 8  # one byte of text becomes 2049
    path.write_bytes(content)
    return path


def test_a_file_on_which_the_library_loops_ends_with_a_sentence(tmp_path: Path, reader: Reader) -> None:
    path = make("nc", tmp_path)
    assert reader.read(hanging(path)) == (
        "said r.nc: cannot be read: the library that reads such files does not come back within 2.01 s; the file is "
        "damaged: copy or export it again"
    )
    assert reader.read(make("nc", tmp_path)) == "read"  # and the next file is read, by a new process


def test_what_it_costs_does_not_depend_on_the_samples(tmp_path: Path) -> None:
    """80 MB in 200 pieces against 8 kB: both within 50 ms of a process that runs."""
    spent = {}
    for name, size in (("small", 1000), ("large", 10_000_000)):
        with h5py.File(tmp_path / f"{name}.h5", "w") as file:
            file.create_dataset("x", (size,), float, chunks=(min(size, 50_000),), data=np.zeros(size))
        apart(walk)(tmp_path / f"{name}.h5")
        start = time.perf_counter()
        apart(walk)(tmp_path / f"{name}.h5")
        spent[name] = time.perf_counter() - start
    assert max(spent.values()) < 0.05


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "seeds", [range(12), pytest.param(range(12, 250), marks=pytest.mark.slow)], ids=["few", "many"]
)
def test_every_damaged_file_is_read_or_refused_in_time(tmp_path: Path, reader: Reader, kind: str, seeds: range) -> None:
    path = make(kind, tmp_path)
    whole, wrong = path.read_bytes(), {}
    for content in (b"", whole[:7], whole[:-1], whole[: len(whole) // 2], bytes(len(whole))):
        path.write_bytes(content)
        assert reader.read(path).startswith("said "), f"{len(content)} bytes"
    for seed in seeds:
        path.write_bytes(damaged(whole, seed))
        said = judge(reader.read(path), path)
        if said:
            wrong[seed] = said
    assert not wrong


def test_damaged_results_end_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`smfe compare` and `smfe report` read what an earlier run wrote."""
    monkeypatch.setattr(guard, "SECONDS", 1.0)
    path = make("nc", tmp_path).rename(tmp_path / "frf.nc")
    assert read_groups(path)
    hanging(path)
    with pytest.raises(InputError, match=r"does not come back within 1\.\d+ s"):
        read_groups(path)
