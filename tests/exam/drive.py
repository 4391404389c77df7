"""Drive records for the exam: an axis with something hidden, as a family that can be diagnosed."""

from dataclasses import replace

import numpy as np
from truth.drive import DRIVE_EFFECTS, DRIVE_OUTSIDE, FRICTION, STEP, Axis, simulate

from process.labels import make_record
from smfe.diagnosis.drive.control_law import Gains
from smfe.diagnosis.drive.record import DriveRecordFamily

EXPECTED = {
    "friction": "guideway_friction",
    "asymmetry": "friction_asymmetry",
    "delay": "loop_delay",
    "ripple": "position_ripple",
    "drift": "drift",
    "stribeck": "low_speed_friction",
    "thinning": "low_speed_friction",
    "slope": "position_friction",
    "command": "hidden_input",
    "saturation": "drive_saturation",
    "hum": "background_tone",
}
"""Hidden effect -> cause that must be named."""

SLIDING = ("stribeck", "thinning")
"""Effects that need sliding friction; friction itself needs an axis without it. The others get either."""


def axis_of(effects, seed, size=1.0):
    """The axis of a seed with effects hidden, `size` times as large as must be found; half have friction."""
    rng = np.random.default_rng([seed, 7])
    axis = _paced(Axis().with_nuisances(rng), np.random.default_rng([seed, 8]))
    sliding = bool(rng.integers(2))
    every = DRIVE_EFFECTS | DRIVE_OUTSIDE
    signs = rng.choice([-1.0, 1.0], len(every))
    if set(effects) & set(SLIDING) or (sliding and "friction" not in effects):
        axis = replace(axis, coulomb=float(rng.uniform(0.75, 1.25) * FRICTION))
    for (name, effect), sign in zip(every.items(), signs, strict=True):
        if name in effects:
            axis = effect.plant(axis, size * effect.size * (sign if effect.signed else 1.0))
    return axis


def _paced(axis, rng):
    """The axis with moves that follow each other at once or after a rest; half as long again where it rests."""
    rest = float(rng.choice([0.0, 0.0, 0.3, 0.8]))
    return replace(axis, rest=rest, seconds=24.0 if rest == 0.0 else 36.0)


def record_of(axis, seed):
    """Simulate an axis and declare its channels."""
    found = simulate(axis, seed)
    channels = {
        "encoder_position": {"x": found["encoder"]},
        "drive_force": {"x": found["force"]},
        "reference_position": {"x": found["reference"]},
    }
    return make_record(found["time"], channels)


def family_of(axis, seed, **options):
    """The family of an axis: its half sample of hold is known, and so is its sliding friction, if it has any."""
    options = {"delay": 0.5 * STEP, **options}
    if axis.command:
        options["gains"] = Gains(axis.position_gain, axis.velocity_gain)
    made = DriveRecordFamily.from_record(record_of(axis, seed), **options)
    if axis.coulomb > 0.5 * FRICTION:
        known = "guideway_friction/coulomb"
        (cause,) = (c for c in made.causes if c.key == known)
        starts = {p.name: p.start for p in (*made.nuisances, *cause.parameters)}
        made = made.settled([known], starts | {"coulomb.force": FRICTION})
    return made


def family(effect, seed):
    """Return the family of an axis with an effect hidden (None: nothing) and the id of the cause that must be named.

    Effects: the keys of `EXPECTED`, or of `DRIVE_OUTSIDE`, which no cause explains (id None).
    """
    axis = axis_of(() if effect is None else (effect,), seed)
    return family_of(axis, seed), EXPECTED.get(effect)
