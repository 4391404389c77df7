"""Presets in tool libraries of Fusion: consistent, in the tool's units, and nothing else of a library changes."""

import copy
import json
import math
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from samples.cam import POINT, fusion_library

from process.errors import InputError
from smfe.cam.fusion import library_bytes, new_library, read_library, write_fusion


def a_mill(unit: str, diameter: float, teeth: int, guid: str, **others: Any) -> dict[str, Any]:
    preset = {
        "guid": "{a}",
        "n": 5000,
        "name": "shop",
        "v_f": 900.0,
        "v_f_plunge": 90.0,
        "ramp-angle": 3,
        "unknown": [1],
    }
    return {
        "description": f"mill {guid}",
        "geometry": {"DC": diameter, "NOF": teeth},
        "guid": guid,
        "last_modified": 1786974587602,
        "start-values": {"presets": [preset | {"tool-coolant": "mist"}]},
        "type": "face mill",
        "unit": unit,
        **others,
    }


def a_library(*tools: dict[str, Any]) -> dict[str, Any]:
    return {"data": list(tools), "version": 36, "key of a later version": {"x": 0.1}}


def written(path: Path, content: dict[str, Any], newline: str = "\n") -> Path:
    path.write_bytes(
        json.dumps(content, indent=4, ensure_ascii=False).replace("\n", newline).encode() + newline.encode()
    )
    return path


def presets_of(path: Path, tool: int = 0) -> list[dict[str, Any]]:
    return list(json.loads(path.read_text())["data"][tool]["start-values"]["presets"])


class TestNewLibrary:
    def test_speed_feed_and_cutting_speed_belong_together(self, tmp_path: Path) -> None:
        write_fusion([POINT], tmp_path / "new.json")
        (tool,) = json.loads((tmp_path / "new.json").read_text())["data"]
        (preset,) = tool["start-values"]["presets"]
        assert (preset["n"], preset["stepdown"], preset["stepover"], preset["f_z"]) == (1145.0, 3.4, 40.0, 0.1)
        assert preset["use-stepdown"] is True
        assert preset["use-stepover"] is True
        assert preset["v_c"] == pytest.approx(math.pi * 0.080 * 1145.0)
        assert preset["v_f"] == pytest.approx(POINT.feed_mm_min)
        assert preset["f_n"] == pytest.approx(preset["v_f_plunge"] / preset["n"])

    def test_the_tool_is_that_of_the_campaign(self) -> None:
        (tool,) = new_library(POINT).content["data"]
        geometry = tool["geometry"]
        assert (tool["type"], geometry["DC"], geometry["NOF"], geometry["TA"]) == ("face mill", 80.0, 2, 45.0)
        assert geometry["OAL"] > geometry["LB"] >= geometry["shoulder-length"] >= geometry["LCF"] > 0.0
        (square,) = new_library(replace(POINT, approach_angle_deg=90.0, edge_length_mm=30.0)).content["data"]
        assert (square["type"], square["geometry"]["LCF"]) == ("flat end mill", 30.0)

    def test_tools_is_the_zip_of_json(self, tmp_path: Path) -> None:
        write_fusion([POINT], tmp_path / "a.json")
        write_fusion([POINT], tmp_path / "a.tools")
        with zipfile.ZipFile(tmp_path / "a.tools") as archive:
            assert archive.namelist() == ["tools.json"]
            assert archive.read("tools.json") == (tmp_path / "a.json").read_bytes()


