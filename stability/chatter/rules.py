"""The chosen numbers of the chatter criterion, in one place, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ChatterRules:
    """What the criterion takes as a line, as noise, as a cut, as a spindle speed."""

    # What a line is.
    mask_bins: float = 3.0
    """Half width of the mask of a spindle order [bins of 1/T]: the main lobe of a Hann window reaches 2."""
    speed_variation: float = 5e-4
    """Relative variation of the speed within the record that the masks allow for [1]."""
    orders_seen: int = 60
    """Spindle orders of which one at least stands out of the noise where a tool cuts."""
    short_turns: tuple[float, ...] = (24.0, 12.0)
    """Windows in which lines that drift are looked for [turns]."""
    orders_compared: int = 5
    """Highest orders of a cut by which what was taken for air is told from a part of it."""
    stands_out: float = 4.0
    """A line is a line from this many times the local rms noise: white noise exceeds it once in 10^7 bins."""
    comb_harmonics: int = 20
    """Tooth passing harmonics that take part in finding the speed."""
    alternating_orders: int = 4
    """Tooth harmonics up to which order Z/2 and its odd multiples are compared with the other orders."""

    # Envelope and sidebands of the candidate.
    steady: float = 1.2
    """Kurtosis of the envelope below which a line is steady whatever else there is; self-excited chatter has 1."""
    comes_and_goes: float = 1.4
    """Kurtosis of the envelope, <|a|^4>/<|a|^2>^2, above which a line may be a mode that noise excites (2)."""
    noise_like: float = 1.75
    """Kurtosis of the envelope from which no coherence makes a line of it."""
    plainly_noise: float = 1.9
    """Kurtosis from which the height of a mode that noise excites does not matter."""
    noise_kurtosis: tuple[float, float] = (1.65, 3.5)
    """Least and most kurtosis of the envelope of a mode that noise excites."""
    noise_coherence: float = 6.0
    """Most coherence of such a mode."""
    excited: float = 4.0
    """Most that a mode that noise excites reaches below `plainly_noise` [thresholds]."""
    towering: float = 8.0
    """Height from which a steady line needs not stand out of what is around it [thresholds]."""
    grows: float = 5.0
    """Growth from the first to the last quarter from which a line grows [1]."""
    growing: float = 4.0
    """Most kurtosis that growth explains: exponential growth has 2 to 4, a knock far more."""
    lasts: tuple[float, float] = (0.7, 1.5)
    """Growth in which a line of a stretch is no transient that dies out, nor one that comes up [1]."""
    coherent: float = 30.0
    """Power of the sidebands over the median power between the orders that speaks for a line [1]."""
    certain: float = 50.0
    """The same, from which it is a line even where its envelope varies [1]."""

    # The rules.
    turns_of_air: float = 5.0
    """Turns in the air from which their mean force is the zero of the dynamometer."""
    fewest_turns: int = 6
    """Below this number of turns the masks of neighbouring orders meet."""
    sideband_share: float = 0.4
    """Share of the threshold that suffices a steady line with sidebands [1]."""
    nearly: float = 0.09
    """A steady line less than this share below the threshold is left open: a sensor may read it low [1]."""
    growth: float = 3.0
    """Growth of order Z/2 against the tooth line along the cut that run-out cannot explain [1]."""
    alternating: float = 6.0
    """Order Z/2 and its odd multiples over all other run-out orders, from which teeth alternate [1]."""
    alternating_rest: float = 0.9
    """The same without the highest order, which may stand on a resonance [1]."""
    alternate: float = 4.0
    """The same without the highest order, from which half the threshold suffices [1]."""
    eccentric: float = 1.5
    """The same, up to which order Z/2 is one of the lines that run-out puts on all orders [1]."""
    foreign: float = 5.0
    """A spindle order that is no tooth harmonic and this many times as high is left open: run-out reaches 15 [1]."""
    never_run_out: float = 20.0
    """The same, from which it is chatter [1]."""
    crowded: float = 0.25
    """Share of the spectrum that may be masked where a cut is called stable [1]."""
    silent: float = 0.1
    """An axis is measured against at least this share of the highest harmonic of all axes [1]."""

    # The part that is judged.
    speed_mismatch: float = 0.01
    """Difference between a recorded and the given speed above which one of them must be wrong [1]."""
    most_change: float = 0.03
    """Change of a recorded speed above which a record is a sweep; up to it the spindle is followed [1]."""
    judged_turns: tuple[int, int] = (60, 600)
    """Turns that are judged: fewer than the first reach back before the second half of the cut."""
    fewest_turns_of_cut: int = 12
    """A stretch of fewer turns far above the rest of a long record is an event, no cut."""
    turns_of_a_stretch: int = 24
    """Least turns of a stretch that is judged for itself."""
    most_stretches: int = 5
    """Most such stretches."""
    speed_pieces: int = 32
    """Most pieces on whose means a recorded speed is tested for being constant: each sample has noise."""

    # The speed of the spindle.
    speeds_searched: tuple[float, float] = (60.0, 60000.0)
    """Spindle speeds among which an unknown one is looked for [rpm]."""
    turn_unknown: float = 0.1
    """Window in which cut and air are separated while the speed is not known [s]."""
    clear: float = 1.5
    """How much higher a line must stand than another to be called the higher one [1]."""
    fewest_lines: int = 3
    """Lines that make a comb."""
    steps_a_bin: int = 4
    """Trial speeds within a bin of the highest line."""
    most_orders: int = 200
    """Most orders of a trial speed."""
    drift: float = 0.012
    """Relative change of the speed along what is judged that is looked for [1]."""
    first_turns: float = 10.0
    """Windows in which the speed is first followed [turns]."""
    most_turn_orders: int = 60
    """Most orders by which the speed is followed."""
    other_orders: float = 0.1
    """Weight of an order that is no tooth harmonic: half a per cent lays a chatter line at order 20 on an order."""
    most_gain: float = 3.0
    """Most that one line counts while the search is wide: log(1 + power/floor)."""
    line: float = 16.0
    """A bin counts from this many times the median power."""

    # Another number of teeth; the picture.
    most_teeth: int = 12
    """Numbers of teeth that are tried."""
    explained: float = 0.8
    """Least share of the power at the spindle orders that another number of teeth must explain [1]."""
    not_explained: float = 0.1
    """Most that the declared number of teeth then explains [1]."""
    picture: tuple[int, int] = (160, 300)
    """Most points of a spectrogram over time and frequency."""
    picture_turns: float = 10.0
    """Window of a spectrogram: neighbouring orders stand apart, an entry of as many turns is seen [turns]."""


RULES = ChatterRules()
"""Those of the criterion; none was chosen on the cuts on which it was verified."""
