"""Numbers of this room that were chosen, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class HammerRules:
    """How hits and the motion between them are judged; what a user sets is in `impacts.HitRules`."""

    same_clock: float = 1.2e-4
    """Relative difference of the lines of two records up to which they are the same: two clocks are each wrong by
    50 ppm or so, and nobody knows which; a mode of 0.5 % damping moves by a fortieth of its half-width."""

    clear_tone: float = 40.0
    """Power of a line over the noise round it from which it is a tone; noise exceeds it in exp(-40) of the lines."""

    tone_neighbours: int = 200
    """Lines over which that noise is a median."""

    constant_tone: float = 0.3
    """Largest relative change of a tone from the early to the late halves of the quiet spans."""

    background_rounds: int = 3
    """How often trend and tones are fitted again, each without the other."""

    guard: float = 2e-3
    """Time before an onset [s] that is not quiet any more."""

    same_shape: float = 0.6
    """Least modal assurance criterion of two hits along one axis."""

    noisy_shape: float = 0.3
    """The same of a hit and the mean of the others, if it is like no other axis and of the right size and sign."""

    apart: float = 3.0
    """What a hit that is like no axis lacks to the others of its own, over the most that one of these lacks."""

    same_size: float = 2.0
    """Largest ratio of their compliances."""

    same_level: float = 2.5
    """Largest ratio of their peak forces: with friction, a strong and a weak hit rightly differ."""

    strong_line: float = 0.01
    """Power of a line, of the strongest, from which the shape is compared."""

    band_drop: float = 0.01
    """Power of the force spectrum, of its maximum, at which it ends: -20 dB."""

    other_side: float = 0.2
    """Share of the largest force from which a pulse of the other sign is a hit."""

    lead: float = 2e-3
    """Time before a hit is detected [s] from which its force is kept: it begins below the trigger."""

    contact: float = 25e-3
    """Time after that [s] over which it is kept; longer for hits that last longer."""

    relevant_mode: float = 0.3
    """Modes whose amplitude is above this share of the highest one count where their levels differ."""

    reach: int = 5
    """Lines to either side over which a compliance is a rational function."""

    poles: int = 2
    """Order of its denominator: two resonances may be near. Others bend the numerator."""

    bend: int = 2
    """Order of its numerator."""

    window_rounds: int = 3
    """How often the fit is weighted with the denominator found."""


RULES = HammerRules()
