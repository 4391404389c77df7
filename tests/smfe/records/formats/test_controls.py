"""Claims about traces of machine controls: what the control recorded comes back, whatever locale and layout."""

from pathlib import Path

import numpy as np
import pytest
from samples.reading import fault_of_reading
from truth.controls import write_capture, write_halscope, write_twincat

import smfe
from process.errors import InputError
from smfe.records import Channel, read_records
from smfe.records.contents import contents

PINS = {"joint.0.motor-pos-cmd": "reference_position_x", "joint.0.motor-pos-fb": "encoder_position_x"}


def draw(seed: int) -> tuple[np.random.Generator, dict[str, np.ndarray], float]:
    rng = np.random.default_rng(seed)
    size, step = int(rng.integers(20, 300)), float(rng.choice([2e-4, 1e-3, 2e-3, 4e-3]))
    return rng, {pin: np.round(rng.standard_normal(size), 9) for pin in PINS}, step


def channels(unit: str) -> dict[str, Channel]:
    return {channel: Channel(pin, unit) for pin, channel in PINS.items()}


def check(path: Path, columns: dict[str, np.ndarray], step: float, atol: float = 0.0) -> None:
    (record,) = read_records(path, channels("mm"))
    size = next(iter(columns.values())).size
    np.testing.assert_allclose(record["time"], step * np.arange(size), atol=1e-9)
    for pin, channel in PINS.items():
        found = record[channel[:-2]].sel(axis="x")
        np.testing.assert_allclose(found, 1e-3 * columns[pin], rtol=1e-12, atol=atol)


class TestHalscope:
    @pytest.mark.parametrize("seed", range(6))
    def test_both_forms_come_back(self, tmp_path: Path, seed: int) -> None:
        rng, columns, step = draw(seed)
        write_halscope(tmp_path / "new.csv", columns, step)
        check(tmp_path / "new.csv", columns, step)
        decimal, unit = str(rng.choice([".", ","])), str(rng.choice(["nSec", "ns"]))
        write_halscope(tmp_path / "halscope.log", columns, step, named=False, decimal=decimal, unit=unit)
        check(tmp_path / "halscope.log", columns, step)

    def test_flipped_bits_give_a_record_or_a_sentence(self, tmp_path: Path) -> None:
        rng, columns, step = draw(3)
        path = tmp_path / "r.txt"
        write_halscope(path, columns, step)
        whole = np.frombuffer(path.read_bytes(), np.uint8)
        for _ in range(60):
            broken = whole.copy()
            at = np.minimum(rng.exponential(whole.size / 6, 2).astype(int), whole.size - 1)
            broken[at] ^= (1 << rng.integers(0, 8, 2)).astype(np.uint8)
            path.write_bytes(broken.tobytes())
            assert fault_of_reading(path, channels("mm")) == ""

    def test_a_row_cut_off_is_said(self, tmp_path: Path) -> None:
        _, columns, step = draw(7)
        for named in (True, False):
            path = tmp_path / f"{named}.txt"
            write_halscope(path, columns, step, named)
            path.write_text(path.read_text()[:-9])
            with pytest.raises(InputError, match=r"incomplete; the file is truncated: record or copy it again"):
                read_records(path, channels("mm"))


class TestTwinCAT:
    @pytest.mark.parametrize("seed", range(10))
    def test_every_layout_comes_back(self, tmp_path: Path, seed: int) -> None:
        rng, columns, step = draw(seed)
        delimiter, decimal = [("\t", ","), (";", ","), ("\t", "."), (";", "."), (",", "."), (":", ".")][seed % 6]
        size = next(iter(columns.values())).size
        slow = {"torque": np.arange(float(size // 5))} if rng.random() < 0.5 else None
        write_twincat(
            tmp_path / "s.csv",
            columns,
            step,
            delimiter,
            decimal,
            shared=bool(rng.random() < 0.5),
            slow=slow,
            end="EOF\n" if rng.random() < 0.5 else "",
        )
        check(tmp_path / "s.csv", columns, step)

    def test_units_and_several_sample_times(self, tmp_path: Path) -> None:
        _, columns, step = draw(1)
        slow = {"torque": np.arange(9.0)}
        units = {next(iter(columns)): "mm (Length)", "torque": "Nm (Torque)"}
        write_twincat(tmp_path / "s.csv", columns, step, units=units, slow=slow)
        (found,) = contents(tmp_path / "s.csv")
        assert found.units == {next(iter(columns)): "mm", "torque": "Nm"}
        assert "torque" in found.unread
        both = channels("mm") | {"drive_force_x": Channel("torque", "N")}
        with pytest.raises(InputError, match=r"channels of one record need one clock .*'torque' 9 every"):
            read_records(tmp_path / "s.csv", both)

    def test_what_cannot_be_parted_is_refused(self, tmp_path: Path) -> None:
        _, columns, step = draw(1)
        write_twincat(tmp_path / "s.csv", columns, step, delimiter=" ", decimal=".")
        with pytest.raises(InputError, match="export it with tabs or semicolons"):
            read_records(tmp_path / "s.csv", channels("mm"))


class TestSinumerikEdge:
    @pytest.mark.parametrize("seed", range(4))
    def test_signals_come_back(self, tmp_path: Path, seed: int) -> None:
        _, columns, step = draw(seed)
        write_capture(tmp_path / "c.json", columns, step)
        check(tmp_path / "c.json", columns, step)

    def test_a_gap_of_the_cycle_counter_ends_a_record(self, tmp_path: Path) -> None:
        _, columns, step = draw(2)
        write_capture(tmp_path / "c.json", columns, step, lost=(10, 11))
        first, second = read_records(tmp_path / "c.json", channels("mm"))
        assert first.sizes["time"] == 10
        assert float(second["time"][0]) == pytest.approx(12 * step)
        assert "cycles are missing at 1 places" in first.attrs["notes"]

    def test_what_is_no_capture_is_said(self, tmp_path: Path) -> None:
        (tmp_path / "c.json").write_text('{"a": 1}')
        with pytest.raises(InputError, match="JSON without Header and Payload"):
            read_records(tmp_path / "c.json", channels("mm"))


def test_a_trace_is_recognised_as_a_drive_or_a_loop(tmp_path: Path) -> None:
    t = np.arange(0.0, 2.0, 2e-3)
    columns = {"ENC_POS|1": np.sin(t), "TORQUE|1": np.cos(t), "CURRENT|1": t % 0.3}
    write_capture(tmp_path / "c.json", columns, 2e-3)
    found = smfe.look(tmp_path / "c.json")
    assert found.kind.name == "drive stroke"
    assert found.sample_rate == 500.0
