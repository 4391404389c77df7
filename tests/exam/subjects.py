"""Subjects of the exam: what is measured, what can be hidden in it, and the cause that must then be named.

A subject hides an effect (or nothing) in data of a generator that shares no code with the packages and hands out the
family of models to be diagnosed. The answer is kept apart from it.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations

from truth.blind import draw

from exam import drive, limits, modal
from exam.records import family as axis_family

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
        ``hide(effects, seed, snr, size)`` -> family; `effects` a tuple of names, `size` over that which must be found.
    noisy : bool, optional
        Whether its generator can be asked for a signal over noise; else the noise is that of its instruments.
    sized : bool, optional
        Whether it can hide effects of other sizes.
    apart : tuple of set of str, optional
        Effects of which no two can be hidden together; a set of one: it is never hidden with another.
    several : bool, optional
        Whether it can hide two at once.
    sitting : int, optional
        How many times it was sat before with other seeds, after which the diagnosis was changed.
    """

    title: str
    effects: Mapping[str, str]
    hide: Callable
    noisy: bool = True
    sized: bool = True
    several: bool = True
    apart: tuple[frozenset[str], ...] = ()
    sitting: int = 0

    def causes(self, effects):
        """Cause ids that must be named."""
        return tuple(sorted(self.effects[e] for e in effects))

    @property
    def pairs(self):
        """Effects that can be hidden together and have different causes."""
        if not self.several:
            return []
        return [
            pair
            for pair in combinations(self.effects, 2)
            if len(set(self.causes(pair))) == 2
            and not any(set(pair) <= group or (len(group) == 1 and group & set(pair)) for group in self.apart)
        ]


class Without:
    """A family that lacks one cause, whatever its variants; it predicts with the null of that.

    Nothing that was declared is named after it either: it is fitted within what is trusted of it, and that is all.
    """

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

    @property
    def nuisances(self):
        """As declared, without that name."""
        return tuple(replace(p, given="") if p.given == self._cause else p for p in self._family.nuisances)

    def predict(self, condition, values):
        """As the family predicts."""
        return self._family.predict(condition, self._null | dict(values))

    def worth(self, weigh):
        """Return what matters of the family itself, whose kind says whether there are depths."""
        whole = self._family.worth(weigh) if isinstance(self._family, Without) else weigh(self._family)

        def of(cost):
            return lambda before, after: cost(self._null | dict(before), self._null | dict(after))

        return replace(whole, cost=of(whole.cost), shown=of(whole.shown))


def _axis(effects, seed, snr, size):
    design = next((AXIS_DESIGN[e] for e in effects if e in AXIS_DESIGN), "full")
    hidden, count = (effects, len(effects)) if effects else ((None,), 1)
    return axis_family(draw(seed, effects=hidden, count=count, scale=(size, size), design=design, snr=snr).records)


def _drive(effects, seed, snr, size):
    return drive.family_of(drive.axis_of(effects, seed, size), seed)


def _modal(effects, seed, snr, size):
    return modal.draw(effects or None, seed, snr=snr, size=size)[0]


def _limits(effects, seed, snr, size):
    return limits.family(effects[0] if effects else None, seed)[0]


WITH_FRICTION = tuple(frozenset({"friction", other}) for other in drive.SLIDING)
"""Friction cannot be hidden in an axis that is known to have it."""

SUBJECTS = {
    "axis": Subject("Compliances of a feed axis", AXIS, _axis, apart=(frozenset(AXIS_DESIGN),), sitting=3),
    "drive": Subject("Records of a moving axis", drive.EXPECTED, _drive, noisy=False, apart=WITH_FRICTION, sitting=3),
    "modal": Subject("Compliances against a modal model", modal.NAMES, _modal, sitting=1),
    "limits": Subject("Stability limits found by cutting", limits.EXPECTED, _limits, False, False, False),
}
