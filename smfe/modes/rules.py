"""Numbers that decide in a modal fit: what counts as a mode, when a step has converged, what is worth a warning."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FitRules:
    """Tunables of the room, each with its reason."""

    # What was measured.
    fewest_lines: int = 12
    """Below this number of frequencies no fit is tried."""
    unknown_share: float = 0.1
    """Noise that was not measured is taken as this share of the local magnitude: what lies below it calls for no more
    poles. It is a weight, no error: intervals come from the residual."""
    unknown_lines: int = 150
    """A record without measured noise counts as no more independent lines than this."""
    smoothing: int = 9
    """Lines over which a mean square error is averaged: one from a few repeats scatters itself."""
    mirrored: float = 1e-6
    """Mirrored entries with less than this share of their variances left in their difference were made equal."""
    smallest: float = 1e-9
    """No error is taken to be smaller than this share of the largest value: doubles hold no more after a fit."""

    # Lines merged into one.
    enough_lines: int = 1000
    """A record with fewer lines stays as it is."""
    longest_block: int = 64
    """Most lines that are merged into one."""
    smooth: float = 0.02
    """Departure from a straight line, as a share of the size, that counts as smooth: blocks half as wide as the
    distance to the nearest pole."""
    departure: float = 2.5
    """Standard deviations by which the power of the departure may exceed that of the noise."""
    departure_of_few: float = 5.0
    """The same for blocks of few lines: leaving those apart that scatter most would select the largest errors."""
    few: int = 4
    """Lines of such a block."""
    widest: float = 0.02
    """No merged line is wider than this share of its frequency."""

    # Poles and remainders.
    upper_at: float = 4.0
    """Frequency of the mode that stands for all modes above the band, over that of the last line."""
    upper_damping: float = 0.2
    """Its damping ratio."""
    lower_at: float = 1e-4
    """Frequency of the mode that stands for all modes below the band, over that of the first line."""
    lower_damping: float = 1e-3
    """Its damping ratio."""
    least_damping: float = 1e-5
    """Damping ratio below which no pole is moved."""
    most_damping: float = 0.7
    """Damping ratio above which no pole is moved."""
    beyond: float = 1.5
    """Poles stay between the first line over this and the last line times this."""
    mode_damping: float = 0.3
    """Poles of more damping are no modes of a machine, and are left out of the stabilisation diagram."""

    # Stabilisation diagram.
    largest_system: int = 72
    """Most unknowns of the denominator: order times excitations."""
    most_orders: int = 36
    """Highest order: a record of some tens of modes is looked at band by band."""

    # Number of modes.
    grid_damping: tuple[float, ...] = (0.02, 0.08)
    """Damping ratios of the grid of proposals: narrower modes are found place by place."""
    diagram_first: float = 0.7
    """Share of the largest gain from which on a candidate of the diagram is preferred."""
    most_places: int = 24
    """Peaks of the residual that are looked at in one round, largest first."""
    rounds: int = 10
    """Rounds in which peaks of the residual are looked at."""
    prominent: float = 2.0
    """Power of a peak of the residual over its surroundings from which on it is looked at."""
    standing: float = 0.02
    """Share of the response around it that a mode must have where no noise is known: no linear model describes all."""
    seen: float = 0.002
    """Share of the response that the residual has where it is looked at, if no noise is known."""
    pairs: tuple[tuple[float, float], ...] = ((0.15, 1.0), (0.5, 0.8), (1.0, 1.0))
    """Starts of two poles that replace one: distance from it in its half bandwidths, and their damping over its."""

    # Likelihood ratio in a window of lines.
    p_value: float = 1e-9
    """Probability that noise alone calls for a mode: a record has a thousand places to look at."""
    p_value_named: float = 1e-4
    """Probability below which a second mode is named though it is not taken as one."""
    reach: float = 8.0
    """Half bandwidths to either side of a mode that belong to its window."""
    fewest_window_lines: int = 24
    """Least lines of a window."""
    most_window_lines: int = 320
    """Most lines of a window."""
    most_window_poles: int = 5
    """Poles of a window that are refined together."""
    like_noise: float = 3.0
    """Power of a residual over that of the scatter of lines up to which it counts as noise."""
    left_alone: float = 0.5
    """Share of a residual that is more than noise which a new pole may leave."""
    left_beside: float = 0.1
    """The same within the width of another pole."""

    # Mode shapes.
    strong: float = 0.5
    """A mode is strong when its peak is above this share of the highest."""
    unresolved: float = 0.5
    """Standard deviation of a stiffness over it from which on it is not known at all."""
    second_vector: float = 0.1
    """Share of a mode's own compliance from which on a second vector is tried for its pole: hits that lean by 2 degrees
    and channels 1 % off make up to 4 % of it."""
    p_value_shapes: float = 1e-3
    """Probability that noise makes real shapes as much worse than free residues, below which poles are held."""
    not_real: float = 0.4
    """Share of a residue that is neither real nor positive from which on it is that of no mode: ordinary errors of a
    hammer test make less than 0.1."""
    fills_up: float = 0.1
    """Share of the response at its own frequency below which a pole of such a residue is no mode."""
    most_repeated: int = 3
    """Modes tried at frequencies that another mode has already, such as those of a symmetric machine."""
    no_shape: float = 0.3
    """Real shapes further from the free fit than this share of its size are not used."""

    # What is reported.
    upper_share: float = 0.01
    """What is no mode of the band goes into a modal model from this share of the largest (or median) compliance on."""
    mount_share: float = 0.1
    """Frequency over the lowest line of the masses on soft mounts that stand for the lower remainder in a model."""
    mount_damping: float = 0.01
    """Their damping ratio."""
    active: float = 0.05
    """A model that gives more energy than this share of its size is called active."""
    coarse: float = 3.0
    """A misfit above this is worth a warning."""
    named_peaks: int = 12
    """Most unexplained peaks that a warning names."""
    not_reciprocal: float = 2.0
    """Mirrored entries that differ by more than this many times their noise are called not reciprocal."""
    stands_out: float = 10.0
    """Power of a peak over the median around it from which on it is named when no mode describes it."""
    unexplained_share: float = 0.5
    """Share of the power of the response at a peak of the residual from which on the peak is unexplained."""


RULES = FitRules()
