"""Peak memory of a sweep identified from long records: ``python benchmarks/scripts/long_record_memory.py 0.1 10``.

For each size [GB] three passes of seven channels in double precision at 51.2 kHz are written (deleted afterwards; they
need as much free disk), then identified by a process of its own as a sweep in the band from 20 to 80 Hz: header,
blocks, low-pass, decimation, estimate. Printed is by how much the largest resident memory of that process exceeds what
it was after passes of 10 s had been identified, so that libraries and compiled code do not count. With
``--what blocks`` the first pass is read through in blocks instead (as `smfe convert` does) and nothing is kept.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
from nptdms import ChannelObject, RootObject, TdmsWriter
from scipy import signal

from process.types import Real

RATE = 51_200
NAMES = ("Fx", "Fy", "Fz", "ax", "ay", "az", "n")
BYTES_A_SECOND = RATE * len(NAMES) * 8
CAMPAIGN = """
[campaign]
name = "Long record"
[tool]
diameter = "100 mm"
teeth = 4
[channels]
time = { sample_rate = "51200 Hz" }
force_x = { column = "Fx", unit = "N" }
force_y = { column = "Fy", unit = "N" }
force_z = { column = "Fz", unit = "N" }
acceleration_x = { column = "ax", unit = "m/s^2" }
acceleration_y = { column = "ay", unit = "m/s^2" }
acceleration_z = { column = "az", unit = "m/s^2" }
spindle_speed = { column = "n", unit = "rpm" }
"""
MEASUREMENT = """
[[measurement]]
name = "{name}"
method = "sweep"
frequency_range = ["20 Hz", "80 Hz"]
records = [
    {{ file = "{name}_0.{kind}", cut = "down", width_of_cut = "40 mm" }},
    {{ file = "{name}_1.{kind}", cut = "up", width_of_cut = "40 mm" }},
    {{ file = "{name}_2.{kind}", cut = "central", width_of_cut = "100 mm" }},
]
"""

_IDENTIFY = """
import sys, time
from smfe.campaign import load_campaign
from smfe.identification.measurement import identify_measurement
from smfe.records import read_blocks
def peak():  # of this process alone; ru_maxrss would begin with that of the process that started it
    return next(int(line.split()[1]) for line in open("/proc/self/status") if line.startswith("VmHWM"))
def read_through(campaign, measurement):
    entry = measurement.records[0]
    return sum(piece.sizes["time"] for piece in read_blocks(entry.files[0], entry.channels))
campaign = load_campaign(sys.argv[1])
short, long = campaign.measurements
if sys.argv[2] == "blocks":
    identify_measurement = read_through
identify_measurement(campaign, short)
before = peak()
start = time.perf_counter()
identify_measurement(campaign, long)
print(time.perf_counter() - start, (peak() - before) / 1024, before / 1024)
"""


def pieces(seconds: int, axis: int) -> Iterator[Real]:
    """Yield a second at a time: a random force along one axis, what a mode at 50 Hz answers, and noise elsewhere."""
    rng = np.random.default_rng(axis)
    poles = np.exp((-0.03 + 1j) * 2.0 * np.pi * 50.0 / RATE)
    b, a = [1.0, -2.0, 1.0], np.poly([poles, np.conj(poles)])
    noise, state = rng.standard_normal((len(NAMES), RATE)), np.zeros(2)
    for second in range(seconds):
        noise[axis] = 100.0 * rng.standard_normal(RATE)
        answer, state = signal.lfilter(b, a, noise[axis], zi=state)
        noise[3 + axis] = 0.1 * answer
        noise[6] = 600.0 + 600.0 * second / seconds
        yield noise


def hdf5(path: Path, seconds: int, axis: int) -> None:
    with h5py.File(path, "w") as file:
        sets = [file.create_dataset(n, (seconds * RATE,), float, chunks=(RATE,)) for n in NAMES]
        for second, piece in enumerate(pieces(seconds, axis)):
            for data, row in zip(sets, piece, strict=True):
                data[second * RATE : (second + 1) * RATE] = row


def tdms(path: Path, seconds: int, axis: int) -> None:
    with TdmsWriter(path) as writer:
        for piece in pieces(seconds, axis):
            channels = [ChannelObject("DAQ", n, row) for n, row in zip(NAMES, piece, strict=True)]
            writer.write_segment([RootObject(), *channels])


WRITE = {"h5": hdf5, "tdms": tdms}


def measure(folder: Path, kind: str, gigabytes: float, what: str) -> None:
    seconds = max(20, round(gigabytes * 1e9 / BYTES_A_SECOND / 3))
    written, campaign = [], folder / "campaign.toml"
    try:
        for name, length in (("short", 10), ("long", seconds)):
            for axis in range(3):
                written.append(folder / f"{name}_{axis}.{kind}")
                WRITE[kind](written[-1], length, axis)
        text = "".join(MEASUREMENT.format(name=name, kind=kind) for name in ("short", "long"))
        campaign.write_text(CAMPAIGN + text, encoding="utf-8")
        size = sum(path.stat().st_size for path in written[3:]) / 1e9
        command = [sys.executable, "-c", _IDENTIFY, str(campaign), what]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        spent, more, before = (float(word) for word in done.stdout.split())
        print(
            f"{kind}, {what}: {size:.2f} GB, 3 passes of {seconds} s: {more:.0f} MB more than the {before:.0f} MB "
            f"before, in {spent:.0f} s",
            flush=True,
        )
    finally:
        for path in (*written, campaign):
            path.unlink(missing_ok=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("gigabytes", type=float, nargs="+")
    parser.add_argument("--format", choices=sorted(WRITE), default="h5")
    parser.add_argument("--what", choices=("sweep", "blocks"), default="sweep")
    parser.add_argument("--folder", type=Path, default=Path("long_record"))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for gigabytes in given.gigabytes:
        start = time.perf_counter()
        measure(given.folder, given.format, gigabytes, given.what)
        print(f"  written, read and deleted in {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main()
