"""Tool, work material and modes as the tables of a campaign file, exact, of which everything else is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from process.cut.force import CuttingCoefficients
from process.cut.tool import Tool
from process.errors import InputError
from process.machine.modes import ModalModel
from smfe.campaign import campaign_of_tables


def tool_table(tool: Tool | Mapping[str, Any]) -> dict[str, Any]:
    """Return ``[tool]`` of a `Tool`; a mapping with the keys of a campaign file is returned as it is."""
    if isinstance(tool, Mapping):
        return dict(tool)
    if not isinstance(tool, Tool):
        raise InputError(f'{tool!r} is no tool; give smfe.Tool("80 mm", 4) or a mapping with the keys of [tool]')
    table: dict[str, Any] = {
        "diameter": f"{tool.diameter!r} m",
        "teeth": tool.teeth,
        "approach_angle": f"{tool.approach_angle!r} rad",
        "helix_angle": f"{tool.helix_angle!r} rad",
    }
    if tool.pitch_angles is not None:
        table["pitch_angles"] = [f"{angle!r} rad" for angle in tool.pitch_angles]
    if tool.runout is not None:
        table["runout"] = [f"{offset!r} m" for offset in tool.runout]
    return table


def material_table(material: CuttingCoefficients | Mapping[str, Any]) -> dict[str, Any]:
    """Return ``[material]`` of `CuttingCoefficients`; a mapping with the keys of a file is returned as it is."""
    if isinstance(material, Mapping):
        return dict(material)
    if not isinstance(material, CuttingCoefficients):
        raise InputError(
            f"{material!r} is no work material; give smfe.CuttingCoefficients with Ktc, Krc and Kac, or a mapping with "
            "the keys of [material]"
        )
    units = {"c": "N/m^2", "e": "N/m"}  # of Ktc and Kte
    return {name: f"{value!r} {units[name[-1]]}" for name, value in asdict(material).items()}


def model_table(name: str, modal: ModalModel, uncertainty: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return ``[[model]]`` of modes."""
    columns = (np.asarray(v).tolist() for v in (modal.frequency, modal.damping, modal.stiffness, modal.direction))
    modes = [
        {"frequency": f"{f!r} Hz", "damping": z, "stiffness": f"{k!r} N/m", "direction": u}
        for f, z, k, u in zip(*columns, strict=True)
    ]
    return {"name": name, "modes": modes, **({"uncertainty": dict(uncertainty)} if uncertainty else {})}


def tool_of(tool: Tool | Mapping[str, Any]) -> Tool:
    """Return the tool that a mapping with the keys of a campaign file describes; a `Tool` as it is."""
    if isinstance(tool, Tool):
        return tool
    stub = {"file": "cut", "spindle_speed": "1 rpm", "depth_of_cut": "1 mm", "cut": "down", "width_of_cut": "1 um"}
    found = campaign_of_tables({"tool": tool_table(tool), "cutting_test": [stub]}, {"cut": []}).tool
    assert found is not None
    return found
