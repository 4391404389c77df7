"""The chosen numbers of the compliance check and of the pitch design, in one place."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class ProblemRules:
    """Settings, each with its reason; by the module that uses it."""

    # pitch_design.py
    factors_tried: tuple[float, ...] = (0.5, 0.7, 0.85, 1.0, 1.15, 1.3, 1.5)
    """Multiples of a formula's difference that are searched."""
    refined_steps: tuple[float, ...] = (0.08, 0.04)
    """Steps about the best multiple, one after the other."""
    ground_angle: float = math.radians(0.1)
    """Pitch angles are rounded to this: no finer can be ground."""
    loose_tolerance: float = 1e-2
    """Tolerance of the limits during the search; those of the result are converged to 1e-3."""

    # problem.py
    edge_size: float = 0.15
    """Share of its peak below which a compliance should be at its last sample."""
    edge_phase: float = 0.3
    """Share of the imaginary part below which a compliance should be at its first sample."""
    active_share: float = 0.05
    """A compliance that gives energy by more than this share of its size is not that of a passive machine."""
    beyond_noise: float = 4.0
    """Standard deviations that noise alone may make of a passive machine."""
    gap_factor: float = 1.5
    """A step longer than this many neighbouring steps is a gap: a logarithmic grid is not, a dropped row is."""


RULES = ProblemRules()
