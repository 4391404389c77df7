"""Operating points as a table, for CAM programs that import CSV and for spreadsheets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from smfe.cam.points import OperatingPoint
from smfe.results import write_csv

COLUMNS = (
    *("name", "machine", "tool", "diameter_mm", "teeth", "material", "cut", "width_of_cut_mm", "spindle_speed_rpm"),
    *("depth_of_cut_mm", "feed_per_tooth_mm", "feed_mm_min", "removal_rate_cm3_min", "probability", "source"),
)


def write_table(points: Sequence[OperatingPoint], path: Path) -> list[str]:
    """Write a row a point; return their names."""
    write_csv(path, pd.DataFrame([asdict(p) for p in points])[list(COLUMNS)])
    return [p.name for p in points]
