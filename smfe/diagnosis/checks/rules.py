"""The limits of all checks of data, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CheckRules:
    """Limits beyond which the checks of this package report what they measure."""

    frozen_share: float = 0.02
    """Longest run of one value, as a share of the record, above which a channel counts as frozen."""
    often: int = 5
    """Times that a signal whose tops are too quick to look flat must stop at its largest value to count as clipped."""
    rest_share: float = 0.6
    """Share of the record that a force may rest at exact zero at either end: the tool is in the air."""
    few_steps: float = 32.0  # converter steps in six standard deviations below which quantisation is part of the noise
    same_signal: float = 0.999999  # correlation of two channels above which they are one signal
    tone: float = 10.0  # amplitude of a tone over its local floor: 20 dB
    floor_width: int = 25  # lines on each side whose median is that floor
    self_excited: float = 3.0  # times the root mean square at rest above which an axis in motion vibrates by itself
    tonal: float = 0.5
    """... if at least this share of its power is in tones: noise of drives and guideways is not self-excited."""
    clear: float = 5.0  # standard deviations above which a line of a compliance is compared
    known: float = 0.2  # standard deviation over the mean of two reciprocal entries up to which their line is compared
    active: float = 0.05  # share of lines that give out energy above which a driving point is not passive
    slack: float = 0.02
    """Share of the magnitude, a degree of phase, up to which a line does not count as giving out energy."""
    no_turn: float = 0.5  # angle of a ratio of two compliances up to which it may be a factor of units or a gain [rad]
    same_factor: float = 0.3  # difference of the logarithms of two ratios up to which they may be one factor of units
    apart_entries: float = 0.2  # difference of two reciprocal entries over their size from which it is said
    beside: float = 0.3  # ... and over the direct entries from which that is a warning
    oblique: float = 10.0  # times the variance of all angles that cross terms may differ by: three deviations and more
    impossible: float = 0.4
    """Share of a compliance that no passive, reciprocal machine has above which another sign or order is tried."""
    mended: float = 0.35  # ... and share of that which the right sign or order may leave
    odd: float = 0.2
    """The same where a right sign or order leaves next to nothing of it: a third axis hides two that are exchanged."""
    mended_whole: float = 0.1
    answering: float = 1.0  # times the median size of a line from which on a machine answers
    flat: float = 0.05  # misfit below which the ratio of two compliances is a constant factor
    dynamic_stiffness: tuple[float, float] = (1e3, 1e11)
    """Range at the largest resonance [N/m]: a slender boring bar has 1e5 at rest, a hundredth of it in resonance."""
    of_model: float = 1.35
    """Ratio about a factor of units within which a measured compliance over that of its model is taken for it."""
    least_factor: float = 8.0
    """Smallest factor of units that is looked for against a model: a machine may well be three times as soft."""
    of_force: float = 12.0
    """Ratio of measured and predicted cutting force that is not credible: coefficients and wear give 4, a kN 1000."""
    hit_scatter: float = 0.1  # standard deviation of a compliance at its peak, relative, above which hits do not repeat
    wild_scatter: float = 0.5  # ... and from which that is a warning
    clear_hits: float = 3.0  # standard deviations above which a line counts as part of that peak
    hit_levels: float = 3.0  # ratio of the largest to the smallest peak force of hits that are averaged
    speeds_agree: float = 0.02
    """Relative difference between two statements of one speed that slip and the load of a cut explain."""
    steady: float = 0.02  # relative range of the speed within which the orders of a cut are lines
    apart: int = 5  # bins of a spectrum between two lines that are not one
    line: float = 8.0  # times the median about it from which a bin holds a line
    strongest_order: float = 5.0
    """Amplitude over the largest at a multiple of the number of teeth from which another order is the teeth's."""
    runout: float = 3.0  # largest run-out that is taken for one: of the chips of single teeth, over their mean
    stands_out: float = 2.0  # times its neighbours from which an order stands above them
    orders: int = 12  # highest number of teeth that is looked for
    p_value: float = 1e-4  # probability below which a difference of two estimates of a compliance is not noise
    notable: float = 0.02  # ... and its relative size from which it matters, rms over the band
    half_width: float = 0.5
    """Half of the band over which a compliance of a sweep is one polynomial [Hz]; bands do not overlap."""
    order: int = 2  # order of that polynomial
    harmonics: int = 3  # harmonics of the tooth passing frequency that are instruments
    halves_known: float = 0.03
    """Halves of passes are compared where their difference is known to this share of the compliance."""


RULES = CheckRules()
