"""Long records at a lower sample rate: seconds, and memory that does not grow with the record.

Seven channels at 51.2 kHz in single precision, random numbers (seed 0), reduced for a band up to 400 Hz. Each file is
read in a process of its own, whose largest resident memory is compared with that before reading.
"""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest
from nptdms import ChannelObject, RootObject, TdmsWriter
from numpy.typing import NDArray

RATE = 51_200
NAMES = ("Fx", "Fy", "Fz", "ax", "ay", "az", "angle")

_READ = """
import sys, time
from smfe.records import Channel, read_records, read_reduced
columns = {f"force_{a}": ("F" + a, "N") for a in "xyz"} | {f"acceleration_{a}": ("a" + a, "g") for a in "xyz"}
columns["spindle_angle"] = ("angle", "rad")
channels = {name: Channel(column, unit) for name, (column, unit) in columns.items()}
channels["time"] = Channel(sample_rate=51200.0)
def peak():  # of this process alone; ru_maxrss would begin with that of the process that started it
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
before = peak()
start = time.perf_counter()
whole = sys.argv[2] == "whole"
(record,) = read_records(sys.argv[1], channels) if whole else read_reduced(sys.argv[1], channels, 400.0)
seconds = time.perf_counter() - start
print(seconds, (peak() - before) / 1024, record.sizes["time"])
"""


def pieces(seconds: int) -> Iterator[NDArray[np.float32]]:
    rng = np.random.default_rng(0)
    for _ in range(seconds):
        yield rng.standard_normal((len(NAMES), RATE), np.float32)


def hdf5(path: Path, seconds: int) -> None:
    with h5py.File(path, "w") as file:
        sets = [file.create_dataset(n, (seconds * RATE,), np.float32, chunks=(RATE,)) for n in NAMES]
        for second, piece in enumerate(pieces(seconds)):
            for data, row in zip(sets, piece, strict=True):
                data[second * RATE : (second + 1) * RATE] = row


def tdms(path: Path, seconds: int) -> None:
    with TdmsWriter(path) as writer:
        for piece in pieces(seconds):
            channels = [ChannelObject("DAQ", n, row) for n, row in zip(NAMES, piece, strict=True)]
            writer.write_segment([RootObject(), *channels])


def parquet(path: Path, seconds: int) -> None:
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet as pq

    schema = pa.schema([(n, pa.float32()) for n in NAMES])
    with pq.ParquetWriter(path, schema) as writer:
        for piece in pieces(seconds):
            writer.write_table(pa.table(list(piece), schema=schema))


def csv(path: Path, seconds: int) -> None:
    with path.open("w") as stream:
        stream.write(",".join(NAMES) + "\n")
        for piece in pieces(seconds):
            np.savetxt(stream, piece.T, "%.6g", ",")


def read(path: Path, how: str) -> tuple[float, float, int]:
    """Return seconds, MB more than before, and samples."""
    done = subprocess.run([sys.executable, "-c", _READ, str(path), how], capture_output=True, text=True, check=True)
    seconds, megabytes, size = map(float, done.stdout.split())
    return seconds, megabytes, int(size)


@pytest.mark.benchmark(group="reading")
@pytest.mark.parametrize(
    ("write", "short", "long"), [(hdf5, 60, 600), (tdms, 60, 600), (parquet, 20, 200), (csv, 4, 40)]
)
def test_memory_does_not_grow_with_the_record(  # type: ignore[no-untyped-def]
    benchmark, tmp_path: Path, write: Callable[[Path, int], None], short: int, long: int
) -> None:
    found = {}
    for seconds in (short, long):
        path = tmp_path / f"{seconds}.{'h5' if write is hdf5 else write.__name__}"
        write(path, seconds)
        if seconds == short:
            _, whole, _ = read(path, "whole")
            found[seconds] = read(path, "reduced")
        else:
            found[seconds] = benchmark.pedantic(read, args=(path, "reduced"), rounds=1)
        path.unlink()
    time_short, memory_short, _ = found[short]
    time_long, memory_long, size = found[long]
    # What is returned grows with the record: 8 bytes a sample of 7 channels and the time, twice while it is labelled.
    returned = 2 * 8 * 8 * size / 2**20
    assert memory_long < memory_short + returned + 40.0, "read whole it would be gigabytes"
    benchmark.extra_info.update(
        megabytes_short=round(memory_short), megabytes_long=round(memory_long), seconds_short=round(time_short, 1)
    )
    print(
        f"\n{write.__name__}: {short} s in {time_short:.1f} s and {memory_short:.0f} MB (read whole: {whole:.0f} MB), "
        f"{long} s in {time_long:.1f} s and {memory_long:.0f} MB"
    )
