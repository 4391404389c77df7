"""From the modes and the feed axes of a campaign to the machine that is diagnosed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from process.errors import InputError
from process.types import Complex
from smfe.campaign import Campaign
from smfe.campaign.machine import GivenAxis
from smfe.diagnosis.cases.case import NamedModes
from smfe.diagnosis.cases.experiments import proposed_modal_experiments
from smfe.diagnosis.frf.noise import Excited, excited_of, smooth_errors
from smfe.diagnosis.inference.problem import Condition
from smfe.diagnosis.machine.axes import DeclaredAxis, Gains, contact_of, is_known, sides_of
from smfe.diagnosis.machine.family import MachineOfAxes
from smfe.diagnosis.machine.rules import RULES
from smfe.diagnosis.machine.settle import settled
from smfe.records.formats.channels import listed


def band_of(modes: NamedModes) -> tuple[float, float]:
    """Return the band that a machine is compared over [Hz]: from where its drives are soft to above its modes."""
    return RULES.lowest, RULES.reach * modes.band[1]


def machine_family(
    campaign: Campaign, axes: Mapping[str, GivenAxis], modes: NamedModes, conditions: tuple[Condition, ...]
) -> MachineOfAxes:
    """Return the family of a machine whose modes ride on feed axes.

    Raises
    ------
    InputError
        When a measurement names no controller of the axes, or an axis cannot be tested.
    """
    declared = {name: _declared(name, axis, modes.modal.frequency.size) for name, axis in axes.items()}
    for c in conditions:
        for name, axis in declared.items():
            given = str(c.settings.get("controller", ""))
            if len(axis.controllers) > 1 and given not in axis.controllers:
                raise InputError(
                    f"measurement '{c.name}': controller {given!r} is none of {listed(sorted(axis.controllers))} of "
                    f"[machine.axis.{name}]; name one of them"
                )
    spread = {**RULES.spread, **modes.spread}
    family = MachineOfAxes(
        modes.modal,
        conditions,
        proposed_modal_experiments(conditions),
        spread={name: spread[name] for name in ("frequency", "damping", "stiffness")},
        stated=tuple(modes.spread),
        axes=declared,
        tolerances=campaign.tolerances,
        top=modes.band[1],
    )
    family = family.with_errors()
    return settled(replace(family, conditions=tuple(_as_linearised(c, declared) for c in family.conditions)))


def _as_linearised(condition: Condition, axes: Mapping[str, DeclaredAxis]) -> Condition:
    """Return a condition that a linearised machine is compared with.

    Hits are no small vibration: what friction and joints do to each column beyond is an error all its lines share.
    """
    excited = excited_of(condition)
    assert condition.observed is not None
    known = excited.compliance_of(condition.observed)
    more = smooth_errors(excited.frequency, known, RULES.discrepancy)
    apart = [
        more * np.array([e == axis for _, e in excited.entries])
        for axis in dict.fromkeys(e for _, e in excited.entries)
    ]
    aside = [left_aside(excited, a, axis) for a, axis in axes.items() if excited.method == "hammer"]
    shared = np.concatenate([*([] if excited.shared is None else [excited.shared]), *apart, *aside])
    data = replace(excited, std=np.hypot(excited.std, RULES.floor * np.abs(known)), shared=shared)
    return replace(condition, data=data, observed=data.whitened(known))


def left_aside(excited: Excited, axis: str, declared: DeclaredAxis) -> Complex:
    """Return what hits along an axis do that leave its slide aside, as an error of `Excited.shared`, (0 or 1, f, k).

    Contacts that slip under the blow do not come back: bristles (LuGre) leave ``F^2/(k_c Fs)`` of a peak F behind, of
    Masing's loops half of it remains: a step, once and not at every cycle as damping does. A slide that moves has
    nowhere to come back to.
    """
    at = [n for n, entry in enumerate(excited.entries) if entry == (axis, axis)]
    if not at or excited.feed.get(axis, 0.0):
        return np.zeros((0, *excited.std.shape), dtype=complex)
    impulse = abs(excited.impulses.get(axis, excited.level))
    peak = 0.5 * np.pi * impulse / excited.duration
    step = peak**2 * declared.aside
    out = np.zeros((1, *excited.std.shape), dtype=complex)
    out[0, :, at[0]] = step / impulse / (2j * np.pi * excited.frequency)
    return out


def _declared(name: str, axis: GivenAxis, count: int) -> DeclaredAxis:
    law = axis.friction
    if law is not None and not is_known(law):
        raise InputError(f"machine.axis.{name}.friction has a delta other than 1, which cannot be tested; leave it out")
    if axis.coupling is not None and len(axis.coupling) != count:
        raise InputError(
            f"machine.axis.{name}.coupling has {len(axis.coupling)} values and the baseline {count} modes; give one a "
            "mode, or leave it out and have it found"
        )
    return DeclaredAxis(
        axis.moving_mass,
        {controller: Gains(*gains) for controller, gains in axis.controllers.items()},
        None if law is None else sides_of(law),
        None if law is None else contact_of(law),
        axis.coupling,
    )
