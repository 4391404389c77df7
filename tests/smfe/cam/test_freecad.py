"""Presets in tool bits of FreeCAD: speed and feed follow from what is stored, nothing else of a tool bit changes."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from samples.cam import POINT

from process.errors import InputError
from smfe.cam.freecad import write_freecad


def test_freecad_computes_the_speed_and_feed_of_the_point(tmp_path: Path) -> None:
    write_freecad([POINT], tmp_path / "t.fctb")
    content = json.loads((tmp_path / "t.fctb").read_text())
    (preset,) = content["presets"]
    diameter = float(content["parameter"]["Diameter"].removesuffix(" mm"))
    # n = 1000 v_c / (pi D), v_f = n Z f_z: FreeCAD's own arithmetic.
    speed = 1e3 * preset["surface_speed"] / (math.pi * diameter)
    assert speed == pytest.approx(POINT.spindle_speed_rpm)
    assert speed * content["parameter"]["Flutes"] * preset["chipload"] == pytest.approx(POINT.feed_mm_min)
    assert "width of cut 40 mm; depth of cut 3.4 mm" in preset["notes"]


def test_an_existing_tool_bit_keeps_everything_else(tmp_path: Path) -> None:
    path = tmp_path / "shop.fctb"
    shop = {"name": "theirs", "notes": None, "chipload": 0.2}
    before = {
        "version": 2,
        "name": "Messerkopf Ø80",
        "shape": "endmill.fcstd",
        "parameter": {"Diameter": "80.0000 mm"},
        "attribute": {"Flutes": "2"},
        "presets": [shop],
        "later": [1],
    }
    path.write_text(json.dumps(before))
    write_freecad([POINT, replace(POINT, spindle_speed_rpm=860.0)], path)
    write_freecad([replace(POINT, spindle_speed_rpm=1150.0)], path)
    after = json.loads(path.read_text())
    mine = after["presets"].pop()
    assert after == before
    assert "1150 rpm" in mine["notes"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{}", "no tool bit of FreeCAD"),
        ("x", "not JSON"),
        ('{"shape": "e", "parameter": {"Diameter": "3.2 in"}}', "a tool of 3.2 in; the campaign's has 80 mm"),
        ('{"shape": "e", "parameter": {"Diameter": "80 mm", "Flutes": 3}}', "a tool of 3 teeth"),
        ('{"shape": "e", "parameter": {}}', "a tool of no diameter"),
    ],
)
def test_another_tool_is_refused(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "t.fctb"
    path.write_text(content)
    with pytest.raises(InputError, match=said):
        write_freecad([POINT], path)
    assert path.read_text() == content
