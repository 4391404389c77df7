"""What is stored comes back exactly: numbers, their kinds, labelled arrays, texts, objects."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from smfe.progress import SmfeWarning
from smfe.stored import Store, digest


@dataclass(frozen=True)
class Held:
    name: str
    data: xr.Dataset
    more: Any = None


def data(value: float = 1.0, units: str = "mm") -> list[object]:
    dataset = xr.Dataset({"limit_depth": ("spindle_speed", np.array([value, 2.0]), {"units": units})})
    frame = pd.DataFrame({"file": ["a.csv", None], "ratio": [0.5, np.nan]})
    return [Held("hammer", dataset), frame, {"a": (1, 2)}, dataset["limit_depth"]]


def part() -> Held:
    axes = np.array(["x", "y"])
    dataset = xr.Dataset(
        {
            "compliance": (("axis", "frequency"), np.array([[1 + 2j, np.nan], [0, 3]]), {"units": "m/N"}),
            "note": ("axis", np.array(["a", None], object)),
            "level": ((), np.uint8(7)),
        },
        {"axis": axes, "frequency": ("frequency", [1.5, 2.5], {"units": "Hz"}), "teeth": 2},
        {"warnings": ["one", "two"], "ratio": np.float64(0.1), "whole": 3, "tuple": (1.0, None), "sure": True},
    )
    more = {"inf": float("inf"), "third": 1.0 / 3.0, 5: [np.int32(4), np.bool_(True)], "none": np.zeros((0, 3))}
    return Held("hammer", dataset, more)


def test_a_part_comes_back_as_it_was_and_is_made_once(tmp_path: Path) -> None:
    made: list[Held] = []

    def make() -> Held:
        made.append(part())
        return made[-1]

    first, again = (Store(tmp_path, "limits", Held).get("k", make) for _ in range(2))
    assert len(made) == 1
    assert again is not first
    xr.testing.assert_identical(again.data, first.data)
    for name, variable in first.data.variables.items():
        assert again.data.variables[name].dtype == variable.dtype, name
    assert {k: type(v) for k, v in again.data.attrs.items()} == {k: type(v) for k, v in first.data.attrs.items()}
    assert digest(again) == digest(first)
    assert type(again.more[5][0]) is np.int32


def test_what_is_not_asked_for_goes_and_what_is_damaged_is_made_again(tmp_path: Path) -> None:
    store = Store(tmp_path, "limits")
    for key in ("a", "b"):
        store.get(key, lambda: 1)
    stored = (tmp_path / "limits-b.npz").read_bytes()
    (tmp_path / "cuts-c.npz").write_bytes(b"of another kind")
    for damaged in (b"PK damaged", b"", stored[:-1], stored[:40] + bytes([stored[40] ^ 1]) + stored[41:]):
        (tmp_path / "limits-b.npz").write_bytes(damaged)
        second = Store(tmp_path, "limits")
        with pytest.warns(SmfeWarning, match=r"limits-b\.npz' is not as it was written"):
            assert second.get("b", lambda: 2) == 2
    second.forget_others()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cuts-c.npz", "limits-b.npz"]
    assert Store(None, "limits").get("b", lambda: 3) == 3
    Store(None, "limits").forget_others()


def test_what_cannot_be_stored_is_a_mistake_that_leaves_no_file(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="set cannot be stored"):
        Store(tmp_path, "limits").get("a", lambda: {1, 2})
    assert list(tmp_path.iterdir()) == []


def test_the_same_data_have_the_same_digest_and_others_another() -> None:
    assert digest(data()) == digest(data())
    others = [data(1.0 + 1e-12), data(units="m"), data()[:3], [*data(), None], {"a": data()}]
    assert len({digest(data()), *map(digest, others)}) == 1 + len(others)
    assert digest({"a": 1, "b": 2}) != digest({"a": 1, "c": 2})
    assert digest(np.array([1, 2])) != digest(np.array([1.0, 2.0]))
    assert digest(np.array(["ab", "c"], object)) != digest(np.array(["a", "bc"], object))
