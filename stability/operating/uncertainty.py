"""What is not known of a machine model: a factor on each parameter, log-normal and independent."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from process.errors import InputError
from process.machine.machine import Machine
from process.machine.structure import Posture, Structure
from process.types import Real

SAFE = 0.95
"""Probability with which the limit lies above the safe depth."""

_QUANTILES = ((0.05, -1.6448536269514722), (0.5, 0.0), (0.95, 1.6448536269514722))
_FRICTION = ("coulomb", "static", "stribeck_speed", "sigma")


@dataclass(frozen=True)
class Uncertainty:
    """Relative standard deviations.

    Parameters
    ----------
    coefficients : float, optional
        Of one factor on all cutting coefficients: the limits go as one over it.
    friction : float, optional
        Of each parameter of each friction law.
    mass, damping, stiffness : float, optional
        Of one factor on all mass, damping and stiffness of the structure.
    """

    coefficients: float = 0.0
    friction: float = 0.0
    mass: float = 0.0
    damping: float = 0.0
    stiffness: float = 0.0


def uncertainty_of(given: Mapping[str, float] | None) -> Uncertainty | None:
    """Return what is not known, checked; None where nothing is stated."""
    if given is None:
        return None
    names = [f.name for f in fields(Uncertainty)]
    for name, value in given.items():
        if name not in names:
            raise InputError(f"an uncertainty of '{name}' is given; there are {', '.join(names)}")
        if not 0.0 <= float(value) < 1.0:
            raise InputError(f"the uncertainty of {name} is {value:g}; give a share from 0 to below 1")
    return Uncertainty(**{name: float(value) for name, value in given.items()})


def quantile_factors() -> tuple[list[float], Real]:
    """Return the quantiles and the standard deviations that belong to them."""
    return [q for q, _ in _QUANTILES], np.array([z for _, z in _QUANTILES])


def variants(machine: Machine, known: Uncertainty) -> list[Machine]:
    """Return machines of which each has one parameter more by its standard deviation."""
    out = []
    for name in ("mass", "damping", "stiffness"):
        factor = math.exp(getattr(known, name))
        if factor > 1.0:
            out.append(replace(machine, structure=_changed(machine.structure, name, factor)))
    if known.friction > 0.0:
        factor = math.exp(known.friction)
        for axis, held in machine.axes.items():
            for name in _FRICTION:
                law = _scaled(held.friction, name, factor)
                if law is not None:
                    axes = {**machine.axes, axis: replace(held, friction=law)}
                    out.append(replace(machine, axes=axes))
    return out


def _scaled(law: Any, name: str, factor: float) -> Any:
    """Return a friction law, both directions of it, with one parameter times a factor; None where it has none."""
    value = getattr(law, name, None)
    if not isinstance(value, float | int) or value == 0.0:
        return None
    changed: dict[str, Any] = {name: value * factor}
    if name == "coulomb" and hasattr(law, "static"):
        changed["static"] = max(law.static, value * factor)
    if name == "static":
        changed["static"] = max(value * factor, law.coulomb)
    if getattr(law, "negative", None) is not None:
        changed["negative"] = _scaled(law.negative, name, factor) or law.negative
    return replace(law, **changed)


def _changed(structure: Structure | Posture, name: str, factor: float) -> Structure | Posture:
    if isinstance(structure, Posture):
        return replace(
            structure, structures=tuple(replace(s, **{name: factor * getattr(s, name)}) for s in structure.structures)
        )
    return replace(structure, **{name: factor * getattr(structure, name)})
