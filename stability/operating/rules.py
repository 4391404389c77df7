"""The chosen numbers of limits at an operating point."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class OperatingRules:
    """Settings, each with its reason."""

    reach: float = 10.0
    """Limits are looked for from this share below the lowest pole to this multiple of the highest."""
    density: float = 5.0
    """Frequencies a doubling of the distance from a pole, in half-power widths."""
    harmonics: int = 15
    """Highest harmonic of the motion of a guideway that comes to rest: depths within 0.5 % of those of 40."""
    rounds: int = 10
    """Rounds between harmonics and the limit."""
    shares: int = 25
    """Rounds in which several guideways settle how they share the motion."""
    same_coefficient: float = 1e-4
    """Relative change of the coefficients at which the rounds end."""
    nearly_same: float = 5e-3
    """Relative change of the coefficients at the last round above which a vibration counts as not found."""
    newton_steps: int = 6
    """Newton steps from a limit to its neighbour."""
    near_rest: float = 0.9
    """Amplitude over the feed above which a guideway comes so near to rest that its harmonics are solved for."""
    amplitudes_of_a_feed: tuple[float, ...] = (0.5, 0.85, 1.0, 1.1, 1.25, 1.45, 1.7, 2.0, 2.4, 3.0, 4.0, 6.0)
    """Amplitudes of a guideway, over its feed, between which the lowest limit is looked for."""
    amplitudes_at_rest: int = 14
    """Amplitudes of a guideway at rest, or of a joint."""
    slow: float = 0.5
    """Feed below which a guideway counts as at rest, over the speed 1/kt in which its friction rises."""
    joint_amplitudes: tuple[float, float] = (1e-5, 0.1)
    """Speeds of a joint's two sides against each other [m/s]."""
    largest_swing: float = 1.5
    """Swing of the chip thickness over the feed per tooth beyond which no cycle is looked for."""
    refinements: int = 5
    """Steps in which the lowest limit is closed in on."""
    no_lower: float = 2e-3
    """A lower limit this near to that of a small disturbance is none."""
    pieces_of_a_level: int = 4
    """Pieces of each interval between measured levels in the search for roots and for the least limit."""
    kept_conditions: int = 64
    """Measured conditions whose eigenvalues are kept for the next speed."""
    same_limit: float = 1e-9
    """The same for a measured compliance, which is not searched but read."""
    shaken: float = 1.0
    """Speed of the forced vibration of a guideway over its feed above which it comes to rest in every tooth period."""
    free_of_friction: float = 10.0
    """Feed [m/s] at which only the viscous friction is left."""
    lowest_frequency: float = 0.5
    """Poles below this are creep [Hz]."""


RULES = OperatingRules()
