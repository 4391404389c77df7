"""Damaged files of every format: the right record or one sentence; never a traceback, a hang or a huge allocation.

What cannot be found out: a flipped bit among the samples of a format without checksums gives another number there, and
in the names of channels another name. Text that ends with a whole row is no other than a shorter record.

On what makes the HDF5 library itself run on for ever, see test_hdf5_damage.py.
"""

import re
import resource
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from samples.damage import (
    CHANGED,
    CLOCK,
    ENDED,
    FORCE,
    KINDS,
    NOTED,
    REFUSED,
    SAME,
    Hang,
    alarm,
    damaged,
    judged,
    make,
)
from samples.reading import fault_of_reading
from scipy import io

from process.errors import InputError
from smfe.records import FORMATS, Channel, read_blocks, read_records
from smfe.records.formats import reader
from smfe.records.formats.table import damaged as sentence_of_damage

LIMIT = 20  # seconds a file may take


@contextmanager
def guarded() -> Iterator[None]:
    """End what takes longer than the limit, and let nothing allocate more than 4 GB."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    if (statm := Path("/proc/self/statm")).exists():
        used = int(statm.read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + (4 << 30), hard))
    try:
        with alarm(LIMIT):
            yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


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
    def test_a_thousand_damaged_files(self, originals: Originals, kind: str) -> None:
        """None of them a traceback, a hang or a record that is none; a million: `make fuzz`, docs/fuzz_table.md."""
        path, channels, whole = originals[kind]
        path.write_bytes(whole)
        record = read_records(path, channels)
        wrong = {}
        for seed in range(1000):
            path.write_bytes(damaged(whole, seed))
            if (found := judged(path, channels, record)) not in (SAME, REFUSED, NOTED, CHANGED, ENDED):
                wrong[seed] = found
        assert not wrong

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


def test_the_alarm_is_not_taken_for_an_error_of_the_file(tmp_path: Path) -> None:
    """Readers turn every Exception into a sentence; a TimeoutError was one, and a hang passed for a refusal."""

    def reading() -> None:
        with sentence_of_damage(tmp_path / "r.mat", "a MATLAB file"):
            while True:
                pass

    with pytest.raises(Hang, match="more than 1 s"), alarm(1):
        reading()


class TestWhatAFormatSaysTwice:
    """A number that contradicts another of the same file is found out, though the samples are as they were."""

    def wav(self, folder: Path) -> tuple[Path, bytearray]:
        path, self.channels = make("wav", folder)
        return path, bytearray(path.read_bytes())

    @pytest.mark.parametrize(
        ("at", "said"),
        [
            (24, r"8192 bytes a frame|\d+ bytes a second and \d+ bytes of samples do not fit together"),  # rate
            (28, r"bytes a second and \d+ bytes of samples do not fit together"),
            (32, r"bytes a frame, .* do not fit together"),
            (4, r"its header says that it ends after \d+ bytes, and its samples after \d+|where its header says"),
        ],
    )
    def test_of_a_wav_file(self, tmp_path: Path, at: int, said: str) -> None:
        path, content = self.wav(tmp_path)
        content[at] ^= 16
        path.write_bytes(content)
        try:
            (record,) = read_records(path, self.channels)
        except InputError as error:
            text = str(error)
        else:
            text = record.attrs["notes"]
        assert re.search(said, text), text

    def test_samples_that_the_header_counts(self, tmp_path: Path) -> None:
        path, content = self.wav(tmp_path)
        content[content.index(b"fact") + 8] ^= 1
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"r\.wav: 256 samples a channel where its header counts 257; the file is"):
            read_records(path, self.channels)

    def test_channels_and_rows_of_labview(self, tmp_path: Path) -> None:
        path, channels = make("lvm", tmp_path)
        whole = path.read_text()
        path.write_text(whole.replace("Channels\t2", "Channels\t3"))
        with pytest.raises(InputError, match=r"r\.lvm, segment 0: 2 channels are named where its header counts 3"):
            read_records(path, channels)
        path.write_text(whole.replace("Samples\t256\t256", "Samples\t206\t206"))
        (record,) = read_records(path, channels)
        assert record.attrs["notes"] == "r.lvm, segment 0: 256 rows where its header states 206; all are read"

    def test_bytes_of_a_binary_universal_file(self, tmp_path: Path) -> None:
        path, channels = make("uff", tmp_path)
        path.write_bytes(path.read_bytes().replace(b"2048", b"2049"))
        (record,) = read_records(path, channels)
        assert "a dataset 58 counts 2049 bytes where its values have 2048" in record.attrs["notes"]

    @pytest.mark.parametrize("kind", ["h5", "nc", "mat73"])
    def test_the_end_of_an_hdf5_file(self, tmp_path: Path, kind: str) -> None:
        path, channels = make(kind, tmp_path)
        assert "notes" not in read_records(path, channels)[0].attrs
        size = path.stat().st_size
        with path.open("ab") as stream:
            stream.write(b"more")
        (record,) = read_records(path, channels)
        assert f"{path.name}: {size + 4} bytes where its superblock says {size}" in record.attrs["notes"]
