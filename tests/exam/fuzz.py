"""Damaged files of every format, by the hundred thousand: what becomes of them, and what it costs.

Run ``python -m exam.fuzz docs/fuzz_table.md [--inputs 1000000] [--minutes 60]`` from ``tests`` (``make fuzz``): each
format in its turn, from the seed where the last sitting stopped, as it stands in ``fuzz_state.json``. A file that ended
this process is counted by the next sitting, which begins behind it.
"""

import argparse
import json
import os
import resource
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

from samples.damage import CHANGED, ENDED, KINDS, NOTED, REFUSED, SAME, damaged, judged, make

from smfe.records import read_records
from smfe.records.formats import reader

BATCH = 1000
"""Inputs of one format in a row."""

PATIENCE = 300
"""Seconds until a file counts as a hang on a machine that others use too; the slowest stands in the table."""

FINE = (SAME, REFUSED, NOTED, CHANGED, ENDED)

REDUNDANCY = {
    "csv": "none: text",
    "parquet": "lengths; no checksum as pandas writes it",
    "nc": "superblock (HDF5); none for samples",
    "h5": "superblock; none for samples",
    "mat": "packed: checksum of each variable",
    "mat_struct": "lengths; none for samples",
    "mat73": "superblock (HDF5); none for samples",
    "tdms": "lengths of segments; none for samples",
    "uff": "counts; none for samples",
    "uff_text": "counts; none: text",
    "wav": "counts, byte rate; none for samples",
    "npy": "length; none for samples",
    "npz": "packed: checksum of each array",
    "npy_list": "lengths; none for samples",
    "xml": "counts; none: text",
    "lvm": "counts; none: text",
    "json": "counter of cycles; none: text",
    "log": "none: text",
    "dat_twincat": "even times; none: text",
}
"""Format -> what it says twice."""


def memory() -> float:
    """Largest memory of the process that reads [MB]."""
    for process in reader._running:
        try:
            lines = Path(f"/proc/{process.process.pid}/status").read_text().splitlines()
        except OSError:
            continue
        return max((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM")), default=0.0)
    return 0.0


def sit(state: dict[str, Any], keep: Path, inputs: int, until: float) -> None:
    """Go on until so many inputs of all formats are done, or the time is up."""
    for told in state.values():
        if (seed := told.pop("doing", None)) is not None:  # it was never told what became of it
            told["faults"][str(seed)] = "crash of the main process"
            told["next"] = seed + 1
    each = -(-inputs // len(KINDS))
    with tempfile.TemporaryDirectory() as folder:
        originals = {}
        for kind in KINDS:
            place = Path(folder) / kind
            place.mkdir()
            path, channels = make(kind, place)
            originals[kind] = path, channels, path.read_bytes(), read_records(path, channels)
        while time.time() < until and any(state[kind]["next"] < each for kind in KINDS):
            for kind in KINDS:
                told, (path, channels, whole, record) = state[kind], originals[kind]
                counts = Counter(told["counts"])
                for process in reader._running[:]:  # one for each format: whose memory is it
                    process.end()
                reader._running.clear()
                for seed in range(told["next"], min(told["next"] + BATCH, each)):
                    content = damaged(whole, seed)
                    path.write_bytes(content)
                    if seed % 50 == 0:
                        keep.write_text(json.dumps(state | {kind: told | {"doing": seed, "counts": dict(counts)}}))
                    start = time.perf_counter()
                    found = judged(path, channels, record, PATIENCE)
                    told["slowest"] = max(told["slowest"], time.perf_counter() - start)
                    told["memory"] = max(told["memory"], memory())
                    counts[found if found in FINE else "fault"] += 1
                    if found not in FINE:
                        told["faults"][str(seed)] = found
                    told["next"] = seed + 1
                    told["counts"] = dict(counts)
                told["main"] = max(told["main"], resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
                temporary = keep.with_suffix(".part")
                temporary.write_text(json.dumps(state))
                os.replace(temporary, keep)


def table(state: dict[str, Any]) -> str:
    """Return the state as a table."""
    lines = [
        "| format | inputs | crashes | tracebacks | hangs | other faults | reader ended | refused | as before "
        "| other, with a note | silent changes | slowest [s] | largest memory [MB]: reader | main "
        "| what the format says twice |",
        "|" + 15 * "---|",
    ]
    total: Counter[str] = Counter()
    for kind, told in state.items():
        counts, faults = Counter(told["counts"]), list(told["faults"].values())
        row = Counter(
            {
                "inputs": told["next"],
                "crashes": sum(f.startswith("crash") for f in faults),
                "tracebacks": sum(f.startswith("traceback") for f in faults),
                "hangs": sum(f.startswith("hang") for f in faults),
            }
        )
        row["others"] = len(faults) - row["crashes"] - row["tracebacks"] - row["hangs"]
        row |= {name: counts[name] for name in (ENDED, REFUSED, SAME, NOTED, CHANGED)}
        total.update(row)
        cells = [f"{row[name]:,}" for name in COLUMNS]
        cells += [f"{told['slowest']:.1f}", f"{told['memory']:.0f}", f"{told['main']:.0f}", REDUNDANCY[kind]]
        lines.append(f"| {kind} | " + " | ".join(cells) + " |")
    ends = [
        f"{max(t['slowest'] for t in state.values()):.1f}",
        f"{max(t['memory'] for t in state.values()):.0f}",
        f"{max(t['main'] for t in state.values()):.0f}",
        "",
    ]
    lines.append("| **all** | " + " | ".join([f"{total[name]:,}" for name in COLUMNS] + ends) + " |")
    return "\n".join(lines) + "\n"


COLUMNS = ("inputs", "crashes", "tracebacks", "hangs", "others", ENDED, REFUSED, SAME, NOTED, CHANGED)


def main() -> None:
    """Sit, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("table", type=Path)
    parser.add_argument("--inputs", type=int, default=1_000_000, help="of all formats together")
    parser.add_argument("--minutes", type=float, default=1e9)
    parser.add_argument("--state", type=Path, default=Path("fuzz_state.json"))
    asked = parser.parse_args()
    state = {k: {"next": 0, "counts": {}, "faults": {}, "slowest": 0.0, "memory": 0.0, "main": 0.0} for k in KINDS}
    if asked.state.is_file():
        state |= json.loads(asked.state.read_text())
    reader.SECONDS = 4.0  # less than the alarm, four times over
    sit(state, asked.state, asked.inputs, time.time() + 60.0 * asked.minutes)
    asked.table.write_text(table(state), encoding="utf-8")
    for kind, told in state.items():
        for seed, fault in list(told["faults"].items())[:20]:
            print(f"{kind} {seed}: {fault}")


if __name__ == "__main__":
    main()
