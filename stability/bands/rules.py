"""The chosen numbers of the bands, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class BandRules:
    """Settings, each with its reason; by the module that uses it."""

    # depth_quantiles.py
    crossings: int = 8
    """Crossings a speed that may become the lowest, in the linearised way."""
    most_bias: float = 0.5
    """Largest correction for the median, in standard deviations; an estimate of infinity is not corrected at all."""
    reach: float = 8.0
    """The quantiles of a mixture are sought this many standard deviations beyond its samples."""
    halvings: int = 20
    """Of that interval, before two steps of Newton: to 1e-9 of the depth."""
    linear_draws: int = 2000
    """Draws of the linearised errors; they cost next to nothing."""

    # error_model.py
    level_width: float = 6.0
    """The level of the errors is averaged over this many shared widths: a few repeats know that of one line badly."""
    most_missing: float = 0.1
    """Share of the frequencies at which a standard deviation may be missing; there it is interpolated."""


RULES = BandRules()
