"""Damaged files of every format: the right record or one sentence; never a traceback, a hang or a huge allocation.

What cannot be found out: a flipped bit among the samples of a format without checksums gives another number there, and
in the names of channels another name. Text that ends with a whole row is no other than a shorter record.

On what makes the HDF5 library itself run on for ever, see test_records_hdf5_damage.py.
"""

import resource
import signal as signals
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from nptdms import ChannelObject, RootObject, TdmsWriter
from samples.reading import fault_of_reading
from scipy import io
from scipy.io import wavfile
from truth.controls import write_capture, write_halscope, write_twincat

from process.errors import InputError
from process.labels import make_record
from smfe.records import (
    FORMATS,
    Channel,
    read_blocks,
    read_records,
    write_record_csv,
    write_record_mat,
    write_record_netcdf,
    write_record_uff,
)
from smfe.records.formats import reader
from smfe.records.formats.controls.sinumerik import DIGITS

N, RATE = 256, 2000.0
CLOCK = {"time": Channel("t", "s")}
FORCE = {"force_x": Channel("Fx", "N"), "acceleration_x": Channel("ax", "m/s^2")}
LIMIT = 5  # seconds a file may take
KINDS = [
    "csv",
    "parquet",
    "nc",
    "h5",
    "mat",
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


@contextmanager
def guarded() -> Iterator[None]:
    """End what takes longer than the limit, and let nothing allocate more than 4 GB."""

    def late(*_: object) -> None:
        raise TimeoutError(f"more than {LIMIT} s")

    before = signals.signal(signals.SIGALRM, late)
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    if (statm := Path("/proc/self/statm")).exists():
        used = int(statm.read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + (4 << 30), hard))
    signals.alarm(LIMIT)
    try:
        yield
    finally:
        signals.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signals.signal(signals.SIGALRM, before)


def _a_sentence(text: str, path: Path) -> str:
    assert path.name in text
    assert "\n" not in text
    return text


def said(path: Path, channels: dict[str, Channel]) -> str:
    """Return the sentence with which a file is refused, empty when it is read; read in blocks it is the same."""
    with guarded():
        try:
            records = read_records(path, channels)
        except InputError as error:
            return _a_sentence(str(error), path)
        if len(records) > 1:  # a damaged name or step made another segment
            return "segments"
        (record,) = records
        sizes = [piece.sizes["time"] for piece in read_blocks(path, channels, 100)]
        assert sum(sizes) == record.sizes["time"]
    return ""


def fault(path: Path, channels: dict[str, Channel]) -> str:
    """Return what is wrong with what becomes of a damaged file; a single record read in blocks has the same size."""
    with guarded():
        if found := fault_of_reading(path, channels):
            return found
        try:
            whole = read_records(path, channels)
        except InputError:
            return ""
        sizes = [piece.sizes["time"] for piece in read_blocks(path, channels, 100)] if len(whole) == 1 else []
    return "" if len(whole) > 1 or sum(sizes) == whole[0].sizes["time"] else f"blocks of {sizes} samples"


@pytest.fixture(autouse=True, scope="module")
def patience() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reader, "SECONDS", 2.0)
        yield


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, dict[str, Channel], bytes]]:
    found = {}
    for kind in KINDS:
        path, channels = make(kind, tmp_path_factory.mktemp(kind))
        found[kind] = path, channels, path.read_bytes()
    return found


Originals = dict[str, tuple[Path, dict[str, Channel], bytes]]


def assert_declared(originals: Originals, kind: str, data: st.DataObject) -> None:
    """Declare the channels in another order, force_x with another sign, scale and unit; read whole and in blocks."""
    path, channels, whole = originals[kind]
    path.write_bytes(whole)
    (plain,) = read_records(path, channels)
    order = data.draw(st.permutations(sorted(channels)))
    sign = data.draw(st.sampled_from((1.0, -1.0)))
    scale = data.draw(st.sampled_from((1.0, 0.5, 4.0)))
    unit, factor = data.draw(st.sampled_from((("N", 1.0), ("kN", 1000.0))))
    if kind == "nc":
        unit, factor = "N", 1.0  # our own layout states its units itself
    changed = {name: channels[name] for name in order}
    changed["force_x"] = replace(channels["force_x"], sign=sign, scale=scale, unit=unit)
    pieces = list(read_blocks(path, changed, data.draw(st.integers(60, 300))))
    for (record,) in (
        read_records(path, changed),
        [xr.concat(pieces, "time", data_vars="minimal", coords="minimal")],
    ):
        np.testing.assert_allclose(record["force"], sign * scale * factor * plain["force"], rtol=1e-15)
        np.testing.assert_array_equal(record["acceleration"], plain["acceleration"])
        np.testing.assert_array_equal(record["time"], plain["time"])


