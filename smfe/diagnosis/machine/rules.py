"""The numbers of the diagnosis of a machine of several axes that somebody chose, in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class MachineRules:
    """What a machine is taken for where nobody says it."""

    spread: Mapping[str, float] = field(
        default_factory=lambda: {"frequency": 0.1, "damping": 0.5, "stiffness": 0.3, "turn": 0.1}
    )
    """Prior standard deviation of a mode fitted at rest as one of the held slides, relative; of its direction [rad]."""
    momentum: float = 1.0  # prior standard deviation of the momentum of a mode along an axis (`unbounded`)
    momentum_given: float = 0.05  # the same where the campaign gives the coupling
    most_momentum: float = 0.6  # largest sum of squares of all modes that a fit begins with
    presliding: float = 8e-6
    """Displacement over which a guideway comes loose [m]: static friction over it is the stiffness of its contact."""
    contact_spread: float = 1.0  # prior standard deviation of the compliance of a contact, relative
    loss: tuple[float, float] = (0.1, 0.2)  # loss factor of a contact, and its prior standard deviation
    stribeck: tuple[float, float] = (6e-3, 4e-3)
    """Speed over which friction falls, where nobody states it, and its prior standard deviation [m/s]: on guideways and
    their drives 1 to 15 mm/s. Two feeds alone tell a small fall over a large speed from a large one over a small."""
    levels_of_two_laws: int = 3
    """Levels of hits from which a joint may both slip and harden: of two levels the stiffness at rest and one law take
    all that there is, and a second law what the first, with one stiffness a hit, leaves."""
    slowest: float = 0.2  # speed over the feed to which hits slow a slide down, at the least
    slip: float = 0.3  # share of a contact's stiffness that a hit of 1 N s takes: prior standard deviation
    aside: float = 8e-12
    """Displacement that a blow leaves behind at rest, over the square of its peak [m/N^2], of friction that nobody
    declared: that of 1 kN which comes loose over 8 um."""
    above: float = 0.03
    """Flexibility of modes above the band over that of the softest mode: prior standard deviation."""
    viscous_share: float = 0.05  # viscous friction that nobody states, over the velocity gain: its standard deviation
    friction: float = 0.2  # prior standard deviation of the level of friction that is declared
    bandwidth: float = 20.0  # velocity loop of a control whose gains nobody knows, where a fit begins [Hz]
    unknown: float = 1.0  # prior standard deviation of such a gain, relative
    delay: float = 1e-3  # dead time of such a control and its standard deviation [s]
    half_held: float = 60.0
    """Natural frequency of an axis on a contact that holds half of it [Hz]: 100 % is a contact that does not yield."""
    lowest: float = 3.0  # frequency from which a machine with drives is compared [Hz]
    discrepancy: float = 0.01
    """Rms of the smooth relative error of a column: hits are no small vibration. With 0.4 % two simulations of one
    healthy machine (hits of 1 N s on slides of 0.3 to 3 t at 200 mm/min) differ significantly and by nothing that
    matters, and the search follows it for minutes."""
    floor: float = 0.01
    """The same of each line by itself: least standard deviation relative to the compliance."""
    reach: float = 1.3  # ... and to which, over the highest mode: beyond, modes that are not seen act
    starts_left_out: int = 7
    """Of the starts of a cause of modes one in so many is followed: a fit of eighty parameters takes seconds."""
    # where fits begin
    usual: tuple[str, ...] = ("viscous_", "aside_", "reach_", "stir_", "push_", "contact_slip_", "contact_loss_")
    """Names of what is expected where it was declared or usually is, wherever a first fit finds it: viscous friction,
    what sensors, hits and contacts do. Of modes and momenta nobody knows more than that fit."""
    of_hits: tuple[str, ...] = ("aside_", "reach_", "stir_", "push_", "contact_slip_")
    """Those of them that say what hits do, which is not held against a joint that slips in them."""
    sure: float = 1e-5  # tolerance of what is declared while the rest is fitted
    temperatures: tuple[float, ...] = (1000.0, 30.0, 1.0)  # by which the squares of the data are divided
    hot: tuple[float, ...] = (1e5, 1e4)  # temperatures before the first, of starts that it alone leads astray
    small: float = 0.4  # share of the momenta that the mass at the tool suggests, of other starts
    mixed: int = 3  # starts whose axes begin each in a way of its own
    cooled: int = 3  # starts that are followed from the first temperature on until one ends near the data
    softer: float = 1.5  # power of the frequency of a mode with which it takes less momentum where a slide moves evenly
    most_as_a_whole: float = 0.9  # largest sum of squares of momenta of slides that move as a whole
    aligned: float = 1e-3  # relative singular value below which modes do not move the tool along an axis
    near: float = 0.05  # misfit beyond noise over what the data are beyond it, below which no sign is wrong
    near_enough: float = 0.1  # the same, at the first temperature, of a start beside which no other is followed
    damping: float = 0.01  # of the first step, over the diagonal of the normal equations
    most_steps: int = 30  # at one temperature
    most_dampings: int = 8  # that are tried in a step
    levels_apart: float = 1.5  # largest level of hits over the smallest, from which a joint is looked for
    over_noise: float = 4.0  # standard deviations of a misfit beyond that of noise, from which something is left
    begun_times: int = 2  # fits that follow each other before a joint is looked for
    begun_to: float = 0.003  # share of its misfit to which a fit is followed that others begin with
    joint_promises: float = 0.2  # share of what is left that a joint must take to first order to be fitted
    joint_leaves: float = 0.5  # the same that it may leave to be begun with
    joint_sizes: tuple[float, ...] = (0.01, 0.03, 0.1)  # of a joint that are tried along the direction found for it
    joint_travels: tuple[float, ...] = (3.0, 1.0)  # the same of the travel of its elements
    joint_starts: int = 20  # of directions, besides each mode alone
    followed: float = 0.03
    """Share of the change of a compliance with a parameter that the change of a joint's force must be for it to be
    simulated: with amplitudes as they were it is 10 to 20 % off."""
    little_progress: float = 0.003  # relative decrease of the misfit below which a temperature is done with
    little_decrease: float = 0.5  # the same of the misfit itself: standard deviations of priors, and of data so heated


RULES = MachineRules()
