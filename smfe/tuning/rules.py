"""Numbers that decide in the search for gains."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TuningRules:
    """Tunables of the room, each with its reason."""

    # The grid of frequencies.
    lowest: float = 5e-3
    """Where it begins, as a share of the lowest mode: integral times of seconds still show there."""
    highest: float = 12.0
    """Where it ends, in the highest mode or crossover: there the masses alone count, and the phase has settled."""
    coarse: int = 500
    """Points while gains are searched."""
    fine: int = 1600
    """Points where they are polished and judged."""

    even: tuple[float, float] = (0.05, 8.0)
    """Ends of the even grid for lobes, in the lowest and the highest mode: the cut knows nothing beyond."""
    even_points: int = 4000
    """Points of it: a step is some tenth of a per cent."""

    # What is tried, in coordinates without unit.
    slowest_crossover: float = 0.05
    """Least Kp over the moving mass [rad/s], as a share of the lowest mode's frequency."""
    fastest_crossover: float = 12.0
    """Largest Kp over the moving mass [rad/s], in the same."""
    delayed_crossover: float = 1.2
    """The same times the dead time [rad]: beyond pi/2 a rigid mass is unstable."""
    integral: tuple[float, float] = (0.3, 50.0)
    """Ti times Kp over the moving mass."""
    position: tuple[float, float] = (0.01, 1.5)
    """Kv over (Kp over the moving mass)."""

    # The search.
    population: int = 40
    """Candidates a generation, times the axes."""
    generations: int = 120
    """Of the global search, at most."""
    clouds: int = 40
    """Rounds of the local search, each in a smaller box; on the fine grid and for a compromise half as many."""
    cloud: int = 60
    """Candidates a round, times the axes."""
    fine_parts: int = 4
    """Parts into which the search on the fine grid is told."""
    shrink: float = 0.85
    """How much smaller."""
    spare: float = 4e-3
    """By how much the limits in decibels are kept while polishing [dB], so that the answer keeps them to the digit."""

    worth: float = 0.25
    """A compromise with the tracking error may cost all of the goal but this share."""
    deepest: float = 1.0
    """A depth without limit counts as this [m]."""


RULES = TuningRules()
"""What is used."""
