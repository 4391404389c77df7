"""One short record in every format, damaged, and what becomes of it."""

import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import xarray as xr
from nptdms import ChannelObject, RootObject, TdmsWriter
from scipy import io
from scipy.io import wavfile
from truth.controls import write_capture, write_halscope, write_twincat

from process.errors import InputError
from process.labels import make_record
from samples.reading import fault_of_record, fault_of_refusal
from smfe.records import (
    Channel,
    read_records,
    write_record_csv,
    write_record_mat,
    write_record_netcdf,
    write_record_uff,
)
from smfe.records.formats.controls.sinumerik import DIGITS

N, RATE = 256, 2000.0
CLOCK = {"time": Channel("t", "s")}
FORCE = {"force_x": Channel("Fx", "N"), "acceleration_x": Channel("ax", "m/s^2")}
KINDS = [
    "csv",
    "parquet",
    "nc",
    "h5",
    "mat",
    "mat_struct",
    "mat73",
    "tdms",
    "uff",
    "uff_text",
    "wav",
    "npy",
    "npz",
    "npy_list",
    "xml",
    "lvm",
    "json",
    "log",
    "dat_twincat",
]


CONTROLS = {
    "json": write_capture,
    "log": partial(write_halscope, named=False),
    "dat_twincat": write_twincat,
}


def make(kind: str, folder: Path) -> tuple[Path, dict[str, Channel]]:
    """Write a short record in a format; return it with its channels."""
    rng = np.random.default_rng(5)
    t = np.arange(N) / RATE
    record = make_record(t, {"force": {"x": rng.standard_normal(N)}, "acceleration": {"x": rng.standard_normal(N)}})
    columns = {"t": t, "Fx": record["force"].values[0], "ax": record["acceleration"].values[0]}
    path = folder / f"r.{kind.split('_')[0].removesuffix('73')}"
    if kind in CONTROLS:
        CONTROLS[kind](path, {"Fx": record["force"].values[0], "ax": record["acceleration"].values[0]}, 1.0 / RATE)
        return path, FORCE
    if kind in ("csv", "nc", "mat"):
        write = {"csv": write_record_csv, "nc": write_record_netcdf, "mat": write_record_mat}[kind]
        return write(record, path), CLOCK | FORCE
    if kind == "mat_struct":
        io.savemat(path, {"d": columns, "text": "abc"})
        return path, {name: replace(channel, column=f"d.{channel.column}") for name, channel in (CLOCK | FORCE).items()}
    if kind == "parquet":
        pd.DataFrame(columns).to_parquet(path)
    elif kind in ("npy", "npz", "npy_list", "xml", "lvm"):
        return path, {"xml": _trace, "lvm": _labview}.get(kind, partial(_numpy_file, kind))(path, columns)
    elif kind in ("h5", "mat73"):
        with h5py.File(path, "w", userblock_size=512 if kind == "mat73" else 0) as file:
            for name, values in columns.items():
                file[name] = values[None, :] if kind == "mat73" else values
        if kind == "mat73":
            with path.open("r+b") as stream:
                stream.write(b"MATLAB 7.3 MAT-file")
    elif kind == "tdms":
        with TdmsWriter(path) as writer:
            writer.write_segment([RootObject(), *(ChannelObject("g", n, v) for n, v in columns.items())])
    elif kind == "wav":
        wavfile.write(path, int(RATE), np.column_stack([columns["Fx"], columns["ax"]]))
        return path, {"force_x": Channel(1, "N"), "acceleration_x": Channel(2, "m/s^2")}
    else:
        write_record_uff(record, path)
        if kind == "uff_text":
            _as_text(path)
        return path, {"force_x": Channel("1:+X", "N"), "acceleration_x": Channel("2:+X", "m/s^2")}
    return path, CLOCK | FORCE


def _numpy_file(kind: str, path: Path, columns: dict[str, np.ndarray]) -> dict[str, Channel]:
    names = list(columns)
    if kind == "npz":
        np.savez_compressed(path, **columns)
    elif kind == "npy":
        np.save(path, np.column_stack(list(columns.values())))
        names = ["[:,0]", "[:,1]", "[:,2]"]
    else:
        several = np.empty(3, dtype=object)
        several[:] = list(columns.values())
        np.save(path, several)
        names = ["[0]", "[1]", "[2]"]
    return {
        "time": Channel(names[0], "s"),
        "force_x": Channel(names[1], "N"),
        "acceleration_x": Channel(names[2], "m/s^2"),
    }


def _labview(path: Path, columns: dict[str, np.ndarray]) -> dict[str, Channel]:
    head = "LabVIEW Measurement\t\nSeparator\tTab\nX_Columns\tNo\n***End_of_Header***\t\n\t\nChannels\t2\n"
    head += f"Samples\t{N}\t{N}\nX0\t0\t0\nDelta_X\t{1.0 / RATE}\t{1.0 / RATE}\n***End_of_Header***\t\n"
    rows = zip(columns["Fx"].tolist(), columns["ax"].tolist(), strict=True)
    path.write_text(head + "X_Value\tFx\tax\n" + "".join(f"\t{a!r}\t{b!r}\n" for a, b in rows))
    return FORCE


