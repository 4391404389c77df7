"""The form of presets for a tool library."""

import copy
import json

import pytest

from process.errors import InputError
from stability.tables.presets import PRESET_SCHEMA, check_presets, read_presets, write_presets

POINT = {
    "status": "recommended",
    "spindle_speed_rpm": 855.0,
    "speed_from_rpm": 845.0,
    "speed_to_rpm": 865.0,
    "depth_of_cut_mm": 13.3,
    "limit_depth_mm": 15.7,
    "limit_depth_p05_mm": 13.4,
    "limit_depth_p95_mm": 18.5,
    "width_of_cut_mm": 40.0,
    "feed_per_tooth_mm": 0.1,
    "feed_mm_min": 171.0,
    "cutting_speed_m_min": 214.9,
    "removal_rate_cm3_min": 90.97,
    "probability": 0.95,
    "chatter_frequency_Hz": 64.3,
    "lobes": "lobes_1",
    "method": "zero_order",
    "cut": "down",
    "source": "sweep",
    "reason": "From sweep, measured in motion.",
    "assumptions": ["the edges are long enough"],
    "tool": {"name": "80 mm, 2 teeth", "diameter_mm": 80.0, "teeth": 2, "approach_angle_deg": 45.0},
    "material": "C45",
    "machine": "ram",
}
LIMIT = POINT | {"status": "limit_only", "depth_of_cut_mm": None, "removal_rate_cm3_min": None, "probability": None}


@pytest.fixture
def document():
    found = {"recommendation": POINT, "recommendations": [POINT, LIMIT], "presets": [POINT]}
    return {"format": "smfe-presets", "version": 2, **{name: copy.deepcopy(part) for name, part in found.items()}}


def test_presets_come_back_as_they_were_written(document, tmp_path):
    assert read_presets(write_presets(document, tmp_path / "presets.json")) == document


def test_presets_have_the_published_form(document):
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator.check_schema(PRESET_SCHEMA)
    jsonschema.validate(json.loads(json.dumps(check_presets(document))), PRESET_SCHEMA)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda p: p.pop("material"), "the file.presets.0. has no 'material'"),
        (lambda p: p.update(colour="red"), "has 'colour', which is not known"),
        (lambda p: p.update(spindle_speed_rpm="1000"), "spindle_speed_rpm is '1000'; number is needed"),
        (lambda p: p.update(depth_of_cut_mm=0), "depth_of_cut_mm is 0; it must be above 0"),
        (lambda p: p.update(depth_of_cut_mm=None), "depth_of_cut_mm is None; number is needed"),
        (lambda p: p.update(status="limit_only"), "status is 'limit_only'; it must be one of recommended"),
        (lambda p: p.update(cut="side"), "cut is 'side'; it must be one of down, up, central"),
        (lambda p: p.update(probability=1.0), "probability is 1; it must be above 0 and below 1"),
        (lambda p: p["tool"].update(teeth=0), "tool.teeth is 0"),
        (lambda p: p.update(source=""), "source is empty"),
    ],
)
def test_presets_of_another_form_are_refused_as_the_schema_does(document, change, sentence):
    change(document["presets"][0])
    with pytest.raises(InputError, match=sentence):
        check_presets(document)
    jsonschema = pytest.importorskip("jsonschema")
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(document, PRESET_SCHEMA)


def test_a_file_that_holds_no_presets_is_refused(tmp_path):
    with pytest.raises(InputError, match="there is no file"):
        read_presets(tmp_path / "none.json")
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(InputError, match="is not JSON"):
        read_presets(tmp_path / "bad.json")
    (tmp_path / "old.json").write_text('{"format": "smfe-presets", "version": 1, "presets": []}')
    with pytest.raises(InputError, match="has the form of version 1, and 2 is read; `smfe run` writes it again"):
        read_presets(tmp_path / "old.json")
