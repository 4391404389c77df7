"""An operating point of the demonstration's kind, and a tool library with the keys that Fusion exports."""

from typing import Any

from smfe.cam.points import OperatingPoint

POINT = OperatingPoint(
    name="C45 down ae 40 ap 3.4 n 1145",
    cut_key="ram machine\x1fC45\x1fdown\x1f40",
    tool="80 mm, 2 teeth",
    material="C45",
    machine="ram machine",
    diameter_mm=80.0,
    approach_angle_deg=45.0,
    edge_length_mm=None,
    teeth=2,
    cut="down",
    spindle_speed_rpm=1145.0,
    depth_of_cut_mm=3.4,
    width_of_cut_mm=40.0,
    feed_per_tooth_mm=0.1,
    feed_mm_min=229.0,
    removal_rate_cm3_min=31.144,
    probability=0.95,
    source="sweep",
)


def _preset(**others: Any) -> dict[str, Any]:
    feeds = dict.fromkeys(("v_f", "v_f_leadIn", "v_f_leadOut", "v_f_transition"), 12.5)
    plunge = dict.fromkeys(("v_f_plunge", "v_f_ramp", "v_f_retract"), 1.25)
    material = {"category": "all", "query": "", "use-hardness": False}
    return {
        "description": "",
        "f_n": 0.001,
        "f_z": 0.0025,
        "guid": "{00000000-0000-4000-8000-000000000001}",
        "material": material,
        "n": 1018.59,
        "n_ramp": 1018.59,
        "name": "Default preset",
        "ramp-angle": 2,
        "tool-coolant": "flood",
        "use-stepdown": False,
        "use-stepover": False,
        "v_c": 99.9998394068759,
        **feeds,
        **plunge,
        **others,
    }


def _tool(kind: str, unit: str, geometry: dict[str, Any], presets: list[Any], **others: Any) -> dict[str, Any]:
    guid = f"00000000-0000-4000-8000-{abs(hash_of(kind + unit)):012d}"
    return {
        "BMC": "carbide",
        "GRADE": "generic",
        "description": f"a {kind}® of the shop",
        "geometry": geometry,
        "guid": guid,
        "last_modified": 1786974587602,
        "post-process": {
            "break-control": False,
            "comment": "",
            "diameter-offset": 3,
            "length-offset": 3,
            "live": True,
            "manual-tool-change": False,
            "number": 3,
            "turret": 0,
        },
        "product-id": "P 1",
        "product-link": "",
        "reference_guid": "<NEW TOOL GUID>",
        "start-values": {"presets": presets},
        "type": kind,
        "unit": unit,
        "vendor": "somebody",
        **others,
    }


def hash_of(text: str) -> int:
    """Return a number that a text always has."""
    return sum(ord(c) * (k + 1) for k, c in enumerate(text))


def fusion_library() -> dict[str, Any]:
    """Return a library with every key of one that Fusion exported, and values of its own."""
    geometry = {
        "CSP": False,
        "DC": 80,
        "HAND": True,
        "LB": 60,
        "LCF": 20,
        "NOF": 2,
        "OAL": 110,
        "RE": 0.8,
        "SFDM": 32,
        "TA": 45,
        "assemblyGaugeLength": 60.5,
        "shoulder-diameter": 60,
        "shoulder-length": 20,
        "tip-diameter": 40.123456789,
    }
    holder = {
        "description": "a holder",
        "gaugeLength": 1.7972442,
        "guid": "00000000-0000-4000-8000-000000000009",
        "product-id": "31",
        "product-link": "",
        "segments": [{"height": 0.422047, "lower-diameter": 0.866142, "upper-diameter": 1.25984}],
        "type": "holder",
        "unit": "inches",
        "vendor": "somebody",
    }
    expressions = {"tool_description": "'mill'", "tool_diameter": "80 mm", "tool_numberOfFlutes": "2"}
    probe = {"guid": "{a}", "name": "Default preset", "v_f_leadIn": 100, "v_f_link": 200, "v_f_measure": 50}
    drill = {"use-feed-per-revolution": False, "tool-coolant": "flood", "name": "d", "v_f_plunge": 10, "guid": "{b}"}
    return {
        "data": [
            _tool("face mill", "millimeters", geometry, [_preset(presetGuid="x")], expressions=expressions),
            _tool("probe", "millimeters", {"DC": 5, "LB": 40, "OAL": 60, "SFDM": 5}, [probe]),
            _tool("flat end mill", "inches", {"DC": 0.375, "NOF": 4, "LCF": 0.75}, [_preset()], holder=holder),
            _tool("drill", "inches", {"DC": 0.161, "NOF": 2, "SIG": 118}, [drill]),
        ],
        "version": 36,
    }