def _trace(path: Path, columns: dict[str, np.ndarray]) -> dict[str, Channel]:
    """A measurement of a control: arrays of doubles to the base 85."""
    nodes = ""
    for name in ("Fx", "ax"):
        words = columns[name].astype(">f8").view(">u4").tolist()
        raw = "".join(DIGITS[word // 85**k % 85] for word in words for k in range(4, -1, -1))
        raw = "\n".join(raw[k : k + 150] for k in range(0, len(raw), 150))
        nodes += (
            f'<PlatformSignalNode><unsigned_int name="m_uNodeId">{name}</unsigned_int><TimeSeries>'
            f'<NumericArray elementtype="double" format="base85"><unsigned_int name="m_length">{N}</unsigned_int>'
            f"<raw><![CDATA[{raw}]]></raw></NumericArray>"
            f'<float name="m_TimeVector.start">0</float><float name="m_TimeVector.end">{(N - 1) / RATE}</float>'
            "</TimeSeries></PlatformSignalNode>\n"
        )
    path.write_text(f"<ResponseTestCustom>{nodes}</ResponseTestCustom>\n")
    return FORCE


def _as_text(path: Path) -> None:
    import pyuff

    sets = pyuff.UFF(str(path)).read_sets()
    path.unlink()
    pyuff.UFF(str(path)).write_sets([s | {"binary": 0} for s in sets], "add")


class Hang(BaseException):
    """A file took too long; no reader can take it for an error of the file, as it does every Exception."""


@contextmanager
def alarm(seconds: int) -> Iterator[None]:
    """End what takes longer."""

    def late(*_: object) -> None:
        raise Hang(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def damaged(whole: bytes, seed: int) -> bytes:
    """Return a file with one to six faults: bits, bytes, huge and odd numbers, pieces lost, doubled and exchanged."""
    rng = np.random.default_rng(seed)
    out = bytearray(whole)
    for _ in range(rng.integers(1, 7) if rng.random() < 0.5 else 1):
        if not out:
            break
        # Headers and footers are at the ends; most of a file is samples.
        at = int(min(rng.exponential(len(out) / 6), len(out) - 1))
        at = len(out) - 1 - at if rng.random() < 0.3 else int(rng.integers(len(out))) if rng.random() < 0.2 else at
        size = int(min(rng.geometric(0.02), len(out) - at))
        match int(rng.choice(8, p=[0.35, 0.2, 0.15, 0.06, 0.06, 0.06, 0.06, 0.06])):
            case 0:
                out[at] ^= 1 << int(rng.integers(8))
            case 1:
                out[at] = int(rng.integers(256))
            case 2:
                out[at : at + 4] = _ODD[int(rng.integers(len(_ODD)))]
            case 3:
                del out[at : at + size]
            case 4:
                out[at:at] = out[at : at + size]
            case 5:
                other = int(rng.integers(len(out)))
                out[at : at + size], out[other : other + size] = out[other : other + size], out[at : at + size]
            case 6:
                out[at : at + size] = rng.bytes(size) if rng.random() < 0.5 else bytes(size)
            case 7:
                del out[at if rng.random() < 0.5 else len(out) - size :]
    return bytes(out)


_ODD = [
    b"\xff\xff\xff\x7f",
    b"\xff\xff\xff\xff",
    b"\0\0\0\0",
    b"\0\0\0\x80",
    b"\0\0\xf0\x7f",
    b"9999",
    b"1e99",
    b"nan ",
    b"\x1b[2J",
]


SAME, REFUSED, NOTED, CHANGED, ENDED = "same", "refused", "noted", "changed", "ended"
"""What may become of a damaged file: the record, a sentence, another record with or without a note, a new process."""


def judged(path: Path, channels: Mapping[str, Channel], whole: list[xr.Dataset], seconds: int = 20) -> str:
    """Return one of these, or what is wrong: a traceback, a record that is none, a refusal that is none, a hang."""
    try:
        with alarm(seconds):
            records = read_records(path, dict(channels))
    except InputError as error:
        return fault_of_refusal(str(error), path) or (ENDED if "breaks down" in str(error) else REFUSED)
    except Hang as late:
        return f"hang: {late}"
    except Exception as error:  # a traceback of any kind is the fault that is looked for
        return f"traceback: {type(error).__name__}: {error}"
    if fault := next((fault for record in records if (fault := fault_of_record(record))), ""):
        return f"no record: {fault}"
    if len(records) == len(whole) and all(a.equals(b) for a, b in zip(records, whole, strict=True)):
        return SAME
    return NOTED if any(record.attrs.get("notes") for record in records) else CHANGED
