"""Operating points that a CAM program is given: those that a folder of results recommends, nothing else."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from process.errors import InputError
from stability import read_presets
from stability.tables.presets import milling


@dataclass(frozen=True)
class OperatingPoint:
    """A cut that is safe with a stated probability.

    Parameters
    ----------
    name : str
        For the list of presets of a tool.
    cut_key : str
        Machine, material, kind and width of cut: what another export of the same campaign has in common with it.
    tool, material, machine : str
        As the campaign calls them.
    diameter_mm, approach_angle_deg, edge_length_mm : float
        Of the tool; the length along its edges is None where the campaign does not say it.
    teeth : int
        Of the tool.
    cut : {"down", "up", "central"}
        Kind of cut.
    spindle_speed_rpm, depth_of_cut_mm, width_of_cut_mm, feed_per_tooth_mm, feed_mm_min, removal_rate_cm3_min : float
        The cut.
    probability : float
        With which it is stable.
    source : str
        Measurement that the limit comes from.
    """

    name: str
    cut_key: str
    tool: str
    material: str
    machine: str
    diameter_mm: float
    approach_angle_deg: float
    edge_length_mm: float | None
    teeth: int
    cut: str
    spindle_speed_rpm: float
    depth_of_cut_mm: float
    width_of_cut_mm: float
    feed_per_tooth_mm: float
    feed_mm_min: float
    removal_rate_cm3_min: float
    probability: float
    source: str

    @property
    def axial_edges_mm(self) -> float | None:
        """Depth that the edges reach, ``l sin(kappa)``; None where it is not known."""
        if self.edge_length_mm is None:
            return None
        return self.edge_length_mm * math.sin(math.radians(self.approach_angle_deg))

    @property
    def description(self) -> str:
        """What the number is and where it comes from, in a sentence."""
        return (
            f"{milling(self.cut)}, depth {self.depth_of_cut_mm:g} mm at width {self.width_of_cut_mm:g} mm: stable with "
            f"{100.0 * self.probability:g} % by {self.source.replace('_', ' ')}"
            + (f", {self.machine}" if self.machine else "")
        )


def operating_points(folder: Path) -> list[OperatingPoint]:
    """Return the points that a folder of results recommends, best first.

    Raises
    ------
    InputError
        When the folder holds no presets, or none of them has a safe depth.
    """
    path = folder / "presets.json"
    if not path.is_file():
        raise InputError(
            f"'{folder}' holds no presets.json: give the folder of results of `smfe run` on a campaign with [[lobes]]"
        )
    document = read_presets(path)
    answers = [a for a in document["recommendations"] if a["status"] == "recommended"]
    if not answers:
        said = document["recommendation"]
        why = f": {said['reason']}" if said else ""
        raise InputError(f"'{path}' recommends no depth{why}. A limit without a margin is not exported")
    used = {(a["lobes"], a["source"], a["width_of_cut_mm"]) for a in answers}
    return [
        _point(p)
        for p in document["presets"]
        if p["status"] == "recommended" and (p["lobes"], p["source"], p["width_of_cut_mm"]) in used
    ]


def _point(entry: Mapping[str, Any]) -> OperatingPoint:
    tool = entry["tool"]
    width, speed, depth = entry["width_of_cut_mm"], entry["spindle_speed_rpm"], entry["depth_of_cut_mm"]
    material, machine = entry["material"], entry.get("machine") or ""
    return OperatingPoint(
        name=f"{material} {entry['cut']} ae {width:g} ap {depth:g} n {speed:g}",
        cut_key="\x1f".join((machine, material, entry["cut"], f"{width:g}")),
        tool=tool["name"],
        material=material,
        machine=machine,
        diameter_mm=tool["diameter_mm"],
        approach_angle_deg=tool["approach_angle_deg"],
        edge_length_mm=tool.get("edge_length_mm"),
        teeth=tool["teeth"],
        cut=entry["cut"],
        spindle_speed_rpm=speed,
        depth_of_cut_mm=depth,
        width_of_cut_mm=width,
        feed_per_tooth_mm=entry["feed_per_tooth_mm"],
        feed_mm_min=entry["feed_mm_min"],
        removal_rate_cm3_min=entry["removal_rate_cm3_min"],
        probability=entry["probability"],
        source=entry["source"],
    )


def file_name(text: str) -> str:
    """Return a text as a name of a file."""
    return re.sub(r"[^A-Za-z0-9.+-]+", "_", text).strip("_.") or "tool"
