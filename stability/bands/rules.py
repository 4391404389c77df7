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

    # critical_crossings.py
    alike: float = 2e-3
    """A crossing that lies as close to a limit, relatively, is that of the limit."""
    apart: float = 2e-2
    """Crossings that differ by less in angle [rad] and, relatively, in depth are one."""
    angle_step: float = 1e-5
    """Share of the angle, or of what is left to a half turn, over which the derivative by it is a difference."""
    reach_step: float = 1e-4
    """Share of the depth over which the derivative by the reach of helical edges is a difference."""

    # converged_band.py
    own_draws: int = 1000
    """Draws of the linearised errors of a converged limit."""
    deviations: float = 3.5
    """Crossings are looked for so many standard deviations of the limit above it..."""
    reach_above: tuple[float, float] = (1.1, 2.5)
    """... but at least and at most up to these multiples of it."""
    least_share: float = 1e-4
    """Lines that give less of the variance are left out."""

    # error_model.py
    level_width: float = 6.0
    """The level of the errors is averaged over this many shared widths: a few repeats know that of one line badly."""
    most_missing: float = 0.1
    """Share of the frequencies at which a standard deviation may be missing; there it is interpolated."""


RULES = BandRules()
