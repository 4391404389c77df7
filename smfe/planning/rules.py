"""Numbers that decide in a plan: what is tried, how finely it is worked out, and what is promised."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlanRules:
    """Tunables of the room, each with its reason."""

    # What is tried.
    widths: tuple[float, ...] = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 0.95)
    """Widths of cut, as shares of the diameter."""
    feeds: int = 4
    """Feeds per tooth."""
    beyond: float = 1.0
    """How far a sweep goes beyond the band at either end [Hz]: as far as the estimator takes lines for its model."""
    depth_step: float = 0.1e-3
    """Depths are rounded down to this [m]."""
    shortest_pass: float = 10.0
    """A pass in less time [s] is no sweep: the resonances would not rise."""

    # How alternatives are ranked.
    ranking_lines: int = 15
    """Frequencies at which alternatives are ranked."""
    ranking_band: float = 4.0
    """Half width of the band in which alternatives are ranked [Hz]: the widest of the estimator, near its model."""
    ranking_speeds: int = 25
    """Spindle speeds of a sweep at which the zero-order method is asked."""

    # How the best of them are worked through.
    refined: int = 10
    """Alternatives that are worked through as the estimator will."""
    most_refined: int = 40
    """The same where none of the first keeps what is asked."""
    modal_limit_speeds: int = 15
    """Speeds of a sweep at which semi-discretisation gives the limit depth of modes: some milliseconds each."""
    measured_limit_speeds: int = 7
    """Speeds at which the multi-frequency method gives that of a measured compliance: a third of a second each."""
    drawn_depths: int = 9
    """Depths of cut at which the prediction holds the force level."""
    angles: int = 360
    """Angles within a tooth period at which the force is sampled for its peak."""
    thin_chip: float = 10e-6
    """Chips thinner than this [m], about the radius of a sharp edge, are not cut as the coefficients say."""

    # The expected error.
    confidence: float = 0.95
    """Probability of the interval in which the error of an entry will lie."""
    confirmed: float = 0.95
    """Probability with which all entries of a right prediction lie in their intervals."""
    unknown: float = 0.1
    """Relative standard deviation of the expected error itself: forces by cutting coefficients that are known to a
    tenth, poles and orders that the noise chooses."""
    band_points: int = 16
    """Points at which a band is sampled, at least; as many a Hertz of half width."""
    bin_points: int = 3
    """Points of Gauss at which a bin of the rational model is sampled."""
    bin_width: float = 1.0 / 16.0
    """Width of a bin [Hz], that of the estimator; also the step of a measured estimate without its noise."""

    # The estimate of the machine.
    rigid: float = 0.1
    """An axis is compared with at least this share of the softest one: errors of a rigid axis matter little."""
    axis_step: float = 0.1
    """Step of the frequency axis on which a machine with axes is taken [Hz]."""
    margin: float = 4.0
    """How far beyond the band a measured estimate reaches, where something was measured there [Hz]."""
    least_error: float = 1e-3
    """Error over the rms of a row that a measured compliance has at least."""


RULES = PlanRules()
