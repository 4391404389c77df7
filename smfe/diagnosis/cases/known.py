"""Causes that an earlier diagnosis found, as part of the baseline: ``known`` of ``[baseline]``.

What has a table of its own in a campaign (modes, friction, gains, coefficients) is written there. All else, a joint
that slips or a drift over the session, is given as ``finding.json`` has it: key of the cause, parameters with their
unit. Its parameters are then fitted with the baseline's own, about these values, and the cause leaves the catalogue.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, cast

from process.errors import InputError
from process.friction.laws import Andersson, Coulomb, CoulombViscous
from smfe.campaign import Campaign, RigidDrive
from smfe.diagnosis.drive.terms import EXPONENT
from smfe.diagnosis.inference.problem import Cause, Condition, Family, Parameter
from smfe.records.formats.channels import did_you_mean, listed

Known = Mapping[str, Mapping[str, str]]
"""Key of a cause -> parameter -> value with its unit."""

SPREAD = 0.1
"""Standard deviation with which a known cause is trusted, relative; at least a change that matters."""


LEVEL = "guideway_friction"
"""Id of the cause whose size is declared as the friction of a control is: what the data contradict of it is named."""


STRIBECK = "low_speed_friction/stribeck"
"""Key of the cause that a Stribeck curve is."""


def known_of(campaign: Campaign) -> Known:
    """Return what the baseline of a campaign holds besides its family: ``known``, and the friction of drive records."""
    law = _friction(campaign)
    found = dict[str, Mapping[str, str]]()
    if law is not None and law.coulomb > 0.0:
        found[f"{LEVEL}/coulomb"] = {"coulomb.force": f"{law.coulomb:.9g} N"}
    if isinstance(law, Andersson) and law.static > law.coulomb:
        found[STRIBECK] = {
            "stribeck.boost": f"{law.static - law.coulomb:.9g} N",
            "stribeck.speed": f"{1e3 * law.stribeck_speed:.9g} mm/s",
            EXPONENT.name: f"{law.delta:.9g} 1",
        }
    return {**found, **campaign.known}


def with_known(family: Family, campaign: Campaign) -> Family:
    """Return a family whose baseline has all that the campaign says besides it (`known_of`, `settled`).

    Raises
    ------
    InputError
        As `settled`.
    """
    law = _friction(campaign)
    if not isinstance(law, Andersson) or STRIBECK in campaign.known:
        return settled(family, known_of(campaign))
    # The rise is a difference of two forces, each known within its share.
    within = {"stribeck.boost": SPREAD * math.hypot(law.static, law.coulomb)}
    return settled(reaching(family, campaign), known_of(campaign), within)


def reaching(family: Family, campaign: Campaign) -> Family:
    """Return a family in which a Stribeck curve may be what was declared, whatever its exponent.

    Moves need not tell the speed of one that is known.
    """
    law = _friction(campaign)
    # A curve that does not rise towards rest is none.
    if not isinstance(law, Andersson) or law.static <= law.coulomb:
        return family
    given = {"stribeck.speed": law.stribeck_speed, EXPONENT.name: law.delta}

    def curve(cause: Cause) -> Cause:
        if cause.key != STRIBECK:
            return cause
        parameters = (
            replace(p, low=min(p.low, 0.5 * x), high=max(p.high, 2.0 * x)) if (x := given.get(p.name)) else p
            for p in (*cause.parameters, EXPONENT)
        )
        return replace(cause, parameters=tuple(parameters))

    return cast(Family, Settled(family, family.nuisances, tuple(map(curve, family.causes))))


def _friction(campaign: Campaign) -> Coulomb | CoulombViscous | Andersson | None:
    law = campaign.baseline.friction if isinstance(campaign.baseline, RigidDrive) else None
    return law if isinstance(law, Coulomb | CoulombViscous | Andersson) else None


class Settled:
    """A family with some of its causes in its baseline; all else it leaves to the family."""

    def __init__(self, family: Family, nuisances: tuple[Parameter, ...], causes: tuple[Cause, ...]) -> None:
        self._family, self.nuisances, self.causes = family, nuisances, causes

    @property
    def conditions(self) -> tuple[Condition, ...]:
        """What was measured."""
        return self._family.conditions

    def __getattr__(self, name: str) -> Any:
        """Return what the family has under a name."""
        if name.startswith("__") or name == "_family":
            raise AttributeError(name)
        return getattr(self._family, name)


def settled(family: Family, known: Known, within: Mapping[str, float] | None = None) -> Family:
    """Return a family whose baseline has some causes, about the values that are known.

    Parameters
    ----------
    family : Family
        With these causes in its catalogue.
    known : mapping
        Key of each cause, its parameters with their units.
    within : mapping, optional
        Name of a parameter -> standard deviation with which it is trusted (SI); default: `SPREAD` of its value.

    Raises
    ------
    InputError
        For a cause or a parameter that the family has not, or a unit that is not the parameter's.
    """
    if not known:
        return family
    values = known_values(family, known)
    mine = [c for c in family.causes if c.key in known]

    def trusted(cause: Cause, p: Parameter) -> Parameter:
        value = values[p.name]
        if p.secondary:
            # Who knows a cause knows what it does; what only shapes it is known as well as wherever it is looked for.
            return replace(p, start=value, prior=max(p.prior, SPREAD * abs(value), p.scale))
        named = LEVEL if cause.id == LEVEL else ""
        spread = (within or {}).get(p.name, SPREAD * abs(value))
        return replace(p, start=value, prior=max(spread, p.scale), given=named)

    more = tuple(trusted(c, p) for c in mine for p in c.parameters)
    rest = tuple(c for c in family.causes if c.key not in known)
    return cast(Family, Settled(family, (*family.nuisances, *more), rest))


def known_values(family: Family, known: Known) -> dict[str, float]:
    """Return the parameters of known causes (SI); what is not given of one has its null value.

    Raises
    ------
    InputError
        As `settled`.
    """
    causes, found = {c.key: c for c in family.causes}, {}
    for key, given in known.items():
        if key not in causes:
            near = did_you_mean(key, list(causes))
            raise InputError(
                f"baseline.known: '{key}' is no cause of these measurements{near}; there are {listed(causes)}"
            )
        own = {p.name: p for p in causes[key].parameters}
        for name in given:
            if name not in own:
                near = did_you_mean(name, list(own))
                raise InputError(f"baseline.known.'{key}': '{name}' is none of its parameters{near}: {listed(own)}")
        for name, p in own.items():
            found[name] = _value(f"baseline.known.'{key}'.{name}", given[name], p) if name in given else p.start
    return found


def written(value: float, parameter: Parameter) -> str:
    """Return a value (SI) as `known` has it."""
    return f"{value * parameter.shown:.9g} {parameter.unit}".strip()


def _value(where: str, text: str, p: Parameter) -> float:
    number, _, unit = str(text).strip().partition(" ")
    try:
        value = float(number) / p.shown
    except ValueError:
        value = math.nan
    if unit.strip() != p.unit or not math.isfinite(value):
        raise InputError(f"{where}: {text!r} has not the unit of finding.json; write a number and '{p.unit}'")
    if not p.low <= value <= p.high:
        low, high = p.low * p.shown, p.high * p.shown
        raise InputError(f"{where}: {text!r} is not possible; give {low:g} to {high:g} {p.unit}")
    return value
