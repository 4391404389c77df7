"""The numbers of the diagnosis of cuts that somebody chose, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CuttingRules:
    """Floors, lines and limits of cutting forces and stability limits."""

    # forces: the limits of what is declared count one standard deviation each
    undeclared: float = 0.3  # prior standard deviation of a coefficient that nobody gave, over the largest one
    least_coefficient: float = 0.1  # share of the largest coefficient that the tolerance of a smaller one counts from
    least_coefficients: tuple[float, float, float] = (0.0, -0.3, -1.0)
    """Least tangential, radial and axial coefficient over the largest that was given: a chip pushes the edge away, but
    for a keen edge of high rake; the axial force may point either way. Exchanged axes are, to the last digit, one
    reversed axis with tangential and radial coefficient exchanged and one of them negative."""
    exact: float = 0.002  # standard deviation of coefficients that are declared to be exact
    edge_scatter: float = 0.3
    """Relative standard deviation of a declared edge force whose material states none: the intercept of a line through
    forces over the chip, which no cut reaches, is several times as uncertain as its slope, and an edge that wears
    raises it first."""
    seat: float = 0.05  # standard deviation of the radius of a tooth, over the run-out that was declared
    depth: float = 2e-5  # standard deviation of the depth of a cut [m]
    harmonics: int = 7  # of the mains
    most_free_teeth: int = 8  # whose radii are found one by one
    angles: int = 360  # of one revolution, where the start of a record is looked for
    reference_chip: float = 5e-5  # chip thickness [m] at which a size effect leaves the coefficients as they are
    force_floor: float = 0.05
    """Share of each order that a mechanistic model may miss, see `orders`."""
    resonance_from: float = 12.0
    """Least first resonance of a dynamometer over the tooth passing whose orders are taken as they are."""
    leak: float = 0.01  # share of the rms along all axes that it may miss of every order, likewise
    most_cross_talk: float = 0.1  # share of another axis that a channel may show; piezoelectric sensors show 0.02
    mains: tuple[float, ...] = (50.0, 60.0)  # lines that are looked for [Hz]
    tooth_orders: int = 6  # orders of tooth passing that count
    block: int = 4  # revolutions of a block
    resonances: int = 60  # of a dynamometer that are tried on each axis
    least_revolutions: int = 40  # of a record
    line_found: float = 6.0  # standard deviations of a line of the mains
    beside: float = 8.0  # independent powers of noise beside a line
    # limits
    common: float = 0.4  # prior standard deviation of the stiffness of all modes together, over that of each
    limit_floor: float = 0.01
    """What a limit is trusted to beside its bracket, relative: what a converged prediction is off by, and forces of
    repeated cuts. The depth that is set and the step of the ladder count by themselves."""
    mesh_error: float = 0.015  # largest relative error of the limit on the mesh of a fit that is taken for its own
    floor_of_correction: float = 0.25
    """Share of the (log of the) correction of the zero-order limit that is added to it."""
    most_corrected: float = 0.3  # logarithm of the correction beyond which zero order does not describe a cut
    roughly: float = 0.4
    """Standard deviation of the logarithm of a limit that zero order does not describe. With two teeth at half
    immersion and modes known within 0.5 %, 20 % and 2 % seven such limits were missed by 0.13 to 0.81, 0.44 rms."""
    little_corrected: float = 0.1  # logarithm of the correction up to which a corrected zero-order limit will do
    steps_a_radian: float = 0.5  # of a mesh, for each radian that the fastest mode turns in the cut
    spare_steps: float = 7.0  # beyond those: the limits are then well within the `limit_floor` of converged ones
    even_steps: int = 6  # the steps are a multiple of it, so that a parameter that moves hardly changes the mesh
    angles_of_circle: int = 16  # of the multiplier at which crossings are looked for, besides those about the modes
    finer: int = 4  # times as many where these do not find the first one
    far_deeper: float = 8.0  # depth, over the one down to which crossings are looked for, where there is none
    alike: float = 0.02  # relative difference of zero-order and converged chatter frequency of one crossing
    frequency_floor: float = 0.003  # of a chatter frequency, relative: a cut that chatters is deeper than the limit
    near: float = 0.1  # share by which a crossing deeper than the first may be the one that was observed
    near_observed: float = 0.02  # relative distance of its frequency from the one observed
    surely_below: float = 0.997  # share of a first limit at which the cut must be stable
    loudest: float = 1.0
    """Logarithm of the size of a line over the largest at a crossing by which another may be the one observed: a cut
    chatters with lines that lie a tooth passing apart, and which is the largest depends on where they are measured."""
    harmonics_of_chatter: tuple[int, ...] = (1, 2)  # of the vibration, whose lines a record of chatter shows
    passings_away: int = 3  # tooth passings from that vibration at which its lines are still large
    same_line: float = 0.6  # distance of lines that are one, in lines that a record resolves
    not_observed: float = 3.0  # of these together, beyond which a crossing is not the one observed
    deepest_observed: float = 2.0  # depth over that of a limit, down to which its crossings are looked for
    deepest_followed: float = 1.5
    """Depth over that of the first of a baseline, down to which its crossings are followed: one beyond the first
    by more is `near` it in no cut that is nearly the same, and where one comes first the others are looked for anew."""
    kept_cuts: int = 200  # converged limits that are kept for their slopes
    missing_from: tuple[float, float] = (1.6, 0.45)  # starts of a missing mode, over the ends of where it may be
    missing_step: float = 0.1  # logarithm of their distance
    in_a_peak: float = 0.1
    """Share of the compliance of a mode along another in whose peak it lies from which it is not seen apart from it."""
    softest: float = 0.05  # share of its stiffness that a mode keeps at any speed, far beyond those that were cut at
    softened: float = 0.05  # share of its frequency that each mode has more or less at the highest speed, likewise
    turned: float = 0.4  # angle of one mode from which a fit of coupled axes begins, either way [rad]
    flank_friction: float = 0.3  # friction coefficient between flank and work
    minutes: float = 20.0  # to bracket a limit


RULES = CuttingRules()
