"""Subjects of the exam: what is measured, what can be hidden in it, and the cause that must then be named.

A subject hides an effect (or nothing) in data of a generator that shares no code with the packages and hands out the
family of models to be diagnosed. The answer is kept apart from it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from exam import drive, limits, modal
from exam.records import family as axis_family
from truth.blind import draw

AXIS = {
    "friction_level": "guideway_friction",
    "asymmetry": "friction_asymmetry",
    "velocity_gain": "servo_gains",
    "integral_time": "servo_gains",
    "delay": "loop_delay",
    "posture": "posture",
    "micro_slip": "joint_micro_slip",
    "cubic": "joint_hardening",
    "gap": "backlash",
    "gain": "sensor_gain",
    "skew": "time_skew",
    "mass_loading": "accelerometer_mass",
    "drift": "drift",
}
"""Effects in the compliances of an axis. A tone is found in the silent record, not in compliances."""

AXIS_DESIGN = {"mass_loading": "with laser"}
"""Designs other than the full one: without a sensor that weighs nothing, mass of the sensor is mass of the tip."""


@dataclass(frozen=True)
class Subject:
    """One kind of data.

    Parameters
    ----------
    title : str
        For the page.
    effects : mapping
        Effect -> cause id that must be named.
    hide : callable
        ``hide(effect or None, seed, snr)`` -> family.
    noisy : bool, optional
        Whether its generator can be asked for a signal over noise; else the noise is that of its instruments.
    """

    title: str
    effects: Mapping[str, str]
    hide: Callable
    noisy: bool = True


class Without:
    """A family that lacks one cause, whatever its variants; it predicts with the null of that."""

    def __init__(self, family, cause):
        self._family, self._cause = family, cause
        self._null = {p.name: p.start for c in family.causes if c.id == cause for p in c.parameters}

    def __getattr__(self, name):
        found = getattr(self._family, name)
        return (lambda values: found(self._null | dict(values))) if name == "as_found" else found

    @property
    def causes(self):
        """All but the one."""
        return tuple(c for c in self._family.causes if c.id != self._cause)

    def predict(self, condition, values):
        """As the family predicts."""
        return self._family.predict(condition, self._null | dict(values))


def _axis(effect, seed, snr):
    return axis_family(draw(seed, effects=(effect,), design=AXIS_DESIGN.get(effect, "full"), snr=snr).records)


def _of(family):
    """A subject whose generator has one level of noise."""
    return lambda effect, seed, snr: family(effect, seed)[0]


SUBJECTS = {
    "axis": Subject("Compliances of a feed axis", AXIS, _axis),
    "drive": Subject("Records of a moving axis", drive.EXPECTED, _of(drive.family), False),
    "modal": Subject("Compliances against a modal model", modal.NAMES, lambda *case: modal.family(*case)[0]),
    "limits": Subject("Stability limits found by cutting", limits.EXPECTED, _of(limits.family), False),
}
