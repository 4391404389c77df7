"""Numbers of this room that were chosen, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DriveRules:
    """What counts as motion, as a Stribeck curve, as a ripple, and what is stated of a drive."""

    resolved_velocity: float = 10.0
    """Velocity of a steady run, in standard deviations from zero, at least."""

    acceleration_sigmas: float = 4.0
    """Change of the velocity within a window, in standard deviations, that is no acceleration."""

    least_samples: int = 20
    """Samples of a steady run, at least."""

    weak_line: float = 1e-4
    """Power of a line of the setpoint, of the strongest, below which it is not excited: -40 dB."""

    loop_neighbours: int = 21
    """Lines over which the roughness of a response of one period is a median."""

    compared_band: float = 2.0
    """Directions are compared up to so many bandwidths."""

    surroundings: int = 101
    """Lines that are the surroundings of a resonance beyond the bandwidth."""

    stands_out: float = 10.0
    """Gain over that of its surroundings from which such a resonance is named: 20 dB."""

    widest_band: float = 50.0
    """Highest frequency [Hz] of the balance unless another is asked for: above, an axis is not rigid."""

    band_share: float = 0.1
    """Highest frequency of the balance, of the sampling rate."""

    acceleration_noise: float = 0.02
    """Largest share of encoder noise in the acceleration, root mean square."""

    standstill: float = 0.002
    """Speed, of the greatest, below which an axis stands still."""

    speed_sigmas: float = 6.0
    """Standard deviations of the encoder noise in the velocity below which an axis stands still."""

    standstill_weight: float = 0.01
    """Largest weight of standstill in the low-pass of a value that is kept."""

    wider: float = 4.0
    """Band of the velocity that decides between motion and rest, of the band of the balance."""

    every: float = 0.3
    """Time between two kept values, of a period of the band."""

    finest: float = 1e-9
    """Least resolution of an encoder over its stroke."""

    least_values: int = 30
    """Values of motion that a balance needs."""

    excited: float = 1e-3
    """Amplitude of a line of the force, of the largest, from which it is excited."""

    open_loop_neighbours: int = 9
    """Lines over which the power of the noise is a mean."""

    difference: int = 5
    """Lines of the difference that removes a smooth response and leaves distortion."""

    distortion_lines: int = 41
    """Lines over which the distortion is a median."""

    clear_line: float = 16.0
    """Power of a line of the vibration velocity, of that of its noise, from which friction is told what it does."""

    unfiltered: float = 0.4
    """Highest frequency of that velocity, of the sampling rate."""

    distorted: float = 1.5
    """Misfit over noise from which the distortion between neighbouring lines counts as well."""

    changed: float = 0.3
    """Correlation of the changes of a force with themselves below which it has changed."""

    repeats: float = 0.3
    """Correlation of the changes of a force from which it repeats itself: noise of four times their power."""

    nearly: float = 0.85
    """Correlation, of the greatest, from which a lag may be the period: later ones are its multiples."""

    widths: tuple[int, ...] = (1, 4, 16)
    """Samples over which changes of a force are taken to find its period, one after the other."""

    guess_error: float = 0.05
    """Relative error of a line that a first guess takes for exact."""

    guess_delays: tuple[float, ...] = (0.0, 0.3e-3, 0.8e-3, 1.6e-3)
    """Dead times that a first guess tries [s]."""

    stopped: float = 0.01
    """Share of the time at a velocity near zero from which an axis counts as stopped."""

    slow: float = 0.05
    """Velocity, of the feed, that is near zero."""

    largest_misfit: float = 3.0
    """Misfit above which `open_loop.fit_open_loop` refuses: Eq. (2) is then not what was measured."""

    time_base: float = 0.05
    """Samples to which the delay of the low-pass of a drive is known."""

    hidden: float = 0.3
    """Share of encoder noise in the acceleration that no friction explains above which there is no inertia."""

    curve_probability: float = 0.99
    """Probability of a Stribeck curve from which on it is stated."""

    widest_interval: float = 4.0
    """Largest ratio of the ends of an interval of the Stribeck speed that is stated."""

    resolved_speed: float = 1.5
    """Least Stribeck speed that is stated, over the slowest motion."""

    least_spread: float = 0.01
    """Least relative error of static friction and Stribeck speed: the law near rest is no better known."""

    drawn: int = 48
    """Stribeck curves over which the parameters are averaged."""

    stages: int = 3
    """How often the grid of Stribeck curves is refined."""

    shown: int = 600
    """Values of friction over velocity that are written."""

    unexplained: float = 0.3
    """Share of the drive force that the balance leaves from which a warning is given."""

    level: float = 0.95
    """Probability of the intervals."""

    most_waves: int = 3
    """Waves along the stroke that are looked for."""

    false_wave: float = 1e-3
    """Probability with which noise alone makes a wave."""

    most_tried: int = 400
    """Wave numbers that are tried."""

    most_values: int = 3000
    """Values of the balance that they are tried on."""

    roll: float = 8.0
    """Band of the low-pass over the width of its edge (`smfe.identification.spectra.low_pass`)."""

    shapes: tuple[float, ...] = (1.0, 1.2, 1.4, 1.6, 1.8, 2.0)
    """Exponents of the curve: 1 of Table 1 of Franco et al. 2024, 2 of Armstrong-Helouvry 1991."""

    speeds: int = 18
    """Speeds of the coarse grid."""

    fine_speeds: int = 12
    """Speeds of a refined grid."""

    narrow: float = 6.0
    """Ratio of speeds that one refined grid covers."""

    near: float = 1.5
    """Ratio of speeds near the best one, where a refined grid is dense."""

    curved: float = 0.5
    """Probability of a Stribeck curve before the record."""

    negligible: float = 1e-4
    """Probability of a speed, of all, that a refined grid leaves out."""

    rare: float = 0.5
    """Probability of a curve below which its speed is not refined."""

    slowest: float = 0.004
    """Least Stribeck speed that is looked for, of the fastest motion."""

    fastest: float = 0.5
    """Greatest Stribeck speed that is looked for, of the fastest motion."""

    faded: float = 1e-3
    """Largest value of a curve that has faded before the slowest motion."""

    block: float = 0.05
    """Shortest block of a run at constant velocity [s]."""

    most_blocks: int = 60
    """Blocks of a run, at most."""

    least_blocks: int = 4
    """Blocks of a run, at least."""

    steady_share: float = 0.8
    """Share of the time at constant velocity from which records are runs at constant velocity."""

    least_feeds: int = 4
    """Different speeds of a direction that a friction curve needs."""

    borrowed: float = 4.0
    """Degrees of freedom of the noise of all runs that the noise of each one borrows."""

    below_slowest: float = 0.3
    """Least Stribeck speed that is looked for, of the slowest run."""

    steady_speeds: int = 40
    """Speeds of a grid of Stribeck curves for runs at constant velocity."""

    steady_turns: int = 3
    """Turns in which curves and scatter from run to run are found."""


RULES = DriveRules()
