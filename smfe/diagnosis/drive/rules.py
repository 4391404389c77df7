"""The numbers of the diagnosis of drive records that somebody chose, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DriveRules:
    """Band, moves, noise and checks of a drive record."""

    # channels and moves
    inertial: float = 0.3  # least share of inertia in the drive force that says what mass is moved
    mass_factor: float = 10.0  # moved over known mass, or the inverse, that no error of either explains
    received: float = 0.3  # share of its work that an axis gives back at most: four moves give back an eighth
    fewest_moves: int = 4  # so that one can be held out
    rest: float = 0.02  # share of the greatest speed below which an axis rests
    longest_move: float = 2.0  # [s], longer ones are cut
    shortest_move: float = 0.2  # [s], shorter ones are left out
    standing_time: float = 0.01  # [s] for which an axis that stands does so
    standing_share: float = 0.005  # of the way at the greatest speed that an axis which stands may make good
    least_moving: float = 0.5  # share of the low-pass over a value in which the axis must move for it to be used
    settling: float = 0.05  # part of a rest [s] that belongs to the move beside it
    # band and filters
    widest: float = 0.1  # band in units of the sample rate
    above_noise: float = 200.0  # force over what the reference leaves, in power, where a record can be used
    beyond: float = 2.5  # times the band up to which a tone is looked for that may end it
    below_mains: float = 40.0  # [Hz] up to which it is in any case: mains hum of 50 Hz is ordinary
    worth_a_band: float = 0.5  # share of what is material, from which they widen it
    above_line: float = 1.25  # frequency over that of a tone which the low-pass must pass
    above_line_noise: float = 20.0  # as `above_noise`, where that is needed to reach a tone
    resolution: float = 5.0  # of power densities [Hz]
    wide: float = 0.2  # of the sample rate: band in which reversals are looked for
    trembles: float = 4.0  # standard deviations of the encoder noise that are no reversal
    finest_slide: float = 1e-6  # shortest distance [m] over which friction gives way
    kept_directions: int = 8  # of one record
    near_rest: float = 0.2  # of the greatest speed, over which friction changes near rest at most
    smooth_sign: float = 2e-4  # v0 [m/s] of tanh(v/v0)
    longest_delay: float = 8e-3  # loop delay that is looked for [s]
    same_step: float = 1e-4  # by which sample intervals of two records may differ: clocks, and digits of a time column
    closed_loop: float = 1.0 / 6.0  # share of the angle by which noise turns the force at the end of the band, 1 sigma
    # noise
    order: int = 10  # of the autoregression, at most
    reference_speeds: tuple[float, ...] = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.35, 0.65, 1.0)
    """Nodes of the reference, over the greatest speed."""
    reference_positions: int = 8  # nodes of the reference along the stroke
    drawn: int = 16  # records of noise that correct a whitener
    rounds: int = 5  # of that correction
    settles: int = 200  # values before noise that is drawn is stationary
    noise_draws: int = 40  # noises that a record could as well have come from
    fades: int = 200  # values before the first by which the noise has forgotten how it began
    values_each: int = 10  # fewest values for each regressor of the reference
    like_all: float = 10.0  # values for which the noise of a kind of move is held to be that of all
    kept_forces: int = 8  # of a record
    # what stands out
    cut_off: float = 0.5  # least share of the force beyond a limit that must be lost
    limits: int = 80  # that are tried
    least_limit: float = 0.01  # of the largest force
    lowest_limit: float = 0.8  # times the limit that was found: the lowest that is fitted
    bins: int = 16  # of the phase in the shortest wave
    speeds: int = 64  # groups of values that are as fast
    at_once: int = 2_000_000  # values of waves in memory
    hopeful: int = 200  # waves that are looked at more closely
    certain: float = 1e-8  # p-value of a wave with a whitener that was learned without it
    beside_line: tuple[int, ...] = (3, 4, 5, 6)  # turns in a move by which frequencies beside a tone are off
    lowest_tone: float = 3.0  # [Hz]; the moves are slower
    stands_out: float = 5.5  # standard deviations of a force that lasts a moment
    # control law
    taps: int = 4  # of the velocity filter
    ahead: int = 3  # samples by which a feed-forward may look ahead
    integral: int = 4  # columns of an integral part: integral, reference, what it is held from, constant
    nothing: float = 0.02  # share of the rms of the force below which a law leaves nothing anywhere
    limits_tried: int = 60  # commands from which on an integral part may stand still, before the best is refined
    lowest_held: float = 0.05  # the least of these over the largest command
    held: float = 0.5  # share of what a law leaves that one whose integral part stands still may leave
    apart: float = 0.5  # time over which such a law is off alike [s]
    better: float = 1.2  # times what the best law leaves, up to which a simpler one is taken
    absolute: int = 60  # rounds of least absolute values
    values_absolute: int = 20_000  # values that are enough for them, evenly spaced
    trim: float = 6.0  # standard deviations beyond which a value does not count
    detect: float = 10.0  # standard deviations of a command that was not logged
    top: float = 0.9  # of the height of a pulse behind moving means, from which it counts as its height
    pulse_share: float = 0.02  # of the highest pulse, from which others count
    shortest_pulse: int = 3  # [samples]
    shortest: float = 0.02  # time for which a material force has the least impulse of a pulse [s]
    told: float = 5e-3  # standard deviation of the gains that an exact law shows [1]
    off: float = 3.0  # the same over the share that a law leaves: of twelve records the rms was 1.7, the worst 3.4
    means: tuple[float, ...] = (0.02, 1.0 / 60.0)  # moving means behind which gains are found: turns of the mains [s]
    slow_mean: float = 0.2  # what is slower is left out, too [s]
    gains_every: float = 5e-3  # between values for the gains [s]
    same_gain: float = 0.25  # by which the velocity gain of a law may differ from that behind a band-pass [1]
    vague: float = 0.05  # standard deviation beyond which gains are not told [1]
    even: float = 0.02  # share of their height by which pulses differ
    floor: float = 1e-8  # of the noise over the range of the force


RULES = DriveRules()