class TestExistingLibrary:
    @pytest.mark.parametrize("newline", ["\n", "\r\n"])
    def test_nothing_else_changes(self, tmp_path: Path, newline: str) -> None:
        before = a_library(a_mill("millimeters", 50, 4, "x"), a_mill("millimeters", 80.0, 2, "y", ü="Ø 1e-7", z=1e-7))
        path = written(tmp_path / "shop.json", copy.deepcopy(before), newline)
        original = path.read_bytes()
        write_fusion([POINT], path)
        after = json.loads(path.read_bytes())
        mine = after["data"][1]["start-values"]["presets"].pop()
        assert mine["name"] == POINT.name
        assert after == before
        # Taken out again, the file is the same to the last byte.
        library = read_library(path)
        library.content["data"][1]["start-values"]["presets"].pop()
        assert library_bytes(library, zipped=False) == original

    def test_a_library_of_fusion_is_read_back_identical_but_for_the_presets(self, tmp_path: Path) -> None:
        for path in (tmp_path / "shop.json", tmp_path / "shop.tools"):
            data = json.dumps(fusion_library(), indent=4, ensure_ascii=False).encode()
            if path.suffix == ".tools":
                with zipfile.ZipFile(path, "w") as archive:
                    archive.writestr("tools.json", data)
                    archive.writestr("beside.txt", "kept")
            else:
                path.write_bytes(data)
            write_fusion([POINT, replace(POINT, name="second")], path)
            library = read_library(path)
            mine = [library.content["data"][0]["start-values"]["presets"].pop() for _ in range(2)]
            assert [p["name"] for p in mine] == ["second", POINT.name]
            assert library.content == fusion_library()
            assert library.others == ({"beside.txt": b"kept"} if path.suffix == ".tools" else {})
            assert library_bytes(library, zipped=False) == data

    def test_a_depth_beyond_the_edges_is_refused(self, tmp_path: Path) -> None:
        path = written(tmp_path / "shop.json", fusion_library())
        with pytest.raises(
            InputError, match=r"reach 20 mm, and 20\.1 mm are recommended; give \[tool\] edge_length = \"28\.2 mm\""
        ):
            write_fusion([replace(POINT, depth_of_cut_mm=20.1)], path)
        assert json.loads(path.read_text()) == fusion_library()

    def test_units_are_those_of_the_tool(self, tmp_path: Path) -> None:
        path = written(tmp_path / "inch.json", a_library(a_mill("inches", 80.0 / 25.4, 2, "x")))
        write_fusion([POINT], path)
        preset = presets_of(path)[-1]
        assert preset["stepdown"] * 25.4 == pytest.approx(3.4)
        assert preset["f_z"] * 25.4 == pytest.approx(0.1)
        assert preset["v_c"] * 0.3048 == pytest.approx(math.pi * 0.080 * 1145.0)
        assert preset["v_f"] * 25.4 == pytest.approx(POINT.feed_mm_min)

    def test_plunging_and_coolant_follow_the_shop(self, tmp_path: Path) -> None:
        path = written(tmp_path / "shop.json", a_library(a_mill("millimeters", 80, 2, "x")))
        write_fusion([POINT], path)
        preset = presets_of(path)[-1]
        assert preset["v_f_plunge"] == pytest.approx(0.1 * preset["v_f"])
        assert (preset["ramp-angle"], preset["tool-coolant"]) == (3, "mist")

    def test_a_second_export_renews_its_own_presets_alone(self, tmp_path: Path) -> None:
        path = written(tmp_path / "shop.json", a_library(a_mill("millimeters", 80, 2, "x")))
        other = replace(POINT, cut_key="other machine", name="other")
        write_fusion([POINT, replace(POINT, name="second", spindle_speed_rpm=860.0), other], path)
        first = presets_of(path)
        write_fusion([POINT, replace(POINT, name="second", spindle_speed_rpm=860.0), other], path)
        assert presets_of(path) == first
        write_fusion([replace(POINT, name="moved", spindle_speed_rpm=1150.0)], path)
        assert [p["name"] for p in presets_of(path)] == ["shop", "other", "moved"]
        assert presets_of(path)[-1]["guid"] == first[1]["guid"]

    def test_names_are_unique(self, tmp_path: Path) -> None:
        mill = a_mill("millimeters", 80, 2, "x")
        mill["start-values"]["presets"][0]["name"] = POINT.name
        path = written(tmp_path / "shop.json", a_library(mill))
        assert write_fusion([POINT, POINT], path) == [f"{POINT.name} (2)", f"{POINT.name} (3)"]
        guids = [p["guid"] for p in presets_of(path)]
        assert len(set(guids)) == 3

    def test_a_tool_is_chosen_by_name_and_never_guessed(self, tmp_path: Path) -> None:
        path = written(
            tmp_path / "shop.json",
            a_library(
                a_mill("millimeters", 80, 2, "x"), a_mill("millimeters", 80, 2, "y"), a_mill("inches", 2, 2, "z")
            ),
        )
        with pytest.raises(InputError, match=r"2 times: mill x .*; mill y .*--tool"):
            write_fusion([POINT], path)
        write_fusion([POINT], path, "Mill y")
        assert [len(presets_of(path, k)) for k in range(3)] == [1, 2, 1]
        with pytest.raises(InputError, match="not the tool of the campaign, 80 mm with 2 teeth"):
            write_fusion([POINT], path, "z")
        with pytest.raises(InputError, match=r"does not hold the tool 'w'; it holds mill x"):
            write_fusion([POINT], path, "w")

    @pytest.mark.parametrize(
        ("content", "said"),
        [
            (b"", "not JSON"),
            (b"[1]", "no list 'data'"),
            (b'{"data": [], "data": []}', "a key is there twice: data"),
            (b'{"data": [NaN]}', "NaN is no number"),
            (b'{"data": [1, {"type": "probe", "unit": "millimeters"}]}', "it holds no mill at all"),
            (b"PK\x05\x06" + bytes(18), "a zip that holds no tools.json"),
            (b"\xff\xfe\x00", "not JSON"),
        ],
    )
    def test_what_is_no_library_is_refused_and_left_as_it_is(self, tmp_path: Path, content: bytes, said: str) -> None:
        path = tmp_path / "shop.json"
        path.write_bytes(content)
        with pytest.raises(InputError, match=said):
            write_fusion([POINT], path)
        assert path.read_bytes() == content
        assert list(tmp_path.iterdir()) == [path]