@pytest.mark.parametrize("kind", KINDS)
class TestDeclarations:
    @given(st.data())
    @settings(max_examples=2, deadline=None)
    def test_order_signs_units_and_scales_change_nothing_but_what_they_should(
        self, originals: Originals, kind: str, data: st.DataObject
    ) -> None:
        assert_declared(originals, kind, data)

    @pytest.mark.slow
    @given(st.data())
    @settings(max_examples=12, deadline=None)
    def test_many_orders_signs_units_and_scales(self, originals: Originals, kind: str, data: st.DataObject) -> None:
        assert_declared(originals, kind, data)


@pytest.mark.parametrize("kind", KINDS)
class TestDamage:
    def test_whole(self, originals: Originals, kind: str) -> None:
        path, channels, whole = originals[kind]
        path.write_bytes(whole)
        assert said(path, channels) == ""

    def test_empty(self, originals: Originals, kind: str) -> None:
        path, channels, _ = originals[kind]
        path.write_bytes(b"")
        assert said(path, channels) == f"{path.name}: the file is empty"

    def test_truncated(self, originals: Originals, kind: str) -> None:
        path, channels, whole = originals[kind]
        for size in np.unique(np.linspace(1, len(whole.rstrip()) - 1, 15, dtype=int)):
            path.write_bytes(whole[:size])
            # Half of the last number of a text is a number.
            unseen = kind in ("csv", "dat_twincat") or (kind == "lvm" and size > len(whole) - 20)
            assert said(path, channels) or unseen, f"{size} of {len(whole)} bytes"

    @given(st.data())
    @settings(max_examples=4, deadline=None, derandomize=True)
    def test_flipped_bits(self, originals: Originals, kind: str, data: st.DataObject) -> None:
        path, channels, whole = originals[kind]
        broken = bytearray(whole)
        # Most of a file is samples: half of the hits go to its ends, where headers and footers are.
        edge = min(len(whole), 1200)
        place = st.one_of(
            st.integers(0, len(whole) - 1), st.integers(0, edge - 1), st.integers(len(whole) - edge, len(whole) - 1)
        )
        for at in data.draw(st.lists(place, min_size=1, max_size=4)):
            broken[at] ^= 1 << data.draw(st.integers(0, 7))
        path.write_bytes(bytes(broken))
        assert fault(path, channels) == ""

    @pytest.mark.slow
    def test_many_flipped_bits(self, originals: Originals, kind: str) -> None:
        path, channels, whole = originals[kind]
        rng = np.random.default_rng(99)
        for _ in range(300):
            broken = np.frombuffer(whole, np.uint8).copy()
            at = np.minimum(rng.exponential(len(whole) / 6, rng.integers(1, 5)).astype(int), len(whole) - 1)
            if rng.random() < 0.5:  # from the end
                at = len(whole) - 1 - at
            broken[at] ^= (1 << rng.integers(0, 8, at.size)).astype(np.uint8)
            path.write_bytes(broken.tobytes())
            assert fault(path, channels) == ""

    @pytest.mark.parametrize("step", [200, pytest.param(50, marks=pytest.mark.slow)])
    def test_headers_that_state_huge_numbers(self, originals: Originals, kind: str, step: int) -> None:
        path, channels, whole = originals[kind]
        for at in range(0, min(len(whole), 1500), step):
            path.write_bytes(whole[:at] + b"\xff\xff\xff\x7f" + whole[at + 4 :])
            assert fault(path, channels) == ""


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.binary(max_size=300), st.sampled_from(sorted(FORMATS)))
def test_any_bytes_under_any_suffix(tmp_path_factory: pytest.TempPathFactory, content: bytes, suffix: str) -> None:
    path = tmp_path_factory.getbasetemp() / f"any{suffix}"
    magic = {
        ".tdms": b"TDSm",
        ".wav": b"RIFF",
        ".uff": b"    -1\n    58\n",
        ".parquet": b"PAR1",
        ".h5": b"\x89HDF\r\n\x1a\n",
    }
    for text in (content, magic.get(suffix, b"") + content):
        path.write_bytes(text)
        assert fault(path, CLOCK | FORCE) == ""


def test_a_structure_of_matlab_is_no_channel_itself(tmp_path: Path) -> None:
    io.savemat(tmp_path / "r.mat", {"t": np.arange(4.0), "Fx": {"Data": np.ones(4)}})
    with pytest.raises(InputError, match=r"no column 'Fx'"):
        read_records(tmp_path / "r.mat", {"time": Channel("t", "s"), "force_x": Channel("Fx", "N")})
