"""Stability limits of milling: lobes, critical depth, lobe tables, and the spectral chatter criterion.

- `zero_order`: limit depth over spindle speed from a measured 3x3 compliance, `lobe_curves` for the single
  lobes, `critical_depth` for the limit that holds at every speed; the ``..._from_matrix`` forms take any
  directional matrix.
- `semi_discretization`, `multi_frequency`: converged limits, with period doubling and any pitch; `limit_depth`,
  `stability_bands` and `floquet_multipliers` for one speed.
- `operating_point`: limits whose compliance belongs to the feed and the force at which each point is cut.
- `stationary_vibration`: the periodic vibration of a stable cut, and the surface error that it leaves; `cut_maps` over
  speed and depth, with force, torque, power and removal rate.
- `find_boundary`: the boundary of any scalar function of two named axes, with islands and every band.
- `sampled_band`, `linearised_band`, `converged_band`, `with_band`: quantiles of a limit and the depth that is safe;
  `Spread` for errors that the compliance does not hold.
- `best_pockets`, `write_presets`: the speeds at which most is removed, and presets for a tool library.
- `design_pitch`: the unequal pitch that suits a mode and a speed.
- `chatter_verdict`: stable, chatter or undecided, from the record of a cut.
- `lobe_table`, `write_table`, `read_table`: tables for CAM.

Depths are axial depths a_p. Conventions and units are those of `process.labels`.
"""

# ruff: noqa: E402  (the guard must speak before the first import of `process` fails with a riddle)

from stability._guard import check_process

check_process()

from typing import TYPE_CHECKING

from process._lazy import lazy

if TYPE_CHECKING:
    from stability.bands.converged_band import converged_band
    from stability.bands.depth_quantiles import linearised_band, sampled_band, with_band
    from stability.bands.error_model import Spread, carries_errors
    from stability.boundary import Axis, Boundary, find_boundary, pointwise
    from stability.chatter.criterion import ChatterVerdict, chatter_verdict
    from stability.methods.multi_frequency import multi_frequency
    from stability.methods.semi_discretization import (
        BAND_COLUMNS,
        LimitDepth,
        floquet_multipliers,
        limit_depth,
        semi_discretization,
        stability_bands,
    )
    from stability.methods.stationary_vibration import StationaryVibration, stationary_vibration
    from stability.methods.zero_order import (
        CriticalDepth,
        critical_depth,
        critical_depth_from_matrix,
        lobe_curves,
        zero_order,
        zero_order_from_matrix,
    )
    from stability.operating.operating_point import operating_point
    from stability.pitch_design import PitchDesign, design_pitch
    from stability.problem import Cut
    from stability.tables.lobe_table import LOBE_COLUMNS, lobe_table, read_table, write_table
    from stability.tables.pockets import POCKET_COLUMNS, SpindleRange, best_pockets
    from stability.tables.presets import PRESET_SCHEMA, read_presets, write_presets
    from stability.vibration_maps import cut_maps


__all__ = [
    "BAND_COLUMNS",
    "LOBE_COLUMNS",
    "POCKET_COLUMNS",
    "PRESET_SCHEMA",
    "Axis",
    "Boundary",
    "ChatterVerdict",
    "CriticalDepth",
    "Cut",
    "LimitDepth",
    "PitchDesign",
    "SpindleRange",
    "Spread",
    "StationaryVibration",
    "best_pockets",
    "carries_errors",
    "chatter_verdict",
    "converged_band",
    "critical_depth",
    "critical_depth_from_matrix",
    "cut_maps",
    "design_pitch",
    "find_boundary",
    "floquet_multipliers",
    "limit_depth",
    "linearised_band",
    "lobe_curves",
    "lobe_table",
    "multi_frequency",
    "operating_point",
    "pointwise",
    "read_presets",
    "read_table",
    "sampled_band",
    "semi_discretization",
    "stability_bands",
    "stationary_vibration",
    "with_band",
    "write_presets",
    "write_table",
    "zero_order",
    "zero_order_from_matrix",
]

_HOMES = {
    "stability.bands.converged_band": "converged_band",
    "stability.bands.depth_quantiles": "linearised_band, sampled_band, with_band",
    "stability.bands.error_model": "Spread, carries_errors",
    "stability.boundary": "Axis, Boundary, find_boundary, pointwise",
    "stability.chatter.criterion": "ChatterVerdict, chatter_verdict",
    "stability.vibration_maps": "cut_maps",
    "stability.methods.multi_frequency": "multi_frequency",
    "stability.methods.semi_discretization": (
        "BAND_COLUMNS, LimitDepth, floquet_multipliers, limit_depth, semi_discretization, stability_bands"
    ),
    "stability.methods.stationary_vibration": "StationaryVibration, stationary_vibration",
    "stability.methods.zero_order": (
        "CriticalDepth, critical_depth, critical_depth_from_matrix, lobe_curves, zero_order, zero_order_from_matrix"
    ),
    "stability.operating.operating_point": "operating_point",
    "stability.pitch_design": "PitchDesign, design_pitch",
    "stability.problem": "Cut",
    "stability.tables.lobe_table": "LOBE_COLUMNS, lobe_table, read_table, write_table",
    "stability.tables.pockets": "POCKET_COLUMNS, SpindleRange, best_pockets",
    "stability.tables.presets": "PRESET_SCHEMA, read_presets, write_presets",
}
"""Module -> the names that it gives; `__all__` and the imports for the type checker say the same."""

if not TYPE_CHECKING:  # a type checker takes the imports above, and so finds a name that is not there
    __getattr__, __dir__ = lazy(__name__, _HOMES)
