"""Stability limits of milling: lobes, critical depth, lobe tables, and the spectral chatter criterion.

- `zero_order`: limit depth over spindle speed from a measured 3x3 compliance, `lobe_curves` for the single
  lobes, `critical_depth` for the limit that holds at every speed; the ``..._from_matrix`` forms take any
  directional matrix.
- `semi_discretization`, `multi_frequency`: converged limits, with period doubling and any pitch; `limit_depth`,
  `stability_bands` and `floquet_multipliers` for one speed.
- `chatter_verdict`: stable, chatter or undecided, from the record of a cut.
- `lobe_table`, `write_table`, `read_table`: tables for CAM.

Depths are axial depths a_p. Conventions and units are those of `process.labels`.
"""

# ruff: noqa: E402  (the guard must speak before the first import of `process` fails with a riddle)

from stability._guard import check_process

check_process()

from stability.criterion import ChatterVerdict, chatter_verdict
from stability.multi_frequency import multi_frequency
from stability.problem import Cut
from stability.semi_discretization import (
    BAND_COLUMNS,
    LimitDepth,
    floquet_multipliers,
    limit_depth,
    semi_discretization,
    stability_bands,
)
from stability.tables import LOBE_COLUMNS, lobe_table, read_table, write_table
from stability.zero_order import (
    CriticalDepth,
    critical_depth,
    critical_depth_from_matrix,
    lobe_curves,
    zero_order,
    zero_order_from_matrix,
)

__all__ = [
    "BAND_COLUMNS",
    "LOBE_COLUMNS",
    "ChatterVerdict",
    "CriticalDepth",
    "Cut",
    "LimitDepth",
    "chatter_verdict",
    "critical_depth",
    "critical_depth_from_matrix",
    "floquet_multipliers",
    "limit_depth",
    "lobe_curves",
    "lobe_table",
    "multi_frequency",
    "read_table",
    "semi_discretization",
    "stability_bands",
    "write_table",
    "zero_order",
    "zero_order_from_matrix",
]
