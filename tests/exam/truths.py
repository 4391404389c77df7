"""What a finding should estimate: the true value of the parameter that an effect changes, in the unit shown."""

import numpy as np
from truth.axis import Truth
from truth.blind import chosen, seed_of
from truth.effects import CUBIC_PER_SHIFT, SHARE_PER_DROP

from exam import drive

AXIS = {
    "friction_level": ("friction_level", 100.0),
    "asymmetry": ("friction_asymmetry", 50.0),  # the size is the difference, the parameter half of it
    "velocity_gain": ("Kp_error", 100.0),
    "integral_time": ("Ti_error", 100.0),
    "delay": ("extra_delay", 1e3),
    "posture": ("stiffness_per_metre", 100.0),
    "micro_slip": ("micro_slip_share", 100.0 * SHARE_PER_DROP),
    "cubic": ("cubic_stiffness", 1e-18 * CUBIC_PER_SHIFT),
    "gap": ("gap", 1e6),
    "gain": ("gain_error", 100.0),
    "skew": ("skew", 1e6),
    "mass_loading": ("sensor_mass", None),  # goes with the mass of the tip, which is drawn
    "drift": ("stiffness_over_session", 100.0),
}
"""Effect -> parameter, and its shown value for a size of one."""

DRIVE = {
    "friction": ("coulomb.force", lambda a: a.coulomb),
    "asymmetry": ("asymmetry.viscous", lambda a: a.asymmetry),
    "delay": ("loop_delay.delay", lambda a: 1e3 * a.delay),
    "stribeck": ("stribeck.boost", lambda a: a.static - a.coulomb),
    "thinning": ("shear.force", lambda a: a.thinning),
    "slope": ("position.offset", lambda a: a.slope),
    "command": ("hidden.command", lambda a: abs(a.command)),
}
"""Effect -> parameter, and its shown value for an axis.

A ripple and a hum have a phase, a drift a time, and a saturation counts from the largest command: not scored.
"""


def true_values(case):
    """Parameter -> true value of what is hidden, where it is one number; nothing for other subjects."""
    if case.subject == "drive":
        axis = drive.axis_of(case.hidden, case.seed, case.size)
        return {name: value(axis) for name, value in (DRIVE[e] for e in case.hidden if e in DRIVE)}
    if case.subject == "axis":
        rng = np.random.default_rng([seed_of(case.seed), 1])
        sizes = chosen(rng, case.hidden, len(case.hidden), (case.size, case.size))
        tip = Truth().with_nuisances(rng).tip_mass
        values = ((size, *AXIS[effect]) for effect, size in sizes.items())
        return {name: size * (tip if unit is None else unit) for size, name, unit in values}
    return {}
