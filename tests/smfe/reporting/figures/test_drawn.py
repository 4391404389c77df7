"""A picture is drawn again when its data are others, and not when they are the same."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from smfe.reporting.figures.drawn import digest, draw_changed


@dataclass
class Held:
    name: str
    data: xr.Dataset


def data(value: float = 1.0, units: str = "mm") -> list[object]:
    dataset = xr.Dataset({"limit_depth": ("spindle_speed", np.array([value, 2.0]), {"units": units})})
    frame = pd.DataFrame({"file": ["a.csv", None], "ratio": [0.5, np.nan]})
    return [Held("hammer", dataset), frame, {"a": (1, 2)}, dataset["limit_depth"]]


def test_the_same_data_have_the_same_digest_and_others_another() -> None:
    assert digest(data()) == digest(data())
    others = [data(1.0 + 1e-12), data(units="m"), data()[:3], [*data(), None], {"a": data()}]
    assert len({digest(data()), *map(digest, others)}) == 1 + len(others)
    assert digest({"a": 1, "b": 2}) != digest({"a": 1, "c": 2})
    assert digest(np.array([1, 2])) != digest(np.array([1.0, 2.0]))
    assert digest(np.array(["ab", "c"], object)) != digest(np.array(["a", "bc"], object))


def draw(values: list[object]) -> None:
    """Stands for what draws."""


def test_only_what_has_changed_or_is_gone_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "figures" / "lobes_1.png"
    path.parent.mkdir()
    saved: list[int] = []

    def save() -> None:
        saved.append(1)
        path.write_text("picture" * len(saved))

    for values, count in ((data(), 1), (data(), 1), (data(3.0), 2), (data(3.0), 2)):
        draw_changed(tmp_path, path.name, partial(draw, values), save)
        assert len(saved) == count
    path.unlink()
    draw_changed(tmp_path, path.name, partial(draw, data(3.0)), save)
    path.write_text("edited by somebody")
    draw_changed(tmp_path, path.name, partial(draw, data(3.0)), save)
    assert len(saved) == 4

    def interrupted() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        draw_changed(tmp_path, path.name, partial(draw, data(5.0)), interrupted)
    draw_changed(tmp_path, path.name, partial(draw, data(3.0)), save)
    assert len(saved) == 5
