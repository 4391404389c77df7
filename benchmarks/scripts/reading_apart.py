"""What it costs to read files in a process of their own: CPU seconds of both processes, against reading them here.

Run ``python benchmarks/scripts/reading_apart.py [SAMPLES]``: a table of the least of seven rounds each, in turns, of a
record with three channels; and what starting the process costs, once.
"""

import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
from nptdms import ChannelObject, RootObject, TdmsWriter
from scipy import io
from scipy.io import wavfile

from process.labels import make_record
from smfe.records import Channel, read_blocks, read_records, uff_columns, write_record_netcdf, write_record_uff
from smfe.records.formats import reader

ROUNDS = 7
RATE = 51200.0


def files(folder: Path, size: int) -> dict[str, tuple[Path, dict[str, Channel]]]:
    """Write one record in every format; text shorter, since it takes longer."""
    t = np.arange(size) / RATE
    force, x = np.random.default_rng(0).standard_normal((2, size))
    named = {"time": Channel("t", "s"), "force_x": Channel("Fx", "N"), "acceleration_x": Channel("ax", "m/s^2")}
    columns = {"t": t, "Fx": force, "ax": x}
    record = make_record(t, {"force": {"x": force}, "acceleration": {"x": x}})
    few = size // 10
    pd.DataFrame({n: v[:few] for n, v in columns.items()}).to_csv(folder / "r.csv", index=False)
    head = "LabVIEW Measurement\t\nSeparator\tTab\nX_Columns\tNo\n***End_of_Header***\t\n\t\nChannels\t2\n"
    head += f"Samples\t{few}\t{few}\nX0\t0\t0\nDelta_X\t{1.0 / RATE}\t{1.0 / RATE}\n***End_of_Header***\t\n"
    rows = "".join(f"\t{a!r}\t{b!r}\n" for a, b in zip(force[:few].tolist(), x[:few].tolist(), strict=True))
    (folder / "r.lvm").write_text(head + "X_Value\tFx\tax\n" + rows)
    pd.DataFrame(columns).to_parquet(folder / "r.parquet")
    write_record_netcdf(record, folder / "r.nc")
    with h5py.File(folder / "r.h5", "w") as file:
        for name, values in columns.items():
            file[name] = values
    io.savemat(folder / "r.mat", columns)
    io.savemat(folder / "packed.mat", columns, do_compression=True)
    io.savemat(folder / "struct.mat", {"d": columns})
    np.save(folder / "r.npy", np.column_stack([t, force, x]))
    np.savez(folder / "r.npz", **columns)
    wavfile.write(folder / "r.wav", int(RATE), np.column_stack([force, x]))
    with TdmsWriter(folder / "r.tdms") as writer:
        writer.write_segment([RootObject(), *(ChannelObject("g", n, v) for n, v in columns.items())])
    write_record_uff(record, folder / "r.uff")
    other = {
        "r.npy": ("[:,0]", "[:,1]", "[:,2]"),
        "struct.mat": ("d.t", "d.Fx", "d.ax"),
        "r.wav": (None, 1, 2),
        "r.lvm": (None, "Fx", "ax"),
    }
    found = {}
    for path in sorted(folder.iterdir()):
        channels = named
        if path.name in other:
            time_, *rest = other[path.name]
            channels = {"force_x": Channel(rest[0], "N"), "acceleration_x": Channel(rest[1], "m/s^2")}
            channels |= {} if time_ is None else {"time": Channel(time_, "s")}
        found[path.name] = path, uff_columns(record) if path.suffix == ".uff" else channels
    return found


def cpu() -> float:
    """CPU seconds of this process and of the one that reads."""
    own = resource.getrusage(resource.RUSAGE_SELF)
    spent = own.ru_utime + own.ru_stime
    for process in reader._running:
        # Hundredths of a second: records must be long enough.
        fields = Path(f"/proc/{process.process.pid}/stat").read_text().rpartition(")")[2].split()
        spent += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return spent


def spent(read: Callable[[], object], apart: bool, times: int) -> float:
    reader._dead[:] = [] if apart else ["measured here"]
    running = reader._running[:]
    if not apart:
        reader._running.clear()
    read()  # what has lain idle is fetched first
    before = cpu()
    for _ in range(times):
        read()
    after = cpu()
    reader._running[:] = running
    return (after - before) / times


def main(size: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        found = files(Path(folder), size)
        start = time.perf_counter(), cpu()
        read_records(*found["r.csv"])
        print(f"started, and read one text: {time.perf_counter() - start[0]:.2f} s, {cpu() - start[1]:.2f} s of CPU")
        print(
            "| file | MB | whole, here [s] | apart | | in blocks, here [s] | apart | |",
            "|---|---|---|---|---|---|---|---|",
            sep="\n",
        )
        for name, (path, channels) in found.items():
            ways = {
                "whole": lambda p=path, c=channels: read_records(p, c),
                "blocks": lambda p=path, c=channels: sum(1 for _ in read_blocks(p, c)),
            }
            cells = []
            for read in ways.values():
                best = {True: np.inf, False: np.inf}
                for apart in best:
                    spent(read, apart, 1)
                times = max(1, round(0.7 / spent(read, False, 1)))
                for _ in range(ROUNDS):
                    for apart in best:
                        best[apart] = min(best[apart], spent(read, apart, times))
                cells += [f"{best[False]:.4f}", f"{best[True]:.4f}", f"{100 * (best[True] / best[False] - 1):+.1f} %"]
            print("|", " | ".join([name, f"{path.stat().st_size / 1e6:.1f}", *cells]), "|", flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
