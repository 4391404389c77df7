"""Numbers of this room that were chosen, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SpectraRules:
    """How tones, periods and the angle of a spindle are found."""

    tone_steps: int = 8
    """Steps of Gauss and Newton at most."""

    highest_multiple: int = 30
    """Multiples of a frequency up to which tones are tied."""

    tied: float = 0.1
    """Distance to a multiple, in lines of the record, up to which a tone is tied to it."""

    stretch: float = 0.05
    """Length of the stretches [s] that are judged together."""

    unlike: float = 3.0
    """Residual of a stretch, of the usual one, above which it is left out."""

    chunk: int = 1 << 15
    """Samples that are summed at a time, for the memory."""

    piece: int = 1 << 8
    """Samples of the shorter of two series whose product is a wave."""

    angle_window: float = 1.0
    """Length of the pieces in which the tooth passing frequency is looked for [s]."""

    tooth_harmonics: int = 4
    """Harmonics of the tooth passing frequency that are added up."""

    lowest_tooth_passing: float = 4.0
    """Least tooth passing frequency [Hz] that is looked for in forces."""

    highest_tooth_passing: float = 250.0
    """Greatest such frequency [Hz]."""

    turns: float = 6.0
    """Turns over which an order is separated from the noise halfway to the next."""

    run_out_over_noise: float = 3.0
    """Run-out over noise from which it is run-out."""

    run_out: float = 0.003
    """Run-out, of the first harmonic of the period that was found, from which it is run-out."""

    like_teeth: float = 0.25
    """Harmonic of the period, of its first, from which it may be the teeth's."""

    same: float = 1e-6
    """Mean square change from one period to the next, of the variance, up to which a setpoint repeats itself."""

    flat: float = 1e-6
    """Relative difference of the lines of a binary sequence of maximum length, but for rounding."""


RULES = SpectraRules()
