"""Numbers of this room that were chosen, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ActuatorRules:
    """How the force of an actuator is judged, and what is claimed of the response; steps: `sine_fit.StepRules`."""

    known_to: float = 0.2
    """Relative standard deviation of a noise of the force that was measured in silence: it need not be white."""

    decayed: float = 0.25
    """Motion at the ends of a record, of that in all of it, below which it may begin and end at rest."""

    caution: float = 2.0
    """Factor on the bound of the force noise: it is the least of many estimates."""

    powerless: float = 1e-5
    """Power of the force, of what it has nearly everywhere at most, below which a line is not claimed: -50 dB."""

    drowned: float = 0.5
    """Share of the compliance that noise of the force may take; above, a line is not claimed."""

    most_frequencies: int = 3000
    """Lines of the frequency axis that is taken where no resolution is given."""

    anti_alias: float = 2.56
    """Sampling rate over the highest frequency that a usual converter passes."""

    clipped: float = 0.05
    """Share of samples at the end of the range above which a record is refused."""

    weak_line: float = 1e-4
    """Power of a line, of the strongest, below which it is not excited: -40 dB."""

    noisy_line: float = 100.0
    """Least power of a line over the noise of its mean."""

    unsettled: float = 3.0
    """Power of the error of the first period over that of the others from which it is transient."""

    transient_order: int = 2
    """Order of the polynomial that stands for the transient between the lines."""

    transient_bins: int = 8
    """Bins between the lines that it is fitted to."""

    least_share: float = 0.5
    """Least share of the force's power, up to the highest line, that has to be at its lines."""

    clean_share: float = 0.99
    """Share of it below which the force is not quite the multisine."""

    settled: float = 1e-4
    """Power of the transient over that of the linear response above which a warning is given."""

    repeats: float = 1e-2
    """Power of the noise over that of the linear response above which the response does not repeat itself."""

    sharp: float = 1e-3
    """Phase [rad] by which lines may smear for clocks that differ."""

    same_force: float = 0.97
    """Correlation of a force with itself one period later from which it repeats itself."""

    stepped: float = 0.6
    """Share of the energy of a force in steps of constant frequency from which it is a stepped sine."""

    least_period: int = 64
    """Samples of a period, at least."""

    whole_period: float = 0.02
    """Samples by which all periods of a record together may be away from a whole number."""

    sideways: float = 0.1
    """Rms of a force along another axis over that of the excitation from which a warning is given."""

    order: int = 2
    """Order of the polynomials over a band of lines."""

    agreement: float = 2.5
    """Largest difference of a band from a narrower one, in standard deviations of the narrower."""

    stronger: float = 1e-3
    """Probability with which noise alone makes the residual of a narrow band that much stronger than a wide one's."""

    most_lines: int = 1200
    """Lines of the widest band."""

    at_once: int = 400_000
    """Lines that are gathered at a time, for the memory."""

    worth: float = 0.8
    """Residual with a pole, of that without it, above which the pole is none."""

    resolved: float = 2.0
    """Lines that the half-power band of a resonance has to hold; of a narrower one nothing is claimed."""

    most_poles: int = 3
    """Poles that are looked for in one stretch of frequencies."""

    harmonics: int = 5
    """Highest harmonic that is fitted to a step."""

    neighbours: int = 8
    """Lines to either side of a sine that its noise is read from."""

    hop: float = 1.0 / 3.0
    """Distance of blocks, of their length."""

    least_blocks: int = 6
    """Independent blocks below which an average says too little of its error."""

    leaked: float = 0.3
    """Share of a response by which half the block length may change it; above, a line is not claimed."""


RULES = ActuatorRules()
