"""What the baseline of a machine with feed axes may lack: of its guideways and drives, and of modes and sensors.

Gains, dead times and masses that somebody declared are no causes of their own: they are nuisances that the inference
releases and names where they are wrong. Here stand those that nobody declared, and what nests the baseline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from smfe.diagnosis.inference.problem import Cause, Parameter
from smfe.diagnosis.machine.axes import DeclaredAxis

REPEATED = ("modal_scale", "modal_mass", "cross_axis_coupling")
"""Causes of a model of modes alone that the nuisances of a machine repeat: its modes and their directions are free."""


def axis_causes(axes: Mapping[str, DeclaredAxis]) -> tuple[Cause, ...]:
    """Return what guideways may do that the baseline does not say."""
    smooth = [a for a, axis in axes.items() if not axis.sticks]
    found = []
    if smooth:
        hold = [_hold(a) for a in smooth]
        fall = [_fall(a) for a in smooth]
        speed = Parameter("stribeck_speed", "mm/min", 6e-3, 2e-3, 5e-4, 0.1, shown=6e4, secondary=True)
        held = tuple([0.7] * len(smooth))
        at_rest = "guideways that hold the slides at rest"
        found.append(Cause("guideway_friction", at_rest, tuple(hold), "sticks", starts=(held,)))
        starts = tuple((*held, *([100.0] * len(smooth)), v) for v in (4e-3, 1e-2))
        title = f"{at_rest}, and friction that falls with speed"
        found.append(Cause("guideway_friction", title, (*hold, *fall, speed), "stribeck", starts=starts))
    if len(smooth) < len(axes) or smooth:
        apart = tuple(
            Parameter(f"friction_asymmetry_{a}", "%", 0.0, 0.05, -0.9, 0.9, shown=100.0)
            for a, axis in axes.items()
            if axis.sticks or axis.friction is not None
        )
        if apart:
            found.append(Cause("friction_asymmetry", "friction that differs between the directions", apart))
    return tuple(_distinct(found))


def _hold(axis: str) -> Parameter:
    return Parameter(f"hold_{axis}", "%", 0.0, 0.05, 0.0, 0.9999, shown=100.0, secondary=True)


def _fall(axis: str) -> Parameter:
    return Parameter(f"fall_{axis}", "N", 0.0, 20.0, 0.0, 1e5)


def _distinct(causes: Sequence[Cause]) -> list[Cause]:
    """Give the parameters of a later variant names of their own."""
    seen: set[str] = set()
    out = []
    for cause in causes:
        own = tuple(
            p
            if p.name not in seen
            else Parameter(
                f"also_{p.name}", p.unit, p.start, p.scale, p.low, p.high, p.prior, p.shown, secondary=p.secondary
            )
            for p in cause.parameters
        )
        seen.update(p.name for p in own)
        out.append(Cause(cause.id, cause.title, own, cause.variant, cause.kind, cause.starts))
    return out
