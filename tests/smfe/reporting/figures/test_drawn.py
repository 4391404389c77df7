"""A picture is drawn again when its data are others, and not when they are the same."""

from functools import partial
from pathlib import Path

import pytest

from smfe.reporting.figures.drawn import draw_changed


def draw(values: list[float]) -> None:
    """Stands for what draws."""


def test_only_what_has_changed_or_is_gone_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "figures" / "lobes_1.png"
    path.parent.mkdir()
    saved: list[int] = []

    def save() -> None:
        saved.append(1)
        path.write_text("picture" * len(saved))

    for values, count in (([1.0], 1), ([1.0], 1), ([3.0], 2), ([3.0], 2)):
        draw_changed(tmp_path, path.name, partial(draw, values), save)
        assert len(saved) == count
    path.unlink()
    draw_changed(tmp_path, path.name, partial(draw, [3.0]), save)
    path.write_text("edited by somebody")
    draw_changed(tmp_path, path.name, partial(draw, [3.0]), save)
    assert len(saved) == 4

    def interrupted() -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        draw_changed(tmp_path, path.name, partial(draw, [5.0]), interrupted)
    draw_changed(tmp_path, path.name, partial(draw, [3.0]), save)
    assert len(saved) == 5
