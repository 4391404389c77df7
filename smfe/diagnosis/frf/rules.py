"""The numbers of the diagnosis of compliances that somebody chose, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FrfRules:
    """What the comparison of compliances with a simulation takes for granted."""

    most_lines: int = 120  # lines of a condition that are compared, at most
    lowest: float = 5.0  # frequency from which an axis is compared [Hz]
    reach: float = 3.0  # ... and to which, over the frequency of the locked axis: beyond, two masses do not describe it
    floor: float = 0.002
    """Least standard deviation relative to the compliance: a difference of a line that no model is expected to meet."""
    fewest_hits: int = 3  # hits from which their scatter is known
    shared: float = 2.0  # factor on the variance that hits share: it comes from three or four of them only
    own_noise: float = 3.0
    """Standard deviations of a line from what its neighbours say of it below which it is taken for noise: of one line
    in 400 (with two neighbours that are as noisy) more is left."""
    smooth_lines: int = 15  # lines over which the variance of noise is averaged
    correlated: float = 1.88
    """Variance of second differences over that of independent ones: 1 + 2 (4/9 14/15 + 1/36 13/15)."""
    smooth_shapes: int = 4
    """Cosines over the logarithm of frequency that the difference between model and machine is made of."""
    discrepancy: float = 0.004
    """Root mean square of the smooth relative error by which two simulations of one machine may differ."""
    stiff_axis: float = 0.2
    """Compliance over the largest of any axis below which that of an axis, and what is of its size, counts as so much:
    of an axis that is much stiffer than another even a large error limits no depth."""
    arm: float = 0.3
    """Distance over which a machine turns about as much as it moves [m]: a hit 3 mm beside its point is 1 % off."""
    mains_width: float = 1.5  # on either side of the mains' harmonics: lines that hum may reach [Hz]
    model_error: float = 0.002
    """Rms relative error of predictions that looks like a change of the parameters: between single hits in motion in
    two simulations of one machine 0.1 to 0.2 %, half of it from a sampled servo taken for a continuous one."""
    roughness: float = 1.0
    """Distance of predictions from a smooth function of the parameters, in noise: measured on a hit of 400 N that
    breaks the guideway away at rest; it stays with ten times the accuracy."""
    unsure: float = 0.5
    """Share of what the mean of the hits has more than the mean hit that is uncertain because the baseline is."""
    rate: float = 2000.0  # samples and steps a second of a simulated hit [Hz]
    steps_per_pole: float = 25.0
    """In a period of the fastest pole as declared: below 20 the simulation takes shorter ones."""
    accuracy: float = 1e-4
    """Of friction in a step; with 5e-4 some hits that break the guideway away jump with the parameters."""
    contact_time: float = 4e-3  # of the hit on a linear machine, whose compliance does not depend on it [s]
    block: int = 64  # samples that are transformed at once
    rest: float = 1e-7  # of a machine after a hit, next to its largest: a tenth of what the step costs in a hit of 25 N
    held: tuple[float, float] = (1e-5, 0.02)
    """Of a slide that its guideway holds: velocities after a hit next to their largest, and what the servo still winds
    up by next to the largest force: what a slide that is held creeps by is a tenth of `floor` at the most."""
    period: float = 0.58
    """Standard deviation, about none, of the period of a control's samples over its dead time: that of what lies evenly
    between none and all of it. The gains of some controls are what acts, of others what a computer multiplies by."""
    shaken_loose: float = 0.15
    """Relative standard deviation of the force at which a guideway lets go, where hits before have shaken it loose."""
    presliding_passes: int = 3
    """Times that hits are put right with the way in which the guideway gave way the last time: on a healthy axis of
    elements the misfit fell by a third, and within a twentieth of that at the true values."""
    slipping: int = 6  # elements of a guideway that slips with some instead of a bristle
    well: float = 20.0  # squares over the noise of a line that hits at rest may leave without their own stiffness
    noise_alone: float = 1.5  # squares over the noise of a value from which another friction is looked for
    nearly_all: float = 0.1  # of what a baseline without dry friction leaves, that one with it may leave
    levels: tuple[float, ...] = (-0.8, -0.4, 0.0, 0.4, 0.8, 1.6)  # of friction that are tried, beyond the declared
    loads: tuple[float, ...] = (0.0, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0)  # the same over where fits begin, of undeclared
    level_known: float = 0.02  # of the step in which levels of friction are tried, to which the best is found
    stiffnesses: tuple[float, ...] = (0.7, 0.8, 0.9, 1.1, 1.2, 1.3)  # that are tried at rest, over that of the values
    pulls: int = 9  # of the drive on an axis at rest that are tried first, and at most besides near the best of them
    pulls_roughly: tuple[float, ...] = (0.0, -0.6, 0.6, -0.95, 0.95)  # ... over what is held, beside other stiffnesses
    pull_known: float = 0.01  # of what is held, to which a pull is found: 7 % off left five times the noise of a hit
    pull: float = 0.5
    """Standard deviation of the pull of a drive at rest over what its guideway holds: between a servo that has wound up
    evenly (0.58) and one that stands well (0.3)."""
    same_level: float = 0.2  # relative difference of levels of hits that are meant to be the same
    along_list: float = 0.7
    """Correlation with its place in the list from which what measurements differ in goes along with the list."""
    contact: float = 2e-9  # compliance of a guideway that sticks [m/N], where nothing is seen of it
    contact_axis: float = (
        1.68e6  # ... of an axis of this stiffness [N/m]: the stiffer the axis, the stiffer its guideway
    )
    contact_spread: float = 10.0  # prior standard deviation of it, over itself: guideways differ by factors
    contact_loss: float = 1.2e-4  # its damping over its stiffness [s]
    elements: int = 20  # Jenkins elements of a joint with micro-slip
    hit_elements: int = 40  # the same in hits on modes: each that begins to slip bends a slope a little
    largest_share: float = 0.95
    """Share of the stiffness that they are at most: a machine that lost more than it has would push itself away."""
    steps_a_period: float = 16.0  # of the highest mode that moves a joint in a hit: 1 % of what the joint does
    died_away: float = 0.03  # amplitude of the slowest mode over its first at which the simulation of a hit ends
    least_steps: int = 64  # of such a simulation
    most_steps: int = 20000
    least_pulse: float = 2.0  # steps of the shortest hit: a shorter one is an impulse to the machine
    excited: float = 0.1  # spectrum of a hit over its impulse below which nothing is asked of a joint
    predictions_kept: int = 20000  # compliances that a family keeps
    modal_kept: int = 4000  # the same of a modal machine, whose compliances are closed form
    # a mode that nobody declared, as compliances show it by themselves
    further_damping: tuple[float, ...] = (0.005, 0.01, 0.02, 0.04)  # ratios that are tried, at each width
    further_own: float = 1e-6  # share of the square of a pole that known ones must leave
    further_lines: int = 1500  # of a compliance that are looked at
    further_rounds: int = 4  # in which declared poles are brought to where they are
    further_off: float = 0.015  # as far as they are at most, relative
    further_of: int = 3  # measurements
    further_share: float = 0.2  # of what they leave there, which it must explain
    machines_kept: int = 40  # machines that are kept with what was prepared for their hits


RULES = FrfRules()
