"""The numbers by which a sweep is judged, together: each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SweepRules:
    """Numbers of the modules of the sweep, none of which depends on the machine."""

    # --- sweep
    warn_condition: float = 30.0
    """Above this condition number of the forces a frequency is reported as badly conditioned."""
    refuse_condition: float = 200.0
    """Above this condition number a frequency is not solved."""
    # --- passes
    air_margin: float = 0.1
    """Time that is left out on either side of the cut [s]."""
    shortest_air: float = 0.2
    """Air in one piece from which a spectrum is taken [s]."""
    # --- noise
    floor_window: float = 1.0
    """Pieces of the cut in which its floor is looked for [s]."""
    noise_scatter: float = 0.1
    """Relative standard deviation of a noise power that no number of lines takes away: it need not be white."""
    bounded_scatter: float = 0.8
    """Relative standard deviation of a noise power of which only a bound is known."""
    same_air: float = 2.5
    """Pieces of air belong to the quietest while the logarithm of their power is within so many standard
    deviations."""
    coherent_p_value: float = 1e-3
    """p-value of independent noise below which a coherence of two rows counts."""
    # --- local_polynomial
    noise_reach: float = 2.0
    """Noise powers of the motion are the median over this distance to either side [Hz]."""
    same_entry: float = 5e-4
    """Relative difference below which two estimates of an entry are the same, however quiet the sensors. An entry
    known to a thousandth must not keep the rest of its row, which is not, from a wide band."""
    model_error: float = 2e-4
    """What the estimate errs by with sensors without noise, as a share of the rms of a row [1]. Force linear
    between samples, a compliance that is a polynomial within a band, ends of records: median 0.5 to 2 parts in ten
    thousand in sweeps of 10 to 30 s of twelve machines. No interval is narrower."""
    most_open: float = 0.3
    """Share of the compliance that the noise of the forces may leave open; above, a frequency is not solved."""
    largest_noise_share: float = 0.7
    """Share of noise in the weakest direction of the forces above which a frequency is not solved."""
    lack_reach: float = 4.0
    """Distance to either side over which what a model lacks is pooled [Hz]."""
    false_alarm: float = 0.01
    """Probability with which noise makes a row of a rational model that is right disagree with a band anywhere."""
    # --- spindle_orders
    instrument_harmonics: int = 3
    """Harmonics of the tooth passing that are instruments."""
    instrument_block: float = 4.0
    """Band over which forces are projected on the instruments [Hz]."""
    instrument_order: int = 3
    """Order of the polynomials that let the amplitude of the instruments change within it."""
    absent_order: float = 1e-3
    """An instrument or spindle order below this share of the largest counts as absent."""
    # --- order_tracking
    spline_margin: float = 2.0
    """The splines reach so far beyond the band [Hz]."""
    window_lines: float = 3.0
    """Lines that a window sees to either side, in units of 1 over its duration: the main lobe of Hann has two."""
    window_rate: float = 500.0
    """Samples of a window from which its transform is taken, a second: forty times what it sees to a side."""
    added_decay: float = 4.0
    """Rest that is added to a record, so that the answer of a spline of the band does not come round [s]."""
    columns_each: float = 2.5
    """Windows for each unknown; with fewer the knots are moved apart."""
    judged_reach: float = 1.0
    """Windows within this distance judge condition and coherence at a frequency [Hz]."""
    noise_rounds: int = 3
    """Times that the noise of the passes is learnt from the residual."""
    # --- spindle_clock
    fewest_windows: int = 3
    """Windows that must fit into a cut."""
    clock_harmonics: int = 3
    """Harmonics of the tooth passing up to which orders are looked at."""
    response_phase: float = 0.5
    """What the response of the machine may turn the phase of a tooth harmonic by along a sweep [rad]."""
    notable_speed: float = 5e-4
    """Relative difference that is said."""
    refused_speed: float = 0.01
    """Relative difference from which nothing is identified: at a damping of 2 % it moves a peak by half of its
    width."""
    ratio_reach: float = 0.08
    """Ratios that are looked for lie within 1 and this [1]."""
    window_passages: int = 80
    """Tooth passages of a window over the angle."""
    comb_stands_out: float = 6.0
    """The comb stands above the median of all ratios by so many times what their lower half scatters by."""
    comb_lifted: float = 1.3
    """And it is so many times the median [1]."""
    spindle_holds: float = 3e-3
    """Relative difference to which a spindle holds the speed that it is set to."""
    slope_turns: float = 3.0
    """The speed is the slope of a parabola through the angle over so many turns."""
    slope_seconds: float = 0.5
    """And it is that over so long at least [s]."""
    above_air: float = 0.05
    """Share of the level of the cut, above that in the air, from which a force rises."""
    surely_in_cut: float = 0.5
    """Share of the level of the cut from which the tool is surely in it."""
    other_harmonics: tuple[float, ...] = (0.25, 1.0 / 3.0, 0.5, 1.0, 2.0, 3.0, 4.0)
    """By what a path through the forces alone may be off: it may follow every second tooth, or the second
    harmonic."""
    speed_by_force: float = 0.2
    """Relative difference from the stated speeds that is accepted where the speed is found from the forces
    alone."""
    path_scatter: float = 1.0
    """Rms from a smooth ramp from which a path through the forces is none [rad of the tooth passing]."""
    # --- chatter
    chatter_share: float = 0.25
    """Rms of the forces between whole orders over that at them, above which a window chatters."""
    chatter_line: float = 25.0
    """Power of the highest line between whole orders over the median between them, from which it is no noise."""
    chatter_windows: int = 2
    """Successive windows that must chatter."""
    shortest_rest: float = 4.0
    """Time in the cut that a rest of a pass is worth using from [s]."""
    # --- delay
    mode_turn: float = 3e-3
    """What the model, and damping that is a little out of proportion, turn a mode by [rad]."""
    lone_mode_turn: float = 0.03
    """The same where one mode alone is seen, and how modes differ is not known [rad]."""
    known_phase: float = 0.05
    """Standard deviation of the phase of a mode from which it says nothing [rad]."""
    mode_damping: tuple[float, float] = (0.002, 0.2)
    """Damping ratios of what is taken for a mode."""
    mode_height: float = 0.1
    """Peak of a mode over that of the highest below which it may be one of the noise."""
    clear_delay: float = 4.0
    """Standard deviations from which a delay is said."""


RULES = SweepRules()
