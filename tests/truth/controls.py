"""Traces as machine controls write them, from plain columns; shares no code with the package."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[np.float64]]


def write_halscope(
    path: Path, columns: Columns, step: float, named: bool = True, decimal: str = ".", unit: str = "nSec"
) -> None:
    """Write a trace of LinuxCNC's halscope: with a line of names, or in the older form of pairs.

    The older form loops once too often: its last row lies beyond the buffer and holds anything.
    """
    rows = zip(*columns.values(), strict=True)
    period = round(1e9 * step)
    if named:
        comments = f"# Position: {';'.join(['0.500000'] * len(columns))}\n# Scale: {';'.join(['0'] * len(columns))}\n"
        body = "".join(";".join(f"{v:.14f}" for v in row) + "\n" for row in rows)
        path.write_text(f"# Sampling period is {period} ns\n{';'.join(columns)}\n{comments}{body}")
        return
    pairs = [[*zip(columns, row, strict=True)] for row in [*rows, (12345.0,) * len(columns)]]
    texts = [[f"{name} {f'{v:+.14f}'.replace('.', decimal)} " for name, v in row] for row in pairs]
    path.write_text(f"Sampling period is {period} {unit} \n" + "".join("\n" + "".join(row) for row in texts))


def write_twincat(
    path: Path,
    columns: Columns,
    step: float,
    delimiter: str = "\t",
    decimal: str = ",",
    shared: bool = True,
    units: Mapping[str, str] | None = None,
    slow: Columns | None = None,
    end: str = "",
) -> None:
    """Write an export of TwinCAT Scope: times in ms before each group of channels, or before each channel.

    `slow` are channels of five times the sample time: columns that end earlier.
    """
    groups = [[(n, v, step)] for n, v in columns.items()]
    if shared:
        groups = [[(n, v, step) for n, v in columns.items()]]
    groups += [[(n, v, 5.0 * step)] for n, v in (slow or {}).items()]
    given = units or {}

    def line(key: str, texts: list[list[str]]) -> str:
        return delimiter.join(field for group in texts for field in (key, *group)) + "\n"

    text = f"Name{delimiter}scope\nFile{delimiter}C:\\scope.csv\n"
    text += f"Starttime of export{delimiter}132959733843760000\nEndtime of export{delimiter}132959733853750000\n\n\n"
    text += line("Name", [[n for n, _, _ in g] for g in groups])
    text += line("Data-Type", [["REAL64"] * len(g) for g in groups])
    text += line("SampleTime[ms]", [[f"{1e3 * dt:g}".replace(".", decimal) for _, _, dt in g] for g in groups])
    text += line("Unit", [[given.get(n, "(None)") for n, _, _ in g] for g in groups]) + "\n"
    size = max(v.size for g in groups for _, v, _ in g)
    for k in range(size):
        fields = []
        for group in groups:
            there = k < group[0][1].size
            fields.append(f"{1e3 * k * group[0][2]:.6f}" if there else " ")
            fields += [f"{float(v[k])!r}" if there else " " for _, v, _ in group]
        text += delimiter.join(fields).replace(".", decimal) + "\n"
    path.write_text(text + end, encoding="utf-8-sig")


def write_capture(path: Path, columns: Columns, step: float, lost: tuple[int, ...] = (), first: int = 5558098) -> None:
    """Write a capture of Sinumerik Edge: messages of some cycles, events between them; cycles `lost` are not there."""
    signals = [{"Name": n, "Type": "DOUBLE", "Axis": n, "Address": n} for n in ("CYCLE", *columns)]
    size = next(iter(columns.values())).size
    rows = [[first + k, *(float(v[k]) for v in columns.values())] for k in range(size) if k not in lost]
    messages: list[dict[str, object]] = []
    for begin in range(0, len(rows), 7):
        messages.append({"HFData": rows[begin : begin + 7]})
        messages.append({"HFBlockEvent": {"HFProbeCounter": first + begin, "GCode": "G1"}})
    header = {"SignalListHFData": signals, "SignalListLFData": [], "CycleTimeMs": 1e3 * step}
    path.write_text(json.dumps({"Header": header, "Payload": messages, "Footer": {"ErrorMessages": []}}))
